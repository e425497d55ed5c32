"""Scores the answers of a solver, whatever it is, by a model of its own.

Answers are lines of JSON, in any order, one per question; what is missing has failed:

    {"id": "inverse 1", "seconds": 0.02, "rotations_deg": [...], "translations_mm": [...], "tip_rotations_deg": [...]}
    {"id": "plan 1", "seconds": 0.6, "rotations_deg": [[...], ...], "translations_mm": [[...], ...]}
    {"id": "design 1", "seconds": 8.0, "curvature_per_m": [...], "poses": [{...}, ...]}

Rotations are those of the held ends, 0 with the tube curved towards -y; translations are from home, where a tube begins
to curve at the plate; tip rotations, those of the tubes at their own ends, tell which equilibrium is meant. A plan goes
straight from row to row. `seconds` are of one processor. docs/benchmark.md says what every question asks.

Usage: python -m benchmarks.suite.score ANSWERS.jsonl [--kinds inverse plan design] [--out SCORES.json]
"""

from __future__ import annotations

import argparse
import json
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from .model import Array, Robot, follow, integrate, margins, turned
from .questions import CLEARANCE, KINDS, MARGIN, MM, Scene, questions, robots, scenes, withdrawn

AT_TIP, POINTED, SAME, TURNED = 0.1 * MM, np.radians(1.0), 1e-4, np.radians(0.1)
"""How far a tip may be from its place (m) and from its direction (rad); how well tip rotations tell the joint rotations
(rad), and how well a plan starts and ends (rad; m are a hundredth of that)."""

LOOSE_MARGIN, LOOSE_CLEARANCE = 1e-3, 0.02 * MM
"""What may lack of margin and clearance, for the steps of the judge."""

LOOKED_AT = 24
"""States of a motion of which the margin is told; at all of them it is seen whether they are stable."""

SPREAD = 2000
"""Random tip rotations at which a design that cannot snap is looked at."""


@dataclass(frozen=True)
class Score:
    """What became of one question.   why: what is not kept, "" of a success.   margin, clearance (mm; NaN without
    walls): the least.   snaps: of a motion, or states of a design that cannot snap which are not stable enough.
    objective: of a design; less is better."""

    id: str
    robot: str
    scene: str
    seconds: float
    why: str
    margin: float = np.nan
    clearance: float = np.nan
    snaps: int = 0
    objective: float = np.nan

    @property
    def success(self) -> bool:
        """Whether all that was asked is kept."""
        return not self.why


Answers = dict[str, dict[str, Any]]


def read_answers(path: Path) -> Answers:
    """Answers by the question's name; of several the last."""
    lines = path.read_text(encoding="utf-8").splitlines()
    return {one["id"]: one for one in map(json.loads, filter(str.strip, lines))}


def _first(faults: Iterable[tuple[bool, str]]) -> str:
    return next((text for broken, text in faults if broken), "")


def _table(one: dict[str, Any], key: str, factor: float, n: int) -> Array:
    """(T, n) of an answer; a ValueError where it is none."""
    table = np.atleast_2d(np.array(one[key], dtype=float)) * factor
    if table.ndim != 2 or table.shape[1] != n or not len(table) or not np.isfinite(table).all():
        raise ValueError(f"{key} must be finite numbers, {n} in a row")
    return table


def _failed(question: dict[str, Any], answer: dict[str, Any] | None, why: str) -> Score:
    report = None if answer is None else answer.get("seconds")
    seconds = float(report) if isinstance(report, int | float) else np.nan
    return Score(question["id"], question["robot"], question["scene"], seconds, why)


@dataclass(frozen=True, eq=False)
class Pose:
    """An arm that was looked at: its margin and least clearance (m), tip (3,), direction (3,), and what is wrong with
    it whatever was asked."""

    margin: float
    clearance: float
    tip: Array
    direction: Array
    why: str


Given = tuple[Array, Array, Array]
"""Rotations, tip rotations and held places (n,) of an answer."""


