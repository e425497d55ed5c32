"""Promises computed again from the robot and its equilibria: strain, walls, nesting, lengths, travel, and own
requirements by their expressions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any

import numpy as np

from ..arguments import typed
from ..block.custom import CustomRequirement
from ..block.quantities import CLEARANCES, Look, Quantity, recorded
from ..equilibrium.answer import sure_margin
from ..equilibrium.kinematics import forward_kinematics, under_load
from ..equilibrium.result import Equilibrium
from ..equilibrium.verification import point_at
from ..errors import SolveError, whole
from ..files.field_metadata import form
from ..physics.strain import surface_strain
from ..robots.concentric import ConcentricRobot
from ..robots.pieces import Series
from ..robots.robot import shifts
from ..robots.tubes import Tube, piece_strain
from ..solvers.blas import small
from ..solvers.time_limit import LONG_TIME_LIMIT, limited
from ..stability import find_stroke_force, follow, snap_free_certificate, worst_margin
from ..typing import Array
from .evaluation import state_at
from .exchange import certified_at, motions
from .program import Program, points_of
from .requirements import (
    SHARES,
    Avoid,
    Coverage,
    Length,
    Nesting,
    Reach,
    Requirement,
    SnapFree,
    SnapFreeInUse,
    Strain,
    Stroke,
    StrokeForce,
    Wall,
    draw,
    of_kind,
)
from .state import STRONGEST
from .task import ORDER_SLACK, pose_places, worst_order

# Part of a limit, or of a step of a custom requirement, by which it may be missed.
MISSED = 1e-6


@dataclass(frozen=True)
class Check:
    """One promise."""

    what: Annotated[str, form("s", label=""), "the requirement"]
    found: Annotated[str, form("s", label="found"), "the value found"]
    kept: Annotated[bool, "true if it is satisfied"]


def check_tubes(one: Requirement, robot: ConcentricRobot, equilibria: tuple[Equilibrium, ...]) -> list[Check]:
    """What becomes of a promise about tubes; nothing for other requirements."""
    match one:
        case Strain(limits=limits):
            found = largest_strain(one, robot, equilibria)
            worst = int(np.argmax(found / np.array(limits)))
            where = ["straightened"] * one.straightened + ["at the task poses"] * (one.in_poses and bool(equilibria))
            words = f"largest strain {' and '.join(where)}, in tube {worst + 1}"
            kept = bool((found <= np.array(limits) * (1 + MISSED)).all())
            return [Check(words, f"{found[worst] * 100:.4f} %", kept)]
        case Wall(thickness=limit):
            least = min((tube.outer_diameter - tube.inner_diameter) / 2 for tube in robot.tubes)
            return [Check("smallest wall thickness", _mm(least), least >= limit * (1 - MISSED))]
        case Nesting(clearance=limit) if robot.n_tubes > 1:
            least = min(outer.inner_diameter - inner.outer_diameter for inner, outer in pairwise(robot.tubes))
            # An absolute tolerance, 1 nm: the limit may be 0, and a share of it would allow nothing.
            return [Check("least clearance of the diameters", _mm(least), least >= limit - 1e-3 * MISSED)]
        case Length(field=field, tube=i, limit=limit, least=at_least):
            value = getattr(robot.tubes[i], field)
            kept = value >= limit * (1 - MISSED) if at_least else value <= limit * (1 + MISSED)
            return [Check(f"{field.replace('_', ' ')} of tube {i + 1}", _mm(value), kept)]
        case Stroke(limit=limit) if equilibria:
            travel = float(np.ptp([e.translations for e in equilibria], axis=0).max())
            return [Check("longest travel of a carriage", _mm(travel), travel <= limit * (1 + MISSED))]
        case _:
            return []


def largest_strain(one: Strain, robot: ConcentricRobot, equilibria: tuple[Equilibrium, ...]) -> Array:
    """Independent of physics.torsion: (n,) largest bending strain of every tube where `one` limits it.

    Held straight, and at the shape points, to both sides of which the tubes are bent as their balance of moments says.
    """
    found = np.array([tube.straightened_strain if one.straightened else 0.0 for tube in robot.tubes])
    for e in equilibria if one.in_poses else ():
        for aside in (-1e-9, 1e-9):  # m: the arm's curvature jumps at breakpoints
            s = e.arc_length + aside
            # In front of the plate, up to the end of the tube: its translation and its curved length.
            there = (s > 0) & (s < e.translations[:, None] + np.array([[tube.curved_length] for tube in robot.tubes]))
            own = [_own(tube, s - d) for tube, d in zip(robot.tubes, e.translations, strict=True)]
            stiffness = there * np.array([part[1] for part in own])
            # u* e^(j theta) in the common frame. Without a load, sum k_i (u - u*_i) = 0:
            # the arm has their weighted mean.
            turned = [part[0] * np.exp(1j * angle) for part, angle in zip(own, e.rotation, strict=True)]
            bent = (stiffness * turned).sum(axis=0) / np.maximum(stiffness.sum(axis=0), 1e-300)
            for i, tube in enumerate(robot.tubes):
                radius = tube.outer_diameter / 2
                strain = own[i][2] * surface_strain(radius, np.abs(bent - turned[i]), np.abs(own[i][0]))
                found[i] = max(found[i], strain[there[i]].max(initial=0.0))
    return found


def _own(tube: Tube, place: Array) -> tuple[Array, Array, Array]:
    """Precurvature x + j y in its own frame, 1/m, bending stiffness, N m^2, and how many times as much as a whole tube
    it is strained, (m,) each, at places from where its straight part ends, m."""
    bend, whole = np.zeros(len(place), dtype=complex), float(tube.bending_stiffness)
    stiffness, ratio, begin = np.full(len(place), whole), np.ones(len(place)), 0.0
    for piece in tube.chain:
        here = (place > begin) & (place <= begin + piece.length)
        x, y, kb = (_at(part, place[here] - begin) for part in (*piece.precurvature[:2], piece.bending_stiffness))
        bend[here] = x + 1j * y
        stiffness[here] = whole if kb is None else kb
        ratio[here] = piece.strain_ratio(whole)
        begin += piece.length
    return bend, stiffness, ratio


def _at(quantity: Any, place: Array) -> Any:
    return quantity(place) if isinstance(quantity, Series) else quantity


def least_room(body: Any, robot: ConcentricRobot, equilibrium: Equilibrium) -> float:
    """Least distance (m) of the arm's surface at its shape points in front of the plate from a body."""
    ends = equilibrium.tube_end
    radius = np.array([tube.outer_diameter / 2 for tube in robot.tubes])
    outer = np.array([radius[np.flatnonzero(ends >= s - 1e-9)].max() for s in equilibrium.arc_length])
    return float((body.signed_distance(equilibrium.position) - outer)[1:].min())


