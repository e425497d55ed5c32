"""Shooting from the tip to the plate: joint rotations as a function of the tip angles.

At the tips the torsion is 0, so that the tip angles determine theta(s) as an initial-value problem, and with it the
joint rotations alpha = theta(0) - |beta| t(0) / kt. Every equilibrium is a preimage of the joint rotations. One turn of
each tip is enough: turning one tip once turns its joint once, and on the centreline turning all tips alike turns all
joints. The derivatives of the joints with respect to the tips are integrated as well (the Jacobi equation); where their
determinant vanishes the equilibrium is a fold.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ..block.transcription.arm import cubic
from ..block.transcription.buffered import mapped
from ..block.transcription.explicit import march_function
from ..block.transcription.mesh import reach, sections_at
from ..block.transcription.reduced import ReducedProblem
from ..solvers.time_limit import check_time
from ..typing import Array, Index, Mask

CHUNKS = (512, 64, 8)
"""Numbers of tip angles integrated at once; the largest that needs at most half padding is used."""

STEPS_PER_ELEMENT = 8
"""Steps of the integration per element of the mesh: errors near 1e-6 rad, so that Newton's method finishes the work."""

State = tuple[Array, ...]
"""State (theta, torque, length) of every tube at an arc length, (B, n) each.

With `slopes` also the derivatives (B, n, n) of theta and of the torque by the tip angles.
"""

Grid = tuple[Array, Array]
"""Rotations theta and torsion theta' (B, K, n) at points from the tip side of an element to its base side."""

GRID = np.arange(2 * STEPS_PER_ELEMENT + 1) / (2 * STEPS_PER_ELEMENT)
"""Fractions of an element for the cross-sections of the steps."""


@lru_cache(maxsize=16)
def sections_of(problem: ReducedProblem) -> tuple[Array, ...]:
    """Arrays 1 / kt, kb and m (P, n) of the tubes on the elements of the mesh.

    For tubes made of pieces also the phase, all (P, X, n) at GRID.
    """
    mesh, n = problem.mesh, problem.assembly.n_tubes
    if problem.assembly.even:
        return problem.compliant.rate[:, 0], *problem.on_elements
    at = sections_at(problem.assembly, mesh, GRID)
    table = 1 / at.torsional_stiffness, at.stiffness, at.moment, at.phase
    return tuple(part.reshape(len(mesh.length), len(GRID), n) for part in table)


@dataclass(frozen=True, eq=False)
class ShootingArm:
    """Tubes to integrate together over P elements, base to tip.

    For tubes with a natural twist theta is the elastic rotation phi.
    """

    length: Array
    """(P,) lengths of the elements, m."""
    bent: Mask
    """(P,) True where tubes act on one another, so that theta is not linear."""
    gain: Array
    """(P, n) compliances int ds / kt along each element, 1/(N m)."""
    sections: tuple[Array, ...]
    """Cross-sections as in `sections_of`: kb of the tubes present, m of those curved."""
    transmission: Array
    """(n,) compliances int ds / kt from the clamped end to the first element, 1/(N m)."""
    offsets: tuple[Array, ...]
    """Offset and offset angle (n,); empty for concentric tubes."""

    @property
    def varying(self) -> bool:
        """True with tubes made of pieces."""
        return self.sections[0].ndim == 3

    @property
    def n_tubes(self) -> int:
        """Number of tubes n."""
        return len(self.transmission)


@dataclass(frozen=True, eq=False)
class Shot:
    """Solution at the clamped ends for B tip angles."""

    rotations: Array
    """(B, n) joint rotations, rad."""
    torque: Array
    """(B, n) torques at the plate, N m."""
    by_tip: Array
    """(B, n, n) derivatives of the joint rotations with respect to the tip angles; (B, 0, 0) without `slopes`."""
    travel: Array
    """(B, n) length of every tube along the elements, m."""


def all_tubes(problem: ReducedProblem) -> ShootingArm:
    """Tubes of a problem on all elements of its mesh."""
    assembly, mesh = problem.assembly, problem.mesh
    return ShootingArm(
        length=mesh.length,
        bent=mesh.collocated,
        gain=gain_of(problem),
        sections=sections_of(problem),
        transmission=problem.compliant.transmission,
        offsets=assembly.offsets,
    )


def gain_of(problem: ReducedProblem) -> Array:
    """(P, n) compliances int ds / kt of the tubes along each element, 1/(N m)."""
    return np.diff(reach(problem.mesh, problem.compliant), axis=0)


def shoot(bundle: ShootingArm, tips: Array, *, steps: int = STEPS_PER_ELEMENT, slopes: bool = False) -> Shot:
    """Joint rotations for tip angles (B, k) of the first k tubes; the other tubes have tip angle 0 and no rotation.

    Args:
        steps: integration steps per element.   slopes: whether to integrate the derivatives.
    """
    k = tips.shape[1]
    padded = np.pad(tips, ((0, 0), (0, bundle.n_tubes - k)))
    shots = [_shoot(bundle, part, steps, slopes) for part in _chunks(padded)]
    rotations, torque, travel, *by_tip = (np.concatenate(column)[: len(tips)] for column in zip(*shots, strict=True))
    slope = by_tip[0][:, :k, :k] if slopes else np.empty((len(tips), 0, 0))
    return Shot(rotations[:, :k], torque[:, :k], slope, travel)


def to_base(problem: ReducedProblem, tips: Array) -> Array:
    """(B, n) joint rotations at tip angles (B, n)."""
    return shoot(all_tubes(problem), tips).rotations


