"""Heating schedule as an optimal control problem: finite volumes along the tube, Radau collocation in time.

Two phases, heating of free duration and hold of given duration, share their states where they meet. Unknowns are the
temperatures at all collocation points, the mean square current I^2 times duty (linear between nodes), and what may be
chosen of the rig: clearance, lead and vents. These are always unknowns, fixed by their bounds where the rig is given,
so that one compiled program serves every tube, rig and question. The current and the tube's resistance are unknowns of
their own: eliminated, they would couple every temperature with every other.

The equations of one instant depend on few unknowns, and linearly on the rates of its temperatures. They are
differentiated as symbols once and evaluated at all points. Automatic differentiation of the whole program would take
one sweep for each direction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from ...block.transcription.tableau import tableau
from ...physics import heat
from ...physics.heat import CLEARANCE, CURVED, GRIP, LEAD, PROPERTIES, Properties, Resolution, Shells, zones
from ...robots.tubes import Tube
from ...solvers.settings import Ipopt
from ...typing import Array
from .rig import Rig
from .thermal import cell_fractions, contact_decay, covered_fraction, half_lengths, rig_numbers


class Scales(NamedTuple):
    """Sizes by which unknowns and residuals are divided, so that IPOPT sees numbers of the order of 1."""

    T: float = 500.0
    """Temperature above ambient, K."""
    charge: float = 1e-2
    """Fraction of the battery's capacity."""
    V_sag: float = 0.1
    """Voltage sag, V."""
    current: float = 100.0
    """Current, A."""
    R: float = 0.1
    """Resistance of half the tube, ohm."""
    length: float = 1e-2
    """Clearance and lead, m."""
    duration: float = 30.0
    """Heating time, s."""
    I_sq: float = 100.0
    """Mean square current, A^2."""
    voltage: float = 10.0
    """Residual of the circuit, V."""
    window: float = 10.0
    """Constraints of the window, K."""
    band: float = 25.0
    """Distance from the window's middle in the objective, K."""
    energy: float = 1e4
    """Energy in the objective, J."""


SCALE = Scales()

VENTS = 6
"""Number of points from the end of the mold to its middle at which vents may be chosen; linear between them."""

OWN, PARAMETERS = (0, 2, 3, 4), 5
"""Inputs of `instant`: those that are unknowns of the instant other than rates, and the parameters of tube and rig."""


def rig_parameters(tube: Tube, rig: Rig, resolution: Resolution) -> Array:
    """Column of all parameters of tube and rig in the program; `Parameters` takes it apart.

    Properties, fractions of the cells (n,), geometry of the shells, and the weights of the vents at the covered cells.
    """
    numbers = rig_numbers(tube, rig, resolution.shells)
    position = covered_fraction(tube, rig, resolution)
    weights = np.array([np.interp(position, np.linspace(0.0, 1.0, VENTS), unit) for unit in np.eye(VENTS)])
    fractions = cell_fractions(resolution, half_lengths(tube, rig), contact_decay(tube, rig))
    return np.concatenate([numbers.properties, fractions, *numbers.shells, weights.ravel()])


def parameter_count(resolution: Resolution) -> int:
    """Length of the column of `rig_parameters`."""
    return len(PROPERTIES) + resolution.cells + 2 * resolution.shells - 1 + resolution.covered * VENTS


@dataclass(frozen=True, eq=False)
class Parameters:
    """Parameters of tube and rig as symbols."""

    properties: Properties
    fraction: Any
    """(n,) width of each cell as a fraction of its zone."""
    shells: Shells
    vents: Any
    """(c, VENTS) weights of the chosen vents at the covered cells."""

    @classmethod
    def of(cls, column: Any, resolution: Resolution) -> Parameters:
        """Parameters from the column of `rig_parameters`."""
        n, m, covered = resolution.cells, resolution.shells, resolution.covered
        ends = np.cumsum([0, len(PROPERTIES), n, m, m - 1, covered * VENTS]).tolist()
        properties, fraction, area, log_ratio, vents = ca.vertsplit(column, ends)
        return cls(Properties.of(properties), fraction, Shells(area, log_ratio), ca.reshape(vents, covered, VENTS))

    def widths(self, resolution: Resolution, design: Any) -> Any:
        """(n,) widths of the cells at a scaled design, m."""
        p = self.properties
        lengths = {
            GRIP: p.L_grip, CLEARANCE: SCALE.length * design[0], LEAD: SCALE.length * design[1], CURVED: p.L_curved,
        }  # fmt: skip
        return self.fraction * ca.vertcat(*(lengths[int(zone)] for zone in zones(resolution)))


