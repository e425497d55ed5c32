"""Compiled kernel on NumPy arrays: one configuration, or many."""

from __future__ import annotations

import ctypes
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...block.transcription.arm import ArmSolution, CollocationPoints, Errors
from ...block.transcription.collocated import SHAPE_STEPS
from ...robots.assembly import LENGTH_ROUND_OFF
from ...robots.lengthwise import Lengthwise, lengthwise
from ...robots.robot import Robot
from ...typing import Array, Mask
from ..time_limit import check_time
from .constants import DEGREE
from .library import MOST_TUBES, Kernel, abreast_library, copied_shape, library

SOLVED = 0

SAME_ARM = 1e-9
"""Largest difference of rotations of one equilibrium, rad."""

Carriages = tuple[tuple[int, ...], ...]
"""Tubes, from 0, on each carriage."""


class Moved(NamedTuple):
    """Directions of translations for one-sided derivatives."""

    sides: tuple[int, ...]
    """Direction of each tube, 1 or -1."""
    carriages: Carriages
    """Tubes that move together."""


class _Guess(ctypes.Structure):
    _fields_ = (
        ("count", ctypes.c_longlong),
        ("points", ctypes.c_longlong),
        ("apart", ctypes.c_longlong),
        ("next", ctypes.c_longlong),
        *((name, ctypes.c_void_p) for name in ("s", "rotation", "torsion", "point", "point_rotation", "turn", "shift")),
    )


class Start(NamedTuple):
    """Start of a solve from another equilibrium."""

    arc_length: Array
    """Arc lengths (m,) of the arm of the start, m."""
    rotation: Array
    """Rotations (n, m) at the arc lengths of the arm, rad."""
    torsion: Array
    """Torsion (n, m) at the arc lengths of the arm, rad/m."""
    point: Array
    """Arc lengths (N,) of its collocation points, m."""
    point_rotation: Array
    """Rotations (N, n) at the collocation points, rad."""
    turn: Array
    """Rotations (n,) to add, rad."""
    translations: Array
    """Translations (n,) at the start, m."""


@dataclass(eq=False)
class _Memory:
    """Memory of one thread for one kernel."""

    workspace: Array
    """Working memory of the kernel."""
    fields: dict[str, Any]
    """Answer of the kernel by field: arrays, which the next call overwrites, and numbers, set by `answer`."""
    numbers: Any
    """Numbers of the answer, as a structured scalar."""
    addresses: tuple[int, int]
    """Addresses of workspace and answer."""
    solved: tuple[Any, bytes] | None = None
    """Tubes and joint values of the solution in the workspace, or None."""

    def answer(self) -> dict[str, Any]:
        """Last answer of the kernel by field; arrays are overwritten by the next call."""
        self.fields.update(zip(self.numbers.dtype.names, self.numbers.item(), strict=True))
        return self.fields

    def has(self, tubes: Any, joints: bytes, start: Start) -> bool:
        """True if the memory contains the solution of `start` for some tubes at joint values."""
        if self.solved is None or self.solved[0] is not tubes or self.solved[1] != joints:
            return False
        count = len(start.point)
        solution = self.fields["point_rotation"][:count]
        return self.fields["points"] == count and bool(solution.tobytes() == start.point_rotation.tobytes())


_memories = threading.local()


def memory_of(kernel: Kernel) -> _Memory:
    """Memory of this thread for a kernel."""
    memories: dict[Any, _Memory] = _memories.__dict__
    if kernel not in memories:
        answer = np.zeros((), kernel.answer)
        names = kernel.answer.names or ()
        numbers = [name for name in names if not kernel.answer[name].shape]
        fields = {name: answer[name] for name in names if name not in numbers}
        workspace = np.zeros(kernel.workspace_size // 8 + 1)
        memories[kernel] = _Memory(
            workspace, fields, answer[numbers] if numbers else answer, (address(workspace), address(answer))
        )
    return memories[kernel]


LANES = 8
"""Numbers per coefficient of a table in the kernel's order: it evaluates four polynomials at once."""


class _Pieces(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_longlong) for name in ("most", "width", "most_cuts")),
        *((name, ctypes.c_void_p) for name in ("breaks", "coefficients", "count", "direction", "bent", "detail")),
        *((name, ctypes.c_void_p) for name in ("twist", "compliance", "cuts")),
        ("refinement", ctypes.c_longlong),
    )


