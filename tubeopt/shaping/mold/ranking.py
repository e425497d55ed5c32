"""Mold materials ranked for a tube by heat and current losses, with reasons (SI)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Annotated, NamedTuple

import numpy as np

from ...constants import ZERO_CELSIUS
from ...errors import InputError
from ...files.field_metadata import unit
from ...robots.tubes import Tube
from ...solvers.time_limit import TIME_LIMIT, limited
from ..heating.plan import HeatingPlan
from ..heating.planning import plan_heating
from ..heating.rig import Rig
from ..materials import MOLD_MATERIALS, MoldMaterial, check_temperatures
from .heat import HeatSpec, heat_drawn, heat_flow, heating_for, thermal_data
from .spec import PlateSpec

# With a larger leak, the tube's heat does not follow from the measured current.
MAX_LEAK = 0.01
"""Largest fraction of the current that may bypass the tube through the mold."""

SECTION_WIDTH = 50e-3
"""Width of plates of free size that conducts next to the tube, m: as on the plate for the thesis' eccentric tube."""


@dataclass(frozen=True)
class MaterialRating:
    """A mold material for one tube."""

    material: MoldMaterial
    """Material of the mold."""
    heat_drawn: Annotated[float, unit("J_per_m"), "heat into the mold per length of tube during the hold"]
    """The tube is hot from the beginning."""
    heat_flow: Annotated[float, unit("W_per_m"), "heat flow into the mold per length of tube at the end of the hold"]
    leak: Annotated[float, "fraction of the current that leaks into the mold"]
    """Upper bound: with perfect contact."""
    heat: Annotated[float, unit("J"), "heat of the curved part and of the mold around it, until the end of the hold"]
    """Ends and circuit take more."""
    limit_margin: Annotated[float, unit("K"), "margin to that limit"]
    """Limit of the material less the set temperature."""
    plan: HeatingPlan | None = None
    """Heating plan on the rig with such a mold; None without a rig."""
    reasons: Annotated[tuple[str, ...], "reasons for and against it"] = ()

    @property
    def shortfall(self) -> float | None:
        """Miss of the window by the plan on the rig, K; None without a rig."""
        return None if self.plan is None else self.plan.shortfall

    @property
    def energy(self) -> float | None:
        """Energy from the battery for the plan on the rig, J; None without a rig or a feasible plan."""
        return self.plan.energy if self.plan is not None and self.plan.feasible else None

    @property
    def suitable(self) -> bool:
        """True for a material that endures the set temperature, insulates, and has a feasible plan on the rig."""
        feasible = self.plan is None or self.plan.feasible
        return feasible and self.limit_margin >= 0 and self.leak <= MAX_LEAK


@limited
def rank_mold_materials(
    tube: Tube,
    heat: HeatSpec | None = None,
    *,
    materials: Iterable[MoldMaterial] = tuple(MOLD_MATERIALS.values()),
    plate: PlateSpec | None = None,
    rig: Rig | None = None,
    time_limit: float = TIME_LIMIT,
) -> tuple[MaterialRating, ...]:
    """Mold materials for a tube, best first: suitable materials by energy, then the others.

    The energy is that from the battery of the rig; materials with which the rig misses the window are last, by their
    miss. Without a rig, it is the heat of tube and mold.

    The mold is infinite around the tube (`heat_drawn`); for a metal plate, this is an upper bound.

    Args:
        tube: the tube to be set.
        heat: set temperature, hold time and so on.
        materials: materials to compare.
        plate: plates that conduct current beside the tube.
        rig: rig for a heating plan with a mold of each material, as by `plan_heating`; by default none is planned.
        time_limit: wall-clock time limit, s.

    Raises:
        InputError: no material, a tube without a curved part or of another metal than nitinol, or a temperature at
            which it cannot be set.
        TimeLimitError: (a SolveError) the time limit was reached before there was an answer.
    """
    compared = tuple(materials)
    if not compared:
        raise InputError("materials is empty; there must be at least one")
    if tube.curved_length == 0:
        raise InputError("the tube has no curved part; it needs no mold")
    heat = heat or HeatSpec()
    degrees = heat.set_temperature - ZERO_CELSIUS
    check_temperatures(tube.material, "set_temperature", degrees, degrees)
    ratings = [_rate(tube, material, heat, plate or PlateSpec()) for material in compared]
    if rig is not None:
        ratings = [replace(rating, plan=_planned(tube, heat, rig, rating.material)) for rating in ratings]
    min_heat = min(rating.heat_drawn for rating in ratings)
    explained = [replace(rating, reasons=_reasons(rating, heat, min_heat)) for rating in ratings]
    return tuple(sorted(explained, key=_rank))


