"""Surfaces as triangles with shared vertices, which is what graphics hardware wants: tubes, plate, bodies.

The number of vertices does not change with the shape, so that a motion sends coordinates and nothing else.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ...bodies.corridors import Corridor, MeshObstacle
from ...bodies.distance_field import DistanceField
from ...bodies.obstacles import Box, Capsule, HalfSpace, Obstacle, Sphere
from ...bodies.surface_net import surface_net
from ...equilibrium.result import Equilibrium
from ...errors import InputError
from ...typing import Array
from ..plots.mesh import Centreline
from ..plots.shape import exposed, plate_radius
from ..plots.style import tube_colour
from ..slots import shade, slotted

Faces = NDArray[np.uint32]
Colour = tuple[int, int, int]

SIDES = 20
"""Facets around a tube."""

PIECES = 72
"""Facets along what shows of a tube."""

RIM_COLOUR = 0.55
"""How much lighter the wall is where a tube is cut."""

PLATE_COLOUR: Colour = (198, 203, 211)
BORE_COLOUR: Colour = (30, 30, 30)
SHEATH_COLOUR: Colour = (158, 173, 194)
SHEATH_OPACITY = 0.22


@dataclass(frozen=True, eq=False)
class Surface:
    """Vertices (v, 3) m and triangles (f, 3) by their corners, counter-clockwise from outside."""

    vertices: Array
    faces: Faces


@dataclass(frozen=True, eq=False)
class Part:
    """A surface with a name, a colour and an opacity."""

    name: str
    surface: Surface
    colour: Colour
    opacity: float = 1.0


def rgb(colour: str) -> Colour:
    """#RRGGBB as three numbers from 0 to 255."""
    red, green, blue = (int(colour[k : k + 2], 16) for k in (1, 3, 5))
    return red, green, blue


def margin_colour(margin: float) -> Colour:
    """Green at margin 1, yellow in between, red at 0 and below."""
    part = min(max(float(margin), 0.0), 1.0)
    stops = np.array([[200, 30, 30], [235, 190, 40], [0, 150, 90]], dtype=float)
    mixed = (
        stops[0] + 2 * part * (stops[1] - stops[0]) if part < 0.5 else stops[1] + (2 * part - 1) * (stops[2] - stops[1])
    )
    red, green, blue = (round(x) for x in mixed)
    return red, green, blue


def robot_parts(equilibrium: Equilibrium) -> list[Part]:
    """All tubes of true diameter, each where it shows, darker where slots have made it softer, with the rim of its wall
    and its bore; sheaths around groups."""
    shown = exposed(equilibrium)
    if not shown:
        return []
    line = Centreline(equilibrium)
    assembly = equilibrium.robot.assembly(equilibrium.translations)
    parts, bores = [], []
    for i, start, end in shown:
        tube = equilibrium.robot.tubes[i]
        outer, inner = tube.outer_diameter / 2, tube.inner_diameter / 2
        angle = float(assembly.offset_angle[i])
        offset = float(assembly.offset[i]) * np.array([np.cos(angle), np.sin(angle)])
        colour = rgb(tube_colour(i))
        for k, (begin, stop, left) in enumerate(slotted(tube, float(assembly.transmission[i]), start, end)):
            s = np.linspace(begin, stop, PIECES + 1)
            red, green, blue = (round(shade(left) * c) for c in colour)
            name = f"tube_{i + 1}" + f"_{k + 1}" * bool(k)
            parts.append(Part(name, tube_surface(line, s, outer, offset), (red, green, blue)))
        rim = tuple(round((1 - RIM_COLOUR) * c + RIM_COLOUR * 255) for c in colour)
        parts.append(Part(f"rim_{i + 1}", ring_surface(line, end, (inner, outer), offset), (rim[0], rim[1], rim[2])))
        bores.append(ring_surface(line, end, (0.0, inner), offset))
    parts.append(Part("bores", join(bores), BORE_COLOUR))
    if assembly.eccentric:
        parts.append(Part("sheath", _sheath(equilibrium, line), SHEATH_COLOUR, SHEATH_OPACITY))
    return parts


def _sheath(equilibrium: Equilibrium, line: Centreline) -> Surface:
    """What holds the tubes side by side, as wide as they need, one piece per segment."""
    from ..plots.shape import bundles

    pieces = [
        tube_surface(line, np.linspace(each.start, each.end, PIECES + 1), each.radius, np.zeros(2), sides=2 * SIDES)
        for each in bundles(equilibrium)
    ]
    return join(pieces)


