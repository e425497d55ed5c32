"""Whether a robot can snap: what is proved, what search finds, and a way to repeat the snap."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import qmc

from ..equilibrium import Equilibrium
from ..errors import SolveError
from ..robots.assembly import Array
from ..robots.robot import Robot
from .certificate import Certificate, certify
from .following import Snap
from .snapping import find_snap
from .worst import WorstMargin, worst_margin

TURN = 2 * np.pi

RANDOM_WAYS_LOG2 = 5
"""Base-2 logarithm of the number of random directions in which a snap is looked for in the end."""


class Finding(Enum):
    """What is known about snapping; every value reads as a sentence."""

    SNAP_FREE = "cannot snap at any rotation"
    CAN_SNAP = "can snap"
    OPEN = "it is not proved that the robot cannot snap, and search found no snap"

    def __str__(self) -> str:
        return self.value


@dataclass(frozen=True, eq=False)
class Verdict:
    """Whether a robot can snap at given translations.

    certificate: the lower bound of the margin over all rotations: proved.
    worst: the least margin that search found, None where it ended on a fold (margin 0).
    start, end: (n,) rotations (rad) of a straight way on which the robot snaps, and the snap; None where none is known.
    ways: how many ways were tried.
    """

    robot: Robot
    certificate: Certificate
    worst: WorstMargin | None
    start: Array | None = None
    end: Array | None = None
    snap: Snap | None = None
    ways: int = 0

    @property
    def finding(self) -> Finding:
        """The verdict in a word."""
        if self.certificate.snap_free:
            return Finding.SNAP_FREE
        return Finding.OPEN if self.snap is None else Finding.CAN_SNAP


def judge(
    robot: Robot,
    translations: ArrayLike | None = None,
    *,
    progress: Callable[[int, int], object] | None = None,
) -> Verdict:
    """Prove that a robot cannot snap at given translations, or find a snap.

    Where the certificate is not above 0, the robot is turned along straight ways from its relaxed home, all tubes
    curving to one side: through the rotations with the least margin, full turns of every group of tubes against the
    others, and random directions, until it snaps. For tubes off the centreline see `eccentric_verdict`.

    Args:
        translations: (n,) m; default home.
        progress: called with the steps done and their largest number.

    Raises:
        InputError: wrong number of translations, one that is not finite, a tube out of its actuator.
        SolveError: no snap was found, and on some way no equilibrium.
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
    start = _relaxed(robot)
    ways = list(_ways(robot, start, None if worst is None else worst.equilibrium))
    failure: SolveError | None = None
    for k, end in enumerate(ways):
        if progress is not None:
            progress(k, len(ways))
        try:
            snap = find_snap(robot, (start, certificate.translations), (end, certificate.translations))
        except SolveError as error:
            failure = error
            continue
        if snap is not None:
            return Verdict(robot, certificate, worst, start, end, snap, k + 1)
    if failure is not None:
        raise failure
    return Verdict(robot, certificate, worst, ways=len(ways))


def _relaxed(robot: Robot) -> Array:
    """(n,) rotations at which all tubes curve to one side."""
    return np.array([np.pi if tube.curvature < 0 else 0.0 for tube in robot.tubes])


def _ways(robot: Robot, start: Array, worst: Equilibrium | None) -> Iterator[Array]:
    """(n,) rotations to turn to, the likeliest to snap on the way first; the outermost tube stays."""
    n = robot.n_tubes
    for i in range(n - 1):
        yield start + TURN * np.eye(n)[i]
    if worst is not None:
        # Its own mirror image, where tubes oppose each other, is half of the way.
        relative = worst.rotations - worst.rotations[-1] + start[-1] - start
        relative -= TURN * np.round((worst.tip_rotations - worst.tip_rotations[-1] + start[-1] - start) / TURN)
        yield start + 2 * _rounded(relative, 4)
    for signs in itertools.product((0, 1, -1), repeat=n - 1):
        if next((sign for sign in signs if sign), -1) > 0 and sum(map(abs, signs)) > 1:
            yield start + TURN * np.array([*signs, 0])
    if n > 2:
        unit = 2 * qmc.Sobol(n - 1, rng=0).random_base2(RANDOM_WAYS_LOG2) - 1
        for direction in unit[np.abs(unit).max(1) > 1e-3]:
            yield start + _rounded(TURN * np.append(direction / np.abs(direction).max(), 0.0), 1)


def _rounded(angles: Array, digits: int) -> Array:
    """Angles (rad) that have few digits in deg, so that they can be told and typed."""
    return np.radians(np.round(np.degrees(angles), digits))
