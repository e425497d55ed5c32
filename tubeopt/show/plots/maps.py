"""Maps: elastic energy over two tip angles, and the stability margin over two relative rotations."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy

from ...errors import InputError
from ...files.units import TO_MILLI
from ...typing import Array, Mask
from .style import INK, angle_locator, narrow, new_figure, number, picture

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.contour import ContourSet
    from matplotlib.figure import Figure

    from ...stability import EnergyMap, StabilityMap

MAP = "cividis"
SNAP_COLOUR = "#D55E00"
HATCH_COLOUR = INK
ENERGY_LEVELS = 24
MOST_MAPS = 4
FINE = 361
"""Points per axis of a map as it is drawn: one per degree."""

MARKS = (("o", "minimum: stable"), ("X", "saddle: unstable"), ("^", "maximum: unstable"))
"""Sign and name of an equilibrium, by its index; the last one for all that are higher."""


@picture
def plot_energy_maps(maps: Sequence[EnergyMap], *, titles: Sequence[str] = ()) -> Figure:
    """Filled contours of elastic energy over two tip angles, up to four maps at one scale of colours.

    Levels are closer where the energy is low. The line through each saddle, above which a robot must be lifted to leave
    its minimum, is drawn white.

    Args:
        maps: of `energy_map`.
        titles: a heading for each; default its joint rotations.

    Raises:
        InputError: no map or more than four, titles of another number, a name of the picture that does not end in a
            known format.
    """
    if not 1 <= len(maps) <= MOST_MAPS:
        raise InputError(f"{len(maps)} maps are given; there must be 1 to {MOST_MAPS}")
    if titles and len(titles) != len(maps):
        raise InputError(f"{len(titles)} titles are given for {len(maps)} maps; they must be as many")
    columns = min(2, len(maps))
    rows = -(-len(maps) // columns)
    figure = new_figure(1.2 + 3.1 * columns, 0.7 + 2.9 * rows)
    panels = figure.subplots(rows, columns, squeeze=False)
    levels = energy_levels([each.energy for each in maps])
    for k, panel in enumerate(panels.ravel()):
        if k >= len(maps):
            panel.axis("off")
            continue
        filled = _draw_energy(panel, maps[k], levels)
        panel.set_title(titles[k] if titles else _rotations(maps[k]), loc="left")
    if len({(*each.tubes, *each.first[[0, -1]], *each.second[[0, -1]]) for each in maps}) == 1:
        for panel in panels.ravel():
            panel.label_outer()
    bar = figure.colorbar(filled, ax=panels, label="elastic energy (mJ)", shrink=0.8, aspect=30, pad=0.02)
    bar.set_ticks(levels[::4].tolist(), labels=[f"{level:.1f}" for level in levels[::4]])
    bar.outline.set_visible(False)
    _name_marks(figure, maps)
    return figure


def energy_levels(energies: Sequence[Array]) -> Array:
    """Levels (mJ) for maps of energy in J, spread as the square root from the least: even rings around a minimum."""
    low = min(float(energy.min()) for energy in energies) * TO_MILLI
    high = max(float(energy.max()) for energy in energies) * TO_MILLI
    span = max(high - low, 1e-9 * max(abs(high), 1e-12))
    return np.asarray(low + span * np.linspace(0, 1, ENERGY_LEVELS + 1) ** 2)


def _rotations(energy_map: EnergyMap) -> str:
    if not energy_map.equilibria:
        return ""
    angles = ", ".join(f"{number(angle, 1)}°" for angle in np.degrees(energy_map.equilibria[0].rotations))
    return f"rotations ({angles})"


def _draw_energy(axes: Axes, energy_map: EnergyMap, levels: Array) -> ContourSet:
    """One map, with its equilibria marked; returns the filled contours."""
    from matplotlib.colors import BoundaryNorm

    first, second = np.degrees(energy_map.first), np.degrees(energy_map.second)
    energy = energy_map.energy.T * TO_MILLI
    filled = axes.contourf(first, second, energy, levels=levels, cmap=MAP, norm=BoundaryNorm(levels, 256))
    axes.contour(first, second, energy, levels=levels, colors=INK, linewidths=0.3, alpha=0.5)
    saddles = sorted({e.energy * TO_MILLI for e in energy_map.equilibria if e.index == 1})
    if saddles:
        axes.contour(first, second, energy, levels=saddles, colors="white", linewidths=1.1)
    for e in energy_map.equilibria:
        x, y = np.degrees(e.tip_rotations[list(energy_map.tubes)])
        sign = MARKS[min(e.index, len(MARKS) - 1)][0]
        axes.plot([x], [y], sign, ms=7, mfc="white", mec=INK, mew=0.9, zorder=5, clip_on=False)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(angle_locator())
    axes.set_xlabel(f"tip angle of tube {energy_map.tubes[0] + 1} (deg)")
    axes.set_ylabel(f"tip angle of tube {energy_map.tubes[1] + 1} (deg)")
    return filled


def _name_marks(figure: Figure, maps: Sequence[EnergyMap]) -> None:
    """Names of the signs that occur, below all panels."""
    from matplotlib.lines import Line2D

    found = sorted({min(e.index, len(MARKS) - 1) for each in maps for e in each.equilibria})
    handles = [
        Line2D([], [], ls="", marker=MARKS[k][0], ms=7, mfc="white", mec=INK, mew=0.9, label=MARKS[k][1]) for k in found
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))


@picture
def plot_stability_map(stability_map: StabilityMap, *, title: str = "") -> Figure:
    """Margin over the rotations of two tubes relative to the others, turned together straight from home.

    Hatched cells were reached through a snap; the line is where the robot snaps, computed exactly.

    Args:
        stability_map: of `stability_map`.
        title: a heading.
    """
    figure = new_figure(5.6, 4.9)
    axes = figure.add_subplot()
    image, handles = draw_map(axes, stability_map)
    first, second = stability_map.tubes
    axes.set_xlabel(f"rotation of tube {first + 1} relative to home (deg)")
    axes.set_ylabel(f"rotation of tube {second + 1} relative to home (deg)")
    axes.set_title(title, loc="left")
    bar = figure.colorbar(image, cax=axes.inset_axes((1.03, 0, 0.035, 1)), label="stability margin")
    bar.outline.set_visible(False)
    figure.legend(handles=handles, loc="outside lower center", ncols=1 if narrow() else 3)
    return figure


def draw_map(axes: Axes, stability_map: StabilityMap) -> tuple[Any, list[Artist]]:
    """Fill `axes` with a map; return the image, for a colour bar, and what a legend explains."""
    angles = np.degrees(stability_map.angles)
    fine, values, snapped = _filled(stability_map)
    image = axes.pcolormesh(
        fine, fine, np.clip(values, 0, 1), cmap=MAP, vmin=0, vmax=1, shading="nearest", rasterized=True
    )
    handles = [_hatch(axes, fine, snapped), *_draw_boundary(axes, stability_map)]
    handles += axes.plot([0], [0], "o", ms=6, mfc="white", mec=INK, mew=1.0, ls="", label="home")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(angle_locator())
    axes.set_aspect("equal")
    axes.set(xlim=(angles[0], angles[-1]), ylim=(angles[0], angles[-1]))
    return image, [h for h in handles if h]


def _filled(stability_map: StabilityMap) -> tuple[Array, Array, Mask]:
    """Angles (F,) deg of a finer map, its margins and whether its points are reached through a snap: (F, F) by rows of
    the second tube.

    Both sides of the boundary are filled from their own points: before a snap the margin falls to 0 there, behind it
    the map begins with where the robot lands. Between points its square is linear, as it falls like
    a root at a fold.
    """
    angles = np.degrees(stability_map.angles)
    fine = np.linspace(angles[0], angles[-1], max(FINE, len(angles)))
    points = np.stack(np.meshgrid(fine, fine, indexing="ij"), axis=-1).reshape(-1, 2)
    grid = np.stack(np.meshgrid(angles, angles, indexing="ij"), axis=-1).reshape(-1, 2)
    square, reached = np.maximum(stability_map.margin.ravel(), 0) ** 2, stability_map.snaps.ravel() > 0
    boundary = np.degrees(stability_map.boundary)
    folds = boundary[np.isfinite(boundary).all(1)]
    behind = _behind(boundary, points)
    values = np.empty(len(points))
    sides = (
        (~behind, np.vstack([grid[~reached], folds]), np.append(square[~reached], np.zeros(len(folds)))),
        (behind, grid[reached], square[reached]),
    )
    for part, known, at in sides:
        if part.any():
            values[part] = np.sqrt(np.maximum(_interpolated(known, at, points[part]), 0)) if len(known) else np.nan
    size = len(fine), len(fine)
    return fine, values.reshape(size).T, behind.reshape(size).T


def _behind(boundary: Array, points: Array) -> Mask:
    """(k,) whether points lie behind the first snap in their direction; its distance is linear between directions."""
    if not len(boundary):
        return np.zeros(len(points), dtype=bool)
    distance = np.append(np.hypot(*boundary.T), np.hypot(*boundary[0]))
    turn = np.arctan2(points[:, 1], points[:, 0]) % (2 * np.pi) / (2 * np.pi) * len(boundary)
    first = np.minimum(turn.astype(int), len(boundary) - 1)
    share = turn - first
    between = (1 - share) * distance[first] + share * distance[first + 1]
    alone = distance[first + np.round(share).astype(int)]  # beside a direction without a snap
    limit = np.where(np.isfinite(between), between, np.where(np.isfinite(alone), alone, np.inf))
    found: Mask = np.hypot(*points.T) > limit
    return found


def _interpolated(known: Array, values: Array, points: Array) -> Array:
    """Linearly between known points, and as the nearest of them beyond."""
    nearest: Array = scipy.interpolate.NearestNDInterpolator(known, values)(points)
    if len(known) < 4:
        return nearest
    inside: Array = scipy.interpolate.LinearNDInterpolator(known, values)(points)
    return np.where(np.isfinite(inside), inside, nearest)


def _hatch(axes: Axes, fine: Array, snapped: Mask) -> Artist | None:
    """Hatching of what is reached through a snap, and its name."""
    from matplotlib.patches import Patch

    if not snapped.any():
        return None
    drawn = axes.contourf(fine, fine, snapped.astype(float), levels=[0.5, 1.5], colors="none", hatches=["////"])
    drawn.set_edgecolor(HATCH_COLOUR)
    drawn.set_linewidth(0)
    look: dict[str, Any] = {"facecolor": "#7C7B78", "edgecolor": HATCH_COLOUR, "hatch": "////", "linewidth": 0}
    return Patch(**look, label="reached through a snap")


def _draw_boundary(axes: Axes, stability_map: StabilityMap) -> list[Artist]:
    """The closed curve of first snaps, broken where directions lead to none."""
    points = np.degrees(np.vstack([stability_map.boundary, stability_map.boundary[:1]]))
    if not np.isfinite(points).any():
        return []
    return [
        *axes.plot(points[:, 0], points[:, 1], color=SNAP_COLOUR, lw=2.0, label="snap on the straight way from home")
    ]
