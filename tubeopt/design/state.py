"""A design at one vector of unknowns: tubes, poses and certificates, and how their derivatives reach the unknowns."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..block.quantities import PoseNumber, Quantity
from ..equilibrium.linearised import Change, Linearised
from ..robots.breakpoints import DIMENSIONS
from ..robots.tubes import Tube
from ..typing import Array
from .drawn import drawn_back
from .parameters import DesignSpace
from .pieces import change_of, given_of
from .pose import Pose, Twist, solve_pose, twist_at, without_solving

JOINTS = ("rotations", "translations")
"""What every pose is differentiated by first."""


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


class State:
    """Everything at x; equilibria are solved when asked for, near `guesses`, where the next poses close by begin too.
    `known`: quantities that were told of it, with their change.

    Raises, when asked: InputError where the dimensions make no tubes, SolveError where a pose has no equilibrium.
    """

    def __init__(self, layout: Layout, x: Array, guesses: dict[PoseNumber, Twist] | None = None) -> None:
        self.layout = layout
        self.x = x
        self.guesses: dict[PoseNumber, Twist] = {} if guesses is None else guesses
        self.known: dict[Quantity, tuple[Array, Array]] = {}
        self._poses: dict[PoseNumber, Pose] = {}
        self._moved: dict[PoseNumber, tuple[Array, Array]] = {}
        self._chains: dict[PoseNumber, Array] = {}

    @cached_property
    def tubes(self) -> tuple[Tube, ...]:
        """The tubes."""
        return self.layout.space.tubes(self.x[: self.layout.designs])

    @cached_property
    def slopes(self) -> dict[str, Array]:
        """(n, X) change of every dimension and stiffness."""
        space, x = self.layout.space, self.x[: self.layout.designs]
        designs = space.slopes(x)
        if space.pieced:
            designs["curvature"] = space.bend_slopes(self.tubes, x)
        return {name: np.pad(part, ((0, 0), (0, self.layout.size - part.shape[1]))) for name, part in designs.items()}

    def joint_values(self, index: PoseNumber) -> tuple[Array, Array]:
        """Rotations and translations (n,) of a pose."""
        (rotations, _), (translations, _) = self._joints(index)
        return rotations, translations

    def joint_slopes(self, index: PoseNumber) -> tuple[Array, Array]:
        """(n, X) change of the rotations and of the translations of a pose."""
        (_, turned), (_, shifted) = self._joints(index)
        return turned, shifted

    def _joints(self, index: PoseNumber) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        """Both of the rotations, and of the translations."""
        if isinstance(index, tuple):
            number, share = index
            turned, (shift, moved) = self._joints(number)
            drawn, back, last = drawn_back(self.tubes, shift, share)
            ended = moved + self.slopes["curved_length"]
            return turned, (drawn, moved - back[:, None] * (ended - share * ended[last]))
        pose = self.layout.poses[index]
        if isinstance(pose, Via):
            t, first, second = pose.fraction, self._joints(pose.first), self._joints(pose.second)
            rotations, translations = (
                ((1 - t) * one[0] + t * other[0], (1 - t) * one[1] + t * other[1])
                for one, other in zip(first, second, strict=True)
            )
            return rotations, translations
        if isinstance(pose, FixedPose):
            still = np.zeros((self.layout.n, self.layout.size))
            return (np.array(pose.rotations), still), (np.array(pose.translations), still)
        (alpha, beta), unit = self.layout.joints(pose), np.eye(self.layout.size)
        straight = np.array([tube.straight_length for tube in self.tubes])
        return (self.x[alpha], unit[alpha]), (self.x[beta] + straight, unit[beta] + self.slopes["straight_length"])

    def pose(self, index: PoseNumber) -> Pose:
        """The equilibrium of a pose."""
        if index not in self._poses:
            solved = solve_pose(self.tubes, *self.joint_values(index), self.guesses.get(index))
            self.guesses[index] = twist_at(solved)
            directions, self._chains[index] = moving(np.concatenate([*self.joint_slopes(index), self._reshaped]))
            self._poses[index] = Pose(solved, (*JOINTS, *self.resized), self.piece_changes, directions)
        return self._poses[index]

    @cached_property
    def resized(self) -> dict[str, Array]:
        """(n, X) change of the DIMENSIONS that some unknown of whole tubes moves."""
        names = [name for name in DIMENSIONS if name != "curvature" or not self.layout.space.pieced]
        return {name: self.slopes[name] for name in names if self.slopes[name].any()}

    @cached_property
    def free_pieces(self) -> list[int]:
        """Columns of the unknowns of pieces."""
        return [column for column, one in enumerate(self.layout.space.unknowns) if one.pieces]

    def piece_changes(self, here: Linearised) -> list[Change]:
        """What every unknown of pieces changes along a solved arm."""
        unknowns = self.layout.space.unknowns
        given = given_of(unknowns, self.x[: self.layout.designs].tolist())
        return [change_of(here, unknowns[column], given) for column in self.free_pieces]

    @cached_property
    def _reshaped(self) -> Array:
        """(L - 2 n, X) change of what a pose is differentiated by beside its joint values."""
        return np.concatenate([*self.resized.values(), np.eye(self.layout.size)[self.free_pieces]])

    def chain(self, index: PoseNumber) -> Array:
        """(Q, X) 1 where a direction in which a pose is differentiated is that of an unknown."""
        self.pose(index)
        return self._chains[index]

    def jacobian(self, index: PoseNumber, *, turning: bool = False) -> tuple[Array, Array]:
        """(6 n,) change of the tip's place with the joint values of a pose, joint by joint, or of its frame (turn
        vector), and by how much that changes (6 n, X): the central difference of exact derivatives."""
        if index not in self._moved:
            self._moved[index] = self._tip_moves(index)
        half = np.split(np.arange(12 * self.layout.n), 2)[int(turning)]
        return self._moved[index][0][half], self._moved[index][1][half]

    def _tip_moves(self, index: PoseNumber) -> tuple[Array, Array]:
        """(12 n,) change of the tip's place, then of its frame, and by how much that changes (12 n, X)."""

        def here(state: State) -> Array:
            of = state.pose(index).by_joints
            return np.concatenate([each.ravel(order="F") for each in (of.tip_position, of.tip_rotation)])

        size = np.ones(self.layout.size)
        size[: self.layout.designs] = self.layout.space.scale
        for pose in self.layout.poses:
            if isinstance(pose, FreePose):
                size[self.layout.joints(pose)[1]] = 0.1  # m
        change = np.zeros((12 * self.layout.n, self.layout.size))
        for column in np.flatnonzero(self.chain(index).any(0)).tolist():
            step = np.eye(self.layout.size)[column] * 1e-4 * size[column]
            ends = (here(State(self.layout, x, dict(self.guesses))) for x in (self.x + step, self.x - step))
            change[:, column] = -np.diff(np.stack(list(ends)), axis=0)[0] / (2 * step[column])
        return here(self), change

    def certificate_at(self, translations: tuple[float, ...]) -> tuple[float, Array]:
        """mu_cert at translations (n,), m, and its change (X,)."""
        solved = without_solving(self.tubes, np.array(translations))
        directions, chain = moving(self._reshaped)
        value, slope = Pose(solved, [*self.resized], self.piece_changes, directions).certificate
        return value, slope @ chain


def moving(rows: Array) -> tuple[Array, Array]:
    """(L, Q) the directions of rows (L, X) in which anything changes, and (Q, X) the unknowns of these: derivatives
    along them, times the second, are those by all unknowns."""
    columns = np.flatnonzero(rows.any(0))
    return rows[:, columns], np.eye(rows.shape[1])[columns]
