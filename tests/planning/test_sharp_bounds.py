"""Bounds of a proof of a motion that are attained: by closed forms, so that no smaller constant passes."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.examples import THESIS, nested
from tubeopt import Load, forward_kinematics
from tubeopt.bodies.obstacles import Sphere
from tubeopt.bodies.scene import scene_of
from tubeopt.inverse.clock import Clock
from tubeopt.planning import apart, branch, loaded_branch, passage
from tubeopt.planning.clearing import Wanted
from tubeopt.planning.cross_sections import Constants, Jet
from tubeopt.planning.effort import ProofSearch
from tubeopt.planning.loaded_sections import LoadedArms, LoadedIntervals, Pull
from tubeopt.typing import Array

NONE = np.zeros((1, 1, 1))


def rate_of_what_is_off(ball: branch._Ball) -> float:
    """Bound of |e'| of what theta is off theta~, where theta~ is at rest and only the first derivative counts."""
    flat = Jet(NONE, NONE, NONE, NONE)
    still: Any = SimpleNamespace(
        weight=(NONE + 1, NONE[..., None]),
        drift=SimpleNamespace(bow=flat),
        cross_sections=lambda course: (flat, flat),
        rotation=lambda moment, stretch: flat,
        response=lambda turn: turn,
        norm=lambda turn: np.zeros(1),
        _stretch=lambda u: u,
    )
    return float(branch._Bounds.course(still, (NONE, NONE[..., None]), ball)[0].d.item())


@pytest.mark.parametrize("bow", [0.1, 2.0])
def test_what_solves_a_parabola_that_is_0_at_both_ends_changes_by_half_of_its_second_derivative(bow: float) -> None:
    """F = e - bow t (1 - t) / 2 has e' = bow (1 - 2 t) / 2, which is bow / 2 at the ends."""
    t = np.linspace(0.0, 1.0, 101)
    off = bow * t * (1 - t) / 2
    ball = branch._Ball(*(np.array([each]) for each in (off.max(), bow, 0.0, 1.0)))
    assert rate_of_what_is_off(ball) == pytest.approx(np.abs(np.gradient(off, t, edge_order=2)).max())


@pytest.mark.parametrize(("bow", "drift", "radius", "stretch"), [(0.4, 0.7, 0.3, 0.5), (0.0, 0.9, 0.2, 0.8)])
def test_the_rate_of_a_solution_is_that_of_the_implicit_function_theorem(
    bow: float, drift: float, radius: float, stretch: float
) -> None:
    """F = stretch (e - radius) + t (bow / 2 + drift e) = 0, solved at t = 0 and shortly after."""
    t = 1e-7
    later = (stretch * radius - t * bow / 2) / (stretch + t * drift)
    ball = branch._Ball(*(np.array([each]) for each in (radius, bow, drift, stretch)))
    assert rate_of_what_is_off(ball) == pytest.approx((radius - later) / t, rel=1e-6)


def test_what_has_a_constant_second_derivative_is_off_its_chord_by_an_eighth_of_it() -> None:
    """Torques and moments a t^2 / 2 at t = 1/2, in the norm of the elastic form, integrated along the arm."""
    random = np.random.default_rng(0)
    torque, kt = random.uniform(1, 2, (2, 1, 3, 2))
    moment, stiffness, long = random.uniform(1, 2, (3, 1, 3))
    spring = random.uniform(1, 2, (1, 2))
    bounds: Any = SimpleNamespace(
        kt=kt, stiffness=stiffness, long=SimpleNamespace(v=long), spring=SimpleNamespace(v=spring)
    )
    bounds.answer = Jet(NONE, NONE, torque), Jet(NONE, NONE, moment)
    bounds._size = lambda *parts: loaded_branch._Bounds._size(bounds, *parts)
    cuts = np.concatenate([[0.0], np.cumsum(long[0])])
    s = (np.arange(6000) + 0.5) / 6000 * cuts[-1]
    k = np.searchsorted(cuts, s) - 1
    off = [each / 2 * (1 / 2 - 1 / 2**2) for each in (torque[0], moment[0])]
    along = (off[0] ** 2 / kt[0]).sum(1)[k] + (off[1] ** 2 / stiffness[0])[k]
    true = np.sqrt(along.sum() * cuts[-1] / 6000 + (spring[0] * off[0][0] ** 2).sum())
    assert loaded_branch._Bounds.gradient(bounds).item() == pytest.approx(true, rel=1e-3)


