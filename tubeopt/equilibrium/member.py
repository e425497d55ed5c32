"""Equations of one robot at joint values, with or without a load, and their solutions.

`Unloaded` and `Loaded` have one interface: equations, margin, and the transfer of unknowns between problems.
Continuation, folds and energy descent use this interface only, and so are written once.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
import scipy

from ..block.transcription import arm as arms
from ..block.transcription import loaded
from ..block.transcription.arm import ArmSolution, CollocationPoints, Errors, Profile, between, cubic, evaluate_arm
from ..block.transcription.bundle import BundleState
from ..block.transcription.collocated import SHAPE_STEPS, THROUGH_ENDS
from ..block.transcription.loaded import (
    LoadedProblem,
    LoadedState,
    base_wrench,
    compliance,
    elastic_energy,
    loaded_arm,
    loaded_profile,
    tip_position,
    tip_slopes,
)
from ..block.transcription.mesh import Mesh, make_mesh
from ..block.transcription.reduced import (
    Evaluation,
    ReducedProblem,
    evaluate,
    on_centreline,
    pull_rate,
    reduce,
    residual,
    to_unknowns,
    worst_equation,
)
from ..block.transcription.second_variation import REAL, Pair, least, margin, modes, softenings, stiffnesses
from ..errors import SolveError
from ..robots.assembly import LENGTH_ROUND_OFF, Assembly
from ..robots.load import Load
from ..robots.order import twisted_tube
from ..robots.robot import Robot
from ..solvers.newton import NewtonResult, descend, full_steps, torsional_turn
from ..solvers.settings import HARDLY_SOFTENED, LARGEST_SHIFT, LEAST_STIFFNESS, NEWTON, Newton
from ..typing import Array, Index
from .problem import (
    DEFAULT_DISCRETISATION,
    EXTRA_COLLOCATION_POINTS,
    LOADED_DISCRETISATION,
    Discretisation,
    assembly_of,
    check_load,
    loaded_problem,
    loading_of,
    reduced_problem,
)
from .result import Equilibrium

# The tubes turn together from home, and each step ends in a minimum. Opposed tubes may leave the branch through a fold
# in any step; a step of at most a sixteenth of a turn keeps them in the basin of the nearest minimum.
HOME_TURN = math.pi / 8
"""Largest rotation (rad) of a tube per step of the path from home."""

SAME_CUT = 1e-9
"""Largest difference (m) of places at which two meshes are cut at the same one."""

S = TypeVar("S", Evaluation, LoadedState, BundleState)
M = TypeVar("M", bound="Member[Any]")


@dataclass(frozen=True, eq=False)
class Point(Generic[M, S]):
    """Solved equilibrium of a member of a family."""

    t: float
    """Parameter of the member in the family."""
    member: M
    state: S
    """Unknowns at the equilibrium, with the equations, their Jacobian and the energy."""
    margin: float
    iterations: int = 0
    """Number of Newton iterations of the solve."""

    @cached_property
    def softest(self) -> Array:
        """(U,) unit vector of the smallest eigenvalue."""
        return np.asarray(self.member.softest(self.state))

    @cached_property
    def unresisted(self) -> Array:
        """(U,) left null vector of the Jacobian at a fold: the softest direction if the equations have an energy."""
        if self.member.descends:
            return self.softest
        # One inverse iteration with H': close to a fold it gives the left eigenvector of the zero eigenvalue.
        push = np.linalg.solve(self.state.hessian.T, self.softest)
        return np.asarray(push * np.sign(push @ self.softest) / np.linalg.norm(push))

    @property
    def torsion(self) -> Profile:
        """Rotation and torsion along the arm."""
        return self.member.profile(self.state)

    @staticmethod
    def of(member: M, result: NewtonResult[S], t: float = 0.0) -> Point[M, S]:
        """Point from the result of a solver."""
        member = member.owner(result.state)
        return Point(t, member, result.state, member.margin(result.state), result.iterations)

    @staticmethod
    def at(member: M, x: Array, t: float = 0.0) -> Point[M, S]:
        """Point at unknowns x (U,) that solve the equations."""
        state = member.at(x)
        return Point(t, member, state, member.margin(state))

    @staticmethod
    def solved_near(member: M, x: Array, failure: str, iterations: int = NEWTON.iterations) -> Point[M, S]:
        """Point found by Newton's method from unknowns x (U,); raises SolveError with the message `failure`."""
        result = member.solve(x, iterations)
        if not result.converged:
            raise SolveError(failure)
        return Point.of(member, result)

    def onto(self, member: M, failure: str, iterations: int = NEWTON.iterations) -> Point[M, Any]:
        """Point of another problem close to this one; raises SolveError with the message `failure`."""
        return Point.solved_near(member, member.transfer(self), failure, iterations)


