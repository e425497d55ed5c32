"""Arms in a scene: robots with their bodies, loads, targets and the paths of their tips, to scale in a ruled box."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import Akima1DInterpolator

from ...bodies.anatomy import TransformedBody
from ...bodies.corridors import Corridor, MeshObstacle
from ...bodies.distance_field import DistanceField
from ...bodies.frames import Frame
from ...bodies.obstacles import HalfSpace, Obstacle
from ...equilibrium.result import Equilibrium
from ...files.units import TO_MILLI, TO_MM
from ...typing import Array
from ..page import tube_colour
from ..surfaces import (
    Detail,
    SampledCentreline,
    obstacle_surface,
    plate_part,
    plate_radius,
    robot_parts,
    swept,
    tube_groups,
    visible,
)
from .labels import arrow, note
from .projection import DrawnMesh, Projection, SceneBox, draw_box, facets, facets_of, mesh_of, widest_view
from .style import FAINT, INK, Axes

PRINTED, SWEEPING = Detail(24, 160, even=True), Detail(10, 120, even=True)
"""Facets of a single arm, and of each of many."""

SIDES = 20
"""Facets around a body."""

PATH_POINTS = 1500
"""Points of the drawn path of a tip, which is curved between its samples."""

OBSTACLE = np.array([0.55, 0.55, 0.58, 0.35])
VESSEL = np.array([0.80, 0.47, 0.65, 0.10])
"""Colours (RGBA) of solid bodies, and of those that enclose the arm."""

TARGET = "#B00020"


class DrawnArm(NamedTuple):
    """An arm of a scene."""

    equilibrium: Equilibrium
    opacity: float = 1.0
    base: Frame = Frame()
    """Frame of its base plate in the scene."""


class TipPath(NamedTuple):
    """Path of a tip, or its targets, in the frame of the scene."""

    time: Array
    """(T,) times, s, or another increasing parameter."""
    points: Array
    """(T, 3) points of the path, m."""
    targets: bool = False
    """Points are targets: straight lines join them, since the path between them is unknown."""


class DrawnTarget(NamedTuple):
    """Target of the tip of an arm."""

    position: Array
    """(3,) position of the target, m."""
    direction: Array | None
    """(3,) required unit tangent of the tip; None: any."""
    tip: Array | None
    """(3,) position of the tip that misses the target, m; None for a reached target."""


@dataclass(frozen=True, eq=False)
class PlotScene:
    """Arms and all that is drawn with them."""

    arms: Sequence[DrawnArm]
    bodies: Sequence[Obstacle] = ()
    paths: Sequence[TipPath] = ()
    targets: Sequence[DrawnTarget] = ()
    detail: Detail = SWEEPING
    plate: bool = False
    """Draw the base plate, and the shadows of the arms on the floor."""
    named: Equilibrium | None = None
    """Arm with labels on its tubes, tip and loads."""

    def view(self, angles: tuple[float, float] | None) -> Projection:
        """View of given elevation and azimuth, deg; with None across the widest side of arms and paths."""
        return Projection(*angles) if angles is not None else widest_view(self._points())

    def extent(self) -> Array:
        """(k, 3) points, m, that a box around the scene contains: arms, paths, bodies, the plate and the loads."""
        corners = [mesh.corners.reshape(-1, 3) for mesh in (*body_meshes(self.bodies), *self._plates())]
        # Heads of arrows count too, or a force at the outermost tip would leave the box.
        heads = [] if self.named is None else [load.end for load in load_arrows(self.named)]
        # The origin of the plate counts also where no arm begins there.
        return np.concatenate([self._points(), *corners, np.reshape(heads, (-1, 3)), np.zeros((1, 3))])

    def _points(self) -> Array:
        """(k, 3) points of arms and tip paths, m, for the extent of the scene."""
        arms = [arm.base.placed(arm.equilibrium.position) for arm in self.arms]
        return np.concatenate([*arms, *(path.points for path in self.paths)])

    def _plates(self) -> list[DrawnMesh]:
        return [plate_mesh(plate_radius(self.arms[0].equilibrium))] if self.plate else []

    def mesh(self) -> DrawnMesh:
        """All facets as one mesh, since facets of arms and bodies hide each other and are sorted together."""
        arms = [
            robot_mesh(arm.equilibrium, opacity=arm.opacity, detail=self.detail).placed(arm.base) for arm in self.arms
        ]
        return DrawnMesh.join([*self._plates(), *body_meshes(self.bodies), *arms])


def draw_scene(axes: Axes, scene: PlotScene, view: Projection, box: SceneBox) -> None:
    """Draw a scene as seen in a view, in a box that other pictures may share."""
    draw_box(axes, box, view)
    if scene.plate:
        for arm in scene.arms:
            # Every centreline as it falls straight down onto the floor; the box is in mm, positions are in m.
            fallen = arm.base.placed(arm.equilibrium.position)
            fallen[:, 2] = box.low[2] / TO_MM
            x, y, _ = view.project(fallen).T
            axes.plot(x, y, color=FAINT, lw=1.3, alpha=0.4, solid_capstyle="round", zorder=1)
    axes.add_collection(facets(scene.mesh().in_sight(view.towards_viewer), view), autolim=False)
    if scene.named is not None:
        if visible(scene.named):
            _name_tubes(axes, scene.named, view)
        _draw_loads(axes, scene.named, view)
    for path in scene.paths:
        _draw_path(axes, path, view)
    for target in scene.targets:
        _draw_target(axes, target, view)


def robot_mesh(
    equilibrium: Equilibrium,
    *,
    opacity: float = 1.0,
    window: tuple[float, float] | None = None,
    detail: Detail = PRINTED,
) -> DrawnMesh:
    """Surfaces of all tubes, m, between the arc lengths of an optional window, m."""
    return mesh_of(robot_parts(equilibrium, detail, window), opacity)


def plate_mesh(radius: float) -> DrawnMesh:
    """Base plate of a radius, m, in facets small enough to be sorted by depth."""
    return mesh_of([plate_part(radius, rings=6, sides=120)])


def draw_plate(axes: Axes, points: Array, view: Projection) -> None:
    """Draw a base plate in proportion to points (k, 3), m, and the ruled box around both."""
    plate = plate_mesh(0.07 * float(np.abs(points).max()))
    draw_box(axes, SceneBox.around(np.concatenate([points, plate.corners.reshape(-1, 3)])), view)
    axes.add_collection(facets(plate, view))


def draw_lines(
    axes: Axes,
    equilibrium: Equilibrium,
    project: Callable[[Array], Array],
    *,
    widths: tuple[float, float],
    opacity: float = 1.0,
) -> None:
    """Draw every visible tube as a line, for pictures in which its true width would be too thin.

    Args:
        project: (k, 3) m -> (k, 2) or more, in the units of the panel.
        widths: of the innermost tube, and by how much each outer one is wider, points.
    """
    line = SampledCentreline(equilibrium)
    for stretch in visible(equilibrium):
        s = np.linspace(stretch.start, stretch.end, 100)
        projected = project(line.position(s) + stretch.offset @ line.ring(s, 4)[1])
        look: dict[str, Any] = {"color": tube_colour(stretch.tube), "lw": widths[0] + widths[1] * stretch.tube}
        axes.plot(projected[:, 0], projected[:, 1], alpha=opacity, solid_capstyle="butt", zorder=4, **look)


def body_meshes(obstacles: Sequence[Obstacle]) -> list[DrawnMesh]:
    """Obstacles as facets, except half-spaces, which have no bounds."""
    out = []
    for obstacle in obstacles:
        body = obstacle.body if isinstance(obstacle, TransformedBody) else obstacle
        if isinstance(body, HalfSpace):
            continue
        if isinstance(obstacle, Corridor):
            surface = swept(np.array(obstacle.centreline), obstacle.radii, sides=SIDES, capped=False)
        else:
            surface = obstacle_surface(obstacle, 0.0, sides=SIDES)
        # A corridor encloses the arm: in the opaque grey of obstacles it would hide it.
        encloses = isinstance(body, Corridor) or (isinstance(body, DistanceField) and not body.bounded)
        out.append(facets_of(surface, VESSEL if encloses else OBSTACLE, triangles=isinstance(body, MeshObstacle)))
    return out


def _draw_path(axes: Axes, path: TipPath, view: Projection) -> None:
    """Draw the path of a tip, curved between its samples, or its targets; with its ends."""
    points = curve = view.project(path.points)
    if len(path.time) > 2 and not path.targets:
        # Makima does not swing where the tip rests between motions, as a cubic spline would.
        interpolant = Akima1DInterpolator(path.time, points, method="makima")
        curve = interpolant(np.union1d(path.time, np.linspace(path.time[0], path.time[-1], PATH_POINTS)))
    name, dots = ("targets", ".") if path.targets else ("tip", None)
    axes.plot(curve[:, 0], curve[:, 1], marker=dots, ms=3, color=INK, lw=0.9, zorder=5, label=name)
    axes.plot(*points[0, :2], "o", mfc="white", mec=INK, ms=4, zorder=6, label="start")
    axes.plot(*points[-1, :2], "o", color=INK, ms=4, zorder=6, label="end")


TARGET_LENGTH = 0.12
"""Length of the arrow of a required direction, over the distance of the target from the base."""


def _draw_target(axes: Axes, target: DrawnTarget, view: Projection) -> None:
    """Draw a cross at a target, an arrow along the required direction, and a line where the tip misses it."""
    at = view.project(target.position)[:2]
    axes.plot(*at, marker="+", ms=11, mew=1.3, color=TARGET, zorder=7)
    if target.direction is not None:
        length = TARGET_LENGTH * float(np.linalg.norm(target.position))
        end = view.project(target.position + length * target.direction)[:2]
        arrow(axes, at, end, TARGET, width=1.2, head=9, zorder=7)
    if target.tip is not None:
        tip = view.project(target.tip)[:2]
        axes.plot(*np.transpose([tip, at]), color=TARGET, lw=1.0, ls=(0, (4, 2)), zorder=7)
        error = float(np.linalg.norm(target.tip - target.position)) * TO_MM
        note(axes, f"{error:.2f} mm short", (tip + at) / 2, (6.0, 0.0), colour=TARGET)


FORCE, MOMENT = "#7A3E9D", "#9C5A00"

FORCE_LENGTH = 0.2
"""Length of the arrow of the largest force, over the length of the arm."""

DISTRIBUTED_ARROWS = 10
"""Number of arrows of a load per length."""

SECOND_HEAD = 0.8
"""Position of the second head of a moment's arrow, over its length."""


