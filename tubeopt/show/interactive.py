"""The shape of a robot in a notebook, to be turned and zoomed with the mouse: by plotly, which an extra brings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..equilibrium.result import Equilibrium
from ..errors import extra, instance
from ..files.units import TO_MM
from .arm_surfaces import Part, plate_part, plate_radius, robot_parts

if TYPE_CHECKING:
    import plotly.graph_objects

GHOST_OPACITY = 0.3
DIGITS = 3
"""Decimals of the coordinates, in mm: what is kept in a notebook is small."""


def show_in_3d(
    equilibrium: Equilibrium, *, ghosts: Sequence[Equilibrium] = (), height: int = 480
) -> plotly.graph_objects.Figure:
    """The robot on its plate as a scene that is turned with the mouse; a notebook shows it.

    Args:
        ghosts: further shapes, drawn translucent.
        height: of the scene, pixels.

    Raises:
        InputError: plotly is not installed.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> pose = tubeopt.forward_kinematics(robot, [0.0, 1.0, 2.0])
        >>> figure = tubeopt.show_in_3d(pose, height=300)
        >>> figure.layout.height
        300
    """
    instance("equilibrium", equilibrium, Equilibrium)
    library = extra("plotly.graph_objects", "notebook", "scenes in a notebook")
    parts = [plate_part(plate_radius(equilibrium)), *robot_parts(equilibrium)]
    meshes = [_mesh(library, part, part.opacity) for part in parts]
    meshes += [_mesh(library, part, GHOST_OPACITY) for ghost in ghosts for part in robot_parts(ghost)]
    axes = {f"{axis}axis": {"title": {"text": f"{axis} (mm)"}} for axis in "xyz"}
    scene = {**axes, "aspectmode": "data"}
    name = equilibrium.robot.name or "robot"
    layout = {"scene": scene, "height": height, "margin": {"l": 0, "r": 0, "t": 30, "b": 0}, "title": {"text": name}}
    figure: plotly.graph_objects.Figure = library.Figure(meshes, layout)
    return figure


def _mesh(library: Any, part: Part, opacity: float) -> Any:
    x, y, z = np.round(part.surface.vertices * TO_MM, DIGITS).astype(np.float32).T
    i, j, k = part.surface.faces.T
    colour = f"rgb{part.colour}"
    return library.Mesh3d(x=x, y=y, z=z, i=i, j=j, k=k, color=colour, opacity=opacity, name=part.name, hoverinfo="name")
