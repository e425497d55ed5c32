"""What a user waits for before anything is computed: the package, the command line, the first solve of a process.

Run it as `python -m benchmarks.startup` from the root of the project; with `--against DIRECTORY` another checkout is
measured in turn with this one. Every time is that of a whole process, its processor time and its largest memory.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from benchmarks.timing import ROOT, Timing, dump, show, summarise, table

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


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--against", type=Path, metavar="DIRECTORY", help="another checkout, measured in turn")
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    checkouts = [ROOT] if given.against is None else [given.against.resolve(), ROOT]
    found = measure(checkouts, given.repeats)
    if given.json:
        dump({"starts": [asdict(one) for one in found]})
        return
    rows = []
    for one in found:
        _, seconds, memory = STARTS[one.what]
        asked = ", ".join([f"{seconds} s"] * (seconds is not None) + [f"{memory} MiB"] * (memory is not None))
        name = "this" if one.checkout == str(ROOT) else Path(one.checkout).name
        rows.append((one.what, name, f"{one.timing.fast:.3f}", f"{one.timing.median:.3f}", f"{one.memory:.0f}", asked))
    columns = ("start", "checkout", "first decile (s)", "median (s)", "memory (MiB)", "asked")
    show([table("Starts of a process", columns, rows)], [])


if __name__ == "__main__":
    main()
