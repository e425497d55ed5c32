"""Arguments that are of another kind than what is asked for."""

from __future__ import annotations

from typing import Any

from ..bodies.obstacles import Obstacle
from ..errors import InputError
from ..robots.limits import JointLimits


def check_robot(robot: Any, limits: Any) -> None:
    """Raise InputError for what is no robot, or no joint limits (None is those of the robot)."""
    if not hasattr(robot, "n_tubes") or not hasattr(robot, "assembly"):
        raise InputError(f"robot is {robot!r}; it must be a ConcentricRobot, an EccentricRobot, or the like")
    if limits is not None:
        kind_of("limits", limits, JointLimits)


def checked_obstacles(obstacles: Any) -> tuple[Obstacle, ...]:
    """The obstacles as a tuple; raises InputError for what is no sequence of bodies."""
    try:
        bodies = tuple(obstacles)
    except TypeError:
        raise InputError(
            f"obstacles is {obstacles!r}; it must be a sequence of bodies, such as [Sphere(...)]"
        ) from None
    for k, body in enumerate(bodies):
        if not hasattr(body, "signed_distance"):
            raise InputError(f"obstacle {k + 1} is {body!r}; it must be a body of tubeopt.bodies")
    return bodies


def kind_of(name: str, value: Any, kind: type) -> None:
    """Raise InputError where a value is not of a class."""
    if not isinstance(value, kind):
        raise InputError(f"{name} is {value!r}; it must be of class {kind.__name__}")
