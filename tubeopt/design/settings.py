"""How hard a design is searched for: what a user may want to change, as documented fields."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ..errors import Settings
from ..solvers.settings import Ipopt

COLLOCATION = Ipopt(tolerance=1e-8, constraint_tolerance=1e-10, iterations=300, barrier=1e-4)


@dataclass(frozen=True)
class DesignSolver(Settings):
    """How hard a design is searched for, and its promises are checked; a field of a `DesignTask`.

    Args:
        retries: starts that are tried before a task counts as infeasible, where fewer were asked for.
        sampled_designs: dimensions drawn for each start, of which those that make a robot come first.
        sampled_poses: joint values drawn for every pose that is free, of which the best begins.
        joint_restarts: times that other joint values are tried for dimensions from which least squares do not get near.
        pose_turn: distance (m) from its target that is as bad, in the guess of a pose, as a turn by 1 rad.
        near: violation, in steps of its limit, from which IPOPT is trusted to get inside.
        inside: steps by which least squares aims inside every limit, so that IPOPT starts in the interior.
        same_design: dimensions closer than this, in steps of their scale, are one design.
        collocation: how IPOPT solves the program of method "collocation". Its start is feasible: a larger barrier would
            drive it far away first, through designs that no branch connects.
        iterations: of IPOPT, before it counts as stuck on a kink.
        ball_iterations: of IPOPT from the optimum in the cubes around targets to that in the balls.
        rim: part of a target's tolerance from a side of the cube around it within which that side binds, and of the
            objective that it may cost to stay inside the cubes.
        orders: of breakpoints, most that are tried for the one that holds the best optimum.
        order_gain: relative, of the objective, below which another order is no better.
        closed_section: length, m, of a section between breakpoints below which it is closed.
        opened_section: length, m, by which one is opened on the other side of a kink.
        exchange_rounds: of adding worst cases (of a box of translations, a joint path, a workspace).
        path_points: between two task poses, at which a joint path is followed.
        points_per_round: of a workspace that is not covered, most that are added in a round.
        relaxed_starts: that failed, from which the smallest relaxation is looked for.
        least_slack: in steps of its limit, below which a limit needs no relaxation.
        slack_missing: violation, in steps, at which slacks count as sufficient.
        price_near: steps of a limit within which it may bind, where IPOPT has not said which do.
        price_gap: part of the objective's slope that the conditions of optimality may leave over.
        least_price: relative to the largest, below which a limit is not told to bind.
        simplex_step: size of the first simplex of a search without derivatives, as a share of every range.
        simplex_size: share of the ranges below which a simplex has converged.
        force_rounds: designs that are made in search of the one that bears a force.
        force_accuracy: of the floor of the certificate without force that this one needs.
        searched_translations: of certified ones, where the least margin is also looked for by search.
        perturbed_robots: with tubes that are off by all that is allowed, whose certificates are looked at.

    Raises:
        InputError: a count that is no whole number of at least 1 (0 for `joint_restarts`), another number that is
            not positive.
    """

    retries: int = 4
    sampled_designs: int = 32
    sampled_poses: int = 256
    joint_restarts: int = 2
    pose_turn: float = 5e-3
    near: float = 0.5
    inside: float = 1e-3
    same_design: float = 1e-3
    collocation: Ipopt = COLLOCATION
    iterations: int = 150
    ball_iterations: int = 60
    rim: float = 1e-3
    orders: int = 6
    order_gain: float = 1e-7
    closed_section: float = 1e-5
    opened_section: float = 2e-6
    exchange_rounds: int = 12
    path_points: int = 16
    points_per_round: int = 3
    relaxed_starts: int = 2
    least_slack: float = 1e-5
    slack_missing: float = 1e-5
    price_near: float = 1e-3
    price_gap: float = 0.02
    least_price: float = 1e-6
    simplex_step: float = 0.2
    simplex_size: float = 1e-3
    force_rounds: int = 16
    force_accuracy: float = 2e-3
    searched_translations: int = 3
    perturbed_robots: int = 12

    _none: ClassVar[tuple[str, ...]] = ("joint_restarts",)


DEFAULT_SOLVER = DesignSolver()
