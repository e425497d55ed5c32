"""All equilibria at given joint values, stable and unstable.

Without a load the map from tip angles to joint rotations is inverted, one group of interacting tubes after the other.
Under a load Newton's method starts from many arms. In both cases the topological degree of the set must be 1.
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
from ..block.transcription.bundle import Bundle, Start, natural_start
from ..block.transcription.mesh import reach
from ..block.transcription.reduced import ReducedProblem
from ..block.transcription.second_variation import least
from ..equilibrium.bundle import Bundled
from ..equilibrium.kinematics import forward_kinematics, point_of, to_equilibrium
from ..equilibrium.member import AnyPoint, Loaded, LoadedPoint, Member, PlainPoint, Point, Unloaded, sample_rotation
from ..equilibrium.problem import check_load
from ..equilibrium.result import Equilibrium
from ..errors import Settings, SolveError
from ..robots.eccentric import BundleRobot
from ..robots.load import Load
from ..robots.robot import Robot, joint_values
from ..solvers.blas import small
from ..solvers.sampling import sobol
from ..solvers.time_limit import TIME_LIMIT, limited
from ..typing import Array, Index
from .branch import ridges_beside
from .certificate import snap_free_certificate, worst_case
from .folds import NUDGE, slide
from .shooting import STEPS_PER_ELEMENT, ShootingArm, gain_of, profiles, sections_of, shoot


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

# The round-off of a certificate is at most 1e-9: below 1e-6 the true one may be 0.
CERTAIN = 1e-6
"""Certificate above which there is one equilibrium and nothing is searched."""

# The certificate samples their couplings at the points of the mesh.
CERTAIN_OF_PIECES = 1e-3
"""Certificate above which tubes made of pieces have one equilibrium."""

SAME = 1e-5
"""Largest difference (rad) of all rotations between equal equilibria: Newton's method ends with 1e-12."""


# --- Groups of tubes that act on one another --------------------------------------------------------------------------

# Two tubes act on each other where both are curved. A tube that is straight in a section only adds its stiffness to
# the section, and its torque t is constant there: on the centreline the others have no effect on it. Off the centreline
# they change its length, theta' = g t / kt, and so the transmission to its own curved part,
#
#     alpha_i = theta_i - t_i (|beta_i| + int g_i ds) / kt_i,
#
# with the integral from the plate to the start of its group. A tube is curved up to its end, so that a group lies
# beyond all those that it passes through: the equations are block triangular, from the base to the tip.


@dataclass(frozen=True, eq=False)
class Group:
    """Tubes that affect one another, with their integration from the tips to the plate."""

    tubes: Index
    """(k,) numbers of the tubes among the n of the robot."""
    bundle: ShootingArm
    """Tubes of the group first, then a straight tube at each offset without one.

    Each offset has the stiffness of all tubes there. Transmissions are those on the centreline.
    """
    seat: Index
    """(n,) tube of the bundle at the offset of each tube of the robot."""


@lru_cache(maxsize=32)
def groups_of(problem: ReducedProblem) -> list[Group]:
    """Groups of tubes, base to tip.

    A single concentric tube is no group: its torsion is 0. A single curved eccentric tube is one, since it bends the
    others.
    """
    assembly = problem.assembly
    curved = assembly.curved
    together = (curved[:, :, None] & curved[:, None, :]).any(0)
    label = scipy.sparse.csgraph.connected_components(together, directed=False)[1]
    groups = [np.flatnonzero(label == k) for k in range(label.max(initial=-1) + 1)]
    min_tubes = 1 if assembly.eccentric else 2
    sections = [np.flatnonzero(curved[:, tubes].any(1)) for tubes in groups]
    order = sorted((ks[0], k) for k, ks in enumerate(sections) if len(ks) and len(groups[k]) >= min_tubes)
    return [_group(problem, groups[k], sections[k]) for _, k in order]


