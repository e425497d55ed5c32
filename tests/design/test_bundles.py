"""Designs of eccentric robots: derivatives, optima, and what is checked again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.equilibrium.test_bundle import end_forces, shoot, tube
from tubeopt import (
    BundleRobot,
    DesignTask,
    EccentricRobot,
    Load,
    find_stroke_force,
    load_robot,
    optimize_design,
    snap_free_certificate,
)
from tubeopt.block.quantities import Quantity
from tubeopt.bodies import Sphere
from tubeopt.design import (
    Bore,
    Channel,
    Deflection,
    Free,
    Girth,
    Objective,
    Poses,
    Reach,
    SnapFree,
    SnapFreeInUse,
    StockTube,
    Strain,
    StrokeForce,
    Target,
    Tolerances,
    Wall,
    choose_from_stock,
    pareto_front,
    tolerance_analysis,
)
from tubeopt.design.evaluation import evaluated_at
from tubeopt.design.program import compile_task
from tubeopt.design.state import DesignState
from tubeopt.equilibrium.kinematics import point_of, unsolved
from tubeopt.errors import InputError
from tubeopt.stability.stroke import stroke_slopes
from tubeopt.typing import Array

ROOT = Path(__file__).resolve().parents[2]
THREE = (0, 1, 2)
EQUAL = (
    Free("curvature", THREE, 4.0, 30.0, "equal"),
    Free("outer_diameter", THREE, 0.8e-3, 1.92e-3, "equal"),
    Free("inner_diameter", THREE, 0.5e-3, 1.7e-3, "equal"),
    Free("offset", THREE, 1e-3, 2e-3, "equal"),
)


def thesis() -> EccentricRobot:
    robot = load_robot("thesis_etr")
    assert isinstance(robot, EccentricRobot)
    return robot


def posed(*degrees: Any, shift: float = 0.0) -> Poses:
    rows = [tuple(row) for row in np.radians(degrees).tolist()]
    return Poses(tuple(rows), ((shift,) * len(rows[0]),) * len(rows))


def test_derivatives_of_every_quantity_are_those_of_solved_designs() -> None:
    free = (
        *EQUAL,
        Free("curved_length", THREE, 0.05, 0.12),
        Free("angle", (1,), 1.9, 2.3),
        Free("sheath_stiffness", (), 0.0, 0.01),
        Free("sheath_diameter", (), 3e-3, 6e-3),
        Free("sheath_rigid_length", (), 0.0, 0.05),
    )
    task = DesignTask(thesis(), free, (posed([30, 100, -20], [0, 60, -60], shift=-0.01),))
    program = compile_task(task)
    x = program.layout.space.start.copy()
    x[3:] = 1.45e-3, 0.094, 0.09, 0.098, 2.05, 0.004, 4.9e-3, 0.02
    state = DesignState(program.layout, x)
    force, moment = Load((0.02, 0.01, -0.01)), Load((0.02, 0.01, -0.01), (0.001, 0.0, 0.002))
    body = Sphere((0.02, -0.02, 0.05), 0.01)
    quantities = [
        *(Quantity(name, 0) for name in ("tip_position", "tip_direction", "margin", "jacobian")),
        *(Quantity("curvature", 0, (fraction,)) for fraction in (0.5, 0.97)),
        *(Quantity("strain", pose, (tube,)) for pose in (0, 1) for tube in THREE),
        Quantity("position", 0, (0.4,)),
        Quantity("clearance", 0, (body,)),
        Quantity("deflection", 0, (force,)),
        *(Quantity("margin_under", 0, (load,)) for load in (force, moment)),
        *(Quantity(name) for name in ("channel", "sheath_diameter", "offset", "angle", "bending_stiffness")),
    ]
    known = {quantity: state.quantity(quantity) for quantity in quantities}
    for k, scale in enumerate(program.scale):
        step = 1e-5 * scale * np.eye(len(x))[k]
        ahead, behind = (DesignState(program.layout, x + way * step, dict(state.guesses)) for way in (1, -1))
        for quantity, (value, slope) in known.items():
            change = (np.ravel(ahead.quantity(quantity)[0]) - np.ravel(behind.quantity(quantity)[0])) / 2e-5
            expected = scale * slope.reshape(value.size, -1)[:, k]
            assert np.abs(change - expected).max() < 2e-8, (quantity.name, program.layout.space.names[k])


def test_rows_of_the_fit_have_their_derivatives() -> None:
    program = compile_task(DesignTask(thesis(), (*EQUAL, Free("angle", (1,), 1.9, 2.3))))
    x = program.layout.space.start.copy()
    x[3] *= 1.1
    values, slopes = evaluated_at(program, x).fixed
    # Three pairs of tubes side by side, and curvature and sheath of each.
    assert (values >= -1e-6).all()
    for k, scale in enumerate(program.scale):
        step = 1e-6 * scale * np.eye(len(x))[k]
        ahead, behind = (evaluated_at(program, x + way * step).fixed[0] for way in (1, -1))
        assert (ahead - behind) / 2e-6 == pytest.approx(scale * slopes[:, k], abs=1e-6)


@pytest.fixture(scope="module")
def tight() -> Any:
    """Tightest turn with a channel of 1.2 mm in the sheath of the thesis."""
    requirements = (
        posed([0, 0, 0], [180, 0, 0]),
        SnapFreeInUse(0.05, paths=False),
        Channel(1.2e-3),
        Girth(4.14e-3),
        Bore(0.6e-3),
        Wall(0.1e-3),
        Strain((0.02,)),
        Deflection(6e-3, (0.2, 0.0, 0.0)),
    )
    return optimize_design(DesignTask(thesis(), EQUAL, requirements, Objective("turning_radius")))


def test_a_turn_is_tighter_with_a_channel(tight: Any) -> None:
    robot = tight.robot
    assert isinstance(robot, BundleRobot)
    assert tight.verification.satisfied
    assert tight.certificate is None
    # The robot of the thesis has 120 mm, and no room between its tubes.
    assert 0.06 < tight.objective < 0.08
    tube, offset = robot.tubes[0], robot.offset[0]
    # The largest free circle lies between two tubes and the sheath, not in the middle.
    across, pocket = offset * 0.5, 4.14e-3 / 2 - 0.6e-3
    apart = np.hypot(offset * np.sin(np.pi / 3), pocket - across)
    assert apart == pytest.approx(tube.outer_diameter / 2 + 0.6e-3, rel=1e-5)
    assert 2 * offset - tube.outer_diameter < 1.2e-3
    assert 2 * offset + tube.outer_diameter == pytest.approx(4.14e-3, rel=1e-5)
    bent = robot.fk(np.zeros(3), load=Load((0.2, 0.0, 0.0)))
    straight = robot.fk([np.pi, 0, 0], load=Load((0.2, 0.0, 0.0)))
    moved = [np.linalg.norm(e.tip_position - robot.fk(e.rotations).tip_position) for e in (bent, straight)]
    assert max(moved) == pytest.approx(6e-3, rel=1e-4)
    # All bent to one side, the tubes of one length have the curvature of one.
    assert 1 / np.linalg.norm(bent.robot.fk(np.zeros(3)).curvature[3]) == pytest.approx(tight.objective, rel=1e-4)


def test_a_design_is_an_equilibrium_of_integrated_forces(tight: Any) -> None:
    """Shooting knows nothing of the energy, nor of its derivatives."""
    pose = tight.robot.fk(np.radians([20.0, 75.0, -110.0]))
    violated, tip = shoot(tight.robot, pose, end_forces(point_of(pose).state), np.zeros(3))
    # Newtons; axial forces are 1 N.
    assert np.abs(violated).max() < 2e-7
    assert np.abs(tip - pose.tip_position).max() < 1e-9


def test_fronts_and_tolerances_of_bundles() -> None:
    turn = posed([0, 0, 0], [180, 0, 0])
    free = (Free("curvature", THREE, 4.0, 14.0, "equal"),)
    task = DesignTask(thesis(), free, (turn, SnapFreeInUse(0.05, paths=False)), Objective("turning_radius"))
    front = pareto_front(task, [0.1, 0.3])
    tighter, safer = front.points
    assert tighter.objective < safer.objective
    for point in front.points:
        assert point.robot.fk([np.pi, 0, 0]).margin == pytest.approx(point.margin, abs=1e-5)
    poses = [(np.radians(row), np.zeros(3)) for row in ([0.0, 0, 0], [180, 0, 0])]
    spread = tolerance_analysis(safer.robot, Tolerances(curvature=0.03), poses=poses, samples=8)
    assert spread.snap_free == 1.0
    # The margin falls where the curvature is larger: by chance both occur.
    assert spread.certificate.min() < 0.3 < spread.certificate.max()
    assert 1e-4 < spread.spread[0] < 1e-2
    with pytest.raises(InputError, match="poses is empty"):
        tolerance_analysis(safer.robot, Tolerances(), samples=2)


def test_certificates_of_bundles_are_required() -> None:
    # The ends keep their order by what bending changes of the lengths: both limits hold the design.
    lengths = Free("curved_length", (1, 2), 0.087, 0.094)
    task = DesignTask(thesis(), (*EQUAL[:1], lengths), (posed([0, 0, 0]), SnapFree(0.3)), Objective("turning_radius"))
    front = pareto_front(task, [0.3, 0.6])
    tighter, safer = front.points
    assert tighter.objective < 0.95 * safer.objective < 0.95 * 0.12
    for point in front.points:
        assert snap_free_certificate(point.robot) == pytest.approx(point.margin, abs=1e-5)
        assert np.ptp([tube.curved_length for tube in point.robot.tubes]) > 4e-3
    made = tolerance_analysis(safer.robot, Tolerances(curvature=0.03), translations=[[0, 0, 0]], samples=8)
    assert made.certificate.min() < 0.6 < made.certificate.max()
    assert np.isinf(
        tolerance_analysis(thesis().bundle(), Tolerances(), translations=[[0, 0, 0]], samples=2).certificate
    ).all()


def test_rigid_parts_of_the_sheath_are_free() -> None:
    free = (*EQUAL[:1], Free("curved_length", (1, 2), 0.087, 0.094), Free("sheath_rigid_length", (), 0.0, 0.03))
    program = compile_task(DesignTask(thesis(), free, (SnapFree(0.3),)))
    x = program.layout.space.start.copy()
    x[:4] = 7.0, 0.091, 0.088, 0.01
    value, slope = DesignState(program.layout, x).certificate_at((0.0, 0.0, 0.0))
    assert value > 0.3
    for k, step in enumerate((1e-4, 1e-7, 1e-7, 1e-7)):
        ahead, behind = (
            DesignState(program.layout, x + way * step * np.eye(len(x))[k]).certificate_at((0.0, 0.0, 0.0))[0]
            for way in (1, -1)
        )
        assert (ahead - behind) / (2 * step) == pytest.approx(slope[k], rel=1e-4, abs=1e-6)
    assert abs(slope[3]) > 0.1
    robot = replace(thesis().bundle(), sheath_rigid_from=0.09)
    tip = Free("sheath_rigid_from", (), 0.07, 0.09)
    q = DesignState((program := compile_task(DesignTask(robot, (tip,)))).layout, program.layout.space.start.copy())
    assert q.quantity(Quantity("sheath_rigid_from"))[0] == pytest.approx(0.09)
    with pytest.raises(InputError, match="there is a proof for flexible tips only: require SnapFreeInUse"):
        DesignTask(robot, EQUAL[:1], (SnapFree(0.3),))
    with pytest.raises(InputError, match="needs a sheath with a rigid tip"):
        DesignTask(thesis(), (tip,))


@pytest.mark.parametrize(("kind", "degrees"), [("fold", (0, 60, -60)), ("ends", (180, 0, 0))])
def test_stroke_forces_scale_as_stiffness_over_length_squared(kind: str, degrees: tuple[float, ...]) -> None:
    """Euler's theorem of homogeneous functions, for the derivatives by all stiffnesses, and by all lengths."""
    robot = load_robot(ROOT / "configs" / "bundles" / "steerable_sheath.yaml")
    assert isinstance(robot, BundleRobot)
    names = ("bending_stiffness", "torsional_stiffness", "straight_length", "curved_length", "curvature")
    found = stroke_slopes(robot.fk(np.radians(degrees)), (*names, "offset", "sheath_stiffness"))
    assert found is not None
    force, slopes = found
    sizes = np.array([[getattr(each, name) for each in robot.tubes] for name in names])
    by_size = [*(sizes * slopes[:15].reshape(5, 3)).sum(1), np.array(robot.offset) @ slopes[15:18]]
    by_size.append(robot.sheath_stiffness * slopes[18])
    assert by_size[0] + by_size[1] + by_size[6] == pytest.approx(force, rel=1e-6 if kind == "fold" else 1e-3)
    lengths = by_size[2] + by_size[3] - by_size[4] + by_size[5]
    assert lengths == pytest.approx(-2 * force, rel=1e-6 if kind == "fold" else 1e-3)


