"""Heating plan: schedule, temperatures, effects on the tube, and files."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from ...constants import ZERO_CELSIUS
from ...display import Displayed
from ...errors import InputError
from ...files.csv_file import to_csv
from ...files.field_metadata import form, key, unit
from ...physics.heat import GRIP, LEAD
from ...physics.heat_functions import CHARGE, CLAMP, DRAWN
from ...robots.tubes import Tube
from ...typing import Array, Delegate, StatusEnum
from .controller import Feedback
from .counts import Counts, blocking_limits, heating_rate
from .outcome import Outcome, hold_slots, remarks
from .rig import COUNTS, Rig
from .schedule import HOPELESS, Schedule
from .simulation import State, advance, simulate, stored
from .spec import HeatingSpec
from .thermal import stack, thermal_data, thermal_model

WATER, AIR = 2000.0, 50.0
"""Heat transfer coefficients of the quench, W/(m^2 K): agitated water, averaged over film boiling; moving air, with
radiation. Orders of magnitude, assumed."""

QUENCHED_DEGC = 100.0
"""Temperature below which the structure of nitinol does not change within seconds."""

AGEING_DEGC, SHORTEST_AGEING = (400.0, 500.0), 120.0
"""Temperatures, degC, that precipitate Ti-50.8Ni wire fastest, and the shortest published treatment, s.

Precipitation changes the austenite finish (ASME 2nd Frontiers in Biomedical Devices, BIOMED2007, p. 89).
"""


class HeatingStatus(StatusEnum):
    """Status of a plan; every value reads as a sentence."""

    HELD = "window, limits and ramp are satisfied"
    MISSED = "the best schedule violates a requirement"


@dataclass(frozen=True)
class Cure:
    """Change that would help, and the violations that would remain."""

    change: Annotated[str, "the change"]
    shortfall: Annotated[float, unit("K"), "remaining miss of window and limit"]
    broken: Annotated[tuple[str, ...], "ramp or currents that would exceed their limits"] = ()

    @property
    def cures(self) -> bool:
        """True if a schedule of whole counts would satisfy every requirement."""
        return self.shortfall <= 0.0 and not self.broken


@dataclass(frozen=True)
class HeatingStatistics:
    """Iterations of the optimal control problem in its last round, and slots of the schedule."""

    iterations: int
    slots: int


@dataclass(frozen=True, eq=False)
class Course:
    """Temperatures, currents and duties at T times and X positions along the tube."""

    time: Array
    """(T,) start of every slot, s."""
    duty: Annotated[Counts, "duty of every slot, 0 to 255"]
    """(T,) integer counts; the last ones are 0."""
    temperature: Array
    """(T, X) temperatures along the tube, degC."""
    position: Array
    """(X,) positions along the tube from the outer end of a clamp, m."""
    curved: NDArray[np.bool_]
    """(X,) True for positions in the curved part."""
    zone: NDArray[np.intp]
    """(X,) 0 clamp, 1 clearance, 2 lead, 3 curved part."""
    ideal_duty: Array
    """(T,) mean duties before rounding, in counts."""
    ideal_temperature: Array
    """(T, X) temperatures under the ideal duties, degC."""
    voltage: Array
    """(T,) battery voltage while the MOSFET conducts, V."""
    current: Array
    """(T,) battery current while the MOSFET conducts, A."""
    charge: Array
    """(T,) state of charge, 0 to 1."""
    clamp_temperature: Array
    """(T,) temperature of the clamps, degC."""
    mold_temperature: Array
    """(T,) hottest temperature of the groove's wall, degC."""


@dataclass(frozen=True)
class Energies:
    """Energy balance of a plan."""

    energy: Annotated[float, unit("kJ"), "energy drawn from the battery"]
    tube_energy: float
    """Heat in tube, mold and clamps at the end, J."""
    energy_error: Annotated[float, "relative error of the energy balance"]
    """Error of the re-simulation."""


