"""The snap-free certificate against closed forms and finite elements, and the worst cases that are found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from tests.examples import CRL, MM, THESIS
from tests.stability.reference import Bundle, Elements, bundle, settle_at, worst_by_elements
from tests.stability.robots import random_robot, random_translations, unit_pair
from tubeopt import ConcentricRobot, InputError, Piece, Tube, snap_free_certificate
from tubeopt.physics.certificate import PARAMETERS
from tubeopt.stability import SnapSearch, certify, worst_certificate, worst_margin
from tubeopt.typing import Array


def exact_two_tube_margin(tubes: Bundle) -> float:
    """The worst margin of two tubes, from the first root of cos q = (l/L) q sin q with q^2 = c L^2 / (1 - mu).

    Unequal tubes: their difference y obeys y'' = -c y with c = c_12 (1/kt_1 + 1/kt_2) and, since their moments balance,
    y(0) = l y'(0) with l the mean of the transmissions weighted by compliance. A stretch without coupling in front of
    the overlap adds to l.
    """
    k = np.flatnonzero(tubes.coupling[:, 0, 1])
    if not len(k):
        return 1.0
    (section,) = k
    compliance = 1 / tubes.torsional
    c = abs(tubes.coupling[section, 0, 1]) * compliance.sum()
    lever = tubes.lever @ compliance / compliance.sum() + tubes.length[:section].sum()
    length = tubes.length[section]
    q = brentq(lambda q: np.cos(q) - lever / length * q * np.sin(q), 0.0, 2.0, xtol=1e-14)
    return float(1 - c * length**2 / q**2)


def test_two_tubes_have_the_exact_worst_margin() -> None:
    random = np.random.default_rng(1)
    signs = {False: 0, True: 0}
    for _ in range(400):
        c, lever = random.uniform(0.05, 4.0), random.uniform(0.0, 2.0) * random.choice([0.0, 1.0])
        mu = snap_free_certificate(unit_pair(c, lever))
        root = np.sqrt(c)
        free = bool(root < np.pi / 2 and lever * root * np.tan(root) < 1)
        assert (mu > 0) == free
        q = brentq(lambda q, lever=lever: np.cos(q) - lever * q * np.sin(q), 0.0, 2.0, xtol=1e-14)
        assert mu == pytest.approx(1 - c / q**2, abs=1e-6)
        signs[free] += 1
    assert min(signs.values()) > 40


def test_unequal_pairs_anywhere_have_the_exact_worst_margin() -> None:
    """Unequal nu, walls, transmissions; curved parts in part behind the plate or all in front of it."""
    random = np.random.default_rng(2)
    behind = ahead = 0
    for _ in range(150):
        robot = random_robot(random, 2, bend=random.uniform(0.2, 3.0))
        shift = random_translations(random, robot)
        tubes = bundle(robot, shift)
        exact = exact_two_tube_margin(tubes)
        assert snap_free_certificate(robot, shift) == pytest.approx(exact, rel=1e-6, abs=1e-6)
        behind += bool((shift < 0).any())
        ahead += bool((shift > 0).all())
    assert min(behind, ahead) > 10


@pytest.mark.parametrize("n", [3, 4])
def test_collocation_and_finite_elements_agree(n: int) -> None:
    random = np.random.default_rng([3, n])
    for _ in range(12):
        robot = random_robot(random, n, bend=random.uniform(0.3, 2.5))
        shift = random_translations(random, robot)
        tubes = bundle(robot, shift)
        mu = snap_free_certificate(robot, shift)
        assert mu == pytest.approx(worst_by_elements(tubes), rel=1e-6, abs=1e-6)
        assert certify(robot, shift).margin == mu


@pytest.mark.parametrize("n", [2, 3])
def test_gradient_is_that_of_finite_differences(n: int) -> None:
    random = np.random.default_rng([4, n])
    for _ in range(8):
        robot = random_robot(random, n, bend=random.uniform(0.5, 2.0))
        long = tuple(replace(tube, straight_length=tube.straight_length + 0.02) for tube in robot.tubes)
        robot = ConcentricRobot(long)
        # A little off, so that no two breakpoints are one.
        shift = random.uniform(-0.3, 0.6, n) * [tube.curved_length for tube in robot.tubes]
        shift = np.minimum(shift, [tube.straight_length for tube in robot.tubes]) - 1e-3 * np.arange(1, n + 1)
        certificate = certify(robot, shift)
        if certificate.margin > 1 - 1e-9:
            continue
        for name in PARAMETERS:
            size = np.abs(certificate.gradient[name]).max()
            for i in range(n):
                up, down = (_moved(robot, shift, name, i, sign) for sign in (1, -1))
                slope = (worst_by_elements(bundle(*up[:2])) - worst_by_elements(bundle(*down[:2]))) / (up[2] - down[2])
                assert certificate.gradient[name][i] == pytest.approx(slope, rel=1e-5, abs=1e-5 * size + 1e-7), name


@pytest.mark.parametrize("robot", [CRL, THESIS], ids=lambda robot: robot.name)
def test_gradient_where_breakpoints_meet_is_that_of_growing_parameters(robot: ConcentricRobot) -> None:
    # At home all transitions are at the plate, and tubes end together.
    home = np.array(robot.home_translations)
    certificate = certify(robot, home)
    for i in range(robot.n_tubes):
        ends = [home + step * np.eye(robot.n_tubes)[i] for step in (0, 1e-6, 2e-6)]
        start, near, far = (snap_free_certificate(robot, shift) for shift in ends)
        slope = (4 * near - 3 * start - far) / 2e-6
        assert certificate.gradient["translation"][i] == pytest.approx(slope, rel=1e-4, abs=1e-4)
        tube = robot.tubes[i]
        longer = [replace(tube, curved_length=tube.curved_length + step) for step in (1e-6, 2e-6)]
        grown = [replace(robot, tubes=(*robot.tubes[:i], one, *robot.tubes[i + 1 :])) for one in longer]
        near, far = (snap_free_certificate(one, home) for one in grown)
        slope = (4 * near - 3 * start - far) / 2e-6
        assert certificate.gradient["curved_length"][i] == pytest.approx(slope, rel=1e-4, abs=1e-4)


def _moved(robot: ConcentricRobot, shift: Array, name: str, i: int, sign: int) -> tuple[ConcentricRobot, Array, float]:
    """A robot and translations with one parameter of tube i a little off, and the parameter's value."""
    tube = robot.tubes[i]
    if name == "translation":
        moved = shift.copy()
        moved[i] += sign * 1e-6
        return robot, moved, float(moved[i])
    material = tube.material
    if name in ("bending_stiffness", "torsional_stiffness"):
        field = "youngs_modulus" if name == "bending_stiffness" else "shear_modulus"
        # Half way between the limits of Poisson's ratio there is room on both sides.
        material = replace(material, **{field: getattr(material, field) * (1 + 1e-5 * sign)})
        changed = replace(tube, material=material)
    else:
        value = getattr(tube, name)
        changed = replace(tube, **{name: value + sign * (1e-5 * value if name == "curvature" else 1e-6)})
    tubes = (*robot.tubes[:i], changed, *robot.tubes[i + 1 :])
    return ConcentricRobot(tubes), shift, float(getattr(changed, name))


