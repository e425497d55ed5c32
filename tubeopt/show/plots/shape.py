"""Pictures of shapes and of the torsion of their tubes."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import scipy

from ...arguments import typed
from ...equilibrium.result import Equilibrium
from ...errors import InputError
from ...files.units import TO_MILLI, TO_MM
from ...typing import Array, Mask
from ..page import tube_colour
from ..surfaces import Bundle, Centreline, Detail, bundles, plate_part, plate_radius, robot_parts, visible
from .stage import Box, Mesh, View, draw_arrow, draw_box, facets, mesh_of, note, rule_step, widest_view
from .style import (
    FAINT,
    INK,
    Axes,
    Figure,
    caption,
    disk,
    entitle,
    headed,
    name_above,
    narrow,
    new_figure,
    number,
    picture,
    widen,
)

GHOST_OPACITY = 0.25
LINE_HEIGHT = 11.0
"""Points by which names of tubes stand apart."""

SCENE_HEIGHT = 250.0
"""Points that a scene is high, about."""

UNSTABLE = "#A02020"

FORCE = "#7A3E9D"
MOMENT = "#9C5A00"
FORCE_SHARE = 0.2
"""Length of the arrow of the largest force, as a share of the arm."""

COMB = 10
"""Arrows of a load per length."""

SECOND_HEAD = 0.8
"""Where the second head of a moment's arrow lies, as a share of its length."""

PRINTED, CLOSE_UP = Detail(24, 160, even=True), Detail(72, 24, even=True)
"""How finely arms are cut in a scene, and where they are seen from near."""


@picture
@typed
def plot_shape(
    equilibrium: Equilibrium,
    *,
    ghosts: Sequence[Equilibrium] = (),
    view: tuple[float, float] | None = None,
    remark: str = "",
) -> Figure:
    """Picture of the robot's shape to scale, with close-ups of the ends of its tubes.

    Args:
        ghosts: other equilibria, drawn translucent.
        remark: a line more of the heading, as of what the ghosts are.
        view: elevation and azimuth of the viewer, deg; None looks across the widest side of the shape.

    Examples:
        >>> import tempfile
        >>> from pathlib import Path
        >>> import tubeopt
        >>> pose = tubeopt.load_robot("two_tube").fk([0.5, 0.0])
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     figure = tubeopt.plot_shape(pose, f"{folder}/shape.png")
        ...     Path(folder, "shape.png").exists()
        True
    """
    figure = new_figure(7.0, 5.0)
    headed(figure, "\n".join(filter(None, (caption(equilibrium), remark))))
    draw_scenes(figure, [equilibrium], [ghosts], view)
    return figure


@picture
def plot_equilibria(equilibria: Sequence[Equilibrium], *, view: tuple[float, float] | None = None) -> Figure:
    """Picture of all equilibria at the same joint values: the first solid, the others translucent, unstable ones with a
    dashed line along them; each numbered at its tip, with margin and energy below.

    Args:
        equilibria: of `find_equilibria`, the lowest energy first.
        view: as in `plot_shape`.
    """
    from matplotlib.lines import Line2D

    lowest, *others = equilibria
    figure = new_figure(7.0, 5.4)
    headed(figure, f"{caption(lowest)}\n{len(equilibria)} equilibria at these joint values")
    (scene,), seen = draw_scenes(figure, [lowest], [others], view)
    handles = []
    for k, each in enumerate(equilibria, start=1):
        way = seen.project(Centreline(each).position(np.linspace(0, each.arc_length[-1], 80)))
        if not each.stable:
            scene.plot(way[:, 0], way[:, 1], color=UNSTABLE, lw=1.2, ls=(0, (3, 2)), zorder=5)
        colour = INK if each.stable else UNSTABLE
        note(scene, str(k), way[-1, :2], np.array([0.0, 4.0 if k > 1 else 14.0]), colour=colour)
        words = f"{k}: {'stable' if each.stable else 'unstable'}, margin {number(each.margin, 3)}, "
        words += f"{number(each.energy * TO_MILLI, 3)} mJ"
        look = {"lw": 2.2, "alpha": 1.0 if k == 1 else 0.4} if each.stable else {"lw": 1.2, "ls": (0, (3, 2))}
        handles.append(Line2D([], [], color=colour, label=words, **look))
    figure.legend(handles=handles, loc="outside lower left", ncols=1 if narrow() else 2)
    return figure


