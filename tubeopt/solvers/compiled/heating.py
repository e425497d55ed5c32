"""Compiled kernel of heating over time in half a tube, for all grids and rigs."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ...physics.heat import PROPERTIES, Resolution, volume_shapes
from ...physics.heat_functions import CLAMP, GAMMA, GROWTH, LUMPED, OF_A_CELL, cell_functions
from ...typing import Array
from .library import kernel_path, open_library
from .text import c_text, private


def heating_source() -> str:
    """C text of the kernel."""
    generator = ca.CodeGenerator("heat.c")
    for law in cell_functions():
        generator.add(law)
    constants = {
        "AMBIENT": PROPERTIES.index("T_amb"),
        "CLAMP": CLAMP,
        "LUMPED": LUMPED,
        "GAMMA": GAMMA,
        "GROWTH": GROWTH,
    }
    return c_text(constants, private(generator.dump()), "heating.c")


@lru_cache(maxsize=1)
def heating_kernel() -> Any:
    """Loaded kernel; None if it does not exist."""
    path = kernel_path((0, "heating"), heating_source)
    loaded = None if path is None else open_library(path)
    if loaded is None:
        return None
    pointer, whole = ctypes.c_void_p, ctypes.c_longlong
    loaded.workspace_size.argtypes, loaded.workspace_size.restype = [whole] * 2, whole
    loaded.march.argtypes, loaded.march.restype = [*[whole] * 6, *[pointer] * 9], None
    loaded.spread.argtypes, loaded.spread.restype = [*[whole] * 2, *[pointer] * 6], None
    return loaded


def _fields(volumes: Array, resolution: Resolution) -> Array:
    """Coefficients (B, V) in the order of the kernel, (B, F).

    They are nine numbers for each of the n cells of the tube, and three fields (1 + M, n) with rows for the tube and
    each shell: conductances outwards and along, and capacities. Shells of cells without a mold have capacity 1 and
    conduct nothing, so that all rows have the same form.
    """
    n, rows, bare = resolution.cells, 1 + resolution.shells, resolution.cells - resolution.covered
    shapes = volume_shapes(resolution)
    ends = np.cumsum([height * width for height, width in shapes.values()])[:-1]
    columns = zip(shapes.items(), np.split(volumes, ends, axis=1), strict=True)
    parts = {name: part.reshape(len(part), width, height) for (name, (height, width)), part in columns}
    tube, fields = np.zeros((len(volumes), 9, n)), np.zeros((len(volumes), 3, rows, n))
    for row, name in zip(tube.swapaxes(0, 1), (*OF_A_CELL, "G_tube", "mold_fraction", "G_wall"), strict=True):
        row[:, bare if name in ("mold_fraction", "G_wall") else 0 :][:, : parts[name].shape[2]] = parts[name][:, 0]
    # Cells without a mold have no gap, either; a wall of 0 would give no number.
    tube[:, -1, :bare] = 1.0
    outward, along, capacity = fields.swapaxes(0, 1)
    outward[:, :, bare:] = np.concatenate([parts[name] for name in ("G_gap", "G_radial", "G_outer")], axis=1)
    along[:, 1:, bare : n - 1], capacity[:, 1:, :bare], capacity[:, 1:, bare:] = (
        parts["G_shell"],
        1.0,
        parts["C_mold"],
    )
    return np.concatenate([tube.reshape(len(volumes), -1), fields.reshape(len(volumes), -1)], axis=1)


@dataclass(frozen=True, eq=False)
class Windows:
    """W successive windows of time."""

    span: Array
    """Durations (W,), s."""
    steps: NDArray[np.int64]
    """Numbers (W,) of equal steps."""
    duty: Array
    """Duties (W, B) of the members."""
    place: NDArray[np.int64]
    """Rows (W + 1,) of a course with the states at the start and at the end of each window."""


class Marcher:
    """B rigs on a grid, bound to the kernel with its memory, for one thread.

    Args:
        kernel: `heating_kernel`.
        properties, volumes: (B, P) and (B, V), which must not change.
    """

    def __init__(self, kernel: Any, resolution: Resolution, properties: Array, volumes: Array) -> None:
        self._kernel, self.members = kernel, len(properties)
        self._grid = resolution.cells, 1 + resolution.shells
        self._numbers = np.ascontiguousarray(properties), _fields(volumes, resolution)
        memory = np.zeros(kernel.workspace_size(*self._grid))
        # Memory with known addresses for one window and one state: NumPy takes longer for an address than a step.
        self._course = np.empty((2, self.members, resolution.cells, 1 + resolution.shells))
        self._lumped, self._duty = np.empty((2, self.members, LUMPED)), np.empty((1, self.members))
        self._window = np.empty(1), np.empty(1, dtype=np.int64), np.arange(2)
        self._spread = np.empty(2 * resolution.cells + 1)
        span, steps, place = self._window
        arrays = *self._numbers, span, steps, self._duty, place, self._course, self._lumped, memory, self._spread
        self._memory = memory
        *self._places, spread = (array.ctypes.data for array in arrays)
        sizes = self.members, 1, *(array.shape[1] for array in self._numbers)
        self._one = *self._grid, *sizes, *self._places
        p, q, *_, cells, lumped, work = self._places
        self._seen = *self._grid, p, q, cells, lumped, spread, work

    def march(self, windows: Windows, cells: Array, lumped: Array) -> None:
        """Write the states after windows of time into a course, cells (T, B, n, 1 + M) and lumped (T, B, 6).

        The course has the initial state in the first row of `windows.place`. Other Python threads run meanwhile.
        """
        sizes = self.members, len(windows.span), *(array.shape[1] for array in self._numbers)
        duty = np.ascontiguousarray(windows.duty)
        arrays = windows.span, windows.steps, duty, windows.place, cells, lumped
        places = (array.ctypes.data for array in arrays)
        self._kernel.march(*self._grid, *sizes, *self._places[:2], *places, self._places[-1])

    def advance(self, cells: Array, lumped: Array, duty: Array | float, span: float, steps: int) -> tuple[Array, Array]:
        """States, cells (B, n, 1 + M) and lumped (B, 6), after one window at a duty, or at duties (B,)."""
        self._course[0], self._lumped[0], self._duty[0] = cells, lumped, duty
        self._window[0][0], self._window[1][0] = span, steps
        self._kernel.march(*self._one)
        return self._course[1].copy(), self._lumped[1].copy()

    def spread(self, cells: Array, lumped: Array) -> Array:
        """Heating rates (2 n + 1,) of the first rig in a state.

        They are rates of the tube at no duty and at full duty, K/s, and the current while the MOSFET conducts, A.
        """
        self._course[0, 0], self._lumped[0, 0] = cells[0], lumped[0]
        self._kernel.spread(*self._seen)
        return self._spread.copy()
