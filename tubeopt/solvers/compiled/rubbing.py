"""Motions of tubes that rub, in the compiled kernel."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ...block.transcription.contact import PIECES
from ...robots.concentric import Friction
from ...robots.robot import Robot, is_general
from ...typing import Array
from ..friction_increment import Signs
from ..time_limit import check_time
from .binding import address, room_of, with_kernel
from .constants import rubbing_constants
from .library import MOST_TUBES, MOST_UNKNOWNS, Kernel, kernel_text, load_kernel
from .text import HERE, with_included


@dataclass(frozen=True, eq=False)
class Rubbed:
    """Where a motion is after K increments of rows.

    Attributes:
        stations: (K, S, 3) m.   frame: (K, 3, 3) of the tip.   rotation: (K, n) of the tubes there, rad.
        margin: (K,) without friction, to 1e-5, NaN if not asked for.   length: (K,) of the arm, m.
        heat: (K,) that friction took since the first row, J.
        violation: (K,) of what friction demands, as a slip (rad) or a part of the capacity.
        unknowns, torque, signs: (K, M) of the states and of their contacts' rows, filled up.
    """

    stations: Array
    frame: Array
    rotation: Array
    margin: Array
    length: Array
    heat: Array
    violation: Array
    unknowns: Array
    torque: Array
    signs: Signs


def rubbing_source(n: int) -> str:
    """The C text of the kernel for n concentric tubes that rub."""
    return kernel_text(n) + rubbing_constants() + with_included(HERE / "rubbing.c")


@lru_cache(maxsize=MOST_TUBES)
def _kernel(n: int) -> Kernel | None:
    kernel = load_kernel((n, "rubbing"), lambda: rubbing_source(n), np.dtype([]))
    if kernel is not None:
        pointer, whole = ctypes.c_void_p, ctypes.c_longlong
        kernel.functions.rub.argtypes = [*[pointer] * 2, ctypes.c_double, whole, *[pointer] * 9]
        kernel.functions.rub.restype = whole
    return kernel


def simple(friction: Friction) -> bool:
    """Whether friction is along the tubes and against their turns alone, as the kernel knows it."""
    return not (friction.sliding or any(any(friction.of(name)) for name in ("plate", "jumps", "ends")))


def rub_compiled(
    robot: Robot,
    friction: Friction,
    joints: Array,
    state: tuple[Array, Array, Signs],
    behind: Array,
    *,
    margins: bool = True,
) -> Rubbed | None:
    """Increments along rows of joint values (T, 2n) from the state of row 0: unknowns (U,), torques (R,) and signs (R,)
    of its contact; with stations `behind` (S,) the tip, m, and, where asked for, `margins`, a quarter of the time.

    Each row is one step. As many as go well: where a step asks for more care, they end before it. None where there is
    no kernel for this robot and this friction, or no room in it.
    """
    check_time()
    n, (unknowns, torque, signs) = robot.n_tubes, state
    if is_general(robot) or not simple(friction) or max(len(unknowns), len(torque)) > MOST_UNKNOWNS:
        return None
    plain = with_kernel(robot)
    kernel = None if plain is None else _kernel(n)
    if plain is None or kernel is None:
        return None
    alpha, shift = (np.ascontiguousarray(part) for part in (joints[:, :n], joints[:, n:]))
    capacity = np.array(friction.per_pair("torque", n - 1))
    sizes = np.array([len(unknowns), len(torque), len(behind), margins], dtype=np.int64)
    states = np.zeros((2, len(joints), MOST_UNKNOWNS))
    states[0, 0, : len(unknowns)], states[1, 0, : len(torque)] = unknowns, torque
    slips = np.zeros((len(joints), MOST_UNKNOWNS), dtype=np.int8)
    slips[0, : len(signs)] = signs
    out, behind = np.zeros((len(joints), 3 * len(behind) + 13 + n)), np.ascontiguousarray(behind)
    places = [address(array) for array in (alpha, shift, sizes, states[0], states[1], slips, behind, out)]
    pieces = PIECES * 2.0**friction.refinement
    given = plain[2], address(capacity), pieces, len(joints)
    count = kernel.functions.rub(*given, *places, room_of(kernel).at[0])
    if count < 0:
        return None
    parts = np.split(out[1:count], np.cumsum([3 * len(behind), 9, n, 1, 1, 1]), axis=1)
    at, frame, turned, margin, length, heat, violation = parts
    return Rubbed(
        stations=at.reshape(len(at), len(behind), 3),
        frame=frame.reshape(-1, 3, 3),
        rotation=turned,
        margin=margin[:, 0] if margins else np.full(len(margin), np.nan),
        length=length[:, 0],
        heat=heat[:, 0],
        violation=violation[:, 0],
        unknowns=states[0, 1:count],
        torque=states[1, 1:count],
        signs=slips[1:count],
    )
