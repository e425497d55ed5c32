"""Motion as cubics between knots, and distances of arms from bodies: expressions of the programs of a motion.

`smoothing` states the program of a path with them, `optimal_motion` those of a user.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..block.transcription.arm import cubic
from ..block.transcription.explicit import MAX_EXPANDED_SIZE, Kind, explicit_arm, explicit_joints, explicit_size
from ..bodies.corridors import MeshObstacle
from ..bodies.distance_field import DistanceField
from ..bodies.obstacles import Obstacle
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
        """(m, K - 1) accelerations q'' at the beginning of every interval, linear up to `late` at its end."""
        return (6 * self.mean - 4 * self.v[:, :-1] - 2 * self.v[:, 1:]) / self.h

    @cached_property
    def late(self) -> Any:
        """(m, K - 1) accelerations q'' at the end of every interval."""
        return (2 * self.v[:, :-1] + 4 * self.v[:, 1:] - 6 * self.mean) / self.h

    @property
    def inner(self) -> Any:
        """(m, 2K - 2) inner Bezier coefficients of q; linear inequalities on them are valid between knots too."""
        return ca.horzcat(self.q[:, :-1] + self.h / 3 * self.v[:, :-1], self.q[:, 1:] - self.h / 3 * self.v[:, 1:])

    @property
    def length(self) -> Any:
        """Sum over the rows of int q'^2."""
        mean, v_0, v_1 = self.mean, self.v[:, :-1], self.v[:, 1:]
        squares = 36 * mean**2 - 6 * mean * (v_0 + v_1) + 4 * v_0**2 + 4 * v_1**2 - 2 * v_0 * v_1
        return ca.sum1(ca.sum2(self.h * squares / 30))

    @property
    def effort(self) -> Any:
        """Sum over the rows of int q''^2, with q'' linear between knots."""
        early, late = self.early, self.late
        return ca.sum1(ca.sum2(self.h * (early**2 + early * late + late**2) / 3))

    def inside(self, x: float) -> Any:
        """(m, K - 1) values at the fraction x of every interval."""
        return cubic(self.q[:, :-1], self.q[:, 1:], self.v[:, :-1], self.v[:, 1:], x, self.h)


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


