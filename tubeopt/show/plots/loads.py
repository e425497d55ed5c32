"""Pictures of robots under loads and friction."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ...equilibrium.result import Equilibrium
from ...errors import InputError
from ...files.units import TO_MILLI, TO_MM
from ...stability import FrictionBand, Path
from ...stability.following import stretches, value_at_snap
from ...typing import Array
from ..formatting import released
from ..page import TUBE_COLOURS, tube_colour
from .labels import note
from .panels import MARGIN, PanelScale, draw_broken, draw_over, share_x
from .style import FAINT, INK, Figure, angle_ticks, entitle, headed, new_figure, picture

if TYPE_CHECKING:
    from ...validation.force import ForceEstimate

AXES = "xyz"

TIP_PATH = PanelScale("path of the tip (mm)", TO_MM)

CHI_SQUARED_95 = 5.991
"""95 % quantile of a chi-squared variable with two degrees of freedom."""


@picture
def plot_payload(equilibria: Sequence[Equilibrium], *, payloads: Array, title: str = "") -> Figure:
    """Picture of an arm under growing payloads: its shapes from the side, the path of its tip, and its margin.

    Args:
        payloads: (T,) force of each, N.
    """
    first, last = equilibria[0], equilibria[-1]
    assert first.load is not None
    assert last.load is not None
    figure = new_figure(7.0, 3.4)
    side, moved, margin = figure.subplot_mosaic(
        [["side", "moved"], ["side", "margin"]], width_ratios=[1.0, 1.2]
    ).values()
    for e, payload in zip(equilibria, payloads, strict=True):
        end = e is first or e is last
        colour = INK if e is first else TUBE_COLOURS[0] if e is last else FAINT
        name = f"{payload * TO_MILLI:.0f} mN" if end else "_"
        _, y, z = e.position.T * TO_MM
        side.plot(y, z, label=name, color=colour, lw=2.0 if end else 0.7)
    side.set_aspect("equal")
    side.set(xlabel="y (mm)", ylabel="z (mm)")
    side.legend(loc="best")
    # The force grows along a straight line, in proportion to the payload; to first order the tip moves by the
    # compliance of the first equilibrium.
    proportion = (payloads - payloads[0]) / (payloads[-1] - payloads[0])
    first_order = np.linalg.norm(first.compliance[:3, :3] @ np.subtract(last.load.force, first.load.force))
    path = [float(np.linalg.norm(e.tip_position - first.tip_position)) for e in equilibria]
    weight = payloads * TO_MILLI
    draw_over(moved, weight, path, TIP_PATH, color=TUBE_COLOURS[0], lw=1.8)
    linear: dict[str, Any] = {"color": FAINT, "lw": 1.0, "ls": "--"}
    draw_over(moved, weight, first_order * proportion, TIP_PATH, name="by the compliance at the start", **linear)
    moved.legend(loc="upper left")
    draw_over(margin, weight, [e.margin for e in equilibria], MARGIN, color=TUBE_COLOURS[2], lw=1.8)
    share_x((moved, margin), weight, "payload (mN)")
    for panel in (side, moved, margin):
        panel.grid()
    return headed(figure, title)


@picture
def plot_load_limits(
    limits: Mapping[str, Array], *, angles: Array, kinds: Mapping[str, Sequence[str]], title: str = ""
) -> Figure:
    """Picture of the smallest tip force that ends the equilibrium of a robot, over its direction in planes.

    Args:
        limits: plane such as "xy" -> (T,) forces, N; NaN if none was found.
        angles: (T,) rad, from the first axis of each plane to its second.
        kinds: "fold", "bifurcation" or "" for each.
    """
    from matplotlib.ticker import MaxNLocator

    figure = new_figure(2.6 * len(limits) + 0.3, 3.1)
    panels = figure.subplots(1, len(limits), subplot_kw={"projection": "polar"}, squeeze=False)[0]
    largest = max(float(np.nanmax(values)) for values in limits.values()) * TO_MILLI
    for panel, (plane, values) in zip(panels, limits.items(), strict=True):
        # One turn more, and not back to 0: otherwise the line would run back over the whole turn.
        closed = np.append(angles, angles[0] + 2 * np.pi), np.append(values, values[0]) * TO_MILLI
        panel.plot(*closed, color=TUBE_COLOURS[0], lw=1.6)
        folds = np.array([kind == "fold" for kind in kinds[plane]])
        panel.plot(angles[folds], values[folds] * TO_MILLI, "o", ms=3, color=TUBE_COLOURS[0])
        # Open marks: bifurcations, where the arm buckles, and limits of unknown kind.
        panel.plot(angles[~folds], values[~folds] * TO_MILLI, "o", ms=4, mfc="white", mec=TUBE_COLOURS[0])
        panel.set_ylim(0, 1.08 * largest)
        panel.set_xticks(np.radians([0, 90, 180, 270]))
        panel.set_xticklabels([plane[0], plane[1], f"\N{MINUS SIGN}{plane[0]}", f"\N{MINUS SIGN}{plane[1]}"])
        panel.grid()
        panel.set_rlabel_position(-45)
        panel.yaxis.set_major_locator(MaxNLocator(4))
    return headed(figure, title)


@picture
def plot_bearing(certificates: Mapping[str, Array], *, forces: Array, title: str = "") -> Figure:
    """Picture of certificates over the largest tip force, of several robots; below 0 nothing is proved.

    Args:
        certificates: name of the robot -> (T,) certificates.   forces: (T,) N.
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
    """Picture of forces estimated from noisy measurements, with the ellipse that contains 95 % by the covariance.

    Args:
        estimates: name of the measured quantity -> estimates.
        true: (3,) true force, N.
    """
    figure = new_figure(7.0, 3.3)
    panels = figure.subplots(1, 2)
    for panel, (i, j) in zip(panels, ((0, 1), (0, 2)), strict=True):
        for k, (name, repeated) in enumerate(estimates.items()):
            colour = TUBE_COLOURS[2 * k]
            forces = np.array([estimate.force for estimate in repeated]) * TO_MILLI
            panel.plot(forces[:, i], forces[:, j], ".", ms=3, color=colour, label=name)
            covariance = repeated[0].covariance[np.ix_([i, j], [i, j])] * TO_MILLI**2
            # x' C^-1 x = c is an ellipse with half axes sqrt(c lambda_i) along the eigenvectors of C.
            variances, directions = np.linalg.eigh(covariance)
            angle = np.linspace(0, 2 * np.pi, 181)
            half_axes = directions * np.sqrt(CHI_SQUARED_95 * variances)
            ellipse = true[[i, j], None] * TO_MILLI + half_axes @ np.array([np.cos(angle), np.sin(angle)])
            panel.plot(*ellipse, color=colour, lw=1.2)
        panel.plot(*(true[[i, j]] * TO_MILLI), "+", ms=9, mew=1.5, color=INK, zorder=5)
        panel.set(xlabel=f"force along {AXES[i]} (mN)", ylabel=f"force along {AXES[j]} (mN)")
        panel.grid()
    panels[0].legend(loc="best")
    return headed(figure, title)


