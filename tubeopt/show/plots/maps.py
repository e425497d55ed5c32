"""Pictures of stability: maps of energy and margin, and branches of equilibria."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ...errors import InputError
from ...files.units import TO_MILLI
from ...solvers.blas import small
from ...stability import Branch, EnergyMap, StabilityMap
from ...stability.maps import APPROACH, pieces, rim
from ...typing import Array, Mask
from ..page import tube_colour
from .labels import arrow, note
from .style import (
    FAINT,
    INK,
    Axes,
    Figure,
    angle_ticks,
    colour_bar,
    entitle,
    narrow,
    new_figure,
    number,
    picture,
    rotations_text,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.contour import ContourSet

MAP = "cividis"
SNAP_COLOUR = "#D55E00"
HATCH_COLOUR = INK
ENERGY_LEVELS = 24
MAX_MAPS = 4
FINE = 361
"""Points per axis of a drawn map: one per degree."""

BETWEEN = 8
"""Drawn points of the boundary for each computed one."""

CORNER = np.pi / 2
"""Angle from one corner of a map to the next, rad."""

SNAPS = "snap on the straight path from home"

MARKS = (("o", "minimum: stable"), ("X", "saddle: unstable"), ("^", "maximum: unstable"))
"""Marker and name of equilibria by their index; the last one for all higher indices."""


@picture
def plot_energy_maps(maps: Sequence[EnergyMap], *, titles: Sequence[str] = ()) -> Figure:
    """Filled contours of elastic energy over two tip angles, up to four maps at one scale of colours.

    Levels are closer where the energy is low. The white line through each saddle is the energy that a robot needs to
    leave its minimum.

    Args:
        maps: results of `energy_map`.
        titles: a heading for each; default its joint rotations.

    Raises:
        InputError: no map or more than four, titles of another number, a name of the picture that does not end in a
            known format.
    """
    from matplotlib.lines import Line2D

    if not 1 <= len(maps) <= MAX_MAPS:
        raise InputError(f"{len(maps)} maps are given; there must be 1 to {MAX_MAPS}")
    if titles and len(titles) != len(maps):
        raise InputError(f"{len(titles)} titles are given for {len(maps)} maps; the numbers must be equal")
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
        title = "".join(rotations_text(e.rotations) for e in maps[k].equilibria[:1])
        panel.set_title(titles[k] if titles else title, loc="left")
    if len({(*each.tubes, *each.first[[0, -1]], *each.second[[0, -1]]) for each in maps}) == 1:
        for panel in panels.ravel():
            panel.label_outer()
    bar = colour_bar(figure, filled, "elastic energy (mJ)", ax=panels, shrink=0.8, aspect=30, pad=0.02)
    bar.set_ticks(levels[::4].tolist(), labels=[f"{level:.1f}" for level in levels[::4]])
    present = sorted({min(e.index, len(MARKS) - 1) for each in maps for e in each.equilibria})
    look: dict[str, Any] = {"ls": "", "ms": 7, "mfc": "white", "mec": INK, "mew": 0.9}
    handles = [Line2D([], [], marker=MARKS[k][0], label=MARKS[k][1], **look) for k in present]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
    return figure


def energy_levels(energies: Sequence[Array]) -> Array:
    """Levels, mJ, for maps of energy, J, that give evenly spaced rings around a minimum."""
    low = min(float(energy.min()) for energy in energies) * TO_MILLI
    high = max(float(energy.max()) for energy in energies) * TO_MILLI
    # Levels must increase, also where the energy is constant.
    span = max(high - low, 1e-9 * max(abs(high), 1e-12))
    # Near a minimum the energy grows with the square of the angle: squares of even steps give even rings.
    return np.asarray(low + span * np.linspace(0, 1, ENERGY_LEVELS + 1) ** 2)


def _draw_energy(axes: Axes, energy_map: EnergyMap, levels: Array) -> ContourSet:
    """Filled contours of an energy map, drawn together with its equilibria."""
    from matplotlib.colors import BoundaryNorm

    first, second = np.degrees(energy_map.first), np.degrees(energy_map.second)
    energy = energy_map.energy.T * TO_MILLI
    filled = axes.contourf(first, second, energy, levels=levels, cmap=MAP, norm=BoundaryNorm(levels, 256))
    axes.contour(first, second, energy, levels=levels, colors=INK, linewidths=0.3, alpha=0.5)
    # A path from one minimum to another must rise to a saddle of index 1 at least (mountain pass theorem).
    saddles = sorted({e.energy * TO_MILLI for e in energy_map.equilibria if e.index == 1})
    if saddles:
        axes.contour(first, second, energy, levels=saddles, colors="white", linewidths=1.1)
    for e in energy_map.equilibria:
        x, y = np.degrees(e.tip_rotations[list(energy_map.tubes)])
        sign = MARKS[min(e.index, len(MARKS) - 1)][0]
        axes.plot([x], [y], sign, ms=7, mfc="white", mec=INK, mew=0.9, zorder=5, clip_on=False)
    angle_ticks(axes.xaxis, axes.yaxis)
    axes.set_xlabel(f"tip angle of tube {energy_map.tubes[0] + 1} (deg)")
    axes.set_ylabel(f"tip angle of tube {energy_map.tubes[1] + 1} (deg)")
    return filled


@picture
def plot_stability_map(stability_map: StabilityMap, *, title: str = "") -> Figure:
    """Picture of the margin over the rotations of two tubes relative to the others, on straight paths from home.

    Hatched points are reached through a snap; the line is the exact snap boundary.

    Args:
        stability_map: result of `stability_map`.
        title: heading.
    """
    figure = new_figure(5.6, 4.9)
    axes = figure.add_subplot()
    image, handles = draw_map(axes, stability_map)
    entitle(axes, title)
    colour_bar(figure, image, "stability margin", cax=axes.inset_axes((1.03, 0, 0.035, 1)))
    figure.legend(handles=handles, loc="outside lower center", ncols=1 if narrow() else 3)
    return figure


def draw_map(axes: Axes, stability_map: StabilityMap) -> tuple[Any, list[Artist]]:
    """Image of a map, for a colour bar, and the handles of its legend.

    Both sides of the boundary are filled from their own points: before a snap the margin falls to 0 there, behind it
    the map starts with the landing. The boundary cuts one image out of the other.
    """
    angles = np.degrees(stability_map.angles)
    fine = np.linspace(angles[0], angles[-1], max(FINE, len(angles)))
    curves = [_smooth(*piece) for piece in pieces(stability_map)]
    look: Any = {"cmap": MAP, "vmin": 0, "vmax": 1, "shading": "nearest", "rasterized": True}
    reached = stability_map.snaps > 0
    # Across the boundary the margin jumps. One interpolation over both sides would smear the jump.
    image = axes.pcolormesh(fine, fine, _filled(stability_map, fine, ~reached, curves), **look)
    handles: list[Artist] = []
    if curves:
        behind = axes.pcolormesh(fine, fine, _filled(stability_map, fine, reached, ()), **look)
        lines = [axes.plot(*curve.points.T, color=SNAP_COLOUR, lw=2.0, label=SNAPS)[0] for curve in curves]
        handles = [_cut_out(axes, behind, curves), lines[0]]
    handles += axes.plot([0], [0], "o", ms=6, mfc="white", mec=INK, mew=1.0, ls="", label="home")
    angle_ticks(axes.xaxis, axes.yaxis)
    axes.set_aspect("equal")
    axes.set(xlim=(angles[0], angles[-1]), ylim=(angles[0], angles[-1]))
    across, up = (f"rotation of tube {tube + 1} relative to home (deg)" for tube in stability_map.tubes)
    axes.set(xlabel=across, ylabel=up)
    return image, handles


class Curve(NamedTuple):
    """Piece of the snap boundary to draw, with points of known margin in front of it."""

    directions: Array
    """(k,) directions of the points of the curve, rad."""
    points: Array
    """(k, 2) rotations, deg."""
    known: Array
    """(m, 2) rotations with a known margin, deg."""
    square: Array
    """(m,) squares of the known margins."""


def _smooth(directions: Array, points: Array, approach: Array) -> Curve:
    """Piece of the boundary with interpolated points, and points in front of it where the margin is known."""
    parts = [np.linspace(*two, BETWEEN, endpoint=False) for two in itertools.pairwise(directions)]
    dense = np.concatenate([*parts, directions[-1:]])
    distance, square = np.hypot(*points.T), approach**2
    if len(directions) > 1:
        # Monotone cubics do not overshoot, so that distances stay positive and squares too.
        distance, square = (scipy.interpolate.PchipInterpolator(directions, y)(dense) for y in (distance, square))
    ray = np.column_stack([np.cos(dense), np.sin(dense)])
    # Distances at which the margin ahead of the snap was computed; the last, 0, is the snap with margin 0.
    before = distance[:, None] - np.append(APPROACH, 0.0)
    known, ahead = before[..., None] * ray[:, None], before >= 0
    values = np.column_stack([square, np.zeros(len(dense))])
    return Curve(dense, np.degrees(distance[:, None] * ray), np.degrees(known[ahead]), values[ahead])


def _filled(stability_map: StabilityMap, fine: Array, selected: Mask, curves: Sequence[Curve]) -> Array:
    """(F, F) margins at angles (F,), deg, rows by the second tube.

    They are interpolated between the selected points (N, N) and the known margins in front of curves. The square of the
    margin is interpolated: the margin itself falls like a root at a fold.
    """
    angles = np.degrees(stability_map.angles)
    first, second = (axis[selected] for axis in np.meshgrid(angles, angles, indexing="ij"))
    known = np.vstack([np.column_stack([first, second]), *(curve.known for curve in curves)])
    # At a fold margin^2 is linear in the distance to it (saddle-node), which a cubic follows; a root it cannot.
    squared = np.clip(stability_map.margin[selected], 0, 1) ** 2
    square = np.concatenate([squared, *(curve.square for curve in curves)])
    if not len(known):
        return np.full((len(fine), len(fine)), np.nan)
    points = np.stack(np.meshgrid(fine, fine), axis=-1).reshape(-1, 2)
    interpolated = _interpolated(known, square, points)
    return np.asarray(np.sqrt(np.clip(interpolated, 0, 1)).reshape(len(fine), len(fine)))


@small
def _interpolated(known: Array, values: Array, points: Array) -> Array:
    """Values at points (P, 2), interpolated between known points (K, 2); beyond them, the value of the nearest one."""
    nearest = scipy.interpolate.NearestNDInterpolator(known, values)
    # Fewer points may have no triangulation with an inside.
    if len(known) < 4:
        return np.asarray(nearest(points))
    out: Array = scipy.interpolate.CloughTocher2DInterpolator(known, values)(points)
    # Outside of the convex hull of the points there is no triangle, and the result is NaN.
    beyond = ~np.isfinite(out)
    out[beyond] = nearest(points[beyond])
    return out


def _cut_out(axes: Axes, behind: Artist, curves: Sequence[Curve]) -> Artist:
    """Clip an image to the region behind the boundary and hatch it; returns the handle of the region for a legend."""
    from matplotlib.patches import Patch, PathPatch
    from matplotlib.path import Path

    rings = []
    for directions, points, *_ in curves:
        # The square's rim between two directions has its corners at odd multiples of 45 deg.
        corners = np.arange(np.ceil(directions[0] / CORNER - 0.5), directions[-1] / CORNER - 0.5) * CORNER + CORNER / 2
        outer = np.degrees(rim(np.sort(np.append(directions, corners))))
        # Along the boundary, and back along the rim of the map: the region between is behind the snap.
        rings.append(Path(np.vstack([points, outer[::-1], points[:1]]), closed=True))
    region = Path.make_compound_path(*rings)
    look: Any = {"facecolor": "none", "edgecolor": HATCH_COLOUR, "hatch": "////", "linewidth": 0}
    axes.add_patch(PathPatch(region, **look))
    behind.set_clip_path(region, axes.transData)
    return Patch(**look | {"facecolor": "#7C7B78"}, label="reached through a snap")


BAND = "#ECEEF1"
DOT_COLOUR = "#0072B2"
FINE_POINTS = 2000


@picture
def plot_branch(
    branch: Branch,
    *,
    tube: int = 0,
    reference: int | None = None,
    dots: ArrayLike | None = None,
    dots_label: str = "closed form",
) -> Figure:
    """Picture of a branch of equilibria: the tip angle of one tube over its input angle, deg.

    Stable parts are solid, unstable ones dashed. At each fold an arrow shows the jump of a slowly turned robot: to the
    first stable part of the curve at the same input. Inputs between folds, where two shapes are stable and the history
    decides, are shaded.

    Args:
        branch: result of `trace_branch`.
        tube: index of the turning tube; 0 is the innermost.
        reference: tube from which both angles are measured; by default the outermost, or the innermost if the
            outermost turns.
        dots: (k, 2) input and tip angles, rad, of another computation, for comparison; `dots_label` names them.

    Raises:
        InputError: tubes that do not exist or are the same, a tube that does not turn against the reference, a name of
            the picture that does not end in a known format.
    """
    n = branch.rotations.shape[1]
    base = reference if reference is not None else (0 if tube == n - 1 else n - 1)
    if tube == base or not {tube, base} <= {*range(n)}:
        raise InputError(f"tube is {tube} and reference {base}; they must be two different tubes from 0 to {n - 1}")
    curve = smooth(branch)
    inputs = np.degrees(curve.rotations[:, tube] - curve.rotations[:, base])
    tips = np.degrees(curve.tip_rotations[:, tube] - curve.tip_rotations[:, base])
    if np.ptp(inputs) < 1e-9:
        raise InputError(f"tube {tube} does not turn against tube {base} along the branch; choose one that does")
    figure = new_figure(6.0, 4.6)
    axes = figure.add_subplot()
    named: set[bool] = set()
    for first, last, stable in stable_parts(curve.margin):
        part = slice(first, last + 1)
        label = "_" if stable in named else "stable" if stable else "unstable"
        look: dict[str, Any] = {"ls": "-", "lw": 2.0} if stable else {"ls": (0, (4, 2)), "lw": 1.4}
        axes.plot(inputs[part], tips[part], color=tube_colour(tube), label=label, zorder=3, **look)
        named.add(stable)
    _draw_folds(axes, curve, inputs, tips)
    if dots is not None:
        x, y = np.degrees(np.asarray(dots, dtype=float)).T
        axes.plot(x, y, ".", ms=5, color=DOT_COLOUR, zorder=6, label=dots_label)
    axes.set_xlabel(f"input angle of tube {tube + 1} relative to tube {base + 1} (deg)")
    axes.set_ylabel(f"tip angle of tube {tube + 1} relative to tube {base + 1} (deg)")
    axes.grid()
    angle_ticks(axes.xaxis, axes.yaxis)
    axes.margins(x=0.07)
    axes.legend(loc="upper left" if (tips[-1] > tips[0]) == (inputs[-1] > inputs[0]) else "upper right")
    return figure


def smooth(branch: Branch) -> Branch:
    """Branch with further points on a cubic spline through its own points."""
    columns = np.column_stack([branch.fraction, branch.rotations, branch.tip_rotations])
    # Over its own length a branch is single-valued, also at folds, where it turns back in the input.
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(columns, axis=0), axis=1))])
    # A point that was found twice is at distance 0 from the last one, and splines need increasing abscissae.
    along, first = np.unique(along, return_index=True)
    fine = np.union1d(along, np.linspace(0.0, along[-1], FINE_POINTS))
    values = scipy.interpolate.CubicSpline(along, columns[first])(fine)
    n = branch.rotations.shape[1]
    return replace(
        branch,
        fraction=values[:, 0],
        rotations=values[:, 1 : n + 1],
        tip_rotations=values[:, n + 1 :],
        # Linear, as a cubic could overshoot to the other sign and move a fold.
        margin=np.interp(fine, along, branch.margin[first]),
    )


def fold_points(branch: Branch) -> list[int]:
    """Indices of the points of a branch that are folds."""
    distances = [np.abs(branch.tip_rotations - fold.tip_rotations).max(1) for fold in branch.folds]
    return [int(np.argmin(distance)) for distance in distances]


def landing(branch: Branch, fold: int) -> float | None:
    """Fractional index of the point where a robot lands that snaps at point `fold`; None if it lands on no point.

    It is the first stable point with the same input on the far side of the unstable part that starts at the fold.
    """
    count = len(branch.fraction)
    # Into the unstable part: the side of the fold with the smaller margin.
    step = 1 if branch.margin[min(fold + 1, count - 1)] < branch.margin[max(fold - 1, 0)] else -1
    offset = branch.fraction - branch.fraction[fold]
    k = fold + step
    while 0 <= k + step < count:
        # A change of sign: between both points the branch has the input of the fold again.
        if offset[k] * offset[k + step] <= 0 and offset[k] != offset[k + step]:
            part = offset[k] / (offset[k] - offset[k + step])
            if branch.margin[k] + part * (branch.margin[k + step] - branch.margin[k]) > 0:
                return k + step * float(part)
        k += step
    return None


class Part(NamedTuple):
    """Part of a curve of equilibria that are all stable or all unstable."""

    first: int
    last: int
    stable: bool


def stable_parts(margin: Array) -> list[Part]:
    """Parts of a curve, from the margins (k,) of its points."""
    # A segment from a fold (margin 0) is of the kind of its other end.
    stable = margin[:-1] + margin[1:] > 0
    cuts = [0, *(np.flatnonzero(stable[1:] != stable[:-1]) + 1).tolist(), len(stable)]
    return [Part(first, last, bool(stable[first])) for first, last in pairwise(cuts)]


def _draw_folds(axes: Axes, curve: Branch, inputs: Array, tips: Array) -> None:
    """Draw folds, the jumps from them, and a band over the inputs between two folds."""
    folds = fold_points(curve)
    if folds:
        axes.plot(inputs[folds], tips[folds], "o", ms=5.5, mfc="white", mec=INK, mew=1.2, zorder=5, label="fold")
    for fold in folds:
        x, y = float(inputs[fold]), float(tips[fold])
        neighbours = curve.fraction[[max(fold - 1, 0), min(fold + 1, len(curve.fraction) - 1)]]
        # Names stand where the robot comes from no more: beyond the fold as the input grows or falls.
        forth = bool(neighbours.mean() < curve.fraction[fold])
        outward = 1 if forth == (inputs[-1] > inputs[0]) else -1
        label = f"input {x:.3f}°\ntip {y:.3f}°".replace("-", "\N{MINUS SIGN}")
        note(axes, label, (x, y), (9.0 * outward, 0.0))
        landed = landing(curve, fold)
        if landed is not None:
            end = float(np.interp(landed, np.arange(len(tips)), tips))
            arrow(axes, (x, y), (x, end), INK, head=11, margins=(4, 1))
            label = f"snap: tip turns {number(abs(end - y), 1)}°"
            note(axes, label, (x, (y + end) / 2), (5.0 * outward, 0.0), colour=FAINT)
    for first, second in pairwise(folds):
        if curve.margin[(first + second) // 2] < 0:
            name = "more than one stable shape" if first == folds[0] else None
            axes.axvspan(*sorted(inputs[[first, second]]), color=BAND, lw=0, zorder=0, label=name)
