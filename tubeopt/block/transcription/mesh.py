"""Mesh over the sections of an arm, with theta as one polynomial on each element, and integrals over it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...physics.certificate import coupling_rate_function
from ...robots.assembly import Assembly
from ...robots.lengthwise import CrossSections
from ...typing import Array, Index, Mask
from .buffered import mapped
from .tableau import Tableau, tableau

# Gauss collocation of degree 6 has order 12: doubling the length of an element multiplies the error by up to 4,000.
WAVES_PER_ELEMENT = 0.75
"""Largest sqrt(c) h of an element of length h, c being the largest stiffness of the torsional coupling.

With Gauss points of degree 6 the error of theta then is near 1e-10 rad, so that refinement is rare."""

BEND_PER_ELEMENT = 1.0
"""Largest bend (rad) of an element, for the integration of the shape."""


TWIST_PER_ELEMENT = 0.75
"""Largest natural twist (rad) along an element, of a tube and between two tubes.

Natural twist rotates the curvature of the arm in the Bishop frame, and the coupling of tubes."""

DETAIL_PER_ELEMENT = 4.0
"""Largest polynomial degree of precurvature and stiffness along an element."""

MAX_ROTATIONS = 5000
"""Maximum number of unknown rotations at collocation points: their matrices are dense."""

KNOWN = 2.0
"""Refinement factor of uncoupled sections with natural twist: the position of a helix is then accurate to 1e-12 m."""

# Gauss points lie inside the section: at its ends the tubes of two sections meet.
SAMPLES = (np.polynomial.legendre.leggauss(8)[0] + 1) / 2
"""Samples in a section of coupling and curvature of tubes made of pieces, as fractions of its length."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """Elements of an arm, base to tip: elements of coupled sections, and the other sections as a whole.

    Attributes:
        tableau: collocation points of every element.
        start, length: arc length (P,) at which each element begins, and its length, m.
        section: section (P,) of each element.
        collocated: True (P,) for elements with collocation points; on the others torsion is linear in arc length.
    """

    tableau: Tableau
    start: Array
    length: Array
    section: NDArray[np.intp]
    collocated: Mask

    def locate(self, arc_length: Array) -> tuple[Index, Array]:
        """Elements that contain arc lengths, and fractions (0 to 1) inside each.

        Arc lengths beyond the ends have the element and fraction of the nearest point.
        """
        element = np.clip(np.searchsorted(self.start, arc_length, side="right") - 1, 0, len(self.start) - 1)
        return element, np.clip((arc_length - self.start[element]) / self.length[element], 0.0, 1.0)

    def interpolated(self, values: Array, arc_length: Array, *, integrals: int = 0) -> Array:
        """Values (S, k) at arc lengths (S,) of the polynomials through values (P, K, k) at the points of every element.

        With `integrals` the polynomials are integrated that often from the start of an element, as if it had length 1.
        """
        element, x = self.locate(arc_length)
        inner = values.reshape(len(self.start), self.tableau.degree, -1)[element]
        return np.asarray(np.einsum("ak,aki->ai", self.tableau.lagrange(x, integrals=integrals), inner))


def _rate(stiffness: Array, moment: Array, torsional_stiffness: Array) -> Array:
    """Bound sqrt(c) (m,) on the rate of torsion, 1/m, in cross-sections with kb, m (m, n) and kt (n,) or (m, n)."""
    count, n = stiffness.shape
    return mapped(coupling_rate_function(n), count)(stiffness, moment, torsional_stiffness)[0][:, 0].copy()


class SectionNeeds(NamedTuple):
    """Quantities (m,) that determine how many elements each section needs."""

    rate: Array
    """Bound on the rate of torsion, 1/m."""
    curvature: Array
    """Largest precurvature, 1/m."""
    twist_elements: Array
    """Number of elements for natural twist and detail of tubes made of pieces."""
    stiffness: Array
    """Smallest sum of kb, N m^2."""
    moment_ratio: Array
    """Largest |m| / kt of a tube, 1/m."""

    @staticmethod
    def of_even(stiffness: Array, moment: Array, torsional_stiffness: Array, sheath: float = 0.0) -> SectionNeeds:
        """Needs of tubes that are even along sections, with kb, m (m, n), kt (n,), and the kb of a sheath, N m^2."""
        return SectionNeeds(
            rate=_rate(stiffness, moment, torsional_stiffness),
            curvature=(np.abs(moment) / np.maximum(stiffness, 1e-300)).max(1, initial=0.0),
            twist_elements=np.zeros(1),
            stiffness=np.maximum(stiffness.sum(1) + sheath, 1e-300),
            moment_ratio=(np.abs(moment) / torsional_stiffness).max(1, initial=0.0),
        )

    def unloaded(self, length: Array) -> Array:
        """Fractional numbers (m,) of elements for coupling and bend of sections of lengths (m,), m."""
        return np.maximum(self.rate * length / WAVES_PER_ELEMENT, self.curvature * length / BEND_PER_ELEMENT)

    def loaded(self, length: Array, total: float, force: float, moment: float) -> Array:
        """The same under a load on an arm with a total length, m.

        Args:
            force: largest force on a cross-section, N.
            moment: moment at the tip, N m.
        """
        # Bending under a force n varies at the rate sqrt(n / K).
        rate = np.sqrt(force / self.stiffness)
        # Elastica: K u^2 / 2 + n.t is constant along the arm, so that u^2 <= 4 n / K. The curvature is also at most
        # that by a lever as long as the arm. A moment at the tip adds its own curvature.
        curvature = np.minimum(2 * rate, force * total / self.stiffness) + moment / self.stiffness
        # Torsion at a curvature u varies at the rate sqrt(|m| u / kt), as a pendulum under gravity.
        waves = np.maximum(np.maximum(self.rate, rate), np.sqrt(self.moment_ratio * curvature)) / LOADED_WAVES
        bend = (self.curvature + curvature) / BEND_PER_ELEMENT
        return np.asarray(np.maximum(waves, bend) * length)


def section_needs(assembly: Assembly) -> SectionNeeds:
    """Quantities that determine the number of elements of each section."""
    if assembly.even:
        sections = assembly.of_sections(np.arange(assembly.n_sections))
        return SectionNeeds.of_even(sections.stiffness, sections.moment, assembly.torsional_stiffness)
    table, count = assembly.lengthwise, len(SAMPLES)
    assert table is not None
    s = (assembly.start[:, None] + assembly.length[:, None] * SAMPLES).ravel()
    sections = assembly.cross_sections(s, s)

    def largest(values: Array) -> Array:
        """Maximum (m,) over the samples of each section."""
        return np.asarray(values.reshape(-1, count).max(1, initial=0.0))

    # An absent tube has kb = m = 0: its precurvature is to be 0.
    precurvature = sections.moment / np.maximum(sections.stiffness, 1e-300)
    panel, tube = table.panel(s[:, None] + assembly.transmission), np.arange(assembly.n_tubes)
    # Twist of a straight tube has no effect, so it needs no refinement.
    present, curved = sections.stiffness > 0, sections.moment > 0
    per_length = np.maximum(
        present * table.detail[tube, panel] / DETAIL_PER_ELEMENT, curved * table.twist[tube, panel] / TWIST_PER_ELEMENT
    ).max(1, initial=0.0)
    # Difference of natural twist between curved tubes.
    fastest = np.where(curved, sections.twist, -np.inf).max(1, initial=-np.inf)
    difference = fastest - np.where(curved, sections.twist, np.inf).min(1)
    per_length = np.maximum(per_length, np.maximum(difference, 0.0) / TWIST_PER_ELEMENT)
    return SectionNeeds(
        rate=largest(_rate(sections.stiffness, sections.moment, sections.torsional_stiffness)),
        curvature=largest(precurvature.max(1, initial=0.0)),
        twist_elements=largest(per_length) * assembly.length,
        stiffness=sections.stiffness.sum(1).reshape(-1, count).min(1),
        moment_ratio=largest((sections.moment / sections.torsional_stiffness).max(1)),
    )


def element_counts(assembly: Assembly, refinement: int = 0) -> NDArray[np.intp]:
    """Number of elements (m,) per section, short enough for coupling and bend, each halved `refinement` times."""
    needs = section_needs(assembly)
    known = np.where(~assembly.coupled & (needs.twist_elements > 0), KNOWN, 1.0)
    need = known * np.maximum(needs.unloaded(assembly.length), needs.twist_elements)
    return np.where(need > 0, whole_elements(need) * 2**refinement, 1)


def whole_elements(need: Array) -> NDArray[np.intp]:
    """Numbers (m,) of elements, at least one each, for fractional numbers (m,)."""
    # 1e-9 is round-off: a section that needs exactly one element gets one.
    return np.asarray(np.maximum(1, np.ceil(need - 1e-9)), dtype=np.intp)


LOADED_WAVES = 0.5
"""Largest sqrt(c) h of an element under load: margins, close to 1 under small loads, are then accurate to 1e-8."""


def loaded_counts(assembly: Assembly, force: float, moment: float) -> NDArray[np.intp]:
    """Number of elements (m,) per section of a loaded arm.

    Args:
        force: largest force on a cross-section, N.  moment: moment at the tip, N m.
    """
    needs = section_needs(assembly)
    need = needs.loaded(assembly.length, assembly.total_length, force, moment)
    return whole_elements(np.maximum(need, needs.twist_elements))


def loaded_mesh(assembly: Assembly, elements: NDArray[np.intp], *, family: str = "gauss", degree: int = 6) -> Mesh:
    """Mesh with collocation points on all elements, since a load also bends straight tubes."""
    everywhere = np.ones(assembly.n_sections, dtype=bool)
    return _mesh(assembly, elements, everywhere, tableau(family, degree))


def make_mesh(
    assembly: Assembly, elements: NDArray[np.intp] | None = None, *, family: str = "gauss", degree: int = 6
) -> Mesh:
    """Mesh with the given number of elements per section (by default `element_counts`)."""
    counts = element_counts(assembly) if elements is None else elements
    return _mesh(assembly, counts, assembly.coupled, tableau(family, degree))


def _mesh(assembly: Assembly, counts: NDArray[np.intp], collocated: Mask, rule: Tableau) -> Mesh:
    """Mesh with `counts` (m,) elements per section; sections marked in `collocated` (m,) have collocation points."""
    # Only coupled sections have unknown rotations, all of which share one dense matrix.
    unknown = int(counts[assembly.coupled].sum()) * rule.degree * assembly.n_tubes
    if max(unknown, int(counts.sum())) > MAX_ROTATIONS:
        raise InputError(
            f"the tubes vary so quickly along them that {counts.sum()} elements of the arm with {unknown} unknown "
            f"rotations would have to be solved; there may be {MAX_ROTATIONS}: are units right, and are tables smooth?"
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


# --- Torsional compliance: rotations at one point by a couple at another, collocated ----------------------------------

INWARDS = 1e-6
"""Offset, relative to half an element, of the cross-section read for its end: properties may jump there."""


@dataclass(frozen=True, eq=False)
class Compliant:
    """Torsional compliance of the tubes of an assembly on a mesh.

    Attributes:
        sections: cross-sections (P K, n) at the points of all elements, collocated or not.
        rate: 1 / kt (P, K, n) at these points.
        transmission: int ds / kt (n,) from clamp to plate.
    """

    sections: CrossSections
    rate: Array
    transmission: Array


def compliant(assembly: Assembly, mesh: Mesh) -> Compliant:
    """Torsional compliance of the tubes of an assembly on a mesh."""
    sections = sections_at(assembly, mesh, mesh.tableau.nodes)
    rate = 1 / sections.torsional_stiffness.reshape(len(mesh.length), mesh.tableau.degree, assembly.n_tubes)
    return Compliant(sections, rate, assembly.compliant(assembly.transmission))


def sections_at(assembly: Assembly, mesh: Mesh, x: Array) -> CrossSections:
    """Cross-sections (P X, n) at fractions x (X,) of every element of a mesh."""
    if assembly.even:
        return assembly.of_sections(np.repeat(mesh.section, len(x)))
    # Cross-sections may jump where elements meet: values at an end are those of this element.
    s, inside = (mesh.start[:, None] + mesh.length[:, None] * at for at in (x, x + INWARDS * (0.5 - x)))
    return assembly.cross_sections(s.ravel(), inside.ravel())


def reach(mesh: Mesh, compliance: Compliant) -> Array:
    """(P + 1, n) compliances int ds / kt from the clamp of each tube to the start of every element, and to the tip."""
    gain = mesh.length[:, None] * np.einsum("k,pki->pi", mesh.tableau.weights, compliance.rate)
    return np.concatenate([np.zeros((1, gain.shape[1])), np.cumsum(gain, axis=0)]) + compliance.transmission


def ahead(mesh: Mesh, compliance: Compliant) -> Array:
    """Compliances int ds / kt (N, n) from the clamp of each tube to the collocation points, collocated."""
    chosen = mesh.collocated
    inside = mesh.tableau.matrix @ (mesh.length[chosen, None, None] * compliance.rate[chosen])
    out = reach(mesh, compliance)[:-1][chosen][:, None] + inside
    return np.asarray(out.reshape(-1, out.shape[-1]))


def green_of(t: Tableau, start: Array, length: Array, rate: Array | None = None) -> Array:
    """Green's functions (..., N, N) of tubes: int `rate` ds from the clamp to the nearer of two points, collocated.

    They are exact between points of different elements.

    Args:
        start: integral (..., E) up to the elements; with the rate 1 their arc length.
        length: lengths (E,) of the elements.
        rate: (..., E, K) at the points; None is 1.
    """
    rate = np.ones((len(length), t.degree)) if rate is None else rate
    start, length = start[..., None], length[:, None]
    # int rate ds up to each point: begin of its element and what the matrix A adds inside.
    at_points = start + length * (rate @ t.matrix.T)
    at_points = at_points.reshape(*at_points.shape[:-2], -1)
    # Between elements the kernel min(s, r) is smooth, so that its collocated value is exact.
    green = np.minimum(at_points[..., :, None], at_points[..., None, :])
    # Within one the kernel has a kink: A diag(rate / b) A' is symmetric, which L L' needs.
    within = start[..., None] + length[..., None] * ((t.matrix * (rate / t.weights)[..., None, :]) @ t.matrix.T)
    for e in range(len(length)):
        block = slice(e * t.degree, (e + 1) * t.degree)
        green[..., block, block] = within[..., e, :, :]
    return green


def integrals(mesh: Mesh, elements: Index) -> tuple[Array, Array]:
    """Matrices (N, N) that integrate over the collocated elements: from the base to each point, from it to the tip."""
    k, count = mesh.tableau.degree, len(elements)
    length = np.repeat(mesh.length[elements], k)
    total = np.tile(mesh.tableau.weights, count) * length
    element = np.repeat(np.arange(count), k)
    before, same = element[None, :] < element[:, None], element[None, :] == element[:, None]
    within = np.tile(mesh.tableau.matrix, (count, count)) * length
    # Whole elements before a point count with their weights b, its own one with the row of A.
    up_to = np.where(same, within, before * total)
    return up_to, total - up_to
