"""Bounds of stability from both sides: by closed forms and by brute force."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from tests.examples import CRL, nested
from tests.physics.test_loaded_certificate import ritz
from tubeopt import ConcentricRobot, EccentricRobot, Piece, Tube, certify, deflection_bound, snap_free_certificate
from tubeopt.equilibrium.problem import DEFAULT_DISCRETISATION, reduced_problem
from tubeopt.stability.certificate import arm_sections, convexity, loaded_worst_case, worst_case
from tubeopt.stability.deflection import under_any_force
from tubeopt.stability.eccentric_certificate import Segment, cross_sections, longest, proved_margin


def test_a_cantilever_moves_by_the_cube_of_its_length_over_three_times_its_stiffness() -> None:
    """F L^3 / 3 EI for a straight tube; a point inside by F s^2 (3 L - s) / 6 EI, which the bound exceeds."""
    robot = ConcentricRobot((Tube(1.2e-3, 1.0e-3, 0.0, 0.1, 0.0),))
    stiffness, force, length = robot.tubes[0].bending_stiffness, 1e-4, 0.1
    margin = snap_free_certificate(robot, max_force=force)
    assert 0.99 < margin <= 1
    tip, middle = deflection_bound(robot, max_force=force, arc_length=[length, length / 2])
    exact = force * length**3 / (3 * stiffness)
    assert tip * margin == pytest.approx(exact, rel=1e-9)
    assert middle * margin == pytest.approx(exact / 8**0.5, rel=1e-9)
    assert middle > force * 0.05**2 * (3 * length - 0.05) / (6 * stiffness)


def test_a_curved_tube_moves_by_what_bends_and_by_what_twists_it() -> None:
    """kappa(s)^2 = s^3 / 3 K + A^2 s^5 / 20 kt of a tube that begins at the plate, bent by A."""
    curvature, length, force = 4.0, 0.1, 1e-4
    robot = ConcentricRobot((Tube(1.2e-3, 1.0e-3, 0.0, length, curvature),))
    tube, s = robot.tubes[0], np.array([length, length / 2])
    kappa = np.sqrt(s**3 / 3 / tube.bending_stiffness + curvature**2 * s**5 / 20 / tube.torsional_stiffness)
    margin = snap_free_certificate(robot, max_force=force)
    result = deflection_bound(robot, max_force=force, arc_length=s)
    assert result * margin == pytest.approx(force * kappa[0] * kappa, rel=1e-9)


def test_what_bends_and_twists_an_arm_is_summed_as_by_brute_force() -> None:
    """kappa(s)^2 by sums over many points, sections and tubes at once."""
    shift, force = np.array([-0.02, 0.0, 0.0]), 1e-3
    bundle = arm_sections(CRL, shift)
    length = bundle.total_length

    def kappa(s: float) -> float:
        x = (np.arange(40000) + 0.5) / 40000 * s
        section = np.searchsorted(bundle.start + bundle.length, x).clip(0, len(bundle.start) - 1)
        slope = bundle.natural_moment[section] / bundle.stiffness[section, None]
        step = s / len(x)
        moment = np.cumsum((((s - x)[:, None] * slope)[::-1]), axis=0)[::-1] * step
        inside = (s - x) ** 2 / bundle.stiffness[section] + (moment**2 / bundle.torsional).sum(1)
        return float(np.sqrt(inside.sum() * step + (bundle.transmission * moment[0] ** 2 / bundle.torsional).sum()))

    margin = snap_free_certificate(CRL, shift, max_force=force)
    result = deflection_bound(CRL, shift, max_force=force, arc_length=[length, length / 2])
    exact = force * kappa(length) * np.array([kappa(length), kappa(length / 2)]) / margin
    assert result == pytest.approx(exact, rel=1e-3)


def test_three_equal_tubes_share_what_takes_from_the_certificate() -> None:
    robot = EccentricRobot(Tube(1.2e-3, 1.0e-3, 0.0, 0.08, 12.0), transmission_length=0.05)
    fraction = certify(robot).pair_fractions
    assert np.triu(fraction, 1).sum() == pytest.approx(1.0)
    assert np.diag(fraction).max() == 0


def test_a_transmission_takes_away_from_the_certificate_what_the_closed_form_says() -> None:
    """Two tubes, alike, on the centreline: tan form of docs/theory.md, 1 - mu = (L lambda)^2 / x^2."""
    robot = nested((0.0, 0.1, 3.0), (0.0, 0.1, 3.0))
    one, two = robot.tubes
    pull = one.bending_stiffness * 3.0 * two.bending_stiffness * 3.0 / (one.bending_stiffness + two.bending_stiffness)
    rate = pull * (1 / one.torsional_stiffness + 1 / two.torsional_stiffness)
    exact = 1 - rate * (0.1 * 2 / np.pi) ** 2
    assert snap_free_certificate(robot) == pytest.approx(exact, rel=1e-6)


def test_what_a_mesh_leaves_out_is_taken_off_the_certificate() -> None:
    """Curvatures that wave faster than the mesh follows: it says too much, and the bound is below a mesh of eighths."""

    def waving(outer: float, inner: float, bend: float, rate: float) -> Tube:
        def curvature(s: np.ndarray) -> tuple[np.ndarray, float, float]:
            return bend * np.cos(rate * s), 0.0, 0.0

        return Tube.of_pieces(outer * 1e-3, inner * 1e-3, [Piece(0.1, curvature)])

    robot = ConcentricRobot((waving(1.0, 0.8, 6, 40), waving(1.3, 1.1, 4, 28), waving(1.6, 1.4, 3, 52)))
    home = np.array(robot.home_translations)

    def on_mesh(refinement: int) -> float:
        discretisation = replace(DEFAULT_DISCRETISATION, refinement=refinement)
        return worst_case(reduced_problem(robot, tuple(home.tolist()), discretisation))[0]

    plain, finest = on_mesh(0), on_mesh(3)
    assert plain > finest + 1e-11
    assert finest - 2 * (plain - finest) < convexity(robot, home) <= finest + 1e-13
    assert snap_free_certificate(robot) == convexity(robot, home) == certify(robot).margin


def stretched_segment(*outer: tuple[float, float]) -> Segment:
    """Three tubes with outer segments (delta, length)."""
    return Segment((0, 1, 2), (0.0, 0.05), 10.0, delta=0.2, length=0.5, transmission=1.0, outer=outer)


def test_outer_segments_stretch_three_tubes_by_their_spread() -> None:
    """By D cos(c), D cos(c + 120 deg), D cos(c - 120 deg): the square is 3/2 D^2, at any rotations of their tubes."""
    random, outer = np.random.default_rng(0), ((0.05, 0.7), (0.02, 1.3))
    theta = random.uniform(0, 2 * np.pi, (400, len(outer), 3))
    theta[:50] = random.uniform(0, 2 * np.pi, (50, 1, 1))
    each = [length * (cross_sections(theta[:, k], delta)[1] - 1) for k, (delta, length) in enumerate(outer)]
    stretch = np.sum(each, axis=0)
    assert stretch.sum(1) == pytest.approx(np.zeros(400), abs=1e-12)
    largest = np.sqrt(2 / 3 * (stretch**2).sum(1).max())
    assert 0.999 * stretched_segment(*outer).spread <= largest <= stretched_segment(*outer).spread


@pytest.mark.parametrize("outer", [(), ((0.25, 2.0),), ((0.1, 3.0), (0.2, 2.5))])
def test_the_proof_of_unequal_transmissions_is_sharp(outer: tuple[tuple[float, float], ...]) -> None:
    """R = tan(phi) P + delta x J is less than the inverse of lam + D cos(c + 120 deg i) for all c, and no more."""
    segment, alike = stretched_segment(*outer), np.ones((3, 3)) / 3
    apart = np.cos(np.linspace(0, 2 * np.pi, 73)[:, None] + 2 * np.pi / 3 * np.arange(3))

    def left(reach: float, soft: float) -> float:
        each = soft * (segment.transmission + segment.spread * apart)
        forms = np.eye(3) / each[:, None] - (np.eye(3) - alike) / reach - segment.delta * soft * segment.length * alike
        return float(np.linalg.eigvalsh(forms)[:, 0].min())

    def excess(soft: float) -> float:
        reach = brentq(left, 1e-3, 1e3, args=(soft,), xtol=1e-13)
        return soft * segment.length - longest(segment.delta, np.arctan(1 / reach))

    true = 1 - 1 / brentq(excess, 0.3, 1.5, xtol=1e-12) ** 2
    assert proved_margin(segment) == pytest.approx(true, abs=1e-9)


def test_the_proof_of_transmissions_far_longer_than_a_segment_is_sharp() -> None:
    """A segment fails where tan(phi(X)) is 1 / lam, however far beyond that turns of all tubes alike are bounded."""
    segment = replace(stretched_segment(), transmission=8.0)
    true = brentq(lambda soft: soft * 0.5 - longest(0.2, np.arctan(1 / (8 * soft))), 0.1, 1.0, xtol=1e-13)
    assert 0.2 * (np.pi / 2) * 8 * np.pi > 1
    assert proved_margin(segment) == pytest.approx(1 - 1 / true**2, abs=1e-9)


@pytest.mark.parametrize("share", [0.5, 0.99, 1.01])
def test_a_straight_tube_keeps_what_one_and_a_half_times_the_force_leaves_of_eulers_load(share: float) -> None:
    """1 - 3/2 F (2 L / pi)^2 / EI; where nothing is left no deflection is bounded."""
    robot, length = nested((0.0, 0.1, 0.0)), 0.1
    force = share * robot.tubes[0].bending_stiffness * (np.pi / 2 / length) ** 2 / 1.5
    assert snap_free_certificate(robot, max_force=force) == pytest.approx(1 - share, abs=1e-9)
    result, moved = under_any_force(robot, np.zeros((2, 1)), force), deflection_bound(robot, max_force=force)
    assert result.margin == pytest.approx(1 - share, abs=1e-9)
    assert result.deflection == moved[0]
    assert (result.deflection == np.inf) == (share > 1)


def test_no_force_makes_a_robot_stabler_than_it_is_without() -> None:
    robot = nested((0.0, 0.1, 0.0))
    for unloaded in (1.0, -0.5):
        result = loaded_worst_case(robot, np.zeros(1), unloaded, 1e-9)
        assert unloaded - 1e-6 < result <= unloaded


def test_a_bundle_for_a_box_of_translations_is_as_soft_as_its_softest_arm() -> None:
    """In torsion as where a tube is softest, with the longest transmission, the longest arm, and every curved part."""
    soft, stiff = (Piece(0.03, 8.0, torsional_stiffness=kt) for kt in (1e-3, 2e-3))
    robot = ConcentricRobot((Tube.of_pieces(1.0e-3, 0.8e-3, [stiff, soft], straight_length=0.04),))
    bundle = arm_sections(robot, np.array([-0.02]), np.array([-0.01]))
    assert bundle.torsional == pytest.approx([1e-3])
    assert bundle.transmission == pytest.approx([0.06])
    assert bundle.total_length == pytest.approx(0.05)


def test_a_certificate_within_round_off_of_0_excludes_no_snap() -> None:
    result = certify(nested((0.0, 0.05, 3.0), (0.0, 0.05, 3.0)))
    assert result.snap_free
    assert [replace(result, margin=margin).snap_free for margin in (-1e-12, 0.0, 1e-12, 1e-10, 1e-8)] == [False] * 4 + [
        True
    ]


def test_a_bundle_for_a_box_of_translations_is_as_soft_and_as_curved_as_any_arm_at_a_place() -> None:
    """Stiffness and pull at every place, of two tubes that move by themselves, by all arms of a grid."""
    robot = nested((0.02, 0.05, 4.0), (0.01, 0.03, 3.0))
    near, far = np.array([0.005, 0.002]), np.array([0.012, 0.006])
    bundle = arm_sections(robot, near, far)
    positions = bundle.start + bundle.length / 2
    softest, pulls = np.full(len(positions), np.inf), np.zeros((len(positions), 2))
    kb, kappa = np.array([[tube.bending_stiffness, tube.curvature] for tube in robot.tubes]).T
    for fractions in np.stack(np.meshgrid(*[np.linspace(0, 1, 30)] * 2), axis=-1).reshape(-1, 2):
        start = near + fractions * (far - near)
        reached = positions[:, None] < start + np.array([0.05, 0.03])
        softest = np.minimum(softest, np.where(reached.any(1), reached @ kb, np.inf))
        pulls = np.maximum(pulls, (reached & (start < positions[:, None])) * kb * kappa)
    assert bundle.stiffness == pytest.approx(softest)
    assert bundle.natural_moment == pytest.approx(pulls)


@pytest.mark.parametrize(("tubes", "force"), [(2, 0.05), (2, 0.5), (3, 0.002)])
def test_a_force_leaves_the_larger_of_two_bounds(tubes: int, force: float) -> None:
    """Of pairs and force at once, and of what the force takes alone from the margin without it."""
    robot = nested((0.03, 0.05, 12.0), (0.02, 0.05, 12.0), (0.01, 0.05, 12.0))
    robot = ConcentricRobot(robot.tubes[3 - tubes :])
    unloaded, bundle = snap_free_certificate(robot), arm_sections(robot, np.zeros(tubes))
    sections = (bundle.length, bundle.stiffness, bundle.natural_moment)
    torsion = (bundle.torsional, bundle.transmission)
    together, apart = (ritz(force, sections, torsion, pairs) for pairs in ((1, 1), (0, 0)))
    assert (1 - together > unloaded - apart) == (tubes == 2)
    assert 1 - together < unloaded
    assert snap_free_certificate(robot, max_force=force) == pytest.approx(max(1 - together, unloaded - apart), abs=1e-8)
