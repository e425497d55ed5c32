"""Equilibrium of an arm that touches walls, with the contact forces and the stability that the walls give.

Walls are bodies that the arm cannot enter. The arm touches body k at arc length s_k with the gap

    g_k(x) = d_k(p(s_k; x)) - r(s_k),     d_k the signed distance of the body, r the radius of the arm.

A stable equilibrium is a minimum of the energy E - W of `block/transcription/loaded.py` under g_k >= 0. The walls are
without friction:

    grad (E - W) = sum lambda_k grad g_k,     g_k >= 0,  lambda_k >= 0,  lambda_k g_k = 0,

so that lambda_k is the contact force along n_k = grad d_k. It acts like a force of the load at s_k, but turns with the
wall and moves along the arm to where the gap is smallest, dg/ds = 0. With P = dp/dx, T = dt/dx and D = d'' the second
derivative of the gap is that of a dead force plus

    P' D P - b b' / g_ss,     b = T'n + P' D t,     g_ss = n.p'' + t' D t.

Where two pieces of a vessel meet in an edge, the arm may stay on it: the larger one of two gaps is smallest where they
are equal. Then g is the stationary value of m g_1 + (1 - m) g_2 by s and m, with 0 <= m <= 1. The force lambda n, with
n = m n_1 + (1 - m) n_2, is normal to arm and edge. With y = (s, m) the last term becomes g_xy g_yy^-1 g_yx; y is (s)
elsewhere, and empty at the end of a tube.

Newton's method solves a quadratic program in every step: the dual problem, lambda >= 0, has one unknown per contact.
The margin is the smallest eigenvalue of the second variation on the motions that keep pressed contacts closed.

The walls are first moved back until the arm is free, and then advance to their places: the arm stays on its branch.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
import scipy

from ..block.transcription.loaded import LoadedProblem, LoadedState, compliance, load_problem, loaded_arm
from ..block.transcription.orientation import position_slopes, tangents
from ..block.transcription.second_variation import least, stiffnesses
from ..bodies.obstacles import Obstacle, Scene, scene_of
from ..errors import InputError, SolveError
from ..robots.concentric import ConcentricRobot
from ..robots.load import FORCE, Load, PointLoad, masses
from ..robots.robot import Robot
from ..solvers.blas import small
from ..solvers.box_minimum import minimum_in_box
from ..solvers.time_limit import check_time
from ..typing import Array
from .arm_surface import ArmSurface, outer_radius
from .kinematics import TOLERANCE, equilibrium_of, error_of, forward_kinematics
from .member import Loaded, Point, at_points, discretisation_of, sample_rotation
from .problem import LOADED_DISCRETISATION, LOADED_REFINEMENTS, Discretisation, check_load
from .result import Equilibrium, Status, WallForce, WallState

FLAT = 1e-9
"""Curvature g_ss, 1/m, of the gap along the arm below which a contact has no place of its own, as along a flat wall."""

AROUND_EDGE, FLAT_EDGE = 3e-4, 1e-6
"""Distance (m) along the arm within which an edge is sought, and slope of a gap along the arm that counts as none."""

CURVATURE_STEP = 1e-6
"""Step (m) of the differences of gradients for the curvature of a wall: 1e-10 of it is round-off, as is the error."""

HERE = 1e-9
"""Difference (m) of places along the arm that counts as none."""

DEEP, DEEP_ON_THE_WAY = 1e-7, 1e-6
"""Depth (m) of a wall in the arm from which it is a contact, at last and before: the arm between the shape points is
interpolated to a few 1e-8 m, and on the way it is less accurate."""

TOO_DEEP = 1e-5
"""Depth (m) of a wall in the arm from which an answer is refused: at a corner, a contact may miss the wall."""

SAME_PLACE = 1e-4
"""Distance (m) along the arm within which two contacts with one body count as one."""

LONGEST_ADVANCE = 2e-3
"""Largest advance (m) of the walls per solve: about a tube's diameter, so that the arm cannot pass around a wall."""

SHORTEST_ADVANCE = 1e-6
"""Smallest advance (m) of the walls; where a smaller one would be needed, the branch ends."""

NEWTON_STEPS = 14
"""Largest number of Newton steps of one solve; from a neighbouring solution six to ten suffice."""

LARGEST_TURN = 0.5
"""Largest rotation (rad) of a tube or of the arm in one Newton step; a longer step is shortened."""

WALL_STIFFNESS = 0.0, 1.0, 1e2, 1e4
"""Stiffness of closed contacts in whitened unknowns, where that of the tubes is 1; the first that suffices is used."""

SAME_MOTION = 1e-13
"""Part of the motion that closes a contact below which other contacts close with it, within round-off."""

SHIFTS = tuple(0.1 * 4.0**k for k in range(12))
"""Shifts of a Hessian that is not positive definite, as in `solvers/newton.py`."""

ROUNDS = 40
"""Largest number of searches for further contacts with the walls at one place."""

