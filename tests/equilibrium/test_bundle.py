"""Bundle robots against shooting of forces and moments, published values, concentric robots and differences."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from tubeopt import BundleRobot, ConcentricRobot, Load, Tube, load_robot
from tubeopt.equilibrium.bundle import linearised_bundle
from tubeopt.errors import InputError
from tubeopt.robots.eccentric import free_channel
from tubeopt.typing import Array

THIRDS = (0.0, 2 * np.pi / 3, -2 * np.pi / 3)


def bundle_of_thesis() -> BundleRobot:
    """The three tubes of the thesis' eccentric robot, each with its own length."""
    robot = load_robot("thesis_etr")
    return BundleRobot((robot.tubes[0],) * 3, (robot.distance,) * 3, THIRDS)


def tube(kb: float, kt: float, curvature: float, straight: float, curved: float) -> Tube:
    """Tube with given stiffnesses."""
    soft = Tube(2e-3, 1.6e-3, straight, curved, curvature=curvature)
    return soft.resized("bending_stiffness", kb).resized("torsional_stiffness", kt)


def random_bundle(rng: np.random.Generator) -> tuple[BundleRobot, Array, Array]:
    """Robot of two to four unequal tubes, with rotations, and translations that leave all tubes curved at the plate."""
    n = int(rng.integers(2, 5))
    offset = rng.uniform(2e-3, 6e-3, n)
    angle = 2 * np.pi * (np.arange(n) + rng.uniform(-0.1, 0.1, n)) / n
    straight = rng.uniform(0.0, 0.05, n) * rng.integers(0, 2)
    factor, length = rng.uniform(0.5, 2.0, n), 0.09 * rng.uniform(0.8, 1.0, n)
    curvature = np.minimum(rng.uniform(0.0, 25.0, n), 0.15 / offset) * (rng.random(n) > 0.2)
    tubes = [tube(0.02 * f, 0.015 * f, k, s, c) for f, k, s, c in zip(factor, curvature, straight, length, strict=True)]
    robot = BundleRobot(tuple(tubes), tuple(offset), tuple(angle), sheath_stiffness=0.004 * float(rng.random() < 0.5))
    return robot, rng.uniform(-2.0, 2.0, n), -straight * rng.uniform(0.0, 0.5, n)


