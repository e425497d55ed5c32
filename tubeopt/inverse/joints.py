"""What the actuators allow: the independent joint values of a robot, their ranges, and the order of its tubes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import scipy

from ..errors import InputError, vector
from ..robots.assembly import ROUND_OFF
from ..robots.eccentric import SegmentedEccentricRobot
from ..robots.limits import JointLimits
from ..robots.robot import Robot
from ..solvers.sampling import sobol
from ..typing import Array, Mask
from .least_squares import constrained_least_squares

CLOSE = 1e-6
"""Share of a joint's scale at which it counts as being at the end of its range."""


@dataclass(frozen=True, eq=False)
class JointSpace:
    """Independent joint values q (m,): n rotations (rad), then the translation of every carriage (m)."""

    robot: Robot
    limits: JointLimits
    """Of which the ranges were made."""
    carriage_gap: float
    """Of which the order was made, as `joint_space` says, m."""
    section_length: float
    """The same, m."""
    carriages: tuple[tuple[int, ...], ...]
    """Tubes, from 0, that each translation moves."""
    lower: Array
    """(m,) least of each."""
    upper: Array
    """(m,) greatest of each."""
    rows: Array
    """(k, m) the order of the tubes: rows q >= least."""
    least: Array
    """(k,) m."""
    row_names: tuple[str, ...]
    """(k,) what each row says where it is active."""
    spread: Array
    """(2n, m) (rotations, translations) = spread q + offset."""
    offset: Array
    """(2n,) rad and m."""
    scale: Array
    """(m,) what counts as one unit of each: 1 rad, and half the longest tube."""

    @cached_property
    def length(self) -> float:
        """Length of the longest tube, m: what distances are measured by."""
        return max(tube.length for tube in self.robot.tubes)

    @cached_property
    def ranges(self) -> Array:
        """(2, 2n) least and greatest rotations and translations of the tubes."""
        which = self.spread.argmax(1)  # one joint moves each; a product would make NaN of an endless range
        return np.stack([self.lower[which], self.upper[which]]) + self.offset

    @cached_property
    def longest(self) -> float:
        """Length of the longest arm that the ranges allow, m: no tip is farther from the plate."""
        shift = self.ranges[1, self.robot.n_tubes :]
        return float((shift + [tube.length - tube.straight_length for tube in self.robot.tubes]).max())

    def joint(self, q: Array) -> Array:
        """(..., 2n) rotations and translations of independent joint values (..., m)."""
        return q if self.plain else np.asarray(q @ self.spread.T + self.offset)

    @cached_property
    def plain(self) -> bool:
        """Whether every tube has a carriage of its own: rotations and translations are the independent joint values."""
        return not self.offset.any() and np.array_equal(self.spread, np.eye(len(self.offset)))

    def by_joints(self, slopes: Array) -> Array:
        """(..., m) derivatives by independent joint values of those (..., 2n) by rotations and translations."""
        return slopes if self.plain else np.asarray(slopes @ self.spread)

    def split(self, q: Array) -> tuple[Array, tuple[float, ...]]:
        """Rotations (n,) and translations (n,) of independent joint values."""
        n = self.robot.n_tubes
        joint = self.joint(q)
        return joint[:n], tuple(joint[n:].tolist())

    def join(self, rotations: Array, translations: Array) -> Array:
        """Independent joint values of rotations and translations (n,)."""
        own = np.asarray(translations) - self.offset[self.robot.n_tubes :]
        return np.concatenate([rotations, own[[tubes[0] for tubes in self.carriages]]])

    def admissible(self, q: Array) -> bool:
        """Whether q keeps the ranges and the order, to within round-off."""
        slack = 1e-9
        inside = (q >= self.lower - slack * self.scale) & (q <= self.upper + slack * self.scale)
        return bool(inside.all() and self.ordered(q))

    def ordered(self, q: Array) -> Mask:
        """(...) whether q (..., m) keep the order, to within round-off."""
        return np.asarray((q @ self.rows.T >= self.least - 1e-9 * self.length).all(-1))

    def inequalities(self, q: Array) -> tuple[Array, Array]:
        """rows (2m + k, m) and bounds of a step from q that stays admissible."""
        return self._sides, self._ends - self._sides @ q

    @cached_property
    def _sides(self) -> Array:
        """(2m + k, m) rows of the ranges, then of the order."""
        unit = np.eye(len(self.scale))
        return np.vstack([unit, -unit, self.rows])

    @cached_property
    def _ends(self) -> Array:
        """(2m + k,) what these are at least."""
        return np.concatenate([self.lower, -self.upper, self.least])

    def free_sides(self, room: Array) -> tuple[int, ...]:
        """(n,) of every tube: -1 where its translation can shrink but not grow, for its range or for the order of the
        tubes, else 1; from the bounds (2m + k,) of `inequalities`."""
        m, held = len(self.scale), room >= -1e-9 * self.length
        if not held.any():
            return (1,) * self.robot.n_tubes
        low, high = held[:m].tolist(), held[m : 2 * m].tolist()
        for row in np.flatnonzero(held[2 * m :]):
            for joint, sign in self._ordered[row]:
                (low if sign > 0 else high)[joint] = True
        back = [high[joint] and not low[joint] for joint in range(self.robot.n_tubes, m)]
        held_back = {tube for tubes, one in zip(self.carriages, back, strict=True) for tube in tubes if one}
        return tuple(-1 if tube in held_back else 1 for tube in range(self.robot.n_tubes))

    @cached_property
    def _ordered(self) -> list[list[tuple[int, float]]]:
        """Which joints are in each row of the order, and with which sign."""
        return [[(int(k), float(np.sign(row[k]))) for k in np.flatnonzero(row)] for row in self.rows]

    def clip(self, q: Array) -> Array:
        """q with round-off beyond the ranges taken away."""
        return np.clip(q, self.lower, self.upper)

    @cached_property
    def names(self) -> list[str]:
        """(m,) "rotation of tube 1", ..., "translation of tube 1", ..., or of the tubes that a carriage moves."""
        turns = [f"rotation of tube {i + 1}" for i in range(self.robot.n_tubes)]
        return turns + [f"translation of {carriage_name(tubes)}" for tubes in self.carriages]

    def active(self, q: Array) -> list[str]:
        """In words, what holds q: joints at the end of their range, tubes that touch in their order."""
        n = self.robot.n_tubes
        words = []
        for k, name in enumerate(self.names):
            close = CLOSE * self.scale[k]
            if q[k] - self.lower[k] <= close or self.upper[k] - q[k] <= close:
                unit = f"{np.degrees(q[k]):.4g} deg" if k < n else f"{q[k] * 1e3:.4g} mm"
                words.append(f"{name} at its end ({unit})")
        gap = self.rows @ q - self.least
        return words + [name for name, size in zip(self.row_names, gap, strict=True) if size <= CLOSE * self.length]

    def wrap(self, q: Array, near: Array) -> Array:
        """q (..., m) with every rotation turned by whole turns into its range, as near to `near` as it can be.

        A rotation whose range has no such place is left out of its range.
        """
        n, turn = self.robot.n_tubes, 2 * np.pi
        out = q.copy()
        rotations, low, high = q[..., :n], self.lower[:n], self.upper[:n]
        first = np.ceil((low - 1e-9 - rotations) / turn)
        last = np.floor((high + 1e-9 - rotations) / turn)
        wanted = np.round((near[..., :n] - rotations) / turn)
        turns = np.where(first <= last, np.clip(wanted, first, np.maximum(first, last)), wanted)
        moved = rotations + turn * turns
        inside = np.clip(moved, low, high)
        out[..., :n] = np.where(np.abs(moved - inside) <= 2e-9, inside, moved)
        return out

    def nearest(self, q: Array) -> Array:
        """The admissible joint values closest to q."""
        rows, bounds = self.inequalities(q)
        found = constrained_least_squares(np.diag(1 / self.scale), np.zeros(len(q)), rows, bounds)
        return self.clip(q + found.x if found is not None else self.inside())

    def middle(self) -> Array:
        """(m,) home where the ranges allow it, else their nearest values."""
        return np.clip(self.join(np.zeros(self.robot.n_tubes), self.robot.home_translations), self.lower, self.upper)

    def sample(self, count: int) -> Array:
        """(count, m) admissible joint values, spread evenly: Sobol points of the ranges that keep the order.

        Where the order leaves little of them, a random walk inside of it (hit and run) adds the rest.
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
            chosen = points[(points @ self.rows.T >= self.least).all(1)] if len(self.least) else points
            if len(chosen) >= count:
                return np.asarray(chosen[:count])
        if len(chosen) >= count // 4:
            return chosen
        added = self._hit_and_run(count - len(chosen))
        return np.concatenate([chosen, added])

    def inside(self) -> Array:
        """(m,) joint values as far as possible from all ends of ranges and order; raises InputError without any."""
        rows, bounds = self.inequalities(np.zeros(len(self.lower)))
        norm = np.linalg.norm(rows * self.scale, axis=1)
        fixed = np.tile(self.upper - self.lower <= 0, 2)
        norm[: len(fixed)][fixed] = 0.0
        # Ranges without width are no ends to be far from.
        reach = np.append(np.zeros(len(self.lower)), -1.0)
        found = scipy.optimize.linprog(
            reach, A_ub=np.column_stack([-rows, norm]), b_ub=-bounds, bounds=[(None, None)] * len(self.lower) + [(0, 1)]
        )
        if found.status != 0:
            raise InputError(
                "limits leave no joint values that keep the tubes in order: every tube must be held behind, and end "
                "beyond, the one around it"
            )
        return np.asarray(found.x[:-1])

    def _hit_and_run(self, count: int) -> Array:
        random = np.random.default_rng(0)
        q = self.inside()
        out = np.empty((count, len(q)))
        for k in range(count * 4):
            direction = random.normal(size=len(q)) * np.where(self.upper > self.lower, self.scale, 0.0)
            rows, bounds = self.inequalities(q)
            speed = rows @ direction
            with np.errstate(divide="ignore", invalid="ignore"):
                time = bounds / speed
            high = time[speed < 0].min(initial=1e3)
            low = time[speed > 0].max(initial=-1e3)
            q = q + random.uniform(min(low, 0.0), max(high, 0.0)) * direction
            out[k // 4] = q
        return out


def carriage_name(tubes: tuple[int, ...]) -> str:
    """What moves: a tube, or the tubes of a segment."""
    return f"tube {tubes[0] + 1}" if len(tubes) == 1 else f"tubes {tubes[0] + 1} to {tubes[-1] + 1}"


def joint_space(
    robot: Robot, limits: JointLimits | None = None, carriage_gap: float = 0.0, section_length: float = 0.0
) -> JointSpace:
    """The joint values that `limits` (by default `robot.limits`) and the order of the tubes allow, found once.

    A tube is held behind the one around it, at least `carriage_gap` (m) apart, and ends beyond it, by at least
    `section_length` (m); the curved part of an eccentric segment begins beyond the end of the next outer one. No tube
    leaves its actuator, none is withdrawn past the plate. Where the order leaves two carriages no play, as for two
    tubes of equal length, they are one joint.
    """
    return _joint_space(robot, limits if limits is not None else robot.limits, carriage_gap, section_length)


@lru_cache(maxsize=32)
def _joint_space(robot: Robot, allowed: JointLimits, carriage_gap: float, section_length: float) -> JointSpace:
    n = robot.n_tubes
    if len(allowed.rotations) != n:
        raise InputError(f"limits are given for {len(allowed.rotations)} tubes; the robot has {n}")
    low, high = _ranges(robot, allowed)
    demands = _order(robot, carriage_gap, section_length)
    offset, carriages = _tied(robot, demands)
    spread = np.zeros((2 * n, n + len(carriages)))
    spread[:n, :n] = np.eye(n)
    for k, group in enumerate(carriages):
        spread[n + np.array(group), n + k] = 1.0
    turn = np.array(allowed.rotations).reshape(n, 2)
    lower = np.array([*turn[:, 0], *((low - offset)[list(group)].max() for group in carriages)])
    upper = np.array([*turn[:, 1], *((high - offset)[list(group)].min() for group in carriages)])
    upper = np.where(np.abs(upper - lower) <= ROUND_OFF, lower, upper)
    rows = np.array([spread[n + ahead] - spread[n + behind] for ahead, behind, _, _ in demands])
    least = np.array([size - offset[ahead] + offset[behind] for ahead, behind, size, _ in demands])
    kept = np.array([bool(row.any()) for row in rows], dtype=bool)
    space = JointSpace(
        robot=robot,
        limits=allowed,
        carriage_gap=carriage_gap,
        section_length=section_length,
        carriages=carriages,
        lower=lower,
        upper=upper,
        rows=rows.reshape(-1, len(lower))[kept],
        least=least[kept],
        row_names=tuple(name for (_, _, _, name), keep in zip(demands, kept, strict=True) if keep),
        spread=spread,
        offset=np.concatenate([np.zeros(n), offset]),
        scale=np.concatenate([np.ones(n), np.full(len(carriages), max(tube.length for tube in robot.tubes) / 2)]),
    )
    space.inside()
    return space


def _ranges(robot: Robot, allowed: JointLimits) -> tuple[Array, Array]:
    """(n,) least and greatest translation of every tube, of what the limits and its lengths allow."""
    shift = np.array(allowed.translations).reshape(-1, 2)
    straight, curved = (
        np.array([getattr(t, f"{part}_length") for t in robot.tubes]) for part in ("straight", "curved")
    )
    low, high = np.maximum(shift[:, 0], -curved), np.minimum(shift[:, 1], straight)
    for i in np.flatnonzero(low > high):
        raise InputError(
            f"limits of translation {i + 1} are [{shift[i, 0]:g}, {shift[i, 1]:g}] m; they must overlap what the "
            f"tube's lengths allow, [{-curved[i]:g}, {straight[i]:g}] m"
        )
    return low, high


Demand = tuple[int, int, float, str]
"""Tubes i, j, a length and a name: translation of i minus that of j is at least the length; at it, the name is so."""


def _order(robot: Robot, carriage_gap: float, section_length: float) -> list[Demand]:
    """What keeps nested tubes in order, once for all tubes that move together."""
    tubes, group = robot.tubes, {i: tubes for tubes in robot.moving_together for i in tubes}
    demands: list[Demand] = []
    seen = set()
    for i, o in robot.nested_pairs:
        if (group[i], group[o]) in seen:
            continue
        seen.add((group[i], group[o]))
        inner, outer = tubes[i], tubes[o]
        names = carriage_name(group[i]), carriage_name(group[o])
        # Held behind: beta_o - beta_i >= gap, with beta = translation - straight_length.
        apart = carriage_gap + outer.straight_length - inner.straight_length
        demands.append((o, i, apart, f"carriages of {names[0]} and {names[1]} touching"))
        if isinstance(robot, SegmentedEccentricRobot):
            demands.append((i, o, outer.curved_length, f"curve of {names[0]} beginning where {names[1]} end"))
        beyond = section_length + outer.curved_length - inner.curved_length
        demands.append((i, o, beyond, f"{names[0]} ending where {names[1]} ends"))
    return demands


def _tied(robot: Robot, demands: list[Demand]) -> tuple[Array, tuple[tuple[int, ...], ...]]:
    """Translations of every tube relative to its group's joint, and the groups: carriages without play are joined."""
    offset = np.zeros(robot.n_tubes)
    groups = [list(tubes) for tubes in robot.moving_together]
    for i, j, least, _ in demands:
        most = min((-size for a, b, size, _ in demands if (a, b) == (j, i)), default=np.inf)
        own, other = (next(g for g in groups if k in g) for k in (i, j))
        if abs(most - least) > ROUND_OFF or own is other:
            continue
        # q_i + offset_i - q_j - offset_j = least, with q_i = q_j from now on.
        shift = least - offset[i] + offset[j]
        offset[own] += shift
        groups.remove(own)
        other += own
    return offset, tuple(tuple(sorted(group)) for group in groups)


