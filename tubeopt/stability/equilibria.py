"""Every equilibrium at given joint values, stable and unstable.

Without a load, tubes are searched group by group over their tip angles. Under a load the search starts from many arms.
In both cases the topological degree of the set must be 1.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from ..arguments import typed
from ..block.transcription.mesh import reach
from ..block.transcription.reduced import ReducedProblem
from ..equilibrium.answer import sample_rotation, to_equilibrium
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.member import Loaded, LoadedPoint, Member, Place, PlainPoint, Point, Unloaded
from ..equilibrium.problem import check_load
from ..equilibrium.result import Equilibrium
from ..errors import Settings, SolveError
from ..robots.assembly import Assembly
from ..robots.load import Load
from ..robots.robot import Robot, joint_values
from ..solvers.blas import small
from ..solvers.sampling import sobol
from ..solvers.time_limit import TIME_LIMIT, limited
from ..typing import Array, Index
from .certificate import snap_free_certificate, worst_case
from .folds import NUDGE, slide
from .shooting import STEPS, Bundle, gain_of, profiles, sections_of, shoot


@dataclass(frozen=True)
class EquilibriaSearch(Settings):
    """Settings of the search for all equilibria at given joint values, for `find_equilibria`.

    Raises:
        InputError: a field out of its range.
    """

    most_starts: int = 16384
    """Number of starts in the last round, for groups of more than three tubes that act on one another."""
    most_loaded_starts: int = 512
    """Number of starts in the last round under load."""


DEFAULT_EQUILIBRIA_SEARCH = EquilibriaSearch()

# The certificate is a sum of products of round-off 1e-9 at most; a certificate below this may be one of 0.
CERTAIN = 1e-6
"""Certificate above which there is one equilibrium and nothing is searched."""

# Their couplings vary between the points of the mesh, where the certificate samples them.
CERTAIN_OF_PIECES = 1e-3
"""The same for tubes made of pieces."""

SAME = 1e-5
"""Largest difference (rad) of all rotations between equal equilibria: Newton's method ends with 1e-12."""


# --- Groups of tubes that act on one another --------------------------------------------------------------------------

# Two tubes act on each other where both are curved. A tube that is straight in a section only shares the stiffness of
# the section, and its torque t is constant there: on the centreline it does not notice the others at all. Off the
# centreline they change its length, theta' = g t / kt, and so the transmission to its own curved part,
#
#     alpha_i = theta_i - t_i (|beta_i| + int g_i ds) / kt_i,
#
# with the integral over everything between the plate and where its group begins. A tube is curved to its end, so that
# a group lies beyond all those that it passes through: the equations are block triangular, from the base to the tip.


@dataclass(frozen=True, eq=False)
class Group:
    """Tubes that act on one another, and what is integrated to shoot them.

    Attributes:
        tubes: (k,) which of the n tubes.
        bundle: these, and behind them a straight tube for each place that has none of them. Each place has the
            stiffness of all tubes there. The transmissions are those of the robot on the centreline.
        seat: (n,) tube of the bundle at whose place each tube of the robot lies.
    """

    tubes: Index
    bundle: Bundle
    seat: Index


@lru_cache(maxsize=32)
def groups_of(problem: ReducedProblem) -> list[Group]:
    """Groups of tubes, base to tip.

    On the centreline a single tube is none: its torsion is 0. Off it a single curved one still bends the others.
    """
    assembly = problem.assembly
    curved = assembly.curved
    together = (curved[:, :, None] & curved[:, None, :]).any(0)
    label = scipy.sparse.csgraph.connected_components(together, directed=False)[1]
    groups = [np.flatnonzero(label == k) for k in range(label.max(initial=-1) + 1)]
    least = 1 if assembly.eccentric else 2
    sections = [np.flatnonzero(curved[:, tubes].any(1)) for tubes in groups]
    order = sorted((where[0], k) for k, where in enumerate(sections) if len(where) and len(groups[k]) >= least)
    return [_group(problem, groups[k], sections[k]) for _, k in order]


