"""Bundle robots against shooting of forces and moments, published values, concentric robots and differences."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from tubeopt import (
    BundleRobot,
    ConcentricRobot,
    EccentricRobot,
    Equilibrium,
    Friction,
    Load,
    Measurements,
    SegmentedEccentricRobot,
    Tube,
    estimate_force,
    find_load_limit,
    find_snap,
    find_stroke_force,
    follow,
    forward_kinematics,
    friction_band,
    load_equilibrium,
    load_robot,
    plan_trajectory,
    snap_free_certificate,
    stability_map,
    verify_trajectory,
)
from tubeopt.block.transcription.bundle import BundleState, length_forces
from tubeopt.block.transcription.mesh import make_mesh
from tubeopt.block.transcription.reduced import reduce
from tubeopt.bodies.obstacles import Sphere
from tubeopt.control.command import Command
from tubeopt.control.servo import Servo
from tubeopt.equilibrium.directions import PARAMETERS
from tubeopt.equilibrium.friction import to_held_equilibrium
from tubeopt.equilibrium.jacobian import derivatives_of, shifted
from tubeopt.equilibrium.kinematics import point_of, to_equilibrium, unsolved
from tubeopt.equilibrium.member import Point
from tubeopt.equilibrium.problem import Discretisation
from tubeopt.errors import ImplausibleWarning, InputError
from tubeopt.inverse.joints import joint_space
from tubeopt.inverse.posture import start_posture
from tubeopt.planning.proof import ProofStatus
from tubeopt.planning.question import PlanOptions
from tubeopt.robots.assembly import LENGTH_ROUND_OFF
from tubeopt.robots.eccentric import channel_between, free_channel
from tubeopt.robots.file import robot_from_dict, robot_to_dict
from tubeopt.show.plan_report import TrajectoryReport
from tubeopt.stability.friction_path import segment_with_friction, start_with_friction
from tubeopt.typing import Array
from tubeopt.validation.fitting import FitOptions, fit

ROOT = Path(__file__).resolve().parents[2]
THIRDS = (0.0, 2 * np.pi / 3, -2 * np.pi / 3)


def bundle_of_thesis() -> BundleRobot:
    """The three tubes of the thesis' eccentric robot, each with its own length."""
    robot = load_robot("thesis_etr")
    assert isinstance(robot, EccentricRobot)
    return robot.bundle()


def tube(kb: float, kt: float, curvature: float, straight: float, curved: float) -> Tube:
    """Tube with given stiffnesses."""
    soft = Tube(2e-3, 1.6e-3, straight, curved, curvature=curvature)
    return soft.resized("bending_stiffness", kb).resized("torsional_stiffness", kt)


def random_bundle(rng: np.random.Generator, tightest: float = 0.15) -> tuple[BundleRobot, Array, Array]:
    """Robot of two to four unequal tubes, with rotations, and translations that leave all tubes curved at the plate."""
    n = int(rng.integers(2, 5))
    offset = rng.uniform(2e-3, 6e-3, n)
    angle = 2 * np.pi * (np.arange(n) + rng.uniform(-0.1, 0.1, n)) / n
    straight = rng.uniform(0.0, 0.05, n) * rng.integers(0, 2)
    factor, length = rng.uniform(0.5, 2.0, n), 0.09 * rng.uniform(0.8, 1.0, n)
    curvature = np.minimum(rng.uniform(0.0, 25 * tightest / 0.15, n), tightest / offset) * (rng.random(n) > 0.2)
    tubes = [tube(0.02 * f, 0.015 * f, k, s, c) for f, k, s, c in zip(factor, curvature, straight, length, strict=True)]
    robot = BundleRobot(tuple(tubes), tuple(offset), tuple(angle), sheath_stiffness=0.004 * float(rng.random() < 0.5))
    return robot, rng.uniform(-2.0, 2.0, n), -straight * rng.uniform(0.0, 0.5, n)


def shoot(
    robot: BundleRobot,
    pose: Any,
    constant: Array,
    force: Array,
    tolerance: float = 1e-12,
    rubs: Array | float = 0.0,
) -> tuple[Array, Array]:
    """Arm by integration from the plate, with the torsion of `pose` there; what is violated at the ends, and the tip.

    Each tube in its frictionless channel bends, twists and pulls:  kt w' = kb kappa (u_x sin theta - u_y cos theta) and
    N = kb (kappa^2 - |v|^2) / 2 - kt w^2 / 2 - lambda. At its end w = 0, and sliding its end along gains no energy:
    lambda g = psi g + the energy that the other tubes lose, since their curvature jumps there.

    A channel that resists the turn of a tube by `rubs` (n,) per length adds that to kt w', and to N' by w times it:
    V = t x M' carries no couple along t, so that N_t' = -M'.v as before. Then lambda' = -w rubs from `constant` on.
    """
    n, alpha, shift = robot.n_tubes, pose.rotations, pose.translations
    rubbed = np.zeros(n) + rubs
    names = ("bending_stiffness", "torsional_stiffness", "curvature", "straight_length", "length")
    kb, kt, kappa, straight, whole = (np.array([float(getattr(t, name)) for t in robot.tubes]) for name in names)
    phi, d, own = np.array(robot.angle), np.array(robot.offset), whole - straight + shift
    lever = d[:, None] * np.column_stack([np.sin(phi), -np.cos(phi)])

    def strain(u: Array, theta: Array) -> Array:
        return u / (1 + lever @ u)[:, None] - kappa[:, None] * np.column_stack([np.cos(theta), np.sin(theta)])

    def potential(u: Array, theta: Array, w: Array, moment: Array, there: Array, constant: Array) -> float:
        """Energy per length less the parts p theta' and lambda g, whose least value has the curvature."""
        psi = kb * (strain(u, theta) ** 2).sum(1) / 2 - kt * w**2 / 2 - constant
        return float(there @ (psi * (1 + lever @ u)) + robot.sheath_stiffness * u @ u / 2 - moment @ u)

    def curvature(theta: Array, w: Array, moment: Array, there: Array, constant: Array) -> Array:
        def balance(u: Array) -> Array:
            axial = kb * (kappa**2 - ((u / (1 + lever @ u)[:, None]) ** 2).sum(1)) / 2 - kt * w**2 / 2 - constant
            bend = kb[:, None] * strain(u, theta)
            return np.asarray(there @ (bend + axial[:, None] * lever) + robot.sheath_stiffness * u - moment)

        u = np.zeros(2)
        for _ in range(8):
            slope = np.column_stack([(balance(u + e) - balance(u - e)) / 2e-4 for e in 1e-4 * np.eye(2)])
            u = u - np.linalg.solve(slope, balance(u))
        return u

    def moment_at(y: Array) -> Array:
        return (y[3 * n + 3 : -n].reshape(3, 3).T @ np.cross(pose.tip_position - y[3 * n : 3 * n + 3], force))[:2]

    def rates(y: Array, there: Array) -> Array:
        theta, w, frame, held = y[:n], y[n : 2 * n], y[3 * n + 3 : -n].reshape(3, 3), y[-n:]
        u = curvature(theta, w, moment_at(y), there, held)
        g = 1 + lever @ u
        spin = np.array([[0, 0, u[1]], [0, 0, -u[0]], [-u[1], u[0], 0.0]])
        twist = (kb * kappa * (u[0] * np.sin(theta) - u[1] * np.cos(theta)) + g * rubbed) / kt
        along = [frame[:, 2], (frame @ spin).ravel(), -rubbed * w * g * there]
        return np.concatenate([g * w * there, twist * there, g, *along])

    w0 = pose.torsion[:, 0] / (1 + lever @ pose.curvature[0])
    y = np.concatenate([alpha + (straight - shift) * w0, w0, np.zeros(n + 3), np.eye(3).ravel(), constant])
    there, violated = np.ones(n), np.zeros((2, n))
    s = 0.0
    for i in np.argsort(pose.tube_end):
        end = lambda _, y, i=i: y[2 * n + i] - own[i]  # noqa: E731
        end.terminal = True
        flow = solve_ivp(
            lambda _, y, on=there: rates(y, on),
            (s, s + 1.0),
            y,
            "DOP853",
            events=end,
            rtol=tolerance,
            atol=tolerance / 10,
        )
        s, y = float(flow.t[-1]), flow.y[:, -1]
        theta, w, moment, after, held = y[:n], y[n : 2 * n], moment_at(y), there * (np.arange(n) != i), y[-n:]
        u = curvature(theta, w, moment, there, held)
        rest = potential(u, theta, w, moment, after, held)
        if after.any():
            rest -= potential(curvature(theta, w, moment, after, held), theta, w, moment, after, held)
        else:
            rest -= float(y[3 * n + 3 : -n].reshape(3, 3)[:, 2] @ force)  # the tip moves with the last end
        g = 1 + lever[i] @ u
        psi = kb[i] * (strain(u, theta)[i] ** 2).sum() / 2 + kt[i] * w[i] ** 2 / 2
        violated[:, i] = kt[i] * w[i], held[i] - psi - rest / g
        there = after
    return violated, y[3 * n : 3 * n + 3]


