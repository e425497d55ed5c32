"""Every equilibrium at given joint values, stable and unstable."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike

from ..arguments import typed
from ..block.transcription.reduced import ReducedProblem, to_unknowns
from ..equilibrium.result import Equilibrium
from ..equilibrium.solving import DEFAULT_DISCRETISATION, Solution, reduced_problem, to_equilibrium
from ..errors import SolveError
from ..robots.load import Load
from ..robots.robot import Robot, joint_values
from ..solvers.newton import descend, newton
from ..solvers.parallel.blas import small
from ..solvers.time_limit import TIME_LIMIT, limited
from ..typing import Array
from .certificate import worst_case
from .groups import groups_of
from .loaded_equilibria import degree, loaded_equilibria
from .settings import DEFAULT_EQUILIBRIA_SEARCH, EquilibriaSearch
from .shooting import profiles
from .tips import preimage


@typed
@small
@limited
def find_equilibria(
    robot: Robot,
    rotations: ArrayLike,
    translations: ArrayLike | None = None,
    *,
    load: Load | None = None,
    search: EquilibriaSearch = DEFAULT_EQUILIBRIA_SEARCH,
    time_limit: float = TIME_LIMIT,
) -> list[Equilibrium]:
    """All equilibria at given joint values, the lowest energy first.

    Where the certificate of tubes on the centreline is positive there is one, and no search. Else tubes that act on one
    another are searched group by group (see `stability.groups`). For up to three tubes in a group, as in every segment
    of an eccentric robot, the search is systematic: the joint rotations are tabulated over one turn of each tip angle,
    every cell of a grid that may hold a solution is solved, and the grid is refined until the set no longer changes
    and its topological degree, on the centreline the sum of (-1)^index, is 1, as it must be. For more tubes the
    starting points are a Sobol sequence, and the degree is the only check.

    Args:
        rotations, translations: (n,) rad and m; translations default to home. Rotations are not wrapped.
        load: forces that keep their direction; the equilibria are then ordered by potential energy, and found from many
            starting points, with the degree as the check (see `stability.loaded_equilibria`).
        search: how they are searched for.
        time_limit: s, on the clock.

    Raises:
        InputError: wrong number of joint values, one that is not finite, a tube out of its actuator; a load with a
            moment or one that turns with the tip, or on an eccentric robot.
        SolveError: the degree of the set that was found is not 1: an equilibrium is missing, or the joint values are
            a fold.
        TimeLimitError: (a SolveError) the time limit was reached before there was an answer.

    Examples:
        >>> import numpy as np
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/two_tube.yaml")
        >>> [e.stable for e in tubeopt.find_equilibria(robot, np.radians([190, 0]))]
        [True, True, False]
    """
    alpha, place = joint_values(robot, rotations, translations)
    shift = tuple(place.tolist())
    problem = reduced_problem(robot, shift, DEFAULT_DISCRETISATION)
    found = all_solutions(problem, alpha, search)
    equilibria = [to_equilibrium(robot, s, shift, ("newton", "search over tip angles", 0.0)) for s in found]
    if load is not None:
        return loaded_equilibria(robot, alpha, shift, load, equilibria, search)
    return sorted(equilibria, key=lambda e: e.energy)


def all_solutions(
    problem: ReducedProblem, rotations: Array, search: EquilibriaSearch = DEFAULT_EQUILIBRIA_SEARCH
) -> list[Solution]:
    """All solutions of a reduced problem; raises SolveError where their degree is not 1."""
    surely = search.certain_of_pieces if problem.assembly.general else search.certain
    if not problem.assembly.eccentric and worst_case(problem)[0] > surely:
        result = descend(problem, rotations, np.zeros(problem.size))
        if result.converged:
            return [Solution.of(problem, rotations, result)]
    found = _solve_from(problem, rotations, profiles(problem, _all_tips(problem, rotations, search)), search.same)
    whole = degree(each.result for each in found)
    if whole != 1:
        raise SolveError(_incomplete(len(found), whole))
    return found


def _all_tips(problem: ReducedProblem, rotations: Array, search: EquilibriaSearch) -> Array:
    """(S, n) tip angles that lead to the joint rotations: of one group after the other, from the base to the tip.

    Off the centreline every solution of the groups below gives its own transmissions to those that pass through them.
    """
    # The tip of a tube that nothing turns is where its joint is.
    branches = [(rotations.copy(), np.zeros(problem.assembly.n_tubes))]
    for group in groups_of(problem):
        bundle, known, longer = group.bundle, {}, []
        for tips, extra in branches:
            key = extra.tobytes()
            if key not in known:
                # Straight tubes that only keep a place have no torsion to transmit.
                own = np.pad(extra[group.tubes], (0, bundle.n_tubes - len(group.tubes)))
                known[key] = preimage(bundle, bundle.transmission + own, rotations[group.tubes], search)
            found = known[key]
            if not found.settled:
                raise SolveError(_incomplete(len(found.tips), int(found.sign.sum())))
            for angles, travel in zip(found.tips, found.travel, strict=True):
                turned = tips.copy()
                turned[group.tubes] = angles
                more = travel[group.seat] - bundle.length.sum() if bundle.place else 0.0
                longer.append((turned, extra + more))
        branches = longer
    return np.array([tips for tips, _ in branches])


def _incomplete(count: int, degree: int) -> str:
    why = f"of degree {degree} instead of 1" if degree != 1 else "more of them on every finer grid"
    return f"{count} equilibria were found, {why}: one is missing, or the joint values are at a fold, where two are one"


def _solve_from(problem: ReducedProblem, rotations: Array, profiles: Iterable[Array], same: float) -> list[Solution]:
    """Newton on the collocation equations from rotations (N, n) at their points, one after the other."""
    out: list[Solution] = []
    for theta in profiles:
        result = newton(problem, rotations, to_unknowns(problem, rotations, theta))
        others = (np.abs(result.state.theta - kept.result.state.theta).max(initial=0.0) for kept in out)
        if result.converged and all(apart > same for apart in others):
            out.append(Solution.of(problem, rotations, result))
    return out
