"""Pictures of reach: targets of inverse kinematics, and workspaces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError, positive
from ...files.units import TO_MM
from ...inverse import InverseSolution
from ...typing import Array
from ...workspaces import SnappingLoss, Workspace
from ...workspaces.sampling import has_margin, require_samples
from ...workspaces.voxels import PATCHES, Keys, Store, index_of
from ..formatting import counted
from .labels import legend_above
from .panels import MARGIN, draw_joints, draw_over, share_x
from .projection import Projection
from .scene import DrawnTarget, draw_plate
from .shape import draw_scenes
from .style import Axes, Figure, caption, colour_bar, headed, new_figure, number, picture
from .trajectory import beside_scene, swept_scene

if TYPE_CHECKING:
    from matplotlib.collections import Collection


@picture
def plot_inverse(
    solutions: InverseSolution | Sequence[InverseSolution],
    *,
    view: tuple[float, float] | None = None,
) -> Figure:
    """Picture of the arm at its target; other solutions for the same target are drawn as ghosts.

    Args:
        solutions: one solution, or several for the same target, the best first.
        view: elevation and azimuth of the viewer, deg; None looks across the widest side.
    """
    best, *alternatives = solutions if isinstance(solutions, Sequence) else [solutions]
    figure = new_figure(7.0, 5.0)
    remark = ""
    if alternatives:
        margins = ", ".join(f"{each.margin:.3f}" for each in alternatives)
        postures = counted(len(alternatives), "other posture")
        remark = f"\nghosts: {postures} with the same tip, margin {margins}"
    headed(figure, caption(best.equilibrium) + remark)
    missed = None if best.reached else best.equilibrium.tip_position
    target = DrawnTarget(best.target_position, best.target_direction, missed)
    ghosts = [each.equilibrium for each in alternatives]
    draw_scenes(figure, [best.equilibrium], [ghosts], view, targets=[target])
    return figure


@picture
def plot_targets(
    solutions: Sequence[InverseSolution],
    *,
    title: str = "",
    shown: int = 5,
    view: tuple[float, float] | None = None,
) -> Figure:
    """Picture of an arm that follows targets: the arm at some of them, the targets, margin and joint values.

    Args:
        solutions: one solution per target, in their order.
        view: as in `plot_inverse`.
        title: heading; default the robot's name.
        shown: number of targets at which the arm is drawn, the last one solid.
    """
    arms = [each.equilibrium for each in solutions]
    targets = np.array([each.target_position for each in solutions])
    figure = new_figure(9.0, 5.0)
    name = title or arms[-1].robot.name or "robot"
    largest_error = max(each.position_error for each in solutions)
    min_margin = min(each.margin for each in solutions)
    headed(
        figure,
        f"{name}: {len(arms)} targets, tip within {largest_error * 1e9:.2g} nm, margin at least {min_margin:.3f}",
    )
    distance = path_length(targets) * TO_MM
    scene = swept_scene(arms, np.arange(len(arms), dtype=float), targets, shown=shown, targets=True)
    panels = beside_scene(figure, 3, scene, view)
    rotations = np.array([each.rotations for each in solutions])
    translations = np.array([each.translations for each in solutions])
    draw_joints(panels[:2], distance, rotations, translations)
    draw_over(panels[2], distance, [each.margin for each in solutions], MARGIN)
    share_x(panels, distance, "path of the tip (mm)")
    return figure


def path_length(points: Array) -> Array:
    """(T,) length of the path through points (T, 3) up to each, m."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


MAP = "cividis"
LOST_FACE = "#F2B48C"
LOST_COLOUR = "#D55E00"
MAX_TIPS = 4000
"""Largest number of tips that are drawn."""

PER_CELL = 12
"""Samples per cell of a section if they were evenly spread over its bounding box."""

ACROSS = 200
"""Smallest number of drawn points along the longer side of a section, for smooth changes between cells."""

MIN_SPAN = 0.01
"""Smallest range of the colour scale of margins."""


