"""A nonlinear program with named variables and constraints, its solution, and one solve of it by IPOPT."""

from __future__ import annotations

import io
import json
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Protocol

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ..arguments import typed
from ..block.transcription.program import Violation, violations_of, worst
from ..display import Displayed
from ..errors import InputError, instance, nearest
from ..files.field_metadata import form
from ..files.files import read_bytes, read_text, save_arrays, write_text
from ..typing import Array, Mask, StatusEnum
from .settings import AT_SOLUTION, Ipopt, WarmStart
from .time_limit import MIN_SECONDS, check_time, time_left

# --- Solution ---------------------------------------------------------------------------------------------------------


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
        """Status for a return status of IPOPT."""
        statuses = {
            "Solve_Succeeded": cls.SOLVED,
            "Infeasible_Problem_Detected": cls.INFEASIBLE,
            "Maximum_Iterations_Exceeded": cls.TOO_MANY_ITERATIONS,
            "Maximum_WallTime_Exceeded": cls.OUT_OF_TIME,
            "Diverging_Iterates": cls.UNBOUNDED,
            "Invalid_Number_Detected": cls.NOT_A_NUMBER,
        }
        return statuses.get(verdict, cls.STOPPED)


class Evaluates(Protocol):
    """A program that evaluates its expressions."""

    def evaluate(self, expression: Any, values: dict[str, Array], parameters: dict[str, Array]) -> Array:
        """Value of an expression at numbers of the variables and parameters."""


@dataclass(frozen=True)
class ProblemStatistics:
    """Effort of a solve."""

    verdict: str
    """Return status of IPOPT."""
    iterations: int
    """Number of iterations of all solves."""
    seconds: float
    """Duration of all solves, s."""
    unknowns: int
    constraints: int
    reorderings: int = 0
    """Number of swaps of breakpoints."""
    solves: int = 1
    """Number of solves; swaps of breakpoints need further solves."""
    gained: float = 0.0
    """Decrease of the objective by swaps of breakpoints."""


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
    objective: Annotated[float, form(".6g"), "objective"]
    """Objective at the solution, in its own unit."""
    values: dict[str, Array]
    """Values of the variables, by name, in their own units."""
    multipliers: dict[str, Array]
    """Multipliers of the constraints, by name, one per row. They are the change of the objective per unit increase of
    the active bound, in the units of objective and constraint. 0 for inactive constraints.
    """
    bound_multipliers: dict[str, Array]
    """Multipliers of the bounds of variables, by name, with the meaning and units of `multipliers`."""
    parameters: dict[str, Array]
    """Values of the parameters, by name."""
    violations: tuple[Violation, ...]
    """Violated constraints, worst first; none if the program is solved."""
    statistics: ProblemStatistics
    """Effort of the solve."""
    attempts: Attempts | None = None
    """Results of the starts of a multistart, or None."""
    program: Evaluates | None = field(default=None, repr=False)
    """Program for evaluating expressions; None for a solution that was loaded or unpickled."""

    def value(self, what: Any) -> Any:
        """Value of a variable or parameter by its name, or of an expression of the problem: a number or an array.

        Raises:
            InputError: an unknown name, or an expression of another program or after loading.
        """
        if isinstance(what, str):
            table = self.values | self.parameters
            if what not in table:
                raise InputError(f"there is no variable {what!r}{nearest(what, table)}")
            return _plain(table[what])
        if not isinstance(what, ca.MX):
            return _plain(np.array(ca.DM(what)))
        if self.program is None:
            raise InputError("a solution that was loaded has values by name only; expressions belong to a Problem")
        return _plain(self.program.evaluate(what, self.values, self.parameters))

    def multiplier(self, name: str) -> Any:
        """Multiplier of a constraint, or of the bounds of a variable, by its name.

        Raises:
            InputError: an unknown name.
        """
        table = self.bound_multipliers | self.multipliers
        if name not in table:
            raise InputError(f"there is no constraint or variable {name!r}{nearest(name, table)}")
        return _plain(table[name])

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
        # Symbols of CasADi cannot be pickled.
        return {**self.__dict__, "program": None}


