"""Which rows may not be told apart: places that a way passes again, blocks held out whole, and passes compared.

Neighbouring rows of a way share their errors, and so do rows of another pass through the same joint values: whoever
holds out one and keeps the other measures how well the data were memorised. So rows are sorted by the place at which
the way first came by, and held out in blocks of places.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
import scipy

from ..files.field_metadata import unit
from ..typing import Array, Index
from .measurements import Measurements
from .timeline import runs_of

STILL = 2e-4
"""rad: joint values that are nearer than this are the same."""


@dataclass(frozen=True, eq=False)
class Passes:
    """Rows of a way, and the places that they are at."""

    place: Index
    """(N,) the row that first came by, its own index where the way was new."""
    pairs: Index
    """(M, 2) rows at one place that were passed in opposite directions, a row in at most one pair."""


def passes(measurements: Measurements) -> Passes:
    """Where a way retraces itself; rows without times are places of their own unless their joint values are equal."""
    m = measurements
    joints = np.hstack([m.rotations, 20.0 * m.translations])  # rad per m: an arm bends by about as much on its length
    count = len(joints)
    if m.time is None:
        return Passes(_equal(joints), np.zeros((0, 2), dtype=int))
    ahead, behind, travelled = _motion(joints, m.time)
    step = np.maximum(np.linalg.norm(ahead, axis=1), np.linalg.norm(behind, axis=1))
    # Half a step is the most by which samples of two passes along one line can miss each other.
    reach = np.maximum(0.75 * step, STILL)
    tree = scipy.spatial.cKDTree(joints)
    place, pairs, paired = np.arange(count), [], np.zeros(count, dtype=bool)
    for k, near in enumerate(tree.query_ball_point(joints, reach)):
        others = np.array([j for j in near if j < k], dtype=int)
        # Rows just before are near because little time has passed, unless the way turned back in between.
        others = others[travelled[k] - travelled[others] > 2 * reach[k]]
        if not len(others):
            continue
        distance = np.linalg.norm(joints[others] - joints[k], axis=1)
        place[k] = place[others[np.argmin(distance)]]
        against = (ahead[others] + behind[others]) @ (ahead[k] + behind[k]) < 0
        opposite = others[against & ~paired[others]]
        if len(opposite):
            j = int(opposite[np.argmin(distance[against & ~paired[others]])])
            pairs.append((j, k))
            paired[[j, k]] = True
    return Passes(place, np.array(pairs, dtype=int).reshape(-1, 2))


def _motion(joints: Array, time: Array) -> tuple[Array, Array, Array]:
    """(N, c) steps to the next and from the last row of a run, and the distance travelled (N,), runs far apart."""
    ahead, behind, travelled = np.zeros_like(joints), np.zeros_like(joints), np.zeros(len(joints))
    far = 0.0
    for rows in runs_of(time):
        move = np.diff(joints[rows], axis=0)
        ahead[rows[:-1]], behind[rows[1:]] = move, move
        travelled[rows] = far + np.append(0.0, np.cumsum(np.linalg.norm(move, axis=1)))
        far = travelled[rows[-1]] + 1e3
    return ahead, behind, travelled


def _equal(joints: Array) -> Index:
    """The first row with equal joint values, for every row."""
    _, first, inverse = np.unique(np.round(joints / STILL), axis=0, return_index=True, return_inverse=True)
    return np.asarray(first[inverse.ravel()])


def deal(measurements: Measurements, folds: int, place: Index | None = None) -> Index:
    """(N,) the fold of each row: blocks of a way by places, or places in a fixed, shuffled order where there is no way.

    All rows at one place are in one fold. There are fewer folds than asked for where there are fewer places.
    """
    where = passes(measurements).place if place is None else place
    distinct, inverse, counts = np.unique(where, return_inverse=True, return_counts=True)
    if measurements.time is None:
        fold = np.empty(len(distinct), dtype=int)
        fold[np.random.default_rng(0).permutation(len(distinct))] = np.arange(len(distinct)) % folds
        return np.asarray(fold[inverse])
    middle = np.cumsum(counts) - counts / 2  # of the rows, in the order of places
    return np.asarray(np.minimum((middle * folds / counts.sum()).astype(int), folds - 1)[inverse])


@dataclass(frozen=True)
class Parity:
    """Residuals of places that were passed both ways, root mean squares, m; noise is in all alike."""

    pairs: Annotated[int, "places that were passed in both directions"]
    history: Annotated[float, unit("mm"), "RMS of half the difference of the errors in both directions"]
    """From effects of the direction: latency, friction, backlash."""
    static: Annotated[float, unit("mm"), "RMS of half the sum of the errors in both directions"]
    measured: Annotated[float, unit("mm"), "RMS of half the difference of the measured tips in both directions"]
    """Without any model."""


def parity(pairs: Index, residuals: Array, measured: Array) -> Parity | None:
    """The split of residuals (N, 3) and measured tips (N, 3), m, NaN where not seen; None with fewer than 10 pairs."""
    there, back = residuals[pairs[:, 0]], residuals[pairs[:, 1]]
    good = np.isfinite(there).all(1) & np.isfinite(back).all(1)
    if good.sum() < 10:
        return None
    apart = measured[pairs[good, 0]] - measured[pairs[good, 1]]
    history, static, seen = (_rms(x[good] if len(x) > len(apart) else x) for x in (there - back, there + back, apart))
    return Parity(int(good.sum()), history, static, seen)


def _rms(twice: Array) -> float:
    """Root mean square of half the vectors (M, 3)."""
    return float(np.sqrt((twice**2).sum(1).mean()) / 2)
