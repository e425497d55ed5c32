"""Latency, play and friction act alike on a smooth path: how far the data at hand can part them."""

from __future__ import annotations

import numpy as np

from ..typing import Array
from .descent import Descent
from .effects import EFFECTS
from .model import ArmModel, State
from .parameters import Parameter, choose_parameters, groups


def history_parameters(model: ArmModel) -> list[Parameter]:
    """Every parameter by which the tip depends on how its configuration was reached, where the data can tell."""
    known = groups(model.robot, model.measurements, model.method)
    names = [name for kind, own in known.items() if EFFECTS[kind].history for name in own]
    return list(choose_parameters(model.robot, model.measurements, names, model.method)) if names else []


def entangled_history(model: ArmModel, fit: Descent) -> list[str]:
    """A remark where an effect of history was fitted that others of these data could imitate."""
    fitted = {p.name for p in model.parameters if p.effect.history}
    if not fitted:
        return []
    known = history_parameters(model)
    others = [p for p in known if p.name not in fitted]
    if not others:
        return []
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
                f"{p.name} can hardly be told from {kinds} on this path: they imitate all but "
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
