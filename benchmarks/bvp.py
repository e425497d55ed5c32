"""The torsion problem of concentric tubes as SciPy's `solve_bvp` takes it, with the shape integrated afterwards.

Every section is mapped to [0, 1] and has theta and theta' of the tubes present there as its states, so that one call
solves all sections at once; the boundary conditions hold at the plate, between sections, and at each tube's own end.
Jacobians can be given in closed form, or left to `solve_bvp` to find by finite differences, as it does by default.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_bvp, solve_ivp

from tubeopt import ConcentricRobot

from .shooting import Array, Section, sections_of

MAX_NODES = 20_000
"""Twice what the largest mesh of a solve that ends well has; one that needs more fails, long before memory does."""


@dataclass(frozen=True, eq=False)
class Guess:
    """Mesh on [0, 1] and states there, to start from."""

    x: Array
    y: Array


@dataclass(frozen=True, eq=False)
class BvpSolution:
    """Mesh and states, the tip (m), and how many points the mesh has in the end."""

    guess: Guess
    tip_position: Array
    points: int


@dataclass(frozen=True, eq=False)
class Problem:
    """The sections of one configuration, the tubes present in each, and where their states begin in the vector y."""

    sections: tuple[Section, ...]
    present: tuple[Array, ...]
    first: tuple[int, ...]
    torsional: Array
    lever: Array
    rotations: Array
    jacobian_start: Array
    jacobian_stop: Array

    @property
    def size(self) -> int:
        """Number of states."""
        return 2 * sum(len(tubes) for tubes in self.present)


def pose(robot: ConcentricRobot, rotations: Array, translations: Array) -> Problem:
    """Lay out states and boundary conditions, linear with constant matrices: A y(0) + B y(1) = (rotations, 0)."""
    sections = sections_of(robot, translations)
    end = translations + [tube.curved_length for tube in robot.tubes]
    present = tuple(np.flatnonzero(end > (s.start + s.stop) / 2) for s in sections)
    first = tuple(int(k) for k in np.cumsum([0, *(2 * len(tubes) for tubes in present)])[:-1])
    lever = np.array([tube.straight_length for tube in robot.tubes]) - translations
    size = 2 * sum(len(tubes) for tubes in present)
    rows: list[tuple[Array, Array]] = []

    def state(k: int, tube: int, derivative: bool) -> int:
        return first[k] + int(np.searchsorted(present[k], tube)) + derivative * len(present[k])

    def add(start: dict[int, float], stop: dict[int, float]) -> None:
        a, b = np.zeros(size), np.zeros(size)
        for row, entries in ((a, start), (b, stop)):
            for column, value in entries.items():
                row[column] = value
        rows.append((a, b))

    for tube in present[0]:
        add({state(0, tube, False): 1.0, state(0, tube, True): -lever[tube]}, {})
    for k, tubes in enumerate(present):
        for tube in tubes:
            if k + 1 < len(present) and tube in present[k + 1]:
                for derivative in (False, True):
                    add({state(k + 1, tube, derivative): 1.0}, {state(k, tube, derivative): -1.0})
            else:
                add({}, {state(k, tube, True): 1.0})
    starts, stops = (np.array(table) for table in zip(*rows, strict=True))
    torsional = np.array([tube.torsional_stiffness for tube in robot.tubes])
    return Problem(sections, present, first, torsional, lever, rotations, starts, stops)


def untwisted(problem: Problem, points: int = 5) -> Guess:
    """Tubes without torsion on a mesh of few points, which the solver refines."""
    parts = [np.concatenate([problem.rotations[tubes], np.zeros(len(tubes))]) for tubes in problem.present]
    return Guess(np.linspace(0, 1, points), np.tile(np.concatenate(parts)[:, None], (1, points)))


def solve(problem: Problem, guess: Guess, tolerance: float, *, jacobians: bool = True) -> BvpSolution:
    """Torsion by `solve_bvp` with `tolerance`, then the shape by `solve_ivp` (RK45) with a tenth of it."""
    right = np.zeros(problem.size)
    right[: len(problem.present[0])] = problem.rotations[problem.present[0]]
    a, b = problem.jacobian_start, problem.jacobian_stop
    run = solve_bvp(
        lambda x, y: _slope(problem, y),
        lambda start, stop: a @ start + b @ stop - right,
        guess.x,
        guess.y,
        tol=tolerance,
        bc_tol=1e-10,
        max_nodes=MAX_NODES,
        fun_jac=(lambda x, y: _jacobian(problem, y)) if jacobians else None,
        bc_jac=(lambda start, stop: (a, b)) if jacobians else None,
    )
    if not run.success:
        raise RuntimeError(f"solve_bvp failed: {run.message}")
    frame = np.concatenate([np.eye(3).ravel(), np.zeros(3)])
    for k, section in enumerate(problem.sections):
        frame = _shape(problem, k, section, run.sol, frame, tolerance / 10)
    return BvpSolution(Guess(run.x, run.y), frame[9:], len(run.x))


def _slope(problem: Problem, y: Array) -> Array:
    out = np.empty_like(y)
    for section, tubes, first in zip(problem.sections, problem.present, problem.first, strict=True):
        n, h = len(tubes), section.stop - section.start
        theta, w = y[first : first + n], y[first + n : first + 2 * n]
        m = section.moment[tubes, None]
        cos, sin = np.cos(theta), np.sin(theta)
        ux, uy = (m * cos).sum(0) / section.stiffness, (m * sin).sum(0) / section.stiffness
        out[first : first + n] = h * w
        out[first + n : first + 2 * n] = h * m * (ux * sin - uy * cos) / problem.torsional[tubes, None]
    return out


def _jacobian(problem: Problem, y: Array) -> Array:
    out = np.zeros((len(y), *y.shape))
    for section, tubes, first in zip(problem.sections, problem.present, problem.first, strict=True):
        n, h = len(tubes), section.stop - section.start
        theta = y[first : first + n]
        spring = section.coupling[np.ix_(tubes, tubes)][:, :, None] * np.cos(theta[:, None] - theta)
        slope = -spring
        slope[np.arange(n), np.arange(n)] += spring.sum(1)
        out[first : first + n, first + n : first + 2 * n] = h * np.eye(n)[:, :, None]
        out[first + n : first + 2 * n, first : first + n] = h * slope / problem.torsional[tubes][:, None, None]
    return out


def _shape(
    problem: Problem, k: int, section: Section, torsion: Callable[[float], Array], frame: Array, tolerance: float
) -> Array:
    tubes, first, h = problem.present[k], problem.first[k], section.stop - section.start
    m = section.moment[tubes]

    def slope(x: float, y: Array) -> Array:
        theta = torsion(x)[first : first + len(tubes)]
        ux, uy = m @ np.cos(theta) / section.stiffness, m @ np.sin(theta) / section.stiffness
        rotation = y[:9].reshape(3, 3)
        turn = np.stack([-uy * rotation[:, 2], ux * rotation[:, 2], uy * rotation[:, 0] - ux * rotation[:, 1]], axis=1)
        return h * np.concatenate([turn.ravel(), rotation[:, 2]])

    run = solve_ivp(slope, (0.0, 1.0), frame, rtol=tolerance, atol=tolerance)
    return np.asarray(run.y[:, -1])
