"""Pictures of designs: task poses in their anatomy, what margin costs, what manufacture leaves, what two hold."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from ...bodies.corridors import Corridor
from ...bodies.obstacles import Capsule, Sphere
from ...design import Avoid, DesignSolution, DesignTask, ParetoFront, Reach, StockChoice, ToleranceAnalysis
from ...design.requirements import of_kind
from ...equilibrium.result import Equilibrium
from ...errors import InputError
from ...files.units import TO_MM
from ...planning import PairShare
from ...stability import StabilityMap
from ...typing import Array
from ..page import tube_colour
from ..surfaces import Centreline, visible
from .maps import draw_map
from .style import FAINT, INK, Axes, Figure, colour_bar, disk, entitle, headed, narrow, new_figure, picture

if TYPE_CHECKING:
    from matplotlib.collections import Collection

CORRIDOR = "#DCE3EA"
BODY = "#C9CDD2"
FREE, LOST = "#0072B2", "#D55E00"
ALONG = 100
"""Points along what shows of a tube."""

VIEWS = ((1, 2), (0, 2))
"""Coordinates across and up of the two views."""


@picture
def plot_poses(solution: DesignSolution) -> Figure:
    """A design in its task poses, seen from two sides: every tube in its colour where it shows, the corridor and
    obstacles behind, targets as rings.
    """
    figure = new_figure(8.2, 4.8)
    views = figure.subplots(1, 2, sharey=True)
    for axes, (i, j) in zip(views, VIEWS, strict=True):
        _draw_anatomy(axes, solution, i, j)
        for equilibrium in solution.equilibria:
            _draw_arm(axes, equilibrium, i, j)
        _draw_targets(axes, solution, i, j)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_xlabel(f"{'xyz'[i]} (mm)")
    views[0].set_ylabel("z (mm)")
    least = min((e.margin for e in solution.equilibria), default=1.0)
    count = len(solution.equilibria)
    headed(figure, f"{solution.robot.name or 'design'}: {count} task poses, least margin {least:.3f}")
    handles = []
    for k in range(solution.robot.n_tubes):
        handles += views[0].plot([], [], color=tube_colour(k), lw=2 + k, label=f"tube {k + 1}")
    if of_kind(solution.task.requirements, Reach):
        handles += views[0].plot([], [], "o", ms=6, mfc="none", mec=INK, label="target")
    bodies = [body for avoid in of_kind(solution.task.requirements, Avoid) for body in avoid.obstacles]
    if of_kind(bodies, Corridor):
        handles += views[0].plot([], [], color=CORRIDOR, lw=8, label="corridor")
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
    return figure


def _draw_arm(axes: Axes, equilibrium: Equilibrium, i: int, j: int) -> None:
    line = Centreline(equilibrium)
    for tube, start, end, *_ in visible(equilibrium):
        points = line.position(np.linspace(start, end, ALONG))[:, [i, j]] * TO_MM
        axes.plot(*points.T, color=tube_colour(tube), lw=1.2 + 0.7 * tube, solid_capstyle="butt", zorder=4)


def _draw_anatomy(axes: Axes, solution: DesignSolution, i: int, j: int) -> None:
    for avoid in of_kind(solution.task.requirements, Avoid):
        for body in avoid.obstacles:
            if isinstance(body, Sphere):
                centre = np.array(body.centre)[[i, j]] * TO_MM
                disk(axes, centre, body.radius * TO_MM, fc=BODY, ec=FAINT, lw=0.7, zorder=1)
            elif isinstance(body, Capsule):
                line = np.array([body.start, body.end])[:, [i, j]] * TO_MM
                _draw_tube(axes, line, np.full(2, body.radius * TO_MM), BODY)
            elif isinstance(body, Corridor):
                _draw_tube(axes, np.array(body.centreline)[:, [i, j]] * TO_MM, body.radii * TO_MM, CORRIDOR)


def _draw_tube(axes: Axes, line: Array, radii: Array, colour: str) -> None:
    """All that is within radii (k,) of a projected polyline (k, 2)."""
    from matplotlib.patches import Polygon

    for (a, b), (wide, slim) in zip(pairwise(line), pairwise(radii.tolist()), strict=True):
        way = b - a
        # Seen end-on, a segment has no length, and the discs at its ends are all that shows.
        size = float(np.linalg.norm(way))
        if size > 1e-9:
            across = np.array([-way[1], way[0]]) / size
            corners = [a + wide * across, b + slim * across, b - slim * across, a - wide * across]
            axes.add_patch(Polygon(corners, fc=colour, ec="none", zorder=0))
    for centre, radius in zip(line, radii.tolist(), strict=True):
        disk(axes, centre, radius, fc=colour, ec="none", zorder=0)


def _draw_targets(axes: Axes, solution: DesignSolution, i: int, j: int) -> None:
    for reach in of_kind(solution.task.requirements, Reach):
        points = np.array([target.position for target in reach.targets]) * TO_MM
        axes.plot(points[:, i], points[:, j], "o", ms=6, mfc="none", mec=INK, mew=0.9, ls="", zorder=5)


@picture
def plot_before_after(maps: tuple[StabilityMap, StabilityMap], *, heading: str = "") -> Figure:
    """Stability maps of a robot before and after a design, at one scale."""
    figure = new_figure(8.6, 4.6)
    views = figure.subplots(1, 2, sharey=True)
    for axes, chart, name in zip(views, maps, ("before", "after"), strict=True):
        image, handles = draw_map(axes, chart)
        snapped = 100 * float(np.mean(chart.snaps > 0))
        axes.set_title(f"{name}: {snapped:.0f} % reached through a snap", loc="left")
        axes.label_outer()
        if name == "before":
            figure.legend(handles=handles, loc="outside lower center", ncols=3)
    colour_bar(figure, image, "stability margin", ax=views, pad=0.02, shrink=0.8, aspect=28)
    return headed(figure, heading)


@picture
def plot_front(front: ParetoFront) -> Figure:
    """The objective against the margin that is demanded, one dot per design."""
    figure = new_figure(4.8, 3.4)
    axes = figure.add_subplot()
    (wanted,) = front.task.objectives
    margin = [point.margin for point in front.points]
    value = [point.objective * wanted.factor for point in front.points]
    axes.plot(margin, value, "-o", color=FREE, ms=4.5, mfc="white", mew=1.2, lw=1.4)
    if front.ended is not None:
        axes.axvline(front.ended, color=LOST, lw=1.0, ls="--")
        axes.annotate(
            "no design found", (front.ended, 0.96), xycoords=("data", "axes fraction"), xytext=(-4, 0),
            textcoords="offset points", color=LOST, ha="right", va="top", rotation=90,
        )  # fmt: skip
    axes.set_xlabel("margin demanded")
    axes.set_ylabel(f"{wanted.words} ({wanted.unit})" if wanted.unit else wanted.words)
    entitle(axes, front.task.name or front.task.robot.name)
    return figure


@picture
def plot_tolerance(analysis: ToleranceAnalysis, *, heading: str = "") -> Figure:
    """The certificate of robots as they may be made, those that may snap apart from the others; and how far the tips of
    the task poses spread.
    """
    poses = analysis.tip.shape[1]
    figure = new_figure(7.4 if poses else 4.6, 3.2)
    axes = figure.add_subplot(1, 2 if poses else 1, 1)
    values = analysis.certificate
    low, high = float(values.min()), float(values.max())
    width = max(high - low, 1e-6) / 30
    # One edge lies at 0, so that no bar is of both kinds.
    edges = width * np.arange(np.floor(low / width), np.ceil(high / width) + 1)
    for part, colour, words in ((values > 0, FREE, "snap-free"), (values <= 0, LOST, "not proved snap-free")):
        if part.any():
            axes.hist(values[part], edges.tolist(), color=colour, label=f"{words}, {100 * part.mean():.1f} %")
    axes.axvline(0.0, color=INK, lw=0.8)
    axes.set(xlabel="certificate", ylabel=f"of {len(values)} samples")
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)
    if poses:
        beside = figure.add_subplot(1, 2, 2)
        at = np.arange(1, poses + 1)
        beside.bar(at, analysis.spread_95 * TO_MM, color="#B8CEDF", width=0.7, label="95 % within")
        beside.bar(at, analysis.spread * TO_MM, color=FREE, width=0.35, label="RMS")
        beside.set_xticks(at)
        beside.set(xlabel="task pose", ylabel="distance of the tip (mm)")
        beside.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)
    return headed(figure, heading)


@picture
def plot_stock(choice: StockChoice, *, task: DesignTask, most: int = 12) -> Figure:
    """The best choices from stock: each stack of tubes to scale in cross-section, and the objective it reaches."""
    from matplotlib.patches import Annulus

    wanted = task.objectives[0]
    best = [one for one in choice.candidates if one.objective is not None][:most]
    figure = new_figure(6.4, 0.8 + 0.34 * len(best))
    left, axes = figure.subplots(1, 2, sharey=True, width_ratios=(1, 8))
    for row, one in enumerate(best):
        for k, size in enumerate(one.sizes):
            outer = 0.45 * size.outer_diameter / max(s.outer_diameter for c in best for s in c.sizes)
            # Annulus takes the width of the ring: r_o - r_i.
            wall = outer * (1 - size.inner_diameter / size.outer_diameter)
            left.add_patch(Annulus((0.0, row), outer, wall, fc=tube_colour(k), ec="none"))
        value = (one.objective or 0.0) * wanted.factor
        axes.barh(row, value, height=0.62, color=FREE)
        words = " + ".join(size.name for size in one.sizes)
        axes.text(value, row, f"{value:.2f} ", ha="right", va="center", color="white")
        axes.text(0, row, f"  {words}", ha="left", va="center", color="white")
    left.set_aspect("equal")
    left.set(xlim=(-0.6, 0.6), ylim=(len(best) - 0.4, -0.6))
    left.axis("off")
    axes.spines["left"].set_visible(False)
    axes.tick_params(left=False, labelleft=False)
    axes.set_xlabel(f"{wanted.words} ({wanted.unit})" if wanted.unit else wanted.words)
    return figure


TICKS = 5
"""Places from one tick to the next."""


@picture
def plot_pair_shares(
    shares: tuple[PairShare, PairShare], *, names: tuple[str, str] = ("one", "other"), title: str = ""
) -> Figure:
    """Figure of the distance between two arms with their tips at any two targets, before and after.

    Grey: an arm does not reach its target, or both targets are the same.

    Args:
        shares: of the robots as given, and of the designs.
        names: of the arms.   title: heading; by default the names of the arms.
    """
    figure = new_figure(7.2, 3.4)
    panels = figure.subplots(1, 2, sharey=True)
    # The clearance is the middle of the colours: what is kept and what is not differ in hue.
    most = 2 * TO_MM * max(shares[1].clearance, 1e-4)
    for panel, one, when in zip(panels, shares, ("as given", "as designed"), strict=True):
        # NaN lets the grey of the panel show.
        table = np.where(np.eye(len(one.apart), dtype=bool), np.nan, one.apart * TO_MM)
        panel.set_facecolor(FAINT)
        panel.imshow(table, vmin=0, vmax=most, cmap="RdBu")
        panel.set(title=f"{when}: {100 * one.share:.0f} % of pairs", xlabel=f"target number of {names[1]}")
        panel.set(xticks=range(0, len(table), TICKS), yticks=range(0, len(table), TICKS))
    panels[0].set_ylabel(f"target number of {names[0]}")
    where: dict[str, Any] = {"location": "bottom", "shrink": 0.6, "aspect": 40, "extend": "both"}
    colour_bar(figure, panels[0].images[0], "distance between arms (mm)", ax=panels, **where)
    headed(figure, title or f"Pairs of targets that {names[0]} and {names[1]} reach together")
    return figure


@picture
def plot_pair_places(
    shares: tuple[PairShare, PairShare], *, places: Array, names: tuple[str, str] = ("one", "other"), title: str = ""
) -> Figure:
    """Map of the targets of two arms, before and after, coloured by the targets that remain for the other arm.

    The left half of a point is the first arm with its tip there, the right half the second. The colour is the fraction
    of the other targets that the other tip then reaches without contact. White: the arm does not reach the target.

    Args:
        shares: of the robots as given, and of the designs.
        places: (N, 3) positions in a frame of both, m.
        names: of the arms.   title: heading; by default which half is which arm.

    Raises:
        InputError: the number of places is not that of the shares.
    """
    if any(np.shape(places) != (len(one.apart), 3) for one in shares):
        raise InputError(f"places has shape {np.shape(places)}; it must be ({len(shares[0].apart)}, 3)")
    figure = new_figure(7.0, 7.6)
    panels = figure.subplots(2, 2, sharex=True, sharey="row")
    # Half of the largest extent and a tenth of it as an edge: all panels have one scale.
    middle, half = (places.max(0) + places.min(0)) / 2 * TO_MM, 0.6 * float(np.ptp(places, axis=0).max()) * TO_MM
    for column, one, when in zip(panels.T, shares, ("as given", "as designed"), strict=True):
        column[0].set_title(f"{when}: {100 * one.share:.0f} % of pairs")
        column[1].set_xlabel("x (mm)")
        for axes, axis in zip(column, (2, 1), strict=True):  # seen along y, and along z
            drawn = [_draw_halves(axes, places[:, [0, axis]] * TO_MM, one, arm) for arm in (0, 1)]
            axes.set_aspect("equal")
            axes.set(xlim=middle[0] + np.array([-half, half]), ylim=middle[axis] + np.array([-half, half]))
    panels[0, 0].set_ylabel("z (mm)")
    panels[1, 0].set_ylabel("y (mm)")
    where: dict[str, Any] = {"location": "bottom", "shrink": 0.6, "aspect": 40}
    colour_bar(figure, drawn[0], "targets left for the other arm (fraction)", ax=panels, **where)
    return headed(figure, title or f"tip of {names[0]}: left half,  tip of {names[1]}: right half")


def _draw_halves(axes: Axes, points: Array, share: PairShare, arm: int) -> Collection:
    """The left (arm 0) or right half of each point (N, 2), mm, by the targets left for the other arm."""
    from matplotlib.markers import MarkerStyle

    reached = share.reached[arm].reached
    # Rows are targets of the first arm; the sum over the other index counts its partners.
    held = share.held.sum(1 - arm) / (len(points) - 1)
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
    return axes.scatter(x[reached], y[reached], c=held[reached], cmap="cividis", vmin=0, vmax=1, **look)
