"""Posteriors of robots whose errors are known: how often intervals, bands and bounds hold.

    python -m benchmarks.posterior [--runs N] [--first SEED] [--rows N] [--friction] [--poses] [--unfitted SIZE]

Every run draws a truth: latency, zeros and curvatures, which are fitted; heated parts that fade, and with `--unfitted`
gains, lengths and stiffnesses, with SIZE times the standard deviation of a drawing, which no fit knows. `--friction`
adds friction between the tubes and a lag of a drive, both fitted. The robot follows a path of `--rows` rows, measured
with 0.3 mm of noise, and 0.5 deg with `--poses`. Printed are how often intervals of 95 % hold the truth, how many
held-out coordinates are in their bands, and how often the margin and the tip of the true robot, at ten configurations
within the measured range, keep their bounds of 95 and 99.9 %.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy
from scipy.spatial.transform import Rotation

from tubeopt import ConcentricRobot, InputError, SolveError, Tube, forward_kinematics
from tubeopt.robots.concentric import friction_of
from tubeopt.robots.robot import Robot
from tubeopt.validation import FitOptions, Measurements, Validation, fit, real_robots, uncertainty
from tubeopt.validation.effects import EFFECTS, Setup
from tubeopt.validation.measurements import Timeline
from tubeopt.validation.model import poses_with_friction, solve_poses

from .timing import clock, show, table

MM = 1e-3
RATE, NOISE, WOBBLE = 10.0, 0.3 * MM, np.radians(0.5)
CONFIGURATIONS = 10

WITHIN = float(scipy.special.ndtri(0.975))
"""Half width of a band of 95 %, in standard deviations."""


BANDED = 20
"""Rows of a new path at which bands are computed."""

ROBOT = ConcentricRobot(
    (
        Tube(1.0 * MM, 0.75 * MM, 150 * MM, 90 * MM, 9.0),
        Tube(1.5 * MM, 1.15 * MM, 70 * MM, 60 * MM, 5.0),
    )
)


def draw(seed: int, *, rubs: bool, unfitted: float) -> tuple[dict[str, float], dict[str, float]]:
    """Values that are fitted, and values that are not, by name of the parameter."""
    random = np.random.default_rng(seed)
    known = {
        "latency": random.uniform(0.03, 0.1), "rotation_2": random.uniform(-0.1, 0.1),
        "translation_1": random.uniform(-2, 2) * MM, "translation_2": random.uniform(-2, 2) * MM,
        "curvature_1": random.uniform(8.2, 9.8), "curvature_2": random.uniform(4.5, 5.5),
        "torsional_stiffness_1": random.uniform(0.85, 1.15),
    }  # fmt: skip
    if rubs:
        known |= {"friction_1": 10 ** random.uniform(-2.3, -1.7), "rotation_lag_1": random.uniform(0.03, 0.15)}
    hidden = {"fade_1": random.uniform(0, 10) * MM, "fade_2": random.uniform(0, 10) * MM}
    if unfitted:
        drawn = unfitted * np.clip(random.normal(size=7), -2, 2)
        factors = ("rotation_gain_1", "rotation_gain_2", "translation_gain")
        hidden |= dict(zip(factors, (1 + 0.02 * drawn[:3]).tolist(), strict=True))
        hidden |= dict(zip(("curved_length_1", "curved_length_2"), (2 * MM * drawn[3:5]).tolist(), strict=True))
        stiffnesses = ("bending_stiffness_1", "torsional_stiffness_2")
        hidden |= dict(zip(stiffnesses, (1 + 0.2 * drawn[5:]).tolist(), strict=True))
    return known, hidden


def setup_of(values: dict[str, float], drawn: ConcentricRobot = ROBOT) -> Setup:
    """All numbers of the true robot, from those of its drawing."""
    first = Setup.of(drawn)
    out, order = first.copy(), list(EFFECTS)
    split = [(*name.rpartition("_")[::2], x) if name[-1].isdigit() else (name, "", x) for name, x in values.items()]
    for kind, number, value in sorted(split, key=lambda each: order.index(each[0])):
        which = [int(number) - 1] if number else range(drawn.n_tubes)
        EFFECTS[kind].change(out, first, which, value, False)
    return out


@dataclass(frozen=True)
class Way:
    """Path of a recording."""

    phase: tuple[float, ...] = (0.3, 1.9, 4.0, 5.1)
    """Phases of the joints, rad."""
    turn: float = 1.5
    """Size of the waves of the rotations, rad."""
    frame: int | None = None
    """Seed of the tracker's frame; None: that of the recording."""


PATH = Way()


