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
from ..physics.certificate import bend_rate_function, worst_function
from ..robots.assembly import Assembly
from ..typing import Array

CELLS = 96
"""Cells of an arm: M is too large by 1/2 of 1/CELLS of its largest value, on average."""

ENCLOSED = 1e-10
"""Relative width to which the eigenvalue is enclosed, from above."""


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
    apart = unloaded - largest_eigenvalue(cells_of(assembly, force, pairs=False))
    together = 1 - largest_eigenvalue(cells_of(assembly, force, pairs=True))
    return min(unloaded, max(apart, together))


def cells_of(assembly: Assembly, force: float, *, pairs: bool) -> Cells:
    """Coefficients no smaller than those of an arm; without `pairs` of the part of N by the force alone."""
    total = assembly.total_length
    counts = np.maximum(1, np.ceil(CELLS * assembly.length / total)).astype(int)
    section = np.repeat(np.arange(assembly.n_sections), counts)
    length = (assembly.length / counts)[section]
    present = assembly.bending_stiffness * assembly.present
    moment = assembly.bending_stiffness * assembly.curvature * assembly.curved
    n, sections = assembly.n_tubes, assembly.n_sections
    slope = mapped(bend_rate_function(n), sections)(present, moment)[0][section]
    # The moment is largest where a cell begins.
    lever = total - (np.cumsum(length) - length)
    coupling = np.eye(n) * (force * lever[:, None] * slope)[:, None, :]
    if pairs:
        worst = mapped(worst_function(n), sections)(present, moment, np.zeros_like(moment))
        both = worst[3].reshape(-1, n, n)[section]
        coupling = coupling + both + np.eye(n) * both.sum(2)[:, None, :]
    return Cells(
        length, present.sum(1)[section], slope, coupling, assembly.torsional_stiffness, assembly.transmission, force
    )


def largest_eigenvalue(cells: Cells) -> float:
    """An upper bound, within ENCLOSED, of the largest eigenvalue of N relative to T."""
    low, high = 0.0, 1.0
    while not positive(cells, high):
        low, high = high, 4 * high
    while high - low > ENCLOSED * max(1.0, high):
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
