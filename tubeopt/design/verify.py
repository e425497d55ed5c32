"""Verification of a design by independent code: requirements computed again from its robot and solved equilibria."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np
import scipy

from ..arguments import typed
from ..block.custom import CustomRequirement
from ..block.quantities import CLEARANCES, PLACES, Look, Quantity, recorded
from ..equilibrium.kinematics import forward_kinematics, sure_margin, under_load
from ..equilibrium.result import Equilibrium
from ..equilibrium.verification import point_at
from ..errors import SolveError, whole
from ..files.field_metadata import form
from ..physics.strain import surface_strain
from ..robots.concentric import ConcentricRobot
from ..robots.eccentric import BundleRobot, channel_between
from ..robots.pieces import Series
from ..robots.robot import shifts
from ..robots.tubes import Tube, piece_strain
from ..solvers.blas import small
from ..solvers.time_limit import LONG_TIME_LIMIT, limited
from ..stability import find_stroke_force, follow, snap_free_certificate, worst_margin
from ..typing import Array
from .evaluation import state_at
from .exchange import UNREACHED, certified_at, motions
from .parameters import SHEATH
from .program import Program, points_of
from .requirements import (
    DEPLOYED_FRACTIONS,
    Avoid,
    Bore,
    Channel,
    Coverage,
    Girth,
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
from .task import ORDER_SLACK, DesignedRobot, pose_ranges, tube_order, worst_order

# Fraction of a limit, or of a step of a custom requirement, by which it may be violated.
RELATIVE_TOLERANCE = 1e-6

# The same in m, rad, N and margin: the tolerance of the optimisation, not of the design.
TOLERANCE = 1e-6

# The search for the smallest margin takes seconds per translation; it is most likely to succeed where the certificate
# is smallest.
SEARCHED_TRANSLATIONS = 3

# Corners of the box of tube errors, drawn at random: of three tubes there are 2^9, and the bound covers all of them.
PERTURBED_ROBOTS = 12


@dataclass(frozen=True)
class Check:
    """Check of one requirement."""

    what: Annotated[str, form("s", label=""), "the requirement"]
    value: Annotated[str, form("s", label="value"), "its value in the design"]
    satisfied: Annotated[bool, "true if it is satisfied"]


@dataclass(frozen=True, eq=False)
class Verification:
    """Checks of all requirements of a design."""

    checks: tuple[Check, ...]
    """Check results, one or more for each requirement."""

    @property
    def satisfied(self) -> bool:
        """True if all requirements are satisfied."""
        return all(check.satisfied for check in self.checks)

    @property
    def violations(self) -> str:
        """Violated requirements with the values found."""
        return "; ".join(f"{check.what}: {check.value}" for check in self.checks if not check.satisfied)


def verify(
    program: Program, robot: DesignedRobot, x: Array, equilibria: tuple[Equilibrium, ...], *, turns: int = 6
) -> Verification:
    """Check all requirements of the design x (X,) on its robot and the equilibria of its task poses.

    Certificates are compared with a search for the smallest margin and with random full turns; strain and clearance are
    computed without the code of the optimisation.
    """
    task = program.task
    checks: list[Check] = []
    for requirement in task.requirements:
        checks += _checks_of(requirement, program, robot, x, equilibria, turns)
    pose_translations = [e.translations for e in equilibria]
    ranges = (*task.translation_ranges, *(pose_ranges(pose_translations) if task.ordered else ()))
    if ranges:
        distance, clause = worst_order(tube_order(robot), robot.tubes, ranges)
        checks.append(Check("order of the tubes", clause, distance >= -ORDER_SLACK))
    return Verification((*checks, *_check_targets(program, equilibria)))


def _checks_of(
    requirement: Requirement,
    program: Program,
    robot: DesignedRobot,
    x: Array,
    equilibria: tuple[Equilibrium, ...],
    turns: int,
) -> Iterator[Check]:
    """Checks of one requirement; those on targets are in `_check_targets`."""
    match requirement:
        case SnapFree():
            yield from _check_certificate(program, robot, requirement, turns)
        case SnapFreeInUse(margin=limit, tolerance=tolerance) if equilibria:
            arms = {"margin at the task poses": equilibria}
            if requirement.deployed:
                arms["margin during deployment to the task poses"] = deployments(robot, equilibria)
            for name, some in arms.items():
                margin = min(e.margin for e in some)
                yield Check(name, f"{margin:.4f}", margin >= limit - tolerance)
            if requirement.paths and len(equilibria) > 1:
                paths = motions(program, robot, x)
                if any(path.snap is not None for path in paths):
                    yield Check("joint paths between the task poses", "a snap", False)
                else:
                    margin = min(float(path.margin.min()) for path in paths)
                    name = "margin on the joint paths between the task poses"
                    # Exchange accepts margins down to one tolerance; the second one covers round-off.
                    yield Check(name, f"{margin:.4f}", margin >= limit - 2 * tolerance)
        case Strain(limits=limits):
            strain = largest_strain(requirement, robot, equilibria)
            worst = int(np.argmax(strain / np.array(limits)))
            posed = requirement.in_poses and bool(equilibria)
            where = ["straightened"] * requirement.straightened + ["at the task poses"] * posed
            satisfied = bool((strain <= np.array(limits) * (1 + RELATIVE_TOLERANCE)).all())
            name = f"largest strain {' and '.join(where)}, in tube {worst + 1}"
            yield Check(name, f"{strain[worst] * 100:.4f} %", satisfied)
        case Wall(thickness=limit):
            wall = min((tube.outer_diameter - tube.inner_diameter) / 2 for tube in robot.tubes)
            yield Check("smallest wall thickness", _mm(wall), wall >= limit * (1 - RELATIVE_TOLERANCE))
        case Nesting(clearance=limit) if robot.nested_pairs:
            clearance = min(
                robot.tubes[o].inner_diameter - robot.tubes[i].outer_diameter for i, o in robot.nested_pairs
            )
            # An absolute tolerance, 1 nm: the limit may be 0, and a fraction of it would allow nothing.
            satisfied = clearance >= limit - 1e-3 * TOLERANCE
            yield Check("least clearance of the diameters", _mm(clearance), satisfied)
        case Channel(diameter=limit) if isinstance(robot, BundleRobot):
            free = channel_between(robot).diameter
            yield Check("free circle between the tubes", _mm(free), free >= limit * (1 - RELATIVE_TOLERANCE))
        case Bore(diameter=limit):
            around = {o for _, o in robot.nested_pairs}
            bore = min(tube.inner_diameter for i, tube in enumerate(robot.tubes) if i not in around)
            yield Check("smallest bore of an innermost tube", _mm(bore), bore >= limit * (1 - RELATIVE_TOLERANCE))
        case Girth(limit=limit) if isinstance(robot, BundleRobot):
            girth = robot.sheath_diameter or robot.least_sheath_diameter
            yield Check("inner diameter of the sheath", _mm(girth), girth <= limit * (1 + RELATIVE_TOLERANCE))
        case Length(field=field, tube=i, limit=limit, least=at_least):
            length = getattr(robot.tubes[i], field)
            below, above = limit * (1 - RELATIVE_TOLERANCE), limit * (1 + RELATIVE_TOLERANCE)
            satisfied = length >= below if at_least else length <= above
            yield Check(f"{field.replace('_', ' ')} of tube {i + 1}", _mm(length), satisfied)
        case Stroke(limit=limit) if equilibria:
            travel = float(np.ptp([e.translations for e in equilibria], axis=0).max())
            yield Check("longest travel of a carriage", _mm(travel), travel <= limit * (1 + RELATIVE_TOLERANCE))
        case StrokeForce(limit=limit):
            value_of = numbers_of(robot, equilibria)
            force = min(float(value_of(Quantity("stroke_force", k))[0]) for k in range(len(equilibria)))
            yield Check("stroke force at the task poses", f"{force * 1e3:.4f} mN", force >= limit - TOLERANCE)
        case Avoid(clearance=limit):
            arms_on_path = deployments(robot, equilibria) if requirement.deployed else ()
            distances = (arm_distance(requirement, robot, e) for e in (*equilibria, *arms_on_path))
            excess = min(distances, default=np.inf) - limit
            # No tolerance here: the optimisation adds HELD_OFF to the clearance.
            yield Check("room between the arm and the obstacles at the task poses", _mm(excess), excess >= 0)
        case CustomRequirement():
            yield check_custom(requirement, robot, equilibria)


def _check_certificate(program: Program, robot: DesignedRobot, requirement: SnapFree, turns: int) -> Iterator[Check]:
    """Checks of a certificate: its value, with tube errors, by a search for smaller margins, and by full turns."""
    translations = [np.array(row) for row in certified_at(program, robot)]
    certificates = [snap_free_certificate(robot, row) for row in translations]
    lowest = requirement.required_margin - requirement.tolerance - TOLERANCE
    yield Check("certificate", f"{min(certificates):.5f}", min(certificates) >= lowest)
    # Growth 1 means no errors; a tube that is not even has no single curvature to change.
    if requirement.growth > 1 and isinstance(robot, ConcentricRobot) and robot.even:
        worst = _smallest_with_errors(robot, requirement, translations)
        name = f"least certificate of {PERTURBED_ROBOTS} robots with random errors of their tubes"
        yield Check(name, f"{worst:.5f}", worst >= requirement.margin - requirement.tolerance - TOLERANCE)
    searched = np.argsort(certificates)[:SEARCHED_TRANSLATIONS]
    for k in searched:
        try:
            margin = worst_margin(robot, translations[k]).margin
        except SolveError:
            margin = 0.0  # a fold
        where = ", ".join(f"{d * 1e3:.4g}" for d in translations[k])
        name = f"least margin that search finds at translations {where} mm"
        # The certificate is a lower bound: an equilibrium with less margin refutes it.
        yield Check(name, f"{margin:.4f}", margin >= certificates[k] - TOLERANCE)
    # Only a positive margin excludes snaps.
    if requirement.margin > 0:
        snaps = sum(count_snaps(robot, turns, 10 + int(k), translations[k])[0] for k in searched)
        name = f"snaps in {turns * len(searched)} random full turns forth and back"
        yield Check(name, str(snaps), snaps == 0)


def _smallest_with_errors(robot: ConcentricRobot, requirement: SnapFree, translations: list[Array]) -> float:
    """Smallest certificate of robots with tubes that deviate by the allowed errors, each up or down at random."""
    random, smallest = np.random.default_rng(0), np.inf
    error = np.array([[requirement.curvature_error], [requirement.stiffness_error], [requirement.stiffness_error]])
    for _ in range(PERTURBED_ROBOTS):
        curvature, bending, torsional = 1 + random.choice([-1.0, 1.0], (3, robot.n_tubes)) * error
        tubes = tuple(
            tube.resized("curvature", tube.curvature * float(curvature[i]))
            .resized("bending_stiffness", float(tube.bending_stiffness) * float(bending[i]))
            .resized("torsional_stiffness", float(tube.torsional_stiffness) * float(torsional[i]))
            for i, tube in enumerate(robot.tubes)
        )
        smallest = min(smallest, *(snap_free_certificate(ConcentricRobot(tubes), row) for row in translations))
    return smallest


@dataclass(frozen=True, eq=False)
class Reached:
    """Targets of one requirement with the poses that reach them."""

    requirement: Reach | Coverage
    poses: list[Equilibrium]
    """One per target."""
    distance: Array
    """(T,) distances of the tips from the targets, m."""
    tolerance: Array
    """(T,) largest allowed distances, m."""


def reached(program: Program, equilibria: Sequence[Equilibrium]) -> Iterator[Reached]:
    """Targets and points of workspace boxes, with the task poses that reach them."""
    row_of = {number: k for k, number in enumerate(program.task_poses)}
    requirements = program.task.requirements
    points = points_of(requirements, program.added)
    for requirement, pose_numbers, positions in zip(requirements, program.requirement_poses, points, strict=True):
        if not isinstance(requirement, Reach | Coverage):
            continue
        poses = [equilibria[row_of[number]] for number in pose_numbers]
        targets = requirement.targets if isinstance(requirement, Reach) else [requirement] * len(positions)
        distance = np.linalg.norm([e.tip_position for e in poses] - np.array(positions), axis=1)
        yield Reached(requirement, poses, distance, np.array([target.tolerance for target in targets]))


def _check_targets(program: Program, equilibria: tuple[Equilibrium, ...]) -> Iterator[Check]:
    """Checks of tip positions and directions at targets and in workspace boxes."""
    for each in reached(program, equilibria):
        distance, tolerance = each.distance, each.tolerance
        worst = int(np.argmax(distance / tolerance))
        name = f"largest distance of the tip from {len(distance)} targets"
        satisfied = bool(distance[worst] <= (1 + UNREACHED) * tolerance[worst])
        yield Check(name, f"{distance[worst] * 1e3:.4f} mm", satisfied)
        if isinstance(each.requirement, Coverage):
            continue
        for k, (target, pose) in enumerate(zip(each.requirement.targets, each.poses, strict=True)):
            if target.direction is not None:
                # Clipped: beyond 1 by round-off, arccos is NaN.
                cosine = np.clip(pose.tip_rotation[:, 2] @ np.array(target.direction), -1, 1)
                angle = float(np.arccos(cosine))
                satisfied = angle <= target.direction_tolerance + TOLERANCE
                yield Check(f"direction at target {k + 1}", f"{np.degrees(angle):.3f} deg off", satisfied)


def solve_again(program: Program, robot: DesignedRobot, x: Array) -> tuple[Equilibrium, ...]:
    """Equilibria of all task poses by forward kinematics from scratch.

    If the robot must reach the poses on joint paths, these are the equilibria at the ends of the paths.
    """
    state = state_at(program, x)
    joints = [state.joint_values(k) for k in program.task_poses]
    if len(joints) > 1 and any(each.paths for each in of_kind(program.task.requirements, SnapFreeInUse)):
        paths = motions(program, robot, x)
        return (paths[0].equilibria[0], *(path.equilibria[-1] for path in paths))
    return tuple(forward_kinematics(robot, *pair) for pair in joints)


def deployments(robot: DesignedRobot, equilibria: tuple[Equilibrium, ...]) -> tuple[Equilibrium, ...]:
    """Partly deployed arms of all poses."""
    return tuple(draw(robot, pose, fraction) for pose in equilibria for fraction in DEPLOYED_FRACTIONS)


@typed
@small
@limited
def count_snaps(
    robot: DesignedRobot,
    turns: int,
    seed: int = 0,
    translations: Array | None = None,
    *,
    time_limit: float = LONG_TIME_LIMIT,
) -> tuple[int, int]:
    """Numbers of snaps, and of full turns with a snap, when random tubes turn in random directions.

    Every turn starts at the untwisted home, with all tubes bending to one side. At least one tube, and not all,
    rotates by a full turn in either direction, and then all tubes return to the start.

    Raises:
        TimeLimitError: `time_limit` (s) was reached before the last turn.
    """
    whole("turns", turns, 0)
    random = np.random.default_rng(seed)
    n = robot.n_tubes
    home = shifts(robot, translations)
    # A tube with negative curvature starts at half a turn: all bend to one side, without torsion.
    start = np.array([np.pi if tube.curvature < 0 else 0.0 for tube in robot.tubes])
    snaps, snapped = 0, 0
    for _ in range(turns):
        direction = np.zeros(n)
        # The last tube stays: turning all tubes together changes no shape, only relative turns do.
        direction[: n - 1] = random.choice([-1.0, 0.0, 1.0], n - 1)
        if n > 1 and not direction.any():
            direction[random.integers(n - 1)] = random.choice([-1.0, 1.0])
        # A random offset: from the exactly aligned home, a turn and its reverse are mirror images.
        offset = start + random.uniform(-0.5, 0.5, n)
        rotations = np.array([start, offset, offset + 2 * np.pi * direction, offset, start])
        count = len(follow(robot, rotations, np.tile(home, (5, 1))).snaps)
        snaps, snapped = snaps + count, snapped + (count > 0)
    return snaps, snapped


class _TubeSections(NamedTuple):
    """Properties of one tube at m arc lengths."""

    precurvature: Array
    """Curvature x + j y (m,) in the frame of the tube, 1/m."""
    stiffness: Array
    """Bending stiffness (m,), N m^2."""
    strain_ratio: Array
    """Strain (m,) relative to the strain of a tube without slots."""


def _sections_at(tube: Tube, s: Array) -> _TubeSections:
    """Properties at s (m,), m, from the end of the straight part."""
    uncut = float(tube.bending_stiffness)
    precurvature, stiffness, ratio = np.zeros(len(s), dtype=complex), np.full(len(s), uncut), np.ones(len(s))
    start = 0.0
    for piece in tube.chain:
        inside = (s > start) & (s <= start + piece.length)
        x, y, kb = (
            part(s[inside] - start) if isinstance(part, Series) else part
            for part in (*piece.precurvature[:2], piece.bending_stiffness)
        )
        precurvature[inside] = x + 1j * y
        stiffness[inside] = uncut if kb is None else kb
        ratio[inside] = piece.strain_ratio(uncut)
        start += piece.length
    return _TubeSections(precurvature, stiffness, ratio)


def largest_strain(requirement: Strain, robot: DesignedRobot, equilibria: tuple[Equilibrium, ...]) -> Array:
    """Largest bending strain (n,) of every tube, straightened and in poses as required. Independent of physics.torsion.

    In poses it is evaluated on both sides of every shape point, from the balance of bending moments.
    """
    largest = np.array([tube.straightened_strain if requirement.straightened else 0.0 for tube in robot.tubes])
    for e in equilibria if requirement.in_poses else ():
        if isinstance(robot, BundleRobot):
            largest = np.maximum(largest, _bundle_strain(robot, e))
            continue
        for offset in (-1e-9, 1e-9):  # m: the arm's curvature jumps at breakpoints
            s = e.arc_length + offset
            # In front of the plate, up to the end of the tube: its translation and its curved length.
            present = (s > 0) & (s < e.translations[:, None] + np.array([[tube.curved_length] for tube in robot.tubes]))
            sections = [_sections_at(tube, s - d) for tube, d in zip(robot.tubes, e.translations, strict=True)]
            kb = present * np.array([section.stiffness for section in sections])
            # u* e^(j theta) in the common frame. Without a load, sum kb_i (u - u*_i) = 0:
            # the arm has their weighted mean.
            rotated = [
                section.precurvature * np.exp(1j * theta) for section, theta in zip(sections, e.rotation, strict=True)
            ]
            u = (kb * rotated).sum(axis=0) / np.maximum(kb.sum(axis=0), 1e-300)
            for i, (tube, section) in enumerate(zip(robot.tubes, sections, strict=True)):
                bend, radius = np.abs(u - rotated[i]), tube.outer_diameter / 2
                strain = section.strain_ratio * surface_strain(radius, bend, np.abs(section.precurvature))
                largest[i] = max(largest[i], strain[present[i]].max(initial=0.0))
    return largest


def _bundle_strain(robot: BundleRobot, e: Equilibrium) -> Array:
    """Largest bending strain (n,) of every tube of a bundle in an equilibrium.

    Own arc lengths, at which a tube begins to curve and ends, are integrals of its stretch along the arm.
    """
    lever = np.array(robot.offset)[:, None] * np.column_stack([np.sin(robot.angle), -np.cos(robot.angle)])
    largest, stretch = np.zeros(robot.n_tubes), 1 + lever @ e.curvature.T
    middle = (e.arc_length[1:] + e.arc_length[:-1]) / 2
    for i, tube in enumerate(robot.tubes):
        # The places of the sections are known: the last place where the tube is straight is one of them.
        own = scipy.integrate.cumulative_simpson(stretch[i], x=e.arc_length, initial=0.0)
        starts = e.section_start[np.abs(np.interp(e.section_start, e.arc_length, own) - e.translations[i]) < 1e-5]
        curves_from = float(starts[0]) if len(starts) else (0.0 if e.translations[i] <= 0 else np.inf)
        for k in np.flatnonzero(middle < e.tube_end[i]):
            natural = tube.curvature if middle[k] > curves_from else 0.0
            for j in (k, k + 1):
                direction = np.array([np.cos(e.rotation[i, j]), np.sin(e.rotation[i, j])])
                bend = float(np.linalg.norm(e.curvature[j] / stretch[i, j] - natural * direction))
                largest[i] = max(largest[i], surface_strain(tube.outer_diameter / 2, bend, abs(natural)))
    return largest


def arm_distance(body: Any, robot: DesignedRobot, equilibrium: Equilibrium) -> float:
    """Smallest distance (m) from a body to the arm's surface at its shape points in front of the plate."""
    if isinstance(robot, BundleRobot):
        width = robot.sheath_diameter or robot.least_sheath_diameter
        return float((body.signed_distance(equilibrium.position) - width / 2)[1:].min())
    ends = equilibrium.tube_end
    radius = np.array([tube.outer_diameter / 2 for tube in robot.tubes])
    arm_radius = np.array([radius[np.flatnonzero(ends >= s - 1e-9)].max() for s in equilibrium.arc_length])
    return float((body.signed_distance(equilibrium.position) - arm_radius)[1:].min())


