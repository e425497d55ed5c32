"""Shape setting in an oven, a furnace or a salt bath: soak time, quench, and the radius of the cold tube.

A tube lies between two plates of a mold, which is put into a medium of constant temperature. With T the temperature of
the mold,

    rho c(T) dT/dt = div(k grad T),   k dT/dn = h (T_oven - T) + eps sigma (T_oven^4 - T^4)  on its faces,

in three dimensions, by finite volumes on a quarter of the mold (the plates are symmetric about the middle of length and
width), with backward differentiation in time. The tube is thin: each point of it approaches the wall of its groove with
one time constant, and warms the mold by nothing that counts (a gram of nitinol, a kilogram of mold).

Incropera et al., Fundamentals of Heat and Mass Transfer, for radiation in a large enclosure and for the ranges of
convection.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, NamedTuple

import numpy as np
import scipy

from ...arguments import typed
from ...constants import STEFAN_BOLTZMANN, ZERO_CELSIUS
from ...display import Displayed
from ...errors import InputError, finite, positive
from ...files.csv_file import to_csv
from ...files.field_metadata import (
    NOT_NEGATIVE,
    POSITIVE,
    REQUIRED,
    OneOf,
    Range,
    Typical,
    Written,
    check_fields,
    form,
    key,
    unit,
)
from ...robots.file import TubeEntry, tube_to_dict
from ...robots.tubes import Tube
from ...typing import Array, StatusEnum
from ..materials import AMBIENT_RANGE, check_temperatures
from .plan import AGEING_DEGC, AIR, QUENCHED_DEGC, SHORTEST_AGEING, WATER, cooling_rate
from .rig import MoldBed, Rig
from .thermal import SURFACE_TRANSFER, gap_transfer, thermal_data

METHODS = ("oven", "furnace", "salt_bath")
QUENCHES = ("water", "water_in_mold", "air")

CONVECTION = {"oven": 20.0, "furnace": 10.0, "salt_bath": 600.0}
"""Heat transfer to the mold without radiation, W/(m^2 K). Order of magnitude, assumed.

A fan oven (forced convection of gases begins at 25), still air of a muffle furnace (free convection of gases: 2 to 25),
stirred nitrate salt.
"""

POROUS = 1500.0
"""Density, kg/m^3, below which a mold material is a board that soaks up salt."""

CELLS = (8, 8, 13)
"""Finite volumes along half of the length, half of the width and all of the thickness.

With twice as many the soak time changes by less than 1 %. The last is odd: the tube then lies in the middle of a layer
of cells.
"""

POINTS = 33
"""Number of points of the curved part with a computed temperature."""

LONGEST = 12 * 3600.0
"""Time, s, after which a mold that is not through counts as one that never will be."""

RELATIVE, KELVIN = 1e-5, 1e-3
"""Tolerances of a step in time: relative, and in K.

