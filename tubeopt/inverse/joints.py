"""Independent joint values of a robot: their ranges, the order of its tubes, and configurations of callers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from ..errors import InputError, vector
from ..files.units import TO_MM
from ..robots.assembly import LENGTH_ROUND_OFF
from ..robots.limits import JointLimits, check_turn
from ..robots.order import Demand, carriage_name, demands, in_order, translation_ranges
from ..robots.robot import Robot
from ..solvers.compiled.quadratic import constrained_least_squares
from ..solvers.sampling import sobol
from ..typing import Array, Mask

CLOSE = 1e-6
"""Distance from the end of a range, relative to the joint's scale, that counts as being at it."""

SLACK = 1e-9
"""Allowed violation of ranges and order by round-off, relative to the joint's scale and the longest tube."""

SAME_POSITION = 1e-9
"""Largest play (m) that counts as none, and largest distance of coinciding carriages.

It is below the resolution of a drive, and above that of files.
"""


@dataclass(frozen=True, eq=False)
class JointSpace:
    """Independent joint values q (m,): n rotations (rad), then the translation of every carriage (m)."""

    robot: Robot
    limits: JointLimits
    """Limits that define the ranges."""
    carriage_gap: float
    """Smallest distance of carriages, as for `joint_space`, m."""
    section_length: float
    """Smallest length of a section, as for `joint_space`, m."""
    apart: tuple[tuple[int, int], ...]
    """Pairs of nested tubes, from 0; the inner one may end inside the outer one."""
    fixed: tuple[Demand, ...]
    """The part of the order that leaves no play."""
    carriages: tuple[tuple[int, ...], ...]
    """Tubes, from 0, that each translation moves."""
    lower: Array
    """Lower bounds (m,)."""
    upper: Array
    """Upper bounds (m,)."""
    rows: Array
    """Order of the tubes as rows (k, m): rows q >= row_lower."""
    row_lower: Array
    """Bounds (k,) of the order, m."""
    row_names: tuple[str, ...]
    """Descriptions (k,) of active rows."""
    row_faults: tuple[str, ...]
    """Descriptions (k,) of violated rows."""
    spread: Array
    """Matrix (2n, m): rotations and translations are spread q + offset."""
    offset: Array
    """Offset (2n,), rad and m."""
    scale: Array
    """Units (m,) of the joints: 1 rad, and half the longest tube."""

    @cached_property
    def length(self) -> float:
        """Length of the longest tube, m, the unit of distances."""
        return max(tube.length for tube in self.robot.tubes)

    @cached_property
    def ranges(self) -> Array:
        """Bounds (2, 2n) of the rotations and translations of the tubes."""
        which = self.spread.argmax(1)  # one joint moves each; a product would make NaN of an infinite range
        return np.stack([self.lower[which], self.upper[which]]) + self.offset

    @cached_property
    def longest(self) -> float:
        """Length of the longest arm that the ranges allow, m: no tip is farther from the plate."""
        shift = self.ranges[1, self.robot.n_tubes :]
        return float((shift + [tube.length - tube.straight_length for tube in self.robot.tubes]).max())

    def joint(self, q: Array) -> Array:
        """Rotations and translations (..., 2n) of independent joint values (..., m)."""
        return q if self.plain else np.asarray(q @ self.spread.T + self.offset)

    @cached_property
    def plain(self) -> bool:
        """True if every tube has its own carriage: rotations and translations are the independent joint values."""
        return not self.offset.any() and np.array_equal(self.spread, np.eye(len(self.offset)))

    def by_joints(self, slopes: Array) -> Array:
        """Derivatives (..., m) by independent joint values, from those (..., 2n) by rotations and translations."""
        return slopes if self.plain else np.asarray(slopes @ self.spread)

    def split(self, q: Array) -> tuple[Array, tuple[float, ...]]:
        """Rotations (n,) and translations (n,) of independent joint values."""
        n = self.robot.n_tubes
        joint = self.joint(q)
        return joint[:n], tuple(joint[n:].tolist())

    def join(self, rotations: Array, translations: Array, name: str = "") -> Array:
        """Independent joint values (m,) of rotations and translations (n,).

        Raises:
            InputError: tubes that one joint moves have inconsistent translations; the message has `name`.
        """
        q = self._independent(rotations, translations)
        if (
            not self.plain
            and np.abs(q @ self.spread.T + self.offset - [*rotations, *translations]).max() > SAME_POSITION
        ):
            raise InputError(self._moved_apart(np.asarray(translations), name))
        return q

    def _independent(self, rotations: Array, translations: Array) -> Array:
        """Joint values (m,), with the translation of the first tube of every carriage."""
        advance = np.asarray(translations) - self.offset[self.robot.n_tubes :]
        return np.concatenate([rotations, advance[[tubes[0] for tubes in self.carriages]]])

    def _moved_apart(self, shift: Array, name: str) -> str:
        """Message on the tubes for which no joint values give the translations (n,)."""
        for tubes in self.robot.moving_together:
            if np.ptp(shift[list(tubes)]) > SAME_POSITION:
                return f"{_translations(shift, tubes, name)}; they must be equal, since one carriage moves these tubes"
        missing = [demand.distance - shift[demand.ahead] + shift[demand.behind] for demand in self.fixed]
        worst = int(np.argmax(missing))
        demand = self.fixed[worst]
        tubes = tuple(sorted((demand.ahead, demand.behind)))
        return f"{_translations(shift, tubes, name)}: {demand.broken}, by {missing[worst] * TO_MM:.4g} mm"

    def holding(self, *shifts: Array) -> JointSpace:
        """Joint space that includes the translations (n,) of each of `shifts`.

        Where the order leaves two carriages no play, and an inner tube ends inside the outer one, they get independent
        carriages, so that the inner tube may end there.
        """
        apart = {
            demand.ends
            for demand in self.fixed
            for shift in shifts
            if demand.ends is not None and shift[demand.ahead] - shift[demand.behind] < demand.distance - SAME_POSITION
        }
        if not apart:
            return self
        pairs = tuple(sorted(apart.union(self.apart)))
        return _joint_space(self.robot, self.limits, self.carriage_gap, self.section_length, pairs)

    def admissible(self, q: Array) -> bool:
        """True if q satisfies the ranges and the order, except for round-off."""
        inside = (q >= self.lower - SLACK * self.scale) & (q <= self.upper + SLACK * self.scale)
        return bool(inside.all() and self.ordered(q))

    def ordered(self, q: Array) -> Mask:
        """Mask (...) of the joint values q (..., m) that satisfy the order, except for round-off."""
        return np.asarray((q @ self.rows.T >= self.row_lower - SLACK * self.length).all(-1))

    def outside(self, q: Array, slack: float = SLACK) -> str:
        """Text on a joint out of its range, by more than `slack` of its scale, or on tubes out of order; "" if there is
        none.
        """
        n = self.robot.n_tubes
        for k in np.flatnonzero((q < self.lower - slack * self.scale) | (q > self.upper + slack * self.scale)):
            unit, factor = ("deg", np.degrees(1.0)) if k < n else ("mm", TO_MM)
            value, low, high = (each[k] * factor for each in (q, self.lower, self.upper))
            return f"{self.names[k]} is {value:.6g} {unit}; it must be from {low:.6g} to {high:.6g} {unit}"
        missing = self.row_lower - self.rows @ q
        if missing.max(initial=0.0) <= SLACK * self.length:
            return ""
        worst = int(np.argmax(missing))
        return f"{self.row_faults[worst]}, by {missing[worst] * TO_MM:.4g} mm"

    def inequalities(self, q: Array) -> tuple[Array, Array]:
        """Rows (2m + k, m) and bounds (2m + k,) of an admissible step from q."""
        return self._sides, self._ends - self._sides @ q

    @cached_property
    def _sides(self) -> Array:
        """Rows (2m + k, m) of the ranges, then of the order."""
        unit = np.eye(len(self.scale))
        return np.vstack([unit, -unit, self.rows])

    @cached_property
    def _ends(self) -> Array:
        """Bounds (2m + k,) of these rows."""
        return np.concatenate([self.lower, -self.upper, self.row_lower])

    def free_sides(self, bounds: Array) -> tuple[int, ...]:
        """Sides (n,) that translations can move to: -1 if a translation can shrink but not grow, else 1.

        `bounds` (2m + k,) are those of `inequalities`; range and order count.
        """
        m, active = len(self.scale), bounds >= -1e-9 * self.length
        if not active.any():
            return (1,) * self.robot.n_tubes
        low, high = active[:m].tolist(), active[m : 2 * m].tolist()
        for row in np.flatnonzero(active[2 * m :]):
            for joint, sign in self._ordered[row]:
                (low if sign > 0 else high)[joint] = True
        shrinks = [high[joint] and not low[joint] for joint in range(self.robot.n_tubes, m)]
        shrinking = {tube for tubes, shrink in zip(self.carriages, shrinks, strict=True) for tube in tubes if shrink}
        return tuple(-1 if tube in shrinking else 1 for tube in range(self.robot.n_tubes))

    @cached_property
    def _ordered(self) -> list[list[tuple[int, float]]]:
        """Joints in each row of the order, with their signs."""
        return [[(int(k), float(np.sign(row[k]))) for k in np.flatnonzero(row)] for row in self.rows]

    def clip(self, q: Array) -> Array:
        """Joint values clipped to the ranges, for round-off."""
        return np.clip(q, self.lower, self.upper)

    @cached_property
    def names(self) -> list[str]:
        """Names (m,) of the joints: "rotation of tube 1", ..., "translation of tube 1", ..."""
        turns = [f"rotation of tube {i + 1}" for i in range(self.robot.n_tubes)]
        return turns + [f"translation of {carriage_name(tubes)}" for tubes in self.carriages]

    def active(self, q: Array) -> list[str]:
        """Texts on active limits: joints at the end of their range, tubes at the limit of their order."""
        m, names = len(self.scale), []
        for k in range(m):
            row = k if q[k] - self.lower[k] <= self.upper[k] - q[k] else m + k
            end = self.lower[k] if row == k else self.upper[k]
            if abs(q[k] - end) <= CLOSE * self.scale[k] or not self.lower[k] < q[k] < self.upper[k]:
                names.append(self.limit(row))
        excess = self.rows @ q - self.row_lower
        return names + [name for name, size in zip(self.row_names, excess, strict=True) if size <= CLOSE * self.length]

    def limit(self, row: int) -> str:
        """Description of a row of `inequalities`, from 0."""
        m = len(self.scale)
        if row >= 2 * m:
            return self.row_names[row - 2 * m]
        k = row % m
        end = float(self.lower[k] if row < m else self.upper[k])
        unit = f"{np.degrees(end):.4g} deg" if k < self.robot.n_tubes else f"{end * 1e3:.4g} mm"
        return f"{self.names[k]} at its end ({unit})"

    def wrap(self, q: Array, reference: Array) -> Array:
        """Joint values q (..., m) with rotations moved by full turns into their ranges, closest to `reference`.

        A rotation without such a value stays out of its range.
        """
        n, full_turn = self.robot.n_tubes, 2 * np.pi
        out = q.copy()
        rotations, low, high = q[..., :n], self.lower[:n], self.upper[:n]
        first = np.ceil((low - 1e-9 - rotations) / full_turn)
        last = np.floor((high + 1e-9 - rotations) / full_turn)
        nearest = np.round((reference[..., :n] - rotations) / full_turn)
        turns = np.where(first <= last, np.clip(nearest, first, np.maximum(first, last)), nearest)
        moved = rotations + full_turn * turns
        inside = np.clip(moved, low, high)
        out[..., :n] = np.where(np.abs(moved - inside) <= 2e-9, inside, moved)
        return out

    def nearest(self, q: Array) -> Array:
        """Admissible joint values (m,) closest to q."""
        rows, bounds = self.inequalities(q)
        solution = constrained_least_squares(np.diag(1 / self.scale), np.zeros(len(q)), rows, bounds)
        return self.clip(q + solution.x if solution is not None else self.inside())

    def middle(self) -> Array:
        """Home (m,), clipped to the ranges."""
        return self.clip(self._independent(self.robot.home_rotations, self.robot.home_translations))

    def sample(self, count: int) -> Array:
        """Admissible joint values (count, m), evenly spread: Sobol points of the ranges that satisfy the order.

        If the order excludes most of them, the others are drawn carriage by carriage, the outermost first, each in the
        range that the order leaves.
        """
        n = self.robot.n_tubes
        m = len(self.lower)
        width = int(np.ceil(np.log2(max(count, 2))))
        chosen = np.zeros((0, m))
        for power in range(width, max(width, 16) + 1):
            unit = sobol(m, 2**power)
            low = np.concatenate([np.maximum(self.lower[:n], -np.pi), self.lower[n:]])
            high = np.concatenate([np.minimum(self.upper[:n], np.pi), self.upper[n:]])
            narrow = low[:n] > high[:n]
            low[:n][narrow], high[:n][narrow] = self.lower[:n][narrow], self.upper[:n][narrow]
            points = low + unit * (high - low)
            chosen = points[(points @ self.rows.T >= self.row_lower).all(1)] if len(self.row_lower) else points
            if len(chosen) >= count:
                return np.asarray(chosen[:count])
        if len(chosen) >= count // 4:
            return chosen
        added = [self._drawn(row, low[:n], high[:n]) for row in sobol(m, 2**width)[: count - len(chosen)]]
        return np.concatenate([chosen, added])

    def _drawn(self, unit: Array, low: Array, high: Array) -> Array:
        """Admissible joint values (m,) at fractions (m,) of the ranges; rotations from `low` to `high` (n,)."""
        n = self.robot.n_tubes
        fractions = iter(np.resize(unit[n:], n).tolist())
        return self._placed(
            low + unit[:n] * (high - low), lambda bottom, top: bottom + next(fractions) * (top - bottom)
        )

    def inside(self) -> Array:
        """Joint values (m,) in the middle of the ranges that satisfy the order; raises InputError if there are none."""
        n = self.robot.n_tubes
        return self._placed((self.lower + self.upper)[:n] / 2, lambda bottom, top: (bottom + top) / 2)

    def drawn_back(self, length: float) -> Array:
        """Joint values (m,) at home rotations with every tube at most `length` (m) farther out than need be."""
        rotations = self.middle()[: self.robot.n_tubes]
        return self._placed(rotations, lambda bottom, top: min(bottom + length, top))

    def _placed(self, rotations: Array, choose: Callable[[float, float], float]) -> Array:
        """Joint values (m,) with given rotations (n,) and translations in order; see `in_order`."""
        ranges = translation_ranges(self.robot.tubes, self.limits)
        shift = in_order(self.robot, ranges, self._order, choose)
        if shift is None:
            distance = f" with carriages {self.carriage_gap * TO_MM:.4g} mm apart" if self.carriage_gap else ""
            raise InputError(
                f"limits allow no joint values with the tube order{distance}: every tube must be clamped behind, and "
                "end beyond, the tube around it"
            )
        return self._independent(rotations, shift)

    @cached_property
    def _order(self) -> list[Demand]:
        return demands(self.robot, self.carriage_gap, self.section_length, self.apart)


