"""Effects that explain a difference between a robot and its drawing: table of names, meanings and functions.

All numbers on which a prediction depends are in `Setup`: drives, tubes, plate and sensor. A new effect is an entry of
`EFFECTS`, and, where it changes what no other does, a number in `Setup`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from copy import deepcopy
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import Any

import numpy as np
import scipy

from ..errors import InputError, without_unit_warnings
from ..robots.assembly import DIMENSIONS, dimensions_of
from ..robots.calibration import TABLES, Calibration
from ..robots.concentric import ConcentricRobot, Friction, friction_of
from ..robots.eccentric import BundleRobot, EccentricRobot, SegmentedEccentricRobot
from ..robots.pieces import Piece
from ..robots.robot import Robot, drawn_clearance
from ..robots.tubes import Tube
from ..typing import Array
from .measurements import Measurements
from .tube_shapes import DEGREES, MODES, TubeShape, shape_of, with_learned

CommonRobot = ConcentricRobot | EccentricRobot | SegmentedEccentricRobot | BundleRobot


@dataclass(eq=False)
class Setup:
    """Properties of a robot with n tubes of m kinds as they really are, which effects change in place. SI units.

    The robot is described by m tubes, one per segment of an eccentric one.
    """

    drives: Calibration
    friction: Array
    """(n - 1,) friction between neighbouring tubes of a concentric robot, N m per m; (0,) of others."""
    friction_by_moment: Array
    """(n - 1,) growth of this friction with the bending moment between the tubes, 1/m; (0,) of others."""
    clearance: Array
    """(n - 1,) radial clearances of every tube in the next one of a concentric robot, m; (0,) of others."""
    curvature: Array
    """(m,) precurvatures, 1/m."""
    straight_length: Array
    """(m,) lengths of the straight parts with the transmission, m."""
    curved_length: Array
    """(m,) lengths of the curved parts, m."""
    bending_stiffness: Array
    """(m,) bending stiffnesses, N m^2."""
    torsional_stiffness: Array
    """(m,) torsional stiffnesses, N m^2."""
    dead_length: Array
    """(m,) straight lengths at either end of the curved part, m."""
    fade: Array
    """(m,) lengths along which the precurvature rises behind one dead length and falls before the other, m."""
    learned: Array
    """(m * MODES,) learned changes of the precurvatures along the tubes, 1/m, see `TubeShape.learned`."""
    piece_curvature: Array
    """(p,) additions to the precurvature of `pieces`, 1/m."""
    plate_shift: Array
    """(3,) offset of the plate from its registered position, m."""
    plate_tilt: Array
    """(2,) tilt of the plate from its registered orientation, about x and y, rad."""
    sensor_offset: Array
    """(3,) offset of the tip's sensor from the tip, m, in the frame of the tube that ends last."""
    sensor_tilt: Array
    """(2,) angles between the tip's tangent and the sensor's axis, about x and y of that frame, rad."""
    transmission: float = 0.0
    """The part of `straight_length` that the file of an eccentric robot calls transmission, m."""
    pieces: tuple[tuple[int, int], ...] = ()
    """Tube and piece, from 0, of all (p) that belong to tubes with two or more."""

    @classmethod
    def of(cls, robot: Robot) -> Setup:
        """The robot, its plate and its sensor as the file describes them."""
        tubes = members(robot)
        between = _between(robot)
        extra = robot.transmission_length if isinstance(robot, EccentricRobot) else 0.0
        dimensions = dimensions_of(tubes)
        dimensions["straight_length"] += extra
        shapes = shapes_of(robot)
        bends = zip(shapes, dimensions["curvature"].tolist(), strict=True)
        dimensions["curvature"] = np.array([bend if shape is None else abs(shape.bend) for shape, bend in bends])
        drives = robot.calibration or Calibration.none(robot.n_tubes)
        pieces = tuple((k, j) for k, tube in enumerate(tubes) if len(tube.pieces) > 1 for j in range(len(tube.pieces)))
        return cls(
            drives=drives,
            **between,
            **dimensions,
            dead_length=np.array([0.0 if shape is None else shape.dead for shape in shapes]),
            fade=np.array([0.0 if shape is None else shape.fade for shape in shapes]),
            learned=np.concatenate([np.zeros(MODES) if shape is None else shape.learned for shape in shapes]),
            piece_curvature=np.zeros(len(pieces)),
            **{name: np.array(getattr(drives, name)) for name in MOUNTS},
            transmission=extra,
            pieces=pieces,
        )

    @property
    def plate_turn(self) -> Array:
        """(3, 3) rotation of the plate from its registered orientation."""
        return np.asarray(scipy.spatial.transform.Rotation.from_rotvec([*self.plate_tilt, 0.0]).as_matrix())

    @property
    def rubs(self) -> bool:
        """True if there is friction between the tubes."""
        return any(getattr(self, name).any() for name in RUBBING)

    def copy(self) -> Setup:
        """Copy that can be changed."""
        return deepcopy(self)

    @classmethod
    def mean(cls, setups: Sequence[Setup], weights: Array) -> Setup:
        """Setup with the means of all numbers of several with the same tubes; weights (K,) with the sum 1."""

        def averaged(each: Sequence[Any], names: Iterable[str]) -> dict[str, Any]:
            values = {name: [getattr(one, name) for one in each] for name in names}
            return {name: np.tensordot(weights, np.array(some), 1) for name, some in values.items()}

        arrays = [field.name for field in fields(cls) if isinstance(getattr(setups[0], field.name), np.ndarray)]
        drives = [setup.drives for setup in setups]
        numbers = [field.name for field in fields(Calibration) if isinstance(getattr(drives[0], field.name), float)]
        tables = [name for name in (*TABLES, *MOUNTS) if getattr(drives[0], name)]
        mean = averaged(drives, [*numbers, *tables])
        changed: dict[str, Any] = {name: float(x) if name in numbers else tuple(x.tolist()) for name, x in mean.items()}
        return replace(setups[0], drives=replace(drives[0], **changed), **averaged(setups, arrays))

    def same_tubes(self, other: Setup) -> bool:
        """True if both have the same tubes and friction."""
        return all(np.array_equal(getattr(self, name), getattr(other, name)) for name in TUBES)

    @without_unit_warnings()
    def robot(self, base: Robot, found_by: str = "") -> CommonRobot:
        """Robot with these numbers; raises InputError if it does not exist."""
        first = Setup.of(base)
        if self.same_tubes(first):
            tubes = members(base)
        else:
            each = enumerate(zip(members(base), shapes_of(base), strict=True))
            tubes = tuple(self._tube(tube, shape, k, first) for k, (tube, shape) in each)
        mounts: dict[str, Any] = {name: tuple(getattr(self, name).tolist()) for name in MOUNTS}
        pairs = zip(self.drives.rotation_gains, self.drives.rotation_middles, strict=True)
        middles = tuple(middle if gain != 1.0 else 0.0 for gain, middle in pairs)
        calibration = replace(self.drives, found_by=found_by, rotation_middles=middles, **mounts)
        drives = None if calibration.trivial else calibration
        if isinstance(base, ConcentricRobot):
            torque, by_moment = (tuple(part.tolist()) or (0.0,) for part in (self.friction, self.friction_by_moment))
            contact = replace(friction_of(base) or Friction(), torque=torque, by_moment=by_moment)
            friction = None if contact.trivial else contact
            loose = tuple(self.clearance.tolist()) if self.clearance.any() else None
            return replace(base, tubes=tubes, calibration=drives, friction=friction, clearance=loose)
        if isinstance(base, SegmentedEccentricRobot):
            return replace(base, segments=tubes, calibration=drives)
        if isinstance(base, EccentricRobot):
            # What is behind the straight part of the tube is transmission, as far as there is any.
            extra = max(0.0, base.transmission_length + float(self.straight_length[0] - first.straight_length[0]))
            tube = replace(tubes[0], straight_length=base.tube.straight_length)
            return replace(base, tube=tube, transmission_length=extra, calibration=drives)
        if isinstance(base, BundleRobot):
            return replace(base, tubes=tubes, calibration=drives)
        raise InputError(f"robot is a {type(base).__name__}; only robots that a file can describe can be calibrated")

    def _tube(self, tube: Tube, shape: TubeShape | None, k: int, first: Setup) -> Tube:
        lengthened = float(self.straight_length[k] - first.straight_length[k])
        changed: dict[str, Any] = {"straight_length": max(0.0, tube.straight_length + lengthened)}
        changed |= {name: float(getattr(self, name)[k]) for name in ("curvature", "curved_length")}
        kb, kt = float(self.bending_stiffness[k]), float(self.torsional_stiffness[k])
        if kb != first.bending_stiffness[k] or kt != first.torsional_stiffness[k]:
            changed |= {"bending_stiffness": kb, "torsional_stiffness": kt}
        dead, fade, modes = float(self.dead_length[k]), float(self.fade[k]), slice(k * MODES, (k + 1) * MODES)
        learned, before = self.learned[modes], first.learned[modes]
        drawn = dead == first.dead_length[k] and fade == first.fade[k] and not (learned.any() or before.any())
        if not drawn and (not tube.pieces or shape is not None):
            bend = changed["curvature"] * (1.0 if shape is None else np.sign(shape.bend))
            pieces = TubeShape(bend, dead, fade, learned).pieces(changed["curved_length"])
            return replace(tube, **changed | _of_pieces(pieces))
        changed |= self._pieces(tube, k, first)
        if learned.any():  # the tube is a chain of other pieces
            scaled = replace(tube, **changed)
            changed |= _of_pieces(with_learned(scaled.pieces, learned))
        return replace(tube, **changed)

    def _pieces(self, tube: Tube, k: int, first: Setup) -> dict[str, Any]:
        """Changed fields of a tube made of pieces; empty for other tubes."""
        if not tube.pieces:
            return {}
        bend, longer, kb, kt = (
            float(getattr(self, name)[k] / getattr(first, name)[k]) if getattr(first, name)[k] else 1.0
            for name in ("curvature", "curved_length", "bending_stiffness", "torsional_stiffness")
        )
        curvatures = dict(zip(first.pieces, self.piece_curvature.tolist(), strict=True))
        pieces = tuple(
            piece.bent(curvatures.get((k, j), 0.0)).stretched(longer).stiffened(kb, kt)
            for j, piece in enumerate(tube.pieces)
        )
        return {"pieces": pieces, "curvature": bend * max(piece.largest_curvature for piece in pieces)}


