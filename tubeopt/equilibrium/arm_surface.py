"""Surface of an arm: its smallest distance from bodies, and its closest points to each."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np

from ..block.transcription.arm import between, cubic
from ..bodies.obstacles import ClearanceMonitor, Scene
from ..robots.robot import Robot
from ..typing import Array, Index, Mask
from .result import Equilibrium

# Half a millimetre on an arm of 200 mm; what lies between two points is bounded by the arm's bend, see `_at_least`.
FINE = 400
"""Number of points along the arm at which its distance from bodies is computed."""

EVENLY = np.linspace(0.0, 1.0, FINE)
"""Arc lengths of these points as fractions of the arm."""

# Every sixteenth point bounds the distance of the stretches between: most cannot be closest.
STRIDES = (16, 4, 1)
"""Strides over these points: coarse first, then finer where the distance may be smallest."""

# One call for all of them, where golden-section search would take as many calls one after the other.
FINER = 17
"""Number of points between the two neighbours of a closest point."""

# Every contact is a row of a quadratic program.
MAX_CONTACTS = 6
"""Maximum number of contacts with one body."""

AHEAD, BEYOND = 5e-3, 1e-9
"""Distances, m, beyond the decisive ones that are computed too."""

PARTS = 4
"""Number of pieces of the centreline between two shape points for the coarse search."""


_UNIT = np.eye(4)
BETWEEN = cubic(_UNIT[0], _UNIT[1], _UNIT[2], _UNIT[3], np.arange(1, PARTS)[:, None] / PARTS)
"""Weights (PARTS - 1, 4) of two shape points, and of their tangents times the length, at the points between them."""


@lru_cache(maxsize=64)
def outer_radius(robot: Robot) -> Array:
    """Radius (n,) of the arm where tube i is the outermost, m; for eccentric tubes the sheath's."""
    return np.asarray(np.hypot(*robot.axes.T) + [tube.outer_diameter / 2 for tube in robot.tubes])


@dataclass(frozen=True, eq=False)
class Contacts:
    """Points of the arm closest to bodies."""

    body: Index
    """Numbers (c,) of the bodies."""
    arc_length: Array
    """Arc lengths (c,), m."""
    point: Array
    """Points (c, 3) of the centreline, m."""
    distance: Array
    """Distances (c,) of the arm's surface from the bodies, m."""

    def chosen(self, rows: Mask | Index) -> Contacts:
        """Contacts in some rows."""
        return Contacts(self.body[rows], self.arc_length[rows], self.point[rows], self.distance[rows])

    @property
    def rank(self) -> Index:
        """Index (c,) of each contact among the contacts of its body, from 0; contacts are sorted by body."""
        return np.arange(len(self.body)) - np.searchsorted(self.body, self.body)


@dataclass(frozen=True, eq=False)
class _Near:
    """Contacts within a distance."""

    within: float
    """Distance within which contacts were computed, m."""
    contacts: Contacts
    row: Index
    """Rows (r,) of the grid with a body within `within`."""
    at_least: Array
    """Lower bounds (r,) of the distances near the rows `row`, m."""
    also: frozenset[int]
    """Bodies that are included at any rank."""

    @cached_property
    def bodies(self) -> int:
        """Number of bodies with contacts."""
        return len(np.unique(self.contacts.body))


NONE = np.zeros(0, dtype=int)
NOWHERE = Contacts(NONE, np.zeros(0), np.zeros((0, 3)), np.zeros(0))


