"""A heating plan: the schedule, the temperatures that it makes, what they mean for the tube, and its files."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, Self

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
from .counts import Counts, heating_rate, stops
from .outcome import Outcome, hold_slots, remarks
from .rig import COUNTS, Rig
from .schedule import HOPELESS, Schedule
from .simulation import stored
from .spec import HeatingSpec
from .thermal import thermal_data

WATER, AIR = 2000.0, 50.0
"""Heat transfer when quenched, W/(m^2 K): in agitated water, on average over the range in which it first boils; in a
draught, with radiation. Order of magnitude, assumed."""

QUENCHED_DEGC = 100.0
"""Below this nothing happens to nitinol in seconds."""

AGEING, SHORTEST = (400.0, 500.0), 120.0
"""Temperatures, degC, around the fastest precipitation of Ti-50.8Ni wire, by which its austenite finish moves; and
the shortest treatment, s, that the source tells of (ASME 2nd Frontiers in Biomedical Devices, BIOMED2007, p. 89)."""


class HeatingStatus(StatusEnum):
    """What became of a plan; every value reads as a sentence."""

    HELD = "window, limits and ramp are satisfied"
    MISSED = "the best schedule violates a requirement"


@dataclass(frozen=True)
class Cure:
    """A change, in words, and what would still be wrong with it."""

    change: Annotated[str, "the change"]
    shortfall: Annotated[float, unit("K"), "remaining miss of window and limit"]
    broken: Annotated[tuple[str, ...], "ramp or currents that would exceed their limits"] = ()

    @property
    def cures(self) -> bool:
        """Whether all would be kept, by a schedule of whole counts."""
        return self.shortfall <= 0.0 and not self.broken


@dataclass(frozen=True)
class HeatingStatistics:
    """What a plan took: iterations of the optimal control problem in its last round, and slots of the schedule."""

    iterations: int
    slots: int


@dataclass(frozen=True, eq=False)
class Course:
    """What happens over time and along the tube: T slots, X places."""

    time: Array
    """(T,) beginning of every slot, s."""
    duty: Annotated[Counts, "duty of every slot, 0 to 255"]
    """Shape (T,), integers, from there to the next; the last ones are 0."""
    temperature: Array
    """(T, X) degC along the tube at these times."""
    position: Array
    """(X,) from the outer end of a clamp, m."""
    curved: NDArray[np.bool_]
    """(X,) which places belong to the curved part."""
    zone: NDArray[np.intp]
    """(X,) 0 clamp, 1 clearance, 2 lead, 3 curved part."""
    ideal_duty: Array
    """(T,) mean duties before rounding, in counts."""
    ideal_temperature: Array
    """(T, X) degC by the ideal duties."""
    voltage: Array
    """(T,) at the battery while the MOSFET conducts, V."""
    current: Array
    """(T,) from the battery while the MOSFET conducts, A."""
    charge: Array
    """(T,) state of charge."""
    clamp_temperature: Array
    """(T,) of the clamps, degC."""
    mold_temperature: Array
    """(T,) of the groove's wall at its hottest place, degC."""


@dataclass(frozen=True)
class Energies:
    """Where the energy goes."""

    energy: Annotated[float, unit("kJ"), "energy drawn from the battery"]
    tube_energy: float
    """Heat in tube, mold and clamps at the end, J."""
    energy_error: Annotated[float, "relative error of the energy balance"]
    """Of the re-simulation."""