def _of_pieces(pieces: Sequence[Piece]) -> dict[str, Any]:
    """Fields of a tube that follow from its pieces."""
    return {
        "pieces": pieces,
        "curvature": max(piece.largest_curvature for piece in pieces),
        "curved_length": math.fsum(piece.length for piece in pieces),
    }


# Effects that a recording may have of its own: homing of the drives, clocks, and where plate and sensor are mounted.
PER_RECORDING = ("latency", "translation", "rotation", "plate_shift", "plate_tilt", "sensor_offset", "sensor_tilt")

# What describes the tubes, how they rub, and how loose they are.
RUBBING = ("friction", "friction_by_moment")
TUBES = (*RUBBING, "clearance", "piece_curvature", "dead_length", "fade", "learned", *DIMENSIONS)

# Where the plate and the tip's sensor stand off where they should be.
MOUNTS = ("plate_shift", "plate_tilt", "sensor_offset", "sensor_tilt")


@lru_cache(maxsize=32)
def shapes_of(robot: Robot) -> tuple[TubeShape | None, ...]:
    """Shape of every kind of tube, None of others than those made of the pieces of a `TubeShape`.

    A change along a tube is a learned one if the posterior says so.
    """
    named = () if robot.posterior is None else robot.posterior.names
    learned = {name.split("_")[2] for name in named if name.startswith("learned_curvature_")}
    return tuple(shape_of(tube, learned=str(k) in learned) for k, tube in enumerate(members(robot), start=1))


