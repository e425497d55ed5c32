"""Requirements as rows of constraints g(x) >= 0, in groups that can be named, relaxed and priced."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..typing import Array
from .lookup import at_state
from .order import gaps_of, order_gaps
from .state import FreePose, State
from .statements import Limit, Statement
from .task import DesignTask

HELD = 5e-8
"""Part of a step by which limits are held inside, so that what a solver leaves open does not violate them."""

ORDERED = 9e-8
"""The same for joints and the order of tubes, in steps of 10 mm: planning allows no more than round-off."""


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of one group: values (K,) and Jacobian (K, X), >= 0 where the limit is kept, in units of `limit.size`;
    `requirement` is the number of the requirement in the task, `part` tells its groups apart. Rows that limit the
    length of a vector tell it too: `vector` (K, 3) and its change (K, 3, X), in the same units, which leads least
    squares to 0 from far away faster than its length does. `slack`: steps by which the limit is eased, and
    their column. `always`: the rows stay where no unknown moves them for a while."""

    requirement: int
    part: int
    limit: Limit
    values: Array
    jacobian: Array
    vector: tuple[Array, Array] | None = None
    slack: tuple[float, int] | None = None
    always: bool = False


def _rows(number: int, part: int, limit: Limit, values: Array, jacobian: Array) -> Rows:
    return Rows(number, part, limit, np.atleast_1d(values) / limit.size - HELD, np.atleast_2d(jacobian) / limit.size)


def stated_rows(found: Sequence[Statement], number: int, state: State) -> list[Rows]:
    """Groups of rows of what a requirement, the `number`-th of its task, states as expressions."""
    look, out = at_state(state), []
    for one in found:
        group = _rows(number, one.part, one.limit, *one.expression.linear(look))
        if one.vector is not None:
            gap, slope = (part / one.limit.size for part in one.vector.linear(look))
            group = replace(group, vector=(gap.reshape(-1, 3), slope.reshape(len(gap) // 3, 3, -1)))
        out.append(replace(group, always=one.always))
    return out


def linear_rows(state: State, task: DesignTask) -> tuple[Array, Array]:
    """Rows that are linear in the unknowns, >= 0 where kept, in steps of 10 mm: in every free pose the order of the
    tubes, and the ranges of the translations that the robot's actuators have; that no tube is shorter than the next
    outer one; the order at given translations. What no unknown moves is left out, as the task has checked it."""
    layout, unmoved, limits = state.layout, np.zeros((state.layout.n, 1)), task.robot.joint_limits
    straight, curved = (state.slopes[name] for name in ("straight_length", "curved_length"))
    length, longer = np.array([tube.length for tube in state.tubes]), straight + curved
    values: list[Array] = []
    slopes: list[Array] = []
    for k in (k for k, pose in enumerate(layout.poses) if isinstance(pose, FreePose)):
        shift, moved = state.joint_values(k)[1], state.joint_slopes(k)[1]
        values.append(gaps_of(state.tubes, shift, shift))
        slopes.append(order_gaps(straight, curved, moved, moved))
        if limits is not None:
            low, high = np.array(limits.translations).T
            values += [shift - low, high - shift]
            slopes += [moved, -moved]
    values.append(length[:-1] - length[1:])
    slopes.append(longer[:-1] - longer[1:])
    for place in task.places:
        values.append(gaps_of(state.tubes, place.low, place.high))
        slopes.append(order_gaps(straight, curved, unmoved, unmoved))
    slope = np.concatenate(slopes)
    moves = slope.any(axis=1)
    return np.concatenate(values)[moves] / 1e-2 - ORDERED, slope[moves] / 1e-2
