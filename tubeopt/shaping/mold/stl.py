"""The plates of a mold as solids (STL, mm): built by manifold3d, read back, watertight, of the right volume."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import SolveError, choice, extra
from ...files.files import atomic_write
from ...files.units import TO_MM
from .drawing import PARTS
from .groove import polygon
from .holes import Hole
from .mold import Mold

ABOVE = 1e-3
"""Cutters reach this far (m) beyond the faces, so that no faces coincide."""


def write_stl(mold: Mold, path: str | PathLike[str], *, part: str = "base") -> Path:
    """Write a plate of the mold as binary STL in mm, whole or not at all, and return the path.

    The upper face of the base lies at z = 0, and the lid on it. It is read back and checked.
    """
    choice("part", part, PARTS)
    above = (*mold.holes, *mold.vents)
    solid = _base(mold) if part == "base" else _plate(mold, above, mold.spec.plate.lid_thickness, 0.0)
    return write_solid(solid, path, lambda written: check_stl(mold, written, part=part, name=str(path)))


def write_solid(solid: Any, path: str | PathLike[str], check: Callable[[Path], object]) -> Path:
    """Write a solid as STL, checked before it has its name."""
    mesh = solid.to_mesh()
    # Vertices as STL holds them; what then coincides is one vertex, so that the file closes as the solid does.
    faces = trimesh().Trimesh(np.asarray(mesh.vert_properties, dtype=np.float32)[:, :3], mesh.tri_verts, process=True)
    with atomic_write(path) as temporary:
        temporary.write_bytes(faces.export(file_type="stl"))
        check(temporary)
    return Path(path)


def check_stl(mold: Mold, path: str | PathLike[str], *, part: str = "base", name: str = "") -> float:
    """The relative difference of an STL file's volume from that of the plate; raises SolveError where that is more than
    0.1 %, or the solid is not watertight."""
    choice("part", part, PARTS)
    mesh = trimesh().load_mesh(str(path), file_type="stl")
    if not mesh.is_watertight:
        raise SolveError(f"{name or path}: the solid of the {part} is not watertight")
    wanted = mold.base_volume if part == "base" else mold.lid_volume
    off = float(mesh.volume) / TO_MM**3 / wanted - 1
    if abs(off) > 1e-3:
        raise SolveError(f"{name or path}: the volume of the {part} is off by {off * 100:.3g} %")
    return off


def _base(mold: Mold) -> Any:
    library = manifold()
    thickness = mold.spec.plate.thickness
    solid = _plate(mold, mold.holes, thickness, -thickness)
    for groove in mold.grooves:
        # Beyond the edge by more than an oblique exit needs.
        curve = groove.centreline.lengthened(20 * groove.width)
        corners = polygon(curve, groove.width, mold.spec.solver.sagitta)
        cutter = library.Manifold.extrude(library.CrossSection([corners * TO_MM]), (groove.depth + ABOVE) * TO_MM)
        solid -= cutter.translate((0.0, 0.0, -groove.depth * TO_MM))
    return solid


def _plate(mold: Mold, holes: Sequence[Hole], thickness: float, bottom: float) -> Any:
    """The plate with its holes, which go through: cut out of its outline, in the plane, and made thick."""
    library = manifold()
    outline = library.CrossSection.square((mold.size[0] * TO_MM, mold.size[1] * TO_MM))
    drills = [
        library.CrossSection.circle(hole.diameter / 2 * TO_MM, mold.spec.solver.hole_sides).translate(
            (hole.centre[0] * TO_MM, hole.centre[1] * TO_MM)
        )
        for hole in holes
    ]
    drilled = library.CrossSection.batch_boolean([outline, *drills], library.OpType.Subtract)
    return library.Manifold.extrude(drilled, thickness * TO_MM).translate((0.0, 0.0, bottom * TO_MM))


def manifold() -> Any:
    """The library of solids; raises MissingExtraError without it."""
    return extra("manifold3d", "fabrication", "STL files")


def trimesh() -> Any:
    """The library of meshes; raises MissingExtraError without it."""
    return extra("trimesh", "fabrication", "STL files")
