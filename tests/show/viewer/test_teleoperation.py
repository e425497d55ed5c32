"""The tip led by keys, gamepads and 3-D mice: what the page makes of them, what the server does, what it refuses."""

from __future__ import annotations

import asyncio
import json
import shutil
import subprocess
from collections.abc import AsyncIterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.examples import THESIS
from tubeopt import InputError, Load
from tubeopt.show.viewer import teleoperation
from tubeopt.show.viewer.session import Session, open_session, push_on, record
from tubeopt.show.viewer.teleoperation import MAX_STEP, SPEED, Channel, TipServo, read
from tubeopt.show.viewer.view import load_waypoints, make_playback, recorded
from tubeopt.typing import Array

from .browser import Tab

SCRIPT = Path(teleoperation.__file__).with_name("hand.js")
SOME = ([0.0, 1.0, 2.0], [-0.05, -0.03, -0.02])


def pad(name: str, *axes: float) -> dict[str, Any]:
    return {"id": name, "axes": axes}


@pytest.mark.skipif(shutil.which("node") is None, reason="NOT TESTED: the page's script needs Node")
def test_keys_sticks_and_caps_mean_a_velocity() -> None:
    cases: list[tuple[list[str], list[Any], list[float]]] = [
        ([], [], [0, 0, 0]),
        (["KeyL"], [], [1, 0, 0]),
        (["KeyI", "KeyK"], [], [0, 0, 0]),
        (["KeyU", "ShiftLeft"], [], [0, 0, 0.2]),
        (["KeyL", "KeyI"], [], [0.5**0.5, 0.5**0.5, 0]),
        (["KeyW"], [], [0, 0, 0]),  # the camera's
        ([], [None, pad("Xbox", 0.1, -0.1, 0, 0.11)], [0, 0, 0]),  # let go
        ([], [pad("Xbox", 0, -1, 0, 0)], [0, 1, 0]),  # left stick pushed
        ([], [pad("Xbox", 0, 0, 0, -0.56)], [0, 0, 0.5]),  # right stick pushed half way
        ([], [pad("3Dconnexion SpaceMouse", 0, 0, 1, 0, 0, 0)], [0, 0, -1]),  # pressed down
        ([], [pad("Wheel", 1)], [1, 0, 0]),
    ]
    program = (
        f"const {{ motion }} = require({json.dumps(str(SCRIPT))});"
        f"const cases = {json.dumps([case[:2] for case in cases])};"
        "console.log(JSON.stringify(cases.map(([keys, pads]) => motion(new Set(keys), pads))));"
    )
    done = subprocess.run(["node", "-e", program], capture_output=True, text=True, check=True, timeout=120)
    np.testing.assert_allclose(json.loads(done.stdout), [case[2] for case in cases], atol=1e-12)


def attend(channel: Channel, messages: AsyncIterator[str | bytes]) -> None:
    """In a thread of its own: in this one the browser's tests keep a loop running."""
    with ThreadPoolExecutor(1) as pool:
        pool.submit(asyncio.run, channel.receive(messages)).result()


def test_messages_lead_the_robot_whose_word_they_have_and_the_rest_is_left_out() -> None:
    channel, report = Channel(), list[Array]()
    word = channel.register(report.append)
    good = json.dumps({"tab": word, "velocity": [0, 3, 4]})
    bad: list[str | bytes] = [
        "",
        "[]",
        "{",
        json.dumps({"tab": word}),
        json.dumps({"tab": [word], "velocity": [1, 0, 0]}),
        b"\xff",
    ]
    bad += [json.dumps({"tab": word, "velocity": v}) for v in ([1, 0], "x", [1, None, 0], [1, 0, float("nan")])]

    async def messages() -> AsyncIterator[str | bytes]:
        for each in (*bad, json.dumps({"tab": "guessed", "velocity": [1, 0, 0]}), good):
            yield each

    attend(channel, messages())
    assert len(report) == 1
    np.testing.assert_allclose(report[0], [0, 0.6, 0.8])  # no faster than the greatest speed
    for each in bad:
        with pytest.raises(InputError):
            read(each)
    channel.remove(word)
    attend(channel, messages())
    assert len(report) == 1


def led(session: Session, velocity: tuple[float, float, float], messages: int, margin: float) -> tuple[Session, str]:
    own, text = TipServo(), ""
    for _ in range(messages):
        session, text = own.move(session, np.array(velocity), margin)
    return session, text


