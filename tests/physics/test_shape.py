"""Shape from curvature: exact on circles, of order 6 elsewhere, a rotation to round-off."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from tubeopt.physics.shape import GAUSS_POINTS, magnus_step
from tubeopt.typing import Array

Curvature = Callable[[float], tuple[float, float]]


def walk(curvature: Curvature, length: float, steps: int) -> tuple[Array, Array]:
    """Frame and position at the end of `steps` equal Magnus steps."""
    rotation, position, h = ca.DM.eye(3), ca.DM.zeros(3), length / steps
    for k in range(steps):
        u = ca.DM(np.array([curvature((k + x) * h) for x in GAUSS_POINTS]).T)
        rotation, position = magnus_step(rotation, position, u, h)
    return rotation.full(), position.full().ravel()


def integrate(curvature: Curvature, length: float) -> tuple[Array, Array]:
    """The same by DOP853: R' = R hat(u), p' = R e3."""

    def slope(s: float, y: Array) -> Array:
        frame, (ux, uy) = y[:9].reshape(3, 3), curvature(s)
        hat = np.array([[0, 0, uy], [0, 0, -ux], [-uy, ux, 0]])
        return np.concatenate([(frame @ hat).ravel(), frame[:, 2]])

    start = np.concatenate([np.eye(3).ravel(), np.zeros(3)])
    end = solve_ivp(slope, (0, length), start, method="DOP853", rtol=3e-14, atol=3e-14).y[:, -1]
    return end[:9].reshape(3, 3), end[9:]


@given(st.floats(-2.0, 2.0), st.floats(-np.pi, np.pi))
def test_one_step_is_exact_on_a_circle(bend: float, direction: float) -> None:
    # But for what the series of the exponential leaves out: for a turn of 2 rad less than 1e-12.
    length = 0.1
    u = bend / length * np.cos(direction), bend / length * np.sin(direction)
    frame, position = walk(lambda s: u, length, 1)
    # Curvature vector along x turns the arc towards -y; here the axis of the turn points to `direction`.
    # (1 - cos b) / b without cancellation.
    across = length * bend / 2 * np.sinc(bend / 2 / np.pi) ** 2
    along = length * np.sinc(bend / np.pi)
    assert position == pytest.approx([across * np.sin(direction), -across * np.cos(direction), along], abs=1e-13)
    assert frame[:, 2] == pytest.approx(
        [np.sin(bend) * np.sin(direction), -np.sin(bend) * np.cos(direction), np.cos(bend)], abs=1e-12
    )


def test_positive_curvature_along_x_bends_towards_minus_y() -> None:
    frame, position = walk(lambda s: (np.pi / 2, 0.0), 1.0, 1)
    assert position == pytest.approx([0, -2 / np.pi, 2 / np.pi])
    assert frame @ [0, 0, 1] == pytest.approx([0, -1, 0])


def helix(s: float) -> tuple[float, float]:
    return 12 * np.cos(30 * s), 12 * np.sin(30 * s)


def wave(s: float) -> tuple[float, float]:
    return 10 * np.exp(-5 * s) + 3 * np.sin(40 * s), 8 * s / 0.2 - 5 * np.cos(25 * s)


@pytest.mark.parametrize("curvature", [helix, wave])
def test_order_six(curvature: Curvature) -> None:
    length = 0.2
    frame, position = integrate(curvature, length)
    walked = [walk(curvature, length, steps) for steps in (4, 8, 16)]
    coarse, middle, fine = np.array([[np.abs(r - frame).max(), np.linalg.norm(p - position)] for r, p in walked])
    assert (np.log2(coarse / middle) > 5.5).all()
    assert (np.log2(middle / fine) > 5.7).all()
    assert fine[1] < 1e-8


def test_a_helix_of_known_pitch() -> None:
    # A Bishop curvature vector of constant length kappa that turns at tau is a helix of curvature kappa, torsion tau:
    # one turn of 2 pi / rate advances by 2 pi tau / rate^2 along the axis (tau, kappa) / rate.
    kappa, tau = 12.0, 30.0
    rate = np.hypot(kappa, tau)
    _, position = walk(lambda s: (kappa * np.cos(tau * s), kappa * np.sin(tau * s)), 2 * np.pi / rate, 64)
    assert np.linalg.norm(position) == pytest.approx(2 * np.pi * tau / rate**2, rel=1e-10)


@given(st.lists(st.floats(-20, 20), min_size=6, max_size=6), st.floats(0, 0.05))
def test_frames_are_rotations_to_round_off(entries: list[float], length: float) -> None:
    rotation, _ = magnus_step(ca.DM.eye(3), ca.DM.zeros(3), ca.reshape(ca.DM(entries), 2, 3), length)
    frame = rotation.full()
    assert frame @ frame.T == pytest.approx(np.eye(3), abs=1e-14)
    assert np.linalg.det(frame) == pytest.approx(1.0)


def test_a_step_starts_where_the_last_one_ended() -> None:
    start = walk(helix, 0.1, 8)
    u = ca.DM(np.array([helix(0.1 + x * 0.05) for x in GAUSS_POINTS]).T)
    local = magnus_step(ca.DM.eye(3), ca.DM.zeros(3), u, 0.05)
    rotation, position = magnus_step(ca.DM(start[0]), ca.DM(start[1]), u, 0.05)
    assert rotation.full() == pytest.approx(start[0] @ local[0].full())
    assert position.full().ravel() == pytest.approx(start[1] + start[0] @ local[1].full().ravel())
