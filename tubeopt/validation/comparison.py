"""Measured tips beside predicted ones."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError
from ..robots.robot import Robot
from ..typing import Array
from .errors import ErrorGroup, ErrorSummary, group_errors
from .measurements import Measurements
from .registration import SENSOR_FRAME, BasePose, Registration, register

Progress = Callable[[int, int], object]
"""Called with how many shapes are solved, and how many there are to solve."""


@dataclass(frozen=True, eq=False)
class Validation:
    """Measured against predicted tips of N configurations, both in the plate frame. SI units.

    Attributes:
        robot, measurements: the input.
        registration: how measured points came into the plate frame.
        measured, predicted: (N, 3) tips, m.
        margin: (N,) stability margin of the predicted shapes.
        length: greatest arc length of the arm in front of the plate, m: what percentages refer to.
    """

    robot: Robot
    measurements: Measurements
    registration: Registration
    measured: Array
    predicted: Array
    margin: Array
    length: float

    @property
    def residuals(self) -> Array:
        """(N, 3) measured minus predicted, m."""
        return self.measured - self.predicted

    @property
    def errors(self) -> Array:
        """(N,) distances between measured and predicted tips, m."""
        return np.asarray(np.linalg.norm(self.residuals, axis=1))

    @property
    def summary(self) -> ErrorSummary:
        """Of all errors."""
        return ErrorSummary.of(self.errors)

    @property
    def by_direction(self) -> tuple[ErrorGroup, ...]:
        """Errors of each direction; empty where the measurements name none."""
        return group_errors(self.measurements.direction, self.errors)

    @property
    def by_separation(self) -> tuple[ErrorGroup, ...]:
        """Errors of each separation; empty where the measurements name none."""
        return group_errors(self.measurements.separation, self.errors)


def validate(
    robot: Robot,
    measurements: Measurements,
    *,
    registration: str = "rigid",
    base: BasePose = SENSOR_FRAME,
    progress: Progress | None = None,
) -> Validation:
    """Compare measured tips with the tips that the model predicts at the same joint values.

    Every configuration is solved for a stable equilibrium on its own, from tubes without torsion. A robot that can snap
    may have been measured in another one; its margin tells which configurations are in doubt.

    Args:
        registration: "rigid" (rotation and translation by least squares), "base-axis" (base and axis given by `base`,
            only the yaw about the axis by least squares) or "none"; see `register`.
        progress: called with the number of shapes solved and of all.

    Raises:
        InputError: measurements of another number of tubes, joint values out of range (naming the row), a registration
            that the data leave undetermined.
        SolveError: no stable shape was found for a row.
    """
    shapes = predict(robot, measurements, progress=progress)
    predicted = np.array([shape.tip_position for shape in shapes])
    motion = register(measurements.tip_position, predicted, registration, base=base)
    return Validation(
        robot=robot,
        measurements=measurements,
        registration=motion,
        measured=motion.apply(measurements.tip_position),
        predicted=predicted,
        margin=np.array([shape.margin for shape in shapes]),
        length=max(float(shape.arc_length[-1]) for shape in shapes),
    )


def predict(
    robot: Robot,
    measurements: Measurements,
    *,
    guesses: Sequence[Equilibrium] | None = None,
    progress: Progress | None = None,
) -> list[Equilibrium]:
    """The stable equilibrium of every row of measurements, started from `guesses` where these lead to one.

    Raises:
        InputError, SolveError: as `validate` does.
    """
    if measurements.n_tubes != robot.n_tubes:
        raise InputError(f"the measurements are of {measurements.n_tubes} tubes; the robot has {robot.n_tubes}")
    shapes = []
    for k in range(len(measurements)):
        try:
            shapes.append(_shape(robot, measurements, k, None if guesses is None else guesses[k]))
        except InputError as error:
            raise InputError(f"row {k + 1}: {error}") from None
        except SolveError as error:
            raise SolveError(f"row {k + 1}: {error}", error.solution) from error
        if progress is not None:
            progress(k + 1, len(measurements))
    return shapes


def _shape(robot: Robot, measurements: Measurements, k: int, guess: Equilibrium | None) -> Equilibrium:
    rotations, translations = measurements.rotations[k], measurements.translations[k]
    if guess is not None:
        try:
            shape = forward_kinematics(robot, rotations, translations, guess=guess)
        except SolveError:
            pass  # the branch of the guess ends: begin anew
        else:
            if shape.stable:
                return shape
    return forward_kinematics(robot, rotations, translations)
