"""What would cure a window that cannot be held: changes of rig and question, tried one after the other."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..errors import SolveError
from ..materials import ZERO_CELSIUS
from ..tubes import Tube
from .heating_ideal import Ideal, Shift, solve_ideal
from .heating_spec import HeatingSpec
from .mold_materials import CALCIUM_SILICATE
from .rig import Rig

ENOUGH = 0.05
"""A window missed by less than this, K, counts as held by the program."""

WORTH = 0.1
"""A change that takes away less than this part of the miss is not worth telling."""

TRIES = 3
SHORT_SLOT, MORE_CURRENT, MORE_TIME, LONG_LEAD, WIDER = 0.1, 2.0, 3.0, 1.5, 25.0


@dataclass(frozen=True)
class Cure:
    """A change, in words, and by how much the window would still be missed with it, K."""

    change: str
    shortfall: float

    @property
    def cures(self) -> bool:
        """Whether the window would be held."""
        return self.shortfall <= 0.0


def find_cures(
    tube: Tube, rig: Rig, spec: HeatingSpec, ideal: Ideal, shift: Shift | None, reserve: tuple[float, float]
) -> tuple[Cure, ...]:
    """Changes that let the window be held, or at least nearly; the best first, the search ends at the first that cures.

    Args:
        ideal: the best schedule without any change. shift, reserve: those that it was found with.
    """
    found: list[Cure] = []
    plain = replace(spec, objective="time")
    for words, other_rig, other_spec in _candidates(rig, plain, ideal, shift)[:TRIES]:
        part = other_spec.slot / spec.slot
        try:
            answer = solve_ideal(
                tube, other_rig, other_spec, reserve=(part * reserve[0], part * reserve[1]), shift=shift
            )
        except SolveError:
            continue
        miss = 0.0 if answer.miss < ENOUGH else answer.miss
        if miss < (1 - WORTH) * ideal.miss:
            mold, clamps = answer.rig.mold, answer.rig.clamps
            change = words.format(lead=1e3 * mold.lead, clearance=1e3 * clamps.clearance, vent=100 * max(mold.vents))
            found.append(Cure(change, miss))
        if miss == 0.0:
            break
    return tuple(sorted(found, key=lambda cure: cure.shortfall))


def _candidates(rig: Rig, spec: HeatingSpec, ideal: Ideal, shift: Shift | None) -> list[tuple[str, Rig, HeatingSpec]]:
    """The changes that fit the reason: the whole tube too cold, its ends too cold, or a window too narrow."""
    low, high = spec.window_degC
    last = ideal.held[-1] - ZERO_CELSIUS + (0.0 if shift is None else shift.held[-1])
    if last.max() < low:
        return _for_power(rig, spec)
    if last.max() - last.min() > 0.5 * (high - low):
        return _for_ends(rig, spec)
    return _for_narrow_window(rig, spec)


def _for_power(rig: Rig, spec: HeatingSpec) -> list[tuple[str, Rig, HeatingSpec]]:
    found: list[tuple[str, Rig, HeatingSpec]] = []
    if rig.mold.material != CALCIUM_SILICATE:
        silicate = replace(rig, mold=replace(rig.mold, material=CALCIUM_SILICATE))
        name = rig.mold.material.name.replace("_", " ")
        found.append((f"a mold of calcium silicate in place of {name}", silicate, spec))
    circuit = replace(rig.circuit, current_limit=MORE_CURRENT * rig.circuit.current_limit)
    words = f"a circuit that bears a mean current of {circuit.current_limit:g} A"
    found.append((words, replace(rig, circuit=circuit), spec))
    if rig.battery.state_of_charge < 0.95:
        found.append(("a full battery", rig.with_charge(1.0), spec))
    longer = replace(spec, longest_heating=MORE_TIME * spec.longest_heating)
    found.append((f"a heating of up to {longer.longest_heating:g} s", rig, longer))
    return found


def _for_ends(rig: Rig, spec: HeatingSpec) -> list[tuple[str, Rig, HeatingSpec]]:
    lead, clearance = rig.mold.lead, rig.clamps.clearance
    longer = replace(spec, free=("lead",), lead_range=(lead, max(60e-3, LONG_LEAD * lead)))
    both = replace(
        longer, free=("lead", "clearance"), clearance_range=(min(1e-3, 0.5 * clearance), max(20e-3, 1.01 * clearance))
    )
    return [
        ("a lead of {lead:.1f} mm of extra tube in the mold at each end", rig, longer),
        ("a lead of {lead:.1f} mm and a clearance of {clearance:.1f} mm at each end", rig, both),
        (
            "a lead of {lead:.1f} mm and vents that leave up to {vent:.0f} % of the tube bare",
            rig,
            replace(longer, free=("lead", "vents")),
        ),
    ]


def _for_narrow_window(rig: Rig, spec: HeatingSpec) -> list[tuple[str, Rig, HeatingSpec]]:
    lead = _for_ends(rig, spec)[0]
    wider = replace(spec, window_degC=(spec.window_degC[0] - WIDER, spec.window_degC[1]))
    wide = (f"a window that begins at {wider.window_degC[0]:g} degC", rig, wider)
    if spec.slot <= SHORT_SLOT:
        return [lead, wide]
    quick = f"duties kept for {SHORT_SLOT:g} s instead of {spec.slot:g} s"
    both = (f"{lead[0]}, and {quick}", rig, replace(lead[2], slot=SHORT_SLOT))
    return [(quick, rig, replace(spec, slot=SHORT_SLOT)), both, wide]
