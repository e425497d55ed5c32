"""`tubeopt validate`: measured tips beside the model's, and the parameters that bring them closest."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Group
from rich.table import Table
from rich.text import Text

from ..files.checked import check
from ..files.csv_file import to_csv
from ..files.files import write_text
from ..files.units import parse_number
from ..robots.file import save_robot
from ..runs.validation_study import ValidationStudy
from ..show.progress import working
from ..show.report import can_be_saved, present, report, to_text, two_columns
from ..validation import ErrorGroup, ErrorSummary, Estimate, Fit, Registration, Validation
from .options import JsonOption, OutOption, PlotOption, RobotArgument, numbers

MM = 1e3

FLAGS = {
    "robot": "",
    "measurements": "",
    "registration": "--registration",
    "base_position_mm": "--base-position-mm",
    "base_axis": "--base-axis",
    "fit": "--fit",
    "folds": "--folds",
}
"""What the keys of the study are called on the command line."""


def validate(
    robot: RobotArgument,
    measured: Annotated[str, typer.Argument(metavar="MEASURED.csv", help="Measured tips.", show_default=False)],
    registration: Annotated[
        str, typer.Option(help="How the device's frame is brought to the plate's: rigid, base-axis or none.")
    ] = "rigid",
    base_position_mm: Annotated[
        str | None, typer.Option(metavar="X,Y,Z", help="For base-axis: the plate's centre as the device sees it.")
    ] = None,
    base_axis: Annotated[
        str | None, typer.Option(metavar="X,Y,Z", help="For base-axis: direction of the plate's z in its frame.")
    ] = None,
    parameters: Annotated[
        str | None,
        typer.Option("--fit", metavar="NAME,..", help="Estimate these: curvature, curvature_2, nu, rotation_1, ..."),
    ] = None,
    folds: Annotated[str, typer.Option(help="Folds of the cross-validation of a fit; 0 for none.")] = "5",
    plot: PlotOption = False,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Measured tips against the model: errors, residuals, and a calibrated robot."""
    flags: dict[str, Any] = {
        "kind": "validation",
        "robot": robot,
        "measurements": measured,
        "registration": registration,
        "base_position_mm": numbers(base_position_mm),
        "base_axis": numbers(base_axis),
        "fit": [] if parameters is None else [name.strip() for name in parameters.split(",")],
        "folds": parse_number(folds),
    }
    study = check(ValidationStudy, flags, "", names=FLAGS)
    can_be_saved(out)
    with working("solving shapes") as progress:
        answer = study.run(progress)
    present(report(answer), out=out, as_json=as_json, plot=plot)


# --- what is said about a comparison ----------------------------------------------------------------------------------


def _summary(summary: ErrorSummary, length: float) -> dict[str, float]:
    record: dict[str, float] = {"count": summary.count}
    for name in ("mean", "rms", "p95", "max"):
        value = getattr(summary, name)
        record |= {f"{name}_mm": value * MM, f"{name}_percent": 100 * value / length if length else float("nan")}
    return record


def _groups(groups: tuple[ErrorGroup, ...], key: str, length: float) -> list[dict[str, float]]:
    return [{key: round(float(np.degrees(g.value)), 6)} | _summary(g.summary, length) for g in groups]


def _registration(registration: Registration) -> dict[str, Any]:
    return {
        "method": registration.method,
        "rotation": registration.rotation.tolist(),
        "translation_mm": (registration.translation * MM).tolist(),
        "yaw_deg": float(np.degrees(registration.yaw)),
        "tilt_deg": float(np.degrees(registration.tilt)),
    }


def comparison_record(v: Validation) -> dict[str, Any]:
    """A comparison as JSON."""
    return {
        "robot": v.robot.name,
        "measurements": v.measurements.source,
        "count": len(v.measurements),
        "length_mm": v.length * MM,
        "registration": _registration(v.registration),
        "error": _summary(v.summary, v.length),
        "by_direction": _groups(v.by_direction, "direction_deg", v.length),
        "by_separation": _groups(v.by_separation, "separation_deg", v.length),
        "sensor_spread_rms_mm": float(np.sqrt((v.measurements.sensor_spread**2).mean()) * MM),
        "least_margin": float(v.margin.min()),
    }


def _errors_in_words(summary: ErrorSummary, length: float) -> str:
    values = [("mean", summary.mean), ("RMS", summary.rms), ("95 % below", summary.p95), ("max", summary.max)]
    return ", ".join(f"{name} {x * MM:.2f} mm ({100 * x / length:.1f} %)" for name, x in values)


def _comparison_rows(v: Validation) -> list[tuple[str, str]]:
    r, sensors = v.registration, v.measurements.sensors.shape[1]
    seen = "1 sensor" if sensors == 1 else f"{sensors} sensors, averaged"
    rows = [
        ("measured", f"{len(v.measurements)} configurations, {seen}"),
        ("registration", f"{r.method}: yaw {np.degrees(r.yaw):.2f} deg, tilt {np.degrees(r.tilt):.2f} deg"),
        ("tip error", _errors_in_words(v.summary, v.length)),
    ]
    for what, groups in (("direction", v.by_direction), ("separation", v.by_separation)):
        if groups:
            worst = max(groups, key=lambda group: group.summary.mean)
            text = f"{np.degrees(worst.value):g} deg, mean {worst.summary.mean * MM:.2f} mm"
            rows.append((f"worst {what}", text))
    rows.append(("percentages", f"of the arm's length, {v.length * MM:.1f} mm"))
    return rows


