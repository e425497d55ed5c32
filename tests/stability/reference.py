"""Brute force for tests of stability, in NumPy only: shooting from the tip on dense grids, and slow motion by gradient
flow of the elastic energy in finite elements.

Tubes interact in pairs, kt_i theta_i'' = sum_j c_ij sin(theta_i - theta_j), and the energy is

    sum_i [int kt_i theta_i'^2 / 2 + kt_i / (2 |beta_i|) (theta_i(0) - alpha_i)^2]
        - sum_pairs int c_ij cos(theta_i - theta_j) + what does not depend on the rotations.

Beyond its end a tube is continued without coupling, which leaves it without torsion there.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve, eigh
from scipy.special import ellipj

from tubeopt.robots.robot import Robot

Array = NDArray[np.float64]

TURN = 2 * np.pi


def closed_form(c: float, length: float, lever: float, tip: Array) -> Array:
    """Input angle (rad) of two tubes of equal length and transmission whose tips are `tip` (rad) apart."""
    k, other = np.cos(tip / 2), np.sin(tip / 2)
    sn, cn, dn, _ = ellipj(np.sqrt(c) * length, k**2)
    # Continuous in the tip angle: 2 acos(k cd) runs from 0 to 2 pi as the tip does, and on by turns.
    turns = np.floor(tip / TURN)
    sign = np.where(turns % 2 == 0, 1.0, -1.0)
    torsion = np.sqrt(c) * k * other * sn / dn
    return np.asarray(2 * np.arccos(np.clip(sign * k * cn / dn, -1, 1)) + TURN * turns + 2 * lever * torsion)


@dataclass(frozen=True, eq=False)
class Bundle:
    """n tubes in front of the plate: kt (n,), |beta| (n,), and per section length (m,), couplings c_ij (m, n, n), and
    the bending energy per length (m,) that does not depend on the rotations."""

    torsional: Array
    lever: Array
    length: Array
    coupling: Array
    constant: Array

    @property
    def coupled(self) -> NDArray[np.intp]:
        """Tubes that are coupled to another one."""
        return np.flatnonzero((self.coupling * self.length[:, None, None]).any((0, 1)))

    @property
    def waves(self) -> Array:
        """(m,) bound of sqrt(c) times length."""
        rate = np.abs(self.coupling).sum(2) / self.torsional
        return np.asarray(np.sqrt(2 * rate.max(1, initial=0.0)) * self.length)


def bundle(robot: Robot, translations: Array | None = None) -> Bundle:
    """The sections of a robot at its translations."""
    shift = np.zeros(robot.n_tubes) if translations is None else np.asarray(translations)
    kb = np.array([tube.bending_stiffness for tube in robot.tubes])
    kappa = np.array([tube.curvature for tube in robot.tubes])
    stop = shift + [tube.curved_length for tube in robot.tubes]
    cuts = np.unique(np.maximum(np.concatenate([[0.0], shift, stop]), 0.0))
    middle = (cuts[:-1] + cuts[1:])[:, None] / 2
    present = middle < stop
    moment = np.where(present & (middle > shift), kb * kappa, 0.0)
    total = np.maximum((present * kb).sum(1), 1e-300)
    coupling = moment[:, :, None] * moment[:, None, :] / total[:, None, None]
    own = np.einsum("mii->m", coupling)
    coupling[:, np.arange(len(kb)), np.arange(len(kb))] = 0.0
    return Bundle(
        torsional=np.array([tube.torsional_stiffness for tube in robot.tubes]),
        lever=np.array([tube.straight_length for tube in robot.tubes]) - shift,
        length=np.diff(cuts),
        coupling=coupling,
        constant=((moment * kappa).sum(1) - own) / 2,
    )


# --- shooting ---------------------------------------------------------------------------------------------------------


def shoot(tubes: Bundle, tips: Array, *, step: float = 0.02) -> Array:
    """Joint rotations (B, n) of tip angles (B, n): classical Runge and Kutta steps of sqrt(c) h <= `step`."""
    theta, twist = np.array(tips, dtype=float), np.zeros_like(tips)
    for length, coupling, waves in zip(tubes.length[::-1], tubes.coupling[::-1], tubes.waves[::-1], strict=True):
        count = max(1, int(np.ceil(waves / step)))
        h = -length / count
        pairs = [(i, j) for i, j in combinations(range(len(tubes.torsional)), 2) if coupling[i, j] != 0]

        def bend(angle: Array, coupling: Array = coupling, pairs: list[tuple[int, int]] = pairs) -> Array:
            out = np.zeros_like(angle)
            for i, j in pairs:
                force = coupling[i, j] * np.sin(angle[:, i] - angle[:, j])
                out[:, i] += force / tubes.torsional[i]
                out[:, j] -= force / tubes.torsional[j]
            return out

        for _ in range(count):
            k1 = bend(theta)
            k2 = bend(theta + h / 2 * twist)
            k3 = bend(theta + h / 2 * twist + h**2 / 4 * k1)
            k4 = bend(theta + h * twist + h**2 / 2 * k2)
            theta = theta + h * twist + h**2 / 6 * (k1 + k2 + k3)
            twist = twist + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return np.asarray(theta - tubes.lever * twist)


def first_fold(tubes: Bundle, start: float) -> float | None:
    """Turn (rad) of the first of two tubes from rotations (start, 0), at which they curve to one side, to the first
    fold; None without one."""
    low, high = 0.0, np.pi
    # The largest turn so far, on ever finer grids around it: a fold is the first place where the turn goes back.
    while True:
        tips = np.zeros((401, 2))
        tips[:, 0] = start + np.linspace(low, high, len(tips))
        joints = shoot(tubes, tips)
        turn = joints[:, 0] - joints[:, 1] - start
        back = np.flatnonzero(np.diff(turn) < 0)
        if not len(back):
            return None
        k = int(back[0])
        if high - low < 1e-5:
            return float(turn[k])
        low, high = (tips[j, 0] - start for j in (max(k - 1, 0), k + 1))


def all_tips(tubes: Bundle, rotations: Array, *, size: int) -> Array:
    """Tip angles (E, n) of every equilibrium that a grid of `size` points per turn of each relative tip angle shows.

    The joint rotations are interpolated linearly on the simplices of the grid; each one that holds the wanted
    rotations, up to whole turns, is a start for Newton's method.
    """
    free = tubes.coupled
    if len(free) < 2:
        return np.array(rotations, dtype=float)[None]
    turning, fixed = free[:-1], free[-1]
    axis = np.arange(size + 1) * TURN / size
    grid: Array = np.stack(np.meshgrid(*[axis] * len(turning), indexing="ij"), axis=-1)
    tips = np.zeros((grid.size // len(turning), len(rotations)))
    tips[:, turning] = grid.reshape(-1, len(turning))
    base = shoot(tubes, tips, step=0.15)
    gap = (base[:, turning] - base[:, [fixed]] - (rotations[turning] - rotations[fixed])) / TURN
    gap = gap.reshape(grid.shape)
    starts = np.concatenate(list(_simplex_roots(grid, gap)))
    result = np.tile(np.array(rotations, dtype=float), (len(starts), 1))
    result[:, free] = rotations[fixed]
    result[:, turning] += starts
    return _unique(_newton(tubes, rotations, result))


def _simplex_roots(grid: Array, gap: Array) -> Iterator[Array]:
    """Relative tip angles at which the linear interpolant of `gap` is a whole number of turns; unwound to 0 turns."""
    yield np.zeros((0, grid.shape[-1]))
    if grid.shape[-1] == 1:
        x, y = grid[:, 0], gap[:, 0]
        for turn in range(int(np.floor(y.min())), int(np.ceil(y.max())) + 1):
            hit = np.flatnonzero((y[:-1] - turn) * (y[1:] - turn) <= 0)
            slope = np.where(y[hit + 1] == y[hit], 1.0, y[hit + 1] - y[hit])
            yield (x[hit] + (turn - y[hit]) / slope * (x[hit + 1] - x[hit]) - TURN * turn)[:, None]
        return
    corner = {(a, b): np.s_[a : len(grid) - 1 + a, b : len(grid) - 1 + b] for a in (0, 1) for b in (0, 1)}
    for corners in (((0, 0), (1, 0), (0, 1)), ((1, 1), (0, 1), (1, 0))):
        x, y = (np.stack([field[corner[c]].reshape(-1, 2) for c in corners], axis=1) for field in (grid, gap))
        low, high = np.floor(y.min(1)).astype(int), np.ceil(y.max(1)).astype(int)
        for first in range(int(low[:, 0].min()), int(high[:, 0].max()) + 1):
            for second in range(int(low[:, 1].min()), int(high[:, 1].max()) + 1):
                turns = np.array([first, second])
                near = np.flatnonzero(((low <= turns) & (turns <= high)).all(1))
                edges = np.stack([y[near, 1] - y[near, 0], y[near, 2] - y[near, 0]], axis=2)
                sound = np.abs(np.linalg.det(edges)) > 1e-14
                near, edges = near[sound], edges[sound]
                part = np.linalg.solve(edges, (turns - y[near, 0])[:, :, None])[:, :, 0]
                inside = (part >= -0.05).all(1) & (part.sum(1) <= 1.05)
                part, near = part[inside, :, None], near[inside]
                position = x[near, 0] + part[:, 0] * (x[near, 1] - x[near, 0]) + part[:, 1] * (x[near, 2] - x[near, 0])
                yield position - TURN * turns


def _newton(tubes: Bundle, rotations: Array, tips: Array) -> Array:
    """Newton's method from each set of tip angles; those that arrive, without leaving by more than half a radian."""
    if not len(tips):
        return tips
    free = tubes.coupled
    tips[:, free] += (rotations - shoot(tubes, tips))[:, free[-1:]]
    start, size, on = tips.copy(), np.full(len(tips), np.inf), np.arange(len(tips))
    for _ in range(12):
        gap = (shoot(tubes, tips[on]) - rotations)[:, free]
        # The slope may be coarse: it only leads there.
        sides = tips[on] + 1e-5 * np.concatenate([np.eye(tips.shape[1])[free], -np.eye(tips.shape[1])[free]])[:, None]
        ends = shoot(tubes, sides.reshape(-1, tips.shape[1]), step=0.1)[:, free]
        up, down = np.split(ends.reshape(2 * len(free), len(on), len(free)), 2)
        slope = ((up - down) / 2e-5).transpose(1, 2, 0)
        slope[np.abs(np.linalg.det(slope)) < 1e-12] += 1e-6 * np.eye(len(free))
        step = np.linalg.solve(slope, -gap[:, :, None])[:, :, 0]
        size[on] = np.abs(step).max(1, initial=0.0)
        tips[np.ix_(on, free)] += step * np.minimum(1.0, 0.2 / np.maximum(size[on], 1e-12))[:, None]
        on = on[(size[on] >= 1e-10) & (np.abs(tips - start)[on].max(1) < 0.5)]
        if not len(on):
            break
    arrived = (size < 1e-8) & (np.abs(tips - start).max(1) < 0.5)
    return np.asarray(tips[arrived])


