"""Joint values -> sections: the stretches of a tube bundle between breakpoints."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError
from ..typing import Array, Mask
from .tubes import Tube

ROUND_OFF = 1e-12
"""Breakpoints closer than this (m) are one: far below any tolerance of a tube, far above round-off of a length."""


@dataclass(frozen=True, eq=False)
class Assembly:
    """A bundle of n tubes in front of the plate, cut into m sections, base to tip.

    Inside a section the same tubes are present and the same ones are curved. Tube i runs at the fixed offset
    `offset[i]` from the centreline in direction `offset_angle[i]` (0 for concentric tubes).

    Attributes:
        bending_stiffness, torsional_stiffness: (n,) EI and GJ, N m^2.
        curvature: (n,) precurvature of the curved parts, 1/m.
        offset, offset_angle: (n,) m, rad.
        transmission: (n,) |beta_i|, the length from where tube i is held to the plate, m.
        transition, end: (n,) arc length where each tube begins to curve, and where it ends, m; < 0 behind the plate.
        start, length: (m,) arc length where each section begins, and its length, m.
        present, curved: (m, n) whether tube i is there, and whether it is curved there.
    """

    bending_stiffness: Array
    torsional_stiffness: Array
    curvature: Array
    offset: Array
    offset_angle: Array
    transmission: Array
    transition: Array
    end: Array
    start: Array
    length: Array
    present: Mask
    curved: Mask

    @property
    def n_tubes(self) -> int:
        """Number of tubes n."""
        return len(self.transmission)

    @property
    def n_sections(self) -> int:
        """Number of sections m."""
        return len(self.length)

    @property
    def total_length(self) -> float:
        """Arc length of the tip, m."""
        return max(0.0, float(self.end.max()))

    @property
    def eccentric(self) -> bool:
        """Whether any tube runs off the centreline."""
        return bool(self.offset.any())

    @property
    def across(self) -> Array:
        """(n, 2) m: where each tube runs beside the centreline, d (cos phi, sin phi)."""
        angle = self.offset_angle
        return np.asarray(self.offset[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))

    @property
    def coupled(self) -> Mask:
        """(m,) sections in which torsion is not simply linear: two curved tubes, or one where tubes run off-centre."""
        return np.asarray(self.curved.sum(1) >= (1 if self.eccentric else 2))


def assemble(
    tubes: Sequence[Tube],
    translations: Array,
    *,
    offset: Array | None = None,
    offset_angle: Array | None = None,
    name: str = "translation",
) -> Assembly:
    """Cut the bundle at every transition and end in front of the plate.

    Args:
        tubes: inner to outer.
        translations: (n,) advance of each tube from home, m.
        offset, offset_angle: (n,) place of each tube beside the centreline, m and rad; None is concentric.
        name: what the caller calls a translation, for the message.

    Raises:
        InputError: a translation pulls a tube out of its actuator (beta_i > 0).
    """
    n = len(tubes)
    straight = np.array([tube.straight_length for tube in tubes])
    beta = translations - straight
    for i in range(n):
        if beta[i] > ROUND_OFF:
            raise InputError(
                f"{name} of tube {i + 1} is {translations[i]:g} m, which pulls it out of its actuator; "
                f"it must be at most its straight_length, {straight[i]:g} m"
            )
    beta = np.minimum(beta, 0.0)
    transition = beta + straight
    end = beta + np.array([tube.length for tube in tubes])
    curvature = np.array([tube.curvature for tube in tubes])
    cuts = merge([0.0, *(s for s in (*transition.tolist(), *end.tolist()) if s > 0)])
    present, curved = where(transition, end, curvature, (cuts[:-1] + cuts[1:])[:, None] / 2)
    zero = np.zeros(n)
    return Assembly(
        bending_stiffness=np.array([tube.bending_stiffness for tube in tubes]),
        torsional_stiffness=np.array([tube.torsional_stiffness for tube in tubes]),
        curvature=curvature,
        offset=zero if offset is None else offset,
        offset_angle=zero if offset_angle is None else offset_angle,
        transmission=-beta,
        transition=transition,
        end=end,
        start=cuts[:-1],
        length=np.diff(cuts),
        present=present,
        curved=curved,
    )


def where(transition: Array, end: Array, curvature: Array, s: Array | float) -> tuple[Mask, Mask]:
    """Which tubes are present, and which are curved, at arc length s between the breakpoints."""
    present: Mask = np.asarray(s < end)
    return present, np.asarray(present & (s > transition) & (curvature != 0))


def merge(points: Iterable[float]) -> Array:
    """Sorted points without those closer than ROUND_OFF to the last one that was kept."""
    kept: list[float] = []
    for point in sorted(points):
        if not kept or point - kept[-1] > ROUND_OFF:
            kept.append(point)
    return np.array(kept)


def without_offsets(assembly: Assembly) -> Assembly:
    """The same tubes, all on the centreline."""
    zero = np.zeros(assembly.n_tubes)
    return replace(assembly, offset=zero, offset_angle=zero)
