"""Tubes made of pieces, solved: against shooting that shares nothing with the library, and against closed forms."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import brentq
from scipy.special import ellipj

from tests.general_reference import Bundle, Stretch, shoot, straight
from tubeopt import (
    ConcentricRobot,
    Equilibrium,
    InputError,
    Load,
    Piece,
    Tube,
    energy_map,
    find_equilibria,
    find_snap,
    forward_kinematics,
    forward_kinematics_batch,
    inverse_kinematics,
    snap_free_certificate,
)
from tubeopt.equilibrium.linearised import linearise
from tubeopt.inverse.answer import InverseOptions
from tubeopt.robots.pieces import Series, times
from tubeopt.solvers.compiled.binding import kernel_of
from tubeopt.typing import Array


def straight_then(before: float, length: float, u: object, bending: object, torsional: object) -> tuple[Tube, ...]:
    """A tube whose stiffness varies along its straight part too: of two pieces, without a straight part."""
    pieces = [
        Piece(before, 0.0, bending_stiffness=bending, torsional_stiffness=torsional),
        Piece(
            length,
            u,
            bending_stiffness=lambda x: bending(before + x),  # type: ignore[operator]
            torsional_stiffness=lambda x: torsional(before + x),  # type: ignore[operator]
        ),
    ]
    return tuple(pieces)  # type: ignore[return-value]


def varying() -> tuple[ConcentricRobot, Bundle, Array]:
    """Three tubes of which everything varies: lengths before and after, u*, EI, GJ; and where they are held."""
    data = [
        (
            (0.12, 0.10),
            lambda x: (18 * math.cos(20 * x), 4 * math.sin(30 * x), 12.0),
            lambda s: 8e-4 * (1 + 0.3 * math.sin(40 * s)),
            lambda s: 6e-4 * (1 + 0.2 * math.sin(55 * s)),
        ),
        ((0.08, 0.08), lambda x: (9.0, 0.0, -6.0), lambda s: 2e-3 * (1 + 0.2 * math.sin(60 * s)), lambda s: 1.6e-3),
        ((0.05, 0.06), lambda x: (5.0, 2.0, 0.0), lambda s: 4e-3, lambda s: 3e-3),
    ]
    tubes, bundle = [], []
    for k, ((before, after), u, kb, kt) in enumerate(data):
        outer = 1e-3 + 0.5e-3 * k
        pieces = straight_then(before, after, u, kb, kt)
        tubes.append(Tube.of_pieces(outer, outer - 0.3e-3, pieces))  # type: ignore[arg-type]
        behind: Stretch = (
            after,
            u,
            lambda x, kb=kb, before=before: kb(before + x),  # type: ignore[misc]
            lambda x, kt=kt, before=before: kt(before + x),  # type: ignore[misc]
        )
        bundle.append([(before, lambda x: (0.0, 0.0, 0.0), kb, kt), behind])
    return ConcentricRobot(tuple(tubes)), bundle, np.array([-0.06, -0.04, -0.02])


ROBOT, BUNDLE, BETA = varying()
TURNED = [0.2, 1.5, -1.0]
INNER = ConcentricRobot(ROBOT.tubes[:2])


@pytest.fixture(scope="module")
def solved() -> Equilibrium:
    return forward_kinematics(ROBOT, TURNED, BETA, tolerance=1e-10, verify=True)


def test_varying_tubes_are_where_shooting_puts_them(solved: Equilibrium) -> None:
    at_plate = [piece[0][3](-beta) for piece, beta in zip(BUNDLE, BETA, strict=True)]
    shot = shoot(BUNDLE, TURNED, BETA.tolist(), (solved.torsion[:, 0] * at_plate).tolist())
    assert np.linalg.norm(solved.tip_position - shot.tip) < 1e-10
    assert np.abs(solved.tip_rotation - shot.frame).max() < 1e-9
    assert np.abs(solved.rotation[:, 0] - shot.theta).max() < 1e-10
    assert shot.stable == solved.stable


def test_verification_agrees(solved: Equilibrium) -> None:
    check = solved.verification
    assert check is not None
    assert max(check.tip_position, check.base_rotation, check.end_torsion) < 1e-10


def test_the_kernel_finds_what_the_general_solver_finds(solved: Equilibrium) -> None:
    if kernel_of(ROBOT) is None:
        pytest.skip("no C compiler")
    batch = forward_kinematics_batch(ROBOT, [TURNED, [1.0, 0.0, 2.0]], BETA, tolerance=1e-3)
    assert np.abs(batch.tip_position[0] - solved.tip_position).max() < 1e-6
    fine = forward_kinematics(ROBOT, [1.0, 0.0, 2.0], BETA, tolerance=1e-10)
    assert np.abs(batch.tip_position[1] - fine.tip_position).max() < 1e-6
    assert batch.margin[1] == pytest.approx(fine.margin, abs=1e-5)
    assert batch.energy[1] == pytest.approx(fine.energy, rel=1e-6)


def frenet(radius: float, pitch: float, length: float) -> Array:
    """The end of a helix whose tangent begins along z and whose normal is -y, by its own formula."""
    lead = pitch / (2 * math.pi)
    size = math.hypot(radius, lead)
    angle = length / size
    # Axis, and the three directions of the helix where it begins.
    tangent, normal = np.array([0.0, 0.0, 1.0]), np.array([0.0, -1.0, 0.0])
    binormal = np.cross(tangent, normal)
    axis = (lead * tangent + radius * binormal) / size
    around = np.cross(axis, normal)
    centre = radius * normal
    out = centre - radius * (math.cos(angle) * normal + math.sin(angle) * around) + lead * angle * axis
    return np.asarray(out)


@pytest.mark.parametrize("turn", [0.0, 1.0])
def test_a_single_helix_keeps_its_helix(turn: float) -> None:
    tube = Tube.of_pieces(1e-3, 0.8e-3, [Piece.helix(0.12, 0.02, 0.08)], straight_length=0.05)
    equilibrium = forward_kinematics(ConcentricRobot((tube,)), [turn])
    end = frenet(0.02, 0.08, 0.12)
    turned = np.array([[math.cos(turn), -math.sin(turn), 0], [math.sin(turn), math.cos(turn), 0], [0, 0, 1.0]]) @ end
    assert np.linalg.norm(equilibrium.tip_position - turned) < 1e-12
    lead = 0.08 / (2 * math.pi)
    assert equilibrium.torsion == pytest.approx(np.full_like(equilibrium.torsion, lead / (0.02**2 + lead**2)))


def pair(twist: float = 0.0, factors: tuple[float, float] = (1.0, 1.0), kappa: float = 12.5) -> ConcentricRobot:
    """Two tubes with the same natural twist and a pattern: overlap 100 mm, transmissions 50 mm."""
    tubes = []
    for outer, inner in ((1e-3, 0.8e-3), (1.25e-3, 1.05e-3)):
        plain = Tube(outer, inner, 0.05, 0.1, 0.0)
        own = [f * float(k) for f, k in zip(factors, (plain.bending_stiffness, plain.torsional_stiffness), strict=True)]
        piece = Piece(0.1, (kappa, 0.0, twist), bending_stiffness=own[0], torsional_stiffness=own[1])
        tubes.append(Tube.of_pieces(outer, inner, [piece], straight_length=0.05))
    return ConcentricRobot(tuple(tubes))


def test_equal_helices_twist_as_planar_tubes_do() -> None:
    wound, plain = (forward_kinematics(pair(twist), [0.0, 2.0], tolerance=1e-11) for twist in (30.0, 0.0))
    assert wound.margin == pytest.approx(plain.margin, abs=1e-8)
    relative = [result.rotation[0] - result.rotation[1] for result in (wound, plain)]
    at = np.linspace(0, 0.1, 9)
    curves = [np.interp(at, f.arc_length, r) for f, r in zip((wound, plain), relative, strict=True)]
    ends = [curve[[0, -1]] for curve in curves]
    assert ends[0] == pytest.approx(ends[1], abs=1e-9)
    assert wound.rotation[0, -1] == pytest.approx(plain.rotation[0, -1] + 3.0, abs=1e-9)


def fold(c: float, length: float, held: float) -> tuple[float, float]:
    """Differences of the tip and of the joint angles (rad) at the fold of two tubes, by the pendulum's closed form."""
    root = math.sqrt(c)

    def joint(al: float) -> float:
        k, rest = math.cos(al / 2), math.sin(al / 2)
        sn, cn, dn, _ = ellipj(root * length, k * k)
        # The part in front of the plate, and the transmissions.
        return 2 * math.acos(k * cn / dn) + 2 * held * root * k * rest * sn / dn

    def slope(al: float) -> float:
        # Of order 8: as good as round-off over the step.
        weights = np.array([4 / 5, -1 / 5, 4 / 105, -1 / 280])
        steps = 4e-3 * np.arange(1, 5)
        return float(weights @ [joint(al + h) - joint(al - h) for h in steps]) / 4e-3

    tip = float(brentq(slope, 0.1, math.pi - 0.1, xtol=1e-15))
    return tip, joint(tip)


