"""What a user waits for: the package, the command line, the first solve of a process, a picture that takes seconds, and
the end of a command after Ctrl-C.

Run it as `python -m benchmarks.startup` from the root of the project; with `--against DIRECTORY` another checkout is
measured in turn with this one. Every time is that of a whole process, its processor time and its largest memory; those
from Ctrl-C to the end, and of tests, are on the clock.

With `--wheel PYTHON`, the interpreter of an environment in which a wheel is installed, forward kinematics is solved
there too, in turn with this checkout, with neither a compiler nor a compiled kernel in reach but that of the wheel.
With `--tests` the tests run once in each checkout, on two cores.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.timing import ROOT, Timing, dump, milliseconds, show, summarise, table

ROBOT, SECOND_ROBOT = "configs/robots/thesis_ctr.yaml", "configs/robots/crl_ctr.yaml"

FOLDER = "FOLDER"
"""Stands among arguments for an empty directory."""


class Start(NamedTuple):
    """Arguments of Python, the most seconds and MiB that it may take, and of how many repeats one is done."""

    arguments: tuple[str, ...]
    seconds: float | None = None
    memory: float | None = None
    rare: int = 1


def _map(robot: str) -> Start:
    return Start(("-m", "tubeopt", "stability-map", robot, "--quiet", "--out", FOLDER), 5.0, None, 3)


STARTS = {
    "python -c pass": Start(("-c", "pass")),
    "import tubeopt": Start(("-c", "import tubeopt"), 0.35, 60),
    "forward_kinematics": Start(
        ("-c", f"import tubeopt; tubeopt.forward_kinematics(tubeopt.load_robot({ROBOT!r}), [0, 1, 2])")
    ),
    "tubeopt --version": Start(("-m", "tubeopt", "--version"), 0.5),
    "tubeopt --help": Start(("-m", "tubeopt", "--help"), 0.5),
    "tubeopt fk": Start(("-m", "tubeopt", "fk", ROBOT, "--rotations-deg", "0,57.3,114.6"), 0.8),
    "tubeopt stability-map, thesis": _map(ROBOT),
    "tubeopt stability-map, CRL": _map(SECOND_ROBOT),
}

INTERRUPTED = {
    "heat plan": ("heat", "plan", "configs/rigs/thesis_calcium_silicate.yaml"),
    "stability-map": ("stability-map", ROBOT, "--directions", "3600"),
}
"""Commands that are at work for longer than AT_WORK."""

AT_WORK, ENDS = 1.5, 2.0
"""Seconds after which Ctrl-C is pressed, and within which a command ends."""

TESTS = {"those of a fifth of a second at most": (("-m", "not slow"), 60.0), "all by day": ((), 480.0)}
"""Arguments of pytest, and seconds on two cores."""


SOLVES = """
import json, sys, time
import numpy as np
import tubeopt
robot = tubeopt.load_robot(sys.argv[1])
seconds, answers = [], []
for rotations in np.random.default_rng(0).uniform(-np.pi, np.pi, (400, robot.n_tubes)):
    began = time.process_time()
    pose = tubeopt.forward_kinematics(robot, rotations)
    seconds.append(time.process_time() - began)
    answers.append([*pose.tip_position, *pose.tip_rotations, pose.margin])
