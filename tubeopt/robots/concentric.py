"""Concentric tube robots: tubes one inside the other, each clamped and driven at its proximal end; their friction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated

from ..arguments import typed
from ..display import Displayed
from ..errors import InputError, items, numbers, positive
from ..files.field_metadata import NOT_NEGATIVE, TYPICAL_TUBE_CLEARANCE, Range, Typical, check_size, check_typical, unit
from ..typing import Array
from .assembly import Assembly, assemble
from .calibration import Calibration, Posterior
from .limits import JointLimits
from .robot import Robot, keeps_hash
from .tubes import Tube

# What a friction holds for every pair of neighbours.
PAIRWISE = ("torque", "plate", "jumps", "ends", "by_moment")


@typed
@dataclass(frozen=True)
class Friction(Displayed):
    """Coulomb friction of every tube in the next one, inner to outer: n - 1 numbers, or one for all pairs.

    In a bundle each tube rubs in its channel, the tube around it or the sheath: n numbers, or one for all tubes.

    The torque about the tubes' axis is limited by the capacities here: N m per m of length, and N m at points. A
    slipping contact has the same torque at any speed. With `by_moment`, 1/m, tubes that bend one another more rub more;
    the capacities of an increment are those of the state before it, so small steps are needed.

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
        Range(minimum=-2, maximum=4),
        "number of mesh bisections, for a sharper boundary between slip and stick; -1 and "
        "-2 coarsen the mesh and save time",
    ] = 0
    by_moment: Annotated[
        float | tuple[float, ...],
        unit("per_m"),
        NOT_NEGATIVE,
        Typical(1e-2, 1e3),
        "more friction torque per length for every N m of bending moment that the outer tube of a pair and those "
        "around it carry; of concentric robots only",
    ] = 0.0

    def __post_init__(self) -> None:
        for name in PAIRWISE:
            values = tuple(positive(f"{name} of friction", x, zero=True) for x in numbers(name, getattr(self, name)))
            if not values:
                raise InputError(f"{name} of friction is empty; it must be one number, or one for every pair of tubes")
            object.__setattr__(self, name, values)
        check_typical(self, "friction")
        lengths = {len(self.of(name)) for name in PAIRWISE} - {1}
        if len(lengths) > 1:
            raise InputError(
                f"friction is given for {' and '.join(map(str, sorted(lengths)))} pairs of tubes; it must be as many"
            )
        if isinstance(self.refinement, bool) or self.refinement not in range(-2, 5):
            raise InputError(f"refinement of friction is {self.refinement!r}; it must be a whole number from -2 to 4")

    def of(self, name: str) -> tuple[float, ...]:
        """Values of a field of PAIRWISE: one for all pairs, or one for each."""
        values: tuple[float, ...] = getattr(self, name)
        return values

    def per_pair(self, name: str, pairs: int) -> tuple[float, ...]:
        """Values of a field of PAIRWISE, one for each pair."""
        values = self.of(name)
        return values * pairs if len(values) == 1 else values

    @property
    def trivial(self) -> bool:
        """True without friction."""
        return not any(any(self.of(name)) for name in PAIRWISE)


def per_pair(name: str, entry: Sequence[float] | float, n_tubes: int, *, channels: bool = False) -> tuple[float, ...]:
    """Values, 0 or more, of the pairs of neighbours, from one for each or one for all; raises InputError.

    With `channels` each of the n tubes of a bundle has one, with what is around it.
    """
    values = tuple(positive(name, x, zero=True) for x in numbers(name, entry))
    count = n_tubes if channels else n_tubes - 1
    if len(values) not in (1, count):
        raise InputError(
            f"{name} is {len(values)} numbers; the robot has {n_tubes} tubes, so it must be {count}, one for "
            f"{'every tube' if channels else 'every pair of neighbours'}, or 1"
        )
    return values * count if len(values) == 1 else values