def test_three_tubes_never_do_better_than_found() -> None:
    random = np.random.default_rng(5)
    gaps = []
    for _ in range(4):
        robot = random_robot(random, 3, bend=random.uniform(0.3, 2.0))
        shift = random_translations(random, robot)
        proved = snap_free_certificate(robot, shift)
        result = worst_margin(robot, shift)
        assert proved <= result.margin + 1e-9
        assert result.margin == pytest.approx(result.equilibrium.margin, abs=1e-9)
        gaps.append((result.margin - proved) / max(1 - proved, 1e-12))
        # The state that was found is an equilibrium, of that margin, in finite elements too.
        e = result.equilibrium
        state = settle_at(robot, e.rotations, shift, e.tip_rotations)
        margin = min(1.0, float(state.elements.margins(state.rotations, state.theta)[0]))
        assert margin == pytest.approx(result.margin, rel=1e-6, abs=1e-5)
    assert np.median(gaps) < 0.2


def test_no_state_of_many_robots_is_below_the_certificate() -> None:
    random = np.random.default_rng(6)
    for k in range(30):
        robot = random_robot(random, 2 + k % 3, bend=random.uniform(0.3, 2.5))
        shift = random_translations(random, robot)
        proved = snap_free_certificate(robot, shift)
        elements = Elements(bundle(robot, shift))
        for _ in range(10):
            theta = np.tile(random.uniform(0, 2 * np.pi, robot.n_tubes), (len(elements.node), 1))
            theta += np.outer(elements.node / elements.node[-1], random.normal(0, 1, robot.n_tubes))
            assert proved <= min(1.0, float(elements.margins(theta[0], theta)[0])) + 1e-6


def test_two_tubes_are_found_as_bad_as_proved() -> None:
    robot = unit_pair(2.0, 0.5)
    result = worst_margin(robot)
    assert result.margin == pytest.approx(snap_free_certificate(robot), abs=1e-6)
    assert float(np.cos(np.subtract(*result.equilibrium.tip_rotations))) == pytest.approx(-1.0, abs=1e-6)
    assert repr(result).startswith("WorstMargin(margin=")


