"""Ideal schedule: the optimal control problem with its parameters, start and bounds, solved; its answer in arrays."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import scipy

from ...constants import ZERO_CELSIUS
from ...errors import SolveError, without_unit_warnings
from ...physics.heat import GRIP, LEAD
from ...physics.heat_functions import CHARGE, CLAMP, SAG
from ...robots.tubes import Tube
from ...typing import Array
from .counts import count_rate, full_current
from .optimal_control import NO_TERMS, CustomTerms, Program, Structure, custom_function, program
from .rig import COUNTS, Rig
from .rig_course import LIMIT_RANGES, SCALE, TASK, VENTS, rig_parameters
from .simulation import FINE_STEP, History, State, advance, at_rest, simulate, simulate_feedback, warming, warming_span
from .spec import HeatingSpec
from .thermal import PROGRAM, ThermalModel, curve_start, curved_temperatures, thermal_model, vent_profile

# The program limits the ramp at its collocation points only; between them, and on the fine grid, it is larger. Half of
# it begins a hold up to 1.5 s sooner, twice 2 to 3 s later.
RAMP_RESERVE = 0.03
"""Fraction of the ramp that is reserved for the fine grid."""

# Where the reserve for counts takes nearly all of the ramp, the heating would never end. Half and twice change no plan.
MIN_RAMP = 0.15
"""Smallest fraction of the ramp that remains after the reserve for whole counts."""

# Larger than the miss of any tube: with it the program is always feasible, at a price.
MAX_MISS = 1500.0
"""Largest miss of the window, K."""

# Mean square currents are linear between 25 nodes; a duty is their quotient by I^2, which changes slowly. 16 points on
# each interval follow it to a thousandth of a count: half and twice change no plan.
DUTY_POINTS = 401
"""Points of the piecewise linear duty over heating and hold."""

# Half and twice change neither a plan nor its time.
GUESS_SLOT = 0.25
"""Slot of the controller that finds the starting schedule, s."""

# From a small miss IPOPT reduces the slack in a few steps; from a slack of 0 a bad start takes a hundred. Half and
# twice change no plan.
GUESS_MISS = 20.0
"""Miss of the window by the starting schedule above which the program starts with slack, K."""

WEIGHTS = {
    "time": {"w_time": 1.0, "w_energy": 0.0, "w_centre": 0.02, "w_miss": 1.0, "w_I_sq": 0.01},
    "energy": {"w_time": 0.3, "w_energy": 5.0, "w_centre": 0.02, "w_miss": 3.0, "w_I_sq": 0.01},
    "margin": {"w_time": 0.3, "w_energy": 0.0, "w_centre": 0.02, "w_miss": 1.0, "w_I_sq": 0.01},
    "custom": {"w_time": 0.0, "w_energy": 0.0, "w_centre": 0.02, "w_miss": 3.0, "w_I_sq": 0.01},
}
"""Weights per s / 30, J / 1e4, square of 25 K, K, and square of changes by 100 A^2.

