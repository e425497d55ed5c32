"""Pictures of robots under loads and friction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ...equilibrium.result import Equilibrium
from ...errors import InputError
from ...files.units import TO_MILLI, TO_MM
from ...stability import FrictionBand, Path
from ...stability.following import place_of, stretches
from ...typing import Array
from ..formatting import released
from ..page import TUBE_COLOURS, tube_colour
from .path import Value, draw_broken
from .stage import note
from .style import FAINT, INK, Axes, Figure, angle_ticks, entitle, headed, new_figure, picture

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
    # The force grows along a straight line, so that its part is that of the payload.
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
        # One turn more, and not back to 0: otherwise the line would run back over the whole turn.
        closed = np.append(angles, angles[0] + 2 * np.pi), np.append(values, values[0]) * TO_MILLI
        panel.plot(*closed, color=TUBE_COLOURS[0], lw=1.6)
        folds = np.array([kind == "fold" for kind in kinds[plane]])
        panel.plot(angles[folds], values[folds] * TO_MILLI, "o", ms=3, color=TUBE_COLOURS[0])
        # Open marks: bifurcations, where the arm buckles, and limits of unknown kind.
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
    # x' C^-1 x = c is an ellipse with half axes sqrt(c lambda_i) along the eigenvectors of C.
    values, vectors = np.linalg.eigh(covariance)
    angle = np.linspace(0, 2 * np.pi, 181)
    circle = np.array([np.cos(angle), np.sin(angle)])
    around = centre[:, None] + vectors @ (np.sqrt(CHI_SQUARED_95 * values)[:, None] * circle)
    axes.plot(*around, color=colour, lw=1.2)


class Way(NamedTuple):
    """A way through waypoints at angles (T,), deg, its name and its look."""

    path: Path
    angles: Array
    name: str
    colour: str
    width: float


@picture
def plot_hysteresis(
    paths: tuple[Path, Path], *, angles_deg: ArrayLike, axis: str | None = None, title: str = ""
) -> Figure:
    """Picture of a path forth and back: a coordinate of the tip, elastic energy and margin over the angle that turns.

    Snaps are arrows, with the jump of the tip in mm and the energy released in mJ.

    Args:
        paths: forth and back, of `follow`, through the same waypoints, the second in the opposite order.
        angles_deg: (T,) angle at each waypoint of the first, deg.
        axis: coordinate of the tip to show, "x", "y" or "z"; default the one that jumps most.
        title: a heading.

    Raises:
        InputError: paths and angles of different lengths, an unknown axis, a name of the picture that does not end in
            a known format.
    """
    (forth, back), angles = paths, np.array(angles_deg, dtype=float)
    if angles.shape != (len(forth.equilibria),) or len(back.equilibria) != len(forth.equilibria):
        raise InputError(
            f"forth has {len(forth.equilibria)} waypoints, back {len(back.equilibria)}, and angles_deg has shape "
            f"{angles.shape}; there must be one angle per waypoint"
        )
    if axis is not None and axis not in ("x", "y", "z"):
        raise InputError(f"axis is {axis!r}; it must be x, y or z")
    chosen = "xyz".index(axis) if axis else _liveliest(forth, back)
    figure = new_figure(6.4, 6.0)
    panels = figure.subplots(3, 1, sharex=True, height_ratios=[1.5, 1.2, 1.0])
    # The thin line of the way back lies on the wide one where both are the same.
    ways = Way(forth, angles, "forth", "#D55E00", 2.6), Way(back, angles[::-1], "back", "#0072B2", 1.3)
    quantities: list[tuple[str, Value]] = [
        (f"tip {'xyz'[chosen]} (mm)", lambda e: float(e.tip_position[chosen]) * TO_MM),
        ("elastic energy (mJ)", lambda e: e.energy * TO_MILLI),
        ("stability margin", lambda e: e.margin),
    ]
    for panel, (name, quantity) in zip(panels, quantities, strict=True):
        for way in ways:
            _draw_way(panel, way, quantity)
        panel.set_ylabel(name)
        panel.grid()
    for way in ways:
        _name_snaps(panels[0], way, quantities[0][1])
    figure.align_ylabels(panels)
    entitle(panels[0], title)
    panels[0].legend(loc="best")
    panels[-1].set_ylim(min(0.0, panels[-1].get_ylim()[0]), None)
    panels[-1].set_xlabel("rotation (deg)")
    angle_ticks(panels[-1].xaxis)
    return figure


def _liveliest(forth: Path, back: Path) -> int:
    """The coordinate that jumps most, or, without snaps, that moves most."""
    snaps = [*forth.snaps, *back.snaps]
    if snaps:
        jumps = [np.abs(snap.after.tip_position - snap.before.tip_position) for snap in snaps]
        return int(np.argmax(np.max(jumps, axis=0)))
    return int(np.argmax(np.ptp([e.tip_position for e in forth.equilibria], axis=0)))


def _draw_way(axes: Axes, way: Way, quantity: Value) -> None:
    """One way: its stretches, and an arrow for each snap between them."""
    parts = stretches(way.path, way.angles)
    drawn = draw_broken(axes, parts, quantity, way.colour, width=way.width, label=way.name)
    arrow = {"arrowstyle": "-|>", "color": way.colour, "lw": 0.9, "shrinkA": 2, "shrinkB": 2, "mutation_scale": 8}
    for (where, _), (old, new) in zip(parts, pairwise(drawn), strict=False):
        axes.annotate("", (where[-1], new[0]), (where[-1], old[-1]), arrowprops=arrow, zorder=2)


def _name_snaps(axes: Axes, way: Way, quantity: Value) -> None:
    """Angle, jump of the tip and energy of each snap, beside it: ahead of the way on which it happens."""
    # Names of both ways stand on opposite sides of the jump, and do not overlap.
    side = 1 if way.angles[-1] > way.angles[0] else -1
    for snap in way.path.snaps:
        x = place_of(snap, way.angles)
        y = (quantity(snap.before) + quantity(snap.after)) / 2
        text = f"{x:.2f}°\ntip jumps {snap.tip_jump * TO_MM:.1f} mm"
        text += released(snap.energy_released, "\n{:.2f} mJ released")
        words = text.replace("-", "\N{MINUS SIGN}")
        note(axes, words, np.array([x, y]), np.array([7.0 * side, 0.0]), colour=way.colour)


@picture
def plot_friction_band(band: FrictionBand, *, magnified: float = 1.0) -> Figure:
    """The arm without friction seen along y and along x, in tubes that it does not leave whatever its history.

    Args:
        band: of `friction_band`.
        magnified: by how much the tubes are drawn wider than they are.
    """
    figure = new_figure(6.4, 3.6)
    wider = "" if magnified == 1 else f", drawn {magnified:g} times as wide"
    headed(figure, f"{band.equilibrium.robot.name or 'robot'}: where friction can hold it{wider}")
    for axes, across in zip(figure.subplots(1, 2), (0, 1), strict=True):
        _draw(axes, band, across, magnified)
    figure.axes[0].legend(fontsize=7, loc="upper left")
    return figure


def _draw(axes: Axes, band: FrictionBand, across: int, magnified: float) -> None:
    """The projection on one axis of the plate and z."""
    line = band.equilibrium.position[:, [across, 2]] * TO_MM
    slope = band.equilibrium.frame[:, :, 2][:, [across, 2]]
    size = np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-12)
    # The tangent turned by 90 deg; where the arm points at the viewer it is 0, and the band has no width.
    normal = np.column_stack([-slope[:, 1], slope[:, 0]]) / size
    # Support function of a box with half edges w: its reach along n is sum |n_i| w_i.
    widths = [("to first order", np.abs(normal * band.first_order[:, [across, 2]]).sum(1), 0.45)]
    if np.isfinite(band.guaranteed).all():
        widths.insert(0, ("guaranteed", band.guaranteed, 0.18))
    for name, width, alpha in widths:
        side = normal * (width * TO_MM * magnified)[:, None]
        around = np.concatenate([line + side, (line - side)[::-1]])
        axes.fill(*around.T, color=tube_colour(0), alpha=alpha, lw=0, label=name)
    axes.plot(*line.T, color=INK, lw=1.0, label="without friction")
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel=f"{'xy'[across]} (mm)", ylabel="z (mm)")
