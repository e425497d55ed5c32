"""Derivatives of an equilibrium of concentric tubes, of one curvature or made of pieces, with a load or without, by the
implicit function theorem.

What moves along the arm is taken at fixed arc lengths: a tube that moves carries what varies along it past every point,
and a breakpoint that moves uncovers a stretch with other tubes, which is a jump of all rates there. Where breakpoints
coincide the derivatives to either side differ, and both are exact.

The margin mu is the least of Q / T, of the second variation Q over its elastic part T. At its mode, with y the turn of
the tubes, v and g their torques and the bending moment, psi the turn of the frame,

    d mu = int [partial derivative of  y' (dM/dtheta) y - 2 g'(du/dtheta) y - (v^2 / kt + |g|^2 / K) / (1 - mu)
                - n.(psi x (psi x e))] ds / T,      R g = dm + m x psi,

since no other change of the mode matters to it. What is continuous where the tubes change is y, v, psi, dm.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from ..block.transcription.arm import between, shape_points
from ..block.transcription.arm_response import LinearisedArm, Response
from ..block.transcription.arm_state import sections_of
from ..block.transcription.buffered import bent_function, mapped, section_function
from ..block.transcription.collocated import ENDS, THROUGH_ENDS
from ..block.transcription.reduced import ReducedProblem, eccentric_sections
from ..block.transcription.second_variation import Mode, worst_mode
from ..errors import SolveError
from ..physics.certificate import worst_function
from ..physics.shape import cross, hat
from ..typing import Array, Index
from .arm_change import SHAPE_POINTS, ArmChange
from .directions import Change, Directions, columns_of
from .member import discretisation_of, sample_rotation
from .problem import loaded_problem, reduced_problem
from .result import Derivatives, Equilibrium, refuse_contact

# --- Margin of tubes off the centreline -------------------------------------------------------------------------------

# How the margin of tubes off the centreline changes with the parameters that an equilibrium is differentiated by.
#
# With the eigenvalue kappa = 1 - mu, its y of `block.transcription.second_variation`, the torques t of the tubes and
# those of the mode, tau, tau' = M' y, and the left vector zeta, the equation
#
#     zeta' { kappa (y - P [t / kt g' y]) - [|beta| / kt tau(0) + P g tau / kt] } = 0
#
# holds for every value of the parameters, so that with a(s) = int_s^L zeta and b(s) = (|beta| a(0) + int_0^s g a) / kt
#
#     d kappa . l'y = int a . (kappa d(t / kt g') y + d(g / kt) tau) - int b . d(M') y + a(0) . tau(0) d(|beta| / kt),
#
# where a breakpoint that moves gives the jumps of g, g' and M' at it.


def offset_change(of: ArmChange) -> Array:
    """Derivative (Q,) of the margin of tubes off the centreline; NaN at a double eigenvalue."""
    arm, problem, forcing, n = of.arm, of.problem, of.forcing, of.n
    solved = arm.mesh.collocated
    theta, torque = (table[solved].reshape(-1, n) for table in (arm.theta, arm.torque))
    mode = worst_mode(problem, theta)
    if mode is None:
        return np.zeros(of.size)
    if not np.isfinite(mode.pairing):
        return np.full(of.size, np.nan)
    along_arm, count = _ModeAlongArm(problem, theta, mode), len(theta)

    def at_points(table: Array) -> Array:
        """(N, r, Q) changes by the parameters at all points."""
        return table[solved].reshape(count, -1, of.size)

    changed = np.concatenate([at_points(of.response.phi), at_points(forcing.data)[:, n:]], axis=1)
    function = section_function("mode", count, n, True)
    slope = function(theta, problem.stiffness, problem.moment, *arm.offsets, *along_arm.weights)[1].reshape(
        count, 3 * n
    )
    out = np.einsum("a,ac,acq->q", problem.weight, slope, changed)
    softer, kappa = at_points(forcing.compliance), mode.value
    twisted = at_points(of.response.torque) / problem.assembly.torsional_stiffness[:, None] + softer * torque[..., None]
    out -= kappa * np.einsum("a,ai,aiq->q", problem.weight, along_arm.a * along_arm.stretched, twisted)
    out -= np.einsum("a,ai,aiq->q", problem.weight, along_arm.a * along_arm.g * along_arm.tau, softer)
    for p in np.flatnonzero(~solved):
        a, tau = along_arm.beyond(arm.mesh.start[p])
        out -= (a * tau) @ np.tensordot(arm.weights[p], forcing.compliance[p], 1)
    out -= (along_arm.a_start * along_arm.tau_start) @ forcing.transmission
    return np.asarray((out + along_arm.gains(of) @ of.widths) / mode.pairing)


class _ModeWeights(NamedTuple):
    """Weights (N, n) of the section function `mode`."""

    y: Array
    """Rotations of the mode."""
    moment_slope: Array
    """Weight of dM/dtheta."""
    stretch_slope: Array
    """Weight of dg/dtheta."""
    stretch: Array
    """Weight of the stretch g."""


class _ModePoint(NamedTuple):
    """Values (n,) of a mode at a breakpoint; symbols as above."""

    y: Array
    tau: Array
    a: Array
    b: Array


class _ModeAlongArm:
    """Mode along the arm: y, tau, a, b, t / kt and g' y at the points (N, n), and at breakpoints."""

    def __init__(self, problem: ReducedProblem, theta: Array, mode: Mode) -> None:
        weight = problem.weight[:, None]
        at = eccentric_sections(problem, theta)
        assert problem.stretch is not None
        up_to, beyond, _ = problem.stretch
        self.problem, self.mode, self.g, self.twist = problem, mode, at.g, at.twist
        self.stretched = np.einsum("aij,aj->ai", at.g_slope, mode.y)
        self.tau_rate = np.einsum("aij,aj->ai", at.slope, mode.y)
        # tau' = M' y and tau = 0 at the tip: the torque of the mode, as w is that of the state.
        self.tau, self.tau_start = -(beyond @ self.tau_rate), -(weight * self.tau_rate).sum(0)
        # The transpose of P sums over the points from a place to the tip.
        self.a, self.a_start = (up_to.T @ mode.zeta) / weight, mode.zeta.sum(0)
        self.b = np.zeros_like(theta)
        for block in problem.blocks:
            inside = np.ix_(block.points, block.tubes)
            compliance = at.rotation_by_torque(problem, block)
            self.b[inside] = np.einsum("iab,ai->bi", compliance, mode.zeta[inside]) / weight[block.points]

    @property
    def weights(self) -> _ModeWeights:
        """Weights of the section function `mode` at the points."""
        kt = self.problem.assembly.torsional_stiffness
        return _ModeWeights(self.mode.y, self.b, -self.mode.value * self.a * self.twist, -self.a * self.tau / kt)

    def gains(self, of: ArmChange) -> Array:
        """(T,) change of the equation by the strips that breakpoints uncover, per width."""
        strips, count, kappa = of.strips, len(of.strips.index), self.mode.value
        if not count:
            return np.zeros(0)
        kt, index = self.problem.assembly.torsional_stiffness, strips.index
        samples = [self._at(s) for s in of.cuts[index]]
        y, tau, a, b = (np.array(part * 2) for part in zip(*samples, strict=True))
        twist = np.concatenate([of.arm.torque_tip_side[index]] * 2) / kt
        weights = _ModeWeights(y, b, -kappa * a * twist, -a * tau / kt)
        function = section_function("mode", 2 * count, of.n, True)
        values = function(*of.strip_inputs[:3], *of.arm.offsets, *weights)[0].reshape(2, -1)
        return np.asarray(of.side * (strips.signs * values).sum(0))

    def beyond(self, s: float) -> tuple[Array, Array]:
        """Values a and tau (n,) at an arc length between whole elements."""
        beyond = self.problem.arc_length > s
        return self.mode.zeta[beyond].sum(0), -(self.problem.weight[:, None] * self.tau_rate)[beyond].sum(0)

    def _at(self, s: float) -> _ModePoint:
        """Mode at a breakpoint: whole elements lie on either side of it."""
        problem, mode = self.problem, self.mode
        kt, transmission = problem.assembly.torsional_stiffness, problem.assembly.transmission
        before, weight = problem.arc_length < s, problem.weight[:, None]
        turning = self.g * self.tau / (mode.value * kt) + self.twist * self.stretched
        y = transmission * self.tau_start / (mode.value * kt) + (weight * turning)[before].sum(0)
        b = transmission * self.a_start + (weight * self.g * self.a)[before].sum(0)
        mesh = problem.mesh
        for p in np.flatnonzero(~mesh.collocated & (mesh.start + mesh.length / 2 < s)):
            a, tau = self.beyond(mesh.start[p])
            y = y + mesh.length[p] * tau / (mode.value * kt)
            b = b + mesh.length[p] * a
        a, tau = self.beyond(s)
        return _ModePoint(y, tau, a, b / kt)


