"""What is said and saved about molds, spring-back and mold materials."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Group
from rich.table import Table
from rich.text import Text

from ..files.files import write_text
from ..robots.materials import ZERO_CELSIUS
from ..robots.tubes import Tube
from ..runs.mold_file import save_springback, springback_to_dict
from ..shaping.mold.checks import Check
from ..shaping.mold.files import write_mold
from ..shaping.mold.heat import HeatSpec
from ..shaping.mold.holes import Hole
from ..shaping.mold.mold import Groove, Mold, predict_tube
from ..shaping.mold.ranking import MaterialRating
from ..shaping.mold.robot import RobotMold
from ..shaping.mold.springback import Calibration, Springback
from .report import report, to_text, two_columns

MM = 1e3


@dataclass(frozen=True)
class MoldReport:
    """What is said and saved about the mold for tubes of a robot."""

    answer: RobotMold

    @property
    def mold(self) -> Mold:
        """As planned."""
        return self.answer.mold

    def record(self) -> dict[str, Any]:
        """The answer as JSON: plates, a mapping per groove, holes, checks, remarks."""
        mold = self.mold
        return {
            "robot": self.answer.name,
            "material": mold.spec.material.name,
            "size_mm": [extent * MM for extent in mold.size],
            "thickness_mm": mold.spec.plate.thickness * MM,
            "lid_thickness_mm": mold.spec.plate.lid_thickness * MM,
            "base_volume_mm3": mold.base_volume * MM**3,
            "lid_volume_mm3": mold.lid_volume * MM**3,
            "springback": _springback(mold.spec.springback),
            "grooves": [self._groove(k) for k in range(len(mold.grooves))],
            "holes": [_hole(hole) for hole in mold.holes],
            "checks": [_check(check) for check in mold.checks],
            "remarks": [*self.answer.left_out, *mold.remarks],
        }

    def _groove(self, k: int) -> dict[str, Any]:
        groove = self.mold.grooves[k]
        predicted = predict_tube(self.mold, k)
        return (
            {"tube": self.answer.numbers[k]}
            | groove_record(groove)
            | {
                "predicted": {
                    "curvature_per_m": predicted.curvature,
                    "curved_length_mm": predicted.curved_length * MM,
                    "straight_length_mm": predicted.straight_length * MM,
                }
            }
        )

    def table(self) -> Group:
        """A row per property, a column per groove; then the remarks."""
        mold = self.mold
        size = " x ".join(f"{extent * MM:g}" for extent in mold.size)
        title = Text(f"{self.answer.name or 'robot'}: mold of {mold.spec.material.name}, {size} mm", style="italic")
        table = Table(box=None, padding=(0, 2, 0, 0))
        table.add_column("tube", style="bold", no_wrap=True)
        for number in self.answer.numbers:
            table.add_column(str(number), justify="right")
        records = [groove_record(groove) for groove in mold.grooves]
        for key, words in _ROWS.items():
            table.add_row(words, *(f"{record[key]:.4g}" for record in records))
        lines = [Text(f"remark: {line}", style="yellow") for line in (*self.answer.left_out, *mold.remarks)]
        return Group(title, table, *lines)

    def save(self, directory: Path) -> list[Path]:
        """Write mold.json, base and lid as DXF, SVG and STL, grooves.nc and the set-up sheet setup.pdf."""
        from .plots.mold import plot_setup_sheet

        record, sheet = directory / "mold.json", directory / "setup.pdf"
        write_text(record, to_text(self.record()))
        files = write_mold(self.mold, directory)
        plot_setup_sheet(self.mold, sheet, title=self.answer.name)
        return [record, *files, sheet]

    def draw(self, directory: Path) -> list[Path]:
        """Write mold.png."""
        from .plots.mold import plot_mold

        plot_mold(self.mold, directory / "mold.png")
        return [directory / "mold.png"]


_ROWS = {
    "wanted_radius_mm": "wanted radius (mm)",
    "mold_radius_mm": "mold radius (mm)",
    "bend_length_mm": "bend, length (mm)",
    "bend_angle_deg": "bend, angle (deg)",
    "width_mm": "groove, width (mm)",
    "depth_mm": "groove, depth (mm)",
    "end_mill_mm": "end mill (mm)",
    "strain_percent": "strain when pressed in (%)",
    "cold_length_mm": "cold end from the clamp (mm)",
    "growth_mm": "growth when hot (mm)",
    "travel_mm": "travel of the sliding clamp (mm)",
    "stock_length_mm": "cut the tube to (mm)",
    "extra_length_mm": "of which is trimmed (mm)",
}


def groove_record(groove: Groove) -> dict[str, Any]:
    """A groove as JSON; of a bend of many curvatures radii and curvature are those of its tightest place."""
    return {
        "wanted_radius_mm": MM / abs(groove.tube.curvature) if groove.tube.curvature else math.inf,
        "mold_radius_mm": groove.radius * MM,
        "mold_curvature_per_m": groove.curvature,
        "arcs": len(groove.centreline.bend),
        "bend_length_mm": groove.bend_length * MM,
        "bend_angle_deg": math.degrees(groove.bend_angle),
        "lead_in_mm": groove.centreline.lead_in.length * MM,
        "lead_out_mm": groove.centreline.lead_out.length * MM,
        "width_mm": groove.width * MM,
        "depth_mm": groove.depth * MM,
        "end_mill_mm": groove.mill.diameter * MM,
        "strain_percent": groove.strain * 100,
        "cold_length_mm": groove.cold.length * MM,
        "decay_length_mm": groove.cold.decay_length * MM,
        "loss_coefficient_W_per_m2_K": groove.cold.loss_coefficient,
        "gaps_mm": [gap * MM for gap in groove.gaps],
        "free_length_mm": groove.free_length * MM,
        "growth_mm": groove.growth * MM,
        "travel_mm": max(clamp.travel for clamp in groove.clamps) * MM,
        "stock_length_mm": groove.stock_length * MM,
        "extra_length_mm": groove.extra_length * MM,
        "bend_begins_mm": groove.before_bend * MM,
        "trim_proximal_mm": groove.trim[0] * MM,
        "trim_distal_mm": groove.trim[1] * MM,
        "clamps": [
            {
                "end": clamp.end,
                "face_mm": [x * MM for x in clamp.face],
                "direction": list(clamp.direction),
                "slides": clamp.slides,
            }
            for clamp in groove.clamps
        ],
        "vents": len(groove.vents),
    }


def _hole(hole: Hole) -> dict[str, Any]:
    return {"purpose": hole.purpose, "centre_mm": [x * MM for x in hole.centre], "diameter_mm": hole.diameter * MM}


def _springback(back: Springback) -> dict[str, Any]:
    """A spring-back with the keys of a mold file, as plain numbers."""
    data = springback_to_dict(back)
    return {key: [float(x) for x in value] if isinstance(value, list) else float(value) for key, value in data.items()}


_UNITS = {"m": ("_mm", MM), "1": ("_percent", 100.0), "K": ("_K", 1.0)}


def _check(check: Check) -> dict[str, Any]:
    suffix, factor = _UNITS[check.unit]
    limit = "at_most" if check.at_most else "at_least"
    return {
        "what": check.name,
        f"value{suffix}": check.value * factor,
        f"{limit}{suffix}": check.limit * factor,
        "passed": check.passed,
    }


@dataclass(frozen=True)
class CalibrationReport:
    """Spring-back fitted to trials."""

    calibration: Calibration

    def record(self) -> dict[str, Any]:
        """The answer as JSON: model, numbers with intervals, trials with residuals, remarks."""
        c = self.calibration
        trials = zip(c.mold_curvature.tolist(), c.obtained_curvature.tolist(), c.lost - c.fitted, strict=True)
        return {
            "model": c.model,
            **_springback(c.springback),
            "fraction_interval_percent": None
            if c.fraction_interval is None
            else [100 * x for x in c.fraction_interval],
            "slope_interval_mm": None if c.slope_interval is None else [MM * x for x in c.slope_interval],
            "noise_percent": 100 * c.noise,
            "trials": [
                {"mold_radius_mm": MM / k, "obtained_radius_mm": MM / o, "residual_percent": 100 * float(r)}
                for k, o, r in trials
            ],
            "remarks": list(c.remarks),
        }

    def table(self) -> Group:
        """The answer as a table, and the remarks."""
        c, back = self.calibration, self.calibration.springback
        rows = [
            ("trials", str(len(c.mold_curvature))),
            ("model", c.model),
            ("lost at small curvature", f"{back.fraction * 100:.3g} %{_within(c.fraction_interval, 100, ' %')}"),
        ]
        if c.model == "linear":
            rows.append(("and per 1/m of curvature", f"{back.slope * 100:.3g} %{_within(c.slope_interval, 100, ' %')}"))
        rows.append(("scatter of one tube", "unknown" if math.isnan(c.noise) else f"{c.noise * 100:.2g} %"))
        assert back.curvature_range is not None
        for kappa in sorted(set(back.curvature_range), reverse=True):
            wanted = back.obtained(kappa)
            rows.append((f"mold radius {MM / kappa:.4g} mm yields", f"{MM / wanted:.4g} mm"))
        lines = [Text(f"remark: {line}", style="yellow") for line in c.remarks]
        return Group(two_columns("spring-back", rows), *lines)

    def save(self, directory: Path) -> list[Path]:
        """Write calibration.json and springback.yaml."""
        paths = [directory / "calibration.json", directory / "springback.yaml"]
        write_text(paths[0], to_text(self.record()))
        save_springback(self.calibration, paths[1])
        return paths

    def draw(self, directory: Path) -> list[Path]:
        """Write springback.png."""
        from .plots.mold import plot_springback

        plot_springback(self.calibration, directory / "springback.png")
        return [directory / "springback.png"]


def _within(interval: tuple[float, float] | None, factor: float, unit: str) -> str:
    return "" if interval is None else f" (95 %: {interval[0] * factor:.3g} to {interval[1] * factor:.3g}{unit})"


@dataclass(frozen=True)
class MaterialsReport:
    """Mold materials for a tube, best first."""

    ratings: tuple[MaterialRating, ...]
    tube: Tube
    heat: HeatSpec

    def record(self) -> dict[str, Any]:
        """The answer as JSON: a mapping per material, best first."""
        return {
            "outer_diameter_mm": self.tube.outer_diameter * MM,
            "curved_length_mm": self.tube.curved_length * MM,
            "set_degC": self.heat.set_temperature - ZERO_CELSIUS,
            "hold_s": self.heat.hold_time,
            "materials": [_rating(rating) for rating in self.ratings],
        }

    def table(self) -> Group:
        """A row per material, then why."""
        degrees = self.heat.set_temperature - ZERO_CELSIUS
        tube = f"a tube of {self.tube.outer_diameter * MM:g} mm, {self.tube.curved_length * MM:g} mm of it"
        title = Text(f"molds for {tube} at {degrees:g} degC for {self.heat.hold_time:g} s", style="italic")
        table = Table(box=None, padding=(0, 2, 0, 0))
        table.add_column("material", style="bold", no_wrap=True)
        for name in ("draws J/m", "energy kJ", "limit degC", "leak", "price", "suits"):
            table.add_column(name, justify="right", no_wrap=True)
        for r in self.ratings:
            m = r.material
            limit, suits = f"{m.limit_temperature_degC:.0f}", "yes" if r.suitable else "no"
            table.add_row(
                m.name, f"{r.heat_drawn:.0f}", f"{r.energy / 1e3:.3g}", limit, f"{r.leak:.1g}", m.price_class, suits
            )
        return Group(title, table, *(Text(f"{r.material.name}: {', '.join(r.reasons)}") for r in self.ratings))

    def save(self, directory: Path) -> list[Path]:
        """Write materials.json."""
        write_text(directory / "materials.json", to_text(self.record()))
        return [directory / "materials.json"]

    def draw(self, directory: Path) -> list[Path]:
        """Write materials.png."""
        from .plots.mold import plot_materials

        plot_materials(self.ratings, directory / "materials.png")
        return [directory / "materials.png"]


def _rating(r: MaterialRating) -> dict[str, Any]:
    m = r.material
    return {
        "material": m.name,
        "suitable": r.suitable,
        "heat_drawn_J_per_m": r.heat_drawn,
        "heat_flow_W_per_m": r.heat_flow,
        "energy_J": r.energy,
        "leak": r.leak,
        "limit_degC": m.limit_temperature_degC,
        "limit_margin_K": r.limit_margin,
        "conductivity_W_per_m_K": m.conductivity,
        "density_kg_per_m3": m.density,
        "heat_capacity_J_per_kg_K": m.heat_capacity,
        "resistivity_ohm_m": m.resistivity,
        "price_class": m.price_class,
        "reasons": list(r.reasons),
        "source": m.source,
    }


@report.register
def _(answer: RobotMold) -> MoldReport:
    return MoldReport(answer)
