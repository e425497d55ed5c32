"""How hard joint values are searched for: what a user may want to change, as documented fields."""

from __future__ import annotations

from dataclasses import dataclass

from ..display import Displayed
from ..errors import check_settings


@dataclass(frozen=True)
class InverseSolver(Displayed):
    """How inverse kinematics searches; a field of `InverseOptions`.

    Args:
        position_tolerance: distance, m, at which an answer counts as on target.
        direction_tolerance: angle, rad, at which it counts as pointing there.
        steps: of the search for the target from one start.
        improving_steps: of the search for a better answer from one on target.
        first_step: largest step at first, in units of the joints' scales.
        nearest: starts that are taken as they come, the most promising first; those after them are spread over all
            postures.
        compared: answers among which the best is taken where there is an objective and no seed.
        doubted: answers that a cold forward kinematics does not find, after which one of them is taken.
        unanimous: so many starts that end as far from the target say that there is no better.
        far_starts: so many starts, all ending farther from the target than `far` of the robot's length, say: out of
            reach.
        far: share of the robot's length.
        program_starts: from which the nonlinear program tries what the fast path did not solve.
        program_orders: changes of the order of breakpoints that the program goes through.
        clear_starts: clear of the obstacles, that are tried where all others ended in one.
        closest_steps: of the search for the posture that misses an unreachable target least.
        closest_orders: changes of the order of breakpoints on its way.
        closest_postures: tried in it; far fewer do but where bodies hold the arm in several places.
        closest_agreeing: so many further ends that it brings as close as the best say that there is no closer one.
        shots: answers without load in search of one that is on target, with its margin and clearance, under it.

    Raises:
        InputError: a count that is no whole number of at least 1 (0 for starts of the program and clear ones, and for
            orders), another number that is not positive.
    """

    position_tolerance: float = 1e-8
    direction_tolerance: float = 1e-7
    steps: int = 30
    improving_steps: int = 60
    first_step: float = 0.6
    nearest: int = 12
    compared: int = 3
    doubted: int = 4
    unanimous: int = 10
    far_starts: int = 24
    far: float = 0.02
    program_starts: int = 4
    program_orders: int = 6
    clear_starts: int = 8
    closest_steps: int = 60
    closest_orders: int = 6
    closest_postures: int = 150
    closest_agreeing: int = 4
    shots: int = 40

    def __post_init__(self) -> None:
        check_settings(self, ("program_starts", "program_orders", "clear_starts", "closest_orders"))


DEFAULT_SOLVER = InverseSolver()


@dataclass(frozen=True)
class WaySearch(Displayed):
    """How hard a way between joint values is searched for, smoothed, timed and proved; a field of `PlanOptions`.

    Args:
        translations: sampled in the search for those at which the robot cannot snap.
        detours: by way of them that are tried, the shortest first.
        detour_seconds, detour_share: most seconds, and most of the time that is left, for that; then chance has its
            turn.
        wall_seconds, wall_share: the same for what keeps start and goal apart.
        motion: longest that RRT-Connect tries at once, in units of the joints' scales.
        long_share, reason_share: of the time that is left, for the search by long motions, and for the same where
            something stands against a way; short ones have the rest.
        pocket_share: of that rest, for whether start or goal lie in a closed pocket.
        pocket_states: of a pocket, from which it counts as open.
        pocket_motions: in a row that do not lead on, from which it counts as closed.
        smoothing_seconds, smoothing_share: most seconds, and most of the time that is left, for smoothing: the proof
            needs the rest.
        scanned_seconds: most seconds of smoothing for length among scans, where rounded corners are rarely longer.
        smoothing_intervals: between knots of the smooth motion at first.
        smoothing_refinements: times that knots are added where the motion between them is not allowed.
        smoothing_twist: change, rad, of a tip rotation between knots that is always allowed.
        smoothing_margin: beyond that of the search, which knots keep at first for what is between them.
        smoothing_reach: distance of knots from bodies, as a share of the longest tube, up to which these may matter.
        rounding_seconds, rounding_share: most seconds, and most of the time that smoothing leaves, for rounding the
            corners of the way as it is.
        goals: joint values, most that are tried where several meet what is asked for, the nearest to the start first.
        goal_turns: whole turns of one tube that are tried.
        goal_share: of the time limit, after which joint values for a goal of the tip are tried from no further start.
        nearest_share: of the time for the search, for the nearest posture where others are tried after it.
        roadmap_share: of the time for the search, which a roadmap is given first.
        attempts: times that a plan whose proof finds a fault is made again with more room and other random numbers.
        timing_cells, timing_fine_cells: of the grid on which a curve is timed, evenly spaced at first, then such that
            they take the same time.
        timing_prudence: share of the rates that is used: the tip's speed is taken on the grid, and ends of the path are
            made exact.
        proof_turn: largest turn (rad) of a joint between two equilibria of the proof, to begin with.
        proof_shift: the same of a translation, as a share of the longest tube.
        proof_equilibria: at most.
        proof_accuracy: how far (m) the bound of the clearance may lie below the least distance that was measured.
        proof_arms_accuracy: the same (m) of the distance of two arms.
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

    Raises:
        InputError: a count that is no whole number of at least 1 (0 for `smoothing_refinements` and `proof_halvings`),
            another number that is not positive.
    """

    translations: int = 160
    detours: int = 24
    detour_seconds: float = 6.0
    detour_share: float = 0.3
    wall_seconds: float = 5.0
    wall_share: float = 0.15
    motion: float = 1.2
    long_share: float = 0.5
    reason_share: float = 0.3
    pocket_share: float = 0.3
    pocket_states: int = 60
    pocket_motions: int = 1500
    smoothing_seconds: float = 20.0
    smoothing_share: float = 0.5
    scanned_seconds: float = 2.5
    smoothing_intervals: int = 24
    smoothing_refinements: int = 3
    smoothing_twist: float = 0.3
    smoothing_margin: float = 3e-3
    smoothing_reach: float = 0.1
    rounding_seconds: float = 5.0
    rounding_share: float = 0.3
    goals: int = 12
    goal_turns: int = 3
    goal_share: float = 0.6
    nearest_share: float = 0.4
    roadmap_share: float = 0.3
    attempts: int = 3
    timing_cells: int = 100
    timing_fine_cells: int = 500
    timing_prudence: float = 0.9995
    proof_turn: float = 0.04
    proof_shift: float = 0.004
    proof_equilibria: int = 20_000
    proof_accuracy: float = 1.2e-5
    proof_arms_accuracy: float = 5e-5
    proof_halvings: int = 4
    reach_starts: int = 8
    reach_steps: int = 20
    reach_longest_step: float = 0.4
    reach_near: float = 0.02
    share_points: int = 30
    share_ways: int = 4
    share_steps: int = 15

    def __post_init__(self) -> None:
        check_settings(self, ("smoothing_refinements", "proof_halvings"))


DEFAULT_WAY = WaySearch()
