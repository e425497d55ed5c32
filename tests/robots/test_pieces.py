"""Tubes of pieces: what is given becomes plain data that says the same, or is refused with a sentence."""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from tubeopt import ConcentricRobot, EccentricRobot, InputError, Piece, Tube, forward_kinematics, load_equilibrium
from tubeopt.robots.pieces import Series, expand, extremes, spline


def varying(x: float) -> tuple[float, float, float]:
    return 18 * math.cos(20 * x), 4 * math.sin(30 * x), 12.0


def tube_of(*pieces: Piece, **more: float) -> Tube:
    return Tube.of_pieces(1.2e-3, 1e-3, pieces, straight_length=0.05, **more)


def test_a_function_becomes_a_series_of_the_same_values() -> None:
    piece = Piece(0.1, varying, bending_stiffness=lambda x: 8e-4 * (1 + 0.3 * math.sin(40 * x)))
    x, y, z = piece.precurvature
    s = np.linspace(0, 0.1, 301)
    assert np.abs(x(s) - 18 * np.cos(20 * s)).max() < 2e-12
    assert np.abs(x([-0.01, *s, 0.11]) - [x.value(t) for t in (-0.01, *s.tolist(), 0.11)]).max() < 1e-13
    assert np.abs(y(s) - 4 * np.sin(30 * s)).max() < 2e-12
    assert z == 12.0
    assert np.abs(piece.bending_stiffness(s) / 8e-4 - 1 - 0.3 * np.sin(40 * s)).max() < 1e-12


def test_fine_detail_is_resolved_by_more_panels() -> None:
    series = expand(lambda s: math.sin(3000 * s), 0.1, "precurvature", 1)[0]
    assert isinstance(series, Series)
    assert len(series.coefficients) > 8
    s = np.random.default_rng(0).uniform(0, 0.1, 500)
    assert np.abs(series(s) - np.sin(3000 * s)).max() < 1e-11


def test_pieces_are_values_that_pickle() -> None:
    one, other = (Piece(0.1, varying) for _ in range(2))
    assert one == other
    assert hash(one) == hash(other)
    assert pickle.loads(pickle.dumps(one)) == one
    tube = tube_of(one, Piece(0.02, 3.0))
    assert pickle.loads(pickle.dumps(tube)) == tube
    assert hash(tube) == hash(tube_of(other, Piece(0.02, 3.0)))


def test_a_table_is_a_spline_through_its_points() -> None:
    s = np.array([0.0, 0.01, 0.03, 0.04, 0.05, 0.055, 0.07, 0.08, 0.1])
    u = np.stack([10 + 100 * s, np.sin(40 * s), np.full(9, 2.0)], axis=1)
    piece = Piece.table(s, u)
    at = np.linspace(0, 0.1, 77)
    desired = make_interp_spline(s, u[:, 1], k=5)
    assert np.abs(piece.precurvature[1](at) - desired(at)).max() < 1e-13
    assert np.abs(piece.precurvature[0](at) - 10 - 100 * at).max() < 1e-12
    assert piece.precurvature[2] == 2.0
    assert piece.length == 0.1


def test_a_short_table_is_the_polynomial_through_it() -> None:
    piece = Piece.table([0, 0.02, 0.05], [[1, 0, 0], [3, 0, 0], [4, 0, 0]])
    assert piece.precurvature[0](0.03) == pytest.approx(np.polyval(np.polyfit([0, 2, 5], [1, 3, 4], 2), 3))


def test_the_largest_curvature_is_the_largest() -> None:
    piece = Piece(0.1, lambda x: (18 * math.cos(20 * x), 4 * math.sin(30 * x), 0.0))
    s = np.linspace(0, 0.1, 100_001)
    assert piece.largest_curvature == pytest.approx(np.hypot(18 * np.cos(20 * s), 4 * np.sin(30 * s)).max(), rel=1e-9)
    wave = spline(np.linspace(0, 1, 9), np.sin(6 * np.linspace(0, 1, 9)))
    values = wave(np.linspace(0, 1, 100_001))
    assert extremes([wave], 1.0) == pytest.approx((values.min(), values.max()), rel=1e-8)


def test_a_helix_has_the_curvature_and_torsion_of_one() -> None:
    piece = Piece.helix(0.1, 0.01, 0.05)
    lead = 0.05 / (2 * math.pi)
    assert piece.precurvature == (0.01 / (0.01**2 + lead**2), 0.0, lead / (0.01**2 + lead**2))
    assert Piece.helix(0.1, 0.01, 0.05, left=True).precurvature[2] == -piece.precurvature[2]


