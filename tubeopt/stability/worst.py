"""Worst cases by search: smallest margin over all rotations, smallest certificate over a box of translations."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..arguments import typed
from ..block.transcription.reduced import ReducedProblem, evaluate, to_unknowns
from ..block.transcription.second_variation import margin, softenings
from ..display import Displayed
from ..equilibrium.batch import forward_kinematics_batch
from ..equilibrium.kinematics import forward_kinematics, to_equilibrium
from ..equilibrium.member import Point, Unloaded
from ..equilibrium.result import Equilibrium
from ..errors import InputError, Settings, vector
from ..files.field_metadata import form, unit
from ..robots.eccentric import BundleRobot
from ..robots.robot import Robot, shifts
from ..solvers.blas import small
from ..solvers.sampling import sobol
from ..solvers.time_limit import TIME_LIMIT, check_time, limited
from ..typing import Array, Delegate, Index
from .certificate import Certificate, certify, estimated_certificate
from .eccentric_certificate import segments_of, softest_untwisted, untwisted_tips
from .pair import least_margin_of_pair, pair_of
from .shooting import profiles, to_base


@dataclass(frozen=True)
class SnapSearch(Settings):
    """Settings of the search for snaps and worst cases where no proof decides.

    For `assess_snapping`, `worst_margin` and `worst_certificate`.

    Raises:
        InputError: a field out of its range.
    """

    samples: int = 512
    """Number of sampled tip angles; the search for the smallest margin starts from the best."""
    evaluations: int = 1500
    """Maximum number of certificates in the global search over translations."""
    random_paths: int = 32
    """Number of random directions tried last."""


DEFAULT_SEARCH = SnapSearch()

# The margin of one eccentric segment depends on two relative angles only, and its softest untwisted shape, where one
# search starts, is nearly always the worst.
SEGMENT_SAMPLES = 128
"""Number of samples per segment, for tubes off the centreline."""

# The margin has few local minima per turn, mirror images of one another in pairs.
LOCAL_SEARCHES = 6
"""Number of local searches, from the best samples."""


# --- Simplices --------------------------------------------------------------------------------------------------------

# The method of Nelder and Mead from many starts in lockstep: evaluating many points at once costs little more than
# evaluating one.

Search = Generator[Array, float, tuple[Array, float]]
"""Yields points (d,), is sent their values, returns the best point and its value."""

FIRST_SIDE = 0.05
"""Sides of the first simplex, as fractions of the start's coordinates (as in SciPy)."""

FIRST_SIDE_AT_ZERO = 0.00025
"""Sides of the first simplex along coordinates that are 0 (as in SciPy)."""

MAX_ITERATIONS = 200
"""Maximum number of iterations per unknown."""


def minimise_together(
    values: Callable[[Array], Array], starts: Array, *, x: float, f: float
) -> list[tuple[Array, float]]:
    """Local minima (d,) and their values, by one simplex from each of `starts` (S, d).

    Args:
        values: objective, points (B, d) -> (B,).
        x, f: a search ends when all corners are within `x` of the best in every coordinate, and within `f` in value.
    """
    searches = dict(enumerate(_search(start, x, f) for start in starts))
    points = {k: next(search) for k, search in searches.items()}
    ends: dict[int, tuple[Array, float]] = {}
    while points:
        check_time()
        report = values(np.array(list(points.values())))
        for (k, search), value in zip([(k, searches[k]) for k in points], report, strict=True):
            try:
                points[k] = search.send(float(value))
            except StopIteration as end:
                ends[k] = end.value
                del points[k]
    return [ends[k] for k in range(len(starts))]


