"""Trust in a design: everything it promises, computed again by code that the optimisation does not use."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arguments import typed
from ..block.custom import CustomRequirement
from ..block.quantities import Quantity
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..errors import SolveError, whole
from ..robots.concentric import ConcentricRobot
from ..robots.robot import shifts
from ..solvers.blas import small
from ..solvers.time_limit import LONG_TIME_LIMIT, limited
from ..stability import follow, snap_free_certificate, worst_margin
from ..typing import Array
from .attempt import state_at
from .deployment import SHARES, draw
from .exchange import certified_at, motions
from .order import SLACK as ORDER_SLACK
from .order import pose_places, worst_order
from .program import Program, points_of
from .rechecks import Check, check_own, check_tubes, least_room, numbers_of
from .requirements import (
    Avoid,
    Coverage,
    Reach,
    SnapFree,
    SnapFreeInUse,
    StrokeForce,
    of_kind,
)

SLACK = 1e-6
"""By how much (m, rad, margin) a promise may be missed: the tolerance of the optimisation, not of the design."""


@dataclass(frozen=True, eq=False)
class Verification:
    """All promises of a design, checked again."""

    checks: tuple[Check, ...]
    """One for each promise."""

    @property
    def kept(self) -> bool:
        """Whether all promises are kept."""
        return all(check.kept for check in self.checks)

    @property
    def broken(self) -> str:
        """The promises that are not kept, in words."""
        return "; ".join(f"{check.what}: {check.found}" for check in self.checks if not check.kept)


@typed
@small
@limited
def count_snaps(
    robot: ConcentricRobot,
    turns: int,
    seed: int = 0,
    translations: Array | None = None,
    *,
    time_limit: float = LONG_TIME_LIMIT,
) -> tuple[int, int]:
    """Snaps and turns on which there were some, in full turns of random tubes in random directions, forth and back.

    Every turn begins at the untwisted home, with all tubes bending to one side; at least one tube, and not all,
    goes a full turn forth or back, and then everything goes back to where it began.

    Raises:
        TimeLimitError: `time_limit` (s) was reached before all turns were made.
    """
    whole("turns", turns, 0)
    random = np.random.default_rng(seed)
    n = robot.n_tubes
    home = shifts(robot, translations)
    start = np.array([np.pi if tube.curvature < 0 else 0.0 for tube in robot.tubes])
    snaps, snapped = 0, 0
    for _ in range(turns):
        turn = np.zeros(n)
        turn[: n - 1] = random.choice([-1.0, 0.0, 1.0], n - 1)
        if n > 1 and not turn.any():
            turn[random.integers(n - 1)] = random.choice([-1.0, 1.0])
        begin = start + random.uniform(-0.5, 0.5, n)
        way = np.array([start, begin, begin + 2 * np.pi * turn, begin, start])
        found = len(follow(robot, way, np.tile(home, (5, 1))).snaps)
        snaps, snapped = snaps + found, snapped + (found > 0)
    return snaps, snapped


def solve_again(program: Program, robot: ConcentricRobot, x: Array) -> tuple[Equilibrium, ...]:
    """Equilibria of all task poses by forward kinematics from scratch; of poses that the robot reaches on joint paths,
    those in which it arrives."""
    state = state_at(program, x)
    joints = [state.joint_values(k) for k in program.task_poses]
    paths = [one for one in of_kind(program.task.requirements, SnapFreeInUse) if one.paths]
    if paths and len(joints) > 1:
        found = motions(program, robot, x)
        return (found[0].equilibria[0], *(motion.equilibria[-1] for motion in found))
    return tuple(forward_kinematics(robot, *pair) for pair in joints)


def verify(
    program: Program, robot: ConcentricRobot, x: Array, equilibria: tuple[Equilibrium, ...], *, turns: int = 6
) -> Verification:
    """Check a design again: certificates against search and against random full turns, poses by forward kinematics,
    tubes by what they are and by the strain in their poses, custom requirements by their expressions at all of that."""
    checks: list[Check] = []
    for one in program.task.requirements:
        if isinstance(one, SnapFree):
            checks += _certificate(program, robot, one, turns)
        elif isinstance(one, SnapFreeInUse) and equilibria:
            arms = {"margin at the task poses": equilibria}
            if one.deployed:
                arms["margin during deployment to the task poses"] = on_the_way(robot, equilibria)
            for words, some in arms.items():
                least = min(e.margin for e in some)
                checks.append(Check(words, f"{least:.4f}", least >= one.margin - one.tolerance))
            if one.paths and len(equilibria) > 1:
                checks.append(_paths(program, robot, x, one))
        elif isinstance(one, StrokeForce):
            checks.append(_stroke_force(one, robot, equilibria))
        elif isinstance(one, Avoid):
            checks.append(_anatomy(one, robot, equilibria))
        elif isinstance(one, CustomRequirement):
            checks.append(check_own(one, robot, equilibria))
        checks += check_tubes(one, robot, equilibria)
    checks += _order(program, robot, equilibria)
    checks += _tips(program, equilibria)
    return Verification(tuple(checks))


def _certificate(program: Program, robot: ConcentricRobot, one: SnapFree, turns: int) -> list[Check]:
    rows = [np.array(row) for row in certified_at(program, robot)]
    values = [snap_free_certificate(robot, row) for row in rows]
    checks = [Check("certificate", f"{min(values):.5f}", min(values) >= one.floor - one.tolerance - SLACK)]
    checks += _erring(robot, one, rows, program.task.solver.perturbed_robots)
    order = np.argsort(values)[: program.task.solver.searched_translations]
    for k in order:
        try:
            found = worst_margin(robot, rows[k]).margin
        except SolveError:
            found = 0.0  # a fold
        where = ", ".join(f"{d * 1e3:.4g}" for d in rows[k])
        words = f"least margin that search finds at translations {where} mm"
        checks.append(Check(words, f"{found:.4f}", found >= values[k] - SLACK))
    if one.margin > 0:
        snaps = sum(count_snaps(robot, turns, 10 + int(k), rows[k])[0] for k in order)
        words = f"snaps in {turns * len(order)} random full turns forth and back"
        checks.append(Check(words, str(snaps), snaps == 0))
    return checks


def _erring(robot: ConcentricRobot, one: SnapFree, rows: list[Array], count: int) -> list[Check]:
    """The certificate with curvatures and stiffnesses that are off by as much as they may be."""
    if one.growth == 1 or not all(tube.even for tube in robot.tubes):
        return []
    random, least = np.random.default_rng(0), np.inf
    for _ in range(count):
        bent, bending, torsional = 1 + random.choice([-1.0, 1.0], (3, robot.n_tubes)) * np.array(
            [[one.curvature_error], [one.stiffness_error], [one.stiffness_error]]
        )
        tubes = tuple(
            tube.resized("curvature", tube.curvature * float(bent[i]))
            .resized("bending_stiffness", float(tube.bending_stiffness) * float(bending[i]))
            .resized("torsional_stiffness", float(tube.torsional_stiffness) * float(torsional[i]))
            for i, tube in enumerate(robot.tubes)
        )
        least = min(least, *(snap_free_certificate(ConcentricRobot(tubes), row) for row in rows))
    words = f"least certificate of {count} robots with random errors of their tubes"
    return [Check(words, f"{least:.5f}", least >= one.margin - one.tolerance - SLACK)]


def on_the_way(robot: ConcentricRobot, equilibria: tuple[Equilibrium, ...]) -> tuple[Equilibrium, ...]:
    """Arms on their way out to poses."""
    return tuple(draw(robot, one, share) for one in equilibria for share in SHARES)


def _order(program: Program, robot: ConcentricRobot, equilibria: tuple[Equilibrium, ...]) -> list[Check]:
    """Tubes in order where the task wants them so, and in its poses."""
    posed = pose_places([e.translations for e in equilibria]) if program.task.ordered else ()
    places = (*program.task.places, *posed)
    if not places:
        return []
    gap, words = worst_order(robot.tubes, places)
    return [Check("order of the tubes", words, gap >= -ORDER_SLACK)]


def _paths(program: Program, robot: ConcentricRobot, x: Array, one: SnapFreeInUse) -> Check:
    found = motions(program, robot, x)
    if any(motion.snap is not None for motion in found):
        return Check("joint paths between the task poses", "a snap", False)
    least = min(float(motion.margin.min()) for motion in found)
    words = "margin on the joint paths between the task poses"
    return Check(words, f"{least:.4f}", least >= one.margin - 2 * one.tolerance)


def _stroke_force(one: StrokeForce, robot: ConcentricRobot, equilibria: tuple[Equilibrium, ...]) -> Check:
    look = numbers_of(robot, equilibria)
    least = min(float(look(Quantity("stroke_force", k))[0]) for k in range(len(equilibria)))
    return Check("stroke force at the task poses", f"{least * 1e3:.4f} mN", least >= one.limit - SLACK)


def _anatomy(one: Avoid, robot: ConcentricRobot, equilibria: tuple[Equilibrium, ...]) -> Check:
    drawn = on_the_way(robot, equilibria) if one.deployed else ()
    room = min((least_room(one, robot, e) for e in (*equilibria, *drawn)), default=np.inf) - one.clearance
    return Check("room between the arm and the obstacles at the task poses", f"{room * 1e3:.4f} mm", room >= 0)


def _tips(program: Program, equilibria: tuple[Equilibrium, ...]) -> list[Check]:
    place = {number: k for k, number in enumerate(program.task_poses)}
    points = points_of(program.task.requirements, program.added)
    checks = []
    for one, own, aims in zip(program.task.requirements, program.own, points, strict=True):
        if not isinstance(one, Reach | Coverage):
            continue
        reached = [equilibria[place[number]] for number in own]
        targets = one.targets if isinstance(one, Reach) else [one] * len(aims)
        allowed = np.array([target.tolerance for target in targets])
        gaps = np.linalg.norm([e.tip_position for e in reached] - np.array(aims), axis=1)
        worst = int(np.argmax(gaps / allowed))
        words = f"largest distance of the tip from {len(aims)} targets"
        kept = bool(gaps[worst] <= (1 + 1e-3) * allowed[worst])
        checks.append(Check(words, f"{gaps[worst] * 1e3:.4f} mm", kept))
        if isinstance(one, Reach):
            checks += _directions(one, reached)
    return checks


def _directions(one: Reach, equilibria: list[Equilibrium]) -> list[Check]:
    out = []
    for k, (target, equilibrium) in enumerate(zip(one.targets, equilibria, strict=True)):
        if target.direction is not None:
            heading = equilibrium.tip_rotation[:, 2]
            angle = float(np.arccos(np.clip(heading @ np.array(target.direction), -1, 1)))
            kept = angle <= target.direction_tolerance + SLACK
            out.append(Check(f"direction at target {k + 1}", f"{np.degrees(angle):.3f} deg off", kept))
    return out
