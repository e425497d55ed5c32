"""What parameters change on a mesh of tubes made of pieces, and what these changes do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from ..typing import Array


@dataclass(frozen=True, eq=False)
class Change:
    """What Q parameters change: alpha (Q, n), int ds / kt up to the plate (Q, n), lengths of the pieces (Q, P), and at
    all their points (Q, P, K, n) 1 / kt, kb, m and phase."""

    base: Array
    transmission: Array
    length: Array
    rate: Array
    stiffness: Array
    moment: Array
    phase: Array

    @property
    def columns(self) -> Array:
        """(Q, P, K, 3n) of phase, kb and m."""
        return np.concatenate([self.phase, self.stiffness, self.moment], axis=3)


@dataclass(frozen=True, eq=False)
class Wound:
    """Moments (P, K, n) at the points, the torque (P, K, n) that they make there, and at the plate (n,)."""

    moments: Array
    torque: Array
    base: Array


@dataclass(frozen=True, eq=False)
class Answer:
    """What changes do: `whole` with the turn of all pulls as its phase, phi (Q, P + 1, n) between the pieces, u and the
    turn vector per piece (Q, P, K, 2), (Q, P, K, 3) at the points."""

    whole: Change
    between: Array
    bent: Array
    turn: Array

    def only(self, k: int) -> Answer:
        """Of the k-th change alone."""
        own = slice(k, k + 1)
        whole = Change(*(getattr(self.whole, field.name)[own] for field in fields(Change)))
        return Answer(whole, self.between[own], self.bent[own], self.turn[own])


def together(changes: Sequence[Change]) -> Change:
    """Several changes as one of so many columns."""
    return Change(*(np.concatenate([getattr(one, field.name) for one in changes]) for field in fields(Change)))
