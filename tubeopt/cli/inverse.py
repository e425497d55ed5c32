"""`tubeopt ik`: the joint values that bring the tip to a target."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Group
from rich.table import Table
from rich.text import Text

from ..equilibrium.file import save_equilibrium
from ..errors import SolveError
from ..files.checked import check
from ..files.csv_file import to_csv
from ..files.files import atomic_write, write_text
from ..files.units import DEG, in_unit, parse_number
from ..files.units import MM as MM_UNIT
from ..inverse import InverseSolution, JointWay
from ..robots.path_file import joint_columns
from ..runs.inverse_study import InverseStudy, Postures, Row, TargetTable
from ..runs.target_file import DIRECTION, POSITION
from ..show.progress import working
from ..show.report import can_be_saved, present, report, to_text, two_columns
from ..show.words import MM, degrees, millimetres, row
from ..typing import Array
from .options import JsonOption, OutOption, RobotArgument, numbers

PATHS = {"robot": "", "targets": "", "start": "", "obstacles": ""}
"""Keys that are files, whose messages name the file."""


def ik(
    robot: RobotArgument,
    target_mm: Annotated[str | None, typer.Option(metavar="X,Y,Z", help="Where the tip shall be.")] = None,
    direction: Annotated[
        str | None, typer.Option(metavar="X,Y,Z", help="Along which the tip shall point, of any length.")
    ] = None,
    targets: Annotated[
        str | None,
        typer.Option(metavar="TARGETS.csv", help="Many targets: columns x_mm, y_mm, z_mm[, direction_x, ...]."),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option("--from", metavar="JOINTS.yaml", help="Where the robot is: rotations_deg, translations_mm."),
    ] = None,
    min_margin: Annotated[str, typer.Option(metavar="MU", help="Least stability margin.")] = "0.05",
    objective: Annotated[
        str | None, typer.Option(metavar="WHAT", help="What is best: nearest (to --from), margin or curvature.")
    ] = None,
    direction_weight: Annotated[
        str | None, typer.Option(metavar="W", help="Make the direction a cost of this weight.")
    ] = None,
    obstacles: Annotated[
        str | None, typer.Option(metavar="OBSTACLES.yaml", help="Bodies that the whole arm keeps away from.")
    ] = None,
    clearance_mm: Annotated[str, typer.Option(metavar="MM", help="Least distance of the arm from obstacles.")] = "0",
    method: Annotated[str, typer.Option(help="How to solve: auto, gauss_newton or nlp.")] = "auto",
    every: Annotated[bool, typer.Option("--all", help="All distinct postures for the target, the best first.")] = False,
    closest: Annotated[
        bool, typer.Option("--closest", help="Where the target is out of reach, the closest pose.")
    ] = False,
    follow: Annotated[
        bool, typer.Option("--follow", help="Solve each of TARGETS.csv from the last one, on its branch.")
    ] = False,
    reachable: Annotated[
        bool,
        typer.Option(
            "--reachable/--no-reachable",
            help="Find a way without a snap, from --from or home, or say none.",
        ),
    ] = True,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Inverse kinematics: stable joint values that bring the tip to a target, and point it there.

    Ends with 3 where the target, or every one of a table, is missed, with --closest as well; misses within a table are
    named in it. With --follow, targets are put between those of the table where the robot would leap.
    """
    flags: dict[str, Any] = {
        "kind": "inverse_kinematics",
        "robot": robot,
        "target_mm": numbers(target_mm),
        "direction": numbers(direction),
        "targets": targets,
        "start": start,
        "min_margin": parse_number(min_margin),
        "objective": objective,
        "direction_weight": None if direction_weight is None else parse_number(direction_weight),
        "obstacles": obstacles,
        "clearance_mm": parse_number(clearance_mm),
        "method": method,
        "all": every,
        "closest": closest,
        "follow": follow,
        "reachable": reachable,
    }
    names = {key: f"--{key.replace('_', '-')}" for key in flags} | PATHS
    given = {key: value for key, value in flags.items() if value is not None}
    study = check(InverseStudy, given, "", names=names)
    can_be_saved(out)
    with working("solving targets") as progress:
        answer = study.run(progress)
    present(report(answer), out=out, as_json=as_json)
    refuse_misses(answer)


