"""`tubeopt design`: the best robot that keeps a list of requirements."""

from __future__ import annotations

from ..runs.design_study import DesignStudy
from .flags import answer, asks_file
from .output import Output


@asks_file(DesignStudy, example="tubeopt design configs/studies/design_thesis_snap_free.yaml --out results")
def design(study: DesignStudy, output: Output) -> None:
    """Design the tubes of a robot: what may change, what must hold and what is wanted stand in a file."""
    answer(study, output)
