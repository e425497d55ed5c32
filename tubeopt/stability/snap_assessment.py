"""Whether a robot can snap: what is proved, what search finds, and a way to repeat the snap."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ..arguments import typed
from ..display import Displayed
from ..errors import SolveError
from ..robots.robot import Robot
from ..solvers.parallel.blas import small
from ..solvers.time_limit import TIME_LIMIT, limited
from ..typing import Array, StatusEnum
from .branch_surface import TURN
from .certificate import Certificate, certify
from .eccentric_certificate import DIRECTIONS, Untwisted, segments_of, softest_untwisted, untwisted_tips
from .following import find_snap
from .motion import Snap
from .search import search_snap
from .settings import DEFAULT_SEARCH, SnapSearch
from .worst import WorstMargin, worst_margin

ASSUMING = "assuming no external load, weight or friction"
"""What every statement about snapping leaves out, in a clause."""


class Finding(StatusEnum):
    """Knowledge about snapping; every value reads as a sentence."""

    SNAP_FREE = "cannot snap at any rotation"
    CAN_SNAP = "can snap"
    OPEN = "it is not proved that the robot cannot snap, and search found no snap"


class SnapAssessmentStatus(StatusEnum):
    """A finding as a sentence by itself."""

    SNAP_FREE = f"the robot {Finding.SNAP_FREE.value}"
    CAN_SNAP = f"the robot {Finding.CAN_SNAP.value}"
    OPEN = Finding.OPEN.value


@dataclass(frozen=True)
class SnapAssessmentStatistics:
    """Numbers of paths tried for a snap, and of those where the equilibrium was lost."""

    paths: int
    """Number of paths tried."""
    failed: int
    """Number of these paths where the equilibrium was lost."""


@dataclass(frozen=True, eq=False)
class SnapAssessment(Displayed):
    """Whether a robot can snap at given translations, with the proof or the snap."""

    _brief = ("robot", "finding", "certificate")

    robot: Robot
    """The robot."""
    certificate: Certificate
    """The lower bound of the margin over all rotations: proved."""
    worst: WorstMargin | None
    """The least margin that search found, None where it ended on a fold (margin 0)."""
    start: Array | None = None
    """(n,) rotations at the start of a straight path with a snap, rad; None if no snap is known."""
    end: Array | None = None
    """(n,) where it ends."""
    snap: Snap | None = None
    """Snap on that path, or None."""
    paths: int = 0
    """Number of paths tried."""
    failed: int = 0
    """Number of these paths where the equilibrium was lost."""
    followed: bool = True
    """True if the snap occurs when the path is followed. False for a snap of two tubes too shallow for that, known from
    its fold.
    """
    decided: bool = False
    """True if no more than two tubes are coupled. The certificate is then exact: below 0 a snap is known. For tubes of
    one curvature each it is the nearest snap.
    """

    @property
    def value(self) -> bool | None:
        """True if the robot can snap, False if it cannot, None if unknown."""
        return None if self.finding is Finding.OPEN else self.finding is Finding.CAN_SNAP

    @property
    def status(self) -> SnapAssessmentStatus:
        """The finding, as a sentence."""
        return SnapAssessmentStatus[self.finding.name]

    @property
    def statistics(self) -> SnapAssessmentStatistics:
        """Numbers of paths tried and lost."""
        return SnapAssessmentStatistics(self.paths, self.failed)

    @property
    def finding(self) -> Finding:
        """The verdict in a word."""
        if self.certificate.snap_free:
            return Finding.SNAP_FREE
        return Finding.OPEN if self.snap is None else Finding.CAN_SNAP

    @property
    def within_limits(self) -> bool | None:
        """True if the snap lies inside the limits of the rotations; None if no snap is known."""
        if self.snap is None or self.start is None:
            return None
        low, high = np.array(self.robot.limits.rotations).T
        joints = np.array([self.start, self.snap.rotations])
        return bool(((joints >= low - 1e-9) & (joints <= high + 1e-9)).all())


@dataclass(frozen=True, eq=False)
class EccentricSnapAssessment(SnapAssessment):
    """A `SnapAssessment` that knows a closed form too."""

    untwisted: float | None = None
    """Margin of the softest shape with one tube of a segment against the two others, all of them equilibria. Below 0
    two more equilibria have its joint rotations, and the robot snaps on some way, shown or not. None where the robot is
    not made of segments of three equal tubes."""

    @property
    def finding(self) -> Finding:
        """The verdict in a word."""
        known = self.untwisted is not None and self.untwisted < 0 and not self.certificate.snap_free
        return Finding.CAN_SNAP if known else super().finding


@typed
@small
@limited
def assess_snapping(
    robot: Robot,
    translations: ArrayLike | None = None,
    *,
    effort: SnapSearch = DEFAULT_SEARCH,
    progress: Callable[[int, int], object] | None = None,
    time_limit: float = TIME_LIMIT,
) -> SnapAssessment:
    """Proof that a robot cannot snap at given translations, or a snap.

    If the certificate is not above 0, rotations are searched for a snap. The paths start at the relaxed pose, with all
    tubes curving to one side. Snaps inside the joint limits come first, then those beyond (see
    `stability.search.search_snap`).

    - Two coupled tubes are always decided: they can snap if and only if the certificate is below 0.
    - Tubes made of pieces start at home and stay inside their limits. More than two of them are decided only by a
      certificate above 0.
    - Tubes off the centreline: one tube of a segment is turned once back and forth. Its other two tubes are fixed, and
      all other segments curve to one side. Half-way are the untwisted shapes of the closed form (see
      `eccentric_certificate`).

    Args:
        translations: (n,) m; default home.
        effort: settings of the search where no proof decides.
        progress: called with the steps done and their likely number.
        time_limit: maximum run time, s.

    Raises:
        InputError: wrong number of translations, one that is not finite, a tube out of its actuator.
        TimeLimitError: (a SolveError) the time limit was reached before there was an answer.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> print(tubeopt.assess_snapping(robot).finding)
        can snap
    """
    certificate = certify(robot, translations)
    try:
        worst = worst_margin(robot, translations, effort=effort)
    except SolveError:
        worst = None
    if robot.assembly(certificate.translations).eccentric:
        return _eccentric(robot, certificate, worst, progress)
    if certificate.snap_free:
        return SnapAssessment(robot, certificate, worst)
    unstable = np.empty((0, robot.n_tubes)) if worst is None else worst.unstable
    found, search = search_snap(robot, certificate.translations, unstable, effort, progress)
    decided = len(search.coupled) == 2 and (found is not None or robot.even)
    verdict = SnapAssessment(robot, certificate, worst, paths=search.ways, failed=search.failed, decided=decided)
    if found is None:
        return verdict
    start, end = found.way
    return replace(verdict, start=start, end=end, snap=found.snap, followed=found.followed)


def _eccentric(
    robot: Robot, certificate: Certificate, worst: WorstMargin | None, progress: Callable[[int, int], object] | None
) -> EccentricSnapAssessment:
    """The verdict on tubes off the centreline."""
    segments = segments_of(robot.assembly(certificate.translations))
    shapes = sorted(map(softest_untwisted, segments or ()), key=lambda shape: shape.margin)
    verdict = EccentricSnapAssessment(robot, certificate, worst, untwisted=shapes[0].margin if shapes else None)
    if certificate.snap_free:
        return verdict
    bends = np.array([np.sign(tube.curvature) for tube in robot.tubes])
    ways = list(_ways(robot.n_tubes, shapes, bends))
    for k, (start, end) in enumerate(ways):
        if progress is not None:
            progress(k, len(ways))
        try:
            snap = find_snap(robot, (start, certificate.translations), (end, certificate.translations))
        except SolveError:
            continue
        if snap is not None:
            return replace(verdict, start=start, end=end, snap=snap, paths=k + 1)
    return replace(verdict, paths=len(ways))


def _ways(n: int, shapes: list[Untwisted], bends: Array) -> Iterator[tuple[Array, Array]]:
    """Rotations (n,) to start from and to turn to, the likeliest to snap on the way first."""
    for shape in shapes:
        for k in range(len(DIRECTIONS) if shape.margin < 0 else 1):
            further = float(DIRECTIONS[k])
            tips, odd = untwisted_tips(n, shape, bends)
            # All segments turn alike: the outer ones keep their direction relative to this one.
            start = tips + further
            start[odd] -= np.pi
            for turn in (TURN, -TURN):
                end = start.copy()
                end[odd] += turn
                yield _rounded(start), _rounded(end)


def _rounded(angles: Array) -> Array:
    """Angles (rad) that are whole degrees exactly, so that they can be told and typed."""
    return np.asarray(np.radians(np.round(np.degrees(angles), 6)))
