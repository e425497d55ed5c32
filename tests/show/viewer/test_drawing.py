"""What is drawn: closed surfaces of true size, plots and words that say what is so."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.examples import CONFIGS, CRL, THESIS, TWO_TUBE
from tubeopt import (
    ConcentricRobot,
    InputError,
    Load,
    forward_kinematics,
    load_robot,
    save_robot,
    stability_map,
    trace_branch,
)
from tubeopt.bodies.corridors import Corridor
from tubeopt.bodies.frames import Plane
from tubeopt.bodies.obstacles import Box, Capsule, HalfSpace, Sphere
from tubeopt.planning.trajectory import load_trajectory
from tubeopt.robots.calibration import Calibration
from tubeopt.robots.file import robot_to_yaml
from tubeopt.show.page import margin_colour
from tubeopt.show.surfaces import SampledCentreline, Surface, obstacle_surface, plate_part, robot_parts
from tubeopt.show.viewer import host, insights, page_text
from tubeopt.show.viewer.overlays import cut_parts, cut_text, swept_volume
from tubeopt.show.viewer.scene import between
from tubeopt.show.viewer.session import move_joint, note, open_session, record
from tubeopt.show.viewer.view import ViewerWaypoints, load_waypoints, make_playback, play_to, snaps_between, state_at

ETR = load_robot(CONFIGS / "thesis_etr.yaml")
SEGMENTS = load_robot(CONFIGS / "example_three_segment_etr.yaml")
ROOT = Path(__file__).parents[3]


def enclosed(surface: Surface) -> float:
    """Volume inside a closed surface, by the divergence theorem; positive where triangles face outwards."""
    a, b, c = (surface.vertices[surface.faces[:, k].astype(int)] for k in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


@pytest.mark.parametrize("robot", [THESIS, CRL, TWO_TUBE, ETR, SEGMENTS], ids=lambda robot: robot.name)
def test_tubes_have_their_true_diameter_everywhere(robot: ConcentricRobot) -> None:
    rotations = np.linspace(0.0, 1.0, robot.n_tubes)
    equilibrium = forward_kinematics(robot, rotations)
    line = SampledCentreline(equilibrium)
    fine = line.position(np.linspace(0, line.length, 4001))
    assembly = robot.assembly(equilibrium.translations)
    for part in robot_parts(equilibrium):
        assert np.isfinite(part.surface.vertices).all()
        assert part.surface.faces.max() < len(part.surface.vertices)
        if part.name.startswith("tube"):
            tube = int(part.name.split("_")[1]) - 1
            near = np.linalg.norm(part.surface.vertices[::7, None] - fine, axis=2).min(1)
            radius, offset = robot.tubes[tube].outer_diameter / 2, assembly.offset[tube]
            assert near.max() <= radius + offset + 1e-6
            assert near.min() >= abs(radius - offset) - 1e-6
            if offset == 0:
                assert near == pytest.approx(radius, rel=1e-3)


def test_parts_keep_their_number_of_vertices_while_the_robot_moves() -> None:
    shapes = [[len(p.surface.vertices) for p in robot_parts(forward_kinematics(THESIS, (a, 0, 0)))] for a in (0, 1, 2)]
    assert shapes[0] == shapes[1] == shapes[2]


@pytest.mark.parametrize("normal", [(1, 0, 0), (0, 0, -1), (0.5, -0.3, 0.7)])
def test_a_cut_leaves_what_lies_before_the_plane_and_fills_what_it_cuts(normal: tuple[float, float, float]) -> None:
    ball = Sphere((0.1, 0.01, 0.02), 0.02)
    along = np.array(normal) / np.linalg.norm(normal)
    plane, other, before = (Plane(ball.centre + far * along, along) for far in (0.005, 0.1, -0.05))
    rest, filled = cut_parts([ball], 1.0, plane)
    for part in (rest, filled):
        assert plane.height(part.surface.vertices).max() <= 1e-9
    together = Surface(
        np.concatenate([rest.surface.vertices, filled.surface.vertices]),
        np.concatenate([rest.surface.faces, filled.surface.faces + np.uint32(len(rest.surface.vertices))]),
    )
    height = 0.02 + 0.005
    assert enclosed(together) == pytest.approx(np.pi * height**2 * (0.06 - height) / 3, rel=0.02)
    area = np.pi * (0.02**2 - 0.005**2) * 1e4
    assert float(cut_text([rest, filled], plane).split()[-4]) == pytest.approx(area, rel=0.01)
    (whole,) = cut_parts([ball], 1.0, other)
    assert enclosed(whole.surface) == pytest.approx(enclosed(obstacle_surface(ball, 1.0)))
    assert cut_parts([ball], 1.0, before) == []


def test_bodies_enclose_their_volume() -> None:
    ball = obstacle_surface(Sphere((0.1, 0, 0), 0.02), 1.0)
    assert enclosed(ball) == pytest.approx(4 / 3 * np.pi * 0.02**3, rel=0.02)
    rod = obstacle_surface(Capsule((0, 0, 0), (0, 0.03, 0.04), 0.01), 1.0)
    assert enclosed(rod) == pytest.approx(np.pi * 0.01**2 * (0.05 + 4 / 3 * 0.01), rel=0.02)
    assert enclosed(obstacle_surface(Box((0, 0, 0), (0.1, 0.2, 0.3)), 1.0)) == pytest.approx(6e-3)
    vessel = Corridor(((0, 0, 0), (0, 0, 0.1), (0.1, 0, 0.1)), 0.01)
    assert np.abs(vessel.signed_distance(obstacle_surface(vessel, 1.0).vertices)).min() < 1e-9
    plane = obstacle_surface(HalfSpace((0, 0, 0.1), (0, 0, 1)), 0.5)
    assert plane.vertices[:, 2] == pytest.approx(0.1)
    assert enclosed(plate_part(0.01).surface) > 0


def test_a_snap_is_shown_from_where_it_was_to_where_it_lands() -> None:
    session, _ = move_joint(open_session(THESIS), 0, np.radians(220))
    (snap,) = session.last
    frames = between(snap.before, snap.after, 12)
    tips = np.array([snap.before.tip_position, *(f.position[-1] for f in frames), snap.after.tip_position])
    steps = np.linalg.norm(np.diff(tips, axis=0), axis=1)
    assert steps.sum() >= snap.tip_jump
    assert steps.max() < 0.4 * snap.tip_jump
    for frame in frames:
        lengths = np.linalg.norm(np.diff(frame.position, axis=0), axis=1)
        assert lengths.sum() == pytest.approx(snap.after.arc_length[-1], rel=0.01)


def test_colours_go_from_red_to_green() -> None:
    assert margin_colour(-1) == margin_colour(0.0) == (200, 30, 30)
    assert margin_colour(1.0) == (0, 150, 90)


# --- plots and words -------------------------------------------------------------------------------------------------


def test_plots_show_the_branch_and_the_place() -> None:
    equilibrium = forward_kinematics(THESIS, np.radians([100, 0, 0]))
    branch = trace_branch(THESIS, np.radians([-360, 0, 0]), np.radians([360, 0, 0]))
    curve = insights.s_curve_plot(branch, equilibrium, 0)
    assert curve.count("<circle") == len(branch.folds) + 1 == 5
    assert curve.count("stroke-dasharray") == 2
    torsion = insights.torsion_plot(equilibrium)
    assert torsion.count("<polyline") == 3
    chart = stability_map(THESIS, samples=5, directions=1, workers=1)
    assert insights.map_plot(chart, equilibrium).count("<rect") == 25
    assert insights.torsion_plot(forward_kinematics(TWO_TUBE, np.zeros(2))).count("<polyline") == 2


def test_ticks_are_round() -> None:
    assert insights.ticks(-360, 360, angle=True).tolist() == [-360, -180, 0, 180, 360]
    assert insights.ticks(0.0, 0.31).tolist() == pytest.approx([0, 0.1, 0.2, 0.3])


def test_the_readout_shows_the_snap_distance() -> None:
    e = forward_kinematics(THESIS, [0.0, 1.0, 2.0])
    assert page_text.snap_distance_text(e) == "snap distance: at least 51.9 deg<br>"
    assert page_text.snap_distance_text(e) in page_text.readout(open_session(THESIS, e.rotations), None)
    assert not page_text.snap_distance_text(forward_kinematics(THESIS, [0.0, 1.0, 2.0], load=Load((1e-3, 0.0, 0.0))))


def test_words_are_escaped() -> None:
    session = open_session(replace(THESIS, name="<script>alert(1)</script>"))
    assert "<script" not in page_text.readout(session, None) + page_text.log_text(note(session, "<b>").log)
    for k in range(page_text.SHOWN_EVENTS + 1):
        session = note(session, f"the {k + 1}th")
    first, *_, last = re.findall(r"value=.(\d+).[^>]*>(.*?)</li>", page_text.log_text(session.log))
    assert (first, last) == (("13", "the 13th"), ("1", "and earlier ones"))
    assert "&lt;b&gt;<br>two" in page_text.message_text("<b>\ntwo", bad=True)
    assert "cannot snap at any rotation" in page_text.certificate_text(0.2)
    assert "not proved" in page_text.certificate_text(-0.2)


# --- trajectories ----------------------------------------------------------------------------------------------------


def test_a_trajectory_has_its_own_history() -> None:
    playback = make_playback(THESIS, load_waypoints(ROOT / "configs" / "paths" / "turn_and_back.csv", THESIS))
    assert playback.duration == pytest.approx(16.0)
    assert len(playback.path.snaps) == 2
    forth, back = state_at(playback, 200 / 45), state_at(playback, 16 - 200 / 45)
    assert forth.rotations == pytest.approx(back.rotations)
    assert np.linalg.norm(forth.tip_position - back.tip_position) > 0.05
    assert [len(snaps_between(playback, a, b)) for a, b in ((0, 4.7), (4.7, 4.8), (4.8, 16), (0, 16))] == [0, 1, 1, 2]
    session = open_session(THESIS)
    assert len(play_to(session, playback, 5.0, since=4.0).log) == 1
    assert not play_to(session, playback, 5.0).log
    assert np.degrees(play_to(session, playback, 5.0).equilibrium.rotations[0]) == pytest.approx(225)
    played = play_to(record(play_to(session, playback, 4.0), True), playback, 5.0, since=4.0)
    assert [
        len(each.recording or ()) for each in (played, play_to(played, playback, 5.0), play_to(played, playback, 2.0))
    ] == [
        2,
        3,
        1,
    ]


def test_a_recording_replays_on_its_own_branch(tmp_path: Path) -> None:
    """From beyond the snap, so that the joint values alone would begin on another branch."""
    session, _ = move_joint(open_session(THESIS), 0, np.radians(250))
    session = record(move_joint(session, 0, np.radians(170))[0], True)
    for angle in (165, 160, 155):
        session, _ = move_joint(session, 0, np.radians(angle))
    path = tmp_path / "recording.csv"
    path.write_text(host.recording_csv(session))
    assert load_trajectory(path, THESIS).start_tips is not None
    playback = make_playback(THESIS, load_waypoints(path, THESIS))
    end = playback.path.equilibria[-1]
    assert end.tip_position == pytest.approx(session.equilibrium.tip_position, abs=1e-9)
    alone = forward_kinematics(THESIS, end.rotations)
    assert np.linalg.norm(alone.tip_position - end.tip_position) > 0.03
    assert playback.duration == pytest.approx(15 / 45)
    with pytest.raises(InputError, match="nothing was recorded"):
        host.recording_csv(open_session(THESIS))


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("time_s,rotation_1_deg,rotation_2_deg,rotation_3_deg\n0,0,0,0\n0,1,0,0\n", "time_s does not increase"),
        ("rotation_1_deg,rotation_2_deg,rotation_3_deg\n0,0,0\n0,999,0\n", "row 2: rotation of tube 2 is 999 deg"),
        ("rotation_1_deg,rotation_2_deg\n0,0\n", "column rotation_3_deg is missing"),
    ],
)
def test_bad_trajectories_are_refused(tmp_path: Path, rows: str, message: str) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(rows)
    with pytest.raises(InputError, match=message):
        load_waypoints(path, THESIS)


def test_the_swept_volume_of_a_turn_is_that_of_its_body_of_revolution() -> None:
    """All tubes turned together sweep what the resting arc, turned about z, sweeps: by Pappus per piece of the arc."""
    angles = np.linspace(0.0, 2 * np.pi / 3, 13)
    path = ViewerWaypoints(np.arange(13.0), np.tile(angles[:, None], (1, 2)), np.zeros((13, 2)))
    playback = make_playback(TWO_TUBE, path)
    swept = swept_volume(playback)
    line = SampledCentreline(playback.path.equilibria[0])
    s = np.linspace(0, line.length, 2001)
    points, tangent = line.position(s), line.axes(s)[2]
    radius = np.hypot(points[:, 0], points[:, 1])
    outer = np.array([tube.outer_diameter for tube in TWO_TUBE.tubes])
    ends = playback.path.equilibria[0].tube_end
    width = np.where(s[:, None] <= ends + 1e-9, outer, 0.0).max(1)
    # The sheet that the centreline sweeps is as thick as the arm, seen across it.
    expected = float(np.trapezoid(2 * np.pi / 3 * radius * width, s))
    assert swept.volume == pytest.approx(expected, rel=0.12)
    assert np.abs(tangent[:, 0]).max() < 1e-6 or np.abs(tangent[:, 1]).max() < 1e-6
    assert enclosed(swept.surface) == pytest.approx(swept.volume, rel=1e-3)


def test_saved_files_are_read_back(tmp_path: Path) -> None:
    from tubeopt.runs.inverse_study import load_joints

    session, _ = move_joint(open_session(THESIS), 0, 1.0)
    (tmp_path / "joints.yaml").write_text(host.joints_yaml(session))
    rotations, translations = load_joints(tmp_path / "joints.yaml", THESIS)
    assert np.array_equal(rotations, session.equilibrium.rotations)
    assert np.array_equal(translations, session.equilibrium.translations)
    (tmp_path / "robot.yaml").write_text(robot_to_yaml(THESIS))
    assert load_robot(tmp_path / "robot.yaml") == THESIS
    save_robot(THESIS, tmp_path / "other.yaml")
    assert (tmp_path / "other.yaml").read_text() == (tmp_path / "robot.yaml").read_text()


def test_a_page_for_a_colleague_needs_nothing_else() -> None:
    page = host.scene_html(open_session(replace(THESIS, name="A & B")), {})
    assert "<title>A &amp; B, tubeopt</title>" in page
    assert page.lstrip().lower().startswith("<!doctype html")
    assert "__VISER_EMBED_DATA__" in page


def test_files_of_a_calibrated_robot_tell_what_its_drives_read(tmp_path: Path) -> None:
    from tubeopt.runs.inverse_study import load_joints

    drives = replace(Calibration.none(3), rotation_offsets=(0.1, 0.0, -0.2))
    robot = replace(THESIS, calibration=drives)
    session, _ = move_joint(open_session(robot), 0, 1.0)
    current = session.equilibrium.rotations
    (tmp_path / "joints.yaml").write_text(host.joints_yaml(session))
    assert load_joints(tmp_path / "joints.yaml", robot)[0] == pytest.approx(current, abs=1e-9)
    report = load_joints(tmp_path / "joints.yaml", THESIS)[0]
    assert report == pytest.approx(current - np.array(drives.rotation_offsets), abs=1e-9)
    (tmp_path / "path.csv").write_text("rotation_1_deg,rotation_2_deg,rotation_3_deg\n0,0,0\n10,0,0\n")
    assert load_waypoints(tmp_path / "path.csv", robot).rotations[0] == pytest.approx(np.array(drives.rotation_offsets))
