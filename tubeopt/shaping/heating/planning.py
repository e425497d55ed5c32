"""How to heat a tube so that its curved part is shape-set: the schedule of duties, and what it does."""

from __future__ import annotations

from dataclasses import replace

from ...constants import ZERO_CELSIUS
from ...errors import InputError, instance
from ...robots.tubes import Tube
from ...solvers.blas import small
from ...solvers.time_limit import TIME_LIMIT, limited
from ..recipes import check_temperatures, warn_of_limit
from .feedback_design import design_feedback
from .plan import HeatingPlan
from .remedies import find_cures
from .rig import Rig
from .schedule import best_schedule
from .sensors import Sensor
from .spec import HeatingSpec
from .thermal import PROGRAM, thermal_data, thermal_model


@small
@limited
def plan_heating(
    tube: Tube,
    rig: Rig,
    spec: HeatingSpec | None = None,
    *,
    sensor: Sensor | None = None,
    time_limit: float = TIME_LIMIT,
) -> HeatingPlan:
    """Schedule of integer duties that keeps the curved part of a tube in the temperature window for the hold time.

    No point exceeds the temperature limit; ramp and currents stay within theirs. If that is impossible, the plan with
    the smallest miss is returned: `feasible` is False, `shortfall` is the miss, `broken` names other violated limits,
    and `cures` lists changes that would help.

    Args:
        tube: the tube; its straight part serves as a lead. Missing lead, and the lead at the tip, are extra tube.
        rig: battery, circuit, clamps, mold.
        spec: window, hold and limits; by default 500-550 degC for 60 s.
        sensor: a `Thermocouple`, `TubeResistance` or `Camera`. The plan's `feedback` is then the controller for it,
            with the probability that uncertain rigs keep the window (see `design_feedback`).
        time_limit: maximum run time, s.

    Raises:
        InputError: a tube without curved part, or an invalid rig or window. A material without thermal data or recipe
            (only nitinol has one), or that cannot be set in the window.
        SolveError: the optimal control problem did not converge.
        TimeLimitError: (a SolveError) the time limit was reached before there was an answer.

    Examples:
        >>> import tubeopt
        >>> rig = tubeopt.load_rig("configs/rigs/thesis_calcium_silicate.yaml")
        >>> plan = tubeopt.plan_heating(rig.tube, rig, tubeopt.HeatingSpec(window_degC=(500, 550), hold_time=5))
        >>> plan.feasible, plan.lowest >= 500, plan.highest <= 550
        (True, True, True)
    """
    spec = HeatingSpec() if spec is None else spec
    for name, value, wanted in (("tube", tube, Tube), ("rig", rig, Rig), ("spec", spec, HeatingSpec)):
        instance(name, value, wanted)
    check_temperatures(tube.material, "window_degC", *spec.window_degC)
    warn_of_limit(tube.material, spec.limit)
    thermal_data(tube)
    if rig.ambient - ZERO_CELSIUS >= spec.window_degC[0]:
        raise InputError(
            f"ambient of the rig is {rig.ambient - ZERO_CELSIUS:g} degC; it must be below the window, which begins at "
            f"{spec.window_degC[0]:g} degC"
        )
    thermal_model(tube, rig, PROGRAM)  # refuses a tube and a mold that do not fit one another
    found = best_schedule(tube, rig, spec)
    cures = () if found.kept else find_cures(tube, rig, spec, found)
    iterations = 0 if found.program is None else found.program.ideal.iterations
    plan = HeatingPlan.of(tube, spec, found, iterations, cures=cures)
    return plan if sensor is None else replace(plan, feedback=design_feedback(plan, sensor))
