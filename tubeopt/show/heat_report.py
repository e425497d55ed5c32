"""What is said and saved about heating plans and calibrated rigs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Group
from rich.table import Table
from rich.text import Text

from ..files.files import write_text
from ..runs.rig_file import rig_to_dict, save_rig
from ..shaping.heating.calibration import RigFit
from ..shaping.heating.files import arduino_header, schedule_csv
from ..shaping.heating.plan import HeatingPlan
from ..shaping.heating.robust import Band, Uncertainty
from ..shaping.heating.trials import TrialFit
from .report import report, to_text, two_columns

MM = 1e3


def plan_record(plan: HeatingPlan) -> dict[str, Any]:
    """A plan as JSON."""
    spec = plan.spec
    return {
        "rig": plan.rig.name,
        "mold_material": plan.rig.mold.material.name,
        "window_degC": list(spec.window_degC),
        "limit_degC": spec.limit,
        "hold_s": spec.hold_time,
        "slot_s": spec.slot,
        "feasible": plan.feasible,
        "shortfall_K": plan.shortfall,
        "broken": list(plan.broken),
        "lowest_degC": plan.lowest,
        "highest_degC": plan.highest,
        "hottest_degC": plan.hottest,
        "mesh_error_K": plan.mesh_error,
        "hold_start_s": plan.hold_start,
        "hold_end_s": plan.hold_end,
        "rounding_error_K": plan.rounding_error,
        "ramp_K_per_s": plan.ramp,
        "steepest_K_per_s": plan.steepest,
        "ramp_limit_K_per_s": spec.ramp,
        "pwm_ripple_K": plan.pwm_ripple,
        "cold_end_mm": plan.cold_end * MM,
        "extra_length_mm": plan.extra_length * MM,
        "growth_mm": plan.growth * MM,
        "clearance_mm": plan.rig.clamps.clearance * MM,
        "lead_mm": plan.rig.mold.lead * MM,
        "gap_um": plan.rig.mold.gap * 1e6,
        "curved_length_mm": plan.tube.curved_length * MM,
        "free_length_mm": plan.free_length * MM,
        "vents_percent": [100 * part for part in plan.rig.mold.vents],
        "battery_V": plan.rig.battery.voltage,
        "state_of_charge_percent": 100 * plan.rig.battery.state_of_charge,
        "charge_used_percent": 100 * float(plan.charge[0] - plan.charge[-1]),
        "energy_kJ": plan.energy / 1e3,
        "peak_current_A": plan.peak_current,
        "mean_current_A": plan.mean_current,
        "mold_degC": float(plan.mold_temperature.max()),
        "clamp_degC": float(plan.clamp_temperature.max()),
        "quench": spec.quench,
        "quench_s": plan.quench_time,
        "energy_error": plan.energy_error,
        "iterations": plan.iterations,
        "problems": list(plan.problems),
        "cures": [
            {"change": c.change, "shortfall_K": c.shortfall, "broken": list(c.broken), "cures": c.cures}
            for c in plan.cures
        ],
        "duty": plan.duty.tolist(),
    }


def band_record(band: Band, uncertainty: Uncertainty) -> dict[str, Any]:
    """A band as JSON."""
    return {
        "loss_percent": 100 * uncertainty.loss,
        "contact_resistance_percent": 100 * uncertainty.contact_resistance,
        "resistivity_percent": 100 * uncertainty.resistivity,
        "samples": len(band.lowest),
        "probability": band.probability,
        "too_cold": band.too_cold,
        "too_hot": band.too_hot,
        "lowest_degC": [float(np.quantile(band.lowest, q)) for q in (0.05, 0.5, 0.95)],
        "highest_degC": [float(np.quantile(band.highest, q)) for q in (0.05, 0.5, 0.95)],
    }


def _cold_end(plan: HeatingPlan) -> str:
    if plan.cold_end == float("inf"):
        return "the whole tube is below the window"
    return f"{plan.cold_end * MM:.1f} mm from each clamp are below the window"


def _verdict(plan: HeatingPlan) -> str:
    low, high = plan.spec.window_degC
    wanted = f"{low:g} to {high:g} degC for {plan.spec.hold_time:g} s"
    return f"held: {wanted}" if plan.feasible else f"CANNOT BE HELD ({wanted}), {plan.verdict}"


def plan_rows(plan: HeatingPlan) -> list[tuple[str, str]]:
    """A plan as names and values for a person."""
    hold = plan.duty[plan.in_hold][:-1]
    rows = [
        ("window", _verdict(plan)),
        ("curved part in the hold", f"{plan.lowest:.1f} to {plan.highest:.1f} degC"),
        ("hottest point, ever", f"{plan.hottest:.1f} degC (limit {plan.spec.limit:g})"),
        ("heating, then hold", f"{plan.hold_start:g} s, to {plan.hold_end:g} s"),
        ("duty in the hold", f"{hold.max()} falling to {hold.min()} of 255, {plan.spec.slot:g} s each"),
        ("fastest warming", f"{plan.steepest:.1f} K/s (limit {plan.spec.ramp:g})"),
        ("rounding to counts", f"changes temperatures by {plan.rounding_error:.1f} K at most"),
        ("cold end", _cold_end(plan)),
        ("extra tube", f"{plan.extra_length * MM:.1f} mm in all, to be cut off afterwards"),
        ("growth when hot", f"{plan.growth * MM:.2f} mm"),
        ("battery", f"{plan.rig.battery.voltage:.2f} V at rest, {plan.energy / 1e3:.2f} kJ, "
                    f"{plan.peak_current:.0f} A while on, {plan.mean_current:.1f} A on average at most"),
        ("quench", f"in {plan.spec.quench}: below 100 degC after {plan.quench_time:.1f} s"),
        ("energy balance", f"closed to {plan.energy_error:.1e}; mesh error {plan.mesh_error:.1f} K"),
    ]  # fmt: skip
    if plan.spec.free:
        vents = ", ".join(f"{100 * part:.0f}" for part in plan.rig.mold.vents)
        chosen = {
            "clearance": f"clearance {plan.rig.clamps.clearance * MM:.1f} mm",
            "lead": f"lead {plan.rig.mold.lead * MM:.1f} mm",
            "vents": f"vents {vents} % from the end of the mold to its middle",
        }
        rows.append(("chosen", "; ".join(chosen[name] for name in plan.spec.free)))
    return rows


@dataclass(frozen=True)
class HeatReport:
    """A plan, its tables by the battery's charge, and its band over uncertain rigs."""

    plan: HeatingPlan
    tables: tuple[HeatingPlan, ...]
    band: Band | None
    uncertainty: Uncertainty
    scale: float

    def record(self) -> dict[str, Any]:
        """The answer as JSON."""
        data = plan_record(self.plan)
        if self.band is not None:
            data["band"] = band_record(self.band, self.uncertainty) | {"duty_scale": self.scale}
        keys = (
            "state_of_charge_percent",
            "battery_V",
            "feasible",
            "broken",
            "lowest_degC",
            "highest_degC",
            "hottest_degC",
            "duty",
        )
        data["tables"] = [{key: plan_record(table)[key] for key in keys} for table in self.tables]
        return data

    def table(self) -> Group:
        """The answer for a person."""
        rows = plan_rows(self.plan)
        if self.band is not None:
            band = self.band
            rows.append(
                (
                    f"loss +-{100 * self.uncertainty.loss:g} %",
                    f"{100 * band.probability:.0f} % of rigs stay in the window; {100 * band.too_cold:.0f} % fall "
                    f"below, {100 * band.too_hot:.0f} % rise above",
                )
            )
        parts: list[Any] = [two_columns(self.plan.rig.name or "rig", rows)]
        if self.tables:
            parts.append(_charge_table(self.tables))
        parts += [Text(f"problem: {words}", style="yellow") for words in self.plan.problems]
        for cure in self.plan.cures:
            left = "cures it" if cure.cures else f"leaves {cure.shortfall:.1f} K"
            left += "".join(f"; {words}" for words in cure.broken)
            parts.append(Text(f"what would help: {cure.change}: {left}", style="yellow"))
        if not self.plan.feasible and not self.plan.cures:
            parts.append(Text("none of the changes that were tried helps", style="yellow"))
        return Group(*parts)

    def save(self, directory: Path) -> list[Path]:
        """Write the plan's schedule.csv, schedule.h and plan.json, and a table and a header for every charge."""
        paths = save_plan(self.plan, directory, "schedule")
        for table in self.tables:
            paths += save_plan(table, directory, f"schedule_{table.rig.battery.voltage:.2f}V")
        paths.append(directory / "plan.json")
        write_text(paths[-1], to_text(self.record() | {"rig_data": rig_to_dict(self.plan.rig)}))
        return paths

    def draw(self, directory: Path) -> list[Path]:
        """Write heating.png."""
        from .plots.heating import plot_heating

        plot_heating(self.plan, directory / "heating.png", band=self.band)
        return [directory / "heating.png"]