def piece_tables(table: Lengthwise) -> dict[str, Array]:
    """Tables of the C struct Pieces by name, in its order.

    The first are breaks (n, panels + 1) and coefficients (n, panels, width, LANES); the last are cuts (n, largest
    number of cuts). Where a tube bends in one plane, its bend is one signed quantity of constant direction.
    """
    lanes = np.zeros((*table.direction.shape, table.coefficients.shape[-1], LANES))
    channels = lanes[..., :5]
    channels[:] = table.coefficients[:, :, [0, 1, 2, 3, 5]].swapaxes(-1, -2)
    turned = np.isfinite(table.direction) & (table.direction != 0)
    if turned.any():
        angle = table.direction[turned][:, None]
        channels[turned, :, 2] = np.cos(angle) * channels[turned, :, 2] + np.sin(angle) * channels[turned, :, 3]
    order = np.arange(1.0, lanes.shape[2] + 1)[:, None]
    count = np.maximum(1.0, ((channels != 0) * order).max(2))
    count = np.concatenate([count, count[:, :, :4].max(-1, keepdims=True)], axis=-1)
    cuts = np.full((table.n_tubes, max(map(len, table.cuts))), np.inf)
    for row, tube_cuts in zip(cuts, table.cuts, strict=True):
        row[: len(tube_cuts)] = tube_cuts
    arrays = [table.breaks, lanes, count, table.direction, table.bent.astype(float), table.detail, table.twist]
    arrays += [np.ascontiguousarray(table.compliance[:, :-1]), cuts]
    return dict(zip((field[0] for field in _Pieces._fields_[3:-1]), arrays, strict=True))


class PieceSizes(NamedTuple):
    """Sizes of `piece_tables`."""

    panels: int
    """Number of panels per tube."""
    coefficients: int
    """Number of coefficients per panel."""
    cuts: int
    """Number of cuts per tube."""


def piece_sizes(tables: Mapping[str, Array]) -> PieceSizes:
    """Sizes of `piece_tables`, in the order of the C struct Pieces."""
    _, panels, coefficients, _ = tables["coefficients"].shape
    return PieceSizes(panels, coefficients, tables["cuts"].shape[1])


def tube_rows(robot: Robot) -> Array:
    """Numbers (5, n) of the C struct Tubes for a robot.

    GJ is 0 for tubes made of pieces, since it varies along them.
    """
    home = robot.assembly(robot.home_translations)
    stiffness = np.zeros(robot.n_tubes) if home.general else home.torsional_stiffness
    lengths = [tube.straight_length for tube in robot.tubes], [tube.length for tube in robot.tubes]
    return np.array([stiffness, *lengths, home.offset, home.offset_angle])


def _tubes(robot: Robot, refinement: int) -> tuple[Array, Any]:
    """C struct Tubes of a robot on a mesh halved `refinement` times, and its struct Pieces."""
    tables = piece_tables(lengthwise(robot.tubes))
    pieces: Any = _Pieces(*piece_sizes(tables), *(address(array) for array in tables.values()), refinement)
    pieces.keep = tables  # the structure points into them
    tubes = np.append(tube_rows(robot), [0.0, 0.0])
    tubes[-2:].view(np.int64)[:] = robot.assembly(robot.home_translations).eccentric, ctypes.addressof(pieces)
    return tubes, pieces


@lru_cache(maxsize=64)
def kernel_of(robot: Robot) -> Kernel | None:
    """Compiled kernel for a robot; None if it does not exist."""
    if robot.n_tubes > MOST_TUBES or not robot.fixed_sections:
        return None
    return library(robot.n_tubes, robot.assembly(robot.home_translations).eccentric)


class Prepared(NamedTuple):
    """Kernel with the tubes of a robot."""

    kernel: Kernel
    tubes: Any
    """C structs of the tubes, which must live as long as their address is used."""
    address: int
    """Address of the C struct Tubes."""