A tenth of them moves the soak time by less than 0.1 %.
"""


@dataclass(frozen=True)
class Oven(Displayed):
    """An oven, a muffle furnace or a salt bath, and the mold in it.

    Raises:
        InputError: a value is out of its range.
    """

    set_temperature: Annotated[
        float,
        key("setting_degC"),
        REQUIRED,
        Range(minimum=ZERO_CELSIUS + 100.0, maximum=ZERO_CELSIUS + 1000.0),
        "temperature setting of the oven, furnace or bath",
    ] = 525.0 + ZERO_CELSIUS
    method: Annotated[str, OneOf(METHODS), "kind of heating: oven (with a fan), furnace (still air) or salt_bath"] = (
        "oven"
    )
    uniformity: Annotated[
        float,
        unit("K"),
        Range(minimum=0.0, maximum=100.0),
        "largest difference between the setting and the temperature at the mold",
    ] = 6.0
    convection: Annotated[
        float | None,
        unit("W_per_m2_K"),
        Range(above=0.0, maximum=1e4),
        "heat transfer coefficient to the mold without radiation; default 20 in an oven, 10 in a furnace, 600 in a "
        "salt bath",
    ] = None
    heating_power: Annotated[
        float | None,
        unit("W"),
        Range(above=0.0, maximum=1e6),
        "power that the oven can give to the mold beyond its own losses; default unlimited",
    ] = None
    on_floor: Annotated[bool, "the mold lies on a floor and gets no heat from below; default on a rack"] = False
    mold: Annotated[MoldBed, "plates, groove and lead; vents do not count"] = field(default_factory=MoldBed)
    mold_length: Annotated[
        float | None,
        unit("mm"),
        Range(above=0.0, maximum=2.0),
        "length of the mold; default the chord of the curved part and both leads",
    ] = None
    ambient: Annotated[float, unit("degC"), AMBIENT_RANGE, "ambient temperature"] = 25.0 + ZERO_CELSIUS
    transfer_time: Annotated[float, unit("s"), NOT_NEGATIVE, "time in air between oven and quench"] = 15.0
    quench: Annotated[
        str, OneOf(QUENCHES), "cooling: water (tube out of the mold), water_in_mold (closed mold), or air (closed mold)"
    ] = "water"
    tube: Annotated[Tube | None, Written(TubeEntry, tube_to_dict), "default tube"] = None
    name: Annotated[str, "name for headings"] = ""

    def __post_init__(self) -> None:
        check_fields(self, "the oven")

    @property
    def transfer_coefficient(self) -> float:
        """Heat transfer to the mold without radiation, W/(m^2 K)."""
        return self.convection or CONVECTION[self.method]

    @property
    def emissivity(self) -> float:
        """Emissivity of the mold where radiation reaches it: a salt bath is opaque, so 0 there."""
        return 0.0 if self.method == "salt_bath" else self.mold.material.emissivity


class OvenStatus(StatusEnum):
    """Result of an oven plan; every value reads as a sentence."""

    HELD = "every point of the curved part stays in the window for the hold time"
    MISSED = "no soak time keeps the curved part in the window"


@dataclass(frozen=True, eq=False)
class OvenCourse:
    """Temperatures over time, at the setting: S times, from the oven to the cold tube."""

    time: Array
    """(S,) times since the mold was put in, s."""
    coldest: Array
    """(S,) coldest temperature of the curved part, degC."""
    hottest: Array
    """(S,) hottest temperature of the curved part, degC."""
    surface: Array
    """(S,) mean of the mold's faces, degC."""
    medium: Array
    """(S,) temperature around mold or tube, degC."""