LAST_CHANGE, STALLED = 1e-9, 1e-7
"""Change (rad, or of a place as a fraction of the arm) after which Newton's method has converged; the second, if the
changes no longer decrease: between two elements the arm has a kink of their error, which a contact may not pass."""

RESERVE = 100.0
"""Factor on the next change that is expected of Newton's method."""

ON_THE_WAY = 1e-5
"""Last change for equilibria from which others are solved: Newton's method squares it in the next step."""

LONGEST_TURN = 0.1
"""Largest rotation (rad) of a joint from one equilibrium of a path to the next."""

SHORTEST_STEP = 2.0**-16
"""Fraction of the longest step of a path below which its branch has ended: 2e-6 rad of a joint."""

SMALL_MOTION, FASTER = 0.02, 4.0
"""Motion (rad) of the arm in a step that is taken as small, and the largest growth of its rate from step to step."""

AT_REST, MOST_FALLS = 1e-3, 200
"""Motion (rad) in a step of a fall below which the arm may rest, and the largest number of steps."""

BLOCKED = "the walls block the arm: it stays on its branch only if they are moved back by"


class Touch(NamedTuple):
    """Possible contact."""

    body: int
    """Number of the body, from 0."""
    arc_length: float
    """Place s on the arm, m."""
    force: float = 0.0
    """Multiplier lambda, N: the size of the force, except at an edge."""
    normal: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Direction n of the force, away from the wall; a unit vector except at an edge."""

    @property
    def size(self) -> float:
        """Size of the force, N."""
        return self.force * math.hypot(*self.normal)

    def along(self, normal: Array) -> Touch:
        """Contact with a force of the same size in the direction n (3,)."""
        x, y, z = normal.tolist()
        return self._replace(force=self.size / math.hypot(x, y, z), normal=(x, y, z))

    @property
    def point_load(self) -> PointLoad:
        """Contact force as a force of a load."""
        x, y, z = self.normal
        return PointLoad(self.arc_length, (self.force * x, self.force * y, self.force * z))


@dataclass(frozen=True, eq=False)
class Walls:
    """Walls around a robot under a given load."""

    robot: Robot
    bodies: tuple[Obstacle, ...]
    load: Load | None

    @property
    def scene(self) -> Scene:
        """Bodies with their trees."""
        return scene_of(self.bodies)

    def total(self, touches: Sequence[Touch]) -> Load:
        """Given load and contact forces."""
        given = self.load or Load()
        return replace(given, points=(*given.points, *(touch.point_load for touch in touches)))

    def described(self, free: Equilibrium) -> Equilibrium:
        """Equilibrium that touches no wall, with its distance from the walls."""
        return replace(free, walls=WallState((), ArmSurface(free).clearance(self.scene), self.load, self.bodies))

    def equations(
        self,
        rotations: Array,
        translations: tuple[float, ...],
        touches: Sequence[Touch] = (),
        discretisation: Discretisation = LOADED_DISCRETISATION,
    ) -> Touching:
        """Equations on a mesh that has the places of contacts between elements."""
        member = Loaded.of(self.robot, rotations, translations, self.total(touches), discretisation)
        given = self.load or Load()
        problem = load_problem(member.torsion, given, masses(self.robot.tubes, given))
        return Touching(self, replace(member, problem=problem))


class Side(NamedTuple):
    """Wall near a point, where it is smooth."""

    distance: float
    """Distance of the point, m."""
    normal: Array
    """Gradient (3,) of the distance."""
    curvature: Array
    """Second derivative (3, 3) of the distance, 1/m."""

    def with_share(self, share: float, other: Side) -> Side:
        """Mean of this side and another one; `share` is the weight of this one."""
        rest = 1 - share
        return Side(
            share * self.distance + rest * other.distance,
            share * self.normal + rest * other.normal,
            share * self.curvature + rest * other.curvature,
        )


@dataclass(frozen=True, eq=False)
class Gap:
    """Gap at a possible contact, with its derivatives by the unknowns x (X,)."""

    value: float
    """Gap, m."""
    normal: Array
    """Direction n (3,) away from the wall."""
    place: Array
    """Derivative P (3, X) of the point of the arm."""
    tangent: Array
    """Tangent t (3,) of the arm."""
    turn: Array
    """Derivative T (3, X) of the tangent."""
    wall: Array
    """Second derivative D (3, 3) of the distance, 1/m."""
    off: Array
    """Derivatives (k,) of the gap by y, 0 at last: y is (s), (s, m) at an edge, () at the end of a tube."""
    bend: Array
    """Second derivative (k, k) of the gap by y."""
    by_point: Array
    """Derivative (k, 3) of `off` by the point of the arm, beside the tangent."""
    by_tangent: Array
    """Derivative (k, 3) of `off` by the tangent of the arm."""

    @cached_property
    def mixed(self) -> Array:
        """Derivative (k, X) of `off` by x."""
        return np.asarray(self.by_tangent @ self.turn + self.by_point @ self.place)

    @property
    def by_x(self) -> Array:
        """Derivative (X,) of the gap."""
        return np.asarray(self.normal @ self.place)

    @property
    def second(self) -> Array:
        """Second derivative (X, X) of the gap, less that of a dead force."""
        out = self.place.T @ self.wall @ self.place
        return np.asarray(out + self.mixed.T @ self.shift(self.mixed))

    def shift(self, change: Array) -> Array:
        """Change of y (k, ...) that keeps `off` at 0 if it changes by `change` (k, ...)."""
        if len(self.bend) < 2:  # without y, `change` is empty
            return np.asarray(-change / self.bend.sum())
        return np.asarray(-np.linalg.solve(self.bend, change))


class Stretch(NamedTuple):
    """Part of the arm with one radius."""

    start: float
    """Arc length, m."""
    end: float
    """Arc length, m."""
    radius: float
    """Radius of the arm, m."""


class Anchor(NamedTuple):
    """Quadratic term (x - x0)'(x - x0) / (2 dt) of an implicit Euler step of x' = -grad E."""

    x: Array
    """Unknowns x0 (X,) before the step."""
    rate: float
    """Inverse 1 / dt of the time step."""


@dataclass(frozen=True, eq=False)
class Touching:
    """Equations of an arm with possible contacts, on one mesh."""

    walls: Walls
    member: Loaded
    """Equations under the given load."""

    @cached_property
    def _steps(self) -> tuple[Array, Array]:
        """Arc lengths of the ends of tubes in order, m, and the radius of the arm up to each, m."""
        ends = np.maximum(self.member.torsion.assembly.end, 0.0)
        order = np.argsort(ends)
        radius = np.maximum.accumulate(outer_radius(self.walls.robot)[order][::-1])[::-1]
        in_front = ends[order] > 0
        return ends[order][in_front], radius[in_front]

    def stretch(self, s: float) -> Stretch:
        """Part of the arm around arc length s."""
        ends, radius = self._steps
        k = min(int(np.searchsorted(ends, s - HERE)), len(ends) - 1)
        return Stretch(float(ends[k - 1]) if k else 0.0, float(ends[k]), float(radius[k]))

    @cached_property
    def _known_weights(self) -> dict[float, Array]:
        return {}

    def weights(self, s: float) -> Array:
        """Weights (3, N) of the tangents at the points: for the position at s, and its first and second derivative."""
        if s in self._known_weights:
            return self._known_weights[s]
        mesh, t = self.member.problem.mesh, self.member.problem.mesh.tableau
        (element,), x = mesh.locate(np.array([s]))
        points = slice(element * t.degree, (element + 1) * t.degree)
        out, h = np.zeros((3, len(self.member.problem.softness))), mesh.length[element]
        out[0, : points.start] = self.member.torsion.weight[: points.start]
        for k, integrals in enumerate((1, 0, -1)):
            out[k, points] = t.lagrange(x, integrals=integrals)[0] * h**integrals
        self._known_weights[s] = out
        return out

    def problem(self, touches: Sequence[Touch]) -> LoadedProblem:
        """Equations with the contact forces as dead forces at their places."""
        problem = self.member.problem
        ahead = problem.ahead.copy()
        for touch in touches:
            # The work of a force at s is F.p(s) = F.sum w_a t_a.
            weight = self.weights(touch.arc_length)[0] / problem.torsion.weight
            ahead[:, FORCE] += np.outer(weight, np.multiply(touch.force, touch.normal))
        return replace(problem, ahead=ahead)

    def at(self, x: Array, touches: Sequence[Touch]) -> LoadedState:
        """State at unknowns x (X,) under the contact forces."""
        return replace(self.member, problem=self.problem(touches)).at(x)

    def surface(self, state: LoadedState) -> ArmSurface:
        """Surface of the arm in a state."""
        member = self.member
        shape = loaded_arm(member.problem, member.profile(state), state)
        ends = np.maximum(member.torsion.assembly.end, 0.0)
        arm: Any = _Arm(member.robot, shape.arc_length, shape.position, shape.frame, shape.curvature, ends)
        return ArmSurface(arm)

    def gap(self, state: LoadedState, touch: Touch) -> Gap:
        """Gap at a possible contact."""
        body, stretch = self.walls.bodies[touch.body], self.stretch(touch.arc_length)
        weights = self.weights(touch.arc_length)
        point, along, bent = weights @ tangents(state.orientation.stage)
        place, turn = position_slopes(state.orientation, weights[:2]) @ state.curvature_slope
        sides = self._sides(state, touch, stretch, point, along)
        if len(sides) == 2:
            before, after = sides
            slopes = np.array([side.normal @ along for side in sides])
            wall = before.with_share(float(slopes[1] / (slopes[1] - slopes[0])), after)
        else:
            wall = side_of(body, point)
        slope, bend = float(wall.normal @ along), float(wall.normal @ bent + along @ wall.curvature @ along)
        # At the end of a tube the corner touches, unless the gap is smaller inside.
        inside = (touch.arc_length > stretch.start + HERE or slope < 0) and (
            touch.arc_length < stretch.end - HERE or slope > 0
        )
        off, second = np.array([slope]), np.array([[bend]])
        by_point, by_tangent = along[None] @ wall.curvature, wall.normal[None]
        if len(sides) == 2:
            apart, across = slopes[0] - slopes[1], before.normal - after.normal
            off, second = np.array([0.0, before.distance - after.distance]), np.array([[bend, apart], [apart, 0.0]])
            by_point, by_tangent = np.vstack([by_point, across]), np.vstack([by_tangent, np.zeros(3)])
        elif not (inside and bend > FLAT):
            off, second, by_point, by_tangent = off[:0], second[:0, :0], by_point[:0], by_tangent[:0]
        return Gap(
            value=wall.distance - stretch.radius,
            normal=wall.normal,
            place=place,
            tangent=along,
            turn=turn,
            wall=wall.curvature,
            off=off,
            bend=second,
            by_point=by_point,
            by_tangent=by_tangent,
        )

    def _sides(self, state: LoadedState, touch: Touch, stretch: Stretch, point: Array, along: Array) -> list[Side]:
        """Both sides of an edge on which the arm stays at a contact, the one towards the base first; otherwise none."""
        body: Any = self.walls.bodies[touch.body]
        if not hasattr(body, "pieces"):
            return []
        ends = np.clip(touch.arc_length + np.array([-AROUND_EDGE, AROUND_EDGE]), stretch.start, stretch.end)
        # Straight on: an edge is sought nearby.
        first, last = body.depths(point + (ends - touch.arc_length)[:, None] * along).argmax(0).tolist()
        if first == last:
            return []
        sides = [side_of(body.pieces[k], point) for k in (first, last)]
        # Only on an edge does one gap grow where the other one shrinks.
        shrinks, grows = (float(side.normal @ along) for side in sides)
        return sides if shrinks < -FLAT_EDGE and grows > FLAT_EDGE else []

    def solve(
        self,
        x: Array,
        touches: Sequence[Touch],
        back: float,
        anchor: Anchor | None,
        last_change: float,
    ) -> Solved | None:
        """Equilibrium with the walls moved `back`, m, from unknowns x (X,), or None if Newton's method fails."""
        known, last = list(touches), np.inf
        length = self.member.torsion.assembly.total_length
        for iteration in range(1, NEWTON_STEPS + 1):
            check_time()
            state = self.at(x, known)
            gaps = [self.gap(state, touch) for touch in known]
            step = self._step(state, known, gaps, back, anchor)
            turn = np.inf if step is None else self.member.largest_rotation(state, step.x)
            if step is None or not turn < np.inf:
                return None
            scale = min(1.0, LARGEST_TURN / max(turn, LARGEST_TURN))
            x = x + scale * step.x
            moved, shift = [], 0.0
            for touch, gap, force in zip(known, gaps, step.forces.tolist(), strict=True):
                s, stretch = touch.arc_length, self.stretch(touch.arc_length)
                if len(gap.off):
                    # Newton's step of dg/dy = 0.
                    s += scale * float(gap.shift(gap.off + gap.mixed @ step.x)[0])
                    s = min(max(s, stretch.start), stretch.end)
                    shift = max(shift, abs(s - touch.arc_length) * (force > 0))
                normal = gap.normal.tolist()
                moved.append(Touch(touch.body, s, force, (normal[0], normal[1], normal[2])))
            change = max(turn, shift / length)
            # Newton's method with the same contacts squares its changes: the next one is about this.
            same = scale == 1 and [t.force > 0 for t in known] == [t.force > 0 for t in moved]
            following = change**3 / last**2 if same and change < last / 10 < np.inf else np.inf
            settled = min(change, RESERVE * following) < last_change or (change < STALLED and change > last / 2)
            known, last = _merged(moved), change
            if settled:
                return Solved(self, x, tuple(known), iteration)
        return None

    def _step(
        self, state: LoadedState, touches: Sequence[Touch], gaps: Sequence[Gap], back: float, anchor: Anchor | None
    ) -> _Step | None:
        """Newton step: the solution of the quadratic program, or None if it has none."""
        hessian, slope = state.hessian.copy(), state.gradient.copy()
        if anchor is not None:
            hessian.ravel()[:: len(hessian) + 1] += anchor.rate
            slope += anchor.rate * (state.x - anchor.x)
        for touch, gap in zip(touches, gaps, strict=True):
            if touch.force:
                hessian -= touch.force * gap.second
                slope += touch.force * (np.array(touch.normal) @ gap.place)
        rows = np.array([gap.by_x for gap in gaps]).reshape(len(gaps), len(slope))
        factor = _definite(hessian, rows[[touch.force > 0 for touch in touches]])
        if factor is None:
            return None
        solved = scipy.linalg.cho_solve((factor, True), np.column_stack([slope, rows.T]))
        free = -solved[:, 0]
        if not len(gaps):
            return _Step(free, np.zeros(0))
        # min f'Cf / 2 + f.(g + A dx), f >= 0, with the compliance C of the contacts: the dual problem.
        dual = minimum_in_box(
            rows @ solved[:, 1:],
            np.array([gap.value + back for gap in gaps]) + rows @ free,
            (np.zeros(len(gaps)), np.full(len(gaps), np.inf)),
            np.array([touch.force for touch in touches]),
            solve=lambda matrix, right: np.linalg.lstsq(matrix, right, rcond=1e-12)[0],
            round_off=1e-13,
        )
        return None if dual is None else _Step(free + solved[:, 1:] @ dual.x, dual.x)

    def curved(self, state: LoadedState, touches: Sequence[Touch]) -> tuple[Array, Array]:
        """Second variation (X, X) on all motions, and the derivatives (K, X) of the gaps of contacts with a force."""
        hessian, rows = state.hessian.copy(), []
        for touch in touches:
            if touch.force > 0:
                gap = self.gap(state, touch)
                hessian -= touch.force * gap.second
                rows.append(gap.by_x)
        return hessian, np.array(rows).reshape(len(rows), len(hessian))

    def second_variation(self, state: LoadedState, touches: Sequence[Touch]) -> SecondVariation:
        """Second variation on the motions that keep all contacts with a force closed."""
        hessian, rows = self.curved(state, touches)
        if not len(rows):
            return SecondVariation(hessian, hessian, np.eye(len(hessian)))
        basis, triangle, _ = scipy.linalg.qr(rows.T, pivoting=True)
        size = np.abs(np.diag(triangle))
        motions = basis[:, (size > SAME_MOTION * size[0]).sum() :]
        return SecondVariation(hessian, motions.T @ hessian @ motions, motions)


