"""One robot at joint values, under a load or without one: the problem that a continuation solves at each of its points.

`Unloaded` and `Loaded` answer the same questions about their unknowns. What follows a branch, finds its end, or falls
downhill in energy asks these only, and so is written once.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, Generic, TypeVar

import numpy as np
import scipy

from ..block.transcription import arm as arms
from ..block.transcription import loaded
from ..block.transcription.arm import ArmSolution, CollocationPoints, Profile, evaluate_arm
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
)
from ..block.transcription.second_variation import least, margin, softest, softest_of, stiffnesses, unstable_directions
from ..errors import SolveError
from ..robots.assembly import Assembly
from ..robots.load import Load
from ..robots.robot import Robot
from ..solvers.newton import NewtonResult, descend, full_steps, leave_saddle, torsional_turn
from ..solvers.settings import HARDLY_SOFTENED, LEAST_STIFFNESS, NEWTON, Newton
from ..typing import Array, Index
from .problem import (
    DEFAULT_DISCRETISATION,
    EXTRA_POINTS,
    LOADED_DISCRETISATION,
    Discretisation,
    loaded_problem,
    loading_of,
    reduced_problem,
)

S = TypeVar("S", Evaluation, LoadedState)
M = TypeVar("M", bound="Member[Any]")


@dataclass(frozen=True, eq=False)
class Point(Generic[M, S]):
    """A solved equilibrium at t of a family."""

    t: float
    member: M
    state: S
    margin: float
    iterations: int = 0

    @cached_property
    def softest(self) -> Array:
        """(U,) direction in which the equilibrium is softest."""
        return np.asarray(self.member.softest(self.state))

    @cached_property
    def unresisted(self) -> Array:
        """(U,) push that the softest direction does not resist at a fold: along it, if the equations have an energy."""
        if self.member.descends:
            return self.softest
        # One inverse iteration with H': at a fold that gives the left vector of its zero eigenvalue.
        push = np.linalg.solve(self.state.hessian.T, self.softest)
        return np.asarray(push * np.sign(push @ self.softest) / np.linalg.norm(push))

    @property
    def torsion(self) -> Profile:
        """Along the arm."""
        return self.member.along(self.state)

    @staticmethod
    def of(member: M, result: NewtonResult[S], t: float = 0.0) -> Point[M, S]:
        """What a solver found, at t."""
        return Point(t, member, result.state, member.margin(result.state), result.iterations)

    @staticmethod
    def at(member: M, x: Array, t: float = 0.0) -> Point[M, S]:
        """That of unknowns x, which are solved."""
        state = member.at(x)
        return Point(t, member, state, member.margin(state))

    @staticmethod
    def near(member: M, x: Array, failure: str, iterations: int = NEWTON.iterations) -> Point[M, S]:
        """What Newton's method finds from unknowns x; raises SolveError, with words of its failure, where it fails."""
        result = member.solve(x, iterations)
        if not result.converged:
            raise SolveError(failure)
        return Point.of(member, result)

    def onto(self, there: M, failure: str, iterations: int = NEWTON.iterations) -> Point[M, Any]:
        """The equilibrium of another problem close to this one; raises SolveError as `near`."""
        return Point.near(there, there.carried(self), failure, iterations)


Place = Point[Any, Any]
"""A point with a load or without one."""