def _between(robot: Robot) -> dict[str, Array]:
    """Friction and clearances (n - 1,) between neighbouring tubes of a concentric robot; (0,) of other robots."""
    if not isinstance(robot, ConcentricRobot):
        return {name: np.zeros(0) for name in ("friction", "friction_by_moment", "clearance")}
    pairs, law = robot.n_tubes - 1, robot.friction or Friction()
    return {
        "friction": np.array(law.per_pair("torque", pairs)),
        "friction_by_moment": np.array(law.per_pair("by_moment", pairs)),
        "clearance": np.array((0.0,) * pairs if robot.clearance is None else robot.clearance),
    }


def members(robot: Robot) -> tuple[Tube, ...]:
    """Tubes that describe a robot: all of a concentric robot, one per segment of an eccentric robot."""
    if isinstance(robot, EccentricRobot):
        return (robot.tube,)
    if isinstance(robot, SegmentedEccentricRobot):
        return robot.segments
    return robot.tubes


@dataclass(frozen=True)
class Span:
    """Range of an estimated number."""

    start: float
    """Value of the robot as given."""
    low: float
    """Lower bound of the search."""
    high: float
    """Upper bound of the search."""
    scale: float
    """Size of a large change of the number."""
    prior: float
    """Standard deviation of the number in the drawing."""