The changes are of the mean square current.
"""


# Requirements and objective are of the order of 1, so multipliers rarely exceed the first. With 100 as the first the
# program takes half as many iterations again.
CUSTOM_WEIGHTS = 10.0, 1e3
"""Weights of the violation of custom requirements; the second where the first leaves one."""

# From a larger one the few iterations of a restart are lost. Half and twice change no plan.
RESTART_SLACK = 0.05
"""Violation of custom requirements, scaled, from which a program is not restarted but solved anew."""

# The last barrier parameter is 1e-6: slacks that are not needed are smaller than this.
CUSTOM_TOLERANCE = 1e-4
"""Violation of custom requirements, scaled, that counts as none."""


DENSER = 3
"""Factor on the numbers of intervals at whose points custom requirements are evaluated in a simulation."""

# The first of each is the start without custom requirements. A dose wants a hotter hold, cold clamps a shorter heating.
START_LEVELS, START_STRETCHES = (0.5, 0.8), (1.0, 1.5, 2.0, 3.0)
"""Temperatures of starts within the window, as fractions of its width, and their heating times by the shortest."""


class CourseNumbers(NamedTuple):
    """Scaled unknowns of a course in numbers, in the order of the program."""

    z: Array
    """(N, S) states at the collocation points."""
    circuit: Array
    """(N, 2) current and resistance of half the tube."""
    I_sq: Array
    """(1+K,) mean square current at the ends of the intervals."""
    durations: Array
    """(intervals of heating,) copies of the heating time."""


class Multipliers(NamedTuple):
    """Multipliers of a solution, as a start for a similar program."""

    bounds: Array
    constraints: Array


@dataclass(frozen=True, eq=False)
class Ideal:
    """Ideal schedule: solution of the optimal control problem."""

    heating: float
    """Heating time before the hold, s."""
    node_time: Array
    """(K,) times between which the duty is linear, s."""
    node_duty: Array
    """(K,) duties at the times `node_time`, 0 to 1."""
    miss: float
    """Miss of the window narrowed by the reserve, K; below 0 only for objective "margin"."""
    rig: Rig
    """Rig with clearance, lead and vents as chosen."""
    time: Array
    """(N,) collocation points, s."""
    tube: Array
    """(N, n) temperatures at the collocation points, K."""
    hold: Array
    """(H, 1 + c) temperatures in the hold at the start of the curved part and at its cells, K."""
    iterations: int
    """Number of iterations of IPOPT."""
    objective: float
    """Scaled objective of the program."""
    x: Array
    """Scaled unknowns without the copies of the design."""
    multipliers: Multipliers
    custom: Array
    """Values of custom requirements, which must be at least 0."""
    structure: Structure
    """Structure of the program."""

    @property
    def longer_lead_helps(self) -> bool:
        """True if a longer lead would lower the objective: the sign of the multiplier of the lead's bound."""
        return bool(self.multipliers.bounds[-1 - VENTS] > 0)

    def duty(self, slot: float, count: int) -> Array:
        """(count,) mean duty in every slot from the start; the last duty continues after the end."""
        edges = slot * np.arange(count + 1)
        times = np.union1d(self.node_time, edges)
        duty = np.interp(times, self.node_time, self.node_duty)
        total = scipy.integrate.cumulative_trapezoid(duty, times, initial=0.0)[np.searchsorted(times, edges)]
        return np.asarray(np.clip(np.diff(total) / slot, 0.0, 1.0))


@dataclass(frozen=True, eq=False)
class Shift:
    """Differences between the temperatures of a finer model and of the program, K."""

    hold: Array
    """(H, 1 + c) differences in the hold, at the start of the curved part and at its cells."""
    tube: Array
    """(N, n) differences at all points and cells."""
    custom: Array
    """Values of custom requirements at the simulation less those at the solution."""

    @classmethod
    def between(
        cls, ideal: Ideal, tube: Tube, model: ThermalModel, history: History, slots: int, custom: Array
    ) -> Shift:
        """Temperature differences between an ideal schedule and a simulation of its duties on a finer model, over
        `slots`.

        `custom` are the values of custom requirements at the simulation.
        """
        slot = float(history.time[1])
        # The hold of the program may end within the slot after the last heated one.
        duties = ideal.duty(slot, max(math.ceil(ideal.time[-1] / slot), slots) + 1)
        later = simulate(model, slot, duties[slots:], start=history.state(slots))
        temperature = np.concatenate([history.tube[: slots + 1, 0], later.tube[1:, 0]])
        time = slot * np.arange(len(temperature))
        coarse = thermal_model(tube, ideal.rig, PROGRAM)
        at_time = np.array([np.interp(ideal.time, time, column) for column in temperature.T]).T
        fine = np.array([np.interp(coarse.position, model.position, row) for row in at_time])
        first = len(ideal.time) - len(ideal.hold)
        edge = np.array([[np.interp(curve_start(model), model.position, row)] for row in at_time[first:]])
        return cls(
            np.hstack([edge, fine[first:][:, coarse.curved]]) - ideal.hold, fine - ideal.tube, custom - ideal.custom
        )


