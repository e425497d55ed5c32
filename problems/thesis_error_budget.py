"""Possible causes of the tip errors of the experiment of the thesis (Table 4.1): each effect at its best.

The table has distances between measured and simulated tips, not the positions. If an effect moves a tip by b, it
explains at best b of a distance a; |a - b| is left. Each effect has the size that leaves the least error of all 72
tips. The direction of the last rotation of each tube is unknown, so the best direction counts.

Result: a sheath with a tenth of the bending stiffness of the tubes explains up to 45 % of the mean error, and little of
the worst error. The worst error requires rotated tubes, more than friction in the sheath explains. Clearance in the
sheath explains a tenth at most. These are upper bounds; distances alone do not determine the true causes.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import cast

import numpy as np

import tubeopt
from tubeopt.runs.measurement_file import load_error_table
from tubeopt.show.plots.style import finish, headed, new_figure
from tubeopt.typing import Array

ROOT = Path(__file__).resolve().parents[1]
TABLE = load_error_table(ROOT / "configs" / "experiments" / "thesis_table_4_1.csv")
ROBOT = cast(tubeopt.EccentricRobot, tubeopt.load_robot(ROOT / "configs" / "robots" / "thesis_etr.yaml"))
ALL = np.array([(d, d + apart, d - apart) for apart in TABLE.separation for d in TABLE.direction])
ERROR = TABLE.error.ravel()


def tips(robot: tubeopt.EccentricRobot, rotations: Array = ALL) -> Array:
    """(72, 3) tips at the rotations of the experiment, m."""
    return np.asarray(tubeopt.forward_kinematics_batch(robot, rotations).tip_position)


def in_sheath(share: float) -> tubeopt.EccentricRobot:
    """The robot in a sheath with `share` of the bending stiffness of its tubes.

    K is the sum of stiffnesses, m the sum of moments. On the centreline the sheath enters the equations by K alone.
    Stiffer tubes of smaller curvature are equivalent, except for the offset, which is 1 % of the radius of curvature
    here.
    """
    tube = ROBOT.tube
    stiffer = replace(
        tube,
        bending_stiffness=tube.bending_stiffness * (1 + share),
        torsional_stiffness=tube.torsional_stiffness,
        curvature=tube.curvature / (1 + share),
    )
    return replace(ROBOT, tube=stiffer)


def moved(name: str, size: float) -> Iterator[Array]:
    """(72,) displacement of the tips by an effect of a size, m, for every direction that it may have."""
    current = tips(ROBOT)
    if name == "sheath":
        yield np.linalg.norm(tips(in_sheath(size)) - current, axis=1)
    elif name == "room":  # tubes further out by the room that they have, and the tip aside by as much
        wider = tips(replace(ROBOT, offset=ROBOT.distance + size))
        yield np.linalg.norm(wider - current, axis=1) + size
    else:
        for senses in product((-1.0, 0.0, 1.0), repeat=3):
            yield np.linalg.norm(tips(ROBOT, ALL + size * np.array(senses)) - current, axis=1)


EFFECTS = {
    "sheath": ("stiffness of the sheath (%)", 100.0, np.linspace(0, 0.3, 13)),
    "turned": ("turn of every tube (deg)", np.degrees(1.0), np.radians(np.linspace(0, 30, 11))),
    "room": ("clearance in the sheath (mm)", 1e3, np.linspace(0, 0.3e-3, 7)),
}
"""What is drawn, its unit, and the sizes that are tried."""


def left(name: str, size: float) -> Array:
    """(72,) remaining errors at best, m."""
    return np.asarray(np.min([np.abs(ERROR - b) for b in moved(name, size)], axis=0))


def rubbing(turn: float) -> float:
    """Torque per length, N m per m, that turns the tip of a slipping tube by this angle against its base."""
    return 2 * ROBOT.tube.torsional_stiffness * turn / ROBOT.tube.curved_length**2


def main(out: Path, samples: int = 13) -> list[Path]:
    """Try at most `samples` sizes of each effect, save the picture into `out`, and return its path."""
    figure = new_figure(7.0, 2.6)
    headed(figure, f"Mean tip error that each effect leaves at best, of {ERROR.mean() * 1e3:.1f} mm (Table 4.1)")
    worst = int(np.argmax(ERROR))
    for axes, (name, (label, unit, sizes)) in zip(figure.subplots(1, 3, sharey=True), EFFECTS.items(), strict=True):
        sizes = sizes[:: -(-len(sizes) // samples)]
        remains = np.array([left(name, float(size)) for size in sizes])
        mean = remains.mean(1)
        best = int(np.argmin(mean))
        axes.plot(sizes * unit, mean * 1e3)
        axes.plot(sizes[best] * unit, mean[best] * 1e3, "o")
        axes.set_xlabel(label)
        print(
            f"{label} {sizes[best] * unit:.3g}: leaves {mean[best] * 1e3:.2f} mm of {ERROR.mean() * 1e3:.2f} mm in the "
            f"mean, {remains[best, worst] * 1e3:.1f} of {ERROR[worst] * 1e3:.1f} mm at the worst place, at best"
        )
        if name == "turned":
            print(f"  by friction alone: {rubbing(sizes[best]) * 1e3:.0f} mN m per m of tube")
    figure.axes[0].set_ylabel("mean error left (mm)")
    figure.axes[0].set_ylim(0, 1.05e3 * ERROR.mean())
    picture = out / "thesis_error_budget.png"
    finish(figure, picture)
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
