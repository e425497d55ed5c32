"""Promises about tubes, computed again from the robot and its equilibria: strain, walls, nesting, lengths, travel."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from ..equilibrium.result import Equilibrium
from ..robots.concentric import ConcentricRobot
from ..typing import Array
from .requirements import Length, Nesting, Requirement, Strain, Stroke, Wall

CLOSE = 1e-6
"""Distance (m) from a breakpoint within which the arm's curvature, which jumps there, is not looked at."""

MISSED = 1e-6
"""Part of a limit by which it may be missed."""

Finding = tuple[str, str, bool]
"""A promise, what was found, whether it is kept."""


def check_tubes(one: Requirement, robot: ConcentricRobot, equilibria: tuple[Equilibrium, ...]) -> list[Finding]:
    """What becomes of a promise about tubes; nothing for other requirements."""
    match one:
        case Strain(limits=limits):
            found = largest_strain(one, robot, equilibria)
            worst = int(np.argmax(found / np.array(limits)))
            where = ["held straight"] * one.straightened + ["at the task poses"] * (one.in_poses and bool(equilibria))
            words = f"largest strain {' and '.join(where)}, in tube {worst + 1}"
            return [(words, f"{found[worst] * 100:.4f} %", bool((found <= np.array(limits) * (1 + MISSED)).all()))]
        case Wall(thickness=limit):
            least = min((tube.outer_diameter - tube.inner_diameter) / 2 for tube in robot.tubes)
            return [("least wall thickness", _mm(least), least >= limit * (1 - MISSED))]
        case Nesting(clearance=limit) if robot.n_tubes > 1:
            least = min(outer.inner_diameter - inner.outer_diameter for inner, outer in pairwise(robot.tubes))
            return [("least clearance of the diameters", _mm(least), least >= limit - 1e-3 * MISSED)]
        case Length(field=field, tube=i, limit=limit, least=at_least):
            value = getattr(robot.tubes[i], field)
            kept = value >= limit * (1 - MISSED) if at_least else value <= limit * (1 + MISSED)
            return [(f"{field.replace('_', ' ')} of tube {i + 1}", _mm(value), kept)]
        case Stroke(limit=limit) if equilibria:
            travel = float(np.ptp([e.translations for e in equilibria], axis=0).max())
            return [("longest travel of a carriage", _mm(travel), travel <= limit * (1 + MISSED))]
        case _:
            return []


def largest_strain(one: Strain, robot: ConcentricRobot, equilibria: tuple[Equilibrium, ...]) -> Array:
    """(n,) largest bending strain of every tube where `one` limits it: held straight, and at the shape points."""
    radius = np.array([tube.outer_diameter / 2 for tube in robot.tubes])
    kappa = np.array([tube.curvature for tube in robot.tubes])
    bent = radius * np.abs(kappa)
    found = bent / (1 - bent) if one.straightened else np.zeros(robot.n_tubes)
    for e in equilibria if one.in_poses else ():
        curved = np.array([tube.curved_length for tube in robot.tubes])
        places = np.concatenate([e.translations, e.translations + curved])
        inside = (np.abs(e.arc_length[:, None] - places) > CLOSE).all(axis=1)
        for i in range(robot.n_tubes):
            natural = np.where(e.arc_length > e.translations[i], kappa[i], 0.0)
            own = natural * np.array([np.cos(e.rotation[i]), np.sin(e.rotation[i])])
            strain = radius[i] * np.linalg.norm(e.curvature.T - own, axis=0) / (1 - radius[i] * np.abs(natural))
            there = inside & (e.arc_length < e.translations[i] + curved[i])
            found[i] = max(found[i], strain[there].max(initial=0.0))
    return found


def least_room(body: Any, robot: ConcentricRobot, equilibrium: Equilibrium) -> float:
    """Least distance (m) of the arm's surface at its shape points in front of the plate from a body."""
    ends = equilibrium.tube_end
    radius = np.array([tube.outer_diameter / 2 for tube in robot.tubes])
    outer = np.array([radius[np.flatnonzero(ends >= s - 1e-9)].max() for s in equilibrium.arc_length])
    return float((body.signed_distance(equilibrium.position) - outer)[1:].min())


def _mm(value: float) -> str:
    return f"{value * 1e3:.4f} mm"
