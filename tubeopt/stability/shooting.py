"""From the tip to the base: the initial-value problem whose solution at the plate are the joint rotations.

At the tip all torsion is 0, so the rotations of the tube tips fix everything: alpha = theta(0) - |beta| w(0) is a
function of the tip angles. Every equilibrium is a preimage of the joint rotations, which makes the search for all of
them finite: turning one tip by a whole turn turns its joint by one, and on the centreline turning all tips turns all
joints. The derivatives of the joints by the tips are integrated along, from those of the cross-section.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ..block.transcription.buffered import mapped, section_function
from ..block.transcription.green import reach, sections_at
from ..block.transcription.march import march_function
from ..block.transcription.reduced import ReducedProblem
from ..typing import Array, Index, Mask

CHUNKS = (512, 64, 8)
"""Tip angles integrated at once: the largest that is at most half padding."""

STEPS = 8
"""Steps of the integration per piece of the mesh: errors near 1e-6 rad, so that Newton's method finishes the work."""

State = tuple[Array, ...]
"""theta and w (B, n), the length of every tube so far (B, n); where they are wanted, the derivatives (B, n, n) of theta
and w by the tip angles."""

Grid = tuple[Array, Array]
"""theta and theta' (B, K, n) at places from the tip side of a piece to its base side."""

GRID = np.arange(2 * STEPS + 1) / (2 * STEPS)
"""Fractions of a piece at which the steps look at its cross-sections."""


@dataclass(frozen=True, eq=False)
class Along:
    """Tubes made of pieces at X places of P pieces, (P, X, n): kb, m, phase, 1 / kt; `whole` (P, n): int ds / kt."""

    stiffness: Array
    moment: Array
    phase: Array
    compliance: Array
    whole: Array

    def of(self, pieces: Index, tubes: Index) -> Along:
        """Some tubes on some pieces."""
        own = np.ix_(pieces, np.arange(len(GRID)), tubes)
        kb, m, phase, soft = (part[own] for part in (self.stiffness, self.moment, self.phase, self.compliance))
        return Along(kb, m, phase, soft, self.whole[np.ix_(pieces, tubes)])


@lru_cache(maxsize=16)
def along_of(problem: ReducedProblem) -> Along | None:
    """The tubes of a problem at GRID of all its pieces; None where none is made of pieces."""
    mesh, here = problem.mesh, problem.here
    if here is None:
        return None
    at = sections_at(problem.assembly, mesh, GRID)
    shape = len(mesh.length), len(GRID), problem.assembly.n_tubes
    table = (at.stiffness, at.moment, at.phase, 1 / at.torsional_stiffness)
    kb, m, phase, soft = (part.reshape(shape) for part in table)
    return Along(kb, m, phase, soft, np.diff(reach(mesh, here), axis=0))


@dataclass(frozen=True, eq=False)
class Bundle:
    """Tubes that are integrated together, on P pieces, base to tip.

    length: (P,) m.  bent: (P,) whether torsion is not linear there.  stiffness, moment: (P, n) kb_i of the tubes
    present and m_i of the tubes curved.  torsional_stiffness, transmission: (n,), the latter m between where a tube is
    held and the first piece.  place: offset and angle (n,), or nothing for concentric tubes.

    With tubes made of pieces theta is the elastic phi, w the torque, `transmission` the compliance int ds / kt up to
    the first piece, and `along` has the cross-sections at GRID of every piece; stiffness, moment and
    torsional_stiffness are not read.
    """

    length: Array
    bent: Mask
    stiffness: Array
    moment: Array
    torsional_stiffness: Array
    transmission: Array
    place: tuple[Array, ...]
    along: Along | None = None

    @property
    def n_tubes(self) -> int:
        """Number of tubes n."""
        return len(self.transmission)


@dataclass(frozen=True, eq=False)
class Shot:
    """Where tip angles lead: joint rotations and w there (B, n), the derivatives (B, n, n) of the rotations by the tip
    angles (B, 0, 0 where these were not asked for), and the length of every tube along the pieces (B, n), m."""

    rotations: Array
    twist: Array
    by_tip: Array
    travel: Array


