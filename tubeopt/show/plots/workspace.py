"""Where a robot reaches: tips in space, from how many sides, and what snapping takes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError
from ...files.units import TO_MM
from ...typing import Array
from ...workspaces import SnappingLoss, Voxels, Workspace, voxels
from ...workspaces.voxels import Keys
from .shape import draw_plate
from .stage import View
from .style import Axes, Figure, colour_bar, headed, new_figure, number, picture

if TYPE_CHECKING:
    from matplotlib.collections import Collection

MAP = "cividis"
LOST_FACE = "#F2B48C"
LOST_COLOUR = "#D55E00"
MOST_TIPS = 4000
"""Tips that are drawn; of more, so many are drawn."""


@picture
def plot_workspace(
    workspace: Workspace,
    *,
    loss: SnappingLoss | None = None,
    size: float | None = None,
    title: str = "",
    view: tuple[float, float] = (18.0, -60.0),
) -> Figure:
    """Figure of a workspace: tips coloured by margin, dexterity, and largest margin in the half-plane through z.

    Args:
        loss: of `snapping_loss`.
        size: edge of the voxels, m; by default as in `voxels`.
        title: heading; default the robot's name and the number of samples.
        view: elevation and azimuth of the viewer of the scene, deg.

    Raises:
        InputError: no sample has a stable equilibrium, a loss of another robot, the name of the picture does not end in
            a known format.
    """
    if loss is not None and loss.robot != workspace.robot:
        raise InputError("loss is of another robot than the workspace")
    found = voxels(workspace, size)
    figure = new_figure(9.0, 4.9)
    name = workspace.robot.name or f"robot of {workspace.robot.n_tubes} tubes"
    headed(figure, title or f"{name}: tips at {len(workspace):,} joint values")
    scene, sides, margins = figure.subplots(1, 3, width_ratios=[1.9, 1, 1])
    tips = _draw_tips(scene, workspace, View(*view))
    share = _draw_section(sides, found, found.dexterity, float(found.dexterity.max()))
    best = _draw_section(margins, found, found.margin, 1.0)
    where: dict[str, Any] = {"orientation": "horizontal", "shrink": 0.75, "aspect": 25, "pad": 0.02}
    colour_bar(figure, tips, "stability margin", ax=scene, **where)
    colour_bar(figure, share, "share of directions", ax=sides, **where)
    colour_bar(figure, best, "largest margin", ax=margins, **where)
    if loss is not None:
        _draw_lost(margins, loss)
    margins.sharey(sides)
    return figure


def _draw_tips(axes: Axes, workspace: Workspace, view: View) -> Collection:
    """Tips in space, those farther from the viewer first."""
    table = workspace.some(MOST_TIPS)
    table = table[np.isfinite(table[:, -1])]
    points, margin = table[:, -7:-4], table[:, -1]
    draw_plate(axes, points, view)
    seen = view.project(points)
    order = np.argsort(seen[:, 2], kind="stable")
    style: dict[str, Any] = {"s": 3, "linewidths": 0, "rasterized": True, "zorder": 4}
    return axes.scatter(seen[order, 0], seen[order, 1], c=margin[order], cmap=MAP, vmin=0, vmax=1, **style)


def _fold(centres: Array, size: float) -> Keys:
    """(V, 2) cell of each voxel in the meridian: distance from the axis and height."""
    distance = np.hypot(centres[:, 0], centres[:, 1])
    return np.floor(np.column_stack([distance, centres[:, 2]]) / size).astype(np.int64)


def _draw_section(axes: Axes, found: Voxels, values: Array, most: float) -> Collection:
    """Voxels folded into the meridian, the largest value of each cell, in colours from 0 to `most`."""
    cells = _fold(found.centres, found.size)
    low, high = cells.min(0), cells.max(0)
    grid = np.full(high - low + 1, -np.inf)
    np.maximum.at(grid, tuple((cells - low).T), values)
    edges = [np.arange(low[k], high[k] + 2) * found.size * TO_MM for k in range(2)]
    shown = np.ma.masked_invalid(grid.T)
    drawn = axes.pcolormesh(*edges, shown, cmap=MAP, vmin=0, vmax=most, rasterized=True)
    axes.set(xlabel="from the axis (mm)", ylabel="z (mm)")
    axes.set_aspect("equal")
    return drawn


def _draw_lost(axes: Axes, loss: SnappingLoss) -> None:
    """Cells of the meridian with lost voxels, hatched and in a colour of their own where nothing else is reached."""
    from matplotlib.collections import PolyCollection
    from matplotlib.patches import Patch

    lost, held = (
        np.unique(_fold(np.asarray((keys + 0.5) * loss.size), loss.size), axis=0) for keys in (loss.lost, loss.held)
    )
    alone = [cell for cell in lost.tolist() if cell not in held.tolist()]
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    outline: dict[str, Any] = {"edgecolor": LOST_COLOUR, "linewidth": 0.8, "hatch": "//////"}
    looks = ((lost.tolist(), outline | {"facecolor": "none"}), (alone, outline | {"facecolor": LOST_FACE}))
    for cells, look in looks:
        if cells:
            corners = (np.array(cells)[:, None] + square) * loss.size * TO_MM
            axes.add_collection(PolyCollection(list(corners), zorder=5, **look))
    axes.autoscale_view()
    share = f"lost to snapping: {number(100 * loss.fraction, 1)} % of the volume"
    handles = [Patch(facecolor="#FEE838", label="reached by a stable robot"), Patch(label=share, **looks[1][1])]
    if alone and len(alone) < len(lost):
        handles.append(Patch(label="both, at other places around the axis", **looks[0][1]))
    axes.legend(handles=handles, loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0)
