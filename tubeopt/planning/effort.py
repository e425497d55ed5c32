"""How hard a plan is made, beyond the search of a way: what a user may want to change, as documented fields."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ..errors import Settings
from ..inverse.joint_path_settings import PathSearch


@dataclass(frozen=True)
class Shares(Settings):
    """How the time limit is divided."""

    goals: float = 0.6
    """Of it, after which joint values for a goal of the tip are tried from no further start."""
    search: float = 0.9
    """Of it, after which the search ends, so that what was found can be reported in time."""
    report: float = 0.35
    """Of it, that is kept for the report at most."""
    report_seconds: float = 2.0
    """For the report at least, s, within that."""
    postures_seconds: float = 15.0
    """Below which only the nearest posture for a goal of the tip is tried, s."""
    nearest: float = 0.4
    """Of the time for the search, for the nearest posture where others are tried after it."""
    roadmap: float = 0.3
    """Of the time for the search, which a roadmap is given first."""
    entry: int = 4
    """Part of the time that is left, as its reciprocal, which each place of the plate gets to which more than so many
    others follow."""
    late_seconds: float = 0.25
    """Beyond the time limit at most, s, in which what a proof did not come to is followed, so that it can be
    returned."""


@dataclass(frozen=True)
class GoalSearch(Settings):
    """Which joint values are tried where several meet what is asked for."""

    most: int = 12
    """Tried at most, the nearest to the start first."""
    turns: int = 3
    """Whole turns of one tube that are tried at most, the nearest to the start."""
    places: int = 2
    """Of a region whose other postures are looked for."""
    apart: float = 1e-3
    """Ends closer than this in every coordinate, in units of the joints' scales, are one."""
    tubes: int = 3
    """Equilibria at joint values are all looked for with so few tubes, or while `seconds` are left; else the one that
    forward kinematics finds is tried."""
    seconds: float = 30.0
    """Left of the time, s, from which that is done for more tubes too: nothing can cut it short."""
    points: int = 8
    """Of a roadmap from which joint values for a goal of the tip are looked for, those with the nearest tips first."""
    answers: int = 2
    """That are enough where ways shall be short: a second one shortens them by a tenth."""


@dataclass(frozen=True)
class ReachSearch(Settings):
    """Whether places are out of reach, and what share of them is reached."""

    starts: int = 8
    """From which it is tried whether a place is out of reach: of those in the table, the nearest half, and half that
    differ."""
    steps: int = 20
    """Most of Gauss-Newton from each."""
    longest_step: float = 0.4
    """Largest change of a coordinate, in units of the joints' scales."""
    near: float = 0.02
    """Share of the robot's length: who comes closer than this is not refused."""
    share_points: int = 30
    """Of a roadmap, those with the nearest tips, that are looked at for each place."""
    share_ways: int = 4
    """Of those to which ways lead, from which the place is approached."""
    share_steps: int = 15
    """Most of Gauss-Newton from each."""
    close: float = 0.01
    """Distance, m, from which on a place that is missed counts nothing in the score of a region."""


@dataclass(frozen=True)
class RoadmapSearch(Settings):
    """How a roadmap is drawn and joined."""

    neighbours: int = 10
    """Nearest points that each point is joined with."""
    drawn: int = 512
    """Points that are drawn at once."""


@dataclass(frozen=True)
class Smoothing(Settings):
    """When a way is smoothed, for how long, from which knots.

    Raises:
        InputError: a count that is no whole number of at least 1 (0 for `refinements`), another number that is not
            positive.
    """

    seconds: float = 20.0
    """At most, s."""
    share: float = 0.5
    """Of the time that is left, at most: the proof needs the rest."""
    least_seconds: float = 1.0
    """With fewer of which none is begun, s."""
    scanned_seconds: float = 2.5
    """At most, s, for length among scans, where rounded corners are rarely longer."""
    intervals: int = 24
    """Between knots at first."""
    refinements: int = 3
    """Times that knots are added where the motion between them is not allowed."""
    twist: float = 0.3
    """Change of a tip rotation between knots that is always allowed, rad."""
    margin: float = 3e-3
    """Beyond that of the search, which knots keep at first for what is between them."""
    reach: float = 0.1
    """Distance of knots from bodies, as a share of the longest tube, up to which these may matter."""
    apart: float = 0.1
    """Distance from a point of the chart, in units of the scales, beyond which an equilibrium is on another branch."""
    left: float = 1e-5
    """Of margin (and, m, of clearance), where samples are as far apart as they may be: more than what lies between
    them can be off. It falls with the square of their distance."""
    worth: float = 0.02
    """Share of its length by which a way must exceed the straight line to be smoothed for length in free space."""
    worth_among_bodies: float = 0.1
    """The same among bodies, where that takes twice as long."""
    same_length: float = 2e-3
    """Share by which lengths and durations may differ that count as the same."""

    _none: ClassVar[tuple[str, ...]] = ("refinements",)