def save_plan(plan: HeatingPlan, directory: Path, name: str) -> list[Path]:
    """Write a schedule as CSV and as a C header; return the paths."""
    paths = [directory / f"{name}.csv", directory / f"{name}.h"]
    write_text(paths[0], schedule_csv(plan))
    write_text(paths[1], arduino_header(plan))
    return paths


def _charge_table(tables: tuple[HeatingPlan, ...]) -> Table:
    table = Table(box=None, padding=(0, 2, 0, 0), title="pick by the battery's voltage at rest", title_justify="left")
    for name in ("battery", "charge", "curved part in the hold", "window"):
        table.add_column(name, justify="right" if name in ("battery", "charge") else "left")
    for plan in tables:
        table.add_row(
            f"{plan.rig.battery.voltage:.2f} V",
            f"{100 * plan.rig.battery.state_of_charge:.0f} %",
            f"{plan.lowest:.1f} to {plan.highest:.1f} degC",
            plan.verdict,
        )
    return table


@dataclass(frozen=True)
class FitReport:
    """A rig calibrated to a log."""

    fit: RigFit

    def record(self) -> dict[str, Any]:
        """The answer as JSON."""
        f = self.fit
        estimates = [
            {"name": e.name, "factor": e.factor, "low": e.low, "high": e.high, "held": e.held} for e in f.estimates
        ]
        return {"estimates": estimates, "confidence": f.confidence, "noise": f.noise, "remarks": list(f.remarks)}

    def table(self) -> Group:
        """The answer for a person."""
        table = Table(title=self.fit.rig.name or "rig", title_justify="left", box=None, padding=(0, 2, 0, 0))
        for name in ("factor on", "fitted", f"{100 * self.fit.confidence:g} % interval"):
            table.add_column(name, justify="left" if name == "factor on" else "right")
        for e in self.fit.estimates:
            table.add_row(e.name, *(("held", "–") if e.held else (f"{e.factor:.4f}", f"{e.low:.4f} to {e.high:.4f}")))
        units = {"temperature": "K", "voltage": "V", "current": "A"}
        noise = ", ".join(f"{name} {value:.3g} {units[name]}" for name, value in self.fit.noise.items())
        lines = [Text(f"remark: {words}", style="yellow") for words in self.fit.remarks]
        return Group(table, Text(f"residuals: {noise}"), *lines)

    def save(self, directory: Path) -> list[Path]:
        """Write calibration.json and the calibrated rig.yaml."""
        paths = [directory / "calibration.json", directory / "rig.yaml"]
        write_text(paths[0], to_text(self.record()))
        save_rig(self.fit.rig, paths[1], "A shape-setting rig for tubeopt, calibrated to a log.")
        return paths

    def draw(self, directory: Path) -> list[Path]:
        """Write calibration.png."""
        from .plots.heating import plot_rig_fit

        plot_rig_fit(self.fit, directory / "calibration.png")
        return [directory / "calibration.png"]


