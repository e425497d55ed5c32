"""Strain of what slots leave of a tube, against beams whose cross-sections are summed up point by point."""

from __future__ import annotations

import numpy as np
import pytest

from tubeopt.physics.strain import SMOOTH, bend_from_own, slotted_strain_ratio, surface_strain

OUTER, INNER = 1.0e-3, 0.75e-3


@pytest.mark.parametrize(("left", "symmetric"), [((0.25, 0.75), True), ((0.1, 0.9), True), ((0.0, 0.6), False)])
@pytest.mark.parametrize("share", [0.2, 0.5, 0.9])
def test_slotted_beams_in_series_are_not_strained_more(
    left: tuple[float, float], symmetric: bool, share: float
) -> None:
    """Left of the ring are sectors between two parts of a half turn, on both sides of the plane of the bend."""
    r, angle = np.meshgrid(np.linspace(INNER, OUTER, 201), np.linspace(0, np.pi, 2001))
    y, area = r * np.cos(angle), r
    current = (angle >= left[0] * np.pi) & (angle <= left[1] * np.pi)
    neutral = (y * area)[current].sum() / area[current].sum()
    stiff = ((y - neutral) ** 2 * area)[current].sum() / (y**2 * area).sum()
    bending_factor = 1 / (1 - share + share / stiff)
    strain = 7.0 * bending_factor / stiff * np.abs(y - neutral)[current].max()
    bound = OUTER * 7.0 * slotted_strain_ratio(bending_factor, share, symmetric=symmetric)
    assert strain <= bound * (1 + 1e-12)
    assert strain > 0.35 * bound


def test_without_slots_it_is_the_strain_of_the_tube() -> None:
    assert slotted_strain_ratio(1.0, 0.3) == pytest.approx(1.0)


def test_the_bend_from_the_own_curvature_is_the_length_of_their_difference() -> None:
    random = np.random.default_rng(0)
    for _ in range(100):
        angle, natural, stretch = random.uniform(0, 2 * np.pi), random.uniform(-30, 30), random.uniform(0.8, 1.2)
        bent = random.uniform(-30, 30, 2)
        own = natural * np.array([np.cos(angle), np.sin(angle)])
        true = np.linalg.norm(bent / stretch - own)
        direction = np.cos(angle), np.sin(angle)
        assert true - SMOOTH <= bend_from_own(direction, bent, natural, stretch) <= true
        assert bend_from_own(direction, own * stretch, natural, stretch) == pytest.approx(0, abs=1e-14)


def test_a_straight_tube_around_a_drum_is_strained_by_its_radius_over_that_of_the_drum() -> None:
    """A curved tube that is made straight is strained by r kappa / (1 - r kappa): its inside is the shorter."""
    radius, curvature = 1e-3, 50.0
    assert surface_strain(radius, curvature, 0.0) == pytest.approx(radius * curvature)
    inside = 1 / curvature - radius  # of the drum that its inner side lies on
    assert surface_strain(radius, curvature, -curvature) == pytest.approx(1 / curvature / inside - 1)
