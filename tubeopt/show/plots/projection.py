"""Stage for pictures in space: parallel projection at one scale, with a ruled floor and back walls in mm.

Plain axes of equal aspect are used instead of 3-D axes: lengths in a picture can be compared, and facets, shadows and
labels are drawn in any order.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ...bodies.frames import Frame
from ...files.units import TO_MM
from ...typing import Array, Mask
from ..page import SCALE, narrow
from ..surfaces import Part, Surface
from .labels import note
from .style import Axes, number

if TYPE_CHECKING:
    from matplotlib.collections import PolyCollection

RULE = "#DADDE1"
FLOOR = "#F6F7F8"


@dataclass(frozen=True)
class Projection:
    """Viewing direction of a scene: elevation above the plate and azimuth about its axis, deg."""

    elevation: float
    azimuth: float

    @property
    def axes(self) -> Array:
        """(3, 3) unit vectors to the right, upwards, and towards the viewer, as rows."""
        up, around = np.radians([self.elevation, self.azimuth])
        # The horizontal axis of the picture stays level, so that z is upright from every side.
        right = np.array([-np.sin(around), np.cos(around), 0.0])
        towards = np.array([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])
        # Rows of an orthonormal matrix: a product with it keeps lengths in all but the third coordinate.
        return np.array([right, np.cross(towards, right), towards])

    @property
    def towards_viewer(self) -> Array:
        """(3,) unit vector from the scene to the viewer."""
        return np.asarray(self.axes[2])

    @property
    def towards_light(self) -> Array:
        """(3,) unit vector towards the light: above the viewer's left shoulder."""
        # In the coordinates of the viewer: the light moves with him, and no side is ever dark.
        light = np.array([-0.5, 0.6, 0.62])
        return np.asarray(light / np.linalg.norm(light) @ self.axes)

    def project(self, points: Array) -> Array:
        """(..., 3) millimetres to the right, upwards and towards the viewer, of points (..., 3) in m."""
        projected: Array = points @ self.axes.T * TO_MM
        return projected


def widest_view(points: Array) -> Projection:
    """View with points (k, 3) spread to the right and a little forwards, off the axes of the plate."""
    # First right singular vector: the horizontal direction in which points lie farthest from the plate's axis.
    # Points are not centred, since the plate is in the picture too.
    _, _, directions = np.linalg.svd(points[:, :2])
    # The sign of a singular vector is arbitrary; here it points to where most of the arm is.
    along = directions[0] * (1.0 if np.sum(points[:, :2] @ directions[0]) >= 0 else -1.0)
    # At 90 deg the bend would lie in the plane of the picture; 60 deg brings it a little forwards.
    best = np.degrees(np.arctan2(along[1], along[0])) - 60.0
    # At multiples of 90 deg a wall would be seen edge-on; 30 and 60 deg show both walls.
    azimuths = np.array([quarter + offset for quarter in (-180, -90, 0, 90) for offset in (30, 60)])
    # The largest cosine is the nearest azimuth, whatever multiples of 360 deg lie between.
    return Projection(18.0, float(azimuths[np.argmax(np.cos(np.radians(azimuths - best)))]))


@dataclass(frozen=True, eq=False)
class SceneBox:
    """Ruled box around a scene: corners `low` and `high` (3,) and the distance of the rules `step`, mm."""

    low: Array
    high: Array
    step: float

    @classmethod
    def around(cls, points: Array) -> SceneBox:
        """Box around points (k, 3), m, with its sides on whole rules and its floor at the lowest point."""
        low, high = points.min(0) * TO_MM, points.max(0) * TO_MM
        step = rule_step(float((high - low).max()) * (2 if narrow() else 1))
        # Without the tolerance, round-off at a whole rule would add one more empty row of squares.
        lower, upper = np.floor(low / step + 1e-9) * step, np.ceil(high / step - 1e-9) * step
        # Shadows fall onto the floor: a floor below the lowest point would part them from the plate.
        lower[2] = low[2]
        return cls(lower, upper, step)

    def rules(self, axis: int) -> Array:
        """(k,) positions of the rules along `axis`, mm: multiples of `step`."""
        first, last = np.ceil(self.low[axis] / self.step - 1e-9), np.floor(self.high[axis] / self.step + 1e-9)
        return np.arange(first, last + 1) * self.step


def rule_step(span: float) -> float:
    """Round distance of rules that gives about four to ten of them on `span`."""
    return round_below(span / 4)


def round_below(value: float) -> float:
    """Largest of ..., 0.5, 1, 2, 5, 10, 20, ... that does not exceed a positive value."""
    # 1, 2 and 5 split a decade into about equal ratios.
    decade = 10.0 ** np.floor(np.log10(value))
    return float(max(step for step in (1, 2, 5) if step * decade <= value) * decade)


