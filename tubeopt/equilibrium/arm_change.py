"""How torsion along a solved arm of tubes off the centreline changes with joint values and with every dimension and
stiffness of the tubes, and the breakpoints that move with these: see `derivatives`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from ..block.transcription.buffered import section_function
from ..block.transcription.linear import Arm, Chain, Response, Slopes, along, chain_of, respond, slopes_at
from ..block.transcription.reduced import ReducedProblem
from ..errors import InputError
from ..robots.assembly import ROUND_OFF, Assembly
from ..robots.breakpoints import DIMENSIONS
from ..typing import Array


@dataclass(frozen=True, eq=False)
class Jumps:
    """J breakpoints that parameters move: `column` of the parameter, `index` of the piece that begins there, and
    kb, m (2 J, n) of the cross-sections that the motion uncovers, then of what was there; `spread` (J, Q) is 1 in the
    column of each."""

    column: NDArray[np.intp]
    index: NDArray[np.intp]
    stiffness: Array
    moment: Array
    spread: Array

    def __len__(self) -> int:
        return len(self.column)

    @cached_property
    def solid(self) -> Array:
        """kb (2 J, n) where there is a tube, 1 where there is none and a cross-section cannot be asked."""
        return np.where(self.stiffness.any(1, keepdims=True), self.stiffness, 1.0)

    def twice(self, table: Array) -> Array:
        """(2 J, ...) of a table (P + 1, ...) between the pieces."""
        here = table[self.index]
        return np.concatenate([here, here])

    def gain(self, values: Array) -> Array:
        """(J, ...) of values (2 J, ...): of what the motion uncovers over what was there."""
        half = len(self.column)
        return np.asarray(values[:half] - values[half:])


Mover = tuple[int, tuple[int, ...], tuple[int, ...]]
"""Column of a parameter that moves breakpoints, with the tubes whose transitions and whose ends move along."""


@lru_cache(maxsize=64)
def moving_breakpoints(assembly: Assembly, between: bytes, movers: tuple[Mover, ...], side: int, size: int) -> Jumps:
    """Every breakpoint in front of the plate that a parameter, one of `size`, moves towards the tip (`side` 1) or the
    plate (-1), the same for all rotations of the bundle; `between` are the arc lengths (P + 1,) between the pieces."""
    cuts = np.frombuffer(between)
    n, nudge = assembly.n_tubes, side * ROUND_OFF
    begin, end = assembly.transition.tolist(), assembly.end.tolist()
    column, place, gained, lost = [], [], [], []
    for c, first, last in movers:
        own = sorted([end[i] for i in last] + [begin[i] for i in first if end[i] - begin[i] > ROUND_OFF])
        begins = [s + 2 * nudge * (i in first) for i, s in enumerate(begin)]
        ends = [s + 2 * nudge * (i in last) for i, s in enumerate(end)]
        for k, s in enumerate(own):
            if s > -nudge and not (k and s - own[k - 1] <= ROUND_OFF):
                after, before = _there(begins, ends, s + nudge), _there(begin, end, s + nudge)
                if after != before:
                    column.append(c)
                    place.append(s)
                    gained.append(after)
                    lost.append(before)
    there = np.array(gained + lost, dtype=bool).reshape(-1, 2, n)
    return Jumps(
        column=np.array(column, dtype=np.intp),
        index=np.searchsorted(cuts, np.array(place) - 2 * ROUND_OFF),
        stiffness=there[:, 0] * assembly.bending_stiffness,
        moment=there[:, 1] * (assembly.bending_stiffness * assembly.curvature),
        spread=(np.array(column)[:, None] == np.arange(size)).astype(float),
    )


def _there(transition: list[float], end: list[float], s: float) -> tuple[list[bool], list[bool]]:
    """Which tubes are there at arc length s between breakpoints, and which of them in their curved part."""
    return [s < last for last in end], [first < s < last for first, last in zip(transition, end, strict=True)]


PARAMETERS = ("rotations", "translations", *DIMENSIONS)
"""What an equilibrium is differentiated by, n columns each, per rad, per m, or per SI unit of the dimension."""


def check_wrt(wrt: Sequence[str], side: int) -> None:
    """Raise InputError for a name that is not among PARAMETERS, or a side that is neither 1 nor -1."""
    if side not in (1, -1):
        raise InputError(f"side is {side!r}; it must be 1 (forward) or -1 (backward)")
    for name in wrt:
        if name not in PARAMETERS:
            raise InputError(f"wrt names {name!r}; it may name {', '.join(PARAMETERS)}")


class ArmChange:
    """Change of one arm with Q parameters, computed where it is asked for.

    Args:
        arm, carriages: the solved arm, and the tubes that move together.
        wrt: names of PARAMETERS, n columns each in this order. Tubes of one carriage share the derivative with respect
            to its translation in equal parts, so that the chain rule holds for every motion that is possible.
        side: 1 for breakpoints that move towards the tip, -1 towards the plate: where breakpoints coincide the
            derivatives differ.
        margin: of the equilibrium.
        problem: gives the reduced problem that the arm solves; the margin asks for it.

    Raises:
        InputError: a name that is not among PARAMETERS, or a side that is neither 1 nor -1.
    """

    def __init__(
        self,
        arm: Arm,
        carriages: tuple[tuple[int, ...], ...],
        *,
        wrt: Sequence[str] = ("rotations", "translations"),
        side: int = 1,
        margin: float,
        problem: Callable[[], ReducedProblem],
    ) -> None:
        check_wrt(wrt, side)
        self.arm, self.assembly, self.carriages = arm, arm.assembly, carriages
        self.wrt, self.side = tuple(wrt), side
        self.value, self.problem = margin, problem
        self.size = 0
        """Number of columns, by carriages."""
        self._first = {}
        for name in self.wrt:
            self._first[name] = self.size
            self.size += len(carriages) if name == "translations" else arm.n_tubes

    # --- what changes -------------------------------------------------------------------------------------------------

    def first(self, name: str) -> int | None:
        """The first column of a parameter, None where it is not asked for."""
        return self._first.get(name)

    @cached_property
    def data(self) -> Array:
        """(P, 3n, Q) change of kb, m and kt."""
        arm, n = self.arm, self.arm.n_tubes
        out = np.zeros((arm.n_pieces, 3 * n, self.size))
        if not self.reshaped:
            return out
        present, tube = arm.stiffness > 0, np.arange(n)
        kb, kappa = self.assembly.bending_stiffness, self.assembly.curvature
        curved = self._curved
        for name, rows in (
            ("curvature", ((n, kb * curved),)),
            ("bending_stiffness", ((0, present), (n, kappa * curved))),
            ("torsional_stiffness", ((2 * n, np.ones((arm.n_pieces, n))),)),
        ):
            first = self.first(name)
            if first is not None:
                for row, values in rows:
                    out[:, row + tube, first + tube] = values
        return out

    @property
    def reshaped(self) -> bool:
        """Whether any parameter changes the cross-sections."""
        return not {"curvature", "bending_stiffness", "torsional_stiffness"}.isdisjoint(self.wrt)

    @property
    def _curved(self) -> Array:
        """(P, n) whether each tube is on its curved part, straight or not."""
        middle = (self.arm.start + self.arm.length / 2)[:, None]
        return np.asarray((middle > self.assembly.transition) & (middle < self.assembly.end))

    @cached_property
    def transmitted(self) -> Array:
        """(n, Q) change of |beta|."""
        out = np.zeros((self.arm.n_tubes, self.size))
        first = self.first("translations")
        if first is not None:
            for c, tubes in enumerate(self.carriages):
                for i in tubes:
                    out[i, first + c] = -1.0
        first = self.first("straight_length")
        if first is not None:
            out[np.arange(len(out)), first + np.arange(len(out))] = 1.0
        return out

    @cached_property
    def movers(self) -> list[Mover]:
        """Columns that move breakpoints, with the tubes whose transitions and whose ends move along."""
        out: list[Mover] = []
        first = self.first("translations")
        if first is not None:
            out += [(first + c, tubes, tubes) for c, tubes in enumerate(self.carriages)]
        first = self.first("curved_length")
        if first is not None:
            out += [(first + i, (), (i,)) for i in range(self.arm.n_tubes)]
        return out

    @cached_property
    def jumps(self) -> Jumps:
        """Every breakpoint in front of the plate that a parameter moves."""
        return moving_breakpoints(self.assembly, self.cuts.tobytes(), tuple(self.movers), self.side, self.size)

    @cached_property
    def cuts(self) -> Array:
        """(P + 1,) arc lengths between the pieces, plate and tip included."""
        return np.append(self.arm.start, self.assembly.total_length)

    @cached_property
    def gains(self) -> tuple[Array, Array, Array, Array]:
        """What theta' and w' (J, 2n), u (J, 2), and energy per length and |u|^2 (J,) gain at the jumps, per unit of
        their parameters."""
        jumps, n, place, kt = self.jumps, self.arm.n_tubes, self.arm.place, self.arm.torsional_stiffness
        count = len(jumps)
        if not count:
            return np.zeros((0, 2 * n)), np.zeros((0, 2)), np.zeros(0), np.zeros(0)
        theta, twist = (jumps.twice(table) for table in self.arm.states)
        there = jumps.stiffness.any(1, keepdims=True)
        function = section_function("section", 2 * count, n, True)
        moment, stretch, u, bending = function(theta, jumps.solid, jumps.moment, *place)
        turned, bent = np.where(there, stretch, 1.0) * twist, u * there
        density = (bending * there)[:, 0] + (turned * twist) @ kt / 2
        rates = np.concatenate([turned, moment / kt], axis=1), bent, density, (bent**2).sum(1)
        state, curvature, energy, squared = (self.side * jumps.gain(rate) for rate in rates)
        return state, curvature, energy, squared

    # --- torsion ------------------------------------------------------------------------------------------------------

    @cached_property
    def slopes(self) -> Slopes:
        """Cross-sections at the points, with their derivatives."""
        return slopes_at(self.arm, self.arm.inner)

    @cached_property
    def chain(self) -> Chain:
        """Linear maps of the pieces."""
        return chain_of(self.arm, self.slopes, dimensions=self.reshaped)

    @cached_property
    def response(self) -> Response:
        """Change of theta and w along the arm, by carriages."""
        arm, n = self.arm, self.arm.n_tubes
        base = self.transmitted * arm.twist[:1].sum(0)[:, None]
        first = self.first("rotations")
        if first is not None:
            base[np.arange(n), first + np.arange(n)] = 1.0
        jumps = np.zeros((arm.n_pieces + 1, 2 * n, self.size))
        # No two breakpoints that one parameter moves are at the same place.
        jumps[self.jumps.index, :, self.jumps.column] = self.gains[0]
        return respond(arm, self.chain, base, self.data, jumps)

    @cached_property
    def twist_change(self) -> Array:
        """(P, K, n, Q) change of w at the points, by carriages."""
        arm, at, n = self.arm, self.slopes, self.arm.n_tubes
        rate = at.rate_slope[..., :n] @ self.response.inner
        if self.reshaped:
            rate += at.rate_slope[..., n:] @ self.data[:, None, : 2 * n]
            rate -= (at.rate / arm.torsional_stiffness)[..., None] * self.data[:, None, 2 * n :]
        gained = arm.length[:, None, None, None] * along(arm.tableau.adjoint, rate)
        return np.asarray(self.response.state[:-1, None, n:] + gained)

    @cached_property
    def columns(self) -> Array:
        """(P, K, 3n, Q) change of theta, kb and m at the points."""
        n, inner = self.arm.n_tubes, self.response.inner
        data = np.broadcast_to(self.data[:, None, : 2 * n], (*inner.shape[:2], 2 * n, self.size))
        return np.concatenate([inner, data], axis=2)

    def per_tube(self, columns: Array) -> Array:
        """(..., Q) by tubes from (...) by carriages: every tube of a carriage gets an equal part."""
        n, first = self.arm.n_tubes, self.first("translations")
        if first is None or len(self.carriages) == n:
            return columns
        parts = [columns[..., :first], np.zeros((*columns.shape[:-1], n)), columns[..., first + len(self.carriages) :]]
        for c, tubes in enumerate(self.carriages):
            parts[1][..., list(tubes)] = columns[..., first + c, None] / len(tubes)
        return np.concatenate(parts, axis=-1)
