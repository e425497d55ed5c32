"""Robots whose tubes are bent unlike any drawing: what a learned change of the curvature gains, and its certificates.

    python -m benchmarks.learned [--runs N] [--first SEED] [--rows N] [--jsonl FILE]

Every run draws two tubes whose precurvature varies along them in waves, in and out of the plane of their bend, by up
to half of its mean. Some can snap, and some cannot. One recording of `--rows` rows with 0.1 mm of noise is fitted
twice from the drawing of one curvature: with zeros, lengths, curvatures and stiffnesses alone, and with learned
changes beside them. Printed are the errors held out and on a new path, and in how many runs the certificate of the
fitted robot at 99.9 % is positive though the true robot can snap. For two tubes the certificate is exact, so that a
negative one of the true robot means that it can. Learned robots that are certified without the posterior follow a full
turn of a tube, on which none may snap: that is their own certificate, a theorem.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from tubeopt import ConcentricRobot, Piece, Tube, follow, snap_free_certificate
from tubeopt.typing import Array
from tubeopt.validation import Fit, FitOptions, fit, validate
from tubeopt.validation.certainty import certificate_bounds
from tubeopt.validation.effects import Setup

from .campaign import add_campaign, campaign
from .posterior import MM, ROBOT, Way, measure
from .timing import clock, show, table

NOISE = 0.1 * MM
DRAWN = replace(
    ROBOT, tubes=tuple(replace(tube, curvature=bend) for tube, bend in zip(ROBOT.tubes, (13.0, 8.0), strict=True))
)
SCALES = (0.65, 1.0)
"""Factors on the curvatures of the drawing: of the least nearly no true robot can snap, of the greatest most can."""

DRIVES = ("rotation_2", "translation_1", "translation_2")
PHYSICS = (
    *DRIVES, "curvature_1", "curvature_2", "curved_length_1", "curved_length_2", "torsional_stiffness_1",
    "bending_stiffness_1",
)  # fmt: skip
LEARNED = (*DRIVES, "curvature_1", "curvature_2", "torsional_stiffness_1", "learned_curvature_all")
PROBABILITY = 0.999


@dataclass(frozen=True)
class Learned:
    """A fit; errors in mm."""

    held_out: float
    """Held-out root mean square."""
    new: float
    """Root mean square on a new path, less the noise."""
    seconds: float
    certificate: float
    """Certificate of the fitted robot."""
    bound: float
    """The same at 99.9 %."""


@dataclass(frozen=True)
class Run:
    """What became of a truth."""

    seed: int
    certificate: float
    """Certificate of the true robot."""
    physics: Learned
    learned: Learned
    snaps: int
    """Snaps of the learned robot on a full turn, where it is certified; -1 where it is not."""


def wavy(tube: Tube, random: np.random.Generator) -> Tube:
    """A tube whose precurvature varies in waves about that of its drawing."""
    inside, across = random.uniform(0.25, 0.5), random.uniform(0.1, 0.4)
    waves, phase = random.uniform(0.5, 1.5, 2), random.uniform(0, 2 * np.pi, 2)
    mean = tube.curvature * random.uniform(0.85, 1.1)

    def bend(s: float) -> Array:
        along = np.sin(2 * np.pi * waves * s / tube.curved_length + phase)
        return mean * np.array([1 + inside * along[0], across * along[1], 0.0])

    return Tube.of_pieces(
        tube.outer_diameter,
        tube.inner_diameter,
        [Piece(tube.curved_length, bend)],
        straight_length=tube.straight_length,
    )


def run(seed: int, rows: int) -> Run:
    """One truth."""
    random = np.random.default_rng(seed)
    scale = random.uniform(*SCALES)
    drawn = replace(DRAWN, tubes=tuple(replace(tube, curvature=scale * tube.curvature) for tube in DRAWN.tubes))
    truth = replace(drawn, tubes=tuple(wavy(tube, random) for tube in drawn.tubes))
    setup = Setup.of(truth)
    data, new = (
        measure(
            setup, rows, seed + 10_000 * k, drawn=truth, noise=NOISE,
            path=Way(tuple(random.uniform(0, 6, 4).tolist()), 0.75, frame=seed),
        )
        for k in range(2)
    )  # fmt: skip
    translations = np.array(truth.home_translations)
    found: list[Learned] = []
    fits: list[Fit] = []
    for names in (PHYSICS, LEARNED):
        seconds, result = clock(partial(fit, drawn, data, names, FitOptions(folds=5)))
        errors = validate(result.robot, new, registration="saved").errors
        bounds = certificate_bounds(result.robot, snap_free_certificate, translations, (PROBABILITY,))
        assert bounds is not None
        assert result.held_out is not None
        found.append(
            Learned(
                1e3 * result.held_out.rms,
                1e3 * float(np.sqrt(max((errors**2).mean() - 3 * NOISE**2, 0.0))),
                seconds,
                snap_free_certificate(result.robot, translations),
                float(bounds[0]),
            )
        )
        fits.append(result)
    snaps = -1
    if found[1].certificate > 0:
        turn = np.radians([[0.0, 0.0], [360.0, 0.0]])
        robot = fits[1].robot
        assert isinstance(robot, ConcentricRobot)
        snaps = len(follow(replace(robot, calibration=None), turn, np.tile(translations, (2, 1))).snaps)
    return Run(seed, snap_free_certificate(truth, translations), found[0], found[1], snaps)


def read(record: dict[str, Any]) -> Run:
    """A run of a file."""
    return Run(**record | {name: Learned(**record[name]) for name in ("physics", "learned")})


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    add_campaign(parser, runs=5)
    parser.add_argument("--rows", type=int, default=300, help="rows of a recording")
    options = parser.parse_args()
    runs = campaign(options, lambda seed: run(seed, options.rows), read)
    report(runs)


def report(runs: list[Run]) -> None:
    """Print errors and certificates of all runs."""
    rows = []
    for name in ("physics", "learned"):
        found: list[Learned] = [getattr(one, name) for one in runs]
        true = [one.certificate for one in runs]
        certified = [x > 0 for x in (each.bound for each in found)]
        false = sum(sure and value <= 0 for sure, value in zip(certified, true, strict=True))
        off = np.median([abs(each.certificate - value) for each, value in zip(found, true, strict=True)])
        rows.append(
            (
                name,
                f"{np.median([each.held_out for each in found]):.3f}",
                f"{np.median([each.new for each in found]):.3f}",
                f"{off:.3f}",
                f"{sum(certified)}",
                f"{false}",
                f"{np.median([each.seconds for each in found]):.1f}",
            )
        )
    ratio = [one.learned.held_out / one.physics.held_out for one in runs]
    own = [one for one in runs if one.snaps >= 0]
    columns = ("fit", "held out mm", "new path mm", "certificate off by", "certified 99.9 %", "falsely", "s")
    lines = [
        f"{len(runs)} truths, of which {sum(one.certificate <= 0 for one in runs)} can snap",
        f"held-out error with the learned change over that without: {np.median(ratio):.2f} in the median, "
        f"at most a half in {sum(x <= 0.5 for x in ratio)} of {len(runs)}",
        f"{len(own)} learned robots have a positive certificate; {sum(one.snaps for one in own)} snaps on a full turn",
    ]
    show([table("physics wrong by design", columns, rows)], lines)


if __name__ == "__main__":
    main()
