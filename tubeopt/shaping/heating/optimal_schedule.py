"""The ideal schedule: the program given numbers, a guess and bounds, solved, and its answer in plain arrays."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from ...constants import ZERO_CELSIUS
from ...errors import SolveError, without_unit_warnings
from ...physics.heat import GRIP, LEAD
from ...physics.heat_functions import CHARGE as USED
from ...physics.heat_functions import CLAMP
from ...physics.heat_functions import SAG as SAGGED
from ...robots.tubes import Tube
from ...typing import Array
from .counts import count_rate, full_current
from .optimal_control import (
    AMPERE,
    CHARGE,
    DRIVE,
    DURATION,
    LENGTH,
    OHM,
    RISE,
    SAG,
    VENTS,
    WINDOW,
    WISHES,
    Program,
    Structure,
    physics,
    program,
)
from .rig import COUNTS, Rig
from .simulation import History, State, simulate, simulate_feedback, warming_span
from .spec import HeatingSpec
from .thermal import PROGRAM, ThermalModel, curve_start, joined, thermal_model, vent_profile

# The program limits the ramp at its collocation points only; between them, and on the fine grid, it is more. Half of it
# begins a hold up to 1.5 s sooner, twice 2 to 3 s later.
RAMP_KEPT = 0.03
"""Share of the ramp that is kept for the fine grid."""

# Where room for counts would take nearly all of the ramp, the heating would never end. Half and twice change no plan.
RAMP_LEFT = 0.15
"""Share of the ramp that is left at least when room is made for whole counts."""

# More than any tube misses a window by: with it the program is always feasible, at a price.
MOST_MISS = 1500.0
"""Largest miss of the window, K."""

# Drives are linear between 25 nodes; a duty is their quotient by a current that changes slowly. 16 points on each
# interval follow it to a thousandth of a count: half and twice change no plan.
DUTY_POINTS = 401
"""Points of the piecewise linear duty over heating and hold."""

# Half and twice change neither a plan nor its time.
GUESS_SLOT = 0.25
"""Slot of the controller that finds the starting schedule, s."""

# From a small miss IPOPT takes the slack back in a few steps; where the start is far off, a slack of 0 takes a hundred.
# Half and twice change no plan.
GUESS_MISS = 20.0
"""Miss of the window by the starting schedule above which the program starts with slack, K."""

WEIGHTS = {
    "time": {"w_time": 1.0, "w_energy": 0.0, "w_centre": 0.02, "w_miss": 1.0, "w_drive": 0.01},
    "energy": {"w_time": 0.3, "w_energy": 5.0, "w_centre": 0.02, "w_miss": 3.0, "w_drive": 0.01},
    "margin": {"w_time": 0.3, "w_energy": 0.0, "w_centre": 0.02, "w_miss": 1.0, "w_drive": 0.01},
}
"""Per s / 30, J / 1e4, square of 25 K, K, and square of steps of the drive of 100 A^2."""


@dataclass(frozen=True, eq=False)
class Ideal:
    """The ideal schedule."""

    heating: float
    """Time at which the hold begins, s."""
    node_time: Array
    """(K,) between which the duty is linear, s."""
    node_duty: Array
    """(K,) duties there, as fractions."""
    miss: float
    """By how much the window, narrowed by the reserve, is missed, K; below 0 only for "margin"."""
    rig: Rig
    """With clearance, lead and vents as chosen."""
    time: Array
    """(N,) collocation points, s."""
    tube: Array
    """(N, n) temperatures there, K."""
    held: Array
    """(H, 1 + c) at the points of the hold, where the curved part begins and at its cells, K."""
    iterations: int
    """Of IPOPT."""
    x: Array
    """Scaled unknowns, for a later guess; without the copies of what is chosen of the rig."""
    multipliers: tuple[Array, Array] = (np.zeros(0), np.zeros(0))
    """Of bounds and constraints, as the unknowns."""

    @property
    def lead_gains(self) -> bool:
        """Whether a longer lead would be better: at its bound, the multiplier of the lead is its slope."""
        return bool(self.multipliers[0][-1 - VENTS] > 0)

    def duty(self, slot: float, count: int) -> Array:
        """(count,) mean duty in every slot from the start; the last duty goes on after the end."""
        edges = slot * np.arange(count + 1)
        both = np.union1d(self.node_time, edges)
        duty = np.interp(both, self.node_time, self.node_duty)
        total = scipy.integrate.cumulative_trapezoid(duty, both, initial=0.0)[np.searchsorted(both, edges)]
        return np.asarray(np.clip(np.diff(total) / slot, 0.0, 1.0))


@dataclass(frozen=True, eq=False)
class Shift:
    """What a finer model adds to the program's temperatures, K."""

    held: Array
    """(H, 1 + c) at the points of the hold, where the curved part begins and at its cells."""
    tube: Array
    """(N, n) at all points and cells."""

    @classmethod
    def between(cls, ideal: Ideal, tube: Tube, model: ThermalModel, history: History, slots: int) -> Shift:
        """From the program's answer to a finer model; `history` is what the same duties do to it for so many slots."""
        slot = float(history.time[1])
        # The hold of the program may end within the slot after the last one that is heated.
        duties = ideal.duty(slot, max(math.ceil(ideal.time[-1] / slot), slots) + 1)
        later = simulate(model, slot, duties[slots:], start=history.state(slots))
        temperature = np.concatenate([history.tube[: slots + 1, 0], later.tube[1:, 0]])
        time = slot * np.arange(len(temperature))
        coarse = thermal_model(tube, ideal.rig, PROGRAM)
        at_time = np.array([np.interp(ideal.time, time, column) for column in temperature.T]).T
        fine = np.array([np.interp(coarse.position, model.position, row) for row in at_time])
        first = len(ideal.time) - len(ideal.held)
        edge = np.array([[np.interp(curve_start(model), model.position, row)] for row in at_time[first:]])
        return cls(np.hstack([edge, fine[first:][:, coarse.curved]]) - ideal.held, fine - ideal.tube)

    def near(self, other: Shift, tolerance: float) -> bool:
        """Whether two shifts differ by less than `tolerance`, K."""
        return bool(np.abs(self.held - other.held).max() < tolerance)