def end_forces(state: BundleState) -> Array:
    """Derivatives (n,) lambda of the energy by the own lengths of the tubes, N."""
    out = np.zeros(state.problem.n)
    for boundary, value in zip(state.problem.order, length_forces(state).tolist(), strict=True):
        out[list(boundary.ends)] = value
    return out


def compared(seed: int, tightest: float = 0.15) -> Array | None:
    """Largest violation of the integrated equations, and of the tip; None where ends of tubes stay together."""
    rng = np.random.default_rng(seed)
    robot, alpha, shift = random_bundle(rng, tightest)
    force = rng.uniform(-0.2, 0.2, 3) * (seed % 2)
    pose = robot.fk(alpha, shift, load=Load(tuple(force)) if seed % 2 else None)
    state = point_of(pose).state
    if state.problem.held:
        return None
    constant = end_forces(state)
    violated, tip = shoot(robot, pose, constant, force)
    return np.array([np.abs(violated).max(), np.abs(tip - pose.tip_position).max()])


def nested_tubes(seed: int, tightest: float) -> tuple[BundleRobot, ConcentricRobot, Array, Array]:
    """Tubes of a random bundle, nested: as a bundle without offsets, as a concentric robot; rotations, translations."""
    drawn, alpha, shift = random_bundle(np.random.default_rng(seed), tightest)
    inner_to_outer, tubes, n = np.argsort([-each.length for each in drawn.tubes]), [], drawn.n_tubes
    for k, i in enumerate(inner_to_outer):
        each = drawn.tubes[i]
        like = Tube(1e-3 + 2e-4 * k, 0.9e-3 + 2e-4 * k, each.straight_length, each.curved_length, each.curvature)
        like = like.resized("bending_stiffness", float(each.bending_stiffness))
        tubes.append(like.resized("torsional_stiffness", float(each.torsional_stiffness)))
    own = BundleRobot(tuple(tubes), (0.0,) * n, (0.0,) * n)
    return own, ConcentricRobot(tuple(tubes)), alpha[inner_to_outer], shift[inner_to_outer]


def on_elements_of(bundle: Equilibrium, concentric: Equilibrium) -> Equilibrium:
    """Equilibrium of concentric tubes with the elements of a bundle, whose sections all have a length."""
    known, point = point_of(bundle).member.problem, point_of(concentric)
    assembly = point.member.problem.assembly
    count = np.ones(assembly.n_sections, dtype=np.intp)
    count[assembly.length > LENGTH_ROUND_OFF] = known.count
    member = replace(point.member, problem=reduce(assembly, make_mesh(assembly, count)))
    return to_equilibrium(Point.solved_near(member, member.transfer(point), "this mesh has none"), "newton")


@pytest.mark.parametrize("seed", range(4))
def test_integrated_forces_and_moments_give_the_same_arm(seed: int) -> None:
    apart = compared(seed)
    assert apart is not None
    assert (apart < [1e-6, 1e-9]).all()


def test_a_hundred_bundles_of_tight_curves_are_those_of_integrated_forces() -> None:
    apart = [each for seed in range(1000, 1100) if (each := compared(seed, 0.2)) is not None]
    assert len(apart) >= 95
    assert (np.max(apart, axis=0) < [1e-4, 1e-7]).all()


# Points of the centreline, mm, by another code; three Kirchhoff rods tied to a sheath are 2e-6 mm from the last.
PUBLISHED = [
    ((0, 60, -60), 94, (0.0003896246, -26.2313415110, 88.8305979550)),
    ((0, 90, -90), 94, (-0.0033954558, -14.3575306616, 92.4746031980)),
    ((30, 100, -20), 94, (15.2207038922, -21.2801179329, 88.8581053521)),
    ((0, 60, -60), 75.2, (0.0026582120, -16.7588649714, 72.6053853638)),
]


@pytest.mark.parametrize(("degrees", "place", "point"), PUBLISHED)
def test_tubes_of_own_length_end_where_rods_do(degrees: Any, place: float, point: Any) -> None:
    pose = bundle_of_thesis().fk(np.radians(degrees))
    found = [1e3 * float(CubicSpline(1e3 * pose.arc_length, row)(place)) for row in pose.position.T]
    assert np.abs(np.array(found) - point).max() < 2e-4  # of the spline
    if degrees == (0, 60, -60):
        assert np.abs(1e3 * pose.tube_end - (93.99797282, 93.43667704, 94.57324920)).max() < 1e-7


def test_the_energy_of_the_robot_of_the_thesis_differs_by_the_ends_of_its_tubes(tmp_path: Path) -> None:
    shipped = yaml.safe_load((ROOT / "configs" / "robots" / "thesis_etr.yaml").read_text())
    (tmp_path / "energy.yaml").write_text(yaml.safe_dump(shipped | {"model": "energy"}))
    robot, thesis = load_robot(tmp_path / "energy.yaml"), load_robot("thesis_etr")
    assert isinstance(robot, BundleRobot)
    for degrees, microns in (((0, 60, -60), 31.6), ((0, 90, -90), 83.8), ((30, 100, -20), 41.4)):
        pose = robot.fk(np.radians(degrees))
        place = CubicSpline(pose.arc_length, pose.position)(0.094)
        apart = np.linalg.norm(place - thesis.fk(np.radians(degrees)).tip_position)
        assert 1e6 * apart == pytest.approx(microns, abs=0.06)
    # One carriage moves the tubes. At home they have no transmission, which they get as they move back.
    jacobian, h = pose.jacobian(), 1e-5
    back = [robot.fk(np.radians(degrees), [-k * h] * 3) for k in (1, 2)]
    for of, slope in (("tip_position", jacobian.position), ("energy", jacobian.energy)):
        here, one, two = (getattr(each, of) for each in (pose, *back))
        assert np.abs((3 * here - 4 * one + two) / (2 * h) - slope[..., 3:].sum(-1)).max() < 1e-6
    with pytest.raises(InputError, match="since they share a carriage"):
        robot.fk(np.radians(degrees), [0.0, 0.0, -0.001])


def test_the_balance_is_far_from_rods_where_offsets_are_a_fifth_of_the_radius() -> None:
    balance = EccentricRobot(tube(0.02, 0.015, 20.0, 0.0, 0.1), 0.01, model="thesis")
    rods, alpha = np.array([-0.6506659, -44.88039498, 58.34198017]), np.radians([0.0, 60.0, -60.0])
    for robot, apart, within in ((balance, 1.371, 2e-3), (balance.bundle(), 0.0, 2e-3)):
        pose = robot.fk(alpha)
        point = [1e3 * float(CubicSpline(1e3 * pose.arc_length, row)(80.0)) for row in pose.position.T]
        assert np.linalg.norm(point - rods) == pytest.approx(apart, abs=within)


