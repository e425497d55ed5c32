"""`tubeopt load-limit` and `force`: how much the robot bears, and which force acts on it."""

from __future__ import annotations

from ..runs.load_studies import ForceStudy, LoadLimitStudy
from .flags import ROBOT, answer, asks
from .output import Output


@asks(
    LoadLimitStudy,
    example="tubeopt load-limit configs/robots/thesis_ctr.yaml --from-deg 0,0,0 --rotations-deg 200,0,0 "
    "--tip-force-mN=-10,0,0",
)
def load_limit(study: LoadLimitStudy, output: Output) -> None:
    """How many times a load the robot bears before it snaps or buckles, computed exactly, and where it lands."""
    answer(study, output)


@asks(
    ForceStudy,
    arguments={"robot": ROBOT, "measurements": ("MEASURED.csv", "Measured positions of the arm.")},
    example="tubeopt force configs/robots/thesis_ctr.yaml configs/experiments/synthetic_forces.csv --noise-mm 0.1",
)
def force(study: ForceStudy, output: Output) -> None:
    """The force on the tip in every row of a recording, how sure it is, and what cannot be told."""
    answer(study, output)
