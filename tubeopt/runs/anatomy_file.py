"""Anatomy as YAML: images, meshes, clouds of points and landmarks of a patient, and where the robot stands."""

from __future__ import annotations

from collections.abc import Mapping
from decimal import Decimal
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, Discriminator, Field, Tag, model_validator

from ..bodies.anatomy import Anatomy, anatomy_seen, centres, field_of_image
from ..bodies.corridors import PLACE, load_mesh, load_points
from ..bodies.distance_field import DistanceField
from ..bodies.frames import Frame, base_frame, ras, register
from ..bodies.images import LabelImage, read_image
from ..bodies.solids import field_of_mesh, field_of_points
from ..errors import InputError
from ..files.checked import Entry, Number, Positive, Whole, check, in_file
from ..files.csv_file import read_csv
from ..files.units import DEG, MM, to_si
from ..files.yaml_file import load_yaml
from ..typing import Array, Mask

Axes = Literal["RAS", "LPS"]

Triple = Annotated[list[Number], Field(min_length=3, max_length=3)]

Pair = Annotated[list[Number], Field(min_length=2, max_length=2)]

UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}


def load_landmarks(path: str | PathLike[str]) -> dict[str, Array]:
    """Named places in a CSV file with the columns name, x_mm, y_mm and z_mm, m, in the axes of the file.

    Raises:
        InputError: no such file, columns or cells that are not as they must be, a name twice.
    """
    table = read_csv(path)
    table.expect(("name", *PLACE))
    places = table.numbers(PLACE, MM)
    found: dict[str, Array] = {}
    for k, place in enumerate(places):
        name = table.cell(k, "name")
        if not name or name in found:
            table.complain(k, "name", f"is {name!r}; every landmark must have a name of its own")
        found[name] = place
    table.check()
    return found


class MeshPart(Entry):
    """A closed surface in an STL, PLY or OBJ file."""

    file: Annotated[Path, in_file(Path, "a mesh file")]
    keep: Literal["in", "out"] = Field("out", description="in: the arm stays within the surface; out: outside of it")
    unit: Literal["mm", "cm", "m"] = Field("mm", description="of the numbers in the file")
    axes: Axes = Field("RAS", description="of the patient that the file is written in")
    cell_mm: Positive | None = Field(None, description="size of the cells of its distance field; 0.5 where that can be")

    def build(self) -> DistanceField:
        """Its distance field in the patient, RAS."""
        mesh = load_mesh(self.file, scale=UNITS[self.unit], axes=self.axes)
        return field_of_mesh(mesh, keep=self.keep, cell=_metres(self.cell_mm), name=self.file.name)


class PointsPart(Entry):
    """A cloud of points in a PLY or CSV file, each the centre of a ball."""

    file: Annotated[Path, in_file(Path, "a PLY or CSV file")]
    radius_mm: Positive = Field(description="of the balls: no less than half of how far apart the points are")
    unit: Literal["mm", "cm", "m"] = Field("mm", description="of the numbers in the file")
    axes: Axes = Field("RAS", description="of the patient that the file is written in")
    cell_mm: Positive | None = Field(None, description="size of the cells of its distance field; 0.5 where that can be")

    def build(self) -> DistanceField:
        """Its distance field in the patient, RAS."""
        points = load_points(self.file, scale=UNITS[self.unit], axes=self.axes)
        radius = to_si(self.radius_mm, MM)
        return field_of_points(points, radius, cell=_metres(self.cell_mm), name=self.file.name)


class LandmarksPart(Entry):
    """Named places in the patient."""

    file: Annotated[Any, in_file(load_landmarks, "a CSV file of landmarks")]
    axes: Axes = Field(description="of the patient that the file is written in")

    def build(self) -> dict[str, Array]:
        """The places in RAS, m."""
        return {name: ras(place, self.axes) for name, place in self.file.items()}


class BasePart(Entry):
    """Where the plate stands in the patient, and along what the arm leaves it."""

    position_mm: Triple | None = Field(None, description="in the patient")
    direction: Triple | None = Field(None, description="along which the arm leaves the plate, of any length")
    at: str | None = Field(None, description="a landmark in place of position_mm")
    towards: str | None = Field(None, description="a landmark in place of direction")
    roll_deg: Number = Field(Decimal(0), description="turn of the plate about that direction")
    axes: Axes = Field("RAS", description="of position_mm and direction")

    @model_validator(mode="after")
    def _one_of_each(self) -> Self:
        for one, other in (("position_mm", "at"), ("direction", "towards")):
            if (getattr(self, one) is None) == (getattr(self, other) is None):
                raise ValueError(f"must give one of {one} and {other}")
        return self

    def frame(self, landmarks: Mapping[str, Array]) -> Frame:
        """The plate in the patient, RAS."""
        known = Anatomy(landmarks=landmarks)
        if self.at is not None:
            position = known.place(self.at)
        else:
            position = ras([to_si(x, MM) for x in self.position_mm or ()], self.axes)
        if self.towards is not None:
            direction = known.place(self.towards) - position
        else:
            direction = ras([float(x) for x in self.direction or ()], self.axes)
        return base_frame(position, direction, to_si(self.roll_deg, DEG))


