"""Order of breakpoints along the arm: constraints that keep it, and postures beyond a change of it.

Derivatives of an equilibrium are smooth within one order of breakpoints, and jump where a section between two of them
closes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..robots.assembly import Assembly
from ..typing import Array
from .goal import Goal
from .joints import JointSpace
from .posture import Posture

# Ten times the distance at which a target counts as met: breakpoints that are closer make no difference to an answer.
CLOSED_SECTION = 1e-7
"""Length, m, below which a section between breakpoints counts as closed."""

# Derivatives are valid up to the end of a section only. On an arm of 200 mm a section of 20 um stops a step so soon
# that a descent looks converged although it would continue in the next order of breakpoints.
SHORT_SECTION = 1e-4
"""Length of a section, relative to the robot's length, that may block a step like a closed one."""

# More than CLOSED_SECTION (2 um against 0.1 um on an arm of 200 mm), or the first step beyond a change of order would
# close the section again and lead back.
MOVED_PAST = 1e-5
"""Distance that breakpoints are moved past each other, relative to the robot's length."""


@dataclass(frozen=True, eq=False)
class OrderConstraints:
    """Order of breakpoints as linear inequalities in the translations d (G,) of the carriages."""

    length: Array
    """Lengths (P,) of the mesh pieces at d = 0, m."""
    length_slope: Array
    """Derivatives (P, G) of the lengths of the mesh pieces by d."""
    rows: Array
    """Rows (c, G) with rows d >= bound: the order of breakpoints, then the order of the tubes, which is fixed."""
    bound: Array
    """Lower bounds (c,) of the rows, m."""
    changeable: int
    """Number of rows for the order of breakpoints."""

    def constrain(self, q: Array, rows: Array, bounds: Array) -> tuple[Array, Array]:
        """Constraints of a step from joint values q (m,), extended by the order of breakpoints."""
        order_rows, order_bounds = self.kept(q, 0.0)
        return np.vstack([rows, order_rows]), np.concatenate([bounds, order_bounds])

    def kept(self, q: Array, length: float) -> tuple[Array, Array]:
        """Rows (k, m) and bounds (k,) of steps from q (m,) after which sections have at least this length (m).

        Sections that are shorter do not get shorter still.
        """
        rows = np.zeros((self.changeable, len(q)))
        rows[:, len(q) - self.rows.shape[1] :] = self.rows[: self.changeable]
        return rows, np.minimum(self.bound[: self.changeable] - rows @ q + length, 0.0)

    def closed(self, shift: Array, section: float) -> list[tuple[Array, float]]:
        """Rows and bounds of sections not longer than `section` (m) at translations (G,)."""
        length = self.rows[: self.changeable] @ shift - self.bound[: self.changeable]
        return [(self.rows[k], float(self.bound[k])) for k in np.flatnonzero(length <= section)]


def breakpoint_order(space: JointSpace, at: Posture) -> OrderConstraints:
    """Order of breakpoints of a posture."""
    n, groups = space.robot.n_tubes, len(space.carriages)
    if not space.robot.fixed_sections:  # a solve of a bundle finds the order
        none = np.zeros((0, groups))
        return OrderConstraints(np.zeros(0), none, np.reshape(space.rows[:, n:], (-1, groups)), space.row_lower, 0)
    problem = at.problem
    assembly, shift = problem.assembly, at.q[n:]
    breaks = [(0.0, np.zeros(groups))]
    rows, bound = [], []
    for k, tubes in enumerate(space.carriages):
        unit = np.eye(groups)[k]
        for s in breakpoints(assembly, tubes):
            if s > 0:
                breaks.append((s, unit))
            else:
                rows.append(-unit)
                bound.append(float(s - shift[k]))
    breaks.sort(key=lambda point: point[0])
    position = np.array([point[0] for point in breaks])
    slope = np.array([point[1] for point in breaks])
    cuts = np.append(assembly.start, assembly.total_length)
    owner = slope[np.abs(position[:, None] - cuts).argmin(0)]
    section = np.diff(owner, axis=0)
    counts = np.bincount(problem.mesh.section, minlength=assembly.n_sections)
    length_slope = (section / counts[:, None])[problem.mesh.section]
    for first, second, row in zip(position[:-1], position[1:], np.diff(slope, axis=0), strict=True):
        if row.any():
            rows.append(row)
            bound.append(float(row @ shift - (second - first)))
    length = problem.mesh.length - length_slope @ shift
    rows, bound, changeable = [*rows, *space.rows[:, n:]], [*bound, *space.row_lower], len(bound)
    return OrderConstraints(length, length_slope, np.reshape(rows, (-1, groups)), np.array(bound), changeable)