print(json.dumps({"seconds": float(np.quantile(seconds, 0.1)), "answers": answers}))
"""
"""Random configurations: the first decile of seconds per solve; tips (m), rotations of the tubes there, margins."""

EQUAL, SLOWER = 1e-12, 1.05
"""How far answers of a wheel may be from those of the kernel compiled here, and how many times as long it may take."""


@dataclass(frozen=True)
class Measurement:
    """Starts of one kind in one checkout: processor time, and the largest memory, MiB."""

    checkout: str
    what: str
    timing: Timing
    memory: float


def process_of(checkout: Path) -> dict[str, str]:
    """The environment of a process that takes the package of a checkout."""
    environment = os.environ | {"PYTHONPATH": str(checkout)}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # every start would compile the package, as no user's does
    return environment


def start(checkout: Path, arguments: Sequence[str]) -> tuple[float, float]:
    """Seconds of processor time and MiB of one process."""
    script = (
        "import resource, subprocess, sys\n"
        "subprocess.run([sys.executable, *sys.argv[1:]], check=True, stdout=subprocess.DEVNULL)\n"
        "used = resource.getrusage(resource.RUSAGE_CHILDREN)\n"
        "print(used.ru_utime + used.ru_stime, used.ru_maxrss / 1024)"
    )
    with tempfile.TemporaryDirectory() as folder:
        own = [folder if each == FOLDER else each for each in arguments]
        command = [sys.executable, "-S", "-c", script, *own]
        out = subprocess.run(
            command, cwd=checkout, env=process_of(checkout), capture_output=True, text=True, check=True
        ).stdout
    seconds, memory = out.split()
    return float(seconds), float(memory)


def measure(checkouts: Sequence[Path], repeats: int) -> list[Measurement]:
    """Every start in every checkout, in turn; the first of each only fills the caches."""
    out = []
    for what, requested in STARTS.items():
        runs: dict[Path, list[tuple[float, float]]] = {checkout: [] for checkout in checkouts}
        for _ in range(max(1, repeats // requested.rare) + 1):
            for checkout in checkouts:
                runs[checkout].append(start(checkout, requested.arguments))
        for checkout, result in runs.items():
            times = summarise(seconds for seconds, _ in result[1:])
            out.append(Measurement(str(checkout), what, times, max(memory for _, memory in result[1:])))
    return out


def seconds_to_end(checkout: Path, arguments: Sequence[str]) -> float:
    """From Ctrl-C to the end of a command that is at work."""

    def hear() -> None:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # what runs in the background may have been told not to

    command = [sys.executable, "-m", "tubeopt", *arguments]
    quiet: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with subprocess.Popen(command, cwd=checkout, env=process_of(checkout), preexec_fn=hear, **quiet) as process:
        time.sleep(AT_WORK)
        if process.poll() is not None:
            raise SystemExit(f"{' '.join(arguments)} ended with {process.returncode} before Ctrl-C was pressed")
        start_time = time.monotonic()
        process.send_signal(signal.SIGINT)
        code = process.wait()
        took = time.monotonic() - start_time
    if code != 130:
        raise SystemExit(f"{' '.join(arguments)} ended with {code} after Ctrl-C; it must be 130")
    return took


def seconds_of_tests(checkout: Path, arguments: Sequence[str]) -> float:
    """On the clock, by two processes."""
    command = [sys.executable, "-m", "pytest", "-q", "-n", "2", *arguments]
    start_time = time.monotonic()
    subprocess.run(command, cwd=checkout, env=process_of(checkout), stdout=subprocess.DEVNULL, check=True)
    return time.monotonic() - start_time


def on_the_clock(checkouts: Sequence[Path], repeats: int, tests: bool) -> list[tuple[str, str, float, float]]:
    """What is measured, in which checkout, the seconds that it took at most, and those asked."""
    out = []
    for what, arguments in INTERRUPTED.items():
        for checkout in checkouts:
            longest = max(seconds_to_end(checkout, arguments) for _ in range(max(1, repeats // 3)))
            out.append((f"Ctrl-C while {what}", str(checkout), longest, ENDS))
    for what, (arguments, requested) in TESTS.items() if tests else ():
        out += [(f"tests, {what}", str(each), seconds_of_tests(each, arguments), requested) for each in checkouts]
    return out


@dataclass(frozen=True)
class Wheel:
    """The kernel of a wheel beside that compiled here: largest difference of an answer, seconds per solve of both."""

    difference: float
    seconds: float
    here: float


def wheel(python: Path, repeats: int) -> Wheel:
    """Solve in both environments, in turn."""
    answers: list[np.ndarray] = []
    seconds: tuple[list[float], list[float]] = [], []
    with tempfile.TemporaryDirectory() as empty:
        bare = {"PATH": str(python.parent), "TUBEOPT_CACHE": empty, "OPENBLAS_NUM_THREADS": "1"}
        for _ in range(repeats):
            for took, program, environment in (
                (seconds[0], python, bare),
                (seconds[1], Path(sys.executable), os.environ | {"PYTHONPATH": str(ROOT)}),
            ):
                command = [str(program), "-c", SOLVES, str(ROOT / ROBOT)]
                run = subprocess.run(command, cwd=empty, env=environment, capture_output=True, text=True, check=True)
                result = json.loads(run.stdout)
                took.append(result["seconds"])
                answers.append(np.array(result["answers"]))
    return Wheel(float(np.abs(answers[0] - answers[1]).max()), min(seconds[0]), min(seconds[1]))


def wheel_text(found: Wheel) -> str:
    """What is asked of a wheel, and whether it holds."""
    holds = found.difference <= EQUAL and found.seconds <= SLOWER * found.here
    return (
        f"wheel without a compiler: answers differ by {found.difference:.1e} at most (asked {EQUAL:g}), a solve takes "
        f"{milliseconds(found.seconds)} ms, {found.seconds / found.here:.2f} times as long as with the kernel compiled "
        f"here (asked {SLOWER:g}): {'reached' if holds else 'MISSED'}"
    )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--against", type=Path, metavar="DIRECTORY", help="another checkout, measured in turn")
    parser.add_argument("--wheel", type=Path, metavar="PYTHON", help="of an environment in which a wheel is installed")
    parser.add_argument("--tests", action="store_true", help="run the tests, too")
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    checkouts = [ROOT] if args.against is None else [args.against.resolve(), ROOT]
    result = measure(checkouts, args.repeats)
    waited = on_the_clock(checkouts, args.repeats, args.tests)
    of_wheel = None if args.wheel is None else wheel(args.wheel.absolute(), args.repeats)
    if args.json:
        report = {"starts": [asdict(one) for one in result], "on the clock": waited}
        dump(report | ({"wheel": asdict(of_wheel)} if of_wheel else {}))
        return
    rows = []
    for one in result:
        start_of = STARTS[one.what]
        limits = (start_of.seconds, "s"), (start_of.memory, "MiB")
        requested = ", ".join(f"{largest} {unit}" for largest, unit in limits if largest is not None)
        times = (f"{seconds:.3f}" for seconds in (one.timing.fast, one.timing.median))
        rows.append((one.what, called(one.checkout), *times, f"{one.memory:.0f}", requested))
    columns = ("start", "checkout", "first decile (s)", "median (s)", "memory (MiB)", "asked")
    clock = [(what, called(checkout), f"{took:.1f}", f"{largest:g} s") for what, checkout, took, largest in waited]
    tables = [
        table("Starts of a process", columns, rows),
        table("On the clock", ("what", "checkout", "at most (s)", "asked"), clock),
    ]
    show(tables, [wheel_text(of_wheel)] if of_wheel else [])


def called(checkout: str) -> str:
    """A checkout in a table."""
    return "this" if checkout == str(ROOT) else Path(checkout).name


if __name__ == "__main__":
    main()
