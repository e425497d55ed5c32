"""Mold and heating of one tube, planned for each other by fixed-point iteration.

The rig's file has the desired mold around the tube; plate, cutters and clamps determine the real one. So the mold is
planned first, and then the heating on the rig *as drawn*, with the leads, gaps, groove, plate and vents of the mold.
Results of the heating (length of the cold ends, growth of the tube, temperature of the clamps) go back into the mold,
until nothing changes.
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
from .heating.plan import HeatingPlan, ageing_remarks
from .heating.planning import plan_heating
from .heating.rig import Rig
from .heating.robust import BARE_STEP, SHORTEST_BARE, longest_bare_tube
from .heating.sensors import thermocouple_for
from .heating.spec import HeatingSpec
from .heating.thermal import gap_transfer, groove_gap, square_groove_gap, uniform_gap_of, vent_profile
from .materials import recipe_for
from .mold.heat import heating_for
from .mold.layout import open_area
from .mold.mold import Groove, Mold, plan_mold
from .mold.spec import MoldSpec

# The corrections of the leads shrink from mold to mold.
MAX_ROUNDS = 6
"""Largest number of molds."""

# A tenth of the resolution of a mill.
SAME_LENGTH = 1e-5
"""Difference below which lengths of mold and heating are equal, m."""

# A cold end is read from cells of about a millimetre.
LEAD_RESERVE = 1e-3
"""Length of the leads beyond cold ends that reach into the curved part, m."""

# The next plate rounds lengths, which changes the resistance by up to a percent or two.
PEAK_FRACTION = 0.98
"""Fraction of the circuit's peak current for lengthened leads; a shorter tube would draw more."""

VENT_POINTS = 41
"""Number of points from the end of the mold to its middle of the vent profile as drawn."""


@dataclass(frozen=True)
class HeatingFeedback:
    """Results of a heating plan that the next mold must fit."""

    cold_length: float
    """Length of tube from a clamp to the heated part, m."""
    growth: float
    """Thermal expansion of the tube, m."""
    T_clamp: float
    """Temperature of the clamps, K."""


@dataclass(frozen=True, eq=False)
class TubeFabrication:
    """Mold and heating of one tube."""

    tube: Tube
    """Tube to make."""
    mold: Mold
    """Mold with one groove for the tube."""
    rig: Rig
    """Rig with the mold as drawn."""
    heating: HeatingPlan
    """Heating on this rig, of the tube with a curved part as long as the bend."""
    rounds: int
    """Number of molds that were planned."""
    disagreement: str
    """Differences between mold and heating, as text; "" without any."""
    remarks: tuple[str, ...] = ()
    """Remarks for making it."""

    @property
    def groove(self) -> Groove:
        """Groove of the tube."""
        return self.mold.grooves[0]

    @property
    def marked_mold(self) -> Mold:
        """The mold, with a remark for its set-up sheet if it does not fit the heating."""
        unfit = () if self.agreed else (f"do not mill this mold: {self.disagreement}",)
        return replace(self.mold, remarks=(*unfit, *self.mold.remarks))

    @property
    def agreed(self) -> bool:
        """True if mold and heating are for the same rig, and the mold fits the heating."""
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
    spec = MoldSpec() if mold is None else mold
    heating = heating_for(spec.heat) if heating is None else heating
    heated, remarks = _with_thermal_data(tube)
    remarks += _gap_remarks(heated, rig)
    given, drawn_rig, drawn = rig, rig, None
    feedback: HeatingFeedback | None = None
    plan: HeatingPlan | None = None
    longest: float | None = None
    for round_ in range(1, MAX_ROUNDS + 1):
        try:
            next_spec = mold_spec_for(drawn_rig, heated, spec, heating, feedback, given)
            next_mold = plan_mold(heated, next_spec, numbers=[number])
        except InputError as error:
            if drawn is None or plan is None:
                raise
            return TubeFabrication(
                tube=tube,
                mold=drawn,
                rig=drawn_rig,
                heating=plan,
                rounds=round_ - 1,
                disagreement=f"{_required_lead(plan)}: {error}",
                remarks=remarks,
            )
        drawn, previous, drawn_rig = next_mold, drawn_rig, rig_as_drawn(rig, next_mold)
        if plan is None or not _same_rig(previous, drawn_rig):
            # The tube as its groove holds it: its curved part is as long as the bend.
            plan = plan_heating(drawn.grooves[0].held, drawn_rig, heating)
            if longest is None and rig.mold.material.electrically_insulating:
                longest = _longest_when_hot(plan)
                cold = max(longest - plan.growth, min(longest, SHORTEST_BARE))
                if 0 < cold < given.clamps.clearance:
                    given = replace(given, clamps=replace(given.clamps, clearance=cold))
        elif _consistent(drawn, plan):
            bare = _bare_disagreement(drawn_rig, longest)
            return TubeFabrication(
                tube=tube,
                mold=drawn,
                rig=drawn_rig,
                heating=plan,
                rounds=round_,
                disagreement=bare,
                remarks=(
                    *remarks,
                    *_bare_remarks(rig.clamps.clearance, drawn_rig, plan, longest),
                    *ageing_remarks(plan),
                ),
            )
        feedback = _heating_feedback(drawn.grooves[0], plan, heating)
    assert drawn is not None
    assert plan is not None
    too_short = plan.cold_end > _clamp_to_bend(drawn.grooves[0]) + SAME_LENGTH
    reason = _required_lead(plan) if too_short else "the mold as drawn still changes"
    return TubeFabrication(
        tube=tube,
        mold=drawn,
        rig=drawn_rig,
        heating=plan,
        rounds=MAX_ROUNDS,
        disagreement=f"{reason} after {MAX_ROUNDS} rounds",
        remarks=remarks,
    )


