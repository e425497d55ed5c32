"""Bound on the rotation of the tubes without a snap, proved from one equilibrium.

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

Slides delta_k of the tubes add two terms. At a fixed arc length, a slide turns the base of tube k by
delta_k T_k / kt_k, where T = D' w' sin(psi + x) are the torques. Couplings change from w to w' between the old and the
new breakpoints:

    x = J (d + delta T / kt) + G (w h(x) - (w' - w) sin(psi + x)).

The arm is cut at the breakpoints before and after the slides, once for each choice of their directions. H is taken at
the longest transmissions, which are the softest, and at the coupling that makes it least. Between two cuts the same
pieces of a tube pass by; a coupling is between those of any two of them, and may change its sign.

Under a known dead load the second variation and the map are others: `loaded_distance`.

A dead force of at most F at the tip bends the arm: K (u - u*) is its moment, at most F (L - s). So it turns tube i by
torques tau_i of at most t_i = F (L - s) |a_i| / K per length, whatever the shape. With bending eliminated,

    z + A' w sin(psi + x) + L' B tau = 0,   x = -A M^-1 L' B tau,   M = 1 + A' diag(w c) A,

where c are mean cosines between psi and psi + x. If H is the smallest M in a box [-X, X], then by Cauchy and Schwarz

    |x_p| <= sqrt(a_p' H^-1 a_p) sqrt(t' |B L H^-1 L' B| t).

If this is below X_p for every pair, x never reaches the border of the box while the force changes. If moreover
H > F nu, with nu F the softening by forces up to F of `ArmSections.softening`, the energy stays strictly convex in the
box: the equilibrium never ends. Both hold for every path of forces of at most F.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from time import perf_counter
from typing import NamedTuple

import numpy as np

from ..arguments import typed
from ..block.transcription.mesh import green_of
from ..display import Displayed
from ..equilibrium.jacobian import compiled_motion, compiled_turn
from ..equilibrium.kinematics import point_of
from ..equilibrium.member import discretisation_of, sample_rotation
from ..equilibrium.problem import reduced_problem
from ..equilibrium.result import Equilibrium, refuse_contact
from ..errors import InputError, positive
from ..robots.eccentric import BundleRobot
from ..robots.pieces import Series
from ..robots.robot import Robot
from ..robots.tubes import stretches
from ..solvers.blas import small
from ..solvers.time_limit import TIME_LIMIT, check_time, limited
from ..typing import Array, Mask, StatusEnum
from .boxes import (
    FULL_TURN,
    MOST_CHANGE,
    ROUND_OFF,
    SPARE,
    SWEEPS,
    Form,
    bends,
    range_of_bend,
    range_of_cosine,
    widened,
)
from .certificate import arm_sections, loaded_worst_case, snap_free_certificate
from .following import find_snap
from .loaded_distance import LoadedForm

NEWTON_STEPS = 40
"""Newton's method from below needs 4 to 10 steps, and up to 25 beside the largest ball, where two fixed points meet."""

POLISH = 3
"""Newton steps on an equilibrium that was sampled from another mesh."""

PRECISION = 1e-6
"""Relative precision of the radius. At 1e-3 it takes half the time, and the ball is up to 0.1 % smaller."""

FIRST_TURN = 0.1
"""Turn that a search begins with, rad."""

SLOW_PRECISION = 1e-3
"""Relative precision with slides and under a load, where a try takes ten times as long."""

SMALLEST = 1e-6
"""Fraction of the largest factor; a smaller one counts as none."""

SECTORS = 4
"""Number of tubes up to which S is proved by its n! simplices. They give a median of 0.93 of the true distance, one box
for all of S 0.84; for five tubes 120 simplices would take a second."""

SAME_PLANE = 1e-12
"""Relative error of a precurvature that is in one plane: rounding of an angle."""

FARTHEST = 2 * FULL_TURN
"""Largest rotation of one tube in the search of its fold, rad: a branch may continue after a full turn."""


class SnapDistanceStatus(StatusEnum):
    """Status of a snap distance; every value reads as a sentence."""

    PROVED = "within this distance nothing can snap"
    NEVER = "the tubes cannot snap by turning at these translations"


