"""Predicted shapes at many joint values, and predicted sensor positions for a robot with given parameters."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Generic, Protocol, Self, TypeVar

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..block.transcription.arm import Arm, evaluate_arm
from ..equilibrium.batch import EquilibriumBatch, forward_kinematics_batch
from ..equilibrium.clearance import clearance_correction
from ..equilibrium.friction import FrictionEquilibrium, to_held_equilibrium
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.readings import yielded
from ..equilibrium.result import Equilibrium
from ..errors import ImplausibleWarning, InputError, SolveError, choice
from ..robots.concentric import ConcentricRobot, Friction, friction_of
from ..robots.order import last_tube
from ..robots.robot import Robot
from ..solvers.compiled.friction import FrictionStates
from ..stability.friction_path import follow_with_friction, start_with_friction
from ..typing import Array, Index, Mask
from .effects import Setup
from .measurements import Measurements, Timeline, middles_of
from .parameters import Parameter, apply
from .registration import FREEDOMS, SENSOR_FRAME, BasePose, MeasuredDirections, Registration, register


@dataclass(frozen=True, eq=False)
class PredictedPoses:
    """Stable equilibria of N configurations, each found on its own; NaN if none was. Plate frame, SI."""

    position: Array
    """(N, K, 3) positions of K stations, the foremost first."""
    frame: Array
    """(N, 3, 3) frame at the tip of the tube that ends last: its own axes, turned with it."""
    margin: Array
    """(N,) margins, NaN if not requested."""
    length: Array
    """(N,) length of the arm in front of the plate, m."""
    failures: tuple[tuple[int, str], ...]
    """(row, reason in words)."""

    @property
    def solved(self) -> Mask:
        """(N,) True for rows with an equilibrium."""
        return np.isfinite(self.frame[:, 0, 0])


def solve_poses(
    robot: Robot, rotations: Array, translations: Array, stations: Array, runs: Sequence[Index] = ()
) -> PredictedPoses:
    """Poses at joint values (N, n) of the model; stations (K,) behind the tip, m, the foremost first.

    Each row is solved alone, without a start. In `runs` of consecutive rows, a row that ends on another branch than the
    row before is solved again from that row, until both solutions agree or the branch ends.

    Raises:
        InputError: joint values at which the robot cannot be; the row is named.
    """
    try:
        batch = forward_kinematics_batch(robot, rotations, translations)
    except InputError as error:
        raise _by_row(robot, rotations, translations, error) from None
    shapes = {row: shape for run in runs for row, shape in _followed(robot, batch, run)}
    reach = translations + np.array([tube.curved_length for tube in robot.tubes])
    tip, turned, turns, margin = (
        getattr(batch, name).copy() for name in ("tip_position", "tip_rotation", "tip_rotations", "margin")
    )
    for row, shape in shapes.items():
        tip[row], turned[row] = shape.tip_position, shape.tip_rotation
        turns[row], margin[row] = shape.tip_rotations, shape.margin
    theta = turns[np.arange(len(batch)), last_tube(reach)]
    position = np.repeat(tip[:, None], len(stations), axis=1)
    failures = tuple(failure for failure in batch.failures if failure[0] not in shapes)
    poses = PredictedPoses(position, turned @ about_z(theta), margin, np.maximum(reach, 0.0).max(1), failures)
    if stations.any() or loose(robot):
        for k in np.flatnonzero(poses.solved).tolist():
            try:
                shape = shapes.get(k) or forward_kinematics(robot, rotations[k], translations[k])
            except SolveError:
                position[k] = np.nan
                continue
            if stations.any():
                position[k] = stations_of(shape, stations)
            if loose(robot):
                tilt(poses, k, shape, stations)
    return poses


def poses_with_friction(
    robot: Robot,
    joints: tuple[Array, Array],
    stations: Array,
    runs: Sequence[Index],
    friction: Friction,
    *,
    margins: bool = True,
) -> PredictedPoses:
    """Poses at joint values (N, n) of the model along `runs` of rows; each run begins without a history.

    Rows of a run after the motion is lost have none. Without `margins` some margins are unknown.

    Raises:
        InputError: joint values at which the robot cannot be.
    """
    alpha, shift = joints
    # On a coarse mesh where slip ends is off by less than what tips are measured to.
    coarse = replace(friction, refinement=min(friction.refinement, -1))
    count = len(alpha)
    position, frame = np.full((count, len(stations), 3), np.nan), np.full((count, 3, 3), np.nan)
    margin, length = np.full(count, np.nan), np.zeros(count)
    failures: list[tuple[int, str]] = []
    poses = PredictedPoses(position, frame, margin, length, ())
    table_of_poses = _ObservedPath(robot, stations, poses)
    for run in runs:
        table, solved = np.hstack([alpha[run], shift[run]]), 0
        try:
            held = start_with_friction(robot, table[0], coarse)
            table_of_poses.put(run[0], held)
            solved = 1
            for part in follow_with_friction(
                robot, table, held, stations=stations, margins=margins, compiled=not loose(robot)
            ):
                rows = run[part.first : part.first + len(part.numbers)]
                if part.states is None:
                    table_of_poses.put(rows[0], part.end)
                else:
                    table_of_poses.put_many(rows, shift, part.states)
                solved = part.first + len(rows)
        except (InputError, SolveError) as error:
            failures += [(int(row), str(error)) for row in run[solved:]]
    return replace(poses, failures=tuple(failures))


@dataclass(frozen=True, eq=False)
class _ObservedPath:
    """Poses of a robot that are filled in."""

    robot: Robot
    stations: Array
    poses: PredictedPoses

    def put(self, row: int, held: FrictionEquilibrium) -> None:
        """Set one row from an equilibrium with friction."""
        problem, poses = held.contact.problem, self.poses
        arm = evaluate_arm(problem, held.rotations, held.increment.state.torsion, held.profile)
        poses.length[row], poses.margin[row] = arm.arc_length[-1], held.margin
        poses.position[row] = stations_of(arm, self.stations) if self.stations.any() else arm.position[-1]
        poses.frame[row] = arm.frame[-1] @ about_z(arm.rotation[self._last(held.translations), -1])
        if loose(self.robot):
            tilt(poses, row, to_held_equilibrium(self.robot, held, "way"), self.stations)

    def put_many(self, rows: Index, translations: Array, many: FrictionStates) -> None:
        """Set rows from the results of the kernel, at translations (N, n) of all rows."""
        poses, last = self.poses, self._last(translations[rows])
        poses.length[rows], poses.margin[rows], poses.position[rows] = many.length, many.margin, many.stations
        poses.frame[rows] = many.frame @ about_z(many.rotation[np.arange(len(rows)), last])

    def _last(self, translations: Array) -> Index:
        """The tube that ends last, at translations (..., n)."""
        return last_tube(translations + [tube.curved_length for tube in self.robot.tubes])


def loose(robot: Robot) -> bool:
    """True if the robot has a clearance between its tubes."""
    return isinstance(robot, ConcentricRobot) and bool(np.any(robot.clearance or 0.0))


def tilt(poses: PredictedPoses, row: int, shape: Equilibrium, stations: Array) -> None:
    """Tilt the arm in a row as far as the clearance between the tubes allows."""
    tilted = clearance_correction(shape)
    moved, at = tilted.position - shape.position, np.maximum(shape.arc_length[-1] - stations, 0.0)
    poses.position[row] += np.column_stack([np.interp(at, shape.arc_length, along) for along in moved.T])
    poses.frame[row] = tilted.turn @ poses.frame[row]


def _followed(robot: Robot, batch: EquilibriumBatch, run: Index) -> Iterator[tuple[int, Equilibrium]]:
    """Rows of a run solved again on the branch of the rows before, if a cold solve ended on another one."""
    # Twist of every tube between its drive and its tip: a snap is a jump of it.
    twist = batch.tip_rotations[run] - batch.rotations[run]
    driven = np.abs(np.diff(batch.rotations[run], axis=0)).max(1, initial=0.0)
    # A tip that turns against its drive by so much more than any drive turned may be in another equilibrium.
    jumps = np.flatnonzero(np.abs(np.diff(twist, axis=0)).max(1, initial=0.0) > 0.5 + 15.0 * driven) + 1
    current, next_row = None, 0
    for jump in jumps.tolist():
        if jump < next_row:
            continue
        k = jump
        while k < len(run):
            row, before = int(run[k]), int(run[k - 1])
            try:
                if current is None:
                    current = forward_kinematics(robot, batch.rotations[before], batch.translations[before])
                current = forward_kinematics(robot, batch.rotations[row], batch.translations[row], start=current)
            except SolveError:
                break  # the branch ends: the robot snaps to what the row alone leads to
            # Back at the equilibrium that the row finds on its own: both agree from here on.
            if not current.stable or (np.abs(current.tip_rotations - batch.tip_rotations[row]) < 1e-3).all():
                break
            yield row, current
            k += 1
        current, next_row = None, k + 1


def about_z(angle: ArrayLike) -> Array:
    """(..., 3, 3) turns about z."""
    rotation = np.zeros((*np.shape(angle), 3, 3))
    rotation[..., 0, 0] = rotation[..., 1, 1] = np.cos(angle)
    rotation[..., 1, 0], rotation[..., 0, 1] = np.sin(angle), -np.sin(angle)
    rotation[..., 2, 2] = 1.0
    return rotation


def stations_of(shape: Equilibrium | Arm, stations: Array) -> Array:
    """(K, 3) positions, m, of sensors at distances behind the tip; on the plate's axis for those behind the plate."""
    # Breakpoints that coincide give equal arc lengths, which a spline does not accept.
    at, distinct = shape.arc_length[-1] - stations, np.append(True, np.diff(shape.arc_length) > 0)
    line = scipy.interpolate.CubicHermiteSpline(
        shape.arc_length[distinct], shape.position[distinct], shape.frame[distinct, :, 2]
    )
    out: Array = line(np.maximum(at, 0.0))
    # Behind the plate the tubes are straight, along its axis.
    out[:, 2] += np.minimum(at, 0.0)
    return out


