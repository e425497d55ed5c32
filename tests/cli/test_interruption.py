"""Ctrl-C: every command ends soon, says what is kept, and ends with 130."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.command_line import COLOUR, ROOT, THESIS

RIG = "configs/rigs/thesis_calcium_silicate.yaml"

COMMANDS = {
    "IPOPT ends its solve and the program goes on": (("heat", "plan", RIG), "nothing was saved"),
    "a compiled loop in threads": (("workspace", THESIS, "--samples", "100000000"), "nothing was saved"),
}


@pytest.mark.parametrize("name", COMMANDS)
def test_ctrl_c_ends_a_command_within_two_seconds(name: str) -> None:
    arguments, kept = COMMANDS[name]
    took, code, _, err = interrupted([*arguments])
    assert code == 130
    assert err.splitlines()[-1] == f"error: interrupted; {kept}"  # CasADi has a line of its own before
    assert took < 2.5  # and what this busy machine adds


def test_what_is_kept_is_said_as_json_too(tmp_path: Path) -> None:
    flags = ["--samples", "100000000", "--out", str(tmp_path / "out"), "--json"]
    _, code, out, err = interrupted(["workspace", THESIS, *flags])
    assert (code, err) == (130, "")
    (message,) = json.loads(out)["error"]["messages"]
    assert message == f"interrupted; the samples so far are in {tmp_path / 'out'}; the same command goes on from there"
    assert list((tmp_path / "out").iterdir())


def interrupted(arguments: list[str]) -> tuple[float, int, str, str]:
    """Seconds from Ctrl-C to the end of a command that had been at work for a while, its code, and what it printed."""
    command = [sys.executable, "-m", "tubeopt", *arguments]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, cwd=ROOT, text=True, **pipes) as process:  # type: ignore[call-overload]
        time.sleep(2.0)
        assert process.poll() is None
        began = time.monotonic()
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=30)
        return time.monotonic() - began, process.returncode, out, COLOUR.sub("", err)