@dataclass(frozen=True, eq=False)
class HeatingPlan(Displayed):
    """A schedule, and what it does to the tube, re-simulated on the fine grid, in steps of a tenth of a second.

    What its parts hold is read at the plan too: `plan.duty` is `plan.course.duty`.
    """

    _brief = ("status", "hold_start", "hold_end", "lowest", "highest")

    tube: Tube
    """The heated tube."""
    rig: Rig
    """The rig; free clearance, lead and vents have their chosen values."""
    spec: HeatingSpec
    """The specification."""
    course: Course
    """Temperatures, currents and duties over time."""
    outcome: Outcome
    """Temperatures, ramp and currents compared with window and limits, also between samples."""
    energies: Energies
    """Energy balance."""
    hold_start: Annotated[float, unit("s"), "start of the hold"]
    reasons: tuple[str, ...]
    """Reasons why the window is missed, as text; empty if it is kept."""
    problems: Annotated[tuple[str, ...], "violated limits, as text"]
    """With their reasons; also other problems, such as an overheated mold."""
    cures: Annotated[tuple[Cure, ...], "changes that would help, best first"]
    """Only if a limit is violated; those that suffice come first."""
    quench_time: Annotated[float, key("quench_s"), "time until the whole tube is below 100 degC"]
    """After the end of the hold, out of the mold."""
    growth: Annotated[float, unit("mm"), form(".2f", label="growth when hot"), "thermal expansion of the tube"]
    """At the end of the hold."""
    iterations: Annotated[int, "iterations of the optimal control problem in its last round; 0 if it was not needed"]
    feedback: Feedback | None = None
    """The law that leads the schedule by a sensor, where one was given."""

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
        """True if all limits are satisfied: window and temperature limit including mesh error, ramp, and the currents
        of the circuit.
        """
        return self.outcome.kept

    @property
    def mesh_error(self) -> float:
        """Estimated error of the temperatures by the mesh (Richardson, grid half as fine), K."""
        return self.outcome.mesh.most

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
        """Whether all limits are satisfied; `verdict` names those that are not."""
        return HeatingStatus.HELD if self.feasible else HeatingStatus.MISSED

    @property
    def statistics(self) -> HeatingStatistics:
        """Iterations and number of samples."""
        return HeatingStatistics(self.iterations, len(self.time))

    @property
    def verdict(self) -> str:
        """ "held" where everything is kept; else what is not, in a few words."""
        if self.feasible:
            return "held"
        circuit = self.rig.circuit
        bounds = (
            (self.steepest, self.spec.ramp, "K/s"),
            (self.mean_current, circuit.current_limit, "A"),
            (self.peak_current, circuit.peak_limit, "A while on"),
        )
        broken = [f"{value:.1f} {unit} of {limit:g}" for value, limit, unit in bounds if value > limit]
        missed = [f"missed by {self.shortfall:.1f} K"] if self.shortfall > 0 else []
        return ", ".join(missed + ([f"limits broken: {', '.join(broken)}"] if broken else []))

    @property
    def table_length(self) -> int:
        """Number of slots until the last duty above 0."""
        return int(np.flatnonzero(self.duty)[-1]) + 1 if self.duty.any() else 0

    @property
    def in_hold(self) -> NDArray[np.bool_]:
        """(T,) which times lie in the hold, both ends included."""
        slack = 1e-6
        return np.asarray((self.time >= self.hold_start - slack) & (self.time <= self.hold_end + slack))

    @property
    def rounding_error(self) -> float:
        """Greatest difference of the temperatures from those of the ideal duties, K."""
        return float(np.abs(self.temperature - self.ideal_temperature).max())

    @property
    def pwm_ripple(self) -> float:
        """Swing of the temperature within a period of the PWM, K: what taking the duty for a mean power leaves out."""
        on = float(self.duty.max()) / COUNTS
        return heating_rate(self.tube, self.rig, self.peak_current) * on * (1 - on) / self.rig.circuit.pwm_frequency

    @property
    def cold_end(self) -> float:
        """Length of tube at each end, from the clamp's edge, beyond which none is colder than the window as the hold
        ends, m; infinite where the middle is."""
        row = self.temperature[int(np.flatnonzero(self.in_hold)[-1])]
        half = len(row) // 2
        x, values = self.position[:half], row[:half]
        low = self.spec.window_degC[0]
        cold = np.flatnonzero(values < low)
        if not len(cold):
            return 0.0
        k = int(cold[-1])
        if k == half - 1:
            return math.inf
        at = np.interp(low, values[k : k + 2], x[k : k + 2])
        return max(float(at - self.rig.clamps.grip), 0.0)

    @property
    def free_length(self) -> float:
        """Length of tube between the clamps when cold, m."""
        return 2 * (self.rig.clamps.clearance + self.rig.mold.lead) + self.tube.curved_length

    @property
    def extra_length(self) -> float:
        """Tube to be added before heating and cut off afterwards, m: leads that the straight part cannot be."""
        end = self.rig.clamps.grip + self.rig.clamps.clearance + self.rig.mold.lead
        return end + max(end - self.tube.straight_length, 0.0)

    @classmethod
    def of(
        cls, tube: Tube, spec: HeatingSpec, found: Schedule, iterations: int, *, cures: tuple[Cure, ...] = ()
    ) -> Self:
        """The plan of a schedule, and the iterations that it took."""
        run, history, outcome = found.run, found.checked, found.outcome
        rig, model = run.rig, run.model
        _, last = hold_slots(spec, run.start)
        row = history.tube[last, 0]
        rise = (row - model.ambient) * model.width
        covered = model.zone >= LEAD
        walls = history.walls[:, 0][:, covered, 0]
        reasons = reasons_of(found)
        missed = (f"the window is missed by {outcome.shortfall:.1f} K: {'; '.join(reasons)}",) if reasons else ()
        course = Course(
            time=history.time,
            duty=np.append(found.counts, 0),
            temperature=_mirrored(history.tube[:, 0]) - ZERO_CELSIUS,
            position=model.full_position,
            curved=_mirrored(model.curved),
            zone=_mirrored(model.zone),
            ideal_duty=np.append(COUNTS * run.levels, 0.0),
            ideal_temperature=_mirrored(run.exact.tube[:, 0]) - ZERO_CELSIUS,
            voltage=history.voltage[:, 0],
            current=history.current[:, 0],
            charge=rig.battery.state_of_charge - history.lumped[:, 0, CHARGE],
            clamp_temperature=history.lumped[:, 0, CLAMP] - ZERO_CELSIUS,
            mold_temperature=walls.max(1) - ZERO_CELSIUS,
        )
        held = float(stored(model, history.state(-1))[0])
        return cls(
            tube=tube,
            rig=rig,
            spec=spec,
            course=course,
            outcome=outcome,
            energies=Energies(float(history.lumped[-1, 0, DRAWN]), held, float(history.imbalance[0])),
            hold_start=run.start,
            reasons=reasons,
            problems=outcome.broken + missed + remarks(rig, history, float(walls.max())),
            cures=cures,
            quench_time=quench_time(tube, spec, float(row.max())),
            growth=float(2 * thermal_data(tube).expansion * rise[model.zone > GRIP].sum()),
            iterations=iterations,
        )


