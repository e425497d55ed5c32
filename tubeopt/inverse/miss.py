"""Messages on a missed target: its distance, the active constraints, and the limiting one."""

from __future__ import annotations

import numpy as np
import scipy

from ..equilibrium.arm_surface import MAX_CONTACTS
from ..files.units import TO_MM
from .goal import DIRECTION_TOLERANCE, POSITION_TOLERANCE, Goal
from .posture import Posture

SMALL_MARGIN = 0.01
"""Bound on the margin below which a smaller one is not advised."""

ACTIVE = 1e-5
"""Largest distance from an active constraint, in units of the joints' scales."""

MIN_MULTIPLIER = 0.05
"""Smallest multiplier, relative to the gradient of the residual, of a constraint that causes a miss."""


def limiting_constraint(goal: Goal, at: Posture) -> tuple[str, str]:
    """Constraint with the largest multiplier at the end of a search, and advice; empty if none limits the tip.

    At a minimum the gradient of the residual is a sum of normals of constraints with multipliers >= 0 (Karush, Kuhn and
    Tucker).
    """
    rows, bounds, names = goal.constraints(at)
    normals = rows * goal.space.scale
    size = np.linalg.norm(normals, axis=1)
    active = np.flatnonzero((size > 0) & (bounds >= -ACTIVE * size))
    gradient = goal.slope(at).T @ goal.residual(at) * goal.space.scale
    if not len(active) or not gradient.any():
        return "", ""
    # Least squares, since a search ends near a minimum only.
    multiplier, _ = scipy.optimize.nnls((normals[active] / size[active, None]).T, gradient)
    if multiplier.max() < MIN_MULTIPLIER * np.linalg.norm(gradient):
        return "", ""
    k, ranges = int(active[np.argmax(multiplier)]), len(at.step_bounds)
    if k < ranges:
        return goal.space.limit(k), "move the target"
    if k == ranges:
        margin = f"margin at its bound ({goal.min_margin:g})"
        return margin, "allow a smaller min_margin" if goal.min_margin > SMALL_MARGIN else "move the target"
    if names[k] < 0:
        return next(iter(goal.extras.active(at)), ""), "relax that constraint"
    body = int(names[k]) // MAX_CONTACTS
    name = f"arm at obstacle {body + 1} ({type(goal.scene.bodies[body]).__name__.lower()})"
    return name, "allow a smaller clearance" if goal.clearance else "move the target away from it"


def millimetres(length: float) -> str:
    """Text of a length (m) in mm, with three digits or as a whole number."""
    size = length * TO_MM
    return f"{size:.3g} mm" if size < 1e3 else f"{size:.0f} mm"


def miss_text(goal: Goal, at: Posture) -> str:
    """Text of the position and direction errors of a posture."""
    position, direction = goal.position_error(at), goal.direction_error(at)
    parts = []
    if position > POSITION_TOLERANCE or not goal.pointed:
        parts.append(f"{millimetres(position)} short")
    if goal.pointed and (direction > DIRECTION_TOLERANCE or not parts):
        parts.append(f"{np.degrees(direction):.3g} deg off the direction")
    return " and ".join(parts)


def active_constraints(goal: Goal, at: Posture) -> list[str]:
    """Texts of the constraints that are active at the end of a search."""
    names = goal.space.active(at.q)
    if at.margin - goal.kept_margin < 1e-3:
        names.append(f"margin at its bound ({goal.min_margin:g})")
    for k in np.unique(goal.contacts(at, goal.kept_clearance + 1e-5).body).tolist():
        names.append(f"arm at obstacle {k + 1} ({type(goal.scene.bodies[k]).__name__.lower()})")
    return names + goal.extras.active(at)
