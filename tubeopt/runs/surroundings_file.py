"""Obstacles and anatomies as YAML: bodies, images, meshes and landmarks around a robot, and where it stands."""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from decimal import Decimal
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self, Union

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag, ValidationInfo, model_validator

from ..bodies.anatomy import Anatomy, anatomy_seen, centres
from ..bodies.corridors import PLACE, Corridor, MeshObstacle, load_mesh, load_points, read_mesh, warn_of_open
from ..bodies.distance_field import DistanceField
from ..bodies.frames import Frame, base_frame, needed, ras, register
from ..bodies.images import LabelImage, field_of_image, read_image
from ..bodies.obstacles import Box, Capsule, HalfSpace, Obstacle, Sphere
from ..bodies.solids import field_of_mesh, field_of_points, field_of_surface
from ..errors import InputError, nearest, triple
from ..files.checked import Entry, Number, Positive, Triple, Whole, check, in_file
from ..files.csv_file import read_csv
from ..files.field_metadata import Typical
from ..files.fields import Part, entry_of
from ..files.files import read_text
from ..files.units import MM, TO_MM, shown
from ..files.yaml_file import load_yaml
from ..robots.limits import FAR
from ..typing import Array, Mask

# --- points that 3D Slicer saves: .fcsv, a table below comments, and .mrk.json ----------------------------------------

COLUMNS = "id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID"
"""Of a .fcsv file that does not name them."""

NOWHERE = ("undefined", "missing")
"""States of a point of a .mrk.json file that has no place."""

UNITS = {"mm": 1e-3, "m": 1.0, "cm": 1e-2, "um": 1e-6}
"""Units of length in files, m."""


def markups(path: str | PathLike[str]) -> dict[str, Array]:
    """Places (3,), m, by their labels, in the axes of the file.

    Raises:
        InputError: no such file, no points in it, a label that is empty or stands twice, a place that is no three
            finite numbers.
    """
    rows = _of_json(path) if Path(path).suffix.lower() == ".json" else _of_table(path)
    found: dict[str, Array] = {}
    for k, (label, place) in enumerate(rows, start=1):
        name = str(label or "").strip()
        if not name or name in found:
            raise InputError(f"{path}: label of point {k} is {name!r}; every landmark must have a name of its own")
        found[name] = np.array(triple(f"{path}: place of {name!r}", place))
    if not found:
        raise InputError(f"{path}: it has no points")
    return found


def _of_table(path: str | PathLike[str]) -> list[tuple[str, Any]]:
    columns, rows = COLUMNS.split(","), []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        if line.lstrip().startswith("#"):
            key, _, words = line.lstrip("# ").partition("=")
            # 3D Slicer names the columns in a comment.
            columns = [each.strip() for each in words.split(",")] if key.strip() == "columns" else columns
        elif line.strip():
            cells = dict(zip(columns, (cell.strip() for cell in line.split(",")), strict=False))
            try:
                place = [float(cells[axis]) * UNITS["mm"] for axis in "xyz"]
            except (KeyError, ValueError):
                raise InputError(f"{path}: line {number} has no x, y and z that are numbers") from None
            rows.append((cells.get("label", ""), place))
    return rows


def _of_json(path: str | PathLike[str]) -> list[tuple[str, Any]]:
    try:
        lists = json.loads(read_text(path))["markups"]
        rows = []
        for each in lists:
            unit = each.get("coordinateUnits", "mm")
            # 3D Slicer writes a word, or a list with one word.
            scale = UNITS[str(unit[0] if isinstance(unit, list) else unit)]
            points = [p for p in each.get("controlPoints", ()) if p.get("positionStatus") not in NOWHERE]
            rows += [(p["label"], np.array(p["position"], dtype=float) * scale) for p in points]
    except (ValueError, KeyError, IndexError, TypeError, AttributeError):
        raise InputError(
            f"{path}: not a markups file of 3D Slicer; it must have a list markups of "
            "controlPoints, each with label and position, and coordinateUnits "
            f"{', '.join(UNITS)}"
        ) from None
    return rows


# --- the file ---------------------------------------------------------------------------------------------------------

