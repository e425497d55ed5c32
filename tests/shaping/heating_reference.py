"""Tubes and rigs of the tests of heating."""

from __future__ import annotations

import math
import re
from dataclasses import fields, replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import solve_ivp

from tubeopt import HeatingPlan, HeatingSpec, Rig, Tube, load_rig, plan_heating
from tubeopt.physics.heat import volume_shapes
from tubeopt.physics.heat_functions import LUMPED
from tubeopt.robots.materials import NITINOL
from tubeopt.shaping.heating.simulation import History, State, at_rest, history_of, rates
from tubeopt.shaping.heating.thermal import ThermalModel
from tubeopt.shaping.materials import MoldMaterial
from tubeopt.typing import Array

CONFIGS = Path(__file__).parents[2] / "configs"
THESIS_RIG = CONFIGS / "rigs" / "thesis_calcium_silicate.yaml"
TUBE = Tube(1.92e-3, 1.57e-3, 0.0, 94e-3, 1 / 0.12)


@lru_cache(maxsize=1)
def thesis_rig() -> Rig:
    return load_rig(THESIS_RIG)


def unchecked(thing: Any, **values: Any) -> Any:
    """A copy with values that no rig can have: closed forms are limits, as of an endless heat sink."""
    out = object.__new__(type(thing))
    for each in fields(thing):
        object.__setattr__(out, each.name, values.get(each.name, getattr(thing, each.name)))
    return out


def with_mold(rig: Rig, **changes: Any) -> Any:
    return unchecked(rig, mold=unchecked(rig.mold, **changes))


def mold_of(conductivity: float, heat: float = 1e6) -> MoldMaterial:
    """An insulating mold material with this conductivity and heat capacity per volume."""
    return MoldMaterial("test", conductivity, 1000.0, heat / 1000.0, 2000.0, "fails", 1e9, 0.9, "low", "a test")


def ideal_tube(**thermal: float) -> Tube:
    """The thesis' tube with constant properties, no radiation to speak of, and what else is given."""
    assert NITINOL.thermal is not None
    plain = {"heat_capacity_slope": 0.0, "resistivity_slope": 0.0, "conductivity_slope": 0.0, "emissivity": 1e-9}
    data = unchecked(NITINOL.thermal, **(plain | thermal))
    return replace(TUBE, material=replace(NITINOL, thermal=data))


@lru_cache(maxsize=1)
def thesis_plan() -> HeatingPlan:
    """The plan for the thesis' tube; made once."""
    return plan_heating(TUBE, thesis_rig(), HeatingSpec())


def conductance(model: ThermalModel, name: str) -> Array:
    """What `physics.heat.Volumes` calls so, of the first member of a model; from the cells, W/K."""
    sizes = {key: rows * columns for key, (rows, columns) in volume_shapes(model.resolution).items()}
    return dict(zip(sizes, np.split(model.volumes[0], np.cumsum(list(sizes.values()))[:-1]), strict=True))[name]


def section(tube: Tube) -> float:
    return math.pi / 4 * (tube.outer_diameter**2 - tube.inner_diameter**2)


def integrate(
    model: ThermalModel, slot: float, duty: ArrayLike, *, method: str = "LSODA", rtol: float = 1e-6, atol: float = 1e-3
) -> History:
    """One member by an adaptive, stiff integrator of SciPy, started anew wherever the duty changes."""
    levels = np.asarray(duty, dtype=float)
    start = at_rest(model)
    shape, size = start.cells.shape, start.cells.size
    trace = [np.concatenate([start.cells.ravel(), start.lumped.ravel()])]
    band = {"lband": shape[2], "uband": shape[2]} if method == "LSODA" else {}
    edges = [0, *(np.flatnonzero(np.diff(levels)) + 1).tolist(), len(levels)]
    for first, last in pairwise(edges):

        def slope(_: float, y: Array, level: float = float(levels[first])) -> Array:
            rate, lumped = rates(model, y[:size].reshape(shape), y[size:].reshape(1, LUMPED), level)
            return np.concatenate([rate.ravel(), lumped.ravel()])

        at = slot * np.arange(1, last - first + 1)
        found = solve_ivp(slope, (0.0, at[-1]), trace[-1], method=method, t_eval=at, rtol=rtol, atol=atol, **band)
        assert found.success, found.message
        trace += list(found.y.T)
    course = np.array(trace)
    cells, lumped = course[:, :size].reshape(-1, *shape), course[:, size:].reshape(-1, 1, LUMPED)
    return history_of(model, slot, State(cells, lumped))


def header_duties(text: str) -> list[int]:
    """The duties in a header of `arduino_header`."""
    found = re.search(r"HEATING_DUTY\[\w+\] PROGMEM = \{([^}]*)\}", text)
    assert found is not None
    return [int(number) for number in found[1].split(",")]
