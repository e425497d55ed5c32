"""Snap-free certificate: one eigenvalue that bounds the margin for every rotation at once.

Every coupling c_ij cos(theta_i - theta_j) of the second variation is replaced by its worst value, -|c_ij|. If the form
stays positive, the energy is strictly convex for all joint rotations: one equilibrium for each, and no snap. Under a
force at the tip the parts of the form by the force are bounded as well (see below).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..arguments import typed
from ..block.transcription.arm import evaluate_arm
from ..block.transcription.arm_response import LinearisedArm
from ..block.transcription.buffered import mapped
from ..block.transcription.reduced import ReducedProblem, torsional_hessian
from ..block.transcription.second_variation import least as least_value
from ..display import Displayed
from ..equilibrium.bundle import bundle_at
from ..equilibrium.linearised import Linearised
from ..equilibrium.member import PlainPoint, Point, Unloaded
from ..equilibrium.problem import DEFAULT_DISCRETISATION, reduced_assembly, reduced_problem
from ..errors import InputError, positive
from ..files.field_metadata import form, unit
from ..physics.certificate import APART, OPPOSED, PARAMETERS, largest_eigenvalue, worst_function
from ..robots.assembly import assemble, merge
from ..robots.eccentric import BundleRobot
from ..robots.lengthwise import variation
from ..robots.limits import check_force
from ..robots.robot import Robot, shifts
from ..robots.tubes import Tube
from ..solvers.blas import small
from ..solvers.time_limit import check_time
from ..typing import Array, StatusEnum
from .bundle_certificate import Proof, bundle_proof, proof_slopes
from .eccentric_certificate import proof, proof_gradient
from .pair import least_margin_of_pair, margins, pair_of
from .shooting import profiles, to_base

# --- Under a force at the tip -----------------------------------------------------------------------------------------

# Bound on the margin for all rotations and all dead forces at the tip.
#
# In rotations theta and bending w = u - u0(theta) every configuration is a point of one vector space. The second
# variation of the potential energy, in the directions y and r of the two, is (see docs/theory-loads.md)
#
#     Q = T + int y'V''y + sum_i (m.a_i / K) y_i^2 - m_w.(psi x psi') - (n.psi)(t.psi) + (n.t) |psi|^2,
#     T = int sum kt y'^2 + K |r|^2 + springs,        psi' = R (u0' y + r),  psi(0) = 0.
#
# With |n| <= F, |m_w(s)| <= M(s) = F (L - s) and A_i = |a_i| / K, for every rotation and every direction of the force,
#
#     Q >= T - N,    N = int sum_pairs |c_ij| (Y_i + Y_j)^2 + sum_i M A_i Y_i^2 + 3/2 F phi^2,
#     Y_i = |y_i|,   phi' = sum A_i Y_i + |r|,   phi(0) = 0,
#
# so that 1 - lambda_max(N, T) bounds the margin from below (see `physics.certificate`).


@dataclass(frozen=True, eq=False)
class ArmSections:
    """Properties of an arm of n tubes in m sections, plate to tip, that enter the bounds."""

    start: Array
    """(m,) arc length of the start of each section, m."""
    length: Array
    """(m,) length of each section, m."""
    stiffness: Array
    """(m,) total bending stiffness K of each section, N m^2."""
    natural_moment: Array
    """(m, n) natural moments |a_i|, bending stiffness times precurvature, N m."""
    torsional: Array
    """Torsional stiffness kt (n,), N m^2."""
    transmission: Array
    """(n,) length from the clamped end to the plate, m."""

    @property
    def total_length(self) -> float:
        """Length of the arm, m."""
        return float(self.start[-1] + self.length[-1]) if len(self.start) else 0.0

    def softening(self, force: float, *, pairs: bool) -> float:
        """Largest eigenvalue of the softening form relative to the stiffness, for forces of at most `force`, N.

        Without `pairs` only the softening by the force counts.
        """
        sections, tubes = (self.length, self.stiffness, self.natural_moment), (self.torsional, self.transmission)
        return largest_eigenvalue(force, sections, tubes, OPPOSED if pairs else APART)[0]


def arm_sections(robot: Robot, near: Array, far: Array | None = None) -> ArmSections:
    """Arm of concentric tubes at translations (n,), or with bounds for all translations from `near` to `far`.

    In a section every tube has the largest precurvature, the smallest bending and the smallest torsional stiffness
    that it may have there; arm and transmissions are as long as they may be. Fields Y, phi, r of an arm in between,
    continued beyond its ends with Y constant and r = 0, have no larger T and no smaller N on this one.
    """
    arms = [robot.assembly(near), robot.assembly(near if far is None else far)]
    cells, transmission = variation(tuple(robot.tubes)), np.stack([arm.transmission for arm in arms])
    cell_ends = cells.cuts - transmission[:, :, None]
    cuts = merge(np.maximum(np.concatenate([[0.0], cell_ends.ravel()]), 0.0))
    start, length = cuts[:-1], np.diff(cuts)
    middle = (start + length / 2)[:, None, None]
    infinity = np.full((robot.n_tubes, 1), np.inf)
    lower, upper = np.hstack([-infinity, cell_ends.min(0)]), np.hstack([cell_ends.max(0), infinity])
    # (m, n, C + 1) cells that a section may be in; the last is behind the end of a tube, where it has no stiffness.
    possible = (lower < middle) & (middle < upper)
    kb, behind = cells.bending[0], np.isinf(upper)
    certain_kb = np.where(possible, np.where(behind, 0.0, kb), np.inf).min(2)
    # Beyond the last end that is certain some tube is present, since there is an arm: at least the softest possible.
    softest_kb = np.where(possible & ~behind, kb, np.inf).min((1, 2))
    return ArmSections(
        start=start,
        length=length,
        stiffness=np.maximum(certain_kb.sum(1), softest_kb),
        natural_moment=np.where(possible & ~behind, cells.moment[0], 0.0).max(2),
        torsional=cells.torsional.min(1),
        transmission=transmission.max(0),
    )


def loaded_worst_case(robot: Robot, translations: Array, unloaded: float, force: float) -> float:
    """Lower bound on the margin for all rotations and all dead tip forces up to `force`, N; `unloaded` without.

    The larger of two bounds: 1 - lambda_max(N, T), and `unloaded` less the eigenvalue of the parts of N by the force
    (the smallest value of a sum is at least the sum of the smallest values). The second is the sharper one for weak
    forces on three or more tubes, which cannot all oppose one another as N assumes.
    """
    bundle = arm_sections(robot, translations)
    if not force or not bundle.total_length:
        return unloaded
    separate = unloaded - bundle.softening(force, pairs=False)
    joint = 1 - bundle.softening(force, pairs=True)
    return min(unloaded, max(separate, joint))


# --- Without a load ---------------------------------------------------------------------------------------------------

ROUNDING = 1e-9
"""Certificate below which its sign proves nothing: it is computed to about 1e-11."""


class CertificateStatus(StatusEnum):
    """Statement of a certificate, as a sentence."""

    SNAP_FREE = "it is proved that the robot cannot snap at any rotation"
    OPEN = "it is not proved that the robot cannot snap"
    NONE = "there is no proof for this arrangement of tubes side by side"


@dataclass(frozen=True)
class CertificateStatistics:
    """Size of the problem."""

    tubes: int
    """Number of tubes of the robot."""
    pairs: int
    """Number of coupled pairs."""


@dataclass(frozen=True, eq=False)
class Certificate(Displayed):
    """Proved stability of a robot at its translations, for all rotations."""

    margin: Annotated[float, "certificate"]
    """mu_cert; above 0 no rotations can make the robot snap, and there is one equilibrium for each.

    Of bundles, one within the bounds of the proof, which no motion from home leaves.
    -inf if nothing can be proved: eccentric tubes that are not three equal ones per segment, and bundles with an
    `obstacle`.
    """
    translations: Annotated[Array, unit("mm"), form(".6g"), "translations"]
    """(n,) translations of the robot, m."""
    gradient: dict[str, Array]
    """Derivatives of the margin with respect to `physics.certificate.PARAMETERS`, each (n,), per SI unit.

    Where breakpoints meet, derivatives for a growing parameter. NaN for a double eigenvalue, which has none.
    """
    pair: tuple[int, int] | None
    """Pair of tubes (0 is the innermost) that reduces the margin most.

    None without coupling, and for eccentric tubes, where three act together.
    """
    section: tuple[float, float] | None
    """Section (start, end) with the largest reduction of the margin by the coupling, m."""
    pair_fractions: Array
    """(n, n) fraction of 1 - margin due to each pair; sums to 1 above the diagonal, and 0 for bundles."""
    obstacle: str = ""
    """Reason why nothing can be proved for a bundle, as a sentence."""

    @property
    def value(self) -> float:
        """Certified margin."""
        return self.margin

    @property
    def status(self) -> CertificateStatus:
        """Statement about snapping, as a sentence."""
        if np.isneginf(self.margin):
            return CertificateStatus.NONE
        return CertificateStatus.SNAP_FREE if self.snap_free else CertificateStatus.OPEN

    @property
    def statistics(self) -> CertificateStatistics:
        """Numbers of tubes and of coupled pairs."""
        return CertificateStatistics(len(self.translations), int((np.triu(self.pair_fractions, 1) > 0).sum()))

    @property
    def snap_free(self) -> bool:
        """True if the margin is above 0 beyond round-off: snapping is excluded at every rotation."""
        return self.margin > ROUNDING


@typed
@small
def snap_free_certificate(robot: Robot, translations: ArrayLike | None = None, *, max_force: float = 0.0) -> float:
    """mu_cert: lower bound on the stability margin over all rotations, at fixed translations.

    Above 0 the elastic energy is strictly convex at all rotations: one equilibrium, no snap anywhere. The bound is the
    margin of the worst case in which all curved tubes oppose each other. Two tubes reach it, so it is exact for them.
    Three cannot oppose each other pairwise, so it is conservative for more.

    Tubes made of pieces: exact for two coupled ones, with any curvatures, twists and stiffnesses along them (see
    `stability.pair`). For more it is a lower bound: the second variation at any rotations is at least that of the worst
    case, point by point. The possible error of the mesh for varying couplings is subtracted, estimated from a finer
    mesh.

    Tubes off the centreline, in segments of three equal ones: the fraction of torsional stiffness that they may lose
    before the proof fails (see `eccentric_certificate`). Above 0 they cannot snap, but it is no bound on the margin.
    Other arrangements have no proof, and the number is -inf.

    Bundles: a lower bound of the second variation of their energy, relative to its parts that stiffen (see
    `bundle_certificate`). Above 0 they cannot snap, but it is no bound on the margin. It is -inf where bending may
    change the order of the ends: `certify` names the tubes, and how far apart their ends must be.

    `max_force` includes all dead forces on the tip of at most that size, in any direction: above 0 the robot cannot
    snap or buckle under any of them. Moments, follower forces and forces along the arm are not covered.

    Args:
        translations: (n,) m; default home.
        max_force: N; concentric tubes only.

    Raises:
        InputError: wrong number of translations, one that is not finite, a tube out of its actuator; a force that is
            negative, or on tubes off the centreline.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> round(tubeopt.snap_free_certificate(robot), 3)
        -0.996
    """
    shift = shifts(robot, translations)
    if isinstance(robot, BundleRobot):
        if positive("max_force", max_force, zero=True):
            raise InputError(f"max_force is {max_force:g} N; it must be 0 for bundles: there is no proof under force")
        return proof_of_bundle(robot, shift).margin
    assembly = robot.assembly(shift)
    check_force(robot.tubes, "max_force", positive("max_force", max_force, zero=True), assembly.total_length)
    if max_force and assembly.eccentric:
        raise InputError(
            f"max_force is {max_force:g} N; it must be 0 for eccentric robots: there is no proof under force"
        )
    if assembly.eccentric:
        return proof(assembly)[0]
    unloaded = worst_case(_problem(robot, shift)).margin if assembly.even else _of_pieces(robot, shift)[0]
    return loaded_worst_case(robot, shift, unloaded, max_force) if max_force else unloaded


def convexity(robot: Robot, translations: Array) -> float:
    """Lower bound on the second variation of concentric tubes, relative to its torsional part, at any theta(s).

    It holds for configurations that are no equilibria, too, and is at most the certificate. For tubes made of pieces
    the change on a mesh of half the size, more than the error of the mesh, is subtracted.
    """
    value = worst_case(_problem(robot, translations)).margin
    return value if robot.even else value - abs(worst_case(_problem(robot, translations, 1)).margin - value)


def _of_pieces(robot: Robot, shift: Array) -> tuple[float, Array | None]:
    """Certificate of tubes made of pieces; and the (N,) cosines of `PairMinimum.opposition`, if it uses them.

    Two coupled tubes reach a smallest margin above the worst case where their bends cannot oppose each other all along.
    The change on a mesh of half the size, more than the error of the mesh, is subtracted.
    """
    value, pair = convexity(robot, shift), pair_of(_problem(robot, shift))
    finer = None if pair is None else pair_of(_problem(robot, shift, 1))
    if pair is None or finer is None:
        return value, None
    minimum = least_margin_of_pair(pair)
    on_finer_mesh = min(1.0, float(margins(finer, np.array([minimum.tip]))[0]))
    sharper = minimum.bound - abs(on_finer_mesh - minimum.margin)
    return (sharper, minimum.opposition) if sharper > value else (value, None)


def proof_of_bundle(robot: BundleRobot, translations: Array) -> Proof:
    """Certificate of a bundle at translations (n,), m; none with a rigid tip of the sheath."""
    if robot.sheath_rigid_from is not None:
        tip = f"the sheath is rigid from {1e3 * robot.sheath_rigid_from:g} mm on"
        return Proof(-np.inf, f"{tip}; there is a proof for flexible tips only.")
    return bundle_proof(bundle_at(robot, tuple(translations.tolist())).beyond_rigid_length)


def estimated_certificate(robot: Robot, shift: Array) -> float:
    """Snap-free certificate without the bound on the mesh error: for searches, not for proofs."""
    check_time()
    if isinstance(robot, BundleRobot):
        return snap_free_certificate(robot, shift)
    assembly = robot.assembly(shift)
    if assembly.eccentric:
        return proof(assembly)[0]
    problem = reduced_assembly(assembly)
    if robot.even:
        return least_value(torsional_hessian(problem, _at_worst(problem)[0]))
    value, pair = worst_case(problem).margin, pair_of(problem)
    return value if pair is None else max(value, least_margin_of_pair(pair).bound)


def _problem(robot: Robot, shift: Array, refinement: int = DEFAULT_DISCRETISATION.refinement) -> ReducedProblem:
    """Unloaded problem on a mesh with pieces halved `refinement` times."""
    return reduced_problem(robot, tuple(shift.tolist()), replace(DEFAULT_DISCRETISATION, refinement=refinement))


def _at_worst(problem: ReducedProblem, opposition: Array | None = None) -> tuple[Array, Array]:
    """(N, n, n) second derivatives V'' at the points with all pairs of tubes opposed, and couplings |c_ij|.

    `opposition` (N,): cosines of the angle between the bends of the only pair, -1 where it is opposed.
    """
    count, n = problem.moment.shape
    result = mapped(worst_function(n), count)(problem.stiffness, problem.moment, np.zeros((count, n)))
    second, coupling = (result[k].reshape(count, n, n).copy() for k in (0, 3))
    if opposition is None:
        return second, coupling
    return second * -opposition[:, None, None], coupling * -opposition[:, None, None]


class OpposedSpectrum(NamedTuple):
    """Smallest eigenvalues of the second variation with all curved tubes opposed."""

    margin: float
    """Smallest eigenvalue mu_cert, at most 1."""
    eigenvector: Array
    """(N, n) eigenvector y at the collocation points, with int kt y'^2 = 1."""
    next_eigenvalue: float