def _mm(value: float) -> str:
    return f"{value * 1e3:.4f} mm"


def numbers_of(robot: ConcentricRobot, equilibria: Sequence[Equilibrium]) -> Look:
    """Quantities as numbers: of the robot, and of its equilibria by forward kinematics; along the arm by adaptive
    integration."""

    def look(one: Quantity) -> Array:
        """The numbers of one quantity."""
        if one.name == "certificate":
            return np.array([snap_free_certificate(robot, np.array(one.at))])
        if one.name == "straightened_strain":
            tube = robot.tubes[one.at[0]]
            return np.array([piece_strain(tube, tube.pieces[one.at[1]]) if tube.pieces else tube.straightened_strain])
        if one.pose is None:
            return np.array([getattr(tube, one.name) for tube in robot.tubes])
        found = equilibria[one.pose] if isinstance(one.pose, int) else draw(robot, equilibria[one.pose[0]], one.pose[1])
        match one.name:
            case "strain":
                anywhere = Strain((1.0,) * robot.n_tubes, straightened=False, in_poses=True)
                return largest_strain(anywhere, robot, (found,))[list(one.at)]
            case "clearance":
                # A recorded clearance has a row for each part of the arm; the least of all is the strictest for each.
                return np.full(CLEARANCES, least_room(one.at[0], robot, found))
            case "deflection":
                return under_load(found, one.at[0]).tip_position - found.tip_position
            case "margin_under":
                return np.array([sure_margin(under_load(found, one.at[0]))])
            case "stroke_force":
                limit = find_stroke_force(
                    robot, found.rotations, found.translations, equilibrium=found, up_to=STRONGEST
                )
                return np.array([STRONGEST if limit is None else limit.factor])
            case "jacobian":
                return found.jacobian().position.ravel(order="F")
            case "turning":
                return found.jacobian().rotation.ravel(order="F")
            case "tip_direction":
                return np.asarray(found.tip_rotation[:, 2])
            case "position" | "curvature":
                place, bend = point_at(found, one.at[0] * float(found.arc_length[-1]))
                return place if one.name == "position" else bend
            case name:
                return np.atleast_1d(getattr(found, name))

    return look


