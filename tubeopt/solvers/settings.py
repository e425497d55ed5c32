"""The settings of the solvers: what a user may want to change, as documented fields."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

from ..arguments import typed
from ..display import Displayed
from ..errors import InputError, Settings, choice, positive, whole
from .time_limit import TIME_LIMIT


@dataclass(frozen=True)
class Newton(Settings):
    """Settings of Newton's method and of the energy descent before it, for an equilibrium.

    Raises:
        InputError: a field out of its range.
    """

    _none: ClassVar[tuple[str, ...]] = ("refinements", "loaded_refinements")

    last_step: float = 1e-6
    """A step below this (rad) is the last, if it leaves a residual of round-off, as quadratic convergence does."""
    round_off: float = 1e-12
    """Residual or step (rad) close to round-off; smaller ones are no sign of divergence."""
    longest_step: float = 1.0
    """Descent turns no point by more than this (rad) at once: well inside the period of the energy."""
    iterations: int = 20
    """Maximum number of Newton iterations."""
    descent_iterations: int = 60
    """Maximum number of descent iterations."""
    refinements: int = 6
    """Most times that the pieces of the mesh are halved."""
    loaded_refinements: int = 4
    """Maximum number of mesh refinements under load."""
    margin_tolerance: float = 1e-8
    """Wanted accuracy under load of margins so close to 1 that they need a check of their own."""


NEWTON = Newton()
"""What solvers do unless they are told otherwise."""


@dataclass(frozen=True)
class Continuation(Settings):
    """How a branch of equilibria is followed, and where a robot goes that has lost its own.

    Raises:
        InputError: a count that is no whole number of at least 1, another number that is not positive.
    """

    largest_ratio: float = 0.3
    """Newton must shrink its steps at least so much: beyond that it may be on its way to another branch."""
    largest_twist: float = 0.6
    """Largest change (rad) of the twist theta - alpha at a point in one step."""
    soft_twist: float = 0.1
    """The same (rad) where the margin is 0. The two stable branches beside a narrow fold are little farther apart."""
    largest_turn: float = 0.3
    """Largest change (rad) of a joint rotation in one step of a path: small against a turn, after which another branch
    looks like the one that is followed."""
    largest_shift: float = 0.05
    """Of a translation, as a fraction of the longest tube."""
    home_turn: float = math.pi / 8
    """Largest turn (rad) of a tube per step of the path from home, by which a cold start goes that ended in no stable
    equilibrium."""
    shortest_step: float = 1e-8
    """Fraction of a path or a load below which a step that fails means that the branch has ended."""
    sharpest_step: float = 1e-11
    """The same where no fold and no bifurcation is found there: the branch may only bend sharply."""
    towards_end: float = 0.8
    """Part of the way to where the margin seems to vanish that is stepped at once."""
    symmetric: float = 1e-5
    """A growing load whose part along the softest direction is smaller than this meets a bifurcation there."""
    compiled_step: float = 1e-3
    """Fraction of a load below which the compiled kernel leaves a step that fails to the general solver."""
    shortest_compiled: float = 1 / 128
    """Part of the longest step along a path below which the general solver takes over from the compiled kernel."""
    least_stiffness: float = 1e-6
    """Margin below which errors no longer grow in the estimate."""
    hardly_softened: float = 0.99
    """Margins above need the check of their accuracy; the others are surer than the shape."""
    fold_steps: int = 25
    """Of Newton's method to a fold at most."""
    fold_difference: float = 1e-4
    """Step of the differences along the softest direction, as a turn (rad) of a tube or of the arm."""
    widest: float = 1e-3
    """Largest part of the way between the last stable point that was found and the one where stability is lost."""
    branch_points: int = 4000
    """Of a branch that is traced through its folds, at most."""
    nudge: float = 1e-2
    """Push (rad) along the softest direction that starts a fall."""
    stride: float = 0.1
    """Largest turn (rad) of a point in one step downhill: short, so that the steps stay in the valley they are in."""
    flow_steps: int = 2000
    """Of a fall at most."""
    smooth_turn: float = 0.05
    """A loss of stability after which no point turns by more than this (rad) is a bifurcation into a neighbouring
    branch, not a snap."""
    least_turn: float = 1e-3
    """That (rad) tells where the robot lands from where it was."""
    past: float = 1e-4
    """Fraction of a way, or part of a load, by which a smooth change of branch is left behind, where both branches are
    one."""
    load_stage: float = 4.0
    """Every stage of a growing load ends with so many times the load of the one before, on a mesh of its own."""
    rubbing_steps: int = 15
    """Of Newton's method with friction at most."""
    stick_patience: int = 4
    """Exchanges between sticking and slipping without fewer wrong rows, after which they are taken to go in circles."""
    stick_changes: int = 20
    """Per row, after which the descent that then follows gives up: round-off has won."""
    onward: float = 0.9
    """Cosine of the angle between two turns of the bases from which the second goes on the way of the first."""
    towards_rubbing_fold: float = 0.72
    """Part of the way to a fold with friction in one step. The state moves as the square root of the way that is left,
    on which Newton's method shrinks its steps enough (`largest_ratio`) up to 0.75 of it."""
    rubbing_past: float = 1e4
    """Shortest steps by which the joints are past the last state that was found when a robot with friction flows from
    it."""
    landed_step: float = 1e-3
    """Part of the longest step with which a motion with friction goes on from where it landed, and which no path is too
    short for."""
    hop: float = 0.1
    """Part of the longest step below which a state that only friction holds may hop."""
    rubbing_waypoints: int = 256
    """That are handed to the compiled kernel at once."""