@pytest.mark.parametrize(("degrees", "microns"), [((0, 60, -60), 8.03), ((0, 90, -90), 4.21), ((30, 100, -20), 7.60)])
def test_axial_forces_alone_move_tubes_that_end_together_by_little(degrees: Any, microns: float) -> None:
    thesis = load_robot("thesis_etr")
    assert isinstance(thesis, EccentricRobot)
    alpha, kb, kt = np.radians(degrees), float(thesis.tube.bending_stiffness), float(thesis.tube.torsional_stiffness)
    kappa, lever = float(thesis.tube.curvature), thesis.distance * np.column_stack([np.sin(THIRDS), -np.cos(THIRDS)])

    def curvature(theta: Array, w: Array) -> Array:
        def balance(u: Array) -> Array:
            v, e = u / (1 + lever @ u)[:, None], np.column_stack([np.cos(theta), np.sin(theta)])
            axial = kb * (kappa**2 - (v**2).sum(1)) / 2 - kt * w**2 / 2
            return np.asarray((kb * (v - kappa * e) + axial[:, None] * lever).sum(0))

        u = np.zeros(2)
        for _ in range(5):
            slope = np.column_stack([(balance(u + e) - balance(u - e)) / 2e-4 for e in 1e-4 * np.eye(2)])
            u = u - np.linalg.solve(slope, balance(u))
        return u

    def rates(_: float, y: Array) -> Array:
        theta, w, frame = y[:3], y[3:6], y[6:15].reshape(3, 3)
        u = curvature(theta, w)
        spin = np.array([[0, 0, u[1]], [0, 0, -u[0]], [-u[1], u[0], 0.0]])
        twist = kb * kappa * (u[0] * np.sin(theta) - u[1] * np.cos(theta)) / kt
        return np.concatenate([(1 + lever @ u) * w, twist, (frame @ spin).ravel(), frame[:, 2]])

    def end(w: Array) -> Array:
        start = np.concatenate([alpha, w, np.eye(3).ravel(), np.zeros(3)])
        return np.asarray(solve_ivp(rates, (0.0, 0.094), start, "DOP853", rtol=1e-8, atol=1e-10).y[:, -1])

    pose = thesis.fk(alpha)
    w = pose.torsion[:, 0] / (1 + lever @ pose.curvature[0])
    left = end(w)[3:6]
    slope = np.column_stack([(end(w + e)[3:6] - left) / 1e-3 for e in 1e-3 * np.eye(3)])
    tip = end(w - np.linalg.solve(slope, left))[-3:]
    assert 1e6 * np.linalg.norm(tip - pose.tip_position) == pytest.approx(microns, abs=0.01)


def test_a_file_without_a_model_has_the_one_that_its_offset_needs(tmp_path: Path) -> None:
    shipped = yaml.safe_load((ROOT / "configs" / "robots" / "thesis_etr.yaml").read_text())
    wide = shipped | {"offset_mm": 6.2}  # 5.2 % of the radius of precurvature
    for data, kind in ((shipped, EccentricRobot), (wide, BundleRobot), (wide | {"model": "thesis"}, EccentricRobot)):
        (tmp_path / "robot.yaml").write_text(yaml.safe_dump(data))
        robot = load_robot(tmp_path / "robot.yaml")
        assert isinstance(robot, kind)
        robot.save(tmp_path / "saved.yaml")
        again = load_robot(tmp_path / "saved.yaml")
        assert again == robot
        assert getattr(again, "model", None) == getattr(robot, "model", None)
    balanced = EccentricRobot(load_robot("thesis_etr").tubes[0], 6.2e-3)
    balanced.save(tmp_path / "saved.yaml")
    assert load_robot(tmp_path / "saved.yaml") == balanced
    assert isinstance(balanced.modelled(), BundleRobot)
    with pytest.raises(InputError, match="model is 'energy'; it must be thesis or None"):
        EccentricRobot(balanced.tube, model="energy")


def test_loads_and_friction_take_the_energy_where_no_model_is_stated() -> None:
    thesis, alpha, load = load_robot("thesis_etr"), np.radians([30, 100, -20]), Load((0.05, 0.0, 0.0))
    assert isinstance(thesis, EccentricRobot)
    bare, pose = thesis.fk(alpha), thesis.fk(alpha, load=load)
    assert isinstance(bare.robot, EccentricRobot)
    assert isinstance(pose.robot, BundleRobot)
    assert np.abs(pose.tip_position - thesis.bundle().fk(alpha, load=load).tip_position).max() < 1e-12
    # An equilibrium of the balance starts at its joint values.
    assert np.abs(thesis.fk(alpha, load=load, start=bare).tip_position - pose.tip_position).max() < 1e-9
    rubbed = follow(thesis, [alpha, alpha + 0.05], friction=Friction(torque=0.005)).equilibria[-1]
    assert isinstance(rubbed.robot, BundleRobot)
    found = estimate_force(thesis, alpha, tip_position=pose.tip_position)
    known = estimate_force(thesis.bundle(), alpha, tip_position=pose.tip_position)
    assert found.force == pytest.approx(known.force, abs=1e-12)
    stated = replace(thesis, model="thesis")
    with pytest.raises(InputError, match="model of the robot is thesis, a balance of moments without loads"):
        stated.fk(alpha, load=load)
    with pytest.raises(InputError, match="friction is given for a robot of kind eccentric"):
        follow(stated, [alpha, alpha + 0.05], friction=Friction(torque=0.005))


def test_segments_are_stacks_of_tubes_of_own_length() -> None:
    robot = load_robot("example_three_segment_etr")
    assert isinstance(robot, SegmentedEccentricRobot)
    turns = np.radians([-50, -35, -65, 110, 125, 95, 70, 85, 55])
    thesis, pose = robot.fk(turns), robot.bundle().fk(turns, robot.home_translations)
    # Curves of inner tubes begin where outer tubes end, at the same own length.
    assert len(pose.section_start) == 9
    assert np.linalg.norm(pose.tip_position - thesis.tip_position) < 5e-4
    # The stretches of three tubes at 120 deg add up to 0 where all three are present.
    assert abs((pose.tube_end - thesis.tube_end).sum()) < 1e-5
    # The key of a file; curves begin beyond the tube around them, so that home is that of the segments.
    data = robot_to_dict(robot) | {"model": "energy"}
    bundle = robot_from_dict(data)
    assert bundle == robot.bundle() == robot_from_dict(robot_to_dict(bundle))
    assert bundle.home_translations == pytest.approx(robot.home_translations, abs=1e-15)


def test_margins_without_offsets_are_concentric_on_a_mesh_of_the_same_elements() -> None:
    """On the default mesh of two elements the concentric margin close to 1 is 4.6e-7 too large."""
    like, tubes = bundle_of_thesis().tubes[0], []
    for k in range(3):
        nested = Tube(1e-3 + 2e-4 * k, 0.9e-3 + 2e-4 * k, 0.0, like.curved_length, curvature=like.curvature)
        nested = nested.resized("bending_stiffness", float(like.bending_stiffness))
        tubes.append(nested.resized("torsional_stiffness", float(like.torsional_stiffness)))
    alpha, bundle = np.radians([30.0, 100.0, -20.0]), BundleRobot(tuple(tubes), (0.0,) * 3, (0.0,) * 3)
    mine, concentric = bundle.fk(alpha), ConcentricRobot(tuple(tubes))
    for refinement, elements, off in ((0, 2, 4.6253e-7), (1, 4, 0.0)):
        other = forward_kinematics(concentric, alpha, discretisation=Discretisation(refinement=refinement))
        assert other.statistics.elements == elements
        assert other.margin - mine.margin == pytest.approx(off, abs=1e-9)
        assert other.tip_position == pytest.approx(mine.tip_position, abs=1e-11)


@pytest.mark.parametrize("seed", [1000, 1002, 1009, 1012])
def test_without_offsets_tips_and_margins_are_concentric_on_the_same_elements(seed: int) -> None:
    """Two to four unequal tubes; the concentric tip on its own, coarser mesh is off by up to 3e-11 m."""
    own, nested, alpha, shift = nested_tubes(seed, 0.2)
    mine, default = own.fk(alpha, shift), nested.fk(alpha, shift)
    other = on_elements_of(mine, default)
    assert other.statistics.elements > default.statistics.elements
    assert np.linalg.norm(mine.tip_position - other.tip_position) < 1e-13
    assert np.linalg.norm(mine.tip_position - default.tip_position) < 3e-11
    assert mine.margin == pytest.approx(other.margin, abs=1e-9)


