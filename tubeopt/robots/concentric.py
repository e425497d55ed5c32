"""Concentric tube robots: tubes one inside the other, each held and driven at its own proximal end."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

from ..arguments import typed
from ..errors import InputError, items
from ..typing import Array
from .assembly import Assembly, assemble
from .calibration import Calibration
from .friction import Friction, check_friction, clearances
from .limits import JointLimits
from .robot import Robot, keeps_hash
from .tubes import Tube


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
    """Inner to outer; each fits into the next, and none is shorter than the next."""
    name: str = ""
    """Name in tables and figures."""
    joint_limits: JointLimits | None = None
    """Limits of the actuators, in readings; None allows what the lengths allow (see `limits`)."""
    calibration: Calibration | None = None
    """Conversion of drive readings to joint values; None if they are equal."""
    friction: Friction | None = None
    """Friction between neighbouring tubes, for motions with friction; None if unknown."""
    clearance: tuple[float, ...] | None = None
    """(n - 1,) m, radial, of every tube in the next one, for those who ask how far it lets the arm tilt; None: it does
    not count."""

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
        """Every tube has a carriage of its own."""
        return tuple((i,) for i in range(self.n_tubes))

    @property
    def nested_pairs(self) -> tuple[tuple[int, int], ...]:
        """Every tube inside the next."""
        return tuple(pairwise(range(self.n_tubes)))

    def assembly(self, translations: Array) -> Assembly:
        """Sections at `translations` (n,), m; raises InputError where a tube leaves its actuator."""
        return assemble(self.tubes, translations)


def friction_of(robot: Robot) -> Friction | None:
    """The friction that a robot is known to have; None where none is known."""
    return robot.friction if isinstance(robot, ConcentricRobot) else None
