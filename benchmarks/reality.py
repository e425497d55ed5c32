"""From recordings of robots whose errors are known to plans that the true robots follow.

    python -m benchmarks.reality [--runs N] [--first SEED] [--rows N] [--sessions N] [--unfitted SIZE] [--plans]
                                [--drawn N] [--jsonl F]

Every run draws a truth: stiffnesses, curvatures, heated parts that fade, friction between the tubes and a lag of a
drive, which all recordings share; latency, zeros of the drives and the tracker's frame, of which each of `--sessions`
recordings has its own. With `--unfitted` gains, lengths and stiffnesses have SIZE times the errors of a drawing, which
no fit knows. Each has `--rows` rows with 0.3 mm of noise. All of them are fitted, from the drawing. Printed are how
often intervals of 95 % hold the truth, the held-out error and the expected one against that of the fitted robot on new
paths, and how many coordinates, held out and of the new path, are in their bands of 95 %.

With `--plans` the fitted robot plans a full turn of a tube without and with `--confidence 0.999`. The true robot and
`--drawn` robots of the posterior follow both plans. Printed are how many snap, and what the confidence costs.
`--jsonl` keeps every run as it ends, and goes on after those that are kept there.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections import defaultdict
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from tubeopt import SolveError, follow
from tubeopt.files.yaml_file import to_yaml
from tubeopt.planning.trajectory import Trajectory
from tubeopt.robots.concentric import ConcentricRobot
from tubeopt.robots.robot import Robot
from tubeopt.runs.plan_study import load_plan_study
from tubeopt.typing import Array
from tubeopt.validation import FitOptions, Measurements, fit, real_robots, validate
from tubeopt.validation.effects import Setup

from .campaign import add_campaign, campaign
from .posterior import MM, ROBOT, Way, draw, measure, setup_of, within_bands
from .timing import clock, show, table

SNAPS = replace(
    ROBOT, tubes=tuple(replace(tube, curvature=bend) for tube, bend in zip(ROBOT.tubes, (14.5, 8.0), strict=True))
)
"""Drawing of a robot that snaps; its carriages leave little room to turn about a full turn without."""

NARROW = replace(SNAPS, joint_limits=replace(SNAPS.limits, translations=((-14 * MM, 14 * MM), (-14 * MM, 0.0))))

SHARED = ("curvature_1", "curvature_2", "torsional_stiffness_1", "friction_1", "rotation_lag_1", "fade_1", "fade_2")
OWN = ("latency", "rotation_2", "translation_1", "translation_2")

NEW = 4
"""New paths on which the true error is measured."""

GENTLE = 0.75
"""Waves of the rotations of a recording, rad: the robot does not snap on them."""

CONFIDENCE = 0.999

WAYPOINTS = 250
"""Most waypoints of a plan that robots follow."""


@dataclass(frozen=True)
class Drive:
    """A plan with what follows it."""

    seconds: float
    """Time of the plan, s."""
    margin: float
    """Least margin of the fitted robot on it."""
    snapped: int
    """Robots that snap, of those drawn and the true one."""
    true_margin: float
    """Least margin of the true robot; 0 where it snaps."""


@dataclass(frozen=True)
class Run:
    """What became of a truth; errors in mm."""

    seed: int
    held: dict[str, bool]
    """Whether the interval of the posterior holds the truth, by name of the estimate."""
    inside: float
    """Fraction of held-out coordinates in their bands."""
    inside_new: float
    """The same on a new path."""
    told: float
    """Held-out root mean square of all recordings."""
    true: float
    """Root mean square on new paths."""
    seconds: float
    """Time of the fit, s."""
    expected: float = math.nan
    """Root mean square expected on new paths by the posterior."""
    within: bool | None = None
    """Whether that of new paths, in the recorded ranges, is in its interval of 95 %."""
    true_inside: float = math.nan
    """Root mean square on new paths, in the recorded ranges."""
    plain: Drive | None = None
    sure: Drive | None = None


@dataclass(frozen=True)
class Truth:
    """A robot with recordings of it."""

    values: dict[str, float]
    """What all recordings share."""
    own: tuple[dict[str, float], ...]
    """What each has of its own."""
    recordings: tuple[Measurements, ...]
    new: tuple[Measurements, ...]
    """More in the frame and with the zeros of the last, which no fit sees."""


def truth_of(seed: int, rows: int, sessions: int, unfitted: float) -> Truth:
    """A truth; the paths of all recordings differ."""
    random = np.random.default_rng(seed)
    known, hidden = draw(seed, rubs=True, unfitted=unfitted)
    shared = {name: value for name, value in (known | hidden).items() if name not in OWN}
    for tube, (old, new) in enumerate(zip(ROBOT.tubes, SNAPS.tubes, strict=True)):
        shared[f"curvature_{tube + 1}"] *= new.curvature / old.curvature
    own = tuple(
        {name: draw(seed + 100_000 * (k + 1), rubs=True, unfitted=0.0)[0][name] for name in OWN}
        for k in range(sessions)
    )

    def record(k: int, number: int) -> Measurements:
        path = Way(tuple(random.uniform(0, 6, 4).tolist()), GENTLE, frame=10 * seed + k)
        m = measure(setup_of(shared | own[k], SNAPS), rows, 1000 * seed + number, drawn=SNAPS, path=path)
        assert m.time is not None
        return replace(m, time=m.time + 1e4 * number, source=f"recording {number}")

    recordings = tuple(record(k, k) for k in range(sessions))
    return Truth(shared, own, recordings, tuple(record(sessions - 1, sessions + k) for k in range(NEW)))


def run(seed: int, options: argparse.Namespace) -> Run:
    """One truth."""
    truth = truth_of(seed, options.rows, options.sessions, options.unfitted)
    names = [*OWN, *SHARED]
    seconds, found = clock(partial(fit, SNAPS, list(truth.recordings), names, FitOptions(folds=5)))
    values = truth.values | {f"{name}@{k + 1}": x for k, own in enumerate(truth.own) for name, x in own.items()}
    if options.sessions == 1:
        values |= truth.own[0]
    held = {e.name: e.posterior_low <= values[e.name] <= e.posterior_high for e in found.estimates}
    new = [validate(found.robot, m, registration="saved") for m in truth.new]
    posterior = found.robot.posterior
    assert posterior is not None
    assert found.held_out_errors is not None
    expected = found.new_paths
    assert expected is not None
    inside = rms(np.concatenate([each.errors[~each.outside] for each in new]))
    out = Run(
        seed,
        held,
        found.held_out_inside or 0.0,
        float(np.mean([within_bands(found.robot, each) for each in new])),
        1e3 * rms(found.held_out_errors),
        1e3 * rms(np.concatenate([each.errors for each in new])),
        seconds,
        1e3 * expected.rms,
        bool(expected.low < inside < expected.high),
        1e3 * inside,
    )
    if not options.plans:
        return out
    assert isinstance(found.robot, ConcentricRobot)
    made = drives(found.robot, truth, options.drawn, seed)
    return replace(out, plain=made.get("plain"), sure=made.get("sure"))


def drives(fitted: ConcentricRobot, truth: Truth, drawn: int, seed: int) -> dict[str, Drive]:
    """Plans without and with a confidence, each followed by the true robot and by those drawn."""
    question = {"kind": "plan", "robot": "robot.yaml", "goal_deg": [360, 0]}
    setup = setup_of(truth.values | truth.own[-1], SNAPS)
    out = {}
    with TemporaryDirectory() as folder:
        replace(fitted, joint_limits=NARROW.joint_limits).save(Path(folder) / "robot.yaml")
        for name, keys in (("plain", {}), ("sure", {"confidence": CONFIDENCE})):
            (Path(folder) / "plan.yaml").write_text(to_yaml(question | keys, "A plan. Source: a benchmark."))
            try:
                seconds, plan = clock(load_plan_study(Path(folder) / "plan.yaml").run)
            except SolveError as error:
                print(f"truth {seed}: {error}", file=sys.stderr)
                continue
            out[name] = driven(fitted, plan, setup, drawn, seconds, seed)
    return out


def driven(fitted: Robot, plan: Trajectory, setup: Setup, drawn: int, seconds: float, seed: int) -> Drive:
    """The true robot, and robots of the posterior, on a plan."""
    reals = real_robots(fitted)
    assert reals is not None
    every = max(1, len(plan.rotations) // WAYPOINTS)
    rows = np.unique(np.append(np.arange(0, len(plan.rotations), every), len(plan.rotations) - 1))
    path = plan.rotations[rows], plan.translations[rows]
    true = least_margin(setup.robot(SNAPS), *setup.drives.to_model(*reals.readings(*path)))
    numbers = np.random.default_rng(seed).normal(size=(drawn, reals.size))
    margins = [least_margin(*reals.at(z, *path)) for z in numbers]
    return Drive(seconds, plan.proof.least_margin, sum(m <= 0 for m in [true, *margins]), true)


def least_margin(robot: Robot, rotations: Array, translations: Array) -> float:
    """Least margin of a robot without friction on a joint path, 0 if it snaps there."""
    assert isinstance(robot, ConcentricRobot)
    path = follow(replace(robot, friction=None), rotations, translations)
    return 0.0 if path.snaps else min(e.margin for e in path.equilibria)


def rms(errors: Array) -> float:
    """Root mean square of numbers that may be NaN."""
    return float(np.sqrt(np.nanmean(np.square(errors))))


def read(record: dict[str, Any]) -> Run:
    """A run of a file."""
    plans = {name: record[name] and Drive(**record[name]) for name in ("plain", "sure")}
    return Run(**record | plans)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    add_campaign(parser, runs=5)
    parser.add_argument("--rows", type=int, default=300, help="rows of a recording")
    parser.add_argument("--sessions", type=int, default=3, help="recordings of a truth")
    parser.add_argument("--unfitted", type=float, default=0.0, help="size of errors of the drawing that are not fitted")
    parser.add_argument("--plans", action="store_true", help="plan with the fitted robots")
    parser.add_argument("--drawn", type=int, default=50, help="robots of the posterior that follow a plan")
    options = parser.parse_args()
    runs = campaign(options, lambda seed: run(seed, options), read)
    report(runs, options.drawn)


def report(runs: list[Run], drawn: int) -> None:
    """Print how often intervals hold, held-out errors against true ones, and what became of plans."""
    holds = defaultdict[str, list[bool]](list)
    for one in runs:
        for name, held in one.held.items():
            holds[name.partition("@")[0]].append(held)
    rows = [(name, f"{len(each)}", f"{100 * np.mean(each):.0f}") for name, each in holds.items()]
    every = [held for each in holds.values() for held in each]
    ratio = [one.told / one.true for one in runs]
    expected = [one.expected / one.true_inside for one in runs]
    lines = [
        f"{len(runs)} truths: {len(every)} intervals of 95 %, {100 * np.mean(every):.1f} % hold the truth",
        f"coordinates in their bands of 95 %: {100 * np.mean([one.inside for one in runs]):.1f} % held out, "
        f"{100 * np.mean([one.inside_new for one in runs]):.1f} % of new paths",
        f"held-out error over that on new paths: {np.mean(ratio):.3f} in the mean, {min(ratio):.3f} to "
        f"{max(ratio):.3f}, within 10 % for {sum(abs(x - 1) < 0.1 for x in ratio)}; "
        f"RMS {np.mean([one.true for one in runs]):.3f} mm",
        f"error expected on new paths over that in the recorded ranges: {np.nanmean(expected):.3f} in the mean, "
        f"{np.nanmin(expected):.3f} to {np.nanmax(expected):.3f}; "
        f"{sum(one.within is True for one in runs)} of {len(runs)} in their intervals of 95 %",
        f"a fit takes {np.median([one.seconds for one in runs]):.1f} s of processor time, "
        f"{max(one.seconds for one in runs):.1f} s at most",
    ]
    for name in ("plain", "sure"):
        plans = [plan for one in runs if (plan := getattr(one, name)) is not None]
        if plans:
            lines.append(
                f"{name} plans: {len(plans)} of {len(runs)}; {sum(p.snapped for p in plans)} of "
                f"{len(plans) * (drawn + 1)} robots snap; median {np.median([p.seconds for p in plans]):.1f} s, "
                f"least margin {min(p.margin for p in plans):.3f}, "
                f"of the true robots {min(p.true_margin for p in plans):.3f}"
            )
    show([table("intervals of 95 %", ("parameter", "intervals", "hold %"), rows)], lines)


if __name__ == "__main__":
    main()