def tube_surface(line: Centreline, s: Array, radius: float, offset: Array, *, sides: int = SIDES) -> Surface:
    """A tube along `line` between arc lengths `s` (k,), its axis at `offset` (2,) in the cross-section, m."""
    x, y, _ = line.axes(s)
    angle = np.arange(sides) * 2 * np.pi / sides
    axis = line.position(s) + offset[0] * x + offset[1] * y
    around = np.cos(angle)[:, None] * x[:, None] + np.sin(angle)[:, None] * y[:, None]
    return Surface((axis[:, None] + radius * around).reshape(-1, 3), grid_faces(len(s), sides))


def ring_surface(
    line: Centreline, s: float, radii: tuple[float, float], offset: Array, *, sides: int = SIDES
) -> Surface:
    """A flat ring across `line` at arc length `s`, facing the tip."""
    x, y, _ = line.axes(np.array([s]))
    angle = np.arange(sides) * 2 * np.pi / sides
    outward = np.cos(angle)[:, None] * x + np.sin(angle)[:, None] * y
    centre = line.position([s]) + offset[0] * x + offset[1] * y
    # From the outer edge to the inner one, so that it faces the way the line goes.
    corners = np.stack([centre + radius * outward for radius in reversed(radii)])
    return Surface(corners.reshape(-1, 3), grid_faces(2, sides))


@lru_cache(maxsize=64)
def grid_faces(rows: int, columns: int, closed: bool = True) -> Faces:
    """Triangles between neighbours of a grid of vertices; `closed`, the last column is next to the first."""
    k, j = np.meshgrid(np.arange(rows - 1), np.arange(columns if closed else columns - 1), indexing="ij")
    ahead = (j + 1) % columns
    a, b, c, d = k * columns + j, k * columns + ahead, (k + 1) * columns + ahead, (k + 1) * columns + j
    faces = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], axis=2)
    return faces.reshape(-1, 3).astype(np.uint32)


def join(surfaces: list[Surface]) -> Surface:
    """All of them as one."""
    start = np.cumsum([0] + [len(each.vertices) for each in surfaces])
    faces = [each.faces + np.uint32(first) for each, first in zip(surfaces, start, strict=False)]
    return Surface(np.concatenate([each.vertices for each in surfaces]), np.concatenate(faces))


def plate_part(equilibrium: Equilibrium) -> Part:
    """The base plate, its upper face at z = 0."""
    radius = plate_radius(equilibrium)
    profile = [
        (0.0, 0.0),
        (radius, 0.0),
        (radius, 0.0),
        (radius, -0.25 * radius),
        (radius, -0.25 * radius),
        (0.0, -0.25 * radius),
    ]
    return Part("plate", _revolved(np.array(profile), sides=64), PLATE_COLOUR)


def _revolved(profile: Array, *, sides: int = 32) -> Surface:
    """A body of revolution about z: radius and height (k, 2), from the top down along the outside."""
    angle = np.arange(sides) * 2 * np.pi / sides
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(sides)])
    vertices = profile[:, 0, None, None] * ring + profile[:, 1, None, None] * np.array([0.0, 0.0, 1.0])
    faces = grid_faces(len(profile), sides)[:, ::-1]
    return Surface(vertices.reshape(-1, 3), faces)


def obstacle_surface(obstacle: Obstacle, reach: float) -> Surface:
    """A body as triangles; of one without end, what lies within `reach` (m) of the plate; of a vessel, its wall.

    Raises:
        InputError: a body of unknown kind.
    """
    if isinstance(obstacle, Sphere):
        return _capsule(np.array(obstacle.centre), np.array(obstacle.centre), obstacle.radius, obstacle.radius)
    if isinstance(obstacle, Capsule):
        return _capsule(np.array(obstacle.start), np.array(obstacle.end), obstacle.radius, obstacle.radius)
    if isinstance(obstacle, Box):
        return _box(np.array(obstacle.low), np.array(obstacle.high))
    if isinstance(obstacle, HalfSpace):
        return _plane(np.array(obstacle.point), np.array(obstacle.normal), reach)
    if isinstance(obstacle, Corridor):
        line, radii = np.array(obstacle.centreline), obstacle.radii.tolist()
        return join([_capsule(*each) for each in zip(line[:-1], line[1:], radii[:-1], radii[1:], strict=True)])
    if isinstance(obstacle, MeshObstacle):
        return Surface(np.array(obstacle.vertices), np.array(obstacle.faces, dtype=np.uint32))
    if isinstance(obstacle, DistanceField):
        vertices, faces = surface_net(obstacle)
        return Surface(vertices, faces[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3).astype(np.uint32))
    raise InputError(f"there is no picture of a {type(obstacle).__name__}")


