"""The certificate of two tubes made of pieces: exact, as far as shooting that shares nothing with the library tells."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from tubeopt import (
    ConcentricRobot,
    Piece,
    Tube,
    assess_snapping,
    certify,
    follow,
    forward_kinematics_batch,
    snap_free_certificate,
    worst_margin,
)
from tubeopt.stability import Finding
from tubeopt.stability.certificate import convexity
from tubeopt.typing import Array

KB, KT = (1.2e-3, 3.1e-3), (0.9e-3, 2.2e-3)
HELD = (0.05, 0.03)


@dataclass(frozen=True)
class Case:
    """Two tubes of pieces: lengths (m), bend (x, y) and natural twist (1/m) of each."""

    pieces: tuple[Sequence[tuple[float, tuple[float, float, float]]], ...]
    scale: float = 1.0

    @property
    def robot(self) -> ConcentricRobot:
        tubes = []
        for i, own in enumerate(self.pieces):
            outer = 1e-3 + 0.5e-3 * i
            pieces = [Piece(h, (self.scale * x, self.scale * y, z)) for h, (x, y, z) in own]
            made = Tube.of_pieces(outer, outer - 0.3e-3, pieces, straight_length=HELD[i])
            tubes.append(replace(made, bending_stiffness=KB[i], torsional_stiffness=KT[i]))
        return ConcentricRobot(tuple(tubes))


def turn_rate(case: Case) -> Callable[[Array], Array]:
    """d alpha / d x of differences x (B,) of tip angles, by DOP853 from the tip: 0 at folds, and nowhere else.

    D' = z_1 - z_2 + sigma t and t' = c sin(D + psi), with t the torque of the first tube, D that of the second taken
    off, psi the difference of bend directions; their derivatives by x from 1 and 0 at the tip.
    """
    ends = [np.cumsum([h for h, _ in own]) for own in case.pieces]
    cuts = sorted({0.0, *(float(e) for own in ends for e in own if e <= min(own[-1] for own in ends))})
    sigma = 1 / KT[0] + 1 / KT[1]

    def rates(x: Array) -> Array:
        state = np.stack([x, 0 * x, 0 * x + 1, 0 * x])
        for low, high in reversed(list(pairwise(cuts))):
            (a, b) = (
                next(u for e, (_, u) in zip(end, own, strict=True) if (low + high) / 2 < e)
                for end, own in zip(ends, case.pieces, strict=True)
            )
            bends = complex(a[0], a[1]), complex(b[0], b[1])
            c = KB[0] * KB[1] / sum(KB) * abs(bends[0] * bends[1]) * case.scale**2
            psi, z = np.angle(bends[0]) - np.angle(bends[1]), a[2] - b[2]

            def slope(s: float, flat: Array, c: float = c, psi: float = psi, z: float = z) -> Array:
                d, t, dx, tx = flat.reshape(4, -1)
                return np.concatenate([z + sigma * t, c * np.sin(d + psi), sigma * tx, c * np.cos(d + psi) * dx])

            run = solve_ivp(slope, (high, low), state.ravel(), method="DOP853", rtol=1e-11, atol=1e-12)
            state = run.y[:, -1].reshape(4, -1)
        return np.asarray(state[2] - sum(h / kt for h, kt in zip(HELD, KT, strict=True)) * state[3])

    return rates


def least_rate(case: Case) -> float:
    """The least d alpha / d x over a whole turn, refined between samples."""
    rates = turn_rate(case)
    x = np.linspace(0, 2 * np.pi, 65)
    for _ in range(3):
        values = rates(x)
        k = int(np.argmin(values))
        x = np.linspace(x[max(k - 1, 0)], x[min(k + 1, len(x) - 1)], 33)
    return float(rates(x).min())


CASES = {
    "an S in a plain tube": Case(
        (((0.04, (-22.0, 0.0, 0.0)), (0.04, (-22.0, 0.0, 0.0))), ((0.04, (23.0, 0.0, 0.0)), (0.025, (-22.0, 0.0, 0.0))))
    ),
    "two S that change at different places": Case(
        (((0.03, (14.0, 0.0, 0.0)), (0.05, (-18.0, 0.0, 0.0))), ((0.045, (16.0, 0.0, 0.0)), (0.03, (-12.0, 0.0, 0.0))))
    ),
    "helices of unequal twist": Case((((0.08, (17.0, 0.0, 30.0)),), ((0.07, (13.0, 4.0, -12.0)),))),
    "an arc, a helix and a bend in another plane": Case(
        (((0.03, (12.0, 0.0, 0.0)), (0.05, (15.0, 5.0, 40.0))), ((0.04, (14.0, 0.0, 0.0)), (0.03, (0.0, 17.0, 0.0))))
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_two_tubes_lose_their_certificate_where_they_first_can_snap(name: str) -> None:
    """All curvatures scaled until d alpha / d x first is 0 for some x: there the certificate is 0."""
    case = CASES[name]
    critical = float(brentq(lambda f: least_rate(replace(case, scale=f)), 0.2, 3.0, xtol=1e-7))
    below, above = (replace(case, scale=critical * (1 + e)).robot for e in (-2e-6, 2e-6))
    assert snap_free_certificate(below) > 0 > snap_free_certificate(above)
    assert convexity(below, below.home_translations) < -0.01


def test_it_is_the_margin_of_an_equilibrium_and_that_of_no_other_is_less() -> None:
    random = np.random.default_rng(0)
    for name, scale in (("helices of unequal twist", 1.5), ("an S in a plain tube", 0.8)):
        robot = replace(CASES[name], scale=scale).robot
        proved, worst = snap_free_certificate(robot), worst_margin(robot)
        assert worst.margin - 2e-6 * max(1.0, 1 - worst.margin) < proved < worst.margin + 1e-9
        assert worst.equilibrium.margin == pytest.approx(worst.margin, abs=1e-7)
        assert certify(robot).margin == proved
        turned = forward_kinematics_batch(robot, random.uniform(-np.pi, np.pi, (25, 2)))
        assert turned.margin.min() > proved - 1e-6


@pytest.mark.parametrize(("name", "scale"), [("an S in a plain tube", 0.8), ("helices of unequal twist", 1.5)])
def test_two_tubes_of_pieces_take_the_whole_of_what_their_margin_lacks(name: str, scale: float) -> None:
    """Their certificate beats that of pairs at their worst, so that how they oppose each other is known."""
    robot = replace(CASES[name], scale=scale).robot
    result = certify(robot)
    assert result.margin > convexity(robot, robot.home_translations) + 1e-2
    assert result.pair == (0, 1)
    assert result.pair_fractions[0, 1] == pytest.approx(1.0, abs=1e-9)


def test_pairs_that_can_oppose_each_other_all_along_have_the_certificate_of_pairs() -> None:
    twisted = Case((((0.08, (17.0, 0.0, 30.0)),), ((0.07, (13.0, 4.0, 30.0)),))).robot
    first, second = (((0.04, (x, 0.0, 0.0)), (0.03, (y, 0.0, 0.0))) for x, y in ((15.0, -9.0), (9.0, -15.0)))
    both = Case((first, second))
    for robot in (twisted, both.robot):
        assert snap_free_certificate(robot) == pytest.approx(convexity(robot, robot.home_translations), abs=2e-7)


def test_what_is_proved_turns_without_a_snap_and_what_is_not_is_shown() -> None:
    """The verdict on both sides of the threshold; where it cannot snap, full turns both ways meet nothing."""
    free, bad = (replace(CASES["an S in a plain tube"], scale=f).robot for f in (0.9, 1.6))
    assert assess_snapping(free).finding is Finding.SNAP_FREE
    turned = follow(free, np.radians([[0, 0], [360, 0], [-360, 0], [0, 360]]))
    assert not turned.snaps
    assert turned.equilibria[-1].margin == pytest.approx(turned.equilibria[0].margin, abs=1e-9)
    verdict = assess_snapping(bad)
    assert verdict.finding is Finding.CAN_SNAP
    assert verdict.decided
