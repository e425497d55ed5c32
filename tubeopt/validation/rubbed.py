"""Where a robot's tip and stations are on its way, with friction between the tubes: every row from the one before."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..block.transcription.arm import Arm
from ..block.transcription.whole_arm import evaluate_arm
from ..equilibrium.friction import Held, sweep, swept, to_held_equilibrium
from ..errors import InputError, SolveError
from ..robots.friction import Friction
from ..robots.robot import Robot
from ..solvers.compiled.rubbing import Rubbed
from ..stability.rubbing_following import rubbing_leg, rubbing_start
from ..typing import Array, Index
from .poses import Poses, about_z, loose, stations_of, tilt


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
        arm, poses = _arm(held), self.poses
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
        return np.asarray(np.argmax(translations + [tube.curved_length for tube in self.robot.tubes], axis=-1))


def _arm(held: Held) -> Arm:
    return evaluate_arm(held.contact.problem, held.rotations, held.found.state.torsion, held.profile)


def with_torque(friction: Friction | None, torque: Array) -> Friction | None:
    """A friction with other torques per length (n - 1,), N m per m; None where nothing rubs."""
    changed = replace(friction or Friction(), torque=tuple(torque.tolist()) or (0.0,))
    return None if changed.trivial else changed
