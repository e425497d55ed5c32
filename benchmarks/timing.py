"""Timing of many short calls, the machine they ran on, and tables of them."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi
import numpy as np
import scipy
from rich.console import Console
from rich.table import Table

import tubeopt

ROOT = Path(__file__).resolve().parents[1]

BRIEF = 2e-3
"""Seconds for which the work of a process is taken to be what it was: to ask for it is a call of the system."""


def count_work() -> None:
    """Make all limits of time count the work of this process, to BRIEF, whatever else the machine does."""
    clock, asked, work = time.perf_counter, -BRIEF, 0.0

    def worked() -> float:
        nonlocal asked, work
        if clock() - asked >= BRIEF:
            asked, work = clock(), time.process_time()
        return work

    time.perf_counter = worked


@dataclass(frozen=True)
class Timing:
    """Seconds per call: median, first and ninth decile, number of calls, and 99.9th percentile."""

    median: float
    fast: float
    slow: float
    calls: int
    rare: float


def summarise(seconds: Iterable[float]) -> Timing:
    """Median and deciles of measured times."""
    times = np.fromiter(seconds, float)
    fast, median, slow, rare = np.quantile(times, [0.1, 0.5, 0.9, 0.999]).tolist()
    return Timing(median, fast, slow, len(times), rare)


def clock(call: Callable[[], Any]) -> tuple[float, Any]:
    """Seconds of processor time that a call takes, and what it returns.

    On one thread of an idle machine that is the time on the clock; where others keep the machine busy it stays so,
    while the clock goes on through every pause of a call that is longer than the scheduler's patience.
    """
    start_time = time.process_time()
    result = call()
    return time.process_time() - start_time, result


def fresh_process(script: str, repeats: int) -> Timing:
    """Seconds that a script prints, run in a new interpreter each time; the first run only warms the disk."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    seconds = []
    for _ in range(repeats + 1):
        out = subprocess.run(
            [sys.executable, "-c", script], cwd=ROOT, env=environment, capture_output=True, text=True, check=True
        )
        seconds.append(float(out.stdout.split()[-1]))
    return summarise(seconds[1:])


def with_package(checkout: Path, module: str, arguments: Sequence[str]) -> Any:
    """What a benchmark of this checkout prints by `--json`, run in a process of its own with the package of another
    checkout: the questions stay the same, whatever that one asks."""
    done = subprocess.run(
        **_with_package(checkout, module, ["--json", *arguments]), capture_output=True, text=True, check=True
    )
    return json.loads(done.stdout)


@contextmanager
def running(checkout: Path, module: str, arguments: Sequence[str]) -> Iterator[subprocess.Popen[str]]:
    """A process of `with_package` that is asked by lines and answers each by a line of JSON."""
    pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    process = subprocess.Popen(**_with_package(checkout, module, arguments), **pipes)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def ask_line(process: subprocess.Popen[str], line: str) -> Any:
    """What a `running` process answers to a line; None where it has ended."""
    assert process.stdin is not None
    assert process.stdout is not None
    print(line, file=process.stdin, flush=True)
    answer = process.stdout.readline()
    return json.loads(answer) if answer else None


def _with_package(checkout: Path, module: str, arguments: Sequence[str]) -> dict[str, Any]:
    """Command, folder and environment of a benchmark of this checkout with the package of another one."""
    script = (
        "import runpy, sys\n"
        "package, benchmarks, module = sys.argv[1:4]\n"
        "sys.path.insert(0, package)\n"
        "import tubeopt\n"
        "sys.path[0], sys.argv = benchmarks, [module, *sys.argv[4:]]\n"
        "runpy.run_module(module, run_name='__main__')"
    )
    command = [sys.executable, "-P", "-c", script, str(checkout), str(ROOT), module, *arguments]
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    return {"args": command, "cwd": ROOT, "env": environment}


def machine() -> dict[str, str]:
    """Processor, load, versions and threads: what times mean nothing without."""
    cpu = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [line.split(":")[1].strip() for line in info.read_text().splitlines() if line.startswith("model name")]
        cpu = names[0] if names else cpu
    load = f"{os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "unknown"
    return {
        "processor": f"{cpu}, {os.cpu_count()} cores",
        "load": load,
        "threads of OpenBLAS": os.environ.get("OPENBLAS_NUM_THREADS", "default"),
        "python": platform.python_version(),
        "tubeopt": tubeopt.__version__,
        "casadi": casadi.__version__,
        "numpy": np.__version__,
        "scipy": scipy.__version__,
    }


def table(title: str, columns: Iterable[str], rows: Iterable[Iterable[str]]) -> Table:
    """A table whose first column is text and whose others are numbers."""
    out = Table(title=title, title_justify="left")
    for k, column in enumerate(columns):
        out.add_column(column, justify="right" if k else "left", no_wrap=not k)
    for row in rows:
        out.add_row(*row)
    return out


def milliseconds(seconds: float) -> str:
    """Three figures of a time in ms."""
    return f"{1e3 * seconds:.3g}"


def show(tables: Iterable[Table], notes: Iterable[str]) -> None:
    """Print tables, then notes, then the machine."""
    console = Console()
    if not console.is_terminal:
        console = Console(width=132)
    for one in tables:
        console.print(one)
    for note in (*notes, "; ".join(f"{key} {value}" for key, value in machine().items())):
        console.print(note, style="dim", highlight=False)


def dump(record: dict[str, Any]) -> None:
    """Print a record as JSON, the machine included."""
    print(json.dumps({"machine": machine(), **record}, indent=2))