@dataclass(frozen=True, eq=False)
class HeatingPlan(Displayed):
    """Schedule and its re-simulation on the fine grid, in steps of a tenth of a second.

    Fields of its parts are attributes of the plan too: `plan.duty` is `plan.course.duty`.
    """

    _brief = ("status", "hold_start", "hold_end", "lowest", "highest")

    tube: Tube
    """Heated tube."""
    rig: Rig
    """Rig; free clearance, lead and vents have their chosen values."""
    spec: HeatingSpec
    """Specification of the heating."""
    course: Course
    """Temperatures, currents and duties over time."""
    outcome: Outcome
    """Temperatures, ramp and currents compared with window and limits, also between samples."""
    energies: Energies
    """Energy balance of battery, tube and mold."""
    hold_start: Annotated[float, unit("s"), "start of the hold"]
    reasons: tuple[str, ...]
    """Reasons why the window is missed, as text; empty if it is kept."""
    problems: Annotated[tuple[str, ...], "violated limits, as text"]
    """Also lists other problems, such as an overheated mold."""
    cures: Annotated[tuple[Cure, ...], "changes that would help, best first"]
    """Empty if no limit is violated; sufficient changes come first."""
    quench_time: Annotated[float, key("quench_s"), "time until the whole tube is below 100 degC"]
    """Measured from the end of the hold, out of the mold."""
    growth: Annotated[float, unit("mm"), form(".2f", label="growth when hot"), "thermal expansion of the tube"]
    """Expansion at the end of the hold."""
    iterations: Annotated[int, "iterations of the optimal control problem in its last round; 0 if it was not needed"]
    feedback: Feedback | None = None
    """Feedback controller for the sensor, if one was given."""
    custom_miss: float = 0.0
    """Largest violation of custom requirements in their sizes, 0 without any."""

    @property
    def concerns(self) -> tuple[str, ...]:
        """Problems of the schedule, and those of the feedback if there is one."""
        return (*self.problems, *(() if self.feedback is None else self.feedback.problems))

    time, ideal_duty, ideal_temperature = (
        Delegate[Array]("course"),
        Delegate[Array]("course"),
        Delegate[Array]("course"),
    )
    temperature, position = Delegate[Array]("course"), Delegate[Array]("course")
    duty = Delegate[Counts]("course")
    curved = Delegate[NDArray[np.bool_]]("course")
    zone = Delegate[NDArray[np.intp]]("course")
    voltage, current, charge = Delegate[Array]("course"), Delegate[Array]("course"), Delegate[Array]("course")
    clamp_temperature, mold_temperature = Delegate[Array]("course"), Delegate[Array]("course")
    lowest, highest, hottest = Delegate[float]("outcome"), Delegate[float]("outcome"), Delegate[float]("outcome")
    shortfall, ramp, steepest = Delegate[float]("outcome"), Delegate[float]("outcome"), Delegate[float]("outcome")
    mean_current, peak_current = Delegate[float]("outcome"), Delegate[float]("outcome")
    broken = Delegate[tuple[str, ...]]("outcome")
    energy, tube_energy, energy_error = (
        Delegate[float]("energies"),
        Delegate[float]("energies"),
        Delegate[float]("energies"),
    )

    @property
    def feasible(self) -> bool:
        """True if all limits and custom requirements are satisfied.

        The limits are window and temperature limit including mesh error, ramp, and the currents of the circuit.
        """
        return self.outcome.feasible and not self.custom_miss

    @property
    def mesh_error(self) -> float:
        """Estimated error of the temperatures by the mesh (Richardson, grid half as fine), K."""
        return self.outcome.mesh.largest

    @property
    def hold_end(self) -> float:
        """End of the hold, s."""
        return self.hold_start + self.spec.hold_time

    @property
    def value(self) -> Counts:
        """(T,) duties, 0 to 255."""
        return self.duty

    @property
    def status(self) -> HeatingStatus:
        """HELD if all limits are satisfied; `verdict` names those that are not."""
        return HeatingStatus.HELD if self.feasible else HeatingStatus.MISSED

    @property
    def statistics(self) -> HeatingStatistics:
        """Iterations and number of samples."""
        return HeatingStatistics(self.iterations, len(self.time))

    @property
    def verdict(self) -> str:
        """ "held" if all limits are satisfied; otherwise a short text of the violations."""
        if self.feasible:
            return "held"
        circuit = self.rig.circuit
        bounds = (
            (self.steepest, self.spec.ramp, "K/s"),
            (self.mean_current, circuit.current_limit, "A"),
            (self.peak_current, circuit.peak_limit, "A while on"),
        )
        broken = [f"{value:.1f} {unit} (limit {limit:g})" for value, limit, unit in bounds if value > limit]
        miss = [f"misses the window by {self.shortfall:.1f} K"] if self.shortfall > 0 else []
        miss += ["misses a custom requirement"] if self.custom_miss else []
        return ", ".join(miss + ([f"exceeds limits: {', '.join(broken)}"] if broken else []))

    @property
    def table_length(self) -> int:
        """Number of slots until the last duty above 0."""
        return int(np.flatnonzero(self.duty)[-1]) + 1 if self.duty.any() else 0

    @property
    def in_hold(self) -> NDArray[np.bool_]:
        """(T,) True for times in the hold, both ends included."""
        round_off = 1e-6
        return np.asarray((self.time >= self.hold_start - round_off) & (self.time <= self.hold_end + round_off))

    @property
    def rounding_error(self) -> float:
        """Largest difference between the temperatures with rounded and with ideal duties, K."""
        return float(np.abs(self.temperature - self.ideal_temperature).max())

    @property
    def pwm_ripple(self) -> float:
        """Temperature ripple within a period of the PWM, K: the error of taking the duty as a mean power."""
        on = float(self.duty.max()) / COUNTS
        return heating_rate(self.tube, self.rig, self.peak_current) * on * (1 - on) / self.rig.circuit.pwm_frequency

    @property
    def cold_end(self) -> float:
        """Length of tube at each end, from the clamp's edge, that is below the window at the end of the hold, m.

        Infinite if the middle of the tube is.
        """
        T = self.temperature[int(np.flatnonzero(self.in_hold)[-1])]
        half, low = len(T) // 2, self.spec.window_degC[0]
        cold = np.flatnonzero(T[:half] < low)
        if not len(cold):
            return 0.0
        k = int(cold[-1])
        if k == half - 1:
            return math.inf
        edge = np.interp(low, T[k : k + 2], self.position[k : k + 2])
        return max(float(edge - self.rig.clamps.grip), 0.0)

    @property
    def free_length(self) -> float:
        """Length of the cold tube between the clamps, m."""
        return 2 * (self.rig.clamps.clearance + self.rig.mold.lead) + self.tube.curved_length

    @property
    def extra_length(self) -> float:
        """Length of tube to add before heating and to cut off afterwards, m, because the leads are longer than the
        tube.
        """
        end = self.rig.clamps.grip + self.rig.clamps.clearance + self.rig.mold.lead
        return end + max(end - self.tube.straight_length, 0.0)

    @classmethod
    def of(
        cls, tube: Tube, spec: HeatingSpec, schedule: Schedule, iterations: int, *, cures: tuple[Cure, ...] = ()
    ) -> Self:
        """Plan of a schedule, with the iterations of its optimal control problem."""
        run, history, outcome = schedule.run, schedule.history, schedule.outcome
        rig, model = run.rig, run.model
        _, last = hold_slots(spec, run.start)
        T_end = history.tube[last, 0]
        walls = history.walls[:, 0][:, model.zone >= LEAD, 0]
        reasons = reasons_of(schedule)
        missed = (f"the window is missed by {outcome.shortfall:.1f} K: {'; '.join(reasons)}",) if reasons else ()
        course = Course(
            time=history.time,
            duty=np.append(schedule.counts, 0),
            temperature=_mirrored(history.tube[:, 0]) - ZERO_CELSIUS,
            position=model.full_position,
            curved=_mirrored(model.curved),
            zone=_mirrored(model.zone),
            ideal_duty=np.append(COUNTS * run.levels, 0.0),
            ideal_temperature=_mirrored(run.history.tube[:, 0]) - ZERO_CELSIUS,
            voltage=history.voltage[:, 0],
            current=history.current[:, 0],
            charge=rig.battery.state_of_charge - history.lumped[:, 0, CHARGE],
            clamp_temperature=history.lumped[:, 0, CLAMP] - ZERO_CELSIUS,
            mold_temperature=walls.max(1) - ZERO_CELSIUS,
        )
        tube_energy = float(stored(model, history.state(-1))[0])
        # Both halves of the tube expand, outside the clamps.
        rise = ((T_end - model.T_amb) * model.width)[model.zone > GRIP]
        return cls(
            tube=tube,
            rig=rig,
            spec=spec,
            course=course,
            outcome=outcome,
            energies=Energies(float(history.lumped[-1, 0, DRAWN]), tube_energy, float(history.imbalance[0])),
            hold_start=run.start,
            reasons=reasons,
            problems=outcome.broken + missed + remarks(rig, history, float(walls.max())),
            cures=cures,
            quench_time=quench_time(tube, spec, float(T_end.max())),
            growth=float(2 * thermal_data(tube).expansion * rise.sum()),
            iterations=iterations,
            custom_miss=schedule.custom_miss,
        )


