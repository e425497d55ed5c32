"""Servo with look-ahead, for goals behind a valley of the margin or an obstacle, where single steps get stuck.

The path to the target is kept as knots. A knot is a point in tip coordinates (rotations and translations), in which the
equilibrium block is explicit: joint values, tip, shape and the Jacobi fields that state the margin are functions of it,
and there is no snap at which their derivatives end. Linearised at N knots, the shortest path through all of them to the
target is one quadratic program:

    min  N sum |joints_k - joints_k-1|^2 + (tip_N - target)^2 w^2 + rho sum slack_k
    with ranges and order of the joints, margin_k >= floor - slack_k, clearance_k >= wanted - slack_k, and changes of
    at most `trust`.

Every step solves for the knots once and improves them by this program (real-time iteration; Diehl, Bock and Schloeder,
SIAM J. Control Optim. 43 (2005)). Then the robot goes along as far as rates allow, if the whole path is allowed, and if
the guard agrees. A new target begins with the straight line to the joint values that inverse kinematics finds for it,
through whatever is between. Where no path becomes allowed, or no joint values are known, and close to the target, the
servo looks one step ahead.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from ..block.transcription.buffered import Buffered
from ..block.transcription.explicit import Kind, explicit_arm
from ..bodies.obstacles import Obstacle, Scene
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError
from ..inverse.answer import InverseOptions
from ..inverse.joints import Configuration
from ..inverse.solving import inverse_kinematics
from ..inverse.task import TipCoordinates
from ..robots.limits import JointLimits
from ..robots.robot import Robot
from ..solvers.blas import small
from ..typing import Array, Mask
from .command import Command, ServoOptions, ServoStep, Why, check_places, time_step
from .servo import Servo

# CasADi's interior point method. On programs of 20 knots of the robot of the thesis it took 0.7 ms of processor time,
# exact to 1e-6; qpOASES 3.9, HiGHS 4.8, OSQP 4.8 without reaching 1e-4 on half of them, ProxQP 17, qrqp failed.
SOLVER, QUIET = "ipqp", {"print_iter": False, "print_header": False, "print_info": False, "error_on_fail": False}


# Behind the valley of docs/control.md the target is reached in 41 or 42 steps of 40 ms with each of the next weights
# and limits at a tenth, half, twice and ten times its value: they matter where paths are long or bodies many.

# Rows of the program, each with the reserve that it keeps. Between two knots margin and clearance are less than at
# them; the guard still stops the step that would fall below the limits themselves.
MARGIN_RESERVE = 0.01
CLEARANCE_RESERVE = 2e-4  # m

# Largest violation of a path that the robot follows: of a Jacobi field, which is 1 without torsion, and of a
# clearance over its reserve. It is below the reserves, so that such a path keeps the limits themselves at its knots.
ALLOWED_VIOLATION = 0.02

# Largest and smallest trust region: change of a knot by one program, in units of the scales. It is halved where a
# change undoes the last one, as where tubes end together and derivatives differ to either side, and doubled where
# not.
LARGEST_TRUST, SMALLEST_TRUST = 0.3, 0.01

# Weight of the tip's distance from the target over the robot's length, relative to the joint motion over its scales.
# The last knot must end at the target: 1 % of the length counts as much as motion by a whole scale.
TIP_WEIGHT = 100.0

# Weight of the motion of the tip rotations, relative to that of the joints. Near a fold the tip rotations change much
# while the joints hardly move: without the weight nothing would keep knots there close together.
TURN_WEIGHT = 0.05

# Price per unit of slack: of the smallest field, and of a clearance over a tenth of the robot's length. An exact
# penalty needs a price above the multipliers of the constraints, of which the tip's weight is the scale.
SLACK_PRICE = 30.0

# Weight of changes of the knots: it makes the Hessian definite where joint motion does not depend on a knot.
KNOT_DAMPING = 1e-6

# Distance from obstacles, as a fraction of the robot's length, within which they count at a knot, and the largest
# number of points that a knot keeps clear of. Bodies farther away become rows of a later program.
BODY_REACH, MAX_CONTACTS = 0.05, 3

# Points per step between points of the arm, on straight lines, at which its distance from bodies is measured.
PLACES_PER_STEP = 4


@lru_cache(maxsize=16)
def _linearised(kind: Kind, knots: int, thread: int) -> Buffered:
    """Functions of an arm for `knots` knots: rotations, fields, points, last tangent, their derivatives, arc lengths.

    The first four are one column; derivatives are by tip rotations and translations.
    """
    tip, shift = ca.MX.sym("z", kind.n), ca.MX.sym("d", kind.n)
    floor, robot = ca.MX.sym("mu"), ca.MX.sym("robot", kind.size)
    rotations, fields, points, tangents, along = explicit_arm(kind)(tip, shift, floor, robot)
    values = ca.vertcat(rotations, ca.vec(fields), ca.vec(points), tangents[:, -1])
    slopes = ca.densify(ca.jacobian(values, ca.vertcat(tip, shift)))
    return Buffered(ca.Function("knot", [tip, shift, floor, robot], [values, slopes, along]).map(knots))


@dataclass(frozen=True, eq=False)
class Knots:
    """K points of a planned path in tip coordinates, with their arms and derivatives."""

    coordinates: TipCoordinates
    z: Array
    """Tip coordinates (K, m)."""
    joints: Array
    """Joint values (K, m), rad and m."""
    fields: Array
    """(K, f) fields; positive if the margin is above its minimum."""
    points: Array
    """(K, p, 3) points of the arm, m."""
    direction: Array
    """(K, 3) direction of its tip."""
    along: Array
    """(K, p) arc lengths of the points, m."""
    slopes: tuple[Array, Array, Array, Array]
    """Derivatives of joints, fields, points and direction by z over the scales, with m columns last."""

    @staticmethod
    def at(coordinates: TipCoordinates, z: Array, floor: float) -> Knots:
        """Knots at points (K, m), with `floor` as the minimum margin."""
        n, (count, m) = coordinates.space.robot.n_tubes, z.shape
        function = _linearised(coordinates.kind, count, threading.get_ident())
        values, slopes, along = function(z[:, :n], coordinates.translations(z), floor, coordinates.parameters)
        first, last = n + explicit_arm(coordinates.kind).numel_out(1), values.shape[1] - 3
        spread = np.concatenate([np.eye(n, m), coordinates.space.spread[n:]]) * coordinates.space.scale
        # In memory one column follows the other: (K, 2n, rows).
        by_z = slopes.reshape(count, 2 * n, -1).transpose(0, 2, 1) @ spread
        slide = np.tile(np.diag(coordinates.space.scale)[n:], (count, 1, 1))
        parts = (
            np.concatenate([by_z[:, :n], slide], axis=1),
            by_z[:, n:first],
            by_z[:, first:last].reshape(count, -1, 3, m),
            by_z[:, last:],
        )
        joints = np.concatenate([values[:, :n], z[:, n:]], axis=1)
        points = values[:, first:last].reshape(count, -1, 3).copy()
        return Knots(
            coordinates, z, joints, values[:, n:first].copy(), points, values[:, last:].copy(), along.copy(), parts
        )

    @property
    def tip(self) -> Array:
        """Tip positions (K, 3), m."""
        return self.points[:, -1]

    def contacts(self, scene: Scene, clearance: float) -> tuple[Array, Array]:
        """(K, C) clearances of arms in excess of the required one, m, infinite without bodies, and (K, C, m)
        derivatives.
        """
        space, (count, m) = self.coordinates.space, self.z.shape
        most = MAX_CONTACTS
        distances, slope = np.full((count, most), np.inf), np.zeros((count, most, m))
        x = np.arange(PLACES_PER_STEP) / PLACES_PER_STEP
        fine, along, moved = (_between(table, x) for table in (self.points, self.along, self.slopes[2]))
        end = self.coordinates.translations(self.z) + [tube.length - tube.straight_length for tube in space.robot.tubes]
        for k in range(count):
            radius = np.where(along[k, :, None] <= end[k] + 1e-12, self.coordinates.radius, 0.0).max(1)
            bodies = scene.close(fine[k], clearance + BODY_REACH * space.length + float(radius.max()))
            if not bodies:
                continue
            distance = scene.distances(bodies, fine[k]) - radius - clearance
            points = distance.argmin(1)
            nearest = np.argsort(distance.min(1))[:most]
            body, at = [bodies[i] for i in nearest], points[nearest]
            distances[k, : len(at)] = distance[nearest, at]
            away = scene.gradients(body, fine[k, at])
            slope[k, : len(at)] = (away[:, None] @ moved[k, at])[:, 0]
        return distances, slope


def _between(table: Array, x: Array) -> Array:
    """Table (K, p', ...) from a table (K, p, ...), with further rows at fractions x between neighbouring rows."""
    shape = (1, 1, len(x), *[1] * (table.ndim - 2))
    a, b = table[:, :-1, None], table[:, 1:, None]
    inner = a + x.reshape(shape) * (b - a)
    return np.concatenate([inner.reshape(len(table), -1, *table.shape[2:]), table[:, -1:]], axis=1)


@dataclass(frozen=True, eq=False)
class Aim:
    """Target position of the tip, m, and its target direction, a unit vector or None."""

    position: Array
    direction: Array | None


def improvement(knots: Knots, aim: Aim, contacts: tuple[Array, Array], trust: float) -> Array | None:
    """(N, m) changes of all knots but the first, in units of the scales, each at most `trust`, by a quadratic program.

    None if the solver finds no answer.
    """
    (path, right), (rows, least) = path_terms(knots, aim), _rows(knots, contacts)
    n, count, width = rows.shape
    m = width - 1
    hessian, matrix = np.zeros((n * width, n * width)), np.zeros((n, count, n, width))
    joint_columns = (np.arange(n)[:, None] * width + np.arange(m)).ravel()
    hessian[np.ix_(joint_columns, joint_columns)] = path.T @ path + KNOT_DAMPING * np.eye(n * m)
    gradient = np.full((n, width), SLACK_PRICE)
    gradient[:, :m] = -(right @ path).reshape(n, m)
    matrix[np.arange(n), :, np.arange(n)] = rows
    lower, upper = np.zeros((n, width)), np.full((n, width), np.inf)
    lower[:, :m], upper[:, :m] = _range(knots, trust)
    program = _program(n, m, count)
    solution = program(
        h=_sparse(program.sparsity_in("h"), hessian),
        a=_sparse(program.sparsity_in("a"), matrix.reshape(n * count, n * width)),
        g=gradient.ravel(),
        lba=least.ravel(),
        lbx=lower.ravel(),
        ubx=upper.ravel(),
    )
    answer = np.asarray(solution["x"]).reshape(n, width)[:, :m]
    return answer if program.stats()["success"] and np.isfinite(answer).all() else None


def path_terms(knots: Knots, aim: Aim) -> tuple[Array, Array]:
    """Rows and right-hand sides of the least-squares objective of all knots, in units of the scales.

    They are for knot spacing, and for the distance of the tip from its aim.
    """
    space, (count, m) = knots.coordinates.space, knots.z.shape
    tubes, n, weight = space.robot.n_tubes, count - 1, np.sqrt(count - 1.0)
    turned = np.tile(TURN_WEIGHT * np.eye(tubes, m), (count, 1, 1))
    slope = np.concatenate([knots.slopes[0] / space.scale[:, None], turned], 1)
    points = np.concatenate([knots.joints / space.scale, TURN_WEIGHT * knots.z[:, :tubes]], axis=1)
    matrix = np.zeros((n, m + tubes, n, m))
    each = np.arange(n)
    matrix[each, :, each] = weight * slope[1:]
    matrix[each[1:], :, each[:-1]] = -weight * slope[1:-1]
    right = -weight * np.diff(points, axis=0)
    desired = [(aim.position - knots.tip[-1], knots.slopes[2][-1, -1])]
    if aim.direction is not None:
        desired.append(((aim.direction - knots.direction[-1]) * space.length, knots.slopes[3][-1] * space.length))
    last = np.zeros((3 * len(desired), n * m))
    last[:, -m:] = TIP_WEIGHT / space.length * np.concatenate([slope for _, slope in desired])
    tip_error = TIP_WEIGHT / space.length * np.concatenate([tip_error for tip_error, _ in desired])
    return np.concatenate([matrix.reshape(-1, n * m), last]), np.concatenate([right.ravel(), tip_error])


def _rows(knots: Knots, contacts: tuple[Array, Array]) -> tuple[Array, Array]:
    """Constraint rows (N, r, m + 1) and lower bounds (N, r) of all knots but the first.

    Columns are over the scales and the slack. Constraints are ranges and order of the joints, margin and clearance.
    """
    space, joints, slope = knots.coordinates.space, knots.joints, knots.slopes[0]
    n = space.robot.n_tubes
    rotation_rows, order = slope[:, :n], space.rows @ slope / space.length
    distances, toward = contacts
    size = 1 + np.abs(knots.fields)
    rows = [rotation_rows, -rotation_rows, order, knots.slopes[1] / size[..., None], toward / (0.1 * space.length)]
    least = [
        (space.lower - joints)[:, :n],
        (joints - space.upper)[:, :n],
        (space.row_lower - joints @ space.rows.T) / space.length,
        -knots.fields / size,
        -distances / (0.1 * space.length),
    ]
    hard = 2 * n + len(space.row_lower)
    matrix = np.concatenate(rows, axis=1)
    slack = np.ones((*matrix.shape[:2], 1))
    slack[:, :hard] = 0.0
    return np.concatenate([matrix, slack], axis=2)[1:], np.concatenate(least, axis=1)[1:]


def _range(knots: Knots, trust: float) -> tuple[Array, Array]:
    """(N, m) lower and upper bounds on the change of every knot but the first, in units of the scales."""
    space, z = knots.coordinates.space, knots.z[1:]
    slides = np.arange(z.shape[1]) >= space.robot.n_tubes
    low, high = ((end - z) / space.scale for end in (space.lower, space.upper))
    return (
        np.where(slides, np.clip(low, -trust, trust), -trust),
        np.where(slides, np.clip(high, -trust, trust), trust),
    )


@lru_cache(maxsize=16)
def _program(n: int, m: int, rows: int) -> ca.Function:
    """Solver of the quadratic program of N knots with m coordinates, one slack and `rows` constraints each."""
    adjacent = np.abs(np.arange(n)[:, None] - np.arange(n)) <= 1
    moved = np.append(np.ones(m, dtype=bool), False)
    hessian = _pattern(np.kron(adjacent, np.outer(moved, moved)))
    matrix = _pattern(np.kron(np.eye(n, dtype=bool), np.ones((rows, m + 1), dtype=bool)))
    return ca.conic("ahead", SOLVER, {"h": hessian, "a": matrix}, QUIET)


def _pattern(mask: Mask) -> ca.Sparsity:
    rows, columns = np.nonzero(mask)
    return ca.Sparsity.triplet(mask.shape[0], mask.shape[1], rows.tolist(), columns.tolist())


def _sparse(pattern: ca.Sparsity, dense: Array) -> ca.DM:
    return ca.DM(pattern, dense[pattern.get_triplet()])


# Distance of the tip from its target, as a fraction of the robot's length, below which a single step suffices: where
# that step comes to rest before the target, the knots take over again. A step of the servo takes a tenth of the time.
CLOSE = 0.01

# Distance between targets, as a fraction of the robot's length, above which a path is planned anew. A target that
# moves on by less is followed by the knots: each program carries the last one along.
ELSEWHERE = 0.05

# Steps that the robot waits for an allowed path, 0.4 s at 50 Hz. Each is one program; then the servo goes on without
# a path.
PATIENCE = 20

# Duration of the search for joint values of a new target: longer than inverse kinematics takes where there are any.
SEARCH_SECONDS = 1.0


class PredictiveServo:
    """Servo of one robot with look-ahead: it plans several knots to the target.

    Args:
        start, limits, obstacles: as for `Servo`.   options: see `ServoOptions`; priorities and objective apply where a
            single step suffices.
        knots: number of knots of the planned path.

    Raises:
        InputError, SolveError: as `Servo` does; fewer than 2 knots.
    """

    def __init__(
        self,
        robot: Robot,
        start: Configuration,
        *,
        limits: JointLimits | None = None,
        obstacles: Sequence[Obstacle] = (),
        options: ServoOptions | None = None,
        knots: int = 20,
    ) -> None:
        if knots < 2:
            raise InputError(f"knots is {knots}; it must be at least 2")
        self.options = options or ServoOptions()
        self._servo = Servo(robot, start, limits=limits, obstacles=obstacles, options=self.options)
        self._guard = self._servo.guard
        self._bodies, self._limits = tuple(obstacles), limits
        self._floor = self.options.min_margin + MARGIN_RESERVE
        self._clearance = self.options.clearance + CLEARANCE_RESERVE
        self._coordinates = TipCoordinates(self._guard.space)
        self._count = knots
        self._path: Array | None = None
        self._aim: Aim | None = None
        self._trust, self._last = LARGEST_TRUST, np.zeros((knots, len(self._guard.posture.q)))
        self._waited, self._near = 0, True

    @property
    def equilibrium(self) -> Equilibrium:
        """Current equilibrium of the robot."""
        return self._guard.arm

    @property
    def path(self) -> Array | None:
        """(K, m) tip rotations (rad) and carriage translations (m) of the planned path; None without one."""
        return None if self._path is None else self._path.copy()

    @small
    def step(self, command: Command, dt: float) -> ServoStep[Equilibrium]:
        """One step of `dt` seconds towards a position, and a direction if given; always returns a step.

        The robot does not move until the planned path is allowed; `why` then names the violated constraints.

        Raises:
            InputError: a command without a position, or with more than position and direction; one that asks for the
                closest pose.
        """
        dt = time_step(dt)
        check_places(command, self._guard.space.robot)
        if command.position is None or command.pivot is not None or command.joints is not None:
            raise InputError("a servo with look-ahead follows a position, and a direction if one is given")
        if command.closest:
            raise InputError("closest is not for a servo with look-ahead; use Servo")
        aim = Aim(command.position, command.direction)
        remaining, current = self._guard.left(command), self._guard.posture
        if self._near and remaining[0] < CLOSE * self._guard.space.length and not self._new(aim):
            step = self._servo.step(command, dt)
            # If the servo comes to rest before the target, a look-ahead of one step is not enough.
            self._near = step.why & Why.HELD == 0
            return step
        knots = self._knots(aim)
        if knots is None:
            return self._servo.step(command, dt)
        lacking = self._renew(knots)
        if not lacking:
            change, passed = self._along(knots, dt)
            reached, lacking = self._guard.go(change, Why.RATE if passed < self._count else Why(0), dt)
            if Why.HELD not in lacking:
                self._waited = 0
                # The rest of the path is divided into the same number of knots.
                if self._path is not None:
                    self._path = _places(self._path, np.linspace(passed, self._count, self._count + 1))
                return ServoStep(reached, lacking, *remaining)
        self._waited += 1
        if self._waited <= PATIENCE:
            arm, _ = self._guard.go(np.zeros(len(current.q)), Why(0), dt)
            return ServoStep(arm, lacking | Why.HELD, *remaining)
        return self._servo.step(command, dt)

    def _renew(self, knots: Knots) -> Why:
        """Improve the planned path; returns its violated constraints."""
        assert self._aim is not None
        contacts = knots.contacts(self._guard.scene, self._clearance)
        change = improvement(knots, self._aim, contacts, self._trust)
        if change is None:  # it is begun anew
            self._aim = None
        else:
            undone = float((change * self._last).sum()) < 0
            self._trust = float(np.clip(self._trust * (0.5 if undone else 2.0), SMALLEST_TRUST, LARGEST_TRUST))
            self._last = change
            self._path = np.concatenate([knots.z[:1], knots.z[1:] + change * self._guard.space.scale])
        lacking = Why(0)
        if knots.fields[1:].min() < -ALLOWED_VIOLATION:
            lacking |= Why.MARGIN
        if contacts[0].min(initial=np.inf) < -CLEARANCE_RESERVE * (1 + ALLOWED_VIOLATION):
            lacking |= Why.OBSTACLE
        return lacking

    def _knots(self, aim: Aim) -> Knots | None:
        """Path to a target, the present one if it fits; None if no joint values are known for the target."""
        current = self._guard.posture
        first, floor = self._coordinates.of(current.equilibrium), min(self._floor, current.margin)
        if self._new(aim):
            self._aim, end = aim, self._goal(aim)
            self._path = None
            if end is None:
                return None
            self._trust, self._last = LARGEST_TRUST, np.zeros_like(self._last)
            self._waited, self._near = 0, True
            self._path = first + np.linspace(0, 1, self._count + 1)[:, None] * (end - first)
        if self._path is None:
            return None
        self._aim = aim
        return Knots.at(self._coordinates, np.concatenate([first[None], self._path[1:]]), floor)

    def _new(self, aim: Aim) -> bool:
        """True if no path is planned, or if the planned path leads to another target."""
        if self._aim is None:
            return True
        moved = float(np.linalg.norm(aim.position - self._aim.position)) / self._guard.space.length
        if aim.direction is not None and self._aim.direction is not None:
            moved = max(moved, float(np.linalg.norm(aim.direction - self._aim.direction)))
        return moved > ELSEWHERE or (aim.direction is None) != (self._aim.direction is None)

    def _goal(self, aim: Aim) -> Array | None:
        """Tip coordinates of joint values close to the robot that reach a target; None if none are known."""
        try:
            solution = inverse_kinematics(
                self._guard.space.robot,
                aim.position,
                direction=aim.direction,
                start=self.equilibrium,
                min_margin=self._floor,
                limits=self._limits,
                obstacles=self._bodies,
                options=InverseOptions(clearance=self._clearance, time_limit=SEARCH_SECONDS),
            )
        except SolveError:
            return None
        return self._coordinates.of(solution.equilibrium)

    def _along(self, knots: Knots, dt: float) -> tuple[Array, float]:
        """Joint change (m,) along the path in `dt` seconds at full speed, and the number of points that are passed."""
        space, current, options = self._guard.space, self._guard.posture, self.options
        rate = np.where(np.arange(len(current.q)) < space.robot.n_tubes, options.turn_rate, options.shift_rate)
        turned = np.abs(np.diff(knots.joints, axis=0)) / np.maximum(rate, 1e-300)
        moved = np.linalg.norm(np.diff(knots.tip, axis=0), axis=1) / max(options.speed, 1e-300)
        time = np.concatenate([[0.0], np.cumsum(np.maximum(turned.max(1), moved))])
        passed = float(np.interp(dt, time, np.arange(len(time))))
        at = _places(knots.z, np.array([passed]))
        change = np.clip(self._coordinates.joints(at)[0], space.lower, space.upper) - current.q
        ratio = float((np.abs(change) / np.maximum(rate * dt, 1e-300)).max())
        return np.clip(change / max(ratio, 1.0), *self._guard.ends(dt)), passed


def _places(z: Array, at: Array) -> Array:
    """(k, m) points on a polyline (K, m) at fractional indices (k,) of its points."""
    return np.column_stack([np.interp(at, np.arange(len(z)), column) for column in z.T])
