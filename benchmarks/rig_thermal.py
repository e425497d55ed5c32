"""A rig and its tube once more, written apart from the package: what its plans and laws are judged by.

Nothing here is taken from `tubeopt.physics` or `tubeopt.shaping` but the numbers of a rig's file: other grids, a
balance of its own, the air's properties from a table (Incropera et al., Table A.4) in place of Sutherland's laws, the
air of the groove by finite volumes in polar coordinates in place of finite elements, the battery by its table in place
of a slope, and steps in time by extrapolation.

Along half the tube, per metre, with d the part of time in which the current I flows,

    rho c(T) A T_t = (k(T) A T_x)_x + d I_tube^2 rho_e(T) / A - q

and around it a cylinder of mold with the plates' cross-section, in r and x. Clamps are lumps of metal. A thermocouple
on the middle draws heat by its wires, by the closed form of a fin in every part of a wire. The mold conducts by its
temperature: between two nodes as the table of its material says at their mean. A `Bench` is one rig; a `Fleet` many on
one grid.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy

from tubeopt import Rig, Tube
from tubeopt.robots.materials import NITINOL
from tubeopt.typing import Array

KELVIN, SIGMA, GRAVITY = 273.15, 5.670374419e-8, 9.80665
HOT, OUTSIDE = 500.0, 10.0
"""What a rig's file leaves open (docs/heating.md): the tube's rise at which air is looked up, K; transfer of the outer
faces of clamps and mold, W/(m^2 K)."""

ROUGHNESS = 10e-6
"""Air between the tube and what it lies on, m."""

AIR = np.array(
    [
        [300, 15.89e-6, 26.3e-3, 0.707],
        [350, 20.92e-6, 30.0e-3, 0.700],
        [400, 26.41e-6, 33.8e-3, 0.690],
        [450, 32.39e-6, 37.3e-3, 0.686],
        [500, 38.79e-6, 40.7e-3, 0.684],
        [550, 45.57e-6, 43.9e-3, 0.683],
        [600, 52.69e-6, 46.9e-3, 0.685],
    ]
)
"""K, kinematic viscosity, conductivity, Prandtl number; 1 atm."""


def air(temperature: float) -> tuple[float, float, float]:
    """Kinematic viscosity (m^2/s), conductivity (W/(m K)) and Prandtl number."""
    viscosity, conductivity, prandtl = (float(np.interp(temperature, AIR[:, 0], column)) for column in AIR[:, 1:].T)
    return viscosity, conductivity, prandtl


def convection(diameter: float, ambient: float) -> float:
    """W/(m^2 K) of a horizontal cylinder that is HOT above still air (Churchill and Chu 1975)."""
    viscosity, conductivity, prandtl = air(ambient + HOT / 2)
    rayleigh = GRAVITY * HOT / (ambient + HOT / 2) * diameter**3 * prandtl / viscosity**2
    nusselt = (0.6 + 0.387 * rayleigh ** (1 / 6) / (1 + (0.559 / prandtl) ** (9 / 16)) ** (8 / 27)) ** 2
    return nusselt * conductivity / diameter


@functools.lru_cache(maxsize=256)
def groove_resistance(diameter: float, side: float, ratio: float) -> float:
    """Resistance of the air of a square groove with its tube on floor and wall, m K/W times the air's conductivity.

    Finite volumes on circles around the tube; between two nodes of a ray the way is air up to the wall, then mold.

    Args:
        side: air on either side if the tube lay in the middle, m. ratio: of the mold's conductivity to that of air.
    """
    near, away = 0.5 + ROUGHNESS / diameter, 0.5 + (2 * side - ROUGHNESS) / diameter
    angle = (np.arange(600) + 0.5) * 2 * math.pi / 600
    across, along = np.cos(angle), np.sin(angle)
    wall = np.minimum(
        np.where(across < 0, near, away) / np.abs(across), np.where(along < 0, near, away) / np.abs(along)
    )
    first, far = 0.1 * ROUGHNESS / diameter, 8.0
    face = 0.5 + first * np.append(
        0.0, np.cumsum(1.1 ** np.arange(math.log(1 + 0.1 * far / first) / math.log(1.1) + 1))
    )
    node = np.concatenate([[0.5], np.sqrt(face[1:] * face[:-1]), [face[-1]]])

    def way(a: Array, b: Array) -> Array:
        edge = np.clip(wall, a[:, None], b[:, None])
        return np.asarray(np.log(edge / a[:, None]) + np.log(b[:, None] / edge) / ratio)

    turn = angle[1] - angle[0]
    radial = turn / way(node[:-1], node[1:])
    # Around: what of a cell is air conducts beside what is mold.
    edge = np.clip(wall, face[:-1, None], face[1:, None])
    beside = (np.log(edge / face[:-1, None]) + ratio * np.log(face[1:, None] / edge)) / turn
    sideways = 2 / (1 / beside + 1 / np.roll(beside, -1, 1))
    rings, rays = beside.shape
    number = np.arange(rings * rays).reshape(rings, rays)
    pairs = [(number[:-1], number[1:], radial[1:-1]), (number, np.roll(number, -1, 1), sideways)]
    one, other, g = (np.concatenate([pair[k].ravel() for pair in pairs]) for k in range(3))
    ends = np.zeros((rings, rays))
    ends[0] += radial[0]
    ends[-1] += radial[-1]
    source = np.zeros((rings, rays))
    source[0] = radial[0]
    matrix = laplacian(one, other, g, rings * rays) + scipy.sparse.diags_array(ends.ravel())
    warm = scipy.sparse.linalg.spsolve(matrix.tocsc(), source.ravel()).reshape(rings, rays)
    return float(1 / (radial[0] * (1 - warm[0])).sum() - math.log(node[-1] / 0.5) / (2 * math.pi * ratio))


@functools.lru_cache(maxsize=512)
def wire_loss(wire: float, anchor: float, cement: float = 1.0) -> tuple[float, float]:
    """Part of the tube's rise that a thermocouple misses, and heat that both wires take away per rise, W/K.

    A wire is a fin in four parts: cemented to the tube, beside it in the slot, through the lid, in the air. In each its
    rise is that of what surrounds it, linear in x, plus exponentials; rise and flow are continuous between them.

    Args:
        wire: diameter, m. anchor: length of a wire in the slot, m. cement: its conductivity, W/(m K).
    """
    air_hot, wall, foil, lid, hole, bonded, end = 0.056, 0.85, 50e-6, 6.35e-3, 1.2e-3, 3e-3, 30e-3
    flow = 25.0 * math.pi / 4 * wire**2
    shape = 2 * math.pi / math.acosh(1 + 2 * foil / wire)
    beside = 2 * math.pi * air_hot / math.log(1.8)
    through = 2 * math.pi * air_hot / math.log(hole / wire)
    # Length of every part, conductances to tube and surroundings, and the rise of these at its ends.
    parts = [
        (bonded, shape * (cement + air_hot), beside, wall, wall),
        (anchor - bonded, shape * air_hot, beside, wall, wall),
        (lid, 0.0, through, wall, 0.0),
        (end, 0.0, 15.0 * math.pi * wire, 0.0, 0.0),
    ]
    size = len(parts)
    matrix, right = np.zeros((2 * size, 2 * size)), np.zeros(2 * size)
    ends = []
    for length, to_tube, to_wall, first, last in parts:
        m = math.sqrt((to_tube + to_wall) / flow)
        rest = [(to_tube + to_wall * rise) / (to_tube + to_wall) for rise in (first, last)]
        # Rise a e^(-m x) + b e^(m (x - length)) + rest, and its slope, at both ends.
        decay, slope = math.exp(-m * length), (rest[1] - rest[0]) / length
        ends.append((np.array([[1, decay], [-m, m * decay]]), np.array([[decay, 1], [-m * decay, m]]), rest, slope))
    matrix[0, :2], right[0] = ends[0][0][1], -ends[0][3]
    for k in range(size - 1):
        here, there = ends[k], ends[k + 1]
        matrix[1 + 2 * k : 3 + 2 * k, 2 * k : 2 * k + 2] = here[1]
        matrix[1 + 2 * k : 3 + 2 * k, 2 * k + 2 : 2 * k + 4] = -there[0]
        right[1 + 2 * k : 3 + 2 * k] = [there[2][0] - here[2][1], there[3] - here[3]]
    matrix[-1, -2:], right[-1] = ends[-1][1][1], -ends[-1][3]
    found = np.linalg.solve(matrix, right)
    bead = float(ends[0][0][0] @ found[:2] + ends[0][2][0])
    leaving = float(ends[2][0][1] @ found[4:6] + ends[2][3])
    return 1 - bead, -2 * flow * leaving


REFERENCE = 200.0
"""Temperature at which a mold conducts as its material says, degC."""


def mold_factor(table: Sequence[tuple[float, float]], slope: Array | float, temperature: Array) -> Array:
    """Conductivity of a mold at temperatures in K, as a part of that at `REFERENCE`.

    Args:
        table: degC and W/(m K), none for a constant. slope: change of this part per K, beside the table.
    """
    degrees = temperature - KELVIN
    part = np.maximum(1 + slope * (degrees - REFERENCE), 0.2)
    if len(table):
        at, value = zip(*table, strict=True)
        part = part * np.interp(degrees, at, value) / np.interp(REFERENCE, at, value)
    return np.asarray(part)


def laplacian(one: Array, other: Array, g: Array, size: int) -> scipy.sparse.csr_array:
    """Matrix of the heat that leaves nodes by conductances g between pairs of them."""
    rows, columns = np.concatenate([one, other, one, other]), np.concatenate([other, one, one, other])
    return scipy.sparse.csr_array((np.concatenate([-g, -g, g, g]), (rows, columns)), shape=(size, size))


def widths(length: float, first: float, growth: float) -> Array:
    """Of cells from `first` on, each `growth` times the last, that fill a length."""
    count = max(math.ceil(math.log(1 + length * (growth - 1) / first) / math.log(growth)), 2)
    plain = growth ** np.arange(count)
    return np.asarray(length * plain / plain.sum())


@dataclass
class Bench:
    """A tube on a rig, cold at first.

    fineness: how many times finer than usual in space and time.
    """

    tube: Tube
    rig: Rig
    fineness: int = 1
    used: float = field(default=0.0, init=False)
    sag: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        rig, tube, fine = self.rig, self.tube, self.fineness
        grip = widths(rig.clamps.grip, 0.25e-3 / fine, 1.35 ** (1 / fine))[::-1]
        bare = np.full(8 * fine, rig.clamps.clearance / (8 * fine))
        lead = widths(rig.mold.lead, 0.5e-3 / fine, 1.05 ** (1 / fine))
        bend = widths(0.5 * tube.curved_length, 1e-3 / fine, 1.08 ** (1 / fine))
        self.width = np.concatenate([grip, bare, lead, bend])
        self.edge, self.mold_from = len(grip), len(grip) + len(bare)
        self.bend_from = self.mold_from + len(lead)
        self.place = np.cumsum(self.width) - 0.5 * self.width
        self.half = float(self.width.sum())
        self._tube_numbers()
        self._mold_numbers(14 * fine)
        self.state = np.full(len(self.heat), rig.ambient)
        self.cold = self.half_resistance()

    def _tube_numbers(self) -> None:
        tube, rig, w = self.tube, self.rig, self.width
        self.metal = tube.material.thermal or NITINOL.thermal
        assert self.metal is not None
        girth = math.pi * tube.outer_diameter
        self.section = math.pi / 4 * (tube.outer_diameter**2 - tube.inner_diameter**2)
        n, k = len(w), np.arange(len(w))
        clamped, bare = k < self.edge, (k >= self.edge) & (k < self.mold_from)
        self.vent = np.where(k >= self.mold_from, self._vents(), 0.0)
        open_part = rig.loss_factor * girth * w * (bare + self.vent)
        given = rig.convection
        self.to_air = open_part * (convection(tube.outer_diameter, rig.ambient) if given is None else given)
        self.radiating = open_part * self.metal.emissivity * SIGMA
        self.to_clamp = np.where(clamped, rig.clamps.contact_conductance * girth * w, 0.0)
        if rig.mold.wire:
            # Both wires, half of them on this half of the tube.
            inner = self.half - np.cumsum(w)
            under = np.clip(rig.mold.anchor - inner, 0.0, w) / rig.mold.anchor
            self.to_air = self.to_air + 0.5 * wire_loss(rig.mold.wire, rig.mold.anchor)[1] * under
        self.ohms = np.where(clamped, 0.0, rig.resistivity_factor * self.metal.resistivity * w / self.section)
        self.apart = self.place[1:] - self.place[:-1]
        self.n = n

    def _vents(self) -> Array:
        vents = self.rig.mold.vents
        start = self.half - float(self.width[self.mold_from :].sum())
        part = (self.place - start) / (self.half - start)
        return np.asarray(np.interp(part, np.linspace(0, 1, max(len(vents), 2)), np.resize(vents, max(len(vents), 2))))

    def _mold_numbers(self, rings: int) -> None:
        """Conductances of all that is linear, heat capacities; unknowns are tube, mold ring by ring, clamp."""
        rig, tube, w = self.rig, self.tube, self.width[self.mold_from :]
        mold, n, c = rig.mold.material, self.n, len(self.width) - self.mold_from
        scale = rig.loss_factor
        face = np.geomspace(
            0.5 * tube.outer_diameter, math.sqrt(rig.mold.width * rig.mold.thickness / math.pi), rings + 1
        )
        node = np.sqrt(face[1:] * face[:-1])
        k = 2 * math.pi * mold.conductivity * scale
        tubes, ring = np.arange(self.mold_from, n), n + np.arange(rings * c).reshape(rings, c)
        clamp = n + rings * c
        self.gap_air = self._gap_resistance() / scale / (1 - self.vent[self.mold_from :]) / w
        self.wall = math.log(node[0] / face[0]) / k / w
        gap = 1 / (self.gap_air + self.wall)
        outward = np.outer(k / np.log(node[1:] / node[:-1]), w)
        area = math.pi * np.diff(face**2)
        along = np.outer(mold.conductivity * scale * area, 1 / self.apart[self.mold_from :])
        self.outward, self.sideways = outward, along
        links = [
            (tubes, ring[0], gap),
            (ring[:-1], ring[1:], outward),
            (ring[:, :-1], ring[:, 1:], along),
            (np.arange(n), np.full(n, clamp), self.to_clamp),
        ]
        one, other, g = (np.concatenate([np.ravel(link[j]) for link in links]) for j in range(3))
        # Gap with its wall, rings, and into the clamp.
        self.one, self.other, self.straight = one, other, g
        self.gaps, self.in_mold = slice(0, c), slice(c, len(g) - n)
        self.curve, self.slope = mold.conductivity_curve, mold.conductivity_slope
        self.loss = np.zeros(clamp + 1)
        self.loss[:n] = self.to_air
        self.last_wall = math.log(face[-1] / node[-1]) / k / w
        self.last_air = 1 / (OUTSIDE * 2 * math.pi * face[-1]) / w
        self.loss[ring[-1]] = 1 / (self.last_wall + self.last_air)
        self.loss[clamp] = OUTSIDE * rig.clamps.area
        self.heat = np.empty(clamp + 1)
        self.heat[:n] = self.metal.density * self.metal.heat_capacity * self.section * self.width
        self.heat[n:clamp] = scale * mold.density * mold.heat_capacity * np.outer(area, w).ravel()
        self.heat[clamp] = rig.clamps.mass * rig.clamps.heat_capacity
        self.first_ring, self.clamp = ring[0], clamp
        covered = 2 * float(w.sum())
        touching = rig.mold.leak_resistance / (0.25 * math.pi * tube.outer_diameter * covered)
        plates = mold.resistivity * covered / (rig.mold.width * rig.mold.thickness)
        self.leak = math.inf if mold.resistivity > 1e3 else touching + plates

    def _gap_resistance(self) -> float:
        """Of the groove's air, m K/W."""
        rig, diameter = self.rig, self.tube.outer_diameter
        conductivity = air(rig.ambient + HOT / 2)[1]
        if rig.mold.gap is not None:
            return rig.mold.gap / (conductivity * math.pi * diameter)
        side = 50e-6 if rig.mold.side_clearance is None else rig.mold.side_clearance
        return groove_resistance(diameter, side, rig.mold.material.conductivity / conductivity) / conductivity

    def bend_begins(self, tube: Array) -> Array:
        """(S,) temperature of the face at which the curved part begins, from those of the cells (S, n)."""
        k = self.bend_from
        before, after = self.width[k - 1], self.width[k]
        return np.asarray((after * tube[:, k - 1] + before * tube[:, k]) / (before + after))

    # --- what happens ---

    def resistances(self) -> Array:
        """(n,) ohm."""
        warm = self.state[: self.n] - self.metal.reference_temperature
        return np.asarray(self.ohms * (1 + self.metal.resistivity_slope * warm))

    def half_resistance(self) -> float:
        """Of half the tube, ohm."""
        return float(self.resistances().sum())

    def current(self) -> tuple[float, float]:
        """While the switch conducts, A; and the part of it that flows through the tube."""
        battery, whole = self.rig.battery, 2 * self.half_resistance()
        charge, volt = np.array(battery.open_circuit).T
        rest = float(np.interp(battery.state_of_charge - self.used, charge, volt))
        share = 1.0 if math.isinf(self.leak) else self.leak / (self.leak + whole)
        return (rest - self.sag) / (battery.internal_resistance + self.rig.circuit.resistance + whole * share), share

    def conductances(self) -> Array:
        """Of all links, by the temperatures, W/K."""
        g, T = self.straight.copy(), self.state
        mean = 0.5 * (T[self.one] + T[self.other])
        g[self.in_mold] *= mold_factor(self.curve, self.slope, mean[self.in_mold])
        g[self.gaps] = 1 / (self.gap_air + self.wall / mold_factor(self.curve, self.slope, T[self.first_ring]))
        return np.asarray(g)

    def gains(self, on: float) -> Array:
        """Heat that every unknown gains, W, with the switch conducting a part `on` of the time."""
        rig, T, n = self.rig, self.state, self.n
        crossing = self.conductances() * (T[self.one] - T[self.other])
        flow = np.bincount(self.other, crossing, len(T)) - np.bincount(self.one, crossing, len(T))
        flow -= self.loss * (T - rig.ambient)
        tube = T[:n]
        flow[:n] -= self.radiating * (tube**4 - rig.ambient**4)
        slope = 1 + self.metal.conductivity_slope * (0.5 * (tube[1:] + tube[:-1]) - self.metal.reference_temperature)
        along = self.metal.conductivity * self.section / self.apart * slope * np.diff(tube)
        flow[: n - 1] += along
        flow[1:n] -= along
        total, share = self.current()
        power = on * total**2
        ohms = self.resistances()
        flow[:n] += power * share**2 * ohms
        contact = 0.25 * power * rig.circuit.contact_resistance
        flow[: self.edge] += contact * self.width[: self.edge] / rig.clamps.grip
        flow[self.clamp] += contact
        cover = self.width[self.mold_from :]
        flow[self.first_ring] += power * share * (1 - share) * ohms.sum() * cover / cover.sum()
        return flow

    def capacity(self) -> Array:
        """Of every unknown, J/K."""
        found = self.heat.copy()
        found[: self.n] *= 1 + self.metal.heat_capacity_slope * (
            self.state[: self.n] - self.metal.reference_temperature
        )
        return found

    def pass_time(self, count: float, span: float) -> Array:
        """Let a span go by at a count of 255; return what the tube was at every step, (S, n) degC.

        Implicit Euler steps with the matrix of the span's beginning, once whole and once in halves, extrapolated: the
        expansion of their error in powers of the step holds for any matrix, so that order two is left.
        """
        duty, lost = count / 255, self.rig.circuit.lost_on_time * self.rig.circuit.pwm_frequency
        on = duty if duty == 1 else max(duty - lost, 0.0)
        steps = max(round(span / 0.125), 1) * self.fineness
        h, heat, n = span / steps, self.capacity(), self.n
        tube = self.state[:n]
        g = self.metal.conductivity * self.section / self.apart
        links = laplacian(np.arange(n - 1), np.arange(1, n), g, len(heat))
        bend = self.loss.copy()
        bend[:n] += 4 * self.radiating * tube**3
        linear = laplacian(self.one, self.other, self.conductances(), len(heat))
        matrix = linear + links + scipy.sparse.diags_array(bend)
        solve = [
            scipy.sparse.linalg.splu((scipy.sparse.diags_array(heat / part) + matrix).tocsc()).solve
            for part in (h, h / 2)
        ]
        seen = []
        for _ in range(steps):
            start = self.state
            before = heat * self.gains(on) / self.capacity()
            whole = start + solve[0](before)
            self.state = start + solve[1](before)
            self.state = self.state + solve[1](heat * self.gains(on) / self.capacity())
            self.state = 2 * self.state - whole
            self._discharge(on, h)
            seen.append(self.state[:n] - KELVIN)
        return np.array(seen)

    def _discharge(self, on: float, span: float) -> None:
        battery, mean = self.rig.battery, on * self.current()[0]
        self.used += mean * span / battery.capacity
        self.sag += (mean * battery.sag_resistance - self.sag) * (1 - math.exp(-span / battery.sag_time))


