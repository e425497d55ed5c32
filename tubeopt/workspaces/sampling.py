"""Workspaces: joint values drawn within the limits of a robot, and their equilibria, in memory or in a file."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, BinaryIO

import numpy as np
import scipy

from ..arguments import typed
from ..display import Displayed, in_full
from ..equilibrium.batch import BatchStatistics, BatchStatus, forward_kinematics_batch
from ..errors import InputError, choice, whole
from ..files.field_metadata import OneOf, Range
from ..files.files import atomic_write, lock, read_bytes, write_text
from ..inverse.joints import JointSpace, joint_space
from ..robots.assembly import LENGTH_ROUND_OFF
from ..robots.robot import Robot
from ..solvers.time_limit import LONG_TIME_LIMIT, limited
from ..typing import Array, Mask, Progress

# 1.7 MB of a robot with three tubes.
CHUNK = 1 << 14
"""Number of rows per chunk, so that a table on disk is never in memory as a whole."""


@dataclass(frozen=True, eq=False)
class Workspace(Displayed):
    """Tips of a robot at N joint values; rows without a stable equilibrium are NaN.

    The arrays are views of `table`, which is on disk if the workspace was computed with `out`.
    """

    _brief = ("robot", "method", "seed", "table")

    robot: Robot
    """Sampled robot."""
    method: str
    """Sampling method of the joint values."""
    seed: int
    """Seed of the joint values."""
    table: Array
    """(N, 2 n + 7) rotations, translations, tip position, tip direction, margin; rad and m."""
    failures: tuple[tuple[int, str], ...] = ()
    """Pairs (row, reason) of configurations without an equilibrium."""

    def __len__(self) -> int:
        return len(self.table)

    @property
    def value(self) -> Array:
        """(N, 3) tip positions, m."""
        return self.tip_position

    @property
    def status(self) -> BatchStatus:
        """Status: an equilibrium for every sample, or gaps."""
        return BatchStatus.GAPS if self.failures else BatchStatus.SOLVED

    @property
    def statistics(self) -> BatchStatistics:
        """Numbers of samples and failures."""
        return BatchStatistics(len(self), len(self.failures))

    @property
    def rotations(self) -> Array:
        """(N, n) rotations, rad."""
        return self.table[:, : self.robot.n_tubes]

    @property
    def translations(self) -> Array:
        """(N, n) translations, m."""
        return self.table[:, self.robot.n_tubes : 2 * self.robot.n_tubes]

    @property
    def tip_position(self) -> Array:
        """(N, 3) tip positions in the plate frame, m."""
        return self.table[:, -7:-4]

    @property
    def tip_direction(self) -> Array:
        """(N, 3) unit vectors of the tip directions."""
        return self.table[:, -4:-1]

    @property
    def margin(self) -> Array:
        """(N,) margins of the equilibria."""
        return self.table[:, -1]

    @property
    def converged(self) -> Mask:
        """(N,) True for samples with a stable equilibrium."""
        return np.isfinite(self.margin)

    def chunks(self) -> Iterator[tuple[int, Array]]:
        """Parts of the table, each with the index of its first row; a table on disk is read in parts."""
        for first in range(0, len(self), CHUNK):
            rows, columns = self.table[first : first + CHUNK].shape
            if isinstance(self.table, np.memmap) and self.table.filename is not None:
                start = self.table.offset + 8 * columns * first
                part = np.fromfile(self.table.filename, "<f8", rows * columns, offset=start).reshape(rows, columns)
            else:
                part = self.table[first : first + CHUNK]
            yield first, part

    def some(self, limit: int) -> Array:
        """Random rows, at most `limit`, reproducible; every k-th row of a sequence would be biased."""
        random = np.random.default_rng(len(self))
        chosen = np.sort(random.choice(len(self), min(limit, len(self)), replace=False))
        rows = [part[chosen[(chosen >= first) & (chosen < first + len(part))] - first] for first, part in self.chunks()]
        return np.asarray(random.permutation(np.concatenate(rows)))


def width(n_tubes: int) -> int:
    """Number of columns of the table of a robot."""
    return 2 * n_tubes + 7


def has_margin(table: Array, min_margin: float) -> Mask:
    """(B,) True for rows of a table with at least a margin."""
    with np.errstate(invalid="ignore"):
        return np.asarray(table[:, -1] >= min_margin)


def require_samples(workspace: Workspace) -> None:
    """Raise InputError if no sample has a stable equilibrium."""
    if not any(np.isfinite(part[:, -1]).any() for _, part in workspace.chunks()):
        raise InputError(f"none of the {len(workspace)} samples of the workspace has a stable equilibrium")


METHODS = ("sobol", "random", "grid")

BLOCK = 4096
"""Points drawn at once; a power of two, as Sobol points come."""

TURN = 2 * np.pi


@dataclass(frozen=True, eq=False)
class JointBox:
    """Box [low, high] of m coordinates y that contains all admissible joint values q = back y."""

    low: Array
    high: Array
    back: Array
    periodic: np.ndarray
    """(m,) True for joints with equal joint values at both ends of the range."""

    @property
    def free(self) -> np.ndarray:
        """(k,) coordinates with a range of positive width."""
        return np.flatnonzero(self.high - self.low > LENGTH_ROUND_OFF)


@dataclass(frozen=True, eq=False)
class JointSamples:
    """Admissible joint values of a robot; see `workspace` for the methods.

    Raises:
        InputError: an unknown method, no samples, an invalid seed, or limits without admissible joint values.
    """

    robot: Robot
    method: str
    count: int
    seed: int

    def __post_init__(self) -> None:
        choice("method", self.method, METHODS)
        for name, value, minimum in (("samples", self.count, 1), ("seed", self.seed, 0)):
            whole(name, value, minimum)

    def blocks(self) -> Iterator[tuple[Array, Array]]:
        """Rotations and translations (B, n) of all samples, in their order."""
        space = joint_space(self.robot)
        box, n = _box(space), self.robot.n_tubes
        left, barren = self.count, 0
        for unit in self._units(box):
            y = np.tile(box.low, (len(unit), 1))
            y[:, box.free] += unit * (box.high - box.low)[box.free]
            q = np.clip(y @ box.back.T, space.lower, space.upper)
            # The box of distances may reach beyond the ranges: clipped points would pile up at their ends, and are left
            # out.
            q = q[(np.abs(q - y @ box.back.T) <= 1e-9 * space.scale).all(1)]
            q = q[space.ordered(q)]
            barren = 0 if len(q) else barren + 1
            # A million points: an admissible share below 1e-6 counts as none.
            if barren > 256:
                raise InputError("no random joint values within the limits satisfy the tube order")
            joint = (q @ space.spread.T + space.offset)[:left]
            left -= len(joint)
            if len(joint):
                yield joint[:, :n], joint[:, n:]
            if not left:
                return

    def _units(self, box: JointBox) -> Iterator[Array]:
        """Blocks of points in the unit cube; endless, except for a grid."""
        m = len(box.free)
        if self.method == "grid":
            yield from _grid(box, self.count)
            return
        random = np.random.default_rng(self.seed)
        sobol = scipy.stats.qmc.Sobol(m, rng=random) if self.method == "sobol" and m else None
        while True:
            yield np.asarray(random.random((BLOCK, m)) if sobol is None else sobol.random(BLOCK))


def _grid(box: JointBox, count: int) -> Iterator[Array]:
    """Grid with as many points per axis as fit into `count`, with both ends; of a full turn only one end."""
    free = box.free
    each = 1
    while free.size and (each + 1) ** len(free) <= count:
        each += 1
    axes = [np.arange(each) / each if box.periodic[k] else np.linspace(0, 1, each) for k in free]
    if each == 1:
        axes = [np.array([0.5])] * len(free)
    total = each ** len(free)
    for first in range(0, total, BLOCK):
        indices = (
            np.unravel_index(np.arange(first, min(first + BLOCK, total)), (each,) * len(free)) if len(free) else ()
        )
        rows = [axis[index] for axis, index in zip(axes, indices, strict=True)]
        yield np.column_stack(rows) if rows else np.zeros((1, 0))


def _box(space: JointSpace) -> JointBox:
    """Tightest of two boxes: of the joints themselves, and of the distances between carriages.

    Where the lengths alone set the limits, the second holds admissible values and no others.
    """
    n, m = space.robot.n_tubes, len(space.lower)
    gaps = np.eye(m)
    for k in range(n, m - 1):
        # The order of carriages bounds their distances, which are independent; their positions are not.
        gaps[k, k + 1] = -1.0
    boxes = []
    for forward in (np.eye(m), gaps):
        low, high = _bounds(space, forward)
        boxes.append(JointBox(low, high, np.asarray(np.linalg.inv(forward), dtype=float), np.zeros(m, dtype=bool)))
    # Of points outside the limits each is drawn in vain, and what is left of Sobol's points is less even.
    best = min(boxes, key=lambda box: (len(box.free), float(np.prod((box.high - box.low)[box.free]))))
    low, high = best.low.copy(), best.high.copy()
    full_turn = np.arange(m) < n
    full_turn &= high - low >= TURN - 1e-9
    # Whole turns repeat the shape: one of them, around home where that is allowed.
    # Nearest to 0, so that samples of robots with wider ranges have the same joint values.
    middle = np.clip(0.0, low + TURN / 2, high - TURN / 2)
    low, high = np.where(full_turn, middle - TURN / 2, low), np.where(full_turn, middle + TURN / 2, high)
    return JointBox(low, high, best.back, full_turn)


def _bounds(space: JointSpace, forward: Array) -> tuple[Array, Array]:
    """Smallest and largest value of each component of forward q over all admissible q."""
    bounds = list(zip(space.lower.tolist(), space.upper.tolist(), strict=True))
    rows = {"A_ub": -space.rows, "b_ub": -space.row_lower} if len(space.row_lower) else {}
    low, high = (
        np.array([sign * scipy.optimize.linprog(sign * row, bounds=bounds, **rows).fun for row in forward])
        for sign in (1.0, -1.0)
    )
    return low, np.maximum(low, high)


SAMPLES, HEAD, FAILURES = "samples.npy", "workspace.json", "failures.jsonl"


@typed
@limited
def workspace(
    robot: Robot,
    samples: Annotated[int, Range(minimum=1)] = 10_000,
    *,
    method: Annotated[str, OneOf(METHODS)] = "sobol",
    seed: Annotated[int, Range(minimum=0)] = 0,
    out: str | PathLike[str] | None = None,
    workers: Annotated[int, Range(minimum=0)] = 1,
    progress: Progress | None = None,
    time_limit: float = LONG_TIME_LIMIT,
) -> Workspace:
    """Tip positions and stability margins at many joint values within `robot.limits`.

    The joint values keep the order of carriages and ends (see `inverse.joints.joint_space`) and cover the allowed set
    evenly. Rotations cover one turn where the limits include one, since the shape repeats. Each configuration is solved
    alone, without a start: its equilibrium is stable, and the one of `forward_kinematics`.

    Args:
        samples: number of sampled configurations. A grid has as many points per axis as this allows, less those out of
            order.
        method: sampling method: sobol, random or grid. Scrambled Sobol points are the most even.
        seed: random seed of random and Sobol samples. The same seed gives the same joint values.
        out: directory for the results, which are appended, so that memory does not grow with N. A run that was stopped
            there continues.
        workers: number of threads; 0 for one per core.
        progress: called with the samples done and their number.
        time_limit: maximum run time, s.

    Raises:
        InputError: no number of samples, unknown method, limits that leave nothing, or a directory that contains
            another workspace, is in use or cannot be written.
        TimeLimitError: (a SolveError) the time limit was reached before there was an answer.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/two_tube.yaml")
        >>> tubeopt.workspace(robot, 100).tip_position.shape
        (100, 3)
    """
    drawn = JointSamples(robot, method, samples, seed)
    count = sum(len(rotations) for rotations, _ in drawn.blocks()) if method == "grid" else samples
    if not count:
        raise InputError(f"samples is {samples}; no point of such a coarse grid satisfies the tube order")
    sink = _Memory(robot, count) if out is None else _Disk(robot, count, Path(out), _spec(robot, method, seed, count))
    with closing(sink):
        done = sink.done
        if progress is not None:
            progress(done, count)
        for alpha, shift in _after(drawn.blocks(), done):
            batch = forward_kinematics_batch(robot, alpha, shift, workers=workers)
            rows = np.column_stack([alpha, shift, batch.tip_position, batch.tip_rotation[:, :, 2], batch.margin])
            sink.append(rows, [(done + row, reason) for row, reason in batch.failures])
            done += len(rows)
            if progress is not None:
                progress(done, count)
    return Workspace(robot, method, seed, *sink.result())


@typed
def load_workspace(robot: Robot, directory: str | PathLike[str]) -> Workspace:
    """The workspace of `robot` that `workspace(..., out=directory)` saved, with its table on disk.

    Raises:
        InputError: no workspace in the directory, one of another robot, or an unfinished one.

    Examples:
        >>> import tempfile
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/two_tube.yaml")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     found = tubeopt.workspace(robot, 50, out=folder)
        ...     len(tubeopt.load_workspace(robot, folder))
        50
    """
    directory = Path(directory)
    head = _head(directory)
    if head["robot_sha256"] != _mark(robot):
        raise InputError(f"{directory}: the workspace there is of another robot")
    table, failures = _stored(directory, head["samples"], width(robot.n_tubes))
    return Workspace(robot, head["method"], head["seed"], table, failures)


def save_workspace(workspace: Workspace, directory: str | PathLike[str]) -> list[Path]:
    """Write a workspace into a directory, as `workspace(..., out=directory)` leaves it, and return the paths.

    One that lies in that directory already is left as it is.

    Raises:
        InputError: the directory cannot be written.
    """
    directory = Path(directory)
    paths = [directory / SAMPLES, directory / HEAD]
    table = workspace.table
    if isinstance(table, np.memmap) and table.filename and Path(table.filename).resolve() == paths[0].resolve():
        return paths
    write_text(directory / FAILURES, "".join(json.dumps(failure) + "\n" for failure in workspace.failures))
    with atomic_write(paths[0]) as temporary:
        np.save(temporary, np.asarray(table, dtype="<f8"))
    write_text(
        paths[1], json.dumps(_spec(workspace.robot, workspace.method, workspace.seed, len(workspace)), indent=2) + "\n"
    )
    if not workspace.failures:
        (directory / FAILURES).unlink()
    return paths


def _after(blocks: Iterator[tuple[Array, Array]], done: int) -> Iterator[tuple[Array, Array]]:
    """Blocks without the first rows."""
    for alpha, shift in blocks:
        skip = min(done, len(alpha))
        done -= skip
        if skip < len(alpha):
            yield alpha[skip:], shift[skip:]


def _mark(robot: Robot) -> str:
    """Hash of all data of a robot on which joint values and equilibria depend."""
    return hashlib.sha256(in_full((type(robot).__name__, robot)).encode()).hexdigest()


def _spec(robot: Robot, method: str, seed: int, count: int) -> dict[str, Any]:
    return {
        "robot": robot.name,
        "robot_sha256": _mark(robot),
        "method": method,
        "seed": int(seed),
        "samples": int(count),
        "columns": _columns(robot.n_tubes),
    }


def _columns(n: int) -> list[str]:
    joints = [f"{kind}_{i}" for kind in ("rotation", "translation") for i in range(1, n + 1)]
    tip = [f"tip_{what}_{axis}" for what in ("position", "direction") for axis in "xyz"]
    return [*joints, *tip, "margin"]


class _Memory:
    """A table in memory."""

    def __init__(self, robot: Robot, count: int) -> None:
        self.done = 0
        self._table = np.full((count, width(robot.n_tubes)), np.nan)
        self._failures: list[tuple[int, str]] = []

    def close(self) -> None:
        """Do nothing: no file is open."""

    def append(self, rows: Array, failures: list[tuple[int, str]]) -> None:
        """Append rows and failures."""
        self._table[self.done : self.done + len(rows)] = rows
        self._failures += failures
        self.done += len(rows)

    def result(self) -> tuple[Array, tuple[tuple[int, str], ...]]:
        """The table and the failures."""
        return self._table, tuple(self._failures)


class _Disk:
    """Table in a .npy file that grows by whole rows, which are kept if the run is killed."""

    def __init__(self, robot: Robot, count: int, directory: Path, spec: dict[str, Any]) -> None:
        self._directory, self._count, self._width = directory, count, width(robot.n_tubes)
        path = directory / SAMPLES
        if (directory / HEAD).exists():
            if _head(directory) != spec:
                raise InputError(f"{directory}: it has the workspace of another robot or of other samples")
        elif path.exists():
            raise InputError(f"{path}: it exists, but {HEAD} is missing; give another directory")
        else:
            write_text(directory / HEAD, json.dumps(spec, indent=2) + "\n")
        try:
            self._file: BinaryIO = path.open("a+b")
        except OSError as error:
            raise InputError(f"{directory}: cannot be written: {error.strerror or error}") from error
        try:
            lock(self._file, path)
            self.done = self._cut_to_whole_rows()
        except BaseException:  # also where a signal comes: no file stays open and locked
            self._file.close()
            raise

    def _cut_to_whole_rows(self) -> int:
        """Number of complete rows, after an incomplete row is cut off; a missing file header is written."""
        size = self._file.seek(0, os.SEEK_END)
        self._file.seek(0)
        try:
            np.lib.format.read_magic(self._file)
            np.lib.format.read_array_header_1_0(self._file)
            start = self._file.tell()
        except ValueError:
            self._file.truncate(0)
            # The header states the final number of rows, so that the complete file is an ordinary .npy file.
            shape = {"descr": "<f8", "fortran_order": False, "shape": (self._count, self._width)}
            np.lib.format.write_array_header_1_0(self._file, shape)
            self._file.flush()
            return 0
        # Eight bytes per number; a run that was killed may leave part of a row.
        rows = min((size - start) // (8 * self._width), self._count)
        self._file.truncate(start + rows * 8 * self._width)
        return rows

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def append(self, rows: Array, failures: list[tuple[int, str]]) -> None:
        """Append rows, which are on disk when this returns; failures are written before their rows."""
        try:
            if failures:
                with (self._directory / FAILURES).open("a", encoding="utf-8") as file:
                    file.writelines(json.dumps(failure) + "\n" for failure in failures)
                    file.flush()
                    os.fsync(file.fileno())
            self._file.write(np.ascontiguousarray(rows, dtype="<f8").tobytes())
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError as error:
            raise InputError(f"{self._directory}: cannot be written: {error.strerror or error}") from error
        self.done += len(rows)

    def result(self) -> tuple[Array, tuple[tuple[int, str], ...]]:
        """The table, on disk, and the failures."""
        return _stored(self._directory, self._count, self._width)


def _head(directory: Path) -> dict[str, Any]:
    """Content of `_spec` of the workspace in a directory."""
    try:
        head = json.loads(read_bytes(directory / HEAD))
    except ValueError:
        head = None
    if not isinstance(head, dict) or not {"robot_sha256", "method", "seed", "samples"} <= head.keys():
        raise InputError(f"{directory / HEAD}: is damaged; give another directory, or delete the workspace there")
    return head


def _stored(directory: Path, count: int, columns: int) -> tuple[Array, tuple[tuple[int, str], ...]]:
    path = directory / SAMPLES
    try:
        table = np.load(path, mmap_mode="r", allow_pickle=False)
    except (OSError, EOFError, ValueError):
        raise InputError(f"{path}: it is missing or not finished; compute the workspace again to resume") from None
    if table.shape != (count, columns):
        raise InputError(f"{path}: has the shape {table.shape}; it must be {(count, columns)}")
    return table, _read_failures(directory / FAILURES)


def _read_failures(path: Path) -> tuple[tuple[int, str], ...]:
    """Failures by row, without repetitions and without an incomplete last line."""
    if not path.exists():
        return ()
    failures = {}
    for line in read_bytes(path).decode("utf-8", errors="replace").splitlines():
        try:
            row, reason = json.loads(line)
        except ValueError:
            continue
        failures[int(row)] = str(reason)
    return tuple(sorted(failures.items()))