def test_unequal_tubes_under_a_force_on_the_sheath_agree_with_rods() -> None:
    tubes = [tube(0.02 * f, 0.015 * f, k, 0.0, 0.1) for f, k in ((1.0, 20.0), (0.5, 14.0), (1.5, 0.0))]
    robot = BundleRobot(tuple(tubes), (0.01,) * 3, (0.0, 2.0943951, -2.0943951))
    load = Load(points=((0.08, (0.4, 0.3, -0.2)),))
    for of, point in (
        (None, (7.5490055774, -23.9270300867, 74.4480933103)),
        (load, (8.86054685, -23.3381964, 74.49749402)),
    ):
        pose = robot.fk([0.0, 1.0, -0.5], load=of)
        k = int(np.argmin(np.abs(pose.arc_length - 0.08)))
        if of is None:
            at = [1e3 * float(CubicSpline(1e3 * pose.arc_length, row)(80.0)) for row in pose.position.T]
            assert np.abs(np.array(at) - point).max() < 2e-3  # of the spline
            continue
        assert pose.arc_length[k] == pytest.approx(0.08, abs=1e-12)
        assert np.abs(1e3 * pose.position[k] - point).max() < 5e-8


LOADS = [
    None,
    Load((0.01, 0.02, -0.01)),
    Load((0.01, 0.0, -0.02), (0.002, -0.003, 0.004)),
    Load((0.01, 0.0, 0.05), (0.002, -0.003, 0.004), frame="tip"),
    Load(gravity=(0.0, -9.81, 3.0), points=((0.05, (0.03, 0.0, 0.02)),)),
    Load(distributed=((0.02, 0.09, (0.1, -0.2, 0.3)),)),
    Load(distributed=lambda s: (0.2, np.sin(20 * s), 0.0)),
]


@pytest.mark.parametrize("load", LOADS)
def test_without_offsets_it_is_a_concentric_robot(load: Load | None) -> None:
    robot = load_robot("thesis_ctr")
    assert isinstance(robot, ConcentricRobot)
    tubes = tuple(replace(each, mass_per_length=0.01) for each in robot.tubes)
    robot = ConcentricRobot(tubes)
    bundle, rng = BundleRobot(tubes, (0.0,) * 3, (0.0,) * 3), np.random.default_rng(3)
    alpha = rng.uniform(-1.5, 1.5, 3)
    mine, other = bundle.fk(alpha, robot.home_translations, load=load), robot.fk(alpha, load=load)
    assert np.abs(mine.tip_position - other.tip_position).max() < 1e-11
    # Of arms that a load hardly softens, the concentric margin is refined further.
    assert mine.margin == pytest.approx(other.margin, abs=1e-9 if load in LOADS[:3] else 1e-5)
    assert mine.energy == pytest.approx(other.energy, rel=1e-9)
    assert np.abs(mine.compliance - other.compliance).max() < 1e-8 * np.abs(other.compliance).max()
    axial = 5 if load is None or load.has_energy else 6
    assert np.abs((mine.base_wrench - other.base_wrench)[:axial]).max() < 1e-10
    if load is None or load.has_energy:
        for name in ("rotations", "translations"):
            jacobian, known = (pose.jacobian(wrt=[name], side=-1) for pose in (mine, other))
            assert np.abs(jacobian.matrix - known.matrix).max() < 1e-7
            if load in LOADS[:2]:
                assert np.abs(jacobian.margin - known.margin).max() < 1e-5 * max(1.0, np.abs(known.margin).max())


@pytest.fixture(scope="module")
def uneven() -> tuple[BundleRobot, Array, Array, Load]:
    """A robot whose tubes begin to curve and end at different places, at joint values under a force."""
    tubes = [tube(0.01 + 0.004 * i, 0.008 + 0.003 * i, 8.0 + 2 * i, 0.05, 0.06 + 0.01 * i) for i in range(3)]
    robot = BundleRobot(tuple(tubes), (0.003, 0.004, 0.005), (0.0, 2.0, 4.0))
    return robot, np.array([0.3, 1.0, -2.0]), np.array([-0.01, 0.02, 0.003]), Load((0.03, 0.02, -0.01))


@pytest.mark.parametrize("load", [None, *LOADS[1:5]])
def test_derivatives_are_those_of_differences(uneven: Any, load: Load | None) -> None:
    robot, alpha, shift, _ = uneven
    robot = replace(robot, tubes=tuple(replace(t, mass_per_length=0.02 * k) for k, t in enumerate(robot.tubes, 1)))
    pose = robot.fk(alpha, shift, load=load)
    jacobian, along = pose.jacobian(wrt=PARAMETERS), derivatives_of(pose, PARAMETERS).position
    for c, (name, i) in enumerate((name, i) for name in PARAMETERS for i in range(3)):
        unit = {"rotations": 1.0, "curvature": 10.0}.get(name, getattr(robot.tubes[i], name, 0.05))
        h = 3e-5 * unit
        sides = [shifted(pose, name, i, way * h) for way in (1, -1)]
        # The start is an equilibrium of another robot.
        ahead, behind = (each.robot.fk(each.rotations, each.translations, load=load, start=pose) for each in sides)

        change = {
            name: (getattr(ahead, name) - getattr(behind, name)) / (2 * h)
            for name in ("tip_position", "tip_rotations", "energy", "margin", "position", "arc_length")
        }
        turn = ahead.tip_rotation @ behind.tip_rotation.T
        about = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / (4 * h)
        assert unit * np.abs(change["tip_position"] - jacobian.position[:, c]).max() < 1e-8
        assert unit * np.abs(about - jacobian.rotation[:, c]).max() < 1e-7
        assert unit * np.abs(change["tip_rotations"] - jacobian.tip_rotations[:, c]).max() < 1e-7
        assert unit * change["energy"] == pytest.approx(unit * jacobian.energy[c], abs=1e-8)
        assert unit * change["margin"] == pytest.approx(unit * jacobian.margin[c], abs=1e-7)
        # Points of the shape move along the arm, those of the derivative stay at fixed arc lengths.
        moved = change["position"] - change["arc_length"][:, None] * pose.frame[:, :, 2]
        assert unit * np.abs(moved - along[:, :, c])[:-1].max() < 1e-8


ARRANGED = [*((name, i, 0.005 if name == "offset" else 1.0) for name in ("offset", "angle") for i in range(3))]


@pytest.mark.parametrize("load", [None, *LOADS[1:4]])
def test_derivatives_by_the_arrangement_are_those_of_differences(uneven: Any, load: Load | None) -> None:
    robot, alpha, shift, _ = uneven
    robot = replace(robot, sheath_stiffness=0.01)
    compare_arrangement(robot, robot.fk(alpha, shift, load=load), [*ARRANGED, ("sheath_stiffness", 0, 0.01)], 1e-8)
    with pytest.raises(InputError, match="under gravity"):
        robot.fk(alpha, shift, load=LOADS[4]).jacobian(wrt=["offset"])


def test_derivatives_by_the_arrangement_where_boundaries_stay_together() -> None:
    thesis = bundle_of_thesis()
    # Wider than touching, so that tubes may move to either side.
    robot = replace(thesis, offset=tuple(1.05 * d for d in thesis.offset))
    poses = (robot.fk(alpha) for alpha in np.random.default_rng(0).uniform(-np.pi, np.pi, (400, 3)))
    pose = next(pose for pose in poses if point_of(pose).state.problem.held)
    compare_arrangement(robot, pose, ARRANGED, 3e-7)


def compare_arrangement(robot: BundleRobot, pose: Any, parameters: Any, limit: float) -> None:
    """Compare the Jacobian of a pose by its arrangement with differences of re-solved equilibria."""
    jacobian = pose.jacobian(wrt=["offset", "angle", "sheath_stiffness"])
    for c, (name, i, unit) in enumerate(parameters):
        sides = []
        for step in (3e-5 * unit, -3e-5 * unit):
            value: Any = robot.sheath_stiffness + step
            if name != "sheath_stiffness":
                value = tuple(d + step * (i == k) for k, d in enumerate(getattr(robot, name)))
            moved = replace(robot, **{name: value})
            sides.append(moved.fk(pose.rotations, pose.translations, load=pose.load, start=pose))
        ahead, behind = sides
        for quantity, slope in (
            ("tip_position", jacobian.position[:, c]),
            ("tip_rotations", jacobian.tip_rotations[:, c]),
            ("margin", jacobian.margin[c]),
            ("energy", jacobian.energy[c]),
        ):
            change = (getattr(ahead, quantity) - getattr(behind, quantity)) / 6e-5
            assert np.abs(change - unit * slope).max() < limit


