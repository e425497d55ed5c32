"""How the time of servo steps, inverse kinematics and planning grows with the number of bodies.

Usage: python -m benchmarks.bodies [--json] [--picture docs/images/growth_with_bodies.png] [--against DIRECTORY]

Spheres of 2 mm radius lie at random around the places that the robot of the thesis goes to; then in a cloud about its
arm, from 4 to 20 mm beside it, all along its way; then there is a ball of 131,000 triangles alone. Processor time of
one thread. With `--against` the package of another checkout is asked the same, in turn with this one.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np
from rich.table import Table
from scipy.spatial import cKDTree

from benchmarks.joints import circle
from benchmarks.timing import ROOT, Timing, clock, dump, milliseconds, show, summarise, table, with_package
from tests.examples import THESIS
from tests.inverse_targets import reachable
from tubeopt import IkSession, SolveError, forward_kinematics, inverse_kinematics, plan_trajectory
from tubeopt.bodies.corridors import MeshObstacle
from tubeopt.bodies.obstacles import Obstacle, Sphere
from tubeopt.control.command import Command, ServoOptions
from tubeopt.control.servo import Servo
from tubeopt.equilibrium.arm_surface import ArmSurface
from tubeopt.equilibrium.result import Equilibrium
from tubeopt.inverse.joints import joint_space

COUNTS, CLOUDS = (0, 1, 10, 100, 1000, 10000), (10, 100, 1000)
"""Spheres, and those of a cloud."""

NEAREST, FARTHEST = 4e-3, 20e-3
"""Distance of the cloud from the arm, m."""

TARGETS = {"servo": 1e-3, "cold": 30e-3, "plan": 1.5}
"""Most seconds of a servo step and of inverse kinematics with 1,000 spheres or the mesh; most time of a plan with 100
spheres, over that of a free one."""

FREE = {"servo": 0.5e-3, "cold": 10e-3}
"""Most seconds of them without bodies."""

KINDS = {
    "servo": "a servo step",
    "session": "a step of IkSession",
    "cold": "inverse kinematics, cold",
    "plan": "a plan, with its proof",
}


@dataclass(frozen=True)
class Growth:
    """What was timed, among what."""

    what: str
    among: str
    count: int
    timing: Timing


def spheres(count: int) -> list[Obstacle]:
    """Around the box in which the targets of the servo lie, by 10 mm."""
    random, result = np.random.default_rng(0), list[Obstacle]()
    while len(result) < count:
        at = random.uniform([-0.15, -0.15, 0.0], [0.15, 0.15, 0.25])
        if np.linalg.norm(at - np.clip(at, [-0.04, -0.04, 0.0], [0.1, 0.08, 0.2])) > 0.01:
            result.append(Sphere(tuple(at.tolist()), 2e-3))
    return result


def cloud(count: int, arms: Sequence[Equilibrium]) -> list[Obstacle]:
    """About arms, which have room."""
    points = np.concatenate([ArmSurface(arm).at(np.linspace(0.0, arm.arc_length[-1], 200))[0] for arm in arms])
    tree, random, result = cKDTree(points), np.random.default_rng(1), list[Obstacle]()
    thick = max(tube.outer_diameter for tube in THESIS.tubes) / 2 + 2e-3
    while len(result) < count:
        at = points[random.integers(len(points), size=1000)] + random.normal(size=(1000, 3)) * FARTHEST
        away = tree.query(at)[0] - thick
        result += [Sphere(tuple(one), 2e-3) for one in at[(away > NEAREST) & (away < FARTHEST)].tolist()]
    return result[:count]


def ball() -> MeshObstacle:
    """A ball of 131,000 triangles beside the way of the servo."""
    import trimesh

    axes = np.concatenate([np.eye(3), -np.eye(3)])
    mesh = trimesh.convex.convex_hull(axes)
    for _ in range(7):
        mesh = mesh.subdivide()
    corners = np.array([0.09, -0.05, 0.15]) + 0.02 * mesh.vertices / np.linalg.norm(mesh.vertices, axis=1)[:, None]
    body = MeshObstacle(tuple(map(tuple, corners.tolist())), tuple(map(tuple, mesh.faces.tolist())))
    assert body.lattice
    return body


def led(bodies: Sequence[Obstacle], steps: int = 200) -> tuple[Timing, list[Equilibrium]]:
    """Steps of the servo of a millisecond, five for each 0.5 mm of a wavy circle; and arms on the way."""
    targets = circle((0.055, 0.02, 0.15), 0.03, steps)
    seed = inverse_kinematics(THESIS, targets[0], obstacles=bodies).equilibrium
    leader = Servo(THESIS, seed, obstacles=bodies, options=ServoOptions(speed=0.1, shift_rate=0.1))
    leader.step(Command(position=targets[0]), 1e-3)  # what is made once
    times, arms = [], [seed]
    for k in range(5, 5 * steps):
        times.append(clock(partial(leader.step, Command(position=targets[k // 5]), 1e-3))[0])
        arms += [leader.equilibrium] if k % 20 == 0 else []
    return summarise(times), arms


def servo(bodies: Sequence[Obstacle]) -> Timing:
    """Steps of the servo."""
    return led(bodies)[0]


def session(bodies: Sequence[Obstacle], steps: int = 200) -> Timing:
    """Steps of 0.5 mm on a wavy circle, each to its end."""
    leader = IkSession(THESIS, min_margin=0.1, obstacles=bodies)
    targets = circle((0.055, 0.02, 0.15), 0.03, steps)
    leader.solve(targets[0])
    return summarise(clock(partial(leader.solve, target))[0] for target in targets[1:])


def cold(bodies: Sequence[Obstacle], count: int = 20) -> Timing:
    """Targets that the free robot reaches, solved from nothing; some are out of reach among the bodies."""
    seconds = []
    for e in reachable(THESIS, count, seed=11):

        def ask(position: np.ndarray = e.tip_position) -> None:
            with suppress(SolveError):
                inverse_kinematics(THESIS, position, obstacles=bodies)

        seconds.append(clock(ask)[0])
    return summarise(seconds[1:])


def plan(bodies: Sequence[Obstacle], repeats: int = 3) -> Timing:
    """A straight way of 69 deg."""
    shift = joint_space(THESIS).split(joint_space(THESIS).inside())[1]
    ends = [forward_kinematics(THESIS, turned, shift) for turned in (np.zeros(3), [1.2, 0.9, 0.4])]
    return summarise(clock(partial(plan_trajectory, THESIS, *ends, obstacles=bodies))[0] for _ in range(repeats))


def measured(only: Sequence[str]) -> list[Growth]:
    """Some of the kinds: what is asked among the cloud about the way of the servo is that way, and targets among their
    own."""
    known = {"servo": servo, "session": session, "cold": cold, "plan": plan}
    requested = {what: known[what] for what in only}
    scenes = [("spheres", count, spheres(count)) for count in COUNTS] + [("mesh", 1, [ball()])]
    results = [
        Growth(what, among, count, ask(bodies)) for among, count, bodies in scenes for what, ask in requested.items()
    ]
    path, ends = led([])[1], list(reachable(THESIS, 20, seed=11))
    for count in CLOUDS:
        about = {"servo": path, "session": path, "cold": ends}
        results += [
            Growth(what, "cloud", count, requested[what](cloud(count, arms)))
            for what, arms in about.items()
            if what in requested
        ]
    return results


def picture(found: Sequence[Growth], path: Path) -> None:
    """Times over the number of spheres; the free robot at the left."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    for colour, what in enumerate(KINDS):
        rows = [each for each in found if each.what == what and each.among == "spheres"]
        x = [max(each.count, 0.3) for each in rows]
        y = [1e3 * each.timing.median for each in rows]
        axes.loglog(x, y, "o-", color=f"C{colour}", label=KINDS[what])
        axes.annotate(f"{y[-1]:.3g} ms", (x[-1], y[-1]), (4, -3), textcoords="offset points", color=f"C{colour}")
        near = [each for each in found if each.what == what and each.among == "cloud"]
        label = "the same about the arm" if what == "cold" else None
        axes.loglog(
            [e.count for e in near], [1e3 * e.timing.median for e in near], "s--", color=f"C{colour}", ms=4, label=label
        )
        mesh = [1e3 * each.timing.median for each in found if each.what == what and each.among == "mesh"]
        if mesh:
            label = "the mesh of 131,000 triangles" if what == "cold" else None
            axes.loglog([0.3], mesh, "^", color=f"C{colour}", mfc="none", label=label)
    axes.set_xticks([0.3, *COUNTS[1:]], ["free", *(f"{count:,}" for count in COUNTS[1:])])
    axes.minorticks_off()
    axes.set_xlim(0.2, 60000)
    axes.set_xlabel("spheres")
    axes.set_ylabel("processor time (ms)")
    axes.grid(alpha=0.3)
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(fontsize="small", loc="outside upper center", ncols=3, frameon=False)
    figure.savefig(path, dpi=150)


