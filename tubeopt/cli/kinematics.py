"""`tubeopt fk`: the shape that a robot takes at given joint values."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table

from ..equilibrium.file import save_equilibrium
from ..equilibrium.kinematics import METHODS
from ..equilibrium.result import Equilibrium, Verification
from ..files.checked import check
from ..files.files import atomic_write
from ..files.units import parse_number
from ..runs.study_file import ForwardKinematicsStudy
from ..show.load_words import load_record, load_rows
from ..show.report import present, report, two_columns
from ..show.words import margin_in_words, told
from ..typing import Array
from .options import (
    GravityOption,
    JsonOption,
    LoadOption,
    OutOption,
    PlotOption,
    RobotArgument,
    RotationsOption,
    TipForceOption,
    TipMomentOption,
    TranslationsOption,
    load_of,
    numbers,
)

FLAGS = {
    "robot": "",
    "rotations_deg": "--rotations-deg",
    "translations_mm": "--translations-mm",
    "method": "--method",
    "tolerance_rad": "--tolerance-rad",
}
"""What the keys of the study are called on the command line."""


def fk(
    robot: RobotArgument,
    rotations_deg: RotationsOption = None,
    translations_mm: TranslationsOption = None,
    method: Annotated[str, typer.Option(help=f"How to solve: {', '.join(METHODS)}.")] = METHODS[0],
    tolerance_rad: Annotated[
        str, typer.Option("--tolerance-rad", "--tolerance", metavar="RAD", help="Largest error of the tubes' angles.")
    ] = "1e-8",
    tip_force_mN: TipForceOption = None,
    tip_moment_mN_m: TipMomentOption = None,
    gravity_m_per_s2: GravityOption = None,
    load: LoadOption = None,
    verify: Annotated[bool, typer.Option("--verify", help="Compare with an adaptive re-integration.")] = False,
    plot: PlotOption = False,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Forward kinematics: the stable shape at given joint values, with its margin to snapping."""
    flags: dict[str, Any] = {
        "kind": "forward_kinematics",
        "robot": robot,
        "rotations_deg": numbers(rotations_deg),
        "translations_mm": numbers(translations_mm),
        "load": load_of(load, tip_force_mN, tip_moment_mN_m, gravity_m_per_s2),
        "method": method,
        "tolerance_rad": parse_number(tolerance_rad),
        "verify": verify,
    }
    study = check(ForwardKinematicsStudy, flags, "", names=FLAGS)
    present(report(study.run()), out=out, as_json=as_json, plot=plot)


@dataclass(frozen=True)
class EquilibriumReport:
    """What is said and saved about an equilibrium."""

    equilibrium: Equilibrium

    def record(self) -> dict[str, Any]:
        """The answer as JSON: joint values, tip, margin, energy, errors, cost."""
        e = self.equilibrium
        return {
            "robot": e.robot.name,
            "rotations_deg": np.degrees(e.rotations).tolist(),
            "translations_mm": (e.translations * 1e3).tolist(),
            "status": e.status.name,
            "stable": e.stable,
            "tip_position_mm": (e.tip_position * 1e3).tolist(),
            "tip_direction": e.tip_rotation[:, 2].tolist(),
            "tip_rotations_deg": np.degrees(e.tip_rotations).tolist(),
            "margin": told(e.margin),
            "energy_mJ": e.energy * 1e3,
            "load": load_record(e),
            "residual_rad": e.residual,
            "mesh_error_rad": e.mesh_error,
            "tip_error_mm": e.tip_error * 1e3,
            "verification": _verification(e.verification) if e.verification else None,
            "statistics": asdict(e.statistics),
        }

    def table(self) -> Table:
        """The answer as a table."""
        e = self.equilibrium
        rows = [
            ("rotations", f"{_row(np.degrees(e.rotations), '.6g')} deg"),
            ("translations", f"{_row(e.translations * 1e3, '.6g')} mm"),
            ("tip position", f"{_row(e.tip_position * 1e3, '.4f')} mm"),
            ("pointing along", _row(e.tip_rotation[:, 2], ".4f")),
            ("rotations at the tips", f"{_row(np.degrees(e.tip_rotations), '.4f')} deg"),
            ("margin", margin_in_words(e.margin)),
            ("elastic energy", f"{e.energy * 1e3:.4f} mJ"),
            *load_rows(e),
            ("residual", f"{e.residual:.1e} rad"),
            ("estimated error", f"{e.mesh_error:.1e} rad along the tubes, {e.tip_error * 1e3:.1e} mm at the tip"),
        ]
        if e.verification:
            v = e.verification
            rows.append(("re-integration differs", f"{v.tip_position * 1e3:.1e} mm at the tip, {v.rotation:.1e} rad"))
        s = e.statistics
        rows.append(("solved", f"in {s.seconds * 1e3:.2f} ms by {s.method}, {s.iterations} iterations, from {s.start}"))
        return two_columns(e.robot.name or "robot", rows)

    def save(self, directory: Path) -> list[Path]:
        """Write result.json and arrays.npz."""
        return save_equilibrium(self.equilibrium, directory)

    def draw(self, directory: Path) -> list[Path]:
        """Write shape.png and torsion.png."""
        from ..show.plots import plot_shape, plot_torsion  # Matplotlib takes longer to load than a solve

        pictures = {directory / "shape.png": plot_shape, directory / "torsion.png": plot_torsion}
        for path, plot in pictures.items():
            with atomic_write(path) as temporary:
                plot(self.equilibrium, temporary)
        return list(pictures)


@report.register
def _(answer: Equilibrium) -> EquilibriumReport:
    return EquilibriumReport(answer)


def _verification(v: Verification) -> dict[str, float]:
    return {
        "tip_position_mm": v.tip_position * 1e3,
        "tip_rotation_rad": v.tip_rotation,
        "rotation_rad": v.rotation,
        "end_torsion_rad_per_m": v.end_torsion,
        "base_rotation_rad": v.base_rotation,
    }


def _row(values: Array, form: str) -> str:
    return ", ".join(format(round(value, 12) + 0.0, form) for value in values)