@picture
@typed
def plot_shapes(
    equilibria: Sequence[Equilibrium],
    *,
    titles: Sequence[str] | None = None,
    view: tuple[float, float] | None = None,
    heading: str = "",
) -> Figure:
    """Picture of several shapes side by side, from one side and at one scale; close-ups of the last one.

    Args:
        equilibria: what to draw, left to right.
        view: as in `plot_shape`.
        titles: a heading for each; None is the robot's name.   heading: above all of them.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("two_tube")
        >>> figure = tubeopt.plot_shapes([robot.fk([0, 0]), robot.fk([1, 0])], titles=["home", "turned"])
        >>> len(figure.axes)
        3
    """
    if not equilibria:
        raise InputError("equilibria is empty; it must have at least one equilibrium")
    if titles is not None and len(titles) != len(equilibria):
        raise InputError(f"titles has {len(titles)} texts; it must have one for each of {len(equilibria)} equilibria")
    figure = new_figure(1.6 + 2.8 * len(equilibria), 4.8)
    scenes, _ = draw_scenes(figure, equilibria, [()] * len(equilibria), view)
    for scene, equilibrium, title in zip(scenes, equilibria, titles or [""] * len(equilibria), strict=True):
        scene.set_title(caption(equilibrium, title, narrow=True), fontsize=8, loc="left")
    return headed(figure, heading)


def draw_scenes(
    figure: Figure,
    equilibria: Sequence[Equilibrium],
    ghosts: Sequence[Sequence[Equilibrium]],
    view: tuple[float, float] | None,
    *,
    close_ups: bool = True,
) -> tuple[list[Axes], View]:
    """Fill `figure` with a scene for each equilibrium and its ghosts; return the scenes, and how they are seen.

    With `close_ups`, a column of close-ups of the last equilibrium stands to the right.
    """
    everyone = [*equilibria, *(ghost for some in ghosts for ghost in some)]
    # One view for all, ghosts included: only then are the shapes comparable.
    seen = View(*view) if view is not None else widest_view(np.concatenate([each.position for each in everyone]))
    meshes = [_scene_mesh(equilibrium, some) for equilibrium, some in zip(equilibria, ghosts, strict=True)]
    # Heads of arrows count for the box, or a force at the outermost tip would leave it.
    heads = [arrow.end for equilibrium in equilibria for arrow in pushes(equilibrium)]
    box = Box.around(np.concatenate([*(mesh.corners.reshape(-1, 3) for mesh in meshes), np.reshape(heads, (-1, 3))]))
    last = equilibria[-1]
    ends = bundles(last) if close_ups else []
    widths = [3.6 if len(equilibria) == 1 else 2.4] * len(equilibria) + [1.0] * close_ups
    grid = figure.add_gridspec(max(len(ends), 3) if close_ups else 1, len(widths), width_ratios=widths)
    scenes = [figure.add_subplot(grid[:, column]) for column in range(len(equilibria))]
    for scene, equilibrium, some, mesh in zip(scenes, equilibria, ghosts, meshes, strict=True):
        draw_box(scene, box, seen)
        _draw_shadows(scene, [equilibrium, *some], box, seen)
        scene.add_collection(facets(mesh.in_sight(seen.towards_viewer), seen), autolim=False)
        if visible(equilibrium):
            _name_tubes(scene, equilibrium, seen)
        _draw_pushes(scene, equilibrium, seen)
    for row, bundle in enumerate(reversed(ends)):
        close_up = figure.add_subplot(grid[row, -1])
        _draw_close_up(close_up, scenes[-1], last, bundle, seen)
        if row == len(ends) - 1:
            _draw_scale_bar(close_up)
    return scenes, seen


