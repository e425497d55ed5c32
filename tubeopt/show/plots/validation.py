"""Measured against predicted tips: residual vectors, and errors by direction and separation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy

from ...files.units import TO_MM
from ...typing import Array
from ...validation import Comparison, ErrorTable, Validation
from ..page import tube_colour
from .stage import note, round_below
from .style import FAINT, INK, Axes, Figure, disk, entitle, headed, name_above, narrow, new_figure, picture

MEASURED = "#D55E00"
PREDICTED = "#0072B2"
LONG_ENOUGH = 0.16
"""Arrows are lengthened by a round factor until the longest is this part of the picture's width."""


@picture
def plot_residuals(validation: Validation, *, when: str = "") -> Figure:
    """Figure of predicted tips with arrows to the measured ones, along the plate's axis and from the side.

    Arrows are to scale, or lengthened by the factor in the heading.

    Args:
        when: words for the heading, such as "after the fit".
    """
    v = validation
    figure = new_figure(8.0, 4.6)
    above, beside = figure.subplots(1, 2)
    seen = np.isfinite(v.errors)
    spread = float(np.ptp(v.predicted[seen], axis=0).max()) or 1e-3
    # A round factor, so that a reader can divide by it; never below 1, as long errors are seen anyway.
    factor = max(1.0, round_below(LONG_ENOUGH * spread / max(float(np.nanmax(v.errors)), 1e-12)))
    for axes, (i, j) in ((above, (0, 1)), (beside, (0, 2))):
        _draw_arrows(axes, v.predicted[:, [i, j]] * TO_MM, v.residuals[:, [i, j]] * TO_MM, factor)
        axes.set(xlabel=f"{'xyz'[i]} (mm)", ylabel=f"{'xyz'[j]} (mm)")
    above.set_title("seen along the axis of the base", loc="left")
    beside.set_title("seen from the side", loc="left")
    scale = "to scale" if factor == 1 else f"{factor:g} times their length"
    s = v.summary
    headed(
        figure,
        f"{_named(v, when)}: {s.count} measured tips, registration {v.registration.method}, error mean "
        f"{s.mean * TO_MM:.2f} mm, max {s.max * TO_MM:.2f} mm\narrows from predicted to measured, {scale}",
    )
    return figure


def _draw_arrows(axes: Axes, start: Array, arrow: Array, factor: float) -> None:
    tip = start + factor * arrow
    axes.plot(*start.T, "o", ms=3.2, mfc="white", mec=PREDICTED, mew=0.9, zorder=2, label="predicted")
    axes.quiver(
        *start.T,
        *(tip - start).T,
        angles="xy",
        scale_units="xy",
        scale=1,
        width=0.004,
        headwidth=3.5,
        headlength=4,
        headaxislength=3.6,
        color=MEASURED,
        zorder=3,
    )
    # Arrows do not widen the view by themselves.
    both = np.vstack([start, tip])
    pad = 0.06 * float(np.ptp(both, axis=0).max() or 1.0)
    axes.set_xlim(both[:, 0].min() - pad, both[:, 0].max() + pad)
    axes.set_ylim(both[:, 1].min() - pad, both[:, 1].max() + pad)
    axes.set_aspect("equal")
    axes.grid()


@picture
def plot_errors(validation: Validation, *, when: str = "") -> Figure:
    """Tip errors: how they are distributed, and by direction (radar) and separation, or else by row.

    Args:
        when: words for the heading, such as "after the fit".
    """
    v = validation
    m, errors = v.measurements, v.errors * TO_MM
    mirrored = m.direction is not None and m.separation is not None
    figure = new_figure(10.0 if mirrored else 7.5, 3.8)
    places = [131, 132, 133] if mirrored else [121, 122]
    if m.direction is not None and m.separation is not None:
        radar = figure.add_subplot(places[0], projection="polar")
        _draw_radar(radar, *_mean_by_place(m.direction, m.separation, errors))
        _draw_by_separation(figure.add_subplot(places[1]), m.separation, errors)
    else:
        _draw_by_row(figure.add_subplot(places[0]), errors)
    _draw_histogram(figure.add_subplot(places[-1]), v)
    return headed(figure, _named(v, when))


