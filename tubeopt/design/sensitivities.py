"""Active limits of a design and their prices, dimensions at a bound, and tubes without effect."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import scipy

from ..constants import GRAVITY
from ..files.field_metadata import form, key
from ..robots.robot import Robot
from ..robots.tubes import Tube, mass_per_length
from ..typing import Array
from .constraints import Limit
from .evaluation import Attempt, prices
from .parameters import UNITS
from .solve import cell_of, cell_rows

# Steps of a limit within which it may be active. A design at which IPOPT did not converge is no nearer to its limits.
ACTIVE_LIMIT = 1e-3

# Part of the objective's slope that no multipliers of active limits explain. Above it the design is no optimum to first
# order, and prices would be wrong by at least that part.
OPTIMALITY_GAP = 0.02

# Relative to the largest price: multipliers of inactive limits are of the size of IPOPT's barrier parameter.
MIN_PRICE = 1e-6


@dataclass(frozen=True)
class Sensitivity:
    """Derivative of the objective by one active limit."""

    limit: Limit
    """Active limit."""
    derivative: Annotated[float, key("derivative_si"), "derivative of the objective by the limit, both in SI"]
    """Derivative in the objective's own sign; with several objectives, of their minimised weighted sum."""
    sentence: Annotated[str, key("words"), "gain from relaxing the limit, as text"]


def sensitivities(design: Attempt) -> tuple[Sensitivity, ...]:
    """Active limits of an optimum, the most expensive first; empty if the design is no optimum to first order."""
    multipliers = _multipliers(design)
    if multipliers is None:
        return ()
    groups = design.evaluated.groups
    per_step = zip(groups, prices(groups, multipliers[0]), strict=True)
    costs = [(group.limit, price / group.limit.size) for group, price in per_step]
    costs += _bounds(design, multipliers[1])
    effect = [price * limit.size for limit, price in costs]
    largest = max(effect, default=0.0)
    order = np.argsort(effect)[::-1]
    smallest = MIN_PRICE * max(largest, 1e-300)
    return tuple(_sensitivity(design, *costs[k]) for k in order if effect[k] > smallest > 0)


def _multipliers(design: Attempt) -> tuple[Array, Array] | None:
    """Multipliers of the rows and of the bounds (> 0 at a lower one), from IPOPT if it converged.

    Otherwise those that satisfy the conditions of optimality best at the design; None if it is no optimum.
    """
    if design.optimum is not None and design.optimum.success:
        return design.optimum.multipliers, design.optimum.bound_multipliers
    program, x = design.program, design.x
    evaluated = design.evaluated
    values, jacobian = evaluated.rows()
    sections = cell_rows(evaluated.state, cell_of(evaluated.state))
    active = np.flatnonzero(values < ACTIVE_LIMIT)
    closed = np.flatnonzero(sections.lengths < ACTIVE_LIMIT)
    low, high = ((program.scale * ACTIVE_LIMIT > abs(x - bound)) for bound in (program.lower, program.upper))
    unit = np.eye(len(x))
    columns = [jacobian[active], sections.slopes[closed], -sections.slopes[closed], unit[low], -unit[high]]
    matrix = (np.concatenate(columns) * program.scale).T
    slope = evaluated.objective[1] * program.scale
    if not matrix.size:
        return None  # nothing is near
    price, residual = scipy.optimize.nnls(matrix, slope)
    if residual > OPTIMALITY_GAP * float(np.linalg.norm(slope)):
        return None
    out = np.zeros(len(values))
    out[active] = price[: len(active)]
    bounds = np.zeros(len(x))
    first = len(active) + 2 * len(closed)
    bounds[low] = price[first : first + low.sum()]
    bounds[high] -= price[first + low.sum() :]
    return out, bounds


def _bounds(design: Attempt, multipliers: Array) -> list[tuple[Limit, float]]:
    """Active bounds of the dimensions, with their prices."""
    space = design.program.layout.space
    out = []
    for k, (name, unknown) in enumerate(zip(space.names, space.unknowns, strict=True)):
        price = float(multipliers[k])
        is_upper = price < 0
        unit, factor = ("", 1.0) if unknown.scaled else UNITS[unknown.field]
        value = float((space.upper if is_upper else space.lower)[k])
        description = f"{'upper' if is_upper else 'lower'} bound of the {name}"
        at_bound = abs(design.x[k] - value) <= 1e-4 * space.scale[k]
        if at_bound and space.upper[k] > space.lower[k]:
            size = min(float(space.scale[k]), 0.2 * abs(value)) if value else float(space.scale[k])
            out.append(
                (Limit(description, value, is_upper_bound=is_upper, unit=unit, factor=factor, size=size), abs(price))
            )
    return out