LOGGER = logging.getLogger(__name__)

Axes = Literal["RAS", "LPS"]


Pair = Annotated[list[Number], Field(min_length=2, max_length=2)]

SQUARE = 1e-3
"""How far the axes of a pose may be from those of a frame."""


def load_landmarks(path: str | PathLike[str], axes: str | None = None) -> dict[str, Array]:
    """Named places (3,) in RAS, m: of a CSV file with the columns name, x_mm, y_mm and z_mm, of markups of 3D Slicer
    (.fcsv, .mrk.json), or the one place that the three numbers (mm) of a .txt file are, by the name of the file.

    Args:
        axes: RAS or LPS, of a file that does not state its own.

    Raises:
        InputError: no such file, columns or cells that are not as they must be, a name twice; axes that are not known,
            or contradict those of the file.
    """
    own, kind = needed(path, axes), Path(path).suffix.lower()
    if kind == ".txt":
        return {Path(path).stem: ras(_numbers(path, (3,), "x, y and z in mm") * 1e-3, own)}
    if kind in (".fcsv", ".json"):
        found = markups(path)
        return {name: ras(place, own) for name, place in found.items()}
    table = read_csv(path, PLACE)
    table.expect(("name", *PLACE))
    places, known = ras(table.numbers(PLACE, MM), own), dict[str, Array]()
    for k, place in enumerate(places):
        name = table.cell(k, "name")
        if not name or name in known:
            table.complain(k, "name", f"is {name!r}; every landmark must have a name of its own")
        known[name] = place
    table.check()
    return known


def load_pose(path: str | PathLike[str], axes: str | None = None) -> Frame:
    """The frame in RAS that the 4 x 4 matrix in a text file is: the axes of the plate as its first three columns, the
    arm leaving along the third, and the position (mm) as its fourth.

    Args:
        axes: RAS or LPS, of a file that does not state its own in a comment.

    Raises:
        InputError: no such file, no such matrix, axes that are not those of a right-handed frame; axes of the patient
            that are not known, or contradict those of the file.
    """
    matrix = _numbers(path, (4, 4), "a matrix of four rows of four numbers")
    turn = matrix[:3, :3]
    # R^T R = I for a rotation, and the last row of a pose is 0 0 0 1.
    off = max(np.abs(turn.T @ turn - np.eye(3)).max(), np.abs(matrix[3] - [0, 0, 0, 1]).max())
    if off > SQUARE or np.linalg.det(turn) < 0:
        raise InputError(
            f"{path}: the matrix is not a pose; it must have a right-handed rotation, a position, and the row 0 0 0 1"
        )
    own = needed(path, axes)
    # U V^T is the rotation nearest to the matrix in the Frobenius norm: digits in files are rounded.
    u, _, v = np.linalg.svd(turn)
    return Frame(ras((u @ v).T, own).T, ras(matrix[:3, 3] * 1e-3, own))


def _numbers(path: str | PathLike[str], shape: tuple[int, ...], what: str) -> Array:
    """All numbers of a text file, between blanks or commas; lines that begin with # are comments."""
    lines = (line for line in read_text(path).splitlines() if not line.lstrip().startswith("#"))
    words = " ".join(lines).replace(",", " ").split()
    try:
        found = np.array([float(word) for word in words])
    except ValueError:
        found = np.zeros(0)
    if found.size != np.prod(shape) or not np.isfinite(found).all():
        raise InputError(f"{path}: it must contain only {what}")
    return found.reshape(shape)


def read_structure(path: str | PathLike[str], axes: str | None = None) -> LabelImage:
    """The voxels of an image that are not 0, as true; axes as of `read_image`.

    Raises:
        InputError: as `read_image`; voxels that are NaN or infinite, or no voxel but of 0.
    """
    image = read_image(path, axes)
    if not all(np.isfinite(part).all() for part in image.values):
        raise InputError(f"{path} has voxels that are NaN or infinite; every one must be a number")
    voxels = np.stack([part != 0 for part in image.values])  # a byte each: a case has many structures
    if not voxels.any():
        raise InputError(f"{path} has only voxels of value 0")
    return replace(image, values=voxels)