@dataclass(frozen=True, eq=False)
class OvenPlan(Displayed):
    """Soak time of a tube in an oven, with the temperatures over time."""

    _brief = ("status", "soak_time", "coldest", "hottest", "cold_radius")

    tube: Tube
    """Tube that is set."""
    oven: Oven
    """Oven and mold."""
    window: Annotated[tuple[float, float], unit("degC"), "temperature window of the hold"]
    hold_time: Annotated[float, unit("s"), "hold time"]
    problems: Annotated[tuple[str, ...], "violated requirements, as text"]
    """Empty if the plan can be used."""
    remarks: Annotated[tuple[str, ...], "what to check"]
    soak_time: Annotated[float, unit("s"), form(".0f"), "soak time: from putting the mold in to taking it out"]
    """Soak time with the oven colder than its setting by the uniformity. Infinite if the window is not reached."""
    warm_time: Annotated[float, unit("s"), form(".0f"), "time until the coldest point is in the window"]
    first_time: Annotated[float, unit("s"), form(".0f"), "time until the first point is in the window"]
    """Time with the oven hotter than its setting by the uniformity."""
    coldest: Annotated[float, unit("degC"), form(".1f"), "coldest point of the curved part at the end of the soak"]
    hottest: Annotated[float, unit("degC"), form(".1f"), "hottest point of the curved part during the soak"]
    quench_start: Annotated[float, unit("degC"), form(".1f"), "coldest point when the quench begins"]
    quench_time: Annotated[float, unit("s"), form(".1f"), "time of the quench until the tube is below 100 degC"]
    ageing_time: Annotated[float, unit("s"), form(".0f"), "longest time of a point between 400 and 500 degC on cooling"]
    energy: Annotated[float, unit("kJ"), form(".0f"), "heat taken by the mold"]
    mold_mass: Annotated[float, unit("kg"), form(".2f"), "mass of the mold"]
    hot_radius: Annotated[float, unit("mm"), form(".3f"), "radius of the groove in the hot mold"]
    cold_radius: Annotated[float, unit("mm"), form(".3f"), "radius of the cold tube, without spring-back"]
    groove_radius: Annotated[float, unit("mm"), form(".3f"), "radius to mill for the drawn radius, without spring-back"]
    course: OvenCourse
    """Temperatures over time at the setting."""

    @property
    def feasible(self) -> bool:
        """True if every requirement is met."""
        return not self.problems

    @property
    def status(self) -> OvenStatus:
        """Status of the requirements; `problems` names the violated ones."""
        return OvenStatus.HELD if self.feasible else OvenStatus.MISSED

    @property
    def value(self) -> float:
        """Soak time, s."""
        return self.soak_time

    @property
    def statistics(self) -> int:
        """Number of times of the course."""
        return len(self.course.time)


# --- The mold ---------------------------------------------------------------------------------------------------------


class Medium(NamedTuple):
    """Surroundings of the mold."""

    temperature: float
    """Temperature, K."""
    transfer: float
    """Heat transfer without radiation, W/(m^2 K)."""
    emissivity: float
    power: float = math.inf
    """Largest heat flow into the mold, W."""