def _by_row(robot: Robot, rotations: Array, translations: Array, error: InputError) -> InputError:
    """Error for the first invalid row, with the message of a single configuration."""
    for k in range(len(rotations)):
        try:
            robot.admit(translations[k])
        except InputError as cause:
            return InputError(f"row {k + 1}: {cause}")
    return error


# Step, in units of a parameter's scale, of the difference quotients: the quotients are as exact as it is small, a few
# 1e-6, and equilibria are solved a thousand times as sharply.
STEP = 2e-6

# Errors below this share of others, and by more than so many m, are clearly smaller: no noise of a fit by turns.
CLEARLY, SEEN = 0.9, 1e-9

# The same of joint values, rad and m.
JOINT_STEP = 1e-6

# Full turns to each side of the calibrated motion in which the begin of a recording is searched: limits of most
# robots allow two, and a calibration may be off by one.
TURNS = 3

# Directions along which a sensor may lie in its own frame.
AXES = np.vstack([np.eye(3), -np.eye(3)])


class Pose(Protocol):
    """Pose of a measuring device, or of several."""

    def moved(self, step: Array) -> Self:
        """Pose after a small step in its freedoms."""


M = TypeVar("M", bound=Pose)


@dataclass(frozen=True, eq=False)
class ParameterState(Generic[M]):
    """Parameters x (P,) and pose of the measuring device."""

    x: Array
    registration: M

    def moved(self, step: Array) -> ParameterState[M]:
        """The state after a step: of the parameters, then of the registration's freedoms."""
        count = len(self.x)
        return ParameterState(self.x + step[:count], self.registration.moved(step[count:]))