@dataclass(frozen=True)
class SnapDistanceStatistics:
    """Effort of the proof."""

    couplings: int
    """Number of coupled pairs, summed over the collocation points."""
    boxes: int
    """Number of radii that were tried in Python; 0 for a proof by the compiled kernel."""
    seconds: float
    """Run time, s."""


@dataclass(frozen=True, eq=False)
class SnapDistance(Displayed):
    """Distance of an equilibrium from the nearest snap by turns of the tubes, at fixed translations."""

    equilibrium: Equilibrium
    """The equilibrium."""
    turn: float
    """Largest turn of every tube, either way and in any order, that is proved to cause no snap, rad. It is a lower
    bound of the true distance, 0.93 of it in the median. inf if the certificate at the translations is positive.
    """
    status: SnapDistanceStatus
    """Result of the proof."""
    statistics: SnapDistanceStatistics
    """Effort of the computation."""

    @property
    def value(self) -> float:
        """Largest turn that is proved to cause no snap, rad."""
        return self.turn

    @cached_property
    def one_tube(self) -> Array:
        """(n, 2) turns of one tube, backward and forward, at which the robot snaps while the others rest, rad.

        NaN if it does not snap within two turns. Exact: folds of the branch, by `find_snap`.
        """
        n = self.equilibrium.robot.n_tubes
        return np.array([[self._fold(side * np.eye(n)[k])[k] for side in (-1, 1)] for k in range(n)])

    @cached_property
    def nearest(self) -> float:
        """Largest turn of any tube at the nearest snap that a search finds, rad; inf if it finds none.

        The true distance is between `turn` and this one.
        """
        n = self.equilibrium.robot.n_tubes
        if self.equilibrium.load is not None:  # all tubes turned alike turn the arm against the load
            ways = (np.array(d, dtype=float) for d in itertools.product((-1, 0, 1), repeat=n) if any(d))
            return float(np.nanmin([math.inf, *(np.abs(self._fold(d)).max() for d in ways)]))
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

    @cached_property
    def slide(self) -> float:
        """Largest slide of every tube, forward or backward at fixed rotations, that is proved to cause no snap, m.
        A tube at the end of its actuator moves backward only.

        Raises:
            InputError: eccentric tubes, and tubes that do not bend in one plane with one stiffness, for which no such
                distance is known.
        """
        return self._largest(0.0, 1.0)

    @cached_property
    def force(self) -> float:
        """Largest dead force at the tip that is proved to cause no snap, in any direction and also while it changes, N.

        It acts at these joint values, without weight and friction. It is a lower bound: 0.1 to 0.6 of the smallest
        limit found along random directions.

        Raises:
            InputError: eccentric tubes, for which no such force is known.
        """
        e = _unloaded(self.equilibrium, "force")
        if e.robot.assembly(e.translations).eccentric:
            raise InputError("robot has eccentric tubes; a force is known for concentric tubes only")
        softening = arm_sections(e.robot, e.translations).softening(1.0, pairs=False)
        largest = 1 / softening
        if not reduced_problem(e.robot, tuple(e.translations.tolist()), discretisation_of(e)).size:
            return largest  # no tubes are coupled
        form, torques = PairForm.of(e), tip_torques(e)
        return _largest(lambda F: form.under_force(F, softening, torques) is not None, largest / 4, largest, PRECISION)[
            0
        ]

    def time(self, turn_rate: float, shift_rate: float) -> float:
        """Time within which nothing snaps if all joints move at up to these rates: proved, s.

        Args:
            turn_rate: of every rotation, rad/s.   shift_rate: of every translation, m/s.

        Raises:
            InputError: rates that are negative or both 0; tubes as for `slide`.
        """
        turn, shift = (positive(n, r, zero=True) for n, r in (("turn_rate", turn_rate), ("shift_rate", shift_rate)))
        if not turn and not shift:
            raise InputError("turn_rate and shift_rate are both 0; one of them must be above 0")
        return self._largest(turn, shift) if shift else self.turn / turn

    def _largest(self, turn_rate: float, shift: float) -> float:
        """Largest factor at which a turn (rad) and a slide (m) of all tubes are proved to cause no snap."""
        e = _unloaded(self.equilibrium, "slide")
        if e.robot.assembly(e.translations).eccentric:
            raise InputError("robot has eccentric tubes; a slide is known for concentric tubes only")
        planar_tubes(e.robot)
        longest = max(tube.length for tube in e.robot.tubes)
        largest = max(longest / shift, math.pi / turn_rate if turn_rate else 0.0)
        even = e.robot.even
        compiled = compiled_motion(e, turn_rate, shift, most=largest, precision=SLOW_PRECISION) if even else None
        if compiled is not None:
            return compiled

        def proves(factor: float) -> bool:
            for signs in itertools.product((-1.0, 1.0), repeat=e.robot.n_tubes):
                form = PairForm.sliding(e, np.array(signs) * (shift * factor))
                if not form.proves(form.boxes(turn_rate * factor)):
                    return False
            return True

        return _largest(proves, largest / 16, largest, SLOW_PRECISION)[0]

    def _radius(self, direction: Array) -> float:
        """Half of max - min of the turns at the first fold along a direction (n,), rad; inf without one."""
        if not np.ptp(direction):
            return math.inf
        radius = float(np.ptp(self._fold(direction))) / 2
        return math.inf if math.isnan(radius) else radius

    def _fold(self, direction: Array) -> Array:
        """(n,) turns at the first fold along a direction (n,), rad; NaN without one."""
        e = self.equilibrium
        longest = max(float(np.ptp(direction)), float(np.abs(direction).max()))
        end = e.rotations + direction * (FARTHEST / longest)
        snap = find_snap(e.robot, (e.rotations, e.translations), (end, e.translations), equilibrium=e, load=e.load)
        return np.full(len(direction), np.nan) if snap is None else snap.rotations - e.rotations


