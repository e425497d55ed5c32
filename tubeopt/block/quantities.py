"""What a custom requirement or objective may speak of: tubes, poses and certificates, as expressions.

An expression is written once, in these quantities. Recorded on symbols, it gives values and derivatives with respect to
whatever the quantities depend on: where equilibria are solved inside, by the chain rule; in a program of equilibrium
blocks, as an expression of that; on the numbers of solved equilibria, the value alone.
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
"""Dimensions and stiffnesses of the tubes, (n,) each, SI."""

CLEARANCES = 24
"""Parts of the arm in each of which the clearance is told where it is least."""

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
}
"""Numbers that a quantity has; the others have one per tube."""


PoseNumber = int | tuple[int, float]
"""A pose by its number from 0; with a share, its arm drawn back to this share of its length."""


@dataclass(frozen=True)
class Quantity:
    """One quantity: its name; the pose of which it is, or None; and `at`: the fraction of the arm's length, the
    translations (n,) of a certificate, the tube of a strain, the body of a clearance, the load of a deflection; of a
    strain held straight the tube and its piece."""

    name: str
    pose: PoseNumber | None = None
    at: tuple[Any, ...] = ()

    def size(self, n: int) -> int:
        """Numbers that it has, for n tubes."""
        if self.name in ("jacobian", "turning"):
            return 6 * n
        return n if self.pose is None and self.name in TUBES else SIZES.get(self.name, n)


Look = Callable[[Quantity], Any]
"""Gives a quantity as an expression or as numbers."""


class Tubes(Mapping[str, Any]):
    """Every one of TUBES by its name, (n,) inner to outer."""

    def __init__(self, look: Look) -> None:
        self._look = look

    def __getitem__(self, name: str) -> Any:
        if name not in TUBES:
            raise InputError(f"tubes have no {name!r}; they have {', '.join(TUBES)}")
        return self._look(Quantity(name))

    def __iter__(self) -> Iterator[str]:
        return iter(TUBES)

    def __len__(self) -> int:
        return len(TUBES)


class PoseQuantities:
    """One solved pose: SI units, plate frame."""

    def __init__(self, look: Look, number: PoseNumber, n_tubes: int) -> None:
        self._look, self._number, self._n_tubes = look, number, n_tubes

    def _of(self, name: str, *at: Any) -> Any:
        return self._look(Quantity(name, self._number, at))

    @property
    def rotations(self) -> Any:
        """(n,) rad."""
        return self._of("rotations")

    @property
    def translations(self) -> Any:
        """(n,) m."""
        return self._of("translations")

    @property
    def tip_position(self) -> Any:
        """(3,) m."""
        return self._of("tip_position")

    @property
    def tip_direction(self) -> Any:
        """(3,) unit vector along which the tip points."""
        return self._of("tip_direction")

    @property
    def margin(self) -> Any:
        """Stability margin."""
        return self._of("margin")

    def position(self, fraction: float) -> Any:
        """(3,) m, at a fraction of the arm's length in front of the plate: 0 the plate, 1 the tip."""
        return self._of("position", _fraction(fraction))

    def curvature(self, fraction: float) -> Any:
        """(2,) of the arm in its Bishop frame, 1/m, at a fraction of its length."""
        return self._of("curvature", _fraction(fraction))

    def strain(self, tube: int) -> Any:
        """Largest bending strain at the surface of a tube (0 is the innermost), with its slots where they are told. For
        designs only."""
        return self._of("strain", int(tube))

    def clearance(self, body: Any) -> Any:
        """(CLEARANCES,) least distance of the arm's surface from a body in parts of the arm, m. For designs only.

        `body` has `signed_distance` and `gradient` of points, as those of `tubeopt.bodies` have.
        """
        return self._of("clearance", body)

    def deflection(self, load: Any) -> Any:
        """(3,) m, how far a `Load`, or a force (3,) on the tip, N, which keeps its direction, moves the tip. For
        designs only."""
        return self._of("deflection", _load(load))

    def margin_under(self, load: Any) -> Any:
        """Stability margin under a `Load`, or a force (3,) on the tip, N; under moments the least eigenvalue of the
        symmetric part of the linearised equations, which is at most the margin. For designs only."""
        return self._of("margin_under", _load(load))

    @property
    def stroke_force(self) -> Any:
        """Largest force, N, with which the tip can push along itself before the arm buckles or snaps; 10 N where it
        bears that. Of poses with given joint values, in designs only."""
        return self._of("stroke_force")

    @property
    def jacobian(self) -> Any:
        """(3, 2 n) change of the tip's place with rotations, m/rad, and translations. For designs only."""
        return ca.reshape(self._of("jacobian"), 3, 2 * self._n_tubes)

    @property
    def turning(self) -> Any:
        """(3, 2 n) turn vector of the tip's frame with rotations, and translations, rad/m. For designs only."""
        return ca.reshape(self._of("turning"), 3, 2 * self._n_tubes)

    def drawn(self, share: float) -> PoseQuantities:
        """The arm on its way out: every tube as in the pose, or drawn back straight so that it ends at this share of
        the arm's length. For designs only."""
        if not isinstance(self._number, int):
            raise InputError("the arm is already retracted; give the fraction of the whole arm")
        if not 0 < finite("share", share) < 1:
            raise InputError(f"share is {share:g}; it must be from 0 (base plate) to 1 (whole arm)")
        return PoseQuantities(self._look, (self._number, float(share)), self._n_tubes)


