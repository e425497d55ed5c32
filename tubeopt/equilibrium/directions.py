"""Changes of the equations of an arm with joint values, dimensions and stiffnesses of the tubes, at fixed arc lengths.

A tube that moves carries its varying properties past every point, and moves its breakpoints.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ..block.transcription.arm_response import Forcing, LinearisedArm
from ..block.transcription.mesh import INWARDS
from ..block.transcription.reduced import ReducedProblem
from ..errors import InputError
from ..robots.assembly import DIMENSIONS, LENGTH_ROUND_OFF, Assembly
from ..robots.lengthwise import CrossSections, Lengthwise
from ..robots.load import masses
from ..robots.order import outermost
from ..robots.tubes import Tube
from ..typing import Array, Index, Mask

# --- Strips of the arm that moving breakpoints uncover ----------------------------------------------------------------

# A breakpoint that moves uncovers a strip of the arm in which other tubes are present than before.

SAME_SPEED = 1e-12
"""Fraction of the largest speed below which speeds of coinciding breakpoints differ by round-off only."""


@dataclass(frozen=True, eq=False)
class Breakpoints:
    """Order of J breakpoints of n tubes at the plate or in front of it, without their positions."""

    tube: Index
    """(J,) tube of each breakpoint."""
    end: Mask
    """(J,) True for the end of a tube."""
    index: Index
    """(J,) piece of the mesh that begins at each breakpoint."""
    in_front: Mask
    """(J,) False at the plate."""
    groups: tuple[tuple[int, ...], ...]
    """Groups of breakpoints that coincide, in the order of the arm."""
    of_tubes: Array
    """(J, n) 1 where a tube has the breakpoint, 0 elsewhere."""


@lru_cache(maxsize=64)
def breakpoints_of(
    n: int, tube: tuple[int, ...], end: tuple[bool, ...], index: tuple[int, ...], in_front: tuple[bool, ...]
) -> Breakpoints:
    """Breakpoints of n tubes; arms with the same order of breakpoints share one object."""
    groups: dict[int, list[int]] = {}
    for j, k in enumerate(index):
        groups.setdefault(k, []).append(j)
    return Breakpoints(
        tube=np.array(tube, dtype=np.intp),
        end=np.array(end, dtype=bool),
        index=np.array(index, dtype=np.intp),
        in_front=np.array(in_front, dtype=bool),
        groups=tuple(tuple(group) for _, group in sorted(groups.items())),
        of_tubes=np.eye(n)[[*tube]],
    )


@dataclass(frozen=True, eq=False)
class PlacedBreakpoints:
    """Breakpoints of an arm with their positions."""

    breakpoints: Breakpoints
    """Order of the breakpoints."""
    arc_length: Array
    """(J,) arc lengths, m."""


@lru_cache(maxsize=64)
def placed_breakpoints(assembly: Assembly, between: bytes) -> PlacedBreakpoints:
    """Breakpoints of all tubes of an arm; `between` are the bytes of the arc lengths (P + 1,) between the pieces."""
    rows = [_places(assembly, i) for i in range(assembly.n_tubes)]
    # Breakpoints behind the plate are out of the arm; one at the plate may move into it.
    placed = [
        (i, s, k == len(row) - 1) for i, row in enumerate(rows) for k, s in enumerate(row) if s > -LENGTH_ROUND_OFF
    ]
    arc_length = np.array([s for _, s, _ in placed])
    breakpoints = breakpoints_of(
        assembly.n_tubes,
        tube=tuple(i for i, _, _ in placed),
        end=tuple(end for _, _, end in placed),
        index=tuple(np.frombuffer(between).searchsorted(arc_length - 2 * LENGTH_ROUND_OFF).tolist()),
        in_front=tuple((arc_length > LENGTH_ROUND_OFF).tolist()),
    )
    return PlacedBreakpoints(breakpoints, arc_length)


class Strip(NamedTuple):
    """Stretch of the arm between two shifted positions of coinciding breakpoints."""

    group: tuple[int, ...]
    """Coinciding breakpoints."""
    past: tuple[int, ...]
    """Breakpoints that have moved beyond the strip."""
    plate_side: bool
    """True if the strip lies on the plate's side of the common position."""


