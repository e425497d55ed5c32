"""How hard a plan is made, beyond the search of a way: what a user may want to change, as documented fields."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ..errors import Settings
from ..inverse.joint_path_settings import PathSearch


@dataclass(frozen=True)
class Shares(Settings):
    """Division of the time limit; fractions of it unless stated otherwise."""

    goals: float = 0.6
    """Time after which no further starts are tried for joint values of a tip goal."""
    search: float = 0.9
    """Time after which the search ends, so that the result can be reported in time."""
    report: float = 0.35
    """Largest time reserved for the report."""
    report_seconds: float = 2.0
    """Smallest time reserved for the report, within that limit, s."""
    postures_seconds: float = 15.0
    """Time, s, below which only the nearest posture for a tip goal is tried."""
    nearest: float = 0.4
    """Fraction of the search time for the nearest posture, if others follow."""
    roadmap: float = 0.3
    """Fraction of the search time for a roadmap, which comes first."""
    entry: int = 4
    """While more than `entry` base poses remain, each gets 1/`entry` of the remaining time."""
    late_seconds: float = 0.25
    """Largest overrun of the time limit for following an unproved motion to its end, s."""


@dataclass(frozen=True)
class GoalSearch(Settings):
    """Choice of joint values where several meet the goal."""

    most: int = 12
    """Maximum number of candidates, nearest to the start first."""
    turns: int = 3
    """Maximum number of full turns of one tube that are tried, nearest to the start first."""
    places: int = 2
    """Number of points of a region for which other postures are searched."""
    apart: float = 1e-3
    """Ends closer than this in every coordinate, in units of the joints' scales, are one."""
    tubes: int = 3
    """Largest number of tubes for which all equilibria at joint values are searched in any case. For more, `seconds`
    must be left; otherwise that of forward kinematics is tried.
    """
    seconds: float = 30.0
    """Remaining time, s, needed to search all equilibria of more tubes, because that cannot be interrupted."""
    points: int = 8
    """Roadmap nodes, nearest tip first, that start the inverse kinematics of the goal."""
    answers: int = 2
    """Number of solutions that suffice for short paths; a second one shortens them by a tenth."""


@dataclass(frozen=True)
class ReachSearch(Settings):
    """Settings for unreachable places and for the reached fraction of places."""

    starts: int = 8
    """Number of starts of the test for unreachable places: half of them nearest in the table, half spread."""
    steps: int = 20
    """Most of Gauss-Newton from each."""
    longest_step: float = 0.4
    """Largest change of a coordinate, in units of the joints' scales."""
    near: float = 0.02
    """Share of the robot's length: who comes closer than this is not refused."""
    share_points: int = 30
    """Number of roadmap nodes with the nearest tips that are considered per place."""
    share_ways: int = 4
    """Number of reachable nodes that approach a place."""
    share_steps: int = 15
    """Most of Gauss-Newton from each."""
    close: float = 0.01
    """Miss, m, beyond which a place counts nothing in the score of a region."""


@dataclass(frozen=True)
class RoadmapSearch(Settings):
    """Settings for drawing and connecting a roadmap."""

    neighbours: int = 10
    """Nearest points that each point is joined with."""
    drawn: int = 512
    """Points that are drawn at once."""


