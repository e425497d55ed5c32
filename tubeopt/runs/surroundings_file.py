"""Obstacles and anatomies as YAML: bodies, images, meshes and landmarks, and the pose of the base plate."""

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

from ..bodies.anatomy import Anatomy, anatomy_in_frame, centres
from ..bodies.corridors import PLACE, Corridor, MeshObstacle, load_mesh, load_points, read_mesh, warn_of_open
from ..bodies.distance_field import DistanceField
from ..bodies.frames import Frame, base_frame, ras, register, required_axes
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
"""Columns of a .fcsv file without a header."""

NOWHERE = ("undefined", "missing")
"""States of a point without a position in a .mrk.json file."""

UNITS = {"mm": 1e-3, "m": 1.0, "cm": 1e-2, "um": 1e-6}
"""Units of length in files, in m."""


def markups(path: str | PathLike[str]) -> dict[str, Array]:
    """Load points (3,), m, by their labels, in the axes of the file.

    Raises:
        InputError: no such file, no points, an empty or repeated label, a position that is not three finite numbers.
    """
    rows = _of_json(path) if Path(path).suffix.lower() == ".json" else _of_table(path)
    points: dict[str, Array] = {}
    for k, (label, position) in enumerate(rows, start=1):
        name = str(label or "").strip()
        if not name or name in points:
            raise InputError(f"{path}: label of point {k} is {name!r}; every landmark must have a name of its own")
        points[name] = np.array(triple(f"{path}: place of {name!r}", position))
    if not points:
        raise InputError(f"{path}: it has no points")
    return points


def _of_table(path: str | PathLike[str]) -> list[tuple[str, Any]]:
    columns, rows = COLUMNS.split(","), []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        if line.lstrip().startswith("#"):
            key, _, value = line.lstrip("# ").partition("=")
            # 3D Slicer names the columns in a comment.
            columns = [each.strip() for each in value.split(",")] if key.strip() == "columns" else columns
        elif line.strip():
            cells = dict(zip(columns, (cell.strip() for cell in line.split(",")), strict=False))
            try:
                position = [float(cells[axis]) * UNITS["mm"] for axis in "xyz"]
            except (KeyError, ValueError):
                raise InputError(f"{path}: line {number} has no x, y and z that are numbers") from None
            rows.append((cells.get("label", ""), position))
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

POSE_TOLERANCE = 1e-3
"""Largest deviation of the axes of a pose from an orthonormal frame."""


def load_landmarks(path: str | PathLike[str], axes: str | None = None) -> dict[str, Array]:
    """Load named landmarks (3,) in RAS, m.

    Formats: CSV with columns name, x_mm, y_mm and z_mm; markups of 3D Slicer (.fcsv, .mrk.json); .txt with the three
    numbers of one landmark in mm, named after the file.

    Args:
        axes: RAS or LPS, for a file that does not state its axes.

    Raises:
        InputError: no such file, invalid columns or cells, a repeated name, unknown axes or axes that contradict the
            file.
    """
    letters, kind = required_axes(path, axes), Path(path).suffix.lower()
    if kind == ".txt":
        return {Path(path).stem: ras(_numbers(path, (3,), "x, y and z in mm") * 1e-3, letters)}
    if kind in (".fcsv", ".json"):
        return {name: ras(point, letters) for name, point in markups(path).items()}
    table = read_csv(path, PLACE)
    table.expect(("name", *PLACE))
    points, known = ras(table.numbers(PLACE, MM), letters), dict[str, Array]()
    for k, row in enumerate(points):
        name = table.cell(k, "name")
        if not name or name in known:
            table.complain(k, "name", f"is {name!r}; every landmark must have a name of its own")
        known[name] = row
    table.check()
    return known