@picture
def plot_workspace(
    workspace: Workspace,
    *,
    loss: SnappingLoss | None = None,
    size: float | None = None,
    title: str = "",
    view: tuple[float, float] = (18.0, -60.0),
) -> Figure:
    """Figure of a workspace: tips in space, and a section with directions of the tip and smallest margin.

    The section is a half-plane through z into which all tips are turned. Each point shows the samples around it: the
    fraction of directions in which their tips point, relative to the half-plane, and the smallest of their margins.

    Args:
        loss: result of `snapping_loss`.
        size: edge of the cells of the section, m; by default for about 12 samples per cell.
        title: heading; default the robot's name and the number of samples.
        view: elevation and azimuth of the viewer of the scene, deg.

    Raises:
        InputError: no sample has a stable equilibrium, a loss of another robot, a size that is not positive, the name
            of the picture does not end in a known format.
    """
    if loss is not None and loss.robot != workspace.robot:
        raise InputError("loss is of another robot than the workspace")
    require_samples(workspace)
    section = _section(workspace, size)
    figure = new_figure(9.0, 4.9)
    name = workspace.robot.name or f"robot of {workspace.robot.n_tubes} tubes"
    headed(figure, title or f"{name}: tips at {len(workspace):,} joint values")
    scene, sides, margins = figure.subplots(1, 3, width_ratios=[1.9, 1, 1])
    tips = _draw_tips(scene, workspace, Projection(*view))
    # From 0, since a fraction has a natural zero.
    fractions = _draw_section(sides, section, section.dexterity, (0.0, float(np.nanmax(section.dexterity))))
    smallest = _draw_section(margins, section, section.margin, _span(section.margin))
    where: dict[str, Any] = {"orientation": "horizontal", "shrink": 0.75, "aspect": 25, "pad": 0.02}
    colour_bar(figure, tips, "stability margin", ax=scene, **where)
    colour_bar(figure, fractions, "fraction of directions", ax=sides, **where)
    colour_bar(figure, smallest, "smallest margin", ax=margins, **where)
    if loss is not None:
        _draw_lost(margins, loss)
    margins.sharey(sides)
    return figure


def _span(margins: Array) -> tuple[float, float]:
    """Lower and upper end of the colour scale for margins."""
    largest = float(np.nanmax(margins))
    return min(float(np.nanmin(margins)), largest - MIN_SPAN), largest


def _draw_tips(axes: Axes, workspace: Workspace, view: Projection) -> Collection:
    """Draw tips in space, those farther from the viewer first."""
    table = workspace.some(MAX_TIPS)
    table = table[np.isfinite(table[:, -1])]
    points, margin = table[:, -7:-4], table[:, -1]
    draw_plate(axes, points, view)
    projected = view.project(points)
    # Of two tips at one point of the picture the nearer one is drawn last; stable, so that files are equal.
    order = np.argsort(projected[:, 2], kind="stable")
    style: dict[str, Any] = {"s": 3, "linewidths": 0, "rasterized": True, "zorder": 4}
    low, high = _span(margin)
    return axes.scatter(
        projected[order, 0], projected[order, 1], c=margin[order], cmap=MAP, vmin=low, vmax=high, **style
    )


def _fold(centres: Array, size: float) -> Keys:
    """(V, 2) cell of each voxel in the half-plane through z: distance from the axis, and height."""
    distance = np.hypot(centres[:, 0], centres[:, 1])
    return np.floor(np.column_stack([distance, centres[:, 2]]) / size).astype(np.int64)


@dataclass(frozen=True, eq=False)
class _Section:
    """Cells of a half-plane through z: cell (i, j) starts (first + (i, j)) * size from the axis and the plate."""

    size: float
    first: Keys
    margin: Array
    """(I, J) smallest margin of the samples in and next to a cell; NaN for cells without samples."""
    dexterity: Array
    """(I, J) fraction of directions of the samples in and next to a cell; NaN for cells without samples."""


def _section(workspace: Workspace, size: float | None) -> _Section:
    """Cells of a half-plane with all tips turned into it about z, and their directions."""
    from scipy.ndimage import minimum_filter

    edge = _cell_size(workspace) if size is None else positive("size", size)
    store = Store(edge)
    for _, part in workspace.chunks():
        table = part[has_margin(part, -np.inf)]
        x, y, z = table[:, -7:-4].T
        distance = np.hypot(x, y)
        # On the axis the half-plane is not determined: the tip is not turned.
        safe = np.where(distance > 0, distance, 1.0)
        cosine, sine = np.where(distance > 0, x / safe, 1.0), y / safe
        across, along, up = table[:, -4:-1].T
        # Rotation by minus the azimuth of the tip, which brings it into the half-plane y = 0.
        turned = np.column_stack([cosine * across + sine * along, cosine * along - sine * across, up])
        tips = np.column_stack([distance, np.zeros(len(table)), z])
        store.add(tips, turned, -table[:, -1], np.ones(len(table), dtype=bool))  # of equal cells it keeps the largest
    cells = index_of(store.keys)[:, ::2]
    first = cells.min(0)
    where = tuple((cells - first).T)
    shape = cells.max(0) - first + 1
    margin, patches = np.full(shape, np.inf), np.zeros(shape + 2, np.uint64)
    margin[where] = -store.margin
    patches[1:-1, 1:-1][where] = store.patches
    empty = np.isinf(margin)
    neighbours = np.zeros(shape, np.uint64)
    for i, j in np.ndindex(3, 3):
        # A bit per patch of directions; the union over a cell and its eight neighbours counts none twice.
        neighbours |= patches[i : i + shape[0], j : j + shape[1]]
    fractions = np.bitwise_count(neighbours) / PATCHES
    # Empty cells are inf here and lose against any neighbour.
    smallest = minimum_filter(margin, 3, mode="nearest")
    return _Section(edge, first, np.where(empty, np.nan, smallest), np.where(empty, np.nan, fractions))


