"""Fields that describe themselves: one annotation, and reading, writing, ranges and hints follow."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from decimal import Decimal
from typing import Annotated, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tubeopt import InputError
from tubeopt.files.checked import Entry as PlainEntry
from tubeopt.files.checked import Number, check
from tubeopt.files.field_metadata import (
    NOT_NEGATIVE,
    POSITIVE,
    REQUIRED,
    Absent,
    Named,
    OneOf,
    Range,
    check_fields,
    key,
    unit,
)
from tubeopt.files.fields import Part, entry_of, keys_from, to_data, values
from tubeopt.files.yaml_file import load_yaml, save_yaml


@dataclass(frozen=True)
class Wood:
    name: Annotated[str, "of the tree"]
    density: Annotated[float, unit("kg_per_m3"), POSITIVE, "when dry"]
    grain: Annotated[str, OneOf(("fine", "coarse")), Absent("fine"), "of its surface"]


OAK = Wood("oak", 700.0, "coarse")


@dataclass(frozen=True)
class Peg:
    length: Annotated[float, unit("mm"), POSITIVE, "of what stands out"]
    taper: Annotated[float | None, unit("deg"), NOT_NEGATIVE, "by default none"] = None


@dataclass(frozen=True)
class Rack:
    """A rack for tubes.

    More about it.
    """

    width: Annotated[float, unit("mm"), POSITIVE, "of the board"] = 0.3
    slack: Annotated[float, unit("percent"), Range(minimum=0.0, maximum=0.5), "of the width"] = 0.1
    kiln: Annotated[float, key("dried_degC"), POSITIVE, "at which it was dried"] = 333.15
    board: Annotated[Wood, Named({"oak": OAK}), "what it is made of"] = OAK
    pegs: Annotated[tuple[Peg, ...], "by default two"] = (Peg(0.01), Peg(0.02))
    place: Annotated[tuple[float, float] | None, unit("mm"), "where it hangs"] = None
    marks: Annotated[tuple[float, ...], unit("mm"), NOT_NEGATIVE, "along the board"] = (0.1,)
    first: Annotated[Peg, REQUIRED, "the one at the door"] = field(default_factory=lambda: Peg(0.03))
    note: str = "not in a file"

    def __post_init__(self) -> None:
        check_fields(self, "the rack")


Entry = entry_of(Rack)
FIRST = {"first": {"length_mm": 30}}


def read(data: object) -> Rack:
    made: Rack = check(Entry, data, "rack.yaml").build()
    return made


def test_what_is_left_out_is_as_in_the_dataclass() -> None:
    assert read(FIRST) == Rack()
    with pytest.raises(InputError, match=r"rack.yaml: first is missing"):
        read({})


def test_keys_are_in_their_units() -> None:
    made = read(
        {
            "width_mm": Decimal("123.4"),
            "slack_percent": 7,
            "dried_degC": -3,
            "board": {"name": "fir", "density_kg_per_m3": 450},
            "pegs": [{"length_mm": 1, "taper_deg": 180}],
            "place_mm": [1, -2],
            "marks_mm": [0, 5],
            **FIRST,
        }
    )
    assert (made.width, made.slack, made.kiln) == (0.1234, 0.07, 270.15)
    assert made.board == Wood("fir", 450.0, "fine")
    assert made.pegs == (Peg(1e-3, 3.141592653589793),)
    assert (made.place, made.marks, made.note) == ((1e-3, -2e-3), (0.0, 5e-3), "not in a file")
    assert to_data(made)["board"] == {"name": "fir", "density_kg_per_m3": 450.0, "grain": "fine"}
    assert to_data(Rack())["board"] == "oak"
    assert "place_mm" not in to_data(Rack())
    assert "note" not in to_data(Rack())


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"widht_mm": 3}, "widht_mm is not a known key; did you mean 'width_mm'?"),
        ({"width_mm": 0}, "width_mm is 0; it must be greater than 0"),
        ({"slack_percent": 51}, "slack_percent is 51; it must be at most 50"),
        ({"dried_degC": -300}, "dried_degC is -300; it must be greater than -273.15"),
        ({"board": "elm"}, "board is 'elm'; it must be oak"),
        ({"board": {"name": "fir", "density_kg_per_m3": 450, "grain": "fin"}}, "did you mean 'fine'?"),
        (
            {"pegs": [{"length_mm": 1, "taper_deg": -1}]},
            "pegs[0].taper_deg is -1; it must be at least 0",
        ),
        ({"place_mm": [1]}, "place_mm has 1 number; it must have 2"),
        ({"marks_mm": []}, "marks_mm has 0 items; it must have at least 1"),
    ],
)
def test_errors_are_reported_in_units_of_file(data: dict[str, object], message: str) -> None:
    with pytest.raises(InputError) as caught:
        read(data | FIRST)
    assert message in str(caught.value)


@dataclass(frozen=True)
class Nail:
    length: Annotated[float, unit("mm"), Range(above=0.0015, maximum=0.0125), "of the shaft"] = 0.0115
    strokes: Annotated[int, Range(minimum=1), "of the hammer"] = 3


def nail(data: dict[str, object]) -> Nail:
    made: Nail = check(entry_of(Nail), data, "nail.yaml").build()
    return made


def test_bounds_and_defaults_between_whole_numbers_of_a_unit_keep_their_digits() -> None:
    assert nail({}) == Nail(0.0115, 3)
    assert type(nail({}).strokes) is int
    assert nail({"length_mm": Decimal("12.5")}).length == 0.0125
    assert nail({"length_mm": Decimal("1.501")}).length == 0.001501
    for value, message in (("12.501", "at most 12.5"), ("1.5", "greater than 1.5")):
        with pytest.raises(InputError, match=f"length_mm is {value}; it must be {message}"):
            nail({"length_mm": Decimal(value)})


def test_a_key_may_be_empty_where_its_field_may_be_none_or_has_many_parts_and_nowhere_else() -> None:
    first = {"length_mm": 30, "taper_deg": None}
    made = read({"first": first, "place_mm": None, "pegs": None})
    assert (made.first.taper, made.place, made.pegs) == (None, None, Rack().pegs)
    for name in ("width_mm", "marks_mm", "first"):
        with pytest.raises(InputError, match=name):
            read({**FIRST, name: None})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"width": 0}, "width of the rack is 0; it must be greater than 0"),
        ({"slack": 0.6}, "slack of the rack is 0.6; it must be at most 0.5"),
        ({"board": None}, "board of the rack is None; it must be a Wood"),
        ({"width": "wide"}, "width of the rack is 'wide'; it must be a number"),
    ],
)
def test_the_dataclass_itself_is_checked_in_si(change: dict[str, object], message: str) -> None:
    with pytest.raises(InputError) as caught:
        Rack(**change)  # type: ignore[arg-type]
    assert str(caught.value) == message


@given(
    width=st.floats(1e-6, 1e3),
    slack=st.floats(0, 0.5),
    kiln=st.floats(1.0, 3000.0),
    marks=st.lists(st.floats(0, 10), min_size=1, max_size=3),
)
def test_numbers_survive_a_file_to_the_last_bit(
    tmp_path_factory: pytest.TempPathFactory, width: float, slack: float, kiln: float, marks: list[float]
) -> None:
    rack = Rack(width=width, slack=slack, kiln=kiln, marks=tuple(marks), pegs=(Peg(width, slack),))
    path = tmp_path_factory.getbasetemp() / "rack.yaml"
    save_yaml(path, to_data(rack), "A rack.")
    assert read(load_yaml(path)) == rack


def test_schema_matches_field() -> None:
    schema = Entry.model_json_schema()
    assert schema["description"] == "A rack for tubes."
    assert schema["properties"]["width_mm"]["description"] == "of the board"
    assert schema["required"] == ["first"]


@dataclass(frozen=True)
class Pace:
    speed: Annotated[float | tuple[float, ...], unit("mm_per_s"), POSITIVE, "of all, or of each"] = 0.02
    rest: Annotated[float | tuple[float, ...] | None, unit("s"), "between steps"] = None


@pytest.mark.parametrize(
    ("data", "made"),
    [
        ({}, Pace()),
        ({"speed_mm_per_s": 5}, Pace(0.005)),
        ({"speed_mm_per_s": [5, 7.5], "rest_s": [1]}, Pace((0.005, 0.0075), (1.0,))),
    ],
)
def test_a_number_or_several(data: dict[str, object], made: Pace) -> None:
    assert check(entry_of(Pace), data, "").build() == made
    assert check(entry_of(Pace), to_data(made), "").build() == made


def test_error_in_one_of_several_values_is_reported() -> None:
    with pytest.raises(InputError, match=r"speed_mm_per_s\[1\] is -2; it must be greater than 0"):
        check(entry_of(Pace), {"speed_mm_per_s": [5, -2]}, "")


@dataclass(frozen=True)
class Tries:
    count: Annotated[int, Range(minimum=2, maximum=9), "of them"] = 3
    offset: Annotated[float, Range(minimum=-2.0), "from the first"] = 0.0
    loud: Annotated[bool, "whether they are told"] = False

    def __post_init__(self) -> None:
        check_fields(self)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"count": 2.5}, "count is 2.5; it must be a whole number"),
        ({"count": 1}, "count is 1; it must be at least 2"),
        ({"count": 10}, "count is 10; it must be at most 9"),
        ({"offset": -3.0}, "offset is -3; it must be at least -2"),
        ({"loud": 1}, "loud is 1; it must be a bool"),
    ],
)
def test_whole_numbers_and_flags_are_checked(change: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=re.escape(message)):
        Tries(**change)


@dataclass(frozen=True)
class Seeded:
    seed: Annotated[int, NOT_NEGATIVE, "of the search"] = 0
    count: Annotated[int, POSITIVE, "of them"] = 1


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"seed": -1}, "seed is -1; it must be at least 0"),
        ({"seed": 0.5}, "seed is 0.5; it must be a whole number"),
        ({"count": 0}, "count is 0; it must be greater than 0"),
    ],
)
def test_range_of_whole_number_is_reported_in_whole_numbers(data: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=f"^{re.escape(message)}$"):
        check(entry_of(Seeded), data, "")


@keys_from(Pace)
class PaceEntry(Part):
    places_mm: list[Number]


@keys_from(Tries, "count")
class Asked(PlainEntry):
    wait_degC: Number


def test_part_builds_dataclass_with_own_keys() -> None:
    entry = check(PaceEntry, {"places_mm": [1, 2.5], "speed_mm_per_s": 5}, "")
    assert entry.build() == Pace(0.005)
    assert entry.si("places_mm") == (0.001, 0.0025)
    assert entry.si("rest_s") is None


def test_an_entry_asks_for_some_fields_alone() -> None:
    entry = check(Asked, {"wait_degC": 20, "count": 4}, "")
    assert values(Tries, entry) == {"count": 4}
    assert entry.in_si("wait_degC", "count") == {"wait": 293.15, "count": 4}
    with pytest.raises(InputError, match="offset is not a known key"):
        check(Asked, {"wait_degC": 20, "offset": 1}, "")
