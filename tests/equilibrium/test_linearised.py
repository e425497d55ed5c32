"""The linearisation of an equilibrium, under every kind of load and of tubes, against differences of equilibria."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from tubeopt import (
    ConcentricRobot,
    EccentricRobot,
    Equilibrium,
    InputError,
    Load,
    Piece,
    SegmentedEccentricRobot,
    SolveError,
    Tube,
    forward_kinematics,
    load_robot,
)
from tubeopt.block.transcription.arm import evaluate_arm
from tubeopt.block.transcription.arm_response import LinearisedArm
from tubeopt.equilibrium.directions import PARAMETERS
from tubeopt.equilibrium.jacobian import derivatives_of
from tubeopt.equilibrium.linearised import Linearised, curvature_at, linearise
from tubeopt.equilibrium.member import OffCentreline, Point, sample_rotation
from tubeopt.equilibrium.problem import reduced_assembly
from tubeopt.robots.robot import Robot, resized
from tubeopt.typing import Array

HELIX = Piece(0.04, (3.0, 1.0, 8.0))
WAVE = Piece(
    0.05,
    lambda s: (9.0 * np.cos(20 * s), 4.0 * s, 0.0),
    bending_stiffness=lambda s: 1.2e-3 + 5e-3 * s,
    torsional_stiffness=lambda s: 7e-4 - 4e-3 * s,
)


def _tube(k: int, straight: float, curved: float, curvature: float) -> Tube:
    outer = 0.9e-3 + 0.5e-3 * k
    return Tube(outer, outer - 0.3e-3, straight, curved, curvature, mass_per_length=4e-3 * (k + 1))


@cache
def _robot(n: int, pieces: bool = False) -> ConcentricRobot:
    """Of n tubes, the innermost and longest of which is made of pieces."""
    tubes = [_tube(k, 0.16 - 0.035 * k, 0.11 - 0.012 * k, (9.0, 7.0, -5.0, 6.0)[k]) for k in range(n)]
    if pieces:
        chain = (HELIX, WAVE, Piece(0.03, -8.0))
        tubes[0] = Tube.of_pieces(0.9e-3, 0.6e-3, chain, straight_length=0.15, mass_per_length=4e-3)
    return ConcentricRobot(tuple(tubes))


SHIFT = np.array([-0.011, -0.017, -0.004, -0.013])
ROTATIONS = np.array([0.3, 1.7, -0.6, 0.9])

LOADS = {
    "tip": Load((0.06, -0.04, 0.03)),
    "gravity": Load(gravity=(2.0, -9.0, 3.0)),
    "points": Load(points=((0.031, (0.1, 0.05, -0.06)), (0.066, (-0.05, 0.08, 0.02)))),
    "distributed": Load(distributed=(0.4, -0.7, 0.3)),
    "function": Load(distributed=lambda s: (0.9 * np.cos(25 * s), 0.5, -7 * s)),
    "stretches": Load(distributed=((0.012, 0.043, (1.0, -0.8, 0.5)), (0.03, 0.08, (-0.2, 0.5, 0.4)))),
    "moment": Load(moment=(0.004, -0.003, 0.002)),
    "following": Load((0.03, 0.02, -0.04), (0.002, 0.001, -0.001), frame="tip"),
    "point moment": Load(points=((0.037, (0.05, 0.02, 0.03), (0.003, -0.002, 0.004)),)),
    "moments along": Load(distributed=((0.009, 0.071, (0.2, 0.3, -0.4), (0.02, 0.03, -0.04)),)),
    "all": Load(
        (0.02, 0.03, -0.02),
        (0.001, 0.001, 0.002),
        frame="tip",
        gravity=(2.0, -9.0, 3.0),
        distributed=lambda s: (0.5 * np.cos(25 * s), 0.2, -3 * s, 0.01, 0.01 * np.sin(30 * s), -0.01),
        points=((0.037, (0.02, 0.02, 0.03), (0.001, -0.001, 0.002)),),
    ),
}


def _resized(robot: Robot, name: str, by: Array) -> Robot:
    """The robot with a dimension of its tubes changed by (n,), the same for all tubes of a segment."""
    if isinstance(robot, EccentricRobot):
        return replace(robot, tube=robot.tube.resized(name, getattr(robot.tube, name) + by[0]))
    if isinstance(robot, SegmentedEccentricRobot):
        grown = zip(robot.segments, by[::3], strict=True)
        return replace(robot, segments=tuple(tube.resized(name, getattr(tube, name) + one) for tube, one in grown))
    for i, one in enumerate(by):
        robot = resized(robot, i, name, getattr(robot.tubes[i], name) + one)
    return robot


def _moved(e: Equilibrium, name: str, by: Array) -> Equilibrium:
    """The equilibrium with all values of a parameter changed by (n,), solved for anew."""
    robot, joints = e.robot, {"rotations": e.rotations, "translations": e.translations}
    if name in joints:
        joints[name] = joints[name] + by
    else:
        robot = _resized(robot, name, by)
    guess = e if robot is e.robot else None
    return forward_kinematics(robot, joints["rotations"], joints["translations"], load=e.load, start=guess)


def _told(e: Equilibrium) -> Array:
    return np.concatenate([e.tip_position, e.tip_rotation.ravel(), e.tip_rotations, [e.energy, e.margin]])


def _columns(e: Equilibrium, name: str, direction: Array, side: int = 1) -> Array:
    """The same rows of the Jacobian, along a direction (n,) of a parameter."""
    of = e.jacobian(wrt=(name,), side=side)
    turn = of.rotation @ direction
    hat = np.array([[0, -turn[2], turn[1]], [turn[2], 0, -turn[0]], [-turn[1], turn[0], 0]])
    rows = of.position @ direction, (hat @ e.tip_rotation).ravel(), of.tip_rotations @ direction
    return np.concatenate([*rows, [of.energy @ direction, of.margin @ direction]])


def _size(e: Equilibrium, name: str) -> Array:
    """(n,) steps that turn the tip by about a thousandth."""
    if name == "rotations":
        return np.full(len(e.rotations), 2e-3)
    if "length" in name or name == "translations":
        return np.full(len(e.rotations), 2e-5)
    return np.array([2e-3 * getattr(tube, name) for tube in e.robot.tubes])


def _check(e: Equilibrium, name: str, tolerances: tuple[float, float, float, float, float]) -> None:
    """Compare with differences of fourth order."""
    random = np.random.default_rng(len(name))
    step = _size(e, name) * random.uniform(0.5, 1.0, len(e.rotations)) * random.choice([-1, 1], len(e.rotations))
    one, two, back, twice = (_told(_moved(e, name, k * step)) for k in (1, 2, -1, -2))
    desired = (8 * (one - back) - (two - twice)) / 12
    result = _columns(e, name, step)
    n = len(e.rotations)
    for rows, size in zip(
        (slice(0, 3), slice(3, 12), slice(12, 12 + n), slice(-2, -1), slice(-1, None)), tolerances, strict=True
    ):
        off = np.abs(result[rows] - desired[rows])
        assert np.isnan(result[rows]).all() or off.max() <= size, (name, rows, result[rows], desired[rows])


@pytest.mark.parametrize("name", PARAMETERS)
@pytest.mark.parametrize("load", LOADS)
def test_every_derivative_under_every_load_is_that_of_differences(load: str, name: str) -> None:
    """Steps change the tip by a tenth of a millimetre and a milliradian: 1e-6 of that and of the energy; the margin is
    solved for to 1e-8."""
    number, column = sorted(LOADS).index(load), PARAMETERS.index(name)
    n = 1 + number % 4
    e = forward_kinematics(_robot(n, (number + column) % 2 == 1), ROTATIONS[:n], SHIFT[:n], load=LOADS[load])
    assert np.isfinite(e.jacobian().margin).all()
    _check(e, name, (1e-10, 2e-9, 2e-9, 1e-6 * e.energy * 2e-3 + 1e-13, 3e-8))


OFF_THE_CENTRELINE = {
    "one segment": ("thesis_etr", [-0.013] * 3),
    "segments": ("example_three_segment_etr", [*[-0.004] * 3, *[-0.009] * 3, *[-0.015] * 3]),
}


@cache
def _eccentric(robot: str) -> Equilibrium:
    """Tubes off the centreline at random rotations; between the segments they are straight."""
    name, shift = OFF_THE_CENTRELINE[robot]
    one = load_robot(f"configs/robots/{name}.yaml")
    if isinstance(one, EccentricRobot):
        one = replace(one, tube=one.tube.resized("straight_length", 0.05))
    turned = np.random.default_rng(2).uniform(-3, 3, one.n_tubes)
    return forward_kinematics(one, turned, one.home_translations + shift)


def _along(e: Equilibrium, name: str, direction: Array, side: int = 1) -> Array:
    """Change of tip, tip rotations, energy and margin, with all tubes moved at once."""
    of = linearise(e, (name,), side, along=direction[:, None])
    return np.concatenate([of.tip_position, of.tip_rotations, of.energy[None], of.margin[None]])[:, 0]


@pytest.mark.parametrize("name", PARAMETERS)
@pytest.mark.parametrize("robot", OFF_THE_CENTRELINE)
def test_every_derivative_of_tubes_off_the_centreline_is_that_of_differences(robot: str, name: str) -> None:
    e, random = _eccentric(robot), np.random.default_rng(len(name))
    assert e.margin < 0.999
    n, size = len(e.rotations), _size(e, name)
    together = random.uniform(0.5, 1.0, n // 3).repeat(3)
    step = size * (random.choice([-1, 1], n) * random.uniform(0.5, 1.0, n) if name == "rotations" else together)

    def there(k: float) -> Array:
        moved = _moved(e, name, k * step)
        return np.concatenate([moved.tip_position, moved.tip_rotations, [moved.energy, moved.margin]])

    one, two, back, twice = (there(k) for k in (1, 2, -1, -2))
    off = _along(e, name, step) - (8 * (one - back) - (two - twice)) / 12
    assert np.abs(off)[:3].max() < 1e-10
    assert np.abs(off)[3:-2].max() < 2e-9
    assert abs(off[-2]) < 1e-6 * e.energy * 2e-3
    assert abs(off[-1]) < 3e-8


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("name", ["translations", "curved_length"])
def test_both_sides_are_exact_where_ends_off_the_centreline_meet(name: str, side: int) -> None:
    """The three ends of a segment lie at one place, and move at once."""
    e = _eccentric("segments")
    for segment in range(3):
        direction = np.repeat(np.eye(3)[segment], 3)

        def there(step: float, direction: Array = direction) -> Array:
            moved = _moved(e, name, step * direction)
            return np.concatenate([moved.tip_position, moved.tip_rotations, [moved.energy, moved.margin]])

        expected = _towards(there, side * 1e-4)
        off = np.abs(_along(e, name, direction, side) - expected)
        assert off.max() < 1e-6 * np.abs(expected).max()
        assert off[:3].max() < 1e-6


def test_curvature_inside_an_arm_off_the_centreline_changes_as_differences_say() -> None:
    e = _eccentric("one segment")
    for name in PARAMETERS:
        step = _size(e, name) * 0.8
        of = linearise(e, (name,), along=step[:, None])
        for fraction in (0.37, 0.9):
            report = (curvature_at(linearise(_moved(e, name, k * step)), fraction)[0] for k in (1, 2, -1, -2))
            one, two, back, twice = report
            desired, result = (8 * (one - back) - (two - twice)) / 12, curvature_at(of, fraction)[1][:, 0]
            assert np.abs(result - desired).max() < 1e-6 * max(float(np.abs(desired).max()), 1e-3), name


@pytest.mark.parametrize("load", [None, "tip", "moments along", "all"])
@pytest.mark.parametrize("pieces", [False, True])
def test_curvature_inside_the_arm_changes_as_differences_say(pieces: bool, load: str | None) -> None:
    """At a fraction of its length, which changes too, by every parameter."""
    e = forward_kinematics(_robot(3, pieces), ROTATIONS[:3], SHIFT[:3], load=None if load is None else LOADS[load])
    for name in PARAMETERS:
        step, of = _size(e, name) * np.array([0.9, -0.6, 0.8]), linearise(e, (name,))
        moved = [linearise(_moved(e, name, k * step)) for k in (1, 2, -1, -2)]
        for fraction in (0.37, 0.9):
            report = (curvature_at(each, fraction)[0] for each in moved)
            one, two, back, twice = report
            desired, (_, result) = (8 * (one - back) - (two - twice)) / 12, curvature_at(of, fraction)
            assert np.abs(result @ step - desired).max() < 1e-6 * max(float(np.abs(desired).max()), 1e-3), name


def _one_sided(e: Equilibrium, name: str, step: Array) -> Array:
    """The change by a step to one side, of fourth order."""
    rows = [_told(e), *(_told(_moved(e, name, k * step)) for k in (1, 2, 3, 4))]
    return np.asarray(np.array([-25, 48, -36, 16, -3]) @ np.array(rows) / 12)


ENDS_TOGETHER = np.zeros(3)
"""Stands for translations at which all tubes end together."""
AT_AN_END = Load((0.02, 0.03, -0.05), points=((0.086 - 0.004, (0.05, -0.04, 0.03)),))
AT_A_TRANSITION = Load((0.02, 0.03, -0.05), points=((0.009, (0.05, -0.04, 0.03), (0.003, 0.004, 0.008)),))


@pytest.mark.parametrize(
    ("shift", "load"),
    [
        ((0.0, 0.0, 0.0), LOADS["tip"]),
        ((0.0, 0.0, 0.0), LOADS["moments along"]),
        (ENDS_TOGETHER, Load((0.06, -0.04, 0.03), gravity=(2.0, -9.0, 3.0), distributed=(0.4, -0.7, 0.3))),
        (ENDS_TOGETHER, Load((0.06, -0.04, 0.03))),
        ((-0.011, -0.017, -0.004), AT_AN_END),
        ((0.021, -0.017, 0.009), AT_A_TRANSITION),
    ],
    ids=["home", "home with moments", "ends together, weight", "ends together", "load at an end", "at a transition"],
)
@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("name", ["translations", "curved_length"])
def test_where_breakpoints_meet_both_sides_are_those_of_differences(
    shift: Array, load: Load, side: int, name: str
) -> None:
    for pieces in (False, True):
        robot = _robot(3, pieces)
        if shift is ENDS_TOGETHER:
            reach = np.array([tube.curved_length for tube in robot.tubes])
            shift = reach.min() - reach
        e = forward_kinematics(robot, ROTATIONS[:3], shift, load=load)
        for tube in range(3):
            step = side * 2e-5 * np.eye(3)[tube]
            desired, result = _one_sided(e, name, step), _columns(e, name, step, side)
            assert np.abs(result - desired)[:-2].max() < 2e-9, (pieces, tube)
            assert abs(result[-2] - desired[-2]) < 1e-7 * e.energy + 1e-13
            # Without an energy both sides of a difference must have the same breakpoints.
            unknown = np.isnan(result[-1]) and not load.has_energy
            assert unknown or abs(result[-1] - desired[-1]) < 3e-8


def test_under_a_load_of_nothing_it_is_that_without_load() -> None:
    for robot, shift in (
        (load_robot("configs/robots/thesis_ctr.yaml"), None),
        (_robot(4), SHIFT),
        (_robot(2, True), SHIFT[:2]),
    ):
        n = robot.n_tubes
        plain = forward_kinematics(robot, ROTATIONS[:n], shift)
        loaded = forward_kinematics(robot, ROTATIONS[:n], shift, load=Load())
        for side in (1, -1):
            one, other = (e.jacobian(wrt=PARAMETERS, side=side) for e in (plain, loaded))
            for a, b in zip(
                (one.position, one.rotation, one.tip_rotations, one.energy),
                (other.position, other.rotation, other.tip_rotations, other.energy),
                strict=True,
            ):
                assert np.abs(a - b).max() < 1e-8 * np.abs(a).max()


@pytest.mark.parametrize("load", [None, "tip"])
@pytest.mark.parametrize("name", ["curved_length", "translations"])
def test_a_straight_tube_grows_a_curved_part(name: str, load: str | None) -> None:
    """With the curvature that is written for it, though it has no length; moved forward it stays straight."""
    tubes = [replace(_tube(0, 0.2, 0.0, 9.0), curvature=9.0), _tube(1, 0.06, 0.1, 7.0)]
    e = forward_kinematics(
        ConcentricRobot(tuple(tubes)), ROTATIONS[:2], [0.09, -0.03], load=None if load is None else LOADS[load]
    )
    for step in 2e-5 * np.eye(2):
        desired, result = _one_sided(e, name, step), _columns(e, name, step)
        assert np.abs(result - desired)[:-2].max() < 2e-9
        assert abs(result[-2] - desired[-2]) < 1e-7 * e.energy + 1e-13
        assert abs(result[-1] - desired[-1]) < 3e-8
    inner, outer = e.jacobian(wrt=("curved_length", "translations")).rotation[:, [0, 2]].T
    assert np.linalg.norm(inner - outer) > 1.0


def test_a_tip_does_not_draw_back_from_under_a_point_load() -> None:
    e = forward_kinematics(_robot(1), [0.0], [0.0], load=Load(points=((0.11, (0.01, 0, 0)),)))
    out = e.jacobian(wrt=("translations",)).position[:, 0]
    moved = [forward_kinematics(e.robot, [0.0], [k * 1e-5], load=e.load).tip_position for k in (1, 2)]
    assert np.abs(out - (4 * moved[0] - moved[1] - 3 * e.tip_position) / 2e-5).max() < 1e-6
    with pytest.raises(InputError, match="the tip, 110 mm"):
        e.jacobian(wrt=("translations",), side=-1)
    e.jacobian(wrt=("rotations",), side=-1)


def test_a_moment_does_not_pass_from_tube_to_tube() -> None:
    at = 0.086 - 0.004
    e = forward_kinematics(_robot(3), ROTATIONS[:3], SHIFT[:3], load=Load(points=((at, (0, 0, 0), (0, 0, 1e-3)),)))
    e.jacobian(wrt=("translations",))
    with pytest.raises(SolveError, match="of tube 3 does"):
        e.jacobian(wrt=("translations",), side=-1)
    shift = np.array([-0.024, -0.012, 0.0])
    e = forward_kinematics(_robot(3), ROTATIONS[:3], shift, load=Load(moment=(0, 0, 1e-3)))
    for side in (1, -1):
        with pytest.raises(SolveError, match="the end of tube"):
            e.jacobian(wrt=("curved_length",), side=side)


@pytest.mark.parametrize("load", [None, LOADS["tip"]])
def test_a_jacobian_computes_beyond_the_pose_what_is_read(load: Load | None, monkeypatch: pytest.MonkeyPatch) -> None:
    robot = load_robot("configs/robots/thesis_etr.yaml") if load is None else _robot(3)
    e = forward_kinematics(robot, ROTATIONS[:3], None if load is None else SHIFT[:3], load=load)
    read: list[str] = []
    for name in ("margin", "energy"):
        known = getattr(Linearised, name)
        monkeypatch.setattr(Linearised, name, property(lambda self, k=known, n=name: (read.append(n), k.func(self))[1]))
    result, at_once = e.jacobian(), derivatives_of(e)
    assert not read
    np.testing.assert_array_equal(result.matrix, [*at_once.tip_position, *at_once.tip_rotation])
    for _ in range(8):  # of other equilibria, for which those kept of this one make room
        forward_kinematics(robot, np.zeros(3), load=load).jacobian()
    margin, mine = result.margin, pickle.loads(pickle.dumps(result))
    assert read == ["margin", "energy"]
    assert result.margin is margin
    for name in ("tip_rotations", "margin", "energy"):
        for one in (result, mine, replace(result, wrt=())):
            np.testing.assert_allclose(getattr(one, name), getattr(at_once, name), rtol=0, atol=1e-12)
    assert repr(mine) == repr(result)
    with pytest.raises(AttributeError, match="'Jacobian' object has no attribute 'margins'"):
        result.margins  # type: ignore[attr-defined]  # noqa: B018


def test_friction_is_refused() -> None:
    e = forward_kinematics(_robot(2), ROTATIONS[:2], SHIFT[:2])
    with pytest.raises(InputError, match="friction"):
        linearise(replace(e, friction="some"))  # type: ignore[arg-type]


def _coincident(pieces: bool) -> ConcentricRobot:
    """Three tubes, all ends at one place at home, tube 1 of pieces or of one curvature."""
    tubes = [_tube(k, 0.12 - 0.03 * k, 0.08, (9.0, 7.0, -5.0)[k]) for k in range(3)]
    if pieces:
        chain = (HELIX, Piece(0.04, -8.0, bending_stiffness=lambda s: 2e-3 + 5e-3 * s))
        tubes[0] = Tube.of_pieces(0.9e-3, 0.6e-3, chain, straight_length=0.12, mass_per_length=4e-3)
    return ConcentricRobot(tuple(tubes))


def _towards(f: Callable[[float], Array], step: float) -> Array:
    """The derivative towards steps of this sign, by the polynomial through five values."""
    values = [f(k * step) for k in range(5)]
    return np.asarray(np.tensordot([-25 / 12, 4.0, -3.0, 4 / 3, -1 / 4], values, 1) / step)


OPPOSED = np.array([0.3, 2.9, 0.5])
"""Rotations at which the margin is below 1."""

TOGETHER = [(1.0, 1.0, 1.0), (1.0, 1.0, 0.0), (1.0, 2.0, 0.5), (-1.0, 1.0, 0.4), (-0.7, -0.7, 1.0)]
"""Speeds of three tubes: alike, two of them alike, and in every order, also to both sides."""


@pytest.mark.parametrize("name", ["translations", "curved_length"])
@pytest.mark.parametrize("pieces", [False, True])
@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("speed", TOGETHER)
def test_tubes_that_move_at_once_push_what_they_uncover_once(
    speed: tuple[float, ...], side: int, pieces: bool, name: str
) -> None:
    """All ends coincide. Added up tube by tube the derivatives are up to three times too large, or 0."""
    e = forward_kinematics(_coincident(pieces), OPPOSED, np.full(3, -0.011))
    direction = np.array(speed)
    of = linearise(e, (name,), side, along=direction[:, None])

    def there(step: float) -> Array:
        moved = _moved(e, name, step * direction)
        return np.concatenate([moved.tip_position, moved.tip_rotations, [moved.energy, moved.margin]])

    expected = _towards(there, side * 1e-4)
    report = np.concatenate([of.tip_position, of.tip_rotations, of.energy[None], of.margin[None]])[:, 0]
    assert np.abs(report - expected).max() < 1e-6 * np.abs(expected).max()
    assert np.abs(report - expected)[:3].max() < 1e-6


@pytest.mark.parametrize("side", [1, -1])
def test_tubes_that_move_at_once_are_exact_under_a_load(side: int) -> None:
    load = Load((0.02, 0.03, -0.02), gravity=(2.0, -9.0, 3.0), distributed=(0.2, -0.3, 0.1))
    e = forward_kinematics(_coincident(True), OPPOSED, np.full(3, -0.011), load=load)
    of = linearise(e, ("translations",), side, along=np.ones((3, 1)))
    expected = _towards(lambda step: _told(_moved(e, "translations", np.full(3, step))), side * 1e-4)
    assert np.abs(of.tip_position[:, 0] - expected[:3]).max() < 2e-6
    assert np.abs(of.margin[0] - expected[-1]) < 2e-6 * abs(expected[-1])


def test_a_tip_moment_stays_with_its_tube_where_all_ends_move_at_once() -> None:
    """Tube by tube another one takes the moment over, and there is no derivative."""
    e = forward_kinematics(_coincident(True), OPPOSED, np.full(3, -0.011), load=LOADS["moment"])
    for side in (1, -1):
        of = linearise(e, ("translations",), side, along=np.ones((3, 1)))
        expected = _towards(lambda step: _told(_moved(e, "translations", np.full(3, step))), side * 1e-4)
        assert np.abs(of.tip_position[:, 0] - expected[:3]).max() < 2e-6
        with pytest.raises(SolveError, match="a moment acts there"):
            e.jacobian(side=side)


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("pieces", [False, True])
def test_tubes_of_one_carriage_move_at_once(pieces: bool, side: int) -> None:
    """Each tube of a carriage has an equal part of the derivative."""
    e = forward_kinematics(_coincident(pieces), OPPOSED, np.full(3, -0.011))
    report = derivatives_of(e, side=side, carriages=((0, 1), (2,)))
    direction = np.array([1.0, 1.0, 0.0])
    expected = _towards(lambda step: _moved(e, "translations", step * direction).tip_position, side * 1e-4)
    assert np.abs(report.tip_position[:, 3:] @ direction - expected).max() < 1e-6
    assert np.abs(report.tip_position[:, 3] - report.tip_position[:, 4]).max() < 1e-15


@pytest.mark.parametrize("name", ["curvature", "bending_stiffness", "torsional_stiffness"])
def test_one_tube_off_the_centreline_may_change_alone(name: str) -> None:
    """No robot has such tubes, but its bundle may."""
    e = _eccentric("segments")
    bundle, start = e.robot.assembly(e.translations), None
    for tube in (0, 4, 8):
        report = []
        for k in (0, 1, 2, -1, -2):
            values = getattr(bundle, name).copy()
            values[tube] *= 1 + 2e-3 * k
            problem = reduced_assembly(replace(bundle, **{name: values}))
            member = OffCentreline(e.robot, problem, e.rotations, tuple(e.translations.tolist()))
            x = member.unknowns(sample_rotation(e, problem.arc_length)) if start is None else start
            point = Point.solved_near(member, x, "no equilibrium")
            shape = evaluate_arm(problem, e.rotations, point.state, point.torsion)
            report.append(np.array([*shape.position[-1], point.margin]))
            if k == 0:
                start = point.state.x
                current = LinearisedArm(problem, e.rotations, point.state.theta, shape)
                of = Linearised(current, e.robot.tubes, point.margin, (name,))
        desired = (8 * (report[1] - report[3]) - (report[2] - report[4])) / 12
        step = 2e-3 * getattr(bundle, name)[tube]
        result = np.append(of.tip_position[:, tube], of.margin[tube]) * step
        assert np.abs(result - desired).max() < 1e-5 * np.abs(desired).max(), tube