def refuse_misses(answer: Postures | TargetTable) -> None:
    """Raise SolveError where the target, or every one of a table, is missed."""
    if isinstance(answer, Postures):
        best = answer.solutions[0]
        if not best.reached:
            raise SolveError(f"{best.status}: {_miss(best)}", best)
        return
    given = [row for row in answer.rows if row.given]
    if not any(row.solution is not None and row.solution.reached for row in given):
        raise SolveError(f"none of {len(given)} targets was reached; the first: {_why(given[0])}")


def solution_record(solution: InverseSolution) -> dict[str, Any]:
    """An answer as JSON."""
    s, e = solution, solution.equilibrium
    direction = s.target_direction
    return {
        "target_mm": (s.target_position * MM).tolist(),
        "target_direction": None if direction is None else direction.tolist(),
        "status": s.status.name,
        "rotations_deg": np.degrees(s.rotations).tolist(),
        "translations_mm": (s.translations * MM).tolist(),
        "tip_position_mm": (e.tip_position * MM).tolist(),
        "tip_direction": e.tip_rotation[:, 2].tolist(),
        "position_error_mm": s.position_error * MM,
        "direction_error_deg": None if direction is None else float(np.degrees(s.direction_error)),
        "margin": s.margin,
        "clearance_mm": s.clearance * MM,
        "energy_mJ": e.energy * MM,
        "cold_start_agrees": s.cold_start_agrees,
        "straight_from_start": s.straight_from_seed,
        "reachable": s.reachable,
        "way": None if s.way is None else _way_record(s.way),
        "leaps": s.leaps,
        "active": list(s.active),
        "statistics": asdict(s.statistics),
    }


def _way_record(way: JointWay) -> dict[str, Any]:
    return {
        "from": way.origin,
        "rotations_deg": np.degrees(way.rotations).tolist(),
        "translations_mm": (way.translations * MM).tolist(),
    }


@dataclass(frozen=True)
class PosturesReport:
    """What is said and saved about the answers for one target."""

    answer: Postures

    def record(self) -> dict[str, Any]:
        """The answers as JSON, the best first."""
        return {
            "robot": self.answer.robot.name,
            "solutions": [solution_record(solution) for solution in self.answer.solutions],
        }

    def table(self) -> Group:
        """The best answer, and a row for each of the others."""
        best, *others = self.answer.solutions
        name = self.answer.robot.name or "robot"
        parts: list[Any] = [two_columns(f"{name}: {best.status}", _rows(best))]
        if others:
            parts += [Text(f"\nother postures with the same tip: {len(others)}"), _others(others)]
        return Group(*parts)

    def save(self, directory: Path) -> list[Path]:
        """Write solutions.json, result.json with arrays.npz of the best, and way.csv, the waypoints to it, where a way
        is known; `tubeopt follow` reads them."""
        best = self.answer.solutions[0]
        path = directory / "solutions.json"
        write_text(path, to_text(self.record()))
        paths = [path, *save_equilibrium(best.equilibrium, directory)]
        if best.way is not None:
            paths.append(directory / "way.csv")
            turns, shifts = joint_columns(self.answer.robot.n_tubes)
            table = zip(best.way.rotations, best.way.translations, strict=True)
            write_text(paths[-1], to_csv([*turns, *shifts], (_joints(*row) for row in table)))
        return paths

    def draw(self, directory: Path) -> list[Path]:
        """Write inverse.png."""
        from ..show.plots.inverse import plot_inverse  # Matplotlib takes longer to load than a solve

        path = directory / "inverse.png"
        with atomic_write(path) as temporary:
            plot_inverse(self.answer.solutions, temporary)
        return [path]


