"""Limits of loads, snaps and equilibria under load, and the certificate against them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.optimize import minimize_scalar

from tests.equilibrium.test_loads import ROTATIONS, rod
from tests.examples import CRL, THESIS
from tubeopt import (
    ConcentricRobot,
    InputError,
    Load,
    SolveError,
    Tube,
    deflection_bound,
    find_equilibria,
    find_load_limit,
    find_snap,
    find_stroke_force,
    follow,
    forward_kinematics,
    forward_kinematics_batch,
    load_robot,
    snap_free_certificate,
)
from tubeopt.block.transcription.loaded import LoadedProblem, evaluate
from tubeopt.equilibrium.continuation import Family, reach
from tubeopt.equilibrium.kinematics import point_of
from tubeopt.equilibrium.member import Loaded
from tubeopt.stability.certificate import ArmSections, arm_sections
from tubeopt.stability.folds import slide
from tubeopt.stability.stroke import stroke_slopes
from tubeopt.typing import Array

UNIT = 1e-3 / 0.2**2
"""EI / L^2 of the column of these tests, N."""


@pytest.mark.parametrize("tilt", [0.0, 1.0])
def test_eulers_load(tilt: float) -> None:
    limit = find_load_limit(rod(0.2, 1e-3), [tilt], None, Load((0, 0, -UNIT)))
    assert limit is not None
    assert limit.kind == "bifurcation"
    assert limit.factor == pytest.approx(np.pi**2 / 4, rel=1e-8)
    assert limit.before.margin == pytest.approx(0, abs=1e-9)
    assert limit.after is not None
    # Just beyond, an elastica has the amplitude 2 sqrt(2) sqrt(excess) times 2 L / pi.
    excess = limit.after.load.force[2] / (-UNIT * np.pi**2 / 4) - 1  # type: ignore[union-attr]
    assert limit.tip_jump == pytest.approx(2 * np.sqrt(2 * excess) * 0.4 / np.pi, rel=1e-2)
    assert limit.energy_released > 0


def test_a_symmetric_pose_bifurcates() -> None:
    limit = find_load_limit(THESIS, (0, 0, 0), None, Load((0, 1.5, -1.5)))
    assert limit is not None
    assert limit.kind == "bifurcation"
    assert limit.factor == pytest.approx(0.0713476, abs=1e-7)
    assert limit.before.tip_position[0] == pytest.approx(0, abs=1e-12)
    assert abs(limit.after.tip_position[0]) > 1e-4  # type: ignore[union-attr]
    assert find_load_limit(THESIS, (0.2, 0, -0.1), None, Load((0, 1.5, -1.5)), up_to=0.1) is None


def largest_factor(problem: LoadedProblem, alpha: Array, x: Array, factor: float) -> float:
    """The largest factor on the branch through a point close to it: the branch is followed along its softest direction
    there, in which it goes through the fold without a turn."""
    softest = np.linalg.eigh(evaluate(problem, alpha, x, factor).hessian)[1][:, 0]

    def at(along: float) -> float:
        y = np.append(x, factor)
        for _ in range(12):
            state = evaluate(problem, alpha, y[:-1], y[-1])
            matrix = np.block([[state.hessian, state.load_slope[:, None]], [softest, np.zeros(1)]])
            step = np.linalg.solve(matrix, -np.append(state.gradient, softest @ (y[:-1] - x) - along))
            y += step
            if np.abs(step).max() < 1e-12:
                break
        return float(y[-1])

    result = minimize_scalar(lambda along: -at(along), bracket=(-1e-3, 1e-3), tol=1e-6)
    return -float(result.fun)


def test_the_thesis_robot_snaps_under_twenty_two_millinewton() -> None:
    turned = follow(THESIS, np.radians([[0, 0, 0], [200, 0, 0]])).equilibria[-1]
    limit = find_load_limit(THESIS, turned.rotations, None, Load((-0.02, 0, 0)), equilibrium=turned)
    assert limit is not None
    assert limit.kind == "fold"
    assert 0.02 * limit.factor == pytest.approx(21.85e-3, abs=1e-5)
    assert limit.before.margin == pytest.approx(0, abs=1e-9)
    assert limit.after is not None
    assert limit.after.stable
    assert limit.energy_released > 1e-3
    start = point_of(turned, Load((-0.02, 0, 0)))
    problem = start.member.problem
    near = reach(Family.growing(start.member), start, 1.09)
    other = largest_factor(problem, turned.rotations, near.state.x, 1.09)
    assert limit.factor == pytest.approx(other, abs=1e-8)
    # The same event, met by turning under that load.
    snap = find_snap(THESIS, ((0, 0, 0), None), (np.radians([230, 0, 0]), None), load=limit.before.load)
    assert snap is not None
    assert np.degrees(snap.rotations[0]) == pytest.approx(200, abs=1e-6)
    assert snap.energy_released == pytest.approx(limit.energy_released, rel=1e-8)


def test_snaps_without_force_are_those_without_loads() -> None:
    paths = ((0, 0, 0), None), (np.radians([360, 0, 0]), None)
    plain, loaded = find_snap(THESIS, *paths), find_snap(THESIS, *paths, load=Load())
    assert plain is not None
    assert loaded is not None
    assert loaded.fraction == pytest.approx(plain.fraction, abs=1e-11)
    assert loaded.energy_released == pytest.approx(plain.energy_released, abs=1e-11)
    assert find_snap(THESIS, ((0, 0, 0), None), (np.radians([200, 0, 0]), None), load=Load((0.02, 0, 0))) is None


def test_motion_under_its_weight_is_followed_and_remembered() -> None:
    load, paths = Load((0.01, 0, 0), gravity=(0, 0, -9.81)), np.radians([[0, 0, 0], [250, 0, 0], [0, 0, 0]])
    path = follow(THESIS, paths, load=load)
    assert [snap.index for snap in path.snaps] == [0, 1]
    back = forward_kinematics(THESIS, paths[2], load=load)
    assert np.allclose(path.equilibria[2].tip_position, back.tip_position, rtol=0, atol=1e-11)
    assert all(e.stable and e.load == load for e in path.equilibria)
    slid = follow(THESIS, [ROTATIONS, ROTATIONS], [(0, 0, 0), (-0.06, -0.02, 0.01)], load=load).equilibria[-1]
    cold = forward_kinematics(THESIS, ROTATIONS, (-0.06, -0.02, 0.01), load=load)
    assert np.allclose(slid.tip_position, cold.tip_position, rtol=0, atol=1e-11)


def test_all_equilibria_are_counted() -> None:
    rotations = np.radians([200, 0, 0])
    below = find_equilibria(THESIS, rotations, load=Load((-0.0218, 0, 0)))
    above = find_equilibria(THESIS, rotations, load=Load((-0.0219, 0, 0)))
    assert [e.index for e in below] == [0, 0, 1]
    assert [e.index for e in above] == [0]
    assert below[0].potential < below[1].potential < below[2].potential


def test_of_a_robot_that_is_certified_under_a_force_nothing_is_searched() -> None:
    (only,) = find_equilibria(slender(0.4), (0.5, 0, 0), load=Load((0.003, 0, 0)))
    assert only.stable


def test_many_configurations_are_those_one_by_one() -> None:
    rotations, load = np.random.default_rng(0).uniform(-2, 2, (2, 3)), Load((0.05, 0, 0), gravity=(0, 0, -9.81))
    batch = forward_kinematics_batch(THESIS, rotations, load=load)
    assert batch.converged.all()
    for k in range(2):
        e = forward_kinematics(THESIS, rotations[k], load=load)
        assert np.allclose(batch.tip_position[k], e.tip_position, rtol=0, atol=1e-14)
        assert np.allclose(batch.compliance[k], e.compliance, rtol=1e-9)
        assert batch.margin[k] == pytest.approx(e.margin, abs=1e-12)
    lost = forward_kinematics_batch(THESIS, [[0, 0, 0]], load=Load((0, 1.5, -1.5)))
    assert not lost.converged.any()
    assert "bifurcates" in lost.failures[0][1]


def slender(scale: float) -> ConcentricRobot:
    """The tubes of the CRL robot, less curved."""
    tubes = [
        Tube(t.outer_diameter, t.inner_diameter, t.straight_length, t.curved_length, scale * t.curvature, t.material)
        for t in CRL.tubes
    ]
    return ConcentricRobot(tuple(tubes))


def test_certificate_without_force_is_the_one_without_loads() -> None:
    for robot in (THESIS, CRL, slender(0.4)):
        plain = snap_free_certificate(robot)
        assert snap_free_certificate(robot, max_force=0.0) == plain
        slightly = snap_free_certificate(robot, max_force=1e-9)
        assert plain - 1e-6 < slightly <= plain


def test_certificate_of_a_column_counts_three_halves_of_eulers_load() -> None:
    for ratio in (0.3, 0.8, 2.0):
        bound = snap_free_certificate(rod(0.2, 1e-3), max_force=ratio * UNIT)
        exact = 1 - 1.5 * ratio * 4 / np.pi**2
        assert bound == pytest.approx(exact, abs=1e-12)


def in_parts(bundle: ArmSections, count: int) -> ArmSections:
    """The same arm, every section in so many parts."""
    length = np.repeat(bundle.length / count, count)
    return replace(
        bundle,
        start=np.concatenate([[0.0], np.cumsum(length)[:-1]]),
        length=length,
        stiffness=np.repeat(bundle.stiffness, count),
        natural_moment=np.repeat(bundle.natural_moment, count, axis=0),
    )


def test_certificate_does_not_depend_on_parts_of_sections() -> None:
    for robot, force in ((slender(0.4), 0.01), (THESIS, 0.02), (THESIS, 1.0)):
        bundle = arm_sections(robot, np.zeros(3))
        for pairs in (True, False):
            whole = bundle.softening(force, pairs=pairs)
            assert in_parts(bundle, 3).softening(force, pairs=pairs) == pytest.approx(whole, rel=1e-12)


def test_certificate_is_below_every_loaded_margin() -> None:
    random = np.random.default_rng(3)
    robot = slender(0.4)
    for force in (0.003, 0.01):
        bound = snap_free_certificate(robot, max_force=force)
        assert 0 < bound < snap_free_certificate(robot)
        for _ in range(12):
            push = random.normal(size=3)
            push *= force / np.linalg.norm(push)
            alpha = random.uniform(-np.pi, np.pi, 3)
            assert forward_kinematics(robot, alpha, load=Load(push)).margin >= bound
            # Not only at equilibria: at any shape.
            member = Loaded.of(robot, alpha, (0.0, 0.0, 0.0), Load(push))
            x = random.normal(size=member.problem.size) * 0.1
            assert member.margin(member.at(x)) >= bound


def test_eigenvalue_of_the_certificate_is_that_of_a_fine_ritz_method() -> None:
    robot, force = slender(0.5), 0.01
    bundle = arm_sections(robot, np.zeros(3))
    fine = in_parts(bundle, 24)
    # Y and the integral of r, linear on each cell: a lower bound of the eigenvalue.
    n, count, h = 3, len(fine.length), fine.length
    moment = fine.natural_moment
    slope = moment / fine.stiffness[:, None]
    lever = fine.total_length - fine.start - h / 2
    pairs = np.einsum("ki,kj->kij", moment, moment) / fine.stiffness[:, None, None] * (1 - np.eye(n))
    coupling = pairs + np.einsum("ki,ij->kij", pairs.sum(2) + force * lever[:, None] * slope, np.eye(n))
    fields = np.zeros((n + 1, count, (n + 1) * count))
    for i in range(n + 1):
        fields[i, np.arange(count), i * count + np.arange(count)] = 1.0
    stiff = np.concatenate([np.repeat(fine.torsional[:, None], count, 1), fine.stiffness[None]])
    below = np.tril(np.ones((count, count)), -1) * h

    def at_middle(slopes: Array) -> Array:
        return below @ slopes + h[:, None] / 2 * slopes

    energy = np.einsum("ik,ika,ikb->ab", stiff * h, fields, fields)
    y = np.array([at_middle(fields[i]) for i in range(n)])
    # The twist of the transmissions is one more unknown each.
    extra = np.zeros((n, count, n))
    for i in range(n):
        extra[i, :, i] = 1.0
    y = np.concatenate([y, extra], axis=2)
    size = y.shape[2]
    full = np.zeros((size, size))
    full[: (n + 1) * count, : (n + 1) * count] = energy
    full[np.arange(size - n, size), np.arange(size - n, size)] = fine.torsional / fine.transmission
    r = np.concatenate([fields[n], np.zeros((count, n))], axis=1)
    phi = at_middle(np.einsum("ki,ika->ka", slope, y) + r)
    loss = np.einsum("k,kij,ika,jkb->ab", h, coupling, y, y)
    loss += 1.5 * force * np.einsum("k,ka,kb->ab", h, phi, phi)
    ritz = float(eigh(loss, full, eigvals_only=True)[-1])
    assert ritz == pytest.approx(bundle.softening(force, pairs=True), rel=2e-3)
    assert ritz < bundle.softening(force, pairs=True)


def test_what_makes_no_sense_says_so() -> None:
    eccentric = load_robot("configs/robots/thesis_etr.yaml")
    loaded = forward_kinematics(THESIS, ROTATIONS, load=Load((0.01, 0, 0)))
    with pytest.raises(InputError, match="must be unloaded and stable"):
        find_load_limit(THESIS, ROTATIONS, None, Load((1, 0, 0)), equilibrium=loaded)
    with pytest.raises(InputError, match="at other joint values"):
        find_load_limit(THESIS, ROTATIONS, None, Load((1, 0, 0)), equilibrium=forward_kinematics(THESIS, (0, 0, 0)))
    with pytest.raises(InputError, match="for eccentric robots"):
        snap_free_certificate(eccentric, max_force=0.1)
    with pytest.raises(InputError, match="max_force is -1"):
        snap_free_certificate(THESIS, max_force=-1)


def test_a_fall_ends_in_a_minimum_below() -> None:
    column = rod(0.2, 1e-3)
    start = point_of(forward_kinematics(column, [0.0]), Load((1e-6, 0, -3 * UNIT)))
    problem, member = start.member.problem, replace(start.member, factor=1.0)
    result = slide(member, start.state.x)
    assert result.converged
    assert member.margin(result.state) > -1e-9
    assert result.state.potential < evaluate(problem, np.zeros(1), start.state.x).potential


def test_deflection_of_a_column_is_bounded_by_its_compliance_over_the_certificate() -> None:
    length, stiffness = 0.2, 1e-3
    for ratio in (0.01, 0.3):
        force = ratio * UNIT
        bound = deflection_bound(rod(length, stiffness), max_force=force, arc_length=[0.0, 0.1, length])
        certificate = snap_free_certificate(rod(length, stiffness), max_force=force)
        # Compliance at s and at the tip: s^3 / (3 K), which are the squares of what the two can do.
        reach = np.sqrt(np.array([0.0, 0.1, length]) ** 3 / 3 / stiffness)
        assert np.allclose(bound, force * reach[-1] * reach / certificate, rtol=1e-12)


def test_no_force_moves_the_arm_farther_than_bounded() -> None:
    robot, shift, force = load_robot("configs/robots/crl_ctr.yaml"), (-0.02, 0.0, 0.0), 0.003
    bound = deflection_bound(robot, shift, max_force=force)[0]
    assert np.isfinite(bound)
    random, moved = np.random.default_rng(3), []
    for _ in range(20):
        alpha, push = random.uniform(-np.pi, np.pi, 3), random.normal(size=3)
        plain = forward_kinematics(robot, alpha, shift)
        e = forward_kinematics(robot, alpha, shift, load=Load(push * force / np.linalg.norm(push)))
        moved.append(float(np.linalg.norm(e.tip_position - plain.tip_position)))
    assert 0.15 * bound < max(moved) <= bound
    assert np.isinf(deflection_bound(robot, shift, max_force=1.0)[0])
    assert deflection_bound(robot, shift, max_force=0.0)[0] == 0
    with pytest.raises(InputError, match="points must lie on the arm"):
        deflection_bound(robot, shift, max_force=0.01, arc_length=[1.0])


def test_the_stroke_force_of_a_column_is_eulers() -> None:
    limit = find_stroke_force(rod(0.2, 1e-3), [0.7])
    assert limit is not None
    assert limit.kind == "bifurcation"
    assert limit.factor == pytest.approx(UNIT * np.pi**2 / 4, rel=1e-8)
    assert find_stroke_force(rod(0.2, 1e-3), [0.7], up_to=0.9 * UNIT * np.pi**2 / 4) is None


def test_the_stroke_force_of_a_curved_arm_is_a_load_limit() -> None:
    limit, home = find_stroke_force(THESIS, (0, 0, 0)), forward_kinematics(THESIS, (0, 0, 0))
    push = Load(tuple(-0.1 * home.tip_rotation[:, 2]))  # type: ignore[arg-type]
    same = find_load_limit(THESIS, (0, 0, 0), None, push)
    assert limit is not None
    assert same is not None
    assert limit.factor == pytest.approx(0.1 * same.factor, rel=1e-7)
    assert limit.before.load is not None
    assert np.linalg.norm(limit.before.load.force) == pytest.approx(limit.factor, rel=1e-9)
    with pytest.raises(InputError, match="it must be unloaded and stable"):
        find_stroke_force(THESIS, (0, 0, 0), equilibrium=limit.before)


def bent(robot: ConcentricRobot, name: str, i: int, step: float) -> ConcentricRobot:
    """The robot with one dimension of a tube moved."""
    tubes = list(robot.tubes)
    tubes[i] = replace(tubes[i], **{name: getattr(tubes[i], name) + step})
    return replace(robot, tubes=tuple(tubes))


@pytest.mark.parametrize(("name", "i"), [("curvature", 2), ("bending_stiffness", 0)])
@pytest.mark.parametrize(("inner", "kind"), [(0.0, "bifurcation"), (np.pi, "fold")])
def test_the_change_of_a_stroke_force_is_that_of_differences(inner: float, kind: str, name: str, i: int) -> None:
    joints, names = (inner, 0.0, 0.0), ("curvature", "bending_stiffness")
    first, limit = forward_kinematics(THESIS, joints), find_stroke_force(THESIS, joints)
    assert limit is not None
    assert limit.kind == kind
    result = stroke_slopes(first, names)
    assert result is not None
    assert result[0] == pytest.approx(limit.factor, rel=1e-12)
    step = 1e-4 * getattr(THESIS.tubes[i], name)
    ahead, back = (find_stroke_force(bent(THESIS, name, i, sign * step), joints) for sign in (1, -1))
    assert ahead is not None
    assert back is not None
    change = result[1][3 * names.index(name) + i]
    assert change == pytest.approx((ahead.factor - back.factor) / (2 * step), rel=1e-6)


def test_the_stroke_force_of_a_column_grows_with_its_stiffness() -> None:
    column = rod(0.2, 1e-3)
    result = stroke_slopes(forward_kinematics(column, [0.7]), ["bending_stiffness", "curved_length"])
    assert result is not None
    value, change = result
    assert change[0] == pytest.approx(value / column.tubes[0].bending_stiffness, rel=1e-7)
    assert change[1] == pytest.approx(-2 * value / 0.2, rel=1e-6)


def test_a_stroke_force_has_no_change_with_what_leaves_the_plane() -> None:
    with pytest.raises(SolveError, match="break the symmetry"):
        stroke_slopes(forward_kinematics(THESIS, (0, 0, 0)), ["rotations"])


@pytest.mark.filterwarnings("ignore::tubeopt.errors.ImplausibleWarning")
@pytest.mark.parametrize("force", [1e150, 1e250, 1.7e308])
def test_forces_beyond_all_numbers_are_not_certified(force: float) -> None:
    assert snap_free_certificate(CRL, np.full(3, -0.03), max_force=force) < -1e100