def _unique(tips: Array) -> Array:
    out: list[Array] = []
    for row in tips:
        if all(np.abs(row - other).max() > 1e-6 for other in out):
            out.append(row)
    return np.array(out).reshape(-1, tips.shape[1])


# --- energy in finite elements ----------------------------------------------------------------------------------------

ORDER = 5

SUBSTEPS = 12
"""Steps of the midpoint rule between two nodes."""

STILL = 1e-8
"""Last step of Newton's method, rad: elements of a short section are stiff, so that round-off leaves about 1e-10."""


class Elements:
    """The elastic energy of a bundle in Lagrange elements of order 5 on Lobatto nodes; theta is (M, n) at the nodes."""

    def __init__(self, tubes: Bundle, *, size: float = 0.8) -> None:
        self.tubes = tubes
        counts = np.maximum(1, np.ceil(tubes.waves / size)).astype(int)
        length = np.repeat(tubes.length / counts, counts)
        start = np.concatenate([[0.0], np.cumsum(length)])
        coefficients = np.zeros(ORDER + 1)
        coefficients[-1] = 1
        local = np.concatenate([[-1.0], legendre.legroots(legendre.legder(coefficients)), [1.0]])
        x, w = legendre.leggauss(ORDER + 2)
        modal = np.linalg.inv(legendre.legvander(local, ORDER))
        value = legendre.legvander(x, ORDER) @ modal
        slope = np.stack([legendre.legval(x, legendre.legder(row)) for row in np.eye(ORDER + 1)], axis=1) @ modal
        m, q = ORDER * len(length) + 1, len(x)
        self.value, self.slope = np.zeros((q * len(length), m)), np.zeros((q * len(length), m))
        for e, h in enumerate(length):
            block = np.s_[q * e : q * (e + 1), ORDER * e : ORDER * (e + 1) + 1]
            self.value[block], self.slope[block] = value, slope * (2 / h)
        self.weight = (np.multiply.outer(length, w) / 2).ravel()
        self.coupling = np.repeat(tubes.coupling, counts * q, axis=0)
        self.start, self.length, self.modal = start, length, modal
        self.node = np.append((start[:-1, None] + length[:, None] * (local[:-1] + 1) / 2).ravel(), start[-1])
        n = len(tubes.torsional)
        stiffness = self.slope.T @ (self.weight[:, None] * self.slope)
        self.stretch = np.kron(stiffness, np.diag(tubes.torsional))
        self.held = tubes.lever < 1e-12
        self.spring = np.where(self.held, 0.0, tubes.torsional / np.where(self.held, 1.0, tubes.lever))
        self.stretch[:n, :n] += np.diag(self.spring)
        self.free = np.append(np.flatnonzero(~self.held), np.arange(n, n * m))
        self.pairs = [(i, j) for i, j in combinations(range(n), 2) if tubes.coupling[:, i, j].any()]

    def energy(self, rotations: Array, theta: Array) -> tuple[float, Array, Array]:
        """Energy (J), gradient and Hessian with respect to the flat theta, without the rotations held at the plate."""
        theta_q = self.value @ theta
        # By the slopes, not by the stiffness matrix, in which those of short sections would drown all others.
        slope, n = self.slope @ theta, theta.shape[1]
        moment = self.weight[:, None] * slope * self.tubes.torsional
        spring = self.spring * (theta[0] - rotations)
        energy = float((moment * slope).sum() + spring @ (theta[0] - rotations)) / 2
        energy += float(self.tubes.constant @ self.tubes.length)
        gradient, hessian = self.slope.T @ moment, self.stretch.copy()
        gradient[0] += spring
        for i, j in self.pairs:
            c = self.coupling[:, i, j] * self.weight
            apart = theta_q[:, i] - theta_q[:, j]
            energy -= float(c @ np.cos(apart))
            pull = self.value.T @ (c * np.sin(apart))
            gradient[:, i] += pull
            gradient[:, j] -= pull
            block = self.value.T @ ((c * np.cos(apart))[:, None] * self.value)
            for a, b, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
                hessian[a::n, b::n] += sign * block
        return energy, gradient.ravel()[self.free], hessian[np.ix_(self.free, self.free)]

    def margins(self, rotations: Array, theta: Array) -> Array:
        """Eigenvalues of the second variation relative to its torsional part, ascending."""
        return self.modes(rotations, theta)[0]

    def modes(self, rotations: Array, theta: Array) -> tuple[Array, Array]:
        """The eigenvalues and their vectors, in the columns, of the nodes that are free."""
        hessian = self.energy(rotations, theta)[2]
        values, vectors = eigh(hessian, self.stretch[np.ix_(self.free, self.free)])
        return values, vectors

    def at(self, theta: Array, arc_length: Array) -> Array:
        """theta (len(arc_length), n) between the nodes; at the tip beyond it."""
        s = np.clip(arc_length, 0.0, self.start[-1])
        e = np.clip(np.searchsorted(self.start, s, side="right") - 1, 0, len(self.length) - 1)
        x = 2 * (s - self.start[e]) / self.length[e] - 1
        rows = np.einsum("pa,ab->pb", legendre.legvander(x, ORDER), self.modal)
        local = theta[(ORDER * e)[:, None] + np.arange(ORDER + 1)]
        return np.asarray(np.einsum("pb,pbn->pn", rows, local))

    def flow(self, rotations: Array, theta: Array, *, stride: float = 0.03) -> Array:
        """The minimum of the energy that its gradient flow, in the norm of the torsional energy, reaches from theta.

        Implicit steps that turn no node by more than `stride` (rad); they become Newton's where the flow ends.
        """
        near = self.newton(rotations, theta)
        if near is not None and np.abs(near - theta).max() < stride:
            return near
        # The energy may be next to 0 where curvatures agree; its round-off is that of its parts.
        noise = 1e-13 * float(np.abs(self.tubes.coupling).sum((1, 2)) @ self.tubes.length)
        metric = self.stretch[np.ix_(self.free, self.free)]
        rate = 0.3
        energy, gradient, hessian = self.energy(rotations, theta)
        for _ in range(5000):
            while True:
                try:
                    factors = cho_factor(hessian + metric / rate, check_finite=False)
                except LinAlgError:
                    rate /= 4
                    continue
                step = np.zeros(theta.size)
                step[self.free] = cho_solve(factors, -gradient, check_finite=False)
                if np.abs(step).max() <= stride:
                    break
                rate /= 2
            trial = theta + step.reshape(theta.shape)
            reached = self.energy(rotations, trial)
            if reached[0] > energy + noise + 1e-13 * abs(energy):
                rate /= 4
                continue
            theta, rate, (energy, gradient, hessian) = trial, min(3 * rate, 1e9), reached
            if np.abs(step).max() < 1e-4 and rate > 1e3:
                near = self.newton(rotations, theta)
                if near is not None and np.abs(near - theta).max() < stride:
                    return near
        raise AssertionError("the gradient flow did not end")

    def newton(self, rotations: Array, theta: Array, *, stable: bool = True) -> Array | None:
        """The equilibrium that a few Newton steps reach; None where they do not, or where it has to be stable and the
        energy is not convex on the way."""
        theta = theta.copy()
        theta[0, self.held] = rotations[self.held]
        for _ in range(8):
            _, gradient, hessian = self.energy(rotations, theta)
            step = np.zeros(theta.size)
            if stable:
                try:
                    step[self.free] = cho_solve(cho_factor(hessian, check_finite=False), -gradient, check_finite=False)
                except LinAlgError:
                    return None
            else:
                step[self.free] = np.linalg.solve(hessian, -gradient)
            theta = theta + step.reshape(theta.shape)
            if np.abs(step).max() < STILL:
                return theta
        return None


