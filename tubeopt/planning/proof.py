"""Proof of a trajectory: equilibria by a second solver, and closed-form bounds between them.

The joint values are followed by `forward_kinematics` (collocation and Newton's method; the planner integrates from the
tip). Between two equilibria, `branch` proves that one branch of stable equilibria joins them, and `trajectory_trace`
bounds the clearance, at all times and all along the arm. Both assume equilibria within the tolerance of forward
kinematics (1e-8 rad, estimated) and their margins; some are integrated again by DOP853. The smallest margin is found
numerically.

The speed of the tip is bounded by its second and third time derivatives between equilibria; see "Speed of the tip" in
`docs/theory-proofs.md`. In the middle of a link the velocity differs from the mean velocity by at most h^2 / 24 times
the third derivative. Between two times with a known velocity it differs from a linear function by at most h^2 / 8 times
that. With known velocities at both ends of a link, it differs from that of the cubic through both tips by h^2 / 31.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from ..arguments import typed
from ..bodies.obstacles import Obstacle, checked_obstacles, scene_of
from ..display import Displayed
from ..equilibrium.jacobian import position_slopes
from ..equilibrium.kinematics import TOLERANCE, forward_kinematics
from ..equilibrium.problem import check_load
from ..equilibrium.result import Equilibrium
from ..equilibrium.verification import verifications
from ..errors import InputError, SolveError, finite, instance, positive
from ..files.field_metadata import TYPICAL_CLEARANCE, form, key, typical_length, unit
from ..inverse.clock import Clock
from ..robots.assembly import LENGTH_ROUND_OFF
from ..robots.calibration import PathBounds
from ..robots.eccentric import by_model
from ..robots.limits import JointLimits
from ..robots.load import Load
from ..robots.robot import Robot, check_robot
from ..solvers.blas import small
from ..solvers.compiled.binding import Carriages
from ..solvers.time_limit import LONG_TIME_LIMIT
from ..stability.deflection import ForceBound, under_any_force
from ..stability.following import checked_waypoints
from ..typing import Array, Delegate, Mask, StatusEnum
from .motion import SLACK, RateLimits, joint_range, out_of_range, rates_of, too_fast
from .trajectory_trace import (
    SHORTEST,
    ClearanceTarget,
    Link,
    TraceStep,
    TrajectoryTrace,
    TrajectoryVerifier,
    bisect,
    follow,
    prove_branch,
)

TIGHT = 0.029
"""Largest relative distance of the speed bound above the measured speed."""

# The largest integral of the Peano kernel of that derivative.
HERMITE = 0.03231
"""Factor of h^2 |f'''| in the bound on |f' - c'| of a cubic Hermite interpolant c.

c has the values and slopes of f at both ends.
"""

# Between the samples the speed grows by at most 12 |deviation| / (8 SAMPLES^2), 2 % of it.
SAMPLES = 8
"""Number of parts of a link between samples of the speed along that cubic."""

STEADY = 1e-9
"""Largest difference of joint rates, relative to the fastest joint, of equal directions of motion."""

# More at once would bisect links that the first bisection had already made sharp.
MAX_HALVINGS = 2
"""Maximum number of bisections of a link in one round."""

# 4096 parts of a link; beyond a fold the bound stays loose however short the links are.
FINEST = 12
"""Maximum number of rounds."""

Slopes = dict[tuple[Equilibrium, Carriages, int], Array]
"""Jacobians (3, 2n) of the tip at equilibria, by the carriages that move tubes together, and the side."""


@dataclass(frozen=True)
class Pace:
    """Speed of the tip, m/s."""

    bound: float
    """Upper bound; infinite where nothing is proved."""
    measured: float
    """Largest mean speed between two equilibria, less the error of the tips."""


def paced(verifier: TrajectoryVerifier, links: Sequence[Link], span: float, limit: float) -> Pace:
    """Speed of the tip in a motion of duration `span`, s, along consecutive links.

    Links are bisected where the bound is not sharp, or above a `limit`, m/s, that the motion may satisfy.
    """
    links, largest, measured = list(links), 0.0, 0.0
    slopes: Slopes = {}
    for _ in range(FINEST):
        row = _Row(verifier, links, span, slopes)
        # Less the errors of both tips, so that this speed certainly occurs.
        measured = float((row.speed - row.wrong).max(initial=0.0))
        if not all(len(link.chord_error) and np.isfinite(link.chord_error).all() for link in links):
            return Pace(math.inf, measured)
        # Derivatives by the fraction of a link, divided by h^2 and h^3, are those by time.
        rates = np.array([link.rates for link in links]).reshape(-1, 2).T / row.passed ** np.array([[2], [3]])
        bounds, attained = row.fastest(rates, min(measured * (1 + TIGHT), limit))
        largest, attained = float(bounds.max(initial=0.0)), max(measured, attained)
        sharp = attained * (1 + TIGHT)
        # A bound must be sharp and within the limit, unless a speed that occurs exceeds the limit anyway.
        loose = bounds > (min(sharp, limit) if attained <= limit else sharp)
        loose &= np.array([link.end.at - link.start.at >= SHORTEST for link in links], dtype=bool)
        # Over distances below the accuracy of the tips the speed cannot be known better.
        loose &= bounds * row.passed > TOLERANCE * verifier.length
        if not loose.any() or verifier.exhausted:
            break
        # The excess of the bound falls with the square of the length, and faster near folds; halves use the cubic.
        best = np.minimum(bounds, row.speed + HERMITE * rates[1] * row.passed**2)
        wide = np.maximum(best - attained, TIGHT * attained) / (TIGHT * attained or 1.0)
        # Assume a factor 2^3 per bisection; links that are loose after that are bisected in the next round.
        times = np.where(loose, np.ceil(np.log2(wide) / 3).clip(1, MAX_HALVINGS), 0).tolist()
        parts: list[Link] = []
        for link, count, bound in zip(links, times, bounds.tolist(), strict=True):
            # The bound of a whole link is valid for its halves.
            more = [replace(link, fastest=bound)] if count else []
            for _ in range(int(count)):
                more = [half for each in more for half in bisect(verifier, each)]
            parts += more
        links = [link for link, count in zip(links, times, strict=True) if not count]
        links += prove_branch(verifier, parts).links
        # In order of time: bounds of neighbours are combined.
        links.sort(key=lambda link: link.start.at)
    return Pace(largest, measured)


@dataclass(frozen=True, eq=False)
class _Row:
    """B consecutive links of a motion of duration `span`, s."""

    verifier: TrajectoryVerifier
    links: list[Link]
    span: float
    slopes: Slopes
    """Cache of Jacobians."""

    @cached_property
    def passed(self) -> Array:
        """(B,) durations of the links, s."""
        return np.array([self.span * (link.end.at - link.start.at) for link in self.links])

    @cached_property
    def steps(self) -> list[TraceStep]:
        """The B + 1 steps between the links."""
        return [self.links[0].start, *(link.end for link in self.links)] if self.links else []

    @cached_property
    def chord(self) -> Array:
        """(B, 3) mean velocities of the tip, m/s."""
        tips = np.array([step.equilibrium.tip_position for step in self.steps]).reshape(-1, 3)
        return np.diff(tips, axis=0) / self.passed[:, None]

    @cached_property
    def speed(self) -> Array:
        """(B,) mean speeds of the tip, m/s."""
        return np.asarray(np.linalg.norm(self.chord, axis=1))

    @cached_property
    def wrong(self) -> Array:
        """(B,) bound on the error of `speed`, m/s, from the errors of both tip positions."""
        error = np.array([step.equilibrium.tip_error for step in self.steps])
        # The difference of two tips is off by the sum of their errors, at most twice the larger one.
        return np.asarray(2 * np.maximum(error[1:], error[:-1]) / self.passed)

    @cached_property
    def rate(self) -> Array:
        """(B, 2n) rates of the joints in each link."""
        return np.diff([step.joints for step in self.steps], axis=0) / self.passed[:, None]

    @cached_property
    def pace(self) -> Array:
        """(B,) largest joint rate in each link; 1 at rest."""
        largest = np.abs(self.rate).max(1)
        return np.where(largest > 0, largest, 1.0)

    @cached_property
    def alike(self) -> Mask:
        """(B - 1,) True for inner steps at which the joints continue straight and the order of sections
        is unchanged.
        """
        n, along = self.verifier.robot.n_tubes, self.rate / self.pace[:, None]
        same = (np.abs(np.diff(along, axis=0)) <= STEADY).all(1)
        if not self.rate[:, n:].any():
            return np.asarray(same)
        # A distance that changes its sign over two links: breakpoints pass each other. One sign is enough, since the
        # table is antisymmetric.
        distance = self._distances(np.array([step.joints[n:] for step in self.steps]))
        return np.asarray(same & ~((distance[:-2] > LENGTH_ROUND_OFF) & (distance[2:] < -LENGTH_ROUND_OFF)).any((1, 2)))

    def _distances(self, translations: Array) -> Array:
        """(S, P, P) signed distances between breakpoints, plate and load points at translations (S, n), m."""
        points = self.verifier.cuts(translations)
        return np.asarray(points[:, :, None] - points[:, None, :])

    def velocity(self, step: int, link: int) -> Array | None:
        """(3,) velocity of the tip at a step of a link, m/s; None at a fold.

        It is the limit from inside the link.

        It is J q'. But where breakpoints meet, each column of J has another order of the sections, and columns do not
        add up. There q' is a sum of parts that keep the order of the sections in the link: all moving tubes together at
        the rate of the slowest, then the others together at the difference to the next rate, and so on.
        """
        e, inwards, n = self.steps[step].equilibrium, 1 if step == link else -1, self.verifier.robot.n_tubes
        turn, shift = np.split(inwards * self.rate[link], 2)
        parts: list[tuple[int, float, Mask]] = []
        if shift.any() and self._meeting(step, shift):
            for side in (1, -1):
                # From 0, so that the differences of the sorted rates sum up to each rate.
                paces = np.unique(np.append(0.0, side * shift).clip(0))
                parts += [(side, side * (b - a), side * shift >= b) for a, b in pairwise(paces.tolist())]
        try:
            if not parts:
                return np.asarray(self._slopes(e) @ self.rate[link])
            velocity = self._slopes(e)[:, :n] @ turn
            for side, pace, tubes in parts:
                velocity += pace * self._slopes(e, tubes, side)[:, n:][:, tubes].sum(1)
        except SolveError:
            return None
        return np.asarray(inwards * velocity)

    def _meeting(self, step: int, shift: Array) -> bool:
        """True if breakpoints of tubes with rates `shift` (n,) meet others, the plate or a load point."""
        n, ended = self.verifier.robot.n_tubes, self.verifier.constants.ended
        meet = np.abs(self._distances(self.steps[step].joints[None, n:])[0]) <= LENGTH_ROUND_OFF
        owner = np.full(len(meet), -1)
        # Points are the plate, the breakpoints of all tubes, then places of the load; only those of tubes move.
        owner[1 : 1 + n * ended] = np.tile(np.arange(n), ended)
        moves = np.append(shift, 0.0)[owner] != 0
        return bool((meet & (owner[:, None] != owner) & (moves[:, None] | moves)).any())

    def _slopes(self, e: Equilibrium, together: Mask | None = None, side: int = 1) -> Array:
        """(3, 2n) one-sided J, where the tubes `together` (n,) share a carriage, and so do the others."""
        carriages = self.verifier.robot.moving_together
        if together is not None:
            groups = (np.flatnonzero(mask).tolist() for mask in (together, ~together))
            carriages = tuple(tuple(tubes) for tubes in groups if tubes)
        key = e, carriages, side
        if key not in self.slopes:
            self.slopes[key] = position_slopes(e, carriages, side=side)
        return self.slopes[key]

    def fastest(self, rates: Array, threshold: float) -> tuple[Array, float]:
        """(B,) upper bounds on the tip speed in links, m/s, and the largest exact tip speed computed, m/s.

        `rates` (2, B) bound the second and third derivative of the tip. J is computed where the bound without it is
        above a `threshold`, m/s.
        """
        if not self.links:
            return np.zeros(0), 0.0
        h, third, speed = self.passed, rates[1], self.speed
        wrong = self.wrong
        # With |v'| <= a, v differs from its mean over h by a h / 2 at most: at an end, with v' = a throughout.
        plain = np.minimum(speed + rates[0] * h / 2 + wrong, [link.fastest for link in self.links])
        # In the middle the second derivative cancels, and the third one leaves h^2 / 24.
        middle = speed + third * h**2 / 24 + wrong
        # From the middle of a link to that of the next, by the joint path instead of time, since rates may differ.
        pace = self.pace
        path, slope, slope_tt = h * pace, middle / pace, third / pace**3
        length, third_path = (path[1:] + path[:-1]) / 2, np.maximum(slope_tt[1:], slope_tt[:-1])
        inner = np.maximum(slope[1:], slope[:-1]) + third_path * length**2 / 8
        inner = np.where(self.alike, inner, np.inf)
        sides = np.stack([np.append(np.inf, inner), np.append(inner, np.inf)]) * pace
        bound, attained = np.minimum(plain, sides.max(0)), 0.0
        enough = speed + HERMITE * third * h**2 <= threshold
        for k in np.flatnonzero((bound > threshold) & np.isfinite(third)).tolist():
            ends: list[Array | None] = [None, None]
            # The side without a bound first: J is necessary there, and may make the other side unnecessary.
            for side in np.argsort(np.isfinite(sides[:, k]), kind="stable").tolist():
                missing = not np.isfinite(sides[side, k])
                if not missing and (not enough[k] or min(plain[k], sides[:, k].max()) <= threshold):
                    break
                ends[side] = end = self.velocity(k + side, k)
                end_speed = 0.0 if end is None else float(np.linalg.norm(end))
                attained = max(attained, end_speed)
                if missing and end is not None:
                    # Linear from the middle to the end, h / 2 away, but for third (h / 2)^2 / 8.
                    sides[side, k] = max(middle[k], end_speed) + third[k] * h[k] ** 2 / 32
            if ends[0] is not None and ends[1] is not None:
                # An error of the mean changes the cubic's velocity by 6 x (1 - x) <= 1.5 times itself.
                cubic = fastest_on_cubic(self.chord[k], ends[0], ends[1]) + 1.5 * wrong[k]
                plain[k] = min(plain[k], cubic + HERMITE * third[k] * h[k] ** 2)
        return np.asarray(np.minimum(plain, sides.max(0))), attained


def fastest_on_cubic(mean: Array, start: Array, end: Array) -> float:
    """Upper bound on the speed along a cubic, from its mean velocity (3,) and those at both ends, m/s."""
    x, deviation = np.linspace(0.0, 1.0, SAMPLES + 1)[:, None], mean - (start + end) / 2
    # 6 x (1 - x) has mean 1 and is 0 at both ends: `deviation` makes the mean right. The second derivative is -12
    # `deviation`, which bounds the speed between samples.
    velocity = start + (end - start) * x + 6 * x * (1 - x) * deviation
    return float(np.linalg.norm(velocity, axis=1).max() + 12 * np.linalg.norm(deviation) / (8 * SAMPLES**2))


ACCURACY = 1.2e-5
"""Largest distance of the clearance bound below the smallest measured distance, m."""

MAX_CELLS = 3_000_000
"""Maximum number of space-time cells of the arm. With too few the bound is less sharp, but still valid."""

# A wrong mesh, or numbers of another robot, show at any equilibrium.
VERIFIED, AGREEMENT = 5, 1e-6
"""Number of equilibria to re-integrate; largest difference of a tip from its re-integration, relative to the robot's
length."""


class ProofStatus(StatusEnum):
    """Result of a proof; every value reads as a sentence."""

    PROVED = "the trajectory is proved from end to end"
    OPEN = "the time limit was reached before the proof finished; no violation was found"
    FOLLOWED = "no violation was found at the equilibria of the motion; nothing is proved between them"
    FAULTY = "a requirement is violated or not proved"


@dataclass(frozen=True)
class ProofStatistics:
    """Effort and progress of a proof."""

    equilibria: Annotated[int, "number of equilibria of the proof"]
    followed: Annotated[float, unit("percent"), "part of the motion that was followed"]
    """Fraction of the time up to the last equilibrium."""


@dataclass(frozen=True)
class Paces:
    """Tip speeds and accelerations of a trajectory, and the length of its tip path."""

    largest_rotation_rate: Annotated[float, unit("deg_per_s"), "largest rotation rate of a tube"]
    largest_translation_rate: Annotated[float, unit("mm_per_s"), "largest translation rate of a tube"]
    largest_rotation_acceleration: Annotated[float, unit("deg_per_s2"), "largest rotation acceleration of a tube"]
    largest_translation_acceleration: Annotated[float, unit("mm_per_s2"), "largest translation acceleration of a tube"]
    largest_tip_step: Annotated[float, unit("mm"), "largest step of the tip between equilibria"]
    largest_tip_rate: Annotated[float, unit("mm_per_s"), "proved bound on the speed of the tip at all times"]
    """Infinite where nothing is proved, and under forces that may change."""
    measured_tip_rate: Annotated[float, unit("mm_per_s"), "largest mean speed of the tip between two equilibria"]
    tip_length: Annotated[float, unit("mm"), "length of the path of the tip"]


@dataclass(frozen=True, eq=False)
class Proof(Displayed):
    """Margins, clearance, speeds and faults of a trajectory that was followed again.

    The fields of `paces` and `statistics` are attributes of the proof too: `proof.largest_tip_rate` is
    `proof.paces.largest_tip_rate`.
    """

    snap: Annotated[float | None, key("snap_at_percent"), "position of a snap along the motion"]
    """Fraction of the time, from `find_snap`; None if the branch reaches the end."""
    least_margin: Annotated[float, form(".4f", label="least margin"), "smallest margin"]
    """Smallest margin at the equilibria of the proof; 0 at a snap."""
    least_clearance: Annotated[float, unit("mm"), "proved distance of the arm from obstacles"]
    """Lower bound on the distance between arm and obstacles at all times up to `end`, m. The arm is every point within
    the radius of the outermost tube from the centreline, so it has round ends. Infinite without obstacles, -inf without
    a bound.
    """
    measured_clearance: Annotated[float, unit("mm"), "smallest distance at the checked instants"]
    paces: Paces
    """Speeds, accelerations and path length."""
    reintegration: Annotated[
        float,
        unit("mm"),
        "largest difference of a tip from adaptive re-integration; under a load or of a bundle, the estimated error",
    ]
    statistics: ProofStatistics
    """Effort of the proof."""
    end: Equilibrium
    """The last that was solved."""
    faults: Annotated[tuple[str, ...], "violated or unproved requirements, as text"]
    """Empty for a proved trajectory."""
    open: bool = False
    """True if nothing was refuted before a time limit ended the proof, or no proof exists, as for bundles."""
    forced: ForceBound | None = None
    """Bounds for all rotations and the translations of the trajectory under any tip force up to `max_force`; None
    without one. Margin, faults and clearance then include any such force.
    """
    samples: tuple[Equilibrium, ...] = field(default=(), repr=False)
    """Equilibria at the samples up to `end`."""
    clearance_from: tuple[str, ...] = ()
    """Reference of the clearance for obstacles that are points or open surfaces, as text."""
    real: PathBounds | None = None
    """Bounds on the real robot, estimated; None without a posterior, and where the motion was not followed."""

    largest_rotation_rate, largest_translation_rate = Delegate[float]("paces"), Delegate[float]("paces")
    largest_rotation_acceleration, largest_translation_acceleration = Delegate[float]("paces"), Delegate[float]("paces")
    largest_tip_step, tip_length = Delegate[float]("paces"), Delegate[float]("paces")
    largest_tip_rate, measured_tip_rate = Delegate[float]("paces"), Delegate[float]("paces")
    equilibria, followed = Delegate[int]("statistics"), Delegate[float]("statistics")

    @property
    def value(self) -> float:
        """The least margin of all times."""
        return self.least_margin

    @property
    def status(self) -> ProofStatus:
        """Result of the proof, as a sentence."""
        if self.holds:
            return ProofStatus.PROVED
        if not self.open:
            return ProofStatus.FAULTY
        return ProofStatus.OPEN if self.end.robot.fixed_sections else ProofStatus.FOLLOWED

    @property
    def holds(self) -> bool:
        """True if the trajectory is proved."""
        return not self.faults

    @property
    def clearance_bound(self) -> float:
        """Smallest proved distance of the arm from a body, m."""
        return self.least_clearance


@dataclass(frozen=True, eq=False)
class TrajectoryRequirements:
    """Requirements on a trajectory, as arguments of `verify_trajectory`."""

    bodies: tuple[Obstacle, ...]
    min_margin: float
    clearance: float
    """Required distance of the arm from the bodies, m."""
    rate_limits: RateLimits | None
    limits: JointLimits | None
    max_force: float
    """Largest dead force on the tip, in addition to the load, N."""


@typed
@by_model
@small
def verify_trajectory(  # noqa: PLR0913
    robot: Robot,
    time: ArrayLike,
    rotations: ArrayLike,
    translations: ArrayLike | None = None,
    *,
    start: Equilibrium | None = None,
    obstacles: Sequence[Obstacle] = (),
    min_margin: float = 0.0,
    clearance: float = 0.0,
    rate_limits: RateLimits | None = None,
    limits: JointLimits | None = None,
    time_limit: float = LONG_TIME_LIMIT,
    max_force: float = 0.0,
    load: Load | None = None,
) -> Proof:
    """Proof or faults of any trajectory, followed from its start; joint values are linear between samples.

    Args:
        time: (T,) s, increasing.   rotations, translations: (T, n) rad and m; translations default to home.
        start: stable equilibrium at the first sample; by default that of `forward_kinematics`.
        obstacles, min_margin, clearance (m), rate_limits, limits: requirements. By default rates are not limited.
            Default joint limits are those of the robot, else those of its lengths with free rotations.
        time_limit: s; one hour by default. Parts that are unproved at its end are a fault: `.open`, `.followed`.
        max_force: N; margin and clearance then include any dead force on the tip up to that size, in addition to the
            load. One bound for all rotations shows it (see `snap_free_certificate`, `deflection_bound`).
        load: constant external load; a start without it is first loaded. The proof is that of the loaded robot, for
            weight and for forces and moments at the tip, at points and on stretches, in fixed axes. For other loads the
            equilibria are computed, and the parts between them are reported as not proved.

    Raises:
        InputError: tables of wrong shape or with numbers that are not finite, times that do not increase, or an
            unstable start or one at other joint values. A force on a robot without a proof for it; a load on an
            eccentric robot, or without an energy. A `max_force` together with a load per length that is a function.
        SolveError: there is no stable equilibrium at the first sample.

    Examples:
        >>> import numpy as np
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> proof = tubeopt.verify_trajectory(robot, [0, 10], [[0, 0, 0], np.radians([270, 0, 0])])
        >>> proof.holds
        False
    """
    clock = Clock(positive("time_limit", time_limit))
    check_robot(robot)
    bodies = checked_obstacles(obstacles)
    instance("limits", limits, JointLimits, optional=True)
    instance("rate_limits", rate_limits, RateLimits, optional=True)
    instance("start", start, Equilibrium, optional=True)
    if max_force and not robot.fixed_sections:
        raise InputError("max_force is given; nothing is proved of bundles under forces that may change")
    alpha, shift = checked_waypoints(robot, rotations, translations)
    t = _times(time, len(alpha))
    if finite("min_margin", min_margin) >= 1:
        raise InputError(f"min_margin is {min_margin:g}; it must be less than 1")
    typical_length("clearance", clearance, TYPICAL_CLEARANCE, zero=True)
    positive("max_force", max_force, zero=True)
    first = _first(robot, start, (alpha[0], shift[0]), load)
    requirements = TrajectoryRequirements(bodies, min_margin, clearance, rate_limits, limits, max_force)
    return proved(first, t, np.concatenate([alpha, shift], axis=1), requirements, clock)


def proved(first: Equilibrium, t: Array, joints: Array, requirements: TrajectoryRequirements, clock: Clock) -> Proof:
    """Proof of a trajectory of joint values (T, 2n) at times t (T,), s, from an equilibrium at the first."""
    robot, load, (alpha, shift) = first.robot, first.load, np.split(joints, 2, axis=1)
    forced = under_any_force(robot, shift, requirements.max_force, load) if requirements.max_force else None
    deflection = forced.deflection if forced is not None and math.isfinite(forced.deflection) else 0.0
    # A force may move the arm closer to bodies by its deflection.
    target = ClearanceTarget(requirements.clearance + deflection, ACCURACY, MAX_CELLS)
    verifier = TrajectoryVerifier(robot, scene_of(requirements.bodies), target, clock, load)
    limits = requirements.rate_limits
    tip_limit = math.inf if limits is None or limits.tip is None else limits.tip
    trace = follow(verifier, first, t, joints)
    pace = paced(verifier, trace.links, float(t[-1] - t[0]), tip_limit)
    # Violations of requirements, then requirements that are not proved.
    faults, unproved = _branch_faults(verifier, trace, requirements.min_margin, t)
    unproved += _tip_faults(pace, tip_limit, pushed=forced is not None)
    if forced is not None:
        unproved += _force_faults(forced, requirements.min_margin)
    unfinished = bool(unproved) and (verifier.clock.over or not robot.fixed_sections)
    steps = [step.equilibrium for step in trace.steps]
    reintegration = _again([steps[k] for k in np.unique(np.linspace(0, len(steps) - 1, VERIFIED).astype(int))])
    if reintegration > AGREEMENT * verifier.length:
        faults.append(f"re-integration moves the tip by {reintegration * 1e3:.3g} mm")
    # Faults of the table itself.
    space, rates = joint_range(robot, requirements.limits), [rates_of(t, values) for values in (alpha, shift)]
    faults += out_of_range(space, alpha, shift)
    if limits is not None:
        faults += too_fast(space, rates, pace.measured, limits)
    turning, moving = ([float(each.max(initial=0.0)) for each in kind] for kind in rates)
    tip_steps = np.linalg.norm(np.diff([e.tip_position for e in steps], axis=0), axis=1)
    proof = Proof(
        snap=trace.snap,
        least_margin=trace.margin,
        least_clearance=trace.clearance,
        measured_clearance=trace.measured,
        paces=Paces(
            largest_rotation_rate=turning[0],
            largest_translation_rate=moving[0],
            largest_rotation_acceleration=turning[1],
            largest_translation_acceleration=moving[1],
            largest_tip_step=float(tip_steps.max(initial=0.0)),
            largest_tip_rate=pace.bound,
            measured_tip_rate=pace.measured,
            tip_length=float(tip_steps.sum()),
        ),
        reintegration=reintegration,
        statistics=ProofStatistics(verifier.count + 1, trace.steps[-1].at),
        end=steps[-1],
        faults=(*faults, *unproved),
        open=unfinished and not faults,
        samples=_at_samples(trace.steps, t),
        clearance_from=verifier.scene.stands_for,
    )
    return proof if forced is None else _under_force(proof, forced)


def _first(robot: Robot, start: Equilibrium | None, joints: tuple[Array, Array], load: Load | None) -> Equilibrium:
    """Stable equilibrium at the first joint values, under the load."""
    if load is not None:
        check_load(robot, load, tuple(joints[1].tolist()))
    first = forward_kinematics(robot, *joints, load=load) if start is None else start
    if not first.stable:
        raise InputError(f"start has margin {first.margin:.3g}; it must be a stable equilibrium (margin above 0)")
    offset = np.concatenate([first.rotations - joints[0], first.translations - joints[1]])
    if np.abs(offset).max() > 1e-6:
        raise InputError("start is at other joint values than the first sample; they must be the same")
    if offset.any() or first.load != load:  # within round-off of a file, or yet to be loaded
        first = forward_kinematics(robot, *joints, load=load, start=first)
    return first


def _force_faults(forced: ForceBound, min_margin: float) -> list[str]:
    """Messages on margins and clearances that some tip force can violate."""
    size = f"{forced.max_force * 1e3:g} mN"
    if forced.margin <= 0:
        return [f"not proved: nothing shows that no force of up to {size} on the tip snaps or buckles the robot"]
    if forced.margin < min_margin:
        shown = f"{forced.margin:.4g} is shown under any force of up to {size} on the tip"
        return [f"not proved: of the margin of {min_margin:g} only {shown}"]
    return []


def _tip_faults(pace: Pace, limit: float, *, pushed: bool) -> list[str]:
    """Messages on tip speeds above their limit; empty without a limit."""
    allowed = f"it must be at most {limit * 1e3:.4g} mm/s"
    if limit == math.inf or pace.measured > limit * (1 + SLACK):
        return []
    if pushed:
        return [f"not proved: nothing bounds the speed of the tip while a force changes; {allowed}"]
    if pace.bound == math.inf:
        return [f"not proved: nothing bounds the speed of the tip; {allowed}"]
    if pace.bound > limit * (1 + SLACK):
        return [f"not proved: of the speed of the tip only {pace.bound * 1e3:.5g} mm/s are shown; {allowed}"]
    return []


def _under_force(proof: Proof, forced: ForceBound) -> Proof:
    """Proof with margin and clearance reduced by any tip force."""
    shown = forced.margin > 0
    return replace(
        proof,
        forced=forced,
        paces=replace(proof.paces, largest_tip_rate=math.inf),
        least_margin=min(proof.least_margin, forced.margin),
        least_clearance=proof.least_clearance - forced.deflection if shown else -math.inf,
        measured_clearance=proof.measured_clearance - forced.deflection if shown else -math.inf,
    )


def _times(time: ArrayLike, count: int) -> Array:
    try:
        t = np.array(time, dtype=float)
    except (TypeError, ValueError):
        raise InputError("time must be numbers, one per sample") from None
    if t.shape != (count,):
        raise InputError(f"time has shape {t.shape}; it must be one number for each of the {count} samples")
    if not np.isfinite(t).all():
        k = int(np.argmin(np.isfinite(t)))
        raise InputError(f"time is {t[k]} at sample {k + 1}; it must be finite")
    if (np.diff(t) <= 0).any():
        k = int(np.argmax(np.diff(t) <= 0))
        raise InputError(
            f"time is {t[k + 1]:g} s at sample {k + 2}, after {t[k]:g} s; it must increase from sample to sample"
        )
    return t


def _branch_faults(
    verifier: TrajectoryVerifier, trace: TrajectoryTrace, min_margin: float, time: Array
) -> tuple[list[str], list[str]]:
    """Messages on violated, and on unproved, requirements of branch, margin and clearance."""
    faults, unproved, required = [], [], verifier.target.clearance
    if trace.snap is not None:
        at = f"{100 * trace.snap:.3g} % of the trajectory ({time[0] + trace.snap * np.ptp(time):.3g} s)"
        flutter = f"the robot begins to flutter at {at} or a little later: its equilibrium becomes unstable"
        faults.append(flutter if verifier.flutters else f"the robot snaps at {at}")
    elif trace.margin < min_margin:
        faults.append(f"the margin falls to {trace.margin:.4g}; it must be at least {min_margin:g}")
    reached = trace.steps[-1].at
    if trace.snap is None and reached < 1:
        followed = f"when {100 * reached:.4g} % of it was followed"
        needed = f"more than {verifier.count} equilibria would be needed"
        why = "the time limit was reached" if verifier.clock.over else needed
        unproved.append(f"not proved: {why} {followed}")
    elif trace.unproved and verifier.unprovable:
        unproved.append(f"not proved: {verifier.unprovable}")
    elif trace.unproved:
        a, b = trace.unproved[0]
        for step in trace.steps:
            if a <= step.at <= b and (sure := verifier.sure_margin(step.equilibrium)) <= 0:
                at = f"{100 * step.at:.4g} % of the trajectory the margin is {step.equilibrium.margin:.3g}"
                condition = f"the least eigenvalue of the symmetric part of the linearised equations is {sure:.3g}"
                why = f"not proved: at {at}, but {condition}; a proof under moments needs it above 0"
                return faults, [*unproved, why]
        where = f"{100 * a:.8g} % and {100 * b:.8g} % of the trajectory"
        unproved.append(f"not proved: nothing shows that one stable branch joins {where}")
    if trace.measured < required:
        shown = trace.measured * 1e3
        faults.append(f"the arm comes as close as {shown:.4g} mm; it must keep {required * 1e3:.6g} mm")
    elif -math.inf < trace.clearance < required:
        shown = trace.clearance * 1e3
        unproved.append(f"not proved: of the clearance of {required * 1e3:.6g} mm only {shown:.4g} mm are shown")
    return faults, unproved


def _again(equilibria: Sequence[Equilibrium]) -> float:
    """Largest difference of a tip from its re-integration, m; under a load or of a bundle the largest estimate."""
    if equilibria[0].load is not None or not equilibria[0].robot.fixed_sections:
        return max(e.tip_error for e in equilibria)
    return max(check.tip_position for check in verifications(equilibria))


def _at_samples(steps: Sequence[TraceStep], t: Array) -> tuple[Equilibrium, ...]:
    """Equilibria at the times (T,) of the samples, until the last computed step."""
    at = np.array([step.at for step in steps])
    fraction = (t - t[0]) / ((t[-1] - t[0]) or 1.0) if len(t) > 1 else np.ones(1)
    # Half of the shortest link earlier: round-off must not choose the step after a sample.
    nearest = np.searchsorted(at, fraction - SHORTEST / 2)
    reached = nearest < len(at)
    return tuple(steps[k].equilibrium for k in nearest[reached])