def joint_space(
    robot: Robot, limits: JointLimits | None = None, carriage_gap: float = 0.0, section_length: float = 0.0
) -> JointSpace:
    """Joint space of `limits` (by default `robot.limits`) and of the order of the tubes, cached.

    A tube is clamped behind the tube around it, at least `carriage_gap` (m) apart, and ends beyond it, by at least
    `section_length` (m). The curved part of an eccentric segment begins beyond the end of the next outer one. No tube
    leaves its actuator or is withdrawn past the plate. Where the order leaves two carriages no play, as for two tubes
    of equal length, they are one joint; see `JointSpace.holding` for exceptions.
    """
    return _joint_space(robot, limits if limits is not None else robot.limits, carriage_gap, section_length, ())


@lru_cache(maxsize=32)
def _joint_space(
    robot: Robot,
    allowed: JointLimits,
    carriage_gap: float,
    section_length: float,
    apart: tuple[tuple[int, int], ...],
) -> JointSpace:
    n = robot.n_tubes
    if len(allowed.rotations) != n:
        raise InputError(f"limits are given for {len(allowed.rotations)} tubes; the robot has {n}")
    low, high = translation_ranges(robot.tubes, allowed)
    order = demands(robot, carriage_gap, section_length, apart)
    offset, carriages = _tied(robot, order)
    spread = np.zeros((2 * n, n + len(carriages)))
    spread[:n, :n] = np.eye(n)
    for k, group in enumerate(carriages):
        spread[n + np.array(group), n + k] = 1.0
    rotation_limits = np.array(allowed.rotations).reshape(n, 2)
    lower = np.array([*rotation_limits[:, 0], *((low - offset)[list(group)].max() for group in carriages)])
    upper = np.array([*rotation_limits[:, 1], *((high - offset)[list(group)].min() for group in carriages)])
    upper = np.where((upper - lower <= LENGTH_ROUND_OFF) & (lower - upper <= SAME_POSITION), lower, upper)
    rows = np.array([spread[n + demand.ahead] - spread[n + demand.behind] for demand in order])
    minimum = np.array([demand.distance - offset[demand.ahead] + offset[demand.behind] for demand in order])
    variable = np.array([bool(row.any()) for row in rows], dtype=bool)
    space = JointSpace(
        robot=robot,
        limits=allowed,
        carriage_gap=carriage_gap,
        section_length=section_length,
        apart=apart,
        fixed=tuple(demand for demand, varies in zip(order, variable, strict=True) if not varies),
        carriages=carriages,
        lower=lower,
        upper=upper,
        rows=rows.reshape(-1, len(lower))[variable],
        row_lower=minimum[variable],
        row_names=tuple(demand.name for demand, varies in zip(order, variable, strict=True) if varies),
        row_faults=tuple(demand.broken for demand, varies in zip(order, variable, strict=True) if varies),
        spread=spread,
        offset=np.concatenate([np.zeros(n), offset]),
        scale=np.concatenate([np.ones(n), np.full(len(carriages), max(tube.length for tube in robot.tubes) / 2)]),
    )
    space.inside()
    return space


