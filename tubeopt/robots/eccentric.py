"""Eccentric tube robots: tubes side by side in a flexible sheath.

`EccentricRobot` and `SegmentedEccentricRobot` have the three equal tubes of the thesis, and its balance of moments.
`BundleRobot` has any tubes at any offsets, with an energy.
"""

from __future__ import annotations

import functools
import inspect
import math
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations, pairwise
from typing import Annotated, Any, NamedTuple, Self, TypeVar

import numpy as np

from ..arguments import typed
from ..errors import InputError
from ..files.field_metadata import NOT_NEGATIVE, POSITIVE, REQUIRED, Checked, Typical, check_fields, unit
from ..files.units import TO_MM
from ..physics.buffer import STEEPEST, buffer_bend
from ..physics.spiral import spiral_rate
from ..physics.strain import surface_strain
from ..typing import Array
from .assembly import LENGTH_ROUND_OFF, Assembly, assemble
from .calibration import Calibration, Posterior
from .concentric import Friction, check_friction
from .limits import JointLimits
from .robot import Robot, keeps_hash, passed_limit
from .tubes import Tube, must_be_plain

Question = TypeVar("Question", bound=Callable[..., Any])

MODELS = ("thesis", "energy")
"""Models of three equal tubes: the balance of moments of the thesis, with tubes that end together, and an energy."""

LARGEST_OFFSET = 0.05
"""Largest offset times precurvature of the model thesis by default: tips of both models then differ by 0.3 % of the
length at the curvature of the robot of the thesis, and by up to twice as much where tubes are more curved.
"""

# Directions of the three tubes from the centreline, rad.
PLACES = (0.0, 2 * math.pi / 3, -2 * math.pi / 3)


def sheath_inner_diameter(outer_diameter: float) -> float:
    """Inner diameter (m) of the sheath around three touching tubes of given outer diameter: (2 / sqrt(3) + 1) OD."""
    # Centres lie OD / sqrt(3) from the middle, and the tubes reach OD / 2 farther.
    return (2 / math.sqrt(3) + 1) * outer_diameter


def _axes(offset: Array, angle: Array) -> Array:
    """Places (n, 2) at offsets (m) and angles (rad) from the centreline, m."""
    return np.asarray(offset[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))


@dataclass(frozen=True)
class Buffer(Checked):
    """Section between drive and plate, in which tubes merge from a gap to their places in the sheath."""

    length: Annotated[float, unit("mm"), POSITIVE, REQUIRED, Typical(1e-3, 1.0), "length along the axis"] = 0.05
    gap: Annotated[
        float, unit("mm"), POSITIVE, REQUIRED, Typical(1e-4, 0.5), "smallest gap between two tubes at the drive"
    ] = 0.02
    guide: Annotated[
        float | None, unit("mm"), POSITIVE, "length of the sheath that takes the bending moment; needed with friction"
    ] = None
    friction: Annotated[float, NOT_NEGATIVE, "coefficient of friction of a tube at the entrance of the sheath"] = 0.0
    clearance: Annotated[float, unit("mm"), NOT_NEGATIVE, "room of a tube at that entrance, from side to side"] = 0.0
    _owner = "the buffer"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.friction and self.guide is None:
            raise InputError("guide of the buffer is missing; its friction depends on the forces there")


class BufferedTube(NamedTuple):
    """A tube in the buffer section."""

    shift: float
    """Distance of its axis at the drive from that in the sheath, m."""
    slope: float
    """Largest angle to the axis of the arm, rad."""
    radius: float
    """Smallest radius of its bends, m; infinite if it is straight."""
    strain: float
    """Largest bending strain at its surface."""
    length: float
    """Length of straight tube in the section, m."""
    force: float
    """Force across the axis, N."""
    push: float
    """Force that pushes drive and sheath apart, N."""
    turn_play: float
    """Half width of the turn of the drive that friction takes up, rad."""
    slide_play: float
    """Change of its length in the section between both sides of the room, m."""


