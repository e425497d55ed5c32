"""What is said and saved about a stability map."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from ..files.files import atomic_write
from ..runs.stability_studies import RobotMap
from .report import report, two_columns
from .words import MM, degrees, millimetres


@dataclass(frozen=True)
class RobotMapReport:
    """What is said and saved about a stability map."""

    answer: RobotMap

    def record(self) -> dict[str, Any]:
        """The answer as JSON: what the map says in numbers, and the snap boundary."""
        found = self.answer.map
        snapped, nearest = found.snaps > 0, self._nearest()
        return {
            "robot": self.answer.robot.name,
            "translations_mm": (self.answer.translations * MM).tolist(),
            "tubes": [tube + 1 for tube in found.tubes],
            "samples": len(found.angles),
            "directions": len(found.boundary),
            "least_margin": float(found.margin.min()),
            "least_margin_before_a_snap": None if snapped.all() else float(found.margin[~snapped].min()),
            "snapped_fraction": float(snapped.mean()),
            "most_snaps": int(found.snaps.max()),
            "nearest_snap_deg": None if nearest is None else np.degrees(nearest).tolist(),
            "boundary_deg": np.degrees(found.boundary).tolist(),
        }

    def _nearest(self) -> np.ndarray | None:
        """The snap that needs the least turning of the tube that turns more; None without snaps."""
        boundary = self.answer.map.boundary
        boundary = boundary[np.isfinite(boundary).all(1)]
        return boundary[np.argmin(np.abs(boundary).max(1))] if len(boundary) else None

    def table(self) -> Table:
        """What the map says in numbers."""
        found, record = self.answer.map, self.record()
        i, j = record["tubes"]
        nearest = self._nearest()
        snapping = int(np.isfinite(found.boundary).all(1).sum())
        rows = [
            ("axes", f"rotations of tubes {i} and {j} from -180 to 180 deg, {len(found.angles)} points each"),
            ("translations", millimetres(self.answer.translations)),
            ("least margin", f"{record['least_margin']:.3f}"),
            ("reached after a snap", f"{100 * record['snapped_fraction']:.1f} % of the map"),
            ("snaps on the way", f"in {snapping} of {len(found.boundary)} directions"),
        ]
        if nearest is not None:
            rows.append(("the nearest snap", f"at {degrees(nearest, '.6f')}"))
        return two_columns(f"{self.answer.robot.name or 'robot'}: stability map", rows)

    def save(self, directory: Path) -> list[Path]:
        """Write map.npz: the fields of `StabilityMap` and the translations, in SI."""
        found = self.answer.map
        path = directory / "map.npz"
        with atomic_write(path) as temporary:
            np.savez(
                temporary,
                tubes=np.array(found.tubes),
                angles=found.angles,
                margin=found.margin,
                snaps=found.snaps,
                boundary=found.boundary,
                translations=self.answer.translations,
            )
        return [path]

    def draw(self, directory: Path) -> list[Path]:
        """Write stability_map.png."""
        from .plots import plot_stability_map  # Matplotlib takes longer to load than a solve

        path = directory / "stability_map.png"
        with atomic_write(path) as temporary:
            plot_stability_map(self.answer.map, temporary)
        return [path]


@report.register
def _(answer: RobotMap) -> RobotMapReport:
    return RobotMapReport(answer)
