"""What dead moments on a loaded arm twist: the part of them along the arm, which no energy has, and its derivatives.

A moment m of fixed direction acts on tube j, where the arm has the tangent t. In a small motion the frame turns by dpsi
about world axes, and the tube by dtheta about the tangent. The work is

    m.dpsi + tau dtheta,        tau = m.t.

The first part bends all tubes up to there: `loaded` has it beside that of forces, by the sum of all moments ahead.
The second twists one tube: at the tip the one that ends last, of several the innermost; elsewhere the outermost one.
At a joint between pieces m is the moment itself; a moment per length acts at the collocation points, times their
weights. The work depends on the path, so that the Jacobian is not symmetric.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...robots.load import Load
from ...robots.order import outermost, twisted_tube
from ...typing import Array, Index
from .orientation import Orientation, tangent_slopes, tangents
from .reduced import ReducedProblem, row_of

END = 1e-12
"""Distance (m) within which a moment acts where a tube ends: round-off of a length."""


@dataclass(frozen=True, eq=False)
class Couples:
    """C moments on the tubes of an arm: J at joints between pieces, the tip first, then those at collocation points."""

    along: Array
    """(N, n, 3) moments per length at the collocation points, on the tubes, N."""
    moment: Array
    """(C, 3) world axes, N m; that at the tip in the axes of the load."""
    joint: Index
    """(J,) the piece that begins there; the number of pieces at the tip."""
    point: Index
    """(C - J,) collocation points."""
    tube: Index
    """(C,) on which each acts."""
    row: Array
    """(C, U) turn of the tube there by z."""
    following: bool
    """Whether the moment at the tip turns with it."""
    rest: Array
    """(J, C) turns of the tubes at the joints, by unit torques on all of them, that z does not see, rad/(N m)."""

    def quaternions(self, along: Orientation) -> Array:
        """(C, 4) where the moments act."""
        return np.concatenate([along.begin[self.joint], along.stage[self.point]])

    def torques(self, along: Orientation) -> Array:
        """(C,) tau = m.t."""
        out = (self.moment * tangents(self.quaternions(along))).sum(1)
        if self.following:
            out[0] = self.moment[0, 2]
        return np.asarray(out)

    def torque_slopes(self, along: Orientation, turned: Array) -> Array:
        """(C, U + 2 N) derivative of the torques, with `turned` (2 N, U + 2 N) that of the curvature."""
        slope = np.concatenate([along.begin_slope[self.joint], along.stage_slope[self.point]])
        leaning = (self.moment[:, None] @ tangent_slopes(self.quaternions(along)))[:, 0]
        leaning[:1] *= not self.following
        return np.asarray((leaning[:, None] @ slope)[:, 0] @ turned)


def couples_of(torsion: ReducedProblem, load: Load, per_length: Array, spread: Array) -> Couples:
    """The moments of a load: at the tip, at its points, and `per_length` (N, 3) at the collocation points, N; `spread`
    (N, n, U) is the turn of the tubes there by z."""
    assembly, mesh = torsion.assembly, torsion.mesh
    ahead, ends = torsion.softness
    at = [(part.at, part.moment) for part in load.acting[::-1] if any(part.moment) or part.at == np.inf]
    # The piece that begins there, at the tip the number of pieces.
    joint = np.searchsorted(mesh.start, [s - END for s, _ in at])
    on_joint, point = twisted_tube(assembly.end, [s for s, _ in at]), np.flatnonzero(per_length.any(1))
    tube_there = np.repeat(outermost(assembly.present)[mesh.section], mesh.tableau.degree)
    on_point = tube_there[point]
    tube, lever = np.concatenate([on_joint, on_point]), np.concatenate([ends[joint, on_joint], ahead[point, on_point]])
    rows = [
        # A torque turns its tube up to where it acts, and no farther.
        row_of(torsion, j, np.minimum(ahead[:, j], end))
        for j, end in zip(on_joint.tolist(), lever.tolist(), strict=False)
    ]
    row, count = np.concatenate([rows, spread[point, on_point]]), len(joint)
    whole = np.where(tube[:count, None] == tube, np.minimum(lever[:count, None], lever), 0.0)
    return Couples(
        along=np.where((tube_there[:, None] == np.arange(assembly.n_tubes))[..., None], per_length[:, None], 0.0),
        moment=np.concatenate([[m for _, m in at], (per_length.T * torsion.weight).T[point]]),
        joint=joint,
        point=point,
        tube=tube,
        row=row,
        following=load.frame == "tip",
        rest=whole - row[:count] @ row.T,
    )
