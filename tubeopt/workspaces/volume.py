"""The volume of a workspace by three methods, each with its error; with voxels and loss to snapping in one answer."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ..arguments import typed
from ..display import Displayed
from ..errors import InputError, finite, positive
from ..files.field_metadata import POSITIVE, TYPICAL_REGION, Range, Typical, key, typical_length
from ..solvers.time_limit import LONG_TIME_LIMIT, limited
from ..typing import Array, Progress
from .loss import SnappingLoss, snapping_loss
from .sampling import Workspace, has_margin
from .voxels import Keys, Voxels, cells, default_size, in_first_half, on_surface, voxels


@dataclass(frozen=True)
class Volume:
    """A volume with its error estimates."""

    value: float
    """Volume, m^3."""
    method: str
    """Method: "voxels", "meridian" or "alpha"."""
    scale: float
    """Edge of the cells, or radius of the alpha shape, m."""
    half: float
    """Volume from the first half of the samples, m^3; if it is as large, more samples change little."""
    unseen: float
    """Estimated volume of voxels without a sample, m^3 (Chao 1984, from those with one and two); NaN for the other
    methods."""
    surface: float
    """Half the volume of the cells on the surface, m^3, as error estimate; NaN for an alpha shape."""


@typed
def voxel_volume(workspace: Workspace, size: float | None = None, *, min_margin: float = 0.0) -> Volume:
    """Volume of all voxels with a tip, less half of the voxels on the surface, which lie half outside.

    Args:
        size, min_margin: as for `voxels`.

    Raises:
        InputError: as `voxels`.
    """
    return volume_of(voxels(workspace, size, min_margin=min_margin))


def volume_of(voxels: Voxels) -> Volume:
    """Volume of voxels: their number times their size, less half of the voxels on the surface, m^3."""
    cube = voxels.size**3
    first = voxels.index[voxels.early > 0]
    once, twice = int((voxels.count == 1).sum()), int((voxels.count == 2).sum())
    surface = 0.5 * voxels.surface.sum() * cube
    return Volume(
        value=float(len(voxels) * cube - surface),
        method="voxels",
        scale=voxels.size,
        half=float((len(first) - 0.5 * on_surface(first).sum()) * cube),
        unseen=once * (once - 1) / (2 * (twice + 1)) * cube,
        surface=float(surface),
    )


@typed
def meridian_volume(workspace: Workspace, size: float | None = None, *, min_margin: float = 0.0) -> Volume:
    """Volume of the body of revolution of the tips about z: the most accurate of the three methods.

    Exact in the limit for concentric robots with rotations of a full turn, since turning all tubes turns the arm. Cells
    at the edge of the meridian count half, as for `voxel_volume`. With a grid of joint values it is a rough estimate:
    its tips form rows in the meridian, with gaps that depend on the place, so that no cell size fits everywhere.

    Args:
        size: edge of the cells, m; by default a quarter of that of `voxels`, or 4/3 of that for a grid of joint
            values, most of whose tips coincide in the meridian.
        min_margin: only configurations at least as stable count.

    Raises:
        InputError: tubes off the centreline, or limits of less than a turn; a size that is not positive; no sample is
            that stable.
    """
    robot = workspace.robot
    turns = np.diff(np.array(robot.limits.rotations), axis=1)
    eccentric = not robot.fixed_sections or robot.assembly(robot.home_translations).eccentric
    if eccentric or turns.min() < 2 * np.pi - 1e-9:
        raise InputError(
            "the workspace is not a body of revolution: the robot is "
            "eccentric, or rotations are limited to less than a full turn"
        )
    # The tips of a grid form rows in the meridian: cells must be wider than most gaps between the rows.
    finer = 3 / 4 if workspace.method == "grid" else 4
    scale = default_size(workspace) / finer if size is None else positive("size", size)
    keys: dict[bool, Keys] = {}
    for first, table in workspace.chunks():
        stable = has_margin(table, min_margin)
        tips = table[stable, -7:-4]
        plane = np.column_stack([np.hypot(tips[:, 0], tips[:, 1]), np.zeros(len(tips)), tips[:, 2]])
        index = cells(plane, scale)[:, ::2]
        for early, rows in ((False, index), (True, index[in_first_half(workspace, first, len(table))[stable]])):
            keys[early] = np.unique(np.concatenate([keys.get(early, rows[:0]), rows]), axis=0)
    if not len(keys[False]):
        raise InputError(f"min_margin is {min_margin:g}; no sample has this margin")
    value, surface = _revolved(keys[False], scale)
    first_half = _revolved(keys[True], scale)[0] if len(keys[True]) else 0.0
    return Volume(value=value, method="meridian", scale=scale, half=first_half, unseen=float("nan"), surface=surface)


def _revolved(index: Keys, size: float) -> tuple[float, float]:
    """Volume of revolution of cells (C, 2) of the meridian, and half of the volume of those on its edge, m^3."""
    filled = np.zeros(index.max(0) - index.min(0) + (3, 3), dtype=bool)
    filled[tuple((index - index.min(0) + 1).T)] = True
    if index[:, 0].min() == 0:  # beyond the axis is the other side
        filled[0] = filled[1]
    inside = filled[1:-1, 1:-1] & filled[:-2, 1:-1] & filled[2:, 1:-1] & filled[1:-1, :-2] & filled[1:-1, 2:]
    # Pappus: the area of a cell times the length of the circle of its centre.
    ring = 2 * np.pi * (np.arange(index[:, 0].min(), index[:, 0].max() + 1) + 0.5) * size**3
    filled_volume, core = (float(ring @ part.sum(1)) for part in (filled[1:-1, 1:-1], inside))
    return (filled_volume + core) / 2, (filled_volume - core) / 2


@typed
def alpha_volume(workspace: Workspace, radius: float | None = None, *, min_margin: float = 0.0) -> Volume:
    """Volume of the alpha shape of the tips: the Delaunay tetrahedra with a small circumsphere.

    Edelsbrunner and Muecke, "Three-dimensional alpha shapes", ACM Trans. Graphics 13(1), 1994.

    Args:
        radius: largest circumradius, m; by default 5 mean distances of the points.
        min_margin: only configurations at least as stable count.

    Raises:
        InputError: a radius that is not positive, fewer than five points, points that lie in a plane.
    """
    if radius is not None:
        typical_length("radius", radius, TYPICAL_REGION)
    table = workspace.some(20_000)
    tips = np.asarray(table[has_margin(table, min_margin), -7:-4])
    value, reach = alpha_shape(tips, radius)
    half, _ = alpha_shape(tips[: len(tips) // 2], radius)
    return Volume(value=value, method="alpha", scale=reach, half=half, unseen=float("nan"), surface=float("nan"))


def alpha_shape(points: Array, radius: float | None = None) -> tuple[float, float]:
    """Volume (m^3) and radius (m) of the alpha shape of points (N, 3)."""
    from scipy.spatial import Delaunay, QhullError

    if len(points) < 5:
        raise InputError(f"there are {len(points)} tips; an alpha shape needs at least 5")
    try:
        corners = points[Delaunay(points).simplices]
    except QhullError:
        raise InputError("the tips lie in a plane; an alpha shape needs points in space") from None
    # Three edges (T, 3, 3) from one corner of each tetrahedron: |det| / 6 is its volume.
    edges = corners[:, 1:] - corners[:, :1]
    size = np.abs(np.linalg.det(edges)) / 6
    # A sliver has no circumsphere within round-off. Its matrix is replaced, so that one call solves all.
    flat = size <= 1e-12 * np.abs(edges).max((1, 2)) ** 3
    edges[flat] = np.eye(3)
    # |c|^2 = |c - e_k|^2 for the three edges e_k from one corner: 2 e_k . c = |e_k|^2.
    centre = np.linalg.solve(2 * edges, (edges**2).sum(2)[..., None])[..., 0]
    circumradius = np.where(flat, np.inf, np.linalg.norm(centre, axis=1))
    if radius is None:
        radius = _mean_distance(size, circumradius, len(points))
    return float(size[circumradius <= radius].sum()), float(radius)


def _mean_distance(size: Array, circumradius: Array, count: int) -> float:
    """Radius that is five mean distances of points in its own alpha shape, m: a fixed point, iterated from above."""
    reach = 5.0  # radius of the alpha shape in mean distances of its points
    radius = reach * (float(size.sum()) / count) ** (1 / 3)
    for _ in range(50):
        smaller = reach * (float(size[circumradius <= radius].sum()) / count) ** (1 / 3)
        if smaller >= 0.99 * radius:
            break
        # At most halved: a much smaller radius may drop so many tetrahedra that the fixed point is passed.
        radius = max(float(smaller), 0.5 * radius)
    return float(radius)


@dataclass(frozen=True, eq=False)
class Findings(Displayed):
    """Voxels, volumes and loss of a workspace; a volume is None if its method does not apply."""

    workspace: Workspace
    voxels: Voxels
    """Voxels that the tips reach."""
    volume: Volume
    meridian: Volume | None
    """Volume of a body of revolution."""
    alpha: Volume | None
    """Volume of an alpha shape."""
    loss: Annotated[SnappingLoss | None, key("snapping"), "volume lost to snapping; null unless requested"]


@typed
@limited
def examine(
    workspace: Workspace,
    size: Annotated[float | None, key("voxel_mm"), POSITIVE, Typical(1e-5, 0.1)] = None,
    *,
    min_margin: Annotated[float, Range(maximum=1.0)] = 0.0,
    loss: Annotated[int, Range(minimum=0)] = 0,
    progress: Progress | None = None,
    time_limit: float = LONG_TIME_LIMIT,
) -> Findings:
    """Compute voxels, volumes and loss of a workspace.

    Args:
        size: edge length of the voxels; by default a round number for about 15 samples per voxel of
            the bounding box.
        min_margin: smallest stability margin of a counted configuration.
        loss: number of sampled equilibria, stable or not, that estimate the share of the workspace lost to snapping; 0
            to skip.
        progress: of the loss.
        time_limit: s, on the clock.

    Raises:
        InputError: as `voxels` and `snapping_loss`.
        TimeLimitError: (a SolveError) the time limit was reached before there was an answer.
    """
    finite("min_margin", min_margin)
    cubes = voxels(workspace, size, min_margin=min_margin)
    lost = None
    if loss:
        lost = snapping_loss(
            workspace.robot, loss, size=cubes.size, seed=workspace.seed, reached=workspace, progress=progress
        )
    meridian = alpha = None
    with suppress(InputError):  # no body of revolution
        meridian = meridian_volume(workspace, min_margin=min_margin)
    with suppress(InputError):  # flat
        alpha = alpha_volume(workspace, min_margin=min_margin)
    return Findings(workspace, cubes, volume_of(cubes), meridian, alpha, lost)
