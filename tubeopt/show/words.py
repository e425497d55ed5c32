"""Numbers of an answer as a person reads them, and equilibria and snaps as JSON."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..equilibrium.result import Equilibrium
from ..stability import Snap
from ..typing import Array

MM = MILLI = 1e3

CLOSE_TO_A_SNAP = 0.05
"""Margin below which the table warns."""


def in_a_word(margin: float) -> str:
    """What a stability margin means."""
    if np.isnan(margin):
        return "not told: moments and following forces have no energy"
    if margin <= 0:
        return "unstable"
    return "close to a snap" if margin < CLOSE_TO_A_SNAP else "stable"


def told(margin: float) -> float | None:
    """A margin as JSON has it, which knows no NaN: None where there is none."""
    return None if np.isnan(margin) else margin


def margin_in_words(margin: float) -> str:
    """A stability margin with what it means."""
    return in_a_word(margin) if np.isnan(margin) else f"{margin:.3f}, {in_a_word(margin)}"


def row(values: ArrayLike, form: str) -> str:
    """Numbers with commas between them, none of them a negative 0."""
    return ", ".join(format(round(value, 12) + 0.0, form) for value in np.asarray(values, dtype=float))


def degrees(angles: Array, form: str = ".9g") -> str:
    """Angles (rad) in deg, with their unit."""
    return f"{row(np.degrees(angles), form)} deg"


def millimetres(lengths: Array, form: str = ".9g") -> str:
    """Lengths (m) in mm, with their unit."""
    return f"{row(np.asarray(lengths) * MM, form)} mm"


def flag(values: Array) -> str:
    """Numbers as an option of the command line takes them, to 1e-6."""
    return row(np.round(values, 6), ".12g").replace(" ", "")


def state(equilibrium: Equilibrium) -> dict[str, Any]:
    """An equilibrium in short, as JSON."""
    return {
        "stable": equilibrium.stable,
        "margin": told(equilibrium.margin),
        "index": equilibrium.index,
        "energy_mJ": equilibrium.energy * MILLI,
        **({} if equilibrium.load is None else {"potential_mJ": equilibrium.potential * MILLI}),
        "tip_position_mm": (equilibrium.tip_position * MM).tolist(),
        "tip_direction": equilibrium.tip_rotation[:, 2].tolist(),
        "tip_rotations_deg": np.degrees(equilibrium.tip_rotations).tolist(),
    }


def snap_record(snap: Snap) -> dict[str, Any]:
    """A snap as JSON."""
    return {
        "fraction": snap.fraction,
        "rotations_deg": np.degrees(snap.rotations).tolist(),
        "translations_mm": (snap.translations * MM).tolist(),
        "tip_jump_mm": snap.tip_jump * MM,
        "energy_released_mJ": snap.energy_released * MILLI,
        "before": state(snap.before),
        "after": state(snap.after),
    }
