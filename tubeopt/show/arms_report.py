"""What is said and saved about the motions of several robots."""

from __future__ import annotations

from importlib.util import find_spec
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..bodies.frames import Frame, roll_of
from ..errors import NotProvedError
from ..files.csv_file import to_csv
from ..files.files import write_text
from ..files.units import TO_MM
from ..planning import ArmsPlan, PairProof, Trajectory
from ..planning.trajectory import save_trajectory
from ..robots.file import save_robot
from .formatting import at_least
from .plan_report import TRAJECTORY
from .quantities import Quantity, described, line
from .report import Drawing, Report, drawing

INSTANTS = 200
"""Instants at which the distances between arms are told in a file."""


class _Arm(NamedTuple):
    """One of several robots of a plan: its number, from 1, its name, where its plate stands, and its motion."""

    number: int
    name: str
    base: Frame
    motion: Trajectory


def _arms(plan: ArmsPlan) -> list[_Arm]:
    pairs = enumerate(zip(plan.arms, plan.trajectories, strict=True), start=1)
    return [_Arm(number, arm.called, arm.base, motion) for number, (arm, motion) in pairs]


def _bound(pair: PairProof) -> str:
    i, j = pair.arms
    if not np.isfinite(pair.least_clearance):
        return f"{i + 1} and {j + 1}: none is shown ({pair.measured_clearance * TO_MM:.3f} mm measured)"
    measured = f"{pair.measured_clearance * TO_MM:.3f} mm measured at {pair.when:.2f} s"
    return f"{i + 1} and {j + 1}: at least {at_least(pair.least_clearance):.3f} mm at all times ({measured})"


def _clearance_from(plan: ArmsPlan) -> str | None:
    """What the clearance of the arms is from, of obstacles that are no solids; None where all are."""
    return "; ".join(dict.fromkeys(chain(*(proof.clearance_from for proof in plan.proof.proofs)))) or None


def _called(arm: _Arm) -> str:
    """Its number and, where it has one, its name."""
    return f"{arm.number} ({arm.name})" if arm.name != f"arm {arm.number}" else f"{arm.number}"


def _moves(arm: _Arm) -> str:
    t = arm.motion
    if len(t.time) == 1:
        return f"{_called(arm)} rests"
    return (
        f"{_called(arm)} moves from {t.time[0]:.2f} to {t.time[-1]:.2f} s, margin at least {t.proof.least_margin:.4f}"
    )


ARM: tuple[Quantity[_Arm], ...] = (
    Quantity("number", "number of the arm, from 1"),
    Quantity("name", "name of the arm"),
    Quantity("position_mm", "position of its plate in the shared frame", lambda a: a.base.origin),
    Quantity("direction", "direction of the arm at its plate, in the shared frame", lambda a: a.base.axes[:, 2]),
    Quantity("roll_deg", "rotation of its plate about that direction, as in `base`", lambda a: roll_of(a.base)),
    Quantity("begin_s", "start of its motion", lambda a: a.motion.time[0]),
    Quantity("end_s", "end of its motion", lambda a: a.motion.time[-1]),
    Quantity("motion", "motion in the frame of its own plate", of=TRAJECTORY),
)

PAIR = described(
    PairProof,
    Quantity("arms", "numbers of the two arms, from 1", lambda p: [k + 1 for k in p.arms]),
    "least_clearance measured_clearance when",
)

ARMS = described(
    ArmsPlan,
    Quantity("proved", "true if all requirements are proved"),
    Quantity("status", "result of the planning"),
    Quantity("duration_s", "time until the last arm rests", form=".2f", label="duration"),
    Quantity("order", "order of planning, arms from 1", lambda p: [k + 1 for k in p.order],
             label="planning order",
             words=lambda p: ", ".join(str(k + 1) for k in p.order)),
    Quantity("withdrawn_first", "arms that withdraw first and continue later, from 1",
             lambda p: [k + 1 for k in p.withdrawn_first],
             words=lambda p: ", ".join(str(k + 1) for k in p.withdrawn_first) or None, label="withdraw first"),
    line("arms", lambda p: "; ".join(_moves(arm) for arm in _arms(p))),
    line("distances between arms", lambda p: "; ".join(_bound(pair) for pair in p.proof.pairs)),
    line("clearance from", lambda p: _clearance_from(p)),
    Quantity("faults", "violated or unproved requirements, as text", lambda p: p.proof.faults),
    Quantity("arms", "the arms", _arms, of=ARM),
    Quantity("pairs", "the pairs of arms", lambda p: p.proof.pairs, of=PAIR),
    "seconds",
)  # fmt: skip


def between_arms(plan: ArmsPlan) -> str:
    """A table of the distances of every two arms at instants: what is measured between points of both, and what is
    proved of all points, from this instant to the next; empty where nothing is."""
    times, pairs = np.linspace(0.0, plan.duration, INSTANTS), plan.proof.pairs
    words = [f"arms_{pair.arms[0] + 1}_{pair.arms[1] + 1}" for pair in pairs]
    columns = ["time_s", *(f"{each}_mm" for each in words), *(f"{each}_at_least_mm" for each in words)]
    later = np.append(times[1:], times[-1])
    bounds = np.column_stack([pair.at_least(times, later) for pair in pairs])
    proved = np.where(np.isfinite(bounds), at_least(bounds, 6), np.nan)
    measured = np.round(plan.clearance(times) * TO_MM, 6)
    rows = (
        [float(t), *map(float, row), *("" if x != x else float(x) for x in known)]
        for t, row, known in zip(times, measured, proved, strict=True)
    )
    return to_csv(columns, rows)


class ArmsReport(Report[ArmsPlan]):
    command = "plan-arms"
    quantities = ARMS
    file = "plan_arms.json"

    def title(self) -> str:
        p = self.answer
        return f"{len(p.arms)} arms: {'motions past each other, proved' if p.proved else f'motions, {p.status}'}"

    def save(self, directory: Path) -> list[Path]:
        """Write arm_1/robot.yaml, arm_1/trajectory.csv and so on, the distances between arms, and plan_arms.json."""
        p, paths = self.answer, list[Path]()
        for arm in _arms(p):
            folder = directory / f"arm_{arm.number}"
            paths += [folder / "robot.yaml", folder / "trajectory.csv"]
            save_robot(arm.motion.robot, paths[-2])
            save_trajectory(arm.motion, paths[-1], robot_file="robot.yaml")
        paths.append(directory / "between_arms.csv")
        write_text(paths[-1], between_arms(p))
        return [*paths, self.save_record(directory)]

    def pictures(self) -> dict[str, Drawing]:
        """The arms and their distances, and a page that plays if viser is installed."""
        shown = {"arms": drawing("trajectory.plot_arms", self.answer)}
        if find_spec("viser") is not None:
            from .viewer.host import arms_page

            shown["arms.html"] = lambda path: write_text(path, arms_page(self.answer))
        return shown

    def films(self) -> dict[str, Drawing]:
        """The moving arms."""
        return {"arms": drawing("trajectory.animate_arms", self.answer)}

    def conclude(self) -> None:
        """Raise NotProvedError where something is not proved."""
        if not self.answer.proved:
            raise NotProvedError(f"trajectories were found, but: {self.answer.status}")
