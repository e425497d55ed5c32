"""Stability as constraints of a block: the margin of its equilibrium, the certificate of its tubes."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from ..errors import InputError, finite
from ..physics.certificate import base_determinant
from ..physics.strain import SMOOTH
from .composed import ComposedBlock
from .given import symbolic
from .guess import fields_of
from .transcription import functions
from .transcription import loaded_fields as fields
from .transcription.panel import CHANNELS


def _checked(name: str, margin: Any) -> Any:
    if symbolic(margin):
        return margin
    if not finite(name, margin) < 1:
        raise InputError(f"{name} is {float(margin):g}; it must be below 1, that of tubes that do not couple")
    return ca.DM(float(margin))


def add_margin(block: ComposedBlock[Any], margin: Any) -> None:
    """Jacobi's condition on tubes softened by `margin`, for their fields y, v from y = 1, v = 0 at the tip: det y >= 0
    where pieces begin and det(y - |beta| v) >= 0 at the plate. Under a dead load y is above the rotation of the frame,
    which is held at the plate: see `loaded_fields`.

    Only the ratio v / y is handed on from piece to piece, and every piece begins with y = 1 anew: fields grow by many
    orders of magnitude along stiff tubes, and the sign of a determinant is that of the product over the pieces. The
    matrices of the determinants are unknowns as well, so that their dense second derivatives stay small.
    """
    if block.load is not None and not block.load.has_energy:
        raise InputError("load has a moment or turns with the tip; it has no energy, so the arm has no margin")
    floor, model = _checked("margin", margin), block.model
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


def add_certificate(block: ComposedBlock[Any], margin: Any) -> None:
    """D(lambda) >= 0 for the second variation that is the worst at all rotations, lambda = 1 - margin: see
    `physics.certificate`, with the pieces of the block in place of sections."""
    if block.load is not None:
        raise InputError("the certificate of an arm under load is no expression; it is of tubes that bear none")
    floor, model = _checked("margin", margin), block.model
    if model.place:
        raise InputError("the robot is eccentric; this certificate holds for concentric tubes")
    n, pieces = block.robot.n_tubes, model.n_pieces
    own = model.torsional_stiffness[:, 0], model.transmission, model.stiffness, model.moment
    if model.along is not None:
        own = _in_steps(block)
    given = {
        "torsional_stiffness": ca.SX.sym("kt", n, own[0].shape[1]),
        "transmission": ca.SX.sym("l", n),
        "length": ca.SX.sym("h", pieces),
        "stiffness": ca.SX.sym("kb", n, pieces),
        "moment": ca.SX.sym("m", n, pieces),
    }
    eigenvalue = ca.SX.sym("lambda")
    determinant = base_determinant(eigenvalue, given)
    function = ca.Function("certificate", [eigenvalue, *given.values()], [determinant], {"cse": True})
    value = function(1 - floor, *own[:2], model.lengths, *own[2:])
    block.demand("certificate", value)


def _in_steps(block: ComposedBlock[Any]) -> tuple[Any, Any, Any, Any]:
    """kt (n, P), transmissions (n,) with kt at the plate, kb and |m| (n, P) of tubes made of pieces.

    Raises:
        InputError: stiffness or curvature varies along a piece.
    """
    model, chain = block.model, block.chain
    assert chain is not None
    if any(table[:, 1:].any() for table in (chain.kb, chain.kt, chain.x, chain.y)):
        raise InputError(
            "a tube has a piece whose curvature or stiffness varies; in a program the certificate takes arcs and "
            "helices of constant stiffness"
        )
    detail = model.grid.detail
    first = [i * (CHANNELS * detail + 2) for i in range(block.robot.n_tubes)]
    kb, kt, x, y = (model.along[[row + c * detail for row in first], :] for c in range(4))
    held = model.transmission * kt[:, 0] / model.torsional_stiffness[:, 0]
    return kt, held, kb, kb * ca.sqrt(x**2 + y**2 + SMOOTH**2)
