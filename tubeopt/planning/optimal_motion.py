"""Optimal motion in a program of the user: cubics between knots, with one explicit equilibrium at every knot.

The unknowns are those of `smoothing`: at every knot the joint values q, their rates q' by a time from 0 to 1, and the
tip rotations z, in which an equilibrium is explicit; and the square S = T^2 of the duration. The equations are

    alpha(z_k, d_k) = rotations of q_k,   fields(z_k, d_k, margin) > 0,

with the translations d_k of q_k. Ranges, order, rates and accelerations are bounds on Bezier coefficients, so they hold
at all times. Margin and clearance hold at knots: `Motion.trajectory` follows the equilibria between them, and
`Motion.solve` raises the reserve at knots until they hold there too. Where breakpoints of tubes meet, derivatives of
equilibria jump: a solve that oscillates there is repeated with a fixed order of breakpoints, which are then swapped.
Distances from bodies are evaluated only at equilibria close to them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicHermiteSpline

from ..arguments import typed
from ..block.composed import as_program
from ..bodies.obstacles import Obstacle, checked_obstacles, scene_of
from ..equilibrium.arm_surface import ArmSurface
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import MIN_MARGIN, Equilibrium
from ..errors import InputError, SolveError, instance, positive, vector, whole
from ..files.field_metadata import TYPICAL_CLEARANCE, typical_length
from ..inverse import InverseOptions, inverse_kinematics
from ..inverse.clock import Clock
from ..inverse.goal import unit_vector
from ..inverse.joints import joint_space
from ..inverse.search import find_path, shorten
from ..inverse.task import TipCoordinates
from ..robots.limits import JointLimits
from ..robots.robot import Robot, check_robot
from ..solvers.named_program import MANY_DIRECTIONS, NamedProgram, ProblemSolution, ProblemStatus
from ..solvers.settings import NEAR_SOLUTION, Ipopt
from ..typing import Array, Mask
from .knots import Cubics, arm_at_knot
from .motion import ANY_RATES, DEFAULT_RATES, JointMotion, RateLimits
from .plan import Faults, build
from .question import PlanOptions, PlanTask, plan_task
from .smoothing import JOINT_ROUND_OFF, LEAST_FIELDS, MARGIN_RESERVE, TWIST
from .timing import SHORTEST, Limits, joint_curves, through, violated
from .trajectory import PlanStatistics, Trajectory

# Joint values alone could jump to another branch. The fastest interval of a motion from rest to rest is about twice as
# long as the mean one.
LONGEST_TWIST = 4.0
"""Limit on the change of a tip rotation between knots, relative to the mean one of the start."""

FIRST_RESERVES = (MARGIN_RESERVE, 5e-5)
"""First reserves of the margin and of the clearance, m, at knots."""

LEAST_RESERVES = 1e-5, 2e-6
"""Smallest increases of the reserves of margin and clearance, m."""

ROOM = 3e-5
"""Reserve of margin and clearance, m, where the proof finds less between samples than at them."""

REPETITIONS = 4
"""Maximum number of solves with a larger reserve."""

SEARCH_WORK, SHORTEN_WORK = 3.0, 1.0
"""Largest work of the search for a first path among bodies, and of its shortening, in seconds of counted work
(`task.Work`): not limited by time, so that the path does not depend on the load of the machine."""

APART, LEAST_FORCE = 1e-6, 1e-4
"""Smallest distance of ordered breakpoints over the length of the robot, and smallest multiplier of it that swaps
them."""

FAR, NEAR = 1.0, 0.02
"""Distances from bodies, m: beyond the first an equilibrium has no constraint. Up to the second plus the clearance it
has one.
"""

ORDERS = 4
"""Maximum number of orders of breakpoints that are solved."""

# The start is nearly a motion; a larger barrier would move it away from its path, and takes twice as many iterations.
# With relaxed bounds the second may stop at an "acceptable" solution, just before the optimum.
SOLVERS = (
    Ipopt(tolerance=1e-8, iterations=200, barrier=1e-4, push=1e-5),
    Ipopt(tolerance=1e-8, barrier=1e-2, further={"bound_relax_factor": 0.0}),
)
"""Settings for a `Problem`, and those after they failed."""

ROUGH = Ipopt(tolerance=1e-3, iterations=40, barrier=1e-4, push=1e-5)
"""Settings for a start."""

# Inside a body nearly all steps are shortened. Full steps for a while, without a test, lead out of it sooner.
QUICK = (
    Ipopt(
        tolerance=1e-8,
        iterations=100,
        barrier=1e-3,
        push=1e-4,
        further={"watchdog_shortened_iter_trigger": 1, "watchdog_trial_iter_max": 10},
    ),
)
"""Settings for a start that may lead nowhere."""

TIME_LIMIT = 600.0
"""Time limit of the check between knots and of the proof, s."""


@dataclass(frozen=True, eq=False)
class Between:
    """Violations of margin and clearance between the knots of a motion."""

    intervals: tuple[int, ...]
    """Intervals with a violation, from 0: a knot in the middle of each makes the answer better there."""
    margin: float
    """Largest shortfall of the margin."""
    clearance: float
    """Largest shortfall of the clearance, m."""
    times: tuple[tuple[float, float], ...]
    """Times of the beginning and end of the intervals with a violation, s."""

    def __str__(self) -> str:
        where = ", ".join(
            f"{k + 1} ({a:.3g} to {b:.3g} s)" for k, (a, b) in zip(self.intervals, self.times, strict=True)
        )
        short = [f"of the margin {self.margin:.3g}"] if self.margin else []
        short += [f"of the clearance {1e3 * self.clearance:.3g} mm"] if self.clearance else []
        what = f": {' and '.join(short)} is missing" if short else ": the robot snaps, or is on another branch, there"
        return f"between knots a requirement is violated in intervals {where}{what}; add knots there"


@typed
class Motion:
    """Motion of a robot in a nonlinear program: joint values over time, with an equilibrium at every knot.

    Args:
        opti: a `casadi.Opti` or a `tubeopt.Problem`; receives the unknowns and constraints.
        robot: robot that moves; without a load.
        knots: number of knots, evenly spaced in time, or their times as fractions of the duration, from 0 to 1.
        between: number of further equilibria inside every interval, at which margin and clearance are limited. With 0,
            knots may end on either side of a small body.
        duration: s, a number or an expression; None makes it an unknown.
        min_margin: smallest margin at the knots, a number or an expression, below 1.
        limits: ranges of the joints; by default those of the robot. The order of the tubes is a constraint too.
        name: prefix of the names of its variables and constraints.

    Attributes:
        duration: s.  rotations, translations: (n, K) rad and m at the knots.
        rotation_rates, translation_rates: (n, K) rad/s and m/s at the knots.
        tip_rotations: (n, K) rad.  tip_position (3, K) m, tip_direction (3, K).
        length, effort: costs, int |q'|^2 dt and int |q''|^2 dt, with joints in units of 1 rad and half the longest
            tube.

    Raises:
        InputError: an invalid argument.

    Examples:
        >>> import casadi, tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/two_tube.yaml")
        >>> problem = tubeopt.Problem()
        >>> motion = tubeopt.Motion(problem, robot, 5)
        >>> motion.start(tubeopt.forward_kinematics(robot, [0.0, 0.0]))
        >>> motion.goal(rotations=[0.5, 0.0])
        >>> motion.limit(tubeopt.RateLimits())
        >>> problem.minimize(motion.duration)
        >>> motion.solve().proved
        True
    """

    def __init__(
        self,
        opti: Any,
        robot: Robot,
        knots: int | ArrayLike = 9,
        *,
        between: int = 1,
        duration: Any = None,
        min_margin: Any = MIN_MARGIN,
        limits: JointLimits | None = None,
        name: str = "motion",
    ) -> None:
        check_robot(robot)
        instance("limits", limits, JointLimits, optional=True)
        instance("name", name, str)
        self.opti, self.program, self.robot, self.name = opti, as_program(opti), robot, name
        if isinstance(opti, NamedProgram):
            # Functions of all knots are differentiated in all directions at once, by their Jacobians.
            opti.directions = MANY_DIRECTIONS
        self.times = _knot_times(knots)
        self._limits, self._space = limits, joint_space(robot, limits)
        self._coordinates = TipCoordinates(self._space)
        self._rates, self._bodies, self._clearance = ANY_RATES, tuple[Obstacle, ...](), 0.0
        self._first: Equilibrium | None = None
        self._last: Array | None = None
        self._goal_given = False
        self._target: tuple[Array, Array | None] | None = None
        self._paths: dict[tuple[Any, ...], Array] = {}
        self._sides: Any = None
        self._warm = False
        space, n, m, count = self._space, robot.n_tubes, len(self._space.scale), len(self.times)
        # Times of all equilibria; every `_stride`th is at a knot.
        self._stride = whole("between", between, 0) + 1
        fractions = np.arange(self._stride) / self._stride
        inside = self.times[:-1, None] + np.diff(self.times)[:, None] * fractions
        self._stations = np.append(inside.ravel(), 1.0)
        stations = len(self._stations)
        self._joints = self._matrix("joint values", space.scale, count)
        self._slopes = self._matrix("rates", space.scale, count)
        self._tips = self._matrix("tip rotations", np.ones(n), stations)
        self._inside = self._matrix("translations between knots", space.scale[n:], stations - count)
        if duration is None:
            self._square = self.program.variable(f"{name}: square of the duration", 1, guess=1.0)
            self._demand("positive duration", self._square - 1e-6)
        else:
            self._square = ca.MX(duration if isinstance(duration, ca.MX) else positive("duration", duration)) ** 2
        self._free = duration is None
        self.duration = ca.sqrt(self._square)
        self._path = Cubics(self._joints, self._slopes, ca.DM(np.tile(np.diff(self.times), (m, 1))))
        self._margin = min_margin
        if not isinstance(min_margin, ca.MX) and not 0 <= float(min_margin) < 1:
            raise InputError(f"min_margin is {float(min_margin):g}; it must be at least 0 and less than 1")
        self._reserve = self.program.parameter(f"{name}: reserves", np.tile(FIRST_RESERVES, stations))
        # Explicit joint rotations differ from those of a start by the accuracy of the integration.
        self._offset = self.program.parameter(f"{name}: error of the start", np.zeros(n))
        self._twist = self.program.parameter(f"{name}: largest twist", [TWIST])
        spread = ca.DM(space.spread)
        self.rotations, self.translations = self._per_tube(self._joints)
        self.rotation_rates, self.translation_rates = ca.vertsplit(spread @ self._slopes / self.duration, n)
        q = self._at_stations()
        rotations, self._shifts = self._per_tube(q)
        reserves = ca.reshape(self._reserve, 2, stations)
        self._floor = ca.repmat(ca.MX(min_margin), 1, stations) + reserves[0, :]
        # 1 at equilibria with a constraint on the clearance. Others, which are far from bodies, cost less.
        self._near = self.program.parameter(f"{name}: near bodies", np.ones(stations))
        alpha, fields = ca.vertsplit(self._arms("balance", slice(None)), [0, n, n + self._coordinates.kind.sections])
        self.tip_rotations = self._tips[:, :: self._stride]
        shift = ca.horzcat(self._offset, ca.DM.zeros(n, stations - 1))
        self._demand("equilibrium", alpha - rotations - shift, upper=0.0)
        # Start and goal may be given: the start is not required to have the reserve.
        self._demand("margin", fields[:, 1:] - LEAST_FIELDS)
        self._in_order()
        turn = self._tips[:, 1:] - self._tips[:, :-1]
        self._at_most("change of a tip rotation between knots", turn, self._twist)

    # --- ends and limits ----------------------------------------------------------------------------------------------

    def start(self, equilibrium: Equilibrium, *, rest: bool = True) -> None:
        """Begin at an equilibrium, by default at rest.

        Raises:
            InputError: it has a load or friction, too small a margin, or joint values out of range or order.
        """
        instance("equilibrium", equilibrium, Equilibrium)
        e, space = equilibrium, self._space
        if e.load is not None:
            raise InputError("the start has a load; the equilibria of a Motion are explicit, which a load prevents")
        if not isinstance(self._margin, ca.MX) and e.margin < float(self._margin):
            raise InputError(f"the start has margin {e.margin:.3g}; it must be at least {float(self._margin):g}")
        q, point = space.join(e.rotations, e.translations, "start"), self._coordinates.of(e)
        if fault := space.outside(q):
            raise InputError(f"start: {fault}")
        self._first = e
        self._begin_clear()
        self.program.set_value(
            self._offset, self._coordinates.joints(point[None])[0, : self.robot.n_tubes] - e.rotations
        )
        self._fix("start", 0, point)
        if rest:
            self._rest(0)
        self._guess()

    def goal(
        self,
        equilibrium: Equilibrium | None = None,
        *,
        tip_position: ArrayLike | None = None,
        tip_direction: ArrayLike | None = None,
        rotations: ArrayLike | None = None,
        translations: ArrayLike | None = None,
        rest: bool = True,
    ) -> None:
        """End at an equilibrium, a tip position (3,), m, and direction (3,), or joint values (n,), by default at rest.

        Omitted quantities are free. Joint values may be reached on any branch; the start value is the one that
        `forward_kinematics` finds.

        Raises:
            InputError: no start before, an unreachable tip, or nothing to reach.
            SolveError: there is no such equilibrium.
        """
        if self._first is None:
            raise InputError("the motion has no start; call start before goal")
        space, n, near = self._space, self.robot.n_tubes, self._first
        if equilibrium is not None:
            self._goal_given, self._last = True, self._coordinates.of(equilibrium)
            self._fix("goal", -1, self._last)
        elif rotations is not None or translations is not None:
            alpha = near.rotations if rotations is None else vector("rotations", rotations, n)
            shift = near.translations if translations is None else vector("translations", translations, n)
            q = space.join(alpha, shift, "goal")
            self._last = self._coordinates.of(forward_kinematics(self.robot, alpha, tuple(shift)))
            rows = [*range(n)] * (rotations is not None) + [*range(n, len(q))] * (translations is not None)
            error = (self._joints[rows, -1] - ca.DM(q[rows])) / ca.DM(space.scale[rows])
            self._demand("joint values of the goal", error, upper=0.0)
        elif tip_position is None and tip_direction is None:
            raise InputError("the goal is empty; it must have an equilibrium, a tip or joint values")
        if tip_position is not None:
            place = vector("tip_position", tip_position, 3)
            direction = None if tip_direction is None else unit_vector("tip_direction", tip_direction)
            if self._last is None:
                self._target = place, direction
                reached = inverse_kinematics(self.robot, place, direction=direction, start=near, limits=self._limits)
                self._last = self._coordinates.of(reached.equilibrium)
            self._demand("tip of the goal", (self._goal_tip[:3] - ca.DM(place)) / space.length, upper=0.0)
        if tip_direction is not None:
            axis = unit_vector("tip_direction", tip_direction)
            across = np.linalg.svd(axis[None])[2][1:]
            self._demand("tip direction of the goal", ca.DM(across) @ self._goal_tip[3:], upper=0.0)
            self._demand("side of the tip direction", ca.dot(ca.DM(axis), self._goal_tip[3:]))
        if rest:
            self._rest(-1)
        self._guess()

    def limit(
        self,
        rates: RateLimits = DEFAULT_RATES,
        *,
        rotation_jerk: float | None = None,
        translation_jerk: float | None = None,
    ) -> None:
        """Limit rates, accelerations and jerks of all joints at all times.

        With limited jerks, rad/s^3 and m/s^3, accelerations are continuous, and 0 at both ends.

        Raises:
            InputError: limits for another number of tubes, or on the speed of the tip, which no bound at knots limits.
        """
        instance("rates", rates, RateLimits)
        if rates.tip is not None:
            raise InputError("rates.tip is a limit; bound the distances of tip_position at knots instead")
        rate, acceleration = rates.of(self._space)
        count, path, time = len(self.times), self._path, self.duration
        across = [ca.repmat(ca.DM(limit), 1, count - 1) for limit in (rate, acceleration)]
        self._at_most(
            "limits of the rates",
            ca.horzcat(self._slopes / ca.repmat(ca.DM(rate), 1, count), path.middle / across[0]),
            time,
        )
        both = ca.horzcat(path.early / across[1], path.late / across[1])
        self._at_most("limits of the accelerations", both, self._square)
        self._rates = rates
        n, carriages = self.robot.n_tubes, len(self._space.carriages)
        jerks = [rotation_jerk] * n + [translation_jerk] * carriages
        limited = {k: positive("jerk", jerk) for k, jerk in enumerate(jerks) if jerk is not None}
        rows = list(limited)
        if rows:
            largest = np.array(list(limited.values()))
            jerk = (path.late - path.early)[rows, :] / path.h[rows, :] / ca.repmat(ca.DM(largest), 1, count - 1)
            self._at_most("limits of the jerks", jerk, self._square**1.5)
            unit = ca.DM(acceleration[rows])
            jump = ca.horzcat(path.early[rows, 0], path.late[rows, :-1] - path.early[rows, 1:], path.late[rows, -1])
            self._demand("continuity of accelerations", jump / ca.repmat(unit, 1, count), upper=0.0)
        self._guess()

    def keep_clear(self, bodies: Obstacle | Sequence[Obstacle], clearance: float = 0.0) -> None:
        """Keep the surface of the arm at least `clearance`, m, from bodies.

        Raises:
            InputError: it was called before, no bodies, or the start is closer.
        """
        if self._bodies:
            raise InputError("keep_clear was called before; pass all bodies at once")
        self._bodies = checked_obstacles(bodies if isinstance(bodies, Sequence) else [bodies])
        self._clearance = typical_length("clearance", clearance, TYPICAL_CLEARANCE, zero=True)
        self._begin_clear()
        distances = self._distances(self._bodies, self._near.T) - self._clearance
        rows = distances.shape[0] // len(self._stations)
        reserves = ca.reshape(self._reserve, 2, len(self._stations))[1, :]
        distances -= ca.repmat(ca.vec(ca.repmat(reserves, rows, 1)), 1, len(self._bodies))
        self._demand("clearance", distances[rows:, :] / self._space.length)
        self._guess()

    def distances(self, bodies: Sequence[Obstacle]) -> Any:
        """(a, bodies) distances of points of the surface from bodies, one equilibrium after the other, m."""
        return self._distances(bodies, None)

    def _distances(self, bodies: Sequence[Obstacle], near: Any) -> Any:
        table = self._arms("distances", slice(None), *bodies, near=near)
        return ca.horzcat(*(ca.vec(part) for part in ca.vertsplit(table, table.shape[0] // len(bodies))))

    @cached_property
    def _places(self) -> Any:
        """(b, stations) arc lengths of the breakpoints of the tubes, in units of the robot's length, and 0 for the
        plate.
        """
        n, kind, p = self.robot.n_tubes, self._coordinates.kind, self._coordinates.parameters
        ends = p[: n * kind.stretches] if kind.stretches else p[3 * n : 5 * n]
        ends = ends.reshape(n, -1, order="F")
        count = self._shifts.shape[1]
        rows = [self._shifts + ca.repmat(ca.DM(end - ends[:, 0]), 1, count) for end in ends.T]
        return ca.vertcat(*rows, ca.DM.zeros(1, count)) / self._space.length

    @cached_property
    def tip_position(self) -> Any:
        """(3, K) positions of the tip at the knots, m."""
        return self._tip[:3, :]

    @cached_property
    def tip_direction(self) -> Any:
        """(3, K) directions of the tip at the knots."""
        return self._tip[3:, :]

    @cached_property
    def _tip(self) -> Any:
        return self._arms("tip", slice(None, None, self._stride))

    @cached_property
    def _goal_tip(self) -> Any:
        return self._arms("tip", slice(-1, None))

    @cached_property
    def _shapes(self) -> Any:
        return self._arms("points", slice(None, None, self._stride))

    def points(self, knot: int) -> Any:
        """(3, p) points of the arm at a knot, plate to tip, m."""
        return ca.reshape(self._shapes[:, range(len(self.times))[knot]], 3, -1)

    def _arms(self, what: str, stations: slice, *bodies: Obstacle, near: Any = None) -> Any:
        """Columns of quantities of all equilibria, from `arm_at_knot`; FAR, without a cost, where `near` is 0."""
        x = ca.vertcat(self._tips, self._shifts, self._floor)[:, stations]
        numbers = np.concatenate([self._coordinates.parameters, self._coordinates.radius])
        function = arm_at_knot(self._coordinates.kind, what, bodies)
        if near is not None:
            function, x = function.switched(FAR), ca.vertcat(x, near)
        return function.at(x.shape[1])(x, ca.DM(numbers))

    # --- costs --------------------------------------------------------------------------------------------------------

    def integral(self, values: Any) -> Any:
        """Integral over time of a cost with values (1, K) at the knots, by the trapezoidal rule."""
        h = np.diff(self.times)
        weights = (np.append(h, 0.0) + np.append(0.0, h)) / 2
        return self.duration * ca.dot(ca.vec(values), ca.DM(weights))

    @property
    def length(self) -> Any:
        """Integral of |q'|^2 over time, with joints in units of their scales."""
        return self._unit_path.length / self.duration

    @property
    def effort(self) -> Any:
        """Integral of |q''|^2 over time, with joints in units of their scales."""
        return self._unit_path.effort / self.duration**3

    @cached_property
    def _unit_path(self) -> Cubics:
        unit = ca.repmat(ca.DM(1 / self._space.scale), 1, len(self.times))
        return Cubics(unit * self._joints, unit * self._slopes, self._path.h)

    # --- solution -----------------------------------------------------------------------------------------------------

    def warm_start(self, trajectory: Trajectory) -> None:
        """Start the program at a trajectory of the same robot."""
        duration = max(float(np.ptp(trajectory.time)), SHORTEST)
        t = (trajectory.time - trajectory.time[0]) / duration
        z = np.array([self._coordinates.of(e) for e in trajectory.arms])
        v = np.gradient(self._coordinates.joints(z), t, axis=0)
        z, v = (
            np.column_stack([np.interp(at, t, each) for each in part.T])
            for at, part in ((self._stations, z), (self.times, v))
        )
        self._set_guess(z, v, duration)
        self._warm = True

    def solve(self, *, start: Trajectory | ProblemSolution | None = None, **settings: Any) -> Trajectory:
        """Solve the program and check the motion between knots; repeat with larger reserves at knots where it fails.

        Args:
            start: start values; by default the optimum without bodies, and if that fails, the least time along a path
                that is clear of them.
            settings: those of `Problem.solve`. An Opti needs a solver and an objective before.

        Raises:
            SolveError: no optimum was found, or knots are too far apart.
        """
        if isinstance(start, Trajectory):
            self.warm_start(start)
        elif start is not None:
            settings["start"] = start
        try:
            if start is None and not self._warm and self._bodies and isinstance(self.opti, NamedProgram):
                guesses = {name: each.guess for name, each in self.opti.variables.items()}
                result = self._around(settings) if "solver" not in settings else None
                if result is not None:
                    return result
                for name, guess in guesses.items():
                    self.opti.set_guess(name, guess)
                # The search of a path takes as long as the optimum without bodies, which mostly is the better start.
                self._guess(bodies=True)
            return self._refined(settings, SOLVERS)
        finally:
            self._activate(np.ones(len(self._stations), dtype=bool))

    def _around(self, settings: dict[str, Any]) -> Trajectory | None:
        """Trajectory from the optimum without bodies, which is pushed out of them; None if none is found."""
        try:
            self._guess(bodies=False)
            self._activate(np.zeros(len(self._stations), dtype=bool))
            self._reset()
            # Its accuracy does not matter.
            self._restart(self.opti.attempt(ROUGH))
            return self._refined(settings, QUICK)
        except SolveError:
            return None

    def _reset(self) -> None:
        """Set reserves and order of breakpoints as before the first solve."""
        if self._sides is not None:
            self.program.set_value(self._sides, np.zeros(self._sides.numel()))
        self.program.set_value(self._reserve, np.tile(FIRST_RESERVES, len(self._stations)))

    def _refined(self, settings: dict[str, Any], solvers: Sequence[Ipopt]) -> Trajectory:
        """Trajectory of the program from its guess; reserves are raised where it violates a requirement."""
        self._reset()
        reserve, room = np.tile(FIRST_RESERVES, (len(self._stations), 1)), 0.0
        active, solution = self._activate(self._close()), None
        for last in [False] * REPETITIONS + [True]:
            self.program.set_value(self._reserve, reserve.ravel())
            solution = self._solution(settings, solvers, solution)
            missing = self._missing(solution, room)
            if missing is None:
                result = self._built(solution)
                if isinstance(result, Trajectory):
                    return result
                room = ROOM
                missing = self._missing(solution, room)
                if missing is None:
                    raise SolveError(f"{self.name}: {'; '.join(result)}")
            short = np.array([missing.margin, missing.clearance])
            beside = sorted({k * self._stride + i for k in missing.intervals for i in range(self._stride + 1)})
            if last or not (short > 0).any():
                raise SolveError(f"{self.name}: {missing}")
            if missing.clearance and not active[beside].all():
                active[beside] = True
                self._activate(active)
            else:
                # The minimum between knots moves with the knots, so a little more than is missing.
                reserve[beside] += np.where(short > 0, 1.5 * short + LEAST_RESERVES, 0.0)
            self._restart(solution)
        raise AssertionError

    def _activate(self, active: Mask) -> Mask:
        """Set which equilibria have a constraint on the clearance."""
        self.program.set_value(self._near, active.astype(float))
        return active

    def _close(self) -> Mask:
        """Mask of the equilibria that start close to bodies, and of their neighbours."""
        count = len(self._stations)
        if not isinstance(self.opti, NamedProgram) or not self._bodies:
            return np.ones(count, dtype=bool)
        x = np.array(self.opti.evaluate(ca.vertcat(self._tips, self._shifts, self._floor), {}, {}))
        numbers = np.concatenate([self._coordinates.parameters, self._coordinates.radius])
        function = arm_at_knot(self._coordinates.kind, "distances", self._bodies).value.map(count)
        distances = np.array(function(x, np.tile(numbers[:, None], count)))
        return np.convolve(distances.min(0) < self._clearance + NEAR, np.ones(3), "same") > 0

    def _solution(self, settings: dict[str, Any], solvers: Sequence[Ipopt], near: Any = None) -> Any:
        """Solution of the program; of a `Problem` without other settings by `solvers`, one after the other.

        Args:
            near: solution with slightly smaller reserves, whose multipliers halve the number of iterations.
        """
        own = isinstance(self.opti, NamedProgram) and "solver" not in settings
        if own and near is not None and not self.opti.blocks:
            again: ProblemSolution = self.opti.attempt(solvers[0], start=near, warm=NEAR_SOLUTION)
            if again.status is ProblemStatus.SOLVED:
                return again
        guesses = {name: each.guess for name, each in self.opti.variables.items()} if own else {}
        for solver in solvers if own else solvers[-1:]:
            try:
                return self.opti.solve(**({"solver": solver} if own else {}), **settings)
            except RuntimeError as error:
                failed = getattr(error, "solution", None)
                if own and failed is not None and failed.status is ProblemStatus.TOO_MANY_ITERATIONS:
                    solution = self._in_fixed_order(failed)
                    if solution is not None:
                        return solution
                if solver is solvers[-1]:
                    raise SolveError(f"{self.name}: {error}") from None
                for name, guess in guesses.items():
                    self.opti.set_guess(name, guess)
        raise AssertionError

    def _in_fixed_order(self, failed: ProblemSolution) -> ProblemSolution | None:
        """Solution with the breakpoints of every equilibrium in their order at a failed solution; None without any.

        Derivatives jump where breakpoints meet, so that the solver oscillates about an optimum there. Breakpoints that
        press against each other are swapped, as long as the objective decreases.
        """
        place, name = self._value(failed, self._places), "order of breakpoints"
        i, j = np.triu_indices(len(place), 1)
        if self._sides is None:
            self._sides = self.program.parameter(f"{self.name}: sides", np.zeros(len(i) * place.shape[1]))
            gaps = ca.vec(self._places[i.tolist(), :] - self._places[j.tolist(), :])
            self._demand(name, self._sides * gaps + 1 - (1 + APART) * self._sides**2)
        # Behind the plate tubes are straight.
        sides = np.where(np.maximum(place[i], place[j]) < 0, 0.0, np.where(place[i] < place[j], -1.0, 1.0))
        kept, best, last = np.zeros_like(sides), None, failed
        for _ in range(ORDERS):
            self.program.set_value(self._sides, sides.ravel(order="F"))
            self._restart(last)
            try:
                last = self.opti.solve(solver=SOLVERS[0])
            except SolveError:
                break
            if best is not None and last.objective > best.objective - 1e-6 * abs(best.objective):
                break
            kept, best, place = sides, last, self._value(last, self._places)
            force = np.abs(last.multipliers[f"{self.name}: {name}"]).reshape(sides.shape, order="F")
            pressed = (force > LEAST_FORCE) & (np.abs(place[i] - place[j]) < 2 * APART)
            if not pressed.any():
                break
            sides = np.where(pressed, -sides, sides)
        self.program.set_value(self._sides, kept.ravel(order="F"))
        return best

    def violations(self, solution: Any) -> Between | None:
        """Violations of margin, clearance and branch between the knots of a solution; None without any."""
        return self._missing(solution, 0.0)

    def trajectory(self, solution: Any) -> Trajectory:
        """Trajectory of a solution, with its proof.

        Raises:
            SolveError: it violates a requirement between knots, or is not proved.
        """
        missing = self.violations(solution)
        if missing is not None:
            raise SolveError(f"{self.name}: {missing}")
        result = self._built(solution)
        if not isinstance(result, Trajectory):
            raise SolveError(f"{self.name}: {'; '.join(result)}")
        return result

    def _built(self, solution: Any) -> Trajectory | Faults:
        task, motion = self._task(self._margin_of(solution)), self._curve(solution)
        statistics = PlanStatistics(how="program", knots=len(self.times))
        return build(task, self._begin(), None, motion, statistics)

    def _missing(self, solution: Any, room: float) -> Between | None:
        """Violations between knots, of margin and clearance (m) with a reserve."""
        task, motion, points = self._task(self._margin_of(solution)), self._curve(solution), self._points(solution)
        task = replace(task, min_margin=task.min_margin + room, clearance=task.clearance + room)
        checkpoints = motion.time, points
        violations = violated(task, self._begin(), motion, task.clock, checkpoints, given_goal=self._goal_given)
        bad = np.flatnonzero(violations.intervals).tolist()
        if not bad:
            return None
        margin, clearance = violations.shortfall.tolist()
        times = [(float(motion.time[k]), float(motion.time[k + 1])) for k in bad]
        return Between(tuple(bad), margin, clearance, tuple(times))

    # --- internal -----------------------------------------------------------------------------------------------------

    def _matrix(self, name: str, scale: Array, count: int) -> Any:
        """Unknowns (len(scale), count)."""
        if not count:
            return ca.MX(len(scale), 0)
        column = self.program.variable(f"{self.name}: {name}", len(scale) * count, scale=np.tile(scale, count))
        return ca.reshape(column, len(scale), count)

    def _at_stations(self) -> Any:
        """(m, stations) joint values of all equilibria.

        Translations between knots are unknowns that are equal to those of the cubics: every equilibrium then depends on
        unknowns of its own, which keeps second derivatives sparse.
        """
        n, stride, last = self.robot.n_tubes, self._stride, len(self._stations) - 1
        columns: list[Any] = [None] * (last + 1)
        columns[::stride] = ca.horzsplit(self._joints)
        unknown = iter(ca.horzsplit(self._inside) if stride > 1 else [])
        for x in range(1, stride):
            for k, column in enumerate(ca.horzsplit(self._path.inside(x / stride))):
                own = next(unknown)
                error = (own - column[n:]) / ca.DM(self._space.scale[n:])
                self._demand(f"translation at {self._stations[k * stride + x]:.6g} of the time", error, upper=0.0)
                columns[k * stride + x] = ca.vertcat(column[:n], own)
        return ca.horzcat(*columns)

    def _per_tube(self, q: Any) -> tuple[Any, Any]:
        """Rotations and translations (n, N) of joint values (m, N)."""
        offset = ca.repmat(ca.DM(self._space.offset), 1, q.shape[1])
        rotations, translations = ca.vertsplit(ca.DM(self._space.spread) @ q + offset, self.robot.n_tubes)
        return rotations, translations

    def _demand(self, name: str, expression: Any, *, upper: ArrayLike = np.inf) -> None:
        """Constrain 0 <= expression <= upper, entry by entry."""
        self.program.subject_to(f"{self.name}: {name}", ca.vec(expression), upper=upper)

    def _at_most(self, name: str, expression: Any, bound: Any) -> None:
        """Constrain |expression| <= bound: two linear rows, where an absolute value would have a corner."""
        column = ca.vec(expression)
        self._demand(name, ca.vertcat(bound - column, bound + column))

    def _in_order(self) -> None:
        """Constrain Bezier coefficients of the joints to ranges and order."""
        space, count = self._space, 2 * len(self.times) - 2
        inner = self._path.inner / ca.repmat(ca.DM(space.scale), 1, count)
        for name, sign, end in (("lower", 1.0, space.lower), ("upper", -1.0, space.upper)):
            rows = np.flatnonzero(np.isfinite(end)).tolist()
            bound = ca.DM(end[rows] / space.scale[rows] - sign * JOINT_ROUND_OFF)
            self._demand(f"{name} end of the ranges", sign * (inner[rows, :] - ca.repmat(bound, 1, count)))
        if len(space.row_lower):
            excess = ca.DM(space.rows) @ self._path.inner - ca.repmat(ca.DM(space.row_lower), 1, count)
            self._demand("order of the tubes", excess / space.length + JOINT_ROUND_OFF)

    def _fix(self, name: str, knot: int, point: Array) -> None:
        """Constrain a knot to tip coordinates (m,), which determine its joint rotations."""
        n = self.robot.n_tubes
        self._demand(f"tip rotations of the {name}", self.tip_rotations[:, knot] - ca.DM(point[:n]), upper=0.0)
        shift = (self._joints[n:, knot] - ca.DM(point[n:])) / ca.DM(self._space.scale[n:])
        self._demand(f"translations of the {name}", shift, upper=0.0)

    def _rest(self, knot: int) -> None:
        name = "start" if knot == 0 else "goal"
        self._demand(f"rest at the {name}", self._slopes[:, knot] / ca.DM(self._space.scale), upper=0.0)

    def _begin(self) -> Equilibrium:
        if self._first is None:
            raise InputError("the motion has no start; call start before it is solved")
        return self._first

    def _begin_clear(self) -> None:
        """Raise InputError if the start is closer to bodies than allowed."""
        if self._first is None or not self._bodies:
            return
        distance = ArmSurface(self._first).clearance(scene_of(self._bodies))
        if distance < self._clearance:
            raise InputError(
                f"the start is {1e3 * distance:.3g} mm from a body; it must be at least {1e3 * self._clearance:g} mm"
            )

    def _guess(self, *, bodies: bool | None = None) -> None:
        """Start on a path from start to goal that is clear of the bodies, in the least time along it.

        Without `bodies` the path is straight; by default that of a `Problem`, since `solve` looks for another one.
        """
        if self._first is None:
            return
        self._warm = False
        bodies = not isinstance(self.opti, NamedProgram) if bodies is None else bodies
        begin = self._coordinates.of(self._first)
        task = self._task(0.05 if isinstance(self._margin, ca.MX) else float(self._margin))
        end = self._end(task)
        points = self._waypoints(task, begin, end) if bodies else np.stack([begin, end])
        curves = joint_curves(task, points)
        z = [
            a + np.linspace(0, 1, len(q))[:, None] * (b - a) for (a, b), q in zip(pairwise(points), curves, strict=True)
        ]
        rates = self._rates if self._rates is not ANY_RATES else DEFAULT_RATES
        motion = through(np.concatenate(curves), task.scale, Limits(*rates.of(self._space)))
        # Corners are rounded, so lengths along the path are relative.
        fine = np.linspace(0, motion.duration, 50 * len(self._stations))
        place = np.interp(self._stations * motion.duration, fine, _length(motion.curve(fine) / task.scale))
        along = _length(np.concatenate(curves) / task.scale)
        at = np.column_stack([np.interp(place, along, column) for column in np.concatenate(z).T])
        self._set_guess(at, motion.curve(self.times * motion.duration, 1) * motion.duration, motion.duration)

    def _waypoints(self, task: PlanTask, begin: Array, end: Array) -> Array:
        """(k, m) points of a path that is clear of the bodies; a straight path if none is found."""
        key = begin.tobytes(), end.tobytes(), self._bodies, self._clearance
        if key not in self._paths:
            task = task.from_to(begin, end)

            def clock(most: float) -> Clock:
                return Clock(most, task.clock, lambda: task.work.seconds)

            points = find_path(task, begin, [end], clock(SEARCH_WORK), how="rrt_connect").points
            straight = np.stack([begin, end])
            self._paths[key] = straight if points is None else shorten(task, points, clock(SHORTEN_WORK))
        return self._paths[key]

    def _end(self, task: PlanTask) -> Array:
        """(m,) end of the initial guess; another configuration with that tip if the nearest violates a requirement."""
        assert self._first is not None
        if self._last is None:
            return self._coordinates.of(self._first)
        if self._target and not task.holds(self._last[None])[0]:
            place, direction = self._target
            reached = inverse_kinematics(
                self.robot,
                place,
                direction=direction,
                start=self._first,
                limits=self._limits,
                min_margin=task.min_margin,
                obstacles=self._bodies,
                on_failure="closest",
                options=InverseOptions(clearance=self._clearance),
            )
            if reached.reached:
                self._last = self._coordinates.of(reached.equilibrium)
        return self._last

    def _set_guess(self, z: Array, v: Array, duration: float) -> None:
        """Start at tip coordinates z (stations, m), rates v (K, m) by a time from 0 to 1, and a duration, s."""
        q, n, program = self._coordinates.joints(z[:: self._stride]), self.robot.n_tubes, self.program
        rates = self._rates if self._rates is not ANY_RATES else DEFAULT_RATES
        if self._free:
            # Cubics through the knots are faster than the motion itself.
            curve = JointMotion(CubicHermiteSpline(self.times * duration, q, v / duration))
            duration *= _excess(curve, *rates.of(self._space))
        mean = np.abs(z[-1, :n] - z[0, :n]).max() * float(np.diff(self._stations).max())
        step = float(np.abs(np.diff(z[:, :n], axis=0)).max())
        program.set_value(self._twist, [max(TWIST, LONGEST_TWIST * mean, 1.3 * step)])
        self._put("joint values", self._joints, q)
        self._put("rates", self._slopes, v)
        self._put("tip rotations", self._tips, z[:, :n])
        if self._stride > 1:
            inner = np.concatenate([z[x :: self._stride, n:] for x in range(1, self._stride)])
            self._put("translations between knots", self._inside, inner)
        if self._free:
            self._put("square of the duration", self._square, np.array([[duration**2]]))

    def _put(self, name: str, unknowns: Any, value: Array) -> None:
        """Set the start values of unknowns (r, N) to the columns of a table (N, r)."""
        if isinstance(self.opti, ca.Opti):
            self.opti.set_initial(unknowns, ca.DM(value.T))
        else:
            self.opti.set_guess(f"{self.name}: {name}", np.ravel(value))

    def _restart(self, solution: Any) -> None:
        """Start the next solve at a solution."""
        if isinstance(self.opti, ca.Opti):
            self.opti.set_initial(solution.value_variables())
        else:
            for name, value in solution.values.items():
                self.opti.set_guess(name, value)

    def _value(self, solution: Any, expression: Any) -> Array:
        """Value of an expression at a solution, as a matrix."""
        return np.asarray(solution.value(expression), dtype=float).reshape(expression.shape)

    def _points(self, solution: Any) -> Array:
        """(K, m) tip coordinates at the knots."""
        tips, q = (self._value(solution, part).T for part in (self.tip_rotations, self._joints))
        return np.column_stack([tips, q[:, self.robot.n_tubes :]])

    def _margin_of(self, solution: Any) -> float:
        return float(self._value(solution, ca.MX(self._margin)).item())

    def _curve(self, solution: Any) -> JointMotion:
        """Joint values over time."""
        q, v = (self._value(solution, part).T for part in (self._joints, self._slopes))
        duration = float(self._value(solution, self.duration).item())
        motion = JointMotion(CubicHermiteSpline(self.times * duration, q, v / duration))
        return motion.slower(max(1.0, _excess(motion, *self._rates.of(self._space))))

    def _task(self, margin: float) -> PlanTask:
        """Requirements on the motion, as those of a plan."""
        options = PlanOptions(clearance=self._clearance, time_limit=TIME_LIMIT)
        task = plan_task(self.robot, self._bodies, max(margin, 0.0), self._rates, self._limits, options)
        return replace(task, coordinates=self._coordinates)


