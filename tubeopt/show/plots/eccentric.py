"""Pictures of eccentric robots: reached tips, and the effect of permuting the tubes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ...equilibrium.result import Equilibrium
from ...files.units import TO_MM
from ...typing import Array
from ..page import tube_colour
from ..surfaces import SampledCentreline
from .labels import note
from .projection import Projection
from .scene import draw_plate
from .style import FAINT, INK, Axes, Figure, colour_bar, headed, new_figure, number, picture

if TYPE_CHECKING:
    from matplotlib.colors import Normalize

MAP = "cividis"
MICRO = 1e6
ARM_POINTS = 33


@dataclass(frozen=True, eq=False)
class Curve:
    """A line in space, coloured by values."""

    points: Array
    """(k, 3) points of the line, m."""
    value: Array | float
    """(k,) values, or one for all points."""
    tip: bool = True
    """True if the end of the curve is a tip."""


def arm_curve(equilibrium: Equilibrium, value: float) -> Curve:
    """Centreline of an equilibrium as a smooth curve of one colour."""
    line = SampledCentreline(equilibrium)
    return Curve(line.position(np.linspace(0.0, line.length, ARM_POINTS)), value)


@picture
def plot_reach(
    curves: Sequence[Curve],
    *,
    title: str,
    label: str,
    view: tuple[float, float] = (18.0, -60.0),
    opacity: float = 1.0,
) -> Figure:
    """Figure of many arms, or of curves of tips: in space, from above, and in the half-plane through z.

    Args:
        curves: lines, coloured by their values.
        title: heading.
        label: name of the values, with their unit.
        view: elevation and azimuth of the viewer of the scene, deg.
        opacity: of the lines, 0 to 1; tips are opaque.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    figure = new_figure(7.4, 4.6)
    headed(figure, title)
    values = np.concatenate([np.ravel(curve.value) for curve in curves])
    scale = Normalize(float(values.min()), float(values.max()))
    grid = figure.add_gridspec(2, 3, width_ratios=[2.5, 1.3, 0.06])
    scene, above, side = (figure.add_subplot(at) for at in (grid[:, 0], grid[0, 1], grid[1, 1]))
    seen = Projection(*view)
    draw_plate(scene, np.concatenate([curve.points for curve in curves]), seen)
    _draw_curves(scene, [(curve, seen.project(curve.points)) for curve in curves], scale, opacity)
    flat = [(curve, curve.points * TO_MM) for curve in curves]
    _draw_curves(above, flat, scale, opacity)
    # A line around the axis is a point in the half-plane: its mark is drawn even where it is no tip.
    _draw_curves(side, [(replace(curve, tip=True), _meridian(at)) for curve, at in flat], scale, opacity)
    for axes, across, up in ((above, "x (mm)", "y (mm)"), (side, "distance from the axis (mm)", "z (mm)")):
        axes.set(xlabel=across, ylabel=up)
        axes.autoscale_view()
        axes.set_aspect("equal")
    colour_bar(figure, ScalarMappable(scale, MAP), label, cax=figure.add_subplot(grid[:, 2]))
    return figure


def _meridian(points: Array) -> Array:
    """(k, 3) points rotated about z into one plane: distance from the axis, height, and 0."""
    distance = np.hypot(points[:, 0], points[:, 1])
    return np.column_stack([distance, points[:, 2], np.zeros(len(points))])


def _draw_curves(axes: Axes, curves: Sequence[tuple[Curve, Array]], scale: Normalize, opacity: float) -> None:
    """Draw curves with their points (k, 3) as seen, mm, farther pieces first; then the tips."""
    from matplotlib import colormaps
    from matplotlib.collections import LineCollection

    lines = [np.column_stack([seen, np.broadcast_to(curve.value, len(seen))]) for curve, seen in curves]
    pieces = np.concatenate([np.stack([line[:-1], line[1:]], axis=1) for line in lines])
    # (m, 2, 4): two ends with x, y, depth and value. The sum of depths orders as their mean.
    pieces = pieces[np.argsort(pieces[..., 2].sum(axis=1), kind="stable")]
    colours = colormaps[MAP](scale(pieces[..., 3].mean(axis=1)))
    colours[:, 3] = opacity
    width = 0.6 if opacity < 1 else 1.2
    drawn = LineCollection(list(pieces[..., :2]), colors=colours, linewidths=width, capstyle="round", zorder=3)
    axes.add_collection(drawn)
    tips = [(seen[-1], float(np.ravel(curve.value)[-1])) for curve, seen in curves if curve.tip]
    if tips:
        at = np.array([tip for tip, _ in tips])
        order = np.argsort(at[:, 2], kind="stable")
        style: dict[str, Any] = {"s": 5 if len(tips) > 60 else 12, "linewidths": 0.15, "edgecolors": "white"}
        axes.scatter(at[order, 0], at[order, 1], c=[tips[k][1] for k in order], cmap=MAP, norm=scale, zorder=4, **style)