@dataclass(frozen=True)
class TrialReport:
    """A rig calibrated to trials."""

    fit: TrialFit

    def record(self) -> dict[str, Any]:
        """The answer as JSON."""
        f = self.fit
        return {
            "loss_factor": f.factor,
            "low": f.low,
            "high": f.high,
            "confidence": f.confidence,
            "end_temperatures_degC": f.temperatures.tolist(),
            "least_probability": f.surprise,
        }

    def table(self) -> Group:
        """The answer for a person."""
        f = self.fit
        ends = ", ".join(f"{value:.0f}" for value in f.temperatures)
        rows = [
            ("loss factor", f"{f.factor:.3f}, {100 * f.confidence:g} % interval {f.low:.3f} to {f.high:.3f}"),
            ("trials ended at", f"{ends} degC by the calibrated rig"),
        ]
        lines = []
        if f.surprise < 0.02:
            lines.append(Text("remark: the trials contradict one another or the rig file", style="yellow"))
        return Group(two_columns(f.rig.name or "rig", rows), *lines)

    def save(self, directory: Path) -> list[Path]:
        """Write calibration.json and the calibrated rig.yaml."""
        paths = [directory / "calibration.json", directory / "rig.yaml"]
        write_text(paths[0], to_text(self.record()))
        save_rig(self.fit.rig, paths[1], "A shape-setting rig for tubeopt, calibrated to trials.")
        return paths

    def draw(self, directory: Path) -> list[Path]:
        """There is no picture of trials."""
        return []


@report.register
def _(answer: HeatingPlan) -> HeatReport:
    return HeatReport(answer, (), None, Uncertainty(), 1.0)