@pytest.mark.parametrize(
    ("kind", "degrees"), [("fold", (0, 60, -60)), ("ends", (180, 0, 0)), ("bifurcation", (0, 0, 0))]
)
def test_stroke_forces_have_their_derivatives(kind: str, degrees: tuple[float, ...]) -> None:
    """At a fold, where ends of tubes separate, and where an arm in a plane buckles out of it."""
    robot = replace(load_robot(ROOT / "configs" / "bundles" / "steerable_sheath.yaml"), sheath_diameter=None)
    if kind == "bifurcation":
        tubes = tube(0.02, 0.015, 6.0, 0.02, 0.2), tube(0.03, 0.02, 4.0, 0.02, 0.17), tube(0.025, 0.02, 8.0, 0.02, 0.12)
        robot = BundleRobot(tubes, (0.004, 0.004, 0.0), (np.pi / 2, -np.pi / 2, np.pi / 2))
    free = (
        Free("curvature", (0,), 1.0, 30.0),
        Free("curved_length", (2,), 0.01, 0.3),
        Free("offset", (0,), 1e-3, 5e-3),
    )
    layout = compile_task(DesignTask(robot, free, (posed(degrees), StrokeForce(0.1)))).layout
    x = layout.space.start.copy()
    value, slope = DesignState(layout, x).quantity(Quantity("stroke_force", 0))
    limit = find_stroke_force(robot, np.radians(degrees))
    assert limit is not None
    assert (limit.kind, limit.factor) == (kind, pytest.approx(float(value[0]), rel=1e-7))
    step = 3e-5 * x * np.random.default_rng(0).uniform(0.5, 1.0, len(x))
    ahead, behind = (DesignState(layout, x + way * step).quantity(Quantity("stroke_force", 0))[0][0] for way in (1, -1))
    assert float((slope @ step)[0]) == pytest.approx((ahead - behind) / 2, rel=1e-3)