AnyPoint = Point[Any, Any]
"""Point with or without a load."""


class Refined(NamedTuple):
    """Newton step on a finer mesh."""

    member: Any
    """Equations on the finer mesh."""
    state: Any
    """State that was transferred to it."""
    step: Array
    """Step (U,) of the unknowns to the solution."""


@dataclass(frozen=True, eq=False)
class Member(ABC, Generic[S]):
    """Equations of a robot at joint values on one mesh, with U unknowns x."""

    robot: Robot
    problem: Any
    rotations: Array
    """(n,) joint rotations, rad."""
    translations: tuple[float, ...]
    """(n,) joint translations, m."""
    discretisation: Discretisation

    @property
    def factor(self) -> float:
        """Factor on the load of the problem."""
        return 1.0

    @property
    @abstractmethod
    def torsion(self) -> ReducedProblem:
        """Equations of the rotations."""

    @property
    def load(self) -> Load | None:
        """External load, or None."""
        return None

    @abstractmethod
    def on(self: M, **mesh: Any) -> M:
        """Same robot and load on a mesh with another `degree` or `refinement`."""

    @abstractmethod
    def unknowns(self, theta: Array, curvature: Array | None = None) -> Array:
        """(U,) unknowns for rotations (N, n) and, under a load, curvature (N, 2) at the collocation points.

        Without a curvature it is the natural one of the rotations.
        """

    def untwisted(self) -> Array:
        """(U,) unknowns of tubes without torsion."""
        return self.unknowns(np.tile(self.rotations, (len(self.torsion.arc_length), 1)))

    @abstractmethod
    def at(self, x: Array) -> S:
        """State at unknowns x (U,): gradient, Hessian and energy."""

    def owner(self: M, state: S) -> M:
        """Member of a state that was solved; another one if the solve changed the structure of the equations."""
        return self

    def descend(self, x: Array, settings: Newton = NEWTON) -> NewtonResult[S]:
        """Minimise the energy from x (U,) by guarded Newton steps."""
        return self.newton(x, partial(descend, settings=settings))

    def from_home(self) -> NewtonResult[S]:
        """State after turning all tubes together from home, with a descent at each step that leaves saddles."""
        member, x = self, self.untwisted()
        steps = max(1, int(np.ceil(np.abs(self.rotations).max(initial=0.0) / HOME_TURN)))
        for k in range(1, steps + 1):
            member = replace(member, rotations=self.rotations * k / steps)
            result = member.descend(x)
            member = member.owner(result.state)
            if result.converged and member.margin(result.state) <= 0:
                # Either side of a symmetric saddle is possible; the one that ends lower is taken.
                sides = [member.descend(start) for start in member.beside(result.state)]
                result = min(sides, key=lambda side: side.state.energy)
                member = member.owner(result.state)
            x = result.state.x
        return result

    def beside(self, state: S) -> tuple[Array, Array]:
        """Starting points (U,) on either side of an unstable equilibrium, along its most unstable direction."""
        direction = self.softest(state)
        # 0.05 rad is small against the distance between minima, and enough for the energy to fall by more than
        # round-off.
        direction = direction * (0.05 / self.largest_rotation(state, direction))
        return state.x + direction, state.x - direction

    def moved(self, state: S, step: Array) -> S:
        """State after a step (U,) of a descent."""
        return self.at(state.x + step)

    def at_rest(self, state: S) -> NewtonResult[S]:
        """Solution next to a state at the end of a descent."""
        return self.solve(state.x, iterations=4)

    def released(self, state: S, freed: list[object]) -> S | None:
        """State from which a descent continues after a constraint is released; None if no constraint was active.

        `freed` are the constraints that were released before.
        """
        return None

    @abstractmethod
    def largest_rotation(self, state: S, step: Array) -> float:
        """Largest rotation (rad) of a tube or of the arm at a point by a step (U,) from a state."""

    @abstractmethod
    def residual(self, state: S) -> float:
        """Largest violation of the equations, rad."""

    def worst(self, state: S) -> str:
        """Text on the equation with the largest violation; by default only the size of the violation."""
        return f"the largest residual is {self.residual(state):.2g} rad"

    def form(self, state: S) -> Array:
        """(U, U) second variation, which has the margin as smallest eigenvalue, or the linearised equations."""
        return np.asarray(state.hessian)

    @property
    def is_symmetric(self) -> bool:
        """True if `form` is symmetric: the equations have an energy, as without a load all of `form` have."""
        return self.descends

    def margin(self, state: S) -> float:
        """Stability margin of a solved state: the smallest real part of the eigenvalues of `form`, at most 1."""
        form = self.form(state)
        if self.is_symmetric:
            return least(form)
        return min(1.0, float(stiffnesses(form, symmetric=False).min(initial=1.0)))

    def index(self, state: S) -> int:
        """Number of unstable directions of a solved state: eigenvalues of `form` with a negative real part."""
        return int((stiffnesses(self.form(state), symmetric=self.is_symmetric) < 0).sum())

    def softest(self, state: S) -> Array:
        """(U,) unit vector of the eigenvalue of `form` with the smallest real part; of a plane for a complex one."""
        direction = self._softest_pair(state).right.real
        return np.asarray(direction / np.linalg.norm(direction))

    def _softest_pair(self, state: S) -> Pair:
        pair = modes(self.form(state), symmetric=self.is_symmetric, any_of_two=True)
        assert pair is not None
        return pair

    @abstractmethod
    def profile(self, state: S) -> Profile:
        """Rotation and torsion along the arm."""

    @abstractmethod
    def solution(self, point: AnyPoint) -> ArmSolution:
        """Shape, energy and estimated errors of a solved point."""

    def flutters(self, state: S) -> bool:
        """True if the softest mode of a solved state has complex eigenvalues: an oscillation, which has no fold."""
        return not self.descends and bool(abs(self._softest_pair(state).value.imag) > REAL)

    @abstractmethod
    def with_inputs(
        self, rotations: Array, translations: tuple[float, ...], load: Load | None, factor: float
    ) -> Member[S] | None:
        """Same unknowns at other joint values and under a load times a factor; None if the sections differ."""

    def under(self, point: AnyPoint, load: Load, factor: float) -> Member[Any]:
        """Problem at the joint values of a point of this member, under `factor` times another load."""
        return Loaded.of(self.robot, self.rotations, self.translations, load, factor=factor)

    @abstractmethod
    def transfer(self, point: AnyPoint) -> Array:
        """(U,) unknowns with the twist and the bending of a point, which may be on another mesh."""

    @abstractmethod
    def distance(self, point: AnyPoint, state: S) -> float:
        """Largest difference (rad) between a point and a state of this member: of a twist, or of the arm's frame."""

    def reorders(self, point: AnyPoint, state: S) -> bool:
        """True if boundaries along the arm have another order in a state than at a point; they may in bundles."""
        return False

    @abstractmethod
    def round_off(self, state: S) -> float:
        """Sum of the sizes (J) of the energies that may cancel in the potential."""

    def tangent(self, point: AnyPoint) -> Array | None:
        """(U,) linear prediction of the unknowns' change with the load factor; None if anything else changed.

        It includes Newton's step at the point, which may be sampled from another mesh.
        """
        if point.member.problem is not self.problem or not np.array_equal(point.member.rotations, self.rotations):
            return None
        if self.load is None:
            return None
        state = point.state
        # The equations are linear in the factor: this is their residual at the new one.
        residual = state.gradient + (self.factor - state.factor) * state.load_slope
        return np.asarray(scipy.linalg.lapack.dgesv(state.hessian, -residual)[2])

    def refined(self, point: AnyPoint) -> Refined:
        """Newton step of a solved point on a mesh with more points per element, which estimates its errors."""
        finer = self.on(degree=self.discretisation.degree + EXTRA_COLLOCATION_POINTS)
        state = finer.at(finer.transfer(point))
        # At a fold the step along the softest direction is unbounded: its stiffness counts as at least this.
        shift = LEAST_STIFFNESS if abs(point.margin) < LEAST_STIFFNESS else 0.0
        step = np.linalg.solve(state.hessian + shift * np.eye(len(state.x)), -state.gradient)
        return Refined(finer, state, np.asarray(step))

    def downhill(self, state: S, time: float) -> tuple[Array, bool]:
        """(U,) implicit Euler step of the flow x' = -g, and True if its matrix is not positive definite.

        Without an energy, True if the symmetric part of the matrix has a negative eigenvalue.
        """
        # (1 / dt + H) dx = -g, which is Newton's step for dt to infinity.
        matrix = state.hessian.copy()
        matrix.ravel()[:: len(matrix) + 1] += 1 / time
        if self.descends:
            _, step, failed = scipy.linalg.lapack.dposv(matrix, -state.gradient)
            return np.asarray(step), failed != 0
        step = scipy.linalg.lapack.dgesv(matrix, -state.gradient)[2]
        # A positive symmetric part suffices, and costs less.
        doubtful = scipy.linalg.lapack.dpotrf((matrix + matrix.T) / 2)[1] != 0
        return np.asarray(step), doubtful and stiffnesses(matrix, symmetric=False).min() <= 0

    @property
    def descends(self) -> bool:
        """True if the equations are the gradient of an energy, which then decreases along the flow."""
        return True

    def solve(self, x: Array, iterations: int = NEWTON.iterations) -> NewtonResult[S]:
        """Solve by Newton's method with full steps from x (U,)."""
        return self.newton(x, partial(full_steps, iterations=iterations))

    def newton(self, x: Array, method: Callable[..., NewtonResult[S]]) -> NewtonResult[S]:
        """Result of `full_steps` or `descend` of `solvers/newton.py` from x (U,)."""
        return method(self.at(x), lambda state, step: self.at(state.x + step), self.largest_rotation, self.residual)


