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
from ...planning import Deployment
from ...typing import Array
from ..page import tube_colour
from ..surfaces import Detail, SampledCentreline, TubeGroup, tube_groups
from .labels import names_above, note, rules_at
from .panels import ROTATION, PanelScale, draw_over
from .projection import Projection, SceneBox, facets, rule_step
from .scene import PRINTED, DrawnArm, DrawnTarget, PlotScene, close_up_radius, draw_scene, robot_mesh
from .style import FAINT, INK, Axes, Figure, caption, disk, entitle, headed, narrow, new_figure, number, picture

GHOST_OPACITY = 0.25

GHOSTS = 4
"""Largest number of arms on the way of a motion."""

UNSTABLE = "#A02020"

CLOSE_UP = Detail(72, 24, even=True)
"""Facets of an arm in a close-up."""


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
        remark: additional line of the heading, such as the meaning of the ghosts.
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
def plot_deployment(deployment: Deployment, *, view: tuple[float, float] | None = None) -> Figure:
    """Picture of the end of a deployment among its walls, with the arm on the way translucent.

    Args:
        deployment: of `deploy`.
        view: as in `plot_shape`.
    """
    *way, last = deployment.equilibria
    shown = np.unique(np.linspace(0, len(way) - 1, GHOSTS).round().astype(int)).tolist() if way else []
    remark = f"deployed: largest contact force {number(TO_MILLI * deployment.largest_force, 1)} mN"
    figure = new_figure(7.0, 5.4)
    headed(figure, f"{caption(last)}\n{remark}")
    draw_scenes(figure, [last], [[way[k] for k in shown]], view)
    return figure


@picture
def plot_equilibria(equilibria: Sequence[Equilibrium], *, view: tuple[float, float] | None = None) -> Figure:
    """Picture of all equilibria at the same joint values, the first solid, the others translucent.

    Unstable ones have a dashed line along them. Each has its number at the tip, with margin and energy below.

    Args:
        equilibria: of `find_equilibria`, the lowest energy first.
        view: as in `plot_shape`.
    """
    from matplotlib.lines import Line2D

    lowest, *ghosts = equilibria
    figure = new_figure(7.0, 5.4)
    headed(figure, f"{caption(lowest)}\n{len(equilibria)} equilibria at these joint values")
    (scene,), projection = draw_scenes(figure, [lowest], [ghosts], view)
    handles = []
    for k, each in enumerate(equilibria, start=1):
        line = projection.project(SampledCentreline(each).position(np.linspace(0, each.arc_length[-1], 80)))
        if not each.stable:
            scene.plot(line[:, 0], line[:, 1], color=UNSTABLE, lw=1.2, ls=(0, (3, 2)), zorder=5)
        colour = INK if each.stable else UNSTABLE
        note(scene, str(k), line[-1, :2], (0.0, 4.0 if k > 1 else 14.0), colour=colour)
        label = f"{k}: {'stable' if each.stable else 'unstable'}, margin {number(each.margin, 3)}, "
        label += f"{number(each.energy * TO_MILLI, 3)} mJ"
        look = {"lw": 2.2, "alpha": 1.0 if k == 1 else 0.4} if each.stable else {"lw": 1.2, "ls": (0, (3, 2))}
        handles.append(Line2D([], [], color=colour, label=label, **look))
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


class Scenes(NamedTuple):
    """Scenes of a figure, and the view that they share."""

    axes: list[Axes]
    view: Projection


def draw_scenes(
    figure: Figure,
    equilibria: Sequence[Equilibrium],
    ghosts: Sequence[Sequence[Equilibrium]],
    view: tuple[float, float] | None,
    *,
    targets: Sequence[DrawnTarget] = (),
    close_ups: bool = True,
) -> Scenes:
    """Fill `figure` with a scene for each equilibrium and its ghosts, all in one view and in equal boxes.

    Args:
        targets: drawn in every scene.
        close_ups: add a column with close-ups of the last equilibrium at the right.
    """
    scenes = [
        PlotScene(
            [DrawnArm(equilibrium), *(DrawnArm(ghost, GHOST_OPACITY) for ghost in some)],
            bodies=() if equilibrium.walls is None else equilibrium.walls.bodies,
            targets=targets,
            detail=PRINTED,
            plate=True,
            named=equilibrium,
        )
        for equilibrium, some in zip(equilibria, ghosts, strict=True)
    ]
    # One view and one box for all, ghosts included: only then are the shapes comparable.
    everyone = PlotScene([arm for scene in scenes for arm in scene.arms])
    projection, box = everyone.view(view), SceneBox.around(np.concatenate([scene.extent() for scene in scenes]))
    last = equilibria[-1]
    ends = tube_groups(last) if close_ups else []
    widths = [3.6 if len(equilibria) == 1 else 2.4] * len(equilibria) + [1.0] * close_ups
    grid = figure.add_gridspec(max(len(ends), 3) if close_ups else 1, len(widths), width_ratios=widths)
    panels = [figure.add_subplot(grid[:, column]) for column in range(len(equilibria))]
    for axes, scene in zip(panels, scenes, strict=True):
        draw_scene(axes, scene, projection, box)
    for row, bundle in enumerate(reversed(ends)):
        close_up = figure.add_subplot(grid[row, -1])
        _draw_close_up(close_up, panels[-1], last, bundle, projection)
        if row == len(ends) - 1:
            # A bar of a round length, a quarter of the width or less.
            low, high = close_up.get_xlim()
            length, y = rule_step(high - low), 1.1 * low
            close_up.plot([-length / 2, length / 2], [y, y], color=INK, lw=1.5, solid_capstyle="butt", clip_on=False)
            close_up.text(0, 1.05 * y, f"{number(length, 3)} mm", ha="center", va="top")
    return Scenes(panels, projection)