@dataclass(frozen=True)
class Smoothing(Settings):
    """Start, duration and knots of the smoothing of a path.

    Raises:
        InputError: a count that is no whole number of at least 1 (0 for `refinements`), another number that is not
            positive.
    """

    seconds: float = 20.0
    """Maximum duration, s."""
    share: float = 0.5
    """Maximum fraction of the remaining time; the proof needs the rest."""
    least_seconds: float = 1.0
    """Remaining time below which smoothing is skipped, s."""
    scanned_seconds: float = 2.5
    """Maximum duration for length among scanned obstacles, s; rounded corners are rarely longer there."""
    intervals: int = 24
    """Initial number of intervals between knots."""
    refinements: int = 3
    """Times that knots are added where the motion between them is not allowed."""
    twist: float = 0.3
    """Change of a tip rotation between knots that is always allowed, rad."""
    margin: float = 3e-3
    """Beyond that of the search, which knots keep at first for what is between them."""
    reach: float = 0.1
    """Distance of knots from obstacles, as a fraction of the longest tube, within which these count."""
    apart: float = 0.1
    """Distance from a point of the chart, in units of the scales, beyond which an equilibrium is on another branch."""
    left: float = 1e-5
    """Reserve of the margin (and of the clearance, m) at the largest sample distance; it exceeds the error between
    samples and falls with the square of that distance.
    """
    worth: float = 0.02
    """Relative excess of a path over the straight line that justifies smoothing for length in free space."""
    worth_among_bodies: float = 0.1
    """Relative excess that justifies smoothing among obstacles, where it takes twice as long."""
    same_length: float = 2e-3
    """Largest relative difference of equal lengths and durations."""

    _none: ClassVar[tuple[str, ...]] = ("refinements",)


@dataclass(frozen=True)
class PathSolver(Settings):
    """Settings of the program that smooths a path."""

    operations: int = 150_000
    """Largest number of operations of one equilibrium; about six tubes. Derivatives take too long beyond."""
    build: float = 5e-5
    """Seconds that it takes at most on most machines to build the program, which nothing can cut short, and to begin to
    solve it: per operation of an equilibrium."""
    build_body: float = 5e-2
    """Time to build the program per obstacle, s."""
    build_node: float = 1e-6
    """Time to build the program per node of a distance table, s."""
    fields: float = 1e-3
    """Least determinant of the Jacobi fields, which begin as 1."""
    sharpness: float = 400.0
    """Sharpness of the smooth minimum distance, over the length of the robot: it is at most log(points) / 400 too
    small.
    """
    splits: int = 4
    """Points per step of the arm at which its distance from bodies is measured."""
    tips: float = 0.05
    """Weight of the motion of the tip rotations beside that of the joints, in the length."""


@dataclass(frozen=True)
class Rounding(Settings):
    """Settings for rounding the corners of a path.

    Raises:
        InputError: a count that is no whole number (of at least 0), another number that is not positive.
    """

    seconds: float = 5.0
    """Maximum duration, s."""
    share: float = 0.3
    """Maximum fraction of the time that smoothing leaves."""
    spacings: tuple[float, ...] = (0.4, 0.2, 0.1, 0.05, 0.02, 0.01)
    """Spacings of the polyline points before rounding, in units of the joint scales, tried in turn."""
    bend: float = 0.02
    """Largest second difference of joint values, in units of their scales, at which curves still stay close to the
    points.
    """
    halvings: int = 4
    """Times that these points are set twice as close at most."""

    _none: ClassVar[tuple[str, ...]] = ("halvings",)


@dataclass(frozen=True)
class Timing(Settings):
    """Settings for timing a curve and sampling the motion."""

    cells: int = 100
    """Number of cells of the first timing grid, evenly spaced."""
    fine_cells: int = 500
    """Number of cells of the second grid, with equal durations."""
    rate_safety_factor: float = 0.9995
    """Safety factor on the rate limits: the tip speed is only checked on a grid, and the ends of the path are made
    exact.
    """
    samples: int = 100
    """Minimum number of samples."""
    samples_of_tip: int = 300
    """Minimum number of samples with a limit of the tip speed; that speed changes between samples."""
    most_samples: int = 4000
    """Maximum number of samples."""
    sample_step: float = 0.04
    """Largest change of a joint between samples, in units of its scale."""
    max_overspeed: float = 1.1
    """Largest ratio of the tip speed to its limit that is repaired by slowing the motion down."""