@pytest.mark.parametrize("load", [None, Load((0.03, 0.02, -0.01))])
def test_a_clamp_that_moves_back_from_the_plate_leaves_a_transmission(uneven: Any, load: Load | None) -> None:
    robot, alpha, shift, _ = uneven
    shift = np.array([robot.tubes[0].straight_length, 0.0, 0.0])
    pose, h = robot.fk(alpha, shift, load=load), 1e-6
    jacobian = pose.jacobian(wrt=["translations"])
    # One-sided differences to second order: no transmission is shorter than none.
    one, two = (robot.fk(alpha, shift - np.array([k * h, 0, 0]), load=load, start=pose) for k in (1, 2))
    for quantity, slope in (("tip_position", jacobian.position[:, 0]), ("margin", jacobian.margin[0])):
        here, back, far = (np.asarray(getattr(each, quantity)) for each in (pose, one, two))
        assert np.abs((3 * here - 4 * back + far) / (2 * h) - slope).max() < 1e-5 * max(1.0, np.abs(slope).max())


def test_its_curvature_is_free_only_where_its_sections_tell(uneven: Any) -> None:
    robot, alpha, shift, _ = uneven
    straight = replace(robot, tubes=(replace(robot.tubes[0], curvature=0.0), *robot.tubes[1:]))
    with pytest.raises(InputError, match="would begin to curve in front of the plate"):
        straight.fk(alpha, shift + np.array([0.02, 0, 0])).jacobian(wrt=["curvature"])


@pytest.mark.parametrize(
    "load",
    [
        Load((0.03, 0.02, -0.01)),
        Load(gravity=(3.0, -9.81, 2.0), distributed=(0.1, -0.2, 0.1), points=((0.03, (0.1, 0.0, 0.05)),)),
    ],
)
def test_compliance_is_symmetric_and_work_becomes_energy(uneven: Any, load: Load) -> None:
    robot, alpha, shift, _ = uneven
    robot = replace(robot, tubes=tuple(replace(t, mass_per_length=0.02 * k) for k, t in enumerate(robot.tubes, 1)))
    pose, h = robot.fk(alpha, shift, load=load), 1e-4
    compliance = pose.compliance
    assert np.abs(compliance - compliance.T).max() < 1e-10 * np.abs(compliance).max()
    for k in range(3):
        more, less = (
            robot.fk(alpha, shift, load=replace(load, force=np.add(load.force, way * h * np.eye(3)[k])), start=pose)
            for way in (1, -1)
        )
        assert np.abs((more.tip_position - less.tip_position) / (2 * h) - compliance[:3, k]).max() < 1e-7
    # The load does the work int W dt while it grows to t = 1: in elastic energy.
    free = robot.fk(alpha, shift)
    nodes, weights = np.polynomial.legendre.leggauss(5)
    steps = [robot.fk(alpha, shift, load=load.scaled((1 + t) / 2), start=pose) for t in nodes.tolist()]
    works = np.array([each.work / ((1 + t) / 2) for t, each in zip(nodes, steps, strict=True)])
    gained = pose.work - weights @ works / 2
    assert pose.energy - free.energy == pytest.approx(gained, abs=1e-9 * pose.energy)


@pytest.mark.parametrize("tube", [None, 0, 1])
def test_compliance_along_the_arm_is_the_change_by_forces_there(uneven: Any, tube: int | None) -> None:
    robot, alpha, shift, _ = uneven
    at, h, load = 0.031, 1e-3, Load((0.03, 0.02, -0.01))
    compliance = robot.fk(alpha, shift, load=load).compliance_at(at, tube)
    assert np.abs(compliance - compliance.T).max() < 1e-10 * np.abs(compliance).max()
    # Where a force acts a section ends, and the arm has a point.
    here = robot.fk(alpha, shift, load=replace(load, points=((at, (0.0, 0.0, 0.0)),)))
    point = int(np.argmin(np.abs(here.arc_length - at)))
    assert here.arc_length[point] == pytest.approx(at, abs=1e-12)
    for axis in np.eye(3):
        more, less = (
            robot.fk(alpha, shift, load=replace(load, points=((at, tuple(way * h * axis)),)), start=here)
            for way in (1, -1)
        )
        moved = (more.position[point] - less.position[point]) / (2 * h)
        turned = Rotation.from_matrix(more.frame[point] @ less.frame[point].T).as_rotvec() / (2 * h)
        if tube is not None:
            turned += here.frame[point, :, 2] * (more.rotation[tube, point] - less.rotation[tube, point]) / (2 * h)
        assert np.abs(np.concatenate([moved, turned]) - compliance[:, :3] @ axis).max() < 1e-6


def test_a_moment_on_the_sheath_is_a_pair_of_forces(uneven: Any) -> None:
    robot, alpha, shift, _ = uneven
    free, place, apart = robot.fk(alpha, shift), 0.03, 1e-3
    tangent = free.frame[int(np.argmin(np.abs(free.arc_length - place)))][:, 2]
    force = np.cross(tangent, (0.3, 0.8, 0.1))
    pair = Load(points=((place + apart, tuple(force)), (place - apart, tuple(-force))))
    moment = Load(points=((place, (0.0, 0.0, 0.0), tuple(2 * apart * np.cross(tangent, force))),))
    by_pair, by_moment = (robot.fk(alpha, shift, load=load) for load in (pair, moment))
    moved = np.linalg.norm(by_pair.tip_position - free.tip_position)
    assert np.linalg.norm(by_moment.tip_position - by_pair.tip_position) < 0.02 * moved


def long_bundle(length: float = 0.164) -> BundleRobot:
    """Three tubes of the thesis' eccentric robot that are long enough to snap."""
    one = replace(load_robot("thesis_etr").tubes[0], straight_length=0.0, curved_length=length)
    return BundleRobot((one,) * 3, (one.outer_diameter / np.sqrt(3),) * 3, THIRDS)


def test_forces_per_length_end_with_the_arm(uneven: Any) -> None:
    robot, alpha, shift, _ = uneven
    with pytest.warns(ImplausibleWarning, match="it is cut at the length of the arm"):
        beyond = robot.fk(alpha, shift, load=Load(distributed=((0.01, 0.2, (0.5, 0.0, 0.0)),)))
    whole = robot.fk(alpha, shift, load=Load(distributed=((0.01, 0.09, (0.5, 0.0, 0.0)),)))
    assert beyond.tip_position == pytest.approx(whole.tip_position, abs=1e-10)
    assert beyond.base_wrench[:3] == pytest.approx([0.04, 0.0, 0.0], abs=1e-9)


def test_moments_per_length_are_the_limit_of_many_moments(uneven: Any) -> None:
    robot, alpha, shift, _ = uneven
    tips = []
    free, start, end, rate = robot.fk(alpha, shift), 0.022, 0.048, np.array([0.4, -0.3, 0.2])
    for count in (4, 8):
        step = (end - start) / count
        places = start + step * (np.arange(count) + 0.5)
        points = tuple((float(s), (0.0, 0.0, 0.0), tuple(rate * step)) for s in places)
        tips.append(robot.fk(alpha, shift, load=Load(points=points)).tip_position)
    spread = robot.fk(alpha, shift, load=Load(distributed=((start, end, (0.0, 0.0, 0.0), tuple(rate)),)))
    # The midpoint rule has errors of the second order, which extrapolation removes.
    limit, moved = (4 * tips[1] - tips[0]) / 3, np.linalg.norm(spread.tip_position - free.tip_position)
    assert moved > 1e-3
    assert np.linalg.norm(spread.tip_position - limit) < 1e-5 * moved
    # A cut fixes a point of the mesh, which else slides along the sheath: the equations are the same.
    none, whole = (0.0, 0.0, 0.0), float(max(t.curved_length + d for t, d in zip(robot.tubes, shift, strict=True)))
    one = robot.fk(alpha, shift, load=Load(distributed=((0.0, whole, none, tuple(rate)),)))
    parts = Load(distributed=((0.0, 0.033, none, tuple(rate)), (0.033, whole, none, tuple(rate))))
    assert robot.fk(alpha, shift, load=parts).tip_position == pytest.approx(one.tip_position, abs=1e-9)


