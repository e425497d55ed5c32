"""A rig over heating and hold: finite volumes along the tube, Radau collocation in time, as expressions of CasADi.

Two phases, heating of free duration and hold of given duration, share their states where they meet. Unknowns are the
temperatures at all collocation points and the mean square current I^2 times duty, linear between nodes. The current and
the tube's resistance are unknowns of their own: eliminated, they would couple every temperature with every other.

`RigCourse` is the one statement of these equations. The program of a schedule (`optimal_control`) has parameters for
tube and rig, so that it is compiled once; `HeatingBlock` puts numbers and a user's expressions in their place.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from ...block.transcription.tableau import tableau
from ...physics import heat
from ...physics.heat import CLEARANCE, CURVED, GRIP, LEAD, PROPERTIES, Properties, Resolution, Shells, zones
from ...robots.tubes import Tube
from ...typing import Array
from .rig import Rig
from .thermal import (
    cell_fractions,
    cell_widths,
    check_mold,
    contact_decay,
    covered_fraction,
    half_lengths,
    properties,
    shells_of,
    uniform_gap_of,
)


class Scales(NamedTuple):
    """Scales of unknowns and residuals, so that IPOPT sees numbers of the order of 1."""

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
"""Number of points from the end of the mold to its middle for possible vents; linear between them."""

RIG_PARAMETERS = {
    "clearance": ("clamps", "clearance"),
    "lead": ("mold", "lead"),
    "gap": ("mold", "gap"),
    "clamp_mass": ("clamps", "mass"),
    "clamp_area": ("clamps", "area"),
    "mold_thickness": ("mold", "thickness"),
    "mold_conductivity": ("mold", "material", "conductivity"),
}
"""Parameters of a rig that may be expressions, and the fields that hold them; SI."""


def with_parameters(rig: Any, values: Mapping[str, Any]) -> Any:
    """Copy of a rig with parameters by the names of `RIG_PARAMETERS`: numbers, or expressions that nothing checks."""
    result = copy.copy(rig)
    for name, value in values.items():
        owner, (*parts, last) = result, RIG_PARAMETERS[name]
        for part in parts:
            inner = copy.copy(getattr(owner, part))
            object.__setattr__(owner, part, inner)
            owner = inner
        object.__setattr__(owner, last, value)
    return result


def rig_parameters(tube: Tube, rig: Rig, resolution: Resolution, expressions: Mapping[str, Any] | None = None) -> Any:
    """Column of all parameters of tube and rig in the program; `Parameters.of` is the inverse.

    Properties, fractions of the cells (n,), geometry of the shells, and the weights of the vents at the covered cells.

    Args:
        expressions: parameters of the rig that are expressions, by the names of `RIG_PARAMETERS`. Vents keep their
            places relative to the mold of the rig, and the gap does not follow the mold's conductivity.

    Raises:
        InputError: a mold that is too small for the tube.
    """
    check_mold(rig, tube)
    values = {"gap": uniform_gap_of(tube, rig), **(expressions or {})}
    symbolic = with_parameters(rig, values)
    table = vars(properties(tube, symbolic, resolution.shells))
    position = covered_fraction(tube, rig, resolution)
    weights = np.array([np.interp(position, np.linspace(0.0, 1.0, VENTS), unit) for unit in np.eye(VENTS)])
    fractions = cell_fractions(resolution, half_lengths(tube, rig), contact_decay(tube, rig))
    shells = shells_of(tube, symbolic, resolution.shells)
    column = ca.vertcat(*(table[name] for name in PROPERTIES), fractions, *shells, weights.ravel())
    return column if expressions else column.full().ravel()


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
    """Function (z, z', circuit, I_sq, design, parameters) -> equations of one instant.

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
    return ca.Function("instant", [z, rate, circuit, I_sq, design, column], [equations])


@dataclass(frozen=True)
class TimeMesh:
    """Numbers of time intervals of heating and hold, and of collocation points in each."""

    heating: int = 14
    hold: int = 10
    degree: int = 2

    @property
    def fractions(self) -> tuple[Array, Array]:
        """Faces of the intervals in each phase, from 0 to 1."""
        up, on = np.linspace(0.0, 1.0, self.heating + 1), np.linspace(0.0, 1.0, self.hold + 1)
        return 1 - np.sinh(1.5 * up[::-1]) / math.sinh(1.5), np.sinh(4.0 * on) / math.sinh(4.0)

    @property
    def intervals(self) -> int:
        """Number of intervals of both phases, K."""
        return self.heating + self.hold

    @property
    def holding_points(self) -> int:
        """Number of points of the hold, H, its first point included."""
        return self.hold * self.degree + 1

    def times(self, heating: float, hold: float) -> tuple[Array, Array]:
        """Faces of the intervals, and collocation points (N,), s, for durations of heating and hold, s."""
        first, second = self.fractions
        faces = np.concatenate([heating * first, heating + hold * second[1:]])
        return faces, (faces[:-1, None] + np.diff(faces)[:, None] * tableau("radau", self.degree).nodes).ravel()


TIME_MESH = TimeMesh()
"""Mesh of the program of a schedule."""


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
class GridPlaces:
    """Places of the cells of a rig in numbers."""

    places: Array
    """(n,) distances from the middle of the tube, decreasing, m."""
    fixed: bool
    """True if all places are fixed; False if an unknown clearance or lead moves those outside the curved part."""


NO_PLACES = GridPlaces(np.zeros(0), fixed=False)


def grid_places(tube: Tube, rig: Rig, resolution: Resolution, *, fixed: bool) -> GridPlaces:
    """Places of the cells of a rig."""
    width = cell_widths(tube, rig, resolution)
    return GridPlaces(float(width.sum()) - np.cumsum(width) + 0.5 * width, fixed)


class RigCourse:
    """A rig over heating and hold, in expressions of the unknowns at N collocation points, SI.

    Temperatures are in K and belong to half of the tube, which is symmetric. Time runs from the start of the heating;
    the points do not include the start, where everything is at the ambient temperature.

    Args:
        resolution, mesh: cells of the tube and shells of the mold; intervals of time.
        z: (S, N) scaled states. circuit: (2, N) scaled current while the MOSFET conducts, resistance of half the tube.
        I_sq_nodes: (1, 1+K) scaled mean square current at the ends of the intervals.
        durations: (1, intervals of heating) copies of the scaled heating time. hold: its duration, s.
        designs: (2 + VENTS, N) scaled clearance and lead, and vents, at every point.
        column: parameters of tube and rig (`rig_parameters`), the same or one column for every point.
        grid: places of the cells, for temperatures at a position.

    Attributes:
        length: (1, N) length of the interval of every point, s.
        equations: equations of all points, scaled.  rate: (S, N) rates of the scaled states, 1/s.
    """

    def __init__(  # noqa: PLR0913
        self,
        resolution: Resolution,
        mesh: TimeMesh,
        *,
        z: Any,
        circuit: Any,
        I_sq_nodes: Any,
        durations: Any,
        hold: Any,
        designs: Any,
        column: Any,
        grid: GridPlaces = NO_PLACES,
    ) -> None:
        self.resolution, self.mesh, self.hold_time, self.grid = resolution, mesh, hold, grid
        self.z, self.circuit, self.I_sq_nodes, self.designs = z, circuit, I_sq_nodes, designs
        self.durations = durations
        self.parameters = Parameters.of(column[:, 0], resolution)
        # Length of the interval of every point: heating time and hold, split by the mesh.
        heating_parts, hold_parts = (np.diff(faces) for faces in mesh.fractions)
        heating = SCALE.duration * ca.repmat(durations * ca.DM(heating_parts).T, mesh.degree, 1)
        self.length = ca.horzcat(ca.vec(heating).T, hold * ca.DM(np.repeat(hold_parts, mesh.degree)).T)
        # Collocation: rates and mean square currents at the points; everything begins at ambient temperature.
        states, points = z.shape
        values = ca.horzcat(ca.DM.zeros(states, 1), z)
        self.rate = ca.mtimes(values, ca.sparsify(ca.DM(differentiation(mesh)))) / ca.repmat(self.length, states, 1)
        self.I_sq = ca.mtimes(I_sq_nodes, ca.sparsify(ca.DM(interpolation(mesh))))
        shared = [5] if column.size2() == 1 else []
        instants = instant(resolution).map("instants", "serial", points, shared, [])
        self.equations = instants(z, self.rate, circuit, self.I_sq, designs, column)

    # --- time ---------------------------------------------------------------------------------------------------------

    @property
    def hold_start(self) -> Any:
        """Start of the hold, s."""
        return SCALE.duration * self.durations[0]

    @property
    def hold_end(self) -> Any:
        """End of the hold, s."""
        return self.hold_start + self.hold_time

    @cached_property
    def faces(self) -> Any:
        """(1, 1+K) ends of the intervals, s."""
        heating, hold = self.mesh.fractions
        return ca.horzcat(self.hold_start * ca.DM(heating).T, self.hold_start + self.hold_time * ca.DM(hold[1:]).T)

    @cached_property
    def time(self) -> Any:
        """(1, N) times of the collocation points, s."""
        nodes = ca.DM(np.tile(tableau("radau", self.mesh.degree).nodes, self.mesh.intervals)).T
        return ca.kron(self.faces[:-1], ca.DM.ones(1, self.mesh.degree)) + nodes * self.length

    def integral(self, values: Any) -> Any:
        """Integral over heating and hold of values (1, N) at the points, by the weights of the collocation."""
        quadrature = np.tile(tableau("radau", self.mesh.degree).weights, self.mesh.intervals)
        return ca.sum2(values * ca.DM(quadrature).T * self.length)

    # --- temperatures -------------------------------------------------------------------------------------------------

    @property
    def T_amb(self) -> Any:
        """Ambient temperature, K."""
        return self.parameters.properties.T_amb

    @property
    def tube_temperature(self) -> Any:
        """(n, N) temperatures of the cells from the end of a clamp to the middle of the tube, K."""
        return self.T_amb + SCALE.T * self.z[: self.resolution.cells, :]

    @property
    def mold_temperature(self) -> Any:
        """(c, N) temperatures of the innermost shell, the wall of the groove, around the last c cells, K."""
        first, c = self.resolution.cells, self.resolution.covered
        return self.T_amb + SCALE.T * self.z[first : first + c * self.resolution.shells : self.resolution.shells, :]

    @property
    def clamp_temperature(self) -> Any:
        """(1, N) temperature of the clamps, K."""
        return self.T_amb + SCALE.T * self.z[-3, :]

    @cached_property
    def hold_temperatures(self) -> Any:
        """(1+c, H) temperatures at the start of the curved part and at its cells, at the points of the hold, K."""
        mesh, cells = self.mesh, self.resolution.cells
        first, first_column = cells - self.resolution.curved, self.z.size2() - mesh.holding_points
        rows = self.z[first - 1 : cells, first_column:] * SCALE.T
        # The joint of lead and curve lies between two cells whose widths the design may change.
        columns = ca.horzsplit(self.designs[:, first_column:])
        widths = [self.parameters.widths(self.resolution, design)[first - 1 : first + 1] for design in columns]
        before, after = ca.vertsplit(ca.horzcat(*widths))
        joint = (after * rows[0, :] + before * rows[1, :]) / (before + after)
        return ca.vertcat(joint, rows[1:, :]) + self.T_amb

    @cached_property
    def places(self) -> Any:
        """(n,) distances of the cells from the middle of the tube, decreasing, m."""
        widths = self.parameters.widths(self.resolution, self.designs[:, 0])
        return ca.sum1(widths) - ca.cumsum(widths) + 0.5 * widths

    def temperature(self, position: float, time: Any = None) -> Any:
        """Temperature of the tube at a distance from its middle, K: at a time, or (1, N) at all points.

        Args:
            position: m, to either side; linear between the middles of cells.
            time: s, a number or an expression, from 0 to the end of the hold; by the collocation polynomial.
        """
        row = ca.mtimes(self._weights(abs(position)), self.tube_temperature)
        return row if time is None else self.at_time(row, self.T_amb, time)

    def _weights(self, distance: float) -> Any:
        """(1, n) interpolation weights of the cells at a distance from the middle; of two cells if positions are
        numbers.
        """
        at, n = self.grid.places, self.resolution.cells
        k = int(np.clip(np.searchsorted(-at, -distance) - 1, 0, n - 2))
        if self.grid.fixed or k >= n - self.resolution.curved:
            # Places in the curved part do not depend on clearance and lead.
            outer = float(np.clip((distance - at[k + 1]) / (at[k] - at[k + 1]), 0.0, 1.0))
            return ca.DM.triplet([0, 0], [k, k + 1], ca.DM([outer, 1 - outer]), 1, n)
        x = self.places
        here = ca.fmin(ca.fmax(distance, x[-1]), x[0])
        # Weight of each cell: 1 at its middle, 0 at those of its neighbours.
        rise, fall = (here - x[1:]) / (x[:-1] - x[1:]), (x[:-1] - here) / (x[:-1] - x[1:])
        return ca.fmax(ca.fmin(ca.vertcat(1, fall), ca.vertcat(rise, 1)), 0).T

    def at_time(self, row: Any, start: Any, time: Any) -> Any:
        """Value at a time (s) of a quantity (1, N) that begins at `start`, by the collocation polynomial."""
        degree, count = self.mesh.degree, self.mesh.intervals
        nodes, faces = np.concatenate([[0.0], tableau("radau", degree).nodes]), self.faces
        begins, ends = faces[:-1], faces[1:]
        x = (time - begins) / (ends - begins)
        # The interval that contains the time has weight 1; the last one includes its end.
        chosen = ca.logic_and(time >= begins, time < ends)
        chosen[-1] = time >= begins[-1]
        ends_of_row = ca.horzcat(start, row[degree - 1 :: degree])
        values = ca.vertcat(ends_of_row[:count], ca.reshape(row, degree, count))
        result = 0
        for k, node in enumerate(nodes):
            others = np.delete(nodes, k)
            lagrange = 1
            for other in others:
                lagrange = lagrange * (x - other) / (node - other)
            result = result + ca.sum2(chosen * lagrange * values[k, :])
        return result

    # --- circuit ------------------------------------------------------------------------------------------------------

    @property
    def current(self) -> Any:
        """(1, N) current while the MOSFET conducts, A."""
        return SCALE.current * self.circuit[0, :]

    @property
    def duty(self) -> Any:
        """(1, N) effective duty, 0 to 1: mean square current over the square of the current."""
        return SCALE.I_sq * self.I_sq / self.current**2

    @property
    def mean_current(self) -> Any:
        """(1, N) mean current of the battery, A."""
        return SCALE.I_sq * self.I_sq / self.current

    @property
    def resistance(self) -> Any:
        """(1, N) resistance of the tube between the clamps, ohm."""
        return 2 * SCALE.R * self.circuit[1, :]

    @property
    def charge(self) -> Any:
        """(1, N) fraction of the battery's capacity that was drawn."""
        return SCALE.charge * self.z[-2, :]

    @property
    def power(self) -> Any:
        """(1, N) mean power of the battery's open-circuit voltage, W."""
        return self.mean_current * heat.open_circuit_voltage(self.charge, self.parameters.properties)

    @property
    def energy(self) -> Any:
        """Energy drawn from the battery until the end of the hold, J: the integral of `power`."""
        return self.integral(self.power)

    # --- limits and objectives of a schedule --------------------------------------------------------------------------

    def limits(self, w: Mapping[str, Any], misses: Any) -> dict[str, Any]:
        """Scaled constraints of a schedule by name; `LIMIT_RANGES` has their bounds.

        Args:
            w: values by the names of `TASK`. misses: (1, N) miss of window and limit, K.
        """
        T_hold, cells = self.hold_temperatures, self.resolution.cells
        allowed = ca.repmat(misses[self.z.size2() - self.mesh.holding_points :], T_hold.size1(), 1)
        limit = (w["limit"] - self.T_amb + misses) / SCALE.T
        return {
            "low": (T_hold + allowed - w["low"]) / SCALE.window,
            "high": (T_hold - allowed - w["high"]) / SCALE.window,
            "limit": self.z[:cells, :] - ca.repmat(limit, cells, 1),
            "ramp": self.rate[self.resolution.grip : cells, :] * SCALE.T / w["ramp"],
            "current": self.I_sq * SCALE.I_sq / (self.circuit[0, :] * SCALE.current) / w["current"],
            # duty = I_sq / I^2 at most 1, times I^2: polynomial, and finite where the current is small.
            "duty": self.I_sq * SCALE.I_sq / SCALE.current**2 - self.circuit[0, :] ** 2,
        }

    def regularisation(self, w: Mapping[str, Any], design: Any) -> Any:
        """Squares in the objective: distance from the middle of the window, changes of the current, design.

        Args:
            w: values by the names of `TASK`. design: (2 + VENTS,) scaled.
        """
        T_hold, changes = self.hold_temperatures, ca.diff(self.I_sq_nodes, 1, 1)
        # From the last interval of heating to the first of the hold the current may jump.
        changes[self.mesh.heating] = 0
        middle = 0.5 * (w["low"] + w["high"])
        smooth = w["w_centre"] * ca.sumsqr((T_hold - middle) / SCALE.band) / T_hold.numel()
        smooth += w["w_I_sq"] * ca.sumsqr(changes)
        # Among equally good clearances, leads and vents the smallest; squares damp the steps of bilinear terms. Vents
        # that change fast along the tube would compensate errors of the coarse grid.
        smooth += W_LENGTH * ca.sumsqr(design[:2]) + W_VENT * ca.sumsqr(design[2:])
        return smooth + W_VENT_CHANGE * ca.sumsqr(ca.diff(design[2:]))


TASK = (
    "hold", "low", "high", "limit", "ramp", "current", "w_time", "w_energy", "w_centre", "w_miss", "w_I_sq", "w_custom",
)  # fmt: skip
"""Parameters of the question: hold (s), window and limit (K), ramp (K/s), mean current (A), and objective weights."""

LIMIT_RANGES: dict[str, tuple[float, float]] = {
    "low": (0.0, np.inf), "high": (-np.inf, 0.0), "limit": (-np.inf, 0.0), "ramp": (-np.inf, 1.0),
    "current": (-np.inf, 1.0), "duty": (-np.inf, 0.0),
}  # fmt: skip
"""Lower and upper bounds of the constraints of `RigCourse.limits`."""

W_LENGTH, W_VENT, W_VENT_CHANGE = 1e-2, 1.0, 20.0
"""Weights in the objective of the squares of clearance and lead (scaled), of the vents, and of their differences."""
