"""Promises computed again from the robot and its equilibria: strain, walls, nesting, lengths, travel, and own
requirements by their expressions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from ..block.custom import CustomRequirement
from ..block.quantities import CLEARANCES, Look, Quantity, recorded
from ..equilibrium.answer import sure_margin
from ..equilibrium.kinematics import under_load
from ..equilibrium.result import Equilibrium
from ..equilibrium.verification import point_at
from ..physics.strain import surface_strain
from ..robots.concentric import ConcentricRobot
from ..robots.series import Series
from ..robots.tubes import Tube, piece_strain
from ..stability import find_stroke_force, snap_free_certificate
from ..typing import Array
from .deployment import draw
from .requirements import Length, Nesting, Requirement, Strain, Stroke, Wall
from .state import STRONGEST

MISSED = 1e-6
"""Part of a limit, or of a step of a custom requirement, by which it may be missed."""


@dataclass(frozen=True)
class Check:
    """One promise."""

    what: str
    """What it is."""
    found: str
    """What was found, with its unit."""
    kept: bool


def check_tubes(one: Requirement, robot: ConcentricRobot, equilibria: tuple[Equilibrium, ...]) -> list[Check]:
    """What becomes of a promise about tubes; nothing for other requirements."""
    match one:
        case Strain(limits=limits):
            found = largest_strain(one, robot, equilibria)
            worst = int(np.argmax(found / np.array(limits)))
            where = ["straightened"] * one.straightened + ["at the task poses"] * (one.in_poses and bool(equilibria))
            words = f"largest strain {' and '.join(where)}, in tube {worst + 1}"
            kept = bool((found <= np.array(limits) * (1 + MISSED)).all())
            return [Check(words, f"{found[worst] * 100:.4f} %", kept)]
        case Wall(thickness=limit):
            least = min((tube.outer_diameter - tube.inner_diameter) / 2 for tube in robot.tubes)
            return [Check("smallest wall thickness", _mm(least), least >= limit * (1 - MISSED))]
        case Nesting(clearance=limit) if robot.n_tubes > 1:
            least = min(outer.inner_diameter - inner.outer_diameter for inner, outer in pairwise(robot.tubes))
            return [Check("least clearance of the diameters", _mm(least), least >= limit - 1e-3 * MISSED)]
        case Length(field=field, tube=i, limit=limit, least=at_least):
            value = getattr(robot.tubes[i], field)
            kept = value >= limit * (1 - MISSED) if at_least else value <= limit * (1 + MISSED)
            return [Check(f"{field.replace('_', ' ')} of tube {i + 1}", _mm(value), kept)]
        case Stroke(limit=limit) if equilibria:
            travel = float(np.ptp([e.translations for e in equilibria], axis=0).max())
            return [Check("longest travel of a carriage", _mm(travel), travel <= limit * (1 + MISSED))]
        case _:
            return []


def largest_strain(one: Strain, robot: ConcentricRobot, equilibria: tuple[Equilibrium, ...]) -> Array:
    """Independent of physics.torsion: (n,) largest bending strain of every tube where `one` limits it.

    Held straight, and at the shape points, to both sides of which the tubes are bent as their balance of moments says.
    """
    found = np.array([tube.straightened_strain if one.straightened else 0.0 for tube in robot.tubes])
    for e in equilibria if one.in_poses else ():
        for aside in (-1e-9, 1e-9):  # m: the arm's curvature jumps at breakpoints
            s = e.arc_length + aside
            there = (s > 0) & (s < e.translations[:, None] + np.array([[tube.curved_length] for tube in robot.tubes]))
            own = [_own(tube, s - d) for tube, d in zip(robot.tubes, e.translations, strict=True)]
            stiffness = there * np.array([part[1] for part in own])
            turned = [part[0] * np.exp(1j * angle) for part, angle in zip(own, e.rotation, strict=True)]
            bent = (stiffness * turned).sum(axis=0) / np.maximum(stiffness.sum(axis=0), 1e-300)
            for i, tube in enumerate(robot.tubes):
                radius = tube.outer_diameter / 2
                strain = own[i][2] * surface_strain(radius, np.abs(bent - turned[i]), np.abs(own[i][0]))
                found[i] = max(found[i], strain[there[i]].max(initial=0.0))
    return found


def _own(tube: Tube, place: Array) -> tuple[Array, Array, Array]:
    """Precurvature x + j y in its own frame, 1/m, bending stiffness, N m^2, and how many times as much as a whole tube
    it is strained, (m,) each, at places from where its straight part ends, m."""
    bend, whole = np.zeros(len(place), dtype=complex), float(tube.bending_stiffness)
    stiffness, ratio, begin = np.full(len(place), whole), np.ones(len(place)), 0.0
    for piece in tube.chain:
        here = (place > begin) & (place <= begin + piece.length)
        x, y, kb = (_at(part, place[here] - begin) for part in (*piece.precurvature[:2], piece.bending_stiffness))
        bend[here] = x + 1j * y
        stiffness[here] = whole if kb is None else kb
        ratio[here] = piece.strain_ratio(whole)
        begin += piece.length
    return bend, stiffness, ratio


def _at(quantity: Any, place: Array) -> Any:
    return quantity(place) if isinstance(quantity, Series) else quantity


def least_room(body: Any, robot: ConcentricRobot, equilibrium: Equilibrium) -> float:
    """Least distance (m) of the arm's surface at its shape points in front of the plate from a body."""
    ends = equilibrium.tube_end
    radius = np.array([tube.outer_diameter / 2 for tube in robot.tubes])
    outer = np.array([radius[np.flatnonzero(ends >= s - 1e-9)].max() for s in equilibrium.arc_length])
    return float((body.signed_distance(equilibrium.position) - outer)[1:].min())


def _mm(value: float) -> str:
    return f"{value * 1e3:.4f} mm"


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
                return under_load(found, one.at[0]).tip_position - found.tip_position
            case "margin_under":
                return np.array([sure_margin(under_load(found, one.at[0]))])
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


def check_own(one: CustomRequirement, robot: ConcentricRobot, equilibria: Sequence[Equilibrium]) -> Check:
    """What becomes of a custom requirement."""
    pieces = [len(tube.pieces) or 1 for tube in robot.tubes]
    expression = recorded(one.expression, robot.n_tubes, len(equilibria), one.words, pieces)
    try:
        least = float(expression(numbers_of(robot, equilibria)).min())
    except FloatingPointError:
        return Check(one.words, "not a finite number", False)
    value = one.limit - least if one.most else one.limit + least
    return Check(one.words, f"{value * one.factor:.6g} {one.unit}".strip(), least >= -MISSED * one.size)
