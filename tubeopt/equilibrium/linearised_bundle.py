"""Derivatives of an equilibrium of a bundle robot by joint values and dimensions, by the implicit function theorem.

The gradient of the energy E(x, c) stays 0 along the equilibrium x(c): dx/dc = -E_xx^-1 E_xc. A section of a bundle ends
where its tubes have fixed own lengths, so that every section moves with the curvature of all others: in place of the
chain of elements of tubes with fixed sections, one matrix E_xx joins them.

The mode z of the margin mu makes z'Hz / z'Tz stationary, with H = E_xx and T the second variation of tubes without
coupling, see `margin_form`. No change of the mode matters to it: d mu = z'(dH - mu dT)z / z'Tz. Under a load without
an energy H is not symmetric, and the left mode takes the place of the first z.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
import scipy

from ..block.transcription.arm import ArmShape, along_elements, cumulate
from ..block.transcription.buffered import mapped
from ..block.transcription.bundle import (
    SAME_PLACE,
    BundleMode,
    BundleState,
    bundle_arm,
    holding_forces,
    margin_form,
    mode_of,
    work_second_change,
)
from ..block.transcription.collocated import ENDS
from ..block.transcription.orientation import orient, tangent_slopes, tangents
from ..block.transcription.second_variation import modes
from ..errors import InputError, SolveError
from ..physics.torsion import bundle_energy_changes
from ..typing import Array, Mask
from .bundle import Bundled
from .directions import ARRANGEMENT, PARAMETERS, check_wrt, columns_of
from .kinematics import point_of
from .linearised import APART, FLAT, place_of
from .result import Equilibrium

CHANGED: dict[str, dict[str, float]] = {
    "rotations": {"alpha": 1},
    "translations": {"transmission": -1, "transition": 1, "end": 1},
    "curvature": {"curvature": 1},
    "straight_length": {"transmission": 1},
    "curved_length": {"end": 1},
    "bending_stiffness": {"bending_stiffness": 1},
    "torsional_stiffness": {"torsional_stiffness": 1},
    "offset": {"offset": 1},
    "angle": {"angle": 1},
    "sheath_stiffness": {"sheath": 1},
    "sheath_rigid_length": {"rigid_length": 1},
    "sheath_rigid_from": {"rigid_from": 1},
}
"""Changes of the quantities of a tube in `Bundle`, and of its rotation alpha, per unit of each parameter."""

SINGLE = ("sheath", "rigid_length", "rigid_from")
"""Quantities of `Bundle` that are one number."""


class _EnergyChanges(NamedTuple):
    """Derivatives of the energy at N points by 5 n + 1 data of a cross-section."""

    first: Array
    """(N, 5 n + 1) gradient."""
    mixed: Array
    """(N, 2 n + 3, 5 n + 1) derivatives of `by_local` by the data."""
    third: Array
    """(N, 2 n + 3) third derivatives along two directions."""


class TubeAlongArm(NamedTuple):
    """A tube in E elements of an arm, at ENDS (x,) of each, with changes at fixed fractions of the elements."""

    theta: Array
    """Rotation (E, x), rad."""
    curvature: Array
    """Curvature (E, x, 2) per own length, in the Bishop frame, 1/m."""
    natural: Array
    """Precurvature (E,), 1/m."""
    turned: Array
    """Change (E, x, Q) of the rotation."""
    bent: Array
    """Change (E, x, 2, Q) of the curvature."""
    curved: Array
    """Change (E, Q) of the precurvature."""


@dataclass(frozen=True, eq=False)
class LinearisedBundle:
    """Derivatives of a solved state of a bundle in Q directions, computed when they are read; names as in `Jacobian`.

    A table (N, 2 n + 3, Q) has the changes of theta, p, kappa and h at the points.
    """

    member: Bundled
    state: BundleState
    wrt: tuple[str, ...]
    """Names of PARAMETERS and of the ARRANGEMENT, with columns as `columns_of`."""
    along: Array | None = None
    """Combinations (.., Q) of these columns that replace them, or None."""
    border: Array | None = None
    """Null vector (U,) of a singular Hessian: changes of the unknowns are orthogonal to it. Else None."""

    def __post_init__(self) -> None:
        bundle = self.state.problem.bundle
        straight = (bundle.curvature == 0) & (bundle.transition > 0)
        if "curvature" in self.wrt and self._of_tubes("curvature")[straight].any():
            raise InputError(
                "wrt names 'curvature', but a straight tube would begin to curve in front of the plate. Give that tube "
                "a curvature, or move it back until its curved part begins at the plate."
            )
        applied = self.state.problem.load
        loaded = [] if applied is None else applied.cuts().tolist()
        for name in {"sheath_rigid_length", "sheath_rigid_from"} & set(self.wrt):
            at = getattr(bundle, name.removeprefix("sheath_"))
            if any(abs(s - at) <= SAME_PLACE for s in loaded):
                raise InputError(f"wrt names {name!r}, but the load begins, ends or acts there, at {at:g} m")
        if self._moves_axes and self.state.problem.density:
            raise InputError("wrt names offset or angle under gravity; these have derivatives under other loads only")

    # --- Changes of the tubes -----------------------------------------------------------------------------------------

    @property
    def size(self) -> int:
        """Number Q of directions."""
        return sum(columns_of(self.wrt, self.state.problem.n)) if self.along is None else self.along.shape[1]

    def _of_tubes(self, quantity: str) -> Array:
        """Change (n, Q) of a quantity of the tubes; (1, Q) of the sheath."""
        n = self.state.problem.n
        rows, counts = 1 if quantity in SINGLE else n, columns_of(self.wrt, n)
        columns = [
            CHANGED[name].get(quantity, 0.0) * np.eye(rows, count) for name, count in zip(self.wrt, counts, strict=True)
        ]
        together = np.concatenate(columns, axis=1)
        return together if self.along is None else together @ self.along

    @property
    def _moves_axes(self) -> bool:
        """True if the axes of tubes move in the cross-section."""
        return bool({"offset", "angle"} & set(self.wrt))

    @cached_property
    def _levers(self) -> Array:
        """Change (n, 2, Q) of the levers of the tubes, m."""
        bundle = self.state.problem.bundle
        c, s, d = (each[:, None] for each in (np.cos(bundle.angle), np.sin(bundle.angle), bundle.offset))
        out, turned = self._of_tubes("offset"), d * self._of_tubes("angle")
        return np.stack([s * out + c * turned, -c * out + s * turned], axis=1)

    def _longer(self, bend: Array) -> Array:
        """Change (m, Q) of the lengths h of elements at kappa (2 N,), by the levers alone."""
        problem = self.state.problem
        if not self._moves_axes:
            return np.zeros((len(problem.order), self.size))
        turned = problem.before @ bend.reshape(-1, 2)
        changes = np.einsum("mc,mcq->mq", turned, problem.at_boundaries(self._levers))
        return -np.asarray(problem.lengths_by_boundaries @ changes)

    def _longer_adjoint(self, forces: Array) -> Array:
        """Derivative (2 N, Q) of forces (m,) times `_longer`, by kappa."""
        problem = self.state.problem
        by_boundary = (problem.lengths_by_boundaries.T @ forces)[:, None, None] * problem.at_boundaries(self._levers)
        return np.asarray(-np.tensordot(problem.before, by_boundary, (0, 0)).reshape(-1, self.size))

    @cached_property
    def _data(self) -> Array:
        """Change (N, 5 n + 1, Q) of kb, kt, m, d, phi and the sheath at the points."""
        problem = self.state.problem
        bundle, present, curved = problem.bundle, problem.present[..., None], problem.curved[..., None]
        kb, kt = self._of_tubes("bending_stiffness"), self._of_tubes("torsional_stiffness")
        m = bundle.curvature[:, None] * kb + bundle.bending_stiffness[:, None] * self._of_tubes("curvature")
        everywhere = np.concatenate([self._of_tubes(name) for name in ("offset", "angle", "sheath")])
        same = np.broadcast_to(everywhere, (len(present), *everywhere.shape))
        return np.concatenate([present * kb, present * kt, curved * m, same], axis=1)

    @cached_property
    def _straight(self) -> Array:
        """Change (m, Q) of the lengths h of elements at fixed kappa, m."""
        problem = self.state.problem
        transition, end = self._of_tubes("transition"), self._of_tubes("end")
        moved = np.zeros((len(problem.order), self.size))
        for k, boundary in enumerate(problem.order):
            for i in boundary.tubes:
                moved[k] += (end if i in boundary.ends else transition)[i]
            for quantity in ("rigid_length", "rigid_from") if boundary.of_sheath else ():
                if abs(boundary.arc_length - getattr(problem.bundle, quantity)) <= SAME_PLACE:
                    moved[k] += self._of_tubes(quantity)[0]
        return problem.lengths_by_boundaries @ moved + self._longer(self.state.bend)

    @cached_property
    def _held_bend(self) -> Array:
        """Change (2 N, Q) of kappa at fixed x, which keeps the length 0 of held sections."""
        return self.state.problem.held_bend(self._straight)

    @cached_property
    def _free(self) -> Mask:
        """Mask (n,) of the tubes that are clamped at the plate."""
        return np.isin(np.arange(self.state.problem.n), self.state.problem.sprung, invert=True)

    @cached_property
    def _plate_twist(self) -> Array:
        """Twist rates (n,) of tubes that are clamped at the plate, 0 of others, rad/m."""
        state, problem = self.state, self.state.problem
        at_plate, k = problem.tableau.basis((0.0,), 0)[0], problem.tableau.degree
        length = np.where(problem.present[:k], state.length[:k], 1.0)
        return np.where(self._free, (at_plate @ state.turn[:k]) / (at_plate @ length), 0.0)

    @cached_property
    def _at_plate(self) -> Array:
        """Change (n, Q) of the rotations at the plate at fixed x: a clamp that moves back gives a transmission."""
        return self._of_tubes("alpha") + self._plate_twist[:, None] * self._of_tubes("transmission")

    @cached_property
    def _softer(self) -> Array:
        """Relative change (s, Q) of the stiffnesses kt / |beta| of the transmissions."""
        problem, sprung = self.state.problem, self.state.problem.sprung
        kt, length = self._of_tubes("torsional_stiffness")[sprung], self._of_tubes("transmission")[sprung]
        bundle = problem.bundle
        return np.asarray(kt.T / bundle.torsional_stiffness[sprung] - length.T / bundle.transmission[sprung]).T

    # --- Change of the equilibrium ------------------------------------------------------------------------------------

    @cached_property
    def _local(self) -> Array:
        """Table of the changes at fixed x."""
        problem, n = self.state.problem, self.state.problem.n
        out = np.zeros((len(problem.weight), 2 * n + 3, self.size))
        out[:, :n] = self._at_plate
        out[:, 2 * n : -1] = self._held_bend.reshape(-1, 2, self.size)
        out[:, -1] = self.lengths[problem.point_section]
        return out

    @cached_property
    def _tubes_by(self) -> tuple[Array, Array]:
        """Gradient (N, 5 n + 1) of the energy by the data; derivative (N, 2 n + 3, 5 n + 1) of `by_local` by them."""
        first, mixed, _ = self._changes(np.zeros(self._local.shape[:2]), np.zeros(self._local.shape[:2]))
        return first, mixed

    def _changes(self, left: Array, right: Array) -> _EnergyChanges:
        """Results of `bundle_energy_changes` at the points, for directions (N, 2 n + 3)."""
        state, problem = self.state, self.state.problem
        count, n = state.theta.shape
        local = np.column_stack([state.theta, state.turn, state.bend, state.h])
        outputs = mapped(bundle_energy_changes(n), count)(local, *problem.inputs, left, right)
        first, mixed, third = (part.copy() for part in outputs)
        # CasADi stores (5 n + 1, 2 n + 3) by columns.
        return _EnergyChanges(first, mixed.reshape(count, 2 * n + 3, 5 * n + 1), third)

    @cached_property
    def gradient(self) -> Array:
        """Change (U, Q) of the gradient at fixed x."""
        state, problem = self.state, self.state.problem
        by_point = state.local_hessian @ self._local
        if self._data.any():
            by_point += self._tubes_by[1] @ self._data
        right = problem.adjoint_sums(problem.weight[:, None, None] * by_point)
        right[problem.sprung_rows] += state.x[problem.sprung_rows, None] * self._softer
        if state.loading is not None:
            count, m = 2 * len(problem.weight), len(problem.order)
            by_place = state.loading.second @ self._placed(self._held_bend)
            follow = by_place[:count] + problem.lengths_by_bend.T @ by_place[count : count + m]
            right[problem.split :] -= state.factor * problem.bend_map.T @ follow
            right -= state.factor * state.loading.torsional_slope @ self._held_bend
        if self._moves_axes:
            # Forces on the lengths, less those that hold sections of length 0.
            forces = problem.in_section @ (problem.weight * state.by_local[:, -1])
            if state.loading is not None:
                forces -= state.factor * state.loading.first[2 * len(problem.weight) :][: len(forces)]
            forces[[*problem.held]] -= holding_forces(state)
            right[problem.split :] += problem.bend_map.T @ self._longer_adjoint(forces)
        return right

    @cached_property
    def x(self) -> Array:
        """Derivative (U, Q) of the unknowns."""
        if self.border is None:
            return np.asarray(-scipy.linalg.solve(self.state.hessian, self.gradient))
        return bordered_response(self.state.hessian, self.border, self.gradient)[:-1]

    @property
    def lengths(self) -> Array:
        """Change (m, Q) of the lengths h of elements at fixed x, m."""
        return self._straight + self.state.problem.lengths_by_bend @ self._held_bend

    def _placed(self, bend: Array) -> Array:
        """Changes (2 N + m + n, Q) of kappa, h and own lengths, on which the work of a load depends, with kappa."""
        h = self._straight + self.state.problem.lengths_by_bend @ bend
        return np.concatenate([bend, h, self._of_tubes("end")])

    @cached_property
    def changes(self) -> Array:
        """Table of all changes."""
        out = self._local.copy()
        for q, step in enumerate(self.x.T):
            out[..., q] += self.state.problem.push(step)
        return out

    @property
    def _bend(self) -> Array:
        """Change (2 N, Q) of kappa."""
        return self.changes[:, -3:-1].reshape(-1, self.size)

    # --- Energy and curvature -----------------------------------------------------------------------------------------

    @cached_property
    def energy(self) -> Array:
        """Derivative (Q,) of the elastic energy, J."""
        problem, state = self.state.problem, self.state
        by_point = problem.weight[:, None] * state.by_local
        out = np.tensordot(by_point, self.changes, 2)
        spring = state.x[problem.sprung_rows]
        out += spring @ self.x[problem.sprung_rows] + spring**2 @ self._softer / 2
        # Where a clamp moves back from the plate, the new transmission is twisted as the tube is.
        twisted = problem.bundle.torsional_stiffness * self._plate_twist**2 / 2
        out += twisted @ self._of_tubes("transmission")
        if self._data.any():
            out += np.tensordot(problem.weight[:, None] * self._tubes_by[0], self._data, 2)
        return np.asarray(out)

    @property
    def total_bend(self) -> float:
        """Integral of the squared curvature, 1/m."""
        return float(self.state.problem.weight @ ((self.state.bend**2).sum(1) / self.state.h))

    @cached_property
    def bend(self) -> Array:
        """Derivative (Q,) of `total_bend`, 1/m."""
        state, weight = self.state, self.state.problem.weight
        u = state.bend / state.h[:, None]
        by_h = -(weight * (u**2).sum(1)) @ self.changes[:, -1]
        return np.asarray(np.tensordot(2 * weight[:, None] * u, self.changes[:, -3:-1], 2) + by_h)

    # --- Shape --------------------------------------------------------------------------------------------------------

    @cached_property
    def shape(self) -> ArmShape:
        """Shape of the arm."""
        return bundle_arm(self.member.rotations, self.state)

    @property
    def cuts(self) -> Array:
        """Arc lengths (P + 1,) of the ends of the elements, m."""
        return self.shape.arc_length[:: len(ENDS) - 1]

    @cached_property
    def moved(self) -> Array:
        """Motion (p, Q) along the arm of the points of the shape, m."""
        k = self.state.problem.tableau.degree
        h = self.changes[::k, -1]
        start = np.cumsum(h, axis=0) - h
        return along_elements(start[:, None] + ENDS[:, None] * h[:, None], len(h))

    @cached_property
    def _oriented(self) -> tuple[Array, Array]:
        """Change (N, 3, Q) of the tangents at the points, and turn (3, Q) of the tip frame about world axes, rad."""
        orientation = orient(self.state.problem.mesh, self.state.bend)
        stage = orientation.stage
        turned = (orientation.stage_slope.reshape(4 * len(stage), -1) @ self._bend).reshape(len(stage), 4, self.size)
        return tangent_slopes(stage) @ turned, orientation.turn_slope() @ self._bend

    @cached_property
    def position(self) -> Array:
        """Derivative (p, 3, Q) of the points of the shape at fixed arc lengths, m; of the last one, of the tip."""
        state, problem, k = self.state, self.state.problem, self.state.problem.tableau.degree
        tangent = tangents(orient(problem.mesh, state.bend).stage)
        # The offset in an element is h int t dx: with the polynomial of t through the points.
        rates = state.h[:, None, None] * self._oriented[0] + tangent[..., None] * self.changes[:, None, -1]
        out = cumulate(problem.tableau, rates.reshape(-1, k, 3, self.size))
        out[:-1] -= self.shape.frame[:-1, :, 2, None] * self.moved[:-1, None]
        return np.asarray(out)

    @property
    def tip_position(self) -> Array:
        """Derivative (3, Q) of the tip position, m."""
        return np.asarray(self.position[-1])

    @property
    def tip_rotation(self) -> Array:
        """Turn (3, Q) of the tip frame about world axes, rad."""
        return self._oriented[1]

    @property
    def tip_rotations(self) -> Array:
        """Derivative (n, Q) of theta at the ends of the tubes, rad."""
        return self._at_plate + self.state.problem.tip_rows @ self.x

    # --- Curvature at a place, strain ---------------------------------------------------------------------------------

    def curvature_at(self, fraction: float) -> tuple[Array, Array]:
        """Curvature (2,) in the Bishop frame at a fraction of the arm's length, 1/m, and its change (2, Q)."""
        degree, (element, x) = self.state.problem.tableau.degree, place_of(self, fraction)
        values, rates = (self.state.problem.tableau.basis((x,), order)[0] for order in (0, -1))
        inside = slice(element * degree, (element + 1) * degree)
        kappa, h = self.state.bend[inside], self.state.h[inside][0]
        bend, change = self.changes[inside, -3:-1], self.changes[inside][0, -1]
        u = values @ kappa / h
        # The place stays at its fraction of the whole arm, and so moves within its element.
        ends = self.moved[:: len(ENDS) - 1][element : element + 2]
        passed = (fraction * self.moved[-1] - (1 - x) * ends[0] - x * ends[1]) / h
        moved = np.tensordot(values, bend, 1) / h - np.outer(u, change / h)
        return u, moved + np.outer(rates @ kappa / h, passed)

    def along_tube(self, tube: int) -> TubeAlongArm:
        """State of a tube at ENDS of the elements that it runs through."""
        problem, state, k = self.state.problem, self.state, self.state.problem.tableau.degree
        first, at = np.flatnonzero(problem.present[::k, tube]) * k, tuple(ENDS.tolist())
        points = first[:, None] + np.arange(k)
        values, integrals = problem.tableau.basis(at, 0), problem.tableau.basis(at, 1)
        n, start = problem.n, problem.tableau.matrix[0]
        turn, dturn = state.turn[points, tube], self.changes[points, n + tube]
        # theta at the first point, less the turn up to there, is theta where the element begins.
        theta = (state.theta[first, tube] - turn @ start)[:, None] + turn @ integrals.T
        dtheta = self.changes[first, tube] - np.einsum("k,ekq->eq", start, dturn)
        dtheta = dtheta[:, None] + np.einsum("xk,ekq->exq", integrals, dturn)
        bend, dbend = (np.einsum("xk,ekc...->exc...", values, table[points]) for table in (state.bend, self._bends))
        lever, dlever = problem.bundle.levers[tube], self._levers[tube]
        length = state.h[first][:, None] + bend @ lever
        longer = self.changes[first, -1][:, None] + np.einsum("c,excq->exq", lever, dbend) + bend @ dlever
        u = bend / length[..., None]
        du = (dbend - u[..., None] * longer[:, :, None]) / length[..., None, None]
        natural = problem.bundle.curvature[tube] * problem.curved[first, tube]
        dnatural = problem.curved[first, tube, None] * self._of_tubes("curvature")[tube]
        return TubeAlongArm(theta, u, natural, dtheta, du, dnatural)

    @property
    def _bends(self) -> Array:
        """Change (N, 2, Q) of kappa at the points."""
        return self.changes[:, -3:-1]

    # --- Margin -------------------------------------------------------------------------------------------------------

    @cached_property
    def margin(self) -> Array:
        """Derivative (Q,) of the margin; NaN at a double eigenvalue."""
        return self._margin(one_of_two=False)

    @cached_property
    def one_margin(self) -> Array:
        """Derivative (Q,) of the margin; at a double eigenvalue, of one of its modes."""
        return self._margin(one_of_two=True)

    def _margin(self, *, one_of_two: bool) -> Array:
        state, mu = self.state, self.member.margin(self.state)
        if mu >= FLAT:
            return np.zeros(self.size)
        symmetric, form = self.member.descends or not state.factor, margin_form(state)
        pair = modes(form, symmetric=symmetric, any_of_two=one_of_two)
        if pair is None:
            return np.full(self.size, np.nan)
        value, left, right = pair
        pairing = np.vdot(left, right)
        # The forms are bilinear: of a mode that oscillates its real and imaginary parts count apart.
        out = np.zeros(self.size, dtype=complex)
        for one, factor in ((left.real, 1.0), (left.imag, -1j)):
            for other, times in ((right.real, 1.0), (right.imag, 1j)):
                if one.any() and other.any():
                    out += (
                        factor * times * self._forms_change(mode_of(state, one), mode_of(state, other), complex(value))
                    )
        return np.asarray(np.real(out / pairing))

    def stiffness(self, direction: Array) -> Array:
        """Derivative (Q,) of the second variation along a direction (U,) of the unknowns."""
        return self._forms_change(BundleMode(direction, direction), BundleMode(direction, direction), 0.0)

    def _forms_change(self, left: BundleMode, right: BundleMode, value: complex) -> Array:
        """Change (Q,) of the second variation less `value` times T, for two modes."""
        state, problem, n = self.state, self.state.problem, self.state.problem.n
        out, stiffer = self._elastic_change(left.unknowns, right.unknowns), np.zeros(self.size)
        if state.loading is not None:
            moves = self._placed(self._bend)
            # Of T, bending counts from the curvature that the rotations of the mode bring by themselves.
            stiffer += out - self._elastic_change(left.relaxed, right.relaxed)
            out -= state.factor * work_second_change(state, left.unknowns, right.unknowns) @ moves
            out -= self._work_change(left.unknowns, right.unknowns)
        # Torsion of T: kt p^2 / g of the tubes, and that of the transmissions, 1 of unknowns at scale.
        a, b = problem.push(left.unknowns)[:, n : 2 * n], problem.push(right.unknowns)[:, n : 2 * n]
        length, kt = np.where(problem.present, state.length, 1.0), problem.bundle.torsional_stiffness
        stretched = self.changes[:, None, -1] + problem.bundle.levers @ self.changes[:, -3:-1]
        stretched += np.einsum("ac,icq->aiq", state.bend, self._levers)
        energy = (problem.weight[:, None] * problem.present * a * b / length)[..., None]
        softened = self._data[:, n : 2 * n] - (kt / length)[..., None] * stretched
        stiffer += (energy * softened).sum((0, 1))
        sprung = left.unknowns[problem.sprung_rows] * right.unknowns[problem.sprung_rows]
        stiffer += sprung @ self._softer
        return np.asarray(out - value * stiffer - self._new_transmissions(left, right, float(np.real(value))))

    def _elastic_change(self, left: Array, right: Array) -> Array:
        """Change (Q,) of the second variation of the elastic energy for two directions (U,)."""
        problem, n = self.state.problem, self.state.problem.n
        by_point = problem.weight[:, None] * self._changes(problem.push(left), problem.push(right)).third
        out = np.tensordot(by_point[:, : 2 * n + 3], self.changes, 2)
        out += np.tensordot(by_point[:, 2 * n + 3 :], self._data, 2)
        for one, other in ((left, right), (right, left)) if self._moves_axes else ():
            bend, h = self._pushed(one)
            forced = problem.weight[:, None] * (self.state.local_hessian @ problem.push(other)[..., None])[..., 0]
            out += forced[:, -3:-1].ravel() @ bend + (problem.in_section @ forced[:, -1]) @ h
        sprung = problem.sprung_rows
        return np.asarray(out + (left[sprung] * right[sprung]) @ self._softer)

    def _pushed(self, step: Array) -> tuple[Array, Array]:
        """Changes of kappa (2 N, Q) and of the lengths h (m, Q) by a step (U,), as the levers change."""
        problem = self.state.problem
        longer = self._longer(problem.bend_map @ step[problem.split :])
        bend = problem.held_bend(longer)
        return bend, longer + problem.lengths_by_bend @ bend

    def _work_change(self, left: Array, right: Array) -> Array:
        """Change (Q,) of the second variation of the work for two directions (U,), as the levers change."""
        state, problem = self.state, self.state.problem
        if not self._moves_axes or state.loading is None:
            return np.zeros(self.size)
        out, none = np.zeros(self.size), np.zeros((problem.n, self.size))
        for one, other, second in ((left, right, state.loading.second), (right, left, state.loading.second.T)):
            bend = problem.bend_map @ other[problem.split :]
            along = second @ np.concatenate([bend, problem.lengths_by_bend @ bend, none[:, 0]])
            out += along @ np.concatenate([*self._pushed(one), none])
        out += left @ state.loading.torsional_slope @ self._pushed(right)[0]
        return state.factor * out

    def _new_transmissions(self, left: BundleMode, right: BundleMode, mu: float) -> Array:
        """Decrease (Q,) of the margin where a clamp moves back from the plate: the mode twists what lies between."""
        problem, n = self.state.problem, self.state.problem.n
        longer = self._of_tubes("transmission") * self._free[:, None]
        if not longer.any():
            return np.zeros(self.size)
        if not self.member.descends:
            return np.where(longer.any(0), np.nan, 0.0)

        def torque(mode: BundleMode) -> Array:
            """Torques (n,) of a mode at the plate."""
            along = (1 - mu) * problem.push(mode.unknowns) + mu * problem.push(mode.relaxed)
            return np.asarray(problem.weight @ (self.state.local_hessian @ along[..., None])[:, :n, 0])

        softness = 1 / (problem.bundle.torsional_stiffness * (1 - mu))
        return np.asarray((softness * torque(left) * torque(right)) @ longer)


