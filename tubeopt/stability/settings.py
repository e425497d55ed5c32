"""How hard snaps, worst cases and equilibria are searched for: what a user may want to change, as documented fields."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..errors import Settings


@dataclass(frozen=True)
class SnapSearch(Settings):
    """How hard snaps and worst cases are searched for, where no proof decides; of `judge`, `worst_margin` and
    `worst_certificate`.

    Args:
        samples: of the tip angles, from the best of which the least margin is searched for.
        segment_samples: the same for each segment of tubes off the centreline.
        local_searches: from the best samples.
        evaluations: of the certificate by the global search over translations.
        folds: at which the sheet of stable equilibria ends, to which ways are tried.
        sheet_grid: its nodes per turn with one, two, .. relative tip angles, and with all that are more.
        sheet_turns: of the tips around the relaxed pose in which folds are looked for, at most; a fold may belong to
            joints that are turned further.
        sheet_nodes: of all turns together.
        sheet_apart: folds in whose directions from the relaxed pose a relative rotation differs by less than this part
            are one try.
        overshoot: how far (rad) a way goes on beyond a fold.
        random_ways: directions in which a snap is looked for in the end.

    Raises:
        InputError: a count that is no whole number of at least 1, another number that is not positive.
    """

    samples: int = 512
    segment_samples: int = 128
    local_searches: int = 6
    evaluations: int = 1500
    folds: int = 12
    sheet_grid: tuple[int, ...] = (256, 64, 16, 8, 5)
    sheet_turns: int = 3
    sheet_nodes: int = 1_000_000
    sheet_apart: float = 0.2
    overshoot: float = 0.3
    random_ways: int = 32


DEFAULT_SEARCH = SnapSearch()


@dataclass(frozen=True)
class EquilibriaSearch(Settings):
    """How all equilibria at given joint values are searched for; of `find_equilibria`.

    Args:
        certain: certificate above which there is one equilibrium and no search: 0, and what round-off may add to it.
        certain_of_pieces: the same of tubes made of pieces, whose couplings vary between the points of the mesh.
        grids_of_one, grids_of_two, grids_of_three: points per turn of the grids, one after the other, on which a table
            of one, two or three relative tip angles is read.
        first_starts, most_starts: points of the Sobol sequence that is searched where there is no table, in the first
            round and in the last; every round has twice those of the one before.
        rough_steps: of the integration per piece on the way to a solution: 2 are wrong by about 1e-4 rad.
        handed_over: a solution of the rough integration is left to the finer one once its joints are as close (rad).
        close: where Newton's method does not get there, as next to a fold, it is left from the best point that was
            seen if that is as close (rad).
        solved: joints as close (rad) are solved.
        longest_step: largest change (rad) of a tip angle by one step: from next to a fold it may leave for anywhere.
        same_tips: tip angles that differ by less (rad) and lie on the same side of a fold are one.
        same: equilibria whose rotations differ by less (rad) everywhere are one.
        loaded_starts, most_loaded_starts: starting points under a load, in the first round and in the last; every round
            has twice those of the one before.
        largest_twist: of a tube at the tip (rad) up to which these reach.

    Raises:
        InputError: a count that is no whole number of at least 1, another number that is not positive.
    """

    certain: float = 1e-6
    certain_of_pieces: float = 1e-3
    grids_of_one: tuple[int, ...] = (1024, 4096, 16384)
    grids_of_two: tuple[int, ...] = (160, 320, 640)
    grids_of_three: tuple[int, ...] = (80, 120, 180)
    first_starts: int = 1024
    most_starts: int = 16384
    rough_steps: int = 2
    handed_over: float = 1e-3
    close: float = 1e-2
    solved: float = 1e-8
    longest_step: float = 0.5
    same_tips: float = 1e-4
    same: float = 1e-5
    loaded_starts: int = 128
    most_loaded_starts: int = 512
    largest_twist: float = 2 * math.pi


DEFAULT_EQUILIBRIA_SEARCH = EquilibriaSearch()
