"""The compiled kernel on NumPy arrays: one configuration, or many."""

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

from ...block.transcription.arm import ArmShape, ArmSolution, CollocationPoints
from ...block.transcription.collocated import STEPS
from ...robots.assembly import ROUND_OFF
from ...robots.lengthwise import Lengthwise, lengthwise
from ...robots.robot import Robot
from ...typing import Array, Mask
from ..time_limit import check_time
from .library import MOST_TUBES, Kernel, library

SOLVED = 0

Carriages = tuple[tuple[int, ...], ...]
"""Tubes, from 0, that each of them moves."""


class Moved(NamedTuple):
    """How translations move: each tube towards its side, 1 or -1, and those of one carriage together."""

    sides: tuple[int, ...]
    carriages: Carriages


class _Guess(ctypes.Structure):
    _fields_ = (
        ("count", ctypes.c_longlong),
        ("points", ctypes.c_longlong),
        ("apart", ctypes.c_longlong),
        ("next", ctypes.c_longlong),
        *((name, ctypes.c_void_p) for name in ("s", "rotation", "torsion", "point", "point_rotation", "turn", "shift")),
    )


class Start(NamedTuple):
    """Where to start from: rotation and torsion (n, m) of another arm at arc_length (m,), its solution at collocation
    points (N,), (N, n), the turn (n,) to add, and its translations (n,)."""

    arc_length: Array
    rotation: Array
    torsion: Array
    point: Array
    point_rotation: Array
    turn: Array
    translations: Array


@dataclass(eq=False)
class _Room:
    """Memory of one thread for one kernel: what it works in; the arrays of its answer by field, and its numbers, which
    `answer` adds as Python's; where both are; and of which tubes, at which joint values, it still holds the solution,
    None where of none."""

    workspace: Array
    fields: dict[str, Any]
    numbers: Any
    at: tuple[int, int]
    solved: tuple[Any, bytes] | None = None

    def answer(self) -> dict[str, Any]:
        """What the kernel has just answered, by field; arrays are overwritten by the next call."""
        self.fields.update(zip(self.numbers.dtype.names, self.numbers.item(), strict=True))
        return self.fields

    def has(self, tubes: Any, joints: bytes, start: Start) -> bool:
        """Whether it holds that of tubes at joint values which a start is."""
        if self.solved is None or self.solved[0] is not tubes or self.solved[1] != joints:
            return False
        count = len(start.point)
        mine = self.fields["point_rotation"][:count]
        return self.fields["points"] == count and bool(mine.tobytes() == start.point_rotation.tobytes())


_rooms = threading.local()


