"""Stability under loads without an energy, against closed forms of straight rods and folds found by shooting."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, fsolve

from tests.equilibrium.test_loads import rod
from tests.equilibrium.test_moments_along_the_arm import NONE, agrees, shot
from tests.load_reference import RefLoad, Shooting, of_robot
from tubeopt import (
    ConcentricRobot,
    Equilibrium,
    Load,
    SolveError,
    find_equilibria,
    find_load_limit,
    find_snap,
    follow,
    forward_kinematics,
    load_robot,
)
from tubeopt.block.transcription.orientation import tangents
from tubeopt.equilibrium.jacobian import shifted, unit_of
from tubeopt.equilibrium.kinematics import point_of
from tubeopt.stability.folds import fall
from tubeopt.stability.load_limit import find_loss
from tubeopt.typing import Array

LENGTH, BENDING, TORSIONAL = 0.2, 1e-3, 8e-4
ROD = rod(LENGTH, BENDING, TORSIONAL)
HOME = (0.0, 0.0, 0.0)
MOMENT = (0.003, 0.002, 0.002)


@pytest.fixture(scope="module")
def thesis() -> ConcentricRobot:
    robot = load_robot("configs/robots/thesis_ctr.yaml")
    assert isinstance(robot, ConcentricRobot)
    return robot


def whitened(e: Equilibrium) -> Array:
    """The matrix (U, U) of the linearised equations."""
    return point_of(e).state.hessian


def at_plate(e: Equilibrium) -> Array:
    """(n + 2,) torques and bending moment at the plate, of an equilibrium at which Newton's method does not stay."""
    stiffness = [tube.torsional_stiffness for tube in e.robot.tubes]
    return np.concatenate([e.torsion[:, 0] * stiffness, e.base_wrench[3:5]])


def turning(at: Callable[[float], Shooting], start: Array, t: float) -> float:
    """The t where a branch turns back, by shooting alone: unknowns and t with the miss 0 form a curve, t is extreme on
    it. A quartic through five of its points, at even changes of the unknown that changes fastest, has the extremum."""

    def miss(x: Array) -> tuple[Array, Array]:
        """The miss (m,), and its derivatives (m, m + 1)."""
        unknown, step = x[:-1], 1e-7
        moved = np.concatenate([np.zeros((1, len(unknown))), step * np.eye(len(unknown)), -step * np.eye(len(unknown))])
        reached = at(x[-1]).march(unknown + moved)[0]
        plus, minus = np.split(reached[1:], 2)
        by_t = (at(x[-1] + 1e-6).march(unknown[None])[0][0] - at(x[-1] - 1e-6).march(unknown[None])[0][0]) / 2e-6
        return reached[0], np.column_stack([(plus - minus).T / (2 * step), by_t])

    current = np.append(start, t)
    along = np.linalg.svd(miss(current)[1] * np.append(np.full(len(start), 1e-3), 1.0))[2][-1]
    k = int(np.argmax(np.abs(along[:-1])))
    free = [i for i in range(len(current)) if i != k]
    offsets, results = np.linspace(-1, 1, 5) * 2e-4, []
    for offset in offsets:
        x = current.copy()
        x[k] += offset
        for _ in range(8):
            off, table = miss(x)
            change = np.linalg.solve(table[:, free], -off)
            x[free] += change
            if np.abs(change).max() < 1e-8:
                break
        results.append(x[-1])
    curve = np.polynomial.Polynomial.fit(offsets, results, 4)
    roots = curve.deriv().roots()
    real = roots[np.abs(roots.imag) < 1e-9].real
    return float(curve(real[np.argmin(np.abs(real))]))


def test_snap_under_a_moment_is_where_shooting_has_a_fold(thesis: ConcentricRobot) -> None:
    snap = find_snap(thesis, (HOME, HOME), (np.radians([195.0, 0, 0]), HOME), load=Load(moment=MOMENT))
    assert snap is not None
    beta = np.array([-tube.straight_length for tube in thesis.tubes])

    def at(turn: float) -> Shooting:
        return Shooting(of_robot(thesis), beta, [turn, 0.0, 0.0], RefLoad(moment=MOMENT))

    assert turning(at, at_plate(snap.before), snap.rotations[0]) == pytest.approx(snap.rotations[0], abs=1e-6)
    assert abs(snap.before.margin) < 1e-9
    assert np.isnan(snap.energy_released)
    # Without the moment the snap is at 214 deg.
    assert np.degrees(snap.rotations[0]) == pytest.approx(187.578, abs=1e-3)
    agrees(snap.after, shot(thesis, snap.after, RefLoad(moment=MOMENT)))
    assert snap.after.stable
    assert snap.tip_jump > 0.09