@lru_cache(maxsize=8)
def instant(resolution: Resolution) -> ca.Function:
    """Function (z, z', circuit, I_sq, design, parameters) -> (equations, battery power in W) of one instant.

    All unknowns are scaled. z: temperatures of tube, shells cell by cell and clamp above ambient, charge drawn, sag; z'
    is per s. circuit: current while the MOSFET conducts, and resistance of half the tube. design: clearance, lead, and
    vents at equal distances.
    """
    n, m, covered = resolution.cells, resolution.shells, resolution.covered
    sizes = {"z": n + covered * m + 3, "rate": n + covered * m + 3, "circuit": 2, "I_sq": 1, "design": 2 + VENTS}
    z, rate, circuit, I_sq, design = (ca.SX.sym(name, size) for name, size in sizes.items())
    column = ca.SX.sym("p", parameter_count(resolution))
    parameters = Parameters.of(column, resolution)
    p = parameters.properties
    vent = ca.mtimes(parameters.vents, design[2:])
    v = heat.volumes(p, parameters.widths(resolution, design), vent, parameters.shells, resolution)
    T = heat.Temperatures(
        tube=p.T_amb + SCALE.T * z[:n],
        mold=p.T_amb + SCALE.T * ca.reshape(z[n : n + covered * m], m, covered).T,
        clamp=p.T_amb + SCALE.T * z[-3],
    )
    x = heat.RigState(T, SCALE.charge * z[-2], SCALE.V_sag * z[-1])
    I_on = SCALE.current * circuit[0]
    drive = heat.Drive(R_half=SCALE.R * circuit[1], I_mean=SCALE.I_sq * I_sq / I_on, I_sq=SCALE.I_sq * I_sq)
    x_dot = heat.state_rates(x, heat.energy_balance(T, drive, v, p), drive, v, p)
    z_dot = ca.vertcat(
        x_dot.T.tube / SCALE.T,
        ca.vec(x_dot.T.mold.T) / SCALE.T,
        x_dot.T.clamp / SCALE.T,
        x_dot.charge / SCALE.charge,
        x_dot.V_sag / SCALE.V_sag,
    )
    V_oc = heat.open_circuit_voltage(x.charge, p)
    # Current and resistance stay unknowns: eliminated, every cell would couple to all others.
    voltage = (I_on * heat.loop_resistance(drive.R_half, p) - V_oc + x.V_sag) / SCALE.voltage
    resistance = ca.sum1(heat.cell_resistance(T.tube, v, p)) / SCALE.R - circuit[1]
    equations = ca.vertcat(rate - z_dot, voltage, resistance)
    return ca.Function("instant", [z, rate, circuit, I_sq, design, column], [equations, drive.I_mean * V_oc])


class Derivative(NamedTuple):
    """Sparse derivative of one instant."""

    nonzeros: ca.Function
    pattern: Any


