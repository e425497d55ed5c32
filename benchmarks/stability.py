"""Stability beside brute force: all equilibria, the first snap, the certificate, a stability map.

Run it as `python -m benchmarks.stability` from the root of the project; `--gap 300` also compares the certificate of
random three-tube robots with the worst margin that search finds. The brute force is that of the tests: shots from a
grid of tip angles, slow motion in finite elements, an eigenvalue problem in finite elements.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from functools import partial
from itertools import count

import numpy as np
from rich.progress import track
from rich.table import Table

from benchmarks.timing import Timing, clock, dump, milliseconds, show, summarise, table
from tests.examples import CRL, THESIS
from tests.stability.reference import Creep, all_tips, bundle, settle, worst_by_elements
from tests.stability.robots import random_robot, random_translations
from tubeopt import find_equilibria, find_snap, snap_free_certificate
from tubeopt.robots.robot import Robot
from tubeopt.stability import Certificate, certify, stability_map, worst_margin
from tubeopt.typing import Array

TARGETS = {"all equilibria": 1.0, "first snap": 0.5, "certificate": 2e-3, "stability map": 30.0}
"""Most seconds of each question."""

GRID = 160
"""Tip angles per turn of the brute force for all equilibria."""

STEPS = 200
"""Steps per way of the brute force for snaps, halved at the snap."""

MAP = 60

BRUTE_RAYS = 16
"""Ways of the stability map that brute force goes; the time of the whole map follows by their number."""


@dataclass(frozen=True)
class Measurement:
    """Times of one question on one robot, of the brute force, and how far the answers agree."""

    robot: str
    what: str
    timing: Timing
    brute: Timing
    agreement: str

    @property
    def ratio(self) -> float:
        """How many times as long the brute force takes."""
        return self.brute.median / self.timing.median


def equilibria(robot: Robot, solves: int, random: np.random.Generator) -> Measurement:
    """All equilibria at random rotations, half of them near opposed tubes, where there are several."""
    times, brute, same, several = [], [], 0, 0
    tubes = bundle(robot)
    for k in range(solves + 1):
        rotations = random.uniform(-np.pi, np.pi, 3)
        if k % 2:
            rotations = np.array([np.pi, 0.0, 0.0]) + random.normal(0.0, 0.3, 3)
        seconds, result = clock(partial(find_equilibria, robot, rotations))
        slow, tips = clock(partial(all_tips, tubes, rotations, size=GRID))
        if k:
            times.append(seconds)
            brute.append(slow)
            same += len(tips) == len(result)
            several += len(result) > 1
    text = f"as many in {same} of {solves}, several in {several}"
    return Measurement(robot.name, "all equilibria", summarise(times), summarise(brute), text)


def first_snap(robot: Robot, solves: int, random: np.random.Generator) -> Measurement:
    """The first snap on ways of two turns of the inner tube; on every other one all tubes are withdrawn."""
    times, brute, errors = [], [], []
    low = np.array([-0.02, -0.02, -0.02])
    for k in range(solves + 1):
        start, stop = np.zeros((2, 3)), np.zeros((2, 3))
        stop[0] = [4 * np.pi, *random.uniform(-0.5, 0.5, 2)]
        if k % 2:
            stop[1] = random.uniform(low, 0.0)
        seconds, snap = clock(partial(find_snap, robot, (start[0], start[1]), (stop[0], stop[1])))
        slow, fraction = clock(partial(_snap_by_creeping, robot, start, stop))
        if k:
            times.append(seconds)
            brute.append(slow)
            assert (snap is None) == np.isnan(fraction)
            errors.append(0.0 if snap is None else abs(snap.fraction - fraction))
    text = f"fractions to {max(errors):.0e}"
    return Measurement(robot.name, "first snap", summarise(times), summarise(brute), text)


def _snap_by_creeping(robot: Robot, start: Array, stop: Array) -> float:
    slow = Creep(robot, start, stop, settle(robot, start[0], start[1]))
    for k in range(1, STEPS + 1):
        slow.to(k / STEPS)
        if slow.snaps:
            return slow.snaps[0]
    return float("nan")


def certificates(robot: Robot, solves: int, random: np.random.Generator) -> list[Measurement]:
    """The certificate, and with gradient, at translations that were not used before."""
    out = []
    low = np.array([-0.05, -0.05, -0.05])
    calls: tuple[tuple[str, Callable[[Robot, Array], float | Certificate]], ...] = (
        ("certificate", snap_free_certificate),
        ("certificate with gradient", certify),
    )
    for what, call in calls:
        times, brute, errors = [], [], []
        for _ in range(10):
            # Each order of breakpoints is built once.
            call(robot, random.uniform(low, 0.0))
        for _ in range(solves):
            shift = random.uniform(low, 0.0)
            seconds, answer = clock(partial(call, robot, shift))
            slow, expected = clock(partial(_certificate_by_elements, robot, shift))
            times.append(seconds)
            brute.append(slow)
            errors.append(abs((answer if isinstance(answer, float) else answer.margin) - expected))
        text = f"to {max(errors):.0e}"
        out.append(Measurement(robot.name, what, summarise(times), summarise(brute), text))
    return out


def _certificate_by_elements(robot: Robot, shift: Array) -> float:
    return worst_by_elements(bundle(robot, shift))


def whole_map(robot: Robot, random: np.random.Generator) -> Measurement:
    """A stability map on two processes, with its snap boundary."""
    seconds, chart = clock(lambda: stability_map(robot, samples=MAP, workers=2))
    brute, same = [], 0
    for _ in range(BRUTE_RAYS):
        i, j = random.integers(0, MAP, 2)
        stop = np.array([[chart.angles[i], chart.angles[j], 0.0], [0.0, 0.0, 0.0]])
        slow, (margin, snaps) = clock(partial(_creep_from_home, robot, stop))
        brute.append(slow * MAP**2 / 2)
        same += snaps == chart.snaps[i, j] and abs(min(1.0, margin) - chart.margin[i, j]) < 1e-4
    text = f"same margin and snaps on {same} of {BRUTE_RAYS} ways; brute force for two processes, from these"
    return Measurement(robot.name, "stability map", summarise([seconds]), summarise(brute), text)


def _creep_from_home(robot: Robot, stop: Array) -> tuple[float, int]:
    """Margin at the end, and snaps on the way."""
    slow = Creep(robot, np.zeros((2, 3)), stop, settle(robot, np.zeros(3), np.zeros(3)))
    for k in range(1, STEPS // 4 + 1):
        slow.to(4 * k / STEPS)
    state = slow.state
    return float(state.elements.margins(state.rotations, state.theta)[0]), len(slow.snaps)


def gap(robots: int) -> dict[str, float]:
    """Certificate and worst margin found of random three-tube robots; gaps are fractions of 1 - certificate."""
    gaps: list[float] = []
    violations = 0
    for seed in track(count(), total=robots, description="worst margins"):
        if len(gaps) == robots:
            break
        random = np.random.default_rng([300, seed])
        robot = random_robot(random, 3, bend=random.uniform(0.3, 2.0))
        shift = random_translations(random, robot)
        proved = snap_free_certificate(robot, shift)
        coupled = bundle(robot, shift).coupled
        if len(coupled) < 3:
            # Two tubes are exact, see the tests.
            continue
        result = worst_margin(robot, shift).margin
        violations += proved > result + 1e-9
        gaps.append((result - proved) / (1 - proved))
    middle, ninth, largest = np.quantile(gaps, [0.5, 0.9, 1.0])
    return {
        "robots": robots,
        "violations": violations,
        "median_gap": float(middle),
        "ninth_decile": float(ninth),
        "largest": float(largest),
    }


def verdicts(rows: Iterable[Measurement]) -> list[str]:
    """Every target beside what was measured."""
    out = []
    for row in rows:
        if row.what in TARGETS:
            limit = TARGETS[row.what]
            verdict = "reached" if row.timing.median <= limit else "MISSED"
            times = f"{milliseconds(row.timing.median)} ms, target {milliseconds(limit)} ms"
            out.append(f"{row.robot}: {row.what}: {times}: {verdict}")
    return out


def as_table(rows: Iterable[Measurement]) -> Table:
    """Times of all questions."""
    cells = [
        (
            f"{row.robot}: {row.what}",
            milliseconds(row.timing.median),
            f"{milliseconds(row.timing.fast)}–{milliseconds(row.timing.slow)}",
            str(row.timing.calls),
            milliseconds(row.brute.median),
            f"{row.ratio:.3g}",
            row.agreement,
        )
        for row in rows
    ]
    head = ("", "ms", "10–90 %", "calls", "brute force, ms", "×", "agreement")
    return table("stability", head, cells)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.stability", description=__doc__.split("\n")[0])
    parser.add_argument("--solves", type=int, default=20, help="calls per row (default 20)")
    parser.add_argument("--gap", type=int, default=0, metavar="ROBOTS", help="certificate gap of so many random robots")
    parser.add_argument("--json", action="store_true", help="print JSON instead of tables")
    arguments = parser.parse_args()
    rows: list[Measurement] = []
    for robot in (THESIS, CRL):
        random = np.random.default_rng(1)
        rows.append(equilibria(robot, arguments.solves, random))
        rows.append(first_snap(robot, arguments.solves, random))
        rows.extend(certificates(robot, 10 * arguments.solves, random))
        rows.append(whole_map(robot, random))
    gaps = gap(arguments.gap) if arguments.gap else None
    if arguments.json:
        dump({"rows": [{**asdict(row), "ratio": row.ratio} for row in rows], "gap": gaps})
        return
    notes = verdicts(rows)
    if gaps is not None:
        notes.append(
            f"{gaps['robots']} random robots of three tubes: {gaps['violations']} certificates above the worst margin "
            f"found; gap as a part of 1 - certificate: median {gaps['median_gap']:.2g}, ninth decile "
            f"{gaps['ninth_decile']:.2g}, largest {gaps['largest']:.2g}"
        )
    show([as_table(rows)], notes)


if __name__ == "__main__":
    main()