def worst_case(problem: ReducedProblem, opposition: Array | None = None) -> OpposedSpectrum:
    """Smallest eigenvalue mu_cert of the second variation in the worst case; `opposition` as in `_at_worst`."""
    check_time()
    count, n = problem.moment.shape
    y = np.zeros((count, n))
    if not problem.size:
        return OpposedSpectrum(1.0, y, 1.0)
    values, vectors = np.linalg.eigh(torsional_hessian(problem, _at_worst(problem, opposition)[0]))
    y.ravel()[problem.flat] = problem.factor @ vectors[:, 0]
    return OpposedSpectrum(min(1.0, float(values[0])), y, float(values[min(1, len(values) - 1)]))


@typed
@small
def certify(robot: Robot, translations: ArrayLike | None = None) -> Certificate:
    """`snap_free_certificate` with its gradient, and the pair of tubes and the section that limit it.

    Raises:
        InputError: as `snap_free_certificate`.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> tubeopt.certify(robot).snap_free
        False
    """
    n, shift = robot.n_tubes, shifts(robot, translations)
    if isinstance(robot, BundleRobot):
        found, gradient = proof_of_bundle(robot, shift), {name: np.full(n, np.nan) for name in PARAMETERS}
        bundle = bundle_at(robot, tuple(shift.tolist())).beyond_rigid_length
        for name in PARAMETERS if np.isfinite(found.margin) else ():
            of = "translations" if name == "translation" else name
            gradient[name] = proof_slopes(bundle, {of: np.eye(n)})[0]
        return Certificate(
            margin=found.margin,
            translations=shift,
            gradient=gradient,
            pair=None,
            section=None,
            pair_fractions=np.zeros((n, n)),
            obstacle=found.obstacle,
        )
    if robot.assembly(shift).eccentric:
        return _of_segments(robot, shift)
    problem, opposition, proved = _problem(robot, shift), None, None
    if not robot.even:
        proved, opposition = _of_pieces(robot, shift)
    margin, y, next_eigenvalue = worst_case(problem, opposition)
    if margin >= 1 - 1e-12:
        zero = {name: np.zeros(n) for name in PARAMETERS}
        return Certificate(
            margin=margin, translations=shift, gradient=zero, pair=None, section=None, pair_fractions=np.zeros((n, n))
        )

    # 1 - margin is a sum over points and pairs of |c_ij| (y_i - y_j)^2: the largest parts limit the robot.
    work = _at_worst(problem, opposition)[1] * (y[:, :, None] - y[:, None, :]) ** 2 * problem.weight[:, None, None]
    fraction = work.sum(0) / (1 - margin)
    i, j = np.unravel_index(int(np.argmax(np.triu(fraction))), fraction.shape)
    mesh, assembly = problem.mesh, problem.assembly
    section = np.repeat(mesh.section[mesh.collocated], mesh.tableau.degree)
    k = int(np.argmax(np.bincount(section, weights=work.sum((1, 2)), minlength=assembly.n_sections)))
    span = float(assembly.start[k]), float(assembly.start[k] + assembly.length[k])

    slope = np.full(n * len(PARAMETERS), np.nan)
    member = Unloaded.of(robot, np.zeros(n), tuple(shift.tolist()))
    if opposition is not None:
        # The smallest margin of two tubes made of pieces belongs to an equilibrium.
        worst = worst_of_pair(member, worst_case(problem).margin)
        if worst is not None:
            slope = _linearised(worst).one_margin
    elif next_eigenvalue - margin >= 1e-9:
        # Rotations do not enter the worst case: any state will do, such as tubes without torsion.
        untwisted = Point(0.0, member, member.at(np.zeros(problem.size)), 1.0)
        slope = _linearised(untwisted).certificate(margin, y)
    gradient = dict(zip(PARAMETERS, slope.reshape(-1, n), strict=True))
    return Certificate(margin if proved is None else proved, shift, gradient, (int(i), int(j)), span, fraction)