FLAT = 1 - 1e-9
"""Margin that counts as its largest value 1, which does not change."""

SOLVED = 1e-6
"""Largest difference of solved rotations from those that follow from the torques, rad."""

APART = 1e-7
"""Absolute margin below which an equilibrium is a fold."""


GAUSS = (0.5 - 0.5 / np.sqrt(3), 0.5 + 0.5 / np.sqrt(3)), (0.5, 0.5)
"""Points and weights of the mean over a short stretch, exact for cubic polynomials."""


class _Form(NamedTuple):
    """Second variation of a mode per length at X points."""

    value: Array
    """Values (X,) of the quadratic form."""
    slopes: Array
    """Gradient (X, n + 4) by theta, b and g."""
    by_data: Array
    """Gradient (X, 2 n) of the form by kb and m."""


class Linearised(ArmChange):
    """Derivatives of an equilibrium in Q directions, computed when they are read; see `Directions`."""

    @cached_property
    def margin(self) -> Array:
        """Derivative (Q,) of the margin; NaN at a double eigenvalue, and for loads without an energy."""
        return self._margin(one_of_two=False)

    @cached_property
    def one_margin(self) -> Array:
        """Derivative (Q,) of the margin; at a double eigenvalue, of one of its modes."""
        return self._margin(one_of_two=True)

    def _margin(self, *, one_of_two: bool) -> Array:
        if not self.arm.elements:
            return -self._softened
        if self.value >= FLAT:
            return np.zeros(self.size)
        if self.arm.offsets:
            return offset_change(self)
        load = self.arm.load
        known = (load is None or load.has_energy) and not np.isnan(self.value)
        mode = mode_of(self.arm, self.value, one_of_two) if known else None
        return np.full(self.size, np.nan) if mode is None else self._quotient(*mode)

    def certificate(self, value: float, y: Array) -> Array:
        """Derivative (Q,) of the certificate `value` with mode y (N, n), of `stability.certificate.worst_case`."""
        arm, n, solved = self.arm, self.n, self.arm.mesh.collocated
        if value >= FLAT:
            return np.zeros(self.size)
        worst = mapped(worst_function(n), len(y))(self.problem.stiffness, self.problem.moment, y)[0]
        decrease = np.zeros(arm.phase.shape)
        decrease[solved] = -(worst.reshape(-1, n, n) @ y[..., None]).reshape(-1, arm.degree, n)
        softness = 1 / (1 - value)
        return self._quotient(arm.torsion_mode(decrease, softness), softness, worst=True)

    @property
    def _softened(self) -> Array:
        """Decrease (Q,) of the margin of an arm of length zero as tubes leave the plate.

        It is the largest eigenvalue of -dM/dtheta over the stiffness of the transmissions, which alone twist, or 0.
        """
        root, slopes = np.sqrt(self.arm.transmission), sections_of(self.strip_inputs, self.arm.offsets).slopes
        slopes = np.einsum("bt,btij->tij", self.strips.signs, slopes.reshape(2, -1, *slopes.shape[1:]))
        # Symmetric as the second variation, and with the same eigenvalues as -dM/dtheta times compliance.
        second = -root[:, None] * slopes[:, : self.n, : self.n] * root
        symmetric = (second + second.swapaxes(1, 2)) / 2
        return np.asarray(np.linalg.eigvalsh(np.tensordot(self.widths.T, symmetric, 1)).max(1, initial=0.0))

    def _form(self, inputs: Sequence[Array], softness: float, *, worst: bool, data: bool = False) -> _Form:
        """Second variation of a mode per length at theta, kb, m, b, with g and y, and its gradients.

        It is taken at the equilibrium, or at the `worst` rotations; without `data` the gradient by kb and m is 0.
        """
        count, n = inputs[0].shape
        if worst:
            _, form, slope, _ = mapped(worst_function(n), count)(inputs[1], inputs[2], inputs[5])
            return _Form(form[:, 0].copy(), np.zeros((count, n + 4)), slope.reshape(count, 2 * n).copy())
        form, slope = (part.copy() for part in bent_function("mode", count, n)(*inputs, softness))
        by_data = (
            bent_function("mode_data", count, n)(*inputs, softness)[0].copy() if data else np.zeros((count, 2 * n))
        )
        return _Form(form[:, 0], slope.reshape(count, -1), by_data.reshape(count, -1))

    def _quotient(self, mode: Response, softness: float, *, worst: bool = False) -> Array:
        """Derivative (Q,) of the smallest eigenvalue of the second variation, from its mode."""
        arm, forcing, n, size = self.arm, self.forcing, self.n, self.size
        weights, torque = arm.weights, mode.torque[..., 0]
        y, g = mode.phi[..., 0], mode.bending_moment[..., 0]
        count, data = len(weights.ravel()), bool(forcing.data.any())
        flat = (arm.theta, arm.stiffness, arm.natural_moment, arm.bending_moment, g, y)
        tables = [table.reshape(count, -1) for table in flat]
        _, slope, by_data = self._form(tables, softness, worst=worst, data=data)
        by = weights.ravel()[:, None] * slope
        out = np.zeros(size) if worst else by[:, :n].ravel() @ self.response.phi.reshape(-1, size)
        if data:
            weighted = np.concatenate([by[:, :n], weights.ravel()[:, None] * by_data], axis=1)
            out += weighted.ravel() @ forcing.data.reshape(-1, size)
        if arm.load is not None:
            out += self._load_change(mode, by)
        # int v^2 d(1 / kt): a softer tube lowers the margin where the mode twists it.
        out -= softness * (weights[..., None] * torque**2).ravel() @ forcing.compliance.reshape(-1, size)
        plate_torque = mode.state[0, n + 3 : 2 * n + 3, 0]
        out -= softness * plate_torque**2 @ forcing.transmission
        out += self._mode_gains(mode, softness, worst=worst) @ self.widths
        # The mode is stationary for Q / T: only the explicit change of Q - mu T counts, over T.
        return np.asarray(out / arm.elastic(mode, softness))

    def _load_change(self, mode: Response, by: Array) -> Array:
        """Part (Q,) of the change of Q - mu T of a mode due to forces, moments and the frame.

        `by` is the gradient (X, n + 4).
        """
        arm, moved, n, size = self.arm, self.response, self.n, self.size
        psi, moment = mode.psi[..., 0], mode.moment[..., 0]
        out = by[:, n : n + 2].ravel() @ moved.bending_moment.reshape(-1, size)
        across = (arm.frame[..., :2] @ by[:, n + 2 :].reshape(arm.elements, arm.degree, 2, 1))[..., 0]
        turns = hat(psi)
        twice = arm.weights[..., None, None] * (turns @ turns)
        # g = (R'(dm + m x psi))_xy: by the moment, of which half is the costate's, and by the turn of the frame.
        total = moment - (turns @ arm.moment[..., None])[..., 0]
        out += ((turns @ across[..., None])[..., 0] / 2).ravel() @ moved.moment.reshape(-1, size)
        turning = cross(across, total) - cross(arm.axis, (twice @ arm.force[..., None])[..., 0])
        out += turning.ravel() @ moved.psi.reshape(-1, size)
        return np.asarray(out - (twice @ arm.axis[..., None]).ravel() @ self.forcing.force.reshape(-1, size))

    def _mode_gains(self, mode: Response, softness: float, *, worst: bool) -> Array:
        """Change (T,) of Q - mu T of a mode (second variation Q, elastic part T) per width of a strip."""
        arm, strips, n = self.arm, self.strips, self.n
        index = strips.index
        if not len(index):
            return np.zeros(0)
        frame, state = arm.end_frame[index], mode.state[index, :, 0]
        y, psi, torque, moment = state[:, :n], state[:, n : n + 3], state[:, n + 3 : 2 * n + 3], state[:, 2 * n + 3 :]
        # hat(psi) b = psi x b: the turn of the frame by the mode.
        turns, bends = hat(psi), (arm.moment_plate_side if self.side < 0 else arm.moment_tip_side)[index]
        total = moment - (turns @ bends[..., None])[..., 0]
        g = (frame[..., :2].swapaxes(1, 2) @ total[..., None])[..., 0]
        form = self._form([*self.strip_inputs, np.concatenate([g, g]), np.concatenate([y, y])], softness, worst=worst)[
            0
        ]
        # Work of the force on the cross-section, n.(psi x (psi x e)).
        work = (self._strip_force * (turns @ turns @ frame[..., 2:])[..., 0]).sum(1)
        twist = softness * (strips.compliance * torque**2).sum(2)
        return np.asarray(self.side * (strips.signs * (form.reshape(2, -1) - twist - work)).sum(0))


