"""What is said and saved about two robots that were sized together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import RenderableType
from rich.text import Text

from ..bodies.frames import Frame, roll_of
from ..design.optimize import DesignSolution
from ..files.csv_file import to_csv
from ..files.files import write_text
from ..files.units import TO_MM
from ..planning import PairShare, ReachShare
from ..robots.file import save_robot
from ..runs.design_study import PairAnswer
from ..typing import Array
from .design_report import CHECK, DIMENSION, before_after, checked_again, dimensions
from .formatting import at_least
from .quantities import Quantity, described, line, of_field
from .report import Drawing, Report, drawing


@dataclass(frozen=True, eq=False)
class _Arm:
    """One of the two: its number, from 1, its design, where it stands, and what it reaches by itself."""

    number: int
    name: str
    solution: DesignSolution
    plate: Frame
    before: ReachShare
    after: ReachShare


def _arms(a: PairAnswer) -> list[_Arm]:
    each = zip(a.names, a.search.solutions, a.plates, a.before.reached, a.after.reached, strict=True)
    return [_Arm(k + 1, *one) for k, one in enumerate(each)]


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def _alone(a: PairAnswer) -> str:
    return "; ".join(
        f"{arm.name} {_percent(arm.before.share)} before, {_percent(arm.after.share)} after" for arm in _arms(a)
    )


def _stands(a: PairAnswer) -> str:
    told = []
    for arm in _arms(a):
        (x, y, z), (p, q, r) = arm.plate.origin * TO_MM, arm.plate.axes[:, 2]
        told.append(f"{arm.name} at {x:.2f}, {y:.2f}, {z:.2f} mm along {p:.3f}, {q:.3f}, {r:.3f}")
    return "; ".join(told)


ARM: tuple[Quantity[_Arm], ...] = (
    Quantity("number", "number of the arm, from 1"),
    Quantity("name", "name of the arm"),
    Quantity("position_mm", "position of its plate in the shared frame", lambda a: a.plate.origin),
    Quantity("direction", "direction of the arm at its plate, in the shared frame", lambda a: a.plate.axes[:, 2]),
    Quantity("roll_deg", "rotation of its plate about that direction, as in `base`", lambda a: roll_of(a.plate)),
    Quantity("reached_before", "fraction of the places that the given robot reaches alone", lambda a: a.before.share),
    Quantity("reached_after", "fraction of the places that the design reaches alone", lambda a: a.after.share),
    Quantity("certificate", "lower bound on its margin at all rotations", lambda a: a.solution.certificate),
    Quantity("dimensions", "free dimensions", lambda a: a.solution.dimensions, of=DIMENSION),
    Quantity("checks", "independent checks of the result", lambda a: a.solution.verification.checks, of=CHECK),
)

PAIR = described(
    PairAnswer,
    Quantity("wanted", "the objective", lambda a: a.search.wanted),
    Quantity("searched_before", "fraction of the pairs of places of the search, given robots",
             lambda a: a.search.before),
    Quantity("searched_after", "fraction of the pairs of places of the search, designs", lambda a: a.search.after),
    Quantity("tried", "number of pairs of robots evaluated", lambda a: a.search.tried,
             words="{tried}; no optimum is claimed", label="pairs of robots evaluated"),
    Quantity("places", "number of independent places for the evaluation", lambda a: len(a.after.apart)),
    Quantity("before", "fraction of their pairs that the given robots reach", lambda a: a.before.share),
    Quantity("after", "fraction of their pairs that the designs reach", lambda a: a.after.share),
    line("pairs of places reached", lambda a: f"{_percent(a.before.share)} before, {_percent(a.after.share)} after, of "
         f"{len(a.after.apart)} places not searched with"),
    line("reached by itself", _alone),
    Quantity("clearance_mm", "clearance between the arms", lambda a: a.after.clearance),
    "planned",
    of_field(PairAnswer, "proved", label="proved", words="{proved} of {planned} motions of both arms to such pairs"),
    line("plates", _stands),
    Quantity("arms", "the two arms", _arms, of=ARM),
    Quantity("remarks", "active limits, tubes with little effect, a coarse search"),
    Quantity("seconds", "run time of the search, s", lambda a: a.search.seconds, form=".1f",
             label="run time of the search"),
)  # fmt: skip


def pairs_of_places(share: PairShare, places: Sequence[Array]) -> str:
    """A table of all pairs of places, mm in the frame that both share: how far the arms are apart at least, and whether
    they hold the pair."""
    columns = [f"{axis}{k}_mm" for k in (1, 2) for axis in "xyz"]
    rows = []
    for i, j in np.argwhere(~np.eye(len(share.apart), dtype=bool)):
        apart = share.apart[i, j]
        told = "" if np.isnan(apart) else float(at_least(apart))
        rows.append([*map(float, [*places[i], *places[j]]), told, int(share.held[i, j])])
    return to_csv([*columns, "apart_at_least_mm", "held"], rows)


class PairReport(Report[PairAnswer]):
    command = "design-pair"
    quantities = PAIR
    file = "design_pair.json"

    def title(self) -> str:
        return " and ".join(self.answer.names)

    def below(self) -> list[RenderableType]:
        """Of each arm its dimensions and what was checked again; the remarks."""
        parts: list[RenderableType] = []
        for arm in _arms(self.answer):
            parts += [dimensions(arm.solution, f" of {arm.name}"), checked_again(arm.solution)]
        return [*parts, *(Text(f"  {words}") for words in self.answer.remarks)]

    def save(self, directory: Path) -> list[Path]:
        """Write arm_1/robot.yaml and arm_2/robot.yaml, the pairs of places, and design_pair.json."""
        a, paths = self.answer, list[Path]()
        for arm in _arms(a):
            paths.append(directory / f"arm_{arm.number}" / "robot.yaml")
            save_robot(arm.solution.robot, paths[-1])
        paths.append(directory / "pairs.csv")
        places = a.plates[0].placed(a.after.reached[0].targets) * TO_MM
        write_text(paths[-1], pairs_of_places(a.after, list(places)))
        return [*paths, self.save_record(directory)]

    def pictures(self) -> dict[str, Drawing]:
        """What both hold before and after, where in the region, and the shapes of each."""
        a = self.answer
        shares, places = (a.before, a.after), a.plates[0].placed(a.after.reached[0].targets)
        found: dict[str, Drawing] = {
            "pairs": drawing("design.plot_pair_shares", shares, names=a.names),
            "places": drawing("design.plot_pair_places", shares, names=a.names, places=places),
        }
        for arm in _arms(a):
            found[f"arm_{arm.number}_shapes"] = before_after(arm.solution, arm.name)
        return found
