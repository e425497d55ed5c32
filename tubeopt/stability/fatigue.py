"""Strain cycles of the tubes along a repeated motion, and their life by published tests or a given curve."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..arguments import typed
from ..bodies.obstacles import Obstacle
from ..display import Displayed
from ..equilibrium.arm_sections import ArmSections
from ..equilibrium.result import Equilibrium
from ..errors import InputError, vector
from ..files.field_metadata import form, key, unit
from ..physics.strain import fibre_strain
from ..robots.assembly import Assembly
from ..robots.concentric import Friction
from ..robots.load import Load
from ..robots.robot import Robot
from ..robots.tubes import Tube
from ..solvers.blas import small
from ..solvers.time_limit import LONG_TIME_LIMIT, check_time, limited
from ..typing import Array, StatusEnum
from .following import checked_waypoints, follow, stretches
from .rainflow import Cycles, rainflow

PLACES = 160
"""Places along a tube at which strains are computed, in the middle of equal parts."""

FIBRES = 24
"""Fibres around a tube."""

DIRECTIONS = 16
"""Directions in the plane of strain and scaled shear in which ranges are compared. The error of a range is 0.5 %."""

CLOSED = 1e-9
"""Largest difference of joint values (rad, m) at the ends of a closed motion."""

# H. Cao et al., The influence of mean strain on the high-cycle fatigue of Nitinol with application to medical devices
# (2020), doi:10.34657/3724: bending tests at 37 degC to 4e8 cycles; 90 % of parts survive, with 95 % confidence.
ANY_MEAN, LARGEST_MEAN = 0.0016, 0.07
"""Strain amplitude that lasts 4e8 cycles, at mean strains up to the second number."""

# A. R. Pelton et al., Journal of the Mechanical Behavior of Biomedical Materials 1 (2008) 153,
# doi:10.1016/j.jmbbm.2007.08.001, and the tests listed in Shape Memory and Superelasticity 4 (2018),
# doi:10.1007/s40830-018-0153-4: limits of specimens cut from tubes at 1e7 cycles.
LIMITS, SMALL_MEAN = (0.004, 0.008), 0.015
"""Smallest and largest published strain amplitude that lasts 1e7 cycles, and a bound on the mean strain.

