"""Reports on a design, and on two robots that were sized together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import RenderableType
from rich.text import Text

from ..bodies.frames import Frame, roll_of
from ..design.objectives import AnyObjective, key_of, shown
from ..design.optimize import DesignSolution, FrontPoint, ParetoFront
from ..design.sensitivities import Dimension, Sensitivity
from ..design.stock import Candidate
from ..design.tolerance import ToleranceAnalysis
from ..design.verify import Check
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..files.csv_file import to_csv
from ..files.files import write_text
from ..files.units import TO_MM
from ..planning import PairFraction, ReachFraction
from ..robots.concentric import ConcentricRobot
from ..robots.file import save_robot
from ..runs.design_parts import RegionAnswer
from ..runs.design_study import DesignAnswer, PairAnswer
from ..runs.real_robot import DesignBounds
from ..typing import Array
from .formatting import at_least
from .quantities import Quantity, columns, described, line, of_field, within
from .report import Drawing, Report, drawing, file_name, grid
from .snap_report import JOINTS

STOCK_ROWS = 12
"""Choices from stock that are listed one by one."""

MAP_SAMPLES, MAP_DIRECTIONS = 20, 60
"""Points per axis of the stability maps before and after."""

CAPTIONS = {
    "shapes": "The robot before and after, at home with all tubes to one side.",
    "poses": "The design in its task poses, from two sides.",
    "maps": "Margin over the rotations of the two inner tubes at home, before and after.",
    "pareto": "What margin costs.",
    "tolerance": "The certificate of robots as they may be made.",
}

DIMENSION = described(
    Dimension,
    of_field(Dimension, "name", label="", text=lambda d: f"{d.name} ({d.unit})" if d.unit else d.name),
    "unit before after",
    Quantity(
        "bound", "active bound, `lower` or `upper`", lambda d: d.bound or None, label="", text="at its {bound} bound"
    ),
)

BINDING = described(
    Sensitivity,
    Quantity("limit", "requirement, as text", lambda sensitivity: sensitivity.limit.description),
    Quantity("value", "limit value", lambda sensitivity: sensitivity.limit.value * sensitivity.limit.factor),
    Quantity("unit", "unit of the limit", lambda sensitivity: sensitivity.limit.unit),
    "derivative sentence",
)

POSE = described(
    Equilibrium,
    *JOINTS,
    Quantity("tip_position_mm", "tip position in the frame of the plate"),
    "margin",
)

CHECK = described(
    Check,
    "what value",
    of_field(Check, "satisfied", label="", text=lambda check: "satisfied" if check.satisfied else "VIOLATED"),
)


def _snap_free_text(t: ToleranceAnalysis) -> str:
    """Fraction of sampled robots that stay snap-free, as text."""
    low, high = t.interval
    fraction = f"{100 * t.snap_free:.1f} % of {len(t.certificate)} samples stay snap-free"
    return f"{fraction} (95 %: {100 * low:.1f} to {100 * high:.1f} %)"


def _spread_text(t: ToleranceAnalysis) -> str | None:
    """Spread of the tips of sampled robots, as text."""
    if not len(t.spread):
        return None
    return f"RMS up to {t.spread.max() * TO_MM:.3f} mm, 95 % within {t.spread_95.max() * TO_MM:.3f} mm"


TOLERANCE = described(
    ToleranceAnalysis,
    Quantity("samples", "number of sampled robots within the tolerances", lambda t: len(t.certificate)),
    ...,
)

FRONT_POINT: tuple[Quantity[tuple[ParetoFront, FrontPoint]], ...] = (
    Quantity("margin", "required margin", lambda item: item[1].margin),
    Quantity("value", "value of the objective", lambda item: item[1].objective * item[0].task.objectives[0].factor),
)

FRONT = described(
    ParetoFront,
    "objective",
    Quantity("unit", "unit of the objective", lambda front: front.task.objectives[0].unit),
    Quantity(
        "points", "points of the trade-off", lambda front: [(front, point) for point in front.points], of=FRONT_POINT
    ),
    "ended",
)

REGION = described(
    RegionAnswer,
    Quantity(
        "searched_before",
        "fraction of the places of the search that the given robot reaches",
        lambda r: r.search.before,
    ),
    Quantity(
        "searched_after", "fraction of the places of the search that the design reaches", lambda r: r.search.after
    ),
    Quantity("tried", "number of designs evaluated", lambda r: r.search.tried),
    Quantity("places", "number of independent places for the evaluation", lambda r: len(r.after.targets)),
    Quantity("before", "lower bound on the fraction of them that the given robot reaches", lambda r: r.before.fraction),
    Quantity("after", "lower bound on the fraction of them that the design reaches", lambda r: r.after.fraction),
    "planned proved",
    Quantity("base_mm", "position of the plate in the frame of the given plate", lambda r: r.base.origin),
    Quantity(
        "base_direction",
        "direction of the arm at the plate in the frame of the given plate",
        lambda r: r.base.axes[:, 2],
    ),
)

SEARCHED: tuple[Quantity[RegionAnswer], ...] = (
    line("search", lambda r: f"{r.search.tried} designs evaluated; no optimum is claimed"),
    line("plans", lambda r: f"{r.proved} of {r.planned} to places that are reached are proved"),
    line("plate", lambda r: "moved by {:.2f}, {:.2f}, {:.2f} mm".format(*r.base.origin * TO_MM)),
)


def _starts_text(s: DesignSolution) -> str:
    """Numbers of starts, feasible and failed, as text."""
    failed = ", ".join(f"{count} at the {name}" for name, count in s.ranking.failures.items())
    return f"{s.ranking.starts}, {sum(s.ranking.found)} feasible" + f" ({failed})" * bool(failed)


def _poses_text(s: DesignSolution) -> str | None:
    """Number of task poses and their smallest margin, as text."""
    return f"{len(s.equilibria)}, least margin {min(e.margin for e in s.equilibria):.4f}" if s.equilibria else None


SOLUTION = described(
    DesignSolution,
    Quantity("task", "name of the task", lambda s: s.task.name),
    Quantity("robot", "name of the robot", lambda s: s.robot.name),
    of_field(DesignSolution, "certificate", label="certificate",
             text="{certificate:.6f}, a lower bound of the margin at all rotations"),
    of_field(DesignSolution, "dimensions", of=DIMENSION),
    of_field(DesignSolution, "sensitivities", of=BINDING),
    of_field(DesignSolution, "equilibria", label="task poses", text=_poses_text, of=POSE),
    Quantity("checks", "independent checks of the result", lambda s: s.verification.checks, of=CHECK),
    Quantity("starts", "number of starts", lambda s: s.ranking.starts, label="starts", text=_starts_text),
    Quantity("designs", "number of distinct designs found", lambda s: len(s.ranking.designs)),
    Quantity("failures", "number of failed starts, by stage", lambda s: s.ranking.failures),
    of_field(DesignSolution, "rounds", label="worst cases added", text="in {rounds} rounds"),
    "seconds",
)  # fmt: skip

CHOICE: tuple[Quantity[tuple[AnyObjective, Candidate]], ...] = (
    Quantity("sizes", "sizes, inner to outer", lambda c: [size.name for size in c[1].sizes], label="inner to outer",
             text=lambda c: ", ".join(size.name for size in c[1].sizes)),
    Quantity("value", "value of the objective", lambda c: c[1].objective and c[1].objective * c[0].factor,
             label="value",
             text=lambda c: "–" if c[1].objective is None else f"{c[1].objective * c[0].factor:.5g} {c[0].unit}"),
    Quantity("status", "design, not found, infeasible, pruned or out of time, with the reason", lambda c: c[1].status,
             label="", text="{status}"),
)  # fmt: skip
"""Quantities of a choice from stock, with the objective that ranks it."""

REAL_DESIGN: tuple[Quantity[DesignBounds], ...] = (
    Quantity("probabilities", "probabilities of the bounds on the real robot; absent without posterior", optional=True),
    Quantity("real_certificate", "the certificate of the real robot is at least this; null without",
             lambda real: real.certificate, optional=True),
    Quantity("real_margin", "its margin at the task poses and on required paths is at least this; null without poses",
             lambda real: real.margin, optional=True),
    Quantity("real_clearance_mm", "its distance from bodies at the task poses is at least this; null without",
             lambda real: real.clearance, optional=True),
    Quantity("real_tip_radius_mm", "its tip is within this distance of the calibrated one at targets; null without",
             lambda real: real.tip, optional=True),
)  # fmt: skip


def _real_text(real: DesignBounds | None) -> str | None:
    """Bounds on the real robot, as text."""
    if real is None:
        return None
    parts = (
        ("certificate at least {:.4f}", real.certificate, 1.0),
        ("margin at least {:.4f}", real.margin, 1.0),
        ("clearance at least {:.2f} mm", real.clearance, TO_MM),
        ("tip within {:.2f} mm", real.tip, TO_MM),
    )
    each = [
        f"{100 * p:g} %: " + ", ".join(text.format(factor * x[k]) for text, x, factor in parts if x is not None)
        for k, p in enumerate(real.probabilities)
    ]
    return "; ".join(each) + " (estimated)" if any(x is not None for _, x, _ in parts) else None


DESIGN = described(
    DesignAnswer,
    *within(SOLUTION, lambda a: a.solution),
    Quantity("objectives", "objectives with their units", lambda a: _objectives(a)),
    Quantity(
        "remarks",
        "active limits, tubes with little effect, a coarse search",
    ),
    of_field(DesignAnswer, "tolerance", of=TOLERANCE),
    of_field(DesignAnswer, "front", of=FRONT),
    of_field(DesignAnswer, "region", of=REGION),
    *within((line("as manufactured", _snap_free_text), line("tip spread", _spread_text)), lambda a: a.tolerance),
    *within(SEARCHED, lambda a: a.region),
    *within(REAL_DESIGN, lambda a: a.real),
    line("real robot", lambda a: _real_text(a.real)),
    Quantity("stock", "choices from stock, best first; null unless requested", lambda a: _choices(a), of=CHOICE,
             label="from stock", text=lambda a: _best_text(a)),
    line("seconds", "{seconds:.1f}"),
)  # fmt: skip


def _best_text(a: DesignAnswer) -> str | None:
    """Sizes of the best choice from stock, as text; None without one."""
    if a.stock is None or a.stock.best is None:
        return None
    return f"{', '.join(size.name for size in a.stock.best.sizes)} (of {len(a.stock.candidates)} choices)"


def _choices(a: DesignAnswer) -> list[tuple[AnyObjective, Candidate]] | None:
    """Objective and candidate of every choice from stock, best first; None unless requested."""
    objective = a.solution.task.objectives[0]
    return None if a.stock is None else [(objective, candidate) for candidate in a.stock.candidates]


def dimensions(s: DesignSolution, of: str = "") -> RenderableType:
    """Free dimensions: before, after, and the active bound."""
    return grid(*columns(s.dimensions, DIMENSION), title=f"dimensions{of}", key=True)


def checked_again(s: DesignSolution) -> RenderableType:
    """Required values, and values computed by independent code."""
    return grid(*columns(s.verification.checks, CHECK), title="checked again by other code", key=True)


def before_after(s: DesignSolution, name: str) -> Drawing:
    """Picture of the shapes before and after the design, at home; name: heading."""
    home = [forward_kinematics(robot, np.zeros(robot.n_tubes)) for robot in (s.task.robot, s.robot)]
    return drawing("shape.plot_shapes", home, titles=("before", "after"), heading=name)


class DesignReport(Report[DesignAnswer]):
    command = "design"
    quantities = DESIGN
    file = "design.json"

    def title(self) -> str:
        return self.answer.solution.robot.name or "design"

    def rows(self) -> list[tuple[str, str]]:
        """Rows (name, text) of the table: the objectives, then the answer in short."""
        s, region = self.answer.solution, self.answer.region
        values = [shown(objective, s.objectives[key_of(objective)]) for objective in s.task.objectives]
        return [("objective", text) for text in (values if region is None else [region.summary])] + super().rows()

    def below(self) -> list[RenderableType]:
        """Dimensions, active limits with their sensitivities, checks, and choices from stock."""
        s = self.answer.solution
        parts: list[RenderableType] = [dimensions(s)]
        parts += [Text(f"  {remark}") for remark in self.answer.remarks]
        if s.sensitivities:
            parts.append(Text("what binds, and what easing it would buy", style="italic"))
            parts += [Text(f"  {sensitivity.sentence}") for sensitivity in s.sensitivities]
        parts.append(checked_again(s))
        if self.answer.stock is not None:
            parts.append(grid(*self.from_stock(), title="choices from stock", key=True))
        return parts

    def from_stock(self) -> tuple[list[str], list[list[str]]]:
        """Heads and rows of the choices, best first, and the numbers of further choices by status."""
        choices = _choices(self.answer) or []
        heads, rows = columns(choices[:STOCK_ROWS], CHOICE)
        counts = {
            "design": "worse designs",
            "not found": "without a design",
            "infeasible": "infeasible",
            "pruned": "pruned by their bound",
            "out of time": "not tried in time",
        }
        for status, text in counts.items():
            # A status may end in its reason: the beginning names the kind.
            count = sum(candidate.status.startswith(status) for _, candidate in choices[STOCK_ROWS:])
            rows += [[f"{count} more", "–", text]] if count else []
        return heads, rows

    def save(self, directory: Path) -> list[Path]:
        """Write the robot, design.json and the page report.md."""
        robot, page = directory / "robot.yaml", directory / "report.md"
        save_robot(self.answer.solution.robot, robot)
        write_text(page, self.page())
        return [robot, self.save_record(directory), page]

    def pictures(self) -> dict[str, Drawing]:
        """Pictures of the design; `CAPTIONS` describes them."""
        a, s = self.answer, self.answer.solution
        name = self.title()
        pictures: dict[str, Drawing] = {"shapes": before_after(s, name)}
        if s.equilibria:
            pictures["poses"] = drawing("design.plot_poses", s)
        # Two tubes have a single relative rotation: a map over two would show nothing more.
        if s.robot.n_tubes > 2 and isinstance(s.robot, ConcentricRobot):
            pictures["maps"] = lambda path=None: _draw_maps((s.task.robot, s.robot), path)
        if a.front is not None:
            pictures["pareto"] = drawing("design.plot_front", a.front)
        if a.tolerance is not None:
            pictures["tolerance"] = drawing("design.plot_tolerance", a.tolerance, heading=name)
        return pictures

    def page(self) -> str:
        """The report as Markdown, with its pictures."""
        s = self.answer.solution
        lines = [f"# {s.robot.name or 'Design'}", ""]
        lines += _markdown(("", ""), self.rows())
        lines += ["", "## Dimensions", "", *_markdown(*columns(s.dimensions, DIMENSION))]
        remarks = self.answer.remarks
        lines += ["", *(f"- {remark}" for remark in remarks)] if remarks else []
        lines += ["", "## Requirements that bind", ""]
        rows = [(o.limit.description, o.limit.shown(), o.sentence) for o in s.sensitivities]
        lines += _markdown(("limit", "at", "price"), rows) if rows else ["None."]
        lines += ["", "## Checked again", ""]
        lines += _markdown(
            ("requirement", "value", "satisfied"),
            [(c.what, c.value, "yes" if c.satisfied else "no") for c in s.verification.checks],
        )
        if self.answer.stock is not None:
            lines += ["", "## Choices from stock", "", *_markdown(*self.from_stock())]
        lines += ["", "## Pictures", ""]
        for name in self.pictures():
            lines += [f"![{CAPTIONS[name]}]({file_name(name)})", "", f"*{CAPTIONS[name]}*", ""]
        return "\n".join(lines) + "\n"


def _draw_maps(robots: Sequence[Any], path: Path | None) -> Any:
    """Draw stability maps before and after the design; they are computed only here, since this takes long."""
    from ..stability import stability_map
    from .plots.design import plot_before_after

    before, after = (
        stability_map(robot, samples=MAP_SAMPLES, directions=MAP_DIRECTIONS, workers=1) for robot in robots
    )
    return plot_before_after((before, after), path, heading=robots[1].name)


def _objectives(a: DesignAnswer) -> dict[str, float]:
    """Values of the objectives, by key with unit; for a region, the fraction that the design reaches."""
    if a.region is not None:
        return {"reach_share": a.region.after.fraction}
    values = {}
    for objective in a.solution.task.objectives:
        unit = {"1/m": "_per_m", "mm": "_mm", "%": "_percent"}.get(objective.unit, "")
        key = key_of(objective)
        values[f"{key}{unit}"] = a.solution.objectives[key] * objective.factor
    return values


def _markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table in Markdown."""
    lines = [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}"]
    return lines + [f"| {' | '.join(row)} |" for row in rows]


