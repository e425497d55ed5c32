"""Joint values -> sections: the stretches of a tube bundle between breakpoints, and the order of the breakpoints.

As long as breakpoints keep their order, the lengths of the sections are linear in lengths and translations of the
tubes; which tubes are present and which are curved in a section does not change.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..typing import Array, Index, Mask
from .lengthwise import CrossSections, Lengthwise, lengthwise
from .limits import check_reach
from .tubes import Tube

# Breakpoints closer than this (m) are one: far below any tolerance of a tube, far above round-off of a length.
LENGTH_ROUND_OFF = 1e-12


@dataclass(frozen=True, eq=False)
class Assembly:
    """A bundle of n tubes in front of the plate, cut into m sections, base to tip.

    Inside a section the same pieces of tubes are present and the same ones are curved. Tube i runs at the fixed offset
    `offset[i]` from the centreline in direction `offset_angle[i]` (0 for concentric tubes).

    Where a tube is not even, stiffnesses and curvature have no number, and refuse every use with an InputError:
    `lengthwise` has them.
    """

    bending_stiffness: Array
    """(n,) bending stiffnesses EI, N m^2."""
    torsional_stiffness: Array
    """(n,) torsional stiffnesses GJ, N m^2."""
    curvature: Array
    """(n,) precurvature of the curved parts, 1/m."""
    offset: Array
    """(n,) offset of each tube from the centreline, m; 0 for concentric ones."""
    offset_angle: Array
    """(n,) angle of each tube's offset about the centreline, rad."""
    transmission: Array
    """(n,) lengths |beta_i| from the clamped end of tube i to the plate, m."""
    transition: Array
    """(n,) arc length where each tube begins to curve, m; < 0 behind the plate."""
    end: Array
    """(n,) arc length where each tube ends, m; < 0 behind the plate."""
    start: Array
    """(m,) arc length where each section begins, m."""
    length: Array
    """(m,) length of each section, m."""
    present: Mask
    """(m, n) True if tube i is present in the section."""
    curved: Mask
    """(m, n) True if tube i is curved in the section."""
    lengthwise: Lengthwise | None = None
    """Precurvature and stiffness along the tubes, where one of them is written as pieces; else None."""
    even: bool = True
    """True if stiffnesses, and the curvature of the curved part, are constant along each tube."""

    @property
    def general(self) -> bool:
        """True if a tube is made of pieces, which have their own breakpoints."""
        return self.lengthwise is not None

    @cached_property
    def between_tubes(self) -> Array:
        """Arc lengths of the breakpoints at which no tube begins, ends or begins to curve, as of loads, m."""
        same = (self.present[1:] == self.present[:-1]).all(1) & (self.curved[1:] == self.curved[:-1]).all(1)
        return np.asarray(self.start[1:][same])

    def cross_sections(self, arc_length: Array, inside: Array) -> CrossSections:
        """Cross-sections at arc lengths (X,), m; at breakpoints, on the side of `inside` (X,)."""
        section = np.searchsorted(self.start, inside, side="right") - 1
        if self.even:
            return self.of_sections(section)
        assert self.lengthwise is not None
        position, near = (s[:, None] + self.transmission for s in (arc_length, inside))
        # By section, since a point inside a very short one rounds to its end.
        return self.lengthwise.at(position, near, self.present[section])

    def of_sections(self, section: Index) -> CrossSections:
        """Cross-sections in sections (X,) of even tubes."""
        kb = self.bending_stiffness * self.present[section]
        moment, none = kb * self.curvature * self.curved[section], np.zeros(kb.shape)
        return CrossSections(kb, moment, none, none + self.torsional_stiffness, none, none)

    def twist_angle(self, arc_length: Array) -> Array:
        """Natural rotation (X, n) of the tubes between their clamped ends and arc lengths (X,), rad; 0
        for even tubes.
        """
        if self.even:
            return np.zeros((len(arc_length), self.n_tubes))
        assert self.lengthwise is not None
        return np.asarray(self.lengthwise.values(arc_length[:, None] + self.transmission)[5])

    def steady(self, low: Array, high: Array) -> Mask:
        """Mask (P,) of the intervals from `low` to `high` (P,), m, in which no tube varies and no section ends."""
        if self.even:
            return np.ones(len(low), dtype=bool)
        assert self.lengthwise is not None
        return self.lengthwise.steady(*(s[:, None] + self.transmission for s in (low, high)))

    def compliant(self, position: Array) -> Array:
        """Compliance (..., n), int ds / GJ, from the clamped ends to arc lengths (..., n) from there, 1/(N m)."""
        if self.even:
            return np.asarray(position / self.torsional_stiffness)
        assert self.lengthwise is not None
        return self.lengthwise.compliant(position)

    @property
    def held_stiffness(self) -> Array:
        """Torsional stiffness (n,) at the clamped ends, N m^2."""
        if self.even:
            return self.torsional_stiffness
        assert self.lengthwise is not None
        return np.asarray(self.lengthwise.values(np.zeros((1, self.n_tubes)))[1][0])

    @property
    def n_tubes(self) -> int:
        """Number of tubes n."""
        return len(self.transmission)

    @property
    def breakpoints(self) -> list[float]:
        """Arc lengths (some behind the plate) of all transitions, ends, and joins of pieces, m."""
        return _breakpoints(self.transition, self.end, self.lengthwise, -self.transmission)

    @property
    def breakpoint_tubes(self) -> list[int]:
        """Tube of each of the `breakpoints`."""
        each = list(range(self.n_tubes))
        cuts = () if self.lengthwise is None else self.lengthwise.cuts
        return [*each, *each, *(i for i, tube_cuts in enumerate(cuts) for _ in tube_cuts)]

    @property
    def n_sections(self) -> int:
        """Number of sections m."""
        return len(self.length)

    @cached_property
    def total_length(self) -> float:
        """Arc length of the tip, m; 0 if no tube reaches beyond the plate by more than LENGTH_ROUND_OFF."""
        return float(self.end.max()) if self.n_sections else 0.0

    @cached_property
    def eccentric(self) -> bool:
        """True if a tube runs off the centreline."""
        return bool(self.offset.any())

    @property
    def offsets(self) -> tuple[Array, ...]:
        """Offset and angle (n,), or () for concentric tubes, as arguments of cross-section functions."""
        return (self.offset, self.offset_angle) if self.eccentric else ()

    @property
    def across(self) -> Array:
        """Offsets (n, 2) of the tubes from the centreline, d (cos gamma, sin gamma), m."""
        angle = self.offset_angle
        return np.asarray(self.offset[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))

    @cached_property
    def coupled(self) -> Mask:
        """Mask (m,) of the sections with nonlinear torsion: two curved tubes, or one with eccentric tubes."""
        return np.asarray(self.curved.sum(1) >= (1 if self.eccentric else 2))


