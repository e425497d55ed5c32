"""Quasi-static motion of an arm among walls, with its snaps."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ..equilibrium.arm_surface import ArmSurface
from ..equilibrium.result import Equilibrium
from ..equilibrium.wall_contact import Milestone, Solved, Walls, along_joints, at_walls, landed, start_of
from ..errors import SolveError
from ..typing import Array
from .folds import PAST
from .motion import SMOOTH_TURN, Event, Snap, family_between, motion

APART = 2e-3
"""Distance (m) from the walls at which an arm that left them moves as without walls."""


class Place(NamedTuple):
    """Equilibrium on the way from one waypoint to the next."""

    t: float
    """Fraction of the way."""
    state: Equilibrium | Solved
    """Equilibrium that touches no wall, or solution that may."""

    def after(self, t: float, state: Equilibrium | Solved) -> Place:
        """Place at fraction t of the rest of the way."""
        return Place(1.0 if t == 1 else self.t + t * (1 - self.t), state)


def segments_among_walls(first: Equilibrium, joints: Array, walls: Walls) -> Iterator[tuple[Equilibrium, list[Snap]]]:
    """Equilibrium among walls at every waypoint (T, 2n), with the snaps before it; `first` is that at the first one.

    Raises:
        SolveError: the arm comes to rest nowhere after a snap.
    """
    yield first, []
    touches = first.walls is not None and first.walls.contacts
    state: Equilibrium | Solved = start_of(first, walls) if touches else first
    for index, waypoint in enumerate(joints[1:]):
        place, snaps = Place(0.0, state), list[Snap]()
        while place.t < 1:
            if isinstance(place.state, Equilibrium):
                place = _apart_from_walls(place, place.state, waypoint, walls)
            else:
                place, snap = _near_walls(place, place.state, waypoint, index)
                snaps += [] if snap is None else [snap]
        state = place.state
        yield walls.described(state) if isinstance(state, Equilibrium) else at_walls(state), snaps


def _apart_from_walls(place: Place, pose: Equilibrium, waypoint: Array, walls: Walls) -> Place:
    """Place up to which the arm moves without a snap, and in no step farther than its distance from the walls."""
    here = np.concatenate([pose.rotations, pose.translations])
    last = Milestone(0.0, pose)
    for step in motion(family_between(walls.robot, here, waypoint, walls.load), pose):
        if isinstance(step, Event) or ArmSurface(step.pose).clearance(walls.scene) < _motion(last.state, step.pose):
            return place.after(last.t, start_of(last.state, walls))
        last = Milestone(step.t, step.pose)
    return place.after(1.0, last.state)


def _motion(before: Equilibrium, after: Equilibrium) -> float:
    """Largest distance (m) that a point of the arm moves, at equal fractions of its length."""
    fraction = np.linspace(0.0, 1.0, 50)
    lines = (ArmSurface(each).centreline(fraction * each.arc_length[-1]) for each in (before, after))
    return float(np.linalg.norm(np.subtract(*lines), axis=1).max())


def _near_walls(place: Place, solved: Solved, waypoint: Array, index: int) -> tuple[Place, Snap | None]:
    """Place up to which the arm moves until it is apart from the walls or its branch ends, and the snap there."""
    passed = [Milestone(0.0, solved)]
    rotations, translations = np.split(waypoint, 2)
    for step in along_joints(solved, rotations, translations):
        passed.append(step)
        if step.t < 1 and not step.state.pressed and step.state.clearance > APART:
            return place.after(step.t, at_walls(step.state)), None
    last = passed[-1]
    end = place.after(last.t, last.state)
    if last.t == 1:
        return end, None
    after = landed(_beyond(last.state, waypoint))
    # A contact that opens may end a branch next to another one, which takes over.
    far = after.distance(last.state) > SMOOTH_TURN
    snap = Snap(index, end.t, _before_end(passed), at_walls(after)) if far else None
    return end.after(PAST, after), snap


def _beyond(solved: Solved, waypoint: Array) -> Solved:
    """Equations a little beyond the end of a branch on the path to a waypoint (2n,), with the unknowns before it."""
    member, walls = solved.touching.member, solved.touching.walls
    here = np.concatenate([member.rotations, member.translations])
    rotations, translations = np.split(here + PAST * (waypoint - here), 2)
    touching = walls.equations(rotations, tuple(translations.tolist()), solved.pressed)
    return Solved(touching, solved.on(touching), solved.pressed, 0)


def _before_end(passed: Sequence[Milestone[Solved]]) -> Equilibrium:
    """Last equilibrium of a branch that a finer mesh confirms: its end differs from mesh to mesh by the errors of both.

    Raises:
        SolveError: there is none.
    """
    for milestone in passed[:0:-1]:
        with contextlib.suppress(SolveError):
            return at_walls(milestone.state)
    return at_walls(passed[0].state)