@lru_cache(maxsize=8)
def mode_of(arm: LinearisedArm, margin: float, one_of_two: bool) -> tuple[Response, float] | None:
    """Buckling mode of an arm, cached for further directions."""
    return arm.mode(margin, one_of_two=one_of_two)


def linearise(
    equilibrium: Equilibrium,
    wrt: Sequence[str] = ("rotations", "translations"),
    side: int = 1,
    more: Callable[[Directions], Sequence[Change]] | None = None,
    along: Array | None = None,
) -> Linearised:
    """Derivatives of an equilibrium of concentric tubes; see `Linearised`.

    Raises:
        InputError: friction acts on it.
        SolveError: it is a fold.
    """
    if abs(equilibrium.margin) < APART:
        raise SolveError("the equilibrium is a fold (margin 0), where derivatives are infinite")
    tubes = equilibrium.robot.tubes
    straight = "curvature" in wrt and not all(tube.curvature for tube in tubes)
    return Linearised(standing_of(equilibrium, straight), tubes, equilibrium.margin, wrt, side, more, along)


@lru_cache(maxsize=64)
def sharing(carriages: tuple[tuple[int, ...], ...], wrt: tuple[str, ...]) -> Array | None:
    """Directions (L, L) that move the tubes of a carriage together, with equal parts of its motion.

    None if every tube has a carriage of its own. The chain rule holds for every possible motion.
    """
    if "translations" not in wrt or all(len(tubes) == 1 for tubes in carriages):
        return None
    counts = columns_of(wrt, sum(len(tubes) for tubes in carriages))
    along, first = np.eye(sum(counts)), sum(counts[: wrt.index("translations")])
    for tubes in carriages:
        members = first + np.array(tubes)
        # The mean over a carriage: sums over its tubes give the change by their common motion.
        along[np.ix_(members, members)] = 1 / len(tubes)
    return along


