"""Insertions into anatomies made of formulas: planned, proved, looked up voxel by voxel; and the same over a roadmap.

Every plan that is proved is looked up in the image by code of its own: points on the surface of the arm and on its
centreline, at LOOKED_AT instants, none of which may lie in a voxel that is barred. Limits count the work of this
process, whatever else the machine does.

Usage: OPENBLAS_NUM_THREADS=1 python -m benchmarks.anatomy [--queries 100] [--voxel 0.6] [--roadmap 600] [--seed 1]
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import tubeopt
from tubeopt import PlanOptions, SolveError
from tubeopt.bodies.images import LabelImage, field_of_image
from tubeopt.bodies.phantoms import LUMEN, PHANTOMS, TARGET
from tubeopt.inverse.task import Task
from tubeopt.planning import Trajectory, build_roadmap, plan_trajectory
from tubeopt.planning.motion import DEFAULT_RATES
from tubeopt.planning.question import plan_task
from tubeopt.typing import Array, Mask

from .timing import count_work

ROOT = Path(__file__).resolve().parents[1]
WITHDRAWN = np.zeros(3), np.array([-0.033, -0.092, -0.096])
OPTIONS = PlanOptions(clearance=2e-4, time_limit=30)
LOOKED_AT = 60
"""Instants of a plan at which its arm is looked up."""

DRAWS = 8
"""Times that thousands of arms are drawn until there are as many places as asked for, at most."""

DEEP = 0.05
"""Height (m) above the plate beyond which goals lie."""


def places(task: Task, count: int, seed: int) -> Array:
    """(k, m) points of the chart, with room to spare, at which the tip is deep."""
    random, n = np.random.default_rng(seed), task.coordinates.space.robot.n_tubes
    results = np.zeros((0, len(task.scale)))
    for _ in range(DRAWS):
        z = task.coordinates.space.sample(8192)[:9000].copy()
        z[:, :n] = random.uniform(-np.pi, np.pi, (len(z), n))
        arms = task.arms(z)
        deep = np.flatnonzero((task.reserves(z, arms=arms) >= 0.5) & (arms.tip[:, 2] > DEEP))
        results = np.concatenate([results, z[random.permutation(deep)]])
        if len(results) >= count:
            break
    return results[:count]


def barred(plan: Trajectory, image: LabelImage, free: Mask) -> int:
    """Points on the surface of the arm and on its centreline, at some instants, in voxels where it may not be."""
    touched = 0
    for arm in plan.arms[:: max(1, len(plan.arms) // LOOKED_AT)]:
        s = np.linspace(0, arm.arc_length[-1], 300)
        line = np.column_stack([np.interp(s, arm.arc_length, arm.position[:, k]) for k in range(3)])
        frame = arm.frame[np.clip(np.searchsorted(arm.arc_length, s), 0, len(arm.arc_length) - 1)]
        radii = [tube.outer_diameter / 2 for tube in arm.robot.tubes]
        radius = np.where(s[:, None] <= arm.tube_end, radii, 0.0).max(1)[:, None]
        angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)[:, None, None]
        rim = line + radius * (np.cos(angle) * frame[:, :, 0] + np.sin(angle) * frame[:, :, 1])
        index = np.rint(image.frame.seen(np.vstack([rim.reshape(-1, 3), line])) / image.spacing).astype(int)
        touched += int((~free[tuple(index.T)]).sum())
    return touched


Told = list[tuple[float, bool, int]]
"""Of every query its seconds, whether its plan was proved, and points in barred voxels."""


def asked_for(goals: Iterable[Any], plan: Callable[[Any], Trajectory], image: LabelImage, free: Mask) -> Told:
    """Plans to goals, each looked up in the image."""
    out = []
    for goal in goals:
        start_time, result = time.process_time(), None
        try:
            result = plan(goal)
        except SolveError as error:
            print(f"  {error}")
        seconds = time.process_time() - start_time
        out.append((seconds, False, 0) if result is None else (seconds, result.proved, barred(result, image, free)))
        print(f"    {seconds:.2f} s, proved: {out[-1][1]}, in barred voxels: {out[-1][2]}", flush=True)
    return out


def report(words: str, some: Told) -> None:
    """Print what became of queries."""
    seconds, proved, outside = (np.array(column) for column in zip(*some, strict=True))
    half, largest = np.quantile(seconds, [0.5, 0.9])
    print(
        f"{words}: {proved.sum()} of {len(some)} planned and proved, {half:.2f} s (median), {largest:.2f} s (90 %), ",
        end="",
    )
    print(f"{seconds.max():.2f} s at most, {outside.sum()} points in barred voxels", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--queries", type=int, default=100, help="in all; an anatomy has as many as it has places for")
    parser.add_argument("--voxel", type=float, default=0.6, help="mm")
    parser.add_argument("--roadmap", type=int, default=600, help="points")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    count_work()
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "crl_ctr.yaml")
    alone: Told = []
    over: Told = []
    for k, (name, make) in enumerate(PHANTOMS.items()):
        count = math.ceil((args.queries - len(alone)) / (len(PHANTOMS) - k))
        image = make().image(args.voxel * 1e-3)
        free = image.chosen([LUMEN, TARGET])
        bodies = [field_of_image(image, lumen=free)]
        roomy = plan_task(robot, bodies, 0.06, DEFAULT_RATES, None, PlanOptions(clearance=1e-3))
        tips = roomy.arms(places(roomy, count, args.seed)).tip
        plan = partial(plan_trajectory, robot, WITHDRAWN, obstacles=bodies)
        result = asked_for(tips, partial(plan, options=OPTIONS), image, free)
        report(name, result)
        start_time = time.process_time()
        roadmap = build_roadmap(robot, obstacles=bodies, options=OPTIONS, count=args.roadmap)
        drawn = time.process_time() - start_time
        quick = replace(OPTIONS, roadmap=roadmap, objective="none")
        again = asked_for(tips, partial(plan, options=quick), image, free)
        report(f"  over a roadmap of {len(roadmap)} points, drawn in {drawn:.1f} s, not smoothed", again)
        alone, over = alone + result, over + again
    report("all", alone)
    report("all over roadmaps", over)


if __name__ == "__main__":
    main()
