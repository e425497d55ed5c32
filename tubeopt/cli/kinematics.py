"""`tubeopt fk`: the shape that a robot takes at given joint values."""

from __future__ import annotations

from ..runs.forward_study import ForwardKinematicsStudy
from .flags import answer, asks
from .output import Output


@asks(
    ForwardKinematicsStudy,
    flags={"tolerance_rad": "--tolerance-rad,--tolerance"},
    example="tubeopt fk configs/robots/thesis_ctr.yaml --rotations-deg 0,57.3,114.6 --translations-mm 0,0,0",
)
def fk(study: ForwardKinematicsStudy, output: Output) -> None:
    """Forward kinematics: the stable shape at given joint values, with its margin to snapping."""
    answer(study, output)
