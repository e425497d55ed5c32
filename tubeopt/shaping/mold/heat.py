"""Heat flow from a hot tube into its mold, and the cold ends of the tube, in closed form (SI).

The tube is a cylinder, suddenly at its set temperature, in an infinite mold, with a thermal contact conductance between
them. The heat flow per length has a closed Laplace transform (Carslaw and Jaeger, Conduction of Heat in Solids, 1959,
section 13.5), which is inverted numerically (Abate and Valko, Int. J. Numer. Meth. Eng. 60, 2004: the fixed Talbot
contour). The flow at the end of the hold time, as a coefficient of heat loss, gives the fin between the hot part and
the clamps.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import scipy

from ...constants import ZERO_CELSIUS
from ...errors import InputError
from ...files.field_metadata import POSITIVE, check_fields, key, unit
from ...robots.materials import NITINOL, ThermalData
from ...robots.tubes import Tube
from ...typing import Array
from ..heating.rig import gap_conductance
from ..heating.spec import HeatingSpec
from ..materials import AMBIENT_RANGE, MoldMaterial

AMBIENT = 20.0 + ZERO_CELSIUS

TYPICAL_GAP = 75e-6
"""Uniform air gap, m, equivalent to a groove of 2 mm in board around a tube of 1.92 mm (`heating.thermal`)."""

Transform = Callable[[Array], Array]


@dataclass(frozen=True)
class HeatSpec:
    """Heating conditions for the design of a mold.

    Raises:
        InputError: a number is out of its range, or the set temperature is not above ambient and clamps.
    """

    set_temperature: Annotated[
        float,
        key("set_degC"),
        POSITIVE,
        "set temperature of the curved part; default the middle of the manufacturer's range, 500 to 550 degC",
    ] = 525.0 + ZERO_CELSIUS
    tolerance: Annotated[float, unit("K"), POSITIVE, "allowed temperature drop at the ends of the curved part"] = 25.0
    hold_time: Annotated[float, key("hold_s"), POSITIVE, "hold time at the set temperature"] = 60.0
    ambient: Annotated[float, unit("degC"), AMBIENT_RANGE, "ambient temperature"] = AMBIENT
    clamp_temperature: Annotated[
        float | None,
        key("clamp_degC"),
        POSITIVE,
        "temperature of the clamps at the end of the hold time; default ambient, because they are massive",
    ] = None
    contact_conductance: Annotated[
        float,
        unit("W_per_m2_K"),
        POSITIVE,
        "thermal conductance between the whole tube surface and the mold. Default: air "
        "around a 1.92 mm tube in a 2 mm groove (75 um gap); calibrate it",
    ] = round(gap_conductance(TYPICAL_GAP, AMBIENT), 1)

    def __post_init__(self) -> None:
        check_fields(self)
        for name, cold in (("ambient", self.ambient), ("clamp_temperature", self.clamps)):
            if self.set_temperature <= cold:
                hot = self.set_temperature - ZERO_CELSIUS
                raise InputError(
                    f"set_temperature is {hot:g} degC; it must be above the {name} ({cold - ZERO_CELSIUS:g} degC)"
                )

    @property
    def rise(self) -> float:
        """Set temperature above ambient, K."""
        return self.set_temperature - self.ambient

    @property
    def clamps(self) -> float:
        """Temperature of the clamps, K."""
        return self.ambient if self.clamp_temperature is None else self.clamp_temperature


def heating_for(heat: HeatSpec) -> HeatingSpec:
    """Heating specification with the window and hold time of a mold's design."""
    degrees = heat.set_temperature - ZERO_CELSIUS
    window = (round(degrees - heat.tolerance, 9), round(degrees + heat.tolerance, 9))
    return HeatingSpec(window_degC=window, hold_time=heat.hold_time)


@dataclass(frozen=True)
class ColdEnd:
    """End of a heated tube as a fin: T(x) = T_set - (T_set - T_clamp) exp(-x / decay_length), x from the clamp."""

    length: float
    """Length from the clamp to where the tube is within the tolerance, m."""
    decay_length: float
    """Decay length sqrt(k A / (h P)), m."""
    loss_coefficient: float
    """Heat transfer coefficient h from the tube to the mold at the end of the hold time, W/(m^2 K)."""

    def of_length(self, length: float | None) -> ColdEnd:
        """Copy with a measured length (m); unchanged for None."""
        return self if length is None else replace(self, length=length)


