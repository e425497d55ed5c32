"""Ctrl-C: every command ends soon, says what is kept, and ends with 130."""

from __future__ import annotations

import contextlib
import importlib
import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.command_line import COLOUR, ROOT, THESIS
from tubeopt import __version__

RIG = "configs/rigs/thesis_calcium_silicate.yaml"

MOST = 4.0
"""Two seconds, and what a busy machine adds."""


def test_ctrl_c_ends_command_during_ipopt() -> None:
    with started(["--log", "debug", "heat", "plan", RIG]) as process:
        assert process.stderr is not None
        while not COLOUR.sub("", process.stderr.readline()).startswith(
            "tubeopt.cli: "
        ):  # which is told before the work
            assert process.poll() is None
        time.sleep(0.5)
        took, code, _, err = interrupted(process)
    assert code == 130
    assert err.splitlines()[-1] == "error: interrupted; nothing was saved"  # CasADi has a line of its own before
    assert took < MOST


def test_interrupted_compiled_loop_reports_saved_results_as_json(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with started(["workspace", THESIS, "--samples", "100000000", "--out", str(out), "--json"]) as process:
        while not (out.exists() and list(out.iterdir())):
            assert process.poll() is None
            time.sleep(0.1)
        took, code, printed, err = interrupted(process)
    assert (code, err) == (130, "")
    (message,) = json.loads(printed)["error"]["messages"]
    assert message == f"interrupted; finished samples are in {out}; the same command continues"
    assert took < MOST


BEFORE = """
class Interrupt:
    def find_spec(self, name, path, target=None):
        if name == "tubeopt.cli.app":
            sys.meta_path.remove(self)
            signal.raise_signal(signal.SIGINT)
sys.meta_path.insert(0, Interrupt())
"""
AFTER = "import atexit; atexit.register(signal.raise_signal, signal.SIGINT)"
INTO_ANOTHER = """
import tubeopt.cli.app as app
def solve(*arguments, **options):
    try:
        signal.raise_signal(signal.SIGINT)
    except KeyboardInterrupt:
        raise SystemError("a result with an exception set") from None
app.program = lambda: solve
"""


@pytest.mark.parametrize(
    ("when", "code", "printed", "told"),
    [
        (BEFORE, 130, "", "error: interrupted; nothing was saved\n"),
        (AFTER, 0, f"tubeopt {__version__}\n", ""),
        (INTO_ANOTHER, 130, "", "error: interrupted; nothing was saved\n"),
    ],
    ids=["while Python imports", "while Python leaves", "in compiled code that makes another error of it"],
)
def test_ctrl_c_is_delayed_until_it_can_be_reported(when: str, code: int, printed: str, told: str) -> None:
    hear = "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler)"
    script = f"{hear}\n{when}\nfrom tubeopt.cli import main\nmain(['--version'])"
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, COLOUR.sub("", done.stderr)) == (code, printed, told)


def started(arguments: list[str]) -> subprocess.Popen[str]:
    """A command in a process of its own, which hears Ctrl-C also where the tests run in the background."""
    command = [sys.executable, "-m", "tubeopt", *arguments]

    def hear() -> None:
        signal.signal(signal.SIGINT, signal.SIG_DFL)

    return subprocess.Popen(
        command, cwd=ROOT, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE, preexec_fn=hear
    )


def interrupted(process: subprocess.Popen[str]) -> tuple[float, int, str, str]:
    """Seconds from Ctrl-C to the end of a process, its code, and what it printed."""
    start_time = time.monotonic()
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=30)
    return time.monotonic() - start_time, process.returncode, out, COLOUR.sub("", err)


@contextlib.contextmanager
def served() -> Iterator[tuple[subprocess.Popen[str], dict[str, Any]]]:
    """A robot that is served, with its address and token, as soon as it tells them."""
    pytest.importorskip("websockets")
    with started(["serve", THESIS, "--port", "0", "--translations-mm=-50,-30,-20", "--json"]) as process:
        try:
            assert process.stdout is not None
            assert json.loads(process.stdout.readline())["event"] == "compiling"
            known = json.loads(process.stdout.readline())
            assert known["event"] == "serving"
            yield process, known
        finally:
            process.kill()


@pytest.mark.parametrize("delay", [0.0, 1e-3])
def test_ctrl_c_ends_a_server_from_its_ready_line_on(delay: float) -> None:
    with served() as (process, _):
        time.sleep(delay)
        took, code, _, err = interrupted(process)
    assert (code, err) == (0, "")
    assert took < MOST


def test_ctrl_c_ends_a_server_whose_client_does_not_read() -> None:
    with served() as (process, known):
        client = importlib.import_module("websockets.sync.client").connect(known["url"], compression=None)
        client.send(json.dumps({"op": "hello", "token": known["token"], "role": "commander"}))
        client.recv(5)
        time.sleep(0.3)
        took, code, _, err = interrupted(process)
        client.socket.close()
    assert (code, err) == (0, "")
    assert took < MOST
