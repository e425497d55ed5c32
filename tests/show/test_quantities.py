"""Quantities: from one list follow the JSON, the table, and the page that describes them; units are converted once."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import jsonschema
import numpy as np
import pytest

from tests.command_line import CRL, ROOT, THESIS, Run, answer
from tubeopt.files.field_metadata import form, key, unit
from tubeopt.files.units import UNITS, in_unit, per_si, to_si, unit_of
from tubeopt.robots.file import joint_columns
from tubeopt.show.quantities import Quantity, described, in_units, line, of_field, record, rows, within
from tubeopt.show.reports import PAGE, page, report, reports, to_dict
from tubeopt.typing import Delegate

CONFIGS = ROOT / "configs"
TURN = ("--rotations-deg", "0,60,120")
COMMANDS: dict[str, tuple[str, ...]] = {
    "fk": ("fk", THESIS, *TURN, "--verify"),
    "ik": ("ik", THESIS, "--target-mm", "50,30,150"),
    "equilibria": ("equilibria", str(CONFIGS / "robots" / "two_tube.yaml"), "--rotations-deg", "190,0"),
    "snap": ("snap", THESIS, "--to-deg", "360,0,0"),
    "follow": ("follow", THESIS, str(CONFIGS / "paths" / "turn_and_back.csv")),
    "certify": ("certify", CRL, "--translations-mm", "-20,0,0"),
    "stability-map": ("stability-map", CRL, "--samples", "3", "--directions", "4", "--workers", "1"),
    "validate": ("validate", str(CONFIGS / "robots" / "thesis_etr.yaml"),
                 str(CONFIGS / "experiments" / "synthetic_etr.csv")),
    "workspace": ("workspace", CRL, "--samples", "300"),
    "mold plan": ("mold", "plan", str(CONFIGS / "robots" / "thesis_etr.yaml")),
    "mold calibrate": ("mold", "calibrate", str(CONFIGS / "molds" / "example_trials.csv")),
    "mold materials": ("mold", "materials", THESIS),
    "robot show": ("robot", "show", CRL),
}  # fmt: skip


@pytest.mark.parametrize("command", COMMANDS)
def test_what_a_command_prints_is_what_its_list_describes(run: Run, command: str) -> None:
    outcome = run(*COMMANDS[command], "--json")
    data = answer(outcome, outcome.code)
    listed = reports()[command].quantities
    for every in {"files", "warnings"} - {quantity.key for quantity in listed}:
        del data[every]
    assert list(jsonschema.Draft202012Validator(schema(listed)).iter_errors(data)) == []


def test_the_page_is_in_step() -> None:
    assert (ROOT / PAGE).read_text(encoding="utf-8") == page(), "run `python -m tubeopt.show.reports`"


def test_every_report_has_a_command_and_every_key_is_described_once() -> None:
    assert set(COMMANDS) < set(reports())
    for kind in reports().values():
        for level in _levels(kind.quantities):
            keys = [quantity.key for quantity in level if quantity.key]
            assert len(set(keys)) == len(keys)
            assert all(quantity.about for quantity in level)


def schema(quantities: Iterable[Quantity[Any]]) -> dict[str, Any]:
    """The JSON Schema of what `record` makes of a list."""
    listed = [quantity for quantity in quantities if quantity.key]
    return {
        "type": "object",
        "properties": {quantity.key: _schema(quantity) for quantity in listed},
        "required": [quantity.key for quantity in listed if not quantity.optional],
        "additionalProperties": False,
    }


def _schema(quantity: Quantity[Any]) -> dict[str, Any]:
    if quantity.unit:
        return {"type": ["number", "array", "null"]}
    if quantity.of is not None:
        part = schema(quantity.of)
        return {"anyOf": [part, {"type": "array", "items": part}, {"type": "null"}]}
    return {}


def _levels(quantities: tuple[Quantity[Any], ...]) -> Iterator[tuple[Quantity[Any], ...]]:
    yield quantities
    for quantity in quantities:
        if quantity.of is not None:
            yield from _levels(tuple(quantity.of))


@dataclass
class Spring:
    stiffness: float
    length: float
    turns: np.ndarray[Any, np.dtype[np.float64]]
    mate: Spring | None = None


SPRING: tuple[Quantity[Spring], ...] = (
    Quantity("length_mm", "length", form=".1f"),
    Quantity("turns_deg", "turns", form=".0f"),
    Quantity("stiffness", "stiffness in N/m", text="{stiffness:g} N/m, {length_mm:g} mm long"),
    line("energy", lambda spring: None if spring.mate is None else "shared"),
)


def test_a_line_is_all_that_a_new_quantity_takes() -> None:
    spring = Spring(2.0, 0.25, np.radians([90.0, -0.0]))
    assert record(spring, SPRING) == {"length_mm": 250, "turns_deg": [90, 0], "stiffness": 2}
    assert rows(spring, SPRING) == [
        ("length", "250.0 mm"),
        ("turns", "90, 0 deg"),
        ("stiffness in N/m", "2 N/m, 250 mm long"),
    ]
    added = (*SPRING, Quantity[Spring]("strain_percent", "strain", lambda spring: 0.01, form=".2f"))
    assert record(spring, added)["strain_percent"] == 1
    assert rows(spring, added)[-1] == ("strain", "1.00 %")
    assert "strain_percent" in schema(added)["required"]


@dataclass
class Needle:
    length: Annotated[float, unit("mm"), form(".1f", label="needle"), "length of the needle"]
    tip: Annotated[float, key("bevel_deg"), "angle of the bevel"]
    maker: str = ""


@dataclass
class Holder:
    needle: Annotated[Needle | None, "the needle"]
    spares: Annotated[tuple[Needle, ...], "others"]
    mass: Annotated[float, unit("g"), "mass of the holder"] = 0.01


@dataclass
class Case:
    needle: Needle

    length = Delegate[float]("needle")


def test_marks_of_a_field_make_a_quantity() -> None:
    needle = Needle(0.25, np.pi / 4)
    assert record(needle, described(Needle)) == {"length_mm": 250.0, "bevel_deg": 45.0}
    assert rows(needle, described(Needle)) == [("needle", "250.0 mm")]


def test_fields_that_a_list_does_not_name_follow_where_it_says_so() -> None:
    holder = Holder(None, (Needle(0.001, 0.0),))
    whole = described(Holder, "mass", line("maker", lambda _: None), ...)
    assert record(holder, whole) == {"mass_g": 10.0, "needle": None, "spares": [{"length_mm": 1.0, "bevel_deg": 0.0}]}
    assert [quantity.key for quantity in described(Holder, "mass needle")] == ["mass_g", "needle"]


def test_a_field_of_a_part_has_the_marks_of_the_part() -> None:
    case = Case(Needle(0.25, 0.0))
    (length,) = described(Case, of_field(Case, "length", form=".0f"))
    assert (length.value(case), length.row_text(case, {"length_mm": 250.0})) == (250.0, "250 mm")


def test_parts_are_described_by_lists_of_their_own() -> None:
    pair: tuple[Quantity[Spring], ...] = (
        Quantity("mate", "the other", of=SPRING),
        *within(SPRING[:1], lambda spring: spring.mate),
    )
    alone = Spring(1.0, 1.0, np.zeros(1))
    assert record(alone, pair) == {"mate": None, "length_mm": None}
    assert rows(alone, pair) == []
    mated = Spring(1.0, 1.0, np.zeros(1), Spring(3.0, 0.002, np.zeros(1)))
    assert record(mated, pair)["length_mm"] == record(mated, pair)["mate"]["length_mm"] == 2
    assert rows(mated, pair) == [("length", "2.0 mm")]


@pytest.mark.parametrize(
    ("key", "unit", "factor"),
    [
        ("tip_position_mm", "mm", 1e3),
        ("largest_rotation_rate_deg_per_s", "deg_per_s", 180 / math.pi),
        ("bending_stiffness_N_mm2", "N_mm2", 1e6),
        ("energy_kJ", "kJ", 1e-3),
        ("feed_mm_per_min", "mm_per_min", 6e4),
        ("spindle_rpm", "rpm", 60.0),
        ("margin", "", 1.0),
        ("price_class", "", 1.0),
    ],
)
def test_a_key_tells_its_unit(key: str, unit: str, factor: float) -> None:
    assert unit_of(key) == unit
    assert per_si(unit) == pytest.approx(factor, rel=1e-15)


def test_every_unit_survives_being_written_and_read() -> None:
    for scale in UNITS.values():
        for value in (0.1, 1 / 3, 7e-5, 123456.789):
            number = in_unit(value, scale)
            assert to_si(number if not isinstance(number, float) else type(scale)(repr(number)), scale) == value


def test_what_is_no_number_is_left_as_it_is() -> None:
    assert in_units(True, "mm") is True
    assert in_units(["a", None, np.float64(0.5)], "mm") == ["a", None, 500]
    assert joint_columns(1)[0] == ["rotation_1_deg"]


def test_nothing_is_said_about_what_is_no_answer() -> None:
    with pytest.raises(TypeError, match="there is no report on a PosixPath"):
        report(Path())
    with pytest.raises(TypeError, match="there is no report on a dict"):
        to_dict({})


def test_an_optional_quantity_that_is_not_there_has_no_row() -> None:
    lone = (
        Quantity[complex]("real", "real part", form=".1f"),
        Quantity[complex]("x_mm", "size", lambda z: None, form=".1f", optional=True),
    )
    assert record(2 + 0j, lone) == {"real": 2.0}
    assert rows(2 + 0j, lone) == [("real part", "2.0")]