def elements_of(mesh: Mesh, assembly: Assembly, other: Assembly) -> Index | None:
    """Number of elements of each section (m,) of a mesh; None if another assembly has another number of sections."""
    count = assembly.n_sections
    return np.bincount(mesh.section, minlength=count) if other.n_sections == count else None


# --- Without a load ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Unloaded(Member[Evaluation]):
    """Equations without a load; the unknowns are the torsion's."""

    problem: ReducedProblem
    discretisation: Discretisation = DEFAULT_DISCRETISATION

    @staticmethod
    def of(
        robot: Robot,
        rotations: Array,
        translations: tuple[float, ...],
        discretisation: Discretisation = DEFAULT_DISCRETISATION,
    ) -> Unloaded:
        """Member of a robot at joint values."""
        problem = reduced_problem(robot, translations, discretisation)
        kind = OffCentreline if problem.assembly.eccentric else Unloaded
        return kind(robot, problem, rotations, translations, discretisation)

    @staticmethod
    def of_equilibrium(
        equilibrium: Equilibrium, load: Load | None, discretisation: Discretisation | None
    ) -> tuple[Unloaded, Array]:
        """Member and unknowns of an equilibrium without load; `load` is None."""
        shift = tuple(equilibrium.translations.tolist())
        member = Unloaded.of(equilibrium.robot, equilibrium.rotations, shift, discretisation or DEFAULT_DISCRETISATION)
        return member, member.unknowns(sample_rotation(equilibrium, member.torsion.arc_length))

    @property
    def torsion(self) -> ReducedProblem:
        """Equations of the rotations."""
        return self.problem

    def on(self, **mesh: Any) -> Unloaded:
        """Same robot on a mesh with another `degree` or `refinement`."""
        return Unloaded.of(self.robot, self.rotations, self.translations, replace(self.discretisation, **mesh))

    def unknowns(self, theta: Array, curvature: Array | None = None) -> Array:
        """(U,) unknowns for rotations (N, n)."""
        return to_unknowns(self.problem, self.rotations, theta)

    def at(self, x: Array) -> Evaluation:
        """State at unknowns x (U,)."""
        return evaluate(self.problem, self.rotations, x)

    def largest_rotation(self, state: Evaluation, step: Array) -> float:
        """Largest rotation (rad) of a tube by a step."""
        return torsional_turn(self.problem, step)

    def residual(self, state: Evaluation) -> float:
        """Largest violation of the torsion equations, as an error of theta, rad."""
        return residual(self.problem, state)

    def worst(self, state: Evaluation) -> str:
        """Element, tube and arc length with the largest violation of the torsion equations."""
        return worst_equation(self.problem, state)

    def profile(self, state: Evaluation) -> arms.Profile:
        """Rotation and torsion along the arm, integrated from the collocation points."""
        return arms.profile(self.problem, self.rotations, state)

    def solution(
        self, point: AnyPoint, profile: arms.Profile | None = None, defect: float | None = None
    ) -> ArmSolution:
        """Shape, energy and estimated errors of a solved point.

        With friction, `profile` and `defect` (rad) replace the rotations along the arm and the error of the mesh.
        """
        problem, state = self.problem, point.state
        arm = evaluate_arm(problem, self.rotations, state, point.torsion if profile is None else profile)
        # The inverse of the linearised equations amplifies a defect by at most 1 / margin.
        error = (arm.defect if defect is None else defect) / max(min(1.0, abs(point.margin)), LEAST_STIFFNESS)
        return ArmSolution.of(
            arm,
            problem.assembly,
            points=CollocationPoints(
                problem.arc_length, state.theta + problem.assembly.twist_angle(problem.arc_length)
            ),
            margin=point.margin,
            energy=arm.energy,
            residual=self.residual(state),
            errors=Errors(error, arm.shape_error + error * lever(problem), 0.0),
            iterations=point.iterations,
            index=0 if point.margin > 0 else self.index(state),
        )

    def with_inputs(
        self, rotations: Array, translations: tuple[float, ...], load: Load | None, factor: float
    ) -> Unloaded | None:
        """Same equations at other joint values, without a load."""
        if translations == self.translations:
            return replace(self, rotations=rotations)
        assembly, d = self.robot.assembly(np.array(translations)), self.discretisation
        elements = elements_of(self.problem.mesh, self.problem.assembly, assembly)
        if elements is None:
            return None
        problem = reduce(assembly, make_mesh(assembly, elements, family=d.family, degree=d.degree))
        return (
            replace(self, problem=problem, rotations=rotations, translations=translations)
            if problem.size == self.problem.size
            else None
        )

    def transfer(self, point: AnyPoint) -> Array:
        """(U,) unknowns of a point from another mesh: the twist is interpolated with its slopes."""
        known = point.member
        if known.problem is self.problem:
            return np.asarray(point.state.x)
        twist = np.zeros((len(self.problem.arc_length), len(self.rotations)))
        if len(known.problem.mesh.length):  # nothing twists an arm of length zero
            twist = arms.interpolate(known.problem, point.torsion, self.problem.arc_length) - known.rotations
        return self.unknowns(self.rotations + twist)

    def distance(self, point: AnyPoint, state: Evaluation) -> float:
        """Largest difference (rad) of the twist of coupled tubes; the twist of others is no unknown."""
        return torsional_turn(self.problem, state.x - self.transfer(point))

    def round_off(self, state: Evaluation) -> float:
        """Sum of the bending energies (J), which may cancel, and the energy."""
        return self.problem.energy_parts + abs(state.energy)


