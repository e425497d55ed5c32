"""Which effects pay: added one after the other, in the order in which they predict rows that no fit has seen.

Every effect lowers the error of the fit; only one that is there lowers the error of what is held out. At each step the
effects that are left are ranked by their held-out gain to first order, for which nothing is solved; the best few are
fitted and held out in full, and the best of these is kept if it pays. At last each that was kept is left out again:
one that came first may be what later ones explain better. Along a way with friction, where every solution costs that of
all rows before, what is held out is told to first order around each fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..display import Displayed
from ..errors import InputError, nearest
from ..robots.robot import Robot
from ..solvers.parallel.blas import small
from ..typing import Array
from .comparison import Progress, check_tubes, distances
from .descent import NEAR, Descent, Weights, descend
from .errors import ErrorSummary
from .fitting import FIRST_GUESS, Fit, FitOptions, FitProblem, check_counts, weigh
from .folds import deal, passes
from .held_out import hold_out, predicted_held_out
from .measurements import Measurements
from .model import ArmModel, State
from .parameters import apply, choose_parameters, groups
from .registration import FREEDOMS

TRIED = 3
"""Of the effects that promise most, so many are fitted in full at each step."""

ROUNDS = 3
"""Times that effects are added and left out again, at most."""

CHORDS = 8
"""Steps of such a fit with the slopes that all share; the best is then fitted in full."""

PAYS = 0.005
"""An effect must lower the held-out error (root of the mean loss) by this part: less is not worth a parameter."""

CERTAIN = 1.0
"""And by so many standard errors of the gain, from the differences between the folds (the one-standard-error rule of
Breiman et al., Classification and Regression Trees (1984))."""

SMALL, CERTAIN_OF_SMALL = 0.05, 3.0
"""A gain below the first must be so many standard errors instead: the best of a dozen effects that are not there
reaches 2 to 2.5 by chance, which a bound for every effect by itself does not know of."""


def pays(gain: float, certainty: float) -> bool:
    """Whether an effect that lowers the held-out error by a part `gain` is worth its parameters."""
    return gain >= PAYS and certainty >= (CERTAIN if gain >= SMALL else CERTAIN_OF_SMALL)


@dataclass(frozen=True)
class Step:
    """One effect of a comparison, at the state to which it was added, or would be next.

    effect: its kind.   parameters: their names.   kept: whether it pays.
    gain: part by which the held-out error falls.   certainty: gain over its standard error between folds.
    held_out: tip errors with it, m.   held_out_axis: root mean square of the angles, rad, or None.
    rivals: effects that would have predicted as well in its place: these data do not tell which of them it is.
    """

    effect: str
    parameters: tuple[str, ...]
    kept: bool
    gain: float
    certainty: float
    held_out: ErrorSummary
    held_out_axis: float | None
    rivals: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Comparison(Displayed):
    """Effects in the order in which they pay.

    Attributes:
        start: held-out tip errors of the robot as given, only registered.   start_axis: its angles, rad, or None.
        steps: the effects that were kept, in order.
        dropped: effects that were kept at first and that later ones made useless.
        refused: those that do not pay beside the kept ones, the best first.
        fit: with the kept effects; None where none pays.
        folds: how many there are.
    """

    start: ErrorSummary
    start_axis: float | None
    steps: tuple[Step, ...]
    dropped: tuple[str, ...]
    refused: tuple[Step, ...]
    fit: Fit | None
    folds: int

    @property
    def chosen(self) -> tuple[str, ...]:
        """Names of the parameters that were kept."""
        return tuple(name for step in self.steps for name in step.parameters)


@small
def compare_effects(
    robot: Robot,
    measurements: Measurements,
    effects: Sequence[str] = (),
    options: FitOptions | None = None,
    *,
    progress: Progress | None = None,
) -> Comparison:
    """Add effects in the order in which they pay held out, and stop where none does.

    Args:
        effects: kinds out of `effects.EFFECTS` to choose from; none for all that these data can speak of but
            "clearance", which takes long.
        options: as for `fit`, with folds; priors keep the many parameters in hand and are always on while comparing.
        progress: called with the number of steps done, and 0.

    Raises:
        InputError: an effect that is unknown or of which the data cannot speak, folds out of range, and what `validate`
            raises.
        SolveError: no row has a stable shape.
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
        raise InputError("folds is 0; a comparison holds rows out, so it must be at least 2")
    search = _Search(robot, measurements, {k: known[k] for k in (effects or known)}, options, progress)
    search.run()
    return search.answer()


