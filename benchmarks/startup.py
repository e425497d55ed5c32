"""What a user waits for before anything is computed: the package, the command line, the first solve of a process.

Run it as `python -m benchmarks.startup` from the root of the project; with `--against DIRECTORY` another checkout is
measured in turn with this one. Every time is that of a whole process, its processor time and its largest memory.

With `--wheel PYTHON`, the interpreter of an environment in which a wheel is installed, forward kinematics is solved
there too, in turn with this checkout, with neither a compiler nor a compiled kernel in reach but that of the wheel.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from benchmarks.timing import ROOT, Timing, dump, milliseconds, show, summarise, table

ROBOT = "configs/robots/thesis_ctr.yaml"

STARTS = {
    "python -c pass": (("-c", "pass"), None, None),
    "import tubeopt": (("-c", "import tubeopt"), 0.35, 60),
    "forward_kinematics": (
        ("-c", f"import tubeopt; tubeopt.forward_kinematics(tubeopt.load_robot({ROBOT!r}), [0, 1, 2])"),
        None,
        None,
    ),
    "tubeopt --version": (("-m", "tubeopt", "--version"), 0.5, None),
    "tubeopt --help": (("-m", "tubeopt", "--help"), 0.5, None),
    "tubeopt fk": (("-m", "tubeopt", "fk", ROBOT, "--rotations-deg", "0,57.3,114.6"), 0.8, None),
}
"""Arguments of Python, and the most seconds and MiB that a start may take."""


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


def start(checkout: Path, arguments: Sequence[str]) -> tuple[float, float]:
    """Seconds of processor time and MiB of one process."""
    script = (
        "import resource, subprocess, sys\n"
        "subprocess.run([sys.executable, *sys.argv[1:]], check=True, stdout=subprocess.DEVNULL)\n"
        "used = resource.getrusage(resource.RUSAGE_CHILDREN)\n"
        "print(used.ru_utime + used.ru_stime, used.ru_maxrss / 1024)"
    )
    environment = os.environ | {"PYTHONPATH": str(checkout)}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # every start would compile the package, as no user's does
    command = [sys.executable, "-S", "-c", script, *arguments]
    out = subprocess.run(command, cwd=checkout, env=environment, capture_output=True, text=True, check=True).stdout
    seconds, memory = out.split()
    return float(seconds), float(memory)


def measure(checkouts: Sequence[Path], repeats: int) -> list[Measurement]:
    """Every start in every checkout, in turn; the first of each only fills the caches."""
    out = []
    for what, (arguments, _, _) in STARTS.items():
        runs: dict[Path, list[tuple[float, float]]] = {checkout: [] for checkout in checkouts}
        for _ in range(repeats + 1):
            for checkout in checkouts:
                runs[checkout].append(start(checkout, arguments))
        for checkout, found in runs.items():
            times = summarise(seconds for seconds, _ in found[1:])
            out.append(Measurement(str(checkout), what, times, max(memory for _, memory in found[1:])))
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
                found = json.loads(run.stdout)
                took.append(found["seconds"])
                answers.append(np.array(found["answers"]))
    return Wheel(float(np.abs(answers[0] - answers[1]).max()), min(seconds[0]), min(seconds[1]))


def wheel_in_words(found: Wheel) -> str:
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
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    checkouts = [ROOT] if given.against is None else [given.against.resolve(), ROOT]
    found = measure(checkouts, given.repeats)
    of_wheel = None if given.wheel is None else wheel(given.wheel.absolute(), given.repeats)
    if given.json:
        dump({"starts": [asdict(one) for one in found]} | ({"wheel": asdict(of_wheel)} if of_wheel else {}))
        return
    rows = []
    for one in found:
        _, seconds, memory = STARTS[one.what]
        asked = ", ".join([f"{seconds} s"] * (seconds is not None) + [f"{memory} MiB"] * (memory is not None))
        name = "this" if one.checkout == str(ROOT) else Path(one.checkout).name
        rows.append((one.what, name, f"{one.timing.fast:.3f}", f"{one.timing.median:.3f}", f"{one.memory:.0f}", asked))
    columns = ("start", "checkout", "first decile (s)", "median (s)", "memory (MiB)", "asked")
    show([table("Starts of a process", columns, rows)], [wheel_in_words(of_wheel)] if of_wheel else [])


if __name__ == "__main__":
    main()
