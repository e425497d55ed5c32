"""Quantities of custom requirements and objectives: tubes, poses and certificates, as expressions.

An expression is written once, in these quantities, and recorded on symbols. Where equilibria are solved inside, the
chain rule gives its derivatives. In a program of equilibrium blocks it becomes an expression of the program. On the
numbers of solved equilibria it has a value only.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from ..errors import InputError, finite, vector
from ..robots.load import Load
from ..typing import Array

TUBES = (
    "outer_diameter",
    "inner_diameter",
    "straight_length",
    "curved_length",
    "curvature",
    "bending_stiffness",
    "torsional_stiffness",
)
"""Names of dimensions and stiffnesses of the tubes, (n,) each, SI."""

PLACES = ("offset", "angle")
"""Names of the places of tubes in a bundle robot, (n,) each, SI."""

CLEARANCES = 24
"""Number of parts of the arm, each with its smallest clearance."""

SIZES = {
    "tip_position": 3,
    "tip_direction": 3,
    "margin": 1,
    "position": 3,
    "curvature": 2,
    "strain": 1,
    "straightened_strain": 1,
    "clearance": CLEARANCES,
    "deflection": 3,
    "margin_under": 1,
    "stroke_force": 1,
    "certificate": 1,
    "channel": 1,
    "sheath_diameter": 1,
    "sheath_stiffness": 1,
    "sheath_rigid_length": 1,
    "sheath_rigid_from": 1,
}
"""Size of each quantity; those that are not listed have one number per tube."""


PoseNumber = int | tuple[int, float]
"""Number of a pose from 0, or a pair of this number and the fraction of its length that the retracted arm has."""


@dataclass(frozen=True)
class Quantity:
    """A quantity of the tubes or of a pose."""

    name: str
    pose: PoseNumber | None = None
    """Pose of the quantity; None for tubes and certificates."""
    at: tuple[Any, ...] = ()
    """Arguments of the quantity, by its kind.

    Fraction of the arm; translations (n,) of a certificate; tube of a strain, and piece if it is straightened; body of
    a clearance; load of a deflection.
    """

    def size(self, n: int) -> int:
        """Number of entries for n tubes."""
        if self.name in ("jacobian", "turning"):
            return 6 * n
        if self.name == "order_reserve":
            return n * (n - 1) // 2
        return SIZES.get(self.name, n) if self.pose is not None or self.name not in TUBES else n


Look = Callable[[Quantity], Any]
"""Function that returns a quantity, as an expression or as numbers."""


class Tubes(Mapping[str, Any]):
    """TUBES by name, (n,) each, inner to outer; of bundle robots in designs also PLACES."""

    def __init__(self, look: Look) -> None:
        self._look = look

    def __getitem__(self, name: str) -> Any:
        if name not in (*TUBES, *PLACES):
            raise InputError(f"tubes have no {name!r}; they have {', '.join(TUBES)}")
        return self._look(Quantity(name))

    def __iter__(self) -> Iterator[str]:
        return iter(TUBES)

    def __len__(self) -> int:
        return len(TUBES)


class PoseQuantities:
    """Quantities of one solved pose, in SI units and the plate frame."""

    def __init__(self, look: Look, number: PoseNumber, n_tubes: int) -> None:
        self._look, self._number, self._n_tubes = look, number, n_tubes

    def _of(self, name: str, *at: Any) -> Any:
        return self._look(Quantity(name, self._number, at))

    @property
    def rotations(self) -> Any:
        """Rotations (n,), rad."""
        return self._of("rotations")

    @property
    def translations(self) -> Any:
        """Translations (n,), m."""
        return self._of("translations")

    @property
    def tip_position(self) -> Any:
        """Position (3,) of the tip, m."""
        return self._of("tip_position")

    @property
    def tip_direction(self) -> Any:
        """Unit vector (3,) along the arm at the tip."""
        return self._of("tip_direction")

    @property
    def margin(self) -> Any:
        """Stability margin, at most 1."""
        return self._of("margin")

    def position(self, fraction: float) -> Any:
        """Position (3,), m, at a fraction of the arm's length in front of the plate: 0 the plate, 1 the tip."""
        return self._of("position", _fraction(fraction))

    def curvature(self, fraction: float) -> Any:
        """Curvature (2,) of the arm in its Bishop frame, 1/m, at a fraction of its length."""
        return self._of("curvature", _fraction(fraction))

    def strain(self, tube: int) -> Any:
        """Largest bending strain at the surface of a tube (0 is the innermost), with its slots. For designs only."""
        return self._of("strain", int(tube))

    def clearance(self, body: Any) -> Any:
        """Smallest distance (CLEARANCES,) of the surface of each part of the arm from a body, m. For designs only.

        Args:
            body: one of `tubeopt.bodies`, or an object with `signed_distance` and `gradient` of points.
        """
        return self._of("clearance", body)

    def deflection(self, load: Any) -> Any:
        """Displacement (3,) of the tip by a load, m. For designs only.

        Args:
            load: a `Load`, or a dead force (3,) at the tip, N.
        """
        return self._of("deflection", _load(load))

    def margin_under(self, load: Any) -> Any:
        """Stability margin under a load. For designs only.

        Under moments it is the smallest eigenvalue of the symmetric part of the linearised equations, a lower bound.

        Args:
            load: a `Load`, or a dead force (3,) at the tip, N.
        """
        return self._of("margin_under", _load(load))

    @property
    def stroke_force(self) -> Any:
        """Largest axial force of the tip before the arm buckles or snaps, N; at most 10 N.

        For poses with fixed joint values in designs only.
        """
        return self._of("stroke_force")

    @property
    def jacobian(self) -> Any:
        """Derivative (3, 2 n) of the tip's position by rotations, m/rad, and translations. For designs only."""
        return ca.reshape(self._of("jacobian"), 3, 2 * self._n_tubes)

    @property
    def turning(self) -> Any:
        """Rotation vector (3, 2 n) of the tip's frame per rotations, and translations, rad/m. For designs only."""
        return ca.reshape(self._of("turning"), 3, 2 * self._n_tubes)

    def retracted(self, fraction: float) -> PoseQuantities:
        """Quantities of the arm during deployment, when a fraction of its length is deployed. For designs only.

        Every tube is as in the pose, or retracted without rotation so that it ends at this fraction.
        """
        if not isinstance(self._number, int):
            raise InputError("the arm is already retracted; give the fraction of the whole arm")
        if not 0 < finite("fraction", fraction) < 1:
            raise InputError(f"fraction is {fraction:g}; it must be from 0 (base plate) to 1 (whole arm)")
        return PoseQuantities(self._look, (self._number, float(fraction)), self._n_tubes)


