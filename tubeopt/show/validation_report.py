"""Reports on measured tips and the model, on a fit of its parameters, and on configurations to measure."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rich.console import RenderableType

from ..files.csv_file import to_csv
from ..files.files import write_text
from ..files.units import SIGNS, TO_MM
from ..robots.calibration import DEVIATIONS
from ..robots.file import calibration_to_dict, save_robot, waypoints_csv
from ..robots.passport import continue_passport
from ..typing import Array
from ..validation import (
    Comparison,
    ErrorGroup,
    ErrorSummary,
    Estimate,
    Fit,
    Placement,
    Registration,
    SelectionStep,
    Validation,
)
from . import quantities
from .quantities import Quantity, described, in_units, line, of_field, with_unit
from .report import Drawing, Report, drawing, grid

ERRORS = ("mean", "rms", "p95", "max")
"""Values of an error summary, in mm and in percent of the arm's length."""


def _summary(summary: ErrorSummary, length: float) -> dict[str, float]:
    known: dict[str, float] = {"count": summary.count}
    for name in ERRORS:
        value = getattr(summary, name)
        known |= {f"{name}_mm": value * TO_MM, f"{name}_percent": 100 * value / length if length else float("nan")}
    return known


def _groups(groups: tuple[ErrorGroup, ...], key: str, length: float) -> list[dict[str, float]]:
    return [{key: round(float(np.degrees(g.value)), 6)} | _summary(g.summary, length) for g in groups]


def _errors_text(summary: ErrorSummary, length: float) -> str:
    values = [("mean", summary.mean), ("RMS", summary.rms), ("95 % below", summary.p95), ("max", summary.max)]
    return ", ".join(f"{name} {x * TO_MM:.2f} mm ({100 * x / length:.1f} %)" for name, x in values)


def _measured(v: Validation) -> str:
    sensors = v.measurements.sensors.shape[1]
    sensor_count = "1 sensor" if sensors == 1 else f"{sensors} sensors, averaged"
    return f"{len(v.measurements)} configurations, {sensor_count}"


def _worst(groups: tuple[ErrorGroup, ...]) -> str | None:
    if not groups:
        return None
    worst = max(groups, key=lambda group: group.summary.mean)
    return f"{np.degrees(worst.value):g} deg, mean {worst.summary.mean * TO_MM:.2f} mm"


REGISTRATION = described(
    Registration,
    "method rotation translation",
    Quantity("yaw_deg", "rotation about the plate's axis"),
    Quantity("tilt_deg", "angle between the frames' z axes"),
)


def _axis_error(v: Validation) -> float | None:
    """RMS angle between measured and predicted directions, rad; None without measured directions."""
    # NaN in rows without a measured direction.
    return None if v.axis_errors is None else float(np.sqrt(np.nanmean(v.axis_errors**2)))


def _stations(v: Validation) -> list[dict[str, float]] | None:
    """Records of the errors at each sensor behind the tip; None if only the tip was measured."""
    behind = v.measurements.stations
    if len(behind) == 1:
        return None
    summaries = [_summary(ErrorSummary.of(v.along[:, k]), v.length) for k in range(len(behind))]
    return [{"behind_mm": float(at * TO_MM)} | each for at, each in zip(behind, summaries, strict=True)]


def _parity_text(v: Validation) -> str | None:
    """Part of the error that depends on the direction of motion, as text; None without pairs."""
    if v.parity is None:
        return None
    p = v.parity
    return (
        f"{p.pairs} places were measured in both directions: {p.history * TO_MM:.2f} mm of the error depends on "
        f"the direction, {p.static * TO_MM:.2f} mm does not"
    )


def _registered(registration: Registration) -> str:
    # Exactly the identity: nothing was fitted.
    if np.array_equal(registration.rotation, np.eye(3)) and not registration.translation.any():
        return f"{registration.method}: the device's frame is the plate's"
    yaw, tilt = np.degrees([registration.yaw, registration.tilt])
    return f"{registration.method}: yaw {yaw:.2f} deg, tilt {tilt:.2f} deg"


