"""Bounds of a proof of a motion that are attained: by closed forms, so that no smaller constant passes."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.examples import THESIS, nested
from tubeopt import Load, forward_kinematics
from tubeopt.bodies.frames import base_frame
from tubeopt.bodies.obstacles import Sphere, scene_of
from tubeopt.inverse.clock import Clock
from tubeopt.planning import arms as several_arms
from tubeopt.planning import branch, loaded_branch, reach_fraction, trajectory_trace
from tubeopt.planning.loaded_sections import DeadLoad, LoadedArms, LoadedIntervals
from tubeopt.planning.sections import PARTS, Constants, DerivativeBounds, Intervals, SolvedArms, linear
from tubeopt.planning.trajectory_trace import Cells, ClearanceTarget, Sizes, clearance_bounds
from tubeopt.robots.robot import Robot
from tubeopt.typing import Array

NONE = np.zeros((1, 1, 1))

STEPPED = nested((0.04, 0.05, 4.0), (0.02, 0.03, 3.0))
"""Two tubes with transmissions, whose curved parts begin and end at different places."""


def between(robot: Robot, *joints: tuple[Any, Any]) -> Intervals:
    """The interval between the equilibria at two joint values."""
    arms = SolvedArms.of(Constants.of(robot), [forward_kinematics(robot, *each) for each in joints])
    return Intervals.of(arms, np.array([0]), np.array([1]))


def bounds_between(robot: Robot, *joints: tuple[Any, Any]) -> branch._Bounds:
    """What is known of the interval between the equilibria at two joint values."""
    return branch._Bounds(between(robot, *joints), np.ones(1))


def rate_of_what_is_off(ball: branch._Ball) -> float:
    """Bound of |e'| of what theta is off theta~, where theta~ is at rest and only the first derivative counts."""
    flat = DerivativeBounds(NONE, NONE, NONE, NONE)
    still: Any = SimpleNamespace(
        weight=(NONE + 1, NONE[..., None]),
        transport=SimpleNamespace(twist_deviation=flat),
        cross_sections=lambda course: (flat, flat),
        rotation=lambda moment, stretch: flat,
        response=lambda turn: turn,
        norm=lambda turn: np.zeros(1),
        _stretch=lambda u: u,
    )
    return float(branch._Bounds.solution_derivatives(still, (NONE, NONE[..., None]), ball)[0].d.item())


@pytest.mark.parametrize("bow", [0.1, 2.0])
def test_what_solves_a_parabola_that_is_0_at_both_ends_changes_by_half_of_its_second_derivative(bow: float) -> None:
    """F = e - bow t (1 - t) / 2 has e' = bow (1 - 2 t) / 2, which is bow / 2 at the ends."""
    t = np.linspace(0.0, 1.0, 101)
    off = bow * t * (1 - t) / 2
    ball = branch._Ball(*(np.array([each]) for each in (off.max(), bow, 0.0, 1.0)))
    assert rate_of_what_is_off(ball) == pytest.approx(np.abs(np.gradient(off, t, edge_order=2)).max())


@pytest.mark.parametrize(("bow", "transport", "radius", "stretch"), [(0.4, 0.7, 0.3, 0.5), (0.0, 0.9, 0.2, 0.8)])
def test_the_rate_of_a_solution_is_that_of_the_implicit_function_theorem(
    bow: float, transport: float, radius: float, stretch: float
) -> None:
    """F = stretch (e - radius) + t (bow / 2 + drift e) = 0, solved at t = 0 and shortly after."""
    t = 1e-7
    later = (stretch * radius - t * bow / 2) / (stretch + t * transport)
    ball = branch._Ball(*(np.array([each]) for each in (radius, bow, transport, stretch)))
    assert rate_of_what_is_off(ball) == pytest.approx((radius - later) / t, rel=1e-6)