@lru_cache(maxsize=8)
def standing_of(equilibrium: Equilibrium, straight: bool = True) -> LinearisedArm:
    """Arm of an equilibrium of concentric tubes, on the mesh of its solve; `straight` as in `ArmState`.

    Raises:
        InputError: friction acts on it.
        SolveError: it was not solved.
    """
    refuse_contact(equilibrium)
    robot, shift = equilibrium.robot, tuple(equilibrium.translations.tolist())
    if equilibrium.load is None:
        problem, loaded = reduced_problem(robot, shift, discretisation_of(equilibrium)), None
    else:
        loaded = loaded_problem(robot, shift, equilibrium.load, discretisation_of(equilibrium))
        problem = loaded.torsion
    solved = sample_rotation(equilibrium, problem.arc_length)
    arm = LinearisedArm(problem, equilibrium.rotations, solved, equilibrium.arm, loaded=loaded, straight=straight)
    # Rotations follow from the torques: those of a state that was not solved differ.
    residual = arm.phi[arm.mesh.collocated].ravel() - solved.ravel()
    off = float(np.abs(residual[problem.flat]).max(initial=0.0))
    if off > SOLVED:
        raise SolveError(f"the equilibrium is a fold or was not solved: its rotations are off by {off:.1e} rad")
    return arm


