"""Stability constraints of a block: its margin, and certificates for all rotations and all forces on the tip."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from ..errors import InputError, finite, positive
from ..physics.certificate import (
    APART,
    ONCE,
    OPPOSED,
    TURNED,
    base_determinant,
    crossing_function,
    largest_eigenvalue,
    plate_conditions,
)
from ..physics.strain import SMOOTH
from ..robots.load import Load
from ..typing import Array
from .composed import ComposedBlock
from .guess import jacobi_fields
from .inputs import symbolic
from .transcription import functions
from .transcription.chain import CHANNELS, Chain
from .transcription.model import Model

# --- Stability margin -------------------------------------------------------------------------------------------------


def checked_margin(margin: Any) -> Any:
    """Lower bound on a margin, as an expression; raises InputError for a number that is not below 1."""
    if symbolic(margin):
        return margin
    if not finite("margin", margin) < 1:
        raise InputError(f"margin is {float(margin):g}; it must be below 1")
    return ca.DM(float(margin))


class MarginBound(NamedTuple):
    """Lower bound on the margin of a block, with its unknowns."""

    fields: tuple[Any, ...]
    """Unknown Jacobi fields, as columns in the order of `JacobiFields`."""
    min_margin: Any


def add_margin(block: ComposedBlock[Any], margin: Any) -> None:
    """Constrain the margin to at least `margin` by Jacobi's condition on tubes softened by that fraction.

    The fields y, v start from y = 1, v = 0 at the tip. The condition is det y >= 0 where elements begin and
    det(y - |beta| v) >= 0 at the plate. Under a dead load y includes the rotation of the frame, which is fixed at the
    plate: see `transcription.functions`.

    Only the ratio v / y is passed on between elements, and every element restarts from y = 1: fields grow by many
    orders of magnitude along stiff tubes, and the sign of a determinant is that of the product over the elements. The
    matrices of the determinants are unknowns as well, so that their dense second derivatives stay small.
    """
    if block.load is not None:
        block.load.require_energy("the arm has no margin")
    min_margin, model = checked_margin(margin), block.model
    n, rows = functions.field_size(model.grid), functions.field_rows(model.grid)
    elements, reach, degree = model.n_elements, block.reach, model.grid.degree
    inside = np.tile(np.where(np.arange(rows) < n, 1.0, 1 / reach), n * degree * elements)
    count = f" {len(block.margins) + 1}" if block.margins else ""
    label = f"{block.label}Jacobi fields"
    columns = [
        block.program.variable(f"{label}{what}{count}", size, scale=scale)
        for what, size, scale in (
            ("", n * n * (elements - 1), 1 / reach),
            (" inside", len(inside), inside),
            (" ahead", n * n * (elements + 1), 1.0),
        )
    ]
    start = float(min_margin) if not symbolic(margin) else min(max(block.initial.margin - 0.1, 0.0), 0.9)
    for column, value in zip(columns, jacobi_fields(block.initial_model, start), strict=True):
        block.program.set_guess(column, value)
    ratio, points, matrices = (ca.reshape(each, size, -1) for each, size in zip(columns, (n, rows, n), strict=True))
    after = ca.vertcat(ca.repmat(ca.DM.eye(n), 1, elements), ca.horzcat(ratio, ca.DM.zeros(n, n)))
    before, defect = model.mapped("fields")(after, points, model.lengths.T, *model.softness(min_margin))
    y, v = before[:n, :], ca.horzsplit(before[n:, :], n)
    plate = y[:, :n] - ca.repmat(model.plate_compliance, 1, n) * v[0]
    begins = ca.horzsplit(matrices, n)
    ratios = ca.horzsplit(ratio, n) if elements > 1 else []
    residuals = [ratio_k @ begins[k + 1] - v[k + 1] for k, ratio_k in enumerate(ratios)]
    labels = [f"Jacobi field {c + 1}, row {r + 1}, after element {k + 1}" for k, c, r in np.ndindex(elements - 1, n, n)]
    name = f"equations of the Jacobi fields{count}"
    block.demand(name, ca.vec(ca.horzcat(ca.MX(n, 0), *residuals)), upper=0.0, scale=1 / reach, entries=labels)
    labels = [
        f"Jacobi field {c + 1}, row {i + 1}, element {k + 1}, point {x + 1}"
        for k, c, x, i in np.ndindex(elements, n, degree, rows)
    ]
    block.demand(f"{name}, inside", ca.vec(defect), upper=0.0, scale=inside, entries=labels)
    starts = [*(f"element {k + 1}" for k in range(elements)), "the plate"]
    labels = [
        f"Jacobi field {c + 1}, row {i + 1}, where {section_name} begins"
        for section_name in starts
        for c, i in np.ndindex(n, n)
    ]
    block.demand(f"{name}, ahead", ca.vec(matrices - ca.horzcat(y, plate)), upper=0.0, entries=labels)
    det = functions.determinant_function(n)
    labels = [f"margin, on the arm from element {k + 1} on" for k in range(elements)] + ["margin"]
    block.demand(f"margin{count}", ca.vertcat(*(det(matrix) for matrix in begins)), entries=labels)
    block.margins.append(MarginBound(tuple(columns), min_margin))


@dataclass(frozen=True, eq=False)
class CertificateBound:
    """A lower bound on a certificate of a block, under forces of at most `force`, N."""

    min_margin: Any
    force: float
    pairs: tuple[float, float]
    """Pairs of the bound that is constrained: of `loaded_worst_case`, the larger one at the start."""
    eigenvalue: Any = None
    """Unknown eigenvalue; None without a force."""
    states: Any = None
    """Unknown eigenfunction, by columns; None without a force."""

    @property
    def name(self) -> str:
        """Name of the certificate in messages."""
        return f"certificate under {1e3 * self.force:g} mN" if self.force else "certificate"

    def start(self, block: ComposedBlock[Any]) -> None:
        """Set the start values of its unknowns to the eigenpair of the arm at the start."""
        if self.eigenvalue is None:
            return
        eigenvalue, states = eigenpair(block.initial_model, self.force, self.pairs)
        block.program.set_guess(self.eigenvalue, eigenvalue)
        block.program.set_guess(self.states, states.ravel(order="F"))

    def value(self, model: Model, chain: Chain | None = None) -> float:
        """The certificate of an arm in numbers."""
        sections, tubes = _sections_and_tubes(model, chain)
        value = 1 - largest_eigenvalue(self.force, sections, tubes, self.pairs)[0]
        return value if self.pairs != APART else value - largest_eigenvalue(0.0, sections, tubes, TURNED)[0]


def add_certificate(block: ComposedBlock[Any], margin: Any, max_force: float = 0.0) -> None:
    """Constrain the certificate to at least `margin`, for all rotations and all tip forces up to `max_force`, N."""
    min_margin, force = checked_margin(margin), positive("max_force", max_force, zero=True)
    if block.model.offsets:
        raise InputError("the robot is eccentric; this certificate is valid for concentric tubes only")
    if block.load is not None:
        _check_covered(block.load, force)
    if not force:
        block.demand("certificate", _without_force(block, 1 - min_margin))
        # A determinant has the same sign beyond the second eigenvalue, so `equilibrium` computes the certificate again.
        block.bounds.append(CertificateBound(min_margin, 0.0, TURNED))
        return
    if block.model.along is not None:
        raise InputError(f"max_force is {force:g} N; for tubes made of pieces it must be 0 in a block")
    _add_under_force(block, min_margin, force)


def _check_covered(load: Load, force: float) -> None:
    """Raise InputError unless a certificate for tip forces up to `force`, N, covers the load."""
    if load != Load(load.force):
        raise InputError("load is not a tip force in the base frame; the certificate does not cover other loads")
    size = float(np.linalg.norm(load.force))
    if size > force * (1 + 1e-12):
        raise InputError(
            f"load is a tip force of {1e3 * size:g} mN; it must be at most max_force, "
            f"{1e3 * force:g} mN, for the certificate to cover it"
        )


def _without_force(block: ComposedBlock[Any], eigenvalue: Any) -> Any:
    """D(lambda) of the second variation at the worst rotations; its sections are the elements of the block."""
    model = block.model
    n, elements = block.robot.n_tubes, model.n_elements
    tubes = _tube_data(model, block.chain)
    inputs = {
        "torsional_stiffness": ca.SX.sym("kt", n, tubes.torsional_stiffness.shape[1]),
        "transmission": ca.SX.sym("l", n),
        "length": ca.SX.sym("h", elements),
        "stiffness": ca.SX.sym("kb", n, elements),
        "moment": ca.SX.sym("m", n, elements),
    }
    symbol = ca.SX.sym("lambda")
    determinant = base_determinant(symbol, inputs, ONCE)
    function = ca.Function("certificate", [symbol, *inputs.values()], [determinant], {"cse": True})
    return function(
        eigenvalue, tubes.torsional_stiffness, tubes.transmission, model.lengths, tubes.stiffness, tubes.moment
    )


def _add_under_force(block: ComposedBlock[Any], min_margin: Any, force: float) -> None:
    """Add the certificate under a force: an eigenvalue, and its eigenfunction at the starts of elements as unknowns.

    The largest eigenvalue is simple, hence smooth, and only its eigenfunction has one sign (Krein and Rutman), which is
    a constraint. Of the two bounds of `loaded_worst_case`, the one that is larger at the start is used.
    """
    model, program = block.model, block.program
    n, elements = block.robot.n_tubes, model.n_elements
    pairs = _tighter_pairs(block.initial_model, force)
    value, initial = eigenpair(block.initial_model, force, pairs)
    count = sum(bound.force > 0 for bound in block.bounds) + 1
    tag = f"{block.label}certificate under force{f' {count}' if count > 1 else ''}"
    typical = np.maximum(np.abs(initial).max(1, keepdims=True), 1e-6 * np.abs(initial).max())
    scale = np.broadcast_to(typical, initial.shape).ravel(order="F")
    eigenvalue = program.variable(f"{tag}: eigenvalue", 1, scale=value, guess=value)
    flat = program.variable(f"{tag}: states", initial.size, scale=scale, guess=initial.ravel(order="F"))
    states = ca.reshape(flat, *initial.shape)
    block.bounds.append(CertificateBound(min_margin, force, pairs, eigenvalue, flat))
    # Lever of the force: arc length from the end of each element to the tip.
    lever = ca.DM(np.triu(np.ones((elements, elements)), 1)) @ model.lengths
    inputs = [ca.repmat(ca.DM(part), 1, elements) for part in (np.array(pairs), force)]
    across = crossing_function(n, 1, *ONCE).map(elements)(
        states[:, 1:],
        ca.repmat(1 / eigenvalue, 1, elements),
        *inputs,
        model.lengths.T,
        lever.T,
        ca.sum1(model.stiffness),
        ca.fabs(model.moment),
        model.torsional_stiffness,
    )
    plate = plate_conditions(states[:, 0], model.torsional_stiffness[:, 0], model.transmission)
    largest = int(np.argmax(np.abs(initial[: n + 1, -1])))
    tip = ca.vertcat(states[n + 1 :, -1] / typical[n + 1 :, 0], states[largest, -1] - 1)
    size = np.concatenate([np.tile(typical[:, 0], elements), typical[: n + 1, 0], np.ones(n + 2)])
    rows = ca.vertcat(ca.vec(states[:, :-1] - across), plate, tip)
    name = tag.removeprefix(block.label)
    block.demand(f"{name}: equations", rows, upper=0.0, scale=size, entries=[f"{name}: equations"] * len(size))
    curved = [*np.flatnonzero(np.abs(np.asarray(block.initial_model.moment)).max(1) > 0).tolist(), n]
    sign = ca.vec(states[curved, 1:] / ca.repmat(typical[curved, 0], 1, elements))
    block.demand(f"{name}: one sign", sign, entries=[f"{name}: one sign"] * sign.numel())
    if pairs == APART:
        block.demand(name, _without_force(block, 1 - min_margin - eigenvalue))
        block.demand(f"{name}: remainder under the force", 1 - min_margin - eigenvalue)
    else:
        block.demand(name, 1 - eigenvalue - min_margin)


def _sections_and_tubes(
    model: Model, chain: Chain | None = None
) -> tuple[tuple[Array, Array, Array], tuple[Array, Array]]:
    """Arguments `sections` and `tubes` of `largest_eigenvalue` for an arm, as numbers."""
    kt, transmission, stiffness, moment = (np.array(part) for part in _tube_data(model, chain))
    length = np.maximum(np.asarray(model.lengths).ravel(), 0.0)
    return (length, stiffness.sum(0), np.abs(moment.T)), (kt * np.ones(len(length)), transmission.ravel())


def _tighter_pairs(model: Model, force: float) -> tuple[float, float]:
    """Name of the treatment of tube pairs, OPPOSED or APART, with the larger lower bound for an arm in numbers."""
    sections, tubes = _sections_and_tubes(model)
    if len(tubes[0]) < 3:  # of two tubes the opposed pair is always the larger bound
        return OPPOSED
    together = largest_eigenvalue(force, sections, tubes, OPPOSED)[0]
    apart = largest_eigenvalue(force, sections, tubes, APART)[0] + largest_eigenvalue(0.0, sections, tubes, TURNED)[0]
    return OPPOSED if together <= apart else APART


def eigenpair(model: Model, force: float, pairs: tuple[float, float]) -> tuple[float, Array]:
    """Largest eigenvalue of an arm in numbers, and its states (2 n + 2, P + 1) at element starts and at the tip."""
    sections, tubes = _sections_and_tubes(model)
    value, tip = largest_eigenvalue(force, sections, tubes, pairs)
    crossing, n = crossing_function(len(tubes[0]), 1, *ONCE), len(tubes[0])
    states, lever = [np.concatenate([tip, np.zeros(n + 1)])], 0.0
    for h, stiffness, moment, kt in zip(*(part[::-1] for part in (*sections, tubes[0].T)), strict=True):
        states.append(np.array(crossing(states[-1], 1 / value, pairs, force, h, lever, stiffness, moment, kt)).ravel())
        lever += h
    return value, np.array(states[::-1]).T


class _TubeData(NamedTuple):
    """Tubes on the P elements of a block."""

    torsional_stiffness: Any
    """Torsional stiffnesses kt (n, P), or (n, 1) for tubes with constant stiffness, N m^2."""
    transmission: Any
    """Transmission lengths |beta| (n,) for kt at the plate, m."""
    stiffness: Any
    """Bending stiffness kb (n, P)."""
    moment: Any
    """Moments m (n, P), bending stiffness times precurvature; of tubes made of pieces their size."""


def _tube_data(model: Model, chain: Chain | None) -> _TubeData:
    """Tubes on the elements of a block.

    Raises:
        InputError: a tube with a piece along which curvature or stiffness varies.
    """
    if model.along is None:
        return _TubeData(model.torsional_stiffness[:, :1], model.transmission, model.stiffness, model.moment)
    assert chain is not None
    if any(table[:, 1:].any() for table in (chain.kb, chain.kt, chain.x, chain.y)):
        raise InputError(
            "a tube has a piece with varying curvature or stiffness; in a program the "
            "certificate supports arcs and helices of constant stiffness only"
        )
    detail = model.grid.detail
    first = [i * (CHANNELS * detail + 2) for i in range(model.torsional_stiffness.shape[0])]
    kb, kt, x, y = (model.along[[row + c * detail for row in first], :] for c in range(4))
    transmission = model.transmission * kt[:, 0] / model.torsional_stiffness[:, 0]
    return _TubeData(kt, transmission, kb, kb * (x**2 + y**2 + SMOOTH**2) ** 0.5)