def test_what_has_a_constant_second_derivative_is_off_its_chord_by_an_eighth_of_it() -> None:
    """Torques and moments a t^2 / 2 at t = 1/2, in the norm of the elastic form, integrated along the arm."""
    random = np.random.default_rng(0)
    torque, kt = random.uniform(1, 2, (2, 1, 3, 2))
    moment, stiffness, long = random.uniform(1, 2, (3, 1, 3))
    spring = random.uniform(1, 2, (1, 2))
    bounds: Any = SimpleNamespace(
        kt=kt, stiffness=stiffness, length=SimpleNamespace(v=long), spring=SimpleNamespace(v=spring)
    )
    bounds.chord = SimpleNamespace(
        torque=DerivativeBounds(NONE, NONE, torque), moment=DerivativeBounds(NONE, NONE, moment)
    )
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
    arms = LoadedArms.of(Constants.of(robot), chain, load=DeadLoad.of(robot, Load()))
    intervals = LoadedIntervals.of(arms, np.array([0]), np.array([1]))
    result = loaded_branch._Bounds(intervals).gradient().item()
    off = coupling * (1 - np.cos(turn / 2))
    true = off * np.sqrt(length**3 / 3 * (1 / inner.torsional_stiffness + 1 / outer.torsional_stiffness))
    assert np.sqrt(3) * true * (1 - 1e-3) <= result <= np.sqrt(3) * true * 1.02


class Rod:
    """A track of an arm of one section that is bilinear between its corners (2 along, 2 in time, 3), all that `apart`
    takes of a track."""

    def __init__(self, corners: Array, off: float = 0.0, radius: float = 0.0, bend: float = 0.0) -> None:
        self.corners = corners
        nothing = np.zeros((1, 1))
        long = np.array([[np.linalg.norm(corners[1] - corners[0], axis=1).max()]])
        self.intervals: Any = SimpleNamespace(
            length=(long, long), radius=nothing + radius, sagitta=lambda link, section, x: np.full(len(link), bend)
        )
        self.chord_error, self.times = nothing + off, np.array([0.0, 1.0])
        self.verifier: Any = SimpleNamespace(exhausted=True)
        self.complete = True

    def link_at(self, t: Array) -> Array:
        return np.zeros(t.shape, dtype=np.intp)

    def positions(self, link: Array, section: Array, x: Array, t: Array) -> Array:
        reached = self.corners[0] + x[:, None, None] * (self.corners[1] - self.corners[0])
        return np.asarray(reached[:, :1] + t[..., None] * (reached[:, 1:] - reached[:, :1]))


def moved(begin: Array, end: Array, move: Array) -> Array:
    """Corners of a segment that moves, and is from `begin` to `end` half-way."""
    return np.stack([np.stack([each - move / 2, each + move / 2]) for each in (begin, end)])


def clearance(one: Rod, other: Rod) -> float:
    """Bound of the distance of two, by a single cell."""
    tracks: Any = (one, other)
    return several_arms.apart((0, 1), tracks, ClearanceTarget(0.0, 1e-9, 0)).least_clearance


@pytest.mark.parametrize(("a", "b", "c", "height"), [(2, 3, 0, 1), (2, 3, 0, 0), (2, 3, 4, 0), (3, 0, 2, 0.5)])
def test_perpendicular_segments_that_cross_in_their_middle_are_as_far_apart_as_their_middles(
    a: float, b: float, c: float, height: float
) -> None:
    """Of length a and b, one of which moves by c across both: a symmetric cell, whose middle is the nearest."""
    x, y, z = np.eye(3)
    along, across = (y, z) if b else (z, y)
    up = height * (z if b else np.eye(3)[2])
    one, other = moved(-a / 2 * x, a / 2 * x, 0 * x), moved(up - b / 2 * along, up + b / 2 * along, c * across)
    assert clearance(Rod(one), Rod(other)) == pytest.approx(height, abs=1e-12)


def test_what_arms_are_thick_and_bent_and_off_their_line_is_taken_off_their_distance() -> None:
    x, y, z = np.eye(3)
    one, other = Rod(moved(-x, x, 0 * x), 0.01, 0.2, 0.03), Rod(moved(3 * z - y, 3 * z + y, 0 * x), 0.03, 0.5, 0.02)
    assert clearance(one, other) == pytest.approx(3 - 0.04 - 0.7 - 0.05, abs=1e-12)


