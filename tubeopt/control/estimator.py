"""Shape, tip force and joint offsets of a robot from its sensors, by a square-root Kalman filter (Potter 1963).

The state x is a vector of first-order Gauss-Markov processes: each has a standard deviation sigma without measurements
and a correlation time tau. With P = S S' the filter predicts over a time dt with phi = exp(-dt / tau). It updates by
one scalar measurement y = h'x + v after the other, var v = 1:

    x <- phi x,      S S' <- phi S S' phi + (1 - phi^2) sigma^2
    f = S'h,   a = 1 / (f'f + 1),   x <- x + a S f (y - h'x),   S <- S - a / (1 + sqrt(a)) S f f'

The equilibrium at the estimate gives the expected measurements, the implicit function theorem their derivatives h. Each
update linearises anew a few times about what it has found (Bell and Cathey, IEEE TAC 38 (1993)). A measurement that
arrives late is filtered at its own time. Later ones are filtered again with the derivatives that they had.
"""

from __future__ import annotations

import reprlib
from bisect import bisect_right
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..arguments import typed
from ..display import Displayed
from ..equilibrium.kinematics import forward_kinematics, one_step
from ..equilibrium.linearised import Linearised, base_wrench_change, curvature_in_tube, linearise, tip_forces
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError, finite, positive, vector, without_unit_warnings
from ..files.field_metadata import form, unit
from ..robots.concentric import ConcentricRobot
from ..robots.load import Load
from ..robots.order import last_tube
from ..solvers.blas import small
from ..solvers.settings import Newton
from ..typing import Array

# Duration of stored joint values and measurements, s: the largest delay. Trackers are late by 10 to 100 ms.
MEMORY = 1.0

# Standard deviations per number beyond which a reading is left out: three normal numbers are as far off once in 1e15
# times.
GATE = 5.0

# Linearisations per update at most, and the change of the state, in its standard deviations, below which there is no
# further one: what a linearisation leaves is then far below the noise.
LINEARISATIONS, SETTLED = 4, 0.1

# Ratio of the standard deviations after and before all measurements above which something counts as not observed.
HIDDEN = 0.5

# Margins close to 1 need meshes of up to a second per solve for their last digits, which the filter does not use.
METHOD = Newton(margin_tolerance=1e-3)

# Readings left out in a row after which the model no longer is that of the robot.
LOST = 10


@dataclass(frozen=True)
class EstimatorOptions:
    """Standard deviations before any measurement (quantities with 0 are not estimated), and correlation times."""

    force: float = 0.05
    """Standard deviation of the tip force per axis, N."""
    rotation: float = np.radians(1.0)
    """Standard deviation of the rotation offsets, rad."""
    translation: float = 5e-4
    """Standard deviation of the translation offsets, m."""
    stiffness: float = 0.0
    """Relative standard deviation of every tube's stiffness."""
    tip_offset: float = 0.0
    """Standard deviation of the offset of measured tips per axis, m."""
    force_time: float = 1.0
    """Correlation time of the force, s."""
    drift_time: float = 5000.0
    """Correlation time of everything else, s."""
    known: Load | None = None
    """Other loads, such as the weight; the estimated force is added to its tip force."""

    def __post_init__(self) -> None:
        for name in ("force", "rotation", "translation", "stiffness", "tip_offset"):
            if finite(name, getattr(self, name)) < 0:
                raise InputError(f"{name} is {getattr(self, name):g}; it must be at least 0")
        positive("force_time", self.force_time)
        positive("drift_time", self.drift_time)
        if self.known is not None and not isinstance(self.known, Load):
            raise InputError(f"known is {reprlib.repr(self.known)}; it must be a Load")
        if self.known is not None and self.known.frame != "world":
            raise InputError("known has a force that turns with the tip; its frame must be 'world'")


# --- Sensors ----------------------------------------------------------------------------------------------------------


class Rows(NamedTuple):
    """Difference between a reading and its prediction by the model."""

    innovation: Array
    """(R,) measured less expected numbers."""
    slopes: Array
    """(R, K) derivatives of the expected numbers by the state."""
    noise: Array
    """(R,) standard deviations."""