# --- At a fraction of the arm's length --------------------------------------------------------------------------------


def positions_at(of: Derivatives, fractions: Array) -> Array:
    """Positions (K, 3) at fractions (K,) of the arm's length in front of the plate, m."""
    if len(of.cuts) < 2:
        return np.repeat(of.shape.position[-1:], len(fractions), axis=0)
    through = _through(of, fractions)
    return np.asarray(np.einsum("kw,kwc->kc", through.weights, of.shape.position[through.points]))


def position_changes(of: Derivatives, fractions: Array) -> Array:
    """Changes (K, 3, Q) of the positions at fractions (K,) of the arm's length, which changes too."""
    # A shape point also moves along its tangent; the change of the last one contains that already.
    change = of.position + of.shape.frame[:, :, 2, None] * of.moved[:, None]
    change[-1] = of.position[-1]
    if len(of.cuts) < 2:
        return np.repeat(change[-1:], len(fractions), axis=0)
    through, ends = _through(of, fractions), of.moved[:: len(ENDS) - 1]
    start, end = ends[through.element], ends[through.element + 1]
    # x = (fraction L - s_k) / h: at a fixed fraction of a length that changes, x changes too.
    along = np.einsum("kw,kwc->kc", through.rates, of.shape.position[through.points])
    passed = fractions[:, None] * of.moved[-1] - start - through.x * (end - start)
    return np.asarray(
        np.einsum("kw,kwcq->kcq", through.weights, change[through.points]) + along[..., None] * passed[:, None]
    )


