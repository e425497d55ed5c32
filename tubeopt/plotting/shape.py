"""The robot in space: tubes as shaded surfaces of true diameter, with close-ups of where each tube ends."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np

from ..robots.assembly import Array
from . import mesh as surfaces
from .mesh import Centreline, Mesh
from .stage import MM, Box, View, draw_box, facets, rule_step, widest_view
from .style import FAINT, INK, caption, new_figure, number, save_figure, styled, tube_colour

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

    from ..equilibrium import Equilibrium

GHOST_OPACITY = 0.25
PLATE_COLOUR = np.array([0.80, 0.82, 0.85, 1.0])
BORE_COLOUR = np.array([0.13, 0.13, 0.13, 1.0])
CLOSE_UP = 1.7
"""Radius of a close-up, in outer diameters of the thickest tube."""


@styled
def plot_shape(
    equilibrium: Equilibrium,
    path: str | PathLike[str] | None = None,
    *,
    ghosts: Sequence[Equilibrium] = (),
    view: tuple[float, float] | None = None,
) -> Figure:
    """Picture of the robot's shape, 7.0 x 5.0 in.

    Args:
        equilibrium: what to draw.
        path: where to save the picture (PNG, PDF or SVG by its ending); None saves nothing.
        ghosts: other equilibria, drawn translucent.
        view: elevation and azimuth of the viewer, deg; None looks across the widest side of the shape.

    Raises:
        InputError: the name of the picture does not end in a known format.
    """
    figure = new_figure(7.0, 5.0)
    draw_shape(figure, equilibrium, ghosts=ghosts, view=view)
    if path is not None:
        save_figure(figure, path)
    return figure


@styled
def draw_shape(
    figure: Figure | SubFigure,
    equilibrium: Equilibrium,
    *,
    ghosts: Sequence[Equilibrium] = (),
    view: tuple[float, float] | None = None,
    title: str | None = None,
    close_ups: bool = True,
) -> None:
    """Draw the shape into `figure`, or a part of one: the robot to scale, and a column of close-ups beside it.

    Args: as `plot_shape`; `title` replaces the robot's name, `close_ups=False` leaves out the column.
    """
    shapes = np.concatenate([each.position for each in (equilibrium, *ghosts)])
    seen = View(*view) if view is not None else widest_view(shapes)
    ends = exposed(equilibrium) if close_ups else []
    grid = figure.add_gridspec(max(len(ends), 3), 2 if ends else 1, width_ratios=(3.6, 1) if ends else None)
    scene = figure.add_subplot(grid[:, 0])
    _draw_scene(scene, equilibrium, ghosts, seen)
    for row, (tube, _, end) in enumerate(reversed(ends)):
        close_up = figure.add_subplot(grid[row, 1])
        _draw_close_up(close_up, scene, equilibrium, tube, end, seen)
    if ends:
        _draw_scale_bar(close_up)
    figure.suptitle(caption(equilibrium, title), fontsize=9, x=0.02, ha="left")


def exposed(equilibrium: Equilibrium) -> list[tuple[int, float, float]]:
    """Tubes of which something shows, with the arc lengths between which they do, m; outermost first.

    A tube shows from where the last tube around it ends to its own end.
    """
    assembly = equilibrium.robot.assembly(equilibrium.translations)
    place = assembly.offset * np.exp(1j * assembly.offset_angle)
    stretches = []
    for i in reversed(range(assembly.n_tubes)):
        around = [assembly.end[j] for j in range(i + 1, assembly.n_tubes) if abs(place[j] - place[i]) < 1e-9]
        start = max(around, default=0.0)
        if assembly.end[i] > start:
            stretches.append((i, float(start), float(assembly.end[i])))
    return stretches


def robot_mesh(equilibrium: Equilibrium, *, opacity: float = 1.0, window: tuple[float, float] | None = None) -> Mesh:
    """Surfaces of all tubes in m: each where it shows, closed by the rim of its wall and the bore inside.

    Args:
        opacity: 0 to 1.
        window: arc lengths, m; only what lies between them, in finer facets.
    """
    from matplotlib.colors import to_rgba

    line = Centreline(equilibrium)
    assembly = equilibrium.robot.assembly(equilibrium.translations)
    low, high = window or (0.0, line.length)
    sides, pieces = (72, 24) if window else (24, 160)
    parts = []
    for i, start, end in exposed(equilibrium):
        tube = equilibrium.robot.tubes[i]
        outer, inner = tube.outer_diameter / 2, tube.inner_diameter / 2
        angle = assembly.offset_angle[i]
        offset = assembly.offset[i] * np.array([np.cos(angle), np.sin(angle)])
        colour = np.array(to_rgba(tube_colour(i), opacity))
        first, last = max(start, low), min(end, high)
        if last > first:
            count = 2 + int(pieces * (last - first) / (min(high, line.length) - max(low, 0.0)))
            s = np.linspace(first, last, count)
            parts.append(surfaces.tube_mesh(line, s, outer, colour, offset=offset, sides=sides))
        if low <= end <= high:
            rim = 0.45 * colour + 0.55 * np.array([1, 1, 1, opacity])
            parts.append(surfaces.ring_mesh(line, end, (inner, outer), rim, offset=offset, sides=sides))
            bore = BORE_COLOUR * [1, 1, 1, opacity]
            parts.append(surfaces.ring_mesh(line, end, (0.0, inner), bore, offset=offset, sides=sides))
    return Mesh.join(parts)


def plate_radius(equilibrium: Equilibrium) -> float:
    """Radius at which to draw the base plate, m: in proportion to the arm, and well beyond its tubes."""
    thickest = max(tube.outer_diameter for tube in equilibrium.robot.tubes)
    return max(0.07 * float(equilibrium.arc_length[-1]), 4 * thickest)


def _draw_scene(axes: Axes, equilibrium: Equilibrium, ghosts: Sequence[Equilibrium], view: View) -> None:
    """The robot on its plate, with its shadow on the floor, to scale."""
    radius = plate_radius(equilibrium)
    parts = [surfaces.plate_mesh(radius, 0.25 * radius, PLATE_COLOUR), robot_mesh(equilibrium)]
    parts += [robot_mesh(ghost, opacity=GHOST_OPACITY) for ghost in ghosts]
    whole = Mesh.join(parts)
    box = Box.around(whole.corners.reshape(-1, 3))
    draw_box(axes, box, view)
    for each in (equilibrium, *ghosts):
        floored = np.column_stack([each.position[:, :2], np.full(len(each.position), box.low[2] / MM)])
        shadow = view.project(floored)
        axes.plot(shadow[:, 0], shadow[:, 1], color=FAINT, lw=1.3, alpha=0.4, solid_capstyle="round", zorder=1)
    axes.add_collection(facets(whole, view))
    _name_tubes(axes, equilibrium, view)


def _name_tubes(axes: Axes, equilibrium: Equilibrium, view: View) -> None:
    """Name each tube beside the middle of where it shows, and the tip."""
    line = Centreline(equilibrium)
    for i, start, end in exposed(equilibrium):
        at, beside = _beside(line, (start + end) / 2, view)
        _label(axes, f"tube {i + 1}", at, 7 * beside, tube_colour(i))
    at, beside = _beside(line, line.length, view)
    _label(axes, "tip", at, -9 * beside, INK)


def _beside(line: Centreline, s: float, view: View) -> tuple[Array, Array]:
    """Where arc length `s` is seen, mm, and the unit vector in the picture that points to the arm's lower right."""
    at = view.project(line.position([s])[0])[:2]
    tangent = view.project(line.axes(np.array([s]))[2][0])[:2]
    beside = np.array([tangent[1], -tangent[0]])
    length = float(np.linalg.norm(beside))
    return at, beside / length if length > 1e-9 else np.array([1.0, 0.0])


