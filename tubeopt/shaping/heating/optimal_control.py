"""The heating schedule as an optimal control problem: finite volumes along the tube, Radau collocation in time.

Two phases, the heating-up whose duration is free and the hold whose duration is given, share their states where they
meet. Unknowns are the temperatures at all collocation points, the drive I^2 times duty (linear between nodes), and what
of the rig may be chosen: clearance, lead and vents. They are always there, and fixed by their bounds where the rig is
as it is, so that one compiled program serves every tube, every rig and every question. The current and the tube's
resistance are unknowns of their own: eliminated, they would couple every temperature with every other.

An instant depends on few unknowns, and linearly on the rates of its temperatures. Differentiated as symbols once, it is
evaluated at all points; with all unknowns at once it would be differentiated in one direction after the other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from ...block.transcription.tableau import tableau
from ...physics import heat
from ...physics.heat import CLEARANCE, CURVED, GRIP, LEAD, PROPERTIES, Properties, Resolution, named, zones
from ...robots.tubes import Tube
from ...solvers.settings import Ipopt
from ...typing import Array
from .rig import Rig
from .thermal import cell_fractions, contact_decay, covered_fraction, half_lengths, model_numbers

RISE = 500.0
"""Size of a temperature, K."""

CHARGE, SAG, AMPERE, OHM, LENGTH, DURATION, DRIVE = 1e-2, 0.1, 100.0, 0.1, 1e-2, 30.0, 100.0
"""Sizes of the other unknowns, by which they are scaled: fraction, V, A, ohm, m, s and A^2."""

VOLT = 10.0
"""Size of the residual of the circuit, V."""

VENTS = 6
"""Places from the end of the mold to its middle at which vents may be chosen; linear between them."""

OWN, NUMBERS = (0, 2, 3, 4), 5
"""Inputs of an instant: the unknowns that are its own, and the numbers of tube and rig."""


def physics(tube: Tube, rig: Rig, resolution: Resolution) -> Array:
    """The numbers of tube and rig, as `Numbers` takes them apart again.

    Values of `PROPERTIES`, the cells' fractions (n,), the shells' rings (M,) in m^2 and log ratios (M-1,), and the
    weights of the vents at the covered cells, by column.
    """
    scalars, shells = model_numbers(tube, rig, resolution.shells)
    place = covered_fraction(tube, rig, resolution)
    weights = np.array([np.interp(place, np.linspace(0.0, 1.0, VENTS), unit) for unit in np.eye(VENTS)])
    fractions = cell_fractions(resolution, half_lengths(tube, rig), contact_decay(tube, rig))
    return np.concatenate([scalars, fractions, *shells, weights.ravel()])


def number_count(resolution: Resolution) -> int:
    """Length of what `physics` returns."""
    return len(PROPERTIES) + resolution.cells + 2 * resolution.shells - 1 + resolution.covered * VENTS


@dataclass(frozen=True, eq=False)
class Numbers:
    """What `physics` returns, as symbols: scalars by name, and columns."""

    scalar: Properties
    fraction: Any
    shells: tuple[Any, Any]
    vents: Any

    @classmethod
    def of(cls, p: Any, resolution: Resolution) -> Numbers:
        """From the column of all numbers."""
        n, m, covered = resolution.cells, resolution.shells, resolution.covered
        ends = np.cumsum([0, len(PROPERTIES), n, m, m - 1, covered * VENTS]).tolist()
        scalars, fraction, ring, ratio, vents = ca.vertsplit(p, ends)
        return cls(named(scalars), fraction, (ring, ratio), ca.reshape(vents, covered, VENTS))

    def widths(self, resolution: Resolution, design: Any) -> Any:
        """(n,) widths of the cells, m, at a scaled design."""
        g = self.scalar
        lengths = {GRIP: g["grip"], CLEARANCE: LENGTH * design[0], LEAD: LENGTH * design[1], CURVED: g["curved"]}
        return self.fraction * ca.vertcat(*(lengths[int(zone)] for zone in zones(resolution)))


@lru_cache(maxsize=8)
def instant(resolution: Resolution) -> ca.Function:
    """(z, z', circuit, drive, design, numbers) -> (equations, power from the battery) at one instant.

    All but numbers and power are scaled. z: temperatures of tube, shells cell by cell and clamp above ambient, charge
    used, sag; z' is per s. circuit: current while the MOSFET conducts, half the tube's resistance. design: clearance,
    lead, and vents at equal distances.
    """
    n, m, covered = resolution.cells, resolution.shells, resolution.covered
    names = {"z": n + covered * m + 3, "rate": n + covered * m + 3, "circuit": 2, "drive": 1, "design": 2 + VENTS}
    z, rate, circuit, drive, design = (ca.SX.sym(name, size) for name, size in names.items())
    p = ca.SX.sym("p", number_count(resolution))
    numbers = Numbers.of(p, resolution)
    g = numbers.scalar
    vent = ca.mtimes(numbers.vents, design[2:])
    v = heat.volumes(g, numbers.widths(resolution, design), vent, numbers.shells, resolution)
    at = heat.Temperatures(
        # Scaled unknowns are of the order of 1, which IPOPT's tolerances and barrier take for granted.
        tube=g["ambient"] + RISE * z[:n],
        mold=g["ambient"] + RISE * ca.reshape(z[n : n + covered * m], m, covered).T,
        clamp=g["ambient"] + RISE * z[-3],
    )
    ampere, sagged = AMPERE * circuit[0], SAG * z[-1]
    load = heat.Load(half=OHM * circuit[1], mean=DRIVE * drive / ampere, drive=DRIVE * drive)
    flows = heat.heat_flows(at, load, v, g)
    discharge, sagging = heat.battery_rates(load, sagged, g)
    rates = ca.vertcat(
        flows.tube / heat.tube_capacity(at.tube, v, g) / RISE,
        ca.vec((flows.mold / v.shell_heat).T) / RISE,
        flows.clamp / g["clamp_heat"] / RISE,
        discharge / CHARGE,
        sagging / SAG,
    )
    source = heat.source_voltage(CHARGE * z[-2], g)
    # Current and resistance stay unknowns: eliminated, every cell would couple to all others.
    voltage = (ampere * heat.loop_resistance(load.half, g) - source + sagged) / VOLT
    resistance = ca.sum1(heat.resistances(at.tube, v, g)) / OHM - circuit[1]
    equations = ca.vertcat(rate - rates, voltage, resistance)
    return ca.Function("instant", [z, rate, circuit, drive, design, p], [equations, load.mean * source])


@lru_cache(maxsize=8)
def instant_derivatives(resolution: Resolution) -> tuple[tuple[ca.Function, Any], tuple[ca.Function, Any]]:
    """Of `instant`, by its own unknowns with the length of its interval: functions that return the nonzeros of a
    pattern, and the pattern. The rates, in which the equations are linear, are left out.

    The first, of (own unknowns, numbers), is the Jacobian of the equations; the second, of (own unknowns, numbers,
    multipliers, weight), the Hessian of the equations times multipliers, and of the energy, power times length, times a
    weight.
    """
    whole = instant(resolution)
    inputs = whole.sx_in()
    sizes = np.cumsum([0, *(inputs[k].numel() for k in OWN), 1]).tolist()
    own, numbers = ca.SX.sym("own", sizes[-1]), inputs[NUMBERS]
    *parts, length = ca.vertsplit(own, sizes)
    state, *others = parts
    equations, power = whole(state, ca.SX(*state.shape), *others, numbers)
    multipliers, weight = ca.SX.sym("multipliers", equations.numel()), ca.SX.sym("weight")
    # One instant's derivatives serve all points by a map: the pattern is built and coloured once.
    J = ca.jacobian(equations, own)
    H = ca.hessian(ca.dot(multipliers, equations) + weight * length * power, own)[0]
    slopes = ca.Function("slopes", [own, numbers], [J.nz[:]], {"cse": True})
    bends = ca.Function("bends", [own, numbers, multipliers, weight], [H.nz[:]], {"cse": True})
    return (slopes, J.sparsity()), (bends, H.sparsity())


def exact_derivatives(
    problem: dict[str, Any], resolution: Resolution, *, numbers: Any, own: Any, rest: dict[str, Any], weights: Any
) -> dict[str, ca.Function]:
    """Jacobian of the constraints of a program and Hessian of its Lagrangian, as options of `nlpsol`, which it is for:
    what depends on the unknowns through the instants, and the rest.

    Args:
        numbers: of tube and rig.
        own: (Y, N) own unknowns of every instant and the length of its interval, linear in the unknowns.
        rest: the objective "f" without the energy, and all constraints "g", of the instants' equations, which come
            first, only their rates.
        weights: (1, N) of power times length in the objective.
    """
    x, p, g = (problem[name] for name in "xpg")
    (jacobian, sloped), (hessian, bent) = instant_derivatives(resolution)
    count, size = own.size2(), sloped.size1()
    factor, multipliers = ca.MX.sym("factor"), ca.MX.sym("multipliers", g.numel())
    ours = ca.reshape(multipliers[: count * size], size, count)
    slopes = jacobian.map("slopes", "serial", count, [1], [])(own, numbers)
    bends = hessian.map("bends", "serial", count, [1], [])(own, numbers, ours, factor * weights)
    # Chain rule with a constant matrix, as own unknowns and interval lengths are linear in x.
    places = ca.jacobian(ca.vec(own), x)
    # Only the first constraints, the equations of instants, depend on x through them.
    below = ca.MX(g.numel() - count * size, x.numel())
    J = ca.jacobian(rest["g"], x) + ca.vertcat(ca.mtimes(_blocks(sloped, slopes), places), below)
    lagrangian = factor * rest["f"] + ca.dot(multipliers, rest["g"])
    H = ca.hessian(lagrangian, x)[0] + ca.mtimes([places.T, _blocks(bent, bends), places])
    given = {"x": x, "p": p}
    return {
        "jac_g": _named("jac_g", given, {"g": g, "jac_g_x": J}),
        "hess_lag": _named(
            "hess_lag", {**given, "lam_f": factor, "lam_g": multipliers}, {"triu_hess_gamma_x_x": ca.triu(H)}
        ),
    }


def _blocks(pattern: Any, values: Any) -> Any:
    """Blocks of a pattern on the diagonal; their nonzeros by column."""
    return ca.MX(ca.diagcat(*[pattern] * values.size2()), ca.vec(values))


def _named(name: str, inputs: dict[str, Any], outputs: dict[str, Any]) -> ca.Function:
    return ca.Function(name, list(inputs.values()), list(outputs.values()), list(inputs), list(outputs))


# --- the program ------------------------------------------------------------------------------------------------------


WISHES = (
    "hold", "low", "high", "limit", "ramp", "current", "w_time", "w_energy", "w_centre", "w_miss", "w_drive",
)  # fmt: skip
"""Numbers of the question: s, K, K, K, K/s, A, and the weights of the objective."""

REGULAR = 1e-5
"""Added to the diagonal of the Hessian, in scaled unknowns."""

LENGTHS, AREA, UNEVEN = 1e-2, 1.0, 20.0
"""Weights of clearance and lead (in units of LENGTH), of the vents, and of their changes, squared, in the objective."""

BAND, ENERGY = 25.0, 1e4
"""Sizes of a distance from the window's middle (K) and of an energy (J) in the objective."""

WINDOW = 10.0
"""Size of a constraint of the window, K."""

# The objective is in units of about 1 K and 30 s: a tolerance of 1e-4 is far below what the coarse grid and counts
# change. Tubes that are hard to heat take up to about 150 iterations.
IPOPT = Ipopt(tolerance=1e-4, constraint_tolerance=1e-7, iterations=250, barrier=1e-2)

# A correction moves the bounds by a few K, which takes 5 to 15 steps. After more a new start is faster.
AGAIN_ITERATIONS = 25
"""Iterations from an earlier solution before a new start."""

MUMPS: dict[str, Any] = {
    # With its own choice the inertia is lost to round-off, and every step is tried several times.
    "ipopt.mumps_pivtol": 1e-2,
    "ipopt.mumps_pivot_order": 5,  # METIS: the pattern is that of a grid, in place and in time.
    # Memory beyond what the analysis foresees, in percent: ten times as much would be mapped anew in every iteration.
    "ipopt.mumps_mem_percent": 20,
}

# What is nearly a linear program may leave each barrier soon.
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
    """Intervals of heating-up and of the hold, and collocation points in each; short where the phases meet."""

    heating: int = 14
    hold: int = 10
    degree: int = 2

    @property
    def fractions(self) -> tuple[Array, Array]:
        """Faces of the intervals in each phase, from 0 to 1."""
        up, on = np.linspace(0.0, 1.0, self.heating + 1), np.linspace(0.0, 1.0, self.hold + 1)
        return 1 - np.sinh(1.5 * up[::-1]) / math.sinh(1.5), np.sinh(4.0 * on) / math.sinh(4.0)

    def times(self, heating: float, hold: float) -> tuple[Array, Array]:
        """Faces of the intervals, and collocation points (N,), s, where heating and hold take so long."""
        first, second = self.fractions
        faces = np.concatenate([heating * first, heating + hold * second[1:]])
        return faces, (faces[:-1, None] + np.diff(faces)[:, None] * tableau("radau", self.degree).nodes).ravel()


@dataclass(frozen=True)
class Structure:
    """What a compiled program depends on."""

    resolution: Resolution
    mesh: TimeMesh = TimeMesh()
    clear: bool = False
    """The limit gives way by the miss as the window's ends do; otherwise it is a bound of the unknowns, and no
    constraint is spent on it."""
    chosen: tuple[str, ...] = ()
    """What of the rig may be chosen: every interval has a copy of it."""

    @property
    def copied(self) -> list[int]:
        """Rows of the design that are chosen."""
        rows = {"clearance": [0], "lead": [1], "vents": list(range(2, 2 + VENTS))}
        return [row for name, own in rows.items() if name in self.chosen for row in own]

    @property
    def copies(self) -> int:
        """Unknowns, the last ones, that are copies: of what is chosen in all intervals but the first."""
        return len(self.copied) * (self.mesh.heating + self.mesh.hold - 1)

    def copies_of(self, design: Array) -> Array:
        """The copies of a design (2 + VENTS,)."""
        return np.resize(design[self.copied], self.copies)

    @property
    def states(self) -> int:
        """Temperatures of the tube, of the shells cell by cell, of the clamp, charge used and sag."""
        return self.resolution.cells + self.resolution.covered * self.resolution.shells + 3

    @property
    def points(self) -> int:
        """Collocation points in time."""
        return (self.mesh.heating + self.mesh.hold) * self.mesh.degree

    @property
    def unknowns(self) -> dict[str, tuple[int, int]]:
        """Shapes of the unknowns by their names, in order."""
        intervals = self.mesh.heating + self.mesh.hold
        return {
            "z": (self.states, self.points),
            "circuit": (2, self.points),
            "drive": (1, intervals + 1),
            "durations": (1, self.mesh.heating),
            "misses": (1, self.points),
            "design": (2 + VENTS, 1),
            "copies": (len(self.copied), intervals - 1),
        }

    @property
    def holding_points(self) -> int:
        """Points of the hold, with the one at which it begins."""
        return self.mesh.hold * self.mesh.degree + 1


@dataclass(frozen=True, eq=False)
class Program:
    """A compiled program: a solver with the exact Hessian, and one with a convex part of it for when it fails.

    From an earlier answer `again` serves, which begins at it and takes few steps. `split` takes the unknowns apart,
    `sizes` tells how many constraints there are of each kind, in their order.
    """

    structure: Structure
    exact: Any
    again: Any
    convex: Any
    split: Any
    sizes: dict[str, int]

    def worst(self, violation: Array) -> str:
        """In words, the constraint that is violated most."""
        at = int(np.argmax(violation))
        for name, size in self.sizes.items():
            if at < size:
                return f"the worst constraint is {name}, entry {at + 1} of {size}, violated by {violation.max():.1e}"
            at -= size
        raise AssertionError


def differentiation(mesh: TimeMesh) -> Array:
    """(1+N, N): values at start and points, times this, are rates at the points times the interval's length."""
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
    """(1+K, N): values at the intervals' ends, times this, are values at the points, linear in between."""
    nodes, count = tableau("radau", mesh.degree).nodes, mesh.heating + mesh.hold
    mix = np.zeros((count + 1, count * mesh.degree))
    for i in range(count):
        columns = slice(i * mesh.degree, (i + 1) * mesh.degree)
        # The drive is continuous and linear in every interval.
        mix[i, columns], mix[i + 1, columns] = 1 - nodes, nodes
    return mix


@dataclass(frozen=True, eq=False)
class _Unknowns:
    """The symbols: states (S, N), circuit (2, N), drive (1, 1+K), duration and miss in copies, design, and copies of
    what of it is chosen.

    A copy of the duration in every interval and of the miss at every point: a single one would be a dense column, which
    fills the factors. So it is with what is chosen of the design.
    """

    z: Any
    circuit: Any
    drive: Any
    durations: Any
    misses: Any
    design: Any
    copies: Any

    @property
    def column(self) -> Any:
        """All unknowns."""
        return ca.veccat(*vars(self).values())

    def designs(self, s: Structure) -> Any:
        """(2 + VENTS, N) design at every point: that of its interval."""
        count = s.mesh.heating + s.mesh.hold
        rows = [ca.repmat(row, 1, count) for row in ca.vertsplit(self.design)]
        for place, row in enumerate(s.copied):
            rows[row] = ca.horzcat(self.design[row], self.copies[place, :])
        return ca.kron(ca.vertcat(*rows), ca.DM.ones(1, s.mesh.degree))


def _widths(mesh: TimeMesh, durations: Any, hold: Any) -> Any:
    """(1, N) length of the interval of every point, s."""
    first, second = (np.diff(faces) for faces in mesh.fractions)
    heating = DURATION * ca.repmat(durations * ca.DM(first).T, mesh.degree, 1)
    return ca.horzcat(ca.vec(heating).T, hold * ca.DM(np.repeat(second, mesh.degree)).T)


def _held(s: Structure, x: _Unknowns, numbers: Numbers, designs: Any) -> Any:
    """(1+c, H) temperatures (K) where the curved part begins, and at its cells, at the points of the hold."""
    first = s.resolution.cells - s.resolution.curved
    rows = x.z[first - 1 : s.resolution.cells, s.points - s.holding_points :] * RISE
    # The joint of lead and curve lies between two cells whose widths the design may change.
    columns = ca.horzsplit(designs[:, s.points - s.holding_points :])
    widths = [numbers.widths(s.resolution, design)[first - 1 : first + 1] for design in columns]
    before, after = ca.vertsplit(ca.horzcat(*widths))
    joint = (after * rows[0, :] + before * rows[1, :]) / (before + after)
    return ca.vertcat(joint, rows[1:, :]) + numbers.scalar["ambient"]


@lru_cache(maxsize=8)
def program(s: Structure) -> Program:
    """The compiled program of a structure."""
    x, mesh = _Unknowns(**{name: ca.MX.sym(name, *shape) for name, shape in s.unknowns.items()}), s.mesh
    p, wishes = ca.MX.sym("p", number_count(s.resolution)), ca.MX.sym("wishes", len(WISHES))
    w = dict(zip(WISHES, ca.vertsplit(wishes), strict=True))
    numbers = Numbers.of(p, s.resolution)
    width = _widths(mesh, x.durations, w["hold"])
    values = ca.horzcat(ca.DM.zeros(s.states, 1), x.z)
    rate = ca.mtimes(values, ca.sparsify(ca.DM(differentiation(mesh)))) / ca.repmat(width, s.states, 1)
    drive = ca.mtimes(x.drive, ca.sparsify(ca.DM(interpolation(mesh))))
    designs = x.designs(s)
    everywhere = instant(s.resolution).map("instants", "serial", s.points, [5], [])
    equations, power = everywhere(x.z, rate, x.circuit, drive, designs, p)
    held = _held(s, x, numbers, designs)
    misses = ca.repmat(x.misses[s.points - s.holding_points :], held.size1(), 1)
    limit = (w["limit"] - numbers.scalar["ambient"] + x.misses) / RISE
    blocks = {
        "equations": equations,
        # Copies are equal by constraints of two entries each, which keep the factors sparse.
        "same": ca.horzcat(ca.diff(x.durations, 1, 1), ca.diff(x.misses, 1, 1)),
        "low": (held + misses - w["low"]) / WINDOW,
        "high": (held - misses - w["high"]) / WINDOW,
        "limit": (x.z[: s.resolution.cells, :] - ca.repmat(limit, s.resolution.cells, 1))[:, : s.clear * s.points],
        "ramp": rate[s.resolution.grip : s.resolution.cells, :] * RISE / w["ramp"],
        "current": drive * DRIVE / (x.circuit[0, :] * AMPERE) / w["current"],
        # duty = drive / I^2 at most 1, times I^2: polynomial, and finite where the current is small.
        "duty": drive * DRIVE / AMPERE**2 - x.circuit[0, :] ** 2,
        # Copies of the design are equal from interval to interval, as those of the duration.
        "chosen": ca.diff(ca.horzcat(x.design[s.copied], x.copies), 1, 1) if s.copied else ca.MX(0, 1),
    }
    # Energy is the quadrature of power, with the weights of the collocation.
    weights = np.tile(tableau("radau", mesh.degree).weights, mesh.heating + mesh.hold)
    energy = w["w_energy"] / ENERGY * ca.DM(weights).T
    smooth = _squares(x, mesh, w, held)
    linear = w["w_time"] * x.durations[0] + w["w_miss"] * x.misses[0]
    problem = {
        "x": x.column,
        "p": ca.veccat(p, wishes),
        "f": smooth + linear + ca.sum2(power * energy * width),
        "g": ca.veccat(*blocks.values()),
    }
    blocks["equations"] = ca.vertcat(rate, ca.MX(equations.size1() - s.states, s.points))
    by_instants = exact_derivatives(
        problem,
        s.resolution,
        numbers=p,
        own=ca.vertcat(x.z, x.circuit, drive, designs, width),
        rest={"f": smooth + linear, "g": ca.veccat(*blocks.values())},
        weights=energy,
    )
    exact = {**IPOPT.options(warm=False), **MUMPS, **by_instants}
    convex = {**exact, "hess_lag": _curvature(problem, smooth)}
    return Program(
        structure=s,
        convex=ca.nlpsol("heating", "ipopt", problem, {**convex, **COLD}),
        again=ca.nlpsol("heating_again", "ipopt", problem, {**exact, **WARM, "ipopt.max_iter": AGAIN_ITERATIONS}),
        exact=ca.nlpsol("heating_exact", "ipopt", problem, {**exact, **COLD}),
        split=ca.Function("split", [x.column], [x.z, x.circuit, x.drive, x.durations[0], x.misses[0], x.design]),
        sizes={name: int(block.numel()) for name, block in blocks.items()},
    )


def _squares(x: _Unknowns, mesh: TimeMesh, w: dict[str, Any], held: Any) -> Any:
    """The squares of the objective: of the distance from the middle of the window, of changes of the drive, of the
    design."""
    steps = ca.diff(x.drive, 1, 1)
    # From the last interval of heating to the first of the hold the drive may change as it must.
    steps[mesh.heating] = 0
    middle = 0.5 * (w["low"] + w["high"])
    smooth = w["w_centre"] * ca.sumsqr((held - middle) / BAND) / held.numel() + w["w_drive"] * ca.sumsqr(steps)
    # Of clearances, leads and vents that do as well, the least; squares, which damp the steps of what is bilinear.
    # Vents that change fast from place to place would even out the coarse grid's own errors.
    smooth += LENGTHS * ca.sumsqr(x.design[:2]) + AREA * ca.sumsqr(x.design[2:])
    smooth += UNEVEN * ca.sumsqr(ca.diff(x.design[2:]))
    return smooth


def _curvature(problem: dict[str, Any], smooth: Any) -> ca.Function:
    """Hessian of the objective's squares alone, a little regularised: the equations are nearly linear.

    With it every step is that of a convex quadratic program, but where the equations bend the steps only creep.
    """
    x = problem["x"]
    weight, multipliers = ca.MX.sym("weight"), ca.MX.sym("multipliers", problem["g"].numel())
    H = ca.hessian(smooth, x)[0] * weight + REGULAR * ca.DM.eye(x.numel())
    return ca.Function("curvature", [x, problem["p"], weight, multipliers], [ca.triu(H)])