@dataclass(frozen=True, eq=False)
class TipReading:
    """Pose of the tip from a tracker, in the plate frame: position, and if measured direction or rotation."""

    position: ArrayLike
    """Measured position (3,) of the tip, m."""
    noise: float = 3e-4
    """Standard deviation of the position per axis, m."""
    direction: ArrayLike | None = None
    """(3,) direction of the arm at the tip, of any length."""
    rotation: ArrayLike | None = None
    """(3, 3) axes of the tube that reaches farthest, at its tip, by column."""
    angle_noise: float = np.radians(0.5)
    """Standard deviation of directions and rotations per axis, rad."""

    def rows(self, of: Model) -> Rows:
        """Difference between the reading and its prediction by a model."""
        arm, frame = of.equilibrium, of.equilibrium.tip_rotation
        innovations = [vector("position", self.position, 3, "x, y, z in m") - arm.tip_position - of.tip_offset]
        slopes, noise = [of.change.tip_position + of.offset_slopes], [positive("noise", self.noise)] * 3
        axis, rotation_slopes = frame[:, 2], of.change.tip_rotation
        if self.direction is not None:
            measured, across = vector("direction", self.direction, 3), frame[:, :2].T
            innovations.append(across @ measured / max(float(np.linalg.norm(measured)), 1e-300))
            # The axis e turns by psi x e.
            slopes.append(across @ np.cross(rotation_slopes, axis, axis=0))
        if self.rotation is not None:
            tube = int(last_tube(arm.tube_end))
            tube_frame = (
                frame @ scipy.spatial.transform.Rotation.from_rotvec([0, 0, arm.rotation[tube, -1]]).as_matrix()
            )
            measured = vector("rotation", np.ravel(self.rotation), 9).reshape(3, 3)
            innovations.append(scipy.spatial.transform.Rotation.from_matrix(measured @ tube_frame.T).as_rotvec())
            slopes.append(rotation_slopes + np.outer(axis, of.change.tip_rotations[tube]))
        noise += [positive("angle_noise", self.angle_noise)] * (sum(map(len, innovations)) - 3)
        return Rows(np.concatenate(innovations), np.concatenate(slopes), np.array(noise))


@dataclass(frozen=True, eq=False)
class CurvatureReading:
    """Curvatures from Bragg gratings of a fibre along a tube, in the axes of the tube."""

    stations: ArrayLike
    """(G,) distances of the gratings behind the tip of the tube, m. Those behind the plate are left out."""
    curvature: ArrayLike
    """(G, 2) curvature at the gratings, 1/m: the tube's curvature vector is along its x axis, if it is of one arc."""
    tube: int = 0
    """Number of the tube, from 0."""
    noise: float = 0.2
    """Standard deviation of a curvature, 1/m."""
    length: float = 5e-3
    """Length of a grating, over which it measures the mean, m."""

    def rows(self, of: Model) -> Rows:
        """Difference between the reading and its prediction by a model."""
        stations, measured = np.atleast_1d(np.asarray(self.stations, dtype=float)), np.asarray(self.curvature, float)
        n, half = of.equilibrium.robot.n_tubes, positive("length", self.length) / 2
        if not 0 <= self.tube < n:
            raise InputError(f"tube is {self.tube}; it must be 0 to {n - 1}")
        if not (np.isfinite(stations).all() and (stations >= half).all()):
            raise InputError(f"stations must be at least half a grating, {half:g} m, behind the tip of the tube")
        if measured.shape != (len(stations), 2) or not np.isfinite(measured).all():
            raise InputError(f"curvature must have two finite numbers for each of the {len(stations)} stations")
        positions = of.equilibrium.tube_end[self.tube] - stations
        innovations, slopes = [np.zeros(0)], [np.zeros((0, of.change.size))]
        for position, value in zip(positions.tolist(), measured, strict=True):
            if position + half > 0:
                ends = position - half, position + half
                expected, slope = curvature_in_tube(of.change, self.tube, ends, of.pace[self.tube])
                innovations.append(value - expected)
                slopes.append(slope)
        innovation = np.concatenate(innovations)
        return Rows(innovation, np.concatenate(slopes), np.full(len(innovation), positive("noise", self.noise)))


@dataclass(frozen=True, eq=False)
class BaseReading:
    """Wrench of all loads on the plate, from a force and torque sensor below it, in the plate frame."""

    wrench: ArrayLike
    """(6,) force, N, and moment about the centre of the plate, N m."""
    force_noise: float = 5e-3
    """Standard deviation of a force, N."""
    moment_noise: float = 1e-3
    """Standard deviation of a moment, N m."""

    def rows(self, of: Model) -> Rows:
        """Difference between the reading and its prediction by a model."""
        innovation = vector("wrench", self.wrench, 6, "force in N, moment in N m") - of.equilibrium.base_wrench
        noise = [positive("force_noise", self.force_noise)] * 3 + [positive("moment_noise", self.moment_noise)] * 3
        return Rows(innovation, base_wrench_change(of.change), np.array(noise))


