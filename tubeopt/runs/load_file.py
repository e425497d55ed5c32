"""Loads in studies and in files of their own: forces in mN, moments in mN m, lengths in mm."""

from __future__ import annotations

from os import PathLike
from typing import Annotated, Any

from pydantic import Field, PlainValidator, ValidationInfo

from ..errors import InputError
from ..files.checked import Entry, Triple, check
from ..files.fields import EntryOf, Part, asking, described, extended, values
from ..files.shipped import resolved
from ..files.yaml_file import load_yaml
from ..robots.load import Load, Stretch
from .study_file import Keys


@asking(Load)
class LoadEntry(Part):
    """External load on the robot."""

    distributed_mN_per_m: Triple | list[EntryOf[Stretch]] | None = Field(
        None, description="load per length in the base frame, along the whole arm or on parts of it"
    )

    def build(self) -> Load:
        """The load in SI; raises InputError where it makes no sense."""
        along: Any = self.distributed_mN_per_m
        stretches = along if along and isinstance(along[0], Part) else []
        points: list[Part] = getattr(self, "points") or []  # noqa: B009  # a field that `asking` adds
        for name, parts in (("points", points), ("distributed_mN_per_m", stretches)):
            for k, part in enumerate(parts):
                own = [key for key in type(part).model_fields if key.startswith(("force", "moment"))]
                if not part.model_fields_set & set(own):
                    raise InputError(f"{name}[{k}] has no load; it must have {' or '.join(own)}")
        if along and isinstance(along[0], Part):
            along = tuple(part.build() for part in along)
        elif along is not None:
            along = self.si("distributed_mN_per_m") or None
        return Load(**values(Load, self), distributed=along)


def load_entry(path: str | PathLike[str]) -> LoadEntry:
    """What a load file says; raises InputError with one line for every problem."""
    return check(LoadEntry, load_yaml(path), path)


def _entry(value: object, info: ValidationInfo) -> LoadEntry | None:
    if value is None or isinstance(value, LoadEntry):
        return value
    if isinstance(value, str):
        return load_entry(resolved(value, info.context["directory"]) if info.context else resolved(value))
    return check(LoadEntry, value, "")


LOAD_KEYS = {one.key: one for one in described(Load) if one.name in ("force", "moment", "gravity")}
"""Keys of a load that a study may have beside it."""


@extended(
    {key: (Triple | None, Field(None, description=one.about, examples=["X,Y,Z"])) for key, one in LOAD_KEYS.items()}
)
class Loaded(Entry):
    """A robot that may have a load; the keys of its own replace those of the load."""

    load: Annotated[
        LoadEntry | None,
        PlainValidator(_entry, json_schema_input_type=str | LoadEntry | None),
        Field(
            description="external load: path of a load file, or its keys as {tip_force_mN: [20, 0, 0]}; default no load"
        ),
    ] = None

    @property
    def external_load(self) -> Load | None:
        """The load, None without one."""
        own = {key: getattr(self, key) for key in LOAD_KEYS if getattr(self, key) is not None}
        if self.load is None and not own:
            return None
        return (self.load or check(LoadEntry, {}, "")).model_copy(update=own).build()


ExternalLoad = Annotated[Load | None, Keys(Loaded, "external_load")]
"""Parameter of a question: the external load, None without one."""
