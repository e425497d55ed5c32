"""Equilibria under load by IPOPT, in whose program the orientation is an unknown: another writing, the same answers."""

from __future__ import annotations

import numpy as np
import pytest

import tubeopt
from tests.examples import PIECES, THESIS, TWO_TUBE
from tubeopt import InputError, Load, forward_kinematics
from tubeopt.block.transcription.loaded import evaluate, tip_position, unknowns
from tubeopt.equilibrium.member import sample_rotation
from tubeopt.equilibrium.problem import loaded_problem
from tubeopt.robots.robot import Robot
from tubeopt.solvers.ipopt import solve_loaded_ipopt

PUSHED = Load(force=(0.02, -0.01, 0.015), gravity=(0, -9.81, 0))


@pytest.mark.parametrize("robot", [THESIS, PIECES], ids=lambda r: r.name)
def test_from_no_load_it_ends_where_the_growing_load_leads(robot: Robot) -> None:
    rotations, load = np.array([0.2, 1.0, 1.6]), PUSHED if robot is THESIS else Load(force=(0.02, 0.01, 0))
    shift = tuple(robot.home_translations.tolist())
    problem, bare = loaded_problem(robot, shift, load), forward_kinematics(robot, rotations)

    x = unknowns(problem, rotations, sample_rotation(bare, problem.torsion.arc_length))
    result = solve_loaded_ipopt(problem, rotations, evaluate(problem, rotations, x))
    grown = forward_kinematics(robot, rotations, load=load)
    assert result.iterations > 2
    assert np.linalg.norm(tip_position(problem, result.state) - grown.tip_position) < 1e-9
    assert np.linalg.norm(bare.tip_position - grown.tip_position) > 1e-3


def test_as_a_method_of_forward_kinematics() -> None:
    newton = forward_kinematics(TWO_TUBE, [0.0, 1.0], load=PUSHED)
    for method in ("energy", tubeopt.Ipopt(tolerance=1e-10)):
        other = forward_kinematics(TWO_TUBE, [0.0, 1.0], load=PUSHED, method=method)
        assert np.linalg.norm(other.tip_position - newton.tip_position) < 1e-9
        assert other.margin == pytest.approx(newton.margin, abs=1e-9)
        assert other.statistics.method == ("energy" if method == "energy" else "ipopt")
        np.testing.assert_allclose(other.compliance, newton.compliance, rtol=1e-6, atol=1e-9)


def test_what_it_cannot_do_is_said() -> None:
    with pytest.raises(InputError, match="no energy, it must be 'newton'"):
        forward_kinematics(THESIS, [0.0, 1.0, 2.0], load=Load(moment=(0, 0, 1e-3)), method="ipopt")
    with pytest.raises(InputError, match="settings other than margin_tol"):
        forward_kinematics(THESIS, [0.0, 1.0, 2.0], load=PUSHED, method=tubeopt.Newton(iterations=5))


def test_margins_close_to_1_are_checked_to_what_is_wanted() -> None:
    """How early a check refines depends on who checks; what is wanted is kept."""
    load = Load((-3e-5, 8e-5, 3e-5))
    usual = forward_kinematics(THESIS, [0.0, 0.0, 0.0], load=load)
    rough, fine = (
        forward_kinematics(THESIS, [0.0, 0.0, 0.0], load=load, method=tubeopt.Newton(margin_tolerance=tolerance))
        for tolerance in (1e-4, 1e-12)
    )
    assert fine.statistics.refinement > rough.statistics.refinement == 0
    assert 0 < abs(fine.margin - rough.margin) < 1e-4
    assert abs(fine.margin - usual.margin) < 1e-8
