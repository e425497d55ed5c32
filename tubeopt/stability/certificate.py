"""Whether a robot can snap at all: one eigenvalue that bounds the margin for every rotation at once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from ..arguments import typed
from ..block.transcription.arm import evaluate_arm, profile
from ..block.transcription.buffered import mapped
from ..block.transcription.reduced import Evaluation, ReducedProblem, evaluate
from ..block.transcription.responsive import Responsive
from ..block.transcription.second_variation import least as least_value
from ..display import Displayed
from ..equilibrium.linearised import Linearised
from ..equilibrium.member import PlainPoint, Point, Unloaded
from ..equilibrium.problem import DEFAULT_DISCRETISATION, reduced_assembly, reduced_problem
from ..errors import InputError, positive
from ..files.field_metadata import form, unit
from ..physics.certificate import APART, OPPOSED, PARAMETERS, Pattern, largest_eigenvalue, worst_function
from ..robots.assembly import ROUND_OFF, Assembly, merge
from ..robots.lengthwise import variation
from ..robots.limits import check_force
from ..robots.robot import Robot, shifts
from ..solvers.blas import small
from ..solvers.time_limit import check_time
from ..typing import Array, StatusEnum
from .eccentric_certificate import proof, proof_gradient
from .pair import least_margin_of_pair, margins, pair_of
from .shooting import profiles, to_base

# --- Under a force at the tip -----------------------------------------------------------------------------------------

# Whether a robot can snap or buckle whatever pushes at its tip: a bound of the margin for all rotations and forces.
#
# In rotations theta and bending w = u - u0(theta) every configuration is a point of one vector space, and the second
# variation of the potential energy at any of them, in the directions y and r of the two, is (see docs/theory-loads.md)
#
#     Q = T + int y'V''y + sum_i (m.a_i / K) y_i^2 - m_w.(psi x psi') - (n.psi)(t.psi) + (n.t) |psi|^2,
#     T = int sum kt y'^2 + K |r|^2 + springs,        psi' = R (u0' y + r),  psi(0) = 0.
#
# With |n| <= F, |m_w(s)| <= M(s) = F (L - s) and A_i = |a_i| / K, for every rotation and every direction of the force,
#
#     Q >= T - N,    N = int sum_pairs |c_ij| (Y_i + Y_j)^2 + sum_i M A_i Y_i^2 + 3/2 F phi^2,
#     Y_i = |y_i|,   phi' = sum A_i Y_i + |r|,   phi(0) = 0,
#
# so that 1 less the largest eigenvalue of N relative to T bounds the margin (see `physics.certificate`).


@dataclass(frozen=True, eq=False)
class Bundle:
    """What the bounds take of an arm of n tubes in m sections, plate to tip.

    start, length (m,), m.   stiffness (m,): K, N m^2.   pull (m, n): |a_i|, N m.   torsional (n,): kt, N m^2.
    transmission (n,): length from where tubes are held to the plate, m.
    """

    start: Array
    length: Array
    stiffness: Array
    pull: Array
    torsional: Array
    transmission: Array

    @property
    def total_length(self) -> float:
        """Length of the arm, m."""
        return float(self.start[-1] + self.length[-1]) if len(self.start) else 0.0

    def softened(self, force: float, *, pairs: bool) -> float:
        """Largest eigenvalue of N relative to T for forces of at most `force`, N; without `pairs` of the part of N by
        the force alone."""
        sections, tubes = (self.length, self.stiffness, self.pull), (self.torsional, self.transmission)
        return largest_eigenvalue(force, sections, tubes, OPPOSED if pairs else APART)[0]


def bundle_of(robot: Robot, near: Array, far: Array | None = None) -> Bundle:
    """An arm of concentric tubes at translations (n,), or no stiffer than the arm at any translations between two: then
    its bounds hold for all of them.

    A tube counts as curved as it may be in a section, as stiff in bending only as it surely is, in torsion as stiff as
    where it is least; its transmission as long and the arm as long as they may be. Fields Y, phi, r of an arm between,
    with Y constant and r 0 beyond its ends, have no larger T there and no smaller N.
    """
    arms = [robot.assembly(near), robot.assembly(near if far is None else far)]
    cells, held = variation(tuple(robot.tubes)), np.stack([arm.transmission for arm in arms])
    ends = cells.cuts - held[:, :, None]
    cuts = merge(np.maximum(np.concatenate([[0.0], ends.ravel()]), 0.0))
    start, length = cuts[:-1], np.diff(cuts)
    s = (start + length / 2)[:, None, None]
    outside = np.full((robot.n_tubes, 1), np.inf)
    begin, end = np.hstack([-outside, ends.min(0)]), np.hstack([ends.max(0), outside])
    # (m, n, C + 1) cells that a section may be in; the last is behind the end of a tube, where it has no stiffness.
    maybe = (begin < s) & (s < end)
    kb, behind = cells.bending[0], np.isinf(end)
    surely = np.where(maybe, np.where(behind, 0.0, kb), np.inf).min(2)
    # Beyond the last end that is sure, some tube is there wherever there is an arm.
    least = np.where(maybe & ~behind, kb, np.inf).min((1, 2))
    return Bundle(
        start,
        length,
        np.maximum(surely.sum(1), least),
        np.where(maybe & ~behind, cells.pull[0], 0.0).max(2),
        cells.torsional.min(1),
        held.max(0),
    )


def loaded_worst_case(robot: Robot, translations: Array, unloaded: float, force: float) -> float:
    """A lower bound of the margin for all rotations and all dead tip forces of at most `force`, N, at translations
    (n,), m; `unloaded` is that without force.

    Of two bounds the larger: that of above, and the unloaded one less the eigenvalue of the parts of N by the force
    alone, since a least value of a sum is at least the sum of the least values. The second is the sharper one for weak
    forces on three or more tubes, which cannot oppose one another pairwise as N has it.
    """
    bundle = bundle_of(robot, translations)
    if not force or not bundle.total_length:
        return unloaded
    apart = unloaded - bundle.softened(force, pairs=False)
    together = 1 - bundle.softened(force, pairs=True)
    return min(unloaded, max(apart, together))


OWN_NAME = {"translation": "translations"}
"""Of a parameter of the certificate among those of an equilibrium."""

ROUNDING = 1e-9
"""A certificate is computed to some 1e-11; within this of 0 its sign proves nothing."""


class CertificateStatus(StatusEnum):
    """What a certificate says; every value reads as a sentence."""

    SNAP_FREE = "it is proved that the robot cannot snap at any rotation"
    OPEN = "it is not proved that the robot cannot snap"
    NONE = "there is no proof for this arrangement of eccentric tubes"


@dataclass(frozen=True)
class CertificateStatistics:
    """What a certificate is about."""

    tubes: int
    """Of the robot."""
    pairs: int
    """Of them that are coupled."""


@dataclass(frozen=True, eq=False)
class Certificate(Displayed):
    """Proved stability of a robot at given translations, for all rotations."""

    margin: Annotated[float, "certificate"]
    """mu_cert; above 0 no rotations can make the robot snap, and there is one equilibrium for each. -inf where nothing
    can be proved: tubes off the centreline that are not three equal ones per segment."""
    translations: Annotated[Array, unit("mm"), form(".6g"), "translations"]
    """Shape (n,)."""
    gradient: dict[str, Array]
    """Derivatives of the margin with respect to `physics.certificate.PARAMETERS`, each (n,), per SI unit. Where
    breakpoints meet they are those for a growing parameter. NaN for a double eigenvalue: the margin then has no
    derivative.
    """
    pair: tuple[int, int] | None
    """The two tubes (0 is the innermost) with the coupling that reduces the margin most. None without coupling, and for
    tubes off the centreline, where three act together.
    """
    section: tuple[float, float] | None
    """(start, end) of the section where it takes most, m."""
    share: Array
    """(n, n) part of 1 - margin that each pair takes; sums to 1 above the diagonal."""

    @property
    def value(self) -> float:
        """The margin."""
        return self.margin

    @property
    def status(self) -> CertificateStatus:
        """Whether snapping is excluded, as a sentence."""
        if np.isneginf(self.margin):
            return CertificateStatus.NONE
        return CertificateStatus.SNAP_FREE if self.snap_free else CertificateStatus.OPEN

    @property
    def statistics(self) -> CertificateStatistics:
        """Numbers of tubes and of coupled pairs."""
        return CertificateStatistics(len(self.translations), int((np.triu(self.share, 1) > 0).sum()))

    @property
    def snap_free(self) -> bool:
        """True if snapping is excluded at every rotation: the margin is above 0 beyond round-off."""
        return self.margin > ROUNDING


@typed
@small
def snap_free_certificate(robot: Robot, translations: ArrayLike | None = None, *, max_force: float = 0.0) -> float:
    """mu_cert: a lower bound on the stability margin over all rotations, at given translations.

    Above 0 the elastic energy is strictly convex at all rotations: one equilibrium, no snap anywhere. The bound is the
    margin of the worst case in which all curved tubes oppose each other. Two tubes reach it, so it is exact for them.
    Three cannot oppose each other pairwise, so it is conservative for more.

    Tubes made of pieces: exact for two coupled ones, with any curvatures, twists and stiffnesses along them (see
    `stability.pair`). For more it is a lower bound: the second variation at any rotations is at least that of the worst
    case, point by point. The possible error of the mesh for varying couplings is subtracted, estimated from a finer
    mesh.

    Tubes off the centreline, in segments of three equal ones: the fraction of torsional stiffness that all of them may
        lose (see `eccentric_certificate`). The proof for their own equations remains valid. Above 0 they cannot snap,
    but it is no bound on the margin. Other arrangements have no proof, and the number is -inf.

    `max_force` includes all dead forces on the tip of at most that size, in any direction (see `loaded_certificate`):
    above 0 the robot cannot snap or buckle under any of them. Moments, follower forces and forces along the arm are not
    covered.

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
    assembly = robot.assembly(shift)
    check_force(robot.tubes, "max_force", positive("max_force", max_force, zero=True), assembly.total_length)
    if max_force and assembly.eccentric:
        raise InputError(
            f"max_force is {max_force:g} N; it must be 0 for eccentric robots: there is no proof under force"
        )
    if assembly.eccentric:
        return proof(assembly)[0]
    unloaded = worst_case(_problem(robot, shift))[0] if assembly.even else _of_pieces(robot, shift)[0]
    return loaded_worst_case(robot, shift, unloaded, max_force) if max_force else unloaded


