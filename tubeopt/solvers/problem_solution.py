"""How the solve of a program ended, and its solution: plain numbers by name, saved as JSON + npz."""

from __future__ import annotations

import io
import json
from dataclasses import asdict, dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any, Protocol

import casadi as ca
import numpy as np

from ..arguments import typed
from ..block.violation import Violation
from ..display import Displayed
from ..errors import InputError, nearest
from ..files.files import read_bytes, read_text, save_arrays, write_text
from ..typing import Array, StatusEnum


class ProblemStatus(StatusEnum):
    """Result of the solve of a program; every value reads as a sentence."""

    SOLVED = "an optimum was found"
    INFEASIBLE = "no point was found that satisfies all constraints"
    TOO_MANY_ITERATIONS = "the solver ran out of iterations"
    OUT_OF_TIME = "the solver ran out of time"
    UNBOUNDED = "the iterates grow without bound"
    NOT_A_NUMBER = "an expression of the program has no finite value or derivative at an iterate"
    STOPPED = "the solver stopped before an optimum"

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


class Evaluates(Protocol):
    """A program whose expressions have numbers where it is solved."""

    def evaluate(self, expression: Any, values: dict[str, Array], parameters: dict[str, Array]) -> Array:
        """An expression at numbers of the variables and parameters."""


@dataclass(frozen=True)
class ProblemStatistics:
    """Effort of a solve."""

    verdict: str
    """Return status of IPOPT."""
    iterations: int
    """Iterations of the last solve."""
    seconds: float
    """Duration of all solves, s."""
    unknowns: int
    constraints: int
    reorderings: int = 0
    """Number of swaps of breakpoints."""


@dataclass(frozen=True)
class Attempts:
    """Results of the starts of `Problem.multistart`."""

    started: int
    solved: int
    """Number of starts that ended in an optimum."""
    without_equilibrium: int
    """Number of starts without an equilibrium."""
    failed: int
    objectives: tuple[float, ...]
    """Objectives of the optima, smallest first."""

    def __str__(self) -> str:
        text = f"{self.started} starts: {self.solved} optima, {self.failed} failed"
        return text + (f", {self.without_equilibrium} had no equilibrium" if self.without_equilibrium else "")


@dataclass(frozen=True, eq=False)
class ProblemSolution(Displayed):
    """Values, multipliers and status of a solved `Problem`."""

    _brief = ("status", "objective", "values")

    status: ProblemStatus
    """Result of the solve."""
    objective: float
    """Value of the objective, in its own unit."""
    values: dict[str, Array]
    """Values of the variables, by name, in their own units."""
    multipliers: dict[str, Array]
    """Multipliers of the constraints, by name, one per row. They are the change of the objective per unit increase of
    the active bound, in the units of objective and constraint. 0 for inactive constraints.
    """
    bound_multipliers: dict[str, Array]
    """Multipliers of the bounds of variables, by name, with the same meaning."""
    parameters: dict[str, Array]
    """The numbers that were given, by name."""
    violations: tuple[Violation, ...]
    """Constraints that do not hold, the worst first: none of a solved program."""
    statistics: ProblemStatistics
    """Effort of the solve."""
    attempts: Attempts | None = None
    """Results of the starts of a multistart, or None."""
    program: Evaluates | None = field(default=None, repr=False)
    """Program for evaluating expressions; None for a solution that was loaded or unpickled."""

    def value(self, what: Any) -> Any:
        """The number, (n,) or (n, m) numbers of a variable by its name, or of an expression of the problem.

        Raises:
            InputError: an unknown name, or an expression of another program or after loading.
        """
        if isinstance(what, str):
            known = self.values | self.parameters
            if what not in known:
                raise InputError(f"there is no variable {what!r}{nearest(what, known)}")
            return _plain(known[what])
        if not isinstance(what, ca.MX):
            return _plain(np.array(ca.DM(what)))
        if self.program is None:
            raise InputError("a solution that was loaded has values by name only; expressions belong to a Problem")
        return _plain(self.program.evaluate(what, self.values, self.parameters))

    def multiplier(self, name: str) -> Any:
        """The multiplier of a constraint, or of the bounds of a variable, by its name.

        Raises:
            InputError: an unknown name.
        """
        known = self.bound_multipliers | self.multipliers
        if name not in known:
            raise InputError(f"there is no constraint or variable {name!r}{nearest(name, known)}")
        return _plain(known[name])

    def save(self, directory: str | PathLike[str]) -> None:
        """Write `result.json` and `arrays.npz` into `directory`; `load_problem_solution` reads them back.

        Raises:
            InputError: the files cannot be written.
        """
        tables = {"values": self.values, "multipliers": self.multipliers}
        tables |= {"bound_multipliers": self.bound_multipliers, "parameters": self.parameters}
        names = {table: list(entries) for table, entries in tables.items()}
        arrays = {f"{table}{k}": v for table, entries in tables.items() for k, v in enumerate(entries.values())}
        record = {
            "status": self.status.name,
            "objective": self.objective,
            "names": names,
            "violations": [asdict(each) for each in self.violations],
            "statistics": asdict(self.statistics),
            "attempts": asdict(self.attempts) if self.attempts else None,
        }
        save_arrays(Path(directory) / "arrays.npz", **arrays)
        write_text(Path(directory) / "result.json", json.dumps(record, indent=2) + "\n")

    def __getstate__(self) -> dict[str, Any]:
        # Symbols do not travel: what is unpickled has values by name.
        return {**self.__dict__, "program": None}


@typed
def load_problem_solution(directory: str | PathLike[str]) -> ProblemSolution:
    """The solution that `ProblemSolution.save` wrote into `directory`: values by name, good as the start of a solve.

    Raises:
        InputError: a file is missing or is not what was written.

    Examples:
        >>> import tempfile
        >>> import tubeopt
        >>> problem = tubeopt.Problem()
        >>> x = problem.variable("x", 1, guess=1.0)
        >>> problem.minimize((x - 2) ** 2)
        >>> with tempfile.TemporaryDirectory() as directory:
        ...     problem.solve().save(directory)
        ...     float(tubeopt.load_problem_solution(directory).value("x"))
        2.0
    """
    result, arrays = Path(directory) / "result.json", Path(directory) / "arrays.npz"
    text, content = read_text(result), read_bytes(arrays)
    try:
        record = json.loads(text)
        with np.load(io.BytesIO(content), allow_pickle=False) as data:
            tables = {
                table: {name: data[f"{table}{k}"] for k, name in enumerate(names)}
                for table, names in record["names"].items()
            }
        attempts = record["attempts"]
        return ProblemSolution(
            status=ProblemStatus[record["status"]],
            objective=float(record["objective"]),
            values=tables["values"],
            multipliers=tables["multipliers"],
            bound_multipliers=tables["bound_multipliers"],
            parameters=tables["parameters"],
            violations=tuple(Violation(**each) for each in record["violations"]),
            statistics=ProblemStatistics(**record["statistics"]),
            attempts=Attempts(**{**attempts, "objectives": tuple(attempts["objectives"])}) if attempts else None,
        )
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{result}: not the solution of a problem ({error})") from None


def _plain(value: Array) -> Any:
    """A number, a vector, or a matrix."""
    array = np.asarray(value, dtype=float)
    if array.size == 1:
        return float(array.item())
    return array.ravel() if array.ndim == 2 and array.shape[1] == 1 else array
