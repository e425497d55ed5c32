"""Reports on heating plans, calibrated rigs, feedback with its firmware, and a heating while it runs."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.text import Text

from ..constants import ZERO_CELSIUS
from ..errors import SolveError
from ..files.files import write_text
from ..files.units import TO_MM, per_si
from ..robots.passport import continue_passport
from ..robots.tubes import Tube
from ..runs.heating_run import HeatingRun, HeatingRunStudy
from ..runs.heating_study import ClosedLoopHeating, Heating, Success
from ..runs.workshop_file import rig_to_dict, save_rig
from ..shaping.firmware.boards import Part, hall_slope
from ..shaping.firmware.sketch_files import write_sketch
from ..shaping.heating.calibration import BIAS, UNITS, RigFit, kind_of
from ..shaping.heating.controller import Contribution, Feedback
from ..shaping.heating.cutout import CutOut, SafeSupply, Short, cut_out, safe_supplies, stop_current
from ..shaping.heating.oven import OvenPlan, oven_csv
from ..shaping.heating.plan import Cure, HeatingPlan, arduino_header, schedule_csv
from ..shaping.heating.replanning import Replanner
from ..shaping.heating.rig import Battery, Clamps, MoldBed
from ..shaping.heating.robust import Band
from ..shaping.heating.spec import HeatingSpec
from ..shaping.heating.thermal import uniform_gap_of
from .quantities import Quantity, columns, described, line, of_field, within
from .report import Drawing, Report, drawing, grid, remarks, to_text, two_columns

QUANTILES = (0.05, 0.5, 0.95)
"""Printed quantiles of the temperatures of uncertain rigs."""


def _window_text(plan: HeatingPlan) -> str:
    """Text of the window and the hold time, and whether they are satisfied."""
    low, high = plan.spec.window_degC
    window = f"{low:g} to {high:g} degC for {plan.spec.hold_time:g} s"
    return f"held: {window}" if plan.feasible else f"MISSED ({window}), {plan.verdict}"


def hold_duties(plan: HeatingPlan) -> tuple[int, int]:
    """Largest and smallest duty, 0 to 255, during the hold."""
    # The last instant is the end of the hold: its duty is that of the slot after it.
    duties = plan.duty[plan.in_hold][:-1]
    return int(duties.max()), int(duties.min())


def _duties_text(plan: HeatingPlan) -> str:
    """Text of the duties during the hold."""
    largest, smallest = hold_duties(plan)
    duties = f"{largest}" if largest == smallest else f"{largest} falling to {smallest}"
    return f"{duties} of 255, {plan.spec.slot:g} s each"


def _cold_end_text(plan: HeatingPlan) -> str:
    """Length of the tube below the window, as text."""
    if plan.cold_end == float("inf"):
        return "the middle of the curved part is below the window"
    if plan.cold_end == 0.0:
        return "no part between the clamps is below the window"
    return f"{plan.cold_end * TO_MM:.1f} mm from each clamp are below the window"


def _free_text(plan: HeatingPlan) -> str | None:
    """Optimised dimensions of the rig, as text; None without any."""
    vents = ", ".join(f"{100 * part:.0f}" for part in plan.rig.mold.vents)
    texts = {
        "clearance": f"clearance {plan.rig.clamps.clearance * TO_MM:.1f} mm",
        "lead": f"lead {plan.rig.mold.lead * TO_MM:.1f} mm",
        "vents": f"vents {vents} % from the end of the mold to its middle",
    }
    return "; ".join(texts[name] for name in plan.spec.free) or None


CURE = described(
    Cure,
    "change shortfall broken",
    Quantity("cures", "true if all limits would be satisfied"),
)

PLAN = described(
    HeatingPlan,
    Quantity("rig", "name of the rig", lambda p: p.rig.name),
    Quantity("mold_material", "material of the mold", lambda p: p.rig.mold.material.name),
    Quantity("window_degC", "temperature window of the hold", lambda p: p.spec.window_degC, text=_window_text,
             label="window"),
    Quantity("limit_degC", "temperature limit of every point at all times", lambda p: p.spec.limit),
    Quantity("hold_s", "hold time", lambda p: p.spec.hold_time),
    *within([of_field(HeatingSpec, "slot")], lambda p: p.spec),
    Quantity("feasible", "true if all limits are satisfied"),
    "shortfall broken",
    line("curved part in the hold", "{lowest_degC:.1f} to {highest_degC:.1f} degC"),
    "lowest highest",
    of_field(HeatingPlan, "hottest", label="maximum temperature",
             text="{hottest_degC:.1f} degC (limit {limit_degC:g})"),
    Quantity("mesh_error_K", "estimated mesh error of these temperatures"),
    line("heating, then hold", "{hold_start_s:g} s, to {hold_end_s:g} s"),
    line("duty in the hold", _duties_text),
    "hold_start",
    Quantity("hold_end_s", "end of the hold"),
    line("fastest warming", "{steepest_K_per_s:.1f} K/s (limit {ramp_limit_K_per_s:g})"),
    Quantity("rounding_error_K", "largest change of a temperature by rounding to integer duties",
             label="rounding to counts", text="changes temperatures by {rounding_error_K:.1f} K at most"),
    "ramp steepest",
    Quantity("ramp_limit_K_per_s", "limit of the heating rate", lambda p: p.spec.ramp),
    Quantity("pwm_ripple_K", "temperature ripple within a PWM period"),
    Quantity("cold_end_mm", "length of the cold end", text=_cold_end_text, label="cold end"),
    Quantity("extra_length_mm", "extra length of tube, cut off afterwards",
             text="{extra_length_mm:.1f} mm in all, to be cut off afterwards", label="extra tube"),
    "growth",
    *within([of_field(Clamps, "clearance")], lambda p: p.rig.clamps),
    *within([of_field(MoldBed, "lead")], lambda p: p.rig.mold),
    Quantity("side_clearance_um", "side clearance of the tube in its groove", lambda p: p.rig.mold.play),
    Quantity("gap_um", "uniform gap that conducts as much as the air of the groove",
             lambda p: uniform_gap_of(p.tube, p.rig)),
    *within([of_field(Tube, "curved_length")], lambda p: p.tube),
    Quantity("free_length_mm", "cold length of tube between the clamps"),
    *within([of_field(MoldBed, "vents")], lambda p: p.rig.mold),
    line(
        "battery",
        "{battery_V:.2f} V at rest, {energy_kJ:.2f} kJ, {peak_current_A:.0f} A while on, "
        "{mean_current_A:.1f} A on average at most",
    ),
    Quantity("battery_V", "open-circuit voltage of the battery", lambda p: p.rig.battery.voltage),
    *within([of_field(Battery, "state_of_charge")], lambda p: p.rig.battery),
    Quantity("charge_used_percent", "charge used, of the battery's capacity", lambda p: p.charge[0] - p.charge[-1]),
    "energy peak_current mean_current",
    Quantity("mold_degC", "highest temperature of the groove's wall", lambda p: p.mold_temperature.max()),
    Quantity("clamp_degC", "highest temperature of the clamps", lambda p: p.clamp_temperature.max()),
    Quantity("quench", "quench medium, water or air", lambda p: p.spec.quench),
    of_field(HeatingPlan, "quench_time", label="quench", text="in {quench}: below 100 degC after {quench_s:.1f} s"),
    of_field(HeatingPlan, "energy_error", label="energy balance",
             text="closed to {energy_error:.1e}; mesh error {mesh_error_K:.1f} K"),
    line("chosen", _free_text),
    "iterations problems",
    of_field(HeatingPlan, "cures", of=CURE),
    "duty",
)  # fmt: skip

OF_A_TABLE = {"state_of_charge_percent", "battery_V", "feasible", "broken", "lowest_degC", "highest_degC",
              "hottest_degC", "duty"}  # fmt: skip
"""Keys of the duty-cycle table for a state of charge."""

OF_THE_BAND = described(
    Band,
    Quantity("samples", "number of uncertain rigs", lambda band: len(band.lowest)),
    "probability too_cold too_hot",
    Quantity(
        "lowest_degC",
        f"quantiles {QUANTILES} of the lowest temperature in the hold",
        lambda band: np.quantile(band.lowest, QUANTILES),
    ),
    Quantity(
        "highest_degC",
        f"quantiles {QUANTILES} of the highest temperature in the hold",
        lambda band: np.quantile(band.highest, QUANTILES),
    ),
)

SUCCESS: tuple[Quantity[Any], ...] = (
    Quantity("success_probability", "fraction of uncertain rigs that keeps window and limit; null without sampling",
             lambda a: None if a.success is None else a.success.probability),
    Quantity("success_interval", "95 % confidence interval of the probability",
             lambda a: None if a.success is None else a.success.interval),
    Quantity("led_by", "sensor of the feedback; \"\" for the schedule alone",
             lambda a: "" if a.success is None else a.success.sensor),
)  # fmt: skip


def success_text(success: Success | None) -> str:
    """Text of the probability that a heating stays within window and limit."""
    if success is None:
        return "success: not known, since no uncertain rigs were sampled (--samples 0)"
    low, high = success.interval
    fraction = f"{100 * success.probability:.0f} % of {success.samples} uncertain rigs keep window and limit"
    bounds = f"(95 %: {100 * low:.0f} to {100 * high:.0f} %)"
    if not success.sensor:
        return f"success: {fraction} {bounds}; open loop, without a sensor"
    alone = f"by the schedule alone {100 * (success.open_loop or 0):.0f} % of the same rigs do"
    unseen = f"; {100 * success.silent:.1f} % MISS UNREPORTED" if success.silent else ""
    return f"success: {fraction} {bounds}{unseen}; the sensor closes the loop ({success.sensor}); {alone}"


def unlikely(success: Success | None) -> str:
    """Message on a feasible plan that most random rigs fail; "" for other plans."""
    if success is None or success.likely:
        return ""
    if success.sensor:
        cure = "shorten the bare tube beside the clamps (clearance_mm), give the conductivity of your mold's board, or "
        cure += "calibrate the rig"
    else:
        cure = "close the loop (--sensor thermocouple, tubeopt heat firmware), or calibrate the rig"
    return f"{success_text(success)}; at least {100 * success.required:.0f} % must: {cure}"


BAND = described(
    Heating,
    Quantity("loss_percent", "half-width of the uncertainty of the heat loss", lambda a: a.uncertainty.loss),
    Quantity(
        "contact_resistance_percent",
        "half-width of the uncertainty of the contact resistance",
        lambda a: a.uncertainty.contact_resistance,
    ),
    Quantity(
        "resistivity_percent",
        "half-width of the uncertainty of the tube's resistivity",
        lambda a: a.uncertainty.resistivity,
    ),
    *within(OF_THE_BAND, lambda a: a.band),
    "scale",
)

HEATING = described(
    Heating,
    *SUCCESS,
    *within(PLAN, lambda a: a.plan),
    Quantity("band", "temperatures of uncertain rigs; null unless requested", lambda a: None if a.band is None else a,
             of=BAND, optional=True),
    of_field(Heating, "tables", of=[quantity for quantity in PLAN if quantity.key in OF_A_TABLE]),
)  # fmt: skip


class HeatingReport(Report[Heating]):
    command = "heat plan"
    quantities = HEATING
    file = "plan.json"

    def title(self) -> str:
        return self.answer.plan.rig.name or "rig"

    def table(self) -> Group:
        """Table with the probability of success and the plan."""
        return Group(Text(success_text(self.answer.success), style="bold"), super().table())

    def rows(self) -> list[tuple[str, str]]:
        """Rows (name, text) of the plan and its result on uncertain rigs."""
        band = self.answer.band
        rows = super().rows()
        if band is not None:
            result = (
                f"{100 * band.probability:.0f} % of rigs stay in the window; {100 * band.too_cold:.0f} % fall "
                f"below, {100 * band.too_hot:.0f} % rise above"
            )
            rows.append(("by schedule alone" if self.answer.plan.feedback else "uncertain rigs", result))
        return rows

    def below(self) -> list[RenderableType]:
        """Tables by charge, problems, and changes that would help."""
        plan, tables = self.answer.plan, self.answer.tables
        parts: list[RenderableType] = []
        if tables:
            cells = [
                (
                    f"{table.rig.battery.voltage:.2f} V",
                    f"{100 * table.rig.battery.state_of_charge:.0f} %",
                    f"{table.lowest:.1f} to {table.highest:.1f} degC",
                    table.verdict,
                )
                for table in tables
            ]
            columns = ("battery >", "charge >", "curved part in the hold", "window")
            parts.append(grid(columns, cells, title="pick by the battery's voltage at rest"))
        parts += remarks(plan.concerns, what="problem")
        for cure in plan.cures:
            result = "sufficient" if cure.cures else f"{cure.shortfall:.1f} K remain"
            parts += remarks(["; ".join([f"{cure.change}: {result}", *cure.broken])], what="what would help")
        if not plan.feasible and not plan.cures:
            parts += remarks(["none of the changes that were tried helps"])
        return parts

    def save(self, directory: Path) -> list[Path]:
        """Write the plan's schedule.csv, schedule.h and plan.json, and a table and a header for every charge."""
        paths = _save_schedule(self.answer.plan, directory, "schedule", self.fault)
        for table in self.answer.tables:
            paths += _save_schedule(table, directory, f"schedule_{table.rig.battery.voltage:.2f}V", self.fault)
        # With the rig, the schedule can be simulated again from the file.
        data = self.record() | {"rig_data": rig_to_dict(self.answer.plan.rig)}
        write_text(directory / self.file, to_text(data))
        return [*paths, directory / self.file]

    def pictures(self) -> dict[str, Drawing]:
        return {
            "heating": drawing("heating.plot_heating", self.answer.plan, band=self.answer.band, stop=bool(self.fault))
        }

    @property
    def fault(self) -> str:
        """Reason not to run the plan, as text; "" for a plan that is likely to succeed."""
        return unlikely(self.answer.success) if self.answer.plan.feasible else missed(self.answer.plan)

    def conclude(self) -> None:
        """Raise SolveError if the plan is infeasible, or if most uncertain rigs miss the window."""
        if self.fault:
            raise SolveError(self.fault)


