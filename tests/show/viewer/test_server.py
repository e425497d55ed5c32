"""Who may talk to the viewer's server, and how it ends."""

from __future__ import annotations

import http.client
import json
import os
import signal
import socket
import subprocess
import sys

import pytest

from tests.command_line import CRL as CRL_FILE
from tests.command_line import ROOT, Run, refused
from tests.command_line import THESIS as FILE
from tests.examples import THESIS
from tubeopt import InputError
from tubeopt.show.viewer import View, serve
from tubeopt.show.viewer.host import address_of, is_own

from .browser import served


def status(address: str, **headers: str) -> int:
    """Status of a request for the page with other headers."""
    where = address.removeprefix("http://")
    connection = http.client.HTTPConnection(where, timeout=60)
    connection.putrequest("GET", "/", skip_host=True, skip_accept_encoding=True)  # as bare as a client may be
    for name, value in ({"Host": where} | headers).items():
        connection.putheader(name, value)
    connection.endheaders()
    answer = connection.getresponse().status
    connection.close()
    return answer


def test_only_its_own_page_on_this_machine_is_answered(address: str) -> None:
    where = address.removeprefix("http://")
    port = where.rsplit(":")[1]
    assert status(address) == status(address, Origin=address) == 200
    assert status(address, Host=f"localhost:{port}") == 200
    assert status(address, Host=f"evil.example:{port}") == 403
    assert status(address, Origin="http://evil.example") == 403
    upgrade = {"Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13"}
    key = {"Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Protocol": "viser-v1.1.1"}
    assert status(address, Origin="http://evil.example", **upgrade, **key) == 403


def test_it_listens_on_this_machine_alone(address: str) -> None:
    """No other address of this machine is served."""
    port = int(address.rsplit(":", 1)[1])
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.settimeout(2)
        assert probe.connect_ex(("127.0.0.2", port)) != 0


def test_own_pages() -> None:
    assert is_own("127.0.0.1:8080", None, "127.0.0.1")
    assert is_own("localhost:8080", "http://localhost:8080", "127.0.0.1")
    assert is_own("[::1]:8080", None, "127.0.0.1")
    assert not is_own("localhost:8080", "http://localhost:9090", "127.0.0.1")
    assert not is_own("robot.lab:8080", None, "127.0.0.1")
    assert is_own("robot.lab:8080", "http://robot.lab:8080", "0.0.0.0")
    assert not is_own("robot.lab:8080", "http://evil.example", "0.0.0.0")


def test_addresses_are_what_a_browser_here_can_open() -> None:
    assert address_of("127.0.0.1", 8080) == "http://127.0.0.1:8080"
    assert address_of("0.0.0.0", 8080) == "http://127.0.0.1:8080"
    assert address_of("::1", 80) == address_of("::", 80) == "http://[::1]:80"
    assert address_of("robot.lab", 8080) == "http://robot.lab:8080"


def test_a_port_that_is_taken_is_not_changed_silently() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(InputError, match=f"cannot listen on 127.0.0.1, port {port}: .* choose another --port"):
            serve(View(THESIS), port=port)
    with pytest.raises(InputError, match=r"cannot listen on no\.such\.host\.invalid"):
        serve(View(THESIS), host="no.such.host.invalid", port=0)


def test_it_ends_when_told() -> None:
    with served(View(THESIS)) as url:
        assert status(url) == 200
    with pytest.raises(OSError, match="refused"):
        status(url)


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_the_command_ends_cleanly_on_ctrl_c(how: signal.Signals) -> None:
    command = [sys.executable, "-m", "tubeopt", "view", FILE, "--port", "0", "--json"]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT, env=environment
    ) as process:
        assert process.stdout is not None
        try:
            said = json.loads("".join(iter(process.stdout.readline, "}\n")) + "}")
            assert said["robot"] == "thesis CTR"
            assert status(said["url"]) == 200
            process.send_signal(how)
            out, err = process.communicate(timeout=120)
        finally:
            process.kill()
    assert (process.returncode, out, err) == (0, "", "")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((FILE, "--port", "80000"), "--port is 80000; it must be at most 65535"),
        ((FILE, "--port", "nan"), "--port is NaN; it must be a finite number"),
        ((FILE, "--port", "-inf"), "--port is -Infinity; it must be a finite number"),
        ((FILE, "--port", "http"), "--port is 'http'; it must be a number"),
        (("nowhere.yaml",), "nowhere.yaml: there is no such file"),
        (
            (CRL_FILE, "--study", "configs/studies/thesis_snap.yaml"),
            f"configs/studies/thesis_snap.yaml: the robot of the study differs from {CRL_FILE}",
        ),
        ((FILE, "--trajectory", "nowhere.csv"), "nowhere.csv: there is no such file"),
        ((FILE, "--obstacles", "nowhere.yaml"), "nowhere.yaml: there is no such file"),
    ],
)
def test_bad_requests_are_refused(
    run: Run, arguments: tuple[str, ...], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(ROOT)
    assert refused(run("view", *arguments)) == [message]


def test_help_has_an_example(run: Run) -> None:
    outcome = run("view", "--help")
    assert outcome.code == 0
    assert "Example: tubeopt view" in outcome.out


def test_another_address_comes_with_a_warning(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: dict[str, object] = {}

    def remember(view: View, **options: object) -> None:
        seen.update(options, view=view)

    monkeypatch.setattr("tubeopt.cli.view.serve", remember)
    monkeypatch.chdir(ROOT)
    outcome = run("view", FILE, "--host", "0.0.0.0", "--study", "configs/studies/thesis_actuated.yaml", "--json")
    assert outcome.code == 0
    assert outcome.err == ""
    assert seen["host"] == "0.0.0.0"
    view = seen["view"]
    assert isinstance(view, View)
    assert view.rotations == pytest.approx([0, 1, 2])
    told = " ".join(run("view", FILE, "--host", "0.0.0.0", "--no-open").err.split())
    assert "warning: everyone who can reach 0.0.0.0 can move this robot" in told
    assert not run("view", FILE, "--json").err
    assert seen["host"] == "127.0.0.1"