def solve_ideal(
    tube: Tube,
    rig: Rig,
    spec: HeatingSpec,
    *,
    reserve: tuple[float, float] = (0.0, 0.0),
    room: float = 0.75,
    shift: Shift | None = None,
    guess: Ideal | None = None,
    below: bool = True,
) -> Ideal:
    """The schedule that is best with a duty of any value.

    Args:
        reserve: by how much the window is narrowed at its low and its high end, K; the limit as at the high end.
        room: counts of the duty for whose warming room is left below the ramp.
        shift: what a finer model adds to the temperatures.
        guess: an earlier answer to a similar question.
        below: whether objective "margin" keeps off the limit as off the window's ends; where the window is missed it
            does not, since the limit would give way as well.

    Raises:
        SolveError: IPOPT did not converge; the message says at what the worst constraint is.
    """
    structure = Structure(PROGRAM, clear=below and spec.objective == "margin", chosen=spec.free)
    made = program(structure)
    x = guess.x if guess is not None else first_guess(made, tube, rig, spec)
    lower, upper = _unknown_bounds(structure, tube, rig, spec)
    lbg, ubg = _constraint_bounds(made, shift)
    if not structure.clear:
        tubes = upper[: structure.points * structure.states].reshape(structure.points, -1)[:, : PROGRAM.cells]
        tubes[:] = (spec.limit - reserve[1] + ZERO_CELSIUS - rig.ambient - (0 if shift is None else shift.tube)) / RISE
    p = np.concatenate([physics(tube, rig, structure.resolution), _wishes(spec, tube, rig, reserve, room)])
    x = np.clip(np.concatenate([x, structure.copies_of(x[-2 - VENTS :])]), lower, upper)
    bounds = {"p": p, "lbx": lower, "ubx": upper, "lbg": lbg, "ubg": ubg}
    found, stats = _solved(made, spec, x, bounds, guess)
    g = found["g"].full().ravel()
    violation = np.maximum(lbg - g, g - ubg)
    if not stats["success"] and violation.max() > 1e-5:
        raise SolveError(f"IPOPT found no heating schedule ({stats['return_status'].replace('_', ' ').lower()}): "
                         f"{made.worst(violation)}")  # fmt: skip
    kept = [len(given) - structure.copies for given in (lower, lbg)]
    multipliers = found["lam_x"].full().ravel()[: kept[0]], found["lam_g"].full().ravel()[: kept[1]]
    answer = _read(made, tube, rig, spec, found["x"].full().ravel(), int(stats["iter_count"]))
    if spec.objective == "margin" and below and answer.miss > 0:
        asked: dict[str, Any] = {"reserve": reserve, "room": room, "shift": shift}
        return solve_ideal(tube, rig, spec, **asked, guess=guess, below=False)
    return replace(answer, multipliers=multipliers)