class MoldBlock:
    """Finite-volume model of a quarter of the mold, and the points of the tube in its middle plane.

    Args:
        oven: mold, material and floor. tube: whose curved part lies in it, as an arc about the middle of the plates.
    """

    def __init__(self, oven: Oven, tube: Tube, cells: tuple[int, int, int] = CELLS) -> None:
        bed, material = oven.mold, oven.mold.material
        self.material = material
        # Neither curve nor slope changes much over the last hundred K, which take most of the time.
        self.conductivity = material.conductivity * float(
            material.conductivity_factor(0.5 * (oven.ambient + oven.set_temperature))
        )
        self.size = np.array([mold_length(oven, tube), bed.width, bed.thickness])
        steps = self.size * (0.5, 0.5, 1.0) / cells
        self.middles = [step * (np.arange(count) + 0.5) for step, count in zip(steps, cells, strict=True)]
        number = np.arange(math.prod(cells)).reshape(cells)
        self.volume = np.full(number.size, steps.prod())
        pairs, conductances, outside = [], [], []
        for axis, step in enumerate(steps):
            order, area = np.moveaxis(number, axis, 0), steps.prod() / step
            # Heat between neighbours: k A (T_2 - T_1) / (distance of the middles).
            pairs.append(np.stack([order[:-1].ravel(), order[1:].ravel()]))
            conductances.append(np.full(pairs[-1].shape[1], self.conductivity * area / step))
            # Length and width are halved at planes of symmetry; a floor closes the lower face.
            for end in [-1] if axis < 2 or oven.on_floor else [0, -1]:
                outside.append([order[end].ravel(), np.full(order[end].size, area), np.full(order[end].size, step / 2)])
        self.surface_cell, self.surface_area, self.surface_depth = (
            np.concatenate(part) for part in zip(*outside, strict=True)
        )
        (i, j), g = np.concatenate(pairs, axis=1), np.concatenate(conductances)
        rows, columns = np.concatenate([i, j, i, j]), np.concatenate([j, i, i, j])
        self.conduction = scipy.sparse.csr_array(
            (np.concatenate([g, g, -g, -g]), (rows, columns)), shape=2 * (number.size,)
        )
        # Weights of the cells at the points of the curved part: linear between the middles of the middle layer.
        points, weights = np.abs(arc_points(tube)), np.zeros((POINTS, *cells))
        along, across = (
            np.array([np.interp(points[:, axis], self.middles[axis], unit) for unit in np.eye(cells[axis])])
            for axis in range(2)
        )
        weights[..., cells[2] // 2] = np.einsum("xp,yp->pxy", along, across)
        self.onto_tube = scipy.sparse.csr_array(weights.reshape(POINTS, -1))
        self.lag = tube_lag(tube, oven)

    def heat_capacity(self, temperature: Array) -> Array:
        """(N,) heat capacities of the cells, J/K."""
        material = self.material
        slope = material.heat_capacity_slope * (temperature - material.reference_temperature)
        return np.asarray(material.density * material.heat_capacity * (1 + slope) * self.volume)

    def stored(self, temperature: Array, start: float) -> float:
        """Heat of the whole mold above `start`, K, in J."""
        material = self.material
        middle = (temperature + start) / 2  # exact for a heat capacity that is linear
        slope = material.heat_capacity_slope * (middle - material.reference_temperature)
        each = material.density * material.heat_capacity * (1 + slope) * self.volume * (temperature - start)
        return 4 * float(each.sum())

    def from_medium(self, temperature: Array, medium: Medium) -> tuple[Array, Array]:
        """(N,) heat into the cells, W, and its derivative by their temperatures, W/K.

        The face of a cell is colder than its middle by what conduction to it needs: flux = (T_face - T) k / depth.
        """
        at = temperature[self.surface_cell]
        inner = self.conductivity / self.surface_depth
        radiating = medium.emissivity * STEFAN_BOLTZMANN
        surface = at.copy()
        # Newton's method for the temperature of the face. Conduction dominates: the third step is below round-off.
        for _ in range(3):
            flux = medium.transfer * (medium.temperature - surface) + radiating * (medium.temperature**4 - surface**4)
            slope = medium.transfer + 4 * radiating * surface**3
            surface = surface - (inner * (surface - at) - flux) / (inner + slope)
        outer = medium.transfer + 4 * radiating * surface**3
        flow = self.surface_area * inner * (surface - at)
        by_own = -self.surface_area * inner * outer / (inner + outer)
        total = 4 * float(flow.sum())
        if total > medium.power:
            # The oven gives what it can: its temperature sinks, and all faces get less by the same factor.
            flow, by_own = flow * (medium.power / total), by_own * (medium.power / total)
        size = self.volume.size
        return (
            np.asarray(np.bincount(self.surface_cell, flow, minlength=size), dtype=float),
            np.asarray(np.bincount(self.surface_cell, by_own, minlength=size), dtype=float),
        )

    def run(
        self, state: Array, medium: Medium, until: float, stop: Callable[[Array], float] | None = None
    ) -> tuple[Array, Array]:
        """Times (S,), s, and states (S, N + POINTS), K, of mold and tube, from `state` on.

        The run ends after `until` s, or where `stop` of the tube's temperatures rises through 0.
        """
        cells = self.volume.size

        def rate(_: float, y: Array) -> Array:
            mold, tube = y[:cells], y[cells:]
            flow = self.conduction @ mold + self.from_medium(mold, medium)[0]
            return np.concatenate([flow / self.heat_capacity(mold), (self.onto_tube @ mold - tube) / self.lag])

        def jacobian(_: float, y: Array) -> scipy.sparse.csc_array:
            mold = y[:cells]
            capacity = self.heat_capacity(mold)
            decay = self.conduction + scipy.sparse.diags_array(self.from_medium(mold, medium)[1])
            by_mold = scipy.sparse.diags_array(1 / capacity) @ decay
            # The slope of the heat capacity changes little within a step: Newton's method converges without it.
            lagging = scipy.sparse.eye_array(POINTS) / self.lag
            return scipy.sparse.block_array([[by_mold, None], [self.onto_tube / self.lag, -lagging]], format="csc")

        def event(_: float, y: Array) -> float:
            assert stop is not None
            return stop(y[cells:])

        event.terminal, event.direction = True, 1.0  # type: ignore[attr-defined]
        result = scipy.integrate.solve_ivp(
            rate, (0.0, until), state, method="BDF", jac=jacobian, rtol=RELATIVE, atol=KELVIN, first_step=1e-3,
            events=None if stop is None else event,
        )  # fmt: skip
        return result.t, result.y.T

    def surface_mean(self, mold: Array) -> Array:
        """(S,) mean temperature of the cells at the faces of the mold, K, from all cells (S, N)."""
        weight = self.surface_area / self.surface_area.sum()
        return np.asarray(mold[:, self.surface_cell] @ weight)


class Warming(NamedTuple):
    """Warming of a block in a furnace."""

    time: float
    """Time until its coldest point is at the wanted temperature, s; inf if it is not within half a day."""
    ageing: float
    """Longest time of a point in the middle between 400 and 500 degC, s."""


def warming(oven: Oven, tube: Tube, goal: float) -> Warming:
    """Warming of a block that is put into a hot oven, until the tube in its middle is at the `goal`, K.

    Args:
        oven: block as a mold of one material, with its length.
        tube: straight one in the middle of the block.
        goal: temperature, K.
    """
    block = MoldBlock(oven, tube)
    cells, medium = block.volume.size, Medium(oven.set_temperature, oven.transfer_coefficient, oven.emissivity)
    start = np.full(cells + POINTS, oven.ambient)
    time, states = block.run(start, medium, LONGEST, lambda points: float(points.min()) - goal)
    points = states[:, cells:]
    low, high = (value + ZERO_CELSIUS for value in AGEING_DEGC)
    passed = [np.interp((low, high), course, time) for course in np.maximum.accumulate(points, axis=0).T]
    reached = points[-1].min() >= goal - KELVIN
    return Warming(float(time[-1]) if reached else math.inf, max(float(end - begin) for begin, end in passed))


def arc_points(tube: Tube) -> Array:
    """(POINTS, 2) points of the curved part in the middle plane, from the middle of the plates, m.

    Along and across.
    """
    angle = (np.linspace(0.0, 1.0, POINTS) - 0.5) * tube.curved_length * tube.curvature
    if not tube.curvature:
        return np.stack([(np.linspace(0.0, 1.0, POINTS) - 0.5) * tube.curved_length, np.zeros(POINTS)], 1)
    radius = 1 / tube.curvature
    points = radius * np.stack([np.sin(angle), np.cos(angle)], 1)
    # The box around the arc is in the middle of the plates.
    return np.asarray(points - (points.max(0) + points.min(0)) / 2)


def mold_length(oven: Oven, tube: Tube) -> float:
    """Length of the mold, m, as given or by default; raises InputError if the arc does not fit into the plates."""
    extent = np.ptp(arc_points(tube), axis=0)
    length = float(extent[0]) + 2 * oven.mold.lead if oven.mold_length is None else oven.mold_length
    if oven.mold_length is not None and extent[0] >= length:
        raise InputError(
            f"mold_length is {1e3 * length:g} mm; it must be above {1e3 * extent[0]:.1f} mm, the chord of the curve"
        )
    if extent[1] >= oven.mold.width:
        raise InputError(
            f"width of the mold is {1e3 * oven.mold.width:g} mm; it must be above {1e3 * extent[1]:.1f} mm, the height "
            "of the curved part"
        )
    return length


def tube_lag(tube: Tube, oven: Oven) -> float:
    """Time constant, s, of the tube behind the wall of its groove, through the air between."""
    data, groove = thermal_data(tube), Rig(mold=oven.mold, ambient=oven.ambient)
    per_length = gap_transfer(tube, groove) * math.pi * tube.outer_diameter
    return data.density * data.heat_capacity * tube.cross_section / per_length


# --- The plan ---------------------------------------------------------------------------------------------------------


@typed
def plan_oven(
    tube: Tube,
    oven: Oven,
    *,
    window_degC: Annotated[tuple[float, float], POSITIVE] = (500.0, 550.0),
    hold_time: Annotated[float, key("hold_s"), POSITIVE, Typical(1.0, 7200.0)] = 600.0,
) -> OvenPlan:
    """Soak time until every point of the curved part has been in its temperature window for the hold time.

    The soak time is that of an oven colder than its setting by its uniformity; the hottest point is that of an oven
    hotter by it. The plan then follows transfer and quench, and computes the radius of the cold tube.

    Args:
        tube: tube to set; its curved part lies in the middle of the mold.
        oven: oven, furnace or salt bath, and the mold.
        window_degC: temperature range of the whole curved part during the hold time.
        hold_time: hold time of every point in the window, s.

    Raises:
        InputError: the window is empty, the tube has no curved part or no thermal data, or it does not fit the mold.

    Examples:
        >>> import tubeopt
        >>> tube = tubeopt.load_robot("thesis_ctr").tubes[0]
        >>> plan = tubeopt.plan_oven(tube, tubeopt.Oven(tubeopt.constants.ZERO_CELSIUS + 525))
        >>> plan.feasible
        True
    """
    low, high = (finite("window_degC", value) for value in window_degC)
    if not low < high:
        raise InputError(f"window_degC is {low:g} to {high:g} degC; the first must be below the second")
    positive("hold_time", hold_time)
    if tube.curved_length <= 0:
        raise InputError(f"curved_length is {tube.curved_length:g} m; a tube to be shape-set must have a curved part")
    check_temperatures(tube.material, "window_degC", low, high)
    block = MoldBlock(oven, tube)
    cells = block.volume.size
    start = np.full(cells + POINTS, oven.ambient)

    def soak(
        state: Array, deviation: float, until: float, stop: Callable[[Array], float] | None = None
    ) -> tuple[Array, Array]:
        power = math.inf if oven.heating_power is None else oven.heating_power
        medium = Medium(oven.set_temperature + deviation, oven.transfer_coefficient, oven.emissivity, power)
        return block.run(state, medium, until, stop)

    setting = oven.set_temperature - ZERO_CELSIUS
    below = setting - oven.uniformity
    warm, late, soaked = math.inf, LONGEST, start
    if below > low:
        time, states = soak(start, -oven.uniformity, LONGEST, lambda points: float(points.min()) - ZERO_CELSIUS - low)
        warm, soaked = (float(time[-1]), states[-1]) if time[-1] < LONGEST else (math.inf, start)
    out = warm + hold_time
    if math.isfinite(out):
        late = out
    coldest = float(soak(soaked, -oven.uniformity, hold_time if math.isfinite(out) else late)[1][-1, cells:].min())
    hot_time, hot = soak(start, oven.uniformity, late)
    hottest = hot[:, cells:].max(1) - ZERO_CELSIUS
    time, states = soak(start, 0.0, late)
    mass = float(oven.mold.material.density * block.size.prod())
    reached = coldest - ZERO_CELSIUS
    problems = problems_of(oven, (low, high), warm, late, np.stack([hot_time, hottest]), reached=reached, mass=mass)
    tail = cool(block, oven, tube, states[-1])
    rise = float(states[-1, cells:].mean()) - oven.ambient
    material = oven.mold.material
    # The groove grows with the mold; the tube, set at its radius, shrinks by its own metal.
    grown, shrunk = 1 + material.expansion * rise, 1 + thermal_data(tube).expansion * rise
    radius = 1 / tube.curvature if tube.curvature else math.inf
    return OvenPlan(
        tube=tube,
        oven=oven,
        window=(low, high),
        hold_time=hold_time,
        problems=problems,
        remarks=remarks_of(oven, tail),
        soak_time=out,
        warm_time=warm,
        first_time=float(np.interp(low, hottest, hot_time)) if hottest.max() >= low else math.inf,
        coldest=coldest - ZERO_CELSIUS,
        hottest=float(hottest.max()),
        quench_start=tail.quench_start,
        quench_time=tail.quench_time,
        ageing_time=tail.ageing_time,
        energy=block.stored(states[-1, :cells], oven.ambient),
        mold_mass=mass,
        hot_radius=radius * grown,
        cold_radius=radius * grown / shrunk,
        groove_radius=radius * shrunk / grown,
        course=OvenCourse(
            time=np.concatenate([time, time[-1] + tail.time]),
            coldest=np.concatenate([states[:, cells:].min(1) - ZERO_CELSIUS, tail.coldest]),
            hottest=np.concatenate([states[:, cells:].max(1) - ZERO_CELSIUS, tail.hottest]),
            surface=np.concatenate([block.surface_mean(states[:, :cells]) - ZERO_CELSIUS, tail.surface]),
            medium=np.concatenate([np.full(len(time), setting), tail.medium]),
        ),
    )


def problems_of(
    oven: Oven, window: tuple[float, float], warm: float, late: float, hot: Array, *, reached: float, mass: float
) -> tuple[str, ...]:
    """Messages on violated requirements.

    Args:
        oven: oven. window: degC. warm: time until the coldest point is in the window, s. late: end of the soak, s.
        hot: (2, S) times, s, and hottest point, degC, in an oven hotter than its setting.
        reached: coldest point at the end, degC. mass: of the mold, kg.
    """
    (low, high), material = window, oven.mold.material
    setting = oven.set_temperature - ZERO_CELSIUS
    below, above = setting - oven.uniformity, setting + oven.uniformity
    problems = list[str]()
    if above > material.limit_temperature_degC:
        problems.append(
            f"the oven may be at {above:g} degC; a mold of {material.name} {material.failure} above "
            f"{material.limit_temperature_degC:g} degC"
        )
    if oven.method == "salt_bath" and material.density < POROUS:
        problems.append(f"a mold of {material.name} ({material.density:g} kg/m^3) is porous and soaks up salt")
    if high - low <= 2 * oven.uniformity:
        problems.append(
            f"the window of {low:g} to {high:g} degC is too narrow for an oven that is off by up to "
            f"{oven.uniformity:g} K"
        )
    elif below <= low:
        problems.append(
            f"the oven may be at {below:g} degC, where no point reaches the window at {low:g} degC; set it above "
            f"{low + oven.uniformity:g} degC and below {high - oven.uniformity:g} degC"
        )
    elif math.isinf(warm):
        cure = "use thinner plates, or a material of higher diffusivity"
        if oven.heating_power is not None:
            cure = f"{oven.heating_power:g} W are too little, or the mold is too heavy"
        problems.append(
            f"the coldest point is at {reached:.0f} degC after {LONGEST / 3600:g} h, below the window at {low:g} degC; "
            f"the mold weighs {mass:.1f} kg: {cure}"
        )
    elif hot[1].max() > high:
        problems.append(
            f"the hottest point passes {high:g} degC after {np.interp(high, hot[1], hot[0]):.0f} s, before the soak "
            f"ends after {late:.0f} s; set the oven at {high - oven.uniformity:g} degC at most"
        )
    return tuple(problems)


def remarks_of(oven: Oven, tail: Cooling) -> tuple[str, ...]:
    """Remarks on points to check, as text."""
    problems = list[str]()
    if oven.convection is None:
        problems.append(
            f"heat transfer of {oven.transfer_coefficient:g} W/(m^2 K) is assumed for this method; measure the mold's "
            "temperature once, and give convection_W_per_m2_K"
        )
    material = oven.mold.material
    if oven.quench == "water_in_mold" and material.density < POROUS:
        problems.append(f"a mold of {material.name} is porous and soaks up water; dry it before the next use")
    if tail.ageing_time > SHORTEST_AGEING:
        problems.append(
            f"the tube cools from {AGEING_DEGC[1]:g} to {AGEING_DEGC[0]:g} degC in {tail.ageing_time:.0f} s, where "
            f"Ti-50.8Ni precipitates fastest; above {SHORTEST_AGEING:g} s its Af changes. Quench it out of the mold"
        )
    return tuple(problems)


@dataclass(frozen=True)
class Cooling:
    """Transfer and quench: S times from the end of the soak on."""

    time: Array
    coldest: Array
    hottest: Array
    surface: Array
    medium: Array
    """(S,) each, s and degC, as in `OvenCourse`."""
    quench_start: float
    """Coldest point as the quench begins, degC."""
    quench_time: float
    """Time from the removal until the hottest point is below 100 degC, s."""
    ageing_time: float
    """Longest time of a point between the temperatures of `AGEING_DEGC`, s."""


def cool(block: MoldBlock, oven: Oven, tube: Tube, state: Array) -> Cooling:
    """Transfer through air in the mold, then the quench, from the state at the end of the soak."""
    cells = block.volume.size
    air = Medium(oven.ambient, SURFACE_TRANSFER, oven.mold.material.emissivity)
    goal = QUENCHED_DEGC + ZERO_CELSIUS
    times, states = [np.zeros(1)], [state[None]]
    if oven.transfer_time:
        time, course = block.run(state, air, oven.transfer_time)
        times.append(time[1:])
        states.append(course[1:])
    moved = states[-1][-1]
    start_time = float(times[-1][-1])
    if oven.quench == "water":
        rate, hottest = cooling_rate(tube, WATER), float(moved[cells:].max())
        last = 0.0 if hottest <= goal else math.log((hottest - oven.ambient) / (goal - oven.ambient)) / rate
        time = np.linspace(0.0, max(last, 1e-3), 50)[1:]
        points = oven.ambient + (moved[cells:] - oven.ambient) * np.exp(-rate * time[:, None])
        course = np.concatenate([np.tile(moved[:cells], (len(time), 1)), points], axis=1)
        surroundings = oven.ambient
    else:
        medium = Medium(oven.ambient, WATER, 0.0) if oven.quench == "water_in_mold" else Medium(oven.ambient, AIR, 0.0)
        time, course = block.run(moved, medium, LONGEST, lambda points: goal - float(points.max()))
        time, course = time[1:], course[1:]
        last, surroundings = float(time[-1]), medium.temperature
    times.append(start_time + time)
    states.append(course)
    time, course = np.concatenate(times), np.concatenate(states)
    points = course[:, cells:] - ZERO_CELSIUS
    spans = np.diff(time, prepend=0.0)
    ageing = (points > AGEING_DEGC[0]) & (points < AGEING_DEGC[1])
    return Cooling(
        time=time,
        coldest=points.min(1),
        hottest=points.max(1),
        surface=block.surface_mean(course[:, :cells]) - ZERO_CELSIUS,
        medium=np.full(len(time), surroundings - ZERO_CELSIUS),
        quench_start=float(moved[cells:].min()) - ZERO_CELSIUS,
        quench_time=last,
        ageing_time=float((ageing * spans[:, None]).sum(0).max()),
    )


def oven_csv(plan: OvenPlan) -> str:
    """Temperatures over time as CSV, a row for each step of the simulation."""
    course = plan.course
    columns = {
        "time_s": course.time,
        "coldest_degC": course.coldest,
        "hottest_degC": course.hottest,
        "surface_degC": course.surface,
        "medium_degC": course.medium,
    }
    rows = zip(*([f"{value:.2f}" for value in values] for values in columns.values()), strict=True)
    comment = f"{plan.oven.name or 'oven'}: soak {plan.soak_time:.0f} s; surface: mean of the mold's faces"
    return to_csv(tuple(columns), rows, comment)
