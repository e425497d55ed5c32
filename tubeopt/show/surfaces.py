"""Surfaces as triangles, of bodies and arms; the arm in one pose for other programs (STL, GLB, URDF, MJCF)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from ..arguments import typed
from ..bodies.anatomy import TransformedBody
from ..bodies.corridors import Corridor, MeshObstacle
from ..bodies.distance_field import DistanceField, surface_net
from ..bodies.obstacles import Box, Capsule, HalfSpace, Obstacle, Sphere
from ..equilibrium.arm_surface import outer_radius
from ..equilibrium.result import Equilibrium
from ..errors import InputError, import_extra
from ..files.files import atomic_write
from ..files.units import TO_MM
from ..robots.pieces import Series, extremes
from ..robots.tubes import Tube, stretches
from ..typing import Array
from .page import Colour, rgb, tube_colour

Faces = NDArray[np.uint32]

SIDES = 32
"""Facets around a round body."""


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles with shared vertices."""

    vertices: Array
    """(v, 3) vertices, m."""
    faces: Faces
    """(f, 3): corners of every triangle, counter-clockwise from outside."""


@lru_cache(maxsize=64)
def grid_faces(rows: int, columns: int) -> Faces:
    """Triangles between neighbours of a closed grid of vertices, two for four corners.

    The last column is next to the first.
    """
    # Vertex (k, j) has the number k columns + j. Modulo closes each ring, so that no seam is left open.
    k, j = np.meshgrid(np.arange(rows - 1), np.arange(columns), indexing="ij")
    ahead = (j + 1) % columns
    return two_of_four(
        np.stack([k * columns + j, k * columns + ahead, (k + 1) * columns + ahead, (k + 1) * columns + j], axis=-1)
    )


def two_of_four(corners: NDArray[np.integer]) -> Faces:
    """(2k, 3) triangles, two of each facet of four corners (..., 4)."""
    return corners[..., [0, 1, 2, 0, 2, 3]].reshape(-1, 3).astype(np.uint32)


def join(surfaces: list[Surface]) -> Surface:
    """Surface of several surfaces."""
    start = np.cumsum([0] + [len(each.vertices) for each in surfaces])
    faces = [each.faces + np.uint32(first) for each, first in zip(surfaces, start, strict=False)]
    return Surface(np.concatenate([each.vertices for each in surfaces]), np.concatenate(faces))


def obstacle_surface(obstacle: Obstacle, reach: float, *, sides: int = SIDES) -> Surface:
    """Surface of a body as triangles.

    Of an unbounded body it is the part within `reach` (m) of the plate; of a vessel, its wall.

    Raises:
        InputError: a body of unknown kind.
    """
    if isinstance(obstacle, Sphere):
        return swept(np.array([obstacle.centre, obstacle.centre]), np.full(2, obstacle.radius), sides=sides)
    if isinstance(obstacle, Capsule):
        return swept(np.array([obstacle.start, obstacle.end]), np.full(2, obstacle.radius), sides=sides)
    if isinstance(obstacle, Box):
        return _box(np.array(obstacle.low), np.array(obstacle.high))
    if isinstance(obstacle, HalfSpace):
        return _plane(np.array(obstacle.point), np.array(obstacle.normal), reach)
    if isinstance(obstacle, Corridor):
        line, radii = np.array(obstacle.centreline), obstacle.radii
        return join([swept(line[k : k + 2], radii[k : k + 2], sides=sides) for k in range(len(line) - 1)])
    if isinstance(obstacle, MeshObstacle):
        return Surface(np.array(obstacle.vertices), np.array(obstacle.faces, dtype=np.uint32))
    if isinstance(obstacle, DistanceField):
        vertices, faces = surface_net(obstacle)
        return Surface(vertices, two_of_four(faces))
    if isinstance(obstacle, TransformedBody):
        inner = obstacle_surface(obstacle.body, reach, sides=sides)
        return Surface(obstacle.frame.seen(inner.vertices), inner.faces)
    raise InputError(f"there is no picture of a {type(obstacle).__name__}")


