"""How hard snaps, worst cases and equilibria are searched for: what a user may want to change, as documented fields."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..errors import Settings


@dataclass(frozen=True)
class SnapSearch(Settings):
    """Settings of the search for snaps and worst cases where no proof decides.

    For `assess_snapping`, `worst_margin` and `worst_certificate`.

    Raises:
        InputError: a count that is no whole number of at least 1, another number that is not positive.
    """

    samples: int = 512
    """Number of sampled tip angles; the search for the smallest margin starts from the best."""
    segment_samples: int = 128
    """Number of samples per segment, for tubes off the centreline."""
    local_searches: int = 6
    """Number of local searches, from the best samples."""
    evaluations: int = 1500
    """Maximum number of certificates in the global search over translations."""
    folds: int = 12
    """Number of folds at the edge of the stable branch surface that are tried as targets."""
    sheet_grid: tuple[int, ...] = (256, 64, 16, 8, 5)
    """Its nodes per turn with one, two, .. relative tip angles, and with all that are more."""
    sheet_turns: int = 3
    """Maximum number of turns of the tips around the relaxed pose in which folds are searched. The joints of a fold may
    have turned further.
    """
    sheet_nodes: int = 1_000_000
    """Maximum number of nodes of all turns together."""
    sheet_apart: float = 0.2
    """Relative difference between the directions of two folds from the relaxed pose below which they count as one."""
    overshoot: float = 0.3
    """Length of the path beyond a fold, rad."""
    random_ways: int = 32
    """Number of random directions tried last."""


DEFAULT_SEARCH = SnapSearch()


@dataclass(frozen=True)
class EquilibriaSearch(Settings):
    """Settings of the search for all equilibria at given joint values, for `find_equilibria`.

    Raises:
        InputError: a count that is no whole number of at least 1, another number that is not positive.
    """

    certain: float = 1e-6
    """Certificate above which there is one equilibrium and no search: 0, and what round-off may add to it."""
    certain_of_pieces: float = 1e-3
    """Certificate above which nothing is searched, for tubes made of pieces; their couplings vary between mesh points.
    """
    grids_of_one: tuple[int, ...] = (1024, 4096, 16384)
    """Points per turn of the successive grids for one relative tip angle."""
    grids_of_two: tuple[int, ...] = (160, 320, 640)
    """Points per turn of the successive grids for two relative tip angles."""
    grids_of_three: tuple[int, ...] = (80, 120, 180)
    """Points per turn of the successive grids for three relative tip angles."""
    first_starts: int = 1024
    """Points of the Sobol sequence that is searched where there is no table, in the first round; every round has twice
    those of the one before."""
    most_starts: int = 16384
    """Number of starts in the last round."""
    rough_steps: int = 2
    """Integration steps per piece on the path to a solution: 2 have an error of about 1e-4 rad."""
    handed_over: float = 1e-3
    """A solution of the rough integration is left to the finer one once its joints are as close, rad."""
    close: float = 1e-2
    """Residual of the best point, rad, that is accepted where Newton's method does not converge, as near a fold."""
    solved: float = 1e-8
    """Joints as close are solved, rad."""
    longest_step: float = 0.5
    """Largest change of a tip angle by one step, rad: from next to a fold it may leave for anywhere."""
    same_tips: float = 1e-4
    """Tip angles that differ by less and lie on the same side of a fold are one, rad."""
    same: float = 1e-5
    """Largest difference of all rotations between equal equilibria, rad."""
    loaded_starts: int = 128
    """Starting points under a load, in the first round; every round has twice those of the one before."""
    most_loaded_starts: int = 512
    """Number of starts in the last round under load."""
    largest_twist: float = 2 * math.pi
    """Largest twist of a tube at the tip that the starts cover, rad."""


DEFAULT_EQUILIBRIA_SEARCH = EquilibriaSearch()