def test_a_pattern_that_halves_c_moves_the_fold_as_the_closed_form_says() -> None:
    # c = (kb1 kappa1 kb2 kappa2) (1 / kt1 + 1 / kt2) / (kb1 + kb2) goes as the bending factor over the torsion factor.
    robots = [pair(factors=factors, kappa=20.0) for factors in ((1.0, 1.0), (0.4, 0.8))]
    coupling = []
    for robot in robots:
        kb = [float(tube.pieces[0].bending_stiffness) for tube in robot.tubes]
        kt = [float(tube.pieces[0].torsional_stiffness) for tube in robot.tubes]
        coupling.append(kb[0] * kb[1] * 20.0**2 / sum(kb) * (1 / kt[0] + 1 / kt[1]))
    assert coupling[1] == pytest.approx(coupling[0] / 2)
    # The straight parts are not patterned: they hold as if they were shorter by the torsion factor.
    tip, joint = fold(coupling[1], 0.1, 0.05 * 0.8)
    snap = find_snap(robot, ([0.0, 0.0], None), ([0.0, 2 * math.pi], None))
    assert snap is not None
    assert math.degrees(snap.rotations[1]) == pytest.approx(math.degrees(joint), abs=1e-8)
    ends = snap.before.tip_rotations
    assert math.degrees(ends[1] - ends[0]) == pytest.approx(math.degrees(tip), abs=1e-8)
    assert snap_free_certificate(robot) < 0