@dataclass(frozen=True, eq=False)
class State:
    """A state of slow motion at joint values: theta (M, n) on elements."""

    rotations: Array
    elements: Elements
    theta: Array

    @property
    def tips(self) -> Array:
        """(n,) rotation of each tube at its end."""
        return np.asarray(self.theta[-1])


def settle(robot: Robot, rotations: Array, translations: Array, before: State | None = None) -> State:
    """Where slow motion takes a robot from the state `before` at nearby joint values (else from no torsion)."""
    elements = Elements(bundle(robot, translations))
    twist = np.zeros((len(elements.node), robot.n_tubes))
    if before is not None:
        twist = before.elements.at(before.theta - before.rotations, elements.node)
    return State(rotations, elements, elements.flow(rotations, rotations + twist))


JUMP = 0.5
"""Turn (rad) of a tip in the smallest step that makes it a snap."""


class Creep:
    """Slow motion along the straight way between two sets of joint values, (2, n) each: rotations, translations.

    `snaps` holds the fractions of the way at which the robot snapped.
    """

    def __init__(self, robot: Robot, start: Array, stop: Array, state: State) -> None:
        self.robot, self.start, self.stop = robot, start, stop
        self.at, self.state = 0.0, state
        self.snaps: list[float] = []

    def to(self, t: float, halvings: int = 10) -> State:
        """The state at fraction t, in halves where the robot moves much."""
        rotations, translations = self.start + t * (self.stop - self.start)
        after = settle(self.robot, rotations, translations, self.state)
        jump = np.abs(after.tips - self.state.tips - (rotations - self.state.rotations)).max() > JUMP
        if jump and halvings and t - self.at > 1e-5:
            self.to((self.at + t) / 2, halvings - 1)
            return self.to(t, halvings - 1)
        if jump:
            self.snaps.append(t)
        self.at, self.state = t, after
        return after


