"""Units of files and flags, converted without loss in both directions.

Dividing a float by 1000 cannot reach every float, so that a saved robot would change when loaded. Numbers from
files are therefore stored as decimals, scaled exactly, and rounded to a float once.
"""

from __future__ import annotations

import functools
import math
import re
import reprlib
from collections.abc import Callable, Collection, Iterator
from decimal import Context, Decimal, InvalidOperation
from typing import TypeGuard

from .. import constants
from ..errors import nearest

MM = Decimal("1e-3")
GPA = Decimal("1e9")
PERCENT = Decimal("1e-2")
DEG = Decimal("0.017453292519943295769236907684886127134428718885417")
PER_M = RAD = Decimal(1)
ZERO_CELSIUS = Decimal(str(constants.ZERO_CELSIUS))

# DEG has 50 digits, floats have 17: products are exact before they are rounded to a float.
_CONTEXT = Context(prec=60)
_MINUTE = Decimal(60)

UNITS = {
    **dict.fromkeys(
        ["rad", "rad_per_m", "per_m", "m", "s", "m_per_s", "m_per_s2", "Hz", "N", "V", "A", "W", "kg"], Decimal(1)
    ),
    **dict.fromkeys(["K", "degC", "per_K", "K_per_s", "W_per_m", "W_per_m_K", "W_per_m2_K"], Decimal(1)),
    **dict.fromkeys(["J", "J_per_m", "kg_per_m3", "J_per_kg_K", "ohm_m", "ohm_m2", "A2_s"], Decimal(1)),
    **dict.fromkeys(["mm", "mm_per_s", "mm_per_s2", "mm_per_N", "mJ", "mohm", "g", "g_per_m", "ms"], Decimal("1e-3")),
    **dict.fromkeys(["mW", "mN", "mN_m", "mN_per_m", "mN_m_per_m", "mV_per_A"], Decimal("1e-3")),
    **dict.fromkeys(["deg", "deg_per_s", "deg_per_s2"], DEG),
    **dict.fromkeys(["um", "us", "mm2", "cm3", "N_mm2"], Decimal("1e-6")),
    "mm_per_min": _CONTEXT.divide(MM, _MINUTE),
    "m_per_min": _CONTEXT.divide(Decimal(1), _MINUTE),
    "rpm": _CONTEXT.divide(Decimal(1), _MINUTE),
    "deg_per_mm": _CONTEXT.divide(DEG, MM),
    "mm3": Decimal("1e-9"),
    "cm2": Decimal("1e-4"),
    "percent": PERCENT,
    "kJ": Decimal(1000),
    "GPa": GPA,
    "Ah": Decimal(3600),
}
"""Units that a key may end in -> size in SI; degC is as K, without the offset."""

CONFUSED_UNITS = (
    {"m": Decimal(1), "cm": Decimal("1e-2"), "mm": Decimal("1e-3"), "um": Decimal("1e-6"), "inch": Decimal("0.0254")},
    {"Pa": Decimal(1), "MPa": Decimal("1e6"), "GPa": Decimal("1e9"), "kPa": Decimal("1e3")},
    {"per_mm": Decimal(1000), "per_m": Decimal(1), "per_cm": Decimal(100)},
    {"s": Decimal(1), "ms": Decimal("1e-3"), "min": Decimal(60), "h": Decimal(3600)},
    {"ohm": Decimal(1), "mohm": Decimal("1e-3")},
    {"V": Decimal(1), "mV": Decimal("1e-3")},
    {"A": Decimal(1), "mA": Decimal("1e-3")},
    {"kg": Decimal(1), "g": Decimal("1e-3")},
    {"Hz": Decimal(1), "kHz": Decimal(1000)},
    {"N": Decimal(1), "mN": Decimal("1e-3")},
    {"rad": Decimal(1), "deg": DEG},
    {"rad_per_s": Decimal(1), "deg_per_s": DEG},
    {"rad_per_s2": Decimal(1), "deg_per_s2": DEG},
    {"m_per_s": Decimal(1), "mm_per_s": MM, "mm_per_min": UNITS["mm_per_min"]},
    {"m_per_s2": Decimal(1), "mm_per_s2": MM},
    {"kg_per_m": Decimal(1), "g_per_m": Decimal("1e-3")},
    {"N_m": Decimal(1), "mN_m": Decimal("1e-3")},
    {"N_m_per_m": Decimal(1), "mN_m_per_m": Decimal("1e-3")},
    {"rad_per_m": Decimal(1), "deg_per_mm": UNITS["deg_per_mm"]},
    {"fraction": Decimal(1), "percent": PERCENT},
    {"W": Decimal(1), "kW": Decimal(1000)},
    {"Ah": Decimal(3600), "mAh": Decimal("3.6")},
)
"""Groups of units that are confused with each other, the likeliest first -> size in SI."""

