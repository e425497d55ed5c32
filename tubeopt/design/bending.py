"""The largest bending strain of a tube, in a pose and held straight, and how it changes with the design."""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np

from ..block.quantities import PoseNumber
from ..block.transcription.collocated import ENDS
from ..equilibrium.general_derivatives import Answer, Linearised
from ..physics.strain import bend_from_own, surface_strain
from ..robots.tubes import Tube
from ..typing import Array
from .pose import PiecePose, Pose
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
    pose = state.pose(index)
    return _of_pieces(state, pose, index, tube) if isinstance(pose, PiecePose) else _of_arcs(state, pose, index, tube)


def _of_arcs(state: State, pose: Pose, index: PoseNumber, tube: int) -> tuple[float, Array]:
    """Of tubes of one curvature each."""
    shape = state.tubes[tube]
    assembly, mesh = pose.problem.assembly, pose.problem.mesh
    section = np.repeat(mesh.section, len(pose.bend) // max(len(mesh.length), 1))
    there, curved = np.flatnonzero(assembly.present[section, tube]), assembly.curved[section, tube]
    if not len(there):
        return 0.0, np.zeros(state.layout.size)
    natural, diameter = shape.curvature * curved, np.full(len(section), shape.outer_diameter)
    given = np.column_stack([pose.theta[:, tube], pose.bend, natural, diameter])[there]
    strains, slopes = (part.full() for part in _strain().map(len(there))(given.T))
    worst = int(np.argmax(strains))
    k, slope = there[worst], slopes.reshape(5, -1, order="F")[:, worst]
    dtheta, du = pose.bend_slopes
    change = (slope[0] * dtheta[k, tube] + slope[1:3] @ du[k]) @ state.chain(index)
    change = change + slope[3] * curved[k] * state.slopes["curvature"][tube]
    return float(strains[0, worst]), change + slope[4] * state.slopes["outer_diameter"][tube]


def _of_pieces(state: State, pose: PiecePose, index: PoseNumber, tube: int) -> tuple[float, Array]:
    """Of tubes made of pieces: the largest of strain times what slots make of it."""
    shape, here = state.tubes[tube], pose.derivatives.here
    number = _pieces_there(here, shape, tube)
    there = np.flatnonzero(number >= -1)
    if not len(there):
        return 0.0, np.zeros(state.layout.size)
    numbers = (here.t.lagrange(ENDS) @ _at_points(here, tube))[there].reshape(-1, 4)
    given = np.column_stack([numbers, np.full(len(numbers), shape.outer_diameter)])
    strains, slopes = (part.full() for part in _strain().map(len(given))(given.T))
    ratios = np.array([_slot_ratio(shape, k)[0] if k >= 0 else 1.0 for k in number[there]])
    worst = int(np.argmax(strains[0] * np.repeat(ratios, len(ENDS))))
    k, end = there[worst // len(ENDS)], worst % len(ENDS)
    s = here.problem.mesh.start[k] + here.length[k] * ENDS[end]
    inwards = here.problem.mesh.start[k] + here.length[k] / 2 - s
    rows = [_change(at, tube, (s, inwards), answer) for at, _, answer in pose.derivatives.answers]
    slope = slopes.reshape(5, -1, order="F")[:, worst]
    value, change = float(strains[0, worst]), (np.array(rows) @ slope[:4]) @ state.chain(index)
    change = change + slope[4] * state.slopes["outer_diameter"][tube]
    if number[k] < 0:
        return value, change
    ratio, raised = _ratio(state, tube, int(number[k]))
    return ratio * value, ratio * change + value * raised


def _pieces_there(here: Linearised, shape: Tube, tube: int) -> Array:
    """(P,) piece of a tube in each piece of the mesh; -1 its straight part, -2 where it is not."""
    middle = here.place[:, :, tube].mean(axis=1)
    joints = shape.straight_length + np.cumsum([0.0, *(piece.length for piece in shape.pieces)])
    there = (here.here.sections.stiffness.reshape(here.shape)[..., tube] > 0).all(axis=1) & (here.length > 0)
    return np.where(there, np.minimum(np.searchsorted(joints, middle, side="right") - 1, len(joints) - 2), -2)


def _at_points(here: Linearised, tube: int) -> Array:
    """(P, K, 4) direction of the bend of a tube, curvature of the arm, and precurvature, at the points."""
    natural = np.hypot(*here.values[2:4, ..., tube])
    return np.concatenate([here.direction[..., tube, None], here.u, natural[..., None]], axis=2)


def _change(at: Linearised, tube: int, place: tuple[float, float], answer: Answer) -> Array:
    """(4,) change of `_at_points` at a place (m) of the arm, at the end of a piece that lies to the given side."""
    start, length = at.problem.mesh.start, at.length
    s, inwards = place
    k = max(int(np.searchsorted(start, s + inwards, side="right")) - 1, 0)
    x = np.clip((s - start[k]) / length[k], 0.0, 1.0)
    kb = at.values[0, k, :, tube]
    natural = np.hypot(*at.values[2:4, k, :, tube])
    grown = (answer.whole.moment[0, k, :, tube] - answer.whole.stiffness[0, k, :, tube] * natural) / kb
    moved = np.column_stack([answer.whole.phase[0, k, :, tube], answer.bent[0, k], grown])
    return np.asarray(at.t.lagrange([x])[0] @ moved)
