"""Loads that make no sense: what is wrong, where on the arm, and in which unit."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.examples import THESIS
from tubeopt import ConcentricRobot, InputError, Load, Piece, Tube, forward_kinematics
from tubeopt.errors import ImplausibleWarning, TimeLimitError
from tubeopt.runs.robot_keys import load_entry

JOINTS = (0.0, 1.0, 2.0)
PUSH = (0.01, 0.0, 0.0)


def from_50_mm(fault: Callable[[], Any]) -> Callable[[float], Any]:
    return lambda s: PUSH if s < 0.05 else fault()


@pytest.mark.parametrize(
    ("function", "words"),
    [
        (lambda s: (1 / s, 0.0, 0.0), r"distributed, a function, fails at 0 m \(0 mm\): ZeroDivisionError: "),
        (
            from_50_mm(lambda: 1 / 0),
            r"distributed, a function, fails at 0\.0\d+ m \(\d+(\.\d)? mm\): ZeroDivisionError",
        ),
        (from_50_mm(lambda: [][3]), r"fails at 0\.0\d+ m .*: IndexError: "),
        (from_50_mm(lambda: {}["a"]), r"fails at 0\.0\d+ m .*: KeyError: 'a'"),
        (from_50_mm(lambda: None), r"distributed at 0\.0\d+ m is (None|array\(nan\)); it must be 3 numbers"),
        (lambda: PUSH, r"fails at 0 m .*: TypeError: "),
    ],
)
def test_faults_of_a_users_function_name_the_place(function: Any, words: str) -> None:
    for load in (Load(distributed=function), Load(distributed=function).scaled(2.0)):
        with pytest.raises(InputError, match=words):
            forward_kinematics(THESIS, JOINTS, load=load)


def test_faults_of_functions_of_pieces_name_the_place() -> None:
    for quantity, inputs in (("precurvature", {}), ("bending_stiffness", {"bending_stiffness": lambda s: 1 / 0})):
        with pytest.raises(InputError, match=f"{quantity} of a piece, a function, fails at .* ZeroDivisionError"):
            Piece(0.1, (lambda s: 1 / 0) if not inputs else 5.0, **inputs)  # type: ignore[arg-type]


@pytest.mark.parametrize("number", [int, np.int64, np.float64, np.float32])
def test_a_load_per_length_takes_all_kinds_of_numbers(number: type) -> None:
    assert Load(distributed=[number(1), number(0), number(2)]).distributed == (1.0, 0.0, 2.0)  # type: ignore[arg-type]


def test_what_lies_beyond_the_arm_is_refused_or_remarked() -> None:
    with pytest.raises(InputError, match=r"points\[1\] of the load is at 0\.5 m \(500 mm\); it must be at most"):
        forward_kinematics(THESIS, JOINTS, load=Load(points=((0.1, PUSH), (0.5, PUSH))))  # type: ignore[arg-type]
    with pytest.raises(
        InputError, match=r"distributed\[0\] of the load begins at 0\.2 m \(200 mm\); .* 0\.2 m \(200 mm\)"
    ):
        forward_kinematics(THESIS, JOINTS, load=Load(distributed=((0.2, 0.3, PUSH),)))  # type: ignore[arg-type]
    with pytest.warns(ImplausibleWarning, match=r"ends at 0\.3 m \(300 mm\), beyond the end of the arm; it is cut at"):
        cut = forward_kinematics(THESIS, JOINTS, load=Load(distributed=((0.1, 0.3, PUSH),)))  # type: ignore[arg-type]
    same = forward_kinematics(THESIS, JOINTS, load=Load(distributed=((0.1, 0.2, PUSH),)))  # type: ignore[arg-type]
    assert np.allclose(cut.tip_position, same.tip_position, rtol=0, atol=1e-12)


def test_gravity_in_another_unit_is_remarked() -> None:
    with pytest.warns(ImplausibleWarning, match=r"gravity is 9810 m/s.2, 1e.03 times that of the earth: was 9810 mm/s"):
        forward_kinematics(THESIS, JOINTS, load=Load(gravity=(0.0, 0.0, -9810.0)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        forward_kinematics(THESIS, JOINTS, load=Load(gravity=(0.0, 5.0, -80.0)))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("points:\n  - {at_mm: 50}\n", r"points\[0\] has no load; it must have force_mN or moment_mN_m"),
        (
            "distributed_mN_per_m:\n  - {from_mm: 5, to_mm: 9}\n",
            r"distributed_mN_per_m\[0\] has no load; it must have force_mN_per_m or moment_mN_m_per_m",
        ),
    ],
)
def test_an_entry_without_a_load_is_refused(text: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "load.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=words):
        load_entry(path).build()


def test_kinematics_keeps_its_time_limit() -> None:
    """A moment that winds a soft rod up takes hundreds of steps."""
    start_time = time.perf_counter()
    with pytest.raises(TimeLimitError, match=r"forward_kinematics reached its time limit of 0\.2 s"):
        forward_kinematics(THESIS, JOINTS, load=Load(moment=(0.2, 0.0, 0.0)), time_limit=0.2)
    assert time.perf_counter() - start_time < 5.0
    straight = ConcentricRobot((Tube(1e-3, 0.0, 0.0, 0.1, 0.0),))
    assert forward_kinematics(straight, [0.0], time_limit=10.0).tip_position[2] == pytest.approx(0.1)
