"""Whether a robot with tubes off the centreline can snap: proved that not, proved that it can and shown, or open."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from ..errors import SolveError
from ..robots.robot import Robot
from ..typing import Array
from .certificate import Certificate
from .eccentric_certificate import DIRECTIONS, Untwisted, segments_of, softest_untwisted, untwisted_tips
from .snapping import find_snap
from .verdict import Finding, Verdict
from .worst import WorstMargin

TURN = 2 * np.pi


@dataclass(frozen=True, eq=False)
class EccentricVerdict(Verdict):
    """A `Verdict` that knows a closed form too.

    untwisted: margin of the softest shape with one tube of a segment against the two others, all of them equilibria.
        Below 0 two more equilibria have its joint rotations, and the robot snaps on some way, shown or not. None where
        the robot is not made of segments of three equal tubes.
    """

    untwisted: float | None = None

    @property
    def finding(self) -> Finding:
        """The verdict in a word."""
        if self.certificate.snap_free:
            return Finding.SNAP_FREE
        if self.snap is not None or (self.untwisted is not None and self.untwisted < 0):
            return Finding.CAN_SNAP
        return Finding.OPEN


def judge_eccentric(
    robot: Robot,
    certificate: Certificate,
    worst: WorstMargin | None,
    progress: Callable[[int, int], object] | None = None,
) -> EccentricVerdict:
    """The verdict on tubes off the centreline at the translations of their certificate.

    Where that is not above 0, one tube of a segment is turned by a turn, forth and back, the other two held, all other
    segments curving to one side: half-way lie the untwisted shapes of the closed form.
    """
    segments = segments_of(robot.assembly(certificate.translations))
    shapes = sorted(map(softest_untwisted, segments or ()), key=lambda shape: shape.margin)
    untwisted = shapes[0].margin if shapes else None
    if certificate.snap_free:
        return EccentricVerdict(robot, certificate, worst, untwisted=untwisted)
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
            return EccentricVerdict(robot, certificate, worst, start, end, snap, k + 1, untwisted=untwisted)
    return EccentricVerdict(robot, certificate, worst, ways=len(ways), untwisted=untwisted)


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
