"""Oven heating against closed forms and an independent finite-element model in three dimensions."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy

import tubeopt
from tubeopt.constants import STEFAN_BOLTZMANN, ZERO_CELSIUS
from tubeopt.errors import InputError
from tubeopt.shaping import CALCIUM_SILICATE, STEEL
from tubeopt.shaping.heating.oven import CELLS, POINTS, Medium, MoldBlock, Oven, OvenStatus, plan_oven, warming
from tubeopt.shaping.heating.rig import MoldBed

TUBE = tubeopt.load_rig("thesis_steel").tube
SLAB = MoldBed(material=STEEL, width=0.1, thickness=25.4e-3)
"""Two half-inch plates of 5.5 kg with a length of 275 mm: the steel mold of the thesis."""


def oven(**changes: object) -> Oven:
    """Oven at 525 degC with the steel slab."""
    return replace(Oven(ZERO_CELSIUS + 525.0, mold=SLAB, mold_length=0.275), **changes)


def fourier(place: float, half: float, diffusivity: float, conductivity: float, transfer: float, time: float) -> float:
    """Temperature, 1 at first and 0 around, at `place` of a plate of half thickness `half` with convection."""
    biot = transfer * half / conductivity
    # The roots of z tan z = Bi: one in each interval (k pi, k pi + pi / 2).
    roots = [
        scipy.optimize.brentq(lambda z: z * math.tan(z) - biot, k * math.pi + 1e-9, (k + 0.5) * math.pi - 1e-9)
        for k in range(80)
    ]
    return sum(
        4 * math.sin(z) / (2 * z + math.sin(2 * z)) * math.exp(-(z**2) * diffusivity * time / half**2)
        * math.cos(z * place / half)
        for z in roots
    )  # fmt: skip


@pytest.mark.parametrize(("material", "after"), [(STEEL, 240.0), (CALCIUM_SILICATE, 900.0)])
def test_salt_bath_is_product_of_three_plates(material, after):
    material = replace(material, heat_capacity_slope=0.0, conductivity_curve=())
    bath = oven(method="salt_bath", mold=replace(SLAB, material=material))
    block = MoldBlock(bath, TUBE)
    start = np.full(block.volume.size + POINTS, bath.ambient)
    _, states = block.run(start, Medium(bath.set_temperature, 600.0, 0.0), after)
    middle = number_of_middle(block)
    expected = math.prod(
        fourier(place, size / 2, material.diffusivity, material.conductivity, 600.0, after)
        for place, size in zip((block.middles[0][0], block.middles[1][0], 0.0), block.size, strict=True)
    )
    relative = (bath.set_temperature - states[-1, middle]) / (bath.set_temperature - bath.ambient)
    assert relative == pytest.approx(expected, rel=0.01)


def number_of_middle(block: MoldBlock) -> int:
    """Cell at the middle of the mold."""
    return int(np.ravel_multi_index((0, 0, CELLS[2] // 2), CELLS))


def elements(size: float, count: int) -> tuple[scipy.sparse.csr_array, scipy.sparse.csr_array]:
    """Mass and stiffness matrices of linear elements on a line."""
    h = size / count
    ends = np.ones(count + 1)
    ends[[0, -1]] = 0.5
    mass = scipy.sparse.diags_array(
        [np.full(count, h / 6), ends * 2 * h / 3, np.full(count, h / 6)], offsets=[-1, 0, 1]
    )
    slope = scipy.sparse.diags_array([np.full(count, -1 / h), ends * 2 / h, np.full(count, -1 / h)], offsets=[-1, 0, 1])
    return mass.tocsr(), slope.tocsr()


def finite_elements(mold: Oven, step: float, until: float, count: tuple[int, int, int] = (6, 6, 6)) -> np.ndarray:
    """Temperature of the middle of a mold over time, K: trilinear elements on an eighth, implicit Euler."""
    material, size = mold.mold.material, np.array([mold.mold_length, mold.mold.width, mold.mold.thickness]) / 2
    (mx, kx), (my, ky), (mz, kz) = (elements(s, c) for s, c in zip(size, count, strict=True))
    kron = scipy.sparse.kron
    stiffness = material.conductivity * (kron(kron(kx, my), mz) + kron(kron(mx, ky), mz) + kron(kron(mx, my), kz))
    volume = np.asarray(kron(kron(mx, my), mz).sum(1)).ravel()
    tips = [scipy.sparse.diags_array((np.arange(c + 1) == c).astype(float)) for c in count]
    faces = kron(kron(tips[0], my), mz) + kron(kron(mx, tips[1]), mz) + kron(kron(mx, my), tips[2])
    area = np.asarray(faces.sum(1)).ravel()
    field, wall, middle = np.full(volume.size, mold.ambient), mold.set_temperature, []
    for _ in range(round(until / step)):
        before = field
        for _ in range(6):
            slope = material.heat_capacity_slope * (field - material.reference_temperature)
            capacity = material.density * material.heat_capacity * (1 + slope) * volume
            flux = mold.transfer_coefficient * (wall - field)
            flux = flux + mold.emissivity * STEFAN_BOLTZMANN * (wall**4 - field**4)
            by_own = mold.transfer_coefficient + 4 * mold.emissivity * STEFAN_BOLTZMANN * field**3
            residual = capacity * (field - before) / step + stiffness @ field - area * flux
            matrix = scipy.sparse.diags_array(capacity / step + area * by_own) + stiffness
            field = field - scipy.sparse.linalg.spsolve(matrix.tocsc(), residual)
        middle.append(field[0])
    return np.array(middle)


@pytest.mark.parametrize(
    "changes",
    [{}, {"mold": replace(SLAB, material=CALCIUM_SILICATE)}, {"method": "furnace", "mold": replace(SLAB, width=0.06)}],
)
def test_soak_time_agrees_with_finite_elements(changes):
    question = oven(uniformity=0.0, **changes)
    plan = plan_oven(replace(TUBE, curved_length=0.05), question, hold_time=1.0)
    step = plan.warm_time / 30
    # Richardson: implicit Euler is of first order.
    coarse, fine = (
        np.interp(
            500.0,
            values := finite_elements(question, s, 1.2 * plan.warm_time) - ZERO_CELSIUS,
            s * np.arange(1, 1 + len(values)),
        )
        for s in (step, step / 2)
    )
    # Points of a short curve are near the middle, which is coldest.
    assert plan.warm_time == pytest.approx(2 * fine - coarse, rel=0.02)


def test_weak_oven_heats_at_its_power():
    block = MoldBlock(oven(), TUBE)
    cells = block.volume.size
    weak = Medium(ZERO_CELSIUS + 525.0, 10.0, 0.79, power=400.0)
    _, states = block.run(np.full(cells + POINTS, 298.15), weak, 2000.0)
    assert block.stored(states[-1, :cells], 298.15) == pytest.approx(400.0 * 2000.0, rel=1e-3)


def test_heat_of_mold_is_heat_through_faces():
    question = oven()
    block = MoldBlock(question, TUBE)
    cells = block.volume.size
    medium = Medium(question.set_temperature, question.transfer_coefficient, question.emissivity)
    time, states = block.run(np.full(cells + POINTS, question.ambient), medium, 900.0)
    flow = [4 * block.from_medium(state[:cells], medium)[0].sum() for state in states]
    assert np.trapezoid(flow, time) == pytest.approx(block.stored(states[-1, :cells], question.ambient), rel=2e-3)


def test_soak_time_does_not_depend_on_mesh():
    question = oven(mold=replace(SLAB, material=CALCIUM_SILICATE))
    medium = Medium(question.set_temperature, question.transfer_coefficient, question.emissivity)
    reached = []
    for cells in (CELLS, (12, 12, 21)):
        block = MoldBlock(question, TUBE, cells)
        start = np.full(block.volume.size + POINTS, question.ambient)
        time, _ = block.run(start, medium, 2e4, lambda points: points.min() - ZERO_CELSIUS - 500.0)
        reached.append(time[-1])
    assert reached[0] == pytest.approx(reached[1], rel=0.01)


def test_tube_lags_behind_groove_by_its_time_constant():
    block = MoldBlock(oven(), TUBE)
    cells = block.volume.size
    hot = np.concatenate([np.full(cells, 800.0), np.full(POINTS, 300.0)])
    # At the temperature of the mold nothing flows into it: only the tube warms.
    time, states = block.run(hot, Medium(800.0, 20.0, 0.8), 3.0)
    expected = 800.0 - 500.0 * np.exp(-time / block.lag)
    assert states[:, cells] == pytest.approx(expected, abs=0.2)
    assert 0.01 < block.lag < 3.0


def test_a_small_block_of_metal_warms_as_one_temperature():
    """Scalar balance of convection and radiation on all faces of a cuboid, whose conduction is far quicker."""
    sides, wire = (40e-3, 30e-3, 20e-3), tubeopt.Tube(1e-3, 0.8e-3, 0.0, 4e-3, 0.0)
    oven = Oven(
        525 + ZERO_CELSIUS, method="furnace", mold=MoldBed(STEEL, width=sides[1], thickness=sides[2]), mold_length=40e-3
    )
    area = 2 * (sides[0] * sides[1] + sides[1] * sides[2] + sides[0] * sides[2])

    def rate(_, T):
        flux = 10.0 * (oven.set_temperature - T) + STEEL.emissivity * STEFAN_BOLTZMANN * (
            oven.set_temperature**4 - T**4
        )
        capacity = STEEL.heat_capacity * (1 + STEEL.heat_capacity_slope * (T - STEEL.reference_temperature))
        return area * flux / (STEEL.density * np.prod(sides) * capacity)

    goals = np.array([400.0, 500.0]) + ZERO_CELSIUS
    T = scipy.integrate.solve_ivp(rate, (0, 7200), [oven.ambient], rtol=1e-8, dense_output=True)
    times = [scipy.optimize.brentq(lambda t, goal=goal: T.sol(t)[0] - goal, 1.0, 7200.0) for goal in goals]
    warm = warming(oven, wire, goals[1])
    assert warm.time == pytest.approx(times[1], rel=0.02)
    assert warm.ageing == pytest.approx(times[1] - times[0], rel=0.02)
    assert warming(oven, wire, 530 + ZERO_CELSIUS).time == math.inf


def test_radius_follows_from_both_expansions():
    plan = plan_oven(TUBE, oven())
    rise = plan.course.hottest[plan.course.time <= plan.soak_time][-1] - 25.0
    thermal = TUBE.material.thermal
    assert plan.hot_radius == pytest.approx(0.12 * (1 + 14.2e-6 * rise), rel=1e-6)
    assert plan.cold_radius == pytest.approx(plan.hot_radius / (1 + thermal.expansion * rise), rel=1e-6)
    # Milled at this radius, the cold tube has the radius of the drawing.
    assert plan.groove_radius * plan.cold_radius == pytest.approx(0.12**2, rel=1e-12)
    assert plan.cold_radius - 0.12 == pytest.approx(0.19e-3, abs=0.01e-3)


def test_floor_makes_soak_longer_and_board_longer_still():
    rack, floor = plan_oven(TUBE, oven()), plan_oven(TUBE, oven(on_floor=True))
    assert 1.2 * rack.warm_time < floor.warm_time < 1.9 * rack.warm_time
    assert rack.status is OvenStatus.HELD
    assert rack.soak_time == pytest.approx(rack.warm_time + 600.0)
    assert rack.first_time < rack.warm_time


def test_quench_out_of_mold_is_exponential():
    plan = plan_oven(TUBE, oven(transfer_time=0.0))
    data = TUBE.material.thermal
    wall = (1.92e-3**2 - 1.57e-3**2) / (4 * 1.92e-3)
    tau = data.density * data.heat_capacity * wall / 2000.0
    hottest = plan.course.hottest[plan.course.time <= plan.soak_time][-1]
    assert plan.quench_time == pytest.approx(tau * math.log((hottest - 25.0) / 75.0), rel=1e-3)


@pytest.mark.parametrize(("quench", "least"), [("water_in_mold", 10.0), ("air", 600.0)])
def test_quench_in_mold_is_slow_and_said(quench, least):
    plan = plan_oven(TUBE, oven(quench=quench))
    assert plan.quench_time > least
    assert plan.course.hottest[-1] == pytest.approx(100.0, abs=0.1)
    assert any("Af" in remark for remark in plan.remarks) == (quench == "air")


def test_transfer_cools_mold_in_air():
    plan = plan_oven(TUBE, oven(transfer_time=60.0))
    assert plan.course.coldest[plan.course.time <= plan.soak_time][-1] - 30.0 < plan.quench_start
    assert plan.quench_start < plan.course.coldest[plan.course.time <= plan.soak_time][-1] - 5.0


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"set_temperature": ZERO_CELSIUS + 500.0}, "494 degC"),
        ({"set_temperature": ZERO_CELSIUS + 555.0}, "set the oven at 544 degC at most"),
        ({"uniformity": 30.0}, "too narrow for an oven that is off by up to 30 K"),
        ({"set_temperature": ZERO_CELSIUS + 568.0}, "scales quickly above 570 degC"),
        ({"heating_power": 20.0}, "after 12 h, below the window at 500 degC; the mold weighs 5.5 kg: 20 W are too"),
        ({"mold": replace(SLAB, width=1.0, thickness=1.0), "mold_length": 2.0}, "15740.0 kg: use thinner plates"),
        ({"set_temperature": ZERO_CELSIUS + 450.0}, "set it above 506 degC and below 544 degC"),
        ({"method": "salt_bath", "mold": replace(SLAB, material=CALCIUM_SILICATE)}, "soaks up salt"),
    ],
)
def test_impossible_oven_is_refused_with_reason(changes, words):
    plan = plan_oven(TUBE, oven(**changes), hold_time=900.0)
    assert plan.status is OvenStatus.MISSED
    assert words in "; ".join(plan.problems)


@pytest.mark.parametrize(
    ("changes", "window", "words"),
    [
        ({}, (550.0, 500.0), "window_degC is 550 to 500 degC"),
        ({"mold_length": 0.05}, (500.0, 550.0), "mold_length is 50 mm"),
        ({"mold": replace(SLAB, width=5e-3)}, (500.0, 550.0), "width of the mold is 5 mm"),
    ],
)
def test_bad_input_names_field_and_value(changes, window, words):
    with pytest.raises(InputError, match=words):
        plan_oven(TUBE, oven(**changes), window_degC=window)


def test_window_narrower_than_oven_is_the_only_problem():
    plan = plan_oven(TUBE, oven(uniformity=30.0))
    assert plan.problems == ("the window of 500 to 550 degC is too narrow for an oven that is off by up to 30 K",)


def test_metal_without_recipe_is_refused():
    steel = replace(TUBE.material, name="steel_304", youngs_modulus=193e9, shear_modulus=77e9)
    with pytest.raises(InputError, match=r"steel_304.*heat recipes exist for nitinol only"):
        plan_oven(replace(TUBE, material=steel), oven())


def test_oven_refuses_unknown_method_and_hot_setting():
    with pytest.raises(InputError, match="method"):
        oven(method="torch")
    with pytest.raises(InputError, match="set_temperature"):
        oven(set_temperature=ZERO_CELSIUS + 1200.0)
