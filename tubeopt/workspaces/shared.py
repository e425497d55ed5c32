"""Overlap of the workspaces of two robots, in voxels, and the placement that makes it largest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from ..arguments import typed
from ..bodies.frames import Frame, base_frame
from ..display import Displayed
from ..errors import InputError, finite, positive
from ..solvers.time_limit import TIME_LIMIT, limited
from ..typing import Array
from .sampling import Workspace, has_margin, require_samples
from .voxels import cells, default_size, index_of, keys_of

# Differential evolution from 25 points of five unknowns; the overlap of voxels has steps, so that no gradient helps.
SEARCHED, EACH = 25, 5
"""Maximum number of generations of differential evolution, and individuals per unknown."""


@dataclass(frozen=True, eq=False)
class SharedWorkspace(Displayed):
    """Voxels that the tips of two robots both reach."""

    size: float
    """Edge of the voxels, m."""
    volumes: Array
    """(2,) volumes of the workspaces, m^3."""
    shared: float
    """Volume that both reach, m^3."""
    places: Array
    """(V, 3) centres of the voxels that both reach, in the frame that the robots share, m."""
    bases: tuple[Frame, Frame]
    """Frames of the base plates."""

    @property
    def value(self) -> float:
        """Volume that both reach, m^3."""
        return self.shared

    @property
    def share(self) -> float:
        """Fraction of the smaller workspace that the other robot also reaches."""
        return float(self.shared / self.volumes.min())


@typed
def shared_workspace(
    workspaces: Sequence[Workspace], bases: Sequence[Frame], *, size: float | None = None, min_margin: float = 0.0
) -> SharedWorkspace:
    """Overlap of the workspaces of two robots with their plates in two frames.

    Contact between the arms is not considered; see `plan_arms`.

    Args:
        size: edge of the voxels, m; by default as in `voxels`. With few samples in each, voxels are missed, and the
            overlap is too small.
        min_margin: only configurations at least as stable count.

    Raises:
        InputError: not two workspaces and two frames, a size that is not greater than 0, no sample with the margin.
    """
    if len(workspaces) != 2 or len(bases) != 2:
        raise InputError(f"there are {len(workspaces)} workspaces and {len(bases)} bases; there must be two of each")
    tips = [_tips(each, finite("min_margin", min_margin)) for each in workspaces]
    edge = max(default_size(each) for each in workspaces) if size is None else positive("size", size)
    return _shared(tips, (bases[0], bases[1]), edge)


def _tips(workspace: Workspace, min_margin: float) -> Array:
    require_samples(workspace)
    tips = np.asarray(workspace.tip_position[has_margin(workspace.table, min_margin)])
    if not len(tips):
        raise InputError(f"no sample of the workspace has a margin of {min_margin:g}")
    return tips


def _shared(tips: Sequence[Array], bases: tuple[Frame, Frame], size: float) -> SharedWorkspace:
    one, other = (np.unique(keys_of(cells(base.placed(tip), size))) for base, tip in zip(bases, tips, strict=True))
    both = index_of(np.intersect1d(one, other, assume_unique=True))
    volumes = np.array([len(one), len(other)]) * size**3
    return SharedWorkspace(size, volumes, len(both) * size**3, np.asarray((both + 0.5) * size), bases)


@typed
@limited
def place_pair(
    workspaces: Sequence[Workspace],
    *,
    least_distance: float,
    most_distance: float,
    most_tilt: float = np.pi / 4,
    size: float | None = None,
    min_margin: float = 0.0,
    seed: int = 0,
    time_limit: float = TIME_LIMIT,
) -> SharedWorkspace:
    """Place two robots so that the overlap of their workspaces is largest.

    They are side by side along x, symmetric about the origin, each tilted in the plane of x and z and turned about its
    own axis.

    Args:
        least_distance, most_distance: limits of the distance between the middles of the plates, m.
        most_tilt: largest angle of each from z, rad.
        seed: seed of differential evolution, which finds distance, two tilts and two turns.
        time_limit: s, on the clock.

    Raises:
        InputError: as `shared_workspace`; distances that leave nothing.
        TimeLimitError: (a SolveError) the time limit was reached before there was an answer.
    """
    if not 0 < finite("least_distance", least_distance) <= finite("most_distance", most_distance):
        raise InputError(
            f"the distance of the base plates is {least_distance * 1e3:g} to "
            f"{most_distance * 1e3:g} mm; the first must be greater than 0 and at most the "
            "second"
        )
    edge = shared_workspace(workspaces, (Frame(), Frame()), size=size, min_margin=min_margin).size
    tips = [_tips(each, finite("min_margin", min_margin)) for each in workspaces]
    tilt = positive("most_tilt", most_tilt, zero=True)

    def bases(x: Array) -> tuple[Frame, Frame]:
        frames = []
        for side, lean, turn in ((-1, x[1], x[3]), (1, x[2], x[4])):
            frames.append(base_frame([side * x[0] / 2, 0, 0], [-side * np.sin(lean), 0, np.cos(lean)], turn))
        return frames[0], frames[1]

    found = scipy.optimize.differential_evolution(
        lambda x: -_shared(tips, bases(x), edge).shared,
        [(least_distance, most_distance), (-tilt, tilt), (-tilt, tilt), (-np.pi, np.pi), (-np.pi, np.pi)],
        maxiter=SEARCHED,
        popsize=EACH,
        tol=1e-3,
        rng=seed,
        polish=False,
    )
    return _shared(tips, bases(found.x), edge)