def _mirrored(half: NDArray[Any]) -> NDArray[Any]:
    """(..., 2n) along the whole tube from (..., n) along its half."""
    return np.concatenate([half, half[..., ::-1]], axis=-1)


def cooling_rate(tube: Tube, transfer: float) -> float:
    """Rate (1/s) of approach of a tube out of the mold to the temperature of the medium, as a lump of metal.

    Args:
        transfer: heat transfer coefficient, W/(m^2 K).
    """
    data = thermal_data(tube)
    wall = (tube.outer_diameter**2 - tube.inner_diameter**2) / (4 * tube.outer_diameter)
    return transfer / (data.density * data.heat_capacity * wall)


def quench_time(tube: Tube, spec: HeatingSpec, T_hot: float) -> float:
    """Time (s) out of the mold for the hottest point to cool from T_hot (K) to 100 degC.

    The tube is a lump of metal.
    """
    rate = cooling_rate(tube, WATER if spec.quench == "water" else AIR)
    T_medium, T_cold = 20.0 + ZERO_CELSIUS, QUENCHED_DEGC + ZERO_CELSIUS
    return 0.0 if T_hot <= T_cold else max(0.0, math.log((T_hot - T_medium) / (T_cold - T_medium)) / rate)


class LeftInMold(NamedTuple):
    """Hottest point of a tube that is left in its mold for `LEFT` s after the hold, degC."""

    closed: float
    opened: float
    """Lid opened at the end of the hold: the upper half of the tube is in air."""
    latest: float
    """Time after the hold at which the tube in the closed mold enters the range of ageing, s."""
    passed: float
    """Time that it then takes to leave this range, s; infinite if it takes longer than the shortest ageing."""


