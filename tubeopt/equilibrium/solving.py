"""A solved torsion problem, on its way from the solver to the plain `Equilibrium`."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from ..block.transcription import arm as arms
from ..block.transcription.arm import ArmShape, CollocationPoints
from ..block.transcription.collocated import ENDS, STEPS
from ..block.transcription.mesh import make_mesh, piece_counts
from ..block.transcription.reduced import Evaluation, ReducedProblem, evaluate, pull_rate, reduce, residual, to_unknowns
from ..block.transcription.second_variation import margin, unstable_directions
from ..block.transcription.tableau import FAMILIES
from ..block.transcription.whole_arm import evaluate_arm
from ..display import Displayed
from ..errors import SolveError, choice, whole
from ..robots.assembly import ROUND_OFF, Assembly
from ..robots.robot import Robot, is_general
from ..solvers.newton import NewtonResult, newton
from ..solvers.settings import NEWTON, Newton
from ..typing import Array
from .result import Accuracy, Equilibrium, Statistics, Status, refuse_load


@dataclass(frozen=True)
class Discretisation(Displayed):
    """How the torsion problem is transcribed."""

    family: str = "gauss"
    """Of collocation."""
    degree: int = 6
    """Of its polynomials."""
    refinement: int = 0
    """How often the default pieces of the mesh are halved."""

    def __post_init__(self) -> None:
        choice("family", self.family, FAMILIES)
        whole("degree", self.degree, 1)
        whole("refinement", self.refinement)


DEFAULT_DISCRETISATION = Discretisation()


@dataclass(frozen=True, eq=False)
class Solution:
    """A solved reduced problem at base rotations (n,); `rubbed`: torsion along the arm and the error (rad) of the mesh,
    where friction shapes them too."""

    problem: ReducedProblem
    rotations: Array
    result: NewtonResult[Evaluation]
    margin: float
    rubbed: tuple[arms.Profile, float] | None = None

    @staticmethod
    def of(problem: ReducedProblem, rotations: Array, result: NewtonResult[Evaluation]) -> Solution:
        """That of a solver."""
        return Solution(problem, rotations, result, margin(problem, result.state))

    @staticmethod
    def near(
        problem: ReducedProblem, rotations: Array, theta: Array, failure: str, settings: Newton = NEWTON
    ) -> Solution:
        """What Newton's method finds from theta (N, n) at the points; raises SolveError, with words of its failure,
        where it fails."""
        result = newton(problem, rotations, to_unknowns(problem, rotations, theta), settings=settings)
        if not result.converged:
            raise SolveError(failure)
        return Solution.of(problem, rotations, result)

    @staticmethod
    def at(problem: ReducedProblem, rotations: Array, z: Array) -> Solution:
        """That of unknowns z (U,), which are solved."""
        return Solution.of(problem, rotations, NewtonResult(evaluate(problem, rotations, z), True, 0, 0.0))

    @property
    def arm(self) -> arms.Profile:
        """Torsion along the arm."""
        if self.rubbed is not None:
            return self.rubbed[0]
        return arms.profile(self.problem, self.rotations, self.result.state)


@lru_cache(maxsize=64)
def reduced_problem(robot: Robot, translations: tuple[float, ...], discretisation: Discretisation) -> ReducedProblem:
    """The reduced torsion problem at given translations, built once for all rotations."""
    return reduced_assembly(robot.assembly(np.array(translations)), discretisation)


def reduced_assembly(assembly: Assembly, discretisation: Discretisation = DEFAULT_DISCRETISATION) -> ReducedProblem:
    """The reduced torsion problem of tubes that are placed."""
    d = discretisation
    pieces = piece_counts(assembly, d.refinement)
    return reduce(assembly, make_mesh(assembly, pieces, family=d.family, degree=d.degree))


def discretisation_of(equilibrium: Equilibrium) -> Discretisation:
    """The discretisation on which an equilibrium was solved."""
    how = equilibrium.statistics
    return Discretisation(how.family, how.degree, how.refinement)


def polish(equilibrium: Equilibrium, discretisation: Discretisation = DEFAULT_DISCRETISATION) -> Solution:
    """The solved reduced problem behind an equilibrium; raises SolveError where Newton does not stay there (a fold).

    Raises InputError for an equilibrium under load, which is none of the reduced problem.
    """
    refuse_load(equilibrium)
    shift = tuple(equilibrium.translations.tolist())
    problem = reduced_problem(equilibrium.robot, shift, discretisation)
    theta = sample_rotation(equilibrium, problem.arc_length)
    failure = "the equilibrium is a fold (margin 0): it has no solution close by that Newton can find"
    return Solution.near(problem, equilibrium.rotations, theta, failure)


def linearised(equilibrium: Equilibrium) -> Array:
    """(U, U) the linearised equations behind an equilibrium, on its own mesh, as it was solved.

    Raises InputError for an equilibrium under load.
    """
    refuse_load(equilibrium)
    shift, own = tuple(equilibrium.translations.tolist()), equilibrium.rotations
    problem = reduced_problem(equilibrium.robot, shift, discretisation_of(equilibrium))
    theta = sample_rotation(equilibrium, problem.arc_length)
    return evaluate(problem, own, to_unknowns(problem, own, theta)).hessian


def collocated(equilibrium: Equilibrium) -> tuple[ReducedProblem, arms.Profile]:
    """The problem that an equilibrium solves, on its own mesh, and the torsion along its arm."""
    solution = polish(equilibrium, discretisation_of(equilibrium))
    return solution.problem, solution.arm


def sample_rotation(equilibrium: Equilibrium, arc_length: Array) -> Array:
    """theta (len(arc_length), n) of an equilibrium: as solved at its own collocation points, else cubic Hermite; phi
    where a tube is made of pieces."""
    own = equilibrium.point
    if len(own) == len(arc_length) and np.abs(own - arc_length).max(initial=0.0) <= ROUND_OFF:
        theta = equilibrium.point_rotation
        if is_general(equilibrium.robot):
            theta = theta - equilibrium.robot.assembly(equilibrium.translations).wound(arc_length)
        return theta
    arm = np.stack([equilibrium.rotation.T, equilibrium.torsion.T])
    return sample_arms(equilibrium.robot, equilibrium.translations, equilibrium.arc_length, arm, arc_length)


def sample_arms(robot: Robot, translations: Array, s: Array, arms: Array, arc_length: Array) -> Array:
    """The same (..., len(arc_length), n) of arms (..., 2, m, n), rotation and torsion at arc lengths s (m,)."""
    rotation, torsion = arms[..., 0, :, :], arms[..., 1, :, :]
    phi = rotation - robot.assembly(translations).wound(s) if is_general(robot) else rotation
    if len(s) < 2:
        return np.repeat(phi, len(arc_length), axis=-2)
    if is_general(robot):
        # The polynomial through the shape points of each piece: its rate jumps between.
        piece = np.clip(np.searchsorted(s[::STEPS], arc_length, side="right") - 1, 0, len(s) // STEPS - 1)
        x = np.clip((arc_length - s[piece * STEPS]) / (s[(piece + 1) * STEPS] - s[piece * STEPS]), 0.0, 1.0)
        basis = np.vander(x, STEPS + 1) @ np.linalg.inv(np.vander(ENDS, STEPS + 1))
        around = phi[..., piece[:, None] * STEPS + np.arange(STEPS + 1), :]
        return np.asarray(np.einsum("ak,...aki->...ai", basis, around))
    k = np.clip(np.searchsorted(s, arc_length, side="right") - 1, 0, len(s) - 2)
    h = (s[k + 1] - s[k])[:, None]
    x = np.clip((arc_length - s[k]) / h[:, 0], 0.0, 1.0)[:, None]
    value = rotation[..., k, :] * ((1 + 2 * x) * (1 - x) ** 2) + rotation[..., k + 1, :] * (x**2 * (3 - 2 * x))
    value += h * (torsion[..., k, :] * (x * (1 - x) ** 2) - torsion[..., k + 1, :] * (x**2 * (1 - x)))
    return np.asarray(value)


def from_compiled(
    robot: Robot, rotations: Array, translations: tuple[float, ...], answer: dict[str, Any], how: tuple[str, float, int]
) -> Equilibrium:
    """The equilibrium that the compiled kernel found; `how` is its start, when (s) the solve began, and how often the
    pieces of the mesh were halved."""
    m, points = int(answer["pieces"]) * STEPS + 1, int(answer["points"])
    start, began, refinement = how
    return Equilibrium(
        robot=robot,
        rotations=rotations,
        translations=np.array(translations),
        arm=ArmShape(
            arc_length=answer["arc_length"][:m].copy(),
            rotation=answer["rotation"][:m].T.copy(),
            torsion=answer["torsion"][:m].T.copy(),
            curvature=answer["curvature"][:m].copy(),
            position=answer["position"][:m].copy(),
            frame=answer["frame"][:m].copy(),
        ),
        tip_rotations=answer["tip_rotations"].copy(),
        section_start=answer["section_start"][: int(answer["sections"])].copy(),
        tube_end=answer["tube_end"].copy(),
        points=CollocationPoints(answer["point"][:points].copy(), answer["point_rotation"][:points].copy()),
        margin=float(answer["margin"]),
        index=0,
        energy=float(answer["energy"]),
        accuracy=Accuracy(float(answer["residual"]), float(answer["mesh_error"]), float(answer["tip_error"])),
        status=Status.STABLE,
        statistics=Statistics(
            method="newton",
            iterations=int(answer["iterations"]),
            elements=int(answer["elements"]),
            degree=DEFAULT_DISCRETISATION.degree,
            start=start,
            seconds=time.perf_counter() - began - answer["loading"],
            refinement=refinement,
            loading=answer["loading"],
        ),
    )


def told_by_arm(arm: ArmShape, assembly: Assembly) -> dict[str, Any]:
    """The fields of an equilibrium that its arm and the bundle tell."""
    ends = np.maximum(assembly.end, 0.0)
    tips = arm.rotation[np.arange(len(ends)), np.searchsorted(arm.arc_length, ends - 1e-12)]
    return {"arm": arm, "tip_rotations": tips, "section_start": assembly.start, "tube_end": ends}


def to_equilibrium(
    robot: Robot, solution: Solution, translations: tuple[float, ...], how: tuple[str, str, float]
) -> Equilibrium:
    """Shape, energy and error estimates of a solved problem; `how` is method, start, and seconds so far."""
    problem, rotations, state = solution.problem, solution.rotations, solution.result.state
    began = time.perf_counter()
    assembly, mesh = problem.assembly, problem.mesh
    arm = evaluate_arm(problem, rotations, state, solution.arm)
    # The inverse of the linearised equation amplifies a defect by at most one over the margin.
    defect = arm.defect if solution.rubbed is None else solution.rubbed[1]
    error = defect / max(min(1.0, abs(solution.margin)), 1e-6)
    method, start, seconds = how
    return Equilibrium(
        robot=robot,
        rotations=rotations,
        translations=np.array(translations),
        **told_by_arm(arm, assembly),
        points=CollocationPoints(problem.arc_length, state.theta + assembly.wound(problem.arc_length)),
        margin=solution.margin,
        index=0 if solution.margin > 0 else unstable_directions(problem, state),
        energy=arm.energy,
        accuracy=Accuracy(residual(problem, state), error, arm.shape_error + error * lever(problem)),
        status=Status.STABLE if solution.margin > 0 else Status.UNSTABLE,
        statistics=Statistics(
            method=method,
            iterations=solution.result.iterations,
            elements=int(mesh.collocated.sum()),
            degree=mesh.tableau.degree,
            start=start,
            seconds=seconds + time.perf_counter() - began,
            family=mesh.tableau.family,
            refinement=_refinement(problem),
        ),
    )


@lru_cache(maxsize=16)
def lever(problem: ReducedProblem) -> float:
    """By how much a tip can move with a wrong theta, m per rad: |dp| <= int |du / dtheta| |dtheta| (L - s) ds.

    The curvature u itself can vanish where tubes oppose each other, its change with theta does not: sum |m_i| / sum
    kb_i bounds it.
    """
    mesh = problem.mesh
    if not len(mesh.length):
        return 0.0
    ahead = mesh.start[-1] + mesh.length[-1] - mesh.start - mesh.length / 2
    return float((pull_rate(problem) * mesh.length) @ ahead)


@lru_cache(maxsize=16)
def _refinement(problem: ReducedProblem) -> int:
    """How often the pieces of the default mesh were halved."""
    collocated = problem.mesh.collocated
    usual = piece_counts(problem.assembly)[problem.assembly.coupled].sum()
    return round(float(np.log2(collocated.sum() / usual))) if usual else 0
