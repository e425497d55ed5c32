"""Part of a workspace that is lost to snapping: positions with unstable equilibria only."""

from __future__ import annotations

import threading
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Annotated, Any

import numpy as np
import scipy

from ..arguments import typed
from ..block.transcription.buffered import Buffered
from ..block.transcription.explicit import Kind, explicit_arm, explicit_kind, explicit_parameters
from ..display import Displayed
from ..errors import InputError, positive
from ..files.field_metadata import form, key
from ..robots.limits import JointLimits
from ..robots.robot import Robot
from ..solvers.time_limit import LONG_TIME_LIMIT, check_time, limited
from ..typing import Array, Mask, Progress
from .sampling import JointSamples, Workspace, has_margin
from .voxels import Keys, Store, default_size, size_for

# Fewer prove little, since many voxels have both kinds: if half were stable, five would all be unstable in 1 of 32.
SURE = 5
"""Smallest number of unstable equilibria in a lost voxel without a stable one."""

CONFIDENCE = 0.95
"""Confidence of the interval of the lost fraction."""

STEPS_PER_SECTION = 6
"""Integration steps per section of the arm: errors of tips are about 1e-6 of the length."""

CHUNK = 256
"""Number of arms in one call of the integrator."""


@dataclass(frozen=True, eq=False)
class SnappingLoss(Displayed):
    """Voxels with a stable equilibrium, and voxels lost to snapping."""

    robot: Robot
    """Robot of the workspace."""
    size: float
    """Edge of the voxels, m."""
    equilibria: Annotated[
        int, form(".6g", label="equilibria, stable or not"), "number of equilibria found, stable or not"
    ]
    unstable: Annotated[int, form(".6g", label="unstable equilibria"), "number of unstable equilibria"]
    held: Keys
    """(V, 3) indices of voxels with a stable equilibrium."""
    lost: Keys
    """(W, 3) indices of voxels with at least `SURE` equilibria, all of them unstable."""
    early_loss: Annotated[
        float,
        key("lost_first_half_cm3"),
        form(".6g", label="lost volume from the first half of the samples"),
        "volume that only unstable equilibria reach, from the first half of the samples",
    ]
    interval: tuple[float, float]
    """95 % confidence interval of the fraction of all equilibria in lost voxels (Clopper and Pearson 1934). Its upper
    end includes voxels with fewer than `SURE` unstable equilibria and no stable one."""

    @property
    def held_volume(self) -> float:
        """Volume of the voxels with a stable equilibrium, m^3."""
        return len(self.held) * self.size**3

    @property
    def lost_volume(self) -> float:
        """Volume of the lost voxels, m^3."""
        return len(self.lost) * self.size**3

    @property
    def fraction(self) -> float:
        """Fraction of all these voxels that is lost."""
        return len(self.lost) / max(len(self.held) + len(self.lost), 1)


@typed
@limited
def snapping_loss(
    robot: Robot,
    samples: int = 50_000,
    *,
    size: float | None = None,
    seed: int = 0,
    reached: Workspace | None = None,
    progress: Progress | None = None,
    time_limit: float = LONG_TIME_LIMIT,
) -> SnappingLoss:
    """Part of the workspace that is lost because only unstable equilibria reach it.

    A model without stability overestimates the workspace: some of its equilibria are unstable, and the robot never
    remains there. This function computes equilibria of all kinds, from tip rotations over a whole turn and the
    translations within the robot's limits. It sorts their tips into voxels. A voxel with unstable equilibria only is
    lost. One with a stable equilibrium is not, even if every path to it has a snap; use `follow` and
    `stability_map` for paths.

    Args:
        samples: number of equilibria.   size: edge of the voxels, m; by default as in `voxels`.   seed: seed of the
            samples.
        reached: a workspace of the same robot; its stable tips count as well.
        progress: called with the samples done and their number.
        time_limit: maximum run time, s.

    Raises:
        InputError: tubes off the centreline (their equilibria cannot be listed by tip rotations), or a workspace of
            another robot. A size that is not positive, or limits of rotations that leave no equilibrium.
        TimeLimitError: (a SolveError) the time limit was reached before there was an answer.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/two_tube.yaml")
        >>> 0 <= tubeopt.snapping_loss(robot, 500).fraction < 1
        True
    """
    require_centred(robot)
    if reached is not None and reached.robot != robot:
        raise InputError("reached is a workspace of another robot")
    drawn = JointSamples(_free_to_turn(robot), "sobol", samples, seed)
    edge = None if size is None else positive("size", size)
    stable, unstable = _sort(robot, drawn, edge, reached, progress)
    counts = int(stable.count.sum()), int(unstable.count.sum())
    if reached is not None:
        for _, rows in reached.chunks():
            _add(stable, rows[has_margin(rows, 0.0)], np.ones(1, dtype=bool))
    return _loss(robot, stable, unstable, counts)


def require_centred(robot: Robot) -> None:
    """Raise InputError for tubes off the centreline."""
    if not robot.fixed_sections or robot.assembly(robot.home_translations).eccentric:
        raise InputError("the loss to snapping is supported for concentric robots only")


