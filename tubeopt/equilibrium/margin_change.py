"""How the margin under a load without an energy changes with joint values and tubes.

With H the linearised equations and w, v the left and right eigenvectors of the eigenvalue l of the margin,
dl = w'dH v / w'v, where the equilibrium moves by H dx = -dg. Both dg and dH are differences of two problems, a step
further and a step back: the eigenvectors are not solved for again. Of the symmetric part w is v.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy

from ..block.transcription.loaded import evaluate, symmetric_part
from ..errors import InputError
from ..robots.assembly import ROUND_OFF, Assembly
from ..robots.robot import Robot, resized
from ..typing import Array
from .answer import point_of
from .directions import check_wrt
from .jacobian import jacobian
from .linearised import sharing
from .loaded import LoadedPoint
from .problem import loaded_problem, loading_of
from .result import Equilibrium

STEP = 1e-5
"""Of the differences: rad, and as a share of the arm's length, of one over it, or of a stiffness."""

APART = 1e-6
"""Distance of two eigenvalues, and cosine of a left and a right eigenvector, below which there is no derivative."""

Side = tuple[Robot, Array, tuple[float, ...]]
"""A robot and its joint values."""


def unit_of(e: Equilibrium, name: str, tube: int) -> float:
    """By what a step is measured: it turns the tip by about as much, in rad."""
    length = float(e.arc_length[-1])
    match name:
        case "rotations":
            return 1.0
        case "curvature":
            return 1 / length
        case "translations" | "straight_length" | "curved_length":
            return length
        case _:
            return float(getattr(e.robot.tubes[tube], name))


def beside(e: Equilibrium, name: str, tube: int, step: float) -> Side:
    """The robot and joint values of an equilibrium with a parameter of a tube a step further; raises InputError where
    there is none."""
    joints = {"rotations": e.rotations.copy(), "translations": e.translations.copy()}
    robot: Any = e.robot
    if name in joints:
        joints[name][tube] += step
    else:
        robot = resized(robot, tube, name, getattr(robot.tubes[tube], name) + step)
    return robot, joints["rotations"], tuple(joints["translations"].tolist())


def sides_of(e: Equilibrium, name: str, tube: int) -> tuple[float, list[Side]]:
    """A step of a parameter of a tube, and what is a step further and a step back from an equilibrium; empty where one
    of them does not exist."""
    step = STEP * unit_of(e, name, tube)
    try:
        return step, [beside(e, name, tube, sign * step) for sign in (1, -1)]
    except InputError:
        return step, []


def margin_slopes(
    e: Equilibrium, wrt: Sequence[str], varied: Sequence[tuple[float, tuple[Robot, Robot]]] = (), *, sure: bool = False
) -> Array:
    """(Q,) derivatives of the margin under a load without an energy, or of the `sure_margin`, by joint values and
    dimensions, n for each name of `wrt`, then per step by robots a step further and a step back. NaN where it is a
    double eigenvalue, or breakpoints meet that part with what changes.

    Raises:
        SolveError: the equilibrium is a fold.
    """
    point: LoadedPoint = point_of(e)
    shift, sides = point.member.translations, list[tuple[float, list[Side]]]()
    sides += [sides_of(e, name, tube) for name in wrt for tube in range(len(e.rotations))]
    sides += [(step, [(robot, e.rotations, shift) for robot in robots]) for step, robots in varied]
    matrix = symmetric_part(point.member.problem, point.state) if sure else point.state.hessian
    found = _modes(matrix, symmetric=sure)
    if found is None:
        return np.full(len(sides), np.nan)
    return np.array([_slope(point, found, each, sure=sure) for each in sides])


def margin_slopes_of(e: Equilibrium, wrt: Sequence[str]) -> Array:
    """(Q,) of the margin of any equilibrium; tubes of a carriage share theirs in equal parts."""
    if e.load is None or e.load.has_energy:
        return jacobian(e, wrt=wrt).margin
    check_wrt(wrt, 1)
    shared, found = sharing(e.robot.moving_together, tuple(wrt)), margin_slopes(e, wrt)
    return found if shared is None else np.asarray(found @ shared)


def _modes(matrix: Array, *, symmetric: bool) -> tuple[Array, Array] | None:
    """Left and right eigenvectors of the eigenvalue of least real part, of a pair one; None where others are as small,
    or it is defective."""
    if symmetric:
        values, right = np.linalg.eigh(matrix)
        left = right
    else:
        values, left, right = scipy.linalg.eig(matrix, left=True)
    order = np.lexsort((-values.imag, values.real))
    k, others = order[0], order[1 + (abs(values[order[0]].imag) > 0) :]
    w, v = left[:, k], right[:, k]
    double = len(others) > 0 and values[others[0]].real - values[k].real < APART
    return None if double or abs(np.vdot(w, v)) < APART else (w, v)


def _slope(point: LoadedPoint, modes: tuple[Array, Array], sides: tuple[float, list[Side]], *, sure: bool) -> float:
    """The derivative by what differs by two steps between two robots."""
    (step, both), (left, right), member = sides, modes, point.member
    here, x = member.problem, point.state.x
    pieces = tuple(np.bincount(here.mesh.section, minlength=here.torsion.assembly.n_sections).tolist())
    cut = [_cut(loading_of(robot, shift, here.load)[0]) for robot, _, shift in both]
    if cut != 2 * [_cut(here.torsion.assembly)]:
        return float("nan")
    problems = [loaded_problem(robot, shift, here.load, member.discretisation, pieces) for robot, _, shift in both]
    turned = [alpha for _, alpha, _ in both]
    one, other = (evaluate(each, alpha, x).gradient for each, alpha in zip(problems, turned, strict=True))
    change = -np.linalg.solve(point.state.hessian, one - other) / 2
    found = [
        evaluate(each, alpha, x + sign * change) for each, alpha, sign in zip(problems, turned, (1, -1), strict=True)
    ]
    further, back = (
        symmetric_part(each, state) if sure else state.hessian for each, state in zip(problems, found, strict=True)
    )
    return float((np.vdot(left, (further - back) @ right) / np.vdot(left, right)).real) / (2 * step)


def _cut(assembly: Assembly) -> tuple[int, int]:
    """Sections of an arm, and those that have a length."""
    return assembly.n_sections, int((assembly.length > ROUND_OFF).sum())