def _label(axes: Axes, text: str, at: Array, shift: Array, colour: str) -> None:
    axes.annotate(
        text,
        (float(at[0]), float(at[1])),
        (float(shift[0]), float(shift[1])),
        textcoords="offset points",
        ha="left" if shift[0] >= 0 else "right",
        va="center" if abs(shift[0]) > abs(shift[1]) else "bottom" if shift[1] > 0 else "top",
        color=colour,
        zorder=6,
    )


def _draw_close_up(axes: Axes, scene: Axes, equilibrium: Equilibrium, tube: int, end: float, view: View) -> None:
    """The end of one tube seen from the same side, in a circle that is drawn in the scene too."""
    from matplotlib.patches import Circle, ConnectionPatch

    radius = CLOSE_UP * max(each.outer_diameter for each in equilibrium.robot.tubes)
    centre = Centreline(equilibrium).position([end])[0]
    shown = facets(robot_mesh(equilibrium, window=(end - 4 * radius, end + 4 * radius)), view, centre)
    rim = Circle((0, 0), radius * MM, facecolor="white", edgecolor=FAINT, lw=0.8)
    axes.add_patch(rim)
    axes.add_collection(shown)
    shown.set_clip_path(rim)
    limit = 1.04 * radius * MM
    axes.set(xlim=(-limit, limit), ylim=(-limit, limit))
    axes.set_aspect("equal")
    axes.axis("off")
    diameter = number(equilibrium.robot.tubes[tube].outer_diameter * MM, 3)
    name = f"tube {tube + 1}, \N{EMPTY SET} {diameter} mm"
    axes.text(0, 1.08 * radius * MM, name, color=tube_colour(tube), ha="center", va="bottom")
    at = view.project(centre)
    ring = Circle((at[0], at[1]), radius * MM, fill=False, edgecolor=FAINT, lw=0.6, zorder=5)
    scene.add_patch(ring)
    link = ConnectionPatch(
        xyA=(at[0] + radius * MM, at[1]),
        coordsA=scene.transData,
        xyB=(-radius * MM, 0),
        coordsB=axes.transData,
        color=FAINT,
        lw=0.5,
        alpha=0.7,
    )
    link.set_in_layout(False)
    axes.add_artist(link)


def _draw_scale_bar(axes: Axes) -> None:
    """A bar of a round length below a close-up."""
    low, high = axes.get_xlim()
    length, y = rule_step(high - low), 1.1 * low
    axes.plot([-length / 2, length / 2], [y, y], color=INK, lw=1.5, solid_capstyle="butt", clip_on=False)
    axes.annotate(f"{number(length, 3)} mm", (0, y), (0, -3), textcoords="offset points", ha="center", va="top")
