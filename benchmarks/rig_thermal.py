"""A rig and its tube once more, written apart from the package: what its plans and laws are judged by.

Nothing here is taken from `tubeopt.physics` or `tubeopt.shaping` but the numbers of a rig's file: other grids, a
balance of its own, the air's properties from a table (Incropera et al., Table A.4) in place of Sutherland's laws, the
air of the groove by finite volumes in polar coordinates in place of finite elements, the battery by its table in place
of a slope, and steps in time by extrapolation.

Along half the tube, per metre, with d the part of time in which the current I flows,

    rho c(T) A T_t = (k(T) A T_x)_x + d I_tube^2 rho_e(T) / A - q

and around it a cylinder of mold with the plates' cross-section, in r and x. Clamps are lumps of metal.
"""

from __future__ import annotations

import functools
import math
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
        gap = w / (self._gap_resistance() / scale / (1 - self.vent[self.mold_from :]) + math.log(node[0] / face[0]) / k)
        outward = np.outer(k / np.log(node[1:] / node[:-1]), w)
        area = math.pi * np.diff(face**2)
        along = np.outer(mold.conductivity * scale * area, 1 / self.apart[self.mold_from :])
        links = [
            (tubes, ring[0], gap),
            (ring[:-1], ring[1:], outward),
            (ring[:, :-1], ring[:, 1:], along),
            (np.arange(n), np.full(n, clamp), self.to_clamp),
        ]
        one, other, g = (np.concatenate([np.ravel(link[j]) for link in links]) for j in range(3))
        self.linear = laplacian(one, other, g, clamp + 1)
        self.loss = np.zeros(clamp + 1)
        self.loss[:n] = self.to_air
        self.loss[ring[-1]] = w / (math.log(face[-1] / node[-1]) / k + 1 / (OUTSIDE * 2 * math.pi * face[-1]))
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

    def gains(self, on: float) -> Array:
        """Heat that every unknown gains, W, with the switch conducting a part `on` of the time."""
        rig, T, n = self.rig, self.state, self.n
        flow = -(self.linear @ T) - self.loss * (T - rig.ambient)
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
        matrix = self.linear + links + scipy.sparse.diags_array(bend)
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
