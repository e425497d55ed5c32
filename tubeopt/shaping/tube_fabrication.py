"""Mold and heating of one tube, planned for each other: what is heated is what the mold holds.

The rig's file says how the mold is to lie around the tube; plate, cutters and clamps decide how it does. So the mold is
drawn first, and the heating is planned on the rig *as drawn*: with its leads, gaps, groove, plate and vents. What the
heating then knows better (where the cold ends stop, how far the tube grows, how warm the clamps get) goes back into the
mold, until nothing changes any more.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ..constants import ZERO_CELSIUS
from ..errors import InputError, without_unit_warnings
from ..robots.materials import NITINOL
from ..robots.tubes import Tube
from .heating.counts import full_current
from .heating.plan import HeatingPlan, ageing_words
from .heating.planning import plan_heating
from .heating.rig import Rig
from .heating.spec import HeatingSpec
from .heating.thermal import gap_of, gap_transfer, groove_gap, own_gap, vent_profile
from .materials import recipe_for
from .mold.heat import heating_for
from .mold.layout import open_area
from .mold.mold import Groove, Mold, plan_mold
from .mold.spec import GrooveSpec, MoldSpec

# Each mold moves the leads by what the last heating said: the correction is a fixed point, and shrinks each time.
MOLDS = 5
"""Molds that are drawn at most."""

# A tenth of what a mill is set to.
SAME_LENGTH = 1e-5
"""Lengths of mold and heating that differ by less are equal, m."""

# A cold end is read from cells of about a millimetre.
LONGER_LEAD = 1e-3
"""Length of the leads beyond cold ends that reach into the curved part, m."""

# The next plate rounds lengths, which moves the resistance by up to a percent or two.
LEAD_PEAK = 0.98
"""Share of the circuit's peak current for which leads are made longer, where a shorter tube would draw more."""

VENT_PLACES = 41
"""Places from the end of the mold to its middle at which the rig as drawn says how far it is vented."""


@dataclass(frozen=True)
class Known:
    """What heating tells the mold: length of the cold ends and growth of the tube, m; temperature of the clamps, K."""

    cold_length: float
    growth: float
    clamps: float


@dataclass(frozen=True, eq=False)
class TubeFabrication:
    """Mold and heating of one tube."""

    tube: Tube
    """The tube to make."""
    mold: Mold
    """Mold with one groove for the tube."""
    rig: Rig
    """The rig with the mold as drawn."""
    heating: HeatingPlan
    """Planned on it, of the tube with a curved part as long as the bend."""
    rounds: int
    """Molds that were drawn."""
    disagreement: str
    """Differences between mold and heating, as text; "" without any."""
    remarks: tuple[str, ...] = ()
    """Remarks for making it."""

    @property
    def groove(self) -> Groove:
        """The groove of the tube."""
        return self.mold.grooves[0]

    @property
    def agreed(self) -> bool:
        """True if mold and heating are for one rig, and the mold has what the heating needs."""
        return not self.disagreement


def plan_tube(
    tube: Tube, rig: Rig, mold: MoldSpec | None = None, heating: HeatingSpec | None = None, *, number: int = 1
) -> TubeFabrication:
    """Mold and heating of one tube on one rig, planned for each other.

    Args:
        tube: the tube to make.
        rig: the rig. Its material, clamps, side clearance, leads and vents take precedence over those of `mold`.
        mold: other requirements on the mold; None takes the defaults of `MoldSpec`.
        heating: requirements on the heating; None takes set temperature, tolerance and hold from `mold.heat`.
        number: number of the tube, for texts.

    Raises:
        InputError: no mold is possible for the rig's leads, tube and rig do not fit, or there is no recipe for the
            tube's material.
        SolveError: the optimal control problem of the heating did not converge.
    """
    asked = MoldSpec() if mold is None else mold
    heating = heating_for(asked.heat) if heating is None else heating
    heated, remarks = _with_thermal_data(tube)
    remarks += _air(heated, rig)
    on, known, plan, drawn = rig, None, None, None
    for round_ in range(1, MOLDS + 1):
        try:
            following = plan_mold(heated, mold_spec_for(on, heated, asked, heating, known, rig), numbers=[number])
        except InputError as error:
            if drawn is None or plan is None:
                raise
            return TubeFabrication(tube, drawn, on, plan, round_ - 1, f"{_needed(plan)}: {error}", remarks)
        drawn, before, on = following, on, rig_as_drawn(rig, following)
        if plan is None or not _alike(before, on):
            # As it lies in its groove: bent so, its curved part as long as the bend.
            plan = plan_heating(following.grooves[0].held, on, heating)
        elif _settled(drawn, plan):
            return TubeFabrication(tube, drawn, on, plan, round_, "", (*remarks, *ageing_words(plan)))
        known = _known(drawn.grooves[0], plan, heating)
    assert drawn is not None
    assert plan is not None
    short = plan.cold_end > _lead_and_gap(drawn.grooves[0]) + SAME_LENGTH
    words = _needed(plan) if short else "the mold as drawn still changes"
    return TubeFabrication(tube, drawn, on, plan, MOLDS, f"{words} after {MOLDS} rounds", remarks)


