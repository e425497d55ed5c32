"""The largest bending strain of a tube, in a pose and held straight, and how it changes with the design."""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np

from ..block.quantities import PoseNumber
from ..block.transcription.buffered import mapped
from ..equilibrium.linearised import PLACES
from ..physics.strain import bend_from_own, surface_strain
from ..robots.tubes import Tube
from ..typing import Array
from .state import State


@lru_cache(maxsize=1)
def _strain() -> ca.Function:
    """(theta, u (2,), precurvature, outer diameter) -> strain, and its slope (1, 5)."""
    x = ca.SX.sym("x", 5)
    theta, u, natural, diameter = x[0], (x[1], x[2]), x[3], x[4]
    bend = bend_from_own((ca.cos(theta), ca.sin(theta)), u, natural)
    strain = surface_strain(diameter / 2, bend, natural)
    return ca.Function("strain", [x], [strain, ca.densify(ca.jacobian(strain, x))])


@lru_cache(maxsize=1)
def _straightened() -> ca.Function:
    """(precurvature, outer diameter) -> strain held straight, and its slope (1, 2)."""
    x = ca.SX.sym("x", 2)
    strain = surface_strain(x[1] / 2, ca.fabs(x[0]), x[0])
    return ca.Function("straightened", [x], [strain, ca.densify(ca.jacobian(strain, x))])


@lru_cache(maxsize=1024)
def _slot_ratio(tube: Tube, number: int) -> tuple[float, float]:
    """How many times as much as a whole tube a piece is strained, and the change of that with the share of its bending
    stiffness that is left."""
    if not tube.pieces or (slots := tube.pieces[number].slots) is None:
        return 1.0, 0.0
    b = ca.SX.sym("b")
    ratio = slots.strain_ratio(b)
    told = ca.Function("ratio", [b], [ratio, ca.jacobian(ratio, b)])
    value, slope = told(tube.pieces[number].bending_factor(float(tube.bending_stiffness)))
    return float(value), float(slope)


def _ratio(state: State, tube: int, number: int) -> tuple[float, Array]:
    """What slots multiply the strain of a piece by, and its change (X,)."""
    shape, space = state.tubes[tube], state.layout.space
    value, slope = _slot_ratio(shape, number)
    change = np.zeros(state.layout.size)
    for column, one in enumerate(space.unknowns):
        if one.field == "piece_bending_factor" and (tube, number) in one.pieces:
            left = shape.pieces[number].bending_factor(float(shape.bending_stiffness))
            change[column] = slope * left / state.x[column]
    return value, change


def straightened_strain(state: State, tube: int, number: int) -> tuple[float, Array]:
    """Largest strain of a piece of a tube held straight, and its change (X,); a tube of one curvature is one piece."""
    shape, space = state.tubes[tube], state.layout.space
    if not space.pieced:
        natural, change = shape.curvature, state.slopes["curvature"][tube]
    else:
        natural = shape.pieces[number].largest_curvature
        designs = state.x[: state.layout.designs]
        change = np.pad(space.bend_slope(shape, (tube, number), designs), (0, state.layout.size - len(designs)))
    value, slope = (part.full().ravel() for part in _straightened()([natural, shape.outer_diameter]))
    change = slope[0] * change + slope[1] * state.slopes["outer_diameter"][tube]
    ratio, raised = _ratio(state, tube, number)
    return ratio * float(value[0]), ratio * change + float(value[0]) * raised


def pose_strain(state: State, index: PoseNumber, tube: int) -> tuple[float, Array]:
    """Largest bending strain of a tube in a pose, and its change (X,); 0 where it is not in front of the plate."""
    shape, of = state.tubes[tube], state.pose(index).derivatives
    n, mesh = of.n, of.problem.mesh
    there = np.flatnonzero((of.here.stiffness[..., tube] > 0).all(1) & (mesh.length > 0))
    if not len(there):
        return 0.0, np.zeros(state.layout.size)
    across, bend = (table[there].reshape(len(there) * len(PLACES), -1) for table in of.sections)
    theta, stiffness, moment = (across[:, k * n + tube] for k in range(3))
    given = np.column_stack([theta, bend, moment / stiffness, np.full(len(theta), shape.outer_diameter)])
    strains, slopes = (part.copy() for part in mapped(_strain(), len(given))(given))
    number = _pieces_there(shape, mesh.start[there] + mesh.length[there] / 2 + of.assembly.transmission[tube])
    ratios = np.array([_slot_ratio(shape, k)[0] if k >= 0 else 1.0 for k in number.tolist()])
    worst = int(np.argmax(strains[:, 0] * np.repeat(ratios, len(PLACES))))
    piece, end = divmod(worst, len(PLACES))
    k = int(there[piece])
    at = of.section(k, PLACES[end], of.moved[k * (len(PLACES) - 1) + end])
    kb, natural = stiffness[worst], given[worst, 3]
    grown = (at.by_tubes[2 * n + tube] - natural * at.by_tubes[n + tube]) / kb
    slope, value = slopes.reshape(-1, 5)[worst], float(strains[worst, 0])
    change = (slope[0] * at.by_tubes[tube] + slope[1:3] @ at.by_curvature + slope[3] * grown) @ state.chain(index)
    change = change + slope[4] * state.slopes["outer_diameter"][tube]
    if number[piece] < 0:
        return value, change
    ratio, raised = _ratio(state, tube, int(number[piece]))
    return ratio * value, ratio * change + value * raised


def _pieces_there(shape: Tube, place: Array) -> Array:
    """(P,) piece of a tube at places along it, m; -1 its straight part, and all of a tube of one curvature."""
    joints = shape.straight_length + np.cumsum([0.0, *(piece.length for piece in shape.pieces)])
    return np.minimum(np.searchsorted(joints, place, side="right") - 1, len(shape.pieces) - 1)
