"""Increments of a motion with friction between the tubes: each state follows from the one before.

Slip is a property of the material. In an increment in which tube i advances by dz_i, the material of tube i at arc
length s was at s - dz_i before. So the slip is the change of the relative rotation of the outer tube o and the inner
tube i from theta_o(s - dz_o) - theta_i(s - dz_i) before to theta_o(s) - theta_i(s) after.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np

from ..block.transcription import arm as arms
from ..block.transcription import loaded
from ..block.transcription.arm import EXTRA_QUADRATURE_POINTS, Errors
from ..block.transcription.buffered import section_function
from ..block.transcription.bundle import VANISHING, BundleState, VanishingError, opened, place_slopes
from ..block.transcription.contact import (
    DEGREE,
    SHEATH,
    BundleContact,
    Contact,
    ContactState,
    Material,
    bending_of,
    contact_profile,
    evaluate_contact,
    make_contact,
    pressed,
    unknowns_of,
)
from ..block.transcription.loaded import LoadedProblem, LoadedState, load_problem
from ..block.transcription.mesh import sections_at
from ..block.transcription.reduced import reduce, to_unknowns
from ..block.transcription.second_variation import least
from ..block.transcription.tableau import tableau
from ..errors import InputError, SolveError
from ..robots.concentric import Friction, check_friction
from ..robots.eccentric import BundleRobot, EccentricRobot, SegmentedEccentricRobot
from ..robots.load import Load
from ..robots.robot import Robot
from ..solvers.compiled.friction import FrictionStart, FrictionStates, friction_motion
from ..solvers.friction_increment import FRICTION_TOLERANCE, Increment, held_margin, imbalance, increment
from ..solvers.newton import NewtonResult, full_steps
from ..solvers.settings import LEAST_STIFFNESS, NEWTON, ONWARD
from ..typing import Array, Index
from .bundle import Bundled
from .continuation import steps_along
from .kinematics import equilibrium_of
from .member import AnyPoint, Loaded, Point, Unloaded, at_points, lever, sample_rotation
from .problem import Discretisation, check_load, loading_of
from .result import Equilibrium, FrictionState, Status

EIGENVALUE_ROUND_OFF = 1e-13
"""Round-off of a smallest eigenvalue."""


@dataclass(frozen=True, eq=False)
class FrictionEquilibrium:
    """State of a robot with friction."""

    contact: Any
    """Equations and friction law on one mesh: a `Contact`; a `BundleContact` of `BundleFriction`."""
    rotations: Array
    """(n,) joint rotations, rad."""
    translations: Array
    """(n,) joint translations, m."""
    increment: Increment
    """Solution of the increment that ended in this state."""
    heat: float
    """Heat of friction since the start of the history, J."""
    tangent: tuple[Array, Array] | None = None
    """Changes of the joint rotations (n,) and of x (X,) in the last increment on the same contact."""

    @property
    def load(self) -> Load | None:
        """External load, or None."""
        load: Load | None = self.contact.load
        return load

    @cached_property
    def profile(self) -> arms.Profile:
        """Torsion along the arm."""
        return contact_profile(self.contact, self.rotations, self.increment.state, self.increment.torque)

    @cached_property
    def margin(self) -> float:
        """Margin without friction: smallest eigenvalue of the second variation."""
        return least(self.contact.form(self.increment.state)[0])

    @cached_property
    def held_margin(self) -> float:
        """Smallest eigenvalue over the motions without slip at sticking contacts, between the margin and 1."""
        if self.increment.signs.all() or self.margin > 1 - EIGENVALUE_ROUND_OFF:
            return self.margin
        return held_margin(self.increment.state, self.increment.signs)

    def theta(self, arc_length: Array) -> Array:
        """(X, n) elastic rotations at arc lengths (X,), m; behind the plate by the twist of the transmission."""
        problem = self.contact.problem
        if not len(problem.mesh.length):  # an arm of length 0 has no twist
            return np.tile(self.rotations, (len(arc_length), 1))
        inside = arms.interpolate(problem, self.profile, np.maximum(arc_length, 0.0))
        behind = np.minimum(arc_length, 0.0)
        if behind.any():
            # Behind the plate the torque is constant: theta falls by it times the compliance up to the plate.
            position = np.maximum(problem.assembly.transmission + behind[:, None], 0.0)
            compliance = problem.assembly.compliant(position) - problem.compliant.transmission
            inside += compliance * self.profile.torque[0]
        return inside


@dataclass(frozen=True, eq=False, kw_only=True)
class BundleFriction(FrictionEquilibrium):
    """State of a bundle with friction of its tubes in their channels."""

    member: Bundled
    """Equations without friction."""
    errors: Errors | None = None
    """Estimated errors, if known."""

    @property
    def point(self) -> AnyPoint:
        """State as a point of the equations without friction."""
        return Point(0.0, self.member, self.increment.state.elastic, 1.0)

    @property
    def before(self) -> Material:
        """Material of this state, from which the next slips are measured."""
        return Material(self.increment.state.elastic, self.rotations, self.translations)


@lru_cache(maxsize=64)
def contact_of(robot: Robot, translations: tuple[float, ...], friction: Friction, load: Load | None = None) -> Contact:
    """Contact equations of a robot at translations, with or without a load, built once for all rotations."""
    if load is None:
        return make_contact(robot.assembly(np.array(translations)), friction)
    check_load(robot, load, translations)
    assembly, loading = loading_of(robot, translations, load)
    return make_contact(assembly, friction, loading)


def validate_friction(robot: Robot, friction: Friction) -> None:
    """Raise InputError for friction of another number of tubes, or for a robot without an energy."""
    if isinstance(robot, (EccentricRobot, SegmentedEccentricRobot)):
        raise InputError(
            "friction is given for a robot of kind eccentric; it is supported for concentric robots and bundles "
            "(model: energy in the file, bundle() in Python)"
        )
    check_friction(friction, robot.n_tubes, channels=isinstance(robot, BundleRobot))


def rest(robot: Robot, equilibrium: Equilibrium, friction: Friction) -> FrictionEquilibrium:
    """Equilibrium as the start of a motion with friction; without friction a history starts there.

    Raises:
        InputError: an equilibrium with another friction.
        SolveError: an equilibrium of another robot.
    """
    stored = equilibrium.friction
    if stored is not None and stored.friction != friction:
        raise InputError("start has a different friction; use the same friction, or a start without friction")
    if isinstance(robot, BundleRobot):
        return _bundle_at_rest(robot, equilibrium, friction)
    shift = equilibrium.translations
    contact = contact_of(robot, tuple(shift.tolist()), friction, equilibrium.load)
    if stored is None:
        return shaken(contact, equilibrium)
    points, bending = _sampled(contact, equilibrium)
    if len(stored.capacity) == len(contact.capacity):
        contact = replace(contact, capacity=np.array(stored.capacity))
    at = contact.concentrated_at
    between = sample_rotation(equilibrium, at)[np.arange(len(at)), contact.tube]
    x = unknowns_of(contact, equilibrium.rotations, points, between, bending)
    state = evaluate_contact(contact, equilibrium.rotations, x)
    return FrictionEquilibrium(contact, equilibrium.rotations, shift, _stored(state, stored), stored.heat)


def _stored(state: ContactState, stored: FrictionState) -> Increment:
    """Increment with stored torques that ended in a state; raises SolveError if they are not in balance."""
    torque = np.array(stored.torque)
    if len(torque) != len(state.capacity) or imbalance(state, torque) > 1e-6:
        raise SolveError("start is not in balance with its friction: it belongs to another robot")
    # Slip is stored only as a torque at its limit, which a file may have rounded in the last digit.
    slips = np.abs(torque) >= state.capacity * (1 - 1e-12)
    signs = (np.sign(torque) * slips).astype(np.int8)
    return Increment(
        state=state, torque=torque, signs=signs, heat=0.0, converged=True, contraction=0.0, violation=stored.violation
    )


def _bundle_at_rest(robot: BundleRobot, equilibrium: Equilibrium, friction: Friction) -> BundleFriction:
    """State of a bundle at an equilibrium; arguments and errors as of `rest`."""
    stored, alpha, shift = equilibrium.friction, equilibrium.rotations, equilibrium.translations
    member, x = Bundled.of_equilibrium(equilibrium, equilibrium.load, None)
    member, errors = replace(member, robot=robot), None
    if stored is None:
        d = Discretisation(degree=DEGREE, refinement=max(friction.refinement, 0))
        if (member.discretisation.degree, member.discretisation.refinement) != (d.degree, d.refinement):
            finer = member.on(degree=d.degree, refinement=d.refinement)
            x, member = finer.transfer(Point(0.0, member, member.at(x), 1.0)), finer
        relaxed = member.solve(x)
        if not relaxed.converged:
            raise SolveError("Newton's method does not converge from start on the friction mesh")
        elastic = relaxed.state
    else:
        elastic, errors = member.at(x), Errors(equilibrium.mesh_error, equilibrium.tip_error, 0.0)
    member = member.owner(elastic)
    contact = bundle_contact(member, friction, Material(elastic, alpha, shift))
    state = contact.of(alpha, elastic)
    none = np.zeros(len(state.rows))
    result = (
        Increment(
            state=state,
            torque=none,
            signs=none.astype(np.int8),
            heat=0.0,
            converged=True,
            contraction=0.0,
            violation=0.0,
        )
        if stored is None
        else _stored(state, stored)
    )
    return BundleFriction(
        contact, alpha, shift, result, 0.0 if stored is None else stored.heat, member=member, errors=errors
    )


def bundle_contact(member: Bundled, friction: Friction, before: Material, *, falls: bool = False) -> BundleContact:
    """Contact of a bundle with slips measured from `before`; if it `falls`, boundaries that meet stay together."""
    around = dict.fromkeys(range(member.problem.n), SHEATH) | dict(member.robot.nested_pairs)
    shift = np.array(member.translations)
    member = replace(member, rescales=False)
    advanced = member.moved if falls else member.advanced
    return BundleContact(member.problem, friction, tuple(around.items()), member.rotations, shift, before, advanced)


def shaken(contact: Contact, equilibrium: Equilibrium) -> FrictionEquilibrium:
    """State without friction torques at an equilibrium, as after vibration.

    Raises:
        SolveError: an equilibrium of another robot.
    """
    alpha = equilibrium.rotations
    points, bending = _sampled(contact, equilibrium)
    parts = [to_unknowns(contact.problem, alpha, points), np.zeros(contact.rotation_by_y.shape[1])]
    if contact.loaded is not None and bending is not None:
        parts.insert(1, (bending / contact.loaded.softness[:, None]).ravel())
    relaxed = full_steps(
        evaluate_contact(contact, alpha, np.concatenate(parts)),
        lambda state, change: evaluate_contact(contact, alpha, state.x + change),
        lambda _, change: contact.largest_rotation(change),
        lambda state: contact.largest_rotation(state.gradient),
        NEWTON.iterations,
    )
    if not relaxed.converged:
        raise SolveError("Newton's method does not converge from start on the friction mesh")
    zero = np.zeros(len(contact.capacity))
    contact = pressed(contact, points, bending)
    result = Increment(
        state=replace(relaxed.state, contact=contact, capacity=contact.capacity),
        torque=zero,
        signs=zero.astype(np.int8),
        heat=0.0,
        converged=True,
        contraction=0.0,
        violation=0.0,
    )
    return FrictionEquilibrium(contact, alpha, equilibrium.translations, result, 0.0)


def _sampled(contact: Contact, equilibrium: Equilibrium) -> tuple[Array, Array | None]:
    """Elastic rotations (N, n) and bending (N, 2), 1/m, of an equilibrium at the points of a contact.

    Bending is the curvature less the natural one of the rotations; None without a load.
    """
    problem = contact.loaded
    if problem is None:
        return sample_rotation(equilibrium, contact.problem.arc_length), None
    theta, curvature = at_points(equilibrium, problem)
    if curvature is None:
        return theta, np.zeros((len(problem.softness), 2))
    x = loaded.unknowns(problem, equilibrium.rotations, theta, curvature)
    return theta, bending_of(contact, x)


def step(
    robot: Robot, current: FrictionEquilibrium, rotations: Array, translations: Array, load: Load | None = None
) -> FrictionEquilibrium | None:
    """State after an increment to other joint values (n,) and another load; None if Newton's method fails."""
    if isinstance(current, BundleFriction):
        return _bundle_step(robot, current, rotations, translations, load)
    contact, before, x = start_increment(robot, current, rotations, translations, load)
    same_contact = contact.problem is current.contact.problem
    turn, shift = rotations - current.rotations, translations - current.translations

    sliding, guess, signs = None, x, None
    if same_contact:
        # The same rows stick or slip as before.
        guess, signs = x + _onward(current, turn, len(x)), current.increment.signs
    elif contact.friction.sliding:
        sliding = _slides(robot, contact.pair, shift[contact.pair + 1] - shift[contact.pair])

    result = increment(contact, rotations, guess, before, signs, sliding)
    if result is None or not result.converged:
        return None
    tangent = (turn, result.state.x - x) if same_contact else None
    return FrictionEquilibrium(contact, rotations, translations, result, current.heat + result.heat, tangent)


