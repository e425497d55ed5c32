"""Motion through waypoints: tip and margin along the path, broken where the robot snaps."""

from __future__ import annotations

from functools import partial
from os import PathLike
from pathlib import Path as FilePath
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ...equilibrium.result import Equilibrium
from ...errors import InputError
from ...files.units import TO_MILLI, TO_MM
from ...stability import Path, Snap
from ...stability.following import stretches, value_at_snap
from ...typing import Array
from ..formatting import released
from .labels import arrow, legend_beside, names_above, note, rules_at
from .panels import MARGIN, PanelScale, draw_broken, share_x
from .projection import SceneBox, draw_box, widest_view
from .scene import DrawnArm, PlotScene, TipPath, draw_lines
from .shape import draw_scenes
from .style import (
    FAINT,
    INK,
    Axes,
    Figure,
    headed,
    millimetres,
    new_figure,
    number,
    picture,
    rotations_text,
    styled,
)
from .trajectory import film_ending, save_film

COORDINATES = (("x", "#D55E00"), ("y", "#009E73"), ("z", "#0072B2"))
"""Coordinates of the tip and their colours, from the palette of Okabe and Ito (2008)."""

TIP = PanelScale("tip position (mm)", TO_MM)

MAX_NAMES = 12
"""Largest number of named snaps that fit above the panel."""


@picture
def plot_path(path: Path) -> Figure:
    """Picture of a motion: tip position over the waypoints, and the margin below it.

    The curves have the points of `path.dense`, those between waypoints included. At a snap they break: an open mark
    before it, a full mark after it.
    """
    # A fold lies between waypoints: with waypoints alone the margin would not be seen to fall to 0.
    parts = path.dense
    figure = new_figure(7.0, 5.0)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    for k, (name, colour) in enumerate(COORDINATES):
        draw_broken(above, parts, partial(_coordinate, k), TIP, colour=colour, name=name)
    draw_broken(below, parts, lambda e: e.margin, MARGIN)
    below.axhline(0, color=FAINT, lw=0.7)
    last = len(path.equilibria)
    share_x((above, below), (1 - 0.02 * last, last + 0.02 * last), "waypoint")
    below.xaxis.get_major_locator().set_params(integer=True)
    names = {
        snap.index + 1 + snap.fraction: f"snap {k}\n{number(snap.tip_jump * TO_MM, 1)} mm"
        for k, snap in enumerate(path.snaps, start=1)
    }
    rules_at((above, below), names)
    if len(names) <= MAX_NAMES:
        names_above(above, names, panel_width=0.8 * float(figure.get_figwidth()))
    legend_beside(above)
    count = {0: "no snap", 1: "1 snap"}.get(len(path.snaps), f"{len(path.snaps)} snaps")
    headed(figure, f"{path.equilibria[0].robot.name or 'Tube robot'}:  {last} waypoints,  {count}")
    return figure


def _coordinate(axis: int, equilibrium: Equilibrium) -> float:
    """Coordinate of the tip, m."""
    return float(equilibrium.tip_position[axis])


REST_FRAMES = 8
"""Number of frames that the arm rests before and after a snap."""

SNAPPED = COORDINATES[0][1]


@styled
def animate_path(
    path: Path,
    file: str | PathLike[str],
    *,
    values: ArrayLike | None = None,
    name: str = "waypoint",
    view: tuple[float, float] | None = None,
) -> FilePath:
    """Path of a film of the arm at each waypoint, with the margin next to it: GIF, or MP4 if ffmpeg is installed.

    At a snap the film rests: before it, and after it with the lost shape as a ghost and the jump of the tip.

    Args:
        path: result of `follow`.
        file: file to write, .gif or .mp4.
        values: (T,) abscissae of the margin, one per waypoint; None counts the waypoints.
        name: name of these values, with their unit.
        view: elevation and azimuth of the viewer, deg; None looks across the first jump of the tip, or
            across the widest side of the motion.

    Raises:
        InputError: the name of the file ends otherwise, ffmpeg is missing, or `values` has another length than `path`.
    """
    film_ending(file)
    count = len(path.equilibria)
    # Waypoints are numbered from 1, as in the table.
    along = np.arange(1.0, count + 1) if values is None else np.asarray(values, dtype=float)
    if along.shape != (count,):
        raise InputError(f"values has shape {along.shape}; it must be ({count},), one per waypoint")
    frames = _frames(path, along)
    tips = np.array([frame.arm.tip_position for frame in frames])
    if view is None and path.snaps:
        jump = np.array([path.snaps[0].before.tip_position, path.snaps[0].after.tip_position])
        # Centred, as the direction of the jump counts, and not where it is.
        across = widest_view(jump - jump.mean(0))
        view = across.elevation, across.azimuth
    everything = PlotScene([DrawnArm(frame.arm) for frame in frames], paths=[TipPath(along, tips)])
    projection, box = everything.view(view), SceneBox.around(everything.extent())
    parts = stretches(path, along)

    def draw(scene: Axes, panel: Axes, k: int) -> None:
        x, arm, snap = frames[k]
        draw_box(scene, box, projection)
        # Lines much thicker than the tubes, which are too thin for a small picture.
        if snap is not None:
            draw_lines(scene, snap.before, projection.project, widths=(2.0, 1.3), opacity=0.35)
            tips = projection.project(np.array([snap.before.tip_position, snap.after.tip_position]))[:, :2]
            arrow(scene, tips[0], tips[1], SNAPPED, width=1.2, head=9, zorder=7)
            panel.set_title(f"snap: the tip jumps by {number(snap.tip_jump * TO_MM, 0)} mm", color=SNAPPED, fontsize=9)
        draw_lines(scene, arm, projection.project, widths=(2.0, 1.3))
        draw_broken(panel, parts, lambda each: each.margin, MARGIN, colour=FAINT)
        panel.plot([x], [arm.margin], "o", ms=7, color=INK if snap is None else SNAPPED, zorder=6, clip_on=False)
        panel.axhline(0, color=FAINT, lw=0.7)
        share_x([panel], along, name)

    robot = path.equilibria[0].robot
    return save_film(file, robot.name or "Tube robot", len(frames), draw, beside=True)