def whole(problem: ReducedProblem) -> Bundle:
    """All tubes of a problem on all its pieces."""
    assembly, mesh = problem.assembly, problem.mesh
    return Bundle(
        length=mesh.length,
        bent=mesh.collocated,
        stiffness=problem.piece_stiffness,
        moment=problem.piece_moment,
        torsional_stiffness=assembly.torsional_stiffness,
        transmission=assembly.transmission if problem.here is None else problem.here.transmission,
        along=along_of(problem),
        place=(assembly.offset, assembly.offset_angle) if assembly.eccentric else (),
    )


def shoot(bundle: Bundle, tips: Array, *, steps: int = STEPS, slopes: bool = False) -> Shot:
    """Joint rotations of tip angles (B, n), with their derivatives if `slopes`."""
    shots = [_shoot(bundle, part, steps, slopes) for part in _chunks(tips)]
    columns = [np.concatenate(column)[: len(tips)] for column in zip(*shots, strict=True)]
    return Shot(columns[0], columns[1], columns[3] if slopes else np.empty((len(tips), 0, 0)), columns[2])


def to_base(problem: ReducedProblem, tips: Array) -> Array:
    """Joint rotations (B, n) of tip angles (B, n)."""
    return shoot(whole(problem), tips).rotations


def relative(angles: Array, free: Index) -> Array:
    """(B, d) angles (B, n) of the tubes `free` but the last, relative to that."""
    return angles[:, free[:-1]] - angles[:, free[-1:]]


def relative_joints(problem: ReducedProblem, free: Index, tips: Array) -> tuple[Array, Array]:
    """(B, d) joint rotations of tip angles (B, n), relative to that of the last of the tubes `free`, and their
    derivatives (B, d, d) by the relative tip angles."""
    shot, own = shoot(whole(problem), tips, slopes=True), free[:-1]
    return relative(shot.rotations, free), shot.by_tip[:, own[:, None], own] - shot.by_tip[:, free[-1:, None], own]


def profiles(problem: ReducedProblem, tips: Array) -> Array:
    """theta (B, N, n) at the collocation points, for tip angles (B, n)."""
    bundle = whole(problem)
    return np.concatenate([_profiles(problem, bundle, part) for part in _chunks(tips)])[: len(tips)]


