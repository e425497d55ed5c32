"""Pictures of friction: hysteresis loops, and the band in which friction can keep the tip."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ...errors import InputError
from ...files.units import TO_MILLI, TO_MM
from ...stability import FrictionBand, Path
from ...stability.following import place_of, stretches
from ...typing import Array
from ..formatting import released
from ..page import tube_colour
from .path import Value, draw_broken
from .stage import note
from .style import INK, Axes, Figure, angle_ticks, entitle, headed, new_figure, picture


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
    normal = np.column_stack([-slope[:, 1], slope[:, 0]]) / size
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
