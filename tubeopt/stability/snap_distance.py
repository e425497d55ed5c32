"""How far the tubes may turn from an equilibrium before anything can snap, proved from that one equilibrium.

At every collocation point a, each pair p = (i, j) of tubes curved there has an angle psi_p = theta_i - theta_j and a
coupling w_p = B_a m_i m_j / K > 0. With theta = alpha + L z, the incidence D (+1 at i, -1 at j) and A = D L,

    g = z + A' w sin psi,   psi = D alpha + A z,   H = 1 + A' diag(w cos psi) A,
    G = A H^-1 A',          J = d psi / d alpha = D - G diag(w cos psi) D.

At alpha + d the equations have a solution with angles psi + x exactly if

    x = J d + G w h(x),   h(x) = sin psi (1 - cos x) + cos psi (x - sin x).

Let d range over a convex set S with 0 in it, and let the right-hand side map a box [x] into itself for every d in S.
Then (Brouwer) each d in S has an equilibrium in the box. If moreover H > 0 at the smallest cosines in the box, the
energy is strictly convex there: the equilibrium is the only one in the box, stable, and depends continuously on d. So
no motion inside S, however it winds, snaps.

S is {max d - min d <= 2 r}: all tubes turned by at most r each, since turning all tubes alike changes nothing. It is
the union of n! simplices, conv(0, 2 r 1_T along a chain of sets T). Two of them share a simplex with 0 in it, and
therefore the same equilibria. The numbers are floating point: H must exceed 1e-9, and the box closes with room to
spare.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import cached_property
from time import perf_counter

import numpy as np

from ..arguments import typed
from ..block.transcription.reduced import ReducedProblem, evaluate, to_unknowns
from ..display import Displayed
from ..equilibrium.answer import discretisation_of, sample_rotation
from ..equilibrium.problem import reduced_problem
from ..equilibrium.result import Equilibrium, refuse_friction
from ..errors import InputError
from ..solvers.blas import small
from ..solvers.time_limit import TIME_LIMIT, check_time, limited
from ..typing import Array, StatusEnum
from .certificate import snap_free_certificate
from .following import find_snap

MOST_CHANGE = 3.0
"""Largest change (rad) of an angle in a box. Below pi, h has one extremum beside 0 in it."""

ROUND_OFF = 1e-9
"""H must exceed this. Its eigenvalues are right to about 1e-12, so that a smaller value would do."""

SPARE = 1e-10
"""Width (rad) of the box beyond the fixed point, so that it is mapped inside itself by more than round-off."""

NEWTON_STEPS = 40
"""Newton's method from below needs 4 to 10 steps, and up to 25 beside the largest ball, where two fixed points meet."""

PRECISION = 1e-6
"""Relative precision of the radius. At 1e-3 it takes half the time, and the ball is up to 0.1 % smaller."""

SECTORS = 4
"""Number of tubes up to which S is proved by its n! simplices. They give a median of 0.93 of the true distance, one box
for all of S 0.84; for five tubes 120 simplices would take a second."""

FULL_TURN = 2 * math.pi
FARTHEST = 2 * FULL_TURN
"""Turn of one tube up to which its fold is searched, rad: equilibria repeat after a full turn, branches need not."""


class SnapDistanceStatus(StatusEnum):
    """What is known of the distance; every value reads as a sentence."""

    PROVED = "within this distance nothing can snap"
    NEVER = "the tubes cannot snap by turning at these translations"


@dataclass(frozen=True)
class SnapDistanceStatistics:
    """Effort of the proof."""

    couplings: int
    """Number of coupled pairs, summed over the collocation points."""
    boxes: int
    """Number of radii that were tried."""
    seconds: float
    """Run time, s."""