@dataclass(frozen=True, eq=False)
class OffCentreline(Unloaded):
    """Equations without a load of tubes off the centreline, which have no energy."""

    def descend(self, x: Array, settings: Newton = NEWTON) -> NewtonResult[Evaluation]:
        """Solve by Newton's method from the minimum of the energy of the same tubes on the centreline."""
        concentric = self._on_centreline()
        # Offsets are a perturbation (d |u| < 1/4): the concentric minimum is close to the solution.
        start = concentric.descend(concentric.unknowns(self.at(x).theta), settings)
        return self.solve(self.unknowns(start.state.theta), settings.iterations)

    def from_home(self) -> NewtonResult[Evaluation]:
        """Solve by Newton's method from the result of `Member.from_home` for the same tubes on the centreline."""
        return self.solve(self.unknowns(self._on_centreline().from_home().state.theta))

    def _on_centreline(self) -> Unloaded:
        """Same tubes on the centreline, where they have an energy."""
        return Unloaded(self.robot, on_centreline(self.problem), self.rotations, self.translations, self.discretisation)

    @property
    def descends(self) -> bool:
        """False: close to a fold the minimum on the centreline may belong to another branch."""
        return False

    def margin(self, state: Evaluation) -> float:
        """Fraction of their torsional stiffness that the tubes may lose at a fixed state before the first fold."""
        return margin(self.problem, state)

    def index(self, state: Evaluation) -> int:
        """Number of folds that tubes at least as stiff as these have met; see `second_variation`."""
        return int((softenings(self.problem, state.theta) > 1).sum()) if self.problem.size else 0