def _search(start: Array, x: float, f: float) -> Search:
    """Nelder-Mead search from one start, one evaluation at a time."""
    d = len(start)
    simplex = np.tile(start, (d + 1, 1))
    for i in range(d):
        simplex[i + 1, i] = start[i] * (1 + FIRST_SIDE) if start[i] else FIRST_SIDE_AT_ZERO
    value = np.empty(d + 1)
    for i in range(d + 1):
        value[i] = yield simplex[i].copy()
    for _ in range(MAX_ITERATIONS * d):
        order = np.argsort(value, kind="stable")
        simplex, value = simplex[order], value[order]
        if np.abs(simplex[1:] - simplex[0]).max() <= x and np.abs(value[1:] - value[0]).max() <= f:
            break
        middle, away = simplex[:-1].mean(0), simplex[:-1].mean(0) - simplex[-1]
        reflected = yield middle + away
        trial, trial_value = middle + away, reflected
        if reflected < value[0]:
            expanded = yield middle + 2 * away
            if expanded < reflected:
                trial, trial_value = middle + 2 * away, expanded
        elif reflected >= value[-2]:
            # Contraction to the outside or the inside of the simplex; if that fails, shrink towards the best corner.
            trial = middle + (0.5 if reflected < value[-1] else -0.5) * away
            trial_value = yield trial
            if trial_value >= value[-1] or trial_value > reflected:
                for i in range(1, d + 1):
                    simplex[i] = simplex[0] + 0.5 * (simplex[i] - simplex[0])
                    value[i] = yield simplex[i].copy()
                continue
        simplex[-1], value[-1] = trial, trial_value
    k = int(np.argmin(value))
    return simplex[k], float(value[k])


NOTHING_PROVED = -1e3
"""Finite value that replaces a certificate of -inf in the search, which computes differences."""


@dataclass(frozen=True, eq=False)
class WorstMargin(Displayed):
    """Smallest margin found over all rotations at fixed translations: an upper bound on every certificate."""

    _brief = ("margin", "equilibrium", "searches", "unstable")

    equilibrium: Equilibrium
    """Equilibrium with the smallest margin found, with its joint values."""
    searches: Annotated[int, form("d"), "local searches"]
    unstable: Array
    """(B, n) tip angles of the unstable equilibria at the ends of local searches, rad."""

    margin = Delegate[float]("equilibrium")


@typed
@small
@limited
def worst_margin(
    robot: Robot,
    translations: ArrayLike | None = None,
    *,
    effort: SnapSearch = DEFAULT_SEARCH,
    time_limit: float = TIME_LIMIT,
) -> WorstMargin:
    """Smallest margin over all rotations and all equilibria, stable or not, by search.

    Each set of tip angles, unlike joint rotations, has exactly one equilibrium (see `stability.shooting`), so the
    margin is a function of them. A Sobol sequence samples it over one turn of each relative tip angle, and the method
    of Nelder and Mead improves the best samples. For two coupled tubes made of pieces the result is the global minimum
    (see `stability.pair`). For tubes off the centreline every segment is searched alone, over one turn of the tips of
    its tubes. The others stay in their softest untwisted shape, where one local search starts. Of bundles, joint
    rotations are searched, and stable equilibria alone.

    Args:
        translations: (n,) m; default home.
        effort: settings of the search.
        time_limit: maximum run time, s.

    Raises:
        InputError: wrong number of translations, one that is not finite, a tube out of its actuator.
        SolveError: the equilibrium that was found cannot be solved again, at a fold.
        TimeLimitError: (a SolveError) the time limit was reached before there was an answer.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> tubeopt.worst_margin(robot).margin < 0
        True
    """
    n, shift = robot.n_tubes, tuple(shifts(robot, translations).tolist())
    if isinstance(robot, BundleRobot):
        return _of_bundle(robot, np.array(shift), effort)
    member = Unloaded.of(robot, np.zeros(n), shift)
    problem = member.problem
    pair = None if robot.even else pair_of(problem)
    if pair is None:
        ends = [end for base, turning in _subspaces(problem) for end in _search_tips(problem, base, turning, effort)]
    else:
        minimum = least_margin_of_pair(pair)
        ends = [(_turned(np.zeros(n), [pair.tubes[0]], np.array([[minimum.tip]]))[0], minimum.margin)]
    tips = min(ends, key=lambda end: end[1])[0][None] if ends else np.zeros((1, n))
    member = replace(member, rotations=to_base(problem, tips)[0])
    failure = "the worst equilibrium found is a fold (margin 0), which Newton cannot solve again"
    solved = Point.solved_near(member, member.unknowns(profiles(problem, tips)[0]), failure)
    equilibrium = to_equilibrium(solved, "search for the least margin")
    unstable = np.array([tips for tips, result in ends if result < 0]).reshape(-1, n)
    return WorstMargin(equilibrium, 0 if pair else len(ends), unstable)


