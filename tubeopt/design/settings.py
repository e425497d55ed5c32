"""How hard a design is searched for: what a user may want to change, as documented fields."""

from __future__ import annotations

from dataclasses import dataclass

from ..display import Displayed
from ..errors import check_settings


@dataclass(frozen=True)
class DesignSolver(Displayed):
    """How hard a design is searched for, and its promises are checked; a field of a `DesignTask`.

    Args:
        retries: starts that are tried before a task counts as infeasible, where fewer were asked for.
        sampled_designs: dimensions drawn for each start, of which those that make a robot come first.
        sampled_poses: joint values drawn for every pose that is free, of which the best begins.
        joint_restarts: times that other joint values are tried for dimensions from which least squares do not get near.
        iterations: of IPOPT, before it counts as stuck on a kink.
        ball_iterations: of IPOPT from the optimum in the cubes around targets to that in the balls.
        orders: of breakpoints, most that are tried for the one that holds the best optimum.
        exchange_rounds: of adding worst cases (of a box of translations, a joint path, a workspace).
        path_points: between two task poses, at which a joint path is followed.
        points_per_round: of a workspace that is not covered, most that are added in a round.
        relaxed_starts: that failed, from which the smallest relaxation is looked for.
        force_rounds: designs that are made in search of the one that bears a force.
        force_accuracy: of the floor of the certificate without force that this one needs.
        searched_translations: of certified ones, where the least margin is also looked for by search.
        perturbed_robots: with tubes that are off by all that is allowed, whose certificates are looked at.

    Raises:
        InputError: a count that is no whole number of at least 1 (0 for `joint_restarts`), an accuracy that is not
            positive.
    """

    retries: int = 4
    sampled_designs: int = 32
    sampled_poses: int = 256
    joint_restarts: int = 2
    iterations: int = 150
    ball_iterations: int = 60
    orders: int = 6
    exchange_rounds: int = 12
    path_points: int = 16
    points_per_round: int = 3
    relaxed_starts: int = 2
    force_rounds: int = 16
    force_accuracy: float = 2e-3
    searched_translations: int = 3
    perturbed_robots: int = 12

    def __post_init__(self) -> None:
        check_settings(self, ("joint_restarts",))


DEFAULT_SOLVER = DesignSolver()
