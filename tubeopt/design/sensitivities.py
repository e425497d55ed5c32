"""What limits a design: prices of active limits, dimensions at a bound, and tubes that it does not need."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import scipy

from ..constants import GRAVITY
from ..files.field_metadata import form, key
from ..robots.concentric import ConcentricRobot
from ..robots.tubes import Tube, mass_per_length
from ..typing import Array
from .constraints import Limit
from .evaluation import Attempt, prices
from .parameters import UNITS
from .solve import cell_of, cell_rows

# Steps of a limit within which it may be active. A design at which IPOPT did not converge is no nearer to its limits.
NEAR_LIMIT = 1e-3

# Part of the objective's slope that no multipliers of active limits explain. Above it the design is no optimum to first
# order, and prices would be wrong by at least that part.
OPTIMALITY_GAP = 0.02

# Relative to the largest price: multipliers of inactive limits are of the size of IPOPT's barrier parameter.
LEAST_PRICE = 1e-6


@dataclass(frozen=True)
class Sensitivity:
    """How the objective changes with one limit that binds, to first order."""

    limit: Limit
    """What is limited."""
    derivative: Annotated[float, key("derivative_si"), "derivative of the objective by the limit, both in SI"]
    """In the objective's own sign; with several objectives, of their weighted sum, as minimised."""
    sentence: Annotated[str, key("words"), "gain from relaxing the limit, as text"]


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
    least = LEAST_PRICE * max(largest, 1e-300)
    return tuple(_sensitivity(found, *costs[k]) for k in order if effect[k] > least > 0)


def _multipliers(found: Attempt) -> tuple[Array, Array] | None:
    """Multipliers of the rows and of the bounds (> 0 at a lower one): IPOPT's where it converged, else the ones that
    come closest to the conditions of optimality at the design; None where those do not hold."""
    if found.optimum is not None and found.optimum.success:
        return found.optimum.multipliers, found.optimum.bound_multipliers
    program, x = found.program, found.x
    there = found.evaluated
    values, jacobian = there.rows()
    sections = cell_rows(there.state, cell_of(there.state))
    near = np.flatnonzero(values < NEAR_LIMIT)
    closed = np.flatnonzero(sections.lengths < NEAR_LIMIT)
    low, high = ((program.scale * NEAR_LIMIT > abs(x - bound)) for bound in (program.lower, program.upper))
    unit = np.eye(len(x))
    columns = [jacobian[near], sections.slopes[closed], -sections.slopes[closed], unit[low], -unit[high]]
    matrix = (np.concatenate(columns) * program.scale).T
    slope = there.objective[1] * program.scale
    if not matrix.size:
        return None  # nothing is near
    price, gap = scipy.optimize.nnls(matrix, slope)
    if gap > OPTIMALITY_GAP * float(np.linalg.norm(slope)):
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


@dataclass(frozen=True)
class Dimension:
    """One free dimension."""

    name: Annotated[str, "name of the dimension and its tube"]
    unit: Annotated[str, "unit of its values"]
    before: Annotated[float, form(".5g", label="before"), "value of the given robot"]
    after: Annotated[float, form(".5g", label="after"), "value of the design"]
    bound: str
    """The bound that it lies on, "lower" or "upper"; "" where on none."""


def remarks(robot: ConcentricRobot, dimensions: Sequence[Dimension]) -> tuple[str, ...]:
    """Sentences on a designed robot, each with its number."""
    return (*_at_bounds(dimensions), *_useless(robot))


def _at_bounds(dimensions: Sequence[Dimension]) -> Iterator[str]:
    for one in dimensions:
        if one.bound:
            yield f"{one.name} lies on its {one.bound} bound, {one.after:.4g} {one.unit}, which the design hangs on"


def _useless(robot: ConcentricRobot) -> Iterator[str]:
    """Tubes whose bend moves the end of their curved part, at home, by less than the weight of the stiffest tube moves
    its own: as cantilevers, the curvature kb kappa / sum kb of the tubes that are there, and w L^4 / (8 kb)."""
    stiff = np.array([float(tube.bending_stiffness) for tube in robot.tubes])
    stiffest = int(stiff.argmax())
    outer = robot.tubes[stiffest]
    mass = mass_per_length(outer)
    if mass is None or robot.n_tubes == 1:
        return
    sag = mass * GRAVITY * outer.curved_length**4 / (8 * stiff[stiffest])
    ends = np.array([tube.length for tube in robot.tubes]) + robot.home_translations
    for i, tube in enumerate(robot.tubes):
        moved = _moved(tube, float(ends[i]), ends, stiff)
        if moved < sag:
            yield (
                f"tube {i + 1} bends the arm by {moved * 1e3:.2g} mm. Tube {stiffest + 1}, the stiffest, sags by "
                f"{sag * 1e3:.2g} mm under its own weight, which is more: tube {i + 1} may be straight"
            )


def _moved(tube: Tube, end: float, ends: Array, stiff: Array) -> float:
    """How far, m, the end (m from the plate) of a tube is moved by its bend, tubes of `stiff` lying up to `ends`."""
    begin = end - tube.curved_length
    cuts = np.unique(np.clip([begin, *ends, end], begin, end))
    there = ends > 0.5 * (cuts[1:] + cuts[:-1])[:, None]
    bend = float(tube.bending_stiffness) * abs(tube.curvature) / (there * stiff).sum(1)
    lever = end - cuts
    return float((bend * (lever[:-1] ** 2 - lever[1:] ** 2) / 2).sum())
