"""Tubes of pieces in YAML: every way to say them, there and back to the last bit, and a sentence for what is wrong."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tubeopt import ConcentricRobot, InputError, Piece, Tube, forward_kinematics, load_robot, save_robot
from tubeopt.robots.pieces import Series
from tubeopt.robots.robot import fit_warnings

HEAD = """kind: concentric
tubes:
  - outer_diameter_mm: 1
    inner_diameter_mm: 0.8
    straight_length_mm: 20
"""


def load(tmp_path: Path, pieces: str, more: str = "") -> Tube:
    lines = "".join(f"      - {line}\n" for line in pieces.splitlines())
    (tmp_path / "robot.yaml").write_text(f"{HEAD}    pieces:\n{lines}{more}")
    robot = load_robot(tmp_path / "robot.yaml")
    assert isinstance(robot, ConcentricRobot)
    return robot.tubes[0]


def test_every_way_to_say_a_precurvature(tmp_path: Path) -> None:
    (tmp_path / "bend.csv").write_text(
        "arc_length_mm,curvature_x_per_m,curvature_y_per_m,twist_deg_per_mm\n0,1,0,0.1\n5,2,0,0.1\n10,5,0,0.1\n"
    )
    tube = load(
        tmp_path,
        "{length_mm: 10, radius_mm: 80}\n"
        "{length_mm: 20, curvature_per_m: 5, plane_deg: 90}\n"
        "{length_mm: 5, curvature_per_m: [3, 4], twist_deg_per_mm: 2}\n"
        "{length_mm: 30, helix: {radius_mm: 10, pitch_mm: 40, handed: left}}\n"
        "{table: bend.csv, plane_deg: 90}\n"
        "{length_mm: 7}",
    )
    arc, turned, twisted, helix, table, straight = tube.pieces
    assert arc.precurvature == (12.5, 0.0, 0.0)
    assert turned.precurvature == pytest.approx((0.0, 5.0, 0.0))
    assert twisted.precurvature == pytest.approx((3.0, 4.0, math.radians(2) * 1e3))
    assert helix == Piece.helix(0.03, 0.01, 0.04, left=True)
    assert table.precurvature[1](np.array([0.005, 0.01])) == pytest.approx([2.0, 5.0])
    assert table.precurvature[2] == pytest.approx(math.radians(100))
    assert straight.precurvature == (0.0, 0.0, 0.0)
    assert tube.curved_length == pytest.approx(0.082)


@pytest.mark.parametrize(("name", "most"), [("bending", 10), ("torsional", 10_000)])
def test_a_stiffness_of_a_piece_lies_between_bounds_of_that_of_the_section(
    tmp_path: Path, name: str, most: int
) -> None:
    tube = load(tmp_path, "{length_mm: 10, radius_mm: 80}")
    own = 1e6 * float(getattr(tube, f"{name}_stiffness"))
    for fraction, refused in ((0.999e-4, True), (1.001e-4, False), (0.999 * most, False), (1.001 * most, True)):
        piece = f"{{length_mm: 10, radius_mm: 80, {name}_stiffness_N_mm2: {fraction * own:.9f}}}"
        if refused:
            with pytest.raises(InputError, match=rf"{name}_stiffness_N_mm2 is .*0.0001 to {most} times that"):
                load(tmp_path, piece)
        else:
            assert getattr(load(tmp_path, piece).pieces[0], f"{name}_stiffness") == pytest.approx(1e-6 * fraction * own)


def test_a_rigid_drive_shaft_leaves_no_transmission(tmp_path: Path) -> None:
    """A tube behind a shaft that hardly twists is one that is held at the plate."""
    outer = Tube(1.5e-3, 1.15e-3, 0.0, 0.06, 5.0)
    held = Tube(1e-3, 0.75e-3, 0.0, 0.09, 9.0)
    shaft = Piece(0.06, 0.0, torsional_stiffness=1e4 * float(held.torsional_stiffness))
    driven = Tube.of_pieces(1e-3, 0.75e-3, [shaft, Piece(0.09, 9.0)])
    path, joints = tmp_path / "robot.yaml", np.array([2.0, 0.0])
    ConcentricRobot((driven, outer)).save(path)
    robot = load_robot(path)
    reached = forward_kinematics(robot, joints, [-0.06, 0.0])
    expected = forward_kinematics(ConcentricRobot((held, outer)), joints)
    np.testing.assert_allclose(reached.tip_position, expected.tip_position, atol=1e-6)
    soft = replace(driven, pieces=(replace(shaft, torsional_stiffness=None), driven.pieces[1]))
    twisted = forward_kinematics(ConcentricRobot((soft, outer)), joints, [-0.06, 0.0])
    assert np.linalg.norm(twisted.tip_position - expected.tip_position) > 1e-3


def test_stiffnesses_and_patterns(tmp_path: Path) -> None:
    tube = load(
        tmp_path,
        "{length_mm: 10, radius_mm: 80, pattern: {bending_factor: 0.4, torsion_factor: 0.5, source: measured}}\n"
        "{length_mm: 10, radius_mm: 80, bending_stiffness_N_mm2: 900, torsional_stiffness_N_mm2: 800}",
        "    bending_stiffness_N_mm2: 1500\n    mass_per_length_g_per_m: 2.5\n",
    )
    assert tube.bending_stiffness == pytest.approx(1.5e-3)
    assert tube.pieces[0].bending_stiffness == pytest.approx(0.6e-3)
    assert tube.pieces[0].torsional_stiffness == pytest.approx(0.5 * tube.torsional_stiffness)
    assert (tube.pieces[1].bending_stiffness, tube.pieces[1].torsional_stiffness) == pytest.approx((9e-4, 8e-4))
    assert tube.mass_per_length == pytest.approx(2.5e-3)


def test_slots_are_read_written_and_count_in_the_strain(tmp_path: Path) -> None:
    whole = "{length_mm: 10, radius_mm: 80}"
    pattern = "pattern: {bending_factor: 0.3, torsion_factor: 0.5, source: measured}"
    report = load(tmp_path, whole + "\n{length_mm: 10, radius_mm: 80, " + pattern + ", slots: {share: 0.4}}")
    strain = 0.5e-3 / 80e-3 / (1 - 0.5e-3 / 80e-3)
    assert report.straightened_strain == pytest.approx(strain * (1 - 0.3 * 0.6) / 0.4)
    robot = ConcentricRobot((report,))
    save_robot(robot, tmp_path / "saved.yaml")
    assert load_robot(tmp_path / "saved.yaml") == robot
    assert [line for line in fit_warnings(robot) if "slots" in line] == []
    silent = load(tmp_path, whole + "\n{length_mm: 10, radius_mm: 80, " + pattern + "}")
    assert silent.straightened_strain == pytest.approx(strain)
    assert any("softer in piece 2 than elsewhere" in line for line in fit_warnings(ConcentricRobot((silent,))))
    with pytest.raises(InputError, match=r"slots.share is 1.5; it must be at most 1|share of the slots is 1.5"):
        load(tmp_path, "{length_mm: 10, radius_mm: 80, slots: {share: 1.5}}")


def test_one_arc_is_the_ordinary_tube(tmp_path: Path) -> None:
    assert load(tmp_path, "{length_mm: 50, curvature_per_m: 10}") == Tube(1e-3, 0.8e-3, 0.02, 0.05, 10.0)


def test_saved_and_loaded_is_equal_to_the_last_bit(tmp_path: Path) -> None:
    bending = Piece(0.0333, lambda s: (9 * math.cos(30 * s), 3.0, 5 * s), torsional_stiffness=lambda s: 1e-3 + 0.01 * s)
    tube = Tube.of_pieces(1e-3, 0.7e-3, [bending, Piece.helix(0.1 / 3, 0.01, 0.03)], straight_length=0.1 / 3)
    inputs = replace(tube, bending_stiffness=1.7e-3, mass_per_length=2e-3)
    for one in (tube, inputs):
        robot = ConcentricRobot((one,))
        save_robot(robot, tmp_path / "saved.yaml")
        back = load_robot(tmp_path / "saved.yaml")
        assert back == robot
        assert isinstance(back.tubes[0].pieces[0].precurvature[0], Series)
        thick = [replace(t, outer_diameter=1.1e-3).bending_stiffness for t in (one, back.tubes[0])]
        assert thick[0] == thick[1]


def test_a_helix_of_less_than_a_turn_may_have_any_pitch(tmp_path: Path) -> None:
    # One turn takes the hypotenuse of 2 pi 10 mm and the pitch of 0.5 mm, 62.834 mm.
    turn = math.hypot(2 * math.pi * 10, 0.5)
    load(tmp_path, f"{{length_mm: {turn - 0.01:.6f}, helix: {{radius_mm: 10, pitch_mm: 0.5}}}}")
    with pytest.raises(InputError, match=r"helix.pitch_mm is 0.5; it must exceed the tube's diameter, 1 mm"):
        load(tmp_path, f"{{length_mm: {turn + 0.01:.6f}, helix: {{radius_mm: 10, pitch_mm: 0.5}}}}")
    load(tmp_path, "{length_mm: 200, helix: {radius_mm: 10, pitch_mm: 1.001}}")


@pytest.mark.parametrize(
    ("pieces", "more", "problem"),
    [
        ("{radius_mm: 80}", "", "pieces[0]: length_mm is missing"),
        (
            "{length_mm: 10, helix: {radius_mm: 0.3, pitch_mm: 1.2}}",
            "",
            "per m; its radius must exceed half the outer_diameter (0.5 mm)",
        ),
        (
            "{length_mm: 100, helix: {radius_mm: 10, pitch_mm: 0.5}}",
            "",
            "pieces[0]: helix.pitch_mm is 0.5; it must exceed the tube's diameter, 1 mm",
        ),
        (
            "{length_mm: 10, radius_mm: 80, torsional_stiffness_N_mm2: 0.001}",
            "",
            "pieces[0]: torsional_stiffness_N_mm2 is 0.001; the cross-section and material give",
        ),
        (
            "{length_mm: 10, radius_mm: 80, twist_deg_per_mm: 360}",
            "",
            "piece 1 is twisted by 360000 deg per m (360 deg per mm)",
        ),
        (
            "{length_mm: 10, radius_mm: 80}",
            "    curved_length_mm: 12\n",
            "curved_length_mm is 12; the lengths of the pieces add up to 10",
        ),
        (
            "{length_mm: 10, radius_mm: 80, pattern: {bending_factor: 1.2, torsion_factor: 1, source: x}}",
            "",
            "pattern.bending_factor is 1.2; it must be at most 1",
        ),
        (
            "{length_mm: 10, radius_mm: 80, pattern: {bending_factor: 0, torsion_factor: 1, source: x}}",
            "",
            "pattern.bending_factor is 0; it must be greater than 0",
        ),
        (
            "{length_mm: 10, radius_mm: 80}",
            "    bending_stiffness_N_mm2: 0.0016\n",
            "bending_stiffness_N_mm2 is 0.0016; the cross-section and material give 1681, and it must be",
        ),
        ("{length_mm: 10, radius_mm: 80, curvature_per_m: 2}", "", "radius_mm and curvature_per_m are both given"),
        ("{length_mm: 10, radius_mm: 80}", "    radius_mm: 80\n", "radius_mm and pieces are both given"),
        ("{table: none.csv}", "", "none.csv: there is no such file"),
        ("{table: fall.csv}", "", "arc_length_mm of a table is 4 in row 3, after 5; it must rise from row to row"),
        ("{length_mm: 9, table: good.csv}", "", "length_mm is 9; the table ends at 5 mm, and they must agree"),
        ("{table: short.csv}", "", "short.csv: column curvature_y_per_m is missing"),
    ],
)
def test_what_is_wrong_has_its_sentence(tmp_path: Path, pieces: str, more: str, problem: str) -> None:
    head = "arc_length_mm,curvature_x_per_m,curvature_y_per_m\n"
    (tmp_path / "fall.csv").write_text(head + "0,1,0\n5,2,0\n4,5,0\n")
    (tmp_path / "good.csv").write_text(head + "0,1,0\n5,2,0\n")
    (tmp_path / "short.csv").write_text("arc_length_mm,curvature_x_per_m\n0,1\n5,2\n")
    with pytest.raises(InputError) as caught:
        load(tmp_path, pieces, more)
    assert problem in str(caught.value)


def test_no_pieces_and_no_length(tmp_path: Path) -> None:
    (tmp_path / "robot.yaml").write_text(HEAD)
    with pytest.raises(InputError, match=r"tubes\[0\].curved_length_mm is missing"):
        load_robot(tmp_path / "robot.yaml")