class SecondVariation(NamedTuple):
    """Second variation on M motions."""

    hessian: Array
    """Second variation (X, X) on all motions."""
    form: Array
    """Matrix (M, M)."""
    motions: Array
    """Motions (X, M), orthonormal."""

    def response(self, forces: Array) -> Array:
        """Motion (X, R) of the unknowns by forces (X, R)."""
        return np.asarray(self.motions @ np.linalg.solve(self.form, self.motions.T @ forces))


class _Step(NamedTuple):
    """Step of Newton's method."""

    x: Array
    """Change (X,) of the unknowns."""
    forces: Array
    """Contact forces (K,), N."""


class _Arm(NamedTuple):
    """Arm of a state, as far as its surface needs it."""

    robot: Robot
    arc_length: Array
    position: Array
    frame: Array
    curvature: Array
    tube_end: Array


@dataclass(frozen=True, eq=False)
class Solved:
    """Equilibrium with the walls at one place."""

    touching: Touching
    x: Array
    """Unknowns (X,)."""
    touches: tuple[Touch, ...]
    """Possible contacts."""
    iterations: int

    @property
    def pressed(self) -> tuple[Touch, ...]:
        """Contacts with a force, base to tip."""
        return tuple(sorted((t for t in self.touches if t.force > 0), key=lambda touch: touch.arc_length))

    @cached_property
    def state(self) -> LoadedState:
        """State under the contact forces."""
        return self.touching.at(self.x, self.touches)

    @property
    def clearance(self) -> float:
        """Smallest distance of the arm's surface from the walls, m; negative inside."""
        return self.touching.surface(self.state).clearance(self.touching.walls.scene)

    @cached_property
    def margin(self) -> float:
        """Smallest eigenvalue of the second variation on motions that keep pressed contacts closed."""
        return least(self.touching.second_variation(self.state, self.touches).form)

    @cached_property
    def stable(self) -> bool:
        """True if the margin is positive."""
        # The stiffness of closed contacts does no work on motions that keep them closed.
        hessian, rows = self.touching.curved(self.state, self.touches)
        return _cholesky(hessian, WALL_STIFFNESS[-1] * _closed(rows)) is not None or self.margin > 0

    def point(self) -> Point[Loaded, LoadedState]:
        """Point of the equations with the contact forces as dead forces."""
        member = replace(self.touching.member, problem=self.touching.problem(self.touches))
        return Point(0.0, member, self.state, 1.0)

    def on(self, touching: Touching) -> Array:
        """Unknowns (X,) of this equilibrium in other equations."""
        if touching.member.problem.torsion is self.touching.member.problem.torsion:
            return self.x
        return touching.member.transfer(self.point())

    def at_joints(self, rotations: Array, translations: Array, robot: Robot | None = None) -> Solved | None:
        """Equilibrium at joint values (n,) close to those of this one, with all walls in place, or None.

        Args:
            robot: almost the same robot, or None for the same.
        """
        walls, shift = self.touching.walls, tuple(translations.tolist())
        if robot is None and shift == self.touching.member.translations:
            touching = replace(self.touching, member=replace(self.touching.member, rotations=rotations))
            return Solved(touching, self.x, self.touches, 0).complete(0.0)
        touching = replace(walls, robot=robot or walls.robot).equations(rotations, shift, self.pressed)
        return Solved(touching, self.on(touching), self.pressed, 0).complete(0.0)

    def distance(self, other: Solved) -> float:
        """Largest difference (rad) of a twist, and of the frame of the arm, from another equilibrium."""
        return self.touching.member.distance(other.point(), self.state)

    def complete(self, back: float, anchor: Anchor | None = None, *, final: bool = False) -> Solved | None:
        """Equilibrium with contacts wherever a wall is in the arm; None if Newton's method fails."""
        accuracy = LAST_CHANGE if final else ON_THE_WAY
        trial = self.touching.solve(self.x, self.touches, back, anchor, accuracy)
        for _ in range(ROUNDS):
            if trial is None:
                return None
            kept = trial.pressed
            new = trial.further(kept, back, DEEP if final else DEEP_ON_THE_WAY)
            if not new:
                return trial
            more = self.touching.solve(trial.x, (*kept, *new), back, anchor, accuracy)
            # More new contacts than the arm can give way to at once have no solution: the deepest comes first.
            trial = more or self.touching.solve(trial.x, (*kept, new[0]), back, anchor, accuracy)
            if trial is not None and _same_places(kept, trial.pressed):
                # The new contacts carry no force: they were as deep as the arm is accurate.
                return trial
        return None

    def further(self, kept: Sequence[Touch], back: float, deep: float) -> list[Touch]:
        """Further contacts where walls are deeper in the arm than `deep`, m, the deepest first."""
        near = self.touching.surface(self.state).contacts(self.touching.walls.scene, -back)
        new: list[Touch] = []
        for k in np.argsort(near.distance).tolist():
            body, s = int(near.body[k]), float(near.arc_length[k])
            taken = any(t.body == body and abs(t.arc_length - s) < SAME_PLACE for t in (*kept, *new))
            if near.distance[k] + back < -deep and not taken:
                new.append(Touch(body, s))
        return new


