"""Every equilibrium at given joint values, stable and unstable."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..arguments import typed
from ..block.transcription.reduced import ReducedProblem
from ..equilibrium.answer import to_equilibrium
from ..equilibrium.member import Point
from ..equilibrium.result import Equilibrium
from ..equilibrium.unloaded import PlainPoint, Unloaded
from ..errors import SolveError
from ..robots.load import Load
from ..robots.robot import Robot, joint_values
from ..solvers.parallel.blas import small
from ..solvers.time_limit import TIME_LIMIT, limited
from ..typing import Array
from .certificate import worst_case
from .groups import groups_of
from .loaded_equilibria import add, degree, loaded_equilibria
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

    A positive certificate of tubes on the centreline proves that there is only one; then nothing is searched. Otherwise
    tubes that act on one another are searched group by group (see `stability.groups`).

    Groups of up to three tubes, as in every segment of an eccentric robot, are searched systematically. The joint
    rotations are tabulated over one turn of each tip angle. Every cell of the grid that may contain a solution is
    solved. The grid is refined until the set no longer changes and its topological degree is 1, as theory demands. On
    the centreline the degree is the sum of (-1)^index. Larger groups start from a Sobol sequence, and the degree is the
    only check.

    Args:
        rotations, translations: (n,) rad and m; translations default to home. Rotations are not wrapped.
        load: external load. The equilibria are then found from many starting points, with the degree as the only check
            (see `stability.loaded_equilibria`). They are ordered by potential energy; without one, the largest margin
            comes first.
        search: settings of the search.
        time_limit: maximum run time, s.

    Raises:
        InputError: wrong number of joint values, one that is not finite, a tube out of its actuator; a load on an
            eccentric robot.
        SolveError: the degree of the set is not 1: an equilibrium is missing, or the joint values are a fold.
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
    found = _without_load(Unloaded.of(robot, alpha, shift), search)
    equilibria = [to_equilibrium(point, "search over tip angles") for point in found]
    if load is not None:
        return loaded_equilibria(robot, alpha, shift, load, equilibria, search)
    return sorted(equilibria, key=lambda e: e.energy)


def _without_load(member: Unloaded, search: EquilibriaSearch) -> list[PlainPoint]:
    """All solutions of a problem; raises SolveError where their degree is not 1."""
    problem, rotations = member.problem, member.rotations
    surely = search.certain if problem.assembly.even else search.certain_of_pieces
    if not problem.assembly.eccentric and worst_case(problem)[0] > surely:
        result = member.descend(np.zeros(problem.size))
        if result.converged:
            return [Point.of(member, result)]
    found = list[PlainPoint]()
    for theta in profiles(problem, _all_tips(problem, rotations, search)):
        add(found, member, member.unknowns(theta), search.same)
    whole = degree(found)
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
                held = bundle.transmission.copy()
                # Straight tubes that only keep a place have no torsion to transmit.
                held[: len(group.tubes)] += (extra / problem.assembly.held_stiffness)[group.tubes]
                known[key] = preimage(bundle, held, rotations[group.tubes], search)
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
