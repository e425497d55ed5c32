"""A robot that snaps is calibrated from recordings of three days, and plans a turn that the real one survives.

The real tubes bend more than drawn, their heated parts fade, and they rub. Every day the tracker stands elsewhere, the
drives are homed anew, and the tips are late by another time.

Result: numbers common to all days are found within their intervals. A plan with a confidence of 99.9 % states the
least margin of the real robot. The true robot keeps it, and so do all robots drawn from the posterior.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from tubeopt import ConcentricRobot, Friction, JointLimits, Tube, follow
from tubeopt.files.yaml_file import to_yaml
from tubeopt.robots.calibration import Calibration
from tubeopt.robots.robot import Robot
from tubeopt.runs.plan_study import load_plan_study
from tubeopt.show.page import tube_colour
from tubeopt.show.plots.style import new_figure, picture
from tubeopt.typing import Array
from tubeopt.validation import Fit, FitOptions, Measurements, fit, real_robots
from tubeopt.validation.tube_shapes import heated_pieces

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from tubeopt.show.plots.style import Axes

ROOT = Path(__file__).resolve().parents[1]
MM = 1e-3
RATE, NOISE, DAYS = 10.0, 0.3 * MM, 3
CONFIDENCE = 0.999

DRAWN = ConcentricRobot(
    (
        Tube(1.0 * MM, 0.75 * MM, 150 * MM, 90 * MM, 14.5),
        Tube(1.5 * MM, 1.15 * MM, 70 * MM, 60 * MM, 8.0),
    ),
    name="a pair that snaps",
)
LIMITS = JointLimits(((-1.0, 7.0), (-4.0, 4.0)), ((-8 * MM, 8 * MM), (-14 * MM, 0.0)))
"""In the workplace there is little room to turn about the snap."""

TRUE = {"curvature_1": 14.9, "curvature_2": 8.15, "fade_1": 6 * MM, "fade_2": 4 * MM, "friction_1": 0.008}
OWN = ("latency", "rotation_2", "translation_1", "translation_2")


def true_robot() -> ConcentricRobot:
    """The pair as it was made."""
    tubes = [
        Tube.of_pieces(
            tube.outer_diameter,
            tube.inner_diameter,
            heated_pieces(tube.curved_length, TRUE[f"curvature_{k}"], 0.0, TRUE[f"fade_{k}"]),
            straight_length=tube.straight_length,
        )
        for k, tube in enumerate(DRAWN.tubes, 1)
    ]
    return replace(DRAWN, tubes=tuple(tubes))


def homed(day: int) -> Calibration:
    """Zeros of the drives of a day."""
    random = np.random.default_rng(100 + day)
    zeros = random.uniform(-0.1, 0.1), random.uniform(-2 * MM, 2 * MM, 2)
    return replace(Calibration.none(2), rotation_offsets=(0.0, zeros[0]), translation_offsets=tuple(zeros[1]))


def record(day: int, count: int) -> Measurements:
    """Rows of one day: a path forward and back, then half as far and twice as fast."""
    random = np.random.default_rng(day)
    time = np.arange(count) / RATE
    last, phase = time[-1], random.uniform(0, 6, 4)

    def joints(t: Array) -> Array:
        slow, fast = 0.4 * last - np.abs(t - 0.4 * last), 2 * (0.1 * last - np.abs(t - 0.9 * last))
        reached = np.outer(np.where(t < 0.8 * last, slow, fast), [0.23, 0.31, 0.19, 0.29])
        waves = np.sin(reached + phase) + 0.6 * np.sin(2.3 * reached + 2 * phase)
        return np.asarray(waves * [0.75, 0.75, 14 * MM, 9 * MM] - [0.0, 0.0, 10 * MM, 15 * MM])

    read, late = joints(time), joints(np.maximum(time - random.uniform(0.03, 0.1), 0.0))
    path = homed(day).to_model(late[:, :2], late[:, 2:])
    tips = np.array(
        [e.tip_position for e in follow(true_robot(), *path, friction=Friction(TRUE["friction_1"])).equilibria]
    )
    seen = Rotation.random(rng=random).apply(tips) + random.uniform(-0.2, 0.2, 3) + random.normal(0, NOISE, tips.shape)
    return Measurements(read[:, :2], read[:, 2:], seen, time=time + 1e4 * day, source=f"day {day + 1}")


class Driven(NamedTuple):
    """Least margins on a plan; 0 where a robot snaps."""

    bound: float
    """What the plan states for the real robot."""
    drawn: Array
    """(N,) of robots drawn from the posterior."""
    true: float
    """Of the true robot, with the zeros of the last day."""


def drive(found: Fit, samples: int) -> Driven:
    """A full turn of the inner tube, planned with a confidence, and followed by drawn robots and the true one."""
    robot, reals = found.robot, real_robots(found.robot)
    assert isinstance(robot, ConcentricRobot)
    assert reals is not None
    question = {"kind": "plan", "robot": "robot.yaml", "goal_deg": [360, 0], "confidence": CONFIDENCE}
    with TemporaryDirectory() as folder:
        replace(robot, joint_limits=LIMITS).save(Path(folder) / "robot.yaml")
        (Path(folder) / "plan.yaml").write_text(to_yaml(question, "A full turn of the inner tube."))
        plan = load_plan_study(Path(folder) / "plan.yaml").run()
    assert plan.proof.real is not None
    rows = np.unique(np.linspace(0, len(plan.rotations) - 1, 80, dtype=int))
    path = plan.rotations[rows], plan.translations[rows]
    numbers = np.random.default_rng(1).normal(size=(samples, reals.size))
    drawn = np.array([least_margin(*reals.at(z, *path)) for z in numbers])
    true = least_margin(true_robot(), *homed(DAYS - 1).to_model(*reals.readings(*path)))
    return Driven(float(plan.proof.real.margin[0]), drawn, true)


def least_margin(robot: Robot, rotations: Array, translations: Array) -> float:
    """Least margin of a robot without friction on a joint path; 0 if it snaps there."""
    path = follow(robot, rotations, translations)
    return 0.0 if path.snaps else min(e.margin for e in path.equilibria)


def main(directory: Path, samples: int = 60, rows: int = 300) -> list[Path]:
    """Calibrate from `rows` rows a day, and draw `samples` robots that follow the plans."""
    found = fit(DRAWN, [record(day, rows) for day in range(DAYS)], [*OWN, *TRUE], FitOptions(folds=5))
    for e in found.estimates:
        if e.name in TRUE:
            print(f"{e.name}: {e.posterior_low:.4g} to {e.posterior_high:.4g} {e.unit}, true {TRUE[e.name]:.4g}")
    for day, (v, own) in enumerate(zip(found.before.recordings, found.by_recording, strict=True), 1):
        print(f"day {day}: RMS {v.summary.rms / MM:.2f} mm as drawn, {own.rms / MM:.2f} mm from the other days")
    driven = drive(found, samples)
    print(f"plan: margin of the real robot at least {driven.bound:.3f}; of the true one {driven.true:.3f}")
    print(f"of {samples} robots drawn {np.count_nonzero(driven.drawn < driven.bound)} have less")
    path = directory / "calibrate_three_days.png"
    plot_three_days((found, driven), path)
    return [path]


@picture
def plot_three_days(data: tuple[Fit, Driven]) -> Figure:
    """Intervals of the common numbers, errors of every day, and margins on the plan."""
    found, driven = data
    figure = new_figure(7.2, 2.9)
    left, middle, right = figure.subplots(1, 3)
    _draw_intervals(left, found)
    cumulative = np.linspace(0, 100, 201)
    for day, v in enumerate(found.before.recordings):
        colour, mine = tube_colour(day), slice(day * len(v.measurements), (day + 1) * len(v.measurements))
        assert found.held_out_recordings is not None
        for errors, line in ((v.errors, ":"), (found.held_out_recordings[mine], "-")):
            name = f"day {day + 1}" if line == "-" else None
            middle.plot(np.percentile(errors, cumulative) / MM, cumulative, line, color=colour, label=name)
    middle.set(xlabel="tip error (mm)", ylabel="rows with less (%)", xlim=(0, None), ylim=(0, 100))
    middle.plot([], [], ":", color="grey", label="as drawn")
    middle.legend(loc="lower right", fontsize=7)
    right.hist(driven.drawn, 15, color=tube_colour(2), alpha=0.6, label="robots drawn")
    right.axvline(driven.bound, color="black", linestyle="--", label="99.9 % have more")
    right.axvline(driven.true, color=tube_colour(0), label="true robot")
    right.set(xlabel="least margin on the plan", ylabel="robots", xlim=(0, None))
    right.legend(loc="upper left", fontsize=7)
    return figure


def _draw_intervals(axes: Axes, found: Fit) -> None:
    """Estimates less the truth, in half widths of their intervals of 95 %."""
    common = [e for e in found.estimates if e.name in TRUE]
    for k, e in enumerate(common):
        half = e.posterior_high - e.value
        axes.errorbar((e.value - TRUE[e.name]) / half, -k, xerr=1.0, fmt="o", ms=4, capsize=3, color=tube_colour(0))
    axes.axvline(0, color="black", linewidth=0.8)
    axes.set_yticks(range(0, -len(common), -1), [e.name.replace("_", " ") for e in common])
    axes.set(xlabel="estimate less truth\n(half widths of the 95 % interval)", ylim=(0.5 - len(common), 0.5))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
