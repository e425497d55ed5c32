"""Planning on the robot of the thesis: random queries whose straight joint path snaps, and corridors.

Usage: python -m benchmarks.planning [--queries 50] [--corridors 10] [--timed 40] [--seed 0]

With `--timed`, plans of random queries for three robots, free and among spheres, are held against the least time that
the path of each can take, by a convex program of its own; at corners a path is passed at rest.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

import tubeopt
from tests.planning.test_plan import least_time
from tubeopt import ConcentricRobot, Equilibrium, SolveError
from tubeopt.bodies.corridors import Corridor
from tubeopt.bodies.obstacles import Obstacle, Sphere
from tubeopt.inverse.joints import JointSpace, joint_space
from tubeopt.planning import PlanOptions, Trajectory, plan_trajectory

ROOT = Path(__file__).resolve().parents[1]
MARGIN = 0.05


def random_equilibrium(space: JointSpace, random: np.random.Generator) -> Equilibrium:
    """An admissible equilibrium with the margin to keep; rotations within half a turn."""
    n = space.robot.n_tubes
    while True:
        q = space.lower + random.random(len(space.lower)) * (space.upper - space.lower)
        q[:n] = random.uniform(-np.pi, np.pi, n)
        if not space.admissible(q):
            continue
        try:
            equilibrium = tubeopt.forward_kinematics(space.robot, *space.split(q))
        except SolveError:
            continue
        if equilibrium.margin >= MARGIN + 0.005:
            return equilibrium


def straight_snaps(start: Equilibrium, goal: Equilibrium) -> bool:
    """Whether the straight path of joint values snaps, or ends on another branch."""
    ends = (start.rotations, start.translations), (goal.rotations, goal.translations)
    return tubeopt.find_snap(start.robot, *ends, equilibrium=start) is not None


def queries(robot: ConcentricRobot, count: int, seed: int) -> tuple[list[tuple[Equilibrium, Equilibrium]], int]:
    """Pairs of equilibria whose straight path snaps, and how many pairs were drawn for them."""
    space, random = joint_space(robot), np.random.default_rng(seed)
    results: list[tuple[Equilibrium, Equilibrium]] = []
    drawn = 0
    while len(results) < count:
        pair = random_equilibrium(space, random), random_equilibrium(space, random)
        drawn += 1
        if straight_snaps(*pair):
            results.append(pair)
    return results, drawn


def run_queries(robot: ConcentricRobot, count: int, seed: int, options: PlanOptions) -> None:
    """Plan all of them, and print what came of it."""
    pairs, drawn = queries(robot, count, seed)
    safe = drawn - count
    print(f"{drawn} random pairs: the straight joint path of {safe} ({safe / drawn:.0%}) does not snap")
    plans: list[Trajectory] = []
    for k, (start, goal) in enumerate(pairs):
        start_time = time.perf_counter()
        try:
            plan = plan_trajectory(robot, start, goal, min_margin=MARGIN, options=options)
        except SolveError as error:
            print(f"{k:3d} {time.perf_counter() - start_time:6.2f} s  {error}", flush=True)
            continue
        plans.append(plan)
        s = plan.statistics
        print(
            f"{k:3d} {s.seconds:6.2f} s  {s.how:8s} {s.smoothed or 'rests':8s} "
            f"length {s.raw_length:6.2f} -> {s.length:6.2f}  margin {plan.proof.least_margin:.4f}  "
            f"proved {plan.proof.holds}",
            flush=True,
        )
    seconds = np.array([plan.statistics.seconds for plan in plans])
    shorter = np.array([1 - plan.statistics.length / plan.statistics.raw_length for plan in plans])
    print(
        f"solved {len(plans)} of {count}, all proved: {all(plan.proof.holds for plan in plans)}; "
        f"median {np.median(seconds):.2f} s, worst {seconds.max():.2f} s; "
        f"joint path shorter by {np.median(shorter):.0%} (median); "
        f"smoothed {sum(bool(plan.statistics.smoothed) for plan in plans)}"
    )


def corridor_scene(robot: ConcentricRobot, seed: int) -> tuple[Equilibrium, Equilibrium, Corridor]:
    """A vessel around a random advanced arm, and the arm withdrawn into its beginning."""
    space, random = joint_space(robot), np.random.default_rng(seed)
    while True:
        goal = random_equilibrium(space, random)
        length = goal.arc_length[-1]
        if length < 0.15:
            continue
        ahead = goal.tip_position + 0.02 * goal.tip_rotation[:, 2]
        positions = np.linspace(0, length, 16)
        line = np.column_stack([np.interp(positions, goal.arc_length, goal.position[:, k]) for k in range(3)])
        vessel = Corridor(tuple(map(tuple, np.vstack([[[0, 0, -0.03]], line, ahead[None]]).tolist())), 0.012)
        shift = -0.85 * np.array([tube.curved_length for tube in robot.tubes])
        rotations = goal.rotations + random.uniform(-0.6, 0.6, robot.n_tubes)
        q = space.join(rotations, shift)
        if not space.admissible(q):
            continue
        start = tubeopt.forward_kinematics(robot, rotations, shift)
        if vessel.signed_distance(start.position).min() > 0.003:
            return start, goal, vessel


def surface_clearance(plan: Trajectory, vessel: Corridor) -> float:
    """Least distance of points of the arm's surface from the wall, m, by code of its own.

    Waypoints four times as dense, followed by `follow`; 12 points around and 600 along; distances from the segments of
    the centreline written out here.
    """
    rows = np.linspace(0, len(plan.time) - 1, 4 * len(plan.time))
    at = np.arange(len(plan.time))
    alpha, shift = (
        np.column_stack([np.interp(rows, at, column) for column in table.T])
        for table in (plan.rotations, plan.translations)
    )
    walked = tubeopt.follow(plan.robot, alpha, shift, start=plan.start)
    assert not walked.snaps
    line = np.array(vessel.centreline)
    a, along = line[:-1], np.diff(line, axis=0)
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)[:, None, None]
    smallest = np.inf
    for e in walked.equilibria:
        s = np.linspace(0, e.arc_length[-1], 600)
        centre = np.column_stack([np.interp(s, e.arc_length, e.position[:, k]) for k in range(3)])
        x, y = (np.column_stack([np.interp(s, e.arc_length, e.frame[:, k, c]) for k in range(3)]) for c in (0, 1))
        size = np.zeros(len(s))
        for tube, end in zip(plan.robot.tubes, e.tube_end, strict=True):
            size = np.where(s <= end, np.maximum(size, tube.outer_diameter / 2), size)
        points = (centre + size[:, None] * (np.cos(angle) * x + np.sin(angle) * y)).reshape(-1, 1, 3)
        fraction = np.clip(((points - a) * along).sum(2) / (along**2).sum(1), 0, 1)
        apart = np.linalg.norm(points - a - fraction[..., None] * along, axis=2).min(1)
        smallest = min(smallest, vessel.radius - float(apart.max()))
    return smallest


def run_corridors(robot: ConcentricRobot, count: int, seed: int) -> None:
    """Plan into vessels, and print what came of it."""
    for k in range(count):
        start, goal, vessel = corridor_scene(robot, seed + k)
        start_time = time.perf_counter()
        try:
            plan = plan_trajectory(
                robot, start, goal, obstacles=[vessel], options=PlanOptions(clearance=1e-3, time_limit=60.0)
            )
        except SolveError as error:
            print(f"corridor {k}: {time.perf_counter() - start_time:.2f} s  {error}", flush=True)
            continue
        s = plan.statistics
        print(
            f"corridor {k}: {s.seconds:6.2f} s  {s.how:8s} {s.smoothed or 'rests':8s} "
            f"length {s.raw_length:6.2f} -> {s.length:6.2f}  "
            f"clearance {plan.proof.measured_clearance * 1e3:.3f} mm (bound {plan.proof.least_clearance * 1e3:.3f}, "
            f"sampled independently {surface_clearance(plan, vessel) * 1e3:.3f})  "
            f"proved {plan.proof.holds}",
            flush=True,
        )


TIMED = tuple((name, bodies) for name in ("thesis_ctr", "crl_ctr", "two_tube") for bodies in (0, 10))
"""Robots, and spheres about them."""


CORNER = 0.2
"""Change of a path's direction (rad, joints over their scales) from one sample to the next that is a corner."""


