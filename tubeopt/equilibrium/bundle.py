"""Equilibria of bundle robots: tubes of fixed own length in a sheath, at the minimum of their energy."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import combinations
from typing import Any

import numpy as np

from ..block.transcription.arm import ArmShape, ArmSolution, CollocationPoints, Errors, Profile
from ..block.transcription.bundle import (
    CLOSING,
    FELT,
    HELD,
    TO_BOUNDARY,
    VANISHING,
    Bundle,
    BundleProblem,
    BundleState,
    Start,
    VanishingError,
    bundle_arm,
    carried,
    cross_section_slopes,
    element_counts,
    evaluate,
    exchanged,
    followed,
    holding_forces,
    margin_form,
    mode_of,
    moved_order,
    natural_start,
    opened,
    place_slopes,
    problem_at,
    rearranged,
    solved_order,
    start_unknowns,
    together,
)
from ..block.transcription.collocated import ENDS
from ..block.transcription.tableau import tableau
from ..errors import InputError
from ..robots.eccentric import BundleRobot
from ..robots.load import Load, masses
from ..robots.robot import Robot
from ..solvers.compiled.binding import Solved
from ..solvers.compiled.bundle import BundleStart, solve_bundle_compiled
from ..solvers.newton import NewtonResult, full_steps
from ..solvers.settings import LEAST_STIFFNESS
from ..solvers.time_limit import check_time
from ..typing import Array, Index
from .member import AnyPoint, Member, Point
from .problem import DEFAULT_DISCRETISATION, LOADED_DISCRETISATION, Discretisation
from .result import Equilibrium

SETTLE = partial(full_steps, iterations=8)
"""Newton's method for a state that is known but in a section without length."""

NO_RIDGE = 1e-6
"""Force (N) on the length of a section below which the energy has no kink there: ten times the round-off."""

APART = 1e-7
"""Length (m) of the elements of a section whose boundaries have just separated."""

RESCALED = 10.0
"""Change of a length, as a factor, after which unknowns are whitened again, for shifts of their Hessian."""

EXCHANGES = 20
"""Maximum number of exchanges of boundaries; 94 of 100 random robots of two to four tubes needed none."""


@lru_cache(maxsize=64)
def bundle_at(robot: BundleRobot, translations: tuple[float, ...]) -> Bundle:
    """Tubes of a bundle robot in front of the plate."""
    shift = np.array(translations)
    straight, curved, kb, kt, bend = (
        np.array([float(getattr(tube, name)) for tube in robot.tubes])
        for name in ("straight_length", "curved_length", "bending_stiffness", "torsional_stiffness", "curvature")
    )
    return Bundle(
        kb,
        kt,
        bend,
        np.array(robot.offset),
        np.array(robot.angle),
        np.maximum(straight - shift, 0.0),
        transition=shift,
        end=shift + curved,
        sheath=robot.sheath_stiffness,
        rigid_length=robot.sheath_rigid_length,
        rigid_from=math.inf if robot.sheath_rigid_from is None else robot.sheath_rigid_from,
    )


def solved_by_kernel(
    robot: BundleRobot, rotations: Array, translations: Array, guess: Equilibrium | None, refinement: int
) -> Solved | None:
    """Solution of the compiled kernel, from tubes without torsion or a guess; None where it has none.

    The kernel solves the arm beyond the rigid part of the sheath, in which tubes are as straight as behind the plate.
    """
    bundle = bundle_at(robot, tuple(translations.tolist()))
    near = None if guess is None else bundle_start(guess, translations)
    if robot.sheath_rigid_from is not None or (guess is not None and near is None):
        return None
    solved = solve_bundle_compiled(bundle.beyond_rigid_length, rotations, near, refinement)
    if solved is None or not bundle.rigid_length:
        return solved
    count = 2**refinement
    return solved._replace(solution=_from_plate(solved.solution, bundle, count), elements=solved.elements + count)


