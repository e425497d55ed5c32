"""The way ahead as knots, each one equilibrium: what they are, how they change, and one quadratic program for all.

A knot is a point of the chart (tip rotations and translations), in which the equilibrium block is explicit: joint
values, tip, shape and the Jacobi fields that tell the margin are functions of it, and there is no snap at which their
derivatives end. Linearised at N knots, the least way through all of them to the target is one quadratic program:

    min  N sum |joints_k - joints_k-1|^2 + (tip_N - target)^2 w^2 + rho sum slack_k
    with ranges and order of the joints, margin_k >= floor - slack_k, clearance_k >= wanted - slack_k, and changes of
    at most `trust`.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from ..block.transcription.buffered import Buffered
from ..block.transcription.explicit import Kind, explicit_arm
from ..bodies.scene import Scene
from ..errors import Settings
from ..inverse.tip_coordinates import TipCoordinates
from ..typing import Array, Mask

SOLVER, QUIET = "ipqp", {"print_iter": False, "print_header": False, "print_info": False, "error_on_fail": False}
"""CasADi's interior point method. On programs of 20 knots of the thesis' robot it took 0.7 ms of processor time, exact
to 1e-6; qpOASES 3.9, HiGHS 4.8, OSQP 4.8 without reaching 1e-4 on half of them, ProxQP 17, qrqp failed."""


@dataclass(frozen=True)
class HorizonSolver(Settings):
    """Settings of the planned path of a `PredictiveServo`.

    Raises:
        InputError: a count that is no whole number of at least 1, another number that is not positive.
    """

    margin_room: float = 0.01
    """Margin above its floor that knots keep: between them it is less."""
    clearance_room: float = 2e-4
    """Reserve of the clearance, m."""
    lacking: float = 0.02
    """Largest violation of a path that the robot follows: of a field, which is 1 without torsion, and of a clearance
    over its reserve.
    """
    trust: float = 0.3
    """Largest change of a knot by one program, in units of the scales. It is halved where a change undoes the last one,
    as where tubes end together and derivatives differ to either side, and doubled where not."""
    calm: float = 0.01
    """Lower limit of that largest change."""
    patience: int = 20
    """Number of steps that the robot waits for an allowed path."""
    seconds: float = 1.0
    """Maximum duration of the search for joint values of a new target, s."""
    close: float = 0.01
    """Distance of the tip from its target, as a fraction of the robot's length, below which a single step suffices."""
    elsewhere: float = 0.05
    """Distance between targets, as a fraction of the robot's length, above which a path is planned anew."""
    tip_weight: float = 100.0
    """Weight of the tip's distance from the target over the robot's length, relative to the joint motion over its
    scales.
    """
    turn_weight: float = 0.05
    """Weight of the motion of the tip rotations, relative to that of the joints."""
    slack_price: float = 30.0
    """Price per unit of slack: of the smallest field, and of a clearance over a tenth of the robot's length."""
    damping: float = 1e-6
    """Weight of changes of the knots."""
    body_reach: float = 0.05
    """Distance from obstacles, as a fraction of the robot's length, within which they count at a knot."""
    contacts: int = 3
    """Bodies' points, at most, that a knot keeps clear of."""
    splits: int = 4
    """Places per step between points of the arm at which its distance from bodies is measured."""


DEFAULT_HORIZON = HorizonSolver()


@lru_cache(maxsize=16)
def _linearised(kind: Kind, knots: int, thread: int) -> Buffered:
    """Rotations, fields, points and the last tangent of an arm, in one column, their derivatives by tip rotations and
    translations, and arc lengths, of as many knots."""
    tip, shift = ca.MX.sym("z", kind.n), ca.MX.sym("d", kind.n)
    floor, robot = ca.MX.sym("mu"), ca.MX.sym("robot", kind.size)
    rotations, fields, points, tangents, along = explicit_arm(kind)(tip, shift, floor, robot)
    values = ca.vertcat(rotations, ca.vec(fields), ca.vec(points), tangents[:, -1])
    slopes = ca.densify(ca.jacobian(values, ca.vertcat(tip, shift)))
    return Buffered(ca.Function("knot", [tip, shift, floor, robot], [values, slopes, along]).map(knots))