def missed(plan: HeatingPlan) -> str:
    """Violated conditions of a plan, as text."""
    low, high = plan.spec.window_degC
    window = f"no schedule was found that keeps {low:g} to {high:g} degC for {plan.spec.hold_time:g} s"
    misses = [f"the window is missed by {plan.shortfall:.1f} K", *plan.reasons] if plan.shortfall > 0 else []
    return f"{window}{':' if misses else ' within the limits:'} {'; '.join((*misses, *plan.broken))}"


def _save_schedule(plan: HeatingPlan, directory: Path, name: str, fault: str) -> list[Path]:
    """Write a schedule as CSV and as a C header, with a reason not to run it at their top; return the paths."""
    paths = [directory / f"{name}.csv", directory / f"{name}.h"]
    write_text(paths[0], (f"# DO NOT RUN: {fault}\n" if fault else "") + schedule_csv(plan))
    write_text(paths[1], (f"/* DO NOT RUN: {fault} */\n" if fault else "") + arduino_header(plan))
    return paths


RIG_FIT = described(
    RigFit,
    "estimates",
    "confidence noise remarks",
)


class RigFitReport(Report[RigFit]):
    command = "heat calibrate"
    quantities = RIG_FIT
    file = "calibration.json"
    drawn = (("calibration", "heating.plot_rig_fit"),)

    def table(self) -> Group:
        """A row per factor, the residuals, the remarks."""
        f = self.answer
        cells = [
            (
                e.name + " (K)" * e.name.startswith(BIAS),
                *(("held", "–") if e.held else (f"{e.factor:.4f}", f"{e.low:.4f} to {e.high:.4f}")),
            )
            for e in f.estimates
        ]
        factors = grid(
            ("factor on", "fitted >", f"{100 * f.confidence:g} % interval >"), cells, title=f.rig.name or "rig"
        )
        noise = ", ".join(f"{name} {value:.3g} {UNITS[kind_of(name)]}" for name, value in f.noise.items())
        return Group(factors, Text(f"residuals: {noise}"), *remarks(f.remarks, what="remark"))

    def save(self, directory: Path) -> list[Path]:
        """Write calibration.json and the calibrated rig.yaml."""
        save_rig(self.answer.rig, directory / "rig.yaml", "A shape-setting rig for tubeopt, calibrated to a log.")
        return [self.save_record(directory), directory / "rig.yaml"]


