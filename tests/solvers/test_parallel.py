"""Many computations: every item answered once, whatever happens to the one next to it."""

from __future__ import annotations

import itertools
import math
import os
import pickle
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import casadi as ca
import pytest

from tubeopt import InputError
from tubeopt.solvers.parallel import Failure, each, executor

from .parallel_functions import Weighed, evaluated, picky, slow, square

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("workers", [1, 2])
def test_every_item_is_answered_once(workers: int) -> None:
    results = list(each(square, range(50), workers=workers))
    assert sorted(outcome.index for outcome in results) == list(range(50))
    assert all(outcome.value == outcome.index**2 and outcome.failure is None for outcome in results)


def test_the_function_arrives_once_per_worker() -> None:
    results = list(each(Weighed(3), range(40), workers=2))
    assert {(o.index, o.value[0]) for o in results if o.value} == {(k, 3 * k) for k in range(40)}
    assert {o.value[2] for o in results if o.value} == {1}
    assert os.getpid() not in {o.value[1] for o in results if o.value}


def test_functions_of_casadi_travel_as_casadi_writes_them() -> None:
    theta = ca.SX.sym("theta")
    function = ca.Function("f", [theta], [ca.sin(theta) ** 2])
    assert function.serialize().encode() in pickle.dumps(function)
    results = {outcome.index: outcome for outcome in each(partial(evaluated, function), range(6), workers=2)}
    assert [results[k].value for k in range(6)] == pytest.approx([math.sin(k) ** 2 for k in range(6)], abs=1e-15)


def test_what_raises_costs_its_own_item_only() -> None:
    results = {outcome.index: outcome for outcome in each(picky, range(6), workers=1)}
    assert results[3].failure == Failure("ValueError", "three is no good")
    assert {k: o.value for k, o in results.items() if k != 3} == {k: k * k for k in (0, 1, 2, 4, 5)}


def test_what_kills_its_worker_costs_its_own_item_only() -> None:
    results = {outcome.index: outcome for outcome in each(picky, range(12), workers=2)}
    assert len(results) == 12
    failed = {k: str(o.failure) for k, o in results.items() if o.failure}
    assert failed == {
        3: "ValueError: three is no good",
        7: "WorkerLost: the process that computed it ended without an answer",
    }


def test_a_worker_killed_from_outside_costs_nothing() -> None:
    results = []
    for outcome in each(slow, range(30), workers=2):
        assert outcome.value is not None
        results.append(outcome.value[0])
        if len(results) == 5:
            os.kill(outcome.value[1], signal.SIGKILL)
    assert sorted(results) == [k * k for k in range(30)]


def test_items_are_taken_as_workers_become_free() -> None:
    taken = itertools.count()

    def endless() -> Iterator[int]:
        for item in itertools.count():
            next(taken)
            yield item

    run = each(square, endless(), workers=1)
    assert [next(run).value for _ in range(5)] == [0, 1, 4, 9, 16]
    run.close()  # type: ignore[attr-defined]
    assert next(taken) < 10


def test_two_runs_side_by_side_keep_to_themselves() -> None:
    one, other = each(Weighed(2), range(4), workers=1), each(Weighed(5), range(4), workers=1)
    pairs = [(a.value[0], b.value[0]) for a, b in zip(one, other, strict=True) if a.value and b.value]
    assert pairs == [(2 * k, 5 * k) for k in range(4)]


def test_workers_do_not_outlive_a_parent_that_is_killed(tmp_path: Path) -> None:
    script = tmp_path / "parent.py"
    script.write_text(
        "from tests.solvers.parallel_functions import slow\n"
        "from tubeopt.solvers.parallel import each\n"
        "if __name__ == '__main__':\n"
        "    for outcome in each(slow, range(10**6), workers=2):\n"
        "        print(outcome.value[1], flush=True)\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, env=environment, text=True) as parent:
        assert parent.stdout is not None
        workers = {int(parent.stdout.readline()) for _ in range(20)}
        parent.kill()
    assert workers
    until = time.monotonic() + 10
    while any(_alive(worker) for worker in workers):
        assert time.monotonic() < until
        time.sleep(0.05)


def _alive(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().split()[2] != "Z"
    except (FileNotFoundError, ProcessLookupError):  # the second where it ends while it is read
        return False


@pytest.mark.parametrize("workers", [-1, 1.5, True])
def test_numbers_of_workers_that_are_none(workers: int) -> None:
    with pytest.raises(InputError, match=r"workers is .*; it must be 0 \(one per core\) or a number of processes"):
        list(each(square, [1], workers=workers))


def test_a_function_that_does_not_pickle_is_named() -> None:
    with pytest.raises(InputError, match=r"lambda.* cannot be sent to other processes"):
        list(each(lambda x: x, [1], workers=2))


LOCAL = """
from tubeopt import InputError
from tubeopt.solvers.parallel import each

def local(x):
    return x

try:
    print(list(each(local, range(3), workers=2)))
except InputError as error:
    print(error)
"""


@pytest.mark.parametrize("typed", [True, False])
def test_workers_that_cannot_begin_are_no_failure_of_the_items(tmp_path: Path, typed: bool) -> None:
    script = tmp_path / "script.py"
    script.write_text(LOCAL)
    command = [sys.executable, "-c", LOCAL] if typed else [sys.executable, str(script)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    report = "the function cannot be loaded by the workers" if typed else "your script under"
    assert report in done.stdout


def test_the_executor_is_one_of_the_standard_library() -> None:
    with executor(2) as pool:
        assert list(pool.map(math.sqrt, [1.0, 4.0])) == [1.0, 2.0]
