"""Report on a commissioning: how columns are read, effects, errors held out, the floor of the servo."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import RenderableType

from ..control.c_library import save_c_library
from ..files.files import write_text
from ..files.units import SIGNS, TO_MM
from ..robots.calibration import DEVIATIONS
from ..robots.file import save_robot
from ..robots.passport import continue_passport
from ..runs.commission_study import Commissioning
from ..runs.log_file import ReadLog
from ..validation.reading import Decision
from .quantities import Quantity, described, in_units, of_field
from .report import Drawing, Report, drawing, grid
from .validation_report import EFFECTS_THAT_PAY, EffectsReport, PlacementReport, save_residuals


def decision_record(d: Decision) -> dict[str, Any]:
    """Record of a decision."""
    left = {"left_mm": d.rms * TO_MM, "left_otherwise_mm": d.other_rms * TO_MM}
    return {"about": d.about, "chosen": d.chosen, "other": d.other, "certain": d.certain, "reason": d.reason, **left}


def reading_rows(log: ReadLog) -> list[tuple[str, str, str]]:
    """Rows (about, chosen, evidence) on how a recording is read."""
    rows = [(d.about, d.chosen, evidence(d)) for d in log.every_decision]
    rows += [
        (f"home of {meaning}", text, "found from the tips") for meaning, text in log.mapping.get("formulas", {}).items()
    ]
    return rows or [("columns", "as the file says", "not checked")]


def evidence(d: Decision) -> str:
    """Text of the reason for a reading."""
    if d.reason:
        return d.reason
    if math.isinf(d.other_rms):
        return f"{d.other} is impossible"
    return f"{d.rms * TO_MM:.2f} mm left; {d.other}: {d.other_rms * TO_MM:.2f} mm"


def _log(log: ReadLog) -> dict[str, Any]:
    found = log.detection
    return {
        "name": log.name,
        "rows": len(log.measurements),
        "columns": dict(log.mapping.get("columns", {})) | dict(log.mapping.get("joint_columns", {})),
        "formulas": dict(log.mapping.get("formulas", {})),
        "left_mm": None if found is None else found.rms * TO_MM,
        "decisions": [decision_record(d) for d in log.every_decision],
    }


def latency_text(c: Commissioning) -> str:
    """Latency of every recording, as text."""
    found = {e.name: e for e in c.fit.estimates if e.name.startswith("latency")}
    if not found:
        return "none that lowers the errors held out"
    return ", ".join(f"{name} {1e3 * e.value:.0f} ms" for name, e in found.items())


def floor_text(c: Commissioning) -> str:
    """Floor of the servo, as text."""
    return "unknown" if c.floor is None else f"snap distance {math.degrees(c.floor):.1f} deg"


COMMISSIONING = described(
    Commissioning,
    Quantity("logs", "recordings, and how their columns were read", lambda c: [_log(each) for each in c.logs],
             label="recordings", text=lambda c: ", ".join(f"{r.name} ({len(r.measurements)} rows)" for r in c.logs)),
    Quantity("latency", "latency of every recording", latency_text, text=latency_text),
    Quantity("held_out_rms_mm", "RMS error held out, with the choice of effects",
             lambda c: c.comparison.chosen_anew.rms, form=".2f", label="held out, choice included",
             text="RMS {held_out_rms_mm:.2f} mm"),
    of_field(Commissioning, "floor", label="servo must keep", text=floor_text),
    Quantity("measure_next", "number of configurations to measure next",
             lambda c: 0 if c.placement is None else int(c.placement.measured.sum()), form="d"),
    of_field(Commissioning, "comparison", of=EFFECTS_THAT_PAY),
    "remarks",
)  # fmt: skip


class CommissioningReport(Report[Commissioning]):
    command = "commission"
    quantities = COMMISSIONING
    file = "report.json"

    def title(self) -> str:
        return self.answer.given.name or "robot"

    def below(self) -> list[RenderableType]:
        """Tables of the columns of every recording, of the effects, and the remarks."""
        columns = ("column", "read as", "because")
        tables = [grid(columns, reading_rows(log), title=log.name, key=True) for log in self.answer.logs]
        return [*tables, *EffectsReport(self.answer.comparison).below(), *super().below()]

    def save(self, directory: Path) -> list[Path]:
        """Write the robot, how recordings are read, residuals, configurations to measure next, and the servo in C."""
        c = self.answer
        paths = [self.save_record(directory), save_residuals(directory, c.fit.after, c.fit.held_out_errors)]
        save_robot(c.robot, directory / "robot.yaml")
        paths.append(directory / "robot.yaml")
        for k, log in enumerate(c.logs, start=1):
            if log.mapping:
                paths.append(directory / f"recording_{k}.yaml")
                write_text(paths[-1], log.text(directory))
        if c.placement is not None:
            paths += PlacementReport(c.placement).save(directory / "next")
        paths += save_c_library(c.library, directory / "servo")
        of = {"robot": c.given.name or "", "held_out_mm": c.comparison.chosen_anew.rms * TO_MM}
        return [*paths, *continue_passport(directory, "validations", **of)]

    def pictures(self) -> dict[str, Drawing]:
        """The page to print."""
        return {"commissioning.pdf": drawing("commission.plot_commissioning", self.answer)}


def estimate_rows(c: Commissioning) -> list[tuple[str, str, str]]:
    """Rows (name, value, interval with what the model lacks) of all fitted parameters."""
    rows = []
    for e in c.fit.estimates:
        if e.learned:
            continue
        unit = DEVIATIONS[e.unit]
        value, low, high = (in_units(x, unit) for x in (e.value, e.posterior_low, e.posterior_high))
        sign = SIGNS.get(unit, unit)
        rows.append(
            (e.name, "held" if e.held else f"{value:.4g} {sign}".strip(), "" if e.held else f"{low:.4g} to {high:.4g}")
        )
    return rows


def next_rows(c: Commissioning, most: int) -> list[tuple[str, ...]]:
    """Readings of the configurations to measure next, rotations in deg and translations in mm."""
    if c.placement is None:
        return []
    p = c.placement
    table = np.hstack([np.degrees(p.rotations), TO_MM * p.translations])[p.measured]
    return [(f"{k}", *(f"{x:.1f}" for x in row)) for k, row in enumerate(table[:most].tolist(), start=1)]
