"""Heat in half a tube in time, in the compiled kernel: one for all grids and rigs."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ...physics.heat import PROPERTIES, Resolution
from ...physics.heat_functions import CLAMP, GAMMA, LUMPED, cell_functions
from ...typing import Array
from .library import kernel_path, open_library
from .text import c_text


def heating_source() -> str:
    """The C text of the kernel."""
    generator = ca.CodeGenerator("heat.c")
    for law in cell_functions():
        generator.add(law)
    constants = {"AMBIENT": PROPERTIES.index("ambient"), "CLAMP": CLAMP, "LUMPED": LUMPED, "GAMMA": GAMMA}
    return c_text(constants, generator, "heating.c")


@lru_cache(maxsize=1)
def heating_kernel() -> Any:
    """The loaded kernel; None where it cannot be had."""
    path = kernel_path((0, "heating"), heating_source)
    loaded = None if path is None else open_library(path)
    if loaded is None:
        return None
    pointer, whole = ctypes.c_void_p, ctypes.c_longlong
    loaded.workspace_size.argtypes, loaded.workspace_size.restype = [whole] * 3, whole
    loaded.march.argtypes, loaded.march.restype = [*[whole] * 7, *[pointer] * 9], None
    loaded.spread.argtypes, loaded.spread.restype = [*[whole] * 3, *[pointer] * 6], None
    return loaded


@dataclass(frozen=True, eq=False)
class Windows:
    """W windows of time after one another.

    Attributes:
        span: (W,) s. steps: (W,) equal ones that each is made in. duty: (W, B) of every member.
        place: (W + 1,) rows of a course in which the states at their ends stand, with the start.
    """

    span: Array
    steps: NDArray[np.int64]
    duty: Array
    place: NDArray[np.int64]


class Marcher:
    """B rigs on a grid bound to the kernel, with what it works in: of one thread.

    Args:
        kernel: `heating_kernel`. properties, volumes: (B, P) and (B, V), which must not be written to.
    """

    def __init__(self, kernel: Any, resolution: Resolution, properties: Array, volumes: Array) -> None:
        self._kernel, self.members = kernel, len(properties)
        self._grid = resolution.cells, resolution.covered, resolution.shells
        self._numbers = np.ascontiguousarray(properties), np.ascontiguousarray(volumes)
        memory = np.zeros(kernel.workspace_size(*self._grid))
        memory[0] = -1.0  # no step is factored
        # For one window, and one state, memory whose place is known: to ask NumPy for it takes longer than a step.
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
        """Write the states after windows of time into a course, cells (T, B, n, 1 + M) and lumped (T, B, 6), whose
        first row in place is given. The interpreter is free while it runs."""
        sizes = self.members, len(windows.span), *(array.shape[1] for array in self._numbers)
        duty = np.ascontiguousarray(windows.duty)
        arrays = windows.span, windows.steps, duty, windows.place, cells, lumped
        places = (array.ctypes.data for array in arrays)
        self._kernel.march(*self._grid, *sizes, *self._places[:2], *places, self._places[-1])

    def advance(self, cells: Array, lumped: Array, duty: Array | float, span: float, steps: int) -> tuple[Array, Array]:
        """The states, cells (B, n, 1 + M) and lumped (B, 6), after one window at duties, one number or (B,)."""
        self._course[0], self._lumped[0], self._duty[0] = cells, lumped, duty
        self._window[0][0], self._window[1][0] = span, steps
        self._kernel.march(*self._one)
        return self._course[1].copy(), self._lumped[1].copy()

    def spread(self, cells: Array, lumped: Array) -> Array:
        """(2 n + 1,) of the first member in a state: rates of the tube at no duty and at full duty, K/s, and the
        current while the MOSFET conducts, A."""
        self._course[0, 0], self._lumped[0, 0] = cells[0], lumped[0]
        self._kernel.spread(*self._seen)
        return self._spread.copy()
