"""Derivatives of an equilibrium of tubes made of pieces, by the implicit function theorem on a mesh that moves along.

Between breakpoints that keep their order every collocation point moves linearly with them, and so do the places on the
tubes that lie there: the collocated problem is a smooth function of the parameters, and is differentiated as it stands.
With phi = alpha - S B M of the reduced problem and H its Hessian,

    d phi = L H^-1 L^-1 (explicit change of alpha - S B M),

the tip follows from the changes of h u on every piece, the energy by the envelope theorem, and the margin, a Rayleigh
quotient, at its mode.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
import scipy

from ..block.transcription.arm import Profile, integrate
from ..block.transcription.buffered import mapped, section_function
from ..block.transcription.green import INWARDS
from ..block.transcription.linear import poses_at_points
from ..block.transcription.whole_arm import evaluate_arm
from ..errors import SolveError
from ..physics.certificate import worst_function
from ..robots.breakpoints import COINCIDE, of_pieces
from ..typing import Array
from .derivatives import FLAT
from .member import PlainPoint
from .result import Equilibrium


@dataclass(frozen=True, eq=False)
class Change:
    """What Q parameters change: alpha (Q, n), int ds / kt up to the plate (Q, n), lengths of the pieces (Q, P), at all
    their points (Q, P, K, n) 1 / kt, kb, m and phase, and the natural turn (Q, n) up to the ends of the tubes."""

    base: Array
    transmission: Array
    length: Array
    rate: Array
    stiffness: Array
    moment: Array
    phase: Array
    wound: Array

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


class Linearised:
    """A solved problem, linearised."""

    def __init__(self, point: PlainPoint, equilibrium: Equilibrium) -> None:
        problem = point.member.problem
        assert problem.assembly.lengthwise is not None
        self.problem, self.point = problem, point
        self.here, self.table = problem.here, problem.assembly.lengthwise
        self.robot, self.t, self.length = equilibrium.robot, problem.mesh.tableau, problem.mesh.length
        self.n = problem.assembly.n_tubes
        self.shape = len(self.length), self.t.degree, self.n
        self.torsion = point.torsion
        self.moments = np.zeros(self.shape)
        self.moments[problem.mesh.collocated] = point.state.moment.reshape(-1, *self.shape[1:])
        self.own = self._wound(self.moments)
        arm = evaluate_arm(problem, point.member.rotations, point.state, self.torsion)
        self.arm, self.tip = arm, arm.position[-1]
        self.frame, self.position = poses_at_points(self.t, self.length, (arm.frame, arm.position, arm.curvature))
        self._look()
        # LAPACK prints where a matrix has no rows, as of tubes that nothing twists.
        hessian = point.state.hessian if problem.size else np.eye(1)
        self.factors = scipy.linalg.lapack.dgetrf(hessian)[:2]

    def _look(self) -> None:
        """Cross-sections at all points, with their derivatives and those of the tubes along them."""
        sections, (pieces, count, n) = self.here.sections, self.shape
        phi = self._inside(self.torsion)
        self.direction = phi + sections.phase.reshape(self.shape)
        out = section_function("linear", pieces * count, n, False)(
            self.direction.reshape(-1, n), sections.stiffness, sections.moment
        )
        u, bending = (part.copy() for part in out[2:4])
        by = [part.reshape(pieces, count, 3 * n, part.shape[1]).swapaxes(2, 3).copy() for part in out[4:8]]
        self.moment_slope, self.u_slope, self.bending_slope = by[0], by[2], by[3][:, :, 0]
        self.u, self.bending = u.reshape(pieces, count, 2), bending.reshape(pieces, count)
        mesh, assembly = self.problem.mesh, self.problem.assembly
        nodes = self.t.nodes
        s, inside = (
            (mesh.start[:, None] + self.length[:, None] * x).ravel()[:, None] + assembly.transmission
            for x in (nodes, nodes + INWARDS * (0.5 - nodes))
        )
        values, rates = self.table.values(s, inside), self.table.rates(s, inside)
        kb, kt, x, y, z = (v.reshape(self.shape) for v in values[:5])
        dkb, dkt, dx, dy, _ = (v.reshape(self.shape) for v in rates[:5])
        there = sections.stiffness.reshape(self.shape) > 0
        size = np.hypot(x, y)
        self.place, self.values = s.reshape(self.shape), values.reshape(len(values), *self.shape)
        solid = np.where(size > 0, size, 1.0)
        # Per length of the tube, of what moves past a point.
        self.passing = (
            dkb * there,
            (dkb * size + kb * (x * dx + y * dy) / solid) * there,
            z + (x * dy - y * dx) / solid**2,
            -dkt / kt**2,
        )

    def _inside(self, torsion: Profile) -> Array:
        """phi (P, K, n) at the points, as collocated."""
        whole = self._torque(torsion) * self.here.rate
        return np.asarray(torsion.rotation[:, None] + self.length[:, None, None] * (self.t.matrix @ whole))

    def _torque(self, torsion: Profile) -> Array:
        return np.asarray(torsion.twist[:, None] + self.length[:, None, None] * (self.t.adjoint @ torsion.moment))

    def change(self, name: str, tube: int) -> Change:
        """What a parameter of a tube changes."""
        one, zero = (np.arange(self.n) == tube).astype(float)[None], np.zeros((1, *self.shape))
        none = np.zeros((1, self.n))
        nothing = Change(none, none, np.zeros((1, len(self.length))), zero, zero, zero, zero, none)
        own, kt = self.robot.tubes[tube], (self.here.rate * one)[None]
        kb, m = (
            (part.reshape(self.shape) * one)[None] for part in (self.here.sections.stiffness, self.here.sections.moment)
        )
        if name == "rotations":
            return replace(nothing, base=one)
        if name == "straight_length":
            return replace(nothing, transmission=one / self.table.values(np.zeros((1, self.n)))[1][0])
        if name == "curvature":
            return replace(nothing, moment=m / own.curvature if own.curvature else kb * self._bendable(tube))
        if name == "bending_stiffness":
            return replace(nothing, stiffness=kb / own.bending_stiffness, moment=m / own.bending_stiffness)
        if name == "torsional_stiffness":
            softer = -1.0 / own.torsional_stiffness
            return replace(nothing, rate=kt * softer, transmission=one * self.here.transmission * softer)
        return self._stretched(tube, one) if name == "curved_length" else self._moved(tube, one)

    def _bendable(self, tube: int) -> Array:
        """(P, K, n) where a tube that is straight would be curved if it had a curvature: behind its straight part, but
        straight pieces stay straight."""
        own, mesh = self.robot.tubes[tube], self.problem.mesh
        s = mesh.start[:, None, None] + self.length[:, None, None] * self.t.nodes[:, None]
        place = s + self.problem.assembly.transmission
        return np.asarray((place > own.straight_length) & (not own.general))

    def _moved(self, tube: int, one: Array) -> Change:
        """A tube moves forward: its breakpoints and all that it is at fixed places."""
        held = 1 / self.table.values(self.problem.assembly.transmission[None])[1][0]
        return self._passing(tube, np.ones_like(self.place) * one, -one * held)

    def _stretched(self, tube: int, one: Array) -> Change:
        """The curved part of a tube becomes longer: all its pieces in proportion, and what varies along them.

        A place x of the tube moves by v = (x - l) / L behind the straight part, l, for each unit of length, L. So does
        the natural turn grow up to there, and int ds / kt up to the plate where the curved part begins behind it.
        """
        own, held = self.robot.tubes[tube], self.problem.assembly.transmission
        straight = np.full(self.n, own.straight_length)
        curve = self.table.values(straight[None])[5][0]

        def moved(place: Array) -> Array:
            return np.maximum(place - own.straight_length, 0.0) / own.curved_length

        rate = 1 / self.table.values(held[None])[1][0]
        grown = np.maximum(self.table.compliant(held) - self.table.compliant(straight), 0.0) / own.curved_length
        change = self._passing(tube, moved(self.place) * one, one * (grown - moved(held) * rate), moved)
        ends = self.table.values(np.array([[t.length for t in self.robot.tubes]]))[5][0]
        turned = np.where(moved(self.place) > 0, self.values[5] - curve, 0.0) / own.curved_length
        wound = one * (ends - curve) / own.curved_length
        return replace(change, phase=change.phase + (turned * one)[None], wound=wound)

    def _passing(
        self, tube: int, moves: Array, transmission: Array, by: Callable[[Array], Array] = np.ones_like
    ) -> Change:
        """A tube whose matter moves by `moves` (P, K, n) at the points, and its breakpoints by a function of where they
        are on it, m; `transmission` (1, n) is the change of int ds / kt up to the plate."""
        assembly, mesh = self.problem.assembly, self.problem.mesh
        cuts = np.append(assembly.start, assembly.total_length)
        own = np.array([s for s in of_pieces(assembly)[tube] if s > COINCIDE])
        mine = np.array([bool((np.abs(own - s) <= 1e-11).any()) for s in cuts])
        moved = np.where(mine, by(cuts + assembly.transmission[tube]), 0.0)
        counts = np.bincount(mesh.section, minlength=assembly.n_sections)
        length = (np.diff(moved) / counts)[mesh.section]
        rank = np.arange(len(length)) - (np.cumsum(counts) - counts)[mesh.section]
        start = moved[mesh.section] + rank * length
        place = (start[:, None] + length[:, None] * self.t.nodes)[..., None] - moves
        kb, m, phase, rate = (part * place for part in self.passing)
        none = np.zeros((1, self.n))
        return Change(none, transmission, length[None], rate[None], kb[None], m[None], phase[None], none)

    def _wound(self, moments: Array) -> Wound:
        """Moments (P, K, n) with the torque that they make."""
        torsion = integrate(self.problem, np.zeros(self.n), moments[self.problem.mesh.collocated])
        return Wound(moments, self._torque(torsion), torsion.twist[0] if len(torsion.twist) else np.zeros(self.n))

    def turned(self, by: Wound, change: Change, gained: Array) -> tuple[Array, Array]:
        """(Q, P, K, n) and (Q, P + 1, n): change of phi at the points and between pieces, of moments that change by
        `gained`."""
        t, h, dh = self.t, self.length[:, None, None], change.length[:, :, None, None]
        more = dh * by.moments + h * gained
        begin = -np.cumsum((t.weights @ more)[:, ::-1], axis=1)[:, ::-1]
        slope = (begin[:, :, None] + t.adjoint @ more) * self.here.rate + by.torque * change.rate
        turning = dh * by.torque * self.here.rate + h * slope
        first = change.base + change.transmission * by.base + self.here.transmission * begin[:, :1].sum(1)
        up_to = first[:, None] + np.cumsum(t.weights @ turning, axis=1)
        between = np.concatenate([first[:, None], up_to], axis=1)
        return between[:, :-1, None] + t.matrix @ turning, between

    def _explicit(self, slope: Array, change: Change) -> Array:
        """(Q, P, K, r) change of what has derivatives `slope` (P, K, r, 3n), at fixed phi."""
        return np.asarray((slope @ change.columns[..., None])[..., 0])

    def answer(self, change: Change) -> Answer:
        """What changes do along the arm."""
        given = self._explicit(self.moment_slope, change)
        explicit, _ = self.turned(self.own, change, given)
        phi = self._solved(explicit)
        whole = replace(change, phase=change.phase + phi)
        gained = self._explicit(self.moment_slope, whole)
        inside, between = self.turned(self.own, change, gained)
        whole = replace(change, phase=change.phase + inside)
        bent = self._explicit(self.u_slope, whole)
        turning = change.length[:, :, None, None] * self.u + self.length[:, None, None] * bent
        return Answer(whole, between, bent, (self.frame[..., :2] @ turning[..., None])[..., 0])

    def columns(self, changes: Sequence[Change]) -> Array:
        """(Q, 8 + n) of every change: tip position and rotation, tip rotations, margin, energy."""
        problem, n, change = self.problem, self.n, together(changes)
        answer, weights = self.answer(change), self.t.weights[:, None]
        turn = answer.turn * weights
        stretch = (self.frame[..., 2] * (weights * change.length[:, :, None, None])).sum((1, 2))
        position = np.cross(turn, self.tip - self.position).sum((1, 2)) + stretch
        cuts = np.append(problem.mesh.start, problem.assembly.total_length)
        index = np.abs(cuts - np.clip(problem.assembly.end, 0.0, cuts[-1])[:, None]).argmin(1)
        tips = answer.between[:, index, np.arange(n)] + change.wound
        last = np.column_stack([self._margin(answer.whole), self._energy(change)])
        return np.concatenate([position, turn.sum((1, 2)), tips, last], axis=1)

    def _solved(self, explicit: Array) -> Array:
        """(Q, P, K, n) change of phi at the coupled points for that of alpha - S B M at fixed phi."""
        problem, chosen, count = self.problem, self.problem.mesh.collocated, len(explicit)
        out = np.zeros((count, *self.shape))
        if not problem.size:
            return out
        right = explicit[:, chosen].reshape(count, -1)[:, problem.flat]
        z = scipy.linalg.lapack.dtrtrs(problem.factor, right.T, lower=1)[0]
        z, failed = scipy.linalg.lapack.dgetrs(*self.factors, z)
        if failed or not np.isfinite(z).all():
            raise SolveError("the equilibrium is a fold (margin 0), where derivatives are infinite")
        inner = np.zeros((count, int(chosen.sum()) * self.shape[1] * self.n))
        inner[:, problem.flat] = (problem.factor @ z).T
        out[:, chosen] = inner.reshape(count, -1, *self.shape[1:])
        return out

    def _softer(self, by: Wound, change: Change) -> Array:
        """(Q,) f' dS f of forces f = weights x moments, where alpha stays."""
        fixed = replace(change, base=np.zeros_like(change.base))
        weights = self.length[:, None, None] * self.t.weights[:, None]
        scale = np.where(self.length > 0, change.length / self.length, 0.0)[:, :, None, None]
        inside, _ = self.turned(by, fixed, -by.moments * scale)
        return -np.asarray((weights * by.moments * inside).sum((1, 2, 3)))

    def _energy(self, change: Change) -> Array:
        """(Q,) of the elastic energy, by the envelope theorem, J."""
        weights = self.t.weights * self.length[:, None]
        bending = (self.t.weights * change.length[:, :, None] * self.bending).sum((1, 2))
        bending += (weights * self._explicit(self.bending_slope[:, :, None], change)[..., 0]).sum((1, 2))
        force = (weights[..., None] * self.moments).sum((0, 1))
        return np.asarray(bending - self._softer(self.own, change) / 2 + change.base @ force)

    def _margin(self, whole: Change) -> Array:
        """(Q,) of the margin, with phase + phi the change of the direction of the pulls; NaN of a double eigenvalue."""
        if not self.problem.size or self.point.margin >= FLAT:
            return np.zeros(len(whole.base))
        if self._mode is None:
            return np.full(len(whole.base), np.nan)
        return self._quotient(self._mode, whole)

    def certificate(self, value: float, y: Array, change: Change) -> Array:
        """(Q,) of the certificate that is `value` at its mode y (N, n), `stability.certificate.worst_case`: what
        bends further off does not matter to it."""
        problem, n = self.problem, self.n
        if not problem.size or value >= FLAT:
            return np.zeros(len(change.base))
        _, form, slope, _ = mapped(worst_function(n), len(y))(problem.stiffness, problem.moment, y)
        gradient = np.concatenate([np.zeros((len(y), n)), slope.reshape(len(y), 2 * n)], axis=1)
        whitened = scipy.linalg.lapack.dtrtrs(problem.factor, y.ravel()[problem.flat], lower=1)[0]
        mode = value, form[:, 0].copy(), gradient, self._forces(whitened)
        return self._quotient(mode, change)

    def _quotient(self, mode: tuple[float, Array, Array, Wound], whole: Change) -> Array:
        """(Q,) change of a least eigenvalue with its `_mode`."""
        problem, chosen, count = self.problem, self.problem.mesh.collocated, len(whole.base)
        value, form, gradient, by = mode
        changed = whole.columns[:, chosen].reshape(count, *gradient.shape)
        scale = np.repeat((whole.length / self.length)[:, chosen], self.shape[1], axis=1)
        out = (problem.weight * scale) @ form + (gradient * changed).sum(2) @ problem.weight
        return np.asarray(out + (value - 1) * self._softer(by, whole))

    @cached_property
    def _mode(self) -> tuple[float, Array, Array, Wound] | None:
        """Least eigenvalue, y' dM y (N,) of its mode, the gradient of that (N, 3 n), and the forces that turn by y;
        None of a double eigenvalue."""
        problem, collocated = self.problem, self.problem.mesh.collocated
        values, vectors = np.linalg.eigh(self.point.state.hessian)
        if len(values) > 1 and values[1] - values[0] < 1e-9:
            return None
        y = np.zeros((int(collocated.sum()) * self.shape[1], self.n))
        y.ravel()[problem.flat] = problem.factor @ vectors[:, 0]
        args = self.direction[collocated].reshape(-1, self.n), problem.stiffness, problem.moment, y
        form, gradient = (part.copy() for part in section_function("variation", len(y), self.n, False)(*args))
        return float(values[0]), form[:, 0], gradient.reshape(len(y), -1), self._forces(vectors[:, 0])

    def _forces(self, whitened: Array) -> Wound:
        """The forces f = S^-1 y that turn the tubes by the mode y, by the triangular factor of S."""
        problem, collocated = self.problem, self.problem.mesh.collocated
        force = np.zeros(problem.moment.shape)
        force.ravel()[problem.flat] = scipy.linalg.lapack.dtrtrs(problem.factor, whitened, lower=1, trans=1)[0]
        moments = np.zeros(self.shape)
        moments[collocated] = (force / problem.weight[:, None]).reshape(-1, *self.shape[1:])
        return self._wound(moments)