class Arrow(NamedTuple):
    """A force or a moment in a picture: where it acts and where its arrow ends (3,), m; its size, N or N m."""

    start: Array
    end: Array
    size: float
    unit: str
    colour: str
    told: bool = True
    """Whether its size stands beside it."""


def pushes(equilibrium: Equilibrium) -> list[Arrow]:
    """Each force and each moment on the arm, at the tip, then along the arm; moments point along their axes.

    The largest arrow of a kind is FORCE_SHARE of the arm long, the others in proportion.
    """
    load = equilibrium.load
    if load is None:
        return []
    # A following load is given in the frame of the tip, and is drawn in that of the plate.
    turned = equilibrium.tip_rotation if load.frame == "tip" else np.eye(3)
    line = Centreline(equilibrium) if load.points else None
    places = [line.position([part.at])[0] for part in load.points if line is not None]
    out = []
    for kind, unit, colour in (("force", "mN", FORCE), ("moment", "mN m", MOMENT)):
        acting = [turned @ getattr(load, kind), *(np.array(getattr(part, kind)) for part in load.points)]
        sizes = [float(np.linalg.norm(each)) for each in acting]
        # Forces and moments have scales of their own: N and N m cannot be compared.
        scale = FORCE_SHARE * float(equilibrium.arc_length[-1]) / (max(sizes) or 1.0)
        for at, push, size in zip((equilibrium.tip_position, *places), acting, sizes, strict=True):
            if size > 0:
                out.append(Arrow(at, at + scale * push, size, unit, colour))
    return out + _along(equilibrium)


def _along(equilibrium: Equilibrium) -> list[Arrow]:
    """COMB arrows of the load per length along the arm, the largest half as long as that of a force, with its size."""
    load, length = equilibrium.load, float(equilibrium.arc_length[-1])
    if load is None or load.distributed is None:
        return []
    # Midpoints of equal intervals: no arrow at the ends, where point loads are.
    s = length * (np.arange(COMB) + 0.5) / COMB
    per_length, places, out = load.per_length(s), Centreline(equilibrium).position(s), []
    for part, unit, colour in ((slice(0, 3), "mN/m", FORCE), (slice(3, 6), "mN m/m", MOMENT)):
        sizes = np.linalg.norm(per_length[:, part], axis=1)
        largest = int(sizes.argmax())
        for k in np.flatnonzero(sizes > 0).tolist():
            end = places[k] + 0.5 * FORCE_SHARE * length * per_length[k, part] / sizes[largest]
            out.append(Arrow(places[k], end, float(sizes[k]), unit, colour, k == largest))
    return out


def _draw_pushes(scene: Axes, equilibrium: Equilibrium, view: View) -> None:
    """An arrow from where each force and moment acts, with its size; that of a moment has two heads."""
    for arrow in pushes(equilibrium):
        draw_arrow(scene, view, arrow.start, arrow.end, arrow.colour)
        if arrow.unit.startswith("mN m"):
            draw_arrow(scene, view, arrow.start, arrow.start + SECOND_HEAD * (arrow.end - arrow.start), arrow.colour)
        if not arrow.told:
            continue
        tail, end = view.project(np.array([arrow.start, arrow.end]))[:, :2]
        along = (end - tail) / max(float(np.linalg.norm(end - tail)), 1e-9)
        note(scene, f"{arrow.size * TO_MILLI:.4g} {arrow.unit}", end, 4 * along, colour=arrow.colour)


def robot_mesh(
    equilibrium: Equilibrium,
    *,
    opacity: float = 1.0,
    window: tuple[float, float] | None = None,
    detail: Detail = PRINTED,
) -> Mesh:
    """Surfaces of all tubes in m, as `robot_parts` tells."""
    return mesh_of(robot_parts(equilibrium, detail, window), opacity)


