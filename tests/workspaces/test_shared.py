"""What two robots share, held against balls whose common part is known."""

from __future__ import annotations

import numpy as np
import pytest

from tests.examples import TWO_TUBE
from tubeopt import InputError, Workspace
from tubeopt.bodies.frames import base_frame
from tubeopt.workspaces import place_pair, shared_workspace

RADIUS, AHEAD = 0.02, 0.05


def ball(count: int = 60_000) -> Workspace:
    """Tips that fill a ball in front of the plate evenly."""
    random = np.random.default_rng(0)
    path = random.normal(size=(count, 3))
    tips = RADIUS * random.random((count, 1)) ** (1 / 3) * path / np.linalg.norm(path, axis=1, keepdims=True)
    n = TWO_TUBE.n_tubes
    table = np.zeros((count, 2 * n + 7))
    table[:, 2 * n : 2 * n + 3] = tips + np.array([0, 0, AHEAD])
    table[:, -2:] = 1.0
    return Workspace(TWO_TUBE, "random", 0, table, ())


def test_two_balls_share_a_lens() -> None:
    both, apart = [ball()] * 2, 0.02
    result = shared_workspace(both, [base_frame([x, 0, 0], [0, 0, 1]) for x in (0, apart)], size=2e-3)
    lens = np.pi * (4 * RADIUS + apart) * (2 * RADIUS - apart) ** 2 / 12
    whole = 4 / 3 * np.pi * RADIUS**3
    assert result.volumes == pytest.approx(whole, rel=0.16)  # voxels on the surface count whole
    assert result.shared == pytest.approx(lens, rel=0.25)
    assert result.fraction == pytest.approx(lens / whole, rel=0.12)
    for x in (0, apart):
        assert (np.linalg.norm(result.positions - [x, 0, AHEAD], axis=1) < RADIUS + 2e-3).all()


def test_a_pair_leans_until_both_reach_the_same() -> None:
    best = place_pair([ball(8000)] * 2, min_distance=0.03, max_distance=0.05, max_tilt=0.6)
    assert best.fraction > 0.85
    middles = [base.placed([0, 0, AHEAD]) for base in best.bases]
    assert np.linalg.norm(middles[0] - middles[1]) < 4e-3
    apart = np.linalg.norm(best.bases[0].origin - best.bases[1].origin)
    assert 0.03 <= apart <= 0.05
    upright = place_pair([ball(200)] * 2, min_distance=0.03, max_distance=0.05, max_tilt=0.0)
    for base in upright.bases:
        assert base.axes[:, 2] == pytest.approx([0, 0, 1])


def test_what_makes_no_pair_is_refused() -> None:
    both, frame = [ball(200)] * 2, base_frame([0, 0, 0], [0, 0, 1])
    with pytest.raises(InputError, match="there are 2 workspaces and 1 bases; there must be two of each"):
        shared_workspace(both, [frame])
    with pytest.raises(InputError, match="plates is 20 to 10 mm"):
        place_pair(both, min_distance=0.02, max_distance=0.01)
    with pytest.raises(InputError, match="no sample of the workspace has a margin of 2"):
        shared_workspace(both, [frame] * 2, min_margin=2.0, size=1e-3)
