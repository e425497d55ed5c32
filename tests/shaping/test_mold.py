"""The plan of a mold: geometry, spring-back, cold ends, clamps, nesting, holes, and what is refused."""

from __future__ import annotations

import itertools
import math
import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

import tubeopt
from tubeopt import InputError, MoldSpec, Tube, plan_mold, predict_tube
from tubeopt.shaping import (
    Clamp,
    ClampSpec,
    EndMill,
    Groove,
    GrooveSpec,
    HeatSpec,
    MillingSpec,
    Mold,
    PlateSpec,
    Springback,
    VentSpec,
    predict_tubes,
)
from tubeopt.shaping.mold.groove import Centreline, polygon

THESIS = Tube(1.92e-3, 1.57e-3, 0.0, 94e-3, 1 / 120e-3)
PAIR = (Tube(1.6e-3, 1.1e-3, 20e-3, 80e-3, 25.0), Tube(2.1e-3, 1.8e-3, 0.3, 120e-3, -20.0))


def points(curve: Centreline, step: float = 1e-4) -> np.ndarray:
    """Points of a centreline from its tangents alone: integrated, not read off the pieces."""
    at = [np.asarray(curve.lead_in.start)]
    for piece in curve.pieces:
        count = max(2, math.ceil(piece.length / step))
        middle = (np.arange(count) + 0.5) * piece.length / count
        at += list(at[-1] + np.cumsum(piece.tangent(middle), axis=0) * piece.length / count)
    return np.array(at)


def refused(tubes: Tube | tuple[Tube, ...], spec: MoldSpec) -> str:
    with pytest.raises(InputError) as error:
        plan_mold(tubes, spec)
    return str(error.value)


def test_the_thesis_tube() -> None:
    mold = plan_mold(THESIS)
    (groove,) = mold.grooves
    (bend,) = groove.centreline.bend
    assert bend.radius == pytest.approx(120e-3, abs=1e-12)
    assert bend.length == pytest.approx(94e-3, abs=1e-12)
    assert (groove.width, groove.depth) == pytest.approx((2e-3, 2e-3))
    assert groove.strain == pytest.approx(0.96 / 120)
    assert predict_tube(mold).curvature == pytest.approx(THESIS.curvature, rel=1e-12)
    assert any("not calibrated" in remark for remark in mold.remarks)
    assert all(check.passed for check in mold.checks)
    assert pickle.loads(pickle.dumps(mold)) == mold


@settings(max_examples=40)
@given(
    diameter=st.floats(0.6e-3, 2.9e-3),
    length=st.floats(10e-3, 250e-3),
    turn=st.floats(-2.6, 2.6),
    straight=st.floats(0.0, 0.4),
    fraction=st.floats(-0.05, 0.3),
    slope=st.floats(-5e-4, 5e-4),
)
def test_any_tube(diameter: float, length: float, turn: float, straight: float, fraction: float, slope: float) -> None:
    tube = Tube(diameter, 0.8 * diameter, straight, length, turn / length)
    back = Springback(fraction, slope, shrinkage=0.005)
    if diameter / 2 * abs(tube.curvature) > 0.03:
        return
    groove_turn = abs(back.mold(tube.curvature)) * length / (1 - back.shrinkage)
    if groove_turn > 2.7:  # beyond, leads come together
        return
    mold = plan_mold(tube, MoldSpec(springback=back))
    (groove,) = mold.grooves
    # What comes out is what was asked for.
    again = predict_tube(mold)
    assert again.curvature == pytest.approx(tube.curvature, rel=1e-9, abs=1e-9)
    assert again.curved_length == pytest.approx(length, rel=1e-12)
    assert (again.outer_diameter, again.straight_length) == (diameter, straight)
    # The centreline is one smooth curve, from edge to edge.
    walked = points(groove.centreline)
    assert walked[-1] == pytest.approx(np.asarray(groove.centreline.lead_out.end), abs=1e-6)
    for end in (groove.centreline.lead_in.start, groove.centreline.lead_out.end):
        to_edge = min(end[0], mold.size[0] - end[0], end[1], mold.size[1] - end[1])
        assert to_edge == pytest.approx(0.0, abs=1e-12)
    turned = groove.centreline.lead_in.tangent(np.zeros(1)) @ groove.centreline.lead_out.tangent(np.zeros(1)).T
    assert turned[0, 0] == pytest.approx(math.cos(groove_turn), abs=1e-9)
    assert (walked > -1e-6).all()
    assert (walked < np.asarray(mold.size) + 1e-6).all()
    # The clamps are far enough from the bend, and the tube long enough to reach both.
    for clamp, lead in zip(groove.clamps, (groove.centreline.lead_in, groove.centreline.lead_out), strict=True):
        inner = lead.end if clamp.end == "proximal" else lead.start
        assert math.dist(clamp.face, inner) >= groove.cold.length - 1e-12
        # Its corners are off the plate.
        along, face, jaws = np.asarray(clamp.direction), np.asarray(clamp.face), mold.spec.clamps
        for side in (-1, 1):
            across = side * np.array([-along[1], along[0]])
            # Its face, and 45 deg behind it the shoulders.
            for corner in (
                jaws.face_width / 2 * across,
                jaws.width / 2 * across + (jaws.width - jaws.face_width) / 2 * along,
            ):
                x, y = face + corner
                assert not (0 < x < mold.size[0] and 0 < y < mold.size[1])
    assert groove.stock_length >= groove.free_length + 2 * mold.spec.clamps.grip - 1e-12
    assert groove.stock_length - sum(groove.trim) == pytest.approx(straight + groove.bend_length, rel=1e-12)
    assert min(groove.trim) >= -1e-15
    # The groove takes the tube, and an end mill at hand takes the groove.
    assert groove.width >= diameter + mold.spec.groove.clearance - 1e-12
    assert groove.depth >= diameter + mold.spec.groove.clearance - 1e-12
    assert groove.width <= diameter + mold.spec.groove.most_clearance + 1e-12
    cut = max(groove.cutter_offsets) - min(groove.cutter_offsets) + groove.mill.diameter
    assert cut == pytest.approx(groove.width, abs=1e-12)
    assert all(np.diff(groove.cutter_offsets) <= groove.mill.diameter / 2 + 1e-12)


