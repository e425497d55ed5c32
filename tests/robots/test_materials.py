"""Materials: elastic constants that an isotropic solid can have, and clear words for those it cannot."""

from __future__ import annotations

import math
from dataclasses import FrozenInstanceError

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tubeopt import NITINOL, InputError, Material


def test_nitinol_has_the_moduli_of_the_thesis() -> None:
    assert (NITINOL.youngs_modulus, NITINOL.shear_modulus) == (58e9, 21.5e9)
    assert NITINOL.poisson_ratio == pytest.approx(0.3488, abs=5e-5)


@given(st.floats(1e6, 1e12), st.floats(0, 0.4999))
def test_poisson_ratio_there_and_back(modulus: float, nu: float) -> None:
    material = Material.from_poisson_ratio("alloy", modulus, nu)
    assert material.poisson_ratio == pytest.approx(nu, abs=1e-12)
    assert material.youngs_modulus == modulus


def test_limits_of_poisson_ratio_are_allowed_where_isotropy_allows_them() -> None:
    assert Material("cork", 3e9, 1.5e9).poisson_ratio == 0.0
    assert Material("rubber", 3e9, 1.0001e9).poisson_ratio == pytest.approx(0.5, abs=1e-3)


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf, "stiff", None])
@pytest.mark.parametrize("field", ["youngs_modulus", "shear_modulus", "working_strain", "superelastic_strain"])
def test_every_constant_must_be_positive_and_finite(field: str, value: object) -> None:
    constants: dict[str, object] = {"youngs_modulus": 58e9, "shear_modulus": 21.5e9, field: value}
    with pytest.raises(InputError, match=f"^{field} of material 'steel' is .*; it must be "):
        Material("steel", **constants)  # type: ignore[arg-type]


@pytest.mark.parametrize(("shear", "ratio"), [(30e9, "-0.0333"), (19e9, "0.526"), (58e9 / 3, "0.5")])
def test_impossible_pair_of_moduli(shear: float, ratio: str) -> None:
    with pytest.raises(InputError, match=f"Poisson's ratio {ratio}; it must lie in \\[0, 0.5\\)") as caught:
        Material("wrong", 58e9, shear)
    assert "E/3 and E/2 (1.93333e+10 to 2.9e+10 Pa)" in str(caught.value)


@pytest.mark.parametrize("ratio", [-0.01, 0.5, 1.0, math.nan])
def test_impossible_poisson_ratio(ratio: float) -> None:
    with pytest.raises(InputError, match=r"^poisson_ratio of material 'wrong' is .*; it must lie in \[0, 0\.5\)$"):
        Material.from_poisson_ratio("wrong", 58e9, ratio)


def test_materials_are_values() -> None:
    assert Material("a", 58e9, 21.5e9) == Material("a", 58e9, 21.5e9) != Material("b", 58e9, 21.5e9)
    with pytest.raises(FrozenInstanceError):
        NITINOL.shear_modulus = 1.0  # type: ignore[misc]