def _chunks(tips: Array) -> list[Array]:
    """Equal chunks, the last one padded: the functions are bound to one number of points."""
    size = next((size for size in CHUNKS if len(tips) > size // 2), CHUNKS[-1])
    missing = -len(tips) % size
    padded = np.concatenate([tips, np.repeat(tips[-1:], missing, axis=0)])
    return np.split(padded, len(padded) // size)


def _shoot(bundle: Bundle, tips: Array, steps: int, slopes: bool) -> State:
    """Rotations, w, travel and, if `slopes`, the derivatives of the rotations."""
    state = _at_tip(tips, slopes)
    for piece in reversed(range(len(bundle.length))):
        state, _ = _over(bundle, piece, steps, state)
    held = bundle.transmission
    shot = (state[0] - held * state[1], state[1], state[2])
    return (*shot, state[3] - held[:, None] * state[4]) if slopes else shot


def _profiles(problem: ReducedProblem, bundle: Bundle, tips: Array) -> Array:
    mesh = problem.mesh
    nodes, degree = mesh.tableau.nodes, mesh.tableau.degree
    out = np.empty((len(tips), len(problem.weight), tips.shape[1]))
    at = len(problem.weight)
    state = _at_tip(tips, False)
    for piece in reversed(range(len(mesh.length))):
        state, grid = _over(bundle, piece, STEPS, state)
        if mesh.collocated[piece]:
            at -= degree
            out[:, at : at + degree] = _hermite(grid, nodes, mesh.length[piece] / STEPS)
    return out


def _at_tip(tips: Array, slopes: bool) -> State:
    count, n = tips.shape
    state = (tips, np.zeros_like(tips), np.zeros_like(tips))
    return (*state, np.tile(np.eye(n), (count, 1, 1)), np.zeros((count, n, n))) if slopes else state


def _over(bundle: Bundle, piece: int, steps: int, state: State) -> tuple[State, Grid]:
    """The state at the base side of a piece, and theta and theta' where its steps begin and end."""
    if not bundle.bent[piece]:
        return _straight(bundle, piece, state)
    if bundle.along is not None:
        return _along(bundle.along, piece, bundle.length[piece] / steps, state, steps)
    count, n = state[0].shape
    march = mapped(march_function(n, bool(bundle.place), len(state) > 3, steps), count)
    # CasADi has matrices by columns: derivatives (B, n, n) are (B n, n) there, those by one tip in a row.
    columns = [part.swapaxes(1, 2).reshape(-1, n) for part in state[3:]]
    constants = bundle.torsional_stiffness, bundle.stiffness[piece], bundle.moment[piece], *bundle.place
    *after, values, slopes = march(*state[:3], *columns, bundle.length[piece] / steps, *constants)
    moved = [part.copy() for part in after[:3]]
    moved += [part.reshape(count, n, n).swapaxes(1, 2).copy() for part in after[3:]]
    return tuple(moved), (values.reshape(count, -1, n), slopes.reshape(count, -1, n))


def _straight(bundle: Bundle, piece: int, state: State) -> tuple[State, Grid]:
    """The same of a piece where torsion is linear."""
    theta, twist, travel, *slopes = state
    n, along = bundle.n_tubes, bundle.along
    gain = np.full(n, bundle.length[piece]) if along is None else along.whole[piece]
    moved = [theta - gain * twist, twist, travel + bundle.length[piece]]
    if slopes:
        moved += [slopes[0] - gain[:, None] * slopes[1], slopes[1]]
    return tuple(moved), (np.stack([theta, moved[0]], axis=1), np.stack([twist, twist], axis=1))


def _along(along: Along, piece: int, h: float, state: State, steps: int) -> tuple[State, Grid]:
    """The same of tubes made of pieces, whose cross-sections change along it: phi and torque for theta and w."""
    values, slopes = [state[0]], []
    for k in reversed(range(steps)):
        low, middle, high = (k * STEPS // steps for k in (2 * k, 2 * k + 1, 2 * k + 2))
        k1 = _rate(along, piece, high, state)
        k2 = _rate(along, piece, middle, _back(state, h / 2, k1))
        k3 = _rate(along, piece, middle, _back(state, h / 2, k2))
        k4 = _rate(along, piece, low, _back(state, h, k3))
        state = _back(state, h, tuple((a + 2 * (b + c) + d) / 6 for a, b, c, d in zip(k1, k2, k3, k4, strict=True)))
        values.append(state[0])
        slopes.append(k1[0])
    slopes.append(_rate(along, piece, 0, state)[0])
    return state, (np.stack(values, axis=1), np.stack(slopes, axis=1))


def _back(state: State, h: float, rate: State) -> State:
    """The state h nearer to the base; lengths add up on the way."""
    moved = [value - h * slope for value, slope in zip(state, rate, strict=True)]
    moved[2] = state[2] + h * rate[2]
    return tuple(moved)


def _rate(along: Along, piece: int, at: int, state: State) -> State:
    """Derivatives of the elastic rotation and the torque of tubes made of pieces, at the place `at` of GRID."""
    phi, torque = state[:2]
    count, n = phi.shape
    soft = along.compliance[piece, at]
    function = section_function("balance" if len(state) > 3 else "moment", count, n, False)
    out = function(phi + along.phase[piece, at], along.stiffness[piece, at], along.moment[piece, at])
    turned, bend, one = soft * torque, out[0].copy(), np.ones_like(phi)
    if len(state) == 3:
        return turned, bend, one
    stiff = out[1].reshape(count, n, n).swapaxes(1, 2)
    return turned, bend, one, soft[:, None] * state[4], stiff @ state[3]


def _hermite(grid: Grid, nodes: Array, h: float) -> Array:
    """(B, K, n) cubic interpolation, at fractions `nodes` from the base side, of a grid that runs from the tip side."""
    value, slope = grid[0], -h * grid[1]
    back = (1 - nodes) * (value.shape[1] - 1)
    k = np.minimum(back.astype(int), value.shape[1] - 2)
    x = (back - k)[None, :, None]
    left, right = value[:, k], value[:, k + 1]
    blend = left * (1 + 2 * x) * (1 - x) ** 2 + right * x**2 * (3 - 2 * x)
    return np.asarray(blend + slope[:, k] * x * (1 - x) ** 2 - slope[:, k + 1] * x**2 * (1 - x))
