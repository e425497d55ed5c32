"""The heat that pegs draw from a tube in air which its own resistance heats, and the cold spots that they make.

The tube is a fin in air, warm by its current as a whole; every peg is a sink at a point. Its conductance is that of the
air around the place where two crossed cylinders touch, in series with what the pin resists: heat spreads from the place
of contact into it and goes down to the board, which stays cold. That makes it an upper bound. Air between cylinders of
radii a and b that cross at right angles, with their roughness d between them, conducts

    2 pi k sqrt(a b) ln(1 + min(a, b) / (2 d))

up to where the gap has grown by half of the smaller radius.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...robots.tubes import Tube
from ...typing import Array
from ..heating.groove_air import STANDOFF
from ..heating.rig import air_conductivity, natural_convection
from ..heating.thermal import STEFAN_BOLTZMANN
from .heat import ColdEnd, HeatSpec, fin, thermal_data


@dataclass(frozen=True, eq=False)
class PegHeat:
    """What pegs make of the tube's temperature.

    Attributes:
        dip: (M,) by which the tube is colder at each peg than without any, K. drawn: (M,) heat into each, W.
        decay_length: of a cold spot along the tube, m. loss: of the tube to air, W/m.
    """

    dip: Array
    drawn: Array
    decay_length: float
    loss: float


def tube_in_air(tube: Tube, heat: HeatSpec) -> ColdEnd:
    """The end of a tube in air as a fin, hot by its current; as `cold_end` of a mold."""
    data, hot, cold = thermal_data(tube), heat.set_temperature, heat.ambient
    radiated = data.emissivity * STEFAN_BOLTZMANN * (hot**4 - cold**4) / heat.rise
    return fin(tube, heat, natural_convection(tube.outer_diameter, hot, cold) + radiated)


def pin_conductance(tube: Tube, heat: HeatSpec, pin: float, height: float, conductivity: float) -> float:
    """W/K from a tube into the board through a pin of this diameter (m), conductivity (W/(m K)) and height (m)."""
    a, b = 0.5 * tube.outer_diameter, 0.5 * pin
    air = air_conductivity(0.5 * (heat.set_temperature + heat.ambient))
    contact = 2 * math.pi * air * math.sqrt(a * b) * math.log1p(min(a, b) / (2 * STANDOFF))
    spreading = 1 / (4 * conductivity * math.sqrt(a * b))
    down = height / (conductivity * math.pi * b**2)
    return 1 / (1 / contact + spreading + down)


def peg_heat(tube: Tube, heat: HeatSpec, places: Array, conductance: float) -> PegHeat:
    """Cold spots of pegs at `places` (M,), m, along the tube, each of this conductance (W/K); steady."""
    end = tube_in_air(tube, heat)
    girth = math.pi * tube.outer_diameter
    # A heat of 1 W makes the tube colder by this where it is drawn.
    one = 1 / (2 * end.loss_coefficient * girth * end.decay_length)
    spots = one * np.exp(-np.abs(places[:, None] - places) / end.decay_length)
    drawn = np.linalg.solve(np.eye(len(places)) / conductance + spots, np.full(len(places), heat.rise))
    return PegHeat(spots @ drawn, drawn, end.decay_length, end.loss_coefficient * girth * heat.rise)