def convexity(robot: Robot, translations: Array) -> float:
    """Least eigenvalue of the second variation of concentric tubes, relative to its torsional part, at any rotations
    along them at all, equilibria or not: a lower bound, never more than the certificate."""
    value = worst_case(_problem(robot, translations))[0]
    return value if robot.even else value - abs(worst_case(_problem(robot, translations, 1))[0] - value)


def _of_pieces(robot: Robot, shift: Array) -> tuple[float, Array | None]:
    """The certificate of tubes made of pieces; of two coupled ones that do better than pairs at their worst also the
    (N,) cosines at the collocation points of how they oppose each other where their margin is least.

    The change with pieces of the mesh half as long is more than what these leave out of couplings that vary.
    """
    value, pair = convexity(robot, shift), pair_of(_problem(robot, shift))
    finer = None if pair is None else pair_of(_problem(robot, shift, 1))
    if pair is None or finer is None:
        return value, None
    least = least_margin_of_pair(pair)
    again = min(1.0, float(margins(finer, np.array([least.tip]))[0]))
    sharper = least.bound - abs(again - least.margin)
    return (sharper, least.opposition) if sharper > value else (value, None)


def estimated_certificate(robot: Robot, shift: Array) -> float:
    """What `snap_free_certificate` is but for what the mesh leaves out of tubes made of pieces, which takes longer to
    bound than the rest: where to look for the least, and no proof."""
    check_time()
    assembly = robot.assembly(shift)
    if assembly.eccentric:
        return proof(assembly)[0]
    problem = reduced_assembly(assembly)
    if robot.even:
        return least_value(np.eye(problem.size) + _coupled(problem)) if problem.size else 1.0
    value, pair = worst_case(problem)[0], pair_of(problem)
    return value if pair is None else max(value, least_margin_of_pair(pair).bound)


