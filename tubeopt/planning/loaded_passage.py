"""Following a trajectory under a load, close enough that what lies between its equilibria is proved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..equilibrium.continuation import JointPath
from ..equilibrium.load_continuation import JointFamily
from ..equilibrium.load_problem import LOADED_DISCRETISATION
from ..equilibrium.loaded import loaded_point
from ..equilibrium.result import Equilibrium
from ..robots.load import Load
from ..stability.loaded_following import LoadedEvent, loaded_motion_along
from ..typing import Array, Index
from .branch import Branch
from .loaded_branch import loaded_branch
from .loaded_sections import LoadedArms, LoadedIntervals, Pull, uncovered
from .passage import Follower, Step
from .sections import Intervals


@dataclass(eq=False)
class LoadedFollower(Follower):
    """Follows a robot that bears a load past bodies."""

    load: Load = field(default_factory=Load)

    @property
    def halvings(self) -> int:
        """None where nothing bounds anything."""
        return 0 if uncovered(self.load) else super().halvings

    @property
    def says(self) -> str:
        """What can be proved nowhere, in words; empty where nothing is known to stand against it."""
        what = uncovered(self.load)
        return f"what lies between equilibria under {what} is not bounded" if what else ""

    @cached_property
    def pull(self) -> Pull:
        """The load on the cross-sections."""
        return Pull.of(self.robot, self.load)

    def near(self, here: Step, at: float, joints: Array) -> Step | None:
        """The same: small changes of joints are one solve."""
        return self.step(here, at, joints)

    def intervals(self, equilibria: Sequence[Equilibrium], one: Index, other: Index) -> Intervals:
        """Those between some of a list of equilibria."""
        if uncovered(self.load):
            return super().intervals(equilibria, one, other)
        return LoadedIntervals.of(LoadedArms.of(self.constants, equilibria, pull=self.pull), one, other)

    def joined(self, intervals: Intervals) -> Branch:
        """What is known between neighbours: nothing of a load that the bounds do not cover."""
        if not isinstance(intervals, LoadedIntervals):
            none = np.zeros(len(intervals.one), dtype=bool)
            return Branch(none, np.full(intervals.length[0].shape, np.inf), none)
        return loaded_branch(intervals, np.array([min(e.margin, 1.0) for e in intervals.arms.equilibria]))

    def snap(self, e: Equilibrium, joints: Array) -> float | None:
        """Share of the straight way from an equilibrium to joint values (2n,) after which it snaps."""
        path = JointPath(self.robot, np.concatenate([e.rotations, e.translations]), joints, LOADED_DISCRETISATION)
        points = loaded_motion_along(JointFamily(path, self.load, self.load), replace(loaded_point(e), t=0.0))
        return next((point.loss.t for point in points if isinstance(point, LoadedEvent)), None)