class PlanarTube(NamedTuple):
    """Tube of one stiffness that bends in one plane, as C stretches from its clamped end."""

    ends: Array
    """(C,) arc length from the clamped end at which each stretch ends, m."""
    curvature: Array
    """(C,) precurvature about x, 1/m."""
    bending: float
    """Bending stiffness, N m^2."""
    torsional: float
    """Torsional stiffness, N m^2."""


def planar_tubes(robot: Robot) -> list[PlanarTube]:
    """Stretches of the tubes; raises InputError for a tube of several stiffnesses, or not bent about x only."""
    tubes = []
    for k, tube in enumerate(robot.tubes, start=1):
        parts = stretches(tube)
        # (C, 5) precurvature x, y, z, and both stiffnesses.
        rows = [[q for q in (*part.precurvature, *part[2:]) if not isinstance(q, Series)] for part in parts]
        table = np.array(rows) if all(len(row) == 5 for row in rows) else np.full((1, 5), np.nan)
        x, stiffness = table[:, 0], table[:, 3:]
        planar = (np.abs(table[:, 1:3]) <= SAME_PLANE * np.maximum(np.abs(x), 1.0)[:, None]).all()
        if not planar or (stiffness != stiffness[0]).any():
            raise InputError(
                f"tube {k} has several stiffnesses, or does not bend about its x axis only with constant curvature in "
                "each piece; a slide is known for other tubes"
            )
        ends = np.cumsum([part.length for part in parts])
        tubes.append(PlanarTube(ends, x, *stiffness[0].tolist()))
    return tubes


class _Stretches(NamedTuple):
    """Curvature and presence of a tube at arc lengths (X,) of an arm while it slides from one place to another."""

    now: Array
    """Curvature before the slide, 1/m; 0 without the tube."""
    low: Array
    """Smallest curvature."""
    high: Array
    """Largest curvature."""
    there: Mask
    """True where the tube is before the slide."""
    always: Mask
    """True where it is during all of the slide."""
    once: Mask
    """True where it is during a part of the slide."""

    @staticmethod
    def of(tube: PlanarTube, at: Array, held: Array) -> _Stretches:
        """Stretches at arc lengths `at` (X,), m; `held` (2,) transmission lengths before and after the slide."""
        stretch = np.searchsorted(tube.ends, at + held[:, None])
        first, last, count = stretch.min(0), stretch.max(0), len(tube.ends)
        curvature = np.append(tube.curvature, 0.0)
        seen = (first[:, None] <= np.arange(count + 1)) & (np.arange(count + 1) <= last[:, None])
        low, high = np.where(seen, curvature, np.inf).min(1), np.where(seen, curvature, -np.inf).max(1)
        return _Stretches(curvature[stretch[0]], low, high, stretch[0] < count, last < count, first < count)

    @property
    def bends(self) -> Mask:
        """Mask (X,) of where it is bent at any time."""
        return np.asarray((self.low != 0) | (self.high != 0))