def arm_of(robot: Robot, answer: dict[str, Any]) -> Given:
    """The joint values and tip rotations of an answer, SI; a ValueError where they are none."""
    turned, z = (_table(answer, f"{key}_deg", np.pi / 180, robot.n)[0] for key in ("rotations", "tip_rotations"))
    return turned, z, _table(answer, "translations_mm", MM, robot.n)[0] - robot.straight_length


def look(robot: Robot, arms: Sequence[tuple[Scene, Given]], least: float = MARGIN) -> list[Pose]:
    """Arms of one robot, each in its scene, as answers give them."""
    if not arms:
        return []
    turned, z, beta = (np.array([inputs[k] for _, inputs in arms]) for k in range(3))
    result, margin, order = integrate(robot, z, beta), margins(robot, z, beta), robot.order(beta)
    off = np.abs(result.rotations - turned).max(axis=1)
    out = []
    for k, (scene, _) in enumerate(arms):
        room = float((scene.depth(result.points[k]) - result.radius[k]).min())
        why = _first(
            (
                (off[k] > SAME, "tip rotations that are not of these joint values"),
                (order[k] < -1e-6, "tubes out of order"),
                (margin[k] < least - LOOSE_MARGIN, "margin"),
                (room < CLEARANCE - LOOSE_CLEARANCE, "clearance"),
            )
        )
        out.append(Pose(float(margin[k]), room, result.tip[k], result.direction[k], why))
    return out


def _mm(room: float) -> float:
    return float(room / MM) if np.isfinite(room) else np.nan


def inverse(robot: Robot, asked: Sequence[dict[str, Any]], answers: Answers) -> list[Score]:
    """Answers of inverse kinematics of one robot."""
    out, arms, retained = [], [], []
    for question in asked:
        try:
            arms.append((scenes()[question["scene"]], arm_of(robot, answers[question["id"]])))
            retained.append(question)
        except (KeyError, TypeError, ValueError) as error:
            out.append(_failed(question, answers[question["id"]], f"no pose: {error}"))
    for question, pose in zip(retained, look(robot, arms), strict=True):
        off = np.linalg.norm(pose.tip - np.array(question["tip_mm"]) * MM)
        heading = np.array(question.get("direction", pose.direction))
        angle = np.arccos(np.clip(pose.direction @ heading / np.linalg.norm(heading), -1, 1))
        why = _first(((off > AT_TIP, "place of the tip"), (angle > POINTED, "direction of the tip"))) or pose.why
        plain = _failed(question, answers[question["id"]], why)
        out.append(replace(plain, margin=pose.margin, clearance=_mm(pose.clearance)))
    return out


def _way(robot: Robot, answer: dict[str, Any]) -> Array:
    """(T, 2 n) rotations and held places of a plan."""
    turns = _table(answer, "rotations_deg", np.pi / 180, robot.n)
    shifts = _table(answer, "translations_mm", MM, robot.n)
    if len(turns) != len(shifts):
        raise ValueError("rotations_deg and translations_mm must have as many rows")
    return np.concatenate([turns, shifts - robot.straight_length], axis=1)


def plans(robot: Robot, asked: Sequence[dict[str, Any]], answers: Answers) -> list[Score]:
    """Answers to plans of one robot, followed beside each other."""
    out, paths, retained = [], [], []
    start = np.concatenate([np.zeros(robot.n), withdrawn(robot)])
    for question in asked:
        try:
            path = _way(robot, answers[question["id"]])
        except (KeyError, TypeError, ValueError) as error:
            out.append(_failed(question, answers[question["id"]], f"no way: {error}"))
            continue
        off = np.abs(path[0] - start) / np.repeat([TURNED, TURNED / 100], robot.n)
        if off.max() > 1:
            out.append(_failed(question, answers[question["id"]], "start"))
            continue
        paths.append(np.vstack([start, path]))
        retained.append(question)
    followed = follow(robot, paths, np.zeros((len(paths), robot.n))) if paths else []
    for question, each, path in zip(retained, followed, paths, strict=True):
        out.append(_judged(robot, question, answers[question["id"]], (each.z, each.joints, each.share), path))
    return out


