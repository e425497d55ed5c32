"""All tip angles of a group of tubes that lead to given joint rotations.

Newton's method starts wherever a table of the map from tips to joints says a solution may lie. The table is read on
ever finer grids until the set no longer changes and its topological degree, the sum of the signs of
det(d alpha / d theta_tip), is 1, as it must be: alpha - theta_tip is bounded, so that the map deforms into the
identity. For more than three tubes there is no table, and the starts are a Sobol sequence.

There is one table for all joint rotations and transmissions. What the torsion adds on the way from the tips to the
base, theta(0) - theta_tip and t(0), is a periodic, analytic function of the tip angles: its Fourier series converges
geometrically, so that a grid fine enough for the series to end stands for every finer one. On the centreline it is a
function of the angles relative to the last tube's; off it the common angle is one more, in which the function is
smooth, so that few points are enough.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..solvers.sampling import sobol
from ..typing import Array
from .settings import DEFAULT_EQUILIBRIA_SEARCH, EquilibriaSearch
from .shooting import STEPS, Bundle, shoot

TURN = 2 * np.pi

RELATIVE, COMMON = 32, 6
"""Points per turn of the coarsest table: in the angles relative to the last tube's, and in its own."""

MOST_POINTS = 250_000
"""Points beyond which a table is not refined."""

TAIL = 0.05
"""Sum of the Fourier amplitudes (rad) beyond two thirds of those that a table has. They decay geometrically: what the
table lacks is about its power 3/2."""

DOUBT = 2e-3
"""What a table may be off, in turns of a joint."""

TABLE_STEPS = 2
"""Steps of the integration per piece for a table: errors near 1e-4 rad."""


@dataclass(frozen=True, eq=False)
class Table:
    """theta(0) - theta_tip and torque at 0 of k tubes, each (*size, k), over a turn of each angle of a grid: k - 1
    angles relative to the last tube's, and off the centreline the last tube's."""

    size: tuple[int, ...]
    turned: Array
    torque: Array


@lru_cache(maxsize=16)
def table_of(bundle: Bundle, k: int) -> Table:
    """The table of the first k tubes of a bundle, refined until its Fourier series ends."""
    size = (RELATIVE,) * (k - 1) + ((COMMON,) if bundle.place else ())
    while True:
        table = _tabulate(bundle, k, size)
        tails = _tails(table.turned - bundle.transmission[:k] * table.torque)
        finer = tuple(2 * n if tail > TAIL else n for n, tail in zip(size, tails, strict=True))
        if finer == size or np.prod(finer) > MOST_POINTS:
            return table
        size = finer


def _tabulate(bundle: Bundle, k: int, size: tuple[int, ...]) -> Table:
    tips = _tips(np.stack(np.meshgrid(*[np.arange(n) * TURN / n for n in size], indexing="ij"), axis=-1), k)
    shot = shoot(bundle, tips.reshape(-1, k), steps=TABLE_STEPS)
    turned = shot.rotations + bundle.transmission[:k] * shot.torque - tips.reshape(-1, k)
    return Table(size, turned.reshape(*size, k), shot.torque.reshape(*size, k))


def _tips(angles: Array, k: int) -> Array:
    """Tip angles (..., k) of the angles (..., d) of a table."""
    tips = np.zeros((*angles.shape[:-1], k))
    tips[..., :-1] = angles[..., : k - 1]
    return tips + angles[..., k - 1 :] if angles.shape[-1] == k else tips


def _tails(values: Array) -> list[float]:
    """Sum of the Fourier amplitudes of the highest frequencies along each axis but the last, at worst."""
    dimension = values.ndim - 1
    axes = tuple(range(dimension))
    amplitude = np.abs(np.fft.fftn(values, axes=axes)) / np.prod(values.shape[:-1])
    out = []
    for axis in axes:
        n = values.shape[axis]
        high = np.abs(np.fft.fftfreq(n, 1 / n)) > n / 3
        out.append(float(np.compress(high, amplitude, axis=axis).sum(axes).max()))
    return out