@lru_cache(maxsize=8)
def instant_derivatives(resolution: Resolution) -> tuple[Derivative, Derivative]:
    """Jacobian and Hessian of `instant` by its own unknowns and the length of its interval.

    The rates, in which the equations are linear, are left out. The Jacobian of the equations is a function of (own
    unknowns, parameters). The Hessian, of (own unknowns, parameters, multipliers, weight), is that of the equations
    times multipliers, and of the energy, power times length, times a weight.
    """
    whole = instant(resolution)
    inputs = whole.sx_in()
    sizes = np.cumsum([0, *(inputs[k].numel() for k in OWN), 1]).tolist()
    own, parameters = ca.SX.sym("own", sizes[-1]), inputs[PARAMETERS]
    z, circuit, I_sq, design, length = ca.vertsplit(own, sizes)
    equations, power = whole(z, ca.SX(*z.shape), circuit, I_sq, design, parameters)
    multipliers, weight = ca.SX.sym("multipliers", equations.numel()), ca.SX.sym("weight")
    # Derivatives of one instant serve all points by a map: the pattern is built and coloured once.
    J = ca.jacobian(equations, own)
    H = ca.hessian(ca.dot(multipliers, equations) + weight * length * power, own)[0]
    jacobian = ca.Function("slopes", [own, parameters], [J.nz[:]], {"cse": True})
    hessian = ca.Function("bends", [own, parameters, multipliers, weight], [H.nz[:]], {"cse": True})
    return Derivative(jacobian, J.sparsity()), Derivative(hessian, H.sparsity())


def exact_derivatives(
    problem: dict[str, Any], resolution: Resolution, *, parameters: Any, own: Any, rest: dict[str, Any], weights: Any
) -> dict[str, ca.Function]:
    """Jacobian of the constraints of a program and Hessian of its Lagrangian, as options of its `nlpsol`.

    Both are sums of what depends on the unknowns through the instants, and the rest.

    Args:
        parameters: of tube and rig.
        own: (Y, N) own unknowns of every instant and the length of its interval, linear in the unknowns.
        rest: objective "f" without the energy; all constraints "g", where the equations of the instants, which come
            first, are reduced to their rates.
        weights: (1, N) of power times length in the objective.
    """
    x, p, g = (problem[name] for name in "xpg")
    jacobian, hessian = instant_derivatives(resolution)
    count, size = own.size2(), jacobian.pattern.size1()
    factor, multipliers = ca.MX.sym("factor"), ca.MX.sym("multipliers", g.numel())
    of_instants = ca.reshape(multipliers[: count * size], size, count)
    J_nonzeros = jacobian.nonzeros.map("slopes", "serial", count, [1], [])(own, parameters)
    H_nonzeros = hessian.nonzeros.map("bends", "serial", count, [1], [])(own, parameters, of_instants, factor * weights)
    # Chain rule with a constant matrix, as own unknowns and interval lengths are linear in x.
    own_by_x = ca.jacobian(ca.vec(own), x)
    # Only the first constraints, the equations of instants, depend on x through them.
    others = ca.MX(g.numel() - count * size, x.numel())
    J = ca.jacobian(rest["g"], x) + ca.vertcat(ca.mtimes(_blocks(jacobian.pattern, J_nonzeros), own_by_x), others)
    lagrangian = factor * rest["f"] + ca.dot(multipliers, rest["g"])
    H = ca.hessian(lagrangian, x)[0] + ca.mtimes([own_by_x.T, _blocks(hessian.pattern, H_nonzeros), own_by_x])
    inputs = {"x": x, "p": p}
    return {
        "jac_g": _function("jac_g", inputs, {"g": g, "jac_g_x": J}),
        "hess_lag": _function(
            "hess_lag", {**inputs, "lam_f": factor, "lam_g": multipliers}, {"triu_hess_gamma_x_x": ca.triu(H)}
        ),
    }


def _blocks(pattern: Any, values: Any) -> Any:
    """Block-diagonal matrix of one pattern with its nonzeros in columns."""
    return ca.MX(ca.diagcat(*[pattern] * values.size2()), ca.vec(values))


def _function(name: str, inputs: dict[str, Any], outputs: dict[str, Any]) -> ca.Function:
    return ca.Function(name, list(inputs.values()), list(outputs.values()), list(inputs), list(outputs))


# --- the program ------------------------------------------------------------------------------------------------------


