"""The order of the tubes: where carriages and ends must not pass one another, and by how much they do not (SI).

At translations d a tube begins at beta = d - straight_length and ends at d + curved_length. Carriages are in order
where every inner tube begins behind the next outer one, ends where it ends beyond it; no tube may be withdrawn past the
plate. All of this is linear in lengths and translations, so that a box of translations is in order where its worst
corners are, and a straight joint path where its ends are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..robots.tubes import Tube
from ..typing import Array
from .objectives import AnyObjective, Objective
from .requirements import Poses, Requirement, SnapFree

SLACK = 1e-10
"""Length (m) by which round-off may take tubes out of order: what inverse kinematics and planning allow."""


@dataclass(frozen=True)
class Place:
    """Translations at which the order must hold: words, and the least and the greatest of every tube (n,), m."""

    words: str
    low: tuple[float, ...]
    high: tuple[float, ...]


def ordered_places(
    n_tubes: int, requirements: Sequence[Requirement], objectives: Sequence[AnyObjective]
) -> tuple[Place, ...]:
    """Where tubes must be in order: at translations 0, which is then home, and wherever a requirement or an objective
    puts them."""
    zero = (0.0,) * n_tubes
    found = [Place("at translations 0", zero, zero)]
    for one in requirements:
        match one:
            case SnapFree(translations=rows, box=box):
                found += [Place(f"at the certified translations {_mm(row)}", row, row) for row in rows or ()]
                found += [] if box is None else [Place(f"in the certified box {_mm(box[0])} to {_mm(box[1])}", *box)]
            case Poses(translations=rows):
                found += [Place(f"at the pose with translations {_mm(row)}", row, row) for row in dict.fromkeys(rows)]
            case _:
                pass
    for aim in objectives:
        if isinstance(aim, Objective) and aim.translations is not None:
            found.append(Place(f"at the objective's translations {_mm(aim.translations)}", *(aim.translations,) * 2))
    return tuple({(place.low, place.high): place for place in reversed(found)}.values())[::-1]


def order_gaps(straight: Array, curved: Array, low: Array, high: Array) -> Array:
    """(3 n - 2,) m by which the order holds between two rows of translations, < 0 where it does not: of carriages, of
    ends, from the plate; or, linear in all as it is, its change (3 n - 2, X) from those (n, X)."""
    carriages = straight[:-1] - straight[1:] + low[1:] - high[:-1]
    return np.concatenate([carriages, curved[:-1] - curved[1:] + low[:-1] - high[1:], curved + low])


def gaps_of(tubes: Sequence[Tube], low: Sequence[float] | Array, high: Sequence[float] | Array) -> Array:
    """(3 n - 2,) m by which the order of tubes holds."""
    straight, curved = (
        np.array([getattr(tube, name) for tube in tubes]) for name in ("straight_length", "curved_length")
    )
    return order_gaps(straight, curved, np.array(low), np.array(high))


def worst_order(tubes: Sequence[Tube], places: Sequence[Place]) -> tuple[float, str]:
    """Least gap of the order at places, m, and in words where and of which tubes."""
    return min((_worst(gaps_of(tubes, place.low, place.high), place) for place in places), key=lambda found: found[0])


def check_order(places: Sequence[Place], least: dict[str, Array], most: dict[str, Array]) -> None:
    """Raise InputError where no lengths within their bounds (n,) keep the order at places."""
    for place in places:
        lows = order_gaps(most["straight_length"], most["curved_length"], np.array(place.low), np.array(place.high))
        n = len(place.low)
        # The outer tube of a pair counts with its least length.
        for name, first in (("straight_length", 0), ("curved_length", n - 1)):
            lows[first : first + n - 1] += most[name][1:] - least[name][1:]
        gap, words = _worst(lows, place)
        if gap < -SLACK:
            raise InputError(
                f"{words}, whatever lengths are chosen; ordered=False (in a file: ordered: false) allows it"
            )


def _worst(gaps: Array, place: Place) -> tuple[float, str]:
    """The least gap, and a clause for it."""
    k, n = int(np.argmin(gaps)), len(place.low)
    gap = float(gaps[k])
    far = f"{abs(gap) * 1e3:.4g} mm"
    if k >= 2 * (n - 1):
        i = k - 2 * (n - 1) + 1
        side = f"ends {far} behind the plate" if gap < 0 else f"ends {far} beyond the plate"
        return gap, f"tube {i} {side} {place.words}"
    i = k % (n - 1) + 1
    inner, outer = f"tube {i}", f"tube {i + 1}"
    if k < n - 1:
        side = "before" if gap < 0 else "behind"
        return gap, f"the carriage of {inner} stands {far} {side} that of {outer} {place.words}"
    side = "inside" if gap < 0 else "beyond"
    return gap, f"{inner} ends {far} {side} {'' if gap < 0 else 'the end of '}{outer} {place.words}"


def pose_places(translations: Sequence[Array]) -> tuple[Place, ...]:
    """Places of task poses."""
    rows = [tuple(row.tolist()) for row in translations]
    return tuple(Place(f"at task pose {k}", row, row) for k, row in enumerate(rows, start=1))


def _mm(row: Sequence[float]) -> str:
    return f"({', '.join(f'{1e3 * value:.4g}' for value in row)}) mm"
