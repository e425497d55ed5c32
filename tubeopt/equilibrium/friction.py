"""A robot whose tubes rub, on its way: the state after every increment, and what the next one remembers of it.

What rubs at an arc length s was, before an increment in which tube i advanced by dz_i, at s - dz_i on tube i. Its slip
is what the rotation theta_o(s) - theta_i(s) of the outer tube in the inner one differs by from theta_o(s - dz_o) -
theta_i(s - dz_i) then: the memory is the material's.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache

import numpy as np

from ..block.transcription import arm as arms
from ..block.transcription import loaded
from ..block.transcription.arm import EXTRA_POINTS, ArmSolution, CollocationPoints
from ..block.transcription.buffered import section_function
from ..block.transcription.contact import (
    DEGREE,
    Contact,
    bent_of,
    evaluate_contact,
    make_contact,
    rubbing_profile,
    unknowns_of,
)
from ..block.transcription.loaded import LoadedProblem, LoadedState, base_wrench, load_problem, loaded_arm
from ..block.transcription.mesh import sections_at
from ..block.transcription.reduced import reduce, to_unknowns
from ..block.transcription.second_variation import least
from ..block.transcription.tableau import tableau
from ..errors import InputError, SolveError
from ..robots.concentric import Friction, check_friction
from ..robots.eccentric import EccentricRobot, SegmentedEccentricRobot
from ..robots.load import Load
from ..robots.robot import Robot
from ..solvers.compiled.rubbing import Rubbed, rub_compiled
from ..solvers.friction_increment import FRICTION_TOLERANCE, Increment, held_margin, imbalance, increment
from ..solvers.newton import full_steps
from ..solvers.settings import NEWTON, ONWARD
from ..typing import Array, Index
from .answer import at_points, equilibrium_of, sample_rotation
from .continuation import steps_along
from .member import Loaded, Point, Unloaded, lever
from .problem import Discretisation, check_load, loading_of
from .result import Equilibrium, FrictionState, Status

ROUND_OFF = 1e-13
"""Of a least eigenvalue."""


@dataclass(frozen=True, eq=False)
class FrictionEquilibrium:
    """A state of a robot whose tubes rub, at joint values (n,); heat (J) since its history began.

    tangent: how far the bases turned (n,), and x changed (X,), from the state before on the same contact.
    """

    contact: Contact
    rotations: Array
    translations: Array
    found: Increment
    heat: float
    tangent: tuple[Array, Array] | None = None

    @cached_property
    def profile(self) -> arms.Profile:
        """Torsion along the arm."""
        return rubbing_profile(self.contact, self.rotations, self.found.state, self.found.torque)

    @cached_property
    def margin(self) -> float:
        """The margin without friction: least eigenvalue of the second variation."""
        return least(self.found.state.hessian)

    @cached_property
    def held_margin(self) -> float:
        """The same along the motions that what sticks leaves free: between the margin and 1, since it is over fewer."""
        if self.found.signs.all() or self.margin > 1 - ROUND_OFF:
            return self.margin
        return held_margin(self.contact, self.found.state, self.found.signs)

    def theta(self, arc_length: Array) -> Array:
        """(X, n) elastic rotations at arc lengths (X,), m; behind the plate by the twist of the transmission."""
        problem = self.contact.problem
        if not len(problem.mesh.length):  # nothing twists an arm of length zero
            return np.tile(self.rotations, (len(arc_length), 1))
        inside = arms.interpolate(problem, self.profile, np.maximum(arc_length, 0.0))
        behind = np.minimum(arc_length, 0.0)
        if behind.any():
            # Behind the plate the torque is constant: theta falls by t times the compliance not passed yet.
            place = np.maximum(problem.assembly.transmission + behind[:, None], 0.0)
            softer = problem.assembly.compliant(place) - problem.here.transmission
            inside += softer * self.profile.torque[0]
        return inside


@lru_cache(maxsize=64)
def contact_of(robot: Robot, translations: tuple[float, ...], friction: Friction, load: Load | None = None) -> Contact:
    """The rows of friction of a robot at translations under a load or none, built once for all rotations."""
    if load is None:
        return make_contact(robot.assembly(np.array(translations)), friction)
    check_load(robot, load, translations)
    assembly, loading = loading_of(robot, translations, load)
    return make_contact(assembly, friction, loading)


def validate_friction(robot: Robot, friction: Friction) -> None:
    """Raise InputError for a robot or a friction of which there is no motion with friction."""
    check_friction(friction, robot.n_tubes)
    if isinstance(robot, (EccentricRobot, SegmentedEccentricRobot)):
        raise InputError("friction is given for an eccentric robot; it is supported for concentric robots only")


def rest(robot: Robot, equilibrium: Equilibrium, friction: Friction) -> FrictionEquilibrium:
    """An equilibrium as the start of a motion with friction: its own history goes on, or begins, where it has none.

    Raises:
        InputError: an equilibrium with another friction.
        SolveError: it is no equilibrium of this robot.
    """
    own = equilibrium.friction
    if own is not None and own.friction != friction:
        raise InputError("start has a different friction; use the same friction, or a start without friction")
    shift = equilibrium.translations
    contact = contact_of(robot, tuple(shift.tolist()), friction, equilibrium.load)
    if own is None:
        return shaken(contact, equilibrium)
    points, bent = _sampled(contact, equilibrium)
    between = sample_rotation(equilibrium, contact.place)[np.arange(len(contact.place)), contact.tube]
    x = unknowns_of(contact, equilibrium.rotations, points, between, bent)
    state = evaluate_contact(contact, equilibrium.rotations, x)
    torque = np.array(own.torque)
    if len(torque) != len(contact.capacity) or imbalance(contact, state, torque) > 1e-6:
        raise SolveError("start is not in balance with its friction: it belongs to another robot")
    # Slip is stored only as a torque at its limit, which a file may have rounded in the last digit.
    slips = np.abs(torque) >= contact.capacity * (1 - 1e-12)
    signs = (np.sign(torque) * slips).astype(np.int8)
    result = Increment(state, torque, signs, 0.0, True, 0.0, own.violation)
    return FrictionEquilibrium(contact, equilibrium.rotations, shift, result, own.heat)


def shaken(contact: Contact, equilibrium: Equilibrium) -> FrictionEquilibrium:
    """An equilibrium without friction as a state of a contact in which nothing bears any.

    Raises:
        SolveError: it is no equilibrium of the contact's robot.
    """
    alpha = equilibrium.rotations
    points, bent = _sampled(contact, equilibrium)
    parts = [to_unknowns(contact.problem, alpha, points), np.zeros(contact.loose.shape[1])]
    if contact.loaded is not None and bent is not None:
        parts.insert(1, (bent / contact.loaded.softness[:, None]).ravel())
    relaxed = full_steps(
        evaluate_contact(contact, alpha, np.concatenate(parts)),
        lambda state, change: evaluate_contact(contact, alpha, state.x + change),
        lambda _, change: contact.turn_of(change),
        lambda state: contact.turn_of(state.gradient),
        NEWTON.iterations,
    )
    if not relaxed.converged:
        raise SolveError("Newton's method does not converge from start on the friction mesh")
    nothing = np.zeros(len(contact.capacity))
    result = Increment(relaxed.state, nothing, nothing.astype(np.int8), 0.0, True, 0.0, 0.0)
    return FrictionEquilibrium(contact, alpha, equilibrium.translations, result, 0.0)


def _sampled(contact: Contact, equilibrium: Equilibrium) -> tuple[Array, Array | None]:
    """Elastic rotations (N, n) of an equilibrium at the points of a contact; under a load also the curvature (N, 2)
    there beyond that without load, 1/m."""
    problem = contact.loaded
    if problem is None:
        return sample_rotation(equilibrium, contact.problem.arc_length), None
    theta, curvature = at_points(equilibrium, problem)
    if curvature is None:
        return theta, np.zeros((len(problem.softness), 2))
    x = loaded.unknowns(problem, equilibrium.rotations, theta, curvature)
    return theta, bent_of(contact, x)


def step(
    robot: Robot, current: FrictionEquilibrium, rotations: Array, translations: Array, load: Load | None = None
) -> FrictionEquilibrium | None:
    """The state after an increment to other joint values (n,) and another load, by Newton's method; None where that is
    not at ease."""
    contact, before, x = carried(robot, current, rotations, translations, load)
    same = contact is current.contact
    slid = None if same or not contact.friction.sliding else _slid(robot, contact, translations - current.translations)
    turned = rotations - current.rotations
    # Without sliding the same rows stick or slip as before; on other rows nothing is known.
    guess, signs = (x + _ahead(current, turned), current.found.signs) if same else (x, None)
    result = increment(contact, rotations, guess, before, signs, slid)
    if result is None or not result.converged:
        return None
    tangent = (turned, result.state.x - x) if same else None
    return FrictionEquilibrium(contact, rotations, translations, result, current.heat + result.heat, tangent)


def _ahead(current: FrictionEquilibrium, turned: Array) -> Array | float:
    """By how much x changes when the bases turn on (n,) as they turned to a state; 0 where they turn another way."""
    if current.tangent is None:
        return 0.0
    last, change = current.tangent
    along, size = float(turned @ last), float(last @ last)
    straight = along > ONWARD * np.sqrt(size * float(turned @ turned)) > 0
    return change * (along / size) if straight else 0.0


def _slid(robot: Robot, contact: Contact, moved: Array) -> Array:
    """(R,) sliding of the tubes along each other, over the radius at which they rub, rad; 0 where it is round-off."""
    radius = np.array([tube.outer_diameter / 2 for tube in robot.tubes])
    # At the surface a turn moves r dtheta around and a slide dz along: dz / r compares both.
    slid = np.abs(moved[contact.pair + 1] - moved[contact.pair]) / radius[contact.pair]
    return np.where(slid > FRICTION_TOLERANCE, slid, 0.0)


def carried(
    robot: Robot, current: FrictionEquilibrium, rotations: Array, translations: Array, load: Load | None = None
) -> tuple[Contact, Array, Array]:
    """At other joint values, under another load: the contact, the relative rotations (R,) before the increment, and a
    first guess of x."""
    moved = translations - current.translations
    if not moved.any() and load == current.contact.load:
        return current.contact, current.found.state.turned, current.found.state.x
    contact = contact_of(robot, tuple(translations.tolist()), current.contact.friction, load)
    pair, s, points = contact.pair, contact.arc_length, contact.problem.arc_length
    # What is at s now was at s - dz_i on tube i: the slip is that of the material (see the top).
    where = (points, contact.place, s - moved[pair], s - moved[pair + 1])
    theta = current.theta(np.concatenate(where))
    at, between, inner, outer = np.split(theta, np.cumsum([len(part) for part in where])[:-1])
    row, spot = np.arange(len(pair)), np.arange(len(contact.place))
    before = outer[row, pair + 1] - inner[row, pair]
    turned = rotations - current.rotations
    x = unknowns_of(contact, rotations, at + turned, (between + turned)[spot, contact.tube], bent_at(current, contact))
    return contact, before, x


def bent_at(current: FrictionEquilibrium, contact: Contact) -> Array | None:
    """(N, 2) curvature of a state beyond that without load, 1/m, at the points of a contact; None where that has no
    load."""
    own = bent_of(current.contact, current.found.state.x)
    if contact.loaded is None or current.contact is contact:
        return own if contact.loaded is not None else None
    if own is None or current.contact.loaded is None:
        return np.zeros((len(contact.loaded.softness), 2))
    return current.contact.loaded.mesh.interpolated(own, contact.loaded.torsion.arc_length)


def to_held_equilibrium(robot: Robot, current: FrictionEquilibrium, start: str) -> Equilibrium:
    """A state with friction as an equilibrium, with its shape, energy and error estimates."""
    contact, state, problem = current.contact, current.found.state, current.contact.problem
    shift, error = tuple(current.translations.tolist()), _smooth_error(current) + _front_error(current)
    if isinstance(state.elastic, LoadedState):
        plain = _under_load(robot, current, state.elastic, start, error)
    else:
        # Friction is a force in the balance: the residual is the gradient with its torques.
        balance = (state.gradient + contact.rows.T @ current.found.torque)[: problem.size]
        torsion = replace(state.elastic, gradient=balance, energy=state.energy)
        member = Unloaded(robot, problem, current.rotations, shift, Discretisation(degree=DEGREE))
        shape = member.solution(Point(0.0, member, torsion, current.margin), current.profile, error)
        plain = equilibrium_of(member, shape, start, method="increment")
    friction = FrictionState(
        friction=contact.friction,
        arc_length=tuple(contact.arc_length.tolist()),
        pair=tuple(contact.pair.tolist()),
        torque=tuple(current.found.torque.tolist()),
        capacity=tuple(contact.capacity.tolist()),
        held_margin=current.held_margin,
        heat=current.heat,
        violation=current.found.violation,
    )
    status = Status.STABLE if current.margin > 0 else (Status.HELD if current.held_margin > 0 else Status.UNSTABLE)
    result = replace(plain, status=status, friction=friction)
    if "base_wrench" in vars(plain):
        # Kept with the state: what recomputes it from the shape knows no friction.
        vars(result)["base_wrench"] = plain.base_wrench
    return result


def _under_load(robot: Robot, held: FrictionEquilibrium, state: LoadedState, start: str, error: float) -> Equilibrium:
    """The equilibrium of a state under a load, whose rotations may be off by `error`, rad, over the margin."""
    problem = held.contact.loaded
    assert problem is not None
    # A residual moves x by the inverse of the Hessian, whose largest eigenvalue is 1 / margin.
    off = error / max(min(1.0, abs(held.margin)), 1e-6)
    arm, s = loaded_arm(problem, held.profile, state), problem.torsion.arc_length
    result = ArmSolution.of(
        arm,
        problem.torsion.assembly,
        points=CollocationPoints(s, state.theta + problem.wound, state.curvature),
        margin=held.margin,
        energy=held.found.state.energy + state.work,
        residual=imbalance(held.contact, held.found.state, held.found.torque),
        errors=(off, off * lever(problem.torsion) + _bending_error(held), float("nan")),
        iterations=0,
        index=0 if held.margin > 0 else int((np.linalg.eigvalsh(held.found.state.hessian) < 0).sum()),
        work=state.work,
        base_wrench=base_wrench(problem, state),
    )
    shift = tuple(held.translations.tolist())
    member = Loaded(robot, problem, held.rotations, shift, Discretisation(degree=DEGREE))
    return equilibrium_of(member, result, start, method="increment")


def _bending_error(current: FrictionEquilibrium) -> float:
    """How far the tip is off, m, by what the equations of bending miss at the points of a finer rule."""
    contact, finer = current.contact, _finer(current.contact)
    bent = bent_of(contact, current.found.state.x)
    assert bent is not None
    assert contact.loaded is not None
    s = finer.torsion.arc_length
    z = to_unknowns(finer.torsion, current.rotations, arms.interpolate(contact.problem, current.profile, s))
    q = contact.loaded.mesh.interpolated(bent, s) / finer.softness[:, None]
    state = loaded.evaluate(finer, current.rotations, np.concatenate([z, q.ravel()]))
    missed = np.linalg.norm(state.gradient[finer.torsion.size :].reshape(-1, 2), axis=1)
    # A wrong bend at s moves the tip by its angle times the distance to the tip.
    return float((finer.torsion.weight * finer.softness * missed) @ (finer.torsion.assembly.total_length - s))


@lru_cache(maxsize=8)
def _finer(contact: Contact) -> LoadedProblem:
    """The loaded problem of a contact with EXTRA_POINTS more on each piece."""
    torsion, mesh, loading = contact.problem, contact.problem.mesh, contact.loading
    assert loading is not None
    unknown = np.zeros((torsion.assembly.n_sections, torsion.assembly.n_tubes), dtype=bool)
    unknown[mesh.section[torsion.point // mesh.tableau.degree], torsion.tube] = True
    rule = replace(mesh, tableau=tableau(mesh.tableau.family, mesh.tableau.degree + EXTRA_POINTS))
    return load_problem(reduce(torsion.assembly, rule, unknown), loading.load, loading.density)


def _smooth_error(current: FrictionEquilibrium) -> float:
    """Bound of what the collocated moments of the tubes are off between the points, as an error of a rotation, rad."""
    problem = current.contact.problem
    mesh, n, t = problem.mesh, problem.assembly.n_tubes, problem.mesh.tableau
    if not problem.size:
        return 0.0
    nodes, chosen, phase, arm = _between(current.contact)
    theta = arms.rotations_at(problem, current.profile, nodes)[mesh.collocated]
    direction = theta.reshape(-1, n) + phase
    moment = section_function("moment", len(direction), n, False)(direction, *chosen)[0].copy()
    bent = bent_of(current.contact, current.found.state.x)
    if bent is not None:  # M_i = m_i (u_x sin theta_i - u_y cos theta_i) of the whole curvature u
        x, y = (t.basis(nodes, 0) @ bent.reshape(-1, t.degree, 2)).reshape(-1, 2).T[:, :, None]
        moment += chosen[1] * (x * np.sin(direction) - y * np.cos(direction))
    moment = moment.reshape(theta.shape)
    own = current.found.state.elastic.torque.reshape(-1, t.degree, n)
    return float((np.abs(moment - t.basis(nodes, 0) @ own).max(1) * arm).sum(0).max())


@lru_cache(maxsize=8)
def _between(contact: Contact) -> tuple[tuple[float, ...], tuple[Array, Array], Array, Array]:
    """Finer points on a piece, stiffness and moment of the tubes there, what turns them against theta, and by how much
    a moment (N) on a piece turns the arm beyond, (E, n) rad per N."""
    problem = contact.problem
    mesh, t = problem.mesh, problem.mesh.tableau
    finer = tableau("gauss", t.degree + EXTRA_POINTS).nodes
    there, kept = sections_at(problem.assembly, mesh, finer), np.repeat(mesh.collocated, len(finer))
    stiffness, moment, phase = there.stiffness[kept], there.moment[kept], there.phase[kept]
    lever = problem.assembly.transmission + (mesh.start + mesh.length)[mesh.collocated, None]
    # A moment that is off on a piece turns its tube by the compliance up to the end of the piece.
    turn = mesh.length[mesh.collocated, None] * lever / there.torsional_stiffness.min(0)
    return tuple(finer.tolist()), (stiffness, moment), phase, turn


def _front_error(current: FrictionEquilibrium) -> float:
    """Bound of what the ends of slip are off, which lie somewhere between two points, rad."""
    signs = current.found.signs
    return float(sum(wrong[np.diff(signs[rows]) != 0].sum() for rows, wrong in _fronts(current.contact)))


@lru_cache(maxsize=8)
def _fronts(contact: Contact) -> list[tuple[Index, Array]]:
    """Of every pair its rows along the arm (K,), and what an end of slip between neighbours can be off, (K - 1,) rad:
    half a spacing of full torque where the rotation is a parabola of it."""
    problem, out = contact.problem, []
    soft = problem.here.rate.max((0, 1), initial=0.0)
    for pair in np.unique(contact.pair):
        rows = np.flatnonzero((contact.pair == pair) & (contact.point >= 0))
        spacing = problem.weight[contact.point[rows]]
        per_length = (contact.capacity[rows] / spacing)[:-1]
        # A front between two points is off by half a spacing at most: c (h / 2)^2 / 2 = c h^2 / 8.
        widest = np.maximum(spacing[:-1], spacing[1:])
        out.append((rows, per_length * widest**2 / 8 * soft[[pair, pair + 1]].sum()))
    return out


def sweep(
    robot: Robot, current: FrictionEquilibrium, joints: Array, behind: Array, *, margins: bool = True
) -> Rubbed | None:
    """States at rows of joint values (T, 2n), the first of which is that of `current`. Where they end sooner, the next
    step is too long, or a snap, and `rubbing_following` goes on from the last.

    Args:
        behind: (S,) stations behind the tip that are told, m.   margins: whether they are told.

    None where there is no kernel for this robot and this friction.
    """
    state = current.found.state.x, current.found.torque, current.found.signs
    steps, inputs = steps_along(robot, joints)
    many = rub_compiled(robot, current.contact.friction, steps, state, behind, margins=margins)
    if many is None or len(steps) == len(joints):
        return many
    # Of the finer steps only the requested rows are reported.
    reached = inputs[(inputs > 0) & (inputs <= len(many.margin))] - 1
    return Rubbed(**{field.name: getattr(many, field.name)[reached] for field in fields(Rubbed)})


def swept(robot: Robot, current: FrictionEquilibrium, joints: Array, many: Rubbed, k: int) -> FrictionEquilibrium:
    """The state after the k-th of many steps from `current` along rows (T, 2n); `current` itself after the 0-th."""
    if not k:
        return current
    rotations, translations = np.split(joints[k], 2)
    contact = contact_of(robot, tuple(translations.tolist()), current.contact.friction)
    there = evaluate_contact(contact, rotations, many.unknowns[k - 1, : contact.problem.size])
    rows, heat, violation = len(contact.capacity), float(many.heat[k - 1]), float(many.violation[k - 1])
    torque, signs = many.torque[k - 1, :rows], many.signs[k - 1, :rows]
    result = Increment(there, torque, signs, heat, True, 0.0, violation)
    return FrictionEquilibrium(contact, rotations, translations, result, current.heat + heat)
