"""Answers of every shipped robot against a stored table: a change of structure must not change them.

    python -m benchmarks.answers [--only ROBOT ...] [--write]

Each row is one question to one robot at joint values that the table stores. A number may differ by the tolerance of
its question, relative to the largest number of the row. Prints the rows that differ and exits with 1 if there are any.
`--write` stores the answers of this checkout.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

import tubeopt
from tubeopt import Equilibrium, Load
from tubeopt.inverse.joints import joint_space

from .timing import ROOT

TABLE = ROOT / "benchmarks" / "answers.json"
ROBOTS = sorted(path.stem for path in (ROOT / "configs" / "robots").glob("*.yaml"))

POSES = 3
"""Random joint values per robot: one for each kind of neighbourhood (two poses of a path, one elsewhere)."""


@dataclass(frozen=True)
class Pose:
    """Joint values: rotations (n,), rad, and translations (n,), m."""

    rotations: list[float]
    translations: list[float]


@dataclass(frozen=True)
class Question:
    """What is asked, and how far an answer may be off, relative to its largest number."""

    ask: Callable[[Any, list[Pose]], list[float]]
    tolerance: float = 1e-9


def draw(robot: Any) -> list[Pose]:
    """Joint values within the robot's limits and in order, rotations within 2 rad."""
    space = joint_space(robot)
    rows = space.joint(space.sample(POSES + 2)[2:])  # the first points of the sequence are corners and the middle
    n = robot.n_tubes
    return [Pose((2 * np.sin(row[:n])).tolist(), row[n:].tolist()) for row in rows]


def solved(robot: Any, pose: Pose, **options: Any) -> Equilibrium:
    """The equilibrium at a pose."""
    return tubeopt.forward_kinematics(robot, pose.rotations, pose.translations, **options)


def numbers(*parts: Any) -> list[float]:
    """Arrays and numbers in one list."""
    return np.concatenate([np.ravel(np.asarray(part, dtype=float)) for part in parts]).tolist()


def shapes(robot: Any, poses: list[Pose]) -> list[float]:
    """Tip, m, orientation, margin and energy, J, of every pose."""
    results = [solved(robot, pose) for pose in poses]
    return numbers([[*e.tip_position, *e.tip_rotation.ravel(), e.margin, e.energy] for e in results])


def slopes(robot: Any, poses: list[Pose]) -> list[float]:
    """Jacobian of the tip by joint values, and that of the margin."""
    result = solved(robot, poses[0]).jacobian()
    return numbers(result.position, result.margin)


def snap(robot: Any, poses: list[Pose]) -> list[float]:
    """Where a turn of the inner tube snaps, its energy, J, and the tip where it lands; empty without a snap."""
    start = poses[0]
    end = [start.rotations[0] + 2 * np.pi, *start.rotations[1:]]
    snap = tubeopt.find_snap(robot, (start.rotations, start.translations), (end, start.translations))
    return [] if snap is None else numbers(snap.fraction, snap.energy_released, snap.after.tip_position)


def path(robot: Any, poses: list[Pose]) -> list[float]:
    """Tips and margins along a path through all poses, with the places of its snaps."""
    rows = [*poses, poses[0]]
    result = tubeopt.follow(robot, [p.rotations for p in rows], [p.translations for p in rows])
    return numbers(
        [[*e.tip_position, e.margin] for e in result.equilibria], [[s.index, s.fraction] for s in result.snaps]
    )


def certificate(robot: Any, poses: list[Pose]) -> list[float]:
    """Snap-free certificates at the translations of every pose."""
    return [tubeopt.snap_free_certificate(robot, pose.translations) for pose in poses]


def equilibria(robot: Any, poses: list[Pose]) -> list[float]:
    """Energies, J, and margins of all equilibria of the second pose."""
    equilibria = tubeopt.find_equilibria(robot, poses[1].rotations, poses[1].translations)
    return numbers([[e.energy, e.margin] for e in equilibria])


def inverse(robot: Any, poses: list[Pose]) -> list[float]:
    """Joint values that bring the tip of the first pose to a point 2 mm away."""
    start = solved(robot, poses[0])
    solution = tubeopt.inverse_kinematics(robot, start.tip_position + np.array([2e-3, 0.0, -1e-3]), start=start)
    return numbers(solution.rotations, solution.translations)


