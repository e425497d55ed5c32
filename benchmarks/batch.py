"""Time, accuracy and memory of batches of forward kinematics, beside SciPy's `solve_bvp` in the same run.

    python -m benchmarks.batch [--robot FILE ...] [--solves N] [--bvp N] [--most N] [--json]

Configurations are random: rotations a turn to either side, carriages and ends in order. The time per configuration is
processor time of one thread divided by their number, margin, shape at the tip, energy and error estimates included;
throughput is by the clock, with one and two workers. `solve_bvp` solves some of them cold, at a tolerance of about the
same accuracy, without margin. The error of the tip is the distance to shooting with DOP853 at 3e-14. Peak memory is
that of a new process that solves so many configurations.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from tubeopt import ConcentricRobot, forward_kinematics, forward_kinematics_batch, load_robot

from .forward_kinematics import solve_bvp
from .joints import ordered_joints
from .shooting import shoot
from .timing import ROOT, clock, dump, fresh_process, show, summarise, table

ROBOTS = tuple(ROOT / "configs" / "robots" / f"{name}.yaml" for name in ("thesis_ctr", "crl_ctr"))

TARGET, RATIO, PEER = 60e-6, 1000, 126e-6
"""Seconds per configuration and core, times as fast as `solve_bvp`, and what compiled code of others takes per solve
without a margin, at an error of 50 micrometres (s)."""

BVP_TOLERANCES = (1e-9, 1e-10)
"""Of `solve_bvp`: tips a few times less accurate in the median than those of the batch, and about as accurate."""

MEMORY = """
import numpy as np
from tubeopt import forward_kinematics_batch, load_robot
robot = load_robot({path!r})
rotations = np.random.default_rng(0).uniform(-3, 3, ({count}, robot.n_tubes))
forward_kinematics_batch(robot, rotations)
# The peak of this process alone: getrusage would tell that of the one that started it, were it larger.
print(next(int(line.split()[1]) / 1024 for line in open("/proc/self/status") if line.startswith("VmHWM")))
"""


@dataclass(frozen=True)
class Measurement:
    """What was measured of one robot; times in s, lengths in m, memory in MiB."""

    robot: str
    solves: int
    per_solve: float
    per_second: dict[int, float]
    converged: int
    stable: int
    least_margin: float
    largest_error: float
    checked: int
    bvp: dict[float, float]
    memory: dict[int, float]


def measure(robot: ConcentricRobot, path: Path, solves: int, bvps: int, most: int) -> Measurement:
    """All numbers of one robot."""
    alpha, shift = ordered_joints(robot, solves)
    forward_kinematics_batch(robot, alpha[:10], shift[:10])
    seconds = [clock(lambda: forward_kinematics_batch(robot, alpha, shift)) for _ in range(3)]
    many = seconds[0][1]
    rate = {}
    for workers in (1, 2):
        start_time = time.perf_counter()
        forward_kinematics_batch(robot, alpha, shift, workers=workers)
        rate[workers] = solves / (time.perf_counter() - start_time)
    chosen = np.linspace(0, solves - 1, min(200, solves)).astype(int)
    errors = []
    for k in chosen:
        start = forward_kinematics(robot, alpha[k], shift[k]).torsion[:, 0]
        errors.append(np.linalg.norm(many.tip_position[k] - shoot(robot, alpha[k], shift[k], start).tip_position))
    joints = list(zip(alpha[:bvps], shift[:bvps], strict=True))
    runs = {tol: solve_bvp(robot, joints, tol, jacobians=False, warm=False) for tol in BVP_TOLERANCES}
    counts = [n for n in (10_000, 100_000, 1_000_000) if n <= most]
    return Measurement(
        robot=robot.name,
        solves=solves,
        per_solve=min(s for s, _ in seconds) / solves,
        per_second=rate,
        converged=int(many.converged.sum()),
        stable=int(many.stable.sum()),
        least_margin=float(many.margin.min()),
        largest_error=float(np.max(errors)),
        checked=len(errors),
        bvp={tol: summarise(s for s, _ in result).median for tol, result in runs.items()},
        memory={n: fresh_process(MEMORY.format(path=str(path), count=n), 1).median for n in counts},
    )


def verdicts(m: Measurement) -> list[str]:
    """Every target beside what was measured."""
    ratios = {tol: seconds / m.per_solve for tol, seconds in m.bvp.items()}
    return [
        f"{m.robot}: {1e6 * m.per_solve:.1f} us per configuration and core, margin included; target "
        f"{1e6 * TARGET:.0f} us: {'reached' if m.per_solve <= TARGET else 'MISSED'}",
        *(
            f"{m.robot}: solve_bvp (tol {tol:g}, cold) {1e3 * m.bvp[tol]:.1f} ms, {ratio:.0f} times as long; target "
            f"{RATIO}: {'reached' if ratio >= RATIO else 'MISSED'}"
            for tol, ratio in ratios.items()
        ),
        f"{m.robot}: {m.converged} of {m.solves} converged, {m.stable} stable, least margin {m.least_margin:.3f}; tips "
        f"within {m.largest_error:.1e} m of shooting on {m.checked}",
    ]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.batch", description=__doc__.split("\n")[0])
    parser.add_argument("--robot", type=Path, action="append", help="robot file; default: thesis CTR and CRL CTR")
    parser.add_argument("--solves", type=int, default=10_000, help="configurations (default 10000)")
    parser.add_argument("--bvp", type=int, default=20, help="solves by solve_bvp (default 20)")
    parser.add_argument("--most", type=int, default=1_000_000, help="largest batch whose memory is measured")
    parser.add_argument("--json", action="store_true", help="print JSON instead of tables")
    arguments = parser.parse_args()
    rows = []
    for path in arguments.robot or ROBOTS:
        robot = load_robot(path)
        if not isinstance(robot, ConcentricRobot):
            parser.error(f"{path} is not a concentric robot; the reference and solve_bvp are written for those")
        rows.append(measure(robot, path, arguments.solves, arguments.bvp, arguments.most))
    if arguments.json:
        dump({"rows": [asdict(row) for row in rows]})
        return
    head = ("", "us / solve", "solves / s", "with 2 workers", "compiled peers, us", "peak MiB at N")
    cells = [
        (
            m.robot,
            f"{1e6 * m.per_solve:.1f}",
            f"{m.per_second[1]:.0f}",
            f"{m.per_second[2]:.0f}",
            f"{1e6 * PEER:.0f}",
            ", ".join(f"{n:g}: {size:.0f}" for n, size in m.memory.items()),
        )
        for m in rows
    ]
    show([table("Batches of forward kinematics", head, cells)], [line for m in rows for line in verdicts(m)])


if __name__ == "__main__":
    main()