def _group(problem: ReducedProblem, tubes: Index, sections: Index) -> Group:
    """Group of `tubes` that are curved in `sections`."""
    assembly, mesh = problem.assembly, problem.mesh
    position = assembly.offset * np.exp(1j * assembly.offset_angle)
    rounded = np.round(np.stack([position.real, position.imag], axis=1), 12)
    offset = np.asarray(np.unique(rounded + 0.0, axis=0, return_inverse=True)[1]).ravel()
    fillers = [int(np.argmax(offset == k)) for k in np.setdiff1d(offset, offset[tubes])]
    members = np.concatenate([tubes, np.array(fillers, dtype=np.intp)])
    seat = np.array([int(np.argmax(offset[members] == k)) for k in offset])
    # From the first to the last curved section: a straight piece between them transmits the torque.
    pieces = np.flatnonzero((mesh.section >= sections[0]) & (mesh.section <= sections[-1]))
    all_tubes = [part[pieces] for part in sections_of(problem)]
    torsion, stiffness, moment, *phase = (part[..., members] for part in all_tubes)
    stiffness[..., len(tubes) :] = moment[..., len(tubes) :] = 0.0
    for i in np.setdiff1d(np.arange(assembly.n_tubes), tubes):
        stiffness[..., seat[i]] += all_tubes[1][..., i]
    bundle = ShootingArm(
        length=mesh.length[pieces],
        bent=mesh.collocated[pieces],
        gain=gain_of(problem)[np.ix_(pieces, members)],
        sections=(torsion, stiffness, moment, *phase),
        transmission=reach(mesh, problem.compliant)[pieces[0], members],
        offsets=tuple(part[members] for part in assembly.offsets),
    )
    return Group(tubes, bundle, seat)


# --- Tip angles of a group for its joint rotations --------------------------------------------------------------------

# The map from tip angles to joint rotations is inverted by Newton's method, from every cell of a grid in which a table
# of the map admits a solution. Finer grids follow until the set no longer changes and its topological degree, the sum
# of the signs of det(d alpha / d theta_tip), is 1, as it must be: alpha - theta_tip is bounded, so that the map deforms
# into the identity. For more than three tubes there is no table, and the starts are a Sobol sequence.
#
# One table serves all joint rotations and transmissions. theta(0) - theta_tip and t(0) are periodic, analytic functions
# of the tip angles: their Fourier series converge geometrically, so that a grid that resolves the series has all values
# in between. On the centreline they depend on the angles relative to the last tube's; off it also on the common angle,
# but smoothly, so that few points are enough.

TURN = 2 * np.pi

RELATIVE = 32
"""Points per turn of the coarsest table in the angles relative to the last tube's."""

COMMON = 6
"""Points per turn of the coarsest table in the angle of the last tube."""

MAX_POINTS = 250_000
"""Number of points beyond which a table is not refined."""

# The amplitudes decay geometrically: those that the table lacks sum up to about the power 3/2 of this.
TAIL = 0.05
"""Largest sum of the Fourier amplitudes (rad) in the upper third of the frequencies of a table."""

TABLE_ERROR = 2e-3
"""Error of a table, in turns of a joint."""

TABLE_STEPS = 2
"""Integration steps per piece for a table, and on the path to a solution: errors near 1e-4 rad."""

# A cell may contain a solution where the function passes a whole number of turns between its corners. On a coarse grid
# the bound on its second differences is large, so that more cells have to be solved. A third grid is needed near folds
# only, where the set still changes from the first to the second.
GRIDS = ((1024, 4096, 16384), (160, 320, 640), (80, 120, 180))
"""Points per turn of the successive grids for one, two and three relative tip angles."""

FIRST_STARTS = 1024
"""Points of the Sobol sequence in the first round without a table; doubled in every round."""

COARSE_TOLERANCE = 1e-3
"""Tolerance (rad) of Newton's method on the coarse integration: ten times the error of the integration."""

CLOSE = 1e-2
"""Largest residual (rad) of a kept point without convergence: next to a fold Newton's method stalls."""

SOLVED = 1e-8
"""Tolerance (rad) of Newton's method on the fine integration; the error of the integration is 1e-6 rad."""

# Next to a fold the Jacobian is nearly singular: a free step may lead anywhere.
LONGEST_TIP_STEP = 0.5
"""Largest change (rad) of a tip angle in one Newton step."""

SAME_TIPS = 1e-4
"""Difference (rad) below which tip angles on the same side of a fold are equal."""


