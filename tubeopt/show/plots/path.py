"""Motion through waypoints: the tip and the margin on the way, broken where the robot snaps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from os import PathLike
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ...equilibrium.result import Equilibrium
from ...errors import InputError
from ...files.units import TO_MILLI, TO_MM
from ...stability import Path, Snap
from ...stability.following import Stretch, place_of, stretches
from ...typing import Array
from ..formatting import released
from ..page import tube_colour
from ..surfaces import Centreline, visible
from .shape import draw_scenes
from .stage import View, draw_arrow, draw_box, widest_view
from .style import (
    FAINT,
    INK,
    Axes,
    Figure,
    headed,
    legend_beside,
    millimetres,
    name_above,
    new_figure,
    number,
    picture,
    rotations_in_words,
    styled,
)
from .trajectory import Sweep, film_ending, margin_scale, save_film, stage_for

COORDINATES = (("x", "#D55E00"), ("y", "#009E73"), ("z", "#0072B2"))
"""Coordinates of the tip and their colours; from the palette of Okabe and Ito (2008)."""

MOST_NAMES = 12
"""Snaps that are named in the picture; more would cover each other."""

Value = Callable[[Equilibrium], float]
"""What is drawn of an equilibrium."""


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
        draw_broken(above, parts, partial(_coordinate, k), colour, label=name)
    draw_broken(below, parts, lambda e: e.margin, INK)
    _mark_snaps(above, below, path)
    below.axhline(0, color=FAINT, lw=0.7)
    least = float(np.nanmin([each.margin for _, what in parts for each in what]))
    below.set_ylim(min(-0.05, least - 0.05), 1.05)
    above.set_ylabel("tip position (mm)")
    below.set(ylabel="margin", xlabel="waypoint")
    last = len(path.equilibria)
    below.set_xlim(1 - 0.02 * last, last + 0.02 * last)
    below.xaxis.get_major_locator().set_params(integer=True)
    for axes in (above, below):
        axes.grid(axis="y")
    legend_beside(above)
    headed(figure, _heading(path))
    return figure


def _coordinate(axis: int, equilibrium: Equilibrium) -> float:
    """Of the tip, mm."""
    return float(equilibrium.tip_position[axis]) * TO_MM


def draw_broken(
    axes: Axes, parts: Sequence[Stretch], quantity: Value, colour: str, *, width: float = 1.4, label: str = ""
) -> list[Array]:
    """A quantity along the stretches of a path, with an open mark where each snap begins, and a full one where it ends;
    returns the values of each stretch."""
    drawn = [np.array([quantity(each) for each in what]) for _, what in parts]
    for k, ((where, _), values) in enumerate(zip(parts, drawn, strict=True)):
        axes.plot(where, values, color=colour, lw=width, label="_" if k else label, zorder=3)
    look: dict[str, Any] = {"ms": 4.5, "mec": colour, "zorder": 4, "clip_on": False}
    for (where, _), (old, new) in zip(parts, pairwise(drawn), strict=False):
        axes.plot(where[-1:], old[-1:], "o", mfc="white", mew=1.2, **look)
        axes.plot(where[-1:], new[:1], "o", mfc=colour, **look)
    return drawn


def _mark_snaps(above: Axes, below: Axes, path: Path) -> None:
    """A thin line at every snap, numbered on top."""
    for k, snap in enumerate(path.snaps, start=1):
        at = snap.index + 1 + snap.fraction
        for axes in (above, below):
            axes.axvline(at, color=FAINT, lw=0.7, ls=(0, (4, 3)), zorder=0)
        if len(path.snaps) <= MOST_NAMES:
            name_above(above, at, f"snap {k}\n{number(snap.tip_jump * TO_MM, 1)} mm")


def _heading(path: Path) -> str:
    robot = path.equilibria[0].robot
    count = {0: "no snap", 1: "1 snap"}.get(len(path.snaps), f"{len(path.snaps)} snaps")
    return f"{robot.name or 'Tube robot'}:  {len(path.equilibria)} waypoints,  {count}"


STILL_FRAMES = 8
"""Frames for which the arm rests on both sides of a snap."""

PIECES = 40
"""Points along a tube."""

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
    """The arm at each waypoint as a film, with the margin beside it: GIF, or MP4 if ffmpeg is installed.

    At a snap the film rests: before it, and after it with the lost shape as a ghost and the jump of the tip.

    Args:
        path: of `follow`.
        file: to write, .gif or .mp4.
        values: (T,) what the margin is drawn over, one per waypoint; None counts the waypoints.
        name: of these values, with their unit.
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
    shots = _shots(path, along)
    tips = np.array([arm.tip_position for _, arm, _ in shots])
    if view is None and path.snaps:
        jump = np.array([path.snaps[0].before.tip_position, path.snaps[0].after.tip_position])
        # Centred, as the direction of the jump counts, and not where it is.
        across = widest_view(jump - jump.mean(0))
        view = across.elevation, across.azimuth
    stage = stage_for([Sweep([arm for _, arm, _ in shots], along, tips)], (), view)
    parts = stretches(path, along)

    def draw(scene: Axes, beside: Axes, k: int) -> None:
        place, arm, snap = shots[k]
        draw_box(scene, stage[1], stage[0])
        if snap is not None:
            _draw_arm(scene, snap.before, stage[0], opacity=0.35)
            draw_arrow(scene, stage[0], snap.before.tip_position, snap.after.tip_position, SNAPPED)
            beside.set_title(f"snap: the tip jumps by {number(snap.tip_jump * TO_MM, 0)} mm", color=SNAPPED, fontsize=9)
        _draw_arm(scene, arm, stage[0])
        draw_broken(beside, parts, lambda each: each.margin, FAINT)
        beside.plot([place], [arm.margin], "o", ms=7, color=INK if snap is None else SNAPPED, zorder=6, clip_on=False)
        beside.axhline(0, color=FAINT, lw=0.7)
        beside.set_xlabel(name)
        beside.set_xlim(float(along.min()), float(along.max()))
        margin_scale(beside, float(min(each.margin for each in path.equilibria)))

    robot = path.equilibria[0].robot
    return save_film(file, robot.name or "Tube robot", len(shots), draw, beside=True)


