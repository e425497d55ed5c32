"""A robot under somebody's hands, without a browser: what it does follows from where it was."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.examples import CONFIGS, CRL, THESIS, TWO_TUBE
from tubeopt import (
    ConcentricRobot,
    InputError,
    SolveError,
    Tube,
    find_equilibria,
    find_snap,
    forward_kinematics,
    load_robot,
    snap_free_certificate,
)
from tubeopt.bodies.obstacles import Sphere
from tubeopt.show.viewer.panel import knobs, with_knob
from tubeopt.show.viewer.session import (
    Session,
    allowed,
    clear_trail,
    go_home,
    move,
    move_joint,
    open_session,
    other_equilibria,
    record,
    redesign,
    space_of,
)
from tubeopt.show.viewer.teleoperation import drag_tip
from tubeopt.typing import Array

ETR = load_robot(CONFIGS / "thesis_etr.yaml")
SEGMENTS = load_robot(CONFIGS / "example_three_segment_etr.yaml")


def turned(session: Session, *degrees: float) -> Session:
    """Tube 1 turned to one angle after another."""
    for angle in degrees:
        session, _ = move_joint(session, 0, np.radians(angle))
    return session


def test_past_the_fold_the_robot_snaps_and_history_decides_where_it_is() -> None:
    home = open_session(THESIS)
    forth = turned(home, 100, 200)
    assert not forth.log
    past = turned(forth, 213.9, 230)
    snap = find_snap(THESIS, (np.zeros(3), None), (np.radians([360, 0, 0]), None))
    assert snap is not None
    assert [event.snap is not None for event in past.log] == [True]
    observed = past.last[0]
    assert observed.rotations == pytest.approx(snap.rotations, abs=1e-9)
    assert (observed.tip_jump, observed.energy_released) == pytest.approx(
        (snap.tip_jump, snap.energy_released), rel=1e-9
    )
    back = turned(past, 200)
    assert (past.verdict, back.verdict) == ("snapped", "stable")
    assert np.linalg.norm(back.equilibrium.tip_position - forth.equilibrium.tip_position) > 0.05
    again = turned(back, 140)
    assert again.last[0].rotations[0] == pytest.approx(2 * np.pi - snap.rotations[0], abs=1e-8)
    assert go_home(again).equilibrium.tip_position == pytest.approx(home.equilibrium.tip_position, abs=1e-9)


def test_one_way_in_many_steps_or_in_one_is_the_same() -> None:
    steps, leap = turned(open_session(THESIS), *range(10, 300, 10)), turned(open_session(THESIS), 290)
    assert steps.equilibrium.tip_position == pytest.approx(leap.equilibrium.tip_position, abs=1e-9)
    assert steps.log[0].text == leap.log[0].text
    assert len(steps.trail) == pytest.approx(len(leap.trail), abs=15)  # type: ignore[arg-type]


def test_a_slider_does_not_step_over_a_narrow_fold() -> None:
    """Hysteresis 0.4 deg wide: one event of a slider is much longer than that, from wherever before the fold it starts.

    On both sides Newton's method is at ease, and the branches are nearer to each other than a step.
    """
    tubes = (
        Tube(3e-3, 2.2e-3, straight_length=0.03, curved_length=0.04, curvature=40.0),
        Tube(4e-3, 3.4e-3, straight_length=0.01, curved_length=0.035, curvature=36.0),
    )
    home = move(open_session(ConcentricRobot(tubes)), (0.0, 0.0), (0.03, 0.01))
    path = [(np.radians([angle, 0.0]), home.equilibrium.translations) for angle in (0, 360)]
    snap = find_snap(home.robot, path[0], path[1])
    assert snap is not None
    fold = np.degrees(snap.rotations[0])
    assert 180.1 < fold < 180.3
    for before, after in [(0.02, 2), (6, 5), (fold - 180, 15)]:
        near = turned(home, fold - before)
        assert not near.log
        past = turned(near, fold + after)
        assert len(past.log) == 1
        assert past.last[0].rotations == pytest.approx(snap.rotations, abs=1e-8)
        with pytest.raises(SolveError, match="snaps"):
            forward_kinematics(
                home.robot, past.equilibrium.rotations, past.equilibrium.translations, start=near.equilibrium
            )


def test_words_of_the_state() -> None:
    assert turned(open_session(THESIS), 150).verdict == "stable"
    close = turned(open_session(THESIS), 214)
    assert (close.verdict, close.equilibrium.margin > 0) == ("close to a snap", True)
    text = turned(close, 215).log[0].text
    assert text == (
        "snap at rotations 214.2224, 0.0000, 0.0000 deg: the tip jumped by 97.9742 mm, 5.1503 mJ were released"
    )


def test_other_equilibria_are_all_but_the_own_one() -> None:
    session = turned(open_session(THESIS), 200)
    everything = find_equilibria(THESIS, np.radians([200, 0, 0]))
    others = other_equilibria(session)
    assert len(others) == len(everything) - 1 == 2
    own = session.equilibrium.tip_rotations
    assert min(np.abs(each.tip_rotations - own).max() for each in others) > 0.5
    assert other_equilibria(open_session(THESIS)) == []


def test_joints_stop_where_tubes_touch_and_at_their_ends() -> None:
    session = open_session(THESIS)
    moved, text = move_joint(session, 3, -0.2)
    assert moved.equilibrium.translations[0] == pytest.approx(-0.05)
    assert text == "translation of tube 1 is stopped: tube 1 ending where tube 2 ends"
    moved, text = move_joint(session, 0, 7.0)
    assert np.degrees(moved.equilibrium.rotations[0]) == pytest.approx(360)
    assert text == "rotation of tube 1 is stopped: end of its range"
    assert allowed(THESIS, session.q, 5) == (
        (pytest.approx(-0.05), "carriages of tube 2 and tube 3 touching"),
        (pytest.approx(0.05), "tube 2 ending where tube 3 ends"),
    )


@pytest.mark.parametrize(
    ("rotations", "translations", "message"),
    [
        ((7, 0, 0), (0, 0, 0), "rotation of tube 1 is 401.07 deg; it must be from -360 to 360 deg"),
        ((0, 0, 0), (-0.06, 0, 0), "the tubes would be out of order: tube 1 ending where tube 2 ends"),
        ((0, 0, np.nan), (0, 0, 0), "rotations is [0.0, 0.0, nan]; every number must be finite"),
        ((0, 0), (0, 0, 0), "rotations has 2 numbers; it must be 3 numbers (one per tube)"),
    ],
)
def test_bad_joint_values_are_refused(rotations: Array, translations: Array, message: str) -> None:
    session = open_session(THESIS)
    with pytest.raises(InputError) as refusal:
        move(session, rotations, translations)
    assert str(refusal.value) == message


def test_joint_values_out_of_order_are_where_it_begins_and_get_no_worse() -> None:
    session = open_session(CRL, np.zeros(3), np.zeros(3))
    assert session.equilibrium.tip_position == pytest.approx(
        forward_kinematics(CRL, np.zeros(3), np.zeros(3)).tip_position
    )
    assert not space_of(CRL).admissible(session.q)
    assert turned(session, 30).equilibrium.rotations[0] == pytest.approx(np.radians(30))


def test_tubes_on_one_carriage_are_one_joint() -> None:
    assert space_of(ETR).names[3:] == ["translation of tubes 1 to 3"]
    assert len(space_of(SEGMENTS).names) == 12
    session = open_session(ETR)
    moved, _ = move_joint(session, 3, -0.02)
    assert moved.equilibrium.translations == pytest.approx([-0.02] * 3)
    with pytest.raises(InputError, match="of tubes 1, 2 and 3 are 0 mm, -10 mm and 0 mm; they must be equal"):
        move(session, np.zeros(3), [0.0, -0.01, 0.0])


def test_two_tubes_with_lengths_in_step_move_together() -> None:
    assert space_of(TWO_TUBE).names[2:] == ["translation of tubes 1 to 2"]
    assert turned(open_session(TWO_TUBE), 30).equilibrium.margin > 0


def test_recording_holds_every_place() -> None:
    session = turned(record(open_session(THESIS), True), 10, 20, 30)
    assert session.recording is not None
    assert np.degrees(np.array(session.recording)[:, 0]) == pytest.approx([0, 10, 20, 30])
    assert len(clear_trail(session).trail) == 1  # type: ignore[arg-type]
    assert record(session, False).recording is None


def test_a_recording_of_other_tubes_begins_anew() -> None:
    session = turned(record(open_session(THESIS), True), 30)
    changed = turned(redesign(session, with_knob(THESIS, knobs(THESIS)[0], 9.0)), 40)
    assert changed.recording is not None
    assert np.degrees(np.array(changed.recording)[[0, -1], 0]) == pytest.approx([30, 40])
    assert changed.recorded_from is not None
    assert changed.recorded_from.robot == changed.robot
    assert "the recording begins anew" in changed.log[-1].text


def test_the_way_on_which_the_tip_was_led_is_recorded() -> None:
    """In joint values it is no straight line, so that both ends would not tell how the robot got there."""
    session = record(open_session(THESIS), True)
    start, target = session.equilibrium.tip_position, np.array([0.05, -0.06, 0.2])
    guided, text = drag_tip(session, target)
    assert not text
    recording = guided.recording
    assert recording is not None
    assert len(recording) > 4
    for row in recording[1:]:
        tip = forward_kinematics(THESIS, row[:3], row[3:]).tip_position
        fraction = float((tip - start) @ (target - start) / ((target - start) @ (target - start)))
        assert tip == pytest.approx(start + fraction * (target - start), abs=2e-6)


# --- the tip ---------------------------------------------------------------------------------------------------------


def test_the_tip_follows_the_hand() -> None:
    session = turned(open_session(THESIS), 60)
    target = session.equilibrium.tip_position + np.array([0.01, 0.01, 0.005])
    guided, text = drag_tip(session, target)
    assert not text
    current = guided.equilibrium
    solved = forward_kinematics(THESIS, current.rotations, current.translations, start=current)
    assert solved.tip_position == pytest.approx(target, abs=1e-6)


def test_the_tip_stops_at_the_margin_and_says_so() -> None:
    """Pulled across to where only a snap would take it, with little to bend but the inner tube's rotation."""
    fixed = replace(THESIS.limits, translations=((0.0, 0.0),) * 3)
    session = turned(open_session(replace(THESIS, joint_limits=fixed)), 150)
    goal = find_equilibria(THESIS, np.radians([230, 0, 0]))[0].tip_position
    guided, text = drag_tip(session, goal, min_margin=0.9)
    assert guided.equilibrium.margin >= 0.9 - 1e-6
    assert not guided.last
    # Around the snap it comes close to the target. How close after so few steps, round-off of the processor decides.
    short = float(np.linalg.norm(goal - guided.equilibrium.tip_position))
    assert short < 1e-3 or "short of the target: margin at its bound (0.9)" in text