@lru_cache(maxsize=64)
def with_kernel(robot: Robot, refinement: int = 0) -> Prepared | None:
    """Kernel of a robot with its tubes on a mesh halved `refinement` times; None without a kernel."""
    kernel = kernel_of(robot)
    if kernel is None:
        return None
    tubes = _tubes(robot, refinement)
    return Prepared(kernel, tubes, address(tubes[0]))


def aligned(size: int) -> NDArray[np.uint8]:
    """Zeros (size,) at an address that is a multiple of 64, as vectors of numbers need."""
    memory = np.zeros(size + 64, dtype=np.uint8)
    return memory[-address(memory) % 64 :][:size]


def address(array: NDArray[Any]) -> int:
    """Address of the data of an array."""
    return int(array.ctypes.data)


def _writable_address(array: Any) -> int:
    """Address of an array that is writable and not empty, in a third of the time of `address`."""
    return ctypes.addressof(ctypes.c_double.from_buffer(array))


class _Inputs(NamedTuple):
    """Arguments of a solve in one array, since each address from NumPy costs a microsecond."""

    memory: Array
    rotations: int
    """Address of the rotations."""
    translations: int
    """Address of the translations."""
    guess: Any
    """Reference to the C struct Guess, or None."""


def _inputs(rotations: Array, translations: Array, start: Start | None) -> _Inputs:
    """Arguments of a solve at joint values (n,)."""
    parts = [rotations, translations]
    if start is not None:
        parts += [start.arc_length, start.rotation, start.torsion, start.point, start.point_rotation, start.turn]
        parts.append(start.translations)
    flat = np.concatenate(parts, axis=None)
    addresses = [_writable_address(flat)]
    for part in parts:
        addresses.append(addresses[-1] + 8 * part.size)
    if start is None:
        return _Inputs(flat, addresses[0], addresses[1], None)
    count = len(start.arc_length)
    guess = _Guess(count, len(start.point), count, 1, *addresses[2:-1])
    return _Inputs(flat, addresses[0], addresses[1], ctypes.byref(guess))


class Solved(NamedTuple):
    """Equilibrium from the kernel."""

    solution: ArmSolution
    elements: int
    """Number of elements of the mesh."""
    largest_change: float
    """Largest change of a twist from the start, rad."""
    contraction: float
    """Largest ratio of successive Newton steps."""
    loading: float
    """Time to load the kernel, s."""


def solve_compiled(
    robot: Robot, rotations: Array, translations: Array, start: Start | None = None, refinement: int = 0
) -> Solved | None:
    """Stable equilibrium at joint values (n,), on a mesh halved `refinement` times.

    None if the kernel does not solve it, or if there is no kernel.
    """
    start_time = time.perf_counter()
    prepared = with_kernel(robot, refinement)
    if prepared is None:
        return None
    loading = time.perf_counter() - start_time
    answer = _solve(prepared, rotations, translations, start)
    if answer is None:
        return None
    elements, change, ratio = answer["elements"], answer["largest_change"], answer["contraction"]
    return Solved(_solution(answer), elements, change, ratio, loading)


def _solution(answer: dict[str, Any]) -> ArmSolution:
    """Copy of the solution in an answer."""
    m, points = answer["pieces"] * SHAPE_STEPS + 1, answer["points"]
    return ArmSolution(
        copied_shape(answer, m),
        tip_rotations=answer["tip_rotations"].copy(),
        section_start=answer["section_start"][: answer["sections"]].copy(),
        tube_end=answer["tube_end"].copy(),
        points=CollocationPoints(answer["point"][:points].copy(), answer["point_rotation"][:points].copy()),
        margin=answer["margin"],
        energy=answer["energy"],
        residual=answer["residual"],
        errors=Errors(answer["mesh_error"], answer["tip_error"], 0.0),
        iterations=answer["iterations"],
    )