def _load(inputs: Any) -> Load:
    if isinstance(inputs, Load):
        return inputs
    return Load(tuple(vector("force", inputs, 3, "x, y, z").tolist()))


def _fraction(value: float) -> float:
    if not 0 <= finite("fraction", value) <= 1:
        raise InputError(f"fraction is {value:g}; it must be from 0 (base plate) to 1 (tip)")
    return float(value)


class Quantities:
    """Quantities of an expression.

    Attributes:
        n_tubes: number of tubes n.  tubes: TUBES by name, (n,) each.  poses: quantities of the poses, in order.
    """

    def __init__(self, look: Look, n_tubes: int, n_poses: int, pieces: Sequence[int] = ()) -> None:
        self._look, self.n_tubes, self._pieces = look, n_tubes, tuple(pieces)
        self.tubes = Tubes(look)
        self.poses = tuple(PoseQuantities(look, k, n_tubes) for k in range(n_poses))

    def certificate(self, translations: Any = None) -> Any:
        """Snap-free certificate at translations (n,), m, which must be numbers; None is all 0."""
        inputs = np.zeros(self.n_tubes) if translations is None else translations
        if isinstance(inputs, (ca.SX, ca.MX)):
            raise InputError("translations of a certificate must be numbers")
        row = vector("translations of a certificate", inputs, self.n_tubes)
        return self._look(Quantity("certificate", at=tuple(row.tolist())))

    def order_reserve(self, translations: Sequence[float]) -> Any:
        """Reserves of the order of tube ends of a bundle robot, m, for all pairs: what bending cannot take away.

        The certificate of a bundle at the same translations (n,) is a proof where they are above 0. For designs only.
        """
        return self._look(Quantity("order_reserve", at=tuple(translations)))

    @property
    def channel(self) -> Any:
        """Diameter of the largest free circle between the tubes of a bundle robot, m. For designs only."""
        return self._look(Quantity("channel"))

    @property
    def sheath_diameter(self) -> Any:
        """Inner diameter of the sheath of a bundle robot, m. For designs only."""
        return self._look(Quantity("sheath_diameter"))

    @property
    def sheath_stiffness(self) -> Any:
        """Bending stiffness of the sheath of a bundle robot, N m^2. For designs only."""
        return self._look(Quantity("sheath_stiffness"))

    @property
    def sheath_rigid_length(self) -> Any:
        """Length of the sheath of a bundle robot from the plate that is rigid, m. For designs only."""
        return self._look(Quantity("sheath_rigid_length"))

    @property
    def sheath_rigid_from(self) -> Any:
        """Arc length from which on the sheath of a bundle robot is rigid, m. For designs only."""
        return self._look(Quantity("sheath_rigid_from"))

    def straightened_strain(self, tube: int) -> Any:
        """Largest strain (pieces,) of every piece of a straightened tube, with its slots if known. For designs only.

        Tube 0 is the innermost; a tube of one curvature is one piece.
        """
        if not self._pieces:
            raise InputError("the strain of a straightened tube is available in designs only")
        pieces = range(self._pieces[tube])
        return ca.vertcat(*(self._look(Quantity("straightened_strain", at=(int(tube), j))) for j in pieces))