def _onward(current: FrictionEquilibrium, turn: Array, size: int) -> Array:
    """Change of x (X,) as in the last increment, if the joints turn on in the same direction; else 0."""
    if current.tangent is None or len(current.tangent[1]) != size:
        return np.zeros(size)
    last_turn, last_change = current.tangent
    along, square = float(turn @ last_turn), float(last_turn @ last_turn)
    onward = along > ONWARD * np.sqrt(square * float(turn @ turn)) > 0
    return last_change * (along / square if onward else 0.0)


def _slides(robot: Robot, inner: Index, shift: Array) -> Array:
    """Slides (R,) along the axis over the friction radius, rad, of inner tubes (R,) that what is around them shifts by
    (R,), m.
    """
    # At the surface a rotation moves the material by r dtheta, a translation by dz: dz / r compares both.
    radius = np.array([tube.outer_diameter / 2 for tube in robot.tubes])
    sliding = np.abs(shift) / radius[inner]
    return np.where(sliding > FRICTION_TOLERANCE, sliding, 0.0)


def _bundle_step(
    robot: Robot, current: BundleFriction, rotations: Array, translations: Array, load: Load | None
) -> BundleFriction | None:
    """State of a bundle after an increment; arguments as of `step`.

    Its boundaries are exchanged, and stay together, as in a solve without friction.
    """
    point, turn, shift = current.point, rotations - current.rotations, translations - current.translations
    member = replace(current.member, robot=robot).near(point, rotations, tuple(translations.tolist()), load, 1.0)
    friction, known = current.contact.friction, current.contact.place
    ends: dict[int, Increment] = {}

    def solved(start: BundleState, advanced: Any, *_: Any) -> NewtonResult[BundleState]:
        contact = bundle_contact(replace(member, problem=start.problem), friction, current.before)
        contact, place = replace(contact, advanced=advanced), contact.place
        same = all(np.array_equal(getattr(known, name), getattr(place, name)) for name in ("inner", "outer", "point"))
        sliding = None
        if friction.sliding and shift.any():
            outer = np.where(place.outer == SHEATH, 0.0, shift[place.outer])
            sliding = _slides(robot, place.inner, outer - shift[place.inner])
        signs = current.increment.signs if same and sliding is None else None
        result = increment(contact, rotations, start.x, np.zeros(len(place.inner)), signs, sliding)
        if result is None:
            return NewtonResult(start, False, 0, np.inf)
        elastic = result.state.elastic
        # The forces on boundaries that stay together contain those of friction.
        state = replace(elastic, by_bend=elastic.by_bend + result.torque @ result.state.rows_by_bend)
        if result.converged:
            ends[id(state)] = result
        return NewtonResult(state, result.converged, 0, result.contraction)

    x = member.transfer(point)
    result = replace(member, rescales=False).newton(x + _onward(current, turn, len(x)), solved, solved)
    if not ends:
        return None
    # Ends of tubes that would only separate by a jump stay together.
    last = ends[id(result.state)] if result.converged else list(ends.values())[-1]
    last = replace(last, contraction=result.contraction if result.converged else 0.0)
    tangent = (turn, last.state.x - x) if len(last.state.x) == len(x) and not shift.any() else None
    heat, owner = current.heat + last.heat, member.owner(last.state.elastic)
    return BundleFriction(last.state.contact, rotations, translations, last, heat, tangent, member=owner)


