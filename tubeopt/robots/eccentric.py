"""Eccentric tube robots: equal tubes side by side in a flexible sheath, in one segment or in several."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Annotated

import numpy as np

from ..arguments import typed
from ..errors import InputError
from ..files.field_metadata import NOT_NEGATIVE, check_fields, unit
from ..typing import Array
from .assembly import LENGTH_ROUND_OFF, Assembly, assemble
from .calibration import Calibration
from .limits import JointLimits
from .robot import Robot, keeps_hash
from .tubes import Tube, must_be_plain

# Directions of the three tubes from the centreline, rad.
PLACES = (0.0, 2 * math.pi / 3, -2 * math.pi / 3)


def sheath_inner_diameter(outer_diameter: float) -> float:
    """Inner diameter (m) of the sheath around three touching tubes of given outer diameter: (2 / sqrt(3) + 1) OD."""
    # Centres lie OD / sqrt(3) from the middle, and the tubes reach OD / 2 farther.
    return (2 / math.sqrt(3) + 1) * outer_diameter


class SheathedRobot(Robot):
    """k telescoping segments of three equal tubes each, in a sheath at 0, 120 and -120 deg around the centreline."""

    offset: float | None
    nested_curves = False

    @property
    @abstractmethod
    def held(self) -> tuple[Tube, ...]:
        """Tube of every segment, inner to outer, straight from its clamp."""

    @property
    def distance(self) -> float:
        """Distance of the tubes from the centreline, m."""
        return float(self.offset or 0.0)

    @cached_property
    def tubes(self) -> tuple[Tube, ...]:  # type: ignore[override]  # nobody writes to a frozen robot
        """The 3 k tubes: three of the innermost segment, then three of the next."""
        return tuple(tube for tube in self.held for _ in range(3))

    def check_bends(self) -> None:
        """Raise InputError where a precurvature is tighter than the robot is thick."""
        for i, tube in enumerate(self.held, start=1):
            if self.distance * abs(tube.curvature) >= 0.25:
                which = f" of segment {i}" if len(self.held) > 1 else ""
                raise InputError(
                    f"offset is {self.distance:g} m; it must be less than a quarter of the radius of precurvature"
                    f"{which}, {0.25 / abs(tube.curvature):g} m"
                )

    @cached_property
    def moving_together(self) -> tuple[tuple[int, ...], ...]:
        """Tubes of each carriage: the three tubes of a segment."""
        return tuple((3 * k, 3 * k + 1, 3 * k + 2) for k in range(len(self.held)))

    @property
    def nested_pairs(self) -> tuple[tuple[int, int], ...]:
        """Pairs of nested tubes: each tube and the tube of the next segment around it."""
        return tuple((i, i + 3) for i in range(3 * len(self.held) - 3))

    def assembly(self, translations: Array) -> Assembly:
        """Sections at `translations` (3 k,), m.

        Raises:
            InputError: the tubes of a segment have different translations, a tube leaves its actuator, or curved parts
                overlap.
        """
        count = len(self.held)
        for k, row in enumerate(np.reshape(translations, (-1, 3))):
            if np.ptp(row) > LENGTH_ROUND_OFF:
                which = f" of segment {k + 1}" if count > 1 else ""
                raise InputError(
                    f"translations{which} are {row.tolist()} m; the three tubes of a segment share a sheath, so they "
                    "must be equal"
                )
        offset, angle = np.full(3 * count, self.distance), np.tile(PLACES, count)
        bundle = assemble(self.tubes, translations, offset=offset, offset_angle=angle)
        transition, end = bundle.transition[::3], bundle.end[::3]
        for inner, outer in pairwise(k for k in range(count) if end[k] > 0):
            if transition[inner] < end[outer] - 1e-9:
                raise InputError(
                    f"segment {inner + 1} begins to curve at {transition[inner]:g} m, before segment {outer + 1} ends "
                    f"at {end[outer]:g} m; curved parts must not overlap"
                )
        return bundle


@typed
@keeps_hash
@dataclass(frozen=True)
class EccentricRobot(SheathedRobot):
    """A one-segment eccentric tube robot: three equal tubes at 0, 120 and -120 deg around the centreline.

    The sheath keeps the tubes in place and has no bending stiffness. The tubes move in and out together.

    Raises:
        InputError: an offset or length that is negative or not finite, or limits for another number of tubes. An offset
            at which the tubes overlap, or are curved more tightly than the robot is thick.
    """

    tube: Tube
    """Design of the three equal tubes."""
    offset: Annotated[
        float | None,
        unit("mm"),
        NOT_NEGATIVE,
        "distance of the tube axes from the centreline; by default the tubes touch",
    ] = None
    """Distance of the tube axes from the centreline, m; None is OD / sqrt(3). 0 is the equivalent concentric robot,
    which cannot be built."""
    transmission_length: Annotated[float, unit("mm"), NOT_NEGATIVE, "straight length behind the base plate"] = 0.0
    """Straight length of each tube between its held end and its `straight_length`, m."""
    name: str = ""
    """Name in tables and figures."""
    joint_limits: JointLimits | None = None
    """Limits of the actuators, in readings; with None the lengths of the tubes decide."""
    calibration: Calibration | None = None
    """Conversion of drive readings to joint values; None if they are equal."""

    def __post_init__(self) -> None:
        must_be_plain([self.tube], "an eccentric robot")
        check_fields(self)
        # Circumradius of the triangle with side OD that the centres of three touching tubes form.
        touching = self.tube.outer_diameter / math.sqrt(3)
        distance = touching if self.offset is None else self.offset
        object.__setattr__(self, "offset", distance)
        if 0 < distance < touching * (1 - 1e-9):
            raise InputError(
                f"offset is {distance:g} m; tubes of outer_diameter {self.tube.outer_diameter:g} m need at least "
                f"{touching:g} m (or 0, the equivalent concentric robot)"
            )
        self.check_bends()
        self.check_drives()

    @cached_property
    def held(self) -> tuple[Tube, ...]:
        """Tube of the segment, with its straight part and transmission."""
        straight = self.tube.straight_length + self.transmission_length
        return (replace(self.tube, straight_length=straight),)

    @property
    def sheath_inner_diameter(self) -> float:
        """Inner diameter of the sheath, m."""
        return sheath_inner_diameter(self.tube.outer_diameter)


@keeps_hash
@dataclass(frozen=True)
class SegmentedEccentricRobot(SheathedRobot):
    """An eccentric tube robot of k telescoping segments: three stacks of k concentric tubes around the centreline.

    The three tubes of a segment are equal and move in and out together. Where the tubes of an inner segment pass
    through an outer one they are straight but stiff: curved parts never overlap.

    Raises:
        InputError: no segment, tubes that do not nest, or an inner tube that does not protrude from the next segment.
            An offset at which the tubes overlap, or are curved more tightly than the robot is thick.
    """

    segments: tuple[Tube, ...]
    """The tube of each segment, inner (which reaches furthest) to outer."""
    offset: Annotated[
        float | None,
        unit("mm"),
        NOT_NEGATIVE,
        "distance of the tube axes from the centreline; by default the outermost tubes touch",
    ] = None
    """Distance of the three stacks from the centreline, m; None is OD / sqrt(3) of the outermost tube."""
    name: str = ""
    """Name in tables and figures."""
    joint_limits: JointLimits | None = None
    """Limits of the actuators of the 3 k tubes, in readings, in the order of `tubes`; with None the lengths decide."""
    calibration: Calibration | None = None
    """Conversion of drive readings to joint values; None if they are equal."""

    def __post_init__(self) -> None:
        segments = tuple(self.segments)
        object.__setattr__(self, "segments", segments)
        must_be_plain(segments, "an eccentric robot")
        if not segments:
            raise InputError("segments is empty; a robot needs at least one segment")
        for i in range(len(segments) - 1):
            inner, outer = segments[i], segments[i + 1]
            if inner.outer_diameter > outer.inner_diameter:
                raise InputError(
                    f"segments {i + 1} and {i + 2} do not nest: outer_diameter {inner.outer_diameter:g} m must be at "
                    f"most inner_diameter {outer.inner_diameter:g} m"
                )
            if inner.straight_length < outer.length - LENGTH_ROUND_OFF:
                raise InputError(
                    f"straight_length of segment {i + 1} is {inner.straight_length:g} m; it must be at least the "
                    f"length of segment {i + 2}, {outer.length:g} m, or their curved parts would overlap at home"
                )
        widest = EccentricRobot(segments[-1], self.offset)
        object.__setattr__(self, "offset", widest.distance)
        self.check_bends()
        self.check_drives()

    @property
    def held(self) -> tuple[Tube, ...]:
        """The tubes of the segments."""
        return self.segments
