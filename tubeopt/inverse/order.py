"""The order of breakpoints along the arm: between its changes everything is smooth in the joint values."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..robots.assembly import Assembly
from ..typing import Array
from .goal import Goal
from .posture import Posture

CLOSED_SECTION = 1e-7
"""Length, m, of a section between breakpoints that counts as none."""

SHORT_SECTION = 1e-4
"""Length of a section, as a share of the robot's length, that may block a step like a closed one."""

MOVED_PAST = 1e-5
"""Distance that breakpoints are moved past each other, as a share of the robot's length."""


@dataclass(frozen=True, eq=False)
class Order:
    """The order of breakpoints at translations d (G,) of the carriages, as numbers."""

    length: Array
    """(P,) of the pieces at translations 0, m."""
    length_slope: Array
    """(P, G) of the lengths, which are length + slope d."""
    rows: Array
    """(c, G) rows d >= bound keeps the order: of breakpoints, which may be another one, then of the tubes."""
    bound: Array
    """(c,) m."""
    changeable: int
    """Rows of the order of breakpoints."""

    def kept(self, q: Array, rows: Array, bounds: Array) -> tuple[Array, Array]:
        """Rows and bounds of a step from joint values q (m,), with those that keep the order of breakpoints."""
        own = np.zeros((self.changeable, len(q)))
        own[:, len(q) - self.rows.shape[1] :] = self.rows[: self.changeable]
        gap = np.minimum(self.bound[: self.changeable] - own @ q, 0.0)
        return np.vstack([rows, own]), np.concatenate([bounds, gap])

    def closed(self, shift: Array, section: float) -> list[tuple[Array, float]]:
        """Changes of the order that are next: rows and bounds that translations (G,) keep by no more than `section`."""
        gap = self.rows[: self.changeable] @ shift - self.bound[: self.changeable]
        return [(self.rows[k], float(self.bound[k])) for k in np.flatnonzero(gap <= section)]


def breakpoint_order(goal: Goal, at: Posture) -> Order:
    """The order of breakpoints of a posture."""
    space, problem = goal.space, at.problem
    n, groups = space.robot.n_tubes, len(space.carriages)
    assembly, shift = problem.assembly, at.q[n:]
    marks = [(0.0, np.zeros(groups))]
    rows, bound = [], []
    for k, tubes in enumerate(space.carriages):
        unit = np.eye(groups)[k]
        for s in _breakpoints(assembly, tubes):
            if s > 0:
                marks.append((s, unit))
            else:
                rows.append(-unit)
                bound.append(float(s - shift[k]))
    marks.sort(key=lambda mark: mark[0])
    place = np.array([mark[0] for mark in marks])
    slope = np.array([mark[1] for mark in marks])
    cuts = np.append(assembly.start, assembly.total_length)
    owner = slope[np.abs(place[:, None] - cuts).argmin(0)]
    section = np.diff(owner, axis=0)
    counts = np.bincount(problem.mesh.section, minlength=assembly.n_sections)
    length_slope = (section / counts[:, None])[problem.mesh.section]
    for first, second, row in zip(place[:-1], place[1:], np.diff(slope, axis=0), strict=True):
        if row.any():
            rows.append(row)
            bound.append(float(row @ shift - (second - first)))
    length = problem.mesh.length - length_slope @ shift
    rows, bound, changeable = [*rows, *space.rows[:, n:]], [*bound, *space.least], len(bound)
    return Order(length, length_slope, np.reshape(rows, (-1, groups)), np.array(bound), changeable)


def _breakpoints(assembly: Assembly, tubes: tuple[int, ...]) -> list[float]:
    """Transitions, ends, and places where pieces meet, of the tubes of one carriage, each place once."""
    mine = list(tubes)
    ends, transitions = assembly.end[mine], assembly.transition[mine]
    bent = ends - transitions > 1e-12
    joints = zip(assembly.breakpoints, assembly.breakpoint_tubes, strict=True)
    cuts = [s for s, i in joints if i in mine] if assembly.general else []
    return sorted({round(float(s), 12) for s in [*ends, *transitions[bent], *cuts]})


def apart(goal: Goal, at: Posture) -> Posture:
    """The posture with breakpoints that coincide moved apart a little, where the limits allow."""
    space = goal.space
    n = space.robot.n_tubes
    step = MOVED_PAST * space.length * np.arange(1, len(space.carriages) + 1)[::-1]
    place = np.sort(np.append([s for g in space.carriages for s in _breakpoints(at.problem.assembly, g)], 0.0))
    if (np.diff(place) > CLOSED_SECTION).all():
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
    """The posture beyond every change of the order that a section of no more than this (m) keeps it from."""
    return beyond(goal, at, breakpoint_order(goal, at).closed(at.q[goal.space.robot.n_tubes :], section))


def beyond(goal: Goal, at: Posture, crossed: Sequence[tuple[Array, float]]) -> Iterator[Posture]:
    """The posture with breakpoints moved past each other, for each pair (row, bound) of an `Order` for which the limits
    allow it."""
    space = goal.space
    n = space.robot.n_tubes
    for row, bound in crossed:
        q = at.q.copy()
        past = max(float(row @ at.q[n:] - bound), 0.0) + 2 * MOVED_PAST * space.length
        q[n:] -= past * row / float(row @ row)
        q = space.clip(q)
        if not space.admissible(q):
            continue
        moved = at.to(q)
        if moved is not None and moved.margin >= goal.floor:
            yield moved