@dataclass(frozen=True, eq=False)
class _Trial:
    """A fit of some effects and what it costs held out: residuals and losses (V,), by the scale of all trials."""

    effects: tuple[str, ...]
    model: ArmModel
    fit: Descent
    sigma: tuple[float, float]
    residuals: Array
    losses: Array


class _Search:
    def __init__(
        self,
        robot: Robot,
        measurements: Measurements,
        known: dict[str, tuple[str, ...]],
        options: FitOptions,
        progress: Progress | None,
    ) -> None:
        self.measurements, self.known, self.progress = measurements, known, progress
        self.given, self.options = options, replace(options, priors=True)
        self.parameters = {k: choose_parameters(robot, measurements, v, options.registration) for k, v in known.items()}
        self.fold = deal(measurements, options.folds, passes(measurements).place)
        self.model = ArmModel(robot, measurements, (), options.registration, options.base)
        self.scale: Weights | None = None
        self.done = 0
        self.begun = self.now = self._fitted((), self.model.start, FIRST_GUESS)
        self.steps: list[Step] = []
        self.dropped: list[str] = []
        self.refused: list[Step] = []

    def run(self) -> None:
        """Forward until nothing pays, then leave out what the rest explain; again where something was left out."""
        for _ in range(ROUNDS):
            while (step := self._forward()) is not None:
                self.steps.append(step)
            before = len(self.dropped)
            self._backward()
            if len(self.dropped) == before:
                break
        if self.dropped:
            self._retell()

    def _fitted(self, effects: tuple[str, ...], start: State, sigma: tuple[float, float]) -> _Trial:
        """A fit in full."""
        chosen = [p for kind in effects for p in self.parameters[kind]]
        problem = FitProblem(self.model.with_parameters(chosen), self.options, start, sigma)
        return self._held_out(effects, problem.model, problem.fit, problem.sigma)

    def _held_out(self, effects: tuple[str, ...], model: ArmModel, fit: Descent, sigma: tuple[float, float]) -> _Trial:
        weights = weigh(model, self.options, sigma)
        self.scale = self.scale or weights  # all are measured by the scale of the first
        if model.costly(fit.state):
            out = predicted_held_out(model, weights, fit, self.fold)
        else:
            out = hold_out(model, weights, fit, self.fold).residuals
        self.done += 1
        if self.progress is not None:
            self.progress(self.done, 0)
        return _Trial(effects, model, fit, sigma, out, self._losses(out))

    def _losses(self, residuals: Array) -> Array:
        assert self.scale is not None
        return self.scale.losses(residuals)

    def _forward(self) -> Step | None:
        """Keep the effect that pays most; None, with what each would bring, where none does."""
        left = [kind for kind in self.known if kind not in self.now.effects]
        slopes = self._slopes(left)
        linear = {kind: self._to_first_order(kind, slopes[kind]) for kind in left}
        order = sorted(left, key=lambda kind: float(self._losses(linear[kind]).sum()))
        trials = self._ranked([self._trial(kind, slopes[kind]) for kind in order[:TRIED]])
        promising = [trial for trial in trials if self._gain(self.now.losses, trial.losses)[0] > PAYS / 2]
        for trial in promising:
            full = self._fitted(trial.effects, trial.fit.state, self.now.sigma)
            step = self._step(full.effects[-1], full.residuals)
            if step.kept:
                self.now = full
                return replace(step, rivals=self._rivals(trial, trials))
        best = {trial.effects[-1]: trial.residuals for trial in trials}
        refused = [self._step(kind, best.get(kind, linear[kind])) for kind in order]
        self.refused = [replace(step, kept=False) for step in sorted(refused, key=lambda step: -step.gain)]
        return None

    def _ranked(self, trials: list[_Trial]) -> list[_Trial]:
        """Trials with the best first; those that are as good as the best in the order of the table of effects."""
        trials = sorted(trials, key=lambda trial: float(trial.losses.sum()))
        alike = [trial for trial in trials if self._gain(trial.losses, trials[0].losses)[0] < PAYS]
        order = list(self.known)
        return sorted(alike, key=lambda trial: order.index(trial.effects[-1])) + trials[len(alike) :]

    def _rivals(self, best: _Trial, trials: Sequence[_Trial]) -> tuple[str, ...]:
        """Other effects that predict as well as the one that is kept."""
        near = [trial for trial in trials if trial is not best and self._gain(trial.losses, best.losses)[0] < PAYS]
        return tuple(trial.effects[-1] for trial in near)

    def _slopes(self, left: Sequence[str]) -> dict[str, Array]:
        """(V, 3, Q) derivatives by the parameters kept, those of each effect, and the registration."""
        now, kept = self.now.fit.jacobian, len(self.now.model.parameters)
        begun = [kind for kind in left if self._begins(kind)]
        out = {}
        for kinds in ([kind for kind in left if kind not in begun], *([kind] for kind in begun)):
            model, state = self._with(*kinds)
            table, at = model.jacobian(state, skip=kept), kept
            for kind in kinds:
                mine = table[..., at : at + len(self.parameters[kind])]
                at += mine.shape[2]
                out[kind] = np.concatenate([now[..., :kept], mine, now[..., kept:]], axis=2)
        return out

    def _with(self, *kinds: str) -> tuple[ArmModel, State]:
        """The model with more effects, at the state of now."""
        more = [p for kind in kinds for p in self.parameters[kind]]
        model = self.model.with_parameters([*self.now.model.parameters, *more])
        return model, State(np.append(self.now.fit.state.x, [p.start for p in more]), self.now.fit.state.registration)

    def _to_first_order(self, kind: str, slopes: Array) -> Array:
        """(V, 3) residuals held out with one more effect, were all linear."""
        model, state = self._with(kind)
        residuals = model.residuals(state) if self._begins(kind) else self.now.fit.residuals
        near = Descent(state, residuals, slopes, True)
        return predicted_held_out(model, weigh(model, self.options, self.now.sigma), near, self.fold)

    def _begins(self, kind: str) -> bool:
        """Whether an effect is there at its start already, where having none has no slope."""
        chosen, first = self.parameters[kind], self.model.first
        return not apply(first, chosen, np.array([p.start for p in chosen])).same_tubes(first)

    def _trial(self, kind: str, slopes: Array) -> _Trial:
        """A fit with one more effect, with slopes that are kept."""
        model, state = self._with(kind)
        fit = self._chords(model, state, slopes)
        return self._held_out((*self.now.effects, kind), model, fit, self.now.sigma)

    def _step(self, kind: str, residuals: Array) -> Step:
        gain, certainty = self._gain(self.now.losses, self._losses(residuals))
        along, axis = distances(self.model, residuals)
        return Step(
            effect=kind,
            parameters=tuple(p.name for p in self.parameters[kind]),
            kept=pays(gain, certainty),
            gain=gain,
            certainty=certainty,
            held_out=ErrorSummary.of(along[:, 0]),
            held_out_axis=_rms(axis),
        )

    def _gain(self, before: Array, after: Array) -> tuple[float, float]:
        """Part by which the held-out error falls, and that over its standard error between the folds."""
        own = self.fold[self.model.row]
        labels = np.unique(own)
        differences = np.array([(before - after)[own == k].sum() for k in labels])
        total = max(float(before.sum()), 1e-300)
        gain = 1 - float(np.sqrt(max(0.0, after.sum()) / total))
        spread = float(differences.std(ddof=1) * np.sqrt(len(labels))) if len(labels) > 1 else np.inf
        return gain, float(differences.sum() / max(spread, 1e-12 * total))

    def _backward(self) -> None:
        """Leave out effects without which the rest predict as well, the useless first."""
        while len(self.now.effects) > 1:
            trials = [self._without(kind) for kind in self.now.effects[:-1]]
            best = min(trials, key=lambda trial: float(trial.losses.sum()))
            gain, certainty = self._gain(best.losses, self.now.losses)
            if pays(gain, certainty):
                return
            (kind,) = set(self.now.effects) - set(best.effects)
            self.now = self._some(best.effects) if self.now.model.costly(self.now.fit.state) else best
            self.dropped.append(kind)
            self.steps = [step for step in self.steps if step.effect != kind]

    def _retell(self) -> None:
        """Put what was kept in the order in which it pays without what was left out again."""
        left, told = list(self.steps), list[Step]()
        before = self.begun
        while left:
            trials = [(self._some((*before.effects, step.effect)), step) for step in left]
            trial, step = min(trials, key=lambda pair: float(pair[0].losses.sum()))
            gain, certainty = self._gain(before.losses, trial.losses)
            along, axis = distances(self.model, trial.residuals)
            summary = ErrorSummary.of(along[:, 0])
            told.append(replace(step, gain=gain, certainty=certainty, held_out=summary, held_out_axis=_rms(axis)))
            left.remove(step)
            before = trial
        self.steps, self.now = told, before

    def _some(self, kinds: tuple[str, ...]) -> _Trial:
        """A fit in full of some of the effects of now, from their values now."""
        now = self.now.fit.state
        known = dict(zip((p.name for p in self.now.model.parameters), now.x, strict=True))
        names = [p for kind in kinds for p in self.parameters[kind]]
        x = np.array([known.get(p.name, p.start) for p in names])
        return self._fitted(kinds, State(x, now.registration), self.now.sigma)

    def _without(self, kind: str) -> _Trial:
        """The fit with one effect less; where new slopes are costly, with those of now."""
        now, kinds = self.now, tuple(k for k in self.now.effects if k != kind)
        if not now.model.costly(now.fit.state):
            return self._some(kinds)
        kept = [k for k, p in enumerate(now.model.parameters) if p.kind != kind]
        model = self.model.with_parameters([now.model.parameters[k] for k in kept])
        slopes = now.fit.jacobian[..., [*kept, *range(len(now.model.parameters), now.fit.jacobian.shape[2])]]
        fit = self._chords(model, State(now.fit.state.x[kept], now.fit.state.registration), slopes)
        return self._held_out(kinds, model, fit, now.sigma)

    def _chords(self, model: ArmModel, start: State, slopes: Array) -> Descent:
        """A fit with slopes that are kept."""
        weights = weigh(model, self.options, self.now.sigma)
        return descend(model, weights, start, jacobian=slopes, iterations=CHORDS, settled=NEAR)

    def answer(self) -> Comparison:
        """The comparison, with the fit of the kept effects."""
        found = None
        if self.now.effects:
            problem = FitProblem(self.now.model, self.given, self.now.fit.state, self.now.sigma)
            found = problem.answer(self.measurements, lambda done, total: None)
        along, axis = distances(self.model, self.begun.residuals)
        return Comparison(
            start=ErrorSummary.of(along[:, 0]),
            start_axis=_rms(axis),
            steps=tuple(self.steps),
            dropped=tuple(self.dropped),
            refused=tuple(self.refused),
            fit=found,
            folds=len(np.unique(self.fold)),
        )


def _rms(axis: Array | None) -> float | None:
    return None if axis is None else float(np.sqrt(np.nanmean(axis**2)))