def assemble(
    tubes: Sequence[Tube],
    translations: Array,
    *,
    offset: Array | None = None,
    offset_angle: Array | None = None,
    name: str = "translation",
) -> Assembly:
    """Cut the bundle at every transition and end in front of the plate.

    Args:
        tubes: inner to outer.
        translations: (n,) advance of each tube, m; at 0 it begins to curve at the plate.
        offset, offset_angle: (n,) place of each tube beside the centreline, m and rad; None is concentric.
        name: what the caller calls a translation, for the message.

    Raises:
        InputError: a translation pulls a tube out of its actuator (beta_i > 0), or draws it back by more than FAR of
            its lengths.
    """
    n = len(tubes)
    straight = np.array([tube.straight_length for tube in tubes])
    beta = translations - straight
    for i in range(n):
        if beta[i] > LENGTH_ROUND_OFF:
            raise InputError(
                f"{name} of tube {i + 1} is {translations[i]:g} m and moves it out of its "
                f"carriage; it must be at most its straight_length, {straight[i]:g} m"
            )
    curvature, bending, torsional = (
        _numbers(tubes, name) for name in ("arc", "bending_stiffness", "torsional_stiffness")
    )
    check_reach(tubes, translations.tolist())
    # Round-off would put the held end in front of the plate.
    beta = np.minimum(beta, 0.0)
    transition = beta + straight
    end = beta + np.array([tube.length for tube in tubes])
    table = lengthwise(tuple(tubes)) if any(tube.general for tube in tubes) else None
    cuts = merge([0.0, *(s for s in _breakpoints(transition, end, table, beta) if s > 0)])
    # Nothing changes within a section: its middle shows which tubes are there, far from round-off at its ends.
    middle = (cuts[:-1] + cuts[1:])[:, None] / 2
    if table is None:
        present, curved = where(transition, end, curvature, middle)
    else:
        present = middle < end
        curved = present & table.bent[np.arange(n), table.panel(middle - beta)]
    zero = np.zeros(n)
    return Assembly(
        bending_stiffness=bending,
        torsional_stiffness=torsional,
        curvature=curvature,
        offset=zero if offset is None else offset,
        offset_angle=zero if offset_angle is None else offset_angle,
        transmission=-beta,
        transition=transition,
        end=end,
        start=cuts[:-1],
        length=np.diff(cuts),
        present=present,
        curved=curved,
        lengthwise=table,
        even=all(tube.even for tube in tubes),
    )


def _breakpoints(transition: Array, end: Array, table: Lengthwise | None, beta: Array) -> list[float]:
    points = [*transition.tolist(), *end.tolist()]
    for tube_cuts, held in zip(() if table is None else table.cuts, beta.tolist(), strict=table is not None):
        points += [s + held for s in tube_cuts]
    return points


