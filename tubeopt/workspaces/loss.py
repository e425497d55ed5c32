"""What a workspace loses to snapping: places where the robot is in equilibrium, but never in a stable one."""

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
from .sampling import JointSamples, Workspace, held
from .voxels import Keys, Store, default_size, size_for

# One unstable equilibrium says little, since many voxels have both kinds.
SURE = 5
"""Unstable equilibria in a voxel without a stable one that make it lost: where half were stable, 1 in 32 would lie."""

CONFIDENCE = 0.95
"""Of the interval of a loss."""

STEPS = 6
"""Steps per section of the arm: tips to about 1e-6 of the length."""

CHUNK = 256
"""Arms integrated at once."""


@dataclass(frozen=True, eq=False)
class SnappingLoss(Displayed):
    """Voxels by what reaches them."""

    robot: Robot
    """The robot."""
    size: float
    """Edge of the voxels, m."""
    equilibria: Annotated[
        int, form(".6g", label="equilibria of all kinds that were found"), "number of equilibria found, stable or not"
    ]
    unstable: Annotated[int, form(".6g", label="those of them that are unstable"), "number of unstable equilibria"]
    held: Keys
    """(V, 3) index of the voxels with a stable equilibrium."""
    lost: Keys
    """(W, 3) of those with at least `SURE` equilibria, all of them unstable."""
    early_loss: Annotated[
        float,
        key("lost_first_half_cm3"),
        form(".6g", label="the same from the first half of the samples"),
        "volume that only unstable equilibria reach, from the first half of the samples",
    ]
    interval: tuple[float, float]
    """95 % confidence interval of the fraction of all equilibria that lie where no stable one is (Clopper and Pearson
    1934). Its upper end counts voxels with fewer than `SURE` unstable equilibria and no stable one as lost."""

    @property
    def held_volume(self) -> float:
        """Volume of the voxels that are held, m^3."""
        return len(self.held) * self.size**3

    @property
    def lost_volume(self) -> float:
        """Volume of the voxels that are lost, m^3."""
        return len(self.lost) * self.size**3

    @property
    def fraction(self) -> float:
        """Share of all these voxels that is lost."""
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
    """The part of the workspace that is lost because only unstable equilibria reach it.

    A model without stability overestimates the workspace: some of its equilibria are unstable, and the robot never
    stays there. This function computes equilibria of all kinds, from tip rotations over a whole turn and the
    translations within the robot's limits. It sorts their tips into voxels. A voxel with unstable equilibria only is
    lost. One with a stable equilibrium is not, even if every path there leads through a snap; use `follow` and
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
    stable, unstable = _sorted(robot, drawn, edge, reached, progress)
    counts = int(stable.count.sum()), int(unstable.count.sum())
    if reached is not None:
        for _, rows in reached.chunks():
            _add(stable, rows[held(rows, 0.0)], np.ones(1, dtype=bool))
    return _loss(robot, stable, unstable, counts)


def require_centred(robot: Robot) -> None:
    """Raise InputError for tubes off the centreline."""
    if robot.assembly(robot.home_translations).eccentric:
        raise InputError("the loss to snapping is supported for concentric robots only")


def _sorted(
    robot: Robot, drawn: JointSamples, edge: float | None, reached: Workspace | None, progress: Progress | None
) -> tuple[Store, Store]:
    """Voxels of the stable and of the unstable equilibria."""
    stores: tuple[Store, Store] | None = None
    done = 0
    # Even in tip rotations, in which every equilibrium, stable or not, is one point.
    for tips, shift in drawn.blocks():
        check_time()
        found = from_tips(robot, tips, shift)
        # In the column of the margin, of which only the sign is needed.
        sign = np.where(found.stable, 1.0, -1.0)
        table = np.column_stack([found.tip_position, found.tip_direction, sign])
        table = table[_within_limits(robot, found.rotations)]
        if stores is None and len(table):
            edge = edge or (_edge(table, drawn.count) if reached is None else default_size(reached))
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
    # Columns from the end, so that tables with and without joint values serve: tip, direction, margin.
    store.add(table[:, -7:-4], table[:, -4:-1], table[:, -1], np.broadcast_to(early, len(table)))


def _loss(robot: Robot, stable: Store, unstable: Store, counts: tuple[int, int]) -> SnappingLoss:
    firm, shaky = stable.voxels(), unstable.voxels()
    lost = _lost(stable.keys, unstable.keys, shaky.count)
    # Sobol points are more even than independent ones, for which the interval is exact: it is not too narrow.
    least, most = (int(shaky.count[rows].sum()) for rows in (lost, ~np.isin(unstable.keys, stable.keys)))
    low, high = (scipy.stats.binomtest(count, sum(counts)).proportion_ci(CONFIDENCE) for count in (least, most))
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
    """The robot whose tubes may turn by half a turn either way: for tip rotations."""
    # Limits are of joints, and samples are tip rotations: joints outside their limits are left out afterwards.
    limits = JointLimits(((-np.pi, np.pi),) * robot.n_tubes, robot.limits.translations)
    changed: Any = robot
    return replace(changed, joint_limits=limits)  # type: ignore[no-any-return]


def _within_limits(robot: Robot, rotations: Array) -> Mask:
    """(B,) whether joint rotations, give or take whole turns, are within the limits."""
    low, high = np.array(robot.limits.rotations).T
    # The least value above the lower limit, up to round-off, that is the same but for whole turns.
    turned = rotations + (2 * np.pi) * np.ceil((low - 1e-9 - rotations) / (2 * np.pi))
    return np.asarray((turned <= high + 1e-9).all(1))


def _edge(table: Array, samples: int) -> float:
    """The default edge of the voxels, for so many samples as these."""
    return size_for(np.ptp(table[:, :3], axis=0), len(table) * max(1, samples // len(table)))


@dataclass(frozen=True, eq=False)
class Equilibria:
    """B equilibria."""

    rotations: Array
    """(B, n) of the joints, rad."""
    tip_position: Array
    """(B, 3) m."""
    tip_direction: Array
    """(B, 3) unit vectors."""
    stable: Mask
    """(B,)."""


def from_tips(robot: Robot, tips: Array, translations: Array) -> Equilibria:
    """Equilibria of tip rotations (B, n), rad, at translations (B, n), m, of a robot with tubes on the centreline.

    The torsion of a tube is 0 at its own end, so that the tip rotations fix the whole arm: an initial-value problem
    from the tip to the base tells joints, pose and stability (`stability.shooting` searches those of given joints).
    Stable is what the sign test says: the determinant of the derivative of theta(s) by the tip rotations stays positive
    down to the plate, and so does that of the joint rotations.
    """
    count = len(tips)
    parts: list[list[Array]] = [[], [], [], []]
    march = _march(explicit_kind(robot, steps=STEPS), threading.get_ident())
    known = explicit_parameters(robot)
    for first in range(0, count, CHUNK):
        size = min(CHUNK, count - first)
        # The function is mapped over CHUNK arms: the last call repeats the last row.
        rows = np.minimum(np.arange(first, first + CHUNK), count - 1)
        rotations, fields, points, tangents, _ = march(tips[rows], translations[rows], 0.0, known)
        places, ahead = (part.reshape(CHUNK, -1, 3)[:size, -1].copy() for part in (points, tangents))
        for part, value in zip(parts, (rotations[:size].copy(), places, ahead, fields[:size].min(1)), strict=True):
            part.append(value)
    rotations, places, ahead, least = (np.concatenate(part) for part in parts)
    return Equilibria(rotations, places, ahead, least > 0)


@lru_cache(maxsize=16)
def _march(kind: Kind, thread: int) -> Buffered:
    return Buffered(explicit_arm(kind).map(CHUNK))
