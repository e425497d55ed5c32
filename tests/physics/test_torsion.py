"""Torsion at one cross-section: moments as slopes of the energy, and the eccentric robot of the thesis."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import root

from tests.examples import DEG, MM, eccentric_assembly, newton
from tubeopt.block.transcription import arm as arms
from tubeopt.block.transcription.arm import evaluate_arm
from tubeopt.block.transcription.mesh import make_mesh
from tubeopt.block.transcription.reduced import evaluate, reduce, residual, to_unknowns
from tubeopt.block.transcription.second_variation import margin, softenings
from tubeopt.physics.torsion import cross_section, section_functions
from tubeopt.robots.assembly import without_offsets
from tubeopt.typing import Array


class Bundle(NamedTuple):
    """theta, kb, m = kb kappa (0 where straight or absent), d, phi, all (n,)."""

    theta: Array
    stiffness: Array
    moment: Array
    offset: Array
    angle: Array

    @property
    def total(self) -> Array:
        return np.array([self.moment @ np.cos(self.theta), self.moment @ np.sin(self.theta)])


@st.composite
def bundles(draw: st.DrawFn) -> Bundle:
    """One to five tubes in units in which kb and kappa are near 1, the first one present."""
    n = draw(st.integers(1, 5))
    columns = []
    for i in range(n):
        kb = draw(st.floats(0.3, 3.0)) * (i == 0 or draw(st.booleans()))
        curvature = draw(st.floats(-2.0, 2.0))
        position = draw(st.floats(0.0, 0.05)), draw(st.floats(-np.pi, np.pi))
        columns.append((draw(st.floats(-7.0, 7.0)), kb, kb * curvature, *position))
    return Bundle(*np.array(columns).T)


def energy(bundle: Bundle, u: Array, g: Array | float = 1.0) -> float:
    """sum of kb / 2 |u / g - kappa e_i|^2 g: every tube is bent from its own curve to that of the bundle."""
    own = np.divide(bundle.moment, bundle.stiffness, out=np.zeros_like(bundle.moment), where=bundle.stiffness > 0)
    g = np.broadcast_to(g, own.shape)
    x, y = u[0] / g - own * np.cos(bundle.theta), u[1] / g - own * np.sin(bundle.theta)
    return float((bundle.stiffness * g) @ (x**2 + y**2)) / 2


@lru_cache(maxsize=16)
def cross_section_function(n: int, eccentric: bool) -> ca.Function:
    symbols = [ca.SX.sym("x", n) for _ in range(5 if eccentric else 3)]
    current = cross_section(*symbols)
    return ca.Function("f", symbols, [current.curvature, current.stretch, current.moment, current.bending_energy])


def values(bundle: Bundle, *, eccentric: bool = False) -> dict[str, Array]:
    """u, g, M, V of the library, as arrays."""
    position = (bundle.offset, bundle.angle) if eccentric else ()
    function = cross_section_function(len(bundle.theta), eccentric)
    out = function(bundle.theta, bundle.stiffness, bundle.moment, *position)
    return {name: value.full().ravel() for name, value in zip("ugMV", out, strict=True)}


@given(bundles())
def test_curvature_is_the_one_of_least_energy(bundle: Bundle) -> None:
    current = values(bundle)
    assert current["V"] == pytest.approx([energy(bundle, current["u"])], abs=1e-12)
    for step in ([1e-3, 0.0], [0.0, 1e-3], [-1e-3, 2e-3]):
        assert energy(bundle, current["u"] + step) > current["V"][0]
    assert current["u"] * bundle.stiffness.sum() == pytest.approx(bundle.total, abs=1e-12)


@given(bundles())
def test_moments_are_the_slope_of_the_energy_and_balance(bundle: Bundle) -> None:
    moment = values(bundle)["M"]
    for i in range(len(moment)):
        sides = []
        for step in (1e-5, -1e-5):
            theta = bundle.theta.copy()
            theta[i] += step
            sides.append(values(bundle._replace(theta=theta))["V"][0])
        assert moment[i] == pytest.approx((sides[0] - sides[1]) / 2e-5, abs=1e-8)
    # Tubes only turn each other: action is reaction.
    assert moment.sum() == pytest.approx(0.0, abs=1e-12)
    assert (moment[bundle.stiffness == 0] == 0).all()


@given(bundles(), st.floats(-4.0, 4.0))
def test_turning_the_bundle_turns_the_curvature_and_nothing_else(bundle: Bundle, angle: float) -> None:
    current, turned = values(bundle), values(bundle._replace(theta=bundle.theta + angle))
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    assert turned["u"] == pytest.approx(rotation @ current["u"], abs=1e-12)
    assert turned["M"] == pytest.approx(current["M"], abs=1e-12)
    assert turned["V"] == pytest.approx(current["V"], abs=1e-12)


@given(bundles())
def test_second_variation_is_a_sum_over_pairs(bundle: Bundle) -> None:
    n = len(bundle.theta)
    balance = section_functions(n, False)["balance"](bundle.theta, bundle.stiffness, bundle.moment)
    expected = np.zeros((n, n))
    for i in range(n):
        for j in range(i):
            pair = np.zeros(n)
            pair[i], pair[j] = 1.0, -1.0
            c = bundle.moment[i] * bundle.moment[j] / bundle.stiffness.sum()
            expected += c * np.cos(bundle.theta[i] - bundle.theta[j]) * np.outer(pair, pair)
    assert balance[1].full() == pytest.approx(expected, abs=1e-12)


@given(bundles(), st.lists(st.floats(-2, 2), min_size=5, max_size=5))
def test_derivatives_of_the_second_variation(bundle: Bundle, entries: list[float]) -> None:
    n = len(bundle.theta)
    y = np.array(entries[:n])
    functions = section_functions(n, False)
    rest = bundle.stiffness, bundle.moment

    def slope(theta: Array) -> Array:
        return np.asarray(functions["balance"](theta, *rest)[1].full())

    steps = np.eye(n) * 1e-5
    form, gradient = (out.full().ravel() for out in functions["variation"](bundle.theta, *rest, y))
    assert form == pytest.approx([y @ slope(bundle.theta) @ y], abs=1e-11)
    expected = [y @ (slope(bundle.theta + h) - slope(bundle.theta - h)) @ y / 2e-5 for h in steps]
    assert gradient[:n] == pytest.approx(expected, abs=1e-7)
    # The form is of second degree in m, and inversely proportional to the sum of kb.
    assert gradient[2 * n :] @ bundle.moment == pytest.approx(2 * form[0], abs=1e-9)
    assert gradient[n : 2 * n] @ bundle.stiffness == pytest.approx(-form[0], abs=1e-9)
    bend = [functions["curvature"](bundle.theta + h, *rest).full().ravel() for h in (*steps, *-steps)]
    expected_bend = (np.array(bend[:n]) - np.array(bend[n:])).T / 2e-5
    assert functions["curvature_slope"](bundle.theta, *rest).full() == pytest.approx(expected_bend, abs=1e-8)


# --- tubes beside the centreline ------------------------------------------------------------------------------------


@given(bundles())
def test_curvature_beside_the_centreline_solves_its_equations(bundle: Bundle) -> None:
    current = values(bundle, eccentric=True)
    u, g = current["u"], current["g"]
    lean = bundle.offset * (u[0] * np.sin(bundle.angle) - u[1] * np.cos(bundle.angle))
    assert g == pytest.approx(1 + lean, abs=1e-12)
    assert u * (bundle.stiffness / g).sum() == pytest.approx(bundle.total, abs=1e-11)
    pull = bundle.moment * (u[0] * np.sin(bundle.theta) - u[1] * np.cos(bundle.theta))
    assert current["M"] == pytest.approx(pull, abs=1e-12)
    assert current["V"] == pytest.approx([energy(bundle, u, g)], abs=1e-11)


@pytest.mark.parametrize("angle", [(0.0, 2.0, -2.0), (0.3, 0.3, 0.3), (1.9, 1.9, 1.9)])
@pytest.mark.parametrize("reach", [0.15, 0.25])
def test_curvature_is_found_to_round_off_for_tubes_a_quarter_of_the_radius_away(
    reach: float, angle: tuple[float, ...]
) -> None:
    # The start is off by (d |u|)^3 < 1/64, which three steps of Newton's method take to its eighth power.
    theta = np.array([0.3, -0.4, 0.1])
    for turn in np.linspace(0, 2 * np.pi, 13):
        bundle = Bundle(theta + turn, np.ones(3), np.full(3, 0.8), np.full(3, reach), np.array(angle))
        current = values(bundle, eccentric=True)
        assert current["u"] * (1 / current["g"]).sum() == pytest.approx(bundle.total, abs=3e-14)


@given(bundles())
def test_slopes_of_moment_and_stretch_beside_the_centreline(bundle: Bundle) -> None:
    n = len(bundle.theta)
    balance = section_functions(n, True)["balance"](*bundle)
    for i, h in enumerate(np.eye(n) * 1e-5):
        ahead, behind = (values(bundle._replace(theta=bundle.theta + s * h), eccentric=True) for s in (1, -1))
        assert balance[1].full()[:, i] == pytest.approx((ahead["M"] - behind["M"]) / 2e-5, abs=1e-7)
        assert balance[4].full()[:, i] == pytest.approx((ahead["g"] - behind["g"]) / 2e-5, abs=1e-7)


@given(bundles())
def test_without_offset_both_models_are_one(bundle: Bundle) -> None:
    flat = bundle._replace(offset=np.zeros_like(bundle.offset))
    concentric, eccentric = values(flat), values(flat, eccentric=True)
    for name, value in concentric.items():
        assert eccentric[name] == pytest.approx(value, abs=1e-12)


ECCENTRIC_TIPS = (
    # rotations (deg), tip (mm), by the shooting of `shoot_eccentric`
    ((0.0, 60.0, -60.0), (-0.0107397903, -26.2037965587, 88.8413289204)),
    ((0.0, 90.0, -90.0), (-0.0008295525, -14.2755632536, 92.4920365767)),
    ((30.0, 100.0, -20.0), (15.1921835553, -21.2539300297, 88.8727067377)),
)


def shoot_eccentric(rotations: Array, offset: float) -> Array:
    """Tip (m) of the thesis' one-segment eccentric robot by shooting with DOP853, from its equations alone."""
    kappa, nu, length, phi = 1 / 0.12, 58 / 43 - 1, 0.094, np.array([0.0, 120.0, -120.0]) * DEG

    def slope(_: float, y: Array) -> Array:
        theta, w, frame = y[:3], y[3:6], y[6:15].reshape(3, 3)
        pull = kappa * np.array([np.cos(theta).sum(), np.sin(theta).sum()])
        u = pull / 3
        for _ in range(12):  # each a fiftieth of what was left
            g = 1 + offset * (u[0] * np.sin(phi) - u[1] * np.cos(phi))
            u = pull / (1 / g).sum()
        turn = np.array([[0, 0, u[1]], [0, 0, -u[0]], [-u[1], u[0], 0]])
        gain = (1 + nu) * kappa * (u[0] * np.sin(theta) - u[1] * np.cos(theta))
        return np.concatenate([g * w, gain, (frame @ turn).ravel(), frame[:, 2]])

    def tip(twist: Array) -> Array:
        start = np.concatenate([rotations, twist, np.eye(3).ravel(), np.zeros(3)])
        run = solve_ivp(slope, (0, length), start, method="DOP853", rtol=1e-12, atol=1e-12)
        return np.asarray(run.y[:, -1])

    twist = root(lambda w: tip(w)[3:6], np.zeros(3), tol=1e-12).x
    return tip(twist)[15:]


