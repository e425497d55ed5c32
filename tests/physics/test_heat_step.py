"""A step of any length in time: an insulated rig keeps its heat."""

from __future__ import annotations

import numpy as np
import pytest

from tubeopt.physics.heat import PROPERTIES, Resolution, Volumes
from tubeopt.physics.heat_functions import LUMPED, instant_function, step_function, volumes_function

GRID = Resolution(2, 3, 3, 4, shells=4)


@pytest.mark.parametrize("span", [1e-2, 1.0, 1e2])
def test_a_step_of_any_length_keeps_the_heat_of_an_insulated_rig(span: float) -> None:
    """The columns of its matrices sum up to the heat capacities: what leaves a cell enters another."""
    rng = np.random.default_rng(3)
    values = dict.fromkeys(PROPERTIES, 1.0) | {
        "c_slope": 0.0, "k_slope": 0.0, "h_clamp": 0.0, "h_air": 0.0, "eps_sigma": 0.0, "h_outer": 0.0, "c_tube": 0.9,
        "kA": 1.6e-5, "h_gap": 0.4, "R_wall": 0.8, "k_mold": 0.5, "c_mold": 1e6, "G_leak": 0.0, "G_wire": 0.0,
        "T_amb": 298.0, "f_mold": 1.1, "f_25": -6e-4, "f_200": 9e-4, "f_350": 1e-3, "f_500": -4e-4, "f_700": -9e-4,
    }  # fmt: skip
    p = np.array([values[name] for name in PROPERTIES])
    width = rng.uniform(1e-3, 4e-3, GRID.cells)
    rings, ratios = rng.uniform(1e-5, 4e-5, GRID.shells), rng.uniform(0.2, 0.5, GRID.shells - 1)
    q = volumes_function(GRID)(p, width, np.zeros(GRID.covered), rings, ratios)
    cells = rng.uniform(300.0, 800.0, (1 + GRID.shells, GRID.cells))
    lumped = np.r_[298.0, np.zeros(LUMPED - 1)]
    after = np.asarray(step_function(GRID)(cells, lumped, 0.0, span, p, q)[0])
    v = Volumes.of(q, GRID)
    capacity = np.zeros_like(cells)
    capacity[0] = np.asarray(v.C_tube)[:, 0]
    capacity[1:, -GRID.covered :] = np.asarray(v.C_mold).T
    moved = capacity * (after - cells)
    assert np.abs(moved).sum() > 1e-3 * span / (1 + span)
    assert abs(moved.sum()) < 1e-11 * np.abs(capacity * cells).sum()
    stored = instant_function(GRID, "stored")
    assert float(stored(after, lumped, p, q)) == pytest.approx(float(stored(cells, lumped, p, q)), rel=1e-11)
