"""Whether a robot can snap: what is proved, what search finds, and a way to repeat the snap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..display import Displayed
from ..robots.robot import Robot
from ..typing import Array, Sentence
from .certificate import Certificate
from .snap import Snap
from .worst import WorstMargin

ASSUMING = "assuming no external load, weight or friction"
"""What every statement about snapping leaves out, in a clause."""


class Finding(Sentence):
    """What is known about snapping; every value reads as a sentence, and holds under what `ASSUMING` says.

    CAN_SNAP says that there is a snap; whether it is inside the joint limits says `Verdict.within_limits`.
    """

    SNAP_FREE = "cannot snap at any rotation"
    CAN_SNAP = "can snap"
    OPEN = "it is not proved that the robot cannot snap, and search found no snap"


class VerdictStatus(Sentence):
    """A finding as a sentence by itself."""

    SNAP_FREE = f"the robot {Finding.SNAP_FREE.value}"
    CAN_SNAP = f"the robot {Finding.CAN_SNAP.value}"
    OPEN = Finding.OPEN.value


@dataclass(frozen=True)
class VerdictStatistics:
    """What a verdict took."""

    ways: int
    """That were tried for a snap."""
    failed: int
    """On how many of them the equilibria were lost."""


@dataclass(frozen=True, eq=False)
class Verdict(Displayed):
    """Whether a robot can snap at given translations."""

    _brief = ("robot", "finding", "certificate")

    robot: Robot
    """That is judged."""
    certificate: Certificate
    """The lower bound of the margin over all rotations: proved."""
    worst: WorstMargin | None
    """The least margin that search found, None where it ended on a fold (margin 0)."""
    start: Array | None = None
    """(n,) rotations from which a straight way begins on which the robot snaps, rad; None where none is known."""
    end: Array | None = None
    """(n,) where it ends."""
    snap: Snap | None = None
    """On that way."""
    ways: int = 0
    """How many were tried."""
    failed: int = 0
    """On how many of them the equilibria were lost."""
    followed: bool = True
    """Whether the snap is met where the way is followed. If not, it is one of two tubes too shallow for that and is
    known from its fold alone."""
    decided: bool = False
    """Whether no more than two tubes are coupled, so that the certificate is exact, and a snap is known where it is
    below 0; of tubes of one curvature each the nearest one."""

    @property
    def value(self) -> bool | None:
        """Whether the robot can snap; None where neither is known."""
        return None if self.finding is Finding.OPEN else self.finding is Finding.CAN_SNAP

    @property
    def status(self) -> VerdictStatus:
        """The finding, as a sentence."""
        return VerdictStatus[self.finding.name]

    @property
    def statistics(self) -> VerdictStatistics:
        """What it took."""
        return VerdictStatistics(self.ways, self.failed)

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


@dataclass(frozen=True, eq=False)
class EccentricVerdict(Verdict):
    """A `Verdict` that knows a closed form too."""

    untwisted: float | None = None
    """Margin of the softest shape with one tube of a segment against the two others, all of them equilibria. Below 0
    two more equilibria have its joint rotations, and the robot snaps on some way, shown or not. None where the robot is
    not made of segments of three equal tubes."""

    @property
    def finding(self) -> Finding:
        """The verdict in a word."""
        known = self.untwisted is not None and self.untwisted < 0 and not self.certificate.snap_free
        return Finding.CAN_SNAP if known else super().finding
