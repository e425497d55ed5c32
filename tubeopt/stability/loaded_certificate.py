"""Whether a robot can snap or buckle whatever pushes at its tip: a bound of the margin for all rotations and forces.

In rotations theta and bending w = u - u0(theta) every configuration is a point of one vector space, and the second
variation of the potential energy at any of them, in the directions y and r of the two, is (see docs/loads.md)

    Q = T + int y'V''y + sum_i (m.a_i / K) y_i^2 - m_w.(psi x psi') - (n.psi)(t.psi) + (n.t) |psi|^2,
    T = int sum kt y'^2 + K |r|^2 + springs,        psi' = R (u0' y + r),  psi(0) = 0.

With |n| <= F, |m_w(s)| <= M(s) = F (L - s) and A_i = |a_i| / K, for every rotation and every direction of the force,

    Q >= T - N,    N = int sum_pairs |c_ij| (Y_i + Y_j)^2 + sum_i M A_i Y_i^2 + 3/2 F phi^2,
    Y_i = |y_i|,   phi' = sum A_i Y_i + |r|,   phi(0) = 0,

so that 1 less the largest eigenvalue of N relative to T bounds the margin. That eigenvalue is enclosed from above: on
cells where the coefficients are constant (M is taken at its largest) the least value of lambda T - N between given ends
is a quadratic form of them, exact by a matrix exponential, and lambda is large enough if and only if their sum over all
cells is positive (dynamic stiffness; Wittrick and Williams, Quart. J. Mech. Appl. Math. 24 (1971)).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from ..block.transcription.buffered import mapped
from ..physics.certificate import opposing_function
from ..robots.assembly import Assembly, merge
from ..robots.robot import Robot
from ..typing import Array

CELLS = 96
"""Cells of an arm: M is too large by 1/2 of 1/CELLS of its largest value, on average."""

ENCLOSED = 1e-10
"""Relative width to which the eigenvalue is enclosed, from above."""


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


def bundle_of(assembly: Assembly) -> Bundle:
    """An arm itself."""
    return Bundle(
        assembly.start,
        assembly.length,
        (assembly.bending_stiffness * assembly.present).sum(1),
        np.abs(assembly.bending_stiffness * assembly.curvature * assembly.curved),
        assembly.torsional_stiffness,
        assembly.transmission,
    )


def bundle_of_box(robot: Robot, low: Array, high: Array) -> Bundle:
    """No stiffer than the arm at any translations between `low` and `high` (n,): its bounds hold for all of them.

    A tube counts as curved where it may be, as stiff in bending only where it surely is, its transmission as long and
    the arm as long as they may be. Fields Y, phi, r of an arm between, with Y constant and r 0 beyond its ends, have no
    larger T there and no smaller N.
    """
    near, far = robot.assembly(low), robot.assembly(high)
    kb, ends = near.bending_stiffness, np.maximum(np.stack([near.end, far.end]), 0.0)
    transition = np.maximum(np.stack([near.transition, far.transition]), 0.0)
    cuts = merge(np.concatenate([[0.0], ends.ravel(), transition.ravel()]))
    start, length = cuts[:-1], np.diff(cuts)
    s = (start + length / 2)[:, None]
    surely, maybe = s < ends.min(0), s < ends.max(0)
    # Beyond the last end that is sure, some tube is there wherever there is an arm.
    least = np.where(maybe, kb, np.inf).min(1)
    curved = maybe & (s > transition.min(0))
    return Bundle(
        start,
        length,
        np.maximum((kb * surely).sum(1), least),
        np.abs(kb * near.curvature) * curved,
        near.torsional_stiffness,
        np.maximum(near.transmission, far.transmission),
    )


@dataclass(frozen=True, eq=False)
class Cells:
    """Constant coefficients on C cells, plate to tip; n tubes.

    length (C,), stiffness (C,) K, slope (C, n) A, coupling (C, n, n) matrix of the part of N in Y; torsional (n,) kt,
    transmission (n,), force: F.
    """

    length: Array
    stiffness: Array
    slope: Array
    coupling: Array
    torsional: Array
    transmission: Array
    force: float


def loaded_worst_case(assembly: Assembly, unloaded: float, force: float) -> float:
    """A lower bound of the margin for all rotations and all dead tip forces of at most `force`, N; `unloaded` is that
    without force.

    Of two bounds the larger: that of above, and the unloaded one less the eigenvalue of the parts of N by the force
    alone, since a least value of a sum is at least the sum of the least values. The second is the sharper one for weak
    forces on three or more tubes, which cannot oppose one another pairwise as N has it.
    """
    if not force or not assembly.total_length:
        return unloaded
    bundle = bundle_of(assembly)
    apart = unloaded - largest_eigenvalue(cells_of(bundle, force, pairs=False))
    together = 1 - largest_eigenvalue(cells_of(bundle, force, pairs=True))
    return min(unloaded, max(apart, together))


def cells_of(bundle: Bundle, force: float, *, pairs: bool) -> Cells:
    """Coefficients no smaller than those of an arm; without `pairs` of the part of N by the force alone."""
    total = bundle.total_length
    counts = np.maximum(1, np.ceil(CELLS * bundle.length / total)).astype(int)
    section = np.repeat(np.arange(len(bundle.start)), counts)
    length = (bundle.length / counts)[section]
    stiffness, pull = bundle.stiffness[section], bundle.pull[section]
    slope = pull / stiffness[:, None]
    # The moment is largest where a cell begins.
    lever = total - (np.cumsum(length) - length)
    n = len(bundle.torsional)
    coupling = np.eye(n) * (force * lever[:, None] * slope)[:, None, :]
    if pairs:
        both = mapped(opposing_function(n), len(section))(stiffness[:, None], pull)[0]
        coupling = coupling + both.reshape(-1, n, n)
    return Cells(length, stiffness, slope, coupling, bundle.torsional, bundle.transmission, force)


def largest_eigenvalue(cells: Cells, *, within: float = ENCLOSED) -> float:
    """An upper bound, to a relative width, of the largest eigenvalue of N relative to T."""
    low, high = 0.0, 1.0
    while not positive(cells, high):
        low, high = high, 4 * high
    while high - low > within * max(1.0, high):
        middle = (low + high) / 2
        if positive(cells, middle):
            high = middle
        else:
            low = middle
    return high


def positive(cells: Cells, eigenvalue: float) -> bool:
    """Whether eigenvalue T - N is positive for all Y, phi, r; False also where cells are too long to tell."""
    if not _short_enough(cells, eigenvalue):
        return False
    count, n = cells.slope.shape
    m = n + 1
    near, far, between = _stiffness(cells, eigenvalue)
    matrix = np.zeros(((count + 1) * m, (count + 1) * m))
    for k in range(count):
        here, there = slice(k * m, (k + 1) * m), slice((k + 1) * m, (k + 2) * m)
        matrix[here, here] += near[k]
        matrix[there, there] += far[k]
        matrix[there, here] += between[k].T
    # At the plate phi is 0, and Y is held by the transmissions: by no give at all where they have no length.
    spring = eigenvalue * cells.torsional / np.maximum(cells.transmission, 1e-12)
    matrix[np.arange(n), np.arange(n)] += spring
    kept = np.delete(np.arange(len(matrix)), n)
    return bool(scipy.linalg.lapack.dpotrf(matrix[np.ix_(kept, kept)], lower=1)[1] == 0)


def _stiffness(cells: Cells, eigenvalue: float) -> tuple[Array, Array, Array]:
    """Blocks (C, n + 1, n + 1) of the least value of a cell in (Y, phi) at its two ends: near, far, and mixed."""
    count, n = cells.slope.shape
    m = n + 1
    # (Y, phi)' = a (Y, phi) + b p,  p' = g (Y, phi) - a' p,  with momenta p of eigenvalue T.
    flow = np.zeros((count, 2 * m, 2 * m))
    flow[:, n, :n] = cells.slope
    flow[:, np.arange(n), m + np.arange(n)] = 1 / (eigenvalue * cells.torsional)
    flow[:, n, m + n] = 1 / (eigenvalue * cells.stiffness)
    flow[:, m : m + n, :n] = -cells.coupling
    flow[:, m + n, n] = -1.5 * cells.force
    flow[:, m:, m:] = -flow[:, :m, :m].swapaxes(1, 2)
    across = scipy.linalg.expm(flow * cells.length[:, None, None])
    inverse = np.linalg.inv(across[:, :m, m:])
    near, far = inverse @ across[:, :m, :m], across[:, m:, m:] @ inverse
    return (near + near.swapaxes(1, 2)) / 2, (far + far.swapaxes(1, 2)) / 2, -inverse


def _short_enough(cells: Cells, eigenvalue: float) -> bool:
    """Whether eigenvalue T - N is positive in every cell for functions that vanish at its ends, of which
    int f^2 <= (h / pi)^2 int f'^2."""
    h = (cells.length / np.pi) ** 2
    across = np.linalg.norm(cells.coupling, 2, axis=(1, 2)) + 3 * cells.force * h * (cells.slope**2).sum(1)
    torsion = eigenvalue * cells.torsional.min() > across * h
    return bool((torsion & (eigenvalue * cells.stiffness > 3 * cells.force * h)).all())
