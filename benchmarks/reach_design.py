"""Tubes for a region of a patient: the share of it that is reached by ways without a snap, made large by a simplex
search from the robot that is there (Nelder and Mead 1965), or by SciPy's differential evolution, in the same time.

The share of few places does not tell neighbours apart; the score that is searched with takes in how far the places that
are not reached are missed by. What comes of it is judged by other places of the region, over larger roadmaps with other
random numbers, and by plans with proof to some that are reached.

Usage: python -m benchmarks.reach_design [--solvers none simplex evolution] [--seconds 180] [--seed 1] [--picture FILE]
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import scipy

import tubeopt
from tubeopt import ConcentricRobot, InputError, PlanOptions, SolveError
from tubeopt.bodies.distance_field import DistanceField
from tubeopt.bodies.images import field_of_image
from tubeopt.bodies.phantoms import LUMEN, TARGET, bronchial_tree
from tubeopt.planning import ReachFraction, RegionReach
from tubeopt.typing import Array

ROOT = Path(__file__).resolve().parents[1]
WITHDRAWN = np.zeros(3), np.array([-0.033, -0.092, -0.096])
OPTIONS = PlanOptions(clearance=2e-4, objective="none", time_limit=120)
RANGE = 0.4, 1.8
"""By what each tube's curvature may be multiplied."""

BRANCH = slice(4, 5)
"""Of the stretches of the bronchial tree: the lower lobe on the left."""

INSIDE = 1.5e-3
"""Distance (m) of places from the wall, at least."""

PLACES, HELD_OUT, PLANNED = 12, 48, 12


class OverError(Exception):
    """The time is over."""


def region(seed: int) -> tuple[DistanceField, Array]:
    """The way that bars all else, and places (N, 3) of the region, m, in random order."""
    phantom = bronchial_tree()
    image = phantom.image(1e-3)
    free = image.chosen([LUMEN, TARGET])
    centres = image.frame.placed(np.argwhere(free) * image.spacing)
    inside = centres[phantom.depth(centres, phantom.stretches[BRANCH]) > INSIDE]
    return field_of_image(image, lumen=free), np.random.default_rng(seed).permutation(inside)


def bent(robot: ConcentricRobot, factors: Array) -> ConcentricRobot:
    """The robot with its tubes' curvatures multiplied."""
    tubes = zip(robot.tubes, factors.tolist(), strict=True)
    return replace(robot, tubes=tuple(replace(tube, curvature=tube.curvature * by) for tube, by in tubes))


def searched(
    robot: ConcentricRobot, body: DistanceField, places: Array, solver: str, given: argparse.Namespace
) -> Array:
    """The best factors (n,) that the solver finds in its time."""
    if solver == "none":
        return np.ones(robot.n_tubes)
    until = time.process_time() + given.seconds
    best: list[tuple[float, float, Array]] = []
    desired = RegionReach(WITHDRAWN, places, (body,), options=OPTIONS)

    def value(factors: Array) -> float:
        if time.process_time() > until:
            raise OverError
        try:
            result, fraction = desired(bent(robot, np.clip(factors, *RANGE)), np.zeros(0))
        except (InputError, SolveError):
            result, fraction = 1.0, 0.0
        best.append((result, fraction, np.clip(factors, *RANGE)))
        return result

    start, n = np.ones(robot.n_tubes), robot.n_tubes
    try:
        if solver == "simplex":
            simplex = np.vstack([start, start + 0.3 * (np.eye(n) - 1 / n)])
            options = {"initial_simplex": simplex, "xatol": 1e-3, "fatol": 0.0}
            scipy.optimize.minimize(value, start, method="Nelder-Mead", bounds=[RANGE] * n, options=options)
        else:
            scipy.optimize.differential_evolution(
                value, [RANGE] * n, x0=start, popsize=5, rng=given.seed, polish=False, maxiter=10_000
            )
    except OverError:
        pass
    result, fraction, factors = min(best, key=lambda one: one[0])
    print(f"{solver}: {len(best)} designs, loss {result:.3f}, share of the {PLACES} places {fraction:.2f}")
    return factors


def judge(robot: ConcentricRobot, body: DistanceField, places: Array, seed: int) -> tuple[ReachFraction, str]:
    """What the robot reaches of places that were not searched with, and how many plans to some of them are proved."""
    requested = RegionReach(WITHDRAWN, places, (body,), options=replace(OPTIONS, seed=seed + 100), count=500)
    result = requested.evaluate(robot, np.zeros(0))
    proved, planned = requested.plans_proved(robot, np.zeros(0), result, PLANNED)
    return result, f"{result.fraction:.2f} of {len(places)} other places reached; {proved} of {planned} plans proved"


NAMES = {"none": "as it is", "simplex": "simplex", "evolution": "differential evolution"}


def draw(judged: dict[str, ReachFraction], path: Path) -> None:
    """The places that are reached, and those that are not, seen from the front, with the way to them."""
    figure, axes = plt.subplots(1, len(judged), figsize=(3.2 * len(judged), 3.6), layout="constrained", sharey=True)
    centres = np.array([[start, stop] for start, stop, _, _ in bronchial_tree().stretches])
    for panel, (solver, result) in zip(np.atleast_1d(axes), judged.items(), strict=True):
        for line in centres:
            panel.plot(line[:, 0], line[:, 2], color="0.85", lw=9, solid_capstyle="round", zorder=0)
        for reached, colour in ((True, "#0072B2"), (False, "#D55E00")):
            some = 1e3 * result.targets[result.reached == reached]
            panel.plot(some[:, 0], some[:, 2], ".", color=colour, label="reached" if reached else "not reached")
        panel.set(title=f"{NAMES[solver]}: {100 * result.fraction:.0f} %", xlabel="x (mm)", aspect="equal")
        panel.set(xlim=(-55, 15), ylim=(20, 108))
        panel.spines[["top", "right"]].set_visible(False)
    np.atleast_1d(axes)[0].set_ylabel("z (mm)")
    np.atleast_1d(axes)[0].legend(frameon=False, fontsize=8, loc="upper right")
    figure.savefig(path, dpi=150)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--solvers", nargs="+", choices=tuple(NAMES), default=list(NAMES))
    parser.add_argument("--seconds", type=float, default=180.0, help="of processor time, for each search")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--picture", type=Path, default=None)
    args = parser.parse_args()
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "crl_ctr.yaml")
    assert isinstance(robot, ConcentricRobot)
    body, positions = region(args.seed)
    judged = {}
    for solver in args.solvers:
        result = bent(robot, searched(robot, body, positions[:PLACES], solver, args))
        print(f"{NAMES[solver]}, curvatures (1/m):", ", ".join(f"{tube.curvature:.2f}" for tube in result.tubes))
        judged[solver], text = judge(result, body, positions[PLACES : PLACES + HELD_OUT], args.seed)
        print(text, flush=True)
    if args.picture is not None:
        draw(judged, args.picture)


if __name__ == "__main__":
    main()