def load_pose(path: str | PathLike[str], axes: str | None = None) -> Frame:
    """Load the frame of the base plate in RAS from a 4 x 4 matrix in a text file.

    Columns 1 to 3 are the axes of the plate, with the arm along the third; column 4 is the position, mm.

    Args:
        axes: RAS or LPS, for a file without a comment that states them.

    Raises:
        InputError: no such file, no such matrix, no right-handed frame; unknown axes or axes that contradict the file.
    """
    matrix = _numbers(path, (4, 4), "a matrix of four rows of four numbers")
    rotation = matrix[:3, :3]
    # R^T R = I for a rotation, and the last row of a pose is 0 0 0 1.
    deviation = max(np.abs(rotation.T @ rotation - np.eye(3)).max(), np.abs(matrix[3] - [0, 0, 0, 1]).max())
    if deviation > POSE_TOLERANCE or np.linalg.det(rotation) < 0:
        raise InputError(
            f"{path}: the matrix is not a pose; it must have a right-handed rotation, a position, and the row 0 0 0 1"
        )
    letters = required_axes(path, axes)
    # U V^T is the rotation nearest to the matrix in the Frobenius norm: digits in files are rounded.
    u, _, v = np.linalg.svd(rotation)
    return Frame(ras((u @ v).T, letters).T, ras(matrix[:3, 3] * 1e-3, letters))


def _numbers(path: str | PathLike[str], shape: tuple[int, ...], what: str) -> Array:
    """Read the numbers of a text file, separated by blanks or commas; lines that begin with # are comments."""
    lines = (line for line in read_text(path).splitlines() if not line.lstrip().startswith("#"))
    try:
        numbers = np.array([float(word) for word in " ".join(lines).replace(",", " ").split()])
    except ValueError:
        numbers = np.zeros(0)
    if numbers.size != np.prod(shape) or not np.isfinite(numbers).all():
        raise InputError(f"{path}: it must contain only {what}")
    return numbers.reshape(shape)


def read_structure(path: str | PathLike[str], axes: str | None = None) -> LabelImage:
    """Load an image as a mask of the voxels that are not 0; axes as in `read_image`.

    Raises:
        InputError: as `read_image`; voxels that are NaN or infinite, or only voxels of value 0.
    """
    image = read_image(path, axes)
    if not all(np.isfinite(part).all() for part in image.values):
        raise InputError(f"{path} has voxels that are NaN or infinite; every one must be a number")
    # Booleans need one byte per voxel: a case has many structures.
    voxels = np.stack([part != 0 for part in image.values])
    if not voxels.any():
        raise InputError(f"{path} has only voxels of value 0")
    return replace(image, values=voxels)


FILE_AXES = "axes of the coordinates; required if the file does not state them"
VOXEL_AXES = "axes of the voxels; required if the header does not state them"


class StructurePart(Entry):
    """Image of one structure: all voxels other than 0."""

    axes: Axes | None = Field(None, description=VOXEL_AXES)
    file: Annotated[Any, in_file(read_structure, "a NIfTI or NRRD file", of="axes")] = Field(
        description="path of the NIfTI or NRRD file"
    )
    keep: Literal["in", "out", "target"] = Field(
        "out", description="in: the arm stays inside; out: the arm stays outside; target: region for the tip"
    )

    def build(self) -> DistanceField:
        """Distance field in the patient, RAS."""
        image: LabelImage = self.file
        region = {"lumen" if self.keep == "in" else "forbidden": image.values}
        return field_of_image(image, **region, name=Path(image.name).name)


class MeshPart(Entry):
    """A surface in an STL, PLY, OBJ or legacy VTK file."""

    file: Annotated[Path, in_file(Path, "a mesh file")] = Field(description="path of the mesh file")
    keep: Literal["in", "out"] = Field(
        "out",
        description="in: the arm stays inside the closed surface; out: the arm stays "
        "outside it, or clear of an open surface",
    )
    unit: Literal["mm", "cm", "m"] = Field("mm", description="unit of the numbers in the file: mm, cm or m")
    axes: Axes | None = Field(None, description=FILE_AXES)
    cell_mm: Annotated[Positive | None, Typical(1e-5, 0.05)] = Field(
        None, description="cell size of the distance field; default 0.5 if memory allows"
    )

    def build(self) -> DistanceField:
        """Distance field in the patient, RAS."""
        mesh = read_mesh(self.file, scale=UNITS[self.unit], axes=required_axes(self.file, self.axes))
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
    axes: Axes | None = Field(None, description=FILE_AXES)
    cell_mm: Annotated[Positive | None, Typical(1e-5, 0.05)] = Field(
        None, description="cell size of the distance field; default 0.5 if memory allows"
    )

    def build(self) -> DistanceField:
        """Distance field in the patient, RAS."""
        points = load_points(self.file, scale=UNITS[self.unit], axes=required_axes(self.file, self.axes))
        field_of: Any = field_of_surface if isinstance(points, MeshObstacle) else field_of_points
        field: DistanceField = field_of(points, name=self.file.name, **self.in_si("radius_mm", "cell_mm"))
        return field


