"""`tubeopt ik`: the joint values that bring the tip to a target."""

from __future__ import annotations

from ..errors import SolveError
from ..runs.inverse_study import InverseStudy, Postures, TargetTable
from ..show.inverse_report import miss, why
from ..show.report import present
from ..show.reports import report
from .flags import ask, asks
from .options import JsonOption, OutOption


@asks(InverseStudy, flags={"start": "--from"})
def ik(study: InverseStudy, out: OutOption = None, as_json: JsonOption = False) -> None:
    """Inverse kinematics: stable joint values that bring the tip to a target, and point it there.

    Ends with 3 where the target, or every one of a table, is missed, with --closest as well; misses within a table are
    named in it. With --follow, targets are put between those of the table where the robot would leap.
    """
    answer = ask(study, "solving targets", out)
    present(report(answer), out=out, as_json=as_json)
    refuse_misses(answer)


def refuse_misses(answer: Postures | TargetTable) -> None:
    """Raise SolveError where the target, or every one of a table, is missed."""
    if isinstance(answer, Postures):
        best = answer.solutions[0]
        if not best.reached:
            raise SolveError(f"{best.status}: {miss(best)}", best)
        return
    given = [row for row in answer.rows if row.given]
    if not any(row.solution is not None and row.solution.reached for row in given):
        raise SolveError(f"none of {len(given)} targets was reached; the first: {why(given[0])}")