def _of_bundle(robot: BundleRobot, translations: Array, effort: SnapSearch) -> WorstMargin:
    """Smallest margin of the stable equilibria at the ends of local searches over joint rotations."""

    def margins(rotations: Array) -> Array:
        # A whole turn of a tube changes nothing here, but a search that finds no slope goes far.
        batch = forward_kinematics_batch(robot, np.mod(rotations, 2 * np.pi), translations)
        return np.where(batch.converged, batch.margin, 1.0)

    samples = 2 * np.pi * sobol(robot.n_tubes, effort.samples)
    starts = samples[np.argsort(margins(samples))[:LOCAL_SEARCHES]]
    ends = minimise_together(margins, starts, x=1e-4, f=1e-7)
    best = min(ends, key=lambda end: end[1])[0]
    worst = forward_kinematics(robot, np.mod(best, 2 * np.pi), translations)
    return WorstMargin(worst, len(ends), np.empty((0, robot.n_tubes)))


def _subspaces(problem: ReducedProblem) -> list[tuple[Array, Index]]:
    """Subspaces of tip angles to search: tip angles (n,) to start from, and the tubes to turn."""
    assembly = problem.assembly
    zero = np.zeros(assembly.n_tubes)
    if not assembly.eccentric:
        turning = np.unique(problem.tube)[:-1]
    elif (segments := segments_of(assembly)) is not None:
        shapes, bends = map(softest_untwisted, segments), np.sign(assembly.curvature)
        return [(untwisted_tips(len(zero), shape, bends)[0], np.array(shape.segment.tubes)) for shape in shapes]
    else:
        turning = np.flatnonzero(assembly.curved.any(0))
    return [(zero, turning)] if len(turning) else []


def _search_tips(problem: ReducedProblem, base: Array, turning: Index, effort: SnapSearch) -> list[tuple[Array, float]]:
    """Tip angles (n,) and margins at the ends of local searches over the tubes `turning`, all others as in `base`."""
    eccentric = problem.assembly.eccentric
    unit = sobol(len(turning), SEGMENT_SAMPLES if eccentric else effort.samples)
    samples = _turned(base, turning, 2 * np.pi * unit)
    order = np.argsort(_margins(problem, samples))
    starts = np.stack([base, samples[order[0]]]) if eccentric else samples[order[:LOCAL_SEARCHES]]
    ends = minimise_together(
        lambda angles: _margins(problem, _turned(base, turning, angles)), starts[:, turning], x=1e-6, f=1e-10
    )
    return [(_turned(base, turning, angles[None])[0], result) for angles, result in ends]


def _turned(base: Array, turning: Index | list[int], angles: Array) -> Array:
    """(B, n) tip angles: `angles` (B, d) of the tubes `turning`, all others as in `base` (n,)."""
    tips = np.tile(base, (len(angles), 1))
    tips[:, turning] = angles
    return tips


def _margins(problem: ReducedProblem, tips: Array) -> Array:
    """(B,) margins of the equilibria at tip angles (B, n), to the error of the integration."""
    shapes = profiles(problem, tips)
    if problem.assembly.eccentric:
        return np.array([1.0 - softenings(problem, theta).max(initial=0.0) for theta in shapes])
    zero = np.zeros(problem.assembly.n_tubes)
    states = (evaluate(problem, zero, to_unknowns(problem, zero, theta)) for theta in shapes)
    return np.array([margin(problem, state) for state in states])


@dataclass(frozen=True, eq=False)
class WorstCertificate(Displayed):
    """Smallest certificate found over a box of translations."""

    certificate: Certificate
    """Certificate at the translations found."""
    lower: Annotated[Array, unit("mm"), "smallest translations"]
    """(n,) lower corner of the box, m."""
    upper: Annotated[Array, unit("mm"), "largest translations"]
    """(n,) upper corner of the box, m."""
    evaluations: Annotated[int, form("d"), "evaluations"]


