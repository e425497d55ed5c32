"""A shape-setting rig over time as a block of a nonlinear program that its user composes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import reduce
from typing import Any

import casadi as ca
import numpy as np

from ...arguments import typed
from ...block.composed import as_program
from ...block.inputs import symbolic
from ...errors import InputError, choice, nearest, whole, without_unit_warnings
from ...physics import heat
from ...robots.tubes import Tube
from ...solvers.settings import Ipopt
from ...typing import Array
from .optimal_control import COLD, IPOPT, MUMPS, Structure
from .optimal_schedule import WEIGHTS, CourseNumbers, first_guess, ideal_of, task_of
from .plan import HeatingPlan
from .rig import Rig
from .rig_course import (
    LIMIT_RANGES,
    RIG_PARAMETERS,
    SCALE,
    TASK,
    TIME_MESH,
    VENTS,
    RigCourse,
    grid_places,
    rig_parameters,
)
from .schedule import RAMP_RESERVE, realised_schedule
from .spec import OBJECTIVES, HeatingSpec
from .thermal import PROGRAM, thermal_data, uniform_gap_of, vent_profile


@typed
class HeatingBlock(RigCourse):
    """A rig over heating and hold in a nonlinear program.

    The block adds states and circuit as unknowns, with their equations, a duty of at most 1 and a charge of at most
    that of the battery. Limits of the schedule are added by `keep_limits`. All starts are those of a simulation.

    Args:
        opti: a `casadi.Opti` or a `tubeopt.Problem`; receives the unknowns and equations.
        rig: battery, circuit, clamps, mold.
        tube: the tube; by default that of the rig.
        spec: hold time, longest heating, and the window about which the start is controlled; by default 500-550 degC
            for 60 s. The block spans one slot more than the hold, so that the hold may begin in the middle of one.
        heating_time: time before the hold, s, a number or an expression; None is an unknown of the block.
        duty: effective duty, 0 to 1, at the ends of the K intervals of time (1+K entries, or one for all), numbers or
            expressions; None is unknown.
        parameters: parameters of the rig by name, numbers or expressions: any of `clearance`, `lead`, `gap` (uniform
            gap to the groove), `clamp_mass`, `clamp_area`, `mold_thickness`, `mold_conductivity`, SI. Those that are
            omitted stay. Start your own variables at the numbers of `rig`.
        refinement: number of times that the intervals of time are halved; K is 24 times 2 to this power.
        name: name of the block in messages.

    Attributes:
        tube_temperature (n, N), mold_temperature (c, N), clamp_temperature (1, N): K at the N collocation points, from
            a clamp to the middle of the tube; of the mold the wall of the groove.
        hold_temperatures: (1+c, H) K, start and cells of the curved part at the points of the hold.
        current, mean_current, duty, power, resistance, charge: (1, N), A, A, 1, W, ohm, fraction of the capacity drawn.
        time: (1, N) s.  hold_start, hold_end: s.  energy: drawn from the battery until the end of the hold, J.

    Raises:
        InputError: a rig without a tube, an unknown parameter, or a wrong number of duties.

    Example:
        >>> import casadi, tubeopt
        >>> rig = tubeopt.load_rig("configs/rigs/thesis_calcium_silicate.yaml")
        >>> opti = casadi.Opti()
        >>> block = tubeopt.HeatingBlock(opti, rig)
        >>> block.keep_limits()
        >>> opti.minimize(block.objective("energy"))
        >>> opti.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes", "tol": 1e-6})
        >>> solution = opti.solve()
        >>> rise = block.temperature(0.0, block.hold_end) - block.T_amb
        >>> 475 < solution.value(rise) < 525
        True
    """

    def __init__(  # noqa: PLR0913
        self,
        opti: Any,
        rig: Rig,
        *,
        tube: Tube | None = None,
        spec: HeatingSpec | None = None,
        heating_time: Any = None,
        duty: Any = None,
        parameters: Mapping[str, Any] | None = None,
        refinement: int = 0,
        name: str = "heating",
    ) -> None:
        heated = rig.tube if tube is None else tube
        if heated is None:
            raise InputError("tube is missing; the rig has no tube, so it must be given")
        self.program, self.rig, self.tube, self.label = as_program(opti), rig, heated, f"{name}: "
        self.spec = HeatingSpec() if spec is None else spec
        thermal_data(self.tube)
        self.rig_values = dict(parameters or {})
        for key in self.rig_values:
            if key not in RIG_PARAMETERS:
                raise InputError(
                    f"parameters has the key {key!r}; allowed keys are {', '.join(RIG_PARAMETERS)}"
                    f"{nearest(str(key), RIG_PARAMETERS)}"
                )
        factor = 2 ** whole("refinement", refinement)
        mesh = replace(TIME_MESH, heating=factor * TIME_MESH.heating, hold=factor * TIME_MESH.hold)
        s = self._structure = Structure(PROGRAM, mesh)
        start = self._start(duty, heating_time)
        z = self._variable("states", s.states, s.points, start.z)
        circuit = self._variable("circuit", 2, s.points, start.circuit)
        if heating_time is None:
            # Every interval has a copy of the heating time: a single unknown would be a dense column.
            durations = self._variable("heating time", 1, s.mesh.heating, start.durations)
            same = ca.vec(ca.diff(durations, 1, 1))
            self.program.subject_to(self.label + "copies of the heating time", same, upper=0.0)
            longest = (self.spec.longest_heating - 0.5) / SCALE.duration
            self.program.subject_to(self.label + "longest heating", durations[0] - 0.5 / SCALE.duration, upper=longest)
        else:
            durations = ca.repmat(ca.MX(heating_time) / SCALE.duration, 1, s.mesh.heating)
        self.design = ca.MX(self._design(self.rig_values))
        copies = self._copies()
        designs = ca.horzcat(*(self._design(values) for values in copies))
        column = ca.horzcat(*(ca.MX(rig_parameters(self.tube, rig, PROGRAM, values)) for values in copies))
        if duty is None:
            I_sq = self._variable("mean square current", 1, s.mesh.intervals + 1, start.I_sq)
            self.program.subject_to(self.label + "current is not negative", ca.vec(I_sq))
        else:
            I_sq = self._duty_nodes(duty) * self._current_nodes(circuit, column) ** 2 / SCALE.I_sq
        super().__init__(
            PROGRAM,
            s.mesh,
            z=z,
            circuit=circuit,
            I_sq_nodes=I_sq,
            durations=durations,
            hold=self.spec.covered_time,
            designs=ca.repmat(designs, 1, s.points)
            if len(copies) == 1
            else ca.kron(designs, ca.DM.ones(1, mesh.degree)),
            column=column if len(copies) == 1 else ca.kron(column, ca.DM.ones(1, mesh.degree)),
            grid=grid_places(self.tube, rig, PROGRAM, fixed=not {"lead", "clearance"} & set(self.rig_values)),
        )
        self.program.subject_to(self.label + "heat balance and circuit", ca.vec(self.equations), upper=0.0)
        if duty is None:
            self._demand("duty", self.limits(dict.fromkeys(TASK, 1.0), ca.MX(1, s.points))["duty"])
        full = rig.battery.state_of_charge
        self.program.subject_to(self.label + "charge of the battery", (full - self.charge[-1]) / SCALE.charge)

    # --- constraints and objectives -----------------------------------------------------------------------------------

    def keep_limits(self, margin: Any = 0.0) -> None:
        """Constrain window, temperature limit, ramp and mean current to those of `spec` and of the rig.

        Ramp and current are less by the reserves of `plan_heating` for whole counts.

        Args:
            margin: distance from the ends of the window and from the limit, K: a number or an expression.
        """
        w = dict(zip(TASK, task_of(self.tube, self.rig, self.spec, (0.0, 0.0), RAMP_RESERVE).tolist(), strict=True))
        misses = ca.repmat(ca.MX(-margin), 1, self._structure.points)
        for name, expression in self.limits(w, misses).items():
            if name != "duty":
                self._demand(name, expression)

    def objective(self, name: str) -> Any:
        """Objective of `plan_heating` by its name (time, energy, margin), scaled, without the miss of a window.

        The objective "margin" is completed by subtracting the margin (K) that `keep_limits` has.
        """
        choice("objective", name, OBJECTIVES)
        w = dict(zip(TASK, task_of(self.tube, self.rig, self.spec, (0.0, 0.0), RAMP_RESERVE).tolist(), strict=True))
        w |= WEIGHTS[name]
        smooth = self.regularisation(w, self.design)
        return smooth + w["w_time"] * self.hold_start / SCALE.duration + w["w_energy"] * self.energy / SCALE.energy

    @staticmethod
    def solver(tolerance: float = 1e-8) -> Ipopt:
        """Settings of IPOPT for `problem.solve(block.solver())`; such programs then need 20 to 60 iterations.

        With its default settings, MUMPS loses the inertia of the steps to round-off: every step is tried several times.
        """
        further = {name.removeprefix("ipopt."): value for name, value in {**MUMPS, **COLD}.items()}
        return Ipopt(tolerance=tolerance, barrier=IPOPT.barrier, expand=True, further=further)

    @classmethod
    def solver_options(cls, tolerance: float = 1e-8) -> dict[str, Any]:
        """Options of `opti.solver("ipopt", block.solver_options())`, with the settings of `solver`."""
        # Every instant has its own operations then, and derivatives take an eighth of the time.
        return {**cls.solver(tolerance).options(), "expand": True}

    # --- results ------------------------------------------------------------------------------------------------------

    @without_unit_warnings()
    def rig_at(self, solution: Any) -> Rig:
        """Rig with the parameters of a solution, checked; raises InputError for values that no rig can have."""
        result = self.rig
        for name, value in self.rig_values.items():
            number = float(np.array(solution.value(value)).item()) if symbolic(value) else float(value)
            result = _with_number(result, RIG_PARAMETERS[name], number)
        return result

    def plan(self, solution: Any) -> HeatingPlan:
        """Plan of whole counts that realise the duty of a solution, simulated on the fine grid and compared with spec.

        Counts and the fine grid change temperatures by a few K: the program should keep that distance from the window
        (`keep_limits(margin=5.0)`). `plan_heating` corrects its program by this difference.
        """
        parts = (self.z, self.circuit, self.I_sq_nodes, self.durations)
        z, circuit, I_sq, durations = (np.atleast_2d(np.array(solution.value(part))) for part in parts)
        numbers = CourseNumbers(z.T, circuit.T, I_sq.ravel(), durations.ravel())
        ideal = ideal_of(self._structure, self.tube, self.rig_at(solution), self.spec, numbers)
        return HeatingPlan.of(self.tube, self.spec, realised_schedule(self.tube, self.spec, ideal), 0)

    # --- start and unknowns -------------------------------------------------------------------------------------------

    def _variable(self, name: str, rows: int, columns: int, start: Array) -> Any:
        """Matrix of unknowns of the order of 1, with its start by columns."""
        return ca.reshape(self.program.variable(self.label + name, rows * columns, guess=start.ravel()), rows, columns)

    def _copies(self) -> list[dict[str, Any]]:
        """Parameters of the rig in every interval, or once if no parameter is an expression.

        Each interval has copies of those that are: a single unknown would be a dense column, which fills the factors.
        """
        intervals = self._structure.mesh.intervals
        free = {name: value for name, value in self.rig_values.items() if symbolic(value)}
        rows = {}
        for name, value in free.items():
            size = _number_of(self.rig, RIG_PARAMETERS[name]) if name != "gap" else uniform_gap_of(self.tube, self.rig)
            rows[name] = size * self._variable(f"copies of {name}", 1, intervals, np.ones(intervals))
            differences = ca.diff(ca.horzcat(value, rows[name]), 1, 1) / size
            self.program.subject_to(self.label + f"copies of {name}", ca.vec(differences), upper=0.0)
        return [
            {**self.rig_values, **{name: row[k] for name, row in rows.items()}} for k in range(intervals if free else 1)
        ]

    def _design(self, values: Mapping[str, Any]) -> Any:
        """(2 + VENTS,) scaled clearance and lead, and vents."""
        lengths = {"clearance": self.rig.clamps.clearance, "lead": self.rig.mold.lead, **values}
        vents = vent_profile(self.rig, np.linspace(0.0, 1.0, VENTS))
        return ca.vertcat(lengths["clearance"] / SCALE.length, lengths["lead"] / SCALE.length, vents)

    def _demand(self, name: str, expression: Any) -> None:
        """Add one of the constraints of `limits`."""
        low, high = LIMIT_RANGES[name]
        distance = high - expression if np.isfinite(high) else expression - low
        self.program.subject_to(self.label + name, ca.vec(distance))

    def _start(self, duty: Any, heating_time: Any) -> CourseNumbers:
        """Unknowns of a simulation: of the duty if it is in numbers, otherwise of a controller."""
        s, spec = self._structure, self.spec
        if not symbolic(heating_time) and heating_time is not None:
            # The controller heats for that time.
            spec = replace(spec, longest_heating=float(heating_time))
        parts = np.split(first_guess(s, self.tube, self.rig, spec), np.cumsum([r * c for r, c in s.unknowns.values()]))
        z, circuit, I_sq, durations = parts[:4]
        return CourseNumbers(z.reshape(s.points, -1), circuit.reshape(s.points, 2), I_sq, durations)

    def _duty_nodes(self, duty: Any) -> Any:
        """(1, 1+K) duty at the ends of the intervals."""
        nodes = self._structure.mesh.intervals + 1
        column = ca.vec(ca.MX(duty) if symbolic(duty) else ca.MX(ca.DM(np.atleast_1d(np.asarray(duty, dtype=float)))))
        if column.numel() not in (1, nodes):
            raise InputError(f"duty has {column.numel()} entries; it must have 1, or {nodes} at the ends of intervals")
        return ca.repmat(column, 1, nodes) if column.numel() == 1 else column.T

    def _current_nodes(self, circuit: Any, column: Any) -> Any:
        """(1, 1+K) current while the MOSFET conducts at the ends of the intervals, A."""
        p = heat.Properties.of(column[: len(heat.PROPERTIES), 0])
        values = {"clearance": self.rig.clamps.clearance, "lead": self.rig.mold.lead, **self.rig_values}
        # At rest the whole tube outside the clamps is at the ambient temperature.
        length = values["clearance"] + values["lead"] + p.L_curved
        R_half = p.r_tube * length * (1 + p.r_slope * (p.T_amb - p.T_ref))
        I_start = p.V_start / heat.loop_resistance(R_half, p)
        degree = self._structure.mesh.degree
        return ca.horzcat(I_start, SCALE.current * circuit[0, degree - 1 :: degree])


def _number_of(whole: Any, path: tuple[str, ...]) -> float:
    """Number among the parts of a dataclass."""
    return float(reduce(getattr, path, whole))


def _with_number(whole: Any, path: tuple[str, ...], value: float) -> Any:
    """Copy of a dataclass with one number of its parts changed, checked."""
    first, *others = path
    return replace(whole, **{first: _with_number(getattr(whole, first), tuple(others), value) if others else value})
