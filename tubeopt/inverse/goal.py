"""Goal of inverse kinematics: target of the tip, constraints and costs, built-in or custom."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from ..block.custom import CustomObjective, CustomRequirement
from ..block.quantities import Expression, Quantity, recorded
from ..bodies.obstacles import Obstacle, Scene, checked_obstacles, scene_of
from ..equilibrium.arm_surface import MAX_CONTACTS, Contacts
from ..equilibrium.linearised import Linearised, curvature_at, position_changes, positions_at
from ..equilibrium.result import MIN_MARGIN
from ..errors import InputError, finite, instance, vector
from ..robots.limits import JointLimits, check_target
from ..robots.robot import Robot, check_robot
from ..stability import snap_free_certificate
from ..typing import Array, Delegate, Index
from .answer import DEFAULT_OPTIONS, InverseOptions
from .clock import Clock
from .joints import Configuration, JointSpace, configuration, joint_space, scaled_weights, shift_of
from .posture import Posture

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Extras:
    """Custom cost and constraints with their expressions."""

    cost: tuple[CustomObjective, Expression] | None = None
    constraints: tuple[tuple[CustomRequirement, Expression], ...] = ()

    def excess(self, at: Posture) -> Array:
        """Values (c,) of all constraints, in steps of their sizes, >= 0 if satisfied."""
        # A little inside, so that they stay satisfied when the posture is solved again on a finer mesh.
        parts = [_finite(each, partial(e, values(at))) / each.size - 1e-6 for each, e in self.constraints]
        return np.concatenate([np.zeros(0), *parts])

    def slopes(self, at: Posture) -> Array:
        """Derivatives (c, m) of `excess` by the joints."""
        parts = [_finite(each, partial(e.linear, linear(at)))[1] / each.size for each, e in self.constraints]
        return np.concatenate([np.zeros((0, len(at.q))), *parts])

    def price(self, at: Posture) -> float:
        """Minimised value of the cost."""
        if self.cost is None:
            return 0.0
        cost, expression = self.cost
        return float(cost.sign * cost.weight * _finite(cost, partial(expression, values(at)))[0])

    def price_slope(self, at: Posture) -> Array:
        """Gradient (m,) of the cost."""
        if self.cost is None:
            return np.zeros(len(at.q))
        cost, expression = self.cost
        slope: Array = cost.sign * cost.weight * _finite(cost, partial(expression.linear, linear(at)))[1][0]
        return slope

    def active(self, at: Posture) -> list[str]:
        """Descriptions of the constraints that are active or violated at a posture."""
        return [each.description for each, e in self.constraints if e(values(at)).min() < 1e-4 * each.size]


NOTHING = Extras()


def extras(cost: CustomObjective | None, constraints: Sequence[CustomRequirement], n: int) -> Extras:
    """Custom cost and constraints, checked and recorded."""
    for requirement in constraints:
        if not isinstance(requirement, CustomRequirement):
            raise InputError(f"extra_constraints contains {requirement!r}; it must be a sequence of CustomRequirement")
        requirement.checked()
    if cost is None:
        recorded_cost = None
    elif isinstance(cost, CustomObjective):
        cost.checked()
        expression = recorded(cost.expression, n, 1, cost.description)
        if expression.value.numel_out() != 1:
            raise InputError(f"the cost {cost.description} has {expression.value.numel_out()} numbers; it must be one")
        recorded_cost = cost, expression
    else:
        raise InputError(f"extra_cost is {cost!r}; it must be a CustomObjective")
    return Extras(
        recorded_cost, tuple((each, recorded(each.expression, n, 1, each.description)) for each in constraints)
    )


def _finite(objective: CustomObjective | CustomRequirement, evaluate: Callable[[], T]) -> T:
    """Value of a custom expression; raises InputError if it is not finite."""
    try:
        return evaluate()
    except FloatingPointError:
        raise InputError(
            f"the expression of {objective.description} is not finite at a pose on the path to the target"
        ) from None


def _with_sections(at: Posture) -> Linearised:
    """Derivatives of a posture with its cross-sections along the arm."""
    if not isinstance(at.derivatives, Linearised):
        raise InputError("kind is bundle; expressions of the curvature along its arm are not available")
    return at.derivatives


def values(at: Posture) -> Callable[[Quantity], Array]:
    """Function that evaluates quantities of a posture."""

    def value_of(quantity: Quantity) -> Array:
        """Numbers (k,) of one quantity."""
        match quantity.name:
            case _ if isinstance(quantity.pose, tuple):
                raise InputError("deployment poses are available in designs only")
            case "strain" | "clearance" | "deflection" | "margin_under" | "jacobian" | "turning" | "stroke_force":
                raise InputError(f"the {quantity.name.replace('_', ' ')} of a pose is available in designs only")
            case "certificate":
                return np.array([snap_free_certificate(at.space.robot, np.array(quantity.at))])
            case "tip_direction":
                return at.direction
            case "position":
                return np.asarray(positions_at(at.derivatives, np.array(quantity.at[:1]))[0])
            case "curvature" if quantity.at:
                return curvature_at(_with_sections(at), quantity.at[0])[0]
            case name if quantity.pose is None:
                return np.array([getattr(tube, name) for tube in at.space.robot.tubes])
            case name:
                return np.atleast_1d(getattr(at.equilibrium, name))

    return value_of


def linear(at: Posture) -> Callable[[Quantity], tuple[Array, Array]]:
    """Function that evaluates quantities of a posture, and their derivatives (.., m) by its joints."""
    n = at.space.robot.n_tubes

    def slope(quantity: Quantity) -> Array:
        """Derivatives (.., m) of a quantity by the joints."""
        match quantity.name:
            case "rotations":
                return at.space.spread[:n]
            case "translations":
                return at.space.spread[n:]
            case "tip_position":
                return at.jacobian.tip
            case "tip_direction":
                return np.cross(at.jacobian.rotation, at.direction[:, None], axis=0)
            case "margin":
                return at.margin_slope()[None]
            case "position":
                return np.asarray(position_changes(at.derivatives, np.array(quantity.at[:1]))[0] @ at.space.spread)
            case "curvature" if quantity.at:
                return curvature_at(_with_sections(at), quantity.at[0])[1] @ at.space.spread
            case _:
                return np.zeros((quantity.size(n), len(at.q)))

    value_of = values(at)
    return lambda quantity: (value_of(quantity), slope(quantity))


# The rotations of an equilibrium are solved for to 1e-8 rad, which moves the tip of an arm of 200 mm by 2e-9 m.
POSITION_TOLERANCE, DIRECTION_TOLERANCE = 1e-8, 1e-7
"""Tolerances of a target, m and rad: the accuracy of forward kinematics."""

EXTRA_MARGIN, EXTRA_CLEARANCE = 1e-6, 1e-5
"""Extra margin, and extra clearance (m), that a search keeps beyond the required values.