def _problem(robot: Robot, shift: Array, refinement: int = DEFAULT_DISCRETISATION.refinement) -> ReducedProblem:
    return reduced_problem(robot, tuple(shift.tolist()), replace(DEFAULT_DISCRETISATION, refinement=refinement))


def _at_worst(problem: ReducedProblem, opposition: Array | None = None) -> tuple[Array, Array]:
    """(N, n, n) V'' at the collocation points at rotations that are worst for every pair of tubes, and |c_ij|; with
    `opposition` (N,) -c_ij times that of the one pair, and the V'' that it makes."""
    count, n = problem.moment.shape
    result = mapped(worst_function(n), count)(problem.stiffness, problem.moment, np.zeros((count, n)))
    second, pull = (result[k].reshape(count, n, n).copy() for k in (0, 3))
    if opposition is None:
        return second, pull
    return second * -opposition[:, None, None], pull * -opposition[:, None, None]


def worst_case(problem: ReducedProblem, opposition: Array | None = None) -> tuple[float, Array, float]:
    """mu_cert, its eigenvector y (N, n) for which int kt y'^2 is 1, and the next eigenvalue; of `opposition` see
    `_at_worst`."""
    check_time()
    count, n = problem.moment.shape
    y = np.zeros((count, n))
    if not problem.size:
        return 1.0, y, 1.0
    values, vectors = np.linalg.eigh(_coupled(problem, opposition))
    y.ravel()[problem.flat] = problem.factor @ vectors[:, 0]
    return min(1.0, 1.0 + float(values[0])), y, 1.0 + float(values[min(1, len(values) - 1)])