def _recording(v: Validation) -> dict[str, Any]:
    """Record of one recording."""
    motion = v.registration
    pose = {"rotation": motion.rotation.tolist(), "translation_mm": (motion.translation * TO_MM).tolist()}
    return {"measurements": v.measurements.source, "error": _summary(v.summary, v.length), "registration": pose}


COMPARISON = described(
    Validation,
    Quantity("robot", "name of the robot", lambda v: v.robot.name),
    Quantity("measurements", "file of the measurements", lambda v: v.measurements.source),
    Quantity("count", "number of measured configurations", lambda v: len(v.measurements), text=_measured,
             label="measured"),
    of_field(Validation, "registration", label="registration",
             text=lambda v: _registered(v.registration), of=REGISTRATION),
    of_field(Validation, "registration_error", label="known to", text="{registration_error[turn_deg]:.2f} deg and "
             "{registration_error[reach_mm]:.2f} mm at the arm's length (standard errors)"),
    Quantity("error", "errors of the tip", lambda v: _summary(v.summary, v.length),
             text=lambda v: _errors_text(v.summary, v.length), label="tip error"),
    Quantity("by_direction", "errors by direction", lambda v: _groups(v.by_direction, "direction_deg", v.length),
             label="worst direction", text=lambda v: _worst(v.by_direction)),
    Quantity("by_separation", "errors by separation", lambda v: _groups(v.by_separation, "separation_deg", v.length),
             label="worst separation", text=lambda v: _worst(v.by_separation)),
    of_field(Validation, "length", label="percentages", text="of the arm's length, {length_mm:.1f} mm"),
    Quantity("sensor_spread_rms_mm", "RMS distance of sensors from their mean",
             lambda v: np.sqrt((v.measurements.sensor_spread**2).mean())),
    Quantity("least_margin", "smallest margin of the configurations", lambda v: np.nanmin(v.margin)),
    Quantity("axis_error_rms_deg", "RMS angle between measured and predicted direction", _axis_error, form=".2f"),
    Quantity("stations", "errors at each distance behind the tip", lambda v: _stations(v)),
    of_field(Validation, "parity", label="both directions", text=lambda v: _parity_text(v)),
    Quantity("recordings", "errors and registration of each of several recordings",
             lambda v: [_recording(part) for part in v.recordings], label="by recording",
             text=lambda v: ", ".join(f"{part.measurements.source} RMS {part.summary.rms * TO_MM:.2f} mm"
                                       for part in v.recordings) or None),
    Quantity("remarks", "remarks on the measurements"),
)  # fmt: skip


class ValidationReport(Report[Validation]):
    command = "validate"
    quantities = COMPARISON
    file = "report.json"

    def save(self, directory: Path) -> list[Path]:
        """Write report.json and residuals.csv, and continue the passport in the folder."""
        v = self.answer
        of = {"robot": v.robot.name or "", "configurations": len(v.errors), "mean_error_mm": float(v.errors.mean())}
        passport = continue_passport(directory, "validations", **of)
        return [self.save_record(directory), save_residuals(directory, v), *passport]

    def pictures(self) -> dict[str, Drawing]:
        return _pictures(self.answer, "")


def _pictures(v: Validation, when: str) -> dict[str, Drawing]:
    return {
        "residuals": drawing("validation.plot_residuals", v, when=when),
        "errors": drawing("validation.plot_errors", v, when=when),
    }


def save_residuals(directory: Path, v: Validation, held_out: Array | None = None) -> Path:
    """A row per configuration: measured and predicted tip in the plate frame, their distance, the margin.

    The last column is 1 for readings outside of the ranges that the robot was calibrated in.
    """
    columns = [f"{what}_{axis}_mm" for what in ("measured", "predicted") for axis in "xyz"]
    columns += ["error_mm", *(["held_out_error_mm"] if held_out is not None else []), "margin", "outside"]
    lengths = [v.measured, v.predicted, v.errors[:, None], *([held_out[:, None]] if held_out is not None else [])]
    table = np.hstack([*(block * TO_MM for block in lengths), v.margin[:, None]])
    rows = zip(table.tolist(), v.outside.astype(int).tolist(), strict=True)
    cells = [[k + 1, *(f"{x:.6f}" for x in row), outside] for k, (row, outside) in enumerate(rows)]
    path = directory / "residuals.csv"
    write_text(path, to_csv(["row", *columns], cells, "Tips in the plate frame, after registration."))
    return path