def _sort(
    robot: Robot, drawn: JointSamples, edge: float | None, reached: Workspace | None, progress: Progress | None
) -> tuple[Store, Store]:
    """Voxels reached by stable equilibria, and voxels reached by unstable ones."""
    stores: tuple[Store, Store] | None = None
    done = 0
    # Evenly distributed tip rotations: every equilibrium, stable or not, is one point of these.
    for tips, shift in drawn.blocks():
        check_time()
        equilibria = from_tips(robot, tips, shift)
        # In the column of the margin only the sign is used.
        sign = np.where(equilibria.stable, 1.0, -1.0)
        table = np.column_stack([equilibria.tip_position, equilibria.tip_direction, sign])
        table = table[_within_limits(robot, equilibria.rotations)]
        if stores is None and len(table):
            if edge is None and reached is None:
                # Extent of the first block, scaled to the number of all samples.
                edge = size_for(np.ptp(table[:, :3], axis=0), len(table) * max(1, drawn.count // len(table)))
            elif edge is None and reached is not None:
                edge = default_size(reached)
            assert edge is not None
            stores = Store(edge), Store(edge)
        early = np.arange(done, done + len(table)) < drawn.count // 2
        for store, rows in zip(stores or (), (table[:, -1] > 0, table[:, -1] < 0), strict=False):
            _add(store, table[rows], early[rows])
        done += len(tips)
        if progress is not None:
            progress(done, drawn.count)
    if stores is None:
        raise InputError("no sampled equilibrium is within the rotation limits")
    return stores


def _add(store: Store, table: Array, early: Mask) -> None:
    # Columns from the end, for tables with and without joint values: tip, direction, margin.
    store.add(table[:, -7:-4], table[:, -4:-1], table[:, -1], np.broadcast_to(early, len(table)))


def _loss(robot: Robot, stable: Store, unstable: Store, counts: tuple[int, int]) -> SnappingLoss:
    firm, shaky = stable.voxels(), unstable.voxels()
    lost = _lost(stable.keys, unstable.keys, shaky.count)
    # Sobol points are more even than independent ones, for which the interval is exact, so it is not too narrow.
    lower, upper = (int(shaky.count[rows].sum()) for rows in (lost, ~np.isin(unstable.keys, stable.keys)))
    low, high = (scipy.stats.binomtest(count, sum(counts)).proportion_ci(CONFIDENCE) for count in (lower, upper))
    return SnappingLoss(
        robot=robot,
        size=stable.size,
        equilibria=sum(counts),
        unstable=counts[1],
        held=firm.index,
        lost=shaky.index[lost],
        early_loss=int(_lost(stable.keys[firm.early > 0], unstable.keys, shaky.early).sum()) * stable.size**3,
        interval=(float(low.low), float(high.high)),
    )


def _lost(firm: Keys, shaky: Keys, count: Keys) -> Mask:
    return np.asarray((count >= SURE) & ~np.isin(shaky, firm))


def _free_to_turn(robot: Robot) -> Robot:
    """Robot with rotation limits of half a turn to either side, to sample tip rotations."""
    # Limits are for joints, and samples are tip rotations: joints outside their limits are removed afterwards.
    limits = JointLimits(((-np.pi, np.pi),) * robot.n_tubes, robot.limits.translations)
    changed: Any = robot
    return replace(changed, joint_limits=limits)  # type: ignore[no-any-return]


def _within_limits(robot: Robot, rotations: Array) -> Mask:
    """(B,) True for joint rotations (B, n) that are within the limits, up to full turns."""
    low, high = np.array(robot.limits.rotations).T
    # Smallest equivalent rotation above the lower limit, up to round-off.
    turned = rotations + (2 * np.pi) * np.ceil((low - 1e-9 - rotations) / (2 * np.pi))
    return np.asarray((turned <= high + 1e-9).all(1))


@dataclass(frozen=True, eq=False)
class TipEquilibria:
    """Joint rotations, tip poses and stability of B equilibria."""

    rotations: Array
    """(B, n) joint rotations, rad."""
    tip_position: Array
    """(B, 3) tip positions, m."""
    tip_direction: Array
    """(B, 3) unit vectors of the tip directions."""
    stable: Mask
    """(B,) True for stable equilibria."""


def from_tips(robot: Robot, tips: Array, translations: Array) -> TipEquilibria:
    """Equilibria of a concentric robot from tip rotations (B, n), rad, at translations (B, n), m.

    The torsion of a tube is 0 at its own end, so that the tip rotations determine the whole arm: an initial-value
    problem from the tip to the base gives joints, pose and stability (`stability.shooting` searches those of given
    joints). Stability is a sign test: the determinant of the derivative of theta(s) by the tip rotations is positive
    down to the plate, and so is that of the joint rotations.
    """
    count = len(tips)
    parts: list[list[Array]] = [[], [], [], []]
    march = _march(explicit_kind(robot, steps=STEPS_PER_SECTION), threading.get_ident())
    known = explicit_parameters(robot)
    for first in range(0, count, CHUNK):
        size = min(CHUNK, count - first)
        # The function is mapped over CHUNK arms: the last call repeats the last row.
        rows = np.minimum(np.arange(first, first + CHUNK), count - 1)
        rotations, fields, points, tangents, _ = march(tips[rows], translations[rows], 0.0, known)
        reached, ahead = (part.reshape(CHUNK, -1, 3)[:size, -1].copy() for part in (points, tangents))
        for part, value in zip(parts, (rotations[:size].copy(), reached, ahead, fields[:size].min(1)), strict=True):
            part.append(value)
    rotations, reached, ahead, smallest = (np.concatenate(part) for part in parts)
    return TipEquilibria(rotations, reached, ahead, smallest > 0)


@lru_cache(maxsize=16)
def _march(kind: Kind, thread: int) -> Buffered:
    return Buffered(explicit_arm(kind).map(CHUNK))