CONTRIBUTION = described(
    Contribution,
    of_field(Contribution, "name", label="not known", text=lambda item: item.name.replace("_", " ")),
    "deviation",
)  # fmt: skip

PART = described(Part)

FEEDBACK = described(
    Feedback,
    Quantity("sensor", "sensor", lambda f: f.sensor.name),
    Quantity("sensor_bias_K", "half-width of its constant error", lambda f: f.sensor.bias),
    Quantity("proportional_per_K", "proportional gain: fraction of the planned duty per K",
             lambda f: f.law.proportional),
    Quantity("integral_per_K_s", "integral gain", lambda f: f.law.integral),
    Quantity("samples", "number of uncertain rigs"),
    Quantity("probability", "fraction of them that keeps window and limit", label="keeps the window",
             text=lambda f: f"{100 * f.probability:.1f} % of {f.samples} uncertain rigs "
             f"({100 * f.interval[0]:.1f} to {100 * f.interval[1]:.1f} %)"),
    Quantity("interval", "95 % confidence interval of the probability"),
    of_field(Feedback, "open_loop", label="without the sensor",
             text=lambda f: f"{100 * f.open_loop:.0f} % of {f.samples}; the schedule leaves the sensor room"),
    Quantity("too_cold", "fraction below the window"),
    Quantity("too_hot", "fraction above window or limit"),
    Quantity("silent", "fraction that misses the window and ends as done", label="misses without a report",
             text=lambda f: f"{100 * f.silent:.1f} % of them"),
    Quantity("share", "largest correction, as a fraction of the planned duty", lambda f: f.law.share,
             label="largest correction", text=lambda f: f"{100 * f.law.share:.0f} % of the planned duty"),
    Quantity("lowest_degC", "lowest temperature of the curved part in the hold, all rigs", lambda f: f.lowest.min()),
    Quantity("highest_degC", "highest temperature of the curved part in the hold, all rigs", lambda f: f.highest.max()),
    line("curved part, any rig", "{lowest_degC:.1f} to {highest_degC:.1f} degC in the hold"),
    Quantity("top_degC", "highest temperature of any point at any time, all rigs", lambda f: f.top.max(),
             label="hottest point, any rig", text="{top_degC:.1f} degC"),
    of_field(Feedback, "contributions", of=CONTRIBUTION),
)  # fmt: skip


