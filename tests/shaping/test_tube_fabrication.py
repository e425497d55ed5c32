"""Mold and heating of one tube belong together: the schedule holds the window on the mold that is drawn."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from benchmarks.rig_thermal import Bench
from tubeopt import Feedback, HeatingPlan, HeatingSpec, InputError, MoldSpec, Rig, Thermocouple, Tube, load_robot
from tubeopt.shaping import Springback, tube_fabrication
from tubeopt.shaping.clamp_body import clamp_body
from tubeopt.shaping.heating.controller import HeatingLaw
from tubeopt.shaping.heating.plan import left_in_mold
from tubeopt.shaping.heating.robust import SHORTEST_BARE, longest_bare_tube
from tubeopt.shaping.heating.sensors import WIRES, equipped, thermocouple_for, wire_dip
from tubeopt.shaping.heating.thermal import (
    FINE,
    GrooveAir,
    curved_temperatures,
    thermal_model,
    uniform_gap,
    uniform_gap_of,
)
from tubeopt.shaping.heating.thermocouple import reading_error
from tubeopt.shaping.materials import mold_material
from tubeopt.shaping.mold.gcode import groove_gcode, read_gcode
from tubeopt.shaping.mold.layout import open_area
from tubeopt.shaping.mold.mold import Clamp, clamp_corners, plan_mold, plan_robot_mold
from tubeopt.shaping.mold.spec import ClampSpec, PlateSpec, VentSpec
from tubeopt.shaping.tube_fabrication import TubeFabrication, drawn_vents, mold_spec_for, plan_tube, rig_as_drawn
from tubeopt.show.plots.clamps import clamp_steps
from tubeopt.show.plots.sheets import (
    groove_numbers,
    heating_numbers,
    mold_steps,
    plot_fabrication_sheet,
    preparation,
    running,
    safety,
    time_line,
)

from .heating_reference import TUBE, integrate, thesis_plan, thesis_rig, with_mold

SHORT = HeatingSpec(hold_time=5)


def drawn_again(made: TubeFabrication, rig: Rig) -> tuple[Tube, Rig]:
    """Tube and rig with the numbers of the drawing, taken from its centreline."""
    groove = made.groove
    curve = groove.centreline
    bed = replace(rig.mold, lead=curve.lead_in.length, gap=_even_gap(groove.width, groove.depth))
    clamps = replace(rig.clamps, clearance=float(np.hypot(*np.subtract(groove.clamps[0].face, curve.lead_in.start))))
    return replace(groove.tube, curved_length=curve.bend_length), replace(rig, mold=bed, clamps=clamps)


def _even_gap(width: float, depth: float) -> float:
    """Of calcium silicate, whose conductivity its maker gives, and air at 275 degC: Incropera et al., Table A.4."""
    return uniform_gap(
        TUBE.outer_diameter, GrooveAir.tube_on_floor_and_wall(TUBE.outer_diameter, width, depth), 0.12 / 0.0436
    )


def test_the_schedule_holds_the_window_on_the_mold_as_drawn() -> None:
    """Plate and lid apart, which hardly warm up, everything of the rig as given but what the drawing says."""
    rig = thesis_rig()
    made = plan_tube(TUBE, rig, MoldSpec(springback=Springback(0.08, shrinkage=0.005)), SHORT)
    assert made.agreed
    assert made.marked_mold == made.mold
    assert made.heating.feasible
    tube, drawn = drawn_again(made, rig)
    between = 2 * (drawn.clamps.clearance + drawn.mold.lead) + tube.curved_length
    assert made.groove.free_length == pytest.approx(between, abs=1e-6)
    assert made.heating.free_length == pytest.approx(between, abs=1e-5)
    assert drawn.mold.gap == pytest.approx(made.rig.mold.gap, rel=0.02)
    assert made.rig.mold.side_clearance == pytest.approx(rig.mold.play)
    plan, low, high = made.heating, *SHORT.window_degC
    model = thermal_model(tube, drawn, replace(FINE, clearance=8, lead=18, curved=24, shells=18))
    history = integrate(model, SHORT.slot, plan.duty[:-1] / 255, rtol=1e-5)
    held = curved_temperatures(model, history.tube[plan.in_hold, 0]) - 273.15
    assert low <= held.min() <= held.max() <= high
    # With the leads of the rig's file the tube would be another one.
    given = integrate(thermal_model(TUBE, rig, FINE), SHORT.slot, plan.duty[:-1] / 255)
    assert given.tube.max() - 273.15 > high + 50


def test_the_sheet_tells_what_is_seen_at_the_rig() -> None:
    plan = thesis_plan()
    model = thermal_model(TUBE, thesis_rig(), FINE)
    history = integrate(model, plan.spec.slot, plan.duty[:-1] / 255, rtol=1e-5)
    middle = history.tube[:, 0, -1] - 273.15
    told = [re.match(r"([\d.]+) s: .*?([\d.]+) °C", line) for line in time_line(made_of(plan))]
    seen = [(float(found[1]), float(found[2])) for found in told if found]
    assert len(seen) == 5
    for time, value in seen:
        assert value == pytest.approx(np.interp(time, plan.time, middle), abs=1.5)
    current = heating_numbers(made_of(plan))["current while on / rms of 10 s (A)"]
    assert float(current.split(" / ")[0]) == pytest.approx(plan.current.max(), abs=0.5)
    words = " ".join(preparation(made_of(plan)) + safety(plan))
    assert f"{plan.rig.battery.voltage:.2f} V" in words
    assert f"With pulses of {plan.rig.circuit.pwm_frequency:.4g} Hz it takes" in words
    assert any("main switch off, clamps and bolts off" in line for line in time_line(made_of(plan)))
    assert "Polarity: battery plus, fuse, main switch, cut-out, current sensor, proximal clamp" in words


def test_the_jaws_of_a_clamp_spare_the_wall() -> None:
    """Force by the equilibrium of half a ring: two walls carry what the jaw presses, at 100 MPa."""
    groove = plan_mold([TUBE]).grooves[0]
    (newton,) = re.findall(r"Press by at most (\d+) N", " ".join(mold_steps(plan_mold([TUBE]))))
    wall = 0.5 * (TUBE.outer_diameter - TUBE.inner_diameter)
    assert float(newton) / (2 * wall * groove.grip) == pytest.approx(100e6, rel=0.01)


def test_a_clamp_is_drawn_with_the_mass_and_the_area_of_its_plan() -> None:
    """Volume and area by a solid; the screws by moments about the shim; a small mass is told to be too small."""
    solids = pytest.importorskip("manifold3d")
    made = made_of(thesis_plan())
    body = clamp_body(made.groove.tube, made.mold.spec.clamps, made.rig.clamps)
    spec, (long, wide) = body.nose, (1e3 * body.length, 1e3 * body.width)
    outline = 1e3 * clamp_corners(Clamp("distal", (0.0, 0.0), (1.0, 0.0), 0.0), spec)
    nose = solids.CrossSection([outline]).extrude(12.0).translate((0.0, 0.0, 6.0))
    block = solids.Manifold.cube((long, wide, 24.0)).translate((1e3 * body.grip, -wide / 2, 0.0))
    solid = nose + block
    assert solid.volume() * 2.7e-6 == pytest.approx(made.rig.clamps.mass, rel=1e-6)
    assert 1e-6 * (solid.surface_area() - long * wide) == pytest.approx(body.area, rel=1e-6)
    assert body.area == pytest.approx(made.rig.clamps.area, rel=0.1)
    newton, rear = body.torque / (0.2 * 4e-3), body.grip + body.length - 2e-3
    on_nose = 2 * newton * (rear - body.grip - 6e-3) / (rear - body.grip / 2)
    assert on_nose == pytest.approx(100e6 * (TUBE.outer_diameter - TUBE.inner_diameter) * body.grip)
    steps = " ".join(clamp_steps(made, body))
    assert f"{1e3 * TUBE.outer_diameter / 2 - 0.1:.2f} mm deep" in steps
    light = clamp_body(body.tube, spec, replace(made.rig.clamps, mass=5e-3))
    assert light.mass > 20e-3
    few = replace(made, rig=replace(made.rig, clamps=replace(made.rig.clamps, mass=5e-3)))
    assert "Heavier than planned" in " ".join(clamp_steps(few, light))
    assert "Heavier than planned" not in steps


def test_the_sheet_of_an_unlikely_heating_says_do_not_run() -> None:
    """At its top, with the reason; a sheet without faults does not say so."""
    for faults in ([], ["9 % of rigs keep the window"]):
        figure = plot_fabrication_sheet(made_of(thesis_plan()), faults=faults)
        texts = {text.get_text(): text.get_position()[1] for text in figure.texts}
        top = texts.get("DO NOT RUN THIS HEATING", 0.0)
        assert (top > 0.9) == any("9 % of rigs" in text for text in texts) == bool(faults)


def test_the_sheet_says_which_readings_the_board_shows() -> None:
    """At a slot of the schedule: the reading that is planned, and how far and how late uncertain rigs are."""
    index = np.array([[0, 0, 0], [1, 1, 0], [2, 1, 1], [3, 2, 1], [3, 3, 1]])
    reading = np.array([[25.0, 25, 25], [40, 38, 25], [60, 50, 26], [80, 71, 26], [90, 82, 26]])
    held = thesis_plan()
    law = HeatingLaw(0.5, np.full(4, 9.0), np.array([25.0, 41, 62, 82]), (3, 4), 0.01, 0.01, bare_count=20.0, share=2.0)
    history = Mock(index=index, reading=reading, finished=np.array([True, True, False]))
    rows: Any = dict.fromkeys(("uncertainty", "contributions"))
    zeros = np.zeros(2)
    feedback = Feedback(Thermocouple(), law, history=history, lowest=zeros, highest=zeros, top=zeros, kept=zeros > 0,
                        open_loop=0.0, window=(500.0, 550.0), limit=550.0, **rows)  # fmt: skip
    assert feedback.expected(2) == (62.0, 9.0, 0.5)
    assert feedback.expected(0) == (25.0, 0.0, 0.0)
    steps = " ".join(running(made_of(replace(held, feedback=feedback))))
    # 20 of 9 counts.
    assert "multiplies the counts of the table by 0.0 to 2.2, with at most 20 of 255" in steps
    on_average = float(re.findall(r"On average ([\d.]+) A", " ".join(safety(held)))[0])
    used = (held.charge[0] - held.charge[-1]) * held.rig.battery.capacity
    assert on_average == pytest.approx(used / held.hold_end, abs=0.06)


def test_the_sheet_names_the_board_and_its_drying() -> None:
    """A board with its data and a drying; no drying of steel."""
    plan = thesis_plan()
    words = " ".join(preparation(made_of(plan)))
    assert "737 kg/m3, 0.117 W/(m K)" in words
    assert "Dry the mold for 2 h at 110 to 150" in words
    steel = replace(plan.rig, mold=replace(plan.rig.mold, material=mold_material("steel")))
    assert "Board" not in " ".join(preparation(made_of(replace(plan, rig=steel))))


def made_of(plan: HeatingPlan) -> TubeFabrication:
    """The plan with a mold of its tube."""
    return TubeFabrication(TUBE, plan_mold([TUBE]), plan.rig, plan, 1, "")


def test_the_mold_takes_what_the_heating_knows() -> None:
    made = plan_tube(TUBE, thesis_rig(), None, SHORT, number=3)
    groove, plan, heat = made.groove, made.heating, made.mold.spec.heat
    assert groove.number == 3
    assert groove.growth == pytest.approx(plan.growth, abs=1e-6)
    assert groove.cold.length == pytest.approx(plan.cold_end, abs=1e-6)
    assert groove.extra_length == pytest.approx(plan.extra_length, abs=1e-5)
    assert (heat.set_temperature - heat.tolerance, heat.hold_time) == (pytest.approx(773.15), 5.0)
    assert heat.clamps == pytest.approx(273.15 + float(np.interp(plan.hold_end, plan.time, plan.clamp_temperature)))


def test_a_plate_too_small_for_the_leads_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """The cold ends reach into the bend, and longer leads leave the plate."""

    def cold(tube: Tube, rig: Rig, spec: HeatingSpec) -> HeatingPlan:
        plan = thesis_plan()
        course = replace(plan.course, temperature=plan.temperature - 18.0)
        return replace(
            plan, tube=tube, rig=rig, spec=spec, course=course, outcome=replace(plan.outcome, shortfall=18.0)
        )

    monkeypatch.setattr(tube_fabrication, "plan_heating", cold)
    rig = with_mold(thesis_rig(), lead=3e-3, gap=50e-6)
    plate = PlateSpec(size=(0.1, 0.05), bolt_diameter=3e-3, dowel_diameter=2e-3)
    made = plan_tube(TUBE, rig, MoldSpec(plate=plate, clamps=ClampSpec(least_lead=2e-3)), SHORT)
    assert not made.heating.feasible
    assert not made.agreed
    assert "mm from clamp to bend, the mold has" in made.disagreement
    assert "does not fit on the plate" in made.disagreement
    assert made.marked_mold.remarks[0] == f"do not mill this mold: {made.disagreement}"
    assert "gap_um of the rig file is 50 um" in made.remarks[0]
    assert "50 um on each side of this tube has a uniform gap of 8" in made.remarks[0]


def test_an_even_gap_from_a_log_goes_along_with_the_groove() -> None:
    """What a log said is 0.9 of the computed one stays that in another groove; what is not said is computed."""
    mold = plan_mold(TUBE)
    groove = mold.grooves[0]
    rig = with_mold(thesis_rig(), side_clearance=50e-6)
    computed = rig_as_drawn(rig, mold).mold
    assert computed.gap == pytest.approx(_even_gap(groove.width, groove.depth), rel=0.02)
    assert computed.side_clearance == pytest.approx(40e-6)
    said = rig_as_drawn(with_mold(rig, gap=0.9 * uniform_gap_of(TUBE, rig)), mold).mold
    assert said.gap == pytest.approx(0.9 * computed.gap)


def test_vents_are_heated_as_they_are_drawn() -> None:
    """Their area, over the tube's surface: holes of the lid bare the upper half of the tube below them."""
    spec = MoldSpec(vents=VentSpec(1.5e-3, (0.2, 0.4, 0.2)))
    mold = plan_mold(TUBE, spec)
    groove = mold.grooves[0]
    vents = np.array(drawn_vents(groove, spec))
    lead, half = groove.centreline.lead_in.length, groove.bend_length / 2
    along = np.linspace(0.0, lead + half, len(vents))
    assert (vents[along < lead - 1e-3] == 0).all()
    area = 2 * np.trapezoid(vents, along) * np.pi * TUBE.outer_diameter
    # Half of the surface below a hole, of which the groove's width sees the diameter.
    holes = len(groove.vents) * open_area(groove.width, 1.5e-3) / groove.width
    assert area == pytest.approx(holes * np.pi * TUBE.outer_diameter / 2, rel=0.03)
    assert rig_as_drawn(thesis_rig(), mold).mold.vents == tuple(vents.tolist())