def solve_ideal(  # noqa: PLR0913
    tube: Tube,
    rig: Rig,
    spec: HeatingSpec,
    *,
    reserve: tuple[float, float] = (0.0, 0.0),
    ramp_reserve: float = 0.75,
    shift: Shift | None = None,
    guess: Ideal | None = None,
    soft_limit: bool | None = None,
    custom: CustomTerms = NO_TERMS,
) -> Ideal:
    """Best schedule with a duty of any value.

    Args:
        reserve: reduction of the window at its low and high end, K; the limit is reduced as the high end.
        ramp_reserve: reserve below the ramp, as the heating rate of so many counts.
        shift: difference of a finer model, by which the bounds of temperatures are corrected.
        guess: earlier solution of a similar question.
        soft_limit: whether objective "margin" maximises the distance to the limit too. Where the window is missed it
            must not, since the limit would be relaxed as well. None tries what `guess` had, then the other.
        custom: requirements and objective of a user.

    Raises:
        SolveError: IPOPT did not converge; the message names the worst constraint.
    """
    soft = (guess is None or guess.structure.soft_limit) if soft_limit is None else soft_limit
    structure = Structure(PROGRAM, soft_limit=soft and spec.objective == "margin", chosen=spec.free)
    nlp = program(structure, custom)
    x = first_guess(structure, tube, rig, spec) if guess is None else _start_at(guess, spec, reserve, shift, structure)
    lower, upper = _unknown_bounds(structure, tube, rig, spec)
    lbg, ubg = _constraint_bounds(nlp, shift)
    if not structure.soft_limit:
        tubes = upper[: structure.points * structure.states].reshape(structure.points, -1)[:, : PROGRAM.cells]
        tubes[:] = (
            spec.limit - reserve[1] + ZERO_CELSIUS - rig.ambient - (0 if shift is None else shift.tube)
        ) / SCALE.T
    task = task_of(tube, rig, spec, reserve, ramp_reserve, custom=custom.objective is not None)
    x = np.clip(np.concatenate([x, structure.copies_of(x[-2 - VENTS :])]), lower, upper)
    p = np.concatenate([rig_parameters(tube, rig, structure.resolution), task])
    count = nlp.sizes["custom"]
    slacks = np.maximum(lbg[len(lbg) - count :] - nlp.custom(x, p).full().ravel(), 0.0)
    # Where the start satisfies all requirements, the program needs no slack.
    most = np.inf if slacks.any() else 0.0
    bounds = {
        "lbx": np.append(lower, np.zeros(count)), "ubx": np.append(upper, np.full(count, most)),
        "lbg": lbg, "ubg": ubg,
    }  # fmt: skip

    # The first solver that converges: from the earlier solution, anew, and with the convex Hessian.
    cold = nlp.rough if slacks.any() else nlp.exact
    attempts: list[tuple[Any, dict[str, Array]]] = [(cold, {}), (nlp.convex, {})]
    if guess is not None and not spec.free and slacks.max(initial=0.0) < RESTART_SLACK:
        same = guess.structure.soft_limit == structure.soft_limit
        of_x, of_g = guess.multipliers if same else _with_other_limit(guess, nlp)
        # The multipliers of a program with other constraints are of no use.
        if of_g.size == lbg.size:
            # Slacks are stationary.
            of_x = np.append(of_x, -CUSTOM_WEIGHTS[0] - of_g[len(of_g) - count :])
            attempts.insert(0, (nlp.restart, {"lam_x0": of_x, "lam_g0": of_g}))
    solved = _first_success(nlp, attempts, x=np.append(x, slacks), p=p, **bounds)
    if solved.x[len(x) :].max(initial=0.0) > CUSTOM_TOLERANCE:
        p[-1] = CUSTOM_WEIGHTS[1]
        with suppress(SolveError):
            solved = _first_success(nlp, attempts[-2:-1], x=solved.x, p=p, **bounds)
    answer = _ideal(nlp, tube, rig, spec, solved)
    if spec.objective == "margin" and soft_limit is not False and soft == (answer.miss > 0):
        return solve_ideal(
            tube, rig, spec,
            reserve=reserve, ramp_reserve=ramp_reserve, shift=shift, guess=answer, soft_limit=not soft, custom=custom,
        )  # fmt: skip
    return answer


