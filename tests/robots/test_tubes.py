"""Tubes: derived stiffnesses and strain, and clear words for tubes that cannot be."""

from __future__ import annotations

import math
from dataclasses import FrozenInstanceError
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from tubeopt import InputError, Material, Tube

TUBE: dict[str, Any] = {
    "outer_diameter": 1e-3,
    "inner_diameter": 0.8e-3,
    "straight_length": 0.05,
    "curved_length": 0.1,
    "curvature": 12.5,
}


def test_derived_quantities_of_a_known_tube() -> None:
    tube = Tube(1e-3, 0.9e-3, 0.2, 0.2, 10.0)
    assert tube.length == pytest.approx(0.4)
    assert tube.second_moment == pytest.approx(1.688115e-14, rel=1e-6, abs=0)  # 0.04908739 * 0.3439 mm^4
    assert tube.polar_moment == 2 * tube.second_moment
    assert tube.bending_stiffness == pytest.approx(58e9 * 1.688115e-14, rel=1e-6)
    assert tube.torsional_stiffness == pytest.approx(21.5e9 * 3.37623e-14, rel=1e-6)
    # A surface 0.5 mm off the axis of an arc of radius 100 mm: inside it is 99.5 mm long and stretched to 100 mm.
    assert tube.straightened_strain == pytest.approx(0.5 / 99.5)


@given(st.floats(1e-4, 1e-2), st.floats(0, 0.99))
def test_second_moment_is_the_integral_over_the_wall(outer: float, part: float) -> None:
    tube = Tube(outer, part * outer, 0.1, 0.1, 0.0)
    wall = quad(lambda r: math.pi * r**3, part * outer / 2, outer / 2, epsabs=0.0, epsrel=1e-12)[0]
    assert tube.second_moment == pytest.approx(wall, rel=1e-9, abs=0)


@given(st.floats(-0.99, 0.99))
def test_strain_depends_on_the_size_of_the_curvature_only(bend: float) -> None:
    tube, mirrored = (Tube(1e-3, 0.8e-3, 0.0, 0.1, sign * bend / 0.5e-3) for sign in (1, -1))
    assert tube.straightened_strain == mirrored.straightened_strain >= 0
    radius = math.inf if bend == 0 else 0.5e-3 / abs(bend)
    assert tube.straightened_strain == pytest.approx(0.5e-3 / (radius - 0.5e-3), rel=1e-9)


def test_stiffness_ratio_is_one_plus_nu() -> None:
    tube = Tube(**TUBE, material=Material.from_poisson_ratio("alloy", 50e9, 0.3))
    assert tube.bending_stiffness / tube.torsional_stiffness == pytest.approx(1.3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"inner_diameter": 1e-3}, "inner_diameter is 0.001 m; it must be less than outer_diameter (0.001 m)"),
        ({"inner_diameter": 2e-3}, "inner_diameter is 0.002 m; it must be less than outer_diameter (0.001 m)"),
        ({"inner_diameter": -1e-3}, "inner_diameter is -0.001; it must be at least 0"),
        ({"outer_diameter": 0}, "outer_diameter is 0; it must be greater than 0"),
        ({"outer_diameter": -1e-3}, "outer_diameter is -0.001; it must be greater than 0"),
        ({"straight_length": -0.01}, "straight_length is -0.01; it must be at least 0"),
        ({"curved_length": -0.01}, "curved_length is -0.01; it must be at least 0"),
        (
            {"straight_length": 0, "curved_length": 0},
            "straight_length and curved_length are both 0; a tube must have a length",
        ),
        ({"curvature": 2000}, "curvature is 2000 per m; its radius must exceed half the outer_diameter (0.0005 m)"),
        ({"curvature": -2500}, "curvature is -2500 per m; its radius must exceed half the outer_diameter (0.0005 m)"),
        ({"outer_diameter": math.nan}, "outer_diameter is nan; it must be a finite number"),
        ({"curved_length": math.inf}, "curved_length is inf; it must be a finite number"),
        ({"curvature": -math.inf}, "curvature is -inf; it must be a finite number"),
        ({"curvature": "round"}, "curvature is 'round'; it must be a number"),
        ({"straight_length": None}, "straight_length is None; it must be a number"),
    ],
)
def test_impossible_tube(change: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as caught:
        Tube(**{**TUBE, **change})
    assert str(caught.value) == message


@pytest.mark.parametrize("part", ["straight_length", "curved_length"])
def test_either_part_may_be_missing(part: str) -> None:
    tube = Tube(**{**TUBE, part: 0})
    assert tube.length == pytest.approx(0.15 - TUBE[part])


def test_numbers_of_any_kind_become_floats() -> None:
    tube = Tube(np.float32(1.0), 0, 1, np.int64(2), np.float64(0.5))
    assert all(type(getattr(tube, field)) is float for field in TUBE)
    assert tube == Tube(1.0, 0.0, 1.0, 2.0, 0.5)
    assert hash(tube) == hash(Tube(1.0, 0.0, 1.0, 2.0, 0.5))


def test_tubes_are_values() -> None:
    tube = Tube(**TUBE)
    with pytest.raises(FrozenInstanceError):
        tube.curvature = 1.0  # type: ignore[misc]