def _draw_close_up(axes: Axes, scene: Axes, equilibrium: Equilibrium, bundle: TubeGroup, view: Projection) -> None:
    """Draw a close-up of the end of a tube or segment in a circle, and the circle in the scene."""
    from matplotlib.patches import ConnectionPatch, PathPatch
    from matplotlib.path import Path

    radius, end = close_up_radius(equilibrium), bundle.end
    radius_mm = radius * TO_MM
    centre = SampledCentreline(equilibrium).position([end])[0]
    # Four radii either way also fill the circle where the arm is seen at a slant of 15 deg.
    mesh = robot_mesh(equilibrium, window=(end - 4 * radius, end + 4 * radius), detail=CLOSE_UP)
    corners = view.project(mesh.corners - centre)[..., :2]
    middle = corners.mean(1)
    # Triangle inequality: no point of a facet is nearer to the centre than its middle less its reach.
    reach = np.linalg.norm(corners - middle[:, None], axis=2).max(1)
    inside = np.linalg.norm(middle, axis=1) - reach < 1.05 * radius_mm
    axes.add_collection(facets(mesh.only(inside), view, centre), autolim=False)
    limit = 1.04 * radius_mm
    # What leaves the circle is covered: to clip every facet takes vector formats twice as long.
    frame = Path(2 * limit * np.array([(-1, -1), (-1, 1), (1, 1), (1, -1), (-1, -1)]))
    around = Path.make_compound_path(frame, Path.circle(radius=radius_mm))
    axes.add_patch(PathPatch(around, facecolor="white", edgecolor="none", zorder=4))
    disk(axes, (0, 0), radius_mm, fill=False, ec=FAINT, lw=0.8, zorder=5)
    axes.set(xlim=(-limit, limit), ylim=(-limit, limit))
    axes.set_aspect("equal")
    axes.axis("off")
    first = bundle.tubes[0]
    diameter = number(equilibrium.robot.tubes[first].outer_diameter * TO_MM, 3)
    if len(bundle.tubes) == 1:
        name, colour = f"tube {first + 1}, \N{EMPTY SET} {diameter} mm", tube_colour(first)
    else:
        name, colour = f"tubes {first + 1}\N{EN DASH}{bundle.tubes[-1] + 1}, \N{EMPTY SET} {diameter} mm", INK
    axes.text(0, 1.08 * radius_mm, name, color=colour, ha="center", va="bottom")
    x, y, _ = view.project(centre)
    disk(scene, (x, y), radius_mm, fill=False, ec=FAINT, lw=0.6, zorder=5)
    ends: dict[str, Any] = {
        "xyA": (x + radius_mm, y),
        "coordsA": scene.transData,
        "xyB": (-radius_mm, 0),
        "coordsB": axes.transData,
    }
    link = ConnectionPatch(**ends, color=FAINT, lw=0.5, alpha=0.7, zorder=4.5)
    link.set_in_layout(False)
    axes.add_artist(link)


# Smaller jumps are errors of the cubics between points.
JUMP = 1e-3
"""Smallest jump of theta' across a breakpoint that is drawn as one, over the range of theta'."""

