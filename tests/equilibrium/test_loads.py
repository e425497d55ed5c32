"""Forward kinematics under load, against shooting, closed forms, differences and balances."""

from __future__ import annotations

import dataclasses
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc

from tests.load_reference import RefLoad, Shooting, of_robot
from tubeopt import (
    ConcentricRobot,
    Discretisation,
    Equilibrium,
    InputError,
    Load,
    Material,
    SolveError,
    Tube,
    follow,
    forward_kinematics,
    load_equilibrium,
    load_robot,
)
from tubeopt.block.transcription.loaded import evaluate
from tubeopt.equilibrium.continuation import Family, reach
from tubeopt.equilibrium.kinematics import point_of, to_equilibrium
from tubeopt.equilibrium.member import Loaded
from tubeopt.equilibrium.problem import loaded_problem
from tubeopt.robots.load import between
from tubeopt.robots.order import twisted_tube
from tubeopt.robots.tubes import mass_per_length
from tubeopt.solvers.compiled.binding import kernel_of
from tubeopt.typing import Array
from tubeopt.validation.model import about_z

MM = 1e-3
ROTATIONS = (0.0, 1.0, 2.0)

WOUND = (0.0, 2.0, 3.5)
"""Where the margin is far from 1, which takes fewer points."""


@pytest.fixture(scope="module")
def thesis() -> ConcentricRobot:
    robot = load_robot("configs/robots/thesis_ctr.yaml")
    assert isinstance(robot, ConcentricRobot)
    return robot


def rod(length: float, stiffness: float, shear: float | None = None, curvature: float = 0.0) -> ConcentricRobot:
    """One tube, all of it in front of the plate, of given EI and GJ (by default of a Poisson's ratio of 0)."""
    inertia = np.pi / 64 * 1e-12
    young = stiffness / inertia
    material = Material("m", young, young / 2 if shear is None else shear / (2 * inertia))
    return ConcentricRobot((Tube(1e-3, 0.0, 0.0, length, curvature, material),))


def base_values(e: Equilibrium) -> Array:
    """(n + 2,) torques and bending moment at the plate, where shooting may start."""
    point = point_of(e)
    torque = -(point.member.problem.torsion.weight @ point.state.torque)
    if point.member.problem.couples is not None:
        torque[point.member.problem.tip_tube] += point.state.joint_torques[0]
    return np.concatenate([torque, e.base_wrench[3:5]])


def test_thesis_robot_under_a_tip_force(thesis: ConcentricRobot) -> None:
    e = forward_kinematics(thesis, ROTATIONS, load=Load((0.1, 0, 0)))
    assert np.allclose(e.tip_position / MM, (102.947988424, -23.162540628, 151.322371031), rtol=0, atol=1e-9 / MM)
    assert e.margin == pytest.approx(0.997097260, abs=1e-8)
    assert e.base_wrench[4] == pytest.approx(15.132237103e-3, abs=1e-12)
    assert e.stable
    assert e.mesh_error < 1e-8


def test_thesis_robot_under_a_dead_moment(thesis: ConcentricRobot) -> None:
    e = forward_kinematics(thesis, ROTATIONS, load=Load(moment=(0.01, 0.02, 0.005)))
    assert np.allclose(e.tip_position / MM, (117.806430837, 9.175066896, 113.932715259), rtol=0, atol=1e-9 / MM)
    assert e.stable
    assert np.isnan(e.potential)


def test_thesis_robot_under_its_weight(thesis: ConcentricRobot, monkeypatch: pytest.MonkeyPatch) -> None:
    masses = dict(zip(thesis.tubes, (0.02, 0.05, 0.05), strict=True))
    monkeypatch.setattr("tubeopt.robots.load.mass_per_length", masses.get)
    e = forward_kinematics(thesis, ROTATIONS, load=Load((0, 0, -0.1), gravity=(0, -9.81, 0)))
    assert np.allclose(e.tip_position / MM, (84.834622201, -69.410646557, 143.478730193), rtol=0, atol=1e-9 / MM)
    assert e.margin == pytest.approx(0.640786858, abs=1e-8)