def clearances(entry: Sequence[float] | float, n_tubes: int) -> tuple[float, ...]:
    """Radial clearances (n - 1,) of neighbouring tubes, m, from one for each or one for all; raises InputError."""
    values = per_pair("clearance", entry, n_tubes)
    check_size("clearance", values, TYPICAL_TUBE_CLEARANCE, "mm")
    return values


def check_friction(friction: Friction | None, n_tubes: int, *, channels: bool = False) -> None:
    """Raise InputError if a friction is for another number of tubes; `channels` as of `per_pair`."""
    if friction is None:
        return
    for name in PAIRWISE:
        per_pair(f"{name} of friction", friction.of(name), n_tubes, channels=channels)
    if channels and any(friction.by_moment):  # type: ignore[arg-type]
        raise InputError(
            "by_moment of friction is given for a bundle; it is supported for concentric robots only: more than "
            "bending presses tubes into their channels"
        )


@typed
@keeps_hash
@dataclass(frozen=True)
class ConcentricRobot(Robot):
    """A concentric tube robot.

    Raises:
        InputError: no tube, tubes that do not nest, an inner tube shorter than an outer one, limits, a
            calibration, a friction or clearances for another number of tubes.
    """

    tubes: tuple[Tube, ...]
    """Tubes, inner to outer; each fits into the next, and none is shorter than the next."""
    name: str = ""
    """Name in tables and figures."""
    joint_limits: JointLimits | None = None
    """Limits of the actuators, in readings; with None the lengths of the tubes decide (see `limits`)."""
    calibration: Calibration | None = None
    """Conversion of drive readings to joint values; None if they are equal."""
    friction: Friction | None = None
    """Friction between neighbouring tubes, for motions with friction; None if unknown."""
    clearance: tuple[float, ...] | None = None
    """Radial clearances (n - 1,) of neighbouring tubes, m, for the tilt of the arm in them; None neglects them."""
    posterior: Posterior | None = None
    """Uncertainty of the parameters after a fit; None if unknown."""

    def __post_init__(self) -> None:
        tubes = items("tubes", self.tubes, Tube, "tubes, inner to outer")
        object.__setattr__(self, "tubes", tubes)
        if not tubes:
            raise InputError("tubes is empty; a robot needs at least one tube")
        for i, (inner, outer) in enumerate(pairwise(tubes), start=1):
            if inner.outer_diameter > outer.inner_diameter:
                raise InputError(
                    f"tube {i} does not fit into tube {i + 1}: its outer_diameter is {inner.outer_diameter:g} m; "
                    f"it must be at most the other's inner_diameter, {outer.inner_diameter:g} m"
                )
            # Sums of lengths that are equal in a file differ by round-off.
            if inner.length < outer.length - 1e-12:
                raise InputError(
                    f"tube {i} is shorter than tube {i + 1} around it: its overall length is {inner.length:g} m; "
                    f"it must be at least {outer.length:g} m"
                )
        self.check_drives(yields=True)
        check_friction(self.friction, len(tubes))
        if self.clearance is not None:
            object.__setattr__(self, "clearance", clearances(self.clearance, len(tubes)))

    @property
    def moving_together(self) -> tuple[tuple[int, ...], ...]:
        """Tubes of each carriage: one per carriage."""
        return tuple((i,) for i in range(self.n_tubes))

    @property
    def nested_pairs(self) -> tuple[tuple[int, int], ...]:
        """Pairs of nested tubes: each tube and the next outer one."""
        return tuple(pairwise(range(self.n_tubes)))

    def assembly(self, translations: Array) -> Assembly:
        """Sections at `translations` (n,), m; raises InputError if a tube leaves its actuator."""
        return assemble(self.tubes, translations)


def friction_of(robot: Robot) -> Friction | None:
    """Friction of a robot; None if it is unknown."""
    friction: Friction | None = getattr(robot, "friction", None)
    return friction
