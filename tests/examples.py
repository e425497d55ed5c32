"""Robots, random robots and random configurations that several tests share."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from hypothesis import strategies as st

from tubeopt import ConcentricRobot, Material, Tube, load_robot
from tubeopt.block.transcription.reduced import Evaluation, ReducedProblem
from tubeopt.equilibrium.member import PlainPoint, Point, Unloaded
from tubeopt.robots.assembly import Assembly, assemble
from tubeopt.robots.eccentric import EccentricRobot
from tubeopt.solvers.newton import NewtonResult
from tubeopt.solvers.settings import NEWTON, Newton
from tubeopt.typing import Array

CONFIGS = Path(__file__).parents[1] / "configs" / "robots"

THESIS = load_robot(CONFIGS / "thesis_ctr.yaml")
CRL = load_robot(CONFIGS / "crl_ctr.yaml")
TWO_TUBE = load_robot(CONFIGS / "two_tube.yaml")
PIECES = load_robot(CONFIGS / "example_pieces.yaml")

MM, DEG = 1e-3, np.pi / 180

THESIS_TIPS = (
    # rotations (rad), tip (mm), margin: design numbers, by DOP853 shooting at home translations
    ((0.0, 0.0, 0.0), (0.0, -90.75837047, 164.83462233), 1.0),
    ((0.0, 1.0, 2.0), (72.83688204, -41.40882527, 169.68901052), 1.0),
    ((0.0, np.pi / 2, np.pi), (70.75080462, -4.22996685, 177.38526469), 0.92675),
)


def nested(*tubes: tuple[float, float, float], material: Material | None = None) -> ConcentricRobot:
    """A robot of tubes (straight length, curved length, curvature) that nest by construction."""
    alloy = material or Material("nitinol with nu = 0.28", 58e9, 58e9 / 2.56)
    walls = ((1.0 + 0.3 * i, 0.8 + 0.3 * i) for i in range(len(tubes)))
    return ConcentricRobot(
        tuple(Tube(od * MM, bore * MM, *tube, alloy) for (od, bore), tube in zip(walls, tubes, strict=True))
    )


def opposed(ratio: float = 1.0) -> ConcentricRobot:
    """Two tubes of equal length that pull with equal moments kb kappa, the outer one by `ratio` of it."""
    inner, outer = nested((0.0, 0.1, 14.0), (0.0, 0.1, 1.0)).tubes
    curvature = ratio * inner.curvature * inner.bending_stiffness / outer.bending_stiffness
    return ConcentricRobot(
        (inner, Tube(outer.outer_diameter, outer.inner_diameter, 0.0, 0.1, curvature, outer.material))
    )


def configurations(robot: ConcentricRobot, count: int, seed: int) -> Iterator[tuple[Array, Array]]:
    """Random rotations within half a turn and translations from wholly withdrawn to wholly advanced."""
    random = np.random.default_rng(seed)
    low, high = np.array(robot.limits.translations).T
    for _ in range(count):
        yield random.uniform(-np.pi, np.pi, robot.n_tubes), random.uniform(low, high)


def unstable_home(robot: ConcentricRobot, rotations: Array) -> PlainPoint:
    """The saddle that Newton finds from tubes without torsion, where symmetry holds them."""
    member = Unloaded.of(robot, rotations, (0.0,) * robot.n_tubes)
    result = member.solve(np.zeros(member.problem.size))
    assert result.converged
    return Point.of(member, result)


def newton(
    problem: ReducedProblem, rotations: Array, z: Array, iterations: int = NEWTON.iterations
) -> NewtonResult[Evaluation]:
    """By Newton's method from z (U,)."""
    return Unloaded(THESIS, problem, rotations, ()).solve(z, iterations)


def descend(
    problem: ReducedProblem, rotations: Array, z: Array, *, settings: Newton = NEWTON
) -> NewtonResult[Evaluation]:
    """By descent of the energy from z (U,)."""
    return Unloaded(THESIS, problem, rotations, ()).descend(z, settings)


