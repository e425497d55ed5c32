"""What everything else is made of: forward kinematics, batches, a servo, derivatives, equilibria and designs.

    python -m benchmarks.core [--only QUESTION ...] [--json] [--against DIRECTORY]

Times are processor times of one thread, after an untimed first round that loads and compiles. With `--against` the
package of another checkout is asked the same questions in a process of its own. Both answer call by call in turn, since
a shared machine changes its speed within seconds; what counts is the median of the ratios of such pairs. Beside it
stands by how much answers differ, relative to the largest of each kind. What a package cannot be asked is left out.
Both find their compiled kernels in TUBEOPT_CACHE.
"""

from __future__ import annotations

import argparse
import inspect
import json
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tubeopt import (
    ConcentricRobot,
    DesignTask,
    Equilibrium,
    IkSession,
    Load,
    RateLimits,
    find_equilibria,
    forward_kinematics,
    load_robot,
    optimize_design,
    plan_trajectory,
    verify_trajectory,
)
from tubeopt import forward_kinematics_batch as batch
from tubeopt.design import Free, Objective, SnapFree, Strain

from .joints import circle, ordered_joints, path_joints, random_joints
from .shooting import Array
from .timing import ROOT, ask_line, clock, dump, milliseconds, running, show, summarise, table

Call = Callable[[], Any]

ROBOTS = ROOT / "configs" / "robots"

DIMENSIONS = ("curvature", "straight_length", "curved_length", "bending_stiffness", "torsional_stiffness")


@dataclass(frozen=True)
class Question:
    """One kind of call: in words, what gives the calls, which numbers of an answer are compared, and how many questions
    a call asks at once."""

    words: str
    calls: Callable[[], Iterable[Call]]
    numbers: Callable[[Any], Array]
    share: int = 1


PUSH = Load((0.01, 0.005, 0.0))
"""Bears on the thesis robot at all random joint values that are asked."""


def robot(name: str = "thesis_ctr") -> Any:
    """A robot of this project."""
    return load_robot(ROBOTS / f"{name}.yaml")


def of_pose(pose: Equilibrium) -> Array:
    """Tip, m, and margin."""
    return np.append(pose.tip_position, pose.margin)


def cold() -> Iterable[Call]:
    """Random configurations, each by itself."""
    one = robot()
    return [partial(forward_kinematics, one, a, d) for a, d in random_joints(one, 300)]


def eccentric() -> Iterable[Call]:
    """Random rotations of the eccentric robot of the thesis."""
    one = robot("thesis_etr")
    return [partial(forward_kinematics, one, a) for a in np.random.default_rng(7).uniform(-1, 1, (200, 3))]


def bundles() -> Iterable[Call]:
    """The same rotations of the same tubes by the energy model."""
    one = robot("thesis_etr").bundle()
    return [partial(forward_kinematics, one, a) for a in np.random.default_rng(7).uniform(-1, 1, (200, 3))]


def warm(translate: bool) -> Iterable[Call]:
    """Steps of a path, each from the one before."""
    one, last = robot(), []
    # Checkouts before 0.1.0 call it `guess`.
    start = "start" if "start" in inspect.signature(forward_kinematics).parameters else "guess"

    def step(a: Array, d: Array) -> Equilibrium:
        last[:] = [forward_kinematics(one, a, d, **{start: last[0] if last else None})]
        return last[0]

    return [partial(step, a, d) for a, d in path_joints(one, 300, translate=translate)]


def loaded(load: Load) -> Iterable[Call]:
    """Random rotations of the thesis robot under a load."""
    one = robot()
    return [partial(forward_kinematics, one, a, load=load) for a, _ in random_joints(one, 60)]


def many() -> Iterable[Call]:
    """10,000 configurations at once, three times."""
    one = robot()
    return [partial(batch, one, *ordered_joints(one, 10_000))] * 3


def servo() -> Iterable[Call]:
    """Targets 0.5 mm apart."""
    session = IkSession(robot(), min_margin=0.1)
    return [partial(session.solve, target) for target in circle((0.055, 0.02, 0.15), 0.03, 200)]


