"""Rates of change of the thermal model, vectorised over members, with an account of where the energy goes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..robots.assembly import Array
from .thermal import ThermalModel

CLAMP, CHARGE, SAG, DRAWN, CIRCUIT, LOST = range(6)
"""Entries of the lumped state: clamp temperature (K), charge used (fraction), sag (V), and energies of the rig
(J): drawn from the battery's chemistry, turned to heat in battery, cables and MOSFET, given off to the surroundings."""

LUMPED = 6


@dataclass(frozen=True, eq=False)
class State:
    """cells: (B, n, 1+M) temperatures of the tube (first) and of the shells around it, K; lumped: (B, 6)."""

    cells: Array
    lumped: Array


def at_rest(model: ThermalModel) -> State:
    """Everything at ambient temperature, the battery rested."""
    b, n, shells = model.shell_heat.shape
    b = max(b, model.members)
    lumped = np.zeros((b, LUMPED))
    lumped[:, CLAMP] = model.ambient
    return State(np.full((b, n, 1 + shells), model.ambient), lumped)


@dataclass(frozen=True, eq=False)
class Current:
    """(B,) current while the MOSFET conducts, its part through the tube, the terminal voltage then; (B, n) ohm."""

    total: Array
    tube: Array
    terminal_voltage: Array
    resistance: Array


def current(model: ThermalModel, tube: Array, lumped: Array) -> Current:
    """The circuit at tube temperatures (B, n) and lumped states (B, 6)."""
    ohm = model.resistance * (1 + model.resistance_slope * (tube - model.reference))
    whole = 2 * ohm.sum(1)
    through = 1 / (1 + whole / model.leak)
    source = model.voltage - model.voltage_slope * lumped[:, CHARGE] - lumped[:, SAG]
    total = source / (model.internal + model.series + whole * through)
    return Current(total, total * through, source - model.internal * total, ohm)


def rates(model: ThermalModel, cells: Array, lumped: Array, duty: Array | float) -> tuple[Array, Array]:
    """Rates of (cells, lumped) in K/s and per s, at a duty in [0, 1], one number or (B,)."""
    # Differences are written as slices: np.diff costs more than the arithmetic, and integrators call this 1e4 times.
    tube, shells = cells[:, :, 0], cells[:, :, 1:]
    now = current(model, tube, lumped)
    rise = tube - model.ambient
    rate = np.empty_like(cells)
    power = duty * now.tube**2
    contact = duty * now.total**2 * model.contact / 2
    into_clamp = model.to_clamp * (tube - lumped[:, CLAMP, None])
    to_air = model.to_air * rise + model.radiating * (tube**4 - model.ambient**4)
    into_mold = model.to_mold * (tube - shells[:, :, 0])
    # What a contact of the clamps makes goes half into the tube's end, half into the clamp.
    heat = power[:, None] * now.resistance - into_clamp - to_air - into_mold
    heat += (0.5 * contact)[:, None] * model.grip_share
    mean = 1 + model.conduction_slope * (0.5 * (tube[:, 1:] + tube[:, :-1]) - model.reference)
    along = model.conduction * mean * (tube[:, 1:] - tube[:, :-1])
    heat[:, :-1] += along
    heat[:, 1:] -= along
    rate[:, :, 0] = heat / (model.heat * (1 + model.heat_slope * (tube - model.reference)))

    outward = model.radial * (shells[:, :, :-1] - shells[:, :, 1:])
    outside = model.outer * (shells[:, :, -1] - model.ambient)
    stray = duty * (now.total - now.tube) * now.tube * now.resistance.sum(1)
    warming = rate[:, :, 1:]
    warming[:, :, 0] = into_mold + stray[:, None] * model.cover_share
    warming[:, :, 1:] = outward
    warming[:, :, :-1] -= outward
    warming[:, :, -1] -= outside
    sideways = model.axial * (shells[:, 1:] - shells[:, :-1])
    warming[:, :-1] += sideways
    warming[:, 1:] -= sideways
    warming /= model.shell_heat
    return rate, _lumped(model, lumped, duty, now, (into_clamp.sum(1) + 0.5 * contact, (to_air + outside).sum(1)))


def _lumped(model: ThermalModel, lumped: Array, duty: Array | float, now: Current, heat: tuple[Array, Array]) -> Array:
    """Rates of the lumped states; `heat` goes into one clamp, and from half the tube and mold to the surroundings."""
    into_clamp, to_surroundings = heat
    mean = duty * now.total
    cooling = model.clamp_loss * (lumped[:, CLAMP] - model.ambient)
    rate = np.empty_like(lumped)
    rate[:, CLAMP] = (into_clamp - cooling) / model.clamp_heat
    rate[:, CHARGE] = mean / model.capacity
    rate[:, SAG] = (mean * model.sag - lumped[:, SAG]) / model.sag_time
    rate[:, DRAWN] = mean * (model.voltage - model.voltage_slope * lumped[:, CHARGE])
    outside_tube = model.internal + model.series - model.contact
    rate[:, CIRCUIT] = mean * (lumped[:, SAG] + now.total * outside_tube)
    rate[:, LOST] = 2 * (to_surroundings + cooling)
    return rate


def stored(model: ThermalModel, state: State) -> Array:
    """(B,) heat in the whole tube, mold and both clamps above ambient, J."""
    tube, reference, slope = state.cells[:, :, 0], model.reference, model.heat_slope
    rise = tube - model.ambient
    curve = 0.5 * slope * ((tube - reference) ** 2 - (model.ambient - reference) ** 2)
    half = (model.heat * (rise + curve)).sum(1)
    half = half + (model.shell_heat * (state.cells[:, :, 1:] - model.ambient) * (model.to_mold > 0)[:, :, None]).sum(
        (1, 2)
    )
    return np.asarray(2 * (half + model.clamp_heat * (state.lumped[:, CLAMP] - model.ambient)))


def imbalance(model: ThermalModel, state: State) -> Array:
    """(B,) energy that is not accounted for, as a fraction of what was drawn from the battery."""
    lumped = state.lumped
    missing = lumped[:, DRAWN] - lumped[:, CIRCUIT] - lumped[:, LOST] - stored(model, state)
    return np.asarray(np.abs(missing) / np.maximum(lumped[:, DRAWN], 1e-12))