@dataclass(frozen=True, eq=False)
class Slides:
    """Effect of sliding the n tubes, each from 0 to its largest translation, on P couplings."""

    lower: Array
    """(P,) smallest coupling, J; below 0 where a piece that bends the other way may come."""
    upper: Array
    """(P,) largest coupling, J."""
    turn: Array
    """(n,) turn of the base of a tube per torque on it at the whole slide, rad/(N m)."""
    D: Array
    """Incidence matrix (P, n) of pairs and tubes."""
    A: Array
    """(P, U) change of the angles per unknown at the longest transmissions, rad per sqrt(J)."""


@dataclass(frozen=True, eq=False)
class PairForm(Form):
    """Equations of an equilibrium in the angles between its tubes: P couplings, n tubes, U unknowns."""

    psi: Array
    """Angles psi (P,) between the natural bends of coupled tubes, rad."""
    w: Array
    """Couplings w (P,) with quadrature weights, J."""
    A: Array
    """(P, U) change of the angles per unknown, rad per sqrt(J)."""
    G: Array
    """Compliance G = A H^-1 A' (P, P) of the angles, rad/J."""
    J: Array
    """(P, n) change of the angles by the rotations of the tubes."""
    defect: Array
    """(P,) change of psi that the residual of the equations stands for, rad; about 1e-16."""
    slides: Slides | None = None
    """Translations allowed in addition to the rotations."""

    @staticmethod
    def of(equilibrium: Equilibrium) -> PairForm:
        """Pair form of an equilibrium of concentric tubes without a load."""
        # Solved again: an equilibrium that was saved, or found on another mesh, is right to 1e-9 only.
        point = point_of(equilibrium, discretisation=discretisation_of(equilibrium))
        problem, state = point.member.problem, point.state
        theta, moment = state.theta + problem.phase, problem.moment
        first, second = np.triu_indices(moment.shape[1], 1)
        product = (problem.weight / problem.stiffness.sum(1))[:, None] * moment[:, first] * moment[:, second]
        a, pair = np.nonzero(product)
        i, j = first[pair], second[pair]
        # A tube curved backwards pulls in the opposite direction: half a turn is in the angle, and w > 0.
        w, half = np.abs(product[a, pair]), np.where(product[a, pair] < 0, np.pi, 0.0)
        D = np.eye(moment.shape[1])[i] - np.eye(moment.shape[1])[j]
        return _at(theta[a, i] - theta[a, j] + half, w, problem.spread[a, i] - problem.spread[a, j], D, state.z)

    @staticmethod
    def sliding(equilibrium: Equilibrium, slide: Array) -> PairForm:
        """Pair form of planar concentric tubes, on a mesh cut at the breakpoints before and after slides (n,), m."""
        robot, shift, n = equilibrium.robot, equilibrium.translations, equilibrium.robot.n_tubes
        slide = np.minimum(slide, np.array([tube.straight_length for tube in robot.tubes]) - shift)
        before, after = robot.assembly(shift), robot.assembly(shift + slide)
        tubes = planar_tubes(robot)
        kb, kt = (np.array([getattr(tube, name) for tube in tubes]) for name in ("bending", "torsional"))
        moves = [np.array([each.transmission[i] for each in (before, after)]) for i in range(n)]

        meshes = [
            reduced_problem(robot, tuple(at.tolist()), discretisation_of(equilibrium)).mesh
            for at in (shift, shift + slide)
        ]
        longest = min(
            mesh.length[mesh.collocated].max(initial=0.0) or mesh.length.max(initial=0.0) or np.inf for mesh in meshes
        )
        places = [tube.ends - held for tube, both in zip(tubes, moves, strict=True) for held in both]
        cuts = np.unique(np.maximum(np.concatenate([[0.0], *places]), 0).round(12))
        stretch = [
            _Stretches.of(tube, (cuts[:-1] + cuts[1:]) / 2, both) for tube, both in zip(tubes, moves, strict=True)
        ]
        coupled = np.sum([each.bends for each in stretch], axis=0) > 1
        counts = np.maximum(np.ceil(coupled * np.diff(cuts) / longest), 1).astype(int)
        tableau = meshes[0].tableau
        length = np.repeat(np.diff(cuts) / counts, counts)
        start = cuts[0] + np.concatenate([[0.0], np.cumsum(length)[:-1]])
        s = (start[:, None] + length[:, None] * tableau.nodes).ravel()
        # (X, n) at the points.
        along = np.repeat(np.arange(len(cuts) - 1), counts * tableau.degree)
        now, low, high, there, always, once = (
            np.stack([getattr(each, name)[along] for each in stretch], axis=1) for name in _Stretches._fields
        )
        ever = (low != 0) | (high != 0)

        first, second = np.triu_indices(n, 1)
        a, pair = np.nonzero(ever[:, first] & ever[:, second])
        i, j = first[pair], second[pair]
        D, both = np.eye(n)[i] - np.eye(n)[j], (np.eye(n)[i] + np.eye(n)[j]) > 0
        weight = np.outer(length, tableau.weights).ravel()[a] * kb[i] * kb[j]
        # K of the tubes that are there: before, always, and for any of the slides.
        stiffness, min_stiffness, max_stiffness = ((present[a] | both) @ kb for present in (there, always, once))
        corners = np.stack([one[a, i] * two[a, j] for one in (low, high) for two in (low, high)])
        least, most, product = corners.min(0), corners.max(0), now[a, i] * now[a, j]
        # A tube curved backwards pulls in the opposite direction: half a turn is in the angle, and w > 0.
        back = np.where(product == 0, least + most, product) < 0
        half = np.where(back, np.pi, 0.0)
        least, most = np.where(back, -most, least), np.where(back, -least, most)
        w = weight * np.abs(product) / stiffness
        lower = weight * least / np.where(least < 0, min_stiffness, max_stiffness)
        upper = weight * most / np.where(most < 0, max_stiffness, min_stiffness)

        rate = np.broadcast_to(1 / kt[:, None, None], (n, len(length), tableau.degree))
        A, softest = (
            _factors(green_of(tableau, (held[:, None] + start) / kt[:, None], length, rate), ever)
            for held in (before.transmission, np.maximum(before.transmission, after.transmission))
        )
        A, softest = (each[i, a] - each[j, a] for each in (A, softest))
        end = before.end
        theta = np.where(
            s[:, None] > end, equilibrium.tip_rotations, sample_rotation(equilibrium, np.minimum(s, end.max()))
        )
        psi = theta[a, i] - theta[a, j] + half
        z = -A.T @ (w * np.sin(psi))
        for _ in range(POLISH):
            psi = D @ equilibrium.rotations + half + A @ z
            H = np.eye(len(z)) + A.T @ ((w * np.cos(psi))[:, None] * A)
            z = z - np.linalg.solve(H, z + A.T @ (w * np.sin(psi)))
        form = _at(D @ equilibrium.rotations + half + A @ z, w, A, D, z)
        rate_change = (before.transmission - after.transmission) / kt
        return replace(form, slides=Slides(lower, upper, rate_change, D, softest))

    def image(self, y: Array, u: Array) -> Array:
        """Box (..., 2 P) that contains the image of the box [x] under the map. Boxes are written u = (-low, high),
        (..., 2 P).
        """
        image = y + widened(self.G * self.w, range_of_bend(np.sin(self.psi), np.cos(self.psi), u))
        return image if self.slides is None else image + self.slid(self.slides, u)

    def slope(self, u: Array) -> Array:
        """(..., 2 P, 2 P) derivatives of the image of a box [x] by the box, without slides."""
        sine, cosine, count = np.sin(self.psi), np.cos(self.psi), len(self.psi)
        low, high, values = -u[..., :count], u[..., count:], bends(sine, cosine, u)
        by_low, by_high = (sine * np.sin(x) + cosine * (1 - np.cos(x)) for x in (low, high))
        # Rows are the ends of the box of u; the image is linear in the box of the bends, the columns.
        out, k = np.zeros((*u.shape, 2 * count)), np.arange(count)
        for column, which, sign in ((0, values.argmin(0), -1.0), (count, values.argmax(0), 1.0)):
            out[..., k, column + k] = np.where(which == 0, -sign * by_low, 0.0)
            out[..., count + k, column + k] = np.where(which == 1, sign * by_high, 0.0)
        return widened(self.G * self.w, out).swapaxes(-1, -2)

    def slid(self, slides: Slides, u: Array) -> Array:
        """(..., 2 P) widening of the image of a box [x] because of slides."""
        count = len(self.psi)
        # The range of the sine.
        bottom, top = range_of_cosine(self.psi - u[..., :count] - np.pi / 2, self.psi + u[..., count:] - np.pi / 2)
        # Torques T = D' w' sin of the weakest or strongest coupling; turns of the bases from none to the whole one.
        pulls = np.stack([w * sine for w in (slides.lower, slides.upper) for sine in (bottom, top)])
        lower, upper = pulls.min(0), pulls.max(0)
        torques = widened(slides.D.T, np.concatenate([-lower, upper], axis=-1))
        turns = np.maximum(widened(np.diag(slides.turn), torques), 0)
        # -(w' - w) sin, where w' - w is between least - w and most - w.
        changes = np.stack([(self.w - w) * sine for w in (slides.lower, slides.upper) for sine in (bottom, top)])
        strips = np.maximum(np.concatenate([-changes.min(0), changes.max(0)], axis=-1), 0)
        return widened(self.J, turns) + widened(self.G, strips)

    def closed(self, y: Array) -> Array | None:
        """Box around the least fixed point, from below by Newton's method; None if it finds none.

        Plain iteration needs thousands of images close to the largest ball. With slides the map is not convex, so that
        Newton's method steps too far.
        """
        if self.slides is not None:
            return super().closed(y)
        u, one = y, np.ones_like(y)
        for _ in range(NEWTON_STEPS):
            image = self.image(y, u)
            solution = np.linalg.solve(np.eye(u.shape[-1]) - self.slope(u), np.stack([image - u, one], axis=-1))
            step, wider = solution[..., 0], solution[..., 1]
            u = u + step
            # (1 - slope)^-1 has a negative entry: no fixed point is above, so the box never closes.
            if (wider <= 0).any() or u.max() > MOST_CHANGE:
                return None
            if np.abs(step).max() < SPARE:
                break
        return np.asarray(np.maximum(u, 0.0) + SPARE * wider)

    def least_eigenvalue(self, u: Array) -> Array:
        """(S,) lower bound of the eigenvalues of H in each of the boxes (S, 2 P): at the smallest cosines."""
        count = len(self.psi)
        cosine = range_of_cosine(self.psi - u[..., :count], self.psi + u[..., count:])[0]
        A, pull = self.A, self.w * cosine
        if self.slides is not None:
            A, lower, upper = self.slides.A, self.slides.lower, self.slides.upper
            # A coupling that changes its sign may be negative where the cosine is 1.
            pull = np.minimum(np.minimum(lower * cosine, upper * cosine), np.where(lower < 0, lower, np.inf))
        return np.asarray(1 + np.linalg.eigvalsh((A.T * pull[:, None, :]) @ A)[:, 0])

    def under_force(self, force: float, softening: float, torques: Array) -> Array | None:
        """(P,) largest change of the angles, rad, by dead tip forces of at most `force` (N), also while they change.

        None where it is not proved that they cause no snap.

        Args:
            softening: `ArmSections.softening` of 1 N.   torques: as of `tip_torques`.
        """
        x = np.zeros_like(self.psi)
        for _ in range(SWEEPS):
            cosine = range_of_cosine(self.psi - x, self.psi + x)[0]
            H = np.eye(self.A.shape[1]) + self.A.T @ ((self.w * cosine)[:, None] * self.A)
            if np.linalg.eigvalsh(H).min(initial=1.0) <= softening * force + ROUND_OFF:
                return None
            inverse = np.linalg.inv(H)
            work = np.abs(torques @ inverse @ torques.T).sum()
            change = force * np.sqrt(work * np.einsum("pu,uv,pv->p", self.A, inverse, self.A))
            if (change <= x).all():
                return x
            if change.max() > MOST_CHANGE:
                return None
            # The changes grow towards the box from below; a box larger by 1e-4 is left after few sweeps.
            x = (1 + 1e-4) * change + SPARE
        return None

    def boxes(self, r: float) -> Array:
        """(S, 2 P) ranges of the changes J d of the angles over the parts of the ball of radius r, rad."""
        n = self.J.shape[1]
        if n > SECTORS:
            reach = r * np.abs(self.J).sum(1)
            return np.concatenate([reach, reach])[None]
        chains = np.array(
            [np.cumsum(np.eye(n)[list(order)], axis=0)[:-1] for order in itertools.permutations(range(n))]
        )
        corners = 2 * r * chains @ self.J.T
        return np.concatenate([np.maximum(-corners.min(1), 0), np.maximum(corners.max(1), 0)], axis=-1)


