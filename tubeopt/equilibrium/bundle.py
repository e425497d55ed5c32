"""Equilibria of bundle robots: tubes of fixed own length in a sheath, at the minimum of their energy."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
import scipy

from ..block.transcription.arm import ArmSolution, CollocationPoints
from ..block.transcription.bundle import (
    Bundle,
    BundleProblem,
    BundleState,
    Start,
    bundle_arm,
    evaluate,
    exchanged,
    margin_form,
    natural_start,
    opened,
    place_slopes,
    problem_at,
    refined,
    sampled,
    sampled_unknowns,
    start_unknowns,
)
from ..errors import InputError, SolveError
from ..robots.eccentric import BundleRobot
from ..robots.load import Load
from ..solvers.newton import NewtonResult, descend
from ..solvers.settings import LEAST_STIFFNESS
from ..solvers.time_limit import check_time
from ..typing import Array
from .answer import build_equilibrium, largest_error
from .problem import EXTRA_COLLOCATION_POINTS, TOLERANCE
from .result import Equilibrium, Jacobian, Statistics

REFINEMENTS = 4
"""Maximum number of times that elements are halved."""

EXCHANGES = 20
"""Maximum number of exchanges of boundaries; 94 of 100 random robots of two to four tubes needed none."""

VANISHING = 1e-7
"""Length (m) of an element below which its section counts as vanishing."""


def bundle_at(robot: BundleRobot, translations: Array) -> Bundle:
    """Tubes of a bundle robot in front of the plate.

    Raises:
        InputError: a translation that moves a tube out of its carriage.
    """
    straight, curved = (
        np.array([getattr(tube, name) for tube in robot.tubes]) for name in ("straight_length", "curved_length")
    )
    beyond = np.flatnonzero(translations > straight + 1e-12)
    if len(beyond):
        i = int(beyond[0])
        raise InputError(
            f"translation of tube {i + 1} is {translations[i]:g} m and moves it out of its carriage; it must be at "
            f"most its straight_length, {straight[i]:g} m"
        )
    kb, kt, bend = (
        np.array([float(getattr(tube, name)) for tube in robot.tubes])
        for name in ("bending_stiffness", "torsional_stiffness", "curvature")
    )
    return Bundle(
        kb,
        kt,
        bend,
        np.array(robot.offset),
        np.array(robot.angle),
        np.maximum(straight - translations, 0.0),
        transition=translations.copy(),
        end=translations + curved,
        sheath=robot.sheath_stiffness,
    )


def forces_of(load: Load | None) -> tuple[tuple[float, tuple[float, float, float]], ...]:
    """Dead forces of a load: arc length and force; raises InputError for other loads."""
    if load is None:
        return ()
    if not load.has_energy or load.gravity is not None or load.distributed is not None:
        raise InputError(
            "load has moments, weight or distributed forces; a bundle robot carries forces of fixed direction only"
        )
    return tuple((part.at, part.force) for part in load.acting if any(part.force))


class Solved(NamedTuple):
    """Stationary state of a bundle problem."""

    problem: BundleProblem
    state: BundleState
    iterations: int


def _newton(problem: BundleProblem, rotations: Array, x: Array) -> NewtonResult[BundleState]:
    """Minimum of the energy near x (U,), by guarded Newton steps."""
    n = len(rotations)

    def turn(_: BundleState, step: Array) -> float:
        change = problem.local @ step
        arm = np.cumsum(problem.weight[:, None] * change[:, 2 * n : -1], axis=0)
        return max(float(np.abs(change[:, :n]).max()), float(np.abs(arm).max()))

    def residual(state: BundleState) -> float:
        return float(np.abs(problem.local[:, :n] @ state.gradient).max())

    first = evaluate(problem, rotations, x)
    if not np.isfinite(first.energy):
        return NewtonResult(first, False, 0, 0.0)
    possible = [first]

    def moved(state: BundleState, step: Array) -> BundleState:
        after = evaluate(problem, rotations, state.x + step)
        if np.isfinite(after.energy):
            possible[0] = after
        return after

    result = descend(first, moved, turn, residual)
    # Steps end at a vanishing section: the last possible state shows which.
    return result if result.converged else replace(result, state=possible[0])


def _minimum(problem: BundleProblem, rotations: Array, x: Array) -> Solved:
    """Minimum of the energy from unknowns x (U,), with boundaries exchanged where a section vanishes.

    Raises:
        SolveError: Newton's method does not converge.
    """
    iterations = 0
    for _ in range(EXCHANGES):
        check_time()
        result = _newton(problem, rotations, opened(problem, x, VANISHING))
        iterations += result.iterations
        state = result.state
        shortest = int(np.argmin(problem.lengths(state.x)))
        if result.converged and np.isfinite(state.energy):
            return Solved(problem, state, iterations)
        if not (np.isfinite(state.energy) and shortest and problem.lengths(state.x)[shortest] < 2 * VANISHING):
            break
        # The section between two boundaries has vanished: they change places.
        start = exchanged(problem, state, shortest)
        arm = bundle_arm(problem, rotations, state)
        problem = replace(problem_at(problem.bundle, start, force=problem.force), tableau=problem.tableau)
        x = sampled_unknowns(problem, start, arm, arm.rotation[:, 0] - rotations)
    raise SolveError("not converged: the energy of the bundle has no minimum near its start")


def _stable(solved: Solved, rotations: Array) -> Solved:
    """The solution; for a saddle the lower of the minima on both sides."""
    values, vectors = np.linalg.eigh(margin_form(solved.problem, solved.state))
    if values[0] > 0:
        return solved
    problem, state = solved.problem, solved.state
    n = len(rotations)
    # 0.05 rad is small against the distance between minima, and enough for the energy to fall.
    aside = 0.05 / np.abs(problem.local[:, :n] @ vectors[:, 0]).max() * vectors[:, 0]
    both = [_minimum(problem, rotations, state.x + side * aside) for side in (1, -1)]
    return min(both, key=lambda one: one.state.energy)


def bundle_kinematics(
    robot: BundleRobot,
    rotations: Array,
    translations: Array,
    *,
    load: Load | None = None,
    start: Equilibrium | None = None,
    tolerance: float = TOLERANCE,
) -> Equilibrium:
    """Equilibrium of a bundle robot at joint values.

    Args:
        rotations, translations: (n,), rad and m.
        load: dead forces at the tip and at places of the sheath.
        start: equilibrium of the robot, whose branch is continued to these joint values; by default the minimum that
            is found from untwisted tubes.

    Raises:
        InputError: other loads, or a tube out of its carriage.
        SolveError: no stable equilibrium was found, or the tolerance cannot be reached.
    """
    began, bundle, force = time.perf_counter(), bundle_at(robot, translations), forces_of(load)
    places = sorted({s for s, _ in force if np.isfinite(s)})
    if start is None:
        first = natural_start(bundle, rotations, places)
        _check_places(places, float(first.length.sum()))
        how = "tubes without torsion"
        problem = problem_at(bundle, first, force=force)
        solved = _stable(_minimum(problem, rotations, start_unknowns(problem, first)), rotations)
    else:
        first, how = sampled(bundle, start.arm, places), "guess"
        problem = problem_at(bundle, first, force=force)
        solved = _minimum(problem, rotations, sampled_unknowns(problem, first, start.arm, _twist(start)))
    for refinement in range(REFINEMENTS + 1):
        result = _equilibrium(robot, rotations, translations, load, solved, (how, refinement, began))
        if largest_error(result.mesh_error, result.tip_error, float(result.arc_length[-1])) <= tolerance:
            if start is None and result.margin <= 0:
                raise SolveError(f"no stable equilibrium was found: the best has margin {result.margin:.3g}", result)
            return result
        arm = result.arm
        again = Start(
            solved.problem.order, solved.problem.lengths(solved.state.x) * solved.problem.count, first.curvature
        )
        problem = problem_at(bundle, again, refinement=refinement + 1, force=force)
        solved = _minimum(problem, rotations, sampled_unknowns(problem, again, arm, _twist(result)))
    raise SolveError(f"the estimated error is above the tolerance of {tolerance:.1e} rad on the finest mesh", result)


def _twist(equilibrium: Equilibrium) -> Array:
    """Twist (n,) of the transmissions, rad."""
    return np.asarray(equilibrium.rotation[:, 0] - equilibrium.rotations)


def _check_places(places: list[float], length: float) -> None:
    """Raise InputError for a force beyond the last tube."""
    if places and places[-1] > length:
        raise InputError(
            f"a force acts {1e3 * places[-1]:g} mm from the plate; the last tube ends at {1e3 * length:g} mm"
        )


def _equilibrium(
    robot: BundleRobot,
    rotations: Array,
    translations: Array,
    load: Load | None,
    solved: Solved,
    how: tuple[str, int, float],
) -> Equilibrium:
    """Equilibrium of a solved bundle, with estimated errors."""
    problem, state = solved.problem, solved.state
    n, k = len(rotations), problem.tableau.degree
    arm = bundle_arm(problem, rotations, state)
    ends = np.cumsum(problem.lengths(state.x) * problem.count)
    tube_end = np.zeros(n)
    for place, boundary in zip(ends.tolist(), problem.order, strict=True):
        if boundary.end:
            tube_end[list(boundary.tubes)] = place
    tips = arm.rotation[np.arange(n), np.searchsorted(arm.arc_length, tube_end - 1e-12)]
    begin = np.repeat(arm.arc_length[:-1:4], k)
    values = np.linalg.eigvalsh(margin_form(problem, state))
    solution = ArmSolution(
        arm,
        tips,
        np.concatenate([[0.0], ends[:-1]]),
        tube_end,
        CollocationPoints(begin + state.h * np.tile(problem.tableau.nodes, len(problem.section)), state.theta),
        margin=min(1.0, float(values[0])),
        energy=state.energy + state.work,
        residual=float(np.abs(problem.local[:, :n] @ state.gradient).max()),
        errors=_errors(problem, rotations, state),
        iterations=solved.iterations,
        index=int((values < 0).sum()),
        work=state.work,
    )
    statistics = Statistics(
        method="newton",
        iterations=solved.iterations,
        elements=len(problem.section),
        degree=k,
        start=how[0],
        seconds=time.perf_counter() - how[2],
        refinement=how[1],
    )
    return build_equilibrium(robot, rotations, translations, solution, statistics, load=load)


def _errors(problem: BundleProblem, rotations: Array, state: BundleState) -> tuple[float, float, float]:
    """Estimated errors of theta (rad), tip (m) and margin: the change by a Newton step with more points."""
    finer, x = refined(problem, state, problem.tableau.degree + EXTRA_COLLOCATION_POINTS)
    there = evaluate(finer, rotations, x)
    shift = LEAST_STIFFNESS * np.eye(finer.size)
    step = np.linalg.solve(there.hessian + shift, -there.gradient)
    last = len(problem.order) - 1
    pose = place_slopes(finer, there, last)
    tip = pose.position + pose.by_x[:3] @ step - place_slopes(problem, state, last).position
    theta = np.abs(finer.local[:, : len(rotations)] @ step).max()
    return 2 * float(theta), float(np.linalg.norm(tip)), 0.0


# --- Derivatives ------------------------------------------------------------------------------------------------------


@lru_cache(maxsize=8)
def linearised_bundle(equilibrium: Equilibrium) -> BundleDerivatives:
    """Derivatives of an equilibrium of a bundle robot, solved once more."""
    robot, force = equilibrium.robot, forces_of(equilibrium.load)
    assert isinstance(robot, BundleRobot)
    bundle = bundle_at(robot, equilibrium.translations)
    start = sampled(bundle, equilibrium.arm, sorted({s for s, _ in force if np.isfinite(s)}))
    problem = problem_at(bundle, start, refinement=equilibrium.statistics.refinement, force=force)
    solved = _minimum(
        problem, equilibrium.rotations, sampled_unknowns(problem, start, equilibrium.arm, _twist(equilibrium))
    )
    return BundleDerivatives(equilibrium, solved.problem, solved.state)


class Columns:
    """Some columns of the derivatives of an equilibrium, computed when they are read; names as in `Jacobian`."""

    def __init__(self, of: BundleDerivatives, wrt: tuple[str, ...], columns: list[int]) -> None:
        self.wrt, self._of, self._columns = wrt, of, columns

    def _chosen(self, table: Array) -> Array:
        return np.asarray(table[..., self._columns])

    @property
    def tip_position(self) -> Array:
        """Derivative (3, Q) of the tip position, m."""
        return self._chosen(self._of.tip_position)

    @property
    def tip_rotation(self) -> Array:
        """Turn (3, Q) of the tip frame, rad."""
        return self._chosen(self._of.tip_rotation)

    @property
    def tip_rotations(self) -> Array:
        """Derivative (n, Q) of theta at the ends of the tubes, rad."""
        return self._chosen(self._of.tip_rotations)

    @property
    def margin(self) -> Array:
        """Derivative (Q,) of the margin."""
        return self._chosen(self._of.margin)

    @property
    def energy(self) -> Array:
        """Derivative (Q,) of the elastic energy, J."""
        return self._chosen(self._of.energy)


@dataclass(frozen=True, eq=False)
class BundleDerivatives:
    """Derivatives of an equilibrium by rotations and translations, by the implicit function theorem.

    The energy E(x, c) has the gradient 0 along x(c): dx/dc = -E_xx^-1 E_xc.
    """

    equilibrium: Equilibrium
    problem: BundleProblem
    state: BundleState

    @property
    def _n(self) -> int:
        return self.equilibrium.robot.n_tubes

    @cached_property
    def _factors(self) -> tuple[Array, Array]:
        """LU factors of the Hessian."""
        return tuple(scipy.linalg.lu_factor(self.state.hessian))

    @cached_property
    def _lengths(self) -> Array:
        """Derivative (m, 2 n) of the lengths h of elements by the joint values, at fixed x."""
        own = np.zeros((len(self.problem.order), 2 * self._n))
        for k, boundary in enumerate(self.problem.order):
            for i in boundary.tubes:
                own[k, self._n + i] = 1.0
        return self.problem.lengths_by_boundaries @ own

    @cached_property
    def _local(self) -> Array:
        """Derivative (N, 2 n + 3, 2 n) of theta, p, kappa and h by the joint values, at fixed x."""
        n, problem = self._n, self.problem
        out = np.zeros((len(problem.weight), 2 * n + 3, 2 * n))
        out[:, np.arange(n), np.arange(n)] = 1.0
        # theta at the plate is alpha + x sqrt(|beta| / kt): a tube moved forward has less transmission.
        twist = problem.transmission_twist(self.state.x)
        out[:, problem.held, n + problem.held] = -twist / (2 * problem.bundle.transmission[problem.held])
        out[:, -1] = self._lengths[problem.point_section]
        return out

    @cached_property
    def _response(self) -> Array:
        """Derivative (U, 2 n) of x by the joint values."""
        problem, state = self.problem, self.state
        change = problem.weight[:, None, None] * (state.local_hessian @ self._local)
        right = problem.local.reshape(-1, problem.size).T @ change.reshape(-1, 2 * self._n)
        # theta = x sqrt(|beta| / kt) at the plate: its derivative by x depends on the transmission, too.
        held, own = problem.held, problem.split - len(problem.held) + np.arange(len(problem.held))
        pull = (problem.weight @ state.by_local[:, held]) * problem.tip_rows[held, own]
        right[own, self._n + held] -= pull / (2 * problem.bundle.transmission[held])
        if problem.force:
            right[problem.split :] -= problem.scale[problem.split :, None] * (state.mixed.T @ self._lengths)
        return np.asarray(-scipy.linalg.lu_solve(self._factors, right))

    @cached_property
    def _tip(self) -> Array:
        """Derivative (6, 2 n) of the tip pose."""
        pose = place_slopes(self.problem, self.state, len(self.problem.order) - 1)
        out = pose.by_x @ self._response
        out[:3] += pose.by_length @ self._lengths
        return np.asarray(out)

    @property
    def tip_position(self) -> Array:
        """Derivative (3, 2 n) of the tip position, m."""
        return self._tip[:3]

    @property
    def tip_rotation(self) -> Array:
        """Turn (3, 2 n) of the tip frame about world axes, rad."""
        return self._tip[3:]

    @cached_property
    def tip_rotations(self) -> Array:
        """Derivative (n, 2 n) of theta at the ends of the tubes, rad."""
        problem, n = self.problem, self._n
        out = np.eye(n, 2 * n) + problem.tip_rows @ self._response
        twist = problem.transmission_twist(self.state.x) / (2 * problem.bundle.transmission[problem.held])
        out[problem.held, n + problem.held] -= twist
        return np.asarray(out)

    @cached_property
    def energy(self) -> Array:
        """Derivative (2 n,) of the elastic energy, J."""
        problem, state = self.problem, self.state
        local = self._local + problem.local @ self._response
        held = slice(problem.split - len(problem.held), problem.split)
        by_points = (problem.weight[:, None] * state.by_local).ravel() @ local.reshape(-1, 2 * self._n)
        return np.asarray(by_points + state.x[held] @ self._response[held])

    @cached_property
    def length_forces(self) -> Array:
        """Derivative (m,) lambda of the energy by the own length of tubes up to each boundary, N."""
        problem, state = self.problem, self.state
        by_length = np.bincount(problem.point_section, problem.weight * state.by_local[:, -1], len(problem.order))
        return np.asarray((by_length - state.work_by_length) @ problem.lengths_by_boundaries)

    @cached_property
    def margin(self) -> Array:
        """Derivative (2 n,) of the margin, by central differences of equilibria."""
        e, n = self.equilibrium, self._n
        assert isinstance(e.robot, BundleRobot)
        joints, slopes = np.concatenate([e.rotations, e.translations]), np.zeros(2 * n)
        for k in range(2 * n):
            step = np.where(np.arange(2 * n) == k, 1e-4 if k < n else 1e-6, 0.0)
            sides = [
                bundle_kinematics(e.robot, *np.split(joints + way * step, 2), load=e.load, start=e).margin
                for way in (1, -1)
            ]
            slopes[k] = (sides[0] - sides[1]) / (2 * step[k])
        return slopes

    @cached_property
    def compliance(self) -> Array:
        """Compliance (6, 6) of the tip: force (N) and moment (N m) -> translation (m) and turn (rad), world axes."""
        problem, ends = self.problem, self.equilibrium.tube_end
        slopes = place_slopes(problem, self.state, len(problem.order) - 1).by_x
        slopes[3:] += np.outer(self.equilibrium.tip_rotation[:, 2], problem.tip_rows[int(np.argmax(ends))])
        return np.asarray(slopes @ scipy.linalg.lu_solve(self._factors, slopes.T))


def bundle_wrench(equilibrium: Equilibrium) -> Array:
    """Force (N) and moment about the plate's point (N m) of the load on the plate."""
    out = np.zeros(6)
    for s, force in forces_of(equilibrium.load):
        at = [
            np.interp(min(s, equilibrium.arc_length[-1]), equilibrium.arc_length, row) for row in equilibrium.position.T
        ]
        out += np.concatenate([force, np.cross(at, force)])
    return out


JOINTS = ("rotations", "translations")
"""Parameters of the derivatives."""


def bundle_jacobian(equilibrium: Equilibrium, wrt: tuple[str, ...] = JOINTS) -> Jacobian:
    """Derivatives of tip pose, margin and energy by joint values; see `equilibrium.jacobian`.

    Raises:
        InputError: another name than "rotations" or "translations".
    """
    for name in wrt:
        if name not in JOINTS:
            raise InputError(f"wrt names {name!r}; of a bundle robot it may name {' and '.join(JOINTS)}")
    n = equilibrium.robot.n_tubes
    columns = [JOINTS.index(name) * n + i for name in wrt for i in range(n)]
    return Jacobian.of(lambda: Columns(linearised_bundle(equilibrium), wrt, columns))