class LandmarksPart(Entry):
    """Landmarks of the patient."""

    axes: Axes | None = Field(None, description=FILE_AXES)
    file: Annotated[Any, in_file(load_landmarks, "a file of landmarks: .csv, .fcsv, .mrk.json or .txt", of="axes")] = (
        Field(description="path of the file: .csv, .fcsv, .mrk.json or .txt")
    )

    def build(self) -> dict[str, Array]:
        """Landmarks (3,) in RAS, m, by name."""
        landmarks: dict[str, Array] = self.file
        return landmarks


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
        for vector, landmark in (("position_mm", "at"), ("direction", "towards")):
            if (getattr(self, vector) is None) == (getattr(self, landmark) is None):
                raise ValueError(f"must give one of {vector} and {landmark}")
        return self

    def frame(self, landmarks: Mapping[str, Array]) -> Frame:
        """Frame of the base plate in the patient, RAS."""
        if self.pose is not None:
            frame: Frame = self.pose
            return frame
        # An anatomy reports unknown landmarks.
        known, axes = Anatomy(landmarks=landmarks), self.axes or "RAS"
        position = ras(self.si("position_mm"), axes) if self.at is None else known.position(self.at)
        direction = ras(self.si("direction"), axes) if self.towards is None else known.position(self.towards) - position
        return base_frame(position, direction, self.si("roll_deg"))


class RegistrationPart(Entry):
    """Landmarks measured from the base plate; they locate the plate in the patient."""

    landmarks_mm: dict[str, Triple] = Field(description="landmark names and their positions in the base frame")
    most_error_mm: Annotated[Positive, Typical(1e-5, 0.05)] = Field(Decimal(3), description="largest allowed RMS error")


class AnatomyPart(Entry):
    """Surroundings of the robot in a patient."""

    image_axes: Axes | None = Field(None, description=VOXEL_AXES)
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
        has_labels = self.lumen or self.forbidden or self.target or self.lumen_between or self.forbidden_between
        if self.image is None and (has_labels or self.region_mm):
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
        """Build the anatomy in the base frame.

        Raises:
            InputError: unreadable files, labels without voxels, a registration with a large error.
        """
        landmarks = {} if self.landmarks is None else self.landmarks.build()
        # Landmarks in LPS read as RAS have x and y reversed, and usually miss the image.
        if self.image is not None and landmarks and not any(self.image.holds(each) for each in landmarks.values()):
            LOGGER.warning(f"no landmark lies inside {self.image.name}; check axes and unit of the landmark file")
        base, registration = Frame(), None
        if self.base is not None:
            base = self.base.frame(landmarks)
        elif self.registration is not None:
            registration = register(landmarks, self.registration.si("landmarks_mm"))
            base, errors = registration.frame, registration.errors
            if registration.rms > self.registration.si("most_error_mm"):
                # Often a single landmark was touched wrongly or mixed up: the message names the worst.
                worst = max(errors, key=lambda name: errors[name])
                raise InputError(
                    f"registration has an RMS error of {registration.rms * 1e3:.3g} mm (landmark "
                    f"{worst!r}: {errors[worst] * 1e3:.3g} mm); it must be at most "
                    f"most_error_mm, {self.registration.most_error_mm}"
                )
            if not registration.exact:
                LOGGER.warning(registration.statement)
        fields, target = self._of_image()
        fields += [part.build() for part in self.structures if part.keep != "target"]
        regions = [centres(part.file, part.file.values) for part in self.structures if part.keep == "target"]
        if regions:
            target = np.concatenate([*regions, *([] if target is None else [target])])
        fields += [part.build() for part in self.meshes]
        fields += [part.build() for part in self.points]
        return anatomy_in_frame(fields, base, target=target, landmarks=landmarks, registration=registration)

    def _of_image(self) -> tuple[list[DistanceField], Array | None]:
        """Distance fields of the image, and the voxel centres of its target (N, 3), m."""
        image = self.image
        if image is None:
            return [], None
        lumen = _voxels(image, self.lumen, self.lumen_between, "lumen")
        forbidden = _voxels(image, self.forbidden, self.forbidden_between, "forbidden")
        target = _voxels(image, self.target, None, "target")
        if lumen is not None and target is not None:
            # The tip must reach the target, so that it belongs to the free space.
            lumen = lumen | target
        points = None if target is None else centres(image, target)
        if lumen is None and forbidden is None:
            if target is None:
                raise InputError(
                    f"no label of {image.name} is chosen; choose lumen, forbidden or target of {image.labels}"
                )
            return [], points
        region = None
        if self.region_mm is not None:
            low, high = map(np.array, self.si("region_mm"))
            region = low, high
        return [field_of_image(image, lumen=lumen, forbidden=forbidden, region=region)], points


