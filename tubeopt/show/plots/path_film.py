"""Motion through waypoints as a film: the arm with its margin beside it, and what each snap does."""

from __future__ import annotations

from os import PathLike
from pathlib import Path as FilePath

import numpy as np
from numpy.typing import ArrayLike

from ...equilibrium.result import Equilibrium
from ...errors import InputError
from ...files.units import TO_MM
from ...stability import Path, Snap
from ...stability.following import place_of, stretches
from ...typing import Array
from ..arm_surfaces import Centreline, visible
from ..colours import tube_colour
from .path import COORDINATES, draw_broken
from .stage import View, draw_arrow, draw_box, widest_view
from .style import FAINT, INK, Axes, number, styled
from .trajectory import Sweep, film_ending, margin_scale, save_film, stage_for

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
    along = np.arange(1.0, count + 1) if values is None else np.asarray(values, dtype=float)
    if along.shape != (count,):
        raise InputError(f"values has shape {along.shape}; it must be ({count},), one per waypoint")
    shots = _shots(path, along)
    tips = np.array([arm.tip_position for _, arm, _ in shots])
    if view is None and path.snaps:
        jump = np.array([path.snaps[0].before.tip_position, path.snaps[0].after.tip_position])
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