def eccentric_assembly(offset: float = 1.92 * MM / np.sqrt(3)) -> Assembly:
    """The one-segment eccentric robot of the thesis' Table 3.1: three equal tubes around the centreline."""
    tube = Tube(1.92 * MM, 1.57 * MM, 0.0, 94.0 * MM, 1 / 0.12)
    angles = np.array([0.0, 120.0, -120.0]) * DEG
    return assemble([tube] * 3, np.zeros(3), offset=np.full(3, offset), offset_angle=angles)


def eccentric_robot(transmission: float = 0.0) -> EccentricRobot:
    """The same as a robot, with a straight part and a transmission of the given length each."""
    tube = Tube(1.92 * MM, 1.57 * MM, transmission, 94.0 * MM, 1 / 0.12)
    return EccentricRobot(tube, transmission_length=transmission)


def random_robot(random: np.random.Generator, n: int) -> ConcentricRobot:
    """n tubes of random walls, lengths, curvatures and alloys, none of them in a special position to another."""
    tubes: list[Tube] = []
    lengths = np.sort(random.uniform(0.02, 0.15, (2, n)))[:, ::-1]
    bore = 0.2 * MM
    for straight, curved in lengths.T:
        outer = bore + random.uniform(0.1, 0.3) * MM
        alloy = Material.from_poisson_ratio("alloy", random.uniform(40e9, 80e9), random.uniform(0.2, 0.4))
        tubes.append(Tube(outer, bore, straight, curved, random.uniform(-15, 15), alloy))
        bore = outer + random.uniform(0.02, 0.1) * MM
    return ConcentricRobot(tuple(tubes))


# --- random robots --------------------------------------------------------------------------------------------------

LENGTHS = st.just(0.0) | st.floats(1e-3, 0.1)


@st.composite
def materials(draw: st.DrawFn) -> Material:
    """Any isotropic alloy."""
    return Material.from_poisson_ratio("alloy", draw(st.floats(20e9, 120e9)), draw(st.floats(0.0, 0.45)))


@st.composite
def tube_stacks(draw: st.DrawFn, most: int = 5, curvature: float = 20.0) -> tuple[Tube, ...]:
    """One to `most` tubes that nest, no inner one shorter than an outer one, of any walls, lengths and materials."""
    n = draw(st.integers(1, most))
    tubes: list[Tube] = []
    bore, curved, straight = draw(st.floats(0.0, 0.5)) * MM, 0.0, 0.0
    profile = []
    for _ in range(n):
        more = draw(LENGTHS), draw(LENGTHS)
        straight, curved = straight + more[0], curved + more[1]
        profile.append((straight, curved))
    if straight + curved == 0 or profile[0] == (0.0, 0.0):
        profile = [(a, b + 0.02) for a, b in profile]
    for straight, curved in reversed(profile):
        outer = bore + draw(st.floats(0.05, 0.4)) * MM
        bend = draw(st.just(0.0) | st.floats(min(0.1, curvature), curvature)) * draw(st.sampled_from((1.0, -1.0)))
        tubes.append(Tube(outer, bore, straight, curved, bend, draw(materials())))
        bore = outer + draw(st.floats(0.0, 0.2)) * MM
    return tuple(tubes)


@st.composite
def robots(draw: st.DrawFn, most: int = 5, curvature: float = 20.0) -> ConcentricRobot:
    """Any concentric robot of one to `most` tubes."""
    return ConcentricRobot(draw(tube_stacks(most, curvature)))


@st.composite
def shifts(draw: st.DrawFn, tubes: tuple[Tube, ...], *, withdrawn: bool = True) -> Array:
    """Translations of each tube: home, advanced to the end, retracted behind the plate, or withdrawn past it."""
    out = []
    for tube in tubes:
        smallest = -1.2 * tube.curved_length if withdrawn else -0.9 * tube.curved_length
        positions = st.sampled_from([0.0, tube.straight_length, -tube.curved_length if withdrawn else 0.0])
        out.append(draw(positions | st.floats(smallest, tube.straight_length)))
    return np.array(out)


@st.composite
def poses(draw: st.DrawFn, most: int = 5, curvature: float = 20.0) -> tuple[ConcentricRobot, Array, Array]:
    """A robot with rotations and translations."""
    robot = draw(robots(most, curvature))
    rotations = np.array([draw(st.floats(-np.pi, np.pi)) for _ in robot.tubes])
    return robot, rotations, draw(shifts(robot.tubes))
