"""How well a registration is known: its standard error in rad and m, and whether a mirror image would fit better.

The turn minimises  sum_v w_v |R m_v + t - p_v|^2, whose second derivative by the turn, the translation following, is
H = tr(S) I - S  with  S = sum_v w_v (R m_v - mean)(p_v - mean)'  (symmetric at the minimum), curvature by residuals
included. Data on a line, or residuals as large as the spread across it, leave H singular or indefinite.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..typing import Array, Index
from .folds import deal
from .model import ArmModel, State
from .registration import FREEDOMS

MOST = math.radians(5.0)
"""Standard error of the turn beyond which a registration is refused."""

BLOCKS = 20
"""Of rows, where there are as many places: errors of neighbouring rows are alike."""

NARROW = 0.1
"""Spread across over spread along, below which tips are taken as near to a line."""

MIRRORED = 0.7
"""A mirror image whose residual is below this part of the registration's is worth a remark."""


@dataclass(frozen=True)
class RegistrationError:
    """Standard errors of a registration: the larger of those for independent errors and those from blocks of rows."""

    turn: float
    """About the axis that is known worst, rad; inf where the data leave it open."""
    reach: float
    """Of the position of a point at the arm's length from the plate's centre, the worst of all directions, m."""
    narrow: float
    """Spread of the predicted tips across the line that is nearest to them, over the spread along it."""
    mirrored: float | None = None
    """Root mean square distance to the best mirror image, m, where that is clearly smaller; else None."""

    @property
    def remark(self) -> str:
        """What a mirror image that fits better means, or a turn that is known badly, in words; "" where neither is."""
        if self.mirrored is None:
            known = f"the frame is known to {math.degrees(self.turn):.0f} deg only (standard error)"
            return "" if self.turn <= MOST else f"{known}: the tips are too few, or the model is too far from them"
        return (
            f"a mirror image of the measured tips fits better (RMS {self.mirrored * 1e3:.2f} mm): does a rotation or "
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
    s = np.einsum("v,vi,vj->ij", weight, here + lever, there + lever)
    hessian = turns @ (np.trace(s) * np.eye(3) - (s + s.T) / 2) @ turns.T
    least, scale = np.linalg.eigvalsh(hessian)[0], max(float(np.trace(hessian)), 1e-300)
    mirrored = _mirrored(here[~a], there[~a], math.sqrt(size[0] / (~a).sum())) if freedoms == 6 else None
    along = np.linalg.svd(there[~a] - there[~a].mean(0), compute_uv=False)
    narrow = float(along[1] / max(along[0], 1e-300)) if len(along) > 1 else 0.0
    if least <= 1e-9 * scale:
        return RegistrationError(math.inf, math.inf, narrow, mirrored)
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
    errors = [_errors(covariance, turns, centre, model.length) for covariance in both]
    turn, reach = np.max(errors, axis=0).tolist()
    return RegistrationError(turn, reach, narrow, mirrored)


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


def _errors(covariance: Array, turns: Array, centre: Array, length: float) -> tuple[float, float]:
    """Standard errors of the turn about its worst axis, and of the worst point at a distance from the plate."""
    n = len(turns)
    about = turns.T @ covariance[:n, :n] @ turns
    reach = 0.0
    for point in length * np.vstack([np.eye(3), -np.eye(3)]):
        x, y, z = point - centre
        cross = np.array([[0, z, -y], [-z, 0, x], [y, -x, 0]])  # of a small turn
        change = np.hstack([cross @ turns.T, np.eye(3)])
        reach = max(reach, float(np.linalg.eigvalsh(change @ covariance @ change.T)[-1]))
    return math.sqrt(max(np.linalg.eigvalsh(about)[-1], 0.0)), math.sqrt(reach)


def _mirrored(here: Array, there: Array, left: float) -> float | None:
    """Root mean square distance to the best mirror image, where it is clearly below what is left, else None."""
    u, v = here - here.mean(0), there - there.mean(0)
    size = np.linalg.svd(u.T @ v)[1]
    sign = np.sign(np.linalg.det(u.T @ v))
    best = (u**2).sum() + (v**2).sum() - 2 * (size[0] + size[1] - sign * size[2])
    apart = math.sqrt(max(float(best), 0.0) / len(u))
    return apart if apart < MIRRORED * left else None


def check_registration(error: RegistrationError | None, method: str) -> None:
    """Raise InputError where the turn of a rigid registration is known too badly, from tips near to a line."""
    if error is None or error.turn <= MOST or error.narrow > NARROW or method != "rigid":
        return
    known = "not at all" if math.isinf(error.turn) else f"to {math.degrees(error.turn):.0f} deg only"
    raise InputError(
        f"the tips tell the device's frame {known} (standard error; at most {math.degrees(MOST):g} deg): they lie too "
        "near to a line for what the model leaves unexplained; measure configurations bent to at least three sides, "
        "90 deg apart, or give registration base-axis with a measured base"
    )