TASK = (
    "hold", "low", "high", "limit", "ramp", "current", "w_time", "w_energy", "w_centre", "w_miss", "w_I_sq",
)  # fmt: skip
"""Parameters of the question: hold (s), window and limit (K), ramp (K/s), mean current (A), and objective weights."""

REGULARISATION = 1e-5
"""Added to the diagonal of the convex Hessian, in scaled unknowns."""

W_LENGTH, W_VENT, W_VENT_CHANGE = 1e-2, 1.0, 20.0
"""Weights in the objective of the squares of clearance and lead (scaled), of the vents, and of their differences."""

# The objective is in units of about 1 K and 30 s: a tolerance of 1e-4 is far below what the coarse grid and counts
# change. Tubes that are hard to heat take up to about 150 iterations.
IPOPT = Ipopt(tolerance=1e-4, constraint_tolerance=1e-7, iterations=250, barrier=1e-2)

# A correction moves the bounds by a few K, which takes 5 to 15 steps. After more a new start is faster.
RESTART_ITERATIONS = 25
"""Iterations from an earlier solution before a new start."""

MUMPS: dict[str, Any] = {
    # With the default the inertia is lost to round-off, and every step is tried several times.
    "ipopt.mumps_pivtol": 1e-2,
    "ipopt.mumps_pivot_order": 5,  # METIS: the pattern is that of a grid, in space and time.
    # Memory beyond the estimate of the analysis, in percent. Ten times as much would be mapped anew in every iteration.
    "ipopt.mumps_mem_percent": 20,
}

# The program is nearly linear: each barrier problem needs little accuracy.
COLD: dict[str, Any] = {"ipopt.barrier_tol_factor": 100.0}
WARM: dict[str, Any] = {
    "ipopt.mu_init": 1e-5,
    "ipopt.warm_start_init_point": "yes",
    "ipopt.warm_start_bound_push": 1e-6,
    "ipopt.warm_start_bound_frac": 1e-6,
    "ipopt.warm_start_slack_bound_push": 1e-6,
    "ipopt.warm_start_slack_bound_frac": 1e-6,
    "ipopt.warm_start_mult_bound_push": 1e-6,
}


@dataclass(frozen=True)
class TimeMesh:
    """Numbers of intervals of heating and hold, and of collocation points in each; short where the phases meet."""

    heating: int = 14
    hold: int = 10
    degree: int = 2

    @property
    def fractions(self) -> tuple[Array, Array]:
        """Faces of the intervals in each phase, from 0 to 1."""
        up, on = np.linspace(0.0, 1.0, self.heating + 1), np.linspace(0.0, 1.0, self.hold + 1)
        return 1 - np.sinh(1.5 * up[::-1]) / math.sinh(1.5), np.sinh(4.0 * on) / math.sinh(4.0)

    def times(self, heating: float, hold: float) -> tuple[Array, Array]:
        """Faces of the intervals, and collocation points (N,), s, for durations of heating and hold, s."""
        first, second = self.fractions
        faces = np.concatenate([heating * first, heating + hold * second[1:]])
        return faces, (faces[:-1, None] + np.diff(faces)[:, None] * tableau("radau", self.degree).nodes).ravel()


