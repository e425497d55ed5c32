"""Surfaces of the robot as triangles: tubes, plate, arrows.

The number of vertices does not change with the shape, so that a motion sends coordinates and nothing else.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...equilibrium.result import Equilibrium
from ...typing import Array
from ..plots.mesh import Centreline
from ..plots.shape import exposed, plate_radius
from ..plots.style import tube_colour
from ..slots import shade, slotted
from ..surfaces import Surface, axes_about, grid_faces, join

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


def arrow_surface(start: Array, end: Array) -> Surface:
    """An arrow from one place to another."""
    length = float(np.linalg.norm(end - start))
    shaft, head, tall = 0.015 * length, 0.05 * length, 0.8 * length
    profile = [(0.0, length), (head, tall), (head, tall), (shaft, tall), (shaft, 0.0), (shaft, 0.0), (0.0, 0.0)]
    body = _revolved(np.array(profile))
    return Surface(start + body.vertices @ axes_about((end - start) / length), body.faces)


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