def _plate_mesh(radius: float) -> Mesh:
    """The base plate of a radius, m, cut fine enough to be sorted by depth."""
    return mesh_of([plate_part(radius, rings=6, sides=120)])


def draw_plate(axes: Axes, points: Array, view: View) -> None:
    """A base plate in proportion to points (k, 3), m, and the ruled box around both."""
    plate = _plate_mesh(0.07 * float(np.abs(points).max()))
    draw_box(axes, Box.around(np.concatenate([points, plate.corners.reshape(-1, 3)])), view)
    axes.add_collection(facets(plate, view))


def _scene_mesh(equilibrium: Equilibrium, ghosts: Sequence[Equilibrium]) -> Mesh:
    """The robot on its plate, and the ghosts."""
    # One mesh, since facets of ghosts and robot hide each other and must be sorted together.
    parts = [_plate_mesh(plate_radius(equilibrium)), robot_mesh(equilibrium)]
    return Mesh.join(parts + [robot_mesh(ghost, opacity=GHOST_OPACITY) for ghost in ghosts])


def _draw_shadows(axes: Axes, equilibria: Sequence[Equilibrium], box: Box, view: View) -> None:
    """Every centreline as it falls straight down onto the floor."""
    for equilibrium in equilibria:
        fallen = equilibrium.position.copy()
        # The box is in mm, positions are in m.
        fallen[:, 2] = box.low[2] / TO_MM
        shadow = view.project(fallen)
        axes.plot(shadow[:, 0], shadow[:, 1], color=FAINT, lw=1.3, alpha=0.4, solid_capstyle="round", zorder=1)


def _name_tubes(axes: Axes, equilibrium: Equilibrium, view: View) -> None:
    """Name each tube to the lower right of the middle of where it shows, and the tip to the upper left of it."""
    line = Centreline(equilibrium)
    # Where the picture is on paper is known after its layout only; a scene is about SCENE_HEIGHT points high.
    low, high = axes.get_ylim()
    points_per_mm = SCENE_HEIGHT / max(high - low, 1e-9)
    lowest = np.inf
    for bundle in bundles(equilibrium):
        middle = (bundle.start + bundle.end) / 2
        beside = _beside(line, middle, view)
        at = view.project(line.position([middle])[0])[:2] + bundle.radius * TO_MM * beside
        for row, i in enumerate(bundle.tubes):
            lower = np.array([0.0, 10.0 * ((len(bundle.tubes) - 1) / 2 - row)])
            several = len(bundle.tubes) > 1
            shift = (12 if several else 5) * beside + lower
            height = at[1] * points_per_mm + shift[1]
            crowded = max(0.0, LINE_HEIGHT - abs(height - lowest)) if np.isfinite(lowest) else 0.0
            shift = shift + np.array([0.0, crowded if height >= lowest else -crowded])
            lowest = at[1] * points_per_mm + shift[1]
            note(axes, f"tube {i + 1}", at, shift, colour=tube_colour(i), level=several or crowded > 0)
    beside = _beside(line, line.length, view)
    at = view.project(equilibrium.tip_position)[:2] - close_up_radius(equilibrium) * TO_MM * beside
    note(axes, "tip", at, -3 * beside)


def _beside(line: Centreline, s: float, view: View) -> Array:
    """(2,) unit vector in the picture, square to the arm at arc length `s`, to its right if it points upwards."""
    tangent = view.project(line.axes(np.array([s])).tangent[0])[:2]
    beside = np.array([tangent[1], -tangent[0]])
    length = float(np.linalg.norm(beside))
    return beside / length if length > 1e-9 else np.array([1.0, 0.0])


def close_up_radius(equilibrium: Equilibrium) -> float:
    """Radius of what a close-up shows, m: a tube, and all that the widest sheath of an eccentric robot holds."""
    diameter = np.array([tube.outer_diameter for tube in equilibrium.robot.tubes])
    # Twice the offset of a tube's axis, plus its diameter, is the width of the bundle around the arm's axis.
    across = diameter + 2 * equilibrium.robot.assembly(equilibrium.translations).offset
    return float(max(1.7 * diameter.max(), 1.1 * across.max()))