def draw_box(axes: Axes, box: SceneBox, view: Projection) -> None:
    """Draw the floor, the two walls behind the scene, their rules, and the scales along the front edges."""
    from matplotlib.collections import LineCollection, PolyCollection

    viewer = view.towards_viewer
    # Of two opposite walls, the one that faces the viewer is behind the scene.
    back = np.where(viewer > 0, box.low, box.high)
    # The floor stays below, also for a view from underneath.
    back[2] = box.low[2]
    front = np.where(viewer > 0, box.high, box.low)
    lines, outlines = [], []
    for normal in range(3):
        first, second = (axis for axis in range(3) if axis != normal)
        outline = np.tile(back, (4, 1))
        outline[:, first] = np.array([box.low, box.low, box.high, box.high])[:, first]
        outline[:, second] = np.array([box.low, box.high, box.high, box.low])[:, second]
        outlines.append(outline)
        for along, across in ((first, second), (second, first)):
            for at in box.rules(across):
                line = np.tile(back, (2, 1))
                line[:, across], line[:, along] = at, [box.low[along], box.high[along]]
                lines.append(line)
    faces = view.project(np.array(outlines) / TO_MM)[..., :2]
    axes.add_collection(
        PolyCollection(
            list(faces), facecolors=["white", "white", FLOOR], edgecolors="#B8BCC2", linewidths=0.6, zorder=0
        )
    )
    ruled = view.project(np.array(lines) / TO_MM)[..., :2]
    axes.add_collection(LineCollection(list(ruled), colors=RULE, linewidths=0.5, zorder=0.5))
    _draw_scales(axes, box, view, back, front)
    axes.set_aspect("equal")
    axes.axis("off")
    axes.autoscale_view()


