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
from ..errors import SolveError
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

    def ends(self, here: Step, at: float, joints: Array) -> float | None:
        """Fraction of the time at which the branch that leads from here to joint values (2n,) ends by a snap."""
        begin = np.concatenate([here.equilibrium.rotations, here.equilibrium.translations])
        family = JointFamily(JointPath(self.robot, begin, joints, LOADED_DISCRETISATION), self.load, self.load)
        try:
            points = loaded_motion_along(family, replace(loaded_point(here.equilibrium), t=0.0))
            snap = next((point for point in points if isinstance(point, LoadedEvent)), None)
        except SolveError:
            snap = None
        return None if snap is None else here.at + snap.loss.t * (at - here.at)
