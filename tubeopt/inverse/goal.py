"""The question: target of the tip, constraints, costs, and custom ones of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from ..block.custom import CustomObjective, CustomRequirement
from ..block.quantities import Expression, Quantity, recorded
from ..bodies.obstacles import Obstacle, Scene, checked_obstacles, scene_of
from ..equilibrium.linearised import curvature_at, place_at, position_at
from ..errors import InputError, finite, instance, vector
from ..robots.limits import JointLimits, check_target
from ..robots.robot import Robot, check_robot
from ..stability import snap_free_certificate
from ..typing import Array, Delegate, Index
from .answer import DEFAULT_OPTIONS, InverseOptions
from .arm_surface import MOST_CONTACTS, Contacts
from .clock import Clock
from .joints import Configuration, JointSpace, configuration, joint_space, scaled_weights, shift_of
from .posture import Posture

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Extras:
    """Own cost and constraints with their expressions."""

    cost: tuple[CustomObjective, Expression] | None = None
    constraints: tuple[tuple[CustomRequirement, Expression], ...] = ()

    def room(self, at: Posture) -> Array:
        """(c,) of every number of every constraint, in steps of its size, >= 0 where it is kept."""
        # A little inside, so that solving again on a finer mesh still finds them kept.
        parts = [_asked(one, partial(e, values(at))) / one.size - 1e-6 for one, e in self.constraints]
        return np.concatenate([np.zeros(0), *parts])

    def slopes(self, at: Posture) -> Array:
        """(c, m) change of `room` with the joints."""
        # A little inside, so that solving again on a finer mesh still finds them kept.
        parts = [_asked(one, partial(e.linear, linear(at)))[1] / one.size for one, e in self.constraints]
        return np.concatenate([np.zeros((0, len(at.q))), *parts])

    def price(self, at: Posture) -> float:
        """The cost, as minimised."""
        if self.cost is None:
            return 0.0
        one, expression = self.cost
        return float(one.sign * one.weight * _asked(one, partial(expression, values(at)))[0])

    def price_slope(self, at: Posture) -> Array:
        """(m,) of the cost."""
        if self.cost is None:
            return np.zeros(len(at.q))
        one, expression = self.cost
        slope: Array = one.sign * one.weight * _asked(one, partial(expression.linear, linear(at)))[1][0]
        return slope

    def broken(self, at: Posture) -> list[str]:
        """Words of the constraints that hold a posture, or that it does not keep."""
        return [one.words for one, e in self.constraints if e(values(at)).min() < 1e-4 * one.size]


NOTHING = Extras()


def extras(cost: CustomObjective | None, constraints: Sequence[CustomRequirement], n: int) -> Extras:
    """Own cost and constraints, checked and recorded."""
    for one in constraints:
        if not isinstance(one, CustomRequirement):
            raise InputError(f"extra_constraints contains {one!r}; it must be a sequence of CustomRequirement")
        one.checked()
    if cost is None:
        found = None
    elif isinstance(cost, CustomObjective):
        cost.checked()
        found = cost, recorded(cost.expression, n, 1, cost.words)
        if found[1].value.numel_out() != 1:
            raise InputError(f"the cost {cost.words} has {found[1].value.numel_out()} numbers; it must be one")
    else:
        raise InputError(f"extra_cost is {cost!r}; it must be a CustomObjective")
    return Extras(found, tuple((one, recorded(one.expression, n, 1, one.words)) for one in constraints))


def _asked(objective: CustomObjective | CustomRequirement, ask: Callable[[], T]) -> T:
    try:
        return ask()
    except FloatingPointError:
        raise InputError(
            f"the expression of {objective.words} is not finite at a pose on the path to the target"
        ) from None


def values(at: Posture) -> Callable[[Quantity], Array]:
    """Quantities of a posture as numbers."""

    def look(quantity: Quantity) -> Array:
        """One quantity of the posture."""
        here = at.equilibrium
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
                return place_at(at.derivatives, quantity.at[0])
            case "curvature" if quantity.at:
                return curvature_at(at.derivatives, quantity.at[0])[0]
            case name if quantity.pose is None:
                return np.array([getattr(tube, name) for tube in at.space.robot.tubes])
            case name:
                return np.atleast_1d(getattr(here, name))

    return look


def linear(at: Posture) -> Callable[[Quantity], tuple[Array, Array]]:
    """Quantities of a posture, and their change (.., m) with its joints."""
    n = at.space.robot.n_tubes

    def slope(quantity: Quantity) -> Array:
        """(..., m) change of a quantity with the joints."""
        match quantity.name:
            case "rotations":
                return at.space.spread[:n]
            case "translations":
                return at.space.spread[n:]
            case "tip_position":
                return at.jacobian[0]
            case "tip_direction":
                return np.cross(at.jacobian[1], at.direction[:, None], axis=0)
            case "margin":
                return at.margin_slope()[None]
            case "position":
                return position_at(at.derivatives, quantity.at[0])[1] @ at.space.spread
            case "curvature" if quantity.at:
                return curvature_at(at.derivatives, quantity.at[0])[1] @ at.space.spread
            case _:
                return np.zeros((quantity.size(n), len(at.q)))

    look = values(at)
    return lambda one: (look(one), slope(one))


# The rotations of an equilibrium are solved for to 1e-8 rad, which moves the tip of an arm of 200 mm by 2e-9 m.
POSITION_TOLERANCE, DIRECTION_TOLERANCE = 1e-8, 1e-7
"""Distance, m, and angle, rad, at which an answer counts as on target: what forward kinematics is exact to."""

MARGIN_ROOM, CLEARANCE_ROOM = 1e-6, 1e-5
"""Margin, and clearance (m), that a search keeps beyond what is required: a finer mesh changes the margin by less than
the first, and the arm leaves the line between its sample points by less than the second."""

# Bodies farther off would only make the quadratic program larger. A step that meets one anyway is shortened, and the
# body is known from then on (`touched`).
BODY_REACH = 0.1
"""Distance from the arm, as a share of the robot's length, within which a step knows of obstacles."""

