"""Own requirements, checked again: their expressions at the numbers of a robot and of its solved equilibria."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..block.own import OwnRequirement
from ..block.quantities import CLEARANCES, Look, Quantity, recorded
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..equilibrium.verification import point_at
from ..robots.concentric import ConcentricRobot
from ..robots.load import Load
from ..robots.tubes import piece_strain
from ..stability import find_stroke_force, snap_free_certificate
from ..typing import Array
from .drawn import draw
from .lookup import STRONGEST
from .requirements import Strain
from .verify_tubes import Check, largest_strain, least_room

MISSED = 1e-6
"""Part of a step by which an own requirement may be missed."""


def numbers_of(robot: ConcentricRobot, equilibria: Sequence[Equilibrium]) -> Look:
    """Quantities as numbers: of the robot, and of its equilibria by forward kinematics; along the arm by adaptive
    integration."""

    def look(one: Quantity) -> Array:
        """The numbers of one quantity."""
        if one.name == "certificate":
            return np.array([snap_free_certificate(robot, np.array(one.at))])
        if one.name == "straightened_strain":
            tube = robot.tubes[one.at[0]]
            return np.array([piece_strain(tube, tube.pieces[one.at[1]]) if tube.pieces else tube.straightened_strain])
        if one.pose is None:
            return np.array([getattr(tube, one.name) for tube in robot.tubes])
        found = equilibria[one.pose] if isinstance(one.pose, int) else draw(robot, equilibria[one.pose[0]], one.pose[1])
        match one.name:
            case "strain":
                anywhere = Strain((1.0,) * robot.n_tubes, straightened=False, in_poses=True)
                return largest_strain(anywhere, robot, (found,))[list(one.at)]
            case "clearance":
                return np.full(CLEARANCES, least_room(one.at[0], robot, found))
            case "deflection":
                force = Load(one.at)
                pushed = forward_kinematics(robot, found.rotations, found.translations, load=force, guess=found)
                return pushed.tip_position - found.tip_position
            case "stroke_force":
                limit = find_stroke_force(
                    robot, found.rotations, found.translations, equilibrium=found, up_to=STRONGEST
                )
                return np.array([STRONGEST if limit is None else limit.factor])
            case "jacobian":
                return found.jacobian().position.ravel(order="F")
            case "turning":
                return found.jacobian().rotation.ravel(order="F")
            case "tip_direction":
                return np.asarray(found.tip_rotation[:, 2])
            case "position" | "curvature":
                place, bend = point_at(found, one.at[0] * float(found.arc_length[-1]))
                return place if one.name == "position" else bend
            case name:
                return np.atleast_1d(getattr(found, name))

    return look


def check_own(one: OwnRequirement, robot: ConcentricRobot, equilibria: Sequence[Equilibrium]) -> Check:
    """What becomes of an own requirement."""
    pieces = [len(tube.pieces) or 1 for tube in robot.tubes]
    expression = recorded(one.expression, robot.n_tubes, len(equilibria), one.words, pieces)
    try:
        least = float(expression(numbers_of(robot, equilibria)).min())
    except FloatingPointError:
        return Check(one.words, "not a finite number", False)
    value = one.limit - least if one.most else one.limit + least
    return Check(one.words, f"{value * one.factor:.6g} {one.unit}".strip(), least >= -MISSED * one.size)