def test_pair_section_and_share() -> None:
    certificate = certify(THESIS)
    assert certificate.pair == (0, 1)
    assert not certificate.snap_free
    fraction = certificate.pair_fractions
    assert fraction == pytest.approx(fraction.T)
    assert np.triu(fraction).sum() == pytest.approx(1.0)
    assert certificate.section is not None
    start, stop = certificate.section
    # At home the three tubes are curved over 0.1 m, the inner two up to 0.15 m.
    assert [start, stop] == pytest.approx([0.0, 0.1])
    assert [name for name, slope in certificate.gradient.items() if not np.isfinite(slope).all()] == []


def test_no_coupling_is_no_danger() -> None:
    single = certify(ConcentricRobot(THESIS.tubes[:1]))
    assert (single.margin, single.pair, single.section) == (1.0, None, None)
    inner, middle, _ = THESIS.tubes
    straight = ConcentricRobot((inner, replace(middle, curvature=0.0)))
    assert snap_free_certificate(straight) == 1.0
    assert worst_margin(straight).margin == pytest.approx(1.0)
    assert all((slope == 0).all() for slope in certify(straight).gradient.values())


def test_a_double_eigenvalue_has_no_gradient() -> None:
    """Three tubes with equal moments and stiffness: two directions are equally soft."""
    tubes = []
    bore = 0.5 * MM
    for _ in range(3):
        tube = Tube(bore + 0.2 * MM, bore, 0.0, 0.1, 1.0, THESIS.tubes[0].material)
        tubes.append(tube)
        bore += 0.21 * MM
    stiff = tubes[0].bending_stiffness
    alike = []
    for tube in tubes:
        material = replace(
            tube.material,
            youngs_modulus=tube.material.youngs_modulus * stiff / tube.bending_stiffness,
            shear_modulus=tube.material.shear_modulus * stiff / tube.bending_stiffness,
        )
        alike.append(replace(tube, curvature=12.0, material=material))
    certificate = certify(ConcentricRobot(tuple(alike)))
    assert certificate.margin < 1
    assert all(np.isnan(slope).all() for slope in certificate.gradient.values())


@pytest.mark.parametrize(("robot", "least"), [(THESIS, 0.0), (CRL, -0.03)], ids=["thesis", "CRL"])
def test_worst_over_translations_against_a_grid(robot: ConcentricRobot, least: float) -> None:
    """Of three tubes that move, and of two where the third one stays."""
    low = np.array([-0.03, -0.03, least])
    high = np.minimum([0.05, 0.05, 0.05 if least else 0.0], [tube.straight_length for tube in robot.tubes])
    worst = worst_certificate(robot, low, high, effort=SnapSearch(evaluations=120))
    axes = [np.linspace(a, b, 4) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)
    observed = min(snap_free_certificate(robot, shift) for shift in grid)
    assert worst.certificate.margin <= observed + 1e-9
    assert (worst.certificate.translations >= low - 1e-12).all()
    assert (worst.certificate.translations <= high + 1e-12).all()
    assert worst.certificate.margin == pytest.approx(snap_free_certificate(robot, worst.certificate.translations))


def test_the_least_certificate_of_an_s_over_a_box_is_a_certificate() -> None:
    """It is bounded where it is least, and no place of a grid has less."""
    inner = Tube.of_pieces(1.0e-3, 0.7e-3, [Piece(0.04, 8.0), Piece(0.04, -8.0)], straight_length=0.12)
    outer = Tube.of_pieces(1.6e-3, 1.2e-3, [Piece(0.03, 12.0), Piece(0.03, -10.0)], straight_length=0.06)
    robot = ConcentricRobot((inner, outer))
    low, high = np.array([-0.02, 0.0]), np.array([0.01, 0.0])
    worst = worst_certificate(robot, low, high, effort=SnapSearch(evaluations=60)).certificate
    assert worst.margin == snap_free_certificate(robot, worst.translations)
    grid = [snap_free_certificate(robot, low + x * (high - low)) for x in np.linspace(0, 1, 16)]
    assert worst.margin <= min(grid) + 1e-9
    assert worst.margin > min(grid) - 0.01


def test_worst_over_a_box_without_extent() -> None:
    shift = np.array([0.01, 0.0, -0.01])
    worst = worst_certificate(THESIS, shift, shift)
    assert worst.certificate.margin == snap_free_certificate(THESIS, shift)
    assert worst.evaluations == 1


def test_messages() -> None:
    with pytest.raises(InputError, match="translations has 2 numbers; it must be 3"):
        snap_free_certificate(THESIS, [0.0, 0.0])
    with pytest.raises(InputError, match=r"translation of tube 2 is 0.2 m"):
        certify(THESIS, [0.0, 0.2, 0.0])
    with pytest.raises(InputError, match="every number must be finite"):
        worst_margin(THESIS, [0.0, np.nan, 0.0])
    with pytest.raises(InputError, match=r"lower translation of tube 1 is 0.01 m; it must be at most upper, 0 m"):
        worst_certificate(THESIS, [0.01, 0.0, 0.0], [0.0, 0.0, 0.0])