def _judged(
    robot: Robot, question: dict[str, Any], answer: dict[str, Any], followed: tuple[Array, Array, float], way: Array
) -> Score:
    z, joints, fraction = followed
    n, scene = robot.n, scenes()[question["scene"]]
    result = integrate(robot, z, joints[:, n:])
    room = float((scene.depth(result.points) - result.radius).min())
    some = np.unique(np.linspace(0, len(z) - 1, LOOKED_AT).astype(int))
    smallest = float(margins(robot, z[some], joints[some, n:]).min()) if fraction == 1 else 0.0
    if "tip_mm" in question:
        off = np.linalg.norm(result.tip[-1] - np.array(question["tip_mm"]) * MM) / AT_TIP
    else:
        turns = np.abs(way[-1, :n] - np.radians(question["rotations_deg"])).max() / TURNED
        shifts = way[-1, n:] + robot.straight_length - np.array(question["translations_mm"]) * MM
        off = max(turns, np.abs(shifts).max() / (TURNED / 100))
    why = _first(
        (
            (fraction < 1, "a snap"),
            (off > 1, "goal"),
            (robot.order(way[:, n:]).min() < -1e-6, "tubes out of order"),
            (smallest < MARGIN - LOOSE_MARGIN, "margin"),
            (room < CLEARANCE - LOOSE_CLEARANCE, "clearance"),
        )
    )
    return replace(_failed(question, answer, why), margin=smallest, clearance=_mm(room), snaps=int(fraction < 1))


def designs(before: Robot, asked: Sequence[dict[str, Any]], answers: Answers) -> list[Score]:
    """Designs that begin from one robot."""
    out = []
    for question in asked:
        try:
            out.append(_designed(question, answers[question["id"]], before))
        except (KeyError, TypeError, ValueError) as error:
            out.append(_failed(question, answers[question["id"]], f"no design: {error}"))
    return out


def _designed(question: dict[str, Any], answer: dict[str, Any], before: Robot) -> Score:
    bend = _table(answer, "curvature_per_m", 1.0, before.n)[0]
    robot = replace(before, curvature=bend)
    low, high = (1 + np.array([-1e-6, 1e-6])) * np.array(question["curvature_factors"])
    if (bend < low * before.curvature).any() or (bend > high * before.curvature).any():
        return _failed(question, answer, "curvatures out of their range")
    judge = _turning if question["kind"] == "snap_free" else _reaching
    return judge(question, answer, robot, before)


def _reaching(question: dict[str, Any], answer: dict[str, Any], robot: Robot, before: Robot) -> Score:
    """Places for the tip, with the least change of the curvatures."""
    change = float((((robot.curvature - before.curvature) / before.curvature) ** 2).sum())
    scene, tips = scenes()[question["scene"]], np.array(question["tips_mm"]) * MM
    if len(answer["poses"]) != len(tips):
        raise ValueError(f"poses must be {len(tips)}")
    poses = look(robot, [(scene, arm_of(robot, one)) for one in answer["poses"]], question["margin"])
    off = max(float(np.linalg.norm(pose.tip - tip)) for pose, tip in zip(poses, tips, strict=True))
    far = off > question["tolerance_mm"] * MM * 1.01
    why = _first(((far, "place of a tip"), *((bool(pose.why), pose.why) for pose in poses)))
    smallest, room = min(pose.margin for pose in poses), min(pose.clearance for pose in poses)
    return replace(_failed(question, answer, why), margin=smallest, clearance=_mm(room), objective=change)


