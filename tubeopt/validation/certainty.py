"""Bounds on the real robot with a probability, from the posterior of a calibrated one.

Parameters are x = start + F z with independent standard normal numbers z, cut at their bounds. At the same readings of
the drives each z is another robot at other joint values.

- The tip is linear in z to first order; its covariance is that of its exact derivatives, and of the misfit.
- A number Q that must not be small (a margin, a snap distance, a certificate) is bounded by the first-order reliability
  method (Hasofer and Lind, J. Eng. Mech. Div. 100 (1974); iterated as by Wu, Millwater and Cruse, AIAA J. 28 (1990)):
  of all z with |z| <= b the one with the least Q is solved for, and its Q is the bound, P = Phi(b). That is exact if Q
  is any falling function of one combination of the z, as steep as it may be, and an estimate otherwise. It is no proof.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Annotated, NamedTuple

import numpy as np
import scipy

from ..arguments import typed
from ..bodies.obstacles import Scene
from ..display import Displayed
from ..equilibrium.arm_surface import ArmSurface
from ..equilibrium.directions import PARAMETERS
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError, without_unit_warnings
from ..files.field_metadata import form, unit
from ..physics.shape import hat
from ..robots.assembly import DIMENSIONS, dimensions_of
from ..robots.calibration import Calibration, PathBounds, Posterior
from ..robots.robot import Robot
from ..stability import snap_distance
from ..stability.following import Path, follow
from ..typing import Array
from .effects import MOUNTS, Setup
from .parameters import Parameter, apply, choose_parameters
from .posterior import PLATE

PROBABILITIES = (0.95, 0.999)
"""Probabilities of the bounds."""

# Kinds that change no equilibrium without history.
WITHOUT_SHAPE = (*MOUNTS, "clearance", "translation_compliance")

# Kinds that change a tube otherwise than by its dimensions.
RESHAPED = ("dead_length", "fade", "piece_curvature", "learned_curvature")

# Kinds that do not scale a tube as a whole, if it has a learned change.
SCALED = ("curvature", "curved_length")

# Steps of differences, in standard deviations: of numbers of a robot, which are nearly linear, of equilibria, and of
# quantities with kinks.
SMALL, STEP, SECANT = 1e-3, 0.05, 0.5

# Largest change of a quantity in a step, of one that may become infinite.
BOUND = 1e3

# Largest step of a joint between configurations of a path at which real robots are solved, rad; 1 m counts as 20 rad.
# Near a snap a margin changes by 1 per rad. So steps are smaller where the margin of the calibrated robot is small, and
# so near to its least that another robot may have its least there.
ROW_STEP, FINE_STEP, NEAR_LEAST, SMALL_MARGIN = 0.05, 0.01, 0.15, 0.6

# Most of these configurations, of either step.
MOST_ROWS = 400

# Rays on which the least of a quantity is searched, and where on them, relative to the radius of a probability. The
# second starts from the slopes at the least on the first.
RAYS, PARTS_OF_RAY = 2, (0.25, 0.5, 0.75, 1.0)

# Steps of descent of the least margin of a path: a third of them reach the radius of a probability.
DESCENT = 18

# Steps of the search for the least margin; later ones change its third digit.
SEARCH = 4


class Real(NamedTuple):
    """A robot that the real one may be, at the readings of given joint values."""

    robot: Robot
    rotations: Array
    translations: Array


class Slopes(NamedTuple):
    """Derivatives of an equilibrium by the K independent numbers."""

    tip: Array
    """(3, K), m."""
    margin: Array
    """(K,)."""


@dataclass(frozen=True, eq=False)
class RealRobots:
    """Robots that the real one may be, of K independent standard normal numbers."""

    robot: Robot
    """The calibrated robot."""
    parameters: tuple[Parameter, ...]
    """Parameters (P,) that change its equilibria."""
    factor: Array
    """(P, K) deviations of the parameters by the independent numbers."""
    plate: Array
    """(6, K) turns (rad) and shifts (m) of the plate against its registration."""

    @cached_property
    def first(self) -> Setup:
        """The robot as calibrated."""
        return Setup.of(self.robot)

    @property
    def size(self) -> int:
        """Number K."""
        return int(self.factor.shape[1])

    def values(self, z: Array) -> Array:
        """(P,) values of the parameters."""
        start, low, high = np.array([(p.start, p.low, p.high) for p in self.parameters]).reshape(-1, 3).T
        return np.clip(start + self.factor @ z, low, high)

    def at(self, z: Array, rotations: Array, translations: Array) -> Real:
        """Robot of z (K,), at the readings of joint values (n,) of the calibrated one.

        Raises:
            InputError: there is no such robot.
        """
        return self._of(self.values(z), rotations, translations)

    @without_unit_warnings()
    def _of(self, values: Array, rotations: Array, translations: Array) -> Real:
        real = apply(self.first, self.parameters, values)
        return Real(real.robot(self.robot), *real.drives.to_model(*self.readings(rotations, translations)))

    def readings(self, rotations: Array, translations: Array) -> tuple[Array, Array]:
        """Readings (..., n) of the drives, rad and m, at joint values of the calibrated robot."""
        calibration = self.robot.calibration or Calibration.none(self.robot.n_tubes)
        return calibration.to_readings(rotations, translations)

    def slopes(self, e: Equilibrium, z: Array, joints: tuple[Array, Array]) -> Slopes:
        """Derivatives of the equilibrium of z; `joints` are joint values of the calibrated robot.

        Raises:
            InputError: friction acts on it.
            SolveError: the equilibrium is a fold.
        """
        values = self.values(z)
        # At coinciding breakpoints derivatives to either side differ: their mean is that of a change to both.
        sides = [e.jacobian(wrt=PARAMETERS, side=side) for side in (1, -1)]
        position = (sides[0].position + sides[1].position) / 2
        margin = (sides[0].margin + sides[1].margin) / 2
        tips, margins = np.zeros((3, len(values))), np.zeros(len(values))
        for k, p in enumerate(self.parameters):
            deviation = float(np.linalg.norm(self.factor[k])) or p.scale
            reshaped = p.kind in RESHAPED or (p.kind in SCALED and self.first.learned.any())
            differs = reshaped or not np.isfinite(margin).all()
            step = (STEP if differs else SMALL) * deviation
            sides_of_p = [np.clip(values[k] + side * step, p.low, p.high) for side in (1, -1)]
            reals = []
            for j, x in enumerate(sides_of_p):
                try:
                    reals.append(self._of(np.where(np.arange(len(values)) == k, x, values), *joints))
                except InputError:  # there is no such robot: the other side counts alone
                    sides_of_p[j] = values[k]
                    reals.append(self._of(values, *joints))
            width = (sides_of_p[0] - sides_of_p[1]) or np.inf
            if differs:
                ahead, behind = (_equilibrium(real, e) for real in reals)
                tips[:, k] = (ahead.tip_position - behind.tip_position) / width
                margins[k] = (ahead.margin - behind.margin) / width
            else:
                ahead_numbers, behind_numbers = (_numbers(real) for real in reals)
                change = (ahead_numbers - behind_numbers) / width
                tips[:, k], margins[k] = position @ change, margin @ change
        # In the frame of the registered plate the tip follows the true plate.
        follows = np.concatenate([-hat(e.tip_position), np.eye(3)], axis=1)
        return Slopes(tips @ self.factor + follows @ self.plate, margins @ self.factor)

    def least(self, quantity: Callable[[Array], float], probabilities: Sequence[float]) -> Array:
        """(len(probabilities),) bounds on a quantity of z (K,): the least on rays of steepest descent within |z| <= b.

        Where a robot does not exist, or has no such equilibrium, the quantity is 0.
        """

        def value(z: Array) -> float:
            try:
                return quantity(z)
            except (InputError, SolveError):
                return 0.0

        radii = scipy.special.ndtri(np.array(probabilities))
        at, worst = value(np.zeros(self.size)), np.zeros(self.size)
        least = np.full(len(radii), at)
        for _ in range(RAYS):
            # Infinite distances have no slope: the greatest loss is that of the robots that have none.
            changed = [value(worst + SECANT * row) for row in np.eye(self.size)]
            descent = np.array([0.0 if x == at else np.clip(at - x, -BOUND, BOUND) for x in changed])
            if not (size := float(np.linalg.norm(descent))):
                break
            # A robot may snap on the way and not at the end: a path then leads past the other side of a fold.
            steps = np.unique(np.outer(radii, PARTS_OF_RAY))
            found = np.array([value(step * descent / size) for step in steps])
            least = np.minimum(least, [found[steps <= radius].min() for radius in radii])
            k = int(found.argmin())
            at, worst = found[k], steps[k] * descent / size
            if at <= 0:
                break
        return least


@lru_cache(maxsize=32)
def real_robots(robot: Robot) -> RealRobots | None:
    """Robots that the real one may be; None without a posterior.

    Raises:
        InputError: the posterior names unknown parameters.
    """
    if robot.posterior is None:
        return None
    posterior = robot.posterior
    named = [name for name in posterior.names if name not in PLATE]
    known = {p.name: p for p in choose_parameters(robot, (), named, "none")} if named else {}
    own = tuple(p for p in known.values() if not (p.effect.history or p.kind in WITHOUT_SHAPE or p.idle))
    place, rows = posterior.names.index, posterior.factor
    factor = rows[[place(p.name) for p in own]]
    plate = np.array([rows[place(name)] if name in posterior.names else np.zeros(len(rows)) for name in PLATE])
    # As few independent numbers as there are parameters of these.
    left, singular, _ = np.linalg.svd(np.concatenate([factor, plate]), full_matrices=False)
    both = (left * singular)[:, singular > 0]
    return RealRobots(robot, own, both[: len(own)], both[len(own) :])


def _numbers(real: Real) -> Array:
    """Joint values and dimensions of all tubes, in the order of `PARAMETERS`."""
    dimensions = dimensions_of(real.robot.tubes)
    return np.concatenate([real.rotations, real.translations, *(dimensions[name] for name in DIMENSIONS)])


def _equilibrium(real: Real, near: Equilibrium) -> Equilibrium:
    """Equilibrium of a robot on the branch of another one."""
    return forward_kinematics(*real, load=near.load, start=near)


@dataclass(frozen=True, eq=False)
class Uncertainty(Displayed):
    """Bounds on the real robot at one configuration, estimated to first order, not proved."""

    probabilities: tuple[float, ...]
    """Probabilities (Q,) of the bounds."""
    tip_covariance: Array
    """(3, 3) covariance of the tip about that of the calibrated robot, m^2, in the frame of the registered plate:
    parameters, plate and misfit, without noise."""
    tip_half_widths: Annotated[Array, unit("mm"), form(".2f"), "the tip is within this along x, y and z"]
    """(Q, 3), m; for each axis on its own."""
    tip_radius: Annotated[Array, unit("mm"), form(".2f"), "the tip is within this distance"]
    """(Q,), m."""
    margin: Annotated[Array, "the margin is at least this"]
    """(Q,) margins, without friction; 0 where the robot may snap."""
    snap_distance: Annotated[Array, unit("deg"), form(".1f"), "no turn of all tubes up to this snaps"]
    """(Q,), rad; infinite where it is certified."""
    outside: bool = False
    """True if a reading is outside of the ranges that the robot was calibrated in."""


@typed
def uncertainty(equilibrium: Equilibrium, probabilities: Sequence[float] = PROBABILITIES) -> Uncertainty:
    """Bounds on tip, margin and snap distance of the real robot at the readings of a stable equilibrium.

    Raises:
        InputError: the robot has no posterior, the equilibrium is unstable or has friction, or a probability is not
            between 0.5 and 1.
    """
    e, reals = equilibrium, real_robots(equilibrium.robot)
    check_probabilities(probabilities)
    if reals is None or e.robot.posterior is None:
        raise InputError("the robot has no posterior; `tubeopt validate --fit` writes one into the robot file")
    if not e.stable:
        raise InputError("the equilibrium is unstable; the real robot will not be there")
    joints, still = (e.rotations, e.translations), np.zeros(reals.size)
    slopes = reals.slopes(e, still, joints)
    covariance = _covariance(slopes, e.robot.posterior)
    quantiles = scipy.special.ndtri((1 + np.array(probabilities)) / 2)
    distances = np.full(len(probabilities), np.nan)
    if e.load is None:
        distances = reals.least(lambda z: _snap_distance(reals.at(z, *joints)), probabilities)
    return Uncertainty(
        tuple(probabilities),
        covariance,
        quantiles[:, None] * np.sqrt(np.diag(covariance)),
        _radii(covariance, probabilities),
        _least_margins(reals, e, slopes.margin, joints, probabilities),
        distances,
        bool(e.robot.posterior.outside(*reals.readings(*joints))),
    )


def _covariance(slopes: Slopes, posterior: Posterior) -> Array:
    """(3, 3) covariance of the tip, m^2."""
    return np.asarray(slopes.tip @ slopes.tip.T + posterior.misfit**2 * np.eye(3))


def _radii(covariance: Array, probabilities: Sequence[float]) -> Array:
    """(Q,) radii of balls, m, that hold a point of covariance (3, 3) with probabilities."""
    # The ball with the longest axis as radius holds at least as much as the ellipsoid.
    longest = np.sqrt(np.linalg.eigvalsh(covariance)[-1])
    return np.asarray(longest * np.sqrt(scipy.special.chdtri(3, 1 - np.array(probabilities))))


def tip_radii(equilibrium: Equilibrium, probabilities: Sequence[float] = PROBABILITIES) -> Array | None:
    """(Q,) distances, m, within which the tip of the real robot is at the readings of a stable equilibrium.

    None without a posterior.
    """
    e, reals = equilibrium, real_robots(equilibrium.robot)
    check_probabilities(probabilities)
    if reals is None or e.robot.posterior is None:
        return None
    slopes = reals.slopes(e, np.zeros(reals.size), (e.rotations, e.translations))
    return _radii(_covariance(slopes, e.robot.posterior), probabilities)


@dataclass(frozen=True)
class ExpectedError:
    """Root mean square distance of measured from predicted tips that is expected on new paths, m."""

    rms: float
    """Expected value."""
    low: float
    """Lower end of the interval of 95 %, by how far the parameters of one fit may be off."""
    high: float
    """Upper end of the interval."""


# Configurations of new paths at which real robots are solved.
NEW_ROWS = 24


def expected_error(robot: Robot, rotations: Array, translations: Array) -> ExpectedError | None:
    """Error expected on new paths in the session of a calibration, in the ranges of readings (N, n) of its recordings.

    Every rotation and the translations of one row are drawn independently, as paths of other phases combine them. What
    depends on history counts as misfit. None without a posterior, or without an equilibrium there.
    """
    reals, posterior = real_robots(robot), robot.posterior
    if reals is None or posterior is None:
        return None
    random, calibration = np.random.default_rng(0), robot.calibration or Calibration.none(robot.n_tubes)
    mixed = np.column_stack([random.permutation(column) for column in rotations.T])
    slopes = []
    for alpha, shift in list(zip(mixed, random.permutation(translations), strict=True))[:NEW_ROWS]:
        joints = calibration.to_model(alpha, shift)
        try:
            slopes.append(reals.slopes(forward_kinematics(robot, *joints), np.zeros(reals.size), joints).tip)
        except (InputError, SolveError):  # the robot cannot be there
            continue
    if not slopes:
        return None
    # The mean square is a sum of squares of independent normal numbers: nearly a gamma variable with its moments.
    parts = np.maximum(np.linalg.eigvalsh(np.einsum("vak,vaj->kj", slopes, slopes) / len(slopes)), 0.0)
    mean, variance, rest = parts.sum(), 2 * (parts**2).sum(), 3 * (posterior.misfit**2 + posterior.noise**2)
    shape = mean**2 / max(variance, 1e-300)
    low, high = scipy.special.gammaincinv(shape, [0.025, 0.975]) * mean / shape if shape > 0 else (0.0, 0.0)
    return ExpectedError(*(float(np.sqrt(square + rest)) for square in (mean, low, high)))


def check_probabilities(probabilities: Sequence[float]) -> None:
    """Raise InputError for a probability that is not between 0.5 and 1."""
    for p in probabilities:
        if not 0.5 < p < 1:
            raise InputError(f"a probability is {p:g}; it must lie between 0.5 and 1")


def _snap_distance(real: Real) -> float:
    e = forward_kinematics(*real)
    return snap_distance(e).turn if e.stable else 0.0


def _least_margins(
    reals: RealRobots, e: Equilibrium, slope: Array, joints: tuple[Array, Array], probabilities: Sequence[float]
) -> Array:
    """Bounds on the margin, on the branch of the equilibrium; 0 where the branch ends."""
    least, out = e.margin, []
    for p in sorted(probabilities):
        towards, at = np.zeros(reals.size), slope
        for _ in range(SEARCH):
            # Mean directions do not swing between two sides of a bend.
            towards = towards - at / (np.linalg.norm(at) or 1.0)
            z = scipy.special.ndtri(p) * towards / (np.linalg.norm(towards) or 1.0)
            try:
                near = _equilibrium(reals.at(z, *joints), e)
                least = min(least, max(near.margin, 0.0))
                if not near.stable:
                    break
                at = reals.slopes(near, z, joints).margin
            except (InputError, SolveError):
                least = 0.0
        out.append(least)
    return np.array(out)[np.argsort(np.argsort(probabilities))]


def certificate_bounds(
    robot: Robot,
    certificate: Callable[[Robot, Array], float],
    translations: Array,
    probabilities: Sequence[float] = PROBABILITIES,
) -> Array | None:
    """(Q,) bounds at probabilities on a certificate of the real robot at translations (n,), m.

    None without a posterior.
    """
    reals = real_robots(robot)
    if reals is None:
        return None

    def value(z: Array) -> float:
        real = reals.at(z, np.zeros(robot.n_tubes), translations)
        return certificate(real.robot, real.translations)

    return reals.least(value, probabilities)


@dataclass(frozen=True, eq=False)
class _RealPath:
    """Path of real robots at the readings of joint values (T, n) of the calibrated one."""

    first: Equilibrium
    """Equilibrium of the calibrated robot at the first row."""
    reals: RealRobots
    rotations: Array
    translations: Array

    def followed(self, z: Array) -> Path:
        """Motion of the robot of z, on the branch of the first equilibrium."""
        real, load = self.reals.at(z, self.rotations, self.translations), self.first.load
        start = forward_kinematics(real.robot, real.rotations[0], real.translations[0], load=load, start=self.first)
        return follow(real.robot, real.rotations, real.translations, load=load, start=start)

    def least_margin(self, radius: float, rows: Sequence[int]) -> float:
        """Least margin met by steps of descent within |z| <= radius, of the least margin of some rows; 0 for a snap."""
        z, least = np.zeros(self.reals.size), np.inf
        for _ in range(DESCENT):
            try:
                way = self.followed(z)
                if way.snaps:
                    return 0.0
                least = min(least, *(near.margin for near in way.equilibria))
                # At the least of a path the margin does not change along it, so only the robot's change counts.
                k = min(rows, key=lambda row: way.equilibria[row].margin)
                joints = self.rotations[k], self.translations[k]
                slope = self.reals.slopes(way.equilibria[k], z, joints).margin
            except (InputError, SolveError):
                return 0.0
            if not slope.any() or least <= 0:
                break
            z = z - 3 * radius / DESCENT * slope / float(np.linalg.norm(slope))
            z = z * min(1.0, radius / float(np.linalg.norm(z)))
        return max(least, 0.0)

    def clearance(self, z: Array, scene: Scene, rows: Sequence[int]) -> float:
        """Smallest distance of the robot of z from bodies at some rows, m; 0 if it snaps."""
        way = self.followed(z)
        if way.snaps:
            return 0.0
        turn, shift = np.split(self.reals.plate @ z, 2)
        matrix = scipy.spatial.transform.Rotation.from_rotvec(turn).as_matrix()
        distances = []
        for near in (way.equilibria[k] for k in rows):
            arm = replace(near.arm, position=near.position @ matrix.T + shift, frame=matrix @ near.frame)
            distances.append(ArmSurface(replace(near, arm=arm)).clearance(scene))
        return min(distances)


def path_bounds(
    first: Equilibrium,
    rotations: Array,
    translations: Array,
    scene: Scene | None = None,
    probabilities: Sequence[float] = PROBABILITIES,
) -> PathBounds | None:
    """Bounds on margin and clearance of the real robot along joint values (T, n) of the calibrated one.

    Joints move linearly from row to row. Each real robot starts on the branch of the `first` equilibrium, and follows
    the path at the readings of the drives. Where it snaps, margin and clearance are 0. Bodies are in the frame of the
    registered plate. None without a posterior.

    Raises:
        InputError: a probability is not between 0.5 and 1.
    """
    reals, n = real_robots(first.robot), first.robot.n_tubes
    check_probabilities(probabilities)
    if reals is None or first.robot.posterior is None:
        return None
    joints = np.hstack([rotations, translations])
    moved = np.abs(np.diff(joints * np.repeat([1.0, 20.0], n), axis=0)).max(1)
    travelled = np.append(0.0, np.cumsum(moved))

    def path_at(at: Array) -> _RealPath:
        table = np.column_stack([np.interp(at, travelled, column) for column in joints.T])
        return _RealPath(first, reals, table[:, :n], table[:, n:])

    coarse, fine = (
        np.linspace(0, travelled[-1], 1 + min(int(np.ceil(travelled[-1] / step)), MOST_ROWS))
        for step in (ROW_STEP, FINE_STEP)
    )
    margins = np.array([near.margin for near in path_at(coarse).followed(np.zeros(reals.size)).equilibria])
    limit = min(margins.min() + NEAR_LEAST, SMALL_MARGIN)
    at = np.union1d(coarse, fine[np.interp(fine, coarse, margins) < limit])
    path, small = path_at(at), np.interp(at, coarse, margins) < limit
    # Each part of the path with a small margin has a least of its own.
    parts = [part.tolist() for part in np.split(np.arange(len(at)), np.flatnonzero(np.diff(small)) + 1)]
    parts = [part for part in parts if small[part[0]]] or [list(range(len(at)))]
    radii = scipy.special.ndtri(probabilities)
    least = tuple(min(path.least_margin(float(radius), part) for part in parts) for radius in radii)
    clearances = np.full(len(least), np.inf)
    if scene is not None and scene.bodies:
        rows = np.flatnonzero(np.isin(at, coarse)).tolist()
        distances = reals.least(lambda z: path.clearance(z, scene, rows), probabilities)
        clearances = distances - radii * first.robot.posterior.misfit
    return PathBounds(tuple(probabilities), least, tuple(clearances.tolist()))
