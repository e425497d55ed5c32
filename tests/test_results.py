"""Every answer has a value, a status that reads as a sentence, and statistics."""

from __future__ import annotations

import dataclasses
from enum import Enum

import numpy as np
import pytest

from tests.examples import THESIS, TWO_TUBE
from tubeopt import (
    Certificate,
    DesignSolution,
    Drives,
    Equilibrium,
    EquilibriumBatch,
    Fatigue,
    ForceEstimate,
    HeatingPlan,
    InverseSolution,
    Ipopt,
    LoadLimit,
    Mold,
    Newton,
    Path,
    Piece,
    Problem,
    ProblemSolution,
    Proof,
    Snap,
    SnapAssessment,
    SnapDistance,
    SnapInTime,
    StabilityMap,
    Trajectory,
    Tube,
    Workspace,
    assess_snapping,
    certify,
    follow,
    forward_kinematics,
    forward_kinematics_batch,
    inverse_kinematics,
    plan_mold,
    stability_map,
    workspace,
)
from tubeopt.design.optimize import DesignStatus
from tubeopt.equilibrium.batch import BatchStatus
from tubeopt.equilibrium.result import Status
from tubeopt.errors import InputError
from tubeopt.inverse.answer import InverseStatus
from tubeopt.planning.proof import ProofStatus
from tubeopt.shaping import Mandrel, plan_mandrel
from tubeopt.shaping.heating.plan import HeatingStatus
from tubeopt.shaping.mold.mandrel import MandrelStatus
from tubeopt.shaping.mold.mold import MoldStatus
from tubeopt.solvers.named_program import ProblemStatus
from tubeopt.stability.certificate import CertificateStatus
from tubeopt.stability.drives import DrivesStatus
from tubeopt.stability.fatigue import Endurance
from tubeopt.stability.following import PathStatus
from tubeopt.stability.load_limit import LoadLimitStatus
from tubeopt.stability.maps import MapStatus
from tubeopt.stability.motion import SnapStatus
from tubeopt.stability.snap_assessment import SnapAssessmentStatus
from tubeopt.stability.snap_distance import SnapDistanceStatus
from tubeopt.stability.snap_in_time import MotionEnd
from tubeopt.typing import Result
from tubeopt.validation.fitting import Fit, FitStatus
from tubeopt.validation.force import ForceStatus

ANSWERS = (
    Certificate,
    DesignSolution,
    Drives,
    Equilibrium,
    EquilibriumBatch,
    Fatigue,
    Fit,
    ForceEstimate,
    HeatingPlan,
    InverseSolution,
    LoadLimit,
    Mandrel,
    Mold,
    Path,
    ProblemSolution,
    Proof,
    Snap,
    StabilityMap,
    Trajectory,
    SnapAssessment,
    SnapDistance,
    SnapInTime,
    Workspace,
)

STATUSES = (
    BatchStatus,
    CertificateStatus,
    DesignStatus,
    DrivesStatus,
    Endurance,
    FitStatus,
    ForceStatus,
    HeatingStatus,
    InverseStatus,
    LoadLimitStatus,
    MandrelStatus,
    MapStatus,
    MoldStatus,
    PathStatus,
    ProblemStatus,
    ProofStatus,
    SnapStatus,
    Status,
    SnapAssessmentStatus,
    SnapDistanceStatus,
    MotionEnd,
)


def of_every_kind(
    found: tuple[DesignSolution, Fit, HeatingPlan, Trajectory, ProblemSolution],
    force: ForceEstimate,
    limit: LoadLimit,
    proof: Proof,
    tips: Workspace,
) -> tuple[Result, ...]:
    """The type checker sees that each is a Result."""
    return (*found, force, limit, proof, tips)


@pytest.mark.parametrize("kind", ANSWERS, ids=lambda kind: kind.__name__)
def test_every_answer_has_value_status_and_statistics(kind: type) -> None:
    fields = {field.name for field in dataclasses.fields(kind)}
    for name in ("value", "status", "statistics"):
        assert name in fields or hasattr(kind, name)