def _named(v: Validation, when: str) -> str:
    return ", ".join(filter(None, (v.robot.name or "robot", when)))


def _mean_by_place(direction: Array, separation: Array, errors: Array) -> tuple[Array, Array, Array]:
    """Directions (D,), separations (S,) and mean errors (S, D), NaN where nothing was measured."""
    # Modulo again: 359.99999 is rounded to 360, which is 0.
    turned = np.round(np.degrees(direction) % 360, 4) % 360
    around, where = np.unique(turned, return_inverse=True)
    apart, row = np.unique(np.round(np.degrees(separation), 4), return_inverse=True)
    total, count = np.zeros((len(apart), len(around))), np.zeros((len(apart), len(around)))
    # Unbuffered: with `+=` of repeated places only the last would count.
    np.add.at(total, (row, where), errors)
    np.add.at(count, (row, where), 1)
    mean = np.divide(total, count, out=np.full_like(total, np.nan), where=count > 0)
    return np.radians(around), np.radians(apart), mean


def _draw_radar(axes: Axes, direction: Array, separation: Array, error: Array) -> None:
    """Errors (S, D), mm, over directions (D,) as closed lines, one for each of separations (S,); rad."""
    from matplotlib.projections.polar import PolarAxes
    from matplotlib.ticker import MaxNLocator

    assert isinstance(axes, PolarAxes)
    axes.set_theta_zero_location("N")  # clockwise from the top, as the thesis draws it
    axes.set_theta_direction(-1)
    for k, (apart, row) in enumerate(zip(separation, error, strict=True)):
        there = np.isfinite(row)
        around, values = np.append(direction[there], direction[there][:1]), np.append(row[there], row[there][:1])
        axes.plot(around, values, "o-", color=tube_colour(k), lw=1.2, ms=2.5, label=f"{np.degrees(apart):g}°")
    axes.set_ylim(0, None)
    axes.set_xticks(np.radians(np.arange(0, 360, 40)))
    axes.set_rlabel_position(350)
    axes.yaxis.set_major_locator(MaxNLocator(6, min_n_ticks=3))
    axes.tick_params(axis="y", labelsize=7, labelcolor=INK)
    for words in axes.get_yticklabels():
        words.set_bbox({"fc": "white", "ec": "none", "alpha": 0.75, "pad": 0.6})
    axes.set_axisbelow(False)  # numbers above the lines
    axes.grid(color="#D5D8DC", lw=0.5)
    corner = (1.15, 1.0) if narrow() else (-0.28, 1.13)
    axes.legend(title="separation", loc="upper left", bbox_to_anchor=corner, handlelength=1.4)
    axes.set_title("tip error (mm) over direction", pad=12)


def _draw_by_separation(axes: Axes, separation: Array, errors: Array) -> None:
    apart = np.round(np.degrees(separation), 4)
    values = np.unique(apart)
    for k, value in enumerate(values):
        here = errors[apart == value]
        spread = np.linspace(-0.25, 0.25, len(here)) if len(here) > 1 else np.zeros(1)
        axes.plot(k + spread, here, "o", ms=3, mfc="none", mec=tube_colour(k), mew=0.9)
        axes.plot([k - 0.28, k + 0.28], [here.mean()] * 2, color=INK, lw=1.4)
        axes.annotate(f"{here.mean():.2f}", (k + 0.3, here.mean()), va="center", fontsize=6.5)
    axes.set_xticks(range(len(values)), [f"{value:g}" for value in values])
    axes.set(xlabel="separation (deg), line: mean", ylabel="tip error (mm)")
    axes.set(ylim=(0, None), xlim=(-0.5, len(values) - 0.2))


def _draw_by_row(axes: Axes, errors: Array) -> None:
    axes.plot(np.arange(1, len(errors) + 1), errors, "o", ms=3, mfc="none", mec=PREDICTED, mew=0.9)
    axes.set(xlabel="row of the measurements", ylabel="tip error (mm)")
    axes.set_ylim(0, None)