def worst_by_elements(tubes: Bundle) -> float:
    """The certificate by its definition: the least eigenvalue with every pair of tubes opposed."""
    elements = Elements(replace(tubes, coupling=-np.abs(tubes.coupling)), size=0.5)
    still = np.zeros((len(elements.node), len(tubes.torsional)))
    return min(1.0, float(elements.margins(still[0], still)[0]))


def settle_at(robot: Robot, rotations: Array, translations: Array, tips: Array) -> State:
    """The equilibrium with given tip angles: theta integrated from the tip, then Newton's method."""
    elements = Elements(bundle(robot, translations))
    theta = elements.newton(rotations, integrated(elements, tips), stable=False)
    assert theta is not None
    return State(rotations, elements, theta)


def integrated(elements: Elements, tips: Array) -> Array:
    """theta (M, n) at the nodes, from the tip."""
    tubes, theta, twist = elements.tubes, np.array(tips, dtype=float), np.zeros_like(tips)
    stop = np.cumsum(tubes.length)
    out = [theta]
    for a, b in zip(elements.node[-2::-1], elements.node[:0:-1], strict=True):
        coupling = tubes.coupling[min(int(np.searchsorted(stop, (a + b) / 2)), len(stop) - 1)]
        h = (a - b) / SUBSTEPS
        for _ in range(SUBSTEPS):
            current, ahead = (
                (coupling * np.sin(np.subtract.outer(angle, angle))).sum(1) / tubes.torsional
                for angle in (theta, theta + h / 2 * twist)
            )
            theta = theta + h * twist + h**2 * (current + 2 * ahead) / 6
            twist = twist + h * ahead
        out.append(theta)
    return np.array(out[::-1])