@dataclass(frozen=True)
class ValidationReport:
    """What is said and saved about a comparison."""

    validation: Validation

    def record(self) -> dict[str, Any]:
        """The answer as JSON: registration, errors, errors by direction and separation."""
        return comparison_record(self.validation)

    def table(self) -> Table:
        """The answer as a table."""
        return two_columns(self.validation.robot.name or "robot", _comparison_rows(self.validation))

    def save(self, directory: Path) -> list[Path]:
        """Write report.json and residuals.csv."""
        paths = [directory / "report.json", directory / "residuals.csv"]
        write_text(paths[0], to_text(self.record()))
        write_text(paths[1], residual_csv(self.validation, None))
        return paths

    def draw(self, directory: Path) -> list[Path]:
        """Write residuals.png and errors.png."""
        from ..show.plots.validation import plot_errors, plot_residuals

        pictures = {directory / "residuals.png": plot_residuals, directory / "errors.png": plot_errors}
        for path, plot in pictures.items():
            plot(self.validation, path)
        return list(pictures)


def residual_csv(v: Validation, held_out: np.ndarray[Any, np.dtype[np.float64]] | None) -> str:
    """A row per configuration: measured and predicted tip in the plate frame, their distance, the margin."""
    columns = [f"{what}_{axis}_mm" for what in ("measured", "predicted") for axis in "xyz"]
    columns += ["error_mm", *(["held_out_error_mm"] if held_out is not None else []), "margin"]
    lengths = [v.measured, v.predicted, v.errors[:, None], *([held_out[:, None]] if held_out is not None else [])]
    table = np.hstack([*(block * MM for block in lengths), v.margin[:, None]])
    rows = [[k + 1, *(f"{x:.6f}" for x in row)] for k, row in enumerate(table.tolist())]
    return to_csv(["row", *columns], rows, "Tips in the plate frame, after registration.")


# --- what is said about a fit -----------------------------------------------------------------------------------------

_UNITS = {"": ("", 1.0), "1/m": ("_per_m", 1.0), "rad": ("_deg", 180 / np.pi), "m": ("_mm", MM)}


def _estimate(e: Estimate) -> dict[str, Any]:
    suffix, factor = _UNITS[e.unit]
    values = {name: getattr(e, name) * factor for name in ("start", "value", "standard_error", "low", "high")}
    return {"name": e.name, **{f"{name}{suffix}": x for name, x in values.items()}, "held": e.held}


@dataclass(frozen=True)
class FitReport:
    """What is said and saved about a fit."""

    fit: Fit

    def record(self) -> dict[str, Any]:
        """The answer as JSON: estimates with intervals, errors before, after and held out."""
        f = self.fit
        length = f.after.length
        return {
            "estimates": [_estimate(e) for e in f.estimates],
            "confidence": f.confidence,
            "correlation": f.correlation.tolist(),
            "noise_mm": f.noise * MM,
            "remarks": list(f.remarks),
            "rotation_offsets_deg": np.degrees(f.rotation_offsets).tolist(),
            "before": comparison_record(f.before),
            "after": comparison_record(f.after),
            "held_out": _summary(f.held_out, length) if f.held_out else None,
            "shapes_solved": f.evaluations,
        }

    def table(self) -> Group:
        """The comparison after the fit, the errors before, after and held out, the estimates, the remarks."""
        f = self.fit
        rows = [row for row in _comparison_rows(f.after) if row[0] != "tip error"]
        rows.insert(2, ("tip error before", _errors_in_words(f.before.summary, f.before.length)))
        rows.insert(3, ("after the fit", _errors_in_words(f.after.summary, f.after.length)))
        if f.held_out:
            rows.insert(4, ("held out", _errors_in_words(f.held_out, f.after.length)))
        rows.append(("noise per coordinate", f"{f.noise * MM:.3f} mm"))
        if f.rotation_offsets.any():
            offsets = ", ".join(f"{x:.2f}" for x in np.degrees(f.rotation_offsets))
            rows.append(("add to the rotations", f"{offsets} deg (a robot file does not hold them)"))
        lines = [Text(f"remark: {line}", style="yellow") for line in f.remarks]
        return Group(two_columns(f.robot.name or "robot", rows), self._estimates(), *lines)

    def _estimates(self) -> Table:
        table = Table(box=None, padding=(0, 2, 0, 0))
        table.add_column("parameter", style="bold")
        interval = f"{100 * self.fit.confidence:g} % interval"
        for name in ("given", "fitted", interval):
            table.add_column(name, justify="right")
        for e in self.fit.estimates:
            suffix, factor = _UNITS[e.unit]
            unit = f" {suffix[1:].replace('per_m', '1/m')}" if suffix else ""
            low, high = (f"{x * factor:.4g}" for x in (e.low, e.high))
            cells = ("held", "–") if e.held else (f"{e.value * factor:.4g}{unit}", f"{low} to {high}{unit}")
            table.add_row(e.name, f"{e.start * factor:.4g}{unit}", *cells)
        return table

    def save(self, directory: Path) -> list[Path]:
        """Write report.json, residuals.csv and the calibrated robot.yaml."""
        paths = [directory / name for name in ("report.json", "residuals.csv", "robot.yaml")]
        write_text(paths[0], to_text(self.record()))
        write_text(paths[1], residual_csv(self.fit.after, self.fit.held_out_errors))
        save_robot(self.fit.robot, paths[2])
        return paths

    def draw(self, directory: Path) -> list[Path]:
        """Write residuals.png and errors.png, after the fit."""
        return ValidationReport(self.fit.after).draw(directory)


@report.register
def _(answer: Validation) -> ValidationReport:
    return ValidationReport(answer)


@report.register
def _(answer: Fit) -> FitReport:
    return FitReport(answer)
