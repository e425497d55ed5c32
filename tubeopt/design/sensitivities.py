"""What a limit costs: multipliers of the optimum in physical units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from ..typing import Array
from .attempt import Attempt, prices
from .cells import cell_of, cell_rows
from .constraints import Limit
from .parameters import UNITS


@dataclass(frozen=True)
class Sensitivity:
    """How the objective changes with one limit that binds, to first order."""

    limit: Limit
    """What is limited."""
    derivative: float
    """Of the objective with respect to the limit, SI, in the objective's own sign (with several objectives: of their
    weighted sum, as minimised)."""
    sentence: str
    """The same in words."""


def sensitivities(found: Attempt) -> tuple[Sensitivity, ...]:
    """All limits that bind at an optimum, the dearest first; empty where the design is no optimum to first order."""
    multipliers = _multipliers(found)
    if multipliers is None:
        return ()
    groups = found.evaluated.groups
    per_step = zip(groups, prices(groups, multipliers[0]), strict=True)
    costs = [(group.limit, price / group.limit.size) for group, price in per_step]
    costs += _bounds(found, multipliers[1])
    effect = [price * limit.size for limit, price in costs]
    largest = max(effect, default=0.0)
    order = np.argsort(effect)[::-1]
    least = found.program.task.solver.pricing.least * max(largest, 1e-300)
    return tuple(_sensitivity(found, *costs[k]) for k in order if effect[k] > least > 0)


def _multipliers(found: Attempt) -> tuple[Array, Array] | None:
    """Multipliers of the rows and of the bounds (> 0 at a lower one): IPOPT's where it converged, else the ones that
    come closest to the conditions of optimality at the design; None where those do not hold."""
    if found.optimum is not None and found.optimum.success:
        return found.optimum.multipliers, found.optimum.bound_multipliers
    program, x, pricing = found.program, found.x, found.program.task.solver.pricing
    there = found.evaluated
    values, jacobian = there.rows()
    sections = cell_rows(there.state, cell_of(there.state))
    near = np.flatnonzero(values < pricing.near)
    closed = np.flatnonzero(sections[0] < pricing.near)
    low, high = ((program.scale * pricing.near > abs(x - bound)) for bound in (program.lower, program.upper))
    unit = np.eye(len(x))
    columns = [jacobian[near], sections[1][closed], -sections[1][closed], unit[low], -unit[high]]
    matrix = (np.concatenate(columns) * program.scale).T
    slope = there.objective[1] * program.scale
    if not matrix.size:
        return None  # nothing is near
    price, gap = scipy.optimize.nnls(matrix, slope)
    if gap > pricing.gap * float(np.linalg.norm(slope)):
        return None
    out = np.zeros(len(values))
    out[near] = price[: len(near)]
    bounds = np.zeros(len(x))
    first = len(near) + 2 * len(closed)
    bounds[low] = price[first : first + low.sum()]
    bounds[high] -= price[first + low.sum() :]
    return out, bounds


def _bounds(found: Attempt, multipliers: Array) -> list[tuple[Limit, float]]:
    """Bounds of the dimensions, with what they cost."""
    space = found.program.layout.space
    out = []
    for k, (name, one) in enumerate(zip(space.names, space.unknowns, strict=True)):
        price = float(multipliers[k])
        most = price < 0
        unit, factor = ("", 1.0) if one.scaled else UNITS[one.field]
        value = float((space.upper if most else space.lower)[k])
        words = f"{'upper' if most else 'lower'} bound of the {name}"
        near = abs(found.x[k] - value) <= 1e-4 * space.scale[k]
        if near and space.upper[k] > space.lower[k]:
            size = min(float(space.scale[k]), 0.2 * abs(value)) if value else float(space.scale[k])
            out.append((Limit(words, value, most, unit, factor, size), abs(price)))
    return out


def _sensitivity(found: Attempt, limit: Limit, price: float) -> Sensitivity:
    """`price`: how much less the minimised objective gets per SI unit by which the limit is eased."""
    objectives = found.program.task.objectives
    sign = 1.0 if limit.most else -1.0
    if len(objectives) == 1 and objectives[0].weight == 1.0:
        one = objectives[0]
        name, unit, factor, direction = one.words, one.unit, one.factor, one.sign
    else:
        name, unit, factor, direction = "weighted objective", "", 1.0, 1
    derivative = -direction * price * sign
    # a round amount of the limit, in the unit in which it is shown
    step = float(10.0 ** np.floor(np.log10(max(limit.size * limit.factor, 1e-12)) + 1e-9))
    gain = abs(price) * step / limit.factor * factor
    verb = "more" if limit.most else "less"
    change = "less" if direction > 0 else "more"
    shown = f"{step:g} {limit.unit}".strip()
    sentence = f"{shown} {verb} {limit.words} buys {f'{gain:.3g} {unit}'.strip()} {change} {name}"
    return Sensitivity(limit, derivative, sentence)