class IncrementStart(NamedTuple):
    """State at which an increment starts."""

    contact: Any
    """Contact equations at the joint values and load after the increment."""
    before: Array
    """(R,) relative rotations of the material before it, rad."""
    x: Array
    """(X,) unknowns with all tubes turned with their joints."""


def start_increment(
    robot: Robot, current: FrictionEquilibrium, rotations: Array, translations: Array, load: Load | None = None
) -> IncrementStart:
    """State at which an increment to other joint values (n,) and another load starts."""
    if isinstance(current, BundleFriction):
        shift = tuple(translations.tolist())
        member = replace(current.member, robot=robot).near(current.point, rotations, shift, load, 1.0)
        falling = bundle_contact(member, current.contact.friction, current.before, falls=True)
        x = opened(member.problem, member.transfer(current.point), VANISHING)
        return IncrementStart(falling, np.zeros(len(falling.pair)), x)
    moved = translations - current.translations
    if not moved.any() and load == current.load:
        state = current.increment.state
        contact = pressed(current.contact, state.elastic.theta, bending_of(current.contact, state.x))
        return IncrementStart(contact, state.relative_rotations, state.x)
    contact = contact_of(robot, tuple(translations.tolist()), current.contact.friction, load)
    pair, s, points = contact.pair, contact.arc_length, contact.problem.arc_length
    # The material at s was at s - dz_i on tube i.
    arc_lengths = (points, contact.concentrated_at, s - moved[pair], s - moved[pair + 1])
    theta = current.theta(np.concatenate(arc_lengths))
    at_points, between, inner, outer = np.split(theta, np.cumsum([len(part) for part in arc_lengths])[:-1])
    row, joint = np.arange(len(pair)), np.arange(len(contact.concentrated_at))
    before = outer[row, pair + 1] - inner[row, pair]
    turn = rotations - current.rotations
    at_joints = (between + turn)[joint, contact.tube]
    bending = bent_at(current, contact)
    x = unknowns_of(contact, rotations, at_points + turn, at_joints, bending)
    return IncrementStart(pressed(contact, at_points, bending), before, x)