def test_a_hole_opens_of_a_groove_what_lies_between_its_walls() -> None:
    assert open_area(2e-3, 1.5e-3) == pytest.approx(np.pi / 4 * 1.5e-3**2)
    x = np.linspace(-0.75e-3, 0.75e-3, 200001)
    chord = np.minimum(2 * np.sqrt(0.75e-3**2 - x**2), 1e-3)
    assert open_area(1e-3, 1.5e-3) == pytest.approx(np.trapezoid(chord, x), rel=1e-6)


def test_a_tube_that_draws_too_much_gets_longer_leads() -> None:
    """The current through the cold tube, by Ohm's law, just below what the circuit bears; without it, above."""
    rig, tube = thesis_rig(), replace(TUBE, outer_diameter=2.25e-3, inner_diameter=1.4e-3, curved_length=40e-3)
    made = plan_tube(tube, rig, heating=SHORT)
    assert made.agreed

    def drawn(length: float) -> float:
        section = 0.25 * np.pi * (tube.outer_diameter**2 - tube.inner_diameter**2)
        thermal = tube.material.thermal
        assert thermal is not None
        ohm = rig.resistivity_factor * thermal.resistivity * length / section
        return rig.battery.voltage / (rig.battery.internal_resistance + rig.circuit.resistance + ohm)

    assert 0.95 * rig.circuit.peak_limit < drawn(made.heating.free_length) < rig.circuit.peak_limit
    least = tube.curved_length + 2 * (rig.mold.lead + rig.clamps.clearance)
    assert drawn(least) > 1.05 * rig.circuit.peak_limit
    assert made.heating.peak_current < rig.circuit.peak_limit


