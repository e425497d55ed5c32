"""A mesh over the sections of an arm, on each piece of which theta is one polynomial, and integrals over it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...physics.certificate import coupling_rate_function
from ...robots.assembly import Assembly
from ...robots.lengthwise import CrossSections
from ...typing import Array, Index, Mask
from .buffered import mapped
from .tableau import Tableau, tableau

# Gauss collocation of degree 6 has order 12: twice as long elements have errors up to 4,000 times as large.
WAVES_PER_ELEMENT = 0.75
"""Largest sqrt(c) h of an element, c being the greatest stiffness of the torsional coupling: with Gauss points of
degree 6 the error of theta then stays near 1e-10 rad, so that refinement is the exception."""

BEND_PER_PIECE = 1.0
"""Largest bend (rad) of a piece, for the integration of the shape."""


TWIST_PER_PIECE = 0.75
"""Largest natural twist (rad) of a tube along a piece, and of two against each other: it turns the curvature of the arm
in the Bishop frame, and how they pull at each other."""

DETAIL_PER_PIECE = 4.0
"""Largest polynomial degree of precurvature and stiffness along a piece."""

MOST_ROTATIONS = 5000
"""Rotations of tubes at collocation points that are solved for at most: their matrices are dense."""

KNOWN = 2.0
"""How many times as many pieces there are where nothing is unknown and bends turn: a helix then is one to 1e-12 m."""

# Gauss points lie inside the section: at its ends the tubes of two sections meet.
SAMPLES = (np.polynomial.legendre.leggauss(8)[0] + 1) / 2
"""Fractions of a section where coupling and curvature of tubes made of pieces are looked at."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """Pieces of an arm, base to tip: elements of coupled sections, and the other sections as a whole.

    Attributes:
        tableau: collocation points of every element.
        start, length: (p,) arc length of each piece, m.
        section: (p,) the section that the piece is a part of.
        collocated: (p,) whether it carries collocation points; torsion is linear in arc length where it does not.
    """

    tableau: Tableau
    start: Array
    length: Array
    section: NDArray[np.intp]
    collocated: Mask

    def places(self, arc_length: Array) -> tuple[Index, Array]:
        """The pieces in which arc lengths lie, and how far inside each, 0 to 1; beyond the ends the nearest place."""
        piece = np.clip(np.searchsorted(self.start, arc_length, side="right") - 1, 0, len(self.start) - 1)
        return piece, np.clip((arc_length - self.start[piece]) / self.length[piece], 0.0, 1.0)

    def interpolated(self, values: Array, arc_length: Array, *, integrals: int = 0) -> Array:
        """(S, k) at arc lengths (S,): the polynomials through values at the collocation points that all pieces would
        have (P, K, k); or how often integrated from where a piece begins, as if it had length 1."""
        piece, x = self.places(arc_length)
        inner = values.reshape(len(self.start), self.tableau.degree, -1)[piece]
        return np.asarray(np.einsum("ak,aki->ai", self.tableau.lagrange(x, integrals=integrals), inner))


def _rate(stiffness: Array, moment: Array, torsional_stiffness: Array) -> Array:
    """(m,) bound sqrt(c) of the fastest growth or oscillation of torsion, 1/m, in cross-sections with kb_i, m_i (m, n)
    and kt (n,) or (m, n)."""
    count, n = stiffness.shape
    return mapped(coupling_rate_function(n), count)(stiffness, moment, torsional_stiffness)[0][:, 0].copy()


def needs(assembly: Assembly) -> tuple[Array, ...]:
    """Of sections (m,): coupling rate, largest curvature, pieces for twist and detail of tubes made of pieces, least
    sum of kb, and largest |m_i| / kt_i."""
    if assembly.even:
        here = assembly.of_sections(np.arange(assembly.n_sections))
        rate = _rate(here.stiffness, here.moment, assembly.torsional_stiffness)
        steepest = (np.abs(assembly.curvature) * assembly.curved).max(1, initial=0.0)
        pull = (np.abs(here.moment) / assembly.torsional_stiffness).max(1, initial=0.0)
        return rate, steepest, np.zeros(1), np.maximum(here.stiffness.sum(1), 1e-300), pull
    table, count = assembly.lengthwise, len(SAMPLES)
    assert table is not None
    s = (assembly.start[:, None] + assembly.length[:, None] * SAMPLES).ravel()
    here = assembly.cross_sections(s, s)
    rate = _rate(here.stiffness, here.moment, here.torsional_stiffness).reshape(-1, count).max(1, initial=0.0)
    # Where no tube is, kb = 0 and m = 0: the quotient is to be 0.
    own = here.moment / np.maximum(here.stiffness, 1e-300)
    steepest = own.max(1, initial=0.0).reshape(-1, count).max(1, initial=0.0)
    panel, tube = table.panel(s[:, None] + assembly.transmission), np.arange(assembly.n_tubes)
    # A straight tube may be twisted as it likes: nobody sees it.
    there, bent = here.stiffness > 0, here.moment > 0
    each = np.maximum(
        there * table.detail[tube, panel] / DETAIL_PER_PIECE, bent * table.twist[tube, panel] / TWIST_PER_PIECE
    )
    # How fast bends turn against one another.
    turning = np.where(bent, here.twist, -np.inf).max(1, initial=-np.inf) - np.where(bent, here.twist, np.inf).min(1)
    finest = np.maximum(each.max(1, initial=0.0), np.maximum(turning, 0.0) / TWIST_PER_PIECE)
    finest = finest.reshape(-1, count).max(1, initial=0.0) * assembly.length
    pull = (here.moment / here.torsional_stiffness).max(1)
    return rate, steepest, finest, here.stiffness.sum(1).reshape(-1, count).min(1), pull.reshape(-1, count).max(1)


def piece_counts(assembly: Assembly, refinement: int = 0) -> NDArray[np.intp]:
    """(m,) pieces per section, short enough for coupling and bend, each split in two `refinement` times."""
    rate, steepest, finest, *_ = needs(assembly)
    waves, bend = rate * assembly.length / WAVES_PER_ELEMENT, steepest * assembly.length / BEND_PER_PIECE
    shape = np.maximum(bend, finest)
    shape = np.where(~assembly.coupled & (finest > 0), KNOWN * shape, shape)
    need = np.maximum(waves, shape)
    # 1e-9 is round-off: a section of exactly one length stays in one piece.
    pieces: NDArray[np.intp] = np.maximum(1, np.ceil(need - 1e-9)).astype(np.intp) * 2**refinement
    pieces[need <= 0] = 1
    return pieces


LOADED_WAVES = 0.5
"""The same of what bends under load: the margin, close to 1 where loads are small, then is right to 1e-8."""


def loaded_counts(assembly: Assembly, force: float, moment: float) -> NDArray[np.intp]:
    """(m,) pieces per section of a loaded arm.

    A force of at most `force`, N, acts on its cross-sections, and the moment `moment`, N m, on its tip. Bending under a
    force n varies at the rate sqrt(n / K). Its curvature is at most twice this rate, as in an elastica. It is also at
    most that under a lever as long as the arm.
    """
    rate, natural, finest, stiffness, pull = needs(assembly)
    # Elastica: K u^2 / 2 + n.t is constant along the arm, so that u^2 <= 4 n / K.
    fast = np.sqrt(force / stiffness)
    # The bound of an elastica and that of a lever both apply; a moment at the tip adds its own bend.
    bent = np.minimum(2 * fast, force * assembly.total_length / stiffness) + moment / stiffness
    # Torsion under a bend u varies at the rate sqrt(|m_i| u / kt_i), as a pendulum under gravity.
    waves = np.maximum(np.maximum(rate, fast), np.sqrt(pull * bent)) / LOADED_WAVES
    need = np.maximum(np.maximum(waves, (natural + bent) / BEND_PER_PIECE) * assembly.length, finest)
    pieces = np.ceil(need - 1e-9)
    return np.asarray(np.maximum(1, pieces).astype(np.intp))


def loaded_mesh(assembly: Assembly, pieces: NDArray[np.intp], *, family: str = "gauss", degree: int = 6) -> Mesh:
    """Mesh with collocation points in all pieces: a loaded arm also bends where its tubes are straight."""
    everywhere = np.ones(assembly.n_sections, dtype=bool)
    return _mesh(assembly, pieces, everywhere, tableau(family, degree))


def make_mesh(
    assembly: Assembly, pieces: NDArray[np.intp] | None = None, *, family: str = "gauss", degree: int = 6
) -> Mesh:
    """Mesh with the given number of pieces per section (by default `piece_counts`)."""
    counts = piece_counts(assembly) if pieces is None else pieces
    return _mesh(assembly, counts, assembly.coupled, tableau(family, degree))


def _mesh(assembly: Assembly, counts: NDArray[np.intp], collocated: Mask, rule: Tableau) -> Mesh:
    """Mesh with `counts` (m,) pieces in the sections; those marked in `collocated` (m,) have collocation points."""
    # Only coupled sections have unknown rotations, all of which share one dense matrix.
    unknown = int(counts[assembly.coupled].sum()) * rule.degree * assembly.n_tubes
    if max(unknown, int(counts.sum())) > MOST_ROTATIONS:
        raise InputError(
            f"the tubes vary so quickly along them that {counts.sum()} pieces of the arm with {unknown} unknown "
            f"rotations would have to be solved; there may be {MOST_ROTATIONS}: are units right, and are tables smooth?"
        )
    section = np.repeat(np.arange(assembly.n_sections), counts)
    rank = np.arange(len(section)) - np.repeat(np.cumsum(counts) - counts, counts)
    length = (assembly.length / counts)[section]
    return Mesh(
        tableau=rule,
        start=assembly.start[section] + rank * length,
        length=length,
        section=section,
        collocated=collocated[section],
    )


# --- What a couple on a tube at one place turns at another: integrals, collocated -------------------------------------

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