def missed(found: Sequence[Growth]) -> list[str]:
    """What takes longer than wanted."""
    known = {(each.what, each.among, each.count): each.timing.median for each in found}
    notes = []
    for (what, among, count), seconds in known.items():
        if count == 0 and seconds > FREE.get(what, np.inf):
            notes.append(f"{KINDS[what]}, free: {1e3 * seconds:.3g} ms")
        if count in (1, 1000) and seconds > TARGETS.get(what, np.inf) and what != "plan":
            notes.append(f"{KINDS[what]}, {count} {among}: {1e3 * seconds:.3g} ms")
    fraction = known.get(("plan", "spheres", 100), 0.0) / known.get(("plan", "spheres", 0), 1.0)
    if fraction > TARGETS["plan"]:
        notes.append(f"{KINDS['plan']} among 100 spheres: {fraction:.2f} times the free one")
    return notes or ["all targets are met"]


def beside(checkout: Path, only: Sequence[str]) -> tuple[list[Growth], list[Growth]]:
    """What takes how long with the package of another checkout and with this one, kind by kind, each twice by turns: of
    both times the shorter one, since others on the machine only make them longer."""
    sides: tuple[list[Growth], list[Growth]] = ([], [])
    for what in only:
        runs = []
        for folder in (checkout, ROOT, ROOT, checkout):
            rows = with_package(folder, "benchmarks.bodies", ["--only", what])["growth"]
            runs.append([Growth(**row | {"timing": Timing(**row["timing"])}) for row in rows])
        for result, pair in zip(sides, ((runs[0], runs[3]), (runs[1], runs[2])), strict=True):
            result += [min(both, key=lambda growth: growth.timing.median) for both in zip(*pair, strict=True)]
    return sides


