"""The same on a Dask cluster of two processes, one of which is killed on the way."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path

import pytest

from tubeopt import InputError, sweep
from tubeopt.solvers.parallel import each

from .parallel_functions import picky, slow, slow_row

pytest.importorskip("distributed")

ROOT = Path(__file__).parents[3]


@contextmanager
def process(*arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "DASK_DISTRIBUTED__ADMIN__TICK__LIMIT": "60s"}
    command = [sys.executable, "-m", "distributed.cli." + arguments[0], *arguments[1:]]
    with subprocess.Popen(
        command, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as running:
        try:
            yield running
        finally:
            running.kill()


@contextmanager
def cluster(workers: int) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """Address of a scheduler of this machine, and its worker processes."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    with ExitStack() as stack:
        current = ("--host", "127.0.0.1")
        stack.enter_context(process("dask_scheduler", *current, "--port", str(port), "--no-dashboard"))
        alone = ("--no-nanny", "--nthreads", "1", "--no-dashboard", *current)
        yield address, [stack.enter_context(process("dask_worker", address, *alone)) for _ in range(workers)]


@pytest.fixture(scope="module")
def running() -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    with cluster(2) as both:
        until = time.monotonic() + 60
        while True:
            try:
                observed = {o.value[1] for o in each(slow, range(16), scheduler=both[0]) if o.value}
                if len(observed) == 2:
                    break
            except InputError:
                time.sleep(0.2)
            assert time.monotonic() < until
        yield both


Running = tuple[str, list[subprocess.Popen[bytes]]]


def test_failures_cost_their_own_item_only(running: Running) -> None:
    results = {o.index: o for o in each(picky, range(6), scheduler=running[0])}
    assert str(results[3].failure) == "ValueError: three is no good"
    assert {k: o.value for k, o in results.items() if k != 3} == {k: k * k for k in (0, 1, 2, 4, 5)}


def test_a_worker_killed_in_the_middle_of_a_sweep(running: Running, tmp_path: Path) -> None:
    address, workers = running
    points = [{"x": k} for k in range(120)]
    used: list[int] = []

    def kill_one(done: int, total: int, failed: int) -> None:
        if done == 30:
            workers[0].send_signal(signal.SIGKILL)
        used.append(done)

    function = partial(slow_row, 2)
    result = sweep(function, points, tmp_path / "cluster", scheduler=address, progress=kill_one)
    alone = sweep(function, points, tmp_path / "alone", workers=1)
    assert workers[0].poll() is not None
    assert (result.computed, result.failures) == (120, ())
    lines = [json.loads(line) for line in result.journal.read_text().splitlines()[1:]]
    assert sorted(line["index"] for line in lines) == list(range(120))
    assert result.table.read_bytes() == alone.table.read_bytes()
    assert used == list(range(121))


def test_addresses_without_a_scheduler_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tubeopt.solvers.cluster.TIMEOUT", 0.3)
    with pytest.raises(InputError, match=r"scheduler is 'tcp://127.0.0.1:1'; no Dask scheduler answers there"):
        list(each(slow, [1], scheduler="tcp://127.0.0.1:1"))
    for address in ("nonsense://x", "localhost:8786", ""):
        with pytest.raises(InputError, match=r"must be an address such as tcp://host:8786"):
            list(each(slow, [1], scheduler=address))
