"""Where friction can hold an arm, drawn as a tube around it."""

from __future__ import annotations

import numpy as np

from ...files.units import TO_MM
from ...stability import FrictionBand
from ..colours import tube_colour
from .style import INK, Axes, Figure, headed, new_figure, picture


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