def _start_at(
    guess: Ideal, spec: HeatingSpec, reserve: tuple[float, float], shift: Shift | None, s: Structure
) -> Array:
    """Unknowns of an earlier solution, with the miss that they have after a correction."""
    low, high = spec.window_degC
    change = (0.0, 0.0) if shift is None else (shift.hold, shift.tube)
    hold, peak = guess.hold + change[0] - ZERO_CELSIUS, (guess.tube + change[1]).max() - ZERO_CELSIUS
    missed = max(low + reserve[0] - hold.min(), hold.max() - high + reserve[1])
    if s.soft_limit:
        missed = max(missed, peak - spec.limit + reserve[1])
    x = guess.x.copy()
    # A start that violates the window would make room by short steps; it has a miss instead, which is reduced by long
    # ones.
    misses = np.split(x, np.cumsum([rows * columns for rows, columns in s.unknowns.values()]))[4]
    misses[:] = np.maximum(misses, missed)
    return x


def _with_other_limit(guess: Ideal, nlp: Program) -> Multipliers:
    """Multipliers for a program with its limit as constraints, from a solution with bounds; or the reverse."""
    s, (of_x, of_g) = guess.structure, guess.multipliers
    first = sum(nlp.sizes[name] for name in ("equations", "same", "low", "high"))
    tubes = np.zeros((s.points, s.states), dtype=bool)
    tubes[:, : s.resolution.cells] = True
    cells, of_x = np.flatnonzero(tubes), of_x.copy()
    if s.soft_limit:
        of_x[cells] += of_g[first : first + len(cells)]
        return Multipliers(of_x, np.delete(of_g, slice(first, first + len(cells))))
    of_limit = np.maximum(of_x[cells], 0.0)
    of_x[cells] -= of_limit
    return Multipliers(of_x, np.insert(of_g, first, of_limit))


class _Solved(NamedTuple):
    """Solution of IPOPT: unknowns, constraints, multipliers of both, scaled objective, iterations."""

    x: Array
    g: Array
    lam_x: Array
    lam_g: Array
    f: float
    iterations: int


def _first_success(
    nlp: Program, attempts: Sequence[tuple[Any, dict[str, Array]]], *, x: Array, **numbers: Array
) -> _Solved:
    """Solution of the first solver that converges; raises SolveError where none does."""
    for solver, start in attempts:
        solution = solver(x0=x, **start, **numbers)
        stats = solver.stats()
        if stats["success"]:
            break
    values = {name: value.full().ravel() for name, value in solution.items()}
    violation = np.maximum(numbers["lbg"] - values["g"], values["g"] - numbers["ubg"])
    if not stats["success"] and violation.max() > 1e-5:
        raise SolveError(f"IPOPT found no heating schedule ({stats['return_status'].replace('_', ' ').lower()}): "
                         f"{nlp.worst(violation)}")  # fmt: skip
    return _Solved(
        values["x"], values["g"], values["lam_x"], values["lam_g"],
        float(values["f"][0]), int(stats["iter_count"]),
    )  # fmt: skip


