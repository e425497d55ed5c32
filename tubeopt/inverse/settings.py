"""How inverse kinematics is asked in detail, and how hard joint values are searched for."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

from ..arguments import typed
from ..block.custom import CustomObjective, CustomRequirement
from ..display import Displayed
from ..errors import InputError, Settings, instance, positive
from ..files.field_metadata import NOT_NEGATIVE, POSITIVE, OneOf, Range, Typical, check_fields, check_size, unit

OBJECTIVES = ("nearest", "margin", "curvature")
"""What is best: joint values near a reference, the largest margin, the least int |u|^2 ds."""

METHODS = ("auto", "gauss_newton", "nlp")
"""How to solve: the fast path and the nonlinear program where it stalls, or one of them alone."""

TIME_LIMIT = 60.0
"""s, for one target: three times what `tubeopt ik` gives one by default."""


@dataclass(frozen=True)
class Descent(Settings):
    """The fast path: steps from one start to the target, then to a better answer."""

    tolerance: float = 1e-10
    """Distance (m) and angle (rad) at which it counts a target as met: far less than an answer may be off."""
    steps: int = 30
    """Maximum number of steps to the target."""
    improving_steps: int = 60
    """Maximum number of steps that improve a solution on target."""
    first_step: float = 0.6
    """Largest step at first, in units of the joints' scales."""
    shortest_step: float = 1e-5
    """Step size that ends the search, in units of the joint scales."""
    least_promise: float = 1e-7
    """Relative decrease of what is left to the target that a step must promise."""
    patience: int = 5
    """Steps in a row that may bring next to nothing."""
    target_weight: float = 1e4
    """Weight of the target relative to the cost, in an improving step."""
    body_reach: float = 0.1
    """Distance from the arm, as a fraction of the robot's length, within which a step considers obstacles."""
    bodies: int = 30
    """Minimum number of obstacles in a step, nearest first. Others enter only after a step comes too close to them."""


@dataclass(frozen=True)
class OrderChanges(Settings):
    """Settings for changes in the order of breakpoints along the arm."""

    closed_section: float = 1e-7
    """Length, m, of a section between breakpoints that counts as none."""
    short_section: float = 1e-4
    """Length of a section, as a fraction of the robot's length, that may block a step like a closed one."""
    shift: float = 1e-5
    """Distance that breakpoints are moved past each other, as a fraction of the robot's length."""


@dataclass(frozen=True)
class Starts(Settings):
    """Settings of the starts of a search, and of conclusions from their results."""

    pool: int = 400
    """Configurations of the table, the most promising, among which starts are spread."""
    direction_weight: float = 0.35
    """Weight of the direction error relative to the position error over the robot's length, in the ranking of starts.
    """
    nearness_weight: float = 0.02
    """Weight of the distance from a reference, in units of the joint scales, in the ranking of starts."""
    nearest: int = 12
    """Taken as they come, the most promising first; those after them are spread over all postures."""
    clear: int = 8
    """Clear of the obstacles, that are tried where all others ended in one."""
    compared: int = 3
    """Answers among which the best is taken where there is an objective and no start."""
    doubted: int = 4
    """Answers that a cold forward kinematics does not find, after which one of them is taken."""
    unanimous: int = 10
    """Number of starts with the same distance from the target that count as proof of no better one."""
    hopeless: int = 24
    """Number of starts, all ending farther from the target than `far`, that count as out of reach."""
    far: float = 0.02
    """Share of the robot's length."""
    same_miss: float = 2e-5
    """Largest difference of equal distances from the target, as a fraction of the robot's length."""
    same_cost: float = 1e-7
    """Relative improvement of the cost that a later solution needs to replace an earlier one."""

    _none: ClassVar[tuple[str, ...]] = ("clear",)


@dataclass(frozen=True)
class Programs(Settings):
    """The nonlinear program, which tries what the fast path did not solve."""

    starts: int = 4
    """Number of starts of the program."""
    orders: int = 6
    """Changes of the order of breakpoints that it goes through."""
    bodies: int = 16
    """Obstacles at most: every one costs as much as all of the arm."""
    building: float = 0.025
    """Seconds that building it may take, per cube of the number of tubes, and per obstacle and one."""
    margin_room: float = 1e-4
    """Margin that it keeps beyond the bound: more than the steps of its Jacobi fields are off."""

    _none: ClassVar[tuple[str, ...]] = ("starts", "orders")


