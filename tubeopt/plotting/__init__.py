"""Pictures of solutions: shapes in space and torsion along the arm. Colour-blind safe, no display needed."""

from __future__ import annotations

from .shape import plot_shape, plot_shapes
from .style import save_figure, tube_colour
from .torsion import plot_torsion, plot_torsions

__all__ = ["plot_shape", "plot_shapes", "plot_torsion", "plot_torsions", "save_figure", "tube_colour"]