class LoadArrow(NamedTuple):
    """A force or a moment in a scene."""

    start: Array
    """(3,) point at which it acts, m."""
    end: Array
    """(3,) end of its arrow, m; moments point along their axes."""
    size: float
    """Size of the force (N) or moment (N m); per metre for a load per length."""
    unit: str
    colour: str
    labelled: bool = True
    """True if the size of the load is printed."""


def load_arrows(equilibrium: Equilibrium) -> list[LoadArrow]:
    """Forces and moments on an arm: at the tip, at points, and per length.

    The largest arrow of a kind is FORCE_LENGTH of the arm long, half as long for loads per length; the others are in
    proportion.
    """
    load = equilibrium.load
    if load is None:
        return []
    # A following load is given in the frame of the tip, and is drawn in that of the plate.
    tip_frame = equilibrium.tip_rotation if load.frame == "tip" else np.eye(3)
    line, length = SampledCentreline(equilibrium), float(equilibrium.arc_length[-1])
    points = [line.position([part.at])[0] for part in load.points]
    out = []
    for kind, unit, colour in (("force", "mN", FORCE), ("moment", "mN m", MOMENT)):
        vectors = [tip_frame @ getattr(load, kind), *(np.array(getattr(part, kind)) for part in load.points)]
        sizes = [float(np.linalg.norm(each)) for each in vectors]
        # Forces and moments have scales of their own: N and N m cannot be compared.
        scale = FORCE_LENGTH * length / (max(sizes) or 1.0)
        for at, vector, size in zip((equilibrium.tip_position, *points), vectors, sizes, strict=True):
            if size > 0:
                out.append(LoadArrow(at, at + scale * vector, size, unit, colour))
    if load.distributed is None:
        return out
    # Midpoints of equal intervals: no arrow at the ends, where point loads are.
    s = length * (np.arange(DISTRIBUTED_ARROWS) + 0.5) / DISTRIBUTED_ARROWS
    per_length, starts = load.per_length(s), line.position(s)
    for part, unit, colour in ((slice(0, 3), "mN/m", FORCE), (slice(3, 6), "mN m/m", MOMENT)):
        sizes = np.linalg.norm(per_length[:, part], axis=1).tolist()
        largest = int(np.argmax(sizes))
        for k in np.flatnonzero(sizes).tolist():
            end = starts[k] + 0.5 * FORCE_LENGTH * length * per_length[k, part] / sizes[largest]
            out.append(LoadArrow(starts[k], end, sizes[k], unit, colour, k == largest))
    return out