def room_of(kernel: Kernel) -> _Room:
    """Memory of this thread for a kernel."""
    rooms: dict[Any, _Room] = _rooms.__dict__
    if kernel not in rooms:
        answer = np.zeros((), kernel.answer)
        names = kernel.answer.names or ()
        numbers = [name for name in names if not kernel.answer[name].shape]
        fields = {name: answer[name] for name in names if name not in numbers}
        workspace = np.zeros(kernel.workspace_size // 8 + 1)
        rooms[kernel] = _Room(
            workspace, fields, answer[numbers] if numbers else answer, (address(workspace), address(answer))
        )
    return rooms[kernel]


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
    """The tables of the C struct Pieces by name, in its order: breaks (n, panels + 1), coefficients (n, panels, width,
    LANES), and so on, the last of them cuts (n, most cuts). In a plane of the tube the bend is one signed quantity,
    whose direction is constant."""
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
    cuts = np.full((table.n_tubes, max(len(own) for own in table.cuts)), np.inf)
    for row, own in zip(cuts, table.cuts, strict=True):
        row[: len(own)] = own
    arrays = [table.breaks, lanes, count, table.direction, table.bent.astype(float), table.detail, table.twist]
    arrays += [np.ascontiguousarray(table.compliance[:, :-1]), cuts]
    return dict(zip((field[0] for field in _Pieces._fields_[3:-1]), arrays, strict=True))


def piece_sizes(tables: Mapping[str, Array]) -> tuple[int, int, int]:
    """Panels and coefficients per tube, and cuts per tube, of `piece_tables`."""
    return tables["coefficients"].shape[1], tables["coefficients"].shape[2], tables["cuts"].shape[1]


def _pieces(table: Lengthwise, refinement: int) -> Any:
    """The C struct Pieces of a mesh that is halved `refinement` times."""
    tables = piece_tables(table)
    out: Any = _Pieces(*piece_sizes(tables), *(address(array) for array in tables.values()), refinement)
    out.keep = tables  # the structure points into them
    return out


def tube_rows(robot: Robot) -> Array:
    """(5, n) numbers of the C struct Tubes of a robot; of tubes made of pieces, GJ is 0: it varies along them."""
    home = robot.assembly(robot.home_translations)
    stiffness = np.zeros(robot.n_tubes) if home.general else home.torsional_stiffness
    lengths = [tube.straight_length for tube in robot.tubes], [tube.length for tube in robot.tubes]
    return np.array([stiffness, *lengths, home.offset, home.offset_angle])


def _tubes(robot: Robot, refinement: int) -> tuple[Array, Any]:
    """The C struct Tubes of a robot, and the struct Pieces to which it points."""
    pieces = _pieces(lengthwise(robot.tubes), refinement)
    tubes = np.append(tube_rows(robot), [0.0, 0.0])
    tubes[-2:].view(np.int64)[:] = robot.assembly(robot.home_translations).eccentric, ctypes.addressof(pieces)
    return tubes, pieces


@lru_cache(maxsize=64)
def kernel_of(robot: Robot) -> Kernel | None:
    """The compiled kernel for a robot, None where there is none for it."""
    if robot.n_tubes > MOST_TUBES:
        return None
    return library(robot.n_tubes, robot.assembly(robot.home_translations).eccentric)


@lru_cache(maxsize=64)
def with_kernel(robot: Robot, refinement: int = 0) -> tuple[Kernel, Any, int] | None:
    """Kernel of a robot, its tubes with a mesh that is halved `refinement` times, and where these are; None where there
    is no kernel."""
    kernel = kernel_of(robot)
    if kernel is None:
        return None
    own = _tubes(robot, refinement)
    return kernel, own, address(own[0])


def address(array: NDArray[Any]) -> int:
    """Where an array lies in memory."""
    return int(array.ctypes.data)


def _place(array: Any) -> int:
    """The same of one that may be written to and is not empty, in a third of the time."""
    return ctypes.addressof(ctypes.c_double.from_buffer(array))


def _pack(rotations: Array, translations: Array, start: Start | None) -> tuple[Array, int, int, Any]:
    """All that goes in, in one piece of memory, since asking NumPy for an address takes a microsecond: that memory,
    where rotations and translations are in it, and the C struct Guess."""
    parts = [rotations, translations]
    if start is not None:
        parts += [start.arc_length, start.rotation, start.torsion, start.point, start.point_rotation, start.turn]
        parts.append(start.translations)
    flat = np.concatenate(parts, axis=None)
    places = [_place(flat)]
    for part in parts:
        places.append(places[-1] + 8 * part.size)
    if start is None:
        return flat, places[0], places[1], None
    count = len(start.arc_length)
    guess = _Guess(count, len(start.point), count, 1, *places[2:-1])
    return flat, places[0], places[1], ctypes.byref(guess)


class Solved(NamedTuple):
    """An equilibrium as the kernel found it, and how."""

    found: ArmSolution
    elements: int
    """Of the mesh."""
    largest_change: float
    """Of a twist from the start, rad."""
    contraction: float
    """Largest ratio of successive steps."""
    loading: float
    """Seconds in which the kernel was got ready."""


def solve_compiled(
    robot: Robot, rotations: Array, translations: Array, start: Start | None = None, refinement: int = 0
) -> Solved | None:
    """The stable equilibrium at joint values (n,).

    None where the kernel declines or there is none, or none of a mesh that is halved `refinement` times.
    """
    began = time.perf_counter()
    prepared = with_kernel(robot, refinement)
    if prepared is None:
        return None
    loading = time.perf_counter() - began
    answer = _solve(prepared, rotations, translations, start)
    if answer is None:
        return None
    elements, change, ratio = answer["elements"], answer["largest_change"], answer["contraction"]
    return Solved(_found(answer), elements, change, ratio, loading)


def _found(answer: dict[str, Any]) -> ArmSolution:
    """Copies of what the kernel found."""
    m, points = answer["pieces"] * STEPS + 1, answer["points"]
    return ArmSolution(
        ArmShape(
            arc_length=answer["arc_length"][:m].copy(),
            rotation=answer["rotation"][:m].T.copy(),
            torsion=answer["torsion"][:m].T.copy(),
            curvature=answer["curvature"][:m].copy(),
            position=answer["position"][:m].copy(),
            frame=answer["frame"][:m].copy(),
        ),
        tip_rotations=answer["tip_rotations"].copy(),
        section_start=answer["section_start"][: answer["sections"]].copy(),
        tube_end=answer["tube_end"].copy(),
        points=CollocationPoints(answer["point"][:points].copy(), answer["point_rotation"][:points].copy()),
        margin=answer["margin"],
        energy=answer["energy"],
        residual=answer["residual"],
        errors=(answer["mesh_error"], answer["tip_error"], 0.0),
        iterations=answer["iterations"],
    )


def _solve(
    prepared: tuple[Kernel, Any, int], rotations: Array, translations: Array, start: Start | None
) -> dict[str, Any] | None:
    """The fields of the C struct Answer, which the next call overwrites; None where the kernel declines."""
    check_time()
    kernel, _, tubes = prepared
    room = room_of(kernel)
    memory, alpha, shift, guess = _pack(rotations, translations, start)
    status = kernel.functions.solve(tubes, alpha, shift, guess, *room.at)
    room.solved = (prepared, memory[: 2 * len(rotations)].tobytes()) if status == SOLVED else None
    return room.answer() if status == SOLVED else None


class Slopes(NamedTuple):
    """Derivatives of a solved arm by its Q = 2n rotations and translations: of its tip (3, Q), the turn vector of its
    tip (3, Q), tip rotations (n, Q), margin and energy (Q,); the compliance (6, 6) of the tip at no load, None where
    not asked for; and of the shape points (m, 3, Q) at fixed arc lengths, the last of which is the tip; None of an arm
    with another mesh. `off` is by how much the rotations of the arm differ from those of the start, rad; infinite with
    another mesh."""

    position: Array
    turn: Array
    tip_rotations: Array
    margin: Array
    energy: Array
    compliance: Array | None
    along: Array | None
    off: float


def slopes_compiled(
    robot: Robot,
    rotations: Array,
    translations: Array,
    start: Start,
    moved: Moved,
    *,
    compliance: bool = False,
    either: bool = True,
) -> Slopes | None:
    """Derivatives of the equilibrium at joint values (n,) that is found from a start close by, where breakpoints
    coincide those of translations as they are `moved`, and of ends of tubes that move towards the first of its sides;
    of a margin that two modes share, by `either` of these, or NaN. None where the kernel declines or there is none; it
    must be `differentiable`.
    """
    prepared = with_kernel(robot, 0)
    if prepared is None:
        return None
    kernel, n = prepared[0], robot.n_tubes
    room = room_of(kernel)
    kept = room.has(prepared, rotations.tobytes() + translations.tobytes(), start)
    if not kept and _solve(prepared, rotations, translations, start) is None:
        return None
    points = room.fields["pieces"] * STEPS + 1
    s = room.fields["arc_length"][:points]
    same = kept or (points == len(start.arc_length) and bool(np.abs(s - start.arc_length).max() <= ROUND_OFF))
    off = 0.0 if kept else float(np.abs(room.fields["rotation"][:points].T - start.rotation).max()) if same else np.inf
    whole = 2 * n * (8 + n) + 36
    more = whole + points * 6 * n
    out = np.empty(more)
    at = _place(out)
    if not kernel.functions.differentiate(_asked(moved, compliance, either)[1], *room.at, at, at + 8 * whole):
        return None
    end = whole - 36 - 2 * n
    table = out[:end].reshape(7 + n, 2 * n)
    return Slopes(
        position=table[:3],
        turn=table[3:6],
        tip_rotations=table[6:-1],
        margin=table[-1],
        compliance=out[end : end + 36].reshape(6, 6) if compliance else None,
        energy=out[end + 36 : whole],
        along=out[whole:].reshape(points, 3, 2 * n) if same else None,
        off=off,
    )


@lru_cache(maxsize=256)
def _asked(moved: Moved, compliance: bool, either: bool) -> tuple[NDArray[np.int64], int]:
    """(2 n + 2,) the C struct Asked, and where it is."""
    n = len(moved.sides)
    out = np.zeros(2 * n + 2, dtype=np.int64)
    for k, tubes in enumerate(moved.carriages):
        out[list(tubes)] = k
    out[n:-2], out[-2:] = moved.sides, (compliance, either)
    return out, address(out)


def solve_many_compiled(
    robot: Robot, rotations: Array, translations: Array, arms: Array | None = None, refinement: int = 0
) -> tuple[Array, Mask] | None:
    """Cold solves of joint values (N, n): a row per configuration with tip position (3), tip frame by rows (9), tip
    rotations (n), margin, residual, mesh error, tip error and energy; and (N,) bool, which were declined. `arms`
    (N, 2, m, n) gets rotations and torsion at the m points of the arms, which all must have.

    None where there is no kernel. The interpreter is free while it runs.
    """
    check_time()
    prepared = with_kernel(robot, refinement)
    if prepared is None:
        return None
    kernel, _, tubes = prepared
    room, count = room_of(kernel), len(rotations)
    room.solved = None
    alpha, shift = (np.ascontiguousarray(a, dtype=float) for a in (rotations, translations))
    table, declined = np.zeros((count, 17 + robot.n_tubes)), np.zeros(count, dtype=np.uint8)
    places = (address(a) for a in (alpha, shift, table, declined))
    whole = (0, None) if arms is None else (arms.shape[2], address(arms))
    kernel.functions.solve_many(tubes, count, *places, *whole, *room.at)
    return table, declined.astype(bool)
