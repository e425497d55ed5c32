"""The distance from a snap: folds by independent shooting, two tubes, legs inside the ball, symmetry."""

from __future__ import annotations

import itertools
import sys
from dataclasses import replace

import numpy as np
import pytest

from tests.examples import CONFIGS, THESIS, TWO_TUBE, nested
from tubeopt import (
    ConcentricRobot,
    Friction,
    InputError,
    Load,
    Piece,
    Tube,
    find_equilibria,
    find_load_limit,
    find_snap,
    follow,
    forward_kinematics,
    load_robot,
    snap_distance,
    snap_free_certificate,
)
from tubeopt.equilibrium.kinematics import point_of
from tubeopt.equilibrium.member import discretisation_of, sample_rotation
from tubeopt.equilibrium.problem import reduced_problem
from tubeopt.equilibrium.result import Equilibrium
from tubeopt.inverse.joints import joint_space
from tubeopt.robots.load import PointLoad
from tubeopt.stability.boxes import range_of_cosine
from tubeopt.stability.certificate import arm_sections
from tubeopt.stability.loaded_distance import LoadedForm
from tubeopt.stability.snap_distance import PairForm, SnapDistanceStatus, least_snap_distance, tip_torques
from tubeopt.typing import Array

FOUR = nested((0.15, 0.05, 18.0), (0.1, 0.05, 14.0), (0.05, 0.06, 8.0), (0.0, 0.08, 6.0))


def turned(robot: ConcentricRobot, degrees: list[float]) -> Equilibrium:
    """The equilibrium to which the branch from home leads."""
    path = follow(robot, [np.zeros(robot.n_tubes), np.radians(degrees)])
    assert not path.snaps
    return path.equilibria[-1]


def robots() -> list[tuple[str, ConcentricRobot]]:
    names = ("thesis_ctr", "crl_ctr", "toronto_ctr", "rvim_ctr", "till_snapping_pair", "example_pieces", "thamo_ctr")
    results = [(name, load_robot(CONFIGS / f"{name}.yaml")) for name in names]
    return [*((name, robot) for name, robot in results if isinstance(robot, ConcentricRobot)), ("four", FOUR)]


REFERENCE = (
    # degrees; snaps by one tube, backward and forward (DOP853 shooting); nearest snap; proved ball
    ([0.0, 0.0, 0.0], [[-214.222427, 214.222427], [-189.724198, 189.724198]], 94.862099, 80.502791),
    (
        np.degrees([0.0, 1.0, 2.0]).tolist(),
        [[-130.333395, 289.177034], [-244.481796, 173.411155]],
        65.166697,
        51.908375,
    ),
    (
        [200.0, 0.0, 0.0],
        [[-414.222427, 14.222427], [-22.804801, 434.069277], [-31.696137, 175.139414]],
        7.111214,
        7.107897,
    ),
)


