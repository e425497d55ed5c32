"""Obstacles as YAML: a list of bodies, lengths in mm, each with its kind."""

from __future__ import annotations

import math
from collections.abc import Sequence
from decimal import Decimal
from os import PathLike
from typing import TYPE_CHECKING, Annotated, Any, Literal, Union

from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag, ValidationInfo

from ..bodies.anatomy import Anatomy
from ..bodies.corridors import Corridor, MeshObstacle, load_mesh
from ..bodies.obstacles import Box, Capsule, HalfSpace, Obstacle, Sphere
from ..errors import nearest
from ..files.checked import Entry, Triple, check, in_file
from ..files.field_metadata import Typical
from ..files.fields import Part, entry_of
from ..files.units import TO_MM, shown
from ..files.yaml_file import load_yaml
from ..robots.limits import FAR
from .anatomy_file import AnatomyKey, load_anatomy

Place = Annotated[Triple, Typical(1e-3, 10.0)]
"""A position that is reached by a robot as long as a hand or an arm."""


def _near_the_robot(place: list[Decimal], info: ValidationInfo) -> list[Decimal]:
    robot = info.data.get("robot")
    if robot is not None:
        most, away = FAR * max(tube.length for tube in robot.tubes) * TO_MM, math.hypot(*map(float, place))
        if away > most:
            numbers = ", ".join(map(str, place))
            raise ValueError(
                f"is [{numbers}], {away:.6g} mm from the plate; it must be at most {most:.6g} mm away, {FAR:g} times "
                "the longest tube"
            )
    return place


TipPlace = Annotated[Place, AfterValidator(_near_the_robot)]
"""A position for the tip of the study's robot."""


class MeshEntry(Part):
    """Surface from a mesh file, in mm and plate axes. A closed surface bounds a body; of an open one the arm avoids the
    triangles. For a file with SPACE=LPS, as 3D Slicer writes it, x and y change sign.
    """

    kind: Literal["mesh"]
    file: Annotated[MeshObstacle, in_file(load_mesh, "a mesh file in mm")] = Field(
        description="path of the mesh file, mm"
    )

    def build(self) -> MeshObstacle:
        """The obstacle in SI."""
        return self.file


class AnatomyEntry(Entry):
    """All bodies of an anatomy file."""

    kind: Literal["anatomy"]
    file: Annotated[Anatomy, in_file(load_anatomy, "a YAML file of an anatomy", kind=Anatomy)] = Field(
        description="path of the YAML file of the anatomy"
    )

    def build(self) -> tuple[Obstacle, ...]:
        """The bodies in SI, as the plate has them."""
        return self.file.bodies


BODIES: dict[str, type[Any]] = {
    "sphere": Sphere,
    "capsule": Capsule,
    "half_space": HalfSpace,
    "box": Box,
    "corridor": Corridor,
}
"""Kinds of bodies that are described by their fields."""

ENTRIES: dict[str, Any] = {
    kind: entry_of(body, extra={"kind": (Literal[kind], kind)}) for kind, body in BODIES.items()
} | {"mesh": MeshEntry, "anatomy": AnatomyEntry}

KINDS = tuple(ENTRIES)

BY_KEYS = {"centre_mm": "sphere", "from_mm": "capsule", "start_mm": "capsule", "low_mm": "box", "normal": "half_space"}
"""A key that only one kind has -> that kind, which need not be said then."""

ALIASES = {"from_mm": "start_mm", "to_mm": "end_mm"}
"""Other names of keys of a capsule."""


def _known(value: Any) -> Any:
    """A body with its kind, and its keys as the entry of that kind calls them."""
    if not isinstance(value, dict):
        raise ValueError(f"is {shown(value)}; it must be a mapping with the kind of a body, one of {', '.join(KINDS)}")
    kind = value.get("kind", next((kind for key, kind in BY_KEYS.items() if key in value), None))
    if kind is None:
        raise ValueError(f"has no kind, and its keys do not determine one; kind must be one of {', '.join(KINDS)}")
    if kind not in KINDS:
        raise ValueError(f"is of kind {shown(kind)}; its kind must be one of {', '.join(KINDS)}{nearest(kind, KINDS)}")
    named = ALIASES if kind == "capsule" else {}
    return {"kind": kind} | {named.get(key, key): part for key, part in value.items()}


if TYPE_CHECKING:
    ObstacleEntry = Part
else:
    ObstacleEntry = Annotated[
        Union[tuple(Annotated[entry, Tag(f"<{kind}>")] for kind, entry in ENTRIES.items())],  # noqa: UP007
        Discriminator(lambda value: f"<{value['kind']}>"),
        BeforeValidator(_known),
    ]
"""Any body, told apart by its kind, which may be left out where its keys tell it."""


class ObstacleFile(Entry):
    """A file of obstacles."""

    obstacles: list[ObstacleEntry]


def load_obstacles(path: str | PathLike[str]) -> tuple[Obstacle, ...]:
    """The obstacles in a YAML file with the key `obstacles`; raises InputError for what makes none: one line for every
    problem."""
    return _built(check(ObstacleFile, load_yaml(path, "obstacles"), path).obstacles)


def _built(entries: Sequence[Part]) -> tuple[Obstacle, ...]:
    built = [entry.build() for entry in entries]
    return tuple(body for one in built for body in (one if isinstance(one, tuple) else (one,)))


if TYPE_CHECKING:
    Bodies = tuple[Obstacle, ...]
else:
    Bodies = Annotated[
        Annotated[tuple[Obstacle, ...], in_file(load_obstacles, "a YAML file of obstacles"), Tag("<file>")]
        | Annotated[list[ObstacleEntry], AfterValidator(_built), Tag("<bodies>")],
        Discriminator(lambda value: "<bodies>" if isinstance(value, list) else "<file>"),
    ]
"""Bodies in whatever file: a list of them, or the path of a file with the key `obstacles`. Read as obstacles in SI."""


class Surrounded(Entry):
    """What has bodies and a patient around it."""

    obstacles: Bodies = Field(
        (),
        description="obstacles for the whole arm: a YAML file, or a list as "
        "[{centre_mm: [30, 0, 120], radius_mm: 8}]; default none",
        examples=["OBSTACLES.yaml"],
    )
    anatomy: AnatomyKey | None = Field(
        None,
        description="anatomy of a patient (images, meshes, point clouds): a YAML file or its keys",
        examples=["ANATOMY.yaml"],
    )

    @property
    def around(self) -> Anatomy:
        """The anatomy, an empty one where none is given."""
        return Anatomy() if self.anatomy is None else self.anatomy

    @property
    def bodies(self) -> tuple[Obstacle, ...]:
        """Obstacles, and those of the anatomy."""
        return self.obstacles + self.around.bodies
