"""Certificate of bundles: the second variation with boundaries that move, its bounds, and robots that cannot snap."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from tests.command_line import Run, answer
from tests.equilibrium.test_bundle import THIRDS, bundle_of_thesis, tube
from tubeopt import (
    BundleRobot,
    ConcentricRobot,
    EccentricRobot,
    InputError,
    Load,
    Tube,
    assess_snapping,
    certify,
    find_snap,
    load_robot,
    snap_distance,
    snap_free_certificate,
    worst_margin,
)
from tubeopt.block.transcription.bundle import Bundle, BundleState
from tubeopt.equilibrium.bundle import bundle_at
from tubeopt.equilibrium.kinematics import point_of
from tubeopt.equilibrium.linearised_bundle import CHANGED
from tubeopt.stability import Finding
from tubeopt.stability.bundle_certificate import bounds_of, bundle_proof, least_stiffness, proof_parts, proof_slopes
from tubeopt.stability.certificate import CertificateStatus
from tubeopt.typing import Array

pytestmark = pytest.mark.filterwarnings("ignore::tubeopt.errors.ImplausibleWarning")


def thin(width: float, kb: float, kt: float, curvature: float, straight: float, curved: float) -> Tube:
    """Tube of an outer diameter (m) with given stiffnesses."""
    like = tube(kb, kt, curvature, straight, curved)
    return replace(like, outer_diameter=width, inner_diameter=0.8 * width)


def apart(rng: np.random.Generator, tightness: float, length: float) -> tuple[BundleRobot, Array]:
    """Two to four unequal tubes, whose ends keep their order by a reserve, and translations."""
    n = int(rng.integers(2, 5))
    offset = 0.07 * tightness * rng.uniform(0.5, 1.0, n)
    angle = 2 * np.pi * (np.arange(n) + rng.uniform(-0.1, 0.1, n)) / n
    straight, factor = rng.uniform(0, 0.05, n) * rng.integers(0, 2), 4 ** rng.uniform(-1, 1, n)
    curvature = rng.uniform(0.3, 1.0, n) * (rng.random(n) > 0.2)
    curvature[0] = max(curvature[0], 0.5)
    curvature *= tightness / (offset * curvature).max() * rng.choice([-1, 1], n)
    shift = -straight * rng.uniform(0.0, 0.5, n)
    gap, kt = 2.2 * rng.uniform(1.02, 1.3) * offset.max() * np.abs(curvature).max(), 0.02 * rng.uniform(0.5, 0.9)
    own = length * (1 + gap) ** rng.permutation(n)
    tubes = [
        thin(0.5 * offset.min(), 0.02 * f, kt * f, k, s, end - d)
        for f, k, s, end, d in zip(factor, curvature, straight, own, shift, strict=True)
    ]
    sheath = 0.1 * float(rng.random()) * (rng.random() < 0.5)
    return BundleRobot(tuple(tubes), tuple(offset), tuple(angle), sheath_stiffness=sheath), shift


def staggered(robot: BundleRobot, step: float) -> BundleRobot:
    """The robot with tubes that are each shorter by `step` (m) than the one before, on carriages of their own."""
    tubes = [each.resized("curved_length", each.curved_length - k * step) for k, each in enumerate(robot.tubes)]
    return replace(robot, tubes=tuple(tubes), carriages=None)


# --- Second variation -------------------------------------------------------------------------------------------------


class Variation(NamedTuple):
    """A change of an equilibrium."""

    value: float
    """Second variation by the formula of the proof."""
    stiff: float
    """The form T of the same change."""


def variation(state: BundleState, change: Array) -> Variation:
    """Second variation along a change (U,) of the unknowns, in the variables of the proof.

    The curvature, the twist and the places of the boundaries change at fixed arc lengths, so that nothing is left of
    the sections' own coordinates.
    """
    problem, bundle = state.problem, state.problem.bundle
    rule, k, n, count = problem.tableau, problem.tableau.degree, problem.n, len(problem.section)
    to_powers = np.linalg.inv(np.vander(rule.nodes, k, increasing=True))
    at_ends = np.vander([0.0, 1.0], k, increasing=True) @ to_powers
    slope = np.column_stack([np.zeros(k), *(j * rule.nodes ** (j - 1) for j in range(1, k))]) @ to_powers
    h, elements = state.h, [slice(e * k, (e + 1) * k) for e in range(count)]
    u, kt, moment = state.bend / h[:, None], bundle.torsional_stiffness, problem.inputs[2]
    g = 1 + u @ bundle.levers.T
    w = state.turn / h[:, None] / g
    along = np.stack([np.cos(state.theta), np.sin(state.theta)], -1)
    normal = np.stack([-along[..., 1], along[..., 0]], -1)
    across = np.einsum("ac,aic->ai", u, normal)
    pushed = problem.push(change)
    d_turn, d_bend, d_h = pushed[:, n : 2 * n], pushed[:, -3:-1], pushed[:, -1]
    d_length = d_h[:, None] + d_bend @ bundle.levers.T
    own_twist = np.where(problem.present, (d_turn - state.turn * d_length / state.length) / state.length, 0.0)

    def summed(values: Array) -> Array:
        out, total = np.zeros_like(values), np.zeros(values.shape[1:])
        for e in elements:
            out[e] = total + h[e][0] * rule.matrix @ values[e]
            total = total + h[e][0] * rule.weights @ values[e]
        return out

    moved = summed((d_h / h)[:, None])[:, 0]
    u_slope = np.concatenate([slope @ u[e] / h[e][0] for e in elements])
    v = d_bend / h[:, None] - u * (d_h / h)[:, None] - u_slope * moved[:, None]
    twist = own_twist + moment * across / kt * moved[:, None]
    spring = problem.torsion(change)[1]
    eta, stretch = spring + summed(g * twist), v @ bundle.levers.T
    y, form = eta + summed(w * stretch), 0.0
    for section in range(len(problem.order)):
        left = elements[int(np.flatnonzero(problem.section == section)[-1])]
        right = slice(left.stop, left.stop + k)
        here, there = at_ends[1] @ u[left], at_ends[0] @ u[right] if right.start < len(h) else np.zeros(2)
        x, angle, tube_twist = float(moved[left] @ at_ends[1]), at_ends[1] @ state.theta[left], at_ends[1] @ w[left]
        g_here, g_there, rotation = 1 + bundle.levers @ here, 1 + bundle.levers @ there, at_ends[1] @ y[left]
        across_it = np.column_stack([-np.sin(angle), np.cos(angle)])
        form -= float(moment[left.start] @ ((across_it @ here) * (2 * rotation * x + tube_twist * g_here * x**2)))
        if right.start < len(h):
            there_too = problem.present[right.start]
            torque = moment[right.start] * there_too * (across_it @ there)
            form += float(torque @ (2 * rotation * x + tube_twist * (2 * g_here - g_there) * x**2))
            y[right.start :] += there_too * tube_twist * (g_here - g_there) * x
    weight = problem.weight * h
    sprung = bundle.transmission > 1e-9
    springs = float((kt[sprung] / bundle.transmission[sprung]) @ spring[sprung] ** 2)
    form += float(weight @ (kt * problem.present * g * twist**2).sum(1)) + springs
    bent = v[:, None] - u[:, None] / g[..., None] * stretch[..., None]
    form += float(weight @ ((problem.stiffness / g * (bent**2).sum(2)).sum(1) + bundle.sheath * (v**2).sum(1)))
    turned = -2 * np.einsum("ac,aic->ai", v, normal) * y + np.einsum("ac,aic->ai", u, along) * y**2
    form += float(weight @ (moment * turned).sum(1))

    bounds = bounds_of(bundle)
    assert bounds is not None
    least = least_stiffness(bundle, bounds)[problem.point_section]
    softest = kt * problem.present / (1 + bundle.offset * bounds.curvature[problem.point_section][:, None])
    rest = v - np.einsum("ai,aic->ac", moment * eta, normal) / least[:, None]
    stiff = float(weight @ ((softest * (g * twist) ** 2).sum(1) + least * (rest**2).sum(1))) + springs
    return Variation(form, stiff)


@pytest.mark.parametrize("seed", range(6))
def test_the_second_variation_is_that_of_the_energy_and_above_its_bound(seed: int) -> None:
    rng = np.random.default_rng(seed)
    robot, shift = apart(rng, (0.02, 0.03, 0.04)[seed % 3], 0.08)
    pose = robot.fk(rng.uniform(-2, 2, robot.n_tubes), shift)
    state = point_of(pose).state
    problem, n = state.problem, robot.n_tubes
    bound = bundle_proof(problem.bundle).margin
    known = problem.unknowns(state.turn, state.bend.ravel(), problem.torsion(state.x)[1])
    for _ in range(5):
        rate = rng.normal(size=n + 2)
        turn, bend = state.turn + np.outer(state.h, rate[:n]), state.bend + np.outer(state.h, rate[n:])
        change = problem.unknowns(turn, bend.ravel(), problem.torsion(state.x)[1] + rng.normal(size=n)) - known
        found = variation(state, change)
        assert found.value == pytest.approx(change @ state.hessian @ change, rel=1e-7)
        assert not np.isfinite(bound) or found.value >= bound * found.stiff


@pytest.mark.parametrize("seed", range(8))
def test_equilibria_are_within_the_bounds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    robot, shift = apart(rng, (0.01, 0.02, 0.04)[seed % 3], 0.09)
    bundle = bundle_at(robot, tuple(shift.tolist()))
    bounds = bounds_of(bundle)
    assert bounds is not None
    nearest = np.zeros(3)
    for _ in range(20):
        state = point_of(robot.fk(rng.uniform(-np.pi, np.pi, robot.n_tubes), shift)).state
        problem = state.problem
        assert problem.order == bounds.order
        u, k = state.bend / state.h[:, None], problem.point_section
        size = np.linalg.norm(u, axis=1)
        ends = np.cumsum(problem.lengths(state.x) * problem.count)
        assert ((bounds.place[0] <= ends) & (ends <= bounds.place[1])).all()
        normal = np.stack([-np.sin(state.theta), np.cos(state.theta)], -1)
        across = np.abs(np.einsum("ac,aic->ai", u, normal)) * problem.curved
        along = np.stack([np.cos(state.theta), np.sin(state.theta)], -1)
        pull = np.einsum("ai,aic->ac", problem.inputs[2], along)
        off = np.linalg.norm(bounds.stiffness[k][:, None] * u - pull, axis=1)
        for number, (value, bound) in enumerate(
            ((size, bounds.curvature[k]), (off, bounds.off_balance[k]), (across, bounds.across[k]))
        ):
            assert (value <= bound + 1e-9).all()
            nearest[number] = max(nearest[number], (value / np.maximum(bound, 1e-9)).max())
    assert (nearest > [0.5, 0.01, 0.3]).all()


# --- Certificates -----------------------------------------------------------------------------------------------------


def test_without_offsets_it_is_the_certificate_of_concentric_tubes() -> None:
    robot = load_robot("crl_ctr")
    assert isinstance(robot, ConcentricRobot)
    shift = np.array([-0.05, -0.03, -0.01])[: robot.n_tubes]
    bundle = BundleRobot(robot.tubes, (0.0,) * robot.n_tubes, (0.0,) * robot.n_tubes)
    for scale in (0.3, 0.6, 1.0):
        tubes = [each.resized("curvature", scale * each.curvature) for each in robot.tubes]
        mine = snap_free_certificate(replace(bundle, tubes=tuple(tubes)), shift)
        assert mine == pytest.approx(snap_free_certificate(ConcentricRobot(tuple(tubes)), shift), abs=1e-8)


def test_tubes_of_equal_length_jump_where_their_ends_pass_each_other() -> None:
    """The robot of the thesis has two equilibria at a symmetric pose, 0.05 mm apart, and no certificate."""
    robot = bundle_of_thesis()
    certificate = certify(robot)
    assert certificate.status is CertificateStatus.NONE
    assert "differ by more than about 1.56 mm" in certificate.obstacle
    meet, tips = np.radians([30.0, -90.0, -30.0]), []
    for side in (1, -1):
        pose = robot.fk(meet + np.radians(side * 1.0))
        for turn in np.linspace(1, 0, 5)[1:]:
            pose = robot.fk(meet + np.radians(side * turn), start=pose)
        assert side * (pose.tube_end[0] - pose.tube_end[1]) > 1e-6
        tips.append(pose.tip_position)
    assert np.linalg.norm(tips[0] - tips[1]) == pytest.approx(0.0533e-3, abs=2e-6)


def test_tubes_of_unequal_length_have_nearly_the_certificate_of_the_thesis() -> None:
    robot = staggered(bundle_of_thesis(), 2e-3)
    certificate, thesis = certify(robot), load_robot("thesis_etr")
    assert isinstance(thesis, EccentricRobot)
    assert certificate.margin == pytest.approx(0.6477, abs=1e-4)
    worst = worst_margin(robot)
    assert 0 < worst.margin - certificate.margin < 0.04
    assert assess_snapping(robot).finding is Finding.SNAP_FREE
    assert snap_distance(worst.equilibrium).turn == np.inf
    with pytest.raises(InputError, match="bundle with a load"):
        snap_distance(robot.fk(np.zeros(3), load=Load((0.01, 0.0, 0.0))))
    step, (first, *others) = 1e-4, robot.tubes
    longer = replace(robot, tubes=(first.resized("curved_length", first.curved_length + step), *others))
    slope = (snap_free_certificate(longer) - certificate.margin) / step
    assert certificate.gradient["curved_length"][0] == pytest.approx(slope, abs=0.05)


def test_no_proof_is_claimed_for_tight_curves_or_forces() -> None:
    tubes = (tube(0.02, 0.015, 40.0, 0.0, 0.1), tube(0.03, 0.02, 30.0, 0.0, 0.12), tube(0.02, 0.02, 35.0, 0.0, 0.2))
    tight = BundleRobot(tubes, (0.006,) * 3, THIRDS)
    assert "too tightly" in certify(tight).obstacle
    with pytest.raises(InputError, match="must be 0 for bundles"):
        snap_free_certificate(tight, max_force=0.1)


def longest_certified(rng: np.random.Generator, tightness: float, target: float) -> tuple[BundleRobot, Array] | None:
    """Random robot as long as its certificate is above `target`; None if short ones have none."""
    state = rng.bit_generator.state

    def at(length: float) -> tuple[BundleRobot, Array]:
        rng.bit_generator.state = state
        return apart(rng, tightness, length)

    low, high = 0.005, 0.3
    if not snap_free_certificate(*at(low)) > target:
        return None
    for _ in range(16):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if snap_free_certificate(*at(middle)) > target else (low, middle)
    return at(low)


def snaps_of(seed: int, paths: int) -> int | None:
    """Number of random paths on which a robot at the edge of its certificate snaps, or that lead elsewhere."""
    rng = np.random.default_rng(seed)
    try:
        found = longest_certified(rng, float(rng.uniform(0.003, 0.2)), 10 ** rng.uniform(-4, -1))
    except InputError:  # tubes that overlap
        return None
    if found is None:
        return None
    robot, shift = found
    wrong = 0
    for start, end in rng.uniform(-2 * np.pi, 2 * np.pi, (paths, 2, robot.n_tubes)):
        pose = robot.fk(start, shift)
        for part in np.linspace(0, 1, 9)[1:]:
            pose = robot.fk(start + part * (end - start), shift, start=pose)
            wrong += int(pose.margin <= 0)
        wrong += int(find_snap(robot, (start, shift), (end, shift)) is not None)
        wrong += int(np.linalg.norm(robot.fk(end, shift).tip_position - pose.tip_position) > 1e-8)
    return wrong


@pytest.mark.parametrize("shift", [(0.020, 0.018, 0.016), (0.010, 0.0085, 0.007)])
def test_curves_that_begin_in_front_of_the_plate_are_certified(shift: tuple[float, ...]) -> None:
    # No tube is curved in the first section: its bound of the curvature comes from axial forces alone.
    thesis = staggered(bundle_of_thesis(), 2e-3)
    tubes = tuple(replace(each, straight_length=0.05, curved_length=each.curved_length) for each in thesis.tubes)
    robot = replace(thesis, tubes=tubes, carriages=None)
    certificate = snap_free_certificate(robot, np.array(shift))
    assert certificate > 0.2
    bundle = bundle_at(robot, shift)
    bounds = bounds_of(bundle)
    assert bounds is not None
    for rotations in np.random.default_rng(0).uniform(-np.pi, np.pi, (20, 3)):
        pose = robot.fk(rotations, np.array(shift))
        assert pose.margin > certificate
        ends = np.clip(np.searchsorted(bounds.place[1], pose.point, side="left"), 0, len(bounds.curvature) - 1)
        within = np.maximum.accumulate(bounds.curvature)[ends]
        assert (np.linalg.norm(pose.point_curvature, axis=1) < within * (1 + 1e-9)).all()
        assert np.linalg.norm(robot.fk(rotations + 2 * np.pi, np.array(shift)).tip_position - pose.tip_position) < 1e-9


@pytest.mark.parametrize("seed", range(6))
def test_derivatives_of_the_proof_are_those_of_differences(seed: int) -> None:
    rng = np.random.default_rng(seed)
    robot, shift = apart(rng, (0.01, 0.02, 0.04)[seed % 3], 0.09)
    bundle, n = bundle_at(replace(robot, sheath_stiffness=0.01), tuple(shift.tolist())), robot.n_tubes
    # A proof sees a robot from the end of its rigid sheath.
    of_tubes = [name for name in CHANGED if name != "rotations" and not name.startswith("sheath")]
    sizes = {name: rng.normal(size=(n, 2)) for name in of_tubes}
    for name in ("translations", "straight_length", "curved_length", "offset"):
        sizes[name] *= 1e-3 * (bundle.transmission > 0)[:, None] if name != "offset" else 1e-4
    sizes["sheath_stiffness"] = 0.01 * rng.normal(size=(1, 2))
    for name in ("curvature", "bending_stiffness", "torsional_stiffness"):
        sizes[name] *= getattr(bundle, name)[:, None]

    def moved(step: float, k: int) -> Array:
        out = {field.name: getattr(bundle, field.name) for field in fields(bundle)}
        for name, rows in sizes.items():
            for quantity, factor in CHANGED[name].items():
                out[quantity] = out[quantity] + step * factor * (rows[0, k] if quantity == "sheath" else rows[:, k])
        parts = proof_parts(Bundle(**out))
        assert parts is not None
        return parts

    slopes = proof_slopes(bundle, sizes)
    assert slopes.shape == (1 + n * (n - 1) // 2, 2)
    for k in range(2):
        difference = (moved(1e-6, k) - moved(-1e-6, k)) / 2e-6
        assert slopes[:, k] == pytest.approx(difference, rel=1e-6, abs=1e-8)
    assert moved(0.0, 0)[0] == bundle_proof(bundle).margin


def test_thin_strips_count() -> None:
    """Tubes that oppose each other at offsets below a nanometre: an arm of 1 mm is one of 1 m at another scale."""
    found = []
    for length in (1e-3, 1.0):
        two, d = np.ones(2), 3e-7 * length
        bundle = Bundle(
            bending_stiffness=0.02 * two,
            torsional_stiffness=0.015 * two,
            curvature=two / length,
            offset=d * two,
            angle=np.array([0.0, np.pi]),
            transmission=0 * two,
            transition=0 * two,
            end=length * np.array([1.0, 1.0 + 1e-5]),
        )
        found.append(bundle_proof(bundle).margin)
    assert found[1] > -np.inf
    assert found[0] == pytest.approx(found[1], abs=1e-9)


def test_certified_robots_do_not_snap_on_random_paths() -> None:
    found = [wrong for seed in range(8) if (wrong := snaps_of(seed, 4)) is not None]
    assert len(found) >= 4
    assert not any(found)


def test_three_hundred_certified_robots_do_not_snap_on_thirty_paths_each() -> None:
    found: list[int] = []
    seed = 100
    while len(found) < 300:
        wrong = snaps_of(seed, 30)
        found += [] if wrong is None else [wrong]
        seed += 1
    assert not any(found)


def test_the_command_tells_what_is_proved_and_what_is_missing(run: Run, tmp_path: Path) -> None:
    staggered(bundle_of_thesis(), 2e-3).save(tmp_path / "apart.yaml")
    found = answer(run("certify", str(tmp_path / "apart.yaml"), "--json"))
    assert (found["finding"], found["exit_code"]) == ("SNAP_FREE", 0)
    bundle_of_thesis().save(tmp_path / "together.yaml")
    outcome = run("certify", str(tmp_path / "together.yaml"))
    assert outcome.code == 4
    assert "Own lengths that differ by more than about 1.56 mm" in " ".join(outcome.out.split())