TWIST = PanelScale("rotation \N{GREEK SMALL LETTER THETA} (deg)", ROTATION.factor, min_span=20.0)
TORSION = PanelScale("torsion \N{GREEK SMALL LETTER THETA}\N{PRIME} (deg/mm)", ROTATION.factor / TO_MM, min_span=0.02)


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
    """Two panels for each equilibrium; the arrows at the left edge are the rotations imposed behind the plate."""
    count = len(equilibria)
    width = 7.0 if count == 1 else 4.0 * count
    figure = new_figure(width, 5.0)
    panels = figure.subplots(2, count, sharex=True, sharey="row", squeeze=False)
    length = max(float(each.tube_end.max()) for each in equilibria)
    panels[0, 0].set_xlim(0, 1.02 * TO_MM * length if length > 0 else 1.0)
    for (above, below), equilibrium, title in zip(panels.T, equilibria, titles, strict=True):
        # Outer tubes first, so that inner ones lie on them.
        for i, end in reversed(list(enumerate(equilibrium.tube_end.tolist()))):
            curve = _torsion_curve(equilibrium, i, end)
            look: dict[str, Any] = {"color": tube_colour(i), "clip_on": False}
            for axes, values, scale in ((above, curve.theta, TWIST), (below, curve.slope, TORSION)):
                x: Array = curve.s * TO_MM
                name, width = f"tube {i + 1}", 1.2 + 0.9 * i
                draw_over(axes, x, values, scale, name=name, lw=width, solid_capstyle="butt", **look)
                if end > 0:
                    axes.plot(x[-1:], scale.factor * values[-1:], "o", ms=3.6 + 0.9 * i, zorder=4, **look)
            # The distance of this mark to the curve is the wind-up behind the plate.
            mark = {"mfc": "white", "mec": tube_colour(i), "ms": 5 + 2 * i, "clip_on": False, "zorder": 5}
            above.plot([0], np.degrees(equilibrium.rotations[[i]]), ">", **mark)
        breaks = breakpoints(equilibrium)
        rows = names_above(above, breaks, panel_width=0.85 * float(figure.get_figwidth()) / count)
        rules_at((above, below), breaks)
        for axes in (above, below):
            axes.grid(axis="y")
        below.set_xlabel("arc length s from the base plate (mm)")
        entitle(above, caption(equilibrium, title, narrow=count > 1), pad=8 + 9 * rows)
        for axes in (above, below):
            axes.label_outer()
    handles, names = panels[0, 0].get_legend_handles_labels()
    (mark,) = panels[0, 0].plot([], [], ">", mfc="white", mec=INK, ms=6)
    figure.legend(
        [*reversed(handles), mark],
        [*reversed(names), "rotation imposed behind the plate"],
        loc="outside lower center",
        ncols=len(handles) + 1,
        handlelength=1.8,
        columnspacing=1.6,
    )
    return figure


class TorsionCurve(NamedTuple):
    """Rotation and torsion of one tube, NaN between both values where theta' jumps."""

    s: Array
    """(k,) arc length, m."""
    theta: Array
    """(k,) rotations along the arm, rad."""
    slope: Array
    """(k,) torsion theta', rad/m."""


def _torsion_curve(equilibrium: Equilibrium, tube: int, end: float) -> TorsionCurve:
    """Curves of one tube up to its `end`, cubic between the points of a section.

    theta' jumps from one section to the next where the natural twist does, as between an arc and a helix.
    """
    inside = equilibrium.arc_length <= end + 1e-12
    s = equilibrium.arc_length[inside]
    theta, slope = equilibrium.rotation[tube, inside], equilibrium.torsion[tube, inside]
    if len(s) < 2:
        return TorsionCurve(s, theta, slope)
    # theta is smooth within a section only: a cubic across a breakpoint would round off the jump of theta'.
    cuts = np.unique(np.searchsorted(s, [0.0, *equilibrium.section_start, s[-1]] - np.array(1e-12)))
    parts: list[Array] = []
    for first, last in pairwise(cuts[cuts < len(s)]):
        stretch = slice(first, last + 1)
        slopes = slope[stretch].copy()
        if first > 0:
            # The result holds theta' in front of a jump; behind it theta' follows from the points of the section.
            # Krogh's polynomial takes a repeated abscissa as value and slope. At the first point the slope is the
            # unknown: one value, then up to three values with slopes, seven conditions, degree 6. Arc length is
            # counted from the point, where high powers lose the fewest digits.
            points = first + np.r_[0, np.repeat(np.arange(1, min(last + 1 - first, 4)), 2)]
            conditions = theta[points]
            conditions[2::2] = slope[points[2::2]]
            slopes[0] = scipy.interpolate.KroghInterpolator(s[points] - s[first], conditions).derivative(0.0)
        # 300 points over the arm are finer than the pixels of a panel; points of the solution are kept.
        fine = np.union1d(s[stretch], np.linspace(s[first], s[last], 2 + int(300 * (s[last] - s[first]) / s[-1])))
        cubic = scipy.interpolate.CubicHermiteSpline(s[stretch], theta[stretch], slopes)
        if parts and abs(slopes[0] - slope[first]) > JUMP * np.ptp(slope):
            parts.append(np.full((3, 1), np.nan))
        parts.append(np.array([fine, cubic(fine), cubic(fine, 1)]))
    return TorsionCurve(*np.concatenate(parts, axis=1))


def breakpoints(equilibrium: Equilibrium) -> dict[float, str]:
    """Arc lengths in front of the plate, mm, and their events, such as "tube 2 curves" and "tube 3 ends"."""
    events: dict[float, list[str]] = {}
    for i, tube in enumerate(equilibrium.robot.tubes):
        end = float(equilibrium.tube_end[i])
        for s, event in ((end - tube.curved_length, "curves"), (end, "ends")):
            # Behind the plate nothing is drawn, and a straight tube has no point where it begins to curve.
            if s > 1e-9 and (event == "ends" or tube.curved_length > 0):
                # Rounded to 1 nm, so that events at one point have one line and one name.
                events.setdefault(round(s * TO_MM, 6), []).append(f"{i + 1} {event}")
    return {s: "tube " + ", ".join(events[s]) for s in sorted(events)}