A finer mesh changes the margin by less than the first. The arm leaves the line between its sample points by less than
the second.
"""

# More distant bodies would only make the quadratic program larger. A step that meets one anyway is shortened, and the
# body is known from then on (`touched`).
BODY_REACH = 0.1
"""Distance from the arm, relative to the robot's length, within which obstacles constrain a step."""

# Every body adds up to MAX_CONTACTS rows, and the time of the quadratic program grows with the rows. Others count as
# soon as a step comes too close to one of them (`Goal.touched`).
BODIES_PER_STEP = 30
"""Number of nearest obstacles that always constrain a step; others are added for a step that approaches them too
closely."""


class LinearConstraints(NamedTuple):
    """Constraints rows x >= bounds on motions x (m,) of the joints."""

    rows: Array
    """Rows (c, m) of the constraint matrix."""
    bounds: Array
    """Lower bounds (c,) of the rows."""
    names: Index
    """Identifiers (c,), equal for the same constraint at different postures."""


@dataclass(frozen=True, eq=False)
class Goal:
    """Target in a joint space, constraints and objective."""

    space: JointSpace
    position: Array
    """Target position (3,) of the tip, m."""
    direction: Array | None
    """Target direction (3,) of the tip, a unit vector, or None."""
    min_margin: float
    scene: Scene
    """Obstacles that the arm must avoid."""
    objective: str | None
    """Objective, one of OBJECTIVES."""
    named: bool
    """True if a start or a reference was given."""
    reference: Array
    """Joint values (m,) to stay near."""
    weights: Array
    """Weights (m,) of the distances from the reference, per unit of a joint."""
    options: InverseOptions
    extras: Extras = NOTHING
    """Custom cost and constraints."""
    clock: Clock = field(default_factory=lambda: Clock(np.inf))
    """Time limit of all searches."""
    touched: set[int] = field(default_factory=set, init=False)
    """Numbers of bodies that an arm has come too close to; these always constrain a step."""

    direction_weight = Delegate[float | None]("options")
    clearance = Delegate[float]("options")

    @property
    def pointed(self) -> bool:
        """True if the direction is a constraint."""
        return self.direction is not None and self.direction_weight is None

    @property
    def ranked(self) -> bool:
        """True if solutions have a cost."""
        aimed = self.direction is not None and self.direction_weight is not None
        return self.objective is not None or aimed or self.extras.cost is not None

    @property
    def hindered(self) -> bool:
        """True with obstacles or custom constraints."""
        return bool(self.scene.bodies) or bool(self.extras.constraints)

    @property
    def overdetermined(self) -> bool:
        """True if the target has more equations than the robot has joints."""
        return len(self.space.lower) < (5 if self.pointed else 3)

    def met(self, at: Posture) -> bool:
        """True if a posture counts as on target."""
        return self.reached(at, POSITION_TOLERANCE, DIRECTION_TOLERANCE)

    @property
    def kept_margin(self) -> float:
        """Smallest margin that a search allows."""
        return self.min_margin + EXTRA_MARGIN

    @property
    def kept_clearance(self) -> float:
        """Smallest clearance that a search allows, m."""
        return self.clearance + EXTRA_CLEARANCE

    def beyond_reach(self) -> float:
        """Distance of the target from the plate minus the length of the longest arm, m; positive: out of reach."""
        return float(np.linalg.norm(self.position)) - self.space.longest

    def residual(self, at: Posture) -> Array:
        """Residual (3,) or (6,): position error over the robot's length, and direction error."""
        position = (at.tip - self.position) / self.space.length
        if self.direction is None or not self.pointed:
            return np.asarray(position)
        return np.concatenate([position, at.direction - self.direction])

    def slope(self, at: Posture, *, side: int = 1) -> Array:
        """Jacobian (3, m) or (6, m) of the residual, for translations that grow (side 1) or shrink (-1)."""
        position = (at.jacobian if side > 0 else at.backward).tip / self.space.length
        if not self.pointed:
            return np.asarray(position)
        return np.vstack([position, self.turning(at, side=side)])

    def turning(self, at: Posture, *, side: int = 1) -> Array:
        """Derivative (3, m) of the tip direction."""
        rotation = (at.jacobian if side > 0 else at.backward).rotation
        return np.asarray(np.cross(rotation, at.direction[:, None], axis=0))

    def position_error(self, at: Posture) -> float:
        """Distance of the tip from the target, m."""
        return float(np.linalg.norm(at.tip - self.position))

    def direction_error(self, at: Posture) -> float:
        """Angle between the tip and the target direction, rad; NaN without one."""
        return angle(at.direction, self.direction) if self.direction is not None else float("nan")

    def reached(self, at: Posture, position: float, direction: float) -> bool:
        """True if the errors of position and, if it is a constraint, direction are within m and rad."""
        return self.position_error(at) <= position and not (self.pointed and self.direction_error(at) > direction)

    def allowed(self, at: Posture, slack: float = 0.0) -> bool:
        """True if joints, order, margin and clearance satisfy the constraints; `slack` (m) is allowed on clearance."""
        return at.admissible and at.margin >= self.kept_margin and self.violation(at) <= slack

    def violation(self, at: Posture) -> float:
        """Largest violation of clearance, m, or of a custom constraint, in steps times the robot's length."""
        missing = -float(self.extras.excess(at).min(initial=0.0)) * self.space.length
        close = self.kept_clearance - at.surface.clearance(self.scene, self.kept_clearance)
        if close > 0 and len(self.scene.bodies) > BODIES_PER_STEP:
            self.touched.update(self.contacts(at, self.kept_clearance).body.tolist())
        return max(0.0, close, missing)

    def collisions(self, at: Posture) -> tuple[Array, Array]:
        """Violations (v,) of clearance, over length, and of custom constraints, in steps, with derivatives (v, m)."""
        values, rows = [np.zeros(0)], [np.zeros((0, len(at.q)))]
        if self.extras.constraints:
            excess = self.extras.excess(at)
            values.append(-excess[excess < 0])
            rows.append(-self.extras.slopes(at)[excess < 0])
        contacts = self.contacts(at, self.kept_clearance)
        if len(contacts.body):
            values.append((self.kept_clearance - contacts.distance) / self.space.length)
            rows.append(-at.contact_slopes(self.scene, contacts) / self.space.length)
        return np.concatenate(values), np.vstack(rows)

    def contacts(self, at: Posture, within: float) -> Contacts:
        """Contacts of the arm with obstacles closer than `within`, m."""
        return at.surface.contacts(self.scene, within)

    def ahead(self, at: Posture) -> Contacts:
        """Contacts with the obstacles that constrain a step from `at`."""
        within = self.kept_clearance + BODY_REACH * self.space.length
        return at.surface.contacts(self.scene, within, BODIES_PER_STEP, frozenset(self.touched))

    def constraints(self, at: Posture) -> LinearConstraints:
        """Linearised constraints of a step: joints, order, margin, custom constraints, and clearances."""
        rows, bounds = self.space.inequalities(at.q)
        slope = at.margin_slope()
        rows = np.vstack([rows, slope])
        bounds = np.append(bounds, self.kept_margin + 1e-9 - at.margin if slope.any() else -np.inf)
        if self.extras.constraints:
            rows = np.vstack([rows, self.extras.slopes(at)])
            bounds = np.concatenate([bounds, -self.extras.excess(at)])
        names = -1 - np.arange(len(rows))
        if self.scene.bodies:
            contacts = self.ahead(at)
            rows = np.vstack([rows, at.contact_slopes(self.scene, contacts)])
            bounds = np.concatenate([bounds, self.kept_clearance - contacts.distance])
            names = np.concatenate([names, contacts.body * MAX_CONTACTS + contacts.rank])
        return LinearConstraints(rows, bounds, names)

    def inequalities(self, at: Posture) -> tuple[Array, Array]:
        """Rows and bounds of a step from `at` that violates no constraint that is satisfied now.

        Joint limits, order and margin are always included.
        """
        rows, bounds, _ = self.constraints(at)
        included = bounds <= 0
        included[: len(at.step_bounds) + 1] = True
        return rows[included], np.minimum(bounds[included], 0.0)

    def cost(self, at: Posture) -> float:
        """Minimised cost; 0 without an objective."""
        value = self.extras.price(at)
        if self.objective == "nearest":
            value += 0.5 * float(np.sum((self.weights * (at.q - self.reference)) ** 2))
        elif self.objective == "margin":
            value -= at.margin
        elif self.objective == "curvature":
            value += 0.5 * at.bend * self.space.length
        if self.direction is not None and self.direction_weight is not None:
            value += 0.5 * self.direction_weight * float(np.sum((at.direction - self.direction) ** 2))
        return value

    def cost_rows(self, at: Posture, damping: float) -> tuple[Array, Array]:
        """Rows (r, m) and right-hand sides (r,) of a least-squares model of the cost in the step.

        Exact for "nearest", Gauss-Newton for a weighted direction. The others have only a gradient: the step of
        steepest descent in the metric of the joints' scales, with `damping` as its inverse length.
        """
        steep = np.zeros(len(at.q))
        rows, right = [np.diag(np.maximum(damping, 1e-6) / self.space.scale)], [steep]
        gradient = self.extras.price_slope(at)
        if self.objective == "nearest":
            rows.append(np.diag(self.weights))
            right.append(self.weights * (self.reference - at.q))
        elif self.objective == "margin":
            gradient = gradient - at.margin_slope()
        elif self.objective == "curvature":
            gradient = gradient + 0.5 * self.space.length * at.bend_slope
        right[0] = -gradient * self.space.scale / np.maximum(damping, 1e-6)
        if self.direction is not None and self.direction_weight is not None:
            root = np.sqrt(self.direction_weight)
            rows.append(root * self.turning(at))
            right.append(root * (self.direction - at.direction))
        return np.vstack(rows), np.concatenate(right)