def test_spring_back_makes_the_mold_tighter() -> None:
    mold = plan_mold(THESIS, MoldSpec(springback=0.08))  # type: ignore[arg-type]
    assert mold.grooves[0].radius == pytest.approx(120e-3 * 0.92, rel=1e-12)
    assert predict_tube(mold, springback=Springback()).curvature == pytest.approx(THESIS.curvature / 0.92)


def apart(first: Groove, second: Groove) -> float:
    a, b = points(first.centreline, 4e-4), points(second.centreline, 4e-4)
    return float(np.linalg.norm(a[:, None] - b[None], axis=2).min())


def test_sides_of_a_plate_are_multiples_of_its_step(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tubeopt.shaping.mold.layout.PLATE_STEP", 20e-3)
    sides = np.array(plan_mold(THESIS).size) / 20e-3
    np.testing.assert_allclose(sides, np.round(sides), atol=1e-9)


@pytest.mark.parametrize("tubes", [PAIR, (THESIS,) * 3, (*PAIR, THESIS), (PAIR[1],) * 2], ids=len)
def test_nested_grooves_keep_their_walls(tubes: tuple[Tube, ...]) -> None:
    mold = plan_mold(tubes, MoldSpec(springback=Springback(0.05)))
    wall = mold.spec.groove.wall
    for first, second in itertools.combinations(mold.grooves, 2):
        assert apart(first, second) > (first.width + second.width) / 2 + wall - 1e-4
    for hole in mold.holes:
        for groove in mold.grooves:
            clear = np.linalg.norm(points(groove.centreline) - hole.centre, axis=1).min()
            assert clear >= (groove.width + hole.diameter) / 2 + wall - 1e-6
        for other in mold.holes:
            if other is not hole:
                assert math.dist(hole.centre, other.centre) >= (hole.diameter + other.diameter) / 2 + wall - 1e-9
        rim = min(*hole.centre, mold.size[0] - hole.centre[0], mold.size[1] - hole.centre[1])
        assert rim >= hole.diameter / 2 + wall - 1e-9
    for tube, out in zip(tubes, predict_tubes(mold), strict=True):
        assert out.curvature == pytest.approx(tube.curvature, rel=1e-12)
    with pytest.raises(InputError, match="grooves; give index"):
        predict_tube(mold)
    with pytest.raises(InputError, match="index is 7"):
        predict_tube(mold, 7)
    assert predict_tube(mold, 1).outer_diameter == tubes[1].outer_diameter


@pytest.mark.parametrize("flat", [3.0, 4.0, 7.0])
def test_a_flatter_groove_stands_a_wall_above_a_sharper_one(flat: float) -> None:
    """Their tops are nearest, where they are set: no step further for a wall that round-off makes smaller."""
    sharp = Tube(1e-3, 0.8e-3, 50e-3, 60e-3, 2 * flat)
    mold = plan_mold([sharp, Tube(1.5e-3, 1.2e-3, 30e-3, 50e-3, flat)])
    (wall,) = (check.value for check in mold.checks if check.name == "least wall between grooves")
    assert wall == pytest.approx(mold.spec.groove.wall, rel=1e-9)


def test_a_hairpin_stands_beside_its_like() -> None:
    tube = Tube(1e-3, 0.8e-3, 0.0, 60e-3, 45.0)  # 155 deg
    mold = plan_mold([tube, tube])
    assert apart(*mold.grooves) > mold.grooves[0].width + mold.spec.groove.wall - 1e-4


def test_the_cold_length_of_a_thermal_model_takes_the_place_of_the_estimate() -> None:
    for cold in (12e-3, 47e-3):
        (groove,) = plan_mold(THESIS, MoldSpec(cold_length=cold)).grooves
        assert groove.cold.length == cold
        held = math.dist(groove.clamps[0].face, groove.centreline.lead_in.end)
        assert held >= cold - 1e-12
    assert plan_mold(THESIS, MoldSpec(cold_length=47e-3)).grooves[0].stock_length > 0.094 + 2 * 0.047


def test_growth_is_the_integral_of_the_expansion_and_the_sliding_clamp_allows_it() -> None:
    heat = HeatSpec(clamp_temperature=350.0)
    for end in ("proximal", "distal"):
        (groove,) = plan_mold(THESIS, MoldSpec(heat=heat, clamps=ClampSpec(sliding_end=end))).grooves
        length, decay = groove.free_length, groove.cold.decay_length

        def temperature(x: float, length: float = length, decay: float = decay) -> float:
            dip = math.cosh((x - length / 2) / decay) / math.cosh(length / 2 / decay)
            return heat.set_temperature - (heat.set_temperature - 350.0) * dip

        wanted = quad(lambda x: 11e-6 * (temperature(x) - heat.ambient), 0, length, points=[decay, length - decay])[0]
        assert groove.growth == pytest.approx(wanted, rel=1e-9)
        sliding = [clamp for clamp in groove.clamps if clamp.slides]
        assert [clamp.end for clamp in sliding] == [end]
        assert sliding[0].travel >= 1.5 * groove.growth


def test_vents_follow_their_profile() -> None:
    profile = (0.2, 0.1, 0.0, 0.15)
    (groove,) = plan_mold(THESIS, MoldSpec(vents=VentSpec(diameter=1e-3, profile=profile))).grooves
    (bend,) = groove.centreline.bend
    middle = np.array([vent.centre for vent in groove.vents])
    assert np.linalg.norm(middle - bend.centre, axis=1) == pytest.approx(np.full(len(middle), bend.radius))
    from_start = bend.heading + math.pi / 2 - np.arctan2(*(middle - bend.centre).T[::-1])
    cells = np.bincount((from_start * bend.radius / bend.length * 4).astype(int), minlength=4)
    opened = cells * math.pi / 4 * 1e-6 / (groove.width * bend.length / 4)
    each = math.pi / 4 * 1e-6 / (groove.width * bend.length / 4)
    assert np.abs(opened - profile).max() <= each
    assert plan_mold(THESIS, MoldSpec(vents=VentSpec(profile=(0.0,)))).vents == ()


def test_area_of_the_groove_within_the_plate() -> None:
    mold = plan_mold(PAIR)
    for groove in mold.grooves:
        # Both walls leave through the same edge: the slanted ends make up for one another.
        solid = mold.size[0] * mold.size[1] * mold.spec.plate.thickness
        assert groove.width * groove.centreline.length * groove.depth < 0.1 * solid
    one = plan_mold(THESIS)
    (groove,) = one.grooves
    through = sum(math.pi / 4 * hole.diameter**2 for hole in one.holes) * 12.7e-3
    wanted = one.size[0] * one.size[1] * 12.7e-3 - through - groove.width * groove.centreline.length * groove.depth
    assert one.base_volume == pytest.approx(wanted, rel=1e-9)


def test_a_polygon_of_the_groove_has_the_groove_s_area() -> None:
    groove = plan_mold(THESIS).grooves[0]
    x, y = polygon(groove.centreline, groove.width).T
    area = 0.5 * float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
    assert area == pytest.approx(groove.width * groove.centreline.length, rel=1e-5)


def test_strain_when_pressed_in() -> None:
    tight = Tube(2e-3, 1.6e-3, 0.0, 20e-3, 55.0)
    message = refused(tight, MoldSpec(springback=Springback(0.1)))
    assert message.startswith("tube 1 is strained 6.11 % when it is pressed straight into the mold (radius 16.36 mm)")
    assert "6 % that nitinol springs back from" in message
    assert plan_mold(tight, MoldSpec(springback=Springback(0.1), most_strain=0.07))
    assert "0.8 %" in refused(THESIS, MoldSpec(most_strain=0.005))


def test_end_mills() -> None:
    big = MillingSpec(end_mills=(EndMill(3e-3), EndMill(4e-3)))
    assert refused(THESIS, MoldSpec(milling=big)).startswith(
        "the smallest available end mill (3 mm) is wider than the groove of tube 1: outer diameter 1.92 mm"
    )
    small = plan_mold(THESIS, MoldSpec(milling=MillingSpec(end_mills=(EndMill(1.2e-3, 3e-3),)))).grooves[0]
    assert small.width == pytest.approx(1.97e-3)
    assert small.cutter_offsets == pytest.approx((-0.385e-3, 0.0, 0.385e-3))
    short = MillingSpec(end_mills=(EndMill(2e-3, 1.5e-3),))
    assert "2 mm deep, deeper than the 2 mm end mill cuts (1.5 mm)" in refused(THESIS, MoldSpec(milling=short))
    sharp = Tube(1.9e-3, 1.5e-3, 0.0, 1e-3, 1 / 0.98e-3)
    assert "below half the groove's width" in refused(sharp, MoldSpec(most_strain=1.0))


def places_in_clamp(clamp: Clamp, spec: ClampSpec) -> set[tuple[int, int]]:
    """Places (half a millimetre) that a clamp takes, wherever it slides."""
    along = np.asarray(clamp.direction)
    across = np.array([-along[1], along[0]])
    a, b = np.meshgrid(np.arange(0, spec.grip + clamp.travel, 1e-4), np.arange(-spec.width / 2, spec.width / 2, 1e-4))
    points = np.asarray(clamp.face) + a.ravel()[:, None] * along + b.ravel()[:, None] * across
    return {(int(x), int(y)) for x, y in np.floor(points / 0.5e-3)}


def test_clamps_that_overlap_are_named() -> None:
    mold = plan_mold((THESIS,) * 3)
    spec = mold.spec.clamps
    taken = [(g.number, places_in_clamp(clamp, spec)) for g in mold.grooves for clamp in g.clamps]
    for (first, a), (second, b) in itertools.combinations(taken, 2):
        named = any(f"clamps of tubes {first} and {second} overlap" in words for words in mold.remarks)
        assert not a & b or named
    assert any("clamps of tubes 1 and 2 overlap: set one tube after the other" in words for words in mold.remarks)
    apart = plan_mold((THESIS,) * 3, MoldSpec(clamps=ClampSpec(width=3e-3)))
    assert not any("overlap" in words for words in (*apart.remarks, *plan_mold(THESIS).remarks))
    # A clamp narrower than the usual nose is straight.
    assert (ClampSpec().face_width, apart.spec.clamps.face_width) == (3.5e-3, 3e-3)
    with pytest.raises(InputError, match=r"nose is 4 mm; it must be at most the width of the clamp, 3 mm"):
        ClampSpec(width=3e-3, nose=4e-3)
    # A bend of more than half a turn brings both ends of one tube together.
    turned = Tube(1.9e-3, 1.5e-3, 0.0, 12e-3 * np.radians(182.0), 1 / 12e-3)
    for wide in (ClampSpec(width=30e-3), ClampSpec(width=30e-3, nose=20e-3), ClampSpec(width=30e-3, nose=30e-3)):
        told = plan_mold(turned, MoldSpec(most_strain=0.2, clamps=wide)).remarks
        assert any("the two clamps of tube 1 overlap" in words for words in told)


def test_plates_too_thin_or_too_small() -> None:
    thin = MoldSpec(plate=PlateSpec(thickness=5e-3))
    assert refused(THESIS, thin).startswith(
        "the plate is too thin: 5 mm. The groove of tube 1 is 2 mm deep; 4 mm must stay below it"
    )
    small = MoldSpec(plate=PlateSpec(size=(0.1, 0.05)))
    assert "the groove of tube 1 does not fit on the plate" in refused(THESIS, small)
    crowded = MoldSpec(plate=PlateSpec(size=(0.16, 0.05)))
    assert "the grooves of tubes 1, 2, 3, 4, 5, 6, 7, 8, 9 cross on a plate of 160 x 50 mm" in refused(
        (THESIS,) * 9, crowded
    )
    assert plan_mold(THESIS, MoldSpec(plate=PlateSpec(size=(0.2, 0.08)))).size == (0.2, 0.08)
    holes = MoldSpec(plate=PlateSpec(bolt_diameter=40e-3))
    assert "fits" in refused(THESIS, holes)


def test_a_groove_that_crosses_itself() -> None:
    loop = Tube(1e-3, 0.8e-3, 0.0, 0.2, 28.0)  # 321 deg
    assert refused(loop, MoldSpec()).startswith("the groove of tube 1 crosses itself: it bends by 320.9 deg")


def test_what_makes_no_sense_is_refused() -> None:
    assert refused((), MoldSpec()) == "tubes is empty; there must be at least one"
    assert refused(Tube(1e-3, 0.8e-3, 0.1, 0.0, 0.0), MoldSpec()) == "tube 1 has no curved part; it needs no mold"
    assert "tube 1: curvature is 8.33333 per m; with this spring-back no mold yields more" in refused(
        THESIS, MoldSpec(springback=Springback(0.1, slope=0.1))
    )
    with pytest.raises(InputError, match="mold material is 'wood'; it must be one of"):
        MoldSpec(material="wood")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="cold_length of the mold is -1"):
        MoldSpec(cold_length=-1.0)
    with pytest.raises(InputError, match="sliding_end is 'left'"):
        ClampSpec(sliding_end="left")
    with pytest.raises(InputError, match=r"most_clearance is 0\.01 mm"):
        GrooveSpec(most_clearance=1e-5)
    with pytest.raises(InputError, match="every number must lie in"):
        VentSpec(profile=(1.2,))
    with pytest.raises(InputError, match="must be above the ambient"):
        HeatSpec(set_temperature=290.0)
    assert "holes every 1.77 mm; the distance must be at least 2 mm" in refused(
        THESIS, MoldSpec(vents=VentSpec(profile=(0.5,)))
    )