The bound is an assumption: the sources, as far as they could be read, do not state one.
"""


class Endurance(StatusEnum):
    """Life of a tube of superelastic nitinol by published tests, as a sentence."""

    ENDLESS = "below all published limits: lasts 400 million cycles, at any mean strain up to 7 %"
    LONG = "below the published limits of 10 million cycles; the mean strain is below an assumed 1.5 %"
    SCATTERED = "in the scatter of the published limits of 10 million cycles: some tubes break before"
    SHORT = "above the published limits of 10 million cycles: tubes break before"
    UNKNOWN = "unknown: the published limits are those of nitinol, and the tube is of another material"


@dataclass(frozen=True, eq=False)
class StrainLife(Displayed):
    """Curve of strain amplitude over cycles to failure, of K points.

    Raises:
        InputError: fewer than two points, numbers that are not positive, or lives that do not fall with the amplitude.
    """

    amplitude: Array
    """(K,) increasing strain amplitudes."""
    cycles: Array
    """(K,) median cycles to failure."""
    low: Array | None = None
    """(K,) lower end of the scatter, cycles; None if unknown."""
    high: Array | None = None
    """(K,) upper end of the scatter, cycles; None if unknown."""

    def __post_init__(self) -> None:
        size = len(np.atleast_1d(self.amplitude))
        if size < 2:
            raise InputError(f"the strain-life curve has {size} points; it must have at least 2")
        for name in ("amplitude", "cycles", "low", "high"):
            if getattr(self, name) is None:
                continue
            values = vector(f"{name} of the strain-life curve", getattr(self, name), size, "one per point")
            if (values <= 0).any():
                raise InputError(f"{name} of the strain-life curve has {values.min():g}; it must be greater than 0")
            step, falls = np.diff(values), name != "amplitude"
            if (step <= 0).any() if not falls else (step > 0).any():
                order = "lives must not rise with the amplitude" if falls else "amplitudes must increase"
                raise InputError(f"{name} of the strain-life curve is {values.tolist()}; {order}")
            object.__setattr__(self, name, values)

    def life(self, cycles: Cycles, of: str = "cycles") -> float:
        """Repetitions to failure of a history by the linear rule of Palmgren and Miner; NaN beyond the curve.

        Between points both logarithms are linear. Amplitudes below the curve count as its smallest.
        """
        lives, amplitude = getattr(self, of), cycles.amplitude
        if lives is None or (amplitude > self.amplitude[-1]).any():
            return math.nan
        if not len(amplitude):
            return math.inf
        at = np.interp(np.log(np.maximum(amplitude, 1e-300)), np.log(self.amplitude), np.log(lives))
        return float(1 / np.exp(-at).sum())


@dataclass(frozen=True, eq=False)
class TubeFatigue(Displayed):
    """Strain of one tube along a repeated motion, at the place and fibre with the largest range."""

    _brief = ("amplitude", "mean", "place", "endurance")

    amplitude: Annotated[float, unit("percent"), form(".3f"), "largest amplitude of the von Mises strain"]
    mean: Annotated[float, unit("percent"), form(".3f"), "mean strain of that cycle"]
    largest: Annotated[float, unit("percent"), form(".3f"), "largest strain, from the free shape"]
    """Largest von Mises strain anywhere in the tube."""
    place: Annotated[float, unit("mm"), form(".1f"), "distance of the place from the clamped end"]
    """m."""
    fibre: Annotated[float, unit("deg"), form(".0f"), "angle of the fibre from the x axis of the tube"]
    """rad."""
    waypoint: Array
    """(T,) numbers of the waypoints of the repetition, from 1; a snap has two rows."""
    history: Array
    """(T,) strain over one repetition, along the direction of the largest range."""
    cycles: Cycles
    """Cycles of one repetition by rainflow counting."""
    endurance: Annotated[Endurance, "life by published tests of nitinol, as a sentence"]
    life: Annotated[float, key("life"), form(".3g"), "median repetitions to failure by the given curve"]
    """NaN without a curve, and beyond it."""
    life_range: tuple[float, float]
    """Scatter of the life by the given curve; NaN if unknown."""


@dataclass(frozen=True)
class FatigueStatistics:
    """Numbers of equilibria."""

    equilibria: int
    """Number of equilibria in one repetition."""
    snaps: int
    """Number of snaps in one repetition."""


@dataclass(frozen=True, eq=False)
class Fatigue(Displayed):
    """Strain cycles of all tubes along a repeated motion."""

    _brief = ("tubes",)

    robot: Robot
    """Robot that moves."""
    tubes: tuple[TubeFatigue, ...]
    """Strains of the n tubes, inner to outer."""
    returned: bool
    """True if the motion does not end where it begins, and is repeated forth and back."""
    statistics: FatigueStatistics
    """Numbers of equilibria and snaps."""

    @property
    def value(self) -> Array:
        """(n,) largest strain amplitudes."""
        return np.array([tube.amplitude for tube in self.tubes])

    @property
    def status(self) -> Endurance:
        """Life of the tube with the largest amplitude, as a sentence."""
        return max(self.tubes, key=lambda tube: tube.amplitude).endurance


@typed
@small
@limited
def fatigue(  # noqa: PLR0913
    robot: Robot,
    rotations: ArrayLike,
    translations: ArrayLike | None = None,
    *,
    start: Equilibrium | None = None,
    load: Load | None = None,
    friction: Friction | None = None,
    walls: Sequence[Obstacle] = (),
    curve: StrainLife | None = None,
    time_limit: float = LONG_TIME_LIMIT,
) -> Fatigue:
    """Strain cycles of the tubes along a repeated motion, by rainflow counting, and their life.

    A motion that does not end where it begins is repeated forth and back. The second repetition counts, since friction
    and snaps make the first one differ. Strains are those of bending and torsion at the surface, from the free shape of
    each tube, also behind the plate. Superelastic tubes are linear here. Stress concentrations are not included.

    Args:
        rotations, translations: (T, n) rad and m, at least two rows; translations default to home.
        start, load, friction, walls: as of `follow`.
        curve: strain-life curve of the tubes' material, for their life; None for the published limits of nitinol alone.
        time_limit: maximum run time, s.

    Raises:
        InputError: as `follow`; eccentric robots; slotted tubes; a single waypoint.
        SolveError: as `follow`.
        TimeLimitError: (a SolveError) the time limit was reached before there was an answer.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("two_tube")
        >>> result = tubeopt.fatigue(robot, [[0, 0], [1.5, 0], [3, 0]])
        >>> len(result.tubes), result.returned
        (2, True)
    """
    alpha, shift = checked_waypoints(robot, rotations, translations)
    if len(alpha) < 2:
        raise InputError("the motion has 1 waypoint; a repeated motion must have at least 2")
    if not robot.fixed_sections or robot.assembly(shift[0]).eccentric:
        raise InputError("the robot has tubes off the centreline; fatigue needs concentric tubes")
    for i, tube in enumerate(robot.tubes, start=1):
        if any(piece.slots is not None for piece in tube.pieces):
            raise InputError(f"tube {i} has slots, which concentrate strains; fatigue needs tubes without slots")
    closed = max(np.abs(alpha[0] - alpha[-1]).max(), np.abs(shift[0] - shift[-1]).max()) < CLOSED
    lap = np.concatenate([alpha, shift], axis=1)
    lap = lap[:-1] if closed else np.concatenate([lap, lap[-2:0:-1]])
    both = np.concatenate([lap, lap, lap[:1]])
    path = follow(robot, *np.split(both, 2, axis=1), start=start, load=load, friction=friction, walls=walls)
    second = [
        (at, state)
        for part in stretches(path, np.arange(float(len(both))))
        for at, state in zip(part.at.tolist(), part.equilibria, strict=True)
        if at >= len(lap)
    ]
    states, numbers = [state for _, state in second], np.array([at for at, _ in second]) - len(lap) + 1
    return Fatigue(
        robot=robot,
        tubes=tuple(_of_tube(states, i, numbers, curve) for i in range(robot.n_tubes)),
        returned=not closed,
        statistics=FatigueStatistics(len(states), sum(snap.index >= len(lap) for snap in path.snaps)),
    )


def _of_tube(states: Sequence[Equilibrium], i: int, at: Array, curve: StrainLife | None) -> TubeFatigue:
    """Strain cycles of tube i, at equilibria with the numbers `at` (T,)."""
    tube = states[0].robot.tubes[i]
    place = (np.arange(PLACES) + 0.5) / PLACES * tube.length
    angle = 2 * np.pi * np.arange(FIBRES) / FIBRES
    # Strains along the fibres (T, P, F), and shear (T, P) by the scale of von Mises: |(strain, shear)| is his strain.
    strain, shear = np.empty((len(states), PLACES, FIBRES)), np.empty((len(states), PLACES))
    for k, state in enumerate(states):
        check_time()
        strain[k], shear[k] = _strains(state, i, place, angle)
    shear *= math.sqrt(3) * tube.material.shear_modulus / tube.material.youngs_modulus
    best, chosen = -1.0, (0, 0)
    for turn in np.pi * np.arange(DIRECTIONS) / DIRECTIONS:
        along = np.cos(turn) * strain + np.sin(turn) * shear[..., None]
        ranges = np.ptp(along, axis=0)
        if ranges.max() > best:
            best, chosen = float(ranges.max()), divmod(int(ranges.argmax()), FIBRES)
            first, last = (int(of(along[:, *chosen])) for of in (np.argmin, np.argmax))
    p, f = chosen
    # The direction of the largest range itself, between its two states.
    across = np.array([strain[last, p, f] - strain[first, p, f], shear[last, p] - shear[first, p]])
    size = float(np.linalg.norm(across))
    direction = across / size if size > 0 else np.array([1.0, 0.0])
    if direction[0] < 0:
        direction = -direction
    history = direction[0] * strain[:, p, f] + direction[1] * shear[:, p]
    cycles = rainflow(history)
    amplitude = float(cycles.amplitude[0]) if len(cycles.amplitude) else 0.0
    mean = float(cycles.mean[0]) if len(cycles.mean) else float(history[0])
    return TubeFatigue(
        amplitude=amplitude,
        mean=mean,
        largest=float(np.sqrt(strain**2 + shear[..., None] ** 2).max()),
        place=float(place[p]),
        fibre=float(angle[f]),
        waypoint=at,
        history=history,
        cycles=cycles,
        endurance=_endurance(tube, amplitude, mean),
        life=math.nan if curve is None else curve.life(cycles),
        life_range=(math.nan, math.nan) if curve is None else (curve.life(cycles, "low"), curve.life(cycles, "high")),
    )


def _strains(e: Equilibrium, i: int, place: Array, angle: Array) -> tuple[Array, Array]:
    """Strains (P, F) along fibres at angles (F,) and shears (P,) of tube i, at distances (P,) from its clamped end."""
    assembly, tube = e.robot.assembly(e.translations), e.robot.tubes[i]
    behind = float(assembly.transmission[i])
    natural, twist, stiffness = _own_shape(assembly, tube, i, place)
    arm = ArmSections(e, assembly)
    curvature, rate = np.zeros(len(place), dtype=complex), arm.plate_torque[i] / stiffness + twist
    front = place > behind
    if front.any() and len(arm.middle):
        at = arm.at(place[front] - behind)
        # In the axes of the tube, which turn by theta.
        curvature[front], rate[front] = at.curvature * np.exp(-1j * at.rotation[:, i]), at.torsion[:, i]
    radius = tube.outer_diameter / 2
    fibre = radius * np.cos(angle), radius * np.sin(angle)
    bent, own = ((u.real[:, None], u.imag[:, None]) for u in (curvature, natural))
    return np.asarray(fibre_strain(fibre, bent, own)), radius * (rate - twist)


class _OwnShape(NamedTuple):
    """Tube without stress at P places along it."""

    curvature: Array
    """Precurvature x + j y, 1/m."""
    twist: Array
    """Natural twist, 1/m."""
    stiffness: Array
    """Torsional stiffness, N m^2."""


def _own_shape(assembly: Assembly, tube: Tube, i: int, place: Array) -> _OwnShape:
    """Shape and stiffness of a tube without stress at places (P,)."""
    if assembly.even:
        natural = np.where(place > tube.straight_length, float(assembly.curvature[i]), 0.0).astype(complex)
        even = np.full(len(place), float(assembly.torsional_stiffness[i]))
        return _OwnShape(natural, np.zeros(len(place)), even)
    assert assembly.lengthwise is not None
    _, kt, x, y, z, _ = assembly.lengthwise.values(np.tile(place[:, None], (1, assembly.n_tubes)))[:, :, i]
    return _OwnShape(x + 1j * y, z, kt)


def _endurance(tube: Tube, amplitude: float, mean: float) -> Endurance:
    """Life of a tube by published tests."""
    name = tube.material.name.lower()
    if "nitinol" not in name and "niti" not in name:
        return Endurance.UNKNOWN
    if amplitude <= ANY_MEAN and abs(mean) <= LARGEST_MEAN:
        return Endurance.ENDLESS
    if amplitude <= LIMITS[0] and abs(mean) <= SMALL_MEAN:
        return Endurance.LONG
    return Endurance.SCATTERED if amplitude <= LIMITS[1] else Endurance.SHORT
