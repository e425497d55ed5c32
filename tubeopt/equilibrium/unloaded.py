"""A robot at joint values without a load."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from ..block.transcription import arm as arms
from ..block.transcription.arm import CollocationPoints, Found
from ..block.transcription.mesh import make_mesh
from ..block.transcription.postprocess import evaluate_arm
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
from ..block.transcription.second_variation import margin, softest, unstable_directions
from ..robots.load import Load
from ..robots.robot import Robot
from ..solvers.newton import NewtonResult, descend, leave_saddle, torsional_turn
from ..solvers.settings import NEWTON, Newton
from ..typing import Array
from .member import Member, Place, Point, pieces_of
from .problem import DEFAULT_DISCRETISATION, Discretisation, reduced_problem

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

    def found(self, point: Place, rubbed: tuple[arms.Profile, float] | None = None) -> Found:
        """`rubbed`: torsion along the arm and the error (rad) of the mesh, where friction shapes them too."""
        problem, state = self.problem, point.state
        torsion, defect = (point.torsion, None) if rubbed is None else rubbed
        arm = evaluate_arm(problem, self.rotations, state, torsion)
        # The inverse of the linearised equation amplifies a defect by at most one over the margin.
        error = (arm.defect if defect is None else defect) / max(min(1.0, abs(point.margin)), 1e-6)
        return Found.of(
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