def _draw_histogram(axes: Axes, v: Validation) -> None:
    s, errors = v.summary, v.errors * TO_MM
    # Square-root rule, a little finer; with more than 20 bins bars are thinner than their names.
    bins = int(np.clip(np.sqrt(len(errors)) * 1.5, 5, 20))
    axes.hist(errors, bins=bins, color="#C9D6E3", edgecolor="white", lw=0.6)
    heights = (("mean", s.mean, 0.98), ("RMS", s.rms, 0.90), ("95 %", s.p95, 0.98), ("max", s.max, 0.90))
    top = axes.get_ylim()[1] * 1.15
    axes.set_ylim(0, top)
    for name, value, height in heights:
        axes.axvline(value * TO_MM, color=INK, lw=0.8, ls=(0, (4, 3)), ymax=height - 0.03)
        axes.annotate(
            f"{name} {value * TO_MM:.2f}",
            (value * TO_MM, height * top),
            (0, 0),
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=7,
            bbox={"fc": "white", "ec": "none", "pad": 0.8},
        )
    axes.set(xlabel=f"tip error (mm)\n1 mm is {0.1 / v.length:.2f} % of the length", ylabel="configurations")
    axes.set_xlim(0, 1.12 * float(errors.max()) or 1.0)


@picture
def plot_error_table(table: ErrorTable, *, title: str = "") -> Figure:
    """A published table of tip errors as a radar plot: a closed line over direction for every separation."""
    figure = new_figure(5.4, 5.0)
    axes = figure.add_subplot(projection="polar")
    _draw_radar(axes, table.direction, table.separation, table.error * TO_MM)
    row, column = np.unravel_index(int(table.error.argmax()), table.error.shape)
    worst = float(table.error[row, column]) * TO_MM
    note(axes, f"{worst:.1f} mm", np.array([table.direction[column], worst]), np.array([-9.0, -1.0]))
    axes.set_title(title or f"tip error (mm) over direction, mean {table.summary.mean * TO_MM:.1f} mm", pad=16)
    return figure


def _closed(direction: Array, points: Array) -> Array:
    """(361, 2) points of the smooth closed line through `points` (D, 2) at directions (D,), rad."""
    knots = np.append(direction, direction[0] + 2 * np.pi)
    # The first point again, a turn later: value, slope and curvature match there.
    line = scipy.interpolate.CubicSpline(knots, np.vstack([points, points[:1]]), bc_type="periodic")
    return np.asarray(line(np.linspace(knots[0], knots[-1], 361)))


@picture
def plot_simulated_circles(table: ErrorTable, *, circles: Sequence[Array], title: str = "") -> Figure:
    """Simulated tips of every separation, marked with their direction, and a published table's errors around them.

    A disc around each simulated tip has the printed error as its radius: the measured tip, whose coordinates are not
    printed, lies in it as seen along the axis, since a distance in space only shortens.

    Args:
        circles: for every separation of the table, (D, 3) tips at its directions, m.
    """
    figure = new_figure(5.6, 6.0)
    axes = figure.add_subplot()
    for k, (tips, errors) in enumerate(zip(circles, table.error, strict=True)):
        colour, line = tube_colour(k), _closed(table.direction, tips[:, :2] * TO_MM)
        for at, error in zip(tips * TO_MM, errors * TO_MM, strict=True):
            disk(axes, at[:2], error, fc=colour, ec="none", alpha=0.13, zorder=1)
        radius = float(np.hypot(*tips.T[:2]).mean()) * TO_MM
        label = f"{np.degrees(table.separation[k]):g}°, radius {radius:.1f} mm"
        axes.plot(*line.T, color=colour, lw=1.2, zorder=2, label=label)
        axes.plot(*tips.T[:2] * TO_MM, "o", color=colour, ms=3, zorder=2)
    for at, angle in zip(circles[0][::2], table.direction[::2], strict=True):
        outward = at[:2] / np.hypot(*at[:2])
        axes.annotate(
            f"{np.degrees(angle):.0f}°", at[:2] * TO_MM + 6 * outward, ha="center", va="center", fontsize=7, color=FAINT
        )
    reach = (
        1.16 * TO_MM * max(np.abs(tips[:, :2]).max() + e.max() for tips, e in zip(circles, table.error, strict=True))
    )
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
    axes.grid()
    axes.set(xlabel="x (mm)", ylabel="y (mm)")
    figure.legend(title="simulated tips; separation", loc="outside lower center", ncols=2)
    entitle(axes, title)
    return figure