def _draw_close_up(axes: Axes, scene: Axes, equilibrium: Equilibrium, bundle: Bundle, view: View) -> None:
    """The end of a tube, or of a segment, seen from the same side, in a circle that is drawn in the scene too."""
    from matplotlib.patches import ConnectionPatch, PathPatch
    from matplotlib.path import Path

    radius, end = close_up_radius(equilibrium), bundle.end
    centre = Centreline(equilibrium).position([end])[0]
    # Four radii either way also fill the circle where the arm is seen at a slant of 15 deg.
    mesh = robot_mesh(equilibrium, window=(end - 4 * radius, end + 4 * radius), detail=CLOSE_UP)
    shown = facets(mesh.only(_within(view.project(mesh.corners - centre), radius * TO_MM)), view, centre)
    axes.add_collection(shown, autolim=False)
    limit = 1.04 * radius * TO_MM
    # What leaves the circle is covered: to clip every facet takes vector formats twice as long.
    frame = Path(2 * limit * np.array([(-1, -1), (-1, 1), (1, 1), (1, -1), (-1, -1)]))
    around = Path.make_compound_path(frame, Path.circle(radius=radius * TO_MM))
    axes.add_patch(PathPatch(around, facecolor="white", edgecolor="none", zorder=4))
    disk(axes, (0, 0), radius * TO_MM, fill=False, ec=FAINT, lw=0.8, zorder=5)
    axes.set(xlim=(-limit, limit), ylim=(-limit, limit))
    axes.set_aspect("equal")
    axes.axis("off")
    first = bundle.tubes[0]
    diameter = number(equilibrium.robot.tubes[first].outer_diameter * TO_MM, 3)
    if len(bundle.tubes) == 1:
        name, colour = f"tube {first + 1}, \N{EMPTY SET} {diameter} mm", tube_colour(first)
    else:
        name, colour = f"tubes {first + 1}\N{EN DASH}{bundle.tubes[-1] + 1}, \N{EMPTY SET} {diameter} mm", INK
    axes.text(0, 1.08 * radius * TO_MM, name, color=colour, ha="center", va="bottom")
    at = view.project(centre)
    disk(scene, at[:2], radius * TO_MM, fill=False, ec=FAINT, lw=0.6, zorder=5)
    link = ConnectionPatch(
        xyA=(at[0] + radius * TO_MM, at[1]),
        coordsA=scene.transData,
        xyB=(-radius * TO_MM, 0),
        coordsB=axes.transData,
        color=FAINT,
        lw=0.5,
        alpha=0.7,
        zorder=4.5,
    )
    link.set_in_layout(False)
    axes.add_artist(link)


def _within(corners: Array, radius: float) -> Mask:
    """(k,) whether anything of facets, as seen (k, 4, 3), may show in a circle about the origin."""
    middle = corners[..., :2].mean(1)
    # Triangle inequality: no point of a facet is nearer to the origin than its middle less its reach.
    reach = np.linalg.norm(corners[..., :2] - middle[:, None], axis=2).max(1)
    inside: Mask = np.linalg.norm(middle, axis=1) - reach < 1.05 * radius
    return inside


def _draw_scale_bar(axes: Axes) -> None:
    """A bar of a round length below a close-up."""
    low, high = axes.get_xlim()
    # A quarter of the width or less, of a round length.
    length, y = rule_step(high - low), 1.1 * low
    axes.plot([-length / 2, length / 2], [y, y], color=INK, lw=1.5, solid_capstyle="butt", clip_on=False)
    axes.text(0, 1.05 * y, f"{number(length, 3)} mm", ha="center", va="top")


JUMP = 1e-3
"""Share of the range of theta' from which a difference across a breakpoint is drawn as a jump."""


