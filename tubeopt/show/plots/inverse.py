"""The arm at its target, with its other postures as ghosts, and a path of targets with the arm along it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...files.units import TO_MM
from ...inverse import InverseSolution
from ...typing import Array
from .shape import draw_scenes
from .stage import View, draw_arrow, note
from .style import INK, Axes, Figure, caption, headed, new_figure, picture
from .trajectory import Sweep, along, beside_scene, draw_joints, margin_scale

TARGET = "#B00020"
ARROW_SHARE = 0.12
"""Length of the arrow of a wanted direction, as a share of the arm."""


@picture
def plot_inverse(
    solutions: InverseSolution | Sequence[InverseSolution],
    *,
    view: tuple[float, float] | None = None,
) -> Figure:
    """Picture of the arm at its target; further answers for the same target stand behind it as ghosts.

    Args:
        solutions: one answer, or several of the same target, the best first.
        view: elevation and azimuth of the viewer, deg; None looks across the widest side.
    """
    first, *others = solutions if isinstance(solutions, Sequence) else [solutions]
    figure = new_figure(7.0, 5.0)
    headed(figure, caption(first.equilibrium) + _alternatives(others))
    (scene,), seen = draw_scenes(figure, [first.equilibrium], [[each.equilibrium for each in others]], view)
    _draw_target(scene, first, seen)
    return figure


def _alternatives(others: Sequence[InverseSolution]) -> str:
    if not others:
        return ""
    margins = ", ".join(f"{each.margin:.3f}" for each in others)
    return f"\nghosts: {len(others)} other posture{'s' if len(others) > 1 else ''} with the same tip, margin {margins}"


def _draw_target(scene: Axes, solution: InverseSolution, view: View) -> None:
    """A cross at the target, an arrow along the wanted direction, and a line where the tip misses it."""
    at = view.project(solution.target_position)
    scene.plot(at[0], at[1], marker="+", ms=11, mew=1.3, color=TARGET, zorder=7)
    if solution.target_direction is not None:
        length = ARROW_SHARE * float(solution.equilibrium.arc_length[-1])
        end = solution.target_position + length * solution.target_direction
        draw_arrow(scene, view, solution.target_position, end, TARGET)
    if not solution.reached:
        tip = view.project(solution.equilibrium.tip_position)
        scene.plot([tip[0], at[0]], [tip[1], at[1]], color=TARGET, lw=1.0, ls=(0, (4, 2)), zorder=7)
        middle = (tip[:2] + at[:2]) / 2
        note(scene, f"{solution.position_error * TO_MM:.2f} mm short", middle, np.array([6.0, 0.0]), colour=TARGET)


@picture
def plot_targets(
    solutions: Sequence[InverseSolution],
    *,
    title: str = "",
    shown: int = 5,
    view: tuple[float, float] | None = None,
) -> Figure:
    """Picture of an arm that follows targets: the arm at some of them, the targets, margin and joint values.

    Args:
        solutions: one answer per target, in their order.
        view: as in `plot_inverse`.
        title: heading; default the robot's name.
        shown: at how many of the targets the arm is drawn, the last one solid.
    """
    arms = [each.equilibrium for each in solutions]
    chosen = np.unique(np.linspace(0, len(arms) - 1, shown).round().astype(int))
    targets = np.array([each.target_position for each in solutions])
    figure = new_figure(9.0, 5.0)
    name = title or arms[-1].robot.name or "robot"
    worst = max(each.position_error for each in solutions)
    least = min(each.margin for each in solutions)
    headed(figure, f"{name}: {len(arms)} targets, tip within {worst * 1e9:.2g} nm, margin at least {least:.3f}")
    way = arc_length(targets) * TO_MM
    sweep = Sweep([arms[k] for k in chosen], np.arange(len(arms), dtype=float), targets, asked=True)
    rows = beside_scene(figure, 3, sweep, (), view)
    draw_joints(rows, way, np.array([each.rotations for each in arms]), np.array([each.translations for each in arms]))
    rows[2].plot(way, [each.margin for each in arms], color=INK, lw=1.4)
    margin_scale(rows[2], least)
    along(rows, way, "path of the tip (mm)")
    figure.align_ylabels(rows)
    return figure


def arc_length(points: Array) -> Array:
    """(T,) length of the way through points (T, 3) up to each, m."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])
