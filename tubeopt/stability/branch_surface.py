"""The sheet of stable equilibria around the relaxed pose, and the folds that bound it: where a robot can snap.

Tip angles name equilibria (see `stability.shooting`). Those that a robot reaches from its relaxed pose without a snap
are the connected set of stable ones around that pose, and where the set ends, at a fold, the robot snaps. Relative to
the pose F(tau) - tau has the period of a turn in each relative tip angle, so that F and the sign of det F', negative
beyond a fold, are computed on a grid over one turn and known on all turns around.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from ..block.transcription.reduced import ReducedProblem
from ..typing import Array, Index, Mask
from .settings import SnapSearch
from .shooting import relative, relative_joints

TURN = 2 * np.pi


@dataclass(frozen=True, eq=False)
class Sheet:
    """A grid over turns of the d relative tip angles around the relaxed pose.

    joints (M..., d): relative joint rotations, rad, from the relaxed pose.  determinant (M...): of F', 0 or less where
    the equilibrium is unstable.  centre: place of the relaxed pose.
    """

    joints: Array
    determinant: Array
    centre: tuple[int, ...]


def stable_sheet(problem: ReducedProblem, coupled: Index, start: Array, unstable: Array, effort: SnapSearch) -> Sheet:
    """The grid around relaxed rotations `start` (n,), in which the tip angles `unstable` (B, n), each an unstable
    equilibrium, take the place of the nodes next to them: so an unstable region smaller than a cell is not missed."""
    d = len(coupled) - 1
    size = effort.sheet_grid[min(d, len(effort.sheet_grid)) - 1]
    shape, origin = (size,) * d, relative(start[None], coupled)
    axis = np.arange(size) * TURN / size
    tips = np.stack(np.meshgrid(*[axis] * d, indexing="ij"), axis=-1).reshape(-1, d)
    seeds = relative(unstable, coupled) - origin
    seeds -= TURN * np.floor(seeds / TURN + 0.5 / size)
    places = np.ravel_multi_index(tuple(np.round(seeds * size / TURN).astype(int).T), shape)
    tips[places] = seeds
    angles = np.tile(start, (len(tips), 1))
    angles[:, coupled[:-1]] += tips
    joints, slope = relative_joints(problem, coupled, angles)
    determinant = np.linalg.det(slope)
    determinant[places] = np.minimum(determinant[places], 0.0)
    turns = min(effort.sheet_turns, int(((effort.sheet_nodes / len(tips)) ** (1 / d) - 1) / 2))
    whole = (2 * turns + 1,) * d
    offset = np.stack(np.meshgrid(*[np.repeat(np.arange(-turns, turns + 1), size)] * d, indexing="ij"), axis=-1)
    return Sheet(
        np.tile((joints - origin).reshape(*shape, d), (*whole, 1)) + TURN * offset,
        np.tile(determinant.reshape(shape), whole),
        (turns * size,) * d,
    )


def folds(sheet: Sheet, allowed: Callable[[Array], Mask], effort: SnapSearch) -> Array:
    """(E, d) about the relative joint rotations of folds at which the sheet ends, from the relaxed pose.

    The nearest come first, each in a direction of its own. `allowed`, (..., d) -> (...), admits the joint rotations of
    the fold and of a way to it on the sheet.
    """
    free = (sheet.determinant > 0) & allowed(sheet.joints)
    if not free[sheet.centre]:
        return np.empty((0, sheet.joints.shape[-1]))
    labels = scipy.ndimage.label(free)[0]
    found = _ends(sheet, labels == labels[sheet.centre])
    found = found[allowed(found)]
    size = np.abs(found).max(1, initial=0.0)
    chosen: list[int] = []
    for k in np.argsort(size, kind="stable"):
        apart = np.abs(found[k] / size[k] - found[chosen] / size[chosen][:, None]).max(1)
        if (apart > effort.sheet_apart).all():
            chosen.append(int(k))
        if len(chosen) == effort.folds:
            break
    return np.asarray(found[chosen])


def _ends(sheet: Sheet, reached: Mask) -> Array:
    """(E, d) joint rotations about where F' turns singular between nodes that are reached and unstable ones beside."""
    out = []
    for axis, size in enumerate(reached.shape):
        sides = [np.arange(size - 1), np.arange(1, size)]
        for here, there in (sides, sides[::-1]):
            high, low = (np.take(sheet.determinant, side, axis) for side in (here, there))
            edge = np.take(reached, here, axis) & (low <= 0)
            first, second = (np.take(sheet.joints, side, axis)[edge] for side in (here, there))
            share = (high[edge] / (high[edge] - low[edge]))[:, None]
            out.append(first + share * (second - first))
    return np.concatenate(out)
