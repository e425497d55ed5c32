"""One pre-curved tube: a straight part, then a part of constant precurvature (SI)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from ..errors import InputError, finite, positive
from ..physics.strain import surface_strain
from .materials import NITINOL, Material


def second_moment(outer_diameter: Any, inner_diameter: Any) -> Any:
    """I = pi/64 (OD^4 - ID^4), m^4, of numbers, arrays or expressions."""
    return math.pi / 64 * (outer_diameter**4 - inner_diameter**4)


@dataclass(frozen=True)
class Tube:
    """A tube that is straight from its held end, then curved with one radius.

    Args:
        outer_diameter, inner_diameter: m; 0 <= inner < outer.
        straight_length, curved_length: m, >= 0 and not both 0.
        curvature: precurvature of the curved part, 1/m; the sign is the side to which it bends.
        material: elastic constants.

    Raises:
        InputError: a field is not finite or out of its range, or the curve is tighter than the tube is thick.
    """

    outer_diameter: float
    inner_diameter: float
    straight_length: float
    curved_length: float
    curvature: float
    material: Material = NITINOL

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        set_field(self, "outer_diameter", positive("outer_diameter", self.outer_diameter))
        for field in ("inner_diameter", "straight_length", "curved_length"):
            set_field(self, field, positive(field, getattr(self, field), zero=True))
        set_field(self, "curvature", finite("curvature", self.curvature))
        if self.inner_diameter >= self.outer_diameter:
            raise InputError(
                f"inner_diameter is {self.inner_diameter:g} m; it must be less than outer_diameter "
                f"({self.outer_diameter:g} m)"
            )
        if self.length == 0:
            raise InputError("straight_length and curved_length are both 0; a tube must have a length")
        if self.outer_diameter / 2 * abs(self.curvature) >= 1:
            raise InputError(
                f"curvature is {self.curvature:g} per m; its radius must exceed half the outer_diameter "
                f"({self.outer_diameter / 2:g} m)"
            )

    @property
    def length(self) -> float:
        """Overall length, m."""
        return self.straight_length + self.curved_length

    @property
    def second_moment(self) -> float:
        """I = pi/64 (OD^4 - ID^4), m^4."""
        return float(second_moment(self.outer_diameter, self.inner_diameter))

    @property
    def polar_moment(self) -> float:
        """J = 2 I, m^4."""
        return 2 * self.second_moment

    @property
    def bending_stiffness(self) -> float:
        """EI, N m^2."""
        return self.material.youngs_modulus * self.second_moment

    @property
    def torsional_stiffness(self) -> float:
        """GJ, N m^2."""
        return self.material.shear_modulus * self.polar_moment

    @property
    def straightened_strain(self) -> float:
        """Largest surface strain when the curved part is held straight: r kappa / (1 - r kappa)."""
        return float(surface_strain(self.outer_diameter / 2, abs(self.curvature), self.curvature))