@dataclass(frozen=True, eq=False)
class Strips:
    """T strips that Q directions uncover."""

    first: Index
    """(T,) breakpoint at each strip, the first of those that coincide."""
    widths: Array
    """(T, Q) widths per unit of motion."""
    past: Array
    """(2 T, n) 1 where a breakpoint of the tube has moved beyond the strip, after the motion, then before it."""
    past_inside: Array
    """(2 T, n) 1 where the breakpoint counted in `past` is not the end of the tube."""


@lru_cache(maxsize=64)
def strips_of(points: Breakpoints, columns: int, speeds: bytes) -> Strips:
    """Strips uncovered by Q `columns` of directions, with speeds (J, Q) towards the tip.

    The order of the shifted breakpoints decides which tubes are present in a strip.
    """
    speed, widths = np.frombuffer(speeds).reshape(-1, columns), dict[Strip, Array]()
    for group in points.groups:
        in_front, rows = bool(points.in_front[group[0]]), speed[[*group]]
        if len(group) == 1:
            # A breakpoint at the plate uncovers a strip only if it moves in front of it.
            widths[Strip(group, group, False)] = rows[0] if in_front else np.maximum(rows[0], 0.0)
            continue
        alike: dict[tuple[float, ...], list[int]] = {}
        for column in np.flatnonzero(rows.any(0)).tolist():
            # Directions with equal speeds uncover equal strips, so each pattern is sorted once.
            alike.setdefault(tuple(rows[:, column].tolist()), []).append(column)
        for pattern, among in alike.items():
            # Shifted positions in order; in front of each strip are the breakpoints that moved farther.
            levels = sorted([0.0, *pattern])
            round_off = SAME_SPEED * max(levels[-1], -levels[0])
            for low, high in pairwise(levels):
                if high - low > round_off and (high > 0 or in_front):
                    past = tuple(j for j, v in zip(group, pattern, strict=True) if v >= high - round_off)
                    widths.setdefault(Strip(group, past, high <= 0), np.zeros(columns))[among] += high - low
    widths = {strip: width for strip, width in widths.items() if width.any()}
    beyond = np.zeros((2, len(widths), len(points.tube)))
    for k, strip in enumerate(widths):
        beyond[0, k, [*strip.past]] = 1.0
        if strip.plate_side:
            beyond[1, k, [*strip.group]] = 1.0
    past_points = beyond.reshape(-1, len(points.tube))
    return Strips(
        first=np.array([strip.group[0] for strip in widths], dtype=np.intp),
        widths=np.array([*widths.values()]).reshape(len(widths), columns),
        past=past_points @ points.of_tubes,
        past_inside=(past_points * ~points.end) @ points.of_tubes,
    )


@dataclass(frozen=True, eq=False)
class Uncovered:
    """T strips that Q directions uncover, with their cross-sections after the motion, then before it (2 T)."""

    index: Index
    """(T,) piece of the mesh that begins at each strip."""
    widths: Array
    """(T, Q) widths per unit of motion."""
    sections: CrossSections
    """(2 T) cross-sections."""
    outermost: Index
    """(2, T) outermost tube that is present."""
    signs: Array
    """(2, T) 1 after the motion and -1 before it, 0 where no tube is present."""

    @cached_property
    def compliance(self) -> Array:
        """Torsional compliance 1 / kt (2, T, n), 1/(N m^2)."""
        kt = self.sections.torsional_stiffness
        return np.asarray(1 / kt.reshape(2, -1, kt.shape[1]))

    @cached_property
    def stiffness(self) -> Array:
        """(2 T, n) kb; 1 without any tube, where a cross-section could not be evaluated."""
        return np.where(self.signs.reshape(-1, 1) != 0, self.sections.stiffness, 1.0)

    @property
    def growth(self) -> Array:
        """(T,) 1 if the tip extends the arm by a strip, -1 if it shortens it, else 0."""
        return np.asarray(self.signs.sum(0))