def swept(line: Array, radii: Array, *, sides: int = SIDES, capped: bool = True) -> Surface:
    """Surface around a polyline (k, 3) at distances (k,), m, with half balls at its ends if `capped`."""
    step = np.diff(line, axis=0)
    length = np.linalg.norm(step, axis=1)[:, None]
    # A sphere is a line of length zero: any direction serves, and z avoids a division by 0.
    along = np.where(length > 0, step / np.where(length > 0, length, 1.0), [0.0, 0.0, 1.0])
    # The ring at a corner lies in the plane that halves the angle between both segments.
    middle = along[:-1] + along[1:]
    # At a reversal by 180 deg both cancel; the bound leaves a zero vector, not NaN.
    middle /= np.maximum(np.linalg.norm(middle, axis=1)[:, None], 1e-12)
    rings = list(zip(line, [along[0], *middle, along[-1]], radii, strict=True))
    if capped:
        # A quarter of the facets around covers a quarter of a circle: facets of balls are about square.
        lifts = np.linspace(0.0, np.pi / 2, sides // 4 + 1)
        front = [(line[0] - radii[0] * np.sin(x) * along[0], along[0], radii[0] * np.cos(x)) for x in lifts[:0:-1]]
        back = [(line[-1] + radii[-1] * np.sin(x) * along[-1], along[-1], radii[-1] * np.cos(x)) for x in lifts[1:]]
        rings = [*front, *rings, *back]
    angle = np.arange(sides) * 2 * np.pi / sides
    across, vertices = axes_about(along[0])[0], []
    for centre, normal, radius in rings:
        # The direction to the first vertex is projected from ring to ring, a discrete parallel transport.
        # A frame made anew at each ring could jump, and the facets between would be twisted.
        across = across - (across @ normal) * normal
        across = across / max(float(np.linalg.norm(across)), 1e-12)
        around = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * np.cross(normal, across)
        vertices.append(centre + radius * around)
    return Surface(np.concatenate(vertices), grid_faces(len(rings), sides))


def revolved(profile: Array, *, sides: int = SIDES) -> Surface:
    """A body of revolution about z: radius and height (k, 2), from the top down along the outside."""
    angle = -np.arange(sides) * 2 * np.pi / sides
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(sides)])
    # (k, sides, 3): radius times the unit ring, plus height along z. The angle falls, so that facets face outwards.
    vertices = profile[:, 0, None, None] * ring + profile[:, 1, None, None] * np.array([0.0, 0.0, 1.0])
    return Surface(vertices.reshape(-1, 3), grid_faces(len(profile), sides))


def _box(low: Array, high: Array) -> Surface:
    corner = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    # Corners are not shared between sides, so that edges stay sharp.
    vertices = np.concatenate([corner[list(side)] for side in sides])
    return Surface(low + vertices * (high - low), two_of_four(np.arange(24).reshape(6, 4)))


