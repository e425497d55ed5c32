"""What the unknowns of a design are: dimensions, joint values of its free poses, auxiliary numbers."""

from __future__ import annotations

from dataclasses import dataclass

from .parameters import DesignSpace


@dataclass(frozen=True)
class FreePose:
    """A task pose whose joint values are unknowns: rotations, then beta of every tube."""

    index: int


@dataclass(frozen=True)
class FixedPose:
    """A task pose with given joint values."""

    rotations: tuple[float, ...]
    translations: tuple[float, ...]


@dataclass(frozen=True)
class Via:
    """The pose at `fraction` of the straight joint path from task pose `first` to task pose `second`."""

    first: int
    second: int
    fraction: float


PoseKind = FreePose | FixedPose | Via


@dataclass(frozen=True, eq=False)
class Layout:
    """What the unknowns x (X,) are: D dimensions, 2 n joint values of each of F free poses, auxiliary numbers."""

    space: DesignSpace
    poses: tuple[PoseKind, ...]
    """Task poses in order, then via points."""
    certified: tuple[tuple[float, ...], ...]
    """(T, n) translations of the certificate, m."""
    auxiliary: tuple[str, ...]

    @property
    def n(self) -> int:
        """Number of tubes."""
        return len(self.space.robot_tubes)

    @property
    def designs(self) -> int:
        """Number of unknown dimensions D."""
        return len(self.space.unknowns)

    @property
    def free_poses(self) -> int:
        """Number of poses whose joint values are unknown."""
        return sum(isinstance(pose, FreePose) for pose in self.poses)

    @property
    def size(self) -> int:
        """Number of unknowns X."""
        return self.designs + 2 * self.n * self.free_poses + len(self.auxiliary)

    def joints(self, pose: FreePose) -> tuple[slice, slice]:
        """Columns of the rotations and of beta of a free pose."""
        first = self.designs + 2 * self.n * pose.index
        return slice(first, first + self.n), slice(first + self.n, first + 2 * self.n)

    def column(self, name: str) -> int:
        """Column of an auxiliary unknown."""
        return self.designs + 2 * self.n * self.free_poses + self.auxiliary.index(name)