def _load(inputs: Any) -> Load:
    if isinstance(inputs, Load):
        return inputs
    return Load(tuple(vector("force", inputs, 3, "x, y, z").tolist()))


def _fraction(value: float) -> float:
    if not 0 <= finite("fraction", value) <= 1:
        raise InputError(f"fraction is {value:g}; it must be from 0 (base plate) to 1 (tip)")
    return float(value)


class Quantities:
    """Everything that an expression may speak of.

    Attributes:
        n_tubes: number of tubes n.  tubes: every one of TUBES by name, (n,).  poses: in order.
    """

    def __init__(self, look: Look, n_tubes: int, n_poses: int, pieces: Sequence[int] = ()) -> None:
        self._look, self.n_tubes, self._pieces = look, n_tubes, tuple(pieces)
        self.tubes = Tubes(look)
        self.poses = tuple(PoseQuantities(look, k, n_tubes) for k in range(n_poses))

    def certificate(self, translations: Any = None) -> Any:
        """Snap-free certificate mu_cert at given translations (n,), m, which are numbers; None is all 0."""
        inputs = np.zeros(self.n_tubes) if translations is None else translations
        if isinstance(inputs, (ca.SX, ca.MX)):
            raise InputError("translations of a certificate must be numbers")
        row = vector("translations of a certificate", inputs, self.n_tubes)
        return self._look(Quantity("certificate", at=tuple(row.tolist())))

    def straightened_strain(self, tube: int) -> Any:
        """(pieces,) largest strain of every piece of a tube (0 is the innermost) that is held straight, with its slots
        where they are told; a tube of one curvature is one piece. For designs only."""
        if not self._pieces:
            raise InputError("the strain of a straightened tube is available in designs only")
        pieces = range(self._pieces[tube])
        return ca.vertcat(*(self._look(Quantity("straightened_strain", at=(int(tube), j))) for j in pieces))


@dataclass(frozen=True, eq=False)
class Expression:
    """A recorded expression of K numbers.

    quantities: what it speaks of, Q numbers in this order.  value: function (Q,) -> (K,).  both: -> (K,) and (K, Q),
    its slope.
    """

    quantities: tuple[Quantity, ...]
    value: Any
    both: Any

    def __call__(self, look: Look) -> Any:
        """Its value in terms of the given quantities: expressions give an expression, arrays an array (K,).

        Raises:
            FloatingPointError: it is not finite at these numbers.
        """
        inputs = [look(one) for one in self.quantities]
        if any(isinstance(one, (ca.SX, ca.MX)) for one in inputs):
            return self.value(ca.vertcat(*inputs))
        return _checked(self.value(np.concatenate([np.ravel(one) for one in inputs])))[:, 0]

    def linear(self, look: Callable[[Quantity], tuple[Array, Array]]) -> tuple[Array, Array]:
        """Value (K,) and change (K, X), from the values and the change (.., X) of the quantities.

        Raises:
            FloatingPointError: one of them is not finite.
        """
        inputs = [look(one) for one in self.quantities]
        at = np.concatenate([np.ravel(value) for value, _ in inputs])
        change = np.concatenate([np.atleast_2d(slope) for _, slope in inputs])
        value, slope = map(_checked, self.both(at))
        return value[:, 0], slope @ change


def _checked(value: Any) -> Array:
    result = np.asarray(value.full(), dtype=float)
    if not np.isfinite(result).all():
        raise FloatingPointError("an expression is not finite")
    return result


def recorded(
    function: Callable[[Quantities], Any], n_tubes: int, n_poses: int, labels: str, pieces: Sequence[int] = ()
) -> Expression:
    """An expression of quantities. `labels` name its owner in error messages; `pieces` are the numbers of pieces of the
    tubes, if it may use them.

    Raises:
        InputError: it is no expression, speaks of nothing or of a pose that is not there.
    """
    symbols: dict[Quantity, Any] = {}

    def look(one: Quantity) -> Any:
        """The symbol of a quantity, made where it is first asked for."""
        if one not in symbols:
            symbols[one] = ca.SX.sym(one.name, one.size(n_tubes))
        return symbols[one]

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
    return Expression(tuple(symbols), value, ca.Function("both", [x], [column, slope], {"cse": True}))
