"""Reports on molds, and on the files to make them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Group
from rich.text import Text

from ..constants import ZERO_CELSIUS
from ..errors import SolveError
from ..files.units import TO_MM, per_si
from ..robots.file import save_robot
from ..robots.passport import begin_passport, continue_passport
from ..robots.tubes import Tube
from ..runs.heating_study import Fabrication, TubeParts
from ..runs.mold_study import MoldRanking
from ..runs.workshop_file import save_rig, save_springback, save_trial, springback_to_dict
from ..shaping.firmware.boards import shared_parts
from ..shaping.materials import MoldMaterial
from ..shaping.mold.checks import Check, pressing_strain
from ..shaping.mold.files import write_mold
from ..shaping.mold.gcode import Program, clamp_distance, programs_of
from ..shaping.mold.layout import Hole
from ..shaping.mold.mandrel import Block, Cylinder, Mandrel, predict_wound_tube, write_mandrel
from ..shaping.mold.measured_tube import MeasuredTube, RadiusErrors
from ..shaping.mold.mold import PARTS, Clamp, Groove, RobotMold, predict_tube
from ..shaping.mold.ranking import MaterialRating
from ..shaping.mold.springback import Calibration, Springback
from .heat_report import HEATING, SUCCESS, FeedbackReport, HeatingReport, hold_duties, success_text
from .quantities import Quantity, described, of_field, with_unit, within
from .report import Drawing, Report, drawing, grid, remarks

CLAMP = described(
    Clamp,
    "end face direction",
    Quantity("slides", "true if it slides when the tube expands"),
)

GROOVE = described(
    Groove,
    Quantity("wanted_radius_mm", "target radius of the tube",
             lambda g: 1 / abs(g.tube.curvature) if g.tube.curvature else math.inf, form=".4g", label="wanted radius"),
    Quantity("mold_radius_mm", "radius of the groove", lambda g: g.radius, form=".4g", label="mold radius"),
    Quantity("mold_curvature_per_m", "curvature of the groove", lambda g: g.curvature),
    Quantity("arcs", "number of tangent arcs of the bend; with several, radii and curvature are the tightest",
             lambda g: len(g.centreline.bend)),
    Quantity("bend_length_mm", "length of the bend", form=".4g", label="bend, length"),
    Quantity("bend_angle_deg", "angle of the bend", form=".4g", label="bend, angle"),
    Quantity("lead_in_mm", "straight groove before the bend", lambda g: g.centreline.lead_in.length),
    Quantity("lead_out_mm", "straight groove behind the bend", lambda g: g.centreline.lead_out.length),
    "width depth",
    Quantity("end_mill_mm", "diameter of the end mill", lambda g: g.mill.diameter, form=".4g", label="end mill"),
    Quantity("strain_percent", "strain of the tube when pressed in", form=".4g", label="strain when pressed in"),
    Quantity("cold_length_mm", "length of the cold end from the clamp", lambda g: g.cold.length, form=".4g",
             label="cold end from the clamp"),
    Quantity("decay_length_mm", "decay length of the cold end", lambda g: g.cold.decay_length),
    Quantity("loss_coefficient_W_per_m2_K", "heat transfer coefficient into the mold",
             lambda g: g.cold.loss_coefficient),
    Quantity("gaps_mm", "gaps between the plate's edges and the clamps"),
    Quantity("free_length_mm", "length of tube between the clamps"),
    "growth",
    Quantity("travel_mm", "travel of the sliding clamp", lambda g: max(clamp.travel for clamp in g.clamps), form=".4g"),
    Quantity("stock_length_mm", "length of the tube blank", form=".4g", label="cut the tube to"),
    Quantity("extra_length_mm", "part of the blank that is trimmed", form=".4g", label="trimmed"),
    Quantity("bend_begins_mm", "distance of the bend from the tube's end", lambda g: g.before_bend),
    Quantity("trim_proximal_mm", "length to cut off at the proximal end", lambda g: g.trim[0]),
    Quantity("trim_distal_mm", "length to cut off at the distal end", lambda g: g.trim[1]),
    of_field(Groove, "clamps", of=CLAMP),
    Quantity("vents", "vents over the bend", lambda g: len(g.vents)),
    Quantity("slot_mm", "width, depth and length of the lid's slot for a thermocouple; null without one",
             lambda g: g.slot and [g.slot.mill.diameter * TO_MM, g.slot.depth * TO_MM,
                                   g.slot.centreline.length * TO_MM]),
)  # fmt: skip

PREDICTED: tuple[Quantity[Tube], ...] = (
    Quantity("curvature_per_m", "curvature of the predicted tube"),
    Quantity("curved_length_mm", "curved length of the predicted tube"),
    Quantity("straight_length_mm", "straight length of the predicted tube"),
)

PROGRAM = described(
    Program,
    "file tool",
    Quantity("time_min", "machining time", lambda program: program.time / 60, form=".1f", label="that its moves take"),
)


def _coming(at: tuple[RobotMold, int]) -> tuple[float, float] | None:
    """95 % interval of the radius of the tube of a groove, m; None without trials, or for a straight tube."""
    mold = at[0].mold
    interval = mold.spec.springback.interval(mold.grooves[at[1]].curvature)
    if interval is None or not interval[1]:
        return None
    low, high = interval
    return 1 / high, 1 / low if low else math.inf


MOLD = described(
    RobotMold,
    "name",
    Quantity("material", "material of both plates", lambda a: a.mold.spec.material.name),
    Quantity("size_mm", "width and height of the plates", lambda a: a.mold.size),
    Quantity("thickness_mm", "thickness of the lower plate", lambda a: a.mold.spec.plate.thickness),
    Quantity("lid_thickness_mm", "thickness of the top plate", lambda a: a.mold.spec.plate.lid_thickness),
    Quantity("base_volume_mm3", "volume of the lower plate", lambda a: a.mold.base_volume),
    Quantity("lid_volume_mm3", "volume of the top plate", lambda a: a.mold.lid_volume),
    Quantity("springback", "spring-back, as in a mold file", lambda a: _springback(a.mold.spec.springback)),
    Quantity(
        "grooves",
        "the grooves, one per tube",
        lambda a: [(a, k) for k in range(len(a.mold.grooves))],
        of=(
            Quantity("tube", "number of the tube, 1 for the innermost", lambda at: at[0].mold.grooves[at[1]].number),
            *within(GROOVE, lambda at: at[0].mold.grooves[at[1]]),
            Quantity("radius_interval_mm", "95 % interval of the radius that comes out; null without trials", _coming),
            Quantity("predicted", "predicted tube", lambda at: predict_tube(at[0].mold, at[1]), of=PREDICTED),
        ),
    ),
    Quantity("programs", "G-code of both plates, in order of machining", lambda a: programs_of(a.mold), of=PROGRAM),
    Quantity("clear_mm", "free room for clamps next to the plates", lambda a: clamp_distance(a.mold)),
    Quantity("holes", "holes of the lower plate", lambda a: a.mold.base_holes, of=described(Hole)),
    Quantity("checks", "checks, and whether they passed", lambda a: [_check(c) for c in a.mold.checks]),
    Quantity("remarks", "remarks for making and using it", lambda a: [*a.left_out, *a.mold.remarks]),
)


class MoldReport(Report[RobotMold]):
    command = "mold plan"
    quantities = MOLD
    file = "mold.json"

    def title(self) -> str:
        mold = self.answer.mold
        size = " x ".join(f"{extent * TO_MM:g}" for extent in mold.size)
        return f"{self.answer.name or 'robot'}: mold of {mold.spec.material.name}, {size} mm"

    def table(self) -> Group:
        """A row per property, a column per groove; then the remarks."""
        grooves = self.record()["grooves"]
        cells = [
            [f"{q.about} ({q.sign})", *(f"{groove[q.key]:{q.form}}" for groove in grooves)] for q in GROOVE if q.form
        ]
        numbers = [f"{groove.number} >" for groove in self.answer.mold.grooves]
        lines = remarks((*self.answer.left_out, *self.answer.mold.remarks), what="remark")
        return Group(Text(self.title(), style="italic"), grid(("tube", *numbers), cells, key=True), *lines)

    def save(self, directory: Path) -> list[Path]:
        """Write mold.json, base and lid as DXF, SVG, STL and G-code, setup.pdf, base_holes.pdf and lid_holes.pdf."""
        from .plots.sheets import plot_hole_sheet, plot_setup_sheet

        mold, paths = self.answer.mold, [self.save_record(directory), *write_mold(self.answer.mold, directory)]
        numbers = ", ".join(str(groove.number) for groove in mold.grooves)
        title = f"{self.answer.name or 'robot'}, tube {numbers}{self.answer.making}"
        paths.append(directory / "setup.pdf")
        plot_setup_sheet(mold, paths[-1], title=title)
        for part in PARTS:
            paths.append(directory / f"{part}_holes.pdf")
            plot_hole_sheet(mold, paths[-1], part=part, title=title)
        return paths

    def pictures(self) -> dict[str, Drawing]:
        return {"mold": drawing("mold.plot_mold", self.answer.mold, title=self.answer.name)}


def _springback(back: Springback) -> dict[str, Any]:
    """Record of a spring-back with the keys of a mold file."""
    data = springback_to_dict(back)
    return {key: [float(x) for x in value] if isinstance(value, list) else float(value) for key, value in data.items()}


SUFFIXES = {"m": "mm", "1": "percent", "K": "K"}
"""SI unit of a check -> unit in its record."""


def _check(check: Check) -> dict[str, Any]:
    """Record of a check."""
    values = {"value": check.value, "at_most" if check.at_most else "at_least": check.limit}
    return {"what": check.name, **with_unit(SUFFIXES[check.unit], values), "passed": check.passed}


TRIAL: tuple[Quantity[tuple[float, float, float]], ...] = (
    Quantity("mold_radius_mm", "radius of the mold", lambda trial: 1 / trial[0]),
    Quantity("obtained_radius_mm", "radius of the obtained tube", lambda trial: 1 / trial[1]),
    Quantity("residual_percent", "deviation of the lost fraction from the model", lambda trial: trial[2]),
)
"""Quantities of a trial: curvatures of mold and tube, 1/m, and residual of the lost fraction."""


def _trials(c: Calibration) -> list[tuple[float, float, float]]:
    """Curvatures of mold and tube, 1/m, and residual of the lost fraction, for every trial."""
    return list(zip(*(x.tolist() for x in (c.mold_curvature, c.obtained_curvature, c.lost - c.fitted)), strict=True))


def _interval_text(interval: tuple[float, float] | None) -> str:
    """95 % interval of a fraction, as text; "" without one."""
    return "" if interval is None else f" (95 %: {interval[0] * 100:.3g} to {interval[1] * 100:.3g} %)"


def _radii(c: Calibration) -> list[float] | None:
    """Smallest and largest mold radius of the trials, m."""
    curvatures = c.springback.curvature_range
    return None if curvatures is None else [1 / max(curvatures), 1 / min(curvatures)]


CALIBRATION = described(
    Calibration,
    Quantity("trials", "the trials", _trials, of=TRIAL, text=lambda c: str(len(c.mold_curvature)), label="trials"),
    of_field(Calibration, "model", label="model", text="{model}"),
    Quantity("fraction_percent", "lost fraction of the curvature at small curvature", lambda c: c.springback.fraction,
             text=lambda c: f"{c.springback.fraction * 100:.3g} %{_interval_text(c.fraction_interval)}",
             label="lost at small curvature"),
    Quantity("slope_mm", "increase of the lost fraction with the mold curvature", lambda c: c.springback.slope,
             label="and per 1/m of curvature",
             text=lambda c: None if c.model != "linear" else
             f"{c.springback.slope * 100:.3g} %{_interval_text(c.slope_interval)}"),
    Quantity("shrinkage_percent", "fraction of the bend length lost on cooling",
             lambda c: c.springback.shrinkage),
    Quantity("radius_range_mm", "smallest and largest mold radius of the trials", _radii, digits=9, optional=True),
    "fraction_interval slope_interval",
    of_field(Calibration, "noise", label="scatter of one tube",
             text=lambda c: "unknown" if math.isnan(c.noise) else f"{c.noise * 100:.2g} %"),
    "remarks",
)  # fmt: skip


class CalibrationReport(Report[Calibration]):
    command = "mold calibrate"
    quantities = CALIBRATION
    file = "calibration.json"
    drawn = (("springback", "mold.plot_springback"),)

    def rows(self) -> list[tuple[str, str]]:
        """Rows (name, text) of the model, and of the radii that the smallest and largest molds of the trials yield."""
        back = self.answer.springback
        assert back.curvature_range is not None
        yields = [
            (f"mold radius {TO_MM / kappa:.4g} mm yields", f"{TO_MM / back.obtained(kappa):.4g} mm")
            # From the smallest radius up; a single curvature is both ends of its range.
            for kappa in sorted(set(back.curvature_range), reverse=True)
        ]
        return super().rows() + yields

    def title(self) -> str:
        return "spring-back"

    def save(self, directory: Path) -> list[Path]:
        """Write calibration.json and springback.yaml."""
        save_springback(self.answer, directory / "springback.yaml")
        fitted = {"trials": len(self.answer.mold_curvature), "lost_percent": 100 * self.answer.springback.fraction}
        passport = continue_passport(directory, "springback", **fitted)
        return [self.save_record(directory), directory / "springback.yaml", *passport]


MEASURED = described(
    MeasuredTube,
    Quantity("photo", "name of the picture", lambda m: m.photo.name),
    Quantity("radius_mm", "radius of the bend", label="radius", text=lambda m:
             f"{m.radius * TO_MM:.2f} mm (95 %: {m.interval[0] * TO_MM:.2f} to {m.interval[1] * TO_MM:.2f} mm)"),
    Quantity("interval_mm", "95 % interval of the radius"),
    Quantity("standard_error_mm", "standard error of the radius", form=".2g", label="standard error"),
    Quantity("errors", "contributions to the interval", of=described(RadiusErrors)),
    Quantity("bend_length_mm", "length of the bend", lambda m: m.arc.length, form=".4g", label="bend, length"),
    Quantity("bend_angle_deg", "angle of the bend", lambda m: m.angle, form=".4g", label="bend, angle"),
    Quantity("leads_mm", "straight parts at both ends", lambda m: m.arc.leads, form=".1f", label="straight parts"),
    Quantity("fades_mm", "lengths over which the curvature fades to them", lambda m: m.arc.fades, form=".1f",
             label="curvature fades over"),
    Quantity("deviation_um", "root mean square deviation of the centreline from the circle", lambda m: m.arc.rms,
             form=".0f", label="deviation from a circle"),
    Quantity("largest_deviation_um", "largest smooth deviation from the circle", lambda m: m.arc.largest),
    Quantity("tube_width_mm", "width of the tube in the picture", lambda m: m.trace.width, form=".2f",
             label="width of the tube"),
    Quantity("scale_from", "source of the scale: marks or resolution", lambda m: m.scale_source, text="{scale_from}",
             label="scale from"),
    Quantity("tilt_deg", "angle between the camera's axis and the normal of the sheet", lambda m: m.scale.tilt,
             form=".1f", label="tilt of the camera"),
    Quantity("pixel_um", "size of a pixel", lambda m: m.scale.pitch, form=".0f", label="pixel"),
    Quantity("mold_radius_mm", "radius of the mold", optional=True),
    Quantity("remarks", "remarks on the measurement"),
)  # fmt: skip


class MeasuredTubeReport(Report[MeasuredTube]):
    command = "mold measure"
    quantities = MEASURED
    file = "measurement.json"
    drawn = (("measurement", "tube_photo.plot_measured_tube"),)

    def title(self) -> str:
        return self.answer.photo.name

    def save(self, directory: Path) -> list[Path]:
        """Write measurement.json and, if the radius of the mold is known, add a row to trials.csv."""
        paths = [self.save_record(directory)]
        if self.answer.mold_radius is not None:
            paths.append(directory / "trials.csv")
            save_trial(self.answer, self.answer.mold_radius, paths[-1])
        radius, error = self.answer.radius, self.answer.standard_error
        of = {"source": self.answer.photo.name, "radius_mm": radius, "error_mm": error}
        return paths + continue_passport(directory, "measurements", **of)


RATING = described(
    MaterialRating,
    Quantity("material", "name of the material", lambda r: r.material.name),
    Quantity("suitable", "true if it is suitable"),
    Quantity("held", "true if the rig keeps the window with it", lambda r: r.plan is None or r.plan.feasible),
    Quantity("shortfall_K", "miss of the window with it"),
    "heat_drawn heat_flow heat",
    Quantity("energy_J", "energy drawn from the battery; null if the tube cannot be heated"),
    "leak",
    Quantity("limit_degC", "temperature limit of the material", lambda r: r.material.limit_temperature_degC),
    "limit_margin",
    Quantity("conductivity_W_per_m_K", "thermal conductivity", lambda r: r.material.conductivity),
    *within([of_field(MoldMaterial, name) for name in ("density", "heat_capacity")], lambda r: r.material),
    Quantity("resistivity_ohm_m", "electrical resistivity", lambda r: r.material.resistivity),
    *within([of_field(MoldMaterial, "price_class")], lambda r: r.material),
    "reasons",
    *within([of_field(MoldMaterial, "source")], lambda r: r.material),
)

RANKING = described(
    MoldRanking,
    Quantity("outer_diameter_mm", "outer diameter of the tube", lambda a: a.tube.outer_diameter),
    *within([of_field(Tube, "curved_length")], lambda a: a.tube),
    Quantity("set_degC", "set temperature", lambda a: a.heat.set_temperature - ZERO_CELSIUS),
    Quantity("hold_s", "hold time", lambda a: a.heat.hold_time),
    of_field(MoldRanking, "ratings", of=RATING),
)


class RankingReport(Report[MoldRanking]):
    command = "mold materials"
    quantities = RANKING
    file = "materials.json"

    def title(self) -> str:
        known = self.record()
        tube = f"a tube of {known['outer_diameter_mm']:g} mm, {known['curved_length_mm']:g} mm of it"
        return f"molds for {tube} at {known['set_degC']:g} degC for {known['hold_s']:g} s"

    def table(self) -> Group:
        """A row per material, then why."""
        ratings = self.answer.ratings
        cells = [
            (
                r.material.name,
                f"{r.heat_drawn:.0f}",
                "-" if r.energy is None else f"{r.energy * per_si('kJ'):.3g}",
                f"{r.material.limit_temperature_degC:.0f}",
                f"{r.leak:.1g}",
                r.material.price_class,
                "" if r.plan is None else "yes" if r.plan.feasible else "no",
                "yes" if r.suitable else "no",
            )
            for r in ratings
        ]
        columns = ("material", "draws J/m >", "battery kJ >", "limit degC >", "leak >", "price >", "held >", "suits >")
        reasons = [Text(f"{r.material.name}: {', '.join(r.reasons)}") for r in ratings]
        return Group(Text(self.title(), style="italic"), grid(columns, cells, key=True), *reasons)

    def pictures(self) -> dict[str, Drawing]:
        title = self.title().replace("degC", "°C")
        return {"materials": drawing("mold.plot_materials", self.answer.ratings, title=title)}


def _turned(get: Callable[[Cylinder], Any]) -> Callable[[Mandrel], Any]:
    """Value of a turned mandrel; None for a printed one."""
    return lambda m: get(m.body) if isinstance(m.body, Cylinder) else None


WOUND_TUBE: tuple[Quantity[Tube], ...] = (
    Quantity("curvature_per_m", "largest curvature of the tube"),
    Quantity("curved_length_mm", "curved length of the tube"),
)

MANDREL = described(
    Mandrel,
    "number",
    Quantity("made", "method, turned or printed", lambda m: "turned" if isinstance(m.body, Cylinder) else "printed",
             text="{made}", label="turned or printed"),
    Quantity("diameter_mm", "diameter of the cylinder", _turned(lambda b: 2 * b.radius), form=".4f", optional=True,
             label="cylinder, diameter"),
    Quantity("length_mm", "length of the cylinder", _turned(lambda b: b.length), form=".4g", optional=True,
             label="cylinder, length"),
    Quantity("helix_radius_mm", "radius of the helix", _turned(lambda b: b.helix_radius), form=".4f", optional=True,
             label="helix, radius"),
    Quantity("pitch_mm", "pitch of the helix", _turned(lambda b: b.pitch), form=".4f", optional=True,
             label="helix, pitch"),
    Quantity("handed", "hand of the helix", _turned(lambda b: b.handed), optional=True),
    Quantity("size_mm", "size of the block", lambda m: m.body.size if isinstance(m.body, Block) else None, form=".4g",
             optional=True, label="block"),
    "width",
    Quantity("bend_length_mm", "length of the bend", lambda m: m.held.curved_length, form=".5g", label="bend, length"),
    Quantity("curvature_per_m", "largest curvature of the groove", lambda m: m.held.curvature, form=".5g"),
    Quantity("strain_percent", "strain of the wound tube", lambda m: pressing_strain(m.tube, m.held.curvature),
             form=".3g", label="strain when wound in"),
    Quantity("stock_length_mm", "length of the tube blank", form=".4g", label="cut the tube to"),
    Quantity("predicted", "predicted tube", predict_wound_tube, of=WOUND_TUBE),
    "remarks",
)  # fmt: skip


class MandrelReport(Report[Mandrel]):
    command = "mold mandrel"
    quantities = MANDREL
    file = "mandrel.json"
    drawn = (("mandrel", "mold.plot_mandrel"),)

    def title(self) -> str:
        return f"mandrel of tube {self.answer.number}"

    def save(self, directory: Path) -> list[Path]:
        """Write mandrel.json, mandrel.stl and the sheet setup.pdf, for a turned mandrel also mandrel.csv and
        mandrel.nc.
        """
        from .plots.sheets import plot_setup_sheet

        paths = [self.save_record(directory), *write_mandrel(self.answer, directory)]
        plot_setup_sheet(self.answer, directory / "setup.pdf")
        return [*paths, directory / "setup.pdf"]


TUBE = described(
    TubeParts,
    "number",
    of_field(TubeParts, "mold", of=MOLD),
    of_field(TubeParts, "heating", of=HEATING),
    Quantity(
        "between_clamps_mm",
        "length of tube between the clamps, by the mold and by the heating",
        lambda part: {
            "mold": part.fabrication.groove.free_length * TO_MM,
            "heating": part.fabrication.heating.free_length * TO_MM,
        },
    ),
    Quantity("agreed", "true if mold and heating agree", lambda part: part.fabrication.agreed),
    Quantity("disagreement", "difference between them, as text", lambda part: part.fabrication.disagreement),
    Quantity("rounds", "number of rounds to agreement", lambda part: part.fabrication.rounds),
    Quantity("remarks", "remarks for making it", lambda part: part.fabrication.remarks),
)

FABRICATION = described(
    Fabrication,
    *SUCCESS,
    Quantity("robot", "name of the robot", lambda a: a.robot.name),
    of_field(Fabrication, "parts", of=TUBE),
    "left_out",
)


def _faults(part: TubeParts) -> list[str]:
    """Violated conditions of a tube, as text."""
    return [text for text in (HeatingReport(part.heating).fault, part.fabrication.disagreement) if text]


def _warned_mold(part: TubeParts) -> RobotMold:
    """Mold of a tube; its sheet says not to heat in it by a schedule that is not likely to succeed."""
    fault, mold = HeatingReport(part.heating).fault, part.mold.mold
    return (
        part.mold
        if not fault
        else replace(part.mold, mold=replace(mold, remarks=(f"do not heat by current yet: {fault}", *mold.remarks)))
    )


def _undecided(part: TubeParts) -> list[str]:
    """Remark on a probability that may be below the required one, by its interval."""
    success = part.heating.success
    if success is None or not success.sensor or not success.interval[0] < success.required <= success.interval[1]:
        return []
    return [
        f"whether {100 * success.required:.0f} % of rigs succeed is not decided by {success.samples}: more --samples"
    ]


def _of_tube(part: TubeParts) -> dict[str, Report[Any]]:
    """Reports on one tube by their folder."""
    reports: dict[str, Report[Any]] = {"mold": MoldReport(_warned_mold(part)), "heating": HeatingReport(part.heating)}
    return reports if part.led is None else reports | {"firmware": FeedbackReport(part.led)}


class FabricationReport(Report[Fabrication]):
    command = "fabricate"
    quantities = FABRICATION
    file = "fabrication.json"

    def table(self) -> Group:
        """A row for every tube, and the remarks."""
        cells, notes = [], []
        for part in self.answer.parts:
            plan, fabrication = part.heating.plan, part.fabrication
            max_duty, min_duty = hold_duties(plan)
            cells.append(
                (
                    str(part.number),
                    plan.verdict,
                    f"{plan.lowest:.0f} to {plan.highest:.0f} degC",
                    f"{max_duty} to {min_duty}",
                    f"{plan.hold_start:g} + {plan.spec.hold_time:g} s",
                    f"radius {fabrication.groove.radius * TO_MM:.2f} mm",
                    f"{plan.rig.mold.lead * TO_MM:.1f} mm",
                    f"{fabrication.groove.free_length * TO_MM:.1f} mm",
                )
            )
            disagreement = [] if fabrication.agreed else [fabrication.disagreement]
            of_tube = *fabrication.remarks, *_undecided(part), *plan.concerns, *disagreement
            notes += [f"tube {part.number}: {note}" for note in of_tube]
            notes += [f"tube {part.number}: what would help: {cure.change}" for cure in plan.cures]
        columns = ("tube", "window", "curved part", "duty", "heating", "mold", "leads", "between clamps")
        title = f"{self.title()}: molds and schedules"
        success = [f"tube {part.number}: {success_text(part.heating.success)}" for part in self.answer.parts]
        return Group(
            *(Text(line, style="bold") for line in success),
            grid(columns, cells, title=title),
            *remarks((*notes, *self.answer.left_out)),
        )

    def save(self, directory: Path) -> list[Path]:
        """Write robot.yaml, fabrication.json, parts.pdf, and files and folders of each tube in tube_N."""
        from .plots.clamps import plot_clamp_sheet
        from .plots.sheets import plot_fabrication_sheet, plot_parts_sheet

        save_robot(self.answer.robot, directory / "robot.yaml")
        paths = [directory / "robot.yaml", self.save_record(directory)]
        led = {part.number: part.led for part in self.answer.parts if part.led is not None}
        if led:
            paths.append(directory / "parts.pdf")
            parts = shared_parts({k: of_tube.plan for k, of_tube in led.items()}, next(iter(led.values())).wiring)
            plot_parts_sheet(parts, paths[-1], title=f"{self.answer.robot.name or 'robot'}, all tubes")
        for part in self.answer.parts:
            folder = directory / f"tube_{part.number}"
            for name, of_part in _of_tube(part).items():
                paths += of_part.save(folder / name)
            paths.append(folder / "rig.yaml")
            save_rig(part.rig, paths[-1], f"The rig with the mold of tube {part.number} as drawn.")
            title = f"{self.answer.robot.name or 'robot'}, tube {part.number}{part.mold.making}"
            made = replace(part.fabrication, heating=part.heating.plan)
            success, faults = success_text(part.heating.success), _faults(part)
            equal = [text for text in self.answer.left_out if f"equal to tube {part.number} " in text]
            notes = [*equal, *part.fabrication.remarks, *_undecided(part)]
            plot_fabrication_sheet(
                made, folder / "sheet.pdf", title=title, success=success, faults=faults, remarks=notes
            )
            paths.append(folder / "sheet.pdf")
            if part.fabrication.mold.spec.material.electrically_insulating:
                paths.append(folder / "clamps.pdf")
                plot_clamp_sheet(part.fabrication, paths[-1], title=title)
            tube, groove = part.fabrication.tube, part.fabrication.groove
            if not tube.pieces:  # one radius is that of one arc
                name, drawn = self.answer.robot.name or "", 1 / abs(tube.curvature)
                paths.append(
                    begin_passport(folder, robot=name, tube=part.number, drawn_radius=drawn, mold_radius=groove.radius)
                )
        return paths

    def pictures(self) -> dict[str, Drawing]:
        """Pictures of every mold, schedule and wiring, in the folders of the tubes."""
        return {
            f"tube_{part.number}/{folder}/{name}": draw
            for part in self.answer.parts
            for folder, of_part in _of_tube(part).items()
            for name, draw in of_part.pictures().items()
        }

    def conclude(self) -> None:
        """Raise SolveError if a tube misses its window, few random rigs succeed, or mold and heating disagree."""
        faults = [f"tube {part.number}: {fault}" for part in self.answer.parts for fault in _faults(part)]
        if faults:
            raise SolveError("; ".join(faults))