Reading = TipReading | CurvatureReading | BaseReading


# --- Model ------------------------------------------------------------------------------------------------------------


class Model(NamedTuple):
    """Equilibrium at an estimated state, with its derivatives by the state."""

    equilibrium: Equilibrium
    change: Linearised
    """Derivatives of the equilibrium by the K estimated quantities."""
    pace: Array
    """(n, K) derivatives of the translations."""
    tip_offset: Array
    """Estimated offset (3,) of the tip, m."""
    offset_slopes: Array
    """(3, K) derivatives of `tip_offset` by the state."""


class States:
    """Estimated quantities; those with a deviation of 0 are left out.

    They are force (3), offsets of rotations (n) and translations (n), logarithms of stiffness factors (n), and tip
    offset (3).
    """

    def __init__(self, n: int, options: EstimatorOptions) -> None:
        o, self.n, self.options = options, n, options
        sizes = {"force": 3, "rotation": n, "translation": n, "stiffness": n, "tip_offset": 3}
        starts = np.cumsum([0, *sizes.values()])
        self.part = {name: slice(k, k + size) for (name, size), k in zip(sizes.items(), starts, strict=False)}
        sigma = np.concatenate([np.full(size, getattr(o, name)) for name, size in sizes.items()])
        tau = np.full(len(sigma), o.drift_time)
        tau[self.part["force"]] = o.force_time
        self.kept = np.flatnonzero(sigma > 0)
        if not len(self.kept):
            raise InputError("all standard deviations are 0; there is nothing to estimate")
        self.sigma, self.tau = sigma[self.kept], tau[self.kept]
        self.loaded = o.force > 0 or o.known is not None
        self.unit = np.eye(len(sigma))[:, self.kept]

    def whole(self, x: Array) -> dict[str, Array]:
        """Parts of a state (K,) by name, including quantities that are not estimated."""
        all_of = self.unit @ x
        return {name: all_of[part] for name, part in self.part.items()}

    def predict(self, x: Array, root: Array, dt: float) -> tuple[Array, Array]:
        """State (K,) and square root (K, K) of its covariance after a time, s."""
        phi = np.exp(-dt / self.tau)
        # (phi S, noise) times its transpose is the covariance; its triangular factor has the same product.
        grown = np.vstack([root.T * phi, np.diag(self.sigma * np.sqrt(-np.expm1(-2 * dt / self.tau)))])
        return phi * x, np.asarray(np.linalg.qr(grown)[1]).T

    def model(self, arm: Equilibrium, x: Array) -> Model:
        """Derivatives of an equilibrium by the state (K,)."""
        part, unit = self.part, self.unit
        wrt, rows = ["rotations", "translations"], [unit[part["rotation"]], unit[part["translation"]]]
        if self.options.stiffness:
            for name in ("bending_stiffness", "torsional_stiffness"):
                wrt.append(name)
                values = np.array([float(getattr(tube, name)) for tube in arm.robot.tubes])
                rows.append(values[:, None] * unit[part["stiffness"]])
        if self.loaded:
            rows.append(unit[part["force"]])
        change = linearise(arm, wrt, more=tip_forces if self.loaded else None, along=np.concatenate(rows))
        offset = unit[part["tip_offset"]]
        return Model(arm, change, unit[part["translation"]], offset @ x, offset)


def potter(x: Array, root: Array, slopes: Array, values: Array) -> tuple[Array, Array]:
    """State (K,) and square root of its covariance after measurements (R,) of unit variance, with slopes (R, K)."""
    for h, y in zip(slopes, values, strict=True):
        f = root.T @ h
        a, along = 1 / (f @ f + 1), root @ f
        x = x + a * (y - h @ x) * along
        root = root - np.outer(a / (1 + np.sqrt(a)) * along, f)
    return x, root