def _voxels(image: LabelImage, labels: list[int], between: list[Decimal] | None, what: str) -> Mask | None:
    """Mask of the voxels with these labels or values; None without labels and values."""
    if between is not None:
        return image.between(float(between[0]), float(between[1]), f"{what}_between")
    return image.chosen(labels, what) if labels else None


class AnatomyFile(Entry):
    """Anatomy file."""

    anatomy: AnatomyPart


def load_anatomy(path: str | PathLike[str]) -> Anatomy:
    """Load an anatomy from a YAML file with the key `anatomy`; raises InputError as `AnatomyPart.build`."""
    return check(AnatomyFile, load_yaml(path), path).anatomy.build()


if TYPE_CHECKING:
    AnatomyKey = Anatomy
else:
    AnatomyKey = Annotated[
        Annotated[Anatomy, in_file(load_anatomy, "a YAML file of an anatomy", kind=Anatomy), Tag("<file>")]
        | Annotated[AnatomyPart, AfterValidator(AnatomyPart.build), Tag("<anatomy>")],
        Discriminator(lambda value: "<anatomy>" if isinstance(value, dict) else "<file>"),
    ]
"""Anatomy, given by its keys or as the path of a file with the key `anatomy`."""


# --- obstacles: a list of bodies with their kinds, lengths in mm ------------------------------------------------------

Position = Annotated[Triple, Typical(1e-3, 10.0)]
"""Position with a warning for an implausible unit."""


def _near_the_robot(position: list[Decimal], info: ValidationInfo) -> list[Decimal]:
    robot = info.data.get("robot")
    if robot is not None:
        # Farther away, the position is in a wrong unit or a wrong frame.
        limit, distance = FAR * max(tube.length for tube in robot.tubes) * TO_MM, math.hypot(*map(float, position))
        if distance > limit:
            numbers = ", ".join(map(str, position))
            raise ValueError(
                f"is [{numbers}], {distance:.6g} mm from the plate; it must be at most {limit:.6g} mm away, {FAR:g} "
                "times the longest tube"
            )
    return position


TipPosition = Annotated[Position, AfterValidator(_near_the_robot)]
"""Position for the tip of the study's robot."""


class MeshEntry(Part):
    """Surface from a mesh file, in mm and plate axes. A closed surface bounds a body. The arm avoids the
    triangles of an open one. For a file with SPACE=LPS, as 3D Slicer writes it, x and y change sign."""

    kind: Literal["mesh"]
    file: Annotated[MeshObstacle, in_file(load_mesh, "a mesh file in mm")] = Field(
        description="path of the mesh file, mm"
    )

    def build(self) -> MeshObstacle:
        """Obstacle in SI."""
        return self.file