def _tied(robot: Robot, order: Sequence[Demand]) -> tuple[Array, tuple[tuple[int, ...], ...]]:
    """Translations of every tube relative to its group's joint, and the groups: carriages without play are joined."""
    offset = np.zeros(robot.n_tubes)
    groups = [list(tubes) for tubes in robot.moving_together]
    for demand in order:
        i, j = demand.ahead, demand.behind
        upper = min((-each.distance for each in order if (each.ahead, each.behind) == (j, i)), default=np.inf)
        first, second = (next(group for group in groups if k in group) for k in (i, j))
        if not -LENGTH_ROUND_OFF <= upper - demand.distance <= SAME_POSITION or first is second:
            continue
        # q_i + offset_i - q_j - offset_j is in the middle of the remaining play, with q_i = q_j from now on.
        shift = (demand.distance + upper) / 2 - offset[i] + offset[j]
        offset[first] += shift
        groups.remove(first)
        second += first
    return offset, tuple(tuple(sorted(group)) for group in groups)


def _translations(shift: Array, tubes: Sequence[int], name: str) -> str:
    """Text of the translations of tubes, from 0."""
    numbers = [f"{number:.6g} mm" for number in (shift[list(tubes)] * TO_MM).tolist()]
    carriages, last = ", ".join(str(tube + 1) for tube in tubes[:-1]), tubes[-1] + 1
    of = f" of {name}" if name else ""
    return f"translations{of} of tubes {carriages} and {last} are {', '.join(numbers[:-1])} and {numbers[-1]}"