def bent_at(current: FrictionEquilibrium, contact: Contact) -> Array | None:
    """(N, 2) bending of a state, 1/m, at the points of a contact; None for one without a load."""
    bending = bending_of(current.contact, current.increment.state.x)
    if contact.loaded is None or current.contact is contact:
        return bending if contact.loaded is not None else None
    if bending is None or current.contact.loaded is None:
        return np.zeros((len(contact.loaded.softness), 2))
    return np.asarray(current.contact.loaded.mesh.interpolated(bending, contact.loaded.torsion.arc_length))


def to_held_equilibrium(robot: Robot, current: FrictionEquilibrium, start: str) -> Equilibrium:
    """Equilibrium of a state with friction, with shape, energy and error estimates."""
    contact, state, problem = current.contact, current.increment.state, current.contact.problem
    shift = tuple(current.translations.tolist())
    error = 0.0 if isinstance(current, BundleFriction) else _smooth_error(current) + _front_error(current)
    if isinstance(current, BundleFriction):
        plain = _in_sheath(current, start)
    elif isinstance(state.elastic, LoadedState):
        plain = _under_load(robot, current, state.elastic, start, error)
    else:
        # Friction torques are part of the balance: the residual is the gradient with them.
        balance = (state.gradient + state.rows.T @ current.increment.torque)[: problem.size]
        torsion = replace(state.elastic, gradient=balance, energy=state.energy)
        member = Unloaded(robot, problem, current.rotations, shift, Discretisation(degree=DEGREE))
        shape = member.solution(Point(0.0, member, torsion, current.margin), current.profile, error)
        plain = equilibrium_of(member, shape, start, method="increment")
    friction = FrictionState(
        friction=contact.friction,
        arc_length=tuple(_arc_lengths(current).tolist()),
        pair=tuple(contact.pair.tolist()),
        torque=tuple(current.increment.torque.tolist()),
        capacity=tuple(state.capacity.tolist()),
        held_margin=current.held_margin,
        heat=current.heat,
        violation=current.increment.violation,
    )
    status = Status.STABLE if current.margin > 0 else (Status.HELD if current.held_margin > 0 else Status.UNSTABLE)
    result = replace(plain, status=status, friction=friction)
    if "base_wrench" in vars(plain):
        # The state's own: recomputed from the shape it would lack the friction torques.
        vars(result)["base_wrench"] = plain.base_wrench
    return result


