"""The surface of an arm, and how far it is from bodies: where it is the least, and where it comes close to each."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from ..bodies.obstacles import ClearanceMonitor, Scene
from ..equilibrium.result import Equilibrium
from ..robots.robot import Robot
from ..typing import Array, Index, Mask

# Half a millimetre on an arm of 200 mm; what lies between two points is bounded by the arm's bend, see `_at_least`.
FINE = 400
"""Points along the arm at which its distance from bodies is measured."""

EVENLY = np.linspace(0.0, 1.0, FINE)
"""Where these are, as shares of it."""

# Every sixteenth point tells on which stretches the arm can be closest at all.
STRIDES = (16, 4, 1)
"""Of these points every so many-th is looked at first, then more where the distance may be the least."""

# One call for all of them, where golden-section search would take as many calls one after the other.
FINER = 17
"""Points between the two neighbours of one at which it is closest."""

# Every contact is a row of a quadratic program.
MOST_CONTACTS = 6
"""Places where the arm comes closest to one body that are told."""

AHEAD, BEYOND = 5e-3, 1e-9
"""How much farther than is enough distances are measured, and beyond what is of interest, m."""

PARTS = 4
"""Pieces of the centreline between two shape points, at whose ends the arm is looked around from."""


def cubic(begin: Any, end: Any, slope: Any, last: Any, x: Any, length: Any = 1.0) -> Any:
    """Cubic interpolation at shares x of a length, from values at both ends and slopes there."""
    y = 1 - x
    return y * y * (begin * (1 + 2 * x) + slope * (length * x)) + x * x * (end * (1 + 2 * y) - last * (length * y))


_UNIT = np.eye(4)
BETWEEN = cubic(_UNIT[0], _UNIT[1], _UNIT[2], _UNIT[3], np.arange(1, PARTS)[:, None] / PARTS)
"""(PARTS - 1, 4) weights of both shape points, and of both tangents times the length between, in the points there."""


@lru_cache(maxsize=64)
def outer_radius(robot: Robot) -> Array:
    """(n,) radius of the arm where tube i is the outermost, for eccentric tubes of what holds them, m."""
    offset = robot.assembly(np.array(robot.home_translations)).offset
    return np.array([tube.outer_diameter / 2 for tube in robot.tubes]) + offset


@dataclass(frozen=True, eq=False)
class Contacts:
    """Where an arm comes closest to bodies."""

    body: Index
    """(c,) their numbers."""
    place: Array
    """(c,) arc lengths, m."""
    point: Array
    """(c, 3) of the centreline, m."""
    distance: Array
    """(c,) of the surface of the arm, m."""

    def chosen(self, rows: Mask | Index) -> Contacts:
        """Some of them."""
        return Contacts(self.body[rows], self.place[rows], self.point[rows], self.distance[rows])

    @property
    def rank(self) -> Index:
        """(c,) the how many-th of its body each of them is, from 0; those of a body stand together."""
        return np.arange(len(self.body)) - np.searchsorted(self.body, self.body)


@dataclass(frozen=True, eq=False)
class _Near:
    """All contacts within a distance, m; rows of the grid about which bodies come that close, and the least (m) that
    these distances can be there."""

    within: float
    contacts: Contacts
    row: Index
    at_least: Array
    also: frozenset[int]

    @cached_property
    def bodies(self) -> int:
        """How many bodies they are of."""
        return len(np.unique(self.contacts.body))


NONE = np.zeros(0, dtype=int)
NOWHERE = Contacts(NONE, np.zeros(0), np.zeros((0, 3)), np.zeros(0))


@dataclass(frozen=True, eq=False)
class ArmSurface:
    """The surface of the arm of an equilibrium, round at the end of every tube."""

    equilibrium: Equilibrium
    _clear: dict[Scene, tuple[float, bool]] = field(default_factory=dict, init=False, repr=False)
    """Clearances from scenes, and whether each is exact, not a bound."""
    _known: dict[Scene, _Near] = field(default_factory=dict, init=False, repr=False)
    """What is known of scenes."""

    @cached_property
    def grid(self) -> Array:
        """(p,) arc lengths close enough for bodies: evenly spaced, and the ends of tubes, where the radius falls."""
        ends = self.equilibrium.tube_end
        tip = self.equilibrium.arc_length[-1]
        s = np.sort(np.concatenate([EVENLY * tip, ends[(ends > 0) & (ends < tip)]]))
        own = s[1:] > s[:-1]
        return s if own.all() else s[np.append(True, own)]

    def at(self, s: Array) -> tuple[Array, Array]:
        """Centreline (p, 3) and radius of the arm (p,) at arc lengths."""
        return self.centreline(s), self.radius(s)

    def line(self, count: int) -> tuple[Array, Array]:
        """Centreline (count, 3) and radius of the arm (count,) at evenly spaced points."""
        return self.at(np.linspace(0.0, self.equilibrium.arc_length[-1], count))

    def centreline(self, s: Array) -> Array:
        """(p, 3) at arc lengths."""
        arm = self.equilibrium
        return _hermite(arm.arc_length, arm.position, arm.frame[:, :, 2], s)

    def radius(self, s: Array) -> Array:
        """(p,) radius of the arm at arc lengths: of the outermost tube, or of what holds tubes beside each other."""
        ends, thick = self._steps
        return np.asarray(thick[np.searchsorted(ends, s)])

    @cached_property
    def _steps(self) -> tuple[Array, Array]:
        """Arc lengths (n,) at which tubes end, in order, and the radius of the arm (n + 1,) up to each and beyond."""
        ends = self.equilibrium.tube_end
        order = np.argsort(ends)
        there = np.append(outer_radius(self.equilibrium.robot)[order], 0.0)
        return ends[order] + 1e-12, np.maximum.accumulate(there[::-1])[::-1]

    def clearance(self, scene: Scene, enough: float = np.inf) -> float:
        """Least distance of the surface from bodies, m; some lower bound of it that is `enough`, where it is more than
        that; infinite without bodies.

        Points far apart tell along which stretches it may be the least, and these are looked at more closely.
        """
        if not scene.bodies:
            return np.inf
        if scene in self._known and enough <= self._known[scene].within:
            near = self._known[scene]
            if not len(near.row):
                return near.within
            least = min(near.within, float(near.contacts.distance.min(initial=np.inf)))
            doubtful = near.row[near.at_least < min(enough, least)]
            return min(least, self._between(scene, doubtful)) if len(doubtful) else least
        known, exact = self._clear.get(scene, (-np.inf, False))
        if not exact and known < enough:
            self._clear[scene] = known, _ = self._clearance(scene, enough)
        return known

    @cached_property
    def _points(self) -> Array:
        """(p, 3) of the centreline at the grid."""
        return self.centreline(self.grid)

    @cached_property
    def _radii(self) -> Array:
        """(p,) at the grid."""
        return self.radius(self.grid)

    @cached_property
    def _few(self) -> Index:
        """Rows of the grid that are looked at first: also those at which the radius falls."""
        few, last = np.zeros(len(self.grid), dtype=bool), len(self.grid) - 1
        few[:: STRIDES[0]] = few[last] = True
        few[np.minimum(np.searchsorted(self.grid, self.equilibrium.tube_end), last)] = True
        return few.nonzero()[0]

    def _window(self, rows: Index, stride: int) -> tuple[Array, Array]:
        """How far the stretch that every so many-th point stands for reaches from rows (r,) of the grid, and how thick
        the arm is there at most, m: it grows thinner towards its tip."""
        grid, half = self.grid, (stride + 1) // 2
        first, end = np.maximum(rows - half, 0), grid[np.minimum(rows + half, len(grid) - 1)]
        return np.maximum(grid[rows] - grid[first], end - grid[rows]), self._radii[first]

    def _clearance(self, scene: Scene, enough: float) -> tuple[float, bool]:
        """The clearance and True, or a bound that is enough and False."""
        grid, least, rows = self.grid, np.inf, self._few
        for stride, finer in zip(STRIDES, (*STRIDES[1:], 0), strict=True):
            points, radius = self.centreline(grid[rows]), self._radii[rows]
            reach, thick = self._window(rows, stride)
            least = min(least, float((scene.at_most(points) - radius).min()))
            interesting = min(max(least, 0.0), enough + AHEAD) + reach + thick + BEYOND
            distance = scene.nearest(points, interesting)
            least = min(least, float((distance - radius)[distance < interesting].min(initial=np.inf)))
            bound = self._at_least(scene, distance, reach) - thick
            if bound.min() >= enough:
                return float(bound.min()), False
            rows = rows[bound <= least]
            if finer:
                rows = np.unique(self._around(rows, stride, finer))
        return min(least, self._between(scene, rows)), True

    def _around(self, rows: Index, stride: int, finer: int) -> Index:
        """(r, k) every `finer`-th row of the stretches that rows (r,) stand for."""
        half = (stride + 1) // 2
        return np.asarray(np.clip(rows[:, None] + np.arange(-half, half + 1, finer), 0, len(self.grid) - 1))

    def _at_least(self, scene: Scene, distance: Array, reach: Array) -> Array:
        """(r,) the least that the distance of the centreline from bodies can be within `reach` (r,) along it of points
        with these distances (r,), m, as far as it has a minimum there.

        A distance changes by no more than its point moves. From a solid body outside of it even less: at the minimum D
        the shortest way is square to the arm, whose curvature is k, and |x - y|^2 <= D^2 + (1 + k D) reach^2.
        """
        bound = distance - reach
        if scene.solid:
            outside = np.maximum(distance, 0.0)
            square = outside**2 - (1 + self.bend * outside) * reach**2
            bound = np.maximum(bound, np.where(square > 0, np.sqrt(np.maximum(square, 0.0)), -np.inf))
        return np.asarray(bound)

    @cached_property
    def bend(self) -> float:
        """Curvature of the arm at most, 1/m: with room for what is between its points."""
        return 1.2 * float(np.linalg.norm(self.equilibrium.curvature, axis=1).max(initial=0.0))

    def _between(self, scene: Scene, rows: Index) -> float:
        """Least distance between points of the grid and their neighbours, m: near a small body the arm comes closer
        there than a clearance may be off."""
        cells = np.unique(np.append(rows, rows - 1))
        cells = cells[(cells >= 0) & (cells < len(self.grid) - 1)]
        if not len(cells):
            return np.inf
        begin, length = self.grid[cells], np.diff(self.grid)[cells]
        share = np.arange(1, FINER // 2) / (FINER // 2)
        points, radius = self.at((begin[:, None] + length[:, None] * share).ravel())
        return float((scene.nearest(points) - radius).min())

    def contacts(
        self, scene: Scene, within: float, fewest: int | None = None, also: frozenset[int] = frozenset()
    ) -> Contacts:
        """Where the arm comes closest to each of the bodies, if closer than `within`, m: body by body, of each at most
        MOST_CONTACTS, the closest first. With `fewest`, those farther than so many bodies may be left out, except
        `also`, numbers of bodies."""
        known = self._known.get(scene)
        if known is None or not (known.within >= within or (fewest and known.bodies >= fewest and also <= known.also)):
            known = self._known[scene] = self._near(scene, within, fewest, also)
        return known.contacts.chosen(known.contacts.distance <= within) if len(known.contacts.body) else NOWHERE

    def look_around(self, lookout: ClearanceMonitor, within: float) -> None:
        """Look for contacts within a distance, m, unless a lookout knows that there are none."""
        if lookout.far(*self._sparse(within)):
            self._known[lookout.scene] = _Near(within, NOWHERE, NONE, np.zeros(0), frozenset())
        else:
            self.contacts(lookout.scene, within)

    def _sparse(self, within: float) -> tuple[Array, Array]:
        """Some points (p, 3) of the centreline, and distances (p,) from them, m, beyond which nothing is closer to the
        surface than `within`: the shape points, and some between each and the next."""
        arm = self.equilibrium
        at, length = arm.position, arm.arc_length[1:] - arm.arc_length[:-1]
        ahead = arm.frame[:, :, 2]
        cells = np.concatenate([at[:-1], at[1:], ahead[:-1] * length[:, None], ahead[1:] * length[:, None]])
        between = (BETWEEN @ cells.reshape(4, -1)).reshape(-1, 3)
        half = length / (2 * PARTS)
        reach = np.concatenate([half[:1], *[half] * PARTS])
        np.maximum(reach[1 : len(length)], half[1:], out=reach[1 : len(length)])
        return np.concatenate([at, between]), reach + (within + float(outer_radius(arm.robot).max()) + BEYOND)

    def _near(self, scene: Scene, within: float, fewest: int | None, also: frozenset[int]) -> _Near:
        """Bodies and stretches of the arm that are far from each other are left out in pairs, first by points far
        apart; so is what is farther than `fewest` bodies certainly are not."""
        few, whole = self._few, within
        always = np.fromiter(also, int, len(also))
        reach, thick = self._window(few, STRIDES[0])
        body, at = scene.pairs(self.centreline(self.grid[few]), within + reach + thick + BEYOND)
        row, distance, bound = few[at], np.zeros(0), np.zeros(0)
        for stride, finer in zip(STRIDES, (*STRIDES[1:], 0), strict=True):
            if not len(body):
                return _Near(within, NOWHERE, row, bound, also)
            reach, thick = self._window(row, stride)
            distance = scene.pair_distances(body, self._points[row], whole + reach + thick + BEYOND)
            bound = self._at_least(scene, distance, reach) - thick
            if fewest:
                within = min(within, _farthest(body, distance - self._radii[row], fewest))
            near = bound <= (np.where(np.isin(body, always), whole, within) if also else within)
            body, row, distance, bound = body[near], row[near], distance[near], bound[near]
            if finer and len(body):
                body, row = _once(body, self._around(row, stride, finer), len(self.grid))
        return _Near(within, self._closest(scene, body, row, distance - self._radii[row]), row, bound, also)

    def _closest(self, scene: Scene, body: Index, row: Index, distance: Array) -> Contacts:
        """Contacts from pairs (k,) in order of bodies, then rows of the grid: those closer than their neighbours."""
        size = len(self.grid) + 1
        key = np.concatenate([[-9], body * size + row, [-9]])
        padded = np.concatenate([[np.inf], distance, [np.inf]])
        before = np.where(key[:-2] == key[1:-1] - 1, padded[:-2], np.inf)
        after = np.where(key[2:] == key[1:-1] + 1, padded[2:], np.inf)
        least = np.flatnonzero((distance <= before) & (distance <= after))
        least = least[np.lexsort((row[least], distance[least], body[least]))]
        body, row = body[least], row[least]
        found = Contacts(body, self.grid[row], self._points[row], distance[least])
        first = found.rank < MOST_CONTACTS
        return self._closer(scene, found.chosen(first), row[first])

    def _closer(self, scene: Scene, contacts: Contacts, row: Index) -> Contacts:
        """The same between the neighbours of points of the grid."""
        low, high = self.grid[np.maximum(row - 1, 0)], self.grid[np.minimum(row + 1, len(self.grid) - 1)]
        finer = low[:, None] + (high - low)[:, None] * np.linspace(0.0, 1.0, FINER)
        points, radius = self.at(finer.ravel())
        within = np.repeat(contacts.distance, FINER) + radius
        between = scene.pair_distances(np.repeat(contacts.body, FINER), points, within) - radius
        points, between = points.reshape(*finer.shape, 3), between.reshape(finer.shape)
        every, best = np.arange(len(row)), between.argmin(1)
        closer = between[every, best] < contacts.distance
        out = Contacts(
            contacts.body,
            np.where(closer, finer[every, best], contacts.place),
            np.where(closer[:, None], points[every, best], contacts.point),
            np.where(closer, between[every, best], contacts.distance),
        )
        return out.chosen(np.lexsort((out.distance, out.body)))


def _farthest(body: Index, distance: Array, count: int) -> float:
    """Distance within which there are `count` bodies, of pairs (k,); infinite where there are fewer."""
    least = np.full(body.max(initial=-1) + 1, np.inf)
    np.minimum.at(least, body, distance)
    return float(np.partition(least, count - 1)[count - 1]) if len(least) >= count else np.inf


def _once(body: Index, rows: Index, count: int) -> tuple[Index, Index]:
    """Pairs of bodies (k,) and rows (k, r) of `count`, each once, in order, by a table: to sort takes longer."""
    known = np.zeros(body.max(initial=-1) + 1, dtype=bool)
    known[body] = True
    table = np.zeros((np.count_nonzero(known), count), dtype=bool)
    table[(np.cumsum(known) - 1)[body][:, None], rows] = True
    one, row = np.nonzero(table)
    return np.flatnonzero(known)[one], row


def _hermite(s: Array, value: Array, slope: Array, at: Array) -> Array:
    """(p, 3) cubic interpolation of a curve given with its tangents at arc lengths s (m,)."""
    if len(s) < 2:
        return np.repeat(value, len(at), axis=0)
    k = np.searchsorted(s[1:-1], at, side="right")
    h = (s[k + 1] - s[k])[:, None]
    return np.asarray(cubic(value[k], value[k + 1], slope[k], slope[k + 1], (at - s[k])[:, None] / h, h))