@dataclass(frozen=True)
class Structure:
    """Everything that the structure of a program depends on: each needs a compiled program of its own."""

    resolution: Resolution
    mesh: TimeMesh = TimeMesh()
    soft_limit: bool = False
    """Whether the limit is relaxed by the miss as the window is; otherwise it is a bound of the unknowns."""
    chosen: tuple[str, ...] = ()
    """Parameters of the rig that may be chosen: every interval has a copy of them."""

    @property
    def copied(self) -> list[int]:
        """Rows of the design that may be chosen."""
        rows = {"clearance": [0], "lead": [1], "vents": list(range(2, 2 + VENTS))}
        return [row for name, of_name in rows.items() if name in self.chosen for row in of_name]

    @property
    def copies(self) -> int:
        """Number of unknowns, the last ones, that copy the chosen design into all intervals but the first."""
        return len(self.copied) * (self.mesh.heating + self.mesh.hold - 1)

    def copies_of(self, design: Array) -> Array:
        """Values of the copies of a design (2 + VENTS,)."""
        return np.resize(design[self.copied], self.copies)

    @property
    def states(self) -> int:
        """Number of states: temperatures of tube, shells and clamp, charge drawn and sag."""
        return self.resolution.cells + self.resolution.covered * self.resolution.shells + 3

    @property
    def points(self) -> int:
        """Number of collocation points in time, N."""
        return (self.mesh.heating + self.mesh.hold) * self.mesh.degree

    @property
    def unknowns(self) -> dict[str, tuple[int, int]]:
        """Shapes of the unknowns by their names, in order."""
        intervals = self.mesh.heating + self.mesh.hold
        return {
            "z": (self.states, self.points),
            "circuit": (2, self.points),
            "I_sq": (1, intervals + 1),
            "durations": (1, self.mesh.heating),
            "misses": (1, self.points),
            "design": (2 + VENTS, 1),
            "copies": (len(self.copied), intervals - 1),
        }

    @property
    def holding_points(self) -> int:
        """Number of points of the hold, H, with the one at which it begins."""
        return self.mesh.hold * self.mesh.degree + 1


@dataclass(frozen=True, eq=False)
class Program:
    """Compiled solvers of the program of one structure."""

    structure: Structure
    exact: Any
    """Solver with the exact Hessian."""
    restart: Any
    """Solver that starts at an earlier solution and takes few steps."""
    convex: Any
    """Solver with a convex part of the Hessian, for when the others fail."""
    split: Any
    """Function that takes the column of unknowns apart."""
    sizes: dict[str, int]
    """Number of constraints of each kind, in their order."""

    def worst(self, violation: Array) -> str:
        """Description of the constraint that is violated most."""
        row = int(np.argmax(violation))
        for name, size in self.sizes.items():
            if row < size:
                return f"the worst constraint is {name}, entry {row + 1} of {size}, violated by {violation.max():.1e}"
            row -= size
        raise AssertionError


def differentiation(mesh: TimeMesh) -> Array:
    """(1+N, N) matrix from values at start and points to rates at the points times the interval's length."""
    # Radau IIA is stiffly accurate: the last point is the end, where the next interval begins.
    nodes = np.concatenate([[0.0], tableau("radau", mesh.degree).nodes])
    k, count = mesh.degree, mesh.heating + mesh.hold
    powers = np.arange(k + 1)
    slopes = powers * nodes[1:, None] ** np.maximum(powers - 1, 0)
    local = slopes @ np.linalg.inv(np.vander(nodes, increasing=True))
    D = np.zeros((1 + count * k, count * k))
    for i in range(count):
        D[i * k : (i + 1) * k + 1, i * k : (i + 1) * k] = local.T
    return D


def interpolation(mesh: TimeMesh) -> Array:
    """(1+K, N) matrix from values at the ends of the intervals to values at the points, linear in between."""
    nodes, count = tableau("radau", mesh.degree).nodes, mesh.heating + mesh.hold
    mix = np.zeros((count + 1, count * mesh.degree))
    for i in range(count):
        columns = slice(i * mesh.degree, (i + 1) * mesh.degree)
        # The mean square current is continuous and linear in every interval.
        mix[i, columns], mix[i + 1, columns] = 1 - nodes, nodes
    return mix