def curvature_at(of: Linearised, fraction: float) -> tuple[Array, Array]:
    """Curvature (2,) in the Bishop frame at a fraction of the arm's length, 1/m, and its change (2, Q)."""
    if len(of.cuts) < 2:
        return np.zeros(2), np.zeros((2, of.size))
    k, x = place_of(of, fraction)
    result = of.section(k, x, fraction * of.moved[-1])
    return result.curvature, result.by_curvature


def tip_forces(of: Directions) -> list[Change]:
    """Changes by the x, y and z components of a dead force at the tip, N, for `more` of `linearise`."""
    arm, still = of.arm, np.zeros(of.n)
    none = np.zeros((arm.elements, arm.degree, of.n))
    force = np.broadcast_to(np.eye(3)[:, None, None], (3, arm.elements, arm.degree, 3))
    return [
        Change(transmission=still, rate=none, stiffness=none, moment=none, phase=none, twist_angle=still, force=each)
        for each in force
    ]


def base_wrench_change(of: Linearised) -> Array:
    """Change (6, Q) of the force (N) and moment (N m) of the load on the plate, world axes."""
    n, state = of.n, of.response.state[0]
    force = of.forcing.force[0, 0] if of.arm.elements else np.zeros((3, of.size))
    # The plate lies across z: bending moments about x and y, and the torques of all tubes about z.
    return np.concatenate([force, state[2 * n + 3 : 2 * n + 5], state[n + 3 : 2 * n + 3].sum(0)[None]])


