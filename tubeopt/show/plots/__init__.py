"""Pictures of solutions: shapes, torsion, stability. Colour-blind safe, no display needed."""

from __future__ import annotations

from ..page import tube_colour
from .loads import (
    plot_bearing,
    plot_force_estimates,
    plot_friction_band,
    plot_hysteresis,
    plot_load_limits,
    plot_payload,
)
from .maps import plot_branch, plot_energy_maps, plot_stability_map
from .path import animate_path, plot_path, plot_snap
from .shape import plot_equilibria, plot_shape, plot_shapes, plot_torsion, plot_torsions
from .snap_in_time import animate_snap, plot_snap_in_time
from .style import save_figure

__all__ = [
    "animate_path",
    "animate_snap",
    "plot_bearing",
    "plot_branch",
    "plot_energy_maps",
    "plot_equilibria",
    "plot_force_estimates",
    "plot_friction_band",
    "plot_hysteresis",
    "plot_load_limits",
    "plot_path",
    "plot_payload",
    "plot_shape",
    "plot_shapes",
    "plot_snap",
    "plot_snap_in_time",
    "plot_stability_map",
    "plot_torsion",
    "plot_torsions",
    "save_figure",
    "tube_colour",
]