def _estimate(e: Estimate) -> dict[str, Any]:
    """Record of an estimated parameter."""
    names = ("start", "value", "standard_error", "low", "high", "posterior_error", "posterior_low", "posterior_high")
    values = with_unit(DEVIATIONS[e.unit], {name: getattr(e, name) for name in names})
    return {"name": e.name, **values, "held": e.held}


FIT_ERRORS: tuple[Quantity[Fit], ...] = (
    line("tip error before", lambda f: _errors_text(f.before.summary, f.before.length)),
    line("after the fit", lambda f: _errors_text(f.after.summary, f.after.length)),
    Quantity("held_out", "errors of held-out configurations",
             lambda f: _summary(f.held_out, f.after.length) if f.held_out else None, label="held out",
             text=lambda f: _errors_text(f.held_out, f.after.length) if f.held_out else None),
    Quantity("held_out_recordings", "errors of recordings, common parameters fitted to the others",
             lambda f: [_summary(s, f.after.length) for s in f.by_recording] or None, label="held-out recordings",
             text=lambda f: ", ".join(f"RMS {s.rms * TO_MM:.2f} mm" for s in f.by_recording) or None),
    Quantity("new_paths", "RMS error expected on new paths in the recorded ranges, and its 95 % interval",
             lambda f: None if f.new_paths is None else with_unit("mm", vars(f.new_paths)),
             label="expected on new paths", text=lambda f: None if f.new_paths is None else
             "RMS {:.2f} mm, 95 % {:.2f} to {:.2f} mm".format(*(x * TO_MM for x in vars(f.new_paths).values()))),
)  # fmt: skip

FIT = described(
    Fit,
    Quantity("estimates", "the parameters, with their intervals", lambda f: [_estimate(e) for e in f.estimates]),
    Quantity("learned_per_m", "learned change of the precurvature, root mean square along each tube",
             lambda f: None if f.learned is None else list(f.learned), label="learned change of the curvature",
             text=lambda f: None if f.learned is None else
             ", ".join(f"{x:.2f} 1/m of tube {k}" for k, x in enumerate(f.learned, start=1))),
    "confidence correlation noise remarks axis_noise",
    Quantity("calibration", "calibration of drives, sensor, plate and registration, as in robot.yaml",
             lambda f: None if f.robot.calibration is None else calibration_to_dict(f.robot.calibration),
             label="drives", text="their offsets, gains and latency go into robot.yaml of --out, with sensor, plate "
             "and registration: `tubeopt validate` of it with these measurements gives the error after the fit again"),
    Quantity("held_out_axis_deg", "RMS angle between measured and predicted direction, held out",
             lambda f: None if f.held_out_axis_errors is None else np.sqrt(np.nanmean(f.held_out_axis_errors**2)),
             form=".2f", label="RMS angle of directions that a fit to the others did not see"),
    of_field(Fit, "before", of=COMPARISON),
    of_field(Fit, "after", of=COMPARISON),
    "evaluations",
)  # fmt: skip