@dataclass(frozen=True, eq=False)
class _Arm:
    """Robot of a pair."""

    number: int
    """Number of the arm, from 1."""
    name: str
    solution: DesignSolution
    plate: Frame
    """Frame of its plate."""
    before: ReachFraction
    """Places that the given robot reaches alone."""
    after: ReachFraction
    """Places that the design reaches alone."""


def _arms(a: PairAnswer) -> list[_Arm]:
    """Both robots of a pair."""
    fields = zip(a.names, a.search.solutions, a.plates, a.before.reached, a.after.reached, strict=True)
    return [_Arm(number, *of_arm) for number, of_arm in enumerate(fields, start=1)]


def _percent(fraction: float) -> str:
    return f"{100 * fraction:.0f} %"


def _reach_text(a: PairAnswer) -> str:
    """Fractions of targets that each arm reaches alone, as text."""
    return "; ".join(
        f"{arm.name} {_percent(arm.before.fraction)} before, {_percent(arm.after.fraction)} after" for arm in _arms(a)
    )


def _plates_text(a: PairAnswer) -> str:
    """Positions and directions of the plates, as text."""
    plates = []
    for arm in _arms(a):
        (x, y, z), (u, v, w) = arm.plate.origin * TO_MM, arm.plate.axes[:, 2]
        plates.append(f"{arm.name} at {x:.2f}, {y:.2f}, {z:.2f} mm along {u:.3f}, {v:.3f}, {w:.3f}")
    return "; ".join(plates)


