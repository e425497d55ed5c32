"""An adjustable mold: pegs on a board that is drilled once hold tubes of any planar shape (SI).

Holes lie on a square lattice that stands on its corner. A peg is a disk on a shank, with a slender pin off its axis:
turned in its hole, the pin goes around a circle, and so comes to touch the tube wherever a hole is near enough. Pegs
stand on both sides of the tube; between them it takes the shape of a beam (`held`).

Frame: the origin is the lower left corner of the board, x to the right, y up. Angles of pegs count from x to y.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ...constants import STEFAN_BOLTZMANN
from ...display import Displayed
from ...errors import InputError, instance
from ...physics.heat import heat_to_air
from ...robots.tubes import Tube
from ...typing import Array, StatusEnum
from ..heating.groove_air import STANDOFF
from ..heating.rig import air_conductivity, natural_convection
from ..recipes import mold_remarks
from .arcs import bend_of
from .beam import Held, held_between
from .checks import held_in_plane, refuse_failed, springback_remarks, strain_check
from .groove import Arc, Centreline, Point, bounds, crosses_itself, with_leads
from .heat import ColdEnd, HeatSpec, fin, thermal_data
from .lattice import Lattice, Peg, Sampled
from .spec import MoldSpec


class PegStatus(StatusEnum):
    """Whether pegs hold a tube on its curve; every value reads as a sentence."""

    HELD = "the deviation of the tube from its curve is within the limit"
    LEFT = "the deviation of the tube from its curve between pegs exceeds the limit"


@dataclass(frozen=True)
class PegStatistics:
    """Holes of the board, pegs that touch the tube, and remarks."""

    holes: int
    pegs: int
    remarks: int


@dataclass(frozen=True, eq=False)
class PegBoard(Displayed):
    """Pegs that hold one tube."""

    number: int
    """Of the tube, for texts."""
    tube: Tube
    """What it is to become."""
    spec: MoldSpec
    """What was asked for."""
    size: Point
    """Of the board, m."""
    holes: dict[str, Point]
    """All that are drilled, m, by their names."""
    centreline: Centreline
    """Wanted, from clamp to clamp."""
    held: Held
    """How the tube lies."""
    pegs: tuple[Peg, ...]
    """Those that touch, along the tube."""
    kept: tuple[float, float]
    """Arc lengths from the proximal clamp between which the tube is not cut off, m."""
    cold: ColdEnd
    """The cold end of the tube in air; its length is that of the specification where one is given."""
    heat: PegHeat
    """What the pegs draw, in their order."""
    remarks: tuple[str, ...]
    """What to keep in mind."""

    @property
    def value(self) -> tuple[Peg, ...]:
        """The pegs."""
        return self.pegs

    @property
    def status(self) -> PegStatus:
        """Whether they hold the tube."""
        return PegStatus.LEFT if self.deviation > self.spec.pegs.most_deviation else PegStatus.HELD

    @property
    def statistics(self) -> PegStatistics:
        """What it has."""
        return PegStatistics(len(self.holes), len(self.pegs), len(self.remarks))

    @property
    def deviation(self) -> float:
        """Greatest distance of the tube from its curve, m, as far as it is kept."""
        return _worst(self.held.offset, self.held.arc_length, self.kept)

    @property
    def heading_deviation(self) -> float:
        """Greatest angle between the tube and its curve, rad, as far as it is kept."""
        return _worst(np.gradient(self.held.offset, self.held.arc_length), self.held.arc_length, self.kept)

    @cached_property
    def free_length(self) -> float:
        """Length of tube between the clamps, m."""
        return self.centreline.length


def plan_pegs(tube: Tube, mold: MoldSpec | None = None, *, number: int = 1) -> PegBoard:
    """Pegs that hold a tube on the curve from which it springs back to its shape.

    As few as keep the tube within `most_deviation` of that curve; where none do, those that keep it nearest.

    Args:
        tube: a planar one. mold: `pegs`, spring-back, heat and clamps are looked at. number: of the tube, for texts.

    Raises:
        InputError: a tube without a curved part, a space curve, one strained too far, one that crosses itself, or a
            board that is too small.
    """
    spec = MoldSpec() if mold is None else mold
    instance("mold", spec, MoldSpec)
    instance("tube", tube, Tube)
    held = held_in_plane(number, tube, spec, "pegs hold")
    remedy = "set it in steps, on wider curves first"
    refuse_failed([strain_check(number, held, spec, "between its pegs", "between its pegs", remedy)])
    cold = tube_in_air(tube, spec.heat).of_length(spec.cold_length)
    bend, over = _going_on(bend_of(held, spec.solver), tube, spec.solver.pegs.overrun * spec.pegs.pitch)
    leads = [max(spec.clamps.least_lead, cold.length - x) for x in over]
    curve = with_leads(bend, *leads)
    # The straight part of the tube lies in the lead, or hangs out of the clamp.
    kept = max(0.0, leads[0] + over[0] - tube.straight_length), curve.length - leads[1] - over[1]
    if crosses_itself(curve, tube.outer_diameter + 2 * spec.pegs.pin):
        raise InputError(f"tube {number} comes too close to itself: there is no space for pegs")
    size, curve = _on_board(curve, spec, number)
    lattice = Lattice.of(size, spec.pegs, spec.solver.pegs.reach)
    worst, placed, pegs, lying = _pegged(curve, lattice, tube, spec, kept)
    conductance = pin_conductance(tube, spec.heat, spec.pegs.pin, spec.pegs.height, spec.pegs.conductivity)
    heat = peg_heat(tube, spec.heat, np.array([peg.arc_length for peg in pegs]), conductance)
    remarks = *_remarks(spec, worst, heat), *mold_remarks(tube.material, spec.heat.set_temperature)
    return PegBoard(number, tube, spec, size, lattice.named, placed, lying, pegs, kept, cold, heat, remarks)


def _pegged(
    curve: Centreline, lattice: Lattice, tube: Tube, spec: MoldSpec, kept: tuple[float, float]
) -> tuple[float, Centreline, tuple[Peg, ...], Held]:
    """Greatest deviation (m), the curve where it lies, the pegs that touch the tube, and how it lies."""
    pegging, solver = spec.pegs, spec.solver
    places = sorted(_shifts(curve, spec), key=lambda c: _unevenness(c, lattice, tube, spec))[: solver.pegs.places]
    found: list[tuple[float, Centreline, tuple[Peg, ...], Held]] = []
    for placed in places:
        every = lattice.all_pegs(Sampled.of(placed, solver.pegs.sampled), tube, pegging)
        for pitches in (6.0, 5.0, 4.0, 3.25, 2.75, 2.25, 1.75, 1.4, 1.0, 0.3):
            pegs = _chosen(every, placed.length, pegging.pitch, pitches * pegging.pitch, solver.pegs.room)
            lying = _held(placed, pegs, solver.pegs.element)
            found.append((_worst(lying.offset, lying.arc_length, kept), placed, pegs, lying))
            if found[-1][0] <= pegging.most_deviation:
                break
    good = [one for one in found if one[0] <= pegging.most_deviation]
    fewest = min(good, key=lambda one: int((one[3].force > 0).sum()), default=None)
    worst, placed, pegs, lying = fewest or min(found, key=lambda one: one[0])
    force = lying.force * float(tube.bending_stiffness)
    some = tuple(replace(peg, force=float(f)) for peg, f in zip(pegs, force, strict=True) if f > 0)
    return worst, placed, some, lying


def _worst(values: Array, s: Array, kept: tuple[float, float]) -> float:
    return float(np.abs(values[(s >= kept[0] - 1e-9) & (s <= kept[1] + 1e-9)]).max())


def _going_on(bend: Sequence[Arc], tube: Tube, length: float) -> tuple[list[Arc], tuple[float, float]]:
    """The bend, longer where the tube is cut off at its end, and by how much at either end, m."""
    pieces, over = list(bend), [0.0, 0.0]
    for end in (0, -1):
        last = pieces[end]
        if not last.curvature or (end == 0 and tube.straight_length > 0):
            continue
        back = length if end == 0 else 0.0
        x, y = last.point(np.array([-back]))[0].tolist()
        pieces[end] = Arc((x, y), last.heading - back * last.curvature, last.length + length, last.curvature)
        over[end] = length
    return pieces, (over[0], over[1])


def _on_board(curve: Centreline, spec: MoldSpec, number: int) -> tuple[Point, Centreline]:
    """Size of the board and the curve in its middle."""
    low, high = bounds(curve.pieces)
    need = [b - a + 4 * spec.pegs.pitch for a, b in zip(low, high, strict=True)]
    if spec.pegs.board is None:
        step = spec.pegs.pitch
        size = math.ceil(need[0] / step) * step, math.ceil(need[1] / step) * step
    else:
        size = spec.pegs.board
        if any(side < n for side, n in zip(size, need, strict=True)):
            raise InputError(
                f"board of the pegs is {size[0] * 1e3:g} x {size[1] * 1e3:g} mm; tube {number} with its cold ends and "
                f"its pegs needs {need[0] * 1e3:.0f} x {need[1] * 1e3:.0f} mm"
            )
    return size, curve.moved((0.5 * (size[0] - low[0] - high[0]), 0.5 * (size[1] - low[1] - high[1])))


def _shifts(curve: Centreline, spec: MoldSpec) -> list[Centreline]:
    """The curve at places of one cell of the lattice around the middle of the board."""
    count, pitch = spec.solver.pegs.shifts, spec.pegs.pitch
    steps = (np.arange(count) - count // 2) / count
    return [
        curve.moved((float(x * math.sqrt(2) * pitch), float(y * pitch / math.sqrt(2)))) for x in steps for y in steps
    ]


def _unevenness(curve: Centreline, lattice: Lattice, tube: Tube, spec: MoldSpec) -> float:
    """The longest stretch (m) without a hole that serves, on either side."""
    sampled = Sampled.of(curve, 5 * spec.solver.pegs.sampled)
    gaps = []
    for side in (1, -1):
        s = np.sort(lattice.serving(sampled, tube, spec.pegs, side)[1])
        gaps.append(np.diff(np.concatenate([[0.0], s, [curve.length]])).max())
    return float(max(gaps))


def _chosen(pegs: Sequence[Peg], length: float, margin: float, spacing: float, room: float) -> tuple[Peg, ...]:
    """Of all pegs those on either side in turn, on one side about a spacing (m) apart, that leave the least room:
    `room` (m) is as bad as a whole spacing along the tube."""
    found: dict[str, Peg] = {}
    count = max(2, round((length - 2 * margin) / spacing) + 1)
    for left in (True, False):
        for k in range(count):
            target = margin + (k + 0.5 * (not left)) * (length - 2 * margin) / count
            some = [p for p in pegs if p.left == left and p.hole not in found and abs(p.arc_length - target) <= spacing]
            if some:
                best = min(some, key=lambda p: abs(p.arc_length - target) / spacing + p.room / room)
                found[best.hole] = best
    return tuple(sorted(found.values(), key=lambda peg: peg.arc_length))


def _held(curve: Centreline, pegs: Sequence[Peg], element: float) -> Held:
    return held_between(
        np.array([piece.length for piece in curve.pieces]),
        np.array([piece.curvature for piece in curve.pieces]),
        np.array([peg.arc_length for peg in pegs]),
        np.array([1.0 if peg.left else -1.0 for peg in pegs]),
        np.array([peg.room for peg in pegs]),
        element=element,
    )


def _remarks(spec: MoldSpec, worst: float, heat: PegHeat) -> tuple[str, ...]:
    found = []
    if worst > spec.pegs.most_deviation:
        found.append(
            f"between its pegs the tube leaves its curve by {1e3 * worst:.3f} mm, more than the "
            f"{1e3 * spec.pegs.most_deviation:g} mm asked for: a smaller pitch, or steps of the angle, would help"
        )
    dip = float(heat.dip.max(initial=0.0))
    if dip > spec.heat.tolerance:
        found.append(
            f"heated by its own current, the tube is up to {dip:.0f} K colder at its pegs, more than the tolerance of "
            f"{spec.heat.tolerance:g} K: set it in a furnace, pegs and board with it, or take pins that conduct less"
        )
    return *found, *springback_remarks(spec)


# --- heat -------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class PegHeat:
    """What pegs make of the tube's temperature."""

    dip: Array
    """(M,) by which the tube is colder at each peg than without any, K."""
    drawn: Array
    """(M,) heat into each, W."""
    decay_length: float
    """Of a cold spot along the tube, m."""
    loss: float
    """Of the tube to air, W/m."""


