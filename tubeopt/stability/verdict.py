"""Whether a robot can snap: what is proved, what search finds, and a way to repeat the snap."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ..display import Displayed
from ..errors import SolveError
from ..robots.robot import Robot, is_general
from ..typing import Array, Sentence
from .certificate import Certificate, certify
from .following import Snap
from .search import search_snap
from .worst import WorstMargin, worst_margin

ASSUMING = "assuming no external load, weight or friction"
"""What every statement about snapping leaves out, in a clause."""


class Finding(Sentence):
    """What is known about snapping; every value reads as a sentence, and holds under what `ASSUMING` says.

    CAN_SNAP says that there is a snap; whether it is inside the joint limits says `Verdict.within_limits`.
    """

    SNAP_FREE = "cannot snap at any rotation"
    CAN_SNAP = "can snap"
    OPEN = "it is not proved that the robot cannot snap, and search found no snap"


@dataclass(frozen=True, eq=False)
class Verdict(Displayed):
    """Whether a robot can snap at given translations.

    certificate: the lower bound of the margin over all rotations: proved.
    worst: the least margin that search found, None where it ended on a fold (margin 0).
    start, end: (n,) rotations (rad) of a straight way on which the robot snaps, and the snap; None where none is known.
    ways: how many ways were tried.  failed: on how many of them the equilibria were lost.
    followed: whether the snap is met where the way is followed. If not, it is one of two tubes too shallow for that and
    is known from its fold alone.
    decided: whether no more than two tubes, of one curvature each, are coupled, so that the certificate is exact and
    the nearest snap is known.
    """

    _brief = ("robot", "finding", "certificate")

    robot: Robot
    certificate: Certificate
    worst: WorstMargin | None
    start: Array | None = None
    end: Array | None = None
    snap: Snap | None = None
    ways: int = 0
    failed: int = 0
    followed: bool = True
    decided: bool = False

    @property
    def finding(self) -> Finding:
        """The verdict in a word."""
        if self.certificate.snap_free:
            return Finding.SNAP_FREE
        return Finding.OPEN if self.snap is None else Finding.CAN_SNAP

    @property
    def within_limits(self) -> bool | None:
        """Whether the robot comes to the snap inside the limits of its rotations; None where no snap is known."""
        if self.snap is None or self.start is None:
            return None
        low, high = np.array(self.robot.limits.rotations).T
        joints = np.array([self.start, self.snap.rotations])
        return bool(((joints >= low - 1e-9) & (joints <= high + 1e-9)).all())


def judge(
    robot: Robot,
    translations: ArrayLike | None = None,
    *,
    progress: Callable[[int, int], object] | None = None,
) -> Verdict:
    """Prove that a robot cannot snap at given translations, or find a snap.

    Where the certificate is not above 0, the robot is turned from its relaxed pose, all tubes curving to one side,
    until it snaps; inside its joint limits where search finds a snap there, else beyond them (see
    `stability.search.search_snap`). Two coupled tubes are decided: they can snap if and only if the certificate is
    below 0, and their snap is found wherever it is. Robots with tubes made of pieces are turned from home, inside their
    limits, and nothing of them is decided but what is proved. For tubes off the centreline see `eccentric_verdict`.

    Args:
        translations: (n,) m; default home.
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
        worst = worst_margin(robot, translations)
    except SolveError:
        worst = None
    if robot.assembly(certificate.translations).eccentric:
        from .eccentric_verdict import judge_eccentric  # which is a Verdict of this module

        return judge_eccentric(robot, certificate, worst, progress)
    if certificate.snap_free:
        return Verdict(robot, certificate, worst)
    unstable = np.empty((0, robot.n_tubes)) if worst is None else worst.unstable
    found, search = search_snap(robot, certificate.translations, unstable, progress)
    decided = len(search.coupled) == 2 and not is_general(robot)
    verdict = Verdict(robot, certificate, worst, ways=search.ways, failed=search.failed, decided=decided)
    if found is None:
        return verdict
    start, end = found.way
    return replace(verdict, start=start, end=end, snap=found.snap, followed=found.followed)