def compared(before: Sequence[Growth], found: Sequence[Growth]) -> Table:
    """Both sides, and their ratio."""
    old = {(g.what, g.among, g.count): g.timing.median for g in before}
    rows = []
    for g in found:
        was = old[g.what, g.among, g.count]
        fraction = f"{g.timing.median / was:.2f}"
        rows.append(
            (f"{KINDS[g.what]}, {g.count} {g.among}", milliseconds(was), milliseconds(g.timing.median), fraction)
        )
    return table("growth with bodies, side by side", ("", "ms there", "ms here", "here / there"), rows)


def main() -> None:
    """Measure, print, and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--picture", type=Path)
    parser.add_argument("--against", type=Path, metavar="DIRECTORY", help="another checkout, measured in turn")
    parser.add_argument("--only", nargs="+", choices=KINDS, default=list(KINDS), metavar="KIND", help=", ".join(KINDS))
    options = parser.parse_args()
    before, result = [], []
    if options.against:
        before, result = beside(options.against.resolve(), options.only)
    else:
        result = measured(options.only)
    if options.picture:
        picture(result, options.picture)
    if options.json:
        dump({"targets": TARGETS, "growth": [asdict(each) for each in result], "there": [asdict(b) for b in before]})
        return
    rows = [
        (
            f"{KINDS[g.what]}, {g.count} {g.among}",
            milliseconds(g.timing.median),
            milliseconds(g.timing.slow),
            milliseconds(g.timing.rare),
        )
        for g in sorted(result, key=lambda g: list(KINDS).index(g.what))
    ]
    tables = [table("growth with bodies", ("", "ms median", "ms 9th decile", "ms 99.9 %"), rows)]
    if before:
        tables.append(compared(before, result))
    show(tables, missed(result))


if __name__ == "__main__":
    main()
