"""The files of a mold, written together: drawings, solids, G-code, set-up sheet."""

from __future__ import annotations

from pathlib import Path

from .dxf import write_dxf
from .gcode import write_gcode
from .mold import Mold
from .stl import write_stl
from .svg import write_svg


def write_mold(mold: Mold, directory: str | Path) -> list[Path]:
    """Write base and lid as DXF, SVG and STL and their G-code; return the paths.

    Raises:
        InputError: a file cannot be written, or ezdxf, manifold3d or trimesh is not installed.
        SolveError: a file that was written does not agree with the mold when it is read back.
    """
    out = Path(directory)
    paths = []
    for part in ("base", "lid"):
        paths.append(write_dxf(mold, out / f"{part}.dxf", part=part))
        paths.append(write_svg(mold, out / f"{part}.svg", part=part))
        paths.append(write_stl(mold, out / f"{part}.stl", part=part))
    return [*paths, *write_gcode(mold, out)]
