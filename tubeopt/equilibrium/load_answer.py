"""From a solved loaded problem to the plain `Equilibrium`."""

from __future__ import annotations

import time

import numpy as np

from ..block.transcription.arm import CollocationPoints
from ..block.transcription.loaded import base_wrench, compliance, tip_position, tip_slopes
from ..block.transcription.loaded_arm import elastic_energy, loaded_arm, loaded_profile
from ..block.transcription.second_variation import stiffnesses
from ..solvers.compiled.loaded import LoadedAnswer
from ..solvers.newton import loaded_margin, loaded_residual
from ..solvers.settings import CONTINUATION
from .load_problem import EXTRA_POINTS
from .member import Loaded, LoadedPoint
from .result import Accuracy, Equilibrium, Statistics, Status
from .solving import told_by_arm


def to_loaded(
    point: LoadedPoint,
    how: tuple[str, float] = ("the load before", 0.0),
    errors: tuple[float, float, float] | None = None,
) -> Equilibrium:
    """Shape, energy and error estimates of a solved problem; `how` is the start and when (s) begun."""
    member, state = point.member, point.state
    problem = member.problem
    profile = loaded_profile(problem, member.rotations, state)
    found = LoadedAnswer(
        theta=state.theta,
        curvature=state.curvature,
        margin=point.margin,
        residual=loaded_residual(problem, state),
        energy=elastic_energy(problem, profile, state),
        work=state.work,
        iterations=point.iterations,
        errors=mesh_errors(point) if errors is None else errors,
        # What follows from the solved state at once need not be solved for again.
        compliance=None if abs(point.margin) < CONTINUATION.least_stiffness else compliance(problem, state),
        base_wrench=base_wrench(problem, state),
        arm=loaded_arm(problem, profile, state),
    )
    symmetric = problem.couples is None
    index = 0 if point.margin > 0 else int((stiffnesses(state.hessian, symmetric=symmetric) < 0).sum())
    return from_answer(member, found, (*how, index))


def from_answer(member: Loaded, found: LoadedAnswer, how: tuple[str, float, int]) -> Equilibrium:
    """The equilibrium of an answer; `how` is the start, when (s) begun, and the number of unstable directions."""
    problem, mesh, margin = member.problem, member.problem.mesh, found.margin
    start, began, index = how
    equilibrium = Equilibrium(
        robot=member.robot,
        rotations=member.rotations,
        translations=np.array(member.translations),
        **told_by_arm(found.arm, problem.torsion.assembly),
        points=CollocationPoints(problem.torsion.arc_length, found.theta + problem.wound, found.curvature),
        margin=margin,
        index=index,
        energy=found.energy,
        accuracy=Accuracy(found.residual, *found.errors[:2]),
        status=Status.STABLE if margin > 0 else Status.UNSTABLE,
        statistics=Statistics(
            method="newton",
            iterations=found.iterations,
            elements=len(mesh.length),
            degree=mesh.tableau.degree,
            start=start,
            seconds=time.perf_counter() - began if began else 0.0,
            family=mesh.tableau.family,
            refinement=member.discretisation.refinement,
        ),
        load=member.load,
        work=found.work,
    )
    vars(equilibrium)["base_wrench"] = found.base_wrench
    if found.compliance is not None:
        vars(equilibrium)["compliance"] = found.compliance
    return equilibrium


def mesh_errors(point: LoadedPoint) -> tuple[float, float, float]:
    """Estimated errors of theta, rad, of the tip, m, and of the margin: what a Newton step on a finer rule changes."""
    member = point.member
    there = member.on(degree=member.discretisation.degree + EXTRA_POINTS)
    problem, state = there.problem, there.at(there.carried(point))
    # At a fold the step along the softest direction has no bound: its stiffness counts as at least this.
    least = CONTINUATION.least_stiffness
    shift = least if abs(point.margin) < least else 0.0
    step = np.linalg.solve(state.hessian + shift * np.eye(problem.size), -state.gradient)
    split = problem.torsion.size
    theta = np.abs(problem.torsion.factor @ step[:split]).max(initial=0.0)
    moved = tip_position(problem, state) + tip_slopes(problem, state)[:3] @ step
    moved -= tip_position(member.problem, point.state)
    # Only of arms that loads hardly soften is the margin less sure than the shape.
    close = point.margin > CONTINUATION.hardly_softened and problem.couples is None
    margin = abs(loaded_margin(problem, state) - point.margin) if close else 0.0
    # Between the points theta is up to 1.6 times as far off as at them (measured).
    return 2 * float(theta), float(np.linalg.norm(moved)), margin
