"""Whether segments of three equal tubes off the centreline can snap: a proof that not, and a closed form beyond which
so.

Each segment is one problem of three tubes (see `eccentric_bound`): inner segments do not act on it but by the stiffness
of their straight tubes, and in front of its own curved part an outer segment only changes how long its tubes are. The
robot cannot snap if no segment can.

*Proof.* A segment with transmissions lam_i (over the unit 1 / omega) cannot snap if R(X) < lam^-1. Outer segments
stretch them to lam + d cos(c), lam + d cos(c + 120 deg) and lam + d cos(c - 120 deg), with d at most D, the sum of
delta omega L over these segments. So tan(phi(X)) < 1 / lam_eff, lam_eff = lam + D/2 + (D^2/2) / (1 / (delta X) - lam),
is enough, and necessary where c is 0.

*Closed form.* Two tubes turned to c and the third to c + pi neither twist nor turn one another: an equilibrium at every
length, whose linearisation has constant coefficients. Where one of these is unstable, with segments further out and in
curving to one side, the joint rotations have more than one equilibrium, and the robot snaps on some way.

Both are told as a number that is positive where the robot is stable: the share of torsional stiffness that all tubes
could lose before the proof fails, or the untwisted shape is a fold.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy

from ..errors import InputError
from ..physics.certificate import PARAMETERS
from ..robots.assembly import ROUND_OFF, Assembly, assemble
from ..robots.robot import Robot
from ..typing import Array
from .eccentric_bound import DELTAS, cross_sections, longest

SHORT = 2e-9
"""Sections shorter than this (m) are tolerances of lengths: their effect is far below the room of the table."""

ALIKE = 1e-9
"""Relative difference up to which numbers of tubes count as equal."""

STEP = 1e-4
"""Relative step of the differences for derivatives: some intervals of the table are wider."""

DIRECTIONS = np.arange(12) * np.pi / 6
"""Directions c of the untwisted shapes that are looked at: the softest lie at 30 deg and every 60 deg from there."""


@dataclass(frozen=True)
class Segment:
    """Three equal tubes on one section, in the units of `eccentric_bound`.

    tubes: of the assembly, in the order of PLACES.   section: (start, end), m.
    rate: omega, 1/m.   delta: d m / K.   length: omega L.   transmission: omega times the mean length from where the
    tubes are held to the section.   outer: (delta, omega L) of the segments further out, with omega of this one.
    """

    tubes: tuple[int, int, int]
    section: tuple[float, float]
    rate: float
    delta: float
    length: float
    transmission: float
    outer: tuple[tuple[float, float], ...] = ()

    @property
    def spread(self) -> float:
        """Bound D of what the three transmissions differ by from their mean."""
        return sum(delta * length for delta, length in self.outer)


def segments_of(assembly: Assembly) -> tuple[Segment, ...] | None:
    """The segments of a robot, base to tip; None where it is not made of three equal tubes each, or curves too tightly
    for the table: then nothing is proved."""
    found: list[Segment] = []
    used: set[int] = set()
    for k in np.flatnonzero(assembly.curved.any(1) & (assembly.length > SHORT)):
        segment = _segment(assembly, int(k))
        if segment is None or used & set(segment.tubes):
            return None
        used |= set(segment.tubes)
        outer = tuple((other.delta, other.length / other.rate * segment.rate) for other in found)
        found.append(replace(segment, outer=outer))
    return tuple(found)


def _segment(assembly: Assembly, k: int) -> Segment | None:
    """What is curved on section k, where that is three equal tubes around others, if any, that are alike at each
    place."""
    tubes = np.flatnonzero(assembly.curved[k])
    if len(tubes) != 3:
        return None
    same = ("bending_stiffness", "torsional_stiffness", "curvature", "offset", "transmission")
    table = np.array([getattr(assembly, name)[tubes] for name in same])
    if (np.ptp(table, axis=1) > ALIKE * np.abs(table).max(1) + np.array([0, 0, 0, 0, ROUND_OFF])).any():
        return None
    kb, kt, curvature, offset, transmission = table[:, 0]
    turn = (assembly.offset_angle - assembly.offset_angle[tubes[0]]) / (2 * np.pi / 3)
    place = np.round(turn).astype(int) % 3
    there = assembly.present[k]
    off = np.abs(turn - np.round(turn)) > ALIKE
    if offset <= 0 or (there & (off | (np.abs(assembly.offset - offset) > ALIKE * offset))).any():
        return None
    total = np.bincount(place, weights=assembly.bending_stiffness * there, minlength=3)
    if len(set(place[tubes].tolist())) != 3 or np.ptp(total) > ALIKE * total.max():
        return None
    moment, whole = kb * abs(curvature), float(total.max())
    rate, delta = float(moment / np.sqrt(whole * kt)), float(offset * moment / total.min())
    if delta > DELTAS[-1]:
        return None
    first, second, third = (int(tubes[place[tubes] == p][0]) for p in range(3))
    start, length = float(assembly.start[k]), float(assembly.length[k])
    return Segment(
        tubes=(first, second, third),
        section=(start, start + length),
        rate=rate,
        delta=delta,
        length=rate * length,
        transmission=rate * (float(transmission) + start),
    )


def proved_margin(segment: Segment) -> float:
    """Share of torsional stiffness that the tubes may lose with the proof still holding; above 0 it holds as they
    are."""

    def excess(soft: float) -> float:
        x, lam, spread = (soft * part for part in (segment.length, segment.transmission, segment.spread))
        room = 1 / (segment.delta * x) - lam
        if room <= 0:
            return 1.0
        reach = lam + spread / 2 + spread**2 / 2 / room
        return x - longest(segment.delta, np.pi / 2 if reach <= 0 else np.arctan(1 / reach))

    highest = np.pi / 2 / segment.length  # no segment of the table is that long: `longest` stays below pi / 2
    return 1 - 1 / float(scipy.optimize.brentq(excess, 1e-9 * highest, highest, xtol=1e-14 * highest, rtol=1e-13)) ** 2


@dataclass(frozen=True)
class Untwisted:
    """The softest untwisted shape of a segment: the margin of that equilibrium, its direction c, and that of the
    segments further out, rad; of tubes that bend backwards, turned by pi."""

    segment: Segment
    margin: float
    direction: float
    outer_direction: float


def softest_untwisted(segment: Segment) -> Untwisted:
    """The softest of the shapes with one tube against two, by their exact linearisation."""
    count = len(DIRECTIONS)
    opposed = DIRECTIONS[:, None] + np.array([0.0, 0.0, np.pi])
    slope, g, _ = cross_sections(opposed, segment.delta)
    root = np.sqrt(g)
    # With y = sqrt(g) z the field is z'' = -A z, of a symmetric A.
    values, vectors = np.linalg.eigh(-root[:, :, None] * (slope + slope.swapaxes(1, 2)) / 2 * root[:, None, :])
    stretch = np.zeros((count, 3))
    for delta, length in segment.outer:
        stretch += length * (cross_sections(np.repeat(DIRECTIONS[:, None], 3, axis=1), delta)[1] - 1)
    if not segment.outer:
        stretch = stretch[:1]
    lever = np.sqrt(np.maximum(segment.transmission + stretch[:, None, :], 0.0)) / root

    def excess(soft: float) -> Array:
        """(outer, c) largest eigenvalue of what must be less than 1."""
        wave = soft * segment.length * np.sqrt(np.abs(values))
        bent = np.where(values > 0, np.tan(np.minimum(wave, np.pi / 2 - 1e-12)), -np.tanh(wave))
        field = vectors @ (vectors * (np.sqrt(np.abs(values)) * bent)[:, None, :]).swapaxes(1, 2)
        form = soft * lever[..., :, None] * field * lever[..., None, :]
        clamped = (wave * (values > 0)).max(1) / (np.pi / 2)
        return np.maximum(np.linalg.eigvalsh(form)[..., -1], np.where(clamped >= 1, 1e9, clamped))

    highest = np.pi / 2 / (segment.length * np.sqrt(values.max())) * (1 + 1e-12)
    soft = scipy.optimize.brentq(
        lambda s: float(excess(s).max()) - 1, 1e-9 * highest, highest, xtol=1e-14 * highest, rtol=1e-13
    )
    o, c = np.unravel_index(int(np.argmax(excess(soft * (1 - 1e-9)))), (len(lever), count))
    return Untwisted(segment, 1 - 1 / float(soft) ** 2, float(DIRECTIONS[c]), float(DIRECTIONS[o]))


def untwisted_tips(n: int, shape: Untwisted, bends: Array) -> tuple[Array, int]:
    """(n,) rotations of an untwisted shape, and its odd tube: one tube of the segment against the two others, the tubes
    of all other segments curving to one side. bends (n,): signs of the precurvatures."""
    tips = np.where(bends < 0, np.pi, 0.0) + shape.outer_direction
    tips[list(shape.segment.tubes)] += shape.direction - shape.outer_direction
    odd = shape.segment.tubes[2]
    tips[odd] += np.pi
    return tips, odd


def proof_gradient(robot: Robot, translations: Array) -> dict[str, Array]:
    """Change of `proof` with each of PARAMETERS, (n,), by differences: tubes that move together change together and
    share the derivative in equal parts. NaN where either side leaves what can be proved; where one does, that of the
    other."""
    here = robot.assembly(translations)
    value, out = proof(here)[0], {name: np.full(here.n_tubes, np.nan) for name in PARAMETERS}
    for name in PARAMETERS:
        for group in robot.moving_together:
            tubes = list(group)
            size = float(np.abs(getattr(here, name)[tubes[0]])) if hasattr(here, name) else here.total_length
            h = STEP * max(size, 1e-300)
            before, after = (_proof_at(robot, translations, (name, tubes, x)) for x in (-h, h))
            known = [(x, y) for x, y in ((-h, before), (0.0, value), (h, after)) if np.isfinite(y)]
            if len(known) > 1:
                (low, first), *_, (high, last) = known
                out[name][tubes] = (last - first) / (high - low) / len(tubes)
    return out


def _proof_at(robot: Robot, translations: Array, changed: tuple[str, list[int], float]) -> float:
    """The proof with one of PARAMETERS of some tubes `changed` by so much; -inf where there are no such tubes."""
    (name, group, change), here = changed, robot.assembly(translations)
    tubes, shift = list(robot.tubes), translations.copy()
    try:
        if name == "translation":
            shift[group] += change
        else:
            for i in group:
                tubes[i] = replace(tubes[i], **{name: getattr(tubes[i], name) + change})
        return proof(assemble(tubes, shift, offset=here.offset, offset_angle=here.offset_angle))[0]
    except InputError:
        return -np.inf


def proof(assembly: Assembly) -> tuple[float, Segment | None]:
    """The least `proved_margin` of all segments, at most 1, and of which; -inf where nothing can be proved, 1 where
    nothing is curved."""
    segments = segments_of(assembly)
    if segments is None:
        return -np.inf, None
    values = [(proved_margin(segment), k) for k, segment in enumerate(segments)]
    if not values:
        return 1.0, None
    least, k = min(values)
    return min(1.0, least), segments[k]