def check_own(one: CustomRequirement, robot: ConcentricRobot, equilibria: Sequence[Equilibrium]) -> Check:
    """What becomes of a custom requirement."""
    pieces = [len(tube.pieces) or 1 for tube in robot.tubes]
    expression = recorded(one.expression, robot.n_tubes, len(equilibria), one.words, pieces)
    try:
        least = float(expression(numbers_of(robot, equilibria)).min())
    except FloatingPointError:
        return Check(one.words, "not a finite number", False)
    value = one.limit - least if one.is_upper_bound else one.limit + least
    return Check(one.words, f"{value * one.factor:.6g} {one.unit}".strip(), least >= -MISSED * one.size)


# By how much (m, rad, margin) a promise may be missed: the tolerance of the optimisation, not of the design.
SLACK = 1e-6

# The search for the least margin takes seconds a translation; where the certificate is smallest it has most to find.
SEARCHED_TRANSLATIONS = 3

# Corners of the box of tube errors, drawn at random: of three tubes there are 2^9, and the bound covers all of them.
PERTURBED_ROBOTS = 12


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
    # A tube with negative curvature begins turned by half: all bend to one side, without torsion.
    start = np.array([np.pi if tube.curvature < 0 else 0.0 for tube in robot.tubes])
    snaps, snapped = 0, 0
    for _ in range(turns):
        turn = np.zeros(n)
        # The last tube stays: turning all tubes together changes no shape, only relative turns do.
        turn[: n - 1] = random.choice([-1.0, 0.0, 1.0], n - 1)
        if n > 1 and not turn.any():
            turn[random.integers(n - 1)] = random.choice([-1.0, 1.0])
        # A random offset: from the exactly aligned home, a turn and its reverse are mirror images.
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
    checks += _erring(robot, one, rows)
    order = np.argsort(values)[:SEARCHED_TRANSLATIONS]
    for k in order:
        try:
            found = worst_margin(robot, rows[k]).margin
        except SolveError:
            found = 0.0  # a fold
        where = ", ".join(f"{d * 1e3:.4g}" for d in rows[k])
        words = f"least margin that search finds at translations {where} mm"
        # The certificate is a lower bound: an equilibrium with less margin refutes it.
        checks.append(Check(words, f"{found:.4f}", found >= values[k] - SLACK))
    # Only a positive margin promises that no turn snaps.
    if one.margin > 0:
        snaps = sum(count_snaps(robot, turns, 10 + int(k), rows[k])[0] for k in order)
        words = f"snaps in {turns * len(order)} random full turns forth and back"
        checks.append(Check(words, str(snaps), snaps == 0))
    return checks


def _erring(robot: ConcentricRobot, one: SnapFree, rows: list[Array]) -> list[Check]:
    """The certificate with curvatures and stiffnesses that are off by as much as they may be."""
    # Growth 1 means no errors; a tube that is not even has no single curvature to change.
    if one.growth == 1 or not all(tube.even for tube in robot.tubes):
        return []
    random, least = np.random.default_rng(0), np.inf
    for _ in range(PERTURBED_ROBOTS):
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
    words = f"least certificate of {PERTURBED_ROBOTS} robots with random errors of their tubes"
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
    # Exchange accepts margins down to one tolerance; the second one keeps round-off from refuting these.
    return Check(words, f"{least:.4f}", least >= one.margin - 2 * one.tolerance)


def _stroke_force(one: StrokeForce, robot: ConcentricRobot, equilibria: tuple[Equilibrium, ...]) -> Check:
    look = numbers_of(robot, equilibria)
    least = min(float(look(Quantity("stroke_force", k))[0]) for k in range(len(equilibria)))
    return Check("stroke force at the task poses", f"{least * 1e3:.4f} mN", least >= one.limit - SLACK)


def _anatomy(one: Avoid, robot: ConcentricRobot, equilibria: tuple[Equilibrium, ...]) -> Check:
    drawn = on_the_way(robot, equilibria) if one.deployed else ()
    room = min((least_room(one, robot, e) for e in (*equilibria, *drawn)), default=np.inf) - one.clearance
    # No tolerance here: the design was kept off by HELD_OFF in addition.
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
        # As in `reachable`, a thousandth of the tolerance may be missed.
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
            # Clipped: beyond 1 by round-off, arccos is NaN.
            angle = float(np.arccos(np.clip(heading @ np.array(target.direction), -1, 1)))
            kept = angle <= target.direction_tolerance + SLACK
            out.append(Check(f"direction at target {k + 1}", f"{np.degrees(angle):.3f} deg off", kept))
    return out
