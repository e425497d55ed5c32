"""Steps per second of the environments of Gymnasium, by processor time on one core.

python -m benchmarks.gym [--robot thesis_ctr] [--environments 256] [--steps 40]
"""

from __future__ import annotations

import argparse

from benchmarks.timing import clock, show, table
from tubeopt.gym import CtrVectorEnv


def rate(robot: str, count: int, steps: int, **options: float) -> tuple[float, float]:
    """Steps per second under random actions, and the share of them that snap."""
    many = CtrVectorEnv(robot, count, **options)
    many.reset(seed=0)
    many.action_space.seed(0)
    actions = [many.action_space.sample() for _ in range(steps)]

    def run() -> int:
        return int(sum(many.step(action)[4]["snap"].sum() for action in actions))

    seconds, snaps = clock(run)
    return count * steps / seconds, snaps / (count * steps)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="thesis_ctr")
    parser.add_argument("--environments", type=int, default=256)
    parser.add_argument("--steps", type=int, default=40)
    asked = parser.parse_args()
    rows = []
    for options in ({"repeats": 1}, {"repeats": 1, "randomisation": 0.05}, {"repeats": 10}):
        many, snaps = rate(asked.robot, asked.environments, asked.steps, **options)
        rows.append((", ".join(f"{name}={value}" for name, value in options.items()), f"{many:.0f}", f"{snaps:.2%}"))
    show([table(f"{asked.robot}, {asked.environments} environments", ("options", "steps / s", "snaps"), rows)], [])


if __name__ == "__main__":
    main()