@dataclass(frozen=True)
class ProofSearch(Settings):
    """Spacing of the equilibria of a proof, and effort of the bounds between them.

    Raises:
        InputError: a count that is no whole number of at least 1 (0 for `halvings`), another number that is not
            positive.
    """

    turn: float = 0.04
    """Largest of a joint between two equilibria, to begin with, rad."""
    shift: float = 0.004
    """Largest change of a translation between two equilibria, as a fraction of the longest tube."""
    equilibria: int = 20_000
    """Maximum number of equilibria."""
    halvings: int = 4
    """Maximum number of bisections of an interval without a bound on the rotation between arm samples."""
    accuracy: float = 1.2e-5
    """Largest distance of the clearance bound below the smallest measured distance, m."""
    cells: int = 3_000_000
    """Maximum number of space-time cells of the arm. With too few the bound is less sharp, but still valid."""
    arms_accuracy: float = 5e-5
    """The `accuracy` for the distance of two arms, m."""
    arms_cells: int = 4_000_000
    """The `cells` for two arms."""
    arms_rounds: int = 12
    """Times that intervals in which nothing sharp is shown of two arms are halved."""
    verified: int = 5
    """Equilibria that are integrated once more."""
    agreement: float = 1e-6
    """Largest difference of a tip from its re-integration, over the length of the robot."""
    seconds: float = 0.1
    """Typical upper limit of the time of a proof without `sample_seconds`, s."""
    sample_seconds: float = 1e-3
    """Typical upper limit of the time of a proof per sample of the motion, s."""

    _none: ClassVar[tuple[str, ...]] = ("halvings",)


@dataclass(frozen=True)
class EntrySearch(Settings):
    """Settings of the random arms that rank base poses."""

    arms: int = 1024
    """Number of random joint values."""
    nearest: int = 12
    """Number of arms considered per goal position, nearest first."""
    points: int = 48
    """Number of points per arm."""


@dataclass(frozen=True)
class ArmsSearch(Settings):
    """Settings for the coordination of several robots."""

    delays: int = 41
    """Number of delays tried for a robot, from none to the rest of all earlier ones."""
    instants: int = 80
    """Number of instants of a motion that determine delays."""
    points: int = 64
    """Number of points per arm that determine delays."""
    room: float = 3e-4
    """Reserve of the distance between moving arms, m, for the error between instants and points. It grows after a
    failed proof.
    """
    rest_chord: float = 2e-3
    """Longest piece of an arm at rest that is taken as straight, m."""
    rest_points: int = 100
    """Along an arm at rest, between which its distance from another is bounded."""


@dataclass(frozen=True)
class PlanEffort(PathSearch):
    """Settings of the search, smoothing, timing and proof of a plan; a field of `PlanOptions`."""

    shares: Shares = Shares()
    """Division of the time limit."""
    goals: GoalSearch = GoalSearch()
    """Choice of joint values where several meet the goal."""
    reach: ReachSearch = ReachSearch()
    """Settings for unreachable goals and for the reached fraction of places."""
    roadmap: RoadmapSearch = RoadmapSearch()
    """Settings of the roadmap."""
    smoothing: Smoothing = Smoothing()
    """Start, duration and knots of the smoothing."""
    program: PathSolver = PathSolver()
    """Settings of the program that smooths a path."""
    rounding: Rounding = Rounding()
    """Settings for rounding the corners of a path."""
    timing: Timing = Timing()
    """Settings for timing a curve and sampling the motion."""
    proof: ProofSearch = ProofSearch()
    """Settings of the proof."""
    entry: EntrySearch = EntrySearch()
    """Settings for comparing positions of the base plate."""
    arms: ArmsSearch = ArmsSearch()
    """Settings for the coordination of several robots."""
    attempts: int = 3
    """Maximum number of attempts: after a failed proof, a plan is made again with more clearance and other random
    numbers.
    """
    force_room: float = 1.05
    """Safety factor on the displacement of the arm by a force, known at the ends of a motion."""


DEFAULT_EFFORT = PlanEffort()
DEFAULT_PROOF = ProofSearch()
