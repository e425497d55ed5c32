"""Inverse kinematics under a load."""

from __future__ import annotations

import time

import numpy as np
import pytest

from tests.command_line import THESIS as THESIS_FILE
from tests.command_line import Run, answer, refused
from tests.examples import THESIS
from tubeopt import InputError, InverseOptions, Load, SolveError, forward_kinematics, inverse_kinematics
from tubeopt.bodies.obstacles import Sphere
from tubeopt.inverse import multistart

LOAD = Load((0.05, 0.02, -0.02))
TARGET = np.array([0.05, 0.02, 0.16])


def test_the_loaded_tip_is_on_target_with_margin() -> None:
    solution = inverse_kinematics(THESIS, TARGET, load=LOAD, min_margin=0.5)
    cold = forward_kinematics(THESIS, solution.rotations, solution.translations, load=LOAD)
    assert np.allclose(cold.tip_position, TARGET, rtol=0, atol=2e-8)
    assert np.allclose(solution.equilibrium.tip_position, cold.tip_position, rtol=0, atol=1e-10)
    assert solution.reached
    assert solution.margin >= 0.5
    unloaded = forward_kinematics(THESIS, solution.rotations, solution.translations)
    assert np.linalg.norm(unloaded.tip_position - TARGET) > 5e-3


@pytest.mark.parametrize(
    "load",
    [
        Load(moment=(0.002, -0.0015, 0.001)),
        Load((0.01, 0.0, 0.0), points=((0.08, (0, 0, 0), (0.002, 0, 0.001)),)),
        Load((0.01, 0.01, -0.02), frame="tip"),
    ],
    ids=["moment", "moment along the arm", "follower"],
)
def test_tip_under_a_load_without_an_energy_is_on_target(load: Load) -> None:
    solution = inverse_kinematics(THESIS, TARGET, load=load, min_margin=0.5)
    cold = forward_kinematics(THESIS, solution.rotations, solution.translations, load=load)
    assert np.allclose(cold.tip_position, TARGET, rtol=0, atol=2e-8)
    assert solution.margin == pytest.approx(cold.margin, abs=1e-7)
    assert solution.margin >= 0.5


def test_no_way_of_the_unloaded_robot_is_told_of_the_loaded_one() -> None:
    assert inverse_kinematics(THESIS, TARGET).reachable
    solution = inverse_kinematics(THESIS, TARGET, load=LOAD)
    assert (solution.reachable, solution.path) == (None, None)


def test_the_loaded_arm_keeps_clear_where_the_unloaded_one_does_not_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(multistart, "COMPARED", 1)
    free = inverse_kinematics(THESIS, TARGET, load=LOAD)
    middle = free.equilibrium.position[len(free.equilibrium.position) // 2]
    ball = Sphere(middle + np.array([0.0, 0.004, 0.0]), 0.002)
    options = InverseOptions(clearance=1e-3)
    retained = inverse_kinematics(THESIS, TARGET, start=free, load=LOAD, obstacles=[ball], options=options)
    assert retained.clearance >= 1e-3
    assert np.allclose(retained.equilibrium.tip_position, TARGET, rtol=0, atol=2e-8)


def test_what_makes_no_sense_under_load() -> None:
    with pytest.raises(InputError, match="for a robot without load"):
        inverse_kinematics(THESIS, TARGET, load=LOAD, all_solutions=True)
    with pytest.raises(SolveError):
        inverse_kinematics(THESIS, [0.5, 0, 0], load=LOAD, options=InverseOptions(starts=2))


def test_the_time_limit_is_that_of_all_of_it() -> None:
    with pytest.raises(SolveError, match="within 1e-09 s"):
        inverse_kinematics(THESIS, TARGET, load=LOAD, options=InverseOptions(time_limit=1e-9))
    inverse_kinematics(THESIS, TARGET)
    start_time = time.process_time()
    with pytest.raises(SolveError):
        # Every shot of many would have the limit to itself.
        inverse_kinematics(THESIS, TARGET, load=LOAD, min_margin=0.9999, options=InverseOptions(time_limit=0.1))
    assert time.process_time() - start_time < 0.6


def test_on_the_command_line(run: Run) -> None:
    requested = ["ik", THESIS_FILE, "--target-mm", "50,20,160", "--tip-force-mN", "50,20,-20"]
    data = answer(run(*requested, "--json"))
    solution = data["solutions"][0] if "solutions" in data else data
    joints = solution["rotations_deg"], solution["translations_mm"]
    reached = forward_kinematics(THESIS, np.radians(joints[0]), np.array(joints[1]) * 1e-3, load=LOAD)
    assert np.allclose(reached.tip_position, TARGET, rtol=0, atol=2e-8)
    assert "without load" in refused(run(*requested, "--all"))[0]
