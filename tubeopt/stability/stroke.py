"""How hard a robot can push with its tip before it buckles or snaps, and what changes that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ..arguments import typed
from ..block.transcription.loaded import LoadedProblem, evaluate
from ..block.transcription.mesh import needs
from ..equilibrium.jacobian import STEP, Side, sides_of
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
    """The largest force of the tip along its own direction, as a load limit; None if it withstands `up_to`, N.

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
    """A force against the tip, N, about that which buckles the weakest part as a column of the whole length."""
    arm = first.robot.assembly(first.translations)
    weakest = float(needs(arm)[3].min())
    unit = min(up_to, 1.1 * weakest / arm.total_length**2)
    return unit, Load(tuple((-unit * first.tip_rotation[:, 2]).tolist()))


BREAKS = 1e-6
"""Part of a change of the equations along the direction of buckling above which it breaks the symmetry."""


@dataclass(frozen=True, eq=False)
class Varied:
    """A robot that changes by a parameter of any unit, at fixed joint values."""

    step: float
    """In that unit."""
    robots: tuple[Robot, Robot]
    """A step further, and a step back."""
    turn: Array
    """(3,) turn vector of the tip, per that unit, rad."""


@small
def stroke_slopes(
    first: Equilibrium, wrt: Sequence[str], up_to: float = 10.0, *, varied: Sequence[Varied] = ()
) -> tuple[float, Array] | None:
    """The stroke force of a stable equilibrium without load, N, and (Q,) its derivatives by joint values and
    dimensions, n for each name of `wrt`, per their units, then by what is `varied`; None as `find_stroke_force`.

    With g the gradient of the energy, H its second variation and v the direction in which H is singular at the limit,
    F the force and p what changes: at a fold v.(g_F dF + g_p dp) = 0; at a bifurcation v'Hv stays 0 along the branch,
    on which H dx = -g_p dp - g_F dF. The push turns with the tip of `first`.

    Raises:
        InputError: as `Equilibrium.jacobian`.
        SolveError: as `find_stroke_force`; or there is no derivative: what changes breaks the symmetry in which the arm
            buckles, or moves a breakpoint past another one.
    """
    unit, load = _push(first, up_to)
    result = find_loss(first, load, float(np.divide(up_to, unit)))
    if result is None:
        return None
    loss, scale = result
    member = loss.point.member
    force = np.array(member.problem.load.force)
    there = [(member.problem, member.rotations, loss.t * (1 + sign * STEP)) for sign in (1, -1)]
    value = loss.t * scale * unit
    by_force = _rate(loss, there, STEP * value)
    turned = first.jacobian(wrt=wrt).rotation
    out = []
    for k, (name, tube) in enumerate((name, i) for name in wrt for i in range(len(first.rotations))):
        step, sides = sides_of(first, name, tube)
        try:
            both = _pushed(sides, force, step * np.cross(turned[:, k], force))
        except InputError:
            both = []
        if len(both) < 2 or any(problem.size != member.problem.size for problem, _ in both):
            raise SolveError(
                f"a stroke force has no derivative with respect to {name} of "
                f"tube {tube + 1}: breakpoints coincide there"
            )
        rate = _rate(loss, [(problem, alpha, loss.t) for problem, alpha in both], step)
        out.append(-rate / by_force)
    for one in varied:
        sides = [(robot, first.rotations, tuple(first.translations.tolist())) for robot in one.robots]
        both = _pushed(sides, force, one.step * np.cross(one.turn, force))
        out.append(-_rate(loss, [(problem, alpha, loss.t) for problem, alpha in both], one.step) / by_force)
    return value, np.array(out)


def _pushed(sides: Sequence[Side], force: Array, change: Array) -> list[tuple[LoadedProblem, Array]]:
    """Problems and rotations at a step further and a step back, under a force that changes with a step; raises
    InputError where the arm does not exist there."""
    return [
        (loaded_problem(robot, shift, Load(tuple((force + sign * change).tolist())), LOADED_DISCRETISATION), alpha)
        for (robot, alpha, shift), sign in zip(sides, (1, -1), strict=False)
    ]


def _rate(loss: Loss, both: Sequence[tuple[LoadedProblem, Array, float]], step: float) -> float:
    """The rate of what vanishes where stability is lost, by what differs by two steps between two problems, with their
    rotations and factors on the load."""
    x, soft, hessian = loss.point.state.x, loss.direction, loss.point.state.hessian
    one, other = (evaluate(problem, alpha, x, factor).gradient for problem, alpha, factor in both)
    pull = (one - other) / (2 * step)
    along = float(soft @ pull) / float(np.linalg.norm(soft))
    if loss.kind == "fold":
        return along
    if abs(along) > BREAKS * float(np.linalg.norm(pull)):
        raise SolveError(
            "a stroke force has no derivative with respect to variables that break the symmetry of buckling"
        )
    bordered = np.block([[hessian, soft[:, None]], [soft, np.zeros(1)]])
    change = np.linalg.solve(bordered, np.append(-pull, 0.0))[:-1]
    further, back = (
        float(soft @ evaluate(problem, alpha, x + sign * step * change, factor).hessian @ soft)
        for (problem, alpha, factor), sign in zip(both, (1, -1), strict=True)
    )
    return (further - back) / (2 * step)