def _cell_size(workspace: Workspace) -> float:
    """Edge, m, of cells with `PER_CELL` samples each, if samples are even over their bounding box."""
    low, high, count = np.full(2, np.inf), np.full(2, -np.inf), 0
    for _, part in workspace.chunks():
        tips = part[has_margin(part, -np.inf), -7:-4]
        if len(tips):
            plane = np.column_stack([np.hypot(tips[:, 0], tips[:, 1]), tips[:, 2]])
            low, high, count = np.minimum(low, plane.min(0)), np.maximum(high, plane.max(0)), count + len(tips)
    longest = max(float((high - low).max()), 1e-3)
    # Tips on a line, as of one tube that only slides, have no area.
    area = float(np.prod(np.maximum(high - low, longest / 100)))
    # count / area samples per area, so an edge sqrt(area PER_CELL / count) holds PER_CELL of them.
    return max(float(np.sqrt(area * PER_CELL / count)), longest / 100)


def _draw_section(axes: Axes, section: _Section, values: Array, span: tuple[float, float]) -> Collection:
    """Draw values (I, J) of a section, smooth between its cells and at its edge."""
    from scipy.ndimage import gaussian_filter, zoom

    # Cells without samples take no part in the mean of a point; the edge is where half of the cells around have some.
    padded = np.pad(values, 2, constant_values=np.nan)
    inside = np.isfinite(padded)
    # Normalised convolution (Knutsson and Westin, 1993): smoothed values over smoothed weights.
    weight = gaussian_filter(inside.astype(float), 0.7)
    mean = gaussian_filter(np.where(inside, padded, 0.0), 0.7) / np.maximum(weight, 1e-9)
    if section.first[0] == 0:  # beyond the axis lies the other side
        weight[:2], mean[:2] = weight[3:1:-1], mean[3:1:-1]
    # Rounded up.
    finer = -(-ACROSS // max(padded.shape))
    # grid_mode: values belong to the middles of cells, and not to their corners.
    fine, part = (zoom(each, finer, order=1, grid_mode=True, mode="nearest") for each in (mean, weight))
    edges = [
        TO_MM * section.size * (section.first[k] - 2 + np.arange(finer * padded.shape[k] + 1) / finer) for k in range(2)
    ]
    outside = part < 0.5
    outside[edges[0][:-1] < -1e-9] = True
    shown = np.ma.masked_where(outside, fine)
    low, high = span
    drawn = axes.pcolormesh(*edges, shown.T, cmap=MAP, vmin=low, vmax=high, rasterized=True)
    visible = [np.flatnonzero(~outside.all(axis=1 - k)) for k in range(2)]
    axes.set_xlim(edges[0][visible[0][0]], edges[0][visible[0][-1] + 1])
    axes.set_ylim(edges[1][visible[1][0]], edges[1][visible[1][-1] + 1])
    axes.set(xlabel="from the axis (mm)", ylabel="z (mm)")
    axes.set_aspect("equal")
    return drawn


def _draw_lost(axes: Axes, loss: SnappingLoss) -> None:
    """Hatch cells of the half-plane with lost voxels, in a colour of their own where nothing else is reached."""
    from matplotlib.collections import PolyCollection
    from matplotlib.patches import Patch

    lost, held = (
        # Voxels are known by their lower corner; half an edge more is the centre.
        np.unique(_fold(np.asarray((keys + 0.5) * loss.size), loss.size), axis=0)
        for keys in (loss.lost, loss.held)
    )
    # A cell of the half-plane contains voxels all around the axis, of which some may be lost and others not.
    alone = [cell for cell in lost.tolist() if cell not in held.tolist()]
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    outline: dict[str, Any] = {"edgecolor": LOST_COLOUR, "linewidth": 0.8, "hatch": "//////"}
    looks = ((lost.tolist(), outline | {"facecolor": "none"}), (alone, outline | {"facecolor": LOST_FACE}))
    for cells, look in looks:
        if cells:
            corners = (np.array(cells)[:, None] + square) * loss.size * TO_MM
            axes.add_collection(PolyCollection(list(corners), zorder=5, **look))
    axes.autoscale_view()
    lost_volume = f"lost to snapping: {number(100 * loss.fraction, 1)} % of the volume"
    handles = [Patch(facecolor="#FEE838", label="reached by a stable robot"), Patch(label=lost_volume, **looks[1][1])]
    if alone and len(alone) < len(lost):
        handles.append(Patch(label="both, at other places around the axis", **looks[0][1]))
    legend_above(axes, 1, handles=handles)