def _from_plate(solution: ArmSolution, bundle: Bundle, count: int) -> ArmSolution:
    """Solution with the rigid part of the sheath in front of the arm beyond it, as `count` elements."""
    arm, points, length, steps = solution.arm, solution.points, bundle.rigid_length, len(ENDS) - 1
    s = length * np.arange(count * steps + 1) / (count * steps)
    nodes = length * (np.arange(count)[:, None] + tableau("gauss", DEFAULT_DISCRETISATION.degree).nodes).ravel() / count
    # The twist w of a tube is that where the sheath begins to bend, where theta' = g w.
    theta, rate = arm.rotation[:, 0], arm.torsion[:, 0] / (1 + bundle.levers @ arm.curvature[0])
    straight, along = np.zeros((len(s), 2)), np.array([0.0, 0.0, 1.0])
    shape = ArmShape(
        np.concatenate([s, length + arm.arc_length[1:]]),
        np.column_stack([theta[:, None] + rate[:, None] * (s - length), arm.rotation[:, 1:]]),
        np.column_stack([np.tile(rate[:, None], len(s)), arm.torsion[:, 1:]]),
        np.concatenate([straight, arm.curvature[1:]]),
        np.concatenate([s[:, None] * along, arm.position[1:] + length * along]),
        np.concatenate([np.tile(np.eye(3), (len(s), 1, 1)), arm.frame[1:]]),
    )
    table = CollocationPoints(
        np.concatenate([nodes, length + points.point]),
        np.concatenate([theta + rate * (nodes[:, None] - length), points.point_rotation]),
        np.concatenate([np.zeros((len(nodes), 2)), points.point_curvature]),
    )
    start = np.append(0.0, length + solution.section_start)
    end = np.where(bundle.end > length, length + solution.tube_end, np.maximum(bundle.end, 0.0))
    return replace(solution, arm=shape, section_start=start, tube_end=end, points=table)


def bundle_start(equilibrium: Equilibrium, translations: Array) -> BundleStart | None:
    """Start of a compiled solve at translations (n,), m; None for a mesh that the kernel does not have."""
    points, statistics, robot = equilibrium.points, equilibrium.statistics, equilibrium.robot
    assert isinstance(robot, BundleRobot)
    if equilibrium.load is not None or statistics.degree != DEFAULT_DISCRETISATION.degree:
        return None
    length = robot.sheath_rigid_length
    ends, beyond = np.append(equilibrium.section_start[1:], equilibrium.arc_length[-1]), points.point > length
    twist = equilibrium.rotation[:, 0] - equilibrium.rotations + length * equilibrium.torsion[:, 0]
    sampled = points.point[beyond] - length, points.point_rotation[beyond], points.point_curvature[beyond]
    shift = translations - equilibrium.translations
    return BundleStart((ends - length)[1 if length else 0 :], *sampled, equilibrium.rotations, twist, shift)


def _places(load: Load | None) -> list[float]:
    """Places of the sheath where the force on a cross-section jumps, m."""
    return [] if load is None else sorted({s for s in load.cuts().tolist() if s > HELD})


def _density(robot: Robot, load: Load | None) -> tuple[float, ...]:
    """Masses (n,) per length of the tubes, kg/m; empty without gravity."""
    return () if load is None or load.gravity is None else tuple(masses(robot.tubes, load).tolist())


def _groups(problem: BundleProblem) -> list[set[object]]:
    """Boundaries from the plate, those that are together in one group."""
    out: list[set[object]] = []
    for k, boundary in enumerate(problem.order):
        if k and k in problem.held:
            out[-1].add(boundary)
        else:
            out.append({boundary})
    return out