@dataclass(frozen=True)
class Context:
    """Data that determine the range of an effect."""

    robot: Robot
    recordings: tuple[Measurements, ...]
    setup: Setup

    @property
    def length(self) -> float:
        """Length of the longest tube, m."""
        return max(tube.length for tube in members(self.robot))


Range = Callable[[Context, int | None], Span]
"""Range of the parameter with an index from 0 (None: common to all)."""

Change = Callable[[Setup, Setup, Sequence[int], float, bool], None]
"""Sets a parameter of a setup: (setup, first setup, indices, value, whether common)."""


@dataclass(frozen=True)
class Effect:
    """Kind of deviation from the drawing."""

    meaning: str
    """Description, with I for the number."""
    unit: str
    """Unit: "", "1/m", "rad", "m", "s", "N" or "m/N"."""
    each: str
    """Object that numbers the parameters of the effect; "" for a single parameter.

    "tube", "kind" of tube (tubes of a concentric robot, segments of an eccentric one), "piece" of a tube of two or
    more, "mode" of a learned change along a tube, "carriage", "spring" (a carriage of a concentric robot), "pair" of
    tubes with friction, "xyz" or "xy".
    """
    span: Range
    """Range of the parameter."""
    change: Change
    """Function that sets the parameter."""
    common: bool = False
    """True if one more parameter without a number applies to all at once."""
    first: int = 1
    """Smallest number of the effect."""
    needs: str = ""
    """Requirement on the data, or "".

    "time", "way" (rows in order of time), "orientation", or "plate" (a registration that does not fit the plate's pose
    itself).
    """
    sets: tuple[str, ...] = ()
    """Names of the quantities that the effect sets; effects with a common name exclude each other."""
    history: bool = False
    """True if the tip depends on the path to its configuration."""
    random: bool = False
    """True if its numbers are of one random function: they always have their prior, whose size is learned."""
    compared: str = "always"
    """Use in a model comparison: "always", "asked" (by name only, since it takes long) or "never"."""
    drives: bool = False
    """True if it changes only joint values."""
    idle: Callable[[Context, int | None], str] = lambda _, __: ""
    """Reason why the parameter with an index has no influence on this robot's tips; "" where it may have one."""


def _put(name: str, how: Callable[[float, Array], Array | float] = lambda value, _: value) -> Change:
    """Change that sets a value, or combines it with the earlier value by `how`."""

    def change(setup: Setup, first: Setup, which: Sequence[int], value: float, _: bool) -> None:
        i = list(which)
        getattr(setup, name)[i] = how(value, getattr(first, name)[i])

    return change


def _drive(name: str) -> Change:
    """Effect on a number of the drives, by its name in their calibration."""

    def change(setup: Setup, _: Setup, which: Sequence[int], value: float, __: bool) -> None:
        known: float | tuple[float, ...] = getattr(setup.drives, name)
        changed = value if isinstance(known, float) else tuple(value if i in which else x for i, x in enumerate(known))
        setup.drives = replace(setup.drives, **{name: changed})  # type: ignore[arg-type]

    return change