ARM: tuple[Quantity[_Arm], ...] = (
    Quantity("number", "number of the arm, from 1"),
    Quantity("name", "name of the arm"),
    Quantity("position_mm", "position of its plate in the shared frame", lambda a: a.plate.origin),
    Quantity("direction", "direction of the arm at its plate, in the shared frame", lambda a: a.plate.axes[:, 2]),
    Quantity("roll_deg", "rotation of its plate about that direction, as in `base`", lambda a: roll_of(a.plate)),
    Quantity(
        "reached_before", "fraction of the places that the given robot reaches alone", lambda a: a.before.fraction
    ),
    Quantity("reached_after", "fraction of the places that the design reaches alone", lambda a: a.after.fraction),
    Quantity("certificate", "lower bound on its margin at all rotations", lambda a: a.solution.certificate),
    Quantity("dimensions", "free dimensions", lambda a: a.solution.dimensions, of=DIMENSION),
    Quantity("checks", "independent checks of the result", lambda a: a.solution.verification.checks, of=CHECK),
)

PAIR = described(
    PairAnswer,
    Quantity("wanted", "the objective", lambda a: a.search.objective),
    Quantity("searched_before", "fraction of the pairs of places of the search, given robots",
             lambda a: a.search.before),
    Quantity("searched_after", "fraction of the pairs of places of the search, designs", lambda a: a.search.after),
    Quantity("tried", "number of pairs of robots evaluated", lambda a: a.search.tried,
             text="{tried}; no optimum is claimed", label="pairs of robots evaluated"),
    Quantity("places", "number of independent places for the evaluation", lambda a: len(a.after.apart)),
    Quantity("before", "fraction of their pairs that the given robots reach", lambda a: a.before.fraction),
    Quantity("after", "fraction of their pairs that the designs reach", lambda a: a.after.fraction),
    line("pairs of places reached", lambda a: f"{_percent(a.before.fraction)} before, "
         f"{_percent(a.after.fraction)} after, of {len(a.after.apart)} places not searched with"),
    line("reached by itself", _reach_text),
    Quantity("clearance_mm", "clearance between the arms", lambda a: a.after.clearance),
    "planned",
    of_field(PairAnswer, "proved", label="proved", text="{proved} of {planned} motions of both arms to such pairs"),
    line("plates", _plates_text),
    Quantity("arms", "the two arms", _arms, of=ARM),
    Quantity("remarks", "active limits, tubes with little effect, a coarse search"),
    Quantity("seconds", "run time of the search, s", lambda a: a.search.seconds, form=".1f",
             label="run time of the search"),
)  # fmt: skip


