"""Time and accuracy of forward kinematics, beside SciPy's `solve_bvp` on the same configurations in the same run.

    python -m benchmarks.forward_kinematics [--robot FILE ...] [--solves N] [--bvp N] [--json]

Cold: random configurations, from tubes without torsion; new translations each time, so that sections, mesh and
compliance are laid out anew, but with compiled functions of the same structure from an untimed first round.
Warm: a path on which all joints move by up to half a degree and 0.1 mm per step, each step from the one before; or the
same with the translations held, so that the layout stays.
All include shape, margin, energy and error estimates. Jacobians are of the cold ones. First use: building the
functions of a robot, in a new process, imports excluded. `solve_bvp` gets the Jacobians in closed form or not, starts
cold from tubes without torsion and warm from the mesh and values of the step before, and its time includes the shape,
but no margin and no error estimate. Times are processor times on one thread. The error of the tip is the distance to
shooting with DOP853 at 3e-14; solves that ended in another equilibrium, or in none, are counted as astray.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tubeopt import ConcentricRobot, Equilibrium, forward_kinematics, load_robot
from tubeopt.equilibrium.directions import PARAMETERS

from . import bvp
from .joints import APART, path_joints, random_joints
from .shooting import Array, shoot
from .timing import ROOT, Timing, clock, dump, fresh_process, milliseconds, show, summarise, table

ROBOTS = tuple(ROOT / "configs" / "robots" / f"{name}.yaml" for name in ("thesis_ctr", "crl_ctr"))

BVP_TOLERANCES = (1e-6, 1e-9, 1e-10)
"""A usual choice; one at which the tip is still less accurate than Newton's on the default mesh; one at which both are
about equal."""

ASTRAY = 1e-5
"""A tip this far (m) from the reference belongs to another equilibrium."""

FIRST_USE = """
import time
from tubeopt import forward_kinematics, load_robot
robot = load_robot({path!r})
began = time.process_time()
forward_kinematics(robot, (0.0, 0.3, -0.2)[: robot.n_tubes], method={method!r})
print(time.process_time() - began)
"""

TARGETS = {
    "newton warm": (0.4e-3, "Newton warm, with shape and margin"),
    "newton cold": (1e-3, "Newton cold"),
    "ipopt cold": (8e-3, "IPOPT cold"),
    "ipopt warm": (8e-3, "IPOPT warm"),
    "newton first use": (1.5, "first use of a robot"),
    "jacobian": (0.5e-3, "Jacobian by joint values, with margin and energy"),
    "jacobian, all dimensions": (1e-3, "Jacobian by joint values and all dimensions"),
}

RATIO = 200
"""Times as long as Newton that `solve_bvp` should take at the accuracy of Newton or worse."""


@dataclass(frozen=True)
class Measurement:
    """One row: what was solved and how, time per solve, error of the tip (median and largest, m), solves astray."""

    robot: str
    what: str
    timing: Timing
    error: float | None = None
    worst: float | None = None
    astray: int = 0


def solve_cold(
    robot: ConcentricRobot, joints: Iterable[tuple[Array, Array]], **options: Any
) -> list[tuple[float, Any]]:
    """Seconds and equilibrium of each configuration by itself."""
    return [clock(lambda a=a, d=d: forward_kinematics(robot, a, d, **options)) for a, d in joints]


def solve_warm(robot: ConcentricRobot, joints: list[tuple[Array, Array]], **options: Any) -> list[tuple[float, Any]]:
    """Seconds and equilibrium of each step from the one before."""
    last: Equilibrium = forward_kinematics(robot, *joints[0])
    out = []
    for a, d in joints[1:]:
        seconds, last = clock(lambda a=a, d=d, last=last: forward_kinematics(robot, a, d, start=last, **options))
        out.append((seconds, last))
    return out


def solve_bvp(
    robot: ConcentricRobot, joints: list[tuple[Array, Array]], tolerance: float, *, jacobians: bool, warm: bool
) -> list[tuple[float, Any]]:
    """Seconds and solution (None where it fails) of each configuration by `solve_bvp`, the laying out included."""
    guess = None
    out = []
    for a, d in joints:

        def run(a: Array = a, d: Array = d, guess: bvp.Guess | None = guess) -> bvp.BvpSolution | None:
            problem = bvp.pose(robot, a, d)
            # The order of breakpoints may change on the way, and with it the states: then the guess does not fit.
            start = guess if guess is not None and len(guess.y) == problem.size else bvp.untwisted(problem)
            try:
                return bvp.solve(problem, start, tolerance, jacobians=jacobians)
            except (RuntimeError, MemoryError):  # no solution, or a mesh too large for its matrices
                return None

        seconds, solution = clock(run)
        guess = solution.guess if warm and solution is not None else None
        out.append((seconds, solution))
    return out[1:] if warm else out


def reference_tips(robot: ConcentricRobot, solved: Iterable[Equilibrium]) -> list[Array]:
    """Tips by shooting, on the branch of each equilibrium."""
    return [shoot(robot, e.rotations, e.translations, e.torsion[:, 0]).tip_position for e in solved]


def measure(robot: ConcentricRobot, path: Path, solves: int, bvps: int) -> list[Measurement]:
    """All rows of one robot."""
    out = []
    cold = random_joints(robot, solves)
    fresh = [(a, d + APART) for a, d in cold]
    steps, again = path_joints(robot, solves + 1), path_joints(robot, solves + 1, APART)
    held = path_joints(robot, solves + 1, translate=False)
    tips = reference_tips(robot, (forward_kinematics(robot, a, d) for a, d in fresh[:bvps]))
    walked = reference_tips(robot, (e for _, e in solve_warm(robot, again[: bvps + 1])))
    for method in ("newton", "ipopt"):
        few = solves if method == "newton" else max(2, solves // 8)
        solve_cold(robot, cold[:few], method=method)
        out.append(_row(robot, f"{method} cold", solve_cold(robot, fresh[:few], method=method), tips))
        solve_warm(robot, steps[: few + 1], method=method)
        out.append(_row(robot, f"{method} warm", solve_warm(robot, again[: few + 1], method=method), walked))
        solve_warm(robot, held[: few + 1], method=method)
        runs = solve_warm(robot, held[: few + 1], method=method)
        out.append(_row(robot, f"{method} warm, translations held", runs, []))
        script = FIRST_USE.format(path=str(path), method=method)
        out.append(Measurement(robot.name, f"{method} first use", fresh_process(script, 5)))
    out += slopes(robot, [e for _, e in solve_cold(robot, fresh)])
    for tolerance in BVP_TOLERANCES:
        for jacobians in (True, False):
            name = f"solve_bvp {{}}, tol {tolerance:g}{', with Jacobians' if jacobians else ''}"
            runs = solve_bvp(robot, fresh[:bvps], tolerance, jacobians=jacobians, warm=False)
            out.append(_row(robot, name.format("cold"), runs, tips))
            runs = solve_bvp(robot, again[: bvps + 1], tolerance, jacobians=jacobians, warm=True)
            out.append(_row(robot, name.format("warm"), runs, walked))
    return out


def slopes(robot: ConcentricRobot, solved: list[Equilibrium]) -> list[Measurement]:
    """Derivatives of tip pose, tips of the tubes, margin and energy of each equilibrium, after an untimed one."""
    out = []
    for what, wrt in (("jacobian", PARAMETERS[:2]), ("jacobian, all dimensions", PARAMETERS)):
        solved[0].jacobian(wrt=wrt)
        timing = summarise(clock(lambda e=e, wrt=wrt: e.jacobian(wrt=wrt))[0] for e in solved)
        out.append(Measurement(robot.name, what, timing))
    return out


def _row(robot: ConcentricRobot, what: str, runs: list[tuple[float, Any]], tips: list[Array]) -> Measurement:
    timing = summarise(seconds for seconds, _ in runs)
    results = [
        np.inf if one is None else float(np.linalg.norm(one.tip_position - tip))
        for (_, one), tip in zip(runs, tips, strict=False)
    ]
    errors = [error for error in results if error < ASTRAY]
    if not errors:
        return Measurement(robot.name, what, timing, astray=len(results))
    return Measurement(
        robot.name, what, timing, float(np.median(errors)), float(np.max(errors)), len(results) - len(errors)
    )


def ratios(rows: list[Measurement]) -> dict[str, float]:
    """How many times as long as Newton every other row took, cold beside cold and warm beside warm."""
    newton = {start: row.timing.median for row in rows for start in ("cold", "warm") if row.what == f"newton {start}"}
    return {
        row.what: row.timing.median / seconds for row in rows for start, seconds in newton.items() if start in row.what
    }


def verdicts(rows: list[Measurement]) -> list[str]:
    """Every target beside what was measured."""
    out = []
    for row in rows:
        if row.what in TARGETS:
            limit, text = TARGETS[row.what]
            verdict = "reached" if row.timing.median <= limit else "MISSED"
            times = f"{milliseconds(row.timing.median)} ms, target {milliseconds(limit)} ms"
            out.append(f"{row.robot}: {text}: {times}: {verdict}")
    for name, ratio in ratios(rows).items():
        if name.startswith("solve_bvp") and f"tol {BVP_TOLERANCES[-1]:g}" in name:
            verdict = "reached" if ratio >= RATIO else "MISSED"
            out.append(f"{rows[0].robot}: {name}: {ratio:.0f} times Newton, target {RATIO}: {verdict}")
    return out


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.forward_kinematics", description=__doc__.split("\n")[0])
    parser.add_argument("--robot", type=Path, action="append", help="robot file; default: thesis CTR and CRL CTR")
    parser.add_argument("--solves", type=int, default=400, help="solves per row (default 400)")
    parser.add_argument("--bvp", type=int, default=20, help="solves by solve_bvp per row (default 20)")
    parser.add_argument("--json", action="store_true", help="print JSON instead of tables")
    arguments = parser.parse_args()
    measured: dict[str, list[Measurement]] = {}
    for path in arguments.robot or ROBOTS:
        robot = load_robot(path)
        if not isinstance(robot, ConcentricRobot):
            parser.error(f"{path} is not a concentric robot; the reference and solve_bvp are written for those")
        measured[robot.name] = measure(robot, path, arguments.solves, arguments.bvp)
    if arguments.json:
        rows = [
            asdict(row) | {"ratio": ratios(all_rows).get(row.what)}
            for all_rows in measured.values()
            for row in all_rows
        ]
        dump({"rows": rows})
        return
    tables = []
    for name, rows in measured.items():
        ratio = ratios(rows)
        cells = [
            (
                row.what,
                milliseconds(row.timing.median),
                f"{milliseconds(row.timing.fast)}–{milliseconds(row.timing.slow)}",
                str(row.timing.calls),
                "" if row.error is None else f"{row.error:.1e}",
                "" if row.worst is None else f"{row.worst:.1e}",
                str(row.astray) if row.astray else "",
                f"{ratio[row.what]:.3g}" if row.what in ratio else "",
            )
            for row in rows
        ]
        head = ("", "ms", "10–90 %", "solves", "tip error, m", "largest", "astray", "× Newton")
        tables.append(table(name, head, cells))
    show(tables, [line for rows in measured.values() for line in verdicts(rows)])


if __name__ == "__main__":
    main()