def test_all_equilibria_are_found_and_the_certificate_bounds_their_margins() -> None:
    tubes = []
    for k, u in enumerate([(20.0, 0.0, 25.0), (0.0, 18.0, -20.0)]):
        outer = 1e-3 + 0.4e-3 * k
        tubes.append(Tube.of_pieces(outer, outer - 0.25e-3, [Piece(0.1, u)], straight_length=0.1))
    robot = ConcentricRobot(tuple(tubes))
    certificate = snap_free_certificate(robot)
    smallest = 1.0
    for turn in np.linspace(0, 2 * np.pi, 7):
        equilibria = find_equilibria(robot, [0.0, turn])
        assert sum((-1) ** e.index for e in equilibria) == 1
        smallest = min(smallest, *(e.margin for e in equilibria))
    assert certificate <= smallest


NAMES = (
    "rotations", "translations", "curvature", "straight_length", "curved_length", "bending_stiffness",
    "torsional_stiffness",
)  # fmt: skip


def with_stiffness(tube: Tube, *, bending: float = 1.0, torsional: float = 1.0) -> Tube:
    """The tube with its stiffnesses, those of its pieces too, multiplied by numbers."""

    def changed(piece: Piece) -> Piece:
        own = piece.bending_stiffness, piece.torsional_stiffness
        new = [None if q is None else times(q, f) for q, f in zip(own, (bending, torsional), strict=True)]
        return replace(piece, bending_stiffness=new[0], torsional_stiffness=new[1])

    return replace(
        tube,
        bending_stiffness=float(tube.bending_stiffness) * bending,
        torsional_stiffness=float(tube.torsional_stiffness) * torsional,
        pieces=tuple(changed(piece) for piece in tube.pieces),
    )


def moved(robot: ConcentricRobot, name: str, tube: int, by: float) -> tuple[ConcentricRobot, Array]:
    """The robot with one tube changed, and the joint values to add (4,)."""
    joints, one, tubes = np.zeros(4), robot.tubes[tube], list(robot.tubes)
    match name:
        case "rotations" | "translations":
            joints[tube + 2 * (name == "translations")] = by
        case "curvature" | "straight_length":
            tubes[tube] = replace(one, **{name: getattr(one, name) + by})  # type: ignore[arg-type]
        case "curved_length":
            longer = 1 + by / one.curved_length
            pieces = tuple(piece.stretched(longer) for piece in one.chain)
            tubes[tube] = replace(one, curved_length=longer * one.curved_length, pieces=pieces if one.pieces else ())
        case "bending_stiffness":
            tubes[tube] = with_stiffness(one, bending=1 + by / one.bending_stiffness)
        case _:
            tubes[tube] = with_stiffness(one, torsional=1 + by / one.torsional_stiffness)
    return replace(robot, tubes=tuple(tubes)), joints


