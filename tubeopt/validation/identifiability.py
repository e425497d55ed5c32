"""What measured tips tell about parameters, and what they do not, in words; whether latency, play and friction part."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..solvers.robust_least_squares import Descent
from ..typing import Array
from .effects import EFFECTS
from .model import ArmModel, State
from .parameters import Parameter, choose_parameters, groups

# A combination of parameters is undetermined if a large change of it moves the tips by less than this part of the
# arm's length (root mean square), once the registration has followed.
NO_EFFECT = 1e-4


def undetermined(parameters: Sequence[Parameter], jacobian: Array, length: float) -> tuple[list[int], list[str]]:
    """Indices of parameters to hold, so that all others are determined, and the reasons in words.

    Args:
        jacobian: (V, 3, P + F) of the residuals by parameters and registration, directions in units of the arm's
            length, m.   length: of the arm, m.
    """
    scaled = beside_registration(jacobian, len(parameters)) * [p.scale for p in parameters]
    scaled /= length * math.sqrt(len(jacobian))
    kept: list[int] = []
    held, words = [], []
    for k, parameter in enumerate(parameters):
        _, singular, directions = np.linalg.svd(scaled[:, [*kept, k]], full_matrices=False)
        if singular[-1] > NO_EFFECT:
            kept.append(k)
            continue
        held.append(k)
        with_it = [parameters[j].name for j, part in zip(kept, directions[-1], strict=False) if abs(part) > 0.05]
        if with_it:
            words.append(
                f"{parameter.name} cannot be distinguished from a change of {join(with_it)} together with the "
                f"registration; held at {shown(parameter.start, parameter.unit)}"
            )
        else:
            words.append(
                f"{parameter.name} has next to no effect on the measured tips: a change by "
                f"{shown(parameter.scale, parameter.unit)} moves them by less than "
                f"{shown(NO_EFFECT * length, 'm')} (RMS) once the registration has followed; held at "
                f"{shown(parameter.start, parameter.unit)}"
            )
    return held, words


def left_out(parameter: Parameter) -> str:
    """The remark on a parameter without influence."""
    return f"{parameter.name} has no influence on the tips and was left out: {parameter.idle}"


def beside_registration(jacobian: Array, count: int) -> Array:
    """(3V, P) columns of the parameters of a Jacobian (V, 3, P + F), less what the registration would undo."""
    flat = jacobian.reshape(3 * len(jacobian), jacobian.shape[2])
    q, _ = np.linalg.qr(flat[:, count:])
    return np.asarray(flat[:, :count] - q @ (q.T @ flat[:, :count]))


def doubts(
    parameters: Sequence[Parameter], free: Sequence[int], values: Array, half: Array, correlation: Array
) -> list[str]:
    """Remarks on a finished fit: values at the edge of their range, wide intervals, entangled pairs.

    Args:
        free: indices of the parameters that were estimated.   values, half: (P,) estimates and half widths of their
            intervals.   correlation: (P, P).
    """
    words = []
    for k in free:
        p = parameters[k]
        if min(values[k] - p.low, p.high - values[k]) <= 1e-6 * p.scale:
            words.append(f"{p.name} ended at the edge of its range: the interval does not hold there")
        if half[k] > p.scale:
            words.append(f"{p.name} is hardly determined: its interval is wider than any plausible range")
    for a, j in enumerate(free):
        for k in free[a + 1 :]:
            if abs(correlation[j, k]) > 0.99:
                words.append(
                    f"{parameters[j].name} and {parameters[k].name} are entangled (correlation "
                    f"{correlation[j, k]:.3f}): the data determine a combination of them far better than each"
                )
    return words


def louder(left: Sequence[float], given: Sequence[float | None]) -> list[str]:
    """Remarks where residuals are far beyond the noise that was given: of positions, m, and of directions, rad."""
    words = []
    for spread, noise, unit in zip(left, given, ("m", "rad"), strict=True):
        if noise and spread > 3.0 * noise:
            words.append(
                f"residuals are {spread / noise:.2g} times the noise that was given ({shown(spread, unit)} for "
                f"{shown(noise, unit)}): the intervals are too narrow, since the model lacks something or the noise is "
                "larger"
            )
    return words


def shown(value: float, unit: str) -> str:
    """A value of a parameter in the unit that people use."""
    if unit == "rad":
        return f"{math.degrees(value):.4g} deg"
    if unit == "m":
        return f"{1e3 * value:.4g} mm"
    if unit == "m/N":
        return f"{1e3 * value:.4g} mm/N"
    return f"{value:.4g} {unit}".strip()


def join(names: Sequence[str]) -> str:
    """ "a, b and c"."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def entangled_history(model: ArmModel, fit: Descent[State]) -> list[str]:
    """A remark where an effect of history was fitted that others of these data could imitate."""
    fitted = {p.name for p in model.parameters if p.effect.history}
    if not fitted:
        return []
    known = groups(model.robot, model.measurements, model.method)
    names = [name for kind, own in known.items() if EFFECTS[kind].history for name in own if name not in fitted]
    if not names:
        return []
    others = choose_parameters(model.robot, model.measurements, names, model.method)
    every = [*model.parameters, *others]
    start = np.append(fit.state.x, [p.start for p in others])
    count = len(model.parameters)
    slopes = model.with_parameters(every).jacobian(State(start, fit.state.registration), skip=count)
    slopes[..., :count] = fit.jacobian[..., :count]
    flat = slopes.reshape(-1, slopes.shape[2])
    usual = [k for k, p in enumerate(every) if not p.effect.history] + list(range(len(every), flat.shape[1]))
    words = []
    for k, p in enumerate(every):
        if p.name not in fitted:
            continue
        rivals = [j for j, q in enumerate(every) if q.kind != p.kind and q.effect.history]
        left = _beside(flat[:, k], flat[:, usual])
        parted = _beside(left, np.column_stack([_beside(flat[:, j], flat[:, usual]) for j in rivals]))
        share = float(np.linalg.norm(parted)) / max(float(np.linalg.norm(left)), 1e-300)
        if share < 0.3:  # of it, the others of its kind cannot imitate
            kinds = " and ".join(sorted({every[j].kind for j in rivals}))
            words.append(
                f"{p.name} can hardly be distinguished from {kinds} on this path: these explain all but "
                f"{100 * share:.0f} % of it. Measure the same path once slowly and once fast: a latency grows with the "
                "speed, play and friction do not"
            )
    return words


def _beside(column: Array, others: Array) -> Array:
    """What the other columns leave of a column."""
    if not others.shape[1]:
        return column
    scale = np.maximum(np.linalg.norm(others, axis=0), 1e-300)
    answer = np.linalg.lstsq(others / scale, column, rcond=1e-10)[0]
    return np.asarray(column - (others / scale) @ answer)
