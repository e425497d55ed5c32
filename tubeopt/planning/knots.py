"""Motion as cubics between knots, and distances of arms from bodies: expressions of the programs of a motion.

`smoothing` states the program of a path with them, `optimal_motion` those of a user.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np
import scipy

from ..block.transcription.explicit import Kind
from ..bodies.corridors import MeshObstacle
from ..bodies.distance_field import DistanceField
from ..bodies.obstacles import Obstacle
from ..inverse.arm_surface import cubic
from ..typing import Array

# --- Cubics -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Cubics:
    """Cubics q of a time from 0 to 1 between K knots, from values and slopes there (Hermite)."""

    q: Any
    """(m, K) values at knots."""
    v: Any
    """(m, K) slopes q' at knots."""
    h: Any
    """(m, K - 1) durations of the intervals, equal in a column."""

    @cached_property
    def mean(self) -> Any:
        """(m, K - 1) mean slopes: the mean of the three Bezier coefficients of q'."""
        return (self.q[:, 1:] - self.q[:, :-1]) / self.h

    @property
    def middle(self) -> Any:
        """(m, K - 1) middle Bezier coefficients of q'; the outer two are the slopes at knots."""
        return 3 * self.mean - self.v[:, :-1] - self.v[:, 1:]

    @cached_property
    def early(self) -> Any:
        """(m, K - 1) q'' at the beginning of every interval; q'' is linear to `late`."""
        return (6 * self.mean - 4 * self.v[:, :-1] - 2 * self.v[:, 1:]) / self.h

    @cached_property
    def late(self) -> Any:
        """(m, K - 1) q'' at the end of every interval."""
        return (2 * self.v[:, :-1] + 4 * self.v[:, 1:] - 6 * self.mean) / self.h

    @property
    def inner(self) -> Any:
        """(m, 2K - 2) inner Bezier coefficients of q: their linear inequalities hold between knots too."""
        return ca.horzcat(self.q[:, :-1] + self.h / 3 * self.v[:, :-1], self.q[:, 1:] - self.h / 3 * self.v[:, 1:])

    @property
    def length(self) -> Any:
        """Sum over the rows of int q'^2."""
        mean, v_0, v_1 = self.mean, self.v[:, :-1], self.v[:, 1:]
        squares = 36 * mean**2 - 6 * mean * (v_0 + v_1) + 4 * v_0**2 + 4 * v_1**2 - 2 * v_0 * v_1
        return ca.sum1(ca.sum2(self.h * squares / 30))

    @property
    def effort(self) -> Any:
        """Sum over the rows of int q''^2, of which q'' is linear between knots."""
        early, late = self.early, self.late
        return ca.sum1(ca.sum2(self.h * (early**2 + early * late + late**2) / 3))

    def inside(self, x: float) -> Any:
        """(m, K - 1) values at the fraction x of every interval."""
        v_0, v_1 = self.v[:, :-1] * self.h, self.v[:, 1:] * self.h
        outer = (1 - x) ** 2 * (1 + 2 * x) * self.q[:, :-1] + x**2 * (3 - 2 * x) * self.q[:, 1:]
        return outer + x * (1 - x) ** 2 * v_0 - x**2 * (1 - x) * v_1


def differences(q: Array, time: Array) -> Array:
    """(K, m) rates at knots by differences, at rest at both ends."""
    v = np.gradient(q, time, axis=0)
    v[0], v[-1] = 0.0, 0.0
    return np.asarray(v)


def ample_duration(q: Array, time: Array, rate: Array, acceleration: Array) -> float:
    """Duration in which knots q (K, m) at times from 0 to 1 are passed well within the limits (m,), s."""
    v, step = differences(q, time), np.diff(time)[:, None]
    speed = (np.abs(np.diff(q, axis=0)) / step / rate).max()
    hard = (np.abs(np.diff(v, axis=0)) / step / acceleration).max()
    # Between knots cubics are faster than differences.
    return float(max(2.0 * speed, 1.5 * np.sqrt(hard), 1e-2))


# --- Arms and bodies --------------------------------------------------------------------------------------------------


SPLITS = 4
"""Points per step of the arm at which its distance from bodies is measured."""

MAX_NODES = 1_000_000
"""Maximum number of nodes of a distance table: its splines and their derivatives take 32 bytes for each."""

