"""Tubes along which everything goes in steps: straight parts, arcs, helices, each with constant stiffnesses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..typing import Array
from .series import Series
from .tubes import Tube, stretches


@dataclass(frozen=True, eq=False)
class Steps:
    """n tubes of up to C stretches; shorter chains are filled up with stretches without length.

    cuts: (n, C) where stretches end, from the held end, m; the first is the straight part.  bending, torsional,
    curvature, phase, twist: (n, C) EI, GJ, |u*_xy|, the direction of that in the tube's own frame, and u*_z.
    wound: (n, C) natural turn where stretches begin.
    """

    cuts: Array
    bending: Array
    torsional: Array
    curvature: Array
    phase: Array
    twist: Array
    wound: Array

    @property
    def compliance(self) -> Array:
        """(n, C) int ds / GJ from the held end to where stretches begin, 1/(N m)."""
        lengths = np.diff(self.cuts, axis=1, prepend=0.0)
        return np.cumsum(lengths / self.torsional, axis=1) - lengths / self.torsional


def steps_of(tubes: Sequence[Tube], what: str) -> Steps:
    """The stretches of tubes; `what` says for whom anything else is too much.

    Raises:
        InputError: curvature, twist or stiffness varies along a piece.
    """
    rows = []
    for i, tube in enumerate(tubes, start=1):
        chain = stretches(tube)
        if tube.straight_length == 0:
            chain = [(0.0, (0.0, 0.0, 0.0), *chain[0][2:]), *chain]
        for _, u, bending, torsional in chain:
            if any(isinstance(q, Series) for q in (*u, bending, torsional)):
                raise InputError(
                    f"tube {i} has a piece that varies along its length; {what} takes straight pieces, arcs and "
                    "helices of constant stiffness"
                )
        rows.append([(length, *u, bending, torsional) for length, u, bending, torsional in chain])
    most = max(2, *(len(row) for row in rows))
    table = np.array([[*row, *[(0.0, *row[-1][1:])] * (most - len(row))] for row in rows], dtype=float)
    length, x, y, z, bending, torsional = table.transpose(2, 0, 1)
    wound = np.cumsum(length * z, axis=1) - length * z
    return Steps(np.cumsum(length, axis=1), bending, torsional, np.hypot(x, y), np.arctan2(y, x), z, wound)
