"""The viewer's page in a real browser: what is read there is what the library says."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from tests.examples import CONFIGS, THESIS
from tubeopt import find_snap, forward_kinematics, load_robot
from tubeopt.runs.inverse_study import load_joints
from tubeopt.show.viewer import View
from tubeopt.show.viewer.view import load_waypoints

from .browser import Tab, served


def tip(*rotations_deg: float, translations_mm: tuple[float, ...] = (0.0, 0.0, 0.0), **options: Any) -> np.ndarray:
    return forward_kinematics(
        THESIS, np.radians(rotations_deg), np.array(translations_mm) / 1e3, **options
    ).tip_position


def test_turned_past_the_fold_and_back_the_robot_snaps_at_two_places(tab: Tab) -> None:
    """The slider follows the branch: 200 deg has one shape on the way forth and another one on the way back."""
    assert np.abs(tab.tip - tip(0, 0, 0)).max() < 1e-6
    tab.wait_for("message", "this tab has a robot of its own")
    snap = find_snap(THESIS, (np.zeros(3), None), (np.radians([360, 0, 0]), None))
    assert snap is not None
    forth = forward_kinematics(
        THESIS, np.radians([200, 0, 0]), start=forward_kinematics(THESIS, np.radians([90, 0, 0]))
    )
    tab.type("rotation of tube 1", 199.9)
    tab.page.get_by_role("slider").first.press("ArrowRight")
    tab.wait_for_tip(forth.tip_position)
    assert tab.read("state") == "stable"
    tab.type("rotation of tube 1", 214)
    tab.wait_for("state", "close to a snap")
    tab.type("rotation of tube 1", 216)
    event = tab.wait_for("event", "snap at")
    assert tab.wait_for("state", "snapped")
    assert "214.2224, 0.0000, 0.0000 deg" in event
    jump, energy = (float(event.split(before)[1].split()[0]) for before in ("jumped by ", "mm, "))
    assert jump == pytest.approx(snap.tip_jump * 1e3, abs=1e-4)
    assert energy == pytest.approx(snap.energy_released * 1e3, abs=1e-4)
    tab.type("rotation of tube 1", 200)
    back = forward_kinematics(THESIS, np.radians([200, 0, 0]), start=snap.after)
    tab.wait_for_tip(back.tip_position)
    assert np.linalg.norm(back.tip_position - forth.tip_position) > 0.05
    tab.press("All equilibria")
    assert (
        tab.wait_for("message", "2 other")
        == "2 other equilibria at these joint values: 1 stable (blue), 1 unstable (red)"
    )
    tab.press("Home")
    assert "145.7776" in tab.wait_for("event", "145.7776")
    tab.wait_for_tip(tip(0, 0, 0))


def test_another_robot_stands_beside_and_obstacles_are_loaded(tab: Tab) -> None:
    """The other robot snaps where it does alone; one of another number of tubes is refused, and the first one stays."""
    assert tab.page.title() == "thesis CTR, tubeopt"
    tab.tab("Layers")
    tab.upload("Put another robot beside (YAML)", CONFIGS / "example_equal_ends.yaml")
    tab.wait_for("message", "example_equal_ends.yaml: stands beside, at the same joint values")
    tab.upload("Put another robot beside (YAML)", CONFIGS / "two_tube.yaml")
    tab.wait_for("message", "two tubes has 2 tubes; it must have 3")
    tab.upload("Load bodies (YAML, mesh, image)", CONFIGS.parent / "obstacles" / "two_bodies.yaml")
    tab.wait_for("message", "two_bodies.yaml: obstacles, 2; the tip avoids them when you drag it")
    tab.tab("Joints")
    tab.type("rotation of tube 1", 90)
    tab.wait_for_tip(tip(90, 0, 0))


def test_bodies_are_cut_by_a_plane(tab: Tab) -> None:
    """The ball of 20 mm at x = 60 mm is cut through its middle, and a plane that was dragged beside it cuts nothing."""
    tab.tab("Layers")
    tab.page.get_by_label("cut bodies across").click()
    tab.page.get_by_role("option", name="x").click()
    assert "cut across x at 0 mm: 0.00 cm2 of bodies" in tab.wait_for("message", "cut across x at 0 mm")
    tab.type("cut at (mm)", 60)
    assert "cut across x at 60 mm: 12.5" in tab.wait_for("message", "cut across x at 60 mm")
    tab.page.get_by_label("cut bodies across").click()
    tab.page.get_by_role("option", name="a direction").click()
    tab.wait_for("message", "cut across 0.707, 0.707, 0 at 60 mm: ")


def test_exact_values_and_what_is_refused(tab: Tab) -> None:
    """Number boxes act at their button; a bad number is refused in a sentence, and the robot stays."""
    tab.page.get_by_text("Exact values").click()
    tab.type("rotation 1 (deg)", 999)
    tab.press("Move there")
    assert tab.wait_for("message", "must be") == "rotation of tube 1 is 999 deg; it must be from -360 to 360 deg"
    assert tab.sees("message")
    assert not tab.sees("readout")  # it was scrolled out of the window on the way to the button
    assert np.abs(tab.tip - tip(0, 0, 0)).max() < 1e-6
    for k, degrees in enumerate(("0", "57.29578", "114.591559"), start=1):
        tab.type(f"rotation {k} (deg)", degrees)
    tab.type("translation 1 (mm)", -10)
    tab.press("Move there")
    tab.wait_for_tip(tip(0, 57.29578, 114.591559, translations_mm=(-10, 0, 0)))
    tab.type("translation 1 (mm)", -100)
    tab.press("Move there")
    assert tab.wait_for("message", "order") == "the tubes would be out of order: tube 1 ending where tube 2 ends"
    tab.wait_for_box("rotation of tube 2", "57.3")


def test_tabs_have_robots_of_their_own_and_a_closed_one_is_forgotten(context: Any, address: str, tab: Tab) -> None:
    other = Tab(context, address)
    other.type("rotation of tube 1", 90)
    other.wait_for_tip(tip(90, 0, 0))
    assert np.abs(tab.tip - tip(0, 0, 0)).max() < 1e-6
    other.page.close()
    tab.page.bring_to_front()
    tab.type("rotation of tube 2", -40)
    tab.wait_for_tip(tip(0, -40, 0))


def test_the_tip_is_led_and_stops_at_its_limit(tab: Tab) -> None:
    tab.tab("Tip")
    for axis, value in zip("xyz", (20, -80, 165), strict=True):
        tab.type(f"target {axis} (mm)", value)
    tab.press("Move the tip there")
    tab.wait_for_tip(np.array([0.02, -0.08, 0.165]))
    tab.type("target z (mm)", 600)
    tab.press("Move the tip there")
    message = tab.wait_for("message", "short of the target")
    assert "at its end" in message or "margin" in message or "touching" in message


def test_the_hand_takes_over_what_is_played(tab: Tab) -> None:
    tab.tab("Play")
    tab.press("Play / pause")
    tab.wait_for_more("time (s)", 0.1)
    tab.tab("Joints")
    tab.type("rotation of tube 3", 45)
    tab.wait_until_at_rest()
    assert tab.box("rotation of tube 3").input_value() == "45"


def test_direction_and_separation_tell_where_an_eccentric_robot_is(context: Any) -> None:
    robot = load_robot(CONFIGS / "thesis_etr.yaml")
    with served(View(robot)) as url:
        tab = Tab(context, url)
        tab.type("separation (deg)", 60)
        tab.wait_for_tip(forward_kinematics(robot, np.radians([0, 60, -60])).tip_position)
        tab.type("direction (deg)", 350)
        refused = "rotation of tube 2 is 410 deg; it must be from -360 to 360 deg"
        assert refused in tab.wait_for("message", "rotation of tube 2 is")
        tab.wait_for_box("direction (deg)", "0")
        tab.wait_for_box("separation (deg)", "60")
        tab.press("Home")
        tab.wait_for_box("separation (deg)", "0")
        tab.page.close()


def test_a_trajectory_is_scrubbed_and_a_design_changed_and_all_of_it_saved(
    tab: Tab, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is saved is what the library reads back."""
    monkeypatch.setattr("tubeopt.show.viewer.overlays.STEP", np.radians(90.0))
    tab.tab("Play")
    tab.type("time (s)", 1)
    tab.wait_for_tip(tip(180, 0, 0, start=forward_kinematics(THESIS, np.radians([100, 0, 0]))))
    tab.type("time (s)", 3)
    wound = forward_kinematics(THESIS, np.radians([260, 0, 0]))
    tab.wait_for_tip(tip(180, 0, 0, start=wound))
    tab.box("record what the robot passes").click()
    tab.tab("Joints")
    tab.type("rotation of tube 1", 200)
    tab.wait_for_tip(tip(200, 0, 0, start=wound))
    tab.tab("Save")
    (tmp_path / "way.csv").write_bytes(tab.download("Recorded trajectory (CSV)"))
    path = load_waypoints(tmp_path / "way.csv", THESIS)
    assert np.degrees(path.rotations[:, 0]) == pytest.approx([180, 200], abs=1e-9)
    (tmp_path / "joints.yaml").write_bytes(tab.download("Joint values (YAML)"))
    assert load_joints(tmp_path / "joints.yaml", THESIS)[0] == pytest.approx(np.radians([200, 0, 0]))
    tab.draw(True)
    with Image.open(io.BytesIO(tab.download("Picture (PNG)"))) as picture:
        assert len(picture.convert("RGB").getcolors(1 << 24) or []) > 100
    tab.draw(False)
    tab.tab("Layers")
    tab.box("volume swept by the trajectory").click()
    tab.wait_for("message", "the arm sweeps")
    tab.tab("Design")
    tab.type("tube 1: curvature (1/m)", 4)
    tab.wait_for("certificate", "cannot snap")
    (tmp_path / "robot.yaml").write_bytes(tab.download("Save robot as YAML"))
    changed = load_robot(tmp_path / "robot.yaml")
    assert changed.tubes[0].curvature == 4.0
    tab.tab("Layers")
    assert not tab.box("volume swept by the trajectory").is_checked()
    tab.wait_for_tip(forward_kinematics(changed, np.radians([200, 0, 0])).tip_position)