def custom_values(tube: Tube, spec: HeatingSpec, ideal: Ideal, custom: CustomTerms, run: CustomRun) -> Array:
    """Values of the user's requirements in a simulation on the fine grid, at the points of the program.

    They are reduced by as much as the smallest value of the requirement is smaller between these points.
    """
    s = ideal.structure
    coarse = thermal_model(tube, ideal.rig, s.resolution)
    slot = float(run.history.time[1])
    # The hold of a simulation begins with a slot. Its end is the last point, not that of one slot more, which cools.
    if spec.hold_slots > 1:
        spec = replace(spec, hold_time=spec.hold_time - spec.slot)
    # Shells of both grids lie at other radii: theirs are those of the program's grid.
    history = simulate(coarse, slot, run.duties)
    cells = np.array([np.interp(coarse.position, run.model.position, row) for row in run.history.tube[:, 0]])
    history = replace(
        history,
        tube=cells[:, None],
        lumped=run.history.lumped,
        current=run.history.current,
        resistance=run.history.resistance,
    )
    effective = np.maximum(run.duties - ideal.rig.circuit.lost_share, 0.0)
    vents = vent_profile(ideal.rig, np.linspace(0.0, 1.0, VENTS))
    lengths = np.array([ideal.rig.clamps.clearance, ideal.rig.mold.lead]) / SCALE.length
    design = np.concatenate([lengths, vents])
    p = np.concatenate([rig_parameters(tube, ideal.rig, s.resolution), task_of(tube, ideal.rig, spec, (0, 0), 0.0)])
    dense = replace(s.mesh, heating=DENSER * s.mesh.heating, hold=DENSER * s.mesh.hold)
    columns = []
    for at in (s, replace(s, mesh=dense)):
        parts = [part.ravel() for part in unknowns_of(at, coarse, history, effective, spec, run.start)]
        x = np.concatenate([*parts, np.zeros(at.points), design, at.copies_of(design)])
        columns.append([value.full().ravel() for value in custom_function(at, custom).call([x, p])])
    return np.concatenate(
        [np.zeros(0)] + [own - max(own.min() - denser.min(), 0.0) for own, denser in zip(*columns, strict=True)]
    )


def custom_start(tube: Tube, rig: Rig, spec: HeatingSpec, custom: CustomTerms) -> Ideal:
    """Controlled heating with the best objective, less what it violates, as a start of `solve_ideal`."""
    s = Structure(PROGRAM, soft_limit=spec.objective == "margin", chosen=spec.free)
    p = np.concatenate([rig_parameters(tube, rig, s.resolution), task_of(tube, rig, spec, (0, 0), 0.0)])
    nlp, starts = program(s, custom), []
    objective = nlp.exact.get_function("nlp_f")
    for level, stretch in product(START_LEVELS, START_STRETCHES):
        x = first_guess(s, tube, rig, spec, level=level, stretch=stretch)
        unknowns = np.append(x, s.copies_of(x[-2 - VENTS :]))
        values = nlp.custom(unknowns, p).full().ravel()
        starts.append((float(objective(np.append(unknowns, np.maximum(-values, 0.0)), p)), values, x))
    _, values, x = min(starts, key=lambda start: start[0])
    z, circuit, I_sq, durations = np.split(x, np.cumsum([rows * columns for rows, columns in s.unknowns.values()]))[:4]
    numbers = CourseNumbers(z.reshape(s.points, -1), circuit.reshape(s.points, 2), I_sq, durations)
    return replace(ideal_of(s, tube, rig, spec, numbers), x=x, custom=values)


class CustomRun(NamedTuple):
    """Simulation on the fine grid, for the user's requirements."""

    model: ThermalModel
    history: History
    duties: Array
    """(T-1,) duties of the slots, 0 to 1."""
    start: float
    """Start of the hold, s."""


def planned_ramp(tube: Tube, rig: Rig, spec: HeatingSpec, reserve: float) -> float:
    """Ramp less the reserves for the fine grid and for `reserve` counts, K/s."""
    ramp, count = (1 - RAMP_RESERVE) * spec.ramp, count_rate(tube, rig)
    if count >= ramp:
        # No reserve helps where one count is too much.
        return ramp
    # Rounded to the nearest count a duty is up to half a count greater, and whole counts are half of one below a limit.
    of_counts = _part_of_slots(tube, rig, spec.slot) * (spec.ramp - 0.5 * count)
    return max(min(ramp - reserve * count, of_counts), MIN_RAMP * spec.ramp)


def _part_of_slots(tube: Tube, rig: Rig, slot: float) -> float:
    """Mean heating rate of a slot at a constant count from rest, as a fraction of the rate at its start.

    The tube warms ever more slowly in a slot. Counts fall behind a schedule that keeps to the ramp all the time.
    """
    model = thermal_model(tube, rig)
    rest, free, duty = at_rest(model), model.zone > GRIP, 1 / COUNTS + rig.circuit.lost_share
    first = warming(model, rest.cells, rest.lumped, duty)[0, free, 0].max()
    warmed = advance(model, rest, duty, slot, math.ceil(slot / FINE_STEP - 1e-9)).cells - rest.cells
    return min(float(warmed[0, free, 0].max() / (slot * first)), 1.0)


