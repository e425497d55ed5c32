"""Where a robot's tip and stations along its arm are at many joint values, or on its way where tubes rub."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..block.transcription.arm import Arm, evaluate_arm
from ..equilibrium.batch import EquilibriumBatch, forward_kinematics_batch
from ..equilibrium.clearance import clearance_correction
from ..equilibrium.friction import Held, sweep, swept, to_held_equilibrium
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError
from ..robots.concentric import ConcentricRobot
from ..robots.friction import Friction
from ..robots.order import last_tube
from ..robots.robot import Robot
from ..solvers.compiled.rubbing import Rubbed
from ..stability.friction_path import rubbing_leg, rubbing_start
from ..typing import Array, Index, Mask


@dataclass(frozen=True, eq=False)
class Poses:
    """Stable equilibria of N configurations, each found on its own; NaN where none was. Plate frame, SI."""

    position: Array
    """(N, K, 3) of K stations, the foremost first."""
    frame: Array
    """(N, 3, 3) of the tip of the tube that ends last: its own axes, turned with it."""
    margin: Array
    """(N,), NaN too where it was not asked for."""
    length: Array
    """(N,) of the arm in front of the plate, m."""
    failures: tuple[tuple[int, str], ...]
    """(row, reason in words)."""

    @property
    def found(self) -> Mask:
        """(N,) whether there is an equilibrium."""
        return np.isfinite(self.frame[:, 0, 0])


def solve_poses(
    robot: Robot, rotations: Array, translations: Array, stations: Array, runs: Sequence[Index] = ()
) -> Poses:
    """Poses at joint values (N, n) of the model; stations (K,) behind the tip, m, the foremost first.

    Each row is solved on its own. Along `runs` of rows on end the branch is followed: where a row on its own leads to
    another equilibrium than the one before it, it is solved from there, until both ways agree or the branch ends.

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
    poses = Poses(position, turned @ about_z(theta), margin, np.maximum(reach, 0.0).max(1), failures)
    if stations.any() or loose(robot):
        for k in np.flatnonzero(poses.found).tolist():
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


