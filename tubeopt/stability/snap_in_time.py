"""A snap in time: motion of the tubes from the lost equilibrium, with inertia and material damping."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..arguments import typed
from ..block.transcription.inertia import TubeMotion
from ..display import Displayed
from ..equilibrium.kinematics import unsolved
from ..equilibrium.member import Member, Point
from ..equilibrium.result import Equilibrium
from ..errors import InputError, positive, vector
from ..files.field_metadata import form, unit
from ..robots.concentric import Friction, check_friction
from ..robots.load import Load, known_masses
from ..solvers.blas import small
from ..solvers.energy_momentum import Instant, motion
from ..solvers.time_limit import TIME_LIMIT, limited
from ..typing import Array, Delegate, StatusEnum
from .folds import slide
from .motion import SMOOTH_TURN, Snap

# A loss factor of 0.3 % at 500 Hz. Metals damp all frequencies about equally, this law high ones more.
RELAXATION = 1e-6
"""Default relaxation time of the material, s."""

# At the fold itself no force acts. From here the motion grows, and its further course does not depend on the size.
PUSH = 0.01
"""Largest rotation (rad) of the push at the start, along the direction that is lost."""

# Halving it changes time and speed of the snap of the pair of Till et al. by 0.1 %.
STEP_TOLERANCE = 2e-3
"""Error of a time step: root of its energy over that of the snap."""

FIRST_STEP = 1e-6
"""First time step, s."""

RISE = (0.1, 0.9)
"""Fractions of the turn at the tip between which the time of the snap is counted."""

# One is enough to see the largest swing.
PERIODS = 1.0
"""Periods of the slowest vibration that the motion continues after the snap."""

# The time of the slow start grows like the inverse root of the push.
LONGEST = 1.0
"""Longest motion without `duration`, s."""

MODES = 6
"""Number of vibrations of which the frequency is returned."""

ARMS = 120
"""Largest number of instants with a shape, evenly spaced in time."""

# The slow start takes most of the time and shows nothing.
BEFORE = 2.0
"""Time before the snap at which the shapes begin, over that of the snap."""


class MotionEnd(StatusEnum):
    """End of a motion through a snap, as a sentence."""

    LANDED = "the robot ends about the equilibrium that slow motion predicts"
    ELSEWHERE = "the robot swings beyond the equilibrium that slow motion predicts, and ends about another one"
    MOVING = "at the end of the motion the robot has not passed the snap"


@dataclass(frozen=True)
class MotionStatistics:
    """Effort of a motion."""

    steps: int
    """Number of time steps."""
    seconds: float
    """Run time, s."""


@dataclass(frozen=True, eq=False)
class SnapInTime(Displayed):
    """Motion of a robot through a snap, at T instants."""

    _brief = ("duration", "peak_speed", "energy_released", "frequencies", "status")

    snap: Snap
    """The snap in slow motion."""
    time: Array
    """(T,) times since the push, s."""
    tip_position: Array
    """(T, 3) positions of the tip, m."""
    tip_rotations: Array
    """(T, n) rotations of the tubes at their own ends, rad."""
    kinetic: Array
    """(T,) kinetic energy, J."""
    potential: Array
    """(T,) elastic energy less the work of the load, J, less that of the equilibrium that is lost."""
    dissipated: Array
    """(T,) energy dissipated in the material and by friction between the tubes, J."""
    drive_work: Array
    """(T,) work of the drives, J."""
    duration: Annotated[float, unit("ms"), form(".4f"), "time of the snap, in which the tip turns from 10 to 90 %"]
    """Time of the tube that turns farthest, s; NaN if the motion ends before."""
    peak_speed: Annotated[float, unit("m_per_s"), form(".3f"), "largest speed of the tip"]
    swept_area: Annotated[float, unit("mm2"), form(".1f"), "area that the centreline sweeps in its first swing"]
    """Until half a period of the slowest vibration after the snap, m^2."""
    swept_volume: Annotated[
        float, unit("cm3"), form(".3f"), "volume of the arm and of what it sweeps in its first swing, at most"
    ]
    """m^3; space that the arm passes twice counts twice."""
    tip_path: Annotated[float, unit("mm"), form(".3f"), "path of the tip in its first swing"]
    """m."""
    frequencies: Annotated[Array, unit("Hz"), form(".1f"), "slowest vibrations after the snap"]
    """(K,) undamped, lowest first, Hz."""
    damping_ratios: Annotated[Array, form(".2g"), "their damping ratios"]
    """(K,) fractions of the critical damping, to first order in the damping."""
    energy_error: Annotated[float, form(".1e"), "largest error of the energy balance over the energy released"]
    relaxation: Annotated[float, unit("us"), "relaxation time of the damping"]
    """s."""
    given: bool
    """True if the relaxation time was given, False for the assumed default."""
    arms: tuple[Equilibrium, ...]
    """Shapes at `arm_times`, for pictures: no equilibria, with the margin NaN."""
    arm_times: Array
    """Times (F,) of the shapes, s, from shortly before the snap."""
    status: MotionEnd
    """End of the motion, as a sentence."""
    statistics: MotionStatistics
    """Time steps and run time."""

    energy_released = Delegate[float]("snap")

    @property
    def value(self) -> float:
        """Time of the snap, s."""
        return self.duration


@typed
@small
@limited
def snap_in_time(
    snap: Snap,
    *,
    bending_inertia: bool = True,
    relaxation: float | None = None,
    friction: Friction | None = None,
    rates: ArrayLike | None = None,
    duration: float | None = None,
    time_limit: float = TIME_LIMIT,
) -> SnapInTime:
    """Motion of the tubes through a snap: its time, the speed of the tip, what it sweeps, and vibrations after it.

    The energy is that of the equilibria. Tubes turn about their axes with their polar inertia and move sideways with
    their mass, transmissions included; every fibre is damped by the law of Kelvin and Voigt. The motion starts at the
    equilibrium that is lost, with a push of 0.01 rad.

    Friction is that of the snap, if `follow` found it with friction; it then starts without a push. With another
    `friction` the tubes creep through the lost equilibrium until the drives, at their `rates`, have overcome it.

    Args:
        snap: result of `find_snap` or `follow`, of a concentric robot without load or under a dead one.
        bending_inertia: False leaves out the mass of the arm, so that its bending follows the rotations at once.
        relaxation: time of the damping law, s: the loss factor over the angular frequency. 0 for no damping; None for
            1 us, which is assumed.
        friction: friction between the tubes; None for that of the snap.
        rates: (n,) rotation rates of the drives, rad/s; None for drives at rest.
        duration: time to simulate, s; None until one period of the slowest vibration after the snap.
        time_limit: maximum run time, s.

    Raises:
        InputError: a robot off the centreline or of tubes of unknown mass; a load without an energy; a negative time.
        SolveError: no time step converges.
        TimeLimitError: (a SolveError) the time limit was reached before there was an answer.

    Examples:
        >>> import numpy as np
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("crl_ctr")
        >>> home = [0, 0, 0]
        >>> snap = tubeopt.find_snap(robot, (home, home), (np.radians([360, 0, 0]), home))
        >>> moving = tubeopt.snap_in_time(snap, bending_inertia=False)
        >>> moving.energy_error < 1e-6
        True
    """
    began = time.perf_counter()
    robot, lost = snap.before.robot, snap.before
    if not robot.fixed_sections or robot.assembly(lost.translations).eccentric:
        raise InputError("the robot of the snap has tubes off the centreline; a snap in time needs concentric tubes")
    if lost.load is not None and not lost.load.has_energy:
        raise InputError("the load of the snap has moments or turns with the tip; a snap in time needs a dead force")
    turning = np.zeros(robot.n_tubes) if rates is None else vector("rates", rates, robot.n_tubes)
    tau, span = RELAXATION if relaxation is None else positive("relaxation", relaxation, zero=True), duration
    if span is not None:
        positive("duration", span)
    law = friction if friction is not None or lost.friction is None else lost.friction.friction
    if law is not None:
        check_friction(law, robot.n_tubes)
        if any(law.of("by_moment")):
            raise InputError("by_moment of friction is above 0; a snap in time supports constant friction torques only")
        if law.sliding:
            raise InputError("friction acts on sliding tubes; a snap in time has carriages at rest")
    member, x = unsolved(replace(lost, friction=None), lost.load or Load())
    system = TubeMotion(
        problem=member.problem,
        density=known_masses(robot.tubes, "a snap in time needs masses"),
        diameters=np.array([[tube.outer_diameter, tube.inner_diameter] for tube in robot.tubes]),
        relaxation=np.full(robot.n_tubes, tau),
        lateral=bending_inertia,
        between=law,
    )
    landed = member.transfer(Point.at(*unsolved(replace(snap.after, friction=None), lost.load or Load())))
    vibrating = vibrations(system, np.concatenate([landed, lost.rotations]), member.at(landed).hessian)
    jump = snap.after.tip_rotations - lost.tip_rotations
    farthest = int(np.argmax(np.abs(jump)))
    pushed = x if lost.friction is not None else _pushed(member, x)
    start, instants = np.concatenate([pushed, lost.rotations]), list[Instant]()
    steps = motion(system, start, turning, scale=snap.energy_released, tolerance=STEP_TOLERANCE, first=FIRST_STEP)
    for instant in steps:
        instants.append(instant)
        turned = (system.tip_rotations(instant.y) - lost.tip_rotations)[farthest] / jump[farthest]
        if span is None and turned >= RISE[1]:
            span = instant.time + PERIODS / float(vibrating.frequency[0])
        if instant.time >= (LONGEST if span is None else span):
            break
    # Friction may hold the tubes far from where they would go without it.
    held = law is not None and turned < RISE[1]
    end = MotionEnd.MOVING if held else _end(member, instants, landed, snap)
    return replace(_answer(snap, system, instants, vibrating, end, began), given=relaxation is not None)


def _pushed(member: Member[Any], x: Array) -> Array:
    """Unknowns (U,) at a small distance from the lost ones x (U,), on the side that leads down."""
    state = member.at(x)
    direction = member.softest(state)
    push = direction * (PUSH / member.largest_rotation(state, direction))
    return np.asarray(min((x + push, x - push), key=lambda side: member.at(side).potential))


def _end(member: Member[Any], instants: Sequence[Instant], landed: Array, snap: Snap) -> MotionEnd:
    """Status of a motion: the minimum below its last instant is that of the snap, or another one."""
    last = instants[-1].y[: len(landed)]
    if snap.after.friction is not None:
        # Friction holds tubes beside the minimum of the energy, to which both are compared.
        without = slide(replace(member, rotations=snap.after.rotations), landed)
        landed = landed if without is None else without.state.x
    result = slide(replace(member, rotations=instants[-1].y[len(landed) :]), last)
    if result is None:
        return MotionEnd.MOVING
    near = member.largest_rotation(result.state, result.state.x - landed) < SMOOTH_TURN + float(
        np.abs(instants[-1].y[len(landed) :] - snap.rotations).max()
    )
    return MotionEnd.LANDED if near else MotionEnd.ELSEWHERE


class Vibrations(NamedTuple):
    """Small vibrations about an equilibrium, slowest first."""

    frequency: Array
    """Frequencies (K,) without damping, Hz."""
    ratio: Array
    """Damping ratios (K,)."""


def vibrations(system: TubeMotion, y: Array, hessian: Array) -> Vibrations:
    """Slowest vibrations about the stable equilibrium y (Y,), from the second derivative (X, X) of its potential."""
    free, slopes = len(hessian), system.slopes(y)
    rows = slopes.position[:, :free]
    # Of M v = H v / w^2, since H is positive definite and M need not be.
    size, modes = scipy.linalg.eigh(rows.T @ system.mass @ rows, hessian, subset_by_index=(free - MODES, free - 1))
    frequency, mode = 1 / np.sqrt(size[::-1]), modes[:, ::-1]
    damped = np.einsum("ik,ij,jk->k", mode, slopes.damping[:free, :free], mode)
    return Vibrations(frequency / (2 * np.pi), damped * frequency / 2)


def _answer(
    snap: Snap, system: TubeMotion, instants: Sequence[Instant], vibrating: Vibrations, end: MotionEnd, began: float
) -> SnapInTime:
    """Answer from the instants of a motion."""
    at, weight = np.array([each.time for each in instants]), system.problem.torsion.weight
    tangent = np.array([each.position[: 3 * len(weight)] for each in instants]).reshape(len(at), -1, 3)
    tips, turns = np.einsum("a,tak->tk", weight, tangent), np.array([system.tip_rotations(each.y) for each in instants])
    before, after = snap.before.tip_rotations, snap.after.tip_rotations
    k = int(np.argmax(np.abs(after - before)))
    low, high = (_first_time(at, (turns[:, k] - before[k]) / (after[k] - before[k]), part) for part in RISE)
    during = np.flatnonzero(at <= (np.inf if np.isnan(high) else high + 0.5 / float(vibrating.frequency[0])))
    moved = np.diff(system.to_points @ tangent[during], axis=0)
    # What a point sweeps across the arm, in a step.
    across = np.linalg.norm(np.cross(moved, (tangent[during][1:] + tangent[during][:-1]) / 2), axis=2)
    present = system.problem.torsion.assembly.present[system.problem.torsion.section]
    width = (present * system.diameters[:, 0]).max(1)
    volume = float(weight @ (np.pi / 4 * width**2)) + float((across @ (weight * width)).sum())
    kinetic, elastic, load_work, dissipated, drive_work = np.transpose(
        [(each.kinetic, each.elastic, each.load_work, each.dissipated, each.drive_work) for each in instants]
    )
    # The load has done the work of the lost equilibrium before.
    potential = elastic - snap.before.energy - load_work
    total = kinetic + potential + dissipated - drive_work
    released = snap.energy_released
    shown = at[0] if np.isnan(high) else max(float(at[0]), low - BEFORE * (high - low))
    chosen = np.unique(np.minimum(np.searchsorted(at, np.linspace(shown, at[-1], ARMS)), len(at) - 1))
    path = np.linalg.norm(np.diff(tips, axis=0), axis=1)
    return SnapInTime(
        snap=snap,
        time=at,
        tip_position=tips,
        tip_rotations=turns,
        kinetic=kinetic,
        potential=potential,
        dissipated=dissipated,
        drive_work=drive_work,
        duration=high - low,
        peak_speed=float((path / np.diff(at)).max()),
        swept_area=float((across @ weight).sum()),
        swept_volume=volume,
        tip_path=float(path[during[:-1]].sum()),
        frequencies=vibrating.frequency,
        damping_ratios=vibrating.ratio,
        energy_error=float(np.abs(total - total[0]).max() / released),
        relaxation=float(system.relaxation[0]),
        given=False,
        arms=tuple(_arm(snap, system, instants[k].y) for k in chosen),
        arm_times=at[chosen],
        status=end,
        statistics=MotionStatistics(len(at) - 1, time.perf_counter() - began),
    )


def _first_time(at: Array, values: Array, level: float) -> float:
    """First time at which values (T,) at times `at` (T,) reach a level; NaN if they do not."""
    over = np.flatnonzero(values >= level)
    if not len(over) or not over[0]:
        return math.nan
    k = int(over[0])
    return float(np.interp(level, values[k - 1 : k + 1], at[k - 1 : k + 1]))


def _arm(snap: Snap, system: TubeMotion, y: Array) -> Equilibrium:
    """Shape at coordinates y (Y,), as an equilibrium is drawn."""
    shape, alpha = system.shape(y), y[system.problem.size :]
    return replace(
        snap.after, rotations=alpha, arm=shape, tip_rotations=system.tip_rotations(y), margin=math.nan, energy=math.nan
    )
