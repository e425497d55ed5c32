"""Order of tubes: distances of carriages and ends, home, and tubes that end inside others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError
from ..typing import Array, Index, Mask
from .assembly import LENGTH_ROUND_OFF
from .limits import JointLimits, default_limits
from .tubes import Tube

# Distance (m) of two ends that count as equal: round-off of lengths and translations that a file states in mm.
SAME_END = 1e-9


class Nested(Protocol):
    """Properties of a `Robot` that the order of tubes depends on."""

    nested_curves: bool

    @property
    def tubes(self) -> tuple[Tube, ...]: ...

    @property
    def limits(self) -> JointLimits: ...

    @property
    def moving_together(self) -> tuple[tuple[int, ...], ...]: ...

    @property
    def nested_pairs(self) -> tuple[tuple[int, int], ...]: ...


@dataclass(frozen=True)
class Demand:
    """Constraint: translation of tube `ahead` minus translation of tube `behind` (from 0) is at least `distance`."""

    ahead: int
    behind: int
    distance: float
    """Smallest difference, m."""
    name: str
    """Description of the active constraint."""
    broken: str
    """Description of the violated constraint."""
    ends: tuple[int, int] | None = None
    """Inner and outer tube, if the constraint is on their ends alone."""


def carriage_name(tubes: tuple[int, ...]) -> str:
    """Text of the tubes that a carriage moves."""
    return f"tube {tubes[0] + 1}" if len(tubes) == 1 else f"tubes {tubes[0] + 1} to {tubes[-1] + 1}"


def translation_ranges(tubes: Sequence[Tube], allowed: JointLimits) -> tuple[Array, Array]:
    """Smallest and largest translations (n,), m, within limits and lengths; raises InputError if a range is empty."""
    shift = np.array(allowed.translations).reshape(-1, 2)
    straight, curved = (np.array([getattr(t, f"{part}_length") for t in tubes]) for part in ("straight", "curved"))
    # A tube is held behind the plate: beta = t - straight <= 0. Its end stays in front of it: t + curved >= 0.
    low, high = np.maximum(shift[:, 0], -curved), np.minimum(shift[:, 1], straight)
    for i in np.flatnonzero(low > high):
        raise InputError(
            f"limits of translation {i + 1} are [{shift[i, 0]:g}, {shift[i, 1]:g}] m; they must overlap what the "
            f"tube's lengths allow, [{-curved[i]:g}, {straight[i]:g}] m"
        )
    return low, high


def demands(
    robot: Nested, carriage_gap: float = 0.0, section_length: float = 0.0, apart: tuple[tuple[int, int], ...] = ()
) -> list[Demand]:
    """Constraints on the order of nested tubes, once for all tubes that move together.

    A tube is clamped behind the tube around it, by at least `carriage_gap` (m), and ends beyond it, by at least
    `section_length` (m); the inner tube of the pairs `apart` may end inside the outer one.
    """
    tubes, group = robot.tubes, {i: tubes for tubes in robot.moving_together for i in tubes}
    order: list[Demand] = []
    pairs = set()
    for i, o in robot.nested_pairs:
        if (group[i], group[o]) in pairs:
            continue
        pairs.add((group[i], group[o]))
        inner, outer = tubes[i], tubes[o]
        names = carriage_name(group[i]), carriage_name(group[o])
        # Held behind: beta_o - beta_i >= gap, with beta = translation - straight_length.
        behind = carriage_gap + outer.straight_length - inner.straight_length
        violation = f"the carriage of {names[0]} would be in front of the carriage of {names[1]}"
        order.append(Demand(o, i, behind, f"carriages of {names[0]} and {names[1]} touching", violation))
        if not robot.nested_curves:
            violation = f"the curve of {names[0]} would begin inside {names[1]}"
            # The inner curve begins at t_i, the outer tube ends at t_o + curved_o.
            name = f"curve of {names[0]} beginning where {names[1]} end"
            order.append(Demand(i, o, outer.curved_length, name, violation))
        if (i, o) not in apart:
            # Tubes end at t + curved: t_i + curved_i >= t_o + curved_o + section_length.
            beyond = section_length + outer.curved_length - inner.curved_length
            violation = f"{names[0]} would end inside {names[1]}"
            order.append(Demand(i, o, beyond, f"{names[0]} ending where {names[1]} ends", violation, (i, o)))
    return order


def out_of_order(robot: Nested, translations: Array) -> list[tuple[Demand, float]]:
    """Constraints on carriages and curves that translations (n,), m, violate, and their violations, m."""
    missing = [
        (each, float(each.distance - translations[each.ahead] + translations[each.behind]))
        for each in demands(robot)
        if each.ends is None
    ]
    return [(each, amount) for each, amount in missing if amount > SAME_END]


def home_translations(robot: Nested) -> Array:
    """Translations (n,) at home, m: 0 if limits and order allow it.

    Otherwise each is as close to 0 as possible, from the outermost tube inwards.

    If no translations within the limits are in order, the lengths of the tubes are the limits.
    """
    home, order = None, demands(robot)
    with suppress(InputError):
        home = in_order(robot, translation_ranges(robot.tubes, robot.limits), order, _nearest_to_0)
    if home is None:
        home = in_order(robot, translation_ranges(robot.tubes, default_limits(robot.tubes)), order, _nearest_to_0)
    assert home is not None  # an inner tube is never shorter than an outer one
    return home


def _nearest_to_0(bottom: float, top: float) -> float:
    # Rounded, so that round-off in the bounds does not move a tube from 0.
    return round(min(max(0.0, bottom), top), 12) + 0.0


def in_order(
    robot: Nested, ranges: tuple[Array, Array], order: Sequence[Demand], choose: Callable[[float, float], float]
) -> Array | None:
    """Translations (n,), m, within ranges (n,) and in order, chosen carriage by carriage, the outermost first.

    Each is chosen from the interval that leaves a place to all carriages inside of it. None if an interval is empty.
    """
    groups = robot.moving_together
    of, plate = {tube: k for k, tubes in enumerate(groups) for tube in tubes}, len(groups)
    # most[a, b] is the largest translation of carriage a less that of b; the last row and column stand for 0.
    most = np.where(np.eye(plate + 1), 0.0, np.inf)
    for k, tubes in enumerate(groups):
        most[plate, k], most[k, plate] = -ranges[0][list(tubes)].max(), ranges[1][list(tubes)].min()
    for demand in order:
        pair = of[demand.behind], of[demand.ahead]
        most[pair] = min(most[pair], -demand.distance)
    for k in range(plate + 1):
        most = np.minimum(most, most[:, [k]] + most[[k]])
    if (np.diag(most) < -LENGTH_ROUND_OFF).any():
        return None
    # Every value between the tightest bounds leaves a place to all other carriages: no choice is ever undone.
    out = np.zeros(len(of))
    for k in reversed(range(plate)):
        value = choose(float(-most[plate, k]), float(most[k, plate]))
        most[plate, k], most[k, plate], out[list(groups[k])] = -value, value, value
        for through in (k, plate):
            most = np.minimum(most, most[:, [through]] + most[[through]])
    return out


@dataclass(frozen=True)
class EndInside:
    """Tube that ends inside another one, both counted from 0."""

    tube: int
    around: int
    """Outer tube that reaches farthest beyond it."""
    depth: float
    """Length of that tube beyond this end, in front of the plate, m."""


def ends_inside(robot: Nested, end: Array) -> tuple[EndInside, ...]:
    """Tubes that end inside an outer one, for ends at arc lengths (n,), m, from the plate."""
    around, visible = dict(robot.nested_pairs), np.maximum(end, 0.0)
    inside = []
    for tube in range(len(end)):
        outer = farthest = tube
        while outer in around:
            outer = around[outer]
            farthest = outer if visible[outer] > visible[farthest] + SAME_END else farthest
        if farthest != tube:
            inside.append(EndInside(tube, farthest, float(visible[farthest] - visible[tube])))
    return tuple(inside)


def tip_tube(end: Array) -> int | None:
    """Tube, from 0, at the tip, for ends at arc lengths (n,), m: of those that end there the innermost.

    None if all are withdrawn behind the plate.
    """
    return int(last_tube(end)) if end.max() > SAME_END else None


def last_tube(end: Array) -> Index:
    """Tubes (...), from 0, that end last, for ends at arc lengths (..., n), m.

    Of tubes that end within SAME_END of each other it is the innermost, which holds the tool.
    """
    return np.asarray(np.argmax(end >= end.max(-1, keepdims=True) - SAME_END, axis=-1))


def outermost(present: Mask) -> Index:
    """Outermost tubes (...), from 0, of those `present` (..., n)."""
    return np.asarray(present.shape[-1] - 1 - np.argmax(present[..., ::-1], axis=-1))


def twisted_tube(end: Array, arc_length: ArrayLike) -> Index:
    """Tubes (...), from 0, that an axial moment twists at arc lengths (...), m, for ends at (..., n).

    It is the outermost tube there, and at the tip the tube that ends last. The moment changes its tube at an end, where
    the frame jumps by the difference of their twists.
    """
    at = np.asarray(arc_length)
    at_tip = at >= end.max(-1) - SAME_END
    return np.where(at_tip, last_tube(end), outermost(end >= at[..., None] - SAME_END))
