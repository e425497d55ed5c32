"""Dry friction between neighbouring tubes, as a torque that each pair can bear before it slips."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

from ..arguments import typed
from ..display import Displayed
from ..errors import InputError, numbers, positive
from ..files.field_metadata import BETWEEN_TUBES, NOT_NEGATIVE, Range, Typical, check_size, check_usual, unit

PAIRWISE = ("torque", "plate", "jumps", "ends")
"""What a friction holds for every pair of neighbours."""


@typed
@dataclass(frozen=True)
class Friction(Displayed):
    """Coulomb friction of every tube in the next one, inner to outer: n - 1 numbers each, or one number for all pairs.

    The torque about the tubes' axis is limited by the capacities here: N m per m of length, and N m at points. A
    slipping contact has the same torque at any speed.

    Raises:
        InputError: a number that is not finite or below 0, or tables of different length.
    """

    torque: Annotated[
        float | tuple[float, ...],
        unit("mN_m_per_m"),
        NOT_NEGATIVE,
        Typical(1e-5, 1.0),
        "friction torque per length, in front of the base plate where both tubes of a pair are present",
    ] = 0.0
    plate: Annotated[
        float | tuple[float, ...],
        unit("mN_m"),
        NOT_NEGATIVE,
        Typical(1e-6, 0.1),
        "friction torque at the base plate, for all friction behind it",
    ] = 0.0
    jumps: Annotated[
        float | tuple[float, ...],
        unit("mN_m"),
        NOT_NEGATIVE,
        Typical(1e-6, 0.1),
        "friction torque where the precurvature of one of the two tubes changes abruptly",
    ] = 0.0
    ends: Annotated[
        float | tuple[float, ...],
        unit("mN_m"),
        NOT_NEGATIVE,
        Typical(1e-6, 0.1),
        "friction torque at the end of the outer tube of a pair",
    ] = 0.0
    sliding: Annotated[
        bool,
        "axial sliding reduces the friction torque; the friction radius is the outer radius of the inner tube",
    ] = False
    refinement: Annotated[
        int,
        Range(least=-2, most=4),
        "number of mesh bisections, for a sharper boundary between slip and stick; -1 and "
        "-2 coarsen the mesh and save time",
    ] = 0

    def __post_init__(self) -> None:
        for name in PAIRWISE:
            values = tuple(positive(f"{name} of friction", x, zero=True) for x in numbers(name, getattr(self, name)))
            if not values:
                raise InputError(f"{name} of friction is empty; it must be one number, or one for every pair of tubes")
            object.__setattr__(self, name, values)
        check_usual(self, "friction")
        lengths = {len(self.of(name)) for name in PAIRWISE} - {1}
        if len(lengths) > 1:
            raise InputError(
                f"friction is given for {' and '.join(map(str, sorted(lengths)))} pairs of tubes; it must be as many"
            )
        if isinstance(self.refinement, bool) or self.refinement not in range(-2, 5):
            raise InputError(f"refinement of friction is {self.refinement!r}; it must be a whole number from -2 to 4")

    def of(self, name: str) -> tuple[float, ...]:
        """The numbers of one of PAIRWISE, as given."""
        values: tuple[float, ...] = getattr(self, name)
        return values

    def per_pair(self, name: str, pairs: int) -> tuple[float, ...]:
        """The numbers of one of PAIRWISE for every pair."""
        values = self.of(name)
        return values * pairs if len(values) == 1 else values

    @property
    def trivial(self) -> bool:
        """True if there is no friction."""
        return not any(any(self.of(name)) for name in PAIRWISE)


def per_pair(name: str, given: Sequence[float] | float, n_tubes: int) -> tuple[float, ...]:
    """A number, 0 or more, for every pair of neighbours, of one for each or one for all; raises InputError."""
    values = tuple(positive(name, x, zero=True) for x in numbers(name, given))
    if len(values) not in (1, n_tubes - 1):
        raise InputError(
            f"{name} is {len(values)} numbers; the robot has {n_tubes} tubes, so it must be {n_tubes - 1}, one for "
            "every pair of neighbours, or 1"
        )
    return values * (n_tubes - 1) if len(values) == 1 else values


def clearances(given: Sequence[float] | float, n_tubes: int) -> tuple[float, ...]:
    """(n - 1,) the radial room, m, of every tube in the next one, of one for each or one for all; raises InputError."""
    room = per_pair("clearance", given, n_tubes)
    check_size("clearance", room, BETWEEN_TUBES, "mm")
    return room


def check_friction(friction: Friction | None, n_tubes: int) -> None:
    """Raise InputError where a friction is for another number of tubes."""
    if friction is None:
        return
    for name in PAIRWISE:
        per_pair(f"{name} of friction", friction.of(name), n_tubes)