Configuration = Any
"""A pair (rotations, translations), or anything with these attributes: an Equilibrium, an InverseSolution."""


def configuration(space: JointSpace, name: str, value: Configuration) -> Array:
    """(m,) joint values of a configuration; raises InputError naming it where it is none."""
    if hasattr(value, "rotations") and hasattr(value, "translations"):
        value = (value.rotations, value.translations)
    try:
        rotations, translations = value
    except (TypeError, ValueError):
        raise InputError(
            f"{name} is {value!r}; it must be a pair (rotations, translations), an Equilibrium or an InverseSolution"
        ) from None
    n = space.robot.n_tubes
    alpha = vector(f"rotations of {name}", rotations, n)
    home = space.robot.home_translations if translations is None else translations
    shift = vector(f"translations of {name}", home, n)
    space.robot.assembly(shift)
    return space.join(alpha, shift)


def scaled_weights(space: JointSpace, weights: Any) -> Array:
    """(m,) weights of the joints in a distance: given per rad and per m, else one over the scale of each."""
    if weights is None:
        return 1 / space.scale
    n = space.robot.n_tubes
    try:
        turn, shift = weights
    except (TypeError, ValueError):
        raise InputError(
            "weights must be a pair: of the rotations (n,), per rad, and of the translations, per m"
        ) from None
    values = [vector(f"weights of {what}", value, n) for what, value in (("rotations", turn), ("translations", shift))]
    if min(value.min() for value in values) < 0:
        raise InputError("weights must be at least 0")
    together = [float(np.sqrt((values[1][list(tubes)] ** 2).sum())) for tubes in space.robot.moving_together]
    return np.concatenate([values[0], together])