@dataclass(frozen=True, eq=False)
class _Unknowns:
    """Symbols of the unknowns.

    There is a copy of the duration in every interval and of the miss at every point: a single one would be a dense
    column, which fills the factors. The same holds for the chosen design.
    """

    z: Any
    """(S, N) states at the points."""
    circuit: Any
    """(2, N) current and resistance of half the tube at the points."""
    I_sq: Any
    """(1, 1+K) mean square current at the ends of the intervals."""
    durations: Any
    """(1, intervals of heating) copies of the heating time."""
    misses: Any
    """(1, N) copies of the miss of the window."""
    design: Any
    """(2 + VENTS,) clearance, lead and vents."""
    copies: Any
    """(chosen rows, K-1) copies of the chosen design in the other intervals."""

    @property
    def column(self) -> Any:
        """All unknowns in one column."""
        return ca.veccat(*vars(self).values())

    def designs(self, s: Structure) -> Any:
        """(2 + VENTS, N) design at every point: that of its interval."""
        count = s.mesh.heating + s.mesh.hold
        rows = [ca.repmat(row, 1, count) for row in ca.vertsplit(self.design)]
        for k, row in enumerate(s.copied):
            rows[row] = ca.horzcat(self.design[row], self.copies[k, :])
        return ca.kron(ca.vertcat(*rows), ca.DM.ones(1, s.mesh.degree))


def _hold_temperatures(s: Structure, x: _Unknowns, parameters: Parameters, designs: Any) -> Any:
    """(1+c, H) temperatures (K) at the start of the curved part and at its cells, at the points of the hold."""
    first = s.resolution.cells - s.resolution.curved
    rows = x.z[first - 1 : s.resolution.cells, s.points - s.holding_points :] * SCALE.T
    # The joint of lead and curve lies between two cells whose widths the design may change.
    columns = ca.horzsplit(designs[:, s.points - s.holding_points :])
    widths = [parameters.widths(s.resolution, design)[first - 1 : first + 1] for design in columns]
    before, after = ca.vertsplit(ca.horzcat(*widths))
    joint = (after * rows[0, :] + before * rows[1, :]) / (before + after)
    return ca.vertcat(joint, rows[1:, :]) + parameters.properties.T_amb


