"""The verdict on a robot: proved that it cannot snap, shown that it can, or open."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from ..errors import SolveError
from ..robots.robot import Robot, is_general
from ..solvers.parallel.blas import small
from .certificate import certify
from .eccentric_verdict import judge_eccentric
from .search import search_snap
from .settings import DEFAULT_SEARCH, SnapSearch
from .verdict import Verdict
from .worst import worst_margin


@small
def judge(
    robot: Robot,
    translations: ArrayLike | None = None,
    *,
    effort: SnapSearch = DEFAULT_SEARCH,
    progress: Callable[[int, int], object] | None = None,
) -> Verdict:
    """Prove that a robot cannot snap at given translations, or find a snap.

    Where the certificate is not above 0, the robot is turned from its relaxed pose, all tubes curving to one side,
    until it snaps; inside its joint limits where search finds a snap there, else beyond them (see
    `stability.search.search_snap`). Two coupled tubes are decided: they can snap if and only if the certificate is
    below 0, and their snap is found wherever it is. Robots with tubes made of pieces are turned from home, inside their
    limits; more than two of them are not decided but where the certificate is above 0. For tubes off the centreline
    see `eccentric_verdict`.

    Args:
        translations: (n,) m; default home.
        effort: how hard is searched where no proof decides.
        progress: called with the steps done and their likely number.

    Raises:
        InputError: wrong number of translations, one that is not finite, a tube out of its actuator.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> print(tubeopt.judge(robot).finding)
        can snap
    """
    certificate = certify(robot, translations)
    try:
        worst = worst_margin(robot, translations, effort=effort)
    except SolveError:
        worst = None
    if robot.assembly(certificate.translations).eccentric:
        return judge_eccentric(robot, certificate, worst, progress)
    if certificate.snap_free:
        return Verdict(robot, certificate, worst)
    unstable = np.empty((0, robot.n_tubes)) if worst is None else worst.unstable
    found, search = search_snap(robot, certificate.translations, unstable, effort, progress)
    decided = len(search.coupled) == 2 and (found is not None or not is_general(robot))
    verdict = Verdict(robot, certificate, worst, ways=search.ways, failed=search.failed, decided=decided)
    if found is None:
        return verdict
    start, end = found.way
    return replace(verdict, start=start, end=end, snap=found.snap, followed=found.followed)