@dataclass(frozen=True, eq=False)
class ArmSurface:
    """Surface of the arm of an equilibrium, round at the end of every tube."""

    equilibrium: Equilibrium
    _clear: dict[Scene, tuple[float, bool]] = field(default_factory=dict, init=False, repr=False)
    """Clearances from scenes, with True if exact, False if a lower bound."""
    _known: dict[Scene, _Near] = field(default_factory=dict, init=False, repr=False)
    """Contacts with scenes."""

    @cached_property
    def grid(self) -> Array:
        """Arc lengths (p,) of the finest grid: evenly spaced, and the ends of tubes, where the radius falls."""
        ends = self.equilibrium.tube_end
        tip = self.equilibrium.arc_length[-1]
        s = np.sort(np.concatenate([EVENLY * tip, ends[(ends > 0) & (ends < tip)]]))
        distinct = s[1:] > s[:-1]
        return s if distinct.all() else s[np.append(True, distinct)]

    def at(self, s: Array) -> tuple[Array, Array]:
        """Centreline (p, 3) and radius of the arm (p,) at arc lengths."""
        return self.centreline(s), self.radius(s)

    def line(self, count: int) -> tuple[Array, Array]:
        """Centreline (count, 3) and radius of the arm (count,) at evenly spaced points."""
        return self.at(np.linspace(0.0, self.equilibrium.arc_length[-1], count))

    def centreline(self, s: Array) -> Array:
        """Centreline (p, 3) at arc lengths (p,), m."""
        arm = self.equilibrium
        return _hermite(arm.arc_length, arm.position, arm.frame[:, :, 2], s)

    def radius(self, s: Array) -> Array:
        """Radius (p,) of the arm at arc lengths (p,): the outermost tube, or the sheath of eccentric tubes."""
        ends, thick = self._steps
        return np.asarray(thick[np.searchsorted(ends, s)])

    @cached_property
    def _steps(self) -> tuple[Array, Array]:
        """Arc lengths (n,) of the tube ends in order, and the radius of the arm (n + 1,) between and beyond them."""
        ends = self.equilibrium.tube_end
        order = np.argsort(ends)
        radius = np.append(outer_radius(self.equilibrium.robot)[order], 0.0)
        return ends[order] + 1e-12, np.maximum.accumulate(radius[::-1])[::-1]

    def clearance(self, scene: Scene, enough: float = np.inf) -> float:
        """Smallest distance of the surface from bodies, m; infinite without bodies. Above `enough` it is a lower bound.

        A coarse grid shows on which intervals the distance may be smallest; only these are refined.
        """
        if not scene.bodies:
            return np.inf
        if scene in self._known and enough <= self._known[scene].within:
            distances = self._known[scene]
            if not len(distances.row):
                return distances.within
            smallest = min(distances.within, float(distances.contacts.distance.min(initial=np.inf)))
            doubtful = distances.row[distances.at_least < min(enough, smallest)]
            return min(smallest, self._between(scene, doubtful)) if len(doubtful) else smallest
        known, exact = self._clear.get(scene, (-np.inf, False))
        if not exact and known < enough:
            self._clear[scene] = known, _ = self._clearance(scene, enough)
        return known

    @cached_property
    def _points(self) -> Array:
        """Centreline (p, 3) at the grid."""
        return self.centreline(self.grid)

    @cached_property
    def _radii(self) -> Array:
        """Radius (p,) of the arm at the grid."""
        return self.radius(self.grid)

    @cached_property
    def _few(self) -> Index:
        """Rows of the coarse grid, and rows at the ends of tubes."""
        few, last = np.zeros(len(self.grid), dtype=bool), len(self.grid) - 1
        few[:: STRIDES[0]] = few[last] = True
        few[np.minimum(np.searchsorted(self.grid, self.equilibrium.tube_end), last)] = True
        return few.nonzero()[0]

    def _window(self, rows: Index, stride: int) -> tuple[Array, Array]:
        """Half lengths (r,) of the intervals around rows (r,) of a grid with a stride, and the largest arm radius in
        each, m.

        The arm grows thinner towards its tip: the radius is that of the proximal end.
        """
        grid, half = self.grid, (stride + 1) // 2
        first, end = np.maximum(rows - half, 0), grid[np.minimum(rows + half, len(grid) - 1)]
        return np.maximum(grid[rows] - grid[first], end - grid[rows]), self._radii[first]

    def _clearance(self, scene: Scene, enough: float) -> tuple[float, bool]:
        """Clearance and True, or a lower bound above `enough` and False, m."""
        grid, smallest, rows = self.grid, np.inf, self._few
        for stride, finer in zip(STRIDES, (*STRIDES[1:], 0), strict=True):
            points, radius = self.centreline(grid[rows]), self._radii[rows]
            reach, thick = self._window(rows, stride)
            smallest = min(smallest, float((scene.at_most(points) - radius).min()))
            # Beyond this distance a point cannot decide.
            cutoff = min(max(smallest, 0.0), enough + AHEAD) + reach + thick + BEYOND
            distance = scene.nearest(points, cutoff)
            smallest = min(smallest, float((distance - radius)[distance < cutoff].min(initial=np.inf)))
            bound = self._at_least(scene, distance, reach) - thick
            if bound.min() >= enough:
                return float(bound.min()), False
            rows = rows[bound <= smallest]
            if finer:
                rows = np.unique(self._around(rows, stride, finer))
        return min(smallest, self._between(scene, rows)), True

    def _around(self, rows: Index, stride: int, finer: int) -> Index:
        """Every `finer`-th row (r, k) of the intervals around rows (r,) of a grid with a stride."""
        half = (stride + 1) // 2
        return np.asarray(np.clip(rows[:, None] + np.arange(-half, half + 1, finer), 0, len(self.grid) - 1))

    def _at_least(self, scene: Scene, distance: Array, reach: Array) -> Array:
        """Lower bounds (r,) of minima of the distance within `reach` (r,) of points with distances (r,), m.

        A distance changes by no more than its point moves. Outside a solid body it changes less: at the minimum D the
        shortest line is normal to the arm, whose curvature is k, and |x - y|^2 <= D^2 + (1 + k D) reach^2.
        """
        bound = distance - reach
        if scene.solid:
            outside = np.maximum(distance, 0.0)
            square = outside**2 - (1 + self.bend * outside) * reach**2
            bound = np.maximum(bound, np.where(square > 0, np.sqrt(np.maximum(square, 0.0)), -np.inf))
        return np.asarray(bound)

    @cached_property
    def bend(self) -> float:
        """Upper bound on the curvature of the arm, 1/m, with a reserve for curvature between its points."""
        return 1.2 * float(np.linalg.norm(self.equilibrium.curvature, axis=1).max(initial=0.0))

    def _between(self, scene: Scene, rows: Index) -> float:
        """Smallest distance between points of the grid and their neighbours, m.

        Near a small body the arm comes closer there than the tolerance of a clearance.
        """
        cells = np.unique(np.append(rows, rows - 1))
        cells = cells[(cells >= 0) & (cells < len(self.grid) - 1)]
        if not len(cells):
            return np.inf
        start, length = self.grid[cells], np.diff(self.grid)[cells]
        fraction = np.arange(1, FINER // 2) / (FINER // 2)
        points, radius = self.at((start[:, None] + length[:, None] * fraction).ravel())
        return float((scene.nearest(points) - radius).min())

    def contacts(
        self, scene: Scene, within: float, fewest: int | None = None, also: frozenset[int] = frozenset()
    ) -> Contacts:
        """Contacts closer than `within`, m, sorted by body, then by distance, at most MAX_CONTACTS for each body.

        With `fewest`, only so many nearest bodies need to be included, and in addition the bodies `also`.
        """
        known = self._known.get(scene)
        if known is None or not (known.within >= within or (fewest and known.bodies >= fewest and also <= known.also)):
            known = self._known[scene] = self._near(scene, within, fewest, also)
        return known.contacts.chosen(known.contacts.distance <= within) if len(known.contacts.body) else NOWHERE

    def look_around(self, monitor: ClearanceMonitor, within: float) -> None:
        """Compute contacts within a distance, m, unless a monitor shows that there are none."""
        if monitor.far(*self._sparse(within)):
            self._known[monitor.scene] = _Near(within, NOWHERE, NONE, np.zeros(0), frozenset())
        else:
            self.contacts(monitor.scene, within)

    def _sparse(self, within: float) -> tuple[Array, Array]:
        """Points (p, 3) of the centreline, and distances (p,), m, that cover everything within `within` of the surface.

        These are the shape points and some points between them.
        """
        arm = self.equilibrium
        at, length = arm.position, arm.arc_length[1:] - arm.arc_length[:-1]
        ahead = arm.frame[:, :, 2]
        cells = np.concatenate([at[:-1], at[1:], ahead[:-1] * length[:, None], ahead[1:] * length[:, None]])
        between = (BETWEEN @ cells.reshape(4, -1)).reshape(-1, 3)
        half = length / (2 * PARTS)
        first = half[:1] if len(half) else np.zeros(1)  # an arm that is fully withdrawn is one point
        reach = np.concatenate([first, *[half] * PARTS])
        np.maximum(reach[1 : len(length)], half[1:], out=reach[1 : len(length)])
        return np.concatenate([at, between]), reach + (within + float(outer_radius(arm.robot).max()) + BEYOND)

    def _near(self, scene: Scene, within: float, fewest: int | None, also: frozenset[int]) -> _Near:
        """Contacts within a distance, found on successively finer grids.

        Pairs of a body and an interval of the arm are dropped as soon as a bound shows that they are too far apart, or
        farther than `fewest` bodies.
        """
        few, limit = self._few, within
        always = np.fromiter(also, int, len(also))
        reach, thick = self._window(few, STRIDES[0])
        body, at = scene.pairs(self.centreline(self.grid[few]), within + reach + thick + BEYOND)
        row, distance, bound = few[at], np.zeros(0), np.zeros(0)
        for stride, finer in zip(STRIDES, (*STRIDES[1:], 0), strict=True):
            if not len(body):
                return _Near(within, NOWHERE, row, bound, also)
            reach, thick = self._window(row, stride)
            distance = scene.pair_distances(body, self._points[row], limit + reach + thick + BEYOND)
            bound = self._at_least(scene, distance, reach) - thick
            if fewest:
                within = min(within, _farthest(body, distance - self._radii[row], fewest))
            near = bound <= (np.where(np.isin(body, always), limit, within) if also else within)
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
        nearest = np.flatnonzero((distance <= before) & (distance <= after))
        nearest = nearest[np.lexsort((row[nearest], distance[nearest], body[nearest]))]
        body, row = body[nearest], row[nearest]
        contacts = Contacts(body, self.grid[row], self._points[row], distance[nearest])
        first = contacts.rank < MAX_CONTACTS
        return self._closer(scene, contacts.chosen(first), row[first])

    def _closer(self, scene: Scene, contacts: Contacts, row: Index) -> Contacts:
        """Contacts refined to a minimum between neighbouring grid points."""
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
            np.where(closer, finer[every, best], contacts.arc_length),
            np.where(closer[:, None], points[every, best], contacts.point),
            np.where(closer, between[every, best], contacts.distance),
        )
        return out.chosen(np.lexsort((out.distance, out.body)))