def test_limit_of_a_moment_along_the_arm_is_where_shooting_has_a_fold(thesis: ConcentricRobot) -> None:
    position, couple = 0.18, np.array((0.002, 0.001, -0.02))
    load = Load(points=((position, NONE, tuple(couple)),))
    limit = find_load_limit(thesis, (0.0, 2.0, 1.0), None, load)
    assert limit is not None
    assert limit.kind == "fold"
    beta = np.array([-tube.straight_length for tube in thesis.tubes])

    def at(factor: float) -> Shooting:
        return Shooting(of_robot(thesis), beta, [0.0, 2.0, 1.0], RefLoad(couples=((position, factor * couple),)))

    assert turning(at, at_plate(limit.before), limit.factor) == pytest.approx(limit.factor, abs=1e-6)
    assert limit.after is not None
    assert limit.after.stable
    agrees(limit.after, shot(thesis, limit.after, RefLoad(couples=((position, limit.factor * couple),))))


def test_no_moment_is_the_zero_of_a_moment(thesis: ConcentricRobot) -> None:
    """Margin and snap go over into those of the load with an energy, linearly in the moment."""
    start, push = (0.0, 2.0, 1.0), (0.05, 0.02, -0.1)
    plain = forward_kinematics(thesis, start, load=Load(push))
    errors = [
        forward_kinematics(thesis, start, load=Load(push, (0.0, 0.0, moment))).margin - plain.margin
        for moment in (1e-7, 2e-7, -1e-7)
    ]
    assert 1e-9 < abs(errors[0]) < 1e-4
    assert errors[1:] == pytest.approx([2 * errors[0], -errors[0]], abs=2e-10)
    ends = (HOME, HOME), (np.radians([360.0, 0, 0]), HOME)
    snaps = [find_snap(thesis, *ends, load=Load(moment=(0.0, 0.0, m))) for m in (0.0, 1e-7, -1e-7)]
    turns = [snap.rotations[0] for snap in snaps if snap is not None]
    assert np.abs(np.array(turns[1:]) - turns[0]).max() < 5e-5
    assert turns[1] + turns[2] == pytest.approx(2 * turns[0], abs=1e-8)


@pytest.mark.parametrize("size", [0.5, 2.0, 3.0])
def test_moment_along_a_clamped_rod_never_buckles_it(size: float) -> None:
    """EI phi'' = i M phi', phi(0) = 0 and EI phi'(L) = i M phi(L) have no solution but 0 at any M: Greenhill's rod
    with a free end and a moment that keeps its direction. The symmetric part alone vanishes at pi EI / L."""
    e = forward_kinematics(ROD, [0.0], load=Load(moment=(0.0, 0.0, size * BENDING / LENGTH)))
    matrix = whitened(e)
    # The exact spectrum is 1 alone; of such a matrix what collocation makes of it depends on the mesh.
    assert 0.9 < e.margin <= 1
    assert np.linalg.eigvalsh((matrix + matrix.T) / 2)[0] == pytest.approx(1 - size / np.pi, abs=1e-7)
    assert find_load_limit(ROD, [0.0], None, Load(moment=(0, 0, size * BENDING / LENGTH)), up_to=2.0) is None


def softening(push: float, moment: float, near: complex) -> complex:
    """kappa of kappa EI phi'' - i M phi' + P phi = 0, phi(0) = 0, kappa EI phi'(L) = i M phi(L): 1 less an eigenvalue
    of a straight rod pushed by P against its tip and twisted by M; phi is the complex slope."""

    def miss(kappa: Array) -> tuple[float, float]:
        stiff = complex(*kappa) * BENDING
        root = np.sqrt(moment**2 + 4 * stiff * push)
        q = (moment + root) / (2 * stiff), (moment - root) / (2 * stiff)
        out = np.exp(1j * (q[0] - q[1]) * LENGTH) - q[0] / q[1]
        return float(out.real), float(out.imag)

    return complex(*fsolve(miss, (near.real, near.imag), xtol=1e-13))