class _OfPieces:
    """Placeholder for a number per tube of tubes made of pieces: every use raises InputError."""

    def __init__(self, name: str, tube: int) -> None:
        self.name, self.tube = name, tube

    def _refuse(self, *_: Any, **__: Any) -> Any:
        raise InputError(
            f"tube {self.tube} is made of pieces; this function supports tubes of one "
            f"constant {self.name.replace('_', ' ')} only"
        )

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return self._refuse()

    __array__ = __getitem__ = __mul__ = __rmul__ = __add__ = __radd__ = __sub__ = __rsub__ = _refuse
    __truediv__ = __rtruediv__ = __neg__ = __abs__ = __len__ = __iter__ = __pow__ = _refuse


def _numbers(tubes: Sequence[Tube], name: str) -> Array:
    """Numbers (n,), one per tube; a placeholder that raises on use if a tube is not even."""
    uneven = next((i for i, tube in enumerate(tubes, start=1) if not tube.even), 0)
    if uneven:
        return cast(Array, _OfPieces("curvature" if name == "arc" else name, uneven))
    return np.array([getattr(tube, name) for tube in tubes])


def where(transition: Array, end: Array, curvature: Array, s: Array | float) -> tuple[Mask, Mask]:
    """Masks of the tubes that are present, and that are curved, at an arc length s."""
    present: Mask = np.asarray(s < end)
    return present, np.asarray(present & (s > transition) & (curvature != 0))


def merge(points: Iterable[float]) -> Array:
    """Sorted points without those closer than LENGTH_ROUND_OFF to the one before."""
    distinct: list[float] = []
    for point in sorted(points):
        if not distinct or point - distinct[-1] > LENGTH_ROUND_OFF:
            distinct.append(point)
    return np.array(distinct)


def cut(assembly: Assembly, at: Array) -> Assembly:
    """Assembly with further breakpoints at arc lengths `at` (m) between the plate and the tip."""
    total = assembly.total_length
    inside = at[(at > LENGTH_ROUND_OFF) & (at < total - LENGTH_ROUND_OFF)]
    start = merge(np.concatenate([assembly.start, inside]))
    length = np.diff(np.append(start, total))
    # New breakpoints only divide sections, so that the middle of a part lies in one old section.
    section = np.searchsorted(assembly.start, start + length / 2) - 1
    return replace(
        assembly, start=start, length=length, present=assembly.present[section], curved=assembly.curved[section]
    )


def without_offsets(assembly: Assembly) -> Assembly:
    """Assembly with all tubes on the centreline."""
    zero = np.zeros(assembly.n_tubes)
    return replace(assembly, offset=zero, offset_angle=zero)


# Dimensions of the tubes on which an equilibrium depends, (n,) each, SI.
DIMENSIONS = ("curvature", "straight_length", "curved_length", "bending_stiffness", "torsional_stiffness")


@dataclass(frozen=True)
class Breakpoint:
    """Transition or end of tubes that move together, or joint between panels of a tube made of pieces.

    Joints are numbered from 1, from the first tube's clamped end on.
    """

    tubes: tuple[int, ...]
    end: bool
    joint: int = 0

    def index(self, n: int) -> int:
        """Index in a column of n transitions, n ends, and all joints."""
        return 2 * n + self.joint - 1 if self.joint else self.tubes[0] + (n if self.end else 0)

    def before(self, other: Breakpoint) -> bool:
        """True if it belongs to the same tube and is closer to its clamped end."""
        return bool(set(self.tubes) & set(other.tubes)) and (self.end, self.joint) < (other.end, other.joint)

    def __str__(self) -> str:
        if self.joint:
            return f"joint {self.joint} between pieces, of tube {self.tubes[0] + 1},"
        what = "end" if self.end else "transition"
        first, last = self.tubes[0] + 1, self.tubes[-1] + 1
        return f"the {what} of tube {first}" if first == last else f"the common {what} of tubes {first} to {last}"


@dataclass(frozen=True, eq=False)
class Order:
    """Breakpoints in front of the plate in order, and those behind it.

    Section k lies between breakpoint k - 1 (the plate for the first) and breakpoint k; `present`, `curved` (m, n) mark
    which tubes are there, and curved there, `panel` (m, n) how many breakpoints of each lie behind it. Sections may
    have no length.
    """

    front: tuple[Breakpoint, ...]
    behind: tuple[Breakpoint, ...]
    present: NDArray[np.bool_]
    curved: NDArray[np.bool_]
    panel: NDArray[np.intp]

    def lengths(self, where: Array) -> Array:
        """Lengths (m,) of the sections in this order, from the arc lengths of transitions, ends and joints."""
        n = self.present.shape[1]
        return np.diff([0.0, *(where[point.index(n)] for point in self.front)])