def determinant_at(pose: Any, force: Array) -> float:
    """Determinant of the integrated equations at an equilibrium, by the torsion and the axial forces at the plate."""
    robot, n = pose.robot, pose.robot.n_tubes
    member, x = unsolved(pose)
    origin = np.concatenate([pose.torsion[:, 0] / (1 + member.problem.bundle.levers @ pose.curvature[0])] * 2)
    origin[n:] = end_forces(member.at(x))

    def violated(z: Array) -> Array:
        at = SimpleNamespace(**{name: getattr(pose, name) for name in ("rotations", "translations", "tube_end")})
        at.tip_position, at.torsion, at.curvature = pose.tip_position + z[2 * n :], z[:n, None], np.zeros((1, 2))
        left, tip = shoot(robot, at, z[n : 2 * n], force, 1e-10)
        return np.append(left.ravel(), tip - at.tip_position)

    origin, scale = np.append(origin, np.zeros(3)), np.append([0.3] * n + [0.1] * n, [0.01] * 3)
    slope = [(violated(origin + e) - violated(origin - e)) / 2e-5 for e in 1e-5 * np.diag(scale)]
    return float(np.linalg.det(np.column_stack(slope)))


def test_designs_withstand_a_push() -> None:
    """Two tubes in a plane buckle out of it. The tightest turn bears the push of 4 N, and not 0.1 % more."""
    tubes = tube(0.02, 0.015, 6.0, 0.02, 0.2), tube(0.03, 0.02, 4.0, 0.02, 0.17)
    robot = BundleRobot(tubes, (0.004, 0.004), (np.pi / 2, -np.pi / 2), sheath_stiffness=0.005)
    free, needs = Free("curvature", (0,), 5.0, 12.0), (posed([0, 0]), StrokeForce(4.0))
    solution = optimize_design(DesignTask(robot, (free,), needs, Objective("turning_radius")))
    assert solution.verification.satisfied
    limit = find_stroke_force(solution.robot, [0.0, 0.0])
    assert limit is not None
    assert limit.factor == pytest.approx(4.0, abs=1e-5)
    # The determinant of the integrated equations falls to 0 there.
    first, parts, found = solution.robot.fk([0.0, 0.0]), np.array([0.999, 0.9999]), []
    for part in parts:
        force = -4.0 * part * first.tip_rotation[:, 2]
        found.append(determinant_at(first.robot.fk([0.0, 0.0], load=Load(tuple(force))), force))
    assert parts[1] + np.diff(parts)[0] * found[1] / (found[0] - found[1]) == pytest.approx(1.0, abs=1e-5)


