"""Whether segments of three equal tubes off the centreline can snap: a proof that not, and a closed form beyond which
so.

Each segment is one problem of three tubes (see below): inner segments do not act on it but by the stiffness
of their straight tubes, and in front of its own curved part an outer segment only changes how long its tubes are. The
robot cannot snap if no segment can.

*Proof.* A segment with transmissions lam_i (over the unit 1 / omega) cannot snap if R(X) < lam^-1. Outer segments
stretch them to lam + d cos(c), lam + d cos(c + 120 deg) and lam + d cos(c - 120 deg), with d at most D, the sum of
delta omega L over these segments. So tan(phi(X)) < 1 / lam_eff, lam_eff = lam + D/2 + (D^2/2) / (1 / (delta X) - lam),
is enough, and necessary where c is 0.

*Closed form.* Two tubes turned to c and the third to c + pi neither twist nor turn one another: an equilibrium at every
length, whose linearisation has constant coefficients. Where one of these is unstable, with segments further out and in
curving to one side, the joint rotations have more than one equilibrium, and the robot snaps on some path.

Both are told as a number that is positive where the robot is stable: the share of torsional stiffness that all tubes
could lose before the proof fails, or the untwisted shape is a fold.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import scipy

from ..block.transcription.buffered import section_function
from ..errors import InputError
from ..physics.certificate import PARAMETERS
from ..robots.assembly import ROUND_OFF, Assembly, assemble
from ..robots.eccentric import PLACES
from ..robots.robot import Robot
from ..typing import Array

# --- Bound of the length of a segment ---------------------------------------------------------------------------------

# How long a segment of three equal tubes off the centreline may be, so that no rotation whatsoever makes it snap.
#
# Three equal tubes at 0 and +-120 deg obey, in x = omega (L - s) with omega^2 = m^2 / (K kt) (m = kb kappa, K the sum
# of kb at one place), equations that know nothing but delta = d m / K:
#
#     theta_x = g p,   p_x = M,   p(0) = 0;     linearised   y_x = g v + p (g' y),   v_x = M' y,   v(0) = 0,
#
# with g and M those of a cross-section with K = m = 1 and offset delta. Joint rotations, alpha = theta(X) + lam p(X),
# depend smoothly and one to one on those of the tips unless some y has y(X) + lam v(X) = 0. Multiplied by y and
# integrated, v_x = M' y says that such a y makes
#
#     Q[y] = y(X)' lam^-1 y(X) + int y_x' G^-1 y_x - y_x' B y + y' C y,
#     B_ij = p_i g'_ij / g_i,   C = sym M',   G = diag g,
#
# zero. With R(0) = 0 and, for every theta and every p that is possible at x,
#
#     R_x >= (R - B/2)' G (R - B/2) - C                                                                          (*)
#
# Q is at least y(X)' (lam^-1 - R(X)) y(X), and not 0. The right-hand side of (*) is convex in p, and p, an integral of
# M, lies in x times the convex hull of all M, which a polygon of twelve corners encloses. R = tan(phi(x)) P + delta x
# J, with J the projection on turns of all tubes alike and P the rest, fulfils (*) if phi_x is at least `steepest`.
#
# The table that comes with the package, of the x at which phi reaches a given angle, for delta up to 0.2525, is made by
# `python -m tubeopt.stability.eccentric_certificate`. Every number of it is on the safe side: phi_x is the largest of
# both ends of each step, at all corners of the polygon, on a grid of rotations whose largest value is raised by
# GRID_ROOM; what is read is lowered by TABLE_ROOM; towards delta = 0, where phi = x is exact, all of that goes to 0.
# The maximum over rotations is a search, not an enclosure by intervals.

FILE = Path(__file__).with_name("eccentric_bound.csv")

DELTAS = np.array([0.0, 0.0025, 0.005, *np.arange(0.01, 0.2501, 0.01), 0.2525])
"""delta of the rows of the table."""

ANGLES = np.linspace(0.0, np.pi / 2, 65)
"""phi of its columns, rad."""

CORNERS = (0.8169, 0.8301)
"""Support of all M towards (2, -1, -1) / sqrt 6 and (1, -1, 0) / sqrt 2, rounded up: twelve sides in turns. With three
equal tubes M_i = sum_j sin(theta_i - theta_j) / k with k >= 3: exactly sqrt(2/3) and 0.82973."""

BASIS = np.column_stack([np.array([2.0, -1.0, -1.0]) / np.sqrt(6), np.array([0.0, 1.0, -1.0]) / np.sqrt(2)])
"""(3, 2) what P keeps: turns of the tubes against one another."""

GRID = 24
"""Rotations per turn and tube at which the slope of phi is maximised: every 15 deg."""

GRID_ROOM = (1e-4, 4e-3)
"""Share by which the slope is raised, and the same per delta: at least twice what lies between the rotations of
GRID."""

TABLE_ROOM = 5e-5
"""By how much the table's x is lowered for what linear interpolation in delta and phi may be off."""

