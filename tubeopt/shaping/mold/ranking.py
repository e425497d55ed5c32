"""Materials for a mold, ranked for a tube by what they cost in heat and current, with reasons (SI)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Annotated

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

MOST_LEAK = 0.01
"""Part of the current that may bypass the tube: above it the tube's heat can no longer be told from the current."""

SECTION_WIDTH = 50e-3
"""Width (m) of the plates whose section conducts beside the tube; that of the plate for the thesis' eccentric tube."""


@dataclass(frozen=True)
class MaterialRating:
    """A mold material for one tube."""

    material: MoldMaterial
    """Rated material."""
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
        """That the plan on the rig draws from the battery, J; None where no rig was given, or where the tube cannot be
        heated on it."""
        return self.plan.energy if self.plan is not None and self.plan.feasible else None

    @property
    def suitable(self) -> bool:
        """Whether it endures the tube and keeps the current in it, and the rig that was given holds the window."""
        held = self.plan is None or self.plan.feasible
        return held and self.limit_margin >= 0 and self.leak <= MOST_LEAK


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
    """The materials in order: those that are suitable, then the others; each by the energy from the battery.

    Those on which the rig misses the window come last, by their miss. Without a rig the heat of tube and mold counts.

    The mold is taken without end around the tube (`heat_drawn`); for a metal plate that is an upper bound.

    Args:
        tube: the tube to be set.
        heat: set temperature, hold time and so on.
        materials: to compare.
        plate: whose section conducts beside the tube.
        rig: on which a heating is planned with a mold of each material, as by `plan_heating`; by default none is.
        time_limit: s, on the clock.

    Raises:
        InputError: no material, a tube without a curved part or of another metal than nitinol, or a temperature at
            which it cannot be set.
        TimeLimitError: (a SolveError) the time limit was reached before there was an answer.
    """
    given = tuple(materials)
    if not given:
        raise InputError("materials is empty; there must be at least one")
    if tube.curved_length == 0:
        raise InputError("the tube has no curved part; it needs no mold")
    heat = heat or HeatSpec()
    degrees = heat.set_temperature - ZERO_CELSIUS
    check_temperatures(tube.material, "set_temperature", degrees, degrees)
    ratings = [_rate(tube, material, heat, plate or PlateSpec()) for material in given]
    if rig is not None:
        ratings = [replace(rating, plan=_planned(tube, heat, rig, rating.material)) for rating in ratings]
    least = min(rating.heat_drawn for rating in ratings)
    explained = [replace(rating, reasons=_reasons(rating, heat, least)) for rating in ratings]
    return tuple(sorted(explained, key=_place))


def _place(rating: MaterialRating) -> tuple[bool, bool, float]:
    """Sort key of a rating: suitable first, then feasible plans, then energy or miss."""
    if rating.plan is None:
        return not rating.suitable, False, rating.heat
    missed = rating.energy is None
    return not rating.suitable, missed, rating.plan.shortfall if missed else rating.plan.energy


def tube_heat(tube: Tube, heat: HeatSpec) -> float:
    """J per m to bring the tube itself from ambient to the set temperature."""
    data = thermal_data(tube)
    mean = (heat.set_temperature + heat.ambient) / 2
    return data.density * data.at("heat_capacity", mean) * tube.cross_section * heat.rise


def current_leak(tube: Tube, material: MoldMaterial, heat: HeatSpec, plate: PlateSpec) -> float:
    """Part of the current that runs through both plates beside the tube, with perfect contact."""
    data = thermal_data(tube)
    resistivity = data.at("resistivity", heat.set_temperature)
    width = plate.size[1] if plate.size else SECTION_WIDTH
    beside = width * (plate.thickness + plate.lid_thickness) / material.resistivity
    return beside / (beside + tube.cross_section / resistivity)


def _rate(tube: Tube, material: MoldMaterial, heat: HeatSpec, plate: PlateSpec) -> MaterialRating:
    end = np.array([heat.hold_time])
    drawn = float(heat_drawn(tube.outer_diameter, material, heat, end)[0])
    return MaterialRating(
        material=material,
        heat_drawn=drawn,
        heat_flow=float(heat_flow(tube.outer_diameter, material, heat, end)[0]),
        leak=current_leak(tube, material, heat, plate),
        heat=(tube_heat(tube, heat) + drawn) * tube.curved_length,
        limit_margin=material.limit_temperature - heat.set_temperature,
    )


def _planned(tube: Tube, heat: HeatSpec, rig: Rig, material: MoldMaterial) -> HeatingPlan:
    """The heating of a tube on a rig with a mold of a material; nothing that would help is searched for."""
    on = replace(rig, mold=replace(rig.mold, material=material))
    return plan_heating(tube, on, heating_for(heat), cures=False)


def _reasons(rating: MaterialRating, heat: HeatSpec, least: float) -> tuple[str, ...]:
    m, reasons = rating.material, []
    if rating.limit_margin < 0:
        reasons.append(f"{m.failure} above {m.limit_temperature_degC:.0f} degC, {-rating.limit_margin:.0f} K too low")
    else:
        reasons.append(f"endures {m.limit_temperature_degC:.0f} degC, {rating.limit_margin:.0f} K to spare")
    if rating.leak > MOST_LEAK:
        reasons.append(f"takes up to {rating.leak * 100:.4g} % of the current")
    else:
        reasons.append("insulates")
    if rating.plan is not None:
        verdict = rating.plan.verdict
        reasons.append(f"{verdict} on the rig" if rating.plan.feasible else f"cannot be heated on the rig: {verdict}")
    draws = rating.heat_drawn / least
    times = f"{draws:.2g} times " if draws > 1 else ""
    reasons.append(f"draws {times}the least heat in {heat.hold_time:g} s")
    return tuple(reasons)
