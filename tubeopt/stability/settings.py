"""How hard snaps and worst cases are searched for: what a user may want to change, as documented fields."""

from __future__ import annotations

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
    sheet_turns: int = 3
    sheet_nodes: int = 1_000_000
    sheet_apart: float = 0.2
    overshoot: float = 0.3
    random_ways: int = 32


DEFAULT_SEARCH = SnapSearch()