VARIED = Tube.of_pieces(
    1e-3,
    0.8e-3,
    [Piece(0.04, lambda x: (15 * math.cos(20 * x), 9.0, 10 * x)), Piece.helix(0.05, 0.03, 0.1)],
    straight_length=0.1,
)
AROUND = Tube.of_pieces(
    1.5e-3,
    1.2e-3,
    [Piece(0.03, 10.0), Piece(0.03, (-4.0, 8.0, 5.0), torsional_stiffness=lambda x: 0.02 + x)],
    straight_length=0.06,
)


@pytest.mark.parametrize("load", [None, Load((0.03, 0.02, -0.01))], ids=["no load", "force"])
@pytest.mark.parametrize(
    ("outer", "shift"),
    [(AROUND, (-0.02, -0.013)), (Tube(1.5e-3, 1.2e-3, 0.06, 0.06, 10.0), (-0.045, -0.013))],
    ids=["pieces", "one drawn back, one plain"],
)
def test_derivatives_are_those_of_central_differences(outer: Tube, shift: tuple[float, ...], load: Load | None) -> None:
    robot = ConcentricRobot((VARIED, outer))
    alpha, at = np.array([0.3, 2.0]), np.array(shift)
    jacobian = forward_kinematics(robot, alpha, at, load=load, tolerance=1e-10).jacobian(wrt=NAMES)
    table = np.concatenate([jacobian.position, jacobian.tip_rotations, jacobian.margin[None], jacobian.energy[None]])
    steps = {"rotations": 1e-4, "translations": 1e-5, "curvature": 1e-3, "straight_length": 1e-5, "curved_length": 1e-5}
    for k, (name, tube) in enumerate((name, tube) for name in NAMES for tube in range(2)):
        step = steps.get(name, 0.0) or 1e-4 * getattr(robot.tubes[tube], name)
        sides = []
        for by in (step, -step):
            other, joints = moved(robot, name, tube, by)
            e = forward_kinematics(other, alpha + joints[:2], at + joints[2:], load=load, tolerance=1e-10)
            sides.append(np.array([*e.tip_position, *e.tip_rotations, e.margin, e.energy]))
        difference = (sides[0] - sides[1]) / (2 * step)
        scale = np.array([np.abs(difference[:3]).max()] * 3 + [max(1e-3, np.abs(difference[3:5]).max())] * 2)
        scale = np.append(scale, [max(abs(difference[5]), 1e-4 / step), max(abs(difference[6]), 1e-6 / step)])
        assert np.abs((table[:, k] - difference) / scale).max() < 1e-5, (name, tube)


def test_a_longer_curved_part_where_breakpoints_meet() -> None:
    """Where a piece ends at the plate, its stretching moves it out or in: the derivatives differ to either side."""
    robot, alpha = ConcentricRobot((VARIED, AROUND)), np.array([0.3, 2.0])
    shift = np.array([-0.02, -0.03])
    current, step = forward_kinematics(robot, alpha, shift, tolerance=1e-10), 1e-5
    for side in (1, -1):
        other = moved(robot, "curved_length", 1, side * step)[0]
        reached = forward_kinematics(other, alpha, shift, tolerance=1e-10)
        result = current.jacobian(wrt=("curved_length",), side=side)
        expected = side * (reached.tip_position - current.tip_position) / step
        assert np.abs(result.position[:, 1] - expected).max() < 1e-3 * np.abs(expected).max()


def test_a_resized_tube_keeps_its_proportions() -> None:
    longer = AROUND.resized("curved_length", 0.09)
    assert longer.curved_length == pytest.approx(0.09)
    assert [piece.length for piece in longer.pieces] == pytest.approx([0.045, 0.045])
    assert longer.pieces[1].precurvature == AROUND.pieces[1].precurvature
    softer = AROUND.resized("torsional_stiffness", AROUND.torsional_stiffness / 2)
    one, other = (tube.pieces[1].torsional_stiffness for tube in (AROUND, softer))
    assert isinstance(one, Series)
    assert isinstance(other, Series)
    assert np.allclose(other([0.0, 0.01]), 0.5 * one([0.0, 0.01]))
    assert softer.bending_stiffness == AROUND.bending_stiffness
    assert softer.pieces[0].torsional_stiffness is None