def test_a_message_moves_the_tip_for_the_time_since_the_last_one(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter([0.0, 0.05, 0.1, 60.0, 60.05])
    monkeypatch.setattr("tubeopt.show.viewer.teleoperation.time.monotonic", lambda: next(clock))
    session = start_time = record(open_session(THESIS, *SOME), True)
    own, path = TipServo(), []
    for _ in range(5):
        before = session.equilibrium.tip_position
        session, text = own.move(session, np.array([0.5, 0.0, 0.0]), 0.05)
        assert text in ("", "a joint moves as fast as it may")
        path.append(session.equilibrium.tip_position - before)
    # The first and the fourth, after a silence of a minute, are of the longest time.
    expected = 0.5 * SPEED * np.array([MAX_STEP, 0.05, 0.05, MAX_STEP, 0.05])
    np.testing.assert_allclose([step[0] for step in path], expected, rtol=0.05)
    assert np.abs(np.array(path)[:, 1:]).max() < 0.1 * expected[1]
    # What was recorded on the way leads there again.
    again = make_playback(THESIS, recorded(session)).path.equilibria
    np.testing.assert_allclose(again[0].tip_position, start_time.equilibrium.tip_position, atol=1e-9)
    np.testing.assert_allclose(again[-1].tip_position, session.equilibrium.tip_position, atol=1e-9)


def test_the_tip_stops_at_the_floor_of_the_margin_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    times = iter(np.arange(0.0, 1e3, MAX_STEP))
    monkeypatch.setattr("tubeopt.show.viewer.teleoperation.time.monotonic", lambda: next(times))
    session, text = led(open_session(THESIS, [np.radians(200), 0, 0]), (1.0, 0.0, 0.0), 1, 0.05)
    floor = session.equilibrium.margin - 0.05
    session, text = led(session, (-0.3, -1.0, 0.0), 40, floor)
    session, back = led(session, (0.3, 1.0, 0.0), 40, floor)
    assert "margin is at its lower limit" in text + back
    assert session.equilibrium.margin >= floor
    assert not session.log


def test_it_leads_without_load_and_replays_what_was_recorded_only() -> None:
    session = open_session(THESIS, *SOME)
    with pytest.raises(InputError, match="moved without load"):
        TipServo().move(push_on(session, Load((0.01, 0.0, 0.0))), np.array([1.0, 0, 0]), 0.05)
    for each in (session, record(session, True)):
        with pytest.raises(InputError, match="nothing was recorded"):
            recorded(each)


def _led_to(tab: Tab, path: Path) -> Array:
    """Where the tip was led in the end, of the recording that the page saves: it is drawn late on a busy machine."""
    saved = None
    for _ in range(20):
        before, saved = saved, tab.download("Recorded trajectory (CSV)")
        if saved == before:
            break
        tab.page.wait_for_timeout(500)
    path.write_bytes(saved or b"")
    tip: Array = make_playback(THESIS, load_waypoints(path, THESIS)).path.equilibria[-1].tip_position
    return tip


def test_keys_lead_the_tip_on_the_page_and_the_recording_is_played_again(tab: Tab, tmp_path: Path) -> None:
    start = tab.tip
    tab.tab("Play")
    tab.press("Replay the recording")
    tab.wait_for("message", "nothing was recorded")
    tab.box("record what the robot passes").click()
    tab.page.keyboard.press("KeyL")  # not ticked yet
    tab.tab("Tip")
    tab.box("move the tip by keys").click()
    tab.wait_for("hand", "along x, y, z")
    assert np.array_equal(tab.tip, start)
    tab.page.get_by_text("What happened").focus()
    tab.page.keyboard.down("KeyU")
    tab.page.wait_for_function(
        "z => Math.abs(parseFloat(document.querySelector('[data-testid=tip]').innerText.split(',')[2]) - z) > 3",
        arg=float(start[2] * 1e3),
        polling=50,
    )
    tab.page.keyboard.up("KeyU")
    tab.tab("Save")
    end = _led_to(tab, tmp_path / "led.csv")
    tab.wait_for_tip(end)
    assert end[2] > start[2] + 2e-3
    assert np.abs(end - start)[:2].max() < 0.2 * (end - start)[2]
    tab.tab("Play")
    tab.press("Replay the recording")
    tab.wait_for_more("time (s)", 0.1)
    tab.wait_for_tip(end)
    tab.tab("Layers")
    tab.press("From x")
    assert "margin: 0, a snap, to 1" in tab.read("legend")