def pose_question(  # noqa: PLR0913
    robot: Robot,
    position: ArrayLike,
    direction: ArrayLike | None = None,
    *,
    start: Configuration | None = None,
    reference: Configuration | None = None,
    min_margin: float = MIN_MARGIN,
    limits: JointLimits | None = None,
    weights: tuple[ArrayLike, ArrayLike] | None = None,
    obstacles: Sequence[Obstacle] = (),
    options: InverseOptions = DEFAULT_OPTIONS,
) -> Goal:
    """Checked goal of inverse kinematics; raises InputError for invalid arguments."""
    check_robot(robot)
    instance("options", options, InverseOptions)
    instance("limits", limits, JointLimits, optional=True)
    bodies = checked_obstacles(obstacles)
    target = vector("position", position, 3, "x, y, z in m")
    check_target(robot.tubes, "position", target)
    margin = finite("min_margin", min_margin)
    if not 0 <= margin < 1:
        raise InputError(f"min_margin is {margin:g}; it must be at least 0 and less than 1")
    space = joint_space(robot, limits, options.carriage_gap, options.section_length)
    space = space.holding(*shift_of(robot, start, reference))
    centre = space.middle()
    for name, value in (("start", start), ("reference", reference)):
        centre = configuration(space, name, value) if value is not None else centre
    named = start is not None or reference is not None
    return Goal(
        space=space,
        position=target,
        direction=None if direction is None else unit_vector("direction", direction),
        min_margin=margin,
        scene=scene_of(bodies),
        objective=options.objective or ("nearest" if named else None),
        named=named,
        reference=centre,
        weights=scaled_weights(space, weights),
        options=options,
        extras=extras(options.extra_cost, options.extra_constraints, robot.n_tubes),
    )


def unit_vector(name: str, value: ArrayLike) -> Array:
    """Unit vector (3,) along `value`; raises InputError if that is zero."""
    array = vector(name, value, 3, "x, y, z")
    largest = float(np.abs(array).max())
    if largest == 0:
        raise InputError(f"{name} is (0, 0, 0); it must have a direction")
    # Scaled first: the squares of very large and very small numbers overflow or vanish.
    array = array / largest
    return np.asarray(array / np.linalg.norm(array))


def angle(a: Array, b: Array) -> float:
    """Angle between two unit vectors, rad: accurate however small."""
    return float(2 * np.arctan2(np.linalg.norm(a - b), np.linalg.norm(a + b)))