@picture
def plot_torsion(equilibrium: Equilibrium) -> Figure:
    """Picture of the rotation and the torsion of every tube over arc length.

    theta_i(s) in deg stands above theta_i'(s) in deg/mm; each curve ends where its tube ends, and theta' is broken
    where it jumps. Curves of outer tubes are thicker, so that curves that coincide stay visible inside one another.
    """
    return _torsions([equilibrium], [""])


@picture
def plot_torsions(
    equilibria: Sequence[Equilibrium],
    *,
    titles: Sequence[str] | None = None,
) -> Figure:
    """`plot_torsion` of several equilibria of one robot side by side, with the same scales.

    Args:
        equilibria: what to draw, left to right.
        titles: a heading for each; None is the robot's name.
    """
    return _torsions(equilibria, titles or [""] * len(equilibria))


def _torsions(equilibria: Sequence[Equilibrium], titles: Sequence[str]) -> Figure:
    count = len(equilibria)
    figure = new_figure(7.0 if count == 1 else 4.0 * count, 5.0)
    panels = figure.subplots(2, count, sharex=True, sharey="row", squeeze=False)
    for (above, below), equilibrium, title in zip(panels.T, equilibria, titles, strict=True):
        _draw_curves(above, below, equilibrium)
        _draw_inputs(above, equilibrium)
        rows = _mark_sections(above, below, equilibrium, room=0.12 if count == 1 else 0.22)
        below.set_xlabel("arc length s from the base plate (mm)")
        entitle(above, caption(equilibrium, title, narrow=count > 1), pad=8 + 9 * rows)
    above, below = panels[:, 0]
    above.set_ylabel("rotation \N{GREEK SMALL LETTER THETA} (deg)")
    below.set_ylabel("torsion \N{GREEK SMALL LETTER THETA}\N{PRIME} (deg/mm)")
    length = max(float(each.tube_end.max()) for each in equilibria)
    below.set_xlim(0, 1.02 * TO_MM * length if length > 0 else 1.0)
    widen(above, 20.0)
    widen(below, 0.02)
    _add_legend(figure, above)
    return figure


def _draw_curves(above: Axes, below: Axes, equilibrium: Equilibrium) -> None:
    """theta_i in deg into `above` and theta_i' in deg/mm into `below`, up to the end of each tube."""
    for i, end in reversed(list(enumerate(equilibrium.tube_end))):
        s, rotation, torsion = _curve(equilibrium, i, float(end))
        for axes, values in ((above, np.degrees(rotation)), (below, np.degrees(torsion) / TO_MM)):
            look: dict[str, Any] = {"color": tube_colour(i), "clip_on": False}
            axes.plot(s * TO_MM, values, lw=1.2 + 0.9 * i, solid_capstyle="butt", label=f"tube {i + 1}", **look)
            if end > 0:
                axes.plot(s[-1:] * TO_MM, values[-1:], "o", ms=3.6 + 0.9 * i, zorder=4, **look)
    for axes in (above, below):
        axes.grid(axis="y")


def _curve(equilibrium: Equilibrium, tube: int, end: float) -> tuple[Array, Array, Array]:
    """Arc length, theta and theta' of one tube up to its `end`, cubic between the points of a section.

    Where theta' jumps from one section to the next, as between an arc and a helix, NaN stands between both values.
    """
    inside = equilibrium.arc_length <= end + 1e-12
    s = equilibrium.arc_length[inside]
    rotation, torsion = equilibrium.rotation[tube, inside], equilibrium.torsion[tube, inside]
    if len(s) < 2:
        return s, rotation, torsion
    # theta is smooth within a section only: a cubic across a breakpoint would round off the jump of theta'.
    cuts = np.unique(np.searchsorted(s, [0.0, *equilibrium.section_start, s[-1]] - np.array(1e-12)))
    parts: list[Array] = []
    for first, last in pairwise(cuts[cuts < len(s)]):
        own = slice(first, last + 1)
        slopes = torsion[own].copy()
        if first > 0:
            slopes[0] = _first_slope(s[own], rotation[own], torsion[own])
        # 300 points over the arm are finer than the pixels of a panel; points of the solution are kept.
        fine = np.union1d(s[own], np.linspace(s[first], s[last], 2 + int(300 * (s[last] - s[first]) / s[-1])))
        curve = scipy.interpolate.CubicHermiteSpline(s[own], rotation[own], slopes)
        if parts and abs(slopes[0] - torsion[first]) > JUMP * np.ptp(torsion):
            parts.append(np.full((3, 1), np.nan))
        parts.append(np.array([fine, curve(fine), curve(fine, 1)]))
    arc_length, angle, slope = np.concatenate(parts, axis=1)
    return arc_length, angle, slope


