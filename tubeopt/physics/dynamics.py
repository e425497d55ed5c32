"""Inertia, material damping and friction of tubes, in arithmetic alone: of numbers, arrays or expressions.

Per length of the arm, with the velocity v of the centreline, the rotations theta and the curvature u,

    kinetic energy      rho A |v|^2 / 2  +  sum_i rho J_i (dtheta_i/dt)^2 / 2
    dissipated power    sum_i tau_i [kb_i |du/dt - dtheta_i/dt e_z x u|^2 + kt_i (dtheta_i'/dt)^2].

The second line is the law of Kelvin and Voigt: to its stress every fibre adds tau times the rate of that stress. The
vector in it is the rate of curvature that tube i feels, in axes that turn with it: a tube that turns inside a bent arm
bends its fibres anew. Left out are the rotary inertia of bending and the spin of the arm's frame about its axis; both
are smaller by the square of tube radius over arm length.
"""

from __future__ import annotations

from typing import Any, NamedTuple


def polar_inertia(mass: Any, outer_diameter: Any, inner_diameter: Any) -> Any:
    """Mass moment of inertia about the axis per length, rho J, kg m, of a tube of `mass` per length, kg/m."""
    return mass * (outer_diameter**2 + inner_diameter**2) / 8


def felt_bending_rate(bending_rate: tuple[Any, Any], turn_rate: Any, curvature: tuple[Any, Any]) -> tuple[Any, Any]:
    """Rate of curvature that a tube feels, du/dt - dtheta/dt e_z x u, x and y, 1/(m s)."""
    return bending_rate[0] + turn_rate * curvature[1], bending_rate[1] - turn_rate * curvature[0]


class DryFriction(NamedTuple):
    """Coulomb friction at R contacts."""

    rows: Any
    """Derivative (R, Y) of the relative displacements by the coordinates."""
    capacity: Any
    """Largest friction forces (R,)."""
    creep: float
    """Relative rate at which a contact has 71 % of its friction; below it friction falls to 0 with the rate."""

    def at(self, rate: Any) -> tuple[Any, Any]:
        """Friction forces (R,) at relative rates (R,), and their derivatives (R,)."""
        size = (rate**2 + self.creep**2) ** 0.5
        return self.capacity * rate / size, self.capacity * self.creep**2 / size**3