@dataclass(frozen=True, eq=False)
class Knots:
    """K knots of a chart."""

    chart: TipCoordinates
    z: Array
    """(K, m)."""
    joints: Array
    """(K, m) rad and m."""
    fields: Array
    """(K, f) above 0 where the margin is above its floor."""
    points: Array
    """(K, p, 3) of the arm, m."""
    direction: Array
    """(K, 3) of its tip."""
    along: Array
    """(K, p) arc lengths of the points, m."""
    slopes: tuple[Array, Array, Array, Array]
    """Of joints, fields, points and direction by z over the scales, with m columns behind."""

    @staticmethod
    def at(chart: TipCoordinates, z: Array, floor: float) -> Knots:
        """Those of points (K, m), with a floor of the margin."""
        n, (count, m) = chart.space.robot.n_tubes, z.shape
        function = _linearised(chart.kind, count, threading.get_ident())
        values, slopes, along = function(z[:, :n], chart.translations(z), floor, chart.parameters)
        first, last = n + explicit_arm(chart.kind).numel_out(1), values.shape[1] - 3
        spread = np.concatenate([np.eye(n, m), chart.space.spread[n:]]) * chart.space.scale
        # In memory one column follows the other: (K, 2n, rows).
        by_z = slopes.reshape(count, 2 * n, -1).transpose(0, 2, 1) @ spread
        slide = np.tile(np.diag(chart.space.scale)[n:], (count, 1, 1))
        parts = (
            np.concatenate([by_z[:, :n], slide], axis=1),
            by_z[:, n:first],
            by_z[:, first:last].reshape(count, -1, 3, m),
            by_z[:, last:],
        )
        joints = np.concatenate([values[:, :n], z[:, n:]], axis=1)
        points = values[:, first:last].reshape(count, -1, 3).copy()
        return Knots(chart, z, joints, values[:, n:first].copy(), points, values[:, last:].copy(), along.copy(), parts)

    @property
    def tip(self) -> Array:
        """(K, 3) m."""
        return self.points[:, -1]

    def contacts(self, scene: Scene, clearance: float, solver: HorizonSolver) -> tuple[Array, Array]:
        """(K, C) how much farther from bodies than the clearance (m) arms are where they come closest, infinite
        where there are none, and (K, C, m) its derivatives."""
        space, (count, m) = self.chart.space, self.z.shape
        most, splits = solver.contacts, solver.splits
        gap, slope = np.full((count, most), np.inf), np.zeros((count, most, m))
        x = np.arange(splits) / splits
        fine, along, moved = (_between(table, x) for table in (self.points, self.along, self.slopes[2]))
        end = self.chart.translations(self.z) + [tube.length - tube.straight_length for tube in space.robot.tubes]
        for k in range(count):
            radius = np.where(along[k, :, None] <= end[k] + 1e-12, self.chart.radius, 0.0).max(1)
            bodies = scene.close(fine[k], clearance + solver.body_reach * space.length + float(radius.max()))
            if not bodies:
                continue
            distance = scene.distances(bodies, fine[k]) - radius - clearance
            place = distance.argmin(1)
            nearest = np.argsort(distance.min(1))[:most]
            body, at = [bodies[i] for i in nearest], place[nearest]
            gap[k, : len(at)] = distance[nearest, at]
            away = scene.gradients(body, fine[k, at])
            slope[k, : len(at)] = (away[:, None] @ moved[k, at])[:, 0]
        return gap, slope


def _between(table: Array, x: Array) -> Array:
    """(K, p', ...) rows of (K, p, ...), and between each and the next those at shares x."""
    shape = (1, 1, len(x), *[1] * (table.ndim - 2))
    a, b = table[:, :-1, None], table[:, 1:, None]
    inner = a + x.reshape(shape) * (b - a)
    return np.concatenate([inner.reshape(len(table), -1, *table.shape[2:]), table[:, -1:]], axis=1)


@dataclass(frozen=True, eq=False)
class Aim:
    """Where the tip shall be, m, and along which unit vector it shall point, or None."""

    position: Array
    direction: Array | None


def improvement(
    knots: Knots, aim: Aim, contacts: tuple[Array, Array], trust: float, solver: HorizonSolver
) -> Array | None:
    """(N, m) the change over the scales of all knots but the first by one quadratic program, each at most `trust`; None
    where the solver finds no answer."""
    (way, right), (rows, least) = _way(knots, aim, solver), _rows(knots, contacts)
    n, count, width = rows.shape
    m = width - 1
    hessian, matrix = np.zeros((n * width, n * width)), np.zeros((n, count, n, width))
    own = (np.arange(n)[:, None] * width + np.arange(m)).ravel()
    hessian[np.ix_(own, own)] = way.T @ way + solver.damping * np.eye(n * m)
    gradient = np.full((n, width), solver.slack_price)
    gradient[:, :m] = -(right @ way).reshape(n, m)
    matrix[np.arange(n), :, np.arange(n)] = rows
    lower, upper = np.zeros((n, width)), np.full((n, width), np.inf)
    lower[:, :m], upper[:, :m] = _range(knots, trust)
    program = _program(n, m, count)
    found = program(
        h=_sparse(program.sparsity_in("h"), hessian),
        a=_sparse(program.sparsity_in("a"), matrix.reshape(n * count, n * width)),
        g=gradient.ravel(),
        lba=least.ravel(),
        lbx=lower.ravel(),
        ubx=upper.ravel(),
    )
    answer = np.asarray(found["x"]).reshape(n, width)[:, :m]
    return answer if program.stats()["success"] and np.isfinite(answer).all() else None


