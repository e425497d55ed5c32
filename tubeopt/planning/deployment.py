"""Deployment through a lumen that cannot be passed without touching: the tip follows a path among walls.

For one point c of the path after the other, the joint values q descend, by the constrained Gauss-Newton method of
`inverse/gauss_newton.py`, to a minimum of

    |p(q) - c|^2 / a^2 + sum_k (lambda_k(q) / lambda_max)^2

under lambda_k <= lambda_max, with the tip p and the contact forces lambda_k. So the tip leaves the path by about the
tolerance a where this lowers the forces of the walls. Every step is followed along its branch: contacts close, slide
and open as they do in the patient, no force on the way exceeds the limit, and the margin stays above its bound.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from ..arguments import typed
from ..bodies.obstacles import Obstacle, checked_obstacles
from ..display import Displayed
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..equilibrium.wall_contact import Solved, Walls, along_joints, at_walls, start_of
from ..errors import InputError, SolveError, positive
from ..files.field_metadata import MARGIN, POSITIVE, Typical, form, unit
from ..files.units import TO_MILLI, TO_MM
from ..inverse.clock import Clock
from ..inverse.gauss_newton import AcceptedStep, Restored, StepModel, descend
from ..inverse.joints import JointSpace, joint_space
from ..inverse.posture import Posture
from ..robots.limits import JointLimits
from ..robots.load import Load
from ..robots.robot import Robot
from ..solvers.blas import small
from ..solvers.time_limit import LONG_TIME_LIMIT, check_time, limited
from ..typing import Array, StatusEnum
from .goals import checked_points
from .tip_path import spaced

ADVANCE = 3e-3
"""Largest distance (m) of two points of the path: about two diameters of a tube, so that the arm slides along walls."""

STEPS = 8
"""Largest number of accepted steps per point; a point 3 mm ahead takes two to four."""

FIRST_STEP = 0.1
"""Trust region of the first step, in units of the joints' scales: an advance turns no tube by more."""

SHORTEST = 0.1
"""Fraction of a step of the continuation below which a motion is given up: the trust region shrinks in its place."""

DAMPING = 1e-2
"""Damping relative to the objective 1: of motions that change neither tip nor forces, the shortest is taken."""

LAG = 5e-3
"""Distance (m) of the tip from its point at which it counts as blocked: nearly two advances."""

FIRST_LENGTH = 1e-3
"""Length (m) of every tube beyond the one around it in the first pose, if none is given."""

ACTIVE = 0.98
"""Fraction of a limit from which on it counts as what blocks the tip."""

ENOUGH = 1e-3
"""Relative decrease of the objective that is worth a step: here millimetres and newtons count, not round-off."""


class DeploymentStatus(StatusEnum):
    """Outcome of a deployment, as a sentence."""

    REACHED = "the tip reached the end of the path"
    BLOCKED = "the tip did not reach the end of the path"


@dataclass(frozen=True, eq=False)
class Deployment(Displayed):
    """Motion of an arm that leads its tip along a path among walls."""

    equilibria: Sequence[Equilibrium]
    """(T,) stable equilibria, the start first, then one per point of the path."""
    points: Array
    """(T, 3) points of the path that the tip was led to, m; the first is the start."""
    status: Annotated[DeploymentStatus, "outcome, as a sentence"]
    largest_force: Annotated[float, unit("mN"), form(".4g"), "largest force of a wall during the motion"]
    reason: Annotated[str, "reason why the tip is not at the end of the path; empty otherwise"] = ""

    @property
    def rotations(self) -> Array:
        """(T, n) rotations, rad."""
        return np.array([each.rotations for each in self.equilibria])

    @property
    def translations(self) -> Array:
        """(T, n) translations, m."""
        return np.array([each.translations for each in self.equilibria])

    @property
    def misses(self) -> Array:
        """(T,) distances of the tip from the points of the path, m."""
        tips = np.array([each.tip_position for each in self.equilibria])
        return np.asarray(np.linalg.norm(tips - self.points, axis=1))