def _group(problem: ReducedProblem, tubes: Index, sections: Index) -> Group:
    assembly, mesh = problem.assembly, problem.mesh
    place = _places(assembly)
    others = [int(np.argmax(place == p)) for p in np.setdiff1d(place, place[tubes])]
    members = np.concatenate([tubes, np.array(others, dtype=np.intp)])
    seat = np.array([int(np.argmax(place[members] == p)) for p in place])
    # Between two curved pieces of a tube a straight one only hands on the torque, but that it does.
    pieces = np.flatnonzero((mesh.section >= sections[0]) & (mesh.section <= sections[-1]))
    every = [part[pieces] for part in sections_of(problem)]
    torsion, stiffness, moment, *phase = (part[..., members] for part in every)
    stiffness[..., len(tubes) :] = moment[..., len(tubes) :] = 0.0
    for i in np.setdiff1d(np.arange(assembly.n_tubes), tubes):
        stiffness[..., seat[i]] += every[1][..., i]
    bundle = Bundle(
        length=mesh.length[pieces],
        bent=mesh.collocated[pieces],
        gain=gain_of(problem)[np.ix_(pieces, members)],
        sections=(torsion, stiffness, moment, *phase),
        transmission=reach(mesh, problem.here)[pieces[0], members],
        place=tuple(part[members] for part in assembly.place),
    )
    return Group(tubes, bundle, seat)


def _places(assembly: Assembly) -> Index:
    """(n,) number of the place beside the centreline at which each tube lies."""
    spot = assembly.offset * np.exp(1j * assembly.offset_angle)
    rounded = np.round(np.stack([spot.real, spot.imag], axis=1), 12)
    return np.asarray(np.unique(rounded + 0.0, axis=0, return_inverse=True)[1]).ravel()


# --- Tip angles of a group that lead to given joint rotations ---------------------------------------------------------

# Newton's method starts wherever a table of the map from tips to joints says a solution may lie. The table is read on
# ever finer grids until the set no longer changes and its topological degree, the sum of the signs of
# det(d alpha / d theta_tip), is 1, as it must be: alpha - theta_tip is bounded, so that the map deforms into the
# identity. For more than three tubes there is no table, and the starts are a Sobol sequence.
#
# There is one table for all joint rotations and transmissions. What the torsion adds on the path from the tips to the
# base, theta(0) - theta_tip and t(0), is a periodic, analytic function of the tip angles: its Fourier series converges
# geometrically, so that a grid fine enough for the series to end stands for every finer one. On the centreline it is a
# function of the angles relative to the last tube's; off it the common angle is one more, in which the function is
# smooth, so that few points are enough.

TURN = 2 * np.pi

RELATIVE, COMMON = 32, 6
"""Points per turn of the coarsest table: in the angles relative to the last tube's, and in its own."""

MOST_POINTS = 250_000
"""Points beyond which a table is not refined."""

TAIL = 0.05
"""Sum of the Fourier amplitudes (rad) beyond two thirds of those that a table has. They decay geometrically: what the
table lacks is about its power 3/2."""

DOUBT = 2e-3
"""What a table may be off, in turns of a joint."""

TABLE_STEPS = 2
"""Integration steps per piece for a table, and on the path to a solution: errors near 1e-4 rad."""

# A cell may hold a solution where the function passes a whole number of turns between its corners. With few cells the
# bound of what it bends in between is large, so that finer grids solve less often from more cells. A third grid is
# needed near folds only, where the set still changes from the first to the second.
GRIDS = ((1024, 4096, 16384), (160, 320, 640), (80, 120, 180))
"""Points per turn of the successive grids for one, two and three relative tip angles."""

FIRST_STARTS = 1024
"""Points of the Sobol sequence in the first round where there is no table; every round has twice those before."""

HANDED_OVER = 1e-3
"""Error of the joints (rad) to which the rough integration solves: ten times its own error."""

CLOSE = 1e-2
"""Residual (rad) of the best point that is accepted where Newton's method does not converge, as close to a fold."""

SOLVED = 1e-8
"""Error of the joints (rad) at which the fine integration has solved; its own error is 1e-6 rad."""

