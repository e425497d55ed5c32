"""Random seeds, starts and goals for inverse kinematics and planning: an answer begins where it was asked to.

    python .ci/joint_values.py [count] [seed]

The robots are those of configs/robots. Joint values are within limits, at their ends, at home, beyond them, out of
order, wholly withdrawn, or have the carriages of equally long tubes apart. Each question ends with an answer, or with a
sentence.
"""

from __future__ import annotations

import sys
import traceback
import warnings
from collections import Counter
from pathlib import Path

import numpy as np

import tubeopt
from tubeopt.errors import InputError, SolveError
from tubeopt.inverse import InverseOptions
from tubeopt.inverse.joints import joint_space
from tubeopt.robots.robot import Robot
from tubeopt.typing import Array

ROBOTS = sorted((Path(__file__).parents[1] / "configs" / "robots").glob("*.yaml"))
KINDS = ("inside", "inside", "apart", "at an end", "home", "beyond", "out of order", "withdrawn", "apart")
PLAN = tubeopt.PlanOptions(time_limit=3.0)
INVERSE = InverseOptions(time_limit=1.0)


def drawn(robot: Robot, kind: str, random: np.random.Generator) -> tuple[Array, Array]:
    """Rotations and translations (n,) of a kind."""
    space, n = joint_space(robot), robot.n_tubes
    few = space.sample(32)
    rotations, shift = space.split(few[random.integers(len(few))])
    rotations, moved = np.array(rotations), np.array(shift)
    curved = np.array([tube.curved_length for tube in robot.tubes])
    k = int(random.integers(n))
    match kind:
        case "at an end":
            rotations[k] = space.ranges[int(random.integers(2)), k]
        case "home":
            return robot.home_rotations, robot.home_translations
        case "beyond":
            rotations[k] += 20.0
        case "out of order":
            moved[k] = random.uniform(-curved[k], robot.tubes[k].straight_length)
        case "withdrawn":
            moved = -curved
        case "apart":
            moved[0] -= random.uniform(0.0, 0.3) * (moved[0] + curved[0])
    return rotations, moved


def plans(robot: Robot, random: np.random.Generator, kinds: tuple[str, str]) -> str:
    """What came of a plan between joint values of two kinds."""
    start, goal = (drawn(robot, kind, random) for kind in kinds)
    plan = tubeopt.plan_trajectory(robot, start, goal, options=PLAN)
    for row, position in ((0, start), (-1, goal)):
        reached = np.concatenate([plan.rotations[row], plan.translations[row]])
        assert np.abs(reached - np.concatenate(position)).max() < 1e-6, (
            f"row {row} is {reached}; it was asked to be {position}"
        )
    return "planned"


def inverts(robot: Robot, random: np.random.Generator, kinds: tuple[str, str]) -> str:
    """What came of inverse kinematics from a seed of the first kind to a tip of the second."""
    seed, other = (drawn(robot, kind, random) for kind in kinds)
    tip = tubeopt.forward_kinematics(robot, *other).tip_position
    solution = tubeopt.inverse_kinematics(robot, tip, start=seed, options=INVERSE)
    assert solution.position_error <= 1e-8
    if solution.path is not None and solution.path.origin == "seed":
        start = np.concatenate([solution.path.rotations[0], solution.path.translations[0]])
        assert np.abs(start - np.concatenate(seed)).max() < 1e-9, f"the way begins at {start}; the seed is {seed}"
        assert not tubeopt.follow(robot, solution.path.rotations, solution.path.translations).snaps
    if solution.straight_from_seed:
        assert tubeopt.find_snap(robot, seed, (solution.rotations, solution.translations)) is None
    return "reached"


def main(count: int, seed: int) -> int:
    """Ask `count` questions, and say what came of them; 1 where one ended in anything but an answer or a sentence."""
    random, report, wrong = np.random.default_rng(seed), Counter[str](), 0
    warnings.simplefilter("ignore")
    known = [tubeopt.load_robot(path) for path in ROBOTS]
    for number in range(count):
        robot, kinds = known[number % len(known)], (str(random.choice(KINDS)), str(random.choice(KINDS)))
        ask = plans if random.random() < 0.5 else inverts
        try:
            report[ask(robot, random, kinds)] += 1
        except (InputError, SolveError) as refused:
            text = str(refused)
            report[type(refused).__name__] += 1
            if "\n" in text or "Error" in text or not text:
                wrong += 1
                print(f"{number}: {robot.name}, {ask.__name__}, {kinds}: no sentence: {text}")
        except Exception:  # any other kind is the fault that is looked for
            wrong += 1
            print(f"{number}: {robot.name}, {ask.__name__}, {kinds}")
            traceback.print_exc(limit=-3, file=sys.stdout)
    print(", ".join(f"{name}: {times}" for name, times in sorted(report.items())), f"wrong: {wrong}")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main(*(int(each) for each in [*sys.argv[1:], *("2000", "0")[len(sys.argv) - 1 :]])))
