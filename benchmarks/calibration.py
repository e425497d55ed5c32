"""Calibration of robots whose errors are known: what is found, how often intervals hold, and the processor time.

    python -m benchmarks.calibration [--runs N] [--first SEED] [--rows N] [--fits] [--smooth] [--jsonl FILE] [--json]

Every run draws a truth (latency, offsets and gains of the drives, friction between the tubes, torsional stiffnesses)
and lets the robot follow a way of `--rows` rows, slowly there and back and then twice as fast, measured with 0.3 mm
of noise. From the drawing it fits what is true, which tells how often an interval of 95 % holds the truth, and
compares all effects, which tells what is chosen that is not there, and what is there and not chosen. The truth
follows the way on a mesh four times as fine as that of the fit. `--fits` leaves out the comparison; `--smooth` the
friction, as truth and as effect. `--jsonl` keeps every run as it ends, and goes on after those that are kept there.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tubeopt import ConcentricRobot, Friction, Tube
from tubeopt.equilibrium.friction import sweep
from tubeopt.stability.friction_path import start_with_friction
from tubeopt.typing import Array
from tubeopt.validation import FitOptions, Measurements, compare_effects, fit
from tubeopt.validation.effects import EFFECTS, Setup
from tubeopt.validation.model import solve_poses
from tubeopt.validation.parameters import groups

from .campaign import add_campaign, campaign
from .timing import clock, milliseconds, show, table

MM = 1e-3
RATE = 10.0
"""Rows per second."""

NOISE = 0.3 * MM
FINE = 1
"""Refinement of the mesh on which the truth is followed."""

ROBOT = ConcentricRobot(
    (
        Tube(1.0 * MM, 0.75 * MM, 220 * MM, 100 * MM, 9.0),
        Tube(1.5 * MM, 1.15 * MM, 140 * MM, 80 * MM, 6.0),
        Tube(2.0 * MM, 1.6 * MM, 60 * MM, 60 * MM, 4.0),
    ),
    name="three tubes that cannot snap",
)

TRUE = ("latency", "translation", "rotation", "rotation_gain", "friction", "torsional_stiffness")
"""Effects that are there."""


@dataclass(frozen=True)
class Truth:
    """What a robot is, against its drawing: by name of the parameter, in SI."""

    values: dict[str, float]

    def setup(self) -> Setup:
        """All numbers of the robot."""
        first = Setup.of(ROBOT)
        out = first.copy()
        for name, value in self.values.items():
            kind, _, number = name.rpartition("_") if name[-1].isdigit() else (name, "", "1")
            EFFECTS[kind].change(out, first, [int(number) - 1], value, False)
        return out


@dataclass(frozen=True)
class Run:
    """What became of a truth: whether intervals hold it, with errors in standard errors, which effects were chosen that
    are not there (`wrong`) or not chosen that are (`missed`), the root mean square held out (m), and seconds."""

    seed: int
    holds: dict[str, bool]
    errors: dict[str, float]
    fit_seconds: float
    wrong: tuple[str, ...] = ()
    missed: tuple[str, ...] = ()
    held_out: float = float("nan")
    compare_seconds: float = float("nan")


def draw(seed: int, *, rubs: bool) -> Truth:
    """A truth; the rotation of the first tube reads true, since a registration hides a common turn."""
    random = np.random.default_rng(seed)
    n = ROBOT.n_tubes
    values = {"latency": random.uniform(0.05, 0.1)}
    values |= {f"translation_{i + 1}": random.uniform(-2 * MM, 2 * MM) for i in range(n)}
    values |= {f"rotation_{i + 1}": random.uniform(-0.1, 0.1) for i in range(1, n)}
    values |= {f"rotation_gain_{i + 1}": random.uniform(0.99, 1.01) for i in range(n)}
    torques = {f"friction_{i + 1}": 10 ** random.uniform(-2.3, -1.7) for i in range(n - 1)}
    values |= torques if rubs else {}
    return Truth(values | {f"torsional_stiffness_{i + 1}": random.uniform(0.85, 1.15) for i in range(n)})


def joints(time: Array, last: float) -> Array:
    """(N, 6) readings at times (N,), s: there and back until 0.8 of `last`, then half as far and twice as fast."""
    turn = 0.4 * last
    slow, fast = turn - np.abs(time - turn), 2 * (0.1 * last - np.abs(time - 0.9 * last))
    position = np.where(time < 2 * turn, slow, fast)[:, None]
    speed = np.array([0.23, 0.31, 0.27, 0.19, 0.29, 0.37])
    phase = np.array([0.3, 1.9, 4.4, 4.0, 5.1, 0.9])
    waves = np.sin(speed * position + phase) + 0.6 * np.sin(2.3 * speed * position + 2 * phase)
    return np.asarray(waves * [1.4, 1.6, 1.2, 14 * MM, 9 * MM, 6 * MM] - [0.0, 0.0, 0.0, 10 * MM, 15 * MM, 10 * MM])


def measure(truth: Truth, rows: int, seed: int) -> Measurements:
    """The way as the laboratory records it."""
    setup, time = truth.setup(), np.arange(rows) / RATE
    read, lagging = (joints(at, time[-1]) for at in (time, time - setup.drives.latency))
    tips = followed(setup, np.hstack(setup.drives.to_model(lagging[:, :3], lagging[:, 3:])))
    random = np.random.default_rng(seed + 10_000)
    observed = Rotation.random(rng=random).apply(tips) + random.uniform(-0.3, 0.3, 3)
    noisy = observed + random.normal(0, NOISE, tips.shape)
    return Measurements(read[:, :3], read[:, 3:], noisy, time=time, source="no laboratory")


def followed(setup: Setup, table: Array) -> Array:
    """(N, 3) tips of the true robot along joint values (N, 6)."""
    robot, n = setup.robot(ROBOT), ROBOT.n_tubes
    if not setup.friction.any():
        return solve_poses(robot, table[:, :n], table[:, n:], np.zeros(1)).position[:, 0]
    held = start_with_friction(robot, table[0], Friction(tuple(setup.friction.tolist()), refinement=FINE))
    result = sweep(robot, held, np.vstack([table[:1], table]), np.zeros(1))
    if result is None or len(result.margin) < len(table):
        raise SystemExit("the truth cannot be followed: there is no compiled kernel, or the robot snaps on the path")
    return result.stations[:, 0]


def run(seed: int, rows: int, *, compared: bool, rubs: bool) -> Run:
    """One truth."""
    truth = draw(seed, rubs=rubs)
    data = measure(truth, rows, seed)
    seconds, result = clock(lambda: fit(ROBOT, data, list(truth.values), FitOptions(folds=10)))
    holds = {e.name: e.low <= truth.values[e.name] <= e.high for e in result.estimates}
    errors = {e.name: (e.value - truth.values[e.name]) / e.standard_error for e in result.estimates}
    if not compared:
        return Run(seed, holds, errors, seconds)
    effects = [kind for kind in groups(ROBOT, data) if rubs or kind != "friction"]
    longer, best = clock(lambda: compare_effects(ROBOT, data, effects, FitOptions(folds=10)))
    retained = [step.effect for step in best.steps]
    reached = [kind for kind in TRUE if rubs or kind != "friction"]
    return Run(
        seed,
        holds,
        errors,
        seconds,
        wrong=tuple(kind for kind in retained if kind not in reached),
        missed=tuple(kind for kind in reached if kind not in retained),
        held_out=best.steps[-1].held_out.rms if best.steps else best.start.rms,
        compare_seconds=longer,
    )


def summary(runs: list[Run]) -> dict[str, Any]:
    """How often intervals hold, effects chosen wrongly and missed, and seconds."""
    held = [hold for one in runs for hold in one.holds.values()]
    compared = [one for one in runs if np.isfinite(one.compare_seconds)]
    return {
        "runs": len(runs),
        "coverage": float(np.mean(held)),
        "coverage_by_parameter": {name: float(np.mean([one.holds[name] for one in runs])) for name in runs[0].holds},
        "spread_by_parameter": {name: _rms([one.errors[name] for one in runs]) for name in runs[0].holds},
        "fit_seconds": [float(np.median([one.fit_seconds for one in runs])), max(one.fit_seconds for one in runs)],
        "compared": len(compared),
        "nothing_wrong": sum(not one.wrong for one in compared),
        "nothing_missed": sum(not one.missed for one in compared),
        "compare_seconds": [
            float(np.median([one.compare_seconds for one in compared])) if compared else None,
            max((one.compare_seconds for one in compared), default=None),
        ],
    }


def _rms(values: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def read(record: dict[str, Any]) -> Run:
    """A run of a file."""
    return Run(**record | {name: tuple(record[name]) for name in ("wrong", "missed")})


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    add_campaign(parser, runs=5)
    parser.add_argument("--rows", type=int, default=1300, help="rows of the way")
    parser.add_argument("--fits", action="store_true", help="without the comparison of effects")
    parser.add_argument("--smooth", action="store_true", help="without friction")
    parser.add_argument("--json", action="store_true", help="one line of JSON in place of tables")
    options = parser.parse_args()
    runs = campaign(
        options, lambda seed: run(seed, options.rows, compared=not options.fits, rubs=not options.smooth), read
    )
    result = summary(runs)
    if options.json:
        print(json.dumps(result))
        return
    parameters = [
        (name, f"{100 * result['coverage_by_parameter'][name]:.0f}", f"{result['spread_by_parameter'][name]:.2f}")
        for name in runs[0].holds
    ]
    each = [
        (
            str(one.seed),
            f"{sum(one.holds.values())} of {len(one.holds)}",
            milliseconds(one.fit_seconds / 1e3),
            milliseconds(one.compare_seconds / 1e3),
            ", ".join(one.wrong) or "-",
            ", ".join(one.missed) or "-",
        )
        for one in runs
    ]
    tables = [
        table("intervals of 95 %", ("parameter", "hold %", "error / standard error"), parameters),
        table("runs", ("truth", "intervals hold", "fit (s)", "comparison (s)", "wrong", "missed"), each),
    ]
    show(tables, [f"{result['runs']} truths, {100 * result['coverage']:.1f} % of all intervals hold the truth"])


if __name__ == "__main__":
    main()