def test_crl_robot_under_a_tip_force() -> None:
    robot = load_robot("configs/robots/crl_ctr.yaml")
    shift = np.array([-0.06, -0.04, -0.01]) + [tube.straight_length for tube in robot.tubes]
    e = forward_kinematics(robot, np.radians([0, 60, 120]), shift, load=Load((0.02, 0.03, -0.01)))
    assert np.allclose(e.tip_position / MM, (58.342762250, 14.566019835, 125.987301931), rtol=0, atol=1e-9 / MM)
    assert e.margin == pytest.approx(0.981607991, abs=1e-8)


def test_straight_cantilever_is_an_elastica() -> None:
    length, stiffness, force = 0.2, 1e-3, 0.5
    e = forward_kinematics(rod(length, stiffness), [0.0], load=Load((force, 0, 0)))
    assert np.allclose(e.tip_position / MM, (173.739179657, 0, 63.222886487), rtol=0, atol=1e-9 / MM)
    # Bisshopp and Drucker, Quart. Appl. Math. 3 (1945), by elliptic integrals of modulus k.
    ratio = np.sqrt(force * length**2 / stiffness)

    def excess(k: float) -> float:
        return float(ellipk(k**2) - ellipkinc(np.arcsin(1 / (k * np.sqrt(2))), k**2) - ratio)

    k = brentq(excess, np.sqrt(0.5) + 1e-12, 1 - 1e-12, xtol=1e-15)
    across = 1 - 2 / ratio * (ellipe(k**2) - ellipeinc(np.arcsin(1 / (k * np.sqrt(2))), k**2))
    along = np.sqrt(2 * (2 * k**2 - 1)) / ratio
    assert np.allclose(e.tip_position, length * np.array([across, 0, along]), rtol=0, atol=1e-11)


def test_margin_is_zero_at_eulers_load() -> None:
    robot, unit = rod(0.2, 1e-3), 1e-3 / 0.2**2
    for ratio in (0.5, np.pi**2 / 4 - 1e-4):
        e = forward_kinematics(robot, [0.0], load=Load((0, 0, -ratio * unit)))
        # The second variation of a compressed column is that of its stiffness less 4 / pi^2 of the load.
        assert e.margin == pytest.approx(1 - ratio * 4 / np.pi**2, abs=1e-8)
    with pytest.raises(SolveError, match=r"bifurcates at 98\."):
        forward_kinematics(robot, [0.0], load=Load((0, 0, -2.5 * unit)))


def test_forty_five_degree_bend() -> None:
    stiffness = 1e7 / 12
    robot = rod(100 * np.pi / 4, stiffness, stiffness, 0.01)
    e = forward_kinematics(robot, [0.0], load=Load((600.0, 0, 0)))
    assert e.tip_position[0] == pytest.approx(53.46860, abs=5e-6)


def test_without_load_all_is_as_without_loads(thesis: ConcentricRobot) -> None:
    for rotations, shift in ((ROTATIONS, None), ((0.3, -1.0, 0.5), (-0.05, 0.01, 0.02))):
        plain = forward_kinematics(thesis, rotations, shift)
        e = forward_kinematics(thesis, rotations, shift, load=Load())
        # The shape without load is integrated by steps whose own error shows.
        assert np.allclose(e.tip_position, plain.tip_position, rtol=0, atol=1e-12 + 2 * plain.tip_error)
        assert np.allclose(e.tip_rotations, plain.tip_rotations, rtol=0, atol=1e-9)
        assert e.margin == pytest.approx(plain.margin, abs=1e-9)
        assert e.energy == pytest.approx(plain.energy, abs=1e-12)
        assert np.abs(e.base_wrench).max() < 1e-17
        assert np.allclose(e.compliance, plain.compliance, rtol=0, atol=1e-6)


def test_hessian_without_load_is_that_of_torsion_beside_the_identity(thesis: ConcentricRobot) -> None:
    problem = loaded_problem(thesis, (0.0, 0.0, 0.0), Load((1.0, 2.0, 3.0)))
    random = np.random.default_rng(1)
    state = evaluate(problem, np.array(ROTATIONS), random.normal(size=problem.size) * 0.1, 0.0)
    split = problem.torsion.size
    assert not state.hessian[:split, split:].any()
    assert np.array_equal(state.hessian[split:, split:], np.eye(problem.size - split))


