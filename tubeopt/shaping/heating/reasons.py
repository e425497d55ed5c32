"""What keeps a schedule from its window, in words."""

from __future__ import annotations

from .counts import stops
from .outcome import hold_slots
from .schedule import Schedule

LEAST_SHARE = 0.1
"""Share of the time to the end of the hold from which on a limit is named that allows no count more."""


def reasons_of(found: Schedule) -> tuple[str, ...]:
    """What keeps a schedule from its window; empty where the window is kept.

    Far below the limit of temperature, these are the limits that allow no count more. Near that limit, a count more
    makes one place too hot while another is too cold.
    """
    outcome, spec, rig = found.outcome, found.spec, found.run.rig
    if outcome.shortfall <= 0:
        return ()
    _, last = hold_slots(spec, found.run.start)
    states = [found.checked.state(k) for k in range(last)]
    stopped = stops(found.run.model, spec, rig, found.counts[:last], states)
    words = {
        "duty": "the switch conducts all the time",
        "current": f"the mean current of {rig.circuit.current_limit:g} A allows no count more",
        "ramp": f"the ramp of {spec.ramp:g} K/s allows no count more",
    }
    held = {limit: stopped.count(limit) for limit in words}
    until = f"of the {spec.slot * last:g} s to the end of the hold"
    said = [
        f"{words[limit]} in {spec.slot * slots:g} {until}"
        for limit, slots in held.items()
        if slots > LEAST_SHARE * last
    ]
    if said and found.run.start > (1 - spec.solver.cures.worth) * spec.longest_heating:
        said.append(f"the heating may last {spec.longest_heating:g} s at most")
    if not said or outcome.hottest + outcome.mesh.hottest > spec.limit - spec.solver.hopeless:
        said.insert(
            0,
            f"in the hold the curved part is at {outcome.lowest:.1f} to {outcome.highest:.1f} degC while the hottest "
            f"point of the tube reaches {outcome.hottest:.1f} degC of {spec.limit:g} degC",
        )
    return tuple(said)