@lru_cache(maxsize=64)
def uncovered_by(assembly: Assembly, placed: PlacedBreakpoints, strips: Strips) -> Uncovered:
    """Cross-sections in the strips of an arm."""
    arc_length = placed.arc_length[strips.first]
    arc_length = np.concatenate([arc_length, arc_length])
    side = arc_length[:, None] + LENGTH_ROUND_OFF
    # A tube whose breakpoint moved beyond continues as before the breakpoint: it is evaluated on the plate's side.
    present = side - 2 * LENGTH_ROUND_OFF * strips.past < assembly.end
    # Where a curved part begins to grow its end moves alone.
    near = side - 2 * LENGTH_ROUND_OFF * strips.past_inside
    return Uncovered(
        index=placed.breakpoints.index[strips.first],
        widths=strips.widths,
        sections=_sections(assembly, arc_length, near, present),
        outermost=outermost(present).reshape(2, -1),
        signs=present.any(1).reshape(2, -1) * _AFTER_BEFORE,
    )


_AFTER_BEFORE = np.array([[1.0], [-1.0]])


def _places(assembly: Assembly, tube: int) -> list[float]:
    """Arc lengths (m) of the breakpoints of a tube in their order."""
    if assembly.lengthwise is None:
        return [float(assembly.transition[tube]), float(assembly.end[tube])]
    cuts = sorted(cut - float(assembly.transmission[tube]) for cut in assembly.lengthwise.cuts[tube])
    return [s for k, s in enumerate(cuts) if not k or s - cuts[k - 1] > LENGTH_ROUND_OFF]


def _sections(assembly: Assembly, s: Array, near: Array, present: Mask) -> CrossSections:
    """Cross-sections at arc lengths (X,), each tube on the side `near` (X, n), with `present` (X, n) tubes.

    Tubes are straight behind their clamped ends.
    """
    if assembly.lengthwise is not None:
        side = near + assembly.transmission
        arm = assembly.lengthwise.at(s[:, None] + assembly.transmission, side, present)
        return replace(arm, moment=arm.moment * (side >= 0))
    kb = assembly.bending_stiffness * present
    none = np.zeros(kb.shape)
    moment = kb * assembly.curvature * (near > assembly.transition)
    return CrossSections(kb, moment, none, none + assembly.torsional_stiffness, none, none)


PARAMETERS = ("rotations", "translations", *DIMENSIONS)
"""Parameters of the derivatives of an equilibrium, n columns each, per rad, per m, or per SI unit."""


OF_SHEATH = ("sheath_stiffness", "sheath_rigid_length", "sheath_rigid_from")
"""Parameters of the sheath of a bundle robot, one number each."""

ARRANGEMENT = ("offset", "angle", *OF_SHEATH)
"""Further parameters of a bundle robot; those of the tubes are n numbers each."""


def columns_of(wrt: Sequence[str], n: int) -> list[int]:
    """Numbers of columns of parameters of n tubes."""
    return [1 if name in OF_SHEATH else n for name in wrt]


def check_wrt(wrt: Sequence[str], side: int, allowed: Sequence[str] = PARAMETERS) -> None:
    """Raise InputError for a name that is not `allowed`, or a side that is neither 1 nor -1."""
    if side not in (1, -1):
        raise InputError(f"side is {side!r}; it must be 1 (forward) or -1 (backward)")
    for name in wrt:
        if name not in allowed:
            raise InputError(f"wrt names {name!r}; it may name {', '.join(allowed)}")


@dataclass(frozen=True, eq=False)
class Change:
    """Derivatives of the tubes at fixed arc lengths with respect to one parameter; (P, K, n) at the points."""

    transmission: Array
    """(n,) change of int ds / kt up to the plate."""
    rate: Array
    """Change (P, K, n) of the torsional compliance 1 / kt."""
    stiffness: Array
    """(P, K, n) change of the bending stiffness kb."""
    moment: Array
    """(P, K, n) change of the moment m."""
    phase: Array
    """(P, K, n) change of the phase of the precurvature."""
    twist_angle: Array
    """(n,) change of the natural twist up to the ends of the tubes."""
    force: Array | None = None
    """(P, K, 3) change of the force on the cross-sections; None for none."""


@dataclass(frozen=True, eq=False)
class Entered:
    """Derivatives of the equations in Q directions."""

    forcing: Forcing
    """Derivatives without the motion of breakpoints."""
    twist_angle: Array
    """(n, Q) derivatives of the natural twist up to the ends of the tubes."""
    speed: Array
    """(J, Q) motion of the breakpoints towards the tip."""


