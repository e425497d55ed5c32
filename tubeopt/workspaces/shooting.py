"""Every equilibrium of concentric tubes, stable or not, from the rotations of the tubes' tips: many at once.

The torsion of a tube is 0 at its own end, so that the tip rotations fix the whole arm: an initial-value problem from
the tip to the base, whose solution there says at which joint rotations the arm is in equilibrium (see
`stability.shooting`, which searches the ones of given joints). Joints, pose and stability come out of one integration.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..robots.assembly import Array, Mask
from ..robots.robot import Robot

STEPS = 10
"""Steps per section of the arm: tips to about 1e-6 of the length."""


@dataclass(frozen=True, eq=False)
class Equilibria:
    """B equilibria.   rotations: (B, n) of the joints, rad.   tip_position: (B, 3) m.   stable: (B,).

    tip_direction: (B, 3) unit vectors.
    """

    rotations: Array
    tip_position: Array
    tip_direction: Array
    stable: Mask


def from_tips(robot: Robot, tips: Array, translations: Array) -> Equilibria:
    """Equilibria of tip rotations (B, n), rad, at translations (B, n), m, of a robot with tubes on the centreline.

    Stable is what the sign test says: the determinant of the derivative of theta(s) by the tip rotations stays positive
    down to the plate, and so does that of the joint rotations.
    """
    bundle = _Bundle.of(robot, translations)
    count, n = tips.shape
    state = _State(tips.copy(), np.zeros((count, n)), np.tile(np.eye(n), (count, 1, 1)), np.zeros((count, n, n)))
    position, turn = np.zeros((count, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    stable = np.ones(count, dtype=bool)
    for section in range(bundle.cuts.shape[1] - 2, -1, -1):
        stretch = bundle.stretch(section)
        if not stretch.length.any():
            continue
        step = stretch.length / STEPS
        for _ in range(STEPS):
            before, state = state, _nystrom(stretch, state, step)
            position, turn = _carry(stretch, before, state, position, turn, step)
            stable &= np.linalg.det(state.by_tip) > 0
    reach = bundle.transmission[..., None]
    stable &= np.linalg.det(state.by_tip - reach * state.twist_by_tip) > 0
    # Seen from the tip the plate is at `position`, turned by `turn`: seen from the plate, the tip is the inverse.
    frame = _matrix(turn).transpose(0, 2, 1)
    return Equilibria(
        rotations=state.theta - bundle.transmission * state.twist,
        tip_position=-np.einsum("bij,bj->bi", frame, position),
        tip_direction=frame[:, :, 2],
        stable=stable,
    )


@dataclass(frozen=True, eq=False)
class _State:
    """theta and theta' (B, n), and their derivatives by the tip rotations (B, n, n)."""

    theta: Array
    twist: Array
    by_tip: Array
    twist_by_tip: Array


@dataclass(frozen=True, eq=False)
class _Stretch:
    """One section of B arms.

    length: (B,).   pull: (B, n) kb kappa of curved tubes.   stiffness: (B,) of all tubes present.
    compliance: (n,) 1 / kt.
    """

    length: Array
    pull: Array
    stiffness: Array
    compliance: Array

    def curvature(self, theta: Array) -> Array:
        """(B, 2)"""
        moment = [(self.pull * wave(theta)).sum(1) / self.stiffness for wave in (np.cos, np.sin)]
        return np.stack(moment, axis=1)

    def bend(self, theta: Array) -> tuple[Array, Array]:
        """theta'' (B, n), and its derivative by theta (B, n, n)."""
        cosine, sine = np.cos(theta), np.sin(theta)
        x, y = ((self.pull * wave).sum(1, keepdims=True) / self.stiffness[:, None] for wave in (cosine, sine))
        force = self.pull * self.compliance
        ahead = force[:, :, None] * (self.pull / self.stiffness[:, None])[:, None, :]
        # By theta_j through the curvature, u_x sin - u_y cos, and by the tube's own theta.
        slope = -ahead * (sine[:, :, None] * sine[:, None, :] + cosine[:, :, None] * cosine[:, None, :])
        own = np.arange(theta.shape[1])
        slope[:, own, own] += force * (x * cosine + y * sine)
        return force * (x * sine - y * cosine), slope