def task_of(
    tube: Tube, rig: Rig, spec: HeatingSpec, reserve: tuple[float, float], ramp_reserve: float, *, custom: bool = False
) -> Array:
    """Values by the names of `TASK`, with reserves as of `solve_ideal`; `custom`: weights of a custom objective."""
    low, high = spec.window_degC
    # By sum-up rounding the mean current is up to a whole count greater.
    current = max(rig.circuit.current_limit - full_current(tube, rig) / COUNTS, 0.5 * rig.circuit.current_limit)
    values = {
        "hold": spec.covered_time,
        "low": low + reserve[0] + ZERO_CELSIUS,
        "high": high - reserve[1] + ZERO_CELSIUS,
        "limit": spec.limit - reserve[1] + ZERO_CELSIUS,
        "ramp": planned_ramp(tube, rig, spec, ramp_reserve),
        "current": current,
        **WEIGHTS["custom" if custom else spec.objective],
        "w_custom": CUSTOM_WEIGHTS[0],
    }
    return np.array([values[name] for name in TASK])


def _bounds(limits: Mapping[str, Sequence[Any]], sizes: Mapping[str, int]) -> tuple[Array, Array]:
    """Lower and upper bounds by name, as columns in the order of the sizes."""
    lower, upper = (
        np.concatenate([np.broadcast_to(np.ravel(limits[name][side]), (size,)) for name, size in sizes.items()])
        for side in (0, 1)
    )
    return lower, upper


def _unknown_bounds(s: Structure, tube: Tube, rig: Rig, spec: HeatingSpec) -> tuple[Array, Array]:
    z_max = np.full((s.points, s.states), np.inf)
    # No more charge can be drawn than the battery has.
    z_max[:, -2] = rig.battery.state_of_charge / SCALE.charge
    # In a long heating the first collocation point is late. At rest there is no loss yet: the ramp bounds the current.
    I_sq_max = np.full(s.unknowns["I_sq"][1], np.inf)
    I_full = full_current(tube, rig, leaking=False)
    I_sq_max[0] = spec.ramp / (COUNTS * count_rate(tube, rig)) * I_full**2 / SCALE.I_sq
    ranges = {"clearance": (rig.clamps.clearance, spec.clearance_range), "lead": (rig.mold.lead, spec.lead_range)}
    lengths = np.array([ends if name in spec.free else (value, value) for name, (value, ends) in ranges.items()])
    vents = vent_profile(rig, np.linspace(0.0, 1.0, VENTS))
    vent_range = (0 * vents, 0 * vents + spec.most_vent) if "vents" in spec.free else (vents, vents)
    limits = {
        "z": (-np.inf, z_max),
        "circuit": (0.0, np.inf),
        "I_sq": (0.0, I_sq_max),
        "durations": (0.5 / SCALE.duration, spec.longest_heating / SCALE.duration),
        "misses": (-1e3 if spec.objective == "margin" else 0.0, MAX_MISS),
        "design": [np.concatenate(side) for side in zip(lengths.T / SCALE.length, vent_range, strict=True)],
        "copies": (-np.inf, np.inf),
    }
    return _bounds(limits, {name: rows * columns for name, (rows, columns) in s.unknowns.items()})


def _constraint_bounds(nlp: Program, shift: Shift | None) -> tuple[Array, Array]:
    limits: dict[str, tuple[Any, Any]] = {
        "equations": (0.0, 0.0),
        "same": (0.0, 0.0),
        **LIMIT_RANGES,
        "chosen": (0.0, 0.0),
        "custom": (0.0, np.inf),
    }
    if shift is not None:
        # The constraints have the units of their scales.
        limits["low"] = (-shift.hold / SCALE.window, np.inf)
        limits["high"] = (-np.inf, -shift.hold / SCALE.window)
        limits["custom"] = (-shift.custom, np.inf)
        if nlp.structure.soft_limit:
            limits["limit"] = (-np.inf, -shift.tube / SCALE.T)
    return _bounds(limits, nlp.sizes)