class Directions:
    """Q directions of change of an arm: the parameters named by `wrt`, n columns each.

    Where breakpoints coincide derivatives are directional: along a sum of parameters they are not the sum of those
    along each.

    Args:
        arm: arm in equilibrium.
        tubes: tubes of the arm.
        margin: margin of the equilibrium.
        wrt: names of PARAMETERS.
        side: 1 for parameters that grow, so that breakpoints move towards the tip, -1 for those that shrink: where
            breakpoints coincide the derivatives differ.
        more: changes of the tubes at fixed arc lengths, one further column each.
        along: (L, Q) combinations of the L columns of `wrt` and `more` that replace them, as for a group of tubes that
            moves together. Where moments act, no direction moves breakpoints to both sides.

    Raises:
        InputError: a name that is not among PARAMETERS, or a side that is neither 1 nor -1.
    """

    def __init__(
        self,
        arm: LinearisedArm,
        tubes: Sequence[Tube],
        margin: float,
        wrt: Sequence[str] = ("rotations", "translations"),
        side: int = 1,
        more: Callable[[Directions], Sequence[Change]] | None = None,
        along: Array | None = None,
    ) -> None:
        check_wrt(wrt, side)
        self.arm, self.tubes, self.value, self.wrt, self.side = arm, tuple(tubes), margin, tuple(wrt), side
        self.problem, self.assembly = arm.problem, arm.problem.assembly
        self.n, self.shape, self.cuts = arm.n, arm.shape, arm.cuts
        self._more = [] if more is None else list(more(self))
        self._along = along
        self.size = self.n * len(self.wrt) + len(self._more) if along is None else along.shape[1]

    @cached_property
    def entered(self) -> Entered:
        """Derivatives of the equations in all directions."""
        arm, n, size = self.arm, self.n, self.n * len(self.wrt) + len(self._more)
        points, bases = (arm.elements, arm.degree), np.zeros((3, n, size))
        forcing = Forcing(
            alpha=bases[0],
            transmission=bases[1],
            data=np.zeros((*points, 3 * n, size)),
            compliance=np.zeros((*points, n, size)),
            force=np.zeros((*points, 3, size)),
            jumps=np.zeros((arm.elements + 1, arm.size, self.size)),
            side=self.side,
        )
        into = Entered(forcing, bases[2], np.zeros((len(self.breakpoints.tube), size)))
        for k, name in enumerate(self.wrt):
            self._enter(into, k * n, name)
        for column, change in enumerate(self._more, start=n * len(self.wrt)):
            forcing.transmission[:, column], forcing.compliance[..., column] = change.transmission, change.rate
            forcing.data[..., column] = np.concatenate([change.phase, change.stiffness, change.moment], axis=2)
            into.twist_angle[:, column] += change.twist_angle
            if change.force is not None:
                forcing.force[..., column] = change.force
        if self._along is None:
            return into
        along = self._along
        forcing = replace(
            forcing,
            alpha=forcing.alpha @ along,
            transmission=forcing.transmission @ along,
            data=_combined(forcing.data, along),
            compliance=_combined(forcing.compliance, along),
            force=_combined(forcing.force, along),
        )
        return Entered(forcing, into.twist_angle @ along, into.speed @ along)

    @cached_property
    def strips(self) -> Uncovered:
        """The T strips that breakpoints uncover."""
        speeds = (self.side * self.entered.speed).tobytes()
        return uncovered_by(self.assembly, self.placed, strips_of(self.breakpoints, self.size, speeds))

    @property
    def widths(self) -> Array:
        """(T, Q) changes of the widths of the strips."""
        return self.strips.widths

    @cached_property
    def placed(self) -> PlacedBreakpoints:
        """Breakpoints in front of the plate or at it."""
        return placed_breakpoints(self.assembly, self.cuts.tobytes())

    @property
    def breakpoints(self) -> Breakpoints:
        """Order of the breakpoints."""
        return self.placed.breakpoints

    def _enter(self, entered: Entered, first: int, name: str) -> None:
        """Enter the changes by a parameter of the tubes into n columns from the first one on."""
        arm, into, columns = self.arm, entered.forcing, slice(first, first + self.n)
        if name == "rotations":
            into.alpha[:, columns] = np.eye(self.n)
            return
        if name == "translations" and self.assembly.lengthwise is None and not self._density.any():
            entered.speed[:, columns] = self.breakpoints.of_tubes
            # A tube that moves forward has less of its straight part below the plate.
            into.transmission[:, columns] = np.diag(-_held(self.assembly, self.side))
            return
        i = np.arange(self.n)
        kb, m, column = self.n + i, 2 * self.n + i, first + i
        if name == "straight_length":
            into.transmission[i, column] = _held(self.assembly, 0)
        elif name == "curvature":
            bend = np.array([tube.curvature for tube in self.tubes])
            # m = kb kappa: dm / dkappa = m / kappa, and kb where kappa is 0.
            into.data[..., m, column] = arm.natural_moment / np.where(bend, bend, 1.0)
            for k in np.flatnonzero(bend == 0).tolist():
                into.data[..., m[k], column[k]] = arm.stiffness[..., k] * self._bendable(k)
        elif name == "bending_stiffness":
            stiffness = np.array([tube.bending_stiffness for tube in self.tubes], dtype=float)
            into.data[..., kb, column], into.data[..., m, column] = (
                arm.stiffness / stiffness,
                arm.natural_moment / stiffness,
            )
        elif name == "torsional_stiffness":
            stiffness = np.array([tube.torsional_stiffness for tube in self.tubes], dtype=float)
            # d(1 / kt) / dkt = -1 / kt^2, in proportion to the whole tube's kt.
            into.compliance[..., i, column] = -arm.compliance / stiffness
            into.transmission[i, column] = -arm.transmission / stiffness
        else:
            for k in range(self.n):
                self._advance(entered, first, name, k)

    def _advance(self, entered: Entered, first: int, name: str, i: int) -> None:
        """Enter the changes by advancing a tube, or by a longer curved part with all its pieces in proportion.

        A point x of the tube behind the straight part, l, moves by (x - l) / L for each unit of the length L.
        """
        arm, into, n, tube, points = self.arm, entered.forcing, self.n, self.tubes[i], self.breakpoints
        column = first + i
        held, mine, table = float(self.assembly.transmission[i]), points.tube == i, self.assembly.lengthwise

        def moves(position: Array) -> Array:
            if name == "translations":
                return np.ones_like(position)
            return np.maximum(position - tube.straight_length, 0.0) / (tube.curved_length or np.inf)

        pace = moves(self.placed.arc_length[mine] + held)
        if name == "curved_length":
            pace[points.end[mine]] = 1.0
        entered.speed[mine, column] += pace
        into.transmission[i, column] -= float(moves(np.array(held))) * self._softness(i)
        end = float(self.assembly.end[i])
        if self._density[i] and end > -self.side * LENGTH_ROUND_OFF:
            # The tube's weight moves beyond all points before its end, by the density per unit of motion.
            into.force[..., column] += (self._arc_length < end)[..., None] * (self._density[i] * self._gravity)
        stretches = name == "curved_length" and tube.curved_length > 0
        if table is None:
            if stretches:
                grown = max(held - tube.straight_length, 0.0) / tube.curved_length
                into.transmission[i, column] += grown * self._softness(i)
            return
        position = self._arc_length + held
        moved = moves(position)
        for k, rate in enumerate(self._passing[:3]):
            # At a fixed arc length a tube that moves forward shows what was behind: minus its slope times the motion.
            into.data[..., k * n + i, column] -= rate[..., i] * moved
        into.compliance[..., i, column] -= self._passing[3][..., i] * moved
        if stretches:
            straight = np.array([tube.straight_length for tube in self.tubes])
            up_to = table.compliant(self.assembly.transmission)[i] - table.compliant(straight)[i]
            into.transmission[i, column] += max(float(up_to), 0.0) / tube.curved_length
            ends = np.array([tube.length for tube in self.tubes])
            straight_angle, full_angle = table.values(np.stack([straight, ends]))[5][:, i]
            turned = arm.problem.compliant.sections.twist_angle.reshape(arm.phase.shape)[..., i] - straight_angle
            # The twist is per length, so that a longer curved part winds more, in proportion.
            into.data[..., i, column] += np.where(moved != 0, turned, 0.0) / tube.curved_length
            entered.twist_angle[i, column] += (full_angle - straight_angle) / tube.curved_length

    @cached_property
    def _arc_length(self) -> Array:
        """(P, K) changes of the arc lengths of the points, m."""
        return np.asarray(self.arm.mesh.start[:, None] + self.arm.length[:, None] * self.arm.tableau.nodes)

    @cached_property
    def _density(self) -> Array:
        """(n,) mass per length of the tubes, kg/m; 0 without gravity."""
        load = self.arm.load
        return np.zeros(self.n) if load is None else masses(self.tubes, load)

    @property
    def _gravity(self) -> Array:
        load = self.arm.load
        return np.array((0.0, 0.0, 0.0) if load is None or load.gravity is None else load.gravity)

    def _bendable(self, i: int) -> Array:
        """(P, K) True at points on the curved part of a tube with one curvature."""
        tube, position = self.tubes[i], self._arc_length + self.assembly.transmission[i]
        return np.asarray((position > tube.straight_length) & (not tube.general))

    def _softness(self, i: int) -> float:
        """Compliance 1 / kt of a tube at the plate, on the side from which the tube moves, 1/(N m^2)."""
        return float(_held(self.assembly, self.side)[i])

    @property
    def _passing(self) -> TubeRates:
        return passing(self.arm.problem)

    # --- what a change of pieces needs to know ------------------------------------------------------------------------

    @property
    def tube_position(self) -> Array:
        """(P, K, n) positions of the points on the tubes, m from their clamped ends."""
        return self._arc_length[..., None] + self.assembly.transmission

    @property
    def table(self) -> Lengthwise:
        """Properties of tubes made of pieces along them."""
        assert self.assembly.lengthwise is not None
        return self.assembly.lengthwise

    @cached_property
    def values(self) -> Array:
        """(6, P, K, n) the quantities of the table at the points."""
        return self.table.values(self.tube_position.reshape(-1, self.n)).reshape(6, *self.arm.phase.shape)