OF_FILE = "axes of the coordinates; required if the file does not state them"
OF_VOXELS = "axes of the voxels; required if the header does not state them"
"""What axes are of."""


class StructurePart(Entry):
    """Image of one structure: all voxels other than 0."""

    axes: Axes | None = Field(None, description=OF_VOXELS)
    file: Annotated[Any, in_file(read_structure, "a NIfTI or NRRD file", of="axes")] = Field(
        description="path of the NIfTI or NRRD file"
    )
    keep: Literal["in", "out", "target"] = Field(
        "out", description="in: the arm stays inside; out: the arm stays outside; target: region for the tip"
    )

    def build(self) -> DistanceField:
        """Its distance field in the patient, RAS."""
        image: LabelImage = self.file
        chosen = {"lumen" if self.keep == "in" else "forbidden": image.values}
        return field_of_image(image, **chosen, name=Path(image.name).name)


class MeshPart(Entry):
    """A surface in an STL, PLY, OBJ or legacy VTK file."""

    file: Annotated[Path, in_file(Path, "a mesh file")] = Field(description="path of the mesh file")
    keep: Literal["in", "out"] = Field(
        "out",
        description="in: the arm stays inside the closed surface; out: the arm stays "
        "outside it, or clear of an open surface",
    )
    unit: Literal["mm", "cm", "m"] = Field("mm", description="unit of the numbers in the file: mm, cm or m")
    axes: Axes | None = Field(None, description=OF_FILE)
    cell_mm: Annotated[Positive | None, Typical(1e-5, 0.05)] = Field(
        None, description="cell size of the distance field; default 0.5 if memory allows"
    )

    def build(self) -> DistanceField:
        """Its distance field in the patient, RAS."""
        mesh = read_mesh(self.file, scale=UNITS[self.unit], axes=needed(self.file, self.axes))
        field = field_of_mesh(mesh, keep=self.keep, name=self.file.name, **self.in_si("cell_mm"))
        warn_of_open(self.file, mesh)
        return field


class PointsPart(Entry):
    """Points in a PLY, VTK or CSV file, as balls. A file with faces bounds a layer around them."""

    file: Annotated[Path, in_file(Path, "a PLY or CSV file")] = Field(description="path of the file")
    radius_mm: Positive = Field(
        description="radius of the balls, at least half the distance between points; for "
        "faces, their thickness on each side"
    )
    unit: Literal["mm", "cm", "m"] = Field("mm", description="unit of the numbers in the file: mm, cm or m")
    axes: Axes | None = Field(None, description=OF_FILE)
    cell_mm: Annotated[Positive | None, Typical(1e-5, 0.05)] = Field(
        None, description="cell size of the distance field; default 0.5 if memory allows"
    )

    def build(self) -> DistanceField:
        """Its distance field in the patient, RAS."""
        found = load_points(self.file, scale=UNITS[self.unit], axes=needed(self.file, self.axes))
        make: Any = field_of_surface if isinstance(found, MeshObstacle) else field_of_points
        field: DistanceField = make(found, name=self.file.name, **self.in_si("radius_mm", "cell_mm"))
        return field


class LandmarksPart(Entry):
    """Landmarks of the patient."""

    axes: Axes | None = Field(None, description=OF_FILE)
    file: Annotated[Any, in_file(load_landmarks, "a file of landmarks: .csv, .fcsv, .mrk.json or .txt", of="axes")] = (
        Field(description="path of the file: .csv, .fcsv, .mrk.json or .txt")
    )

    def build(self) -> dict[str, Array]:
        """The places in RAS, m."""
        places: dict[str, Array] = self.file
        return places