# Every body adds up to MOST_CONTACTS rows, and the time of the quadratic program grows with the rows. Others count as
# soon as a step comes too close to one of them (`Goal.touched`).
BODIES_PER_STEP = 30
"""Obstacles that a step knows of at least, the nearest first; others follow when a step comes too close to them."""


@dataclass(frozen=True, eq=False)
class Goal:
    """A target in a joint space, what must hold, and what is best."""

    space: JointSpace
    position: Array
    """(3,) m."""
    direction: Array | None
    """(3,) unit vector, or None."""
    min_margin: float
    scene: Scene
    """All bodies to keep away from."""
    objective: str | None
    """One of OBJECTIVES."""
    named: bool
    """Whether a start or a reference is given."""
    reference: Array
    """(m,) joint values to stay near."""
    weights: Array
    """(m,) of the distances from them, per unit of a joint."""
    options: InverseOptions
    extras: Extras = NOTHING
    """Own cost and constraints beside all that."""
    clock: Clock = field(default_factory=lambda: Clock(np.inf))
    """When it is over, searches end where they are."""
    touched: set[int] = field(default_factory=set, init=False)
    """Numbers of bodies that an arm was found too close to, which are looked at however many are closer."""

    direction_weight = Delegate[float | None]("options")
    clearance = Delegate[float]("options")

    @property
    def pointed(self) -> bool:
        """Whether the direction is a constraint."""
        return self.direction is not None and self.direction_weight is None

    @property
    def ranked(self) -> bool:
        """Whether one answer can be better than another."""
        aimed = self.direction is not None and self.direction_weight is not None
        return self.objective is not None or aimed or self.extras.cost is not None

    @property
    def hindered(self) -> bool:
        """Whether obstacles or custom constraints are in the way."""
        return bool(self.scene.bodies) or bool(self.extras.constraints)

    @property
    def overdetermined(self) -> bool:
        """Whether the target has more equations than the robot has joints."""
        return len(self.space.lower) < (5 if self.pointed else 3)

    def met(self, at: Posture) -> bool:
        """Whether a posture counts as on target."""
        return self.reached(at, POSITION_TOLERANCE, DIRECTION_TOLERANCE)

    @property
    def floor(self) -> float:
        """The margin that is kept."""
        return self.min_margin + MARGIN_ROOM

    @property
    def gap(self) -> float:
        """The clearance that is kept, m."""
        return self.clearance + CLEARANCE_ROOM

    def beyond_reach(self) -> float:
        """By how much the target is farther from the plate than the longest arm that the joints' ranges allow, m: the
        tip is certainly no closer. Negative where it is not."""
        return float(np.linalg.norm(self.position)) - self.space.longest

    def residual(self, at: Posture) -> Array:
        """(3,) or (6,) what is left to the target: position over length, and direction."""
        gap = (at.tip - self.position) / self.space.length
        if self.direction is None or not self.pointed:
            return np.asarray(gap)
        return np.concatenate([gap, at.direction - self.direction])

    def slope(self, at: Posture, *, side: int = 1) -> Array:
        """(3, m) or (6, m) derivative of the residual."""
        position = (at.jacobian if side > 0 else at.backward)[0] / self.space.length
        if not self.pointed:
            return np.asarray(position)
        return np.vstack([position, self.turning(at, side=side)])

    def turning(self, at: Posture, *, side: int = 1) -> Array:
        """(3, m) derivative of the tip's direction."""
        turn = (at.jacobian if side > 0 else at.backward)[1]
        return np.asarray(np.cross(turn, at.direction[:, None], axis=0))

    def position_error(self, at: Posture) -> float:
        """Distance of the tip from the target, m."""
        return float(np.linalg.norm(at.tip - self.position))

    def direction_error(self, at: Posture) -> float:
        """Angle between the tip and the wanted direction, rad; NaN without one."""
        return angle(at.direction, self.direction) if self.direction is not None else float("nan")

    def reached(self, at: Posture, position: float, direction: float) -> bool:
        """Whether position (m) and, where it is a constraint, direction (rad) are met."""
        return self.position_error(at) <= position and not (self.pointed and self.direction_error(at) > direction)

    def allowed(self, at: Posture, slack: float = 0.0) -> bool:
        """Whether joints, order, margin and clearance are kept, to within `slack` (m) of clearance."""
        return at.admissible and at.margin >= self.floor and self.violation(at) <= slack

    def violation(self, at: Posture) -> float:
        """Missing clearance from the worst obstacle, m, or steps missing to a custom constraint, times the robot's
        length; 0 without a violation."""
        missing = -float(self.extras.room(at).min(initial=0.0)) * self.space.length
        close = self.gap - at.outline.clearance(self.scene, self.gap)
        if close > 0 and len(self.scene.bodies) > BODIES_PER_STEP:
            self.touched.update(self.contacts(at, self.gap).body.tolist())
        return max(0.0, close, missing)

    def collisions(self, at: Posture) -> tuple[Array, Array]:
        """(v,) clearances that are missing, over length, steps of custom constraints that are, and their slopes (v, m):
        what a search has to make 0."""
        values, rows = [np.zeros(0)], [np.zeros((0, len(at.q)))]
        if self.extras.constraints:
            room = self.extras.room(at)
            values.append(-room[room < 0])
            rows.append(-self.extras.slopes(at)[room < 0])
        contacts = self.contacts(at, self.gap)
        if len(contacts.body):
            values.append((self.gap - contacts.distance) / self.space.length)
            rows.append(-at.contact_slopes(self.scene, contacts) / self.space.length)
        return np.concatenate(values), np.vstack(rows)

    def contacts(self, at: Posture, within: float) -> Contacts:
        """Where the arm comes closer than `within`, m, to obstacles."""
        return at.outline.contacts(self.scene, within)

    def ahead(self, at: Posture) -> Contacts:
        """Where the arm comes close to the bodies of which a step from `at` shall know."""
        within = self.gap + BODY_REACH * self.space.length
        return at.outline.contacts(self.scene, within, BODIES_PER_STEP, frozenset(self.touched))

    def demands(self, at: Posture) -> tuple[Array, Array, Index]:
        """Linearised constraints of a step, rows and bounds, and (c,) identifiers for comparing them between postures.

        Joints, order, margin, custom constraints, and clearances."""
        rows, bounds = self.space.inequalities(at.q)
        slope = at.margin_slope()
        rows = np.vstack([rows, slope])
        bounds = np.append(bounds, self.floor + 1e-9 - at.margin if slope.any() else -np.inf)
        if self.extras.constraints:
            rows = np.vstack([rows, self.extras.slopes(at)])
            bounds = np.concatenate([bounds, -self.extras.room(at)])
        names = -1 - np.arange(len(rows))
        if self.scene.bodies:
            contacts = self.ahead(at)
            rows = np.vstack([rows, at.contact_slopes(self.scene, contacts)])
            bounds = np.concatenate([bounds, self.gap - contacts.distance])
            names = np.concatenate([names, contacts.body * MOST_CONTACTS + contacts.rank])
        return rows, bounds, names

    def inequalities(self, at: Posture) -> tuple[Array, Array]:
        """Rows and bounds of a step from `at` that keeps the joints' order, the margin, and what is clear now."""
        rows, bounds, _ = self.demands(at)
        kept = bounds <= 0
        kept[: len(at.room) + 1] = True
        return rows[kept], np.minimum(bounds[kept], 0.0)

    def cost(self, at: Posture) -> float:
        """What is made small among all answers; 0 where nothing was asked for."""
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
        """Rows (r, m) and right-hand sides of least squares in the step whose minimum makes the cost small.

        Exact for "nearest", Gauss-Newton for a weighted direction; for the others, of which only the gradient is known,
        the step of steepest descent in the metric of the joints' scales, `damping` its inverse length.
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


def pose_question(
    robot: Robot,
    wanted: tuple[ArrayLike, ArrayLike | None],
    places: tuple[Configuration | None, Configuration | None] = (None, None),
    *,
    min_margin: float = 0.05,
    limits: JointLimits | None = None,
    weights: tuple[ArrayLike, ArrayLike] | None = None,
    obstacles: Sequence[Obstacle] = (),
    options: InverseOptions = DEFAULT_OPTIONS,
) -> Goal:
    """The question, checked; `wanted` are position and direction of the tip, `places` start and reference."""
    position, direction = wanted
    check_robot(robot)
    instance("options", options, InverseOptions)
    instance("limits", limits, JointLimits, optional=True)
    bodies = checked_obstacles(obstacles)
    target = vector("position", position, 3, "x, y, z in m")
    check_target(robot.tubes, "position", target)
    floor = finite("min_margin", min_margin)
    if not 0 <= floor < 1:
        raise InputError(f"min_margin is {floor:g}; it must be at least 0 and less than 1")
    start, reference = places
    space = joint_space(robot, limits, options.carriage_gap, options.section_length)
    space = space.holding(*shift_of(robot, start, reference))
    centre = space.middle()
    for name, place in (("start", start), ("reference", reference)):
        centre = configuration(space, name, place) if place is not None else centre
    named = start is not None or reference is not None
    return Goal(
        space=space,
        position=target,
        direction=None if direction is None else unit_vector("direction", direction),
        min_margin=floor,
        scene=scene_of(bodies),
        objective=options.objective or ("nearest" if named else None),
        named=named,
        reference=centre,
        weights=scaled_weights(space, weights),
        options=options,
        extras=extras(options.extra_cost, options.extra_constraints, robot.n_tubes),
    )


def unit_vector(name: str, value: ArrayLike) -> Array:
    """`value` (3,) over its length; raises InputError where it has none."""
    array = vector(name, value, 3, "x, y, z")
    largest = float(np.abs(array).max())
    if largest == 0:
        raise InputError(f"{name} is (0, 0, 0); it must have a direction")
    # The squares of very large and very small numbers are none.
    array = array / largest
    return np.asarray(array / np.linalg.norm(array))


def angle(a: Array, b: Array) -> float:
    """Angle between two unit vectors, rad: accurate however small."""
    return float(2 * np.arctan2(np.linalg.norm(a - b), np.linalg.norm(a + b)))