@dataclass(frozen=True, eq=False)
class _AmongWalls(Posture):
    """Posture among walls."""

    solved: Solved
    """Solution of the equilibrium, from which the next one is solved."""
    largest: float
    """Largest force of a wall on the way to it, N."""

    @property
    def forces(self) -> Array:
        """Contact forces (K,), base to tip, N."""
        walls = self.equilibrium.walls
        return np.array([] if walls is None else [contact.size for contact in walls.contacts])

    @property
    def force_slopes(self) -> Array:
        """Derivatives (K, m) of the contact forces by q."""
        return self.slope("contact_forces") if len(self.forces) else np.zeros((0, len(self.q)))


@dataclass(eq=False)
class _Lead:
    """Descent of the joint values that leads the tip to a point."""

    space: JointSpace
    target: Array
    """Point (3,), m."""
    tolerance: float
    """Distance a, m."""
    largest_force: float
    """Limit lambda_max, N."""
    min_margin: float
    clock: Clock = field(default_factory=lambda: Clock(np.inf))
    touched: tuple[int, ...] = ()

    @property
    def scale(self) -> Array:
        return self.space.scale

    def residual(self, at: _AmongWalls) -> Array:
        """Residuals (3 + K,) of the objective."""
        return np.concatenate([(at.tip - self.target) / self.tolerance, at.forces / self.largest_force])

    def value(self, at: _AmongWalls) -> float:
        residual = self.residual(at)
        return 0.5 * float(residual @ residual)

    def min_decrease(self, value: float) -> float:
        return ENOUGH * max(value, ENOUGH)

    def converged(self, at: _AmongWalls, values: Sequence[float]) -> bool:
        return len(values) > 1 and values[-2] - values[-1] < self.min_decrease(values[-2])

    def model(self, at: _AmongWalls, side: int, last: AcceptedStep[_AmongWalls] | None) -> StepModel:
        force = at.force_slopes
        matrix = np.vstack([at.slope("tip_position") / self.tolerance, force / self.largest_force])
        rows, bounds = self.space.inequalities(at.q)
        rows, bounds = np.vstack([rows, -force]), np.concatenate([bounds, at.forces - self.largest_force])
        if not len(force):
            # With contacts the derivative of the margin would take two equilibria per joint: `after` checks it only.
            rows, bounds = np.vstack([rows, at.margin_slope()]), np.append(bounds, self.min_margin - at.margin)
        damping = DAMPING * np.diag(1 / self.scale), np.zeros(len(self.scale))
        return StepModel(matrix, -self.residual(at), *damping, rows, np.minimum(bounds, 0.0))

    def after(self, current: _AmongWalls, x: Array) -> Restored[_AmongWalls]:
        """Posture after a motion on its branch; None if it ends, or a wall presses too hard on the way."""
        check_time()
        q = self.space.clip(current.q + x)
        rotations, translations = self.space.split(q)
        end, solves, largest = None, 0, 0.0
        for step in along_joints(current.solved, rotations, np.array(translations), SHORTEST):
            end, solves = step, solves + 1
            largest = max((touch.size for touch in step.state.pressed), default=largest)
            if largest > self.largest_force:
                return Restored(None, solves)
        if end is None or end.t < 1 or end.state.margin < min(self.min_margin, current.margin):
            return Restored(None, solves)
        try:
            equilibrium = at_walls(end.state)
        except SolveError:  # a solution of the coarse mesh only
            return Restored(None, solves)
        return Restored(_AmongWalls(self.space, q, equilibrium, end.state, largest), solves)

    def reason(self, at: _AmongWalls) -> str:
        """Limits that keep the tip from the point, as text."""
        miss = float(np.linalg.norm(at.tip - self.target))
        limits = [
            f"body {contact.body} presses with {contact.size * TO_MILLI:.4g} mN at {contact.arc_length * TO_MM:.4g} mm"
            for contact in (at.equilibrium.walls.contacts if at.equilibrium.walls else ())
            if contact.size > ACTIVE * self.largest_force
        ]
        limits += self.space.active(at.q)
        if at.margin < self.min_margin / ACTIVE:
            limits.append(f"the margin is {at.margin:.3g}")
        why = "; ".join(limits) or "no motion within the limits brings it closer"
        return f"the tip is {miss * TO_MM:.4g} mm from the path: {why}"

    def two_sided(self, at: _AmongWalls) -> bool:
        return False

    def across(self, at: _AmongWalls) -> Iterator[_AmongWalls]:
        return iter(())