STEPS = 1600
"""Steps of x up to pi / 2."""


def corners() -> Array:
    """(12, 3) corners of the polygon, in order, that holds all M."""
    turn = np.arange(12) * np.pi / 6
    sides = np.column_stack([np.cos(turn), np.sin(turn)]) @ BASIS.T
    reach = np.array(CORNERS)[np.arange(12) % 2]
    out = []
    for k in range(12):
        rows, limit = sides[[k, (k + 1) % 12]], reach[[k, (k + 1) % 12]]
        out.append(rows.T @ np.linalg.solve(rows @ rows.T, limit))
    return np.array(out)


class Slope:
    """The slope of phi at rotations (T, 3) of one delta and every p of some corners, prepared for all x and phi."""

    def __init__(self, theta: Array, delta: float, vertices: Array) -> None:
        moments, g, stretched = cross_sections(theta, delta)
        relative = stretched / g[:, :, None]
        basis, common = BASIS, np.full(3, 1 / np.sqrt(3))
        # Per unit of x: B on turns within P (T, V, 3, 2), and delta J - B/2 on turns of all alike (T, V, 3).
        across = vertices[None, :, :, None] * (relative @ basis)[:, None]
        alike = delta * common - vertices * (relative @ common)[:, None] / 2
        self.delta = delta
        self.coupling = _form(basis.T @ moments @ basis)[:, :, None]
        self.alone = _form(np.einsum("ia,ti,ib->tab", basis, g, basis))[:, :, None]
        self.mixed = _form(np.einsum("ia,ti,tvib->tvab", basis, g, across))
        self.square = _form(np.einsum("tvia,ti,tvib->tvab", across, g, across))
        self.first = np.einsum("ia,ti,tvi->atv", basis, g, alike)
        self.second = np.einsum("tvia,ti,tvi->atv", across, g, alike)
        self.shear = (basis.T @ moments @ common / 2).T[:, :, None]
        self.common = np.einsum("tvi,ti,tvi->tv", alike, g, alike)

    def __call__(self, x: float, phi: float) -> Array:
        """(T, V) least slope of phi at x and phi."""
        sine, cosine = np.sin(phi), np.cos(phi)
        form = sine**2 * self.alone - sine * cosine * x * self.mixed + (cosine * x / 2) ** 2 * self.square
        form = form - cosine**2 * self.coupling
        lean = sine * x * self.first - cosine * x**2 / 2 * self.second - cosine * self.shear
        left = self.delta - x**2 * self.common
        if (left <= 0).any():
            raise ArithmeticError(f"turns of all tubes alike are not bounded at x = {x:g}")
        a, b, c = form[0] + lean[0] ** 2 / left, form[1] + lean[0] * lean[1] / left, form[2] + lean[1] ** 2 / left
        return np.asarray((a + c) / 2 + np.hypot((a - c) / 2, b))


