"""Arguments that are of another kind than what is asked for."""

from __future__ import annotations

from typing import Any

from ..bodies.obstacles import Obstacle
from ..errors import InputError


def check_robot(robot: Any) -> None:
    """Raise InputError for what is no robot."""
    if not hasattr(robot, "n_tubes") or not hasattr(robot, "assembly"):
        raise InputError(f"robot is {robot!r}; it must be a ConcentricRobot, an EccentricRobot, or the like")


def checked_obstacles(obstacles: Any) -> tuple[Obstacle, ...]:
    """The obstacles as a tuple; raises InputError for what is no sequence of bodies."""
    try:
        bodies = tuple(obstacles)
    except TypeError:
        raise InputError(f"obstacles is {obstacles!r}; it must be a sequence of bodies, as [Sphere(...)]") from None
    for k, body in enumerate(bodies):
        if not hasattr(body, "signed_distance"):
            raise InputError(f"obstacle {k + 1} is {body!r}; it must be a body of tubeopt.bodies")
    return bodies


def kind_of(name: str, value: Any, kind: type, *, optional: bool = False) -> None:
    """Raise InputError where a value is not of a class; where it is optional, None will do."""
    if not (isinstance(value, kind) or (optional and value is None)):
        raise InputError(f"{name} is {value!r}; it must be of class {kind.__name__}")