FORWARD = 0.6
"""Weight of the new temperatures in a step of a fleet; one half would leave the fastest modes undamped."""


class Fleet:
    """Many benches with one grid, stepped at once: alternating directions, radius first (Douglas and Gunn 1964).

    Arrays are (n, 1 + M, B): cells along the tube, the tube and M rings, benches, whose molds have one table of the
    conductivity.
    """

    def __init__(self, benches: Sequence[Bench]) -> None:
        first = self.first = benches[0]
        n, covered = first.n, first.n - first.mold_from
        rings = (first.clamp - n) // covered

        def of_all(name: str) -> Array:
            """Of every bench, these last."""
            return np.moveaxis(np.array([getattr(bench, name) for bench in benches]), 0, -1)

        def along(name: str) -> Array:
            """(n, rings, B) of what a bench has (rings, covered), 0 where there is no mold."""
            values = np.moveaxis(of_all(name), 0, 1)
            return np.concatenate([np.zeros((first.mold_from, *values.shape[1:])), values])

        heat = of_all("heat")
        self.heat = np.ones((n, 1 + rings, len(benches)))
        self.heat[:, 0] = heat[:n]
        self.heat[first.mold_from :, 1:] = np.moveaxis(heat[n:-1].reshape(rings, covered, -1), 0, 1)
        self.clamp_heat, self.clamp_loss = heat[-1], of_all("loss")[-1]
        self.gap_air, self.wall = of_all("gap_air"), of_all("wall")
        self.last_wall, self.last_air = of_all("last_wall"), of_all("last_air")
        self.outward, self.sideways = along("outward"), along("sideways")
        self.to_air, self.radiating = of_all("to_air"), of_all("radiating")
        self.to_clamp, self.ohms = of_all("to_clamp"), of_all("ohms")
        self.leak = of_all("leak")
        assert all(bench.curve == first.curve for bench in benches)
        self.slopes = np.array([bench.slope for bench in benches])
        of_metals = [vars(bench.metal) for bench in benches]
        self.metal = {key: np.array([data[key] for data in of_metals]) for key in of_metals[0]}
        conducting = self.metal["conductivity"] * of_all("section")
        self.along_tube = conducting / first.apart[:, None]
        self.ambient = np.array([bench.rig.ambient for bench in benches])
        circuits, batteries = [bench.rig.circuit for bench in benches], [bench.rig.battery for bench in benches]
        self.series = np.array([c.resistance for c in circuits])
        self.contact = np.array([c.contact_resistance for c in circuits])
        self.lost = np.array([c.lost_on_time * c.pwm_frequency for c in circuits])
        self.inner = np.array([b.internal_resistance for b in batteries])
        self.sagging = np.array([b.sag_resistance for b in batteries])
        self.sag_time = np.array([b.sag_time for b in batteries])
        self.left = np.array([b.state_of_charge for b in batteries])
        self.capacity = np.array([b.capacity for b in batteries])
        self.charges, self.volts = np.array(batteries[0].open_circuit).T
        self.sag = np.zeros(len(benches))
        self.T = np.broadcast_to(self.ambient, self.heat.shape).copy()
        self.clamp = self.ambient.copy()
        self.cold = self.half_resistance()

    @property
    def tube(self) -> Array:
        """(B, n) degC."""
        return self.T[:, 0].T - KELVIN

    def bend(self) -> tuple[Array, Array]:
        """Coldest and hottest of every curved part, degC."""
        tube, k = self.tube, self.first.bend_from
        whole = np.column_stack([self.first.bend_begins(tube), tube[:, k:]])
        return whole.min(1), whole.max(1)

    def half_resistance(self) -> Array:
        """(B,) ohm."""
        warm = self.T[:, 0] - self.metal["reference_temperature"]
        return np.asarray((self.ohms * (1 + self.metal["resistivity_slope"] * warm)).sum(0))

    def rest(self) -> Array:
        """(B,) voltage of the batteries at rest, V."""
        return np.interp(self.left, self.charges, self.volts)

    def currents(self) -> tuple[Array, Array]:
        """(B,) while the switch conducts, A, and the part of it that flows through the tube."""
        whole = 2 * self.half_resistance()
        share = np.where(np.isinf(self.leak), 1.0, 1 / (1 + whole / self.leak))
        return (self.rest() - self.sag) / (self.inner + self.series + whole * share), share

    def conductances(self) -> tuple[Array, Array, Array]:
        """Outwards (n, M, B) and along (n - 1, 1 + M, B) by the temperatures, and losses to the air (n, 1 + M, B)."""
        first, T, metal = self.first, self.T, self.metal
        k, mold = first.mold_from, T[:, 1:]

        def factor(temperature: Array) -> Array:
            return mold_factor(first.curve, self.slopes, temperature)

        outwards = np.zeros((first.n, mold.shape[1], T.shape[2]))
        outwards[k:, 0] = 1 / (self.gap_air + self.wall / factor(T[k:, 1]))
        outwards[k:, 1:] = self.outward[k:] * factor(0.5 * (mold[k:, 1:] + mold[k:, :-1]))
        along = np.zeros((first.n - 1, *T.shape[1:]))
        middle = 0.5 * (T[1:, 0] + T[:-1, 0]) - metal["reference_temperature"]
        along[:, 0] = self.along_tube * (1 + metal["conductivity_slope"] * middle)
        along[k:, 1:] = self.sideways[k:] * factor(0.5 * (mold[k + 1 :] + mold[k:-1]))
        losses = np.zeros_like(T)
        losses[:, 0] = self.to_air
        losses[k:, -1] = 1 / (self.last_air + self.last_wall / factor(T[k:, -1]))
        return outwards, along, losses

    def pass_time(self, counts: Array, span: float) -> None:
        """One step of every bench at its count of 255."""
        duty = counts / 255
        on = np.where(duty == 1, 1.0, np.maximum(duty - self.lost, 0.0))
        first, T, metal, ambient = self.first, self.T, self.metal, self.ambient
        outwards, along, losses = self.conductances()
        total, share = self.currents()
        power, tube = on * total**2, T[:, 0].copy()
        flow = -losses * (T - ambient)
        q = outwards * (T[:, :-1] - T[:, 1:])
        flow[:, :-1] -= q
        flow[:, 1:] += q
        q = along * (T[:-1] - T[1:])
        flow[:-1] -= q
        flow[1:] += q
        warm = tube - metal["reference_temperature"]
        ohms = self.ohms * (1 + metal["resistivity_slope"] * warm)
        contact = 0.25 * power * self.contact
        into_clamp = self.to_clamp * (tube - self.clamp)
        flow[:, 0] += power * share**2 * ohms - self.radiating * (tube**4 - ambient**4) - into_clamp
        flow[: first.edge, 0] += contact * (first.width[: first.edge] / first.rig.clamps.grip)[:, None]
        cover = first.width[first.mold_from :] / first.width[first.mold_from :].sum()
        flow[first.mold_from :, 1] += power * share * (1 - share) * ohms.sum(0) * cover[:, None]
        held = self.heat / span
        held[:, 0] *= 1 + metal["heat_capacity_slope"] * warm
        bare = losses.copy()
        bare[:, 0] += 4 * self.radiating * tube**3 + self.to_clamp
        change = tridiagonal(held + FORWARD * bare, FORWARD * outwards, flow, axis=1)
        self.T = T + tridiagonal(held, FORWARD * along, held * change, axis=0)
        self.clamp += span / self.clamp_heat * (
            into_clamp.sum(0) + contact - self.clamp_loss * (self.clamp - ambient)
        )  # fmt: skip
        self.left = self.left - on * total * span / self.capacity
        self.sag += (on * total * self.sagging - self.sag) * (1 - np.exp(-span / self.sag_time))


def tridiagonal(own: Array, links: Array, right: Array, axis: int) -> Array:
    """Solve own x + sum of links (x - neighbour) = right along an axis, for all others at once (Thomas 1949)."""
    own, links, right = (np.moveaxis(values, axis, 0) for values in (own, links, right))
    pivot, x = own.copy(), right.copy()
    pivot[:-1] += links
    pivot[1:] += links
    for k in range(1, len(x)):
        part = links[k - 1] / pivot[k - 1]
        pivot[k] -= part * links[k - 1]
        x[k] += part * x[k - 1]
    x[-1] /= pivot[-1]
    for k in range(len(x) - 2, -1, -1):
        x[k] = (x[k] + links[k] * x[k + 1]) / pivot[k]
    return np.moveaxis(x, 0, axis)
