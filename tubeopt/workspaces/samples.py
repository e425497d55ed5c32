"""Joint values drawn within a robot's limits, in blocks: always the same ones, however far a run has come."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy

from ..errors import InputError, choice, whole
from ..inverse.joints import JointSpace, joint_space
from ..robots.assembly import ROUND_OFF
from ..robots.robot import Robot
from ..typing import Array

METHODS = ("sobol", "random", "grid")

BLOCK = 4096
"""Points drawn at once; a power of two, as Sobol points come."""

TURN = 2 * np.pi


@dataclass(frozen=True, eq=False)
class Box:
    """A box y in [low, high] of m coordinates that holds all admissible joint values q = back y."""

    low: Array
    high: Array
    back: Array
    periodic: np.ndarray
    """(m,) whether an end of the range is the same joint value as the other one."""

    @property
    def free(self) -> np.ndarray:
        """(k,) coordinates whose range has a width."""
        return np.flatnonzero(self.high - self.low > ROUND_OFF)


@dataclass(frozen=True, eq=False)
class JointSamples:
    """Admissible joint values of a robot; see `workspace` for the methods.

    Raises:
        InputError: unknown method, no samples, a seed that is none, limits that leave no joint values.
    """

    robot: Robot
    method: str
    count: int
    seed: int

    def __post_init__(self) -> None:
        choice("method", self.method, METHODS)
        for name, value, least in (("samples", self.count, 1), ("seed", self.seed, 0)):
            whole(name, value, least)

    def blocks(self) -> Iterator[tuple[Array, Array]]:
        """Rotations and translations (B, n) of all samples, in their order."""
        space = joint_space(self.robot)
        box, n = _box(space), self.robot.n_tubes
        left, barren = self.count, 0
        for unit in self._units(box):
            y = np.tile(box.low, (len(unit), 1))
            y[:, box.free] += unit * (box.high - box.low)[box.free]
            q = np.clip(y @ box.back.T, space.lower, space.upper)
            q = q[(np.abs(q - y @ box.back.T) <= 1e-9 * space.scale).all(1)]
            q = q[space.ordered(q)]
            barren = 0 if len(q) else barren + 1
            if barren > 256:
                raise InputError("no random joint values within the limits satisfy the tube order")
            joint = (q @ space.spread.T + space.offset)[:left]
            left -= len(joint)
            if len(joint):
                yield joint[:, :n], joint[:, n:]
            if not left:
                return

    def _units(self, box: Box) -> Iterator[Array]:
        """Blocks of points of the unit cube, endless but for a grid."""
        m = len(box.free)
        if self.method == "grid":
            yield from _grid(box, self.count)
            return
        random = np.random.default_rng(self.seed)
        sobol = scipy.stats.qmc.Sobol(m, rng=random) if self.method == "sobol" and m else None
        while True:
            yield np.asarray(random.random((BLOCK, m)) if sobol is None else sobol.random(BLOCK))


def _grid(box: Box, count: int) -> Iterator[Array]:
    """As many points per axis as fit into `count`, ends included, of a whole turn only one."""
    free = box.free
    each = 1
    while free.size and (each + 1) ** len(free) <= count:
        each += 1
    axes = [np.arange(each) / each if box.periodic[k] else np.linspace(0, 1, each) for k in free]
    if each == 1:
        axes = [np.array([0.5])] * len(free)
    total = each ** len(free)
    for first in range(0, total, BLOCK):
        places = np.unravel_index(np.arange(first, min(first + BLOCK, total)), (each,) * len(free)) if len(free) else ()
        rows = [axis[place] for axis, place in zip(axes, places, strict=True)]
        yield np.column_stack(rows) if rows else np.zeros((1, 0))


def _box(space: JointSpace) -> Box:
    """The tightest of two boxes: of the joints themselves, and of the distances between carriages.

    Where the lengths alone set the limits, the second holds admissible values and no others.
    """
    n, m = space.robot.n_tubes, len(space.lower)
    gaps = np.eye(m)
    for k in range(n, m - 1):
        gaps[k, k + 1] = -1.0
    boxes = []
    for forward in (np.eye(m), gaps):
        low, high = _bounds(space, forward)
        boxes.append(Box(low, high, np.asarray(np.linalg.inv(forward), dtype=float), np.zeros(m, dtype=bool)))
    best = min(boxes, key=lambda box: (len(box.free), float(np.prod((box.high - box.low)[box.free]))))
    low, high = best.low.copy(), best.high.copy()
    whole = np.arange(m) < n
    whole &= high - low >= TURN - 1e-9
    # Whole turns repeat the shape: one of them, around home where that is allowed.
    middle = np.clip(0.0, low + TURN / 2, high - TURN / 2)
    low, high = np.where(whole, middle - TURN / 2, low), np.where(whole, middle + TURN / 2, high)
    return Box(low, high, best.back, whole)


def _bounds(space: JointSpace, forward: Array) -> tuple[Array, Array]:
    """Least and greatest value of each of forward q over all admissible q."""
    bounds = list(zip(space.lower.tolist(), space.upper.tolist(), strict=True))
    rows = {"A_ub": -space.rows, "b_ub": -space.least} if len(space.least) else {}
    low, high = (
        np.array([sign * scipy.optimize.linprog(sign * row, bounds=bounds, **rows).fun for row in forward])
        for sign in (1.0, -1.0)
    )
    return low, np.maximum(low, high)