LEFT_STEP = 0.25
"""Step of the temperatures of a tube in its mold, s."""

LEFT, OPENED = 10.0, 0.5
"""Time in the mold after the hold, s, and fraction of the surface that an opened lid leaves in air."""


def left_in_mold(plan: HeatingPlan) -> LeftInMold:
    """Temperatures of a tube that is not quenched at once, in the closed mold and with a hinged lid opened."""
    opened = replace(plan.rig, mold=replace(plan.rig.mold, vents=(OPENED,)))
    closed = thermal_model(plan.tube, plan.rig)
    heated = simulate(closed, plan.spec.slot, plan.duty[: round(plan.hold_end / plan.spec.slot)] / COUNTS).state(-1)
    both = State(*(np.concatenate([part, part]) for part in (heated.cells, heated.lumped)))
    after = advance(stack([closed, thermal_model(plan.tube, opened)]), both, 0.0, LEFT)
    low, high = AGEING_DEGC
    state, times, hottest = heated, [0.0], [float(heated.cells[..., 0].max()) - ZERO_CELSIUS]
    while hottest[-1] > low and times[-1] < 2 * SHORTEST_AGEING:
        step = LEFT_STEP if times[-1] < LEFT else 10 * LEFT_STEP
        state = advance(closed, state, 0.0, step)
        times.append(times[-1] + step)
        hottest.append(float(state.cells[..., 0].max()) - ZERO_CELSIUS)
    # Temperatures fall, and np.interp needs them to rise.
    latest, end = np.interp([-high, -low], -np.array(hottest), times).tolist()
    passed = end - latest if hottest[-1] <= low and end - latest < SHORTEST_AGEING else math.inf
    shut, open_ = (after.cells[..., 0].max(1) - ZERO_CELSIUS).tolist()
    return LeftInMold(shut, open_, latest, passed)