# --- Functions of knots -----------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class KnotFunction:
    """Function (x (a,), p (r,)) -> (b,) of one knot, with its derivatives by x."""

    value: ca.Function
    slope: ca.Function
    """Function (x, p) -> Jacobian (b, a) of the values."""
    gradient: ca.Function
    """(x, p, weight (b,)) -> gradient (a,) of the weighted sum."""
    hessian: ca.Function
    """(x, p, weight) -> Hessian (a, a) of the weighted sum, or of its first rows."""

    @staticmethod
    def of(value: ca.Function, curved: int | None = None, damping: ArrayLike = 0.0) -> KnotFunction:
        """Function with derivatives; second ones only of the first `curved` rows, by default of all.

        Args:
            damping: (a,) added to the diagonal of the Hessian: steps are shorter, the optimum is the same.
        """
        inputs: list[Any] = [*(value.sx_in() if value.is_a("SXFunction") else value.mx_in())]
        x, p = inputs
        y: Any = value(x, p)
        weight: Any = type(x).sym("weight", y.numel())
        gradient, hessian = ca.gradient(ca.dot(weight, y), x), ca.hessian(ca.dot(weight[:curved], y[:curved]), x)[0]
        diagonal = ca.diag(ca.sparsify(ca.DM(np.broadcast_to(damping, x.numel()))))
        return KnotFunction(
            value,
            ca.Function("slope", [x, p], [ca.jacobian(y, x)]),
            ca.Function("gradient", [x, p, weight], [ca.densify(gradient)]),
            ca.Function("hessian", [x, p, weight], [hessian + diagonal]),
        )

    def switched(self, off: float) -> KnotFunction:
        """Function with a last entry of x that is 1 or 0; with 0 its values are `off`, at no cost."""
        (a, r), b = (self.value.size1_in(k) for k in range(2)), self.value.size1_out(0)
        x, p, weight = ca.MX.sym("x", a + 1), ca.MX.sym("p", r), ca.MX.sym("weight", b)

        def switch(function: ca.Function, otherwise: float) -> ca.Function:
            inputs = [x, p, weight][: function.n_in()]
            own = function.mx_in()
            zero = ca.Function("off", own, [ca.DM(function.sparsity_out(0), otherwise)])
            out = ca.Function.if_else("switch", function, zero)(x[a], x[:a], *inputs[1:])
            rows = {"slope": (0, 1), "gradient": (1, 0), "hessian": (1, 1)}.get(function.name(), (0, 0))
            out = ca.diagcat(out, ca.MX(*rows)) if any(rows) else out
            return ca.Function(function.name(), inputs, [ca.densify(out) if function.name() == "gradient" else out])

        return KnotFunction(
            switch(self.value, off), switch(self.slope, 0.0), switch(self.gradient, 0.0), switch(self.hessian, 0.0)
        )

    def at(self, count: int) -> ca.Function:
        """Function (x (a, count), p) -> (b, count), knot by knot; p is no unknown.

        Its derivatives are one small block for every knot. CasADi's own would pass through all knots once for every
        group of unknowns without a common row of the program, several times as often.
        """
        (a, r), b = (self.value.size1_in(k) for k in range(2)), self.value.size1_out(0)
        sizes = {"x": (a, count), "p": (r, 1), "out_y": (b, count), "adj_y": (b, count)}
        at: dict[str, Any] = {name: ca.MX.sym(name, *size) for name, size in sizes.items()}
        more: dict[str, Any] = {"out_adj_x": ca.MX.sym("out_adj_x", a, count), "out_adj_p": ca.MX.sym("out_adj_p", r)}
        numbers = ca.repmat(at["p"], 1, count)
        mapped, slope, gradient, hessian = (
            function.map(count)(at["x"], numbers, *[at["adj_y"]] * (function.n_in() - 2))
            for function in (self.value, self.slope, self.gradient, self.hessian)
        )
        by_x: Any = ca.diagcat(*ca.horzsplit(slope, a))
        second: Any = ca.diagcat(*ca.horzsplit(hessian, a))
        # CasADi looks up derivatives by their names in the cache of a function before it makes them. Those that are
        # inlined are not evaluated where a program does not need them.
        name = f"knotwise_{self.value.name()}"
        inline: dict[str, Any] = {"always_inline": True}
        first = list(at)[:3]
        jacobian = ca.Function(
            f"jac_{name}", [at[k] for k in first], [by_x, ca.MX(b * count, r)], first, ["jac_y_x", "jac_y_p"], inline
        )
        rows: dict[str, list[Any]] = {"adj_x": [second, ca.MX(a * count, r), ca.MX(a * count, b * count), by_x.T]}
        rows["adj_p"] = [ca.MX(r, part.shape[1]) for part in rows["adj_x"]]
        names = [f"jac_{row}_{column}" for row in rows for column in at]
        inputs = {**at, **more}
        curvature = ca.Function(
            f"jac_adj1_{name}", list(inputs.values()), rows["adj_x"] + rows["adj_p"], list(inputs), names, inline
        )
        # Forward derivatives are products with the Jacobian, backward ones are not.
        options: dict[str, Any] = {"never_inline": True, "enable_forward": False, "jac_penalty": -1}
        cached = {**options, "cache": {curvature.name(): curvature}}
        out = [gradient, ca.MX.zeros(r, 1)]
        backward = ca.Function(f"adj1_{name}", list(at.values()), out, list(at), ["adj_x", "adj_p"], cached)
        cached = {**options, "cache": {jacobian.name(): jacobian, backward.name(): backward}}
        return ca.Function(name, [at["x"], at["p"]], [mapped], ["x", "p"], ["y"], cached)


# --- Arms and bodies --------------------------------------------------------------------------------------------------


SPLITS = 4
"""Number of points per step of the arm for its distance from bodies."""

MAX_NODES = 1_000_000
"""Maximum number of nodes of a distance table: its splines and their derivatives take 32 bytes for each."""

# Steps of voxels would be corners for Newton's method.
BLUR = 1.5
"""Standard deviation, in nodes, of the Gaussian filter on a table of distances."""

TABLES = (MeshObstacle, DistanceField)
"""Bodies without a formula for their distance."""


class KnotInputs(NamedTuple):
    """Symbols of `arm_at_knot`, and their parts."""

    x: Any
    p: Any
    tip: Any
    """Tip rotations (n,)."""
    translations: Any
    margin: Any
    robot: Any
    """Numbers of the robot."""
    radius: Any
    """Radius of the arm (n,), m."""


def knot_inputs(kind: Kind) -> KnotInputs:
    """Symbols of `arm_at_knot`."""
    n = kind.n
    x, p = ca.MX.sym("x", 2 * n + 1), ca.MX.sym("p", kind.size + n)
    return KnotInputs(x, p, *ca.vertsplit(x, [0, n, 2 * n, 2 * n + 1]), *ca.vertsplit(p, [0, kind.size, kind.size + n]))