def cross_sections(theta: Array, delta: float) -> tuple[Array, Array, Array]:
    """M' (N, 3, 3), g (N, 3) and g' (N, 3, 3) at rotations (N, 3)."""
    balance = section_function("balance", len(theta), 3, True)
    _, turned, _, g, stretched = balance(theta, 1.0, 1.0, delta, np.array(PLACES))
    moments, stretches = (part.reshape(-1, 3, 3).swapaxes(1, 2).copy() for part in (turned, stretched))
    return moments, g.copy(), stretches


def _form(matrix: Array) -> Array:
    """Entries (3, ...) of the symmetric part of matrices (..., 2, 2): xx, xy, yy."""
    return np.stack([matrix[..., 0, 0], (matrix[..., 0, 1] + matrix[..., 1, 0]) / 2, matrix[..., 1, 1]])


def all_rotations() -> Array:
    """(GRID^3, 3) rotations of three tubes on a grid over a turn of each, rad."""
    axis = np.arange(GRID) * 2 * np.pi / GRID
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)


def length_curve(delta: float, steps: int = STEPS) -> Array:
    """(65,) x at which phi reaches ANGLES, for one delta: an upper bound of phi, so a lower one of x."""
    if delta == 0.0:
        return ANGLES.copy()
    # Turning all by 120 deg and renaming the tubes turns the polygon by four corners: a third of them is enough.
    slope = Slope(all_rotations(), delta, corners()[:4])
    raised = 1 + GRID_ROOM[0] + GRID_ROOM[1] * delta
    h = np.pi / 2 / steps
    x, phi = [0.0], [0.0]
    while phi[-1] < np.pi / 2:
        start, ahead = phi[-1], x[-1] + h
        steep = float(slope(ahead, start).max())
        steep = max(steep, float(slope(ahead, min(np.pi / 2, start + h * raised * steep)).max()))
        x.append(ahead)
        phi.append(start + h * raised * steep)
    return np.asarray(np.interp(ANGLES, phi, x))


@lru_cache(maxsize=1)
def table() -> Array:
    """(deltas, angles) x of the table, lowered; row 0, of tubes on the centreline, is exact: x = phi."""
    rows = np.loadtxt(FILE, delimiter=",")
    return np.maximum(rows - np.where(DELTAS > 0, TABLE_ROOM, 0.0)[:, None], 0.0)


def longest(delta: float, angle: float) -> float:
    """The x up to which phi stays below `angle` (rad, at most pi / 2): a segment that is shorter cannot snap."""
    if not 0 <= delta <= DELTAS[-1]:
        raise InputError(f"delta is {delta:g}; the bound holds from 0 to {DELTAS[-1]:g}")
    i = min(int(np.searchsorted(DELTAS, delta, side="right")) - 1, len(DELTAS) - 2)
    row = (delta - DELTAS[i]) / (DELTAS[i + 1] - DELTAS[i])
    at = angle / ANGLES[1]
    j = min(int(at), len(ANGLES) - 2)
    column = at - j
    near = table()[i : i + 2, j : j + 2]
    left, right = (1 - row) * near[0] + row * near[1]
    return float((1 - column) * left + column * right)


def make_table() -> None:
    """Compute the table and write it: some minutes."""
    rows = [length_curve(delta) for delta in DELTAS]
    head = "largest x with phi below 0, pi/128, .. pi/2 (columns), by delta (rows); see eccentric_certificate.py"
    np.savetxt(FILE, rows, fmt="%.7f", delimiter=",", header=head)


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
    """Three equal tubes on one section, in units with K = m = 1.

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
    result: list[Segment] = []
    used: set[int] = set()
    for k in np.flatnonzero(assembly.curved.any(1) & (assembly.length > SHORT)):
        segment = _segment(assembly, int(k))
        if segment is None or used & set(segment.tubes):
            return None
        used |= set(segment.tubes)
        outer = tuple((other.delta, other.length / other.rate * segment.rate) for other in result)
        result.append(replace(segment, outer=outer))
    return tuple(result)


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


if __name__ == "__main__":
    make_table()