def mold_spec_for(
    rig: Rig, tube: Tube, spec: MoldSpec, heating: HeatingSpec, feedback: HeatingFeedback | None, given: Rig
) -> MoldSpec:
    """Specification of the mold with material, groove, clamps, lead, vents and heat of the rig.

    Args:
        rig: as drawn so far. tube: that is heated. spec: other requirements on the mold.
        heating: requirements on the heating.
        feedback: results of the last heating. given: rig of the user; its leads are the smallest.
    """
    smallest_lead = max(given.mold.lead, spec.clamps.least_lead)
    clamps = replace(spec.clamps, gap=given.clamps.clearance, grip=given.clamps.grip, least_lead=smallest_lead)
    low, high = heating.window_degC
    heat = replace(
        spec.heat,
        set_temperature=0.5 * (low + high) + ZERO_CELSIUS,
        tolerance=0.5 * (high - low),
        hold_time=heating.hold_time,
        ambient=rig.ambient,
        contact_conductance=gap_transfer(tube, rig),
        clamp_temperature=None if feedback is None else feedback.T_clamp,
    )
    vents = replace(spec.vents, profile=lid_profile(replace(rig, mold=replace(rig.mold, vents=given.mold.vents)), tube))
    # The rig's side clearance on either side of the tube; wider only if no end mill is that small.
    clearance = 2 * given.mold.play
    fits = spec.milling.end_mills[0].diameter <= tube.outer_diameter + clearance
    most_clearance = clearance if fits else max(clearance, spec.groove.most_clearance)
    # The wires that draw heat in the plan lie in the slot of the lid.
    slot = (
        replace(spec.slot, wire=rig.mold.wire, anchor=rig.mold.anchor)
        if rig.mold.wire and spec.slot.wire
        else spec.slot
    )
    return replace(
        spec,
        material=rig.mold.material,
        groove=replace(spec.groove, clearance=clearance, most_clearance=most_clearance),
        clamps=clamps,
        cold_length=given.clamps.clearance + given.mold.lead if feedback is None else feedback.cold_length,
        growth=None if feedback is None else feedback.growth,
        heat=heat,
        vents=vents,
        slot=slot,
    )


