"""The constraints of a design program at a state, as rows: requirements, joint limits, order of the tubes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..block.quantities import Quantity
from ..typing import Array
from .constraints import Limit, Statement
from .layout import FreePose
from .order import gaps_of, order_gaps
from .program import BOUNDED, Program, slack_name
from .state import State
from .task import DesignTask

HELD = 5e-8
"""Part of a step by which limits are held inside, so that what a solver leaves open does not violate them."""

ORDERED = 9e-8
"""The same for joints and the order of tubes, in steps of 10 mm: planning allows no more than round-off."""

POSED = ("margin in use", "certified margin")
"""Limits whose rows stay, though their derivative may be 0 for a while: where nothing softens."""

DEPTH_TOLERANCE = 1e-6
"""How exactly (m) the pose of the objective reach_radius keeps its depth."""


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of one group, >= 0 where the limit is kept, in units of `limit.size`."""

    requirement: int
    """Its number in the task."""
    part: int
    """Tells the groups of a requirement apart."""
    limit: Limit
    values: Array
    """(K,)."""
    jacobian: Array
    """(K, X)."""
    vector: tuple[Array, Array] | None = None
    """(K, 3) whose length is limited, and its change (K, 3, X), where it is such a limit: it leads least squares to 0
    from far away faster than its length does."""
    slack: tuple[float, int] | None = None
    """Steps by which the limit is eased, and their column."""
    always: bool = False
    """Whether the rows stay where no unknown moves them for a while."""


def rows_of(program: Program, state: State) -> list[Rows]:
    """All groups of rows that can be relaxed."""
    out = [group for number, stated in enumerate(program.stated) for group in stated_rows(stated, number, state)]
    # A limit on dimensions that are not free, and is kept, is no constraint.
    out = [one for one in out if one.always or one.jacobian.any() or one.values.min() < 0 or one.limit.words in POSED]
    return [_eased(state, group, k) for k, group in enumerate(out)] if program.elastic else out


def _eased(state: State, group: Rows, k: int) -> Rows:
    column = state.layout.column(slack_name(k))
    jacobian = group.jacobian.copy()
    jacobian[:, column] += 1.0
    slack = float(state.x[column])
    return replace(group, values=group.values + slack, jacobian=jacobian, slack=(slack, column))


def stated_rows(found: Sequence[Statement], number: int, state: State) -> list[Rows]:
    """Groups of rows of what a requirement, the `number`-th of its task, states as expressions."""
    out = []
    for one in found:
        size, vector = one.limit.size, None
        values, jacobian = one.expression.linear(state.quantity)
        if one.vector is not None:
            gap, slope = (part / size for part in one.vector.linear(state.quantity))
            vector = gap.reshape(-1, 3), slope.reshape(len(gap) // 3, 3, -1)
        rows = np.atleast_1d(values) / size - HELD, np.atleast_2d(jacobian) / size
        out.append(Rows(number, one.part, one.limit, *rows, vector, always=one.always))
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


def fixed_rows(program: Program, state: State) -> tuple[Array, Array]:
    """Rows that are never relaxed: joint limits, the order of the tubes, the depth of the reach, the bounds behind
    strain and margin."""
    values, change = linear_rows(state, program.task)
    parts, changes = [values], [change]
    for one in program.task.built_in:
        if one.depth is not None and program.depth_pose is not None:
            place, slope = state.quantity(Quantity("tip_position", program.depth_pose))
            height = place[2] - one.depth
            parts.append(np.array([DEPTH_TOLERANCE - height, DEPTH_TOLERANCE + height]) / 1e-2)
            changes.append(np.array([-slope[2], slope[2]]) / 1e-2)
        if one.kind in program.layout.auxiliary:
            column, size = program.layout.column(one.kind), BOUNDED[one.kind][2]
            values, change = program.aims[one].linear(state.quantity)
            change = -one.sign * change
            change[:, column] += one.sign
            parts.append(one.sign * (state.x[column] - values) / size)
            changes.append(change / size)
    return np.concatenate(parts), np.concatenate(changes)


def squared(group: Rows) -> Rows:
    """Rows that limit the length of a vector, in its square: of constant curvature, the same to first order where they
    bind; as they are where the limit is eased by slack."""
    if group.vector is None or group.slack is not None:
        return group
    vector, change = group.vector
    most = group.limit.value / group.limit.size
    values = (most**2 - (vector**2).sum(1)) / (2 * most) - HELD
    return replace(group, values=values, jacobian=-np.einsum("kc,kcx->kx", vector, change) / most)


def cubed(group: Rows) -> Rows:
    """Rows that limit the length of a vector, as the six sides of the cube inside: linear in it, and stricter."""
    if group.vector is None:
        return group
    vector, change = np.sqrt(3) * group.vector[0], np.sqrt(3) * group.vector[1]
    most = group.limit.value / group.limit.size - HELD + (0.0 if group.slack is None else group.slack[0])
    values = np.concatenate([most - vector, most + vector], axis=1).ravel()
    jacobian = np.concatenate([-change, change], axis=1).reshape(len(values), -1)
    if group.slack is not None:
        jacobian[:, group.slack[1]] += 1.0
    return replace(group, values=values, jacobian=jacobian)
