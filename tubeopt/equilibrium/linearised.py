"""Derivatives of an equilibrium of concentric tubes, of one curvature or made of pieces, with a load or without, by the
implicit function theorem.

What moves along the arm is taken at fixed arc lengths: a tube that moves carries what varies along it past every point,
and a breakpoint that moves uncovers a stretch with other tubes, which is a jump of all rates there. Where breakpoints
coincide the derivatives to either side differ, and both are exact.

The margin mu is the least of Q / T, of the second variation Q over its elastic part T. At its mode, with y the turn of
the tubes, v and g their torques and the bending moment, psi the turn of the frame,

    d mu = int [partial derivative of  y' (dM/dtheta) y - 2 g'(du/dtheta) y - (v^2 / kt + |g|^2 / K) / (1 - mu)
                - n.(psi x (psi x e))] ds / T,      R g = dm + m x psi,

since no other change of the mode matters to it. What is continuous where the tubes change is y, v, psi, dm.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ..block.transcription.buffered import bent_function, mapped
from ..block.transcription.collocated import ENDS
from ..block.transcription.green import INWARDS
from ..block.transcription.linear import cumulate
from ..block.transcription.reduced import ReducedProblem
from ..block.transcription.standing import (
    Burden,
    Forcing,
    Response,
    Sections,
    Standing,
    by_data_of,
    cross,
    hat,
    sections_of,
)
from ..errors import InputError, SolveError
from ..physics.certificate import worst_function
from ..robots.assembly import ROUND_OFF, Assembly
from ..robots.lengthwise import CrossSections, Lengthwise
from ..robots.load import FORCE, MOMENT, masses
from ..robots.tubes import Tube
from ..typing import Array, Index, Mask
from .answer import discretisation_of, sample_rotation
from .arm_change import check_wrt
from .problem import loaded_problem, reduced_problem
from .result import Equilibrium, refuse_friction

FLAT = 1 - 1e-9
"""Margin above which nothing softens: the greatest value, 1, which does not change."""

APART = 1e-7
"""Margins of either sign smaller than this are those of a fold."""

SAME_SPEED = 1e-12
"""Part of the greatest speed below which speeds of breakpoints that coincide differ by round-off alone."""

PLACES = tuple(ENDS.tolist())


@dataclass(frozen=True, eq=False)
class Change:
    """What an unknown changes at fixed arc lengths: int ds / kt up to the plate (n,), at the points (P, K, n) 1 / kt,
    kb, m and phase, and the natural turn (n,) up to the ends of the tubes."""

    transmission: Array
    rate: Array
    stiffness: Array
    moment: Array
    phase: Array
    wound: Array


@dataclass(frozen=True, eq=False)
class Section:
    """u (2,) at a place of the arm, and the changes of theta, kb and m (3 n, Q) and of u (2, Q) while it moves."""

    curvature: Array
    by_tubes: Array
    by_curvature: Array


@dataclass(frozen=True, eq=False)
class Breakpoints:
    """J breakpoints in front of the plate or at it: the `tube` that has each, its `place` (m), whether it is the `end`
    of the tube, the `index` of the piece that begins there, and numbers of those that coincide, `together`."""

    tube: Index
    place: Array
    end: Mask
    index: Index
    together: tuple[tuple[int, ...], ...]


@lru_cache(maxsize=64)
def breakpoints_of(assembly: Assembly, between: bytes) -> Breakpoints:
    """Those of all tubes; `between` are the arc lengths (P + 1,) between the pieces."""
    each = [_places(assembly, i) for i in range(assembly.n_tubes)]
    own = [(i, s, k == len(row) - 1) for i, row in enumerate(each) for k, s in enumerate(row) if s > -ROUND_OFF]
    place = np.array([s for _, s, _ in own])
    index = np.searchsorted(np.frombuffer(between), place - 2 * ROUND_OFF)
    where: dict[int, list[int]] = {}
    for j, k in enumerate(index.tolist()):
        where.setdefault(k, []).append(j)
    tube, end = np.array([i for i, _, _ in own], dtype=np.intp), np.array([last for _, _, last in own], dtype=bool)
    return Breakpoints(tube, place, end, index, tuple(tuple(some) for _, some in sorted(where.items())))


class Strip(NamedTuple):
    """What breakpoints that coincide uncover between two of their shifted places: those of `past` moved beyond it. It
    lies on the side of the tip or, where it is `behind`, of the plate; places are numbers of breakpoints."""

    together: tuple[int, ...]
    past: tuple[int, ...]
    behind: bool


def strips_of(points: Breakpoints, speed: Array) -> dict[Strip, Array]:
    """The strips (T,) that directions uncover and their widths (Q,), if breakpoints move towards the tip at `speed`
    (J, Q). The order in which the places are then decides which tubes are in a strip."""
    widths: dict[Strip, Array] = {}
    for own in points.together:
        ahead, rows = bool(points.place[own[0]] > ROUND_OFF), speed[[*own]]
        if len(own) == 1:
            widths[Strip(own, own, False)] = rows[0] if ahead else np.maximum(rows[0], 0.0)
            continue
        for column in np.flatnonzero(rows.any(0)).tolist():
            pace = rows[:, column].tolist()
            levels = sorted([0.0, *pace])
            least = SAME_SPEED * max(levels[-1], -levels[0])
            for low, high in pairwise(levels):
                if high - low > least and (high > 0 or ahead):
                    past = tuple(j for j, one in zip(own, pace, strict=True) if one >= high - least)
                    widths.setdefault(Strip(own, past, high <= 0), np.zeros(speed.shape[1]))[column] += high - low
    return {strip: width for strip, width in widths.items() if width.any()}


@dataclass(frozen=True, eq=False)
class Uncovered:
    """Of T strips: the `index` of the piece that begins there and 2 T cross-sections, of what the motion uncovers, then
    of what was there; `there` (2 T,) whether there is any tube, and the `outermost` one."""

    index: Index
    sections: CrossSections
    there: Mask
    outermost: Index


@lru_cache(maxsize=64)
def uncovered_by(assembly: Assembly, between: bytes, strips: tuple[Strip, ...]) -> Uncovered:
    """What strips uncover; `between` as for `breakpoints_of`."""
    points, n = breakpoints_of(assembly, between), assembly.n_tubes
    first = np.array([strip.together[0] for strip in strips], dtype=np.intp)
    place = points.place[first]
    near = np.repeat(np.concatenate([place, place])[:, None] + ROUND_OFF, n, axis=1)
    bends = near.copy()
    for row, strip in enumerate(strips):
        for at, moved in ((row, strip.past), (row + len(strips), strip.together if strip.behind else ())):
            near[at, points.tube[[*moved]]] -= 2 * ROUND_OFF
            # Where a curved part begins to grow its end moves alone.
            bends[at, points.tube[[j for j in moved if not points.end[j]]]] -= 2 * ROUND_OFF
    present = near < assembly.end
    return Uncovered(
        index=points.index[first],
        sections=_sections(assembly, np.concatenate([place, place]), bends, present),
        there=np.asarray(present.any(1)),
        outermost=n - 1 - present[:, ::-1].argmax(1),
    )


def _places(assembly: Assembly, tube: int) -> list[float]:
    """Arc lengths (m) of the breakpoints of a tube in their order, but for where it is held."""
    if assembly.lengthwise is None:
        return [float(assembly.transition[tube]), float(assembly.end[tube])]
    own = sorted(cut - float(assembly.transmission[tube]) for cut in assembly.lengthwise.cuts[tube][1:])
    return [s for k, s in enumerate(own) if not k or s - own[k - 1] > ROUND_OFF]


def _sections(assembly: Assembly, s: Array, near: Array, present: Mask) -> CrossSections:
    """The tubes at arc lengths (X,), each on the side of (X, n), and (X, n) which are there."""
    if assembly.lengthwise is not None:
        return assembly.lengthwise.at(s[:, None] + assembly.transmission, near + assembly.transmission, present)
    kb = assembly.bending_stiffness * present
    none = np.zeros(kb.shape)
    moment = kb * assembly.curvature * (near > assembly.transition)
    return CrossSections(kb, moment, none, none + assembly.torsional_stiffness, none, none)


class Linearised:
    """Derivatives of an equilibrium by what `wrt` names of its n tubes, n columns each, computed where asked for.

    Where breakpoints coincide they are directional: those along a sum of parameters are not the sum of those by each.

    Args:
        here: the arm in equilibrium.
        tubes: of which it is.
        margin: of the equilibrium.
        wrt: names of PARAMETERS.
        side: 1 for parameters that grow, so that breakpoints move towards the tip, -1 for those that shrink: where
            breakpoints coincide the derivatives differ.
        more: changes of the tubes at fixed arc lengths, one further column each.
        along: (L, Q) directions, by what `wrt` and `more` give, that replace these L columns; as where a group of tubes
            moves at once. Where moments act, no direction moves breakpoints to both sides.

    Raises:
        InputError: a name that is not among PARAMETERS, a side that is neither 1 nor -1; or the tip draws back from
            under a force or moment that acts where it is.
        SolveError: the equilibrium is a fold.
    """

    def __init__(
        self,
        here: Standing,
        tubes: Sequence[Tube],
        margin: float,
        wrt: Sequence[str] = ("rotations", "translations"),
        side: int = 1,
        more: Callable[[Linearised], Sequence[Change]] | None = None,
        along: Array | None = None,
    ) -> None:
        check_wrt(wrt, side)
        self.here, self.tubes, self.value, self.wrt, self.side = here, tuple(tubes), margin, tuple(wrt), side
        self.problem, self.assembly = here.problem, here.problem.assembly
        self.n, self.arm, self.cuts = here.n, here.shape, here.cuts
        self._more = [] if more is None else list(more(self))
        self._along = along
        self.size = self.n * len(self.wrt) + len(self._more) if along is None else along.shape[1]

    # --- what changes -------------------------------------------------------------------------------------------------

    @cached_property
    def _entered(self) -> tuple[Forcing, Array, Array]:
        """What the parameters change beside breakpoints; the natural turn (n, Q) up to the ends of the tubes; by how
        much each moves the breakpoints (J, Q)."""
        here, n, size = self.here, self.n, self.n * len(self.wrt) + len(self._more)
        points, bases = (here.pieces, here.degree), np.zeros((3, n, size))
        forcing = Forcing(
            base=bases[0],
            transmission=bases[1],
            data=np.zeros((*points, 3 * n, size)),
            rate=np.zeros((*points, n, size)),
            force=np.zeros((*points, 3, size)),
            jumps=np.zeros((here.pieces + 1, here.size, self.size)),
            side=self.side,
        )
        wound, speed = bases[2], np.zeros((len(self._breakpoints.tube), size))
        for k, name in enumerate(self.wrt):
            self._enter(forcing, (wound, speed), (k * n, name))
        for column, change in enumerate(self._more, start=n * len(self.wrt)):
            forcing.transmission[:, column], forcing.rate[..., column] = change.transmission, change.rate
            forcing.data[..., column] = np.concatenate([change.phase, change.stiffness, change.moment], axis=2)
            wound[:, column] += change.wound
        if self._along is None:
            return forcing, wound, speed
        along = self._along
        forcing = replace(
            forcing,
            base=forcing.base @ along,
            transmission=forcing.transmission @ along,
            data=_combined(forcing.data, along),
            rate=_combined(forcing.rate, along),
            force=_combined(forcing.force, along),
        )
        return forcing, wound @ along, speed @ along

    @cached_property
    def _uncovering(self) -> tuple[Uncovered, Array]:
        """What the directions uncover, and the widths (T, Q) of the strips."""
        widths = strips_of(self._breakpoints, self.side * self._entered[2])
        table = np.array([*widths.values()]).reshape(len(widths), self.size)
        return uncovered_by(self.assembly, self.cuts.tobytes(), tuple(widths)), table

    @property
    def _strips(self) -> Uncovered:
        return self._uncovering[0]

    @property
    def _widths(self) -> Array:
        return self._uncovering[1]

    @cached_property
    def _given(self) -> tuple[Forcing, Array]:
        """All that the directions change; the natural turn (n, Q) up to the ends of the tubes."""
        forcing, wound, _ = self._entered
        np.add.at(forcing.jumps, self._strips.index, self._gains[0][:, :, None] * self._widths[:, None])
        return forcing, wound

    def _enter(self, into: Forcing, more: tuple[Array, Array], what: tuple[int, str]) -> None:
        """Enter what a parameter of the tubes changes into n columns from the first one on."""
        (first, name), here, i = what, self.here, np.arange(self.n)
        kb, m, column = self.n + i, 2 * self.n + i, first + i
        if name == "rotations":
            into.base[i, column] = 1.0
        elif name == "straight_length":
            into.transmission[i, column] = _held(self.assembly, 0)
        elif name == "curvature":
            bend = np.array([tube.curvature for tube in self.tubes])
            into.data[..., m, column] = here.moments / np.where(bend, bend, 1.0)
            for k in np.flatnonzero(bend == 0).tolist():
                into.data[..., m[k], column[k]] = here.stiffness[..., k] * self._bendable(k)
        elif name == "bending_stiffness":
            stiffness = np.array([tube.bending_stiffness for tube in self.tubes], dtype=float)
            into.data[..., kb, column], into.data[..., m, column] = here.stiffness / stiffness, here.moments / stiffness
        elif name == "torsional_stiffness":
            stiffness = np.array([tube.torsional_stiffness for tube in self.tubes], dtype=float)
            into.rate[..., i, column] = -here.rate / stiffness
            into.transmission[i, column] = -here.transmission / stiffness
        else:
            for k in range(self.n):
                self._advance(into, more, (first + k, name, k))

    def _advance(self, into: Forcing, more: tuple[Array, Array], what: tuple[int, str, int]) -> None:
        """A tube moves forward with all that it is; or its curved part becomes longer, all its pieces in proportion: a
        place x of the tube moves by (x - l) / L behind the straight part, l, for each unit of length, L."""
        column, name, i = what
        here, n, own, points = self.here, self.n, self.tubes[i], self._breakpoints
        wound, speed = more
        held, mine, table = float(self.assembly.transmission[i]), points.tube == i, self.assembly.lengthwise

        def moves(place: Array) -> Array:
            if name == "translations":
                return np.ones_like(place)
            return np.maximum(place - own.straight_length, 0.0) / (own.curved_length or np.inf)

        pace = moves(points.place[mine] + held)
        if name == "curved_length":
            pace[points.end[mine]] = 1.0
        speed[mine, column] += pace
        into.transmission[i, column] -= float(moves(np.array(held))) * self._softness(i)
        end = float(self.assembly.end[i])
        if self._density[i] and end > -self.side * ROUND_OFF:
            into.force[..., column] += (self._arc_length < end)[..., None] * (self._density[i] * self._gravity)
        stretches = name == "curved_length" and own.curved_length > 0
        if table is None:
            if stretches:
                grown = max(held - own.straight_length, 0.0) / own.curved_length
                into.transmission[i, column] += grown * self._softness(i)
            return
        place = self._arc_length + held
        moved = moves(place)
        for k, rate in enumerate(self._passing[:3]):
            into.data[..., k * n + i, column] -= rate[..., i] * moved
        into.rate[..., i, column] -= self._passing[3][..., i] * moved
        if stretches:
            straight = np.array([tube.straight_length for tube in self.tubes])
            up_to = table.compliant(self.assembly.transmission)[i] - table.compliant(straight)[i]
            into.transmission[i, column] += max(float(up_to), 0.0) / own.curved_length
            ends = np.array([tube.length for tube in self.tubes])
            begun, ended = table.values(np.stack([straight, ends]))[5][:, i]
            turned = here.problem.here.sections.wound.reshape(here.phase.shape)[..., i] - begun
            into.data[..., i, column] += np.where(moved != 0, turned, 0.0) / own.curved_length
            wound[i, column] += (ended - begun) / own.curved_length

    @cached_property
    def _arc_length(self) -> Array:
        """(P, K) of the points, m."""
        return np.asarray(self.here.mesh.start[:, None] + self.here.length[:, None] * self.here.t.nodes)

    @cached_property
    def _density(self) -> Array:
        """(n,) mass per length of the tubes, kg/m; 0 where nothing weighs."""
        load = self.here.load
        return np.zeros(self.n) if load is None else masses(self.tubes, load)

    @property
    def _gravity(self) -> Array:
        load = self.here.load
        return np.array((0.0, 0.0, 0.0) if load is None or load.gravity is None else load.gravity)

    def _bendable(self, i: int) -> Array:
        """(P, K) where a straight tube would be curved if it had a curvature; straight pieces stay straight."""
        own, place = self.tubes[i], self._arc_length + self.assembly.transmission[i]
        return np.asarray((place > own.straight_length) & (not own.general))

    def _softness(self, i: int) -> float:
        """1 / kt of a tube at the plate, on the side from which it moves, 1/(N m^2)."""
        return float(_held(self.assembly, self.side)[i])

    @property
    def _passing(self) -> tuple[Array, ...]:
        return passing(self.here.problem)

    # --- what a change of pieces needs to know ------------------------------------------------------------------------

    @property
    def shape(self) -> tuple[int, int, int]:
        """Pieces, points, tubes."""
        return self.here.pieces, self.here.degree, self.n

    @property
    def place(self) -> Array:
        """(P, K, n) where the points lie on the tubes, m from their held ends."""
        return self._arc_length[..., None] + self.assembly.transmission

    @property
    def table(self) -> Lengthwise:
        """What tubes made of pieces are along them."""
        assert self.assembly.lengthwise is not None
        return self.assembly.lengthwise

    @cached_property
    def values(self) -> Array:
        """(6, P, K, n) the quantities of the table at the points."""
        return self.table.values(self.place.reshape(-1, self.n)).reshape(6, *self.shape)

    # --- breakpoints --------------------------------------------------------------------------------------------------

    @cached_property
    def _breakpoints(self) -> Breakpoints:
        return breakpoints_of(self.assembly, self.cuts.tobytes())

    @cached_property
    def _force_there(self) -> Array:
        """(T, 3) force on the cross-section at the strips, on the side to which they lie."""
        here, index = self.here, self._strips.index
        if self.side < 0:
            return np.asarray(here.t.basis((1.0,), 0)[0] @ here.force[index - 1])
        table = np.concatenate([here.t.basis((0.0,), 0)[0] @ here.force, here.tip_force[None]])
        return np.asarray(table[index])

    @cached_property
    def _gains(self) -> tuple[Array, Array, Array, Array]:
        """What the rates of the state (T, 2 n + 6), the motion of the tip (T, 3), the elastic energy per length and
        |u|^2 (T,) gain per width of a strip."""
        here, points = self.here, self._strips
        index, count = points.index, len(points.index)
        if not count:
            return np.zeros((0, here.size)), np.zeros((0, 3)), np.zeros(0), np.zeros(0)
        both = np.concatenate([index, index])
        frame, there, n = here.end_frame[both], points.there, self.n
        torque = (here.torque_ahead if self.side < 0 else here.torque_behind)[both]
        at, rate, _ = self._sections_there
        rates = np.empty((2 * count, here.size))
        rates[:, :n] = rate * torque
        rates[:, n : n + 3] = (frame[..., :2] @ at.curvature[..., None])[..., 0]
        rates[:, n + 3 : 2 * n + 3] = at.torque
        falling = -cross(frame[:count, :, 2], self._force_there)
        if here.load is not None and here.load.distributed is not None:
            along = here.load.per_length(self.cuts[index] + self.side * ROUND_OFF)[:, MOMENT]
            falling -= along
            felt = (along * frame[:count, :, 2]).sum(1)
            rates[np.arange(2 * count), n + 3 + points.outermost] -= np.concatenate([felt, felt])
        rates[:count, 2 * n + 3 :] = rates[count:, 2 * n + 3 :] = falling
        energy = at.energy + (rates[:, :n] * torque).sum(1) / 2
        squared = (at.curvature**2).sum(1)
        signs = self.side * there
        signs[count:] *= -1
        gains = [part * signs[:, None] for part in (rates, frame[..., 2], np.column_stack([energy, squared]))]
        state, tip, more = (part[:count] + part[count:] for part in gains)
        return state, tip, more[:, 0], more[:, 1]

    @cached_property
    def _sections_there(self) -> tuple[Sections, Array, tuple[Array, ...]]:
        """Cross-sections at the 2 T places, 1 / kt (2 T, n) there, and of what they are: theta, kb, m, b."""
        here, points = self.here, self._strips
        index, tubes = points.index, points.sections
        frame, moment = here.end_frame[index], here.moment_ahead if self.side < 0 else here.moment_behind
        bent = (frame[..., :2].swapaxes(1, 2) @ moment[index][..., None])[..., 0]
        phi = here.phi_ends[index]
        # Where there is no tube a cross-section cannot be asked.
        solid = np.where(points.there[:, None], tubes.stiffness, 1.0)
        given = np.concatenate([phi, phi]) + tubes.phase, solid, tubes.moment, np.concatenate([bent, bent])
        return sections_of(*given), 1 / tubes.torsional_stiffness, given

    # --- answers ------------------------------------------------------------------------------------------------------

    @cached_property
    def response(self) -> Response:
        """Of the arm."""
        forcing = self._given[0]
        here, load = self.here, self.here.load
        if load is not None:
            self._must_stay()
            if load.distributed is not None:
                force = load.per_length(self.cuts[-1:] + self.side * ROUND_OFF)[0, FORCE]
                forcing.force[:] += np.outer(force, self._longer)
        return here.respond(forcing)

    def _must_stay(self) -> None:
        """Refuse motions that draw the tip, or the end of a tube, from under what acts there."""
        here, ends, points = self.here, self.assembly.end, self._breakpoints
        assert here.load is not None
        tip, pace = self.cuts[-1], np.zeros((self.n, self.size))
        at_end = np.abs(points.place - ends[points.tube]) <= ROUND_OFF
        pace[points.tube[at_end]] = self.side * self._entered[2][at_end]
        if (self.side * self._longer < 0).any() and any(part.at >= tip - TIP for part in here.load.points):
            raise InputError(
                f"points of load act at the tip, {1e3 * tip:g} mm from the plate, from where it draws back; take "
                "derivatives by what moves it out (side=1)"
            )
        left = {tube for k, tube, _ in here.joints if (pace[tube] < 0).any() and abs(self.cuts[k] - ends[tube]) <= TIP}
        if any(here.load.moment):
            last = np.flatnonzero(tip - ends <= ROUND_OFF)
            over = pace[last] > pace[here.tip_tube]
            # A tube that runs ahead takes the moment over, or one that stays while that with the moment draws back.
            left |= {int(i) for i, row in zip(last, over, strict=True) if (row & (pace[i] > 0)).any()}
            left |= {here.tip_tube} if (over.any(0) & (pace[here.tip_tube] < 0)).any() else set()
        if left:
            raise SolveError(
                f"there is no derivative by the end of tube {min(left) + 1}: a moment acts there, which another tube "
                "takes over"
            )

    @cached_property
    def _longer(self) -> Array:
        """(Q,) change of the arm's length."""
        at_tip = self._strips.index == self.here.pieces
        return np.asarray((self._gains[1] @ self.here.end_frame[-1, :, 2] * at_tip) @ self._widths)

    @property
    def pushed(self) -> Array:
        """(3, Q) motion of the tip with the tubes that push it out, or that alone hold it there."""
        return np.outer(self.here.end_frame[-1, :, 2], self._longer)

    @cached_property
    def tip_position(self) -> Array:
        """(3, Q) of the tip, m."""
        here = self.here
        levers = (here.weights[..., None, None] * -hat(here.axis)).reshape(-1, 3, 3).swapaxes(0, 1).reshape(3, -1)
        return np.asarray(levers @ self.response.psi.reshape(-1, self.size) + self.pushed)

    @property
    def tip_rotation(self) -> Array:
        """(3, Q) turn vector of the tip frame in the plate frame, rad."""
        return self.response.state[-1, self.n : self.n + 3]

    @property
    def tip_rotations(self) -> Array:
        """(n, Q) of theta at each tube's own end."""
        ends = np.clip(self.assembly.end, 0.0, self.cuts[-1])
        index = np.abs(self.cuts - ends[:, None]).argmin(1)
        return np.asarray(self.response.state[index, np.arange(self.n)] + self._given[1])

    @cached_property
    def moved(self) -> Array:
        """(m, Q) motion of the shape points along the arm, if they keep their places in the pieces of the mesh."""
        return self._moved(self.arm.arc_length)

    def _moved(self, s: Array) -> Array:
        """(len(s), Q) motion of places that divide the stretches between breakpoints as they do; of those that coincide
        the foremost counts."""
        points, pace = self._breakpoints, self.side * self._entered[2]
        each = [own for own in points.together if points.index[own[0]] > 0]
        knots = np.concatenate([[0.0], self.cuts[points.index[[own[0] for own in each]]]]) if each else np.zeros(1)
        speed = self.side * np.array([pace[[*own]].max(0) for own in each])
        share = [np.interp(s, knots, row) for row in np.eye(len(knots))[1:]]
        return np.stack(share, axis=1) @ speed if share else np.zeros((len(s), self.size))

    @cached_property
    def turned(self) -> Array:
        """(m, 3, Q) turn vector of the frames at the shape points that move so, rad."""
        here, n = self.here, self.n
        rates = here.frame[..., :2] @ self.response.curvature
        inside = here.t.basis(PLACES, 1)[1:] @ rates.reshape(here.pieces, here.degree, 3 * self.size)
        inside = (here.h * inside).reshape(here.pieces, len(PLACES) - 1, 3, self.size)
        ahead = (self.response.state[:-1, None, n : n + 3] + inside).reshape(-1, 3, self.size)
        bend = (self.arm.frame[1:, :, :2] @ self.arm.curvature[1:, :, None]) * self.moved[1:, None]
        return np.concatenate([np.zeros((1, 3, self.size)), ahead + bend])

    @cached_property
    def _sections_along(self) -> tuple[Array, Array]:
        """(P, K, n) phi' and (P, K, 3 n + 2) phase, kb, m and b at the points."""
        here = self.here
        return here.rate * here.torque, np.concatenate([here.phase, here.stiffness, here.moments, here.bent], axis=2)

    @cached_property
    def sections(self) -> tuple[Array, Array]:
        """(P, 5, 3 n) theta, kb and m, and (P, 5, 2) u at ENDS of every piece."""
        here, n, (rate, table) = self.here, self.n, self._sections_along
        at = here.t.basis(PLACES, 0) @ table
        at[..., :n] += here.phi_ends[:-1, None] + here.h * (here.t.basis(PLACES, 1) @ rate)
        found = sections_of(*_parts(at.reshape(-1, 3 * n + 2)))
        return at[..., : 3 * n], found.curvature.reshape(*at.shape[:2], 2)

    def section(self, k: int, x: float, moves: Array) -> Section:
        """The cross-section at a fraction x of piece k, while the place moves along the arm by (Q,)."""
        here, n, (rate, table) = self.here, self.n, self._sections_along
        h, response, forcing = here.length[k], self.response, self._given[0]
        inside, whole, slope = (here.t.basis((x,), times)[0] for times in (0, 1, -1))
        at, by = inside @ table[k], slope @ table[k] / h
        at[:n] += here.phi_ends[k] + h * (whole @ rate[k])
        by[:n] += inside @ rate[k]
        change = by[:, None] * moves
        change[: 3 * n] += _at(inside, forcing.data[k])
        if here.load is not None:
            change[3 * n :] += _at(inside, response.bent[k])
        gained = here.rate[k, ..., None] * response.torque[k] + forcing.rate[k] * here.torque[k, ..., None]
        change[:n] += response.state[k, :n] + h * _at(whole, gained)
        given = _parts(at[None])
        found, own = sections_of(*given), by_data_of(*given)[1]
        turned = found.by_curvature[0] @ np.concatenate([change[:n], change[3 * n :]]) + own[0] @ change[n : 3 * n]
        return Section(found.curvature[0], change[: 3 * n], turned)

    @cached_property
    def position(self) -> Array:
        """(m, 3, Q) of the shape points at fixed arc lengths; the last one is the tip, which moves along."""
        here = self.here
        out = cumulate(here.t, here.h[..., None] * (-hat(here.axis) @ self.response.psi))
        out[-1] += self.pushed
        return out

    @property
    def total_bend(self) -> float:
        """int |u|^2 ds along the arm, 1/m."""
        return float(self.here.weights.ravel() @ (self.here.at.curvature**2).sum(1))

    @cached_property
    def bend(self) -> Array:
        """(Q,) of int |u|^2 ds, 1/m."""
        here, u = self.here, self.here.at.curvature
        pull = (2 * here.weights.ravel()[:, None] * u).ravel()
        return np.asarray(pull @ self.response.curvature.reshape(-1, self.size) + self._gains[3] @ self._widths)

    @cached_property
    def energy(self) -> Array:
        """(Q,) of the elastic energy, J."""
        here, forcing, n = self.here, self._given[0], self.n
        moved, weights, size = self.response, here.weights.ravel(), self.size
        by = weights[:, None] * here.at.by_energy
        out = by[:, :n].ravel() @ moved.phi.reshape(-1, size)
        out += by[:, n:].ravel() @ moved.bent.reshape(-1, size)
        if forcing.data.any():
            out += (weights[:, None] * here.by_data[2].reshape(len(weights), -1)).ravel() @ forcing.data.reshape(
                -1, size
            )
        torque = here.torque.reshape(-1, n)
        out += (weights[:, None] * here.rate.reshape(-1, n) * torque).ravel() @ moved.torque.reshape(-1, size)
        out += (weights[:, None] * torque**2 / 2).ravel() @ forcing.rate.reshape(-1, size)
        # The torque that the transmissions feel, behind what moves at the plate.
        held, gained = here.torque_ahead[0], (moved.state - forcing.jumps)[0, n + 3 : 2 * n + 3]
        out += (held**2 / 2) @ forcing.transmission + (here.transmission * held) @ gained
        return np.asarray(out + self._gains[2] @ self._widths)

    @cached_property
    def margin(self) -> Array:
        """(Q,) of the margin; NaN where it is a double eigenvalue, and for loads without an energy."""
        return self._margin(one_of_two=False)

    @cached_property
    def one_margin(self) -> Array:
        """(Q,) of the margin; that of one of its modes where it is a double eigenvalue."""
        return self._margin(one_of_two=True)

    def _margin(self, *, one_of_two: bool) -> Array:
        if not self.here.pieces:
            return -self._softened
        if self.value >= FLAT:
            return np.zeros(self.size)
        load = self.here.load
        known = (load is None or load.has_energy) and not np.isnan(self.value)
        mode = mode_of(self.here, self.value, one_of_two) if known else None
        return np.full(self.size, np.nan) if mode is None else self._quotient(*mode)

    def certificate(self, value: float, y: Array) -> Array:
        """(Q,) of the certificate that is `value` at its mode y (N, n), `stability.certificate.worst_case`."""
        here, n, solved = self.here, self.n, self.here.mesh.collocated
        if value >= FLAT:
            return np.zeros(self.size)
        worst = mapped(worst_function(n), len(y))(self.problem.stiffness, self.problem.moment, y)[0]
        pull = np.zeros(here.phase.shape)
        pull[solved] = (worst.reshape(-1, n, n) @ y[..., None]).reshape(-1, here.degree, n)
        softness = 1 / (1 - value)
        return self._quotient(here.pulled(pull, softness), softness, worst=True)

    @property
    def _softened(self) -> Array:
        """(Q,) by how much the margin of an arm of length zero falls with what leaves the plate: the largest eigenvalue
        of -dM/dtheta over the stiffness of the transmissions, which alone twist there, or 0."""
        count, root = len(self._strips.index), np.sqrt(self.here.transmission)
        slope = self._sections_there[0].by_torque[..., : self.n] * self._strips.there[:, None, None]
        second = -root[:, None] * (slope[:count] - slope[count:]) * root
        return np.asarray(np.linalg.eigvalsh(np.tensordot(self._widths.T, second, 1)).max(1, initial=0.0))

    def per_tube(self, columns: Array) -> Array:
        """Every tube has a carriage of its own."""
        return columns

    def _form(
        self, given: Sequence[Array], softness: float, *, worst: bool, data: bool = False
    ) -> tuple[Array, Array, Array]:
        """What a mode has of the second variation per length (X,) at theta, kb, m, b, with g and y, its gradient
        (X, n + 4) by theta, b, g and, where there are `data`, (X, 2 n) by kb and m; at the equilibrium or at the
        `worst` rotations."""
        count, n = given[0].shape
        if worst:
            _, form, slope, _ = mapped(worst_function(n), count)(given[1], given[2], given[5])
            return form[:, 0].copy(), np.zeros((count, n + 4)), slope.reshape(count, 2 * n).copy()
        form, slope = (part.copy() for part in bent_function("mode", count, n)(*given, softness))
        own = bent_function("mode_data", count, n)(*given, softness)[0].copy() if data else np.zeros((count, 2 * n))
        return form[:, 0], slope.reshape(count, -1), own.reshape(count, -1)

    def _quotient(self, mode: Response, softness: float, *, worst: bool = False) -> Array:
        """(Q,) of a least eigenvalue of the second variation, from its mode."""
        here, forcing, n, size = self.here, self._given[0], self.n, self.size
        weights, torque = here.weights, mode.torque[..., 0]
        y, felt = mode.phi[..., 0], mode.bent[..., 0]
        count, data = len(here.at.energy), bool(forcing.data.any())
        flat = (here.theta, here.stiffness, here.moments, here.bent, felt, y)
        tables = [table.reshape(count, -1) for table in flat]
        _, slope, own = self._form(tables, softness, worst=worst, data=data)
        by = weights.ravel()[:, None] * slope
        out = np.zeros(size) if worst else by[:, :n].ravel() @ self.response.phi.reshape(-1, size)
        if data:
            whole = np.concatenate([by[:, :n], weights.ravel()[:, None] * own], axis=1)
            out += whole.ravel() @ forcing.data.reshape(-1, size)
        if here.load is not None:
            out += self._carried(mode, by)
        out -= softness * (weights[..., None] * torque**2).ravel() @ forcing.rate.reshape(-1, size)
        held = mode.state[0, n + 3 : 2 * n + 3, 0]
        out -= softness * held**2 @ forcing.transmission
        out += self._mode_gains(mode, softness, worst=worst) @ self._widths
        return np.asarray(out / here.elastic(mode, softness))

    def _carried(self, mode: Response, by: Array) -> Array:
        """(Q,) what the change of forces, moments and of the frame adds to it, with the gradient (X, n + 4)."""
        here, moved, n, size = self.here, self.response, self.n, self.size
        psi, moment = mode.psi[..., 0], mode.moment[..., 0]
        out = by[:, n : n + 2].ravel() @ moved.bent.reshape(-1, size)
        across = (here.frame[..., :2] @ by[:, n + 2 :].reshape(here.pieces, here.degree, 2, 1))[..., 0]
        turns = hat(psi)
        twice = here.weights[..., None, None] * (turns @ turns)
        # g = (R'(dm + m x psi))_xy: by the moment, of which half is the costate's, and by the turn of the frame.
        whole = moment - (turns @ here.moment[..., None])[..., 0]
        out += ((turns @ across[..., None])[..., 0] / 2).ravel() @ moved.moment.reshape(-1, size)
        turning = cross(across, whole) - cross(here.axis, (twice @ here.force[..., None])[..., 0])
        out += turning.ravel() @ moved.psi.reshape(-1, size)
        return np.asarray(out - (twice @ here.axis[..., None]).ravel() @ self._given[0].force.reshape(-1, size))

    def _mode_gains(self, mode: Response, softness: float, *, worst: bool) -> Array:
        """(T,) what the margin gains per width of a strip."""
        here, points, n = self.here, self._strips, self.n
        index, count = points.index, len(points.index)
        if not count:
            return np.zeros(0)
        frame, state = here.end_frame[index], mode.state[index, :, 0]
        y, psi, torque, moment = state[:, :n], state[:, n : n + 3], state[:, n + 3 : 2 * n + 3], state[:, 2 * n + 3 :]
        turns, ahead = hat(psi), (here.moment_ahead if self.side < 0 else here.moment_behind)[index]
        whole = moment - (turns @ ahead[..., None])[..., 0]
        felt = (frame[..., :2].swapaxes(1, 2) @ whole[..., None])[..., 0]
        _, rate, given = self._sections_there
        both = (np.concatenate([part, part]) for part in (felt, y))
        form = self._form([*given, *both], softness, worst=worst)[0]
        lean = (self._force_there * (turns @ turns @ frame[..., 2:])[..., 0]).sum(1)
        twisted = torque**2
        density = form - softness * (rate * np.concatenate([twisted, twisted])).sum(1) - np.concatenate([lean, lean])
        density = density * points.there
        return np.asarray(self.side * (density[:count] - density[count:]))


