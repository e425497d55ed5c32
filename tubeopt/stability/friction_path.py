"""Motion along waypoints with dry friction between the tubes: increments, snaps, and where the robot lands.

A state is followed as the nearest minimum of energy and friction together. Where that is lost the robot snaps: it flows
downhill, friction taking its part meanwhile, to where it comes to rest.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy

from ..arguments import typed
from ..block.transcription.contact import evaluate_contact, make_contact
from ..block.transcription.loaded import LoadedProblem, LoadedState, integration_to
from ..block.transcription.orientation import tangent_slopes
from ..display import Displayed
from ..equilibrium.continuation import Family, JointPath, largest_twist
from ..equilibrium.friction import (
    FrictionEquilibrium,
    bent_at,
    carried,
    check_rubbing,
    rest,
    shaken,
    step,
    sweep,
    swept,
    to_held_equilibrium,
)
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.problem import check_load, loading_of
from ..equilibrium.result import Equilibrium, refuse_friction
from ..errors import InputError, SolveError
from ..robots.concentric import Friction
from ..robots.load import Load
from ..robots.robot import Robot
from ..solvers.blas import small
from ..solvers.friction_increment import FRICTION_TOLERANCE, slide, softest
from ..solvers.settings import LARGEST_RATIO
from ..typing import Array
from .certificate import convexity, snap_free_certificate
from .folds import NUDGE
from .motion import SMOOTH_TURN, Snap

SHORTEST = 1e-11
"""Turn of a base (rad), or shift over the longest tube, in a step that fails only where the state is lost."""

UNTOLD = 1e-9
"""Margin whose square is round-off, which tells of no fold."""


# The state moves by the square root of the distance to a fold. Newton's method shrinks its steps enough
# (`LARGEST_RATIO`) over up to 0.75 of that distance.
TOWARDS_FRICTION_FOLD = 0.72
"""Fraction of the distance to a fold with friction that one step covers."""

PAST_LAST = 1e4
"""Shortest steps between the last state before a snap and the joint values at which the robot flows on from it."""

LANDED_STEP = 1e-3
"""Fraction of the longest step that the first step after a snap takes, also on a path that is shorter."""

# Rows that let go one after another move by less, the finer the mesh is: only short steps may be such a hop.
HOP = 0.1
"""Fraction of the longest step below which a state that only friction holds may hop."""

WAYPOINTS = 256
"""Waypoints that the compiled kernel gets at once."""


class Stride:
    """The length `size` of the next step, a fraction of a path.

    Towards a fold at t_f the square of the margin goes to 0 as t_f - t does: two states tell where it is.
    """

    def __init__(self, family: Family) -> None:
        self.longest = family.path.largest_step()
        self.shortest = min(SHORTEST / max(family.span(), SHORTEST), LANDED_STEP * self.longest)
        self.size, self._halted, self._wall = self.longest, False, 0.0
        self._before: tuple[float, FrictionEquilibrium] | None = None

    def failed(self, t: float, current: FrictionEquilibrium, at: float) -> bool:
        """After a step from a state at t to `at` that failed: whether there is a shorter one, which is `size` now."""
        step, ahead = at - t, self._ahead(t, current)
        self.size = max(self.shortest, ahead if ahead < 0.9 * step else step / 4)
        self._halted, self._wall = True, at
        return step > 2 * self.shortest

    def went(self, t: float, current: FrictionEquilibrium, at: float, there: FrictionEquilibrium) -> None:
        """After a step from a state at t to another."""
        self._before = (t, current)
        grown = self.size if self._halted else min(2 * self.size, self.longest)
        near = self._ahead(at, there) if at < self._wall else grown
        self.size, self._halted = max(self.shortest, near if near < grown else grown), False

    def landed(self) -> None:
        """After the state was another one at once."""
        self.size = max(self.size, LANDED_STEP * self.longest)
        self._halted, self._wall, self._before = False, 0.0, None

    def _ahead(self, t: float, current: FrictionEquilibrium) -> float:
        """Largest fraction of the path from a state at t to the fold that the last two states predict, or infinity."""
        if self._before is None or current.held_margin < UNTOLD:
            return float("inf")
        s, earlier = self._before
        soft, softer = earlier.held_margin**2, current.held_margin**2
        return TOWARDS_FRICTION_FOLD * (t - s) * softer / (soft - softer) if softer < soft else float("inf")


NOWHERE = np.zeros(0)
"""No stations behind the tip."""


@dataclass(frozen=True, eq=False)
class RubbingSnap:
    """A snap at a fraction of a segment, from one state to another; energy in J."""

    fraction: float
    before: FrictionEquilibrium
    after: FrictionEquilibrium


def rubbing_legs(
    robot: Robot, joints: Array, friction: Friction, start: Equilibrium | None, load: Load | None
) -> Iterator[tuple[FrictionEquilibrium | Callable[[], FrictionEquilibrium], list[Snap]]]:
    """The state at every waypoint (T, 2n), or what tells it, and the snaps on the path to it."""
    current = rubbing_start(robot, joints[0], friction, start, load)
    at_start = np.allclose(np.concatenate([current.rotations, current.translations]), joints[0], rtol=0, atol=1e-12)
    if not at_start or current.contact.load != load:
        current, _ = rubbing_leg(robot, current, joints[0], load)
    yield current, []
    k = 1
    while k < len(joints):
        rows = joints[k - 1 : k + WAYPOINTS]
        many = sweep(robot, current, rows, NOWHERE, margins=False) if load is None else None
        count = 0 if many is None else len(many.margin)
        if many is not None and count:
            yield from ((partial(swept, robot, current, rows, many, j), []) for j in range(1, count + 1))
            current, k = swept(robot, current, rows, many, count), k + count
        if count < len(rows) - 1:  # where the kernel gives up, a step with more care
            current, snaps = rubbing_leg(robot, current, joints[k], load)
            yield current, [_told(robot, snap, k - 1) for snap in snaps]
            k += 1


def _told(robot: Robot, snap: RubbingSnap, index: int) -> Snap:
    before, after = (
        to_held_equilibrium(robot, side, how) for side, how in ((snap.before, "fold"), (snap.after, "flow"))
    )
    return Snap(index, snap.fraction, before, after)


def rubbing_start(
    robot: Robot, joints: Array, friction: Friction, start: Equilibrium | None = None, load: Load | None = None
) -> FrictionEquilibrium:
    """The state in which a motion with friction begins: by default at joint values (2n,) under a load."""
    check_rubbing(robot, friction)
    if load is not None:
        load.require_energy("motion with friction is not known")
    first = start if start is not None else forward_kinematics(robot, *np.split(joints, 2), load=load)
    current = rest(robot, first, friction)
    if current.held_margin <= 0:
        raise InputError(
            f"start has margin {current.held_margin:.3g}; it must be a stable equilibrium (margin above 0)"
        )
    return current


def rubbing_leg(
    robot: Robot, current: FrictionEquilibrium, goal: Array, load: Load | None = None
) -> tuple[FrictionEquilibrium, list[RubbingSnap]]:
    """The state at other joint values (2n,) and under another load, on a straight path, and the snaps on it."""
    snaps: list[RubbingSnap] = []
    path = JointPath(robot, np.concatenate([current.rotations, current.translations]), goal)
    for result in _along(Family(path, load, current.contact.load), current):
        current = result.after if isinstance(result, RubbingSnap) else result
        snaps += [result] if isinstance(result, RubbingSnap) else []
    return current, snaps


def _along(family: Family, current: FrictionEquilibrium) -> Iterator[FrictionEquilibrium | RubbingSnap]:
    """States along a straight path of joint values and load, and snaps; the last is at its end."""
    t, far, stride = 0.0, -1.0, Stride(family)
    for goal in family.path.events():
        while t < goal:
            at = goal if t + stride.size >= goal - 1e-12 else t + stride.size
            there = _near(family, current, at)
            if there is not None:
                yield there
                stride.went(t, current, at, there)
                t, current = at, there
                continue
            shorter = stride.failed(t, current, at)
            # What friction alone holds lets go row by row, in hops that a fine mesh would make small. Where a hop
            # goes far, a snap lies before it.
            if current.margin <= 0 and stride.size < HOP * stride.longest and t >= far:
                there = _flowed(family, current, at, pushed=False)
                if there is None or _distance(current, there) > SMOOTH_TURN:
                    there, far = None, at
            if there is None and shorter:
                continue
            if there is None:
                at, far = min(goal, t + PAST_LAST * stride.shortest), -1.0
                there = _flowed(family, current, at, pushed=True)
                if there is None:
                    raise SolveError(
                        f"the motion with friction is lost at {100 * at:.3f} % of the path: "
                        f"no state satisfies the friction law to {FRICTION_TOLERANCE:g}"
                    )
                if _distance(current, there) > SMOOTH_TURN:
                    yield RubbingSnap(t, current, there)
            t, current = at, there
            stride.landed()
    yield current


def _near(family: Family, current: FrictionEquilibrium, t: float) -> FrictionEquilibrium | None:
    """The state at fraction t next to another; None where the step is too long for it, or it is lost."""
    there = step(family.path.robot, current, *family.path.at(t), family.load_at(t))
    if there is None or there.found.contraction > LARGEST_RATIO:
        return None
    far = _distance(current, there)
    return there if far <= largest_twist(0.0) or far <= largest_twist(current.held_margin) else None


def _distance(a: FrictionEquilibrium, b: FrictionEquilibrium) -> float:
    """Largest difference of two states at the points of the second, rad: of the twist theta - alpha, and under a load
    of the turn of the arm if its curvature changed alike all along it."""
    problem = b.contact.problem
    before = a.found.state.elastic.theta if a.contact is b.contact else a.theta(problem.arc_length)
    change = ((b.found.state.elastic.theta - b.rotations) - (before - a.rotations)).ravel()[problem.flat]
    bent, old = bent_at(b, b.contact), bent_at(a, b.contact)
    if bent is not None and old is not None:
        change = np.append(change, problem.assembly.total_length * (bent - old))
    return float(np.abs(change).max(initial=0.0))


def _flowed(family: Family, current: FrictionEquilibrium, t: float, *, pushed: bool) -> FrictionEquilibrium | None:
    """Where the robot flows to by itself, or with a push from a state that is no equilibrium any more; None where that
    is not found."""
    (rotations, translations), load = family.path.at(t), family.load_at(t)
    contact, before, x = carried(family.path.robot, current, rotations, translations, load)
    push = None
    if pushed and contact is current.contact:
        push = NUDGE * softest(contact, current.found.state, current.found.signs)
    elif pushed:  # on another mesh the softest direction is that of the state carried over
        state = evaluate_contact(contact, rotations, x)
        push = NUDGE * softest(contact, state, np.ones(len(before), dtype=np.int8))
    landed = slide(contact, rotations, x, before, push)
    return (
        None
        if landed is None
        else FrictionEquilibrium(contact, rotations, translations, landed[0], current.heat + landed[1])
    )


# --- Band of friction -------------------------------------------------------------------------------------------------

# How far friction can hold an arm from where it would be without, whatever its history: bounds without a path.
#
# Every state with friction obeys grad E + P' lam = 0 with |lam| <= D, E the potential energy of torsion and bending
# under the load, if any. To first order around the equilibrium without friction a place p moves by -J H^-1 P' lam, so
# by at most |J H^-1 P'| D along each axis. A bound that is none of first order follows where the energy is convex at
# these joint values, H >= mu > 0 (the snap-free certificate, under a force on the tip that for all forces of its size):
# then |x - x0| <= |P' lam| / mu, and with m_i = kb_i kappa_i, K = sum kb_i, u = u_natural(theta) + w
#
#     |P' lam|^2 <= D' |P P'| D
#     |p - p0| <= int |u - u0| (s_p - s) ds <= int (sum_i (|m_i| / K) |theta_i - theta_i0| + |w - w0|) (s_p - s) ds


@dataclass(frozen=True, eq=False)
class FrictionBand(Displayed):
    """Region of equilibria that friction allows for an arm, at M points along it."""

    equilibrium: Equilibrium
    """Equilibrium without friction."""
    friction: Friction
    """The friction."""
    certificate: float
    """Certificate of convexity at these translations; under a tip force, that for all forces of its size. -inf under
    other loads, and under a force with tubes made of pieces.
    """
    first_order: Array
    """(M, 3) half widths along the axes of the plate, m, true for small friction only."""
    guaranteed: Array
    """(M,) radius around the equilibrium that no state at these joint values leaves, m; inf where the certificate is
    not positive."""

    @property
    def tip_half_widths(self) -> Array:
        """(3,) of the tip, m, to first order."""
        return np.asarray(self.first_order[-1])

    @property
    def tip_radius(self) -> float:
        """Guaranteed largest displacement of the tip by friction, m."""
        return float(self.guaranteed[-1])


@typed
@small
def friction_band(equilibrium: Equilibrium, friction: Friction) -> FrictionBand:
    """Largest displacement that friction allows from an equilibrium without friction, for any history; concentric
    robots.

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
    check_rubbing(robot, friction)
    refuse_friction(equilibrium)
    shift, load = tuple(equilibrium.translations.tolist()), equilibrium.load or Load()
    check_load(robot, load, shift)
    load.require_energy("there is no least energy around which friction could be bounded")
    assembly, loading = loading_of(robot, shift, load)
    current = shaken(make_contact(assembly, friction, loading), equilibrium)
    contact, state, problem = current.contact, current.found.state, current.contact.loaded
    assert problem is not None
    assert isinstance(state.elastic, LoadedState)
    response = scipy.linalg.solve(state.hessian, contact.rows.T, assume_a="sym")
    slopes = _place_slopes(equilibrium.arc_length, problem, state.elastic)
    first = np.abs(slopes @ response[: problem.size]) @ contact.capacity
    certificate = _convexity(equilibrium, load)
    push = contact.capacity @ np.abs(contact.rows @ contact.rows.T) @ contact.capacity
    guaranteed = np.full(len(equilibrium.arc_length), np.inf)
    if certificate > 0:
        guaranteed = _levers(equilibrium, problem) * (np.sqrt(push) / certificate)
    return FrictionBand(equilibrium, friction, certificate, first, guaranteed)


