"""Forward kinematics: joint values -> the equilibrium that the robot takes."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from .equilibrium import Equilibrium, Statistics, Status
from .errors import InputError, SolveError, choice, positive, vector
from .robots.assembly import Array
from .robots.robot import Robot
from .solvers.ipopt import solve_ipopt
from .solvers.newton import NewtonResult, descend, leave_saddle, newton
from .transcription import arm as arms
from .transcription.mesh import make_mesh, piece_counts
from .transcription.reduced import (
    ReducedProblem,
    margin,
    on_centreline,
    reduce,
    residual,
    to_unknowns,
    unstable_directions,
)
from .verification import verify_equilibrium

METHODS = ("newton", "ipopt", "energy")

FINEST = 6
"""Most times that the pieces of the mesh are halved."""

HOMOTOPY_STEP = np.pi / 8
"""Largest turn (rad) of a tube per step of the way from home."""

LARGEST_RATIO = 0.5
"""Newton that follows a branch must at least halve its steps: beyond that it may be on its way to another branch."""

SHORTEST_STEP = 2.0**-14
"""Fraction of the way from guess to goal below which a branch is taken to have ended."""


@dataclass(frozen=True)
class Discretisation:
    """How the torsion problem is transcribed: collocation family and degree, and halvings of the default pieces."""

    family: str = "gauss"
    degree: int = 6
    refinement: int = 0


DEFAULT_DISCRETISATION = Discretisation()


@dataclass(frozen=True, eq=False)
class Solution:
    """A solved reduced problem at base rotations (n,)."""

    problem: ReducedProblem
    rotations: Array
    result: NewtonResult
    margin: float

    @property
    def arm(self) -> arms.Profile:
        """Torsion along the arm."""
        return arms.profile(self.problem, self.rotations, self.result.state)


@lru_cache(maxsize=64)
def reduced_problem(robot: Robot, translations: tuple[float, ...], discretisation: Discretisation) -> ReducedProblem:
    """The reduced torsion problem at given translations, built once for all rotations."""
    assembly = robot.assembly(np.array(translations))
    d = discretisation
    pieces = piece_counts(assembly, d.refinement)
    return reduce(assembly, make_mesh(assembly, pieces, family=d.family, degree=d.degree))


def forward_kinematics(
    robot: Robot,
    rotations: ArrayLike,
    translations: ArrayLike | None = None,
    *,
    method: str = "newton",
    guess: Equilibrium | None = None,
    tolerance: float = 1e-8,
    verify: bool = False,
    discretisation: Discretisation = DEFAULT_DISCRETISATION,
) -> Equilibrium:
    """Equilibrium of a robot at given joint values.

    Without a guess the answer is a stable equilibrium: the one that energy descent (method "newton") reaches from
    tubes without torsion, or, where that is unstable, the one that is reached by turning all tubes together from home.
    With a guess, an equilibrium at other joint values, the branch of the guess is followed, stable or not.

    Args:
        rotations, translations: (n,) rad and m; translations default to home. Rotations are not wrapped.
        method: "newton" (the collocation equations, condensed), "ipopt" (the same equations as the constraints of a
            nonlinear program), "energy" (least elastic energy by IPOPT; concentric tubes only).
        tolerance: wanted accuracy of theta(s), rad; the mesh is refined until the estimate is below.
        verify: also re-integrate adaptively and report the difference in `.verification`.
        discretisation: collocation family and degree.

    Raises:
        InputError: wrong number of joint values, one that is not finite, a tube out of its actuator, unknown method.
        SolveError: no stable equilibrium was found, the branch of the guess ends on the way (a snap), or the tolerance
            is out of reach; `.solution` holds the best equilibrium found, where there is one.
    """
    began = time.perf_counter()
    alpha = vector("rotations", rotations, robot.n_tubes)
    home = robot.home_translations if translations is None else translations
    shift = tuple(vector("translations", home, robot.n_tubes).tolist())
    choice("method", method, METHODS)
    positive("tolerance", tolerance)
    if guess is not None and guess.robot.n_tubes != robot.n_tubes:
        raise InputError(f"guess is of a robot with {guess.robot.n_tubes} tubes; it must have {robot.n_tubes}")
    if guess is None:
        solution, start = _cold(reduced_problem(robot, shift, discretisation), alpha, method)
    else:
        solution, start = follow_branch(robot, guess, alpha, shift, discretisation), "guess"
        if method != "newton":
            solution = _resolve(solution.problem, alpha, solution.arm, method)
    for level in range(discretisation.refinement, FINEST + 1):
        equilibrium = to_equilibrium(robot, solution, shift, (method, start, time.perf_counter() - began))
        length = max(float(equilibrium.arc_length[-1]), 1e-300)
        if max(equilibrium.mesh_error, equilibrium.tip_error / length) <= tolerance:
            break
        if level == FINEST:
            raise SolveError(
                f"{Status.MESH_TOO_COARSE}: the estimated error is {equilibrium.mesh_error:.1e} rad, "
                f"wanted was {tolerance:.1e} rad",
                equilibrium,
            )
        finer = Discretisation(discretisation.family, discretisation.degree, level + 1)
        solution = _refine(robot, solution, shift, finer, method)
    return verify_equilibrium(equilibrium) if verify else equilibrium


def _cold(problem: ReducedProblem, rotations: Array, method: str) -> tuple[Solution, str]:
    """A stable equilibrium from tubes without torsion, else by way of home."""
    failure = ""
    try:
        untwisted = _untwisted(problem, rotations)
        solution = _resolve(problem, rotations, untwisted, method)
        if solution.margin > 0:
            return solution, "tubes without torsion"
    except SolveError as error:
        failure = f" ({error})"
    solution = _from_home(problem, rotations)
    if solution.margin <= 0 or not solution.result.converged:
        raise SolveError(f"no stable equilibrium was found: the best has margin {solution.margin:.3g}{failure}")
    if method != "newton":
        solution = _resolve(problem, rotations, solution.arm, method)
    return solution, "the way from home"


def _untwisted(problem: ReducedProblem, rotations: Array) -> arms.Profile:
    pieces, n = len(problem.mesh.length), problem.assembly.n_tubes
    extra = np.zeros((pieces, problem.mesh.tableau.degree, n)) if problem.assembly.eccentric else None
    still = np.zeros((pieces, problem.mesh.tableau.degree, n))
    return arms.Profile(np.tile(rotations, (pieces, 1)), np.zeros((pieces, n)), still, extra)


def _resolve(problem: ReducedProblem, rotations: Array, guess: arms.Profile, method: str) -> Solution:
    """Solve from a guess by the named method; raises SolveError where it does not converge."""
    if method == "newton":
        z = _unknowns(problem, rotations, guess)
        result = (newton if problem.assembly.eccentric else descend)(problem, rotations, z)
    elif method == "energy" and problem.assembly.eccentric:
        raise InputError("method is 'energy'; tubes off the centreline have no such energy: use newton or ipopt")
    else:
        result = solve_ipopt(problem, rotations, guess, "energy" if method == "energy" else "equations")
    if not result.converged:
        error = residual(problem, result.state)
        raise SolveError(
            f"{Status.NOT_CONVERGED}: after {result.iterations} iterations the residual is {error:.1e} rad"
        )
    return Solution(problem, rotations, result, margin(problem, result.state))


def _unknowns(problem: ReducedProblem, rotations: Array, guess: arms.Profile) -> Array:
    nodes = tuple(problem.mesh.tableau.nodes.tolist())
    theta = arms.rotations_at(problem, guess, nodes)[problem.mesh.collocated]
    return to_unknowns(problem, rotations, theta.reshape(-1, len(rotations)))


def _from_home(problem: ReducedProblem, rotations: Array) -> Solution:
    """Turn all tubes together from home, descending in energy at each step; then leave any saddle."""
    concentric = on_centreline(problem)
    steps = max(1, int(np.ceil(np.abs(rotations).max(initial=0.0) / HOMOTOPY_STEP)))
    z = np.zeros(concentric.size)
    for k in range(1, steps + 1):
        alpha = rotations * k / steps
        result = descend(concentric, alpha, z)
        if result.converged and margin(concentric, result.state) <= 0:
            sides = [descend(concentric, alpha, start) for start in leave_saddle(concentric, result.state)]
            result = min(sides, key=lambda side: side.state.energy)
        z = result.state.z
    if problem.assembly.eccentric:
        theta = result.state.theta
        result = newton(problem, rotations, to_unknowns(problem, rotations, theta))
    return Solution(problem, rotations, result, margin(problem, result.state))


def _refine(robot: Robot, coarse: Solution, shift: tuple[float, ...], finer: Discretisation, method: str) -> Solution:
    """The same equilibrium on a finer mesh, started from the coarse one."""
    problem = reduced_problem(robot, shift, finer)
    theta = arms.interpolate(coarse.problem, coarse.arm, problem.arc_length)
    z = to_unknowns(problem, coarse.rotations, theta)
    result = newton(problem, coarse.rotations, z)
    if not result.converged:
        raise SolveError(f"{Status.NOT_CONVERGED} on a finer mesh: the solution on the coarse mesh is not one")
    solution = Solution(problem, coarse.rotations, result, margin(problem, result.state))
    return solution if method == "newton" else _resolve(problem, coarse.rotations, solution.arm, method)


def follow_branch(
    robot: Robot,
    guess: Equilibrium,
    rotations: Array,
    translations: tuple[float, ...],
    discretisation: Discretisation,
) -> Solution:
    """Follow the branch of `guess` along the straight path of joint values, in steps that Newton takes with ease.

    Raises:
        SolveError: the branch ends on the way.
    """
    origin = np.concatenate([guess.rotations, guess.translations])
    goal = np.concatenate([rotations, translations])
    n = len(rotations)
    at, step, current = 0.0, 1.0, None
    while at < 1.0:
        fraction = min(1.0, at + step)
        joint = goal if fraction == 1.0 else origin + fraction * (goal - origin)
        problem = reduced_problem(robot, tuple(joint[n:].tolist()), discretisation)
        where = problem.arc_length
        if current is None:
            theta = sample_rotation(guess, where) + (joint[:n] - guess.rotations)
        else:
            theta = arms.interpolate(current.problem, current.arm, where) + (joint[:n] - current.rotations)
        result = newton(problem, joint[:n], to_unknowns(problem, joint[:n], theta), iterations=8)
        if result.converged and result.contraction <= LARGEST_RATIO:
            current = Solution(problem, joint[:n], result, margin(problem, result.state))
            at, step = fraction, step * 2
        else:
            step /= 2
        if step < SHORTEST_STEP:
            raise SolveError(
                f"{Status.BRANCH_ENDED}: it ends {100 * at:.2f} % of the way from the guess to the goal", guess
            )
    assert current is not None
    return current


def polish(equilibrium: Equilibrium, discretisation: Discretisation = DEFAULT_DISCRETISATION) -> Solution:
    """The solved reduced problem behind an equilibrium; raises SolveError where Newton does not stay there (a fold)."""
    shift = tuple(equilibrium.translations.tolist())
    problem = reduced_problem(equilibrium.robot, shift, discretisation)
    theta = sample_rotation(equilibrium, problem.arc_length)
    result = newton(problem, equilibrium.rotations, to_unknowns(problem, equilibrium.rotations, theta))
    if not result.converged:
        raise SolveError("the equilibrium is a fold (margin 0): it has no solution close by that Newton can find")
    return Solution(problem, equilibrium.rotations, result, margin(problem, result.state))


def sample_rotation(equilibrium: Equilibrium, arc_length: Array) -> Array:
    """theta (len(arc_length), n) of an equilibrium: as solved at its own collocation points, else cubic Hermite."""
    if np.array_equal(arc_length, equilibrium.point):
        return equilibrium.point_rotation
    s = equilibrium.arc_length
    if len(s) < 2:
        return np.tile(equilibrium.rotation[:, 0], (len(arc_length), 1))
    k = np.clip(np.searchsorted(s, arc_length, side="right") - 1, 0, len(s) - 2)
    h = s[k + 1] - s[k]
    x = np.clip((arc_length - s[k]) / h, 0.0, 1.0)
    r, w = equilibrium.rotation, equilibrium.torsion
    value = r[:, k] * (1 + 2 * x) * (1 - x) ** 2 + r[:, k + 1] * x**2 * (3 - 2 * x)
    value += h * (w[:, k] * x * (1 - x) ** 2 - w[:, k + 1] * x**2 * (1 - x))
    return np.asarray(value.T)


def to_equilibrium(
    robot: Robot, solution: Solution, translations: tuple[float, ...], how: tuple[str, str, float]
) -> Equilibrium:
    """Shape, energy and error estimates of a solved problem; `how` is method, start, and seconds so far."""
    problem, rotations, state = solution.problem, solution.rotations, solution.result.state
    began = time.perf_counter()
    assembly, mesh = problem.assembly, problem.mesh
    arm = arms.evaluate_arm(problem, rotations, state, solution.arm)
    s = arm.arc_length
    ends = np.maximum(assembly.end, 0.0)
    # The inverse of the linearised equation amplifies a defect by at most one over the margin.
    error = arm.defect / max(min(1.0, abs(solution.margin)), 1e-6)
    # A wrong theta turns the curvature: |dp| <= int |u| |dtheta| (L - s) ds.
    bend = np.sqrt((arm.curvature**2).sum(1)) * (s[-1] - s)
    lever = 0.5 * float((bend[1:] + bend[:-1]) @ (s[1:] - s[:-1]))
    method, start, seconds = how
    return Equilibrium(
        robot=robot,
        rotations=rotations,
        translations=np.array(translations),
        tip_position=arm.position[-1],
        tip_rotation=arm.frame[-1],
        arc_length=s,
        position=arm.position,
        frame=arm.frame,
        curvature=arm.curvature,
        rotation=arm.rotation,
        torsion=arm.torsion,
        tip_rotations=arm.rotation[np.arange(len(rotations)), np.searchsorted(s, ends - 1e-12)],
        section_start=assembly.start,
        point=problem.arc_length,
        point_rotation=state.theta,
        tube_end=ends,
        margin=solution.margin,
        index=0 if solution.margin > 0 else unstable_directions(problem, state),
        energy=arm.energy,
        residual=residual(problem, state),
        mesh_error=error,
        tip_error=arm.shape_error + error * lever,
        status=Status.STABLE if solution.margin > 0 else Status.UNSTABLE,
        statistics=Statistics(
            method=method,
            iterations=solution.result.iterations,
            elements=int(mesh.collocated.sum()),
            degree=mesh.tableau.degree,
            start=start,
            seconds=seconds + time.perf_counter() - began,
        ),
    )
