"""A robot at joint values under a load."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from ..block.transcription import arm as arms
from ..block.transcription import loaded
from ..block.transcription.arm import CollocationPoints, Found
from ..block.transcription.loaded import (
    LoadedProblem,
    LoadedState,
    base_wrench,
    compliance,
    tip_position,
    tip_slopes,
)
from ..block.transcription.loaded_arm import elastic_energy, loaded_arm, loaded_profile
from ..block.transcription.reduced import ReducedProblem
from ..block.transcription.second_variation import least, softest_of, stiffnesses
from ..robots.load import Load
from ..robots.robot import Robot
from ..solvers.settings import HARDLY_SOFTENED, LEAST_STIFFNESS
from ..typing import Array
from .member import Member, Place, Point, pieces_of
from .problem import EXTRA_POINTS, LOADED_DISCRETISATION, Discretisation, loaded_problem, loading_of


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

    def found(self, point: Place) -> Found:
        """What follows from the solved state at once need not be solved for again."""
        state, problem, profile = point.state, self.problem, point.torsion
        return Found.of(
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

    def tangent(self, near: Place) -> Array | None:
        """Where only the factor changes, by what the load pulls."""
        if near.member.problem is not self.problem or not np.array_equal(near.member.rotations, self.rotations):
            return None
        step = scipy.linalg.lapack.dgesv(near.state.hessian, -near.state.pull)[2]
        return np.asarray(step * (self.factor - near.state.factor))

    def round_off(self, state: LoadedState) -> float:
        """Elastic energy and work may cancel."""
        return state.energy + abs(state.work)


LoadedPoint = Point[Loaded, LoadedState]
