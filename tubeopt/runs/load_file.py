"""Loads in studies and in files of their own: forces in mN, moments in mN m, lengths in mm."""

from __future__ import annotations

from decimal import Decimal
from os import PathLike
from typing import Annotated, Any, Literal

from pydantic import Field, PlainValidator, ValidationInfo, model_validator

from ..files.checked import Entry, Number, check
from ..files.units import MM, UNITS, to_si
from ..files.yaml_file import load_yaml
from ..robots.load import Load, PointForce, Stretch
from .base import Study

Triple = Annotated[list[Number], Field(min_length=3, max_length=3)]
"""x, y and z."""


def _vector(values: list[Decimal], unit: Decimal) -> tuple[float, float, float]:
    x, y, z = (to_si(value, unit) for value in values)
    return x, y, z


class PointEntry(Entry):
    """A force along the arm."""

    at_mm: Number = Field(description="arc length from the plate")
    force_mN: Triple


class StretchEntry(Entry):
    """A constant load per length on a stretch of the arm."""

    from_mm: Number = Field(description="arc length from the plate")
    to_mm: Number
    force_mN_per_m: Triple


class LoadEntry(Entry):
    """What pushes on the robot."""

    tip_force_mN: Triple | None = None
    tip_moment_mN_m: Triple | None = None
    frame: Literal["world", "tip"] = Field(
        "world", description="of tip force and moment: world keeps their direction, tip turns them with the tip"
    )
    gravity_m_per_s2: Triple | None = Field(None, description="acceleration of gravity on the tubes")
    points: list[PointEntry] = Field([], description="forces along the arm, in world axes")
    distributed_mN_per_m: Triple | list[StretchEntry] | None = Field(
        None, description="load per length in world axes, all along the arm or on stretches"
    )

    @model_validator(mode="after")
    def _makes_sense(self) -> LoadEntry:
        self.build()
        return self

    def build(self) -> Load:
        """The load in SI; raises InputError where it makes no sense."""
        along: Any = self.distributed_mN_per_m
        if along is not None and along and isinstance(along[0], StretchEntry):
            along = tuple(
                Stretch(to_si(part.from_mm, MM), to_si(part.to_mm, MM), _vector(part.force_mN_per_m, UNITS["mN"]))
                for part in along
            )
        elif along is not None:
            along = _vector(along, UNITS["mN"]) if along else None
        zero = (0.0, 0.0, 0.0)
        return Load(
            zero if self.tip_force_mN is None else _vector(self.tip_force_mN, UNITS["mN"]),
            zero if self.tip_moment_mN_m is None else _vector(self.tip_moment_mN_m, UNITS["mN"]),
            frame=self.frame,
            distributed=along,
            points=tuple(
                PointForce(to_si(part.at_mm, MM), _vector(part.force_mN, UNITS["mN"])) for part in self.points
            ),
            gravity=None if self.gravity_m_per_s2 is None else _vector(self.gravity_m_per_s2, UNITS["m_per_s2"]),
        )


def load_entry(path: str | PathLike[str]) -> LoadEntry:
    """What a load file says; raises InputError with one line for every problem."""
    return check(LoadEntry, load_yaml(path), path)


def load_load(path: str | PathLike[str]) -> Load:
    """The load in a YAML file; raises InputError with one line for every problem."""
    return load_entry(path).build()


def _entry(value: object, info: ValidationInfo) -> LoadEntry | None:
    if value is None or isinstance(value, LoadEntry):
        return value
    if isinstance(value, str):
        return load_entry(info.context["directory"] / value if info.context else value)
    return check(LoadEntry, value, "")


class LoadedStudy(Study):
    """A study of a robot on which something may push; the keys of its own replace what the load says."""

    load: Annotated[
        LoadEntry | None,
        PlainValidator(_entry, json_schema_input_type=str | LoadEntry | None),
        Field(description="what pushes on the robot: keys of a load, or the path of a load file"),
    ] = None
    tip_force_mN: Triple | None = Field(None, description="force on the tip in axes of the plate", examples=["X,Y,Z"])
    tip_moment_mN_m: Triple | None = Field(
        None, description="moment on the tip in axes of the plate", examples=["X,Y,Z"]
    )
    gravity_m_per_s2: Triple | None = Field(
        None, description="gravity, which acts on the mass of the tubes", examples=["X,Y,Z"]
    )

    def pushing(self) -> Load | None:
        """The load, None without one."""
        names = ("tip_force_mN", "tip_moment_mN_m", "gravity_m_per_s2")
        own = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
        if self.load is None and not own:
            return None
        return (self.load or check(LoadEntry, {}, "")).model_copy(update=own).build()
