"""Forward kinematics of many configurations, each solved by itself."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..arguments import typed
from ..block.transcription.arm import arc_lengths
from ..display import Displayed
from ..errors import InputError, SolveError, choice, positive
from ..robots.assembly import LENGTH_ROUND_OFF
from ..robots.eccentric import by_model
from ..robots.limits import check_reach, check_turn
from ..robots.load import Load
from ..robots.robot import Robot, check_robot
from ..solvers.compiled.binding import solve_compiled, solve_many_compiled
from ..solvers.compiled.loaded import solve_many_loaded_compiled
from ..solvers.settings import NEWTON
from ..solvers.time_limit import LONG_TIME_LIMIT, check_time, limited
from ..typing import Array, Index, Mask, StatusEnum
from .kinematics import KERNEL_MESHES, TOLERANCE, SolveRequest, forward_kinematics, largest_error, unloaded
from .member import sample_arms
from .problem import check_load, loaded_rules

CHUNK = 2048
"""Number of configurations per call of the kernel: large against its overhead, small enough to occupy all workers."""


class BatchStatus(StatusEnum):
    """Outcome of a batch, as a sentence."""

    SOLVED = "a stable equilibrium was found at all joint values"
    GAPS = "no stable equilibrium was found at some joint values"


@dataclass(frozen=True)
class BatchStatistics:
    """Size of a batch."""

    samples: int
    """Number of configurations."""
    failures: int
    """Number of configurations without a stable equilibrium found."""


@dataclass(frozen=True, eq=False)
class EquilibriumBatch(Displayed):
    """Equilibria of N configurations of a robot with n tubes; rows that did not converge are NaN."""

    robot: Robot
    """Robot of all configurations."""
    rotations: Array
    """(N, n) rotations, rad."""
    translations: Array
    """(N, n) translations, m."""
    tip_position: Array
    """(N, 3) end of the tube that reaches farthest, in the plate frame, m."""
    tip_rotation: Array
    """(N, 3, 3) frame of the tip in the plate frame."""
    tip_rotations: Array
    """(N, n) rotations of the tubes at their own ends, rad."""
    margin: Array
    """(N,) stability margins; positive where stable."""
    energy: Array
    """(N,) elastic energies, J."""
    residual: Array
    """(N,) violations of the equations, as errors of theta, rad."""
    mesh_error: Array
    """(N,) estimated discretisation errors of theta, rad."""
    tip_error: Array
    """(N,) estimated errors of the tip position, m."""
    converged: Mask
    """(N,) True where a stable equilibrium was found to the tolerance; any equilibrium under loads without a margin."""
    failures: tuple[tuple[int, str], ...] = ()
    """Pairs (row, reason) of all unsolved rows."""
    compliance: Array = field(default_factory=lambda: np.zeros((0, 6, 6)))
    """(N, 6, 6) compliance of the tip under a load, m and rad per N and N m; (0, 6, 6) without a load."""

    def __len__(self) -> int:
        return len(self.rotations)

    @property
    def value(self) -> Array:
        """(N, 3) tip positions, m."""
        return self.tip_position

    @property
    def status(self) -> BatchStatus:
        """Outcome of the batch, as a sentence."""
        return BatchStatus.SOLVED if self.converged.all() else BatchStatus.GAPS

    @property
    def statistics(self) -> BatchStatistics:
        """Numbers of configurations and failures."""
        return BatchStatistics(len(self), int((~self.converged).sum()))

    @property
    def stable(self) -> Mask:
        """(N,) True where a stable equilibrium was found."""
        return np.asarray(self.converged & (self.margin > 0))


@typed
@by_model
@limited
def forward_kinematics_batch(  # noqa: PLR0913
    robot: Robot,
    rotations: ArrayLike,
    translations: ArrayLike | None = None,
    *,
    load: Load | None = None,
    tolerance: float = TOLERANCE,
    workers: int = 1,
    on_failure: str = "return",
    progress: Callable[[int], object] | None = None,
    time_limit: float = LONG_TIME_LIMIT,
) -> EquilibriumBatch:
    """Equilibria of N configurations, each the one that `forward_kinematics` finds without a start.

    The compiled kernel solves them where there is a C compiler; `forward_kinematics` solves the remaining ones.

    Args:
        rotations: (N, n) rad.
        translations: (N, n) m, or (n,) for all; None is home.
        load: external load on every configuration.
        tolerance: required accuracy of theta(s), rad, and of the tip, relative to the length of the arm. For tubes made
            of pieces it applies to pieces of 10 mm.
        workers: threads of the kernel; 0 is one per core.
        on_failure: "return" marks configurations without a stable equilibrium; "raise" raises SolveError for the first.
        progress: called with the number of configurations done, now and then.
        time_limit: maximum run time, s.

    Raises:
        InputError: arrays of wrong shape, a value that is not finite, or a tube out of its actuator; names the row.
        SolveError: with on_failure="raise", no stable equilibrium was found for a configuration.
        TimeLimitError: (a SolveError) the time limit was reached before there was an answer.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/two_tube.yaml")
        >>> batch = tubeopt.forward_kinematics_batch(robot, [[0.0, 0.0], [0.5, 0.0]])
        >>> batch.tip_position.shape, bool(batch.converged.all())
        ((2, 3), True)
    """
    alpha, shift = joint_arrays(robot, rotations, translations)
    positive("tolerance", tolerance)
    choice("on_failure", on_failure, ("return", "raise"))
    if isinstance(workers, bool) or not isinstance(workers, int) or workers < 0:
        raise InputError(f"workers is {workers!r}; it must be 0 (one per core) or a number of threads")
    _admissible(robot, shift)
    raises = on_failure == "raise"
    return solved_batch(robot, alpha, shift, load, tolerance, workers=workers, raises=raises, progress=progress)


def solved_batch(  # noqa: PLR0913
    robot: Robot,
    alpha: Array,
    shift: Array,
    load: Load | None = None,
    tolerance: float = TOLERANCE,
    *,
    workers: int = 1,
    raises: bool = False,
    quick: bool = False,
    progress: Callable[[int], object] | None = None,
) -> EquilibriumBatch:
    """Batch at checked rotations and translations (N, n).

    Args:
        raises: raise SolveError for the first configuration without an equilibrium.
        quick: count configurations without a load that the compiled kernel does not solve as failed.
    """
    table = np.full((len(alpha), 17 + robot.n_tubes), np.nan)
    compliance = np.full((len(alpha) if load is not None else 0, 6, 6), np.nan)
    failures: list[tuple[int, str]] = []

    def run(rows: slice) -> int:
        """Solve some rows into `table` and `compliance`; returns their number."""
        if load is None:
            unsolved = _solve_rows(robot, alpha, shift, rows, table, tolerance)
        else:
            unsolved = _solve_loaded_rows(robot, alpha, shift, load, rows, table, compliance, tolerance)
        for row in unsolved.tolist():
            try:
                if quick:
                    e = unloaded(robot, alpha[row], shift[row], None, SolveRequest(tolerance=tolerance))
                    if e is None:
                        raise SolveError("the compiled kernel found no equilibrium")
                else:
                    e = forward_kinematics(robot, alpha[row], shift[row], load=load, tolerance=tolerance)
            except SolveError as error:
                table[row], compliance[row : row + 1] = np.nan, np.nan  # without a load there is no such row
                failures.append((row, str(error)))
                continue
            scalars = [e.margin, e.residual, e.mesh_error, e.tip_error, e.energy]
            table[row] = np.concatenate([e.tip_position, e.tip_rotation.ravel(), e.tip_rotations, scalars])
            if load is not None:
                compliance[row] = e.compliance
        return len(alpha[rows])

    solved = 0
    for count in _in_chunks(run, len(alpha), workers or os.cpu_count() or 1):
        check_time()
        solved += count
        if progress is not None:
            progress(solved)
        if failures and raises:
            row, reason = min(failures)
            raise SolveError(f"configuration {row}: {reason}")
    return replace(_batch(robot, alpha, shift, table, sorted(failures)), compliance=compliance)


def joint_arrays(robot: Robot, rotations: ArrayLike, translations: ArrayLike | None) -> tuple[Array, Array]:
    """Rotations and translations as finite (N, n) arrays; raises InputError naming an invalid value."""
    check_robot(robot)
    n = robot.n_tubes
    alpha = _table("rotations", rotations)
    if alpha.ndim != 2 or alpha.shape[1] != n:
        raise InputError(f"rotations has the shape {alpha.shape}; it must be (N, {n}), one column per tube")
    check_turn(alpha)
    shift = _table("translations", robot.home_translations if translations is None else translations)
    if shift.shape == (n,):
        shift = np.tile(shift, (len(alpha), 1))
    if shift.shape != alpha.shape:
        raise InputError(f"translations has the shape {shift.shape}; it must be {alpha.shape} or ({n},)")
    return alpha, shift


def _table(name: str, values: ArrayLike) -> Array:
    """Argument `name` as an array of finite numbers."""
    try:
        array = np.array(values, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{name} is no array of numbers; it must be (N, n)") from None
    if not array.ndim:
        raise InputError(f"{name} is {values!r}; it must be an array (N, n)")
    if not np.isfinite(array).all():
        row = int(np.argwhere(~np.isfinite(array))[0][0])
        raise InputError(f"{name}[{row}] is {array[row].tolist()}; every number must be finite")
    return array


def _admissible(robot: Robot, shift: Array) -> None:
    """Raise InputError naming the first row of translations (N, n) that the robot cannot have."""
    straight = np.array([tube.straight_length for tube in robot.tubes])
    out = np.argwhere(shift - straight > LENGTH_ROUND_OFF)
    if len(out):
        row, tube = (int(k) for k in out[0])
        raise InputError(
            f"translations[{row}] of tube {tube + 1} is {shift[row, tube]:g} m and moves it "
            "out of its carriage; it must be at most its straight_length, "
            f"{straight[tube]:g} m"
        )
    if len(shift):
        check_reach(robot.tubes, shift.min(0).tolist())
    if all(len(tubes) == 1 for tubes in robot.moving_together):
        return
    for row in sorted(np.unique(shift, axis=0, return_index=True)[1].tolist()):
        try:
            robot.admit(shift[row])
        except InputError as error:
            raise InputError(f"translations[{row}]: {error}") from None


def _in_chunks(run: Callable[[slice], int], count: int, workers: int) -> Iterator[int]:
    """Results of `run` for chunks of `count` rows, on a number of threads."""
    chunks = [slice(k, min(k + CHUNK, count)) for k in range(0, count, CHUNK)]
    if workers == 1 or len(chunks) == 1:
        yield from map(run, chunks)
        return
    with ThreadPoolExecutor(workers) as pool:
        yield from pool.map(run, chunks)


def _solve_rows(robot: Robot, alpha: Array, shift: Array, rows: slice, table: Array, tolerance: float) -> Index:
    """Solve some rows into `table` by the compiled kernel; returns the rows that it did not solve."""
    unsolved: Index = np.arange(rows.start, rows.stop)
    straight, curved = np.array([(tube.straight_length, tube.curved_length) for tube in robot.tubes]).T
    n = robot.n_tubes
    for refinement in KERNEL_MESHES:
        if not len(unsolved):
            break
        result = solve_many_compiled(robot, alpha[unsolved], shift[unsolved], None, refinement)
        if result is None:
            break
        values, declined = result
        table[unsolved] = values
        length = (np.minimum(shift[unsolved], straight) + curved).max(1)
        coarse = ~(largest_error(values[:, n + 14], values[:, n + 15], length, even=robot.even) <= tolerance)
        unsolved = unsolved[declined | coarse]
    return unsolved


def _solve_loaded_rows(
    robot: Robot,
    alpha: Array,
    shift: Array,
    load: Load,
    rows: slice,
    table: Array,
    compliance: Array,
    tolerance: float,
) -> Index:
    """Solve some rows under a load by the compiled kernels; returns the rows that they did not solve."""
    unsolved = [np.arange(0)]
    translations, group = np.unique(shift[rows], axis=0, return_inverse=True)
    for k, translation in enumerate(translations):
        chosen = rows.start + np.flatnonzero(group.ravel() == k)
        result = _solve_loaded(robot, alpha[chosen], translation, load, tolerance) if len(chosen) > 1 else None
        if result is not None:
            table[chosen], compliance[chosen] = result.table, result.compliance
            chosen = chosen[~result.solved]
        unsolved.append(chosen)
    return np.concatenate(unsolved)


class _LoadedRows(NamedTuple):
    """Equilibria at M rotations and one set of translations under a load."""

    table: Array
    """Rows of tip position (3), frame (9), tip rotations (n), margin, residual, errors of theta and tip, energy."""
    compliance: Array
    """(M, 6, 6) compliance of the tip."""
    solved: Mask
    """(M,) True where a stable equilibrium grew from the unloaded one, on a mesh that is fine enough."""


def _solve_loaded(
    robot: Robot, rotations: Array, translations: Array, load: Load, tolerance: float
) -> _LoadedRows | None:
    """Equilibria at rotations (M, n) and translations (n,) under a load, by the compiled kernels; None without one."""
    shift = tuple(translations.tolist())
    check_load(robot, load, shift)
    first = solve_compiled(robot, rotations[0], translations) if load.has_energy else None
    if first is None:
        return None
    s = first.solution.arm.arc_length
    arms = np.zeros((len(rotations), 2, len(s), robot.n_tubes))
    unloaded = solve_many_compiled(robot, rotations, np.tile(translations, (len(rotations), 1)), arms)
    assert unloaded is not None
    rules = loaded_rules(robot, shift, load)
    problem, n = rules.problem, robot.n_tubes
    length = problem.torsion.assembly.total_length
    theta = sample_arms(robot, translations, s, arms, problem.torsion.arc_length)
    ends = np.searchsorted(arc_lengths(problem.mesh), np.maximum(problem.torsion.assembly.end, 0.0) - 1e-12)
    result = solve_many_loaded_compiled(rules, rotations, (theta, unloaded[0][:, n + 12]), ends.astype(np.int64))
    if result is None:
        return None
    table, compliance, declined = result
    coarse = largest_error(table[:, n + 14], table[:, n + 15], length) > tolerance
    unsolved = unloaded[1] | declined | coarse | (table[:, -1] > NEWTON.margin_tolerance)
    return _LoadedRows(table[:, :-1], compliance, ~unsolved)


def _batch(robot: Robot, alpha: Array, shift: Array, table: Array, failures: list[tuple[int, str]]) -> EquilibriumBatch:
    """Batch from rows of the table."""
    n = robot.n_tubes
    converged = np.ones(len(alpha), dtype=bool)
    converged[[row for row, _ in failures]] = False
    return EquilibriumBatch(
        robot=robot,
        rotations=alpha,
        translations=shift,
        tip_position=table[:, :3],
        tip_rotation=table[:, 3:12].reshape(-1, 3, 3),
        tip_rotations=table[:, 12 : 12 + n],
        margin=table[:, n + 12],
        residual=table[:, n + 13],
        mesh_error=table[:, n + 14],
        tip_error=table[:, n + 15],
        energy=table[:, n + 16],
        converged=converged,
        failures=tuple(failures),
    )