Configuration = Any
"""A pair (rotations, translations), or anything with these attributes: an Equilibrium, an InverseSolution."""


def parts(name: str, value: Configuration) -> tuple[Any, Any]:
    """Rotations and translations of a configuration, unchecked; raises InputError with `name` for other values."""
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
    """Joint values (m,) of a configuration; raises InputError with `name` for other values."""
    rotations, translations = parts(name, value)
    n = space.robot.n_tubes
    alpha = vector(f"rotations of {name}", rotations, n)
    home = space.robot.home_translations if translations is None else translations
    shift = vector(f"translations of {name}", home, n)
    check_turn(alpha)
    space.robot.admit(shift)
    return space.join(alpha, shift, name)


def joints_of(space: JointSpace, name: str, value: Configuration) -> tuple[Array, tuple[float, ...]]:
    """Rotations and translations (n,) of a configuration, as its joint space has them; raises as `configuration`."""
    q = configuration(space, name, value)
    return space.split(q)


def shift_of(robot: Robot, *places: Any) -> list[Array]:
    """Translations (n,), m, of each start that is a configuration; other starts are skipped."""
    rows = []
    for configuration in places:
        if isinstance(configuration, tuple | list) and len(configuration) == 2:
            shift = robot.home_translations if configuration[1] is None else configuration[1]
        else:
            shift = getattr(configuration, "translations", ())
        with suppress(TypeError, ValueError):
            row = np.array(shift, dtype=float)
            if row.shape == (robot.n_tubes,):
                rows.append(row)
    return rows


def scaled_weights(space: JointSpace, weights: Any) -> Array:
    """Weights (m,) of the joints in a distance, from weights per rad and per m; by default one over the scale."""
    if weights is None:
        return 1 / space.scale
    n = space.robot.n_tubes
    try:
        per_rotation, shift = weights
    except (TypeError, ValueError):
        raise InputError(
            "weights must be a pair: for rotations (n,), per rad, and for translations (n,), per m"
        ) from None
    values = [
        vector(f"weights of {what}", value, n) for what, value in (("rotations", per_rotation), ("translations", shift))
    ]
    if min(value.min() for value in values) < 0:
        raise InputError("weights must be at least 0")
    together = [float(np.sqrt((values[1][list(tubes)] ** 2).sum())) for tubes in space.carriages]
    return np.concatenate([values[0], together])
