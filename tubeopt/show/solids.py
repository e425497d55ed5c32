"""The arm in one pose for other programs: closed surfaces (STL, GLB) and rigid bodies (URDF, MJCF).

All stand in the frame of the base plate, in metres but for STL, which workshops read in mm. A tube is there from where
it comes out of the next one to its own end, as solid as its outside; sheaths of eccentric robots are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from scipy.spatial.transform import Rotation

from ..arguments import typed
from ..equilibrium.result import Equilibrium
from ..errors import InputError, extra
from ..files.files import atomic_write
from ..files.units import TO_MM
from ..typing import Array
from .page import rgb, tube_colour
from .surfaces import Centreline, Stretch, Surface, tube_surface, visible

SIDES = 48
"""Facets around a tube: its volume is 0.3 % small."""

STEP = 5e-4
"""Length of a facet along a tube, m."""

CHORD = 2e-5
"""Straight pieces of a rigid body leave the axis of their tube by at most this much, m."""


@typed
def save_solid(equilibrium: Equilibrium, path: str | PathLike[str]) -> Path:
    """Path of a file with the arm in its pose; the file is written completely or not at all.

    Args:
        path: file; its ending selects the format. Surfaces with a part per tube: .stl (mm), .glb. Cylinders and
            capsules along the arm, fixed to each other, with a frame at the tip: .urdf, .xml (MJCF of MuJoCo).

    Raises:
        InputError: another ending, an arm of length zero, a file that cannot be written, or, for surfaces, trimesh is
            not installed.

    Examples:
        >>> import tempfile
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/two_tube.yaml")
        >>> pose = tubeopt.forward_kinematics(robot, [0.5, 0.0])
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     tubeopt.save_solid(pose, f"{folder}/arm.urdf").name
        'arm.urdf'
    """
    path = Path(path)
    write = WRITERS.get(path.suffix.lower())
    if write is None:
        raise InputError(f"the name of the solid is {str(path)!r}; it must end in {', '.join(WRITERS)}")
    if len(equilibrium.arc_length) < 2:
        raise InputError("no tube is in front of the base plate: there is no arm surface to save")
    with atomic_write(path) as temporary:
        write(equilibrium, temporary)
    return path


def closed_surface(line: Centreline, stretch: Stretch) -> Surface:
    """A tube as a solid: its outside, closed by a disc at either end."""
    count = 2 + int((stretch.end - stretch.start) / STEP)
    side = tube_surface(
        line, np.linspace(stretch.start, stretch.end, count), stretch.radius, stretch.offset, sides=SIDES
    )
    rings = side.vertices.reshape(count, SIDES, 3)
    here, ahead = np.arange(SIDES), (np.arange(SIDES) + 1) % SIDES
    first, last = len(side.vertices), len(side.vertices) + 1
    far = (count - 1) * SIDES
    discs = [(np.full(SIDES, first), ahead, here), (np.full(SIDES, last), far + here, far + ahead)]
    faces = np.concatenate([side.faces, *(np.column_stack(disc) for disc in discs)]).astype(np.uint32)
    return Surface(np.concatenate([side.vertices, rings[[0, -1]].mean(1)]), faces)


def _write_mesh(kind: str, scale: float) -> Callable[[Equilibrium, Path], None]:
    def write(equilibrium: Equilibrium, path: Path) -> None:
        library = extra("trimesh", "fabrication", "STL and GLB files")
        line, scene = Centreline(equilibrium), library.Scene()
        for stretch in visible(equilibrium):
            surface = closed_surface(line, stretch)
            body = library.Trimesh(surface.vertices * scale, surface.faces, process=False)
            body.visual.face_colors = [*rgb(tube_colour(stretch.tube)), 255]
            scene.add_geometry(body, node_name=f"tube_{stretch.tube + 1}", geom_name=f"tube_{stretch.tube + 1}")
        path.write_bytes(scene.export(file_type=kind))

    return write


class Piece(NamedTuple):
    """A straight piece of a tube: ends (3,), m, frame (3, 3) with the third axis along it, and radius, m."""

    tube: int
    start: Array
    end: Array
    frame: Array
    radius: float


def pieces(equilibrium: Equilibrium) -> Iterator[Piece]:
    """The arm as straight pieces, whose ends lie on the axes of the tubes."""
    line = Centreline(equilibrium)
    tightest = max(float(np.linalg.norm(equilibrium.curvature, axis=1).max()), 1e-9)
    for stretch in visible(equilibrium):
        length = stretch.end - stretch.start
        s = np.linspace(stretch.start, stretch.end, 1 + max(1, int(np.ceil(length / np.sqrt(8 * CHORD / tightest)))))
        x, y, _ = line.axes(s)
        points = line.position(s) + stretch.offset[0] * x + stretch.offset[1] * y
        for k in range(len(s) - 1):
            along = (points[k + 1] - points[k]) / np.linalg.norm(points[k + 1] - points[k])
            across = x[k] - (x[k] @ along) * along
            across /= np.linalg.norm(across)
            frame = np.column_stack([across, np.cross(along, across), along])
            yield Piece(stretch.tube + 1, points[k], points[k + 1], frame, stretch.radius)


def _write_urdf(equilibrium: Equilibrium, path: Path) -> None:
    robot = Element("robot", name=_name(equilibrium))
    arm = SubElement(robot, "link", name="plate")
    for piece in pieces(equilibrium):
        for purpose in ("visual", "collision"):
            part = SubElement(arm, purpose)
            _place(part, (piece.start + piece.end) / 2, piece.frame)
            length = _numbers([np.linalg.norm(piece.end - piece.start)])
            SubElement(SubElement(part, "geometry"), "cylinder", radius=_numbers([piece.radius]), length=length)
            if purpose == "visual":
                colour = SubElement(SubElement(part, "material", name=f"tube_{piece.tube}"), "color")
                colour.set("rgba", _colour(piece.tube))
    SubElement(robot, "link", name="tip")
    joint = SubElement(robot, "joint", name="pose", type="fixed")
    SubElement(joint, "parent", link="plate")
    SubElement(joint, "child", link="tip")
    _place(joint, equilibrium.tip_position, equilibrium.tip_rotation)
    _write_xml(robot, path)


def _write_mjcf(equilibrium: Equilibrium, path: Path) -> None:
    model = Element("mujoco", model=_name(equilibrium))
    arm = SubElement(SubElement(model, "worldbody"), "body", name="plate")
    for k, piece in enumerate(pieces(equilibrium), start=1):
        ends = _numbers([*piece.start, *piece.end])
        SubElement(
            arm, "geom", name=f"tube_{piece.tube}_{k}", type="capsule", fromto=ends, size=_numbers([piece.radius]),
            rgba=_colour(piece.tube),
        )  # fmt: skip
    x, y, z, w = Rotation.from_matrix(equilibrium.tip_rotation).as_quat()
    SubElement(arm, "site", name="tip", pos=_numbers(equilibrium.tip_position), quat=_numbers([w, x, y, z]))
    _write_xml(model, path)


def _place(parent: Element, position: Array, frame: Array) -> None:
    """The origin of a part: URDF turns about the fixed axes x, y and z in this order."""
    turns = Rotation.from_matrix(frame).as_euler("xyz")
    SubElement(parent, "origin", xyz=_numbers(position), rpy=_numbers(turns))


def _name(equilibrium: Equilibrium) -> str:
    return (equilibrium.robot.name or "robot").replace(" ", "_")


def _numbers(values: Any) -> str:
    return " ".join(f"{value + 0.0:.9g}" for value in values)


def _colour(tube: int) -> str:
    return _numbers([*(part / 255 for part in rgb(tube_colour(tube - 1))), 1.0])


def _write_xml(root: Element, path: Path) -> None:
    ElementTree.indent(root)
    ElementTree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)


WRITERS: dict[str, Callable[[Equilibrium, Path], None]] = {
    ".stl": _write_mesh("stl", TO_MM),
    ".glb": _write_mesh("glb", 1.0),
    ".urdf": _write_urdf,
    ".xml": _write_mjcf,
}
"""Ending of a file -> what writes it."""
