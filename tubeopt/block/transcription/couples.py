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
from ...robots.order import last_tube, twisted_tube
from ...typing import Array, Index
from .orientation import Orientation, tangent_slopes, tangents
from .reduced import ReducedProblem, row_of

END = 1e-12
"""Distance (m) within which a moment acts where a tube ends: round-off of a length."""


@dataclass(frozen=True, eq=False)
class Couples:
    """C moments on the tubes of an arm: J at joints between pieces, the tip first, then those at collocation points."""

    along: Array
    """(N, 3) moment per length at the collocation points, N."""
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
    unseen: Array
    """(C,) turn of the tip, by a unit torque there, that z does not see, rad/(N m)."""

    def quaternions(self, along: Orientation) -> Array:
        """(C, 4) where the moments act."""
        return np.concatenate([along.begin[self.joint], along.stage[self.point]])

    def torques(self, along: Orientation, moment: Array) -> Array:
        """(C,) tau = m.t of moments (C, 3)."""
        return np.asarray((moment * tangents(self.quaternions(along))).sum(1))

    def torque_slopes(self, along: Orientation, moment: Array, turned: Array, *, following: bool) -> Array:
        """(C, U + 2 N) derivative of the torques, with `turned` (2 N, U + 2 N) that of the curvature; a moment at the
        tip that is `following` turns with the tangent."""
        slope = np.concatenate([along.begin_slope[self.joint], along.stage_slope[self.point]])
        leaning = (moment[:, None] @ tangent_slopes(self.quaternions(along)))[:, 0]
        leaning[:1] *= not following
        return np.asarray((leaning[:, None] @ slope)[:, 0] @ turned)


def couples_of(torsion: ReducedProblem, load: Load, per_length: Array, spread: Array) -> Couples:
    """The moments of a load: at the tip, at its points, and `per_length` (N, 3) at the collocation points, N; `spread`
    (N, n, U) is the turn of the tubes there by z."""
    assembly, mesh = torsion.assembly, torsion.mesh
    ahead, ends = torsion.softness
    at = [part for part in load.points if any(part.moment)]
    joint = np.array([len(mesh.length), *(_joint(mesh.start, part.at) for part in at)])
    tip = int(last_tube(assembly.end))
    on_joint = [tip, *(twisted_tube(assembly.end, part.at) for part in at)]
    point = np.flatnonzero(per_length.any(1))
    present = assembly.present[np.repeat(mesh.section, mesh.tableau.degree)[point]]
    outermost = present.shape[1] - 1 - present[:, ::-1].argmax(1)
    # A torque turns its tube up to where it acts, and no farther.
    levers = [np.minimum(ahead[:, j], ends[e, j]) for e, j in zip(joint.tolist(), on_joint, strict=True)]
    rows = [row_of(torsion, j, lever) for j, lever in zip(on_joint, levers, strict=True)]
    row, tube = np.concatenate([rows, spread[point, outermost]]), np.array([*on_joint, *outermost], dtype=np.intp)
    turns = np.concatenate([ends[joint, tip], ahead[point, tip]])
    return Couples(
        along=per_length,
        moment=np.concatenate([[load.moment, *(part.moment for part in at)], (per_length.T * torsion.weight).T[point]]),
        joint=joint,
        point=point,
        tube=tube,
        row=row,
        unseen=np.where(tube == tip, turns, 0.0) - row @ row[0],
    )


def _joint(start: Array, at: float) -> int:
    """The piece that begins at an arc length, of those that begin at (P,); their number at the tip."""
    return int(np.searchsorted(start, at - END))
