"""Stroke force: the largest force of the tip along its own direction, and its derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..arguments import typed
from ..block.transcription.loaded import LoadedProblem, evaluate
from ..block.transcription.mesh import section_needs
from ..equilibrium.jacobian import STEP, Posed, difference_of
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.problem import LOADED_DISCRETISATION, loaded_problem
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError, positive
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
    arm = first.robot.assembly(first.translations)
    weakest = float(section_needs(arm).stiffness.min())
    unit = min(up_to, 1.1 * weakest / arm.total_length**2)
    return unit, Load(tuple((-unit * first.tip_rotation[:, 2]).tolist()))


SYMMETRY_BREAKING = 1e-6
"""Cosine between a change of the equations and the direction of buckling above which it breaks the symmetry."""


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
    first: Equilibrium, wrt: Sequence[str], up_to: float = 10.0, *, varied: Sequence[Varied] = ()
) -> tuple[float, Array] | None:
    """Stroke force of a stable equilibrium without load, N, and its derivatives (Q,); None as `find_stroke_force`.

    Derivatives are with respect to joint values and dimensions, n for each name of `wrt`, per SI unit, then the
    parameters of `varied`. With g the gradient of the energy, H its second variation, v its null vector at the limit, F
    the force and p a parameter:

        fold:         v . (g_F dF + g_p dp) = 0
        bifurcation:  d(v'Hv) = 0 along the branch H dx = -g_p dp - g_F dF

    The push turns with the tip of `first`.

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
    member = loss.point.member
    force = np.array(member.problem.load.force)
    at_forces = [_Side(member.problem, member.rotations, loss.t * (1 + sign * STEP)) for sign in (1, -1)]
    value = loss.t * scale * unit
    rate_by_force = _rate(loss, at_forces, STEP * value)
    tip_turns = first.jacobian(wrt=wrt).rotation
    slopes = []
    for k, (name, tube) in enumerate((name, i) for name in wrt for i in range(len(first.rotations))):
        step, robots = difference_of(first, name, tube)
        try:
            sides = _pushed(robots, loss.t, force, step * np.cross(tip_turns[:, k], force))
        except InputError:  # the arm does not exist on one side
            sides = []
        if len(sides) < 2 or any(side.problem.size != member.problem.size for side in sides):
            raise SolveError(
                f"a stroke force has no derivative with respect to {name} of "
                f"tube {tube + 1}: breakpoints coincide there"
            )
        slopes.append(-_rate(loss, sides, step) / rate_by_force)
    for parameter in varied:
        robots = [Posed(robot, first.rotations, tuple(first.translations.tolist())) for robot in parameter.robots]
        sides = _pushed(robots, loss.t, force, parameter.step * np.cross(parameter.rotation, force))
        slopes.append(-_rate(loss, sides, parameter.step) / rate_by_force)
    return value, np.array(slopes)


class _Side(NamedTuple):
    """Problem on one side of a central difference."""

    problem: LoadedProblem
    rotations: Array
    factor: float
    """Factor on the load."""


def _pushed(robots: Sequence[Posed], factor: float, force: Array, change: Array) -> list[_Side]:
    """Problems at plus and minus one step, under a force that changes with the step.

    Raises:
        InputError: the arm does not exist there.
    """
    return [
        _Side(
            loaded_problem(robot, shift, Load(tuple((force + sign * change).tolist())), LOADED_DISCRETISATION),
            alpha,
            factor,
        )
        for (robot, alpha, shift), sign in zip(robots, (1, -1), strict=False)
    ]


def _rate(loss: Loss, sides: Sequence[_Side], step: float) -> float:
    """Derivative of the function that vanishes at the loss of stability, from problems two steps apart."""
    x, v, hessian = loss.point.state.x, loss.direction, loss.point.state.hessian
    plus, minus = (evaluate(side.problem, side.rotations, x, side.factor).gradient for side in sides)
    g_p = (plus - minus) / (2 * step)
    along_v = float(v @ g_p) / float(np.linalg.norm(v))
    if loss.kind == "fold":
        return along_v
    if abs(along_v) > SYMMETRY_BREAKING * float(np.linalg.norm(g_p)):
        raise SolveError(
            "a stroke force has no derivative with respect to variables that break the symmetry of buckling"
        )
    # H is singular along v: the branch is followed in the complement of v.
    bordered = np.block([[hessian, v[:, None]], [v, np.zeros(1)]])
    dx = np.linalg.solve(bordered, np.append(-g_p, 0.0))[:-1]
    stiffness_plus, stiffness_minus = (
        float(v @ evaluate(side.problem, side.rotations, x + sign * step * dx, side.factor).hessian @ v)
        for side, sign in zip(sides, (1, -1), strict=True)
    )
    return (stiffness_plus - stiffness_minus) / (2 * step)
