"""Reports of inverse kinematics: for one target, and for a table of targets."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Group, RenderableType
from rich.text import Text

from ..equilibrium.file import save_equilibrium
from ..equilibrium.readings import to_readings
from ..equilibrium.result import Equilibrium
from ..errors import SolveError
from ..files.csv_file import to_csv
from ..files.files import write_text
from ..files.units import MM, TO_MILLI, TO_MM, in_unit
from ..inverse import InverseSolution
from ..robots.file import joint_cells, joint_columns, waypoints_csv
from ..runs.inverse_study import DIRECTION, POSITION, Postures, Row, TargetTable
from .formatting import counted, degrees, millimetres, row, tip_number, tip_text
from .quantities import SNAP_DISTANCE, Quantity, described, line, of_field, readings, rows, within
from .report import Drawing, Report, drawing, grid, two_columns

NOTES = 10
"""Largest number of listed notes on targets; further notes are counted."""

CONVERGED_ERROR = 1e-2
"""Error (mm or deg) below which a solve has converged: targets are reached to 1e-6 mm, and misses are larger."""

SOLUTION = described(
    InverseSolution,
    "target_position target_direction",
    Quantity("status", "result of the search", lambda s: s.status.name),
    of_field(InverseSolution, "rotations", form="", label="rotations", text=lambda s: degrees(s.rotations, ".6f")),
    of_field(InverseSolution, "translations", form="", label="translations",
             text=lambda s: millimetres(s.translations, ".4f")),
    *readings(lambda s: s.equilibrium),
    Quantity("tip_position_mm", "tip position in the frame of the plate", lambda s: s.equilibrium.tip_position,
             form=".6f", label="tip position"),
    Quantity("tip_tube",
             "number of the tube at the tip: the one that ends farthest from the plate, of several the innermost; "
             "null if all are withdrawn", lambda s: tip_number(s.equilibrium), label="the tip is",
             text=lambda s: tip_text(s.equilibrium.robot, s.equilibrium.tube_end) or None),
    of_field(InverseSolution, "position_error", label="misses by",
             text=lambda s: f"{_error(s.position_error * TO_MM)} mm"),
    Quantity("tip_direction", "direction of the tip", lambda s: s.equilibrium.tip_rotation[:, 2], form=".4f",
             label="pointing along"),
    Quantity("direction_error_deg", "angle between the tip and its target direction",
             lambda s: None if s.target_direction is None else s.direction_error, label="off the direction by",
             text=lambda s: None if s.target_direction is None else f"{_error(np.degrees(s.direction_error))} deg"),
    of_field(InverseSolution, "margin", form=".3f", label="margin"),
    *within(SNAP_DISTANCE, lambda s: s.equilibrium),
    Quantity("clearance_mm", "distance of the arm from obstacles", label="clear of obstacles by",
             text=lambda s: f"{s.clearance * TO_MM:.4f} mm" if np.isfinite(s.clearance) else None),
    Quantity("clearance_from",
             "reference of that distance, for obstacles that are points or open surfaces; absent otherwise",
             lambda s: s.scene.stands_for or None, optional=True, label="clearance from",
             text=lambda s: "; ".join(s.scene.stands_for) or None),
    Quantity("energy_mJ", "elastic energy", lambda s: s.equilibrium.energy),
    "cold_start_agrees straight_from_seed reachable",
    of_field(InverseSolution, "path", label="snap-free path", text=lambda s: _path_text(s)),
    "jump",
    of_field(InverseSolution, "active", label="limited by", text=lambda s: ", ".join(s.active) or None),
    Quantity("statistics", "starts, iterations and time", lambda s: asdict(s.statistics), label="solved",
             text=lambda s: _solver_text(s)),
)  # fmt: skip


def _error(value: float) -> str:
    """Text of an error in mm or deg: only the magnitude of round-off, more digits of a miss."""
    return f"{value:.4f}" if value >= CONVERGED_ERROR else f"{value:.1e}"


def _path_text(s: InverseSolution) -> str:
    """Snap-free path to the solution, as text."""
    if s.path is not None:
        count = len(s.path.rotations) - 2
        course = f"through {counted(count, 'waypoint')}" if count else "straight"
        return f"{course} from {'home' if s.path.origin == 'home' else f'the {s.path.origin}'}"
    return "none was found" if s.reachable is False else "none is known"


def _solver_text(s: InverseSolution) -> str:
    """Time, method and starts of the search, as text."""
    used = s.statistics
    starts = counted(used.tries, "start")
    return f"in {used.seconds * TO_MILLI:.1f} ms by {used.method}, {starts}, from the {used.start}"


POSTURES = described(
    Postures,
    Quantity("robot", "name of the robot", lambda a: a.robot.name),
    of_field(Postures, "solutions", of=SOLUTION),
    "timed_out",
)


class PosturesReport(Report[Postures]):
    command = "ik"
    quantities = POSTURES
    file = "solutions.json"
    drawn = (("inverse", "workspace.plot_inverse", "solutions"),)

    def table(self) -> Group:
        """Best solution, and a row for each other posture."""
        best, *alternatives = self.answer.solutions
        parts: list[Any] = [two_columns(f"{super().title()}: {best.status}", rows(best, SOLUTION))]
        if alternatives:
            cells = [
                (
                    row(np.degrees(s.rotations), ".2f"),
                    row(s.translations * TO_MM, ".2f"),
                    f"{s.margin:.3f}",
                    f"{s.equilibrium.energy * TO_MILLI:.3f}",
                )
                for s in alternatives
            ]
            parts.append(Text(f"\nother postures with the same tip: {len(alternatives)}"))
            parts.append(grid(("rotations (deg)", "translations (mm)", "margin >", "mJ >"), cells))
        if self.answer.timed_out:
            parts.append(Text("\nthe time limit ended the search: there may be more postures, and paths to them"))
        return Group(*parts)

    def save(self, directory: Path) -> list[Path]:
        """Write solutions.json, result.json and arrays.npz of the best solution, and path.csv if a path to it is known.

        The waypoints of path.csv are readings of the drives for a calibrated robot; `tubeopt follow` reads them.
        """
        best = self.answer.solutions[0]
        paths = [self.save_record(directory), *save_equilibrium(best.equilibrium, directory)]
        if best.path is not None:
            paths.append(directory / "path.csv")
            readings = to_readings(self.answer.robot, best.path.rotations, best.path.translations)
            write_text(paths[-1], waypoints_csv(*readings))
        return paths

    def solids(self) -> dict[str, Equilibrium]:
        return {"arm": self.answer.solutions[0].equilibrium}

    def conclude(self) -> None:
        """Raise SolveError if the target is missed."""
        best = self.answer.solutions[0]
        if not best.reached:
            raise SolveError(f"{best.status}: {_miss(best)}", best)


TARGET_QUANTITIES = described(
    Row,
    "position direction",
    Quantity("status", "result of the search", lambda r: "FAILED" if r.solution is None else r.solution.status.name),
)
"""Quantities of a target that exist without a solution."""

ROW = described(
    Row,
    "number",
    *TARGET_QUANTITIES,
    # The target is known without a solution, so that its keys come from the row.
    *within([q for q in SOLUTION if q.key not in {target.key for target in TARGET_QUANTITIES}], lambda r: r.solution),
    "problem",
)

TARGETS = described(
    TargetTable,
    Quantity("robot", "name of the robot", lambda a: a.robot.name),
    Quantity("targets", "number of targets in the table", lambda a: len(_requested(a))),
    Quantity(
        "reached",
        "number of targets reached",
        lambda a: len(_reached(a)),
        text="{reached} of {targets} targets",
        label="reached",
    ),
    line("largest error", lambda a: _of_reached(a, lambda s: f"{max(x.position_error for x in s) * TO_MM:.1e} mm")),
    line("least margin", lambda a: _of_reached(a, lambda s: f"{min(x.margin for x in s):.3f}")),
    line(
        "median time",
        lambda a: _of_reached(
            a, lambda s: f"{np.median([x.statistics.seconds for x in s]) * TO_MILLI:.1f} ms per target"
        ),
    ),
    line(
        "snap-free path",
        lambda a: (
            None
            if a.followed
            else _of_reached(a, lambda s: f"known to {sum(x.path is not None for x in s)} of {len(s)}")
        ),
    ),
    line("put in between", lambda a: _inserted_text(a)),
    line("jumps", lambda a: _jumps_text(a)),
    of_field(TargetTable, "rows", of=ROW),
)


def _requested(a: TargetTable) -> list[Row]:
    """Rows of the targets that are in the table, without inserted targets."""
    return [r for r in a.rows if not r.inserted]


def _reached(a: TargetTable) -> list[InverseSolution]:
    """Solutions of requested targets that are reached."""
    return [r.solution for r in _requested(a) if r.solution is not None and r.solution.reached]


def _of_reached(a: TargetTable, text: Callable[[list[InverseSolution]], str]) -> str | None:
    """Text on the reached targets; None without any."""
    reached = _reached(a)
    return text(reached) if reached else None


def _inserted_text(a: TargetTable) -> str | None:
    """Number of inserted targets, as text; None without any."""
    count = len(a.rows) - len(_requested(a))
    return f"{count} targets, so that the robot does not jump" if a.followed and count else None


def _jumps_text(a: TargetTable) -> str | None:
    """Number of rows with a jump, as text; None if rows are solved one by one."""
    jumps = sum(bool(r.solution and r.solution.jump) for r in a.rows)
    return f"{jumps or 'none'}, of {len(a.rows)} rows" if a.followed else None


def _miss(s: InverseSolution) -> str:
    """Distance from the target, and the active constraints, as text."""
    active = ", ".join(s.active)
    return f"{s.position_error * TO_MM:.4g} mm short{f': {active}' if active else ''}"


def _failure(r: Row) -> str:
    """Reason why a target of a table was not reached."""
    return r.problem if r.solution is None else _miss(r.solution)


class TargetTableReport(Report[TargetTable]):
    command = "ik --targets"
    quantities = TARGETS

    def below(self) -> list[RenderableType]:
        """Reasons why targets were not reached, and jumps."""
        notes = [(r, _failure(r)) for r in _requested(self.answer) if r.solution is None or not r.solution.reached]
        notes += [(r, f"jumps: {r.solution.jump}") for r in self.answer.rows if r.solution and r.solution.jump]
        more = [Text(f"and {len(notes) - NOTES} more")] if len(notes) > NOTES else []
        return [*(Text(f"target {r.number:g}: {note}") for r, note in notes[:NOTES]), *more]

    def save(self, directory: Path) -> list[Path]:
        """Write solutions.csv: a row per target, with empty cells for missing answers."""
        turns, shifts = joint_columns(self.answer.robot.n_tubes)
        tips = [f"tip_{name}" for name in POSITION]
        columns = ["target", *POSITION, *DIRECTION, *turns, *shifts, *tips]
        columns += ["position_error_mm", "direction_error_deg", "margin", "reachable", "jump", "status", "problem"]
        path = directory / "solutions.csv"
        write_text(path, to_csv(columns, self._cells(len(turns) + len(shifts) + len(tips))))
        return [path]

    def _cells(self, answers: int) -> Iterator[Sequence[object]]:
        for r in self.answer.rows:
            # Targets in between have fractional numbers, as 3.5.
            target: list[object] = [f"{r.number:g}", *(in_unit(float(x), MM) for x in r.position)]
            target += ["", "", ""] if r.direction is None else [float(x) for x in r.direction]
            s = r.solution
            if s is None:
                yield [*target, *[""] * (answers + 5), "FAILED", f'"{r.problem}"']
                continue
            joints = joint_cells(*to_readings(s.equilibrium.robot, s.rotations, s.translations))
            tip = [round(float(x), 9) + 0.0 for x in s.equilibrium.tip_position * TO_MM]
            direction_error = "" if r.direction is None else float(np.degrees(s.direction_error))
            reachable = {True: "yes", False: "no", None: ""}[s.reachable]
            jump = f'"{s.jump}"' if s.jump else ""
            errors = [s.position_error * TO_MM, direction_error, s.margin]
            yield [*target, *joints, *tip, *errors, reachable, jump, s.status.name, ""]

    def pictures(self) -> dict[str, Drawing]:
        reached = _reached(self.answer)
        # One target has no path to be drawn.
        return {"targets": drawing("workspace.plot_targets", reached)} if len(reached) > 1 else {}

    def conclude(self) -> None:
        """Raise SolveError if every target is missed; single misses are named in the table."""
        requested = _requested(self.answer)
        if not _reached(self.answer):
            raise SolveError(f"none of {len(requested)} targets was reached; the first: {_failure(requested[0])}")