def test_one_arc_is_the_ordinary_tube() -> None:
    assert tube_of(Piece(0.1, 12.0)) == Tube(1.2e-3, 1e-3, 0.05, 0.1, 12.0)
    assert not tube_of(Piece(0.1, 12.0)).general
    assert tube_of(Piece(0.1, (0, 12.0, 0))).general


def test_curvature_of_a_tube_bends_all_its_pieces() -> None:
    tube = tube_of(Piece(0.03, 6.0), Piece(0.05, (-3.0, 4.0, 7.0)))
    assert tube.curvature == 6.0
    assert tube.curved_length == pytest.approx(0.08)
    bent = replace(tube, curvature=12.0)
    assert [piece.precurvature for piece in bent.pieces] == [(12.0, 0.0, 0.0), (-6.0, 8.0, 7.0)]
    assert replace(bent) == bent


def test_a_stiffness_follows_the_cross_section_unless_given() -> None:
    tube = Tube(1.2e-3, 1e-3, 0.05, 0.1, 12.0)
    thick = replace(tube, outer_diameter=1.4e-3)
    assert thick.bending_stiffness == Tube(1.4e-3, 1e-3, 0.05, 0.1, 12.0).bending_stiffness
    inputs = replace(tube, torsional_stiffness=0.05)
    assert replace(inputs, outer_diameter=1.4e-3).torsional_stiffness == 0.05
    assert replace(inputs, torsional_stiffness=None) == tube
    assert pickle.loads(pickle.dumps(replace(tube, outer_diameter=1.4e-3))) == thick
    assert replace(pickle.loads(pickle.dumps(tube)), outer_diameter=1.4e-3) == thick


def jump(s: float) -> float:
    return 10.0 if s < 0.0333 else 20.0


def dyadic_jump(s: float) -> float:
    return 10.0 if s < 0.05 else 20.0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Piece(0.1, jump), "precurvature is not smooth near 33."),
        (lambda: Piece(0.1, dyadic_jump), "precurvature is not smooth"),
        (lambda: Piece(0.1, lambda s: abs(s - 0.05)), "precurvature is not smooth"),
        (lambda: Piece(0.1, lambda s: (1.0, 2.0)), "precurvature at 0 mm of its piece is [1.0, 2.0]; it must be 3"),
        (lambda: Piece(0.1, (1.0, 2.0)), "precurvature has 2 components; it must have three, about x, y and z"),
        (lambda: Piece(0.0, 1.0), "length of a piece is 0; it must be greater than 0"),
        (lambda: Piece(0.1, 1.0, bending_stiffness=0.0), "bending_stiffness of a piece is 0 N m^2; it must be greater"),
        (
            lambda: Piece(0.1, 1.0, torsional_stiffness=lambda s: 1 - 20 * s),
            "torsional_stiffness of a piece is -1 N m^2; it must be greater than 0",
        ),
        (lambda: Piece.table([0, 0.02, 0.01], np.zeros((3, 3))), "arc_length of a table is 0.01 in row 3, after 0.02"),
        (lambda: tube_of(), "pieces is empty; a tube needs at least one piece"),
        (
            lambda: replace(tube_of(Piece(0.1, varying)), curved_length=0.2),
            "curved_length is 0.2 m; of a tube of",
        ),
        (lambda: tube_of(Piece(0.1, (0, 2000.0, 0))), "piece 1 is curved by 2000 per m; its radius must exceed"),
        (lambda: EccentricRobot(tube_of(Piece(0.1, varying))), "tube 1 is made of pieces; an eccentric robot supports"),
    ],
)
def test_what_is_no_tube_is_refused(make: Callable[[], object], message: str) -> None:
    with pytest.raises(InputError) as caught:
        make()
    assert str(caught.value).startswith(message)


def test_an_equilibrium_of_a_wavy_tube_survives_its_file(tmp_path: Path) -> None:
    wavy = Piece(0.05, varying, bending_stiffness=lambda s: 1e-3 + 0.01 * s)
    robot = ConcentricRobot((tube_of(wavy, Piece(0.05, -10.0)),))
    solved = forward_kinematics(robot, [1.0])
    solved.save(tmp_path)
    again = load_equilibrium(tmp_path)
    assert again.robot == robot
    assert again.tip_position == pytest.approx(solved.tip_position, abs=0)
