"""Surfaces as facets that are sorted by depth, and how light falls on them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from ...bodies.frames import Frame
from ...typing import Array, Mask
from ..arm_surfaces import Part
from ..surfaces import Surface


class Mesh(NamedTuple):
    """k four-sided facets: corners (k, 4, 3) m, outward normals (k, 3), colours (k, 4) as RGBA in [0, 1].

    `lift` (k,) m: how much nearer to whom it faces a facet counts when facets are sorted by depth, so that a surface
    stays outside of what touches it from within.
    """

    corners: Array
    normals: Array
    colours: Array
    lift: Array

    def depth(self, towards_viewer: Array) -> Array:
        """(k,) distance towards the viewer, m, to draw far facets first; `towards_viewer` (3,) points at the viewer."""
        depth: Array = self.corners.mean(1) @ towards_viewer
        return depth + self.lift * (self.normals @ towards_viewer)

    def placed(self, frame: Frame) -> Mesh:
        """The facets in the coordinates in which `frame` is given; here they are in those of the frame."""
        return Mesh(frame.placed(self.corners), self.normals @ frame.axes.T, self.colours, self.lift)

    def only(self, kept: Mask) -> Mesh:
        """Some of the facets: `kept` (k,), bool."""
        return Mesh(*(each[kept] for each in self))

    def in_sight(self, towards_viewer: Array) -> Mesh:
        """The facets of surfaces that enclose something, without those that its other side hides: opaque ones that turn
        away from who looks from `towards_viewer` (3,)."""
        return self.only((self.colours[:, 3] < 1) | (self.normals @ towards_viewer >= 0))

    @staticmethod
    def join(parts: list[Mesh]) -> Mesh:
        """All facets of `parts` as one mesh, so that they can be sorted by depth together."""
        nothing = Mesh(np.empty((0, 4, 3)), np.empty((0, 3)), np.empty((0, 4)), np.empty(0))
        return Mesh(*map(np.concatenate, zip(nothing, *parts, strict=True)))

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


def facets_of(surface: Surface, colour: Array, *, lift: float = 0.0, triangles: bool = False) -> Mesh:
    """A surface in a colour (4,) as RGBA: two of its triangles at a time are a facet; `triangles`, each for itself."""
    faces = surface.faces[:, [0, 1, 2, 2]] if triangles else surface.faces.reshape(-1, 6)[:, [0, 1, 2, 5]]
    corners = surface.vertices[faces]
    normal = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal /= np.where(length > 0, length, 1.0)
    return Mesh(corners, normal, np.tile(colour, (len(corners), 1)), np.full(len(corners), lift))


def mesh_of(parts: Iterable[Part], opacity: float = 1.0) -> Mesh:
    """Parts as one mesh, all as much more translucent."""
    colours = [(part, np.array([*(c / 255 for c in part.colour), part.opacity * opacity])) for part in parts]
    return Mesh.join([facets_of(part.surface, colour, lift=part.lift) for part, colour in colours])