def rubbed_poses(
    robot: Robot,
    joints: tuple[Array, Array],
    stations: Array,
    runs: Sequence[Index],
    friction: Friction,
    *,
    margins: bool = True,
) -> Poses:
    """Poses at joint values (N, n) of the model along `runs` of rows, of which each begins without a history.

    Rows of a run behind one at which the motion is lost have none; `margins` are not known of all where not asked for.

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
    poses = Poses(position, frame, margin, length, ())
    seen = _Seen(robot, stations, poses)
    for run in runs:
        table, done = np.hstack([alpha[run], shift[run]]), 0
        try:
            held = rubbing_start(robot, table[0], coarse)
            seen.put(run[0], held)
            done = 1
            while done < len(run):
                many = None if loose(robot) else sweep(robot, held, table[done - 1 :], stations, margins=margins)
                if many is not None:
                    count = len(many.margin)
                    seen.put_many(run[done : done + count], shift, many)
                    held, done = swept(robot, held, table[done - 1 :], many, count), done + count
                if done < len(run):  # where the kernel gives up, a step with more care
                    held, _ = rubbing_leg(robot, held, table[done])
                    seen.put(run[done], held)
                    done += 1
        except (InputError, SolveError) as error:
            failures += [(int(row), str(error)) for row in run[done:]]
    return replace(poses, failures=tuple(failures))


@dataclass(frozen=True, eq=False)
class _Seen:
    """Poses of a robot that are filled in."""

    robot: Robot
    stations: Array
    poses: Poses

    def put(self, row: int, held: Held) -> None:
        """One row."""
        problem, poses = held.contact.problem, self.poses
        arm = evaluate_arm(problem, held.rotations, held.found.state.torsion, held.profile)
        poses.length[row], poses.margin[row] = arm.arc_length[-1], held.margin
        poses.position[row] = stations_of(arm, self.stations) if self.stations.any() else arm.position[-1]
        poses.frame[row] = arm.frame[-1] @ about_z(arm.rotation[self._last(held.translations), -1])
        if loose(self.robot):
            tilt(poses, row, to_held_equilibrium(self.robot, held, "way"), self.stations)

    def put_many(self, rows: Index, translations: Array, many: Rubbed) -> None:
        """Rows of the kernel, at translations (N, n) of all."""
        poses, last = self.poses, self._last(translations[rows])
        poses.length[rows], poses.margin[rows], poses.position[rows] = many.length, many.margin, many.stations
        poses.frame[rows] = many.frame @ about_z(many.rotation[np.arange(len(rows)), last])

    def _last(self, translations: Array) -> Index:
        """The tube that ends last, at translations (..., n)."""
        return last_tube(translations + [tube.curved_length for tube in self.robot.tubes])


def loose(robot: Robot) -> bool:
    """Whether the robot is known to have room between its tubes."""
    return isinstance(robot, ConcentricRobot) and bool(np.any(robot.clearance or 0.0))


def tilt(poses: Poses, row: int, shape: Equilibrium, stations: Array) -> None:
    """Put a row where the room between the tubes lets the arm tilt to."""
    tilted = clearance_correction(shape)
    moved, at = tilted.position - shape.position, np.maximum(shape.arc_length[-1] - stations, 0.0)
    poses.position[row] += np.column_stack([np.interp(at, shape.arc_length, along) for along in moved.T])
    poses.frame[row] = tilted.turn @ poses.frame[row]


def _followed(robot: Robot, batch: EquilibriumBatch, run: Index) -> Iterator[tuple[int, Equilibrium]]:
    """Rows of a run at which the branch of the rows before goes on, where the row on its own leads elsewhere."""
    own = batch.tip_rotations[run] - batch.rotations[run]
    driven = np.abs(np.diff(batch.rotations[run], axis=0)).max(1, initial=0.0)
    # A tip that turns against its drive by so much more than any drive turned may be in another equilibrium.
    leaps = np.flatnonzero(np.abs(np.diff(own, axis=0)).max(1, initial=0.0) > 0.5 + 15.0 * driven) + 1
    here, done = None, 0
    for leap in leaps.tolist():
        if leap < done:
            continue
        k = leap
        while k < len(run):
            row, before = int(run[k]), int(run[k - 1])
            try:
                if here is None:
                    here = forward_kinematics(robot, batch.rotations[before], batch.translations[before])
                here = forward_kinematics(robot, batch.rotations[row], batch.translations[row], start=here)
            except SolveError:
                break  # the branch ends: the robot snaps to what the row alone leads to
            if not here.stable or (np.abs(here.tip_rotations - batch.tip_rotations[row]) < 1e-3).all():
                break
            yield row, here
            k += 1
        here, done = None, k + 1


def about_z(angle: ArrayLike) -> Array:
    """(..., 3, 3) turns about z."""
    turn = np.zeros((*np.shape(angle), 3, 3))
    turn[..., 0, 0] = turn[..., 1, 1] = np.cos(angle)
    turn[..., 1, 0], turn[..., 0, 1] = np.sin(angle), -np.sin(angle)
    turn[..., 2, 2] = 1.0
    return turn


def stations_of(shape: Equilibrium | Arm, stations: Array) -> Array:
    """(K, 3) positions of stations behind the tip; on the plate's axis where they are behind the plate."""
    at, kept = shape.arc_length[-1] - stations, np.append(True, np.diff(shape.arc_length) > 0)
    line = scipy.interpolate.CubicHermiteSpline(shape.arc_length[kept], shape.position[kept], shape.frame[kept, :, 2])
    out: Array = line(np.maximum(at, 0.0))
    out[:, 2] += np.minimum(at, 0.0)
    return out


def _by_row(robot: Robot, rotations: Array, translations: Array, error: InputError) -> InputError:
    """The complaint about the first row that the robot cannot take, in the words of a single configuration."""
    for k in range(len(rotations)):
        try:
            robot.assembly(translations[k])
        except InputError as own:
            return InputError(f"row {k + 1}: {own}")
    return error
