"""Motions in the least time around a sphere exactly on the path of the tip: success, durations and times.

    python -m benchmarks.motion [--robots two_tube thesis_ctr] [--tasks 20] [--knots 9] [--json]

Start and goal are random configurations of a robot. The least time without bodies gives the path of the tip. The sphere
is in its middle. Motions have the default rates, a margin of 0.1, and a clearance of 1 mm. Every answer is a proved
trajectory. Times are processor times of one thread.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

import tubeopt
from tubeopt.robots.robot import Robot

from .timing import ROOT, dump, show, table

RADIUS, CLEARANCE, MARGIN = 5e-3, 1e-3, 0.1
"""Largest radius of the sphere and clearance, m, and margin."""

SHORT_CURVE, SMALL_RADIUS = 0.03, 1e-3
"""Length (m) of the shortest curve below which the sphere has the second radius, m: paths of the tip are 10 mm long."""


@dataclass(frozen=True)
class Task:
    """One motion: durations without and with the sphere, s, processor time, s, and the failure, if any."""

    free: float
    duration: float
    seconds: float
    failure: str


def motion(robot: Robot, start: Any, goal: Any, knots: int, bodies: list[Any]) -> tubeopt.Trajectory:
    """Least time from an equilibrium to the tip of another one."""
    problem = tubeopt.Problem("least time")
    composed = tubeopt.Motion(problem, robot, knots, min_margin=MARGIN)
    composed.start(start)
    composed.goal(tip_position=goal.tip_position)
    composed.limit(tubeopt.RateLimits())
    if bodies:
        composed.keep_clear(bodies, CLEARANCE)
    problem.minimize(composed.duration)
    return composed.solve()


def run(robot: Robot, seed: int, knots: int) -> Task | None:
    """Task of a seed; None if start, goal or sphere make no task."""
    rng = np.random.default_rng(seed)
    curves = [tube.curved_length for tube in robot.tubes]
    # Withdrawn past the plate, by more than its curve, a tube makes no task.
    reach = min(max(tube.straight_length for tube in robot.tubes), 2 * min(curves))
    radius = RADIUS if min(curves) > SHORT_CURVE else SMALL_RADIUS
    ends = []
    for _ in range(2):
        # Tubes that are withdrawn together are in order.
        shift = np.full(robot.n_tubes, -reach * rng.uniform(0.1, 0.8))
        ends.append(tubeopt.forward_kinematics(robot, rng.uniform(-1.5, 1.5, robot.n_tubes), shift))
    try:
        free = motion(robot, ends[0], ends[1], knots, [])
    except (tubeopt.SolveError, tubeopt.InputError):
        return None
    path = free.tip_position
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1)))
    centre = np.array([np.interp(along[-1] / 2, along, column) for column in path.T])
    if min(np.linalg.norm(path[k] - centre) for k in (0, -1)) < 3 * radius:
        return None
    begin = time.process_time()
    try:
        around = motion(robot, ends[0], ends[1], knots, [tubeopt.Sphere(tuple(centre), radius)])
    except tubeopt.InputError:
        # The arm at the start touches the sphere.
        return None
    except tubeopt.SolveError as error:
        return Task(float(free.time[-1]), np.nan, time.process_time() - begin, str(error))
    return Task(float(free.time[-1]), float(around.time[-1]), time.process_time() - begin, "")


def main() -> None:
    """Print success and times of every robot."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", nargs="+", default=["two_tube", "thesis_ctr", "endonasal_ctr"])
    parser.add_argument("--tasks", type=int, default=20)
    parser.add_argument("--knots", type=int, default=9)
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args()
    results: dict[str, list[Task]] = {}
    for name in options.robots:
        robot = tubeopt.load_robot(ROOT / "configs" / "robots" / f"{name}.yaml")
        tasks = results.setdefault(name, [])
        for seed in range(10 * options.tasks):
            if len(tasks) == options.tasks:
                break
            task = run(robot, seed, options.knots)
            if task is not None:
                tasks.append(task)
                if not options.json:
                    print(f"{name}, seed {seed}: {task}", flush=True)
    if options.json:
        dump({name: [asdict(task) for task in tasks] for name, tasks in results.items()})
        return
    columns = "robot", "proved", "median s", "slowest s", "median duration with / without sphere"
    rows = [
        (
            name,
            f"{sum(not task.failure for task in tasks)} of {len(tasks)}",
            f"{np.median([task.seconds for task in tasks]):.1f}",
            f"{max(task.seconds for task in tasks):.1f}",
            f"{np.nanmedian([task.duration / task.free for task in tasks]):.3f}",
        )
        for name, tasks in results.items()
    ]
    show([table("a sphere on the path", columns, rows)], [])


if __name__ == "__main__":
    main()
