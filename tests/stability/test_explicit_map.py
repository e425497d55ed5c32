"""All equilibria under a tip force by another way: rotations of the tubes and the force, both at the tip, lead to joint
rotations and to the force in axes of the plate by integration alone, so that every equilibrium is a root of a map of
six unknowns, whose signs sum to 1."""

from __future__ import annotations

import numpy as np

from tests.examples import THESIS
from tubeopt import Load, find_equilibria
from tubeopt.typing import Array

TUBES = THESIS.tubes
KB, KT, PULL, STRAIGHT = (
    np.array([getattr(tube, name) for tube in TUBES])
    for name in ("bending_stiffness", "torsional_stiffness", "curvature", "straight_length")
)
PULL = KB * PULL
ENDS, STEPS, STARTS = (0.2, 0.15, 0.1, 0.0), 12, 40


def rates(y: Array, present: Array) -> Array:
    """Of theta, t, the frame, m_x and m_y, and the force, which stays: (S, 20)."""
    theta, t, frame, moment, force = np.split(y, (3, 6, 15, 17), axis=1)
    frame = frame.reshape(-1, 3, 3)
    pulls = (PULL * present)[:, None] * np.stack([np.cos(theta), np.sin(theta)], axis=-1)
    x, y2 = ((moment + pulls.sum(1)) / (KB * present).sum()).T
    felt, whole, zero = np.einsum("sij,si->sj", frame, force), (t * present).sum(1), np.zeros(len(theta))
    torque = (x[:, None] * pulls[:, :, 1] - y2[:, None] * pulls[:, :, 0]) * present
    hat = np.array([[zero, zero, y2], [zero, zero, -x], [-y2, x, zero]]).transpose(2, 0, 1)
    bent = np.stack([felt[:, 1] - y2 * whole, x * whole - felt[:, 0]], axis=1)
    return np.concatenate([t / KT * present, torque, (frame @ hat).reshape(-1, 9), bent, np.zeros_like(force)], axis=1)


def explicit(z: Array) -> Array:
    """(S, 6) joint rotations and force in axes of the plate, of those at the tip."""
    count = len(z)
    flat = np.tile(np.eye(3).ravel(), (count, 1))
    y = np.concatenate([z[:, :3], np.zeros((count, 3)), flat, np.zeros((count, 2)), z[:, 3:]], axis=1)
    for k in range(3):
        present, h = np.array([1.0, k > 0, k > 1]), (ENDS[k + 1] - ENDS[k]) / STEPS
        for _ in range(STEPS):
            one = rates(y, present)
            two = rates(y + h / 2 * one, present)
            three = rates(y + h / 2 * two, present)
            y = y + h / 6 * (one + 2 * two + 2 * three + rates(y + h * three, present))
    force = np.einsum("sij,si->sj", y[:, 6:15].reshape(-1, 3, 3), y[:, 17:])
    return np.concatenate([y[:, :3] - STRAIGHT * y[:, 3:6] / KT, force], axis=1)


def test_every_equilibrium_under_a_tip_force_is_found() -> None:
    rotations, force = np.array([3.6, 0.0, 0.0]), np.array([0.01, 0.02, 0.0])
    random, scale = np.random.default_rng(0), np.repeat([1.0, np.linalg.norm(force)], 3)
    desired = np.concatenate([rotations, force])
    directions = random.normal(size=(STARTS, 3))
    directions *= scale[3] / np.linalg.norm(directions, axis=1)[:, None]
    z = np.concatenate([rotations + random.uniform(-2 * np.pi, 2 * np.pi, (STARTS, 3)), directions], axis=1)
    slopes, on = np.zeros((STARTS, 6, 6)), np.arange(STARTS)
    for _ in range(30):
        moved = z[on] + 1e-6 * np.concatenate([np.zeros((1, 6)), np.diag(scale)])[:, None]
        gap, *sides = explicit(moved.reshape(-1, 6)).reshape(moved.shape) - desired
        slopes[on] = np.stack([side - gap for side in sides], axis=2) / 1e-6 / scale[:, None]
        step = -np.linalg.solve(slopes[on], (gap / scale)[..., None])[..., 0]
        size = np.abs(step).max(1, initial=1e-9)
        z[on] += scale * step * np.minimum(1.0, 0.7 / size)[:, None]
        on = on[size > 1e-8]
    arrived = np.flatnonzero(np.abs((explicit(z) - desired) / scale).max(1) < 1e-8)
    roots: list[tuple[Array, float]] = []
    for k in arrived:
        if all(np.abs(z[k, :3] - known[:3]).max() > 1e-3 for known, _ in roots):
            roots.append((z[k], float(np.sign(np.linalg.det(slopes[k])))))
    equilibria = find_equilibria(THESIS, rotations, load=Load(tuple(force)))  # type: ignore[arg-type]
    assert len(equilibria) == len(roots) == 3
    assert sum(sign for _, sign in roots) == sum((-1) ** e.index for e in equilibria) == 1
    for e in equilibria:
        near = min(np.abs(e.tip_rotations - root[:3]).max() for root, _ in roots)
        assert near < 1e-6
