"""`tubeopt design`: the best robot that keeps a list of requirements."""

from __future__ import annotations

from ..runs.design_study import DesignStudy
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
