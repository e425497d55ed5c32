"""What is said and saved about heating plans and calibrated rigs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Group, RenderableType
from rich.text import Text

from ..errors import SolveError
from ..files.files import write_text
from ..files.units import TO_MM
from ..runs.heating_study import Heating, Success
from ..runs.rig_file import rig_to_dict, save_rig
from ..shaping.heating.calibration import BIAS, UNITS, RigFit, kind_of
from ..shaping.heating.plan import Cure, HeatingPlan, arduino_header, schedule_csv
from ..shaping.heating.robust import Band
from ..shaping.heating.thermal import gap_of
from .quantities import Quantity, described, line, of_field, within
from .report import Drawing, Report, drawing, grid, remarks, to_text

QUANTILES = (0.05, 0.5, 0.95)
"""Of the temperatures of uncertain rigs that are told."""


def _verdict(plan: HeatingPlan) -> str:
    low, high = plan.spec.window_degC
    wanted = f"{low:g} to {high:g} degC for {plan.spec.hold_time:g} s"
    return f"held: {wanted}" if plan.feasible else f"MISSED ({wanted}), {plan.verdict}"


def held_duties(plan: HeatingPlan) -> tuple[int, int]:
    """Greatest and least duty during the hold."""
    duties = plan.duty[plan.in_hold][:-1]
    return int(duties.max()), int(duties.min())


def _duties(plan: HeatingPlan) -> str:
    most, least = held_duties(plan)
    counts = f"{most}" if most == least else f"{most} falling to {least}"
    return f"{counts} of 255, {plan.spec.slot:g} s each"


def _cold_end(plan: HeatingPlan) -> str:
    if plan.cold_end == float("inf"):
        return "the middle of the curved part is below the window"
    if plan.cold_end == 0.0:
        return "no part between the clamps is below the window"
    return f"{plan.cold_end * TO_MM:.1f} mm from each clamp are below the window"


def _chosen(plan: HeatingPlan) -> str | None:
    vents = ", ".join(f"{100 * part:.0f}" for part in plan.rig.mold.vents)
    words = {
        "clearance": f"clearance {plan.rig.clamps.clearance * TO_MM:.1f} mm",
        "lead": f"lead {plan.rig.mold.lead * TO_MM:.1f} mm",
        "vents": f"vents {vents} % from the end of the mold to its middle",
    }
    return "; ".join(words[name] for name in plan.spec.free) or None


CURE = described(
    Cure,
    "change shortfall broken",
    Quantity("cures", "true if all limits would be satisfied"),
)

PLAN = described(
    HeatingPlan,
    Quantity("rig", "name of the rig", lambda p: p.rig.name),
    Quantity("mold_material", "material of the mold", lambda p: p.rig.mold.material.name),
    Quantity("window_degC", "temperature window of the hold", lambda p: p.spec.window_degC, words=_verdict,
             label="window"),
    Quantity("limit_degC", "temperature limit of every point at all times", lambda p: p.spec.limit),
    Quantity("hold_s", "hold time", lambda p: p.spec.hold_time),
    Quantity("slot_s", "duration of one duty-cycle value", lambda p: p.spec.slot),
    Quantity("feasible", "true if all limits are satisfied"),
    "shortfall broken",
    line("curved part in the hold", "{lowest_degC:.1f} to {highest_degC:.1f} degC"),
    "lowest highest",
    of_field(HeatingPlan, "hottest", label="hottest point, ever",
             words="{hottest_degC:.1f} degC (limit {limit_degC:g})"),
    Quantity("mesh_error_K", "estimated mesh error of these temperatures"),
    line("heating, then hold", "{hold_start_s:g} s, to {hold_end_s:g} s"),
    line("duty in the hold", _duties),
    "hold_start",
    Quantity("hold_end_s", "end of the hold"),
    line("fastest warming", "{steepest_K_per_s:.1f} K/s (limit {ramp_limit_K_per_s:g})"),
    Quantity("rounding_error_K", "largest change of a temperature by rounding to integer duties",
             label="rounding to counts", words="changes temperatures by {rounding_error_K:.1f} K at most"),
    "ramp steepest",
    Quantity("ramp_limit_K_per_s", "limit of the heating rate", lambda p: p.spec.ramp),
    Quantity("pwm_ripple_K", "temperature ripple within a PWM period"),
    Quantity("cold_end_mm", "length of the cold end", words=_cold_end, label="cold end"),
    Quantity("extra_length_mm", "extra length of tube, cut off afterwards",
             words="{extra_length_mm:.1f} mm in all, to be cut off afterwards", label="extra tube"),
    "growth",
    Quantity("clearance_mm", "bare tube between clamp and mold", lambda p: p.rig.clamps.clearance),
    Quantity("lead_mm", "straight tube in the mold on each side", lambda p: p.rig.mold.lead),
    Quantity("side_clearance_um", "side clearance of the tube in its groove", lambda p: p.rig.mold.play),
    Quantity("gap_um", "uniform gap that conducts as much as the air of the groove", lambda p: gap_of(p.tube, p.rig)),
    Quantity("curved_length_mm", "curved part of the tube", lambda p: p.tube.curved_length),
    Quantity("free_length_mm", "cold length of tube between the clamps"),
    Quantity("vents_percent", "open part of the surface, from the end of the mold to its middle",
             lambda p: p.rig.mold.vents),
    line(
        "battery",
        "{battery_V:.2f} V at rest, {energy_kJ:.2f} kJ, {peak_current_A:.0f} A while on, "
        "{mean_current_A:.1f} A on average at most",
    ),
    Quantity("battery_V", "open-circuit voltage of the battery", lambda p: p.rig.battery.voltage),
    Quantity("state_of_charge_percent", "state of charge of the battery", lambda p: p.rig.battery.state_of_charge),
    Quantity("charge_used_percent", "charge used, of the battery's capacity", lambda p: p.charge[0] - p.charge[-1]),
    "energy peak_current mean_current",
    Quantity("mold_degC", "highest temperature of the groove's wall", lambda p: p.mold_temperature.max()),
    Quantity("clamp_degC", "highest temperature of the clamps", lambda p: p.clamp_temperature.max()),
    Quantity("quench", "quench medium, water or air", lambda p: p.spec.quench),
    of_field(HeatingPlan, "quench_time", label="quench", words="in {quench}: below 100 degC after {quench_s:.1f} s"),
    of_field(HeatingPlan, "energy_error", label="energy balance",
             words="closed to {energy_error:.1e}; mesh error {mesh_error_K:.1f} K"),
    line("chosen", _chosen),
    "iterations problems",
    of_field(HeatingPlan, "cures", of=CURE),
    "duty",
)  # fmt: skip

OF_A_TABLE = {"state_of_charge_percent", "battery_V", "feasible", "broken", "lowest_degC", "highest_degC",
              "hottest_degC", "duty"}  # fmt: skip
"""What is told of the table for a state of charge."""

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
             lambda a: "" if a.success is None else a.success.led_by),
)  # fmt: skip


def success_words(success: Success | None) -> str:
    """How likely a heating keeps window and limit."""
    if success is None:
        return "success: not known, since no uncertain rigs were sampled (--samples 0)"
    low, high = success.interval
    kept = f"{100 * success.probability:.0f} % of {success.samples} uncertain rigs keep window and limit"
    bounds = f"(95 %: {100 * low:.0f} to {100 * high:.0f} %)"
    if not success.led_by:
        return f"success: {kept} {bounds}; no sensor closes the loop"
    alone = f"by the schedule alone {100 * (success.open_loop or 0):.0f} % of the same rigs do"
    return f"success: {kept} {bounds}; the sensor closes the loop ({success.led_by}); {alone}"


def unlikely(success: Success | None) -> str:
    """Why a heating that holds the window on the rig as filed is not to be trusted; "" where it is."""
    if success is None or success.likely:
        return ""
    return (
        f"{success_words(success)}; at least one half must: close the loop (--sensor thermocouple, tubeopt heat "
        "firmware), or calibrate the rig"
    )


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
        """How likely it is, and the plan."""
        return Group(Text(success_words(self.answer.success), style="bold"), super().table())

    def rows(self) -> list[tuple[str, str]]:
        """The plan, and what becomes of it on uncertain rigs."""
        band = self.answer.band
        told = super().rows()
        if band is not None:
            words = (
                f"{100 * band.probability:.0f} % of rigs stay in the window; {100 * band.too_cold:.0f} % fall "
                f"below, {100 * band.too_hot:.0f} % rise above"
            )
            told.append(("by schedule alone" if self.answer.plan.feedback else "uncertain rigs", words))
        return told

    def below(self) -> list[RenderableType]:
        """The tables by charge, problems, and what would help."""
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
        parts += remarks(plan.problems, what="problem")
        parts += remarks((_cure_words(cure) for cure in plan.cures), what="what would help")
        if not plan.feasible and not plan.cures:
            parts += remarks(["none of the changes that were tried helps"])
        return parts

    def save(self, directory: Path) -> list[Path]:
        """Write the plan's schedule.csv, schedule.h and plan.json, and a table and a header for every charge."""
        paths = _save_schedule(self.answer.plan, directory, "schedule")
        for table in self.answer.tables:
            paths += _save_schedule(table, directory, f"schedule_{table.rig.battery.voltage:.2f}V")
        data = self.record() | {"rig_data": rig_to_dict(self.answer.plan.rig)}
        write_text(directory / self.file, to_text(data))
        return [*paths, directory / self.file]

    def pictures(self) -> dict[str, Drawing]:
        return {"heating": drawing("heating.plot_heating", self.answer.plan, band=self.answer.band)}

    def conclude(self) -> None:
        """Raise SolveError where no schedule was found that holds the window within limit, ramp and currents, or where
        most uncertain rigs miss it."""
        if not self.answer.plan.feasible:
            raise SolveError(missed(self.answer.plan))
        if words := unlikely(self.answer.success):
            raise SolveError(words)


def _cure_words(cure: Cure) -> str:
    left = "cures it" if cure.cures else f"leaves {cure.shortfall:.1f} K"
    return f"{cure.change}: {left}" + "".join(f"; {words}" for words in cure.broken)


def missed(plan: HeatingPlan) -> str:
    """What a plan does not keep, in words."""
    low, high = plan.spec.window_degC
    window = f"no schedule was found that holds {low:g} to {high:g} degC for {plan.spec.hold_time:g} s"
    cold = [f"it is missed by {plan.shortfall:.1f} K", *plan.reasons] if plan.shortfall > 0 else []
    return f"{window}{':' if cold else ' within the limits:'} {'; '.join((*cold, *plan.broken))}"


def _save_schedule(plan: HeatingPlan, directory: Path, name: str) -> list[Path]:
    """Write a schedule as CSV and as a C header; return the paths."""
    paths = [directory / f"{name}.csv", directory / f"{name}.h"]
    write_text(paths[0], schedule_csv(plan))
    write_text(paths[1], arduino_header(plan))
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
