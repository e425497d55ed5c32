"""Two robots on one plate sized together: their tips shall hold any two places of a region at once without touching.

Curvatures of all six tubes are free, and so are the places and leans of both plates. Each tip reaches every place of
the ball by itself; that the arms touch is what keeps the pair from a third of the pairs of places.

One learns: a pair is not good because both of its robots are. What is left to gain lies between the arms, and a search
with a planner in the loop finds some of it in half a minute.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import tubeopt
from tubeopt.bodies.frames import base_frame
from tubeopt.design import Free, Strain
from tubeopt.planning import PairShare
from tubeopt.show.plots.style import new_figure, picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ROOT = Path(__file__).resolve().parents[1]
MIDDLE, RADIUS = np.array([0.0, 0.0, 0.06]), 0.014
"""Of the region, a ball, m."""
PLACES, JUDGED = 8, 16
"""Places of the region by which is searched, and others by which what comes of it is judged."""


def places(count: int, seed: int) -> np.ndarray:
    """(count, 3) random places of the region, m."""
    random = np.random.default_rng(seed)
    way = random.normal(size=(count, 3))
    far = RADIUS * random.random((count, 1)) ** (1 / 3)
    return np.asarray(MIDDLE + far * way / np.linalg.norm(way, axis=1, keepdims=True))


def main(out: Path, samples: int = 30) -> list[Path]:
    """Search for so many seconds on the clock, judge, print, save the picture into `out`, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "crl_ctr.yaml")
    assert isinstance(robot, tubeopt.ConcentricRobot)
    withdrawn = (np.zeros(3), np.array([-0.02, -0.08, -0.09]))
    bases = base_frame([-0.015, 0, 0], [0, 0, 1]), base_frame([0.015, 0, 0], [0, 0, 1])
    free = [Free("curvature", (i,), 0.4 * tube.curvature, 1.8 * tube.curvature) for i, tube in enumerate(robot.tubes)]
    task = tubeopt.DesignTask(robot, tuple(free), (Strain((0.03,)),), ordered=False)
    wanted = tubeopt.PairReach(
        (withdrawn, withdrawn),
        bases,
        places(PLACES, 0),
        options=tubeopt.PlanOptions(clearance=1e-3, time_limit=30),
        count=80,
        shift=4e-3,
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
    drawn((before, after), path)
    return [path]


@picture
def drawn(found: tuple[PairShare, PairShare]) -> Figure:
    """How far the arms are apart with their tips at any two places, before and after."""
    figure = new_figure(6.4, 2.9)
    panels = figure.subplots(1, 2, sharey=True)
    for panel, one, title in zip(panels, found, ("side by side", "sized together"), strict=True):
        table = np.where(np.eye(len(one.apart), dtype=bool), np.nan, one.apart * 1e3)
        image = panel.imshow(table, vmin=0, vmax=2e3 * one.clearance, cmap="RdBu")
        panel.set(title=f"{title}: {100 * one.share:.0f} % held", xlabel="place of the right tip")
        panel.set(xticks=range(0, len(table), 5), yticks=range(0, len(table), 5))
    panels[0].set_ylabel("place of the left tip")
    figure.colorbar(image, ax=panels, label="arms apart (mm)")
    return figure


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
