"""Surfaces as facets: tubes of true diameter along a centreline, plates, and how light falls on them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ...bodies.frames import Frame
from ...typing import Array

if TYPE_CHECKING:
    from ...equilibrium.result import Equilibrium


@dataclass(frozen=True, eq=False)
class Mesh:
    """k four-sided facets: corners (k, 4, 3) m, outward normals (k, 3), colours (k, 4) as RGBA in [0, 1].

    `lift` (k,) m: how much nearer to whom it faces a facet counts when facets are sorted by depth, so that a surface
    stays outside of what touches it from within; None is 0.
    """

    corners: Array
    normals: Array
    colours: Array
    lift: Array | None = None

    def depth(self, towards_viewer: Array) -> Array:
        """(k,) m: by which to sort facets that are seen from `towards_viewer` (3,), far ones first."""
        depth: Array = self.corners.mean(1) @ towards_viewer
        return depth if self.lift is None else depth + self.lift * (self.normals @ towards_viewer)

    def placed(self, frame: Frame) -> Mesh:
        """The same facets, which stand in a frame, as that has them in which it is given."""
        return Mesh(frame.placed(self.corners), self.normals @ frame.axes.T, self.colours, self.lift)

    @staticmethod
    def join(parts: list[Mesh]) -> Mesh:
        """All facets of `parts` as one mesh, so that they can be sorted by depth together."""
        return Mesh(
            np.concatenate([np.empty((0, 4, 3)), *(part.corners for part in parts)]),
            np.concatenate([np.empty((0, 3)), *(part.normals for part in parts)]),
            np.concatenate([np.empty((0, 4)), *(part.colours for part in parts)]),
            np.concatenate([np.empty(0), *(np.zeros(len(p.corners)) if p.lift is None else p.lift for p in parts)]),
        )

    def lit(self, towards_viewer: Array, towards_light: Array) -> Array:
        """(k, 4) colours under a light from `towards_light` (unit, (3,)), seen from `towards_viewer`."""
        facing = np.where(self.normals @ towards_viewer < 0, -1.0, 1.0)
        cosine = facing * (self.normals @ towards_light)
        half = towards_viewer + towards_light
        gloss = np.clip(facing * (self.normals @ (half / np.linalg.norm(half))), 0, 1) ** 30
        shade = 0.45 + 0.55 * (0.5 + 0.5 * cosine)
        colours = self.colours.copy()
        colours[:, :3] = np.clip(colours[:, :3] * shade[:, None], 0, 1)
        colours[:, :3] += 0.35 * gloss[:, None] * (1 - colours[:, :3])
        return colours


class Centreline:
    """The centreline of an equilibrium at any arc length: cubic between the points, exact in position and tangent."""

    def __init__(self, equilibrium: Equilibrium) -> None:
        s, keep = np.unique(equilibrium.arc_length, return_index=True)
        self.length = float(s[-1])
        frame = equilibrium.frame[keep]
        self._position = scipy.interpolate.CubicHermiteSpline(s, equilibrium.position[keep], frame[:, :, 2])
        self._across = scipy.interpolate.interp1d(s, frame[:, :, 0], axis=0)

    def position(self, s: ArrayLike) -> Array:
        """(k, 3) points at arc lengths `s` (k,), m."""
        points: Array = self._position(np.clip(s, 0, self.length))
        return points

    def axes(self, s: Array) -> tuple[Array, Array, Array]:
        """Unit vectors of the cross-section at `s` (k,), x and y, and the tangent: (k, 3) each."""
        s = np.clip(s, 0, self.length)
        tangent = _unit(self._position.derivative()(s))
        across = self._across(s)
        across = _unit(across - (across * tangent).sum(1, keepdims=True) * tangent)
        return across, np.cross(tangent, across), tangent


def tube_mesh(
    line: Centreline, s: Array, radius: float, colour: Array, *, offset: ArrayLike = (0.0, 0.0), sides: int = 24
) -> Mesh:
    """Surface of a tube of `radius` along `line` between the arc lengths `s` (k,), increasing.

    Args:
        offset: (2,) place of the tube's axis in the cross-section, m.
        colour: (4,) RGBA.
        sides: facets around the tube.
    """
    x, y, _ = line.axes(s)
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    outward = np.cos(angle)[:, None] * x[:, None] + np.sin(angle)[:, None] * y[:, None]
    axis = line.position(s) + np.asarray(offset)[0] * x + np.asarray(offset)[1] * y
    corners = quads(axis[:, None] + radius * outward)
    middle = (angle[:-1] + angle[1:]) / 2
    normals = np.cos(middle)[:, None] * _mid(x)[:, None] + np.sin(middle)[:, None] * _mid(y)[:, None]
    return _mesh(corners, normals.reshape(-1, 3), colour)


def ring_mesh(
    line: Centreline,
    s: float,
    radii: tuple[float, float],
    colour: Array,
    *,
    offset: ArrayLike = (0.0, 0.0),
    sides: int = 24,
) -> Mesh:
    """Flat ring across `line` at arc length `s`, from the inner to the outer of `radii`, facing the tip."""
    x, y, tangent = line.axes(np.array([s]))
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    outward = np.cos(angle)[:, None] * x + np.sin(angle)[:, None] * y
    centre = line.position([s]) + np.asarray(offset)[0] * x + np.asarray(offset)[1] * y
    corners = quads(np.stack([centre + radius * outward for radius in radii]))
    return _mesh(corners, np.repeat(tangent, sides, axis=0), colour)


def plate_mesh(radius: float, thickness: float, colour: Array) -> Mesh:
    """A disc whose upper face lies at z = 0: the base plate, cut fine enough to be sorted by depth."""
    angle = np.linspace(0, 2 * np.pi, 121)
    circle = np.column_stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])
    top = quads(np.stack([r * circle for r in np.linspace(0, radius, 7)]))
    down = np.array([0, 0, -thickness])
    side = quads(np.stack([radius * circle, radius * circle + down]))
    side_normals = (circle[:-1] + circle[1:]) / 2
    return Mesh.join(
        [
            _mesh(top, np.tile([0.0, 0.0, 1.0], (len(top), 1)), colour),
            _mesh(top + down, np.tile([0.0, 0.0, -1.0], (len(top), 1)), colour),
            _mesh(side, side_normals, colour),
        ]
    )


def _mesh(corners: Array, normals: Array, colour: Array) -> Mesh:
    return Mesh(corners, normals, np.tile(colour, (len(corners), 1)))


def quads(grid: Array) -> Array:
    """Facets between neighbours of a grid of points (a, b, 3): ((a - 1)(b - 1), 4, 3)."""
    return np.stack([grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]], axis=2).reshape(-1, 4, 3)


def _mid(vectors: Array) -> Array:
    return _unit(vectors[:-1] + vectors[1:])


def _unit(vectors: Array) -> Array:
    unit: Array = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    return unit