EULER = (np.pi / 2) ** 2 * BENDING / LENGTH**2


@pytest.mark.parametrize("sign", [1, -1])
def test_rod_under_a_push_and_a_moment_against_its_closed_form(sign: int) -> None:
    """Eigenvalues are complex: an oscillation, which grows from a push on that is below that of Euler's buckling."""
    moment = 0.5 * BENDING / LENGTH
    kappa = complex(0.8)
    for part in np.linspace(0, 1, 11)[1:]:
        kappa = softening(0.8 * EULER, part * moment, kappa + 1e-3j)
    load = Load((0.0, 0.0, -0.8 * EULER), (0.0, 0.0, sign * moment))
    e = forward_kinematics(ROD, [0.0], load=load)
    smallest = np.linalg.eigvals(whitened(e))
    smallest = smallest[np.argmin(smallest.real)]
    assert e.margin == pytest.approx(1 - kappa.real, abs=1e-9)
    assert abs(smallest.imag) == pytest.approx(abs(kappa.imag), abs=1e-9)
    assert abs(kappa.imag) > 0.05

    def margin(factor: float) -> float:
        near = kappa * factor
        return 1 - softening(factor * 0.8 * EULER, factor * moment, near).real

    onset = brentq(margin, 0.9, 1.6, xtol=1e-12)
    limit = find_load_limit(ROD, [0.0], None, load)
    assert limit is not None
    assert limit.kind == "flutter"
    assert limit.factor == pytest.approx(onset, abs=1e-7)
    assert limit.after is None
    assert "flutter" in str(limit.status)
    with pytest.raises(SolveError, match=r"begins to flutter at .* % of the load"):
        forward_kinematics(ROD, [0.0], load=load.scaled(1.01 * onset))


def test_push_that_turns_with_the_tip_never_buckles_a_column() -> None:
    """Beck's column has no other equilibrium than the straight one at any push: no fold, no bifurcation."""
    follower = Load((0.0, 0.0, -3 * EULER), frame="tip")
    e = forward_kinematics(ROD, [0.0], load=follower)
    assert e.stable
    assert e.margin > 0.9


def test_motion_under_a_moment_goes_on_from_where_it_lands(thesis: ConcentricRobot) -> None:
    load = Load(moment=MOMENT)
    path = follow(thesis, np.radians([[0.0, 0, 0], [120, 0, 0], [240, 0, 0]]), load=load)
    assert [round(float(np.degrees(snap.rotations[0])), 3) for snap in path.snaps] == [187.578]
    agrees(path.equilibria[-1], shot(thesis, path.equilibria[-1], RefLoad(moment=MOMENT)))
    assert all(e.stable for e in path.equilibria)


def test_unstable_equilibrium_under_a_moment_is_left_by_the_flow(thesis: ConcentricRobot) -> None:
    """Tubes of a viscous material go where x' = -g leads: integrated by an adaptive method, they end there too."""
    result = find_loss(forward_kinematics(thesis, (0.0, 2.0, 1.0)), Load(moment=(0.0, 0.0, -0.02)), 1.0)
    assert result is not None
    lost = result[0].point
    landed = fall(lost, result[0].direction)
    assert landed is not None
    side = lost.softest * np.sign((landed.state.x - lost.state.x) @ lost.unresisted)
    flow = solve_ivp(
        lambda _, x: -lost.member.at(x).gradient, (0, 60), lost.state.x + 0.05 * side, "LSODA", rtol=1e-7, atol=1e-9
    )
    assert np.abs(lost.member.at(flow.y[:, -1]).gradient).max() < 1e-6
    assert np.abs(flow.y[:, -1] - landed.state.x).max() < 1e-5


def test_all_equilibria_under_a_moment_are_counted(thesis: ConcentricRobot) -> None:
    """Two of three vanish at the fold that shooting finds at 187.578 deg."""
    load = Load(moment=MOMENT)
    before, after = (find_equilibria(thesis, np.radians([turn, 0, 0]), load=load) for turn in (187.5, 187.65))
    assert [e.index for e in before] == [0, 0, 1]
    assert [e.index for e in after] == [0]
    assert before[0].margin > before[1].margin > 0 > before[2].margin
    assert np.isnan(before[0].potential)
    on = follow(thesis, [HOME, np.radians([187.5, 0, 0])], load=load).equilibria[-1]
    assert before[1].tip_position == pytest.approx(on.tip_position, abs=1e-9)
    snap = find_snap(thesis, (HOME, HOME), (np.radians([187.65, 0, 0]), HOME), load=load)
    assert snap is not None
    assert after[0].tip_position == pytest.approx(snap.after.tip_position, abs=1e-3)


