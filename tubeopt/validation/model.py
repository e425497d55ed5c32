"""What the sensors should see of a robot with given parameters, and how far they see something else."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..equilibrium.readings import yielded
from ..errors import ImplausibleWarning, InputError, SolveError, choice
from ..robots.concentric import friction_of
from ..robots.robot import Robot
from ..typing import Array, Mask
from .measurements import Measurements
from .parameters import Parameter, apply
from .poses import Poses, rubbed_poses, solve_poses
from .registration import FREEDOMS, SENSOR_FRAME, BasePose, Directions, Registration, register
from .setup import Setup
from .timeline import Timeline, middles_of

STEP = 2e-6
"""Step, in units of a parameter's scale, of the difference quotients: the quotients are as exact as it is small, a few
1e-6, and equilibria are solved a thousand times as sharply."""

CLEARLY, SEEN = 0.9, 1e-9
"""Errors below this share of others, and by more than so many m, are clearly smaller: no noise of a fit by turns."""

JOINT_STEP = 1e-6
"""The same of joint values, rad and m."""

TURNS = 3
"""Turns to each side of the calibrated motion in which the begin of a recording is searched."""

AXES = np.vstack([np.eye(3), -np.eye(3)])
"""Directions along which a sensor may lie in its own frame."""


@dataclass(frozen=True, eq=False)
class State:
    """Parameters x (P,) and where the device stands."""

    x: Array
    registration: Registration

    def moved(self, step: Array) -> State:
        """The state after a step: of the parameters, then of the registration's freedoms."""
        count = len(self.x)
        return State(self.x + step[:count], self.registration.moved(step[count:]))