def over_least(plan: Trajectory) -> float:
    """Duration of a plan, over the least that its own path can take; at a corner everything has to rest."""
    space = joint_space(plan.robot)
    q = np.array([space.join(*row) for row in zip(plan.rotations, plan.translations, strict=True)]) / space.scale
    q = q[np.append(True, np.linalg.norm(np.diff(q, axis=0), axis=1) > 1e-7)]
    along = np.diff(q, axis=0) / np.linalg.norm(np.diff(q, axis=0), axis=1)[:, None]
    corners = 1 + np.flatnonzero((along[1:] * along[:-1]).sum(1) < np.cos(CORNER))
    rate, largest = (limit / space.scale for limit in plan.rate_limits.of(space))
    ends = pairwise([0, *corners.tolist(), len(q) - 1])
    return float(plan.time[-1] / sum(least_time(q[a : b + 1], rate, largest) for a, b in ends))


def spheres_beside(ends: Sequence[Equilibrium], count: int, random: np.random.Generator) -> list[Obstacle]:
    """Spheres of 3 mm, 6 mm from the centrelines at both ends."""
    results: list[Obstacle] = []
    while len(results) < count:
        centre = random.uniform([-0.12, -0.12, 0.0], [0.12, 0.12, 0.25])
        if min(np.linalg.norm(e.position - centre, axis=1).min() for e in ends) > 9e-3:
            results.append(Sphere(tuple(centre.tolist()), 3e-3))
    return results


