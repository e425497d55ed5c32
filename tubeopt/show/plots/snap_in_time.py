"""A snap in time: the arm, the turn and speed of its tip, and its energies."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

import numpy as np

from ...files.units import TO_MILLI
from ...stability import SnapInTime
from ...typing import Array
from ..page import tube_colour
from .labels import legend_beside
from .panels import PanelScale, draw_over, share_x
from .projection import SceneBox, draw_box
from .scene import DrawnArm, PlotScene, TipPath, draw_lines
from .style import FAINT, INK, Axes, Figure, headed, new_figure, number, picture, styled
from .trajectory import beside_scene, film_ending, save_film, swept_arms

TURN = PanelScale("turn at the tips (deg)", 180 / np.pi)
SPEED = PanelScale("speed of the tip (m/s)", low=0.0)
ENERGY = PanelScale("energy (mJ)", TO_MILLI)

SHOWN = 7
"""Arms in a picture."""

ENERGIES = (("kinetic", "#D55E00"), ("potential", "#0072B2"), ("dissipated", "#009E73"), ("drive_work", "#CC79A7"))
"""Energies and their colours, from the palette of Okabe and Ito (2008)."""


def _speed(moving: SnapInTime) -> tuple[Array, Array]:
    """Times in the middle of the steps, s, and the speed of the tip there, m/s."""
    moved = np.linalg.norm(np.diff(moving.tip_position, axis=0), axis=1)
    return (moving.time[1:] + moving.time[:-1]) / 2, moved / np.diff(moving.time)


def _scene(moving: SnapInTime) -> PlotScene:
    """Some arms of a snap, evenly spaced in the path of their rotations, and the path of the tip."""
    turns = np.array([arm.tip_rotations for arm in moving.arms])
    travelled = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(turns, axis=0)).max(1))])
    chosen = np.unique(np.searchsorted(travelled, np.linspace(0.0, travelled[-1], SHOWN)))
    shown = moving.time >= moving.arm_times[0]
    path = TipPath(moving.time[shown], moving.tip_position[shown])
    return PlotScene(swept_arms([moving.arms[min(k, len(moving.arms) - 1)] for k in chosen]), (), [path])


@picture
def plot_snap_in_time(moving: SnapInTime, *, title: str = "", view: tuple[float, float] | None = None) -> Figure:
    """Picture of a snap in time: the arm at some instants; turn and speed of the tip, and energies, over time.

    Args:
        moving: result of `snap_in_time`.
        title: heading; default the robot's name.
        view: elevation and azimuth of the viewer, deg; None looks across the widest side.
    """
    figure = new_figure(10.0, 5.4)
    panels = beside_scene(figure, 3, _scene(moving), view)
    ms = moving.time * TO_MILLI
    for i, row in enumerate(np.transpose(moving.tip_rotations)):
        draw_over(panels[0], ms, row, TURN, name=f"tube {i + 1}", color=tube_colour(i))
    middle, speed = _speed(moving)
    draw_over(panels[1], middle * TO_MILLI, speed, SPEED)
    for name, colour in ENERGIES:
        values = getattr(moving, name)
        if name != "drive_work" or values.any():
            draw_over(panels[2], ms, values, ENERGY, name=name.replace("_", " "), color=colour)
    legend_beside(panels[0])
    legend_beside(panels[2])
    share_x(panels, moving.arm_times * TO_MILLI, "time (ms)")
    robot = moving.snap.before.robot
    facts = [f"tip speed up to {number(moving.peak_speed, 1)} m/s", f"{moving.energy_released * TO_MILLI:.2f} mJ"]
    if np.isfinite(moving.duration):
        facts.insert(0, f"snaps in {number(moving.duration * TO_MILLI, 2)} ms")
    return headed(figure, f"{title or robot.name or 'Tube robot'}\n{',  '.join(facts)}")


@styled
def animate_snap(moving: SnapInTime, file: str | PathLike[str], *, view: tuple[float, float] | None = None) -> Path:
    """Path of a film of the arm through a snap, with the turn of the tips beside it: GIF, or MP4 with ffmpeg.

    Args:
        moving: result of `snap_in_time`.
        file: file to write, .gif or .mp4.
        view: elevation and azimuth of the viewer, deg; None looks across the widest side.

    Raises:
        InputError: the name of the file ends otherwise, or ffmpeg is missing.
    """
    film_ending(file)
    scene = PlotScene([DrawnArm(arm) for arm in moving.arms], paths=[TipPath(moving.time, moving.tip_position)])
    projection, box = scene.view(view), SceneBox.around(scene.extent())
    ms = moving.time * TO_MILLI

    def draw(axes: Axes, panel: Axes, k: int) -> None:
        at, arm = moving.arm_times[k], moving.arms[k]
        draw_box(axes, box, projection)
        passed = (moving.time >= moving.arm_times[0]) & (moving.time <= at)
        path = projection.project(moving.tip_position[passed])
        axes.plot(path[:, 0], path[:, 1], color=INK, lw=0.8, zorder=5)
        draw_lines(axes, arm, projection.project, widths=(2.0, 1.3))
        for i, row in enumerate(np.transpose(moving.tip_rotations)):
            draw_over(panel, ms, row, TURN, color=FAINT, lw=1.0)
            draw_over(panel, ms[passed], row[passed], TURN, color=tube_colour(i))
        share_x([panel], moving.arm_times * TO_MILLI, "time (ms)")

    shown = (moving.arm_times[-1] - moving.arm_times[0]) * TO_MILLI
    title = f"{moving.snap.before.robot.name or 'Tube robot'}: {number(float(shown), 2)} ms"
    return save_film(file, title, len(moving.arms), draw, beside=True)