class FilmFrame(NamedTuple):
    """Frame of a film: abscissa, arm, and the snap that has just happened."""

    x: float
    arm: Equilibrium
    snap: Snap | None = None


def _frames(path: Path, along: Array) -> list[FilmFrame]:
    """Frames of a film: one for each waypoint, and pauses before and after each snap."""
    frames: list[FilmFrame] = []
    for k, (x, arm) in enumerate(zip(along.tolist(), path.equilibria, strict=True)):
        for snap in path.snaps:
            if snap.index + 1 == k:
                at = value_at_snap(snap, along)
                frames += [FilmFrame(at, snap.before)] * REST_FRAMES + [FilmFrame(at, snap.after, snap)] * REST_FRAMES
        frames.append(FilmFrame(x, arm))
    return frames


@picture
def plot_snap(
    snap: Snap,
    *,
    title: str = "",
    view: tuple[float, float] | None = None,
) -> Figure:
    """Picture of the robot before and after a snap, side by side in equal boxes and at one scale.

    The shape before the snap is drawn behind the new one as a ghost, with an arrow from the old tip to the new.

    Args:
        snap: result of `find_snap` or `follow`.
        title: heading; default the robot's name.
        view: elevation and azimuth of the viewer, deg; None looks across the jump of the tip.
    """
    before, after = snap.before, snap.after
    figure = new_figure(7.0, 4.9)
    robot = before.robot
    joints = rotations_text(snap.rotations, 3)
    if np.any(snap.translations):
        joints += f", translations ({millimetres(snap.translations)}) mm"
    energy = released(snap.energy_released, ", {:.2f} mJ are released")
    heading = f"{title or robot.name or f'Robot with {robot.n_tubes} tubes'}:  snap at {joints}"
    headed(figure, f"{heading}\nthe tip jumps by {snap.tip_jump * TO_MM:.1f} mm{energy}")
    if view is None:
        tips = np.array([before.tip_position, after.tip_position])
        across = widest_view(tips - tips.mean(0))
        view = across.elevation, across.azimuth
    scenes, projection = draw_scenes(figure, [before, after], [(), (before,)], view, close_ups=False)
    # At a fold the margin is 0 but for round-off.
    states = (("before", before, "0, the fold"), ("after", after, f"{after.margin:.3f}"))
    for scene, (when, state, margin) in zip(scenes, states, strict=True):
        facts = f"tip ({millimetres(state.tip_position)}) mm\nmargin {margin},  energy {state.energy * TO_MILLI:.2f} mJ"
        scene.set_title(f"{when}\n{facts}", fontsize=8, loc="left")
    old, new = (projection.project(each.tip_position)[:2] for each in (before, after))
    arrow(scenes[1], old, new, INK, margins=(3, 3), zorder=6)
    # The label stands above the arrow, on the free side: the sign distinguishes an arrow that falls to the right
    # from one that rises to the right.
    slope = float(np.sign((old[1] - new[1]) * (new[0] - old[0])))
    label = note(scenes[1], f"{snap.tip_jump * TO_MM:.1f} mm", (old + new) / 2, (2.0 * slope, 10.0))
    label.set_bbox({"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.5})
    return figure
