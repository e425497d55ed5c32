"""The balance of heat and current at one instant as equations of the optimal control problem, and their derivatives.

The control is the drive, duty times current squared. The current and the tube's resistance are unknowns of their own:
eliminated, they would couple every temperature with every other.

An instant depends on few unknowns, and linearly on the rates of its temperatures. Differentiated as symbols once, it is
evaluated at all points; with all unknowns at once it would be differentiated in one direction after the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from ...physics import heat
from ...physics.heat import CLEARANCE, CURVED, GRIP, LEAD, PROPERTIES, Properties, Resolution, named, zones
from ...robots.tubes import Tube
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
    places = ca.jacobian(ca.vec(own), x)
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
