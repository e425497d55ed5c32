"""Tube designs: the closed form, times, full turns without a snap, starts that find the way around the corner.

Run it as `python -m benchmarks.design` from the root of the project; it takes some minutes.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.progress import track
from rich.table import Table

from benchmarks.timing import dump, show, table
from tests.design.tasks import closed_form, equal_pair, tightest
from tests.examples import THESIS
from tubeopt import ConcentricRobot, SolveError, forward_kinematics, optimize_design
from tubeopt.design import DesignSolution, Reach, count_snaps
from tubeopt.design.infeasibility import best_of
from tubeopt.design.optimize import add_worst_cases
from tubeopt.design.program import compile_task
from tubeopt.design.requirements import of_kind
from tubeopt.design.solve import rank, solve, solve_from, start_values
from tubeopt.runs.design_study import DesignStudy
from tubeopt.runs.study_file import load_study

STUDIES = Path(__file__).resolve().parents[1] / "configs" / "studies"

TARGETS = {"design_thesis_snap_free": 10.0, "design_tightest_turn": 60.0, "design_corner": 120.0}
"""Most seconds of each design from one start, checks included."""


@dataclass(frozen=True)
class Row:
    """One claim: what was asked, the number found, the target, whether it is reached."""

    what: str
    found: str
    target: str
    reached: bool


def task_of(name: str) -> DesignStudy:
    """A design study of this project."""
    study = load_study(STUDIES / f"{name}.yaml")
    assert isinstance(study, DesignStudy)
    return study


def closed_forms(count: int) -> Row:
    """Two tubes of equal curvature: largest relative error of the optimum over random (L, l, m)."""
    worst = 0.0
    for overlap, transmission, margin in np.random.default_rng(1).uniform((0.05, 0, 0), (0.3, 0.3, 0.9), (count, 3)):
        program = compile_task(tightest(equal_pair(overlap, transmission), margin))
        result = solve(program, program.layout.space.start).x[0]
        worst = max(worst, abs(result / closed_form(overlap, transmission, margin) - 1))
    return Row(f"two tubes, {count} random (L, l, m): largest relative error", f"{worst:.1e}", "1e-6", worst <= 1e-6)


def timed(name: str) -> tuple[DesignSolution, Row]:
    """A design from one start, with its time."""
    task = task_of(name).task()
    start_time = time.perf_counter()
    design = optimize_design(task)
    seconds = time.perf_counter() - start_time
    return design, Row(f"{name}: seconds", f"{seconds:.1f}", f"{TARGETS[name]:g}", seconds <= TARGETS[name])


def turns(design: DesignSolution, count: int) -> list[Row]:
    """Random full turns of the snap-free robot and of the thesis' own."""
    assert isinstance(THESIS, ConcentricRobot)
    after, before = count_snaps(design.robot, count)[1], count_snaps(THESIS, count)[1]
    return [
        Row(f"snap-free robot: of {count} random full turns snap", str(after), "0", after == 0),
        Row("thesis robot: of the same turns snap", str(before), "some", before > 0),
    ]


def around_the_corner(design: DesignSolution) -> Row:
    """Largest distance of the tip from its target, solved from scratch."""
    (reach,) = of_kind(design.task.requirements, Reach)
    gap = max(
        float(np.linalg.norm(forward_kinematics(design.robot, e.rotations, e.translations).tip_position - t.position))
        for e, t in zip(design.equilibria, reach.targets, strict=True)
    )
    return Row("design_corner: tip off its target, mm", f"{gap * 1e3:.5f}", "0.1", gap <= 1.001e-4)


def random_starts(count: int) -> Row:
    """Random starts of the corner that end feasible, or in a verified report why not."""
    program = compile_task(task_of("design_corner").task())
    good = reported = 0
    for start in track(start_values(program, 7, count + 1)[1:], description="random starts"):
        result = solve_from(program, start)
        try:
            add_worst_cases(best_of(rank([result])))
            good += 1
        except SolveError as error:
            reported += bool(getattr(error, "relaxations", ()))
    text = f"{good} feasible, {reported} with a verified relaxation"
    return Row(f"design_corner: of {count} random starts", text, f"{0.8 * count:g}", good + reported >= 0.8 * count)


def as_table(rows: list[Row]) -> Table:
    """All claims."""
    cells = [(row.what, row.found, row.target, "reached" if row.reached else "MISSED") for row in rows]
    return table("design", ("", "found", "target", ""), cells)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.design", description=__doc__.split("\n")[0])
    parser.add_argument("--turns", type=int, default=500, help="random full turns (default 500)")
    parser.add_argument("--starts", type=int, default=10, help="random starts around the corner (default 10)")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    arguments = parser.parse_args()
    snap_free, first = timed("design_thesis_snap_free")
    _, second = timed("design_tightest_turn")
    corner, third = timed("design_corner")
    rows = [closed_forms(50), first, *turns(snap_free, arguments.turns), second, third, around_the_corner(corner)]
    if arguments.starts:
        rows.append(random_starts(arguments.starts))
    if arguments.json:
        dump({"rows": [row.__dict__ for row in rows]})
    else:
        show([as_table(rows)], [])


if __name__ == "__main__":
    main()
