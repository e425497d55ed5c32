"""From the tip to the base: the initial-value problem whose solution at the plate are the joint rotations.

At the tip all torsion is 0, so the rotations of the tube tips fix everything: alpha = theta(0) - |beta| theta'(0) is a
function of the tip angles. Every equilibrium is a preimage of the joint rotations, which makes the search for all of
them finite: turning all tips turns all joints, and turning one tip by a whole turn turns its joint by one.
"""

from __future__ import annotations

import numpy as np

from ..robots.assembly import Array
from ..transcription.buffered import section_function
from ..transcription.reduced import Index, ReducedProblem

CHUNK = 512
"""Tip angles integrated at once."""

STEPS = 8
"""Steps of the integration per piece of the mesh: errors near 1e-6 rad, so that Newton's method finishes the work."""


def to_base(problem: ReducedProblem, tips: Array) -> Array:
    """Joint rotations (B, n) of tip angles (B, n)."""
    return np.concatenate([_integrate(problem, part)[0] for part in _chunks(tips)])[: len(tips)]


def relative(angles: Array, free: Index) -> Array:
    """(B, d) angles (B, n) of the tubes `free` but the last, relative to that."""
    return angles[:, free[:-1]] - angles[:, free[-1:]]


def relative_joints(problem: ReducedProblem, free: Index, tips: Array) -> Array:
    """(B, d) joint rotations of tip angles (B, n), relative to that of the last of the tubes `free`."""
    return relative(to_base(problem, tips), free)


def relative_slope(problem: ReducedProblem, free: Index, tips: Array) -> Array:
    """(B, d, d) derivatives of the relative joint rotations with respect to the relative tip angles."""
    epsilon = 1e-5
    columns = []
    for tube in free[:-1]:
        moved = np.repeat(tips[None], 2, axis=0)
        moved[0, :, tube] += epsilon
        moved[1, :, tube] -= epsilon
        forward, backward = (relative_joints(problem, free, side) for side in moved)
        columns.append((forward - backward) / (2 * epsilon))
    return np.stack(columns, axis=2)


def profiles(problem: ReducedProblem, tips: Array) -> Array:
    """theta (B, N, n) at the collocation points, for tip angles (B, n)."""
    return np.concatenate([_integrate(problem, part)[1] for part in _chunks(tips)])[: len(tips)]


def _chunks(tips: Array) -> list[Array]:
    """Equal chunks, the last one padded: the functions are bound to one number of points."""
    size = CHUNK if len(tips) > CHUNK // 8 else CHUNK // 8
    missing = -len(tips) % size
    padded = np.concatenate([tips, np.repeat(tips[-1:], missing, axis=0)])
    return np.split(padded, len(padded) // size)


def _integrate(problem: ReducedProblem, tips: Array) -> tuple[Array, Array]:
    """Joint rotations (B, n) and theta (B, N, n): Nystrom's method of order 4 for theta'' = M / kt, from the tip."""
    mesh, assembly = problem.mesh, problem.assembly
    count, n = tips.shape
    theta, twist = tips.copy(), np.zeros_like(tips)
    nodes, degree = mesh.tableau.nodes, mesh.tableau.degree
    out = np.empty((count, len(problem.weight), n))
    at = len(problem.weight)
    function = section_function("moment", count, n, False)
    for p in range(len(mesh.length) - 1, -1, -1):
        if not mesh.collocated[p]:
            theta = theta - mesh.length[p] * twist
            continue
        h = mesh.length[p] / STEPS
        stiffness, pull = problem.piece_stiffness[p], problem.piece_moment[p]

        def bend(angle: Array, stiffness: Array = stiffness, pull: Array = pull) -> Array:
            return function(angle, stiffness, pull)[0] / assembly.torsional_stiffness

        grid = [(theta, twist)]
        for _ in range(STEPS):
            k1 = bend(theta)
            k2 = bend(theta - h / 2 * twist + h**2 / 8 * k1)
            k3 = bend(theta - h * twist + h**2 / 2 * k2)
            theta = theta - h * twist + h**2 / 6 * (k1 + 2 * k2)
            twist = twist - h / 6 * (k1 + 4 * k2 + k3)
            grid.append((theta, twist))
        at -= degree
        out[:, at : at + degree] = _hermite(grid, nodes, h)
    return theta - assembly.transmission * twist, out


def _hermite(grid: list[tuple[Array, Array]], nodes: Array, h: float) -> Array:
    """(B, K, n) cubic interpolation, at fractions `nodes` from the base side, of a grid that runs from the tip side."""
    back = (1 - nodes) * (len(grid) - 1)
    k = np.minimum(back.astype(int), len(grid) - 2)
    x = (back - k)[None, :, None]
    value, slope = (np.stack([state[j] for state in grid], axis=1) for j in range(2))
    slope = -h * slope
    left, right = value[:, k], value[:, k + 1]
    blend = left * (1 + 2 * x) * (1 - x) ** 2 + right * x**2 * (3 - 2 * x)
    return np.asarray(blend + slope[:, k] * x * (1 - x) ** 2 - slope[:, k + 1] * x**2 * (1 - x))