@pytest.mark.parametrize(
    "load",
    [
        Load(distributed=((0.01, 0.088, (0.0, 0.0, 0.0), (0.3, -0.2, 0.4)),)),
        Load(distributed=lambda s: (0.1, 0.0, 0.2, 0.2 * np.cos(20 * s), 0.3, 10 * s)),
    ],
)
def test_derivatives_under_moments_per_length_are_those_of_differences(uneven: Any, load: Load) -> None:
    robot, alpha, shift, _ = uneven
    point = point_of(robot.fk(alpha, shift, load=load))
    state, member = point.state, point.member
    rng, h = np.random.default_rng(8), 1e-5
    for _ in range(3):
        way = rng.normal(size=len(state.x))
        slope = (member.at(state.x + h * way).gradient - member.at(state.x - h * way).gradient) / (2 * h)
        assert np.abs(slope - state.hessian @ way).max() < 1e-7 * np.abs(slope).max()
    pose, h = robot.fk(alpha, shift, load=load), 1e-5
    for name, at in (("rotations", alpha), ("translations", shift)):
        jacobian = pose.jacobian(wrt=[name]).matrix
        for k in range(3):
            a, b = (
                robot.fk(*((alpha + w, shift) if at is alpha else (alpha, shift + 0.1 * w)), load=load).tip_position
                for w in (h * np.eye(3)[k], -h * np.eye(3)[k])
            )
            step = h if at is alpha else 0.1 * h
            assert np.abs((a - b) / (2 * step) - jacobian[:3, k]).max() < 1e-5


def test_it_snaps_where_the_integrated_equations_are_singular() -> None:
    robot, start = long_bundle(), np.radians([30.0, 200.0, 30.0])
    snap = find_snap(robot, (start, None), (np.radians([30.0, 230.0, 30.0]), None))
    assert snap is not None
    # The balance of the thesis snaps at 210.1645 deg.
    assert np.degrees(snap.rotations[1]) == pytest.approx(210.1645, abs=0.06)
    assert abs(snap.before.margin) < 1e-9
    assert snap.energy_released > 1e-5
    assert snap.after.margin > 0
    pose = snap.before
    member, x = unsolved(pose)
    held, constant = member.problem, end_forces(member.at(x))
    lever = held.bundle.levers
    z = np.concatenate([pose.torsion[:, 0] / (1 + lever @ pose.curvature[0]), constant])

    def violated(z: Array) -> Array:
        at = SimpleNamespace(**{name: getattr(pose, name) for name in ("rotations", "translations", "tip_position")})
        at.torsion, at.curvature, at.tube_end = z[:3, None], np.zeros((1, 2)), pose.tube_end
        return shoot(robot, at, z[3:], np.zeros(3), 1e-9)[0].ravel()

    scale = np.array([0.1] * 3 + [0.01] * 3)
    steps = 1e-4 * np.diag(scale)
    here = violated(z)
    slope = np.column_stack([(violated(z + e) - here) / 1e-4 for e in steps])
    # It falls with the square root of the distance to the fold, and is 4e-5 at 210 deg: 1e-12 rad from the fold it is
    # 1e-9.
    assert np.linalg.svd(slope, compute_uv=False)[-1] < 1e-9


def test_boundaries_change_places_along_a_path() -> None:
    robot = long_bundle(0.12)
    turns = np.radians([[30, a, 30] for a in (0, 40, 90, 40, 0)])
    path = follow(robot, turns)
    assert not path.snaps
    for pose, rotations in zip(path.equilibria, turns, strict=True):
        assert np.abs(pose.tip_position - robot.fk(rotations).tip_position).max() < 1e-10
    # Tube 2 turns past tube 3: its end passes the other one, which it meets at equal angles.
    ends = [pose.tube_end[2] - pose.tube_end[0] for pose in path.equilibria]
    assert ends[0] > 0 > ends[1]
    meeting = robot.fk(np.radians([30, 30, 30]), start=path.equilibria[0])
    assert abs(meeting.tube_end[2] - meeting.tube_end[0]) < 1e-11


def test_its_inverse_kinematics_reach_a_tip(uneven: Any) -> None:
    robot, alpha, shift, load = uneven
    pose = robot.fk(alpha, shift)
    target = pose.tip_position + np.array([1e-3, -5e-4, 2e-4])
    solution = robot.ik(target, start=pose)
    assert np.linalg.norm(robot.fk(solution.rotations, solution.translations).tip_position - target) < 1e-8
    loaded = robot.ik(target, start=solution, load=load)
    assert np.linalg.norm(loaded.equilibrium.tip_position - target) < 1e-8
    # The shape of a posture moves with its joints, at fixed arc lengths.
    posture = start_posture(joint_space(robot), pose)
    step = 1e-5 * np.random.default_rng(0).standard_normal(6)
    ahead, behind = (robot.fk(*np.split(posture.q + way * step, 2), start=pose) for way in (1, -1))
    for s in (0.02, 0.05):
        at = [CubicSpline(each.arc_length, each.position)(s) for each in (ahead, behind)]
        change = CubicSpline(pose.arc_length, posture.along @ step)(s)
        assert np.abs((at[0] - at[1]) / 2 - change).max() < 1e-8


def test_it_buckles_under_a_load_that_its_straight_tubes_bear() -> None:
    # Euler's column of a straight tube on the centreline and a sheath: F = pi^2 K / (4 L^2).
    one = tube(0.02, 0.015, 0.0, 0.0, 0.1)
    robot = BundleRobot((one,), (0.0,), (0.0,), sheath_stiffness=0.01)
    euler = np.pi**2 * 0.03 / (4 * 0.1**2)
    limit = find_load_limit(robot, [0.0], None, Load((0.0, 0.0, -euler)), up_to=2.0)
    assert limit is not None
    assert limit.kind == "bifurcation"
    assert limit.factor == pytest.approx(1.0, rel=1e-8)


def test_free_channels_are_those_of_touching_circles() -> None:
    one = Tube(2e-3, 1e-4, 0.0, 0.05, curvature=5.0)
    three = BundleRobot((one,) * 3, (2e-3 / np.sqrt(3),) * 3, THIRDS)
    # Beside three touching tubes, in their sheath: Descartes' theorem of four touching circles.
    k = 1 / np.array([1e-3, 1e-3, -(1 + 2 / np.sqrt(3)) * 1e-3])
    outer = 1 / (k.sum() + 2 * np.sqrt(k[0] * k[1] + k[1] * k[2] + k[2] * k[0]))
    assert free_channel(three).diameter == pytest.approx(2 * outer, rel=1e-8)
    two = BundleRobot((one,) * 2, (1e-3,) * 2, (0.0, np.pi))
    assert free_channel(two).diameter == pytest.approx(4e-3 / 3, rel=1e-8)
    assert free_channel(two).inside is None
    # Around a tube in the centre the circle may lie anywhere.
    centred = BundleRobot((one,) * 2, (0.0, 2e-3), (0.0, 1.0), sheath_diameter=6.4e-3)
    assert free_channel(centred).diameter == pytest.approx(2.2e-3, rel=1e-8)
    random = np.random.default_rng(5)
    for _ in range(20):
        n, wide = int(random.integers(2, 6)), 10e-3
        around = 2 * np.pi * (np.arange(n) + random.uniform(-0.1, 0.1, n)) / n
        robot = BundleRobot((one,) * n, tuple(random.uniform(2.2e-3, 4e-3, n)), tuple(around), sheath_diameter=wide)
        x, y = wide / 2 * np.mgrid[-1:1:401j, -1:1:401j]
        to_tubes = np.hypot(*(np.stack([x, y])[..., None] - robot.axes.T[:, None, None])) - 1e-3
        brute = 2 * np.minimum(to_tubes.min(-1), wide / 2 - np.hypot(x, y)).max()
        assert brute <= channel_between(robot).diameter + 1e-12 < brute + wide / 200


def test_robot_files_keep_a_bundle(tmp_path: Path, uneven: Any) -> None:
    robot = uneven[0]
    robot.save(tmp_path / "bundle.yaml")
    again = load_robot(tmp_path / "bundle.yaml")
    assert isinstance(again, BundleRobot)
    assert np.abs(np.subtract(again.angle, robot.angle)).max() < 1e-12
    assert np.abs(np.subtract(again.offset, robot.offset)).max() < 1e-15
    assert again.tubes == robot.tubes