def _definite(hessian: Array, rows: Array) -> Array | None:
    """Cholesky factor of a Hessian, made positive definite by closed contacts, or by a shift if these do not suffice.

    Closed contacts (K, X) allow no motion along their rows: stiffness added there changes no step that keeps them
    closed. A shift shortens steps.
    """
    closed = _closed(rows)
    for stiffness, shift in (*((k, 0.0) for k in WALL_STIFFNESS), *((WALL_STIFFNESS[-1], k) for k in SHIFTS)):
        factor = _cholesky(hessian, stiffness * closed, shift)
        if factor is not None:
            return factor
    return None


def _closed(rows: Array) -> Array:
    """Stiffness (X, X) of closed contacts (K, X) of unit size."""
    scaled = rows / np.maximum(np.linalg.norm(rows, axis=1), 1e-300)[:, None]
    return np.asarray(scaled.T @ scaled)


def _cholesky(hessian: Array, closed: Array, shift: float = 0.0) -> Array | None:
    """Lower Cholesky factor of the sum of a Hessian, a stiffness and a shift; None if it is not positive definite."""
    matrix = hessian + closed
    matrix.ravel()[:: len(matrix) + 1] += shift
    factor, failed = scipy.linalg.lapack.dpotrf(matrix, lower=True)
    return None if failed else np.asarray(factor)


