"""A reference for eccentric robots that shares nothing with tubeopt but the numbers of their tubes.

Every tube is a row of numbers; sections, cross-sections and boundary conditions are written out here once more in
NumPy, and solved by shooting with DOP853. The one-segment robot is there too in the polar form of the thesis, equation
(3.31) with (3.39) to (3.49), which is singular where the arm is straight.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp

from tubeopt import SegmentedEccentricRobot, Tube
from tubeopt.typing import Array

TOLERANCE = 1e-13


@dataclass(frozen=True)
class Row:
    """One tube: EI, GJ, precurvature, where it begins to curve and ends in front of the plate, where it is held, and
    its place (across, along) beside the centreline."""

    bending: float
    torsional: float
    curvature: float
    begin: float
    end: float
    held: float
    place: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Answer:
    """Tip (3,) and its frame (3, 3), theta and w (n,) at the plate, theta (n,) at each tube's own end."""

    tip: Array
    frame: Array
    rotation: Array
    twist: Array
    end_rotation: Array


def rows(segments: tuple[Tube, ...], advance: tuple[float, ...], distance: float) -> tuple[Row, ...]:
    """The tubes of segments, inner to outer, each advanced by its number of metres from home at the plate."""
    out = []
    for tube, shift in zip(segments, advance, strict=True):
        inertia = np.pi / 64 * (tube.outer_diameter**4 - tube.inner_diameter**4)
        stiffness = tube.material.youngs_modulus * inertia, 2 * tube.material.shear_modulus * inertia
        for angle in np.radians([0.0, 120.0, 240.0]):
            place = (float(distance * np.cos(angle)), float(distance * np.sin(angle)))
            ends = (shift, shift + tube.curved_length, tube.straight_length - shift)
            out.append(Row(*stiffness, tube.curvature, *ends, place))
    return tuple(out)


def rows_of(robot: SegmentedEccentricRobot, advance: tuple[float, ...]) -> tuple[Row, ...]:
    """The tubes of a robot of segments; offset as where the tubes of the outermost one touch, if it has any."""
    distance = robot.segments[-1].outer_diameter / np.sqrt(3) if robot.distance else 0.0
    return rows(robot.segments, advance, distance)


def shoot(tubes: tuple[Row, ...], rotations: Array, twist: Array | None = None) -> Answer:
    """The equilibrium whose torsion w at the plate is near `twist` (n,), by default 0: by Newton's method with
    differences."""
    held, n = np.array([tube.held for tube in tubes]), len(tubes)
    w = np.zeros(n) if twist is None else np.array(twist, dtype=float)
    size = 1e-6 * max(1.0, float(np.abs(w).max()))
    for _ in range(20):
        several = w + size * np.concatenate([np.zeros((1, n)), np.eye(n)])
        left = _ends(tubes, rotations + held * several, several)[0]
        w = w - np.linalg.solve(((left[1:] - left[0]) / size).T, left[0])
        if np.abs(left[0]).max() < 1e-7:
            break
    theta = rotations + held * w
    left, ends = _ends(tubes, theta[None], w[None])
    assert np.abs(left).max() < 1e-9
    state = _with_frame(tubes, theta, w)
    return Answer(state[2 * n + 9 :], state[2 * n : 2 * n + 9].reshape(3, 3), theta, w, ends[0])


def torsion_map(tubes: tuple[Row, ...], rotations: Array, twist: Array) -> Array:
    """(n, n) how w at the ends changes with `twist` (n,) at the plate: singular at a fold."""
    held = np.array([tube.held for tube in tubes])
    size = 1e-5 * np.abs(twist).max()
    several = twist + size * np.concatenate([np.eye(len(twist)), -np.eye(len(twist))])
    up, down = np.split(_ends(tubes, rotations + held * several, several)[0], 2)
    return np.asarray((up - down).T / (2 * size))


def _sections(tubes: tuple[Row, ...]) -> Iterator[tuple[tuple[float, float], Array, Array]]:
    """Where each section begins and ends, and which tubes (n,) are there and are curved."""
    cuts = np.unique(np.clip([[0.0, tube.begin, tube.end] for tube in tubes], 0.0, None).round(15))
    for start, stop in pairwise(cuts):
        middle = (start + stop) / 2
        there = np.array([middle < tube.end for tube in tubes])
        yield (start, stop), there, there & [tube.begin < middle for tube in tubes]


