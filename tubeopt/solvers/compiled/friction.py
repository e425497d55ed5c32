"""Motions of tubes with friction, in the compiled kernel."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import casadi as ca
import numpy as np

from ...block.transcription.contact import ELEMENTS
from ...physics.torsion import passed_moment_function
from ...robots.concentric import Friction
from ...robots.robot import Robot
from ...typing import Array
from ..friction_increment import Signs
from ..time_limit import check_time
from .binding import address, memory_of, with_kernel
from .constants import friction_constants
from .library import MOST_TUBES, MOST_UNKNOWNS, Kernel, kernel_text, load_kernel
from .text import HERE, private, with_fresh_macros, with_included


@dataclass(frozen=True, eq=False)
class FrictionStates:
    """States after K increments of a motion with friction."""

    stations: Array
    """Positions (K, S, 3) of the stations, m."""
    frame: Array
    """Frames (K, 3, 3) of the tip."""
    rotation: Array
    """Rotations (K, n) of the tubes at the tip, rad."""
    margin: Array
    """Margins (K,) without friction, to 1e-5; NaN if not requested."""
    length: Array
    """Lengths (K,) of the arm, m."""
    heat: Array
    """Energy (K,) dissipated by friction since the first row, J."""
    violation: Array
    """Violations (K,) of the friction conditions, as a slip (rad) or a fraction of the capacity."""
    unknowns: Array
    """Unknowns (K, M) of the states, padded."""
    torque: Array
    """Torques (K, M) of the friction rows, padded."""
    capacity: Array
    """Largest torques (K, M) of the friction rows, padded."""
    signs: Signs
    """Signs of slip (K, M) of the friction rows, padded."""


class FrictionStart(NamedTuple):
    """Start state of a motion with friction."""

    unknowns: Array
    """Unknowns (U,) of its contact."""
    torque: Array
    """Torques (R,) of its friction rows, N m."""
    signs: Signs
    """Signs of slip (R,) of its friction rows."""


def friction_source(n: int) -> str:
    """C text of the kernel for n concentric tubes with friction."""
    generator = ca.CodeGenerator("passed.c")
    generator.add(passed_moment_function(n))
    functions = with_fresh_macros(private(generator.dump()), kernel_text(n))
    return functions + friction_constants() + with_included(HERE / "friction.c")


@lru_cache(maxsize=MOST_TUBES)
def _kernel(n: int) -> Kernel | None:
    kernel = load_kernel((n, "friction"), lambda: friction_source(n), np.dtype([]))
    if kernel is not None:
        pointer, whole = ctypes.c_void_p, ctypes.c_longlong
        kernel.functions.friction_motion.argtypes = [*[pointer] * 2, ctypes.c_double, whole, *[pointer] * 10]
        kernel.functions.friction_motion.restype = whole
    return kernel


def simple(friction: Friction) -> bool:
    """Return whether friction is distributed and torsional only, as in the kernel."""
    return not (friction.sliding or any(any(friction.of(name)) for name in ("plate", "jumps", "ends")))


def friction_motion(
    robot: Robot,
    friction: Friction,
    joints: Array,
    start: FrictionStart,
    behind: Array,
    *,
    margins: bool = True,
) -> FrictionStates | None:
    """Increments along rows of joint values (T, 2n), one step per row, from a state at row 0.

    They end before the first step that fails in the kernel. None if there is no kernel for this robot and friction, or
    if the problem is too large for it.

    Args:
        behind: distances (S,) of the stations from the tip, m.
        margins: also compute margins, for a quarter of the time.
    """
    check_time()
    n, unknowns, torque, signs = robot.n_tubes, start.unknowns, start.torque, start.signs
    if not simple(friction) or max(len(unknowns), len(torque)) > MOST_UNKNOWNS:
        return None
    prepared = with_kernel(robot)
    kernel = None if prepared is None else _kernel(n)
    if prepared is None or kernel is None:
        return None
    alpha, shift = (np.ascontiguousarray(part) for part in (joints[:, :n], joints[:, n:]))
    law = np.concatenate([friction.per_pair(name, n - 1) for name in ("torque", "by_moment")])
    sizes = np.array([len(unknowns), len(torque), len(behind), margins], dtype=np.int64)
    states = np.zeros((3, len(joints), MOST_UNKNOWNS))
    states[0, 0, : len(unknowns)], states[1, 0, : len(torque)] = unknowns, torque
    slips = np.zeros((len(joints), MOST_UNKNOWNS), dtype=np.int8)
    slips[0, : len(signs)] = signs
    out, behind = np.zeros((len(joints), 3 * len(behind) + 13 + n)), np.ascontiguousarray(behind)
    arrays = [address(array) for array in (alpha, shift, sizes, *states, slips, behind, out)]
    pieces = ELEMENTS * 2.0**friction.refinement
    scalars = prepared.address, address(law), pieces, len(joints)
    count = kernel.functions.friction_motion(*scalars, *arrays, memory_of(kernel).addresses[0])
    if count < 0:
        return None
    parts = np.split(out[1:count], np.cumsum([3 * len(behind), 9, n, 1, 1, 1]), axis=1)
    stations, frame, rotation, margin, length, heat, violation = parts
    return FrictionStates(
        stations=stations.reshape(len(stations), len(behind), 3),
        frame=frame.reshape(-1, 3, 3),
        rotation=rotation,
        margin=margin[:, 0] if margins else np.full(len(margin), np.nan),
        length=length[:, 0],
        heat=heat[:, 0],
        violation=violation[:, 0],
        unknowns=states[0, 1:count],
        torque=states[1, 1:count],
        capacity=states[2, 1:count],
        signs=slips[1:count],
    )