def _merged(touches: Sequence[Touch]) -> list[Touch]:
    """Possible contacts, those that moved to one place as one with the sum of their forces."""
    out: list[Touch] = []
    for touch in touches:
        for k, other in enumerate(out):
            if touch.body == other.body and abs(touch.arc_length - other.arc_length) < SAME_PLACE:
                out[k] = other._replace(force=other.force + touch.force)
                break
        else:
            out.append(touch)
    return out


def side_of(body: Obstacle, point: Array) -> Side:
    """Wall of a body near a point (3,); its curvature by differences of gradients."""
    gradient = body.gradient(point + CURVATURE_STEP * STAR)
    out = (gradient[1:4] - gradient[4:]) / (2 * CURVATURE_STEP)
    return Side(float(body.signed_distance(point)), gradient[0], (out + out.T) / 2)


STAR = np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
"""Directions (7, 3) to a point and its neighbours."""


# --- Along a path of joint values -------------------------------------------------------------------------------------


P = TypeVar("P")


class Milestone(NamedTuple, Generic[P]):
    """Equilibrium on a path of joint values."""

    t: float
    """Fraction of the path."""
    state: P


def along_joints(
    start: Solved, rotations: Array, translations: Array, shortest: float = SHORTEST_STEP
) -> Iterator[Milestone[Solved]]:
    """Stable equilibria on the straight path to joint values (n,), without `start`, as far as its branch reaches.

    The last one is at t = 1, or less than the fraction `shortest` of a step before the branch ends.
    """
    member = start.touching.member
    turn, shift = rotations - member.rotations, translations - np.array(member.translations)
    longest = 1 / max(1.0, float(np.abs(turn).max()) / LONGEST_TURN, float(np.abs(shift).max()) / LONGEST_ADVANCE)
    step, last, rate = longest, Milestone(0.0, start), 0.0
    while last.t < 1:
        t = min(1.0, last.t + step)
        following = last.state.at_joints(member.rotations + t * turn, np.array(member.translations) + t * shift)
        distance = np.inf if following is None else following.distance(last.state)
        # The arm moves about as fast as before, or it has left the branch for another one.
        near = distance <= max(SMALL_MOTION, FASTER * rate * (t - last.t)) and distance <= LARGEST_TURN
        if following is not None and near and following.stable:
            rate = distance / (t - last.t)
            last, step = Milestone(t, following), min(2 * step, longest)
            yield last
        elif step < shortest * longest:
            return
        else:
            step = min(step, t - last.t) / 2


