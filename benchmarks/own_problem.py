"""Own problems: `tubeopt.Problem` and plain `casadi.Opti` with the same blocks, side by side.

    python -m benchmarks.own_problem [--knots 6 9 12] [--json]

A joint path of two tubes, one equilibrium block per knot, moves the tip from one position to another. In the first case
breakpoints stay apart, so that both solve the same program once. In the second case they meet: `Opti` returns the
optimum for the given order of breakpoints, `Problem` swaps them on its way and returns a better optimum. To reach it
with `Opti`, its user swaps the same breakpoints by hand and solves again.

The target compares equal answers: where breakpoints meet it is against `Opti` by hand. In the given order of `Opti`
`Problem` then takes 1.06 to 1.11 times as long, at the same number of iterations: it evaluates gradients in other
orders at three points, and builds a second solver for the start with multipliers. Times are processor times of one
thread for the composition and for all solves, which include the derivatives. All run in turn REPETITIONS times; shown
is the run with the median ratio, since times of single runs differ by a fifth on a shared machine.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from tubeopt import Equilibrium, EquilibriumBlock, Ipopt, Problem, forward_kinematics, load_robot

from .timing import ROOT, clock, dump, milliseconds, show, table

MAX_RATIO = 1.1
"""Largest time of `Problem` over that of `Opti` for the same blocks, start, options and answer."""

REPETITIONS = 5
"""Number of runs of each."""

TOLERANCE = 1e-10
"""Tolerance of IPOPT in both."""

CASES = {"apart": (-0.01, -0.03), "meeting": (0.0, 0.0)}
"""Translations (m) at which the knots start: breakpoints apart, or all transitions at the plate."""


@dataclass(frozen=True)
class Run:
    """One solve: seconds for composition and solve, its effort and result."""

    compose: float
    solve: float
    iterations: int
    solves: int
    gained: float
    objective: float


def knots(count: int, case: str) -> tuple[list[Equilibrium], np.ndarray]:
    """Equilibria at which the knots start, and the target of the tip, m."""
    robot, shift = load_robot(ROOT / "configs" / "robots" / "two_tube.yaml"), np.array(CASES[case])
    first, change = np.array([0.0, 1.0]), np.array([0.3, -0.4])
    starts = [forward_kinematics(robot, first + change * x, shift) for x in np.linspace(0.0, 1.0, count)]
    return starts, forward_kinematics(robot, first + np.array([0.35, -0.3]), shift).tip_position


def cost(rotations: list[Any], translations: list[Any], starts: list[Equilibrium]) -> Any:
    """Length of the path, and distance of the translations from their start."""
    moved = sum(ca.sumsqr(b - a) for a, b in pairwise(rotations))
    return moved + 1e3 * sum(ca.sumsqr(d - e.translations) for d, e in zip(translations, starts, strict=True))


def by_opti(count: int, case: str, *, swapped: bool = False) -> Run:
    """The path by `casadi.Opti`; `swapped`: breakpoints at the last knot are swapped by hand, and it solves again."""
    starts, target = knots(count, case)

    def compose() -> tuple[ca.Opti, Any, EquilibriumBlock[Equilibrium]]:
        opti, rotations, translations, blocks = ca.Opti(), [], [], []
        for start in starts:
            rotations.append(opti.variable(2))
            translations.append(opti.variable(2))
            opti.set_initial(rotations[-1], start.rotations)
            opti.set_initial(translations[-1], start.translations)
            block = EquilibriumBlock(opti, start, rotations=rotations[-1], translations=translations[-1])
            blocks.append(block)
        objective = cost(rotations, translations, starts)
        opti.minimize(objective)
        opti.subject_to(blocks[0].tip_position[:2] == starts[0].tip_position[:2])
        opti.subject_to(blocks[-1].tip_position[:2] == target[:2])
        opti.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes", "tol": TOLERANCE})
        return opti, objective, blocks[-1]

    def solve() -> tuple[Any, int]:
        first = opti.solve()
        if not swapped:
            return first, int(first.stats()["iter_count"])
        opti.set_initial(first.value_variables())
        last.reorder(first)
        second = opti.solve()
        return second, int(first.stats()["iter_count"] + second.stats()["iter_count"])

    composed, (opti, objective, last) = clock(compose)
    seconds, (solution, iterations) = clock(solve)
    return Run(composed, seconds, iterations, 1 + swapped, 0.0, float(solution.value(objective)))


def by_problem(count: int, case: str) -> Run:
    """The path by `tubeopt.Problem`."""
    starts, target = knots(count, case)

    def compose() -> Problem:
        problem, rotations, translations, blocks = Problem("path"), [], [], []
        for k, start in enumerate(starts):
            rotations.append(problem.variable(f"rotations {k}", 2, guess=start.rotations))
            translations.append(problem.variable(f"translations {k}", 2, guess=start.translations))
            block = EquilibriumBlock(problem, start, rotations=rotations[-1], translations=translations[-1])
            blocks.append(block)
        problem.minimize(cost(rotations, translations, starts))
        problem.subject_to("start", blocks[0].tip_position[:2] == starts[0].tip_position[:2])
        problem.subject_to("target", blocks[-1].tip_position[:2] == target[:2])
        return problem

    composed, problem = clock(compose)
    seconds, solution = clock(lambda: problem.solve(Ipopt(tolerance=TOLERANCE)))
    statistics = solution.statistics
    return Run(composed, seconds, statistics.iterations, statistics.solves, statistics.gained, solution.objective)


def measured(count: int, case: str) -> tuple[Run, Run, Run | None]:
    """Runs of `Opti`, of `Problem`, and of `Opti` with a swap by hand where breakpoints meet, of the median ratio."""
    runs = [
        (
            by_opti(count, case),
            by_problem(count, case),
            by_opti(count, case, swapped=True) if case == "meeting" else None,
        )
        for _ in range(REPETITIONS)
    ]
    runs.sort(key=lambda each: each[1].solve / each[0].solve)
    return runs[len(runs) // 2]


def main() -> None:
    """Print both for every case and number of knots."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--knots", type=int, nargs="+", default=[6, 9, 12])
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args()
    # The first blocks write out the functions of their pieces, which all later ones share.
    for case in CASES:
        by_opti(2, case)
        by_problem(2, case)
    runs = {f"{case}, {n} knots": measured(n, case) for case in CASES for n in options.knots}
    ratios = {name: problem.solve / opti.solve for name, (opti, problem, _) in runs.items()}
    if options.json:
        parts = "opti", "problem", "opti_by_hand"
        dump(
            {
                name: {**{k: asdict(v) for k, v in zip(parts, run, strict=True) if v}, "ratio": ratios[name]}
                for name, run in runs.items()
            }
        )
        return
    columns = (
        "case",
        "Opti ms",
        "Problem ms",
        "ratio, given order",
        "iterations",
        "solves",
        "objectives",
        "Opti by hand ms",
        "ratio, same answer",
    )
    rows = [
        (
            name,
            milliseconds(opti.solve),
            milliseconds(problem.solve),
            f"{ratios[name]:.2f}",
            f"{opti.iterations}, {problem.iterations}",
            f"{problem.solves}",
            f"{opti.objective:.5g}, {problem.objective:.5g}",
            milliseconds(by_hand.solve) if by_hand else "-",
            f"{problem.solve / by_hand.solve:.2f}" if by_hand else "-",
        )
        for name, (opti, problem, by_hand) in runs.items()
    ]
    same = {name: problem.solve / (by_hand or opti).solve for name, (opti, problem, by_hand) in runs.items()}
    slow = [name for name, ratio in same.items() if ratio > MAX_RATIO]
    notes = [f"{name}: the ratio at the same answer is {same[name]:.2f}; the target is {MAX_RATIO}" for name in slow]
    show([table("the same blocks", columns, rows)], notes or ["all targets are met"])


if __name__ == "__main__":
    main()