def _first_slope(s: Array, rotation: Array, torsion: Array) -> float:
    """theta' where a section begins, from what stands behind it: the answer holds the value in front of a jump."""
    # Krogh's polynomial takes a repeated abscissa as value and slope. At the first point the slope is the unknown.
    # One value, then up to three values with slopes: seven conditions, degree 6.
    points = np.r_[0, np.repeat(np.arange(1, min(len(s), 4)), 2)]
    values = rotation[points]
    values[2::2] = torsion[points[2::2]]
    # Arc length is counted from the point, where high powers lose the fewest digits.
    slope = scipy.interpolate.KroghInterpolator(s[points] - s[0], values).derivative(0.0)
    return float(slope)


def _draw_inputs(axes: Axes, equilibrium: Equilibrium) -> None:
    """The rotation imposed behind the plate, at the left edge: its distance to the curve is the wind-up there."""
    for i, rotation in reversed(list(enumerate(np.degrees(equilibrium.rotations)))):
        axes.plot([0], [rotation], ">", mfc="white", mec=tube_colour(i), ms=5 + 2 * i, clip_on=False, zorder=5)


def _add_legend(figure: Figure, axes: Axes) -> None:
    """Names of the curves in `axes` and of the sign of an input, below all panels."""
    handles, labels = axes.get_legend_handles_labels()
    (mark,) = axes.plot([], [], ">", mfc="white", mec=INK, ms=6)
    figure.legend(
        [*reversed(handles), mark],
        [*reversed(labels), "rotation imposed behind the plate"],
        loc="outside lower center",
        ncols=len(handles) + 1,
        handlelength=1.8,
        columnspacing=1.6,
    )


def breakpoints(equilibrium: Equilibrium) -> dict[float, str]:
    """What happens at which arc length in front of the plate, mm: "tube 2 curves", "tube 3 ends"."""
    events: dict[float, list[str]] = {}
    for i, tube in enumerate(equilibrium.robot.tubes):
        end = float(equilibrium.tube_end[i])
        for s, what in ((end - tube.curved_length, "curves"), (end, "ends")):
            # Behind the plate nothing is drawn, and a straight tube has no place where it begins to curve.
            if s > 1e-9 and (what == "ends" or tube.curved_length > 0):
                # Rounded to 1 nm, so that events at one place have one line and one name.
                events.setdefault(round(s * TO_MM, 6), []).append(f"{i + 1} {what}")
    return {s: "tube " + ", ".join(events[s]) for s in sorted(events)}


def _mark_sections(above: Axes, below: Axes, equilibrium: Equilibrium, *, room: float) -> int:
    """A thin line at every breakpoint, named on top; return how many rows of names that took.

    Names less than `room` (a fraction of the width) apart go into different rows.
    """
    width = float(equilibrium.tube_end.max()) * TO_MM
    reached: list[float] = []
    # A name goes into the lowest row in which the last name ends far enough to the left.
    for s, what in breakpoints(equilibrium).items():
        for axes in (above, below):
            axes.axvline(s, color=FAINT, lw=0.6, ls=(0, (4, 3)), zorder=0)
        row = next((k for k, last in enumerate(reached) if s - last > room * width), len(reached))
        reached[row : row + 1] = [s]
        name_above(above, s, what, row)
    return len(reached)
