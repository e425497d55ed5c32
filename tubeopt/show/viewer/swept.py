"""The volume that an arm sweeps along a trajectory, as one closed surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...equilibrium.result import Equilibrium
from ...errors import InputError
from ...files.units import TO_MM
from ...inverse.arm_surface import ArmSurface
from ...typing import Array
from ..arm_surfaces import Centreline
from ..surfaces import Surface
from .playback import Playback, snaps_between, state_at
from .session import strides

STEP = np.radians(20.0)
"""Largest turn of a tube between shapes whose common hull is taken."""

SLIDE = 0.008
"""Largest translation likewise, m."""

PIECES = 20
"""Parts of the arm between which hulls are taken."""

SIDES = 10
"""Corners of each cross-section: the hull lies within 5 % of the radius inside the round tube."""

MOST_SHAPES = 160
COLOUR, OPACITY = (120, 90, 200), 0.25


@dataclass(frozen=True, eq=False)
class Swept:
    """The surface of what is swept, its volume (m^3), and how many shapes were joined."""

    surface: Surface
    volume: float
    shapes: int


def swept_volume(playback: Playback) -> Swept:
    """Union of the convex hulls of neighbouring parts of the arm at neighbouring times.

    A snap is left out: through where the arm flies is not in the model.

    Raises:
        InputError: manifold3d, which joins the hulls, is not installed.
    """
    try:
        import manifold3d
    except ImportError:
        raise InputError("the swept volume needs manifold3d: python -m pip install 'tubeopt[view]'") from None
    hulls: list[Any] = []
    shapes = 0
    for run in _runs(playback):
        rings = [_rings(each) for each in run]
        shapes += len(rings)
        pairs = zip(rings, rings[1:] or rings, strict=False)
        for a, b in pairs:
            for k in range(PIECES):
                points = np.concatenate([a[k], a[k + 1], b[k], b[k + 1]]).astype(np.float32)
                hulls.append(manifold3d.Manifold.hull_points(np.ascontiguousarray(points * TO_MM)))
    whole = manifold3d.Manifold.batch_boolean(hulls, manifold3d.OpType.Add)
    mesh = whole.to_mesh()
    surface = Surface(np.array(mesh.vert_properties)[:, :3] / TO_MM, np.array(mesh.tri_verts, dtype=np.uint32))
    return Swept(surface, float(whole.volume()) * 1e-9, shapes)


def _runs(playback: Playback) -> list[list[Equilibrium]]:
    """Shapes close together in time, in runs that no snap interrupts."""
    points = playback.waypoints
    steps = strides(points.rotations, points.translations, turn=STEP, slide=SLIDE)
    count = np.maximum(np.ceil(steps), 1).astype(int)
    count = np.maximum(1, np.floor(count * min(1.0, MOST_SHAPES / max(count.sum(), 1)))).astype(int)
    times = [np.linspace(a, b, n + 1)[1:] for a, b, n in zip(points.time, points.time[1:], count, strict=False)]
    runs: list[list[Equilibrium]] = [[playback.path.equilibria[0]]]
    before = 0.0
    for t in np.concatenate([*times, np.empty(0)]):
        if snaps_between(playback, before, float(t)):
            runs.append([])
        runs[-1].append(state_at(playback, float(t)))
        before = float(t)
    return [run for run in runs if run]


def _rings(equilibrium: Equilibrium) -> Array:
    """(PIECES + 1, SIDES, 3) corners of cross-sections along the arm, as wide as the widest tube there, m."""
    line = Centreline(equilibrium)
    s = np.linspace(0.0, line.length, PIECES + 1)
    radius = ArmSurface(equilibrium).radius(s)[:, None, None]
    return np.asarray(line.position(s)[:, None] + radius * line.ring(s, SIDES)[0])