def _parts(table: Array) -> tuple[Array, Array, Array, Array]:
    """theta, kb, m (X, n) and b (X, 2) of a table (X, 3 n + 2)."""
    n = table.shape[1] // 3
    return table[:, :n], table[:, n : 2 * n], table[:, 2 * n : 3 * n], table[:, 3 * n :]


def _combined(columns: Array, along: Array) -> Array:
    """(..., Q) along directions (L, Q), of (..., L)."""
    return np.asarray((columns.reshape(-1, len(along)) @ along).reshape(*columns.shape[:-1], along.shape[1]))


def _at(weights: Array, values: Array) -> Array:
    """(r, Q) at a place, by weights (K,) of what is at the points (K, r, Q)."""
    return np.asarray(weights @ values.reshape(len(values), -1)).reshape(values.shape[1:])


@lru_cache(maxsize=64)
def _held(assembly: Assembly, side: int) -> Array:
    """(n,) 1 / kt of the tubes at the plate, on the side from which they move; with `side` 0 where they are held."""
    table = assembly.lengthwise
    if table is None:
        return np.asarray(1 / assembly.torsional_stiffness)
    at = assembly.transmission[None] * abs(side)
    return np.asarray(1 / table.values(at, at - side * ROUND_OFF)[1, 0])


@lru_cache(maxsize=64)
def passing(problem: ReducedProblem) -> tuple[Array, ...]:
    """(P, K, n) rates of phase, kb, m and 1 / kt along tubes made of pieces, at the points."""
    table, mesh, shape = problem.assembly.lengthwise, problem.mesh, problem.here.rate.shape
    assert table is not None
    nodes = mesh.tableau.nodes
    s, inside = (
        (mesh.start[:, None] + mesh.length[:, None] * x).ravel()[:, None] + problem.assembly.transmission
        for x in (nodes, nodes + INWARDS * (0.5 - nodes))
    )
    kb, kt, x, y, z, _ = (part.reshape(shape) for part in table.values(s, inside))
    dkb, dkt, dx, dy, _, _ = (part.reshape(shape) for part in table.rates(s, inside))
    there, size = problem.here.sections.stiffness.reshape(shape) > 0, np.hypot(x, y)
    solid = np.where(size > 0, size, 1.0)
    turning, growing = (x * dy - y * dx) / solid**2, (x * dx + y * dy) / solid
    return z + turning, dkb * there, (dkb * size + kb * growing) * there, -dkt / kt**2