@pytest.mark.parametrize("method", ["ipopt", "energy"])
def test_every_method_finds_the_same(method: str) -> None:
    """Least energy over theta and torsion, or the equations as constraints, of tubes of which everything varies."""
    known = forward_kinematics(INNER, TURNED[:2], BETA[:2])
    equilibrium = forward_kinematics(INNER, TURNED[:2], BETA[:2], method=method)
    assert np.abs(equilibrium.tip_position - known.tip_position).max() < 1e-10
    assert equilibrium.energy == pytest.approx(known.energy, rel=1e-10)


@pytest.mark.parametrize("method", ["gauss_newton", "nlp"])
def test_joint_values_for_the_tip(method: str) -> None:
    """Of tubes of which everything varies, with and without the nonlinear program."""
    goal, seed = forward_kinematics(INNER, TURNED[:2], BETA[:2]), (np.array(TURNED[:2]) + 0.3, BETA[:2] - 0.004)
    solution = inverse_kinematics(INNER, goal.tip_position, start=seed, options=InverseOptions(method=method))
    again = forward_kinematics(INNER, solution.rotations, solution.translations, start=solution.equilibrium)
    assert np.linalg.norm(again.tip_position - goal.tip_position) < 1e-8


def test_motion_along_the_arm_is_that_of_differences() -> None:
    """Of a point half-way and of the tip, by every joint, at fixed arc lengths."""
    current = forward_kinematics(ROBOT, TURNED, BETA, tolerance=1e-10)
    motion = linearise(current)
    k, step = len(current.arc_length) // 2, 1e-5
    position = current.arc_length[k]
    for joint in range(6):
        ends = []
        for side in (1, -1):
            change = side * step * np.eye(6)[joint]
            e = forward_kinematics(ROBOT, TURNED + change[:3], BETA + change[3:], start=current, tolerance=1e-10)
            s, first = np.unique(e.arc_length, return_index=True)
            ends.append((CubicHermiteSpline(s, e.position[first], e.frame[first][:, :, 2])(position), e.tip_position))
        inside, tip = ((a - b) / (2 * step) for a, b in zip(*ends, strict=True))
        scale = max(float(np.abs(tip).max()), 1e-3)
        assert np.abs(motion.tip_position[:, joint] - tip).max() < 1e-5 * scale
        assert np.abs(motion.position[k, :, joint] - inside).max() < 1e-3 * scale


def test_what_does_not_take_pieces_says_so() -> None:
    with pytest.raises(InputError, match=r"tube 1 is made of pieces; .* one constant bending stiffness"):
        ROBOT.assembly(BETA).bending_stiffness * 2.0


def test_a_straight_stretch_only_hands_on_torque() -> None:
    kb, kt = 1e-3, 8e-4
    inner: list[Stretch] = [straight(0.1, kb, kt), (0.03, lambda x: (14.0, 0.0, 0.0), lambda x: kb, lambda x: kt)]
    inner += [straight(0.02, kb, kt), (0.04, lambda x: (0.0, 16.0, 0.0), lambda x: kb, lambda x: kt)]
    outer: list[Stretch] = [straight(0.06, 2 * kb, 2 * kt)]
    outer += [(0.08, lambda x: (9.0, 0.0, 0.0), lambda x: 2 * kb, lambda x: 2 * kt)]
    tubes = [
        Tube.of_pieces(
            1e-3,
            0.7e-3,
            [Piece(0.03, 14.0), Piece(0.02, 0.0), Piece(0.04, (0.0, 16.0, 0.0))],
            straight_length=0.1,
            bending_stiffness=kb,
            torsional_stiffness=kt,
        ),
        Tube(1.5e-3, 1.2e-3, 0.06, 0.08, 9.0, bending_stiffness=2 * kb, torsional_stiffness=2 * kt),
    ]
    robot = ConcentricRobot(tuple(tubes))
    equilibrium = forward_kinematics(robot, [0.0, 2.5], [-0.04, -0.03], tolerance=1e-10)
    torque = equilibrium.torsion[:, 0] * np.array([kt, 2 * kt])
    shot = shoot([inner, outer], [0.0, 2.5], [-0.14, -0.09], torque.tolist())
    assert np.linalg.norm(equilibrium.tip_position - shot.tip) < 1e-10


def test_an_energy_map_knows_no_natural_twist() -> None:
    wound, plain = (energy_map(pair(twist, kappa=20.0), [0.0, 3.0], samples=7) for twist in (30.0, 0.0))
    assert wound.energy == pytest.approx(plain.energy, rel=1e-9)
    assert wound.first == pytest.approx(plain.first + 3.0, abs=1e-6)