def _mm(value: float) -> str:
    return f"{value * 1e3:.4f} mm"


def numbers_of(robot: DesignedRobot, equilibria: Sequence[Equilibrium]) -> Look:
    """Function that evaluates quantities of a robot and of its equilibria.

    Loaded poses and withdrawn arms are solved by forward kinematics, points on the arm by adaptive integration.
    """

    def value_of(quantity: Quantity) -> Array:
        """Numbers (k,) of one quantity."""
        if quantity.name == "certificate":
            return np.array([snap_free_certificate(robot, np.array(quantity.at))])
        if quantity.name == "channel" and isinstance(robot, BundleRobot):
            return np.array([channel_between(robot).diameter])
        if quantity.name in (*SHEATH, *PLACES) and isinstance(robot, BundleRobot):
            value = getattr(robot, quantity.name)
            return np.atleast_1d(robot.least_sheath_diameter if value is None else value)
        if quantity.name == "straightened_strain":
            tube, number = robot.tubes[quantity.at[0]], quantity.at[1]
            return np.array([piece_strain(tube, tube.pieces[number]) if tube.pieces else tube.straightened_strain])
        if quantity.pose is None:
            return np.array([getattr(tube, quantity.name) for tube in robot.tubes])
        if isinstance(quantity.pose, int):
            pose = equilibria[quantity.pose]
        else:
            number, fraction = quantity.pose
            pose = draw(robot, equilibria[number], fraction)
        match quantity.name:
            case "strain":
                in_pose = Strain((1.0,) * robot.n_tubes, straightened=False, in_poses=True)
                return largest_strain(in_pose, robot, (pose,))[list(quantity.at)]
            case "clearance":
                # A recorded clearance has a row for each part of the arm; the smallest of all is the strictest for
                # each.
                return np.full(CLEARANCES, arm_distance(quantity.at[0], robot, pose))
            case "deflection":
                return under_load(pose, quantity.at[0]).tip_position - pose.tip_position
            case "margin_under":
                return np.array([sure_margin(under_load(pose, quantity.at[0]))])
            case "stroke_force":
                limit = find_stroke_force(robot, pose.rotations, pose.translations, equilibrium=pose, up_to=STRONGEST)
                return np.array([STRONGEST if limit is None else limit.factor])
            case "jacobian":
                return pose.jacobian().position.ravel(order="F")
            case "turning":
                return pose.jacobian().rotation.ravel(order="F")
            case "tip_direction":
                return np.asarray(pose.tip_rotation[:, 2])
            case "position" | "curvature":
                point, u = point_at(pose, quantity.at[0] * float(pose.arc_length[-1]))
                return point if quantity.name == "position" else u
            case name:
                return np.atleast_1d(getattr(pose, name))

    return value_of


def check_custom(requirement: CustomRequirement, robot: DesignedRobot, equilibria: Sequence[Equilibrium]) -> Check:
    """Check of a custom requirement, by its expression at the numbers of the robot and its equilibria."""
    pieces = [len(tube.pieces) or 1 for tube in robot.tubes]
    expression = recorded(requirement.expression, robot.n_tubes, len(equilibria), requirement.description, pieces)
    try:
        excess = float(expression(numbers_of(robot, equilibria)).min())
    except FloatingPointError:
        return Check(requirement.description, "not a finite number", False)
    value = requirement.limit - excess if requirement.is_upper_bound else requirement.limit + excess
    satisfied = excess >= -RELATIVE_TOLERANCE * requirement.size
    return Check(requirement.description, f"{value * requirement.factor:.6g} {requirement.unit}".strip(), satisfied)