def test_carriages_reach_targets_together() -> None:
    robot = load_robot(ROOT / "configs" / "bundles" / "steerable_sheath.yaml")
    known = robot.fk(np.radians([0, 40, 0]), np.array([0.0, -0.01, 0.0]))
    target = known.tip_position + np.array([4e-3, 0.0, 3e-3])
    free = (Free("curvature", (0, 1), 5.0, 25.0), Free("sheath_stiffness", (), 0.001, 0.01))
    solution = optimize_design(DesignTask(robot, free, (Reach((Target(tuple(target), 2e-4),)),)))
    assert solution.verification.satisfied
    assert np.linalg.norm(solution.equilibria[0].tip_position - target) < 2e-4


@pytest.mark.parametrize(
    ("requirement", "message"),
    [
        (SnapFree(0.05, max_force=0.1), "SnapFree of an eccentric robot has a force, a box or tube errors"),
        (SnapFree(0.05, curvature_error=0.01), "require a larger margin, and check tolerances"),
        (SnapFree(0.05, ((0.0, 0.0, -0.01),)), "must be equal, since they share a carriage"),
        (SnapFreeInUse(0.05, deployed=True), "tubes of this robot share carriages"),
        (Poses(((0.0, 0.0, 0.0),), ((0.0, 0.0, -0.01),)), "must be equal, since they share a carriage"),
    ],
)
def test_what_designs_of_bundles_do_not_support_is_named(requirement: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        DesignTask(thesis(), EQUAL, (requirement, *(() if isinstance(requirement, Poses) else (posed([0, 0, 0]),))))


def test_wrong_dimensions_are_named() -> None:
    pair = load_robot("two_tube")
    with pytest.raises(InputError, match="free offset is a dimension of eccentric robots"):
        DesignTask(pair, (Free("offset", (0,), 0.0, 1e-3),))
    with pytest.raises(InputError, match="a sheath has no tubes"):
        Free("sheath_stiffness", (0,), 0.0, 1.0)
    with pytest.raises(InputError, match="is a dimension of nested tubes"):
        DesignTask(thesis(), (Free("piece_twist", THREE, -1.0, 1.0),))
    segments = load_robot(ROOT / "configs" / "robots" / "example_three_segment_etr.yaml")
    with pytest.raises(InputError, match="offset of tubes 1, 4, 7, which are nested, is not free together"):
        DesignTask(segments, (Free("offset", (0, 1, 2), 1e-3, 2e-3, "equal"),))


def test_tubes_from_stock_fit_side_by_side() -> None:
    """Three sizes: one is too wide for the offsets; the stiffer of the others bends as tightly, within its strain."""
    robot = thesis().bundle()
    sizes = [StockTube("thin", 1.2e-3, 0.9e-3), StockTube("wide", 1.9e-3, 1.6e-3), StockTube("too wide", 2.4e-3, 2e-3)]
    task = DesignTask(
        robot,
        (Free("curvature", THREE, 4.0, 30.0, "equal"),),
        (posed([0, 0, 0]), Strain(0.02)),
        (Objective("turning_radius"),),
    )
    choice = choose_from_stock(task, sizes)
    assert len(choice.candidates) == 2
    best = choice.best
    assert best is not None
    assert [size.name for size in best.sizes] == ["thin"] * 3
    assert isinstance(best.robot, BundleRobot)
    assert best.robot.offset == robot.offset
    with pytest.raises(InputError, match="no tubes in stock fit at the offsets"):
        choose_from_stock(task, sizes[2:])