def _mirrored(half: NDArray[Any]) -> NDArray[Any]:
    """(..., 2n) along the whole tube from (..., n) along its half."""
    return np.concatenate([half, half[..., ::-1]], axis=-1)


def quench_time(tube: Tube, spec: HeatingSpec, hottest: float) -> float:
    """Time (s) in which the hottest point, at `hottest` (K), cools below 100 degC out of the mold: a lump of metal."""
    data = thermal_data(tube)
    medium = 20.0 + ZERO_CELSIUS
    transfer = WATER if spec.quench == "water" else AIR
    wall = (tube.outer_diameter**2 - tube.inner_diameter**2) / (4 * tube.outer_diameter)
    rate = transfer / (data.density * data.heat_capacity * wall)
    goal = QUENCHED_DEGC + ZERO_CELSIUS
    return 0.0 if hottest <= goal else max(0.0, math.log((hottest - medium) / (goal - medium)) / rate)


def ageing(plan: HeatingPlan) -> tuple[float, float]:
    """Length (m) of tube beside the curved part, at each end, whose hottest is where nitinol ages; its longest time (s)
    there."""
    half = len(plan.position) // 2
    outside = np.flatnonzero(~plan.curved[:half])
    spans = np.diff(plan.time, append=plan.time[-1])
    within = (plan.temperature[:, outside] > AGEING[0]) & (plan.temperature[:, outside] < AGEING[1])
    times = (within * spans[:, None]).sum(0)
    place = plan.position[:half]
    faces = np.concatenate([[0.0], 0.5 * (place[1:] + place[:-1]), place[-1:]])
    widths = np.diff(faces)[outside]
    hottest = plan.temperature[:, outside].max(0)
    ages = (hottest > AGEING[0]) & (hottest < AGEING[1])
    return float(widths[ages].sum()), float(times[ages].max(initial=0.0))


