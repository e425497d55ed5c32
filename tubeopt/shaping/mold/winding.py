"""The groove of a mandrel in space: bend and tangent leads, integrated from the curvature (SI)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy

from ...robots.pieces import Piece
from ...robots.series import breaks_of, values, vary
from ...robots.tubes import Tube
from ...typing import Array
from .settings import MoldSolver


@dataclass(frozen=True, eq=False)
class Winding:
    """A curve in space: arc length (N,), points (N, 3) and unit tangents (N, 3), and which points are of the bend."""

    arc_length: Array
    points: Array
    tangents: Array
    bend: slice

    def moved(self, rotation: Array, shift: Array) -> Winding:
        """The curve turned by a matrix (3, 3), then moved by `shift` (3,)."""
        return Winding(self.arc_length, self.points @ rotation.T + shift, self.tangents @ rotation.T, self.bend)

    def lengthened(self, extra: float, step: float = 1e-3) -> Winding:
        """With both leads `extra` (m) longer; by points about `step` (m) apart."""
        s = self.arc_length
        return self.with_leads(extra - s[0], extra + s[-1] - s[self.bend][-1], step)

    def with_leads(self, before: float, after: float, step: float = 1e-3) -> Winding:
        """The bend with straight tangent leads of these lengths (m) in place of its own."""
        s, p, t = (field[self.bend] for field in (self.arc_length, self.points, self.tangents))
        counts = [max(2, math.ceil(length / step)) for length in (before, after)]
        back, on = np.linspace(-before, 0.0, counts[0])[:-1], np.linspace(0.0, after, counts[1])[1:]
        return Winding(
            np.concatenate([s[0] + back, s, s[-1] + on]),
            np.vstack([p[0] + back[:, None] * t[0], p, p[-1] + on[:, None] * t[-1]]),
            np.vstack([np.tile(t[0], (len(back), 1)), t, np.tile(t[-1], (len(on), 1))]),
            slice(len(back), len(back) + len(s)),
        )


def helix_of(held: Tube) -> tuple[float, float] | None:
    """Curvature and torsion (1/m) where the whole curved part is one helix in constant components; else None."""
    if any(vary(piece.precurvature) for piece in held.pieces):
        return None
    u = np.array([piece.precurvature for piece in held.pieces])
    if not len(u) or np.abs(u - u[0]).max() > 1e-12 * np.abs(u[0]).max():
        return None
    curvature, torsion = float(np.hypot(u[0, 0], u[0, 1])), float(u[0, 2])
    return (curvature, torsion) if curvature > 0 and torsion != 0 else None


def bend_in_space(held: Tube, solver: MoldSolver) -> Winding:
    """The bend from the origin, along z at first: R' = R hat(u*), p' = R e3, to 1e-12."""
    state = np.concatenate([np.zeros(3), np.eye(3).ravel()])
    s, rows = [0.0], [state]
    for piece in held.pieces or (Piece(held.curved_length, held.curvature),):
        breaks = breaks_of(piece.precurvature, piece.length)
        for low, high in pairwise(breaks):
            bent = max(held.curvature, 1.0)
            step = min(math.sqrt(8 * solver.sagitta / bent), solver.chord_turn / bent, 1e-3)
            places = np.linspace(low, high, max(2, math.ceil((high - low) / step) + 1))

            def rate(x: float, y: Array, piece: Piece = piece) -> Array:
                ux, uy, uz = (float(values(q, np.array([x]))[0]) for q in piece.precurvature)
                frame = y[3:].reshape(3, 3)
                hat = np.array([[0.0, -uz, uy], [uz, 0.0, -ux], [-uy, ux, 0.0]])
                return np.concatenate([frame[:, 2], (frame @ hat).ravel()])

            found = scipy.integrate.solve_ivp(
                rate, (low, high), rows[-1], method="DOP853", t_eval=places, rtol=1e-11, atol=1e-13
            ).y.T
            begin = s[-1]
            s += (begin + places[1:] - low).tolist()
            rows += list(found[1:])
    table = np.array(rows)
    tangents = table[:, 3:].reshape(-1, 3, 3)[:, :, 2]
    tangents = tangents / np.linalg.norm(tangents, axis=1)[:, None]
    return Winding(np.array(s), table[:, :3], tangents, slice(0, len(s)))
