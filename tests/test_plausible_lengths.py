"""Lengths and forces that were probably typed in mm and mN are warned of, wherever a public function takes them."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import tubeopt
from tests.examples import THESIS
from tubeopt.errors import ImplausibleWarning
from tubeopt.planning.plan import EntryRegion
from tubeopt.validation import Measurements

REST = tubeopt.forward_kinematics(THESIS, np.zeros(3))
FURTHER = REST.tip_position + np.array([0.0, 0.001, 0.0])
STILL = [REST.rotations, REST.rotations]
SEEN = Measurements(np.zeros((1, 3)), np.zeros((1, 3)), REST.tip_position[None])

ASKED: dict[str, Callable[[], Any]] = {
    "clearance is 0.05 m": lambda: tubeopt.clearance_correction(REST, 0.05),
    "clearance is 0.02 m": lambda: tubeopt.ConcentricRobot(THESIS.tubes, clearance=(0.02, 0.02)),
    "max_force is 20 N": lambda: tubeopt.deflection_bound(THESIS, max_force=20.0),
    "max_force is 30 N": lambda: tubeopt.snap_free_certificate(THESIS, max_force=30.0),
    "clearance is 0.5 m": lambda: tubeopt.verify_trajectory(THESIS, [0, 1], STILL, clearance=0.5),
    "max_force is 40 N": lambda: tubeopt.verify_trajectory(THESIS, [0, 1], STILL, max_force=40.0),
    "tolerance is 0.5 m": lambda: tubeopt.follow_tip_path(THESIS, [REST.tip_position, FURTHER], tolerance=0.5),
    "tolerance is 0.6 m": lambda: tubeopt.evaluate_reach(THESIS, REST, [REST.tip_position], tolerance=0.6, count=20),
    "noise is 0.1 m": lambda: tubeopt.estimate_force(THESIS, np.zeros(3), tip_position=REST.tip_position, noise=0.1),
    "noise is 0.2 m": lambda: tubeopt.estimate_forces(THESIS, SEEN, noise=0.2),
    "radius of the entry is 5 m": lambda: EntryRegion(radius=5.0),
    "box of the entry is 8 m": lambda: EntryRegion(box=(8.0, 0.0, 0.0)),
}


@pytest.mark.parametrize("words", ASKED)
def test_a_number_that_was_meant_in_mm_or_mn_is_warned_of(words: str) -> None:
    with (
        pytest.warns(ImplausibleWarning) as result,
        contextlib.suppress(tubeopt.SolveError, tubeopt.InputError),
    ):
        ASKED[words]()
    report = [str(one.message) for one in result]
    assert any(one.startswith(words) and "meant?" in one for one in report), report
