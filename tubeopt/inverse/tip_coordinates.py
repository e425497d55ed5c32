"""The space in which plans are searched: one point per equilibrium, so that no point has two branches.

Joint values do not tell in which of several equilibria a robot is. The rotations of the tubes at their own ends do,
together with the translations: see `block.transcription.explicit`. A straight line of such points is a continuous
motion of the robot; if every point on it is stable, moving the joints accordingly makes the robot follow it without a
snap.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..block.transcription.buffered import Buffered
from ..block.transcription.explicit import (
    Kind,
    explicit_arm,
    explicit_kind,
    explicit_parameters,
    explicit_rotations,
    explicit_size,
)
from ..equilibrium.result import Equilibrium
from ..robots.load import Load
from ..typing import Array, Delegate, Mask
from .arm_surface import cubic, outer_radius
from .clock import Clock, LateError
from .joints import JointSpace

BATCH = 8
"""Equilibria integrated per call: enough to hide the cost of calling, few enough to stop early where a motion fails."""

FINE = 128
"""Points along the arm at which clearance is measured during the search."""


@dataclass(frozen=True, eq=False)
class Arms:
    """N equilibria."""

    rotations: Array
    """(N, n) of the joints, rad."""
    stable: Mask
    """(N,) whether the margin is above the one asked for."""
    points: Array
    """(N, p, 3) of the centrelines, m."""
    tangents: Array
    """(N, p, 3) there."""
    arc_length: Array
    """(N, p) there, m."""
    tube_end: Array
    """(N, n) m."""

    @property
    def tip(self) -> Array:
        """(N, 3) m."""
        return self.points[:, -1]

    def some(self, rows: NDArray[np.intp]) -> Arms:
        """Those in some rows (r,)."""
        return Arms(*(getattr(self, field.name)[rows] for field in fields(self)))

    def fine(self) -> tuple[Array, Array]:
        """Arc lengths (N, FINE) and centreline (N, FINE, 3) at evenly spaced points."""
        s = np.linspace(0.0, 1.0, FINE) * self.arc_length[:, -1:]
        return s, self.at(s, np.arange(len(s)))

    def at(self, s: Array, rows: NDArray[np.intp]) -> Array:
        """(r, p, 3) centrelines of the equilibria `rows` (r,) at arc lengths s (r, p), by cubic interpolation."""
        along = self.arc_length[rows]
        k = np.clip((along[:, None, :] <= s[:, :, None]).sum(2) - 1, 0, along.shape[1] - 2)
        row, own = rows[:, None], np.arange(len(rows))[:, None]
        start = along[own, k]
        h = along[own, k + 1] - start
        x = (np.where(h > 0, (s - start) / np.where(h > 0, h, 1.0), 1.0))[..., None]
        p, q, a, b = self.points[row, k], self.points[row, k + 1], self.tangents[row, k], self.tangents[row, k + 1]
        return np.asarray(cubic(p, q, a, b, x, h[..., None]))


@lru_cache(maxsize=128)
def _mapped(function: Callable[[Kind], Any], kind: Kind, count: int, thread: int) -> Buffered:
    return Buffered(function(kind).map(count))


@dataclass(frozen=True, eq=False)
class TipCoordinates:
    """Points z (m,): tip rotations (n,), rad, then the translation of every carriage, m, of a joint space; `load`: what
    the arms of its points bear, None for arms that bear none."""

    space: JointSpace
    load: Load | None = None

    eccentric = Delegate[bool]("kind")

    @cached_property
    def parameters(self) -> Array:
        """The robot as numbers."""
        return explicit_parameters(self.space.robot)

    @cached_property
    def kind(self) -> Kind:
        """Which function its arms are."""
        return explicit_kind(self.space.robot)

    @cached_property
    def radius(self) -> Array:
        """(n,) radius of the arm where tube i is the outermost, m."""
        return outer_radius(self.space.robot)

    @cached_property
    def size(self) -> int:
        """Operations that one equilibrium takes."""
        return explicit_size(self.kind)

    def of(self, equilibrium: Equilibrium) -> Array:
        """The point of an equilibrium."""
        return self.space.join(equilibrium.tip_rotations, equilibrium.translations)

    def translations(self, z: Array) -> Array:
        """(N, n) translations of points (N, m)."""
        return self.space.joint(z)[:, self.space.robot.n_tubes :]

    def joints(self, z: Array, arms: Arms | None = None) -> Array:
        """(N, m) independent joint values of points, whose arms may be known."""
        rotations = self.rotations(z) if arms is None else arms.rotations
        return np.concatenate([rotations, z[:, self.space.robot.n_tubes :]], axis=1)

    def rotations(self, z: Array) -> Array:
        """(N, n) rotations of the joints at points z (N, m): those of `arms`, in a sixth of the time."""
        tip, shift, thread = z[:, : self.space.robot.n_tubes], self.translations(z), threading.get_ident()
        out = np.empty(tip.shape)
        for k in range(0, len(z), BATCH):
            some = slice(k, k + BATCH)
            function = _mapped(explicit_rotations, self.kind, len(tip[some]), thread)
            out[some] = function(tip[some], shift[some], self.parameters)[0]
        return out

    def arms(self, z: Array, margin: float | Array, clock: Clock | None = None) -> Arms:
        """The equilibria of points z (N, m), and whether their margin is above `margin`, one number or (N,).

        Raises:
            LateError: the clock is over before all of them are known.
        """
        n = self.space.robot.n_tubes
        shift = self.translations(z)
        floor = np.broadcast_to(margin, len(z))
        parts = []
        for k in range(0, len(z), BATCH):
            if clock is not None and clock.over:
                raise LateError
            parts.append(self._batch(z[k : k + BATCH, :n], shift[k : k + BATCH], floor[k : k + BATCH, None]))
        rotations, fields, points, tangents, s = (np.concatenate(part) for part in zip(*parts, strict=True))
        tubes = self.space.robot.tubes
        end = shift + np.array([tube.length - tube.straight_length for tube in tubes])
        return Arms(rotations, np.asarray((fields > 0).all(1)), points, tangents, s, end)

    def _batch(self, tip: Array, shift: Array, margin: Array) -> list[Array]:
        count = len(tip)
        function = _mapped(explicit_arm, self.kind, count, threading.get_ident())
        rotations, fields, points, tangents, s = (
            array.copy() for array in function(tip, shift, margin, self.parameters)
        )
        curves = [curve.reshape(count, -1, 3) for curve in (points, tangents)]
        return [rotations, fields, *curves, s.reshape(count, -1)]
