"""All numbers on which a prediction depends: drives, tubes, plate and sensor; and the robot and joints they make."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..errors import InputError
from ..robots.breakpoints import DIMENSIONS, dimensions_of
from ..robots.calibration import Calibration
from ..robots.concentric import ConcentricRobot, friction_of
from ..robots.eccentric import EccentricRobot, SegmentedEccentricRobot
from ..robots.friction import Friction
from ..robots.robot import Robot
from ..robots.tubes import Tube
from ..typing import Array

CommonRobot = ConcentricRobot | EccentricRobot | SegmentedEccentricRobot

DRIVES = {
    "rotation": "rotation_offsets",
    "rotation_gain": "rotation_gains",
    "rotation_play": "rotation_play",
    "translation": "translation_offsets",
    "translation_gain": "translation_gains",
    "translation_play": "translation_play",
    "translation_compliance": "translation_compliance",
}
"""Numbers of the drives -> the table of a calibration that holds them."""


@dataclass(eq=False)
class Setup:
    """The numbers of a robot with n tubes of m kinds, as measured; effects change them in place. SI units.

    Attributes:
        latency: s by which the measured tips come later than the joint readings.
        rotation, rotation_gain, rotation_play, translation, translation_gain, translation_play, translation_compliance:
            (n,) of the drives; see `Calibration`.
        friction: (n - 1,) N m per m between neighbouring tubes of a concentric robot; (0,) of others.
        clearance: (n - 1,) m, radial, of every tube in the next one of a concentric robot; (0,) of others.
        curvature, straight_length, curved_length, bending_stiffness, torsional_stiffness: (m,) of the tubes that the
            robot is described by, one per segment of an eccentric one; straight_length with the transmission.
        piece_curvature: (p,) 1/m added to the precurvature of `pieces`, all those of tubes that have two or more: the
            tube and the piece, from 0.
        plate_shift, plate_tilt: (3,) m and (2,) rad about x and y, by which the plate stands off where the
            registration puts it.
        sensor_offset: (3,) m, of the tip's sensor from the tip, in the frame of the tube that ends last.
        sensor_tilt: (2,) rad about x and y of that frame, between the tip's tangent and the sensor's axis.
        transmission: the part of straight_length that the file of an eccentric robot calls transmission, m.
    """

    latency: float
    rotation: Array
    rotation_gain: Array
    rotation_play: Array
    translation: Array
    translation_gain: Array
    translation_play: Array
    translation_compliance: Array
    friction: Array
    clearance: Array
    curvature: Array
    straight_length: Array
    curved_length: Array
    bending_stiffness: Array
    torsional_stiffness: Array
    piece_curvature: Array
    plate_shift: Array
    plate_tilt: Array
    sensor_offset: Array
    sensor_tilt: Array
    transmission: float = 0.0
    pieces: tuple[tuple[int, int], ...] = ()

    @classmethod
    def of(cls, robot: Robot) -> Setup:
        """The robot as its file describes it, on a plate and with a sensor that are where they should be."""
        drives = robot.calibration or Calibration.none(robot.n_tubes)
        tubes = members(robot)
        extra = robot.transmission_length if isinstance(robot, EccentricRobot) else 0.0
        dimensions = dimensions_of(tubes)
        dimensions["straight_length"] += extra
        pieces = tuple((k, j) for k, tube in enumerate(tubes) if len(tube.pieces) > 1 for j in range(len(tube.pieces)))
        return cls(
            latency=drives.latency,
            **{name: np.array(getattr(drives, table)) for name, table in DRIVES.items()},
            friction=_torques(robot),
            clearance=_clearance(robot),
            **dimensions,
            piece_curvature=np.zeros(len(pieces)),
            plate_shift=np.zeros(3),
            plate_tilt=np.zeros(2),
            sensor_offset=np.zeros(3),
            sensor_tilt=np.zeros(2),
            transmission=extra,
            pieces=pieces,
        )

    def copy(self) -> Setup:
        """The same numbers, to be changed."""
        return deepcopy(self)

    def same_tubes(self, other: Setup) -> bool:
        """Whether both describe the same tubes, which rub alike."""
        return all(np.array_equal(getattr(self, name), getattr(other, name)) for name in TUBES)

    def calibration(self, found_by: str = "") -> Calibration | None:
        """The part that the drives have; None where they read true."""
        tables: dict[str, Any] = {table: tuple(getattr(self, name).tolist()) for name, table in DRIVES.items()}
        found = Calibration(**tables, latency=self.latency, found_by=found_by)
        return None if found.trivial else found

    def robot(self, given: Robot, found_by: str = "") -> CommonRobot:
        """The robot with these numbers; raises InputError where there is none."""
        first = Setup.of(given)
        if self.same_tubes(first):
            tubes = members(given)
        else:
            tubes = tuple(self._tube(tube, k, first) for k, tube in enumerate(members(given)))
        extra = 0.0
        if isinstance(given, EccentricRobot):
            # What is behind the straight part of the tube is transmission, as far as there is any.
            extra = max(0.0, given.transmission_length + float(self.straight_length[0] - first.straight_length[0]))
        drives = self.calibration(found_by)
        if isinstance(given, ConcentricRobot):
            friction = _with_torque(friction_of(given), self.friction)
            loose = tuple(self.clearance.tolist()) if self.clearance.any() else None
            return replace(given, tubes=tubes, calibration=drives, friction=friction, clearance=loose)
        return _rebuild(given, tubes, extra, drives)

    def _tube(self, tube: Tube, k: int, first: Setup) -> Tube:
        lengthened = float(self.straight_length[k] - first.straight_length[k])
        changed: dict[str, Any] = {"straight_length": max(0.0, tube.straight_length + lengthened)}
        changed |= {name: float(getattr(self, name)[k]) for name in ("curvature", "curved_length")}
        kb, kt = float(self.bending_stiffness[k]), float(self.torsional_stiffness[k])
        if kb != first.bending_stiffness[k] or kt != first.torsional_stiffness[k]:
            changed |= {"bending_stiffness": kb, "torsional_stiffness": kt}
        return replace(tube, **changed | self._pieces(tube, k, first))

    def _pieces(self, tube: Tube, k: int, first: Setup) -> dict[str, Any]:
        """What is changed piece by piece of a tube of pieces: nothing of any other."""
        if not tube.pieces:
            return {}
        bend, longer, kb, kt = (
            float(getattr(self, name)[k] / getattr(first, name)[k]) if getattr(first, name)[k] else 1.0
            for name in ("curvature", "curved_length", "bending_stiffness", "torsional_stiffness")
        )
        own = dict(zip(first.pieces, self.piece_curvature.tolist(), strict=True))
        pieces = tuple(
            piece.bent(own.get((k, j), 0.0)).stretched(longer).stiffened(kb, kt) for j, piece in enumerate(tube.pieces)
        )
        return {"pieces": pieces, "curvature": bend * max(piece.largest_curvature for piece in pieces)}


TUBES = ("friction", "clearance", "piece_curvature", *DIMENSIONS)
"""What describes the tubes, how they rub, and how loose they are."""


def _torques(robot: Robot) -> Array:
    if not isinstance(robot, ConcentricRobot):
        return np.zeros(0)
    pairs = robot.n_tubes - 1
    return np.zeros(pairs) if robot.friction is None else np.array(robot.friction.per_pair("torque", pairs))


def _clearance(robot: Robot) -> Array:
    if not isinstance(robot, ConcentricRobot):
        return np.zeros(0)
    return np.zeros(robot.n_tubes - 1) if robot.clearance is None else np.array(robot.clearance)


def _with_torque(friction: Friction | None, torque: Array) -> Friction | None:
    """A friction with other torques per length (n - 1,), N m per m; None where nothing rubs."""
    changed = replace(friction or Friction(), torque=tuple(torque.tolist()) or (0.0,))
    return None if changed.trivial else changed


def members(robot: Robot) -> tuple[Tube, ...]:
    """The tubes that a robot is described by: all of a concentric one, one per segment of an eccentric one."""
    if isinstance(robot, EccentricRobot):
        return (robot.tube,)
    if isinstance(robot, SegmentedEccentricRobot):
        return robot.segments
    return robot.tubes


def _rebuild(
    given: Robot, tubes: tuple[Tube, ...], transmission: float, drives: Calibration | None
) -> EccentricRobot | SegmentedEccentricRobot:
    if isinstance(given, SegmentedEccentricRobot):
        return replace(given, segments=tubes, calibration=drives)
    if isinstance(given, EccentricRobot):
        kept = replace(tubes[0], straight_length=given.tube.straight_length)
        return replace(given, tube=kept, transmission_length=transmission, calibration=drives)
    raise InputError(f"robot is a {type(given).__name__}; only robots that a file can describe can be calibrated")
