"""Two robots on one plate sized together: their tips shall hold any two places of a region at once without touching.

Free are a factor on the curvatures of each robot, and how each plate leans. Each tip reaches every place of the ball by
itself; that the arms come too close keeps the pair from a quarter of the pairs of places.

One learns: a pair is not good because both of its robots are. What is left to gain lies between the arms, and a search
with a planner in the loop finds some of it in a minute. `configs/studies/design_pair.yaml` asks the same as a file.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

import tubeopt
from tubeopt.bodies.frames import base_frame
from tubeopt.design import Free, Strain
from tubeopt.show.plots.pair import plot_pair_shares

ROOT = Path(__file__).resolve().parents[1]
MIDDLE, RADIUS = np.array([0.0, 0.0, 0.06]), 0.008
"""Of the region, a ball, m."""
PLACES, JUDGED = 8, 16
"""Places of the region by which is searched, and others by which what comes of it is judged."""


def places(count: int, seed: int) -> np.ndarray:
    """(count, 3) random places of the region, m."""
    random = np.random.default_rng(seed)
    way = random.normal(size=(count, 3))
    far = RADIUS * random.random((count, 1)) ** (1 / 3)
    return np.asarray(MIDDLE + far * way / np.linalg.norm(way, axis=1, keepdims=True))


def main(out: Path, samples: int = 60) -> list[Path]:
    """Search for so many seconds on the clock, judge, print, save the picture into `out`, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "crl_ctr.yaml")
    assert isinstance(robot, tubeopt.ConcentricRobot)
    withdrawn = (np.zeros(3), np.array([-0.02, -0.08, -0.09]))
    bases = base_frame([-0.008, 0, 0], [0, 0, 1]), base_frame([0.008, 0, 0], [0, 0, 1])
    free = (Free("curvature", (0, 1, 2), 0.4, 1.8, "scaled"),)
    task = tubeopt.DesignTask(robot, free, (Strain((0.03,)),), ordered=False)
    wanted = tubeopt.PairReach(
        (withdrawn, withdrawn),
        bases,
        places(PLACES, 0),
        options=tubeopt.PlanOptions(clearance=2e-3, time_limit=30),
        count=80,
        tilt=np.radians(15),
    )
    found = tubeopt.search_pair((task, task), wanted, seconds=samples)
    judge = replace(wanted, targets=places(JUDGED, 1), count=200)
    before = judge.evaluate(robot, robot, np.zeros(len(wanted.ranges)))
    after = judge.evaluate(*found.value, found.own)
    proved, asked = judge.plans_proved(*found.value, found.own, after, 2)
    print(f"{found.tried} pairs of robots tried in {samples} s")
    for name, one in (("two CRL robots side by side", before), ("sized and placed together", after)):
        alone = ", ".join(f"{100 * each.share:.0f} %" for each in one.reached)
        print(
            f"{name}: alone they reach {alone} of the places, together {100 * one.share:.0f} % of the pairs of places"
        )
    print(f"motions of both arms to such pairs that are proved: {proved} of {asked}")
    path = out / "design_pair.png"
    plot_pair_shares((before, after), path, names=("the left", "the right"), title="Two CRL robots on one plate")
    return [path]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
