"""The files of a mold, written together: drawings, solids, G-code, set-up sheet."""

from __future__ import annotations

from pathlib import Path

from ...files.files import left_out_where_missing
from .dxf import write_dxf
from .gcode import write_gcode
from .mold import Mold
from .stl import write_stl
from .svg import write_svg


def write_mold(mold: Mold, directory: str | Path) -> list[Path]:
    """Write base and lid as DXF, SVG and STL and their G-code; return the paths.

    Drawings and solids whose package (ezdxf, manifold3d, trimesh) is not installed are left out with a warning.

    Raises:
        InputError: a file cannot be written.
        SolveError: a file that was written does not agree with the mold when it is read back.
    """
    out = Path(directory)
    paths = []
    for part in ("base", "lid"):
        for kind, write in (("dxf", write_dxf), ("svg", write_svg), ("stl", write_stl)):
            with left_out_where_missing():
                paths.append(write(mold, out / f"{part}.{kind}", part=part))
    return [*paths, *write_gcode(mold, out)]
