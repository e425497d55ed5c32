"""Torsion of tubes that rub: the profile obeys theta' = t / kt inside the pieces of the mesh as across them."""

from __future__ import annotations

import numpy as np
import pytest

from tubeopt import ConcentricRobot, Friction, Piece, Tube
from tubeopt.block.transcription import arm as arms
from tubeopt.block.transcription.contact import contact_profile, evaluate_contact, make_contact

MM = 1e-3
STIFFNESS = 0.02


def softening(s: float) -> float:
    """GJ along a piece of 50 mm, which falls to half."""
    return STIFFNESS * (1 - 10 * s)


def test_concentrated_friction_turns_tubes_whose_stiffness_varies_along_a_piece() -> None:
    piece = Piece(50 * MM, 10.0, torsional_stiffness=softening)
    inner = Tube.of_pieces(1.2 * MM, 1.0 * MM, [piece], straight_length=30 * MM)
    outer = Tube(1.8 * MM, 1.5 * MM, 20 * MM, 40 * MM, 8.0)
    assembly = ConcentricRobot((inner, outer)).assembly(np.zeros(2))
    contact = make_contact(assembly, Friction(plate=0.05, jumps=0.05, ends=0.05))
    rotations, torque = np.array([0.2, 0.9]), np.array([1.0, -2.0, 3.0, 1.5])[: len(contact.capacity)] * 1e-3
    state = evaluate_contact(contact, rotations, 0.1 * np.ones(contact.rows.shape[1]))
    profile, problem = contact_profile(contact, rotations, state, torque), contact.problem
    ends = arms.rotations_at(problem, profile, (0.0, 1.0))
    assert ends[1:, 0] == pytest.approx(ends[:-1, 1], abs=1e-9)
    x, h = (0.2, 0.7), 1e-4
    sides = (arms.rotations_at(problem, profile, tuple(np.array(x) + side)) for side in (h, -h))
    slope = np.subtract(*sides) / (2 * h * problem.mesh.length[:, None, None])
    position = problem.mesh.start[:, None] + problem.mesh.length[:, None] * x
    stiffness = assembly.cross_sections(position.ravel(), position.ravel()).torsional_stiffness.reshape(slope.shape)
    reached = position[:, :, None] < assembly.end
    assert (slope * stiffness)[reached] == pytest.approx(arms.torques_at(problem, profile, x)[reached], abs=1e-7)
    assert np.abs(torque).min() > 0
