"""Joint values to sections: which tube is where, for any order of breakpoints."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given

from tests.examples import CRL, MM, THESIS, eccentric_assembly, nested, poses
from tubeopt import ConcentricRobot, InputError, Tube
from tubeopt.robots.assembly import LENGTH_ROUND_OFF, Assembly, assemble, without_offsets
from tubeopt.typing import Array


def table(assembly: Assembly) -> list[tuple[float, float, str]]:
    """Start, stop (mm), and for each tube one letter: c curved, s straight, - not there."""
    letters = np.where(assembly.curved, "c", np.where(assembly.present, "s", "-"))
    stop = assembly.start + assembly.length
    bounds = zip(assembly.start / MM, stop / MM, letters, strict=True)
    return [(round(a, 9), round(b, 9), "".join(row)) for a, b, row in bounds]


@pytest.mark.parametrize(
    ("translations", "expected"),
    [
        # At home every transition lies at the plate.
        ((0, 0, 0), [(0, 100, "ccc"), (100, 150, "cc-"), (150, 200, "c--")]),
        # Advanced by different amounts: the curves begin one after the other.
        ((60, 30, 0), [(0, 30, "ssc"), (30, 60, "scc"), (60, 100, "ccc"), (100, 180, "cc-"), (180, 260, "c--")]),
        # The order of breakpoints turned around: the inner tube ends inside the outer ones.
        ((-150, -20, 50), [(0, 50, "ccs"), (50, 130, "-cc"), (130, 150, "--c")]),
        # Curved parts drawn back behind the plate: what is left in front is curved.
        ((-50, -100, -90), [(0, 10, "ccc"), (10, 50, "cc-"), (50, 150, "c--")]),
        # Straight stretches in front of the plate, the outer tube ends before any curve begins.
        ((200, 150, -40), [(0, 60, "ssc"), (60, 150, "ss-"), (150, 200, "sc-"), (200, 300, "cc-"), (300, 400, "c--")]),
        # A tube withdrawn so far that nothing of it is left in front of the plate.
        ((0, 0, -100), [(0, 150, "cc-"), (150, 200, "c--")]),
        ((0, -180, -130), [(0, 200, "c--")]),
        ((-250, -180, -100), []),
    ],
)
def test_sections_of_the_thesis_robot(
    translations: tuple[float, ...], expected: list[tuple[float, float, str]]
) -> None:
    assert table(THESIS.assembly(np.array(translations) * MM)) == expected


def test_numbers_that_the_equations_need() -> None:
    shift = np.array([10.0, -20.0, 30.0]) * MM
    assembly = THESIS.assembly(shift)
    assert assembly.transmission / MM == pytest.approx([190, 170, 70])
    assert assembly.transition / MM == pytest.approx([10, -20, 30])
    assert assembly.end / MM == pytest.approx([210, 130, 130])
    assert assembly.bending_stiffness.tolist() == [tube.bending_stiffness for tube in THESIS.tubes]
    assert assembly.torsional_stiffness.tolist() == [tube.torsional_stiffness for tube in THESIS.tubes]
    assert assembly.curvature == pytest.approx([10, 5, 2.5])
    assert not assembly.eccentric
    assert assembly.offset.tolist() == assembly.offset_angle.tolist() == [0, 0, 0]


def test_tubes_of_equal_length_end_together() -> None:
    robot = nested((0.05, 0.1, 10.0), (0.05, 0.1, 5.0), (0.05, 0.1, 2.0))
    assert table(robot.assembly(np.zeros(3))) == [(0, 100, "ccc")]


def test_breakpoints_apart_by_round_off_are_one() -> None:
    robot = nested((0.05, 0.1, 10.0), (0.05, 0.1, 5.0))
    assert robot.assembly(np.array([0.0, 1e-13])).n_sections == 1
    assert robot.assembly(np.array([0.0, -1e-9])).n_sections == 2


@pytest.mark.parametrize(
    ("tubes", "expected"),
    [
        ((0.1, 0.0, 10.0), []),
        ((0.0, 0.1, 10.0), [(0, 100, "c")]),
        ((0.05, 0.1, 0.0), [(0, 100, "s")]),
    ],
)
def test_parts_without_length_or_curvature(tubes: tuple[float, float, float], expected: list[object]) -> None:
    assert table(nested(tubes).assembly(np.zeros(1))) == expected


def test_straight_tube_inside_a_curved_one_is_there_but_not_curved() -> None:
    robot = nested((0.2, 0.0, 0.0), (0.0, 0.1, 5.0))
    assert table(robot.assembly(np.array([0.15, 0.0]))) == [(0, 100, "sc"), (100, 150, "s-")]
    assert not robot.assembly(np.array([0.15, 0.0])).coupled.any()


def test_coupled_where_two_tubes_are_curved() -> None:
    assembly = THESIS.assembly(np.array([60.0, 30.0, 0.0]) * MM)
    assert assembly.coupled.tolist() == [False, True, True, True, False]


def test_tubes_beside_the_centreline_couple_wherever_one_is_curved() -> None:
    tube = Tube(1e-3, 0.8e-3, 0.05, 0.05, 10.0)
    given_place = {"offset": np.full(2, 1e-3), "offset_angle": np.array([0.0, np.pi])}
    assembly = assemble([tube, tube], np.array([0.03, 0.0]), **given_place)
    assert assembly.eccentric
    assert assembly.coupled.tolist() == [True, True, True]
    assert not without_offsets(assembly).eccentric
    assert without_offsets(assembly).coupled.tolist() == [False, True, False]
    assert without_offsets(assembly).offset_angle.tolist() == [0, 0]


def test_the_eccentric_robot_is_one_section() -> None:
    assert table(eccentric_assembly()) == [(0, 94, "ccc")]


@pytest.mark.parametrize("tube", [0, 1, 2])
def test_a_tube_pulled_out_of_its_actuator(tube: int) -> None:
    shift = np.zeros(3)
    shift[tube] = CRL.tubes[tube].straight_length + 1e-6
    with pytest.raises(InputError) as caught:
        CRL.assembly(shift)
    straight = CRL.tubes[tube].straight_length
    assert str(caught.value) == (
        f"translation of tube {tube + 1} is {shift[tube]:g} m and moves it out of its carriage; "
        f"it must be at most its straight_length, {straight:g} m"
    )


def test_the_message_speaks_the_words_of_its_caller() -> None:
    with pytest.raises(InputError, match=r"^advance of tube 1 is 0\.2 m"):
        assemble([Tube(1e-3, 0.8e-3, 0.1, 0.1, 1.0)], np.array([0.2]), name="advance")


def test_advanced_to_the_last_bit_of_the_straight_part() -> None:
    robot = nested((0.3, 0.1, 10.0))
    assembly = robot.assembly(np.array([0.1 + 0.2]))  # 0.30000000000000004
    assert assembly.transmission.tolist() == [0.0]


@given(poses())
def test_sections_tell_the_truth_about_every_tube(pose: tuple[ConcentricRobot, Array, Array]) -> None:
    robot, _, shift = pose
    assembly = robot.assembly(shift)
    n, ends = robot.n_tubes, shift + [tube.curved_length for tube in robot.tubes]
    # At most two breakpoints per tube; sections follow each other and reach to the farthest tip.
    assert assembly.n_sections <= 2 * n
    assert (assembly.length > LENGTH_ROUND_OFF).all()
    assert assembly.start[1:] == pytest.approx(assembly.start[:-1] + assembly.length[:-1], abs=1e-15)
    assert assembly.total_length == pytest.approx(max(0.0, ends.max()), abs=1e-15)
    assert assembly.length.sum() == pytest.approx(assembly.total_length, abs=2 * n * LENGTH_ROUND_OFF)
    assert (assembly.present | ~assembly.curved).all()
    assert assembly.present.any(axis=1).all()
    # In front of the plate lies of each tube what its length leaves, and of that the curved part and no more.
    for i, tube in enumerate(robot.tubes):
        visible = max(0.0, ends[i])
        curved = min(visible, tube.curved_length) if tube.curvature else 0.0
        assert assembly.length @ assembly.present[:, i] == pytest.approx(visible, abs=1e-10)
        assert assembly.length @ assembly.curved[:, i] == pytest.approx(curved, abs=1e-10)
        assert assembly.transmission[i] == pytest.approx(tube.straight_length - shift[i], abs=1e-15)