def _hall_sensitivity(answer: ClosedLoopHeating) -> float:
    """Sensitivity of the current sensor of the sketch, V/A."""
    return hall_slope(answer.wiring, stop_current(answer.plan.tube, answer.plan.rig))


SHORT = described(Short)

SUPPLY = described(SafeSupply)

CUT_OUT = described(
    CutOut,
    of_field(CutOut, "shorts", of=SHORT),
    of_field(CutOut, "peak", label="shorted switch",
             text=lambda c: f"tube at {c.peak:.0f} degC at most: the cut-out opens after {1e3 * c.delay:.0f} ms, "
             f"650 degC take {1e3 * c.budget:.0f} ms"),
    "delay budget current pulse withstood",
    Quantity("unsafe", "violated safety limits, with cures", lambda c: list(c.problems)),
)  # fmt: skip

FEEDBACK_HEATING = described(
    ClosedLoopHeating,
    Quantity("rig", "name of the rig", lambda a: a.plan.rig.name),
    Quantity("window_degC", "temperature window of the hold", lambda a: a.plan.spec.window_degC),
    Quantity("limit_degC", "temperature limit of every point at all times", lambda a: a.plan.spec.limit),
    Quantity("feasible", "true if the schedule alone keeps all limits on the nominal rig", lambda a: a.plan.feasible),
    Quantity("board", "board for the sketch", lambda a: a.wiring.known.title, label="board",
             text="{board}, pulses at {pwm_Hz:.1f} Hz"),
    "frequency",
    Quantity("hall_mV_per_A", "sensitivity of the current sensor", _hall_sensitivity, label="current sensor",
             text=lambda a: f"{_hall_sensitivity(a) * per_si('mV_per_A'):g} mV/A, "
             + ("chosen for this tube" if a.wiring.shunt_V_per_A is None else "with its pulses from the rig file")),
    *within(FEEDBACK, lambda a: a.feedback),
    *within(CUT_OUT, lambda a: cut_out(a.plan)),
    Quantity("safe_supplies", "supplies that need no cut-out", lambda a: list(safe_supplies(a.plan)), of=SUPPLY),
    Quantity("parts", "list of parts", lambda a: list(a.parts), of=PART),
)  # fmt: skip