def landed(lost: Solved) -> Solved:
    """Stable equilibrium in which the arm comes to rest after its equilibrium is lost; drag replaces inertia.

    Implicit Euler steps of x' = -grad E among the walls. Every step lowers the energy, and time steps grow into
    Newton's method.

    Raises:
        SolveError: it comes to rest nowhere.
    """
    current, rate = lost, 1.0
    for _ in range(MOST_FALLS):
        following = current.complete(0.0, Anchor(current.x, rate))
        if following is None or following.distance(current) > LARGEST_TURN:
            rate *= 4
            continue
        at_rest = following.distance(current) < AT_REST
        current, rate = following, rate / 4
        if at_rest:
            final = current.complete(0.0)
            if final is not None and final.stable:
                return final
    raise SolveError("the arm snaps, and comes to rest nowhere among the walls")


# --- From an equilibrium to contact, and back -------------------------------------------------------------------------


@small
def among_walls(
    robot: Robot,
    rotations: Array,
    translations: Array,
    load: Load | None,
    bodies: tuple[Obstacle, ...],
    start: Equilibrium | None,
) -> Equilibrium:
    """Stable equilibrium of a robot among walls, at joint values (n,), rad and m, and under a load.

    Raises:
        InputError: a robot or a load without an energy, or a wall in the arm at the plate.
        SolveError: the walls block the arm, or the branch of the start ends on the way to the joint values.
    """
    if not isinstance(robot, ConcentricRobot):
        raise InputError("walls are given; contact is solved for concentric robots only")
    if load is not None:
        load.require_energy("walls cannot be given with it")
    start_time, walls = time.perf_counter(), Walls(robot, bodies, load)
    if start is None:
        free = forward_kinematics(robot, rotations, translations, load=load)
        if ArmSurface(free).clearance(walls.scene) >= 0:
            return walls.described(free)
        return at_walls(advanced(start_of(free, walls)), start_time)
    last = Milestone(0.0, advanced(start_of(start, walls)))
    for step in along_joints(last.state, rotations, translations):
        last = step
    pose = at_walls(last.state, start_time)
    if last.t < 1:
        raise SolveError(f"{Status.BRANCH_ENDED}: it ends {100 * last.t:.2f} % of the path from the start", pose)
    return pose