def solve_eccentric(rotations: Array, offset: float) -> arms.Arm:
    """The same robot by collocation."""
    assembly = eccentric_assembly(offset)
    problem = reduce(assembly, make_mesh(assembly))
    result = newton(problem, rotations, np.zeros(problem.size))
    assert result.converged
    assert residual(problem, result.state) < 1e-12
    return evaluate_arm(problem, rotations, result.state, arms.profile(problem, rotations, result.state))


@pytest.mark.parametrize(("rotations", "tip"), ECCENTRIC_TIPS)
def test_eccentric_robot_of_the_thesis(rotations: tuple[float, ...], tip: tuple[float, ...]) -> None:
    arm = solve_eccentric(np.array(rotations) * DEG, 1.92 * MM / np.sqrt(3))
    assert arm.position[-1] == pytest.approx(np.array(tip) * MM, abs=1e-11)


@pytest.mark.parametrize("offset", [0.0, 0.5 * MM, 2.0 * MM])
def test_eccentric_robot_against_shooting(offset: float) -> None:
    rotations = np.array([30.0, 100.0, -20.0]) * DEG
    arm = solve_eccentric(rotations, offset)
    assert arm.position[-1] == pytest.approx(shoot_eccentric(rotations, offset), abs=2e-11)


@pytest.mark.parametrize(("separation", "radius"), [(0, 34.971), (30, 32.864), (60, 26.204), (90, 14.276)])
def test_circles_of_the_mirrored_eccentric_robot(separation: float, radius: float) -> None:
    arm = solve_eccentric(np.array([0.0, separation, -separation]) * DEG, 1.92 * MM / np.sqrt(3))
    assert np.hypot(*arm.position[-1, :2]) == pytest.approx(radius * MM, abs=0.5e-6)