@dataclass(frozen=True, eq=False)
class _Bundle:
    """Sections of B arms, as many for all, some of no length.

    cuts: (B, m + 1) arc lengths where they begin and end.   The rest is as in `robots.assembly.Assembly`.
    """

    cuts: Array
    transition: Array
    end: Array
    transmission: Array
    stiffness: Array
    moment: Array
    compliance: Array

    @classmethod
    def of(cls, robot: Robot, translations: Array) -> _Bundle:
        """Sections at translations (B, n)."""
        tubes = robot.tubes
        straight = np.array([tube.straight_length for tube in tubes])
        beta = np.minimum(translations - straight, 0.0)
        transition, end = beta + straight, beta + np.array([tube.length for tube in tubes])
        cuts = np.concatenate([np.zeros((len(beta), 1)), transition, end], axis=1)
        stiffness = np.array([tube.bending_stiffness for tube in tubes])
        return cls(
            cuts=np.sort(np.maximum(cuts, 0.0), axis=1),
            transition=transition,
            end=end,
            transmission=-beta,
            stiffness=stiffness,
            moment=stiffness * np.array([tube.curvature for tube in tubes]),
            compliance=1 / np.array([tube.torsional_stiffness for tube in tubes]),
        )

    def stretch(self, section: int) -> _Stretch:
        """One section."""
        low, high = self.cuts[:, section], self.cuts[:, section + 1]
        middle = ((low + high) / 2)[:, None]
        present = middle < self.end
        curved = present & (middle > self.transition)
        stiffness = np.where(present, self.stiffness, 0.0).sum(1)
        # Sections of no length may hold no tube.
        stiffness = np.where(stiffness > 0, stiffness, 1.0)
        return _Stretch(high - low, np.where(curved, self.moment, 0.0), stiffness, self.compliance)


def _nystrom(stretch: _Stretch, at: _State, step: Array) -> _State:
    """One step of Nystrom's method of order 4 towards the plate, for theta and its derivative by the tips."""
    h, H = step[:, None], step[:, None, None]
    k1, v = stretch.bend(at.theta)
    y1 = v @ at.by_tip
    k2, v = stretch.bend(at.theta - h / 2 * at.twist + h**2 / 8 * k1)
    y2 = v @ (at.by_tip - H / 2 * at.twist_by_tip + H**2 / 8 * y1)
    k3, v = stretch.bend(at.theta - h * at.twist + h**2 / 2 * k2)
    y3 = v @ (at.by_tip - H * at.twist_by_tip + H**2 / 2 * y2)
    return _State(
        at.theta - h * at.twist + h**2 / 6 * (k1 + 2 * k2),
        at.twist - h / 6 * (k1 + 4 * k2 + k3),
        at.by_tip - H * at.twist_by_tip + H**2 / 6 * (y1 + 2 * y2),
        at.twist_by_tip - H / 6 * (y1 + 4 * y2 + y3),
    )


def _carry(
    stretch: _Stretch, before: _State, after: _State, position: Array, turn: Array, step: Array
) -> tuple[Array, Array]:
    """Pose of the arm one step further towards the plate: Simpson's rule in classical Runge-Kutta."""
    h = step[:, None]
    middle = (before.theta + after.theta) / 2 + h / 8 * (after.twist - before.twist)
    u0, u1, u2 = (stretch.curvature(theta) for theta in (before.theta, middle, after.theta))
    q1 = _rate(turn, u0)
    q2 = _rate(turn - h / 2 * q1, u1)
    q3 = _rate(turn - h / 2 * q2, u1)
    q4 = _rate(turn - h * q3, u2)
    half = turn - h / 48 * (10 * q1 + 8 * q2 + 8 * q3 - 2 * q4)
    end = turn - h / 6 * (q1 + 2 * q2 + 2 * q3 + q4)
    half, end = (q / np.linalg.norm(q, axis=1, keepdims=True) for q in (half, end))
    position = position - h / 6 * (_axis(turn) + 4 * _axis(half) + _axis(end))
    return position, end


def _rate(q: Array, u: Array) -> Array:
    """q' = q (0, u_x, u_y, 0) / 2 of unit quaternions (B, 4)."""
    w, x, y, z = q.T
    a, b = u.T / 2
    return np.stack([-x * a - y * b, w * a - z * b, w * b + z * a, x * b - y * a], axis=1)


def _axis(q: Array) -> Array:
    """Third column of the rotation matrix."""
    w, x, y, z = q.T
    return np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), w * w - x * x - y * y + z * z], axis=1)


def _matrix(q: Array) -> Array:
    """(B, 3, 3)"""
    w, x, y, z = q.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.array(rows).transpose(2, 0, 1)