@dataclass(frozen=True, eq=False)
class TipTable:
    """Map from tip angles to the plate for k tubes, over one turn of each of d angles.

    The angles are the k - 1 relative to the last tube's, and off the centreline also the last tube's.
    """

    size: tuple[int, ...]
    """(d,) points per turn of each angle."""
    twist: Array
    """(*size, k) theta(0) - theta_tip, rad."""
    torque: Array
    """(*size, k) torque at the plate, N m."""


@lru_cache(maxsize=16)
def table_of(bundle: ShootingArm, k: int) -> TipTable:
    """Table from tip angles to plate angles for the first k tubes of a bundle, refined to resolve its
    Fourier series.
    """
    size = (RELATIVE,) * (k - 1) + ((COMMON,) if bundle.offsets else ())
    while True:
        tips = _tips(_grid(size), k).reshape(-1, k)
        shot = shoot(bundle, tips, steps=TABLE_STEPS)
        twist = shot.rotations + bundle.transmission[:k] * shot.torque - tips
        table = TipTable(size, twist.reshape(*size, k), shot.torque.reshape(*size, k))
        tails = _tails(table.twist - bundle.transmission[:k] * table.torque)
        finer = tuple(2 * n if tail > TAIL else n for n, tail in zip(size, tails, strict=True))
        if finer == size or np.prod(finer) > MAX_POINTS:
            return table
        size = finer


def _grid(size: tuple[int, ...]) -> Array:
    """(*size, d) angles of a grid over one turn of each of d angles."""
    return np.stack(np.meshgrid(*[np.arange(n) * TURN / n for n in size], indexing="ij"), axis=-1)


def _tips(angles: Array, k: int) -> Array:
    """(..., k) tip angles for angles (..., d) of a table."""
    tips = np.zeros((*angles.shape[:-1], k))
    tips[..., :-1] = angles[..., : k - 1]
    return tips + angles[..., k - 1 :] if angles.shape[-1] == k else tips


def _tails(values: Array) -> list[float]:
    """Sum of the Fourier amplitudes in the upper third of the frequencies along each axis, for the worst component."""
    dimension = values.ndim - 1
    axes = tuple(range(dimension))
    amplitude = np.abs(np.fft.fftn(values, axes=axes)) / np.prod(values.shape[:-1])
    out = []
    for axis in axes:
        n = values.shape[axis]
        high = np.abs(np.fft.fftfreq(n, 1 / n)) > n / 3
        out.append(float(np.compress(high, amplitude, axis=axis).sum(axes).max()))
    return out