# Least time hardly depends on most joints: without damping steps are so long that equilibria do not follow. Of twelve
# motions of the thesis' robot around a sphere, four were not solved without it. One was not solved with it, which also
# had a shorter search and fewer iterations.
DAMPING = 1e-3, 0.1
"""Damping of the tip rotations, 1/rad^2, and of the translations, 1/m^2, of every equilibrium."""


@lru_cache(maxsize=8)
def arm_at_knot(kind: Kind, what: str, bodies: tuple[Obstacle, ...] = ()) -> KnotFunction:
    """Function (x (2n + 1,), p) that returns quantities of the equilibrium at a knot.

    `x`: tip rotations, translations, margin; `p`: robot, radius of the arm (n,). Its value is "balance": joint
    rotations and determinants of the Jacobi fields; "tip": position, m, and direction; "points": (3 p,), m; or
    "distances" of points of the arm from bodies, one body after the other, m. Second derivatives of determinants and
    distances take four times as long as all others, and save a third of the iterations: they are 0.
    """
    n = kind.n
    x, p, *at, radius = knot_inputs(kind)
    if what == "balance":
        out: Any = ca.vertcat(*explicit_joints(kind)(*at))
    else:
        points, tangents, s = explicit_arm(kind)(*at)[2:]
        if what == "tip":
            out = ca.vertcat(points[:, -1], tangents[:, -1])
        elif what == "points":
            out = ca.vec(points)
        else:
            distances = body_distances(kind, points.shape[1], bodies)
            out = ca.vec(distances(points, tangents, s, at[1], at[3], radius))
    value = ca.Function(what, [x, p], [ca.densify(out)])
    short = explicit_size(kind) < MAX_EXPANDED_SIZE and not any(isinstance(body, TABLES) for body in bodies)
    damping = np.append(np.repeat(DAMPING, n), 0.0) * (what == "balance")
    return KnotFunction.of(value.expand() if short else value, {"balance": n, "distances": 0}.get(what), damping)


def body_distances(kind: Kind, count: int, bodies: Sequence[Obstacle]) -> ca.Function:
    """Function from the points of an arm to the distances (a, bodies) of its surface from bodies, m.

    Inputs are points and tangents (3, count), their arc lengths, translations, robot, and radius of the arm (n,).
    """
    n = kind.n
    inputs = [ca.MX.sym("p", 3, count), ca.MX.sym("t", 3, count), ca.MX.sym("s", count)]
    inputs += [ca.MX.sym("d", n), ca.MX.sym("robot", kind.size), ca.MX.sym("r", n)]
    points, thick = _places(kind, count)(*inputs)
    x, y, z = (ca.SX.sym(axis) for axis in "xyz")
    columns = []
    for k, body in enumerate(bodies):
        if isinstance(body, TABLES):
            columns.append((_tabulated(body, points) - thick).T)
        else:
            distance = ca.Function(f"body_{k}", [x, y, z], [body.distance(x, y, z)]).map(points.shape[1])
            columns.append((distance(points[0, :], points[1, :], points[2, :]) - thick).T)
    return ca.Function("distances", inputs, [ca.horzcat(*columns)])


def _tabulated(body: MeshObstacle | DistanceField, points: Any) -> Any:
    """Distances (1, a) of points (3, a) from a body with a table, m; beyond its lattice, those of its border."""
    lattice = body.lattice
    at = ca.DM(lattice.frame.axes.T) @ (points - ca.repmat(ca.DM(lattice.frame.origin), 1, points.shape[1]))
    last = ca.DM((np.array(lattice.values.shape) - 1) * lattice.spacing)
    inside = ca.fmin(ca.fmax(at, 0), ca.repmat(last, 1, points.shape[1]))
    return table_function(body).map(points.shape[1])(inside)


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
    positions, thick = [], []
    for k in range(count - 1):
        h = s[k + 1] - s[k]
        for x in np.arange(1, SPLITS + 1) / SPLITS:
            positions.append(cubic(points[:, k], points[:, k + 1], tangents[:, k], tangents[:, k + 1], x, h))
            # Steps do not extend across the end of a tube, so the middle decides.
            thick.append(ca.mmax(radius * ((s[k] + s[k + 1]) / 2 < end)))
    out = [ca.horzcat(*positions), ca.horzcat(*thick)]
    return ca.Function("places", [points, tangents, s, shift, robot, radius], out)
