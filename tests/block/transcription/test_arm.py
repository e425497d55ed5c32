"""From moments to the whole arm: profiles that integrate them, energy, and honest error estimates."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.shooting import shoot
from tests.examples import CRL, MM, THESIS, configurations, newton, opposed
from tubeopt import ConcentricRobot, Discretisation, Equilibrium, forward_kinematics
from tubeopt.block.transcription import arm as arms
from tubeopt.block.transcription.reduced import ReducedProblem
from tubeopt.equilibrium.problem import DEFAULT_DISCRETISATION, reduced_problem

ROTATIONS = np.array([0.3, -0.8, 1.2])


@pytest.fixture(scope="module")
def solved() -> tuple[ReducedProblem, arms.Profile]:
    problem = reduced_problem(THESIS, (0.06, 0.03, 0.0), DEFAULT_DISCRETISATION)
    result = newton(problem, ROTATIONS, np.zeros(problem.size))
    return problem, arms.profile(problem, ROTATIONS, result.state)


def test_boundary_conditions_and_continuity(solved: tuple[ReducedProblem, arms.Profile]) -> None:
    problem, profile = solved
    theta = arms.rotations_at(problem, profile, (0.0, 1.0))
    torsion = arms.torques_at(problem, profile, (0.0, 1.0)) / problem.assembly.torsional_stiffness
    assert theta[0, 0] == pytest.approx(ROTATIONS + problem.assembly.transmission * torsion[0, 0], abs=1e-13)
    assert theta[1:, 0] == pytest.approx(theta[:-1, 1], abs=1e-13)
    assert torsion[1:, 0] == pytest.approx(torsion[:-1, 1], abs=1e-11)
    stop = problem.mesh.start + problem.mesh.length
    for i, end in enumerate(problem.assembly.end):
        # No torsion at the tube's own end, nor beyond.
        assert torsion[stop >= end - 1e-12, 1, i] == pytest.approx(0.0, abs=1e-12)


def test_torsion_is_the_slope_of_rotation(solved: tuple[ReducedProblem, arms.Profile]) -> None:
    problem, profile = solved
    h = 1e-4
    for x in (0.1, 0.5, 0.9):
        sides = arms.rotations_at(problem, profile, (x - h, x + h))
        slope = (sides[:, 1] - sides[:, 0]) / (2 * h * problem.mesh.length[:, None])
        torque = arms.torques_at(problem, profile, (x,))[:, 0]
        assert slope == pytest.approx(torque / problem.assembly.torsional_stiffness, abs=1e-6)


def test_interpolation_anywhere(solved: tuple[ReducedProblem, arms.Profile]) -> None:
    problem, profile = solved
    mesh = problem.mesh
    x = (0.0, 0.3, 0.77)
    s = (mesh.start[:, None] + mesh.length[:, None] * x).ravel()
    assert arms.interpolate(problem, profile, s) == pytest.approx(
        arms.rotations_at(problem, profile, x).reshape(-1, 3), abs=1e-12
    )
    end = problem.assembly.total_length
    beyond = arms.interpolate(problem, profile, np.array([-1.0, 0.0, end, end + 1.0]))
    assert (beyond[0] == beyond[1]).all()
    assert (beyond[2] == beyond[3]).all()


def test_shape_points_share_the_ends_of_pieces(solved: tuple[ReducedProblem, arms.Profile]) -> None:
    problem, _ = solved
    s = arms.arc_lengths(problem.mesh)
    assert (np.diff(s) > 0).all()
    assert len(s) == 1 + 4 * len(problem.mesh.length)
    assert set(np.round(problem.mesh.start, 12)) <= set(np.round(s, 12))
    assert s[-1] == pytest.approx(problem.assembly.total_length, abs=1e-15)


def true_errors(robot: ConcentricRobot, solved: Equilibrium) -> tuple[float, float]:
    """Errors of theta (rad) at the plate and of the tube tips, and of the tip (m), against shooting."""
    reference = shoot(robot, solved.rotations, solved.translations, solved.torsion[:, 0])
    assert reference.residual < 1e-11
    theta = np.abs(
        [*(solved.rotation[:, 0] - reference.rotation), *(solved.tip_rotations - reference.tip_rotations)]
    ).max()
    return float(theta), float(np.linalg.norm(solved.tip_position - reference.tip_position))


@pytest.mark.parametrize("degree", [2, 3, 4, 6])
@pytest.mark.parametrize("robot", [THESIS, CRL], ids=lambda robot: robot.name)
def test_error_estimates_hold_and_are_not_absurd(robot: ConcentricRobot, degree: int) -> None:
    fractions = []
    for rotations, translations in configurations(robot, 15, seed=degree):
        discretisation = Discretisation("gauss", degree)
        solved = forward_kinematics(robot, rotations, translations, tolerance=1.0, discretisation=discretisation)
        theta, tip = true_errors(robot, solved)
        assert theta <= solved.mesh_error + 1e-12
        assert tip <= 1.5 * solved.tip_error + 1e-13
        fractions.append(theta / (solved.mesh_error + 1e-15))
    if degree == 2:
        # Between one and a hundred times the truth where there is an error to speak of.
        assert max(fractions) > 0.01


def test_more_points_give_a_smaller_error() -> None:
    errors = []
    for degree in (1, 2, 3, 4, 5):
        solved = forward_kinematics(
            CRL, (2.0, 0.5, 0.0), tolerance=10.0, discretisation=Discretisation("gauss", degree)
        )
        errors.append(true_errors(CRL, solved)[0])
    assert (np.array(errors[1:]) < 0.2 * np.array(errors[:-1])).all()


@pytest.mark.parametrize(
    ("robot", "rotations", "translations"),
    [
        (THESIS, (0.3, -0.8, 1.2), (60.0, 30.0, 0.0)),
        (CRL, (1.5, -0.5, 0.2), (-20.0, -30.0, 5.0)),
        (opposed(0.7), (2.0, -0.3), (0.0, -20.0)),
    ],
)
def test_work_of_the_actuators_is_the_change_of_energy(
    robot: ConcentricRobot, rotations: tuple[float, ...], translations: tuple[float, ...]
) -> None:
    # Turning tube i takes the torque -GJ w of its transmission: dE / d alpha_i = -GJ_i w_i(0).
    shift = np.array(translations) * MM
    solved = forward_kinematics(robot, rotations, shift)
    for i, tube in enumerate(robot.tubes):
        step = np.zeros(robot.n_tubes)
        step[i] = 1e-4
        ahead, behind = (forward_kinematics(robot, rotations + sign * step, shift).energy for sign in (1, -1))
        torque = -tube.torsional_stiffness * solved.torsion[i, 0]
        assert (ahead - behind) / 2e-4 == pytest.approx(torque, abs=1e-9)


def test_energy_of_aligned_tubes_is_known() -> None:
    # No torsion: each tube is bent from its own curve to the common one.
    solved = forward_kinematics(opposed(), (0.0, 0.0))
    inner, outer = solved.robot.tubes
    kb = inner.bending_stiffness, outer.bending_stiffness
    u = (kb[0] * inner.curvature + kb[1] * outer.curvature) / sum(kb)
    expected = sum(k * (u - t.curvature) ** 2 for k, t in zip(kb, (inner, outer), strict=True)) / 2 * 0.1
    assert solved.energy == pytest.approx(expected, rel=1e-12)