def _turning(question: dict[str, Any], answer: dict[str, Any], robot: Robot, before: Robot) -> Score:
    """The radius of the turn (m) at the tip of tubes that cannot snap, whatever their tip rotations are."""
    beta = np.array(question["translations_mm"]) * MM - robot.straight_length
    ends = beta + robot.length
    reached = (ends >= ends.max() - 1e-9) & (robot.curved_length > 0)
    stiff = robot.bending_stiffness[reached]
    curvature = float((stiff * robot.curvature[reached]).sum() / stiff.sum())
    z = np.random.default_rng(1).uniform(-np.pi, np.pi, (SPREAD, robot.n))
    rows = np.broadcast_to(beta, z.shape)
    requested = question["margin"] - LOOSE_MARGIN
    bad = int((~turned(robot, z, rows, 1 / (1 - requested)).stable).sum())
    strain = float((robot.outer_diameter * robot.curvature / 2).max())
    broken = strain > question["strain_percent"] / 100 * (1 + 1e-6)
    why = _first(((broken, "strain"), (bad > 0, "a rotation with too small a margin")))
    smallest = float(margins(robot, z[:100], rows[:100]).min())
    return replace(_failed(question, answer, why), margin=smallest, snaps=bad, objective=1 / curvature)


JUDGES = {"inverse": inverse, "plan": plans, "design": designs}


def score(answers: Answers, kinds: Sequence[str] = KINDS) -> list[Score]:
    """The scores of all questions of some kinds."""
    out: list[Score] = []
    for kind in kinds:
        answered: dict[str, list[dict[str, Any]]] = defaultdict(list)
        for question in questions(kind):
            answer = answers.get(question["id"])
            if answer is None or "failed" in answer:
                why = "no answer" if answer is None else str(answer["failed"])
                out.append(_failed(question, answer, why))
            else:
                answered[question["robot"]].append(question)
        for name, requested in answered.items():
            out += JUDGES[kind](robots()[name], requested, answers)
    return out


def group_of(one: Score) -> tuple[str, str]:
    """Under which kind of question and scene a score is told."""
    kind = one.id.split()[0]
    scene = "corridors" if one.scene.startswith("corridor") else one.scene.rstrip(" 0123456789")
    return kind, "cannot snap" if one.id in _turns() else scene


@cache
def _turns() -> frozenset[str]:
    return frozenset(one["id"] for one in questions("design") if one["kind"] == "snap_free")


def _quantile(values: Array, share: float) -> float:
    return float(np.quantile(values, share)) if len(values) else np.nan


def table(scores: Sequence[Score]) -> str:
    """Markdown, a row per kind of question and scene, of those that were answered at all."""
    groups: dict[tuple[str, str], list[Score]] = defaultdict(list)
    for one in scores:
        groups[group_of(one)].append(one)
    rows = [
        "| | | asked | kept | seconds, median | nine of ten | least margin | least clearance (mm) | snaps |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for (kind, scene), some in groups.items():
        answered = [one for one in some if one.why != "no answer"]
        good = [one for one in answered if one.success]
        times = np.array([one.seconds for one in answered if np.isfinite(one.seconds)])
        margin = min((one.margin for one in good), default=np.nan)
        room = min((one.clearance for one in good), default=np.nan)
        rows.append(
            f"| {kind} | {scene} | {len(answered)} of {len(some)} | {len(good)} | {_quantile(times, 0.5):.3g} | "
            f"{_quantile(times, 0.9):.3g} | {margin:.3f} | {'' if np.isnan(room) else f'{room:.2f}'} | "
            f"{sum(one.snaps > 0 for one in answered)} |"
        )
    return "\n".join(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("answers", type=Path)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--out", type=Path, default=None, help="file for the score of every question")
    args = parser.parse_args()
    scores = score(read_answers(args.answers), args.kinds)
    print(table(scores))
    for one in scores:
        if one.why not in ("", "no answer"):
            print(f"  {one.id} ({one.robot}, {one.scene}): {one.why}")
    if args.out is not None:
        answered = (asdict(one) for one in scores if one.why != "no answer")
        rows = [json.dumps({key: None if value != value else value for key, value in row.items()}) for row in answered]
        args.out.write_text("[\n" + ",\n".join(rows) + "\n]\n", encoding="utf-8")


if __name__ == "__main__":
    main()