# Steps of voxels would be corners for Newton's method.
BLUR = 1.5
"""Standard deviation, in nodes, of the Gaussian filter on a table of distances."""

TABLES = (MeshObstacle, DistanceField)
"""Bodies without a formula for their distance."""


def body_distances(kind: Kind, count: int, bodies: Sequence[Obstacle]) -> ca.Function:
    """Function of an arm of `count` points: distances (a, bodies) of its surface from bodies, by its points, m.

    Inputs are points and tangents (3, count), their arc lengths, translations, robot, and radius of the arm (n,).
    """
    n = kind.n
    inputs = [ca.MX.sym("p", 3, count), ca.MX.sym("t", 3, count), ca.MX.sym("s", count)]
    inputs += [ca.MX.sym("d", n), ca.MX.sym("robot", kind.size), ca.MX.sym("r", n)]
    places, thick = _places(kind, count)(*inputs)
    x, y, z = (ca.SX.sym(axis) for axis in "xyz")
    columns = []
    for k, body in enumerate(bodies):
        if isinstance(body, TABLES):
            columns.append((_tabulated(body, places) - thick).T)
        else:
            distance = ca.Function(f"body_{k}", [x, y, z], [body.distance(x, y, z)]).map(places.shape[1])
            columns.append((distance(places[0, :], places[1, :], places[2, :]) - thick).T)
    return ca.Function("distances", inputs, [ca.horzcat(*columns)])


def _tabulated(body: MeshObstacle | DistanceField, places: Any) -> Any:
    """(1, a) distances of places (3, a) from a body that is a table; beyond its lattice, those of its border, m."""
    lattice = body.lattice
    at = ca.DM(lattice.frame.axes.T) @ (places - ca.repmat(ca.DM(lattice.frame.origin), 1, places.shape[1]))
    last = ca.DM((np.array(lattice.values.shape) - 1) * lattice.spacing)
    inside = ca.fmin(ca.fmax(at, 0), ca.repmat(last, 1, places.shape[1]))
    return table_function(body).map(places.shape[1])(inside)


@lru_cache(maxsize=8)
def table_function(body: MeshObstacle | DistanceField) -> ca.Function:
    """Function of a place (3,), m from the first node of a body's lattice: cubic B-splines weighted by its distances.

    The distances are weights, not interpolated values, so no system is solved and a table of millions is a function at
    once. This and the filter blur the steps of voxels. Tables of more than MAX_NODES are thinned out.
    """
    lattice = body.lattice
    stride = int(np.ceil((lattice.values.size / MAX_NODES) ** (1 / 3)))
    few = lattice.values[::stride, ::stride, ::stride].astype(float)
    values = np.pad(scipy.ndimage.gaussian_filter(few, BLUR, mode="nearest"), (1, 1 + (stride > 1)), mode="edge")
    # The weight of node i belongs to the spline on the knots from i - 2 to i + 2.
    knots = [
        (np.arange(count + 4) - 3) * stride * step
        for count, step in zip(values.shape, lattice.spacing.tolist(), strict=True)
    ]
    return ca.Function.bspline("table", knots, values.ravel(order="F"), [3, 3, 3], 1)


def _places(kind: Kind, count: int) -> ca.Function:
    """Points along an arm (3, a), `SPLITS` per step, and its radius there (1, a)."""
    points, tangents, s = ca.SX.sym("p", 3, count), ca.SX.sym("t", 3, count), ca.SX.sym("s", count)
    shift, robot, radius = ca.SX.sym("d", kind.n), ca.SX.sym("robot", kind.size), ca.SX.sym("r", kind.n)
    end = shift + kind.reach(robot)
    places, thick = [], []
    for k in range(count - 1):
        h = s[k + 1] - s[k]
        for x in np.arange(1, SPLITS + 1) / SPLITS:
            places.append(cubic(points[:, k], points[:, k + 1], tangents[:, k], tangents[:, k + 1], x, h))
            # Steps do not extend across the end of a tube, so the middle decides.
            thick.append(ca.mmax(radius * ((s[k] + s[k + 1]) / 2 < end)))
    out = [ca.horzcat(*places), ca.horzcat(*thick)]
    return ca.Function("places", [points, tangents, s, shift, robot, radius], out)
