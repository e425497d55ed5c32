"""Eccentric robots: what they are made of, and the files that say so."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.examples import CONFIGS, MM
from tubeopt import EccentricRobot, InputError, JointLimits, SegmentedEccentricRobot, Tube, load_robot
from tubeopt.robots.eccentric import PLACES, sheath_inner_diameter

ETR = load_robot(CONFIGS / "thesis_etr.yaml")
THREE = load_robot(CONFIGS / "example_three_segment_etr.yaml")
assert isinstance(ETR, EccentricRobot)
assert isinstance(THREE, SegmentedEccentricRobot)

LIMITS = JointLimits(rotations=((-1.0, 2.5),) * 3, translations=((-0.05, 0.0),) * 3)


def test_the_robot_of_the_thesis() -> None:
    assert ETR.tube == Tube(1.92e-3, 1.57e-3, 0.0, 0.094, 1 / 0.12)
    assert ETR.distance == pytest.approx(1.92 * MM / math.sqrt(3), abs=1e-15)
    assert ETR.sheath_inner_diameter == pytest.approx((2 / math.sqrt(3) + 1) * 1.92 * MM, abs=1e-15)
    assert ETR.tube.material.poisson_ratio == pytest.approx(0.3488, abs=1e-4)
    assert ETR.home_translations.tolist() == [0, 0, 0]
    assert ETR.moving_together == ((0, 1, 2),)


def test_the_sheath_holds_three_touching_tubes() -> None:
    diameter = 1.92 * MM
    place = diameter / math.sqrt(3) * np.exp(1j * np.array(PLACES))
    assert np.abs(place - np.roll(place, 1)) == pytest.approx(diameter)
    assert sheath_inner_diameter(diameter) / 2 == pytest.approx(abs(place[0]) + diameter / 2)


@pytest.mark.parametrize(
    "robot",
    [
        ETR,
        replace(ETR, offset=0.0),
        replace(ETR, offset=1.3 * MM, transmission_length=0.0421, joint_limits=LIMITS, name="held far back"),
        THREE,
        replace(THREE, offset=0.0, name="centred"),
        replace(THREE, offset=1.7 * MM),
    ],
    ids=lambda robot: f"{type(robot).__name__} {robot.name or 'unnamed'} {robot.distance * 1e3:.3f}",
)
def test_files_keep_every_bit(robot: EccentricRobot | SegmentedEccentricRobot, tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    robot.save(path)
    loaded = load_robot(path)
    assert type(loaded) is type(robot)
    assert loaded == robot
    assert hash(loaded) == hash(robot)


def test_transmission_lies_behind_the_plate() -> None:
    held = replace(ETR, transmission_length=0.03)
    bundle = held.assembly(np.zeros(3))
    assert bundle.transmission == pytest.approx([0.03] * 3)
    assert bundle.transition == pytest.approx([0.0] * 3)
    assert bundle.end == pytest.approx([0.094] * 3)
    advanced = held.assembly(np.full(3, 0.01))
    assert advanced.transmission == pytest.approx([0.02] * 3)
    assert advanced.transition == pytest.approx([0.01] * 3)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"offset": 1.0 * MM}, r"^offset is 0\.001 m; tubes of outer_diameter 0\.00192 m need at least 0\.0011"),
        ({"offset": -1.0 * MM}, r"^offset is -0\.001; it must be at least 0"),
        (
            {"offset": 0.05},
            r"^offset is 0\.05 m; it must be less than a quarter of the radius of precurvature, 0\.03 m",
        ),
        ({"transmission_length": -1e-3}, r"^transmission_length is -0\.001; it must be at least 0"),
        ({"transmission_length": math.nan}, r"^transmission_length is nan; it must be a finite number"),
    ],
)
def test_what_is_no_segment(change: dict[str, float], problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        EccentricRobot(ETR.tube, **change)


def test_limits_are_for_all_tubes() -> None:
    pair = JointLimits(LIMITS.rotations[:2], LIMITS.translations[:2])
    with pytest.raises(InputError, match=r"^limits are given for 2 tubes; the robot has 3$"):
        replace(ETR, joint_limits=pair)
    with pytest.raises(InputError, match=r"^limits are given for 3 tubes; the robot has 9$"):
        replace(THREE, joint_limits=LIMITS)


def test_tubes_of_a_segment_move_together() -> None:
    with pytest.raises(InputError, match=r"translations are .* must be equal$"):
        ETR.assembly(np.array([0.0, -1e-6, 0.0]))
    shift = THREE.home_translations
    shift[4] += 1e-6
    with pytest.raises(InputError, match=r"^translations of segment 2 are .* must be equal$"):
        THREE.assembly(shift)


def test_segments_follow_each_other_at_home() -> None:
    bundle = THREE.assembly(THREE.home_translations)
    assert bundle.transition[::3] / MM == pytest.approx([90, 50, 0])
    assert bundle.end[::3] / MM == pytest.approx([120, 90, 50])
    assert bundle.transmission[::3] / MM == pytest.approx([70, 60, 50])
    assert bundle.start / MM == pytest.approx([0, 50, 90])
    letters = ["".join("c" if c else "s" if p else "-" for c, p in zip(*row, strict=True)) for row in _masks(bundle)]
    assert letters == ["ssssssccc", "sssccc---", "ccc------"]
    assert bundle.offset == pytest.approx([1.92 * MM / math.sqrt(3)] * 9)
    assert np.exp(1j * bundle.offset_angle) == pytest.approx(np.tile(np.exp(1j * np.array(PLACES)), 3))


def _masks(bundle: object) -> list[tuple[list[bool], list[bool]]]:
    curved, present = bundle.curved, bundle.present  # type: ignore[attr-defined]
    return [(c.tolist(), p.tolist()) for c, p in zip(curved, present, strict=True)]


@pytest.mark.parametrize(("segment", "shift", "message"), [(0, -1e-6, "1 begins"), (1, -1e-6, "2 begins")])
def test_curved_parts_never_overlap(segment: int, shift: float, message: str) -> None:
    advance = THREE.home_translations
    advance[3 * segment : 3 * segment + 3] += shift
    with pytest.raises(InputError, match=rf"^segment {message} to curve at .*; curved parts must not overlap$"):
        THREE.assembly(advance)


def test_a_gap_between_segments_is_allowed() -> None:
    advance = THREE.home_translations + np.repeat([0.02, 0.01, 0.0], 3)
    bundle = THREE.assembly(advance)
    assert bundle.coupled.tolist() == [True, False, True, False, True]


@pytest.mark.parametrize(
    ("segments", "problem"),
    [
        ((), r"^segments is empty; a robot needs at least one segment$"),
        ((ETR.tube, ETR.tube), r"^segments 1 and 2 do not nest: outer_diameter 0\.00192 m must be at most inner_"),
        ((Tube(1.2e-3, 1.05e-3, 0.05, 0.1, 5.0), ETR.tube), r"^straight_length of segment 1 is 0\.05 m; it must be at"),
        (
            (Tube(1.2e-3, 1.05e-3, 0.2, 0.1, -250.0), ETR.tube),
            r"^offset is 0\.00110851 m; it must be less than .* of segment 1, 0\.001 m$",
        ),
    ],
)
def test_what_is_no_stack_of_segments(segments: tuple[Tube, ...], problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        SegmentedEccentricRobot(segments)
