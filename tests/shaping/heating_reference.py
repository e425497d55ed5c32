"""Tubes and rigs of the tests of heating."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from tubeopt import HeatingPlan, HeatingSpec, Rig, Tube, load_rig, plan_heating
from tubeopt.robots.materials import NITINOL
from tubeopt.shaping.materials import MoldMaterial

CONFIGS = Path(__file__).parents[2] / "configs"
THESIS_RIG = CONFIGS / "rigs" / "thesis_calcium_silicate.yaml"
TUBE = Tube(1.92e-3, 1.57e-3, 0.0, 94e-3, 1 / 0.12)


def thesis_rig() -> Rig:
    return load_rig(THESIS_RIG)


def with_mold(rig: Rig, **changes: Any) -> Rig:
    return replace(rig, mold=replace(rig.mold, **changes))


def mold_of(conductivity: float, heat: float = 1e6) -> MoldMaterial:
    """An insulating mold material with this conductivity and heat capacity per volume."""
    return MoldMaterial("test", conductivity, 1000.0, heat / 1000.0, 2000.0, "fails", 1e9, 0.9, "low", "a test")


def ideal_tube(**thermal: float) -> Tube:
    """The thesis' tube with constant properties, no radiation to speak of, and what else is given."""
    assert NITINOL.thermal is not None
    plain = {"heat_capacity_slope": 0.0, "resistivity_slope": 0.0, "conductivity_slope": 0.0, "emissivity": 1e-9}
    data = replace(NITINOL.thermal, **(plain | thermal))
    return replace(TUBE, material=replace(NITINOL, thermal=data))


@lru_cache(maxsize=1)
def thesis_plan() -> HeatingPlan:
    """The plan for the thesis' tube; made once."""
    return plan_heating(TUBE, thesis_rig(), HeatingSpec())


def section(tube: Tube) -> float:
    return math.pi / 4 * (tube.outer_diameter**2 - tube.inner_diameter**2)
