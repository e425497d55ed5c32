"""The stability margin of an equilibrium as a constraint of its block."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from ..errors import InputError, finite
from .composed import ComposedBlock
from .given import symbolic
from .guess import fields_of
from .transcription import functions
from .transcription import loaded_fields as fields


def checked(name: str, margin: Any) -> Any:
    """A floor of a margin, as an expression; raises InputError for a number that is none below 1."""
    if symbolic(margin):
        return margin
    if not finite(name, margin) < 1:
        raise InputError(f"{name} is {float(margin):g}; it must be below 1")
    return ca.DM(float(margin))


def add_margin(block: ComposedBlock[Any], margin: Any) -> None:
    """Jacobi's condition on tubes softened by `margin`, for their fields y, v from y = 1, v = 0 at the tip: det y >= 0
    where pieces begin and det(y - |beta| v) >= 0 at the plate. Under a dead load y is above the rotation of the frame,
    which is held at the plate: see `loaded_fields`.

    Only the ratio v / y is handed on from piece to piece, and every piece begins with y = 1 anew: fields grow by many
    orders of magnitude along stiff tubes, and the sign of a determinant is that of the product over the pieces. The
    matrices of the determinants are unknowns as well, so that their dense second derivatives stay small.
    """
    if block.load is not None:
        block.load.require_energy("the arm has no margin")
    floor, model = checked("margin", margin), block.model
    n, rows = fields.size(model.grid), fields.rows(model.grid)
    pieces, reach, degree = model.n_pieces, block.reach, model.grid.degree
    inside = np.tile(np.where(np.arange(rows) < n, 1.0, 1 / reach), n * degree * pieces)
    count = f" {len(block.margins) + 1}" if block.margins else ""
    label = f"{block.label}Jacobi fields"
    columns = [
        block.program.variable(f"{label}{what}{count}", size, scale=scale)
        for what, size, scale in (
            ("", n * n * (pieces - 1), 1 / reach),
            (" inside", len(inside), inside),
            (" ahead", n * n * (pieces + 1), 1.0),
        )
    ]
    start = float(floor) if not symbolic(margin) else min(max(block.near.margin - 0.1, 0.0), 0.9)
    for column, value in zip(columns, fields_of(block.begin, start), strict=True):
        block.program.set_guess(column, value)
    ratio, points, ahead = (ca.reshape(each, size, -1) for each, size in zip(columns, (n, rows, n), strict=True))
    after = ca.vertcat(ca.repmat(ca.DM.eye(n), 1, pieces), ca.horzcat(ratio, ca.DM.zeros(n, n)))
    before, defect = model.mapped("fields")(after, points, model.lengths.T, *model.softness(floor))
    y, v = before[:n, :], ca.horzsplit(before[n:, :], n)
    held = y[:, :n] - ca.repmat(model.held_at_the_plate, 1, n) * v[0]
    begins = ca.horzsplit(ahead, n)
    gaps = [own @ begins[k + 1] - v[k + 1] for k, own in enumerate(ca.horzsplit(ratio, n) if pieces > 1 else [])]
    words = [f"Jacobi field {c + 1}, row {r + 1}, after piece {k + 1}" for k, c, r in np.ndindex(pieces - 1, n, n)]
    name = f"equations of the Jacobi fields{count}"
    block.demand(name, ca.vec(ca.horzcat(ca.MX(n, 0), *gaps)), upper=0.0, scale=1 / reach, entries=words)
    words = [
        f"Jacobi field {c + 1}, row {i + 1}, piece {k + 1}, point {x + 1}"
        for k, c, x, i in np.ndindex(pieces, n, degree, rows)
    ]
    block.demand(f"{name}, inside", ca.vec(defect), upper=0.0, scale=inside, entries=words)
    places = [*(f"piece {k + 1}" for k in range(pieces)), "the plate"]
    words = [
        f"Jacobi field {c + 1}, row {i + 1}, where {place} begins" for place in places for c, i in np.ndindex(n, n)
    ]
    block.demand(f"{name}, ahead", ca.vec(ahead - ca.horzcat(y, held)), upper=0.0, entries=words)
    det = functions.determinant_function(n)
    places = [f"margin, on the arm from piece {k + 1} on" for k in range(pieces)] + ["margin"]
    block.demand(f"margin{count}", ca.vertcat(*(det(each) for each in begins)), entries=places)
    block.margins.append((tuple(columns), floor))