@dataclass(frozen=True)
class Closest(Settings):
    """The search for the posture that misses an unreachable target least."""

    steps: int = 60
    """Maximum number of steps from one end of a search."""
    postures: int = 150
    """Tried in it; far fewer do but where bodies hold the arm in several places."""
    promise: float = 1e-8
    """Smallest predicted approach of a step to the target, as a fraction of the robot's length."""
    gain: float = 1e-7
    """Improvement that a later end needs to replace an earlier one, as a fraction of the robot's length."""
    returns: int = 12
    """Maximum number of steps back into the allowed set."""
    curvature: float = 1e-6
    """Smallest curvature of the model, per square of a joint's scale."""
    same_end: float = 1e-3
    """Ends closer than this in every joint, in units of their scales, are one."""
    agreeing: int = 4
    """Number of further ends at the same distance that count as proof of no closer one."""


@dataclass(frozen=True)
class Aiming(Settings):
    """Settings for correcting unloaded solutions so that the loaded arm reaches the target."""

    shots: int = 40
    """Answers without load in search of one that is on target, with its margin and clearance, under it."""
    tolerance: float = 2e-9
    """Distance, m, and angle, rad, at which the aim is good."""
    stalled: float = 1e-7
    """Correction, as a fraction of the arm or as an angle, below which round-off ends the iteration."""
    gain: float = 0.9
    """Largest ratio of successive misses of a converging iteration."""
    poor: int = 4
    """Poor shots beyond which aiming does not converge."""
    room: float = 1e-3
    """Margin, and share of the arm's length as clearance, asked for beyond what was found missing."""


@dataclass(frozen=True)
class SessionSteps(Settings):
    """Settings of the steps of an `IkSession` between targets."""

    tolerance: float = 2e-9
    """Distance, m, and angle, rad, at which a step ends."""
    move: float = 0.02
    """Share of the robot's length; farther targets are approached in so long parts on a straight line."""
    part: float = 1 / 16
    """Smallest part, as a fraction, into which a step is divided to avoid a jump."""
    push: float = 0.5
    """Length of the motion towards larger margin, over that of the motion towards the target."""
    careful: float = 0.15
    """Margin above its bound below which derivatives are computed anew for every step."""
    room: float = 4.0
    """Spare clearance of a step that ignores obstacles, per distance that the tip moves."""
    least_room: float = 2e-4
    """Minimum of that spare clearance, m."""
    solves: int = 4
    """Equilibria that a step may cost before its derivatives count as stale."""
    age: int = 8
    """Steps after which they do in any case."""
    section: float = 1e-3
    """Length, m, of a section that a step may close."""


@dataclass(frozen=True)
class Jumps(Settings):
    """Limits beyond which an `IkSession` reports a jump."""

    turn: float = 20.0
    """Largest motion of a rotation, rad, over that of the tip in robot's lengths and, where it is pointed, rad."""
    shift: float = 8.0
    """Allowed translation in units of its scale, per motion of the tip. A carriage that moves more than four times as
    far as the tip changes the posture.
    """
    azimuth: float = 2.0
    """Additional allowed rotation, per angle that the tip moves about the plate axis."""
    least: float = 0.02
    """Motion of a joint, in units of its scale, that is no leap in any case."""
    aside: float = 0.05
    """Distance of the tip from the line between the targets that is no leap, as a share of their distance."""
    least_aside: float = 1e-5
    """Minimum of the allowed distance from the line, m."""
    sampled: float = 0.1
    """Joint motion between two checked points of the path, in units of the joint scales."""