def _of_segments(robot: Robot, shift: Array) -> Certificate:
    """Certificate of eccentric tubes; all three tubes of a segment reduce the margin equally."""
    assembly = robot.assembly(shift)
    margin, segment = proof(assembly)

    def proved(tubes: Sequence[Tube], moved: Array) -> float:
        return proof(assemble(tubes, moved, offset=assembly.offset, offset_angle=assembly.offset_angle))[0]

    gradient = proof_gradient(robot, shift, proved, robot.moving_together)
    fraction = np.zeros((robot.n_tubes, robot.n_tubes))
    if segment is not None:
        tubes = list(segment.tubes)
        fraction[np.ix_(tubes, tubes)] = (1 - np.eye(3)) / 3
    return Certificate(
        margin=margin,
        translations=shift,
        gradient=gradient,
        pair=None,
        section=None if segment is None else segment.section,
        pair_fractions=fraction,
    )


def _linearised(point: PlainPoint) -> Linearised:
    """Derivatives of the certificate or margin with respect to PARAMETERS at a point."""
    problem, rotations, state = point.member.problem, point.member.rotations, point.state
    arm = LinearisedArm(problem, rotations, state.theta, evaluate_arm(problem, rotations, state, point.torsion))
    names = tuple("translations" if name == "translation" else name for name in PARAMETERS)
    return Linearised(arm, point.member.robot.tubes, point.margin, names)


def worst_of_pair(member: Unloaded, above: float) -> PlainPoint | None:
    """Equilibrium of smallest margin over all rotations of two coupled tubes made of pieces.

    Its margin does not change with the rotations to first order. None for tubes of one curvature each or more than two
    coupled ones, if the margin is not more than `above`, or if Newton's method does not converge to it.
    """
    problem, n = member.problem, len(member.rotations)
    pair = None if problem.assembly.even else pair_of(problem)
    minimum = None if pair is None else least_margin_of_pair(pair)
    # Within 1e-6 of `above` the bends oppose each other all along, and the certificate of all pairs is the margin.
    if pair is None or minimum is None or minimum.bound <= above + 1e-6:
        return None
    tips = np.zeros((1, n))
    tips[0, pair.tubes[0]] = minimum.tip
    worst = replace(member, rotations=to_base(problem, tips)[0])
    result = worst.solve(worst.unknowns(profiles(problem, tips)[0]))
    return Point(0.0, worst, result.state, minimum.margin) if result.converged else None