def _combined(columns: Array, along: Array) -> Array:
    """Table (..., Q) in directions (L, Q), from a table (..., L)."""
    if not columns.any():  # as of joints of tubes of one arc
        return np.zeros((*columns.shape[:-1], along.shape[1]))
    return np.asarray((columns.reshape(-1, len(along)) @ along).reshape(*columns.shape[:-1], along.shape[1]))


@lru_cache(maxsize=64)
def _held(assembly: Assembly, side: int) -> Array:
    """(n,) torsional compliances 1 / kt of the tubes at the plate, on the side of their motion, 1/(N m^2).

    With `side` 0 they are those at the clamps.
    """
    table = assembly.lengthwise
    if table is None:
        return np.asarray(1 / assembly.torsional_stiffness)
    at = assembly.transmission[None] * abs(side)
    return np.asarray(1 / table.values(at, at - side * LENGTH_ROUND_OFF)[1, 0])


class TubeRates(NamedTuple):
    """(P, K, n) rates along tubes made of pieces, per m of their own arc length, at the points."""

    phase: Array
    bending: Array
    """Rate of kb, N m."""
    moment: Array
    """Rate of m."""
    compliance: Array
    """Rate of 1 / kt."""


@lru_cache(maxsize=64)
def passing(problem: ReducedProblem) -> TubeRates:
    """Rates at which the tubes made of pieces change past a point."""
    table, mesh, shape = problem.assembly.lengthwise, problem.mesh, problem.compliant.rate.shape
    assert table is not None
    nodes = mesh.tableau.nodes
    s, inside = (
        (mesh.start[:, None] + mesh.length[:, None] * x).ravel()[:, None] + problem.assembly.transmission
        for x in (nodes, nodes + INWARDS * (0.5 - nodes))
    )
    kb, kt, x, y, z, _ = (part.reshape(shape) for part in table.values(s, inside))
    dkb, dkt, dx, dy, _, _ = (part.reshape(shape) for part in table.rates(s, inside))
    present, size = problem.compliant.sections.stiffness.reshape(shape) > 0, np.hypot(x, y)
    solid = np.where(size > 0, size, 1.0)
    turning, growing = (x * dy - y * dx) / solid**2, (x * dx + y * dy) / solid
    return TubeRates(z + turning, dkb * present, (dkb * size + kb * growing) * present, -dkt / kt**2)
