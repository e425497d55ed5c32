"""Physical constants in SI; `tests/test_constants.py` compares them with `scipy.constants`."""

from __future__ import annotations

GRAVITY = 9.80665
"""Standard acceleration of free fall, m/s^2."""

ZERO_CELSIUS = 273.15
"""0 degC in K."""

STEFAN_BOLTZMANN = 5.670374419e-8
"""Constant of black-body radiation, W/(m^2 K^4)."""
