"""Stroke force: the largest force of the tip along its own direction, and its derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..arguments import typed
from ..block.transcription.bundle import BundleState, opened, rearranged
from ..block.transcription.mesh import section_needs
from ..equilibrium.bundle import APART, Bundled
from ..equilibrium.jacobian import STEP, Change, Difference, Posed, change_by, difference_of
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.linearised_bundle import LinearisedBundle, bordered_response, linearise_bundle
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError, positive
from ..robots.eccentric import BundleRobot
from ..robots.load import Load
from ..robots.robot import Robot
from ..solvers.blas import small
from ..solvers.time_limit import TIME_LIMIT, limited
from ..typing import Array
from .folds import Loss
from .load_limit import LoadLimit, find_load_limit, find_loss


@typed
@small
@limited
def find_stroke_force(
    robot: Robot,
    rotations: ArrayLike,
    translations: ArrayLike | None = None,
    *,
    equilibrium: Equilibrium | None = None,
    up_to: float = 10.0,
    time_limit: float = TIME_LIMIT,
) -> LoadLimit | None:
    """Largest force of the tip along its own direction, as a load limit; None if it withstands `up_to`, N.

    The reaction acts along the initial direction of the tip and keeps that direction; the tip is free to move. At the
    limit the robot buckles or snaps, see `find_load_limit`; its `factor` is the force, N. A planar arm buckles out of
    its plane. Most other arms have no limit: they bend ever further without instability. Then the displacement counts
    (`compliance`, `tip_deflection` of designs).

    Args:
        rotations, translations: (n,) rad and m; translations None for home.
        equilibrium: stable, unloaded equilibrium at the start; by default that of `forward_kinematics`.
        up_to: largest force to search, N.
        time_limit: maximum run time, s.

    Raises:
        InputError, SolveError: as `find_load_limit`.
        TimeLimitError: (a SolveError) the time limit was reached before there was an answer.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> limit = tubeopt.find_stroke_force(robot, [0.0, 0.0, 0.0])
        >>> round(1e3 * limit.factor), limit.kind
        (125, 'bifurcation')
    """
    positive("up_to", up_to)
    first = equilibrium if equilibrium is not None else forward_kinematics(robot, rotations, translations)
    if first.load is not None:
        raise InputError("equilibrium is loaded or unstable; it must be unloaded and stable")
    if not float(first.arc_length[-1]) > 0:
        raise InputError("no tube is in front of the base plate; there is no arm to push")
    unit, load = _push(first, up_to)
    limit = find_load_limit(
        robot, rotations, translations, load, equilibrium=first, up_to=float(np.divide(up_to, unit))
    )
    return None if limit is None else replace(limit, factor=limit.factor * unit)


def _push(first: Equilibrium, up_to: float) -> tuple[float, Load]:
    """Force against the tip, N, near the buckling load of the weakest part as a column of the whole length."""
    robot, length = first.robot, float(first.arc_length[-1])
    if isinstance(robot, BundleRobot):
        weakest = robot.sheath_stiffness + min(tube.bending_stiffness for tube in robot.tubes)
    else:
        weakest = float(section_needs(robot.assembly(first.translations)).stiffness.min())
    unit = min(up_to, 1.1 * weakest / length**2)
    return unit, Load(tuple((-unit * first.tip_rotation[:, 2]).tolist()))


SYMMETRY_BREAKING = 1e-6
"""Cosine between a change of the equations and the direction of buckling above which it breaks the symmetry."""


AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
"""Forces of 1 N along the world axes."""

BREAKS_SYMMETRY = "a stroke force has no derivative with respect to variables that break the symmetry of buckling"


@dataclass(frozen=True, eq=False)
class Varied:
    """Robot that changes with a parameter, at fixed joint values."""

    step: float
    """Step of the central difference, in the unit of the parameter."""
    robots: tuple[Robot, Robot]
    """Robots at plus and minus one step."""
    rotation: Array
    """(3,) rotation vector of the tip per unit of the parameter, rad."""


@small
def stroke_slopes(
    first: Equilibrium,
    wrt: Sequence[str],
    up_to: float = 10.0,
    *,
    varied: Sequence[Varied] = (),
    along: Array | None = None,
) -> tuple[float, Array] | None:
    """Stroke force of a stable equilibrium without load, N, and its derivatives (Q,); None as `find_stroke_force`.

    Derivatives are with respect to joint values and dimensions, n for each name of `wrt`, per SI unit, then the
    parameters of `varied`. With g the gradient of the energy, H its second variation, v its null vector at the limit, F
    the force and p a parameter:

        fold:         v . (g_F dF + g_p dp) = 0
        bifurcation:  d(v'Hv) = 0 along the branch H dx = -g_p dp - g_F dF
        ends:         the force that holds ends of tubes of a bundle together stays 0, or they stay at one place

    The push turns with the tip of `first`. Of bundles `along` combines the columns, as in `Directions`.

    Raises:
        InputError: as `Equilibrium.jacobian`.
        SolveError: as `find_stroke_force`; or there is no derivative, since a parameter breaks the symmetry in which
            the arm buckles, or moves a breakpoint past another one.
    """
    unit, load = _push(first, up_to)
    result = find_loss(first, load, float(np.divide(up_to, unit)))
    if result is None:
        return None
    loss, scale = result
    member, force = loss.point.member, np.array(loss.point.member.problem.load.force)
    value = loss.t * scale * unit
    if isinstance(member, Bundled):
        return value, value / loss.t * _of_bundle(first, wrt, along, loss)
    ahead, behind = (replace(member, factor=loss.t * (1 + sign * STEP)) for sign in (1, -1))
    rate_by_force = _rate(loss, Difference(STEP * value, ahead, behind))

    def slope(change: Change, rotation: Array, name: str) -> float:
        """Derivative by a parameter that turns the tip by a rotation vector (3,) per unit."""
        turned = change.step * np.cross(rotation, force)
        further, back = (Load(tuple((force + sign * turned).tolist())) for sign in (1, -1))
        difference = difference_of(member, change, (further, back))
        if difference is None:
            raise SolveError(f"a stroke force has no derivative with respect to {name}: breakpoints coincide there")
        return -_rate(loss, difference) / rate_by_force

    tip_turns = first.jacobian(wrt=wrt).rotation
    names = [(name, tube) for name in wrt for tube in range(len(first.rotations))]
    slopes = [
        slope(change_by(first, name, tube), tip_turns[:, k], f"{name} of tube {tube + 1}")
        for k, (name, tube) in enumerate(names)
    ]
    for parameter in varied:
        sides = [Posed(robot, first.rotations, tuple(first.translations.tolist())) for robot in parameter.robots]
        slopes.append(slope(Change(parameter.step, sides), parameter.rotation, "a piece of a tube"))
    return value, np.array(slopes)


def _rate(loss: Loss, difference: Difference) -> float:
    """Derivative of the function that vanishes at the loss of stability."""
    x, v, hessian = loss.point.state.x, loss.direction, loss.point.state.hessian
    g_p = difference.gradient(x)
    along_v = float(v @ g_p) / float(np.linalg.norm(v))
    if loss.kind == "fold":
        return along_v
    if abs(along_v) > SYMMETRY_BREAKING * float(np.linalg.norm(g_p)):
        raise SolveError(BREAKS_SYMMETRY)
    # H is singular along v: the branch is followed in the complement of v.
    bordered = np.block([[hessian, v[:, None]], [v, np.zeros(1)]])
    dx = np.linalg.solve(bordered, np.append(-g_p, 0.0))[:-1]
    return difference.stiffness(x, dx, (v, v))


# --- Bundles ----------------------------------------------------------------------------------------------------------


def _of_bundle(first: Equilibrium, wrt: Sequence[str], along: Array | None, loss: Loss) -> Array:
    """Derivatives (Q,) of the load factor at which the branch of a bundle ends; the push turns with the first tip."""
    member, state = loss.point.member, loss.point.state
    meeting = _meeting(member, state) if loss.kind == "ends" else None
    if meeting is not None:
        member, state = meeting.member, meeting.state
    v = loss.direction / np.linalg.norm(loss.direction)
    by_p = LinearisedBundle(member, state, tuple(wrt), along, v if loss.kind == "bifurcation" else None)
    force = np.array(member.problem.load.force)
    turned = np.cross(linearise_bundle(first, wrt, along=along).tip_rotation.T, force).T
    # Changes of the gradient by the three components of the force, then by the factor.
    units = [replace(member.problem, load=Load(axis)) for axis in AXES]
    pushed = [replace(member, problem=problem).at(state.x) for problem in units]
    by_force = np.column_stack([*(member.factor * each.load_slope for each in pushed), state.load_slope])
    if loss.kind == "fold":
        rates, forced = v @ by_p.gradient, v @ by_force
    elif meeting is not None:
        rates, forced = meeting.rates(by_p.gradient, by_p.lengths), meeting.rates(by_force)
    else:
        changed = by_p.gradient + by_force[:, :3] @ turned
        # A variable that changes nothing at the limit, as the torsional stiffness of planar arms, leaves round-off.
        size = np.maximum(np.linalg.norm(changed, axis=0), np.linalg.norm(state.load_slope))
        if (np.abs(v @ changed) > SYMMETRY_BREAKING * size).any():
            raise SolveError(BREAKS_SYMMETRY)
        rates, responses = by_p.stiffness(v), bordered_response(state.hessian, v, by_force)[:-1]
        stiffer = [each.hessian - each.elastic_hessian for each in pushed]
        stiffer.append((state.hessian - state.elastic_hessian) / member.factor)
        forced = np.array(
            [v @ (hessian + _turn(member, state, x)) @ v for hessian, x in zip(stiffer, responses.T, strict=True)]
        )
    return np.asarray(-(rates + forced[:3] @ turned) / forced[3])


def _turn(member: Bundled, state: BundleState, change: Array) -> Array:
    """Change (U, U) of the Hessian as the unknowns change by (U,)."""
    h = STEP / member.largest_rotation(state, change)
    return np.asarray((member.at(state.x + h * change).hessian - member.at(state.x - h * change).hessian) / (2 * h))


class _Meeting(NamedTuple):
    """State at which ends of tubes meet: they separate, or change their order, beyond it."""

    member: Bundled
    state: BundleState
    """State with the section between the ends free."""
    section: int
    together: bool
    """True if the ends were together until here."""

    def rates(self, gradient: Array, longer: Array | None = None) -> Array:
        """Changes (Q,) of the force that holds the ends together, or else of their distance.

        Args:
            gradient: changes (U, Q) of the gradient.
            longer: changes (m, Q) of the lengths of elements.
        """
        problem = self.state.problem
        row = np.zeros(problem.size)
        row[problem.split :] = problem.lengths_by_bend[self.section] @ problem.bend_map
        length = np.zeros(gradient.shape[1]) if longer is None else longer[self.section]
        if self.together:
            return np.asarray(bordered_response(self.state.hessian, row, gradient, length)[-1])
        return np.asarray(length - row @ np.linalg.solve(self.state.hessian, gradient))


def _meeting(member: Bundled, state: BundleState) -> _Meeting:
    """Ends that meet where the branch of a bundle ends."""
    closed = [(abs(force), section, each) for section, sides in member.closed(state) for each, force in sides]
    if closed:
        _, section, held = min(closed, key=lambda one: one[:2])
        known = held.problem
        problem, x = rearranged(held, known.order, tuple(k for k in known.held if k != section))
        free = replace(member, problem=problem)
        return _Meeting(free, free.at(opened(problem, x, APART)), section, True)
    lengths = state.problem.lengths(state.x)
    return _Meeting(member.owner(state), state, int(np.argmin(lengths)), False)
