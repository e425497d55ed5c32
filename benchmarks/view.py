"""From a slider to a new shape: what the viewer's server does between the two, without the browser.

Run it as `python -m benchmarks.view` from the root of the project. Counted is everything from the wish for another
joint value to coordinates that could be sent: the motion on its branch, the surfaces, the plots and the words. The slow
things that wait until the hand rests (S-curve, certificate) are told apart.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial

import numpy as np

from benchmarks.timing import Timing, clock, dump, milliseconds, show, summarise, table
from tests.examples import CONFIGS, CRL, THESIS
from tubeopt import load_robot, snap_free_certificate, trace_branch
from tubeopt.robots.robot import Robot
from tubeopt.show.surfaces import robot_parts
from tubeopt.show.viewer.insights import torsion_plot
from tubeopt.show.viewer.page_text import log_text, readout
from tubeopt.show.viewer.session import Session, move_joint, open_session
from tubeopt.show.viewer.teleoperation import drag_tip

LIMIT = 50e-3
"""Most seconds from a slider to a new shape, for the robot of the thesis."""


@dataclass(frozen=True)
class Measurement:
    """Times of one thing on one robot."""

    robot: str
    what: str
    timing: Timing


def drawn(session: Session) -> int:
    """Everything that a motion changes on the page, in the form in which it is sent; returns its size in bytes."""
    size = sum(part.surface.vertices.astype(np.float32).nbytes for part in robot_parts(session.equilibrium))
    text = readout(session, 0.0) + log_text(session.log) + torsion_plot(session.equilibrium)
    return size + len(text.encode())


def slide(session: Session, degrees: float) -> Session:
    """One event of a slider, to what is sent."""
    moved, _ = move_joint(session, 0, np.radians(degrees))
    drawn(moved)
    return moved


def sweeps(robot: Robot, step: float, moves: int) -> list[Measurement]:
    """A slider pulled back and forth; motions with a snap are told apart."""
    session = slide(open_session(robot), step)
    smooth, snapping = [], []
    angle, direction = step, step
    for _ in range(moves):
        if abs(angle + direction) > 300:
            direction = -direction
        angle += direction
        seconds, session = clock(partial(slide, session, angle))
        (snapping if session.last else smooth).append(seconds)
    out = [Measurement(robot.name, f"slider by {step:g} deg to new shape", summarise(smooth))]
    if snapping:
        out.append(Measurement(robot.name, "the same with a snap", summarise(snapping)))
    return out


def parts(robot: Robot, repeats: int) -> list[Measurement]:
    """What a new shape is made of, and what waits until the hand rests."""
    session = slide(open_session(robot), 100.0)
    current = session.equilibrium
    low, high = np.zeros(robot.n_tubes), np.zeros(robot.n_tubes)
    low[0], high[0] = -2 * np.pi, 2 * np.pi
    calls: list[tuple[str, Callable[[], object]]] = [
        ("surfaces", partial(robot_parts, current)),
        ("plot of torsion", partial(torsion_plot, current)),
        ("tip led by 2 mm", partial(drag_tip, session, current.tip_position + np.array([2e-3, 0.0, 0.0]))),
        ("certificate", partial(snap_free_certificate, robot, current.translations)),
        ("S-curve", partial(trace_branch, robot, low, high, current.translations)),
    ]
    out = []
    for what, call in calls:
        call()
        times = [clock(call)[0] for _ in range(repeats)]
        out.append(Measurement(robot.name, what, summarise(times)))
    return out


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.view", description=__doc__.split("\n")[0])
    parser.add_argument("--moves", type=int, default=200, help="events of the slider per row (default 200)")
    parser.add_argument("--json", action="store_true", help="print JSON instead of tables")
    arguments = parser.parse_args()
    rows: list[Measurement] = []
    for robot in (THESIS, CRL, load_robot(CONFIGS / "example_three_segment_etr.yaml")):
        rows += sweeps(robot, 1.0, 3 * arguments.moves) + sweeps(robot, 10.0, arguments.moves)
        rows += parts(robot, 5)
    if arguments.json:
        dump({"rows": [asdict(row) for row in rows], "bytes": drawn(open_session(THESIS))})
        return
    cells = [
        (
            f"{row.robot}: {row.what}",
            milliseconds(row.timing.median),
            f"{milliseconds(row.timing.fast)}–{milliseconds(row.timing.slow)}",
            str(row.timing.calls),
        )
        for row in rows
    ]
    notes = [
        f"{row.robot}: {row.what}: ninth decile {milliseconds(row.timing.slow)} ms, target {milliseconds(LIMIT)} ms: "
        f"{'reached' if row.timing.slow <= LIMIT else 'MISSED'}"
        for row in rows
        if row.robot == THESIS.name and ("slider" in row.what or "snap" in row.what)
    ]
    notes.append(f"{drawn(open_session(THESIS)) / 1e3:.0f} kB are sent for a new shape of the {THESIS.name}")
    show([table("viewer", ("", "ms", "10–90 %", "calls"), cells)], notes)


if __name__ == "__main__":
    main()