class FeedbackReport(Report[ClosedLoopHeating]):
    command = "heat firmware"
    quantities = FEEDBACK_HEATING
    file = "law.json"
    drawn = (("feedback", "heating.plot_feedback"), ("wiring", "heating.plot_wiring"))

    def title(self) -> str:
        return self.answer.plan.rig.name or "rig"

    def table(self) -> Group:
        """Table with the probability of success in closed and in open loop at its top."""
        success = success_text(Success.led(self.answer.feedback))
        return Group(Text(success, style="bold"), super().table())

    def below(self) -> list[RenderableType]:
        """Contributions to the temperature error, the list of parts, and the safety of the circuit."""
        answer, safety = self.answer, cut_out(self.answer.plan)
        contributions = columns(answer.feedback.contributions[:6], CONTRIBUTION)
        return [
            grid(*contributions, title="what moves the temperature (standard deviation)"),
            grid(*columns(answer.parts, PART), title="what to build it of"),
            grid(*columns(safety.shorts, SHORT), title="switch shorts: hottest point until the cut-out has opened"),
            grid(*columns(safe_supplies(answer.plan), SUPPLY), title="safe without a cut-out"),
            *remarks((*answer.plan.problems, *answer.feedback.problems, *safety.problems), what="problem"),
        ]

    def save(self, directory: Path) -> list[Path]:
        """Write law.json and the sketch."""
        answer = self.answer
        sketch = write_sketch(answer.plan, answer.feedback, answer.wiring, directory, fault=self.fault)
        return [self.save_record(directory), *sketch]

    @property
    def fault(self) -> str:
        """Reason not to run the heating, as text; "" for one that is likely to succeed."""
        answer, feedback = self.answer, self.answer.feedback
        if not answer.plan.feasible:
            return missed(answer.plan)
        # A heating that often fails is no success, though the nominal rig keeps the window.
        fault = unlikely(Success.led(feedback))
        return "; ".join((*feedback.problems[:1], fault)) if fault else ""

    def conclude(self) -> None:
        """Raise SolveError if the schedule is infeasible on the nominal rig, or if most uncertain rigs fail."""
        if self.fault:
            raise SolveError(self.fault)


