"""What a block tells about its arm, as expressions: place, frame, curvature, strain, clearance."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from ..errors import InputError
from ..physics.shape import rotation_matrix
from ..physics.strain import surface_strain
from ..robots.assembly import Assembly
from ..robots.robot import Robot
from .transcription import functions
from .transcription.layout import Layout
from .transcription.model import Model

POINT = 1e-12
"""A piece shorter than this (m) is a point."""


class Outputs:
    """Expressions of the arm of a block."""

    robot: Robot
    model: Model
    layout: Layout
    tip_position: Any
    length: Any
    _bundle: Assembly
    _moving: bool

    def position(self, fraction: float) -> Any:
        """(3,) position, m, at a fraction of the arm's length in front of the plate: 0 the plate, 1 the tip."""
        return self.tip_position if fraction == 1.0 else self._inside(fraction)[1]

    def orientation(self, fraction: float) -> Any:
        """(3, 3) Bishop frame at a fraction of the arm's length."""
        return rotation_matrix(self._inside(fraction)[0])

    def curvature(self, fraction: float) -> Any:
        """(2,) curvature of the arm in its Bishop frame, 1/m, at a fraction of its length."""
        return self._inside(fraction)[4]

    def rotation(self, fraction: float) -> Any:
        """(n,) rotations theta_i of the tubes, rad, at a fraction of the arm's length."""
        _, _, theta, _, _, *natural = self._inside(fraction)
        return theta + natural[0] if natural else theta

    def torsion(self, fraction: float) -> Any:
        """(n,) torsion of the tubes per length of each, rad/m, at a fraction of the arm's length."""
        _, _, _, w, _, *natural = self._inside(fraction)
        return natural[2] * w + natural[1] if natural else w

    def _inside(self, fraction: float) -> list[Any]:
        """q, p, theta, w and u at a fraction of the arm's length."""
        if not 0 <= fraction <= 1:
            raise InputError(f"fraction is {fraction:g}; it must lie between 0, the plate, and 1, the tip")
        return self._where_it_is(fraction) if self._moving else self._in_piece(fraction)

    def _in_piece(self, fraction: float) -> list[Any]:
        """In the piece that is known to hold it, since no length is free."""
        length = np.array(ca.DM(self.model.lengths)).ravel()
        behind = np.cumsum(length)
        k = min(int(np.searchsorted(behind, fraction * behind[-1])), len(length) - 1)
        while length[k] <= POINT and k + 1 < len(length):
            k += 1
        x = (fraction * behind[-1] - (behind[k] - length[k])) / length[k]
        q, p = self.model.poses
        return list(functions.inside_function(self.model.grid)(q[:, k], p[:, k], x, *self.model.piece(k)))

    def _where_it_is(self, fraction: float) -> list[Any]:
        """In the piece that holds it at the lengths of the moment, which is picked out of all."""
        model, pieces = self.model, self.model.n_pieces
        behind = ca.cumsum(model.lengths)
        start = behind - model.lengths
        s = fraction * self.length
        there = ca.fmin(ca.fmax(s - start, 0), model.lengths)
        x = there / ca.if_else(model.lengths > POINT, model.lengths, 1.0)
        # The last piece that begins before it, but none without length.
        begun = ca.logic_and(start <= s, model.lengths > POINT)
        later = ca.DM.zeros(1)
        picked = []
        for k in reversed(range(pieces)):
            picked.append(ca.logic_and(begun[k], ca.logic_not(later)))
            later = ca.logic_or(later, begun[k])
        weight = ca.vertcat(*reversed(picked))
        n, degree = self.robot.n_tubes, model.grid.degree
        every = [*model.poses, x.T, model.theta, model.twist, ca.reshape(model.inner, n * degree, pieces), *model.data]
        one = [part @ weight for part in every]
        one[5] = ca.reshape(one[5], n, degree)
        return list(functions.inside_function(model.grid)(*one))

    def _natural_turn(self) -> Any:
        """Of tubes made of pieces where the arm ends, rad."""
        if self.model.along is None:
            return 0.0
        q, p = self.model.poses
        last = self.model.n_pieces - 1
        return functions.inside_function(self.model.grid)(q[:, last], p[:, last], 1.0, *self.model.piece(last))[5]

    def strain(self, tube: int) -> Any:
        """(points,) bending strain r |u - u*| / (1 - r |u*|) at the surface of a tube (0 is the innermost), at the
        collocation points; where lengths are free, 0 where the tube is not."""
        if tube not in range(self.robot.n_tubes):
            raise InputError(f"tube is {tube}; the robot has tubes 0 to {self.robot.n_tubes - 1}")
        model, degree = self.model, self.model.grid.degree
        bend, natural = (part[tube, :] for part in model.mapped("bend")(*model.arguments, model.natural))
        radius = self.robot.tubes[tube].outer_diameter / 2
        there = ca.reshape(ca.repmat(model.present[tube, :], degree, 1), 1, -1)
        strain = ca.vec(there * surface_strain(radius, bend, natural))
        if self._moving:
            return strain
        kept = np.flatnonzero(np.repeat(self.layout.present[tube], degree)).tolist()
        return strain[kept]

    def points(self) -> Any:
        """(3, m) shape points of the arm, four per piece, the tip last, m."""
        return self.model.mapped("places")(*self.model.poses, *self.model.arguments)

    def clearance(self, body: Any) -> Any:
        """(m,) distance of the arm's surface from a body at its shape points, m: at least 0 keeps them apart there.

        `body` is any of `tubeopt.bodies`, or whatever has `distance(x, y, z)` written with arithmetic alone. Between
        the points nothing is known: `verify_trajectory` proves clearance.
        """
        if not hasattr(body, "distance"):
            raise InputError(f"body is {body!r}; it must be one of tubeopt.bodies, or have distance(x, y, z)")
        places = self.points()
        thick = np.array([tube.outer_diameter / 2 for tube in self.robot.tubes]) + self._bundle.offset
        radius: Any = ca.DM.zeros(1, self.model.n_pieces)
        for i, own in enumerate(thick.tolist()):
            radius = ca.fmax(radius, own * self.model.present[i, :])
        each = places.shape[1] // self.model.n_pieces
        x, y, z = (ca.SX.sym(axis) for axis in "xyz")
        far = ca.Function("distance", [x, y, z], [body.distance(x, y, z)]).map(places.shape[1])
        distance = far(places[0, :], places[1, :], places[2, :])
        return ca.vec(distance - ca.reshape(ca.repmat(radius, each, 1), 1, -1))