@dataclass(frozen=True, eq=False)
class Permutations:
    """Tips of one mirror actuation with the tubes in every order, and largest deviations of tips elsewhere."""

    tips: Array
    """(6, 3) tips of the assignments, m."""
    reference: Array
    """(3,) tip at offset d = 0, m."""
    names: Sequence[str]
    """Names of the six assignments."""
    frame: Array
    """(3, 3) frame of the tip, seen along its last column."""
    separation: Array
    """(k,) separations of the deviations, rad."""
    deviation: Array
    """(k,) largest distance from the reference over all directions, m."""
    shown: float
    """Separation of the drawn tips, rad."""
    published: tuple[float, str]
    """Published largest distance, m, and its source."""


@picture
def plot_permutations(data: Permutations, *, title: str, arms: Sequence[Equilibrium] = ()) -> Figure:
    """Picture of the six tips of one mirror actuation around the tip at d = 0, and of the largest distance.

    Args:
        title: heading.
        arms: the six arms and the reference, drawn to scale.
    """
    figure = new_figure(7.4, 3.3)
    headed(figure, title)
    scene, hexagon, curve = figure.subplots(1, 3, width_ratios=[1.0, 1.15, 1.45])
    # In the meridian of their bend the arms coincide to the width of a line.
    for k, arm in enumerate(arms):
        x, y, _ = _meridian(arm_curve(arm, 0.0).points * TO_MM).T
        scene.plot(x, y, color=tube_colour(k) if k < 6 else INK, lw=1.2, ls="-" if k < 6 else ":")
    # The panel is narrower than the name of its axis in one line, which would be clipped at the edge of the picture.
    scene.set(xlabel="distance from\nthe axis (mm)", ylabel="z (mm)", title="all seven arms, to scale")
    scene.set_aspect("equal")
    _draw_hexagon(hexagon, data)
    _draw_deviation(curve, data)
    return figure


def _draw_hexagon(axes: Axes, data: Permutations) -> None:
    """Draw the tips in the plane across the arm, in micrometres from the reference."""
    # Components along the first two axes of the cross-section: differences along the arm are not seen.
    seen = (data.tips - data.reference) @ data.frame[:, :2] * MICRO
    # By angle about the reference: otherwise the hexagon's outline would cross itself.
    order = np.argsort(np.arctan2(seen[:, 1], seen[:, 0]))
    axes.fill(seen[order, 0], seen[order, 1], facecolor="none", edgecolor=FAINT, lw=0.7)
    half_width, half_height = np.abs(seen).max(axis=0)
    for k, (at, name) in enumerate(zip(seen, data.names, strict=True)):
        axes.plot(*at, "o", ms=4, color=tube_colour(k))
        note(axes, name, at, 7 * at / np.linalg.norm(at), colour=tube_colour(k))
    axes.plot(0, 0, "+", ms=5, mew=1.0, color=INK)
    note(axes, "d = 0", (0, 0), (7, 0))
    # Names stand outside the hexagon, which may be flat: half as high as wide, the panel has space for them.
    half_width, half_height = 1.6 * half_width, max(1.6 * half_height, 0.8 * half_width)
    axes.set(xlim=(-half_width, half_width), ylim=(-half_height, half_height))
    axes.set(xlabel="across the arm (µm)", ylabel="across the arm (µm)")
    axes.set_title(f"tips at separation {number(float(np.degrees(data.shown)), 1)}°")
    axes.set_aspect("equal")


def _draw_deviation(axes: Axes, data: Permutations) -> None:
    """Draw the largest distance from the reference over separation, and the published one."""
    x, y = np.degrees(data.separation), data.deviation * TO_MM
    axes.semilogy(x, y, color=tube_colour(2), lw=1.6)
    k = int(np.argmax(y))
    axes.plot(x[k], y[k], "o", color=tube_colour(2), ms=4)
    note(axes, f"{y[k]:.4f} mm at {number(float(x[k]), 0)}°", (x[k], y[k]), (3, 6), colour=tube_colour(2))
    value, source = data.published
    axes.axhline(value * TO_MM, color=tube_colour(0), lw=1.2, ls="--")
    text = f"{source}: {number(value * TO_MM, 3)} mm"
    note(axes, text, (x[0], value * TO_MM), (6, 4), colour=tube_colour(0))
    axes.set(xlabel="separation (deg)", ylabel="mm", title="largest distance from d = 0", xlim=(x[0], x[-1]))
    axes.set_ylim(bottom=1e-4, top=2 * value * TO_MM)
    axes.set_xticks(np.arange(x[0], x[-1] + 1, 30))