def test_materials_speak_up() -> None:
    for name, said in (("mdf", "mdf chars above 300 degC"), ("steel", "steel conducts")):
        assert any(said in remark for remark in plan_mold(THESIS, MoldSpec(material=name)).remarks)  # type: ignore[arg-type]
    plain = replace(THESIS, material=tubeopt.Material("other", 60e9, 22e9))
    assert any("thermal constants of other are not known" in remark for remark in plan_mold(plain).remarks)


def test_trials_elsewhere_are_remarked_upon() -> None:
    far = MoldSpec(springback=Springback(0.1, curvature_range=(20.0, 30.0)))
    assert any("lies outside the trials (33.33 to 50 mm)" in remark for remark in plan_mold(THESIS, far).remarks)
    near = MoldSpec(springback=Springback(0.1, curvature_range=(8.0, 10.0), shrinkage=0.005))
    assert plan_mold(THESIS, near).remarks == ()


def test_a_straight_tube_gets_a_straight_groove() -> None:
    mold: Mold = plan_mold(Tube(1e-3, 0.8e-3, 0.0, 50e-3, 0.0))
    assert mold.grooves[0].radius == math.inf
    assert predict_tube(mold).curvature == 0


def test_every_check_of_a_plan_holds() -> None:
    for curvature in (3.0, 6.0, 9.0):
        tubes = [
            Tube(1.0e-3 + 0.8e-3 * k, 0.7e-3 + 0.8e-3 * k, 0.05, 0.06 + 0.04 * k, curvature / (k + 1)) for k in range(3)
        ]
        assert all(check.passed for check in plan_mold(tubes).checks)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: plan_mold(5), "tubes is 5; it must be a Tube or several"),  # type: ignore[arg-type]
        (lambda: plan_mold([], 5), "mold is 5; it must be a MoldSpec"),  # type: ignore[arg-type]
        (lambda: MoldSpec(plate="thin"), "plate of the mold is 'thin'; it must be a PlateSpec"),  # type: ignore[arg-type]
        (lambda: PlateSpec(thickness="thin"), "thickness is 'thin'; it must be a number"),  # type: ignore[arg-type]
        (lambda: PlateSpec(size=5), "size of the plate is 5; it must be 2 numbers (width and height)"),  # type: ignore[arg-type]
        (lambda: MillingSpec(end_mills=5), "end_mills is 5; it must be a list of EndMill"),  # type: ignore[arg-type]
        (lambda: MillingSpec(end_mills=(1e-3,)), "an entry of end_mills is 0.001; it must be an EndMill"),  # type: ignore[arg-type]
        (lambda: predict_tube(5), "mold is 5; it must be a Mold"),  # type: ignore[arg-type]
    ],
)
def test_wrong_kinds_are_refused(make: Any, message: str) -> None:
    with pytest.raises(InputError) as caught:
        make()
    assert message in str(caught.value)
