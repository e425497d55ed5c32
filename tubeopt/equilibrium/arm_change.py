"""Derivatives of an arm in equilibrium: of its tip, shape and energy.

A breakpoint that moves uncovers a strip with other tubes: there all derivatives with respect to arc length jump.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..block.transcription.arm import cumulate
from ..block.transcription.collocated import ENDS
from ..block.transcription.responsive import Forcing, Response
from ..block.transcription.standing import SectionInputs, by_data_of, cross, sections_of, values_of
from ..errors import InputError, SolveError
from ..robots.assembly import ROUND_OFF
from ..robots.load import FORCE, MOMENT
from ..robots.order import SAME_END, twisted_tube
from ..typing import Array
from .directions import Directions

PLACES = tuple(ENDS.tolist())
"""Fractions of a piece at which its shape points lie."""

TIP = 1e-9
"""Distance (m) from the tip up to which a force acts at it."""

AHEAD = 100 * SAME_END
"""Motion (m) of the fastest end, to test whether a moment passes from one tube to another."""


@dataclass(frozen=True, eq=False)
class Section:
    """u (2,) at a place of the arm, and the changes of theta, kb and m (3 n, Q) and of u (2, Q) while it moves."""

    curvature: Array
    by_tubes: Array
    by_curvature: Array


class ArmChange(Directions):
    """Derivatives of an arm in equilibrium in Q directions, computed when they are read.

    Raises:
        InputError: the tip draws back from under a force or moment that acts where it is.
        SolveError: the equilibrium is a fold.
    """

    @cached_property
    def forcing(self) -> Forcing:
        """Derivatives of the equations in all directions, with the motion of breakpoints."""
        forcing = self.entered.forcing
        forcing.jumps[:] += (self.strips.onto[:, None] * self._gains.T) @ self.widths
        return forcing

    @cached_property
    def _force_there(self) -> Array:
        """(T, 3) force on the cross-section at the strips, on the side to which they lie."""
        here, index = self.here, self.strips.index
        if self.side < 0:
            return np.asarray(here.t.basis((1.0,), 0)[0] @ here.force[index - 1])
        table = np.concatenate([here.t.basis((0.0,), 0)[0] @ here.force, here.tip_force[None]])
        return np.asarray(table[index])

    @cached_property
    def _values_there(self) -> tuple[Array, Array, Array, Array]:
        """Torque, curvature, bending energy and stretch in the strips after the motion, then before it."""
        return values_of(self.given_there, self.here.offsets)

    @cached_property
    def _rates_there(self) -> Array:
        """(2 T, 2 n + 6) derivatives of the state with respect to arc length in the strips."""
        here, points, n = self.here, self.strips, self.n
        index, count = points.index, len(points.index)
        both = np.concatenate([index, index])
        frame = here.end_frame[both]
        fall, curvature, _, stretch = self._values_there
        rates = np.zeros((2 * count, here.size))
        # phi' = g t / kt, the frame turns by R (u_x, u_y, 0), and t' = M.
        rates[:, :n] = points.rate * self._torque_there * stretch
        rates[:, n : n + 3] = (frame[..., :2] @ curvature[..., None])[..., 0]
        rates[:, n + 3 : 2 * n + 3] = fall
        if here.load is None:
            return rates
        # m' = -e_3 x n less the moment per length.
        falling = -cross(frame[:count, :, 2], self._force_there)
        if here.load.distributed is not None:
            along = here.load.per_length(self.cuts[index] + self.side * ROUND_OFF)[:, MOMENT]
            falling -= along
            felt = (along * frame[:count, :, 2]).sum(1)
            rates[np.arange(2 * count), n + 3 + points.outermost] -= np.concatenate([felt, felt])
        rates[:count, 2 * n + 3 :] = rates[count:, 2 * n + 3 :] = falling
        return rates

    @property
    def _torque_there(self) -> Array:
        """(2 T, n) torques at the strips."""
        here, index = self.here, self.strips.index
        torque = (here.torque_plate_side if self.side < 0 else here.torque_tip_side)[index]
        return np.concatenate([torque, torque])

    def _gained(self, there: Array) -> Array:
        """(T, ...) change per width of a strip of a quantity per length (2 T, ...), after and before the motion."""
        # A breakpoint that moves replaces one cross-section by another: the jump of the quantity counts.
        new, old = (there.T * self.strips.there).T.reshape(2, -1, *there.shape[1:])
        return np.asarray(self.side * (new - old))

    @cached_property
    def _gains(self) -> Array:
        """(T, 2 n + 6) change of the state per width of a strip."""
        return self._gained(self._rates_there) if len(self.strips.index) else np.zeros((0, self.here.size))

    @cached_property
    def _stored(self) -> Array:
        """(T,) change of the elastic energy per width of a strip, J/m."""
        if not len(self.strips.index):
            return np.zeros(0)
        # Bending energy and torsion: t phi' / 2 per length, phi' = g t / kt.
        stored = self._values_there[2] + (self._rates_there[:, : self.n] * self._torque_there).sum(1) / 2
        return self._gained(stored)

    @cached_property
    def given_there(self) -> SectionInputs:
        """theta, kb, m (2 T, n) and b (2 T, 2) in the strips after the motion, then before it."""
        here, points = self.here, self.strips
        index, tubes = points.index, points.sections
        frame, moment = here.end_frame[index], here.moment_plate_side if self.side < 0 else here.moment_tip_side
        bent = (frame[..., :2].swapaxes(1, 2) @ moment[index][..., None])[..., 0]
        phi = here.phi_ends[index]
        return np.concatenate([phi, phi]) + tubes.phase, points.stiffness, tubes.moment, np.concatenate([bent, bent])

    @cached_property
    def response(self) -> Response:
        """Derivatives of the state along the arm."""
        forcing = self.forcing
        here, load = self.here, self.here.load
        if load is not None:
            self._must_stay()
            if load.distributed is not None:
                force = load.per_length(self.cuts[-1:] + self.side * ROUND_OFF)[0, FORCE]
                forcing.force[:] += np.outer(force, self._longer)
        return here.respond(forcing)

    def _must_stay(self) -> None:
        """Raise an error for motions that retract the tip or the end of a tube from a load that acts there."""
        here, ends, points = self.here, self.assembly.end, self.breakpoints
        assert here.load is not None
        tip = self.cuts[-1]
        if any(part.at >= tip - TIP for part in here.load.points) and (self.side * self._longer < 0).any():
            raise InputError(
                f"points of load act at the tip, {1e3 * tip:g} mm from the plate, from where it draws back; take "
                "derivatives by what moves it out (side=1)"
            )
        acts = [self.cuts[k] for k, *_ in here.joints] + [np.inf] * any(here.load.moment)
        if not acts:
            return
        at_end, pace = np.abs(points.place - ends[points.tube]) <= ROUND_OFF, np.zeros((self.n, self.size))
        pace[points.tube[at_end]] = self.side * self.entered.speed[at_end]
        moved = ends + AHEAD * pace.T / np.maximum(np.abs(pace).max(0), 1e-300)[:, None]
        left = (twisted_tube(moved[:, None], acts) != twisted_tube(ends, acts)).any(1)
        if left.any():
            tube = np.flatnonzero(pace[:, left].any(1))[0]
            raise SolveError(
                f"the derivative with respect to the end of tube {tube + 1} does not exist: a moment acts there"
            )

    @cached_property
    def _longer(self) -> Array:
        """(Q,) change of the arm's length."""
        at_tip = self.strips.index == self.here.pieces
        return np.asarray((self.side * self.strips.grown * at_tip) @ self.widths)

    @property
    def pushed(self) -> Array:
        """(3, Q) motion of the tip along its axis with the tubes that end there, m."""
        return np.asarray(self.here.end_frame[-1, :, 2, None] * self._longer)

    @cached_property
    def tip_position(self) -> Array:
        """(3, Q) of the tip, m."""
        here = self.here
        # The tip moves by int psi x e ds = -int e x psi ds, and by what it is pushed out.
        moved = here.weights.ravel() @ (here.about_axis @ self.response.psi).reshape(-1, 3 * self.size)
        return np.asarray(self.pushed - moved.reshape(3, self.size))

    @property
    def tip_rotation(self) -> Array:
        """(3, Q) turn vector of the tip frame in the plate frame, rad."""
        return self.response.state[-1, self.n : self.n + 3]

    @property
    def tip_rotations(self) -> Array:
        """(n, Q) of theta at each tube's own end."""
        ends = np.clip(self.assembly.end, 0.0, self.cuts[-1])
        index = np.abs(self.cuts - ends[:, None]).argmin(1)
        return np.asarray(self.response.state[index, np.arange(self.n)] + self.entered.wound)

    @cached_property
    def moved(self) -> Array:
        """(m, Q) motion of the shape points along the arm, if they keep their places in the pieces of the mesh."""
        return self._moved(self.arm.arc_length)

    def _moved(self, s: Array) -> Array:
        """(len(s), Q) motion of places that divide the stretches between breakpoints as they do; of those that coincide
        the foremost counts."""
        points, pace = self.breakpoints, self.side * self.entered.speed
        each = [own for own in points.together if points.index[own[0]] > 0]
        knots = np.concatenate([[0.0], self.cuts[points.index[[own[0] for own in each]]]]) if each else np.zeros(1)
        speed = self.side * np.array([pace[[*own]].max(0) for own in each])
        fraction = [np.interp(s, knots, row) for row in np.eye(len(knots))[1:]]
        return np.stack(fraction, axis=1) @ speed if fraction else np.zeros((len(s), self.size))

    @cached_property
    def turned(self) -> Array:
        """(m, 3, Q) turn vector of the frames at the shape points that move so, rad."""
        here, n = self.here, self.n
        rates = here.frame[..., :2] @ self.response.curvature
        inside = here.t.basis(PLACES, 1)[1:] @ rates.reshape(here.pieces, here.degree, 3 * self.size)
        inside = (here.h * inside).reshape(here.pieces, len(PLACES) - 1, 3, self.size)
        turned = (self.response.state[:-1, None, n : n + 3] + inside).reshape(-1, 3, self.size)
        # A place that moves along the arm also turns with the arm's bend there.
        bend = (self.arm.frame[1:, :, :2] @ self.arm.curvature[1:, :, None]) * self.moved[1:, None]
        return np.concatenate([np.zeros((1, 3, self.size)), turned + bend])

    @cached_property
    def _sections_along(self) -> tuple[Array, Array]:
        """(P, K, n) phi' and (P, K, 3 n + 2) phase, kb, m and b at the points."""
        here = self.here
        return here.rate * here.stretched, np.concatenate([here.phase, here.stiffness, here.moments, here.bent], axis=2)

    @cached_property
    def sections(self) -> tuple[Array, Array]:
        """(P, 5, 3 n) theta, kb and m, and (P, 5, 2) u at ENDS of every piece."""
        here, n, (rate, table) = self.here, self.n, self._sections_along
        at = here.t.basis(PLACES, 0) @ table
        at[..., :n] += here.phi_ends[:-1, None] + here.h * (here.t.basis(PLACES, 1) @ rate)
        result = sections_of(_parts(at.reshape(-1, 3 * n + 2)), here.offsets)
        return at[..., : 3 * n], result.curvature.reshape(*at.shape[:2], 2)

    def section(self, k: int, x: float, moves: Array) -> Section:
        """The cross-section at a fraction x of piece k, while the place moves along the arm by (Q,)."""
        here, n, (rate, table) = self.here, self.n, self._sections_along
        h, response, forcing = here.length[k], self.response, self.forcing
        inside, whole, slope = (here.t.basis((x,), times)[0] for times in (0, 1, -1))
        at, by = inside @ table[k], slope @ table[k] / h
        at[:n] += here.phi_ends[k] + h * (whole @ rate[k])
        # Along the arm theta changes by phi' beside the polynomials of phase and precurvature.
        by[:n] += inside @ rate[k]
        change = by[:, None] * moves
        change[: 3 * n] += _at(inside, forcing.data[k])
        if here.load is not None:
            change[3 * n :] += _at(inside, response.bent[k])
        change[:n] += response.state[k, :n] + h * _at(whole, here.wound(response, forcing, k))
        inputs = _parts(at[None])
        result, own = sections_of(inputs, here.offsets), by_data_of(inputs, here.offsets)[1]
        turned = result.by_curvature[0] @ np.concatenate([change[:n], change[3 * n :]]) + own[0] @ change[n : 3 * n]
        return Section(result.curvature[0], change[: 3 * n], turned)

    @cached_property
    def position(self) -> Array:
        """(m, 3, Q) of the shape points at fixed arc lengths; the last one is the tip, which moves along."""
        here = self.here
        out = cumulate(here.t, here.h[..., None] * (-here.about_axis @ self.response.psi))
        out[-1] += self.pushed
        return out

    @property
    def total_bend(self) -> float:
        """int |u|^2 ds along the arm, 1/m."""
        return float(self.here.weights.ravel() @ (self.here.at.curvature**2).sum(1))

    @cached_property
    def bend(self) -> Array:
        """(Q,) of int |u|^2 ds, 1/m."""
        here, u = self.here, self.here.at.curvature
        # d(int |u|^2 ds) = int 2 u . du ds, and the jump of |u|^2 where breakpoints move.
        pull = (2 * here.weights.ravel()[:, None] * u).ravel()
        squared = self._gained((self._values_there[1] ** 2).sum(1))
        return np.asarray(pull @ self.response.curvature.reshape(-1, self.size) + squared @ self.widths)

    @cached_property
    def energy(self) -> Array:
        """(Q,) of the elastic energy, J."""
        here, forcing, n = self.here, self.forcing, self.n
        moved, weights, size = self.response, here.weights.ravel(), self.size
        by = weights[:, None] * here.by_energy.reshape(-1, n + 2)
        out = by[:, :n].ravel() @ moved.phi.reshape(-1, size)
        out += by[:, n:].ravel() @ moved.bent.reshape(-1, size)
        if forcing.data.any():
            out += (weights[:, None] * here.by_data.energy.reshape(len(weights), -1)).ravel() @ forcing.data.reshape(
                -1, size
            )
        torque = here.torque.reshape(-1, n)
        out += (weights[:, None] * here.winding.reshape(-1, n) * torque).ravel() @ moved.torque.reshape(-1, size)
        stretched = here.stretched.reshape(-1, n)
        out += (weights[:, None] * stretched * torque / 2).ravel() @ forcing.rate.reshape(-1, size)
        # The torque that the transmissions feel, on the plate's side of what moves there.
        held, gained = here.torque_plate_side[0], (moved.state - forcing.jumps)[0, n + 3 : 2 * n + 3]
        out += (held**2 / 2) @ forcing.transmission + (here.transmission * held) @ gained
        return np.asarray(out + self._stored @ self.widths)


def _parts(table: Array) -> tuple[Array, Array, Array, Array]:
    """theta, kb, m (X, n) and b (X, 2) of a table (X, 3 n + 2)."""
    n = table.shape[1] // 3
    return table[:, :n], table[:, n : 2 * n], table[:, 2 * n : 3 * n], table[:, 3 * n :]


def _at(weights: Array, values: Array) -> Array:
    """(r, Q) at a place, by weights (K,) of what is at the points (K, r, Q)."""
    return np.asarray(weights @ values.reshape(len(values), -1)).reshape(values.shape[1:])