class AnatomyEntry(Entry):
    """Bodies of an anatomy file."""

    kind: Literal["anatomy"]
    file: Annotated[Anatomy, in_file(load_anatomy, "a YAML file of an anatomy", kind=Anatomy)] = Field(
        description="path of the YAML file of the anatomy"
    )

    def build(self) -> tuple[Obstacle, ...]:
        """Bodies in SI, in the base frame."""
        return self.file.bodies


BODIES: dict[str, type[Any]] = {
    "sphere": Sphere,
    "capsule": Capsule,
    "half_space": HalfSpace,
    "box": Box,
    "corridor": Corridor,
}
"""Bodies with keys that follow from their fields."""

ENTRIES: dict[str, Any] = {
    kind: entry_of(body, extra={"kind": (Literal[kind], kind)}) for kind, body in BODIES.items()
} | {"mesh": MeshEntry, "anatomy": AnatomyEntry}

KINDS = tuple(ENTRIES)

BY_KEYS = {"centre_mm": "sphere", "from_mm": "capsule", "start_mm": "capsule", "low_mm": "box", "normal": "half_space"}
"""Key that only one kind has -> this kind, which may then be omitted."""

ALIASES = {"from_mm": "start_mm", "to_mm": "end_mm"}
"""Alternative names of keys of a capsule."""


def _with_kind(value: Any) -> Any:
    """Complete the kind of a body, and replace alternative names of its keys."""
    if not isinstance(value, dict):
        raise ValueError(f"is {shown(value)}; it must be a mapping with the kind of a body, one of {', '.join(KINDS)}")
    # Files may omit the kind if a key of the body determines it.
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
        BeforeValidator(_with_kind),
    ]
"""Body of any kind; the kind may be omitted if the keys determine it."""


class ObstacleFile(Entry):
    """Obstacle file."""

    obstacles: list[ObstacleEntry]


def load_obstacles(path: str | PathLike[str]) -> tuple[Obstacle, ...]:
    """Load obstacles from a YAML file with the key `obstacles`; raises InputError with one line per problem."""
    return _built(check(ObstacleFile, load_yaml(path, "obstacles"), path).obstacles)


def _built(entries: Sequence[Part]) -> tuple[Obstacle, ...]:
    built = [entry.build() for entry in entries]
    return tuple(body for part in built for body in (part if isinstance(part, tuple) else (part,)))


if TYPE_CHECKING:
    Bodies = tuple[Obstacle, ...]
else:
    Bodies = Annotated[
        Annotated[tuple[Obstacle, ...], in_file(load_obstacles, "a YAML file of obstacles"), Tag("<file>")]
        | Annotated[list[ObstacleEntry], AfterValidator(_built), Tag("<bodies>")],
        Discriminator(lambda value: "<bodies>" if isinstance(value, list) else "<file>"),
    ]
"""Obstacles in SI, given as a list of bodies or as the path of a file with the key `obstacles`."""


WallBodies = Annotated[
    Bodies,
    Field(
        description="bodies that the arm cannot enter, and that push it where it touches them, without friction: a "
        "YAML file of obstacles, or a list as [{centre_mm: [30, 0, 120], radius_mm: 8}]; default none",
        examples=["OBSTACLES.yaml"],
    ),
]
"""Walls that push the arm."""

LumenBodies = Annotated[
    Bodies,
    Field(
        description="walls of the lumen, without friction: a YAML file of obstacles, or a list of bodies",
        examples=["OBSTACLES.yaml"],
    ),
]
"""Walls that the arm cannot do without."""


class Surrounded(Entry):
    """Robot with obstacles and an anatomy around it."""

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
        """Anatomy; an empty one by default."""
        return Anatomy() if self.anatomy is None else self.anatomy

    @property
    def bodies(self) -> tuple[Obstacle, ...]:
        """Obstacles of the study and of its anatomy."""
        return self.obstacles + self.around.bodies