def mold_spec_for(
    rig: Rig, tube: Tube, spec: MoldSpec, heating: HeatingSpec, known: Known | None, asked: Rig
) -> MoldSpec:
    """The mold's specification in line with the rig on which it is heated: material, groove, clamps, lead, vents, heat.

    Args:
        rig: as drawn so far. tube: that is heated. spec: what else is asked of the mold.
        heating: what the tube is heated for.
        known: from the heating. asked: the rig as given, whose leads are the least.
    """
    least = max(asked.mold.lead, spec.clamps.least_lead)
    clamps = replace(spec.clamps, gap=asked.clamps.clearance, grip=asked.clamps.grip, least_lead=least)
    low, high = heating.window_degC
    heat = replace(
        spec.heat,
        set_temperature=0.5 * (low + high) + ZERO_CELSIUS,
        tolerance=0.5 * (high - low),
        hold_time=heating.hold_time,
        ambient=rig.ambient,
        contact_conductance=gap_transfer(tube, rig),
        clamp_temperature=None if known is None else known.clamps,
    )
    vents = replace(spec.vents, profile=lid_profile(replace(rig, mold=replace(rig.mold, vents=asked.mold.vents)), tube))
    return replace(
        spec,
        material=rig.mold.material,
        groove=_groove_for(asked, tube, spec),
        clamps=clamps,
        cold_length=asked.clamps.clearance + asked.mold.lead if known is None else known.cold_length,
        growth=None if known is None else known.growth,
        heat=heat,
        vents=vents,
    )


def _groove_for(rig: Rig, tube: Tube, spec: MoldSpec) -> GrooveSpec:
    """A groove with the rig's side clearance on either side of the tube; wider only where no end mill is as small."""
    play = 2 * rig.mold.play
    fits = spec.milling.end_mills[0].diameter <= tube.outer_diameter + play
    most = play if fits else max(play, spec.groove.most_clearance)
    return replace(spec.groove, clearance=play, most_clearance=most)


def lid_profile(rig: Rig, tube: Tube) -> tuple[float, ...]:
    """Open part of the groove's area in cells along the bend, from the rig's open part of the tube's surface.

    A vent bares the upper half of the tube below it, so that the groove is open over twice the part of the surface.
    """
    if not any(rig.mold.vents):
        return (0.0,)
    ends = np.linspace(0.0, 1.0, 2 * 5 + 1)
    middle = 0.5 * (ends[1:] + ends[:-1])
    half = 0.5 * tube.curved_length
    inward = (rig.mold.lead + half * (1 - np.abs(2 * middle - 1))) / (rig.mold.lead + half)
    return tuple((2 * vent_profile(rig, inward)).tolist())


@without_unit_warnings()
def rig_as_drawn(rig: Rig, mold: Mold) -> Rig:
    """The rig with a mold of one groove: leads, distance of the clamps, gap, plates and vents as they are drawn."""
    groove, plate = mold.grooves[0], mold.spec.plate
    curve = groove.centreline
    bed = replace(
        rig.mold,
        lead=0.5 * (curve.lead_in.length + curve.lead_out.length),
        side_clearance=0.5 * (groove.width - groove.tube.outer_diameter),
        gap=_gap_as_drawn(rig, groove),
        # As much material as lies around the groove, over its length.
        width=mold.size[0] * mold.size[1] / curve.length,
        thickness=plate.thickness + plate.lid_thickness,
        vents=drawn_vents(groove, mold.spec),
    )
    return replace(rig, mold=bed, clamps=replace(rig.clamps, clearance=0.5 * sum(groove.gaps), grip=groove.grip))


def _gap_as_drawn(rig: Rig, groove: Groove) -> float:
    """Even gap (m) of the groove as drawn; a gap that the rig's file says keeps its ratio to that of its own groove."""
    drawn = groove_gap(groove.tube, rig, groove.width, groove.depth)
    return drawn if rig.mold.gap is None else rig.mold.gap * drawn / own_gap(groove.tube, rig)


