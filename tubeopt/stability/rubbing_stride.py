"""How long the next step of a motion with friction is: longer where steps go well, most of the way to a fold."""

from __future__ import annotations

from ..equilibrium.continuation import JointPath
from ..equilibrium.friction import Held

SHORTEST = 1e-11
"""Turn of a base (rad), or shift over the longest tube, in a step that fails only where the state is lost."""

SHORT = 1e-3
"""Part of the longest step with which a motion goes on from where it landed, and which no path is too short for."""

MOST_OF_THE_WAY = 0.72
"""Part of the way to a fold in one step. The state moves as the square root of the way that is left, on which Newton's
method shrinks its steps enough (`LARGEST_RATIO`) up to 0.75 of it."""

UNTOLD = 1e-9
"""Margin whose square is round-off, which tells of no fold."""


class Stride:
    """The length `size` of the next step, a fraction of a path.

    Towards a fold at t_f the square of the margin goes to 0 as t_f - t does: two states tell where it is.
    """

    def __init__(self, path: JointPath) -> None:
        self.longest = path.largest_step()
        self.shortest = min(SHORTEST / max(path.span(), SHORTEST), SHORT * self.longest)
        self.size, self._halted, self._wall = self.longest, False, 0.0
        self._before: tuple[float, Held] | None = None

    def failed(self, t: float, held: Held, at: float) -> bool:
        """After a step from a state at t to `at` that failed: whether there is a shorter one, which is `size` now."""
        step, ahead = at - t, self._ahead(t, held)
        self.size = max(self.shortest, ahead if ahead < 0.9 * step else step / 4)
        self._halted, self._wall = True, at
        return step > 2 * self.shortest

    def went(self, t: float, held: Held, at: float, there: Held) -> None:
        """After a step from a state at t to another."""
        self._before = (t, held)
        grown = self.size if self._halted else min(2 * self.size, self.longest)
        near = self._ahead(at, there) if at < self._wall else grown
        self.size, self._halted = max(self.shortest, near if near < grown else grown), False

    def landed(self) -> None:
        """After the state was another one at once."""
        self.size, self._halted, self._wall, self._before = max(self.size, SHORT * self.longest), False, 0.0, None

    def _ahead(self, t: float, held: Held) -> float:
        """Most of the way from a state at t to the fold that it and the one before tell of; infinite without one."""
        if self._before is None or held.held_margin < UNTOLD:
            return float("inf")
        s, earlier = self._before
        soft, softer = earlier.held_margin**2, held.held_margin**2
        return MOST_OF_THE_WAY * (t - s) * softer / (soft - softer) if softer < soft else float("inf")