OVEN = described(
    OvenPlan,
    Quantity("oven", "name of the oven", lambda p: p.oven.name),
    Quantity("method", "oven, furnace or salt_bath", lambda p: p.oven.method),
    Quantity("mold_material", "material of the mold", lambda p: p.oven.mold.material.name),
    Quantity("setting_degC", "temperature setting", lambda p: p.oven.set_temperature - ZERO_CELSIUS,
             label="setting", text=lambda p: f"{p.oven.set_temperature - ZERO_CELSIUS:g} degC "
             f"within {p.oven.uniformity:g} K, {p.oven.method.replace('_', ' ')}"),
    "window hold_time",
    Quantity("feasible", "true if every requirement is met", label="result",
             text=lambda p: "held" if p.feasible else "MISSED"),
    line("soak time", lambda p: f"{p.soak_time / 60:.1f} min: {p.warm_time / 60:.1f} min to warm through, then hold"
         if p.feasible else None),
    of_field(OvenPlan, "soak_time", form=""),
    of_field(OvenPlan, "warm_time", form=""),
    of_field(OvenPlan, "first_time", form="", label="first point in the window",
             text=lambda p: f"after {p.first_time / 60:.1f} min" if math.isfinite(p.first_time) else "never"),
    line("curved part", "{coldest_degC:.1f} to {hottest_degC:.1f} degC at the end of the soak"),
    of_field(OvenPlan, "coldest", form=""),
    of_field(OvenPlan, "hottest", form=""),
    of_field(OvenPlan, "quench_start", form=""),
    of_field(OvenPlan, "quench_time", form="", label="quench",
             text=lambda p: f"{p.oven.quench.replace('_', ' ')}: from {p.quench_start:.0f} degC "
             f"below 100 degC in {p.quench_time:.1f} s"),
    of_field(OvenPlan, "ageing_time", form=""),
    line("mold", "{mold_mass_kg:.2f} kg, takes {energy_kJ:.0f} kJ"),
    of_field(OvenPlan, "energy", form=""),
    of_field(OvenPlan, "mold_mass", form=""),
    line("radius", "{groove_radius_mm:.2f} mm in the cold mold for the drawn radius; "
         "a groove of the drawn radius gives {cold_radius_mm:.2f} mm, without spring-back"),
    of_field(OvenPlan, "hot_radius", form=""),
    of_field(OvenPlan, "cold_radius", form=""),
    of_field(OvenPlan, "groove_radius", form=""),
    "problems remarks",
)  # fmt: skip


