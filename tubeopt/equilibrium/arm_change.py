"""Derivatives of an arm in equilibrium: of its tip, shape and energy.

A breakpoint that moves uncovers a strip with other tubes: there all derivatives with respect to arc length jump.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..block.transcription.arm import cumulate
from ..block.transcription.arm_response import Forcing, Response
from ..block.transcription.arm_state import (
    SectionInputs,
    SectionValues,
    data_slopes_of,
    energy_of,
    sections_of,
    values_of,
)
from ..block.transcription.collocated import ENDS
from ..errors import InputError, SolveError
from ..physics.shape import cross
from ..robots.assembly import LENGTH_ROUND_OFF
from ..robots.load import FORCE, MOMENT
from ..robots.order import SAME_END, twisted_tube
from ..typing import Array
from .directions import Directions

SHAPE_POINTS = tuple(ENDS.tolist())
"""Shape points of an element as fractions of its length."""

TIP = 1e-9
"""Largest distance (m) from the tip of a force that counts as a tip force."""

AHEAD = 100 * SAME_END
"""Motion (m) of the fastest end, to test whether a moment passes from one tube to another."""


@dataclass(frozen=True, eq=False)
class Section:
    """Cross-section at a point of the arm, with its changes while the point moves."""

    rotation: Array
    """Rotations theta (n,), rad."""
    curvature: Array
    """Curvature u (2,), 1/m."""
    by_tubes: Array
    """Changes (3 n, Q) of theta, kb and m."""
    by_curvature: Array
    """Changes (2, Q) of the curvature u."""


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
        # A breakpoint that moves replaces one cross-section by another: the jumps of the rates count.
        np.add.at(forcing.jumps, self.strips.index, self._gained(self._strip_rates)[..., None] * self.widths[:, None])
        return forcing

    def _gained(self, rates: Array) -> Array:
        """(T, ...) change per width of a strip, from a rate per length (2, T, ...) after and before the motion."""
        return np.asarray(self.side * (rates.T * self.strips.signs.T).sum(-1).T)

    @cached_property
    def strip_inputs(self) -> SectionInputs:
        """Cross-sections in the strips after the motion, then before it (2 T)."""
        arm, strips = self.arm, self.strips
        frame = arm.end_frame[strips.index]
        moment = (arm.moment_plate_side if self.side < 0 else arm.moment_tip_side)[strips.index]
        b = (frame[..., :2].swapaxes(1, 2) @ moment[..., None])[..., 0]
        phi = arm.phi_ends[strips.index]
        theta = np.concatenate([phi, phi]) + strips.sections.phase
        return SectionInputs(theta, strips.stiffness, strips.sections.moment, np.concatenate([b, b]))

    @cached_property
    def _strip_values(self) -> SectionValues:
        """Torque, curvature and stretch in the strips after the motion, then before it (2 T)."""
        return values_of(self.strip_inputs, self.arm.offsets)

    @cached_property
    def _strip_torque(self) -> Array:
        """(T, n) torques at the strips."""
        return (self.arm.torque_plate_side if self.side < 0 else self.arm.torque_tip_side)[self.strips.index]

    @cached_property
    def _strip_force(self) -> Array:
        """(T, 3) force on the cross-section at the strips, on the side of the strip."""
        arm, index = self.arm, self.strips.index
        if self.side < 0:
            return np.asarray(arm.tableau.basis((1.0,), 0)[0] @ arm.force[index - 1])
        table = np.concatenate([arm.tableau.basis((0.0,), 0)[0] @ arm.force, arm.tip_force[None]])
        return np.asarray(table[index])

    @cached_property
    def _strip_rates(self) -> Array:
        """(2, T, 2 n + 6) derivatives of the state with respect to arc length in the strips."""
        arm, strips, n, values = self.arm, self.strips, self.n, self._strip_values
        count, frame = len(strips.index), arm.end_frame[strips.index]
        rates = np.zeros((2, count, arm.size))
        # phi' = g t / kt, the frame turns by R (u_x, u_y, 0), and t' = M.
        rates[..., :n] = strips.compliance * self._strip_torque * values.stretch.reshape(2, count, n)
        rates[..., n : n + 3] = (frame[..., :2] @ values.curvature.reshape(2, count, 2, 1))[..., 0]
        rates[..., n + 3 : 2 * n + 3] = values.torque.reshape(2, count, n)
        if arm.load is None:
            return rates
        # m' = -e x n less the moment per length l, of which the part along the arm twists the outermost tube.
        axis = frame[..., 2]
        rates[..., 2 * n + 3 :] = -cross(axis, self._strip_force)
        if arm.load.distributed is not None:
            density = arm.load.per_length(self.cuts[strips.index] + self.side * LENGTH_ROUND_OFF)[:, MOMENT]
            rates[..., 2 * n + 3 :] -= density
            rates[[[0], [1]], np.arange(count), n + 3 + strips.outermost] -= (density * axis).sum(1)
        return rates

    @cached_property
    def _strip_energy(self) -> Array:
        """(T,) change of the elastic energy per width of a strip, J/m."""
        # Bending energy and torsion: t phi' / 2 per length, phi' = g t / kt.
        bending = energy_of(self.strip_inputs, self.arm.offsets).value.reshape(2, -1)
        return self._gained(bending + (self._strip_rates[..., : self.n] * self._strip_torque).sum(2) / 2)

    @cached_property
    def response(self) -> Response:
        """Derivatives of the state along the arm."""
        forcing = self.forcing
        arm, load = self.arm, self.arm.load
        if load is not None:
            self._must_stay()
            if load.distributed is not None:
                force = load.per_length(self.cuts[-1:] + self.side * LENGTH_ROUND_OFF)[0, FORCE]
                forcing.force[:] += np.outer(force, self._longer)
        return arm.respond(forcing)

    def _must_stay(self) -> None:
        """Raise an error for motions that retract the tip or the end of a tube from a load that acts there."""
        arm, ends, points = self.arm, self.assembly.end, self.breakpoints
        assert arm.load is not None
        tip = self.cuts[-1]
        if any(part.at >= tip - TIP for part in arm.load.points) and (self.side * self._longer < 0).any():
            raise InputError(
                f"points of load act at the tip, {1e3 * tip:g} mm from the plate, from where it draws back; take "
                "derivatives by what moves it out (side=1)"
            )
        acts = [self.cuts[k] for k, *_ in arm.joint_moments] + [np.inf] * any(arm.load.moment)
        if not acts:
            return
        at_end, pace = (
            np.abs(self.placed.arc_length - ends[points.tube]) <= LENGTH_ROUND_OFF,
            np.zeros((self.n, self.size)),
        )
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
        return np.asarray((self.side * self.strips.growth) @ self.widths)

    @property
    def pushed(self) -> Array:
        """(3, Q) motion of the tip along its axis with the tubes that end there, m."""
        return np.asarray(self.arm.end_frame[-1, :, 2, None] * self._longer)

    @cached_property
    def tip_position(self) -> Array:
        """(3, Q) change of the tip position, m."""
        arm = self.arm
        # The tip moves by int psi x e ds = -int e x psi ds, and by what it is pushed out.
        moved = arm.weights.ravel() @ (arm.about_axis @ self.response.psi).reshape(-1, 3 * self.size)
        return np.asarray(self.pushed - moved.reshape(3, self.size))

    @property
    def tip_rotation(self) -> Array:
        """(3, Q) turn vector of the tip frame in the plate frame, rad."""
        return self.response.state[-1, self.n : self.n + 3]

    @property
    def tip_rotations(self) -> Array:
        """(n, Q) change of theta at each tube's own end."""
        ends = np.clip(self.assembly.end, 0.0, self.cuts[-1])
        index = np.abs(self.cuts - ends[:, None]).argmin(1)
        return np.asarray(self.response.state[index, np.arange(self.n)] + self.entered.twist_angle)

    @cached_property
    def moved(self) -> Array:
        """(m, Q) motion along the arm of the shape points, which stay at fixed fractions of the elements."""
        return self._moved(self.shape.arc_length)

    def _moved(self, s: Array) -> Array:
        """(len(s), Q) motion of points at arc lengths s, which stay at fixed fractions between breakpoints.

        Of breakpoints that coincide the foremost counts.
        """
        points, pace = self.breakpoints, self.side * self.entered.speed
        each = [group for group in points.groups if points.index[group[0]] > 0]
        knots = np.concatenate([[0.0], self.cuts[points.index[[group[0] for group in each]]]]) if each else np.zeros(1)
        speed = self.side * np.array([pace[[*group]].max(0) for group in each])
        fraction = [np.interp(s, knots, row) for row in np.eye(len(knots))[1:]]
        return np.stack(fraction, axis=1) @ speed if fraction else np.zeros((len(s), self.size))

    @cached_property
    def _sections_along(self) -> tuple[Array, Array]:
        """Slopes phi' (P, K, n), and phase, kb, m and b (P, K, 3 n + 2), at the points."""
        arm = self.arm
        return arm.compliance * arm.stretched_torque, np.concatenate(
            [arm.phase, arm.stiffness, arm.natural_moment, arm.bending_moment], axis=2
        )

    @cached_property
    def sections(self) -> tuple[Array, Array]:
        """Arrays theta, kb and m (P, 5, 3 n), and curvature u (P, 5, 2), at ENDS of every element."""
        arm, n, (rate, table) = self.arm, self.n, self._sections_along
        at = arm.tableau.basis(SHAPE_POINTS, 0) @ table
        at[..., :n] += arm.phi_ends[:-1, None] + arm.h * (arm.tableau.basis(SHAPE_POINTS, 1) @ rate)
        result = sections_of(_parts(at.reshape(-1, 3 * n + 2)), arm.offsets)
        return at[..., : 3 * n], result.curvature.reshape(*at.shape[:2], 2)

    def section(self, k: int, x: float, moves: Array) -> Section:
        """Cross-section at a fraction x of element k, while the point moves along the arm by (Q,)."""
        arm, n, (rate, table) = self.arm, self.n, self._sections_along
        h, response, forcing = arm.length[k], self.response, self.forcing
        inside, full, slope = (arm.tableau.basis((x,), times)[0] for times in (0, 1, -1))
        at, by = inside @ table[k], slope @ table[k] / h
        at[:n] += arm.phi_ends[k] + h * (full @ rate[k])
        # Along the arm theta changes by phi' beside the polynomials of phase and precurvature.
        by[:n] += inside @ rate[k]
        change = by[:, None] * moves
        change[: 3 * n] += _at(inside, forcing.data[k])
        if arm.load is not None:
            change[3 * n :] += _at(inside, response.bending_moment[k])
        change[:n] += response.state[k, :n] + h * _at(full, arm.twist_change(response, forcing, k))
        inputs = _parts(at[None])
        result, by_data = sections_of(inputs, arm.offsets), data_slopes_of(inputs, arm.offsets).curvature[0]
        turned = result.slopes[0, n:] @ np.concatenate([change[:n], change[3 * n :]]) + by_data @ change[n : 3 * n]
        return Section(at[:n], result.curvature[0], change[: 3 * n], turned)

    @cached_property
    def position(self) -> Array:
        """(m, 3, Q) change of the shape points at fixed arc lengths; the last one is the tip, which moves along."""
        arm = self.arm
        out = cumulate(arm.tableau, arm.h[..., None] * (-arm.about_axis @ self.response.psi))
        out[-1] += self.pushed
        return out

    @property
    def total_bend(self) -> float:
        """Integral of the squared curvature along the arm, 1/m."""
        return float(self.arm.weights.ravel() @ (self.arm.at.curvature**2).sum(1))

    @cached_property
    def bend(self) -> Array:
        """(Q,) change of int |u|^2 ds, 1/m."""
        arm, u = self.arm, self.arm.at.curvature
        # d(int |u|^2 ds) = int 2 u . du ds, and the jump of |u|^2 where breakpoints move.
        weighted = (2 * arm.weights.ravel()[:, None] * u).ravel()
        squared = self._gained((self._strip_values.curvature**2).sum(1).reshape(2, -1))
        return np.asarray(weighted @ self.response.curvature.reshape(-1, self.size) + squared @ self.widths)

    @cached_property
    def energy(self) -> Array:
        """(Q,) change of the elastic energy, J."""
        arm, forcing, n = self.arm, self.forcing, self.n
        moved, weights, size = self.response, arm.weights.ravel(), self.size
        by = weights[:, None] * arm.energy_slopes.reshape(len(weights), 3 * n + 2)
        out = by[:, :n].ravel() @ moved.phi.reshape(-1, size)
        out += by[:, 3 * n :].ravel() @ moved.bending_moment.reshape(-1, size)
        if forcing.data.any():
            out += by[:, : 3 * n].ravel() @ forcing.data.reshape(-1, size)
        torque = arm.torque.reshape(-1, n)
        out += (weights[:, None] * arm.twist_compliance.reshape(-1, n) * torque).ravel() @ moved.torque.reshape(
            -1, size
        )
        stretched = arm.stretched_torque.reshape(-1, n)
        out += (weights[:, None] * stretched * torque / 2).ravel() @ forcing.compliance.reshape(-1, size)
        # The torque that the transmissions feel, on the plate's side of what moves there.
        held, gained = arm.torque_plate_side[0], (moved.state - forcing.jumps)[0, n + 3 : 2 * n + 3]
        out += (held**2 / 2) @ forcing.transmission + (arm.transmission * held) @ gained
        return np.asarray(out + self._strip_energy @ self.widths)


def _parts(table: Array) -> SectionInputs:
    """Arguments of cross-sections from a table (X, 3 n + 2)."""
    n = table.shape[1] // 3
    return SectionInputs(table[:, :n], table[:, n : 2 * n], table[:, 2 * n : 3 * n], table[:, 3 * n :])


def _at(weights: Array, values: Array) -> Array:
    """Interpolated value (r, Q), by weights (K,) of values at the points (K, r, Q)."""
    return np.asarray(weights @ values.reshape(len(values), -1)).reshape(values.shape[1:])
