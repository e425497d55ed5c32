"""How hard snaps, worst cases and equilibria are searched for: what a user may want to change, as documented fields."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..errors import Settings


@dataclass(frozen=True)
class SnapSearch(Settings):
    """How hard snaps and worst cases are searched for, where no proof decides; of `judge`, `worst_margin` and
    `worst_certificate`.

    Raises:
        InputError: a count that is no whole number of at least 1, another number that is not positive.
    """

    samples: int = 512
    """Of the tip angles, from the best of which the least margin is searched for."""
    segment_samples: int = 128
    """The same for each segment of tubes off the centreline."""
    local_searches: int = 6
    """From the best samples."""
    evaluations: int = 1500
    """Of the certificate by the global search over translations."""
    folds: int = 12
    """At which the sheet of stable equilibria ends, to which ways are tried."""
    sheet_grid: tuple[int, ...] = (256, 64, 16, 8, 5)
    """Its nodes per turn with one, two, .. relative tip angles, and with all that are more."""
    sheet_turns: int = 3
    """Of the tips around the relaxed pose in which folds are looked for, at most; a fold may belong to joints that are
    turned further."""
    sheet_nodes: int = 1_000_000
    """Of all turns together."""
    sheet_apart: float = 0.2
    """Folds in whose directions from the relaxed pose a relative rotation differs by less than this part are one
    try."""
    overshoot: float = 0.3
    """How far a way goes on beyond a fold, rad."""
    random_ways: int = 32
    """Directions in which a snap is looked for in the end."""


DEFAULT_SEARCH = SnapSearch()


@dataclass(frozen=True)
class EquilibriaSearch(Settings):
    """How all equilibria at given joint values are searched for; of `find_equilibria`.

    Raises:
        InputError: a count that is no whole number of at least 1, another number that is not positive.
    """

    certain: float = 1e-6
    """Certificate above which there is one equilibrium and no search: 0, and what round-off may add to it."""
    certain_of_pieces: float = 1e-3
    """The same of tubes made of pieces, whose couplings vary between the points of the mesh."""
    grids_of_one: tuple[int, ...] = (1024, 4096, 16384)
    """Points per turn of the grids, one after the other, on which a table of one relative tip angle is read."""
    grids_of_two: tuple[int, ...] = (160, 320, 640)
    """The same of two."""
    grids_of_three: tuple[int, ...] = (80, 120, 180)
    """Of three."""
    first_starts: int = 1024
    """Points of the Sobol sequence that is searched where there is no table, in the first round; every round has twice
    those of the one before."""
    most_starts: int = 16384
    """The same in the last round."""
    rough_steps: int = 2
    """Of the integration per piece on the way to a solution: 2 are wrong by about 1e-4 rad."""
    handed_over: float = 1e-3
    """A solution of the rough integration is left to the finer one once its joints are as close, rad."""
    close: float = 1e-2
    """Where Newton's method does not get there, as next to a fold, it is left from the best point that was seen if that
    is as close, rad."""
    solved: float = 1e-8
    """Joints as close are solved, rad."""
    longest_step: float = 0.5
    """Largest change of a tip angle by one step, rad: from next to a fold it may leave for anywhere."""
    same_tips: float = 1e-4
    """Tip angles that differ by less and lie on the same side of a fold are one, rad."""
    same: float = 1e-5
    """Equilibria whose rotations differ by less everywhere are one, rad."""
    loaded_starts: int = 128
    """Starting points under a load, in the first round; every round has twice those of the one before."""
    most_loaded_starts: int = 512
    """The same in the last round."""
    largest_twist: float = 2 * math.pi
    """Of a tube at the tip up to which these reach, rad."""


DEFAULT_EQUILIBRIA_SEARCH = EquilibriaSearch()
