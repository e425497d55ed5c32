"""Reports on trajectories, planned or checked, and on the motions of several robots."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from importlib.util import find_spec
from itertools import chain
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Group
from rich.text import Text

from ..bodies.frames import Frame, roll_of
from ..equilibrium.readings import to_readings
from ..equilibrium.result import Equilibrium, WallForce
from ..errors import NotProvedError, SolveError
from ..files.csv_file import to_csv
from ..files.files import write_text
from ..files.units import TO_MM
from ..planning import ArmsPlan, Deployment, Entry, PairProof, Proof, Trajectory
from ..planning.trajectory import save_joint_trajectory, save_trajectory
from ..robots.calibration import PathBounds
from ..robots.file import joint_cells, joint_columns, save_robot
from ..runs.plan_study import VerifiedTrajectory
from ..stability import ASSUMING
from ..stability.deflection import ForceBound
from ..typing import Array
from .equilibrium_report import by_history
from .formatting import at_least, tip_number, tip_text
from .quantities import (
    Quantity,
    described,
    distance_text,
    joints_text,
    known_distance,
    line,
    load_text,
    of_field,
    readings,
    rows,
    within,
)
from .report import Drawing, Report, drawing, two_columns

BEYOND = "assuming no other load and no friction"

FRICTION_SAMPLES = 25
"""Number of samples of the motion for the effect of friction on the tip."""

METHODS = {
    "straight": "straight",
    "detour": "by translations at which nothing can snap",
    "search": "by random search",
    "roadmap": "over a roadmap",
    "tip path": "by inverse kinematics along the curve",
    "leader": "by withdrawing the arm along itself",
    "partial": "as far as the search came",
}


def _clearance_text(p: Proof) -> str | None:
    """Proved and measured clearance, as text; None without obstacles."""
    measured = f"({p.measured_clearance * TO_MM:.3f} mm measured)"
    # -inf if no bound is shown, +inf without obstacles.
    if np.isfinite(p.least_clearance):
        return f"at least {at_least(p.least_clearance):.3f} mm at all times {measured}"
    return f"none is shown {measured}" if p.least_clearance < 0 else None


def _equilibria_text(p: Proof) -> str:
    """Number of equilibria of the proof, and their independent check, as text."""
    if p.end.load is not None or not p.end.robot.fixed_sections:
        return f"through {p.equilibria} equilibria, tips right to {p.reintegration * TO_MM:.0e} mm (estimated)"
    checked = f", re-integrated to {p.reintegration * TO_MM:.0e} mm (DOP853)" if np.isfinite(p.reintegration) else ""
    return f"through {p.equilibria} equilibria{checked}"


def _assuming(p: Proof) -> str:
    """Text of the assumptions of a proof."""
    forced = "" if p.forced is None else f"any force of up to {p.forced.max_force * 1e3:g} mN on the tip"
    if p.end.load is not None:
        return f"under {load_text(p.end.load)}{forced and f' and {forced}'}, {BEYOND}"
    return f"under {forced}, assuming no weight or friction" if forced else ASSUMING


def _force_text(f: ForceBound) -> str:
    """Effect of any force on the tip, as text."""
    effect = f"moves the arm by at most {f.deflection * TO_MM:.3g} mm" if f.margin > 0 else "may snap the robot"
    return f"of up to {f.max_force * 1e3:g} mN {effect}, margin at least {f.margin:.4f}"


def _tip_speed_text(p: Proof) -> str:
    """Proved and measured speed of the tip, as text."""
    measured = f"{p.measured_tip_rate * TO_MM:.2f} mm/s between equilibria"
    if math.isinf(p.largest_tip_rate):
        return f"{measured}; no bound is proved"
    return f"at most {p.largest_tip_rate * TO_MM:.2f} mm/s, proved; {measured}"


FORCED = described(
    ForceBound,
    line("any force on the tip", _force_text),
    "max_force deflection",
)


def _real_text(real: PathBounds | None) -> str | None:
    """Bounds on the real robot, as text."""
    if real is None:
        return None
    near = [f" and clearance at least {x * TO_MM:.2f} mm" if np.isfinite(x) else "" for x in real.clearance]
    each = zip(real.probabilities, real.margin, near, strict=True)
    return "; ".join(f"{100 * p:g} %: margin at least {mu:.4f}{body}" for p, mu, body in each) + " (estimated)"


REAL_PATH: tuple[Quantity[PathBounds], ...] = (
    Quantity("probabilities", "probabilities of the bounds on the real robot; absent without posterior", optional=True),
    Quantity("real_margin", "the margin of the real robot is at least this; 0 where it may snap",
             lambda real: real.margin, optional=True),
    Quantity("real_clearance_mm", "the real robot keeps this distance from obstacles; null without",
             lambda real: real.clearance, optional=True),
)  # fmt: skip

PROOF = described(
    Proof,
    Quantity("proved", "true if all requirements are proved", lambda p: p.holds),
    Quantity("assumed", "assumptions of all results", _assuming),
    "faults followed snap least_margin",
    of_field(Proof, "least_clearance", label="clearance", text=_clearance_text),
    Quantity(
        "clearance_from",
        "reference of the clearance, for obstacles that are points or open surfaces; absent otherwise",
        lambda p: p.clearance_from or None,
        optional=True,
        label="clearance from",
        text=lambda p: "; ".join(p.clearance_from) or None,
    ),
    Quantity("clearance_bound_mm", "lower bound on the distance between the checked instants"),
    "measured_clearance",
    *within(FORCED, lambda p: p.forced),
    *within(REAL_PATH, lambda p: p.real),
    line("real robot", lambda p: _real_text(p.real)),
    line(
        "largest rates",
        "{largest_rotation_rate_deg_per_s:.2f} deg/s, {largest_translation_rate_mm_per_s:.2f} mm/s; "
        "{largest_rotation_acceleration_deg_per_s2:.2f} deg/s^2, "
        "{largest_translation_acceleration_mm_per_s2:.2f} mm/s^2",
    ),
    "largest_rotation_rate largest_translation_rate largest_rotation_acceleration largest_translation_acceleration",
    line("path of the tip", "{tip_length_mm:.2f} mm, in steps of at most {largest_tip_step_mm:.2f} mm"),
    line("speed of the tip", _tip_speed_text),
    "largest_tip_step tip_length largest_tip_rate measured_tip_rate reintegration",
    of_field(Proof, "equilibria", label="followed again", text=_equilibria_text),
)


def _ends(k: int, name: str, label: str) -> Quantity[Trajectory]:
    """Joint values at an end of a trajectory."""
    joints: tuple[Quantity[Trajectory], ...] = (
        Quantity("rotations_deg", "rotation of every tube", lambda t: t.rotations[k]),
        Quantity("translations_mm", "translation of every tube", lambda t: t.translations[k]),
        *readings(lambda t: t.arms[k]),
        Quantity(
            "tip_tube",
            "number of the tube at the tip, from 1; null if all are withdrawn",
            lambda t: tip_number(t.arms[k]),
        ),
    )
    return Quantity(
        name,
        f"joint values at the {name}",
        lambda t: t,
        of=joints,
        label=label,
        text=lambda t: joints_text(t.arms[k]),
    )


def _entry_text(t: Trajectory) -> str | None:
    """Position of the plate found by the plan, as text; None if it was fixed."""
    if t.entry is None:
        return None
    (x, y, z), axes = t.entry.frame.origin * TO_MM, t.entry.frame.axes
    # The last column is the new axis; its z component is the cosine to the old one. Round-off may exceed 1.
    leans = np.degrees(np.arccos(np.clip(axes[2, 2], -1.0, 1.0)))
    pose = f"moved by {x:.2f}, {y:.2f}, {z:.2f} mm, leaning {leans:.1f} deg"
    return f"{pose}; {t.entry.considered} positions considered, {t.entry.tried} tried"


ENTRY = described(
    Entry,
    Quantity("position_mm", "position of the plate in the frame of the given plate", lambda e: e.frame.origin),
    Quantity(
        "direction", "direction of the arm at the plate in the frame of the given plate", lambda e: e.frame.axes[:, 2]
    ),
    Quantity("patient_position_mm", "position of the plate in the patient, RAS", lambda e: e.base.origin),
    Quantity("patient_direction", "direction of the arm at the plate in the patient, RAS", lambda e: e.base.axes[:, 2]),
    "considered clear tried",
)


def _smoothing_text(t: Trajectory) -> str | None:
    """Effect and effort of smoothing, as text; None if it did nothing."""
    s = t.statistics
    change = f"{s.raw_length:.2f} to {s.length:.2f} joint units ({s.smoothed}), {s.iterations} iterations"
    return f"{change}, {s.smooth_seconds:.1f} s" if s.smoothed else None


TRAJECTORY = described(
    Trajectory,
    Quantity("robot", "name of the robot", lambda t: t.robot.name),
    _ends(0, "start", "from"),
    _ends(-1, "goal", "to"),
    Quantity("tip_position_mm", "tip position at the end", lambda t: t.tip_position[-1], form=".3f",
             label="tip at the end"),
    Quantity("duration_s", "duration of the motion", lambda t: t.time[-1],
             text="{duration_s:.2f} s, {samples} samples", label="duration"),
    Quantity("samples", "number of samples", lambda t: len(t.time)),
    Quantity("tip_rotations_deg", "rotation of every tube at its own tip, at the end", lambda t: t.end.tip_rotations),
    line("the tip is", lambda t: tip_text(t.robot, t.arms[-1].tube_end) or None),
    of_field(Trajectory, "turns", label="full turns added",
             text=lambda t: ", ".join(str(turn) for turn in t.turns) if any(t.turns) else None),
    Quantity("status", "result of the planning"),
    Quantity("largest_deviation_mm", "largest deviation from the requested path",
             lambda t: None if t.deviation is None else t.deviation.max(), form=".3f", label="largest deviation"),
    Quantity("tip_by_history_mm",
             "largest displacement of the tip by friction along x, y and z, over all samples, to first order; absent "
             "without friction", lambda t: largest_by_history(t), optional=True, label="effect of friction",
             text="within ± {tip_by_history_mm:.3f} mm along x, y, z, to first order"),
    Quantity("least_snap_distance_deg",
             "smallest snap distance at the samples: all tubes can turn by this much, each either way, without a snap: "
             "proved; null if no turn can snap; absent if unknown or under load",
             lambda t: _quick_distance(t), optional=True),
    line("snap distance",
         lambda t: distance_text(_quick_distance(t), " at every sample")),
    line("plate", _entry_text),
    of_field(Trajectory, "entry", of=ENTRY, optional=True),
    of_field(Trajectory, "proof", of=PROOF),
    Quantity("statistics", "effort of the search", lambda t: asdict(t.statistics)),
)  # fmt: skip

SEARCH: tuple[Quantity[Trajectory], ...] = (
    *within(PROOF, lambda t: t.proof),
    line("found", lambda t: _search_text(t)),
    line("smoothed", _smoothing_text),
)
"""Quantities shown below those of the motion."""


def largest_by_history(t: Trajectory) -> Array | None:
    """(3,) largest half-widths of the range of tip positions under friction, m; None without friction."""
    chosen = np.unique(np.linspace(0, len(t.arms) - 1, FRICTION_SAMPLES).round().astype(int)).tolist()
    half_widths = [half for k in chosen if (half := by_history(t.arms[k])) is not None]
    # Per axis: the largest along x and along y may be at different instants.
    return np.max(half_widths, axis=0) if half_widths else None


def _quick_distance(t: Trajectory) -> float | None:
    """Smallest snap distance, rad; None if unknown, or under a load, where a sample takes 0.1 s."""
    return known_distance(lambda: t.least_snap_distance) if all(e.load is None for e in t.arms) else None


def _search_text(t: Trajectory) -> str:
    """Method and effort of the search, as text."""
    s = t.statistics
    return f"{METHODS[s.how]}, {s.motions} motion{'' if s.motions == 1 else 's'}, {s.search_seconds:.1f} s"


class TrajectoryReport(Report[Trajectory]):
    command = "plan"
    quantities = TRAJECTORY
    file = "plan.json"

    def title(self) -> str:
        t = self.answer
        result = "a motion on one stable branch, proved" if t.proved else f"a motion, {t.status}"
        assumptions = "" if t.start.load is None else f", {_assuming(t.proof)}"
        return f"{super().title()}: {result}{assumptions}"

    def rows(self) -> list[tuple[str, str]]:
        """Rows (name, text) of the plan, its proof and the search."""
        return super().rows() + rows(self.answer, SEARCH)

    def save(self, directory: Path) -> list[Path]:
        """Write robot.yaml, trajectory.csv, joint_trajectory.json, tip.csv and plan.json.

        If the plan includes the position of the plate, base.txt has its pose in the patient.
        """
        paths = [directory / name for name in ("robot.yaml", "trajectory.csv", "tip.csv", "joint_trajectory.json")]
        save_robot(self.answer.robot, paths[0])
        save_trajectory(self.answer, paths[1], robot_file="robot.yaml")
        save_joint_trajectory(self.answer, paths[3])
        columns = ["time_s", "x_mm", "y_mm", "z_mm", "margin", "clearance_mm"]
        write_text(paths[2], to_csv(columns, self._tip()))
        if self.answer.entry is not None:
            paths.append(directory / "base.txt")
            write_text(paths[-1], _pose(self.answer.entry.base))
        return [*paths, self.save_record(directory)]

    def _tip(self) -> Iterator[Sequence[object]]:
        """Rows of tip.csv."""
        t = self.answer
        for time, tip, margin, clear in zip(t.time, t.tip_position, t.margin, t.clearance, strict=True):
            # To 1 nm, so that round-off does not show in the file.
            shown = round(float(clear) * TO_MM, 6) if np.isfinite(clear) else ""
            yield [float(time), *(round(float(x) * TO_MM, 6) + 0.0 for x in tip), float(margin), shown]

    def tables(self) -> dict[str, Any]:
        return {"trajectory": self.answer}

    def pictures(self) -> dict[str, Drawing]:
        """Pictures of the motion, and of its section by the plane of the study."""
        pictures: dict[str, Drawing] = {"trajectory": drawing("trajectory.plot_trajectory", self.answer)}
        if self.answer.cut is not None:
            pictures["section"] = drawing("trajectory.plot_section", self.answer)
        return pictures

    def films(self) -> dict[str, Drawing]:
        """Film of the moving arm."""
        return {"trajectory": drawing("trajectory.animate_trajectory", self.answer)}

    def conclude(self) -> None:
        """Raise NotProvedError if the proof is incomplete."""
        if not self.answer.proved:
            raise NotProvedError(f"a trajectory was found, but it is {self.answer.status}")


def _pose(base: Frame) -> str:
    """Text of a frame in RAS as a homogeneous matrix, mm, as the key `pose` of an anatomy reads it."""
    # Navigation software exchanges poses in this form.
    rows = [*np.column_stack([base.axes, base.origin * TO_MM]), np.array([0.0, 0.0, 0.0, 1.0])]
    return "# SPACE=RAS\n" + "".join(" ".join(f"{number:.12g}" for number in row) + "\n" for row in rows)


CHECKED: tuple[Quantity[VerifiedTrajectory], ...] = (
    Quantity("robot", "name of the robot", lambda a: a.joints.robot.name),
    Quantity("duration_s", "duration of the motion", lambda a: a.joints.time[-1] - a.joints.time[0]),
    Quantity("samples", "number of samples", lambda a: len(a.joints.time)),
    *within(PROOF, lambda a: a.proof),
)


class CheckedReport(Report[VerifiedTrajectory]):
    command = "verify"
    quantities = CHECKED
    file = "verify.json"
    drawn = (("verified", "trajectory.plot_checked"),)

    def table(self) -> Group:
        """Verdict and numbers; `conclude` raises the faults."""
        a = self.answer
        verdict = "is proved" if a.proof.holds else "is not proved"
        return Group(Text(f"{a.file} {verdict}, {_assuming(a.proof)}"), two_columns("", self.rows()))

    def conclude(self) -> None:
        """Raise SolveError if a requirement is violated."""
        if not self.answer.proof.holds:
            raise SolveError(f"{self.answer.file}: {'; '.join(self.answer.proof.faults)}")


INSTANTS = 200
"""Instants of the distances between arms in their file."""


class _Arm(NamedTuple):
    """Robot of a plan with several."""

    number: int
    """Number of the arm, from 1."""
    name: str
    base: Frame
    """Frame of its plate."""
    motion: Trajectory


def _arms(plan: ArmsPlan) -> list[_Arm]:
    """Arms of a plan with their motions."""
    pairs = enumerate(zip(plan.arms, plan.trajectories, strict=True), start=1)
    return [_Arm(number, arm.called, arm.base, motion) for number, (arm, motion) in pairs]


def _distance_text(pair: PairProof) -> str:
    """Proved and measured distance of two arms, as text."""
    i, j = pair.arms
    if not np.isfinite(pair.least_clearance):
        return f"{i + 1} and {j + 1}: none is shown ({pair.measured_clearance * TO_MM:.3f} mm measured)"
    measured = f"{pair.measured_clearance * TO_MM:.3f} mm measured at {pair.when:.2f} s"
    return f"{i + 1} and {j + 1}: at least {at_least(pair.least_clearance):.3f} mm at all times ({measured})"


def _motion_text(arm: _Arm) -> str:
    """Motion of an arm, with its number and own name, as text."""
    t = arm.motion
    name = f"{arm.number} ({arm.name})" if arm.name != f"arm {arm.number}" else f"{arm.number}"
    if len(t.time) == 1:
        return f"{name} rests"
    return f"{name} moves from {t.time[0]:.2f} to {t.time[-1]:.2f} s, margin at least {t.proof.least_margin:.4f}"


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
             text=lambda p: ", ".join(str(k + 1) for k in p.order)),
    Quantity("withdrawn_first", "arms that withdraw first and continue later, from 1",
             lambda p: [k + 1 for k in p.withdrawn_first],
             text=lambda p: ", ".join(str(k + 1) for k in p.withdrawn_first) or None, label="withdraw first"),
    line("arms", lambda p: "; ".join(_motion_text(arm) for arm in _arms(p))),
    line("distances between arms", lambda p: "; ".join(_distance_text(pair) for pair in p.proof.pairs)),
    # Each sentence once, in the order of the arms.
    line("clearance from", lambda p: "; ".join(dict.fromkeys(
        chain(*(proof.clearance_from for proof in p.proof.proofs)))) or None),
    Quantity("faults", "violated or unproved requirements, as text", lambda p: p.proof.faults),
    Quantity("arms", "the arms", _arms, of=ARM),
    Quantity("pairs", "the pairs of arms", lambda p: p.proof.pairs, of=PAIR),
    "seconds",
)  # fmt: skip


def between_arms(plan: ArmsPlan) -> str:
    """CSV of the distances of every two arms at instants.

    Columns are the measured distances between points of both arms, and the proved bounds for all points from this
    instant to the next; cells without a bound are empty.
    """
    times, pairs = np.linspace(0.0, plan.duration, INSTANTS), plan.proof.pairs
    names = [f"arms_{pair.arms[0] + 1}_{pair.arms[1] + 1}" for pair in pairs]
    columns = ["time_s", *(f"{name}_mm" for name in names), *(f"{name}_at_least_mm" for name in names)]
    # The bound of a row covers the interval up to the next row.
    later = np.append(times[1:], times[-1])
    bounds = np.column_stack([pair.at_least(times, later) for pair in pairs])
    # Rounded down, since a bound that is rounded up is no bound.
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
        """Pictures of the arms and their distances, and a page with the motion if viser is installed."""
        pictures = {"arms": drawing("trajectory.plot_arms", self.answer)}
        if find_spec("viser") is not None:
            from .viewer.host import arms_page

            pictures["arms.html"] = lambda path: write_text(path, arms_page(self.answer))
        return pictures

    def films(self) -> dict[str, Drawing]:
        """Film of the moving arms."""
        return {"arms": drawing("trajectory.animate_arms", self.answer)}

    def conclude(self) -> None:
        """Raise NotProvedError if a requirement is not proved."""
        if not self.answer.proved:
            raise NotProvedError(f"trajectories were found, but: {self.answer.status}")


class _Step(NamedTuple):
    """Equilibrium of a deployment and the point of the path that its tip was led to."""

    equilibrium: Equilibrium
    miss: float
    """Distance of the tip from the point, m."""


def _steps(d: Deployment) -> list[_Step]:
    return [_Step(*each) for each in zip(d.equilibria, d.misses.tolist(), strict=True)]


STEP: tuple[Quantity[_Step], ...] = (
    *(
        Quantity(f"{name}_{unit}", text, attrgetter(f"equilibrium.{name}"))
        for name, unit, text in (
            ("rotations", "deg", "rotations"),
            ("translations", "mm", "translations"),
            ("tip_position", "mm", "tip position"),
        )
    ),
    Quantity("miss_mm", "distance of the tip from its point of the path", lambda step: step.miss),
    Quantity("margin", "margin with the walls", lambda step: step.equilibrium.margin),
    Quantity("contacts", "contacts with walls, base to tip",
             lambda step: list(step.equilibrium.walls.contacts) if step.equilibrium.walls else [],
             of=described(WallForce)),
)  # fmt: skip

DEPLOYMENT = described(
    Deployment,
    Quantity("robot", "name of the robot", lambda d: d.equilibria[0].robot.name),
    of_field(Deployment, "status", label="outcome", text="{status}"),
    of_field(Deployment, "reason", text=lambda d: d.reason or None, label="reason"),
    "largest_force",
    Quantity("miss_mm", "distance of the tip from the last point of the motion", lambda d: d.misses[-1], form=".3f"),
    Quantity(
        "least_margin", "smallest margin at the points", lambda d: min(e.margin for e in d.equilibria), form=".4f"
    ),
    line("at the end", lambda d: joints_text(d.equilibria[-1])),
    Quantity("steps", "start of the motion, and the equilibrium at every point of the path", _steps, of=STEP),
)  # fmt: skip


class DeploymentReport(Report[Deployment]):
    command = "deploy"
    quantities = DEPLOYMENT
    file = "deployment.json"
    drawn = (("deployment", "shape.plot_deployment"),)

    def title(self) -> str:
        return self.answer.equilibria[0].robot.name or "robot"

    def save(self, directory: Path) -> list[Path]:
        """Write waypoints.csv, which `follow` reads, and deployment.json."""
        first = self.answer.equilibria[0].robot
        turns, shifts = joint_columns(first.n_tubes)
        cells = (joint_cells(*to_readings(first, e.rotations, e.translations)) for e in self.answer.equilibria)
        write_text(directory / "waypoints.csv", to_csv([*turns, *shifts], cells))
        return [directory / "waypoints.csv", self.save_record(directory)]

    def solids(self) -> dict[str, Equilibrium]:
        """Arm at the end of the motion, to save as a mesh."""
        return {"arm": self.answer.equilibria[-1]}

    def conclude(self) -> None:
        """Raise SolveError if the tip did not reach the end of the path."""
        if self.answer.reason:
            raise SolveError(f"{self.answer.status}: {self.answer.reason}")