def _plane(point: Array, normal: Array, reach: float) -> Surface:
    x, y, z = axes_about(normal / np.linalg.norm(normal))
    foot = z * float(point @ z)
    corners = [foot + reach * (a * x + b * y) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    # Both sides, since a viewer may stand on either.
    faces = np.array([[0, 1, 2], [0, 2, 3], [2, 1, 0], [3, 2, 0]], dtype=np.uint32)
    return Surface(np.array(corners), faces)


def axes_about(z: Array) -> Array:
    """(3, 3) rows of a right-handed frame with `z` as the third axis."""
    # The coordinate axis farthest from z: the cross product is at least sqrt(2/3) long, so no digits are lost.
    x = np.cross(np.eye(3)[int(np.argmin(np.abs(z)))], z)
    x /= np.linalg.norm(x)
    return np.array([x, np.cross(z, x), z])


RIM = 0.55
"""Fraction of white in the colour of the wall where a tube is cut."""

DARKEST = 0.45
"""Brightness factor of a tube without any remaining stiffness."""

PLATE_COLOUR: Colour = (204, 209, 217)
BORE_COLOUR: Colour = (33, 33, 33)
SHEATH_COLOUR: Colour = (158, 173, 194)
SHEATH_OPACITY = 0.22


class RingSection(NamedTuple):
    """Directions (k, 3) of the axes of cross-sections of the arm."""

    x: Array
    y: Array
    tangent: Array


class SampledCentreline:
    """Centreline of an equilibrium as a cubic curve through its points and tangents."""

    def __init__(self, equilibrium: Equilibrium) -> None:
        # A breakpoint is in the answer twice, once for each section; splines need increasing arc lengths.
        s, first = np.unique(equilibrium.arc_length, return_index=True)
        self.length = float(s[-1])
        frame, position = equilibrium.frame[first], equilibrium.position[first]
        if len(s) < 2:  # an arm of length zero: the tangent at the plate, of any length
            s, frame, position = np.array([0.0, 1.0]), np.repeat(frame, 2, axis=0), np.array([[0, 0, 0], [0, 0, 1.0]])
        # The third column of a frame is the tangent r'(s): its data make the cubic of order h^4.
        self._position = scipy.interpolate.CubicHermiteSpline(s, position, frame[:, :, 2])
        # Linear is enough across the arm: `axes` projects and normalises it, and the error is a turn about the tangent.
        self._across = scipy.interpolate.interp1d(s, frame[:, :, 0], axis=0)

    def position(self, s: ArrayLike) -> Array:
        """(k, 3) points at arc lengths `s` (k,), m."""
        points: Array = self._position(np.clip(s, 0, self.length))
        return points

    def axes(self, s: Array) -> RingSection:
        """The cross-sections at arc lengths `s` (k,), m."""
        s = np.clip(s, 0, self.length)
        # Between points |r'| of the cubic is 1 only to O(h^3).
        tangent = _unit(self._position.derivative()(s))
        across = self._across(s)
        # One step of Gram and Schmidt keeps the section square to the tangent.
        across = _unit(across - (across * tangent).sum(1, keepdims=True) * tangent)
        return RingSection(across, np.cross(tangent, across), tangent)

    def ring(self, s: Array, sides: int) -> tuple[Array, Array]:
        """Unit vectors around the line at `s` (k,), (k, sides, 3), and the two axes of the section, (k, 2, 3)."""
        x, y, _ = self.axes(s)
        angle = np.arange(sides) * 2 * np.pi / sides
        return np.cos(angle)[:, None] * x[:, None] + np.sin(angle)[:, None] * y[:, None], np.stack([x, y], axis=1)


def _unit(vectors: Array) -> Array:
    unit: Array = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    return unit


class TubeSurface(NamedTuple):
    """Visible stretch of a tube."""

    tube: int
    """Index of the tube."""
    start: float
    """First arc length, m."""
    end: float
    """Last arc length, m."""
    radius: float
    """Outer radius, m."""
    offset: Array
    """(2,) position of its axis in the cross-section of the arm, m."""


def visible(equilibrium: Equilibrium) -> list[TubeSurface]:
    """Visible stretches of tubes, outermost first, each from the end of the tubes around it to its own end."""
    axes = equilibrium.robot.axes
    shown = []
    # Tubes are numbered from the innermost, so those with larger index can be around this one.
    for i, end in reversed(list(enumerate(equilibrium.tube_end.tolist()))):
        # Side by side, tubes have other axes and hide nothing of each other; 1 nm is below any real offset.
        around = np.hypot(*(axes[i + 1 :] - axes[i]).T) < 1e-9
        # Where all tubes around end behind the plate, the tube shows from the plate on (0).
        start = float(equilibrium.tube_end[i + 1 :].max(where=around, initial=0.0))
        if end > start:
            shown.append(TubeSurface(i, start, end, equilibrium.robot.tubes[i].outer_diameter / 2, axes[i]))
    return shown


class SlottedStretch(NamedTuple):
    """Stretch of a tube with a constant remaining stiffness."""

    start: float
    """First arc length, m."""
    end: float
    """Last arc length, m."""
    stiffness: float
    """Bending stiffness over the stiffness of the whole tube, at most 1."""


def slotted(tube: Tube, held: float, first: float, last: float) -> list[SlottedStretch]:
    """Stretches of a tube between arc lengths `first` and `last`, m, with their remaining bending stiffness.

    held: distance of its clamped end behind the plate, m.
    """
    # Arc length is counted from the plate, and the proximal end is `held` behind it.
    stiffness_of_tube, start = float(tube.bending_stiffness), -held
    out: list[SlottedStretch] = []
    for length, _, bending, _ in stretches(tube):
        low, high = max(start, first), min(start + length, last)
        # Of a stiffness that varies, the least: the colour warns of the weakest point.
        smallest = extremes([bending], length)[0] if isinstance(bending, Series) else float(bending)
        stiffness = min(smallest / stiffness_of_tube, 1.0)
        if high > low:
            # Adjacent stretches of one shade are one surface: fewer parts, and no ring between them.
            if out and out[-1].stiffness == stiffness:
                out[-1] = out[-1]._replace(end=high)
            else:
                out.append(SlottedStretch(low, high, stiffness))
        start += length
    return out


def shade(part: float) -> float:
    """Brightness factor for a remaining fraction of the bending stiffness; 1 for the whole stiffness."""
    return DARKEST + (1 - DARKEST) * part


@dataclass(frozen=True)
class TubeGroup:
    """Tubes side by side, visible between common arc lengths."""

    tubes: tuple[int, ...]
    """Indices of the tubes, from 0."""
    start: float
    """First arc length, m."""
    end: float
    """Last arc length, m."""
    radius: float
    """Radius around all tubes, m."""


def tube_groups(equilibrium: Equilibrium) -> list[TubeGroup]:
    """Visible tubes: all tubes of a segment together, tubes of a concentric robot separately."""
    groups: dict[tuple[float, float], list[int]] = {}
    for each in visible(equilibrium):
        groups.setdefault((each.start, each.end), []).append(each.tube)
    radius = outer_radius(equilibrium.robot)
    return [
        TubeGroup(tuple(sorted(tubes)), start, end, float(radius[tubes].max()))
        for (start, end), tubes in groups.items()
    ]


@dataclass(frozen=True, eq=False)
class Part:
    """Surface with its appearance."""

    name: str
    """Name in a scene."""
    surface: Surface
    """Facets of the surface, m."""
    colour: Colour
    """Red, green, blue, 0 to 255."""
    opacity: float = 1.0
    """Opacity from 0 to 1; 1 hides everything behind."""
    lift: float = 0.0
    """Shift along the normal for sorting by depth, m: an outer surface stays in front of one that it touches."""


def _mixed(colour: Colour, background: float, part: float) -> Colour:
    """Colour mixed with a part of a grey."""
    red, green, blue = (round((1 - part) * c + part * background) for c in colour)
    return red, green, blue


class Detail(NamedTuple):
    """Number of facets of an arm."""

    sides: int = 20
    """Number of facets around a tube."""
    pieces: int = 72
    """Number of facets along a tube; along the whole arm if `even`."""
    even: bool = False

    def along(self, start: float, end: float, length: float) -> Array:
        """(k,) arc lengths on a stretch, with both of its ends."""
        pieces = 1 + int(self.pieces * (end - start) / length) if self.even else self.pieces
        return np.linspace(start, end, pieces + 1)


MOVING = Detail()
"""Detail of a moving robot."""


def robot_parts(
    equilibrium: Equilibrium, detail: Detail = MOVING, window: tuple[float, float] | None = None
) -> list[Part]:
    """Parts of an arm to scale: visible tubes with the rims of their walls and their bores, and sheaths.

    Tubes are darker where slots have made them softer.

    Args:
        window: arc lengths, m, between which parts are made; None: the whole arm.
    """
    shown = visible(equilibrium)
    if not shown:
        return []
    line = SampledCentreline(equilibrium)
    robot = equilibrium.robot
    low, high = (0.0, line.length) if window is None else (max(window[0], 0.0), min(window[1], line.length))
    parts: list[Part] = []
    for each in shown:
        tube, colour = robot.tubes[each.tube], rgb(tube_colour(each.tube))
        held = tube.straight_length - float(equilibrium.translations[each.tube])
        first, last = max(each.start, low), min(each.end, high)
        for k, (start, end, stiffness) in enumerate(slotted(tube, held, first, last)):
            name = f"tube_{each.tube + 1}" + f"_{k + 1}" * bool(k)
            # Rings are distributed over the shown length: a close-up has as many as a whole arm.
            s = detail.along(start, end, high - low)
            surface = tube_surface(line, s, each.radius, each.offset, sides=detail.sides)
            parts.append(Part(name, surface, _mixed(colour, 0.0, 1 - shade(stiffness))))
    # Ends outside of a window are not seen: a rim there would float in front of nothing.
    cut = [each for each in shown if low <= each.end <= high]
    bores: list[Surface] = []
    for each in cut:
        inner, colour = robot.tubes[each.tube].inner_diameter / 2, rgb(tube_colour(each.tube))
        rim = ring_surface(line, each.end, (inner, each.radius), each.offset, sides=detail.sides)
        parts.append(Part(f"rim_{each.tube + 1}", rim, _mixed(colour, 255.0, RIM)))
        bores.append(ring_surface(line, each.end, (0.0, inner), each.offset, sides=detail.sides))
    parts += [Part("bores", join(bores), BORE_COLOUR)] if bores else []
    return parts + (list(_sheaths(equilibrium, line, detail, (low, high))) if robot.axes.any() else [])


def _sheaths(
    equilibrium: Equilibrium, line: SampledCentreline, detail: Detail, window: tuple[float, float]
) -> Iterator[Part]:
    """Sheaths of the segments, as wide as the tubes in them need."""
    for k, bundle in enumerate(tube_groups(equilibrium), start=1):
        first, last = max(bundle.start, window[0]), min(bundle.end, window[1])
        if last > first:
            s = detail.along(first, last, window[1] - window[0])
            surface = tube_surface(line, s, bundle.radius, np.zeros(2), sides=2 * detail.sides)
            yield Part(f"sheath_{k}", surface, SHEATH_COLOUR, SHEATH_OPACITY, bundle.radius)


def tube_surface(line: SampledCentreline, s: Array, radius: float, offset: Array, *, sides: int) -> Surface:
    """A tube along `line` between arc lengths `s` (k,), its axis at `offset` (2,) in the cross-section, m."""
    around, section = line.ring(s, sides)
    axis = line.position(s) + offset @ section
    return Surface((axis[:, None] + radius * around).reshape(-1, 3), grid_faces(len(s), sides))


def ring_surface(
    line: SampledCentreline, s: float, radii: tuple[float, float], offset: Array, *, sides: int
) -> Surface:
    """A flat ring across `line` at arc length `s`, from the inner to the outer of `radii`, facing the tip."""
    around, section = line.ring(np.array([s]), sides)
    centre = line.position([s]) + offset @ section
    # From the outer edge to the inner one, so that it faces along the line.
    corners = np.concatenate([centre + radius * around[0] for radius in reversed(radii)])
    return Surface(corners, grid_faces(2, sides))


def plate_radius(equilibrium: Equilibrium) -> float:
    """Radius of the drawn base plate, m: in proportion to the arm, and well beyond its tubes."""
    # With all tubes withdrawn the arm is short, and 7 % of it could be thinner than a tube.
    thickest = max(tube.outer_diameter for tube in equilibrium.robot.tubes)
    return max(0.07 * float(equilibrium.arc_length[-1]), 4 * thickest)


def plate_part(radius: float, *, rings: int = 1, sides: int = 64) -> Part:
    """Base plate with its upper face at z = 0; cut into rings for sorting by depth."""
    # Painters sort facets by the depth of their middle: large facets of one ring would hide what is in front.
    radii, low = np.linspace(0.0, radius, rings + 1), -0.25 * radius
    profile = [(r, 0.0) for r in radii] + [(radius, 0.0), (radius, low)] + [(r, low) for r in radii[::-1]]
    return Part("plate", revolved(np.array(profile), sides=sides), PLATE_COLOUR)


TUBE_FACETS = 48
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


def closed_surface(line: SampledCentreline, stretch: TubeSurface) -> Surface:
    """Surface of a tube as a solid: its outside, closed by a disc at either end."""
    # Two rings at least: a stretch below STEP is one row of facets.
    count = 2 + int((stretch.end - stretch.start) / STEP)
    side = tube_surface(
        line, np.linspace(stretch.start, stretch.end, count), stretch.radius, stretch.offset, sides=TUBE_FACETS
    )
    rings = side.vertices.reshape(count, TUBE_FACETS, 3)
    corner, ahead = np.arange(TUBE_FACETS), (np.arange(TUBE_FACETS) + 1) % TUBE_FACETS
    first, last = len(side.vertices), len(side.vertices) + 1
    far = (count - 1) * TUBE_FACETS
    # Opposite orders at both ends: each disc faces away from the tube, as a watertight body needs.
    discs = [(np.full(TUBE_FACETS, first), ahead, corner), (np.full(TUBE_FACETS, last), far + corner, far + ahead)]
    faces = np.concatenate([side.faces, *(np.column_stack(disc) for disc in discs)]).astype(np.uint32)
    return Surface(np.concatenate([side.vertices, rings[[0, -1]].mean(1)]), faces)


def _write_mesh(kind: str, scale: float) -> Callable[[Equilibrium, Path], None]:
    def write(equilibrium: Equilibrium, path: Path) -> None:
        library = import_extra("trimesh", "fabrication", "STL and GLB files")
        line, scene = SampledCentreline(equilibrium), library.Scene()
        for stretch in visible(equilibrium):
            surface = closed_surface(line, stretch)
            # Processing would merge vertices and renumber facets.
            body = library.Trimesh(surface.vertices * scale, surface.faces, process=False)
            body.visual.face_colors = [*rgb(tube_colour(stretch.tube)), 255]
            scene.add_geometry(body, node_name=f"tube_{stretch.tube + 1}", geom_name=f"tube_{stretch.tube + 1}")
        path.write_bytes(scene.export(file_type=kind))

    return write


class SurfacePiece(NamedTuple):
    """A straight piece of a tube: ends (3,), m, frame (3, 3) with the third axis along it, and radius, m."""

    tube: int
    start: Array
    end: Array
    frame: Array
    radius: float


def pieces(equilibrium: Equilibrium) -> Iterator[SurfacePiece]:
    """Arm as straight pieces with ends on the axes of the tubes."""
    line = SampledCentreline(equilibrium)
    # A straight arm has curvature 0; 1e-9 per m then gives one piece.
    tightest = max(float(np.linalg.norm(equilibrium.curvature, axis=1).max()), 1e-9)
    for stretch in visible(equilibrium):
        length = stretch.end - stretch.start
        # A chord h of an arc with curvature k has the sagitta k h^2 / 8, which must not exceed CHORD.
        s = np.linspace(stretch.start, stretch.end, 1 + max(1, int(np.ceil(length / np.sqrt(8 * CHORD / tightest)))))
        x, y, _ = line.axes(s)
        points = line.position(s) + stretch.offset[0] * x + stretch.offset[1] * y
        for k in range(len(s) - 1):
            along = (points[k + 1] - points[k]) / np.linalg.norm(points[k + 1] - points[k])
            # The chord is not quite the tangent, so the section axis loses its part along it.
            across = x[k] - (x[k] @ along) * along
            across /= np.linalg.norm(across)
            frame = np.column_stack([across, np.cross(along, across), along])
            yield SurfacePiece(stretch.tube + 1, points[k], points[k + 1], frame, stretch.radius)


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
    # SciPy has the scalar of a quaternion last, MuJoCo first.
    x, y, z, w = Rotation.from_matrix(equilibrium.tip_rotation).as_quat()
    SubElement(arm, "site", name="tip", pos=_numbers(equilibrium.tip_position), quat=_numbers([w, x, y, z]))
    _write_xml(model, path)


def _place(parent: Element, position: Array, frame: Array) -> None:
    """Add the origin element of a part; URDF rotates about the fixed axes x, y and z in this order."""
    turns = Rotation.from_matrix(frame).as_euler("xyz")
    SubElement(parent, "origin", xyz=_numbers(position), rpy=_numbers(turns))


def _name(equilibrium: Equilibrium) -> str:
    return (equilibrium.robot.name or "robot").replace(" ", "_")


def _numbers(values: Any) -> str:
    # Adding 0.0 turns -0 into 0. Nine digits keep 1 nm at an arm of 1 m.
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
"""Suffix of a file -> function that writes it."""