@dataclass(frozen=True, eq=False)
class Member(ABC, Generic[S]):
    """A robot at joint values, (n,) rad and m, on one mesh; U unknowns x."""

    robot: Robot
    problem: Any
    rotations: Array
    translations: tuple[float, ...]
    discretisation: Discretisation

    @property
    @abstractmethod
    def torsion(self) -> ReducedProblem:
        """The problem of its rotations."""

    @property
    def load(self) -> Load | None:
        """That acts; None without one."""
        return None

    @abstractmethod
    def on(self: M, **mesh: Any) -> M:
        """The same with another `degree` or `refinement` of the mesh."""

    @abstractmethod
    def unknowns(self, theta: Array, curvature: Array | None = None) -> Array:
        """(U,) unknowns of rotations (N, n) and, under a load, curvature (N, 2) at the points; None is that of the
        rotations without a load."""

    @abstractmethod
    def at(self, x: Array) -> S:
        """The state of unknowns x (U,)."""

    @abstractmethod
    def turn(self, state: S, step: Array) -> float:
        """Largest turn (rad) by a step (U,) from a state: of a tube at a point, or of the arm."""

    @abstractmethod
    def residual(self, state: S) -> float:
        """Largest violation of the equations, rad."""

    @abstractmethod
    def margin(self, state: S) -> float:
        """Stability margin of a solved state."""

    @abstractmethod
    def index(self, state: S) -> int:
        """How many directions of a solved state are unstable."""

    @abstractmethod
    def along(self, state: S) -> Profile:
        """Torsion along the arm of a state."""

    @abstractmethod
    def found(self, point: Place) -> ArmSolution:
        """Shape, energy and estimated errors of a solved point."""

    @abstractmethod
    def softest(self, state: S) -> Array:
        """(U,) direction in which a solved state is softest."""

    def flutters(self, state: S) -> bool:
        """Whether a solved state is softest in an oscillation: a pair of complex eigenvalues, which has no fold."""
        return not self.descends and softest_of(state.hessian)[1]

    @abstractmethod
    def beside(
        self, rotations: Array, translations: tuple[float, ...], load: Load | None, factor: float
    ) -> Member[S] | None:
        """The problem at other joint values and under a load times a factor on a mesh with as many pieces, so that it
        has the same unknowns; None where the sections are others."""

    @abstractmethod
    def carried(self, point: Place) -> Array:
        """(U,) unknowns with the twist and the bending of a point, which may be on another mesh."""

    @abstractmethod
    def moved(self, point: Place, state: S) -> float:
        """Largest change of a twist, and turn of the arm, from a point to a state here, rad."""

    @abstractmethod
    def round_off(self, state: S) -> float:
        """Size (J) of the energies whose sum a state's is."""

    def tangent(self, point: Place) -> Array | None:
        """(U,) change of the unknowns of a point along the branch, where that costs nothing; else None."""
        return None

    def downhill(self, state: S, time: float) -> tuple[Array, bool]:
        """(U,) step of the gradient flow of the energy in a time, and whether its matrix is not positive; without an
        energy, of the flow against the residual, and whether that grows apart."""
        # Implicit Euler step of x' = -g: (1 / dt + H) dx = -g, Newton's step for dt to infinity.
        matrix = _shifted(state.hessian, 1 / time)
        if self.descends:
            _, step, failed = scipy.linalg.lapack.dposv(matrix, -state.gradient)
            return np.asarray(step), failed != 0
        step = scipy.linalg.lapack.dgesv(matrix, -state.gradient)[2]
        # A positive symmetric part suffices, and costs less.
        doubtful = scipy.linalg.lapack.dpotrf((matrix + matrix.T) / 2)[1] != 0
        return np.asarray(step), doubtful and stiffnesses(matrix, symmetric=False).min() <= 0

    @property
    def descends(self) -> bool:
        """Whether the gradient is that of an energy, which falls along the flow."""
        return True

    def solve(self, x: Array, iterations: int = NEWTON.iterations) -> NewtonResult[S]:
        """By Newton's method from x (U,), in at most so many steps."""
        return full_steps(
            self.at(x),
            lambda state, step: self.at(state.x + step),
            self.turn,
            self.residual,
            iterations,
        )


def pieces_of(mesh: Mesh, assembly: Assembly, there: Assembly) -> Index | None:
    """(m,) pieces of each section of a mesh; None where another assembly has not as many sections."""
    count = assembly.n_sections
    return np.bincount(mesh.section, minlength=count) if there.n_sections == count else None