def proof(robot: Any, poses: list[Pose]) -> list[float]:
    """Least margin that is proved on a tenth of the path between two poses."""
    a, b = (np.array([*p.rotations, *p.translations]) for p in poses[:2])
    joint, n = np.linspace(a, a + 0.1 * (b - a), 3), robot.n_tubes
    result = tubeopt.verify_trajectory(robot, [0.0, 1.0, 2.0], joint[:, :n], joint[:, n:])
    return [result.least_margin]


FORCE = Load(force=(4e-3, -6e-3, 2e-3))
"""N: small against every shipped robot, whose tips it moves by 0.1 to 10 mm."""


def loaded(robot: Any, poses: list[Pose]) -> list[float]:
    """Tip, margin and compliance under a force on the tip, and under weight where the materials have a density."""
    result = solved(robot, poses[0], load=FORCE)
    return numbers(result.tip_position, result.margin, result.compliance)


def limit(robot: Any, poses: list[Pose]) -> list[float]:
    """Factor on a force at which the branch ends; empty where there is none up to the limit of the search."""
    limit = tubeopt.find_load_limit(robot, poses[0].rotations, poses[0].translations, FORCE)
    return [] if limit is None else [limit.factor]


QUESTIONS = {
    "shape": Question(shapes),
    "jacobian": Question(slopes, 1e-8),
    "snap": Question(snap, 1e-8),
    "path": Question(path),
    "certificate": Question(certificate),
    "equilibria": Question(equilibria),
    "inverse": Question(inverse, 1e-6),
    "proof": Question(proof, 1e-6),
    "loaded": Question(loaded, 1e-8),
    "load limit": Question(limit, 1e-8),
}


def answered(name: str, poses: list[Pose] | None) -> Iterator[tuple[str, Any]]:
    """(key, value) of a robot's part of the table: its poses, then its answers, "refused" where there is none."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / f"{name}.yaml")
    poses = poses or draw(robot)
    yield "poses", [vars(pose) for pose in poses]
    for key, question in QUESTIONS.items():
        try:
            yield key, question.ask(robot, poses)
        except (tubeopt.InputError, tubeopt.SolveError):
            yield key, "refused"


def differs(key: str, here: Any, stored: Any) -> str:
    """How two answers differ beyond the tolerance of their question, in words; empty where they do not."""
    if isinstance(here, str) or isinstance(stored, str):
        return "" if here == stored else f"{str(stored)[:60]} before, {str(here)[:60]} now"
    if len(here) != len(stored):
        return f"{len(stored)} numbers before, {len(here)} now"
    one, other = np.array(here, dtype=float), np.array(stored, dtype=float)
    same = (one == other) | (np.isnan(one) & np.isnan(other))  # endless numbers are equal to themselves
    apart = np.abs(np.where(same, 0.0, one - other))
    finite = np.abs(other[np.isfinite(other)])
    relative = float(apart.max(initial=0.0) / max(finite.max(initial=0.0), 1e-300)) if len(apart) else 0.0
    return f"off by {relative:.1e}" if not relative <= QUESTIONS[key].tolerance else ""


def main() -> None:
    """Compare, or store."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.answers", description=__doc__.split("\n")[0])
    parser.add_argument("--only", nargs="+", choices=ROBOTS, default=ROBOTS, metavar="ROBOT", help="default: all")
    parser.add_argument("--write", action="store_true", help="store the answers of this checkout")
    args = parser.parse_args()
    table = json.loads(TABLE.read_text()) if TABLE.exists() else {}
    faults = 0
    for name in args.only:
        stored = table.get(name, {})
        results = dict(answered(name, [Pose(**pose) for pose in stored.get("poses", [])]))
        for key in QUESTIONS:
            text = "" if args.write else differs(key, results[key], stored.get(key, "no answer"))
            faults += bool(text)
            if text:
                print(f"{name}, {key}: {text}", flush=True)
        table[name] = results
        print(f"{name}: {len(QUESTIONS)} questions", file=sys.stderr, flush=True)
    if args.write:
        rows = ",\n".join(
            f'"{name}": {{\n' + ",\n".join(f' "{key}": {json.dumps(value)}' for key, value in part.items()) + "}"
            for name, part in sorted(table.items())
        )
        TABLE.write_text(f"{{{rows}}}\n", encoding="utf-8")
    sys.exit(bool(faults))


if __name__ == "__main__":
    main()
