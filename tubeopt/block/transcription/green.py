"""What a couple on a tube at one place of an arm turns at another: integrals over a mesh, collocated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...robots.assembly import Assembly
from ...robots.lengthwise import CrossSections
from ...typing import Array, Index
from .mesh import Mesh
from .tableau import Tableau

INWARDS = 1e-6
"""How far towards the middle of a piece one looks for the cross-section at its ends, where it may jump."""


@dataclass(frozen=True, eq=False)
class Compliant:
    """The tubes of an assembly on a mesh.

    Attributes:
        sections: (P K, n) the cross-sections at the points that all pieces would have.
        rate: (P, K, n) 1 / kt there.
        transmission: (n,) int ds / kt from where each tube is held to the plate.
    """

    sections: CrossSections
    rate: Array
    transmission: Array


def compliant(assembly: Assembly, mesh: Mesh) -> Compliant:
    """The tubes of an assembly on a mesh."""
    sections = sections_at(assembly, mesh, mesh.tableau.nodes)
    rate = 1 / sections.torsional_stiffness.reshape(len(mesh.length), mesh.tableau.degree, assembly.n_tubes)
    return Compliant(sections, rate, assembly.compliant(assembly.transmission))


def sections_at(assembly: Assembly, mesh: Mesh, x: Array) -> CrossSections:
    """(P X, n) cross-sections at fractions x (X,) of every piece of a mesh."""
    if assembly.even:
        return assembly.of_sections(np.repeat(mesh.section, len(x)))
    # Cross-sections jump where pieces meet: values at an end belong to the side of this piece.
    s, inside = (mesh.start[:, None] + mesh.length[:, None] * at for at in (x, x + INWARDS * (0.5 - x)))
    return assembly.cross_sections(s.ravel(), inside.ravel())


def reach(mesh: Mesh, here: Compliant) -> Array:
    """(P + 1, n) int ds / kt from where each tube is held to where the pieces begin, and to the tip."""
    gain = mesh.length[:, None] * np.einsum("k,pki->pi", mesh.tableau.weights, here.rate)
    return np.concatenate([np.zeros((1, gain.shape[1])), np.cumsum(gain, axis=0)]) + here.transmission


def ahead(mesh: Mesh, here: Compliant) -> Array:
    """(N, n) int ds / kt from where each tube is held to the collocation points, collocated."""
    chosen = mesh.collocated
    inside = mesh.tableau.matrix @ (mesh.length[chosen, None, None] * here.rate[chosen])
    out = reach(mesh, here)[:-1][chosen][:, None] + inside
    return np.asarray(out.reshape(-1, out.shape[-1]))


def green_of(t: Tableau, begin: Array, length: Array, rate: Array | None = None) -> Array:
    """(..., N, N) of tubes: int `rate` ds from where they are held to the nearer of two points, collocated, exact
    between elements of lengths (E,); `rate` (..., E, K) at the points, None is 1, and `begin` (..., E) the integral up
    to the elements: their arc length, where the rate is 1."""
    rate = np.ones((len(length), t.degree)) if rate is None else rate
    begin, length = begin[..., None], length[:, None]
    # int rate ds up to each point: begin of its element and what the matrix A adds inside.
    near = begin + length * (rate @ t.matrix.T)
    near = near.reshape(*near.shape[:-2], -1)
    # Between elements the kernel min(s, r) is smooth, so that its collocated value is exact.
    green = np.minimum(near[..., :, None], near[..., None, :])
    # Within one the kernel has a kink: A diag(rate / b) A' is symmetric, which L L' needs.
    within = begin[..., None] + length[..., None] * ((t.matrix * (rate / t.weights)[..., None, :]) @ t.matrix.T)
    for e in range(len(length)):
        block = slice(e * t.degree, (e + 1) * t.degree)
        green[..., block, block] = within[..., e, :, :]
    return green


def integrals(mesh: Mesh, elements: Index) -> tuple[Array, Array]:
    """(N, N) integration over the collocated elements from the base to each point, and from each point to the tip."""
    k, count = mesh.tableau.degree, len(elements)
    length = np.repeat(mesh.length[elements], k)
    whole = np.tile(mesh.tableau.weights, count) * length
    element = np.repeat(np.arange(count), k)
    before, same = element[None, :] < element[:, None], element[None, :] == element[:, None]
    within = np.tile(mesh.tableau.matrix, (count, count)) * length
    # Whole elements before a point count with their weights b, its own one with the row of A.
    up_to = np.where(same, within, before * whole)
    return up_to, whole - up_to