@pytest.mark.parametrize("frame", ["world", "tip"])
def test_no_other_starts_find_further_equilibria_without_an_energy(frame: str, thesis: ConcentricRobot) -> None:
    load = Load((0.01, 0, -0.02), (0.002, -0.003, 0.004), frame=frame)
    angles = np.radians([200.0, -30.0, 40.0])
    equilibria = find_equilibria(thesis, angles, load=load)
    point, random = point_of(equilibria[0]), np.random.default_rng(3)
    problem, tips = point.member.problem, np.array([e.tip_position for e in equilibria])
    assert sum((-1) ** e.index for e in equilibria) == 1
    reached = 0
    for _ in range(60):
        twist = random.uniform(-4, 4, 3) * (problem.torsion.arc_length / 0.2)[:, None]
        x = point.member.unknowns(angles + twist)
        x[problem.torsion.size :] = 0.1 * random.normal() * random.normal(size=2 * len(problem.softness))
        result = point.member.solve(x, iterations=40)
        if result.converged:
            reached += 1
            tip = problem.torsion.weight @ tangents(result.state.orientation.stage)
            assert np.linalg.norm(tips - tip, axis=1).min() < 1e-8
    assert reached > 10


def test_a_rod_under_a_moment_along_it_has_one_equilibrium() -> None:
    equilibria = find_equilibria(ROD, [0.0], load=Load(moment=(0.0, 0.0, 5 * BENDING / LENGTH)))
    assert [e.index for e in equilibria] == [0]


@pytest.mark.parametrize("load", [Load((0.01, 0, 0), MOMENT), Load(points=((0.06, NONE, (0.006, -0.004, 0.008)),))])
def test_the_margin_under_moments_changes_as_differences_say(load: Load, thesis: ConcentricRobot) -> None:
    """By joint values and dimensions, real eigenvalues and pairs of complex ones."""
    names = ("rotations", "translations", "curvature", "curved_length", "torsional_stiffness")
    e = forward_kinematics(thesis, (2.0, 0.3, -0.2), (-0.02, -0.013, -0.007), load=load)
    result, true = e.margin_slopes(wrt=names), []
    for name, tube in ((name, tube) for name in names for tube in range(3)):
        step = 1e-4 * unit_of(e, name, tube)
        sides = (shifted(e, name, tube, sign * step) for sign in (1, -1))
        one, other = (forward_kinematics(*side, load=load).margin for side in sides)
        true.append((one - other) / (2 * step))
    sizes = np.abs(true).reshape(5, 3).max(1).repeat(3)
    assert (np.abs(result - true) <= 1e-6 * sizes).all()


def test_the_margin_of_a_pair_changes_with_the_length_as_differences_say() -> None:
    """Of a rod that a push and a moment along it bring close to flutter."""
    push, moment = 0.8 * np.pi**2 / 4 * BENDING / LENGTH**2, 0.5 * BENDING / LENGTH
    load = Load((0, 0, -push), (0, 0, moment))
    e = forward_kinematics(ROD, [0.0], [-0.01], load=load)
    values = np.linalg.eigvals(whitened(e))
    assert abs(values[np.argmin(values.real)].imag) > 1e-3
    one, other = (forward_kinematics(ROD, [0.0], [-0.01 + step], load=load).margin for step in (1e-5, -1e-5))
    assert e.margin_slopes(wrt=("translations",))[0] == pytest.approx((one - other) / 2e-5, rel=1e-5)


def test_a_margin_has_no_derivative_where_breakpoints_part(thesis: ConcentricRobot) -> None:
    slopes = forward_kinematics(thesis, (2.0, 0.3, -0.2), load=Load(moment=MOMENT)).margin_slopes()
    assert np.isfinite(slopes[:3]).all()
    assert np.isnan(slopes[3:]).all()
    plain = forward_kinematics(thesis, (2.0, 0.3, -0.2), load=Load((0.01, 0, 0)))
    assert plain.margin_slopes() == pytest.approx(plain.jacobian().margin)