def _draw_loads(axes: Axes, equilibrium: Equilibrium, view: Projection) -> None:
    """Draw an arrow at the point of each force and moment, with its size; arrows of moments have two heads."""
    for load in load_arrows(equilibrium):
        start, end = view.project(np.array([load.start, load.end]))[:, :2]
        ends = [end, start + SECOND_HEAD * (end - start)] if load.unit.startswith("mN m") else [end]
        for head in ends:
            arrow(axes, start, head, load.colour, width=1.2, head=9, zorder=7)
        if load.labelled:
            along = (end - start) / max(float(np.linalg.norm(end - start)), 1e-9)
            note(axes, f"{load.size * TO_MILLI:.4g} {load.unit}", end, 4 * along, colour=load.colour)


NAME_DISTANCE = 10.0
"""Distance between the names of tubes that lie side by side, points."""


def _name_tubes(axes: Axes, equilibrium: Equilibrium, view: Projection) -> None:
    """Draw the name of each tube to the lower right of its visible part, and that of the tip to its upper left."""
    line = SampledCentreline(equilibrium)
    for bundle in tube_groups(equilibrium):
        middle = (bundle.start + bundle.end) / 2
        right = _right_of(line, middle, view)
        at = view.project(line.position([middle])[0])[:2] + bundle.radius * TO_MM * right
        several = len(bundle.tubes) > 1
        for row, i in enumerate(bundle.tubes):
            lower = np.array([0.0, NAME_DISTANCE * ((len(bundle.tubes) - 1) / 2 - row)])
            shift = (12 if several else 5) * right + lower
            note(axes, f"tube {i + 1}", at, shift, colour=tube_colour(i), level=several)
    right = _right_of(line, line.length, view)
    at = view.project(equilibrium.tip_position)[:2] - close_up_radius(equilibrium) * TO_MM * right
    note(axes, "tip", at, -3 * right)


def _right_of(line: SampledCentreline, s: float, view: Projection) -> Array:
    """(2,) unit vector in the picture perpendicular to the arm at arc length `s`, to the right of an arm that points
    up.
    """
    x, y, _ = view.project(line.axes(np.array([s])).tangent[0])
    length = float(np.hypot(x, y))
    return np.array([y, -x]) / length if length > 1e-9 else np.array([1.0, 0.0])


def close_up_radius(equilibrium: Equilibrium) -> float:
    """Radius of a close-up, m: around a tube, or all that the widest sheath of an eccentric robot encloses."""
    diameter = np.array([tube.outer_diameter for tube in equilibrium.robot.tubes])
    # Twice the offset of a tube's axis, plus its diameter, is the width of the bundle around the arm's axis.
    across = diameter + 2 * np.hypot(*equilibrium.robot.axes.T)
    return float(max(1.7 * diameter.max(), 1.1 * across.max()))
