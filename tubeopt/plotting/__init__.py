"""Pictures of solutions: shapes in space and torsion along the arm. Colour-blind safe, no display needed."""

from __future__ import annotations

from .shape import draw_shape, plot_shape
from .style import save_figure, tube_colour
from .torsion import draw_torsion, plot_torsion

__all__ = ["draw_shape", "draw_torsion", "plot_shape", "plot_torsion", "save_figure", "tube_colour"]
