"""From what a caller gives to a checked question."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ..bodies.obstacles import Obstacle, checked_obstacles
from ..bodies.scene import scene_of
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..errors import InputError, finite, instance, vector
from ..robots.limits import JointLimits
from ..robots.robot import Robot, check_robot
from ..typing import Array
from .extra import extras
from .goal import Goal
from .joints import Configuration, JointSpace, configuration, joint_space, scaled_weights
from .posture import Posture, posture_of
from .settings import DEFAULT_OPTIONS, InverseOptions


def pose_question(
    robot: Robot,
    wanted: tuple[ArrayLike, ArrayLike | None],
    places: tuple[Configuration | None, Configuration | None] = (None, None),
    *,
    min_margin: float = 0.05,
    limits: JointLimits | None = None,
    weights: tuple[ArrayLike, ArrayLike] | None = None,
    obstacles: Sequence[Obstacle] = (),
    options: InverseOptions = DEFAULT_OPTIONS,
) -> Goal:
    """The question, checked; `wanted` are position and direction of the tip, `places` seed and reference."""
    position, direction = wanted
    check_robot(robot)
    instance("options", options, InverseOptions)
    instance("limits", limits, JointLimits, optional=True)
    bodies = checked_obstacles(obstacles)
    target = vector("position", position, 3, "x, y, z in m")
    floor = finite("min_margin", min_margin)
    if not 0 <= floor < 1:
        raise InputError(f"min_margin is {floor:g}; it must be at least 0 and less than 1")
    space = joint_space(robot, limits, options.carriage_gap, options.section_length)
    seed, reference = places
    centre = space.middle()
    for name, place in (("seed", seed), ("reference", reference)):
        centre = configuration(space, name, place) if place is not None else centre
    named = seed is not None or reference is not None
    return Goal(
        space=space,
        position=target,
        direction=None if direction is None else unit_vector("direction", direction),
        min_margin=floor,
        scene=scene_of(bodies),
        objective=options.objective or ("nearest" if named else None),
        named=named,
        reference=centre,
        weights=scaled_weights(space, weights),
        options=options,
        extras=extras(options.extra_cost, options.extra_constraints, robot.n_tubes),
    )


def unit_vector(name: str, value: ArrayLike) -> Array:
    """`value` (3,) over its length; raises InputError where it has none."""
    array = vector(name, value, 3, "x, y, z")
    largest = float(np.abs(array).max())
    if largest == 0:
        raise InputError(f"{name} is (0, 0, 0); it must have a direction")
    # The squares of very large and very small numbers are none.
    array = array / largest
    return np.asarray(array / np.linalg.norm(array))


def seed_posture(space: JointSpace, seed: Configuration) -> Posture:
    """The equilibrium of a seed: its own, else that of a cold forward kinematics at its joint values."""
    q = configuration(space, "seed", seed)
    known = seed if isinstance(seed, Equilibrium) else getattr(seed, "equilibrium", None)
    if isinstance(known, Equilibrium) and known.robot == space.robot:
        return posture_of(space, known)
    rotations, shift = space.split(q)
    return posture_of(space, forward_kinematics(space.robot, rotations, shift))
