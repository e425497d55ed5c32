"""Rigs that differ from their file in everything, on a thermal model that shares no code with the package's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.rig_thermal import KELVIN, Bench, Fleet, wire_loss
from benchmarks.rigs import OWN, loaded, measure
from tubeopt.shaping.heating.thermocouple import stem_loss

from .heating_reference import TUBE, thesis_rig


@pytest.mark.parametrize("objective", ["time", "margin"])
def test_drawn_rigs_keep_the_window_or_say_so(objective: str) -> None:
    found = measure(OWN, objective, "thermocouple", 60, 3, loaded("thesis_calcium_silicate", None))
    assert found.share >= 0.95
    assert found.hottest < 560
    assert found.silent == 0
    assert found.stated >= 0.95


def test_many_rigs_at_once_are_as_each_alone() -> None:
    rig = replace(thesis_rig(), mold=replace(thesis_rig().mold, wire=0.25e-3))
    alone, many = Bench(TUBE, rig), Fleet([Bench(TUBE, rig), Bench(TUBE, replace(rig, loss_factor=1.2))])
    for count in [*np.linspace(10, 20, 40).round(), *[13.0] * 40]:
        alone.pass_time(count, 0.5)
        for _ in range(5):
            many.pass_time(np.full(2, count), 0.1)
    assert np.abs(many.tube[0] - (alone.state[: alone.n] - KELVIN)).max() < 0.4
    assert many.tube[1].max() < many.tube[0].max() - 20


@pytest.mark.parametrize("cement", [1 / 3, 1.0, 3.0])
def test_wires_draw_what_the_closed_form_of_fins_says(cement: float) -> None:
    error, drawn = wire_loss(0.25e-3, 12e-3, cement)
    found = stem_loss(0.25e-3, 12e-3, quality=cement)
    assert (found.error, found.conductance) == pytest.approx((error, drawn), rel=1e-3)