def _sensitivity(design: Attempt, limit: Limit, price: float) -> Sensitivity:
    """Sensitivity to a limit; `price` is the decrease of the minimised objective per SI unit of relaxation."""
    objectives = design.program.task.objectives
    sign = 1.0 if limit.is_upper_bound else -1.0
    if len(objectives) == 1 and objectives[0].weight == 1.0:
        objective = objectives[0]
        name, unit, factor, direction = objective.description, objective.unit, objective.factor, objective.sign
    else:
        name, unit, factor, direction = "weighted objective", "", 1.0, 1
    derivative = -direction * price * sign
    # a round amount of the limit, in the unit in which it is shown
    step = float(10.0 ** np.floor(np.log10(max(limit.size * limit.factor, 1e-12)) + 1e-9))
    gain = abs(price) * step / limit.factor * factor
    verb = "more" if limit.is_upper_bound else "less"
    change = "less" if direction > 0 else "more"
    shown = f"{step:g} {limit.unit}".strip()
    sentence = f"{shown} {verb} {limit.description} buys {f'{gain:.3g} {unit}'.strip()} {change} {name}"
    return Sensitivity(limit, derivative, sentence)


@dataclass(frozen=True)
class Dimension:
    """Free dimension before and after the design."""

    name: Annotated[str, "name of the dimension and its tube"]
    unit: Annotated[str, "unit of its values"]
    before: Annotated[float, form(".5g", label="before"), "value of the given robot"]
    after: Annotated[float, form(".5g", label="after"), "value of the design"]
    bound: str
    """"lower" or "upper" if the dimension is at that bound, else ""."""


def remarks(robot: Robot, dimensions: Sequence[Dimension]) -> tuple[str, ...]:
    """Sentences on a designed robot, each with its number."""
    at_bounds = (
        f"{each.name} lies on its {each.bound} bound, {each.after:.4g} {each.unit}, which the design hangs on"
        for each in dimensions
        if each.bound
    )
    return (*at_bounds, *_without_effect(robot))


def _without_effect(robot: Robot) -> Iterator[str]:
    """Remarks on tubes that move the arm at home less by their bend than the stiffest tube sags under its own weight.

    The bend has the curvature kb kappa / sum kb over the tubes at each place, the sag is w L^4 / (8 kb).
    """
    stiff = np.array([float(tube.bending_stiffness) for tube in robot.tubes])
    stiffest = int(stiff.argmax())
    outer = robot.tubes[stiffest]
    mass = mass_per_length(outer)
    if mass is None or robot.n_tubes == 1:
        return
    sag = mass * GRAVITY * outer.curved_length**4 / (8 * stiff[stiffest])
    ends = np.array([tube.length for tube in robot.tubes]) + robot.home_translations
    for i, tube in enumerate(robot.tubes):
        moved = _bend_of(tube, float(ends[i]), ends, stiff)
        if moved < sag:
            yield (
                f"tube {i + 1} bends the arm by {moved * 1e3:.2g} mm. Tube {stiffest + 1}, the stiffest, sags by "
                f"{sag * 1e3:.2g} mm under its own weight, which is more: tube {i + 1} may be straight"
            )


def _bend_of(tube: Tube, end: float, ends: Array, kb: Array) -> float:
    """Displacement, m, of the end of a tube because of its bend; kb and `ends` are those of all tubes."""
    start = end - tube.curved_length
    cuts = np.unique(np.clip([start, *ends, end], start, end))
    present = ends > 0.5 * (cuts[1:] + cuts[:-1])[:, None]
    bend = float(tube.bending_stiffness) * abs(tube.curvature) / (present * kb).sum(1)
    lever = end - cuts
    return float((bend * (lever[:-1] ** 2 - lever[1:] ** 2) / 2).sum())
