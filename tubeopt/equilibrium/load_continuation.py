"""Following an equilibrium under load along a family of problems: the load grows, or the joints move under it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from ..block.transcription.loaded import LoadedProblem, LoadedState, evaluate, unknowns
from ..errors import SolveError
from ..robots.load import Load, between
from ..robots.robot import Robot
from ..solvers.newton import NewtonResult, loaded_margin, loaded_newton
from ..solvers.settings import CONTINUATION
from ..typing import Array
from .continuation import JointPath, largest_twist
from .load_problem import LOADED_DISCRETISATION, loaded_problem
from .solving import Discretisation


@dataclass(frozen=True, eq=False)
class Member:
    """One problem of a family: a robot at joint values (n,) under `factor` times the load of the problem."""

    robot: Robot
    problem: LoadedProblem
    rotations: Array
    translations: tuple[float, ...]
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
    ) -> Member:
        """That of a robot at joint values under `factor` times a load."""
        problem = loaded_problem(robot, translations, load, discretisation)
        return Member(robot, problem, rotations, translations, discretisation, factor)

    def on(self, **mesh: Any) -> Member:
        """The same with another `degree` or `refinement` of the mesh."""
        d = replace(self.discretisation, **mesh)
        return Member.of(self.robot, self.rotations, self.translations, self.problem.load, d, self.factor)

    @property
    def load(self) -> Load:
        """That acts."""
        return self.problem.load if self.factor == 1.0 else self.problem.load.scaled(self.factor)

    def at(self, x: Array) -> LoadedState:
        """The state of unknowns x."""
        return evaluate(self.problem, self.rotations, x, self.factor)

    def solve(self, x: Array, iterations: int = 20) -> NewtonResult[LoadedState]:
        """By Newton's method from x."""
        return loaded_newton(self.problem, self.rotations, x, self.factor, iterations=iterations)


@dataclass(frozen=True, eq=False)
class Family:
    """Problems that depend on one number t: the joints move along a path while one load becomes another, from t = 0 to
    1, or, from none, grows on."""

    path: JointPath
    load: Load
    """At t = 1."""
    before: Load | None
    """At the start; None is no load."""

    @staticmethod
    def growing(member: Member) -> Family:
        """The load of a problem grows from nothing where the joints are: t is the factor on it."""
        here = np.concatenate([member.rotations, member.translations])
        path = JointPath(member.robot, here, here, member.discretisation)
        return Family(path, member.problem.load, None)

    def member(self, t: float) -> Member:
        """The problem at t."""
        rotations, translations = self.path.at(t)
        load, factor = (self.load, t) if self.before is None else (self.load_at(t), 1.0)
        return Member.of(
            self.path.robot, rotations, tuple(translations.tolist()), load, self.path.discretisation, factor
        )

    def under_load(self, t: float) -> Member:
        """The problem under the whole of the load at t."""
        rotations, translations = self.path.at(t)
        return Member.of(self.path.robot, rotations, tuple(translations.tolist()), self.load_at(t))

    def load_at(self, t: float) -> Load:
        """The load at t."""
        if self.before is None:
            return self.load.scaled(t)
        return self.load if t == 1 or self.before == self.load else between(self.before, self.load, t)


@dataclass(frozen=True, eq=False)
class LoadedPoint:
    """A solved equilibrium of a family at t."""

    t: float
    member: Member
    state: LoadedState
    margin: float
    iterations: int = 0

    @property
    def softest(self) -> Array:
        """(U + 2 N,) direction in which the equilibrium is softest."""
        vectors: Array = np.linalg.eigh(self.state.hessian)[1]
        return vectors[:, 0]

    @staticmethod
    def of(member: Member, result: NewtonResult[LoadedState], t: float | None = None) -> LoadedPoint:
        """What a solver found, at t, by default the factor."""
        margin = loaded_margin(member.problem, result.state)
        return LoadedPoint(member.factor if t is None else t, member, result.state, margin, result.iterations)

    @staticmethod
    def near(member: Member, x: Array, failure: str) -> LoadedPoint:
        """What Newton's method finds from unknowns x; raises SolveError, with words of its failure, where it fails."""
        result = member.solve(x)
        if not result.converged:
            raise SolveError(failure)
        return LoadedPoint.of(member, result)


def solve_member(
    family: Family, t: float, near: LoadedPoint, before: LoadedPoint | None = None, *, stable: bool = True
) -> LoadedPoint | None:
    """The equilibrium at t on the branch of `near`, or None where Newton is not at ease or, if `stable`, it is not
    stable. Loads without an energy have no stability: there it is only followed."""
    there = family.member(t)
    result = there.solve(_guess(there, near, before, t), iterations=8)
    if not result.converged or result.contraction > CONTINUATION.largest_ratio:
        return None
    if _moved(there, near, result.state) > largest_twist(1.0 if np.isnan(near.margin) else near.margin):
        return None
    if there.problem.load.has_energy and stable and scipy.linalg.lapack.dpotrf(result.state.hessian)[1]:
        return None
    return LoadedPoint.of(there, result, t)