@typed
@small
@limited
def deploy(  # noqa: PLR0913
    robot: Robot,
    path: ArrayLike,
    *,
    walls: Sequence[Obstacle],
    start: Equilibrium | None = None,
    load: Load | None = None,
    largest_force: Annotated[float, unit("mN"), POSITIVE, Typical(1e-4, 20.0)] = 0.5,
    tolerance: Annotated[float, unit("mm"), POSITIVE, Typical(1e-6, 0.05)] = 2e-3,
    min_margin: Annotated[float, MARGIN] = 0.05,
    limits: JointLimits | None = None,
    progress: Callable[[int], object] | None = None,
    time_limit: float = LONG_TIME_LIMIT,
) -> Deployment:
    """Motion of an arm that leads its tip along a path among walls; contact forces stay below a limit.

    Args:
        path: (k, 3) points, m: a polyline, such as the centreline of a vessel. The tip is first led to its first point.
        walls: bodies that the arm cannot enter, without friction; see `forward_kinematics`.
        start: first pose. By default all tubes are drawn back as far as `limits` allow.
        load: load on the arm besides the walls.
        largest_force: limit on the force of every contact, N.
        tolerance: largest distance of the tip from the last point, m. Before, the tip leaves the path about as far
            where this lowers the forces.
        min_margin: smallest margin with the walls.
        limits: ranges of the joint values.
        progress: called with the number of points reached.
        time_limit: time limit, s; OutOfTimeError is raised when it is reached.

    Raises:
        InputError: no walls, fewer than one point, a start that presses a wall too hard, numbers out of range.
        SolveError: the walls block the arm at the start.

    Examples:
        >>> import tubeopt
        >>> from tubeopt.bodies import Corridor
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> vessel = Corridor([[0, 0, -0.02], [0, 0, 0.01], [0.002, 0, 0.03]], 3e-3)
        >>> motion = tubeopt.deploy(robot, [[0.0005, 0, 0.015]], walls=[vessel])
        >>> str(motion.status)
        'the tip reached the end of the path'
    """
    for name, value in (("largest_force", largest_force), ("tolerance", tolerance)):
        positive(name, value)
    bodies, space = checked_obstacles(walls), joint_space(robot, limits)
    if not bodies:
        raise InputError("walls is empty; a deployment needs at least one body")
    if start is None:
        rotations, translations = space.split(space.drawn_back(FIRST_LENGTH))
        start = forward_kinematics(robot, rotations, translations, load=load, walls=bodies)
    current = _start(space.holding(start.translations), start, Walls(robot, bodies, load))
    if current.largest > largest_force:
        raise InputError(
            f"start presses a wall with {current.largest * TO_MILLI:.4g} mN; it must be at most "
            f"{largest_force * TO_MILLI:.4g} mN"
        )
    points = spaced(np.vstack([current.tip, checked_points(path, "path")]), ADVANCE)
    reached, largest, reason = [current], current.largest, ""
    for number, point in enumerate(points[1:], 1):
        lead = _Lead(current.space, point, tolerance, largest_force, min_margin)
        current = descend(lead, current, size=FIRST_STEP, max_steps=STEPS).iterate
        reached.append(current)
        largest = max(largest, current.largest)
        if progress is not None:
            progress(number)
        if np.linalg.norm(current.tip - point) > LAG:
            reason = lead.reason(current)
            break
    end = float(np.linalg.norm(current.tip - points[-1]))
    if not reason and end > tolerance:
        reason = lead.reason(current)
    status = DeploymentStatus.BLOCKED if reason else DeploymentStatus.REACHED
    return Deployment([each.equilibrium for each in reached], points[: len(reached)], status, largest, reason)


def _start(space: JointSpace, start: Equilibrium, walls: Walls) -> _AmongWalls:
    """First posture."""
    solved = start_of(start, walls)
    q = space.join(start.rotations, start.translations, "start")
    largest = max((touch.size for touch in solved.pressed), default=0.0)
    return _AmongWalls(space, q, start, solved, largest)