def relative(angles: Array, free: Index) -> Array:
    """(B, d) angles of the tubes `free` relative to the last of them, from angles (B, n) of all tubes."""
    return angles[:, free[:-1]] - angles[:, free[-1:]]


def relative_joints(problem: ReducedProblem, free: Index, tips: Array) -> tuple[Array, Array]:
    """(B, d) joint rotations at tip angles (B, n), relative to the last of the tubes `free`, and their derivatives.

    Derivatives (B, d, d) are with respect to the relative tip angles.
    """
    shot, i = shoot(all_tubes(problem), tips, slopes=True), free[:-1]
    return relative(shot.rotations, free), shot.by_tip[:, i[:, None], i] - shot.by_tip[:, free[-1:, None], i]


def profiles(problem: ReducedProblem, tips: Array) -> Array:
    """(B, N, n) rotations theta at the collocation points for tip angles (B, n), rad."""
    bundle = all_tubes(problem)
    return np.concatenate([_profiles(problem, bundle, part) for part in _chunks(tips)])[: len(tips)]


def _chunks(tips: Array) -> list[Array]:
    """Tip angles in chunks of equal size, the last one padded: compiled functions take a fixed number of points."""
    size = next((size for size in CHUNKS if len(tips) > size // 2), CHUNKS[-1])
    missing = -len(tips) % size
    padded = np.concatenate([tips, np.repeat(tips[-1:], missing, axis=0)])
    return np.split(padded, len(padded) // size)


def _shoot(bundle: ShootingArm, tips: Array, steps: int, slopes: bool) -> State:
    """Rotations, torques and travel at the clamped ends and, with `slopes`, the derivatives of the rotations."""
    check_time()
    state = _at_tip(tips, slopes)
    for element in reversed(range(len(bundle.length))):
        state, _ = _over(bundle, element, steps, state)
    # Behind the plate the torque is constant: alpha = theta(0) - t(0) int ds / kt.
    gain = bundle.transmission
    shot = (state[0] - gain * state[1], state[1], state[2])
    return (*shot, state[3] - gain[:, None] * state[4]) if slopes else shot


def _profiles(problem: ReducedProblem, bundle: ShootingArm, tips: Array) -> Array:
    """(B, N, n) rotations theta at the collocation points, rad, for one chunk of tip angles."""
    mesh = problem.mesh
    nodes, degree = mesh.tableau.nodes, mesh.tableau.degree
    out = np.empty((len(tips), len(problem.weight), tips.shape[1]))
    at = len(problem.weight)
    state = _at_tip(tips, False)
    for element in reversed(range(len(mesh.length))):
        state, grid = _over(bundle, element, STEPS_PER_ELEMENT, state)
        if mesh.collocated[element]:
            at -= degree
            out[:, at : at + degree] = _hermite(grid, nodes, mesh.length[element] / STEPS_PER_ELEMENT)
    return out


def _at_tip(tips: Array, slopes: bool) -> State:
    """State at the tip, without torque and with unit derivatives."""
    count, n = tips.shape
    state = (tips, np.zeros_like(tips), np.zeros_like(tips))
    return (*state, np.tile(np.eye(n), (count, 1, 1)), np.zeros((count, n, n))) if slopes else state


def _over(bundle: ShootingArm, element: int, steps: int, state: State) -> tuple[State, Grid]:
    """State at the base side of an element, and theta and theta' at the ends of its steps."""
    if not bundle.bent[element]:
        return _straight(bundle, element, state)
    count, n = state[0].shape
    march = mapped(march_function(n, bool(bundle.offsets), len(state) > 3, steps, bundle.varying), count)
    # CasADi stores matrices by columns: derivatives (B, n, n) are (B n, n) there, one row per tip.
    columns = [part.swapaxes(1, 2).reshape(-1, n) for part in state[3:]]
    sections = [
        part[element, :: STEPS_PER_ELEMENT // steps].ravel() if bundle.varying else part[element]
        for part in bundle.sections
    ]
    *after, values, slopes = march(*state[:3], *columns, bundle.length[element] / steps, *sections, *bundle.offsets)
    moved = [part.copy() for part in after[:3]]
    moved += [part.reshape(count, n, n).swapaxes(1, 2).copy() for part in after[3:]]
    return tuple(moved), (values.reshape(count, -1, n), slopes.reshape(count, -1, n))


def _straight(bundle: ShootingArm, element: int, state: State) -> tuple[State, Grid]:
    """State at the base side of an element with constant torque, and theta and theta' at both ends of it."""
    theta, torque, travel, *slopes = state
    gain, length = bundle.gain[element], bundle.length[element]
    moved = [theta - gain * torque, torque, travel + length]
    if slopes:
        moved += [slopes[0] - gain[:, None] * slopes[1], slopes[1]]
    rate = np.repeat((gain / length * torque)[:, None], 2, axis=1)
    return tuple(moved), (np.stack([theta, moved[0]], axis=1), rate)


def _hermite(grid: Grid, nodes: Array, h: float) -> Array:
    """(B, K, n) cubic interpolation at fractions `nodes` from the base side of a grid that runs from the tip side."""
    value, slope = grid
    back = (1 - nodes) * (value.shape[1] - 1)
    k = np.minimum(back.astype(int), value.shape[1] - 2)
    x = (back - k)[None, :, None]
    return np.asarray(cubic(value[:, k], value[:, k + 1], slope[:, k], slope[:, k + 1], x, -h))