@lru_cache(maxsize=8)
def program(s: Structure) -> Program:
    """Compiled program of a structure."""
    x, mesh = _Unknowns(**{name: ca.MX.sym(name, *shape) for name, shape in s.unknowns.items()}), s.mesh
    p, task = ca.MX.sym("p", parameter_count(s.resolution)), ca.MX.sym("task", len(TASK))
    w = dict(zip(TASK, ca.vertsplit(task), strict=True))
    parameters = Parameters.of(p, s.resolution)
    T_amb = parameters.properties.T_amb

    # Length of the interval of every point: heating time and hold, split by the mesh.
    heating_parts, hold_parts = (np.diff(faces) for faces in mesh.fractions)
    heating = SCALE.duration * ca.repmat(x.durations * ca.DM(heating_parts).T, mesh.degree, 1)
    length = ca.horzcat(ca.vec(heating).T, w["hold"] * ca.DM(np.repeat(hold_parts, mesh.degree)).T)

    # Collocation: rates and mean square currents at the points; everything begins at ambient temperature.
    values = ca.horzcat(ca.DM.zeros(s.states, 1), x.z)
    rate = ca.mtimes(values, ca.sparsify(ca.DM(differentiation(mesh)))) / ca.repmat(length, s.states, 1)
    I_sq = ca.mtimes(x.I_sq, ca.sparsify(ca.DM(interpolation(mesh))))
    designs = x.designs(s)
    instants = instant(s.resolution).map("instants", "serial", s.points, [5], [])
    equations, power = instants(x.z, rate, x.circuit, I_sq, designs, p)

    T_hold = _hold_temperatures(s, x, parameters, designs)
    misses = ca.repmat(x.misses[s.points - s.holding_points :], T_hold.size1(), 1)
    limit = (w["limit"] - T_amb + x.misses) / SCALE.T
    blocks = {
        "equations": equations,
        # Copies are equal by constraints of two entries each, which keep the factors sparse.
        "same": ca.horzcat(ca.diff(x.durations, 1, 1), ca.diff(x.misses, 1, 1)),
        "low": (T_hold + misses - w["low"]) / SCALE.window,
        "high": (T_hold - misses - w["high"]) / SCALE.window,
        "limit": (x.z[: s.resolution.cells, :] - ca.repmat(limit, s.resolution.cells, 1))[:, : s.soft_limit * s.points],
        "ramp": rate[s.resolution.grip : s.resolution.cells, :] * SCALE.T / w["ramp"],
        "current": I_sq * SCALE.I_sq / (x.circuit[0, :] * SCALE.current) / w["current"],
        # duty = I_sq / I^2 at most 1, times I^2: polynomial, and finite where the current is small.
        "duty": I_sq * SCALE.I_sq / SCALE.current**2 - x.circuit[0, :] ** 2,
        # Copies of the design are equal from interval to interval, as those of the duration.
        "chosen": ca.diff(ca.horzcat(x.design[s.copied], x.copies), 1, 1) if s.copied else ca.MX(0, 1),
    }

    # Squares of the distance from the middle of the window and of changes of the current.
    changes = ca.diff(x.I_sq, 1, 1)
    # From the last interval of heating to the first of the hold the current may jump.
    changes[mesh.heating] = 0
    middle = 0.5 * (w["low"] + w["high"])
    smooth = w["w_centre"] * ca.sumsqr((T_hold - middle) / SCALE.band) / T_hold.numel()
    smooth += w["w_I_sq"] * ca.sumsqr(changes)
    # Among equally good clearances, leads and vents the smallest; squares damp the steps of bilinear terms. Vents that
    # change fast along the tube would compensate errors of the coarse grid.
    smooth += W_LENGTH * ca.sumsqr(x.design[:2]) + W_VENT * ca.sumsqr(x.design[2:])
    smooth += W_VENT_CHANGE * ca.sumsqr(ca.diff(x.design[2:]))
    linear = w["w_time"] * x.durations[0] + w["w_miss"] * x.misses[0]
    # Energy is the quadrature of power, with the weights of the collocation.
    quadrature = np.tile(tableau("radau", mesh.degree).weights, mesh.heating + mesh.hold)
    energy = w["w_energy"] / SCALE.energy * ca.DM(quadrature).T

    problem = {
        "x": x.column,
        "p": ca.veccat(p, task),
        "f": smooth + linear + ca.sum2(power * energy * length),
        "g": ca.veccat(*blocks.values()),
    }
    blocks["equations"] = ca.vertcat(rate, ca.MX(equations.size1() - s.states, s.points))
    derivatives = exact_derivatives(
        problem,
        s.resolution,
        parameters=p,
        own=ca.vertcat(x.z, x.circuit, I_sq, designs, length),
        rest={"f": smooth + linear, "g": ca.veccat(*blocks.values())},
        weights=energy,
    )
    exact = {**IPOPT.options(warm=False), **MUMPS, **derivatives}
    convex = {**exact, "hess_lag": _convex_hessian(problem, smooth)}
    return Program(
        structure=s,
        convex=ca.nlpsol("heating", "ipopt", problem, {**convex, **COLD}),
        restart=ca.nlpsol("heating_again", "ipopt", problem, {**exact, **WARM, "ipopt.max_iter": RESTART_ITERATIONS}),
        exact=ca.nlpsol("heating_exact", "ipopt", problem, {**exact, **COLD}),
        split=ca.Function("split", [x.column], [x.z, x.circuit, x.I_sq, x.durations[0], x.misses[0], x.design]),
        sizes={name: int(block.numel()) for name, block in blocks.items()},
    )


def _convex_hessian(problem: dict[str, Any], smooth: Any) -> ca.Function:
    """Hessian of the squares in the objective alone, a little regularised: the equations are nearly linear.

    With it every step is that of a convex quadratic program. Where the equations are curved, such steps are short.
    """
    x = problem["x"]
    weight, multipliers = ca.MX.sym("weight"), ca.MX.sym("multipliers", problem["g"].numel())
    H = ca.hessian(smooth, x)[0] * weight + REGULARISATION * ca.DM.eye(x.numel())
    return ca.Function("curvature", [x, problem["p"], weight, multipliers], [ca.triu(H)])
