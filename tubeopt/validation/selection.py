"""Model selection: the set of effects that best predicts rows held out of the fit, with few parameters.

Every effect lowers the error of a fit; only one that is there lowers the error of what is held out, but so does one
that acts like it, and the best of a dozen that are not there may by chance. So whole sets are compared, not effects one
by one: around the fit of a set all others are predicted to first order, for which nothing is solved, and those that
promise most are fitted, until none is better. A set costs what it loses held out, to first order around its own fit,
and a charge for each of its parameters. Of effects that act alike those that stand first in the table of effects are
kept, unless the data speak for others.

All that a least-squares fit needs of the observations are sums over them, kept here block by block: a set of effects is
fitted to all folds but one and held out in a small linear solve, so that hundreds of sets cost less than one pass
through the data.

The loss held out prefers no true set over one with a few idle parameters more (Shao, J. Am. Stat. Assoc. 88 (1993)),
and the best of many candidates gains by chance. So each parameter is charged, as by Schwarz (Ann. Stat. 6 (1978)) and
by Foster and George (Ann. Stat. 22 (1994)): together with what holding out charges already, twice the variance
inflation, it must gain the logarithm of the number of observations, or twice that of the number of candidates. The
inflation, by which errors that neighbouring rows share make parameters less certain than independent ones would, is the
optimism of the fit: how much more is lost held out than by the fit to all, over the same for independent errors
(Takeuchi, Suri-Kagaku 153 (1976)).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Annotated, NamedTuple

import numpy as np

from ..arguments import typed
from ..display import Displayed
from ..errors import InputError, SolveError, nearest
from ..files.field_metadata import form, unit
from ..robots.robot import Robot
from ..solvers.blas import small
from ..solvers.robust_least_squares import RobustDescent, Weights, bounded_step, cost_of, descend
from ..solvers.time_limit import LONG_TIME_LIMIT, limited
from ..typing import Array, Index, Progress
from .comparison import BLOCKS, ErrorSummary, check_registration, check_tubes, distances, registration_error
from .effects import RUBBING, Setup
from .fitting import BY_CHORDS, Fit, FitOptions, FitProblem, calibrated, predicted_held_out, sessions, weigh
from .identifiability import left_out
from .measurements import Measurements, joined, recordings_of
from .model import ParameterState
from .parameters import Parameter, apply, choose_parameters, groups
from .posterior import posterior_of
from .registration import FIRST_GUESS
from .sessions import Registrations, Sessions

# Rounds of choosing effects. A round costs a fit in full; sets that still change after eight go round in circles.
ROUNDS = 8


# Sets of effects, of those that promise most to first order, that are fitted at each round.
TRIED_SETS = 4


# Twice the logarithm of a Bayes factor from which on evidence is worth more than a bare mention (Kass and Raftery,
# J. Am. Stat. Assoc. 90 (1995)). At 10, "very strong", offsets stand in for curvatures in 11 of 60 robots.
EVIDENCE = 2.0


# A set is fitted if it is no more than so much worse to first order, in twice a log likelihood, which curvature of the
# model may make up for.
CROOKED = 30.0


# Fraction of the folds without which an effect must be chosen, too (stability selection: Meinshausen and Buehlmann,
# J. R. Stat. Soc. B 72 (2010)). Of 60 robots with six effects 56 have no false effect in place of 51, for 6 of 108 true
# ones; at 0.6 it is 58 for 16.
STEADY = 0.4


# Fraction of the folds that must agree on the effects.
SETTLED = 0.8


# Weight from which on an effect is certain: sets without it have a quarter of the weight of those with it.
CERTAIN = 0.8


LEAST_WEIGHT = 1e-3
"""Smallest weight of a set of effects in a mean."""


class SetWeight(NamedTuple):
    """Set of effects and its weight in a mean over sets."""

    weight: float
    effects: tuple[str, ...]


@dataclass(frozen=True)
class SelectionStep:
    """Effect of a comparison, at the state before it was added, or would be added next."""

    effect: str
    """Kind of the effect."""
    parameters: tuple[str, ...]
    """Names of its parameters."""
    kept: bool
    """True if its gain exceeds its cost."""
    gain: float
    """Relative decrease of the held-out error."""
    certainty: float
    """Gain over its standard error between folds."""
    held_out: ErrorSummary
    """Tip errors with it, m."""
    held_out_axis: float | None
    """Root mean square of the angles, rad, or None."""
    weight: float
    """Sum of the weights of the sets of effects that contain it: how sure it is that this effect is there."""
    rivals: tuple[str, ...] = ()
    """Effects that predict as well as this one: the data do not distinguish them."""


@dataclass(frozen=True, eq=False)
class Comparison(Displayed):
    """Selected effects in order of their gain."""

    start: ErrorSummary
    """Held-out tip errors of the robot as given, only registered."""
    start_axis: Annotated[float | None, unit("deg"), form(".2f"), "RMS angle of the directions, held out"]
    steps: tuple[SelectionStep, ...]
    """The effects that were kept, in order."""
    dropped: Annotated[tuple[str, ...], "effects made useless by later ones"]
    """Effects made useless by later ones; `refused` has their gain."""
    refused: tuple[SelectionStep, ...]
    """Effects that do not improve the prediction of the kept effects, best first."""
    fit: Annotated[Fit | None, "the fit with the chosen effects"]
    """None if no effect reduces the errors. The choice of effects has seen all rows, also the held-out ones."""
    chosen_anew: ErrorSummary
    """Held-out tip errors that include the choice of effects, to first order around the fit, m.

    Each fold is predicted by the effects chosen by all other folds, steady or not.
    """
    chosen_by_fold: Annotated[tuple[tuple[str, ...], ...], "effects that are chosen without each held-out block"]
    """Effects that all other folds choose, for every fold."""
    averaged: Robot
    """Robot with the means of all numbers over the sets of effects, by their weights, to first order around the fit.

    Its posterior is that of all their effects together. See `benchmarks.effects` for what it gains.
    """
    averaged_anew: ErrorSummary
    """Held-out tip errors of such means, weighted and fitted without each fold, m."""
    weights: tuple[SetWeight, ...]
    """Sets of effects and their weights, largest first; without those below LEAST_WEIGHT."""
    folds: Annotated[int, "number of held-out blocks"]
    remarks: Annotated[tuple[str, ...], "remarks on the file"]

    @property
    def certain(self) -> tuple[str, ...]:
        """Selected effects with a weight of CERTAIN or more."""
        return tuple(step.effect for step in self.steps if step.weight >= CERTAIN)

    @property
    def alike(self) -> int:
        """Number of folds without which the same effects are chosen."""
        chosen = {step.effect for step in self.steps}
        return sum(set(kinds) == chosen for kinds in self.chosen_by_fold)

    @property
    def settled(self) -> bool:
        """True if the same effects are chosen without at least four of five folds."""
        return self.alike >= SETTLED * len(self.chosen_by_fold)

    @property
    def chosen(self) -> tuple[str, ...]:
        """Names of the parameters in the selection."""
        return tuple(name for step in self.steps for name in step.parameters)


@typed
@small
@limited
def compare_effects(
    robot: Robot,
    measurements: Measurements | Sequence[Measurements],
    effects: Sequence[str] = (),
    options: FitOptions | None = None,
    *,
    progress: Progress | None = None,
    time_limit: float = LONG_TIME_LIMIT,
) -> Comparison:
    """Set of effects that best predicts held-out data, with as few parameters as possible.

    Args:
        effects: kinds out of `effects.EFFECTS` to try; only these are tried. By default all that these data can
            determine, without the slow ones such as "clearance".
        options: as for `fit`, with folds; priors are always on during a comparison.
        progress: called with the number of steps done, and 0.
        time_limit: maximum run time, s.

    Raises:
        InputError: an effect that is unknown or that the data cannot determine, folds out of range, and what `validate`
            raises.
        SolveError: no row has a stable shape.
        TimeLimitError: (a SolveError) the time limit was reached before there was an answer.
    """
    options = options or FitOptions(folds=10)
    recordings = recordings_of(measurements)
    check_tubes(robot, recordings[0])
    known = groups(robot, recordings, options.registration, effects)
    for effect in effects:
        if effect not in known:
            raise InputError(
                f"effect {effect!r} cannot be compared{nearest(effect, known)}; choose from {', '.join(known)}"
            )
    if not options.folds:
        raise InputError("folds is 0; a comparison needs cross-validation, so it must be at least 2")
    search = _Search(robot, recordings, {k: known[k] for k in (effects or known)}, options, progress)
    search.run()
    return search.answer()


@dataclass(frozen=True, eq=False)
class _Trial:
    """A fit of a set of effects, in the order of the table, and its residuals (V, 3) held out."""

    effects: tuple[str, ...]
    model: Sessions
    fit: RobustDescent[ParameterState[Registrations]]
    sigma: tuple[float, float]
    residuals: Array


class _Search:
    def __init__(
        self,
        robot: Robot,
        recordings: Sequence[Measurements],
        known: dict[str, tuple[str, ...]],
        options: FitOptions,
        progress: Progress | None,
    ) -> None:
        self.progress = progress
        self.given, self.options = options, replace(options, priors=True)
        named = {
            k: choose_parameters(robot, recordings, v, options.registration, options.per_recording)
            for k, v in known.items()
        }
        self.idle = [p for some in named.values() for p in some if p.idle]
        active = {k: tuple(p for p in some if not p.idle) for k, some in named.items()}
        self.parameters = {k: some for k, some in active.items() if some}
        self.known = {k: known[k] for k in self.parameters}
        self.model = sessions(robot, recordings, (), options)
        self.fold, self.block = self.model.fold(options.folds), self.model.blocks(BLOCKS)
        self.passed: list[str] = []
        self.tried = 0
        self.initial_trial = self._fitted((), self.model.start, FIRST_GUESS)
        self._stand(self.initial_trial)

    def run(self) -> None:
        """Search better sets; prefer earlier effects of the table; drop effects not worth their cost, or unsteady."""
        for _ in range(ROUNDS):
            better = self._better()
            if better is None:
                break
            self._move(better)
        while (first := self._earlier()) is not None:
            self._move(first)
        while (fewer := self._fewer()) is not None:
            self._move(fewer)
        while (steadier := self._steadier()) is not None:
            self._move(steadier)

    def _steadier(self) -> _Trial | None:
        """Set without the effect that fewest folds choose, if these are fewer than STEADY of them; None otherwise."""
        chosen, folds = self.sets.chosen_anew().sets, len(np.unique(self.fold))
        count = {kind: sum(kind in each for each in chosen) for kind in self.now.effects}
        unsteady = sorted((kind for kind in count if count[kind] < STEADY * folds), key=lambda kind: count[kind])
        tried = (self._tried(Effects(self.now.effects) - {kind}) for kind in unsteady)
        return next((trial for trial in tried if trial is not None), None)

    def _move(self, trial: _Trial) -> None:
        self.passed += self.now.effects
        long = self._long(trial.effects)
        self._stand(self._fitted(trial.effects, trial.fit.state, trial.sigma) if long else trial)

    def _stand(self, trial: _Trial) -> None:
        """Fit of the current set, and first-order predictions for all other sets around it."""
        self.now = trial
        self.slopes = self._slopes(trial, self.known)
        self.sets = self._sets(self.slopes)
        # What was fitted from afar, by the slopes there, may not have come to its end.
        self.fits: dict[Effects, _Trial | None] = {Effects(): self.initial_trial, Effects(trial.effects): trial}

    def _better(self) -> _Trial | None:
        """First of the most promising sets that is better than the current one; None without any."""
        sets, cost = self.sets, self._cost(self.now)
        limit = sets.cost(sets.base) + CROOKED * sets.inflation
        best = [effects for effects in sets.explore() if effects != sets.base and sets.cost(effects) <= limit]
        for effects in best[:TRIED_SETS]:
            trial = self._tried(effects)
            if trial is not None and self._cost(trial) < cost:
                return trial
        return None

    def _earlier(self) -> _Trial | None:
        """Set with one effect replaced by an earlier one of the table, if the data do not contradict it.

        Held-out errors at few configurations, and penalties for parameters, are no such evidence.
        """
        order = list(self.known)
        for kind in reversed(self.now.effects):
            for earlier in order[: order.index(kind)]:
                trial = self._in_place(earlier, kind)
                if trial is not None:
                    return trial
        return None

    def _in_place(self, other: str, kind: str) -> _Trial | None:
        """Set with one effect replaced by another; None if the data clearly contradict it."""
        sets, now = self.sets, Effects(self.now.effects)
        fewer, threshold = now - {kind}, EVIDENCE * sets.inflation
        changed = fewer | {other}
        if other in now or sets.seen(changed) > sets.seen(now) + threshold + CROOKED * sets.inflation:
            return None
        if sets.lost(changed) >= sets.lost(fewer):
            return None  # it must predict better than nothing in its place, not only cost little
        trial = self._tried(changed)
        return trial if trial is not None and self._seen(trial) <= self._seen(self.now) + threshold else None

    def _fewer(self) -> _Trial | None:
        """Set without the effect that improves the fit least for its cost; None if all are worth their cost."""
        now, sets, cost = Effects(self.now.effects), self.sets, self._cost(self.now)
        limit = sets.cost(now) + CROOKED * sets.inflation
        tried = (self._tried(now - {kind}) for kind in self.now.effects if sets.cost(now - {kind}) <= limit)
        evidence = {trial: self._worth(trial) for trial in tried if trial is not None}
        idle = [trial for trial, value in evidence.items() if value < 0 or self._cost(trial) < cost]
        return min(idle, key=lambda trial: evidence[trial], default=None)

    def _worth(self, fewer: _Trial) -> float:
        """Gain of the current set over a smaller one in the fit to all rows, minus the cost of the difference.

        The loss of held-out rows at few positions may overstate the gain by chance.
        """
        count = len(self.now.model.parameters) - len(fewer.model.parameters)
        return float(self._seen(fewer) - self._seen(self.now) - self.sets.price * count)

    def _seen(self, trial: _Trial) -> float:
        """Loss of a set in the fit to all rows, with priors."""
        weights = weigh(trial.model, self.options, self.now.sigma)
        return cost_of(trial.model, weights, trial.fit.state, trial.fit.residuals)

    def _cost(self, trial: _Trial) -> float:
        """Cost of a set: held-out loss, and charge for its parameters."""
        losses = weigh(self.model, self.options, self.now.sigma).losses(trial.residuals)
        return float(losses.sum() + self.sets.charge * len(trial.model.parameters))

    # --- fits ---------------------------------------------------------------------------------------------------------

    def _tried(self, effects: Effects) -> _Trial | None:
        """Fit of a set of effects from the current values, cached; None if the robot would not exist."""
        if effects not in self.fits:
            kinds = tuple(kind for kind in self.known if kind in effects)
            try:
                self.fits[effects] = self._some(kinds)
            except (InputError, SolveError):
                self.fits[effects] = None
        return self.fits[effects]

    def _some(self, kinds: tuple[str, ...]) -> _Trial:
        """Fit of a set from the current values; if it is costly, with known derivatives."""
        now = self.now.fit.state
        known = dict(zip((p.name for p in self.now.model.parameters), now.x, strict=True))
        chosen = [p for kind in kinds for p in self.parameters[kind]]
        start = ParameterState(np.array([known.get(p.name, p.start) for p in chosen]), now.registration)
        if not self._long(kinds):
            return self._fitted(kinds, start, self.now.sigma)
        model = self.model.with_parameters(chosen)
        weights = weigh(model, self.options, self.now.sigma)
        fit = descend(model, weights, start, jacobian=self.slopes.of(chosen), solver=BY_CHORDS)
        return self._held_out(kinds, model, fit, self.now.sigma)

    def _long(self, kinds: Sequence[str]) -> bool:
        """True if fitting these effects needs a pass along all rows for every parameter."""
        return not set(RUBBING).isdisjoint(kinds) or self.initial_trial.model.costly(self.initial_trial.fit.state)

    def _fitted(
        self, kinds: tuple[str, ...], start: ParameterState[Registrations], sigma: tuple[float, float]
    ) -> _Trial:
        """A fit in full."""
        chosen = [p for kind in kinds for p in self.parameters[kind]]
        problem = FitProblem(self.model.with_parameters(chosen), self.options, start, sigma)
        return self._held_out(kinds, problem.model, problem.fit, problem.sigma)

    def _held_out(
        self,
        kinds: tuple[str, ...],
        model: Sessions,
        fit: RobustDescent[ParameterState[Registrations]],
        sigma: tuple[float, float],
    ) -> _Trial:
        weights = weigh(model, self.options, sigma)
        out = predicted_held_out(model, weights, fit, self.fold)
        if self.progress is not None:
            self.tried += 1
            self.progress(self.tried, 0)
        return _Trial(kinds, model, fit, sigma, out)

    def _slopes(self, around: _Trial, kinds: Iterable[str]) -> Slopes:
        """Residuals around a fit, by its own effects and by others."""
        return slopes_around(around.model, around.fit, [self.parameters[k] for k in kinds if k not in around.effects])

    def _sets(self, slopes: Slopes) -> HeldOutSets:
        return slopes.sets(self._weights(slopes), self.fold)

    def _weights(self, slopes: Slopes) -> Weights:
        return weigh(slopes.model, self.options, self.now.sigma)

    # --- reports -----------------------------------------------------------------------------------------------------

    def answer(self) -> Comparison:
        """The comparison, with the fit of the kept effects."""
        result = None
        if self.now.effects:
            problem = FitProblem(self.now.model, self.given, self.now.fit.state, self.now.sigma)
            result = problem.answer(lambda count, total: None)
        else:
            begun = self.initial_trial.model
            for model, part in zip(begun.models, begun.parts(self.initial_trial.fit.state), strict=True):
                check_registration(registration_error(model, part), begun.method)
        along, axis = distances(self.model, self.initial_trial.residuals)
        anew = self.sets.chosen_anew()
        return Comparison(
            start=ErrorSummary.of(along[:, 0]),
            start_axis=_rms(axis),
            steps=self._kept(),
            dropped=tuple(dict.fromkeys(kind for kind in self.passed if kind not in self.now.effects)),
            refused=self._refused(),
            fit=result,
            chosen_anew=ErrorSummary.of(distances(self.model, anew.residuals)[0][:, 0]),
            chosen_by_fold=anew.sets,
            averaged=self._averaged(),
            averaged_anew=ErrorSummary.of(distances(self.model, anew.averaged)[0][:, 0]),
            weights=tuple(SetWeight(w, tuple(k for k in self.known if k in kinds)) for w, kinds in self.sets.weighed()),
            folds=len(np.unique(self.fold)),
            remarks=(*joined(self.model.recordings).remarks, *(left_out(p) for p in self.idle)),
        )

    def _averaged(self) -> Robot:
        """Robot with the means over sets of effects and its posterior; of several recordings as in the last."""
        sets, slopes, setups = self.sets, self.slopes, list[Setup]()
        model, registration, p, f = slopes.model, slopes.state.registration, sets.count, sets.free
        weighed, mean = sets.weighed(), np.zeros(p + f + len(slopes.jumps))
        # An effect that cannot begin at 0 is absent there.
        x, absent = np.zeros(p), np.where([each.kind in slopes.jumps for each in model.parameters], 0.0, 1.0)
        for weight, effects in weighed:
            step = sets.fitted(effects)
            kept = np.array([each.kind in effects for each in model.parameters], dtype=bool)
            values = slopes.state.x + step[:p]
            fewer = model.with_parameters([each for each, mine in zip(model.parameters, kept, strict=True) if mine])
            part = fewer.part(ParameterState(values[kept], registration), -1)
            setups.append(fewer.models[-1].setup(part.x))
            mean += weight * step
            x += weight * np.where(kept, values, values * absent)
        moved = registration.moved(mean[p : p + f])
        robot = calibrated(
            model.models[-1], Setup.mean(setups, np.array([weight for weight, _ in weighed])), moved.parts[-1]
        )
        weighty = {kind for _, effects in weighed for kind in effects}
        model = model.with_parameters([each for each in model.parameters if each.kind in weighty])
        if not model.parameters:
            return robot
        state = ParameterState(x[[kind in weighty for kind in sets.kinds]], moved)
        descent = RobustDescent(state, slopes.moved(mean), slopes.of(model.parameters), True)
        found = posterior_of(
            model,
            descent,
            weigh(model, self.options, self.now.sigma),
            model.parameters,
            self.options.per_recording,
            self.options.noise[0],
            np.zeros(0, dtype=int),
            at_minimum=False,
        )
        return replace(robot, posterior=found.posterior)

    def _kept(self) -> tuple[SelectionStep, ...]:
        """Kept effects, in order of their gain."""
        before, steps = self.initial_trial, list[SelectionStep]()
        while len(steps) < len(self.now.effects):
            left = [kind for kind in self.now.effects if kind not in before.effects]
            sets = self._sets(self._slopes(before, left))
            order = sorted(left, key=lambda kind: sets.lost(sets.base | {kind}))
            for kind in order:
                trial = self._tried(Effects({*before.effects, kind}))
                if trial is not None:
                    break
            else:
                break  # without the others there is no such robot
            steps.append(self._step(kind, before, trial.residuals, kept=True))
            before = trial
        return tuple(steps)

    def _refused(self) -> tuple[SelectionStep, ...]:
        """Gain of each effect that is not selected, added to the selected ones; best first."""
        weights, out = self._weights(self.slopes), list[SelectionStep]()
        for kind in self.known:
            if kind in self.now.effects or not any(p.kind == kind for p in self.slopes.model.parameters):
                continue
            fitted = self.fits.get(Effects({*self.now.effects, kind}))
            residuals = self.slopes.beside(kind, weights, self.fold) if fitted is None else fitted.residuals
            out.append(self._step(kind, self.now, residuals, kept=False))
        return tuple(sorted(out, key=lambda step: -step.gain))

    def _step(self, kind: str, before: _Trial, residuals: Array, *, kept: bool) -> SelectionStep:
        gain, certainty = self._gain(before.residuals, residuals)
        along, axis = distances(self.model, residuals)
        return SelectionStep(
            effect=kind,
            parameters=tuple(p.name for p in self.parameters[kind]),
            kept=kept,
            gain=gain,
            certainty=certainty,
            held_out=ErrorSummary.of(along[:, 0]),
            held_out_axis=_rms(axis),
            weight=sum(weight for weight, kinds in self.sets.weighed() if kind in kinds),
            rivals=self._rivals(kind) if kept else (),
        )

    def _rivals(self, kind: str) -> tuple[str, ...]:
        """Effects that predict about as well as a kept one."""
        return tuple(rival for rival in self.known if self._in_place(rival, kind) is not None)

    def _gain(self, before: Array, after: Array) -> tuple[float, float]:
        """Relative decrease of the held-out error, and that decrease over its standard error between blocks."""
        block_of_row, scale = self.block[self.model.row], weigh(self.model, self.options, self.initial_trial.sigma)
        first, then = scale.losses(before), scale.losses(after)
        differences = np.array([(first - then)[block_of_row == k].sum() for k in np.unique(block_of_row)])
        total = max(float(first.sum()), 1e-300)
        # Losses are squares: the root gives the part by which the error itself falls.
        gain = 1 - float(np.sqrt(max(0.0, then.sum()) / total))
        count = len(differences)
        # A sum over independent blocks has the standard error std sqrt(count).
        spread = float(differences.std(ddof=1) * np.sqrt(count)) if count > 1 else np.inf
        return gain, float(differences.sum() / max(spread, 1e-12 * total))


def _rms(axis: Array | None) -> float | None:
    return None if axis is None else float(np.sqrt(np.nanmean(axis**2)))


# A parameter must gain so much at least, in squares of its standard error: two standard errors.
MIN_GAIN = 4.0


Effects = frozenset[str]


class ChosenAnew(NamedTuple):
    """Choice of effects without each fold."""

    residuals: Array
    """(V, 3) residuals of every fold, by the set of effects chosen and fitted on the other folds."""
    averaged: Array
    """(V, 3) the same by the mean over sets of effects, weighted and fitted on the other folds."""
    sets: tuple[tuple[str, ...], ...]
    """Effects that the other folds choose for each fold."""


@dataclass(eq=False)
class HeldOutSets:
    """Losses of sets of effects, held out and in the fit to all rows, from linearised residuals.

    The state has every effect that may be part of a set: P parameters, and F freedoms of the registration.

    Attributes:
        inflation: of the variance of parameters, 1 for independent errors.
        price: what a parameter must gain by the fit to all, two standard errors.
        charge: of a parameter, beside what is lost held out.
    """

    residuals: Array
    """(V, 3) residuals at the state."""
    slopes: Array
    """(V, 3, P + F) derivatives of the residuals by parameters and registration."""
    weights: Array
    """(V,) weights of the squares of residuals."""
    fold: Index
    """(V,) fold of each row."""
    numbers: int
    """Number of independent residuals."""
    kinds: tuple[str, ...]
    """(P,) effect of each parameter."""
    base: Effects
    """Effects that are part of the state."""
    absent: Array
    """(P,) change of each parameter that removes its effect."""
    drawn: Array
    """(P,) change of each parameter to its value in the drawing."""
    prior: Array
    """(P,) standard deviation around that."""
    low: Array
    """(P,) smallest change of the parameters."""
    high: Array
    """(P,) largest change of the parameters."""
    jumps: Mapping[str, Array]
    """(V, 3) jump of the residuals by an effect, if its parameters alone do not define its absence."""

    def __post_init__(self) -> None:
        self.names, self.count, v = tuple(dict.fromkeys(self.kinds)), len(self.kinds), len(self.residuals)
        parts = [self.slopes.reshape(3 * v, -1), *(jump.reshape(-1, 1) for jump in self.jumps.values())]
        table = np.hstack([*parts, self.residuals.reshape(-1, 1)])
        table *= np.sqrt(np.repeat(self.weights, 3))[:, None]
        size = np.sqrt((table[:, :-1] ** 2).sum(0))
        self.scale = np.where(size > 0, size, 1.0)  # what moves nothing stays as drawn
        # Columns of unit length: units of parameters do not matter for the linear solves.
        table[:, :-1] /= self.scale
        rows = np.repeat(self.fold, 3)
        self.squares = np.array([table[rows == k].T @ table[rows == k] for k in np.unique(self.fold)])
        self.free = self.slopes.shape[2] - self.count
        scale = self.scale[: self.count]
        self.absent, self.drawn, self.low, self.high = (
            each * scale for each in (self.absent, self.drawn, self.low, self.high)
        )
        self.inverse = 1 / (self.prior * scale) ** 2
        self.known: dict[Effects, float] = {}
        # For independent errors of unit variance the optimism is twice the number of parameters and freedoms.
        optimism = self.lost(self.base) - self.seen(self.base)
        self.inflation = max(1.0, optimism / (2 * max(self.parameters(self.base) + self.free, 1)))
        min_inflation = max(math.log(self.numbers / self.inflation), 2 * math.log(max(self.count, 1)), MIN_GAIN)
        # Holding out charges 2 for each parameter already.
        self.price, self.charge = self.inflation * MIN_GAIN, self.inflation * (min_inflation - 2)

    def parameters(self, effects: Iterable[str]) -> int:
        """Number of parameters of a set."""
        return sum(self.kinds.count(kind) for kind in effects)

    def cost(self, effects: Effects) -> float:
        """Held-out loss of a set plus the charge for its parameters."""
        if effects not in self.known:
            self.known[effects] = self.lost(effects) + self.charge * self.parameters(effects)
        return self.known[effects]

    def lost(self, effects: Effects) -> float:
        """Held-out loss of a set of effects."""
        total = self.squares.sum(0)
        steps = (self._step(effects, total - square) for square in self.squares)
        return float(sum(step @ square @ step for step, square in zip(steps, self.squares, strict=True)))

    def seen(self, effects: Effects) -> float:
        """Loss of a set of effects in the fit to all rows."""
        total = self.squares.sum(0)
        step = self._step(effects, total)
        return float(step @ total @ step)

    def _step(self, effects: Effects, square: Array) -> Array:
        """Step that minimises a sum of squares; a parameter at the edge of its range stays there."""
        n, free = self.count, np.full(self.free, np.inf)
        chosen = np.array([kind in effects for kind in self.kinds], dtype=bool)
        change = [(kind in effects) - float(kind in self.base) for kind in self.jumps] * self.scale[n + self.free :]
        # Residuals are the last column: with the factor 1, step' S step is the loss of residuals + J step.
        given = np.append(change, 1.0)
        low, high = (np.where(chosen, edge, self.absent) for edge in (self.low, self.high))
        bounds = np.concatenate([low, -free, given]), np.concatenate([high, free, given])
        matrix, slope = square.copy(), np.zeros(len(square))
        # Small against the unit length of columns: only columns that are alike need it.
        matrix.ravel()[:: len(square) + 1] += 1e-12
        matrix[np.arange(n), np.arange(n)] += self.inverse
        slope[:n] = -self.drawn * self.inverse
        return bounded_step(matrix, slope, bounds, np.linalg.solve)

    def explore(self, starts: Sequence[Effects] = ()) -> list[Effects]:
        """Sets in the order of their costs: all neighbours on the descent by single changes from each start.

        The default starts are the current set, no effects, and all effects.
        """
        for start in starts or (self.base, Effects(), Effects(self.names)):
            best = start
            while (best_neighbour := min([best, *self.around(best)], key=self.cost)) != best:
                best = best_neighbour
        return sorted(self.known, key=self.cost)

    def weighed(self, starts: Sequence[Effects] = ()) -> list[tuple[float, Effects]]:
        """Weights of the explored sets with the sum 1, largest first, from their costs as log likelihoods.

        Akaike weights (Burnham and Anderson, Model Selection and Multimodel Inference (2002)); rows with common errors
        count for fewer.
        """
        explored = self.explore(starts)
        cost = np.array([self.cost(effects) for effects in explored])
        weight = np.exp((cost.min() - cost) / (2 * self.inflation))
        kept = weight > LEAST_WEIGHT * weight.sum()
        return [
            (float(w), kinds)
            for w, kinds, mine in zip(weight / weight[kept].sum(), explored, kept, strict=True)
            if mine
        ]

    def fitted(self, effects: Effects) -> Array:
        """(P + F + J,) change of parameters, registration and jumps by the fit of a set."""
        return np.asarray(self._step(effects, self.squares.sum(0))[:-1] / self.scale)

    def chosen_anew(self) -> ChosenAnew:
        """Choice of effects and their fit, repeated without each fold."""
        sets = list[tuple[str, ...]]()
        out, mean = np.empty_like(self.residuals), np.empty_like(self.residuals)
        columns = [self.slopes, *(jump[..., None] for jump in self.jumps.values())]
        for k, label in enumerate(np.unique(self.fold)):
            remaining = copy(self)
            remaining.squares, remaining.known = np.delete(self.squares, k, axis=0), {}
            # From none and from all: the current set was chosen with this fold. From none alone the descent stays at
            # effects that act like two others.
            weighed = remaining.weighed([Effects(), Effects(self.names)])
            best = weighed[0][1]
            sets.append(tuple(kind for kind in self.names if kind in best))
            average = sum(weight * remaining.fitted(effects) for weight, effects in weighed)
            mine = self.fold == label
            table = np.concatenate([column[mine] for column in columns], axis=2)
            out[mine] = self.residuals[mine] + table @ remaining.fitted(best)
            mean[mine] = self.residuals[mine] + table @ average
        return ChosenAnew(out, mean, tuple(sets))

    def around(self, effects: Effects) -> list[Effects]:
        """Sets with one effect more, one less, or one replaced by another."""
        more = [kind for kind in self.names if kind not in effects]
        less = [effects - {kind} for kind in sorted(effects)]
        return [effects | {kind} for kind in more] + less + [some | {kind} for some in less for kind in more]


@dataclass(frozen=True, eq=False)
class Slopes:
    """Slopes around a fit to V observations, with P parameters and F freedoms of the registration."""

    model: Sessions
    """Model with all parameters, those of the fit first."""
    state: ParameterState[Registrations]
    """State at the parameters."""
    base: Effects
    """Effects of the fit."""
    residuals: Array
    """(V, 3) residuals of the fit."""
    table: Array
    """(V, 3, P + F) derivatives."""
    jumps: Mapping[str, Array]
    """Residuals (V, 3) that an effect adds at its initial value."""

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
            base=self.base,
            absent=np.where([p.kind in self.jumps for p in chosen], 0.0, away),
            drawn=away,
            prior=weights.prior,
            low=np.array([p.low for p in chosen]) - x,
            high=np.array([p.high for p in chosen]) - x,
            jumps=self.jumps,
        )

    def moved(self, step: Array) -> Array:
        """(V, 3) residuals after a step (P + F + J,) of parameters, registration and jumps, to first order."""
        columns = [self.table, *(jump[..., None] for jump in self.jumps.values())]
        return np.asarray(self.residuals + np.concatenate(columns, axis=2) @ step)

    def beside(self, kind: str, weights: Weights, fold: Index) -> Array:
        """(V, 3) held-out residuals with one more effect than the fit; weights as for `sets`."""
        kept = np.array([p.kind == kind or p.kind in self.base for p in self.model.parameters])
        fewer = self.model.with_parameters([p for p, mine in zip(self.model.parameters, kept, strict=True) if mine])
        residuals = self.residuals + self.jumps.get(kind, 0.0)
        state = ParameterState(self.state.x[kept], self.state.registration)
        descent = RobustDescent(state, residuals, self.of(fewer.parameters), True)
        return predicted_held_out(fewer, replace(weights, prior=weights.prior[kept]), descent, fold)


def slopes_around(
    model: Sessions, fit: RobustDescent[ParameterState[Registrations]], others: Sequence[Sequence[Parameter]]
) -> Slopes:
    """Slopes around a fit by the parameters of a model, and by those of other effects at their starts.

    An effect that cannot begin, since there is no such robot, is left out.
    """
    parameters, motion = model.parameters, fit.state.registration
    table, jumps, chosen = [fit.jacobian[..., : len(parameters)]], dict[str, Array](), list(parameters)
    unstarted = [some for some in others if _begins(model, some)]
    started = [some for some in others if some not in unstarted]
    for some in ([p for each in started for p in each], *unstarted):
        more = model.with_parameters([*parameters, *some])
        state = ParameterState(np.append(fit.state.x, [p.start for p in some]), motion)
        try:
            slopes = more.jacobian(state, skip=len(parameters))
            jump = more.residuals(state) - fit.residuals
        except (InputError, SolveError):
            continue
        table.append(slopes[..., len(parameters) : len(parameters) + len(some)])
        chosen += some
        if some in unstarted:
            jumps[some[0].kind] = jump
    for kind in dict.fromkeys(p.kind for p in parameters):
        mine = np.array([p.kind == kind for p in parameters])
        if _begins(model, [p for p in parameters if p.kind == kind]):
            fewer = model.with_parameters([p for p in parameters if p.kind != kind])
            jumps[kind] = fit.residuals - fewer.residuals(ParameterState(fit.state.x[~mine], motion))
    x = np.append(fit.state.x, [p.start for p in chosen[len(parameters) :]])
    return Slopes(
        model=model.with_parameters(chosen),
        state=ParameterState(x, motion),
        base=Effects(p.kind for p in parameters),
        residuals=fit.residuals,
        table=np.concatenate([*table, fit.jacobian[..., len(parameters) :]], axis=2),
        jumps=jumps,
    )


def _begins(model: Sessions, chosen: Sequence[Parameter]) -> bool:
    """True if an effect must start at a value other than 0, since its derivative at 0 vanishes."""
    first = model.first
    return not apply(first, chosen, np.array([p.start for p in chosen])).same_tubes(first)