def _arc_lengths(current: FrictionEquilibrium) -> Array:
    """Arc lengths (R,) of the rows of friction, m."""
    if isinstance(current, BundleFriction):
        return np.asarray(current.contact.place.up_to @ current.increment.state.elastic.h)
    return np.asarray(current.contact.arc_length)


def _in_sheath(current: BundleFriction, start: str) -> Equilibrium:
    """Equilibrium of a bundle with friction; its errors are the change of the same increment with more points."""
    state, torque = current.increment.state, current.increment.torque
    solution = current.member.solution(replace(current.point, margin=current.margin))
    errors = current.errors or (_bundle_errors(current) if torque.any() else solution.errors)
    solved = replace(solution, residual=imbalance(state, torque), errors=errors)
    return equilibrium_of(current.member, solved, start, method="increment" if torque.any() else "newton")


def _bundle_errors(current: BundleFriction) -> Errors:
    """Errors of a state after an increment; infinite if the increment has no state on the finer mesh."""
    finer = current.member.on(degree=current.member.discretisation.degree + EXTRA_QUADRATURE_POINTS)
    contact, x = bundle_contact(finer, current.contact.friction, current.contact.before), finer.transfer(current.point)
    try:
        result = increment(contact, current.rotations, x, np.zeros(len(contact.pair)))
    except VanishingError:
        result = None
    if result is None:
        return Errors(np.inf, np.inf, 0.0)
    last = len(finer.problem.order) - 1
    tips = [place_slopes(each, last).position for each in (result.state.elastic, current.increment.state.elastic)]
    theta = finer.problem.push(result.state.x - x)[:, : finer.problem.n]
    return Errors(float(np.abs(theta).max()), float(np.linalg.norm(tips[0] - tips[1])), 0.0)