class FitReport(Report[Fit]):
    command = "validate --fit"
    quantities = (*FIT_ERRORS, *FIT)
    file = "report.json"

    def rows(self) -> list[tuple[str, str]]:
        """Rows (name, text) of the comparison after the fit, the errors (before, after, held out) and the noise."""
        compared = quantities.rows(self.answer.after, COMPARISON)
        # The error after the fit is one of three errors, which replace the single one.
        at = [name for name, _ in compared].index("tip error")
        errors = quantities.rows(self.answer, FIT_ERRORS)
        return [*compared[:at], *errors, *compared[at + 1 :], *quantities.rows(self.answer, FIT)]

    def below(self) -> list[RenderableType]:
        """A row per parameter, then the remarks."""
        cells = []
        for e in self.answer.estimates:
            if e.learned:  # a dozen numbers per tube, which say something together only
                continue
            unit = DEVIATIONS[e.unit]
            sign = f" {SIGNS.get(unit, unit)}" if unit else ""
            names = ("start", "value", "low", "high", "posterior_low", "posterior_high")
            factor = "× " if not unit and e.start == 1.0 else ""  # what is given is 1 of factors alone
            start, value, low, high, posterior_low, posterior_high = (
                f"{factor * (name in names[:2])}{in_units(getattr(e, name), unit):.4g}" for name in names
            )
            fitted = (
                ("held", "–", "–")
                if e.held
                else (f"{value}{sign}", f"{low} to {high}{sign}", f"{posterior_low} to {posterior_high}{sign}")
            )
            cells.append((e.name, f"{start}{sign}", *fitted))
        interval = f"{100 * self.answer.confidence:g} % interval"
        columns = ("parameter", "given >", "fitted >", f"{interval} >", "with what the model lacks >")
        return [grid(columns, cells, key=True), *super().below()]

    def save(self, directory: Path) -> list[Path]:
        """Write report.json, residuals.csv and the calibrated robot.yaml."""
        f = self.answer
        paths = [self.save_record(directory), save_residuals(directory, f.after, f.held_out_errors)]
        save_robot(f.robot, directory / "robot.yaml")
        return [*paths, directory / "robot.yaml"]

    def pictures(self) -> dict[str, Drawing]:
        return _pictures(self.answer.after, "after the fit")


def _step(step: SelectionStep, length: float) -> dict[str, Any]:
    axis = step.held_out_axis
    return {
        "effect": step.effect,
        "parameters": list(step.parameters),
        "gain_percent": 100 * step.gain,
        "certainty": step.certainty,
        "held_out": _summary(step.held_out, length),
        "held_out_axis_deg": None if axis is None else float(np.degrees(axis)),
        "weight": step.weight,
        "rivals": list(step.rivals),
    }


def _held_out(errors: ErrorSummary, axis: float | None) -> tuple[str, str]:
    """Errors of tips and of directions in two cells."""
    return f"{errors.rms * TO_MM:.2f} mm", "" if axis is None else f"{np.degrees(axis):.2f} deg"


def _length(c: Comparison) -> float:
    return c.fit.after.length if c.fit else float("nan")


EFFECTS_THAT_PAY = described(
    Comparison,
    "folds",
    Quantity("start", "held-out errors of the given robot", lambda c: _summary(c.start, _length(c)),
             label="as given", text="RMS {start[rms_mm]:.2f} mm held out"),
    "start_axis",
    Quantity("steps", "effects that reduce the held-out errors, in order",
             lambda c: [_step(s, _length(c)) for s in c.steps]),
    Quantity("chosen_anew",
             "held-out errors that include the choice of effects, to first order; the rows held out for steps and fit"
             " took part in that choice", lambda c: _summary(c.chosen_anew, _length(c)),
             label="held out, choice included",
             text="RMS {chosen_anew[rms_mm]:.2f} mm; the rows held out below took part in the choice of effects"),
    Quantity("chosen_by_fold", "effects that are chosen without each held-out block",
             lambda c: [list(kinds) for kinds in c.chosen_by_fold], label="same effects chosen",
             text=lambda c: f"in {c.alike} of {len(c.chosen_by_fold)} choices without one block"),
    Quantity("averaged_anew", "the same of the mean over sets of effects, as averaged.yaml has it",
             lambda c: _summary(c.averaged_anew, _length(c)), label="held out, mean over sets of effects",
             text=lambda c: f"RMS {c.averaged_anew.rms * TO_MM:.2f} mm"
                            + ("" if c.settled else "; use it, since blocks disagree on the effects: averaged.yaml")),
    Quantity("weights", "sets of effects and their weights in this mean",
             lambda c: [{"weight": set_.weight, "effects": list(set_.effects)} for set_ in c.weights]),
    "dropped",
    Quantity("refused", "effects that do not reduce the held-out errors further",
             lambda c: [_step(s, _length(c)) for s in c.refused]),
    "remarks",
    of_field(Comparison, "fit", of=(*FIT_ERRORS[2:], *FIT)),
)  # fmt: skip