class BasePart(Entry):
    """Pose of the base plate in the patient."""

    position_mm: Triple | None = Field(None, description="position in the patient")
    direction: Triple | None = Field(None, description="direction of the arm at the base plate, any length")
    axes: Axes | None = Field(
        None, description="axes: RAS (default) or LPS; required for a pose file that does not state them"
    )
    pose: Annotated[Any, in_file(load_pose, "a text file with a 4 x 4 matrix, mm", of="axes")] = Field(
        None, description="file with a 4 by 4 matrix; its third column is the direction, its fourth the position"
    )
    at: str | None = Field(None, description="landmark, instead of position_mm")
    towards: str | None = Field(None, description="landmark to point at, instead of direction")
    roll_deg: Number = Field(Decimal(0), description="rotation of the base plate about the direction")

    @model_validator(mode="after")
    def _one_of_each(self) -> Self:
        if self.pose is not None:
            if self.position_mm or self.direction or self.at or self.towards or self.roll_deg:
                raise ValueError("gives a pose and also position or direction; give one of them")
            return self
        for one, other in (("position_mm", "at"), ("direction", "towards")):
            if (getattr(self, one) is None) == (getattr(self, other) is None):
                raise ValueError(f"must give one of {one} and {other}")
        return self

    def frame(self, landmarks: Mapping[str, Array]) -> Frame:
        """The plate in the patient, RAS."""
        # Messages on unknown landmarks are those of the anatomy.
        known = Anatomy(landmarks=landmarks)
        if self.pose is not None:
            frame: Frame = self.pose
            return frame
        own = self.axes or "RAS"
        position = ras(self.si("position_mm"), own) if self.at is None else known.place(self.at)
        aim = ras(self.si("direction"), own) if self.towards is None else known.place(self.towards) - position
        return base_frame(position, aim, self.si("roll_deg"))


class RegistrationPart(Entry):
    """Landmarks measured from the base plate; they locate the plate in the patient."""

    landmarks_mm: dict[str, Triple] = Field(description="landmark names and their positions in the base frame")
    most_error_mm: Annotated[Positive, Typical(1e-5, 0.05)] = Field(Decimal(3), description="largest allowed RMS error")


