"""What is said and saved about a stability map."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..files.files import save_arrays
from ..runs.stability_studies import RobotMap
from ..typing import Array
from .quantities import Quantity, line
from .report import Drawing, Report, drawing
from .words import degrees


def _nearest(a: RobotMap) -> Array | None:
    """The snap that needs the least turning of the tube that turns more; None without snaps."""
    boundary = a.map.boundary
    boundary = boundary[np.isfinite(boundary).all(1)]
    return boundary[np.argmin(np.abs(boundary).max(1))] if len(boundary) else None


def _least_before(a: RobotMap) -> float | None:
    snapped = a.map.snaps > 0
    return None if snapped.all() else float(a.map.margin[~snapped].min())


def _snapping_fraction(a: RobotMap) -> float:
    """Part of all directions; each stands for those that are closer to it than to its neighbours."""
    angles = a.map.directions
    wide = np.roll(angles, -1) - np.roll(angles, 1)
    wide[[0, -1]] += 2 * np.pi
    return float(wide @ np.isfinite(a.map.boundary).all(1)) / (4 * np.pi)


def _nearest_words(a: RobotMap) -> str | None:
    nearest = _nearest(a)
    return None if nearest is None else f"at {degrees(nearest, '.6f')}"


MAP: tuple[Quantity[RobotMap], ...] = (
    Quantity("robot", "name of the robot", lambda a: a.robot.name),
    line("axes", "rotations of tubes {tubes[0]} and {tubes[1]} from -180 to 180 deg, {samples} points each"),
    Quantity("translations_mm", "translations", form=".9g"),
    Quantity("tubes", "the two tubes that turn, from 1", lambda a: [tube + 1 for tube in a.map.tubes]),
    Quantity("samples", "points per axis", lambda a: len(a.map.angles)),
    Quantity("directions", "directions in which the first snap is looked for", lambda a: len(a.map.boundary)),
    Quantity("least_margin", "least margin", lambda a: a.map.margin.min(), form=".3f"),
    Quantity("least_margin_before_a_snap", "least margin of what is reached without a snap", _least_before),
    Quantity("snapped_fraction", "part of the map that is reached after a snap", lambda a: (a.map.snaps > 0).mean(),
             label="reached after a snap", words=lambda a: f"{100 * (a.map.snaps > 0).mean():.1f} % of the map"),
    Quantity("most_snaps", "most snaps on the way to a point", lambda a: a.map.snaps.max()),
    Quantity("snapping_fraction", "part of all directions from home in which a snap is met", _snapping_fraction,
             label="snaps on the way", words=lambda a: f"in {100 * _snapping_fraction(a):.1f} % of all directions"),
    Quantity("nearest_snap_deg", "the snap that needs the least turning", _nearest, label="the nearest snap",
             words=_nearest_words),
    Quantity("directions_deg", "from the axis of the first tube", lambda a: a.map.directions),
    Quantity("boundary_deg", "rotations of the first snap in every direction", lambda a: a.map.boundary),
)  # fmt: skip


class RobotMapReport(Report[RobotMap]):
    """What is said and saved about a stability map."""

    command = "stability-map"
    quantities = MAP

    def title(self) -> str:
        """The robot's name."""
        return f"{self.answer.robot.name or 'robot'}: stability map"

    def save(self, directory: Path) -> list[Path]:
        """Write map.npz: the fields of `StabilityMap` and the translations, in SI."""
        found = self.answer.map
        fields = {
            name: getattr(found, name)
            for name in ("tubes", "angles", "margin", "snaps", "directions", "boundary", "approach")
        }
        return [save_arrays(directory / "map.npz", translations=self.answer.translations, **fields)]

    def pictures(self) -> dict[str, Drawing]:
        """The map."""
        from .plots import plot_stability_map  # Matplotlib takes longer to load than a solve

        return {"stability_map": drawing(plot_stability_map, self.answer.map, title=self.answer.robot.name)}
