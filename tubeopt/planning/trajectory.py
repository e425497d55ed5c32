"""What planning answers with: plain tables over time, with their proof."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from typing import Annotated

import numpy as np

from ..bodies.frames import Frame, Plane
from ..bodies.obstacles import Obstacle
from ..bodies.scene import scene_of
from ..display import Displayed
from ..equilibrium.result import Equilibrium
from ..inverse.arm_surface import ArmSurface
from ..inverse.joints import joint_space
from ..robots.robot import Robot
from ..typing import Array, lazy_import
from .motion import RateLimits
from .proof import Proof


@dataclass(frozen=True)
class PlanStatistics:
    """How a plan was found."""

    how: str
    """"straight", "detour", "search", or by what else."""
    smoothed: str
    """By which objective, "corners" where only those of the way were rounded, "" where it rests at them: what is
    smoothed was not allowed, no better, or not asked for."""
    motions: int
    """That the search checked."""
    raw_length: float
    """Of the path in joint space as found, in units of the joints' scales (1 rad, half the longest tube)."""
    length: float
    """As it is."""
    iterations: int
    """Of smoothing."""
    knots: int
    """Of smoothing."""
    search_seconds: float
    smooth_seconds: float = 0.0
    proof_seconds: float = 0.0
    seconds: float = 0.0
    """In all."""


@dataclass(frozen=True, eq=False)
class Entry(Displayed):
    """A place of the plate that was chosen."""

    frame: Frame
    """In the frame of the plate as it is given."""
    base: Frame
    """In the patient, RAS; the same without a patient."""
    considered: Annotated[int, "number of positions considered"]
    clear: Annotated[int, "number of them with a collision-free arm at the start"]
    tried: Annotated[int, "number of these that were tried as start of a plan"]


@dataclass(frozen=True, eq=False)
class Trajectory(Displayed):
    """A motion on one stable branch, T samples of n tubes; joint values are linear between samples."""

    _brief = ("robot", "status", "time")

    robot: Robot
    """The robot."""
    time: Array
    """(T,) s; evenly spaced, but for the rests of `ArmsPlan.withdrawn_first`."""
    rotations: Array
    """(T, n) rad, not wrapped."""
    translations: Array
    """(T, n) translations, m."""
    arms: tuple[Equilibrium, ...]
    """Equilibria at the samples."""
    start: Equilibrium
    """Equilibrium at the requested start."""
    turns: Annotated[tuple[int, ...], "full turns added to the rotations of the goal"]
    """Shape (n,)."""
    obstacles: tuple[Obstacle, ...]
    """Obstacles that the arm avoids."""
    min_margin: float
    """Smallest allowed margin."""
    min_clearance: float
    """Required clearance, m."""
    rate_limits: RateLimits
    """Limits on speeds and accelerations."""
    proof: Annotated[Proof, "the proof"]
    """Proof by independent code; `.proved` states whether it finished in time, `.status` the same as a sentence."""
    statistics: PlanStatistics
    """Effort of the search."""
    deviation: Array | None = None
    """(T,) distance of the tip from the path that it was to follow, or, for follow-the-leader, of the arm from the path
    of its tip, m; None for other plans."""
    entry: Annotated[Entry | None, "chosen position of the plate; null if it was not free"] = None
    """From `plan_from_region`; None if the plate was not moved."""
    cut: Plane | None = None
    """Along which pictures cut bodies open, in the frame of the plate; None for none."""

    @property
    def end(self) -> Equilibrium:
        """The equilibrium at its end."""
        return self.arms[-1]

    @cached_property
    def tip_position(self) -> Array:
        """(T, 3) positions of the tip, m."""
        return np.array([e.tip_position for e in self.arms])

    @cached_property
    def margin(self) -> Array:
        """(T,) margins."""
        return np.array([e.margin for e in self.arms])

    @cached_property
    def clearance(self) -> Array:
        """Required clearance, m."""
        scene = scene_of(self.obstacles)
        return np.array([ArmSurface(e).clearance(scene) for e in self.arms])

    @property
    def value(self) -> tuple[Array, Array]:
        """The joint values over time: rotations (T, n), rad, and translations (T, n), m."""
        return self.rotations, self.translations

    @property
    def proved(self) -> bool:
        """True if the whole trajectory is proved; else the time limit was reached before the proof was finished."""
        return self.proof.holds

    @property
    def quality(self) -> float:
        """Bound of how good the path is, at best 1: the straight line between the joint values at its ends, over its
        length, both in units of the joints' scales. No motion between them is shorter: even the shortest has at least
        this share of the length."""
        space = joint_space(self.robot).holding(*self.translations)
        rows = zip(self.rotations, self.translations, strict=True)
        q = np.array([space.join(*row) for row in rows]) / space.scale
        length = float(np.linalg.norm(np.diff(q, axis=0), axis=1).sum())
        return float(np.linalg.norm(q[-1] - q[0])) / length if length > 0 else 1.0

    @property
    def status(self) -> str:
        """Whether the trajectory is proved, as a sentence."""
        return "proved" if self.proved else "; ".join(self.proof.faults)

    def save(self, path: str | PathLike[str]) -> None:
        """Write the joint values over time as CSV, with units in the header; `tubeopt verify` reads it."""
        lazy_import("tubeopt.planning.file.save_trajectory")(self, path)