def tip_torques(equilibrium: Equilibrium) -> Array:
    """(R, U) largest torques of 1 N at the tip on tubes at collocation points, N m, times the change of the angles by
    the unknowns: rows t L' B of the derivation above.
    """
    problem = reduced_problem(
        equilibrium.robot, tuple(equilibrium.translations.tolist()), discretisation_of(equilibrium)
    )
    lever = equilibrium.arc_length[-1] - problem.arc_length
    largest = (lever / problem.stiffness.sum(1))[:, None] * np.abs(problem.moment)
    rows = (problem.weight[:, None] * largest)[..., None] * problem.spread
    return np.asarray(rows[largest > 0])


def _factors(green: Array, ever: Mask) -> Array:
    """(n, N, U) rows of the square root of the compliance of each tube, at points (N, n) where it can be curved."""
    n, ends = len(green), np.cumsum([0, *ever.sum(0)])
    out = np.zeros((n, len(ever), ends[-1]))
    for k in range(n):
        points = np.flatnonzero(ever[:, k])
        out[k, points, ends[k] : ends[k + 1]] = np.linalg.cholesky(green[k][np.ix_(points, points)])
    return out


def _at(psi: Array, w: Array, A: Array, D: Array, z: Array) -> PairForm:
    """Pair form at angles psi, with unknowns z that solve the equations."""
    cosine = (w * np.cos(psi))[:, None]
    H, gradient = np.eye(len(z)) + A.T @ (cosine * A), z + A.T @ (w * np.sin(psi))
    response = np.linalg.solve(H, np.column_stack([A.T, gradient]))
    G = A @ response[:, :-1]
    return PairForm(psi, w, A, G, D - G @ (cosine * D), np.abs(A @ response[:, -1]))