def _coupled(problem: ReducedProblem, opposition: Array | None = None) -> Array:
    """(U, U) the second variation less its torsional part, which is the identity, where all curved tubes oppose each
    other; of `opposition` see `_at_worst`."""
    second = np.zeros(problem.size**2)
    pairs = problem.pairs
    second[pairs.places] = _at_worst(problem, opposition)[0].ravel()[pairs.entries] * pairs.weight
    return np.asarray(problem.factor.T @ second.reshape(problem.size, -1) @ problem.factor)


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
    if robot.assembly(shift).eccentric:
        return _of_segments(robot, shift)
    problem, opposition, proved = _problem(robot, shift), None, None
    if not robot.even:
        proved, opposition = _of_pieces(robot, shift)
    margin, y, following = worst_case(problem, opposition)
    if margin >= 1 - 1e-12:
        nothing = {name: np.zeros(n) for name in PARAMETERS}
        return Certificate(margin, shift, nothing, None, None, np.zeros((n, n)))
    work = _at_worst(problem, opposition)[1] * (y[:, :, None] - y[:, None, :]) ** 2 * problem.weight[:, None, None]
    fraction = work.sum(0) / (1 - margin)
    i, j = np.unravel_index(int(np.argmax(np.triu(fraction))), fraction.shape)
    mesh, assembly = problem.mesh, problem.assembly
    section = np.repeat(mesh.section[mesh.collocated], mesh.tableau.degree)
    each = np.bincount(section, weights=work.sum((1, 2)), minlength=assembly.n_sections)
    k = int(np.argmax(each))
    span = float(assembly.start[k]), float(assembly.start[k] + assembly.length[k])
    double = following - margin < 1e-9
    slope = np.full(n * len(PARAMETERS), np.nan) if double else _gradient(robot, problem, margin, y)
    if opposition is not None:
        slope = _gradient_of_pair(robot, shift, worst_case(problem)[0])
    gradient = dict(zip(PARAMETERS, slope.reshape(-1, n), strict=True))
    return Certificate(margin if proved is None else proved, shift, gradient, (int(i), int(j)), span, fraction)


