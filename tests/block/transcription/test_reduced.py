"""The condensed equations: gradient and Hessian of an energy, and a margin that means what it says."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from scipy.integrate import solve_ivp

from benchmarks.shooting import sections_of
from tests.examples import CRL, DEG, MM, THESIS, TWO_TUBE, eccentric_assembly, newton, opposed, poses, unstable_home
from tubeopt import ConcentricRobot, Discretisation, Equilibrium, forward_kinematics
from tubeopt.block.transcription.mesh import make_mesh
from tubeopt.block.transcription.reduced import ReducedProblem, evaluate, reduce, residual, to_unknowns
from tubeopt.block.transcription.second_variation import margin
from tubeopt.equilibrium.kinematics import to_equilibrium
from tubeopt.equilibrium.problem import DEFAULT_DISCRETISATION, reduced_problem
from tubeopt.typing import Array

ROTATIONS = np.array([0.3, -0.8, 2.0])


def problems() -> list[ReducedProblem]:
    eccentric = eccentric_assembly()
    return [
        reduced_problem(THESIS, (0.06, 0.03, 0.0), DEFAULT_DISCRETISATION),
        reduced_problem(CRL, (-0.01, -0.05, 0.005), Discretisation("radau", 4)),
        reduce(eccentric, make_mesh(eccentric, degree=4)),
    ]


@pytest.mark.parametrize("problem", problems(), ids=["gauss", "radau", "eccentric"])
def test_slopes_by_finite_differences(problem: ReducedProblem) -> None:
    z = np.random.default_rng(1).normal(size=problem.size) * 0.02
    current = evaluate(problem, ROTATIONS, z)
    gradient, hessian, h = current.gradient.copy(), current.hessian.copy(), 1e-6
    for k, step in enumerate(np.eye(problem.size) * h):
        ahead, behind = (evaluate(problem, ROTATIONS, z + sign * step) for sign in (1, -1))
        assert hessian[:, k] == pytest.approx((ahead.gradient - behind.gradient) / (2 * h), abs=1e-7)
        if not problem.assembly.eccentric:
            # Tubes beside the centreline have no such energy, only equations.
            assert gradient[k] == pytest.approx((ahead.energy - behind.energy) / (2 * h), abs=1e-8)
    if not problem.assembly.eccentric:
        assert hessian == pytest.approx(hessian.T, abs=1e-13)


@pytest.mark.parametrize("family", ["gauss", "radau"])
def test_energy_is_stationary_at_the_equilibrium(family: str) -> None:
    problem = reduced_problem(THESIS, (0.0, 0.02, -0.01), Discretisation(family))
    solved = newton(problem, ROTATIONS, np.zeros(problem.size))
    assert solved.converged
    random = np.random.default_rng(2)
    for _ in range(10):
        step = random.normal(size=problem.size) * 1e-4
        sides = [evaluate(problem, ROTATIONS, solved.state.z + sign * step).energy for sign in (1, -1)]
        # The first order vanishes, and a stable equilibrium is a minimum.
        assert sides[0] - sides[1] == pytest.approx(0.0, abs=1e-6 * np.linalg.norm(step))
        assert min(sides) > solved.state.energy


def test_unknowns_there_and_back() -> None:
    problem = reduced_problem(THESIS, (0.06, 0.03, 0.0), DEFAULT_DISCRETISATION)
    z = np.random.default_rng(3).normal(size=problem.size) * 0.02
    theta = evaluate(problem, ROTATIONS, z).theta
    assert to_unknowns(problem, ROTATIONS, theta) == pytest.approx(z, abs=1e-12)


def test_residual_is_an_angle() -> None:
    problem = reduced_problem(THESIS, (0.0, 0.0, 0.0), DEFAULT_DISCRETISATION)
    solved = newton(problem, ROTATIONS, np.zeros(problem.size)).state
    theta = solved.theta.copy()
    theta[5, 1] += 1e-6
    wrong = evaluate(problem, ROTATIONS, to_unknowns(problem, ROTATIONS, theta))
    # One rotation is wrong by 1e-6 rad: so is its equation, but for the little that it changes the moments.
    assert residual(problem, wrong) == pytest.approx(1e-6, rel=0.02)
    assert residual(problem, solved) < 1e-12


# --- the margin -----------------------------------------------------------------------------------------------------


def stability_determinant(equilibrium: Equilibrium, scale: float) -> tuple[float, float]:
    """For torsional stiffnesses `scale` kt: least det Y(s) on the arm, and det(Y(0) - |beta| Y'(0)), by DOP853 from
    Y = 1, Y' = 0 at the tip along the solved rotations."""
    robot, n = equilibrium.robot, equilibrium.robot.n_tubes
    kt = np.array([tube.torsional_stiffness for tube in robot.tubes])
    lever = np.array([tube.straight_length for tube in robot.tubes]) - equilibrium.translations
    state = np.concatenate([equilibrium.rotation[:, -1], np.zeros(n), np.eye(n).ravel(), np.zeros(n * n)])
    smallest = 1.0
    for section in reversed(sections_of(robot, equilibrium.translations)):

        def slope(_: float, y: Array, coupling: Array = section.coupling) -> Array:
            apart = y[:n, None] - y[:n]
            spring = coupling * np.cos(apart)
            stiffness = (np.diag(spring.sum(1)) - spring) / (scale * kt)[:, None]
            force = (coupling * np.sin(apart)).sum(1) / kt
            variation = y[2 * n :].reshape(2, n, n)
            return np.concatenate([y[n : 2 * n], force, variation[1].ravel(), (stiffness @ variation[0]).ravel()])

        run = solve_ivp(slope, (section.stop, section.start), state, method="DOP853", rtol=1e-10, atol=1e-10)
        state = run.y[:, -1]
        smallest = min(smallest, *(np.linalg.det(y[2 * n : 2 * n + n * n].reshape(n, n)) for y in run.y.T))
    y, twist = state[2 * n :].reshape(2, n, n)
    return smallest, float(np.linalg.det(y - lever[:, None] * twist))


@pytest.mark.parametrize(
    ("robot", "rotations", "translations"),
    [
        (THESIS, (0.0, np.pi / 2, np.pi), (0.0, 0.0, 0.0)),
        (THESIS, (2.3, -1.0, 1.8), (-40.0, 28.0, 47.0)),
        (THESIS, (1.2, -0.2, -1.8), (56.0, -118.0, 38.0)),
        (CRL, (0.8, -0.8, 1.9), (0.0, -36.0, -12.0)),
        (CRL, (-1.0, 2.7, 2.4), (60.0, -25.0, -27.0)),
        (opposed(0.9), (2.9, 0.0), (0.0, 0.0)),
    ],
)
def test_margin_is_the_share_of_torsional_stiffness_that_can_be_lost(
    robot: ConcentricRobot, rotations: tuple[float, ...], translations: tuple[float, ...]
) -> None:
    solved = forward_kinematics(robot, rotations, np.array(translations) * MM)
    assert 0 < solved.margin < 0.999
    retained = 1 - solved.margin
    # With all stiffness but the margin the arm is just neutral; with any more it is stable, with less no longer.
    assert stability_determinant(solved, retained * (1 - 1e-5))[1] < 0
    for scale in (retained * (1 + 1e-5), retained * 1.1, retained + 0.5 * solved.margin, 1.0):
        within, base = stability_determinant(solved, scale)
        assert within > 0
        assert base > 0


def test_margin_of_an_unstable_equilibrium() -> None:
    # (pi, 0, 0): design number. Nearly twice its torsional stiffness would be needed to hold it.
    solution = unstable_home(THESIS, np.array([np.pi, 0.0, 0.0]))
    assert solution.margin == pytest.approx(-0.95567, abs=1e-4)
    solved = to_equilibrium(solution, "tubes without torsion")
    assert stability_determinant(solved, (1 - solved.margin) * (1 - 1e-5))[1] < 0
    within, base = stability_determinant(solved, (1 - solved.margin) * (1 + 1e-5))
    assert min(within, base) > 0


def test_closed_form_of_the_margin_of_two_opposed_tubes() -> None:
    # V'' = -c (1, -1; -1, 1) all along: neutral where sqrt(c / scale) L = pi / 2, c the rate for full stiffness.
    robot = opposed()
    solution = unstable_home(robot, np.array([0.0, np.pi]))
    kb, kt = (np.array([getattr(t, f"{k}_stiffness") for t in robot.tubes]) for k in ("bending", "torsional"))
    m = kb[0] * robot.tubes[0].curvature
    c = m**2 / kb.sum() * (1 / kt).sum()
    assert solution.margin == pytest.approx(1 - c * 0.1**2 / (np.pi / 2) ** 2, abs=1e-9)


def test_margin_vanishes_at_the_fold() -> None:
    # The snap of the two-tube file at 203.90356628 deg, from the closed form; next to it the margin goes as a root.
    fold = 203.90356628
    home = forward_kinematics(TWO_TUBE, (0.0, 0.0))
    near = [forward_kinematics(TWO_TUBE, ((fold - gap) * DEG, 0.0), start=home).margin for gap in (4e-4, 1e-4)]
    assert near[1] == pytest.approx(0.0, abs=5e-3)
    assert near[0] / near[1] == pytest.approx(2.0, rel=1e-2)


@given(poses())
@settings(max_examples=40)
def test_margin_never_exceeds_one(pose: tuple[ConcentricRobot, Array, Array]) -> None:
    robot, rotations, shift = pose
    problem = reduced_problem(robot, tuple(shift.tolist()), DEFAULT_DISCRETISATION)
    z = np.random.default_rng(4).normal(size=problem.size) * 0.1
    assert margin(problem, evaluate(problem, rotations, z)) <= 1
