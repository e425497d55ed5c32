"""Rate of the eccentric robot's forward kinematics, and the same boundary-value problem in SciPy's `solve_bvp`.

`python -m benchmarks.eccentric [--configurations N]` prints configurations per second for the three variants that the
thesis times (section 3.4.2), and how long one configuration takes warm, beside `solve_bvp` in the same run: with the
tolerance that forward kinematics is asked for, and with the one at which its tip is as accurate. Both find torsion and
tip; forward kinematics also energy, stability margin and error estimate. Run it with OMP_NUM_THREADS=1.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_bvp, solve_ivp

from tubeopt import Discretisation, EccentricRobot, Equilibrium, forward_kinematics, load_robot
from tubeopt.inverse.mirror import mirror_rotations

from .timing import clock, milliseconds, show, summarise, table

Array = NDArray[np.float64]

ROBOT = Path(__file__).parents[1] / "configs" / "robots" / "thesis_etr.yaml"

THESIS_RATES = {"three free rotations": 46.5, "mirror actuation": 48.5, "mirror actuation, d = 0": 65.4}
"""Configurations per second of the thesis (MATLAB's bvp5c on an i7-3770)."""

TOLERANCE = 1e-8
"""Accuracy of theta (rad) that both solvers are asked for."""

TOLERANCES = (1e-8, 1e-9, 1e-10, 1e-11, 1e-12)
"""Of `solve_bvp`, until its tip is as accurate as that of forward kinematics."""

FINE = Discretisation(degree=10, refinement=1)
"""Mesh whose tip counts as exact."""

CURVATURE_STEPS = 8
"""Iterations for the curvature of a cross-section: each gains a factor d |u| < 0.01."""


@dataclass(frozen=True)
class Measurement:
    """Median seconds per configuration of one way to solve, and the largest error of its tip, m."""

    name: str
    seconds: float
    error: float


def cross_section(robot: EccentricRobot, theta: Array) -> tuple[Array, Array]:
    """u (2, k) and g (3, k) at rotations theta (3, k), by iteration on u sum 1 / g = sum kappa e(theta)."""
    angle = np.radians([[0.0], [120.0], [-120.0]])
    pull = robot.tube.curvature * np.array([np.cos(theta).sum(0), np.sin(theta).sum(0)])
    stretch = np.ones_like(theta)
    for _ in range(CURVATURE_STEPS):
        u = pull / (1 / stretch).sum(0)
        stretch = 1 + robot.distance * (u[0] * np.sin(angle) - u[1] * np.cos(angle))
    return u, stretch


def solve_with_scipy(robot: EccentricRobot, rotations: Array, tolerance: float) -> tuple[Array, Array]:
    """theta (3,) at the tip by `solve_bvp` from tubes without torsion, and the tip (3,), m, by `solve_ivp` (DOP853).

    The general assembly written out in NumPy: theta' = g w, w' = (1 + nu) kappa (u_x sin theta - u_y cos theta).
    """
    tube = robot.tube
    gain = tube.bending_stiffness / tube.torsional_stiffness * tube.curvature

    def slope(_: Array, y: Array) -> Array:
        u, stretch = cross_section(robot, y[:3])
        return np.concatenate([stretch * y[3:], gain * (u[0] * np.sin(y[:3]) - u[1] * np.cos(y[:3]))])

    def ends(start: Array, stop: Array) -> Array:
        return np.concatenate([start[:3] - rotations, stop[3:]])

    s = np.linspace(0.0, tube.length, 11)
    guess = np.zeros((6, len(s)))
    guess[:3] = rotations[:, None]
    run = solve_bvp(slope, ends, s, guess, tol=tolerance, max_nodes=100_000)
    if not run.success:
        raise RuntimeError(f"solve_bvp failed: {run.message}")

    def turn(at: float, y: Array) -> Array:
        (ux, uy), frame = cross_section(robot, run.sol(at)[:3, None])[0][:, 0], y[:9].reshape(3, 3)
        hat = np.array([[0.0, 0.0, uy], [0.0, 0.0, -ux], [-uy, ux, 0.0]])
        return np.concatenate([(frame @ hat).ravel(), frame[:, 2]])

    start = np.concatenate([np.eye(3).ravel(), np.zeros(3)])
    shape = solve_ivp(turn, (0.0, tube.length), start, method="DOP853", rtol=tolerance / 10, atol=tolerance / 100)
    return run.y[:3, -1], shape.y[9:, -1]


def median_seconds(run: Callable[[Array], object], inputs: Sequence[Array]) -> float:
    """Median time of `run` over all inputs, after a first pass that builds what is built once."""
    for each in inputs[:3]:
        run(each)
    return summarise(clock(lambda each=each: run(each))[0] for each in inputs).median


def variant_rates(robot: EccentricRobot, configurations: int) -> dict[str, float]:
    """Cold configurations per second of the three variants that the thesis times."""
    random = np.random.default_rng(7)
    free = list(random.uniform(0.0, 2 * np.pi, (configurations, 3)))
    pairs = random.uniform([0.0, 0.0], [2 * np.pi, 2 * np.pi / 3], (configurations, 2))
    mirrored = [mirror_rotations(direction, separation) for direction, separation in pairs]
    centred = replace(robot, offset=0.0)
    variants = ((robot, free), (robot, mirrored), (centred, mirrored))
    return {
        name: 1 / median_seconds(lambda each, which=which: forward_kinematics(which, each), inputs)
        for name, (which, inputs) in zip(THESIS_RATES, variants, strict=True)
    }


def compare(robot: EccentricRobot, configurations: int, bvp_configurations: int) -> list[Measurement]:
    """Warm forward kinematics, then `solve_bvp` with the same tolerance, and with the first that is as accurate.

    Warm is a path of small steps, as a controller takes: each solve starts from the one before.
    """
    path = [mirror_rotations(0.5, np.radians(60 + 20 * np.sin(x))) for x in np.linspace(0, 6, configurations)]
    last: list[Equilibrium] = [forward_kinematics(robot, path[0])]

    def follow(rotations: Array) -> None:
        last[0] = forward_kinematics(robot, rotations, start=last[0], tolerance=TOLERANCE)

    some = path[:: max(1, configurations // bvp_configurations)]
    exact = [forward_kinematics(robot, each, verify=True, discretisation=FINE) for each in some]
    solved = [forward_kinematics(robot, each).tip_position for each in some]
    results = [Measurement("forward_kinematics, warm", median_seconds(follow, path), _error(solved, exact))]
    for tolerance in TOLERANCES:
        tips = [solve_with_scipy(robot, each, tolerance)[1] for each in some]
        error = _error(tips, exact)
        if tolerance in (TOLERANCE, TOLERANCES[-1]) or error <= results[0].error:
            seconds = median_seconds(lambda each, t=tolerance: solve_with_scipy(robot, each, t), some)
            results.append(Measurement(f"solve_bvp, tolerance {tolerance:.0e}", seconds, error))
        if error <= results[0].error:
            break
    return results


def _error(tips: Sequence[Array], exact: Sequence[Equilibrium]) -> float:
    """Largest distance of tips from those of a fine mesh, m."""
    return max(float(np.linalg.norm(a - b.tip_position)) for a, b in zip(tips, exact, strict=True))


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--configurations", type=int, default=1000, help="how many of each variant")
    parser.add_argument("--bvp-configurations", type=int, default=10, help="how many for solve_bvp")
    options = parser.parse_args(arguments)
    robot = load_robot(ROBOT)
    assert isinstance(robot, EccentricRobot)
    rates = variant_rates(robot, options.configurations)
    warm, *others = compare(robot, options.configurations, options.bvp_configurations)
    cold = table(
        "Cold solves, configurations per second",
        ("variant", "tubeopt", "thesis", "ratio"),
        (
            (name, f"{rate:.0f}", f"{THESIS_RATES[name]:.1f}", f"{rate / THESIS_RATES[name]:.0f}")
            for name, rate in rates.items()
        ),
    )
    beside = table(
        "One configuration, torsion and tip",
        ("solver", "ms", "tip off by (mm)", "times the first"),
        (
            (each.name, milliseconds(each.seconds), f"{each.error * 1e3:.1e}", f"{each.seconds / warm.seconds:.0f}")
            for each in (warm, *others)
        ),
    )
    show((cold, beside), ())


if __name__ == "__main__":
    main()