PlainPoint = Point[Unloaded, Evaluation]


@lru_cache(maxsize=16)
def lever(problem: ReducedProblem) -> float:
    """Largest displacement of the tip per error of theta, m/rad: |dp| <= int |du / dtheta| |dtheta| (L - s) ds.

    The curvature u can vanish where tubes oppose each other, but not its derivative, bounded by sum |m_i| / sum kb_i.
    """
    mesh = problem.mesh
    if not len(mesh.length):
        return 0.0
    distance_to_tip = mesh.start[-1] + mesh.length[-1] - mesh.start - mesh.length / 2
    return float((pull_rate(problem) * mesh.length) @ distance_to_tip)


# --- Under a load -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Loaded(Member[LoadedState]):
    """Equations under `factor` times the load of the problem; the unknowns are torsion, then bending."""

    problem: LoadedProblem
    discretisation: Discretisation = LOADED_DISCRETISATION
    """Mesh of the problem."""
    factor: float = 1.0
    """Factor on the load of the problem."""

    @staticmethod
    def of(
        robot: Robot,
        rotations: Array,
        translations: tuple[float, ...],
        load: Load,
        discretisation: Discretisation = LOADED_DISCRETISATION,
        factor: float = 1.0,
    ) -> Loaded:
        """Member of a robot at joint values under `factor` times a load."""
        problem = loaded_problem(robot, translations, load, discretisation)
        return Loaded(robot, problem, rotations, translations, discretisation, factor)

    @staticmethod
    def of_equilibrium(
        equilibrium: Equilibrium, load: Load | None, discretisation: Discretisation | None
    ) -> tuple[Loaded, Array]:
        """Member and unknowns of an equilibrium: under its load on its mesh, or without load under 0 times `load`."""
        robot, rotations, shift = equilibrium.robot, equilibrium.rotations, tuple(equilibrium.translations.tolist())
        if equilibrium.load is not None:
            known = discretisation_of(equilibrium)
            member = Loaded(robot, _loaded_problem_of(equilibrium), rotations, shift, known)
            theta = sample_rotation(equilibrium, equilibrium.point)
            return member, member.unknowns(theta, equilibrium.point_curvature)
        assert load is not None
        check_load(robot, load, shift)
        member = Loaded.of(robot, rotations, shift, load, discretisation or LOADED_DISCRETISATION, 0.0)
        return member, member.unknowns(sample_rotation(equilibrium, member.torsion.arc_length))

    @property
    def torsion(self) -> ReducedProblem:
        """Equations of the rotations."""
        return self.problem.torsion

    def on(self, **mesh: Any) -> Loaded:
        """Same robot and load on a mesh with another `degree` or `refinement`, at the same load factor."""
        d = replace(self.discretisation, **mesh)
        return Loaded.of(self.robot, self.rotations, self.translations, self.problem.load, d, self.factor)

    @property
    def load(self) -> Load:
        """Load times its factor."""
        return self.problem.load if self.factor == 1.0 else self.problem.load.scaled(self.factor)

    def unknowns(self, theta: Array, curvature: Array | None = None) -> Array:
        """(U,) unknowns for rotations (N, n) and curvature (N, 2)."""
        return loaded.unknowns(self.problem, self.rotations, theta, curvature)

    def at(self, x: Array) -> LoadedState:
        """State at unknowns x (U,)."""
        return loaded.evaluate(self.problem, self.rotations, x, self.factor)

    def largest_rotation(self, state: LoadedState, step: Array) -> float:
        """Largest rotation (rad) of a tube by a step, or of the arm if its curvature changed equally all along."""
        tubes = np.abs(self.torsion.factor @ step[: self.torsion.size]).max(initial=0.0)
        length = self.torsion.assembly.total_length
        return max(float(tubes), length * float(np.abs(state.curvature_slope @ step).max(initial=0.0)))

    def residual(self, state: LoadedState) -> float:
        """Largest violation of the equations, as an error of theta or of the arm's direction, rad."""
        split = self.torsion.size
        tubes = np.abs(self.torsion.factor @ state.gradient[:split]).max(initial=0.0)
        bend = np.abs(np.repeat(self.problem.softness, 2) * state.gradient[split:]).max(initial=0.0)
        return max(float(tubes), self.torsion.assembly.total_length * float(bend))

    @property
    def is_symmetric(self) -> bool:
        """True under loads with an energy, and without load."""
        return self.descends or not self.factor

    def profile(self, state: LoadedState) -> arms.Profile:
        """Rotation and torsion along the arm, integrated from the collocation points."""
        return loaded_profile(self.problem, self.rotations, state)

    def solution(
        self, point: AnyPoint, profile: arms.Profile | None = None, errors: Errors | None = None
    ) -> ArmSolution:
        """Shape, energy, compliance, base wrench and estimated errors of a solved point.

        With friction, `profile` and `errors` replace the rotations along the arm and the errors of the mesh. There is
        no compliance then: it depends on which tubes slide.
        """
        state, problem = point.state, self.problem
        profile = point.torsion if profile is None else profile
        known = errors is None and abs(point.margin) >= LEAST_STIFFNESS
        return ArmSolution.of(
            loaded_arm(problem, profile, state),
            problem.torsion.assembly,
            points=CollocationPoints(problem.torsion.arc_length, state.theta + problem.twist_angle, state.curvature),
            margin=point.margin,
            energy=elastic_energy(problem, profile, state),
            residual=self.residual(state),
            errors=self._errors(point) if errors is None else errors,
            iterations=point.iterations,
            index=0 if point.margin > 0 else self.index(state),
            work=state.work,
            compliance=self.compliance(state) if known else None,
            base_wrench=self.base_wrench(state),
        )

    def compliance(self, state: LoadedState) -> Array:
        """Compliance (6, 6) of the tip of a solved state."""
        torsion = self.torsion
        return compliance(self.problem, state, torsion.assembly.total_length, torsion.tip_tube)

    def compliance_at(self, state: LoadedState, arc_length: float, tube: int | None) -> Array:
        """Compliance (6, 6) of a solved state where an element ends; by default the outermost tube carries a moment."""
        chosen = int(twisted_tube(self.torsion.assembly.end, arc_length)) if tube is None else tube
        return compliance(self.problem, state, arc_length, chosen)

    def base_wrench(self, state: LoadedState) -> Array:
        """Wrench (6,) of the load on the plate."""
        return base_wrench(self.problem, state)

    def _errors(self, point: LoadedPoint) -> Errors:
        """Estimated errors: the change by one Newton step on a mesh with more points per element."""
        finer, state, step = self.refined(point)
        problem, split = finer.problem, finer.problem.torsion.size
        theta = np.abs(problem.torsion.factor @ step[:split]).max(initial=0.0)
        tip_change = tip_position(problem, state) + tip_slopes(problem, state.orientation, state.curvature_slope) @ step
        tip_change -= tip_position(self.problem, point.state)
        # The margin is less accurate than the shape only for arms that loads hardly soften.
        hardly_softened = point.margin > HARDLY_SOFTENED and self.descends
        margin = abs(finer.margin(state) - point.margin) if hardly_softened else 0.0
        # Between the points the error of theta is up to 1.6 times that at the points (measured).
        return Errors(2 * float(theta), float(np.linalg.norm(tip_change)), margin)

    @property
    def descends(self) -> bool:
        """True if descent of the energy applies: no moments and no follower forces."""
        return self.problem.couples is None

    def with_inputs(
        self,
        rotations: Array,
        translations: tuple[float, ...],
        load: Load | None,
        factor: float,
        robot: Robot | None = None,
    ) -> Loaded | None:
        """Same equations at other joint values, or of another robot; the load acts at the same points."""
        assert load is not None
        robot = robot or self.robot
        if robot is self.robot and translations == self.translations and load is self.problem.load:
            return replace(self, rotations=rotations, factor=factor)
        assembly, _ = loading_of(robot, translations, load)
        elements = elements_of(self.problem.mesh, self.problem.torsion.assembly, assembly)
        if elements is None:
            return None
        problem = loaded_problem(robot, translations, load, self.discretisation, tuple(elements.tolist()))
        if problem.size != self.problem.size:
            return None
        return Loaded(robot, problem, rotations, translations, self.discretisation, factor)

    def transfer(self, point: AnyPoint) -> Array:
        """(U,) unknowns of a point from another mesh: bending is interpolated by the polynomials of the elements."""
        known, state, problem = point.member, point.state, self.problem
        if known.problem.torsion is problem.torsion:
            return np.asarray(state.x)
        bending = known.problem.softness[:, None] * state.x[known.problem.torsion.size :].reshape(-1, 2)
        if not self._same_points(known.problem):
            bending = known.problem.mesh.interpolated(bending, problem.torsion.arc_length)
        x = self.unknowns(self.rotations + self._twist(point))
        x[problem.torsion.size :] = (bending / problem.softness[:, None]).ravel()
        return x

    def _same_points(self, known: LoadedProblem) -> bool:
        """True if points and unknowns of another problem correspond one to one to those of this one.

        Breakpoints move with the tubes, and cuts of the load stay. A cut elsewhere, as at a contact that slid, does not
        correspond.
        """
        one, other = self.problem.torsion, known.torsion
        same_mesh = len(one.weight) == len(other.weight) and np.array_equal(one.mesh.section, other.mesh.section)
        return (
            same_mesh
            and np.array_equal(one.flat, other.flat)
            and np.allclose(one.assembly.between_tubes, other.assembly.between_tubes, rtol=0, atol=SAME_CUT)
        )

    def _twist(self, point: AnyPoint) -> Array:
        """(N, n) twist of a point at the collocation points of this member, for all tubes."""
        known = point.member
        if self._same_points(known.problem):
            return np.asarray(point.state.theta - known.rotations)
        theta = arms.interpolate(known.torsion, point.torsion, self.torsion.arc_length)
        return np.asarray(theta - known.rotations)

    def distance(self, point: AnyPoint, state: LoadedState) -> float:
        """Largest difference (rad) of a twist and of the arm's frame at the collocation points."""
        frames = point.state.orientation.stage
        if not self._same_points(point.member.problem):
            frames = point.member.problem.mesh.interpolated(frames, self.torsion.arc_length)
        twist_change = (state.theta - self.rotations - self._twist(point)).ravel()[self.problem.torsion.flat]
        twist = np.abs(twist_change).max(initial=0.0)
        # The frames are unit quaternions: a rotation by a moves one by a / 2.
        return max(float(twist), 2 * float(np.linalg.norm(state.orientation.stage - frames, axis=1).max()))

    def round_off(self, state: LoadedState) -> float:
        """Sum of elastic energy and work (J), which may cancel."""
        return state.energy + abs(state.work)