# --- Estimates --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class StateEstimate(Displayed):
    """Estimated shape, force and offsets at one time."""

    time: Annotated[float, unit("s"), form(".3f"), "time"]
    """Time, s."""
    equilibrium: Equilibrium
    """Equilibrium of the robot at the estimate: its shape. Under a load the error of its margin is up to 1e-3."""
    force: Annotated[Array, unit("mN"), form(".2f", label="force at the tip"), "estimated force on the tip"]
    """(3,) estimated force on the tip, N, plate frame."""
    rotation_offsets: Array
    """(n,) true less measured rotations, rad."""
    translation_offsets: Array
    """(n,) true less measured translations, m."""
    stiffness_factors: Array
    """Factor (n,) on the given stiffness of every tube."""
    tip_offset: Array
    """(3,) offset of measured tips from the model, m."""
    state: Array
    """(K,) all that is estimated in this order, without what has the deviation 0; of stiffnesses the logarithms."""
    covariance: Array
    """(K, K) covariance of the state."""
    prior: Array
    """(K,) standard deviations without measurements."""
    states: States
    """Places of the estimated quantities in the state."""

    def covariance_of(self, name: str) -> Array:
        """Covariance of "force", "rotation", "translation", "stiffness" or "tip_offset"; 0 where not estimated."""
        whole = self.states.unit @ self.covariance @ self.states.unit.T
        return np.asarray(whole[self.states.part[name], self.states.part[name]])

    @cached_property
    def _force_axes(self) -> tuple[Array, Array]:
        square, axes = np.linalg.eigh(self.covariance_of("force"))
        return axes.T, np.sqrt(np.maximum(square, 0.0))

    @property
    def force_directions(self) -> Array:
        """(3, 3) unit vectors by row, from the best to the worst determined."""
        return self._force_axes[0]

    @property
    def force_errors(self) -> Array:
        """(3,) standard errors of the force along `force_directions`, N."""
        return self._force_axes[1]

    @property
    def force_observed(self) -> Array:
        """(3,) True for each of `force_directions` if measurements at least halved its standard error."""
        return np.asarray(self.force_errors <= HIDDEN * self.states.options.force)

    @property
    def unobserved(self) -> str:
        """Sentence on the directions of force and offsets that the measurements do not determine; "" if none."""
        parts = []
        if self.states.options.force:
            for axis, error, seen in zip(self.force_directions, self.force_errors, self.force_observed, strict=True):
                if not seen:
                    along = ", ".join(f"{x + 0.0:.2f}" for x in axis)
                    parts.append(f"the force along ({along}), with a standard error of {error * 1e3:.3g} mN")
        for name, size, symbol in (("rotation", 180 / np.pi, "deg"), ("translation", 1e3, "mm")):
            for i, error in enumerate(np.sqrt(np.diag(self.covariance_of(name))).tolist()):
                if error > HIDDEN * getattr(self.states.options, name):
                    what = f"the {name} offset of tube {i + 1}"
                    parts.append(f"{what}, with a standard error of {size * error:.3g} {symbol}")
        return "not observed: " + "; ".join(parts) if parts else ""

    @cached_property
    def shape_covariance(self) -> Array:
        """(m, 3, 3) covariance of the shape points at their arc lengths, m^2; the last one is the tip."""
        with small:
            slopes = self.states.model(self.equilibrium, self.state).change.position
        return np.asarray(slopes @ self.covariance @ slopes.swapaxes(1, 2))

    @property
    def value(self) -> Array:
        """(3,) force, N."""
        return self.force


@dataclass(frozen=True, eq=False)
class Correction(Displayed):
    """Result of measurements for an estimator."""

    used: bool
    """True if a reading corrected the state."""
    message: str
    """Reason for an unused reading; "" where all were used."""
    surprise: float
    """Squared innovations over their covariance, of the readings that were used."""
    expected: int
    """Expected value of `surprise`: how many numbers the readings have. On average both agree if the model is right."""
    before: float
    """Distance of the measured tip from the one that was expected, m; NaN without one."""
    after: float
    """Distance after the correction, m."""


class _Update(NamedTuple):
    """Measurements at one time, linearised in the state and divided by their noise, with the state after them."""

    time: float
    slopes: Array
    values: Array
    x: Array
    root: Array