def shoot(robot: BundleRobot, pose: Any, constant: Array, force: Array) -> tuple[Array, Array]:
    """Arm by integration from the plate, with the torsion of `pose` there; what is violated at the ends, and the tip.

    Each tube in its frictionless channel bends, twists and pulls:  kt w' = kb kappa (u_x sin theta - u_y cos theta) and
    N = kb (kappa^2 - |v|^2) / 2 - kt w^2 / 2 - lambda. At its end w = 0, and sliding its end along gains no energy:
    lambda g = psi g + the energy that the other tubes lose, since their curvature jumps there.
    """
    n, alpha, shift = robot.n_tubes, pose.rotations, pose.translations
    names = ("bending_stiffness", "torsional_stiffness", "curvature", "straight_length", "length")
    kb, kt, kappa, straight, whole = (np.array([float(getattr(t, name)) for t in robot.tubes]) for name in names)
    phi, d, own = np.array(robot.angle), np.array(robot.offset), whole - straight + shift
    lever = d[:, None] * np.column_stack([np.sin(phi), -np.cos(phi)])

    def strain(u: Array, theta: Array) -> Array:
        return u / (1 + lever @ u)[:, None] - kappa[:, None] * np.column_stack([np.cos(theta), np.sin(theta)])

    def potential(u: Array, theta: Array, w: Array, moment: Array, there: Array) -> float:
        """Energy per length less the parts p theta' and lambda g, whose least value has the curvature."""
        psi = kb * (strain(u, theta) ** 2).sum(1) / 2 - kt * w**2 / 2 - constant
        return float(there @ (psi * (1 + lever @ u)) + robot.sheath_stiffness * u @ u / 2 - moment @ u)

    def curvature(theta: Array, w: Array, moment: Array, there: Array) -> Array:
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
        return (y[3 * n + 3 :].reshape(3, 3).T @ np.cross(pose.tip_position - y[3 * n : 3 * n + 3], force))[:2]

    def rates(y: Array, there: Array) -> Array:
        theta, w, frame = y[:n], y[n : 2 * n], y[3 * n + 3 :].reshape(3, 3)
        u = curvature(theta, w, moment_at(y), there)
        g = 1 + lever @ u
        spin = np.array([[0, 0, u[1]], [0, 0, -u[0]], [-u[1], u[0], 0.0]])
        twist = kb * kappa * (u[0] * np.sin(theta) - u[1] * np.cos(theta)) / kt
        return np.concatenate([g * w * there, twist * there, g, frame[:, 2], (frame @ spin).ravel()])

    w0 = pose.torsion[:, 0] / (1 + lever @ pose.curvature[0])
    y = np.concatenate([alpha + (straight - shift) * w0, w0, np.zeros(n + 3), np.eye(3).ravel()])
    there, violated = np.ones(n), np.zeros((2, n))
    s = 0.0
    for i in np.argsort(pose.tube_end):
        end = lambda _, y, i=i: y[2 * n + i] - own[i]  # noqa: E731
        end.terminal = True
        flow = solve_ivp(
            lambda _, y, on=there: rates(y, on), (s, s + 1.0), y, "DOP853", events=end, rtol=1e-12, atol=1e-13
        )
        s, y = float(flow.t[-1]), flow.y[:, -1]
        theta, w, moment, after = y[:n], y[n : 2 * n], moment_at(y), there * (np.arange(n) != i)
        u = curvature(theta, w, moment, there)
        rest = potential(u, theta, w, moment, after)
        if after.any():
            rest -= potential(curvature(theta, w, moment, after), theta, w, moment, after)
        else:
            rest -= float(y[3 * n + 3 :].reshape(3, 3)[:, 2] @ force)  # the tip moves with the last end
        g = 1 + lever[i] @ u
        psi = kb[i] * (strain(u, theta)[i] ** 2).sum() / 2 + kt[i] * w[i] ** 2 / 2
        violated[:, i] = kt[i] * w[i], constant[i] - psi - rest / g
        there = after
    return violated, y[3 * n : 3 * n + 3]


@pytest.mark.parametrize("seed", range(4))
def test_integrated_forces_and_moments_give_the_same_arm(seed: int) -> None:
    rng = np.random.default_rng(seed)
    robot, alpha, shift = random_bundle(rng)
    force = rng.uniform(-0.2, 0.2, 3) * (seed % 2)
    pose = robot.fk(alpha, shift, load=Load(tuple(force)) if seed % 2 else None)
    arm = linearised_bundle(pose)
    constant = np.zeros(robot.n_tubes)
    for boundary, value in zip(arm.problem.order, arm.length_forces.tolist(), strict=True):
        constant[list(boundary.tubes)] = value
    violated, tip = shoot(robot, pose, constant, force)
    assert np.abs(violated).max() < 1e-6
    assert np.abs(tip - pose.tip_position).max() < 1e-9


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


@pytest.mark.parametrize("name", ["thesis_ctr"])
def test_without_offsets_it_is_a_concentric_robot(name: str) -> None:
    robot = load_robot(name)
    assert isinstance(robot, ConcentricRobot)
    bundle, rng = BundleRobot(robot.tubes, (0.0,) * robot.n_tubes, (0.0,) * robot.n_tubes), np.random.default_rng(3)
    alpha, load = rng.uniform(-1.5, 1.5, robot.n_tubes), Load((0.01, 0.02, -0.01))
    for of in (None, load):
        mine, other = bundle.fk(alpha, robot.home_translations, load=of), robot.fk(alpha, load=of)
        assert np.abs(mine.tip_position - other.tip_position).max() < 1e-11
        assert mine.margin == pytest.approx(other.margin, abs=1e-9)
        assert mine.energy == pytest.approx(other.energy, rel=1e-10)
        assert np.abs(mine.compliance - other.compliance).max() < 1e-8 * np.abs(other.compliance).max()
    assert np.abs(mine.base_wrench[:3] - other.base_wrench[:3]).max() < 1e-12
    assert np.abs(mine.base_wrench[3:5] - other.base_wrench[3:5]).max() < 1e-10
    assert np.abs(mine.jacobian(wrt=["rotations"]).matrix - other.jacobian(wrt=["rotations"]).matrix).max() < 1e-8


