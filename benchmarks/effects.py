"""Choice of effects on robots whose effects are known: what is chosen falsely, and what means over sets gain.

    python -m benchmarks.effects [--runs N] [--first SEED] [--rows N] [--jsonl FILE]

Every run draws which of six effects a robot has, friction among them, each with probability 1/2, and their sizes. The
robot follows a path of `--rows` rows, measured with 0.3 mm of noise. `compare_effects` chooses among all effects that
it tries by default. Printed are effects that are chosen and are not there, effects that are there and are not chosen,
the held-out errors that include the choice, and the true errors on a new path: of the chosen set and of the mean over
sets, and how many coordinates there are in the bands of their posteriors. With `--jsonl` finished runs are kept in a
file and are not repeated.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from tubeopt.robots.calibration import Calibration
from tubeopt.robots.robot import Robot
from tubeopt.validation import FitOptions, compare_effects, validate

from .campaign import add_campaign, campaign
from .posterior import ROBOT, Way, draw, measure, setup_of, within_bands
from .timing import clock, show, table

ROTATION = 0.8
"""Size of the waves of the rotations on the path, rad."""


@dataclass(frozen=True)
class Choice:
    """What was chosen for a truth; errors in mm."""

    seed: int
    false: list[str]
    """Effects chosen that are not there."""
    missed: list[str]
    """Effects there that are not chosen."""
    false_certain: list[str]
    """Certain effects that are not there."""
    certain: int
    """Certain effects."""
    alike: int
    """Folds of five without which the same effects are chosen."""
    told: float
    """Held-out error that includes the choice."""
    told_mean: float
    """The same of the mean over sets."""
    true: float
    """Error of the chosen set on a new path."""
    true_mean: float
    """Error of the mean over sets there."""
    inside: float
    """Fraction of coordinates there within the bands of 95 % of the chosen set."""
    inside_mean: float
    """The same of the mean over sets."""
    seconds: float


def kind(name: str) -> str:
    """Kind of a parameter, without its number."""
    return name.rpartition("_")[0] if name[-1].isdigit() else name


def chosen(seed: int, rows: int) -> Choice:
    """One truth."""
    random = np.random.default_rng(seed)
    known, _ = draw(seed, rubs=True, unfitted=0.0)
    kinds = [k for k in dict.fromkeys(map(kind, known)) if k != "rotation_lag"]
    there = {k for k in kinds if random.random() < 0.5}
    setup = setup_of({name: value for name, value in known.items() if kind(name) in there})

    def record(number: int) -> Way:
        return Way(tuple(random.uniform(0, 6, 4).tolist()), ROTATION, frame=seed)

    recording, new = (measure(setup, rows, 10 * seed + k, path=record(k)) for k in range(2))
    assert new.time is not None
    new = replace(new, time=new.time + 1e4)
    seconds, found = clock(partial(compare_effects, ROBOT, recording, options=FitOptions(folds=5)))
    if found.fit is None:  # the registration of the drawing is that of the mean
        calibration = Calibration.none(ROBOT.n_tubes)
        assert found.averaged.calibration is not None
        calibration = replace(calibration, registration=found.averaged.calibration.registration)
        fitted: Robot = replace(ROBOT, calibration=calibration)
    else:
        fitted = found.fit.robot
    each = [validate(robot, new, registration="saved") for robot in (fitted, found.averaged)]
    steps = {step.effect for step in found.steps}
    return Choice(
        seed,
        sorted(steps - there),
        sorted(there - steps),
        sorted(set(found.certain) - there),
        len(found.certain),
        found.alike,
        1e3 * found.chosen_anew.rms,
        1e3 * found.averaged_anew.rms,
        *(1e3 * one.summary.rms for one in each),
        *(within_bands(one.robot, one) if one.robot.posterior else float("nan") for one in each),
        seconds,
    )


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    add_campaign(parser, runs=3)
    parser.add_argument("--rows", type=int, default=150, help="rows of the path")
    options = parser.parse_args()
    runs = campaign(options, lambda seed: chosen(seed, options.rows), lambda record: Choice(**record))
    settled = [c for c in runs if c.alike >= 4]
    unsettled = [c for c in runs if c.alike < 4]
    rows = [
        (
            name,
            str(len(some)),
            *(
                f"{np.median([getattr(c, key) for c in some]):.3f}"
                for key in ("told", "told_mean", "true", "true_mean")
            ),
            *(f"{100 * np.nanmean([getattr(c, key) for c in some]):.1f}" for key in ("inside", "inside_mean")),
            f"{sum(c.true_mean < c.true for c in some)}",
        )
        for name, some in (("settled", settled), ("folds disagree", unsettled))
        if some
    ]
    columns = (
        "",
        "runs",
        "held out",
        "mean held out",
        "new path",
        "mean, new path",
        "in bands %",
        "mean %",
        "mean better",
    )
    clean, sure = (sum(not getattr(c, name) for c in runs) for name in ("false", "false_certain"))
    count = f"{sum(c.certain for c in runs)} effects certain"
    note = f"nothing false chosen in {clean} of {len(runs)}; nothing false is certain in {sure}; {count}"
    show([table("median errors, mm", columns, rows)], [note])


if __name__ == "__main__":
    main()
