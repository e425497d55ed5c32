"""The questions as their files have them, and in SI."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from .model import Array, Robot

DATA = Path(__file__).parent / "data"

MM = 1e-3
"""m."""

KINDS = ("inverse", "plan", "design")

CLEARANCE, MARGIN = 0.2 * MM, 0.05
"""What every answer keeps: distance of the arm from the wall, m, and margin."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A way that the arm stays in: the union of balls whose centres and radii go linearly along K segments; with none,
    all of space.   starts, ends: (K, 3), radii: (K, 2), m."""

    name: str
    starts: Array
    ends: Array
    radii: Array

    @property
    def free(self) -> bool:
        """Whether there is no wall."""
        return not len(self.radii)

    def depth(self, points: Array) -> Array:
        """(...) depth of points (..., 3) in the ball in which they lie deepest, m; negative outside."""
        best = np.full(points.shape[:-1], np.inf if self.free else -np.inf)
        for a, b, (r, q) in zip(self.starts, self.ends, self.radii, strict=True):
            along, length = b - a, float(np.linalg.norm(b - a))
            if abs(q - r) >= length:  # one ball holds the other
                best = np.maximum(best, max(r, q) - np.linalg.norm(points - (a if r > q else b), axis=-1))
                continue
            axis, slope = along / length, (q - r) / length
            away = points - a
            s = away @ axis
            aside = np.linalg.norm(away - s[..., None] * axis, axis=-1)
            t = np.clip(s + aside * slope / np.sqrt(1 - slope**2), 0.0, length)
            best = np.maximum(best, r + slope * t - np.hypot(aside, s - t))
        return best


def _read(name: str) -> Any:
    return json.loads((DATA / name).read_text(encoding="utf-8"))


def robot_of(name: str, row: dict[str, list[float]]) -> Robot:
    """A robot as the file has it, in SI."""
    lengths = ("outer_diameter", "inner_diameter", "straight_length", "curved_length")
    mm = {each: np.array(row[f"{each}_mm"]) * MM for each in lengths}
    stiff = {each: np.array(row[f"{each}_N_mm2"]) * MM**2 for each in ("bending_stiffness", "torsional_stiffness")}
    return Robot(name, **mm, curvature=np.array(row["curvature_per_m"], dtype=float), **stiff)


def scene_of(name: str, rows: list[list[float]]) -> Scene:
    """A scene as the file has it: of every segment its start, its end, and two radii, mm."""
    table = np.array(rows, dtype=float).reshape(-1, 8) * MM
    return Scene(name, table[:, :3], table[:, 3:6], table[:, 6:])


@cache
def robots() -> dict[str, Robot]:
    """All robots by name."""
    return {name: robot_of(name, row) for name, row in _read("robots.json").items()}


@cache
def scenes() -> dict[str, Scene]:
    """All scenes by name."""
    return {name: scene_of(name, rows) for name, rows in _read("scenes.json").items()}


def questions(*kinds: str) -> Iterator[dict[str, Any]]:
    """All questions of some kinds, as the files have them."""
    for kind in kinds:
        yield from _read(f"{kind}.json")


def withdrawn(robot: Robot) -> Array:
    """(n,) places at which the tubes of a plan are held in the beginning, m: they end 2 mm before the plate, and every
    next inner one 1 mm farther; all rotations are 0."""
    return np.asarray((2.0 + np.arange(robot.n)[::-1]) * MM - robot.length)
