"""Robots under load: what a payload does, which force snaps them, and how well a force is told."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ...equilibrium.result import Equilibrium
from ...files.units import TO_MILLI, TO_MM
from ...typing import Array
from ..page import TUBE_COLOURS
from .style import FAINT, INK, Axes, Figure, headed, new_figure, picture

if TYPE_CHECKING:
    from ...validation.force import ForceEstimate

AXES = "xyz"


@picture
def plot_payload(equilibria: Sequence[Equilibrium], *, payloads: Array, title: str = "") -> Figure:
    """Picture of an arm under growing payloads: its shapes from the side, and the way of its tip and its margin.

    Args:
        payloads: (T,) force of each, N.
    """
    figure = new_figure(7.0, 3.4)
    side, moved, margin = figure.subplot_mosaic(
        [["side", "moved"], ["side", "margin"]], width_ratios=[1.0, 1.2]
    ).values()
    for k, e in enumerate(equilibria):
        first, last = k == 0, k == len(equilibria) - 1
        look: dict[str, Any] = {
            "color": INK if first else TUBE_COLOURS[0] if last else FAINT,
            "lw": 2.0 if first or last else 0.7,
        }
        name = f"{payloads[k] * TO_MILLI:.0f} mN" if first or last else "_"
        side.plot(e.position[:, 1] * TO_MM, e.position[:, 2] * TO_MM, label=name, **look)
    side.set_aspect("equal")
    side.set(xlabel="y (mm)", ylabel="z (mm)")
    side.legend(loc="best")
    way = [float(np.linalg.norm(e.tip_position - equilibria[0].tip_position)) for e in equilibria]
    linear = np.linalg.norm(_first_order(equilibria[0], equilibria[-1], payloads), axis=1)
    weight = payloads * TO_MILLI
    moved.plot(weight, np.array(way) * TO_MM, color=TUBE_COLOURS[0], lw=1.8)
    moved.plot(weight, linear * TO_MM, color=FAINT, lw=1.0, ls="--", label="by the compliance at the start")
    moved.set_ylabel("path of the tip (mm)")
    moved.legend(loc="upper left")
    moved.tick_params(labelbottom=False)
    margin.plot(weight, [e.margin for e in equilibria], color=TUBE_COLOURS[2], lw=1.8)
    margin.set_ylim(min(0.0, *(e.margin for e in equilibria)), 1.05)
    margin.set(ylabel="stability margin", xlabel="payload (mN)")
    for panel in (side, moved, margin):
        panel.grid()
    return headed(figure, title)


def _first_order(start: Equilibrium, end: Equilibrium, payloads: Array) -> Array:
    """(T, 3) way of the tip that the compliance of the first equilibrium gives, m."""
    assert start.load is not None
    assert end.load is not None
    force = np.subtract(end.load.force, start.load.force)
    part = (payloads - payloads[0]) / (payloads[-1] - payloads[0])
    return np.asarray(part[:, None] * (start.compliance[:3, :3] @ force))


@picture
def plot_load_limits(
    limits: Mapping[str, Array], *, angles: Array, kinds: Mapping[str, Sequence[str]], title: str = ""
) -> Figure:
    """Picture of the least force on the tip that takes a robot out of its equilibrium, over directions in planes.

    Args:
        limits: for planes such as "xy", (T,) forces in N; NaN where none was found.
        angles: (T,) rad, from the first axis of each plane to its second.
        kinds: "fold", "bifurcation" or "" for each.
    """
    from matplotlib.ticker import MaxNLocator

    figure = new_figure(2.6 * len(limits) + 0.3, 3.1)
    panels = figure.subplots(1, len(limits), subplot_kw={"projection": "polar"}, squeeze=False)[0]
    most = max(float(np.nanmax(values)) for values in limits.values()) * TO_MILLI
    for panel, (plane, values) in zip(panels, limits.items(), strict=True):
        closed = np.append(angles, angles[0] + 2 * np.pi), np.append(values, values[0]) * TO_MILLI
        panel.plot(*closed, color=TUBE_COLOURS[0], lw=1.6)
        folds = np.array([kind == "fold" for kind in kinds[plane]])
        panel.plot(angles[folds], values[folds] * TO_MILLI, "o", ms=3, color=TUBE_COLOURS[0])
        panel.plot(angles[~folds], values[~folds] * TO_MILLI, "o", ms=4, mfc="white", mec=TUBE_COLOURS[0])
        panel.set_ylim(0, 1.08 * most)
        panel.set_xticks(np.radians([0, 90, 180, 270]))
        panel.set_xticklabels([plane[0], plane[1], f"\N{MINUS SIGN}{plane[0]}", f"\N{MINUS SIGN}{plane[1]}"])
        panel.grid()
        panel.set_rlabel_position(-45)
        panel.yaxis.set_major_locator(MaxNLocator(4))
    return headed(figure, title)


@picture
def plot_bearing(certificates: Mapping[str, Array], *, forces: Array, title: str = "") -> Figure:
    """Picture of certificates over the largest force on the tip, of several robots; below 0 nothing is proved.

    Args:
        certificates: (T,) by the name of the robot.   forces: (T,) N.
    """
    figure = new_figure(4.6, 3.0)
    axes = figure.subplots()
    for k, (name, values) in enumerate(certificates.items()):
        axes.plot(forces * TO_MILLI, values, "-o", ms=3, lw=1.6, color=TUBE_COLOURS[k], label=name)
    axes.axhline(0.0, color=INK, lw=0.8)
    axes.set(xlabel="largest force on the tip (mN)", ylabel="certificate")
    axes.grid()
    axes.legend(loc="best")
    return headed(figure, title)


@picture
def plot_force_estimates(estimates: Mapping[str, Sequence[ForceEstimate]], *, true: Array, title: str = "") -> Figure:
    """Picture of forces told from noisy measurements, with the ellipse that holds 95 % of them by the covariance.

    Args:
        estimates: by what was measured.
        true: (3,) the force that acted, N.
    """
    figure = new_figure(7.0, 3.3)
    panels = figure.subplots(1, 2)
    for panel, (i, j) in zip(panels, ((0, 1), (0, 2)), strict=True):
        for k, (name, found) in enumerate(estimates.items()):
            colour = TUBE_COLOURS[2 * k]
            forces = np.array([estimate.force for estimate in found]) * TO_MILLI
            panel.plot(forces[:, i], forces[:, j], ".", ms=3, color=colour, label=name)
            covariance = found[0].covariance[np.ix_([i, j], [i, j])] * TO_MILLI**2
            _ellipse(panel, true[[i, j]] * TO_MILLI, covariance, colour)
        panel.plot(*(true[[i, j]] * TO_MILLI), "+", ms=9, mew=1.5, color=INK, zorder=5)
        panel.set(xlabel=f"force along {AXES[i]} (mN)", ylabel=f"force along {AXES[j]} (mN)")
        panel.grid()
    panels[0].legend(loc="best")
    return headed(figure, title)


CHI_SQUARED_95 = 5.991
"""What a chi-squared of two degrees of freedom stays below in 95 of 100 cases."""


def _ellipse(axes: Axes, centre: Array, covariance: Array, colour: str) -> None:
    values, vectors = np.linalg.eigh(covariance)
    angle = np.linspace(0, 2 * np.pi, 181)
    circle = np.array([np.cos(angle), np.sin(angle)])
    around = centre[:, None] + vectors @ (np.sqrt(CHI_SQUARED_95 * values)[:, None] * circle)
    axes.plot(*around, color=colour, lw=1.2)