class Ageing(NamedTuple):
    """Stretch of the tube beyond the curved part that ends the hold within `AGEING_DEGC`, the same at both ends."""

    near: float
    """Distance of its end towards the curved part from there, m."""
    far: float
    """Distance of its other end, m; equal to `near` where nothing is in this range."""
    longest: float
    """Longest time of one of its points in this range up to the end of the hold, s."""


def ageing(plan: HeatingPlan, kept: float = math.inf) -> Ageing:
    """Ageing of the tube beyond the curved part, where nitinol precipitates.

    Args:
        kept: length of tube beyond the curved part that is not trimmed off, m.
    """
    half = len(plan.position) // 2
    x = plan.position[:half]
    edges = np.concatenate([[0.0], 0.5 * (x[1:] + x[:-1]), x[-1:]])
    bend = edges[int(np.flatnonzero(plan.curved[:half])[0])]
    outside = np.flatnonzero(~plan.curved[:half] & (edges[1:] > bend - kept))
    last = int(np.flatnonzero(plan.in_hold)[-1])
    low, high = AGEING_DEGC
    temperature = plan.temperature[: last + 1, outside]
    inside = (temperature > low) & (temperature < high)
    ages = outside[inside[-1]]
    if not len(ages):
        return Ageing(0.0, 0.0, 0.0)
    end = plan.temperature[last]

    def crossing(first: int, second: int) -> float:
        """Place between two points, the second out of the range, where the range ends, m."""
        limit = high if end[second] >= high else low
        share = (limit - end[first]) / (end[second] - end[first])
        return float(x[first] + share * (x[second] - x[first]))

    # The hotter end towards the bend; the colder one towards the clamp.
    inner, outer = int(ages[-1]), int(ages[0])
    near = bend - (edges[inner + 1] if plan.curved[inner + 1] else crossing(inner, inner + 1))
    far = bend - (edges[0] if outer == 0 else crossing(outer, outer - 1) if outer - 1 in outside else edges[outer])
    times = (inside[:-1] * np.diff(plan.time[: last + 1])[:, None]).sum(0)
    return Ageing(min(float(near), kept), min(float(far), kept), float(times[inside[-1]].max()))


def ageing_remarks(plan: HeatingPlan) -> tuple[str, ...]:
    """Remark on the ageing of the straight part that remains; none if no part of it is in this range."""
    near, far, longest = ageing(plan, plan.tube.straight_length)
    if far == near:
        return ()
    low, high = AGEING_DEGC
    comparison = "less" if longest < SHORTEST_AGEING else "more"
    return (
        f"the straight part from {1e3 * near:.0f} to {1e3 * far:.0f} mm before the bend ends the hold at {low:.0f} to "
        f"{high:.0f} degC, where it is for up to {longest:.0f} s. There Ti-50.8Ni precipitates fastest, and its Af "
        f"changes. This is {comparison} than the {SHORTEST_AGEING:.0f} s of the shortest published treatment "
        "(BIOMED2007, p. 89). Measure the Af of this part",
    )


# --- reasons of a miss ------------------------------------------------------------------------------------------------


# A technician changes no rig for less: the loss of a rig is known to 15 % (`Uncertainty`).
MIN_GAIN = 0.1
"""Smallest relative change that is reported: of a miss, and of the time to the longest heating."""

MIN_BLOCKED = 0.1
"""Smallest fraction of the time to the end of the hold that a named limit must block."""


