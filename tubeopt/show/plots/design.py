"""Pictures of designs: task poses, trade-offs, tolerances, stock, and pairs of robots."""

from __future__ import annotations

from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from ...bodies.corridors import Corridor
from ...bodies.obstacles import Capsule, Sphere
from ...design import (
    Avoid,
    CustomObjective,
    DesignSolution,
    DesignTask,
    Objective,
    ParetoFront,
    Reach,
    StockChoice,
    ToleranceAnalysis,
)
from ...design.requirements import of_kind
from ...errors import InputError
from ...files.units import TO_MM
from ...planning import PairFraction
from ...stability import StabilityMap
from ...typing import Array
from ..page import tube_colour
from .labels import legend_above
from .maps import draw_map
from .panels import draw_bars
from .scene import draw_lines
from .style import FAINT, INK, Axes, Figure, colour_bar, disk, entitle, headed, narrow, new_figure, picture

if TYPE_CHECKING:
    from matplotlib.collections import Collection

CORRIDOR = "#DCE3EA"
BODY = "#C9CDD2"
FREE, LOST = "#0072B2", "#D55E00"
VIEWS = ((1, 2), (0, 2))
"""Horizontal and vertical coordinates of the two views."""


@picture
def plot_poses(solution: DesignSolution) -> Figure:
    """Picture of a design in its task poses from two sides, with corridor, obstacles and targets."""
    figure = new_figure(8.2, 4.8)
    views = figure.subplots(1, 2, sharey=True)
    bodies = [body for avoid in of_kind(solution.task.requirements, Avoid) for body in avoid.obstacles]
    for axes, (i, j) in zip(views, VIEWS, strict=True):
        plane = [i, j]
        for body in bodies:
            if isinstance(body, Sphere):
                centre = np.array(body.centre)[plane] * TO_MM
                disk(axes, centre, body.radius * TO_MM, fc=BODY, ec=FAINT, lw=0.7, zorder=1)
            elif isinstance(body, Capsule):
                line = np.array([body.start, body.end])[:, plane] * TO_MM
                _draw_swept(axes, line, np.full(2, body.radius * TO_MM), BODY)
            elif isinstance(body, Corridor):
                _draw_swept(axes, np.array(body.centreline)[:, plane] * TO_MM, body.radii * TO_MM, CORRIDOR)
        for equilibrium in solution.equilibria:
            draw_lines(axes, equilibrium, partial(_projected, plane), widths=(1.2, 0.7))
        for reach in of_kind(solution.task.requirements, Reach):
            x, y = np.array([target.position for target in reach.targets]).T[plane] * TO_MM
            axes.plot(x, y, "o", ms=6, mfc="none", mec=INK, mew=0.9, ls="", zorder=5)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_xlabel(f"{'xyz'[i]} (mm)")
    views[0].set_ylabel("z (mm)")
    min_margin = min((e.margin for e in solution.equilibria), default=1.0)
    count = len(solution.equilibria)
    headed(figure, f"{solution.robot.name or 'design'}: {count} task poses, least margin {min_margin:.3f}")
    handles = []
    for k in range(solution.robot.n_tubes):
        handles += views[0].plot([], [], color=tube_colour(k), lw=2 + k, label=f"tube {k + 1}")
    if of_kind(solution.task.requirements, Reach):
        handles += views[0].plot([], [], "o", ms=6, mfc="none", mec=INK, label="target")
    if of_kind(bodies, Corridor):
        handles += views[0].plot([], [], color=CORRIDOR, lw=8, label="corridor")
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
    return figure


def _projected(plane: list[int], points: Array) -> Array:
    """(k, 2) coordinates of points (k, 3), m, in a plane, mm."""
    projected: Array = points[:, plane] * TO_MM
    return projected


def _draw_swept(axes: Axes, line: Array, radii: Array, colour: str) -> None:
    """Draw the projected body within radii (k,) of a polyline (k, 2), mm."""
    from matplotlib.patches import Polygon

    for (a, b), (wide, slim) in zip(pairwise(line), pairwise(radii.tolist()), strict=True):
        along = b - a
        # Seen end-on, a segment has no length, and only the discs at its ends show.
        length = float(np.linalg.norm(along))
        if length > 1e-9:
            across = np.array([-along[1], along[0]]) / length
            corners = [a + wide * across, b + slim * across, b - slim * across, a - wide * across]
            axes.add_patch(Polygon(corners, fc=colour, ec="none", zorder=0))
    for centre, radius in zip(line, radii.tolist(), strict=True):
        disk(axes, centre, radius, fc=colour, ec="none", zorder=0)


@picture
def plot_before_after(maps: tuple[StabilityMap, StabilityMap], *, heading: str = "") -> Figure:
    """Picture of the stability maps of a robot before and after a design, at one scale."""
    figure = new_figure(8.6, 4.6)
    views = figure.subplots(1, 2, sharey=True)
    for axes, margin_map, name in zip(views, maps, ("before", "after"), strict=True):
        image, handles = draw_map(axes, margin_map)
        snapped = 100 * float(np.mean(margin_map.snaps > 0))
        axes.set_title(f"{name}: {snapped:.0f} % reached through a snap", loc="left")
        axes.label_outer()
        if name == "before":
            figure.legend(handles=handles, loc="outside lower center", ncols=3)
    colour_bar(figure, image, "stability margin", ax=views, pad=0.02, shrink=0.8, aspect=28)
    return headed(figure, heading)