def _draw_scales(axes: Axes, box: SceneBox, view: Projection, back: Array, front: Array) -> None:
    """Draw numbers and names along the front edges of the floor and the left upright edge."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    outline = view.project((box.low + corners * (box.high - box.low)) / TO_MM)[:, :2]
    middle, (width, height) = outline.mean(0), np.ptp(outline, axis=0).tolist()
    # Length in the scene of four inches of paper: the height of the box, or more where the width of the panel limits.
    four_inches = max(height, 4.0 * width * axes.figure.dpi / axes.get_window_extent().width)
    # Two upright edges are outlines of the box. The scale of z stands at the left one.
    left = min(((front[0], back[1]), (back[0], front[1])), key=lambda xy: view.project(np.array([*xy, 0.0]))[0])
    for axis, name in enumerate("xyz"):
        edge = np.array([front[0], front[1], box.low[2]]) if axis < 2 else np.array([*left, 0.0])
        ends = np.tile(edge, (2, 1))
        ends[:, axis] = box.low[axis], box.high[axis]
        start, stop = view.project(ends / TO_MM)[:, :2]
        if np.linalg.norm(stop - start) < 1e-6 * height:
            continue  # seen end-on
        outward = np.array([stop[1] - start[1], start[0] - stop[0]]) / np.linalg.norm(stop - start)
        # Of both normals of the edge, the one away from the middle of the box: numbers stand outside.
        outward *= np.sign(outward @ ((start + stop) / 2 - middle))
        rules = _spaced(box, axis, stop - start, four_inches)
        if axis < 2 and view.axes[0, axis] ** 2 < 0.5:
            # The two scales meet at the front corner, where only one number fits.
            rules = rules[np.abs(rules - front[axis]) > box.step / 2]
        points = np.tile(edge, (len(rules), 1))
        points[:, axis] = rules
        for value, at in zip(rules, view.project(points / TO_MM)[:, :2], strict=True):
            note(axes, number(value, 3), at, 5 * outward).set_gid(SCALE)
        if axis < 2:
            note(axes, f"{name} (mm)", (start + stop) / 2, 21 * outward, size=9)
        else:
            note(axes, f"{name} (mm)", (start + stop) / 2, 28 * outward, size=9, rotation=90)


def _spaced(box: SceneBox, axis: int, edge: Array, four_inches: float) -> Array:
    """Rules along `axis` that can have numbers without overlap, if its edge is seen as `edge` (2,).

    four_inches: length in the scene of four inches of paper; numbers are wider than high.
    """
    length = float(np.linalg.norm(edge))
    # A number takes 7.5 % of four inches across and 4 % upwards: 0.3 in and 0.16 in, at 8 points.
    needed = (0.075 * abs(edge[0]) + 0.04 * abs(edge[1])) / length * four_inches
    distance = length * box.step / (box.high[axis] - box.low[axis])
    # Numbers at round multiples of the rules, so that a reader counts in 1, 2, 5, 10.
    every = next((k for k in (1, 2, 5, 10) if k * distance >= needed), 20)
    rules = box.rules(axis)
    numbered: Array = rules[np.round(rules / box.step).astype(int) % every == 0]
    return numbered


def facets(mesh: DrawnMesh, view: Projection, centre: Array | None = None) -> PolyCollection:
    """Mesh of facets with their colours under the light, farthest first; in mm, about `centre` (3,) m if given."""
    from matplotlib.collections import PolyCollection

    projected = view.project(mesh.corners if centre is None else mesh.corners - centre)
    order = np.argsort(mesh.depth(view.towards_viewer))
    colours = mesh.lit(view.towards_viewer, view.towards_light)[order]
    # Painter's algorithm: facets are small against their distances, so sorting by their middles suffices.
    # Opaque facets are drawn with a hair of their own colour around them, which closes the seams between neighbours.
    edges = np.where(colours[:, 3:] < 1, 0.0, colours)
    corners: Any = projected[order, :, :2]  # an array is drawn at once, a list facet by facet
    return PolyCollection(corners, facecolors=colours, edgecolors=edges, linewidths=0.3, zorder=3)


class DrawnMesh(NamedTuple):
    """k four-sided facets."""

    corners: Array
    """(k, 4, 3) corners of the facets, m."""
    normals: Array
    """(k, 3) outward unit normals."""
    colours: Array
    """(k, 4) RGBA in [0, 1]."""
    lift: Array
    """(k,) shifts along the normal for sorting by depth, m: an outer surface stays in front of one that it touches."""

    def depth(self, towards_viewer: Array) -> Array:
        """(k,) distances towards the viewer, m, in the direction `towards_viewer` (3,)."""
        # Only order matters, so the mean of the corners stands for the whole facet.
        depth: Array = self.corners.mean(1) @ towards_viewer
        return depth + self.lift * (self.normals @ towards_viewer)

    def placed(self, frame: Frame) -> DrawnMesh:
        """Facets in the parent frame of `frame`, from facets in `frame`."""
        return DrawnMesh(frame.placed(self.corners), self.normals @ frame.axes.T, self.colours, self.lift)

    def only(self, selected: Mask) -> DrawnMesh:
        """Selected facets, by a mask (k,)."""
        return DrawnMesh(*(each[selected] for each in self))

    def in_sight(self, towards_viewer: Array) -> DrawnMesh:
        """Facets without those that face away from the viewer and are hidden."""
        return self.only((self.colours[:, 3] < 1) | (self.normals @ towards_viewer >= 0))

    @staticmethod
    def join(parts: list[DrawnMesh]) -> DrawnMesh:
        """Mesh of all facets of `parts`, which can be sorted by depth together."""
        # With an empty mesh in front, no parts at all are a mesh too.
        nothing = DrawnMesh(np.empty((0, 4, 3)), np.empty((0, 3)), np.empty((0, 4)), np.empty(0))
        return DrawnMesh(*map(np.concatenate, zip(nothing, *parts, strict=True)))

    def lit(self, towards_viewer: Array, towards_light: Array) -> Array:
        """(k, 4) colours under a light, from unit vectors (3,) towards viewer and light."""
        # Open surfaces are seen from both sides: a normal away from the viewer is reversed.
        facing = np.where(self.normals @ towards_viewer < 0, -1.0, 1.0)
        cosine = facing * (self.normals @ towards_light)
        # Halfway vector of Blinn (1977): a mirror image where the normal halves the angle of both.
        half = towards_viewer + towards_light
        # Power 30 makes a spot of about 12 deg (half its height), as on polished metal.
        gloss = np.clip(facing * (self.normals @ (half / np.linalg.norm(half))), 0, 1) ** 30
        # Half Lambert: the cosine from -1 to 1 becomes 0 to 1, so that form stays visible away from the light.
        shade = 0.45 + 0.55 * (0.5 + 0.5 * cosine)
        colours = self.colours.copy()
        colours[:, :3] = np.clip(colours[:, :3] * shade[:, None], 0, 1)
        # A blend towards white cannot exceed 1.
        colours[:, :3] += 0.35 * gloss[:, None] * (1 - colours[:, :3])
        return colours


def facets_of(surface: Surface, colour: Array, *, lift: float = 0.0, triangles: bool = False) -> DrawnMesh:
    """Mesh of a surface in a colour (4,), RGBA: a facet is two of its triangles, or one if `triangles`."""
    # `two_of_four` splits corners 0 1 2 3 into 0 1 2 and 0 2 3: entries 0, 1, 2 and 5 are the four again.
    # Half as many facets are drawn in half the time, without a seam along the diagonal.
    faces = surface.faces[:, [0, 1, 2, 2]] if triangles else surface.faces.reshape(-1, 6)[:, [0, 1, 2, 5]]
    corners = surface.vertices[faces]
    # The diagonals also give a normal where two corners coincide, as at the pole of a ball.
    normal = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal /= np.where(length > 0, length, 1.0)
    return DrawnMesh(corners, normal, np.tile(colour, (len(corners), 1)), np.full(len(corners), lift))


def mesh_of(parts: Iterable[Part], opacity: float = 1.0) -> DrawnMesh:
    """Mesh of parts, with a factor on their opacity."""
    colours = [(part, np.array([*(c / 255 for c in part.colour), part.opacity * opacity])) for part in parts]
    return DrawnMesh.join([facets_of(part.surface, colour, lift=part.lift) for part, colour in colours])