LoadedPoint = Point[Loaded, LoadedState]


# --- Samples of a solved equilibrium ----------------------------------------------------------------------------------


def discretisation_of(equilibrium: Equilibrium) -> Discretisation:
    """Discretisation that an equilibrium was solved on."""
    statistics = equilibrium.statistics
    return _discretisation(statistics.family, statistics.degree, statistics.refinement)


_discretisation = lru_cache(maxsize=64)(Discretisation)


def _loaded_problem_of(equilibrium: Equilibrium) -> LoadedProblem:
    """Problem of a loaded equilibrium on its own mesh, possibly refined for a larger load."""
    robot, shift, load = equilibrium.robot, tuple(equilibrium.translations.tolist()), equilibrium.load
    assert load is not None
    start, d = loading_of(robot, shift, load)[0].start, discretisation_of(equilibrium)
    points = np.bincount(np.searchsorted(start, equilibrium.point, side="right") - 1, minlength=len(start))
    return loaded_problem(robot, shift, load, d, tuple((points // d.degree).tolist()))


def at_points(start: Equilibrium, problem: LoadedProblem) -> tuple[Array, Array | None]:
    """Elastic rotations (N, n) and curvature (N, 2) of an equilibrium at the points of a problem.

    The curvature is None without a load.
    """
    s, curvature = problem.torsion.arc_length, None
    if start.load is not None:
        tolerance = LARGEST_SHIFT * start.arc_length[-1]
        if len(s) == len(start.point) and np.abs(s - start.point).max() <= tolerance:
            s, curvature = start.point, start.point_curvature
        else:
            curvature = _loaded_problem_of(start).mesh.interpolated(start.point_curvature, s)
    return sample_rotation(start, s), curvature


def sample_rotation(equilibrium: Equilibrium, arc_length: Array) -> Array:
    """(N, n) rotations theta of an equilibrium at arc lengths (N,), rad; phi for tubes made of pieces.

    As solved at its own collocation points, interpolated by cubic Hermite polynomials elsewhere.
    """
    points, robot, shift = equilibrium.point, equilibrium.robot, equilibrium.translations
    if len(points) != len(arc_length) or np.abs(points - arc_length).max(initial=0.0) > LENGTH_ROUND_OFF:
        arm = np.stack([equilibrium.rotation.T, equilibrium.torsion.T])
        return sample_arms(robot, shift, equilibrium.arc_length, arm, arc_length)
    theta = equilibrium.point_rotation
    return theta if robot.even else theta - assembly_of(robot, tuple(shift.tolist())).twist_angle(arc_length)


def sample_arms(robot: Robot, translations: Array, s: Array, arms: Array, arc_length: Array) -> Array:
    """(..., N, n) theta or phi at arc lengths (N,) of arms (..., 2, m, n), rotation and torsion at s (m,)."""
    rotation, torsion = arms[..., 0, :, :], arms[..., 1, :, :]
    even = robot.even
    phi = rotation if even else rotation - robot.assembly(translations).twist_angle(s)
    if len(s) < 2:
        return np.repeat(phi, len(arc_length), axis=-2)
    if not even:
        # The polynomial through the shape points of each piece: the torsion jumps between pieces.
        piece, _, x = between(s[::SHAPE_STEPS], arc_length)
        basis = np.vander(np.clip(x, 0.0, 1.0), SHAPE_STEPS + 1, increasing=True) @ THROUGH_ENDS
        around = phi[..., piece[:, None] * SHAPE_STEPS + np.arange(SHAPE_STEPS + 1), :]
        return np.asarray(np.einsum("ak,...aki->...ai", basis, around))
    k, length, fraction = between(s, arc_length)
    h, x = length[:, None], np.minimum(np.maximum(fraction, 0.0), 1.0)[:, None]
    ends = rotation[..., k, :], rotation[..., k + 1, :], torsion[..., k, :], torsion[..., k + 1, :]
    return np.asarray(cubic(*ends, x, h))
