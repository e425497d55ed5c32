"""Motions with friction in the compiled kernel, beside the same increments in Python."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from tests.examples import THESIS
from tests.stability.test_friction import random_way
from tests.validation.drives import joints, robot
from tubeopt import ConcentricRobot, Friction, Piece, Tube
from tubeopt.equilibrium.continuation import steps_along
from tubeopt.equilibrium.friction import sweep, swept
from tubeopt.solvers.compiled.binding import kernel_of
from tubeopt.solvers.settings import LARGEST_SHIFT, LARGEST_TURN
from tubeopt.stability import friction_path
from tubeopt.stability.friction_path import start_with_friction
from tubeopt.typing import Array
from tubeopt.validation import model as posing
from tubeopt.validation.model import PredictedPoses

pytestmark = pytest.mark.skipif(kernel_of(THESIS) is None, reason="no C compiler")


def way(seed: int) -> tuple[ConcentricRobot, Array, Friction]:
    """A random robot with friction along its tubes, and rows (T, 2n) of a way with corners."""
    inputs, rotations, translations, rub = random_way(seed)
    corners = np.hstack([rotations, translations])
    at = np.linspace(0, len(corners) - 1, 21)
    rows = np.column_stack([np.interp(at, np.arange(len(corners)), column) for column in corners.T])
    return inputs, rows, Friction(rub.torque)


def way_of_pieces(seed: int) -> tuple[ConcentricRobot, Array, Friction]:
    """A robot of pieces that vary and twist along the tubes, with friction, and rows (T, 2n) of a way with slides."""
    random = np.random.default_rng(seed)
    wavy = Piece(0.05, lambda s: (9 * math.cos(30 * s), 3.0, 5 * s), torsional_stiffness=lambda s: 1e-3 + 0.01 * s)
    soft = Piece(0.06, (4.0, 5.0, 3.0), bending_stiffness=lambda s: 8e-3 * (1 + 0.3 * math.sin(40 * s)))
    inner = Tube.of_pieces(1.0e-3, 0.8e-3, (wavy, Piece(0.03, 6.0)), straight_length=0.12)
    middle = Tube.of_pieces(1.5e-3, 1.2e-3, (soft,), straight_length=0.06)
    inputs = ConcentricRobot((inner, middle, Tube(2.0e-3, 1.7e-3, 0.03, 0.05, 4.0)))
    slides = np.minimum(np.cumsum(random.normal(0, 4e-3, (6, 3)), axis=0), 0.0)
    corners = np.hstack([np.cumsum(random.normal(0, 0.7, (6, 3)), axis=0), slides])
    at = np.linspace(0, len(corners) - 1, 21)
    rows = np.column_stack([np.interp(at, np.arange(len(corners)), column) for column in corners.T])
    return inputs, rows, Friction((0.02, 0.01), by_moment=(0.0, 2.0))


def poses(given: ConcentricRobot, rows: Array, rub: Friction) -> PredictedPoses:
    alpha, shift = np.hsplit(rows, 2)
    return posing.poses_with_friction(given, (alpha, shift), np.array([0.0, 0.03]), [np.arange(len(rows))], rub)


def test_no_step_is_too_long_or_changes_the_order_of_breakpoints() -> None:
    """Between rows far apart; places from the lengths of the tubes, and the plate."""
    draw, lengths = np.random.default_rng(2), np.array([tube.curved_length for tube in THESIS.tubes])
    rows = np.hstack([draw.uniform(-1, 1, (30, 3)), draw.uniform(-0.06, 0.0, (30, 3))])
    rows[10] = rows[9]
    steps, inputs = steps_along(THESIS, rows)
    assert (steps[inputs] == rows).all()
    assert inputs[10] == inputs[9] + 1
    assert 100 < len(steps) < 400
    change = np.abs(np.diff(steps, axis=0))
    assert change[:, :3].max() <= LARGEST_TURN * (1 + 1e-12)
    assert change[:, 3:].max() <= LARGEST_SHIFT * max(tube.length for tube in THESIS.tubes) * (1 + 1e-12)
    positions = np.hstack([steps[:, 3:], steps[:, 3:] + lengths, np.zeros((len(steps), 1))])
    gap = positions[:, :, None] - positions[:, None]
    gap[np.abs(gap) < 1e-11] = 0.0
    assert (gap[1:] * gap[:-1] >= 0).all()
    # On a straight path, row by row.
    for k, (first, last) in enumerate(pairwise(inputs.tolist())):
        part = (steps[first : last + 1] - rows[k]) @ (rows[k + 1] - rows[k])
        assert (np.diff(part) > 0).all() or k == 9


# 4 has steps that the kernel leaves to Python, 15 slides.
@pytest.mark.parametrize(
    ("of", "seed"), [(way, 2), (way, 4), (way, 15), (way_of_pieces, 0), (way_of_pieces, 1), (way_of_pieces, 3)]
)
def test_kernel_finds_the_states_of_python(
    of: Callable[[int], tuple[ConcentricRobot, Array, Friction]], seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    inputs, rows, rub = of(seed)
    held = start_with_friction(inputs, rows[0], Friction(rub.torque, refinement=-1))
    assert sweep(inputs, held, rows, np.zeros(1)) is not None
    own = poses(inputs, rows, rub)
    monkeypatch.setattr(friction_path, "sweep", lambda *_, **__: None)
    other = poses(inputs, rows, rub)
    assert own.solved.all()
    assert own.position == pytest.approx(other.position, abs=1e-10)
    assert own.frame == pytest.approx(other.frame, abs=1e-9)
    assert own.margin == pytest.approx(other.margin, abs=1e-5)
    assert own.length == pytest.approx(other.length, abs=1e-15)


def test_laws_of_friction_hold_in_the_kernel() -> None:
    """The state after every row slips against its torque, and from where the row before left its material."""
    rub = Friction(0.012, refinement=-1)
    time = np.arange(60) / 10.0
    rows = joints(3 * time, 3 * time[-1]) * [1, 1, 0, 0]
    held = start_with_friction(robot(), rows[0], rub)
    fronts, worst = 0, 0.0
    for k in range(1, len(rows)):
        result = sweep(robot(), held, rows[k - 1 : k + 1], np.zeros(1))
        assert result is not None
        assert len(result.margin) == 1
        reached = swept(robot(), held, rows[k - 1 : k + 1], result, 1)
        slip, own = (
            reached.increment.state.relative_rotations - held.increment.state.relative_rotations,
            reached.increment,
        )
        stuck = own.signs == 0
        wrong = np.concatenate(
            [np.abs(slip[stuck]), -(slip * own.signs)[~stuck], np.abs(own.torque) / reached.contact.capacity - 1, [0.0]]
        )
        assert own.violation == pytest.approx(wrong.max(), abs=1e-15)
        assert own.violation < 1e-9
        assert own.torque[~stuck] == pytest.approx((reached.contact.capacity * own.signs)[~stuck], rel=1e-12)
        balance = own.state.gradient + reached.contact.rows.T @ own.torque
        assert np.abs(reached.contact.problem.factor @ balance).max() < 1e-11
        fronts += bool(stuck.any() and not stuck.all())
        held, worst = reached, max(worst, own.violation)
    assert fronts > 10
    assert worst > 1e-16  # measured, not 0


def test_what_the_kernel_leaves_to_python() -> None:
    rows = np.zeros((3, 4))
    for rub in (Friction(0.01, ends=1e-5), Friction(0.01, sliding=True)):
        assert sweep(robot(), start_with_friction(robot(), rows[0], rub), rows, np.zeros(1)) is None
