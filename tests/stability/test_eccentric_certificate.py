"""Eccentric robots: the proof that they cannot snap, the closed form beyond which they can, and verdicts from both."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from tests.command_line import Run
from tests.examples import MM, eccentric_robot
from tubeopt import (
    EccentricRobot,
    Finding,
    InputError,
    SegmentedEccentricRobot,
    Tube,
    assess_snapping,
    certify,
    find_snap,
    forward_kinematics,
    forward_kinematics_batch,
    snap_free_certificate,
    worst_certificate,
    worst_margin,
)
from tubeopt.block.transcription.second_variation import softenings
from tubeopt.equilibrium.problem import DEFAULT_DISCRETISATION, reduced_problem
from tubeopt.robots.assembly import Assembly, assemble
from tubeopt.robots.robot import Robot
from tubeopt.stability import EccentricSnapAssessment
from tubeopt.stability import eccentric_certificate as theorem
from tubeopt.stability.eccentric_certificate import segments_of, softest_untwisted, untwisted_tips
from tubeopt.stability.shooting import profiles, to_base
from tubeopt.typing import Array

# Formulas hold beyond what metals bear.
pytestmark = pytest.mark.filterwarnings("ignore::tubeopt.errors.ImplausibleWarning")

PLACES = np.array([0.0, 2 * np.pi / 3, -2 * np.pi / 3])


def on_the_edge(outer_diameter: float, tightness: float, certificate: float) -> EccentricRobot:
    """A clamped segment with d kappa = `tightness` whose tubes have this certificate on the centreline."""
    curvature = tightness / (outer_diameter / np.sqrt(3))
    tube = Tube(outer_diameter, 0.8 * outer_diameter, 0.0, 1 * MM, curvature)
    centred = snap_free_certificate(EccentricRobot(tube, offset=0.0))
    return EccentricRobot(replace(tube, curved_length=np.sqrt((1 - certificate) / (1 - centred)) * MM))


def longer(robot: EccentricRobot, factor: float) -> EccentricRobot:
    tube = robot.tube
    return replace(
        robot,
        tube=replace(tube, straight_length=factor * tube.straight_length, curved_length=factor * tube.curved_length),
        transmission_length=factor * robot.transmission_length,
    )


def threshold(robot: EccentricRobot) -> float:
    """By what factor it has to be longer for the closed form to say that it snaps."""

    def least(factor: float) -> float:
        segments = segments_of((scaled := longer(robot, factor)).assembly(scaled.home_translations))
        assert segments is not None
        return softest_untwisted(segments[0]).margin

    return float(brentq(least, 0.05, 20.0))


# --- the bound ------------------------------------------------------------------------------------------------------


def sections(theta: Array, delta: float) -> tuple[Array, Array, Array, Array]:
    """M (3,), M' , g and g' at rotations (3,) with K = m = 1, by iteration and differences, from the equations
    alone."""

    def at(angles: Array) -> Array:
        pull, u = np.array([np.cos(angles).sum(), np.sin(angles).sum()]), np.zeros(2)
        for _ in range(20):
            g = 1 + delta * (u[0] * np.sin(PLACES) - u[1] * np.cos(PLACES))
            u = pull / (1 / g).sum()
        return np.concatenate([u[0] * np.sin(angles) - u[1] * np.cos(angles), g])

    here, h = at(theta), 1e-6
    slope = np.column_stack([(at(theta + h * e) - at(theta - h * e)) / (2 * h) for e in np.eye(3)])
    return here[:3], slope[:3], here[3:], slope[3:]


@pytest.mark.parametrize("delta", [0.004, 0.06, 0.173, 0.2525])
def test_the_table_fulfils_the_inequality_at_random_states(delta: float) -> None:
    random = np.random.default_rng(1)
    x = np.array([theorem.longest(delta, angle) for angle in theorem.ANGLES])
    turns = np.ones((3, 3)) / 3
    for _ in range(60):
        at = random.uniform(0.02, 0.98) * x[-1]
        k = int(np.searchsorted(x, at))
        rise = (theorem.ANGLES[k] - theorem.ANGLES[k - 1]) / (x[k] - x[k - 1])
        phi = theorem.ANGLES[k - 1] + rise * (at - x[k - 1])
        opposed = random.uniform(0, 2 * np.pi) + np.array([0.0, 0.0, np.pi]) + random.normal(0, 0.2, 3)
        states = [random.uniform(0, 2 * np.pi, 3) if random.random() < 0.5 else opposed]
        states += [random.uniform(0, 2 * np.pi, 3) for _ in range(2)]
        p = at * sum(w * sections(s, delta)[0] for w, s in zip(random.dirichlet(np.ones(3)), states, strict=True))
        _, moments, g, stretched = sections(states[0], delta)
        bound = np.tan(phi) * (np.eye(3) - turns) + delta * at * turns
        lean = bound - (p / g)[:, None] * stretched / 2
        left = rise / np.cos(phi) ** 2 * (np.eye(3) - turns) + delta * turns
        room = left - lean.T @ np.diag(g) @ lean + (moments + moments.T) / 2
        assert np.linalg.eigvalsh(room)[0] > -1e-9 * np.linalg.norm(left)


@pytest.mark.parametrize("delta", [0.02, 0.2525])
def test_the_slope_is_the_least_that_fulfils_the_inequality(delta: float) -> None:
    """Of (*), with the slope for phi_x, the least eigenvalue is 0 at every rotation and corner."""
    random, x, phi = np.random.default_rng(2), 0.7, 0.6
    theta, vertices, turns = (
        random.uniform(0, 2 * np.pi, (8, 3)),
        theorem.corners()[:3],
        np.ones((3, 3)) / 3,
    )
    found = theorem.Slope(theta, delta, vertices)(x, phi)
    bound = np.tan(phi) * (np.eye(3) - turns) + delta * x * turns
    for angles, slopes in zip(theta, found, strict=True):
        _, moments, g, stretched = sections(angles, delta)
        for vertex, slope in zip(vertices, slopes.tolist(), strict=True):
            lean = bound - x * (vertex / g)[:, None] * stretched / 2
            left = slope / np.cos(phi) ** 2 * (np.eye(3) - turns) + delta * turns
            room = left - lean.T @ np.diag(g) @ lean + (moments + moments.T) / 2
            assert abs(np.linalg.eigvalsh(room)[0]) < 1e-7


@pytest.mark.parametrize("fall", [0.0, 4.0])
def test_a_length_curve_is_below_the_solution_that_it_bounds(fall: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """phi_x = 5 + x^2 - fall phi, which grows with x and with phi falls, by a solver of differential equations."""
    monkeypatch.setattr(theorem, "Slope", lambda *_: lambda x, phi: np.array([5 + x**2 - fall * phi]))
    found = theorem.length_curve(0.25, steps=40)
    true = solve_ivp(lambda x, phi: 5 + x**2 - fall * phi, (0, 2), [0.0], rtol=1e-10, atol=1e-12, dense_output=True)
    phi = true.sol(found)[0]
    assert (phi <= theorem.ANGLES + 1e-9).all()
    assert phi[-1] > 0.85 * np.pi / 2


def test_the_room_of_the_grid_is_twice_what_lies_between_its_rotations() -> None:
    """Around the steepest rotations of the grid the slope is higher by at most half of the room, and by a fourth."""
    delta, angle, random = theorem.DELTAS[-1], 1.5, np.random.default_rng(3)
    x, corners, step = theorem.longest(delta, angle), theorem.corners()[:4], 2 * np.pi / 24
    grid = theorem.all_rotations()
    coarse = theorem.Slope(grid, delta, corners)(x, angle).max(1)
    near = (grid[np.argsort(coarse)[-60:], None] + random.uniform(-step / 2, step / 2, (100, 3))).reshape(-1, 3)
    between = theorem.Slope(near, delta, corners)(x, angle).max() / coarse.max() - 1
    room = theorem.GRID_ALLOWANCE[0] + theorem.GRID_ALLOWANCE[1] * delta
    assert room / 4 < between < room / 2


def test_the_table_is_lowered_by_an_eighth_of_its_second_differences_and_more() -> None:
    """What linear interpolation is above a function at most, in delta and in phi; and it is no larger than need be."""
    rows = np.loadtxt(theorem.FILE, delimiter=",")
    lowered = (rows - theorem.table())[1:, 1:].min()
    along = np.diff(rows, 2, axis=1).max() / 8
    steps = np.diff(theorem.DELTAS)[:, None]
    bend = np.diff(np.diff(rows, axis=0) / steps, axis=0) / (steps[1:] + steps[:-1]) * 2
    across = (bend * np.maximum(steps[1:], steps[:-1]) ** 2).max() / 8
    assert along + across <= lowered <= 3 * (along + across)


def test_what_is_between_the_rows_and_columns_of_the_table_is_their_mean() -> None:
    deltas, angles, rows = (
        theorem.DELTAS[20:22],
        theorem.ANGLES[30:32],
        theorem.table(),
    )
    found = theorem.longest(deltas @ [0.75, 0.25], angles @ [0.25, 0.75])
    assert found == pytest.approx([0.75, 0.25] @ rows[20:22, 30:32] @ [0.25, 0.75], rel=1e-12)


def test_no_segment_of_the_table_is_as_long_as_a_quarter_of_a_wave() -> None:
    """Without offset x is phi, up to pi / 2; the root of the proof lies below it, for every offset."""
    lengths = theorem.table()
    assert np.pi / 2 - 1e-7 < lengths.max() < np.pi / 2
    assert lengths[0] == pytest.approx(theorem.ANGLES, abs=6e-8)


def test_all_moments_lie_in_the_polygon() -> None:
    random = np.random.default_rng(0)
    corners = theorem.corners()
    assert corners.sum(1) == pytest.approx(np.zeros(12), abs=1e-12)
    sides = np.roll(corners, -1, axis=0) - corners
    outward = np.cross(sides, np.ones(3))
    outward *= np.sign((outward * corners).sum(1))[:, None]
    for delta in (0.0, 0.1, 0.25):
        for _ in range(100):
            moment = sections(random.uniform(0, 2 * np.pi, 3), delta)[0]
            assert ((moment - corners) * outward).sum(1).max() <= 1e-9


def test_the_table_is_what_its_script_makes() -> None:
    coarse = theorem.length_curve(0.12, steps=80)
    stored = np.array([theorem.longest(0.12, angle) for angle in theorem.ANGLES])
    assert (coarse < stored + 1e-4).all()
    assert coarse == pytest.approx(stored, rel=5e-3, abs=1e-4)
    assert [theorem.longest(0.0, angle) for angle in (0.3, 1.2)] == pytest.approx([0.3, 1.2], abs=1e-7)
    with pytest.raises(InputError, match=r"the bound is valid from 0 to 0\.2525"):
        theorem.longest(0.26, 1.0)


# --- numbers --------------------------------------------------------------------------------------------------------


def test_without_offset_it_is_the_certificate_of_concentric_tubes() -> None:
    thin = Tube(1e-7, 0.8e-7, 0.01, 0.05, 26.0)
    for transmission in (0.0, 0.03):
        eccentric = EccentricRobot(thin, transmission_length=transmission)
        centred = snap_free_certificate(replace(eccentric, offset=0.0))
        assert snap_free_certificate(eccentric) == pytest.approx(centred, abs=1e-6)


def test_a_bent_back_robot_is_as_free_of_snaps() -> None:
    robot = eccentric_robot(0.01)
    back = replace(robot, tube=replace(robot.tube, curvature=-robot.tube.curvature))
    assert snap_free_certificate(back) == pytest.approx(snap_free_certificate(robot), abs=1e-12)


@pytest.mark.parametrize("tightness", [0.01, 0.1, 0.22])
@pytest.mark.parametrize("transmission", [0.0, 0.7])
def test_the_closed_form_is_the_margin_of_an_equilibrium(tightness: float, transmission: float) -> None:
    robot = on_the_edge(1.2 * MM, tightness, 0.1)
    robot = replace(robot, transmission_length=transmission * robot.tube.curved_length)
    segments = segments_of(robot.assembly(robot.home_translations))
    assert segments is not None
    shape = softest_untwisted(segments[0])
    tips, _ = untwisted_tips(3, shape, np.ones(3))
    problem = reduced_problem(robot, (0.0, 0.0, 0.0), DEFAULT_DISCRETISATION)
    theta = profiles(problem, tips[None])[0]
    assert to_base(problem, tips[None])[0] == pytest.approx(tips, abs=1e-9)
    assert 1 - softenings(problem, theta).max() == pytest.approx(shape.margin, abs=1e-9)
    assert certify(robot).margin <= shape.margin


def test_the_gradient_against_differences() -> None:
    robot = eccentric_robot(0.02)
    gradient = certify(robot).gradient
    for name in ("curvature", "curved_length", "straight_length"):
        h = 1e-3 * abs(getattr(robot.tube, name))
        values = [
            snap_free_certificate(replace(robot, tube=replace(robot.tube, **{name: getattr(robot.tube, name) + s * h})))
            for s in (1, -1)
        ]
        assert gradient[name].sum() == pytest.approx((values[0] - values[1]) / (2 * h), rel=5e-3)


def test_the_gradient_of_tubes_that_are_held_at_the_plate() -> None:
    """No straight part can be shorter: the derivative is the one to the side that there is."""
    robot, h = eccentric_robot(0.0), 1e-5
    tubes = [replace(robot.tube, straight_length=k * h) for k in range(3)]
    at = [snap_free_certificate(replace(robot, tube=tube)) for tube in tubes]
    gradient = certify(replace(robot, tube=tubes[0])).gradient
    assert gradient["straight_length"].sum() == pytest.approx((4 * at[1] - 3 * at[0] - at[2]) / (2 * h), rel=5e-3)


@pytest.mark.parametrize(("factor", "known"), [(1.0, True), (1 + 1e-6, False)])
def test_straight_tubes_through_a_segment_lie_where_those_of_the_segment_do(factor: float, known: bool) -> None:
    """The closed form is that of places on one circle: a straight tube 1 nm off it belongs to no segment."""
    curved, straight = eccentric_robot(0.0).tube, Tube(1.5 * MM, 1.2 * MM, 0.0, 0.12, 0.0)
    offset = 1.92 * MM / np.sqrt(3) * np.array([1, 1, 1, factor, 1, 1])
    angle = np.tile(PLACES, 2)
    segments = segments_of(assemble([curved] * 3 + [straight] * 3, np.zeros(6), offset=offset, offset_angle=angle))
    assert (segments is not None) == known


TUBE, THROUGH = Tube(1.92 * MM, 1.57 * MM, 0.0, 94 * MM, 1 / 0.12), Tube(1.5 * MM, 1.2 * MM, 0.0, 0.12, 0.0)
SHORTER = Tube(1.5 * MM, 1.2 * MM, 0.0, 0.05, 0.0)


@pytest.mark.parametrize(
    ("tubes", "places", "known"),
    [
        ([TUBE] * 3, [0, 1, 2], True),
        ([TUBE] * 3 + [THROUGH] * 3, [0, 1, 2, 0, 1, 2], True),
        ([TUBE] * 6, [0, 1, 2, 0, 1, 2], False),
        ([TUBE] * 2, [0, 1], False),
        ([TUBE] * 3 + [THROUGH], [0, 1, 2, 0], False),
        ([TUBE] * 3 + [SHORTER] * 3, [0, 1, 2, 0, 1, 2], False),
        ([TUBE] * 2 + [replace(TUBE, curvature=8.4)], [0, 1, 2], False),
        ([TUBE] * 2 + [replace(TUBE, inner_diameter=1.5 * MM)], [0, 1, 2], False),
        ([TUBE] * 2 + [replace(TUBE, straight_length=0.01)], [0, 1, 2], False),
        ([replace(TUBE, curvature=1 / 1.6e-3)] * 3, [0, 1, 2], False),
    ],
    ids=["three", "through", "six", "two", "uneven", "ends within", "curvature", "bore", "transmission", "tight"],
)
def test_a_segment_is_three_equal_tubes_around_equal_ones_all_along(
    tubes: list[Tube], places: list[int], known: bool
) -> None:
    """Of what differs in one respect the closed form does not hold, and nothing is proved."""
    n, angle = len(tubes), PLACES[places]
    here = assemble(tubes, np.zeros(n), offset=np.full(n, 1.92 * MM / np.sqrt(3)), offset_angle=angle)
    assert (segments_of(here) is not None) == known


def test_straight_tubes_are_as_soft_in_front_of_the_plate_as_behind_it() -> None:
    """Nothing but torsion acts there: the certificate knows only how long they are."""
    robot = eccentric_robot(0.03)
    assert snap_free_certificate(robot, np.full(3, 0.02)) == pytest.approx(snap_free_certificate(robot), rel=1e-12)
    assert snap_free_certificate(robot) < snap_free_certificate(eccentric_robot(0.0)) - 0.01


def test_boxes_move_carriages() -> None:
    robot = eccentric_robot(0.02)
    worst = worst_certificate(robot, np.full(3, -0.01), np.full(3, 0.01))
    samples = [snap_free_certificate(robot, np.full(3, shift)) for shift in np.linspace(-0.01, 0.01, 9)]
    assert worst.certificate.margin <= min(samples) + 1e-9
    assert np.ptp(worst.certificate.translations) == 0
    with pytest.raises(InputError, match="lower differs between tubes 1, 2, 3; they move together"):
        worst_certificate(robot, [-0.01, 0.0, 0.0], np.zeros(3))


# --- verdicts -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("outer_diameter", "tightness", "centred", "turn"),
    [(1.92 * MM, 0.0092, 0.001, 180.0006), (1.5 * MM, 0.22, 0.02, 180.073)],
)
def test_robots_that_only_their_offset_makes_snap(
    outer_diameter: float, tightness: float, centred: float, turn: float
) -> None:
    robot = on_the_edge(outer_diameter, tightness, centred)
    assert snap_free_certificate(replace(robot, offset=0.0)) == pytest.approx(centred, abs=1e-9)
    verdict = assess_snapping(robot)
    assert isinstance(verdict, EccentricSnapAssessment)
    assert verdict.finding is Finding.CAN_SNAP
    assert not verdict.certificate.snap_free
    assert verdict.untwisted is not None
    assert verdict.untwisted < 0
    assert verdict.snap is not None
    assert verdict.start is not None
    assert np.degrees(np.ptp(verdict.snap.rotations - verdict.start)) == pytest.approx(turn, abs=1e-4)
    assert abs(verdict.snap.before.margin) < 1e-8
    # The way that was known before: tube 2 turned against the others at 30 deg.
    snap = find_snap(robot, (np.radians([30, 30, 30]), None), (np.radians([30, 390, 30]), None))
    assert snap is not None
    assert abs(snap.before.margin) < 1e-8


@pytest.mark.parametrize("tightness", [0.02, 0.1, 0.23])
@pytest.mark.parametrize("transmission", [0.0, 1.0])
def test_shorter_is_proved_longer_snaps_and_between_is_open(tightness: float, transmission: float) -> None:
    robot = on_the_edge(1.0 * MM, tightness, 0.1)
    robot = replace(robot, transmission_length=transmission * robot.tube.curved_length)
    edge = threshold(robot)
    assert snap_free_certificate(longer(robot, 0.97 * edge)) > 0
    between = longer(robot, 0.99999 * edge)
    assert snap_free_certificate(between) < 0
    assert assess_snapping(longer(robot, 1.002 * edge)).snap is not None
    if tightness == 0.1:
        verdict = assess_snapping(between)
        assert verdict.finding is Finding.OPEN
        assert verdict.snap is None
        assert verdict.worst is not None
        assert 0 < verdict.worst.margin < 1e-4


def segmented(factor: float) -> SegmentedEccentricRobot:
    """Two segments of which the inner one, with its long way to the actuator, snaps first."""
    outer = Tube(1.9 * MM, 1.5 * MM, 5 * MM * factor, 20 * MM * factor, 40.0)
    inner = Tube(1.4 * MM, 1.1 * MM, 25 * MM * factor, 25 * MM * factor, -35.0)
    return SegmentedEccentricRobot((inner, outer))


def test_segmented_robots() -> None:
    def least(factor: float) -> float:
        robot = segmented(factor)
        segments = segments_of(robot.assembly(robot.home_translations))
        assert segments is not None
        return min(softest_untwisted(segment).margin for segment in segments)

    edge = float(brentq(least, 0.2, 5.0, xtol=1e-4))
    assert snap_free_certificate(segmented(0.95 * edge)) > 0
    robot = segmented(1.003 * edge)
    assert snap_free_certificate(robot) < 0
    verdict = assess_snapping(robot)
    assert verdict.finding is Finding.CAN_SNAP
    assert verdict.snap is not None
    assert abs(verdict.snap.before.margin) < 1e-8
    assert verdict.worst is not None
    assert verdict.worst.margin <= least(1.003 * edge) + 1e-7


def test_no_way_of_a_robot_that_is_proved_snaps() -> None:
    random = np.random.default_rng(5)
    robot = on_the_edge(1.3 * MM, 0.12, 0.06)
    assert snap_free_certificate(robot) > 0
    for k in range(6):
        start = np.full(3, np.pi / 6 * (2 * k + 1)) + random.normal(0, 1e-3, 3)
        end = start + 2 * np.pi * np.eye(3)[k % 3]
        assert find_snap(robot, (start, None), (end, None)) is None


@dataclass(frozen=True)
class Uneven(EccentricRobot):
    """Three tubes that do not stand at 120 deg from one another."""

    def assembly(self, translations: Array) -> Assembly:
        return replace(super().assembly(translations), offset_angle=np.array([0.0, 2.0, -2.0]))


@dataclass(frozen=True)
class OfTwo(EccentricRobot):
    """One of the three tubes is straight."""

    def assembly(self, translations: Array) -> Assembly:
        bundle = super().assembly(translations)
        return replace(bundle, curved=bundle.curved & np.array([True, True, False]))


@dataclass(frozen=True)
class Unequal(EccentricRobot):
    """One of the three tubes is stiffer."""

    def assembly(self, translations: Array) -> Assembly:
        bundle = super().assembly(translations)
        return replace(bundle, bending_stiffness=bundle.bending_stiffness * np.array([1.0, 1.0, 1.001]))


@pytest.mark.parametrize("kind", [Uneven, OfTwo, Unequal])
def test_nothing_is_proved_of_other_arrangements(kind: type[EccentricRobot]) -> None:
    robot: Robot = kind(Tube(1.92 * MM, 1.57 * MM, 0.0, 30 * MM, 1 / 0.12))
    assert snap_free_certificate(robot) == -np.inf
    assert not certify(robot).snap_free
    assert forward_kinematics(robot, np.zeros(3)).margin > 0.9
    assert assess_snapping(robot).finding is Finding.OPEN


@pytest.mark.parametrize("kind", [Uneven, Unequal])
def test_the_search_of_other_arrangements_turns_all_their_tubes(kind: type[EccentricRobot]) -> None:
    """Brute force over turns of all three: no pose of a grid has a margin that is smaller by 1e-4."""
    robot = kind(Tube(1.92 * MM, 1.57 * MM, 0.0, 60 * MM, 1 / 0.12))
    turns = np.stack(np.meshgrid(*[np.linspace(0, 2 * np.pi, 6, endpoint=False)] * 3), axis=-1).reshape(-1, 3)
    assert worst_margin(robot).margin <= forward_kinematics_batch(robot, turns).margin.min() + 1e-4


def test_the_command_says_that_the_robot_snaps(run: Run, tmp_path: object) -> None:
    robot = replace(on_the_edge(1.92 * MM, 0.0092, 0.001), name="edge")
    file = f"{tmp_path}/edge.yaml"
    robot.save(file)
    data = json.loads(run("certify", file, "--json").out)
    assert data["finding"] == "CAN_SNAP"
    assert data["certificate"] < 0
    assert -0.01 < data["untwisted_margin"] < 0
    text = " ".join(run("certify", file).out.split())
    assert "edge can snap: from rotations" in text
    assert "That it can snap is certain" in text