def start_of(equilibrium: Equilibrium, walls: Walls, mesh: Discretisation = LOADED_DISCRETISATION) -> Solved:
    """Equations among walls with the unknowns of an equilibrium, which is no solution if a wall is in its arm."""
    check_load(walls.robot, walls.load or Load(), tuple(equilibrium.translations.tolist()))
    known = [] if equilibrium.walls is None else [touch_of(contact) for contact in equilibrium.walls.contacts]
    touching = walls.equations(equilibrium.rotations, tuple(equilibrium.translations.tolist()), known, mesh)
    theta, curvature = at_points(equilibrium, touching.member.problem)
    x = touching.member.unknowns(theta, curvature)
    if any(hasattr(walls.bodies[touch.body], "pieces") for touch in known):
        # At an edge the size of the force is not its multiplier.
        state = touching.at(x, known)
        known = [touch.along(touching.gap(state, touch).normal) for touch in known]
    return Solved(touching, x, tuple(known), 0)


def touch_of(contact: WallForce) -> Touch:
    """Contact of a result as a possible contact."""
    x, y, z = (part / contact.size for part in contact.force)
    return Touch(contact.body - 1, contact.arc_length, contact.size, (x, y, z))


def advanced(solved: Solved) -> Solved:
    """Equilibrium among walls from one that they may have entered: they are moved back, and advance step by step.

    Raises:
        InputError: a wall is in the arm at the plate.
        SolveError: the walls block the arm.
    """
    scene, radius = solved.touching.walls.scene, solved.touching.stretch(0.0).radius
    at_plate = float(scene.nearest(np.zeros((1, 3)))[0]) - radius
    if at_plate < 0:
        raise InputError(f"a wall is {-1e3 * at_plate:.3g} mm deep in the arm at the base plate; it must be outside")
    back = max(0.0, -solved.clearance)
    advance = LONGEST_ADVANCE
    while True:
        target = max(0.0, back - advance)
        trial = solved.complete(target)
        if trial is not None:
            solved, back = trial, target
            advance = min(2 * advance, LONGEST_ADVANCE)
            if not back:
                return solved
        elif advance < SHORTEST_ADVANCE:
            raise SolveError(f"{BLOCKED} {1e3 * back:.3g} mm")
        else:
            advance /= 2


