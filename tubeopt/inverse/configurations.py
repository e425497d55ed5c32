"""Configurations: joint values as callers give them, and what distances between them weigh."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import numpy as np

from ..errors import InputError, vector
from ..robots.limits import check_turn
from ..robots.robot import Robot
from ..typing import Array
from .joints import JointSpace

Configuration = Any
"""A pair (rotations, translations), or anything with these attributes: an Equilibrium, an InverseSolution."""


def parts(name: str, value: Configuration) -> tuple[Any, Any]:
    """Rotations and translations of a configuration as they are given; raises InputError naming it where it is none."""
    if hasattr(value, "rotations") and hasattr(value, "translations"):
        return value.rotations, value.translations
    try:
        rotations, translations = value
    except (TypeError, ValueError):
        raise InputError(
            f"{name} is {value!r}; it must be a pair (rotations, translations), an Equilibrium or an InverseSolution"
        ) from None
    return rotations, translations


def configuration(space: JointSpace, name: str, value: Configuration) -> Array:
    """(m,) joint values of a configuration; raises InputError naming it where it is none."""
    rotations, translations = parts(name, value)
    n = space.robot.n_tubes
    alpha = vector(f"rotations of {name}", rotations, n)
    home = space.robot.home_translations if translations is None else translations
    shift = vector(f"translations of {name}", home, n)
    check_turn(alpha)
    space.robot.assembly(shift)
    return space.join(alpha, shift, name)


def joints_of(space: JointSpace, name: str, value: Configuration) -> tuple[Array, tuple[float, ...]]:
    """Rotations and translations (n,) of a configuration, as its joint space has them; raises as `configuration`."""
    q = configuration(space, name, value)
    return space.split(q)


def shift_of(robot: Robot, *places: Any) -> list[Array]:
    """(n,) translations, m, of each place that is a configuration, so far as it makes sense; a tip pose has none."""
    found = []
    for place in places:
        if isinstance(place, tuple | list) and len(place) == 2:
            shift = robot.home_translations if place[1] is None else place[1]
        else:
            shift = getattr(place, "translations", ())
        with suppress(TypeError, ValueError):
            row = np.array(shift, dtype=float)
            if row.shape == (robot.n_tubes,):
                found.append(row)
    return found


def scaled_weights(space: JointSpace, weights: Any) -> Array:
    """(m,) weights of the joints in a distance: given per rad and per m, else one over the scale of each."""
    if weights is None:
        return 1 / space.scale
    n = space.robot.n_tubes
    try:
        turn, shift = weights
    except (TypeError, ValueError):
        raise InputError(
            "weights must be a pair: for rotations (n,), per rad, and for translations (n,), per m"
        ) from None
    values = [vector(f"weights of {what}", value, n) for what, value in (("rotations", turn), ("translations", shift))]
    if min(value.min() for value in values) < 0:
        raise InputError("weights must be at least 0")
    together = [float(np.sqrt((values[1][list(tubes)] ** 2).sum())) for tubes in space.carriages]
    return np.concatenate([values[0], together])