@pytest.mark.parametrize(
    "load",
    [
        Load((0.2, -0.1, 0.05), gravity=(0, -9.81, 0), points=((0.06, (0.1, 0.2, -0.1)),)),
        Load((0.05, 0, -0.05), distributed=((0.03, 0.12, (0.3, 0.1, 0.0)),)),
        Load((0.05, 0.02, -0.05), (0.003, 0.004, 0.005)),
        Load((0.05, 0.02, -0.05), (0.003, 0.004, 0.005), frame="tip", gravity=(1, 2, 3)),
    ],
)
def test_jacobian_is_that_of_differences(thesis: ConcentricRobot, load: Load) -> None:
    problem = loaded_problem(thesis, (0.0, 0.0, 0.0), load)
    random = np.random.default_rng(2)
    x, factor, alpha = random.normal(size=problem.size) * 0.03, 0.8, np.array(ROTATIONS)
    state = evaluate(problem, alpha, x, factor)
    for direction in random.normal(size=(3, problem.size)):
        sides = [evaluate(problem, alpha, x + step * direction, factor) for step in (1e-5, -1e-5)]
        change = (sides[0].gradient - sides[1].gradient) / 2e-5
        scale = np.linalg.norm(state.hessian @ direction)
        assert np.linalg.norm(state.hessian @ direction - change) < 1e-7 * scale
        if load.has_energy:
            rate = (sides[0].potential - sides[1].potential) / 2e-5
            assert state.gradient @ direction == pytest.approx(rate, abs=1e-8)
    pull = (evaluate(problem, alpha, x, 0.9).gradient - evaluate(problem, alpha, x, 0.7).gradient) / 0.2
    assert np.allclose(state.load_slope, pull, rtol=0, atol=1e-12)


def tube_frame(e: Equilibrium) -> Array:
    """(3, 3) frame of the tube that ends last, at its end."""
    angle = e.tip_rotations[int(np.argmax(e.tube_end))]
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray(e.tip_rotation @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]))


@pytest.mark.parametrize(
    ("force", "moment"),
    [((0, 0, 0), (0, 0, 0)), ((0.1, -0.05, 0.02), (0, 0, 0)), ((0.05, 0.0, 0.0), (0.002, 0.003, 0.004))],
)
def test_compliance_is_symmetric_and_that_of_differences(thesis: ConcentricRobot, force: Any, moment: Any) -> None:
    shift = (0.0, 0.01, -0.02)
    current = forward_kinematics(thesis, WOUND, shift, load=Load(force, moment))
    compliance = current.compliance
    if not any(moment):
        assert np.abs(compliance - compliance.T).max() < 1e-10 * np.abs(compliance).max()
    for k in range(6):
        step = np.zeros(6)
        step[k] = 1e-4 if k < 3 else 1e-6
        sides = [
            forward_kinematics(thesis, WOUND, shift, load=Load(force + s * step[:3], moment + s * step[3:]))
            for s in (1, -1)
        ]
        moved = (sides[0].tip_position - sides[1].tip_position) / (2 * step[k])
        turn = (tube_frame(sides[0]) - tube_frame(sides[1])) @ tube_frame(current).T / (2 * step[k])
        turned = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
        assert np.abs(compliance[:3, k] - moved).max() < 1e-6 * np.abs(compliance[:3]).max()
        assert np.abs(compliance[3:, k] - turned).max() < 1e-6 * np.abs(compliance[3:]).max()


@pytest.mark.parametrize(("at", "pushed"), [(0.03, [0]), (0.06, [1]), (0.12, [0, 1, 2])])
def test_compliance_along_the_arm_is_that_of_differences(thesis: ConcentricRobot, at: float, pushed: list[int]) -> None:
    current = forward_kinematics(thesis, WOUND, load=Load((0.1, -0.05, 0.02), points=((at, (0, 0, 0)),)))
    compliance = forward_kinematics(thesis, WOUND, load=Load((0.1, -0.05, 0.02))).compliance_at(at)
    assert np.abs(compliance - compliance.T).max() < 1e-10 * np.abs(compliance).max()
    for k in pushed:
        push = 1e-3 * np.eye(3)[k]
        sides = [
            forward_kinematics(thesis, WOUND, load=Load((0.1, -0.05, 0.02), points=((at, tuple(s * push)),)))
            for s in (1, -1)
        ]
        position = [np.argmin(np.abs(e.arc_length - at)) for e in (*sides, current)]
        assert abs(current.arc_length[position[2]] - at) < 1e-12
        moved = (sides[0].position[position[0]] - sides[1].position[position[1]]) / 2e-3
        assert np.abs(compliance[:3, k] - moved).max() < 1e-5 * np.abs(compliance[:3]).max()
        turn = (sides[0].frame[position[0]] - sides[1].frame[position[1]]) @ current.frame[position[2]].T / 2e-3
        turned = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
        # Of the frame, which has not the tube's twist in it: alike across the arm.
        across = np.eye(3) - np.outer(current.frame[position[2]][:, 2], current.frame[position[2]][:, 2])
        assert np.abs(across @ (compliance[3:, k] - turned)).max() < 1e-5 * np.abs(compliance[3:]).max()


