"""A load on the robot under somebody's hands: what is shown is what the library says of that load."""

from __future__ import annotations

import re
from functools import cache

import numpy as np
import pytest

from tests.examples import THESIS
from tubeopt import InputError, Load, find_load_limit, follow, forward_kinematics
from tubeopt.show.viewer import View
from tubeopt.show.viewer.session import (
    DIRECTIONS,
    Session,
    equilibrium_load_text,
    go_home,
    head_of,
    load_effect,
    move_joint,
    newtons_per_metre,
    open_session,
    other_equilibria,
    push_on,
    redesign,
)
from tubeopt.show.viewer.teleoperation import drag_tip
from tubeopt.stability.following import push

from .browser import Tab

NUMBER = re.compile(r"-?\d+(?:\.\d+)?")
TURNED = np.radians([200.0, 0.0, 0.0])


def numbers(words: str) -> list[float]:
    return [float(each) for each in NUMBER.findall(words)]


@cache
def turned() -> Session:
    session, _ = move_joint(open_session(THESIS), 0, TURNED[0])
    return session


@cache
def gently_pushed() -> Session:
    return push_on(turned(), Load((-0.01, 0, 0)))


def test_a_growing_force_snaps_the_robot_where_its_limit_is() -> None:
    session = turned()
    limit = find_load_limit(THESIS, TURNED, None, Load((-0.01, 0, 0)), equilibrium=session.equilibrium)
    assert limit is not None
    gentle = gently_pushed()
    assert not gentle.last
    assert gentle.equilibrium.margin < session.equilibrium.margin
    past = push_on(gentle, Load((-0.03, 0, 0)))
    (snap,) = past.last
    assert snap.before.load is not None
    assert -100 * snap.before.load.force[0] == pytest.approx(limit.factor, rel=1e-8)
    assert snap.after.tip_position == pytest.approx(limit.after.tip_position, abs=1e-8)
    assert past.verdict == "snapped"
    assert "force -21.846" in past.log[-1].text
    back = push_on(past, Load())
    assert back.equilibrium.load is None
    assert np.linalg.norm(back.equilibrium.tip_position - session.equilibrium.tip_position) > 0.05


def test_a_view_begins_under_the_load_that_is_given() -> None:
    load = Load((-0.01, 0.0, 0.0), gravity=(0.0, 3.0, -9.0))
    start_time = View(THESIS, rotations=TURNED, load=load).session().equilibrium
    assert start_time.load == load
    same = forward_kinematics(THESIS, TURNED, load=load)
    assert start_time.tip_position == pytest.approx(same.tip_position, abs=1e-9)
    with pytest.raises(InputError, match="more than a force on the tip and gravity"):
        View(THESIS, load=Load(moment=(1e-3, 0.0, 0.0))).session()


def test_joints_move_under_the_load() -> None:
    load = Load((0.02, 0.0, 0.0), gravity=DIRECTIONS["along -y"])
    session = push_on(open_session(THESIS), load)
    moved, _ = move_joint(session, 1, 0.5)
    alone = follow(THESIS, [np.zeros(3), [0.0, 0.5, 0.0]], load=load).equilibria[-1]
    assert moved.equilibrium.load == load
    assert moved.equilibrium.tip_position == pytest.approx(alone.tip_position, abs=1e-10)
    assert go_home(moved).equilibrium.tip_position == pytest.approx(session.equilibrium.tip_position, abs=1e-10)
    for refused in (lambda: drag_tip(moved, [0, 0, 0.2]), lambda: redesign(moved, THESIS)):
        with pytest.raises(InputError, match="without load only"):
            refused()
    assert all(other.load == load for other in other_equilibria(moved))


def test_what_a_load_does_in_a_sentence() -> None:
    current = gently_pushed().equilibrium
    result = load_effect(current)
    assert result is not None
    deflection, limit = result
    assert limit is not None
    assert limit.factor == pytest.approx(2.1846, abs=1e-4)
    expected = f"10.00 mN: tip moved by {1e3 * deflection:.4f} mm, snaps at 2.1846 times as much"
    assert equilibrium_load_text(current) == expected
    plain = turned().equilibrium
    assert equilibrium_load_text(plain) == ""
    far = push(plain, Load((-0.03, 0, 0))).equilibria[-1]
    assert equilibrium_load_text(far).startswith("30.00 mN: t")
    scale = newtons_per_metre(plain)
    assert scale * (head_of(current, scale) - current.tip_position) == pytest.approx([-0.01, 0, 0])


def test_a_force_that_is_typed_and_a_snap_by_it(tab: Tab) -> None:
    """As `test_a_growing_force_snaps_the_robot_where_its_limit_is`, by hand."""
    start = turned().equilibrium
    gentle = gently_pushed().equilibrium
    tab.type("rotation of tube 1", 200)
    tab.wait_for_tip(start.tip_position)
    tab.tab("Load")
    tab.page.get_by_text("drag a force").click()
    tab.type("force x (mN)", -10)
    tab.press("Put the load on")
    tab.wait_for_tip(gentle.tip_position)
    report, text = tab.wait_for("load-limit", "snaps at"), equilibrium_load_text(gentle)
    assert NUMBER.sub("", report) == NUMBER.sub("", text)
    assert numbers(report) == pytest.approx(numbers(text), abs=1.01e-4)
    assert float(tab.read("margin")) == pytest.approx(gentle.margin, abs=1.01e-4)
    tab.type("force x (mN)", -30)
    tab.press("Put the load on")
    path = push(gentle, Load((-0.03, 0, 0)))
    tab.wait_for_tip(path.equilibria[-1].tip_position)
    assert path.snaps
    assert "force -21.846" in tab.wait_for("event", "snap at")
    tab.press("Take the load off")
    tab.wait_for_tip(push(path.equilibria[-1], Load()).equilibria[-1].tip_position)
    assert "wrong" not in tab.read("message")