def _solve(prepared: Prepared, rotations: Array, translations: Array, start: Start | None) -> dict[str, Any] | None:
    """Fields of the C struct Answer, which the next call overwrites; None if the kernel does not solve it."""
    check_time()
    memory, inputs = memory_of(prepared.kernel), _inputs(rotations, translations, start)
    status = prepared.kernel.functions.solve(
        prepared.address, inputs.rotations, inputs.translations, inputs.guess, *memory.addresses
    )
    memory.solved = (prepared, inputs.memory[: 2 * len(rotations)].tobytes()) if status == SOLVED else None
    return memory.answer() if status == SOLVED else None


class Slopes(NamedTuple):
    """Derivatives of a solved arm by its Q = 2n rotations and translations."""

    position: Array
    """Derivative (3, Q) of the tip position."""
    turn: Array
    """Derivative (3, Q) of the rotation vector of the tip."""
    tip_rotations: Array
    """Derivative (n, Q) of the rotations at the ends of the tubes."""
    margin: Array
    """Derivative (Q,) of the margin."""
    energy: Array
    """Derivative (Q,) of the elastic energy."""
    compliance: Array | None
    """Compliance (6, 6) of the tip without load, if requested."""
    along: Array | None
    """Derivatives (m, 3, Q) of shape points at fixed arc lengths, the last at the tip; None if the meshes differ."""
    deviation: float
    """Largest difference of the rotations from the start's, rad; infinite if the meshes differ."""
    dimensions: Array | None = None
    """Derivatives (8 + n, 5 n) by DIMENSIONS, if requested: tip position, turn, tip rotations, margin and energy.

    Those by curvatures and stiffnesses are by relative changes.
    """