@typed
@small
@limited
def snap_distance(equilibrium: Equilibrium, *, time_limit: float = TIME_LIMIT) -> SnapDistance:
    """Largest turn of all tubes that is proved to cause no snap, and the snaps by turning one tube.

    Args:
        equilibrium: stable, of concentric tubes, without friction and without load or under dead forces. Translations
            and load stay as they are.
        time_limit: maximum run time, s.

    Raises:
        InputError: an unstable equilibrium, one under friction, or under a load that has moments or turns with the tip;
            eccentric tubes that the certificate does not cover.
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
    return _distance(equilibrium, math.pi)


@small
def least_snap_distance(equilibria: Iterable[Equilibrium]) -> float:
    """Smallest snap distance of equilibria, rad; inf if no turn can snap at any of them.

    Equilibria are checked from the smallest margin on. Most then need one check only: whether their distance is larger
    than the smallest one. A check takes 0.1 ms, under a load 0.1 s.

    Raises:
        InputError: as `snap_distance`.
    """
    smallest = math.inf
    for equilibrium in sorted(equilibria, key=lambda e: e.margin):
        smallest = min(smallest, _distance(equilibrium, smallest).turn)
    return smallest


@small
def proved_turn(equilibrium: Equilibrium, most: float, precision: float = 1.0) -> float:
    """Turn up to `most` (rad) that is proved to cause no snap, to a relative precision; inf if none can snap.

    With precision 1 the answer is `most` or 0: one check.

    Raises:
        InputError: as `snap_distance`.
    """
    return _distance(equilibrium, most, precision).turn


def _distance(equilibrium: Equilibrium, limit: float, precision: float = PRECISION) -> SnapDistance:
    """Snap distance, or `limit` (rad) if that is smaller; errors as of `snap_distance`."""
    start_time, robot = perf_counter(), equilibrium.robot
    refuse_contact(equilibrium)
    if not equilibrium.stable:
        raise InputError(f"equilibrium has a margin of {equilibrium.margin:.3g}; it must be above 0")
    load = equilibrium.load
    if load is not None:
        load.require_energy("its snap distance is not known")
        if isinstance(robot, BundleRobot):
            raise InputError("equilibrium is of a bundle with a load; its snap distance is known without load only")
    compiled = compiled_turn(equilibrium, most=limit, precision=precision) if load is None else None
    radius, couplings, boxes = math.inf, 0, 0
    form: PairForm | LoadedForm | None = None
    if load is not None:
        loaded, free = LoadedForm.of(equilibrium), snap_free_certificate(robot, equilibrium.translations)
        if not loaded_worst_case(robot, equilibrium.translations, free, loaded.largest_force) > ROUND_OFF:
            form, precision = loaded, max(precision, SLOW_PRECISION)
    elif compiled is not None:
        radius, couplings = compiled
    elif not (certificate := snap_free_certificate(robot, equilibrium.translations)) > 0:
        if isinstance(robot, BundleRobot):
            raise InputError("equilibrium is of a bundle without a certificate above 0; its snap distance is not known")
        if robot.assembly(equilibrium.translations).eccentric:
            raise InputError(
                f"equilibrium is of an eccentric robot with a certificate of {certificate:.3g}; it must be above 0: "
                "a finite snap distance is known for concentric robots only"
            )
        form = PairForm.of(equilibrium)
    if form is not None:
        couplings = len(form.psi)
        radius, boxes = largest_turn(form, limit, precision)
    status = SnapDistanceStatus.NEVER if radius == math.inf else SnapDistanceStatus.PROVED
    seconds = perf_counter() - start_time
    return SnapDistance(equilibrium, radius, status, SnapDistanceStatistics(couplings, boxes, seconds))


def largest_turn(form: PairForm | LoadedForm, limit: float, precision: float) -> tuple[float, int]:
    """Largest turn of all tubes up to `limit` (rad) that is proved to cause no snap, and number of tries."""
    if limit < math.pi and form.proves(form.boxes(limit)):
        return limit, 1
    return _largest(lambda r: form.proves(form.boxes(r)), min(FIRST_TURN, limit / 2), min(limit, math.pi), precision)


def _unloaded(equilibrium: Equilibrium, word: str) -> Equilibrium:
    if equilibrium.load is not None:
        raise InputError(f"equilibrium has a load; a {word} is known without load only")
    return equilibrium


def _largest(proves: Callable[[float], bool], first: float, limit: float, precision: float) -> tuple[float, int]:
    """Largest factor below `limit` that is proved, by bisection from `first`, and number of tried factors.

    Each success is a proof by itself; only the size relies on smaller sets being easier to prove.
    """
    proved, refused, tries, factor = 0.0, limit, 0, first
    while refused - proved > precision * refused and refused > SMALLEST * limit:
        check_time()
        tries += 1
        if proves(factor):
            proved, factor = (
                factor,
                min(2 * factor, (factor + refused) / 2) if refused == limit else (factor + refused) / 2,
            )
        else:
            refused, factor = factor, (proved + factor) / 2
    return proved, tries
