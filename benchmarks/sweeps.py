"""Workspaces and sweeps: throughput, and peak memory while results stream into a file.

    python -m benchmarks.sweeps [--robot FILE] [--samples N ...] [--points N] [--json]

Workspaces run in new processes, one per number of samples, whose peak memory is that of the process alone, imports and
compiled kernel included; the voxels are counted at the end. The sweep is `forward_kinematics` as a study whose robot
changes at every point, on one and on two processes and again in a directory that is complete; a point costs its share
of the journal too.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

from tubeopt import sweep
from tubeopt.runs.sweep_file import load_sweep
from tubeopt.show.reports import to_dict

from .timing import ROOT, dump, show, table

ROBOT = ROOT / "configs" / "robots" / "crl_ctr.yaml"

STREAM = """
import json, sys, tempfile, time
from tubeopt import load_robot, workspace
from tubeopt.workspaces import voxels
robot, count = load_robot(sys.argv[1]), int(sys.argv[2])
workspace(robot, 10)
peak = lambda: next(int(line.split()[1]) / 1024 for line in open("/proc/self/status") if line.startswith("VmHWM"))
before = peak()
with tempfile.TemporaryDirectory() as directory:
    clock, cpu = time.perf_counter(), time.process_time()
    found = workspace(robot, count, out=directory)
    clock, cpu = time.perf_counter() - clock, time.process_time() - cpu
    assert all((part[:, -1] > 0).all() for _, part in found.chunks())
    cubes = len(voxels(found))
print(json.dumps([clock, cpu, before, peak(), cubes]))
"""


@dataclass(frozen=True)
class Stream:
    """A workspace of so many samples: seconds by the clock and of the processor, and memory in MiB."""

    samples: int
    clock: float
    processor: float
    memory_before: float
    memory_peak: float
    voxels: int


def stream(robot: Path, samples: int) -> Stream:
    """Compute a workspace in a new process."""
    command = [sys.executable, "-c", STREAM, str(robot), str(samples)]
    out = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    return Stream(samples, *json.loads(out))


def sweeps(points: int) -> dict[str, float]:
    """Points per second of a sweep with so many points, by the clock, start of the processes included."""
    source = (ROOT / "configs" / "studies" / "sweep_tips.yaml").read_text(encoding="utf-8")
    source = source.replace("count: 200", f"count: {points}").replace("../robots", str(ROOT / "configs" / "robots"))
    rates = {}
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "sweep.yaml"
        path.write_text(source, encoding="utf-8")
        question = load_sweep(path)
        runs = (("1 process", 1, "one"), ("2 processes", 2, "two"), ("complete already", 2, "two"))
        for what, workers, directory in runs:
            start_time = time.perf_counter()
            sweep(
                question.function(to_dict),
                question.points,
                Path(name) / directory,
                fingerprint=question.fingerprint,
                workers=workers,
            )
            rates[what] = points / (time.perf_counter() - start_time)
    return rates


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.sweeps", description=__doc__.split("\n")[0])
    parser.add_argument("--robot", type=Path, default=ROBOT, help="robot file")
    parser.add_argument(
        "--samples", type=int, nargs="+", default=[10_000, 100_000, 1_000_000], help="of the workspaces"
    )
    parser.add_argument("--points", type=int, default=2000, help="of the sweep")
    parser.add_argument("--json", action="store_true", help="print JSON instead of tables")
    arguments = parser.parse_args()
    streams = [stream(arguments.robot.absolute(), samples) for samples in arguments.samples]
    rates = sweeps(arguments.points)
    if arguments.json:
        dump({"workspaces": [asdict(one) for one in streams], "sweep_points_per_second": rates})
        return
    cells = [
        (
            f"{one.samples:,}",
            f"{1e6 * one.processor / one.samples:.1f}",
            f"{one.samples / one.clock:,.0f}",
            f"{one.memory_before:.0f}",
            f"{one.memory_peak:.0f}",
            f"{one.voxels:,}",
        )
        for one in streams
    ]
    head = ("samples", "µs each (processor)", "per second (clock)", "MiB before", "MiB at most", "voxels")
    notes = [
        f"sweep of {arguments.points} studies, {what}: {rate:,.0f} points per second" for what, rate in rates.items()
    ]
    show([table(f"workspace of {arguments.robot.stem}, streamed to a file", head, cells)], notes)


if __name__ == "__main__":
    main()
