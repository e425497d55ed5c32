"""The model that judges answers: concentric tubes written out in NumPy, with nothing of tubeopt.

The angles z of the tubes at their own ends, where torsion vanishes, and the places beta at which they are held tell
one equilibrium: from the tip the equations are integrated to the plate (Runge and Kutta, fourth order), where the joint
rotations follow. No equation is solved, so an equilibrium cannot be mistaken for another. Jacobi fields Y are
integrated beside it: at the plate they give how the rotations change with z, and by the determinants of both whether
the equilibrium is stable. SI units; B states of n tubes at a time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

STEPS = 16
"""Of Runge and Kutta in every section."""

BETWEEN = np.array([0.25, 0.5, 0.75])
"""Of every step, where the arm is looked at beside its ends."""

BISECTIONS = 14
"""By which the margin is found: to 6e-5."""

MOST_TURN, MAX_SHIFT = 0.1, 3e-3
"""Largest change of a rotation (rad) and a translation (m) in one step along a motion."""

MAX_JUMP = 0.25
"""Largest distance (rad) of tip angles from what was foreseen, for a step that is taken."""

MIN_STEP = 1e-4
"""Share of the longest step below which the branch counts as ended: a snap."""


@dataclass(frozen=True, eq=False)
class Robot:
    """Tubes, inner to outer, (n,) each: diameters, lengths, m; curvature, 1/m; stiffnesses E I and G J, N m^2."""

    name: str
    outer_diameter: Array
    inner_diameter: Array
    straight_length: Array
    curved_length: Array
    curvature: Array
    bending_stiffness: Array
    torsional_stiffness: Array

    @property
    def n(self) -> int:
        """Number of tubes."""
        return len(self.curvature)

    @property
    def length(self) -> Array:
        """(n,) m."""
        return np.asarray(self.straight_length + self.curved_length)

    def order(self, beta: Array) -> Array:
        """(B,) least room (m) for places (B, n) at which tubes are held: carriages and ends in order, every tube from
        its whole length behind the plate to the plate itself."""
        ends = beta + self.length
        gaps = [np.diff(beta, axis=1), -np.diff(ends, axis=1), -beta, ends]
        return np.asarray(np.concatenate(gaps, axis=1).min(axis=1))


@dataclass(frozen=True, eq=False)
class Turned:
    """What tip angles ask of the joints: rotations (B, n) at the plate's joints, rad; whether the states are stable
    (B,); how the rotations change with the tip angles (B, n, n)."""

    rotations: Array
    stable: Mask
    slope: Array


@dataclass(frozen=True, eq=False)
class States(Turned):
    """The same with the arm at M places: points (B, M, 3), radius (B, M), m; its direction at the tip (B, 3)."""

    points: Array = field(repr=False)
    radius: Array = field(repr=False)
    direction: Array

    @property
    def tip(self) -> Array:
        """(B, 3) m."""
        return self.points[:, 0]


@dataclass(frozen=True, eq=False)
class _Section:
    """A stretch between breakpoints: (B,) step towards the plate; (B, n) EI of what is there, EI kappa of what is
    curved, 1 / GJ of what is there."""

    step: Array
    bending: Array
    pull: Array
    twist: Array

    def rates(self, state: tuple[Any, ...], scale: Any) -> tuple[Any, ...]:
        """Of theta, theta', Y, Y' along the arm, and of frame and place where the state has them."""
        theta, turn, fields, change, *arm = state
        a = self.pull * np.exp(1j * theta)
        whole = np.maximum(self.bending.sum(1), 1e-300)
        u = a.sum(1) / whole
        along = (np.conj(u)[:, None] * a).real
        stiff = -np.real(a[:, :, None] * np.conj(a)[:, None, :]) / whole[:, None, None]
        n = theta.shape[1]
        stiff[:, range(n), range(n)] += along
        bend = self.twist * (np.conj(u)[:, None] * a).imag
        reached = (self.twist > 0)[:, :, None]
        twisted = scale * self.twist[:, :, None] * (stiff @ fields)
        out = (turn * reached[:, :, 0], bend, change * reached, twisted)
        if not arm:
            return out
        # R' = R hat(u) with u_z = 0: the third column of hat(u) is (u_y, -u_x, 0).
        hat = np.zeros((len(u), 3, 3))
        hat[:, 0, 2], hat[:, 1, 2] = u.imag, -u.real
        hat[:, 2, 0], hat[:, 2, 1] = -u.imag, u.real
        return (*out, arm[0] @ hat, arm[0][:, :, 2])


def _sections(robot: Robot, beta: Array) -> list[_Section]:
    """From the tip to the plate, some of no length."""
    start = np.maximum(beta + robot.straight_length, 0.0)
    end = np.maximum(beta + robot.length, 0.0)
    cuts = np.sort(np.concatenate([np.zeros((len(beta), 1)), start, end], axis=1), axis=1)
    out = []
    for k in range(cuts.shape[1] - 1, 0, -1):
        middle = (cuts[:, k] + cuts[:, k - 1])[:, None] / 2
        reached = middle < end
        curved = reached & (middle > start)
        out.append(
            _Section(
                -(cuts[:, k] - cuts[:, k - 1]) / STEPS,
                reached * robot.bending_stiffness,
                curved * robot.bending_stiffness * robot.curvature,
                reached / robot.torsional_stiffness,
            )
        )
    return out


def integrate(robot: Robot, z: Array, beta: Array, scale: Array | float = 1.0) -> States:
    """States of tip angles (B, n), rad, and of tubes held at beta (B, n), m. `scale` (B,) of the elastic coupling of
    Jacobi fields: stable up to 1 / (1 - margin)."""
    frame = np.broadcast_to(np.eye(3), (len(z), 3, 3)).copy()
    stable, points, radii = np.ones(len(z), dtype=bool), [], []
    for section, before, state in _marched(robot, z, beta, scale, (frame, np.zeros((len(z), 3)))):
        stable &= np.linalg.det(state[2]) > 0
        radius = np.where(section.twist > 0, robot.outer_diameter / 2, 0.0).max(axis=1)
        between = [] if before is None else _between(before, state, section.step)
        points += [*between, state[5]]
        radii += [radius] * (len(between) + 1)
    plate = _at_plate(state, stable, beta)
    frame, position = state[4:]
    path = np.stack(points, axis=1) - position[:, None]
    return States(plate.rotations, plate.stable, plate.slope, path @ frame, np.stack(radii, axis=1), frame[:, 2])


def turned(robot: Robot, z: Array, beta: Array, scale: Array | float = 1.0) -> Turned:
    """The same without the arm, in half of the time."""
    stable = np.ones(len(z), dtype=bool)
    for _, _, state in _marched(robot, z, beta, scale):
        stable &= np.linalg.det(state[2]) > 0
    return _at_plate(state, stable, beta)


def _marched(
    robot: Robot, z: Array, beta: Array, scale: Array | float, arm: tuple[Array, ...] = ()
) -> Iterator[tuple[_Section, tuple[Any, ...] | None, tuple[Any, ...]]]:
    """All steps from the tip to the plate: the section, the state before a step, None where the section begins, and the
    state behind it. `arm`: frame and place at the tip, where they are wanted."""
    count, n = z.shape
    factor = np.broadcast_to(np.asarray(scale, dtype=float), (count,))[:, None, None]
    eye = np.broadcast_to(np.eye(n), (count, n, n)).copy()
    state: tuple[Any, ...] = (z.copy(), np.zeros((count, n)), eye, np.zeros_like(eye), *arm)
    for section in _sections(robot, beta):
        h = section.step
        yield section, None, state
        for _ in range(STEPS if arm or h.any() else 0):
            before = state
            k1 = section.rates(state, factor)
            k2 = section.rates(_moved(state, k1, h / 2), factor)
            k3 = section.rates(_moved(state, k2, h / 2), factor)
            k4 = section.rates(_moved(state, k3, h), factor)
            sums = tuple((a + 2 * b + 2 * c + d) / 6 for a, b, c, d in zip(k1, k2, k3, k4, strict=True))
            state = _moved(state, sums, h)
            yield section, before, state


def _at_plate(state: tuple[Any, ...], stable: Mask, beta: Array) -> Turned:
    theta, turn, fields, change, *_ = state
    slope = fields + beta[:, :, None] * change  # beta is negative: theta(0) = alpha + |beta| theta'(0)
    return Turned(theta + beta * turn, stable & (np.linalg.det(slope) > 0), slope)


def _moved(state: tuple[Any, ...], rates: tuple[Any, ...], h: Array) -> tuple[Any, ...]:
    return tuple(
        each + h.reshape((-1,) + (1,) * (each.ndim - 1)) * rate for each, rate in zip(state, rates, strict=True)
    )


def _between(before: tuple[Any, ...], after: tuple[Any, ...], h: Array) -> list[Array]:
    """Places within a step, by the cubic through both ends with their directions."""
    p, q, step = before[5], after[5], h[:, None]
    a, b = before[4][:, :, 2] * step, after[4][:, :, 2] * step
    return [
        p + t * a + t**2 * (3 * (q - p) - 2 * a - b) + t**3 * (2 * (p - q) + a + b) for t in BETWEEN.tolist()
    ]  # fmt: skip


def margins(robot: Robot, z: Array, beta: Array) -> Array:
    """(B,) least eigenvalue of the second variation relative to its torsional part, from 0 to 1; -1 where unstable."""
    low, high = np.zeros(len(z)), np.ones(len(z))
    stable = turned(robot, z, beta).stable
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        holds = turned(robot, z, beta, 1 / (1 - middle)).stable
        low, high = np.where(holds, middle, low), np.where(holds, high, middle)
    return np.where(stable, low, -1.0)


@dataclass(frozen=True, eq=False)
class Followed:
    """A motion followed: tip angles (T, n) and joint values (T, 2 n) where it was looked at, and the share of it after
    which the branch ended: 1 without a snap."""

    z: Array
    joints: Array
    share: float


def follow(robot: Robot, ways: Sequence[Array], starts: Array) -> list[Followed]:
    """Motions (T, 2 n) of rotations and held places, straight between rows, each followed from its tip angles (n,).

    Every step is Newton's method from where the motion was heading. A step is taken where that converges to a stable
    equilibrium nearby, and halved where not; where nothing is left to halve, the branch has ended: the robot snaps.
    """
    n = robot.n
    limit = np.array([MOST_TURN] * n + [MAX_SHIFT] * n)
    lengths = [np.append(0.0, np.cumsum((np.abs(np.diff(path, axis=0)) / limit).max(axis=1))) for path in ways]

    def at(k: int, t: float) -> Array:
        return np.array([np.interp(t, lengths[k], column) for column in ways[k].T])

    t, step, alive = np.zeros(len(ways)), np.ones(len(ways)), np.ones(len(ways), dtype=bool)
    whole = np.array([each[-1] for each in lengths])
    tracks = [([z], [path[0]], [0.0]) for z, path in zip(starts, ways, strict=True)]
    while (active := np.flatnonzero(alive & (t < whole))).size:
        new = np.minimum(t[active] + step[active], whole[active])
        joints = np.array([at(k, each) for k, each in zip(active.tolist(), new.tolist(), strict=True)])
        start_time = np.array([_ahead(tracks[k], each) for k, each in zip(active.tolist(), new.tolist(), strict=True)])
        z, good = _stepped(robot, joints, start_time)
        for row, k in enumerate(active.tolist()):
            if good[row]:
                t[k], step[k] = new[row], min(1.0, 1.5 * step[k])
                for part, value in zip(tracks[k], (z[row], joints[row], t[k]), strict=True):
                    part.append(value)
            else:
                step[k] /= 2
                alive[k] = step[k] > MIN_STEP
    fractions = np.where(whole > 0, t / np.maximum(whole, 1e-12), 1.0)
    return [Followed(np.array(z), np.array(q), float(s)) for (z, q, _), s in zip(tracks, fractions, strict=True)]


def _ahead(track: tuple[list[Array], list[Array], list[float]], t: float) -> Array:
    """Tip angles on the straight line through the last two."""
    z, _, times = track
    if len(z) < 2:
        return z[-1]
    return z[-1] + (z[-1] - z[-2]) * (t - times[-1]) / (times[-1] - times[-2])


def _stepped(robot: Robot, joints: Array, begun: Array) -> tuple[Array, Mask]:
    """Newton's method at joint values (B, 2 n) from tip angles: where it ends, and whether that counts."""
    n, z = robot.n, begun.copy()
    good = np.zeros(len(z), dtype=bool)
    for _ in range(6):
        result = turned(robot, z, joints[:, n:])
        gap = result.rotations - joints[:, :n]
        good = result.stable & (np.abs(gap).max(axis=1) < 1e-9) & (np.abs(z - begun).max(axis=1) < MAX_JUMP)
        lost = ~result.stable | (np.abs(z - begun).max(axis=1) >= MAX_JUMP)
        if (good | lost).all():
            break
        step = np.linalg.solve(result.slope + 1e-14 * np.eye(n), gap[:, :, None])[:, :, 0]
        z = np.where((good | lost)[:, None], z, z - step)
    return z, good
