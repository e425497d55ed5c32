"""A region in which the tips of two robots work at the same time, as what the design of a pair is wanted for."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy

from ..arguments import typed
from ..bodies.anatomy import seen_from
from ..bodies.frames import Frame
from ..bodies.obstacles import Obstacle, checked_obstacles
from ..display import Displayed
from ..errors import InputError, SolveError, positive
from ..inverse.arm_surface import ArmSurface
from ..robots.robot import Robot
from ..typing import Array, Mask
from .arms import PlacedRobot
from .arms_plan import plan_arms
from .goals import checked_places
from .question import DEFAULT_PLAN, PlanOptions
from .reach_share import ReachShare, RegionReach, check_asked, score

REST_POINTS = 100
"""Points along an arm at rest, between which its distance from another is bounded."""


@dataclass(frozen=True, eq=False)
class PairShare(Displayed):
    """What became of the pairs of N places for two tips."""

    reached: tuple[ReachShare, ReachShare]
    """Of either robot, which places it reaches by itself."""
    apart: Array = field(repr=False)
    """(N, N) lower bound of the distance (m) of the arms at rest with the first tip at one place, the second at
    another; NaN where either is not reached."""
    clearance: float
    """That they must keep, m."""

    @property
    def held(self) -> Mask:
        """(N, N) the pairs of different places that both tips hold without touching."""
        with np.errstate(invalid="ignore"):
            return np.asarray((self.apart >= self.clearance) & ~np.eye(len(self.apart), dtype=bool))

    @property
    def share(self) -> float:
        """Of the ordered pairs of different places those that are held."""
        count = len(self.apart)
        return float(self.held.sum() / (count * (count - 1)))


@typed
@dataclass(frozen=True, eq=False)
class PairReach(Displayed):
    """Goal of `search_pair`: two robots hold any two places of a region at the same time without touching.

    The base plates may be moved. Each robot reaches its place by a path with margin and clearance from obstacles, on
    its own (`RegionReach`). The distance of the two arms is bounded from below at rest; use `plan_arms` to prove a
    motion of both.

    Raises:
        InputError: a table of wrong shape, numbers out of range.
    """

    starts: tuple[Any, Any]
    """Initial joint values (rotations, translations) of the two robots."""
    bases: tuple[Frame, Frame]
    """Poses of the base plates."""
    targets: Array
    """(N, 3) places for the tips, m, at least two, in the frame of the bases."""
    obstacles: Sequence[Obstacle] = ()
    """Obstacles in the frame of the bases."""
    tolerance: float = 5e-4
    """Largest distance of the tip from a reached place, m."""
    min_margin: float = 0.05
    """Smallest allowed margin."""
    options: PlanOptions = DEFAULT_PLAN
    """Options as for `evaluate_reach`; the arms keep their clearance from each other too."""
    count: int = 200
    """Number of points of the roadmap."""
    shift: float = 0.0
    """Largest shift of either plate along its own axes, to both sides, m."""
    tilt: float = 0.0
    """Largest rotation of either plate about its own x and y, to both sides, rad."""
    words: str = field(default="share of the pairs of places that both tips hold without touching", init=False)
    """Label of the value."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "targets", checked_places(self.targets))
        object.__setattr__(self, "obstacles", checked_obstacles(self.obstacles))
        check_asked(self.tolerance, self.min_margin, self.options, self.count)
        if len(self.targets) < 2:
            raise InputError("targets is 1 point; two tips need at least 2")
        for name in ("starts", "bases"):
            if len(getattr(self, name)) != 2:
                raise InputError(f"{name} are {len(getattr(self, name))}; they must be two, one for each robot")
        positive("shift of the plates", self.shift, zero=True)
        positive("tilt of the plates", self.tilt, zero=True)

    @cached_property
    def sides(self) -> tuple[RegionReach, RegionReach]:
        """Goals of the two robots alone, in the frames of their plates."""
        numbers = self.tolerance, self.min_margin, self.options, self.count, self.shift, self.tilt
        one, other = (
            RegionReach(start, base.seen(self.targets), seen_from(base, self.obstacles), *numbers)
            for start, base in zip(self.starts, self.bases, strict=True)
        )
        return one, other

    @property
    def ranges(self) -> Array:
        """(k, 2) of how the plates may be moved: those of `RegionReach` for the one, then for the other."""
        return np.concatenate([side.ranges for side in self.sides])

    def plates(self, own: Array) -> tuple[Frame, Frame]:
        """Poses of the plates after a move by numbers (k,)."""
        first, second = (
            base.inverse.of(side.base(numbers))
            for base, side, numbers in zip(self.bases, self.sides, np.split(np.asarray(own), 2), strict=True)
        )
        return first, second

    def evaluate(self, one: Robot, other: Robot, own: Array) -> PairShare:
        """Fraction of the pairs of places that two robots hold from moved plates.

        Raises:
            InputError, SolveError: as for `evaluate_reach`.
        """
        numbers = np.split(np.asarray(own, dtype=float), 2)
        sides = [side.evaluate(robot, x) for side, robot, x in zip(self.sides, (one, other), numbers, strict=True)]
        arms = [
            _at_rest(robot, found, base)
            for robot, found, base in zip((one, other), sides, self.plates(own), strict=True)
        ]
        apart = np.full((len(self.targets),) * 2, np.nan)
        for i, first in arms[0].items():
            for j, second in arms[1].items():
                apart[i, j] = _apart(first, second)
        return PairShare((sides[0], sides[1]), apart, self.options.clearance)

    def __call__(self, one: Robot, other: Robot, own: Array) -> tuple[float, float]:
        """Score, from 0 where all pairs are held to 1, and the share; places that are missed count by how far."""
        found = self.evaluate(one, other, own)
        return score(found.reached, found.share)

    def plans_proved(self, one: Robot, other: Robot, own: Array, found: PairShare, most: int) -> tuple[int, int]:
        """Numbers of proved and of tried motions to pairs that are held; at most `most`, evenly picked."""
        pairs = np.argwhere(found.held)
        some = pairs[np.unique(np.linspace(0, len(pairs) - 1, most).astype(int))] if len(pairs) else pairs
        arms = [PlacedRobot(robot, base) for robot, base in zip((one, other), self.plates(own), strict=True)]
        options, proved = replace(self.options, objective="none"), 0
        asked: dict[str, Any] = {"obstacles": self.obstacles, "min_margin": self.min_margin, "options": options}
        for pair in some.tolist():
            ends = zip(found.reached, (one, other), pair, strict=True)
            goals = [goal for side, robot, k in ends if (goal := side.arm(robot, k)) is not None]
            with suppress(SolveError):
                proved += plan_arms(arms, self.starts, goals, **asked).proved
        return proved, len(some)


