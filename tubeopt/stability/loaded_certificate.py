"""Whether a robot can snap or buckle whatever pushes at its tip: a bound of the margin for all rotations and forces.

In rotations theta and bending w = u - u0(theta) every configuration is a point of one vector space, and the second
variation of the potential energy at any of them, in the directions y and r of the two, is (see docs/theory-loads.md)

    Q = T + int y'V''y + sum_i (m.a_i / K) y_i^2 - m_w.(psi x psi') - (n.psi)(t.psi) + (n.t) |psi|^2,
    T = int sum kt y'^2 + K |r|^2 + springs,        psi' = R (u0' y + r),  psi(0) = 0.

With |n| <= F, |m_w(s)| <= M(s) = F (L - s) and A_i = |a_i| / K, for every rotation and every direction of the force,

    Q >= T - N,    N = int sum_pairs |c_ij| (Y_i + Y_j)^2 + sum_i M A_i Y_i^2 + 3/2 F phi^2,
    Y_i = |y_i|,   phi' = sum A_i Y_i + |r|,   phi(0) = 0,

so that 1 less the largest eigenvalue of N relative to T bounds the margin (see `physics.certificate`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..physics.certificate import APART, OPPOSED, largest_eigenvalue
from ..robots.assembly import merge
from ..robots.robot import Robot
from ..robots.variation import variation
from ..typing import Array


@dataclass(frozen=True, eq=False)
class Bundle:
    """What the bounds take of an arm of n tubes in m sections, plate to tip.

    start, length (m,), m.   stiffness (m,): K, N m^2.   pull (m, n): |a_i|, N m.   torsional (n,): kt, N m^2.
    transmission (n,): length from where tubes are held to the plate, m.
    """

    start: Array
    length: Array
    stiffness: Array
    pull: Array
    torsional: Array
    transmission: Array

    @property
    def total_length(self) -> float:
        """Length of the arm, m."""
        return float(self.start[-1] + self.length[-1]) if len(self.start) else 0.0

    def softened(self, force: float, *, pairs: bool) -> float:
        """Largest eigenvalue of N relative to T for forces of at most `force`, N; without `pairs` of the part of N by
        the force alone."""
        sections, tubes = (self.length, self.stiffness, self.pull), (self.torsional, self.transmission)
        return largest_eigenvalue(force, sections, tubes, OPPOSED if pairs else APART)[0]


def bundle_of(robot: Robot, near: Array, far: Array | None = None) -> Bundle:
    """An arm of concentric tubes at translations (n,), or no stiffer than the arm at any translations between two: then
    its bounds hold for all of them.

    A tube counts as curved as it may be in a section, as stiff in bending only as it surely is, in torsion as stiff as
    where it is least; its transmission as long and the arm as long as they may be. Fields Y, phi, r of an arm between,
    with Y constant and r 0 beyond its ends, have no larger T there and no smaller N.
    """
    arms = [robot.assembly(near), robot.assembly(near if far is None else far)]
    cells, held = variation(tuple(robot.tubes)), np.stack([arm.transmission for arm in arms])
    ends = cells.cuts - held[:, :, None]
    cuts = merge(np.maximum(np.concatenate([[0.0], ends.ravel()]), 0.0))
    start, length = cuts[:-1], np.diff(cuts)
    s = (start + length / 2)[:, None, None]
    outside = np.full((robot.n_tubes, 1), np.inf)
    begin, end = np.hstack([-outside, ends.min(0)]), np.hstack([ends.max(0), outside])
    # (m, n, C + 1) cells that a section may be in; the last is behind the end of a tube, where it has no stiffness.
    maybe = (begin < s) & (s < end)
    kb, behind = cells.bending[0], np.isinf(end)
    surely = np.where(maybe, np.where(behind, 0.0, kb), np.inf).min(2)
    # Beyond the last end that is sure, some tube is there wherever there is an arm.
    least = np.where(maybe & ~behind, kb, np.inf).min((1, 2))
    return Bundle(
        start,
        length,
        np.maximum(surely.sum(1), least),
        np.where(maybe & ~behind, cells.pull[0], 0.0).max(2),
        cells.torsional.min(1),
        held.max(0),
    )


def loaded_worst_case(robot: Robot, translations: Array, unloaded: float, force: float) -> float:
    """A lower bound of the margin for all rotations and all dead tip forces of at most `force`, N, at translations
    (n,), m; `unloaded` is that without force.

    Of two bounds the larger: that of above, and the unloaded one less the eigenvalue of the parts of N by the force
    alone, since a least value of a sum is at least the sum of the least values. The second is the sharper one for weak
    forces on three or more tubes, which cannot oppose one another pairwise as N has it.
    """
    bundle = bundle_of(robot, translations)
    if not force or not bundle.total_length:
        return unloaded
    apart = unloaded - bundle.softened(force, pairs=False)
    together = 1 - bundle.softened(force, pairs=True)
    return min(unloaded, max(apart, together))