KEPT, REFUSED = "#0072B2", "#B8BEC6"


@picture
def plot_effects(comparison: Comparison) -> Figure:
    """Held-out errors of the robot as given and with every effect that pays, then the gain of those that do not; of
    places passed both ways, what of the error depends on the direction, before and after."""
    c = comparison
    both = c.fit is not None and c.fit.before.parity is not None
    figure = new_figure(9.6 if both else 7.2, max(3.0, 0.9 + 0.30 * (2 + len(c.steps) + len(c.refused))))
    if both:
        left, right = figure.subplots(1, 2, width_ratios=[2.6, 1])
        _draw_parity(right, c)
    else:
        left = figure.subplots()
    _draw_steps(left, c)
    return figure


def _draw_steps(axes: Axes, c: Comparison) -> None:
    rows = [("as given", c.start.rms), *((f"+ {s.effect.replace('_', ' ')}", s.held_out.rms) for s in c.steps)]
    values = np.array([value for _, value in rows]) * TO_MM
    axes.bar_label(axes.barh(range(len(rows)), values, height=0.62, color=KEPT), fmt="%.2f", padding=4, fontsize=8)
    last = values[-1]
    for k, step in enumerate(c.refused, start=len(rows)):
        value = step.held_out.rms * TO_MM
        axes.barh(k, value, height=0.62, color="none", edgecolor=REFUSED, lw=0.9)
        gain = f"{100 * step.gain + 0.0:+.1f} %".replace("-0.0", "±0.0").replace("+0.0", "±0.0").replace("-", "−")
        note(axes, gain, np.array([max(value, last), k]), np.array([4.0, 0.0]), size=7, colour=FAINT)
    names = [name for name, _ in rows] + [f"({s.effect.replace('_', ' ')})" for s in c.refused]
    axes.set_yticks(range(len(names)), names)
    for label in axes.get_yticklabels()[len(rows) :]:
        label.set_color(FAINT)
    if c.fit is not None:
        # Standard deviation per coordinate; in space the variances of three add.
        noise = c.fit.noise * np.sqrt(3) * TO_MM
        axes.axvline(noise, color=INK, lw=0.8, ls=(0, (4, 3)))
        name_above(axes, noise, f"what the fit leaves, {noise:.2f}")
    axes.invert_yaxis()
    axes.set_xlim(0, 1.14 * float(values.max()))
    axes.set_xlabel(f"RMS tip error held out (mm), {c.folds} blocks")
    axes.xaxis.grid()


def _draw_parity(axes: Axes, c: Comparison) -> None:
    assert c.fit is not None
    for k, v in enumerate((c.fit.before, c.fit.after)):
        if v.parity is None:
            continue
        for j, (value, colour) in enumerate(((v.parity.history, "#D55E00"), (v.parity.static, "#009E73"))):
            height = value * TO_MM
            label = ("depends on the direction", "does not")[j] if k == 0 else None
            bar = axes.bar(k + 0.36 * (j - 0.5), height, width=0.34, color=colour, label=label)
            axes.bar_label(bar, fmt="%.2f", padding=2, fontsize=7)
    axes.set_xticks([0, 1], ["as given", "calibrated"])
    axes.set_ylabel("RMS of points passed in both directions (mm)")
    axes.set_ylim(0, 1.32 * axes.get_ylim()[1])
    axes.legend(loc="upper right", fontsize=7)
    axes.yaxis.grid()
