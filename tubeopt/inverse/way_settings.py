"""How hard ways between joint values are searched for: what a user may want to change, as documented fields."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ..errors import Settings


@dataclass(frozen=True)
class WaySearch(Settings):
    """How hard a way between joint values is searched for, smoothed, timed and proved; a field of `PlanOptions`.

    Args:
        translations: sampled in the search for those at which the robot cannot snap.
        detours: by way of them that are tried, the shortest first.
        detour_seconds, detour_share: most seconds, and most of the time that is left, for that; then chance has its
            turn.
        wall_seconds, wall_share: the same for what keeps start and goal apart.
        wall_levels: between start and goal, at which a section that every way crosses is looked at.
        wall_screened: random states by which a section is screened: most have one that is allowed.
        wall_states: on a grid at most; larger sections are not decided.
        wall_doubt: margin that states must lack to count as not allowed: more than the integration is off.
        step_turn, step_joint: largest change, rad, of a tip rotation and of a joint rotation between points of a motion
            that are checked.
        step_shift: the same of a translation, as a share of the longest tube.
        step_halvings: of these steps at most, where little is to spare.
        clearance_slope, margin_slope: clearance, m, and margin that must be to spare per distance from an end, in units
            of the joints' scales: at the end itself nothing, and before steps grow long, as much as anywhere.
        windows, window_points: stretches between points along an arm that are looked at once more, and points in each.
        motion: longest that RRT-Connect tries at once, in units of the joints' scales.
        long_share, reason_share: of the time that is left, for the search by long motions, and for the same where
            something stands against a way; short ones have the rest.
        pocket_share: of that rest, for whether start or goal lie in a closed pocket.
        pocket_states: of a pocket, from which it counts as open.
        pocket_apart: distance, in units of the joints' scales, of states of a pocket that are two.
        pocket_motions: in a row that do not lead on, from which it counts as closed.
        smoothing_seconds, smoothing_share: most seconds, and most of the time that is left, for smoothing: the proof
            needs the rest.
        least_smoothing: seconds, with fewer of which none is begun.
        scanned_seconds: most seconds of smoothing for length among scans, where rounded corners are rarely longer.
        smoothing_intervals: between knots of the smooth motion at first.
        smoothing_refinements: times that knots are added where the motion between them is not allowed.
        smoothing_twist: change, rad, of a tip rotation between knots that is always allowed.
        smoothing_margin: beyond that of the search, which knots keep at first for what is between them.
        smoothing_reach: distance of knots from bodies, as a share of the longest tube, up to which these may matter.
        rounding_seconds, rounding_share: most seconds, and most of the time that smoothing leaves, for rounding the
            corners of the way as it is.
        smoothing_operations: of one equilibrium at most, beyond which its derivatives take too long: robots of about
            six tubes.
        smoothing_build, smoothing_build_body, smoothing_build_node: seconds that it takes at most on most machines to
            build the program, which nothing can cut short, and to begin to solve it: per operation of an equilibrium,
            per obstacle, and per node of a table of distances.
        smoothing_bend: second difference of joint values, in units of their scales, of points of a motion up to which
            curves keep close to them.
        smoothing_halvings: times that these points are set twice as close at most.
        smoothing_apart: distance from a point of the chart, in units of the scales, beyond which an equilibrium is on
            another branch.
        smoothing_fields: least determinant of the Jacobi fields, which begin as 1.
        smoothing_left: of margin (and, m, of clearance), where samples are as far apart as they may be: more than what
            lies between them can be off. It falls with the square of their distance.
        smoothing_sharpness: of the smooth least distance, over the length of the robot: at most log(points) / 400 too
            small.
        smoothing_splits: points per step of the arm at which its distance from bodies is measured.
        smoothing_tips: weight of the motion of the tip rotations beside that of the joints, in the length.
        worth_smoothing, worth_among_bodies: share of its length by which a way must exceed the straight line to be
            smoothed for length: in free space, and among bodies, where that takes twice as long.
        same_length: share by which lengths and durations may differ that count as the same.
        roundings: distances, in units of the joints' scales, of the points of a polyline whose corners are rounded,
            tried in turn.
        goals: joint values, most that are tried where several meet what is asked for, the nearest to the start first.
        goal_turns: whole turns of one tube that are tried.
        goal_share: of the time limit, after which joint values for a goal of the tip are tried from no further start.
        goal_places: of a region whose other postures are looked for.
        goal_apart: ends closer than this in every coordinate, in units of the joints' scales, are one.
        goal_tubes, goal_seconds: equilibria at joint values are all looked for with so few tubes, or while so many
            seconds are left, since nothing can cut that short; else the one that forward kinematics finds is tried.
        goal_points: of a roadmap from which joint values for a goal of the tip are looked for, those with the nearest
            tips first.
        goal_answers: that are enough where ways shall be short: a second one shortens them by a tenth.
        search_share: of the time limit, after which the search ends, so that what was found can be reported in time.
        report_seconds, report_share: kept for the report at least, s, but no more than this share of the time limit.
        postures_seconds: below which only the nearest posture for a goal of the tip is tried.
        nearest_share: of the time for the search, for the nearest posture where others are tried after it.
        roadmap_share: of the time for the search, which a roadmap is given first.
        roadmap_neighbours: nearest points that each point of a roadmap is joined with.
        roadmap_drawn: points that are drawn at once.
        attempts: times that a plan whose proof finds a fault is made again with more room and other random numbers.
        timing_cells, timing_fine_cells: of the grid on which a curve is timed, evenly spaced at first, then such that
            they take the same time.
        timing_prudence: share of the rates that is used: the tip's speed is taken on the grid, and ends of the path are
            made exact.
        samples, samples_of_tip, most_samples: of a trajectory at least; at least where the speed of the tip is limited,
            which changes on the way from one to the next; and at most.
        sample_step: largest change of a joint between samples, in units of its scale.
        tip_hurry: share of its limit by which the tip may be too fast between samples of a motion that is then slowed
            down for it.
        late_seconds: beyond the time limit at most, in which what a proof did not come to is followed, so that it can
            be returned.
        force_room: what is kept for how far a force moves the arm, over what is known of the ends of a motion.
        proof_turn: largest turn (rad) of a joint between two equilibria of the proof, to begin with.
        proof_shift: the same of a translation, as a share of the longest tube.
        proof_equilibria: at most.
        proof_seconds, proof_sample_seconds: that a proof takes at most on most machines: in all, and per sample of the
            motion.
        proof_accuracy: how far (m) the bound of the clearance may lie below the least distance that was measured.
        proof_arms_accuracy: the same (m) of the distance of two arms.
        proof_cells, proof_arms_cells: of the arm, or of two, over time that are looked at; where they do not suffice
            the bound is less sharp, and holds.
        proof_arms_rounds: times that intervals in which nothing sharp is shown of two arms are halved.
        proof_verified: equilibria that are integrated once more.
        proof_agreement: largest difference of a tip from its re-integration, over the length of the robot.
        proof_halvings: of an interval in which nothing bounds how tubes turn between samples along the arm, before it
            is given up.
        reach_starts: from which it is tried whether a place is out of reach: of those in the table, the nearest half,
            and half that differ.
        reach_steps: most Gauss-Newton steps from each.
        reach_longest_step: largest change of a coordinate per step, in units of the joints' scales.
        reach_near: share of the robot's length: who comes closer than this is not refused.
        share_points: of a roadmap, those with the nearest tips, that are looked at for each place of a share of reach.
        share_ways: of those to which ways lead, from which the place is approached.
        share_steps: most Gauss-Newton steps from each.
        region_close: distance (m) from which on a place that is missed counts nothing in the score of a region.
        rest_points: along an arm at rest, between which its distance from another is bounded.
        entry_arms: random arms by which places of the plate are compared.
        entry_nearest: of these, those that are looked at for each place of the goal.
        entry_points: along each.
        entry_share: part of the time that is left, as its reciprocal, which each place gets to which more than so many
            others follow.
        delays: that are tried for a robot beside others, from none to when all before it have come to rest.
        delay_instants, delay_points: of a motion, and along an arm, by which delays are told.
        delay_room: distance (m) to spare between arms that move at a time, for what lies between instants and points;
            more is asked where the proof finds a fault.
        rest_chord: longest piece (m) of an arm at rest that is taken as straight.

    Raises:
        InputError: a count that is no whole number of at least 1 (0 for `step_halvings`, `smoothing_refinements`,
            `smoothing_halvings` and `proof_halvings`), another number that is not positive.
    """

    translations: int = 160
    detours: int = 24
    detour_seconds: float = 6.0
    detour_share: float = 0.3
    wall_seconds: float = 5.0
    wall_share: float = 0.15
    wall_levels: int = 9
    wall_screened: int = 48
    wall_states: int = 20_000
    wall_doubt: float = 2e-3
    step_turn: float = 0.15
    step_joint: float = 0.35
    step_shift: float = 0.02
    step_halvings: int = 4
    clearance_slope: float = 3e-4
    margin_slope: float = 0.02
    windows: int = 12
    window_points: int = 9
    motion: float = 1.2
    long_share: float = 0.5
    reason_share: float = 0.3
    pocket_share: float = 0.3
    pocket_states: int = 60
    pocket_apart: float = 0.02
    pocket_motions: int = 1500
    smoothing_seconds: float = 20.0
    smoothing_share: float = 0.5
    least_smoothing: float = 1.0
    scanned_seconds: float = 2.5
    smoothing_intervals: int = 24
    smoothing_refinements: int = 3
    smoothing_twist: float = 0.3
    smoothing_margin: float = 3e-3
    smoothing_reach: float = 0.1
    rounding_seconds: float = 5.0
    rounding_share: float = 0.3
    smoothing_operations: int = 150_000
    smoothing_build: float = 5e-5
    smoothing_build_body: float = 5e-2
    smoothing_build_node: float = 1e-6
    smoothing_bend: float = 0.02
    smoothing_halvings: int = 4
    smoothing_apart: float = 0.1
    smoothing_fields: float = 1e-3
    smoothing_left: float = 1e-5
    smoothing_sharpness: float = 400.0
    smoothing_splits: int = 4
    smoothing_tips: float = 0.05
    worth_smoothing: float = 0.02
    worth_among_bodies: float = 0.1
    same_length: float = 2e-3
    roundings: tuple[float, ...] = (0.4, 0.2, 0.1, 0.05, 0.02, 0.01)
    goals: int = 12
    goal_turns: int = 3
    goal_share: float = 0.6
    goal_places: int = 2
    goal_apart: float = 1e-3
    goal_tubes: int = 3
    goal_seconds: float = 30.0
    goal_points: int = 8
    goal_answers: int = 2
    search_share: float = 0.9
    report_seconds: float = 2.0
    report_share: float = 0.35
    postures_seconds: float = 15.0
    nearest_share: float = 0.4
    roadmap_share: float = 0.3
    roadmap_neighbours: int = 10
    roadmap_drawn: int = 512
    attempts: int = 3
    timing_cells: int = 100
    timing_fine_cells: int = 500
    timing_prudence: float = 0.9995
    samples: int = 100
    samples_of_tip: int = 300
    most_samples: int = 4000
    sample_step: float = 0.04
    tip_hurry: float = 1.05
    late_seconds: float = 0.25
    force_room: float = 1.05
    proof_turn: float = 0.04
    proof_shift: float = 0.004
    proof_equilibria: int = 20_000
    proof_seconds: float = 0.1
    proof_sample_seconds: float = 1e-3
    proof_accuracy: float = 1.2e-5
    proof_arms_accuracy: float = 5e-5
    proof_cells: int = 3_000_000
    proof_arms_cells: int = 4_000_000
    proof_arms_rounds: int = 12
    proof_verified: int = 5
    proof_agreement: float = 1e-6
    proof_halvings: int = 4
    reach_starts: int = 8
    reach_steps: int = 20
    reach_longest_step: float = 0.4
    reach_near: float = 0.02
    share_points: int = 30
    share_ways: int = 4
    share_steps: int = 15
    region_close: float = 0.01
    rest_points: int = 100
    entry_arms: int = 1024
    entry_nearest: int = 12
    entry_points: int = 48
    entry_share: int = 4
    delays: int = 41
    delay_instants: int = 80
    delay_points: int = 64
    delay_room: float = 3e-4
    rest_chord: float = 2e-3

    _none: ClassVar[tuple[str, ...]] = (
        "step_halvings",
        "smoothing_refinements",
        "smoothing_halvings",
        "proof_halvings",
    )


DEFAULT_WAY = WaySearch()
