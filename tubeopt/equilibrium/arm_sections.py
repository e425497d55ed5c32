"""Torques and bending moments along an equilibrium of concentric tubes, from its shape.

Unlike torsion and curvature they are continuous where tubes begin to curve or end, so that they give both there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..block.transcription.arm import between
from ..block.transcription.collocated import SHAPE_STEPS, THROUGH_ENDS
from ..robots.assembly import Assembly
from ..robots.lengthwise import CrossSections
from ..typing import Array
from .result import Equilibrium

NEAR = 1e-9
"""Distance (m) within which a breakpoint, friction or a contact is at the end of an element."""


class SectionsAt(NamedTuple):
    """Cross-sections at X arc lengths."""

    sections: CrossSections
    rotation: Array
    """Rotations theta (X, n), rad."""
    torsion: Array
    """Rates of the rotations (X, n), rad/m."""
    curvature: Array
    """Curvature u_x + j u_y (X,) of the arm in its Bishop frame, 1/m."""


class ArmSections:
    """An equilibrium of n concentric tubes, at the m shape points of P elements.

    Breakpoints of the tubes are at ends of elements. There the shape has the values of the plate's side, but at the
    plate itself those of the other side.
    """

    def __init__(self, e: Equilibrium, assembly: Assembly) -> None:
        self.e, self.assembly, self.n = e, assembly, assembly.n_tubes
        self.cuts = e.arc_length[::SHAPE_STEPS]
        self.middle = (self.cuts[:-1] + self.cuts[1:]) / 2
        if len(self.middle):
            element = np.maximum(np.arange(len(e.arc_length)) - 1, 0) // SHAPE_STEPS
            at = assembly.cross_sections(e.arc_length, self.middle[element])
            self.torques = np.where(at.stiffness > 0, at.torsional_stiffness * (e.torsion.T - at.twist), 0.0)
            """Torques (m, n) of the tubes, N m."""
            self.elastic = e.rotation.T - assembly.twist_angle(e.arc_length)
            """Rotations (m, n) of the tubes less their natural twist, rad."""
            self.moments = at.stiffness.sum(1) * (e.curvature @ (1, 1j)) - self.natural(at, self.elastic).sum(1)
            """Bending moments b_x + j b_y (m,) of the arm in its Bishop frame, N m."""
        else:
            self.torques, self.moments = np.zeros((1, self.n)), np.zeros(1, dtype=complex)
            self.elastic = e.rotation.T
        self._set_friction()

    @staticmethod
    def natural(at: CrossSections, elastic: Array) -> Array:
        """Moments a_i = kb_i (u*_x + j u*_y) (X, n) in the Bishop frame, N m, of elastic rotations (X, n)."""
        return np.asarray(at.moment * np.exp(1j * (elastic + at.phase)))

    def _set_friction(self) -> None:
        """Set the torques (P + 1, n) of friction on the tubes at ends of elements, and those between."""
        friction, self.jumps = self.e.friction, np.zeros((len(self.cuts), self.n))
        """Torques (P + 1, n) of concentrated friction on the tubes at the ends of elements, N m."""
        self.along = np.zeros(0), np.zeros(0, dtype=np.intp), np.zeros(0)
        """Arc lengths (R,), m, tubes (R,), and torques (R,) of friction on them between the ends of elements, N m."""
        if friction is None:
            return
        s, inner, torque = (np.array(part) for part in (friction.arc_length, friction.pair, friction.torque))
        # The torque of a row is the one that turns the inner tube.
        s, tube, torque = np.tile(s, 2), np.concatenate([inner, inner + 1]), np.concatenate([torque, -torque])
        cut = np.abs(self.cuts - s[:, None]).argmin(1)
        inside = np.abs(self.cuts[cut] - s) > NEAR
        np.add.at(self.jumps, (cut[~inside], tube[~inside]), torque[~inside])
        self.along = s[inside], tube[inside], torque[inside]

    @property
    def plate_torque(self) -> Array:
        """Torques (n,) of the tubes behind the plate, N m; friction at the plate acts between them and the arm."""
        return np.asarray(self.torques[0] + self.jumps[0])

    def at(self, s: Array) -> SectionsAt:
        """Cross-sections at arc lengths (X,) in front of the plate, by the polynomials of the elements."""
        element, _, x = between(self.cuts, s)
        points = element[:, None] * SHAPE_STEPS + np.arange(SHAPE_STEPS + 1)
        weights = np.vander(x, SHAPE_STEPS + 1, increasing=True) @ THROUGH_ENDS
        torques = self.torques[points]
        # Concentrated friction makes the torque jump where elements meet.
        torques[:, 0] -= np.where(element[:, None] > 0, self.jumps[element], 0.0)
        at = self.assembly.cross_sections(s, self.middle[element])
        elastic, torque = (np.einsum("xk,xki->xi", weights, table) for table in (self.elastic[points], torques))
        moment = (weights * self.moments[points]).sum(1) + self.natural(at, elastic).sum(1)
        torsion = np.where(at.stiffness > 0, torque / at.torsional_stiffness + at.twist, 0.0)
        return SectionsAt(at, elastic + at.twist_angle, torsion, moment / at.stiffness.sum(1))