def buffered_tubes(robot: SheathedRobot | BundleRobot) -> list[BufferedTube]:
    """Tubes (n,) in the buffer section of a robot; [] if it has none. Each tube bends by itself.

    At the drive all offsets are larger by one factor. The gap is that of the closest tubes.

    Raises:
        InputError: a tube would stand across the axis.
    """
    buffer, axes = robot.buffer, robot.axes
    if buffer is None:
        return []
    radius = [tube.outer_diameter / 2 for tube in robot.tubes]
    factors = [
        (buffer.gap + radius[i] + radius[j]) / apart
        for i, j in combinations(range(len(radius)), 2)
        if (apart := float(np.linalg.norm(axes[i] - axes[j]))) > SAME_AXIS
    ]
    out = []
    for tube, r, distance in zip(robot.tubes, radius, np.linalg.norm(axes, axis=1).tolist(), strict=True):
        shift = (max([1.0, *factors]) - 1) * distance
        if shift >= STEEPEST * buffer.length:
            raise InputError(
                f"gap of the buffer is {buffer.gap:g} m, and moves a tube by {shift:g} m over {buffer.length:g} m; it "
                f"must move it by less than {STEEPEST:.3g} times the length"
            )
        bend, ei = buffer_bend(shift, buffer.length), float(tube.bending_stiffness)
        # A pair of forces at the ends of the guide carries the moment; one of them carries the force across, too.
        pressed = ei * (2 * bend.curvature / (buffer.guide or math.inf) + bend.across)
        room = buffer.clearance / 2 if shift else 0.0
        longer, shorter = (buffer_bend(shift + way * room, buffer.length).length for way in (1, -1))
        out.append(
            BufferedTube(
                shift,
                bend.slope,
                1 / bend.curvature if bend.curvature else math.inf,
                surface_strain(r, bend.curvature, 0.0),
                bend.length,
                ei * bend.across,
                ei * bend.along,
                buffer.friction * r * pressed * bend.length / float(tube.torsional_stiffness),
                longer - shorter,
            )
        )
    return out


def buffer_warnings(robot: SheathedRobot | BundleRobot) -> list[str]:
    """Warnings of tubes that are strained too much in the buffer section, or have too little straight tube for it."""
    out = []
    for i, (tube, bent) in enumerate(zip(robot.tubes, buffered_tubes(robot), strict=False), start=1):
        if passed := passed_limit(tube.material, bent.strain):
            out.append(f"tube {i} is strained {bent.strain * 100:.2f} % in the buffer, where it turns, {passed}")
        if tube.straight_length < bent.length:
            out.append(
                f"tube {i} is straight over {tube.straight_length * TO_MM:.4g} mm, and the buffer takes "
                f"{bent.length * TO_MM:.4g} mm: at home its curve begins in there, which no model contains"
            )
    return out