@dataclass(frozen=True)
class InverseSolver(Settings):
    """Settings of the search of inverse kinematics; a field of `InverseOptions`.

    Raises:
        InputError: a count that is no whole number of at least 1 (0 for starts of the program, clear starts and
            orders), another number that is not positive.
    """

    position_tolerance: float = 1e-8
    """Distance, m, at which an answer counts as on target."""
    direction_tolerance: float = 1e-7
    """Angle, rad, at which it counts as pointing there."""
    margin_room: float = 1e-6
    """Extra margin beyond the required one, so that a finer mesh still satisfies it."""
    clearance_room: float = 1e-5
    """Extra clearance beyond the required one, m: covers the arm between its sample points."""
    path_seconds: float = 10.0
    """Longest search for a snap-free path to one solution, s."""
    path_margin: float = 2e-3
    """Margin kept on that path; half of the margin at its ends if that is less."""
    descent: Descent = Descent()
    """Towards the target from each start."""
    order: OrderChanges = OrderChanges()
    """Settings for changes in the order of breakpoints."""
    starts: Starts = Starts()
    """Settings of the starts."""
    program: Programs = Programs()
    """Settings of the nonlinear programs that start from results of the descent."""
    closest: Closest = Closest()
    """Settings for the closest pose to a target out of reach."""
    aim: Aiming = Aiming()
    """Settings for targets under a load."""
    session: SessionSteps = SessionSteps()
    """Settings of the steps of an `IkSession`."""
    jump: Jumps = Jumps()
    """Settings of the check for jumps between targets."""


DEFAULT_SOLVER = InverseSolver()


@typed
@dataclass(frozen=True)
class InverseOptions(Displayed):
    """Details of the question and of the search.

    Raises:
        InputError: a value that is not allowed.
    """

    objective: Annotated[
        str | None,
        OneOf(OBJECTIVES),
        "objective: nearest (to the start or reference), margin or curvature; "
        "default nearest with a start or reference, otherwise any answer",
    ] = None
    """Among the answers: "nearest" (to the reference), "margin" (largest), "curvature" (least int |u|^2 ds), or None:
    "nearest" where a start or a reference is given, else any answer."""
    direction_weight: Annotated[
        float | None,
        POSITIVE,
        "factor on half the squared difference of the unit vectors in the cost; by default the direction is exact",
    ] = None
    """None makes the direction a constraint. A number adds half the squared difference of the unit vectors to the
    objective, with that weight.
    """
    clearance: Annotated[
        float, unit("mm"), NOT_NEGATIVE, Typical(1e-5, 0.1), "smallest allowed distance between arm and obstacles"
    ] = 0.0
    """Smallest allowed distance between the surface of the arm and obstacles, m."""
    carriage_gap: float = 0.0
    """Least distance of neighbouring carriages, m."""
    section_length: float = 0.0
    """Smallest length that a tube protrudes from the next outer one, m."""
    method: Annotated[str, OneOf(METHODS), "solver: auto, gauss_newton or nlp"] = "auto"
    """"auto" (the fast path, and the nonlinear program where that stalls), "gauss_newton" or "nlp" alone."""
    starts: Annotated[int, Range(least=1), "largest number of starting configurations"] = 48
    distinct: float = 0.05
    """Answers of `all_solutions` differ somewhere along the arm by this share of its length."""
    time_limit: float = TIME_LIMIT
    """Time limit of the whole call for any method, s; computations in progress end early. `math.inf` sets none."""
    extra_cost: CustomObjective | None = None
    """Custom objective that is added to `objective`: an expression of the quantities of the pose, `q.poses[0]`, times
    its weight. Only the fast path supports it."""
    extra_constraints: tuple[CustomRequirement, ...] = ()
    """Custom requirements that every solution satisfies. Only the fast path supports them."""
    solver: InverseSolver = DEFAULT_SOLVER
    """Settings of the search."""

    def __post_init__(self) -> None:
        check_fields(self)
        for name in ("carriage_gap", "section_length"):
            positive(name, getattr(self, name), zero=True)
            check_size(name, getattr(self, name), Typical(1e-6, 0.5), "mm")
        positive("distinct", self.distinct)
        if self.time_limit != math.inf:
            positive("time_limit", self.time_limit)
        if not isinstance(self.extra_constraints, (list, tuple)):
            raise InputError(
                f"extra_constraints is {self.extra_constraints!r}; it must be a sequence of CustomRequirement"
            )
        object.__setattr__(self, "extra_constraints", tuple(self.extra_constraints))
        if self.method == "nlp" and (self.extra_cost is not None or self.extra_constraints):
            raise InputError(
                "method 'nlp' does not support extra_cost and extra_constraints; use 'auto' or 'gauss_newton'"
            )
        instance("solver", self.solver, InverseSolver)


DEFAULT_OPTIONS = InverseOptions()