def curvature_in_tube(of: Linearised, tube: int, ends: tuple[float, float], moves: Array) -> tuple[Array, Array]:
    """Mean curvature (2,) of a stretch of a tube in its own axes, 1/m, and its change (2, Q).

    The stretch lies between arc lengths of the arm, m, and moves along it by (Q,) with the tube. Behind the plate tubes
    are straight.
    """
    arm, (first, last) = of.arm, ends
    value, change = np.zeros(2), np.zeros((2, of.size))
    # A tube made of pieces has axes of its own, which its natural twist turns; theta is that of its precurvature.
    turned = of.problem.compliant.sections.twist_angle.reshape(arm.phase.shape) - arm.phase
    for k in np.flatnonzero((of.cuts[1:] > first) & (of.cuts[:-1] < last)).tolist():
        # Curvature jumps where elements meet: each part of the stretch has points of its own, which move with its ends.
        low, high = max(first, of.cuts[k]), min(last, of.cuts[k + 1])
        from_, to = (
            moves if inside else of.moved[(len(SHAPE_POINTS) - 1) * j]
            for inside, j in ((low == first, k), (high == last, k + 1))
        )
        for x, weight in zip(*GAUSS, strict=True):
            fraction = float((low + x * (high - low) - of.cuts[k]) / arm.length[k])
            at = of.section(k, fraction, (1 - x) * from_ + x * to)
            theta = float(at.rotation[tube] + arm.tableau.basis((fraction,), 0)[0] @ turned[k, :, tube])
            c, s = np.cos(theta), np.sin(theta)
            to_tube = np.array([[c, s], [-s, c]])
            u = to_tube @ at.curvature
            by = to_tube @ at.by_curvature + np.outer([u[1], -u[0]], at.by_tubes[tube])
            value += weight * (high - low) * u
            change += weight * ((high - low) * by + np.outer(u, to - from_))
    return value / (last - first), change / (last - first)


def place_of(of: Derivatives, fraction: float) -> tuple[int, float]:
    """Element at a fraction of the arm's length, and the fraction within the element."""
    (k,), _, (x,) = between(of.cuts, np.array([fraction * of.cuts[-1]]))
    return int(k), float(x)


class _Through(NamedTuple):
    """Polynomials through the shape points of elements, at K places."""

    element: Index
    """Numbers (K,) of the elements."""
    x: Array
    """Fractions (K, 1) of the elements."""
    points: Index
    """Indices (K, 5) of the shape points of the elements."""
    weights: Array
    """Weights (K, 5) of the values."""
    rates: Array
    """Weights (K, 5) of the derivatives along the arm, 1/m."""


def _through(of: Derivatives, fractions: Array) -> _Through:
    """Polynomials at fractions (K,) of the length."""
    k, length, x = between(of.cuts, fractions * of.cuts[-1])
    powers, x = np.arange(len(ENDS)), x[:, None]
    weights = np.power(x, powers) @ THROUGH_ENDS
    rates = powers * np.power(x, np.maximum(powers - 1, 0)) / length[:, None] @ THROUGH_ENDS
    return _Through(k, x, shape_points(len(of.cuts) - 1)[k], weights, rates)