def test_margin_of_the_eccentric_robot_is_that_without_offset_in_the_limit() -> None:
    rotations = np.array([0.0, 90.0, -90.0]) * DEG
    gaps = []
    for offset in (1.92 * MM / np.sqrt(3), 1e-5):
        assembly = eccentric_assembly(offset)
        problem = reduce(assembly, make_mesh(assembly))
        solved = newton(problem, rotations, np.zeros(problem.size)).state
        concentric = reduce(without_offsets(assembly), problem.mesh)
        assert (concentric.point == problem.point).all()
        # The compliance is the same, so z means the same: evaluate the concentric energy at the eccentric rotations.
        reached = evaluate(concentric, rotations, solved.z)
        gaps.append(abs(margin(problem, solved) - margin(concentric, reached)))
    assert 1e-6 < gaps[0] < 5e-3
    assert gaps[1] < 0.02 * gaps[0]


def test_margin_is_zero_where_the_jacobian_of_the_eccentric_robot_is_singular() -> None:
    random = np.random.default_rng(0)
    assembly = eccentric_assembly()
    problem = reduce(assembly, make_mesh(assembly))
    for _ in range(20):
        alpha = random.uniform(0, 2 * np.pi, 3)
        theta = alpha + np.outer(problem.arc_length / 0.03, random.normal(0, 1, 3))
        state = evaluate(problem, alpha, to_unknowns(problem, alpha, theta))
        fractions = softenings(problem, state.theta)
        # det (1 - K) is that of the Jacobian, up to a factor that is not 0.
        assert np.sign(np.prod(1 - fractions)) == np.linalg.slogdet(state.hessian)[0]
