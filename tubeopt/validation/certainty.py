"""How well a registration of measured tips is known, and whether a mirror image would fit better."""

from __future__ import annotations

import math

import numpy as np

from ..bodies.certainty import MOST, RegistrationError, mirrored, narrowness, standard_errors, turn_curvature
from ..errors import InputError
from ..typing import Array, Index
from .folds import deal
from .model import ArmModel, State
from .registration import FREEDOMS

BLOCKS = 20
"""Of rows, where there are as many places: errors of neighbouring rows are alike."""


def remark(error: RegistrationError) -> str:
    """What a mirror image that fits better means, or a turn that is known badly, in words; "" where neither is."""
    if error.mirrored is None:
        known = f"the frame is known to {math.degrees(error.turn):.0f} deg only (standard error)"
        return "" if error.turn <= MOST else f"{known}: the tips are too few, or the model is too far from them"
    return (
        f"a mirror image of the measured tips fits better (RMS {error.mirrored * 1e3:.2f} mm): does a rotation or "
        "an axis of the device have the wrong sign?"
    )


def registration_error(model: ArmModel, state: State) -> RegistrationError | None:
    """The standard errors of the registration of a state; None where it was not found by least squares."""
    freedoms = FREEDOMS[model.method]
    if not freedoms:
        return None
    there, here, lever = _pairs(model, state)
    a = model.directed
    size = [((there - here)[part] ** 2).sum() for part in (~a, a)]
    spare = max(3 * int((~a).sum()) + 2 * int(a.sum()) - freedoms, 1) / (3 * (~a).sum() + 2 * a.sum())
    counts = (3 * (~a).sum(), 2 * a.sum())
    variance = [max(s / max(n, 1) / spare, 1e-30) for s, n in zip(size, counts, strict=True)]
    weight = 1 / np.where(a, variance[1], variance[0])
    turns = np.eye(3)[2:] if freedoms == 1 else np.eye(3)
    hessian = turn_curvature(here + lever, there + lever, weight, turns)
    mirror = mirrored(here[~a], there[~a], math.sqrt(size[0] / (~a).sum())) if freedoms == 6 else None
    narrow = narrowness(there[~a])
    if hessian is None:
        return RegistrationError(math.inf, math.inf, narrow, mirror)
    inverse = np.linalg.inv(hessian)
    pull = weight[:, None] * np.cross(here + lever, there - here) @ turns.T
    shift = np.where(a[:, None], 0.0, there - here) / (~a).sum() if freedoms == 6 else np.zeros_like(here)
    moved = np.hstack([pull @ inverse, shift])  # what each observation moves of turn and shift
    alone = np.zeros((moved.shape[1],) * 2)
    alone[: len(turns), : len(turns)] = inverse
    if freedoms == 6:
        alone[3:, 3:] = np.eye(3) * variance[0] / (~a).sum()
    both = (alone, _from_blocks(moved, _blocks(model)))
    centre = there[~a].mean(0) if freedoms == 6 else np.zeros(3)
    errors = [standard_errors(covariance, turns, centre, model.length) for covariance in both]
    turn, reach = np.max(errors, axis=0).tolist()
    return RegistrationError(turn, reach, narrow, mirror)


def _pairs(model: ArmModel, state: State) -> tuple[Array, Array, Array]:
    """Predicted and measured in the plate's frame (V, 3), and what to add to either to be a lever of the turn."""
    motion, a = state.registration, model.directed
    predicted = model.predicted(state)
    turned = [each @ motion.rotation.T for each in (predicted, model.observed)]
    there, here = (np.where(a[:, None], each, each + motion.translation) for each in turned)
    lever = np.zeros_like(there)
    if FREEDOMS[model.method] == 6:
        lever[~a] = -there[~a].mean(0)
    return there, here, lever


def _blocks(model: ArmModel) -> Index:
    return deal(model.measurements, min(BLOCKS, len(model.measurements)))[model.row]


def _from_blocks(moved: Array, block: Index) -> Array:
    """Covariance of sums over blocks that are taken as independent."""
    sums = np.array([moved[block == k].sum(0) for k in np.unique(block)])
    count = len(sums)
    return np.asarray(sums.T @ sums * (count / max(count - 1, 1)))


def check_registration(error: RegistrationError | None, method: str) -> None:
    """Raise InputError where the turn of a rigid registration is known too badly, from tips near to a line."""
    if error is None or not error.too_large or method != "rigid":
        return
    known = "not at all" if math.isinf(error.turn) else f"to {math.degrees(error.turn):.0f} deg only"
    raise InputError(
        f"the tips determine the device frame {known} (standard error; it must be at most "
        f"{math.degrees(MOST):g} deg): they lie too close to a line. Measure configurations "
        "bent in at least three directions, 90 deg apart, or give registration base-axis"
    )