def lid_profile(rig: Rig, tube: Tube) -> tuple[float, ...]:
    """Open fraction of the groove's area in cells along the bend, from the rig's open fraction of the tube's surface.

    A vent bares the upper half of the tube below it, so the open fraction of the groove is twice that of the surface.
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
    """Rig with a mold of one groove: leads, clamps, gap, plates and vents as drawn."""
    groove, plate = mold.grooves[0], mold.spec.plate
    curve = groove.centreline
    gap = groove_gap(groove.tube, rig, groove.width, groove.depth)
    if rig.mold.gap is not None:
        # A calibrated gap keeps its ratio to that of the computed one.
        gap = rig.mold.gap * gap / square_groove_gap(groove.tube, rig)
    bed = replace(
        rig.mold,
        lead=0.5 * (curve.lead_in.length + curve.lead_out.length),
        side_clearance=0.5 * (groove.width - groove.tube.outer_diameter),
        gap=gap,
        # As much material as lies around the groove, over its length.
        width=mold.size[0] * mold.size[1] / curve.length,
        thickness=plate.thickness + plate.lid_thickness,
        vents=drawn_vents(groove, mold.spec),
    )
    return replace(rig, mold=bed, clamps=replace(rig.clamps, clearance=0.5 * sum(groove.gaps), grip=groove.grip))


def drawn_vents(groove: Groove, spec: MoldSpec) -> tuple[float, ...]:
    """Fraction of the tube's surface that the drawn vents leave uncovered, from the end of the mold to its middle."""
    if not groove.vents:
        return (0.0,)
    profile = np.asarray(spec.vents.profile)
    requested = groove.width * groove.bend_length * float(profile.mean())
    realised = len(groove.vents) * open_area(groove.width, spec.vents.diameter) / requested
    # The leads have no vents.
    lead, half = groove.centreline.lead_in.length, 0.5 * groove.bend_length
    along = np.linspace(0.0, lead + half, VENT_POINTS) - lead
    cell = np.clip((along / (2 * half) * len(profile)).astype(int), 0, len(profile) - 1)
    bare = np.where(along >= 0, 0.5 * realised * profile[cell], 0.0)
    return tuple(np.minimum(bare, 0.5).tolist())


def _longest_when_hot(plan: HeatingPlan) -> float:
    """Longest bare tube beside a clamp, m, as `longest_bare_tube`; the growth at the sliding clamp is part of it."""
    clamps = plan.rig.clamps
    grown = replace(plan.rig, clamps=replace(clamps, clearance=clamps.clearance + plan.growth))
    return longest_bare_tube(replace(plan, rig=grown), thermocouple_for(plan.tube, plan.rig))


def _bare_remarks(given: float, rig: Rig, plan: HeatingPlan, longest: float | None) -> tuple[str, ...]:
    """Remarks on drawn clamps that are nearer to the plate than `given`, m, and on a gap that growth makes too long."""
    bare = rig.clamps.clearance
    hot = bare + plan.growth
    remarks = []
    if bare < given - SAME_LENGTH and longest and longest < given + plan.growth:
        remarks.append(
            f"clamps {bare * 1e3:.1f} mm from the plate in place of {given * 1e3:g} mm (clearance_mm). With growth, "
            f"bare tube above {longest * 1e3:.1f} mm gets hotter than the limit on boards that take most heat"
        )
    if longest and hot > longest + BARE_STEP:
        remarks.append(
            f"the growth opens the gap at the sliding clamp to {hot * 1e3:.1f} mm, and at most {longest * 1e3:.1f} mm "
            "keep the limit on boards that take most heat. Make the face of the clamps narrower (nose_mm)"
        )
    return tuple(remarks)


def _bare_disagreement(rig: Rig, longest: float | None) -> str:
    """Message if the drawn bare tube is longer than the `longest` one, m; otherwise ""."""
    bare = rig.clamps.clearance
    if longest is None or bare <= longest + SAME_LENGTH:
        return ""
    most = f"at most {longest * 1e3:.1f} mm keep" if longest else "not even 1 mm keeps"
    return (
        f"{bare * 1e3:.1f} mm of bare tube lie between clamp and plate, and {most} the limit on boards that take most "
        "heat. Make the face of the clamps narrower (nose_mm), or give the conductivity of your board"
    )


def _with_thermal_data(tube: Tube) -> tuple[Tube, tuple[str, ...]]:
    """Tube with thermal data, and a remark if they are taken from nitinol."""
    recipe_for(tube.material)
    if tube.material.thermal is not None:
        return tube, ()
    remark = f"thermal constants of {tube.material.name} are not known; mold and heating take those of nitinol"
    return replace(tube, material=replace(tube.material, thermal=NITINOL.thermal)), (remark,)