@typed
def load_problem_solution(directory: str | PathLike[str]) -> ProblemSolution:
    """Read a solution that `ProblemSolution.save` wrote; it can start a solve.

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


# --- Program as one function of IPOPT ---------------------------------------------------------------------------------


DIRECTIONS, MANY_DIRECTIONS = 8, 64
"""Numbers of directions that CasADi differentiates along at once; its own is the second.

With few, derivatives are evaluated as fast, and are built in a fraction of the time for cross-sections of many tubes.
Functions with a Jacobian of their own evaluate it once for that many.
"""


class Stacked:
    """Scales and bounds of all variables, or of all constraints, one below the other."""

    def __init__(self, parts: Sequence[Any]) -> None:
        columns = [
            np.concatenate([*(getattr(p, key) for p in parts), np.zeros(0)]) for key in ("scale", "lower", "upper")
        ]
        self.scale, self.lower, self.upper = columns


class Watch(ca.Callback):
    """Test after every iteration of IPOPT, which may stop it there."""

    STOPPED = "User_Requested_Stop"
    """Return status of a solve that was stopped."""

    def __init__(self, unknowns: int, constraints: int, parameters: int) -> None:
        super().__init__()
        self._sizes = {"f": 1, "x": unknowns, "lam_x": unknowns, "lam_p": parameters}
        self._sizes |= dict.fromkeys(("g", "lam_g"), constraints)
        self.test: Callable[[Array, Array, Array, Array], bool] | None = None
        """Function (x, g, multipliers of g, of x) -> whether to stop, in the scale of the solver."""
        self.construct("watch", {})

    def get_n_in(self) -> int:
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, i: int) -> Any:
        return ca.Sparsity.dense(self._sizes[ca.nlpsol_out(i)])

    def eval(self, arg: Sequence[Any]) -> list[float]:
        """1 to stop, otherwise 0."""
        if self.test is None:
            return [0.0]
        values = {ca.nlpsol_out(i): value for i, value in enumerate(arg)}
        return [float(self.test(*(np.array(values[name]).ravel() for name in ("x", "g", "lam_g", "lam_x"))))]


def ipopt_function(  # noqa: PLR0913
    variables: Sequence[Any],
    parameters: list[Any],
    objective: Any,
    constraints: Sequence[Any],
    settings: Ipopt,
    *,
    warm: WarmStart | None,
    derivatives: ca.Function | None = None,
    directions: int = DIRECTIONS,
    watch: Watch | None = None,
) -> ca.Function:
    """Solver (x0, p, bounds) -> x, f, g, multipliers of the scaled program.

    Args:
        warm: for a start with multipliers; None for a cold start.
        derivatives: another solver of the same program and settings, the derivatives of which are used again.
        directions: number of directions that CasADi differentiates along at once.
        watch: called after every iteration.
    """
    symbols = [each.symbol for each in variables]
    program = function_of(
        [*symbols, *parameters], [objective, *(each.expression / ca.DM(each.scale) for each in constraints)]
    )
    scale = Stacked(variables).scale
    x: Any = ca.MX.sym("x", len(scale))
    p: Any = ca.MX.sym("p", sum(each.numel() for each in parameters))
    parts = _parted(ca.DM(scale) * x, symbols) + _parted(p, parameters)
    f, *rows = program.call(parts, True, False)
    options = settings.options(warm=warm)
    if watch is not None:
        options["iteration_callback"] = watch
    with few_directions(directions):
        if settings.expand:
            flat = ca.Function("flat", [x, p], [f, *rows]).expand()
            x, p = flat.sx_in()
            f, *rows = flat.call([x, p], True, False)
        if derivatives is not None:
            for option, function in (("grad_f", "nlp_grad_f"), ("jac_g", "nlp_jac_g"), ("hess_lag", "nlp_hess_l")):
                if derivatives.has_function(function):
                    options[option] = derivatives.get_function(function)
        elif not settings.expand:
            with few_directions(MANY_DIRECTIONS):
                g = ca.vertcat(*rows)
                options["jac_g"] = ca.Function("jac_g", [x, p], [g, ca.jacobian(g, x)], ["x", "p"], ["g", "jac_g_x"])
        elif settings.hessian == "limited-memory":
            # Constraint by constraint: rows of a few constraints that depend on all variables are cheap in reverse
            # mode, and would spoil the colouring of the others, which are local.
            slopes = ca.vertcat(ca.SX(0, x.numel()), *(ca.jacobian(row, x) for row in rows))
            outputs = [ca.vertcat(ca.SX(0, 1), *rows), slopes]
            options["jac_g"] = ca.Function("jac_g", [x, p], outputs, ["x", "p"], ["g", "jac_g_x"])
        return ca.nlpsol("program", "ipopt", {"x": x, "p": p, "f": f, "g": ca.vertcat(*rows)}, options)


def function_of(symbols: list[Any], expressions: list[Any]) -> ca.Function:
    """Function from symbols to expressions; raises InputError if these contain other symbols."""
    function: ca.Function = ca.Function("program", symbols, expressions, {"allow_free": True})
    if function.has_free():
        raise InputError(f"an expression has symbols that are not the problem's: {', '.join(function.get_free())}")
    return function


def _parted(column: Any, symbols: list[Any]) -> list[Any]:
    sizes = [each.numel() for each in symbols]
    return list(ca.vertsplit(column, np.cumsum([0, *sizes]).tolist())) if sizes else []


@contextmanager
def few_directions(count: int = DIRECTIONS) -> Iterator[None]:
    """Context with CasADi differentiating along few directions at once, also for a `casadi.Opti` solved in it."""
    before = ca.GlobalOptions.getMaxNumDir()
    ca.GlobalOptions.setMaxNumDir(count)
    try:
        yield
    finally:
        ca.GlobalOptions.setMaxNumDir(before)


NAMED = 10
"""Largest number of violations of a solution."""

NAMED_VIOLATIONS = 3
"""Number of constraints that the message of a failed solve names."""

MAX_SOLVERS = 3
"""Number of solvers that a program keeps, for cold starts, warm ones, and swaps of breakpoints; each may take 60 MB."""

MAX_FUNCTIONS = 256
"""Number of expressions that a program keeps as functions to evaluate them again."""


@dataclass(eq=False)
class _Variable:
    symbol: Any
    scale: Array
    lower: Array
    upper: Array
    guess: Array


@dataclass(eq=False)
class _Constraint:
    expression: Any
    scale: Array
    lower: Array
    upper: Array
    entries: tuple[str, ...]


class ScaledMultipliers(NamedTuple):
    """Multipliers with signs and scale of IPOPT."""

    constraints: Array
    """(G,) multipliers of the constraints."""
    bounds: Array
    """(X,) multipliers of the bounds of the variables."""
    equations: Mask
    """(G,) True for constraints that are equations."""


class NamedProgram:
    """Variables, constraints and parameters of a nonlinear program, by name, and one solve of it."""

    def __init__(self, name: str = "problem") -> None:
        instance("name", name, str)
        self.name = name
        self.blocks: list[Any] = []
        self.directions = DIRECTIONS
        self.variables: dict[str, _Variable] = {}
        self._constraints: dict[str, _Constraint] = {}
        self._parameters: dict[str, tuple[Any, Array]] = {}
        # Names of variables and parameters by the hash of their symbol.
        self._names: dict[int, str] = {}
        self._objective: Any = ca.MX(0.0)
        self._solvers: dict[tuple[Ipopt, WarmStart | None], tuple[ca.Function, Watch | None]] = {}
        self._functions: dict[int, tuple[Any, ca.Function]] = {}

    # --- composition --------------------------------------------------------------------------------------------------

    def variable(
        self,
        name: str,
        size: int = 1,
        *,
        guess: ArrayLike = 0.0,
        lower: ArrayLike = -np.inf,
        upper: ArrayLike = np.inf,
        scale: ArrayLike = 1.0,
    ) -> Any:
        """Column of `size` unknowns.

        Args:
            guess, lower, upper, scale: a number for all, or one each, in the variable's own units.

        Raises:
            InputError: a name that is taken, a wrong size, bounds in the wrong order, or a scale that is not positive.
        """
        self._free(name)
        if size < 0:
            raise InputError(f"size of {name!r} is {size}; it must be at least 0")
        numbers = {"scale": scale, "lower": lower, "upper": upper, "guess": guess}
        table = {key: _table(f"{key} of {name!r}", value, size) for key, value in numbers.items()}
        _ordered(name, table)
        self.variables[name] = _Variable(ca.MX.sym(name, size), **table)
        self._names[self.variables[name].symbol.__hash__()] = name
        self._changed()
        return self.variables[name].symbol

    def parameter(self, name: str, value: ArrayLike) -> Any:
        """Column of numbers that may be changed between solves by `set_value`.

        Raises:
            InputError: a name that is taken, or a value that is not finite numbers.
        """
        self._free(name)
        numbers = np.asarray(value, dtype=float).ravel()
        self._parameters[name] = ca.MX.sym(name, len(numbers)), _table(f"value of {name!r}", numbers, len(numbers))
        self._names[self._parameters[name][0].__hash__()] = name
        self._changed()
        return self._parameters[name][0]

    def subject_to(
        self,
        name: str,
        expression: Any,
        *,
        lower: ArrayLike = 0.0,
        upper: ArrayLike = np.inf,
        scale: ArrayLike = 1.0,
        entries: Sequence[str] | None = None,
    ) -> None:
        """Constrain lower <= expression <= upper, or a comparison: `a == b`, `a >= b`, `a <= b`.

        Args:
            expression: of any shape; by default it must be at least 0.
            scale: its typical size; the tolerance on violations is relative to it.
            entries: labels of its rows; by default the name and a number.

        Raises:
            InputError: a name that is taken, a wrong size, or an expression without symbols.
        """
        self._free(name)
        if not isinstance(expression, ca.MX):
            raise InputError(f"constraint {name!r} is not an expression of the problem's variables: {expression!r}")
        if expression.is_op(ca.OP_EQ) or expression.is_op(ca.OP_LE) or expression.is_op(ca.OP_LT):
            equal = expression.is_op(ca.OP_EQ)
            expression, lower, upper = expression.dep(1) - expression.dep(0), 0.0, 0.0 if equal else np.inf
        size = expression.numel()
        numbers = {"scale": scale, "lower": lower, "upper": upper}
        table = {key: _table(f"{key} of {name!r}", value, size) for key, value in numbers.items()}
        _ordered(name, table)
        labels = entries or ([name] if size == 1 else [f"{name}, entry {k + 1}" for k in range(size)])
        if len(labels) != size:
            raise InputError(f"entries of {name!r} are {len(labels)} words; the constraint has {size} rows")
        self._constraints[name] = _Constraint(ca.vec(expression), **table, entries=tuple(labels))
        self._changed()

    def minimize(self, expression: Any) -> None:
        """Make `expression`, one number, the objective."""
        if ca.MX(expression).numel() != 1:
            raise InputError(f"the objective has shape {ca.MX(expression).shape}; it must be one number")
        self._objective = ca.MX(expression)
        self._changed()

    def maximize(self, expression: Any) -> None:
        """Make `-expression` the objective, which is minimised."""
        self.minimize(-expression)

    def set_value(self, parameter: Any, value: ArrayLike) -> None:
        """Set the value of a parameter, by its symbol or name."""
        name = self._name_of(parameter, self._parameters, "parameter")
        symbol, old = self._parameters[name]
        self._parameters[name] = symbol, _table(f"value of {name!r}", value, len(old))

    def set_guess(self, variable: Any, value: ArrayLike) -> None:
        """Set the start value of a variable, by its symbol or name."""
        name = self._name_of(variable, self.variables, "variable")
        self.variables[name].guess = _table(f"guess of {name!r}", value, len(self.variables[name].guess))

    def set_bounds(self, variable: Any, lower: ArrayLike, upper: ArrayLike) -> None:
        """Set the bounds of a variable, by its symbol or name."""
        name = self._name_of(variable, self.variables, "variable")
        each, bounds = self.variables[name], {"lower": lower, "upper": upper}
        table = {key: _table(f"{key} of {name!r}", value, len(each.guess)) for key, value in bounds.items()}
        _ordered(name, {**table, "scale": each.scale})
        each.lower, each.upper = table["lower"], table["upper"]

    def rename(self, name: str, entries: Sequence[str]) -> None:
        """Set the labels of the rows of a constraint."""
        self._constraints[name].entries = tuple(entries)

    def enter(self, block: Any) -> str:
        """Register a block and return its default name."""
        self.blocks.append(block)
        return f"equilibrium {len(self.blocks)}"

    def symbol(self, name: str) -> Any:
        """Symbol of a variable, a column.

        Raises:
            InputError: an unknown name.
        """
        return self.variables[self._name_of(name, self.variables, "variable")].symbol

    def constraint(self, name: str) -> Any:
        """Expression of a constraint, a column.

        Raises:
            InputError: an unknown name.
        """
        return self._constraints[self._name_of(name, self._constraints, "constraint")].expression

    def entries(self, name: str) -> tuple[str, ...]:
        """Labels of the rows of a constraint.

        Raises:
            InputError: an unknown name.
        """
        return self._constraints[self._name_of(name, self._constraints, "constraint")].entries

    @property
    def constraint_sizes(self) -> dict[str, int]:
        """Number of rows of every constraint, in the order of the program."""
        return {name: len(each.scale) for name, each in self._constraints.items()}

    # --- solution -----------------------------------------------------------------------------------------------------

    def attempt(
        self,
        solver: Ipopt,
        *,
        start: ProblemSolution | None = None,
        warm: WarmStart = AT_SOLUTION,
        interrupt: Callable[[Array, Array, Array, Array], bool] | None = None,
    ) -> ProblemSolution:
        """Solve once and return the result, solved or not; breakpoints keep their order.

        Args:
            start: earlier solution with its multipliers; `warm` says how close it is to that of the program.
            interrupt: function (x, g, multipliers of g, of x) -> whether to stop there, in the scale of the solver.
        """
        start_time = time.perf_counter()
        function, watch = self._solver(in_time(solver), warm=None if start is None else warm)
        variables, constraints = self.variables.values(), self._constraints.values()
        x, g = (Stacked(list(part)) for part in (variables, constraints))
        guess = {name: each.guess for name, each in self.variables.items()}
        inputs: dict[str, Any] = {}
        if start is not None:
            guess |= {name: v for name, v in start.values.items() if name in guess and v.shape == guess[name].shape}
            # IPOPT minimises f + lam g: its signs are opposite to those of `ProblemSolution`.
            inputs["lam_g0"], inputs["lam_x0"], _ = self.scaled_multipliers(start)
        inputs["x0"] = np.concatenate([*guess.values(), np.zeros(0)]) / x.scale
        p = np.concatenate([*(numbers for _, numbers in self._parameters.values()), np.zeros(0)])
        bounds = {"lbx": x.lower, "ubx": x.upper, "lbg": g.lower, "ubg": g.upper}
        bounds = {key: value / (x if key.endswith("x") else g).scale for key, value in bounds.items()}
        if watch is not None:
            watch.test = interrupt
        result = function(p=p, **inputs, **bounds)
        stats = function.stats()
        solution = {key: np.array(result[key]).ravel() for key in ("x", "g", "lam_x", "lam_g")}
        names = [label for each in constraints for label in each.entries]
        violations = violations_of(names, solution["g"] * g.scale, (g.lower, g.upper), g.scale, 10 * solver.tolerance)
        return ProblemSolution(
            status=ProblemStatus.of(stats["return_status"]),
            objective=float(result["f"]),
            values=self._split(solution["x"] * x.scale, self.variables),
            multipliers=self._split(-solution["lam_g"] / g.scale, self._constraints),
            bound_multipliers=self._split(-solution["lam_x"] / x.scale, self.variables),
            parameters={name: numbers.copy() for name, (_, numbers) in self._parameters.items()},
            violations=worst(violations, NAMED),
            statistics=ProblemStatistics(
                verdict=stats["return_status"],
                iterations=int(stats["iter_count"]),
                seconds=time.perf_counter() - start_time,
                unknowns=len(x.scale),
                constraints=len(g.scale),
            ),
            program=self,
        )

    def iterate(self, x: Array, multipliers: Array, of_bounds: Array) -> ProblemSolution:
        """Iterate of the solver as a solution that is not solved.

        Args:
            x, multipliers, of_bounds: unknowns, multipliers of constraints and bounds, with signs and scale of IPOPT.
        """
        scales = [Stacked(list(part.values())).scale for part in (self.variables, self._constraints)]
        return ProblemSolution(
            status=ProblemStatus.STOPPED,
            objective=math.nan,
            values=self._split(x * scales[0], self.variables),
            multipliers=self._split(-multipliers / scales[1], self._constraints),
            bound_multipliers=self._split(-of_bounds / scales[0], self.variables),
            parameters={name: numbers.copy() for name, (_, numbers) in self._parameters.items()},
            violations=(),
            statistics=ProblemStatistics(Watch.STOPPED, 0, 0.0, *map(len, scales)),
            program=self,
        )

    def derivative(self, name: str, values: Mapping[str, Array]) -> Any:
        """Sparse gradient of the objective ("nlp_grad_f") or Jacobian of the constraints ("nlp_jac_g"), scaled.

        An `attempt` before has built these functions.

        Args:
            values: variables; others have their guess, and parameters their present value.
        """
        function = next(function for function, _ in self._solvers.values())
        x = np.concatenate([values.get(key, each.guess) for key, each in self.variables.items()])
        p = np.concatenate([*(numbers for _, numbers in self._parameters.values()), np.zeros(0)])
        return function.get_function(name)(x / Stacked(list(self.variables.values())).scale, p)[1].sparse()

    def scaled_multipliers(self, at: ProblemSolution) -> ScaledMultipliers:
        """Multipliers of a solution, as IPOPT has them."""
        x, g = (Stacked(list(part.values())) for part in (self.variables, self._constraints))
        of_bounds = -self._known(at.bound_multipliers, self.variables) * x.scale
        return ScaledMultipliers(
            -self._known(at.multipliers, self._constraints) * g.scale, of_bounds, g.lower == g.upper
        )

    def violated(self, names: Sequence[str], values: dict[str, Array], tolerance: float) -> tuple[Violation, ...]:
        """Violations of the named constraints at values of the variables, worst first."""
        parts = [self._constraints[name] for name in names]
        g = Stacked(parts)
        column = self.evaluate(ca.veccat(ca.MX(0, 1), *(each.expression for each in parts)), values, {}).ravel()
        entries = [label for each in parts for label in each.entries]
        return worst(violations_of(entries, column, (g.lower, g.upper), g.scale, tolerance), NAMED)

    def failure(self, solution: ProblemSolution) -> str:
        """Message of a failed solve, with its status and worst constraints."""
        missed = (
            "; ".join(str(each) for each in solution.violations[:NAMED_VIOLATIONS]) or "all constraints are satisfied"
        )
        verdict = solution.statistics.verdict.replace("_", " ").lower()
        return (
            f"{self.name}: {solution.status} (IPOPT: {verdict}, {solution.statistics.iterations} iterations): {missed}"
        )

    def evaluate(self, expression: Any, values: dict[str, Array], parameters: dict[str, Array]) -> Array:
        """Value of an expression at numbers of the variables and parameters.

        Raises:
            InputError: the expression has symbols of another program.
        """
        symbols = [each.symbol for each in self.variables.values()] + [p for p, _ in self._parameters.values()]
        names = [*self.variables, *self._parameters]
        numbers = {name: each.guess for name, each in self.variables.items()}
        numbers |= {name: value for name, (_, value) in self._parameters.items()} | values | parameters
        # Blocks evaluate the same expressions after every solve. The expression is kept, so that its hash stays unique.
        key = expression.__hash__() if isinstance(expression, ca.MX) else None
        if key is None or key not in self._functions:
            function = function_of(symbols, [expression])
            if key is None:
                return np.array(function(*(numbers[name] for name in names)))
            while len(self._functions) >= MAX_FUNCTIONS:
                self._functions.pop(next(iter(self._functions)))
            self._functions[key] = expression, function
        return np.array(self._functions[key][1](*(numbers[name] for name in names)))

    # --- internal -----------------------------------------------------------------------------------------------------

    def _changed(self) -> None:
        """Drop solvers and functions of an earlier program."""
        self._solvers.clear()
        self._functions.clear()

    def _free(self, name: str) -> None:
        if name in self.variables or name in self._parameters or name in self._constraints:
            raise InputError(
                f"the name {name!r} is already used; variables, parameters and constraints need different names"
            )

    def _name_of(self, what: Any, table: dict[str, Any], kind: str) -> str:
        if isinstance(what, str):
            if what in table:
                return what
            raise InputError(f"there is no {kind} {what!r}{nearest(what, table)}")
        if isinstance(what, ca.MX) and (name := self._names.get(what.__hash__())) in table:
            return str(name)
        raise InputError(f"{what} is no {kind} of {self.name}; it must be one of its symbols or their name")

    def _known(self, numbers: dict[str, Array], table: dict[str, Any]) -> Array:
        """Numbers of an earlier solution in one column; 0 for variables that it does not have in this size."""
        sizes = {name: len(each.scale) for name, each in table.items()}
        parts = [
            numbers[k] if k in numbers and len(numbers[k]) == size else np.zeros(size) for k, size in sizes.items()
        ]
        return np.concatenate([*parts, np.zeros(0)])

    def _split(self, column: Array, table: dict[str, Any]) -> dict[str, Array]:
        stops = np.cumsum([len(each.scale) for each in table.values()])[:-1]
        return dict(zip(table, np.split(column, stops), strict=True)) if table else {}

    def _solver(self, solver: Ipopt, *, warm: WarmStart | None) -> tuple[ca.Function, Watch | None]:
        key = solver, warm
        if key not in self._solvers:
            if not self.variables:
                raise InputError(f"{self.name} has no variables")
            variables, constraints = list(self.variables.values()), list(self._constraints.values())
            parameters = [symbol for symbol, _ in self._parameters.values()]
            watch = None
            if any(block.swappable() for block in self.blocks):
                unknowns, rows = (sum(len(each.scale) for each in part) for part in (variables, constraints))
                watch = Watch(unknowns, rows, sum(symbol.numel() for symbol in parameters))
            # Cold and warm starts differ in options of IPOPT only.
            alike = next((function for (other, _), (function, _) in self._solvers.items() if other == solver), None)
            function = ipopt_function(
                variables,
                parameters,
                self._objective,
                constraints,
                solver,
                warm=warm,
                directions=self.directions,
                derivatives=alike,
                watch=watch,
            )
            self._solvers[key] = function, watch
            while len(self._solvers) > MAX_SOLVERS:
                self._solvers.pop(next(iter(self._solvers)), None)
        return self._solvers[key]


def in_time(solver: Ipopt) -> Ipopt:
    """Settings with the time left to the nearest limit, rounded down to a power of two: a solver is built for each."""
    check_time()
    left = time_left()
    if left >= solver.time_limit:
        return solver
    return replace(solver, time_limit=2.0 ** math.floor(math.log2(max(left, MIN_SECONDS))))


def _table(what: str, value: ArrayLike, size: int) -> Array:
    """Column (size,) of finite numbers; bounds may be infinite."""
    try:
        numbers = np.asarray(value, dtype=float)
        table = np.broadcast_to(numbers.ravel() if numbers.ndim else numbers, (size,)).copy()
    except (TypeError, ValueError):
        raise InputError(f"{what} is {value!r}; it must be one number or {size}") from None
    bound = what.startswith(("lower", "upper"))
    if np.isnan(table).any() or (not bound and not np.isfinite(table).all()):
        raise InputError(f"{what} is {table.tolist()}; every number must be finite")
    return table


def _ordered(name: str, table: dict[str, Array]) -> None:
    if (table["lower"] > table["upper"]).any():
        raise InputError(f"bounds of {name!r} are {table['lower'].tolist()} to {table['upper'].tolist()}: out of order")
    if (table["scale"] <= 0).any():
        raise InputError(f"scale of {name!r} is {table['scale'].tolist()}; it must be greater than 0")
