"""How hard joint values are searched for: what a user may want to change, as documented fields."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ..errors import Settings


@dataclass(frozen=True)
class InverseSolver(Settings):
    """How inverse kinematics searches; a field of `InverseOptions`.

    Args:
        position_tolerance: distance, m, at which an answer counts as on target.
        direction_tolerance: angle, rad, at which it counts as pointing there.
        search_tolerance: distance (m) and angle (rad) at which a search counts a target as met: far less than an answer
            may be off.
        margin_room, clearance_room: kept beyond what is asked, so that solving on a finer mesh still finds it kept; the
            second, m, is more than the arm comes closer between the points at which it is measured.
        steps: of the search for the target from one start.
        improving_steps: of the search for a better answer from one on target.
        first_step: largest step at first, in units of the joints' scales.
        shortest_step: to which a step is shortened before the search ends, in the same units.
        least_promise: relative decrease of what is left to the target that a step must promise.
        patience: steps in a row that may bring next to nothing.
        target_weight: of the target over the cost, in a step of the search for a better answer.
        body_reach: share of the robot's length, up to which a step looks at bodies.
        bodies: of which a step knows at least, the nearest; of more only those that a step has come too close to.
        closed_section: length, m, of a section between breakpoints that counts as none.
        short_section: share of the robot's length, up to which a section may hold a step up as if it were none.
        order_shift: share of the robot's length, by which breakpoints are moved past each other.
        pool: configurations of the table, the most promising, among which starts are spread.
        direction_weight: of the difference of directions against that of positions over the robot's length, in how
            promising a start is.
        nearness_weight: of its distance from a reference, in units of the joints' scales.
        nearest: starts that are taken as they come, the most promising first; those after them are spread over all
            postures.
        compared: answers among which the best is taken where there is an objective and no seed.
        doubted: answers that a cold forward kinematics does not find, after which one of them is taken.
        unanimous: so many starts that end as far from the target say that there is no better.
        far_starts: so many starts, all ending farther from the target than `far` of the robot's length, say: out of
            reach.
        far: share of the robot's length.
        same_miss: share of the robot's length, by which the distances of two ends from the target may differ and agree.
        same_cost: share of the cost, by which a later answer must be better to take an earlier one's place.
        program_starts: from which the nonlinear program tries what the fast path did not solve.
        program_orders: changes of the order of breakpoints that the program goes through.
        program_bodies: obstacles at most, for the program: every one costs as much as all of the arm.
        program_building: seconds that building it may take, per cube of the number of tubes, and per obstacle and one.
        program_margin_room: margin that it keeps beyond the bound: more than the steps of its Jacobi fields are off.
        clear_starts: clear of the obstacles, that are tried where all others ended in one.
        closest_steps: of the search for the posture that misses an unreachable target least.
        closest_orders: changes of the order of breakpoints on its way.
        closest_postures: tried in it; far fewer do but where bodies hold the arm in several places.
        closest_promise: share of the robot's length, by which a step must promise to bring the tip closer.
        closest_gain: the same, by which a later end must be closer to take an earlier one's place.
        closest_returns: steps of the way back to what is allowed.
        closest_curvature: of the model at least, per square of a joint's scale.
        same_end: ends closer than this in every joint, in units of their scales, are one.
        closest_agreeing: so many further ends that it brings as close as the best say that there is no closer one.
        shots: answers without load in search of one that is on target, with its margin and clearance, under it.
        aim_tolerance: distance, m, and angle, rad, at which the aim under a load is good.
        aim_stalled: share of the arm, or angle, up to which round-off may end the aiming.
        aim_gain: part of the last miss to which a shot must bring it; beyond, aiming does not converge.
        aim_room: margin, and share of the arm's length as clearance, asked for beyond what was found missing.
        way_seconds: for which a way without a snap to one answer is looked for at most.
        way_margin: that it keeps, or half of what its ends have where that is less.
        session_tolerance: distance, m, and angle, rad, at which a step of an `IkSession` ends.
        session_move: share of the robot's length; farther targets are approached in so long parts on a straight line.
        session_part: share of such a part, to which it is divided at most, so that the robot does not leap.
        session_push: length of the motion towards larger margin, over that of the motion towards the target.
        session_careful: margin above its bound below which derivatives are computed anew for every step.
        session_room, session_least_room: clearance to spare for a step that does not look at bodies: per way of the
            tip, and at least, m.
        session_solves: equilibria that a step may cost before its derivatives count as stale.
        session_steps: after which they do in any case.
        session_section: length, m, of a section that a step may close.
        leap_turn, leap_shift: largest motion of a rotation and of a translation, in units of its scale, over that of
            the tip in robot's lengths and, where it is pointed, rad: more is a leap. A carriage that moves more than
            four times as far as the tip changes the posture.
        leap_azimuth: rotation allowed beside that, over the angle by which the tip moves about the axis of the plate.
        leap_least: motion of a joint, in units of its scale, that is no leap in any case.
        leap_aside, leap_least_aside: distance of the tip from the line between the targets that is no leap, as a share
            of their distance, and m.
        leap_sampled: motion, in units of the joints' scales, between two places where the way is looked at.

    Raises:
        InputError: a count that is no whole number of at least 1 (0 for starts of the program and clear ones, and for
            orders), another number that is not positive.
    """

    position_tolerance: float = 1e-8
    direction_tolerance: float = 1e-7
    search_tolerance: float = 1e-10
    margin_room: float = 1e-6
    clearance_room: float = 1e-5
    steps: int = 30
    improving_steps: int = 60
    first_step: float = 0.6
    shortest_step: float = 1e-5
    least_promise: float = 1e-7
    patience: int = 5
    target_weight: float = 1e4
    body_reach: float = 0.1
    bodies: int = 30
    closed_section: float = 1e-7
    short_section: float = 1e-4
    order_shift: float = 1e-5
    pool: int = 400
    direction_weight: float = 0.35
    nearness_weight: float = 0.02
    nearest: int = 12
    compared: int = 3
    doubted: int = 4
    unanimous: int = 10
    far_starts: int = 24
    far: float = 0.02
    same_miss: float = 2e-5
    same_cost: float = 1e-7
    program_starts: int = 4
    program_orders: int = 6
    program_bodies: int = 16
    program_building: float = 0.025
    program_margin_room: float = 1e-4
    clear_starts: int = 8
    closest_steps: int = 60
    closest_orders: int = 6
    closest_postures: int = 150
    closest_promise: float = 1e-8
    closest_gain: float = 1e-7
    closest_returns: int = 12
    closest_curvature: float = 1e-6
    same_end: float = 1e-3
    closest_agreeing: int = 4
    shots: int = 40
    aim_tolerance: float = 2e-9
    aim_stalled: float = 1e-7
    aim_gain: float = 0.9
    aim_room: float = 1e-3
    way_seconds: float = 10.0
    way_margin: float = 2e-3
    session_tolerance: float = 2e-9
    session_move: float = 0.02
    session_part: float = 1 / 16
    session_push: float = 0.5
    session_careful: float = 0.15
    session_room: float = 4.0
    session_least_room: float = 2e-4
    session_solves: int = 4
    session_steps: int = 8
    session_section: float = 1e-3
    leap_turn: float = 20.0
    leap_shift: float = 8.0
    leap_azimuth: float = 2.0
    leap_least: float = 0.02
    leap_aside: float = 0.05
    leap_least_aside: float = 1e-5
    leap_sampled: float = 0.1

    _none: ClassVar[tuple[str, ...]] = ("program_starts", "program_orders", "clear_starts", "closest_orders")


DEFAULT_SOLVER = InverseSolver()
