"""Strain of what slots leave of a tube, against beams whose cross-sections are summed up point by point."""

from __future__ import annotations

import numpy as np
import pytest

from tubeopt.physics.strain import slotted_strain_ratio

OUTER, INNER = 1.0e-3, 0.75e-3


@pytest.mark.parametrize(("left", "symmetric"), [((0.25, 0.75), True), ((0.1, 0.9), True), ((0.0, 0.6), False)])
@pytest.mark.parametrize("share", [0.2, 0.5, 0.9])
def test_slotted_beams_in_series_are_not_strained_more(
    left: tuple[float, float], symmetric: bool, share: float
) -> None:
    """Left of the ring are sectors between two parts of a half turn, on both sides of the plane of the bend."""
    r, angle = np.meshgrid(np.linspace(INNER, OUTER, 201), np.linspace(0, np.pi, 2001))
    y, area = r * np.cos(angle), r
    here = (angle >= left[0] * np.pi) & (angle <= left[1] * np.pi)
    neutral = (y * area)[here].sum() / area[here].sum()
    stiff = ((y - neutral) ** 2 * area)[here].sum() / (y**2 * area).sum()
    bending_factor = 1 / (1 - share + share / stiff)
    strain = 7.0 * bending_factor / stiff * np.abs(y - neutral)[here].max()
    bound = OUTER * 7.0 * slotted_strain_ratio(bending_factor, share, symmetric=symmetric)
    assert strain <= bound * (1 + 1e-12)
    assert strain > 0.35 * bound


def test_without_slots_it_is_the_strain_of_the_tube() -> None:
    assert slotted_strain_ratio(1.0, 0.3) == pytest.approx(1.0)