def heat_flow(diameter: float, material: MoldMaterial, heat: HeatSpec, times: Array) -> Array:
    """(N,) heat flow from a tube into the mold per length, W/m.

    Args:
        diameter: outer diameter of the tube, m.
        times: (N,) times after the tube is hot, s.
    """
    return _invert(_flow_transform(diameter, material, heat), times)


def heat_drawn(diameter: float, material: MoldMaterial, heat: HeatSpec, times: Array) -> Array:
    """(N,) heat from a tube into the mold per length, J/m: the integral of `heat_flow`."""
    flow = _flow_transform(diameter, material, heat)
    return _invert(lambda s: flow(s) / s, times)


def cold_end(tube: Tube, material: MoldMaterial, heat: HeatSpec) -> ColdEnd:
    """Cold end of the tube next to a clamp at the end of the hold, by the fin equation.

    The fin is steady, with uniform Joule heat for the set temperature far from the clamps and loss proportional to the
    temperature. This is valid after decay_length^2 / diffusivity of the tube, about 10 s.
    """
    loss = float(heat_flow(tube.outer_diameter, material, heat, np.array([heat.hold_time]))[0]) / heat.rise
    return fin(tube, heat, loss / (math.pi * tube.outer_diameter))


def fin(tube: Tube, heat: HeatSpec, coefficient: float) -> ColdEnd:
    """Cold end of a tube as a fin; coefficient: of the heat loss, W/(m^2 K)."""
    k = thermal_data(tube).at("conductivity", heat.set_temperature)
    decay = math.sqrt(k * tube.cross_section / (coefficient * math.pi * tube.outer_diameter))
    drop = heat.set_temperature - heat.clamps
    length = decay * math.log(drop / heat.tolerance) if drop > heat.tolerance else 0.0
    return ColdEnd(length, decay, coefficient)


def thermal_growth(tube: Tube, heat: HeatSpec, decay_length: float, length: float) -> float:
    """Growth (m) of a tube of `length` (m) between clamps: the integral of its thermal expansion.

    The temperature between two clamps is T_set - (T_set - T_clamp) cosh(x / decay_length) / cosh(length / 2 /
    decay_length), with x from the middle.
    """
    cold_length = 2 * decay_length * math.tanh(length / 2 / decay_length)
    clamp_rise = heat.clamps - heat.ambient
    return thermal_data(tube).expansion * (heat.rise * (length - cold_length) + clamp_rise * cold_length)


def thermal_data(tube: Tube) -> ThermalData:
    """Thermal constants of the tube's material; of nitinol if it has none."""
    data = tube.material.thermal or NITINOL.thermal
    assert data is not None
    return data


def _flow_transform(diameter: float, material: MoldMaterial, heat: HeatSpec) -> Transform:
    """Laplace transform of the heat flow per length, W s/m."""
    contact = 1 / (heat.contact_conductance * math.pi * diameter)

    def transform(s: Array) -> Array:
        z = diameter / 2 * np.sqrt(s / material.diffusivity)
        # kve scales K_1 and K_0 alike, so that neither underflows in the quotient.
        mold = 2 * math.pi * material.conductivity * z * scipy.special.kve(1, z) / scipy.special.kve(0, z)
        return np.asarray(heat.rise / s / (contact + 1 / mold))

    return transform


def _invert(transform: Transform, times: Array) -> Array:
    """Inverse Laplace transform at `times` (N,) > 0 on the fixed Talbot contour."""
    points = 24  # more gains nothing in double precision
    angle = np.arange(1, points) * math.pi / points
    cot = 1 / np.tan(angle)
    values = []
    for time in np.asarray(times, dtype=float):
        r = 2 * points / (5 * time)
        s = r * angle * (cot + 1j)
        weight = 1 + 1j * (angle + (angle * cot - 1) * cot)
        first = 0.5 * math.exp(r * time) * transform(np.array([r + 0j]))[0].real
        values.append(r / points * (first + np.sum((np.exp(s * time) * transform(s) * weight).real)))
    return np.array(values)