# Next to a fold the Jacobian is nearly singular: a free step may lead anywhere.
LONGEST_TIP_STEP = 0.5
"""Largest change (rad) of a tip angle in one step."""

SAME_TIPS = 1e-4
"""Difference (rad) below which tip angles on the same side of a fold are equal."""


@dataclass(frozen=True, eq=False)
class Table:
    """theta(0) - theta_tip and torque at 0 of k tubes, each (*size, k), over a turn of each angle of a grid: k - 1
    angles relative to the last tube's, and off the centreline the last tube's."""

    size: tuple[int, ...]
    turned: Array
    torque: Array


@lru_cache(maxsize=16)
def table_of(bundle: Bundle, k: int) -> Table:
    """The table of the first k tubes of a bundle, refined until its Fourier series ends."""
    size = (RELATIVE,) * (k - 1) + ((COMMON,) if bundle.place else ())
    while True:
        table = _tabulate(bundle, k, size)
        tails = _tails(table.turned - bundle.transmission[:k] * table.torque)
        finer = tuple(2 * n if tail > TAIL else n for n, tail in zip(size, tails, strict=True))
        if finer == size or np.prod(finer) > MOST_POINTS:
            return table
        size = finer


def _tabulate(bundle: Bundle, k: int, size: tuple[int, ...]) -> Table:
    tips = _tips(np.stack(np.meshgrid(*[np.arange(n) * TURN / n for n in size], indexing="ij"), axis=-1), k)
    shot = shoot(bundle, tips.reshape(-1, k), steps=TABLE_STEPS)
    turned = shot.rotations + bundle.transmission[:k] * shot.torque - tips.reshape(-1, k)
    return Table(size, turned.reshape(*size, k), shot.torque.reshape(*size, k))


def _tips(angles: Array, k: int) -> Array:
    """Tip angles (..., k) of the angles (..., d) of a table."""
    tips = np.zeros((*angles.shape[:-1], k))
    tips[..., :-1] = angles[..., : k - 1]
    return tips + angles[..., k - 1 :] if angles.shape[-1] == k else tips


def _tails(values: Array) -> list[float]:
    """Sum of the Fourier amplitudes of the highest frequencies along each axis but the last, at worst."""
    dimension = values.ndim - 1
    axes = tuple(range(dimension))
    amplitude = np.abs(np.fft.fftn(values, axes=axes)) / np.prod(values.shape[:-1])
    out = []
    for axis in axes:
        n = values.shape[axis]
        high = np.abs(np.fft.fftfreq(n, 1 / n)) > n / 3
        out.append(float(np.compress(high, amplitude, axis=axis).sum(axes).max()))
    return out


def starts(table: Table, transmission: Array, target: Array, size: int) -> Array:
    """Tip angles (B, k) in the middle of every cell of a grid that may lead to the wanted joints (k,).

    It has at least `size` points per turn of the relative angles.
    """
    k, dimension = len(target), len(table.size)
    values = table.turned - transmission * table.torque
    sizes = tuple(max(2 * n, size if axis < k - 1 else 0) for axis, n in enumerate(table.size))
    for axis, n in enumerate(sizes):
        values = _resampled(values, n, axis)
    angles = np.stack(np.meshgrid(*[np.arange(n) * TURN / n for n in sizes], indexing="ij"), axis=-1)
    gap = _tips(angles, k) + values - target
    # Relative to the last tube, then that itself where it counts: continuous along the grid, in turns.
    parts = [(gap[..., i] - gap[..., -1]) / TURN for i in range(k - 1)] + [gap[..., -1] / TURN] * (dimension == k)
    hit = np.logical_and.reduce([_may_be_whole(part, axis) for axis, part in enumerate(parts)])
    chosen = angles[hit] + TURN / 2 / np.array(sizes)
    tips = _tips(chosen, k)
    return tips if dimension == k else tips + target[-1]


