"""Gains of the law from the thermal model: a linear-quadratic regulator of its response to a share of power."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from ...typing import Array
from .sensors import Felt, Sensor
from .thermal import ThermalModel

PROBE = 0.02
"""Share by which the planned duties are raised to see what the reading does."""

RESET = 8.0
"""Time, s, in which an error that stays weighs as much as one at once: that of the mold's first shells, which fill up
and are why the tube needs less and less power."""


@dataclass(frozen=True)
class Response:
    """What the reading does after a share of power: towards `gain`, K, with a time constant, s."""

    gain: float
    time_constant: float


def readings(model: ThermalModel, sensor: Sensor, slot: float, duty: Array) -> Array:
    """(T + 1, B) degC that a sensor without bias and noise shows under duties (T,) in [0, 1]."""
    felt = [Felt.at_rest(model, sensor)]
    for level in duty:
        felt.append(felt[-1].after(model, sensor, level, slot))
    return np.array([now.lagged for now in felt])


def response(model: ThermalModel, sensor: Sensor, slot: float, duty: Array, hold: tuple[int, int]) -> Response:
    """The response of the first member's reading in the hold (first slot, and the slot before which it ends)."""
    first, last = hold
    plain = readings(model, sensor, slot, duty)[:, 0]
    raised = readings(model, sensor, slot, np.where(np.arange(len(duty)) < first, duty, duty * (1 + PROBE)))[:, 0]
    rise = (raised - plain)[first : last + 1] / PROBE
    gain = float(rise[-1])
    # The area between the step and its end is the time constant, whatever the shape is.
    return Response(gain, float(max(slot * np.sum(1 - rise / gain), slot)))


def regulator(found: Response, slot: float, share_per_kelvin: float) -> tuple[float, float]:
    """Proportional (1/K) and integral gain (1/(K s)) that balance errors with the share that they cost.

    The least sum over slots of e^2 + (sum of e / RESET)^2 + (share / share_per_kelvin)^2, the reading being the state:
    the algebraic Riccati equation of error and integrated error.
    """
    kept = float(np.exp(-slot / found.time_constant))
    A = np.array([[kept, 0.0], [slot, 1.0]])
    B = np.array([[-found.gain * (1 - kept)], [0.0]])
    Q, R = np.diag([1.0, 1 / RESET**2]), np.array([[1 / share_per_kelvin**2]])
    P = scipy.linalg.solve_discrete_are(A, B, Q, R)
    gains = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)[0]
    return float(-gains[0]), float(-gains[1])
