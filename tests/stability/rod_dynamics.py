"""Independent dynamics of two concentric tubes: a chain of nodes in space, explicit in time.

Nodes at equal distances have positions, and a rotation of each tube. Edges resist stretch, nodes bend by the discrete
curvature between their edges (Bergou et al., ACM Trans. Graph. 27 (2008)) in a frame that is carried along the edges,
and the rotations of neighbours resist twist. Forces are J' C (strain - rest + tau d strain / dt), with J by CasADi;
masses are lumped, and time steps are those of Verlet. Nothing is shared with the library: no mesh, no unknowns, no
integrator.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from tubeopt.typing import Array


class Chain(NamedTuple):
    """Two tubes, inner first, on a chain; the outer one is held at the plate, the inner one behind it."""

    length: float
    cells: int
    transmission: float
    bending: tuple[float, float]
    twisting: tuple[float, float]
    mass: tuple[float, float]
    inertia: tuple[float, float]
    curvature: tuple[float, float]
    curved: tuple[tuple[float, float], tuple[float, float]]
    end: tuple[float, float]
    relaxation: float
    stretching: float
    """Stiffness against stretch, N; large enough to have no effect."""


class Strains:
    """Strains of a chain with their stiffnesses and values at rest."""

    def __init__(self) -> None:
        self.strain: list[Any] = []
        self.stiffness: list[float] = []
        self.rest: list[float] = []
        self.damped: list[float] = []

    def add(self, strain: Any, stiffness: float, rest: float = 0.0, *, damped: bool = True) -> None:
        self.strain.append(strain)
        self.stiffness.append(stiffness)
        self.rest.append(rest)
        self.damped.append(float(damped))


def overlap(low: Array, high: Array, span: tuple[float, float]) -> Array:
    """Length of each interval within a span."""
    return np.asarray(np.maximum(np.minimum(high, span[1]) - np.maximum(low, span[0]), 0.0))


def motion_of(
    chain: Chain,
    start: tuple[Array, Array, Array],
    drive_at: Callable[[float], float],
    every: tuple[float, int],
    steps: int,
) -> tuple[Array, Array]:
    """Positions (T, 3) of the tip and rotations (T,) of the inner tube there, once in `every` (time step, count).

    Args:
        start: nodes (N + 1, 3), rotations (N + 1, 2) and those of the inner tube behind the plate (B,), at rest.
        drive_at: rotation of the drive of the inner tube at a time.
        steps: number T of results.
    """
    nodes, theta, behind = start
    n, h, b = chain.cells, chain.length / chain.cells, len(behind)
    s: Array = h * np.arange(n + 1.0)
    low, high = np.maximum(s - h / 2, 0.0), np.minimum(s + h / 2, chain.length)
    cell, within = high - low, [overlap(low, high, (0.0, end)) for end in chain.end]
    curved, step_behind = [overlap(low, high, span) for span in chain.curved], chain.transmission / b
    # Positions of all nodes but the clamped one, rotations of all, and the shaft from the drive to the plate.
    q, first_turn, first_shaft = ca.SX.sym("q", 5 * n + 2 + b), 3 * n, 5 * n + 2
    drive, rate, strains = ca.SX.sym("alpha"), ca.SX.sym("rate", 5 * n + 2 + b), Strains()
    place = [ca.SX(3, 1), *(q[3 * k : 3 * k + 3] for k in range(n))]
    turn = [q[first_turn + 2 * k : first_turn + 2 * k + 2] for k in range(n + 1)]
    tangent, axis = ca.SX([0.0, 0.0, 1.0]), ca.SX([1.0, 0.0, 0.0])
    for k in range(n):
        edge = place[k + 1] - place[k]
        size = ca.norm_2(edge)
        strains.add(size, chain.stretching / h, h, damped=False)
        unit = edge / size
        across, along = ca.cross(tangent, unit), 1 + ca.dot(tangent, unit)
        carried = axis * (along - 1) + ca.cross(across, axis) + across * ca.dot(across, axis) / along
        bend = 2 * across / along
        x = ca.dot(bend, axis + carried) / 2
        y = ca.dot(bend, ca.cross(tangent, axis) + ca.cross(unit, carried)) / 2
        for i in range(2):
            if within[i][k]:
                cos, sin = ca.cos(turn[k][i]), ca.sin(turn[k][i])
                stiffness, natural = chain.bending[i] * within[i][k], chain.curvature[i] * curved[i][k] / within[i][k]
                strains.add((cos * x + sin * y) / cell[k], stiffness, natural)
                strains.add((cos * y - sin * x) / cell[k], stiffness)
        tangent, axis = unit, carried
    for i in range(2):
        for k in range(n):
            # Nodes beyond the end of a tube follow it.
            share = max(float(overlap(s[k : k + 1], s[k + 1 : k + 2], (0.0, chain.end[i]))[0]) / h, 1e-3)
            strains.add(turn[k + 1][i] - turn[k][i], chain.twisting[i] / h * share)
    shaft = [drive, *(q[first_shaft + k] for k in range(b))]
    for k in range(b):
        strains.add(shaft[k + 1] - shaft[k], chain.twisting[0] / step_behind)
    strain, c = ca.vertcat(*strains.strain), ca.DM(strains.stiffness)
    stretched = strain - ca.DM(strains.rest)
    stretched += chain.relaxation * ca.DM(strains.damped) * ca.jtimes(strain, q, rate)
    force = -ca.jtimes(strain, q, c * stretched, True)
    # The last node of the shaft is the inner tube at the plate; the outer tube is held there.
    last, plate = first_shaft + b - 1, first_turn
    force[last] += force[plate]
    inverse = np.zeros(q.numel())
    inverse[:first_turn] = 1 / np.repeat((chain.mass[0] * cell + chain.mass[1] * within[1])[1:], 3)
    for i in range(2):
        inverse[first_turn + 2 + i : first_shaft : 2] = 1 / (chain.inertia[i] * np.maximum(within[i], h / 20)[1:])
    inverse[first_shaft:] = 1 / (chain.inertia[0] * step_behind)
    inverse[last] = 2 / (chain.inertia[0] * (step_behind + h))
    acceleration = ca.Function("a", [q, rate, drive], [ca.DM(inverse) * force], {"cse": True})

    dt, count = every
    old, velocity, fixed = ca.MX.sym("q", q.numel()), ca.MX.sym("v", q.numel()), ca.MX.sym("alpha")
    half = velocity + dt / 2 * acceleration(old, velocity, fixed)
    new = old + dt * half
    new[plate] = new[last]
    after = half + dt / 2 * acceleration(new, half, fixed)
    verlet = ca.Function("verlet", [ca.vertcat(old, velocity), fixed], [ca.vertcat(new, after)]).fold(count)
    state = np.concatenate([nodes[1:].ravel(), theta.ravel(), behind, np.zeros(q.numel())])
    tips, turns = [], []
    for k in range(steps):
        tips.append(state[first_turn - 3 : first_turn])
        turns.append(state[first_shaft - 2])
        state = np.asarray(verlet(state, drive_at((k + 0.5) * count * dt))).ravel()
    return np.array(tips), np.array(turns)