def _under_load(robot: Robot, held: FrictionEquilibrium, state: LoadedState, start: str, error: float) -> Equilibrium:
    """Equilibrium of a state under a load; `error` (rad) is the mesh error of the equations."""
    problem = held.contact.loaded
    assert problem is not None
    # A residual changes x by the inverse of the Hessian, whose largest eigenvalue is 1 / margin.
    theta_error = error / max(min(1.0, abs(held.margin)), LEAST_STIFFNESS)
    errors = Errors(theta_error, theta_error * lever(problem.torsion) + _bending_error(held), float("nan"))
    member = Loaded(robot, problem, held.rotations, tuple(held.translations.tolist()), Discretisation(degree=DEGREE))
    solved = replace(
        member.solution(Point(0.0, member, state, held.margin), held.profile, errors),
        energy=held.increment.state.energy + state.work,
        residual=imbalance(held.increment.state, held.increment.torque),
        index=0 if held.margin > 0 else int((np.linalg.eigvalsh(held.increment.state.hessian) < 0).sum()),
    )
    return equilibrium_of(member, solved, start, method="increment")


def _bending_error(current: FrictionEquilibrium) -> float:
    """Error of the tip, m, estimated from the bending equations at the points of a finer rule."""
    contact, finer = current.contact, _finer(current.contact)
    bending = bending_of(contact, current.increment.state.x)
    assert bending is not None
    assert contact.loaded is not None
    s = finer.torsion.arc_length
    z = to_unknowns(finer.torsion, current.rotations, arms.interpolate(contact.problem, current.profile, s))
    q = contact.loaded.mesh.interpolated(bending, s) / finer.softness[:, None]
    state = loaded.evaluate(finer, current.rotations, np.concatenate([z, q.ravel()]))
    residual = np.linalg.norm(state.gradient[finer.torsion.size :].reshape(-1, 2), axis=1)
    # An error of the bending at s moves the tip by its angle times the distance to the tip.
    return float((finer.torsion.weight * finer.softness * residual) @ (finer.torsion.assembly.total_length - s))