class EffectsReport(Report[Comparison]):
    command = "validate --compare"
    quantities = EFFECTS_THAT_PAY
    file = "report.json"

    def title(self) -> str:
        return self.answer.fit.robot.name if self.answer.fit else "no effect pays"

    def below(self) -> list[RenderableType]:
        """Effects in order of their gain, effects without gain, and the fit."""
        c = self.answer
        cells = [("as given", *_held_out(c.start, c.start_axis), "", "", "")]
        for word, steps in (("", c.steps), ("does not pay", c.refused)):
            for s in steps:
                rivals = f"or {' or '.join(s.rivals)}: as good" if s.rivals else word
                sure = f"{100 * s.gain:.1f} %", f"{s.weight:.2f}"
                cells.append((s.effect, *_held_out(s.held_out, s.held_out_axis), *sure, rivals))
        table = grid(("effect", "held out, RMS >", "direction >", "gain >", "weight >", ""), cells, key=True)
        return [table, *(super().below() if c.fit is None else [FitReport(c.fit).table()])]

    def save(self, directory: Path) -> list[Path]:
        """Write report.json and averaged.yaml, and residuals.csv and the calibrated robot.yaml where an effect pays."""
        of_fit = [] if self.answer.fit is None else FitReport(self.answer.fit).save(directory)[1:]
        save_robot(self.answer.averaged, directory / "averaged.yaml")
        return [self.save_record(directory), *of_fit, directory / "averaged.yaml"]

    def pictures(self) -> dict[str, Drawing]:
        """Pictures of the effects; residuals and errors if an effect is useful."""
        of_fit = {} if self.answer.fit is None else FitReport(self.answer.fit).pictures()
        return {"effects": drawing("validation.plot_effects", self.answer)} | of_fit


def _expected(p: Placement) -> list[dict[str, Any]]:
    rows = zip(p.parameters, p.units, p.standard_errors.tolist(), p.random.tolist(), strict=True)
    return [
        {"name": name} | with_unit(DEVIATIONS[unit], {"standard_error": error, "at_random": random})
        for name, unit, error, random in rows
    ]


PLACEMENT = described(
    Placement,
    Quantity("robot", "name of the robot", lambda p: p.robot.name),
    Quantity(
        "count",
        "number of configurations to measure",
        lambda p: int(p.measured.sum()),
        form="d",
        label="configurations to measure",
    ),
    Quantity(
        "waypoints",
        "number of waypoints, with home and detours around snaps",
        lambda p: len(p.measured),
        form="d",
        label="waypoints with home and detours around snaps",
    ),
    Quantity("least_margin", "smallest margin", lambda p: p.margin.min(), form=".3f", label="least margin"),
    "noise",
    Quantity("expected", "expected standard errors, and those of random configurations", _expected),
    "rotations translations measured",
)


class PlacementReport(Report[Placement]):
    command = "measure"
    quantities = PLACEMENT
    file = "report.json"

    def below(self) -> list[RenderableType]:
        """Table of the expected errors."""
        p = self.answer
        cells = []
        for name, unit, error, random in zip(p.parameters, p.units, p.standard_errors, p.random, strict=True):
            suffix = DEVIATIONS[unit]
            sign = SIGNS.get(suffix, suffix)
            shown = (f"{in_units(float(x), suffix):.3g} {sign}".strip() for x in (error, random))
            cells.append((name, *shown, f"{random / error:.1f}"))
        heads = ("parameter", "standard error >", "at random >", "times less >")
        return [grid(heads, cells, key=True)]

    def save(self, directory: Path) -> list[Path]:
        """Write report.json, path.csv, which `tubeopt follow` reads, and configurations.csv, those to measure."""
        a = self.answer
        tables = {"path.csv": a.measured >= 0, "configurations.csv": a.measured}
        for name, rows in tables.items():
            write_text(directory / name, waypoints_csv(a.rotations[rows], a.translations[rows]))
        return [self.save_record(directory), *(directory / name for name in tables)]
