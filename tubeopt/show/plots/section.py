"""Picture of a motion in a plane that cuts the bodies open."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...bodies.frames import Plane
from ...bodies.obstacles import nearest_distance
from ...equilibrium.result import Equilibrium
from ...errors import InputError
from ...files.units import TO_MM
from ...inverse.arm_surface import ArmSurface
from ...planning import Trajectory
from .style import FAINT, INK, Axes, Figure, headed, legend_beside, new_figure, number, picture
from .trajectory import some_of

CELLS = 300
"""Places along a side of the picture at which it is told whether a body is there."""

AROUND = 0.012
"""Length (m) by which more is shown than the arm."""

ALONG = 400
"""Points along an arm."""

BODY, ARM, BESIDE = "#DDD3CE", "#0072B2", "#9CC3DE"


@picture
def plot_section(trajectory: Trajectory, *, plane: Plane | None = None, title: str = "") -> Figure:
    """Picture of a motion in a plane: the bodies as it cuts them, the arm at the end as wide as it is, where the plane
    cuts it darker than where it lies before or behind, and centrelines on the way there.

    Args:
        plane: in the frame of the plate; by default `trajectory.cut`.
        title: heading; by default the robot's name.

    Raises:
        InputError: neither a plane nor `trajectory.cut`.
    """
    t, plane = trajectory, plane or trajectory.cut
    if plane is None:
        raise InputError("there is no plane to cut along; give one, or a trajectory with a cut")
    arms = some_of(t.arms)
    lines = [ArmSurface(arm).line(ALONG)[0] for arm in arms]
    frame = plane.frame
    seen = frame.seen(np.concatenate([*lines, t.tip_position]))[:, :2]
    low, high = seen.min(0) - AROUND, seen.max(0) + AROUND
    figure = new_figure(4.6, 4.4)
    axes = figure.add_subplot()
    if t.obstacles:
        u, v = (np.linspace(a, b, CELLS) for a, b in zip(low, high, strict=True))
        places = frame.placed(np.stack(np.broadcast_arrays(u[None], v[:, None], 0.0), axis=-1))
        away = nearest_distance(t.obstacles, places)
        axes.contourf(u * TO_MM, v * TO_MM, away, levels=[-np.inf, 0.0], colors=[BODY])
        axes.contour(u * TO_MM, v * TO_MM, away, levels=[0.0], colors=[FAINT], linewidths=0.7)
    for line in lines[:-1]:
        axes.plot(*(frame.seen(line)[:, :2].T * TO_MM), color=ARM, lw=0.6, alpha=0.5, label="before")
    _draw_arm(axes, arms[-1], plane)
    axes.plot(*(frame.seen(t.tip_position[-1])[:2, None] * TO_MM), "o", color=INK, ms=3, zorder=4, label="tip")
    axes.set(xlim=TO_MM * np.array([low[0], high[0]]), ylim=TO_MM * np.array([low[1], high[1]]), aspect="equal")
    axes.set(xlabel="to the right in the plane (mm)", ylabel="upwards in the plane (mm)")
    for colour, what in ((ARM, "arm, cut"), (BESIDE, "arm, beside"), (BODY, "body, cut")):
        axes.fill([], [], color=colour, label=what)
    signs = dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True))
    legend_beside(axes, signs.values(), signs.keys())
    place, across = (
        ", ".join(number(float(x), digits) for x in row)
        for row, digits in ((plane.point * TO_MM, 1), (plane.normal, 2))
    )
    headed(figure, f"{title or t.robot.name or 'robot'}\nplane through {place} mm, square to {across}")
    return figure


def _draw_arm(axes: Axes, arm: Equilibrium, plane: Plane) -> None:
    """An arm as the balls about its centreline: all of them as they are seen, and what the plane cuts of them."""
    from matplotlib.collections import EllipseCollection

    line, radius = ArmSurface(arm).line(ALONG)
    at, height = plane.frame.seen(line)[:, :2] * TO_MM, plane.height(line)
    for half, colour in ((radius, BESIDE), (np.sqrt(np.maximum(radius**2 - height**2, 0.0)), ARM)):
        wide = 2 * TO_MM * half[half > 0]
        where: dict[str, Any] = {"units": "xy", "offsets": at[half > 0], "offset_transform": axes.transData}
        axes.add_collection(EllipseCollection(wide, wide, 0 * wide, color=colour, lw=0, zorder=3, **where))
