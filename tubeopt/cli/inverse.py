"""`tubeopt ik`: the joint values that bring the tip to a target."""

from __future__ import annotations

from ..runs.inverse_study import InverseStudy
from ..stability import ASSUMING
from .flags import answer, asks
from .output import Output


@asks(
    InverseStudy,
    flags={"start": "--from"},
    example="tubeopt ik configs/robots/thesis_ctr.yaml --target-mm 50,30,150 --all --out results",
    note=f"What is said of ways without a snap is said {ASSUMING}.",
)
def ik(study: InverseStudy, output: Output) -> None:
    """Inverse kinematics: stable joint values that bring the tip to a target, and point it there.

    Ends with 3 where the target, or every one of a table, is missed, with --closest as well; misses within a table are
    named in it. With --follow, targets are put between those of the table where the robot would leap.
    """
    answer(study, output)