@dataclass(frozen=True, eq=False)
class SnapDistance(Displayed):
    """Distance of an equilibrium from the nearest snap by turns of the tubes, at fixed translations."""

    equilibrium: Equilibrium
    """The equilibrium."""
    turn: float
    """Largest turn of every tube, either way and in any order, that is proved to cause no snap, rad. It is a lower
    bound of the true distance, 0.93 of it in the median. inf where the certificate at the translations is positive.
    """
    status: SnapDistanceStatus
    """Result of the proof."""
    statistics: SnapDistanceStatistics
    """Effort."""

    @property
    def value(self) -> float:
        """`turn`, rad."""
        return self.turn

    @cached_property
    def one_tube(self) -> Array:
        """(n, 2) turn of one tube, backward and forward, at which the robot snaps while the others rest, rad. NaN where
        it does not snap within two turns. Exact: folds of the branch, by `find_snap`."""
        n = self.equilibrium.robot.n_tubes
        return np.array([[self._fold(side * np.eye(n)[k])[k] for side in (-1, 1)] for k in range(n)])

    @cached_property
    def nearest(self) -> float:
        """Largest turn of any tube at the nearest snap that a search finds, rad; inf where it finds none. The true
        distance is between `turn` and this."""
        n = self.equilibrium.robot.n_tubes
        corners = [np.array(c, dtype=float) for c in itertools.product((0, 1), repeat=n) if 0 < sum(c) < n]
        pairs = [(a, b) for a, b in itertools.product(corners, repeat=2) if (a <= b).all() and (b - a).sum() == 1]
        # The nearest fold touches the ball at a corner, or on a face if turning some tube does not matter there.
        directions = [*corners, *((a + b) / 2 for a, b in pairs)]
        best, k = min((self._radius(d), k) for k, d in enumerate(directions))
        at, step = directions[k], 0.25
        while n > 2 and math.isfinite(best) and step > 0.01:  # the corners are all directions of two tubes
            around = [np.clip(at + side * step * unit, 0, 1) for unit in np.eye(n) for side in (-1, 1)]
            radius, k = min((self._radius(d), k) for k, d in enumerate(around))
            if radius < best:
                best, at = radius, around[k]
            else:
                step /= 2
        return best

    def _radius(self, direction: Array) -> float:
        """Half of max - min of the turns at the first fold along a direction (n,), rad; inf without one."""
        if not np.ptp(direction):
            return math.inf
        result = float(np.ptp(self._fold(direction))) / 2
        return math.inf if math.isnan(result) else result

    def _fold(self, direction: Array) -> Array:
        """(n,) turns at the first fold along a direction (n,), rad; NaN without one."""
        e = self.equilibrium
        longest = max(float(np.ptp(direction)), float(np.abs(direction).max()))
        end = e.rotations + direction * (FARTHEST / longest)
        snap = find_snap(e.robot, (e.rotations, e.translations), (end, e.translations), equilibrium=e)
        return np.full(len(direction), np.nan) if snap is None else snap.rotations - e.rotations


