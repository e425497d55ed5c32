"""`tubeopt plan`, `plan-arms` and `verify`: motions that never snap, and whether a trajectory is one."""

from __future__ import annotations

from ..runs.arms_study import ArmsStudy
from ..runs.plan_study import PlanStudy
from ..runs.verify_study import VerifyStudy
from .flags import answer, asks, asks_file
from .output import Output

TRAJECTORY = (
    "TRAJECTORY.csv",
    "Columns time_s, rotation_1_deg, ... and, where tubes slide, translation_1_mm, ...",
)


@asks_file(
    PlanStudy,
    example="tubeopt plan configs/studies/plan_thesis_turn.yaml --out results",
    note="All is said assuming no friction, and no load or weight but what is given.",
)
def plan(study: PlanStudy, output: Output) -> None:
    """Plan a motion that stays on one stable branch, around obstacles and within rates, and prove it.

    Ends with 0 if it is proved, 3 where none was found, and 4 where one was found, shown and saved, but the time limit
    was reached before its proof was finished.
    """
    answer(study, output)


@asks_file(
    ArmsStudy,
    example="tubeopt plan-arms configs/studies/plan_two_arms.yaml --out results",
    note="All is said assuming no friction, and no load or weight.",
)
def plan_arms(study: ArmsStudy, output: Output) -> None:
    """Plan motions of several robots beside each other, none of which snaps or touches another, and prove them.

    Ends with 0 if they are proved, 3 where none were found, and 4 where some were found, shown and saved, but are not
    proved.
    """
    answer(study, output)


@asks(
    VerifyStudy,
    arguments={"trajectory": TRAJECTORY},
    example="tubeopt verify results/trajectory.csv --min-margin 0.05",
    note="All is said assuming no friction, and no load or weight but what is given.",
)
def verify(study: VerifyStudy, output: Output) -> None:
    """Follow a trajectory, of whatever origin, and say whether it snaps, collides or is too fast. Ends with 3 if so."""
    answer(study, output)
