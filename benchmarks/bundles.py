"""Bundle robots beside integrated forces and moments: tips, loads, folds; concentric tubes; the certificate.

    python -m benchmarks.bundles QUESTION ... [--robots N]

The questions are those of QUESTIONS, with the number of robots that the documentation states. All robots are random,
with two to four tubes, equal and unequal, some straight, half of them in a stiff sheath. What a robot is compared with
is that of the tests: each tube integrated alone from the plate, without an energy.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import count
from types import SimpleNamespace

import numpy as np
from rich.progress import track

from benchmarks.timing import show, table
from tests.equilibrium.test_bundle import compared, end_forces, nested_tubes, on_elements_of, random_bundle, shoot
from tests.stability.test_bundle_certificate import longest_certified, snaps_of
from tubeopt import (
    BundleRobot,
    Discretisation,
    Equilibrium,
    Load,
    find_snap,
    forward_kinematics,
    worst_margin,
)
from tubeopt.equilibrium.kinematics import unsolved
from tubeopt.errors import ImplausibleWarning, InputError
from tubeopt.typing import Array

FIRST = 1000
"""Seed of the first random robot."""

TIGHTEST = 0.2
"""Largest offset times precurvature."""

PATHS = 30
"""Random paths of each certified robot."""

ROWS = (0.01, 0.02, 0.04, 0.08, 0.15)
"""Offsets times precurvature of the certified robots whose margin is searched."""

CLOSE, STRIDE, MOST = 0.01, 1.25, 2.0
"""Margin to which a search goes, and the largest factors of one step and of all on the precurvatures."""

NEAR_1 = 0.99
"""Margin above which it converges slowly with the mesh: eigenvalues accumulate at 1."""

Row = tuple[str, ...]


def tips(robots: int) -> Iterator[Row]:
    """Tip, and conditions at the ends of tubes, of arms integrated from the plate; every other one under a force."""
    found = [compared(seed, TIGHTEST) for seed in track(range(FIRST, FIRST + robots), transient=True)]
    apart = np.array([each for each in found if each is not None])
    yield "robots, of these without ends that stay together", f"{robots}, {len(apart)}"
    yield "largest torque (N m) or force (N) violated at an end", f"{apart[:, 0].max():.1e}"
    yield "largest distance of tips, m", f"{apart[:, 1].max():.1e}"


def loads(robots: int) -> Iterator[Row]:
    """Symmetry of the compliance, and energy gained while a force grows, beside its work."""
    uneven, lost = [], []
    for seed in track(range(FIRST, FIRST + robots), transient=True):
        rng = np.random.default_rng(seed)
        robot, alpha, shift = random_bundle(rng, TIGHTEST)
        load = Load(tuple(rng.uniform(-0.2, 0.2, 3)))
        free, pose = robot.fk(alpha, shift), robot.fk(alpha, shift, load=load)
        uneven.append(np.abs(pose.compliance - pose.compliance.T).max() / np.abs(pose.compliance).max())
        # A part of the way at a time: where the order of ends changes, the work has a kink.
        gained = 0.0
        nodes, weights = np.polynomial.legendre.leggauss(6)
        for low in np.arange(4) / 4:
            for node, weight in zip(low + (1 + nodes) / 8, weights / 8, strict=True):
                step = robot.fk(alpha, shift, load=load.scaled(float(node)), start=pose)
                gained += weight * step.work / node
        lost.append(abs(pose.energy - free.energy - (pose.work - gained)) / pose.energy)
    yield "robots", str(robots)
    yield "compliance, largest asymmetry, relative", f"{max(uneven):.1e}"
    yield "energy less work, relative: median", f"{np.median(lost):.1e}"
    yield "largest", f"{max(lost):.1e}"


def folds(robots: int) -> Iterator[Row]:
    """Angle of a fold on a full turn of the first tube, by the margin and by integrated arms alone."""
    apart, others = [], 0
    for seed in track(range(FIRST, FIRST + robots), transient=True):
        robot, start, shift = random_bundle(np.random.default_rng(seed), TIGHTEST)
        end = start + 2 * np.pi * (np.arange(robot.n_tubes) == 0)
        snap = find_snap(robot, (start, shift), (end, shift))
        if snap is None or snap.before.margin > 1e-6:
            others += snap is not None
            continue
        apart.append(abs(integrated_fold(robot, snap.before) - snap.rotations[0]))
    yield "robots, of these with a fold", f"{robots}, {len(apart)}"
    yield "robots with a jump where ends meet", str(others)
    yield "largest difference of the angles, rad", f"{max(apart):.1e}"


def integrated_fold(robot: BundleRobot, pose: Equilibrium) -> float:
    """Rotation (rad) of the first tube at which the integrated equations are singular, close to an equilibrium.

    On the curve of their solutions, the rotation is there at its largest or least value: the vertex of a quartic
    through five points of the curve. The derivatives by differences only shape the steps of Newton's method.
    """
    member, x = unsolved(pose)
    lever = member.problem.bundle.levers
    twist = pose.torsion[:, 0] / (1 + lever @ pose.curvature[0])
    origin, n = np.concatenate([twist, end_forces(member.at(x)), pose.rotations[:1]]), robot.n_tubes
    scale = np.concatenate([np.maximum(np.abs(origin[: 2 * n]), [0.3] * n + [0.1] * n), [1.0]])

    def violated(z: Array) -> Array:
        at = SimpleNamespace(**{name: getattr(pose, name) for name in ("translations", "tip_position", "tube_end")})
        at.rotations = np.append(z[-1], pose.rotations[1:])
        at.torsion, at.curvature = z[:n, None], np.zeros((1, 2))
        return shoot(robot, at, z[n : 2 * n], np.zeros(3), 1e-11)[0].ravel()

    steps = 1e-5 * np.diag(scale)
    slope = np.column_stack([(violated(origin + e) - violated(origin - e)) / 2e-5 for e in steps])
    along = np.linalg.svd(slope[:, :-1])[2][-1]
    bordered = np.vstack([slope, np.append(along, 0.0)])
    distances, angles = 2e-3 * np.arange(-2, 3), []
    for distance in distances:
        z = origin + distance * scale * np.append(along, 0.0)
        for _ in range(5):
            z = z - scale * np.linalg.solve(bordered, np.append(violated(z), 0.0))
        angles.append(z[-1])
    quartic = np.polynomial.Polynomial.fit(distances, np.array(angles) - angles[2], 4)
    roots = quartic.deriv().roots()
    return float(angles[2] + quartic(roots[np.argmin(np.abs(roots))].real))


def concentric(robots: int) -> Iterator[Row]:
    """Nested tubes as a bundle without offsets, beside a concentric robot on other meshes."""
    rows: dict[str, list[tuple[float, float, float]]] = {
        "default": [],
        "the same": [],
        "the default, halved 3 times": [],
    }
    for seed in track(range(FIRST, FIRST + robots), transient=True):
        own, nested, alpha, shift = nested_tubes(seed, TIGHTEST)
        pose, other = forward_kinematics(own, alpha, shift), forward_kinematics(nested, alpha, shift)
        if np.abs(pose.tip_rotations - other.tip_rotations).max() > 1e-3:  # another of several equilibria
            continue
        halved = forward_kinematics(nested, alpha, shift, discretisation=Discretisation(refinement=3))
        for found, each in zip(rows.values(), (other, on_elements_of(pose, other), halved), strict=True):
            tip = float(np.linalg.norm(pose.tip_position - each.tip_position))
            found.append((tip, abs(pose.margin - each.margin), each.margin))
    for mesh, found in rows.items():
        tip, margin, known = np.transpose(found)
        below = known < NEAR_1
        yield f"elements: {mesh}; {len(found)} robots, largest distance of tips, m", f"{tip.max():.1e}"
        yield f"difference of margins, {below.sum()} of them below {NEAR_1}", f"{margin[below].max():.1e}"
        yield "of the others", f"{margin[~below].max():.1e}"


def certificate(robots: int) -> Iterator[Row]:
    """Snaps of robots at the edge of their certificate, on random paths."""
    found: list[int] = []
    for seed in count(100):
        snaps = snaps_of(seed, PATHS)
        found += [] if snaps is None else [snaps]
        if len(found) == robots:
            break
    yield f"certified robots, on {PATHS} paths each", str(robots)
    yield "snaps, or paths that lead elsewhere", str(sum(found))


def conservative(robots: int) -> Iterator[Row]:
    """Robots at the edge of their certificate: precurvature, of that where a search finds the margin 0; margin."""
    for tightness in ROWS:
        shares, margins, firm = list[float](), list[float](), 0
        for seed in count(FIRST):
            try:
                longest = longest_certified(np.random.default_rng(seed), tightness, 1e-4)
            except InputError:  # tubes that overlap
                continue
            if longest is not None:
                margins.append(worst_margin(*longest).margin)
                factor = softening(*longest, margins[-1])
                shares += [] if factor is None else [1 / factor]
                firm += factor is None
            if len(shares) == robots or seed > FIRST + 10 * robots:
                break
        yield f"offset times precurvature {tightness}: {len(shares)} robots, share, median", f"{np.median(shares):.2f}"
        yield "least", f"{min(shares):.2f}"
        yield "least margin found, median", f"{np.median(margins):.2f}"
        yield f"robots without a margin of 0 up to {MOST} times the precurvature", str(firm)


def softening(robot: BundleRobot, shift: Array, margin: float) -> float | None:
    """Factor on all precurvatures at which the least margin that is found is 0; None above MOST.

    Of tubes that oppose each other, 1 - margin grows with the square of the factor: each step goes nearly to the end.
    """
    factor = 1.0
    while margin > 2 * CLOSE:
        factor *= min(np.sqrt((1 - CLOSE) / (1 - margin)), STRIDE)
        if factor > MOST:
            return None
        tubes = tuple(tube.resized("curvature", factor * tube.curvature) for tube in robot.tubes)
        try:
            margin = worst_margin(replace(robot, tubes=tubes), shift).margin
        except InputError:  # tighter than a bundle may be
            return None
    return float(factor / np.sqrt(1 - margin))


QUESTIONS: dict[str, tuple[Callable[[int], Iterator[Row]], int]] = {
    "tips": (tips, 100),
    "loads": (loads, 100),
    "folds": (folds, 100),
    "concentric": (concentric, 100),
    "certificate": (certificate, 300),
    "conservative": (conservative, 16),
}
"""What is measured, and for how many robots."""


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.bundles", description=__doc__.split("\n")[0])
    parser.add_argument("questions", nargs="+", choices=QUESTIONS, help="what to measure")
    parser.add_argument("--robots", type=int, help="number of random robots")
    args = parser.parse_args()
    warnings.simplefilter("ignore", ImplausibleWarning)
    for name in args.questions:
        ask, robots = QUESTIONS[name]
        rows = list(ask(args.robots or robots))
        show([table(str(ask.__doc__).split("\n")[0], ("", ""), rows)], [])


if __name__ == "__main__":
    main()