def _rows(s: InverseSolution) -> list[tuple[str, str]]:
    e = s.equilibrium
    rows = [
        ("target", millimetres(s.target_position, ".6g")),
        ("rotations", degrees(s.rotations, ".6f")),
        ("translations", millimetres(s.translations, ".6f")),
        ("tip position", millimetres(e.tip_position, ".6f")),
        ("misses by", f"{s.position_error * MM:{'.1e' if s.reached else '.4f'}} mm"),
        ("pointing along", row(e.tip_rotation[:, 2], ".4f")),
    ]
    if s.target_direction is not None:
        rows.append(("off the direction by", f"{np.degrees(s.direction_error):.1e} deg"))
    rows.append(("margin", f"{s.margin:.3f}"))
    if np.isfinite(s.clearance):
        rows.append(("clear of obstacles by", f"{s.clearance * MM:.4f} mm"))
    rows.append(("a way without a snap", _way_words(s)))
    if s.active:
        rows.append(("held by", ", ".join(s.active)))
    count = s.statistics
    tries = "1 start" if count.tries == 1 else f"{count.tries} starts"
    rows.append(("solved", f"in {count.seconds * MM:.1f} ms by {count.method}, {tries}, from the {count.start}"))
    return rows


def _way_words(s: InverseSolution) -> str:
    if s.way is not None:
        count = len(s.way.rotations) - 2
        there = "straight" if count == 0 else f"through {count} waypoint{'' if count == 1 else 's'}"
        return f"{there} from {'home' if s.way.origin == 'home' else f'the {s.way.origin}'}"
    return "none was found" if s.reachable is False else "none is known"


def _joints(rotations: Array, translations: Array) -> list[object]:
    """Cells of one row of joint values."""
    return [*(in_unit(float(x), DEG) for x in rotations), *(in_unit(float(x), MM_UNIT) for x in translations)]


def _others(solutions: Sequence[InverseSolution]) -> Table:
    table = Table(box=None, padding=(0, 2, 0, 0))
    for name in ("rotations (deg)", "translations (mm)", "margin", "mJ"):
        table.add_column(name, header_style="bold", justify="left" if "(" in name else "right")
    for s in solutions:
        table.add_row(
            row(np.degrees(s.rotations), ".2f"),
            row(s.translations * MM, ".2f"),
            f"{s.margin:.3f}",
            f"{s.equilibrium.energy * MM:.3f}",
        )
    return table