def ageing_words(plan: HeatingPlan) -> tuple[str, ...]:
    """What to know of it; nothing where no part of the tube gets there."""
    length, longest = ageing(plan)
    if not length:
        return ()
    than = "less" if longest < SHORTEST else "more"
    return (
        f"next to the bend, {1e3 * length:.0f} mm of tube at each end stay at {AGEING[0]:.0f} to {AGEING[1]:.0f} degC "
        f"for up to {longest:.0f} s. There Ti-50.8Ni precipitates fastest, and its Af changes. This is {than} than the "
        f"{SHORTEST:.0f} s of the shortest published treatment (BIOMED2007, p. 89). Measure Af of the remaining tube",
    )


# --- what keeps a schedule from its window ----------------------------------------------------------------------------


# A technician changes no rig for less: the loss of a rig is known to 15 % (`Uncertainty`).
WORTH = 0.1
"""Relative change that is worth being reported: of a miss, and of the time to the longest heating."""

LEAST_SHARE = 0.1
"""Share of the time to the end of the hold from which on a limit is named that allows no count more."""


def reasons_of(found: Schedule) -> tuple[str, ...]:
    """What keeps a schedule from its window; empty where the window is kept.

    Far below the limit of temperature, these are the limits that allow no count more. Near that limit, a count more
    makes one place too hot while another is too cold.
    """
    outcome, spec, rig = found.outcome, found.spec, found.run.rig
    if outcome.shortfall <= 0:
        return ()
    _, last = hold_slots(spec, found.run.start)
    states = [found.checked.state(k) for k in range(last)]
    stopped = stops(found.run.model, spec, rig, found.counts[:last], states)
    words = {
        "duty": "the switch conducts all the time",
        "current": f"the mean current of {rig.circuit.current_limit:g} A allows no count more",
        "ramp": f"the ramp of {spec.ramp:g} K/s allows no count more",
    }
    held = {limit: stopped.count(limit) for limit in words}
    until = f"of the {spec.slot * last:g} s to the end of the hold"
    said = [
        f"{words[limit]} in {spec.slot * slots:g} {until}"
        for limit, slots in held.items()
        if slots > LEAST_SHARE * last
    ]
    if said and found.run.start > (1 - WORTH) * spec.longest_heating:
        said.append(f"the heating may last {spec.longest_heating:g} s at most")
    if not said or outcome.hottest + outcome.mesh.hottest > spec.limit - HOPELESS:
        said.insert(
            0,
            f"in the hold the curved part is at {outcome.lowest:.1f} to {outcome.highest:.1f} degC while the hottest "
            f"point of the tube reaches {outcome.hottest:.1f} degC of {spec.limit:g} degC",
        )
    return tuple(said)


# --- files ------------------------------------------------------------------------------------------------------------


PER_LINE = 16


def schedule_csv(plan: HeatingPlan) -> str:
    """A row for every slot: its beginning, the duty (0-255), and what the simulation tells.

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
        f"{plan.rig.name or 'rig'}: every duty holds for {plan.spec.slot:g} s; hold from {plan.hold_start:g} to "
        f"{plan.hold_end:g} s; battery at {plan.rig.battery.voltage:.2f} V at rest"
    )
    return to_csv(tuple(columns), rows, comment)


def arduino_header(plan: HeatingPlan) -> str:
    """A C header with the duties as bytes, for `analogWrite` every SLOT_MS ms; errors as `slot_milliseconds`."""
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
    """A slot (s) in ms; raises InputError where that is no whole number."""
    milliseconds = round(1000 * slot)
    if abs(milliseconds - 1000 * slot) > 1e-9 or milliseconds < 1:
        raise InputError(f"slot is {slot:g} s; for an Arduino it must be a whole number of milliseconds")
    return milliseconds