@pytest.mark.parametrize(
    "load",
    [
        Load((0.05, -0.02, 0.0), moment=(2e-3, 1e-3, -1e-3)),
        Load((0.05, -0.02, 0.03), moment=(1e-3, 0.0, 1e-3), frame="tip"),
        Load(points=((0.04, (0.0, 0.02, 0.0), (1e-3, 0.0, 2e-3)),)),
    ],
)
def test_compliance_along_the_arm_under_moments_is_that_of_differences(thesis: ConcentricRobot, load: Load) -> None:
    at = 0.08
    compliance = forward_kinematics(thesis, WOUND, load=load).compliance_at(at)

    def pushed(push: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Position and frame of the tube that the moment twists."""
        e = forward_kinematics(
            thesis, WOUND, load=dataclasses.replace(load, points=(*load.points, (at, tuple(push[:3]), tuple(push[3:]))))
        )
        k = int(np.argmin(np.abs(e.arc_length - at)))
        assert abs(e.arc_length[k] - at) < 1e-12
        return e.position[k], e.frame[k] @ about_z(e.rotation[int(twisted_tube(e.tube_end, at)), k])

    _, frame = pushed(np.zeros(6))
    for k, step in enumerate(np.diag([1e-3] * 3 + [1e-5] * 3)):
        (ahead, ahead_frame), (behind, behind_frame) = pushed(step), pushed(-step)
        moved = (ahead - behind) / (2 * step[k])
        turn = (ahead_frame - behind_frame) @ frame.T / (2 * step[k])
        turned = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
        assert np.abs(compliance[:3, k] - moved).max() < 1e-6 * np.abs(compliance[:3]).max()
        assert np.abs(compliance[3:, k] - turned).max() < 1e-6 * np.abs(compliance[3:]).max()


def test_compliance_along_the_arm_ends_at_the_tip(thesis: ConcentricRobot) -> None:
    e = forward_kinematics(thesis, WOUND, load=Load((0.1, -0.05, 0.02)))
    assert np.allclose(e.compliance_at(e.arc_length[-1], 0), e.compliance, rtol=1e-10, atol=1e-12)
    # A straight tube gives way in torsion in proportion to the distance, and in bending as a cantilever.
    column = rod(0.2, 1e-3)
    reached = forward_kinematics(column, [0.0]).compliance_at(0.1)
    assert reached[5, 5] == pytest.approx(0.1 / column.tubes[0].torsional_stiffness, rel=1e-12)
    assert reached[0, 0] == pytest.approx(0.1**3 / 3e-3, rel=1e-12)
    with pytest.raises(InputError, match="it must be on the arm"):
        e.compliance_at(1.0)
    with pytest.raises(InputError, match="tube is 2; tubes 0 are at"):
        e.compliance_at(e.arc_length[-1], 2)


@pytest.mark.parametrize(
    "load", [Load((0.1, -0.05, 0.02), gravity=(0, 0, -9.81)), Load((0.02, 0, 0), (0.002, 0, 0.001))]
)
def test_jacobian_under_load_is_that_of_differences(thesis: ConcentricRobot, load: Load) -> None:
    shift = np.array([-0.02, 0.01, -0.005])
    current = forward_kinematics(thesis, WOUND, shift, load=load)
    slopes = current.jacobian()
    for k in (2, 3):
        step = np.zeros(6)
        step[k] = 1e-3 if k < 3 else 1e-5
        sides = [
            forward_kinematics(thesis, WOUND + s * step[:3], shift + s * step[3:], load=load, start=current)
            for s in (1, -1)
        ]
        scale = 2 * step[k]
        moved = (sides[0].tip_position - sides[1].tip_position) / scale
        assert np.abs(slopes.position[:, k] - moved).max() < 1e-5 * np.abs(slopes.position).max()
        tips = (sides[0].tip_rotations - sides[1].tip_rotations) / scale
        assert np.abs(slopes.tip_rotations[:, k] - tips).max() < 1e-5 * np.abs(slopes.tip_rotations).max()
        if load.has_energy:
            assert slopes.margin[k] == pytest.approx((sides[0].margin - sides[1].margin) / scale, abs=2e-3)
        rate = (sides[0].energy - sides[1].energy) / scale
        assert slopes.energy[k] == pytest.approx(rate, abs=1e-5 * np.abs(slopes.energy).max())


def test_jacobian_under_load_to_one_side(thesis: ConcentricRobot) -> None:
    load = Load((0.1, 0, 0))
    home = forward_kinematics(thesis, ROTATIONS, load=load)
    for side in (1, -1):
        column = home.jacobian(wrt=("translations",), side=side).position[:, 0]
        moved = forward_kinematics(thesis, ROTATIONS, (side * 1e-6, 0, 0), load=load, start=home)
        assert np.allclose(column, (moved.tip_position - home.tip_position) / (side * 1e-6), rtol=0, atol=1e-4)
    with pytest.raises(InputError, match="wrt names 'colour'; it may name rotations"):
        home.jacobian(wrt=("colour",))


@pytest.mark.parametrize("shift", [(-0.02, 0.01, -0.005), None])
def test_jacobian_under_load_by_dimensions(thesis: ConcentricRobot, shift: tuple[float, float, float] | None) -> None:
    """Also at home, where all tubes begin to curve at the plate and a length moves their ends only."""
    load = Load((0.1, -0.05, 0.02))
    current = forward_kinematics(thesis, WOUND, shift, load=load)
    for name, k, step in (("curvature", 0, 1e-4), ("curved_length", 2, 1e-6), ("bending_stiffness", 1, 1e-5)):
        slopes = current.jacobian(wrt=(name,)).position
        size = step * getattr(thesis.tubes[k], name)
        tips = []
        for sign in (1, -1):
            tubes = list(thesis.tubes)
            tubes[k] = dataclasses.replace(tubes[k], **{name: getattr(tubes[k], name) + sign * size})
            changed = dataclasses.replace(thesis, tubes=tuple(tubes))
            tips.append(forward_kinematics(changed, WOUND, shift, load=load).tip_position)
        moved = (tips[0] - tips[1]) / (2 * size)
        assert np.abs(slopes[:, k] - moved).max() < 2e-4 * np.abs(slopes).max()


def test_work_done_is_energy_stored(thesis: ConcentricRobot) -> None:
    force = np.array([0.08, 0.05, -0.03])
    nodes, weights = np.polynomial.legendre.leggauss(10)
    work = 0.0
    for x, w in zip((nodes + 1) / 2, weights / 2, strict=True):
        e = forward_kinematics(thesis, ROTATIONS, load=Load(x * force))
        work += w * x * force @ e.compliance[:3, :3] @ force
    plain = forward_kinematics(thesis, ROTATIONS, load=Load())
    full = forward_kinematics(thesis, ROTATIONS, load=Load(force))
    assert full.energy - plain.energy == pytest.approx(work, rel=1e-9)
    assert full.work == pytest.approx(force @ full.tip_position, abs=1e-15)


def test_base_wrench_balances_the_loads(thesis: ConcentricRobot) -> None:
    at, force, push = 0.07, np.array([0.05, -0.02, 0.01]), np.array([0.1, 0.1, -0.1])
    for load in (
        Load(force, points=((at, push),)),
        Load(force, (0.002, -0.001, 0.003), points=((at, push),)),
        Load(force, (0.002, -0.001, 0.003), frame="tip", points=((at, push),)),
    ):
        e = forward_kinematics(thesis, ROTATIONS, load=load)
        reached = e.position[np.argmin(np.abs(e.arc_length - at))]
        turn = e.tip_rotation if load.frame == "tip" else np.eye(3)
        moment = turn @ load.moment + np.cross(e.tip_position, turn @ force) + np.cross(reached, push)
        assert np.allclose(e.base_wrench, np.concatenate([turn @ force + push, moment]), rtol=0, atol=1e-12)


def test_weight_is_that_of_the_tubes_in_front_of_the_plate(thesis: ConcentricRobot) -> None:
    e = forward_kinematics(thesis, ROTATIONS, load=Load(gravity=(0, 0, -9.81)))
    density = 6450.0
    weight = sum(
        density * np.pi / 4 * (t.outer_diameter**2 - t.inner_diameter**2) * t.curved_length * 9.81 for t in thesis.tubes
    )
    assert np.allclose(e.base_wrench[:3], (0, 0, -weight), rtol=1e-13)


def random_case(seed: int) -> tuple[ConcentricRobot, Array, Array, Load, RefLoad]:
    """A robot of 2 to 4 tubes, joint values, and a load of up to 30 % of linear deflection."""
    random = np.random.default_rng(seed)
    tubes, bore, length = [], 0.4e-3, random.uniform(0.12, 0.3)
    for i in range(int(random.integers(2, 5))):
        outer, straight = bore + random.uniform(0.15e-3, 0.35e-3), random.uniform(0.2, 0.7) * length
        young, nu = random.uniform(40e9, 75e9), random.uniform(0.2, 0.45)
        material = Material("m", young, young / 2 / (1 + nu))
        curvature = random.uniform(2, 14) * random.choice([-1, 1])
        tubes.append(Tube(outer, bore if i else 0.3e-3, straight, length - straight, curvature, material))
        bore, length = outer + 0.05e-3, length * random.uniform(0.6, 0.95)
    robot = ConcentricRobot(tuple(tubes))
    straight_lengths = np.array([tube.straight_length for tube in tubes])
    beta = np.maximum(np.sort(-straight_lengths * random.uniform(0.05, 1, len(tubes))), -straight_lengths)
    alpha = random.uniform(-np.pi, np.pi, len(tubes))
    plain = forward_kinematics(robot, alpha, beta + straight_lengths)
    force = random.normal(size=3)
    reach = float(np.linalg.norm(plain.compliance[:3, :3] @ force))
    force *= random.uniform(0.03, 0.3) * plain.arc_length[-1] / reach
    points = ((random.uniform(0.1, 0.9) * plain.arc_length[-1], tuple(0.5 * force[::-1])),)
    return robot, alpha, beta + straight_lengths, Load(force, points=points), RefLoad(tuple(force), points=points)


@pytest.mark.parametrize("seed", range(3))
def test_random_robots_against_shooting(seed: int) -> None:
    robot, alpha, shift, load, same = random_case(seed)
    e = forward_kinematics(robot, alpha, shift, load=load)
    beta = shift - [tube.straight_length for tube in robot.tubes]
    shooting = Shooting(of_robot(robot), beta, alpha, same)
    shot = shooting.solve(base_values(e))
    assert shot.residual < 1e-12
    assert np.linalg.norm(shot.tip - e.tip_position) < 1e-11
    assert np.abs(shot.frame - e.tip_rotation).max() < 1e-9
    assert e.stable == bool((shooting.determinants(shot) > 0).all())


def under_load(plain: Equilibrium, load: Load, degree: int) -> Equilibrium:
    """The equilibrium into which one grows with a load, on pieces of so many points."""
    start = point_of(plain, load, Discretisation(degree=degree))
    return to_equilibrium(reach(Family.growing(start.member), start), "the load before")


def test_the_estimated_error_is_that_of_coarse_meshes(thesis: ConcentricRobot) -> None:
    load = Load((0.3, 0.1, -0.1))
    plain = forward_kinematics(thesis, ROTATIONS)
    exact = forward_kinematics(thesis, ROTATIONS, load=load, tolerance=1e-11)
    for degree in (2, 3, 4):
        e = under_load(plain, load, degree)
        error = float(np.linalg.norm(e.tip_position - exact.tip_position))
        assert error / 2 < e.tip_error < 2 * error


def test_the_estimated_error_of_rotations_is_not_below_the_true_one(thesis: ConcentricRobot) -> None:
    plain = forward_kinematics(thesis, ROTATIONS)
    for load in (Load((0.3, 0.1, -0.1)), Load(gravity=(0.0, -9.81, 0.0))):
        exact = forward_kinematics(thesis, ROTATIONS, load=load, tolerance=1e-12)
        for degree in (2, 3, 4):
            e = under_load(plain, load, degree)
            at = np.abs(exact.arc_length[:, None] - e.arc_length)
            mine, its = at.min(0) < 1e-12, at.argmin(0)
            true = np.abs(e.rotation[:, mine] - exact.rotation[:, its[mine]]).max()
            assert true < e.mesh_error < 20 * true


def test_a_guess_is_followed_to_other_joints_and_loads(thesis: ConcentricRobot) -> None:
    current = forward_kinematics(thesis, ROTATIONS, load=Load((0.1, 0, 0)))
    for rotations, load in (
        ((0.02, 1.0, 2.0), Load((0.1, 0, 0))),
        ((0.9, 1.5, 1.6), Load((0.1, 0.05, -0.02))),
        (ROTATIONS, Load((0.0, 0.3, 0.0), gravity=(0, 0, -9.81))),
    ):
        cold = forward_kinematics(thesis, rotations, load=load)
        warm = forward_kinematics(thesis, rotations, load=load, start=current)
        assert warm.statistics.start == "guess"
        assert np.allclose(warm.tip_position, cold.tip_position, rtol=0, atol=1e-12)
    moved = forward_kinematics(thesis, ROTATIONS, (-0.03, 0.0, 0.01), load=Load((0.1, 0, 0)), start=current)
    cold = forward_kinematics(thesis, ROTATIONS, (-0.03, 0.0, 0.01), load=Load((0.1, 0, 0)))
    assert np.allclose(moved.tip_position, cold.tip_position, rtol=0, atol=1e-12)


def test_far_ways_from_a_guess_are_those_of_the_general_solver(monkeypatch: pytest.MonkeyPatch) -> None:
    robot, alpha, shift, load, _ = random_case(4)
    current = forward_kinematics(robot, alpha, shift, load=load)
    elsewhere = forward_kinematics(robot, alpha + 0.4, shift)
    turned = alpha + np.linspace(1, -0.5, len(alpha))
    paths = (
        (turned, load, current),
        (alpha, load.scaled(0.5), current),
        (alpha, load, elsewhere),
        (turned, None, elsewhere),
    )
    ends = [forward_kinematics(robot, a, shift, load=q, start=g) for a, q, g in paths]
    with monkeypatch.context() as patch:
        patch.setattr("tubeopt.equilibrium.kinematics.loaded", lambda *arguments: None)
        patch.setattr("tubeopt.equilibrium.kinematics.unloaded", lambda *arguments: None)
        for end, (a, q, g) in zip(ends, paths, strict=True):
            general = forward_kinematics(robot, a, shift, load=q, start=g)
            assert np.allclose(end.tip_position, general.tip_position, rtol=0, atol=1e-12)
            assert end.margin == pytest.approx(general.margin, abs=1e-9)
    if kernel_of(robot) is None:
        return
    monkeypatch.setattr("tubeopt.equilibrium.kinematics._to_tolerance", None)  # the kernel goes all of the way
    for a, q, g in paths:
        forward_kinematics(robot, a, shift, load=q, start=g)


def test_the_branch_that_snaps_is_not_left(thesis: ConcentricRobot) -> None:
    turned = follow(thesis, np.radians([[0, 0, 0], [200, 0, 0]])).equilibria[-1]
    assert turned.margin == pytest.approx(0.875, abs=1e-3)
    held = forward_kinematics(thesis, turned.rotations, load=Load((-0.0218, 0, 0)), start=turned)
    assert 0 < held.margin < 0.05
    with pytest.raises(SolveError, match=r"fold at 99\.") as lost:
        forward_kinematics(thesis, turned.rotations, load=Load((-0.0219, 0, 0)), start=turned)
    assert lost.value.solution.load.force[0] == pytest.approx(-0.021846, abs=1e-6)


def test_saved_loaded_copied(thesis: ConcentricRobot, tmp_path: Path) -> None:
    load = Load(
        (0.1, 0, 0), points=((0.05, (0.1, 0, 0)),), gravity=(0, 0, -9.81), distributed=((0.01, 0.05, (1, 2, 3)),)
    )
    e = forward_kinematics(thesis, ROTATIONS, load=load)
    e.save(tmp_path)
    for copy in (load_equilibrium(tmp_path), pickle.loads(pickle.dumps(e))):
        assert copy.load == load
        assert np.array_equal(copy.point_curvature, e.point_curvature)
        assert np.allclose(copy.compliance, e.compliance, rtol=1e-9)
    moved = forward_kinematics(thesis, ROTATIONS, load=Load(distributed=lambda s: (s, 0, 0)))
    with pytest.raises(InputError, match="a function"):
        moved.save(tmp_path)


def test_a_load_along_the_arm_may_be_a_function(thesis: ConcentricRobot) -> None:
    as_function = forward_kinematics(thesis, ROTATIONS, load=Load(distributed=lambda s: (0.1, 0.2, 0.0)))
    constant = forward_kinematics(thesis, ROTATIONS, load=Load(distributed=(0.1, 0.2, 0.0)))
    assert np.allclose(as_function.tip_position, constant.tip_position, rtol=0, atol=1e-14)
    half = Load(distributed=lambda s: (0.1, 0.2, 0.0)).scaled(0.5)
    assert np.array_equal(half.scaled(0.5).per_length(np.array([0.1]))[:, :3], [[0.025, 0.05, 0.0]])


def test_loads_between_two_loads() -> None:
    one = Load((1, 0, 0), distributed=(1, 0, 0), points=((0.1, (1, 0, 0)),))
    other = Load((0, 1, 0), gravity=(0, 0, 4), distributed=((0.0, 0.1, (0, 2, 0)),))
    mixed = between(one, other, 0.25)
    assert mixed.force == (0.75, 0.25, 0.0)
    assert mixed.gravity == (0, 0, 1)
    assert np.allclose(mixed.per_length(np.array([0.05, 0.15]))[:, :3], [(0.75, 0.5, 0), (0.75, 0, 0)])
    assert mixed.points[0].force == (0.75, 0, 0)
    with pytest.raises(InputError, match="frame"):
        between(one, dataclasses.replace(other, frame="tip"), 0.5)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"force": (1, 2)}, "force has 2 numbers; it must be 3 numbers"),
        ({"moment": (1, 2, float("nan"))}, "every number must be finite"),
        ({"frame": "base"}, "frame is 'base'; it must be one of world, tip"),
        ({"points": (0.1,)}, r"points\[0\] is 0.1; it must be \(arc length"),
        ({"points": ((-0.1, (0, 0, 1)),)}, r"arc length of points\[0\] is -0.1; it must be at least 0"),
        ({"distributed": ((0.2, 0.1, (0, 0, 1)),)}, r"end of distributed\[0\] is 0.1 m; it must be greater"),
    ],
)
def test_loads_that_make_no_sense(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Load(**arguments)


def test_what_is_not_there_under_load_says_so(thesis: ConcentricRobot) -> None:
    load = Load((0.01, 0, 0))
    e = forward_kinematics(thesis, ROTATIONS, load=load)
    eccentric = replace(load_robot("configs/robots/thesis_etr.yaml"), model="thesis")
    steel = rod(0.1, 1e-3)
    calls: list[tuple[Any, str]] = [
        (lambda: forward_kinematics(thesis, ROTATIONS, start=e), "start has a load"),
        (lambda: forward_kinematics(eccentric, (0, 1, 2), load=load), "model of the robot is thesis"),
        (lambda: forward_kinematics(thesis, ROTATIONS, load=Load(points=((0.3, (0, 0, 1)),))), "at most the length"),
        (lambda: forward_kinematics(steel, [0.0], load=Load(gravity=(0, 0, -9.81))), "but tube 1 has"),
        (lambda: forward_kinematics(thesis, ROTATIONS, load=(1, 2, 3)), "it must be a Load"),  # type: ignore[arg-type]
        (lambda: follow(thesis, [ROTATIONS, ROTATIONS], start=e), "has a load"),
    ]
    for call, message in calls:
        with pytest.raises(InputError, match=message):
            call()
    assert mass_per_length(steel.tubes[0]) is None
    with pytest.raises(InputError, match="no tube is in front of the base plate"):
        forward_kinematics(thesis, ROTATIONS, (-0.2, -0.15, -0.1), load=load)


def test_margin_is_one_without_coupling_or_compression() -> None:
    member = Loaded.of(rod(0.1, 1e-3), np.zeros(1), (0.0,), Load((0, 0, 1.0)))
    x = member.unknowns(np.zeros((len(member.problem.softness), 1)))
    assert member.margin(member.at(x)) == 1.0