# --- the answer -------------------------------------------------------------------------------------------------------


@without_unit_warnings()
def _ideal(nlp: Program, tube: Tube, rig: Rig, spec: HeatingSpec, solved: _Solved) -> Ideal:
    s = nlp.structure
    Z, circuit, I_sq, duration, miss, design = (part.full() for part in nlp.split(solved.x))
    clamps, mold = rig.clamps, rig.mold
    if "clearance" in spec.free:
        clamps = replace(clamps, clearance=SCALE.length * float(design[0, 0]))
    if "lead" in spec.free:
        mold = replace(mold, lead=SCALE.length * float(design[1, 0]))
    if "vents" in spec.free:
        mold = replace(mold, vents=tuple(np.clip(design[2:, 0], 0.0, 0.5).tolist()))
    numbers = CourseNumbers(Z.T, circuit.T, I_sq.ravel(), np.full(s.mesh.heating, float(duration[0, 0])))
    # The copies of the design, and their constraints, are the last ones before custom constraints.
    count = nlp.sizes["custom"]
    kept, size = len(solved.g) - count - s.copies, len(solved.x) - count - s.copies
    constraints = np.append(solved.lam_g[:kept], solved.lam_g[kept + s.copies :])
    return replace(
        ideal_of(s, tube, replace(rig, clamps=clamps, mold=mold), spec, numbers),
        miss=float(miss[0, 0]),
        iterations=solved.iterations,
        objective=solved.f,
        x=solved.x[:size],
        multipliers=Multipliers(solved.lam_x[:size], constraints),
        custom=solved.g[kept + s.copies :] - solved.x[size + s.copies :],
    )


def ideal_of(s: Structure, tube: Tube, rig: Rig, spec: HeatingSpec, numbers: CourseNumbers) -> Ideal:
    """Ideal schedule of a course in numbers, without miss and multipliers."""
    heating = SCALE.duration * float(numbers.durations[0])
    faces, points = s.mesh.times(heating, spec.covered_time)
    # I_sq is linear between the nodes, the current is known at the points: the duty is curved a little.
    fine = np.unique(np.concatenate([faces, np.linspace(0.0, faces[-1], DUTY_POINTS)]))
    I_on = SCALE.current * np.interp(fine, points, numbers.circuit[:, 0])
    duty = SCALE.I_sq * np.interp(fine, faces, numbers.I_sq) / I_on**2
    temperature = rig.ambient + SCALE.T * numbers.z[:, : s.resolution.cells]
    first_of_hold = s.mesh.heating * s.mesh.degree - 1
    return Ideal(
        heating=heating,
        node_time=fine,
        node_duty=np.clip(duty, 0.0, 1.0),
        miss=0.0,
        rig=rig,
        time=points,
        tube=temperature,
        hold=curved_temperatures(thermal_model(tube, rig, s.resolution), temperature[first_of_hold:]),
        iterations=0,
        objective=math.nan,
        x=np.zeros(0),
        multipliers=Multipliers(np.zeros(0), np.zeros(0)),
        custom=np.zeros(0),
        structure=s,
    )


# --- start: the schedule of a controller that knows the model ---------------------------------------------------------


def first_guess(
    s: Structure, tube: Tube, rig: Rig, spec: HeatingSpec, *, level: float = 0.5, stretch: float = 1.0
) -> Array:
    """Unknowns of a schedule that heats as fast as the ramp allows.

    If that misses the window by far, the schedule heats as long as allowed instead. Of two optima, IPOPT ends at the
    one on the side of its start.

    Args:
        level: temperature of the hold in the window, 0 to 1.
        stretch: factor on the heating time.
    """
    low, high = spec.window_degC
    target = low + level * (high - low) + ZERO_CELSIUS
    heating = min(stretch * (target - rig.ambient) / min(0.9 * spec.ramp, 1e3), spec.longest_heating)
    unknowns, miss = _controlled(s, tube, rig, spec, target, heating)
    if miss > 0 and heating < spec.longest_heating:
        unknowns, miss = _controlled(s, tube, rig, spec, target, spec.longest_heating)
    design = np.array([rig.clamps.clearance, rig.mold.lead]) / SCALE.length
    vents = vent_profile(rig, np.linspace(0.0, 1.0, VENTS))
    return np.concatenate([unknowns, np.full(s.points, miss), design, vents])


