"""Inverse kinematics: how many random targets are solved, how fast, and beside damped least squares on differences.

Run it as `OPENBLAS_NUM_THREADS=1 python -m benchmarks.inverse` from the root of the project. A target is the tip of a
random stable configuration (margin at least 0.1, uniform in the ranges, tubes in order). Every answer is checked by
forward kinematics from its joint values.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial

import numpy as np

from benchmarks.joints import STEP, circle
from benchmarks.timing import Timing, clock, dump, milliseconds, show, summarise, table
from tests.examples import CRL, THESIS, TWO_TUBE
from tests.inverse_targets import inside, reachable
from tubeopt import Equilibrium, IkSession, InverseOptions, SolveError, follow, forward_kinematics, inverse_kinematics
from tubeopt.robots.robot import Robot
from tubeopt.typing import Array

TARGETS = {"solved cold": 0.995, "with direction": 0.98, "cold": 60e-3, "servo step": 3e-3}
"""Shares of targets solved, and most seconds of the median."""


@dataclass(frozen=True)
class Cold:
    """One robot, one kind of target: how many were solved, and how the answers are."""

    robot: str
    what: str
    targets: int
    solved: int
    worst_error: float
    least_margin: float
    cold_agrees: int
    timing: Timing


def cold(robot: Robot, what: str, count: int, options: InverseOptions, *, pointed: bool = False) -> Cold:
    """Random targets, each from nothing; answers checked by forward kinematics."""
    desired = list(reachable(robot, count, seed=11))
    inverse_kinematics(robot, desired[0].tip_position)
    times, errors, margins, agreeing, solved = [], [0.0], [1.0], 0, 0
    for e in desired:
        direction = e.tip_rotation[:, 2] if pointed else None
        question = partial(inverse_kinematics, robot, e.tip_position, direction=direction, options=options)
        try:
            seconds, answer = clock(question)
        except SolveError:
            continue
        times.append(seconds)
        again = forward_kinematics(robot, answer.rotations, answer.translations, start=answer.equilibrium)
        fresh = forward_kinematics(robot, answer.rotations, answer.translations)
        error = float(np.linalg.norm(again.tip_position - e.tip_position))
        turned = float(np.linalg.norm(again.tip_rotation[:, 2] - e.tip_rotation[:, 2])) if pointed else 0.0
        retained = inside(robot, answer.rotations, answer.translations) and again.margin >= 0.05
        solved += error <= 1e-7 and turned <= 1e-6 and retained
        agreeing += bool(np.linalg.norm(fresh.tip_position - e.tip_position) <= 1e-7)
        errors.append(error)
        margins.append(again.margin)
    return Cold(robot.name, what, count, solved, max(errors), min(margins), agreeing, summarise(times))


@dataclass(frozen=True)
class Servo:
    """Steps along a path: times, worst error, least margin, snaps that `follow` finds on the way."""

    robot: str
    what: str
    timing: Timing
    worst_error: float
    least_margin: float
    snaps: int
    solves: float
    steps: int


def servo(robot: Robot, targets: Array) -> Servo:
    """The session, step by step."""
    session = IkSession(robot, min_margin=0.1)
    first = session.solve(targets[0])
    times, answers = [], [first]
    for target in targets[1:]:
        seconds, answer = clock(partial(session.solve, target))
        times.append(seconds)
        answers.append(answer)
    equilibria = [each.equilibrium for each in answers]
    errors = [each.position_error for each in answers]
    solves = float(np.mean([each.statistics.solves for each in answers[1:]]))
    return _servo(robot, "IkSession", (times, equilibria, errors, solves))


def differences(robot: Robot, targets: Array) -> Servo:
    """Damped least squares on finite differences of the same forward kinematics: no limits, no margin."""
    start = inverse_kinematics(robot, targets[0]).equilibrium
    times, path, errors, solves = [], [start], [0.0], 0
    for target in targets[1:]:
        try:
            seconds, (current, count) = clock(partial(damped_step, robot, path[-1], target))
        except SolveError:
            break  # the branch ends: this robot would snap here
        times.append(seconds)
        path.append(current)
        errors.append(float(np.linalg.norm(current.tip_position - target)))
        solves += count
    return _servo(robot, "damped, differences", (times, path, errors, solves / len(times)))


def damped_step(robot: Robot, here: Equilibrium, target: Array) -> tuple[Equilibrium, int]:
    """Damped least squares to the target, and the equilibria solved."""
    n, step, solves = robot.n_tubes, 1e-6, 0
    scale = np.concatenate([np.ones(n), np.full(n, max(tube.length for tube in robot.tubes) / 2)])
    for _ in range(20):
        gap = target - here.tip_position
        if np.linalg.norm(gap) <= 2e-9:
            break
        q = np.concatenate([here.rotations, here.translations])
        columns = []
        for k in range(2 * n):
            moved = q.copy()
            moved[k] -= step * scale[k]
            reached = forward_kinematics(robot, moved[:n], moved[n:], start=here)
            columns.append((here.tip_position - reached.tip_position) / step)
        slope = np.column_stack(columns)
        solves += 2 * n + 1
        q = q + scale * (slope.T @ np.linalg.solve(slope @ slope.T + 1e-8 * np.eye(3), gap))
        q[n:] = np.minimum(q[n:], [tube.straight_length for tube in robot.tubes])
        here = forward_kinematics(robot, q[:n], q[n:], start=here)
    return here, solves


def _servo(robot: Robot, what: str, run: tuple[list[float], list[Equilibrium], list[float], float]) -> Servo:
    times, path, errors, solves = run
    motion = follow(robot, [e.rotations for e in path], [e.translations for e in path], start=path[0])
    smallest = min(e.margin for e in path)
    return Servo(robot.name, what, summarise(times), max(errors), smallest, len(motion.snaps), solves, len(times))


def main() -> None:
    """Measure, print, and say what misses its target."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--targets", type=int, default=1000, help="random targets per robot")
    parser.add_argument("--steps", type=int, default=1000, help="steps of the servo path")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    results: list[Cold] = []
    plain, program = InverseOptions(), InverseOptions(method="nlp")
    for robot in (THESIS, CRL, TWO_TUBE):
        results.append(cold(robot, "position", options.targets, plain))
        results.append(cold(robot, "position and direction", options.targets, plain, pointed=True))
        results.append(cold(robot, "position, program alone", max(options.targets // 10, 1), program))
    runs: list[Servo] = []
    paths = ((THESIS, (0.055, 0.02, 0.15), 0.03), (CRL, (0.03, 0.0, 0.11), 0.015))
    methods: tuple[Callable[[Robot, Array], Servo], ...] = (servo, differences)
    for robot, centre, radius in paths:
        for method in methods:
            runs.append(method(robot, circle(centre, radius, options.steps)))
    if options.json:
        dump({"targets": TARGETS, "cold": [asdict(each) for each in results], "servo": [asdict(each) for each in runs]})
        return
    columns = (
        "robot, target",
        "solved",
        "ms median",
        "ms 9th decile",
        "worst error (m)",
        "least margin",
        "cold agrees",
    )
    rows = [
        (
            f"{c.robot}, {c.what}",
            f"{c.solved} of {c.targets}",
            milliseconds(c.timing.median),
            milliseconds(c.timing.slow),
            f"{c.worst_error:.1e}",
            f"{c.least_margin:.3f}",
            f"{c.cold_agrees}",
        )
        for c in results
    ]
    names = (
        "robot, method",
        "steps",
        "ms median",
        "ms 9th decile",
        "worst error (m)",
        "least margin",
        "snaps",
        "solves per step",
    )
    steps = [
        (
            f"{s.robot}, {s.what}",
            f"{s.steps}",
            milliseconds(s.timing.median),
            milliseconds(s.timing.slow),
            f"{s.worst_error:.1e}",
            f"{s.least_margin:.3f}",
            f"{s.snaps}",
            f"{s.solves:.1f}",
        )
        for s in runs
    ]
    show(
        [table("from nothing", columns, rows), table(f"steps of {STEP * 1e3} mm", names, steps)], _missed(results, runs)
    )


def _missed(found: list[Cold], runs: list[Servo]) -> list[str]:
    notes = []
    for c in found:
        fraction = TARGETS["with direction" if "direction" in c.what else "solved cold"]
        if c.solved < fraction * c.targets:
            notes.append(f"{c.robot}, {c.what}: solves {c.solved / c.targets:.1%}, wanted {fraction:.1%}")
        if c.timing.median > TARGETS["cold"]:
            notes.append(
                f"{c.robot}, {c.what}: takes {c.timing.median * 1e3:.0f} ms, wanted {TARGETS['cold'] * 1e3:.0f}"
            )
    for s in runs:
        if s.what == "IkSession" and (s.timing.median > TARGETS["servo step"] or s.snaps):
            notes.append(f"{s.robot}: a step takes {s.timing.median * 1e3:.2f} ms, {s.snaps} snaps")
    return notes or ["all targets are met"]


if __name__ == "__main__":
    main()