def starts(table: Table, transmission: Array, wanted: Array, size: int) -> Array:
    """Tip angles (B, k) in the middle of every cell of a grid that may lead to the wanted joints (k,).

    It has at least `size` points per turn of the relative angles.
    """
    k, dimension = len(wanted), len(table.size)
    values = table.turned - transmission * table.torque
    sizes = tuple(max(2 * n, size if axis < k - 1 else 0) for axis, n in enumerate(table.size))
    for axis, n in enumerate(sizes):
        values = _resampled(values, n, axis)
    angles = np.stack(np.meshgrid(*[np.arange(n) * TURN / n for n in sizes], indexing="ij"), axis=-1)
    gap = _tips(angles, k) + values - wanted
    # Relative to the last tube, then that itself where it counts: continuous along the grid, in turns.
    parts = [(gap[..., i] - gap[..., -1]) / TURN for i in range(k - 1)] + [gap[..., -1] / TURN] * (dimension == k)
    hit = np.logical_and.reduce([_may_be_whole(part, axis) for axis, part in enumerate(parts)])
    chosen = angles[hit] + TURN / 2 / np.array(sizes)
    tips = _tips(chosen, k)
    return tips if dimension == k else tips + wanted[-1]


def _resampled(values: Array, size: int, axis: int) -> Array:
    """Values on a finer grid of a period along an axis, by their Fourier series: as `scipy.signal.resample`, but
    without its package, whose import takes longer than all that is asked of a table."""
    spectrum, old = np.moveaxis(np.fft.rfft(values, axis=axis), axis, 0), values.shape[axis]
    if old % 2 == 0:
        spectrum[old // 2] /= 2  # the highest frequency stands for both of its signs
    return np.asarray(np.fft.irfft(np.moveaxis(spectrum, 0, axis), size, axis=axis) * (size / old))


def _may_be_whole(values: Array, own: int) -> NDArray[np.bool_]:
    """Cells of a grid in which a function (in turns), which grows by one along its `own` axis, may be a whole number.

    Inside a cell it stays between its corners but for what it bends: by twice what its second differences tell.
    """
    low = high = values
    bend = np.zeros_like(values)
    for axis in range(values.ndim):
        ahead = [_next(part, axis, axis == own) for part in (low, high)]
        low, high = np.minimum(low, ahead[0]), np.maximum(high, ahead[1])
        step = _next(values, axis, axis == own) - values
        second = np.abs(step - np.roll(step, 1, axis=axis))
        bend += np.maximum(second, np.roll(second, -1, axis=axis)) / 4
    # Of the corners, that with most bend.
    for axis in range(values.ndim):
        bend = np.maximum(bend, np.roll(bend, -1, axis=axis))
    slack = bend + DOUBT
    return np.asarray(np.floor(high + slack) >= np.ceil(low - slack))


def _next(values: Array, axis: int, own: bool) -> Array:
    """Values one point on along an axis, continued past a turn."""
    out = np.roll(values, -1, axis=axis)
    if own:
        out[(slice(None),) * axis + (-1,)] += 1.0
    return out


@dataclass(frozen=True, eq=False)
class Preimage:
    """Tip angles (S, k) that lead to given joints, the signs (S,) of det(d alpha / d theta_tip) there, and the length
    (S, m) of every tube of the bundle, m; `settled`: whether the search ended because nothing was missing."""

    tips: Array
    sign: Array
    travel: Array
    settled: bool


def preimage(
    bundle: Bundle, transmission: Array, rotations: Array, search: EquilibriaSearch = DEFAULT_EQUILIBRIA_SEARCH
) -> Preimage:
    """Tip angles that lead to joint rotations (k,) of the first k tubes of a bundle, the others being straight, if its
    transmissions were (n,) `transmission`, 1/(N m)."""
    part = replace(bundle, transmission=transmission)
    found = _finish(part, rotations, rotations[None] if len(rotations) == 1 else np.zeros((0, len(rotations))), search)
    if len(rotations) == 1:
        # Nothing turns a single tube.
        return found
    for near in _starts(bundle, transmission, rotations, search):
        before = len(found.tips)
        found = _finish(part, rotations, np.concatenate([found.tips, _approach(part, rotations, near, search)]), search)
        if len(found.tips) == before and found.sign.sum() == 1:
            return found
    return replace(found, settled=False)


def _starts(bundle: Bundle, transmission: Array, wanted: Array, search: EquilibriaSearch) -> Iterator[Array]:
    """Tip angles (B, k) from which to solve, from ever finer grids."""
    k = len(wanted)
    if k <= 3:
        table = table_of(bundle, k)
        for size in (search.grids_of_one, search.grids_of_two, search.grids_of_three)[len(table.size) - 1]:
            yield starts(table, transmission[:k], wanted, size)
        return
    # Twice as many each time, for as long as a new solution or the degree says that some are missing.
    count = search.first_starts
    while count <= search.most_starts:
        tips = np.pad(sobol(k - 1, count, count.bit_length() - 1) * TURN, ((0, 0), (0, 1)))
        led = shoot(replace(bundle, transmission=transmission), tips, steps=search.rough_steps).rotations
        yield tips + (wanted - led)[:, -1:]
        count *= 2


def _newton(
    bundle: Bundle, wanted: Array, tips: Array, how: tuple[int, int, float], longest: float
) -> tuple[Array, Array]:
    """Tip angles (B, k) of Newton's method where they left the least gap, and this gap (B,); `how`: steps of the
    integration, most iterations, and the gap that ends them; `longest`: change of a tip angle by one step."""
    steps, iterations, enough = how
    best, least = tips.copy(), np.full(len(tips), np.inf)
    going, here = np.arange(len(tips)), tips
    for _ in range(iterations):
        if not len(going):
            break
        shot = shoot(bundle, here, steps=steps, slopes=True)
        gap = shot.rotations - wanted
        gap -= TURN * np.round(gap / TURN)
        size = np.abs(gap).max(1)
        better = size < least[going]
        best[going[better]], least[going[better]] = here[better], size[better]
        left = size > enough
        going, here, gap, slope = going[left], here[left], gap[left], shot.by_tip[left]
        step = np.linalg.solve(slope + 1e-12 * np.eye(tips.shape[1]), -gap[:, :, None])[:, :, 0]
        change = np.abs(step).max(1, initial=0.0)
        here = here + step * np.minimum(1.0, longest / np.maximum(change, 1e-12))[:, None]
    return best, least


def _approach(bundle: Bundle, wanted: Array, starts: Array, search: EquilibriaSearch) -> Array:
    """Starts that got close, by rough integration, without doubles."""
    tips = starts
    # Most starts have met after a few steps.
    for iterations in (3, 10):
        how = search.rough_steps, iterations, search.handed_over
        tips, gap = _newton(bundle, wanted, tips, how, search.longest_step)
        tips = tips % TURN
        first = np.unique(np.round(tips / search.close), axis=0, return_index=True)[1]
        tips, gap = tips[first], gap[first]
    return np.asarray(tips[gap < search.close])


def _finish(bundle: Bundle, wanted: Array, starts: Array, search: EquilibriaSearch) -> Preimage:
    """Tip angles that starts lead to, unwound so that their joints are the wanted ones without whole turns."""
    tips, gap = _newton(bundle, wanted, starts, (STEPS, 12, search.solved), search.longest_step)
    tips = tips[gap < search.solved]
    if not len(tips):
        return Preimage(tips, np.zeros(0), np.zeros((0, bundle.n_tubes)), True)
    shot = shoot(bundle, tips, slopes=True)
    tips = tips - TURN * np.round((shot.rotations - wanted) / TURN)
    sign = np.sign(np.linalg.det(shot.by_tip))
    kept: list[int] = []
    for i in range(len(tips)):
        near = np.abs(tips[kept] - tips[i]).max(1, initial=0.0) < search.same_tips
        if not (near & (sign[kept] == sign[i])).any():
            kept.append(i)
    return Preimage(tips[kept], sign[kept], shot.travel[kept], True)