@dataclass(frozen=True)
class TargetTableReport:
    """What is said and saved about a table of targets. Targets are counted from 1."""

    answer: TargetTable

    def record(self) -> dict[str, Any]:
        """The answers as JSON, one per target."""
        return {
            "robot": self.answer.robot.name,
            "targets": len(self._given()),
            "reached": len(self._reached()),
            "solutions": [
                {"target": r.number}
                | (solution_record(r.solution) if r.solution is not None else _missing(r))
                | {"problem": r.problem}
                for r in self.answer.rows
            ],
        }

    def _given(self) -> list[Row]:
        return [r for r in self.answer.rows if r.given]

    def _reached(self) -> list[InverseSolution]:
        return [r.solution for r in self._given() if r.solution is not None and r.solution.reached]

    def table(self) -> Group:
        """How many targets were reached, and why others were not."""
        rows, reached = self._given(), self._reached()
        lines = [("reached", f"{len(reached)} of {len(rows)} targets")]
        if reached:
            lines += [
                ("largest error", f"{max(s.position_error for s in reached) * MM:.1e} mm"),
                ("least margin", f"{min(s.margin for s in reached):.3f}"),
                ("median time", f"{np.median([s.statistics.seconds for s in reached]) * MM:.1f} ms per target"),
            ]
        lines += self._ways(reached)
        notes = [(r, _why(r)) for r in rows if r.solution is None or not r.solution.reached]
        notes += [(r, f"leaps: {r.solution.leaps}") for r in self.answer.rows if r.solution and r.solution.leaps]
        texts = [Text(f"target {r.number:g}: {words}") for r, words in notes[:10]]
        texts += [Text(f"and {len(notes) - 10} more")] if len(notes) > 10 else []
        return Group(two_columns(self.answer.robot.name or "robot", lines), *texts)

    def _ways(self, reached: Sequence[InverseSolution]) -> list[tuple[str, str]]:
        """What is known of how the robot gets from one answer, or from home, to the next."""
        if not self.answer.followed:
            known = sum(s.way is not None for s in reached)
            return [("a way without a snap", f"known to {known} of {len(reached)}")] if reached else []
        between = len(self.answer.rows) - len(self._given())
        leaping = sum(bool(r.solution and r.solution.leaps) for r in self.answer.rows)
        lines = [("put in between", f"{between} targets, so that the robot does not leap")] if between else []
        return [*lines, ("leaps", f"{leaping or 'none'}, of {len(self.answer.rows)} rows")]

    def save(self, directory: Path) -> list[Path]:
        """Write solutions.csv: a row per target, empty cells where there is no answer."""
        turns, shifts = joint_columns(self.answer.robot.n_tubes)
        tips = [f"tip_{name}" for name in POSITION]
        columns = ["target", *POSITION, *DIRECTION, *turns, *shifts, *tips]
        columns += ["position_error_mm", "direction_error_deg", "margin", "reachable", "leaps", "status", "problem"]
        path = directory / "solutions.csv"
        write_text(path, to_csv(columns, self._cells(len(turns) + len(shifts) + len(tips))))
        return [path]

    def _cells(self, answers: int) -> Iterator[Sequence[object]]:
        for r in self.answer.rows:
            target: list[object] = [f"{r.number:g}", *(in_unit(float(x), MM_UNIT) for x in r.position)]
            target += ["", "", ""] if r.direction is None else [float(x) for x in r.direction]
            s = r.solution
            if s is None:
                yield [*target, *[""] * (answers + 5), "FAILED", f'"{r.problem}"']
                continue
            joints = _joints(s.rotations, s.translations)
            tip = [round(float(x), 9) + 0.0 for x in s.equilibrium.tip_position * MM]
            turned = "" if r.direction is None else float(np.degrees(s.direction_error))
            known = {True: "yes", False: "no", None: ""}[s.reachable]
            leaps = f'"{s.leaps}"' if s.leaps else ""
            errors = [s.position_error * MM, turned, s.margin]
            yield [*target, *joints, *tip, *errors, known, leaps, s.status.name, ""]

    def draw(self, directory: Path) -> list[Path]:
        """Write targets.png: the arm along the targets that were reached."""
        reached = self._reached()
        if len(reached) < 2:
            return []
        from ..show.plots.inverse import plot_targets  # Matplotlib takes longer to load than a solve

        path = directory / "targets.png"
        with atomic_write(path) as temporary:
            plot_targets(reached, temporary)
        return [path]


def _missing(r: Row) -> dict[str, Any]:
    direction = None if r.direction is None else r.direction.tolist()
    return {"target_mm": (r.position * MM).tolist(), "target_direction": direction, "status": "FAILED"}


def _why(r: Row) -> str:
    if r.solution is None:
        return r.problem
    return _miss(r.solution)


def _miss(s: InverseSolution) -> str:
    held = ", ".join(s.active)
    return f"{s.position_error * MM:.4g} mm short{f': {held}' if held else ''}"


@report.register
def _(answer: Postures) -> PosturesReport:
    return PosturesReport(answer)


@report.register
def _(answer: TargetTable) -> TargetTableReport:
    return TargetTableReport(answer)
