"""Pictures of validation: residual vectors of tips, and errors by direction and separation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy

from ...files.units import TO_MM
from ...typing import Array
from ...validation import Comparison, ErrorTable, Validation
from ..page import tube_colour
from .labels import names_above, note, rules_at
from .panels import draw_bars
from .projection import round_below
from .style import FAINT, INK, Axes, Figure, disk, entitle, headed, narrow, new_figure, picture

MEASURED = "#D55E00"
PREDICTED = "#0072B2"
ARROW_LENGTH = 0.16
"""Length of the longest arrow over the width of the picture, at most; arrows are lengthened by a round factor."""


@picture
def plot_residuals(validation: Validation, *, when: str = "") -> Figure:
    """Figure of predicted tips with arrows to the measured tips, along the plate's axis and from the side.

    Arrows are to scale, or lengthened by the factor in the heading.

    Args:
        when: words for the heading, such as "after the fit".
    """
    v = validation
    figure = new_figure(8.0, 4.6)
    views = figure.subplots(1, 2)
    finite = np.isfinite(v.errors)
    spread = float(np.ptp(v.predicted[finite], axis=0).max()) or 1e-3
    # A round factor, so that a reader can divide by it; never below 1, as long errors are seen anyway.
    factor = max(1.0, round_below(ARROW_LENGTH * spread / max(float(np.nanmax(v.errors)), 1e-12)))
    names = ("seen along the axis of the base", "seen from the side")
    for axes, (i, j), name in zip(views, ((0, 1), (0, 2)), names, strict=True):
        start, arrows = v.predicted[:, [i, j]] * TO_MM, factor * v.residuals[:, [i, j]] * TO_MM
        axes.plot(*start.T, "o", ms=3.2, mfc="white", mec=PREDICTED, mew=0.9, zorder=2, label="predicted")
        head = {"width": 0.004, "headwidth": 3.5, "headlength": 4, "headaxislength": 3.6}
        to_scale = {"angles": "xy", "scale_units": "xy", "scale": 1}
        axes.quiver(*start.T, *arrows.T, color=MEASURED, zorder=3, **to_scale, **head)
        # Arrows do not widen the view by themselves.
        ends = np.vstack([start, start + arrows])
        border = 0.06 * float(np.ptp(ends, axis=0).max() or 1.0)
        axes.set_xlim(ends[:, 0].min() - border, ends[:, 0].max() + border)
        axes.set_ylim(ends[:, 1].min() - border, ends[:, 1].max() + border)
        axes.set_aspect("equal")
        axes.grid()
        axes.set(xlabel=f"{'xyz'[i]} (mm)", ylabel=f"{'xyz'[j]} (mm)")
        axes.set_title(name, loc="left")
    scale = "to scale" if factor == 1 else f"{factor:g} times their length"
    s = v.summary
    headed(
        figure,
        f"{_named(v, when)}: {s.count} measured tips, registration {v.registration.method}, error mean "
        f"{s.mean * TO_MM:.2f} mm, max {s.max * TO_MM:.2f} mm\narrows from predicted to measured, {scale}",
    )
    return figure


@picture
def plot_errors(validation: Validation, *, when: str = "") -> Figure:
    """Picture of tip errors: histogram, and errors by direction (radar) and separation, or else by row.

    Args:
        when: words for the heading, such as "after the fit".
    """
    v = validation
    m, errors = v.measurements, v.errors * TO_MM
    mirrored = m.direction is not None and m.separation is not None
    figure = new_figure(10.0 if mirrored else 7.5, 3.8)
    slots = [131, 132, 133] if mirrored else [121, 122]
    if m.direction is not None and m.separation is not None:
        radar = figure.add_subplot(slots[0], projection="polar")
        _draw_radar(radar, _mean_errors(m.direction, m.separation, errors))
        _draw_by_separation(figure.add_subplot(slots[1]), m.separation, errors)
    else:
        rows = figure.add_subplot(slots[0])
        rows.plot(np.arange(1, len(errors) + 1), errors, "o", ms=3, mfc="none", mec=PREDICTED, mew=0.9)
        rows.set(xlabel="row of the measurements", ylabel="tip error (mm)")
        rows.set_ylim(0, None)
    panel_width = 0.8 * float(figure.get_figwidth()) / len(slots)
    _draw_histogram(figure.add_subplot(slots[-1]), v, panel_width)
    return headed(figure, _named(v, when))


def _named(v: Validation, when: str) -> str:
    return ", ".join(filter(None, (v.robot.name or "robot", when)))


class MeanErrors(NamedTuple):
    """Errors of tips over direction, for every separation."""

    direction: Array
    """(D,) directions of the mirror actuation, rad."""
    separation: Array
    """(S,) separations of the mirror actuation, rad."""
    error: Array
    """(S, D) mean tip errors, mm; NaN if nothing was measured."""


def _mean_errors(direction: Array, separation: Array, errors: Array) -> MeanErrors:
    """Means of errors (N,), mm, measured at equal directions and separations (N,), rad."""
    # Modulo again: 359.99999 is rounded to 360, which is 0.
    turned = np.round(np.degrees(direction) % 360, 4) % 360
    around, column = np.unique(turned, return_inverse=True)
    apart, row = np.unique(np.round(np.degrees(separation), 4), return_inverse=True)
    total, count = np.zeros((len(apart), len(around))), np.zeros((len(apart), len(around)))
    # Unbuffered: with `+=` of repeated places only the last would count.
    np.add.at(total, (row, column), errors)
    np.add.at(count, (row, column), 1)
    mean = np.divide(total, count, out=np.full_like(total, np.nan), where=count > 0)
    return MeanErrors(np.radians(around), np.radians(apart), mean)


def _draw_radar(axes: Axes, errors: MeanErrors) -> None:
    """Draw errors over direction as closed lines, one for each separation."""
    from matplotlib.projections.polar import PolarAxes
    from matplotlib.ticker import MaxNLocator

    assert isinstance(axes, PolarAxes)
    axes.set_theta_zero_location("N")  # clockwise from the top, as the thesis draws it
    axes.set_theta_direction(-1)
    for k, (apart, row) in enumerate(zip(errors.separation, errors.error, strict=True)):
        measured = np.isfinite(row)
        around, values = errors.direction[measured], row[measured]
        # The first point again, to close the line.
        around, values = np.append(around, around[:1]), np.append(values, values[:1])
        axes.plot(around, values, "o-", color=tube_colour(k), lw=1.2, ms=2.5, label=f"{np.degrees(apart):g}°")
    axes.set_ylim(0, None)
    axes.set_xticks(np.radians(np.arange(0, 360, 40)))
    axes.set_rlabel_position(350)
    axes.yaxis.set_major_locator(MaxNLocator(6, min_n_ticks=3))
    axes.tick_params(axis="y", labelsize=7, labelcolor=INK)
    for label in axes.get_yticklabels():
        label.set_bbox({"fc": "white", "ec": "none", "alpha": 0.75, "pad": 0.6})
    axes.set_axisbelow(False)  # numbers above the lines
    axes.grid(color="#D5D8DC", lw=0.5)
    corner = (1.15, 1.0) if narrow() else (-0.28, 1.13)
    axes.legend(title="separation", loc="upper left", bbox_to_anchor=corner, handlelength=1.4)
    axes.set_title("tip error (mm) over direction", pad=12)


def _draw_by_separation(axes: Axes, separation: Array, errors: Array) -> None:
    """Draw errors (N,), mm, in a column for each separation, with their mean."""
    apart = np.round(np.degrees(separation), 4)
    values = np.unique(apart)
    for k, value in enumerate(values):
        of_value = errors[apart == value]
        shift = np.linspace(-0.25, 0.25, len(of_value)) if len(of_value) > 1 else np.zeros(1)
        axes.plot(k + shift, of_value, "o", ms=3, mfc="none", mec=tube_colour(k), mew=0.9)
        axes.plot([k - 0.28, k + 0.28], [of_value.mean()] * 2, color=INK, lw=1.4)
        note(axes, f"{of_value.mean():.2f}", (k + 0.3, of_value.mean()), (2.5, 0.0), size=6.5)
    axes.set_xticks(range(len(values)), [f"{value:g}" for value in values])
    axes.set(xlabel="separation (deg), line: mean", ylabel="tip error (mm)")
    axes.set(ylim=(0, None), xlim=(-0.5, len(values) - 0.2))


def _draw_histogram(axes: Axes, v: Validation, panel_width: float) -> None:
    """Draw the distribution of errors, with mean, RMS, 95 % quantile and maximum."""
    s, errors = v.summary, v.errors * TO_MM
    # Square-root rule, a little finer; with more than 20 bins bars are thinner than their names.
    bins = int(np.clip(np.sqrt(len(errors)) * 1.5, 5, 20))
    axes.hist(errors, bins=bins, color="#C9D6E3", edgecolor="white", lw=0.6)
    axes.set(xlabel=f"tip error (mm)\n1 mm is {0.1 / v.length:.2f} % of the length", ylabel="configurations")
    axes.set_xlim(0, 1.12 * float(errors.max()) or 1.0)
    summary = (("mean", s.mean), ("RMS", s.rms), ("95 %", s.p95), ("max", s.max))
    names = {value * TO_MM: f"{name} {value * TO_MM:.2f}" for name, value in summary}
    rules_at([axes], names)
    names_above(axes, names, panel_width=panel_width)


@picture
def plot_error_table(table: ErrorTable, *, title: str = "") -> Figure:
    """Radar plot of a published table of tip errors: a closed line over direction for every separation."""
    figure = new_figure(5.4, 5.0)
    axes = figure.add_subplot(projection="polar")
    _draw_radar(axes, MeanErrors(table.direction, table.separation, table.error * TO_MM))
    row, column = np.unravel_index(int(table.error.argmax()), table.error.shape)
    largest = float(table.error[row, column]) * TO_MM
    note(axes, f"{largest:.1f} mm", (table.direction[column], largest), (-9.0, -1.0))
    axes.set_title(title or f"tip error (mm) over direction, mean {table.summary.mean * TO_MM:.1f} mm", pad=16)
    return figure


@picture
def plot_simulated_circles(table: ErrorTable, *, circles: Sequence[Array], title: str = "") -> Figure:
    """Picture of simulated tips for every separation, with the errors of a published table as discs around them.

    The radius of a disc is the printed error: the measured tip, whose coordinates are not printed, lies in the disc as
    seen along the axis, since a projection only shortens distances.

    Args:
        circles: for every separation of the table, (D, 3) tips at its directions, m.
    """
    figure = new_figure(5.6, 6.0)
    axes = figure.add_subplot()
    for k, (tips, errors) in enumerate(zip(circles, table.error, strict=True)):
        colour = tube_colour(k)
        # A smooth closed line: at the first point again, a turn later, value, slope and curvature match.
        knots = np.append(table.direction, table.direction[0] + 2 * np.pi)
        closed = np.vstack([tips[:, :2], tips[:1, :2]]) * TO_MM
        spline = scipy.interpolate.CubicSpline(knots, closed, bc_type="periodic")
        line = spline(np.linspace(knots[0], knots[-1], 361))
        for at, error in zip(tips * TO_MM, errors * TO_MM, strict=True):
            disk(axes, at[:2], error, fc=colour, ec="none", alpha=0.13, zorder=1)
        radius = float(np.hypot(*tips.T[:2]).mean()) * TO_MM
        label = f"{np.degrees(table.separation[k]):g}°, radius {radius:.1f} mm"
        axes.plot(*line.T, color=colour, lw=1.2, zorder=2, label=label)
        axes.plot(*tips.T[:2] * TO_MM, "o", color=colour, ms=3, zorder=2)
    for at, angle in zip(circles[0][::2], table.direction[::2], strict=True):
        outward = at[:2] / np.hypot(*at[:2])
        label = f"{np.degrees(angle):.0f}°"
        axes.annotate(label, at[:2] * TO_MM + 6 * outward, ha="center", va="center", fontsize=7, color=FAINT)
    largest = max(np.abs(tips[:, :2]).max() + e.max() for tips, e in zip(circles, table.error, strict=True))
    reach = 1.16 * TO_MM * largest
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
    axes.grid()
    axes.set(xlabel="x (mm)", ylabel="y (mm)")
    figure.legend(title="simulated tips; separation", loc="outside lower center", ncols=2)
    entitle(axes, title)
    return figure


KEPT, REFUSED = "#0072B2", "#B8BEC6"


@picture
def plot_effects(comparison: Comparison) -> Figure:
    """Picture of held-out errors: before any effect, with every useful effect, and gains of the rejected effects.

    If points were passed in both directions, a second panel splits their error into a part that depends on the
    direction and one that does not.
    """
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
    """Draw a bar for the robot as given, for every useful effect, and for every refused one."""
    steps = [("as given", c.start.rms), *((f"+ {s.effect.replace('_', ' ')}", s.held_out.rms) for s in c.steps)]
    refused = [(f"({s.effect.replace('_', ' ')})", s.held_out.rms) for s in c.refused]
    names, errors = zip(*steps, *refused, strict=True)
    values = np.array(errors) * TO_MM
    gains = [f"{100 * s.gain + 0.0:+.1f} %".replace("-0.0", "±0.0").replace("+0.0", "±0.0") for s in c.refused]
    labels = [f"{value:.2f}" for value in values[: len(steps)]] + [
        gain.replace("-", "\N{MINUS SIGN}") for gain in gains
    ]
    bars = draw_bars(axes, names, values, f"RMS tip error held out (mm), {c.folds} blocks", colours=KEPT, labels=labels)
    for bar, label in zip(bars[len(steps) :], axes.get_yticklabels()[len(steps) :], strict=True):
        bar.set(facecolor="none", edgecolor=REFUSED, lw=0.9)
        label.set_color(FAINT)
    axes.set_xlim(0, 1.14 * float(values[: len(steps)].max()))
    if c.fit is not None:
        # Standard deviation per coordinate; in space the variances of three add.
        noise = c.fit.noise * np.sqrt(3) * TO_MM
        rules_at([axes], [noise])
        names_above(axes, {noise: f"remaining after the fit, {noise:.2f}"}, panel_width=1.0)
    axes.xaxis.grid()


def _draw_parity(axes: Axes, c: Comparison) -> None:
    """Draw the parts of the error of points passed in both directions, before and after the calibration."""
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
    axes.set_ylabel("RMS, passed in both directions (mm)")
    axes.set_ylim(0, 1.32 * axes.get_ylim()[1])
    axes.legend(loc="upper right", fontsize=7)
    axes.yaxis.grid()