def _curvature(setup: Setup, first: Setup, which: Sequence[int], value: float, common: bool) -> None:
    setup.curvature[list(which)] = value * first.curvature[list(which)] if common else value


def _ratio(setup: Setup, first: Setup, which: Sequence[int], value: float, _: bool) -> None:
    """Set the bending stiffness to a multiple of the first tube's, with the same Poisson's ratio."""
    i = list(which)
    setup.bending_stiffness[i] = value * first.bending_stiffness[0]
    setup.torsional_stiffness[i] = setup.bending_stiffness[i] * (first.torsional_stiffness / first.bending_stiffness)[i]


def _nu(setup: Setup, _: Setup, which: Sequence[int], value: float, __: bool) -> None:
    setup.torsional_stiffness[list(which)] = setup.bending_stiffness[list(which)] / (1 + value)


def _within(start: float, reach: float, scale: float, prior: float) -> Range:
    return lambda _, __: Span(start, start - reach, start + reach, scale, prior)


def _own(name: str, reach: float, scale: float, prior: float, *, positive: bool = False) -> Range:
    """Range around the value in the file, or from 0 on."""

    def span(context: Context, index: int | None) -> Span:
        start = float(np.atleast_1d(getattr(context.setup.drives, name))[index or 0])
        ends = (0.0, max(start, reach)) if positive else (start - reach, start + reach)
        return Span(start, *ends, scale, prior)

    return span


def _mounted(name: str, reach: float, scale: float, prior: float) -> Range:
    """Range around the pose of the plate or the sensor in the file."""

    def span(context: Context, index: int | None) -> Span:
        start = float(getattr(context.setup, name)[index or 0])
        return Span(start, start - reach, start + reach, scale, prior)

    return span


def _curvature_span(context: Context, index: int | None) -> Span:
    if index is None:
        return Span(1.0, 0.2, 5.0, 1.0, 0.1)
    value, edge = float(context.setup.curvature[index]), 1 / members(context.robot)[index].outer_diameter
    return Span(value, -edge, edge, max(abs(value), 1.0), 0.1 * abs(value) + 0.5)


def _piece_span(context: Context, index: int | None) -> Span:
    tube, piece = context.setup.pieces[index or 0]
    tube_pieces = members(context.robot)[tube]
    value, limit = tube_pieces.pieces[piece].largest_curvature, 2 / tube_pieces.outer_diameter
    return Span(0.0, -limit, limit, max(value, 1.0), 0.1 * value + 0.5)


def _ratio_span(context: Context, index: int | None) -> Span:
    value = float(context.setup.bending_stiffness[index or 0] / context.setup.bending_stiffness[0])
    return Span(value, value / 20, value * 20, value, 0.2 * value)


def _nu_span(context: Context, index: int | None) -> Span:
    tubes = members(context.robot) if index is None else members(context.robot)[index : index + 1]
    return Span(float(np.mean([tube.material.poisson_ratio for tube in tubes])), 0.0, 0.499, 0.25, 0.1)


def _translation_span(context: Context, index: int | None) -> Span:
    together = context.robot.moving_together
    tubes = list(range(context.robot.n_tubes)) if index is None else list(together[index])
    start = context.setup.drives.translation_offsets[tubes[0]]
    limit = min(context.robot.tubes[i].straight_length - _furthest(context, i) for i in tubes)
    scale = context.length / 10
    return Span(start, start - 2 * scale, start + max(0.0, min(2 * scale, limit)), scale, 2e-3)


def _furthest(context: Context, tube: int) -> float:
    """Largest translation of a tube in the recording by the model, m."""
    drives = context.setup.drives
    measured = max((m.translations[:, tube].max() for m in context.recordings), default=0.0)
    return float(drives.translation_gains[tube] * measured + drives.translation_offsets[tube])


def _transmission_span(context: Context, index: int | None) -> Span:
    tubes = members(context.robot)
    each = context.robot.n_tubes // len(tubes)
    reach = [max(_furthest(context, i) for i in range(k * each, (k + 1) * each)) for k in range(len(tubes))]
    limit = [longest - tube.straight_length for longest, tube in zip(reach, tubes, strict=True)]
    min_length = max(limit) if index is None else limit[index]
    start = 0.0
    if isinstance(context.robot, EccentricRobot):
        start, min_length = context.robot.transmission_length, max(0.0, min_length)
    return Span(start, min(start, min_length), start + 20 * context.length, context.length, 0.1 * context.length)


