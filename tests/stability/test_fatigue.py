"""Strain cycles of tubes in closed form, rainflow counting by the numbers of the standard, and life by a curve."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.examples import MM, TWO_TUBE, nested
from tubeopt import ConcentricRobot, InputError, Material, StrainLife, Tube, drives_along, fatigue, forward_kinematics
from tubeopt.stability.fatigue import Endurance
from tubeopt.stability.rainflow import Cycles, rainflow

ALLOY = Material("nitinol with nu = 0.28", 58e9, 58e9 / 2.56)


def test_cycles_are_those_of_the_standard() -> None:
    # ASTM E1049-85, the history of its figures, repeated: ranges 9, 7, 4 and 3.
    found = rainflow(np.array([-2.0, 1, -3, 5, -1, 3, -4, 4]))
    np.testing.assert_allclose(2 * found.amplitude, [9, 7, 4, 3])
    np.testing.assert_allclose(found.mean, [0.5, 0.5, 1.0, -0.5])
    # Any start of the period, and points between the turning points, give the same cycles.
    other = rainflow(np.array([3.0, 0, -4, -4, 4, 1, -2, 1, -3, 1, 5, 2, -1]))
    np.testing.assert_allclose(other.amplitude, found.amplitude)
    assert len(rainflow(np.full(4, 0.3)).amplitude) == 0


def test_a_straight_tube_that_turns_in_a_bent_one_bends_to_and_fro() -> None:
    robot = nested((0.0, 0.1, 0.0), (0.0, 0.1, 14.0))
    turn = np.linspace(0.0, 2 * np.pi, 25)[:, None] * (1.0, 0.0)
    inner, outer = fatigue(robot, turn).tubes
    kb = [float(tube.bending_stiffness) for tube in robot.tubes]
    bend = 14.0 * kb[1] / sum(kb)
    assert inner.amplitude == pytest.approx(0.5 * MM * bend, rel=1e-9)
    assert inner.mean == pytest.approx(0.0, abs=1e-12)
    assert inner.largest == pytest.approx(inner.amplitude)
    # The outer tube stays as it is.
    assert outer.amplitude == pytest.approx(0.0, abs=1e-12)
    radius = robot.tubes[1].outer_diameter / 2
    assert outer.largest == pytest.approx(radius * (14.0 - bend) / (1 - radius * 14.0), rel=1e-9)


def test_a_tube_that_is_drawn_back_is_straightened() -> None:
    robot = ConcentricRobot((Tube(1.0 * MM, 0.8 * MM, 0.05, 0.06, 20.0, ALLOY),))
    (tube,) = fatigue(robot, [[0.0], [0.0]], [[0.0], [-0.06]]).tubes
    strain = 0.5 * MM * 20.0
    assert tube.amplitude == pytest.approx(strain / (1 - strain) / 2, rel=1e-9)
    assert abs(tube.mean) == pytest.approx(tube.amplitude)
    assert tube.place > 0.05
    assert tube.endurance is Endurance.SCATTERED


def test_torsion_counts_by_the_strain_of_von_mises() -> None:
    pair = nested((0.1, 0.03, 14.0), (0.08, 0.03, 10.0))
    soft = replace(pair, tubes=tuple(replace(t, torsional_stiffness=t.torsional_stiffness / 20) for t in pair.tubes))
    turn = np.linspace(0.0, 1.2, 13)[:, None] * (1.0, 0.0)
    tube, ends = fatigue(soft, turn).tubes[0], [forward_kinematics(soft, turn[k]) for k in (0, -1)]
    torque = np.abs(drives_along(soft, turn).torque[:, 0]).max()
    shear = 0.5 * MM * torque / float(soft.tubes[0].torsional_stiffness)
    # In front of the plate it bends too: in the axes of the tube, which turn.
    bend = np.diff([complex(*e.curvature[0]) * np.exp(-1j * e.rotation[0, 0]) for e in ends])[0]
    assert 0.1 < tube.place < 0.101
    assert 2 * tube.amplitude == pytest.approx(np.hypot(np.sqrt(3) / 2.56 * shear, 0.5 * MM * abs(bend)), rel=0.03)
    assert shear > 3 * 0.5 * MM * abs(bend)


def test_a_loop_is_no_way_forth_and_back() -> None:
    loop = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 0.0]]
    assert not fatigue(TWO_TUBE, loop).returned
    assert fatigue(TWO_TUBE, loop[:2]).returned
    assert fatigue(TWO_TUBE, loop).statistics.equilibria == 4


def test_life_adds_the_damage_of_all_cycles() -> None:
    curve = StrainLife(np.array([1e-3, 1e-2]), np.array([1e6, 1e2]), np.array([1e5, 1e1]), np.array([1e7, 1e3]))
    once = Cycles(np.array([np.sqrt(1e-5)]), np.zeros(1))
    assert curve.life(once) == pytest.approx(1e4)
    both = Cycles(np.array([1e-2, np.sqrt(1e-5), 1e-5]), np.zeros(3))
    assert 1 / curve.life(both) == pytest.approx(1e-2 + 1e-4 + 1e-6)
    assert curve.life(once, "low") == pytest.approx(1e3)
    assert np.isnan(curve.life(Cycles(np.array([2e-2]), np.zeros(1))))
    assert curve.life(rainflow(np.zeros(3))) == np.inf


@pytest.mark.parametrize(
    ("amplitude", "cycles", "message"),
    [
        ([1e-3], [1e6], "has 1 points; it must have at least 2"),
        ([1e-3, 1e-2], [1e2, 1e6], "lives must not rise with the amplitude"),
        ([1e-2, 1e-3], [1e6, 1e2], "amplitudes must increase"),
        ([1e-3, 1e-2], [1e6, 0.0], "it must be greater than 0"),
    ],
)
def test_curves_that_are_none_are_refused(amplitude: list[float], cycles: list[float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        StrainLife(np.array(amplitude), np.array(cycles))


def test_only_nitinol_has_published_limits() -> None:
    steel = replace(ALLOY, name="titanium")
    assert isinstance(TWO_TUBE, ConcentricRobot)
    other = replace(TWO_TUBE, tubes=tuple(replace(tube, material=steel) for tube in TWO_TUBE.tubes))
    assert fatigue(other, [[0.0, 0.0], [1.0, 0.0]]).status is Endurance.UNKNOWN
    assert fatigue(TWO_TUBE, [[0.0, 0.0], [1e-3, 0.0]]).status is Endurance.ENDLESS
    with pytest.raises(InputError, match="at least 2"):
        fatigue(TWO_TUBE, [[0.0, 0.0]])