@dataclass(frozen=True, eq=False)
class Expression:
    """A recorded expression of K numbers."""

    quantities: tuple[Quantity, ...]
    """Quantities of the expression, with Q numbers in total."""
    value: Any
    """Function (Q,) -> value (K,)."""
    value_and_slope: Any
    """Function (Q,) -> value (K,), derivative (K, Q)."""

    def __call__(self, look: Look) -> Any:
        """Value in terms of quantities: an expression for expressions, an array (K,) for arrays.

        Raises:
            FloatingPointError: the value is not finite.
        """
        inputs = [look(quantity) for quantity in self.quantities]
        if any(isinstance(value, (ca.SX, ca.MX)) for value in inputs):
            return self.value(ca.vertcat(*inputs))
        return _finite(self.value(np.concatenate([np.ravel(value) for value in inputs])))[:, 0]

    def linear(self, look: Callable[[Quantity], tuple[Array, Array]]) -> tuple[Array, Array]:
        """Value (K,) and change (K, X), from values and changes (.., X) of the quantities.

        Raises:
            FloatingPointError: a result is not finite.
        """
        inputs = [look(quantity) for quantity in self.quantities]
        at = np.concatenate([np.ravel(value) for value, _ in inputs])
        change = np.concatenate([np.atleast_2d(slope) for _, slope in inputs])
        value, slope = map(_finite, self.value_and_slope(at))
        return value[:, 0], slope @ change


def _finite(value: Any) -> Array:
    result = np.asarray(value.full(), dtype=float)
    if not np.isfinite(result).all():
        raise FloatingPointError("an expression is not finite")
    return result


def recorded(
    function: Callable[[Quantities], Any], n_tubes: int, n_poses: int, labels: str, pieces: Sequence[int] = ()
) -> Expression:
    """Record an expression of quantities.

    Args:
        labels: name of its owner in error messages.
        pieces: number of pieces of each tube, if the expression may use them.

    Raises:
        InputError: no expression, one without quantities, or one of a pose that does not exist.
    """
    symbols: dict[Quantity, Any] = {}

    def look(quantity: Quantity) -> Any:
        """Symbol of a quantity, created on first use."""
        if quantity not in symbols:
            symbols[quantity] = ca.SX.sym(quantity.name, quantity.size(n_tubes))
        return symbols[quantity]

    try:
        result = function(Quantities(look, n_tubes, n_poses, pieces))
        column = ca.vertcat(*result) if isinstance(result, (list, tuple)) else result
    except IndexError as error:
        raise InputError(f"the expression of {labels} refers to a pose or tube that does not exist ({error})") from None
    if not isinstance(column, ca.SX) or not symbols or not column.numel():
        raise InputError(
            f"the expression of {labels} is {result!r}; it must be an expression of the quantities it is given"
        )
    column, x = ca.densify(ca.vec(column)), ca.vertcat(*symbols.values())
    slope = ca.densify(ca.jacobian(column, x))
    value = ca.Function("value", [x], [column], {"cse": True})
    return Expression(tuple(symbols), value, ca.Function("value_and_slope", [x], [column, slope], {"cse": True}))