def reasons_of(schedule: Schedule) -> tuple[str, ...]:
    """Reasons why a schedule misses its window; empty if it does not.

    Far below the temperature limit, these are the limits that allow no greater count. Near it, a greater count makes
    one point too hot while another is too cold.
    """
    outcome, spec, rig = schedule.outcome, schedule.spec, schedule.run.rig
    if outcome.shortfall <= 0:
        return ()
    _, last = hold_slots(spec, schedule.run.start)
    states = [schedule.history.state(k) for k in range(last)]
    blocking = blocking_limits(schedule.run.model, spec, rig, schedule.counts[:last], states)
    descriptions = {
        "duty": "the switch conducts all the time",
        "current": f"the mean current of {rig.circuit.current_limit:g} A allows no larger count",
        "ramp": f"the ramp of {spec.ramp:g} K/s allows no larger count",
    }
    reasons = [
        f"{description} in {spec.slot * blocking.count(limit):g} of the {spec.slot * last:g} s to the end of the hold"
        for limit, description in descriptions.items()
        if blocking.count(limit) > MIN_BLOCKED * last
    ]
    if reasons and schedule.run.start > (1 - MIN_GAIN) * spec.longest_heating:
        reasons.append(f"the heating time is limited to {spec.longest_heating:g} s")
    if not reasons or outcome.hottest + outcome.mesh.hottest > spec.limit - HOPELESS:
        reasons.insert(
            0,
            f"in the hold the curved part is at {outcome.lowest:.1f} to {outcome.highest:.1f} degC while the hottest "
            f"point of the tube reaches {outcome.hottest:.1f} degC of {spec.limit:g} degC",
        )
    return tuple(reasons)


# --- files ------------------------------------------------------------------------------------------------------------


PER_LINE = 16


def schedule_csv(plan: HeatingPlan) -> str:
    """CSV with a row for every slot: start, duty (0-255), and results of the simulation.

    `coldest_degC` and `hottest_degC` are of the curved part, `limit_point_degC` is the hottest of the whole tube;
    voltage and current are those while the MOSFET conducts.
    """
    curved = plan.temperature[:, plan.curved]
    columns = {
        "time_s": (plan.time, ".3f"),
        "duty": (plan.duty, "d"),
        "ideal_duty": (plan.ideal_duty, ".3f"),
        "coldest_degC": (curved.min(1), ".2f"),
        "hottest_degC": (curved.max(1), ".2f"),
        "limit_point_degC": (plan.temperature.max(1), ".2f"),
        "voltage_V": (plan.voltage, ".3f"),
        "current_A": (plan.current, ".2f"),
    }
    rows = zip(*([f"{value:{form}}" for value in values] for values, form in columns.values()), strict=True)
    comment = (
        f"{plan.rig.name or 'rig'}: every duty lasts {plan.spec.slot:g} s; hold from {plan.hold_start:g} to "
        f"{plan.hold_end:g} s; battery at {plan.rig.battery.voltage:.2f} V at rest"
    )
    return to_csv(tuple(columns), rows, comment)


def arduino_header(plan: HeatingPlan) -> str:
    """C header with the duties as bytes, for `analogWrite` every SLOT_MS ms; errors as `slot_milliseconds`."""
    duty, milliseconds = plan.duty.tolist(), slot_milliseconds(plan.spec.slot)
    lines = [", ".join(f"{d:3d}" for d in duty[k : k + PER_LINE]) for k in range(0, len(duty), PER_LINE)]
    body = ",\n".join(f"    {line}" for line in lines)
    return f"""/* Heating schedule for a shape-setting rig: duty (0-255) of the PWM, one byte for every slot.
   For a battery of {plan.rig.battery.voltage:.2f} V at rest. The last duty is 0: the tube is off. */
#ifndef HEATING_SCHEDULE_H
#define HEATING_SCHEDULE_H

#include <stdint.h>
#ifdef __AVR__
#include <avr/pgmspace.h> /* pgm_read_byte(&HEATING_DUTY[k]) */
#else
#define PROGMEM
#endif

#define HEATING_SLOT_MS {milliseconds}u
#define HEATING_SLOTS {len(duty)}u

static const uint8_t HEATING_DUTY[HEATING_SLOTS] PROGMEM = {{
{body}
}};

#endif
"""


def slot_milliseconds(slot: float) -> int:
    """Duration of a slot (s) in ms; raises InputError if it is no whole number."""
    milliseconds = round(1000 * slot)
    if abs(milliseconds - 1000 * slot) > 1e-9 or milliseconds < 1:
        raise InputError(f"slot is {slot:g} s; for an Arduino it must be a whole number of milliseconds")
    return milliseconds