@dataclass(frozen=True, eq=False)
class PairForm:
    """An equilibrium by the angles between its tubes; P couplings, n tubes, U unknowns. Symbols as on top."""

    psi: Array
    """(P,) rad."""
    w: Array
    """(P,) J."""
    A: Array
    """(P, U) rad per sqrt(J)."""
    G: Array
    """(P, P) rad/J."""
    J: Array
    """(P, n) change of the angles by the rotations of the tubes."""
    defect: Array
    """(P,) change of psi that the residual of the equations stands for, rad; about 1e-16."""

    @staticmethod
    def of(equilibrium: Equilibrium) -> PairForm:
        """That of an equilibrium of concentric tubes without a load."""
        shift = tuple(equilibrium.translations.tolist())
        problem = reduced_problem(equilibrium.robot, shift, discretisation_of(equilibrium))
        z = to_unknowns(problem, equilibrium.rotations, sample_rotation(equilibrium, problem.arc_length))
        state = evaluate(problem, equilibrium.rotations, z)
        # Saved equilibria, and those of other meshes, are right to 1e-9 only.
        for _ in range(2 if problem.size else 0):
            z = z - np.linalg.solve(state.hessian, state.gradient)
            state = evaluate(problem, equilibrium.rotations, z)
        return _pair_form(problem, state.theta + problem.phase, z)

    def h(self, x: Array) -> Array:
        """h(x) of changes (..., P)."""
        return np.asarray(np.sin(self.psi) * (1 - np.cos(x)) + np.cos(self.psi) * (x - np.sin(x)))

    def h_slope(self, x: Array) -> Array:
        """dh / dx."""
        return np.asarray(np.sin(self.psi) * np.sin(x) + np.cos(self.psi) * (1 - np.cos(x)))

    @cached_property
    def extremum(self) -> Array:
        """(P,) the x in [-pi, pi) other than 0 at which h' = 2 sin(x / 2) sin(psi + x / 2) is 0."""
        return np.asarray(np.mod(np.pi - 2 * self.psi, FULL_TURN) - np.pi)

    @cached_property
    def spread(self) -> Array:
        """(2 P, 2 P) how the ranges of h, by largest value and by least one with the other sign, widen the box."""
        positive, negative = np.maximum(self.G, 0) * self.w, np.maximum(-self.G, 0) * self.w
        return np.block([[negative, positive], [positive, negative]])

    def image(self, y: Array, u: Array) -> tuple[Array, Array]:
        """The box to which [x] is mapped, and its derivatives (..., 2 P, 2 P) by [x].

        Boxes are u = (-low, high) (..., 2 P), for which the map grows; y: that of J d over S.
        """
        count = len(self.psi)
        low, high = -u[..., :count], u[..., count:]
        inside = (low <= self.extremum) & (self.extremum <= high)
        nothing = np.zeros_like(low)
        values = np.stack([self.h(low), self.h(high), nothing, np.where(inside, self.h(self.extremum), 0.0)])
        which = np.concatenate([values.argmax(0), values.argmin(0)], axis=-1)
        result = y + np.concatenate([values.max(0), -values.min(0)], axis=-1) @ self.spread.T
        by_low, by_high = -self.h_slope(low), self.h_slope(high)
        slope, k = np.zeros((*u.shape, 2 * count)), np.arange(count)
        for row, sign in ((0, 1.0), (count, -1.0)):
            slope[..., row + k, k] = np.where(which[..., row + k] == 0, sign * by_low, 0.0)
            slope[..., row + k, count + k] = np.where(which[..., row + k] == 1, sign * by_high, 0.0)
        return result, self.spread @ slope

    def proves(self, y: Array) -> bool:
        """Whether every d with J d in the boxes y (S, 2 P) leads to one stable equilibrium, without a snap between."""
        y = y + np.tile(self.defect, 2)
        u, one = y, np.ones_like(y)
        # The least fixed point of an increasing map, from below by Newton's method: plain iteration needs thousands of
        # sweeps close to the largest ball. The proof is the check afterwards, whatever the steps did.
        for _ in range(NEWTON_STEPS):
            image, slope = self.image(y, u)
            result = np.linalg.solve(np.eye(u.shape[-1]) - slope, np.stack([image - u, one], axis=-1))
            step, wider = result[..., 0], result[..., 1]
            u = u + step
            # (1 - slope)^-1 has a negative entry: no fixed point is above, so the box never closes.
            if (wider <= 0).any() or u.max() > MOST_CHANGE:
                return False
            if np.abs(step).max() < SPARE:
                break
        box = np.maximum(u, 0.0) + SPARE * wider
        return bool((self.image(y, box)[0] <= box).all()) and self.convex(box)

    def convex(self, u: Array) -> bool:
        """Whether H exceeds round-off at the smallest cosines in each of the boxes (S, 2 P)."""
        count = len(self.psi)
        low, high = self.psi - u[..., :count], self.psi + u[..., count:]
        opposed = np.floor((high - np.pi) / FULL_TURN) > np.floor((low - np.pi) / FULL_TURN)
        least = np.where(opposed, -1.0, np.minimum(np.cos(low), np.cos(high)))
        second = (self.A.T * (self.w * least)[:, None, :]) @ self.A
        return bool((np.linalg.eigvalsh(second)[:, 0] > ROUND_OFF - 1).all())

    def boxes(self, r: float) -> Array:
        """(S, 2 P) ranges of J d over the parts of the ball of radius r."""
        n = self.J.shape[1]
        if n > SECTORS:
            reach = r * np.abs(self.J).sum(1)
            return np.concatenate([reach, reach])[None]
        chains = np.array(
            [np.cumsum(np.eye(n)[list(order)], axis=0)[:-1] for order in itertools.permutations(range(n))]
        )
        corners = 2 * r * chains @ self.J.T
        return np.concatenate([np.maximum(-corners.min(1), 0), np.maximum(corners.max(1), 0)], axis=-1)