def joints_of(assembly: Assembly) -> list[Array]:
    """Arc lengths, m, of the joints between panels behind the transition of each tube; empty for tubes of one
    curvature.
    """
    table = assembly.lengthwise
    if table is None:
        return [np.zeros(0)] * assembly.n_tubes
    positions = table.breaks - assembly.transmission[:, None]
    first, last = assembly.transition + LENGTH_ROUND_OFF, assembly.end - LENGTH_ROUND_OFF
    return [
        tube_joints[(tube_joints > a) & (tube_joints < b)]
        for tube_joints, a, b in zip(positions, first, last, strict=True)
    ]


def where_of(assembly: Assembly) -> Array:
    """Arc lengths, m, of all transitions, ends and joints of an assembly."""
    return np.concatenate([assembly.transition, assembly.end, *joints_of(assembly)])


def order_of(assembly: Assembly, carriages: Sequence[tuple[int, ...]], *, side: int = -1) -> Order:
    """Order of the breakpoints of an assembly.

    Args:
        carriages: tubes that move together; breakpoints that they share are one.
        side: where a transition lies at the plate: 1 takes it in front, -1 behind. Among other breakpoints that
            coincide outer tubes come first, so that an inner one may grow out of them.
    """
    n = assembly.n_tubes
    transition, end = assembly.transition, assembly.end
    groups: list[tuple[float, int, Breakpoint]] = []
    for tubes in carriages:
        for at_end, values in ((False, transition), (True, end)):
            # A tube without a curved part has no transition: it is straight to its end.
            mine = [i for i in tubes if at_end or has_curve(assembly, i)]
            while mine:
                same = tuple(i for i in mine if abs(values[i] - values[mine[0]]) <= 1e-9)
                groups.append((float(values[mine[0]]), -max(same), Breakpoint(same, at_end)))
                mine = [i for i in mine if i not in same]
    joints = [(float(s), i) for i, tube_joints in enumerate(joints_of(assembly)) for s in tube_joints]
    groups += [(s, -i, Breakpoint((i,), False, k)) for k, (s, i) in enumerate(joints, start=1)]
    # A transition at the plate to within round-off goes to the chosen side. An end there has no section in front.
    nudge = side * 1e-9
    # Rounded to 0.1 nm: breakpoints that coincide but for round-off come in the order of tubes.
    front = sorted(
        (g for g in groups if g[0] + (0.0 if g[2].end else nudge) > 0), key=lambda g: (round(g[0], 10), g[1])
    )
    points = [point for *_, point in front]
    return arrange(points, [point for *_, point in groups if point not in points], n)


def arrange(front: Sequence[Breakpoint], behind: Sequence[Breakpoint], n_tubes: int) -> Order:
    """Order with breakpoints in front of the plate, base to tip, and behind it."""
    present, curved = (np.zeros((len(front), n_tubes), dtype=bool) for _ in range(2))
    panel = np.zeros((len(front), n_tubes), dtype=np.intp)
    for i in range(n_tubes):
        # Breakpoints behind the plate lie behind all sections; one in front lies behind the sections after it.
        panel[:, i] = sum(i in point.tubes for point in behind)
        panel[1:, i] += np.cumsum([i in point.tubes for point in front[:-1]], dtype=np.intp)
    rank = {(i, point.end): k for k, point in enumerate(front) if not point.joint for i in point.tubes}
    bent = {i for point in (*front, *behind) if not point.end for i in point.tubes}
    for i in range(n_tubes):
        # -1 stands for behind the plate: such a tube is in no section, or is curved from the first one on.
        last, first = rank.get((i, True), -1), rank.get((i, False), -1)
        present[: last + 1, i] = True
        curved[first + 1 : last + 1, i] = i in bent
    return Order(tuple(front), tuple(behind), present, curved, panel)


def has_curve(assembly: Assembly, tube: int) -> bool:
    """True if a tube has a curved part."""
    return bool(assembly.end[tube] > assembly.transition[tube])


class TubePositions(NamedTuple):
    """(n,) positions of tubes, m: arrays or expressions."""

    transmission: Any
    """|beta|."""
    transition: Any
    """Arc length at which the curved part begins."""
    end: Any


def tube_positions(translations: Any, straight_length: Any, curved_length: Any) -> TubePositions:
    """Positions of tubes at translations (n,)."""
    return TubePositions(straight_length - translations, translations, translations + curved_length)


def dimensions_of(tubes: Sequence[Any]) -> dict[str, Array]:
    """Arrays (n,) of the DIMENSIONS of tubes."""
    return {name: np.array([getattr(tube, name) for tube in tubes]) for name in DIMENSIONS}