def _guess(there: Member, near: LoadedPoint, before: LoadedPoint | None, t: float) -> Array:
    """Unknowns at t from those at one or two points of the branch."""
    x = carry(near, there)
    if near.member.problem is there.problem and np.array_equal(near.member.rotations, there.rotations):
        # Only the factor changes: along the tangent of the branch.
        step = scipy.linalg.lapack.dgesv(near.state.hessian, -near.state.pull)[2] * (there.factor - near.state.factor)
    elif before is not None and near.t > before.t:
        step = (x - carry(before, there)) * ((t - near.t) / (near.t - before.t))
    else:
        return x
    return np.asarray(x + step)


def carry(point: LoadedPoint, there: Member) -> Array:
    """Unknowns of another problem with the twist and the bending of a point."""
    problem, state = point.member.problem, point.state
    if problem.torsion is there.problem.torsion:
        return state.x
    split = problem.torsion.size
    twist = state.theta - point.member.rotations
    bent = problem.softness[:, None] * state.x[split:].reshape(-1, 2)
    table = np.concatenate([twist, bent], axis=1)
    if len(table) != len(there.problem.softness):
        table = interpolate(problem, table, there.problem)
    n = twist.shape[1]
    x = unknowns(there.problem, there.rotations, there.rotations + table[:, :n])
    x[there.problem.torsion.size :] = (table[:, n:] / there.problem.softness[:, None]).ravel()
    return x


def interpolate(problem: LoadedProblem, table: Array, there: LoadedProblem) -> Array:
    """Values (N, k) at the points of one problem, at those of another."""
    mesh, s = problem.mesh, there.torsion.arc_length
    piece = np.clip(np.searchsorted(mesh.start, s, side="right") - 1, 0, len(mesh.start) - 1)
    x = np.clip((s - mesh.start[piece]) / mesh.length[piece], 0.0, 1.0)
    inner = table.reshape(len(mesh.start), mesh.tableau.degree, -1)
    return np.asarray(np.einsum("ak,aki->ai", mesh.tableau.lagrange(x), inner[piece]))


def _moved(there: Member, near: LoadedPoint, state: LoadedState) -> float:
    """Largest change of a twist at a point, and turn of the arm's frame there, rad."""
    if state.theta.shape != near.state.theta.shape:
        carried = interpolate(near.member.problem, near.state.theta - near.member.rotations, there.problem)
        frames = interpolate(near.member.problem, near.state.orientation.stage, there.problem)
    else:
        carried, frames = near.state.theta - near.member.rotations, near.state.orientation.stage
    unknown = there.problem.torsion.flat
    twist = np.abs((state.theta - there.rotations - carried).ravel()[unknown]).max(initial=0.0)
    return max(float(twist), 2 * float(np.linalg.norm(state.orientation.stage - frames, axis=1).max()))


def follow_family(
    family: Family, start: LoadedPoint, goal: float, *, longest: float = np.inf, stable: bool = True
) -> Iterator[LoadedPoint]:
    """Points of the branch after `start`, up to t = `goal`, or to just before it ends (if `stable`, turns unstable)."""
    here, before = start, None
    step = longest = min(longest, goal - start.t)
    least, ends, power = CONTINUATION.shortest_load_step * max(1.0, abs(goal)), False, 0
    while here.t < goal:
        t = goal if here.t + step >= goal - 1e-12 * max(1.0, abs(goal)) else here.t + step
        there = solve_member(family, t, here, before, stable=stable)
        if there is None:
            # The first failure may be that of a long step; one of a step to before a bifurcation tells of a fold.
            step, ends, power = step / 3, True, 2 if power else 0
            if step < least:
                return
            continue
        yield there
        here, before = there, here
        step = min(2 * step, longest)
        if ends:
            power = max(power, 1)
            step = min(step, max(CONTINUATION.towards_end * _left(here, before, power), step / 20, least))


def _left(here: LoadedPoint, before: LoadedPoint, power: int) -> float:
    """How far ahead the margin of two points vanishes, a power of which falls in proportion to t: the first towards a
    bifurcation, the second towards a fold; infinity where it grows."""
    if not 0 < here.margin < before.margin:
        return np.inf
    return (here.t - before.t) / ((before.margin / here.margin) ** power - 1)


def reach(
    family: Family, start: LoadedPoint, goal: float, *, longest: float = np.inf, stable: bool = True
) -> LoadedPoint:
    """The last point of `follow_family`, which is `start` where the branch ends at once."""
    last = start
    for point in follow_family(family, start, goal, longest=longest, stable=stable):
        last = point
    return last
