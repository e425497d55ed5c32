"""Motion along waypoints with dry friction between the tubes, and bounds on the effect of friction.

Each increment goes to the nearest minimum of energy and friction work together. Where that minimum vanishes the robot
snaps: it flows downhill, against friction, until it comes to rest.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
import scipy

from ..arguments import typed
from ..block.transcription.bundle import bundle_arm
from ..block.transcription.contact import largest_capacity, make_contact
from ..block.transcription.loaded import LoadedState, integration_to
from ..block.transcription.orientation import position_slopes
from ..display import Displayed
from ..equilibrium.continuation import Family, SampledJointPath, distance_to_end, largest_twist
from ..equilibrium.friction import (
    BundleFriction,
    FrictionEquilibrium,
    bent_at,
    rest,
    shaken,
    start_increment,
    step,
    sweep,
    swept,
    to_held_equilibrium,
    validate_friction,
)
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.problem import check_load, loading_of
from ..equilibrium.result import Equilibrium, refuse_contact
from ..errors import InputError, SolveError
from ..robots.concentric import Friction
from ..robots.eccentric import BundleRobot
from ..robots.load import Load
from ..robots.robot import Robot
from ..solvers.blas import small
from ..solvers.compiled.friction import FrictionStates
from ..solvers.friction_increment import FRICTION_TOLERANCE, slide, softest
from ..solvers.settings import LARGEST_RATIO
from ..typing import Array
from .certificate import convexity, snap_free_certificate
from .folds import NUDGE
from .motion import SMOOTH_TURN, Snap

SHORTEST = 1e-11
"""Shortest step: rotation of a joint (rad), or translation over the longest tube. If it fails, the state vanishes."""

MIN_MARGIN = 1e-9
"""Smallest margin that predicts a fold; the square of a smaller one is round-off."""

# The state moves by the square root of the distance to a fold. Newton's method shrinks its steps enough
# (`LARGEST_RATIO`) over up to 0.75 of that distance.
TOWARDS_FRICTION_FOLD = 0.72
"""Fraction of the distance to a fold with friction that one step covers."""

PAST_LAST = 1e4
"""Distance, in shortest steps, from the last state before a snap to the joint values of the flow after it."""

LANDED_STEP = 1e-3
"""First step after a snap, as a fraction of the longest step, also where that is longer than the path."""

# Contact rows that let go one after another move less on a finer mesh: only short steps may be such hops.
HOP = 0.1
"""Fraction of the longest step below which a state that only friction holds may hop."""

WAYPOINTS = 256
"""Number of waypoints in one call of the compiled kernel."""


class StepLength:
    """Adaptive length of the next step, as a fraction of the path.

    Towards a fold at t_f, margin^2 falls linearly in t_f - t: the last two states predict t_f.
    """

    def __init__(self, family: Family) -> None:
        self.longest = family.path.largest_step()
        self.shortest = min(SHORTEST / max(family.span(), SHORTEST), LANDED_STEP * self.longest)
        self.size, self._just_failed, self._failed_at = self.longest, False, 0.0
        self._before: tuple[float, FrictionEquilibrium] | None = None

    def reject(self, t: float, current: FrictionEquilibrium, t_next: float) -> bool:
        """Shorten the next step after a failed step from t to `t_next`; False if it cannot be shorter."""
        step, to_fold = t_next - t, self._to_fold(t, current)
        self.size = max(self.shortest, to_fold if to_fold < 0.9 * step else step / 4)
        self._just_failed, self._failed_at = True, t_next
        return step > 2 * self.shortest

    def accept(self, t: float, current: FrictionEquilibrium, t_next: float, state: FrictionEquilibrium) -> None:
        """Choose the next step after a successful one from `current` at t to `state` at `t_next`."""
        self._before = (t, current)
        longer = self.size if self._just_failed else min(2 * self.size, self.longest)
        to_fold = self._to_fold(t_next, state) if t_next < self._failed_at else longer
        self.size, self._just_failed = max(self.shortest, min(to_fold, longer)), False

    def restart(self) -> None:
        """Choose the next step after a snap."""
        self.size = max(self.size, LANDED_STEP * self.longest)
        self._just_failed, self._failed_at, self._before = False, 0.0, None

    def _to_fold(self, t: float, current: FrictionEquilibrium) -> float:
        """Longest step from a state at t towards the fold that the last two states predict, or infinity."""
        if self._before is None or current.held_margin < MIN_MARGIN:
            return float("inf")
        t_before, before = self._before
        return TOWARDS_FRICTION_FOLD * distance_to_end(t - t_before, before.held_margin, current.held_margin, 2)


@dataclass(frozen=True, eq=False)
class FrictionSnap:
    """Snap at a fraction of a segment."""

    fraction: float
    before: FrictionEquilibrium
    after: FrictionEquilibrium


def segments_with_friction(
    robot: Robot, joints: Array, friction: Friction, start: Equilibrium | None, load: Load | None
) -> Iterator[tuple[FrictionEquilibrium | Callable[[], FrictionEquilibrium], list[Snap]]]:
    """State at every waypoint (T, 2n), or a function that computes it, and the snaps on the segment to it."""
    current = start_with_friction(robot, joints[0], friction, start, load)
    at_start = np.allclose(np.concatenate([current.rotations, current.translations]), joints[0], rtol=0, atol=1e-12)
    if not at_start or current.load != load:
        current, _ = segment_with_friction(robot, current, joints[0], load)
    yield current, []
    for part in follow_with_friction(robot, joints, current, load):
        if part.states is None:
            yield part.end, [_to_snap(robot, part.first - 1, snap) for snap in part.snaps]
        else:
            yield from ((partial(swept, robot, part.start, part.rows, part.states, j), []) for j in part.numbers)


def _to_snap(robot: Robot, segment: int, snap: FrictionSnap) -> Snap:
    """Snap of a path on the segment from a row."""
    before, after = to_held_equilibrium(robot, snap.before, "fold"), to_held_equilibrium(robot, snap.after, "flow")
    return Snap(segment, snap.fraction, before, after)


class FollowedRows(NamedTuple):
    """Consecutive rows of a path of joint values that were followed with friction."""

    first: int
    """Number of the first of these rows."""
    rows: Array
    """Joint values (m, 2n), from the row before."""
    start: FrictionEquilibrium
    """State at the row before."""
    end: FrictionEquilibrium
    """State at the last of them."""
    states: FrictionStates | None
    """States of the compiled kernel; None for one row that step-length control reached."""
    snaps: Sequence[FrictionSnap]

    @property
    def numbers(self) -> range:
        """Numbers of the states in `rows`."""
        return range(1, 1 + (1 if self.states is None else len(self.states.margin)))


def follow_with_friction(
    robot: Robot,
    joints: Array,
    current: FrictionEquilibrium,
    load: Load | None = None,
    *,
    stations: Array | None = None,
    margins: bool = False,
    compiled: bool = True,
) -> Iterator[FollowedRows]:
    """Parts of a motion through rows (T, 2n), from a state at the first row.

    Args:
        stations, margins: what `sweep` returns of its states.
        compiled: False to follow all rows with step-length control.
    """
    k, stations = 1, np.zeros(0) if stations is None else stations
    compiled = compiled and load is None and robot.fixed_sections
    while k < len(joints):
        rows = joints[k - 1 : k + WAYPOINTS]
        states = sweep(robot, current, rows, stations, margins=margins) if compiled else None
        count = 0 if states is None else len(states.margin)
        if states is not None and count:
            end = swept(robot, current, rows, states, count)
            yield FollowedRows(k, rows, current, end, states, ())
            current, k = end, k + count
        # Where the kernel stops, one segment is followed with step-length control.
        if count < len(rows) - 1:
            end, snaps = segment_with_friction(robot, current, joints[k], load)
            yield FollowedRows(first=k, rows=joints[k - 1 : k + 1], start=current, end=end, states=None, snaps=snaps)
            current, k = end, k + 1


def start_with_friction(
    robot: Robot, joints: Array, friction: Friction, start: Equilibrium | None = None, load: Load | None = None
) -> FrictionEquilibrium:
    """Start state of a motion with friction, from `start` or by default from the equilibrium at joint values (2n,).

    Raises:
        InputError: an unstable start, a load without an energy, friction for another robot.
    """
    validate_friction(robot, friction)
    if load is not None:
        load.require_energy("motion with friction is not known")
    first = start if start is not None else forward_kinematics(robot, *np.split(joints, 2), load=load)
    current = rest(robot, first, friction)
    if current.held_margin <= 0:
        raise InputError(
            f"start has margin {current.held_margin:.3g}; it must be a stable equilibrium (margin above 0)"
        )
    return current


def segment_with_friction(
    robot: Robot, current: FrictionEquilibrium, goal: Array, load: Load | None = None
) -> tuple[FrictionEquilibrium, list[FrictionSnap]]:
    """State after a straight motion to joint values (2n,) and another load, and the snaps on it."""
    snaps: list[FrictionSnap] = []
    path = SampledJointPath(robot, np.concatenate([current.rotations, current.translations]), goal)
    for result in _along(Family(path, load, current.load), current):
        if isinstance(result, FrictionSnap):
            snaps.append(result)
            current = result.after
        else:
            current = result
    return current, snaps


def _along(family: Family, current: FrictionEquilibrium) -> Iterator[FrictionEquilibrium | FrictionSnap]:
    """States along a straight path of joint values and load, and snaps; the last is at its end.

    Each step takes the state next to the last one. If no step is short enough for that, the robot flows on: by itself
    where friction alone holds it, else with a push. A flow of more than `SMOOTH_TURN` is a snap.
    """
    t, snap_before, step = 0.0, -1.0, StepLength(family)
    for goal in family.events():
        while t < goal:
            t_next = goal if t + step.size >= goal - 1e-12 else t + step.size
            state = _next_state(family, current, t_next)
            if state is not None:
                yield state
                step.accept(t, current, t_next, state)
                t, current = t_next, state
                continue
            can_shorten = step.reject(t, current, t_next)
            # A state that only friction holds lets go row by row, in hops that a finer mesh would make smaller. A hop
            # that goes far has a snap before it: up to there, no hops.
            if current.margin <= 0 and step.size < HOP * step.longest and t >= snap_before:
                state = _flow(family, current, t_next, pushed=False)
                if state is None or _distance(current, state) > SMOOTH_TURN:
                    state, snap_before = None, t_next
            if state is None and can_shorten:
                continue
            if state is None:
                t_next, snap_before = min(goal, t + PAST_LAST * step.shortest), -1.0
                state = _flow(family, current, t_next, pushed=True)
                if state is None:
                    raise SolveError(
                        f"the motion with friction is lost at {100 * t_next:.3f} % of the path: "
                        f"no state satisfies the friction law to {FRICTION_TOLERANCE:g}"
                    )
                if _distance(current, state) > SMOOTH_TURN:
                    yield FrictionSnap(t, current, state)
            t, current = t_next, state
            step.restart()
    yield current


def _next_state(family: Family, current: FrictionEquilibrium, t: float) -> FrictionEquilibrium | None:
    """State at fraction t close to the current one; None if the step is too long or the state vanishes."""
    state = step(family.path.robot, current, *family.path.at(t), family.load_at(t))
    if state is None or state.increment.contraction > LARGEST_RATIO:
        return None
    distance = _distance(current, state)
    # The margin is only computed where the limit for the softest state is exceeded.
    return state if distance <= largest_twist(0.0) or distance <= largest_twist(current.held_margin) else None


def _distance(a: FrictionEquilibrium, b: FrictionEquilibrium) -> float:
    """Largest difference between two states at the points of the second, in twist theta - alpha and in bending, rad.

    Bending is measured by the rotation of the arm if its curvature changed everywhere by the same amount.
    """
    if isinstance(a, BundleFriction) and isinstance(b, BundleFriction):
        return b.member.distance(a.point, b.increment.state.elastic)
    problem = b.contact.problem
    theta_a = a.increment.state.elastic.theta if a.contact.problem is problem else a.theta(problem.arc_length)
    change = ((b.increment.state.elastic.theta - b.rotations) - (theta_a - a.rotations)).ravel()[problem.flat]
    bending_b, bending_a = bent_at(b, b.contact), bent_at(a, b.contact)
    if bending_b is not None and bending_a is not None:
        change = np.append(change, problem.assembly.total_length * (bending_b - bending_a))
    return float(np.abs(change).max(initial=0.0))


def _flow(family: Family, current: FrictionEquilibrium, t: float, *, pushed: bool) -> FrictionEquilibrium | None:
    """State at rest after the energy flow at fraction t, on its own or after a push in the softest direction.

    None if the flow does not end in a state.
    """
    (rotations, translations), load = family.path.at(t), family.load_at(t)
    contact, before, x = start_increment(family.path.robot, current, rotations, translations, load)
    push = None
    if pushed and contact.problem is current.contact.problem:
        push = NUDGE * softest(current.increment.state, current.increment.signs)
    elif pushed:  # on another mesh the softest direction is that of the state carried over
        push = NUDGE * softest(contact.evaluate(rotations, x), np.ones(len(before), dtype=np.int8))
    landed = slide(contact, rotations, x, before, push)
    if landed is None:
        return None
    if isinstance(current, BundleFriction):
        state, joints = landed.increment.state, (rotations, translations)
        member = replace(current.member, problem=state.elastic.problem, rotations=rotations, robot=family.path.robot)
        member = replace(member, translations=tuple(translations.tolist()))
        return BundleFriction(state.contact, *joints, landed.increment, current.heat + landed.heat, member=member)
    return FrictionEquilibrium(contact, rotations, translations, landed.increment, current.heat + landed.heat)


# --- Band of friction -------------------------------------------------------------------------------------------------

# Bounds on the displacement of an arm by friction, for every history.
#
# Every state with friction obeys grad E + P' lam = 0 with |lam| <= D, E the potential energy of torsion and bending
# under the load, if any. To first order around the equilibrium without friction a point p moves by -J H^-1 P' lam, so
# by at most |J H^-1 P'| D along each axis. A bound of any order follows where the energy is convex at these joint
# values, H >= mu > 0 (mu: the snap-free certificate; under a tip force the one for all forces of its size): then
# |x - x0| <= |P' lam| / mu, and with m_i = kb_i kappa_i, K = sum kb_i, u = u_natural(theta) + w
#
#     |P' lam|^2 <= D' |P P'| D
#     |p - p0| <= int |u - u0| (s_p - s) ds <= int (sum_i (|m_i| / K) |theta_i - theta_i0| + |w - w0|) (s_p - s) ds


@dataclass(frozen=True, eq=False)
class FrictionBand(Displayed):
    """Region of equilibria that friction allows for an arm, at M points along it."""

    equilibrium: Equilibrium
    """Centre: equilibrium without friction."""
    friction: Friction
    """Friction between the tubes."""
    certificate: float
    """Convexity of the energy at these translations; under a tip force, for all forces of its size.

    -inf under other loads, and under a force with tubes made of pieces.
    """
    first_order: Array
    """(M, 3) half widths along the axes of the plate, m; valid for small friction only."""
    guaranteed: Array
    """(M,) proved radius around the equilibrium for every history, m; inf if the certificate is not positive."""

    @property
    def tip_half_widths(self) -> Array:
        """(3,) half widths at the tip, m, to first order."""
        return np.asarray(self.first_order[-1])

    @property
    def tip_radius(self) -> float:
        """Guaranteed largest displacement of the tip by friction, m."""
        return float(self.guaranteed[-1])


@typed
@small
def friction_band(equilibrium: Equilibrium, friction: Friction) -> FrictionBand:
    """Largest displacement that friction allows from an equilibrium without friction, for any history.

    The robot must be concentric, or a bundle, for which nothing is guaranteed beyond first order.

    Raises:
        InputError: an equilibrium under friction, or under a load without an energy; a friction for another robot, an
            eccentric robot.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> pose = tubeopt.forward_kinematics(robot, [0.0, 1.0, 2.0])
        >>> band = tubeopt.friction_band(pose, tubeopt.Friction(torque=0.001))
        >>> bool(band.tip_radius > 0)
        True
    """
    robot = equilibrium.robot
    validate_friction(robot, friction)
    refuse_contact(equilibrium)
    if isinstance(robot, BundleRobot):
        return _bundle_band(equilibrium, friction)
    shift, load = tuple(equilibrium.translations.tolist()), equilibrium.load or Load()
    check_load(robot, load, shift)
    load.require_energy("there is no least energy around which friction could be bounded")
    assembly, loading = loading_of(robot, shift, load)
    current = shaken(make_contact(assembly, friction, loading), equilibrium)
    contact, state, problem = current.contact, current.increment.state, current.contact.loaded
    assert problem is not None
    assert isinstance(state.elastic, LoadedState)
    torsion = problem.torsion

    # First order: points move by -J H^-1 P' lam, with |lam| at most the capacity D.
    response = scipy.linalg.solve(state.hessian, state.rows.T, assume_a="sym")
    weights = np.array([integration_to(problem, s) for s in equilibrium.arc_length.tolist()])
    slopes = position_slopes(state.elastic.orientation, weights) @ state.elastic.curvature_slope
    first_order = np.abs(slopes @ response[: problem.size]) @ contact.capacity

    # Any order: |x - x0| <= |P' lam| / mu, where the energy is convex with the constant mu.
    force = float(np.linalg.norm(load.force))
    if not load.tip_force_only:
        certificate = -np.inf
    elif force:
        certificate = snap_free_certificate(robot, equilibrium.translations, max_force=force)
    else:
        certificate = convexity(robot, equilibrium.translations)
    guaranteed = np.full(len(equilibrium.arc_length), np.inf)
    # A load has bending moments without a known bound, and friction may grow with them.
    bounded = equilibrium.load is None or not contact.growth.any()
    if certificate > 0 and bounded:
        capacity = largest_capacity(contact)
        push = capacity @ np.abs(contact.rows @ contact.rows.T) @ capacity
        # |p - p0| <= int |u - u0| (s_p - s) ds by Cauchy's inequality, in the norm of the whitened unknowns.
        natural = torsion.moment / np.maximum(torsion.stiffness.sum(1), 1e-300)[:, None]
        reach = np.maximum(equilibrium.arc_length[:, None] - torsion.arc_length, 0.0)
        lever = (np.abs(natural) * torsion.weight[:, None])[torsion.point, torsion.tube] * reach[:, torsion.point]
        squares = np.einsum("ma,ab,mb->m", lever, np.abs(torsion.factor @ torsion.factor.T), lever)
        if equilibrium.load is not None:  # without a load w stays 0 under friction
            squares += ((reach * torsion.weight * problem.softness) ** 2).sum(1)
        guaranteed = np.sqrt(squares) * (np.sqrt(push) / certificate)
    return FrictionBand(equilibrium, friction, certificate, np.asarray(first_order), guaranteed)


def _bundle_band(equilibrium: Equilibrium, friction: Friction) -> FrictionBand:
    """Band of a bundle: to first order, at the same fractions of the elements of its mesh."""
    load = equilibrium.load
    if load is not None:
        load.require_energy("there is no least energy around which friction could be bounded")
    current = rest(equilibrium.robot, equilibrium, friction)
    state = current.increment.state
    response = scipy.linalg.solve(state.hessian, state.rows.T, assume_a="sym") * state.capacity
    # Positions are smooth in x: a central difference of a turn of 1e-4 rad is exact to 1e-8 of the band.
    first_order = np.zeros((len(bundle_arm(current.rotations, state.elastic).arc_length), 3))
    for column in response.T:
        step = column * (1e-4 / max(state.contact.largest_rotation(column), 1e-300))
        ahead, behind = (
            bundle_arm(current.rotations, state.contact.evaluate(current.rotations, state.x + sign * step).elastic)
            for sign in (1.0, -1.0)
        )
        first_order += (
            np.abs(ahead.position - behind.position) / 2 * float(np.linalg.norm(column) / np.linalg.norm(step))
        )
    unbounded = np.full(len(first_order), np.inf)
    return FrictionBand(equilibrium, friction, -np.inf, first_order, unbounded)