def test_a_thin_wall_gets_clamps_close_to_the_plate() -> None:
    """Per length a mold takes up to three times the planned power, and the bare tube beside it gets all of it.

    With both ends cold, it is hottest in its middle: P l^2 / (8 k A) above them, less what air takes. A wall of a third
    of the section bears a shorter bare tube; thick ones keep the given one.
    """
    rig = thesis_rig()
    thin = replace(TUBE, outer_diameter=1.0e-3, inner_diameter=0.9e-3)
    made = plan_tube(thin, rig, heating=SHORT)
    assert made.agreed
    bare = made.rig.clamps.clearance
    assert SHORTEST_BARE <= bare < 0.7 * rig.clamps.clearance
    assert f"clamps {1e3 * bare:.1f} mm from the plate in place of 5 mm" in made.remarks[0]
    assert max(made.groove.gaps) == pytest.approx(bare)
    hot = bare + made.heating.growth
    # Without the growth it keeps the limit, and half as long again it does not: then the growth is said.
    for length, keeps in ((bare, True), (1.5 * hot, False)):
        longer = replace(made.heating, rig=replace(made.rig, clamps=replace(made.rig.clamps, clearance=length)))
        longest = longest_bare_tube(longer, Thermocouple())
        assert math.isinf(longest) == keeps
    (said,) = re.findall(r"clamp to ([\d.]+) mm, and at most ([\d.]+) mm keep", " ".join(made.remarks))
    assert [float(number) for number in said] == pytest.approx([1e3 * hot, 1e3 * longest], abs=0.25)
    # A thick wall has room for the growth.
    thick = plan_tube(TUBE, rig, heating=SHORT)
    grown = thick.rig.clamps.clearance + thick.heating.growth
    assert 0.9 * rig.clamps.clearance < grown < rig.clamps.clearance + thick.heating.growth
    assert not any("the growth opens the gap" in text for text in thick.remarks)
    longer = replace(thick.heating, rig=replace(thick.rig, clamps=replace(thick.rig.clamps, clearance=grown)))
    assert longest_bare_tube(longer, Thermocouple()) == math.inf
    # Wide clamps do not come that close to a plate that the tube leaves at an angle.
    bent = replace(thin, curved_length=0.2, curvature=10.0)
    wide = plan_tube(bent, rig, MoldSpec(clamps=ClampSpec(nose=15e-3)), SHORT)
    assert "Make the face of the clamps narrower (nose_mm)" in wide.disagreement
    assert not wide.agreed


