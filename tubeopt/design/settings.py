"""How hard a design is searched for: what a user may want to change, as documented fields."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ..errors import Settings
from ..solvers.settings import Ipopt

COLLOCATION = Ipopt(tolerance=1e-8, constraint_tolerance=1e-10, iterations=300, barrier=1e-4)


@dataclass(frozen=True)
class StartSearch(Settings):
    """Where designs begin.

    Raises:
        InputError: a count that is no whole number of at least 1 (0 for `restarts`), another number that is not
            positive.
    """

    retries: int = 4
    """Starts that are tried before a task counts as infeasible, where fewer were asked for."""
    designs: int = 32
    """Dimensions drawn for each start, of which those that make a robot come first."""
    poses: int = 256
    """Joint values drawn for every pose that is free, of which the best begins."""
    restarts: int = 2
    """Times that other joint values are tried for dimensions from which least squares do not get near."""
    pose_turn: float = 5e-3
    """Distance (m) from its target that is as bad, in the guess of a pose, as a turn by 1 rad."""
    same_design: float = 1e-3
    """Dimensions closer than this, in steps of their scale, are one design."""

    _none: ClassVar[tuple[str, ...]] = ("restarts",)


@dataclass(frozen=True)
class OptimumSearch(Settings):
    """How the best design near a start is found, by least squares and by IPOPT."""

    near: float = 0.5
    """Violation, in steps of its limit, from which IPOPT is trusted to get inside."""
    inside: float = 1e-3
    """Steps by which least squares aims inside every limit, so that IPOPT starts in the interior."""
    iterations: int = 150
    """Of IPOPT, before it counts as stuck on a kink."""
    ball_iterations: int = 60
    """Of IPOPT from the optimum in the cubes around targets to that in the balls."""
    rim: float = 1e-3
    """Part of a target's tolerance from a side of the cube around it within which that side binds, and of the objective
    that it may cost to stay inside the cubes."""


@dataclass(frozen=True)
class OrderSearch(Settings):
    """Which order of breakpoints holds the best optimum."""

    most: int = 6
    """That are tried."""
    gain: float = 1e-7
    """Relative, of the objective, below which another order is no better."""
    closed_section: float = 1e-5
    """Length, m, of a section between breakpoints below which it is closed."""
    opened_section: float = 2e-6
    """Length, m, by which one is opened on the other side of a kink."""


@dataclass(frozen=True)
class ExchangeSearch(Settings):
    """How worst cases are found and added, of a box of translations, a joint path, a workspace."""

    rounds: int = 12
    """In which worst cases are found and added, at most."""
    path_points: int = 16
    """Between two task poses, at which a joint path is followed."""
    points: int = 3
    """Of a workspace that is not covered, most that are added in a round."""


@dataclass(frozen=True)
class RelaxationSearch(Settings):
    """How the smallest relaxation of a task that is infeasible is found."""

    starts: int = 2
    """That failed, from which it is looked for."""
    least_slack: float = 1e-5
    """In steps of its limit, below which a limit needs no relaxation."""
    missing: float = 1e-5
    """Violation, in steps, at which slacks count as sufficient."""


@dataclass(frozen=True)
class Pricing(Settings):
    """Which limits bind, and what they cost, where IPOPT has not said so."""

    near: float = 1e-3
    """Steps of a limit within which it may bind."""
    gap: float = 0.02
    """Part of the objective's slope that the conditions of optimality may leave over."""
    least: float = 1e-6
    """Relative to the largest price, below which a limit is not told to bind, whoever has found it."""


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