def _transmission(setup: Setup, first: Setup, which: Sequence[int], value: float, _: bool) -> None:
    i = list(which)
    setup.straight_length[i] = first.straight_length[i] + value - first.transmission


def _curved_span(context: Context, index: int | None) -> Span:
    reach = 0.2 * float(context.setup.curved_length[index or 0])
    return Span(0.0, -reach, reach, context.length / 10, 2e-3)


def _together(context: Context, pair: int) -> float:
    """Largest common length in front of the plate of tube `pair` (from 0) and the next one, m."""
    tubes = context.robot.tubes
    return min(_furthest(context, i) + tubes[i].curved_length for i in (pair, pair + 1))


def _friction_span(context: Context, index: int | None) -> Span:
    """Range of a friction torque; its scale turns the tubes by 0.1 rad over the largest length in contact."""
    pair = index or 0
    length = max(_together(context, pair), 1e-3)
    scale = 0.1 * float(min(context.setup.torsional_stiffness[pair : pair + 2])) / length**2
    start = float(context.setup.friction[pair])
    return Span(start, 0.0, max(start, 50 * scale), scale, scale)


def _growth_span(context: Context, index: int | None) -> Span:
    """Range of the growth of friction with the bending moment: its scale is that of friction at the largest moment."""
    pair = index or 0
    kb, curvature = context.setup.bending_stiffness[pair : pair + 2], context.setup.curvature[pair : pair + 2]
    moment = float(kb.prod() / kb.sum() * np.abs(curvature).sum())
    scale = _friction_span(context, index).scale / max(moment, 1e-9)
    start = float(context.setup.friction_by_moment[pair])
    return Span(start, 0.0, max(start, 50 * scale), scale, scale)


def _no_friction(context: Context, index: int | None) -> str:
    pair = index or 0
    return "" if _together(context, pair) > 0 else f"tubes {pair + 1} and {pair + 2} are nowhere in front of the plate"


def _no_curve(context: Context, index: int | None) -> str:
    if index is None:
        return "" if context.setup.curvature.any() else "all tubes are straight"
    return "" if context.setup.curved_length[index] > 0 else f"tube {index + 1} has no curved part"


def _shape_span(name: str, start: float) -> Range:
    """Range of a length of the heated shape; `start` is a fraction of the curved length."""

    def span(context: Context, index: int | None) -> Span:
        known = float(getattr(context.setup, name)[index or 0])
        length = float(context.setup.curved_length[index or 0])
        return Span(known or start * length, 0.0, max(known, 0.24 * length), context.length / 10, 3e-3)

    return span


def _no_arc(context: Context, index: int | None) -> str:
    if not isinstance(context.robot, ConcentricRobot):
        return "it is of concentric robots only"
    tube = context.robot.tubes[index or 0]
    other = bool(tube.pieces) and shapes_of(context.robot)[index or 0] is None
    return f"tube {(index or 0) + 1} is a chain of pieces" if other else _no_curve(context, index)


FIRST_DECAY = 0.6
"""Deviation of a learned polynomial over that of one degree less, before the data tell it."""


def _learned_span(context: Context, index: int | None) -> Span:
    """Range of a number of a learned change, around that in the file."""
    tube, mode = divmod(index or 0, MODES)
    value, start = float(context.setup.curvature[tube]), float(context.setup.learned[index or 0])
    edge = 1 / members(context.robot)[tube].outer_diameter
    deviation = (0.1 * abs(value) + 0.5) * FIRST_DECAY ** (mode % DEGREES)
    return Span(start, start - edge, start + edge, max(abs(value), 1.0), deviation)


def _learns_nothing(context: Context, index: int | None) -> str:
    if not isinstance(context.robot, ConcentricRobot):
        return "it is of concentric robots only"
    tube = (index or 0) // MODES
    return "" if context.setup.curved_length[tube] > 0 else f"tube {tube + 1} has no curved part"