def test_no_current_heats_what_is_no_metal() -> None:
    nylon = replace(TUBE.material, name="nylon", youngs_modulus=2e9, shear_modulus=0.7e9, thermal=None)
    with pytest.raises(InputError, match=r"nylon has no thermal constants, and its Young's modulus of 2 GPa"):
        plan_tube(replace(TUBE, material=nylon), thesis_rig(), heating=SHORT)


def test_programs_aim_at_the_middle_of_the_limits_and_leave_room_for_the_tube() -> None:
    """By the paths of the cutter in the program, and the limits of the sheet."""
    mold = plan_mold([TUBE])
    groove, numbers = mold.grooves[0], groove_numbers(mold.grooves[0], mold)
    cuts = [m for m in read_gcode(groove_gcode(mold)) if m.feed is not None and m.piece.length > 0]
    offsets = groove.cutter_offsets
    cut = {"width": groove.mill.diameter + max(offsets) - min(offsets), "depth": -min(m.end for m in cuts)}
    for name, size in cut.items():
        low, high = (1e-3 * float(x) for x in numbers[f"limits of its {name}"].split(" to "))
        assert 0.5 * (low + high) == pytest.approx(size, abs=1e-6)
        assert TUBE.outer_diameter + 20e-6 < low < size - 20e-6