def slopes(name: str = "thesis_ctr", load: Load | None = None, read: str = "position", **asked: Any) -> Iterable[Call]:
    """Jacobians of random configurations, of which one part is read; of tubes off the centreline, of random
    rotations. Each is that of an equilibrium whose problem is still kept."""
    one = robot(name)
    if isinstance(one, ConcentricRobot):
        joints = random_joints(one, 200 if load is None else 100)
    else:
        joints = [(a, one.home_translations) for a in np.random.default_rng(7).uniform(-1, 1, (200, one.n_tubes))]
    poses = [forward_kinematics(one, a, d, load=load) for a, d in joints]

    def ask(pose: Equilibrium) -> Any:
        result = pose.jacobian(**asked)
        getattr(result, read)
        return result

    return [partial(ask, pose) for pose in poses]


def of_slopes(found: Any) -> Array:
    """Of the tip by the rotations, m/rad, and of the margin."""
    return np.append(found.position[:, : found.position.shape[1] // 2].ravel(), found.margin[0])


def every(name: str, times: int) -> Iterable[Call]:
    """All equilibria, at rotations that change a little."""
    one = robot(name)
    first = np.random.default_rng(3).uniform(-2, 2, one.n_tubes)
    return [partial(find_equilibria, one, first + 0.1 * k) for k in range(times)]


def verifications(load: Load | None = None) -> Iterable[Call]:
    """A motion of the thesis robot that is verified, with a limit of the speed of the tip."""
    rotations = np.radians([[0, 0, 0], [60, 20, 0], [100, -40, 30]])
    shift = [[0.0, 0, 0], [-0.01, -0.015, -0.02], [0.0, -0.02, -0.03]]
    rates = RateLimits(tip=0.5)
    return [partial(verify_trajectory, robot(), [0.0, 4.0, 10.0], rotations, shift, rate_limits=rates, load=load)] * 4


def plans() -> Iterable[Call]:
    """Plans between joint values."""
    one = robot()
    goals = np.radians([[100, 20, 0], [60, -50, 30], [150, 0, 60]])
    return [partial(plan_trajectory, one, [np.zeros(3)] * 2, (goal, np.zeros(3))) for goal in goals]


def designs(name: str, most: float, aim: str, *more: Any) -> Iterable[Call]:
    """The curvatures of a robot that cannot snap at home."""
    free = (Free("curvature", (0, 1, 2), 0.5, most),)
    task = DesignTask(robot(name), free, (SnapFree(0.05), *more), Objective(aim))
    return [partial(optimize_design, task)] * 5


QUESTIONS = {
    "cold": Question("forward kinematics, cold", cold, of_pose),
    "eccentric": Question("the same of an eccentric robot", eccentric, lambda pose: pose.tip_position),
    "bundle": Question("the same by the energy model", bundles, lambda pose: pose.tip_position),
    "warm": Question("forward kinematics, warm", partial(warm, translate=True), of_pose),
    "held": Question("the same, translations held", partial(warm, translate=False), of_pose),
    "force": Question("the same under a force on the tip", partial(loaded, Load((0.02, 0.01, 0.0))), of_pose),
    "moment": Question(
        "the same under a moment on the tip",
        partial(loaded, Load(moment=(0.001, 0.002, 0.001))),
        lambda pose: pose.tip_position,
    ),
    "batch": Question(
        "one of a batch of 10,000", many, lambda b: np.column_stack([b.tip_position, b.margin])[:2].ravel(), 10_000
    ),
    "servo": Question("step of a servo", servo, lambda answer: answer.equilibrium.tip_position),
    "jacobian": Question("Jacobian with margin", slopes, lambda j: np.append(j.position[:, :6:2], j.margin[0])),
    "dimensions": Question(
        "Jacobian by all 7n dimensions",
        lambda: slopes(wrt=("rotations", "translations", *DIMENSIONS)),
        lambda j: np.append(j.position[:, :6:2], j.margin[0]),
    ),
    "jacobian-pieces": Question("Jacobian of tubes made of pieces", partial(slopes, "example_pieces"), of_slopes),
    "jacobian-loaded": Question("Jacobian under a force", partial(slopes, load=PUSH), of_slopes),
    "jacobian-loaded-margin": Question(
        "Jacobian under a force, with margin", partial(slopes, load=PUSH, read="margin"), of_slopes
    ),
    "jacobian-eccentric": Question(
        "Jacobian of an eccentric robot", partial(slopes, "thesis_etr", read="margin"), of_slopes
    ),
    "verify": Question("verify a trajectory", verifications, lambda proof: np.array([proof.least_margin])),
    "verify-loaded": Question(
        "verify a trajectory under a force",
        partial(verifications, Load((0.02, 0.01, 0.0))),
        lambda proof: np.array([proof.least_margin]),
    ),
    "plan": Question("plan to joint values", plans, lambda plan: plan.time[-1:]),
    "equilibria": Question(
        "all equilibria of the thesis robot",
        partial(every, "thesis_ctr", 6),
        lambda found: np.array([len(found), *of_pose(found[0])]),
    ),
    "segments": Question(
        "all equilibria of three eccentric segments",
        partial(every, "example_three_segment_etr", 1),
        lambda found: np.array([len(found), *of_pose(found[0])]),
    ),
    "snap-free": Question(
        "design: thesis robot, snap-free",
        partial(designs, "thesis_ctr", 15.0, "change"),
        lambda design: np.array([tube.curvature for tube in design.robot.tubes]),
    ),
    "turn": Question(
        "design: tightest turn",
        partial(designs, "example_equal_ends", 30.0, "tip_curvature", Strain((0.01,))),
        lambda design: np.array([tube.curvature for tube in design.robot.tubes]),
    ),
}


def ask(question: Question) -> dict[str, Any]:
    """Seconds per call after an untimed first round, and the numbers of the answers."""
    for call in list(question.calls())[:3]:
        call()
    timed = [clock(call) for call in question.calls()]
    return {
        "seconds": [seconds / question.share for seconds, _ in timed],
        "answers": [question.numbers(answer).tolist() for _, answer in timed],
    }


ROUNDS = 2
"""How often all calls of a question are asked of both packages."""


def answer_in_turn() -> None:
    """Answer questions whose names come by stdin: by the number of calls, then by one line for each empty line."""
    for line in sys.stdin:
        question = QUESTIONS[line.strip()]
        for call in list(question.calls())[:3]:
            call()
        calls = [call for _ in range(ROUNDS) for call in question.calls()]
        print(json.dumps(len(calls)), flush=True)
        for call, _ in zip(calls, sys.stdin, strict=False):
            seconds, answer = clock(call)
            print(json.dumps([seconds / question.share, question.numbers(answer).tolist()]), flush=True)


def beside(checkout: Path, name: str) -> tuple[str, ...]:
    """A question to the package of another checkout and to this one, call by call in turn, as a row."""
    text = QUESTIONS[name].words
    with (
        running(checkout, "benchmarks.core", ["--in-turn"]) as reached,
        running(ROOT, "benchmarks.core", ["--in-turn"]) as current,
    ):
        both = reached, current
        counts = [ask_line(one, name) for one in both]
        if None in counts:
            return (text, "none", "", "", "", "")
        seconds, apart = np.empty((counts[0], 2)), 0.0
        for k in range(counts[0]):
            answers = {j: ask_line(both[j], "") for j in ((0, 1) if k % 2 else (1, 0))}
            seconds[k] = answers[0][0], answers[1][0]
            one, other = (np.array(answers[j][1], dtype=float) for j in (0, 1))
            apart = max(apart, float(np.abs(one - other).max() / np.abs(one).max()))
    ratio = float(np.median(seconds[:, 1] / seconds[:, 0]))
    times = map(milliseconds, np.median(seconds, axis=0).tolist())
    return (text, *times, f"{ratio:.2f}", f"{apart:.0e}", str(counts[0] * QUESTIONS[name].share))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.core", description=__doc__.split("\n")[0])
    parser.add_argument("--only", nargs="+", choices=QUESTIONS, default=list(QUESTIONS), help="questions; default: all")
    parser.add_argument("--json", action="store_true", help="seconds of every call, and answers, as JSON")
    parser.add_argument("--in-turn", action="store_true", help="answer by lines, as the other side of --against")
    parser.add_argument("--against", type=Path, metavar="DIRECTORY", help="another checkout, measured in turn")
    args = parser.parse_args()
    if args.in_turn:
        answer_in_turn()
        return
    if args.against:
        columns = "", "ms there", "ms here", "here / there", "answers apart", "calls of each"
        rows = []
        for name in args.only:
            rows.append(beside(args.against.resolve(), name))
            print("; ".join(rows[-1]), file=sys.stderr)
        show([table("side by side", columns, rows)], [])
        return
    results = {name: ask(QUESTIONS[name]) for name in args.only}
    if args.json:
        dump(results)
        return
    rows = []
    for name, one in results.items():
        timing, question = summarise(one["seconds"]), QUESTIONS[name]
        times = map(milliseconds, (timing.median, timing.fast, timing.slow))
        rows.append((question.words, *times, str(timing.calls * question.share)))
    show([table("processor time per call", ("", "ms", "10 %", "90 %", "calls"), rows)], [])


if __name__ == "__main__":
    main()
