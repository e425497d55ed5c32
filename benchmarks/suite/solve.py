"""tubeopt's answers to the questions, one line each; what is answered already is left alone, so a run may be cut short.

Usage: OPENBLAS_NUM_THREADS=1 python -m benchmarks.suite.solve ANSWERS.jsonl [--kinds inverse plan design]
       [--scene corridor] [--seconds 200] [--limit 30] [--every 1] [--again]
"""

from __future__ import annotations

import argparse
import json
import time
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import tubeopt
from tubeopt import ConcentricRobot, Equilibrium, InputError, InverseOptions, Material, PlanOptions, SolveError, Tube
from tubeopt.bodies.corridors import Corridor
from tubeopt.design import Avoid, Free, Objective, Reach, SnapFree, SnapFreeInUse, Strain, Target

from ..timing import count_work
from .questions import CLEARANCE, KINDS, MARGIN, MM, questions, robots, scenes, withdrawn
from .score import read_answers

TIME_LIMIT = 30.0
"""Seconds of the processor for one question, unless `--limit` says another number."""

SPARE = 0.01 * MM
"""Clearance (m) that is kept beyond what is asked."""


@cache
def robot_of(name: str) -> ConcentricRobot:
    """A robot of the questions, as tubes of a material that has their stiffness."""
    inputs = robots()[name]
    second = np.pi / 64 * (inputs.outer_diameter**4 - inputs.inner_diameter**4)
    tubes = []
    for i in range(inputs.n):
        young, shear = inputs.bending_stiffness[i] / second[i], inputs.torsional_stiffness[i] / (2 * second[i])
        size = inputs.outer_diameter[i], inputs.inner_diameter[i], inputs.straight_length[i], inputs.curved_length[i]
        tubes.append(Tube(*map(float, size), float(inputs.curvature[i]), Material(f"tube {i + 1}", young, shear)))
    return ConcentricRobot(tuple(tubes), name=name)


@cache
def bodies_of(name: str) -> tuple[Corridor, ...]:
    """The wall of a scene: its segments as one polyline, which goes back along every branch."""
    scene = scenes()[name]
    if scene.free:
        return ()
    starts, ends = (list(map(tuple, table.tolist())) for table in (scene.starts, scene.ends))
    line: list[tuple[Any, float]] = []

    def walk(place: Any) -> None:
        for k in (k for k, start in enumerate(starts) if start == place):
            reached, back = (place, float(scene.radii[k, 0])), (ends[k], float(scene.radii[k, 1]))
            line.extend([reached, back])
            walk(ends[k])
            line.extend([back, reached])

    walk(starts[0])
    line = [one for k, one in enumerate(line) if not k or one != line[k - 1]]
    return (Corridor(tuple(place for place, _ in line), tuple(radius for _, radius in line)),)


def _pose(e: Equilibrium) -> dict[str, Any]:
    return {
        "rotations_deg": np.degrees(e.rotations).round(9).tolist(),
        "translations_mm": (e.translations / MM).round(8).tolist(),
        "tip_rotations_deg": np.degrees(e.tip_rotations).round(9).tolist(),
    }


def inverse(question: dict[str, Any], limit: float = TIME_LIMIT) -> dict[str, Any]:
    """The answer to a question of inverse kinematics."""
    bodies = bodies_of(question["scene"])
    options = InverseOptions(clearance=CLEARANCE + SPARE if bodies else 0.0, time_limit=limit)
    answer = tubeopt.inverse_kinematics(
        robot_of(question["robot"]), np.array(question["tip_mm"]) * MM, direction=question.get("direction"),
        obstacles=bodies, min_margin=MARGIN, options=options, on_failure="closest",
    )  # fmt: skip
    return _pose(answer.equilibrium)


