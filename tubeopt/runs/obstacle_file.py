"""Obstacles as YAML: a list of bodies, lengths in mm, each with its kind."""

from __future__ import annotations

from collections.abc import Sequence
from decimal import Decimal
from os import PathLike
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag

from ..bodies.corridors import Corridor, MeshObstacle, load_mesh
from ..bodies.obstacles import Box, Capsule, HalfSpace, Obstacle, Sphere
from ..errors import nearest
from ..files.checked import Entry, Number, Positive, check, in_file
from ..files.fields import Part
from ..files.units import MM, shown, to_si
from ..files.yaml_file import load_yaml

Triple = Annotated[list[Number], Field(min_length=3, max_length=3)]
"""x, y and z."""


def point(values: list[Decimal]) -> tuple[float, float, float]:
    """Coordinates in m of three numbers in mm."""
    x, y, z = (to_si(value, MM) for value in values)
    return x, y, z


class SphereEntry(Part):
    """A ball."""

    kind: Literal["sphere"]
    centre_mm: Triple
    radius_mm: Positive

    def build(self) -> Sphere:
        """The obstacle in SI."""
        return Sphere(point(self.centre_mm), to_si(self.radius_mm, MM))


class CapsuleEntry(Part):
    """All within a radius of a segment."""

    kind: Literal["capsule"]
    start_mm: Triple
    end_mm: Triple
    radius_mm: Positive

    def build(self) -> Capsule:
        """The obstacle in SI."""
        return Capsule(point(self.start_mm), point(self.end_mm), to_si(self.radius_mm, MM))


class HalfSpaceEntry(Part):
    """All behind a plane; the normal points to where the arm may be."""

    kind: Literal["half_space"]
    point_mm: Triple
    normal: Triple

    def build(self) -> HalfSpace:
        """The obstacle in SI."""
        x, y, z = (float(value) for value in self.normal)
        return HalfSpace(point(self.point_mm), (x, y, z))


class BoxEntry(Part):
    """A cuboid along the axes of the plate."""

    kind: Literal["box"]
    low_mm: Triple
    high_mm: Triple

    def build(self) -> Box:
        """The obstacle in SI."""
        return Box(point(self.low_mm), point(self.high_mm))


class CorridorEntry(Part):
    """Everything outside a vessel: farther than a radius from its centreline."""

    kind: Literal["corridor"]
    centreline_mm: Annotated[list[Triple], Field(min_length=2)]
    radius_mm: Positive

    def build(self) -> Corridor:
        """The obstacle in SI."""
        return Corridor(tuple(point(row) for row in self.centreline_mm), to_si(self.radius_mm, MM))


class MeshEntry(Part):
    """A body bounded by the closed surface in a mesh file, in mm."""

    kind: Literal["mesh"]
    file: Annotated[MeshObstacle, in_file(load_mesh, "a mesh file in mm")]

    def build(self) -> MeshObstacle:
        """The obstacle in SI."""
        return self.file


KINDS = ("sphere", "capsule", "half_space", "box", "corridor", "mesh")

BY_KEYS = {"centre_mm": "sphere", "from_mm": "capsule", "start_mm": "capsule", "low_mm": "box", "normal": "half_space"}
"""A key that only one kind has -> that kind, which need not be said then."""

ALIASES = {"from_mm": "start_mm", "to_mm": "end_mm"}
"""Other names of keys of a capsule."""


def _known(value: Any) -> Any:
    """A body with its kind, and its keys as the entry of that kind calls them."""
    if not isinstance(value, dict):
        raise ValueError(f"is {shown(value)}; it must be a mapping with the kind of a body, one of {', '.join(KINDS)}")
    kind = value.get("kind", next((kind for key, kind in BY_KEYS.items() if key in value), None))
    if kind not in KINDS:
        raise ValueError(f"is of kind {shown(kind)}; its kind must be one of {', '.join(KINDS)}{_hint(kind)}")
    named = ALIASES if kind == "capsule" else {}
    return {"kind": kind} | {named.get(key, key): part for key, part in value.items()}


def _hint(kind: object) -> str:
    return nearest(kind, KINDS) if isinstance(kind, str) else ""


ObstacleEntry = Annotated[
    Annotated[SphereEntry, Tag("<sphere>")]
    | Annotated[CapsuleEntry, Tag("<capsule>")]
    | Annotated[HalfSpaceEntry, Tag("<half_space>")]
    | Annotated[BoxEntry, Tag("<box>")]
    | Annotated[CorridorEntry, Tag("<corridor>")]
    | Annotated[MeshEntry, Tag("<mesh>")],
    Discriminator(lambda value: f"<{value['kind']}>"),
    BeforeValidator(_known),
]
"""Any body, told apart by its kind, which may be left out where its keys tell it."""


class ObstacleFile(Entry):
    """A file of obstacles."""

    obstacles: list[ObstacleEntry]


def load_obstacles(path: str | PathLike[str]) -> tuple[Obstacle, ...]:
    """The obstacles in a YAML file with the key `obstacles`.

    Raises:
        InputError: no such file, not YAML, or keys or values that make no obstacles: one line for every problem.
    """
    return _built(check(ObstacleFile, load_yaml(path), path).obstacles)


def _built(entries: Sequence[Part]) -> tuple[Obstacle, ...]:
    return tuple(entry.build() for entry in entries)


if TYPE_CHECKING:
    Bodies = tuple[Obstacle, ...]
else:
    Bodies = Annotated[
        Annotated[tuple[Obstacle, ...], in_file(load_obstacles, "a YAML file of obstacles"), Tag("<file>")]
        | Annotated[list[ObstacleEntry], AfterValidator(_built), Tag("<bodies>")],
        Discriminator(lambda value: "<bodies>" if isinstance(value, list) else "<file>"),
    ]
"""Bodies in whatever file: a list of them, or the path of a file with the key `obstacles`. Read as obstacles in SI."""