def _solved(
    made: Program, spec: HeatingSpec, x: Array, bounds: dict[str, Array], guess: Ideal | None
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Solution and statistics of the first solver that converges: from the earlier answer, anew, convex Hessian."""
    attempts: list[tuple[Any, dict[str, Array]]] = [(made.exact, {}), (made.convex, {})]
    # The multipliers of a program with other constraints are of no use.
    if guess is not None and not spec.free and guess.multipliers[1].size == bounds["lbg"].size:
        attempts.insert(0, (made.again, {"lam_x0": guess.multipliers[0], "lam_g0": guess.multipliers[1]}))
    for solver, start in attempts:
        found = solver(x0=x, **start, **bounds)
        stats = solver.stats()
        if stats["success"]:
            break
    return found, stats


def planned_ramp(tube: Tube, rig: Rig, spec: HeatingSpec, room: float) -> float:
    """The ramp less what the fine grid takes of it and `room` counts, K/s."""
    ramp, count = (1 - RAMP_KEPT) * spec.ramp, count_rate(tube, rig)
    # Rounded to the nearest count a duty is up to half a count greater. Where one is too much, no room would do.
    return max(ramp - room * count, RAMP_LEFT * spec.ramp) if count < ramp else ramp


def _wishes(spec: HeatingSpec, tube: Tube, rig: Rig, reserve: tuple[float, float], room: float) -> Array:
    low, high = spec.window_degC
    # By sum-up rounding it is up to a whole count greater.
    current = max(rig.circuit.current_limit - full_current(tube, rig) / COUNTS, 0.5 * rig.circuit.current_limit)
    values = {
        "hold": spec.covered_time,
        "low": low + reserve[0] + ZERO_CELSIUS,
        "high": high - reserve[1] + ZERO_CELSIUS,
        "limit": spec.limit - reserve[1] + ZERO_CELSIUS,
        "ramp": planned_ramp(tube, rig, spec, room),
        "current": current,
        **WEIGHTS[spec.objective],
    }
    return np.array([values[name] for name in WISHES])


def _bounds(limits: Mapping[str, Sequence[Any]], sizes: Mapping[str, int]) -> tuple[Array, Array]:
    """Lower and upper bounds of everything by name, in the order of the sizes."""
    lower, upper = (
        np.concatenate([np.broadcast_to(np.ravel(limits[name][side]), (size,)) for name, size in sizes.items()])
        for side in (0, 1)
    )
    return lower, upper


def _unknown_bounds(s: Structure, tube: Tube, rig: Rig, spec: HeatingSpec) -> tuple[Array, Array]:
    hot = np.full((s.points, s.states), np.inf)
    # What the battery holds is what can be drawn.
    hot[:, -2] = rig.battery.state_of_charge / CHARGE
    # The points of a long heating look at the ramp too late; at rest nothing is lost yet, and it bounds the drive.
    drives = np.full(s.unknowns["drive"][1], np.inf)
    drives[0] = spec.ramp / (COUNTS * count_rate(tube, rig)) * full_current(tube, rig, leaking=False) ** 2 / DRIVE
    given = {"clearance": (rig.clamps.clearance, spec.clearance_range), "lead": (rig.mold.lead, spec.lead_range)}
    lengths = np.array([ends if name in spec.free else (own, own) for name, (own, ends) in given.items()]) / LENGTH
    vents = vent_profile(rig, np.linspace(0.0, 1.0, VENTS))
    opened = (0 * vents, 0 * vents + spec.most_vent) if "vents" in spec.free else (vents, vents)
    limits = {
        "z": (-np.inf, hot),
        "circuit": (0.0, np.inf),
        "drive": (0.0, drives),
        "durations": (0.5 / DURATION, spec.longest_heating / DURATION),
        "misses": (-1e3 if spec.objective == "margin" else 0.0, MOST_MISS),
        "design": [np.concatenate(side) for side in zip(lengths.T, opened, strict=True)],
        "copies": (-np.inf, np.inf),
    }
    return _bounds(limits, {name: rows * columns for name, (rows, columns) in s.unknowns.items()})


def _constraint_bounds(made: Program, shift: Shift | None) -> tuple[Array, Array]:
    limits: dict[str, tuple[Any, Any]] = {
        "equations": (0.0, 0.0), "same": (0.0, 0.0), "low": (0.0, np.inf), "high": (-np.inf, 0.0),
        "limit": (-np.inf, 0.0), "ramp": (-np.inf, 1.0), "current": (-np.inf, 1.0), "duty": (-np.inf, 0.0),
        "chosen": (0.0, 0.0),
    }  # fmt: skip
    if shift is not None:
        # The constraints of the window are written in units of WINDOW, that of the limit in units of RISE.
        limits["low"] = (-shift.held / WINDOW, np.inf)
        limits["high"] = (-np.inf, -shift.held / WINDOW)
        if made.structure.clear:
            limits["limit"] = (-np.inf, -shift.tube / RISE)
    return _bounds(limits, made.sizes)


# --- the answer ---------------------------------------------------------------------------------------------------


@without_unit_warnings()
def _read(made: Program, tube: Tube, rig: Rig, spec: HeatingSpec, x: Array, iterations: int) -> Ideal:
    Z, circuit, u, duration, miss, design = (part.full() for part in made.split(x))
    heating = DURATION * float(duration[0, 0])
    faces, points = made.structure.mesh.times(heating, spec.covered_time)
    # The drive is linear between the nodes, the current is known at the points: the duty is curved a little.
    fine = np.unique(np.concatenate([faces, np.linspace(0.0, faces[-1], DUTY_POINTS)]))
    ampere = AMPERE * np.interp(fine, points, circuit[0])
    duty = DRIVE * np.interp(fine, faces, u.ravel()) / ampere**2
    clamps, mold = rig.clamps, rig.mold
    if "clearance" in spec.free:
        clamps = replace(clamps, clearance=LENGTH * float(design[0, 0]))
    if "lead" in spec.free:
        mold = replace(mold, lead=LENGTH * float(design[1, 0]))
    if "vents" in spec.free:
        mold = replace(mold, vents=tuple(np.clip(design[2:, 0], 0.0, 0.5).tolist()))
    chosen = replace(rig, clamps=clamps, mold=mold)
    temperature = rig.ambient + RISE * Z[: made.structure.resolution.cells].T
    first_held = made.structure.mesh.heating * made.structure.mesh.degree - 1
    return Ideal(
        heating=heating,
        node_time=fine,
        node_duty=np.clip(duty, 0.0, 1.0),
        miss=float(miss[0, 0]),
        rig=chosen,
        time=points,
        tube=temperature,
        held=joined(thermal_model(tube, chosen, made.structure.resolution), temperature[first_held:]),
        iterations=iterations,
        x=x[: len(x) - made.structure.copies],
    )


# --- where it begins: the schedule that a controller finds, which knows the model -------------------------------------


def first_guess(made: Program, tube: Tube, rig: Rig, spec: HeatingSpec) -> Array:
    """Unknowns of a schedule that heats up as fast as the ramp lets it; where that misses the window by far, of one
    that heats up for as long as it may: of two optima, IPOPT ends at the one on the side it comes from."""
    target, ramp = _aim(spec)
    soon = (target - rig.ambient) / ramp
    found, miss = _led(made, tube, rig, spec, soon)
    if miss > 0 and soon < spec.longest_heating:
        found, miss = _led(made, tube, rig, spec, spec.longest_heating)
    design = np.array([rig.clamps.clearance, rig.mold.lead]) / LENGTH
    vents = vent_profile(rig, np.linspace(0.0, 1.0, VENTS))
    return np.concatenate([found, np.full(made.structure.points, miss), design, vents])


def _aim(spec: HeatingSpec) -> tuple[float, float]:
    """Where a guess goes, the middle of the window, K, and its ramp, K/s."""
    return 0.5 * sum(spec.window_degC) + ZERO_CELSIUS, min(0.9 * spec.ramp, 1e3)


def _led(made: Program, tube: Tube, rig: Rig, spec: HeatingSpec, planned: float) -> tuple[Array, float]:
    """Temperatures, circuit, drives and durations of the schedule that a controller finds, which knows the model and
    leads the hottest cell, where the hold begins after `planned` s; and the miss to begin with, K."""
    s = made.structure
    model = thermal_model(tube, rig, s.resolution)
    (target, ramp), hold = _aim(spec), spec.covered_time
    count = int(np.clip(np.ceil((planned + hold) / GUESS_SLOT), 200, 2000))
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
    return 1.1 * miss if miss > GUESS_MISS else 0.0


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