class _Rank(NamedTuple):
    """Sort key of a rating."""

    unsuitable: bool
    missed: bool
    """True if the plan on the rig misses the window."""
    loss: float
    """Heat or energy, J; for a missed window, the miss, K."""


def _rank(rating: MaterialRating) -> _Rank:
    """Sort key of a rating: suitable first, then feasible plans, then energy or miss."""
    if rating.plan is None:
        return _Rank(not rating.suitable, False, rating.heat)
    missed = not rating.plan.feasible
    return _Rank(not rating.suitable, missed, rating.plan.shortfall if missed else rating.plan.energy)


def tube_heat(tube: Tube, heat: HeatSpec) -> float:
    """Heat per length of tube from ambient to the set temperature, J/m."""
    data = thermal_data(tube)
    mean = (heat.set_temperature + heat.ambient) / 2
    return data.density * data.at("heat_capacity", mean) * tube.cross_section * heat.rise


def _rate(tube: Tube, material: MoldMaterial, heat: HeatSpec, plate: PlateSpec) -> MaterialRating:
    """Rating of a material without a rig and without reasons."""
    end = np.array([heat.hold_time])
    drawn = float(heat_drawn(tube.outer_diameter, material, heat, end)[0])
    # Conductances per length: both plates beside the tube, with perfect contact, and the tube itself.
    width = plate.size[1] if plate.size else SECTION_WIDTH
    surrounding = width * (plate.thickness + plate.lid_thickness) / material.resistivity
    through_tube = tube.cross_section / thermal_data(tube).at("resistivity", heat.set_temperature)
    return MaterialRating(
        material=material,
        heat_drawn=drawn,
        heat_flow=float(heat_flow(tube.outer_diameter, material, heat, end)[0]),
        leak=surrounding / (surrounding + through_tube),
        heat=(tube_heat(tube, heat) + drawn) * tube.curved_length,
        limit_margin=material.limit_temperature - heat.set_temperature,
    )


def _planned(tube: Tube, heat: HeatSpec, rig: Rig, material: MoldMaterial) -> HeatingPlan:
    """Heating plan of a tube on a rig with a mold of a material, without a search for remedies."""
    with_material = replace(rig, mold=replace(rig.mold, material=material))
    return plan_heating(tube, with_material, heating_for(heat), cures=False)


def _reasons(rating: MaterialRating, heat: HeatSpec, min_heat: float) -> tuple[str, ...]:
    """Reasons for and against a material; min_heat: smallest heat into a mold of all materials, J/m."""
    m, reasons = rating.material, []
    if rating.limit_margin < 0:
        reasons.append(f"{m.failure} above {m.limit_temperature_degC:.0f} degC, {-rating.limit_margin:.0f} K too low")
    else:
        reasons.append(f"endures {m.limit_temperature_degC:.0f} degC, {rating.limit_margin:.0f} K to spare")
    if rating.leak > MAX_LEAK:
        reasons.append(f"takes up to {rating.leak * 100:.4g} % of the current")
    else:
        reasons.append("insulates")
    if rating.plan is not None:
        verdict = rating.plan.verdict
        reasons.append(f"{verdict} on the rig" if rating.plan.feasible else f"cannot be heated on the rig: {verdict}")
    ratio = rating.heat_drawn / min_heat
    times = f"{ratio:.2g} times " if ratio > 1 else ""
    reasons.append(f"draws {times}the least heat in {heat.hold_time:g} s")
    if not m.conductivity_curve:
        reasons.append("conductivity over temperature not known, taken as constant")
    return tuple(reasons)