def _capsule(start: Array, end: Array, radius: float, end_radius: float) -> Surface:
    length = float(np.linalg.norm(end - start))
    angle = np.linspace(0, np.pi / 2, 9)
    top = np.column_stack([end_radius * np.sin(angle), length + end_radius * np.cos(angle)])
    bottom = np.column_stack([radius * np.cos(angle), -radius * np.sin(angle)])
    body = _revolved(np.concatenate([top, bottom]))
    axes = _axes((end - start) / length if length else np.array([0.0, 0.0, 1.0]))
    return Surface(start + body.vertices @ axes, body.faces)


def arrow_surface(start: Array, end: Array) -> Surface:
    """An arrow from one place to another."""
    length = float(np.linalg.norm(end - start))
    shaft, head, tall = 0.015 * length, 0.05 * length, 0.8 * length
    profile = [(0.0, length), (head, tall), (head, tall), (shaft, tall), (shaft, 0.0), (shaft, 0.0), (0.0, 0.0)]
    body = _revolved(np.array(profile))
    return Surface(start + body.vertices @ _axes((end - start) / length), body.faces)


def _axes(z: Array) -> Array:
    """(3, 3) rows of a right-handed frame whose third axis is `z`."""
    x = np.cross(np.eye(3)[int(np.argmin(np.abs(z)))], z)
    x /= np.linalg.norm(x)
    return np.array([x, np.cross(z, x), z])


def _box(low: Array, high: Array) -> Surface:
    corner = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    # Corners are not shared between sides, so that edges stay sharp.
    vertices = np.concatenate([corner[list(side)] for side in sides])
    faces = np.array([[4 * k + a for a in triangle] for k in range(6) for triangle in ((0, 1, 2), (0, 2, 3))])
    return Surface(low + vertices * (high - low), faces.astype(np.uint32))


def _plane(point: Array, normal: Array, reach: float) -> Surface:
    x, y, z = _axes(normal / np.linalg.norm(normal))
    foot = z * float(point @ z)
    corners = [foot + reach * (a * x + b * y) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    faces = np.array([[0, 1, 2], [0, 2, 3], [2, 1, 0], [3, 2, 0]], dtype=np.uint32)
    return Surface(np.array(corners), faces)


def between(before: Equilibrium, after: Equilibrium, count: int) -> list[Equilibrium]:
    """Shapes between two of one robot at the same joint values, for a moving picture of a snap.

    Their curvature goes evenly from one to the other, and the arm keeps its length. They are no equilibria: how a snap
    runs in time is not in the model.
    """
    s = after.arc_length
    first = np.column_stack([np.interp(s, before.arc_length, u) for u in before.curvature.T])
    weights = ((1 - np.cos(np.pi * np.arange(count + 1) / count)) / 2)[:, None, None]
    u = (1 - weights) * first + weights * after.curvature
    h = np.diff(s)
    middle = (u[:, :-1] + u[:, 1:]) / 2 * h[:, None]
    frame = np.empty((count + 1, len(s), 3, 3))
    frame[:, 0] = after.frame[0]
    position = np.zeros((count + 1, len(s), 3))
    position[:, 0] = after.position[0]
    for k in range(len(h)):
        frame[:, k + 1] = frame[:, k] @ _rotation(middle[:, k])
        position[:, k + 1] = position[:, k] + h[k] * (frame[:, k, :, 2] + frame[:, k + 1, :, 2]) / 2
    # The few points integrate to within a per cent: what is missing at both ends is shared out between them.
    ends = Centreline(before).position(s), after.position
    position += (1 - weights) * (ends[0] - position[0]) + weights * (ends[1] - position[-1])
    return [replace(after, position=p, frame=f) for p, f in zip(position[1:-1], frame[1:-1], strict=True)]


def _rotation(turn: Array) -> Array:
    """(k, 3, 3) rotations about vectors (k, 2) in the cross-section, by Rodrigues' formula."""
    angle = np.linalg.norm(turn, axis=1)
    safe = np.where(angle > 0, angle, 1.0)
    x, y = (turn / safe[:, None]).T
    cosine, sine = np.cos(angle), np.sin(angle)
    one = 1 - cosine
    rows = [
        [cosine + x * x * one, x * y * one, y * sine],
        [x * y * one, cosine + y * y * one, -x * sine],
        [-y * sine, x * sine, cosine],
    ]
    return np.moveaxis(np.array(rows), 2, 0)