FAN = np.array([[[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]], [[0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]])
"""A segment that grows out of a point; with axes swapped, one end of which rests while the other passes by."""


@pytest.mark.parametrize("corners", [FAN, FAN.swapaxes(0, 1)], ids=["in time", "along"])
def test_cells_are_as_large_as_their_longer_side(corners: Array) -> None:
    """The middle of that side is next to a point, which all corners are farther from."""
    point = np.array([0.0, 0.0, 0.4])
    assert clearance(Rod(corners), Rod(moved(point, point, 0 * point))) <= 0.4
    assert clearance(Rod(moved(point, point, 0 * point)), Rod(corners)) <= 0.4
    distance = np.linalg.norm(corners - point, axis=-1)
    assert distance.min() > 0.5
    cells = Cells(*np.zeros((2, 1), dtype=int), *np.zeros((2, 1, 2)), corners[None], distance[None])
    nothing = np.zeros((1, 1))
    intervals: Any = SimpleNamespace(
        arms=SimpleNamespace(shape_error=np.array([0.01, 0.03])),
        start=np.array([0]),
        end=np.array([1]),
        sagitta=lambda which, section, x: np.zeros(1),
        radius=nothing,
    )
    for order in ([0.01, 0.03], [0.03, 0.01]):
        intervals.arms.shape_error = np.array(order)
        sizes = Sizes.of(cells, intervals, nothing + 0.02)
        assert sizes.bound(distance.min()[None])[0] <= 0.4
        assert (sizes.along.item(), sizes.time.item()) == pytest.approx((4.0, 2.0) if corners is FAN else (2.0, 4.0))
        assert sizes.chord_error.item() == pytest.approx(0.05)


def test_the_clearance_of_a_rod_by_its_first_cells_is_that_of_pythagoras() -> None:
    """Cells of a quarter of its length each: a sphere beside the middle of one, beside an end, and behind the plate."""
    length = 0.04
    robot = nested((0.0, length, 0.0))
    current = between(robot, ([0.0], [0.0]), ([0.0], [0.0]))
    radius, off = robot.tubes[0].outer_diameter / 2, np.full(current.length[0].shape, 1e-4)
    for z, beside, tall in ((0.375 * length, 0.02, True), (length, 0.02, False), (-0.01, 0.0, False)):
        scene = scene_of([Sphere((0.0, beside, z), 1e-3)])
        bound, closest = clearance_bounds(current, off, scene, ClearanceTarget(0.0, 1e-9, 0), np.inf)
        corner = np.hypot(beside, length / 8 if tall else abs(z) if z < 0 else 0.0) - 1e-3
        true = np.sqrt(corner**2 - (length / 8) ** 2) - radius - 1e-4
        assert bound.item() == pytest.approx(min(true, corner - radius if z < 0 else np.inf), abs=1e-7)
        assert closest == pytest.approx(corner - radius, abs=1e-7)
    flush = between(robot, ([0.0], [-length]), ([0.0], [-length]))
    scene = scene_of([Sphere((0.0, 0.0, 0.02), 1e-3)])
    bound, _ = clearance_bounds(flush, 0 * off, scene, ClearanceTarget(0.0, 1e-9, 0), np.inf)
    assert bound.item() == pytest.approx(0.02 - 1e-3 - radius)


def test_a_track_is_off_its_line_by_both_ends_of_a_link_and_whole_where_all_is_shown() -> None:
    verifier: Any = SimpleNamespace(
        intervals=lambda equilibria, one, other: SimpleNamespace(
            arms=SimpleNamespace(shape_error=np.array([0.1, 0.3, 0.2]))
        )
    )
    arm = forward_kinematics(STEPPED, [0.3, 0.1])
    steps = [trajectory_trace.TraceStep(at, arm, np.zeros(4)) for at in (0.0, 0.5, 1.0)]
    links = [trajectory_trace.Link(a, b, chord_error=np.array([1.0, 2.0])) for a, b in pairwise(steps)]
    track = several_arms.Track(verifier, tuple(links), base_frame([0, 0, 0], [0, 0, 1]), 0.0, 2.0)
    assert track.chord_error == pytest.approx(np.array([[1.3, 2.3], [1.3, 2.3]]))
    assert track.times == pytest.approx(np.array([0.0, 1.0, 2.0]))


@pytest.mark.parametrize("missing", ["nothing", "a branch", "a link", "a snap", "time"])
def test_a_track_is_whole_only_where_one_branch_was_followed_to_its_end(
    missing: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    arm = forward_kinematics(STEPPED, [0.3, 0.1])
    ends = (0.0, 0.9) if missing == "time" else (0.0, 1.0)
    steps = tuple(trajectory_trace.TraceStep(at, arm, np.zeros(4)) for at in ends)
    followed = SimpleNamespace(
        steps=steps, snap=0.7 if missing == "a snap" else None, unproved=((0.1, 0.2),) if missing == "a branch" else ()
    )
    lost = [(0.1, 0.2)] if missing == "a link" else []
    monkeypatch.setattr(several_arms, "follow", lambda *_: followed)
    monkeypatch.setattr(several_arms, "prove_branch", lambda verifier, links: trajectory_trace.Proved(links, lost))
    none: Any = None
    track = several_arms.tracked(none, arm, np.array([0.0, 1.0]), np.zeros((2, 4)), none)
    assert track.complete == (missing == "nothing")
    # Arms of which a part is not shown have no clearance.
    rods = Rod(moved(*np.eye(3))), Rod(moved(*(5 * np.eye(3))))
    rods[0].complete = track.complete
    assert np.isfinite(clearance(*rods)) == track.complete


def test_a_finer_track_is_whole_as_far_as_its_halves_are_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = forward_kinematics(STEPPED, [0.3, 0.1])
    steps = [trajectory_trace.TraceStep(at, arm, np.full(4, at)) for at in (0.0, 1.0)]
    none: Any = None
    track = several_arms.Track(none, (trajectory_trace.Link(steps[0], steps[1]),), none, 0.0, 1.0)

    def ends(verifier: Any, link: Any) -> list[Any]:
        raise trajectory_trace.BranchEndsError(0.5)

    monkeypatch.setattr(several_arms, "bisect", lambda verifier, link: [link])
    for lost in ([], [(0.0, 0.5)]):
        monkeypatch.setattr(
            several_arms, "prove_branch", lambda verifier, links, lost=lost: trajectory_trace.Proved(links, lost)
        )
        assert track.finer(np.array([0])).complete == (not lost)
    monkeypatch.setattr(several_arms, "bisect", ends)
    assert not track.finer(np.array([0])).complete


def test_a_clearance_from_one_time_to_another_is_the_least_in_between() -> None:
    times, distances = np.array([0.0, 1.0, 2.0, 3.0]), np.array([0.3, 0.1, 0.2])
    proof = several_arms.PairProof((0, 1), 0.1, 0.1, 0.0, times, distances)
    start, end = np.array([[0.2, 0.5], [0.5, 1.5], [2.1, 9.0], [-1.0, 0.5], [1.0, 1.0], [0.0, 3.0]]).T
    assert proof.at_least(start, end).tolist() == [0.3, 0.1, 0.2, 0.3, 0.1, 0.1]
    rods: Any = (Rod(moved(*np.eye(3))), Rod(moved(*(5 * np.eye(3)))))
    assert several_arms.apart((0, 1), rods, ClearanceTarget(0.0, 1e-9, 0), 0.01).least_clearance == 0.01


@pytest.mark.parametrize(("share", "more"), [(0.6e-9, 0), (2.2e-9, 3), (0.1, 63)])
def test_a_stretch_of_time_that_is_short_is_not_halved(
    share: float, more: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where one cell at once cannot show the clearance, stretches are halved down to 1e-9 of the time, or
    until there are no equilibria left, of which each round takes twice as many."""
    body = Sphere((0.0, 0.0, 0.4), 0.05)
    monkeypatch.setattr(trajectory_trace, "MAX_EQUILIBRIA", 40)
    verifier = trajectory_trace.TrajectoryVerifier(THESIS, scene_of([body]), ClearanceTarget(0.5, 1e-9, 0), Clock(60.0))
    joints = [np.append(angles, THESIS.home_translations) for angles in ([0.0, 0.0, 0.0], [0.02, 0.0, 0.0])]
    steps = [
        trajectory_trace.TraceStep(at, forward_kinematics(THESIS, q[:3]), q)
        for at, q in zip((0.5, 0.5 + share), joints, strict=True)
    ]
    links, lost = trajectory_trace.prove_branch(verifier, [trajectory_trace.Link(steps[0], steps[1])])
    assert not lost
    trajectory_trace._prove_clearance(verifier, links)
    assert verifier.count == more


def test_a_point_of_an_arc_that_slides_out_is_off_its_chord_by_the_bend_of_its_path() -> None:
    """P = (1 - cos(k h), sin(k h)) / k at length h(t): |P_tt| is k h_t^2, all of it from the arm that grows."""
    curvature, short, long = 0.5, 0.018, 0.022
    robot = nested((0.0, 0.03, curvature))
    result = branch.branch(between(robot, *(([0.0], [h - 0.03]) for h in (short, long))), np.ones(2))

    def tip(h: float) -> Array:
        return np.array([1 - np.cos(curvature * h), np.sin(curvature * h)]) / curvature

    true = float(np.linalg.norm(tip((short + long) / 2) - (tip(short) + tip(long)) / 2))
    assert 0.999 * true <= result.chord_error.max() <= 1.03 * true
    speeding = curvature * (long - short) ** 2
    assert 0.999 * speeding <= result.rates[0, 0] <= 1.03 * speeding


def test_what_bends_an_arm_otherwise_moves_a_point_by_its_lever() -> None:
    """int (s - x) |du| dx by sums along the arm, where all tubes turn by an angle against theta~."""
    current = [0.3, 0.1], [-0.02, -0.01]
    bounds, turn = bounds_between(STEPPED, current, current), 1e-3
    cuts = bounds.intervals.start_cuts[0]
    still = np.zeros_like(bounds.torque), np.zeros_like(bounds.bending.pairs)
    result = (
        bounds.chord_error(still, np.full_like(bounds.torque, turn))[0]
        - bounds.chord_error(still, np.zeros_like(bounds.torque))[0]
    )
    x = (np.arange(20000) + 0.5) / 20000 * cuts[-1]
    tubes, offset = STEPPED.tubes, np.array(current[1]) + 0.0
    reached = [(x < tube.curved_length + by) for tube, by in zip(tubes, offset, strict=True)]
    stiff = sum(tube.bending_stiffness * on for tube, on in zip(tubes, reached, strict=True))
    pull = sum(tube.bending_stiffness * tube.curvature * on for tube, on in zip(tubes, reached, strict=True))
    true = [float(((s - x).clip(0) * pull / stiff * turn).sum() * cuts[-1] / 20000) for s in cuts[1:]]
    assert result == pytest.approx(true, rel=1e-3)


def test_no_rotation_of_unit_torsional_energy_is_larger_than_its_weight_and_one_is_as_large() -> None:
    """The most of y(s) over int kt y'^2 + kt / |beta| y(0)^2 = 1 is the root of the compliance, by elements."""
    current = [0.3, 0.1], [-0.02, -0.01]
    bounds = bounds_between(STEPPED, current, (current[0], [-0.022, -0.013]))
    cuts = bounds.intervals.start_cuts[0]
    for i, (tube, held) in enumerate(zip(STEPPED.tubes, (0.06, 0.03), strict=True)):
        for s, weight in zip(cuts[1:], bounds.weight[0][0, :, i], strict=True):
            count = 50
            stiff = np.full(count, tube.torsional_stiffness * count / s) if s else np.zeros(count)
            matrix = np.diag(np.append(stiff, 0) + np.append(0, stiff)) - np.diag(stiff, 1) - np.diag(stiff, -1)
            matrix[0, 0] += tube.torsional_stiffness / held
            if s:
                assert np.sqrt(np.linalg.inv(matrix)[-1, -1]) <= weight * (1 + 1e-9)
    still = bounds_between(STEPPED, current, current)
    true = np.sqrt((np.array([0.06, 0.03]) + cuts[1:, None]) / [tube.torsional_stiffness for tube in STEPPED.tubes])
    assert still.weight[0][0] == pytest.approx(true, rel=1e-9)
    assert still.weight[1][0] == pytest.approx(np.sqrt(true[:, :, None] ** 2 + true[:, None] ** 2), rel=1e-9)


def test_what_moments_twist_by_is_bounded_by_its_own_derivatives() -> None:
    """|beta| w(0) + int h g w of moments that are constant in every section, while all of it grows with time: the
    bound is what it is at the end, and its derivatives there."""
    random = np.random.default_rng(2)
    (h, more), (held, longer), (compliance,) = (
        random.uniform(1, 2, (k, *each)) for k, each in ((2, (4, 1)), (2, (2,)), (1, (2,)))
    )
    m, g = random.uniform(1, 2, (3, 4, 2)), random.uniform(1, 2, (3, 4, 2))
    bounds: Any = branch._Bounds.__new__(branch._Bounds)
    bounds.length = linear(h[None, :, 0], (h + more)[None, :, 0])
    bounds.transmission, bounds.compliance = (
        linear(held[None], (held + longer)[None]),
        DerivativeBounds(compliance, NONE, NONE, NONE),
    )

    def twist(t: float) -> Array:
        moment, stretch = (a[0] + a[1] * (t - 1) + a[2] * (t - 1) ** 2 / 2 for a in (m, g))
        gain = (h + t * more) * moment
        mean = np.cumsum(gain[::-1], axis=0)[::-1] - gain / 2
        return np.asarray(
            (held + t * longer) * gain.sum(0) + np.cumsum((h + t * more) * (1 + stretch) * mean * compliance, axis=0)
        )

    result, step = bounds.rotation(DerivativeBounds(*m[:, None]), DerivativeBounds(*g[:, None])), 1e-3
    before, current, after = (twist(1 + k * step) for k in (-1, 0, 1))
    assert result.v[0] == pytest.approx(current, rel=1e-9)
    assert result.d[0] == pytest.approx((after - before) / (2 * step), rel=1e-5)
    assert result.dd[0] == pytest.approx((after - 2 * current + before) / step**2, rel=1e-5)


def test_the_norm_of_a_change_is_the_torsional_energy_of_what_its_moments_twist() -> None:
    """int g^2 t^2 / kt with torques t linear in every section, by sums, and of the transmissions; of stretched tubes
    the change of g t."""
    random = np.random.default_rng(3)
    bounds, turn = bounds_between(STEPPED, ([0.3, 0.1], [-0.02, -0.01]), ([0.3, 0.1], [-0.02, -0.01])), 1e-3
    count = bounds.torque.shape
    moment, grown, more = random.uniform(1, 2, (3, *count))
    bounds.torque_change = lambda turn: moment  # type: ignore[method-assign]
    bounds._stretch = lambda u: grown if u is bounds.bending.max_u else more  # type: ignore[method-assign]
    h, kt = bounds.length.v[0], np.array([tube.torsional_stiffness for tube in STEPPED.tubes])
    total = np.array([0.06, 0.03]) / kt * (h[:, None] * moment[0]).sum(0) ** 2
    ahead = np.zeros((2, 2))
    for k in reversed(range(len(h))):
        x = (np.arange(2000) + 0.5) / 2000 * h[k]
        # A change of g meets the whole torque where the section begins.
        whole = ahead[1] + h[k] * bounds.torque[0, k]
        t = (1 + grown[0, k]) * (ahead[0] + x[:, None] * moment[0, k]) + more[0, k] * whole
        total += (t**2).sum(0) / kt * h[k] / 2000
        ahead += h[k] * np.array([moment[0, k], bounds.torque[0, k]])
    still = np.zeros(count) + turn
    result = bounds.energy((still, still[..., None] + still[..., None, :])).item()
    assert result == pytest.approx(np.sqrt(total.sum()), rel=1e-6)


@pytest.mark.parametrize("stiffness", [1.0, 0.4])
def test_what_a_rotation_calls_forth_is_its_energy_over_the_margin(stiffness: float) -> None:
    """x + A (DF - 1) x, its norm the most of all sections of any length, of the tubes and of their pairs."""
    weight = np.array([[[2.0, 3.0], [4.0, 5.0], [1.0, 1.0]]])
    both = np.array([2.0, 4.0, 9.0])[:, None, None] + np.zeros((1, 1, 2, 2))
    bounds: Any = branch._Bounds.__new__(branch._Bounds)
    bounds.weight, bounds.stiffness, bounds.length = (
        (weight, both),
        np.array([stiffness]),
        DerivativeBounds(np.array([[1.0, 2.0, 0.0]]), NONE, NONE),
    )
    bounds.energy = lambda turn: np.array([0.3])
    turn = weight * 0.1, both * 0.2
    own, pair = bounds.response(turn)
    assert own == pytest.approx(weight * (0.1 + 0.3 / stiffness))
    assert pair == pytest.approx(both * (0.2 + 0.3 / stiffness))
    assert bounds.norm((own, pair)).item() == pytest.approx(0.2 + 0.3 / stiffness)
    assert bounds.norm((own, 0.1 * pair)).item() == pytest.approx(0.1 + 0.3 / stiffness)
    only = np.zeros_like(weight)
    only[0, 2] = 7.0
    assert bounds.norm((only, both * 0.0)).item() == 0.0


@pytest.mark.parametrize(("residual", "by_time", "by_ball"), [(0.4, 0.6, 0.5), (0.2, 1.2, 0.8), (0.5, 0.0, 0.0)])
def test_the_ball_of_a_parabola_is_that_of_newton_and_kantorovich(
    residual: float, by_time: float, by_ball: float
) -> None:
    """F = e - by_time t e - by_ball e^2 / 2 - residual t (1 - t) / 2: the most of e up to half of the time.
    Half of all of it is there without what it calls forth."""
    flat, made = DerivativeBounds(NONE, NONE, NONE, NONE), iter((NONE + by_time / 2, NONE + by_ball / 2))
    still: Any = SimpleNamespace(
        weight=(NONE + 1, NONE[..., None] + 1),
        bending=SimpleNamespace(max_u=NONE[0], change=lambda y: NONE[0], second=lambda y, by: NONE[0]),
        transport=SimpleNamespace(gain=lambda pair: NONE),
        zero=NONE,
        chord=lambda turn: None,
        cross_sections=lambda course: (flat, flat),
        rotation=lambda moment, stretch: DerivativeBounds(NONE, NONE, NONE + residual / 2),
        torque_change=lambda y: NONE,
        torque_second=lambda y, by: NONE,
        response=lambda turn: (2 * turn[0], 2 * turn[1]),
        norm=lambda turn: turn[0][0, 0],
        _stretch=lambda u: u,
        _jacobian_change=lambda varied, gained, by, moving: next(made),
    )
    ball, retained = branch._Bounds.ball(still, (NONE, NONE[..., None]))
    assert retained.all()
    q = by_time / 2
    # At half of the time, where both the residual and q are largest, by the quadratic formula.
    roots = np.roots([by_ball / 2, q - 1, residual / 8])
    radius = float(roots.min())
    assert ball.radius.item() == pytest.approx(radius)
    assert (ball.residual_tt.item(), ball.jacobian_t.item()) == pytest.approx((residual, by_time))
    assert ball.contraction.item() == pytest.approx(1 - q - by_ball * radius)


def test_what_changes_between_samples_is_off_its_chord_by_an_eighth_of_its_second_derivative() -> None:
    """Two tubes that begin to turn against each other: theta'' changes by c / kt times the turn."""
    length, turn = 0.04, 1e-3
    robot = nested((0.0, length, 3.0), (0.0, length, 3.0))
    bounds = bounds_between(robot, ([-turn / 2, 0.0], None), ([turn / 2, 0.0], None))
    one, other = robot.tubes
    coupling = 9.0 * one.bending_stiffness * other.bending_stiffness / (one.bending_stiffness + other.bending_stiffness)
    pair = np.zeros((*bounds.torque.shape, 2)) + turn * (1 - np.eye(2))
    result = bounds._between_samples((np.zeros_like(bounds.torque), pair))[0].max(0)
    kt = np.array([tube.torsional_stiffness for tube in robot.tubes])
    x = np.linspace(0, length / PARTS, 101)
    parabola = coupling * turn / kt * (x * (x[-1] - x))[:, None] / 2
    assert result == pytest.approx(parabola.max(0), rel=1e-6)


def test_pieces_of_arms_at_rest_that_cross_in_their_middle_are_as_far_apart_as_their_middles() -> None:
    """Of length 0.4 and 0.6, thick at one end and off their pieces."""
    x, y, z = np.eye(3)
    one, other = np.array([-0.2 * x, 0.2 * x]), np.array([z - 0.3 * y, z + 0.3 * y])
    thick = np.array([0.05, 0.05]), np.array([0.03, 0.03])
    result = reach_fraction._apart(
        reach_fraction._Arm(one, thick[0], 0.4**2, 0.001), reach_fraction._Arm(other, thick[1], 0.6**2, 0.002)
    )
    assert result == pytest.approx(1 - 0.08 - 0.003)


def test_an_arm_at_rest_is_as_thick_as_at_the_nearer_point_and_bends_off_its_pieces_by_their_sagitta(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """An arc that a tube leaves half-way: 11 points, of pieces of a tenth."""
    monkeypatch.setattr(reach_fraction, "REST_POINTS", 11)
    robot, curvature, length, count = nested((0.0, 0.08, 5.0), (0.0, 0.043, 5.0)), 5.0, 0.08, 11
    arm = forward_kinematics(robot, [0.0, 0.0])
    result: Any = SimpleNamespace(reached=np.array([True]), arm=lambda robot, k: arm)
    line, thick, square, bow = reach_fraction._at_rest(robot, result, base_frame([0, 0, 0], [0, 0, 1]))[0]
    assert len(line) == count
    assert square == pytest.approx((length / 10) ** 2)
    sagitta = (1 - np.cos(curvature * length / 20)) / curvature
    assert sagitta <= bow <= 1.25 * sagitta
    # The outer tube ends at 43 mm, between points 5 and 6, both of which are as thick as it is.
    radii = [tube.outer_diameter / 2 for tube in robot.tubes]
    assert thick == pytest.approx(np.array([radii[1]] * 7 + [radii[0]] * 4))


@pytest.mark.parametrize(
    ("begin", "end", "places", "ordered"),
    [
        ([0.02, 0.05], [0.03, 0.06], [], True),
        ([0.02, 0.05], [0.03, 0.06], [0.07], True),
        ([0.02, 0.05], [0.03, 0.06], [0.04], True),
        ([0.02, 0.05], [0.03, 0.06], [0.055], False),  # the tip passes a place of the load
        ([0.02, 0.05], [0.03, 0.06], [0.025], False),  # a breakpoint passes it
        ([0.02, 0.05], [0.06, 0.04], [], False),  # breakpoints pass one another
        ([-0.01, 0.05], [0.01, 0.05], [], False),  # one passes the plate
        ([-0.02, 0.05], [-0.01, 0.05], [], True),
    ],
)
def test_sections_are_in_order_where_no_places_along_the_arm_meet(
    begin: list[float], end: list[float], places: list[float], ordered: bool
) -> None:
    arms: Any = SimpleNamespace(
        breakpoints=np.array([begin, end]),
        load_positions=np.array(places),
        constants=SimpleNamespace(stretch=lambda middle, tubes: None),
    )
    forwards_and_backwards = np.array([0, 1]), np.array([1, 0])
    assert Intervals.of(arms, *forwards_and_backwards).ordered.tolist() == [ordered] * 2
