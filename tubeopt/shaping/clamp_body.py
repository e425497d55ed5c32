"""Body of a clamp: two halves of aluminium, split at the axis of the tube, with the mass of a rig (SI).

Its nose presses the tube between half-round grooves. Two screws behind the nose pull the halves together, and a shim at
the rear end keeps them parallel: a lever.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from ..robots.tubes import Tube
from .heating.rig import Clamps
from .mold.mold import shoulder
from .mold.spec import ClampSpec

DENSITY, ALUMINIUM = 2700.0, 896.0
"""Density (kg/m^3) and heat capacity (J/(kg K)) of aluminium."""

HALF_NOSE, HALF_BODY, WIDTH = 6e-3, 12e-3, 20e-3
"""Heights of each half of nose and body, and width of the body, m."""

OPEN = 0.1e-3
"""Material (m) that each groove lacks to a half circle: the halves stay apart by twice this."""

SCREW, BEHIND_NOSE, ASIDE = 4e-3, 6e-3, 6e-3
"""Nominal diameter of both screws, and their distances from the nose and from the tube's axis, m."""

SHIM = 4e-3
"""Length of the shim along the tube, m."""

LEAST_BODY = 16e-3
"""Length of a body with room for screws, lug and shim, m."""

CRUSHING = 100e6
"""Largest stress by the jaws in a tube's wall, Pa: a quarter of where nitinol transforms (assumed)."""


def largest_force(tube: Tube, grip: float) -> float:
    """Largest force (N) of half-round jaws on a length of tube, m: as on a pipe, p D / (2 t) with p = F / (D L)."""
    return CRUSHING * (tube.outer_diameter - tube.inner_diameter) * grip


@dataclass(frozen=True)
class ClampBody:
    """One of the two clamps of a tube; the nose is as long as the grip."""

    tube: Tube
    grip: float
    """Length of the nose, m."""
    nose: ClampSpec
    """Face and width of the nose."""
    length: float
    """Length of the body behind the nose, m."""
    width: float
    """Width of the body, m."""

    @property
    def groove_depth(self) -> float:
        """Depth of the groove in each half, m."""
        return 0.5 * self.tube.outer_diameter - OPEN

    @property
    def nose_plan(self) -> float:
        """Area of the nose seen from above, m^2."""
        return self.grip * self.nose.width - shoulder(self.nose) * (self.nose.width - self.nose.face_width) / 2

    @property
    def mass(self) -> float:
        """Mass of both halves, kg; grooves and holes do not count."""
        return DENSITY * 2 * (HALF_NOSE * self.nose_plan + HALF_BODY * self.width * self.length)

    @property
    def area(self) -> float:
        """Area in air, m^2: all faces but the lower one of the body, which lies on a support."""
        slope, back = shoulder(self.nose), self.grip - shoulder(self.nose)
        rim = self.nose.face_width + 2 * math.hypot(slope, (self.nose.width - self.nose.face_width) / 2) + 2 * back
        sides = 4 * HALF_BODY * (self.width + self.length) - 2 * HALF_NOSE * self.nose.width
        return 2 * self.nose_plan + 2 * HALF_NOSE * rim + sides + self.width * self.length

    @property
    def lever(self) -> float:
        """Force of both screws over that of the nose: moments about the middle of the shim."""
        rear = self.grip + self.length - SHIM / 2
        return (rear - self.grip / 2) / (rear - self.grip - BEHIND_NOSE)

    @property
    def torque(self) -> float:
        """Largest torque of each screw, N m: T = 0.2 F d."""
        return 0.2 * self.lever * largest_force(self.tube, self.grip) / 2 * SCREW


def clamp_body(tube: Tube, spec: ClampSpec, clamps: Clamps) -> ClampBody:
    """Clamp of a tube with the heat capacity of those of a rig, or more where screws and lug need a longer body."""
    # Within the lines at 45 deg from its face, it stays as far from the plate as its nose.
    width = min(WIDTH, spec.face_width + 2 * spec.grip)
    nose = ClampBody(tube, spec.grip, spec, 0.0, width)
    length = (equal_mass(clamps) - nose.mass) / (DENSITY * 2 * HALF_BODY * width)
    return replace(nose, length=max(length, LEAST_BODY))


def equal_mass(clamps: Clamps) -> float:
    """Mass (kg) of aluminium with the heat capacity of one clamp of a rig."""
    return clamps.mass * clamps.heat_capacity / ALUMINIUM
