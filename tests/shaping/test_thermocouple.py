"""Thermocouples in the slot of a mold: heat along their wires, and the error that it makes."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from tubeopt import Thermocouple
from tubeopt.constants import ZERO_CELSIUS
from tubeopt.shaping.heating import thermocouple as law
from tubeopt.shaping.heating.robust import readings
from tubeopt.shaping.heating.sensors import equipped
from tubeopt.shaping.heating.thermal import thermal_model
from tubeopt.shaping.heating.thermocouple import reading_error, stem_loss

from .heating_reference import TUBE, thesis_rig


def test_the_bead_of_a_leg_is_that_of_exponentials() -> None:
    """Shooting through four zones of constant conductances, each by a matrix exponential."""
    wire, r = 0.25e-3, 0.125e-3
    over = 2 * math.pi / math.log((r + 50e-6) / r + math.sqrt(((r + 50e-6) / r) ** 2 - 1))
    kA, slot, hole = 25.0 * math.pi * r**2, 2 * math.pi * 0.056 / math.log(1.8), 2 * math.pi * 0.056 / math.log(4.8)
    # Length, conductance to the tube and to the wall, wall at the start and its slope.
    zones = [
        (3e-3, over * 1.056, slot, 0.85, 0.0),
        (9e-3, over * 0.056, slot, 0.85, 0.0),
        (6.35e-3, 0.0, hole, 0.85, -0.85 / 6.35e-3),
        (30e-3, 0.0, 15 * 2 * math.pi * r, 0.0, 0.0),
    ]

    def along(bead: float) -> list[np.ndarray]:
        """T, T', 1 and x at the start and after each zone."""
        states = [np.array([bead, 0.0, 1.0, 0.0])]
        for length, tube, wall, T, slope in zones:
            rate = np.array([[0, 1, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 1, 0]], dtype=float)
            rate[1] = np.array([tube + wall, 0.0, -tube - wall * T, -wall * slope]) / kA
            states.append(expm(rate * length) @ np.append(states[-1][:3], 0.0))
        return states

    # Linear in the bead's rise: the one that leaves no flow at the free end.
    first, second = (along(bead)[-1][1] for bead in (0.0, 1.0))
    bead = first / (first - second)
    lost = stem_loss(wire, 12e-3)
    assert lost.error == pytest.approx(1 - bead, rel=0.05)
    assert lost.conductance == pytest.approx(-2 * kA * along(bead)[2][1], rel=0.05)


def test_the_default_error_is_that_of_wire_and_anchor() -> None:
    low, high = reading_error(0.25e-3, 12e-3, 525.0, 25.0)
    sensor = Thermocouple()
    assert (sensor.correction, sensor.bias) == pytest.approx((-(low + high) / 2, (high - low) / 2), abs=0.05)
    assert low < -10 < 0 < high < 3
    # A bead that only touches reads 45 K too little; a thinner wire draws less heat.
    assert 500 * stem_loss(0.25e-3, 12e-3, quality=0.0).error == pytest.approx(45, abs=2)
    assert stem_loss(0.13e-3, 12e-3).conductance < 0.4 * stem_loss(0.25e-3, 12e-3).conductance
    assert law.FILM > 0


def test_the_wires_cool_the_middle_by_the_heat_that_they_draw() -> None:
    rig, sensor = thesis_rig(), Thermocouple()
    with_wires = equipped(rig, sensor)
    models = [thermal_model(TUBE, each) for each in (rig, with_wires)]
    drawn = models[1].volumes.sum() - models[0].volumes.sum()
    # One half of the tube has one leg, the other half is its mirror image.
    assert drawn == pytest.approx(0.5 * stem_loss(sensor.wire, sensor.anchor).conductance, rel=1e-9)
    end = [readings(model, sensor, 0.5, np.full(120, 0.03))[-1, 0] for model in models]
    assert 5 < end[0] - end[1] < 40
    assert readings(models[0], sensor, 0.5, np.zeros(2))[-1, 0] == pytest.approx(rig.ambient - ZERO_CELSIUS)
    assert replace(with_wires.mold, wire=0.0).anchor == sensor.anchor