def _shifted(matrix: Array, by: float) -> Array:
    """A square matrix with a number added to its diagonal."""
    out = matrix.copy()
    out.ravel()[:: len(out) + 1] += by
    return out


# --- Without a load ---------------------------------------------------------------------------------------------------

# The tubes turn together from home, and each step ends in a minimum. Opposed tubes may leave the branch through a fold
# in any step; a step of at most a sixteenth of a turn keeps them in the basin of the nearest minimum.
HOME_TURN = math.pi / 8
"""Largest turn (rad) of a tube per step of the path from home, for a cold start that ended in no stable equilibrium."""


@dataclass(frozen=True, eq=False)
class Unloaded(Member[Evaluation]):
    """Without a load: the unknowns are those of the torsion."""

    problem: ReducedProblem
    discretisation: Discretisation = DEFAULT_DISCRETISATION

    @staticmethod
    def of(
        robot: Robot,
        rotations: Array,
        translations: tuple[float, ...],
        discretisation: Discretisation = DEFAULT_DISCRETISATION,
    ) -> Unloaded:
        """That of a robot at joint values."""
        problem = reduced_problem(robot, translations, discretisation)
        return Unloaded(robot, problem, rotations, translations, discretisation)

    @property
    def torsion(self) -> ReducedProblem:
        """See `Member`, as below."""
        return self.problem

    def on(self, **mesh: Any) -> Unloaded:
        """At the same joint values."""
        return Unloaded.of(self.robot, self.rotations, self.translations, replace(self.discretisation, **mesh))

    def unknowns(self, theta: Array, curvature: Array | None = None) -> Array:
        """Of rotations alone."""
        return to_unknowns(self.problem, self.rotations, theta)

    def at(self, x: Array) -> Evaluation:
        """Of the torsion."""
        return evaluate(self.problem, self.rotations, x)

    def descend(self, x: Array, settings: Newton = NEWTON) -> NewtonResult[Evaluation]:
        """The minimum of the energy to which a descent leads from x (U,); for tubes off the centreline, which have no
        such energy, what Newton's method finds from that of the same tubes on it."""
        if self.problem.assembly.eccentric:
            there = self._on_centreline()
            # Offsets are a perturbation (d |u| < 1/4): the concentric minimum is a start close to the answer.
            start = there.descend(there.unknowns(self.at(x).theta), settings)
            return self.solve(self.unknowns(start.state.theta), settings.iterations)
        return descend(self.at(x), lambda state, step: self.at(state.x + step), self.turn, self.residual, settings)

    def from_home(self) -> NewtonResult[Evaluation]:
        """By turning all tubes together from home, with a descent in energy at each step, off any saddle."""
        there = self._on_centreline()
        z = np.zeros(there.problem.size)
        steps = max(1, int(np.ceil(np.abs(self.rotations).max(initial=0.0) / HOME_TURN)))
        for k in range(1, steps + 1):
            here = replace(there, rotations=self.rotations * k / steps)
            result = here.descend(z)
            if result.converged and here.margin(result.state) <= 0:
                # A symmetric saddle has two sides of equal right; the lower one is taken.
                sides = [here.descend(start) for start in leave_saddle(here.problem, result.state)]
                result = min(sides, key=lambda side: side.state.energy)
            z = result.state.z
        if self.problem.assembly.eccentric:
            result = self.solve(self.unknowns(result.state.theta))
        return result

    def _on_centreline(self) -> Unloaded:
        """With all tubes on the centreline: these have the energy that is to fall."""
        return replace(self, problem=on_centreline(self.problem))

    def turn(self, state: Evaluation, step: Array) -> float:
        """Of a tube."""
        return torsional_turn(self.problem, step)

    def residual(self, state: Evaluation) -> float:
        """Of the equations of torsion."""
        return residual(self.problem, state)

    def margin(self, state: Evaluation) -> float:
        """By the second variation."""
        return margin(self.problem, state)

    def index(self, state: Evaluation) -> int:
        """By the second variation."""
        return unstable_directions(self.problem, state)

    def along(self, state: Evaluation) -> arms.Profile:
        """Integrated from the points."""
        return arms.profile(self.problem, self.rotations, state)

    def found(self, point: Place, rubbed: tuple[arms.Profile, float] | None = None) -> ArmSolution:
        """`rubbed`: torsion along the arm and the error (rad) of the mesh, where friction shapes them too."""
        problem, state = self.problem, point.state
        torsion, defect = (point.torsion, None) if rubbed is None else rubbed
        arm = evaluate_arm(problem, self.rotations, state, torsion)
        # The inverse of the linearised equation amplifies a defect by at most one over the margin.
        error = (arm.defect if defect is None else defect) / max(min(1.0, abs(point.margin)), 1e-6)
        return ArmSolution.of(
            arm,
            problem.assembly,
            points=CollocationPoints(problem.arc_length, state.theta + problem.assembly.wound(problem.arc_length)),
            margin=point.margin,
            energy=arm.energy,
            residual=self.residual(state),
            errors=(error, arm.shape_error + error * lever(problem), 0.0),
            iterations=point.iterations,
            index=0 if point.margin > 0 else self.index(state),
        )

    def softest(self, state: Evaluation) -> Array:
        """By the second variation."""
        return softest(self.problem, state)

    def beside(
        self, rotations: Array, translations: tuple[float, ...], load: Load | None, factor: float
    ) -> Unloaded | None:
        """Without a load."""
        if translations == self.translations:
            return replace(self, rotations=rotations)
        assembly, d = self.robot.assembly(np.array(translations)), self.discretisation
        pieces = pieces_of(self.problem.mesh, self.problem.assembly, assembly)
        if pieces is None:
            return None
        problem = reduce(assembly, make_mesh(assembly, pieces, family=d.family, degree=d.degree))
        there = Unloaded(self.robot, problem, rotations, translations, d)
        return there if problem.size == self.problem.size else None

    def carried(self, point: Place) -> Array:
        """Twist is interpolated with its own slopes, also where nothing couples the tubes."""
        known = point.member
        if known.problem is self.problem:
            return np.asarray(point.state.x)
        twist = np.zeros((len(self.problem.arc_length), len(self.rotations)))
        if len(known.problem.mesh.length):  # nothing twists an arm of length zero
            twist = arms.interpolate(known.problem, point.torsion, self.problem.arc_length) - known.rotations
        return self.unknowns(self.rotations + twist)

    def moved(self, point: Place, state: Evaluation) -> float:
        """Of the coupled tubes: the others are carried along, not solved for."""
        return torsional_turn(self.problem, state.x - self.carried(point))

    def round_off(self, state: Evaluation) -> float:
        """Bending energies may cancel."""
        return self.problem.energy_parts + abs(state.energy)

    @property
    def descends(self) -> bool:
        """At a fold of tubes off the centreline the same tubes on it may have a minimum close by, in which a descent of
        their energy would be caught."""
        return not self.problem.assembly.eccentric