def test_the_tip_stops_out_of_reach_and_at_obstacles() -> None:
    session = open_session(THESIS)
    beside = Sphere((0.06, 0.0, 0.1), 0.02)  # at times no part of the arm is near it
    assert not drag_tip(session, [0.02, -0.08, 0.165], obstacles=[beside])[1]
    far, text = drag_tip(session, [0.0, 0.0, 1.0])
    error = np.linalg.norm(far.equilibrium.tip_position - [0.0, 0.0, 1.0])
    assert error > 0.3
    assert text.startswith(f"the tip stops {error * 1e3:.2f} mm short of the target: ")
    assert "at its end" in text or "touching" in text
    ball = Sphere((0.0, -0.13, 0.165), 0.03)
    stopped, text = drag_tip(session, [0.0, -0.13, 0.165], obstacles=[ball])
    assert text
    clear = ball.signed_distance(stopped.equilibrium.tip_position)
    assert clear > 0


# --- the design ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("robot", [THESIS, ETR, SEGMENTS], ids=lambda robot: robot.name)
def test_knobs_change_one_dimension_of_one_tube(robot) -> None:  # type: ignore[no-untyped-def]
    for knob in knobs(robot):
        value = knob.shown(robot)
        assert with_knob(robot, knob, value) == robot or knob.field != "curvature"
        if knob.field == "curvature":
            assert knob.shown(with_knob(robot, knob, 0.9 * value)) == pytest.approx(0.9 * value)
            with pytest.raises(InputError, match="it must be from"):
                with_knob(robot, knob, 3 * value)


