"""How the solve of a program may end."""

from __future__ import annotations

from ..typing import Sentence


class ProblemStatus(Sentence):
    """How the solve of a program ended; every value reads as a sentence."""

    SOLVED = "an optimum was found"
    INFEASIBLE = "no point was found at which all constraints hold"
    TOO_MANY_ITERATIONS = "the solver ran out of iterations"
    OUT_OF_TIME = "the solver ran out of time"
    UNBOUNDED = "the iterates grow without bound"
    NOT_A_NUMBER = "an expression of the program has no finite value or derivative where the solver came"
    STOPPED = "the solver came to a halt before an optimum"

    @classmethod
    def of(cls, verdict: str) -> ProblemStatus:
        """The status behind a return status of IPOPT."""
        known = {
            "Solve_Succeeded": cls.SOLVED,
            "Infeasible_Problem_Detected": cls.INFEASIBLE,
            "Maximum_Iterations_Exceeded": cls.TOO_MANY_ITERATIONS,
            "Maximum_WallTime_Exceeded": cls.OUT_OF_TIME,
            "Diverging_Iterates": cls.UNBOUNDED,
            "Invalid_Number_Detected": cls.NOT_A_NUMBER,
        }
        return known.get(verdict, cls.STOPPED)
