"""Residuals around a fit, to first order in the parameters of its effects and of those that it lacks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError, SolveError
from ..typing import Array, Index
from .descent import Descent, Weights
from .held_out import predicted_held_out
from .model import ArmModel, State
from .parameters import Parameter, apply
from .subsets import Effects, HeldOutSets, Linear


@dataclass(frozen=True, eq=False)
class Slopes:
    """Around a fit to V observations, with P parameters and F freedoms of the registration.

    model: with all parameters, those of the fit first.   state: where they are.   there: effects of the fit.
    residuals: (V, 3) of the fit.   table: (V, 3, P + F) derivatives.
    jumps: residuals (V, 3) that an effect brings at once which is there at its start already.
    """

    model: ArmModel
    state: State
    there: Effects
    residuals: Array
    table: Array
    jumps: Mapping[str, Array]

    def of(self, parameters: Sequence[Parameter]) -> Array:
        """(V, 3, Q + F) derivatives by some of the parameters, in their order."""
        names = [p.name for p in self.model.parameters]
        count = len(names)
        return self.table[..., [*(names.index(p.name) for p in parameters), *range(count, count + self.model.freedoms)]]

    def sets(self, weights: Weights, fold: Index) -> HeldOutSets:
        """Sets of effects; weights with the priors of all parameters, fold (N,) of each row."""
        chosen, x = self.model.parameters, self.state.x
        away = np.array([p.start for p in chosen]) - x
        directed = int(self.model.directed.sum())
        return HeldOutSets(
            Linear(
                residuals=self.residuals,
                slopes=self.table,
                weights=weights.of(self.residuals),
                fold=fold[self.model.row],
                numbers=3 * len(self.model.row) - directed,
                kinds=tuple(p.kind for p in chosen),
                there=self.there,
                absent=np.where([p.kind in self.jumps for p in chosen], 0.0, away),
                drawn=away,
                prior=weights.prior,
                low=np.array([p.low for p in chosen]) - x,
                high=np.array([p.high for p in chosen]) - x,
                jumps=self.jumps,
            )
        )

    def beside(self, kind: str, weights: Weights, fold: Index) -> Array:
        """(V, 3) residuals held out with one more effect than the fit has; weights as for `sets`."""
        own = np.array([p.kind == kind or p.kind in self.there for p in self.model.parameters])
        fewer = self.model.with_parameters([p for p, mine in zip(self.model.parameters, own, strict=True) if mine])
        residuals = self.residuals + self.jumps.get(kind, 0.0)
        state = State(self.state.x[own], self.state.registration)
        near = Descent(state, residuals, self.of(fewer.parameters), True)
        return predicted_held_out(fewer, replace(weights, prior=weights.prior[own]), near, fold)


def slopes_around(model: ArmModel, fit: Descent, others: Sequence[Sequence[Parameter]]) -> Slopes:
    """Slopes around a fit of the parameters of a model, and by those of other effects at their starts.

    An effect that cannot begin, since there is no such robot, is left out.
    """
    own, motion = model.parameters, fit.state.registration
    table, jumps, chosen = [fit.jacobian[..., : len(own)]], dict[str, Array](), list(own)
    late = [some for some in others if _begins(model, some)]
    early = [some for some in others if some not in late]
    for some in ([p for each in early for p in each], *late):
        more = model.with_parameters([*own, *some])
        state = State(np.append(fit.state.x, [p.start for p in some]), motion)
        try:
            slopes = more.jacobian(state, skip=len(own))
            jump = more.residuals(state) - fit.residuals
        except (InputError, SolveError):
            continue
        table.append(slopes[..., len(own) : len(own) + len(some)])
        chosen += some
        if some in late:
            jumps[some[0].kind] = jump
    for kind in dict.fromkeys(p.kind for p in own):
        mine = np.array([p.kind == kind for p in own])
        if _begins(model, [p for p in own if p.kind == kind]):
            fewer = model.with_parameters([p for p in own if p.kind != kind])
            jumps[kind] = fit.residuals - fewer.residuals(State(fit.state.x[~mine], motion))
    x = np.append(fit.state.x, [p.start for p in chosen[len(own) :]])
    return Slopes(
        model=model.with_parameters(chosen),
        state=State(x, motion),
        there=Effects(p.kind for p in own),
        residuals=fit.residuals,
        table=np.concatenate([*table, fit.jacobian[..., len(own) :]], axis=2),
        jumps=jumps,
    )


def _begins(model: ArmModel, chosen: Sequence[Parameter]) -> bool:
    """Whether an effect is there at its start already, where having none has no slope."""
    first = model.first
    return not apply(first, chosen, np.array([p.start for p in chosen])).same_tubes(first)
