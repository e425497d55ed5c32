"""What measured tips tell about parameters, and what they do not, in words."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..typing import Array
from .parameters import Parameter

NO_EFFECT = 1e-4
"""A combination of parameters is undetermined if a large change of it moves the tips by less than this part of the
arm's length (root mean square), once the registration has followed."""

INVOLVED = 0.05
"""Part of an undetermined combination from which a parameter belongs to it."""

ENTANGLED = 0.99
"""Correlation of two estimates above which they are told as entangled."""


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
        with_it = [parameters[j].name for j, part in zip(kept, directions[-1], strict=False) if abs(part) > INVOLVED]
        if with_it:
            words.append(
                f"{parameter.name} cannot be told from a change of {join(with_it)} together with the registration; "
                f"held at {shown(parameter)}"
            )
        else:
            words.append(
                f"{parameter.name} has no effect on the measured tips that the registration does not undo; held at "
                f"{shown(parameter)}"
            )
    return held, words


def beside_registration(jacobian: Array, count: int) -> Array:
    """(3V, P) columns of the parameters of a Jacobian (V, 3, P + F), less what the registration would undo."""
    flat = jacobian.reshape(3 * len(jacobian), jacobian.shape[2])
    if not count or flat.shape[1] == count:
        return flat[:, :count].copy()
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
            if abs(correlation[j, k]) > ENTANGLED:
                words.append(
                    f"{parameters[j].name} and {parameters[k].name} are entangled (correlation "
                    f"{correlation[j, k]:.3f}): the data determine a combination of them far better than each"
                )
    return words


def shown(parameter: Parameter) -> str:
    """The start of a parameter in the unit that people use."""
    if parameter.unit == "rad":
        return f"{math.degrees(parameter.start):.4g} deg"
    if parameter.unit == "m":
        return f"{1e3 * parameter.start:.4g} mm"
    return f"{parameter.start:.4g} {parameter.unit}".strip()


def join(names: Sequence[str]) -> str:
    """ "a, b and c"."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