class AnatomyPart(Entry):
    """Surroundings of the robot in a patient."""

    image_axes: Axes | None = Field(None, description=OF_VOXELS)
    image: (
        Annotated[LabelImage, in_file(read_image, "a NIfTI or NRRD file", kind=LabelImage, of="image_axes")] | None
    ) = Field(None, description="path of the label image, NIfTI or NRRD")
    lumen: list[Whole] = Field([], description="image labels that the arm must stay inside")
    lumen_between: Pair | None = Field(None, description="smallest and largest voxel value, instead of labels")
    forbidden: list[Whole] = Field([], description="image labels that the arm must avoid")
    forbidden_between: Pair | None = Field(None, description="smallest and largest voxel value, instead of labels")
    target: list[Whole] = Field([], description="image labels of the target region for the tip")
    region_mm: Annotated[list[Triple], Field(min_length=2, max_length=2)] | None = Field(
        None,
        description="smallest and largest corner (RAS) of the used part of the image; everything outside is forbidden",
    )
    structures: list[StructurePart] = Field([])
    meshes: list[MeshPart] = Field([])
    points: list[PointsPart] = Field([])
    landmarks: LandmarksPart | None = None
    base: BasePart | None = None
    registration: RegistrationPart | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        chosen = self.lumen or self.forbidden or self.target or self.lumen_between or self.forbidden_between
        if self.image is None and (chosen or self.region_mm):
            raise ValueError("chooses labels or a region without an image")
        if self.image is None and not self.structures and not self.meshes and not self.points:
            raise ValueError("has no image, structures, meshes or points; it must have one of them")
        if self.base is not None and self.registration is not None:
            raise ValueError("gives base and registration; give one of them")
        if self.registration is not None and self.landmarks is None:
            raise ValueError("gives a registration without landmarks")
        for labels, between in (("lumen", "lumen_between"), ("forbidden", "forbidden_between")):
            if getattr(self, labels) and getattr(self, between) is not None:
                raise ValueError(f"gives {labels} and {between}; give one of them")
        return self

    def build(self) -> Anatomy:
        """What the plate sees.

        Raises:
            InputError: files that cannot be read, labels that no voxel has, a registration that does not fit.
        """
        landmarks = {} if self.landmarks is None else self.landmarks.build()
        # Landmarks in LPS read as RAS have x and y reversed, and usually miss the image.
        if self.image is not None and landmarks and not any(self.image.holds(each) for each in landmarks.values()):
            LOGGER.warning(f"no landmark lies inside {self.image.name}; check axes and unit of the landmark file")
        base, found = Frame(), None
        if self.base is not None:
            base = self.base.frame(landmarks)
        elif self.registration is not None:
            here = self.registration.si("landmarks_mm")
            found = register(landmarks, here)
            base, error = found.frame, found.rms
            if error > self.registration.si("most_error_mm"):
                # Often a single landmark was touched wrongly or mixed up: the message names the worst.
                worst = max(found.errors, key=lambda name: found.errors[name])
                raise InputError(
                    f"registration has an RMS error of {error * 1e3:.3g} mm (landmark "
                    f"{worst!r}: {found.errors[worst] * 1e3:.3g} mm); it must be at most "
                    f"most_error_mm, {self.registration.most_error_mm}"
                )
            if not found.exact:
                LOGGER.warning(found.statement)
        fields, target = self._of_image()
        fields += [part.build() for part in self.structures if part.keep != "target"]
        regions = [centres(part.file, part.file.values) for part in self.structures if part.keep == "target"]
        if regions:
            target = np.concatenate([*regions, *([] if target is None else [target])])
        fields += [part.build() for part in self.meshes]
        fields += [part.build() for part in self.points]
        return anatomy_seen(fields, base, target=target, landmarks=landmarks, registration=found)

    def _of_image(self) -> tuple[list[DistanceField], Array | None]:
        image = self.image
        if image is None:
            return [], None
        lumen = _voxels(image, self.lumen, self.lumen_between, "lumen")
        forbidden = _voxels(image, self.forbidden, self.forbidden_between, "forbidden")
        target = _voxels(image, self.target, None, "target")
        if lumen is not None and target is not None:
            # The tip must reach the target, so that it belongs to the free space.
            lumen = lumen | target
        places = None if target is None else centres(image, target)
        if lumen is None and forbidden is None:
            if target is None:
                raise InputError(
                    f"no label of {image.name} is chosen; choose lumen, forbidden or target of {image.labels}"
                )
            return [], places
        region = None
        if self.region_mm is not None:
            low, high = map(np.array, self.si("region_mm"))
            region = low, high
        return [field_of_image(image, lumen=lumen, forbidden=forbidden, region=region)], places


def _voxels(image: LabelImage, labels: list[int], between: list[Decimal] | None, what: str) -> Mask | None:
    """Voxels that are chosen; None where none are to be."""
    if between is not None:
        return image.between(float(between[0]), float(between[1]), f"{what}_between")
    return image.chosen(labels, what) if labels else None


class AnatomyFile(Entry):
    """A file of an anatomy."""

    anatomy: AnatomyPart


def load_anatomy(path: str | PathLike[str]) -> Anatomy:
    """The anatomy in a YAML file with the key `anatomy`; raises InputError for what makes none."""
    return check(AnatomyFile, load_yaml(path), path).anatomy.build()


if TYPE_CHECKING:
    AnatomyKey = Anatomy
else:
    AnatomyKey = Annotated[
        Annotated[Anatomy, in_file(load_anatomy, "a YAML file of an anatomy", kind=Anatomy), Tag("<file>")]
        | Annotated[AnatomyPart, AfterValidator(AnatomyPart.build), Tag("<anatomy>")],
        Discriminator(lambda value: "<anatomy>" if isinstance(value, dict) else "<file>"),
    ]
"""An anatomy in whatever file: what it is made of, or the path of a file with the key `anatomy`."""


# --- obstacles: a list of bodies, lengths in mm, each with its kind ---------------------------------------------------

Place = Annotated[Triple, Typical(1e-3, 10.0)]
"""A position that is reached by a robot as long as a hand or an arm."""


def _near_the_robot(place: list[Decimal], info: ValidationInfo) -> list[Decimal]:
    robot = info.data.get("robot")
    if robot is not None:
        # So far away, a place is in a wrong unit or in a wrong frame.
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
    # Files may leave out the kind, where a key of the body determines it.
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