def at_walls(solved: Solved, start_time: float = 0.0) -> Equilibrium:
    """Equilibrium of a solution, on a mesh with the contacts between elements that is fine enough.

    Args:
        start_time: start of the clock, s; 0 if unknown.

    Raises:
        SolveError: no mesh is fine enough.
    """
    walls, member = solved.touching.walls, solved.touching.member
    for refinement in range(LOADED_REFINEMENTS + 1):
        for _ in range(3):
            # A contact moves a little when the mesh follows it.
            before = solved.pressed
            mesh = replace(LOADED_DISCRETISATION, refinement=refinement)
            touching = walls.equations(member.rotations, member.translations, before, mesh)
            again = Solved(touching, solved.on(touching), before, 0).complete(0.0, final=True)
            if again is None:
                raise SolveError(f"{Status.NOT_CONVERGED} on a finer mesh: the solution on the coarse mesh is not one")
            solved = again
            if _same_places(before, again.pressed):
                break
        held = Loaded.of(walls.robot, member.rotations, member.translations, walls.total(solved.pressed), mesh)
        failure = f"{Status.NOT_CONVERGED} under its contact forces"
        point = Point.solved_near(held, held.transfer(solved.point()), failure)
        equilibrium = equilibrium_of(held, held.solution(point), "walls", start_time)
        if not solved.pressed and walls.load is None:
            return walls.described(_unloaded(equilibrium))
        if error_of(equilibrium) <= TOLERANCE:
            return _described(equilibrium, solved)
    raise SolveError(f"{Status.MESH_TOO_COARSE}: the estimated error is {error_of(equilibrium):.1e} rad", equilibrium)


def _unloaded(equilibrium: Equilibrium) -> Equilibrium:
    """Equilibrium without load from one under a load of zero."""
    alpha, shift = equilibrium.rotations, equilibrium.translations
    return equilibrium.at(equilibrium.robot, alpha, shift, lambda s: sample_rotation(equilibrium, s).T)


def _same_places(before: Sequence[Touch], after: Sequence[Touch]) -> bool:
    """True if contacts have not moved along the arm."""
    if len(before) != len(after):
        return False
    return all(abs(a.arc_length - b.arc_length) < HERE for a, b in zip(before, after, strict=True))


def _described(equilibrium: Equilibrium, solved: Solved) -> Equilibrium:
    """Equilibrium with its contacts, and the margin that they give."""
    touching, state, walls = solved.touching, solved.state, solved.touching.walls
    second = touching.second_variation(state, solved.touches)
    stiffness, surface = stiffnesses(second.form, symmetric=True), ArmSurface(equilibrium)
    margin = min(1.0, float(stiffness.min(initial=1.0)))
    clearance = surface.clearance(walls.scene)
    if clearance < -TOO_DEEP:
        raise SolveError(f"{Status.NOT_CONVERGED}: a wall is {-1e3 * clearance:.3g} mm deep in the arm", equilibrium)
    contacts = []
    for touch in solved.pressed:
        x, y, z = surface.centreline(np.array([touch.arc_length]))[0].tolist()
        contacts.append(WallForce(touch.body + 1, touch.arc_length, (x, y, z), touch.point_load.force))
    return replace(
        equilibrium,
        margin=margin,
        index=int((stiffness < 0).sum()),
        status=Status.STABLE if margin > 0 else Status.UNSTABLE,
        work=touching.member.at(solved.x).work,
        walls=WallState(tuple(contacts), clearance, walls.load, walls.bodies),
    )


def solution_of(equilibrium: Equilibrium) -> Solved:
    """Solution of an equilibrium that touches walls.

    Raises:
        InputError: an equilibrium from a file, which has no walls.
    """
    assert equilibrium.walls is not None
    if not equilibrium.walls.bodies:
        raise InputError("the equilibrium touches walls, and its file does not hold them; solve it again among walls")
    walls = Walls(equilibrium.robot, equilibrium.walls.bodies, equilibrium.walls.load)
    return start_of(equilibrium, walls, discretisation_of(equilibrium))


def compliance_among_walls(equilibrium: Equilibrium) -> Array:
    """Compliance (6, 6) of the tip of an arm that touches walls, which stay closed; `Equilibrium.compliance`.

    Raises:
        InputError: an equilibrium from a file, which has no walls.
    """
    solved = solution_of(equilibrium)
    touching, state = solved.touching, solved.state
    torsion = touching.member.torsion
    second = touching.second_variation(state, solved.touches)
    tip = torsion.assembly.total_length, torsion.tip_tube
    return compliance(touching.problem(solved.touches), state, *tip, responds=second.response)