class RegistrationPart(Entry):
    """Landmarks as they are measured from the plate, by which the plate is found in the patient."""

    landmarks_mm: dict[str, Triple] = Field(description="names of landmarks, and where each is from the plate")
    most_error_mm: Positive = Field(Decimal(3), description="largest root of the mean square error that is allowed")


class AnatomyPart(Entry):
    """What is around the robot in a patient."""

    image: Annotated[LabelImage, in_file(read_image, "a NIfTI or NRRD file", kind=LabelImage)] | None = None
    lumen: list[Whole] = Field([], description="labels of the image within which the arm stays")
    lumen_between: Pair | None = Field(None, description="in place of labels: least and greatest value of voxels")
    forbidden: list[Whole] = Field([], description="labels that the arm keeps out of")
    forbidden_between: Pair | None = Field(None, description="in place of labels: least and greatest value of voxels")
    target: list[Whole] = Field([], description="labels of the region for the tip")
    region_mm: Annotated[list[Triple], Field(min_length=2, max_length=2)] | None = Field(
        None,
        description="least and greatest corner (RAS) of the part of the image that counts; beyond all is forbidden",
    )
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
        if self.image is None and not self.meshes and not self.points:
            raise ValueError("has no image, meshes or points; it must have one of them")
        if self.base is not None and self.registration is not None:
            raise ValueError("gives base and registration; one of them says where the robot stands")
        if self.registration is not None and self.landmarks is None:
            raise ValueError("gives a registration without landmarks")
        for labels, between in (("lumen", "lumen_between"), ("forbidden", "forbidden_between")):
            if getattr(self, labels) and getattr(self, between) is not None:
                raise ValueError(f"gives {labels} and {between}; one of them chooses the voxels")
        return self

    def build(self) -> Anatomy:
        """What the plate sees.

        Raises:
            InputError: files that cannot be read, labels that no voxel has, a registration that does not fit.
        """
        landmarks = {} if self.landmarks is None else self.landmarks.build()
        base, error = Frame(), 0.0
        if self.base is not None:
            base = self.base.frame(landmarks)
        elif self.registration is not None:
            here = {k: [to_si(x, MM) for x in place] for k, place in self.registration.landmarks_mm.items()}
            found = register(landmarks, here)
            base, error = found.frame, found.rms
            if error > to_si(self.registration.most_error_mm, MM):
                worst = max(found.errors, key=lambda name: found.errors[name])
                raise InputError(
                    f"registration leaves landmarks {error * 1e3:.3g} mm off (root of the mean square; {worst!r} by "
                    f"{found.errors[worst] * 1e3:.3g} mm); most_error_mm is {self.registration.most_error_mm}"
                )
        fields, target = self._of_image()
        fields += [part.build() for part in self.meshes]
        fields += [part.build() for part in self.points]
        return anatomy_seen(fields, base, target=target, landmarks=landmarks, registration_error=error)

    def _of_image(self) -> tuple[list[DistanceField], Array | None]:
        image = self.image
        if image is None:
            return [], None
        lumen = _voxels(image, self.lumen, self.lumen_between, "lumen")
        forbidden = _voxels(image, self.forbidden, self.forbidden_between, "forbidden")
        target = _voxels(image, self.target, None, "target")
        if lumen is not None and target is not None:
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
            low, high = (np.array([to_si(x, MM) for x in corner]) for corner in self.region_mm)
            region = low, high
        return [field_of_image(image, lumen=lumen, forbidden=forbidden, region=region)], places


def _voxels(image: LabelImage, labels: list[int], between: list[Decimal] | None, what: str) -> Mask | None:
    """Voxels that are chosen; None where none are to be."""
    if between is not None:
        return image.between(float(between[0]), float(between[1]), f"{what}_between")
    return image.chosen(labels, what) if labels else None


def _metres(value: Decimal | None) -> float | None:
    return None if value is None else to_si(value, MM)


class AnatomyFile(Entry):
    """A file of an anatomy."""

    anatomy: AnatomyPart


def load_anatomy(path: str | PathLike[str]) -> Anatomy:
    """The anatomy in a YAML file with the key `anatomy`.

    Raises:
        InputError: no such file, not YAML, or keys, values and files that make no anatomy.
    """
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
