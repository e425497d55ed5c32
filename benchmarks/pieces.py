"""Time of forward kinematics of tubes made of pieces beside that of planar ones, in the same run.

    python -m benchmarks.pieces [--solves N] [--rounds N] [--tubes N ...]

Robots of two to four tubes: helices, bends with natural twist, tables of curvatures that vary strongly, S-shapes, and
slotted tubes. Beside each stands a robot of as many tubes of one curvature each, of the same lengths, bent so much that
its mesh has as many collocation points, and stiff in torsion by as much as keeps its coupling: so that it needs as many
iterations; and it is turned until as many of its margins are below 1, which then must be computed. Each has its own
random configurations, from tubes without torsion, single (new translations each time) and in a batch. Rounds are
interleaved; what is shown is the processor time of the fastest of them per solve, and the ratio.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from tubeopt import ConcentricRobot, Piece, Tube, forward_kinematics, forward_kinematics_batch
from tubeopt.equilibrium.problem import DEFAULT_DISCRETISATION, reduced_problem

from .shooting import Array
from .timing import show, table

DIAMETERS = ((0.9e-3, 0.7e-3), (1.3e-3, 1.0e-3), (1.8e-3, 1.45e-3), (2.4e-3, 2.0e-3))

GROWTH = 1.05
"""By which the planar robot is bent further until its mesh is as fine."""


@dataclass(frozen=True)
class ArmSurface:
    """What all robots of n tubes have: diameters, lengths of the straight and curved parts (m), curvature (1/m)."""

    diameters: tuple[float, float]
    straight: float
    curved: float
    bend: float

    @property
    def planar(self) -> Tube:
        """The tube of one curvature."""
        return Tube(*self.diameters, self.straight, self.curved, self.bend)


def outlines(n: int) -> list[ArmSurface]:
    """Of n tubes, inner to outer."""
    return [ArmSurface(DIAMETERS[i], 0.03 * (n - i), 0.04 + 0.015 * (n - 1 - i), 12.0 - 1.5 * i) for i in range(n)]


def _helix(o: ArmSurface, i: int) -> list[Piece]:
    return [Piece(o.curved, (o.bend, 0.0, 40.0 - 10.0 * i))]


def _twisted(o: ArmSurface, i: int) -> list[Piece]:
    return [Piece(o.curved / 2, o.bend), Piece(o.curved / 2, (o.bend, 2.0, 25.0 - 8 * i))]


def _table(o: ArmSurface, i: int) -> list[Piece]:
    s = np.linspace(0, o.curved, 10)
    return [Piece.table(s, np.stack([o.bend * np.cos(12 * s), 4 * np.sin(30 * s), 0 * s], axis=1))]


def _s_shape(o: ArmSurface, i: int) -> list[Piece]:
    return [Piece(o.curved / 2, o.bend), Piece(o.curved / 2, -o.bend)]


def _patterned(o: ArmSurface, i: int) -> list[Piece]:
    kb, kt = float(o.planar.bending_stiffness), float(o.planar.torsional_stiffness)
    slotted = Piece(o.curved / 2, o.bend, bending_stiffness=0.4 * kb, torsional_stiffness=0.8 * kt)
    return [Piece(o.curved / 2, o.bend), slotted]


KINDS: dict[str, Callable[[ArmSurface, int], list[Piece]]] = {
    "helix": _helix,
    "twisted": _twisted,
    "table": _table,
    "S": _s_shape,
    "patterned": _patterned,
}


def made_of_pieces(kind: str, n: int) -> ConcentricRobot:
    """The robot of n tubes of a kind."""
    made = (
        Tube.of_pieces(*o.diameters, KINDS[kind](o, i), straight_length=o.straight) for i, o in enumerate(outlines(n))
    )
    return ConcentricRobot(tuple(made))


def configurations(robot: ConcentricRobot, count: int) -> tuple[Array, Array]:
    """Rotations within a turn by which nothing snaps, translations within a few mm of home."""
    random = np.random.default_rng(0)
    n = robot.n_tubes
    back = random.uniform(0.0, 4e-3, (count, n)).cumsum(1)[:, ::-1]
    return random.uniform(-1.2, 1.2, (count, n)), robot.home_translations - back


def softened(robot: ConcentricRobot, joints: tuple[Array, Array]) -> float:
    """Part of the configurations whose margin is below 1."""
    return float((forward_kinematics_batch(robot, *joints).margin < 1 - 1e-3).mean())


def turned(robot: ConcentricRobot, joints: tuple[Array, Array], share: float) -> tuple[Array, Array]:
    """The configurations with neighbouring tubes turned apart until a share of the margins is below 1."""
    alpha, shift = joints
    apart = np.arange(alpha.shape[1]) % 2
    for angle in np.arange(0.0, np.pi, 0.2):
        if softened(robot, (alpha + angle * apart, shift)) >= share:
            return alpha + angle * apart, shift
    return joints


def points(robot: ConcentricRobot) -> float:
    """Mean number of unknowns of a few configurations."""
    _, shift = configurations(robot, 8)
    return float(np.mean([reduced_problem(robot, tuple(row), DEFAULT_DISCRETISATION).size for row in shift.tolist()]))


def matched(n: int, desired: float) -> ConcentricRobot:
    """The planar robot of n tubes whose mesh has at least as many points as wanted, less one part in twenty."""
    factor = 1.0
    while True:
        tubes = tuple(
            replace(
                o.planar, curvature=factor * o.bend, torsional_stiffness=factor**2 * float(o.planar.torsional_stiffness)
            )
            for o in outlines(n)
        )
        robot = ConcentricRobot(tubes)
        if points(robot) >= 0.95 * desired:
            return robot
        factor *= GROWTH


def seconds(robot: ConcentricRobot, joints: tuple[Array, Array]) -> tuple[float, float]:
    """Processor time per solve, single and in a batch."""
    start_time = time.process_time()
    for alpha, shift in zip(*joints, strict=True):
        forward_kinematics(robot, alpha, shift)
    middle = time.process_time()
    forward_kinematics_batch(robot, *joints)
    return (middle - start_time) / len(joints[0]), (time.process_time() - middle) / len(joints[0])


def measure(kind: str, n: int, solves: int, rounds: int) -> list[str]:
    """One row of the table."""
    robot = made_of_pieces(kind, n)
    sides = {"pieces": robot, "planar": matched(n, points(robot))}
    joints = {name: configurations(side, solves) for name, side in sides.items()}
    joints["planar"] = turned(sides["planar"], joints["planar"], softened(robot, joints["pieces"]))
    best: dict[str, Array] = {}
    for k in range(rounds + 1):
        for name, side in sides.items():
            taken = np.array(seconds(side, joints[name]))
            if k:
                best[name] = np.minimum(best.get(name, taken), taken)
    ratio = best["pieces"] / best["planar"]
    times = [f"{1e6 * best[name][m]:.0f}" for m in (0, 1) for name in sides]
    sizes = [f"{points(side):.0f}" for side in sides.values()]
    return [kind, str(n), *sizes, *times[:2], f"{ratio[0]:.2f}", *times[2:], f"{ratio[1]:.2f}"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--solves", type=int, default=100, help="configurations of each robot")
    parser.add_argument("--rounds", type=int, default=7, help="how often each is timed")
    parser.add_argument("--tubes", type=int, nargs="*", default=[2, 3, 4], help="numbers of tubes")
    args = parser.parse_args()
    rows = [measure(kind, n, args.solves, args.rounds) for n in args.tubes for kind in KINDS]
    columns = ("tubes", "n", "unknowns", "planar", "single (us)", "planar", "ratio", "batch (us)", "planar", "ratio")
    show([table("Forward kinematics of tubes made of pieces", columns, rows)], [])


if __name__ == "__main__":
    main()