def slopes_compiled(  # noqa: PLR0913
    robot: Robot,
    rotations: Array,
    translations: Array,
    start: Start,
    moved: Moved,
    refinement: int,
    *,
    compliance: bool = False,
    either: bool = True,
    dimensions: bool = False,
) -> Slopes | None:
    """Derivatives of the equilibrium at joint values (n,), solved from a start close to it.

    None if the kernel does not solve it, or if there is no kernel; the kernel must be `differentiable`.

    Args:
        moved: directions of translations, which decide where breakpoints coincide; ends of tubes move in the first
            one.
        refinement: halvings of the mesh.
        compliance: also compute the compliance of the tip.
        either: for a margin of two modes, return the derivative by either of them; False returns NaN.
        dimensions: also compute the derivatives by dimensions of tubes that each have one curvature.
    """
    prepared = with_kernel(robot, refinement)
    if prepared is None:
        return None
    kernel, n = prepared.kernel, robot.n_tubes
    memory, deviation = memory_of(kernel), _at_hand(prepared, rotations, translations, start)
    if deviation is None:
        return None
    points = memory.fields["pieces"] * SHAPE_STEPS + 1
    # Output of the kernel: a table (7 + n, 2 n), compliance, derivative of the energy; then the shape points.
    size = 2 * n * (8 + n) + 36
    out = np.empty(size + points * 6 * n)
    at = _writable_address(out)
    if not kernel.functions.differentiate(_request(moved, compliance, either)[1], *memory.addresses, at, at + 8 * size):
        return None
    columns = None
    if dimensions:
        columns = np.empty((5 * n, 8 + n))
        varied = np.empty(kernel.functions.varied_size() // 8 * memory.fields["pieces"] * DEGREE)
        places = _writable_address(varied), _writable_address(columns)
        kernel.functions.differentiate_dimensions(*memory.addresses, moved.sides[0], *places)
    end = size - 36 - 2 * n
    table = out[:end].reshape(7 + n, 2 * n)
    return Slopes(
        position=table[:3],
        turn=table[3:6],
        tip_rotations=table[6:-1],
        margin=table[-1],
        compliance=out[end : end + 36].reshape(6, 6) if compliance else None,
        energy=out[end + 36 : size],
        along=out[size:].reshape(points, 3, 2 * n) if deviation < np.inf else None,
        deviation=deviation,
        dimensions=None if columns is None else columns.T,
    )


def _at_hand(prepared: Prepared, rotations: Array, translations: Array, start: Start) -> float | None:
    """Solve the equilibrium at joint values (n,) from a close start and leave it in the memory of the kernel.

    Largest difference of its rotations from those of the start, rad, infinite if the meshes differ; None if the kernel
    does not solve it.
    """
    memory = memory_of(prepared.kernel)
    if memory.has(prepared, rotations.tobytes() + translations.tobytes(), start):
        return 0.0
    if _solve(prepared, rotations, translations, start) is None:
        return None
    points = memory.fields["pieces"] * SHAPE_STEPS + 1
    s, rotation = memory.fields["arc_length"][:points], memory.fields["rotation"][:points].T
    if points != len(start.arc_length) or not np.abs(s - start.arc_length).max() <= LENGTH_ROUND_OFF:
        return np.inf
    return float(np.abs(rotation - start.rotation).max())


def _prepared_at(robot: Robot, rotations: Array, translations: Array, start: Start, refinement: int) -> Prepared | None:
    """Kernel with the equilibrium of `start` in its memory; None without derivatives, or if it solves another one."""
    prepared = with_kernel(robot, refinement)
    if prepared is None or not prepared.kernel.differentiable:
        return None
    deviation = _at_hand(prepared, rotations, translations, start)
    return None if deviation is None or deviation > SAME_ARM else prepared


class Turn(NamedTuple):
    """Snap distance by the kernel."""

    turn: float
    """Largest turn of all tubes that is proved to cause no snap, rad; inf if no turn can snap."""
    couplings: int
    """Number of coupled pairs, summed over the collocation points."""


def turn_compiled(
    robot: Robot,
    rotations: Array,
    translations: Array,
    start: Start,
    refinement: int,
    *,
    most: float,
    precision: float,
) -> Turn | None:
    """Snap distance of the equilibrium at joint values (n,), given by `start`; None without a kernel for it.

    Args:
        most: largest turn that is searched, rad.
        precision: relative precision of the turn.
    """
    prepared = _prepared_at(robot, rotations, translations, start, refinement)
    if prepared is None:
        return None
    couplings = ctypes.c_longlong()
    workspace = memory_of(prepared.kernel).addresses[0]
    turn = prepared.kernel.functions.snap_distance(workspace, most, precision, ctypes.byref(couplings))
    return Turn(turn, couplings.value) if turn >= 0 else None


class Reach(NamedTuple):
    """Set of joint motions, to be scaled: all tubes at once, each either way."""

    turn: float
    """Largest turn, rad."""
    slide: float
    """Largest slide, m."""


def motion_compiled(
    robot: Robot,
    rotations: Array,
    translations: Array,
    start: Start,
    refinement: int,
    reach: Reach,
    *,
    most: float,
    precision: float,
) -> float | None:
    """Largest factor on `reach` at which it is proved that nothing snaps.

    None without a kernel for the equilibrium at joint values (n,), given by `start`.

    Args:
        most: largest factor that is searched.
        precision: relative precision of the factor.
    """
    prepared = _prepared_at(robot, rotations, translations, start, refinement)
    if prepared is None:
        return None
    joints = np.stack([rotations, translations]).astype(float)
    arrays = *memory_of(prepared.kernel).addresses, prepared.address, address(joints[0]), address(joints[1])
    result = float(prepared.kernel.functions.motion_distance(*arrays, *reach, most, precision))
    return result if result >= 0 else None


@lru_cache(maxsize=256)
def _request(moved: Moved, compliance: bool, either: bool) -> tuple[NDArray[np.int64], int]:
    """C struct Asked, (2 n + 2,), with the requested derivatives, and its address."""
    n = len(moved.sides)
    out = np.zeros(2 * n + 2, dtype=np.int64)
    for k, tubes in enumerate(moved.carriages):
        out[list(tubes)] = k
    out[n:-2], out[-2:] = moved.sides, (compliance, either)
    return out, address(out)


def solve_many_compiled(
    robot: Robot, rotations: Array, translations: Array, arms: Array | None = None, refinement: int = 0
) -> tuple[Array, Mask] | None:
    """Cold solves at joint values (N, n): table (N, 17 + n), and mask (N,) of unsolved rows; None without a kernel.

    A row has tip position (3), tip frame by rows (9), tip rotations (n), margin, residual, mesh error, tip error and
    energy. Rotations and torsion at the m points of the arms are written to `arms` (N, 2, m, n), if it is given; all
    arms must have m points. Other Python threads run meanwhile.
    """
    check_time()
    prepared = with_kernel(robot, refinement)
    if prepared is None:
        return None
    memory, count = memory_of(prepared.kernel), len(rotations)
    memory.solved = None
    alpha, shift = (np.ascontiguousarray(a, dtype=float) for a in (rotations, translations))
    table, unsolved = np.zeros((count, 17 + robot.n_tubes)), np.ones(count, dtype=np.uint8)
    side_by_side = abreast_library(robot.n_tubes) if arms is None and prepared.kernel.differentiable else None
    if side_by_side is not None:
        jobs, room = np.zeros((count, 4), dtype=np.int64), aligned(side_by_side.workspace_size)
        arrays = (alpha, shift, table, unsolved, jobs, room)
        side_by_side.functions.solve_abreast(prepared.address, count, *(address(a) for a in arrays))
    rows = np.flatnonzero(unsolved)
    left, again = np.zeros((len(rows), table.shape[1])), np.zeros(len(rows), dtype=np.uint8)
    inputs = alpha[rows], shift[rows]
    points = (0, None) if arms is None else (arms.shape[2], address(arms))
    places = [address(a) for a in (*inputs, left, again)]
    prepared.kernel.functions.solve_many(prepared.address, len(rows), *places, *points, *memory.addresses)
    table[rows], unsolved[rows] = left, again
    return table, unsolved.astype(bool)


class Branches:
    """Equilibria of many robots of one kernel, each followed on its branch."""

    def __init__(self, robot: Robot, count: int) -> None:
        """Raises LookupError if there is no kernel."""
        kernel = kernel_of(robot)
        if kernel is None:
            raise LookupError("there is no compiled kernel")
        self._kernel = kernel
        self._tubes = [_tubes(robot, 0)] * count
        self._addresses = np.full(count, address(self._tubes[0][0]), dtype=np.uintp)
        self._arms, self._spare = np.zeros(count, kernel.answer), np.zeros(2, kernel.answer)
        self._workspace = np.zeros(kernel.workspace_size // 8 + 1)
        self._abreast = abreast_library(robot.n_tubes) if kernel.differentiable else None
        if self._abreast is not None:
            self._room = aligned(self._abreast.workspace_size)
            self._jobs = np.empty((count, 4), dtype=np.int64)
            self._kept = np.zeros(count, kernel.answer)
        self.rotations, self.translations = np.zeros((2, count, robot.n_tubes))
        """(N, n) joint values of the equilibria, rad and m."""

    def use(self, row: int, robot: Robot) -> None:
        """Give a row another robot of the same kernel, before its cold solve."""
        self._tubes[row] = _tubes(robot, 0)
        self._addresses[row] = address(self._tubes[row][0])

    def go(self, rotations: Array, translations: Array, cold: Mask) -> Mask:
        """(N,) rows without an equilibrium after a straight motion to joint values (N, n), or `cold` (N,) at them.

        Such a row stays as it was; after a motion it has lost its branch, as at a snap.
        """
        check_time()
        to = [np.ascontiguousarray(a, dtype=float) for a in (rotations, translations)]
        lost, requested = np.zeros(len(cold), dtype=np.uint8), np.ascontiguousarray(cold, dtype=np.uint8)
        first = (self.rotations, self.translations, *to, requested, self._arms)
        places = [address(self._addresses), len(cold), *map(address, first)]
        if self._abreast is not None:  # rows that it moves are at rest for the other kernel
            room = address(self._jobs), address(self._kept), address(self._room)
            self._abreast.functions.follow_abreast(*places, *room)
        self._kernel.functions.follow_many(*places, address(lost), address(self._workspace), address(self._spare))
        return lost.astype(bool)

    @property
    def tips(self) -> Array:
        """(N, 3) tip positions, m."""
        last = self._arms["pieces"] * SHAPE_STEPS
        return np.asarray(self._arms["position"][np.arange(len(last)), last])

    @property
    def margins(self) -> Array:
        """(N,) stability margins."""
        return np.asarray(self._arms["margin"])
