"""The compiled kernel on NumPy arrays: one configuration, or many."""

from __future__ import annotations

import ctypes
import threading
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...robots.assembly import Array, Mask
from ...robots.robot import Robot
from .library import Library, library

SOLVED = 0

MOST_TUBES = 6
"""Robots of more tubes go to the general solver: their matrices ask for a blocked elimination, as LAPACK has it."""


class _Guess(ctypes.Structure):
    _fields_ = (
        ("count", ctypes.c_longlong),
        ("points", ctypes.c_longlong),
        *((name, ctypes.c_void_p) for name in ("s", "rotation", "torsion", "point", "point_rotation", "turn")),
    )


@dataclass(frozen=True, eq=False)
class Start:
    """Where to start from: rotation and torsion (n, m) of another arm at arc_length (m,), its solution at collocation
    points (N,), (N, n), and the turn (n,) to add."""

    arc_length: Array
    rotation: Array
    torsion: Array
    point: Array
    point_rotation: Array
    turn: Array


@dataclass(frozen=True, eq=False)
class _Room:
    """Memory of one thread for one kernel: what it works in, and what it answers, whole and by field."""

    workspace: Array
    answer: Any
    fields: dict[str, Any]


_rooms = threading.local()


def _room(kernel: Library) -> _Room:
    rooms: dict[Any, _Room] = _rooms.__dict__
    if kernel not in rooms:
        answer = np.zeros((), kernel.answer)
        fields = {name: answer[name] for name in kernel.answer.names or ()}
        rooms[kernel] = _Room(np.zeros(kernel.workspace_size // 8 + 1), answer, fields)
    return rooms[kernel]


@lru_cache(maxsize=64)
def _tubes(robot: Robot) -> Array:
    """The C struct Tubes of a robot."""
    home = robot.assembly(robot.home_translations)
    straight = [tube.straight_length for tube in robot.tubes]
    whole = [tube.length for tube in robot.tubes]
    table = [home.bending_stiffness, home.torsional_stiffness, home.curvature, straight, whole]
    out = np.concatenate([*table, home.offset, home.offset_angle, [0.0]])
    out[-1:].view(np.int64)[0] = home.eccentric
    return out


@lru_cache(maxsize=64)
def kernel_of(robot: Robot) -> Library | None:
    """The compiled kernel for a robot, None where there is none for it."""
    if robot.n_tubes > MOST_TUBES:
        return None
    return library(robot.n_tubes, robot.assembly(robot.home_translations).eccentric)


def _at(array: NDArray[Any]) -> int:
    return int(array.ctypes.data)


def solve_compiled(
    robot: Robot, rotations: Array, translations: Array, start: Start | None = None
) -> dict[str, Any] | None:
    """The stable equilibrium at joint values (n,), as the fields of the C struct Answer; overwritten by the next call.

    None where the kernel declines or there is none.
    """
    kernel = kernel_of(robot)
    if kernel is None:
        return None
    room, guess, tubes = _room(kernel), None, _tubes(robot)
    if start is not None:
        arrays = [start.arc_length, start.rotation, start.torsion, start.point, start.point_rotation, start.turn]
        arrays = [np.ascontiguousarray(a, dtype=float) for a in arrays]
        guess = ctypes.byref(_Guess(len(arrays[0]), len(arrays[3]), *(_at(a) for a in arrays)))
    joints = np.concatenate([rotations, translations])
    here = _at(joints)
    status = kernel.solve(
        _at(tubes), kernel.method, here, here + 8 * len(rotations), guess, _at(room.workspace), _at(room.answer)
    )
    return room.fields if status == SOLVED else None


def solve_many_compiled(robot: Robot, rotations: Array, translations: Array) -> tuple[Array, Mask] | None:
    """Cold solves of joint values (N, n): a row per configuration with tip position (3), tip frame by rows (9), tip
    rotations (n), margin, residual, mesh error, tip error and energy; and (N,) bool, which were declined.

    None where there is no kernel. The interpreter is free while it runs.
    """
    kernel = kernel_of(robot)
    if kernel is None:
        return None
    room, count, tubes = _room(kernel), len(rotations), _tubes(robot)
    alpha, shift = (np.ascontiguousarray(a, dtype=float) for a in (rotations, translations))
    table, declined = np.zeros((count, 17 + robot.n_tubes)), np.zeros(count, dtype=np.uint8)
    arguments = [_at(tubes), kernel.method, count, _at(alpha), _at(shift), _at(table), _at(declined)]
    kernel.solve_many(*arguments, _at(room.workspace), _at(room.answer))
    return table, declined.astype(bool)