class OvenReport(Report[OvenPlan]):
    command = "heat oven"
    quantities = OVEN
    file = "oven.json"
    drawn = (("oven", "heating.plot_oven"),)

    def title(self) -> str:
        return self.answer.oven.name or "oven"

    def below(self) -> list[RenderableType]:
        """Problems of the plan, and remarks on it."""
        return [
            *remarks(self.answer.problems, what="problem"),
            *remarks(self.answer.remarks, what="remark"),
        ]

    def save(self, directory: Path) -> list[Path]:
        """Write oven.json and oven.csv, the temperatures over time."""
        path = directory / "oven.csv"
        write_text(path, oven_csv(self.answer))
        return [self.save_record(directory), path]

    def conclude(self) -> None:
        """Raise SolveError if a requirement is violated."""
        if not self.answer.feasible:
            raise SolveError("; ".join(self.answer.problems))


BLOCKS = " ▁▂▃▄▅▆▇█"
WIDTH = 60

RUN = described(
    HeatingRun,
    of_field(HeatingRun, "reason", label="ended", text="{reason}"),
    Quantity("done", "true if the whole schedule was executed"),
    # A test of the cut-out has no readings.
    Quantity("time_s", "duration", label="after", text=lambda r: f"{r.time:.1f} s" if r.rows else None),
    Quantity("hottest_degC", "highest reading", label="greatest reading",
             text=lambda r: f"{r.hottest:.1f} degC" if r.rows else None),
    "window",
    Quantity("lowest_degC", "lowest reading in the hold; null without one", lambda r: r.held and r.held[0]),
    Quantity("highest_degC", "highest reading in the hold", lambda r: r.held and r.held[1]),
    Quantity("shortfall_K", "miss of the window by the readings of the hold; 0 if it is kept",
             label="in the hold", text=lambda r: _readings_text(r) if r.opened is None else None),
    of_field(HeatingRun, "opened", label="cut-out", optional=True,
             text=lambda r: None if r.opened is None else f"opened after {1e3 * r.opened:.0f} ms; the tube allows "
             f"{1e3 * r.allowed:.0f} ms"),
    of_field(HeatingRun, "allowed", optional=True),
    Quantity("rows", "number of reports from the rig", lambda r: len(r.rows)),
    Quantity("log", "file with all reports", lambda r: None if r.log is None else str(r.log)),
)  # fmt: skip


def _readings_text(run: HeatingRun) -> str:
    """Text of the readings in the hold, and whether they are in the window."""
    if run.held is None:
        return "nothing was measured"
    readings = f"{run.held[0]:.1f} to {run.held[1]:.1f} degC"
    if run.window is None or run.shortfall is None:
        return f"{readings}; the rig reports no window"
    window = f"{run.window[0]:g} to {run.window[1]:g} degC"
    verdict = f"missed by {run.shortfall:.1f} K" if run.shortfall > 0 else "kept"
    return f"{readings}: window of {window} {verdict}"


