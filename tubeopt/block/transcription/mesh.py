"""A mesh over the sections of an arm: on each piece theta is one polynomial."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...physics.certificate import coupling_rate_function
from ...robots.assembly import Assembly
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
    bent = np.minimum(2 * fast, force * assembly.total_length / stiffness) + moment / stiffness
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