def plan(question: dict[str, Any], limit: float = TIME_LIMIT) -> dict[str, Any]:
    """The answer to a question of planning."""
    robot, bodies = robot_of(question["robot"]), bodies_of(question["scene"])
    start = withdrawn(robots()[question["robot"]]) + [tube.straight_length for tube in robot.tubes]
    goal: Any = np.array(question["tip_mm"]) * MM if "tip_mm" in question else None
    if goal is None:
        goal = np.radians(question["rotations_deg"]), np.array(question["translations_mm"]) * MM
    options = PlanOptions(objective="none", clearance=CLEARANCE + SPARE if bodies else 0.0, time_limit=limit)
    plan = tubeopt.plan_trajectory(
        robot, (np.zeros(robot.n_tubes), start), goal, obstacles=bodies, min_margin=MARGIN, options=options
    )
    return {
        "rotations_deg": np.degrees(plan.rotations).round(6).tolist(),
        "translations_mm": (plan.translations / MM).round(6).tolist(),
        "proved": plan.proved,
    }


def design(question: dict[str, Any], _limit: float = TIME_LIMIT) -> dict[str, Any]:
    """The answer to a question of design; where a pose that was found is not the one that a robot takes at once, the
    one that it moves to from the first without a snap."""
    try:
        return _designed(question, paths=False)
    except SolveError:
        if question["kind"] == "snap_free":
            raise
        return _designed(question, paths=True)


def _designed(question: dict[str, Any], *, paths: bool) -> dict[str, Any]:
    robot, bodies = robot_of(question["robot"]), bodies_of(question["scene"])
    low, high = question["curvature_factors"]
    free = [Free("curvature", (i,), low * tube.curvature, high * tube.curvature) for i, tube in enumerate(robot.tubes)]
    if question["kind"] == "reach":
        targets = [Target(tuple(tip), question["tolerance_mm"] * MM) for tip in np.array(question["tips_mm"]) * MM]
        requirements: list[Any] = [Reach(tuple(targets)), SnapFreeInUse(question["margin"], paths=paths)]
        requirements += [Avoid(bodies, CLEARANCE + SPARE)] if bodies else []
        desired = Objective("change")
    else:
        shift = tuple((np.array(question["translations_mm"]) * MM).tolist())
        requirements = [SnapFree(question["margin"], (shift,)), Strain((question["strain_percent"] / 100,))]
        desired = Objective("tip_curvature", translations=shift)
    task = tubeopt.DesignTask(robot, tuple(free), tuple(requirements), desired, ordered=False)
    solution = tubeopt.optimize_design(task, turns=0)
    bend = [float(tube.curvature) for tube in solution.robot.tubes]
    return {"curvature_per_m": bend, "poses": [_pose(e) for e in solution.equilibria]}


ANSWERS = {"inverse": inverse, "plan": plan, "design": design}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("answers", type=Path)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--scene", default="", help="only scenes whose names begin so")
    parser.add_argument("--limit", type=float, default=TIME_LIMIT, help="seconds of the processor for one question")
    parser.add_argument("--seconds", type=float, default=200.0, help="of processor time, after which it stops")
    parser.add_argument("--every", type=int, default=1, help="only every so manieth question of each kind")
    parser.add_argument("--again", action="store_true", help="ask what failed once more")
    args = parser.parse_args()
    known = read_answers(args.answers) if args.answers.exists() else {}
    if args.again:
        known = {name: answer for name, answer in known.items() if "failed" not in answer}
    some = (one for kind in args.kinds for one in list(questions(kind))[:: args.every])
    requested = [one for one in some if one["id"] not in known and one["scene"].startswith(args.scene)]
    count_work()
    until = time.process_time() + args.seconds
    with args.answers.open("a", encoding="utf-8") as file:
        for question in requested:
            if time.process_time() > until:
                break
            start_time = time.process_time()
            try:
                answer = ANSWERS[question["id"].split()[0]](question, args.limit)
            except (InputError, SolveError) as error:
                answer = {"failed": str(error)}
            seconds = round(time.process_time() - start_time, 4)
            file.write(json.dumps({"id": question["id"], "seconds": seconds, **answer}) + "\n")
            file.flush()
    print(f"{len(read_answers(args.answers))} answers in {args.answers}")


if __name__ == "__main__":
    main()