TIP = 1e-9
"""Distance (m) from the tip up to which a force acts at it."""


@lru_cache(maxsize=8)
def mode_of(here: Standing, margin: float, one_of_two: bool) -> tuple[Response, float] | None:
    """See `Standing.mode`."""
    return here.mode(margin, one_of_two=one_of_two)


def linearise(
    equilibrium: Equilibrium,
    wrt: Sequence[str] = ("rotations", "translations"),
    side: int = 1,
    more: Callable[[Linearised], Sequence[Change]] | None = None,
    along: Array | None = None,
) -> Linearised:
    """Derivatives of an equilibrium of concentric tubes; see `Linearised`.

    Raises:
        InputError: friction acts on it.
        SolveError: it is a fold.
    """
    check_wrt(wrt, side)
    refuse_friction(equilibrium)
    if abs(equilibrium.margin) < APART:
        raise SolveError("the equilibrium is a fold (margin 0), where derivatives are infinite")
    tubes = equilibrium.robot.tubes
    straight = "curvature" in wrt and not all(tube.curvature for tube in tubes)
    return Linearised(standing_of(equilibrium, straight), tubes, equilibrium.margin, wrt, side, more, along)


def sharing(carriages: Sequence[Sequence[int]], wrt: Sequence[str]) -> Array | None:
    """(L, L) directions in which tubes of a carriage move together, equal parts of the motion each; None where every
    tube has a carriage of its own. The chain rule holds for every motion that is possible."""
    if "translations" not in wrt or all(len(tubes) == 1 for tubes in carriages):
        return None
    n = sum(len(tubes) for tubes in carriages)
    along, first = np.eye(n * len(wrt)), n * list(wrt).index("translations")
    for tubes in carriages:
        own = first + np.array(tubes)
        along[np.ix_(own, own)] = 1 / len(tubes)
    return along


@lru_cache(maxsize=8)
def standing_of(equilibrium: Equilibrium, straight: bool = True) -> Standing:
    """The arm of an equilibrium of concentric tubes, on the mesh on which it was solved; `straight` as there."""
    robot, shift = equilibrium.robot, tuple(equilibrium.translations.tolist())
    if equilibrium.load is None:
        problem, burden = reduced_problem(robot, shift, discretisation_of(equilibrium)), None
    else:
        loaded = loaded_problem(robot, shift, equilibrium.load, discretisation_of(equilibrium))
        problem, burden = loaded.torsion, Burden(loaded.load, loaded.force, loaded.couples)
    solved = sample_rotation(equilibrium, problem.arc_length)
    return Standing(problem, equilibrium.rotations, solved, equilibrium.arm, burden=burden, straight=straight)