@picture
def plot_hysteresis(
    paths: tuple[Path, Path], *, angles_deg: ArrayLike, axis: str | None = None, title: str = ""
) -> Figure:
    """Picture of a path forth and back: a coordinate of the tip, elastic energy and margin over the turning angle.

    Snaps are arrows, with the jump of the tip in mm and the energy released in mJ.

    Args:
        paths: forth and back, results of `follow` through the same waypoints, the second in the opposite order.
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
    chosen = "xyz".index(axis) if axis else _most_moving_coordinate(forth, back)
    figure = new_figure(6.4, 6.0)
    panels = figure.subplots(3, 1, sharex=True, height_ratios=[1.5, 1.2, 1.0])
    # The thin line of the backward motion lies on the wide one where both coincide; names stand ahead of the motion, so
    # that those of both directions are on opposite sides of a jump.
    directions = (("forth", forth, angles, "#D55E00", 2.6), ("back", back, angles[::-1], "#0072B2", 1.3))
    quantities: list[tuple[PanelScale, Callable[[Equilibrium], float]]] = [
        (PanelScale(f"tip {'xyz'[chosen]} (mm)", TO_MM), lambda e: float(e.tip_position[chosen])),
        (PanelScale("elastic energy (mJ)", TO_MILLI), lambda e: e.energy),
        (MARGIN, lambda e: e.margin),
    ]
    for name, path, along, colour, width in directions:
        for panel, (scale, quantity) in zip(panels, quantities, strict=True):
            line: dict[str, Any] = {"colour": colour, "width": width, "name": name}
            draw_broken(panel, stretches(path, along), quantity, scale, arrows=True, **line)
        for snap in path.snaps:
            angle = value_at_snap(snap, along)
            coordinate = (snap.before.tip_position[chosen] + snap.after.tip_position[chosen]) / 2 * TO_MM
            text = f"{angle:.2f}°\ntip jumps {snap.tip_jump * TO_MM:.1f} mm"
            text += released(snap.energy_released, "\n{:.2f} mJ released")
            ahead = 1 if along[-1] > along[0] else -1
            label = text.replace("-", "\N{MINUS SIGN}")
            note(panels[0], label, (angle, coordinate), (7.0 * ahead, 0.0), colour=colour)
    border = 0.05 * float(np.ptp(angles))
    share_x(panels, (angles.min() - border, angles.max() + border), "rotation (deg)")
    for panel in panels:
        panel.grid()
    entitle(panels[0], title)
    panels[0].legend(loc="best")
    angle_ticks(panels[-1].xaxis)
    return figure


def _most_moving_coordinate(forth: Path, back: Path) -> int:
    """Coordinate of the tip that jumps most, or, without snaps, that moves most."""
    snaps = [*forth.snaps, *back.snaps]
    if snaps:
        jumps = [np.abs(snap.after.tip_position - snap.before.tip_position) for snap in snaps]
        return int(np.argmax(np.max(jumps, axis=0)))
    return int(np.argmax(np.ptp([e.tip_position for e in forth.equilibria], axis=0)))


@picture
def plot_friction_band(band: FrictionBand, *, magnified: float = 1.0) -> Figure:
    """Picture of the arm without friction, seen along y and along x, in the band that it never leaves.

    Args:
        band: result of `friction_band`.
        magnified: factor on the width of the band.
    """
    figure = new_figure(6.4, 3.6)
    wider = "" if magnified == 1 else f", drawn {magnified:g} times as wide"
    headed(figure, f"{band.equilibrium.robot.name or 'robot'}: range of its positions with friction{wider}")
    line, tangent = band.equilibrium.position, band.equilibrium.frame[:, :, 2]
    for axes, across in zip(figure.subplots(1, 2), (0, 1), strict=True):
        plane = [across, 2]
        # The tangent turned by 90 deg; where the arm points at the viewer it is 0, and the band has no width.
        normal = np.column_stack([-tangent[:, 2], tangent[:, across]])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        # Support function of a box with half edges w: its reach along n is sum |n_i| w_i.
        widths = [("to first order", np.abs(normal * band.first_order[:, plane]).sum(1), 0.45)]
        if np.isfinite(band.guaranteed).all():
            widths.insert(0, ("guaranteed", band.guaranteed, 0.18))
        for name, width, alpha in widths:
            shift = normal * (width * magnified)[:, None]
            around = np.concatenate([line[:, plane] + shift, (line[:, plane] - shift)[::-1]]) * TO_MM
            axes.fill(*around.T, color=tube_colour(0), alpha=alpha, lw=0, label=name)
        axes.plot(*(line[:, plane].T * TO_MM), color=INK, lw=1.0, label="without friction")
        axes.set_aspect("equal", adjustable="datalim")
        axes.set(xlabel=f"{'xy'[across]} (mm)", ylabel="z (mm)")
    figure.axes[0].legend(fontsize=7, loc="upper left")
    return figure