def bordered_response(hessian: Array, border: Array, gradient: Array, longer: Array | None = None) -> Array:
    """Changes (U + 1, Q) of x and of a multiplier f of g = f a, with a (U,) the border, as g changes by (U, Q).

    They keep a.x, or change it by -`longer` (Q,).
    """
    matrix = np.block([[hessian, border[:, None]], [border, np.zeros(1)]])
    below = np.zeros(gradient.shape[1]) if longer is None else longer
    return np.asarray(-scipy.linalg.solve(matrix, np.vstack([gradient, below])))


def linearise_bundle(
    equilibrium: Equilibrium, wrt: Sequence[str], side: int = 1, along: Array | None = None
) -> LinearisedBundle:
    """Derivatives of an equilibrium of a bundle robot; `wrt`, `side` and `along` as in `Directions`.

    Raises:
        InputError: an unknown name or side.
        SolveError: the equilibrium is a fold.
    """
    check_wrt(wrt, side, (*PARAMETERS, *ARRANGEMENT))
    if abs(equilibrium.margin) < APART:
        raise SolveError("the equilibrium is a fold (margin 0), where derivatives are infinite")
    point = _point_of(equilibrium)
    return LinearisedBundle(point.member, point.state, tuple(wrt), along)


_point_of = lru_cache(maxsize=8)(point_of)