@dataclass(frozen=True)
class PathSolver(Settings):
    """The program by which a way is smoothed."""

    operations: int = 150_000
    """Of one equilibrium at most, beyond which its derivatives take too long: robots of about six tubes."""
    build: float = 5e-5
    """Seconds that it takes at most on most machines to build the program, which nothing can cut short, and to begin to
    solve it: per operation of an equilibrium."""
    build_body: float = 5e-2
    """The same per obstacle."""
    build_node: float = 1e-6
    """The same per node of a table of distances."""
    fields: float = 1e-3
    """Least determinant of the Jacobi fields, which begin as 1."""
    sharpness: float = 400.0
    """Of the smooth least distance, over the length of the robot: at most log(points) / 400 too small."""
    splits: int = 4
    """Points per step of the arm at which its distance from bodies is measured."""
    tips: float = 0.05
    """Weight of the motion of the tip rotations beside that of the joints, in the length."""


@dataclass(frozen=True)
class Rounding(Settings):
    """How the way as it is becomes a curve, and its corners round.

    Raises:
        InputError: a count that is no whole number (of at least 0), another number that is not positive.
    """

    seconds: float = 5.0
    """At most, s."""
    share: float = 0.3
    """Of the time that smoothing leaves, at most."""
    spacings: tuple[float, ...] = (0.4, 0.2, 0.1, 0.05, 0.02, 0.01)
    """Distances, in units of the joints' scales, of the points of a polyline whose corners are rounded, tried in
    turn."""
    bend: float = 0.02
    """Second difference of joint values, in units of their scales, of points of a motion up to which curves keep close
    to them."""
    halvings: int = 4
    """Times that these points are set twice as close at most."""

    _none: ClassVar[tuple[str, ...]] = ("halvings",)


@dataclass(frozen=True)
class Timing(Settings):
    """How a curve is timed, and the motion sampled."""

    cells: int = 100
    """Of the grid on which a curve is timed, evenly spaced at first."""
    fine_cells: int = 500
    """Then such that they take the same time."""
    rate_safety_factor: float = 0.9995
    """Share of the rates that is used: the tip's speed is taken on the grid, and ends of the path are made exact."""
    samples: int = 100
    """At least."""
    samples_of_tip: int = 300
    """At least where the speed of the tip is limited, which changes on the way from one to the next."""
    most_samples: int = 4000
    """At most."""
    sample_step: float = 0.04
    """Largest change of a joint between samples, in units of its scale."""
    max_overspeed: float = 1.1
    """Over its limit, by which the tip may be too fast between samples of a motion that is then slowed down for it."""


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
    """By which random arms places of the plate are compared."""

    arms: int = 1024
    """Of random joint values."""
    nearest: int = 12
    """Of these, those that are looked at for each place of the goal."""
    points: int = 48
    """Along each."""


@dataclass(frozen=True)
class ArmsSearch(Settings):
    """How several robots leave each other room."""

    delays: int = 41
    """That are tried for a robot beside others, from none to when all before it have come to rest."""
    instants: int = 80
    """Of a motion, by which delays are told."""
    points: int = 64
    """Along an arm, by which they are."""
    room: float = 3e-4
    """To spare between arms that move at a time, m, for what lies between instants and points; more is asked where the
    proof finds a fault."""
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
    """What is kept for how far a force moves the arm, over what is known of the ends of a motion."""


DEFAULT_EFFORT = PlanEffort()
DEFAULT_PROOF = ProofSearch()