def _knot_times(knots: int | ArrayLike) -> Array:
    """(K,) times of knots from 0 to 1, from their number or their times."""
    if np.ndim(knots) == 0:
        return np.linspace(0.0, 1.0, whole("knots", knots, 3))
    times = np.asarray(knots, dtype=float).ravel()
    if len(times) < 3 or times[0] != 0.0 or times[-1] != 1.0 or (np.diff(times) <= 0).any():
        raise InputError(f"knots are {times.tolist()}; they must increase from 0 to 1, at least 3")
    return times


def _length(points: Array) -> Array:
    """(N,) length of a polyline (N, m) up to each of its points."""
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))


def _excess(motion: JointMotion, rate: Array, acceleration: Array) -> float:
    """Factor on the duration of cubics so that rates and accelerations (m,) just satisfy their limits."""
    h = np.diff(motion.time)[:, None]
    c = motion.curve.c
    # Bezier coefficients of q' and end values of q'' of c_0 x^3 + c_1 x^2 + c_2 x + c_3.
    slopes = np.array([c[2], c[2] + c[1] * h, c[2] + 2 * c[1] * h + 3 * c[0] * h**2])
    bends = np.array([2 * c[1], 2 * c[1] + 6 * c[0] * h])
    return max(float((np.abs(slopes) / rate).max()), math.sqrt(float((np.abs(bends) / acceleration).max())))
