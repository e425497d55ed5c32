"""Possible causes of the tip errors of the experiment of the thesis (Table 4.1): each effect at its best.

The table has distances between measured and simulated tips, not the positions. If an effect moves a tip by b, it
explains at best b of a distance a; |a - b| is left. Each effect has the size that leaves the least error of all 72
tips. The direction of the last rotation of each tube is unknown, so the best direction counts.

Result: a sheath with a tenth of the bending stiffness of the tubes explains up to 45 % of the mean error, and little of
the worst error. The worst error requires rotated tubes, more than friction in the sheath explains. Clearance in the
sheath explains a tenth at most, tubes that spiral in it by a turn a sixth. These are upper bounds; distances alone do
not determine the true causes.

Tubes of the energy of `physics.spiral` spiral by half a turn if nothing rubs: that has less energy, and takes less than
a micrometre of room.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Any, cast

import casadi as ca
import numpy as np
import scipy

import tubeopt
from tubeopt.block.transcription.tableau import tableau
from tubeopt.physics.spiral import spiral_energy, touching_offset
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


RULE = tableau("gauss", 12)
"""Points along the arm."""


@lru_cache(maxsize=2)
def spiralling(free: bool) -> ca.Function:
    """Solver for theta' (12, 3), u (12, 2) and a `free` rate: the least energy, mJ, of tubes that spiral.

    Parameters are the rotations and a rate, rad/m, which counts if it is not free. The tubes end together.
    """
    tube, one, place = ROBOT.tube, np.ones(3), np.array([0, 2, -2]) * np.pi / 3
    turn, u, rotations, given = ca.SX.sym("turn", 12, 3), ca.SX.sym("u", 12, 2), ca.SX.sym("a", 3), ca.SX.sym("rate")
    rate = ca.SX.sym("free") if free else given
    theta = tube.curved_length * ca.DM(RULE.matrix) @ turn
    constants = tube.bending_stiffness * one, tube.torsional_stiffness * one, tube.curvature * one
    energy = 0.0
    for k, s in enumerate((tube.curved_length * RULE.nodes).tolist()):
        at = rotations + theta[k, :].T, turn[k, :].T, u[k, :].T, rate
        density = spiral_energy(3)(*at, *constants, ROBOT.distance * one, place + rate * s)
        energy += 1e3 * tube.curved_length * RULE.weights[k] * density
    x = ca.vertcat(ca.vec(turn), ca.vec(u), *([rate] if free else []))
    options: Any = {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-10}}
    return ca.nlpsol("spiral", "ipopt", {"x": x, "p": ca.vertcat(rotations, given), "f": energy}, options)


def spiral(rotations: Array, rate: float | None = 0.0) -> tuple[float, Array, float]:
    """Spiral (rad), tip (3,), m, and energy (mJ) of tubes that spiral at a rate, rad/m; None: that of least energy."""
    length = ROBOT.tube.curved_length
    bend = ROBOT.tube.curvature * np.array([np.cos(rotations).mean(), np.sin(rotations).mean()])
    start = np.concatenate([np.zeros(36), np.repeat(bend, 12)])
    starts = [start] if rate is not None else [np.append(start, turn / length) for turn in (-3.5, -0.5, 0.5, 3.5)]
    solver = spiralling(rate is None)
    solved = [solver(x0=each, p=np.append(rotations, rate or 0.0)) for each in starts]
    best = min(solved, key=lambda one: float(one["f"]))
    x = best["x"].full().ravel()
    curvature = scipy.interpolate.BarycentricInterpolator(length * RULE.nodes, x[36:60].reshape(2, 12).T)
    steps, frame, tip = 100, np.eye(3), np.zeros(3)
    for s in (np.arange(steps) + 0.5) * length / steps:
        half = scipy.spatial.transform.Rotation.from_rotvec(
            np.append(curvature(s), 0.0) * length / steps / 2
        ).as_matrix()
        tip = tip + length / steps * (frame @ half)[:, 2]
        frame = frame @ half @ half
    return float((rate if rate is not None else x[-1]) * length), tip, float(best["f"])


def moved(name: str, size: float) -> Iterator[Array]:
    """(72,) displacement of the tips by an effect of a size, m, for every direction that it may have."""
    current = tips(ROBOT)
    if name == "sheath":
        yield np.linalg.norm(tips(in_sheath(size)) - current, axis=1)
    elif name == "room":  # tubes further out by the room that they have, and the tip aside by as much
        wider = tips(replace(ROBOT, offset=ROBOT.distance + size))
        yield np.linalg.norm(wider - current, axis=1) + size
    elif name == "spiral":
        straight = np.array([spiral(rotations)[1] for rotations in ALL])
        for turn in (size, -size):
            turned = [spiral(rotations, turn / ROBOT.tube.curved_length)[1] for rotations in ALL]
            yield np.linalg.norm(turned - straight, axis=1)
    else:
        for senses in product((-1.0, 0.0, 1.0), repeat=3):
            yield np.linalg.norm(tips(ROBOT, ALL + size * np.array(senses)) - current, axis=1)


EFFECTS = {
    "sheath": ("sheath stiffness (%)", 100.0, np.linspace(0, 0.3, 13)),
    "turned": ("turn of tubes (deg)", np.degrees(1.0), np.radians(np.linspace(0, 30, 11))),
    "room": ("clearance (mm)", 1e3, np.linspace(0, 0.3e-3, 7)),
    "spiral": ("spiral (deg)", np.degrees(1.0), np.radians(np.linspace(0, 360, 7))),
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
    figure = new_figure(7.0, 4.4)
    headed(figure, f"Mean tip error that each effect leaves at best, of {ERROR.mean() * 1e3:.1f} mm (Table 4.1)")
    worst = int(np.argmax(ERROR))
    for axes, (name, (label, unit, sizes)) in zip(
        figure.subplots(2, 2, sharey=True).ravel(), EFFECTS.items(), strict=True
    ):
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
        if name == "spiral":
            found = [(spiral(rotations), spiral(rotations, None)) for rotations in ALL]
            turns = np.abs([free[0] for _, free in found])
            moves = np.array([np.linalg.norm(free[1] - tight[1]) for tight, free in found])
            most = touching_offset(ROBOT.tube.outer_diameter, float(turns.max()) / ROBOT.tube.curved_length)
            print(
                f"  of least energy: {np.degrees(np.median(turns)):.0f} deg in the median, "
                f"{np.degrees(turns.max()):.0f} at most, in {1e6 * (most - ROBOT.distance):.2f} um of room; tips move "
                f"by {moves.mean() * 1e3:.2f} mm, {moves.max() * 1e3:.2f} at most"
            )
    for axes in figure.axes[::2]:
        axes.set_ylabel("mean error left (mm)")
    figure.axes[0].set_ylim(0, 1.05e3 * ERROR.mean())
    picture = out / "thesis_error_budget.png"
    finish(figure, picture)
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