@picture
def plot_front(front: ParetoFront) -> Figure:
    """Picture of the objective over the required margin, one dot per design."""
    figure = new_figure(4.8, 3.4)
    axes = figure.add_subplot()
    (objective,) = front.task.objectives
    margin = [point.margin for point in front.points]
    value = [point.objective * objective.factor for point in front.points]
    axes.plot(margin, value, "-o", color=FREE, ms=4.5, mfc="white", mew=1.2, lw=1.4)
    if front.ended is not None:
        axes.axvline(front.ended, color=LOST, lw=1.0, ls="--")
        axes.annotate(
            "no design found", (front.ended, 0.96), xycoords=("data", "axes fraction"), xytext=(-4, 0),
            textcoords="offset points", color=LOST, ha="right", va="top", rotation=90,
        )  # fmt: skip
    axes.set_xlabel("required margin")
    axes.set_ylabel(_axis_name(objective))
    entitle(axes, front.task.name or front.task.robot.name)
    return figure


@picture
def plot_tolerance(analysis: ToleranceAnalysis, *, heading: str = "") -> Figure:
    """Picture of the certificates of robots within tolerances, and of the spread of their tips in the task poses."""
    poses = analysis.tip.shape[1]
    figure = new_figure(7.4 if poses else 4.6, 3.2)
    axes = figure.add_subplot(1, 2 if poses else 1, 1)
    values = analysis.certificate
    bounded = values[np.isfinite(values)]
    low, high = (float(bounded.min()), float(bounded.max())) if len(bounded) else (0.0, 0.0)
    width = max(high - low, 1e-6) / 30
    # One edge lies at 0, so that no bar is of both kinds.
    edges = width * np.arange(np.floor(low / width), np.ceil(high / width) + 1)
    for kind, colour, name in ((values > 0, FREE, "snap-free"), (values <= 0, LOST, "not proved snap-free")):
        if kind.any():
            # A bundle without any proof has -inf: it counts in the number only.
            axes.hist(
                values[kind & np.isfinite(values)],
                edges.tolist(),
                color=colour,
                label=f"{name}, {100 * kind.mean():.1f} %",
            )
    axes.axvline(0.0, color=INK, lw=0.8)
    axes.set(xlabel="certificate", ylabel=f"of {len(values)} samples")
    legend_above(axes, 2)
    if poses:
        spread = figure.add_subplot(1, 2, 2)
        numbers = np.arange(1, poses + 1)
        spread.bar(numbers, analysis.spread_95 * TO_MM, color="#B8CEDF", width=0.7, label="95 % within")
        spread.bar(numbers, analysis.spread * TO_MM, color=FREE, width=0.35, label="RMS")
        spread.set_xticks(numbers)
        spread.set(xlabel="task pose", ylabel="distance of the tip (mm)")
        legend_above(spread, 2)
    return headed(figure, heading)


@picture
def plot_stock(choice: StockChoice, *, task: DesignTask, limit: int = 12) -> Figure:
    """Picture of the best choices from stock: cross-sections of the tubes to scale, and the objective.

    most: largest number of choices.
    """
    from matplotlib.patches import Annulus

    objective = task.objectives[0]
    best = [each for each in choice.candidates if each.objective is not None][:limit]
    figure = new_figure(6.4, 0.8 + 0.34 * len(best))
    left, axes = figure.subplots(1, 2, sharey=True, width_ratios=(1, 8))
    largest = max(size.outer_diameter for candidate in best for size in candidate.sizes)
    for row, candidate in enumerate(best):
        for k, size in enumerate(candidate.sizes):
            outer = 0.45 * size.outer_diameter / largest
            # Annulus takes the width of the ring: r_o - r_i.
            wall = outer * (1 - size.inner_diameter / size.outer_diameter)
            left.add_patch(Annulus((0.0, row), outer, wall, fc=tube_colour(k), ec="none"))
    values = [objective.factor * (candidate.objective or 0.0) for candidate in best]
    names = [" + ".join(size.name for size in candidate.sizes) for candidate in best]
    bars = draw_bars(axes, [""] * len(best), values, _axis_name(objective), colours=FREE)
    for bar, name, value in zip(bars, names, values, strict=True):
        y = bar.get_y() + bar.get_height() / 2
        axes.text(0, y, f"  {name}", ha="left", va="center", color="white")
        axes.text(value, y, f"{value:.2f} ", ha="right", va="center", color="white")
    left.set_aspect("equal")
    left.set(xlim=(-0.6, 0.6))
    left.axis("off")
    axes.spines["left"].set_visible(False)
    axes.tick_params(left=False, labelleft=False)
    return figure


def _axis_name(objective: Objective | CustomObjective) -> str:
    """Name of an objective with its unit."""
    return f"{objective.description} ({objective.unit})" if objective.unit else objective.description


