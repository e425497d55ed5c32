"""How much of a tube slots have left along it, for pictures."""

from __future__ import annotations

from ..robots.series import Series, extremes
from ..robots.tubes import Tube, stretches

DARKEST = 0.45
"""Part of a colour's light that is left where nothing is left of the stiffness."""


def slotted(tube: Tube, held: float, first: float, last: float) -> list[tuple[float, float, float]]:
    """Stretches of arc length between `first` and `last`, m, of a tube held `held` m behind the plate, with the part of
    the tube's own bending stiffness that is left there, at most 1."""
    own, begin = float(tube.bending_stiffness), -held
    out: list[tuple[float, float, float]] = []
    for length, _, bending, _ in stretches(tube):
        low, high = max(begin, first), min(begin + length, last)
        least = extremes([bending], length)[0] if isinstance(bending, Series) else float(bending)
        part = min(least / own, 1.0)
        if high > low:
            if out and out[-1][2] == part:
                out[-1] = (out[-1][0], high, part)
            else:
                out.append((low, high, part))
        begin += length
    return out


def shade(part: float) -> float:
    """By how much a colour is darkened where this part of the bending stiffness is left: 1 not at all."""
    return DARKEST + (1 - DARKEST) * part
