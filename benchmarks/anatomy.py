"""Insertions into anatomies made of formulas: planned, proved, looked up voxel by voxel; and the same over a roadmap.

Usage: python -m benchmarks.anatomy [--queries 34] [--voxel 0.6] [--roadmap 600] [--seed 1]
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

import tubeopt
from tubeopt import PlanOptions, SolveError
from tubeopt.bodies.anatomy import field_of_image
from tubeopt.bodies.images import LabelImage
from tubeopt.bodies.phantoms import LUMEN, PHANTOMS, TARGET
from tubeopt.inverse.clock import Clock
from tubeopt.inverse.task import Task
from tubeopt.planning import Trajectory, build_roadmap, plan_trajectory
from tubeopt.planning.motion import DEFAULT_RATES
from tubeopt.planning.question import asked
from tubeopt.typing import Array, Mask

ROOT = Path(__file__).resolve().parents[1]
WITHDRAWN = np.zeros(3), np.array([-0.033, -0.092, -0.096])
OPTIONS = PlanOptions(clearance=2e-4, time_limit=30)
DEEP = 0.05
"""Height (m) above the plate beyond which goals lie."""


def places(task: Task, count: int, seed: int) -> Array:
    """(k, m) points of the chart, with room to spare, at which the tip is deep."""
    random, n = np.random.default_rng(seed), task.chart.space.robot.n_tubes
    z = task.chart.space.sample(8192)[:9000].copy()
    z[:, :n] = random.uniform(-np.pi, np.pi, (len(z), n))
    arms = task.arms(z)
    deep = np.flatnonzero((task.spare(z, arms=arms) >= 0.5) & (arms.tip[:, 2] > DEEP))
    return z[random.permutation(deep)[:count]]


def barred(plan: Trajectory, image: LabelImage, free: Mask) -> int:
    """Points of the surface of the arm, at a dozen of times, that lie in voxels where it may not be."""
    touched = 0
    for arm in plan.arms[:: max(1, len(plan.arms) // 12)]:
        s = np.linspace(0, arm.arc_length[-1], 300)
        line = np.column_stack([np.interp(s, arm.arc_length, arm.position[:, k]) for k in range(3)])
        frame = arm.frame[np.clip(np.searchsorted(arm.arc_length, s), 0, len(arm.arc_length) - 1)]
        radii = [tube.outer_diameter / 2 for tube in arm.robot.tubes]
        radius = np.where(s[:, None] <= arm.tube_end, radii, 0.0).max(1)[:, None]
        angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)[:, None, None]
        rim = line + radius * (np.cos(angle) * frame[:, :, 0] + np.sin(angle) * frame[:, :, 1])
        index = np.rint(image.frame.seen(rim.reshape(-1, 3)) / image.spacing).astype(int)
        touched += int((~free[tuple(index.T)]).sum())
    return touched


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--queries", type=int, default=34, help="per anatomy")
    parser.add_argument("--voxel", type=float, default=0.6, help="mm")
    parser.add_argument("--roadmap", type=int, default=600, help="points")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "crl_ctr.yaml")
    for name, make in PHANTOMS.items():
        image = make().image(given.voxel * 1e-3)
        free = image.chosen([LUMEN, TARGET])
        bodies = [field_of_image(image, lumen=free)]
        roomy, _ = asked(robot, bodies, 0.06, DEFAULT_RATES, None, PlanOptions(clearance=1e-3))
        goals = places(roomy, given.queries, given.seed)
        tips = roomy.arms(goals).tip
        seconds, proved, outside = [], 0, 0
        for tip in tips:
            began = time.process_time()
            try:
                plan = plan_trajectory(robot, WITHDRAWN, tip, obstacles=bodies, options=OPTIONS)
                proved, outside = proved + plan.proved, outside + barred(plan, image, free)
            except SolveError as error:
                print(f"  {error}")
            seconds.append(time.process_time() - began)
        half, most = np.quantile(seconds, [0.5, 0.9])
        print(
            f"{name}: {proved} of {len(tips)} planned and proved, {half:.2f} s (median), {most:.2f} s (90 %), ", end=""
        )
        print(f"{outside} points in barred voxels", flush=True)
        over_a_roadmap(robot, bodies, goals, given.roadmap)


def over_a_roadmap(robot: tubeopt.ConcentricRobot, bodies: list[object], goals: Array, count: int) -> None:
    """Print how long ways over a roadmap take."""
    began = time.process_time()
    roadmap = build_roadmap(robot, obstacles=bodies, options=OPTIONS, count=count)  # type: ignore[arg-type]
    drawn = time.process_time() - began
    task, _ = asked(robot, bodies, 0.05, DEFAULT_RATES, None, OPTIONS)  # type: ignore[arg-type]
    start = task.chart.of(tubeopt.forward_kinematics(robot, *WITHDRAWN))
    seconds, found = [], 0
    for goal in goals:
        own = task.from_to(start, goal)
        began = time.process_time()
        found += roadmap.way(own, start, [goal], Clock(10)).points is not None
        seconds.append(time.process_time() - began)
    half, most = np.quantile(seconds, [0.5, 1.0])
    print(f"  roadmap of {len(roadmap)} points in {drawn:.1f} s: {found} of {len(goals)} ways, ", end="")
    print(f"{half * 1e3:.0f} ms (median), {most * 1e3:.0f} ms at most", flush=True)


if __name__ == "__main__":
    main()
