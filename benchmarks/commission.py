"""How often the columns of a recording are read as they are: units, directions and zeros drawn at random.

    python -m benchmarks.commission [--runs N] [--first SEED] [--rows N]

Every run draws a robot out of `configs/robots`, whose truth differs from the file: curvatures by 5 %, lengths by 2 mm,
torsional stiffnesses by 10 % (standard deviations). It follows a smooth path, and its tips are measured with 0.5 mm of
noise in a frame of their own. Units, directions, zeros of all columns and the latency are drawn. Printed is how many
readings are right, refused by a question, and wrong, and the errors of zeros and latency.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from tubeopt import ConcentricRobot, InputError, SolveError, load_robot
from tubeopt.typing import Array
from tubeopt.validation.model import solve_poses
from tubeopt.validation.reading import ANGLES, LENGTHS, Detection, RawLog, Reading, detect

from .timing import clock, show, table

MM = 1e-3
RATE, NOISE = 20.0, 0.5 * MM
ROBOTS = ("thesis_ctr", "crl_ctr", "two_tube", "medlab_ctr", "grassmann_ctr", "pedrosa_ctr", "rvim_ctr")


@dataclass(frozen=True)
class Drawn:
    """A recording and how it is to be read."""

    robot: ConcentricRobot
    log: RawLog
    reading: Reading
    name: str


def draw(seed: int, rows: int) -> Drawn:
    """A recording of a random robot with random columns."""
    random = np.random.default_rng(seed)
    name = str(random.choice(ROBOTS))
    given = load_robot(name)
    assert isinstance(given, ConcentricRobot)
    n, true = given.n_tubes, given
    while true is given:
        try:
            true = perturbed(given, random)
        except InputError:  # the inner tube would be the shorter one
            continue
    time = np.arange(rows) / RATE
    for _ in range(200):
        rotations, translations, latency = path(given, time, random)
        poses = solve_poses(true, *rotations_at(rotations, translations, time - latency, time), np.zeros(1))
        if poses.solved.all() and np.linalg.norm(np.ptp(poses.position[:, 0], axis=0)) > 0.1 * poses.length.max():
            break
    else:
        raise SolveError(f"no path of {name} was found")
    turn, base = Rotation.random(rng=random).as_matrix(), random.uniform(-0.3, 0.3, 3)
    tips = poses.position[:, 0] @ turn.T + base + random.normal(0, NOISE, (rows, 3))
    units = [str(random.choice(names)) for names in (["deg", "rad"], ["mm", "m"], ["mm", "m"])]
    signs = [tuple(random.choice([-1, 1], n).tolist()) for _ in range(2)]
    turns, shifts = random.uniform(-np.pi, np.pi, n - 1).tolist(), (random.uniform(-60, 60, n) * MM).tolist()
    reading = Reading(units[0], units[1], units[2], signs[0], signs[1], (0.0, *turns), tuple(shifts), latency)
    # What is read is the sign times (what is meant less the zero).
    raw_r = (rotations - reading.rotation_zeros) * reading.rotation_signs / ANGLES[reading.rotation_unit]
    raw_t = (translations - reading.translation_zeros) * reading.translation_signs / LENGTHS[reading.translation_unit]
    log = RawLog(raw_r, raw_t, time, tips[:, None] / LENGTHS[reading.position_unit], time)
    return Drawn(given, log, reading, name)


def perturbed(robot: ConcentricRobot, random: np.random.Generator) -> ConcentricRobot:
    """A robot that is not quite as drawn."""
    tubes = []
    for tube in robot.tubes:
        curvature, longer, softer = 1 + 0.05 * random.normal(), 2 * MM * random.normal(), 1 + 0.1 * random.normal()
        if tube.pieces:
            tubes.append(tube)
            continue
        sizes = {"curvature": tube.curvature * curvature, "curved_length": tube.curved_length + longer}
        tubes.append(replace(tube, **sizes, torsional_stiffness=tube.torsional_stiffness * softer))
    return replace(robot, tubes=tuple(tubes), friction=None, clearance=None)


def path(robot: ConcentricRobot, time: Array, random: np.random.Generator) -> tuple[Array, Array, float]:
    """Rotations and translations (N, n) of a smooth path, rad and m, and a latency, s."""
    n = robot.n_tubes
    low, high = np.array(robot.limits.translations).T
    low = np.maximum(low, -0.6 * np.array([tube.curved_length for tube in robot.tubes]))
    high = np.minimum(high, 0.5 * np.array([tube.straight_length for tube in robot.tubes]))
    width = np.minimum(high - low, 40 * MM) * random.uniform(0.5, 1.0, n)
    middle = random.uniform(low + width / 2, high - width / 2)
    speed, phase = random.uniform(0.15, 0.5, 2 * n), random.uniform(0, 6.28, 2 * n)
    waves = np.sin(speed * time[:, None] + phase) + 0.5 * np.sin(2.3 * speed * time[:, None] + 2 * phase)
    reach = random.uniform(0.5, 1.6, n)
    common = random.uniform(0.0, 1.5) * np.sin(random.uniform(0.2, 0.5) * time)[:, None]
    rotations = waves[:, :n] * reach + random.uniform(-0.8, 0.8, n) + common
    translations = middle + waves[:, n:] / 3 * width
    return rotations, translations, float(random.uniform(0.0, 0.25))


def rotations_at(rotations: Array, translations: Array, instants: Array, time: Array) -> tuple[Array, Array]:
    """Joint values at other times."""
    return (
        np.column_stack([np.interp(instants, time, column) for column in rotations.T]),
        np.column_stack([np.interp(instants, time, column) for column in translations.T]),
    )


def right(found: Detection, true: Reading) -> bool:
    """True if units and directions are those that were drawn."""
    names = ("rotation_unit", "translation_unit", "position_unit", "rotation_signs", "translation_signs")
    return all(getattr(found.reading, name) == getattr(true, name) for name in names)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--runs", type=int, default=60, help="recordings")
    parser.add_argument("--first", type=int, default=0, help="seed of the first")
    parser.add_argument("--rows", type=int, default=600, help="rows of a recording")
    options = parser.parse_args()
    counts = {"right": 0, "asked": 0, "wrong": 0, "failed": 0}
    turns, shifts, seconds = list[float](), list[float](), list[float]()
    for seed in range(options.first, options.first + options.runs):
        drawn = draw(seed, options.rows)
        try:
            duration, found = clock(lambda drawn=drawn: detect(drawn.robot, drawn.log))
        except (InputError, SolveError) as error:
            counts["failed"] += 1
            print(f"{seed} {drawn.name}: {error}", flush=True)
            continue
        seconds.append(duration)
        sure = all(d.certain for d in found.decisions)
        kind = "asked" if not sure else "right" if right(found, drawn.reading) else "wrong"
        counts[kind] += 1
        doubts = [f"{d.about} {d.other} {1e3 * d.other_rms:.2f}" for d in found.decisions if not d.certain]
        least = min((d.other_rms / d.rms for d in found.decisions if np.isfinite(d.other_rms)), default=np.inf)
        off = np.array(found.reading.rotation_zeros) - drawn.reading.rotation_zeros
        turns.append(float(np.abs((off - off[0] + np.pi) % (2 * np.pi) - np.pi).max()))
        shifts.append(float(np.abs(np.array(found.reading.translation_zeros) - drawn.reading.translation_zeros).max()))
        other = "" if right(found, drawn.reading) else " (not as drawn)"
        print(
            f"{seed} {drawn.name}: {kind}{other}, {1e3 * found.rms:.2f} mm, ratio {least:.2f}, "
            f"zeros {np.degrees(turns[-1]):.1f} deg {1e3 * shifts[-1]:.1f} mm, {duration:.1f} s {'; '.join(doubts)}",
            flush=True,
        )
    result = table("readings", counts, [[str(count) for count in counts.values()]])
    show([result], [f"{np.median(seconds):.1f} s of processor time (median)"])


if __name__ == "__main__":
    main()