def measure(
    setup: Setup,
    rows: int,
    seed: int,
    *,
    poses: bool = False,
    drawn: ConcentricRobot = ROBOT,
    path: Way = PATH,
    noise: float = NOISE,
) -> Measurements:
    """A path there and back, then half as far and twice as fast, as the laboratory records it."""
    time = np.arange(rows) / RATE
    last = time[-1]
    slow, fast = 0.4 * last - np.abs(time - 0.4 * last), 2 * (0.1 * last - np.abs(time - 0.9 * last))
    position = np.where(time < 0.8 * last, slow, fast)[:, None]
    speed = np.array([0.23, 0.31, 0.19, 0.29])
    phase = np.array(path.phase)
    waves = np.sin(speed * position + phase) + 0.6 * np.sin(2.3 * speed * position + 2 * phase)
    read = waves * [path.turn, path.turn, 14 * MM, 9 * MM] - [0.0, 0.0, 10 * MM, 15 * MM]
    m = Measurements(read[:, :2], read[:, 2:], np.zeros((rows, 3)), time=time)
    joints, robot = Timeline.of(m).driven(setup.drives, np.zeros(2)), setup.robot(drawn)
    friction = friction_of(robot)
    if friction is None:
        result = solve_poses(robot, *joints, np.zeros(1))
    else:
        result = poses_with_friction(robot, joints, np.zeros(1), [np.arange(rows)], friction)
    if result.failures:
        raise SolveError("the truth cannot be followed")
    place, random = (np.random.default_rng(1000 + (seed if each is None else each)) for each in (path.frame, seed))
    turn, base = Rotation.random(rng=place).as_matrix(), place.uniform(-0.3, 0.3, 3)
    tips = result.position[:, 0] @ turn.T + base + random.normal(0, noise, (rows, 3))
    wobble = Rotation.from_rotvec(random.normal(0, WOBBLE, (rows, 3))).as_matrix()
    return Measurements(
        m.rotations, m.translations, tips, time=time, orientation=turn @ result.frame @ wobble if poses else None
    )


def within_bands(robot: Robot, new: Validation) -> float:
    """Fraction of coordinates of a new path within the bands of 95 % of the posterior, with misfit and noise."""
    reals, posterior = real_robots(robot), robot.posterior
    calibration = robot.calibration
    assert reals is not None
    assert posterior is not None
    assert calibration is not None
    m, inside = new.measurements, list[bool]()
    for row in np.linspace(0, len(m) - 1, BANDED, dtype=int).tolist():
        joints = calibration.to_model(m.rotations[row], m.translations[row])
        slopes = reals.slopes(forward_kinematics(robot, *joints), np.zeros(reals.size), joints)
        deviation = np.sqrt((slopes.tip**2).sum(1) + posterior.misfit**2 + posterior.noise**2)
        inside += (np.abs(new.residuals[row]) < WITHIN * deviation).tolist()
    return float(np.mean(inside))


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--runs", type=int, default=5, help="truths")
    parser.add_argument("--first", type=int, default=0, help="seed of the first")
    parser.add_argument("--rows", type=int, default=300, help="rows of the path")
    parser.add_argument("--friction", action="store_true", help="with friction and lag")
    parser.add_argument("--poses", action="store_true", help="with directions of the tip")
    parser.add_argument(
        "--unfitted", type=float, default=0.0, help="size of the errors of the drawing that no fit knows"
    )
    options = parser.parse_args()
    alone, full = defaultdict[str, list[bool]](list), defaultdict[str, list[bool]](list)
    inside, seconds, told = list[float](), list[float](), list[list[bool]]()
    for seed in range(options.first, options.first + options.runs):
        known, hidden = draw(seed, rubs=options.friction, unfitted=options.unfitted)
        setup = setup_of(known | hidden)
        try:
            data = measure(setup, options.rows, seed, poses=options.poses)
        except SolveError:
            continue
        duration, found = clock(partial(fit, ROBOT, data, list(known), FitOptions(folds=5)))
        seconds.append(duration)
        inside.append(found.held_out_inside or 0.0)
        for e in found.estimates:
            alone[e.name].append(e.low <= known[e.name] <= e.high)
            full[e.name].append(e.posterior_low <= known[e.name] <= e.posterior_high)
        # At the same readings of the drives, the robot as fitted and as it is.
        calibration, true = found.robot.calibration, setup.robot(ROBOT)
        assert calibration is not None
        for row in np.linspace(0, 0.8 * options.rows, CONFIGURATIONS, dtype=int).tolist():
            read = data.rotations[row], data.translations[row]
            try:
                fitted = forward_kinematics(found.robot, *calibration.to_model(*read))
                there, bounds = forward_kinematics(true, *setup.drives.to_model(*read)), uncertainty(fitted)
            except (InputError, SolveError):
                continue
            told.append(
                [*(there.margin >= bounds.margin - 1e-9), *(there.snap_distance >= bounds.snap_distance - 1e-9)]
            )
    rows = [(name, f"{100 * np.mean(alone[name]):.0f}", f"{100 * np.mean(full[name]):.0f}") for name in full]
    every = [100 * np.mean([hold for holds in kind.values() for hold in holds]) for kind in (alone, full)]
    kept = 100 * np.mean(told, axis=0)
    lines = [
        f"{len(seconds)} truths: intervals hold {every[0]:.1f} % alone, {every[1]:.1f} % with what the model lacks",
        f"held-out coordinates in their 95 % bands: {100 * np.mean(inside):.1f} %",
        f"{len(told)} configurations keep their bounds of 95 and 99.9 %: margin {kept[0]:.1f} and {kept[1]:.1f} %, "
        f"snap distance {kept[2]:.1f} and {kept[3]:.1f} %",
        f"a fit takes {np.median(seconds):.2f} s of processor time",
    ]
    show([table("intervals of 95 %", ("parameter", "alone hold %", "with what the model lacks %"), rows)], lines)


if __name__ == "__main__":
    main()
