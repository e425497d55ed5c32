"""All tip angles of a group of tubes that lead to given joint rotations.

Newton's method starts wherever a table of the map from tips to joints (`stability.tables`) says a solution may lie.
The table is read on ever finer grids until the set no longer changes and its topological degree, the sum of the signs
of det(d alpha / d theta_tip), is 1, as it must be: alpha - theta_tip is bounded, so that the map deforms into the
identity. For more than three tubes there is no table, and the starts are a Sobol sequence.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..solvers.sampling import sobol
from ..typing import Array
from .settings import DEFAULT_EQUILIBRIA_SEARCH, EquilibriaSearch
from .shooting import STEPS, Bundle, shoot
from .tables import TURN, starts, table_of


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
    transmissions were (n,) `transmission`, m."""
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
