"""Sets of effects, and what each would lose held out, were the observations linear in the parameters around a state.

All that a least-squares fit needs of the observations are sums over them, kept here block by block: a set of effects is
fitted to all folds but one and held out in a small linear solve, so that hundreds of sets cost less than one pass
through the data.

What is lost held out prefers no set that is there over one with a few idle parameters more (Shao, J. Am. Stat. Assoc.
88 (1993)), and the best of many candidates gains by chance. So each parameter is charged, as by Schwarz (Ann. Stat. 6
(1978)) and by Foster and George (Ann. Stat. 22 (1994)): together with what holding out charges already, twice the
variance inflation, it must gain the logarithm of the number of observations, or twice that of the number of candidates.
The inflation, by which errors that neighbouring rows share make parameters less certain than independent ones would,
is the optimism of the fit: how much more is lost held out than by the fit to all, over the same for independent
errors (Takeuchi, Suri-Kagaku 153 (1976)).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError, SolveError
from ..solvers.robust_least_squares import Descent, Weights
from ..typing import Array, Index, Mask
from .descent import predicted_held_out
from .model import ArmModel, State
from .parameters import Parameter, apply

Effects = frozenset[str]

LEAST = 4.0
"""A parameter must gain so much at least, in squares of its standard error: two standard errors."""


@dataclass(eq=False)
class HeldOutSets:
    """What sets of effects lose, held out and by the fit to all: by residuals around a state, with every effect that
    may be part of a set, P parameters and F freedoms besides.

    Attributes:
        inflation: of the variance of parameters, 1 for independent errors.
        price: what a parameter must gain by the fit to all, two standard errors.
        charge: of a parameter, beside what is lost held out.
    """

    residuals: Array
    """(V, 3)."""
    slopes: Array
    """(V, 3, P + F)."""
    weights: Array
    """(V,) of the squares of residuals."""
    fold: Index
    """(V,)."""
    numbers: int
    """How many are independent."""
    kinds: tuple[str, ...]
    """(P,) effect of each parameter."""
    there: Effects
    """Effects that are part of the state."""
    absent: Array
    """(P,) what to add to each to be without it."""
    drawn: Array
    """(P,) what to add to be as drawn."""
    prior: Array
    """(P,) standard deviation around that."""
    low: Array
    """(P,) least change."""
    high: Array
    """(P,) greatest change."""
    jumps: Mapping[str, Array]
    """(V, 3) residuals that an effect brings at once, where parameters alone do not say what it is to be without it."""

    def __post_init__(self) -> None:
        self.names, self.count, v = tuple(dict.fromkeys(self.kinds)), len(self.kinds), len(self.residuals)
        parts = [self.slopes.reshape(3 * v, -1), *(jump.reshape(-1, 1) for jump in self.jumps.values())]
        table = np.hstack([*parts, self.residuals.reshape(-1, 1)])
        table *= np.sqrt(np.repeat(self.weights, 3))[:, None]
        size = np.sqrt((table[:, :-1] ** 2).sum(0))
        self.scale = np.where(size > 0, size, 1.0)  # what moves nothing stays as drawn
        table[:, :-1] /= self.scale
        rows = np.repeat(self.fold, 3)
        self.squares = np.array([table[rows == k].T @ table[rows == k] for k in np.unique(self.fold)])
        self.free = self.slopes.shape[2] - self.count
        own = self.scale[: self.count]
        self.absent, self.drawn, self.low, self.high = (
            each * own for each in (self.absent, self.drawn, self.low, self.high)
        )
        self.inverse = 1 / (self.prior * own) ** 2
        self.known: dict[Effects, float] = {}
        optimism = self.lost(self.there) - self.seen(self.there)
        self.inflation = max(1.0, optimism / (2 * max(self.parameters(self.there) + self.free, 1)))
        least = max(math.log(self.numbers / self.inflation), 2 * math.log(max(self.count, 1)), LEAST)
        self.price, self.charge = self.inflation * LEAST, self.inflation * (least - 2)

    def parameters(self, effects: Iterable[str]) -> int:
        """How many a set has."""
        return sum(self.kinds.count(kind) for kind in effects)

    def cost(self, effects: Effects) -> float:
        """What a set loses held out, and what its parameters are charged."""
        if effects not in self.known:
            self.known[effects] = self.lost(effects) + self.charge * self.parameters(effects)
        return self.known[effects]

    def lost(self, effects: Effects) -> float:
        """What a set loses held out."""
        total = self.squares.sum(0)
        steps = (self._step(effects, total - own) for own in self.squares)
        return float(sum(step @ own @ step for step, own in zip(steps, self.squares, strict=True)))

    def seen(self, effects: Effects) -> float:
        """What it loses by the fit to all."""
        total = self.squares.sum(0)
        step = self._step(effects, total)
        return float(step @ total @ step)

    def _step(self, effects: Effects, square: Array) -> Array:
        """The step of least loss by a sum of squares; a parameter at the edge of its range is held there."""
        n, step = self.count, np.zeros(len(square))
        chosen = np.array([kind in effects for kind in self.kinds], dtype=bool)
        step[:n] = np.where(chosen, 0.0, self.absent)
        here = [(kind in effects) - float(kind in self.there) for kind in self.jumps]
        step[n + self.free : -1] = here * self.scale[n + self.free :]
        step[-1] = 1.0
        free = np.concatenate([chosen, np.ones(self.free, dtype=bool), np.zeros(len(here) + 1, dtype=bool)])
        while free.any():
            step[free] = 0.0
            self._solve(square, step, free)
            beyond = free[:n] & ((step[:n] < self.low - 1e-9) | (step[:n] > self.high + 1e-9))
            if not beyond.any():
                break
            step[:n][beyond] = np.clip(step[:n], self.low, self.high)[beyond]
            free[:n] &= ~beyond
        return step

    def _solve(self, square: Array, step: Array, free: Mask) -> None:
        """Fill in the free part of a step."""
        at = np.flatnonzero(free)
        own = np.flatnonzero(at < self.count)
        matrix, slope = square[np.ix_(at, at)], square[at] @ step
        matrix[own, own] += self.inverse[at[own]]
        slope[own] -= (self.drawn * self.inverse)[at[own]]
        matrix[np.arange(len(at)), np.arange(len(at))] += 1e-12
        step[at] = -np.linalg.solve(matrix, slope)

    def explore(self, starts: Sequence[Effects] = ()) -> list[Effects]:
        """Sets in the order of their costs: all beside the way of single changes that leads down from each start, by
        default from the set that is there, from none and from all."""
        for start in starts or (self.there, Effects(), Effects(self.names)):
            best = start
            while (found := min([best, *self.around(best)], key=self.cost)) != best:
                best = found
        return sorted(self.known, key=self.cost)

    def chosen_anew(self) -> Array:
        """(V, 3) residuals of every fold by the set that the other folds choose, fitted to these."""
        out, total = np.empty_like(self.residuals), self.squares.sum(0)
        columns = [self.slopes, *(jump[..., None] for jump in self.jumps.values())]
        for k, label in enumerate(np.unique(self.fold)):
            rest = copy(self)
            rest.squares, rest.known = np.delete(self.squares, k, axis=0), {}
            # From no effect: the set that is there was chosen with this fold.
            best = rest.explore([Effects()])[0]
            step = self._step(best, total - self.squares[k])[:-1] / self.scale
            mine = self.fold == label
            table = np.concatenate([column[mine] for column in columns], axis=2)
            out[mine] = self.residuals[mine] + table @ step
        return out

    def around(self, effects: Effects) -> list[Effects]:
        """Sets with one effect more, one less, or one in the place of another."""
        more = [kind for kind in self.names if kind not in effects]
        less = [effects - {kind} for kind in sorted(effects)]
        return [effects | {kind} for kind in more] + less + [some | {kind} for some in less for kind in more]


@dataclass(frozen=True, eq=False)
class Slopes:
    """Around a fit to V observations, with P parameters and F freedoms of the registration."""

    model: ArmModel
    """With all parameters, those of the fit first."""
    state: State
    """Where they are."""
    there: Effects
    """Effects of the fit."""
    residuals: Array
    """(V, 3) of the fit."""
    table: Array
    """(V, 3, P + F) derivatives."""
    jumps: Mapping[str, Array]
    """(V, 3) residuals that an effect brings at once which is there at its start already."""

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

    def beside(self, kind: str, weights: Weights, fold: Index) -> Array:
        """(V, 3) residuals held out with one more effect than the fit has; weights as for `sets`."""
        own = np.array([p.kind == kind or p.kind in self.there for p in self.model.parameters])
        fewer = self.model.with_parameters([p for p, mine in zip(self.model.parameters, own, strict=True) if mine])
        residuals = self.residuals + self.jumps.get(kind, 0.0)
        state = State(self.state.x[own], self.state.registration)
        near = Descent(state, residuals, self.of(fewer.parameters), True)
        return predicted_held_out(fewer, replace(weights, prior=weights.prior[own]), near, fold)


def slopes_around(model: ArmModel, fit: Descent[State], others: Sequence[Sequence[Parameter]]) -> Slopes:
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