def without_kernel(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("compiled_turn", "compiled_motion"):
        monkeypatch.setattr(sys.modules[snap_distance.__module__], name, lambda *_, **__: None)


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize(("degrees", "one_tube", "nearest", "ball"), REFERENCE)
def test_the_robot_of_the_thesis_is_that_far_from_a_snap(
    degrees: list[float],
    one_tube: list[list[float]],
    nearest: float,
    ball: float,
    compiled: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sys.modules[snap_distance.__module__], "PRECISION", 1e-9)
    if not compiled:
        without_kernel(monkeypatch)
    distance = snap_distance(turned(THESIS, degrees))
    assert np.degrees(distance.turn) == pytest.approx(ball, rel=1e-6)
    assert distance.status is SnapDistanceStatus.PROVED
    assert distance.value == distance.turn
    if not compiled:
        return
    result = np.degrees(distance.one_tube)
    assert result[: len(one_tube)] == pytest.approx(np.array(one_tube), abs=2e-6)
    assert np.isnan(result[len(one_tube) :]).all()


@pytest.mark.parametrize(("degrees", "nearest"), [(case[0], case[2]) for case in REFERENCE])
def test_the_nearest_snap_that_is_found(degrees: list[float], nearest: float) -> None:
    distance = snap_distance(turned(THESIS, degrees))
    assert np.degrees(distance.nearest) == pytest.approx(nearest, abs=2e-6)
    assert distance.turn < distance.nearest


@pytest.mark.parametrize(("name", "robot"), robots(), ids=[name for name, _ in robots()])
def test_the_kernel_proves_what_python_proves(
    name: str, robot: ConcentricRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    # By Newton's method and dense arrays in Python, by images and Aitken's method on the kernel's factors in C.
    random = np.random.default_rng(len(name) + 1)
    results = [forward_kinematics(robot, random.uniform(-np.pi, np.pi, robot.n_tubes)) for _ in range(3)]
    compiled = [snap_distance(e) for e in results]
    without_kernel(monkeypatch)
    for e, by_kernel in zip(results, compiled, strict=True):
        # Boxes that are larger than the least one may still be convex, so that one way may find a little more.
        assert by_kernel.turn > snap_distance(e).turn * (1 - 2e-4)


def test_the_smallest_distance_along_a_path() -> None:
    path = follow(THESIS, np.radians(np.linspace([0, 0, 0], [200, -20, 10], 9)))
    distances = [e.snap_distance for e in path.equilibria]
    assert least_snap_distance(path.equilibria) == pytest.approx(min(distances), rel=2e-6)
    assert least_snap_distance(path.equilibria[:1]) == distances[0]
    assert least_snap_distance([]) == np.inf


def test_the_smallest_distance_along_a_path_under_a_load() -> None:
    push = Load((0.01, 0.0, 0.005))
    start = forward_kinematics(THESIS, [0.0, 0.0, 0.0], load=push)
    path = follow(THESIS, np.radians([[0, 0, 0], [60, -20, 10]]), start=start, load=push).equilibria[::4]
    distances = [e.snap_distance for e in path]
    assert least_snap_distance(path) == pytest.approx(min(distances), rel=2e-3)


def test_two_tubes_are_half_their_one_fold_away() -> None:
    # Turning one tube by 2 r, or both against each other by r each, is the same motion but for a turn of the whole.
    robot = load_robot(CONFIGS / "till_snapping_pair.yaml")
    e = forward_kinematics(robot, [0.0, 0.4])
    distance = snap_distance(e)
    fold = np.nanmin(np.abs(distance.one_tube))
    assert distance.nearest == pytest.approx(fold / 2, rel=1e-9)
    assert distance.one_tube[0, 0] == pytest.approx(-distance.one_tube[1, 1], rel=1e-9)
    assert 0.99 * fold / 2 < distance.turn < fold / 2


@pytest.mark.parametrize(("name", "robot"), robots(), ids=[name for name, _ in robots()])
def test_no_leg_inside_the_ball_snaps(name: str, robot: ConcentricRobot) -> None:
    random, n = np.random.default_rng(len(name)), robot.n_tubes
    finite = 0
    for _ in range(3):
        e = forward_kinematics(robot, random.uniform(-np.pi, np.pi, n))
        r = snap_distance(e).turn
        if not e.stable or r == np.inf:
            continue
        finite += 1
        corners = r * 0.9999 * random.choice([-1.0, 1.0], (12, n))
        path = follow(robot, np.vstack([e.rotations, e.rotations + corners, e.rotations]), start=e)
        assert not path.snaps
        assert path.equilibria[-1].tip_position == pytest.approx(e.tip_position, abs=1e-8)
    assert finite or snap_free_certificate(robot) > 0


def test_angles_in_the_ball_are_in_the_box() -> None:
    # The proof is that the equilibria at all rotations of the ball have their angles in the box that it closes.
    e = turned(THESIS, [40.0, -30.0, 10.0])
    form, r = PairForm.of(e), snap_distance(e).turn * 0.99
    y = form.boxes(r)
    u = y
    for _ in range(500):
        u = form.image(y, u)
    low, high = -u[:, : len(form.psi)].max(0), u[:, len(form.psi) :].max(0)
    random = np.random.default_rng(4)
    touched = 0.0
    for corner in random.choice([-1.0, 1.0], (24, 3)):
        reached = follow(THESIS, [e.rotations, e.rotations + r * corner], start=e).equilibria[-1]
        x = PairForm.of(reached).psi - form.psi
        assert (low - 1e-9 <= x).all()
        assert (x <= high + 1e-9).all()
        touched = max(touched, float((x / high).max()))
    assert touched > 0.8  # nor is the box much too large


def test_the_form_is_the_equilibrium() -> None:
    e = turned(THESIS, [150.0, -20.0, 30.0])
    form = PairForm.of(e)
    hessian = np.eye(form.A.shape[1]) + form.A.T @ ((form.w * np.cos(form.psi))[:, None] * form.A)
    assert np.linalg.eigvalsh(hessian)[0] == pytest.approx(e.margin, abs=1e-9)
    assert form.defect.max() < 1e-13
    # J by differences of equilibria.
    step = 1e-5
    for k in range(3):
        sides = [
            PairForm.of(forward_kinematics(THESIS, e.rotations + side * step * np.eye(3)[k], start=e)).psi
            for side in (-1, 1)
        ]
        assert form.J[:, k] == pytest.approx((sides[1] - sides[0]) / (2 * step), abs=1e-6)


def test_the_range_of_h_is_its_range() -> None:
    random, count = np.random.default_rng(2), 40
    psi, one = random.uniform(-4, 4, count), np.eye(count)
    # With G = 1 and w = 1 the image of a box is the range of h itself.
    form = PairForm(psi, np.ones(count), one, one, one, np.zeros(count))
    u = random.uniform(0, 3, (1, 2 * count))
    image = form.image(np.zeros((1, 2 * count)), u)[0]
    for k in range(count):
        x = np.linspace(-u[0, k], u[0, count + k], 4001)
        h = np.sin(psi[k] + x) - np.sin(psi[k]) - np.cos(psi[k]) * x
        assert image[count + k] == pytest.approx(-h.min(), abs=1e-6)
        assert image[k] == pytest.approx(h.max(), abs=1e-6)
        assert image[count + k] >= -h.min() - 1e-14
        assert image[k] >= h.max() - 1e-14


def test_a_tube_curved_backwards_is_one_turned_by_half() -> None:
    backwards = replace(THESIS.tubes[1], curvature=-THESIS.tubes[1].curvature)
    robot = ConcentricRobot((THESIS.tubes[0], backwards, THESIS.tubes[2]))
    at = np.array([0.2, 0.5, -0.3])
    distance = snap_distance(forward_kinematics(robot, at)).turn
    same = snap_distance(forward_kinematics(ConcentricRobot(THESIS.tubes), at + np.array([0, np.pi, 0]))).turn
    assert distance == pytest.approx(same, rel=1e-5)


def test_turning_all_tubes_alike_changes_nothing() -> None:
    one, other = (snap_distance(forward_kinematics(THESIS, np.array([0.1, 1.2, 2.0]) + by)).turn for by in (0.0, 0.9))
    assert one == pytest.approx(other, rel=1e-5)


def test_a_certified_robot_never_snaps() -> None:
    shift = [-0.02, 0.0, 0.0]
    robot = load_robot(CONFIGS / "crl_ctr.yaml")
    assert snap_free_certificate(robot, shift) > 0
    distance = snap_distance(forward_kinematics(robot, [0.3, 2.0, -1.0], shift))
    assert distance.turn == np.inf
    assert distance.status is SnapDistanceStatus.NEVER
    assert distance.nearest == np.inf
    assert np.isnan(distance.one_tube).all()


def test_an_equilibrium_by_another_search_is_as_far() -> None:
    e = forward_kinematics(THESIS, [0.0, 1.0, 2.0])
    again = find_equilibria(THESIS, [0.0, 1.0, 2.0])[0]
    assert snap_distance(e).turn == pytest.approx(snap_distance(again).turn, rel=1e-5)
    assert e.snap_distance == snap_distance(e).turn


def test_what_has_no_distance_is_refused() -> None:
    at: Array = np.array([0.0, 1.0, 2.0])
    with pytest.raises(InputError, match=r"load has a moment or turns with the tip"):
        snap_distance(forward_kinematics(THESIS, at, load=Load(moment=(1e-3, 0, 0))))
    with pytest.raises(InputError, match=r"equilibrium has a load; a slide is known without load only"):
        _ = snap_distance(forward_kinematics(THESIS, at, load=Load((1e-3, 0, 0)))).slide
    rubbed = follow(TWO_TUBE, [[0.0, 0.0], [0.0, 0.5]], friction=Friction(torque=1e-3)).equilibria[-1]
    with pytest.raises(InputError, match="friction"):
        snap_distance(rubbed)
    unstable = next(e for e in find_equilibria(THESIS, np.radians([200, 0, 0])) if not e.stable)
    with pytest.raises(InputError, match=r"equilibrium has a margin of -0\.782; it must be above 0"):
        snap_distance(unstable)


@pytest.mark.parametrize(("at", "ball"), [([0.0, 0.0, 0.0], 70.476432), ([0.0, 1.0, 2.0], 50.566318)])
def test_one_box_for_more_tubes_proves_less(at: list[float], ball: float, monkeypatch: pytest.MonkeyPatch) -> None:
    without_kernel(monkeypatch)
    monkeypatch.setattr(sys.modules[snap_distance.__module__], "SECTORS", 2)
    assert np.degrees(snap_distance(forward_kinematics(THESIS, at)).turn) == pytest.approx(ball, rel=3e-6)


def test_a_search_that_stops_early_proves_less(monkeypatch: pytest.MonkeyPatch) -> None:
    # What Newton's method finds is only a candidate: the check that the box is mapped into itself is the proof.
    without_kernel(monkeypatch)
    e = turned(THESIS, [150.0, -20.0, 30.0])
    whole = snap_distance(e).turn
    monkeypatch.setattr(sys.modules[snap_distance.__module__], "NEWTON_STEPS", 1)
    assert snap_distance(e).turn < 0.5 * whole


BOXES = (
    # degrees; proved box of turns (deg) with 10 mm of slide per rad, by intervals on meshes of its own
    ([0.0, 0.0, 0.0], 70.460),
    (np.degrees([0.0, 1.0, 2.0]).tolist(), 43.650),
    ([200.0, 0.0, 0.0], 5.945),
)


SLIDING = ("thesis_ctr", "crl_ctr", "two_tube", "endonasal_ctr")


@pytest.mark.parametrize("name", SLIDING)
def test_the_kernel_proves_slides_that_python_proves(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    robot, random = load_robot(CONFIGS / f"{name}.yaml"), np.random.default_rng(len(name))
    space = joint_space(robot)
    drawn = space.sample(64)[random.integers(64, size=2)]
    results = [snap_distance(forward_kinematics(robot, *space.split(q))) for q in drawn]
    compiled = [(each.time(1.0, 0.01), each.slide) for each in results]
    without_kernel(monkeypatch)
    for each, (seconds, slide) in zip(results, compiled, strict=True):
        again = snap_distance(each.equilibrium)
        # Both boxes are proofs; which one is found close to the largest motion depends on the iteration.
        assert 0.97 < seconds / again.time(1.0, 0.01) < 1.03
        assert 0.97 < slide / again.slide < 1.03


def test_slides_have_no_snap_if_no_tubes_are_coupled(monkeypatch: pytest.MonkeyPatch) -> None:
    # Curved parts of this arm do not overlap. Withdrawn by half a metre it has no length at all.
    robot = load_robot(CONFIGS / "toronto_ctr.yaml")
    e = forward_kinematics(robot, [0.1, 0.5, -0.2], [0.335, 0.17, 0.073])
    by_kernel = snap_distance(e).time(1.0, 0.01)
    without_kernel(monkeypatch)
    assert by_kernel == pytest.approx(snap_distance(e).time(1.0, 0.01), rel=2e-3)
    assert by_kernel > 1.0


@pytest.mark.parametrize(("degrees", "box"), BOXES)
def test_all_joints_may_move_for_that_long(degrees: list[float], box: float) -> None:
    e = turned(THESIS, degrees)
    distance = snap_distance(e)
    seconds = distance.time(1.0, 0.01)
    assert np.degrees(seconds) == pytest.approx(box, rel=3e-3)
    assert distance.time(2.0, 0.02) == pytest.approx(seconds / 2, rel=3e-3)
    assert distance.time(2.0, 0.0) == distance.turn / 2
    random = np.random.default_rng(7)
    signs = random.choice([-1.0, 1.0], (16, 2, 3)) * seconds * 0.999
    path = follow(
        THESIS,
        np.vstack([e.rotations, e.rotations + signs[:, 0], e.rotations]),
        np.vstack([e.translations, e.translations + 0.01 * signs[:, 1], e.translations]),
        start=e,
    )
    assert not path.snaps
    assert path.equilibria[-1].tip_position == pytest.approx(e.tip_position, abs=1e-8)


def test_slides_alone_are_shorter_than_the_first_snap() -> None:
    # At 200 deg the robot snaps when tube 2 slides by -18.475431 mm, the least of all tubes and directions.
    e = turned(THESIS, [200.0, 0.0, 0.0])
    back = (e.rotations, e.translations - np.array([0.0, 0.03, 0.0]))
    snap = find_snap(THESIS, (e.rotations, e.translations), back, equilibrium=e)
    assert snap is not None
    assert (snap.translations - e.translations)[1] == pytest.approx(-18.475431e-3, abs=1e-8)
    assert 0.3 * 18.475e-3 < snap_distance(e).slide < 18.475e-3


@pytest.mark.parametrize("tube", range(3))
@pytest.mark.parametrize("slide", [-2e-3, -1e-5, 1e-5, 2e-3])
def test_the_image_of_a_slide_has_the_angles_after_it(tube: int, slide: float) -> None:
    e = turned(THESIS, [150.0, -20.0, 30.0])
    by = slide * np.eye(3)[tube]
    reached = forward_kinematics(THESIS, e.rotations, e.translations + by, start=e)
    form = PairForm.sliding(e, by)
    x = PairForm.sliding(reached, -by).psi - form.psi  # cut at the same places
    u = np.concatenate([np.maximum(-x, 0), np.maximum(x, 0)])
    image = form.image(np.zeros(len(u)), u)
    assert (image >= u - 1e-9).all()
    assert image.max() < 5 * u.max()  # turned bases and strips, which may cancel, are bounded one by one
    assert np.abs(x).max() > abs(slide) / 2


def test_a_form_without_slides_is_that_of_turns() -> None:
    e = turned(THESIS, [150.0, -20.0, 30.0])
    still = PairForm.sliding(e, np.zeros(3))
    r = snap_distance(e).turn
    assert still.proves(still.boxes(0.99 * r))
    assert not still.proves(still.boxes(1.02 * r))


def test_slides_of_a_tube_cut_into_equal_pieces_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.modules["tubeopt.stability.snap_distance"], "compiled_motion", lambda *_, **__: None)
    even = load_robot(CONFIGS / "two_tube.yaml")
    parts = (0.4, 0.6)
    cut = ConcentricRobot(
        [
            Tube.of_pieces(
                tube.outer_diameter,
                tube.inner_diameter,
                [Piece(part * tube.curved_length, tube.curvature) for part in parts],
                straight_length=tube.straight_length,
                material=tube.material,
            )
            for tube in even.tubes
        ]
    )
    one, two = (
        snap_distance(forward_kinematics(robot, [1.2, -0.9], even.home_translations - 0.01)) for robot in (even, cut)
    )
    assert two.time(3.0, 0.03) == pytest.approx(one.time(3.0, 0.03), rel=1e-9)


def test_nothing_snaps_while_tubes_bent_both_ways_turn_and_slide() -> None:
    """Pieces that bend the other way come to places where others were: couplings change their sign."""
    inner = Tube.of_pieces(1.0e-3, 0.8e-3, [Piece(0.03, 16.0), Piece(0.04, -16.0)], straight_length=0.1)
    pieces = [Piece(0.02, 14.0), Piece(0.01, 0.0), Piece(0.03, -14.0)]
    robot = ConcentricRobot([inner, Tube.of_pieces(1.5e-3, 1.2e-3, pieces, straight_length=0.06)])
    q, shift = np.array([0.5, 3.0]), np.array([-0.03, -0.01])
    arm = forward_kinematics(robot, q, shift)
    time = snap_distance(arm).time(3.0, 0.03)
    assert time == pytest.approx(0.053047, rel=1e-3)
    # Both tubes turn and slide against each other: the corner with the nearest snap.
    folds = []
    for signs in itertools.product((-1.0, 1.0), repeat=4):
        end = q + 0.6 * np.array(signs[:2]), shift + 0.006 * np.array(signs[2:])
        snap = find_snap(robot, (q, shift), end, equilibrium=arm)
        folds += [] if snap is None else [0.2 * snap.fraction]
    assert min(folds) == pytest.approx(0.119194, rel=1e-4)
    random = np.random.default_rng(0)
    corners = 0.9999 * time * random.choice([-1.0, 1.0], (12, 4)) * [3.0, 3.0, 0.03, 0.03]
    corners[[0, -1]] = 0.0
    passed = follow(robot, q + corners[:, :2], shift + corners[:, 2:], start=arm)
    assert not passed.snaps
    assert passed.equilibria[-1].tip_position == pytest.approx(arm.tip_position, abs=1e-7)


def test_slides_of_other_tubes_are_refused() -> None:
    pieces = load_robot(CONFIGS / "example_pieces.yaml")
    with pytest.raises(InputError, match="tube 1 has several stiffnesses, or does not bend about its x axis only"):
        _ = snap_distance(forward_kinematics(pieces, np.zeros(pieces.n_tubes))).slide
    with pytest.raises(InputError, match="turn_rate and shift_rate are both 0"):
        snap_distance(forward_kinematics(THESIS, [0, 0, 0])).time(0.0, 0.0)


@pytest.mark.parametrize("signs", [(1, 1, 1), (-1, -1, -1), (1, -1, 1), (-1, 1, -1), (1, -1, -1)])
@pytest.mark.parametrize("degrees", [[120.0, -20.0, 0.0], [200.0, 0.0, 0.0]])
def test_couplings_and_margins_after_slides_are_in_their_bounds(degrees: list[float], signs: tuple[int, ...]) -> None:
    e = turned(THESIS, degrees)
    by = np.minimum(0.012 * np.array(signs), 0.05)
    form = PairForm.sliding(e, by)
    assert form.slides is not None
    lowest = 1.0
    for fraction in (0.25, 0.5, 1.0):
        at = [e.translations, e.translations + fraction * by]
        reached = follow(THESIS, [e.rotations] * 2, at, start=e).equilibria[-1]
        if fraction == 1.0:
            again = PairForm.sliding(reached, -by)
            assert (again.w <= form.slides.upper * (1 + 1e-12)).all()
            assert (again.w >= form.slides.lower * (1 - 1e-12)).all()
            x = again.psi - form.psi
        lowest = min(lowest, reached.margin)
    u = np.concatenate([np.maximum(-x, 0), np.maximum(x, 0)])[None] + 1e-9
    assert form.least_eigenvalue(u)[0] <= lowest + 1e-7


def test_longer_transmissions_are_softer() -> None:
    e = turned(THESIS, [200.0, 0.0, 0.0])
    form = PairForm.sliding(e, np.full(3, -0.02))
    assert form.slides is not None
    softer = np.eye(form.A.shape[1]) + form.slides.A.T @ ((form.w * np.cos(form.psi))[:, None] * form.slides.A)
    assert np.linalg.eigvalsh(softer)[0] < e.margin - 1e-3
    cosine = np.cos(form.psi)
    w = np.where(cosine < 0, form.slides.upper, form.slides.lower)
    softest = np.eye(form.A.shape[1]) + form.slides.A.T @ ((w * cosine)[:, None] * form.slides.A)
    result = form.least_eigenvalue(np.zeros((1, 2 * len(form.psi))))[0]
    assert result == pytest.approx(np.linalg.eigvalsh(softest)[0], abs=1e-12)


def test_the_range_of_a_cosine_is_its_range() -> None:
    random = np.random.default_rng(3)
    low = random.uniform(-9, 9, 300)
    high = low + random.uniform(0, 7, 300)
    smallest, largest = range_of_cosine(low, high)
    sampled = np.cos(np.linspace(low, high, 4001))
    assert smallest == pytest.approx(sampled.min(0), abs=1e-5)
    assert largest == pytest.approx(sampled.max(0), abs=1e-5)
    assert (smallest <= sampled.min(0)).all()
    assert (largest >= sampled.max(0)).all()


# --- Known loads ------------------------------------------------------------------------------------------------------

LOADED = (
    ("thesis_ctr", 0.1),
    ("thesis_ctr", 0.6),
    ("crl_ctr", 0.2),
    ("till_snapping_pair", 0.5),
    ("example_pieces", 0.3),
)


def loaded(name: str, share: float, seed: int = 3) -> Equilibrium:
    """A pose under a share of the force that is proved to be borne there, in a random direction, and own weight."""
    robot, random = load_robot(CONFIGS / f"{name}.yaml"), np.random.default_rng(seed)
    pose = forward_kinematics(robot, random.uniform(-1.5, 1.5, robot.n_tubes))
    force = random.normal(size=3)
    force *= share * snap_distance(pose).force / np.linalg.norm(force)
    points = (PointLoad(0.6 * float(pose.arc_length[-1]), tuple((-force / 3).tolist())),)
    return forward_kinematics(robot, pose.rotations, load=Load(tuple(force.tolist()), points=points))


def form_of(e: Equilibrium) -> LoadedForm:
    return LoadedForm.of(e)


@pytest.mark.parametrize(("name", "share"), LOADED)
def test_a_known_load_leaves_a_ball_without_a_snap(name: str, share: float) -> None:
    e = loaded(name, share)
    distance, random = snap_distance(e), np.random.default_rng(2)
    assert 0.02 < distance.turn < 3.0
    n, load = e.robot.n_tubes, e.load
    corners = distance.turn * 0.999 * random.choice([-1.0, -0.3, 1.0], (6, n))
    path = follow(e.robot, np.vstack([e.rotations, e.rotations + corners, e.rotations]), start=e, load=load)
    assert not path.snaps
    assert path.equilibria[-1].tip_position == pytest.approx(e.tip_position, abs=1e-8)
    for direction in (*np.eye(n), -np.eye(n)[0], random.choice([-1.0, 1.0], n)):
        end = e.rotations + 3.0 * direction
        snap = find_snap(e.robot, (e.rotations, None), (end, None), equilibrium=e, load=load)
        assert snap is None or np.abs(snap.rotations - e.rotations).max() > distance.turn


@pytest.mark.parametrize(("name", "share"), LOADED)
def test_the_loaded_form_is_the_equilibrium(name: str, share: float) -> None:
    e = loaded(name, share)
    form, step = form_of(e), 1e-5
    assert form.defect.max() < 1e-12
    for k in range(e.robot.n_tubes):
        by = step * np.eye(e.robot.n_tubes)[k]
        sides = [forward_kinematics(e.robot, e.rotations + s * by, load=e.load, start=e) for s in (-1, 1)]
        low, high = (rows_of(form, side) for side in sides)
        assert form.J[:, k] == pytest.approx((high - low) / (2 * step), abs=1e-7)


def rows_of(form: LoadedForm, e: Equilibrium) -> Array:
    """(R,) pairs, tubes and bending of an equilibrium on the mesh of a form."""
    point = point_of(e)
    torsion, state = point.member.problem.torsion, point.state
    theta = state.theta[np.nonzero(torsion.moment)]
    i, j = np.nonzero((form.point[:, None] == form.point) & np.triu(np.ones((len(theta),) * 2, dtype=bool), 1))
    return np.concatenate([theta[i] - theta[j], theta, state.x[torsion.size :]])


@pytest.mark.parametrize(("name", "share"), LOADED)
def test_what_a_turn_changes_under_a_load_is_within_its_bounds(name: str, share: float) -> None:
    e = loaded(name, share)
    form, turn, random = form_of(e), snap_distance(e).turn, np.random.default_rng(5)
    before, largest = rows_of(form, e), []
    boxes = form.boxes(0.99 * turn)
    box = form.closed(boxes + np.tile(form.defect, 2))
    assert box is not None
    low, high = -box[:, : len(before)].max(0), box[:, len(before) :].max(0)
    change = form._bounds(box).change.max(0)  # of the moment
    for corner in random.choice([-1.0, 1.0], (4, e.robot.n_tubes)):
        turned = forward_kinematics(e.robot, e.rotations + 0.99 * turn * corner, load=e.load, start=e)
        x = rows_of(form, turned) - before
        assert (low - 1e-9 <= x).all()
        assert (x <= high + 1e-9).all()
        largest.append((x / high).max())
        # q is the moment, whitened: dW/du = B m.
        moment = np.linalg.norm(x[-2 * len(form.weight) :].reshape(-1, 2), axis=1) / (form.weight * form.softness)
        assert (moment <= change * (1 + 1e-9)).all()
    assert max(largest) > 0.3


def test_a_weak_load_changes_little() -> None:
    pose = forward_kinematics(THESIS, [0.0, 1.0, 2.0])
    weak = snap_distance(forward_kinematics(THESIS, pose.rotations, load=Load((1e-7, 0, 0)))).turn
    assert 1.0 < weak / pose.snap_distance < 1.15  # parts of another shape, in which a little more is proved
    assert weak < snap_distance(pose).nearest


def test_a_certificate_under_load_is_a_distance() -> None:
    robot = load_robot(CONFIGS / "crl_ctr.yaml")
    e = forward_kinematics(robot, [0.3, 2.0, -1.0], [-0.02, 0.0, 0.0], load=Load((1e-3, 0, 0)))
    assert snap_distance(e).turn == np.inf


# --- Forces -----------------------------------------------------------------------------------------------------------

# Degrees; proved force, mN; that of an earlier derivation, which bounds the motion by the softened energy.
FORCES = (
    ([0.0, 0.0, 0.0], 33.98593, 28.826732),
    (np.degrees([0.0, 1.0, 2.0]).tolist(), 33.98593, 22.277304),
    ([200.0, 0.0, 0.0], 8.83852, 5.926654),
)


@pytest.mark.parametrize(("degrees", "proved", "earlier"), FORCES)
def test_force_is_proved_and_below_every_limit(degrees: list[float], proved: float, earlier: float) -> None:
    pose = turned(THESIS, degrees)
    force = snap_distance(pose).force
    assert 1e3 * force == pytest.approx(proved, rel=1e-5)
    assert 1e3 * force > earlier
    random = np.random.default_rng(3)
    for direction in [*random.normal(size=(8, 3)), -pose.tip_rotation[:, 2]]:
        load = Load(tuple((force * direction / np.linalg.norm(direction)).tolist()))
        limit = find_load_limit(THESIS, pose.rotations, None, load, equilibrium=pose, up_to=4.0)
        assert limit is None or limit.factor > 1


@pytest.mark.parametrize("name", ["crl_ctr", "till_snapping_pair", "example_pieces"])
def test_forces_that_change_within_the_proved_one_cause_no_snap(name: str) -> None:
    robot = load_robot(CONFIGS / f"{name}.yaml")
    pose = here = forward_kinematics(robot, np.linspace(0.3, 1.5, robot.n_tubes))
    force, random = snap_distance(pose).force, np.random.default_rng(4)
    for direction in random.normal(size=(6, 3)):
        load = Load(tuple((0.999 * force * direction / np.linalg.norm(direction)).tolist()))
        here = forward_kinematics(robot, pose.rotations, load=load, start=here)
        assert here.margin > 0
    # Without the force the robot is where it was.
    back = forward_kinematics(robot, pose.rotations, load=Load((0.0, 0.0, 1e-12)), start=here)
    assert back.tip_position == pytest.approx(pose.tip_position, abs=1e-8)


@pytest.mark.parametrize("degrees", [[100.0, -40.0, 0.0], [200.0, 0.0, 0.0]])
def test_angles_and_torques_under_a_force_are_within_their_bounds(degrees: list[float]) -> None:
    pose, random = turned(THESIS, degrees), np.random.default_rng(5)
    force, form = snap_distance(pose).force, PairForm.of(pose)
    softening = arm_sections(THESIS, np.zeros(3)).softening(1.0, pairs=False)
    box = form.under_force(force, softening, tip_torques(pose))
    assert box is not None
    before, shares = PairForm.of(pose).psi, []
    for direction in random.normal(size=(8, 3)):
        load = Load(tuple((force * direction / np.linalg.norm(direction)).tolist()))
        bent = forward_kinematics(THESIS, pose.rotations, load=load, start=pose)
        problem = reduced_problem(THESIS, (0.0, 0.0, 0.0), discretisation_of(pose))
        angles, moment = sample_rotation(bent, problem.arc_length) + problem.phase, problem.moment
        first, second = np.triu_indices(3, 1)
        coupled = moment[:, first] * moment[:, second] != 0
        assert (np.abs((angles[:, first] - angles[:, second])[coupled] - before) < box).all()

        # On the mesh of the load: z + L' B (torques of the pairs) is what the force contributes, up to L' B t.
        point = point_of(bent)
        problem, state = point.member.problem.torsion, point.state
        lever = bent.arc_length[-1] - problem.arc_length
        own, across = (
            np.stack([np.cos(at := state.theta + problem.phase), np.sin(at)]),
            np.stack([-np.sin(at), np.cos(at)]),
        )
        natural = np.einsum("cai,ai->ac", own, problem.moment) / problem.stiffness.sum(1)[:, None]
        pairs = -np.einsum("ac,cai->ai", natural, across) * problem.moment
        unbalanced = state.x[: problem.size] + np.einsum("a,ai,aiu->u", problem.weight, pairs, problem.spread)
        largest = force * (lever / problem.stiffness.sum(1))[:, None] * problem.moment
        bound = np.abs((problem.weight[:, None] * largest)[..., None] * problem.spread).sum((0, 1))
        shares.append(float((np.abs(unbalanced) / bound).max()))
    # The bound is no larger than necessary, and never too small.
    assert 0.7 < max(shares) < 1


def test_a_force_on_eccentric_tubes_is_refused() -> None:
    pose = forward_kinematics(load_robot(CONFIGS / "thesis_etr.yaml"), [0.0, 0.0, 0.0])
    with pytest.raises(InputError, match="concentric tubes only"):
        _ = snap_distance(pose).force
