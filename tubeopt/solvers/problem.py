"""A nonlinear program with names: composed of variables, constraints and blocks, solved by IPOPT."""

from __future__ import annotations

from collections.abc import Sequence

from ..errors import SolveError
from .multistart import multistart
from .named_program import NamedProgram
from .problem_solution import ProblemSolution, ProblemStatus
from .reordering import improve, retry
from .settings import Ipopt


class Problem(NamedProgram):
    """A nonlinear program with names, for IPOPT with exact second derivatives.

    Variables, constraints and parameters have a name each; a failed solve says by name what was violated. Everything is
    in its own units; `scale` is the size that it typically has.

    Args:
        name: what to call it in messages.

    Example:
        >>> import tubeopt
        >>> problem = tubeopt.Problem("rod")
        >>> side = problem.variable("side", 2, guess=1.0, lower=0.0)
        >>> problem.subject_to("area", side[0] * side[1] >= 4.0)
        >>> problem.minimize(side[0] + side[1])
        >>> solution = problem.solve()
        >>> solution.value("side").round(6).tolist(), round(solution.multiplier("area"), 6)
        ([2.0, 2.0], 0.5)
    """

    def solve(
        self, solver: Ipopt | None = None, *, start: ProblemSolution | None = None, reorderings: int = 8
    ) -> ProblemSolution:
        """Solve the program from its guesses, or from an earlier solution with its multipliers.

        Where breakpoints of a block meet at the optimum and press against each other, they change places, and the solve
        goes on from there as long as the objective does not grow. So they do where a failed solve ended.

        Args:
            solver: settings.
            start: a solution of this problem or of one with the same names; what it does not name keeps its guess.
            reorderings: how often breakpoints may change places.

        Raises:
            SolveError: no optimum was found; the message names the worst constraints, `solution` holds the last point.
        """
        own = solver or Ipopt()
        solution = self.attempt(own, start=start)
        if solution.status is not ProblemStatus.SOLVED:
            solution = retry(self, own, solution, reorderings)
        if solution.status is not ProblemStatus.SOLVED:
            raise SolveError(self.failure(solution), solution)
        return improve(self, own, solution, reorderings)

    def multistart(
        self, over: Sequence[str], count: int = 16, *, seed: int = 0, solver: Ipopt | None = None
    ) -> ProblemSolution:
        """The best of `count` solves whose starts fill the bounds of the variables `over` evenly (Sobol).

        At every start the blocks begin at the equilibrium of their joint values and dimensions there.

        Raises:
            InputError: an unknown variable, or one without finite bounds.
            SolveError: no start led to an optimum; the message counts what happened, `solution` is the nearest miss.
        """
        own = solver or Ipopt()
        return multistart(self, lambda: self.solve(own), over, count, seed)