@lru_cache(maxsize=8)
def _finer(contact: Contact) -> LoadedProblem:
    """Loaded problem of a contact with EXTRA_QUADRATURE_POINTS more points on each element."""
    torsion, mesh, loading = contact.problem, contact.problem.mesh, contact.loading
    assert loading is not None
    unknown = np.zeros((torsion.assembly.n_sections, torsion.assembly.n_tubes), dtype=bool)
    unknown[mesh.section[torsion.point // mesh.tableau.degree], torsion.tube] = True
    rule = replace(mesh, tableau=tableau(mesh.tableau.family, mesh.tableau.degree + EXTRA_QUADRATURE_POINTS))
    return load_problem(reduce(torsion.assembly, rule, unknown), loading.load, loading.density)


def _smooth_error(current: FrictionEquilibrium) -> float:
    """Error of theta, rad, estimated from the moments of the tubes between the collocation points."""
    problem = current.contact.problem
    mesh, n, t = problem.mesh, problem.assembly.n_tubes, problem.mesh.tableau
    if not problem.size:
        return 0.0
    finer = _finer_points(current.contact)
    theta = arms.rotations_at(problem, current.profile, finer.nodes)[mesh.collocated]
    direction = theta.reshape(-1, n) + finer.phase
    sections = finer.stiffness, finer.moment
    moment = section_function("moment", len(direction), n, False)(direction, *sections)[0].copy()
    bending = bending_of(current.contact, current.increment.state.x)
    if (
        bending is not None
    ):  # M_i = m_i (u_x sin theta_i - u_y cos theta_i), with the natural curvature and bending in u
        x, y = (t.basis(finer.nodes, 0) @ bending.reshape(-1, t.degree, 2)).reshape(-1, 2).T[:, :, None]
        moment += finer.moment * (x * np.sin(direction) - y * np.cos(direction))
    moment = moment.reshape(theta.shape)
    collocated = current.increment.state.elastic.torque.reshape(-1, t.degree, n)
    return float((np.abs(moment - t.basis(finer.nodes, 0) @ collocated).max(1) * finer.turn).sum(0).max())


class _FinerPoints(NamedTuple):
    """Points of a finer rule on the collocated elements, and the tubes there."""

    nodes: tuple[float, ...]
    """Fractions of an element."""
    stiffness: Array
    moment: Array
    phase: Array
    turn: Array
    """(E, n) rotation of all beyond an element per moment on it, rad/N."""


@lru_cache(maxsize=8)
def _finer_points(contact: Contact) -> _FinerPoints:
    problem = contact.problem
    mesh, t = problem.mesh, problem.mesh.tableau
    nodes = tableau("gauss", t.degree + EXTRA_QUADRATURE_POINTS).nodes
    sections, collocated = sections_at(problem.assembly, mesh, nodes), np.repeat(mesh.collocated, len(nodes))
    lever = problem.assembly.transmission + (mesh.start + mesh.length)[mesh.collocated, None]
    return _FinerPoints(
        nodes=tuple(nodes.tolist()),
        stiffness=sections.stiffness[collocated],
        moment=sections.moment[collocated],
        phase=sections.phase[collocated],
        # An error of the moment on an element turns its tube by the compliance up to the end of the element.
        turn=mesh.length[mesh.collocated, None] * lever / sections.torsional_stiffness.min(0),
    )


def _front_error(current: FrictionEquilibrium) -> float:
    """Upper bound on the error of theta, rad, by slip zones that end between two points."""
    signs = current.increment.signs
    return float(sum(errors[np.diff(signs[rows]) != 0].sum() for rows, errors in _fronts(current.contact)))


@lru_cache(maxsize=8)
def _fronts(contact: Contact) -> list[tuple[Index, Array]]:
    """Rows (K,) of every pair along the arm, and the error (K - 1,) rad of a slip zone between two rows.

    The end is off by at most half a spacing, over which the full torque makes the rotation a parabola.
    """
    problem, out = contact.problem, []
    soft = problem.compliant.rate.max((0, 1), initial=0.0)
    for pair in np.unique(contact.pair):
        rows = np.flatnonzero((contact.pair == pair) & (contact.point >= 0))
        spacing = problem.weight[contact.point[rows]]
        per_length = (contact.capacity[rows] / spacing)[:-1]
        # c (h / 2)^2 / 2 = c h^2 / 8.
        widest = np.maximum(spacing[:-1], spacing[1:])
        out.append((rows, per_length * widest**2 / 8 * soft[[pair, pair + 1]].sum()))
    return out


def sweep(
    robot: Robot, current: FrictionEquilibrium, joints: Array, behind: Array, *, margins: bool = True
) -> FrictionStates | None:
    """States at rows of joint values (T, 2n) by the compiled kernel; None without a kernel for this robot and friction.

    The first row is that of `current`. There are fewer states if a step is too long or the robot snaps; then
    `friction_path.segment_with_friction` continues from the last one.

    Args:
        behind: (S,) distances of stations behind the tip at which the shape is returned, m.
        margins: whether to compute the margins.
    """
    start = FrictionStart(current.increment.state.x, current.increment.torque, current.increment.signs)
    steps, inputs = steps_along(robot, joints)
    many = friction_motion(robot, current.contact.friction, steps, start, behind, margins=margins)
    if many is None or len(steps) == len(joints):
        return many
    # Of the finer steps only the requested rows are reported.
    reached = inputs[(inputs > 0) & (inputs <= len(many.margin))] - 1
    return FrictionStates(**{field.name: getattr(many, field.name)[reached] for field in fields(FrictionStates)})


def swept(
    robot: Robot, current: FrictionEquilibrium, joints: Array, many: FrictionStates, k: int
) -> FrictionEquilibrium:
    """State after the k-th step from `current` along rows (T, 2n), from the results of `sweep`."""
    if not k:
        return current
    rotations, translations = np.split(joints[k], 2)
    contact = contact_of(robot, tuple(translations.tolist()), current.contact.friction)
    rows, heat, violation = len(contact.capacity), float(many.heat[k - 1]), float(many.violation[k - 1])
    contact = replace(contact, capacity=many.capacity[k - 1, :rows])
    state = evaluate_contact(contact, rotations, many.unknowns[k - 1, : contact.problem.size])
    torque, signs = many.torque[k - 1, :rows], many.signs[k - 1, :rows]
    result = Increment(state, torque, signs, heat, True, 0.0, violation)
    return FrictionEquilibrium(contact, rotations, translations, result, current.heat + heat)
