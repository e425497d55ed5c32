"""Jacobi fields of softened tubes, integrated from the tip to the plate: explicit, where a program must stay small."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from .collocated import Piece, Torsion

SOFT_NODES = np.array([0.0, 1 / 3, 1 / 2, 2 / 3, 1.0])
"""Where a step of Butcher's method of order 6 needs its right-hand side."""

_STAGES = (0, 1, 3, 1, 2, 2, 4)
_BUTCHER = (
    (),
    (1 / 3,),
    (0, 2 / 3),
    (1 / 12, 1 / 3, -1 / 12),
    (-1 / 16, 9 / 8, -3 / 16, -3 / 8),
    (0, 9 / 8, -3 / 8, -3 / 4, 1 / 2),
    (9 / 44, -9 / 11, 63 / 44, 18 / 11, 0, -16 / 11),
)
_WEIGHTS = (11 / 120, 0, 27 / 40, 27 / 40, -4 / 15, -4 / 15, 11 / 120)

SOFT_STEPS = 2
"""Steps of that method per piece: margins below 0.9 to about 1e-6."""


def marched_fields(torsion: Torsion, fields: Any, margin: Any) -> Any:
    """Jacobi fields (2n, n) at the beginning of a piece from those at its end, tubes softened by the fraction `margin`.

    The fields are those of `softened_fields`.

    Method: J. C. Butcher, J. Austral. Math. Soc. 4 (1964), order 6 in 7 stages.
    """
    piece, n = torsion.piece, torsion.piece.grid.n_tubes
    h = piece.length / SOFT_STEPS
    for step in reversed(range(SOFT_STEPS)):
        x = (step + SOFT_NODES) / SOFT_STEPS
        theta, w = torsion.rotation(x), torsion.torsion(x)
        rates = [_field_rate(piece, x[k], (theta[:, k], w[:, k]), margin) for k in range(len(x))]
        slopes: list[Any] = []
        for stage, row in zip(_STAGES, _BUTCHER, strict=True):
            at = fields - h * sum((a * k for a, k in zip(row, slopes, strict=True)), ca.SX.zeros(2 * n, n))
            # Towards the plate: the node at fraction c of the step lies at 1 - c of the stretch.
            slopes.append(rates[len(x) - 1 - stage](at))
        fields = fields - h * sum(b * k for b, k in zip(_WEIGHTS, slopes, strict=True))
    return fields


def _field_rate(piece: Piece, x: float, at: tuple[Any, Any], margin: Any) -> Any:
    """The right-hand side of the Jacobi fields at the fraction x of a piece, theta and w there, as a function of the
    fields."""
    n, (theta, w) = piece.grid.n_tubes, at
    _, stiff, *stretching = piece.balance(theta, x)
    gain = ca.diag(1 / ((1 - margin) * piece.torsional_stiffness)) @ stiff

    def rate(fields: Any) -> Any:
        y, v = fields[:n, :], fields[n:, :]
        turned = ca.diag(stretching[0]) @ v if stretching else v
        if len(stretching) > 1:
            turned += ca.diag(w) @ (stretching[1] @ y)
        return ca.vertcat(turned, gain @ y)

    return rate