def _clearance_span(context: Context, index: int | None) -> Span:
    """Range of a clearance around its nominal value.

    A tilt grows with the square root of the clearance, with infinite slope at 0.
    """
    drawn = max(drawn_clearance(context.robot.tubes)[index or 0], 5e-6)
    start = float(context.setup.clearance[index or 0]) or drawn
    return Span(start, 0.0, 5 * max(start, drawn), drawn, 0.5 * drawn)


DEGREE = math.pi / 180

# Every effect by the kind of its parameters, in the order in which they are applied; of those that act alike a
# comparison prefers the first: drives, whose readings nothing checks, then what a drawing of tubes does not say or an
# arm's shape depends on most (a shear modulus is seldom measured, and unlike Young's does not cancel between tubes of
# one material), then what it does.
EFFECTS: dict[str, Effect] = {
    "latency": Effect(
        "the measured tips come so much later than the joint readings", "s", "",
        _own("latency", 0.5, 0.1, 0.1), _drive("latency"), needs="time", history=True, drives=True,
    ),
    "translation": Effect(
        "offset added to the translation of carriage I", "m", "carriage",
        _translation_span, _drive("translation_offsets"), drives=True,
    ),
    "rotation": Effect(
        "offset added to the rotation of tube I", "rad", "tube",
        _own("rotation_offsets", math.pi, 1.0, 10 * DEGREE), _drive("rotation_offsets"), drives=True,
    ),
    "rotation_gain": Effect(
        "factor on the rotation readings of tube I", "", "tube",
        _own("rotation_gains", 0.2, 0.1, 0.02), _drive("rotation_gains"), drives=True,
    ),
    "translation_gain": Effect(
        "factor on all translation readings, or on those of carriage I", "", "carriage",
        _own("translation_gains", 0.2, 0.1, 0.02), _drive("translation_gains"), common=True, drives=True,
    ),
    "rotation_lag": Effect(
        "time constant of tube I behind its rotation drive", "s", "tube",
        _own("rotation_lag", 1.0, 0.1, 0.1, positive=True), _drive("rotation_lag"),
        needs="way", history=True, compared="asked", drives=True,
    ),
    "translation_lag": Effect(
        "time constant of carriage I behind its drive", "s", "carriage",
        _own("translation_lag", 1.0, 0.1, 0.1, positive=True), _drive("translation_lag"),
        needs="way", history=True, compared="asked", drives=True,
    ),
    "rotation_play": Effect(
        "half width of the backlash between drive and tube I", "rad", "tube",
        _own("rotation_play", 20 * DEGREE, 0.1, DEGREE, positive=True), _drive("rotation_play"),
        needs="way", history=True, drives=True,
    ),
    "translation_play": Effect(
        "half width of the backlash between drive and carriage I", "m", "carriage",
        _own("translation_play", 5e-3, 1e-3, 5e-4, positive=True), _drive("translation_play"),
        needs="way", history=True, drives=True,
    ),
    "translation_compliance": Effect(
        "by how much carriage I of a concentric robot yields to the force of its tubes", "m/N", "spring",
        _own("translation_compliance", 0.1, 0.01, 1e-3, positive=True), _drive("translation_compliance"),
        compared="asked", drives=True,
    ),
    "friction": Effect(
        "friction torque per length between tube I and the next one, N m per m", "N", "pair",
        _friction_span, _put("friction"), needs="way", history=True, idle=_no_friction,
    ),
    "friction_by_moment": Effect(
        "more friction torque per length between tube I and the next one for every N m of bending moment between them",
        "1/m", "pair",
        _growth_span, _put("friction_by_moment"), needs="way", history=True, compared="asked", idle=_no_friction,
    ),
    "clearance": Effect(
        "radial clearance of tube I in the next one; the arm beyond its end tilts", "m", "pair",
        _clearance_span, _put("clearance"), compared="asked",
    ),
    "stiffness_ratio": Effect(
        "bending stiffness of tube I over that of the first, I >= 2, Poisson's ratio kept", "", "kind",
        _ratio_span, _ratio, first=2, sets=("bending_stiffness",), compared="never",
    ),
    "torsional_stiffness": Effect(
        "factor on the torsional stiffness GJ of tube I, or of all, EI kept", "", "kind",
        _within(1.0, 0.9, 1.0, 0.2), _put("torsional_stiffness", np.multiply),
        common=True, sets=("torsional_stiffness",),
    ),
    "curvature": Effect(
        "precurvature of tube I, 1/m; without a number, a common factor on all", "1/m", "kind",
        _curvature_span, _curvature, common=True, sets=("curvature",), idle=_no_curve,
    ),
    "piece_curvature": Effect(
        "added to the precurvature of piece J of tube I, about the axis that it is bent about", "1/m", "piece",
        _piece_span, _put("piece_curvature"),
    ),
    "curved_length": Effect(
        "length added to the curved part of tube I", "m", "kind",
        _curved_span, _put("curved_length", np.add), idle=_no_curve,
    ),
    "dead_length": Effect(
        "straight length at either end of the curved part of tube I", "m", "kind",
        _shape_span("dead_length", 0.0), _put("dead_length"), compared="asked", idle=_no_arc,
    ),
    # With little fade only the sum of dead length and half the fade is seen, so that it begins with some.
    "fade": Effect(
        "length over which the precurvature of tube I rises and falls at the ends of its curved part", "m", "kind",
        _shape_span("fade", 0.1), _put("fade"), compared="asked", idle=_no_arc,
    ),
    "learned_curvature": Effect(
        f"number J of the learned change of the precurvature along tube I: polynomials of degree 1 to {DEGREES} about "
        "x, then about y",
        "1/m", "mode",
        _learned_span, _put("learned"), compared="asked", idle=_learns_nothing, random=True,
    ),
    "bending_stiffness": Effect(
        "factor on the bending stiffness EI of tube I, GJ kept", "", "kind",
        _within(1.0, 0.9, 1.0, 0.2), _put("bending_stiffness", np.multiply), sets=("bending_stiffness",),
    ),
    "nu": Effect(
        "Poisson's ratio of all tubes, or of tube I, EI kept", "", "kind",
        _nu_span, _nu, common=True, sets=("torsional_stiffness",), compared="never",
    ),
    "transmission_length": Effect(
        "straight length behind the plate of an eccentric robot, or what is added to every tube, or to tube I: the "
        "compliance of its transmission", "m", "kind",
        _transmission_span, _transmission, common=True, sets=("transmission",),
    ),
    "plate_shift": Effect(
        "the plate stands off where the registration puts it", "m", "xyz",
        _mounted("plate_shift", 0.05, 0.01, 2e-3), _put("plate_shift"), needs="plate",
    ),
    "plate_tilt": Effect(
        "the plate is tilted against where the registration puts it", "rad", "xy",
        _mounted("plate_tilt", 0.5, 0.1, 3 * DEGREE), _put("plate_tilt"), needs="plate",
    ),
    "sensor_offset": Effect(
        "the tip's sensor sits off the tip, in the frame of the tube that ends last", "m", "xyz",
        _mounted("sensor_offset", 0.05, 0.01, 2e-3), _put("sensor_offset"),
    ),
    "sensor_tilt": Effect(
        "the sensor's axis is tilted against the tip's tangent", "rad", "xy",
        _mounted("sensor_tilt", 0.5, 0.1, 5 * DEGREE), _put("sensor_tilt"), needs="orientation",
    ),
}  # fmt: skip


TWO_NUMBERS = ("piece", "mode")
"""Objects with the number of their tube and one of their own."""


def _patterns(kind: str, effect: Effect) -> list[str]:
    """Names of the parameters of a kind, without and with a placeholder for the number."""
    alone = [kind] if effect.common or not effect.each else []
    return alone + ([kind + ("_I_J" if effect.each in TWO_NUMBERS else "_I")] if effect.each else [])


# Names of parameters, I and J being numbers from 1, or I one of x, y, z, and what they mean.
KINDS = {name: effect.meaning for kind, effect in EFFECTS.items() for name in _patterns(kind, effect)}
