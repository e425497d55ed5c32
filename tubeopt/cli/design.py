"""`tubeopt design` and `design-pair`: the best robot, or two, that keep a list of requirements."""

from __future__ import annotations

from ..runs.design_study import DesignStudy
from ..runs.pair_study import PairStudy
from ..stability import ASSUMING
from .flags import answer, asks_file
from .output import Output


@asks_file(
    DesignStudy,
    example="tubeopt design configs/studies/design_thesis_snap_free.yaml --out results",
    note=f"What is said of snaps is said {ASSUMING}, but for the force of max_tip_force_mN.",
)
def design(study: DesignStudy, output: Output) -> None:
    """Design the tubes of a robot: what may change, what must hold and what is wanted stand in a file."""
    answer(study, output)


@asks_file(
    PairStudy,
    example="tubeopt design-pair configs/studies/design_pair.yaml --out results",
    note=f"What is said of snaps is said {ASSUMING}.",
)
def design_pair(study: PairStudy, output: Output) -> None:
    """Design two robots together, so that both tips hold as many pairs of places of a region as can be found.

    What may change, what must hold, where the plates stand and the region stand in a file.
    """
    answer(study, output)
