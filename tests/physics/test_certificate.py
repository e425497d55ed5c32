"""The determinant of the snap-free certificate, of two tubes against the closed form."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from tubeopt.physics.certificate import WHOLE, base_determinant


@pytest.mark.parametrize("varying", [False, True])
def test_the_determinant_of_two_tubes_is_that_of_their_difference(varying: bool) -> None:
    """Torques are opposite, T' = -c d / lambda and d' = T (1 / kt_1 + 1 / kt_2); d at the plate is what the
    transmissions are twisted by, and T is 0 at the tip. kt may differ from section to section."""
    random = np.random.default_rng(0)
    for _ in range(20):
        sections = 3
        kt = random.uniform(0.5, 2.0, (2, sections if varying else 1))
        kb, m = random.uniform(0.5, 2.0, (2, sections)), random.uniform(0.2, 2.0, (2, sections))
        length, straight = random.uniform(0.2, 0.8, sections), random.uniform(0.0, 1.0, 2)
        for eigenvalue in (0.3, 1.0, 4.0):
            d, torque = 1.0, 0.0
            for k in reversed(range(sections)):
                here = kt[:, k if varying else 0]
                g, c = (1 / here).sum(), m[0, k] * m[1, k] / kb[:, k].sum() / eigenvalue
                q = np.sqrt(c * g)
                cos, sin = np.cos(q * length[k]), np.sin(q * length[k])
                d, torque = d * cos - torque * g / q * sin, torque * cos + d * c / q * sin
            expected = d - torque * (straight / kt[:, 0]).sum()
            given = {
                "torsional_stiffness": ca.DM(kt),
                "transmission": ca.DM(straight),
                "length": ca.DM(length),
                "stiffness": ca.DM(kb),
                "moment": ca.DM(m),
            }
            assert float(base_determinant(ca.DM(eigenvalue), given, WHOLE)) == pytest.approx(
                expected, rel=1e-8, abs=1e-8
            )