SIGNS = {
    "percent": "%",
    "per_m": "1/m",
    "per_mm": "1/mm",
    "per_cm": "1/cm",
    "N_mm2": "N mm²",
    "mN_m": "mN m",
    "mN_per_m": "mN/m",
    "g_per_m": "g/m",
    "mN_m_per_m": "mN m/m",
    "m_per_s": "m/s",
    "m_per_s2": "m/s²",
    "mm2": "mm²",
    "deg_per_s": "deg/s",
    "mm_per_s": "mm/s",
    "mm_per_N": "mm/N",
}
"""Units in tables, if they differ from their suffix."""

TO_MM = TO_MILLI = 1e3
"""Millimetres per metre, and thousandths of any unit, for plots and messages."""


@functools.lru_cache(maxsize=1024)
def unit_of(key: str) -> str:
    """Unit at the end of a key, the longest of `UNITS`: "mm_per_s" of "tip_speed_mm_per_s"; "" without a unit."""
    parts = key.split("_")
    # The longest ending goes first: "mm_per_s" ends in "s" too.
    endings = ("_".join(parts[k:]) for k in range(1, len(parts)))
    return next((ending for ending in endings if ending in UNITS), "")


def split_unit(key: str) -> tuple[str, str]:
    """Split a key into its name and its unit."""
    unit = unit_of(key)
    return (key.removesuffix(f"_{unit}"), unit) if unit else (key, "")


def alternative_units(unit: str) -> Iterator[tuple[str, Decimal]]:
    """Units that are confused with a unit, the likeliest first, with their sizes in SI."""
    for group in CONFUSED_UNITS:
        if unit in group:
            yield from ((name, size) for name, size in group.items() if name != unit)


def si_unit(unit: str) -> str:
    """SI unit of a unit, as "m" of "mm"; "" for a number without unit."""
    return next((name for group in CONFUSED_UNITS if unit in group for name, size in group.items() if size == 1), "")


def unit_text(unit: str) -> str:
    """Unit in a sentence, as "mm/s"; "" for a fraction of 1."""
    return (
        ""
        if unit == "fraction"
        else SIGNS.get(unit, re.sub("(^|_)per_", "/", unit).replace("_", " ").replace("2", "²"))
    )


def suggest_key(key: str, known: Collection[str]) -> str:
    """Hint with the probable key, as "; did you mean 'radius_mm'?", and a factor if units differ."""
    for candidate in known:
        unit = unit_of(candidate)
        for other, size in alternative_units(unit) if unit else ():
            if key == f"{candidate.removesuffix(unit)}{other}":
                factor = size / UNITS[unit]
                return f"; did you mean {candidate!r}, {float(factor):.6g} times the number?"
    return nearest(key, known)


@functools.lru_cache(maxsize=1024)
def per_si(unit: str) -> float:
    """Factor from SI to a unit (a key of `UNITS`, or "" for a plain number)."""
    return float(_CONTEXT.divide(Decimal(1), UNITS[unit])) if unit else 1.0