def _farthest(body: Index, distance: Array, count: int) -> float:
    """Distance within which `count` different bodies occur in pairs (k,); infinite for fewer bodies."""
    smallest = np.full(body.max(initial=-1) + 1, np.inf)
    np.minimum.at(smallest, body, distance)
    return float(np.partition(smallest, count - 1)[count - 1]) if len(smallest) >= count else np.inf


def _once(body: Index, rows: Index, count: int) -> tuple[Index, Index]:
    """Distinct pairs of bodies (k,) and rows (k, r) of `count`, in order, by a table, which is faster than sorting."""
    known = np.zeros(body.max(initial=-1) + 1, dtype=bool)
    known[body] = True
    table = np.zeros((np.count_nonzero(known), count), dtype=bool)
    table[(np.cumsum(known) - 1)[body][:, None], rows] = True
    index, row = np.nonzero(table)
    return np.flatnonzero(known)[index], row


def _hermite(s: Array, value: Array, slope: Array, at: Array) -> Array:
    """(p, 3) cubic interpolation of a curve given with its tangents at arc lengths s (m,)."""
    if len(s) < 2:
        return np.repeat(value, len(at), axis=0)
    k, length, x = between(s, at)
    return np.asarray(cubic(value[k], value[k + 1], slope[k], slope[k + 1], x[:, None], length[:, None]))
