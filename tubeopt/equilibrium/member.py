"""One robot at joint values, under a load or without one: the problem that a continuation solves at each of its points.

`Unloaded` and `Loaded` answer the same questions about their unknowns. What follows a branch, finds its end, or falls
downhill in energy asks these only, and so is written once.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Generic, TypeVar

import numpy as np
import scipy

from ..block.transcription import arm as arms
from ..block.transcription import loaded
from ..block.transcription.loaded import LoadedProblem, LoadedState
from ..block.transcription.loaded_arm import loaded_profile
from ..block.transcription.mesh import Mesh, make_mesh
from ..block.transcription.reduced import Evaluation, ReducedProblem, evaluate, reduce, residual, to_unknowns
from ..block.transcription.second_variation import margin, softest, softest_of, stiffnesses, unstable_directions
from ..errors import SolveError
from ..robots.assembly import Assembly
from ..robots.load import Load
from ..robots.robot import Robot
from ..solvers.newton import NewtonResult, full_steps, loaded_margin, loaded_residual, torsional_turn, turn_of
from ..solvers.settings import NEWTON, Newton
from ..typing import Array, Index
from .problem import (
    DEFAULT_DISCRETISATION,
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
        push = np.linalg.solve(self.state.hessian.T, self.softest)
        return np.asarray(push * np.sign(push @ self.softest) / np.linalg.norm(push))

    @property
    def torsion(self) -> arms.Profile:
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
    def near(member: M, x: Array, failure: str, settings: Newton = NEWTON) -> Point[M, S]:
        """What Newton's method finds from unknowns x; raises SolveError, with words of its failure, where it fails."""
        result = member.solve(x, settings=settings)
        if not result.converged:
            raise SolveError(failure)
        return Point.of(member, result)


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
    def along(self, state: S) -> arms.Profile:
        """Torsion along the arm of a state."""

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

    def tangent(self, near: Place) -> Array | None:
        """(U,) change of the unknowns of a point along the branch, where that costs nothing; else None."""
        return None

    def downhill(self, state: S, time: float) -> tuple[Array, bool]:
        """(U,) step of the gradient flow of the energy in a time, and whether its matrix is not positive; without an
        energy, of the flow against the residual, and whether that grows apart."""
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

    def solve(self, x: Array, iterations: int | None = None, settings: Newton = NEWTON) -> NewtonResult[S]:
        """By Newton's method from x (U,), in by default as many steps as in `settings`."""
        return full_steps(
            self.at(x),
            lambda state, step: self.at(state.x + step),
            self.turn,
            self.residual,
            settings,
            settings.iterations if iterations is None else iterations,
        )


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
        pieces = _pieces(self.problem.mesh, self.problem.assembly, assembly)
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


@dataclass(frozen=True, eq=False)
class Loaded(Member[LoadedState]):
    """Under `factor` times the load of the problem: the unknowns are those of the torsion, then of the bending."""

    problem: LoadedProblem
    discretisation: Discretisation = LOADED_DISCRETISATION
    factor: float = 1.0

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
        return turn_of(self.problem, state, step)

    def residual(self, state: LoadedState) -> float:
        """Of the equations of torsion and bending."""
        return loaded_residual(self.problem, state)

    def margin(self, state: LoadedState) -> float:
        """By the second variation, or the linearised equations."""
        return loaded_margin(self.problem, state)

    def index(self, state: LoadedState) -> int:
        """By the second variation, or the linearised equations."""
        return int((stiffnesses(state.hessian, symmetric=self.descends) < 0).sum())

    def along(self, state: LoadedState) -> arms.Profile:
        """Integrated from the points and the torques at joints."""
        return loaded_profile(self.problem, self.rotations, state)

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
        pieces = _pieces(self.problem.mesh, self.problem.torsion.assembly, assembly)
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
            bent = interpolate(known.problem, bent, there)
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
            frames = interpolate(point.member.problem, frames, self.problem)
        turned = (state.theta - self.rotations - self._twist(point)).ravel()[self.problem.torsion.flat]
        twist = np.abs(turned).max(initial=0.0)
        return max(float(twist), 2 * float(np.linalg.norm(state.orientation.stage - frames, axis=1).max()))

    def tangent(self, near: Place) -> Array | None:
        """Where only the factor changes, by what the load pulls."""
        if near.member.problem is not self.problem or not np.array_equal(near.member.rotations, self.rotations):
            return None
        step = scipy.linalg.lapack.dgesv(near.state.hessian, -near.state.pull)[2]
        return np.asarray(step * (self.factor - near.state.factor))

    def round_off(self, state: LoadedState) -> float:
        """Elastic energy and work may cancel."""
        return state.energy + abs(state.work)


PlainPoint = Point[Unloaded, Evaluation]
LoadedPoint = Point[Loaded, LoadedState]


def _pieces(mesh: Mesh, assembly: Assembly, there: Assembly) -> Index | None:
    """(m,) pieces of each section of a mesh; None where another assembly has not as many sections."""
    count = assembly.n_sections
    return np.bincount(mesh.section, minlength=count) if there.n_sections == count else None


def _shifted(matrix: Array, by: float) -> Array:
    """A square matrix with a number added to its diagonal."""
    out = matrix.copy()
    out.ravel()[:: len(out) + 1] += by
    return out


def interpolate(problem: LoadedProblem, table: Array, there: LoadedProblem) -> Array:
    """Values (N, k) at the points of one problem, at those of another."""
    mesh, s = problem.mesh, there.torsion.arc_length
    piece = np.clip(np.searchsorted(mesh.start, s, side="right") - 1, 0, len(mesh.start) - 1)
    x = np.clip((s - mesh.start[piece]) / mesh.length[piece], 0.0, 1.0)
    inner = table.reshape(len(mesh.start), mesh.tableau.degree, -1)
    return np.asarray(np.einsum("ak,aki->ai", mesh.tableau.lagrange(x), inner[piece]))