def _of_segments(robot: Robot, shift: Array) -> Certificate:
    """The certificate of tubes off the centreline: its three tubes take alike from the margin."""
    assembly = robot.assembly(shift)
    margin, segment = proof(assembly)
    gradient = proof_gradient(robot, shift)
    fraction = np.zeros((robot.n_tubes, robot.n_tubes))
    if segment is not None:
        mine = list(segment.tubes)
        fraction[np.ix_(mine, mine)] = (1 - np.eye(3)) / 3
    return Certificate(margin, shift, gradient, None, None if segment is None else segment.section, fraction)


def breakpoint_pattern(assembly: Assembly) -> Pattern:
    """The order of breakpoints, as `physics.certificate.determinant_function` takes it. Of breakpoints that coincide
    the first tube's is taken."""
    ends = []
    for stop in assembly.start + assembly.length:
        near = np.abs(np.stack([assembly.transition, assembly.end], axis=1).ravel() - stop) <= 2 * ROUND_OFF
        ends.append(int(np.argmax(near)))
    present, curved = (tuple(map(tuple, mask.astype(int).tolist())) for mask in (assembly.present, assembly.curved))
    return tuple(ends), present, curved


def _gradient(robot: Robot, problem: ReducedProblem, margin: float, y: Array) -> Array:
    """(Q,) by PARAMETERS of the eigenvalue with the eigenvector y (N, n), which rotations do not change: of tubes
    without torsion."""
    still = np.zeros(robot.n_tubes)
    return _changes(robot, problem, still, evaluate(problem, still, np.zeros(problem.size)), 1.0).certificate(margin, y)


def _gradient_of_pair(robot: Robot, shift: Array, above: float) -> Array:
    """(Q,) by PARAMETERS of the least margin of two coupled tubes, which is more than `above`; NaN without one."""
    point = worst_of_pair(Unloaded.of(robot, np.zeros(robot.n_tubes), tuple(shift.tolist())), above)
    if point is None:
        return np.full(robot.n_tubes * len(PARAMETERS), np.nan)
    return _changes(robot, point.member.problem, point.member.rotations, point.state, point.margin).one_margin


def _changes(robot: Robot, problem: ReducedProblem, rotations: Array, state: Evaluation, margin: float) -> Linearised:
    """Derivatives by PARAMETERS at a solved state."""
    arm = evaluate_arm(problem, rotations, state, profile(problem, rotations, state))
    here = Responsive(problem, rotations, state.theta, arm)
    return Linearised(here, robot.tubes, margin, tuple(OWN_NAME.get(name, name) for name in PARAMETERS))


def worst_of_pair(member: Unloaded, above: float) -> PlainPoint | None:
    """The equilibrium of least margin at any rotations of the two tubes of a problem that are coupled, at which the
    margin does not change with the rotations. None where tubes are even, more than two are coupled, that margin is not
    more than `above`, or Newton's method does not stay there."""
    problem, n = member.problem, len(member.rotations)
    pair = None if problem.assembly.even else pair_of(problem)
    least = None if pair is None else least_margin_of_pair(pair)
    if pair is None or least is None or least.bound <= above + 1e-6:  # else they are the same
        return None
    tips = np.zeros((1, n))
    tips[0, pair.tubes[0]] = least.tip
    there = replace(member, rotations=to_base(problem, tips)[0])
    result = there.solve(there.unknowns(profiles(problem, tips)[0]))
    return Point(0.0, there, result.state, least.margin) if result.converged else None
