"""Error of a thermocouple in the slot of a mold: heat that flows along its wires, cold junction, converter.

The two legs lie on the tube, in opposite directions from the bead, in a slot of the lid. Ceramic cement fills the slot
around the bead. At the ends of the slot the legs leave through holes of the lid. Along a leg

    k A T'' = g_tube (T - T_tube) + g_wall (T - T_wall)

with conductances per length to the tube and to the wall, which is colder. Rises over ambient are fractions of that of
the tube.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_banded

CONDUCTIVITY = 25.0
"""Thermal conductivity of type K wires at 500 degC, W/(m K): mean of 19 (chromel) and 30 (alumel), ASM Handbook."""

AIR, CEMENT = 0.056, 1.0
"""Conductivity of air at 500 degC, and of alumina cement (assumed), W/(m K)."""

FILM = 0.05e-3
"""Distance of a wire from the tube, m: its coat of cement, or a foil of mica."""

CEMENTED = 3e-3
"""Length of each leg that is cemented to the tube, m."""

QUALITY = 3.0
"""Factor by which the conductance of the cement may be smaller or larger than computed."""

WALL = 0.85
"""Rise of the wall of a groove in an insulating board in the hold, as a fraction of that of the tube."""

LID, HOLE, AIR_END = 6.35e-3, 1.2e-3, 30e-3
"""Thickness of the lid, diameter of its holes for the legs, and length of a leg in the air above, m."""

FREE = 15.0
"""Heat transfer coefficient of a thin wire in still air at its surface, W/(m^2 K) (assumed)."""

JUNCTION, CONVERTER, WIRE_CLASS = 2.0, 2.0, 0.004
"""Largest errors of cold junction and converter (MAX31855, data sheet), K, and of wires of class 1 (IEC 60584),
relative to the temperature in degC."""

WIRE, ANCHOR = 0.25e-3, 12e-3
"""Default diameter of the wires, and length of each leg in the slot, m: it spreads the heat that the legs draw."""

STEP = 0.05e-3
"""Distance of the points along a leg, m."""


@dataclass(frozen=True)
class StemLoss:
    """Heat that flows along both legs of a thermocouple."""

    error: float
    """Rise of the bead that is missing, as a fraction of the rise of the tube."""
    conductance: float
    """Heat drawn from the tube per rise of the tube, W/K."""


@functools.lru_cache(maxsize=64)
def stem_loss(wire: float, anchor: float, *, quality: float = 1.0) -> StemLoss:
    """Missing rise of a bead, and the heat that its legs draw.

    Args:
        wire: diameter, m. anchor: length of each leg in the slot, m.
        quality: factor on the conductance of the cement; 0 for a bead that only touches the tube.
    """
    x = np.arange(0.0, anchor + LID + AIR_END, STEP) + 0.5 * STEP
    in_slot, in_lid = x < anchor, (x >= anchor) & (x < anchor + LID)
    # A wire over a plane, and within a wider channel of 1.6 wires, or a hole.
    over_plane = 2 * math.pi / math.acosh((0.5 * wire + FILM) / (0.5 * wire))
    to_tube = np.where(in_slot, over_plane * AIR, 0.0)
    to_tube[x < CEMENTED] += quality * over_plane * CEMENT
    to_wall = np.where(in_slot, 2 * math.pi * AIR / math.log(1.8), 2 * math.pi * AIR / math.log(HOLE / wire))
    to_wall[x >= anchor + LID] = FREE * math.pi * wire
    # Through the lid the board cools to ambient.
    wall = np.where(in_slot, WALL, np.where(in_lid, WALL * (1 - (x - anchor) / LID), 0.0))
    kA = CONDUCTIVITY * math.pi / 4 * wire**2 / STEP**2
    band = np.zeros((3, len(x)))
    band[0, 1:] = band[2, :-1] = -kA
    band[1] = 2 * kA + to_tube + to_wall
    band[1, 0] -= kA  # the other leg is alike: no flow through the bead
    rise = solve_banded((1, 1), band, to_tube + to_wall * wall)
    # What a leg gives to the wall of the slot stays in the mold; the rest leaves with it through the lid.
    last = int(np.count_nonzero(in_slot))
    return StemLoss(float(1 - rise[0]), float(2 * kA * STEP * (rise[last - 1] - rise[last])))


def reading_error(wire: float, anchor: float, window: float, ambient: float) -> tuple[float, float]:
    """Lowest and highest constant error of the reading at a temperature `window`, K; temperatures in degC.

    Stem loss only lowers the reading. Errors of wire, cold junction and converter are independent.
    """
    stem = [-(window - ambient) * stem_loss(wire, anchor, quality=q).error for q in (1 / QUALITY, QUALITY)]
    others = math.sqrt(JUNCTION**2 + CONVERTER**2 + (WIRE_CLASS * window) ** 2)
    return min(stem) - others, max(stem) + others
