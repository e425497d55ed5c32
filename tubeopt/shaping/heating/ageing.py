"""What the heating does to the metal that is not hot enough to be set: precipitation at the cold ends.

Ti-50.8Ni wire precipitates fastest near 450 degC, which moves its austenite finish temperature; it was treated for 2 to
180 min (ASME 2nd Frontiers in Biomedical Devices, BIOMED2007, p. 89). What shorter times do is not told there.
"""

from __future__ import annotations

import numpy as np

from .plan import HeatingPlan

AGEING = (400.0, 500.0)
"""Temperatures, degC, around the fastest precipitation."""

SHORTEST = 120.0
"""Shortest treatment, s, that the source tells of."""


def ageing(plan: HeatingPlan) -> tuple[float, float]:
    """Length (m) of tube beside the curved part, at each end, whose hottest is where nitinol ages; its longest time (s)
    there."""
    half = len(plan.position) // 2
    outside = np.flatnonzero(~plan.curved[:half])
    spans = np.diff(plan.time, append=plan.time[-1])
    within = (plan.temperature[:, outside] > AGEING[0]) & (plan.temperature[:, outside] < AGEING[1])
    times = (within * spans[:, None]).sum(0)
    place = plan.position[:half]
    faces = np.concatenate([[0.0], 0.5 * (place[1:] + place[:-1]), place[-1:]])
    widths = np.diff(faces)[outside]
    hottest = plan.temperature[:, outside].max(0)
    ages = (hottest > AGEING[0]) & (hottest < AGEING[1])
    return float(widths[ages].sum()), float(times[ages].max(initial=0.0))


def ageing_words(plan: HeatingPlan) -> tuple[str, ...]:
    """What to know of it; nothing where no part of the tube gets there."""
    length, longest = ageing(plan)
    if not length:
        return ()
    than = "less" if longest < SHORTEST else "more"
    return (
        f"beside the bend {1e3 * length:.0f} mm of tube at each end get no hotter than {AGEING[0]:.0f} to "
        f"{AGEING[1]:.0f} degC, for {longest:.0f} s at most, where Ti-50.8Ni precipitates fastest and its Af moves: "
        f"{than} than the {SHORTEST:.0f} s of the shortest treatment that is told of (BIOMED2007, p. 89); measure Af "
        "of what is not cut off",
    )
