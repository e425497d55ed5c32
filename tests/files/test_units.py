"""Numbers pass from a file to SI and back without losing a bit."""

from __future__ import annotations

import math
from decimal import Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tubeopt.files import units
from tubeopt.files.units import (
    DEG,
    GPA,
    MM,
    PER_M,
    PERCENT,
    alternative_units,
    decimal,
    in_unit,
    parse_number,
    shown,
    suggest_key,
    to_si,
)

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


def in_si(name: str) -> float:
    """A unit in SI, from its prefix, base and power."""
    bases = dict.fromkeys(("m", "s", "rad", "N", "V", "A", "K", "degC", "J", "W", "kg", "ohm", "Hz", "Pa"), 1.0)
    bases |= {"g": 1e-3, "deg": math.pi / 180, "percent": 1e-2, "fraction": 1.0, "rpm": 1 / 60}
    bases |= {"inch": 0.0254, "min": 60.0, "h": 3600.0, "Ah": 3600.0}
    prefixes = {"m": 1e-3, "c": 1e-2, "u": 1e-6, "k": 1e3, "M": 1e6, "G": 1e9}

    def factor(part: str) -> float:
        base, power = (part[:-1], int(part[-1])) if part[-1].isdigit() else (part, 1)
        return float(bases[base] if base in bases else prefixes[base[0]] * bases[base[1:]]) ** power

    above, *below = f"_{name}".split("_per_")
    parts = [part for part in above.split("_") if part], [part for part in "_".join(below).split("_") if part]
    return math.prod(map(factor, parts[0])) / math.prod(map(factor, parts[1]))


def test_units_are_those_of_the_international_system() -> None:
    assert {name: float(size) for name, size in units.UNITS.items()} == pytest.approx(
        {x: in_si(x) for x in units.UNITS}, rel=1e-15
    )
    alike = {name: float(size) for unit in units.UNITS for name, size in alternative_units(unit)}
    assert alike == pytest.approx({name: in_si(name) for name in alike}, rel=1e-15)
    assert {"min", "inch", "kPa", "mAh", "per_cm"} <= set(alike)


def test_key_in_other_unit_is_reported_with_factor_to_its_own() -> None:
    assert suggest_key("hold_min", ["hold_s"]) == "; did you mean 'hold_s', 60 times the number?"
    assert suggest_key("width_inch", ["width_mm"]) == "; did you mean 'width_mm', 25.4 times the number?"
    assert suggest_key("turn_rad", ["turn_deg"]) == "; did you mean 'turn_deg', 57.2958 times the number?"
