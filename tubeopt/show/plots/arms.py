"""Pictures of the motions of several robots: all arms as they sweep, and the distances between them; as a film too."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

import numpy as np

from ...files.units import TO_MM
from ...planning import ArmsPlan
from ...typing import Array
from .mesh import Mesh
from .shape import robot_mesh
from .stage import Box, View, draw_box, facets, note
from .style import FAINT, INK, Axes, Figure, headed, new_figure, number, picture, styled
from .trajectory import SWEEPING, body_meshes, film_ending, save_film, stage_for

SHOWN = 6
"""Instants at which the arms are drawn in the picture."""

FRAMES = 24
"""Pictures of the film."""

CURVE = 160
"""Instants of the curve of distances."""


@picture
def plot_arms(plan: ArmsPlan, *, title: str = "", view: tuple[float, float] | None = None) -> Figure:
    """Picture of a plan of several arms: all of them to scale at some instants, and the distances between them over
    time, with what was asked for and what is proved.

    Args:
        title: heading; by default what the arms are called.
        view: elevation and azimuth of the viewer, deg; None looks across the widest side of the motion.
    """
    figure = new_figure(10.0, 4.8)
    scene, curve = figure.subplots(1, 2, width_ratios=(1.25, 1.0))
    stage = _stage(plan, view)
    _draw(scene, plan, np.linspace(0.0, plan.duration, SHOWN), stage)
    _distances(curve, plan, np.linspace(0.0, plan.duration, CURVE))
    curve.legend(loc="best")
    headed(figure, title or " and ".join(arm.called for arm in plan.arms))
    return figure


@styled
def animate_arms(
    plan: ArmsPlan, path: str | PathLike[str], *, frames: int = FRAMES, view: tuple[float, float] | None = None
) -> Path:
    """The moving arms as a film, with the distances between them below: GIF, or MP4 where there is ffmpeg.

    Raises:
        InputError: the file cannot be written, its name ends otherwise, or ffmpeg is missing.
    """
    film_ending(path)
    stage, times = _stage(plan, view), np.linspace(0.0, plan.duration, frames)

    def draw(scene: Axes, below: Axes, k: int) -> None:
        _draw(scene, plan, times[k : k + 1], stage)
        _distances(below, plan, times)
        below.axvline(float(times[k]), color=INK, lw=0.8)

    return save_film(path, f"{len(plan.arms)} arms: {number(plan.duration, 1)} s", frames, draw)


def _stage(plan: ArmsPlan, view: tuple[float, float] | None) -> tuple[View, Box]:
    points = []
    for arm, motion in zip(plan.arms, plan.trajectories, strict=True):
        ends = (motion.start, motion.end)
        points += [arm.base.placed(each) for each in (motion.tip_position, *(e.position for e in ends))]
    return stage_for(np.concatenate(points), plan.obstacles, view)


def _draw(scene: Axes, plan: ArmsPlan, times: Array, stage: tuple[View, Box]) -> None:
    """All arms at some instants, paler but for the last, and the ways of their tips up to it."""
    seen, box = stage
    draw_box(scene, box, seen)
    parts = body_meshes(plan.obstacles)
    for k, t in enumerate(times):
        strong = 1.0 if k == len(times) - 1 else 0.45 if k == 0 else 0.15
        for arm, motion, row in zip(plan.arms, plan.trajectories, plan.rows_at(float(t)), strict=True):
            parts.append(robot_mesh(motion.arms[row], opacity=strong, detail=SWEEPING).placed(arm.base))
    scene.add_collection(facets(Mesh.join(parts), seen))
    for arm, motion, row in zip(plan.arms, plan.trajectories, plan.rows_at(float(times[-1])), strict=True):
        tips = seen.project(arm.base.placed(motion.tip_position[: row + 1]))
        scene.plot(tips[:, 0], tips[:, 1], color=INK, lw=0.9, zorder=5)
        scene.plot(*tips[-1, :2], "o", color=INK, ms=3, zorder=6)
        note(scene, arm.called, seen.project(arm.base.origin)[:2], np.array([7.0, 0.0]))


def _distances(axes: Axes, plan: ArmsPlan, times: Array) -> None:
    gaps = plan.clearance(times) * TO_MM
    for k, pair in enumerate(plan.proof.pairs):
        words = f"arms {pair.arms[0] + 1} and {pair.arms[1] + 1}"
        line = axes.plot(times, gaps[:, k], lw=1.4, color=INK if k == 0 else None, label=words)[0]
        if np.isfinite(pair.least_clearance):
            axes.axhline(
                pair.least_clearance * TO_MM, lw=0.8, color=line.get_color(), ls=":", label="proved at all times"
            )
    axes.axhline(plan.min_clearance * TO_MM, color=FAINT, lw=0.8, ls="--", label="asked for")
    axes.set(xlabel="time (s)", ylabel="between arms (mm)")
    axes.set_ylim(bottom=0)