def _ends(tubes: tuple[Row, ...], theta: Array, w: Array) -> tuple[Array, Array]:
    """w and theta of every tube at its own end, of several arms at once: (B, n) at the plate and (B, n) there."""
    twist, rotation, n = w.copy(), theta.copy(), len(tubes)
    state = np.concatenate([theta, w], axis=1)
    for ends, there, curved in _sections(tubes):
        rates = _rates(tubes, there, curved)

        def slope(_: float, y: Array, rates: Rates = rates) -> Array:
            theta, w = np.split(y.reshape(-1, 2 * n), 2, axis=1)
            return np.concatenate(rates(theta, w)[:2], axis=1).ravel()

        state = _run(slope, ends, state.ravel()).reshape(-1, 2 * n)
        twist[:, there], rotation[:, there] = state[:, n:][:, there], state[:, :n][:, there]
    return twist, rotation


def _with_frame(tubes: tuple[Row, ...], theta: Array, w: Array) -> Array:
    """theta, w, R and p at the tip from theta and w (n,) at the plate."""
    state = np.concatenate([theta, w, np.eye(3).ravel(), np.zeros(3)])
    for ends, there, curved in _sections(tubes):
        state = _run(_slope(tubes, there, curved), ends, state)
    return state


def _run(slope: Callable[[float, Array], Array], ends: tuple[float, float], state: Array) -> Array:
    run = solve_ivp(slope, ends, state, method="DOP853", rtol=TOLERANCE, atol=TOLERANCE)
    return np.asarray(run.y[:, -1])


def curvature(bending: Array, pull: Array, place: Array, theta: Array) -> tuple[Array, Array]:
    """u (..., 2) and g (..., n) at theta (..., n): u (sum EI / g) = sum pull (cos theta, sin theta), by iteration that
    gains a factor d |u| at every step, to the last bit."""
    total = np.stack([np.cos(theta) @ pull, np.sin(theta) @ pull], axis=-1)
    stretch, across = np.ones_like(theta), np.stack([place[:, 1], -place[:, 0]])
    u = total / bending.sum()
    for _ in range(12):
        before = u
        # e3' hat(u) d of (3.10): the tube on the inside of the bend is the shorter one.
        stretch = 1 + u @ across
        u = total / (bending / stretch).sum(-1)[..., None]
        if np.abs(u - before).max() <= 1e-16 * np.abs(u).max():
            break
    return u, stretch


Rates = Callable[[Array, Array], tuple[Array, Array, Array]]


def _rates(tubes: tuple[Row, ...], there: Array, curved: Array) -> Rates:
    """theta', w' (..., n) and u (..., 2) of a section with these tubes there and curved, as a function of theta, w."""
    bending, torsional, bend = (
        np.array([getattr(tube, name) for tube in tubes]) for name in ("bending", "torsional", "curvature")
    )
    place = np.array([tube.place for tube in tubes])
    pull, present = bending * bend * curved, bending * there

    def rates(theta: Array, w: Array) -> tuple[Array, Array, Array]:
        u, stretch = curvature(present, pull, place, theta)
        gain = pull * (u[..., :1] * np.sin(theta) - u[..., 1:] * np.cos(theta)) / torsional
        return stretch * w * there, gain, u

    return rates


def _slope(tubes: tuple[Row, ...], there: Array, curved: Array) -> Callable[[float, Array], Array]:
    """(theta, w, R, p)' of a section with these tubes there and curved, as a function of s and state."""
    n, rates = len(tubes), _rates(tubes, there, curved)

    def slope(_: float, y: Array) -> Array:
        frame = y[2 * n : 2 * n + 9].reshape(3, 3)
        turned, gain, u = rates(y[:n], y[n : 2 * n])
        hat = np.array([[0.0, 0.0, u[1]], [0.0, 0.0, -u[0]], [-u[1], u[0], 0.0]])
        return np.concatenate([turned, gain, (frame @ hat).ravel(), frame[:, 2]])

    return slope