def test_a_change_is_taken_back_and_the_target_begins_at_the_tip(tab: Tab) -> None:
    assert tab.page.get_by_text(THESIS.name).count()
    assert tab.read("tubes").split() == ["●", "tube", "1", "●", "tube", "2", "●", "tube", "3"]
    tab.tab("Tip")
    for axis, value in zip("xyz", tip(0, 0, 0) * 1e3, strict=True):
        assert abs(float(tab.box(f"target {axis} (mm)").input_value()) - value) < 1e-3
    tab.tab("Joints")
    tab.type("rotation of tube 1", 60)
    tab.wait_for_tip(tip(60, 0, 0))
    tab.type("rotation of tube 2", -40)
    tab.wait_for_tip(tip(60, -40, 0))
    tab.press("Undo")
    tab.wait_for_tip(tip(60, 0, 0))
    tab.press("Undo")
    tab.wait_for_tip(tip(0, 0, 0))
    tab.press("Undo")
    assert tab.wait_for("message", "nothing") == "nothing was changed"


def test_a_small_window_keeps_the_arm_and_what_is_refused_in_sight(tab: Tab) -> None:
    """The panel stands below the scene and gives it its room when it is closed; a number may have an exponent."""
    tab.page.set_viewport_size({"width": 420, "height": 760})
    tab.page.get_by_text("Exact values").click()
    tab.type("rotation 1 (deg)", "0.6e2")
    tab.press("Move there")
    tab.wait_for_tip(tip(60, 0, 0))
    tab.type("rotation 1 (deg)", "1e3")
    tab.press("Move there")
    tab.wait_for("message", "must be")
    assert tab.sees("message")
    assert tab.page.evaluate("document.documentElement.scrollWidth") == 420
    higher = "least => document.querySelector('[data-dock-root]').getBoundingClientRect().height > least"
    assert tab.page.evaluate(higher, 0.4 * 760)
    assert not tab.page.evaluate(higher, 0.6 * 760)
    tab.page.get_by_text(THESIS.name).first.click()
    tab.page.wait_for_function(higher, arg=0.9 * 760, polling=100)
