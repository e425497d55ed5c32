"""Heat drawn by a mold and cold ends, against finite volumes, closed limits and the fin equation."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_bvp, solve_ivp

from tubeopt import InputError, Tube
from tubeopt.shaping import (
    CALCIUM_SILICATE,
    GLASS_MICA,
    MDF,
    MOLD_MATERIALS,
    STEEL,
    HeatSpec,
    MoldMaterial,
    cold_end,
    heat_drawn,
    heat_flow,
    rank_mold_materials,
)
from tubeopt.shaping.mold.ranking import tube_heat

THESIS = Tube(1.92e-3, 1.57e-3, 0.0, 94e-3, 1 / 120e-3)


def by_finite_volumes(diameter: float, material: MoldMaterial, heat: HeatSpec, end: float) -> tuple[float, float]:
    """Heat flow (W/m) and heat drawn (J/m) at `end`, in a mold that is wide enough, by shells of growing thickness."""
    radius = diameter / 2
    outside = radius + 9 * math.sqrt(material.diffusivity * end)
    faces = radius * np.linspace(0, 1, 241) ** 2 * (outside / radius - 1) + radius
    middle = (faces[1:] + faces[:-1]) / 2
    capacity = math.pi * np.diff(faces**2) * material.density * material.heat_capacity
    between = 2 * math.pi * material.conductivity / np.log(middle[1:] / middle[:-1])
    first = 1 / (
        1 / (heat.contact_conductance * math.pi * diameter)
        + math.log(middle[0] / radius) / (2 * math.pi * material.conductivity)
    )

    def rate(_: float, rise: np.ndarray) -> np.ndarray:
        flow = np.concatenate([[first * (heat.rise - rise[0])], -between * np.diff(rise), [0.0]])
        return (flow[:-1] - flow[1:]) / capacity

    start = np.zeros(len(middle))
    out = solve_ivp(rate, (0, end), start, method="LSODA", rtol=1e-8, atol=1e-8, lband=1, uband=1)
    # Nothing leaves the outermost shell: what was drawn is in the shells.
    return first * (heat.rise - out.y[0, -1]), float(capacity @ out.y[:, -1])


@pytest.mark.parametrize("material", [CALCIUM_SILICATE, GLASS_MICA, STEEL], ids=lambda m: m.name)
def test_the_cylinder_agrees_with_finite_volumes(material: MoldMaterial) -> None:
    heat = HeatSpec()
    flow, drawn = by_finite_volumes(1.92e-3, material, heat, 60.0)
    time = np.array([60.0])
    assert heat_flow(1.92e-3, material, heat, time)[0] == pytest.approx(flow, rel=2e-3)
    assert heat_drawn(1.92e-3, material, heat, time)[0] == pytest.approx(drawn, rel=2e-3)


def test_early_it_is_a_half_space_and_late_a_line() -> None:
    perfect = replace(HeatSpec(), contact_conductance=1e12)
    m, diameter = CALCIUM_SILICATE, 1.92e-3
    early = 1e-4
    half_space = m.conductivity * perfect.rise / math.sqrt(math.pi * m.diffusivity * early) * math.pi * diameter
    # A cylinder's next term is half the conductance of a radius of material.
    half_space += m.conductivity * perfect.rise / diameter * math.pi * diameter
    assert heat_flow(diameter, m, perfect, np.array([early]))[0] == pytest.approx(half_space, rel=1e-3)
    late = 1e6
    log = math.log(4 * m.diffusivity * late / (diameter / 2) ** 2) - 2 * np.euler_gamma
    line = 4 * math.pi * m.conductivity * perfect.rise * (1 / log - np.euler_gamma / log**2)
    assert heat_flow(diameter, m, perfect, np.array([late]))[0] == pytest.approx(line, rel=1e-2)


def test_what_is_drawn_is_the_integral_of_the_flow() -> None:
    heat = HeatSpec()
    nodes, weights = np.polynomial.legendre.leggauss(20)
    times = 30 + 15 * (nodes + 1)
    between = float(weights @ heat_flow(1.2e-3, MDF, heat, times)) * 15
    ends = heat_drawn(1.2e-3, MDF, heat, np.array([30.0, 60.0]))
    assert between == pytest.approx(ends[1] - ends[0], rel=1e-8)


def test_the_cold_end_solves_the_fin_equation() -> None:
    heat = HeatSpec(clamp_temperature=340.0)
    cold = cold_end(THESIS, CALCIUM_SILICATE, heat)
    area, perimeter = math.pi / 4 * (1.92e-3**2 - 1.57e-3**2), math.pi * 1.92e-3
    loss = cold.loss_coefficient * perimeter
    joule = loss * heat.rise  # W/m, which holds the set temperature

    def fin(_: np.ndarray, state: np.ndarray) -> np.ndarray:
        return np.vstack([state[1], (loss * (state[0] - heat.ambient) - joule) / (18.0 * area)])

    x = np.linspace(0, 14 * cold.decay_length, 200)
    guess = np.vstack([np.full_like(x, heat.set_temperature), np.zeros_like(x)])
    held = solve_bvp(fin, lambda a, b: np.array([a[0] - 340.0, b[1]]), x, guess, tol=1e-8)
    assert held.sol(cold.length)[0] == pytest.approx(heat.set_temperature - heat.tolerance, abs=0.01)


def test_hot_clamps_make_no_cold_end() -> None:
    assert cold_end(THESIS, MDF, HeatSpec(clamp_temperature=780.0)).length == 0


@pytest.mark.parametrize("outer", [0.5e-3, 1.0e-3, 1.92e-3, 3.2e-3])
@pytest.mark.parametrize("hold", [5.0, 60.0, 600.0])
def test_calcium_silicate_comes_out_on_its_numbers(outer: float, hold: float) -> None:
    tube = Tube(outer, 0.8 * outer, 0.0, 0.1, 5.0)
    ratings = rank_mold_materials(tube, HeatSpec(hold_time=hold))
    assert ratings[0].material is CALCIUM_SILICATE
    assert [r.material.name for r in ratings if r.suitable] == ["calcium_silicate", "glass_mica"]
    by_name = {r.material.name: r for r in ratings}
    assert by_name["steel"].leak > 0.99
    assert by_name["mdf"].limit_margin < 0
    for r in ratings:
        assert r.heat == pytest.approx((tube_heat(tube, HeatSpec()) + r.heat_drawn) * 0.1)
        assert r.energy is None  # which battery gives it is not known
        assert r.reasons
        # No source gives the conductivity of glass-mica over temperature.
        assert any("taken as constant" in reason for reason in r.reasons) == (r.material.name == "glass_mica")


def test_the_name_wins_nothing() -> None:
    dense = replace(CALCIUM_SILICATE, conductivity=5.0, conductivity_range=None)
    conducting = replace(CALCIUM_SILICATE, resistivity=1e-6)
    weak = replace(CALCIUM_SILICATE, limit_temperature=700.0)
    for worse in (dense, conducting, weak):
        assert rank_mold_materials(THESIS, materials=(worse, GLASS_MICA))[0].material is GLASS_MICA
    better = replace(MDF, limit_temperature=1000.0, conductivity=0.05, conductivity_range=None)
    assert rank_mold_materials(THESIS, materials=(CALCIUM_SILICATE, better))[0].material is better
    cool = HeatSpec(set_temperature=500.0)
    assert {r.material.name for r in rank_mold_materials(THESIS, cool) if r.suitable} >= {"mdf"}


def test_every_number_has_its_source() -> None:
    for name, material in MOLD_MATERIALS.items():
        assert name == material.name
        assert len(material.source) > 60
    assert CALCIUM_SILICATE.electrically_insulating
    assert not STEEL.electrically_insulating


def test_materials_that_make_no_sense() -> None:
    with pytest.raises(InputError, match="conductivity of mold material 'mdf' is -1"):
        replace(MDF, conductivity=-1.0)
    with pytest.raises(InputError, match=r"emissivity of mold material 'mdf' is 1\.5"):
        replace(MDF, emissivity=1.5)
    with pytest.raises(InputError, match="price_class of mold material 'mdf' is 'cheap'"):
        replace(MDF, price_class="cheap")
    with pytest.raises(InputError, match="materials is empty"):
        rank_mold_materials(THESIS, materials=())
