"""A mesh over the sections of an arm: pieces on which theta is one polynomial."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..robots.assembly import Assembly
from ..typing import Array, Mask
from .tableau import Tableau, tableau

WAVES_PER_ELEMENT = 0.75
"""Largest sqrt(c) h of an element, c being the greatest stiffness of the torsional coupling: with Gauss points of
degree 6 the error of theta then stays near 1e-10 rad, so that refinement is the exception."""

BEND_PER_PIECE = 1.0
"""Largest bend (rad) of a piece, for the integration of the shape."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """Pieces of an arm, base to tip: elements of coupled sections, and the other sections as a whole.

    Attributes:
        tableau: collocation points of every element.
        start, length: (p,) arc length of each piece, m.
        section: (p,) the section of which it is a part.
        collocated: (p,) whether it carries collocation points; torsion is linear in arc length where it does not.
    """

    tableau: Tableau
    start: Array
    length: Array
    section: NDArray[np.intp]
    collocated: Mask


def coupling_rate(assembly: Assembly) -> Array:
    """(m,) bound sqrt(c) of the fastest growth or oscillation of torsion in each section, 1/m.

    For two tubes c = (1 + nu) kappa_1 kappa_2 when their nu are equal (Dupont et al. 2010); for more, the row sums of
    the Jacobi matrix bound its eigenvalues.
    """
    moment = np.abs(assembly.bending_stiffness * assembly.curvature) * assembly.curved
    total = (assembly.bending_stiffness * assembly.present).sum(1)
    pairs = moment[:, :, None] * moment[:, None, :] / np.maximum(total, 1e-300)[:, None, None]
    pairs[:, np.arange(assembly.n_tubes), np.arange(assembly.n_tubes)] = 0.0
    each = pairs / assembly.torsional_stiffness[:, None] + pairs / assembly.torsional_stiffness
    rate: Array = np.sqrt(each.sum(2).max(1, initial=0.0))
    return rate


def piece_counts(assembly: Assembly, refinement: int = 0) -> NDArray[np.intp]:
    """(m,) pieces per section, short enough for coupling and bend, each split in two `refinement` times."""
    waves = coupling_rate(assembly) * assembly.length / WAVES_PER_ELEMENT
    bend = (np.abs(assembly.curvature) * assembly.curved).max(1, initial=0.0) * assembly.length / BEND_PER_PIECE
    pieces: NDArray[np.intp] = np.maximum(1, np.ceil(np.maximum(waves, bend) - 1e-9)).astype(np.intp) * 2**refinement
    pieces[~assembly.curved.any(1)] = 1
    return pieces


LOADED_WAVES = 0.5
"""The same of what bends under load: the margin, close to 1 where loads are small, then is right to 1e-8."""


def loaded_counts(assembly: Assembly, force: float, moment: float, refinement: int = 0) -> NDArray[np.intp]:
    """(m,) pieces per section of an arm on whose cross-sections at most `force`, N, and at its tip `moment`, N m, act.

    Bending under a force n is as fast as sqrt(n / K), and bends an arm by no more than that of an elastica, twice this
    rate, or of a lever as long as the arm.
    """
    stiffness = np.maximum((assembly.bending_stiffness * assembly.present).sum(1), 1e-300)
    fast = np.sqrt(force / stiffness)
    bent = np.minimum(2 * fast, force * assembly.total_length / stiffness) + moment / stiffness
    pull = np.abs(assembly.bending_stiffness * assembly.curvature) * assembly.curved
    twisted = np.sqrt((pull * bent[:, None] / assembly.torsional_stiffness).max(1, initial=0.0))
    waves = np.maximum(np.maximum(coupling_rate(assembly), fast), twisted) / LOADED_WAVES
    natural = (np.abs(assembly.curvature) * assembly.curved).max(1, initial=0.0)
    pieces = np.ceil(np.maximum(waves, (natural + bent) / BEND_PER_PIECE) * assembly.length - 1e-9)
    return np.asarray(np.maximum(1, pieces).astype(np.intp) * 2**refinement)


def loaded_mesh(assembly: Assembly, pieces: NDArray[np.intp], *, family: str = "gauss", degree: int = 6) -> Mesh:
    """Mesh whose pieces all have collocation points: what is loaded bends, be it curved or straight."""
    mesh = make_mesh(assembly, pieces, family=family, degree=degree)
    return replace(mesh, collocated=np.ones(len(mesh.length), dtype=bool))


def make_mesh(
    assembly: Assembly, pieces: NDArray[np.intp] | None = None, *, family: str = "gauss", degree: int = 6
) -> Mesh:
    """Mesh with the given number of pieces per section (by default `piece_counts`)."""
    counts = piece_counts(assembly) if pieces is None else pieces
    section = np.repeat(np.arange(assembly.n_sections), counts)
    rank = np.arange(len(section)) - np.repeat(np.cumsum(counts) - counts, counts)
    length = (assembly.length / counts)[section]
    return Mesh(
        tableau=tableau(family, degree),
        start=assembly.start[section] + rank * length,
        length=length,
        section=section,
        collocated=assembly.coupled[section],
    )