def _controlled(
    s: Structure, tube: Tube, rig: Rig, spec: HeatingSpec, target: float, heating: float
) -> tuple[Array, float]:
    """States, circuit, currents and durations of a controlled heating of this duration (s), and its miss, K.

    The controller knows the model and keeps the hottest cell on the ramp to the target, K.
    """
    model = thermal_model(tube, rig, s.resolution)
    ramp = min(0.9 * spec.ramp, 1e3)
    count = int(np.clip(np.ceil((heating + spec.covered_time) / GUESS_SLOT), 200, 2000))
    slot = (heating + spec.covered_time) / count

    def controller(time: float, state: State) -> float:
        setpoint = min(model.T_amb + ramp * (time + slot), target)
        return duty_for(model, state, setpoint, slot, rig.circuit.current_limit)

    history, duties = simulate_feedback(model, slot, count, controller)
    unknowns = unknowns_of(s, model, history, duties, spec, heating)
    hold = curved_temperatures(
        model, model.T_amb + SCALE.T * unknowns.z[-s.mesh.holding_points :, : s.resolution.cells]
    )
    low, high = spec.window_degC
    miss = max(low - float(hold.min() - ZERO_CELSIUS), float(hold.max() - ZERO_CELSIUS) - high)
    columns = np.concatenate([part.ravel() for part in unknowns])
    return columns, 1.1 * miss if miss > GUESS_MISS else 0.0


def unknowns_of(
    s: Structure, model: ThermalModel, history: History, duties: Array, spec: HeatingSpec, heating: float
) -> CourseNumbers:
    """Unknowns of a simulation on the program's grid at `duties` (T-1,), with a hold that starts at `heating`, s."""
    faces, points = s.mesh.times(heating, spec.covered_time)
    covered, lumped = model.zone >= LEAD, history.lumped[:, 0]
    temperatures = [history.tube[:, 0], history.walls[:, 0][:, covered].reshape(len(history.time), -1)]
    z = np.column_stack(
        [
            (np.hstack(temperatures) - model.T_amb) / SCALE.T,
            (lumped[:, CLAMP] - model.T_amb) / SCALE.T,
            lumped[:, CHARGE] / SCALE.charge,
            lumped[:, SAG] / SCALE.V_sag,
        ]
    )
    circuit = np.column_stack([history.current[:, 0] / SCALE.current, history.resistance[:, 0] / 2 / SCALE.R])
    z, circuit = (np.column_stack([np.interp(points, history.time, x) for x in table.T]) for table in (z, circuit))
    # Mean square currents at the ends of the intervals.
    middle = 0.5 * (history.time[1:] + history.time[:-1])
    I_sq = np.interp(faces, middle, duties * history.current[:-1, 0] ** 2) / SCALE.I_sq
    return CourseNumbers(z, circuit, I_sq, np.full(s.mesh.heating, heating / SCALE.duration))


def duty_for(model: ThermalModel, state: State, setpoint: float, slot: float, current_limit: float) -> float:
    """Duty that brings the hottest cell outside the clamps to a temperature, K, in one slot, within the
    current limit.
    """
    (idle,), (full,), (I_on,) = warming_span(model, state.cells, state.lumped)
    tube = state.cells[0, :, 0]
    hot = int(np.argmax(np.where(model.zone > GRIP, tube, 0.0)))
    rate = (setpoint - tube[hot]) / slot - idle[hot]
    return float(np.clip(rate / (full[hot] - idle[hot]), 0.0, min(1.0, current_limit / I_on)))