def pairs_of_places(reach: PairFraction, places: Sequence[Array]) -> str:
    """CSV of all pairs of targets: both positions, lower bound on the distance of the arms, 1 if reached.

    places: positions (3,) in the frame that both share, mm.
    """
    columns = [f"{axis}{k}_mm" for k in (1, 2) for axis in "xyz"]
    rows = []
    # Off the diagonal, since the two tips cannot be at the same place.
    for i, j in np.argwhere(~np.eye(len(reach.apart), dtype=bool)):
        distance = reach.apart[i, j]
        bound = "" if np.isnan(distance) else float(at_least(distance))
        rows.append([*map(float, [*places[i], *places[j]]), bound, int(reach.held[i, j])])
    return to_csv([*columns, "apart_at_least_mm", "held"], rows)


class PairReport(Report[PairAnswer]):
    command = "design-pair"
    quantities = PAIR
    file = "design_pair.json"

    def title(self) -> str:
        return " and ".join(self.answer.names)

    def below(self) -> list[RenderableType]:
        """Dimensions and verification of each arm, and the remarks."""
        parts: list[RenderableType] = []
        for arm in _arms(self.answer):
            parts += [dimensions(arm.solution, f" of {arm.name}"), checked_again(arm.solution)]
        return [*parts, *(Text(f"  {remark}") for remark in self.answer.remarks)]

    def save(self, directory: Path) -> list[Path]:
        """Write arm_1/robot.yaml and arm_2/robot.yaml, the pairs of targets, and design_pair.json."""
        a, paths = self.answer, list[Path]()
        for arm in _arms(a):
            paths.append(directory / f"arm_{arm.number}" / "robot.yaml")
            save_robot(arm.solution.robot, paths[-1])
        paths.append(directory / "pairs.csv")
        # Targets are known in the frame of the first plate; both arms share the frame outside of it.
        places = a.plates[0].placed(a.after.reached[0].targets) * TO_MM
        write_text(paths[-1], pairs_of_places(a.after, list(places)))
        return [*paths, self.save_record(directory)]

    def pictures(self) -> dict[str, Drawing]:
        """Pictures of the satisfied pairs before and after, their positions, and the shapes of each arm."""
        a = self.answer
        shares, places = (a.before, a.after), a.plates[0].placed(a.after.reached[0].targets)
        pictures: dict[str, Drawing] = {
            "pairs": drawing("design.plot_pair_fractions", shares, names=a.names),
            "places": drawing("design.plot_pair_places", shares, names=a.names, places=places),
        }
        for arm in _arms(a):
            pictures[f"arm_{arm.number}_shapes"] = before_after(arm.solution, arm.name)
        return pictures