@dataclass(frozen=True, eq=False)
class Bundled(Member[BundleState]):
    """Equations of a bundle robot, with its boundaries in one order, under `factor` times the load of the problem.

    A solve may exchange boundaries: `owner` is then the member of its state.
    """

    problem: BundleProblem
    discretisation: Discretisation = DEFAULT_DISCRETISATION
    factor: float = 1.0
    """Factor on the load of the problem."""
    patient: bool = False
    """True if a step never closes a section, but makes it half as long at most."""
    rescales: bool = True
    """True if unknowns may be whitened again on the way; with friction its rows are in the unknowns of the problem."""

    @staticmethod
    def of(
        robot: BundleRobot,
        rotations: Array,
        translations: tuple[float, ...],
        load: Load | None = None,
        factor: float = 1.0,
        *,
        start: Callable[[Bundle, list[float]], Start],
        discretisation: Discretisation = DEFAULT_DISCRETISATION,
    ) -> Bundled:
        """Equations of a bundle with the boundaries that `start` returns for it and the places of its load."""
        bundle = bundle_at(robot, translations)
        mesh = {"degree": discretisation.degree, "refinement": discretisation.refinement}
        problem = problem_at(bundle, start(bundle, _places(load)), load=load, density=_density(robot, load), **mesh)
        return Bundled(robot, problem, rotations, translations, discretisation, factor)

    @staticmethod
    def cold(robot: BundleRobot, rotations: Array, translations: tuple[float, ...]) -> Bundled:
        """Member with the boundaries of untwisted tubes, without a load."""
        first = natural_start(bundle_at(robot, translations), rotations)
        if not first.order:
            where = "beyond the rigid part of the sheath" if robot.sheath_rigid_length else "in front of the base plate"
            raise InputError(f"no tube is {where}; a bundle robot needs one")
        return Bundled.of(robot, rotations, translations, start=lambda *_: first)

    @staticmethod
    def of_equilibrium(
        equilibrium: Equilibrium, load: Load | None, discretisation: Discretisation | None
    ) -> tuple[Bundled, Array]:
        """Member and unknowns of an equilibrium: with its load on its mesh, or without load under 0 times `load`."""
        robot, statistics, points = equilibrium.robot, equilibrium.statistics, equilibrium.points
        assert isinstance(robot, BundleRobot)
        shift, rotations = tuple(equilibrium.translations.tolist()), equilibrium.rotations
        bundle, applied, t = bundle_at(robot, shift), equilibrium.load, tableau("gauss", statistics.degree)
        first, ends = equilibrium.section_start, np.append(equilibrium.section_start[1:], equilibrium.arc_length[-1])
        count = np.bincount(np.searchsorted(first, points.point, side="right") - 1, minlength=len(first)) // t.degree
        h = np.repeat((ends - first) / count, count * t.degree)
        bend = points.point_curvature * h[:, None]
        lengths = np.tile(t.weights, len(h) // t.degree)[:, None] * (h[:, None] + bend @ bundle.levers.T)
        reached = np.cumsum(lengths, axis=0)[np.cumsum(count * t.degree) - 1]
        start = Start(solved_order(bundle, _places(applied), ends, reached), ends - first, np.zeros((len(ends), 2)))
        d = Discretisation(degree=statistics.degree, refinement=statistics.refinement)
        member = Bundled.of(robot, rotations, shift, applied, start=lambda *_: start, discretisation=d)
        member = replace(member, problem=replace(member.problem, count=count, nominal=(ends - first) / count))
        problem, base = member.problem, equilibrium.rotation[:, 0]
        # theta at the points is the sum of p up to there.
        turn = np.asarray(np.linalg.solve(problem.up_to, points.point_rotation - base), dtype=float)
        x = problem.unknowns(turn, bend.ravel(), base - rotations)
        if applied is not None or (load is None and discretisation in (None, d)):
            return member, x
        point = Point(0.0, member, member.at(x), equilibrium.margin)
        d = discretisation or (DEFAULT_DISCRETISATION if load is None else LOADED_DISCRETISATION)
        member = replace(member, discretisation=d).near(point, rotations, shift, load, 0.0).on(degree=d.degree)
        return member, member.transfer(point)

    @property
    def torsion(self) -> Any:
        """None, since the rotations of a bundle have no equations of their own."""
        return None

    @property
    def load(self) -> Load | None:
        """Load times its factor."""
        load = self.problem.load
        return load if load is None or self.factor == 1.0 else load.scaled(self.factor)

    def owner(self, state: BundleState) -> Bundled:
        """Equations that a state belongs to; its boundaries may have another order than these."""
        return self if state.problem is self.problem else replace(self, problem=state.problem)

    def on(self, **mesh: Any) -> Bundled:
        """Same robot and load on a mesh with another `degree` or `refinement`."""
        d, known = replace(self.discretisation, **mesh), self.problem
        finer = 2 ** (d.refinement - self.discretisation.refinement)
        problem = replace(
            known, tableau=tableau("gauss", d.degree), count=known.count * finer, nominal=known.nominal / finer
        )
        return replace(self, problem=problem, discretisation=d)

    def unknowns(self, theta: Array, curvature: Array | None = None) -> Array:
        """Raises InputError: rotations and curvature determine no lengths."""
        raise InputError("kind is bundle; its equilibria are not found from rotations along the arm")

    def untwisted(self) -> Array:
        """(U,) unknowns of tubes without torsion."""
        return start_unknowns(self.problem, natural_start(self.problem.bundle, self.rotations))

    def at(self, x: Array) -> BundleState:
        """State at unknowns x (U,)."""
        return evaluate(self.problem, self.rotations, x, self.factor)

    def largest_rotation(self, state: BundleState, step: Array) -> float:
        """Largest rotation (rad) of a tube or of the arm by a step; held sections count as if they were longer."""
        problem = state.problem
        change = problem.push(step)
        arm = problem.up_to @ change[:, -3:-1]
        held = change[np.isin(problem.point_section, problem.held), problem.n : -1] * (FELT / HELD)
        return max(float(np.abs(part).max(initial=0.0)) for part in (change[:, : problem.n], arm, held))

    def residual(self, state: BundleState) -> float:
        """Largest violation of the equations, as an error of theta or of the arm's direction, rad."""
        return self.largest_rotation(state, state.gradient)

    @property
    def is_symmetric(self) -> bool:
        """True under loads with an energy, and without load."""
        return self.descends or not self.factor

    @property
    def descends(self) -> bool:
        """False under moments and follower forces, which have no energy."""
        return self.problem.load is None or self.problem.load.has_energy

    def form(self, state: BundleState) -> Array:
        """(U, U) matrix of the second variation; its smallest eigenvalue is the margin."""
        return margin_form(state)

    def margin(self, state: BundleState) -> float:
        """Stability margin; minus infinity on a ridge: the energy falls where closed sections open in either order."""
        out = super().margin(state)
        for section, orders in self.closed(state):
            if max(force for _, force in orders) < -NO_RIDGE:
                return -np.inf
            # Without a force the section is as free as an open one.
            out = min([out, *(self._margin_apart(each, section) for each, force in orders if abs(force) < NO_RIDGE)])
        return out

    def closed(self, state: BundleState) -> Iterator[tuple[int, list[tuple[BundleState, float]]]]:
        """Closed sections between two boundaries; the states in both orders of these, with the forces (N) that resist
        opening the section.
        """
        held = state.problem.held
        for section in held if self.descends else ():
            alone = section > 0 and not {section - 1, section + 1} & set(held)
            other = self.owner(state).with_exchange(state, section) if alone else None
            if other is not None:
                orders = (state, other)
                yield (
                    section,
                    [(each, float(holding_forces(each)[each.problem.held.index(section)])) for each in orders],
                )

    def _margin_apart(self, state: BundleState, section: int) -> float:
        """Margin of a state with a closed section free."""
        order, held = state.problem.order, tuple(k for k in state.problem.held if k != section)
        problem, x = rearranged(state, order, held)
        free = replace(self, problem=problem)
        start = free.at_scale(opened(problem, x, APART))
        return super(Bundled, free.owner(start)).margin(start)

    def with_exchange(self, state: BundleState, section: int) -> BundleState | None:
        """Same state with the boundaries at the ends of a closed section in the other order; None if none is found."""
        problem, x = exchanged(state, section, hold=True)
        other = replace(self, problem=problem)
        try:
            result = SETTLE(other.at(x), other.advanced, other.largest_rotation, other.residual)
        except VanishingError:
            return None
        return result.state if result.converged else None

    def softest(self, state: BundleState) -> Array:
        """(U,) unit vector of the unknowns for the softest direction of the form."""
        unknowns = mode_of(state, super().softest(state)).unknowns
        return np.asarray(unknowns / np.linalg.norm(unknowns))

    def profile(self, state: BundleState) -> Profile:
        """Raises InputError: a bundle has no profile of torsion alone."""
        raise InputError("kind is bundle; it has no profile of torsion alone")

    # --- Solving ------------------------------------------------------------------------------------------------------

    def advanced(self, state: BundleState, step: Array) -> BundleState:
        """State after a step, with all lengths above 0; raises VanishingError if the length of a section vanishes."""
        problem = state.problem
        after = problem.push(step)
        h, g = problem.lengths(state.x), state.length
        dh = problem.lengths_by_bend @ (problem.bend_map @ step[problem.split :])
        dg = np.where(problem.present, after[:, -1:] + after[:, -3:-1] @ problem.bundle.levers.T, 0.0)
        free = np.setdiff1d(np.arange(len(h)), problem.held)
        # A section that a step makes a thousand times shorter is one that closes: its curvature is unknown then.
        limit = 2 * VANISHING if self.patient else CLOSING
        closing = free[(h[free] < limit) & (h[free] + dh[free] <= np.maximum(VANISHING, 1e-3 * h[free]))]
        if len(closing):
            raise VanishingError(state, int(closing[0]))
        with np.errstate(divide="ignore", invalid="ignore"):
            step_limits = np.concatenate([(-h / dh)[free][dh[free] < 0], (-g / dg)[dg < 0]])
        fraction = float(step_limits.min(initial=np.inf))
        return self.owner(state).at_scale(state.x + (1.0 if fraction > 1 else TO_BOUNDARY * fraction) * step)

    def at_scale(self, x: Array) -> BundleState:
        """State at unknowns x (U,), in unknowns that are whitened for lengths close to its own."""
        problem, h = self.problem, self.problem.lengths(x)
        ratio = np.delete(h / problem.nominal, problem.held)
        if not self.rescales or not len(ratio) or not ratio.min() > 0 or max(ratio.max(), 1 / ratio.min()) < RESCALED:
            return self.at(x)
        nominal = h.copy()
        nominal[[*problem.held]] = HELD
        scaled = replace(problem, nominal=nominal)
        (turn, twist), bend = problem.torsion(x), problem.bend(x)
        return replace(self, problem=scaled).at(scaled.unknowns(turn, bend, twist))

    def newton(
        self,
        x: Array,
        method: Callable[..., NewtonResult[BundleState]],
        settle: Callable[..., NewtonResult[BundleState]] | None = None,
    ) -> NewtonResult[BundleState]:
        """Result of a Newton method with the sections of length 0 that it finds.

        A section that vanishes is exchanged: the boundaries at its ends change places. Where it vanishes in both orders
        its boundaries stay together. They separate again as soon as this lowers the energy.
        """
        member, exchanges, freed, spent = self, set[frozenset[object]](), list[object](), 0
        for _ in range(EXCHANGES):
            check_time()
            try:
                start = member.at_scale(opened(member.problem, x, VANISHING))
                result = method(start, member.advanced, member.largest_rotation, member.residual)
            except VanishingError as end:
                order = member.problem.order
                pair = frozenset(order[end.section - 1 : end.section + 1])
                if end.section == 0:
                    break
                problem, x = exchanged(end.state, end.section, hold=pair in exchanges)
                exchanges.add(pair)
                member = replace(member, problem=problem)
                continue
            spent += result.iterations
            found = member.owner(result.state)
            apart = found.separated(result.state, freed, settle or SETTLE) if result.converged else None
            if apart is None:
                forces = [
                    [force for _, force in orders] for _, orders in found.closed(result.state) if result.converged
                ]
                if any(min(pair) < -NO_RIDGE < NO_RIDGE < max(pair) for pair in forces):
                    # The ends slide past each other: no equilibrium, and Newton's method does not leave it.
                    break
                # After a change the first steps open a section, and say nothing about the branch.
                contraction = 0.0 if member is not self else result.contraction
                return replace(result, iterations=spent, contraction=contraction if result.converged else np.inf)
            problem, x = apart
            # Sections that have closed a second time may have done so by a step that was too long.
            member = replace(member, problem=problem, patient=len(freed) > len(set(freed)))
        return NewtonResult(member.at(x), False, spent, np.inf)

    def separated(
        self, state: BundleState, freed: list[object], settle: Callable[..., NewtonResult[BundleState]]
    ) -> tuple[BundleProblem, Array] | None:
        """Problem and unknowns after boundaries that are together separate into two groups; None if none would.

        Of boundaries that are together any may come first. To first order the energy of small gaps between them is the
        sum of those of each gap, which depends on the group before it only: it is a minimum if no single gap lowers it.

        Args:
            freed: pairs of groups that have separated; each may do so twice in a solve.
            settle: solves in few steps.
        """
        problem = self.problem
        for chain in together(problem.held):
            first, last = chain[0] - 1, chain[-1]
            meeting = problem.order[first : last + 1]
            if first < 0:
                continue
            # First the groups of the present order.
            groups = [group for k in range(1, len(meeting)) for group in combinations(meeting, k)]
            for group in sorted(groups, key=lambda group: group != meeting[: len(group)]):
                rest = tuple(b for b in meeting if b not in group)
                pair, section = frozenset([frozenset(group), frozenset(rest)]), first + len(group)
                if freed.count(pair) > 1:
                    continue
                order = (*problem.order[:first], *group, *rest, *problem.order[last + 1 :])
                found = state
                if order != problem.order:
                    known, x = rearranged(state, order, problem.held)
                    other = replace(self, problem=known)
                    # The state is the same but in the held sections: few steps settle it.
                    result = settle(other.at(x), other.advanced, other.largest_rotation, other.residual)
                    if not result.converged:
                        continue
                    found = result.state
                if holding_forces(found)[problem.held.index(section)] < 0:
                    freed.append(pair)
                    return rearranged(found, order, tuple(k for k in problem.held if k != section))
        return None

    def moved(self, state: BundleState, step: Array) -> BundleState:
        """State after a step of a descent; a section that vanishes stays at length 0."""
        member = self.owner(state)
        try:
            return member.advanced(state, step)
        except VanishingError as end:
            problem, x = rearranged(state, state.problem.order, tuple(sorted({*state.problem.held, end.section})))
            return replace(member, problem=problem).at(x)

    def at_rest(self, state: BundleState) -> NewtonResult[BundleState]:
        """Solution next to a state at the end of a descent; sections of length 0 stay so."""
        try:
            return full_steps(state, self.advanced, self.largest_rotation, self.residual, 4)
        except VanishingError as end:
            return NewtonResult(end.state, False, 0, np.inf)

    def released(self, state: BundleState, freed: list[object]) -> BundleState | None:
        """State from which a descent continues after boundaries separate; None if none would."""
        apart = self.separated(state, freed, SETTLE)
        if apart is None:
            return None
        member = replace(self, problem=apart[0])
        start = member.at_scale(opened(member.problem, apart[1], VANISHING))
        return start if np.isfinite(start.energy) else None

    # --- Answers ------------------------------------------------------------------------------------------------------

    def solution(self, point: AnyPoint) -> ArmSolution:
        """Shape, energy, compliance, base wrench and estimated errors of a solved point."""
        state, problem = point.state, self.problem
        arm, ends = bundle_arm(self.rotations, state), np.cumsum(problem.lengths(state.x) * problem.count)
        # Tubes that end in the rigid part of the sheath are as long there as it is.
        tube_end = np.clip(problem.bundle.end, 0.0, problem.bundle.rigid_length)
        for place, boundary in zip(ends.tolist(), problem.order, strict=True):
            tube_end[list(boundary.ends)] = place
        first = np.repeat(arm.arc_length[:-1:4], problem.tableau.degree)
        s = first + state.h * np.tile(problem.tableau.nodes, len(problem.section))
        return ArmSolution(
            arm,
            arm.rotation[np.arange(problem.n), np.searchsorted(arm.arc_length, tube_end - 1e-12)],
            np.concatenate([[0.0], ends[:-1]]),
            tube_end,
            CollocationPoints(s, state.theta, state.bend / state.h[:, None]),
            margin=point.margin,
            energy=state.energy + (state.work if self.descends else 0.0),
            residual=self.residual(state),
            errors=self._errors(point),
            iterations=point.iterations,
            index=0 if point.margin > 0 else self.index(state),
            work=state.work,
            compliance=None if problem.load is None or abs(point.margin) < LEAST_STIFFNESS else self.compliance(state),
            base_wrench=self.base_wrench(state),
        )

    def compliance(self, state: BundleState) -> Array:
        """Compliance (6, 6) of the tip: force (N) and moment (N m) -> translation (m) and turn (rad), world axes."""
        return self.compliance_at(state, np.inf, None)

    def compliance_at(self, state: BundleState, arc_length: float, tube: int | None) -> Array:
        """Compliance (6, 6) of a cross-section where a section ends; the sheath carries a moment if `tube` is None.

        At the tip the tube that ends last carries it.
        """
        problem = state.problem
        section = problem.boundary_at(arc_length) if arc_length > HELD else -1
        if tube is None and section == len(problem.order) - 1:
            tube = problem.tip_tube
        slopes = cross_section_slopes(state, section, tube)
        return np.asarray(slopes @ np.linalg.solve(state.hessian, slopes.T))

    def base_wrench(self, state: BundleState) -> Array:
        """Force (N) and moment about the plate's centre (N m) of the load on the plate."""
        return np.zeros(6) if state.loading is None else self.factor * state.loading.wrench

    def _errors(self, point: AnyPoint) -> Errors:
        """Estimated errors: the change by a Newton step with more points."""
        finer, state, step = self.refined(point)
        last = len(self.problem.order) - 1
        pose = place_slopes(state, last)
        tip = pose.position + pose.by_x[:3] @ step - place_slopes(point.state, last).position
        theta = np.abs(finer.problem.push(step)[:, : self.problem.n]).max()
        return Errors(2 * float(theta), float(np.linalg.norm(tip)), 0.0)

    # --- Families -----------------------------------------------------------------------------------------------------

    def with_inputs(
        self, rotations: Array, translations: tuple[float, ...], load: Load | None, factor: float
    ) -> Bundled | None:
        """Same equations at other joint values and load, with the boundaries in the same order."""
        known = self.problem
        problem = known
        assert isinstance(self.robot, BundleRobot)
        # Equal inputs share one object.
        bundle = bundle_at(self.robot, translations)
        if bundle is not known.bundle or load is not known.load:
            order = moved_order(known, bundle, _places(load))
            if not order:
                return None
            problem = replace(known, bundle=bundle, order=order, load=load, density=_density(self.robot, load))
        return replace(self, problem=problem, rotations=rotations, translations=translations, factor=factor)

    def near(
        self, point: AnyPoint, rotations: Array, translations: tuple[float, ...], load: Load | None, factor: float
    ) -> Bundled:
        """Same equations at other inputs, with boundaries and elements as at a point close by."""
        known, state = replace(point.member, robot=self.robot), point.state
        like = known.with_inputs(rotations, translations, load, factor)
        if like is not None and np.array_equal(like.wanted(state), state.problem.count):
            return replace(self, problem=like.problem, rotations=rotations, translations=translations, factor=factor)
        assert isinstance(self.robot, BundleRobot)
        return Bundled.of(
            self.robot,
            rotations,
            translations,
            load,
            factor,
            start=lambda bundle, places: followed(state, bundle, places),
            discretisation=self.discretisation,
        )

    def wanted(self, state: BundleState) -> Index:
        """Numbers (m,) of elements that sections as long as in a state need."""
        problem, length = self.problem, state.problem.lengths(state.x) * state.problem.count
        mesh = self.discretisation.refinement, problem.load, problem.density
        return element_counts(problem.bundle, problem.order, length, *mesh)

    def under(self, point: AnyPoint, load: Load, factor: float) -> Bundled:
        """Problem at the joint values of a point under `factor` times another load."""
        return self.near(point, self.rotations, self.translations, load, factor)

    def transfer(self, point: AnyPoint) -> Array:
        """(U,) unknowns with the twist and the bending of a point, which may be on another mesh."""
        return carried(self.problem, point.state)

    def distance(self, point: AnyPoint, state: BundleState) -> float:
        """Largest difference (rad) of the twist and of the arm's direction."""
        member = self.owner(state)
        return member.largest_rotation(state, state.x - member.transfer(point))

    def reorders(self, point: AnyPoint, state: BundleState) -> bool:
        """True if boundaries passed each other, met or separated."""
        return _groups(point.state.problem) != _groups(state.problem)

    def round_off(self, state: BundleState) -> float:
        """Sum of elastic energy and work (J), which may cancel."""
        return abs(state.energy) + 2 * abs(state.work)
