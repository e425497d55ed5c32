"""Meshes: pieces that fill the sections, short enough for coupling and bend."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given

from tests.examples import CRL, MM, THESIS, TWO_TUBE, nested, poses
from tubeopt import ConcentricRobot
from tubeopt.block.transcription.mesh import (
    BEND_PER_ELEMENT,
    WAVES_PER_ELEMENT,
    element_counts,
    make_mesh,
    section_needs,
)
from tubeopt.typing import Array


def test_coupling_rate_of_two_tubes_is_the_closed_form() -> None:
    # Equal nu: c = (1 + nu) kappa_1 kappa_2, which the file of this robot chooses as 2 / L^2.
    rate = section_needs(TWO_TUBE.assembly(np.zeros(2))).rate
    assert rate == pytest.approx([np.sqrt(2) / 0.1])


def test_coupling_rate_bounds_the_fastest_growth() -> None:
    for robot in (THESIS, CRL):
        assembly = robot.assembly(np.zeros(3))
        kb, kt, kappa = assembly.bending_stiffness, assembly.torsional_stiffness, assembly.curvature
        for rate, present, curved in zip(section_needs(assembly).rate, assembly.present, assembly.curved, strict=True):
            m = kb * kappa * curved
            c = np.outer(m, m) / kb[present].sum()
            aligned = (np.diag(c.sum(1)) - c) / kt[:, None]  # V'' / kt where all tubes point the same way
            assert rate**2 >= np.abs(np.linalg.eigvals(aligned)).max() - 1e-9
            assert rate > 0 or curved.sum() < 2


@given(poses())
def test_pieces_fill_the_sections(pose: tuple[ConcentricRobot, Array, Array]) -> None:
    robot, _, shift = pose
    assembly = robot.assembly(shift)
    mesh = make_mesh(assembly)
    assert mesh.length.sum() == pytest.approx(assembly.length.sum(), abs=1e-15)
    assert mesh.start[1:] == pytest.approx(mesh.start[:-1] + mesh.length[:-1], abs=1e-11)
    assert sorted(set(mesh.section)) == list(range(assembly.n_sections))
    assert (mesh.collocated == assembly.coupled[mesh.section]).all()
    bend = np.abs(assembly.curvature) * assembly.curved
    assert (mesh.length * section_needs(assembly).rate[mesh.section] <= WAVES_PER_ELEMENT + 1e-6).all()
    assert (mesh.length * bend.max(1, initial=0.0)[mesh.section] <= BEND_PER_ELEMENT + 1e-6).all()


def test_refinement_halves_the_curved_pieces_only() -> None:
    robot = nested((0.1, 0.1, 10.0), (0.05, 0.1, 5.0))
    assembly = robot.assembly(np.array([60.0, 40.0]) * MM)
    counts = [element_counts(assembly, level) for level in range(3)]
    straight = ~assembly.curved.any(1)
    assert straight.tolist() == [True, False, False, False]
    for coarse, fine in pairwise(counts):
        assert (fine[~straight] == 2 * coarse[~straight]).all()
        assert (fine[straight] == 1).all()


def test_nothing_in_front_of_the_plate_has_no_pieces() -> None:
    assert len(make_mesh(THESIS.assembly(np.array([-200.0, -150.0, -100.0]) * MM)).length) == 0