def test_another_design_is_the_same_branch_or_says_that_it_is_not() -> None:
    session = turned(open_session(THESIS), 200)
    curvature = knobs(THESIS)[0]
    near = redesign(session, with_knob(THESIS, curvature, 9.9))
    assert not near.log
    assert near.equilibrium.tip_rotations == pytest.approx(session.equilibrium.tip_rotations, abs=0.1)
    fresh = forward_kinematics(
        near.robot, near.equilibrium.rotations, near.equilibrium.translations, start=near.equilibrium
    )
    assert fresh.tip_position == pytest.approx(near.equilibrium.tip_position, abs=1e-9)
    calm = redesign(session, with_knob(THESIS, curvature, 2.0))
    assert calm.log[-1].text.endswith("assembled afresh")
    assert snap_free_certificate(calm.robot) > 0


def test_a_shorter_tube_brings_its_joint_back_into_range() -> None:
    session, _ = move_joint(open_session(THESIS), 3, 0.15)
    shorter = next(knob for knob in knobs(THESIS) if (knob.index, knob.field) == (0, "straight_length"))
    robot = with_knob(THESIS, shorter, 160.0)
    assert robot.limits.translations[0][1] == pytest.approx(0.16)
    changed = redesign(session, robot)
    space = space_of(robot)
    assert space.admissible(space.join(changed.equilibrium.rotations, changed.equilibrium.translations))