@pytest.fixture(scope="module")
def uneven() -> tuple[BundleRobot, Array, Array, Load]:
    """A robot whose tubes begin to curve and end at different places, at joint values under a force."""
    tubes = [tube(0.01 + 0.004 * i, 0.008 + 0.003 * i, 8.0 + 2 * i, 0.05, 0.06 + 0.01 * i) for i in range(3)]
    robot = BundleRobot(tuple(tubes), (0.003, 0.004, 0.005), (0.0, 2.0, 4.0))
    return robot, np.array([0.3, 1.0, -2.0]), np.array([-0.01, 0.02, 0.003]), Load((0.03, 0.02, -0.01))


def test_derivatives_are_those_of_differences(uneven: Any) -> None:
    robot, alpha, shift, load = uneven
    pose = robot.fk(alpha, shift, load=load)
    jacobian, joints, h = pose.jacobian(), np.concatenate([alpha, shift]), 2e-5
    for k in range(6):
        step = h * (np.arange(6) == k)
        ahead, behind = (robot.fk(*np.split(joints + way * step, 2), load=load, start=pose) for way in (1, -1))
        assert np.abs((ahead.tip_position - behind.tip_position) / (2 * h) - jacobian.position[:, k]).max() < 1e-6
        turn = ahead.tip_rotation @ behind.tip_rotation.T
        about = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / (4 * h)
        assert np.abs(about - jacobian.rotation[:, k]).max() < 1e-5
        assert (
            np.abs((ahead.tip_rotations - behind.tip_rotations) / (2 * h) - jacobian.tip_rotations[:, k]).max() < 1e-4
        )
        assert (ahead.energy - behind.energy) / (2 * h) == pytest.approx(jacobian.energy[k], abs=1e-5)
    assert jacobian.margin.shape == (6,)


def test_compliance_is_symmetric_and_work_becomes_energy(uneven: Any) -> None:
    robot, alpha, shift, load = uneven
    pose, h = robot.fk(alpha, shift, load=load), 1e-4
    compliance = pose.compliance
    assert np.abs(compliance - compliance.T).max() < 1e-10 * np.abs(compliance).max()
    for k in range(3):
        force = np.array(load.force)
        more, less = (
            robot.fk(alpha, shift, load=Load(tuple(force + way * h * np.eye(3)[k])), start=pose) for way in (1, -1)
        )
        assert np.abs((more.tip_position - less.tip_position) / (2 * h) - compliance[:3, k]).max() < 1e-7
        # The energy grows by the work of the force along the motion that it causes.
        gained = force @ compliance[:3, k]
        assert (more.energy - less.energy) / (2 * h) == pytest.approx(gained, rel=1e-6)


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
    with pytest.raises(InputError, match="bundle robot carries forces of fixed direction"):
        robot.fk(alpha, shift, load=Load(gravity=(0, 0, -9.81)))
    with pytest.raises(InputError, match="supports concentric and eccentric robots only"):
        robot.ik([0.0, 0.0, 0.1])
    with pytest.raises(InputError, match="wrt names 'curvature'"):
        robot.fk(alpha, shift).jacobian(wrt=["curvature"])
    with pytest.raises(InputError, match=r"must be at least 0\.002 m apart"):
        BundleRobot(robot.tubes[:2], (0.0005, 0.0005), (0.0, np.pi))
    with pytest.raises(InputError, match="offset has 1 numbers; it must have 3"):
        BundleRobot(robot.tubes, (0.003,), (0.0, 1.0, 2.0))
    with pytest.raises(InputError, match=r"must be at least 0\.012 m to contain the tubes"):
        BundleRobot(robot.tubes, robot.offset, robot.angle, sheath_diameter=0.01)
    with pytest.raises(InputError, match="the last tube ends at"):
        robot.fk(alpha, shift, load=Load(points=((0.3, (0.1, 0.0, 0.0)),)))