class ArmModel:
    """Observations, three numbers each: positions of stations (m), then directions of the tip's sensor (unit vectors).

    Args:
        robot, measurements: as given.   parameters: that x holds.
        method, base: of the registration, as for `register`.

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
    ) -> None:
        self.robot, self.measurements, self.parameters = robot, measurements, tuple(parameters)
        self.method, self.base = choice("registration", method, FREEDOMS), base
        self.freedoms = FREEDOMS[self.method]
        self.first = Setup.of(robot)
        self.timeline = Timeline.of(measurements)
        self.first.drives, self.turns = middles_of(self.first.drives, measurements)
        self.stations = measurements.stations
        self.evaluations = 0
        self._solved: list[tuple[Setup, Array, Array, Poses]] = []
        self._gave_way: list[tuple[Setup, Array, Array, Array]] = []
        self._count_turns()
        poses = self.poses(self.first)
        self.failures = poses.failures
        if not poses.found.any():
            row, reason = poses.failures[0]
            raise SolveError(f"row {row + 1}: {reason}")
        self.length = float(poses.length[poses.found].max())
        self._observe(poses)

    def _count_turns(self) -> None:
        """Choose from which turn each rotation counts, where a gain of its drive makes that matter.

        The recording of the calibration counts as it did there. In others a counter stands as it was read, unless
        another turn halves the errors: then it was set to zero elsewhere. Wrapped angles take the turn that fits
        clearly better than the one of the first row. Turns are changed one at a time, the one that helps most first.
        """
        m, saved = self.measurements, self.first.drives.registration
        if saved is not None and saved.recording == m.mark:
            return
        beside, wrapped = self.turns, np.array(m.wrapped or (False,) * m.n_tubes)
        gained = np.flatnonzero(np.array(self.first.drives.rotation_gains) != 1.0).tolist()
        moves = [(k, beside[k] + turn) for k in gained for turn in range(-TURNS, TURNS + 1)]
        fitting, least = np.zeros(m.n_tubes), self._misfit(np.zeros(m.n_tubes)) if moves else 0.0
        as_read = least
        while moves:
            tried = [np.where(np.arange(m.n_tubes) == k, turns, fitting) for k, turns in moves]
            misfits = [self._misfit(turns) for turns in tried]
            if min(misfits) > min(CLEARLY * least, least - SEEN):
                break
            fitting, least = tried[int(np.argmin(misfits))], min(misfits)
        known = np.where(wrapped, fitting, 0.0)
        self.turns = fitting if least < self._misfit(known) / 2 else known
        if fitting.any():
            words = " and ".join(f"{-360 * fitting[k]:+.0f} deg of rotation_{k + 1}" for k in np.flatnonzero(fitting))
            counted = "so they are counted"
            if not np.array_equal(self.turns, fitting):
                kept = [f"rotation_{k + 1}" for k in np.flatnonzero(self.turns != fitting)]
                counted = f"{' and '.join(kept)} counts as read, since errors are not halved"
            remark = (
                f"readings fit best with {words}: {least * 1e3:.2f} mm instead of {as_read * 1e3:.2f} mm "
                f"(root mean square); {counted}"
            )
            self.measurements = replace(m, remarks=(*m.remarks, remark))

    def _misfit(self, turns: Array) -> float:
        """Root mean square distance (m) of the positions from those without friction, where rotations count from
        `turns` (n,); infinite where there is none."""
        self.turns, setup = turns, self.first.copy()
        setup.friction[:] = 0.0
        try:
            with warnings.catch_warnings(action="ignore", category=ImplausibleWarning):  # of turns that are tried
                poses = self.poses(setup)
            self._observe(poses)
            apart = self.observed - self._seen(setup, poses, self.start.registration)
        except (InputError, SolveError):
            return math.inf
        return float(np.sqrt((apart[~self.directed] ** 2).sum(1).mean()))

    def _observe(self, poses: Poses) -> None:
        """Lay out what was measured."""
        positions = self.measurements.station_position
        seen = np.isfinite(positions[..., 0]) & poses.found[:, None] & np.isfinite(poses.position[..., 0])
        rows, stations = np.nonzero(seen)
        predicted, pointing = self._placed(self.first, poses)
        m, registration = self.measurements, self._register(positions[seen], predicted[seen])
        self.axis = self._sensor_axis(poses, pointing, registration)
        parts, row, station = [positions[rows, stations]], [rows], [stations]
        frames = m.orientation
        if frames is not None and self.axis is not None:
            directed = np.flatnonzero(np.isfinite(frames).all((1, 2)) & poses.found)
            parts.append(frames[directed] @ self.axis)
            row.append(directed)
            station.append(np.full(len(directed), -1))
            directions = Directions(parts[1], pointing[directed])
            registration = self._register(positions[seen], predicted[seen], directions)
        self.observed, self.row, self.station = np.concatenate(parts), np.concatenate(row), np.concatenate(station)
        self.start = State(np.array([p.start for p in self.parameters]), registration)

    def _register(self, measured: Array, predicted: Array, directions: Directions | None = None) -> Registration:
        """The registration by closed form, or that of the calibration."""
        if self.method != "saved":
            return register(measured, predicted, self.method, base=self.base, directions=directions)
        saved = self.first.drives.registration
        if saved is None:
            raise InputError("registration is 'saved', but the robot's calibration has none; fit with rigid first")
        return Registration.of_saved(saved)

    def registered(self, state: State, noise: tuple[float | None, float | None]) -> State:
        """The state with the registration that fits its shapes best; `noise` as for `Directions`."""
        if self.method in ("none", "saved"):
            return state
        setup, a = self.setup(state.x), self.directed
        placed = self._placed(setup, self.poses(setup))
        directions = Directions(self.observed[a], placed[1][self.row[a]], noise)
        found = self._register(self.observed[~a], placed[0][self.row[~a], self.station[~a]], directions)
        return State(state.x, found)

    @property
    def directed(self) -> Mask:
        """(V,) which observations are directions."""
        return np.asarray(self.station < 0)

    def _sensor_axis(self, poses: Poses, pointing: Array, registration: Registration) -> Array | None:
        """The direction along the tube in the sensor's frame: as the recording or the calibration gives it, or the one
        of AXES that fits best."""
        m, known = self.measurements, self.first.drives.sensor_axis
        if m.orientation is None or m.sensor_axis is not None:
            return m.sensor_axis
        if known:
            return np.array(known)
        seen = np.isfinite(m.orientation).all((1, 2)) & poses.found
        if not seen.any():
            return None
        tangent = pointing[seen] @ registration.rotation
        alike = np.einsum("ka,nba,nb->k", AXES, m.orientation[seen], tangent)
        return np.asarray(AXES[int(np.argmax(alike))])

    def with_parameters(self, parameters: Sequence[Parameter]) -> ArmModel:
        """The same observations with other parameters in x; what was solved is kept."""
        other = object.__new__(ArmModel)
        other.__dict__.update(self.__dict__)
        other.parameters = tuple(parameters)
        other.start = State(np.array([p.start for p in parameters]), self.start.registration)
        return other

    # --- what a state predicts ----------------------------------------------------------------------------------------

    def setup(self, x: Array) -> Setup:
        """All numbers at parameters x."""
        return apply(self.first, self.parameters, x)

    def joints(self, setup: Setup) -> tuple[Array, Array]:
        """(N, n) joint values of the model, rad and m."""
        drives = setup.drives
        alpha, shift = self.timeline.driven(drives, self.turns)
        if not any(drives.translation_compliance):
            return alpha, shift
        return alpha, self._yielded(setup, alpha, shift)

    def _yielded(self, setup: Setup, alpha: Array, shift: Array) -> Array:
        """(N, n) translations of carriages that yield, remembered for the last setups, of which the first is the start.

        Tubes that rub carry the friction among themselves; to the carriages they are tubes that do not.
        """
        for told, *given, found in self._gave_way:
            yields_alike = told.drives.translation_compliance == setup.drives.translation_compliance
            if yields_alike and told.same_tubes(setup) and np.array_equal(given, [alpha, shift]):
                return found
        near = None
        if self._gave_way:
            _, _, before, there = self._gave_way[0]
            near = there + shift - before
        found = yielded(setup.robot(self.robot), alpha, shift, np.array(setup.drives.translation_compliance), near)
        self._gave_way[:] = [(setup.copy(), alpha, shift, found), *self._gave_way[:2]]
        return found

    def poses(self, setup: Setup, joints: tuple[Array, Array] | None = None, *, margins: bool = False) -> Poses:
        """Equilibria of every row, at its own joint values or at others; the last few are remembered.

        Along a way with friction `margins` are known of all only where they are asked for.

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
            poses = rubbed_poses(robot, (alpha, shift), self.stations, runs, friction, margins=margins)
        if joints is None:
            self._solved[:] = [(setup.copy(), alpha, shift, poses), *self._solved[:2]]
        return poses

    def _placed(self, setup: Setup, poses: Poses) -> tuple[Array, Array]:
        """Stations (N, K, 3), with the sensor where it sits, and directions (N, 3), in the plate frame."""
        stations = poses.position.copy()
        stations[:, 0] += poses.frame @ setup.sensor_offset
        x, y = setup.sensor_tilt
        direction = poses.frame @ np.array([np.sin(y) * np.cos(x), -np.sin(x), np.cos(y) * np.cos(x)])
        turn = setup.plate_turn
        return stations @ turn.T + setup.plate_shift, direction @ turn.T

    def predicted(self, state: State) -> Array:
        """(V, 3) of what the device should see.

        Raises:
            InputError: there is no such robot.
            SolveError: a row that was solved at the start has no stable equilibrium.
        """
        setup = self.setup(state.x)
        return self._seen(setup, self.poses(setup), state.registration)

    def _seen(self, setup: Setup, poses: Poses, motion: Registration) -> Array:
        stations, direction = self._placed(setup, poses)
        out = np.empty_like(self.observed)
        a = self.directed
        out[~a] = (stations[self.row[~a], self.station[~a]] - motion.translation) @ motion.rotation
        out[a] = direction[self.row[a]] @ motion.rotation
        if not np.isfinite(out).all():
            row = int(self.row[np.argmax(~np.isfinite(out).all(1))])
            raise SolveError(f"row {row + 1} has no stable equilibrium")
        return out

    def residuals(self, state: State) -> Array:
        """(V, 3) measured minus predicted, in the device's frame: m, and unit vectors; raises as `predicted`."""
        return self.observed - self.predicted(state)

    def jacobian(self, state: State, skip: int = 0) -> Array:
        """(V, 3, P + F) derivatives of `residuals` by the parameters and by the freedoms of the registration.

        Difference quotients, in scaled steps towards the middle of each range; a step to where there is no robot is
        taken the other way, and a parameter that cannot be changed either way gets a column of 0. All parameters of the
        drives share the derivatives by the joint values. The columns of the first `skip` parameters are left at 0.
        """
        here = self.predicted(state)
        count = len(self.parameters)
        out = np.zeros((*here.shape, count + self.freedoms))
        now = self.setup(state.x)
        joints: Array | None = None
        for k, p in enumerate(self.parameters[skip:], start=skip):
            inward = -1.0 if state.x[k] > (p.low + p.high) / 2 else 1.0
            if p.effect.drives and not now.friction.any():  # with friction, rows depend on all joint values before
                joints = self._joint_slopes(now, state.registration, here) if joints is None else joints
                moved = self.setup(_nudged(state.x, k, inward * STEP * p.scale))
                change = np.hstack(self.joints(moved)) - np.hstack(self.joints(now))
                change /= inward * STEP * p.scale
                out[..., k] = -np.einsum("vaj,vj->va", joints, change[self.row])
                continue
            for step in (inward * STEP * p.scale, -inward * STEP * p.scale):
                try:
                    there = self.predicted(State(_nudged(state.x, k, step), state.registration))
                except (InputError, SolveError):
                    continue
                out[..., k] = (here - there) / step
                break
        out[..., count:] = -self._registration_slope(state, here)
        return out

    @property
    def bounds(self) -> Array:
        """(2, P) least and greatest value of every parameter."""
        return np.array([[p.low, p.high] for p in self.parameters]).reshape(-1, 2).T

    def costly(self, state: State) -> bool:
        """Whether the derivatives at a state take a way along all rows for every parameter."""
        return bool(self.setup(state.x).friction.any()) and bool(self.timeline.runs)

    def _joint_slopes(self, setup: Setup, motion: Registration, here: Array) -> Array:
        """(V, 3, 2 n) of what is seen by the joint values of its row; tubes of one carriage share theirs equally."""
        alpha, shift = self.joints(setup)
        n = alpha.shape[1]
        out = np.zeros((*here.shape, 2 * n))
        carriages = self.robot.moving_together
        moves = [((i,), 0) for i in range(n)] + [(tubes, n) for tubes in carriages]
        for tubes, block in moves:
            for step in (-JOINT_STEP, JOINT_STEP):
                moved = [alpha.copy(), shift.copy()]
                moved[block > 0][:, list(tubes)] += step
                try:
                    there = self._seen(setup, self.poses(setup, (moved[0], moved[1])), motion)
                except (InputError, SolveError):
                    continue
                out[..., [block + i for i in tubes]] = ((there - here) / step / len(tubes))[..., None]
                break
        return out

    def _registration_slope(self, state: State, here: Array) -> Array:
        """(V, 3, F) of what is predicted by the registration's freedoms."""
        out = np.zeros((*here.shape, self.freedoms))
        for k in range(self.freedoms):
            turn, shift = state.registration.rates(k)
            lever = np.where(
                self.directed[:, None], here, here + state.registration.rotation.T @ state.registration.translation
            )
            out[..., k] = np.cross(turn, lever) + np.where(self.directed[:, None], 0.0, shift)
        return out


def _nudged(x: Array, k: int, step: float) -> Array:
    """x with one of its numbers changed."""
    moved = x.copy()
    moved[k] += step
    return moved