class HeatingRunReport(Report[HeatingRun]):
    command = "heat run"
    quantities = RUN

    def title(self) -> str:
        return self.answer.name

    def save(self, directory: Path) -> list[Path]:
        """Continue the passport in the folder by a heating with current."""
        run = self.answer
        if not any(row["state"] in ("heating", "holding") and not row["dry"] for row in run.rows):
            return []
        lowest, highest = run.held or (None, None)
        readings = {"lowest_degC": lowest, "highest_degC": highest, "time_s": run.time}
        log = "" if run.log is None else run.log.name
        return continue_passport(directory, "heatings", ended=run.reason, **readings, log=log)

    def conclude(self) -> None:
        """Raise SolveError if the rig stopped early, or if readings of the hold missed the window."""
        run = self.answer
        if run.opened is not None and run.allowed is not None and run.opened > run.allowed:
            raise SolveError(
                f"the cut-out opened after {1e3 * run.opened:.0f} ms; it must open within {1e3 * run.allowed:.0f} ms"
            )
        if not run.done:
            raise SolveError(f"the rig stopped after {self.answer.time:.1f} s: {self.answer.reason}")
        if self.answer.shortfall:
            raise SolveError(f"in the hold {_readings_text(self.answer)}")


def with_live_page(study: HeatingRunStudy, out: Path | None, *, shown: bool = True) -> HeatingRun:
    """Run a heating and show its state on stderr; the log is written into `out`."""
    if not shown:
        return study.run_in(out)
    readings: list[float] = []
    line, replanner = study.open()
    with Live(console=Console(stderr=True), transient=True, refresh_per_second=8) as live:

        def show(hello: dict[str, Any], row: dict[str, Any]) -> None:
            readings.append(row["temperature_degC"])
            live.update(
                two_columns(
                    f"{hello.get('firmware', 'rig')}: {row['state']}",
                    _state_rows(hello, row, readings) + _prediction_rows(row, replanner),
                )
            )

        return study.run_on(out, line, replanner, show)


def _prediction_rows(row: dict[str, Any], replanner: Replanner | None) -> list[tuple[str, str]]:
    """Rows on the controller, and on the temperatures of the hold as predicted by the replanning computer."""
    if replanner is None:
        return []
    controller = "this computer" if row.get("led") else "the board's own law"
    rows = [("controlled by", f"{controller}; the rig heats {100 * replanner.strength:+.0f} % more than its file says")]
    if replanner.rest is not None:
        # The remaining schedule begins at the present slot, the hold perhaps some slots later.
        reading = replanner.rest.reading[max(replanner.planner.law.hold[0] - replanner.rest.index, 0) :]
        if len(reading):
            rows.append(("predicted", f"{min(reading):.0f} to {max(reading):.0f} degC in the hold"))
    return rows


def _state_rows(hello: dict[str, Any], row: dict[str, Any], readings: list[float]) -> list[tuple[str, str]]:
    """Rows on the present state, from the messages of the rig at its start and of this slot."""
    left = max(hello.get("slots", 0) - row["place"], 0) * hello.get("slot_ms", 500) / 1000
    volt, ampere = row["voltage_V"], row["current_A"]
    battery = "not measured" if volt is None else f"{volt:.2f} V, {ampere:.0f} A while on"
    window = hello.get("window_degC")
    within = "" if window is None else f", window {window[0]:g} to {window[1]:g}"
    return [
        ("temperature", f"{row['temperature_degC']:.1f} degC, reference {row['reference_degC']:.1f}{within}"),
        ("", _curve(readings)),
        ("duty", f"{row['count']} of 255" + (", dry run, no current" if row["dry"] else "")),
        ("battery", battery),
        ("time", f"{row['time_s']:.0f} s, {left:.0f} s left"),
        ("stop", "Ctrl-C"),
    ]


def _curve(readings: list[float]) -> str:
    """Curve of the readings up to now, as a line of block characters."""
    # Every k-th reading, k rounded up, so that the line never exceeds WIDTH.
    shown = readings[:: max(1, -(-len(readings) // WIDTH))]
    # A scale from 0 degC; at least 1, as all readings may be 0 or below.
    top = max(max(shown), 1.0)
    return "".join(BLOCKS[round(max(value, 0.0) / top * (len(BLOCKS) - 1))] for value in shown)