def stepped_tip(tubes: tuple[Row, ...], answer: Answer, steps: int) -> Array:
    """Tip by `steps` exponentials of the mean curvature of each step: the leading term of the Magnus series alone,
    which leaves out what curvatures of one step do not commute by. One section, all tubes curved."""
    n, length = len(tubes), tubes[0].end
    flags = np.ones(n, dtype=bool)
    start = np.concatenate([answer.rotation, answer.twist, np.eye(3).ravel(), np.zeros(3)])
    x, weight = np.polynomial.legendre.leggauss(5)
    h = length / steps
    s = (np.arange(steps)[:, None] * h + h * (x + 1) / 2).ravel()
    run = solve_ivp(_slope(tubes, flags, flags), (0.0, length), start, "DOP853", s, rtol=TOLERANCE, atol=TOLERANCE)
    bending, bend = np.array([tube.bending for tube in tubes]), np.array([tube.curvature for tube in tubes])
    place = np.array([tube.place for tube in tubes])
    u = curvature(bending, bending * bend, place, run.y[:n].T)[0]
    mean = np.einsum("k,akc->ac", weight / 2, u.reshape(steps, 5, 2))
    frame, tip = np.eye(3), np.zeros(3)
    for ux, uy in mean:
        turn = float(np.hypot(ux, uy)) * h
        hat = h * np.array([[0.0, 0.0, uy], [0.0, 0.0, -ux], [-uy, ux, 0.0]])
        first, second, third = _rodrigues(turn)
        tip = tip + h * frame @ (np.eye(3) + second * hat + third * hat @ hat)[:, 2]
        frame = frame @ (np.eye(3) + first * hat + second * hat @ hat)
    return np.asarray(tip)


def _rodrigues(x: float) -> tuple[float, float, float]:
    """sin x / x, (1 - cos x) / x^2, (x - sin x) / x^3 as series, for small x."""
    square = x * x
    return (
        1 - square / 6 * (1 - square / 20),
        0.5 - square / 24 * (1 - square / 30),
        1 / 6 - square / 120 * (1 - square / 42),
    )


def thesis_slope(theta: Array, slope: Array, bend: float, distance: float, nu: float) -> Array:
    """theta'' (3,) of one segment at theta and theta' (3,), as the thesis writes it: (3.31) with (3.39) to (3.49).

    Its symbols: S, C and their derivatives (3.35) to (3.38), psi (3.39), its derivative (3.42), u by the cubic (3.45)
    with (3.46), its derivative (3.49) with (3.48).
    """
    phi = np.radians([0.0, 120.0, -120.0])
    d = distance
    S, C = np.sin(theta).sum(), np.cos(theta).sum()
    dS, dC = (np.cos(theta) * slope).sum(), -(np.sin(theta) * slope).sum()
    psi = np.arctan2(S, C)
    dpsi = (C * dS - S * dC) / (C**2 + S**2)
    size = np.hypot(S, C)
    a0 = 4 * bend * size
    a1, a2 = -12.0, -3 * d**2 * a0 / 4
    a3 = 3 * d**2 + d**3 * np.sin(3 * psi) * a0 / 4
    roots = np.roots([a3, a2, a1, a0]) if d else np.array([a0 / 12])
    real = roots.real[np.abs(roots.imag) < 1e-9 * np.abs(roots)]
    u = real[np.argmin(np.abs(real - bend * size / 3))]
    da0 = 2 * bend * (2 * C * dC + 2 * S * dS) / size
    da2 = -3 * d**2 * da0 / 4
    da3 = (d**3 * np.sin(3 * psi) * da0 + 3 * d**3 * np.cos(3 * psi) * a0 * dpsi) / 4
    du = -(u**3 * da3 + u**2 * da2 + da0) / (3 * a3 * u**2 + 2 * a2 * u + a1)
    g = d * np.sin(phi - psi) * u + 1
    first = (d * np.sin(phi - psi) * du - d * np.cos(phi - psi) * u * dpsi) / g * slope
    return np.asarray(first - bend * u * np.sin(psi - theta) * g * (nu + 1))