class ArmModel:
    """Observations, three numbers each: positions of stations (m), then directions of the tip's sensor (unit vectors).

    Args:
        robot, measurements: as given.   parameters: that x holds.
        method, base: of the registration, as for `register`.
        middle: (n,) median rotation of all recordings that have gains in common; None for that of this one.

    Attributes:
        row (V,): row of each observation.   station (V,): its station, -1 for a direction.
        observed: (V, 3) in the device's frame.
        failures: rows without a stable equilibrium at the start, which are left out, with the reason.

    Raises:
        InputError: a row at which the robot cannot be.
        SolveError: no row has a stable equilibrium.
    """

    def __init__(
        self,
        robot: Robot,
        measurements: Measurements,
        parameters: Sequence[Parameter] = (),
        method: str = "rigid",
        base: BasePose = SENSOR_FRAME,
        middle: Array | None = None,
    ) -> None:
        self.robot, self.measurements, self.parameters = robot, measurements, tuple(parameters)
        self.method, self.base = choice("registration", method, FREEDOMS), base
        self.freedoms = FREEDOMS[self.method]
        self.first = Setup.of(robot)
        self.timeline = Timeline.of(measurements)
        common = np.median(measurements.rotations, axis=0) if middle is None else middle
        self.first.drives, self.turns = middles_of(self.first.drives, measurements, common)
        self.stations = measurements.stations
        self.evaluations = 0
        self._solved: list[tuple[Setup, Array, Array, PredictedPoses]] = []
        self._gave_way: list[tuple[Setup, Array, Array, Array]] = []
        self._count_turns()
        poses = self.poses(self.first)
        self.failures = poses.failures
        if not poses.solved.any():
            row, reason = poses.failures[0]
            raise SolveError(f"row {row + 1}: {reason}")
        self.length = float(poses.length[poses.solved].max())
        self._observe(poses)

    def _count_turns(self) -> None:
        """Choose the turn from which each rotation is counted, if the gain of its drive depends on it.

        The recording of the calibration counts as it did there. In others a counter stands as it was read, unless
        another turn halves the errors: then it was set to zero elsewhere. Wrapped angles take the turn that fits
        clearly better than the one of the first row. Turns are changed one at a time, the one that helps most first.
        """
        m, saved = self.measurements, self.first.drives.registration
        if saved is not None and saved.recording == m.mark:
            return
        earlier, wrapped = self.turns, np.array(m.wrapped or (False,) * m.n_tubes)
        gained = np.flatnonzero(np.array(self.first.drives.rotation_gains) != 1.0).tolist()
        moves = [(k, earlier[k] + count) for k in gained for count in range(-TURNS, TURNS + 1)]
        fitting, min_misfit = np.zeros(m.n_tubes), self._misfit(np.zeros(m.n_tubes)) if moves else 0.0
        as_read = min_misfit
        while moves:
            tried = [np.where(np.arange(m.n_tubes) == k, turns, fitting) for k, turns in moves]
            misfits = [self._misfit(turns) for turns in tried]
            # A change must take off a tenth, and more than round-off.
            if min(misfits) > min(CLEARLY * min_misfit, min_misfit - SEEN):
                break
            fitting, min_misfit = tried[int(np.argmin(misfits))], min(misfits)
        known = np.where(wrapped, fitting, 0.0)
        self.turns = fitting if min_misfit < self._misfit(known) / 2 else known
        if fitting.any():
            corrections = " and ".join(
                f"{-360 * fitting[k]:+.0f} deg of rotation_{k + 1}" for k in np.flatnonzero(fitting)
            )
            counted = "so they are counted"
            if not np.array_equal(self.turns, fitting):
                as_read_joints = [f"rotation_{k + 1}" for k in np.flatnonzero(self.turns != fitting)]
                counted = f"{' and '.join(as_read_joints)} counts as read, since errors are not halved"
            remark = (
                f"readings fit best with {corrections}: {min_misfit * 1e3:.2f} mm instead of {as_read * 1e3:.2f} mm "
                f"(root mean square); {counted}"
            )
            self.measurements = replace(m, remarks=(*m.remarks, remark))

    def _misfit(self, turns: Array) -> float:
        """Root mean square error (m) of the positions, without friction, for rotations counted from `turns` (n,).

        Infinite without an equilibrium.
        """
        self.turns, setup = turns, self.first.copy()
        # Without friction every row is solved on its own, which is enough to recognise a full turn.
        setup.friction[:] = setup.friction_by_moment[:] = 0.0
        try:
            with warnings.catch_warnings(action="ignore", category=ImplausibleWarning):  # of turns that are tried
                poses = self.poses(setup)
            self._observe(poses)
            apart = self.observed - self._seen(setup, poses, self.start.registration)
        except (InputError, SolveError):
            return math.inf
        return float(np.sqrt((apart[~self.directed] ** 2).sum(1).mean()))

    def _observe(self, poses: PredictedPoses) -> None:
        """Arrange the measured values as observations."""
        positions = self.measurements.station_position
        observed = np.isfinite(positions[..., 0]) & poses.solved[:, None] & np.isfinite(poses.position[..., 0])
        rows, stations = np.nonzero(observed)
        predicted, pointing = self._placed(self.first, poses)
        # The axis of the sensor needs a registration, which positions alone give first; directions then refine it.
        m, seen = self.measurements, np.zeros(len(rows), dtype=bool)
        registration = self.register(positions[observed], predicted[observed], seen)
        self.axis = self._sensor_axis(poses, pointing, registration)
        parts, row, station = [positions[rows, stations]], [rows], [stations]
        frames = m.orientation
        if frames is not None and self.axis is not None:
            directed = np.flatnonzero(np.isfinite(frames).all((1, 2)) & poses.solved)
            parts.append(frames[directed] @ self.axis)
            row.append(directed)
            station.append(np.full(len(directed), -1))
        self.observed, self.row, self.station = np.concatenate(parts), np.concatenate(row), np.concatenate(station)
        if self.directed.any():
            registration = self.register(self.observed, self._in_plate(self.first, poses), self.directed)
        self.start = ParameterState(np.array([p.start for p in self.parameters]), registration)

    def register(
        self,
        measured: Array,
        predicted: Array,
        a: Mask,
        noise: tuple[float | None, float | None] = (None, None),
    ) -> Registration:
        """Registration by closed form, or that of the calibration.

        Args:
            measured, predicted: (V, 3), in the frame of the device and of the plate.   a: (V,) True for directions.
            noise: as for `MeasuredDirections`.
        """
        if self.method != "saved":
            directions = MeasuredDirections(measured[a], predicted[a], noise)
            return register(measured[~a], predicted[~a], self.method, base=self.base, directions=directions)
        saved = self.first.drives.registration
        if saved is None:
            raise InputError("registration is 'saved', but the robot's calibration has none; fit with rigid first")
        return Registration.of_saved(saved)

    def registered(
        self, state: ParameterState[Registration], noise: tuple[float | None, float | None]
    ) -> ParameterState[Registration]:
        """The state with the registration that fits its shapes best; `noise` as for `MeasuredDirections`."""
        if self.method in ("none", "saved"):
            return state
        return ParameterState(state.x, self.register(self.observed, self.in_plate(state.x), self.directed, noise))

    def in_plate(self, x: Array) -> Array:
        """(V, 3) predictions of the observations in the frame of the plate."""
        setup = self.setup(x)
        return self._in_plate(setup, self.poses(setup))

    def _in_plate(self, setup: Setup, poses: PredictedPoses) -> Array:
        stations, direction = self._placed(setup, poses)
        out, a = np.empty_like(self.observed), self.directed
        out[~a], out[a] = stations[self.row[~a], self.station[~a]], direction[self.row[a]]
        return out

    @property
    def count(self) -> int:
        """Number of rows."""
        return len(self.measurements)

    @property
    def directed(self) -> Mask:
        """(V,) True for observations that are directions."""
        return np.asarray(self.station < 0)

    def _sensor_axis(self, poses: PredictedPoses, pointing: Array, registration: Registration) -> Array | None:
        """Direction along the tube in the frame of the sensor, from the recording or from the calibration.

        Without one it is the direction of AXES that fits best.
        """
        m, known = self.measurements, self.first.drives.sensor_axis
        if m.orientation is None or m.sensor_axis is not None:
            return m.sensor_axis
        if known:
            return np.array(known)
        measured = np.isfinite(m.orientation).all((1, 2)) & poses.solved
        if not measured.any():
            return None
        # Rows times R are R' times vectors: from the plate into the device's frame.
        tangent = pointing[measured] @ registration.rotation
        alike = np.einsum("ka,nba,nb->k", AXES, m.orientation[measured], tangent)
        return np.asarray(AXES[int(np.argmax(alike))])

    def with_parameters(self, parameters: Sequence[Parameter]) -> ArmModel:
        """Model of the same observations with other parameters in x; solved equilibria are reused."""
        copied = object.__new__(ArmModel)
        copied.__dict__.update(self.__dict__)
        copied.parameters = tuple(parameters)
        copied.start = ParameterState(np.array([p.start for p in parameters]), self.start.registration)
        return copied

    # --- what a state predicts ----------------------------------------------------------------------------------------

    def setup(self, x: Array) -> Setup:
        """Setup at parameters x."""
        return apply(self.first, self.parameters, x)

    def joints(self, setup: Setup) -> tuple[Array, Array]:
        """(N, n) joint values of the model, rad and m."""
        drives = setup.drives
        alpha, shift = self.timeline.driven(drives, self.turns)
        if not any(drives.translation_compliance):
            return alpha, shift
        return alpha, self._yielded(setup, alpha, shift)

    def _yielded(self, setup: Setup, alpha: Array, shift: Array) -> Array:
        """(N, n) translations of compliant carriages, cached for the last setups and for the start.

        Friction between tubes acts only among them: the carriages yield as without friction.
        """
        for known, *joints, yielding in self._gave_way:
            yields_alike = known.drives.translation_compliance == setup.drives.translation_compliance
            if yields_alike and known.same_tubes(setup) and np.array_equal(joints, [alpha, shift]):
                return yielding
        guess = None
        if self._gave_way:
            _, _, before, last_shift = self._gave_way[0]
            # Carriages that yield by as much as before, at the new readings.
            guess = last_shift + shift - before
        yielding = yielded(setup.robot(self.robot), alpha, shift, np.array(setup.drives.translation_compliance), guess)
        self._gave_way[:] = [(setup.copy(), alpha, shift, yielding), *self._gave_way[:2]]
        return yielding

    def poses(
        self, setup: Setup, joints: tuple[Array, Array] | None = None, *, margins: bool = False
    ) -> PredictedPoses:
        """Equilibria of every row, at its own joint values or at others; the last few are remembered.

        Along a path with friction all margins are known only with `margins`.

        Raises:
            InputError: there is no such robot, or it cannot be at these joint values.
        """
        alpha, shift = self.joints(setup) if joints is None else joints
        for tubes, a, d, poses in self._solved:
            if not margins and np.array_equal(a, alpha) and np.array_equal(d, shift) and tubes.same_tubes(setup):
                return poses
        robot = setup.robot(self.robot)
        self.evaluations += len(alpha)
        friction, runs = friction_of(robot), self.timeline.runs
        if friction is None or not runs:
            poses = solve_poses(robot, alpha, shift, self.stations, runs)
        else:
            poses = poses_with_friction(robot, (alpha, shift), self.stations, runs, friction, margins=margins)
        # Joint values that are given come from differences, which ask for them once.
        if joints is None:
            self._solved[:] = [(setup.copy(), alpha, shift, poses), *self._solved[:2]]
        return poses

    def _placed(self, setup: Setup, poses: PredictedPoses) -> tuple[Array, Array]:
        """Positions (N, K, 3), m, of the sensors on the arm, and directions (N, 3), in the plate frame."""
        stations = poses.position.copy()
        stations[:, 0] += poses.frame @ setup.sensor_offset
        x, y = setup.sensor_tilt
        # R_y(y) R_x(x) e_z: the axis of the tube, turned about x, then about y.
        direction = poses.frame @ np.array([np.sin(y) * np.cos(x), -np.sin(x), np.cos(y) * np.cos(x)])
        plate_rotation = setup.plate_turn
        return stations @ plate_rotation.T + setup.plate_shift, direction @ plate_rotation.T

    def predicted(self, state: ParameterState[Registration]) -> Array:
        """(V, 3) predicted sensor values.

        Raises:
            InputError: there is no such robot.
            SolveError: a row that was solved at the start has no stable equilibrium.
        """
        setup = self.setup(state.x)
        return self._seen(setup, self.poses(setup), state.registration)

    def _seen(self, setup: Setup, poses: PredictedPoses, motion: Registration) -> Array:
        shift = np.where(self.directed[:, None], 0.0, motion.translation)
        out = (self._in_plate(setup, poses) - shift) @ motion.rotation
        if not np.isfinite(out).all():
            row = int(self.row[np.argmax(~np.isfinite(out).all(1))])
            raise SolveError(f"row {row + 1} has no stable equilibrium")
        return out

    def residuals(self, state: ParameterState[Registration]) -> Array:
        """(V, 3) measured minus predicted, in the device's frame: m, and unit vectors; raises as `predicted`."""
        return self.observed - self.predicted(state)

    def jacobian(self, state: ParameterState[Registration], skip: int = 0) -> Array:
        """(V, 3, P + F) derivatives of `residuals` by the parameters and by the freedoms of the registration.

        Difference quotients, in scaled steps towards the middle of each range; a step to where there is no robot is
        taken in the opposite direction, and a parameter without a possible change gets a column of 0. All parameters of
        the drives share the derivatives by the joint values. The columns of the first `skip` parameters are left at 0.
        """
        predicted = self.predicted(state)
        count = len(self.parameters)
        out = np.zeros((*predicted.shape, count + self.freedoms))
        now = self.setup(state.x)
        joints: Array | None = None
        for k, p in enumerate(self.parameters[skip:], start=skip):
            inward = -1.0 if state.x[k] > (p.low + p.high) / 2 else 1.0
            if p.effect.drives and not now.rubs:  # with friction, rows depend on all joint values before
                joints = self._joint_slopes(now, state.registration, predicted) if joints is None else joints
                moved = self.setup(_nudged(state.x, k, inward * STEP * p.scale))
                change = np.hstack(self.joints(moved)) - np.hstack(self.joints(now))
                change /= inward * STEP * p.scale
                # Minus: residuals are measured less predicted.
                out[..., k] = -np.einsum("vaj,vj->va", joints, change[self.row])
                continue
            for step in (inward * STEP * p.scale, -inward * STEP * p.scale):
                try:
                    shifted = self.predicted(ParameterState(_nudged(state.x, k, step), state.registration))
                except (InputError, SolveError):
                    continue
                out[..., k] = (predicted - shifted) / step
                break
        out[..., count:] = -self._registration_slope(state, predicted)
        return out

    @property
    def bounds(self) -> Array:
        """(2, P) least and greatest value of every parameter."""
        return np.array([[p.low, p.high] for p in self.parameters]).reshape(-1, 2).T

    def costly(self, state: ParameterState[Registration]) -> bool:
        """True if derivatives need a pass along all rows for every parameter, or for many."""
        many = any(p.effect.random for p in self.parameters)
        return many or (self.setup(state.x).rubs and bool(self.timeline.runs))

    def _joint_slopes(self, setup: Setup, motion: Registration, predicted: Array) -> Array:
        """(V, 3, 2 n) derivatives of the observations by the joint values of their row.

        Tubes of one carriage share equally.
        """
        alpha, shift = self.joints(setup)
        n = alpha.shape[1]
        out = np.zeros((*predicted.shape, 2 * n))
        carriages = self.robot.moving_together
        moves = [((i,), 0) for i in range(n)] + [(tubes, n) for tubes in carriages]
        for tubes, block in moves:
            for step in (-JOINT_STEP, JOINT_STEP):
                moved = [alpha.copy(), shift.copy()]
                moved[block > 0][:, list(tubes)] += step
                try:
                    shifted = self._seen(setup, self.poses(setup, (moved[0], moved[1])), motion)
                except (InputError, SolveError):
                    continue
                out[..., [block + i for i in tubes]] = ((shifted - predicted) / step / len(tubes))[..., None]
                break
        return out

    def _registration_slope(self, state: ParameterState[Registration], predicted: Array) -> Array:
        """(V, 3, F) derivatives of the predictions by the registration's freedoms."""
        out = np.zeros((*predicted.shape, self.freedoms))
        for k in range(self.freedoms):
            rotation, shift = state.registration.rates(k)
            lever = np.where(
                self.directed[:, None],
                predicted,
                predicted + state.registration.rotation.T @ state.registration.translation,
            )
            out[..., k] = np.cross(rotation, lever) + np.where(self.directed[:, None], 0.0, shift)
        return out


def _nudged(x: Array, k: int, step: float) -> Array:
    """Copy of a vector x with its number k increased by `step`."""
    moved = x.copy()
    moved[k] += step
    return moved
