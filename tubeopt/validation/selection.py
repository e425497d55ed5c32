"""Which effects are there: the set that predicts rows that no fit has seen, by no more parameters than it must.

Every effect lowers the error of a fit; only one that is there lowers the error of what is held out, but so does one
that acts like it, and the best of a dozen that are not there may by chance. So whole sets are compared, not effects one
by one: around the fit of a set all others are told to first order, for which nothing is solved, and those that promise
most are fitted, until none is better. A set costs what it loses held out, to first order around its own fit, and a
charge for each of its parameters (see `subsets`). Of effects that act alike those that stand first in the table of
effects are kept, unless there is very strong evidence for others. Nothing of the way there is remembered: what is told
of the effects that were kept, and of those that were not, is told beside the last set.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from ..arguments import typed
from ..display import Displayed
from ..errors import InputError, SolveError, nearest
from ..files.field_metadata import form, unit
from ..robots.robot import Robot
from ..solvers.blas import small
from ..solvers.robust_least_squares import Descent, Weights, cost_of, descend
from ..solvers.time_limit import LONG_TIME_LIMIT, limited
from ..typing import Array, Progress
from .certainty import check_registration, registration_error
from .comparison import ErrorSummary, check_tubes, distances
from .descent import predicted_held_out
from .fitting import Fit, FitOptions, FitProblem, check_counts, weigh
from .folds import deal, passes
from .identifiability import left_out
from .measurements import Measurements
from .model import ArmModel, State
from .parameters import choose_parameters, groups
from .registration import FIRST_GUESS, FREEDOMS
from .subsets import Effects, HeldOutSets, Slopes, slopes_around


@dataclass(frozen=True)
class Step:
    """One effect of a comparison, at the state to which it was added, or would be next."""

    effect: str
    """Its kind."""
    parameters: tuple[str, ...]
    """Their names."""
    kept: bool
    """Whether it pays."""
    gain: float
    """Part by which the held-out error falls."""
    certainty: float
    """Gain over its standard error between folds."""
    held_out: ErrorSummary
    """Tip errors with it, m."""
    held_out_axis: float | None
    """Root mean square of the angles, rad, or None."""
    rivals: tuple[str, ...] = ()
    """Effects that would have predicted as well in its place: these data do not tell which of them it is."""


@dataclass(frozen=True, eq=False)
class Comparison(Displayed):
    """Effects in the order in which they pay."""

    start: ErrorSummary
    """Held-out tip errors of the robot as given, only registered."""
    start_axis: Annotated[float | None, unit("deg"), form(".2f"), "RMS angle of the directions, held out"]
    steps: tuple[Step, ...]
    """The effects that were kept, in order."""
    dropped: Annotated[tuple[str, ...], "effects made useless by later ones"]
    """`refused` has what they would bring."""
    refused: tuple[Step, ...]
    """Those that do not pay beside the kept ones, the best first."""
    fit: Annotated[Fit | None, "the fit with the chosen effects"]
    """None where no effect reduces the errors. Its held-out errors, like those of the steps, are of rows that took
    part in the choice of effects."""
    chosen_anew: ErrorSummary
    """Held-out tip errors that include the choice: each fold is predicted by the effects that the others choose, to
    first order around the fit, m."""
    folds: Annotated[int, "number of held-out blocks"]
    remarks: Annotated[tuple[str, ...], "remarks on the file"]

    @property
    def chosen(self) -> tuple[str, ...]:
        """Names of the parameters that were kept."""
        return tuple(name for step in self.steps for name in step.parameters)


@typed
@small
@limited
def compare_effects(
    robot: Robot,
    measurements: Measurements,
    effects: Sequence[str] = (),
    options: FitOptions | None = None,
    *,
    progress: Progress | None = None,
    time_limit: float = LONG_TIME_LIMIT,
) -> Comparison:
    """The set of effects that predicts what no fit has seen by no more parameters than it must.

    Args:
        effects: kinds out of `effects.EFFECTS` to choose from; none for all that these data can speak of but
            "clearance", which takes long.
        options: as for `fit`, with folds; priors keep the many parameters in hand and are always on while comparing.
        progress: called with the number of steps done, and 0.
        time_limit: s, on the clock.

    Raises:
        InputError: an effect that is unknown or of which the data cannot speak, folds out of range, and what `validate`
            raises.
        SolveError: no row has a stable shape.
        TimeLimitError: (a SolveError) the time limit was reached before there was an answer.
    """
    options = options or FitOptions(folds=10)
    check_tubes(robot, measurements)
    known = groups(robot, measurements, options.registration, effects)
    for effect in effects:
        if effect not in known:
            raise InputError(
                f"effect {effect!r} cannot be compared{nearest(effect, known)}; choose from {', '.join(known)}"
            )
    check_counts(measurements, FREEDOMS[options.registration] + 1, options.folds)
    if not options.folds:
        raise InputError("folds is 0; a comparison needs cross-validation, so it must be at least 2")
    search = _Search(robot, measurements, {k: known[k] for k in (effects or known)}, options, progress)
    search.run()
    return search.answer()


@dataclass(frozen=True, eq=False)
class _Trial:
    """A fit of a set of effects, in the order of the table, and its residuals (V, 3) held out."""

    effects: tuple[str, ...]
    model: ArmModel
    fit: Descent[State]
    sigma: tuple[float, float]
    residuals: Array


class _Search:
    def __init__(
        self,
        robot: Robot,
        measurements: Measurements,
        known: dict[str, tuple[str, ...]],
        options: FitOptions,
        progress: Progress | None,
    ) -> None:
        self.measurements, self.progress = measurements, progress
        self.given, self.options = options, replace(options, priors=True)
        named = {k: choose_parameters(robot, measurements, v, options.registration) for k, v in known.items()}
        self.idle = [p for some in named.values() for p in some if p.idle]
        active = {k: tuple(p for p in some if not p.idle) for k, some in named.items()}
        self.parameters = {k: some for k, some in active.items() if some}
        self.known = {k: known[k] for k in self.parameters}
        place = passes(measurements).place
        self.fold, self.block = (deal(measurements, k, place) for k in (options.folds, options.solver.blocks))
        self.model = ArmModel(robot, measurements, (), options.registration, options.base)
        self.passed: list[str] = []
        self.tried = 0
        self.begun = self._fitted((), self.model.start, FIRST_GUESS)
        self._stand(self.begun)

    def run(self) -> None:
        """From set to set while one is better, then to effects that stand first in the table where nothing speaks
        strongly against them, then to those that are worth their price."""
        for _ in range(self.options.solver.rounds):
            better = self._better()
            if better is None:
                break
            self._move(better)
        while (first := self._earlier()) is not None:
            self._move(first)
        while (fewer := self._fewer()) is not None:
            self._move(fewer)

    def _move(self, trial: _Trial) -> None:
        self.passed += self.now.effects
        long = self._long(trial.effects)
        self._stand(self._fitted(trial.effects, trial.fit.state, trial.sigma) if long else trial)

    def _stand(self, trial: _Trial) -> None:
        """A fit, and what is told of all others around it."""
        self.now = trial
        self.slopes = self._slopes(trial, self.known)
        self.sets = self._sets(self.slopes)
        # What was fitted from afar, by the slopes there, may not have come to its end.
        self.fits: dict[Effects, _Trial | None] = {Effects(): self.begun, Effects(trial.effects): trial}

    def _better(self) -> _Trial | None:
        """The first of the sets that promise most, or nearly, which is better than that of now; None where none is."""
        sets, cost, solver = self.sets, self._cost(self.now), self.options.solver
        near = sets.cost(sets.there) + solver.crooked * sets.inflation
        best = [effects for effects in sets.explore() if effects != sets.there and sets.cost(effects) <= near]
        for effects in best[: solver.tried]:
            trial = self._tried(effects)
            if trial is not None and self._cost(trial) < cost:
                return trial
        return None

    def _earlier(self) -> _Trial | None:
        """A set with an effect of the table in the place of one behind it, where the data do not speak strongly against
        it; what is held out at few places, and charged for parameters, is no such evidence."""
        order = list(self.known)
        for kind in reversed(self.now.effects):
            for other in order[: order.index(kind)]:
                trial = self._in_place(other, kind)
                if trial is not None:
                    return trial
        return None

    def _in_place(self, other: str, kind: str) -> _Trial | None:
        """The set with another effect in the place of one of now; None where the data speak strongly against it."""
        sets, now, solver = self.sets, Effects(self.now.effects), self.options.solver
        fewer, room = now - {kind}, solver.strong * sets.inflation
        changed = fewer | {other}
        if other in now or sets.seen(changed) > sets.seen(now) + room + solver.crooked * sets.inflation:
            return None
        if sets.lost(changed) >= sets.lost(fewer):
            return None  # it must predict better than nothing in its place, not only cost little
        trial = self._tried(changed)
        return trial if trial is not None and self._seen(trial) <= self._seen(self.now) + room else None

    def _fewer(self) -> _Trial | None:
        """The set without the effect that is least worth its price by the fit to all; None where all are worth it."""
        now, sets, cost = Effects(self.now.effects), self.sets, self._cost(self.now)
        near = sets.cost(now) + self.options.solver.crooked * sets.inflation
        tried = (self._tried(now - {kind}) for kind in self.now.effects if sets.cost(now - {kind}) <= near)
        worth = {trial: self._worth(trial) for trial in tried if trial is not None}
        idle = [trial for trial, value in worth.items() if value < 0 or self._cost(trial) < cost]
        return min(idle, key=lambda trial: worth[trial], default=None)

    def _worth(self, fewer: _Trial) -> float:
        """What the effects of now gain by the fit to all, beside fewer, over their price: what is held out at few
        places may seem to gain more, by chance."""
        count = len(self.now.model.parameters) - len(fewer.model.parameters)
        return float(self._seen(fewer) - self._seen(self.now) - self.sets.price * count)

    def _seen(self, trial: _Trial) -> float:
        """What a set loses by the fit to all, priors among it."""
        weights = weigh(trial.model, self.options, self.now.sigma)
        return cost_of(trial.model, weights, trial.fit.state, trial.fit.residuals)

    def _cost(self, trial: _Trial) -> float:
        """What a set costs: its loss held out, and the charge for its parameters."""
        losses = weigh(self.model, self.options, self.now.sigma).losses(trial.residuals)
        return float(losses.sum() + self.sets.charge * len(trial.model.parameters))

    # --- fits ---------------------------------------------------------------------------------------------------------

    def _tried(self, effects: Effects) -> _Trial | None:
        """The fit of a set, from the values of now, once; None where there is no such robot."""
        if effects not in self.fits:
            kinds = tuple(kind for kind in self.known if kind in effects)
            try:
                self.fits[effects] = self._some(kinds)
            except (InputError, SolveError):
                self.fits[effects] = None
        return self.fits[effects]

    def _some(self, kinds: tuple[str, ...]) -> _Trial:
        """A fit from the values of now: in full, or, where it is costly, with the slopes that are known."""
        now = self.now.fit.state
        known = dict(zip((p.name for p in self.now.model.parameters), now.x, strict=True))
        chosen = [p for kind in kinds for p in self.parameters[kind]]
        start = State(np.array([known.get(p.name, p.start) for p in chosen]), now.registration)
        if not self._long(kinds):
            return self._fitted(kinds, start, self.now.sigma)
        model = self.model.with_parameters(chosen)
        weights = weigh(model, self.options, self.now.sigma)
        fit = descend(model, weights, start, jacobian=self.slopes.of(chosen), solver=self.options.solver.by_chords)
        return self._held_out(kinds, model, fit, self.now.sigma)

    def _long(self, kinds: Sequence[str]) -> bool:
        """Whether a fit of these takes a way along all rows for every parameter."""
        return "friction" in kinds or self.begun.model.costly(self.begun.fit.state)

    def _fitted(self, kinds: tuple[str, ...], start: State, sigma: tuple[float, float]) -> _Trial:
        """A fit in full."""
        chosen = [p for kind in kinds for p in self.parameters[kind]]
        problem = FitProblem(self.model.with_parameters(chosen), self.options, start, sigma)
        return self._held_out(kinds, problem.model, problem.fit, problem.sigma)

    def _held_out(
        self, kinds: tuple[str, ...], model: ArmModel, fit: Descent[State], sigma: tuple[float, float]
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

    # --- what is told -------------------------------------------------------------------------------------------------

    def answer(self) -> Comparison:
        """The comparison, with the fit of the kept effects."""
        found = None
        if self.now.effects:
            problem = FitProblem(self.now.model, self.given, self.now.fit.state, self.now.sigma)
            found = problem.answer(self.measurements, lambda done, total: None)
        else:
            check_registration(registration_error(self.begun.model, self.begun.fit.state), self.begun.model.method)
        along, axis = distances(self.model, self.begun.residuals)
        return Comparison(
            start=ErrorSummary.of(along[:, 0]),
            start_axis=_rms(axis),
            steps=self._kept(),
            dropped=tuple(dict.fromkeys(kind for kind in self.passed if kind not in self.now.effects)),
            refused=self._refused(),
            fit=found,
            chosen_anew=self._chosen_anew(),
            folds=len(np.unique(self.fold)),
            remarks=(*self.measurements.remarks, *(left_out(p) for p in self.idle)),
        )

    def _chosen_anew(self) -> ErrorSummary:
        return ErrorSummary.of(distances(self.model, self.sets.chosen_anew())[0][:, 0])

    def _kept(self) -> tuple[Step, ...]:
        """What was kept, in the order in which it pays."""
        before, steps = self.begun, list[Step]()
        while len(steps) < len(self.now.effects):
            left = [kind for kind in self.now.effects if kind not in before.effects]
            sets = self._sets(self._slopes(before, left))
            order = sorted(left, key=lambda kind: sets.lost(sets.there | {kind}))
            for kind in order:
                trial = self._tried(Effects({*before.effects, kind}))
                if trial is not None:
                    break
            else:
                break  # without the others there is no such robot
            steps.append(self._step(kind, before, trial.residuals, kept=True))
            before = trial
        return tuple(steps)

    def _refused(self) -> tuple[Step, ...]:
        """What each of the other effects would bring beside those that were kept, the best first."""
        weights, out = self._weights(self.slopes), list[Step]()
        for kind in self.known:
            if kind in self.now.effects or not any(p.kind == kind for p in self.slopes.model.parameters):
                continue
            fitted = self.fits.get(Effects({*self.now.effects, kind}))
            residuals = self.slopes.beside(kind, weights, self.fold) if fitted is None else fitted.residuals
            out.append(self._step(kind, self.now, residuals, kept=False))
        return tuple(sorted(out, key=lambda step: -step.gain))

    def _step(self, kind: str, before: _Trial, residuals: Array, *, kept: bool) -> Step:
        gain, certainty = self._gain(before.residuals, residuals)
        along, axis = distances(self.model, residuals)
        return Step(
            effect=kind,
            parameters=tuple(p.name for p in self.parameters[kind]),
            kept=kept,
            gain=gain,
            certainty=certainty,
            held_out=ErrorSummary.of(along[:, 0]),
            held_out_axis=_rms(axis),
            rivals=self._rivals(kind) if kept else (),
        )

    def _rivals(self, kind: str) -> tuple[str, ...]:
        """Other effects that predict as well in the place of one that is kept."""
        return tuple(other for other in self.known if self._in_place(other, kind) is not None)

    def _gain(self, before: Array, after: Array) -> tuple[float, float]:
        """Part by which the held-out error falls, and that over its standard error between blocks."""
        own, scale = self.block[self.model.row], weigh(self.model, self.options, self.begun.sigma)
        first, then = scale.losses(before), scale.losses(after)
        differences = np.array([(first - then)[own == k].sum() for k in np.unique(own)])
        total = max(float(first.sum()), 1e-300)
        gain = 1 - float(np.sqrt(max(0.0, then.sum()) / total))
        count = len(differences)
        spread = float(differences.std(ddof=1) * np.sqrt(count)) if count > 1 else np.inf
        return gain, float(differences.sum() / max(spread, 1e-12 * total))


def _rms(axis: Array | None) -> float | None:
    return None if axis is None else float(np.sqrt(np.nanmean(axis**2)))