def in_input_units(sentence: str) -> str:
    """Convert the numbers of a sentence from SI to mm, deg, mN and mN m.

    A question about the unit is removed: it asks for the unit that the user gave.
    """
    out = _MEANT.sub("", sentence)
    for pattern, unit, size in _TYPED:

        def _scaled(number: re.Match[str], size: float = size) -> str:
            return f"{float(number[0]) * size:.6g}"

        def _converted(numbers: re.Match[str], unit: str = unit, scaled: Callable[..., str] = _scaled) -> str:
            return f"{_NUMBER.sub(scaled, numbers[1])} {unit}"

        out = pattern.sub(_converted, out)
    return _TWICE.sub(r"\1", out)


_NUMBER = re.compile(r"-?\d[\d.]*(?:e[-+]?\d+)?")
# "segment 2, 90 mm" is no list: the number after such a word is that of a part.
_PART = "".join(rf"(?<!\b{part} )" for part in ("tube", "segment", "piece", "row", "pose", "point", "section"))
_SEVERAL = rf"(?<![\w.]){_PART}((?:{_NUMBER.pattern}(?:, | to | and ))*{_NUMBER.pattern})"
_TYPED = tuple(
    (re.compile(rf"{_SEVERAL} {unit}(?![\w/^²]| m\b)"), typed, size)
    for unit, typed, size in (("N m", "mN m", 1e3), ("N", "mN", 1e3), ("m", "mm", TO_MM), ("rad", "deg", 180 / math.pi))
)
_MEANT = re.compile(
    r"(?:[;:] \w+ are in \w+(?: m)?)?: was \S+ (?:mm|deg|mN|mN m) meant\?$|: translations are in m(?=;|$)"
)
_TWICE = re.compile(r"(-?[\d.e+]+ mm) \(\1\)")


def to_si(number: Decimal, unit: Decimal) -> float:
    """Float nearest to `number` times `unit`."""
    return float(_CONTEXT.multiply(number, unit))


def in_unit(value: float, unit: Decimal) -> int | float | Decimal:
    """Convert a value from SI to a unit, with the fewest digits that `to_si` converts back to the same float.

    The result is an int or a float if it represents the digits exactly, otherwise a `Decimal`.
    """
    exact = _CONTEXT.divide(Decimal(value), unit)
    # A float has 15 to 17 digits. Units that are no power of ten (deg, rpm) need more to come back.
    for digits in range(15, 30):
        number = Context(prec=digits).plus(exact)
        if to_si(number, unit) == value:
            break
    return simplest(number)


def simplest(number: Decimal) -> int | float | Decimal:
    """Convert a decimal to an int or a float if that represents all digits; otherwise return it unchanged."""
    if number == number.to_integral_value() and abs(number) < 10**15:
        return int(number)
    return float(number) if Decimal(repr(float(number))) == number else number


def decimal(value: object) -> Decimal:
    """Convert a value to the decimal as it was written.

    Raises:
        ValueError: no number, or not finite; the message continues the name of the value.
    """
    if not _is_number(value):
        raise ValueError(f"is {shown(value)}; it must be a number")
    number = Decimal(repr(value)) if isinstance(value, float) else Decimal(value)
    if not math.isfinite(float(number)):
        raise ValueError(f"is {shown(value)}; it must be a finite number")
    return number


def parse_number(text: str) -> Decimal | str:
    """Parse a decimal; text that is no number is returned without blanks."""
    try:
        return Decimal(text.strip())
    except InvalidOperation:
        return text.strip()


def shown(value: object) -> str:
    """Text of a value in a message: as written, and shortened."""
    if value is None or isinstance(value, bool):
        return {None: "empty", True: "true", False: "false"}[value]
    # A float keeps the digits as written; lists are shortened.
    text = str(value) if _is_number(value) else reprlib.repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _is_number(value: object) -> TypeGuard[int | float | Decimal]:
    return isinstance(value, (int, float, Decimal)) and not isinstance(value, bool)
