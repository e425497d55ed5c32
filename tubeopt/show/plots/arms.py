"""Pictures of the motions of several robots: all arms as they sweep, and the distances between them; as a film too."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

import numpy as np

from ...files.units import TO_MM
from ...planning import ArmsPlan
from ...typing import Array
from .stage import Box, View, note
from .style import FAINT, INK, Axes, Figure, headed, new_figure, number, picture, styled
from .trajectory import Sweep, draw_sweeps, film_ending, save_film, stage_for

SHOWN = 6
"""Instants at which the arms are drawn in the picture."""

FRAMES = 24
"""Pictures of the film."""

CURVE = 160
"""Instants of the curve of distances."""


@picture
def plot_arms(plan: ArmsPlan, *, title: str = "", view: tuple[float, float] | None = None) -> Figure:
    """Figure of a plan of several arms: all arms to scale at some instants, and their distances over time.

    Args:
        title: heading; by default what the arms are called.
        view: elevation and azimuth of the viewer, deg; None looks across the widest side of the motion.
    """
    figure = new_figure(10.0, 4.8)
    scene, curve = figure.subplots(1, 2, width_ratios=(1.25, 1.0))
    sweeps = _sweeps(plan, np.linspace(0.0, plan.duration, SHOWN))
    _draw(scene, plan, sweeps, stage_for(sweeps, plan.obstacles, view))
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
    times = np.linspace(0.0, plan.duration, frames)
    stage = stage_for(_sweeps(plan, times), plan.obstacles, view)

    def draw(scene: Axes, below: Axes, k: int) -> None:
        _draw(scene, plan, _sweeps(plan, times[k : k + 1]), stage)
        _distances(below, plan, times)
        below.axvline(float(times[k]), color=INK, lw=0.8)

    return save_film(path, f"{len(plan.arms)} arms: {number(plan.duration, 1)} s", frames, draw)


def _sweeps(plan: ArmsPlan, times: Array) -> list[Sweep]:
    """Every arm at some instants, and the way of its tip up to the last."""
    out = []
    rows = zip(*(plan.rows_at(float(t)) for t in times), strict=True)
    for arm, motion, own in zip(plan.arms, plan.trajectories, rows, strict=True):
        passed = slice(own[-1] + 1)
        tips = arm.base.placed(motion.tip_position[passed])
        out.append(Sweep([motion.arms[row] for row in own], motion.time[passed], tips, arm.base))
    return out


def _draw(scene: Axes, plan: ArmsPlan, sweeps: list[Sweep], stage: tuple[View, Box]) -> None:
    """All arms, with their names."""
    draw_sweeps(scene, stage, sweeps, plan.obstacles, faint=0.15)
    for arm in plan.arms:
        note(scene, arm.called, stage[0].project(arm.base.origin)[:2], np.array([7.0, 0.0]))


def _distances(axes: Axes, plan: ArmsPlan, times: Array) -> None:
    gaps = plan.clearance(times) * TO_MM
    for k, pair in enumerate(plan.proof.pairs):
        words = f"arms {pair.arms[0] + 1} and {pair.arms[1] + 1}"
        line = axes.plot(times, gaps[:, k], lw=1.4, color=INK if k == 0 else None, label=words)[0]
        if np.isfinite(pair.least_clearance):
            axes.axhline(
                pair.least_clearance * TO_MM, lw=0.8, color=line.get_color(), ls=":", label="proved at all times"
            )
    axes.axhline(plan.min_clearance * TO_MM, color=FAINT, lw=0.8, ls="--", label="required")
    axes.set(xlabel="time (s)", ylabel="between arms (mm)")
    axes.set_ylim(bottom=0)