@typed
@small
@limited
def worst_certificate(
    robot: Robot,
    lower: ArrayLike | None = None,
    upper: ArrayLike | None = None,
    *,
    effort: SnapSearch = DEFAULT_SEARCH,
    time_limit: float = TIME_LIMIT,
) -> WorstCertificate:
    """Smallest certificate over a box of translations, by search.

    Method: the DIRECT algorithm (Jones, Perttunen, Stuckman 1993: deterministic division of the whole box). L-BFGS-B
    then starts from its best point and from every corner, and Nelder and Mead's method from the best result, since
    mu_cert has kinks where two breakpoints meet. The certificate is continuous and piecewise smooth in the
    translations, so the result is the smallest value to the resolution of DIRECT. It is no proof for the box. For tubes
    made of pieces, the mesh error of the certificate is bounded at the result only.

    Args:
        lower, upper: (n,) m; default the translations of `robot.limits`.
        effort: settings of the search.
        time_limit: maximum run time, s.

    Raises:
        InputError: bounds of the wrong number, not finite, crossed, or beyond the actuator of a tube.
        TimeLimitError: (a SolveError) the time limit was reached before there was an answer.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> worst = tubeopt.worst_certificate(robot, [-0.03, -0.02, 0.0], [0.0, 0.0, 0.0])
        >>> worst.certificate.snap_free
        False
    """
    limits = np.array(robot.limits.translations)
    low = vector("lower", limits[:, 0] if lower is None else lower, robot.n_tubes)
    high = vector("upper", limits[:, 1] if upper is None else upper, robot.n_tubes)
    if (low > high).any():
        i = int(np.argmax(low > high))
        raise InputError(f"lower translation of tube {i + 1} is {low[i]:g} m; it must be at most upper, {high[i]:g} m")
    robot.admit(high)
    carriages = _moving(robot, low, high)
    count = 0

    def value(part: Array) -> float:
        nonlocal count
        count += 1
        try:
            return max(estimated_certificate(robot, _fill(low, carriages, part)), NOTHING_PROVED)
        except InputError:  # translations at which curved parts of segments would overlap
            return 1.0

    if not carriages:
        return WorstCertificate(certify(robot, low), low, high, 1)
    first = [group[0] for group in carriages]
    bounds = scipy.optimize.Bounds(low[first], high[first])
    result = scipy.optimize.direct(value, bounds, maxfun=effort.evaluations, locally_biased=True)
    best, smallest = result.x, float(result.fun)
    corners = np.array(np.meshgrid(*[(0.0, 1.0)] * len(first))).reshape(len(first), -1).T
    span = high[first] - low[first]
    for start in [best, *(low[first] + span * corner for corner in corners)]:
        local = scipy.optimize.minimize(value, start, method="L-BFGS-B", bounds=bounds, options={"maxiter": 50})
        if local.fun < smallest:
            best, smallest = local.x, float(local.fun)
    kink = scipy.optimize.minimize(
        value, best, method="Nelder-Mead", bounds=bounds, options={"xatol": 1e-7, "fatol": 1e-9}
    )
    best = kink.x if kink.fun < smallest else best
    return WorstCertificate(certify(robot, _fill(low, carriages, best)), low, high, count)


def _moving(robot: Robot, low: Array, high: Array) -> list[tuple[int, ...]]:
    """Carriages with different translations at the corners of a box."""
    for name, bound in (("lower", low), ("upper", high)):
        for group in robot.moving_together:
            if np.ptp(bound[list(group)]) > 1e-12:
                tubes = ", ".join(str(i + 1) for i in group)
                raise InputError(f"{name} differs between tubes {tubes}; they move together, so it must be the same")
    return [group for group in robot.moving_together if high[group[0]] - low[group[0]] > 1e-12]


def _fill(base: Array, carriages: list[tuple[int, ...]], part: Array) -> Array:
    """(n,) translations: `part` of the carriages, all others as in `base`."""
    out = base.copy()
    for group, translation in zip(carriages, part, strict=True):
        out[list(group)] = translation
    return out