def _draw_arm(scene: Axes, arm: Equilibrium, view: View, opacity: float = 1.0) -> None:
    """Every tube where it shows, as a line much thicker than the tube, which is too thin for a small picture."""
    line = Centreline(arm)
    for each in visible(arm):
        s = np.linspace(each.start, each.end, PIECES)
        seen = view.project(line.position(s) + each.offset @ line.ring(s, 4)[1])
        width = 2.0 + 1.3 * each.tube
        scene.plot(seen[:, 0], seen[:, 1], color=tube_colour(each.tube), lw=width, alpha=opacity, zorder=4)


def _shots(path: Path, along: Array) -> list[tuple[float, Equilibrium, Snap | None]]:
    """Place, arm, and the snap that has just happened, of each frame."""
    shots: list[tuple[float, Equilibrium, Snap | None]] = []
    for k, (place, arm) in enumerate(zip(along.tolist(), path.equilibria, strict=True)):
        for snap in path.snaps:
            if snap.index + 1 == k:
                here = place_of(snap, along)
                shots += [(here, snap.before, None)] * STILL_FRAMES + [(here, snap.after, snap)] * STILL_FRAMES
        shots.append((place, arm, None))
    return shots


@picture
def plot_snap(
    snap: Snap,
    *,
    title: str = "",
    view: tuple[float, float] | None = None,
) -> Figure:
    """Picture of the robot before and after a snap, side by side in equal boxes and at one scale.

    The shape that is lost stands behind the new one as a ghost, with an arrow from the old tip to the new.

    Args:
        snap: of `find_snap` or `follow`.
        title: heading; default the robot's name.
        view: elevation and azimuth of the viewer, deg; None looks across the jump of the tip.
    """
    before, after = snap.before, snap.after
    figure = new_figure(7.0, 4.9)
    headed(figure, _snap_heading(snap, title))
    if view is None:
        tips = np.array([before.tip_position, after.tip_position])
        across = widest_view(tips - tips.mean(0))
        view = across.elevation, across.azimuth
    scenes, seen = draw_scenes(figure, [before, after], [(), (before,)], view, close_ups=False)
    scenes[0].set_title("before\n" + _state(before, at_fold=True), fontsize=8, loc="left")
    scenes[1].set_title("after\n" + _state(after), fontsize=8, loc="left")
    _draw_jump(scenes[1], snap, seen)
    return figure


def _snap_heading(snap: Snap, title: str) -> str:
    """Where the robot snaps and what that does, in two lines."""
    robot = snap.before.robot
    name = title or robot.name or f"Robot with {robot.n_tubes} tubes"
    joints = rotations_in_words(snap.rotations, 3)
    if np.any(snap.translations):
        joints += f", translations ({millimetres(snap.translations)}) mm"
    energy = released(snap.energy_released, ", {:.2f} mJ are released")
    return f"{name}:  snap at {joints}\nthe tip jumps by {snap.tip_jump * TO_MM:.1f} mm{energy}"


def _state(equilibrium: Equilibrium, *, at_fold: bool = False) -> str:
    """Tip, margin and energy, in two lines; at a fold the margin is 0 but for round-off."""
    margin = "0, the fold" if at_fold else f"{equilibrium.margin:.3f}"
    energy = f"{equilibrium.energy * TO_MILLI:.2f} mJ"
    return f"tip ({millimetres(equilibrium.tip_position)}) mm\nmargin {margin},  energy {energy}"


def _draw_jump(scene: Axes, snap: Snap, view: View) -> None:
    """An arrow from the old tip to the new one, with its length."""
    old, new = (view.project(each.tip_position)[:2] for each in (snap.before, snap.after))
    style = {"arrowstyle": "-|>", "color": INK, "lw": 1.0, "ls": "-", "shrinkA": 3, "shrinkB": 3, "mutation_scale": 10}
    scene.annotate("", (float(new[0]), float(new[1])), (float(old[0]), float(old[1])), arrowprops=style, zorder=6)
    # The label stands above the arrow, to the side that the arrow leaves free.
    # Its sign tells an arrow that falls to the right from one that rises to the right.
    slope = (old[1] - new[1]) * (new[0] - old[0])
    scene.annotate(
        f"{snap.tip_jump * TO_MM:.1f} mm",
        tuple(((old + new) / 2).tolist()),
        (3.0 * float(np.sign(slope)), 10.0),
        textcoords="offset points",
        ha="center",
        va="bottom",
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.5},
        zorder=7,
    )
