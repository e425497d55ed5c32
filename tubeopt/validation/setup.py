"""All numbers on which a prediction depends: drives, tubes, plate and sensor; and the robot and joints they make."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from ..errors import InputError, undoubted
from ..robots.breakpoints import DIMENSIONS, dimensions_of
from ..robots.calibration import Calibration
from ..robots.concentric import ConcentricRobot, friction_of
from ..robots.eccentric import EccentricRobot, SegmentedEccentricRobot
from ..robots.friction import Friction
from ..robots.robot import Robot
from ..robots.tubes import Tube
from ..typing import Array

CommonRobot = ConcentricRobot | EccentricRobot | SegmentedEccentricRobot


@dataclass(eq=False)
class Setup:
    """The numbers of a robot with n tubes of m kinds, as measured; effects change them in place. SI units.

    The robot is described by m tubes, one per segment of an eccentric one.
    """

    drives: Calibration
    friction: Array
    """(n - 1,) N m per m between neighbouring tubes of a concentric robot; (0,) of others."""
    clearance: Array
    """(n - 1,) m, radial, of every tube in the next one of a concentric robot; (0,) of others."""
    curvature: Array
    """(m,) 1/m."""
    straight_length: Array
    """(m,) m, with the transmission."""
    curved_length: Array
    """(m,) m."""
    bending_stiffness: Array
    """(m,) N m^2."""
    torsional_stiffness: Array
    """(m,) N m^2."""
    piece_curvature: Array
    """(p,) 1/m added to the precurvature of `pieces`."""
    plate_shift: Array
    """(3,) m by which the plate stands off where the registration puts it."""
    plate_tilt: Array
    """(2,) rad about x and y, of the same."""
    sensor_offset: Array
    """(3,) m, of the tip's sensor from the tip, in the frame of the tube that ends last."""
    sensor_tilt: Array
    """(2,) rad about x and y of that frame, between the tip's tangent and the sensor's axis."""
    transmission: float = 0.0
    """The part of `straight_length` that the file of an eccentric robot calls transmission, m."""
    pieces: tuple[tuple[int, int], ...] = ()
    """Tube and piece, from 0, of all (p) that belong to tubes with two or more."""

    @classmethod
    def of(cls, robot: Robot) -> Setup:
        """The robot, its plate and its sensor as the file describes them."""
        tubes = members(robot)
        torque, clearance = _between(robot)
        extra = robot.transmission_length if isinstance(robot, EccentricRobot) else 0.0
        dimensions = dimensions_of(tubes)
        dimensions["straight_length"] += extra
        drives = robot.calibration or Calibration.none(robot.n_tubes)
        pieces = tuple((k, j) for k, tube in enumerate(tubes) if len(tube.pieces) > 1 for j in range(len(tube.pieces)))
        return cls(
            drives=drives,
            friction=torque,
            clearance=clearance,
            **dimensions,
            piece_curvature=np.zeros(len(pieces)),
            **{name: np.array(getattr(drives, name)) for name in MOUNTS},
            transmission=extra,
            pieces=pieces,
        )

    @property
    def plate_turn(self) -> Array:
        """(3, 3) by which the plate is tilted from where the registration puts it."""
        return np.asarray(scipy.spatial.transform.Rotation.from_rotvec([*self.plate_tilt, 0.0]).as_matrix())

    def copy(self) -> Setup:
        """The same numbers, to be changed."""
        return deepcopy(self)

    def same_tubes(self, other: Setup) -> bool:
        """Whether both describe the same tubes, which rub alike."""
        return all(np.array_equal(getattr(self, name), getattr(other, name)) for name in TUBES)

    @undoubted()
    def robot(self, given: Robot, found_by: str = "") -> CommonRobot:
        """The robot with these numbers; raises InputError where there is none."""
        first = Setup.of(given)
        if self.same_tubes(first):
            tubes = members(given)
        else:
            tubes = tuple(self._tube(tube, k, first) for k, tube in enumerate(members(given)))
        mounts: dict[str, Any] = {name: tuple(getattr(self, name).tolist()) for name in MOUNTS}
        pairs = zip(self.drives.rotation_gains, self.drives.rotation_middles, strict=True)
        middles = tuple(middle if gain != 1.0 else 0.0 for gain, middle in pairs)
        calibration = replace(self.drives, found_by=found_by, rotation_middles=middles, **mounts)
        drives = None if calibration.trivial else calibration
        if isinstance(given, ConcentricRobot):
            rubbing = replace(friction_of(given) or Friction(), torque=tuple(self.friction.tolist()) or (0.0,))
            friction = None if rubbing.trivial else rubbing
            loose = tuple(self.clearance.tolist()) if self.clearance.any() else None
            return replace(given, tubes=tubes, calibration=drives, friction=friction, clearance=loose)
        if isinstance(given, SegmentedEccentricRobot):
            return replace(given, segments=tubes, calibration=drives)
        if isinstance(given, EccentricRobot):
            # What is behind the straight part of the tube is transmission, as far as there is any.
            extra = max(0.0, given.transmission_length + float(self.straight_length[0] - first.straight_length[0]))
            kept = replace(tubes[0], straight_length=given.tube.straight_length)
            return replace(given, tube=kept, transmission_length=extra, calibration=drives)
        raise InputError(f"robot is a {type(given).__name__}; only robots that a file can describe can be calibrated")

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

MOUNTS = ("plate_shift", "plate_tilt", "sensor_offset", "sensor_tilt")
"""Where the plate and the tip's sensor stand off where they should be."""


def _between(robot: Robot) -> tuple[Array, Array]:
    """(n - 1,) torque of friction and clearance between the tubes of a concentric robot; (0,) of others."""
    if not isinstance(robot, ConcentricRobot):
        return np.zeros(0), np.zeros(0)
    none = (0.0,) * (robot.n_tubes - 1)
    torque = none if robot.friction is None else robot.friction.per_pair("torque", len(none))
    return np.array(torque), np.array(none if robot.clearance is None else robot.clearance)


def members(robot: Robot) -> tuple[Tube, ...]:
    """The tubes that a robot is described by: all of a concentric one, one per segment of an eccentric one."""
    if isinstance(robot, EccentricRobot):
        return (robot.tube,)
    if isinstance(robot, SegmentedEccentricRobot):
        return robot.segments
    return robot.tubes
