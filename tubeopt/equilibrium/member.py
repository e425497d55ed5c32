"""One robot at joint values, under a load or without one: the problem that a continuation solves at each of its points.

`Unloaded` and `Loaded` answer the same questions about their unknowns. What follows a branch, finds its end, or falls
downhill in energy asks these only, and so is written once.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Generic, TypeVar

import numpy as np
import scipy

from ..block.transcription.arm import Found, Profile
from ..block.transcription.loaded import LoadedState
from ..block.transcription.mesh import Mesh
from ..block.transcription.reduced import Evaluation, ReducedProblem
from ..block.transcription.second_variation import softest_of, stiffnesses
from ..errors import SolveError
from ..robots.assembly import Assembly
from ..robots.load import Load
from ..robots.robot import Robot
from ..solvers.newton import NewtonResult, full_steps
from ..solvers.settings import NEWTON
from ..typing import Array, Index
from .problem import Discretisation

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
    def found(self, point: Place) -> Found:
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