def test_what_a_bundle_does_not_support_is_named(uneven: Any) -> None:
    robot, alpha, shift, _ = uneven
    with pytest.raises(InputError, match=r"must be at least 0\.002 m apart"):
        BundleRobot(robot.tubes[:2], (0.0005, 0.0005), (0.0, np.pi))
    with pytest.raises(InputError, match="offset has 1 numbers; it must have 3"):
        BundleRobot(robot.tubes, (0.003,), (0.0, 1.0, 2.0))
    with pytest.raises(InputError, match=r"must be at least 0\.012 m to contain the tubes"):
        BundleRobot(robot.tubes, robot.offset, robot.angle, sheath_diameter=0.01)
    with pytest.raises(InputError, match=r"points\[0\] of the load is at 0.3 m"):
        robot.fk(alpha, shift, load=Load(points=((0.3, (0.1, 0.0, 0.0)),)))


def test_a_servo_leads_its_tip_and_stops_before_it_snaps() -> None:
    robot = bundle_of_thesis()
    start, target = robot.fk(np.zeros(3)), robot.fk(np.radians([20.0, 80.0, -60.0])).tip_position
    servo, steps = Servo(robot, start), []
    for _ in range(20):
        steps.append(servo.step(Command(position=target), 0.05))
    assert np.linalg.norm(steps[-1].equilibrium.tip_position - target) < 1e-6
    again = follow(robot, [s.rotations for s in steps], [s.translations for s in steps])
    assert not again.snaps
    assert again.equilibria[-1].tip_position == pytest.approx(steps[-1].equilibrium.tip_position, abs=1e-10)
    # A straight turn of the second tube snaps at 210 deg; the servo leads the others around it.
    robot = long_bundle()
    start = robot.fk(np.radians([30.0, 195.0, 30.0]))
    servo, goal = Servo(robot, start), (np.radians([30.0, 230.0, 30.0]), np.zeros(3))
    steps = [servo.step(Command(joints=goal), 0.05) for _ in range(20)]
    assert min(step.equilibrium.margin for step in steps) >= 0.05 - 1e-9
    again = follow(robot, [s.rotations for s in steps], [s.translations for s in steps])
    assert not again.snaps
    assert again.equilibria[-1].margin == pytest.approx(steps[-1].equilibrium.margin, abs=1e-8)


def test_plans_are_paths_that_can_be_followed() -> None:
    robot = bundle_of_thesis()
    start, goal = (robot.fk(np.radians([turn] * 3)) for turn in (60.0, -60.0))
    body = Sphere(tuple(robot.fk(np.zeros(3)).position[-3]), 3e-3)
    plan = plan_trajectory(robot, start, goal, obstacles=[body], options=PlanOptions(clearance=5e-4))
    assert not plan.proved
    assert plan.proof.status is ProofStatus.FOLLOWED
    path = follow(robot, plan.rotations, plan.translations)
    assert not path.snaps
    assert path.equilibria[-1].tip_position == pytest.approx(goal.tip_position, abs=1e-9)
    # The largest radius of the robot, and the chord between shape points.
    radius = robot.least_sheath_diameter / 2
    gaps = [np.linalg.norm(e.position - body.centre, axis=1).min() - body.radius - radius for e in path.equilibria]
    assert 5e-4 - 1e-6 <= min(gaps) < 2e-3
    assert plan.proof.measured_clearance == pytest.approx(min(gaps), abs=3e-4)
    assert plan.proof.measured_clearance <= min(gaps) + 1e-9
    assert plan.proof.least_clearance == -np.inf
    loaded = plan_trajectory(robot, start, robot.fk(np.radians([60.0, 68.0, 64.0])), load=Load((0.1, 0.0, 0.0)))
    assert loaded.arms[-1].load is not None
    assert np.abs(loaded.arms[-1].compliance).max() > 0
    # A turn that snaps is refuted.
    robot = long_bundle()
    proof = verify_trajectory(robot, [0.0, 1.0], np.radians([[30.0, 180.0, 30.0], [30.0, 230.0, 30.0]]))
    assert proof.status is ProofStatus.FAULTY
    assert proof.snap is not None
    assert 180 + 50 * proof.snap == pytest.approx(210.1645, abs=0.06)


def test_plans_lead_to_joint_values() -> None:
    robot, goal = bundle_of_thesis(), np.radians([40.0, 20.0, -20.0])
    plan = plan_trajectory(robot, (np.zeros(3), np.zeros(3)), (goal, np.zeros(3)))
    assert plan.proof.status is ProofStatus.FOLLOWED
    assert plan.rotations[-1] == pytest.approx(goal, abs=1e-9)
    # It is not integrated again.
    assert "(estimated)" in dict(TrajectoryReport(plan).rows())["followed again"]


def test_maps_and_stroke_forces_without_offsets_are_concentric() -> None:
    robot = load_robot("thesis_ctr")
    assert isinstance(robot, ConcentricRobot)
    bundle = BundleRobot(robot.tubes, (0.0,) * 3, (0.0,) * 3)
    mine, other = (stability_map(each, robot.home_translations, samples=3, directions=4) for each in (bundle, robot))
    assert mine.margin == pytest.approx(other.margin, abs=1e-5)
    assert (mine.snaps == other.snaps).all()
    assert mine.boundary == pytest.approx(other.boundary, abs=1e-6, nan_ok=True)
    by_bundle, known = (find_stroke_force(each, np.zeros(3), robot.home_translations) for each in (bundle, robot))
    assert by_bundle is not None
    assert known is not None
    assert by_bundle.factor == pytest.approx(known.factor, rel=1e-6)


def test_calibration_finds_the_curvature_and_the_force_of_a_bundle(uneven: Any) -> None:
    robot, _, shift, load = uneven
    rotations = np.random.default_rng(4).uniform(-1.0, 1.0, (6, 3))
    bent = robot.tubes[1].resized("curvature", 0.9 * robot.tubes[1].curvature)
    real = replace(robot, tubes=(robot.tubes[0], bent, robot.tubes[2]))
    tips = np.array([real.fk(alpha, shift).tip_position for alpha in rotations])
    measured = Measurements(rotations, np.tile(shift, (6, 1)), tips)
    found = fit(robot, measured, ["curvature_2"], FitOptions(registration="none"))
    assert found.robot.tubes[1].curvature == pytest.approx(bent.curvature, rel=1e-6)
    pushed = robot.fk(rotations[0], shift, load=load)
    force = estimate_force(robot, rotations[0], shift, tip_position=pushed.tip_position, noise=1e-5)
    assert force.force == pytest.approx(load.force, abs=1e-6)
    with pytest.raises(InputError, match="for a bundle the tip only is allowed"):
        estimate_force(robot, rotations[0], shift, points=[(0.02, pushed.position[5])])


def test_a_certificate_of_the_balance_is_none_of_the_energy() -> None:
    """A robot that cannot snap by the balance of the thesis has two minima of the energy, by the order of its ends."""
    thesis = load_robot("thesis_etr")
    assert isinstance(thesis, EccentricRobot)
    slender = replace(thesis.tube, outer_diameter=1.421e-3, inner_diameter=1.162e-3, curvature=13.98)
    robot = replace(thesis, tube=slender, offset=1.31e-3)
    assert snap_free_certificate(robot) > 0.05
    bundle = robot.bundle()
    first, last = np.radians([-125.85, 48.13, 19.81]), np.radians([-131.45, 56.04, 39.55])
    pose = bundle.fk(first)
    for x in np.linspace(0.0, 1.0, 9)[1:]:
        pose = bundle.fk(first + x * (last - first), start=pose)
    other = bundle.fk(last)
    assert np.linalg.norm(pose.tip_position - other.tip_position) > 4e-3
    assert pose.tube_end.argsort().tolist() != other.tube_end.argsort().tolist()
    for each in (pose, other):
        assert each.margin > 0.06
        member, x = unsolved(each)
        assert member.residual(member.at(x)) < 1e-10
        # Both stay on a mesh of four times as many elements, with all eigenvalues of the second variation positive.
        finer = member.on(refinement=2)
        result = finer.solve(finer.transfer(point_of(each)))
        assert result.converged
        assert finer.owner(result.state).margin(result.state) == pytest.approx(each.margin, abs=1e-8)
    # On the way the branch ends at a stable point, where the ends of two tubes meet.
    snap = find_snap(bundle, (first, None), (first + 2 * (last - first), None))
    assert snap is not None
    assert snap.before.margin > 0.1
    assert snap.after.margin > 0.05
    assert snap.energy_released == pytest.approx(snap.before.energy - snap.after.energy, rel=1e-6)
    assert snap.energy_released > 1e-4
    ends = np.sort(snap.before.tube_end)
    assert np.diff(ends).min() < 1e-5
    beyond = bundle.fk(first + 1.2 * (last - first))
    landed = follow(bundle, [snap.after.rotations, beyond.rotations], start=snap.after)
    assert landed.equilibria[-1].tip_position == pytest.approx(beyond.tip_position, abs=1e-9)