def drawn_vents(groove: Groove, spec: MoldSpec) -> tuple[float, ...]:
    """Part of the tube's surface that the drawn vents bare, from the end of the mold (no vents there) to its middle."""
    if not groove.vents:
        return (0.0,)
    profile = np.asarray(spec.vents.profile)
    wanted = groove.width * groove.bend_length * float(profile.mean())
    opened = len(groove.vents) * open_area(groove.width, spec.vents.diameter) / wanted
    lead, half = groove.centreline.lead_in.length, 0.5 * groove.bend_length
    along = np.linspace(0.0, lead + half, VENT_PLACES) - lead
    cell = np.clip((along / (2 * half) * len(profile)).astype(int), 0, len(profile) - 1)
    part = np.where(along >= 0, 0.5 * opened * profile[cell], 0.0)
    return tuple(np.minimum(part, 0.5).tolist())


def _with_thermal_data(tube: Tube) -> tuple[Tube, tuple[str, ...]]:
    recipe_for(tube.material)
    if tube.material.thermal is not None:
        return tube, ()
    words = f"thermal constants of {tube.material.name} are not known; mold and heating take those of nitinol"
    return replace(tube, material=replace(tube.material, thermal=NITINOL.thermal)), (words,)


def _air(tube: Tube, rig: Rig) -> tuple[str, ...]:
    """Whether the even gap that the rig's file says is that of its groove."""
    said, computed = gap_of(tube, rig), own_gap(tube, rig)
    if abs(said / computed - 1) < 0.25:
        return ()
    return (
        f"gap_um of the rig file is {1e6 * said:.0f} um. A groove with {1e6 * rig.mold.play:.0f} um on each side of "
        f"this tube has a uniform gap of {1e6 * computed:.0f} um. Remove gap_um unless it comes from a log (tubeopt "
        "heat calibrate)",
    )


def _known(groove: Groove, plan: HeatingPlan, spec: HeatingSpec) -> Known:
    """What the heating tells the next mold; leads that are too short, or let too much current flow, get longer."""
    held, end = _lead_and_gap(groove), plan.cold_end
    if math.isinf(end):
        # The whole tube is cold, for which no lead helps.
        end = groove.cold.length
    hot = int(np.flatnonzero(plan.in_hold)[-1])
    clamps = float(plan.clamp_temperature[hot]) + ZERO_CELSIUS
    # The plate makes leads longer than they are asked to be, by as much again next time.
    asked = groove.cold.length + _length_for_peak(plan, spec) - held
    return Known(max(end if end <= held + SAME_LENGTH else end + LONGER_LEAD, asked), plan.growth, clamps)


def _length_for_peak(plan: HeatingPlan, spec: HeatingSpec) -> float:
    """Length (m) from clamp to bend with which the cold tube draws what the circuit bears; 0 where that is too long.

    The current is greatest through the cold tube at rest, whose resistance grows as its length.
    """
    tube, rig = plan.tube, plan.rig
    now, most = full_current(tube, rig, leaking=False), LEAD_PEAK * rig.circuit.peak_limit
    whole = tube.curved_length + 2 * (rig.mold.lead + rig.clamps.clearance)
    ohm = rig.battery.voltage / now - rig.battery.internal_resistance - rig.circuit.resistance
    needed = whole * (1 + rig.battery.voltage * (1 / most - 1 / now) / ohm)
    each = 0.5 * (needed - tube.curved_length)
    return each if each - rig.clamps.clearance <= spec.lead_range[1] else 0.0


def _lead_and_gap(groove: Groove) -> float:
    """Length (m) of tube from a clamp to the bend."""
    return groove.gaps[0] + groove.centreline.lead_in.length


def _alike(a: Rig, b: Rig) -> bool:
    """Whether two rigs as drawn are the same to the heating, to lengths of `SAME_LENGTH`."""
    lengths = [abs(getattr(a.mold, name) - getattr(b.mold, name)) for name in ("lead", "gap", "width", "thickness")]
    lengths.append(abs(a.clamps.clearance - b.clamps.clearance))
    vents = (vent_profile(rig, np.linspace(0.0, 1.0, VENT_PLACES)) for rig in (a, b))
    return max(lengths) < SAME_LENGTH and float(np.abs(next(vents) - next(vents)).max()) < SAME_LENGTH


def _settled(mold: Mold, plan: HeatingPlan) -> bool:
    """Whether the mold holds what the plan heats, and was drawn with what the plan knows."""
    groove = mold.grooves[0]
    uneven = abs(groove.centreline.lead_in.length - groove.centreline.lead_out.length)
    differences = [groove.free_length - plan.free_length, uneven, groove.growth - plan.growth]
    short = 0.0 if math.isinf(plan.cold_end) else plan.cold_end - _lead_and_gap(groove)
    return max(abs(x) for x in differences) < SAME_LENGTH and short < SAME_LENGTH


def _needed(plan: HeatingPlan) -> str:
    need = 1e3 * (plan.cold_end + LONGER_LEAD)
    have = 1e3 * (plan.rig.clamps.clearance + plan.rig.mold.lead)
    return f"the heating needs {need:.1f} mm from clamp to bend, the mold has {have:.1f} mm"