def tube_in_air(tube: Tube, heat: HeatSpec) -> ColdEnd:
    """The end of a tube in air as a fin, hot by its current; as `cold_end` of a mold."""
    data, hot, cold = thermal_data(tube), heat.set_temperature, heat.ambient
    convection = natural_convection(tube.outer_diameter, hot, cold)
    return fin(tube, heat, heat_to_air(hot, cold, convection, data.emissivity * STEFAN_BOLTZMANN) / heat.rise)


def pin_conductance(tube: Tube, heat: HeatSpec, pin: float, height: float, conductivity: float) -> float:
    """W/K from a tube into the board through a pin of this diameter (m), conductivity (W/(m K)) and height (m).

    That of the air around the place where two crossed cylinders touch, in series with what the pin resists: heat
    spreads from the place of contact into it and goes down to the board, which stays cold, so that it is an upper
    bound. Air between cylinders of radii a and b that cross at right angles, with their roughness d between them,
    conducts 2 pi k sqrt(a b) ln(1 + min(a, b) / (2 d)) up to where the gap has grown by half of the smaller radius.
    """
    a, b = 0.5 * tube.outer_diameter, 0.5 * pin
    air = air_conductivity(0.5 * (heat.set_temperature + heat.ambient))
    contact = 2 * math.pi * air * math.sqrt(a * b) * math.log1p(min(a, b) / (2 * STANDOFF))
    spreading = 1 / (4 * conductivity * math.sqrt(a * b))
    down = height / (conductivity * math.pi * b**2)
    return 1 / (1 / contact + spreading + down)


def peg_heat(tube: Tube, heat: HeatSpec, places: Array, conductance: float) -> PegHeat:
    """Cold spots of pegs at `places` (M,), m, along the tube, each of this conductance (W/K); steady.

    The tube is a fin in air, warm by its current as a whole; every peg is a sink at a point.
    """
    end = tube_in_air(tube, heat)
    girth = math.pi * tube.outer_diameter
    # A heat of 1 W makes the tube colder by this where it is drawn.
    one = 1 / (2 * end.loss_coefficient * girth * end.decay_length)
    spots = one * np.exp(-np.abs(places[:, None] - places) / end.decay_length)
    drawn = np.linalg.solve(np.eye(len(places)) / conductance + spots, np.full(len(places), heat.rise))
    return PegHeat(spots @ drawn, drawn, end.decay_length, end.loss_coefficient * girth * heat.rise)