@pytest.mark.parametrize("kind", STATUSES, ids=lambda kind: kind.__name__)
def test_every_status_reads_as_a_sentence(kind: type[Enum]) -> None:
    for member in kind:
        assert str(member) == member.value
        assert len(str(member).split()) >= 4
        assert str(member)[0].islower()
        assert not str(member).endswith(".")


def test_answers_of_solvers_and_questions() -> None:
    near = forward_kinematics(TWO_TUBE, [0.0, 1.0])
    tips = workspace(TWO_TUBE, 8)
    assert isinstance(tips, Result)
    assert tips.statistics.samples == len(tips.value) == 8
    assert str(tips.status) == "a stable equilibrium was found at all joint values"
    problem = Problem()
    side = problem.variable("side", guess=1.0)
    problem.minimize((side - 2.0) ** 2)
    answers: tuple[Result, ...] = (near, inverse_kinematics(TWO_TUBE, near.tip_position, start=near), problem.solve())
    for each in answers:
        assert isinstance(each, Result)
        assert each.statistics.seconds >= 0
        assert str(each.status)
    np.testing.assert_array_equal(answers[0].value, near.tip_position)


def test_answers_about_stability() -> None:
    """Turned once around, the robot of the thesis snaps once; two weakly curved tubes cannot."""
    path = follow(THESIS, np.radians([[0, 0, 0], [270, 0, 0]]))
    answers: tuple[Result, ...] = (path, path.snaps[0], certify(TWO_TUBE, [-0.09, -0.06]), assess_snapping(TWO_TUBE))
    assert [str(each.status) for each in answers] == [
        "the robot reached all waypoints, with snaps",
        "the robot snapped to another equilibrium",
        "it is proved that the robot cannot snap at any rotation",
        "the robot can snap",
    ]
    assert path.value.shape == (2, 3)
    assert (path.statistics.waypoints, path.statistics.snaps) == (2, 1)
    assert answers[1].value == pytest.approx(214.2224 / 270, abs=1e-5)
    assert answers[2].value > 0
    assert answers[2].statistics.pairs == 1
    assert answers[3].value is True
    chart = stability_map(THESIS, samples=3, directions=4, workers=1)
    assert chart.value.shape == (3, 3)
    assert (chart.statistics.paths, chart.statistics.directions) == (9, 4)
    assert (str(chart.status) == "the robot snaps on none of the paths") == (not chart.snaps.any())


def test_answers_for_many_joint_values_and_of_molds() -> None:
    many = forward_kinematics_batch(TWO_TUBE, [[0.0, 0.0], [0.0, 1.0]])
    mold = plan_mold(THESIS.tubes[0])
    mandrel = plan_mandrel(Tube.of_pieces(1.2e-3, 1.05e-3, [Piece.helix(0.16, 14e-3, 24e-3)]))
    answers: tuple[Result, ...] = (many, mold, mandrel)
    assert all(isinstance(each, Result) for each in answers)
    assert str(many.status) == "a stable equilibrium was found at all joint values"
    assert (many.statistics.samples, many.statistics.failures) == (2, 0)
    assert mold.value == mold.grooves
    assert str(mandrel.status) == "the mandrel is turned, and passes all checks"
    assert mandrel.value.arc_length.shape == mandrel.value.points.shape[:1]
    assert mold.statistics.grooves == 1


def test_solvers_are_chosen_by_name_or_by_their_settings() -> None:
    desired = forward_kinematics(TWO_TUBE, [0.3, 2.0])
    for solver in (Newton(iterations=30), Ipopt(tolerance=1e-11, iterations=50), "ipopt"):
        equilibrium = forward_kinematics(TWO_TUBE, [0.3, 2.0], method=solver)
        np.testing.assert_allclose(equilibrium.tip_position, desired.tip_position, atol=1e-9)
        assert equilibrium.statistics.method == ("newton" if isinstance(solver, Newton) else "ipopt")
    with pytest.raises(InputError, match="descent_iterations is 0; it must be at least 1"):
        Newton(descent_iterations=0)
    with pytest.raises(InputError, match="method is 'simplex'"):
        forward_kinematics(TWO_TUBE, [0.3, 2.0], method="simplex")