def starts(table: TipTable, transmission: Array, target: Array, size: int) -> Array:
    """(B, k) tip angles in the middle of every cell of a grid that may contain a solution.

    The solution is for the joints `target` (k,).

    The grid has at least `size` points per turn of the relative angles.
    """
    k, dimension = len(target), len(table.size)
    values = table.twist - transmission * table.torque
    sizes = tuple(max(2 * n, size if axis < k - 1 else 0) for axis, n in enumerate(table.size))
    for axis, n in enumerate(sizes):
        # The values of the Fourier series on the finer grid, as by `scipy.signal.resample`, whose import takes longer
        # than the search.
        spectrum, coarse = np.moveaxis(np.fft.rfft(values, axis=axis), axis, 0), values.shape[axis]
        if coarse % 2 == 0:
            spectrum[coarse // 2] /= 2  # the amplitude of the highest frequency belongs to both signs
        values = np.fft.irfft(np.moveaxis(spectrum, 0, axis), n, axis=axis) * (n / coarse)
    angles = _grid(sizes)
    residual = _tips(angles, k) + values - target
    # Continuous along the grid: relative to the last tube, and that of the last tube where the common angle matters.
    parts = [residual[..., i] - residual[..., -1] for i in range(k - 1)] + [residual[..., -1]] * (dimension == k)
    admitted = np.logical_and.reduce([_may_be_whole(part / TURN, axis) for axis, part in enumerate(parts)])
    tips = _tips(angles[admitted] + TURN / 2 / np.array(sizes), k)
    return tips if dimension == k else tips + target[-1]


def _may_be_whole(values: Array, rising_axis: int) -> NDArray[np.bool_]:
    """Mask of the grid cells in which a function, in turns, may take an integer value.

    It rises by 1 along one axis per turn.

    Inside a cell it lies between the values at the corners, widened by twice the bound from its second differences.
    """

    def shifted(values: Array, axis: int) -> Array:
        out = np.roll(values, -1, axis=axis)
        if axis == rising_axis:
            out[(slice(None),) * axis + (-1,)] += 1.0
        return out

    low = high = values
    curvature = np.zeros_like(values)
    for axis in range(values.ndim):
        low, high = np.minimum(low, shifted(low, axis)), np.maximum(high, shifted(high, axis))
        step = shifted(values, axis) - values
        second = np.abs(step - np.roll(step, 1, axis=axis))
        curvature += np.maximum(second, np.roll(second, -1, axis=axis)) / 4
    for axis in range(values.ndim):
        curvature = np.maximum(curvature, np.roll(curvature, -1, axis=axis))
    width = curvature + TABLE_ERROR
    return np.asarray(np.floor(high + width) >= np.ceil(low - width))


@dataclass(frozen=True, eq=False)
class Preimage:
    """Tip angles of all solutions for the joint rotations of k tubes."""

    tips: Array
    """(S, k) tip angles, rad."""
    sign: Array
    """(S,) signs of det(d alpha / d theta_tip)."""
    travel: Array
    """(S, m) length of every tube of the bundle, m."""
    complete: bool
    """True if the last grid added nothing and the degree is 1."""


def preimage(
    bundle: ShootingArm, transmission: Array, rotations: Array, most_starts: int = DEFAULT_EQUILIBRIA_SEARCH.most_starts
) -> Preimage:
    """Tip angles for joint rotations (k,) of the first k tubes of a bundle, with transmissions (n,), 1/(N m).

    All other tubes of the bundle are straight.
    """
    part = replace(bundle, transmission=transmission)
    if len(rotations) == 1:
        # The torsion of a single tube is 0.
        return _finish(part, rotations, rotations[None])
    result = _finish(part, rotations, np.zeros((0, len(rotations))))
    for guesses in _tip_starts(bundle, transmission, rotations, most_starts):
        before = len(result.tips)
        result = _finish(part, rotations, np.concatenate([result.tips, _approach(part, rotations, guesses)]))
        if len(result.tips) == before and result.sign.sum() == 1:
            return result
    return replace(result, complete=False)


def _tip_starts(bundle: ShootingArm, transmission: Array, target: Array, max_starts: int) -> Iterator[Array]:
    """(B, k) tip angles to solve from, from ever finer grids."""
    k = len(target)
    if k <= 3:
        table = table_of(bundle, k)
        for size in GRIDS[len(table.size) - 1]:
            yield starts(table, transmission[:k], target, size)
        return
    count = FIRST_STARTS
    while count <= max_starts:
        tips = np.pad(sobol(k - 1, count, count.bit_length() - 1) * TURN, ((0, 0), (0, 1)))
        joints = shoot(replace(bundle, transmission=transmission), tips, steps=TABLE_STEPS).rotations
        # Turning all tubes alike makes the last joint exact.
        yield tips + (target - joints)[:, -1:]
        count *= 2


def _newton(
    bundle: ShootingArm, target: Array, tips: Array, steps: int, iterations: int, tolerance: float
) -> tuple[Array, Array]:
    """(B, k) tip angles with the smallest residual of Newton's method, and this residual (B,), rad, up to full turns.

    Args:
        steps: integration steps per piece.   iterations: maximum number.   tolerance: residual, rad.
    """
    best, smallest = tips.copy(), np.full(len(tips), np.inf)
    active, x = np.arange(len(tips)), tips
    for _ in range(iterations):
        if not len(active):
            break
        shot = shoot(bundle, x, steps=steps, slopes=True)
        residual = shot.rotations - target
        residual -= TURN * np.round(residual / TURN)
        size = np.abs(residual).max(1)
        better = size < smallest[active]
        best[active[better]], smallest[active[better]] = x[better], size[better]
        unsolved = size > tolerance
        active, x, residual, jacobian = active[unsolved], x[unsolved], residual[unsolved], shot.by_tip[unsolved]
        step = np.linalg.solve(jacobian + 1e-12 * np.eye(tips.shape[1]), -residual[:, :, None])[:, :, 0]
        change = np.abs(step).max(1, initial=0.0)
        x = x + step * np.minimum(1.0, LONGEST_TIP_STEP / np.maximum(change, 1e-12))[:, None]
    return best, smallest


def _approach(bundle: ShootingArm, target: Array, starts: Array) -> Array:
    """Tip angles close to solutions, from the coarse integration, without duplicates."""
    tips = starts
    # After three steps most starts coincide; only distinct ones are continued.
    for iterations in (3, 10):
        tips, residual = _newton(bundle, target, tips, TABLE_STEPS, iterations, COARSE_TOLERANCE)
        tips = tips % TURN
        first = np.unique(np.round(tips / CLOSE), axis=0, return_index=True)[1]
        tips, residual = tips[first], residual[first]
    return np.asarray(tips[residual < CLOSE])


def _finish(bundle: ShootingArm, target: Array, starts: Array) -> Preimage:
    """Distinct solutions from close starts, with the tip angles for which the joints have no extra full turns."""
    tips, residual = _newton(bundle, target, starts, STEPS_PER_ELEMENT, 12, SOLVED)
    tips = tips[residual < SOLVED]
    if not len(tips):
        return Preimage(tips, np.zeros(0), np.zeros((0, bundle.n_tubes)), True)
    shot = shoot(bundle, tips, slopes=True)
    tips = tips - TURN * np.round((shot.rotations - target) / TURN)
    sign = np.sign(np.linalg.det(shot.by_tip))
    distinct: list[int] = []
    for i in range(len(tips)):
        near = np.abs(tips[distinct] - tips[i]).max(1, initial=0.0) < SAME_TIPS
        # Next to a fold two solutions are close together, but differ in sign.
        if not (near & (sign[distinct] == sign[i])).any():
            distinct.append(i)
    return Preimage(tips[distinct], sign[distinct], shot.travel[distinct], True)


# --- Under a load -----------------------------------------------------------------------------------------------------

# The equations are x - f(x) = 0 in whitened rotations and bending. f is bounded, by the moments of precurvature, forces
# times the length of the arm, and external moments, whether there is an energy or not. So no equilibrium of x - s f(x),
# 0 <= s <= 1, lies beyond the bound, and the degree is that of x, 1: the signs of the determinants add up to 1 over all
# equilibria. Where there is an energy, they are (-1)^index.

LOADED_STARTS = 128
"""Number of starts in the first round; doubled in every round."""

# Tubes of a stable arm without external moments twist by less than a turn.
LARGEST_TWIST = 2 * np.pi
"""Largest twist (rad) of a tube at the tip that the starts cover, without that by external moments."""

BENT = np.pi / 2
"""Largest bend (rad) of a bundle by a load that its starts cover."""


def loaded_equilibria(
    robot: Robot,
    rotations: Array,
    translations: tuple[float, ...],
    load: Load,
    unloaded: list[Equilibrium],
    search: EquilibriaSearch = DEFAULT_EQUILIBRIA_SEARCH,
) -> list[Equilibrium]:
    """All equilibria under a load; `unloaded` are those without.

    Newton's method starts at every unloaded equilibrium and at twisted and bent arms from a Sobol sequence, twice as
    many in every round. From every unstable equilibrium the robot falls to both sides. The search ends when a round
    finds nothing new, the degree is 1, and, where there is an energy, one equilibrium is stable.

    Returns:
        Lowest potential energy first; without an energy, largest margin first.
    """
    check_load(robot, load, translations)
    member = Loaded.of(robot, rotations, translations, load)
    bounded, force = load.tip_force_only, float(np.linalg.norm(load.force))
    if bounded and snap_free_certificate(robot, translations, max_force=force) > CERTAIN:
        return [forward_kinematics(robot, rotations, translations, load=load)]
    result: list[LoadedPoint] = []
    explored: set[int] = set()
    for equilibrium in unloaded:
        theta = sample_rotation(equilibrium, member.problem.torsion.arc_length)
        add(result, member, member.unknowns(theta))
    sequence, count = scipy.stats.qmc.Sobol(robot.n_tubes + 4, seed=0), LOADED_STARTS
    while count <= search.most_loaded_starts:
        starts = _starts(member, sequence.random(count))
        new = sum(add(result, member, x) for x in starts)
        new += _descend(result, explored)
        # An energy has a minimum: without a stable equilibrium the set is not complete.
        if not new and degree(result) == 1 and (not member.descends or any(point.margin > 0 for point in result)):
            points = sorted(result, key=lambda point: point.state.potential if member.descends else -point.margin)
            return [to_equilibrium(point, "search from many starts") for point in points]
        count *= 2
    raise SolveError(
        f"{len(result)} equilibria were found with degree {degree(result)} instead of 1: one "
        "is missing, or joint values and load are at a fold"
    )


def _starts(member: Loaded, samples: Array) -> list[Array]:
    """Unknowns of arms with tubes twisted and bent linearly in arc length, from samples (B, n + 4) in [0, 1].

    A force F bends a rod by at most min(2 sqrt(F / K), F L / K): the first integral of the elastica, and the lever.
    """
    problem, n, load = member.problem, len(member.rotations), member.problem.load
    torsion = problem.torsion
    length = torsion.assembly.total_length
    s = torsion.arc_length[:, None] / length
    stiffness = torsion.stiffness.sum(1)
    push = np.linalg.norm(problem.force, axis=1) + np.linalg.norm(load.force) * (load.frame == "tip")
    couple = 0.0 if problem.couples is None else np.linalg.norm(problem.couples.moment, axis=1).sum()
    max_curvature = np.minimum(2 * np.sqrt(push / stiffness), push * length / stiffness)[:, None]
    max_curvature += (couple / stiffness)[:, None]
    twist = LARGEST_TWIST + couple * problem.tip_lever
    starts = []
    for sample in 2 * samples - 1:
        x = member.unknowns(member.rotations + twist * sample[:n] * s)
        curvature = 2 * max_curvature * (sample[n : n + 2] * (1 - s) + sample[n + 2 :] * s)
        x[torsion.size :] = (curvature / problem.softness[:, None]).ravel()
        starts.append(x)
    return starts


def add(equilibria: list[Any], member: Member[Any], x: Array) -> bool:
    """Solve from x, and append the equilibrium if it is a new one; True if so."""
    result = member.solve(x, iterations=30)
    if not result.converged:
        return False
    return keep(equilibria, Point.of(member, result, 1.0))


def keep(equilibria: list[Any], point: AnyPoint) -> bool:
    """Append an equilibrium if it is a new one; True if so."""
    member, state = point.member, point.state

    def same(known: AnyPoint) -> bool:
        if not isinstance(member, Bundled):
            return bool(member.distance(known, state) < SAME)
        # Ends together have two orders, each with unknowns of its own.
        tips = (p.state.problem.tip_rows @ p.state.x for p in (known, point))
        return bool(np.abs(np.subtract(*tips)).max() < SAME)

    if any(same(known) for known in equilibria):
        return False
    equilibria.append(point)
    return True


def _descend(result: list[Any], explored: set[int]) -> int:
    """Add equilibria reached from unstable ones on both sides of their unstable directions; returns their number.

    Only from real eigenvalues: the motion after flutter has no known end.
    """
    new = 0
    for k, point in enumerate(list(result)):
        if k in explored or point.margin >= 0:
            continue
        explored.add(k)
        member = point.member
        values, vectors = (np.linalg.eigh if member.descends else np.linalg.eig)(point.state.hessian)
        for direction in vectors.real.T[(values.real < 0) & (values.imag == 0)]:
            push = NUDGE / member.largest_rotation(point.state, direction) * direction
            for side in (push, -push):
                landed = slide(member, point.state.x + side)
                new += landed is not None and add(result, member.owner(landed.state), landed.state.x)
    return new


# --- Of bundles -------------------------------------------------------------------------------------------------------

# The energy of a bundle has kinks where the order of its ends changes. Where it falls to both sides of one the arm is
# on a ridge, which counts as a saddle with one more unstable direction.


def bundle_equilibria(
    robot: BundleRobot,
    rotations: Array,
    translations: tuple[float, ...],
    load: Load | None,
    search: EquilibriaSearch = DEFAULT_EQUILIBRIA_SEARCH,
) -> list[Equilibrium]:
    """All equilibria of a bundle, ridges included; the search is that of `loaded_equilibria`.

    Returns:
        Lowest potential energy first; without an energy, largest margin first.

    Raises:
        SolveError: the set is not complete, as where three ends meet.
    """
    first = forward_kinematics(robot, rotations, translations, load=load)
    if load is None and snap_free_certificate(robot, translations) > CERTAIN:
        return [first]
    found, explored = [point_of(first)], set[int]()
    descends = found[0].member.descends
    sequence, count = scipy.stats.qmc.Sobol(robot.n_tubes + 4, seed=0), LOADED_STARTS
    while count <= search.most_loaded_starts:
        starts = _bundle_starts(robot, rotations, translations, load, sequence.random(count))
        new = 0
        for member, x in starts:
            if add(found, member, x):
                new += 1
                _refuse_meeting_ends(found)
        new += _descend(found, explored)
        if descends:
            new += sum(keep(found, ridge) for point in list(found) for ridge in ridges_beside(point))
        if not new and degree(found) == 1 and (not descends or any(point.margin > 0 for point in found)):
            points = sorted(found, key=lambda point: point.state.potential if descends else -point.margin)
            return [to_equilibrium(point, "search from many starts") for point in points]
        count *= 2
    raise SolveError(
        f"{len(found)} equilibria were found with degree {degree(found)} instead of 1: one is missing, joint values "
        "are at a fold, or three ends of tubes meet"
    )


MEETING = 1e-5
"""Distance (m) of three ends below which an arm that is stable in three of their orders makes the search fail."""


def _refuse_meeting_ends(found: list[Any]) -> None:
    """Raise SolveError if arms are stable in three orders of three ends at one place.

    Between them there is an equilibrium with all three ends together: a kink of the energy in several directions, of
    which no section has the equations.
    """
    orders = set[tuple[int, ...]]()
    for point in found:
        if point.margin > 0:
            ends = to_equilibrium(point, "search from many starts").tube_end
            last = np.argsort(ends)[-3:]
            if len(last) == 3 and np.ptp(ends[last]) < MEETING:
                orders.add(tuple(int(i) for i in last))
    same = [order for order in orders if sum(set(order) == set(other) for other in orders) >= 3]
    if same:
        first, second, third = sorted(i + 1 for i in same[0])
        raise SolveError(
            f"tubes {first}, {second} and {third} end within {MEETING:g} m of one another, and the arm is stable in "
            f"{len(same)} orders of these ends; the unstable equilibria between the orders cannot be found. Other "
            "rotations or lengths of the tubes separate the ends"
        )


def _bundle_starts(
    robot: BundleRobot, rotations: Array, translations: tuple[float, ...], load: Load | None, samples: Array
) -> Iterator[tuple[Bundled, Array]]:
    """Members and unknowns of arms with tubes twisted and bent linearly in arc length, from samples (B, n + 4)."""
    n = robot.n_tubes
    for sample in 2 * samples - 1:
        twist = LARGEST_TWIST * sample[:n]

        def untwisted(bundle: Bundle, places: list[float], turns: Array = rotations + twist / 2) -> Start:
            return natural_start(bundle, turns, places)

        member = Bundled.of(robot, rotations, translations, load, start=untwisted)
        problem = member.problem
        h = problem.nominal[problem.point_section][:, None]
        s = problem.up_to @ h
        theta = rotations + twist * s / s.max()
        stiffness = problem.stiffness.sum(1) + problem.bundle.sheath
        pull = problem.inputs[2][..., None] * np.stack([np.cos(theta), np.sin(theta)], -1)
        pushed = BENT * (sample[n : n + 2] * (1 - s / s.max()) + sample[n + 2 :] * s / s.max()) / s.max()
        bend = (pull.sum(1) / stiffness[:, None] + pushed * (load is not None)) * h
        bend *= problem.bends.reshape(-1, 2)
        yield member, problem.unknowns(twist * problem.present * h / s.max(), bend.ravel(), np.zeros(n))


def degree(result: Iterable[AnyPoint]) -> int:
    """Topological degree of a set of equilibria: the sum of the signs of det H, which is 1 for a complete set.

    The equations deform into those without coupling, which have one solution.
    """
    return int(sum(_sign(each) for each in result))


def _sign(point: AnyPoint) -> float:
    """Sign of det H; opposite where a bundle is unstable because ends that are together separate, as on a ridge."""
    sign, margin = float(np.linalg.slogdet(point.state.hessian)[0]), point.margin
    opens = isinstance(point.member, Bundled) and margin < 0 < least(point.member.form(point.state))
    return -sign if opens or np.isneginf(margin) else sign


# --- Search -----------------------------------------------------------------------------------------------------------


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
    """All equilibria at given joint values, stable and unstable, the lowest energy first.

    A positive certificate of tubes on the centreline proves that there is only one; then nothing is searched. Otherwise
    tubes that act on one another are searched group by group (groups: tubes that are curved in a common section).

    Groups of up to three tubes, as in every segment of an eccentric robot, are searched systematically. The joint
    rotations are tabulated over one turn of each tip angle. Every cell of the grid that may contain a solution is
    solved. The grid is refined until the set no longer changes and its topological degree is 1, as theory demands. On
    the centreline the degree is the sum of (-1)^index. Larger groups start from a Sobol sequence, and the degree is the
    only check. Bundles are searched as robots under load. Where the order of their ends changes, the arm may stand on a
    ridge of the energy: an unstable equilibrium with a margin of minus infinity.

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
    alpha, translation = joint_values(robot, rotations, translations)
    shift = tuple(translation.tolist())
    if isinstance(robot, BundleRobot):
        return bundle_equilibria(robot, alpha, shift, load, search)
    result = _without_load(Unloaded.of(robot, alpha, shift), search.most_starts)
    equilibria = [to_equilibrium(point, "search over tip angles") for point in result]
    if load is not None:
        return loaded_equilibria(robot, alpha, shift, load, equilibria, search)
    return sorted(equilibria, key=lambda e: e.energy)


def _without_load(member: Unloaded, most_starts: int) -> list[PlainPoint]:
    """All equilibria without a load; raises SolveError if their degree is not 1."""
    problem, rotations = member.problem, member.rotations
    certain = CERTAIN if problem.assembly.even else CERTAIN_OF_PIECES
    if not problem.assembly.eccentric and worst_case(problem).margin > certain:
        result = member.descend(np.zeros(problem.size))
        if result.converged:
            return [Point.of(member, result)]
    points = list[PlainPoint]()
    for theta in profiles(problem, _all_tips(problem, rotations, most_starts)):
        add(points, member, member.unknowns(theta))
    if degree(points) != 1:
        raise SolveError(_incomplete(len(points), degree(points)))
    return points


def _all_tips(problem: ReducedProblem, rotations: Array, most_starts: int) -> Array:
    """(S, n) tip angles of all equilibria, from the groups of tubes in order, base to tip.

    With tubes off the centreline, each solution of the groups closer to the base gives the tubes inside them other
    lengths, and so other transmissions.
    """
    # The tip of a tube without torsion has the rotation of its joint.
    branches = [(rotations.copy(), np.zeros(problem.assembly.n_tubes))]
    for group in groups_of(problem):
        bundle, solved, extended = group.bundle, dict[bytes, Preimage](), []
        for tips, extra_length in branches:
            key = extra_length.tobytes()
            if key not in solved:
                transmission = bundle.transmission.copy()
                # Straight tubes that only fill an offset have no torsion to transmit.
                transmission[: len(group.tubes)] += (extra_length / problem.assembly.held_stiffness)[group.tubes]
                solved[key] = preimage(bundle, transmission, rotations[group.tubes], most_starts)
            result = solved[key]
            if not result.complete:
                raise SolveError(_incomplete(len(result.tips), int(result.sign.sum())))
            for group_tips, travel in zip(result.tips, result.travel, strict=True):
                all_tips = tips.copy()
                all_tips[group.tubes] = group_tips
                stretch = travel[group.seat] - bundle.length.sum() if bundle.offsets else 0.0
                extended.append((all_tips, extra_length + stretch))
        branches = extended
    return np.array([tips for tips, _ in branches])


def _incomplete(count: int, degree: int) -> str:
    """Message for a set of equilibria that is not complete."""
    why = f"of degree {degree} instead of 1" if degree != 1 else "more of them on every finer grid"
    return f"{count} equilibria were found, {why}: one is missing, or the joint values are at a fold, where two are one"