@typed
class StateEstimator:
    """Estimates tip force, joint offsets and shape of one robot of concentric tubes in motion.

    Args:
        start: the equilibrium of the model where the robot is.
        options: see `EstimatorOptions`.

    Raises:
        InputError: tubes beside the centreline.
    """

    def __init__(self, start: Equilibrium, options: EstimatorOptions | None = None) -> None:
        if not isinstance(start.robot, ConcentricRobot):
            raise InputError("a state estimator supports concentric robots only")
        self.options = options or EstimatorOptions()
        self._given, self._arm = start.robot, start
        self.states = States(start.robot.n_tubes, self.options)
        # Without measurements the processes are stationary: a time in the far past changes nothing.
        zero = np.zeros(len(self.states.sigma))
        none = np.zeros((0, len(zero)))
        self._updates = [_Update(-np.inf, none, none[:, 0], zero, np.diag(self.states.sigma))]
        self._past: deque[tuple[float, Array, Array]] = deque()
        self._left_out = 0

    def encoders(self, time: float, rotations: ArrayLike, translations: ArrayLike) -> None:
        """Add joint values (n,) that were measured or sent at a time, s; times must increase."""
        n = self.states.n
        alpha, shift = vector("rotations", rotations, n), vector("translations", translations, n)
        if self._past and not time > self._past[-1][0]:
            raise InputError(f"time is {time:g} s; it must be more than that of the last joint values")
        self._past.append((finite("time", time), alpha, shift))
        while time - self._past[0][0] > MEMORY and len(self._past) > 2:
            self._past.popleft()
        while len(self._updates) > 1 and self._updates[1].time < time - MEMORY:
            self._updates.pop(0)

    @small
    def measured(self, time: float, *readings: Reading) -> Correction:
        """Result of readings taken at a time, s. They may arrive late; without joint values near that time they are
        ignored.
        """
        joints = self._joints_at(time)
        if joints is None or time < self._updates[0].time:
            return Correction(False, "no joint values of its time are known", 0.0, 0, np.nan, np.nan)
        try:
            return self._update(time, readings, joints)
        except SolveError as error:
            message = f"the model has no equilibrium there, the robot may have snapped: {error}"
            return Correction(False, message, 0.0, 0, np.nan, np.nan)

    def estimate(self, time: float | None = None) -> StateEstimate:
        """StateEstimate at a time, s, by default that of the last joint values.

        Raises:
            InputError: no joint values of the time are known.
            SolveError: the branch of the model ends before these joint values.
        """
        if time is None and self._past:
            time = self._past[-1][0]
        joints = None if time is None else self._joints_at(time)
        if time is None or joints is None:
            raise InputError("time has no joint values; call `encoders` first")
        x, root = self._state_at(time, self._before(time))
        states, parts = self.states, self.states.whole(x)
        arm = self.at(x, *joints)
        offsets = parts["rotation"], parts["translation"], np.exp(parts["stiffness"]), parts["tip_offset"]
        return StateEstimate(time, arm, parts["force"], *offsets, x, root @ root.T, states.sigma, states)

    @property
    def robot(self) -> ConcentricRobot:
        """The robot with the stiffnesses of the last estimate."""
        return self._robot(self._updates[-1].x)

    def predict(self, rotations: ArrayLike, translations: ArrayLike) -> tuple[Equilibrium, Array]:
        """Equilibrium at measured joint values (n,) under the last estimate, and predicted measured tip (3,), m."""
        n, x = self.states.n, self._updates[-1].x
        arm = self.at(x, vector("rotations", rotations, n), vector("translations", translations, n))
        return arm, arm.tip_position + self.states.whole(x)["tip_offset"]

    def shift(self, nominal: Equilibrium) -> Array:
        """(3,) shift, m, from the tip of the nominal robot to the tip that would be measured.

        To reach p, a servo on the robot as given aims at p minus this.
        """
        return np.asarray(self.predict(nominal.rotations, nominal.translations)[1] - nominal.tip_position)

    def _joints_at(self, time: float) -> tuple[Array, Array] | None:
        times = [past[0] for past in self._past]
        k = bisect_right(times, time)
        if not times or k == 0 or (k == len(times) and time > times[-1]):
            return None
        if k == len(times):
            return self._past[-1][1:]
        (a, *first), (b, *last) = self._past[k - 1], self._past[k]
        x = (time - a) / (b - a)
        alpha, shift = ((1 - x) * one + x * two for one, two in zip(first, last, strict=True))
        return alpha, shift

    def _before(self, time: float) -> int:
        """Number of updates up to a time."""
        return bisect_right([update.time for update in self._updates], time)

    def _state_at(self, time: float, count: int) -> tuple[Array, Array]:
        """State and square root of its covariance at a time, predicted from the last of `count` updates."""
        last = self._updates[count - 1]
        return self.states.predict(last.x, last.root, min(time - last.time, 1e300))

    def _update(self, time: float, readings: Sequence[Reading], joints: tuple[Array, Array]) -> Correction:
        count = self._before(time)
        x0, root0 = self._state_at(time, count)
        x, root, used, message = x0, root0, list(readings), ""
        slopes, values, surprise = self._updates[0].slopes, self._updates[0].values, 0.0
        for k in range(LINEARISATIONS):
            model = self.states.model(self.at(x, *joints), x)
            rows = [reading.rows(model) for reading in used]
            if k == 0:
                surprises = [_surprise(each, root) for each in rows]
                plausible = [s <= len(r.innovation) * GATE**2 for s, r in zip(surprises, rows, strict=True)]
                self._left_out = 0 if all(plausible) else self._left_out + 1
                if not all(plausible):
                    message = "it is farther off than could be"
                    if self._left_out >= LOST:
                        message += f", as {self._left_out} in a row: the robot may have snapped; start a new estimator"
                before = after = _tip_distance(used, [each.innovation for each in rows])
                surprise = sum(s for s, good in zip(surprises, plausible, strict=True) if good)
                used = [each for each, good in zip(used, plausible, strict=True) if good]
                rows = [each for each, good in zip(rows, plausible, strict=True) if good]
                if not used:
                    return Correction(False, message, 0.0, 0, before, before)
            noise = np.concatenate([each.noise for each in rows])
            slopes = np.concatenate([each.slopes for each in rows]) / noise[:, None]
            # Linear in the state: what the model expects at x, and the derivatives there.
            values = np.concatenate([each.innovation for each in rows]) / noise + slopes @ x
            last, (x, root) = x, potter(x0, root0, slopes, values)
            if np.abs((x - last) / np.sqrt((root**2).sum(1))).max() < SETTLED:
                break
        # The distance of the tip after the last step, by the derivatives.
        if not np.isnan(before):
            after = _tip_distance(used, [each.innovation - each.slopes @ (x - last) for each in rows])
        later = self._updates[count:]
        del self._updates[count:]
        self._updates.append(_Update(time, slopes, values, x, root))
        for update in later:
            x, root = potter(*self._state_at(update.time, len(self._updates)), update.slopes, update.values)
            self._updates.append(update._replace(x=x, root=root))
        return Correction(True, message, surprise, len(values), before, after)

    @without_unit_warnings()
    def _robot(self, x: Array) -> ConcentricRobot:
        """Robot with the stiffnesses of an estimated state."""
        if not self.options.stiffness:
            return self._given
        factors = np.exp(self.states.whole(x)["stiffness"]).tolist()
        tubes = tuple(
            replace(
                tube,
                bending_stiffness=float(tube.bending_stiffness) * factor,
                torsional_stiffness=float(tube.torsional_stiffness) * factor,
                pieces=tuple(piece.stiffened(factor) for piece in tube.pieces),
            )
            for tube, factor in zip(self._given.tubes, factors, strict=True)
        )
        return replace(self._given, tubes=tubes)

    @without_unit_warnings()
    def at(self, x: Array, rotations: Array, translations: Array) -> Equilibrium:
        """Equilibrium at measured joint values under an estimated state, on the branch of the last one."""
        robot, parts = self._robot(x), self.states.whole(x)
        alpha, shift = rotations + parts["rotation"], translations + parts["translation"]
        last = self._arm if robot is self._arm.robot else replace(self._arm, robot=robot)
        try:
            if self.states.loaded:
                known = self.options.known or Load()
                force = tuple(np.add(known.force, parts["force"]).tolist())
                load = replace(known, force=force)
                arm = forward_kinematics(robot, alpha, shift, load=load, start=last, method=METHOD)
            else:
                quick = one_step(robot, last, alpha, tuple(shift.tolist()))
                arm = forward_kinematics(robot, alpha, shift, start=last) if quick is None else quick
        except InputError as error:
            raise SolveError(str(error)) from None
        self._arm = arm
        return arm


def _surprise(rows: Rows, root: Array) -> float:
    """Squared innovations over their covariance."""
    spread = rows.slopes @ root
    covariance = spread @ spread.T + np.diag(rows.noise**2)
    return float(rows.innovation @ np.linalg.solve(covariance, rows.innovation)) if len(rows.innovation) else 0.0


def _tip_distance(readings: Sequence[Reading], innovations: Sequence[Array]) -> float:
    """Distance of the first measured tip from the expected one, m; NaN without one."""
    tip_innovations = (
        innovation for reading, innovation in zip(readings, innovations, strict=True) if isinstance(reading, TipReading)
    )
    return float(np.linalg.norm(next(tip_innovations, np.full(3, np.nan))[:3]))