def _gap_remarks(tube: Tube, rig: Rig) -> tuple[str, ...]:
    """Remark on a gap in the rig file that differs from the gap of its groove."""
    gap, computed = uniform_gap_of(tube, rig), square_groove_gap(tube, rig)
    if abs(gap / computed - 1) < 0.25:
        return ()
    return (
        f"gap_um of the rig file is {1e6 * gap:.0f} um. A groove with {1e6 * rig.mold.play:.0f} um on each side of "
        f"this tube has a uniform gap of {1e6 * computed:.0f} um. Remove gap_um unless it comes from a log (tubeopt "
        "heat calibrate)",
    )


def _heating_feedback(groove: Groove, plan: HeatingPlan, spec: HeatingSpec) -> HeatingFeedback:
    """Results of the heating for the next mold; leads that are too short, or leak too much current, become longer."""
    length, cold_end = _clamp_to_bend(groove), plan.cold_end
    if math.isinf(cold_end):
        # The whole tube is cold: no lead helps.
        cold_end = groove.cold.length
    last = int(np.flatnonzero(plan.in_hold)[-1])
    T_clamp = float(plan.clamp_temperature[last]) + ZERO_CELSIUS
    # The plate makes leads longer than requested, by the same length again next time.
    for_peak = groove.cold.length + _length_for_peak(plan, spec) - length
    for_ends = cold_end if cold_end <= length + SAME_LENGTH else cold_end + LEAD_RESERVE
    return HeatingFeedback(max(for_ends, for_peak), plan.growth, T_clamp)


def _length_for_peak(plan: HeatingPlan, spec: HeatingSpec) -> float:
    """Length (m) from clamp to bend for a cold tube that draws the allowed peak current; 0 if it is too long.

    The current is greatest through the cold tube at rest, whose resistance is proportional to its length.
    """
    tube, rig = plan.tube, plan.rig
    current, allowed = full_current(tube, rig, leaking=False), PEAK_FRACTION * rig.circuit.peak_limit
    length = tube.curved_length + 2 * (rig.mold.lead + rig.clamps.clearance)
    R = rig.battery.voltage / current - rig.battery.internal_resistance - rig.circuit.resistance
    required = length * (1 + rig.battery.voltage * (1 / allowed - 1 / current) / R)
    each = 0.5 * (required - tube.curved_length)
    return each if each - rig.clamps.clearance <= spec.lead_range[1] else 0.0


def _clamp_to_bend(groove: Groove) -> float:
    """Length (m) of tube from a clamp to the bend."""
    return groove.gaps[0] + groove.centreline.lead_in.length


def _same_rig(a: Rig, b: Rig) -> bool:
    """True if two rigs as drawn are equal for the heating, to within lengths of `SAME_LENGTH`."""
    lengths = [abs(getattr(a.mold, name) - getattr(b.mold, name)) for name in ("lead", "gap", "width", "thickness")]
    lengths.append(abs(a.clamps.clearance - b.clamps.clearance))
    vents = [vent_profile(rig, np.linspace(0.0, 1.0, VENT_POINTS)) for rig in (a, b)]
    return max(lengths) < SAME_LENGTH and float(np.abs(vents[0] - vents[1]).max()) < SAME_LENGTH


def _consistent(mold: Mold, plan: HeatingPlan) -> bool:
    """True if the mold fits the heated tube and has the lead and growth of the heating."""
    groove = mold.grooves[0]
    uneven = abs(groove.centreline.lead_in.length - groove.centreline.lead_out.length)
    differences = [groove.free_length - plan.free_length, uneven, groove.growth - plan.growth]
    missing = 0.0 if math.isinf(plan.cold_end) else plan.cold_end - _clamp_to_bend(groove)
    return max(abs(x) for x in differences) < SAME_LENGTH and missing < SAME_LENGTH


def _required_lead(plan: HeatingPlan) -> str:
    """Message with the required and the present length from clamp to bend."""
    required = 1e3 * (plan.cold_end + LEAD_RESERVE)
    present = 1e3 * (plan.rig.clamps.clearance + plan.rig.mold.lead)
    return f"the heating needs {required:.1f} mm from clamp to bend, the mold has {present:.1f} mm"
