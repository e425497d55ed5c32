"""Choice of the breakpoints that pass each other at an optimum of their present order, to first order.

The Lagrangian has a kink where breakpoints meet. Along a step v of the user's variables a distance of breakpoints
changes by t = D v, and the Lagrangian by

    force t                for t >= 0,
    (force + jump) t       for t < 0, where the breakpoints have changed places.

The force is the multiplier of the distance. The jump is the difference of two gradients of the Lagrangian, with the
breakpoints in both orders, over D. The multipliers of the blocks' equations follow from their adjoint equations in each
order; those of all other constraints are those of the solver. If force + jump is negative, the meeting is a minimum in
both orders, and a swap would gain nothing. A small mixed-integer program finds the step with the largest decrease.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import zip_longest
from typing import Any

import numpy as np
import scipy

from ..errors import InputError, SolveError
from ..typing import Array
from .named_program import NamedProgram, ProblemSolution, Stacked

# At a barrier parameter of 1e-5 the multipliers of an order are known well enough for the test.
NEAR_BARRIER, NEAR_STEP = 1e-5, 0.1
"""Barrier parameter and step, scaled, below which the solver is close enough to the optimum of an order."""

NEAR = 1e-3
"""Distance of breakpoints over the arm's length below which they may meet there."""

# On the central path the product of force and distance is the barrier parameter: breakpoints that only touch have both
# equal to its root.
STRICT = 1e3
"""Smallest force over distance, scaled, of breakpoints that press against each other at an iterate."""

LEAST_SLIDE, LEAST_SLOPE = 1e-3, 1e-3
"""Smallest change of a distance that counts as a swap, and smallest decrease of the Lagrangian over the gradient
of the objective, both for a step of 1.
"""

LEAST_GRADIENT = 1e-6
"""Smallest gradient of the objective that counts as one, scaled."""


def order_name(block: Any) -> str:
    """Name of the constraint on the order of the breakpoints of a block."""
    return f"{block.label}order of breakpoints"


@contextmanager
def kept(problem: NamedProgram) -> Iterator[None]:
    """Context after which layouts of the blocks and guesses are as before."""
    layouts = [block.layout for block in problem.blocks]
    guesses = {name: each.guess for name, each in problem.variables.items()}
    try:
        yield
    finally:
        restore(problem, layouts)
        for name, guess in guesses.items():
            problem.set_guess(name, guess)


def restore(problem: NamedProgram, layouts: Sequence[object]) -> None:
    """Set the layouts of all blocks."""
    for block, layout in zip(problem.blocks, layouts, strict=True):
        if block.layout is not layout:
            block.restore(layout)


class Meeting:
    """Test whether breakpoints press against each other, and should pass, at an iterate close to an optimum."""

    def __init__(self, problem: NamedProgram) -> None:
        self.problem = problem
        self.order, self.rows = order_rows(problem)
        swappable = {block: block.swappable() for block in problem.blocks}
        self.may_swap = np.array([row in swappable[block] for block, row in self.order], dtype=bool)
        self.tested = np.zeros(len(self.order), dtype=bool)
        self.last: Array | None = None
        self.passing: dict[Any, list[int]] = {}
        """Rows of every block that pass."""

    def __call__(self, x: Array, g: Array, multipliers: Array, of_bounds: Array) -> bool:
        step = np.inf if self.last is None else float(np.abs(x - self.last).max(initial=0.0))
        self.last = x
        distance, force = g[self.rows], -multipliers[self.rows]
        # On the central path all products are the barrier parameter.
        if step < NEAR_STEP and (distance * force)[self.may_swap].max(initial=0.0) < NEAR_BARRIER:
            pressed = self.may_swap & (distance < NEAR) & (force > STRICT * np.abs(distance)) & ~self.tested
            if pressed.any():
                self.tested |= pressed
                at = self.problem.iterate(x, multipliers, of_bounds)
                self.passing = passing(self.problem, at, pressed, np.abs(distance) < NEAR)
        return bool(self.passing)


def order_rows(problem: NamedProgram) -> tuple[list[tuple[Any, int]], Array]:
    """Distances of breakpoints as (block, row), and their rows in the constraints of the program."""
    blocks, first = {order_name(block): block for block in problem.blocks}, 0
    order: list[tuple[Any, int]] = []
    rows: list[int] = []
    for name, size in problem.constraint_sizes.items():
        if name in blocks:
            order += [(blocks[name], row) for row in range(size)]
            rows += range(first, first + size)
        first += size
    return order, np.array(rows, dtype=np.intp)


