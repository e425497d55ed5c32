"""What a verification says of a design, at either side of what is promised."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from tests.examples import nested
from tubeopt import ConcentricRobot, Piece, SolveError, Tube, forward_kinematics, snap_free_certificate
from tubeopt.block.quantities import Quantity
from tubeopt.bodies.obstacles import HalfSpace, Sphere
from tubeopt.design import exchange, requirements, verify
from tubeopt.design.program import Added
from tubeopt.design.requirements import (
    Avoid,
    Length,
    Nesting,
    Reach,
    SnapFree,
    SnapFreeInUse,
    Strain,
    Stroke,
    StrokeForce,
    Target,
    Wall,
)

ROBOT = nested((0.0, 0.05, 3.0), (0.0, 0.05, 3.0))


def program_of(*requirements: Any, ordered: bool = False) -> Any:
    """Of two poses, of which only this is known."""
    task = SimpleNamespace(requirements=requirements, ordered=ordered, translation_ranges=())
    return SimpleNamespace(
        task=task, task_poses=(0, 1), requirement_poses=((0, 1),) * len(requirements), added=SimpleNamespace(points=())
    )


def arm(**known: Any) -> Any:
    return SimpleNamespace(translations=np.zeros(2), **known)


def checks_of(requirement: Any, *arms: Any, robot: ConcentricRobot = ROBOT) -> Any:
    return verify.verify(program_of(requirement), robot, np.zeros(0), arms).checks


@pytest.mark.parametrize(
    ("least", "found", "snaps", "kept"),
    [
        (0.2 - 1e-4, 0.2, 0, [True, True, True]),
        (0.2 - 1.03e-4, 0.2, 0, [False, True, True]),
        (0.2, 0.2 - 1.1e-6, 0, [True, False, True]),
        (0.2, None, 0, [True, False, True]),
        (0.2, 0.3, 1, [True, True, False]),
    ],
)
def test_a_certificate_is_kept_at_its_worst_translations_and_above_no_margin_that_is_found(
    least: float, found: float | None, snaps: int, kept: list[bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The search, and the turns, are at the translations with the least certificate; a fold has margin 0."""
    searched: list[float] = []

    def search(robot: Any, row: Any) -> Any:
        searched.append(row[0])
        if found is None:
            raise SolveError("a fold")
        return SimpleNamespace(margin=found)

    monkeypatch.setattr(verify, "SEARCHED_TRANSLATIONS", 1)
    monkeypatch.setattr(verify, "certified_at", lambda program, robot: [(0.0, 0.0), (1.0, 0.0), (2.0, 0.0)])
    monkeypatch.setattr(verify, "snap_free_certificate", lambda robot, row: (0.9, least, 0.8)[int(row[0])])
    monkeypatch.setattr(verify, "worst_margin", search)
    monkeypatch.setattr(verify, "count_snaps", lambda robot, turns, seed, row: (snaps, snaps))
    checks = checks_of(SnapFree(0.2))
    assert [check.satisfied for check in checks] == kept
    assert searched == [1.0]


def test_a_certificate_is_kept_at_its_floor_where_tubes_may_be_off(monkeypatch: pytest.MonkeyPatch) -> None:
    one = SnapFree(0.2, curvature_error=0.1)
    monkeypatch.setattr(verify, "certified_at", lambda program, robot: [(0.0, 0.0)])
    monkeypatch.setattr(verify, "worst_margin", lambda robot, row: SimpleNamespace(margin=1.0))
    monkeypatch.setattr(verify, "count_snaps", lambda *_: (0, 0))
    monkeypatch.setattr(verify, "PERTURBED_ROBOTS", 0)
    for short, retained in ((1.0e-4, True), (1.02e-4, False)):
        monkeypatch.setattr(
            verify, "snap_free_certificate", lambda robot, row, short=short: one.required_margin - short
        )
        assert checks_of(one)[0].satisfied == retained


def test_errors_of_three_tubes_take_as_much_from_a_certificate_as_is_allowed_for() -> None:
    """Two soft curved tubes in a stiff straight one: the coupling grows by ((1 + c)(1 + s))^2 / (1 - s), over 1 - s."""
    soft = nested((0.0, 0.05, 3.0), (0.0, 0.05, 3.0), (0.0, 0.05, 0.0)).tubes
    one = SnapFree(0.2, curvature_error=0.1, stiffness_error=0.2)

    def softened(bend: float, bending: float, torsional: float, around: float) -> float:
        tubes = [
            tube.resized("curvature", tube.curvature * bend)
            .resized("bending_stiffness", 1e-3 * bending)
            .resized("torsional_stiffness", 1e-3 * torsional)
            for tube in soft[:2]
        ]
        return 1 - snap_free_certificate(ConcentricRobot((*tubes, soft[2].resized("bending_stiffness", around))))

    nominal = softened(1.0, 1.0, 1.0, 1.0)
    worst = softened(1.1, 1.2, 0.8, 0.8) / nominal
    assert 0.999 * one.growth <= worst <= one.growth * (1 + 1e-9)
    assert one.required_margin == pytest.approx(1 - 0.8 / one.growth, rel=1e-12)