@pytest.mark.parametrize("turn", [0.05, 0.2])
def test_the_gradient_along_the_chord_of_two_tubes_is_that_of_the_sine_of_their_angle(turn: float) -> None:
    """T_i = c (L - s) sin D around D = 90 deg, where the sine bends most. The bound has L for L - s: 3^(1/2) of it."""
    length, curvature = 0.05, 0.5
    robot = nested((0.0, length, curvature), (0.0, length, curvature))
    inner, outer = robot.tubes
    one, other = inner.bending_stiffness, outer.bending_stiffness
    coupling = one * other / (one + other) * curvature**2
    chain = [forward_kinematics(robot, [angle, 0.0], load=Load()) for angle in np.pi / 2 + np.array([-turn, turn]) / 2]
    arms = LoadedArms.of(Constants.of(robot), chain, pull=Pull.of(robot, Load()))
    intervals = LoadedIntervals.of(arms, np.array([0]), np.array([1]))
    found = loaded_branch._Bounds(intervals).gradient().item()
    off = coupling * (1 - np.cos(turn / 2))
    true = off * np.sqrt(length**3 / 3 * (1 / inner.torsional_stiffness + 1 / outer.torsional_stiffness))
    assert np.sqrt(3) * true * (1 - 1e-3) <= found <= np.sqrt(3) * true * 1.02


class Rod:
    """A track of a straight arm of one section that moves along one axis, all that `apart` takes of a track."""

    def __init__(self, begin: Array, end: Array, move: Array, off: float = 0.0, radius: float = 0.0) -> None:
        self.begin, self.end, self.move = begin, end, move
        nothing = np.zeros((1, 1))
        long = np.array([[np.linalg.norm(end - begin)]])
        self.intervals: Any = SimpleNamespace(
            length=(long, long), radius=nothing + radius, sagitta=lambda link, section, x: np.zeros(len(link))
        )
        self.off, self.times = nothing + off, np.array([0.0, 1.0])
        self.follower: Any = SimpleNamespace(effort=SimpleNamespace(arms_rounds=1), over=True)
        self.whole = True

    def link_at(self, t: Array) -> Array:
        return np.zeros(t.shape, dtype=np.intp)

    def places(self, link: Array, section: Array, x: Array, t: Array) -> Array:
        here = self.begin + x[:, None] * (self.end - self.begin)
        return np.asarray(here[:, None] + (t[..., None] - 0.5) * self.move)


@pytest.mark.parametrize(("a", "b", "c", "height"), [(2, 3, 0, 1), (2, 3, 0, 0), (2, 3, 4, 0), (3, 0, 2, 0.5)])
def test_perpendicular_segments_that_cross_in_their_middle_are_as_far_apart_as_their_middles(
    a: float, b: float, c: float, height: float
) -> None:
    """Of length a and b, one of which moves by c across both: a symmetric cell, whose middle is the nearest."""
    x, y, z = np.eye(3)
    along, across = (y, z) if b else (z, y)
    up = height * (z if b else np.eye(3)[2])
    one, other = Rod(-a / 2 * x, a / 2 * x, 0 * x), Rod(up - b / 2 * along, up + b / 2 * along, c * across)
    tracks: Any = (one, other)
    found = apart.apart((0, 1), tracks, Wanted(0.0, 1e-9, 0))
    assert found.least_clearance == pytest.approx(height, abs=1e-12)


def test_what_arms_are_thick_and_off_their_line_is_taken_off_their_distance() -> None:
    x, y, z = np.eye(3)
    tracks: Any = (Rod(-x, x, 0 * x, 0.01, 0.2), Rod(3 * z - y, 3 * z + y, 0 * x, 0.03, 0.5))
    found = apart.apart((0, 1), tracks, Wanted(0.0, 1e-9, 0))
    assert found.least_clearance == pytest.approx(3 - 0.04 - 0.7, abs=1e-12)


@pytest.mark.parametrize(("share", "more"), [(0.6e-9, 0), (2.2e-9, 3), (0.1, 63)])
def test_a_stretch_of_time_that_is_short_is_not_halved(share: float, more: int) -> None:
    """Where one cell at once cannot show the clearance, stretches are halved down to 1e-9 of the time, or
    until there are no equilibria left, of which each round takes twice as many."""
    body = Sphere((0.0, 0.0, 0.4), 0.05)
    wanted, effort = Wanted(0.5, 1e-9, 0), ProofSearch(equilibria=40)
    follower = passage.Follower(THESIS, scene_of([body]), wanted, Clock(60.0), effort)
    joints = [np.append(angles, THESIS.home_translations) for angles in ([0.0, 0.0, 0.0], [0.02, 0.0, 0.0])]
    steps = [
        passage.Step(at, forward_kinematics(THESIS, q[:3]), q) for at, q in zip((0.5, 0.5 + share), joints, strict=True)
    ]
    links, lost = passage.joined(follower, [passage.Link(steps[0], steps[1])])
    assert not lost
    passage._kept_clear(follower, links)
    assert follower.count == more
