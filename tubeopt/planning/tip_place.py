"""Where no tip can be: in an obstacle, farther than any arm, or behind a box that no arm gets around."""

from __future__ import annotations

import numpy as np

from ..bodies.obstacles import Box
from ..errors import SolveError
from ..inverse.task import Task
from ..typing import Array


def place_for_the_tip(task: Task, position: Array) -> None:
    """Raise SolveError where the tip cannot be at a place, since an obstacle is there."""
    for k, obstacle in enumerate(task.obstacles):
        # No arm is thinner at its tip than the thinnest tube.
        clear = float(obstacle.signed_distance(position[None])[0] - task.chart.radius.min())
        if clear < task.clearance:
            raise SolveError(
                f"no plan exists: with its tip at the goal the arm has clearance {clear * 1e3:.4g} mm at most from "
                f"obstacle {k + 1} ({type(obstacle).__name__}); it must keep {task.clearance * 1e3:g} mm"
            )


def long_enough(task: Task, position: Array) -> None:
    """Raise SolveError where no arm is long enough for its tip to be at a place, straight or around a box."""
    space, n = task.chart.space, task.chart.space.robot.n_tubes
    whole = np.array([tube.length - tube.straight_length for tube in space.robot.tubes])
    longest = float((space.spread[n:] @ space.upper + space.offset[n:] + whole).max())
    far = float(np.linalg.norm(position))
    if far > longest:
        raise SolveError(
            f"no plan exists: the goal is {far * 1e3:.4g} mm from the plate, and no arm is longer than "
            f"{longest * 1e3:.4g} mm"
        )
    for k, body in enumerate(task.obstacles):
        around = way_around(body, position) if isinstance(body, Box) else 0.0
        if around > longest:
            raise SolveError(
                f"no plan exists: obstacle {k + 1} (Box) is between the plate and the goal; a way around it is at "
                f"least {around * 1e3:.4g} mm long, and no arm is longer than {longest * 1e3:.4g} mm"
            )


def way_around(box: Box, position: Array) -> float:
    """Length (m) that a way from the plate to a place is at least, since a box lies between them; 0 where it does not.

    Where plate and place are on either side of the box along an axis, a way passes the plane in the middle of the box
    beyond one of its four sides there: at best on the edge of that side, unfolded about it.
    """
    low, high, longest = np.array(box.low), np.array(box.high), 0.0
    for k in range(3):
        if not min(0.0, position[k]) < low[k] < high[k] < max(0.0, position[k]):
            continue
        middle, ways = (low[k] + high[k]) / 2, []
        for i in range(3):
            for edge, side in ((low[i], -1.0), (high[i], 1.0)) if i != k else ():
                # From a point that is itself beyond the side the plane is reached straight on.
                reach = [np.hypot(max(side * (edge - p[i]), 0.0), middle - p[k]) for p in (np.zeros(3), position)]
                along = position[3 - i - k]
                ways.append(float(np.hypot(sum(reach), along)))
        longest = max(longest, min(ways))
    return longest