def test_tubes_that_are_off_are_tried_at_the_corners_of_their_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of two equal tubes the certificate falls by (1 + c)^2 (1 + s) / (1 - s) at most, at the worst translations."""

    def certificate(robot: ConcentricRobot, row: Any) -> float:
        bent = np.prod([tube.curvature for tube in robot.tubes])
        soft = [
            sum(1 / getattr(tube, f"{kind}_stiffness") for tube in robot.tubes) for kind in ("bending", "torsional")
        ]
        return float(1 - bent * soft[1] / soft[0] * (2 * 0.05 / np.pi) ** 2 * row[0])

    rows = [np.array([0.5, 0.0]), np.ones(2), np.array([0.7, 0.0])]
    assert certificate(ROBOT, rows[1]) == pytest.approx(snap_free_certificate(ROBOT), abs=1e-9)
    monkeypatch.setattr(verify, "PERTURBED_ROBOTS", 400)
    monkeypatch.setattr(verify, "SEARCHED_TRANSLATIONS", 0)
    monkeypatch.setattr(verify, "certified_at", lambda *_: rows)
    monkeypatch.setattr(verify, "snap_free_certificate", certificate)
    worst = 1 - (1 - certificate(ROBOT, rows[1])) * 1.1**2 * 1.2 / 0.8
    for more, retained in ((-1e-9, True), (1e-9, False)):
        requested = SnapFree(worst + 1e-4 + 1e-6 + more, curvature_error=0.1, stiffness_error=0.2)
        check = checks_of(requested)[1]
        assert float(check.value) == pytest.approx(worst, abs=1e-5)
        assert check.satisfied == retained


@pytest.mark.parametrize(
    ("margins", "snap", "kept"),
    [
        ([[0.5, 0.2981], [0.4, 0.5]], None, [True, True, True]),
        ([[0.5, 0.2979], [0.4, 0.5]], None, [True, True, False]),
        ([[0.5, 0.4], [0.2979, 0.5]], None, [True, True, False]),
        ([[0.5, 0.4], [0.4, 0.5]], 0.7, [True, True, False]),
    ],
)
def test_the_margin_in_use_is_the_least_of_poses_ways_and_deployments(
    margins: list[list[float]], snap: float | None, kept: list[bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    program = program_of(SnapFreeInUse(0.3, deployed=True))
    paths = [SimpleNamespace(snap=snap if k else None, margin=np.array(each)) for k, each in enumerate(margins)]
    monkeypatch.setattr(verify, "motions", lambda *_: paths)
    for at_pose, on_the_way in ((0.2991, 0.2991), (0.2989, 0.5), (0.5, 0.2989)):
        drawn = (arm(margin=0.9), arm(margin=on_the_way))
        monkeypatch.setattr(verify, "deployments", lambda robot, arms, drawn=drawn: drawn)
        result = verify.verify(program, ROBOT, np.zeros(0), (arm(margin=0.9), arm(margin=at_pose)))
        assert [check.satisfied for check in result.checks] == [at_pose > 0.299, on_the_way > 0.299, kept[2]]
        assert result.satisfied == all(check.satisfied for check in result.checks)


def test_the_stroke_force_is_that_of_the_weakest_pose(monkeypatch: pytest.MonkeyPatch) -> None:
    for second, retained in ((0.5 - 0.9e-6, True), (0.5 - 1.1e-6, False)):
        forces = [0.9, second]
        monkeypatch.setattr(verify, "numbers_of", lambda *_, forces=forces: lambda one: np.array([forces[one.pose]]))
        assert checks_of(StrokeForce(0.5), arm(), arm())[0].satisfied == retained


def test_the_room_around_an_arm_is_the_least_of_poses_and_deployments(monkeypatch: pytest.MonkeyPatch) -> None:
    one = Avoid((Sphere((0.0, 0.0, 1.0), 0.1),), clearance=2e-3, deployed=True)
    monkeypatch.setattr(verify, "arm_distance", lambda one, robot, arm: arm.room)
    for pose, drawn in ((2e-3, 2e-3), (1.999e-3, 9e-3), (9e-3, 1.999e-3)):
        monkeypatch.setattr(verify, "deployments", lambda robot, arms, drawn=drawn: [arm(room=drawn)])
        assert checks_of(one, arm(room=9e-3), arm(room=pose))[0].satisfied == (min(pose, drawn) >= 2e-3)


def test_a_tip_is_as_near_to_its_target_as_the_worst_of_all() -> None:
    """By shares of what is allowed: 0.2 mm off is too much where 0.1 mm is, and 0.5 mm is not where 1 mm is."""
    wide, fine = Target((0.0, 0.0, 0.1), 1e-3), Target((0.0, 0.0, 0.2), 1e-4, (0.0, 0.0, 1.0), np.radians(2.0))
    for off, turn, retained in ((1.0009e-4, 1.999, [True, True]), (2e-4, 2.001, [False, False])):
        axes = np.eye(3)
        axes[:, 2] = np.sin(np.radians(turn)), 0.0, np.cos(np.radians(turn))
        arms = (
            arm(tip_position=np.array([5e-4, 0.0, 0.1])),
            arm(tip_position=np.array([off, 0.0, 0.2]), tip_rotation=axes),
        )
        assert [check.satisfied for check in checks_of(Reach((wide, fine)), *arms)] == retained


def test_tubes_are_in_order_in_the_poses_too(monkeypatch: pytest.MonkeyPatch) -> None:
    for gap, retained in ((0.0, True), (-1e-3, False)):
        monkeypatch.setattr(verify, "worst_order", lambda order, tubes, positions, gap=gap: (gap, "in words"))
        checks = verify.verify(program_of(ordered=True), ROBOT, np.zeros(0), (arm(), arm())).checks
        assert [check.satisfied for check in checks] == [retained]


def test_snaps_are_counted_in_whole_turns_forth_and_back(monkeypatch: pytest.MonkeyPatch) -> None:
    paths: list[Any] = []

    def follow(robot: Any, way: Any, shift: Any) -> Any:
        paths.append(way)
        return SimpleNamespace(snaps=[0.3, 0.6] if len(paths) != 2 else [])

    monkeypatch.setattr(verify, "follow", follow)
    assert verify.count_snaps(ROBOT, 4) == (6, 3)
    for way in paths:
        turn = (way[2] - way[1]) / (2 * np.pi)
        assert np.abs(turn[0]) == pytest.approx(1.0)
        assert turn[1] == 0
        assert (way[0], way[1]) == (pytest.approx(way[4]), pytest.approx(way[3]))


def test_a_deployment_is_off_by_the_length_of_each_gap(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(requirements, "deviations", lambda *_: ca.DM([3e-3, 4e-3, 0.0, 0.0, 0.0, 7e-3]))
    requested: Any = SimpleNamespace(poses=())
    left = np.array(requirements.Deployment(6e-3).expression(requested)).ravel()
    assert left == pytest.approx([1e-3, -1e-3], abs=1e-9)


def test_the_limit_of_a_deployment_is_relaxed_upwards() -> None:
    eased = requirements.Deployment(6e-3).relaxed(1e-3)
    assert eased is not None
    assert eased.limit == pytest.approx(7e-3)


@pytest.mark.parametrize("promised", [None, 0.5])
def test_translations_of_a_box_are_added_where_less_than_the_floor_or_the_promise_is_certified(
    promised: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = SnapFree(0.2, box=((0.0, 0.0), (0.01, 0.01)), curvature_error=0.1)
    auxiliary = () if promised is None else ("margin",)
    layout = SimpleNamespace(auxiliary=auxiliary, column=lambda name: 0, certified=())
    program: Any = SimpleNamespace(added=Added(), layout=layout, task=SimpleNamespace(requirements=(one,)))
    monkeypatch.setattr(exchange, "robot_at", lambda *_: ROBOT)
    for short, added in ((0.9e-4, ()), (1.1e-4, ((0.01, 0.0),))):
        smallest = max(one.required_margin, promised or 0.0) - short
        monkeypatch.setattr(exchange, "worst_in_box", lambda *_, smallest=smallest: (smallest, (0.01, 0.0)))
        assert exchange.worst_cases(program, np.array([promised or 0.0])).added.translations == added


UNEQUAL = nested((0.01, 0.05, 3.0), (0.01, 0.04, 5.0))


def arms(*translations: list[float]) -> Any:
    return tuple(SimpleNamespace(translations=np.array(each)) for each in translations)


@pytest.mark.parametrize(
    ("make", "limit", "sign"),
    [
        (lambda limit: Length("curved_length", 0, limit), 0.05, 1),
        (lambda limit: Length("curved_length", 1, limit, least=True), 0.04, -1),
        (lambda limit: Wall(limit), 1e-4, -1),
        (lambda limit: Nesting(limit), 1e-4, -1),
        (lambda limit: Stroke(limit), 0.03, 1),
        (lambda limit: Strain((limit,), in_poses=False), max(tube.straightened_strain for tube in UNEQUAL.tubes), 1),
    ],
    ids=["length", "least length", "wall", "nesting", "stroke", "strain"],
)
def test_a_promise_about_tubes_is_kept_up_to_its_limit(make: Any, limit: float, sign: int) -> None:
    """The carriages travel 30 mm and 10 mm."""
    moved = arms([0.0, 0.0], [-0.03, -0.01])
    for beyond, retained in ((2e-5, True), (-2e-5, False)):
        assert checks_of(make(limit * (1 + sign * beyond)), *moved, robot=UNEQUAL)[0].satisfied == retained


def test_the_room_of_an_arm_is_that_of_its_closest_place_less_the_tube_that_is_there() -> None:
    wall, radius = HalfSpace((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)), [tube.outer_diameter / 2 for tube in UNEQUAL.tubes]
    for heights, room in (([1e-3, 9e-3, 3e-3], 3e-3 - radius[0]), ([1e-3, 3e-3, 3.1e-3], 3e-3 - radius[1])):
        arm: Any = SimpleNamespace(
            tube_end=np.array([0.05, 0.02]),
            arc_length=np.array([0.0, 0.02, 0.03]),
            position=np.array([[0.0, 0.0, height] for height in heights]),
        )
        assert verify.arm_distance(wall, UNEQUAL, arm) == pytest.approx(room, rel=1e-12)


def test_the_strain_of_several_poses_is_the_largest_of_each() -> None:
    one = Strain((0.01,), straightened=False)
    poses = [forward_kinematics(UNEQUAL, angles) for angles in ([np.pi, 0.0], [0.0, 0.0])]
    each = [verify.largest_strain(one, UNEQUAL, (pose,)) for pose in poses]
    assert each[0].max() > 1.5 * each[1].max()
    assert verify.largest_strain(one, UNEQUAL, tuple(poses)) == pytest.approx(np.max(each, axis=0), rel=1e-12)


def test_an_own_requirement_is_kept_to_a_millionth_of_its_step(monkeypatch: pytest.MonkeyPatch) -> None:
    one: Any = SimpleNamespace(
        expression=None, description="own", is_upper_bound=False, limit=1.0, factor=1.0, unit="", size=2.0
    )
    for left, retained in ((-1.9e-6, True), (-2.1e-6, False)):
        monkeypatch.setattr(verify, "recorded", lambda *_, left=left: lambda look: np.array([0.5, left]))
        assert verify.check_custom(one, UNEQUAL, ()).satisfied == retained


def test_a_stroke_force_is_that_at_which_the_arm_buckles(monkeypatch: pytest.MonkeyPatch) -> None:
    arm: Any = SimpleNamespace(rotations=None, translations=None)
    for result, force in ((SimpleNamespace(factor=0.3), 0.3), (None, verify.STRONGEST)):
        monkeypatch.setattr(verify, "find_stroke_force", lambda *_, result=result, **__: result)
        assert verify.numbers_of(UNEQUAL, [arm])(Quantity("stroke_force", 0)).tolist() == [force]


@pytest.mark.parametrize("rising", [True, False])
def test_the_strain_counts_the_arm_on_both_sides_of_a_breakpoint(rising: bool) -> None:
    """The precurvature of the outer tube rises to 20/m where it ends, or begins with 20/m and falls.

    The straight inner tube is bent most on one side of that breakpoint. In one plane it has k2 20 / (k1 + k2) there.
    """
    law = (lambda s: 20.0 * s / 0.04) if rising else (lambda s: 20.0 * (1 - s / 0.04))
    outer = Tube.of_pieces(1.3e-3, 1.1e-3, [Piece(0.02, 0.0), Piece(0.04, law)], straight_length=0.01)
    inner = Tube(1.0e-3, 0.8e-3, 0.01, 0.08, 0.0)
    robot = ConcentricRobot((inner, outer))
    one, (k1, k2) = Strain((0.01,), straightened=False), (tube.bending_stiffness for tube in robot.tubes)
    arm = forward_kinematics(robot, [0.0, 0.0])
    exact = inner.outer_diameter / 2 * 20.0 * k2 / (k1 + k2)
    assert verify.largest_strain(one, robot, (arm,))[0] == pytest.approx(exact, rel=1e-6)
