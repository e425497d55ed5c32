"""Own costs and constraints of inverse kinematics: expressions of the quantities of one pose."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

import numpy as np

from ..block.custom import CustomObjective, CustomRequirement
from ..block.quantities import Expression, Quantity, recorded
from ..equilibrium.linearised import curvature_at, place_at, position_at
from ..errors import InputError
from ..stability import snap_free_certificate
from ..typing import Array
from .posture import Posture

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Extras:
    """Own cost and constraints with their expressions."""

    cost: tuple[CustomObjective, Expression] | None = None
    constraints: tuple[tuple[CustomRequirement, Expression], ...] = ()

    def room(self, at: Posture) -> Array:
        """(c,) of every number of every constraint, in steps of its size, >= 0 where it is kept."""
        # A little inside, so that solving again on a finer mesh still finds them kept.
        parts = [_asked(one, partial(e, values(at))) / one.size - 1e-6 for one, e in self.constraints]
        return np.concatenate([np.zeros(0), *parts])

    def slopes(self, at: Posture) -> Array:
        """(c, m) change of `room` with the joints."""
        # A little inside, so that solving again on a finer mesh still finds them kept.
        parts = [_asked(one, partial(e.linear, linear(at)))[1] / one.size for one, e in self.constraints]
        return np.concatenate([np.zeros((0, len(at.q))), *parts])

    def price(self, at: Posture) -> float:
        """The cost, as minimised."""
        if self.cost is None:
            return 0.0
        one, expression = self.cost
        return float(one.sign * one.weight * _asked(one, partial(expression, values(at)))[0])

    def price_slope(self, at: Posture) -> Array:
        """(m,) of the cost."""
        if self.cost is None:
            return np.zeros(len(at.q))
        one, expression = self.cost
        slope: Array = one.sign * one.weight * _asked(one, partial(expression.linear, linear(at)))[1][0]
        return slope

    def broken(self, at: Posture) -> list[str]:
        """Words of the constraints that hold a posture, or that it does not keep."""
        return [one.words for one, e in self.constraints if e(values(at)).min() < 1e-4 * one.size]


NOTHING = Extras()


def extras(cost: CustomObjective | None, constraints: Sequence[CustomRequirement], n: int) -> Extras:
    """Own cost and constraints, checked and recorded."""
    for one in constraints:
        if not isinstance(one, CustomRequirement):
            raise InputError(f"extra_constraints contains {one!r}; it must be a sequence of CustomRequirement")
        one.checked()
    if cost is None:
        found = None
    elif isinstance(cost, CustomObjective):
        cost.checked()
        found = cost, recorded(cost.expression, n, 1, cost.words)
        if found[1].value.numel_out() != 1:
            raise InputError(f"the cost {cost.words} has {found[1].value.numel_out()} numbers; it must be one")
    else:
        raise InputError(f"extra_cost is {cost!r}; it must be a CustomObjective")
    return Extras(found, tuple((one, recorded(one.expression, n, 1, one.words)) for one in constraints))


def _asked(one: CustomObjective | CustomRequirement, ask: Callable[[], T]) -> T:
    try:
        return ask()
    except FloatingPointError:
        raise InputError(f"the expression of {one.words} is not finite at a pose on the path to the target") from None


def values(at: Posture) -> Callable[[Quantity], Array]:
    """Quantities of a posture as numbers."""

    def look(one: Quantity) -> Array:
        """One quantity of the posture."""
        here = at.equilibrium
        match one.name:
            case _ if isinstance(one.pose, tuple):
                raise InputError("deployment poses are available in designs only")
            case "strain" | "clearance" | "deflection" | "margin_under" | "jacobian" | "turning" | "stroke_force":
                raise InputError(f"the {one.name.replace('_', ' ')} of a pose is available in designs only")
            case "certificate":
                return np.array([snap_free_certificate(at.space.robot, np.array(one.at))])
            case "tip_direction":
                return at.direction
            case "position":
                return place_at(at.derivatives, one.at[0])
            case "curvature" if one.at:
                return curvature_at(at.derivatives, one.at[0])[0]
            case name if one.pose is None:
                return np.array([getattr(tube, name) for tube in at.space.robot.tubes])
            case name:
                return np.atleast_1d(getattr(here, name))

    return look


def linear(at: Posture) -> Callable[[Quantity], tuple[Array, Array]]:
    """Quantities of a posture, and their change (.., m) with its joints."""
    n = at.space.robot.n_tubes

    def slope(one: Quantity) -> Array:
        """(..., m) change of a quantity with the joints."""
        match one.name:
            case "rotations":
                return at.space.spread[:n]
            case "translations":
                return at.space.spread[n:]
            case "tip_position":
                return at.jacobian[0]
            case "tip_direction":
                return np.cross(at.jacobian[1], at.direction[:, None], axis=0)
            case "margin":
                return at.margin_slope()[None]
            case "position":
                return position_at(at.derivatives, one.at[0])[1] @ at.space.spread
            case "curvature" if one.at:
                return curvature_at(at.derivatives, one.at[0])[1] @ at.space.spread
            case _:
                return np.zeros((one.size(n), len(at.q)))

    look = values(at)
    return lambda one: (look(one), slope(one))