TICK_STEP = 5
"""Targets from one tick to the next."""


@picture
def plot_pair_fractions(
    reaches: tuple[PairFraction, PairFraction], *, names: tuple[str, str] = ("one", "other"), title: str = ""
) -> Figure:
    """Figure of the distance between two arms with their tips at any two targets, before and after.

    Grey: an arm does not reach its target, or both targets are the same.

    Args:
        reaches: results for the initial robots, and for the designs.
        names: names of the arms.   title: heading; by default the names of the arms.
    """
    figure = new_figure(7.2, 3.4)
    panels = figure.subplots(1, 2, sharey=True)
    # The clearance is the middle of the colours: satisfied and violated pairs differ in hue.
    largest = 2 * TO_MM * max(reaches[1].clearance, 1e-4)
    for panel, reach, when in zip(panels, reaches, ("as given", "as designed"), strict=True):
        # NaN lets the grey of the panel show.
        table = np.where(np.eye(len(reach.apart), dtype=bool), np.nan, reach.apart * TO_MM)
        panel.set_facecolor(FAINT)
        panel.imshow(table, vmin=0, vmax=largest, cmap="RdBu")
        panel.set(title=f"{when}: {100 * reach.fraction:.0f} % of pairs", xlabel=f"target number of {names[1]}")
        panel.set(xticks=range(0, len(table), TICK_STEP), yticks=range(0, len(table), TICK_STEP))
    panels[0].set_ylabel(f"target number of {names[0]}")
    where: dict[str, Any] = {"location": "bottom", "shrink": 0.6, "aspect": 40, "extend": "both"}
    colour_bar(figure, panels[0].images[0], "distance between arms (mm)", ax=panels, **where)
    headed(figure, title or f"Pairs of targets that {names[0]} and {names[1]} reach together")
    return figure


@picture
def plot_pair_places(
    reaches: tuple[PairFraction, PairFraction],
    *,
    places: Array,
    names: tuple[str, str] = ("one", "other"),
    title: str = "",
) -> Figure:
    """Map of the targets of two arms, before and after, coloured by the targets that remain for the other arm.

    The left half of a point is the first arm with its tip there, the right half the second. The colour is the fraction
    of the other targets that the other tip then reaches without contact. White: the arm does not reach the target.

    Args:
        reaches: results for the initial robots, and for the designs.
        places: (N, 3) positions of the targets in a common frame, m.
        names: names of the arms.   title: heading; by default it assigns the halves to the arms.

    Raises:
        InputError: the number of places is not that of the reaches.
    """
    if any(np.shape(places) != (len(reach.apart), 3) for reach in reaches):
        raise InputError(f"places has shape {np.shape(places)}; it must be ({len(reaches[0].apart)}, 3)")
    figure = new_figure(7.0, 7.6)
    panels = figure.subplots(2, 2, sharex=True, sharey="row")
    # Half of the largest extent and a tenth of it as an edge: all panels have one scale.
    middle, half = (places.max(0) + places.min(0)) / 2 * TO_MM, 0.6 * float(np.ptp(places, axis=0).max()) * TO_MM
    for column, reach, when in zip(panels.T, reaches, ("as given", "as designed"), strict=True):
        column[0].set_title(f"{when}: {100 * reach.fraction:.0f} % of pairs")
        column[1].set_xlabel("x (mm)")
        for axes, axis in zip(column, (2, 1), strict=True):  # seen along y, and along z
            drawn = [_draw_halves(axes, places[:, [0, axis]] * TO_MM, reach, arm) for arm in (0, 1)]
            axes.set_aspect("equal")
            axes.set(xlim=middle[0] + np.array([-half, half]), ylim=middle[axis] + np.array([-half, half]))
    panels[0, 0].set_ylabel("z (mm)")
    panels[1, 0].set_ylabel("y (mm)")
    where: dict[str, Any] = {"location": "bottom", "shrink": 0.6, "aspect": 40}
    colour_bar(figure, drawn[0], "targets left for the other arm (fraction)", ax=panels, **where)
    return headed(figure, title or f"tip of {names[0]}: left half,  tip of {names[1]}: right half")


def _draw_halves(axes: Axes, points: Array, reach: PairFraction, arm: int) -> Collection:
    """Left (arm 0) or right half of each point (N, 2), mm, coloured by the targets left for the other arm."""
    from matplotlib.markers import MarkerStyle

    reached = reach.reached[arm].reached
    # Rows are targets of the first arm; the sum over the other index counts its partners.
    left = reach.held.sum(1 - arm) / (len(points) - 1)
    half: Any = MarkerStyle("o", fillstyle=("left", "right")[arm])
    look: dict[str, Any] = {
        "s": 20 if narrow() else 60,
        "marker": half,
        "edgecolors": INK,
        "linewidths": 0.5,
        "zorder": 3,
    }
    x, y = points.T
    axes.scatter(x[~reached], y[~reached], c="white", **look)
    return axes.scatter(x[reached], y[reached], c=left[reached], cmap="cividis", vmin=0, vmax=1, **look)
