"""What is given to a block: joint values and dimensions of the tubes, as numbers or as expressions of a program."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from ..errors import InputError, nearest
from ..robots.assembly import Assembly
from ..robots.breakpoints import DIMENSIONS, dimensions_of, places
from ..robots.tubes import must_be_plain
from ..typing import Array

if TYPE_CHECKING:
    from ..equilibrium.result import Equilibrium

LENGTHS = ("translations", "straight_length", "curved_length")
"""What moves breakpoints."""


@dataclass(frozen=True, eq=False)
class Given:
    """Joint values and DIMENSIONS of n tubes by name, (n,) each: `values` as expressions or numbers, `start` the
    numbers where a solve begins."""

    values: dict[str, Any]
    start: dict[str, Array]

    def free(self, *names: str) -> bool:
        """Whether any of these is an expression."""
        return any(symbolic(self.values[name]) for name in names)


def symbolic(value: Any) -> bool:
    """Whether a value is an expression of CasADi."""
    return isinstance(value, (ca.SX, ca.MX))


def given_of(near: Equilibrium, rotations: Any, translations: Any, tubes: Mapping[str, Any]) -> Given:
    """What a block is given; None stands for that of `near`.

    Raises:
        InputError: an unknown name, or a vector of the wrong length or without meaning.
    """
    for name in tubes:
        if name not in DIMENSIONS:
            known = ", ".join(DIMENSIONS)
            raise InputError(f"tubes names {name!r}; it may name {known}{nearest(str(name), DIMENSIONS)}")
    robot = near.robot
    must_be_plain(robot.tubes, "an equilibrium block")
    start = {"rotations": near.rotations, "translations": near.translations, **dimensions_of(robot.tubes)}
    wanted = {"rotations": rotations, "translations": translations, **tubes}
    values: dict[str, Any] = {}
    for name, otherwise in start.items():
        carriages = robot.moving_together if name != "rotations" else tuple((i,) for i in range(robot.n_tubes))
        values[name] = _column(name, wanted.get(name), otherwise, carriages)
        if not symbolic(values[name]):
            start[name] = np.array(values[name]).ravel()
    return Given(values, start)


def _column(name: str, value: Any, otherwise: Array, carriages: tuple[tuple[int, ...], ...]) -> Any:
    """An (n,) column of numbers or an expression; of tubes that are equal and move together one entry tells all."""
    n = sum(len(tubes) for tubes in carriages)
    if value is None:
        return ca.DM(otherwise)
    if isinstance(value, (list, tuple)) and any(symbolic(entry) for entry in value):
        value = ca.vertcat(*value)
    if symbolic(value):
        entries = value.numel()
        if entries != len(carriages):
            each = "tube" if len(carriages) == n else "segment, whose tubes are equal and move together"
            raise InputError(f"{name} has {entries} entries; it must have {len(carriages)}, one per {each}")
        column = ca.vec(value)
        return ca.vertcat(*(column[k] for k, tubes in enumerate(carriages) for _ in tubes)) if entries < n else column
    try:
        numbers = np.asarray(value, dtype=float).ravel()
    except (TypeError, ValueError):
        raise InputError(f"{name} is {value!r}; it must be numbers or an expression of the program") from None
    if numbers.shape != (n,) or not np.isfinite(numbers).all():
        raise InputError(f"{name} is {numbers.tolist()}; it must be {n} finite numbers, one per tube")
    return ca.DM(numbers)


def assembly_at(assembly: Assembly, numbers: Mapping[str, Array]) -> Assembly:
    """A bundle with other joint values and dimensions, not cut into sections: `layout` does that."""
    transmission, transition, end = places(*(numbers[name] for name in LENGTHS))
    return replace(
        assembly,
        bending_stiffness=numbers["bending_stiffness"],
        torsional_stiffness=numbers["torsional_stiffness"],
        curvature=numbers["curvature"],
        transmission=transmission,
        transition=transition,
        end=end,
    )
