"""The air between a round tube and its groove, against series solutions and shape factors of the literature."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from tubeopt.shaping import STEEL
from tubeopt.shaping.heating.rig import MoldBed, Rig
from tubeopt.shaping.heating.thermal import GrooveAir, uniform_gap, uniform_gap_of
from tubeopt.typing import Array

from .heating_reference import TUBE

METAL = 1e6

touching = GrooveAir.tube_on_floor_and_wall
centred = partial(touching, standoff=math.inf)


@pytest.mark.parametrize("width", [2.0, 3.0])
def test_a_wide_square_groove_has_the_shape_factor_of_the_textbook(width: float) -> None:
    """S = 2 pi / ln(1.08 w / D): Incropera et al., Fundamentals of Heat and Mass Transfer, Table 4.1."""
    gap = uniform_gap(1.0, centred(1.0, width, width), METAL)
    assert math.pi / gap == pytest.approx(2 * math.pi / math.log(1.08 * width), rel=1e-2)


@pytest.mark.parametrize(("play", "depth"), [(0.02, 1.04), (0.05, 1.1), (0.1, 1.3)])
@pytest.mark.parametrize("leaning", [False, True])
def test_walls_of_metal_agree_with_a_series_for_any_place_of_the_tube(play: float, depth: float, leaning: bool) -> None:
    lie = touching(1.0, 1 + 2 * play, depth, 0.01) if leaning else centred(1.0, 1 + 2 * play, depth)
    assert uniform_gap(1.0, lie, METAL) == pytest.approx(_by_series(lie), rel=1e-2)


@pytest.mark.parametrize("ratio", [2.7, 20.0])
@pytest.mark.parametrize("play", [0.02, 0.05])
def test_a_board_that_conducts_little_better_than_air_agrees_with_a_series(play: float, ratio: float) -> None:
    gap = uniform_gap(1.0, centred(1.0, 1 + 2 * play, 1 + 2 * play), ratio)
    assert gap == pytest.approx(_by_two_series(1 + 2 * play, ratio), rel=1.5e-2)


touching = GrooveAir.tube_on_floor_and_wall


def test_where_all_is_air_there_is_no_gap() -> None:
    assert uniform_gap(1.0, touching(1.0, 1.1, 1.2), 1.0) == pytest.approx(0.0, abs=1e-9)


def test_where_a_tube_lies_matters_in_metal_and_hardly_in_board() -> None:
    size = 2.02e-3
    for ratio, least in ((2.7, 0.95), (300.0, 0.6)):
        middle, leaning = (uniform_gap(1.92e-3, kind(1.92e-3, size, size), ratio) for kind in (centred, touching))
        assert least < leaning / middle < least + 0.06


def test_a_rig_takes_the_even_gap_of_its_groove_unless_its_file_says_one() -> None:
    rig = Rig(mold=MoldBed(side_clearance=50e-6))
    assert 75e-6 < uniform_gap_of(TUBE, rig) < 85e-6
    steel = replace(rig, mold=replace(rig.mold, material=STEEL))
    assert uniform_gap_of(TUBE, steel) < uniform_gap_of(TUBE, rig)
    said = Rig(mold=MoldBed(gap=70e-6))
    assert uniform_gap_of(TUBE, said) == said.mold.play == 70e-6


def _by_series(lie: GrooveAir) -> float:
    """Even gap with isothermal walls: ln r and harmonics that vanish on the tube, fitted to the walls."""
    right, top, left, bottom = (0.5 + x for x in (lie.right, lie.top, lie.left, lie.bottom))
    angle = np.linspace(0.0, 2 * math.pi, 4001)[:-1]
    across, along = np.cos(angle), np.sin(angle)
    radius = np.minimum(
        np.where(across > 0, right, left) / np.maximum(abs(across), 1e-9),
        np.where(along > 0, top, bottom) / np.maximum(abs(along), 1e-9),
    )
    order, r = np.arange(1, 101), 2 * radius[:, None]
    rise = (r / r.max()) ** order - (r * r.max()) ** (-order.astype(float))
    columns = [
        np.log(2 * radius)[:, None],
        rise * np.cos(angle[:, None] * order),
        rise * np.sin(angle[:, None] * order),
    ]
    fitted = _least_squares(np.hstack(columns), np.ones(len(angle)))
    return 0.5 / float(fitted[0])


def _by_two_series(width: float, ratio: float) -> float:
    """Even gap of a tube in the middle: harmonics of the square's symmetry in the air and in the mold beyond, which
    meet at the wall in temperature and in heat flow."""
    angle = np.linspace(0.0, math.pi / 4, 801)[:-1] + math.pi / 3200
    r = width / np.cos(angle)[:, None]  # in radii of the tube
    order = 4.0 * np.arange(1, 25)
    cos, sin = np.cos(angle[:, None] * order), np.sin(angle[:, None] * order)
    high, low = r.max(), r.min()
    rising, vanishing, falling = (r / high) ** order, (r * high) ** -order, (r / low) ** -order

    def slope(power: Array, sign: int) -> Array:
        """d/dx of r^(sign n) cos(n theta), given r^(sign n)."""
        radial, turning = sign * order * power / r * cos, -order * power / r * sin
        return np.asarray(radial * np.cos(angle)[:, None] - turning * np.sin(angle)[:, None])

    # With ln r in the air and ln r / ratio in the mold, whose heat flows agree, the rest is fitted. The constant of the
    # mold is what the air resists beyond mold in its place.
    missing = np.log(r) * (1 - 1 / ratio)
    meets = np.hstack([-np.ones_like(r), (rising - vanishing) * cos, -falling * cos])
    flows = np.hstack([np.zeros_like(r), slope(rising, 1) - slope(vanishing, -1), -ratio * slope(falling, -1)])
    fitted = _least_squares(np.vstack([meets, flows]), np.concatenate([-missing[:, 0], np.zeros(len(angle))]))
    return 0.5 * float(fitted[0])


def _least_squares(matrix: Array, right: Array) -> Array:
    scale = np.linalg.norm(matrix, axis=0)
    return np.asarray(np.linalg.lstsq(matrix / scale, right, rcond=1e-13)[0] / scale)
