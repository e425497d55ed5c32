"""What could explain the tip errors of the thesis' experiment (Table 4.1)? Each effect at its best.

The table prints distances between measured and simulated tips, not where the tips were. So an effect that moves a tip
by b explains, at best, b of a distance a, and |a - b| is left. Each effect gets the size at which the least is left of
all 72 tips, and, where every tube may be turned either way (which was turned last is not told), the best of all ways.

One learns: a sheath with a tenth of the tubes' bending stiffness could explain 45 % of the mean, and little of the
worst place, which asks for tubes that are turned, more than friction in the sheath will do; room in the sheath explains
a tenth at most. These are upper bounds: what the effects really did, distances alone cannot tell.
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
    """The robot in a sheath that has `share` of the bending stiffness of its tubes.

    With K and m the sums of stiffness and of pull, the equations of tubes on the centreline know the sheath by K alone:
    stiffer tubes of less curvature are the same, but for the offset, which is 1 % of the radius of curvature here.
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
    """(72,) how far an effect of a size moves the tips, m, for every sense that it may have."""
    here = tips(ROBOT)
    if name == "sheath":
        yield np.linalg.norm(tips(in_sheath(size)) - here, axis=1)
    elif name == "room":  # tubes further out by the room that they have, and the tip aside by as much
        wider = tips(replace(ROBOT, offset=ROBOT.distance + size))
        yield np.linalg.norm(wider - here, axis=1) + size
    else:
        for senses in product((-1.0, 0.0, 1.0), repeat=3):
            yield np.linalg.norm(tips(ROBOT, ALL + size * np.array(senses)) - here, axis=1)


EFFECTS = {
    "sheath": ("stiffness of the sheath (%)", 100.0, np.linspace(0, 0.3, 13)),
    "turned": ("turn of every tube (deg)", np.degrees(1.0), np.radians(np.linspace(0, 30, 11))),
    "room": ("room in the sheath (mm)", 1e3, np.linspace(0, 0.3e-3, 7)),
}
"""What is drawn, its unit, and the sizes that are tried."""


def left(name: str, size: float) -> Array:
    """(72,) what is left of the errors at best, m."""
    return np.asarray(np.min([np.abs(ERROR - b) for b in moved(name, size)], axis=0))


def rubbing(turn: float) -> float:
    """Torque per length that turns the tip of a tube by so much against its base while all of it slips, N m per m."""
    return 2 * ROBOT.tube.torsional_stiffness * turn / ROBOT.tube.curved_length**2


def main(out: Path, samples: int = 13) -> list[Path]:
    """Try at most `samples` sizes of each effect, save the picture into `out`, and return its path."""
    figure = new_figure(7.0, 2.6)
    headed(figure, f"What each effect leaves at best of the mean tip error, {ERROR.mean() * 1e3:.1f} mm (Table 4.1)")
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