def _way(knots: Knots, aim: Aim, solver: HorizonSolver) -> tuple[Array, Array]:
    """Rows and right-hand sides in least squares, over the scales: the way from knot to knot, and the tip's distance
    from its aim."""
    space, (count, m) = knots.chart.space, knots.z.shape
    tubes, n, weight = space.robot.n_tubes, count - 1, np.sqrt(count - 1.0)
    turned = np.tile(solver.turn_weight * np.eye(tubes, m), (count, 1, 1))
    slope = np.concatenate([knots.slopes[0] / space.scale[:, None], turned], 1)
    place = np.concatenate([knots.joints / space.scale, solver.turn_weight * knots.z[:, :tubes]], axis=1)
    matrix = np.zeros((n, m + tubes, n, m))
    each = np.arange(n)
    matrix[each, :, each] = weight * slope[1:]
    matrix[each[1:], :, each[:-1]] = -weight * slope[1:-1]
    right = -weight * np.diff(place, axis=0)
    wanted = [(aim.position - knots.tip[-1], knots.slopes[2][-1, -1])]
    if aim.direction is not None:
        wanted.append(((aim.direction - knots.direction[-1]) * space.length, knots.slopes[3][-1] * space.length))
    last = np.zeros((3 * len(wanted), n * m))
    last[:, -m:] = solver.tip_weight / space.length * np.concatenate([slope for _, slope in wanted])
    gap = solver.tip_weight / space.length * np.concatenate([gap for gap, _ in wanted])
    return np.concatenate([matrix.reshape(-1, n * m), last]), np.concatenate([right.ravel(), gap])


def _rows(knots: Knots, contacts: tuple[Array, Array]) -> tuple[Array, Array]:
    """(N, r, m + 1) and (N, r): rows of every knot but the first over the scales and its slack, and what they are at
    least: ranges and order of the joints, margin, clearance."""
    space, joints, slope = knots.chart.space, knots.joints, knots.slopes[0]
    n = space.robot.n_tubes
    turn, order = slope[:, :n], space.rows @ slope / space.length
    gap, toward = contacts
    size = 1 + np.abs(knots.fields)
    rows = [turn, -turn, order, knots.slopes[1] / size[..., None], toward / (0.1 * space.length)]
    least = [
        (space.lower - joints)[:, :n],
        (joints - space.upper)[:, :n],
        (space.least - joints @ space.rows.T) / space.length,
        -knots.fields / size,
        -gap / (0.1 * space.length),
    ]
    hard = 2 * n + len(space.least)
    matrix = np.concatenate(rows, axis=1)
    slack = np.ones((*matrix.shape[:2], 1))
    slack[:, :hard] = 0.0
    return np.concatenate([matrix, slack], axis=2)[1:], np.concatenate(least, axis=1)[1:]


def _range(knots: Knots, trust: float) -> tuple[Array, Array]:
    """(N, m) least and largest change of every knot but the first, over the scales."""
    space, z = knots.chart.space, knots.z[1:]
    slides = np.arange(z.shape[1]) >= space.robot.n_tubes
    low, high = ((end - z) / space.scale for end in (space.lower, space.upper))
    return (
        np.where(slides, np.clip(low, -trust, trust), -trust),
        np.where(slides, np.clip(high, -trust, trust), trust),
    )


@lru_cache(maxsize=16)
def _program(n: int, m: int, rows: int) -> ca.Function:
    """The solver of the quadratic program of N knots, of m coordinates and a slack each, and of rows for each."""
    near = np.abs(np.arange(n)[:, None] - np.arange(n)) <= 1
    moved = np.append(np.ones(m, dtype=bool), False)
    hessian = _pattern(np.kron(near, np.outer(moved, moved)))
    matrix = _pattern(np.kron(np.eye(n, dtype=bool), np.ones((rows, m + 1), dtype=bool)))
    return ca.conic("ahead", SOLVER, {"h": hessian, "a": matrix}, QUIET)


def _pattern(mask: Mask) -> ca.Sparsity:
    rows, columns = np.nonzero(mask)
    return ca.Sparsity.triplet(mask.shape[0], mask.shape[1], rows.tolist(), columns.tolist())


def _sparse(pattern: ca.Sparsity, dense: Array) -> ca.DM:
    return ca.DM(pattern, dense[pattern.get_triplet()])