CONTINUATION = Continuation()

HESSIANS = ("exact", "limited-memory")

NO_SENSITIVITIES = {"no_nlp_grad": True, "calc_lam_p": False}
"""Options of `casadi.nlpsol`: how an optimum changes with the parameters, nobody asks; the derivatives that would tell
take as long to build as all others."""


LINEAR_SOLVERS = ("mumps", "ma27", "ma57", "ma77", "ma86", "ma97", "pardiso", "pardisomkl", "spral", "wsmp")
"""Those that IPOPT knows, where they are installed."""


@typed
@dataclass(frozen=True)
class Ipopt(Displayed):
    """Settings of IPOPT, for a `Problem` or the equations of an equilibrium.

    Raises:
        InputError: a field out of its range.
    """

    tolerance: float = 1e-10
    """Tolerance of optimality and of scaled constraints. An "acceptable" solution of IPOPT counts as a failure."""
    constraint_tolerance: float | None = None
    """Tolerance of scaled constraints; None is `tolerance`."""
    iterations: int = 500
    """Maximum number of iterations."""
    time_limit: float = TIME_LIMIT
    """s, after which it stops where it is."""
    linear_solver: str = "mumps"
    """Linear solver of the Newton steps; "mumps" comes with CasADi."""
    expand: bool = False
    """Write the program out in scalars first: a solve is faster, the building slower. For one to three blocks."""
    hessian: str = "exact"
    """Second derivatives: "exact", or "limited-memory"."""
    barrier: float = 0.1
    """Initial barrier parameter of a cold start."""
    print_level: int = 0
    """0 silent, 5 a line for every iteration."""

    def __post_init__(self) -> None:
        positive("tolerance", self.tolerance)
        if self.constraint_tolerance is not None:
            positive("constraint_tolerance", self.constraint_tolerance)
        positive("barrier", self.barrier)
        if self.time_limit != math.inf:
            positive("time_limit", self.time_limit)
        choice("hessian", self.hessian, HESSIANS)
        choice("linear_solver", self.linear_solver, LINEAR_SOLVERS)
        whole("iterations", self.iterations, 1)
        if whole("print_level", self.print_level, 0) > 12:
            raise InputError(f"print_level is {self.print_level}; it must lie between 0 and 12")

    def options(self, *, warm: bool) -> dict[str, Any]:
        """Options of `casadi.nlpsol`; `warm` for a start with multipliers."""
        own: dict[str, Any] = {
            "tol": self.tolerance,
            "constr_viol_tol": self.constraint_tolerance or self.tolerance,
            "max_iter": self.iterations,
            "linear_solver": self.linear_solver,
            "hessian_approximation": self.hessian,
            "mu_init": self.barrier,
            "print_level": self.print_level,
            "sb": "yes",
            # "Acceptable" is not converged: what is not within the tolerance is a failure, and said to be one.
            "acceptable_iter": 0,
        }
        if self.time_limit < math.inf:
            own["max_wall_time"] = self.time_limit
        if warm:
            near = dict.fromkeys(
                (f"warm_start_{what}" for what in ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac")),
                1e-9,
            )
            own |= {"warm_start_init_point": "yes", "warm_start_mult_bound_push": 1e-9, "mu_init": 1e-9, **near}
        return {
            "print_time": False,
            "show_eval_warnings": False,
            **NO_SENSITIVITIES,
            **{f"ipopt.{key}": value for key, value in own.items()},
        }
