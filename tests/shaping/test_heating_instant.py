"""The balance of heat at one instant against the same physics in plain loops, cell by cell; conservation; Jacobian."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tubeopt import Rig
from tubeopt.physics.heat import Resolution
from tubeopt.physics.heat_functions import instant_function
from tubeopt.robots.materials import ThermalData
from tubeopt.shaping.heating.rig import gap_conductance
from tubeopt.shaping.heating.simulation import (
    State,
    advance,
    circuit_state,
    march,
    rates,
    step_by_step,
    stored,
    warming_span,
)
from tubeopt.shaping.heating.thermal import leak_resistance, stack, thermal_model, uniform_gap_of
from tubeopt.shaping.materials import CALCIUM_SILICATE, GLASS_MICA, MDF, STEEL
from tubeopt.solvers.compiled.heating import Windows, heating_kernel
from tubeopt.typing import Array

from .heating_reference import TUBE, ideal_tube, section, thesis_rig, with_mold

GRID = Resolution(2, 3, 4, 5, 4)
COVERED, FIRST = 9, 5
DUTY = 0.07


def rig_of(material: object) -> Rig:
    rig = replace(thesis_rig(), convection=40.0, loss_factor=1.1, resistivity_factor=1.03)
    return with_mold(rig, material=material, vents=(0.0, 0.3))


def states(count: int, ambient: float) -> tuple[Array, Array]:
    """Any temperatures, and lumped states of (clamp, charge, sag)."""
    generator = np.random.default_rng(3)
    cells = ambient + 500 * generator.random((count, 14, 1 + GRID.shells))
    return cells, np.array([ambient + 20, 0.01, 0.05, 0.0, 0.0, 0.0]) + 1e-3 * generator.random((count, 6))


class ByHand:
    """Rates of warming of half the rig with TUBE, in SI, from the rig's own numbers and the cells' widths alone."""

    def __init__(self, rig: Rig, width: Array, cells: Array, lumped: Array) -> None:
        assert TUBE.material.thermal is not None
        assert rig.convection is not None
        self.rig, self.width, self.T, self.lumped = rig, width, cells, lumped
        self.data: ThermalData = TUBE.material.thermal
        self.girth, self.area = math.pi * TUBE.outer_diameter, section(TUBE)
        place = np.cumsum(width) - width / 2 - 0.015
        self.vent = [0.3 * max(at, 0.0) / (0.02 + 0.047) for at in place]
        ratio = (rig.mold.radius / (TUBE.outer_diameter / 2)) ** (1 / GRID.shells)
        self.faces = [TUBE.outer_diameter / 2 * ratio**j for j in range(GRID.shells + 1)]
        self.circuit()
        self.heat = np.zeros_like(cells)
        self.capacity = np.ones_like(cells)
        self.clamp = -10.0 * rig.clamps.area * (lumped[0] - rig.ambient)
        self.lost = -self.clamp
        for i in range(len(width)):
            self.cell(i)

    def circuit(self) -> None:
        """Tube and leak in parallel, behind the battery and what is in series."""
        rig, d = self.rig, self.data
        rho = [rig.resistivity_factor * d.resistivity * (1 + d.resistivity_slope * (T - d.reference_temperature))
               for T in self.T[:, 0]]  # fmt: skip
        self.ohm = [0.0 if i < 2 else rho[i] * w / self.area for i, w in enumerate(self.width)]
        whole, leak = 2 * sum(self.ohm), leak_resistance(TUBE, rig)
        pair = 1 / (1 / whole + 1 / leak)
        source = rig.battery.voltage - rig.battery.voltage_slope * self.lumped[1] - self.lumped[2]
        self.total = source / (rig.battery.internal_resistance + rig.circuit.resistance + pair)
        self.through = self.total * pair / whole
        self.stray = DUTY * (self.total - self.through) * self.total * pair / 2
        self.contact = DUTY * self.total**2 * rig.circuit.contact_resistance / 2

    def cell(self, i: int) -> None:
        """What cell i and its shells gain: Joule heat, conduction to the next, clamp, air, mold."""
        rig, d, T, w = self.rig, self.data, self.T, self.width[i]
        at, heat = T[i, 0] - d.reference_temperature, self.heat
        self.capacity[i, 0] = d.density * d.heat_capacity * (1 + d.heat_capacity_slope * at) * self.area * w
        heat[i, 0] += DUTY * self.through**2 * self.ohm[i]
        if i + 1 < len(self.width):
            middle = (T[i, 0] + T[i + 1, 0]) / 2 - d.reference_temperature
            k = d.conductivity * (1 + d.conductivity_slope * middle)
            self.move((i + 1, 0), (i, 0), k * self.area * (T[i + 1, 0] - T[i, 0]) / ((w + self.width[i + 1]) / 2))
        if i < 2:
            into = rig.clamps.contact_conductance * self.girth * w * (T[i, 0] - self.lumped[0])
            heat[i, 0] += self.contact / 2 * w / rig.clamps.grip - into
            self.clamp += into + self.contact / 2 * w / rig.clamps.grip
            return
        bare = 1.0 if i < FIRST else self.vent[i]
        assert rig.convection is not None
        flux = rig.convection * (T[i, 0] - rig.ambient)
        flux += d.emissivity * 5.670374419e-8 * (T[i, 0] ** 4 - rig.ambient**4)
        self.give_off(i, 0, rig.loss_factor * bare * self.girth * w * flux)
        if i >= FIRST:
            self.mold(i, 1 - bare)

    def mold(self, i: int, touching: float) -> None:
        """Shells of cell i: layers in series, at the geometric middle of each."""
        rig, T, w = self.rig, self.T, self.width[i]
        material = rig.mold.material
        k = rig.loss_factor * material.conductivity
        f = [np.nan, *(self.factor(at) for at in T[i, 1:])]
        half = math.log(self.faces[1] / self.faces[0]) / 2 / (2 * math.pi * k * w)
        gap = 1 / (
            rig.loss_factor * gap_conductance(uniform_gap_of(TUBE, rig), rig.ambient) * touching * self.girth * w
        )
        self.move((i, 0), (i, 1), (T[i, 0] - T[i, 1]) / (gap + half / f[1]))
        self.heat[i, 1] += self.stray * w / self.width[FIRST:].sum()
        for j in range(1, GRID.shells + 1):
            ring = math.pi * (self.faces[j] ** 2 - self.faces[j - 1] ** 2)
            self.capacity[i, j] = rig.loss_factor * material.density * material.heat_capacity * ring * w
            if j < GRID.shells:
                self.move((i, j), (i, j + 1), (T[i, j] - T[i, j + 1]) / (2 * half) * (f[j] + f[j + 1]) / 2)
            if i + 1 < len(self.width):
                distance = (w + self.width[i + 1]) / 2
                both = (f[j] + self.factor(T[i + 1, j])) / 2
                self.move((i + 1, j), (i, j), both * k * ring * (T[i + 1, j] - T[i, j]) / distance)
        air = 1 / (10.0 * 2 * math.pi * self.faces[-1] * w)
        self.give_off(i, GRID.shells, (T[i, -1] - rig.ambient) / (half / self.curve(rig.ambient) + air))

    def curve(self, at: float) -> float:
        """Conductivity of the mold by its data sheet, with its slope, as a part of that at 200 degC."""
        material = self.rig.mold.material
        degrees, values = zip(*(material.conductivity_curve or ((0.0, 1.0),)), strict=True)
        ratio = np.interp(at - 273.15, degrees, values) / np.interp(200.0, degrees, values)
        return float(ratio * (1 + material.conductivity_slope * (at - 473.15)))

    def factor(self, at: float) -> float:
        """The same, linear between five temperatures, with corners that are rounded over 15 K."""
        bends = 273.15 + np.array([25.0, 200.0, 350.0, 500.0, 700.0])
        values = [self.curve(bend) for bend in bends]
        slopes = [0.0, *np.diff(values) / np.diff(bends), 0.0]
        rounded = ((at - bend + math.hypot(at - bend, 15.0)) / 2 for bend in bends)
        return values[0] + sum((b - a) * x for a, b, x in zip(slopes, slopes[1:], rounded, strict=False))

    def move(self, giver: tuple[int, int], taker: tuple[int, int], flow: float) -> None:
        self.heat[giver] -= flow
        self.heat[taker] += flow

    def give_off(self, i: int, j: int, flow: float) -> None:
        self.heat[i, j] -= flow
        self.lost += flow


@pytest.mark.parametrize("material", [CALCIUM_SILICATE, replace(MDF, conductivity_slope=-4e-4), STEEL, GLASS_MICA])
def test_the_balance_is_that_of_loops_over_the_cells(material: Any) -> None:
    rigs = [rig_of(material), replace(rig_of(material), loss_factor=0.9)]
    model = stack([thermal_model(TUBE, rig, GRID) for rig in rigs])
    cells, lumped = states(2, model.T_amb)
    rate, slow = rates(model, cells, lumped, DUTY)
    now = circuit_state(model, cells[:, :, 0], lumped)
    for b, rig in enumerate(rigs):
        expected = ByHand(rig, model.width, cells[b], lumped[b])
        np.testing.assert_allclose(rate[b], expected.heat / expected.capacity, rtol=1e-11, atol=1e-11)
        mean, battery = DUTY * expected.total, rig.battery
        assert now.I_on[b] == pytest.approx(expected.total, rel=1e-13)
        assert now.I_tube[b] == pytest.approx(expected.through, rel=1e-13)
        resistance = battery.internal_resistance + rig.circuit.resistance - rig.circuit.contact_resistance
        rest = battery.voltage - battery.voltage_slope * lumped[b, 1]
        others = [
            expected.clamp / (rig.clamps.mass * rig.clamps.heat_capacity), mean / battery.capacity,
            (mean * battery.sag_resistance - lumped[b, 2]) / battery.sag_time, mean * rest,
            mean * (lumped[b, 2] + expected.total * resistance), 2 * expected.lost,
        ]  # fmt: skip
        np.testing.assert_allclose(slow[b], others, rtol=1e-11)


@pytest.mark.parametrize("material", [CALCIUM_SILICATE, STEEL])
def test_what_the_battery_gives_is_stored_or_lost_at_every_instant(material: Any) -> None:
    """The rate of what is stored, by differences along the rates, is drawn less turned to heat in the circuit, less
    given off."""
    model = thermal_model(TUBE, rig_of(material), GRID)
    cells, lumped = states(1, model.T_amb)
    rate, slow = rates(model, cells, lumped, DUTY)
    step = 1e-2 / np.abs(rate).max()
    ahead, behind = (stored(model, State(cells + s * rate, lumped + s * slow))[0] for s in (step, -step))
    drawn, circuit, lost = slow[0, 3:]
    assert (ahead - behind) / (2 * step) == pytest.approx(drawn - circuit - lost, rel=1e-6)


def test_the_jacobian_of_the_implicit_steps_is_that_of_the_flows() -> None:
    """Without current and with a conductivity that does not depend on temperature, by central differences."""
    model = thermal_model(ideal_tube(emissivity=0.3), rig_of(GLASS_MICA), GRID)
    cells, lumped = states(1, model.T_amb)
    n, m = cells.shape[1:]
    columns = instant_function(GRID, "linearised")(cells[0].T, model.properties[0], model.volumes[0])
    heat, own, inward, along = (column.full().T[None] for column in columns)
    expected = np.zeros((n, m, n, m))
    for i in range(n):
        for j in range(m):
            shift = np.zeros_like(cells)
            shift[0, i, j] = 0.05
            up, down = (rates(model, cells + s * shift, lumped, 0.0)[0] for s in (1, -1))
            expected[:, :, i, j] = (heat * (up - down) / 0.1)[0]
    found = np.zeros_like(expected)
    for i in range(n):
        for j in range(m):
            found[i, j, i, j] = own[0, i, j]
            if j + 1 < m:
                found[i, j, i, j + 1] = found[i, j + 1, i, j] = inward[0, i, j]
            if i + 1 < n:
                found[i, j, i + 1, j] = found[i + 1, j, i, j] = along[0, i, j]
    assert (inward[0, :, -1] == 0).all()
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())


def test_one_member_in_many_states_is_each_state_alone() -> None:
    model = thermal_model(TUBE, rig_of(STEEL), GRID)
    cells, lumped = states(6, model.T_amb)
    together = rates(model, cells, lumped, DUTY)
    for k in range(6):
        alone = rates(model, cells[k : k + 1], lumped[k : k + 1], DUTY)
        np.testing.assert_array_equal(alone[0][0], together[0][k])
        np.testing.assert_array_equal(alone[1][0], together[1][k])


@pytest.mark.skipif(heating_kernel() is None, reason="no compiled kernel")
@pytest.mark.parametrize("material", [CALCIUM_SILICATE, STEEL])
def test_the_kernel_makes_the_steps_of_the_expressions(material: Any) -> None:
    """Of two rigs at once, in windows of unlike spans; also of one rig alone, whose factors are kept between calls."""
    rigs = [rig_of(material), replace(rig_of(material), loss_factor=0.9, ambient=290.0)]
    model = stack([thermal_model(TUBE, rig, GRID) for rig in rigs])
    cells, lumped = states(2, model.T_amb)
    duty = np.random.default_rng(1).random((4, 2)) * [[0.1], [0.1], [0.0], [1.0]]
    windows = Windows(np.array([0.05, 1.0, 0.2, 0.05]), np.array([1, 4, 1, 1]), duty, np.array([0, 2, 1, 3, 4]))
    here, there = (State(np.empty((5, *cells.shape)), np.empty((5, *lumped.shape))) for _ in range(2))
    for course, follow in ((here, march), (there, step_by_step)):
        course.cells[0], course.lumped[0] = cells, lumped
        follow(model, course, windows)
    np.testing.assert_allclose(here.cells, there.cells, rtol=0, atol=1e-9)
    np.testing.assert_allclose(here.lumped, there.lumped, rtol=1e-12)
    alone, one = thermal_model(TUBE, rigs[1], GRID), State(cells[1:], lumped[1:])
    for k, place in enumerate(windows.place[1:]):
        one = advance(alone, one, duty[k, 1], windows.span[k])
        np.testing.assert_allclose(one.cells[0], there.cells[place, 1], rtol=0, atol=1e-9)
    idle, full, ampere = warming_span(alone, one.cells, one.lumped)
    for rate, level in ((idle, 0.0), (full, 1.0)):
        np.testing.assert_allclose(rate, rates(alone, one.cells, one.lumped, level)[0][:, :, 0], rtol=1e-10, atol=1e-10)
    assert ampere == pytest.approx(circuit_state(alone, one.cells[:, :, 0], one.lumped).I_on, rel=1e-13)
