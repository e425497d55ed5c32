"""Quantities of a design, where equilibria are solved inside: values, and their change with the unknowns."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..block.quantities import PoseNumber, Quantity
from ..equilibrium.along import curvature_at, position_at
from ..typing import Array
from .anatomy import arm_clearance
from .bending import pose_strain, straightened_strain
from .pushed import stroke_force, tip_deflection
from .state import State

Linear = Callable[[Quantity], tuple[Array, Array]]
"""Value and change (.., X) of a quantity."""


def at_state(state: State) -> Linear:
    """Quantities at a state; poses are numbered as in its layout."""

    def look(one: Quantity) -> tuple[Array, Array]:
        """Value and change of one quantity."""
        if one not in state.known:
            state.known[one] = _told(state, one)
        return state.known[one]

    return look


def _told(state: State, one: Quantity) -> tuple[Array, Array]:
    if one.name == "certificate":
        return _row(state.certificate_at(one.at))
    if one.name == "straightened_strain":
        return _row(straightened_strain(state, *one.at))
    if one.pose is None:
        return np.array([getattr(tube, one.name) for tube in state.tubes]), state.slopes[one.name]
    match one.name:
        case "rotations" | "translations":
            part = ("rotations", "translations").index(one.name)
            return state.joint_values(one.pose)[part], state.joint_slopes(one.pose)[part]
        case "strain":
            return _row(pose_strain(state, one.pose, one.at[0]))
        case "deflection":
            return tip_deflection(state, one.pose, one.at)
        case "stroke_force":
            return _row(stroke_force(state, one.pose))
        case "jacobian" | "turning":
            return state.jacobian(one.pose, turning=one.name == "turning")
        case "clearance":
            return arm_clearance(state, one.pose, one.at[0])
    value, change = _of_pose(state, one, one.pose)
    return value, change @ state.chain(one.pose)


def _row(found: tuple[float, Array]) -> tuple[Array, Array]:
    """(1,) and (1, X) of one number."""
    return np.array(found[:1]), found[1][None]


def _of_pose(state: State, one: Quantity, index: PoseNumber) -> tuple[Array, Array]:
    """Value and change (.., 7 n) by what a pose is differentiated by."""
    pose = state.pose(index)
    match one.name:
        case "tip_position":
            return pose.position[-1], pose.tip_slope
        case "tip_direction":
            heading = pose.frame[-1][:, 2]
            return heading, np.cross(pose.tip_turn, heading[:, None], axis=0)
        case "margin":
            return np.array([pose.margin]), pose.margin_slope[None]
        case "position":
            return position_at(pose.derivatives, one.at[0])
        case _:
            return curvature_at(pose.derivatives, one.at[0])