PlainPoint = Point[Unloaded, Evaluation]


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


# --- Under a load -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Loaded(Member[LoadedState]):
    """Under `factor` times the load of the problem: the unknowns are those of the torsion, then of the bending."""

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
        """That of a robot at joint values under `factor` times a load."""
        problem = loaded_problem(robot, translations, load, discretisation)
        return Loaded(robot, problem, rotations, translations, discretisation, factor)

    @property
    def torsion(self) -> ReducedProblem:
        """See `Member`, as below."""
        return self.problem.torsion

    def on(self, **mesh: Any) -> Loaded:
        """Under the same part of the load."""
        d = replace(self.discretisation, **mesh)
        return Loaded.of(self.robot, self.rotations, self.translations, self.problem.load, d, self.factor)

    @property
    def load(self) -> Load:
        """That acts."""
        return self.problem.load if self.factor == 1.0 else self.problem.load.scaled(self.factor)

    def unknowns(self, theta: Array, curvature: Array | None = None) -> Array:
        """Of rotations and curvature."""
        return loaded.unknowns(self.problem, self.rotations, theta, curvature)

    def at(self, x: Array) -> LoadedState:
        """Under the part of the load that acts."""
        return loaded.evaluate(self.problem, self.rotations, x, self.factor)

    def turn(self, state: LoadedState, step: Array) -> float:
        """Of a tube, or of the arm if its curvature changed alike all along it."""
        tubes = np.abs(self.torsion.factor @ step[: self.torsion.size]).max(initial=0.0)
        length = self.torsion.assembly.total_length
        return max(float(tubes), length * float(np.abs(state.turned @ step).max(initial=0.0)))

    def residual(self, state: LoadedState) -> float:
        """Of the equations of torsion and bending, as an error of theta at the points or of the arm's direction."""
        split = self.torsion.size
        tubes = np.abs(self.torsion.factor @ state.gradient[:split]).max(initial=0.0)
        bend = np.abs(np.repeat(self.problem.softness, 2) * state.gradient[split:]).max(initial=0.0)
        return max(float(tubes), self.torsion.assembly.total_length * float(bend))

    def margin(self, state: LoadedState) -> float:
        """By the second variation relative to its torsional and bending part, at most 1; under loads without an energy
        the least real part of the eigenvalues of the linearised equations."""
        if self.problem.couples is None or not state.factor:  # without load the equations have an energy
            return least(state.hessian)
        return min(1.0, float(stiffnesses(state.hessian, symmetric=False).min(initial=1.0)))

    def index(self, state: LoadedState) -> int:
        """By the second variation, or the linearised equations."""
        return int((stiffnesses(state.hessian, symmetric=self.descends) < 0).sum())

    def along(self, state: LoadedState) -> arms.Profile:
        """Integrated from the points and the torques at joints."""
        return loaded_profile(self.problem, self.rotations, state)

    def found(self, point: Place) -> ArmSolution:
        """What follows from the solved state at once need not be solved for again."""
        state, problem, profile = point.state, self.problem, point.torsion
        return ArmSolution.of(
            loaded_arm(problem, profile, state),
            problem.torsion.assembly,
            points=CollocationPoints(problem.torsion.arc_length, state.theta + problem.wound, state.curvature),
            margin=point.margin,
            energy=elastic_energy(problem, profile, state),
            residual=self.residual(state),
            errors=self._errors(point),
            iterations=point.iterations,
            index=0 if point.margin > 0 else self.index(state),
            work=state.work,
            compliance=None if abs(point.margin) < LEAST_STIFFNESS else compliance(problem, state),
            base_wrench=base_wrench(problem, state),
        )

    def _errors(self, point: LoadedPoint) -> tuple[float, float, float]:
        """Estimated errors of theta, rad, of the tip, m, and of the margin: what a Newton step on a finer rule
        changes."""
        there = self.on(degree=self.discretisation.degree + EXTRA_POINTS)
        problem, state = there.problem, there.at(there.carried(point))
        # At a fold the step along the softest direction has no bound: its stiffness counts as at least this.
        least = LEAST_STIFFNESS
        shift = least if abs(point.margin) < least else 0.0
        step = np.linalg.solve(state.hessian + shift * np.eye(problem.size), -state.gradient)
        split = problem.torsion.size
        theta = np.abs(problem.torsion.factor @ step[:split]).max(initial=0.0)
        moved = tip_position(problem, state) + tip_slopes(problem, state)[:3] @ step
        moved -= tip_position(self.problem, point.state)
        # Only of arms that loads hardly soften is the margin less sure than the shape.
        close = point.margin > HARDLY_SOFTENED and self.descends
        margin = abs(there.margin(state) - point.margin) if close else 0.0
        # Between the points theta is up to 1.6 times as far off as at them (measured).
        return 2 * float(theta), float(np.linalg.norm(moved)), margin

    def softest(self, state: LoadedState) -> Array:
        """By the second variation, or the linearised equations."""
        if not self.descends:
            return softest_of(state.hessian)[0]
        vectors: Array = np.linalg.eigh(state.hessian)[1]
        return vectors[:, 0]

    @property
    def descends(self) -> bool:
        """Moments and forces that turn with the tip have no energy."""
        return self.problem.couples is None

    def beside(
        self, rotations: Array, translations: tuple[float, ...], load: Load | None, factor: float
    ) -> Loaded | None:
        """Under a load whose places are the same."""
        assert load is not None
        if translations == self.translations and load is self.problem.load:
            return replace(self, rotations=rotations, factor=factor)
        assembly, _ = loading_of(self.robot, translations, load)
        pieces = pieces_of(self.problem.mesh, self.problem.torsion.assembly, assembly)
        if pieces is None:
            return None
        problem = loaded_problem(self.robot, translations, load, self.discretisation, tuple(pieces.tolist()))
        there = Loaded(self.robot, problem, rotations, translations, self.discretisation, factor)
        return there if problem.size == self.problem.size else None

    def carried(self, point: Place) -> Array:
        """Bending is interpolated by the polynomials of the pieces."""
        known, state, there = point.member, point.state, self.problem
        if known.problem.torsion is there.torsion:
            return np.asarray(state.x)
        bent = known.problem.softness[:, None] * state.x[known.problem.torsion.size :].reshape(-1, 2)
        if not self._alike(known.problem):
            bent = known.problem.mesh.interpolated(bent, there.torsion.arc_length)
        x = self.unknowns(self.rotations + self._twist(point))
        x[there.torsion.size :] = (bent / there.softness[:, None]).ravel()
        return x

    def _alike(self, known: LoadedProblem) -> bool:
        """Whether the points and unknowns of another problem stand for those here, one by one."""
        own, other = self.problem.torsion, known.torsion
        same_points = len(own.weight) == len(other.weight) and np.array_equal(own.mesh.section, other.mesh.section)
        return same_points and np.array_equal(own.flat, other.flat)

    def _twist(self, point: Place) -> Array:
        """(N, n) twist of a point at the points here: where a tube was not unknown it has one all the same."""
        known = point.member
        if self._alike(known.problem):
            return np.asarray(point.state.theta - known.rotations)
        theta = arms.interpolate(known.torsion, point.torsion, self.torsion.arc_length)
        return np.asarray(theta - known.rotations)

    def moved(self, point: Place, state: LoadedState) -> float:
        """Of a twist at a point, and of the arm's frame there."""
        frames = point.state.orientation.stage
        if not self._alike(point.member.problem):
            frames = point.member.problem.mesh.interpolated(frames, self.torsion.arc_length)
        turned = (state.theta - self.rotations - self._twist(point)).ravel()[self.problem.torsion.flat]
        twist = np.abs(turned).max(initial=0.0)
        return max(float(twist), 2 * float(np.linalg.norm(state.orientation.stage - frames, axis=1).max()))

    def tangent(self, point: Place) -> Array | None:
        """Where only the factor changes, by what the load pulls."""
        if point.member.problem is not self.problem or not np.array_equal(point.member.rotations, self.rotations):
            return None
        step = scipy.linalg.lapack.dgesv(point.state.hessian, -point.state.pull)[2]
        return np.asarray(step * (self.factor - point.state.factor))

    def round_off(self, state: LoadedState) -> float:
        """Elastic energy and work may cancel."""
        return state.energy + abs(state.work)


LoadedPoint = Point[Loaded, LoadedState]