class SheathedRobot(Robot):
    """k telescoping segments of three equal tubes each, in a sheath at 0, 120 and -120 deg around the centreline."""

    offset: float | None
    buffer: Buffer | None
    model: str | None
    nested_curves = False

    @property
    @abstractmethod
    def held(self) -> tuple[Tube, ...]:
        """Tube of every segment, inner to outer, straight from its clamp."""

    @property
    def buffer_warnings(self) -> list[str]:
        """Warnings of tubes in the buffer section."""
        return buffer_warnings(self)

    @property
    def distance(self) -> float:
        """Distance of the tubes from the centreline, m."""
        return float(self.offset or 0.0)

    @property
    def axes(self) -> Array:
        """Places (3 k, 2) of the tube axes in the cross-section, m."""
        count = len(self.held)
        return _axes(np.full(3 * count, self.distance), np.tile(PLACES, count))

    @cached_property
    def tubes(self) -> tuple[Tube, ...]:  # type: ignore[override]  # nobody writes to a frozen robot
        """The 3 k tubes: three of the innermost segment, then three of the next."""
        return tuple(tube for tube in self.held for _ in range(3))

    @property
    def bent_offset(self) -> float:
        """Largest offset times precurvature: the relative difference of the lengths of tubes in a bend."""
        return self.distance * max(abs(tube.curvature) for tube in self.held)

    def modelled(self, *, loaded: bool = False) -> Self | BundleRobot:
        """This robot, or its bundle if no model is stated and the balance of moments is not enough.

        That is so under loads or friction (`loaded`), and with an offset of more than LARGEST_OFFSET of a radius of
        precurvature.
        """
        return self.bundle() if self.model is None and (loaded or self.bent_offset > LARGEST_OFFSET) else self

    def check_model(self) -> None:
        """Raise InputError for a model that is not that of this class."""
        if self.model not in (None, "thesis"):
            raise InputError(f"model is {self.model!r}; it must be thesis or None: bundle() has the model energy")

    def check_bends(self) -> None:
        """Raise InputError if a precurvature is tighter than the robot is thick."""
        for i, tube in enumerate(self.held, start=1):
            if self.distance * abs(tube.curvature) >= 0.25:
                which = f" of segment {i}" if len(self.held) > 1 else ""
                raise InputError(
                    f"offset is {self.distance:g} m; it must be less than a quarter of the radius of precurvature"
                    f"{which}, {0.25 / abs(tube.curvature):g} m"
                )

    def bundle(self) -> BundleRobot:
        """The same tubes, each of its own length, as a robot with an energy; a carriage moves each segment."""
        count = len(self.held)
        return BundleRobot(
            self.tubes,
            (self.distance,) * (3 * count),
            PLACES * count,
            name=self.name,
            joint_limits=self.joint_limits,
            calibration=self.calibration,
            carriages=self.moving_together,
            nested_curves=count == 1,
            buffer=self.buffer,
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
    """Straight length of each tube between its clamped end and its `straight_length`, m."""
    name: str = ""
    """Name in tables and figures."""
    joint_limits: JointLimits | None = None
    """Limits of the actuators, in readings; with None the lengths of the tubes decide."""
    calibration: Calibration | None = None
    """Conversion of drive readings to joint values; None if they are equal."""
    buffer: Annotated[Buffer | None, "section between drive and plate, in which the tubes merge; default none"] = None
    """Section between drive and plate, in which the tubes merge; None without one."""
    posterior: Posterior | None = None
    """Uncertainty of the parameters after a fit; None if unknown."""
    model: str | None = field(default=None, compare=False)
    """"thesis" for this model under all conditions, which refuses loads; None takes the bundle under loads."""

    def __post_init__(self) -> None:
        must_be_plain([self.tube], "an eccentric robot")
        check_fields(self)
        self.check_model()
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
    buffer: Annotated[Buffer | None, "section between drive and plate, in which the tubes merge; default none"] = None
    """Section between drive and plate, in which the tubes merge; None without one."""
    posterior: Posterior | None = None
    """Uncertainty of the parameters after a fit; None if unknown."""
    model: str | None = field(default=None, compare=False)
    """"thesis" for this model under all conditions, which refuses loads; None takes the bundle under loads."""

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
        self.check_model()
        self.check_bends()
        self.check_drives()

    @property
    def held(self) -> tuple[Tube, ...]:
        """The tubes of the segments."""
        return self.segments


@typed
@keeps_hash
@dataclass(frozen=True)
class BundleRobot(Robot):
    """Tubes at any offsets in a flexible sheath, each with its own length, rotation and translation.

    The tubes slide in frictionless channels of a sheath that neither twists nor stretches along its centreline. Its
    equilibria are minima of an energy, which contains the axial forces of the tubes.

    Raises:
        InputError: numbers of tubes, offsets and angles that differ, tubes of pieces, tubes that overlap, or that are
            curved more tightly than a quarter of the robot's thickness allows.
    """

    tubes: tuple[Tube, ...]
    """Tubes (n,)."""
    offset: Annotated[tuple[float, ...], unit("mm"), NOT_NEGATIVE, "distance of each tube axis from the centreline"]
    """Distances (n,) of the tube axes from the centreline, m."""
    angle: Annotated[tuple[float, ...], unit("deg"), "direction of each tube axis from the centreline"]
    """Directions (n,) of the tube axes from the centreline, rad."""
    sheath_stiffness: Annotated[float, unit("N_mm2"), NOT_NEGATIVE, "bending stiffness of the sheath"] = 0.0
    """Bending stiffness of the sheath, N m^2."""
    sheath_diameter: Annotated[float | None, unit("mm"), NOT_NEGATIVE, "inner diameter of the sheath"] = None
    """Inner diameter of the sheath, m; None if the sheath touches the tubes."""
    sheath_rigid_length: Annotated[float, unit("mm"), NOT_NEGATIVE, "length of the rigid part of the sheath"] = 0.0
    """Length of the sheath from the plate that is rigid and straight, m."""
    sheath_rigid_from: Annotated[
        float | None, unit("mm"), POSITIVE, "length of the sheath in front of its rigid tip; default no rigid tip"
    ] = None
    """Length of the sheath in front of its rigid and straight tip, m; None if the tip is flexible."""
    name: str = ""
    """Name in tables and figures."""
    joint_limits: JointLimits | None = None
    """Limits of the actuators, in readings; None allows what the lengths allow."""
    calibration: Calibration | None = None
    """Conversion of drive readings to joint values; None if they are equal."""
    buffer: Annotated[Buffer | None, "section between drive and plate, in which the tubes merge; default none"] = None
    """Section between drive and plate, in which the tubes merge; None without one."""
    carriages: tuple[tuple[int, ...], ...] | None = None
    """Tubes, from 0, that one carriage translates: a partition. None if each tube has its own."""
    nested_curves: Annotated[bool, "the curve of a tube may begin inside the tube around it"] = True
    """True if the curve of a tube may begin inside the tube around it; of segments it begins beyond."""
    friction: Friction | None = None
    """Friction of the tubes in their channels, for motions with friction; None if unknown."""
    posterior: Posterior | None = None
    """Uncertainty of the parameters after a fit; None if unknown."""
    fixed_sections = False

    def __post_init__(self) -> None:
        must_be_plain(self.tubes, "a bundle robot")
        check_friction(self.friction, len(self.tubes), channels=True)
        check_fields(self)
        n = len(self.tubes)
        if not n:
            raise InputError("tubes is empty; a robot needs at least one tube")
        for name in ("offset", "angle"):
            if len(getattr(self, name)) != n:
                raise InputError(f"{name} has {len(getattr(self, name))} numbers; it must have {n}, one per tube")
        for i, (tube, distance) in enumerate(zip(self.tubes, self.offset, strict=True), start=1):
            if distance * abs(tube.curvature) >= 0.25:
                raise InputError(
                    f"offset of tube {i} is {distance:g} m; it must be less than a quarter of its radius of "
                    f"precurvature, {0.25 / abs(tube.curvature):g} m"
                )
        if self.sheath_rigid_from is not None and self.sheath_rigid_from <= self.sheath_rigid_length:
            raise InputError(
                f"sheath_rigid_from is {self.sheath_rigid_from:g} m; it must be greater than sheath_rigid_length, "
                f"{self.sheath_rigid_length:g} m"
            )
        if self.carriages is not None and sorted(i for tubes in self.carriages for i in tubes) != list(range(n)):
            raise InputError(f"carriages are {self.carriages}; each tube from 0 to {n - 1} must be in one of them")
        self._check_fit()
        self.check_drives()

    @property
    def buffer_warnings(self) -> list[str]:
        """Warnings of tubes in the buffer section."""
        return buffer_warnings(self)

    @property
    def axes(self) -> Array:
        """Places (n, 2) of the tube axes in the cross-section, m."""
        return _axes(np.array(self.offset), np.array(self.angle))

    def _check_fit(self) -> None:
        """Raise InputError for tubes that overlap, or reach beyond the sheath."""
        radius = [tube.outer_diameter / 2 for tube in self.tubes]
        nested = set(self.nested_pairs) | {(j, i) for i, j in self.nested_pairs}
        for i, j in combinations(range(len(self.tubes)), 2):
            apart = float(np.linalg.norm(self.axes[i] - self.axes[j]))
            if apart <= SAME_AXIS and any({i, j} <= set(stack) for stack in self.stacks):
                continue
            if (i, j) not in nested and apart < (radius[i] + radius[j]) * (1 - 1e-9):
                raise InputError(
                    f"tubes {i + 1} and {j + 1} are {apart:g} m apart; their axes must be at least "
                    f"{radius[i] + radius[j]:g} m apart, or the same with one tube inside the other"
                )
        widest = self.least_sheath_diameter
        if self.sheath_diameter is not None and self.sheath_diameter < widest * (1 - 1e-9):
            raise InputError(
                f"sheath_diameter is {self.sheath_diameter:g} m; it must be at least {widest:g} m to contain the tubes"
            )

    @property
    def least_sheath_diameter(self) -> float:
        """Diameter of the smallest circle about the centreline around all tubes, m."""
        return 2 * max(d + tube.outer_diameter / 2 for d, tube in zip(self.offset, self.tubes, strict=True))

    @cached_property
    def stacks(self) -> tuple[tuple[int, ...], ...]:
        """Tubes on one axis, inner to outer."""
        out: list[list[int]] = []
        for i in sorted(range(len(self.tubes)), key=lambda i: self.tubes[i].outer_diameter):
            same = [stack for stack in out if np.abs(self.axes[stack[0]] - self.axes[i]).max() <= SAME_AXIS]
            if same and self.tubes[same[0][-1]].outer_diameter <= self.tubes[i].inner_diameter:
                same[0].append(i)
            else:
                out.append([i])
        return tuple(map(tuple, out))

    @property
    def moving_together(self) -> tuple[tuple[int, ...], ...]:
        """Tubes of each carriage."""
        return self.carriages or tuple((i,) for i in range(len(self.tubes)))

    @cached_property
    def nested_pairs(self) -> tuple[tuple[int, int], ...]:
        """Pairs of nested tubes: each tube and the next one around it on its axis."""
        return tuple(pair for stack in self.stacks for pair in pairwise(stack))

    def admit(self, translations: Array) -> None:
        """Raise InputError for a translation that moves a tube out of its carriage."""
        for i, (shift, tube) in enumerate(zip(translations.tolist(), self.tubes, strict=True), start=1):
            if shift > tube.straight_length + 1e-12:
                raise InputError(
                    f"translation of tube {i} is {shift:g} m and moves it out of its carriage; it must be at most its "
                    f"straight_length, {tube.straight_length:g} m"
                )
        for tubes in self.moving_together:
            if np.ptp(translations[[*tubes]]) > LENGTH_ROUND_OFF:
                raise InputError(
                    f"translations are {translations.tolist()} m; those of tubes "
                    f"{', '.join(str(i + 1) for i in tubes)} must be equal, since they share a carriage"
                )

    def assembly(self, translations: Array) -> Assembly:
        """Refuse: sections at fixed arc lengths are those of the balance of the thesis.

        Raises:
            InputError: always.
        """
        raise InputError(
            "kind is bundle; this function supports concentric and eccentric robots only. Bundles have forward and "
            "inverse kinematics, loads, Jacobians, compliances, snaps, motions through waypoints, plans and a servo"
        )


def by_model(function: Question) -> Question:
    """Decorate a question: with a load or friction, an eccentric robot that states no model is asked as its bundle.

    A question without a keyword `load` or `friction` is always about a load.
    """
    parameters = inspect.signature(function).parameters.values()
    keywords = [
        each.name for each in parameters if each.kind is each.KEYWORD_ONLY and each.name in ("load", "friction")
    ]

    @functools.wraps(function)
    def asked(*args: Any, **kwargs: Any) -> Any:
        """Ask the robot, or its bundle."""
        # A solve takes 0.1 ms: what is asked without a load goes straight on.
        for name in keywords:
            if kwargs.get(name) is not None:
                break
        else:
            if keywords:
                return function(*args, **kwargs)
        robot = args[0] if args else kwargs.get("robot")
        if isinstance(robot, SheathedRobot):
            modelled = robot.modelled(loaded=True)

            def of_model(value: Any) -> Any:
                """The robot, and equilibria of it at the same joint values, by the model."""
                if value is robot:
                    return modelled
                same = modelled is not robot and getattr(value, "robot", None) == robot
                return modelled.fk(value.rotations, value.translations) if same else value

            args, kwargs = tuple(map(of_model, args)), {name: of_model(value) for name, value in kwargs.items()}
        return function(*args, **kwargs)

    return asked  # type: ignore[return-value]


def model_text(robot: EccentricRobot | SegmentedEccentricRobot | BundleRobot) -> str:
    """Model of an eccentric robot and the reason for it, as text."""
    if isinstance(robot, BundleRobot):
        bent = max(d * abs(tube.curvature) for d, tube in zip(robot.offset, robot.tubes, strict=True))
        return f"energy of tubes of own length; offset times precurvature is up to {bent:.2g}"
    why = "stated; " if robot.model is not None else "equal tubes, no load; "
    return f"thesis: {why}offset times precurvature is {robot.bent_offset:.2g}"


SAME_AXIS = 1e-9
"""Distance (m) below which two axes are one."""


class Room(NamedTuple):
    """Room of the tubes in a sheath."""

    diameter: float
    """Inner diameter of the sheath, m."""
    width: float
    """Play between tubes and sheath: how much farther from the centreline all tubes can lie, m."""
    turns: float | None
    """Turns of the tubes around each other for which this room is enough; None unless equal tubes touch all around."""


def room_in_sheath(robot: EccentricRobot | SegmentedEccentricRobot | BundleRobot) -> Room:
    """Room of the tubes in the sheath of a robot, and how far they can spiral in it."""
    radius = np.array([tube.outer_diameter / 2 for tube in robot.tubes])
    distance = np.linalg.norm(robot.axes, axis=1)
    widest = 2 * float((distance + radius).max())
    diameter = (robot.sheath_diameter if isinstance(robot, BundleRobot) else None) or widest
    width = max(diameter - widest, 0.0) / 2
    outside = [i for i in range(robot.n_tubes) if i not in {inner for inner, _ in robot.nested_pairs}]
    around = np.sort(np.arctan2(*robot.axes[outside].T[::-1]))
    count, outer = len(outside), 2 * float(radius[outside[0]])
    touching = count > 1 and np.abs(distance[outside] - outer / (2 * math.sin(math.pi / count))).max() <= SAME_AXIS
    even = np.abs(np.diff(around, append=around[0] + 2 * math.pi) - 2 * math.pi / count).max() <= 1e-6
    if not touching or not even or np.ptp(radius[outside]) > 0:
        return Room(diameter, width, None)
    length = max(shift + tube.curved_length for shift, tube in zip(robot.home_translations, robot.tubes, strict=True))
    return Room(diameter, width, spiral_rate(outer, width, count) * float(length) / (2 * math.pi))


class Channel(NamedTuple):
    """Free circle along a robot."""

    diameter: float
    """Diameter, m."""
    centre: tuple[float, float]
    """Centre in the cross-section, m."""
    inside: int | None
    """Index of the tube if the channel is its bore; None between the tubes."""


def free_channel(robot: EccentricRobot | SegmentedEccentricRobot | BundleRobot) -> Channel:
    """Largest circle inside the sheath that touches no tube, or the widest bore of an innermost tube."""
    centre, around = robot.axes, {outer for _, outer in robot.nested_pairs}
    bores = [
        Channel(tube.inner_diameter, (float(centre[i][0]), float(centre[i][1])), i)
        for i, tube in enumerate(robot.tubes)
        if i not in around
    ]
    return max([channel_between(robot), *bores], key=lambda one: one.diameter)


def channel_between(robot: EccentricRobot | SegmentedEccentricRobot | BundleRobot) -> Channel:
    """Largest circle inside the sheath that touches no tube; its diameter is negative where tubes overlap everywhere.

    A largest circle touches three of tubes and sheath, or a tube and the sheath opposite to it.
    """
    centre = robot.axes
    outer = np.array([tube.outer_diameter / 2 for tube in robot.tubes])
    distance = np.hypot(*centre.T)
    radius = (getattr(robot, "sheath_diameter", None) or 2 * float((distance + outer).max())) / 2

    def clearance(at: Array) -> Array:
        """Radius (P,) of the free circle around each point (P, 2)."""
        to_tubes = np.linalg.norm(at[:, None] - centre, axis=2) - outer
        return np.asarray(np.minimum(to_tubes.min(1), radius - np.linalg.norm(at, axis=1)))

    away = np.where(distance[:, None] > 0, -centre / np.maximum(distance, 1e-300)[:, None], (1.0, 0.0))
    points = [np.zeros(2), *(away * (radius + outer - distance)[:, None] / 2)]
    # From inside, the sheath is a circle of negative radius: |p - c| = r + f for a circle of radius f around p.
    circles = [*zip(centre, outer, strict=True), (np.zeros(2), -radius)]
    for three in combinations(circles, 3):
        c, r = np.array([each[0] for each in three]), np.array([each[1] for each in three])
        # Differences of the squares are linear in (p, f): a line, on which one of the squares is a quadratic.
        rows = 2 * np.column_stack([c[1:] - c[0], r[1:] - r[0]])
        right = (c[1:] ** 2).sum(1) - (c[0] ** 2).sum() - r[1:] ** 2 + r[0] ** 2
        start, line = np.linalg.lstsq(rows, right, rcond=None)[0], np.cross(*rows)
        line /= np.linalg.norm(line) or 1.0
        sign, from_circle = np.array([1, 1, -1]), start + np.append(-c[0], r[0])
        a, b, q = (
            float((sign * one * two).sum())
            for one, two in ((line, line), (line, from_circle), (from_circle, from_circle))
        )
        root = math.sqrt(max(b * b - a * q, 0.0))
        steps = [(-b + root) / a, (-b - root) / a] if abs(a) > 1e-12 else [-q / (2 * b)] if b else []
        points += [(start + step * line)[:2] for step in steps]
    best = max(points, key=lambda point: float(clearance(point[None])[0]))
    return Channel(2 * float(clearance(best[None])[0]), (float(best[0]), float(best[1])), None)
