"""A region for the tip as what a design is wanted for: the share of it that is reached by ways without a snap."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy

from ..bodies.frames import Frame
from ..bodies.obstacles import Obstacle
from ..bodies.placed import seen_from
from ..display import Displayed
from ..errors import SolveError, positive
from ..robots.robot import Robot
from ..typing import Array
from .goals import checked_places
from .options import DEFAULT_PLAN, PlanOptions
from .plan import plan_trajectory
from .reach_share import ReachShare, evaluate_reach


@dataclass(frozen=True, eq=False)
class RegionReach(Displayed):
    """What `search_design` asks of a robot: to reach places of a region from where it starts, by ways that keep margin
    and clearance, maybe from a plate that may be moved.

    The share is a lower bound: a larger roadmap (`count`) may lead to more places, and one of too few points to none.
    That of few places does not tell neighbours apart; the score takes in how far those are missed that are not
    reached. Robots are compared by the same random numbers.

    Args:
        start: joint values (rotations, translations), with which every robot begins.
        targets: (N, 3) places for the tip, m.   obstacles: bodies; both in the frame of the plate as it stands.
        tolerance, min_margin, options, count: as of `evaluate_reach`.
        shift: how far the plate may be moved along each of its axes, to both sides, m.
        tilt: by how much it may be turned about its x and about its y, to both sides, rad.
        words: what its value is called.

    Raises:
        InputError: a table of wrong shape, numbers that make no sense.
    """

    start: tuple[Any, Any]
    targets: Array
    obstacles: Sequence[Obstacle] = ()
    tolerance: float = 5e-4
    min_margin: float = 0.05
    options: PlanOptions = DEFAULT_PLAN
    count: int = 200
    shift: float = 0.0
    tilt: float = 0.0
    words: str = field(default="share of the region that is reached", init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "targets", checked_places(self.targets))
        positive("shift of the plate", self.shift, zero=True)
        positive("tilt of the plate", self.tilt, zero=True)

    @property
    def ranges(self) -> Array:
        """(k, 2) of how the plate may be moved: along x, y and z, m, then about x and y, rad, where it may be."""
        most = np.array([self.shift] * 3 * bool(self.shift) + [self.tilt] * 2 * bool(self.tilt))
        return np.column_stack([-most, most])

    def base(self, own: Array) -> Frame:
        """Where the plate stands, in the frame of the plate as it stood, when it is moved by numbers (k,)."""
        shift, tilt = np.split(np.asarray(own, dtype=float), [3 * bool(self.shift)])
        turn = np.append(tilt, 0.0) if len(tilt) else np.zeros(3)
        axes = scipy.spatial.transform.Rotation.from_rotvec(turn).as_matrix()
        return Frame(axes, shift if len(shift) else np.zeros(3))

    def evaluate(self, robot: Robot, own: Array) -> ReachShare:
        """The places that a robot reaches from a plate that is moved.

        Raises:
            InputError, SolveError: as of `evaluate_reach`.
        """
        frame = self.base(own)
        return evaluate_reach(
            robot,
            self.start,
            frame.seen(self.targets),
            tolerance=self.tolerance,
            obstacles=seen_from(frame, self.obstacles),
            min_margin=self.min_margin,
            options=self.options,
            count=self.count,
        )

    def __call__(self, robot: Robot, own: Array) -> tuple[float, float]:
        """Score, from 0 where all places are reached to 1, and the share."""
        found = self.evaluate(robot, own)
        return score([found], found.share, self.options.effort.region_close)

    def plans_proved(self, robot: Robot, own: Array, found: ReachShare, most: int) -> tuple[int, int]:
        """How many plans to places that are reached, the first ones, are proved, and how many were asked for."""
        some, proved = np.flatnonzero(found.reached)[:most], 0
        bodies, options = seen_from(self.base(own), self.obstacles), replace(self.options, objective="none")
        asked: dict[str, Any] = {"obstacles": bodies, "min_margin": self.min_margin, "options": options}
        for k in some.tolist():
            goal = found.arm(robot, k)
            with suppress(SolveError):
                proved += goal is not None and plan_trajectory(robot, self.start, goal, **asked).proved
        return proved, len(some)


def score(found: Sequence[ReachShare], share: float, close: float) -> tuple[float, float]:
    """From 0 where all is reached to 1, by a share and how far places are missed, up to `close`, m; and the share."""
    missed = [np.minimum(np.maximum(each.miss - each.tolerance, 0.0) / close, 1.0) for each in found]
    return float(np.mean(missed) + 1 - share) / 2, share