def _pair_form(problem: ReducedProblem, theta: Array, z: Array) -> PairForm:
    """The form at rotations (N, n) with the phases of the tubes in them."""
    first, second = np.triu_indices(problem.moment.shape[1], 1)
    moment, per_length = problem.moment, problem.weight / problem.stiffness.sum(1)
    product = per_length[:, None] * moment[:, first] * moment[:, second]
    a, p = np.nonzero(product)
    i, j = first[p], second[p]
    # A tube curved backwards pulls the other way: then half a turn is in the angle, and w > 0 as the signs of G ask.
    w, psi = np.abs(product[a, p]), theta[a, i] - theta[a, j] + np.where(product[a, p] < 0, np.pi, 0.0)
    A = problem.spread[a, i] - problem.spread[a, j]
    D = np.eye(moment.shape[1])[i] - np.eye(moment.shape[1])[j]
    cosine = (w * np.cos(psi))[:, None]
    response = np.linalg.solve(
        np.eye(problem.size) + A.T @ (cosine * A), np.column_stack([A.T, z + A.T @ (w * np.sin(psi))])
    )
    G = A @ response[:, :-1]
    return PairForm(psi, w, A, G, D - G @ (cosine * D), np.abs(A @ response[:, -1]))


@typed
@small
@limited
def snap_distance(equilibrium: Equilibrium, *, time_limit: float = TIME_LIMIT) -> SnapDistance:
    """Largest turn of all tubes that is proved to cause no snap, and the snaps by turning one tube.

    Args:
        equilibrium: stable, of concentric tubes, without load and friction. Its translations stay as they are.
        time_limit: maximum run time, s.

    Raises:
        InputError: an unstable equilibrium, one under load or friction, eccentric tubes that the certificate does not
            cover.
        TimeLimitError: (a SolveError) the time limit was reached before there was an answer.

    Examples:
        >>> import numpy as np
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> pose = tubeopt.forward_kinematics(robot, [0.0, 1.0, 2.0])
        >>> distance = tubeopt.snap_distance(pose)
        >>> round(float(np.degrees(distance.turn)), 3)
        51.908
    """
    began, robot = perf_counter(), equilibrium.robot
    refuse_friction(equilibrium)
    if equilibrium.load is not None:
        raise InputError("equilibrium has a load; it must have none: the snap distance is known without load only")
    if not equilibrium.stable:
        raise InputError(f"equilibrium has a margin of {equilibrium.margin:.3g}; it must be above 0")
    certificate = snap_free_certificate(robot, equilibrium.translations)
    if not certificate > 0 and robot.assembly(equilibrium.translations).eccentric:
        raise InputError(
            f"equilibrium is of an eccentric robot with a certificate of {certificate:.3g}; it must be above 0: "
            "a finite snap distance is known for concentric robots only"
        )
    couplings = boxes = 0
    turn = math.inf
    if not certificate > 0:
        form = PairForm.of(equilibrium)
        couplings = len(form.psi)
        turn, boxes = _largest_ball(form)
    status = SnapDistanceStatus.NEVER if turn == math.inf else SnapDistanceStatus.PROVED
    seconds = perf_counter() - began
    return SnapDistance(equilibrium, turn, status, SnapDistanceStatistics(couplings, boxes, seconds))


def _largest_ball(form: PairForm) -> tuple[float, int]:
    """Largest radius that is proved, rad, and how many were tried. Each yes is a proof by itself."""
    proved, refused, boxes = 0.0, math.pi, 0
    radius = 0.1
    while refused - proved > PRECISION * refused:
        check_time()
        boxes += 1
        if form.proves(form.boxes(radius)):
            proved = radius
            radius = min(2 * radius, (radius + refused) / 2) if refused == math.pi else (radius + refused) / 2
        else:
            refused = radius
            radius = (proved + refused) / 2
    return proved, boxes
