"""Where the program of the ideal schedule begins: the schedule that a controller finds, which knows the model."""

from __future__ import annotations

import numpy as np

from ...physics.heat import GRIP, LEAD
from ...physics.heat_functions import CHARGE as USED
from ...physics.heat_functions import CLAMP
from ...physics.heat_functions import SAG as SAGGED
from ...robots.materials import ZERO_CELSIUS
from ...robots.tubes import Tube
from ...typing import Array
from .instant import AMPERE, CHARGE, DRIVE, DURATION, LENGTH, OHM, RISE, SAG, VENTS
from .program import Program
from .rates import State, warming_span
from .rig import Rig
from .simulation import History, simulate_feedback
from .spec import HeatingSpec
from .thermal import ThermalModel, joined, thermal_model, vent_profile


def first_guess(made: Program, tube: Tube, rig: Rig, spec: HeatingSpec) -> Array:
    """Unknowns of a schedule that heats up as fast as the ramp lets it; where that misses the window by far, of one
    that heats up for as long as it may: of two optima, IPOPT ends at the one on the side it comes from."""
    soon = (_target(spec) - rig.ambient) / _start_ramp(spec)
    found, miss = _led(made, tube, rig, spec, soon)
    if miss > 0 and soon < spec.longest_heating:
        found, miss = _led(made, tube, rig, spec, spec.longest_heating)
    design = np.array([rig.clamps.clearance, rig.mold.lead]) / LENGTH
    vents = vent_profile(rig, np.linspace(0.0, 1.0, VENTS))
    return np.concatenate([found, np.full(made.structure.points, miss), design, vents])


def _target(spec: HeatingSpec) -> float:
    """Middle of the window, K."""
    return 0.5 * sum(spec.window_degC) + ZERO_CELSIUS


def _start_ramp(spec: HeatingSpec) -> float:
    """Ramp of a guess, K/s."""
    return min(0.9 * spec.ramp, 1e3)


def _led(made: Program, tube: Tube, rig: Rig, spec: HeatingSpec, planned: float) -> tuple[Array, float]:
    """Temperatures, circuit, drives and durations of the schedule that a controller finds, which knows the model and
    leads the hottest cell, where the hold begins after `planned` s; and the miss to begin with, K."""
    s = made.structure
    model = thermal_model(tube, rig, s.resolution)
    target, ramp, hold = _target(spec), _start_ramp(spec), spec.covered_time
    count = int(np.clip(np.ceil((planned + hold) / spec.solver.guess_slot), 200, 2000))
    slot = (planned + hold) / count

    def controller(time: float, state: State) -> float:
        wanted = min(model.ambient + ramp * (time + slot), target)
        return duty_for(model, state, wanted, slot, rig.circuit.current_limit)

    history, duties = simulate_feedback(model, slot, count, controller)
    faces, points = s.mesh.times(planned, hold)
    found = _unknowns(model, history, duties, points, faces)
    durations = np.full(s.mesh.heating, planned / DURATION)
    return np.concatenate([*found, durations]), _start_miss(made, model, spec, found[0])


def _start_miss(made: Program, model: ThermalModel, spec: HeatingSpec, z: Array) -> float:
    """By how much a guess misses the window, K, where that is far: from 0, IPOPT would take a hundred tiny steps."""
    s = made.structure
    tube = model.ambient + RISE * z.reshape(s.points, s.states)[-s.holding_points :, : s.resolution.cells]
    held = joined(model, tube) - ZERO_CELSIUS
    low, high = spec.window_degC
    miss = max(low - float(held.min()), float(held.max()) - high)
    return 1.1 * miss if miss > spec.solver.guess_miss else 0.0


def duty_for(model: ThermalModel, state: State, wanted: float, slot: float, current_limit: float) -> float:
    """Duty that brings the hottest cell outside of the clamps to `wanted` (K) in a slot, within the current limit."""
    (idle,), (full,), (now,) = warming_span(model, state.cells, state.lumped)
    tube = state.cells[0, :, 0]
    hot = int(np.argmax(np.where(model.zone > GRIP, tube, 0.0)))
    need = (wanted - tube[hot]) / slot - idle[hot]
    return float(np.clip(need / (full[hot] - idle[hot]), 0.0, min(1.0, current_limit / now)))


def _unknowns(model: ThermalModel, history: History, duties: Array, points: Array, faces: Array) -> list[Array]:
    """Scaled temperatures, currents and duties of a simulation at the collocation points and nodes."""
    covered = model.zone >= LEAD
    parts = [history.tube[:, 0], history.walls[:, 0][:, covered].reshape(len(history.time), -1)]
    scaled = (np.hstack(parts) - model.ambient) / RISE
    lumped = history.lumped[:, 0]
    z = np.column_stack(
        [scaled, (lumped[:, CLAMP] - model.ambient) / RISE, lumped[:, USED] / CHARGE, lumped[:, SAGGED] / SAG]
    )
    circuit = np.column_stack([history.current[:, 0] / AMPERE, history.resistance[:, 0] / 2 / OHM])
    at = [np.column_stack([np.interp(points, history.time, x) for x in table.T]).ravel() for table in (z, circuit)]
    middle = 0.5 * (history.time[1:] + history.time[:-1])
    return [*at, np.interp(faces, middle, duties * history.current[:-1, 0] ** 2) / DRIVE]
