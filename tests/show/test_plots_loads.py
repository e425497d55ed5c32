"""The picture of what friction can hold an arm in."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tubeopt import ConcentricRobot, Friction, Tube, forward_kinematics, friction_band
from tubeopt.show.plots import plot_friction_band


def test_band_of_friction(tmp_path: Path) -> None:
    tubes = (Tube(1e-3, 0.75e-3, 0.1, 0.08, 8.0), Tube(1.5e-3, 1.15e-3, 0.07, 0.06, 8.0))
    band = friction_band(forward_kinematics(ConcentricRobot(tubes), [0.3, 1.9]), Friction(5e-3))
    figure = plot_friction_band(band, tmp_path / "band.png")
    for axes, across in zip(figure.axes, (0, 1), strict=True):
        proved, first = (patch.get_path().vertices for patch in axes.patches)
        tip = band.equilibrium.tip_position[[across, 2]] * 1e3
        half = len(band.equilibrium.arc_length) - 1
        assert np.linalg.norm(proved[half] - tip) == pytest.approx(1e3 * band.tip_radius)
        assert 0 < np.linalg.norm(first[half] - tip) < 1e3 * np.linalg.norm(band.tip_half_widths) * (1 + 1e-9)
