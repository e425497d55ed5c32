"""Shapes that the viewer shows in addition to the arm: a cut through a mesh, the swept volume, a second robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...bodies.frames import Plane
from ...bodies.obstacles import Obstacle, nearest_distance
from ...equilibrium.arm_surface import ArmSurface
from ...equilibrium.result import Equilibrium
from ...errors import InputError, SolveError, import_extra
from ...files.units import TO_MM
from ...robots.robot import Robot
from ...typing import Array
from ..surfaces import Part, SampledCentreline, Surface, plate_part, plate_radius, two_of_four
from .scene import SCALE, ViewerScene, obstacle_parts
from .session import Session, move, open_session, strides
from .view import Playback, snaps_between, state_at

CELLS = 200
"""Number of cells of the filled section along its longer side."""

ACROSS = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
"""Normals of planes across the axes of the plate."""

SECTION = "section"

SECTION_COLOUR = (205, 150, 120)


def cut_parts(obstacles: Sequence[Obstacle], reach: float, plane: Plane | None) -> list[Part]:
    """Bodies to be shown, up to a plane if one is given, with the section that it makes of them."""
    parts = obstacle_parts(obstacles, reach)
    if plane is None or not parts:
        return parts
    corners = np.concatenate([part.surface.vertices for part in parts])
    cut = [replace(part, surface=cut_surface(part.surface, plane)) for part in parts]
    filled = section(obstacles, plane, corners.min(0), corners.max(0))
    return [part for part in (*cut, Part(SECTION, filled, SECTION_COLOUR)) if len(part.surface.faces)]


def cut_text(parts: Sequence[Part], plane: Plane | None) -> str:
    """Position of the plane and the cut area of bodies, as text."""
    if plane is None:
        return ""
    corners = [part.surface.vertices[part.surface.faces] for part in parts if part.name == SECTION]
    # The cross product of two sides of a triangle has twice its area as length.
    twice = sum(np.linalg.norm(np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0]), axis=1).sum() for c in corners)
    direction = ", ".join(f"{x:.3g}" for x in plane.normal + 0.0)
    across = next((name for name, axis in ACROSS.items() if (plane.normal == axis).all()), direction)
    return f"cut across {across} at {plane.point @ plane.normal * TO_MM:.4g} mm: {twice / 2 * 1e4:.2f} cm2 of bodies"


def cut_surface(surface: Surface, plane: Plane) -> Surface:
    """The part of a surface up to a plane: triangles across it are cut there."""
    trimesh = import_extra("trimesh.intersections", "view", "bodies that are cut")
    vertices, faces, _ = trimesh.slice_faces_plane(
        # trimesh keeps what lies ahead of the normal, and what is behind is wanted.
        surface.vertices,
        surface.faces.astype(np.int64),
        -plane.normal,
        plane.point,
    )
    return Surface(vertices, faces.astype(np.uint32))


def section(obstacles: Sequence[Obstacle], plane: Plane, low: Array, high: Array) -> Surface:
    """Section of bodies by a plane within a box: squares with their middle in a body."""
    corners = np.array([[(low, high)[k][i] for i, k in enumerate(each)] for each in np.ndindex(2, 2, 2)])
    side, frame = plane.height(corners), plane.frame
    # All corners on one side: by convexity the plane misses the whole box.
    if not side.min() <= 0 <= side.max():
        return _squares(np.zeros((0, 4, 3)))
    along = frame.seen(corners)[:, :2]
    # A body that only touches the plane has no extent in it.
    size = max(float(np.ptp(along, axis=0).max()) / CELLS, 1e-6)
    u, v = (np.arange(a + size / 2, b, size) for a, b in zip(along.min(0), along.max(0), strict=True))
    middle = frame.placed(np.stack(np.broadcast_arrays(u[:, None], v[None], 0.0), axis=-1))
    within = ((middle >= low) & (middle <= high)).all(-1)
    # Outside of the box there is nothing but half-spaces without end, which would fill the whole plane.
    inside = middle[within & (nearest_distance(obstacles, middle) < 0)]
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * size / 2 @ frame.axes[:, :2].T
    return _squares(inside[:, None] + square)


def _squares(corners: Array) -> Surface:
    """Squares (k, 4, 3) that share no corners."""
    faces = np.arange(4 * len(corners), dtype=np.uint32).reshape(-1, 4)
    return Surface(corners.reshape(-1, 3), two_of_four(faces))


STEP = np.radians(20.0)
"""Largest turn of a tube between shapes with a common hull."""

SLIDE = 0.008
"""Largest translation likewise, m."""

PIECES = 20
"""Parts of the arm between which hulls are taken."""

SIDES = 10
"""Corners of each cross-section: the hull lies within 5 % of the radius inside the round tube."""

MAX_SHAPES = 160
COLOUR, OPACITY = (120, 90, 200), 0.25


@dataclass(frozen=True, eq=False)
class Swept:
    """Surface of the swept space, its volume (m^3), and the number of joined shapes."""

    surface: Surface
    volume: float
    shapes: int


def swept_volume(playback: Playback) -> Swept:
    """Union of the convex hulls of neighbouring parts of the arm at neighbouring times.

    A snap is left out: through where the arm flies is not in the model.

    Raises:
        InputError: manifold3d, which joins the hulls, is not installed.
    """
    try:
        import manifold3d
    except ImportError:
        raise InputError("the swept volume needs manifold3d: python -m pip install 'tubeopt[view]'") from None
    hulls: list[Any] = []
    shapes = 0
    for run in _runs(playback):
        rings = [_rings(each) for each in run]
        shapes += len(rings)
        # A run of one shape is paired with itself: its volume is that of the arm.
        pairs = zip(rings, rings[1:] or rings, strict=False)
        for a, b in pairs:
            for k in range(PIECES):
                # Four rings span one piece of the arm at two times; their hull covers the motion of points along lines.
                points = np.concatenate([a[k], a[k + 1], b[k], b[k + 1]]).astype(np.float32)
                hulls.append(manifold3d.Manifold.hull_points(np.ascontiguousarray(points * TO_MM)))
    union = manifold3d.Manifold.batch_boolean(hulls, manifold3d.OpType.Add)
    mesh = union.to_mesh()
    surface = Surface(np.array(mesh.vert_properties)[:, :3] / TO_MM, np.array(mesh.tri_verts, dtype=np.uint32))
    return Swept(surface, float(union.volume()) * 1e-9, shapes)


def _runs(playback: Playback) -> list[list[Equilibrium]]:
    """Shapes in sequence, split where a snap interrupts them."""
    points = playback.waypoints
    steps = strides(points.rotations, points.translations, turn=STEP, slide=SLIDE)
    count = np.maximum(np.ceil(steps), 1).astype(int)
    # The union grows with the number of hulls: beyond MAX_SHAPES all steps are coarsened alike.
    count = np.maximum(1, np.floor(count * min(1.0, MAX_SHAPES / max(count.sum(), 1)))).astype(int)
    times = [np.linspace(a, b, n + 1)[1:] for a, b, n in zip(points.time, points.time[1:], count, strict=False)]
    runs: list[list[Equilibrium]] = [[playback.path.equilibria[0]]]
    before = 0.0
    for t in np.concatenate([*times, np.empty(0)]):
        if snaps_between(playback, before, float(t)):
            # A hull across a snap would fill the space that the arm flew through.
            runs.append([])
        runs[-1].append(state_at(playback, float(t)))
        before = float(t)
    return [run for run in runs if run]


def _rings(equilibrium: Equilibrium) -> Array:
    """(PIECES + 1, SIDES, 3) corners of cross-sections along the arm, as wide as the widest tube there, m."""
    line = SampledCentreline(equilibrium)
    s = np.linspace(0.0, line.length, PIECES + 1)
    radius = ArmSurface(equilibrium).radius(s)[:, None, None]
    return np.asarray(line.position(s)[:, None] + radius * line.ring(s, SIDES)[0])


LATERAL = 0.45
"""Distance of the compared robot to the side, over the length of the longer arm."""

PLACE = "/beside"


def comparison_session(robot: Robot, first: Session) -> Session:
    """Session at home of a robot to be compared with the robot of `first`.

    Raises:
        InputError: another number of tubes.
        SolveError: it has no stable equilibrium at home.
    """
    # Both are moved by the same joint values, tube by tube.
    if robot.n_tubes != first.robot.n_tubes:
        raise InputError(
            f"{robot.name or 'the robot'} has {robot.n_tubes} tubes; it must have {first.robot.n_tubes}: both are "
            "moved by the same joint values"
        )
    return open_session(robot)


class ComparedRobot:
    """Second robot next to the first one; it follows the joint values, with a label on its state."""

    def __init__(self, api: Any, session: Session, first: Session) -> None:
        self.session = session
        long = max(float(each.equilibrium.arc_length[-1]) for each in (session, first))
        # To the right of the first robot, seen from the initial camera.
        position = LATERAL * long * SCALE * np.array([1.0, 1.0, 0.0]) / np.sqrt(2.0)
        self._frame = api.add_frame(PLACE, show_axes=False, position=tuple(position))
        self._label = api.add_label(f"{PLACE}/name", "", anchor="bottom-right")
        self._scene = ViewerScene(api, PLACE)
        self._scene.layer(f"{PLACE[1:]}/plate", [plate_part(plate_radius(session.equilibrium))])
        self.follow(first)

    def follow(self, first: Session) -> str:
        """Go to the joint values of the first robot; returns the message of an error, or ""."""
        target, message = first.equilibrium, ""
        try:
            self.session = move(self.session, target.rotations, target.translations)
        except (InputError, SolveError) as error:
            message = f"beside: {error}"
        shown = self.session.equilibrium
        self._scene.show(shown)
        self._label.text = f"{shown.robot.name or 'robot'}: {self.session.verdict}, margin {shown.margin:.3f}"
        self._label.position = tuple(shown.tip_position * SCALE)
        return message

    @property
    def visible(self) -> bool:
        """True if it is shown."""
        return bool(self._frame.visible)

    @visible.setter
    def visible(self, on: bool) -> None:
        self._frame.visible = on

    def remove(self) -> None:
        """Remove the robot and its label from the scene."""
        self._frame.remove()