def passing(problem: NamedProgram, at: ProblemSolution, tested: Array, near: Array) -> dict[Any, list[int]]:
    """Rows of distances of every block whose breakpoints pass each other with a smaller objective.

    Args:
        at: an optimum in the present order, or an iterate close to it.
        tested: for each of `order_rows`, whether it may pass.
        near: the same, whether its breakpoints meet.
    """
    order, lagrangian = order_rows(problem)[0], Lagrangian(problem, at)
    # Blocks whose breakpoints only touch have nothing to gain.
    strict = {order[k][0] for k in np.flatnonzero(tested & (lagrangian.force > lagrangian.least))}
    table: dict[Any, list[int]] = {}
    for k in np.flatnonzero(tested).tolist():
        if order[k][0] in strict:
            table.setdefault(order[k][0], []).append(k)
    if not table:
        return {}
    # Blocks are independent of each other, so that one row of each is swapped at a time.
    jump, distances, before = np.zeros(len(order)), np.zeros((0, 0)), {block: block.layout.distance for block in table}
    for several in zip_longest(*table.values()):
        swapped = [k for k in several if k is not None]
        with kept(problem):
            try:
                for k in swapped:
                    order[k][0].reorder(at, order[k][1])
                gradient, slopes = lagrangian.gradient(at.values)
            except (InputError, SolveError, RuntimeError):
                # The other order has no equilibrium here, or only a singular one.
                return {}
            if not distances.size:
                # Distances in one order are sums of those in the other.
                for block, matrix in before.items():
                    rows = [k for k, (other, _) in enumerate(order) if other is block]
                    slopes[rows] = matrix @ np.linalg.pinv(block.layout.distance) @ slopes[rows]
                distances = slopes
        change = gradient - distances.T @ lagrangian.force + lagrangian.of_bounds
        jump[swapped] = np.linalg.lstsq(distances[swapped].T, change)[0]
    involved = np.flatnonzero(near & [block in table for block, _ in order])
    force = lagrangian.force[involved]
    slide = _steepest(distances[involved], (force, force + jump[involved]), tested[involved], lagrangian)
    result: dict[Any, list[int]] = {}
    for k in involved[slide < 0].tolist():
        result.setdefault(order[k][0], []).append(order[k][1])
    return result


def _steepest(distances: Array, slopes: tuple[Array, Array], tested: Array, of: Lagrangian) -> Array:
    """Changes t = D v (k,) of distances for the steepest descent of a Lagrangian with kinks.

    Its slope along each t is the first of `slopes` for t >= 0, and the second for t < 0, where only `tested` rows may
    go.
    """
    (count, size), (force, beyond) = distances.shape, slopes
    # Unknowns: v, the positive and the negative part of t, and 1 where t is negative.
    cost = np.concatenate([np.zeros(size), force, -beyond, np.zeros(count)])
    eye, none, far = np.eye(count), np.zeros((count, count)), np.abs(distances).sum(1)
    parts = np.hstack([distances, -eye, eye, none])
    above = np.hstack([np.zeros_like(distances), eye, none, np.diag(far)])
    below = np.hstack([np.zeros_like(distances), none, eye, -np.diag(far)])
    rows = [
        scipy.optimize.LinearConstraint(parts, 0, 0),
        scipy.optimize.LinearConstraint(above, -np.inf, far),
        scipy.optimize.LinearConstraint(below, -np.inf, 0),
    ]
    bounds = scipy.optimize.Bounds(np.r_[of.box[0], np.zeros(3 * count)], np.r_[of.box[1], far, far, tested])
    result = scipy.optimize.milp(
        cost, constraints=rows, bounds=bounds, integrality=np.r_[np.zeros(size + 2 * count), np.ones(count)]
    )
    step = distances @ result.x[:size]
    return (
        np.where(step < -LEAST_SLIDE * far, step, 0.0) if result.success and result.fun < -of.least else np.zeros(count)
    )


class Lagrangian:
    """Gradient of the Lagrangian by the user's variables, without the order of breakpoints, in scaled units.

    The equations of the blocks determine their own variables and, by their adjoint, their multipliers.

    Args:
        at: an optimum in the present order, or an iterate close to it.
    """

    def __init__(self, problem: NamedProgram, at: ProblemSolution) -> None:
        self.problem = problem
        self.labels = labels = tuple(block.label for block in problem.blocks)
        sizes = problem.constraint_sizes
        x, names = Stacked([*problem.variables.values()]), list(problem.variables)
        self.owned = np.repeat([name.startswith(labels) for name in names], [len(at.values[name]) for name in names])
        owned = np.repeat([name.startswith(labels) for name in sizes], list(sizes.values()))
        self.multipliers, of_bounds, equal = problem.scaled_multipliers(at)
        self.equations, self.rows = owned & equal, order_rows(problem)[1]
        self.force, self.of_bounds = -self.multipliers[self.rows], of_bounds[~self.owned]
        gradient = problem.derivative("nlp_grad_f", at.values).toarray()
        self.least = LEAST_SLOPE * np.abs(gradient).max(initial=LEAST_GRADIENT)
        """Slope that counts as none."""
        # Directions in which the user's variables may move: not beyond a bound that is reached.
        values = np.concatenate([at.values[name] for name in names])
        reached = np.abs(np.array([x.lower, x.upper]) - values) < NEAR * x.scale
        self.box = np.where(reached, 0.0, [[-1.0], [1.0]])[:, ~self.owned]

    def gradient(self, values: Mapping[str, Array]) -> tuple[Array, Array]:
        """Gradient, and derivatives (k, v) of the distances of breakpoints, in the present order of the blocks.

        Args:
            values: variables of the user; the blocks are at their guesses.
        """
        own = {name: value for name, value in values.items() if not name.startswith(self.labels)}
        slope, jacobian = (self.problem.derivative(name, own) for name in ("nlp_grad_f", "nlp_jac_g"))
        others = self.multipliers.copy()
        others[self.equations], others[self.rows] = 0.0, 0.0
        total, equations = slope.toarray().ravel() + jacobian.T @ others, jacobian[self.equations]
        adjoint = scipy.sparse.linalg.splu(equations[:, self.owned].T.tocsc()).solve(-total[self.owned])
        return (total + equations.T @ adjoint)[~self.owned], jacobian[self.rows][:, ~self.owned].toarray()