def _convexity(equilibrium: Equilibrium, load: Load) -> float:
    """Lower bound of the second variation of the energy at any shape and rotations, relative to its elastic part."""
    robot, shift = equilibrium.robot, equilibrium.translations
    if not load.tip_force_only:
        return -np.inf
    force = float(np.linalg.norm(load.force))
    return snap_free_certificate(robot, shift, max_force=force) if force else convexity(robot, shift)


def _place_slopes(arc_length: Array, problem: LoadedProblem, state: LoadedState) -> Array:
    """(M, 3, X) change of the points along the arm with torsion and bending."""
    weights, along = np.array([integration_to(problem, s) for s in arc_length.tolist()]), state.orientation
    moved = (tangent_slopes(along.stage) @ along.stage_slope).reshape(len(along.stage), -1)
    return np.asarray((weights @ moved).reshape(len(weights), 3, -1) @ state.turned)


def _levers(equilibrium: Equilibrium, loaded: LoadedProblem) -> Array:
    """(M,) how far a point moves at most per unit of |(z, q)|."""
    problem = loaded.torsion
    pull = problem.moment / np.maximum(problem.stiffness.sum(1), 1e-300)[:, None]
    point, tube = problem.point, problem.tube
    reach = np.maximum(equilibrium.arc_length[:, None] - problem.arc_length, 0.0)
    weights = (np.abs(pull) * problem.weight[:, None])[point, tube] * reach[:, point]
    compliance = np.abs(problem.factor @ problem.factor.T)
    squares = np.einsum("ma,ab,mb->m", weights, compliance, weights)
    if equilibrium.load is not None:  # without one w is 0, whatever rubs
        squares += ((reach * problem.weight * loaded.softness) ** 2).sum(1)
    return np.asarray(np.sqrt(squares))