def run_timed(count: int, seed: int) -> None:
    """How much longer than their own paths need plans take, by turns of robots, spheres and objectives."""
    random, failed = np.random.default_rng(seed), 0
    fractions: dict[tuple[str, int], list[float]] = {scene: [] for scene in TIMED}
    robots = {name: tubeopt.load_robot(ROOT / "configs" / "robots" / f"{name}.yaml") for name, _ in TIMED}
    while (done := sum(map(len, fractions.values()))) < count:
        name, bodies = TIMED[(done + failed) % len(TIMED)]
        space = joint_space(robots[name])
        ends = random_equilibrium(space, random), random_equilibrium(space, random)
        options = PlanOptions(objective=("length", "time")[(done // len(TIMED)) % 2])
        try:
            obstacles = spheres_beside(ends, bodies, random)
            plan = plan_trajectory(space.robot, *ends, obstacles=obstacles, options=options)
        except SolveError:
            failed += 1
            continue
        fractions[name, bodies].append(over_least(plan))
    for (name, bodies), result in fractions.items():
        if result:
            print(f"{name}, {bodies} spheres: {len(result)} plans, at most {max(result):.4f} of the least time")
    worst = max(map(max, filter(None, fractions.values())))
    print(f"{count} plans, {failed} queries without one: at most {worst:.4f} of the least time, asked was 1.05")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--queries", type=int, default=50)
    parser.add_argument("--corridors", type=int, default=10)
    parser.add_argument("--timed", type=int, default=0, help="queries timed against the least that their paths take")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--method", default="auto")
    chosen = parser.parse_args()
    thesis = tubeopt.load_robot(ROOT / "configs" / "robots" / "thesis_ctr.yaml")
    assert isinstance(thesis, ConcentricRobot)
    if chosen.queries:
        run_queries(thesis, chosen.queries, chosen.seed, PlanOptions(method=chosen.method))
    if chosen.timed:
        run_timed(chosen.timed, chosen.seed)
    run_corridors(thesis, chosen.corridors, chosen.seed)
