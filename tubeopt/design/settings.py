"""How hard a design is searched for: what a user may want to change, as documented fields."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ..errors import Settings
from ..solvers.settings import Ipopt

COLLOCATION = Ipopt(tolerance=1e-8, constraint_tolerance=1e-10, iterations=300, barrier=1e-4)


@dataclass(frozen=True)
class StartSearch(Settings):
    """Settings of the starts of a design.

    Raises:
        InputError: a count that is no whole number of at least 1 (0 for `restarts`), another number that is not
            positive.
    """

    retries: int = 4
    """Starts that are tried before a task counts as infeasible, where fewer were asked for."""
    designs: int = 32
    """Number of random dimensions per start; those of possible robots come first."""
    poses: int = 256
    """Number of random joint values per free pose; the best is the start."""
    restarts: int = 2
    """Number of retries with other joint values if least squares do not come near."""
    pose_turn: float = 5e-3
    """Distance (m) from its target that is as bad, in the guess of a pose, as a turn by 1 rad."""
    same_design: float = 1e-3
    """Dimensions closer than this, in steps of their scale, are one design."""

    _none: ClassVar[tuple[str, ...]] = ("restarts",)


@dataclass(frozen=True)
class OptimumSearch(Settings):
    """Settings of the local search by least squares and IPOPT."""

    near: float = 0.5
    """Violation, in steps of its limit, below which IPOPT takes over."""
    inside: float = 1e-3
    """Distance inside every limit that least squares aim for, in steps, so that IPOPT starts in the interior."""
    iterations: int = 150
    """Maximum number of IPOPT iterations before it counts as stuck on a kink."""
    ball_iterations: int = 60
    """Maximum number of IPOPT iterations from the optimum in the cubes around targets to that in the balls."""
    rim: float = 1e-3
    """Relative distance from a side of a target's cube within which that side is active, and relative cost that staying
    in the cube may have.
    """


@dataclass(frozen=True)
class OrderSearch(Settings):
    """Settings of the search over orders of breakpoints."""

    most: int = 6
    """Maximum number of orders tried."""
    gain: float = 1e-7
    """Relative, of the objective, below which another order is no better."""
    closed_section: float = 1e-5
    """Length, m, of a section between breakpoints below which it is closed."""
    opened_section: float = 2e-6
    """Length of a section that is opened on the other side of a kink, m."""


@dataclass(frozen=True)
class ExchangeSearch(Settings):
    """Settings for finding and adding worst cases of a box of translations, a joint path, or a workspace."""

    rounds: int = 12
    """Maximum number of rounds."""
    path_points: int = 16
    """Number of points of a joint path between two task poses."""
    points: int = 3
    """Maximum number of uncovered workspace points added per round."""


@dataclass(frozen=True)
class RelaxationSearch(Settings):
    """Settings of the search for the smallest relaxation of an infeasible task."""

    starts: int = 2
    """Number of failed starts that the search uses."""
    least_slack: float = 1e-5
    """Slack, in steps of its limit, below which a limit needs no relaxation."""
    missing: float = 1e-5
    """Violation, in steps, at which slacks count as sufficient."""


@dataclass(frozen=True)
class Pricing(Settings):
    """Settings for active limits and their prices, where IPOPT has not returned them."""

    near: float = 1e-3
    """Steps of a limit within which it may bind."""
    gap: float = 0.02
    """Part of the objective's slope that the conditions of optimality may leave over."""
    least: float = 1e-6
    """Price, relative to the largest, below which a limit counts as inactive."""


@dataclass(frozen=True)
class DesignSolver(Settings):
    """Settings of the search for a design and of its checks; a field of a `DesignTask`."""

    starts: StartSearch = StartSearch()
    """Settings of the starts."""
    optimum: OptimumSearch = OptimumSearch()
    """Settings of the local optimisation from a start."""
    orders: OrderSearch = OrderSearch()
    """Settings of the search over orders of breakpoints."""
    collocation: Ipopt = COLLOCATION
    """IPOPT settings of method "collocation". Its start is feasible: a larger barrier would first move far away,
    through designs that no branch connects.
    """
    exchange: ExchangeSearch = ExchangeSearch()
    """Settings for finding and adding worst cases."""
    relaxation: RelaxationSearch = RelaxationSearch()
    """Settings for finding the smallest relaxation of an infeasible task."""
    pricing: Pricing = Pricing()
    """Settings for active limits and their prices."""
    simplex_step: float = 0.2
    """Size of the first simplex of a search without derivatives, as a share of every range."""
    simplex_size: float = 1e-3
    """Share of the ranges below which a simplex has converged."""
    force_rounds: int = 16
    """Designs tried in the search for one that withstands a force."""
    force_accuracy: float = 2e-3
    """Accuracy of the required certificate without force."""
    searched_translations: int = 3
    """Number of certified translations at which the smallest margin is also searched."""
    perturbed_robots: int = 12
    """Number of robots with deviating tubes, within the allowed errors, for which the certificate is checked."""


DEFAULT_SOLVER = DesignSolver()
