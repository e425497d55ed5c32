"""Numbers pass from a file to SI and back without losing a bit."""

from __future__ import annotations

import math
from decimal import Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tubeopt.files.units import DEG, GPA, MM, PER_M, PERCENT, decimal, in_unit, parse_number, shown, to_si

UNITS = [MM, GPA, PERCENT, DEG, PER_M]
FINITE = st.floats(allow_nan=False, allow_infinity=False, min_value=-1e280, max_value=1e280)


@given(FINITE, st.sampled_from(UNITS))
def test_there_and_back_is_exact(value: float, unit: Decimal) -> None:
    assert to_si(decimal(in_unit(value, unit)), unit) == value


@pytest.mark.parametrize(
    ("value", "unit", "written"),
    [(0.0009, MM, 0.9), (0.2, MM, 200), (58e9, GPA, 58), (math.pi, DEG, 180), (0.0, MM, 0)],
)
def test_what_a_person_would_write(value: float, unit: Decimal, written: float) -> None:
    assert in_unit(value, unit) == written
    assert to_si(decimal(written), unit) == value


def test_a_float_of_the_unit_cannot_hold_every_number() -> None:
    value = 0.0015000000000000013
    assert isinstance(in_unit(value, MM), Decimal) or to_si(decimal(in_unit(value, MM)), MM) == value
    lost = [x for x in (0.0015 + k * 2.2e-19 for k in range(200)) if isinstance(in_unit(x, MM), Decimal)]
    assert lost


@pytest.mark.parametrize("value", [True, "3", None, [1], {"a": 1}, 1j])
def test_what_is_no_number_is_refused(value: object) -> None:
    with pytest.raises(ValueError, match="; it must be a number"):
        decimal(value)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, Decimal("NaN"), Decimal("1e400"), 10**400])
def test_what_is_not_finite_is_refused(value: float | Decimal) -> None:
    with pytest.raises(ValueError, match="; it must be a finite number"):
        decimal(value)


def test_text_that_spells_a_number() -> None:
    assert parse_number(" -1.5e1 ") == Decimal(-15)
    assert parse_number(" abc ") == "abc"


def test_values_in_messages_are_short() -> None:
    assert shown(Decimal("-1.50")) == "-1.50"
    assert shown("a") == "'a'"
    assert len(shown("a" * 1000)) <= 60
    assert len(shown(Decimal(10) ** 20 + Decimal("1e-20"))) <= 60
    assert len(shown([[["deep"] * 100] * 100] * 100)) <= 60
