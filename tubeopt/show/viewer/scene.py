"""Picture of a session in the browser: its objects, and their changes with a motion.

Lengths are drawn `SCALE` times as large, since the viewer's camera is made for things of the size of a person.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import scipy

from ...bodies.corridors import Corridor
from ...bodies.obstacles import HalfSpace, Obstacle
from ...equilibrium.result import Equilibrium
from ...robots.robot import Robot
from ...stability import Snap
from ...typing import Array
from ...workspaces import Workspace
from ..page import margin_colour
from ..surfaces import (
    Part,
    SampledCentreline,
    Surface,
    axes_about,
    join,
    obstacle_surface,
    plate_part,
    plate_radius,
    revolved,
    robot_parts,
)
from .session import Session

SCALE = 10.0
"""Units of the scene per metre."""

GHOST_COLOURS = {True: (70, 110, 190), False: (205, 60, 60)}
"""Colours of other equilibria: stable, unstable."""

GHOST_OPACITY = 0.3
DOT = 0.0035
"""Size of a tip of the workspace, as a share of the longest tube."""

OBSTACLE_COLOUR = (150, 120, 95)
FORCE_COLOUR = (220, 120, 30)
FORCE = "/force"
SHORTEST_ARROW = 1e-6
"""Shortest arrow of a force, m."""
MARK = 0.2
"""Size of a mark that is dragged, over the longest curved part of a tube."""

FRAMES, SNAP_SECONDS = 12, 0.36
"""Pictures of a snap, and how long it takes on the screen; a real one is over in milliseconds."""


class ViewerScene:
    """Scene of one browser; its objects in viser are updated in place.

    Args:
        api: `scene` of a viser server or of one of its clients.
        prefix: name in viser below which all objects are.
    """

    def __init__(self, api: Any, prefix: str = "/robot") -> None:
        self._api, self._prefix = api, prefix
        self._parts: dict[str, Any] = {}
        self._layers: dict[str, tuple[tuple[Part, ...], list[Any]]] = {}
        self._trail: Any = None

    def set_stage(self, equilibrium: Equilibrium) -> None:
        """Plate and ruled floor, and the lights."""
        plate = plate_part(plate_radius(equilibrium))
        low = float(plate.surface.vertices[:, 2].min())
        self.layer("plate", [plate])
        # Whole units, so that bold lines meet the edges of the floor.
        reach = 4 * float(np.ceil(max(tube.length for tube in equilibrium.robot.tubes) * SCALE))
        # Cells are in units of the scene: 0.1 is 1 cm, and a section 10 cm.
        self._api.add_grid(
            "/floor",
            width=reach,
            height=reach,
            plane="xy",
            cell_size=0.1,
            section_size=1.0,
            position=(0.0, 0.0, low * SCALE),
            fade_distance=2 * reach,
            shadow_opacity=0.2,
        )
        self._api.configure_default_lights(enabled=True, cast_shadow=False)

    def show(self, equilibrium: Equilibrium) -> None:
        """Draw the robot in a shape; parts that do not show are hidden."""
        parts = {f"{self._prefix}/{part.name}": part for part in robot_parts(equilibrium)}
        for name, part in parts.items():
            self._draw(name, part)
        for name, handle in self._parts.items():
            if name not in parts and name != FORCE:
                handle.visible = False

    def show_trail(self, session: Session, visible: bool) -> None:
        """Draw the path of the tip up to now, coloured by margin; jumps of snaps are straight."""
        trail = session.trail
        if not visible or trail is None or len(trail) < 2:
            if self._trail is not None:
                self._trail.visible = False
            return
        # (k - 1, 2, 3): single segments take a colour each, which a line does not.
        segments = np.stack([trail[:-1, :3], trail[1:, :3]], axis=1).astype(np.float32) * SCALE
        colours = np.array([[margin_colour(m)] * 2 for m in trail[1:, 3]], dtype=np.uint8)
        if self._trail is None:
            self._trail = self._api.add_line_segments(
                "/trail", points=segments, colors=colours, thickness=2.5, thickness_units="screen"
            )
            return
        self._trail.points = segments
        self._trail.colors = colours
        self._trail.visible = True

    def layer(self, name: str, parts: Iterable[Part]) -> None:
        """Replace everything in a named layer."""
        self.clear(name)
        shown = tuple(parts)
        self._layers[name] = shown, [self._add(f"/{name}/{part.name}", part) for part in shown]

    def clear(self, name: str) -> None:
        """Remove a layer."""
        for handle in self._layers.pop(name, ((), []))[1]:
            handle.remove()

    @property
    def contents(self) -> dict[str, tuple[Part, ...]]:
        """Surfaces of every visible layer, without points."""
        return {name: parts for name, (parts, _) in self._layers.items()}

    def has(self, name: str) -> bool:
        """True if a layer shows something."""
        return name in self._layers and bool(self._layers[name][1])

    def show_cloud(self, workspace: Workspace) -> None:
        """Show the tips of a workspace as points coloured by margin."""
        self.clear("workspace")
        rows = workspace.table[np.isfinite(workspace.table[:, -1])]
        n = workspace.robot.n_tubes
        points = (rows[:, 2 * n : 2 * n + 3] * SCALE).astype(np.float32)
        colours = np.array([margin_colour(margin) for margin in rows[:, -1]], dtype=np.uint8)
        size = DOT * max(tube.length for tube in workspace.robot.tubes) * SCALE
        cloud = self._api.add_point_cloud(
            "/workspace/tips", points, colours, point_size=size, point_shape="circle", precision="float32"
        )
        self._layers["workspace"] = (), [cloud]

    def show_force(self, tip: Array, head: Array) -> None:
        """Draw the arrow of a force on the tip; hide it if its length is 0."""
        if np.linalg.norm(head - tip) < SHORTEST_ARROW:
            if FORCE in self._parts:
                self._parts[FORCE].visible = False
        else:
            self._draw(FORCE, Part("force", arrow_surface(tip, head), FORCE_COLOUR))

    def _draw(self, name: str, part: Part) -> None:
        """Draw a part; an earlier drawing with equally many vertices is updated instead of replaced."""
        vertices = (part.surface.vertices * SCALE).astype(np.float32)
        handle = self._parts.get(name)
        # New vertices of an old mesh are sent without faces, and the browser builds nothing anew.
        if handle is not None and handle.vertices.shape == vertices.shape:
            handle.vertices = vertices
            handle.visible = True
            return
        if handle is not None:
            handle.remove()
        self._parts[name] = self._add(name, part)

    def _add(self, name: str, part: Part) -> Any:
        # viser wants None for what is opaque: anything else is drawn by depth, back to front.
        return self._api.add_mesh_simple(
            name,
            (part.surface.vertices * SCALE).astype(np.float32),
            part.surface.faces,
            color=part.colour,
            opacity=None if part.opacity >= 1 else part.opacity,
            # Back faces of closed opaque bodies are never seen; leaving them out saves work.
            side="front" if part.opacity >= 1 else "double",
            cast_shadow=False,
            receive_shadow=False,
        )


class Mark:
    """Arrows for dragging in the scene of a browser.

    The callback `dragged` gets their position, m, and True at the end of the drag.
    """

    def __init__(self, api: Any, name: str, dragged: Callable[[Array, bool], None]) -> None:
        self._api, self._name, self._dragged = api, name, dragged
        self._arrows: Any = None

    @property
    def visible(self) -> bool:
        """True if they are in the scene."""
        return self._arrows is not None

    def put(self, position: Array, robot: Robot, on: bool) -> None:
        """Show the arrows at a position, m, scaled to the robot, or hide them."""
        if self._arrows is not None:
            self._arrows.remove()
            self._arrows = None
        if on:
            size = MARK * max(tube.curved_length for tube in robot.tubes) * SCALE
            self._arrows = self._api.add_transform_controls(
                f"/{self._name}", scale=size, disable_rotations=True, position=tuple(position * SCALE), depth_test=False
            )
            self._arrows.on_update(self._drawn)

    def follow(self, position: Array) -> None:
        """Move visible arrows to a position, m."""
        if self._arrows is not None:
            self._arrows.position = tuple(position * SCALE)

    async def _drawn(self, event: Any) -> None:
        # The start of a drag is a click without motion.
        if event.phase != "start":
            self._dragged(np.array(event.target.position) / SCALE, event.phase == "end")


def ghost_parts(ghosts: Sequence[Equilibrium]) -> list[Part]:
    """Translucent surfaces of other equilibria: stable ones blue, unstable ones red."""
    out = []
    for k, each in enumerate(ghosts):
        surfaces = [part.surface for part in robot_parts(each)]
        if surfaces:
            out.append(Part(f"ghost_{k + 1}", join(surfaces), GHOST_COLOURS[each.stable], GHOST_OPACITY))
    return out


def obstacle_parts(obstacles: Sequence[Obstacle], reach: float) -> list[Part]:
    """Surfaces of bodies; unbounded bodies, up to `reach` (m), and vessels are translucent."""
    return [
        Part(
            f"obstacle_{k + 1}",
            obstacle_surface(body, reach),
            OBSTACLE_COLOUR,
            0.3 if isinstance(body, HalfSpace | Corridor) or not getattr(body, "bounded", True) else 1.0,
        )
        for k, body in enumerate(obstacles)
    ]


SIDES = {
    "side": (1.4, 0.0, 0.45),
    "front": (0.0, -1.4, 0.45),
    # Exactly above, the direction of view and "up" would be parallel, and the camera could roll.
    "above": (0.0, -1e-3, 1.9),
    "corner": (0.85, -0.85, 0.75),
}
"""Positions of the camera, over the length of the arm: views of the planes y-z, x-z and x-y, and the first view."""


def look_from(camera: Any, equilibrium: Equilibrium, side: str = "corner", *, far: float = 1.0) -> None:
    """Move a camera of viser to one of `SIDES`, `far` times as far away, so that it sees the whole robot."""
    # With all tubes withdrawn the camera would stand in the plate.
    length = max(float(equilibrium.arc_length[-1]), 0.02) * SCALE
    camera.position = tuple(far * length * np.array(SIDES[side]))
    # About the middle of an arm, which bends away from the axis.
    camera.look_at = (0.0, 0.0, 0.45 * length)


def animate(client: Any, scene: ViewerScene, snaps: Sequence[Snap]) -> None:
    """Show snaps one after the other."""
    for snap in snaps:
        for shape in [snap.before, *between(snap.before, snap.after, FRAMES), snap.after]:
            start_time = time.monotonic()
            with client.atomic():
                scene.show(shape)
            client.flush()
            time.sleep(max(0.0, SNAP_SECONDS / FRAMES - (time.monotonic() - start_time)))


def arrow_surface(start: Array, end: Array) -> Surface:
    """Surface of an arrow between two points (3,), m."""
    length = float(np.linalg.norm(end - start))
    shaft, head, tall = 0.015 * length, 0.05 * length, 0.8 * length
    # Points at edges are twice there, so that no normals are averaged across them and edges look sharp.
    profile = [(0.0, length), (head, tall), (head, tall), (shaft, tall), (shaft, 0.0), (shaft, 0.0), (0.0, 0.0)]
    body = revolved(np.array(profile))
    return Surface(start + body.vertices @ axes_about((end - start) / length), body.faces)


def between(before: Equilibrium, after: Equilibrium, count: int) -> list[Equilibrium]:
    """Shapes between two equilibria of one robot at the same joint values, to animate a snap.

    Their curvature goes evenly from one to the other, and the arm keeps its length. They are no equilibria: how a snap
    runs in time is not in the model.
    """
    s = after.arc_length
    first = np.column_stack([np.interp(s, before.arc_length, u) for u in before.curvature.T])
    # Half a cosine: the motion begins and ends at rest.
    weights = ((1 - np.cos(np.pi * np.arange(count + 1) / count)) / 2)[:, None, None]
    u = (1 - weights) * first + weights * after.curvature
    h = np.diff(s)
    # Mean curvature times length is the rotation vector of a step; without its third entry, no twist of the frame.
    omega = np.concatenate([(u[:, :-1] + u[:, 1:]) / 2 * h[:, None], np.zeros((count + 1, len(h), 1))], axis=2)
    frame = np.empty((count + 1, len(s), 3, 3))
    frame[:, 0] = after.frame[0]
    position = np.zeros((count + 1, len(s), 3))
    position[:, 0] = after.position[0]
    for k in range(len(h)):
        frame[:, k + 1] = frame[:, k] @ scipy.spatial.transform.Rotation.from_rotvec(omega[:, k]).as_matrix()
        # r' = R e3 by the trapezoidal rule.
        position[:, k + 1] = position[:, k] + h[k] * (frame[:, k, :, 2] + frame[:, k + 1, :, 2]) / 2
    # The few points integrate to within a per cent: what is missing at both ends is shared out between them.
    ends = SampledCentreline(before).position(s), after.position
    # So both ends of the film are the equilibria themselves, without a jump of the picture.
    position += (1 - weights) * (ends[0] - position[0]) + weights * (ends[1] - position[-1])
    arms = (replace(after.arm, position=p, frame=f) for p, f in zip(position[1:-1], frame[1:-1], strict=True))
    return [replace(after, arm=arm) for arm in arms]