_Arm = tuple[Array, Array, float, float]
"""Centreline (P, 3) in the frame of the bases and radii (P,) of an arm at rest; square of the length of its
pieces, and how far it bends off them, m."""


def _at_rest(robot: Robot, found: ReachShare, base: Frame) -> dict[int, _Arm]:
    """Arms at the places that are reached."""
    arms: dict[int, _Arm] = {}
    for k in np.flatnonzero(found.reached).tolist():
        e = found.arm(robot, k)
        if e is None:
            continue
        outline = ArmSurface(e)
        line, radius = outline.line(REST_POINTS)
        # The arm is as thick up to the next point as it is at the one before: it grows thinner towards its tip.
        thick = np.maximum.accumulate(radius[::-1])[::-1]
        thick[1:] = np.maximum(thick[1:], thick[:-1])
        square = (float(e.arc_length[-1]) / (REST_POINTS - 1)) ** 2
        arms[k] = base.placed(line), thick, square, outline.bend * square / 8
    return arms


def _apart(one: _Arm, other: _Arm) -> float:
    """Lower bound of the distance of two arms, m: between pieces it is at least the root of the least square of the
    distances of their ends less a quarter of the squares of their lengths, see `apart`."""
    far = scipy.spatial.distance.cdist(one[0], other[0], "sqeuclidean")
    straight = np.sqrt(np.maximum(far - (one[2] + other[2]) / 4, 0.0))
    return float((straight - one[1][:, None] - other[1]).min()) - one[3] - other[3]