# --- Friction ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_friction_in_the_channels_is_that_of_integrated_torques(seed: int) -> None:
    """After a turn of all tubes all of their length slips: each has a known torque per length, which also pulls."""
    rng = np.random.default_rng(seed)
    robot, alpha, shift = random_bundle(rng)
    force, n = rng.uniform(-0.2, 0.2, 3) * (seed % 2), robot.n_tubes
    load, torque = Load(tuple(force)) if seed % 2 else None, rng.uniform(0.002, 0.006, n)
    before = np.concatenate([alpha - 1.5 * rng.choice([-1, 1], n), shift])
    held = start_with_friction(robot, before, Friction(tuple(torque)), None, load)
    held, _ = segment_with_friction(robot, held, np.concatenate([alpha, shift]), load)
    assert held.increment.signs.all()
    state, place, pose = held.increment.state.elastic, held.contact.place, to_held_equilibrium(robot, held, "follow")
    problem, twist = state.problem, state.turn / state.length
    rubs = -np.array([held.increment.signs[place.inner == i][0] for i in range(n)]) * torque
    # Torques in front of a place pull there, too: lambda at the plate is that at the end and their work.
    pull = (held.increment.torque * twist[place.point, place.inner]) @ (place.up_to @ problem.in_section.T)
    constant = end_forces(state)
    for boundary, value in zip(problem.order, (pull @ problem.lengths_by_boundaries).tolist(), strict=True):
        constant[list(boundary.ends)] += value
    constant += rubs * (problem.weight @ np.where(problem.present, state.turn, 0.0))
    violated, tip = shoot(robot, pose, constant, force, rubs=rubs)
    assert np.abs(violated).max() < 1e-6
    assert np.abs(tip - pose.tip_position).max() < 1e-9
    free = robot.fk(alpha, shift, load=load)
    assert np.linalg.norm(free.tip_position - pose.tip_position) > 1e-6


@pytest.mark.parametrize("load", [None, Load((0.05, 0.02, 0.0))])
@pytest.mark.parametrize(("torque", "apart"), [(5e-3, 1e-12), (5e-2, 1e-6)])
def test_friction_without_offsets_is_that_of_nested_tubes(load: Load | None, torque: float, apart: float) -> None:
    """Tubes that slip everywhere agree to round-off, also at the plate and at ends; fronts as far as both meshes do."""
    inner, outer = Tube(1e-3, 0.75e-3, 0.15, 0.09, 9.0), Tube(1.5e-3, 1.15e-3, 0.07, 0.06, 5.0)
    turns, shift = [[0, 0], [0, 1.5], [0, 1.2], [0.3, 1.25], [0, -1]], [[-0.03, 0.0]] * 5
    nested = Friction(torque, plate=1e-4, jumps=5e-5, ends=2e-4)
    # The outer tube turns freely in the sheath.
    channels = Friction((torque, 0.0), (1e-4, 0.0), (5e-5, 0.0), (2e-4, 0.0))
    one = follow(ConcentricRobot((inner, outer)), turns, shift, friction=nested, load=load).equilibria
    other = follow(BundleRobot((inner, outer), (0.0, 0.0), (0.0, 0.0)), turns, shift, friction=channels, load=load)
    for a, b in zip(one, other.equilibria, strict=True):
        assert a.friction is not None
        assert b.friction is not None
        assert np.abs(a.tip_position - b.tip_position).max() < apart
        assert b.friction.heat == pytest.approx(a.friction.heat, rel=1e-3 if apart > 1e-9 else 1e-9)
        assert b.friction.held_margin == pytest.approx(a.friction.held_margin, abs=1e-3)


def test_friction_takes_what_the_drives_give(tmp_path: Path) -> None:
    """Work of the drives is energy and heat; without friction the history is nothing; a saved state goes on."""
    robot, friction = replace(bundle_of_thesis(), carriages=None), Friction(2e-3)
    way = np.radians(np.linspace([0, 0, 0], [90, -60, 120], 61))
    there = follow(robot, way, friction=friction).equilibria
    states = list(there)
    torque = []
    for pose in states:
        levers = robot.axes[:, [1, 0]] * [1.0, -1.0]
        g = 1 + levers @ pose.curvature[0]
        torque.append(-np.array([t.torsional_stiffness for t in robot.tubes]) * pose.torsion[:, 0] / g)
    work = float(((np.array(torque[1:]) + torque[:-1]) / 2 * np.diff(way, axis=0)).sum())
    heats = [pose.friction.heat for pose in states if pose.friction is not None]
    assert (np.diff(heats) >= 0).all()
    assert heats[-1] > 1e-4
    assert work == pytest.approx(states[-1].energy - states[0].energy + heats[-1], rel=2e-3)
    back = follow(robot, way[::-1], start=states[-1], friction=friction).equilibria
    assert back[-1].friction is not None
    assert back[-1].friction.heat > 1.5 * heats[-1]
    assert np.linalg.norm(back[-1].tip_position - states[0].tip_position) > 1e-6
    slight = follow(robot, way[::20], friction=Friction(1e-9)).equilibria[-1]
    assert np.abs(slight.tip_position - robot.fk(way[-1]).tip_position).max() < 1e-10
    states[40].save(tmp_path)
    again = follow(robot, way[40:], start=load_equilibrium(tmp_path), friction=friction).equilibria[-1]
    assert again.tip_position == pytest.approx(states[-1].tip_position, abs=1e-12)


def test_friction_delays_a_snap_and_its_band_holds_every_history(tmp_path: Path) -> None:
    robot, start, end = long_bundle(), np.radians([30, 195, 30]), np.radians([30, 230, 30])
    angles = []
    for torque in (1e-8, 1e-4):
        (snap,) = follow(robot, [start, end], friction=Friction(torque)).snaps
        angles.append(float(np.degrees(snap.rotations[1])))
    assert angles[0] == pytest.approx(210.11, abs=0.01)
    assert angles[0] + 0.005 < angles[1] < angles[0] + 0.05
    sheath = load_robot("configs/bundles/steerable_sheath.yaml")
    assert isinstance(sheath, BundleRobot)
    rubbed = replace(sheath, friction=Friction((1e-4, 2e-4, 1e-4), plate=1e-6))
    rubbed.save(tmp_path / "robot.yaml")
    assert load_robot(tmp_path / "robot.yaml").friction == rubbed.friction
    for load in (None, Load((0.05, 0.0, 0.0))):
        still, random = rubbed.fk(np.radians([30, 60, 0]), load=load), np.random.default_rng(0)
        ways = [p for _ in range(6) for p in (still.rotations + random.normal(0, 1.0, 3), still.rotations)]
        states = follow(rubbed, ways, friction=rubbed.friction, load=load).equilibria[1::2]
        off = np.abs([pose.tip_position - still.tip_position for pose in states]).max(0)
        assert off == pytest.approx(
            friction_band(still, Friction((1e-4, 2e-4, 1e-4), plate=1e-6)).tip_half_widths, rel=0.05
        )
    with pytest.raises(InputError, match="the robot has 3 tubes, so it must be 3, one for every tube, or 1"):
        follow(sheath, [start, end], friction=Friction((1e-3, 1e-3)))
    with pytest.raises(InputError, match="by_moment of friction is given for a bundle"):
        replace(sheath, friction=Friction(by_moment=0.1))