def test_the_sheet_says_until_when_a_quench_helps() -> None:
    left = left_in_mold(thesis_plan())
    (line,) = [line for line in time_line(made_of(thesis_plan())) if "latest quench" in line]
    assert f"latest quench: {left.latest:.1f} s after the hold" in line
    assert "optional" in line
    assert "measure its Af" in line


def test_equal_tubes_are_made_in_one_mold() -> None:
    found = plan_robot_mold(load_robot("thesis_etr"))
    assert (found.made, found.making) == ((3,), ", make 3")
    assert plan_robot_mold(load_robot("two_tube")).making == ""


def test_a_thin_wall_takes_thin_wires_in_plan_slot_and_parts() -> None:
    """Wires as thick as for a strong tube would cool its middle by a third of the window, which no board sees."""
    rig, thin, thick = thesis_rig(), load_robot("thesis_ctr").tubes[0], TUBE
    assert thermocouple_for(thick, rig) == Thermocouple()
    sensor = thermocouple_for(thin, rig)
    assert sensor.wire == 0.13e-3
    low, high = reading_error(sensor.wire, sensor.anchor, 525.0, 25.0)
    assert (sensor.correction, sensor.bias) == pytest.approx((-0.5 * (low + high), 0.5 * (high - low)), abs=0.05)
    kept = equipped(rig, replace(Thermocouple(), wire=0.2e-3))
    assert thermocouple_for(thin, kept).wire == 0.2e-3
    spec = mold_spec_for(equipped(rig, sensor), thin, MoldSpec(), SHORT, None, rig)
    assert spec.slot.wire == sensor.wire


@pytest.mark.parametrize("wire", WIRES)
def test_the_estimated_dip_by_the_wires_is_that_of_a_simulated_hold(wire: float) -> None:
    plan = replace(thesis_plan(), rig=equipped(thesis_rig(), replace(Thermocouple(), wire=wire)))
    bench = Bench(plan.tube, plan.rig)
    for count in plan.duty[: round(plan.hold_end / plan.spec.slot)]:
        hot = bench.pass_time(float(count), plan.spec.slot)[-1]
    assert hot.max() - hot[-1] == pytest.approx(wire_dip(plan.tube, plan.rig, wire), rel=0.4, abs=1.0)