def breakpoints(assembly: Assembly, tubes: Sequence[int]) -> list[float]:
    """Distinct arc lengths, m, of transitions, ends and joints of pieces for the tubes of one carriage."""
    mine = list(tubes)
    ends, transitions = assembly.end[mine], assembly.transition[mine]
    bent = ends - transitions > 1e-12
    joints = zip(assembly.breakpoints, assembly.breakpoint_tubes, strict=True)
    cuts = [s for s, i in joints if i in mine] if assembly.general else []
    return sorted({round(float(s), 12) for s in [*ends, *transitions[bent], *cuts]})


def breakpoints_at_zero(space: JointSpace) -> list[tuple[int, float]]:
    """Carriage of each breakpoint, from 0, and its arc length, m, if the translation of the carriage were 0.

    Empty for a bundle: its sections follow from its bending.
    """
    robot = space.robot
    if not robot.fixed_sections:
        return []
    zero = space.offset[robot.n_tubes :] - robot.home_translations
    home = robot.assembly(robot.home_translations)
    groups = enumerate(space.carriages)
    return [(c, float(s + zero[group[0]])) for c, group in groups for s in breakpoints(home, group)]


def separate_breakpoints(goal: Goal, at: Posture) -> Posture:
    """Posture with coinciding breakpoints moved apart a little, if the limits allow it."""
    space = goal.space
    if not space.robot.fixed_sections:
        return at
    n = space.robot.n_tubes
    # A step of its own for each carriage: with equal ones breakpoints that coincide would stay together.
    step = MOVED_PAST * space.length * np.arange(1, len(space.carriages) + 1)[::-1]
    position = np.sort(np.append([s for g in space.carriages for s in breakpoints(at.problem.assembly, g)], 0.0))
    if (np.diff(position) > CLOSED_SECTION).all():
        return at
    for sign in (1.0, -1.0):
        q = at.q.copy()
        q[n:] += sign * step
        if space.admissible(q):
            moved = at.to(q)
            if moved is not None:
                return moved
    return at


def crossings(goal: Goal, at: Posture, section: float) -> Iterator[Posture]:
    """Postures with two breakpoints swapped, one for each pair closer than `section`, m."""
    shift = at.q[goal.space.robot.n_tubes :]
    return cross_breakpoints(goal, at, breakpoint_order(goal.space, at).closed(shift, section))


def cross_breakpoints(goal: Goal, at: Posture, sections: Sequence[tuple[Array, float]]) -> Iterator[Posture]:
    """Posture with breakpoints moved past each other, for each section (row, bound), within the limits."""
    space = goal.space
    n = space.robot.n_tubes
    for row, bound in sections:
        q = at.q.copy()
        past = max(float(row @ at.q[n:] - bound), 0.0) + 2 * MOVED_PAST * space.length
        # The shortest motion of the carriages that takes the row past its bound.
        q[n:] -= past * row / float(row @ row)
        q = space.clip(q)
        if not space.admissible(q):
            continue
        moved = at.to(q)
        if moved is not None and moved.margin >= goal.kept_margin:
            yield moved
