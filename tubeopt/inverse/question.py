"""From what a caller gives to a checked question."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from ..equilibrium import Equilibrium
from ..errors import InputError, finite, vector
from ..kinematics import forward_kinematics
from ..obstacles import Obstacle
from ..robots.assembly import Array
from ..robots.limits import JointLimits
from ..robots.robot import Robot
from .answer import InverseOptions
from .goal import Goal
from .joints import Configuration, JointSpace, configuration, joint_space, scaled_weights
from .posture import Posture, posture_of


@lru_cache(maxsize=32)
def prepared(robot: Robot, limits: JointLimits | None, carriage_gap: float, section_length: float) -> JointSpace:
    """The joint space of a robot, made once."""
    return joint_space(robot, limits, carriage_gap=carriage_gap, section_length=section_length)


def pose_question(
    robot: Robot,
    position: ArrayLike,
    direction: ArrayLike | None,
    places: tuple[Configuration | None, Configuration | None],
    min_margin: float,
    limits: JointLimits | None,
    weights: tuple[ArrayLike, ArrayLike] | None,
    obstacles: Sequence[Obstacle],
    options: InverseOptions,
) -> Goal:
    """The question, checked; `places` are seed and reference."""
    target = vector("position", position, 3, "x, y, z in m")
    floor = finite("min_margin", min_margin)
    if not 0 <= floor < 1:
        raise InputError(f"min_margin is {floor:g}; it must be at least 0 and less than 1")
    space = prepared(robot, limits, options.carriage_gap, options.section_length)
    seed, reference = places
    centre = space.middle()
    for name, place in (("seed", seed), ("reference", reference)):
        centre = configuration(space, name, place) if place is not None else centre
    named = seed is not None or reference is not None
    return Goal(
        space=space,
        position=target,
        direction=None if direction is None else unit_vector("direction", direction),
        direction_weight=options.direction_weight,
        min_margin=floor,
        obstacles=tuple(obstacles),
        clearance=options.clearance,
        objective=options.objective or ("nearest" if named else None),
        reference=centre,
        weights=scaled_weights(space, weights),
    )


def unit_vector(name: str, value: ArrayLike) -> Array:
    """`value` (3,) over its length; raises InputError where it has none."""
    array = vector(name, value, 3, "x, y, z")
    length = float(np.linalg.norm(array))
    if length == 0:
        raise InputError(f"{name} is (0, 0, 0); it must have a direction")
    return np.asarray(array / length)


def seed_posture(space: JointSpace, seed: Configuration) -> Posture:
    """The equilibrium of a seed: its own, else that of a cold forward kinematics at its joint values."""
    q = configuration(space, "seed", seed)
    known = seed if isinstance(seed, Equilibrium) else getattr(seed, "equilibrium", None)
    if isinstance(known, Equilibrium) and known.robot == space.robot:
        return posture_of(space, known)
    rotations, shift = space.split(q)
    return posture_of(space, forward_kinematics(space.robot, rotations, shift))