def _resampled(values: Array, size: int, axis: int) -> Array:
    """Values on a finer grid of a period along an axis, by their Fourier series: as `scipy.signal.resample`, but
    without its package, whose import takes longer than all that is asked of a table."""
    spectrum, old = np.moveaxis(np.fft.rfft(values, axis=axis), axis, 0), values.shape[axis]
    if old % 2 == 0:
        spectrum[old // 2] /= 2  # the highest frequency stands for both of its signs
    return np.asarray(np.fft.irfft(np.moveaxis(spectrum, 0, axis), size, axis=axis) * (size / old))


def _may_be_whole(values: Array, own: int) -> NDArray[np.bool_]:
    """Cells of a grid in which a function (in turns), which grows by one along its `own` axis, may be a whole number.

    Inside a cell it stays between its corners but for what it bends: by twice what its second differences tell.
    """
    low = high = values
    bend = np.zeros_like(values)
    for axis in range(values.ndim):
        ahead = [_next(part, axis, axis == own) for part in (low, high)]
        low, high = np.minimum(low, ahead[0]), np.maximum(high, ahead[1])
        step = _next(values, axis, axis == own) - values
        second = np.abs(step - np.roll(step, 1, axis=axis))
        bend += np.maximum(second, np.roll(second, -1, axis=axis)) / 4
    # Of the corners, that with most bend.
    for axis in range(values.ndim):
        bend = np.maximum(bend, np.roll(bend, -1, axis=axis))
    slack = bend + DOUBT
    return np.asarray(np.floor(high + slack) >= np.ceil(low - slack))


def _next(values: Array, axis: int, own: bool) -> Array:
    """Values one point on along an axis, continued past a turn."""
    out = np.roll(values, -1, axis=axis)
    if own:
        out[(slice(None),) * axis + (-1,)] += 1.0
    return out


@dataclass(frozen=True, eq=False)
class Preimage:
    """Tip angles (S, k) that lead to given joints, the signs (S,) of det(d alpha / d theta_tip) there, and the length
    (S, m) of every tube of the bundle, m; `settled`: whether the search ended because nothing was missing."""

    tips: Array
    sign: Array
    travel: Array
    settled: bool


def preimage(
    bundle: Bundle, transmission: Array, rotations: Array, most_starts: int = DEFAULT_EQUILIBRIA_SEARCH.most_starts
) -> Preimage:
    """Tip angles that lead to joint rotations (k,) of the first k tubes of a bundle, the others being straight, if its
    transmissions were (n,) `transmission`, 1/(N m)."""
    part = replace(bundle, transmission=transmission)
    result = _finish(part, rotations, rotations[None] if len(rotations) == 1 else np.zeros((0, len(rotations))))
    if len(rotations) == 1:
        # Nothing turns a single tube.
        return result
    for near in _tip_starts(bundle, transmission, rotations, most_starts):
        before = len(result.tips)
        result = _finish(part, rotations, np.concatenate([result.tips, _approach(part, rotations, near)]))
        if len(result.tips) == before and result.sign.sum() == 1:
            return result
    return replace(result, settled=False)


def _tip_starts(bundle: Bundle, transmission: Array, target: Array, most: int) -> Iterator[Array]:
    """Tip angles (B, k) from which to solve, from ever finer grids."""
    k = len(target)
    if k <= 3:
        table = table_of(bundle, k)
        for size in GRIDS[len(table.size) - 1]:
            yield starts(table, transmission[:k], target, size)
        return
    # Twice as many each time, for as long as a new solution or the degree says that some are missing.
    count = FIRST_STARTS
    while count <= most:
        tips = np.pad(sobol(k - 1, count, count.bit_length() - 1) * TURN, ((0, 0), (0, 1)))
        reached = shoot(replace(bundle, transmission=transmission), tips, steps=TABLE_STEPS).rotations
        yield tips + (target - reached)[:, -1:]
        count *= 2


def _newton(
    bundle: Bundle, target: Array, tips: Array, steps: int, iterations: int, enough: float
) -> tuple[Array, Array]:
    """Tip angles (B, k) of Newton's method where they left the least gap, and this gap (B,).

    Args:
        steps: of the integration per piece.   iterations: maximum number.   enough: gap that ends them, rad.
    """
    best, least = tips.copy(), np.full(len(tips), np.inf)
    going, here = np.arange(len(tips)), tips
    for _ in range(iterations):
        if not len(going):
            break
        shot = shoot(bundle, here, steps=steps, slopes=True)
        gap = shot.rotations - target
        gap -= TURN * np.round(gap / TURN)
        size = np.abs(gap).max(1)
        better = size < least[going]
        best[going[better]], least[going[better]] = here[better], size[better]
        left = size > enough
        going, here, gap, slope = going[left], here[left], gap[left], shot.by_tip[left]
        step = np.linalg.solve(slope + 1e-12 * np.eye(tips.shape[1]), -gap[:, :, None])[:, :, 0]
        change = np.abs(step).max(1, initial=0.0)
        here = here + step * np.minimum(1.0, LONGEST_TIP_STEP / np.maximum(change, 1e-12))[:, None]
    return best, least


def _approach(bundle: Bundle, target: Array, starts: Array) -> Array:
    """Starts that got close, by rough integration, without doubles."""
    tips = starts
    # Most starts have met after a few steps.
    for iterations in (3, 10):
        tips, gap = _newton(bundle, target, tips, TABLE_STEPS, iterations, HANDED_OVER)
        tips = tips % TURN
        first = np.unique(np.round(tips / CLOSE), axis=0, return_index=True)[1]
        tips, gap = tips[first], gap[first]
    return np.asarray(tips[gap < CLOSE])


def _finish(bundle: Bundle, target: Array, starts: Array) -> Preimage:
    """Tip angles that starts lead to, unwound so that their joints are the wanted ones without whole turns."""
    tips, gap = _newton(bundle, target, starts, STEPS, 12, SOLVED)
    tips = tips[gap < SOLVED]
    if not len(tips):
        return Preimage(tips, np.zeros(0), np.zeros((0, bundle.n_tubes)), True)
    shot = shoot(bundle, tips, slopes=True)
    tips = tips - TURN * np.round((shot.rotations - target) / TURN)
    sign = np.sign(np.linalg.det(shot.by_tip))
    kept: list[int] = []
    for i in range(len(tips)):
        near = np.abs(tips[kept] - tips[i]).max(1, initial=0.0) < SAME_TIPS
        if not (near & (sign[kept] == sign[i])).any():
            kept.append(i)
    return Preimage(tips[kept], sign[kept], shot.travel[kept], True)


# --- Under a load -----------------------------------------------------------------------------------------------------

# The equations are x - f(x) = 0 in whitened rotations and bending. What tubes and load make of them, f, is bounded: by
# moments of precurvature, forces times the length of the arm, and moments, whether there is an energy or not. So no
# equilibrium of x - s f(x), 0 <= s <= 1, is farther away than the bound, and the degree is that of x, 1: the signs of
# the determinants add up to 1 over all equilibria. Where there is an energy, they are (-1)^index.

LOADED_STARTS = 128
"""Starting points in the first round; every round has twice those of the one before."""

# Tubes of a stable arm twist by less than a turn; what moments add to that comes to it.
LARGEST_TWIST = 2 * np.pi
"""Largest twist (rad) of a tube at the tip that the starts cover."""


def loaded_equilibria(
    robot: Robot,
    rotations: Array,
    translations: tuple[float, ...],
    load: Load,
    plain: list[Equilibrium],
    search: EquilibriaSearch = DEFAULT_EQUILIBRIA_SEARCH,
) -> list[Equilibrium]:
    """All equilibria under a load, lowest potential energy first, without an energy largest margin first; `plain` are
    those without load.

    Newton's method starts at every equilibrium without load and at twisted and bent arms from a Sobol sequence, twice
    as many in every round. From every unstable equilibrium that was found the robot falls. The search ends where a
    round finds nothing new and the degree is 1; where there is an energy, one of them is stable, too.
    """
    check_load(robot, load, translations)
    member = Loaded.of(robot, rotations, translations, load)
    bounded, force = load.tip_force_only, float(np.linalg.norm(load.force))
    if bounded and snap_free_certificate(robot, translations, max_force=force) > CERTAIN:
        return [forward_kinematics(robot, rotations, translations, load=load)]
    result: list[LoadedPoint] = []
    explored: set[int] = set()
    for equilibrium in plain:
        theta = sample_rotation(equilibrium, member.problem.torsion.arc_length)
        add(result, member, member.unknowns(theta))
    sequence, count = scipy.stats.qmc.Sobol(robot.n_tubes + 4, seed=0), LOADED_STARTS
    while count <= search.most_loaded_starts:
        starts = _starts(member, sequence.random(count))
        new = sum(add(result, member, x) for x in starts)
        new += _descend(result, member, explored)
        # Where there is a least energy, a set without a stable equilibrium is not all.
        if not new and degree(result) == 1 and (not member.descends or any(point.margin > 0 for point in result)):
            points = sorted(result, key=lambda point: point.state.potential if member.descends else -point.margin)
            return [to_equilibrium(point, "search from many starts") for point in points]
        count *= 2
    raise SolveError(
        f"{len(result)} equilibria were found with degree {degree(result)} instead of 1: one "
        "is missing, or joint values and load are at a fold"
    )


def _starts(member: Loaded, samples: Array) -> list[Array]:
    """Unknowns of arms whose tubes are twisted and which are bent linearly in arc length."""
    problem, n, load = member.problem, len(member.rotations), member.problem.load
    torsion = problem.torsion
    length = torsion.assembly.total_length
    s = torsion.arc_length[:, None] / length
    stiffness = torsion.stiffness.sum(1)
    push = np.linalg.norm(problem.force, axis=1) + np.linalg.norm(load.force) * (load.frame == "tip")
    couple = 0.0 if problem.couples is None else np.linalg.norm(problem.couples.moment, axis=1).sum()
    most = np.minimum(2 * np.sqrt(push / stiffness), push * length / stiffness)[:, None]
    most += (couple / stiffness)[:, None]
    twist = LARGEST_TWIST + couple * problem.tip_lever
    starts = []
    for sample in 2 * samples - 1:
        x = member.unknowns(member.rotations + twist * sample[:n] * s)
        bent = 2 * most * (sample[n : n + 2] * (1 - s) + sample[n + 2 :] * s)
        x[torsion.size :] = (bent / problem.softness[:, None]).ravel()
        starts.append(x)
    return starts


def add(equilibria: list[Any], member: Member[Any], x: Array) -> bool:
    """Solve from x; whether that is an equilibrium which was not known."""
    result = member.solve(x, iterations=30)
    if not result.converged:
        return False
    if any(member.turn(result.state, result.state.x - known.state.x) < SAME for known in equilibria):
        return False
    equilibria.append(Point.of(member, result, 1.0))
    return True


def _descend(result: list[LoadedPoint], member: Loaded, explored: set[int]) -> int:
    """Fall from unstable equilibria to both sides of their unstable directions; how many new ones that finds. Where one
    goes that flutters is not known."""
    new = 0
    for k, point in enumerate(list(result)):
        if k in explored or point.margin >= 0:
            continue
        explored.add(k)
        values, vectors = (np.linalg.eigh if member.descends else np.linalg.eig)(point.state.hessian)
        for direction in vectors.real.T[(values.real < 0) & (values.imag == 0)]:
            push = NUDGE / member.turn(point.state, direction) * direction
            for side in (push, -push):
                landed = slide(member, point.state.x + side)
                new += landed.converged and add(result, member, landed.state.x)
    return new


def degree(result: Iterable[Place]) -> int:
    """Topological degree, the sum of the signs of the Jacobians' determinants, (-1)^index where there is an energy.

    It is 1 for a complete set, since the equations deform into those without coupling.
    """
    return int(sum(np.linalg.slogdet(each.state.hessian)[0] for each in result))


# --- The question -----------------------------------------------------------------------------------------------------


@typed
@small
@limited
def find_equilibria(
    robot: Robot,
    rotations: ArrayLike,
    translations: ArrayLike | None = None,
    *,
    load: Load | None = None,
    search: EquilibriaSearch = DEFAULT_EQUILIBRIA_SEARCH,
    time_limit: float = TIME_LIMIT,
) -> list[Equilibrium]:
    """All equilibria at given joint values, the lowest energy first.

    A positive certificate of tubes on the centreline proves that there is only one; then nothing is searched. Otherwise
    tubes that act on one another are searched group by group (groups: tubes that are curved in a common section).

    Groups of up to three tubes, as in every segment of an eccentric robot, are searched systematically. The joint
    rotations are tabulated over one turn of each tip angle. Every cell of the grid that may contain a solution is
    solved. The grid is refined until the set no longer changes and its topological degree is 1, as theory demands. On
    the centreline the degree is the sum of (-1)^index. Larger groups start from a Sobol sequence, and the degree is the
    only check.

    Args:
        rotations, translations: (n,) rad and m; translations default to home. Rotations are not wrapped.
        load: external load. The equilibria are then found from many starting points, with the degree as the only check.
            They are ordered by potential energy; without one, the largest margin comes first.
        search: settings of the search.
        time_limit: maximum run time, s.

    Raises:
        InputError: wrong number of joint values, one that is not finite, a tube out of its actuator; a load on an
            eccentric robot.
        SolveError: the degree of the set is not 1: an equilibrium is missing, or the joint values are a fold.
        TimeLimitError: (a SolveError) the time limit was reached before there was an answer.

    Examples:
        >>> import numpy as np
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/two_tube.yaml")
        >>> [e.stable for e in tubeopt.find_equilibria(robot, np.radians([190, 0]))]
        [True, True, False]
    """
    alpha, place = joint_values(robot, rotations, translations)
    shift = tuple(place.tolist())
    result = _without_load(Unloaded.of(robot, alpha, shift), search.most_starts)
    equilibria = [to_equilibrium(point, "search over tip angles") for point in result]
    if load is not None:
        return loaded_equilibria(robot, alpha, shift, load, equilibria, search)
    return sorted(equilibria, key=lambda e: e.energy)


def _without_load(member: Unloaded, most_starts: int) -> list[PlainPoint]:
    """All solutions of a problem; raises SolveError where their degree is not 1."""
    problem, rotations = member.problem, member.rotations
    surely = CERTAIN if problem.assembly.even else CERTAIN_OF_PIECES
    if not problem.assembly.eccentric and worst_case(problem)[0] > surely:
        result = member.descend(np.zeros(problem.size))
        if result.converged:
            return [Point.of(member, result)]
    solution = list[PlainPoint]()
    for theta in profiles(problem, _all_tips(problem, rotations, most_starts)):
        add(solution, member, member.unknowns(theta))
    whole = degree(solution)
    if whole != 1:
        raise SolveError(_incomplete(len(solution), whole))
    return solution


def _all_tips(problem: ReducedProblem, rotations: Array, most_starts: int) -> Array:
    """(S, n) tip angles that lead to the joint rotations: of one group after the other, from the base to the tip.

    Off the centreline every solution of the groups below gives its own transmissions to those that pass through them.
    """
    # The tip of a tube that nothing turns is where its joint is.
    branches = [(rotations.copy(), np.zeros(problem.assembly.n_tubes))]
    for group in groups_of(problem):
        bundle, known, longer = group.bundle, {}, []
        for tips, extra in branches:
            key = extra.tobytes()
            if key not in known:
                held = bundle.transmission.copy()
                # Straight tubes that only keep a place have no torsion to transmit.
                held[: len(group.tubes)] += (extra / problem.assembly.held_stiffness)[group.tubes]
                known[key] = preimage(bundle, held, rotations[group.tubes], most_starts)
            result = known[key]
            if not result.settled:
                raise SolveError(_incomplete(len(result.tips), int(result.sign.sum())))
            for angles, travel in zip(result.tips, result.travel, strict=True):
                turned = tips.copy()
                turned[group.tubes] = angles
                more = travel[group.seat] - bundle.length.sum() if bundle.place else 0.0
                longer.append((turned, extra + more))
        branches = longer
    return np.array([tips for tips, _ in branches])


def _incomplete(count: int, degree: int) -> str:
    why = f"of degree {degree} instead of 1" if degree != 1 else "more of them on every finer grid"
    return f"{count} equilibria were found, {why}: one is missing, or the joint values are at a fold, where two are one"
