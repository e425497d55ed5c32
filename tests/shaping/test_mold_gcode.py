"""Programs of whole molds, by an interpreter of their own: grooves, holes, outline, tools and safety."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from tubeopt import InputError, Mold, MoldSpec, SolveError, Tube, plan_mold
from tubeopt.shaping.materials import mold_material
from tubeopt.shaping.mold.checks import beyond_edge
from tubeopt.shaping.mold.files import plate_part, write_mold, write_solid
from tubeopt.shaping.mold.gcode import hazards, programs, read_gcode, stages_of
from tubeopt.shaping.mold.layout import Hole
from tubeopt.shaping.mold.spec import HingeSpec, MillingSpec, PlateSpec, VentSpec, WorkshopSpec
from tubeopt.show.plots.sheets import hole_rows, mold_steps, path_rows, plot_hole_sheet, tool_rows, torque_of, zero_text

from .gcode_machine import Block, mill

SMALL = Tube(1.92e-3, 1.57e-3, 0.0, 30e-3, 1 / 0.12)
PARTS = ("base", "lid")


def small(**workshop: object) -> Mold:
    """A little mold."""
    spec = MoldSpec(
        plate=PlateSpec(size=(0.09, 0.05)),
        vents=VentSpec(profile=(0.1,)),
        workshop=WorkshopSpec(**workshop),  # type: ignore[arg-type]
    )
    return plan_mold(SMALL, spec)


def bore(hole: Hole) -> float:
    """Diameter of the drill of a hole: a dowel is reamed by 0.2 mm."""
    return round(hole.diameter - (0.2e-3 if hole.purpose == "dowel" else 0.0), 6)


def texts(mold: Mold, part: str) -> list[str]:
    return [each.text for each in programs(mold, part)]


@pytest.mark.parametrize("dialect", ["grbl", "linuxcnc", "mach"])
@pytest.mark.parametrize("touch_plate", [None, 15e-3])
def test_nothing_is_done_that_breaks_a_tool(dialect: str, touch_plate: float | None) -> None:
    mold = small(dialect=dialect, touch_plate=touch_plate, work_offset="G55")
    for part in PARTS:
        made, tools = texts(mold, part), len(stages_of(mold, part))
        assert len(made) == (tools if touch_plate is None else 1)
        for text in made:
            seen = mill(text)
            assert not seen.errors
            assert not hazards(read_gcode(text))
            assert seen.ended
            assert seen.offsets == {"G55"}
            assert max(map(len, text.splitlines())) < 75
            assert ("G83" in text) <= (dialect != "grbl")
        # The new tool is put in, and the touch plate laid and taken away.
        changes = (tools - 1) * (2 if dialect == "grbl" else 3)
        assert seen.pauses == (0 if touch_plate is None else changes)


@pytest.mark.parametrize("dialect", ["grbl", "linuxcnc"])
def test_all_holes_are_there_and_go_through(dialect: str) -> None:
    mold = small(dialect=dialect)
    for part, thickness in zip(PARTS, (12.7, 6.35), strict=True):
        # The lid is milled with its lower face up: its holes are mirrored.
        wide, sign = (1e3 * mold.size[0], -1) if part == "lid" else (0.0, 1)
        holes = mold.lid_holes if part == "lid" else mold.holes
        wanted = {(round(wide + sign * 1e3 * h.centre[0], 4), round(1e3 * h.centre[1], 4), bore(h)) for h in holes}
        found = set()
        for stage, text in zip(stages_of(mold, part), texts(mold, part), strict=True):
            if stage.tool.startswith("drill"):
                deep = [way[-1] for way in mill(text).cuts if way[:, 2].min() < -thickness]
                found |= {(round(x, 4), round(y, 4), stage.diameter) for x, y, _ in deep}
        assert found == wanted


@pytest.mark.parametrize("hinged", [False, True])
def test_the_table_of_holes_says_what_the_programs_drill(hinged: bool, tmp_path: Path) -> None:
    mold = small()
    if hinged:
        mold = plan_mold(SMALL, replace(mold.spec, plate=PlateSpec(), hinge=HingeSpec(3.2e-3)))
    for part in PARTS:
        drilled: dict[tuple[float, float, float], float] = {}
        for stage, text in zip(stages_of(mold, part), texts(mold, part), strict=True):
            for way in mill(text).cuts if stage.tool.startswith("drill") else ():
                x, y, z = way[way[:, 2].argmin()].round(3).tolist()
                place = x, y, round(1e3 * stage.diameter, 3)
                drilled[place] = min(z, drilled.get(place, 0.0))
        rows = hole_rows(mold, part)
        assert [row[0] for row in rows] == [str(k) for k in range(1, len(rows) + 1)]
        told = {}
        for _, x, y, diameter, fit, z, tool in rows:
            if tool == "latch, end mill 4":
                continue
            drill = float(re.findall(r"drill ([\d.]+)", tool)[0])
            told[float(x), float(y), drill] = float(z)
            if tool.startswith("dowel"):
                assert f"ream {diameter}" in tool
                assert fit == {"base": "H7", "lid": "F7"}[part]
            else:
                assert (drill, fit[0]) == (float(diameter), "+")
        for place, z in told.items():
            (depth,) = [z for other, z in drilled.items() if np.allclose(other, place, rtol=0, atol=0.0051)]
            assert z == pytest.approx(depth, abs=0.051)
        assert len(drilled) == len(told)
        plot_hole_sheet(mold, tmp_path / f"{part}.pdf", part=part)
    assert_sheets_tell_slot_and_zero(mold, hinged=hinged)
    (heading, first, arc, last) = path_rows(mold, "base")
    groove = mold.grooves[0]
    assert f"{1e3 * groove.width:.3f} wide" in heading[0]
    numbers = [float(x) for x in re.findall(r"-?[\d.]+", arc[1])]
    x1, y1, radius, x, y = numbers
    x0, y0 = (float(x) for x in re.findall(r"to \(([-\d.]+), ([-\d.]+)\)", first[1])[0])
    assert np.hypot(x1 - x, y1 - y) == pytest.approx(radius, abs=0.01) == np.hypot(x0 - x, y0 - y)
    assert radius == pytest.approx(1e3 * groove.radius, abs=1e-3)
    assert last[1].startswith(f"line ({x1:.2f}, {y1:.2f}) to ({1e3 * mold.size[0]:.2f}, ")


def assert_sheets_tell_slot_and_zero(mold: Mold, *, hinged: bool) -> None:
    """Slot and cut of the lid as its programs mill them; countersinks where heads are; corner 0 from the stock."""
    heading, arc, *cut = path_rows(mold, "lid")
    assert "0.4 wide, 0.4 deep" in heading[0]
    x0, y0, x1, y1 = (float(x) for x in re.findall(r"-?[\d.]+", arc[1])[:4])
    milled = [m.piece for m in programs(mold, "lid")[0].motions if m.end < -0.39e-3 and m.piece.length > 0]
    assert np.allclose([milled[0].start, milled[-1].end], 1e-3 * np.array([(x0, y0), (x1, y1)]), atol=6e-6)
    stock = [float(x) for x in re.findall(r"\(stock: ([\d.]+) x ([\d.]+)", texts(mold, "lid")[0])[0]]
    edges = [float(x) for x in re.findall(r"= (-[\d.]+)", zero_text(mold, "lid"))]
    assert edges == pytest.approx([-(size - 1e3 * of) / 2 for size, of in zip(stock, mold.size, strict=True)])
    strip = float(re.findall(r"Y [\d.]+ to ([\d.]+)", cut[0][0])[0]) if cut else 0.0
    told = {part: [row for row in hole_rows(mold, part) if row[6].startswith("hinge")] for part in PARTS}
    assert [len(cut), *map(len, told.values())] == ([1, 4, 8] if hinged else [0, 0, 0])
    # A cone of 90 degrees from 6.4 mm down to the 3.2 mm of the hole is 1.6 mm deep.
    for part, rows in told.items():
        for row in rows:
            # Screws of the strip, above the cut, have their heads in the base.
            assert ("sunk 90° to 6.4, 1.6 deep, lower face" in row[6]) == (part == "base" or float(row[2]) < strip)


def test_screws_are_tightened_as_far_as_the_board_bears() -> None:
    """M5 with washers of 10 mm on a board: 2 MPa below them; in steel a third of the yield point of class 8.8."""
    on_board, in_steel = (torque_of(5.5e-3, mold_material(name)) for name in ("calcium_silicate", "steel"))
    assert on_board / (0.2 * 5e-3) / (np.pi / 4 * (10e-3**2 - 5.5e-3**2)) == pytest.approx(2e6)
    # The stress area of M5 is 14.2 mm2 (ISO 898-1).
    assert in_steel / (0.2 * 5e-3) / 14.2e-6 == pytest.approx(640e6 / 3, rel=0.1)


@pytest.mark.parametrize("part", PARTS)
def test_what_is_milled_away_is_what_the_solid_lacks(part: str, tmp_path: Path) -> None:
    spec = MoldSpec(vents=VentSpec(profile=(0.1,)))
    mold = plan_mold([SMALL, Tube(1.2e-3, 0.9e-3, 0.0, 20e-3, 20.0)], spec)
    solid = trimesh.load_mesh(write_solid(plate_part(mold, part), tmp_path / "plate.stl"))
    thickness = 12.7 if part == "base" else 6.35
    block = Block((1e3 * mold.size[0], 1e3 * mold.size[1]), thickness)
    for stage, text in zip(stages_of(mold, part), texts(mold, part), strict=True):
        seen = mill(text)
        assert not seen.errors
        for way in seen.cuts:
            block.cut(way, 1e3 * stage.diameter)
    lacks = np.prod(1e3 * np.array(mold.size)) * thickness - solid.volume
    # What the reamer takes is left.
    reamed = sum(np.pi / 4 * 1e6 * (hole.diameter**2 - bore(hole) ** 2) for hole in mold.holes) * thickness
    assert reamed > 20 * thickness / 12.7
    assert block.removed == pytest.approx(lacks - reamed, rel=5e-3)


def test_the_plate_is_cut_out_but_for_its_tabs() -> None:
    mold = small(tab_pitch=60e-3)
    stage, text = stages_of(mold, "base")[-1], texts(mold, "base")[-1]
    outline = np.vstack([way for way in mill(text).cuts if way[0, 2] < -12.7 or way[-1, 2] < -12.7])
    # Nothing of the plate is touched.
    inside = np.abs(outline[:, :2] - 500 * np.array(mold.size)) - 500 * np.array(mold.size)
    assert inside.max(1).min() == pytest.approx(500 * stage.diameter)
    deepest = [way for way in mill(text).cuts if np.ptp(way[:, 2]) == 0 and way[0, 2] == pytest.approx(-10.7)]
    assert len(deepest) >= 6
    # Six tabs: two on each of the long sides, one on the others.
    deep = outline[outline[:, 2] < -12.7]
    along = np.sort(deep[np.isclose(deep[:, 1], -2.0), 0])
    gaps = np.diff(along)
    assert np.sort(gaps)[-2:] == pytest.approx([10.0, 10.0], abs=0.3)
    assert np.sort(gaps)[-3] < 0.3


@pytest.mark.parametrize("material", ["steel", "glass_mica", "mdf", "calcium_silicate"])
def test_no_tool_turns_or_feeds_faster_than_the_material_allows(material: str) -> None:
    # m/min: drills of high-speed steel in 1018; Macor. A board is cut at the speeds of the machine.
    fastest = {"steel": 27.0, "glass_mica": 6.0}.get(material, np.inf)
    mold = plan_mold(SMALL, replace(small().spec, material=mold_material(material), hinge=HingeSpec(3.2e-3)))
    slowest = np.inf
    for part in PARTS:
        rows = [row for row in tool_rows(mold) if row[0].startswith(part)]
        for row, text in zip(rows, texts(mold, part), strict=True):
            size = float(row[1].split()[-2])
            rpm, depth = float(re.findall(r"M3 S(\d+)", text)[0]), -min(way[:, 2].min() for way in mill(text).cuts)
            drills = row[1].startswith("drill")
            assert np.pi * 1e-3 * size * rpm < fastest * 1.003
            assert rpm <= (3000 if drills else 12000)
            # At most a hundredth of the diameter for each of two teeth; a board is cut no slower than that.
            feeds = [float(word) for word in re.findall(r"G[123] [^F\n]*F([\d.]+)", text)]
            cut = min(feeds) if drills else float(row[4])
            asked = 120 if drills else 600 if size == 4 else 300
            assert cut == pytest.approx(min(asked, 0.02 * size * rpm), abs=0.6)
            plunge = cut if drills else 120 * cut / asked
            assert min(feeds) == pytest.approx(plunge, abs=0.6)
            assert row[2:5] == (f"{rpm:.0f}", f"{np.pi * 1e-3 * size * rpm:.1f}", f"{cut:.0f}")
            assert float(row[7]) == pytest.approx(depth, abs=5e-4)
            slowest = min(slowest, rpm / (3000 if drills else 12000))
    assert (slowest == 1) == (fastest == np.inf)
    steps = " ".join(mold_steps(mold))
    assert "Add what the clamps hold: they stay" in steps
    assert ("Cut wet, at 27 m/min" in steps) == (material == "steel")
    assert ("Cut dry, with an extractor" in steps) == (fastest == np.inf)
    # A mold that conducts takes the tube to an oven: no clamps, no current.
    assert ("`tubeopt heat oven`" in steps) == (material == "steel") == ("Clamps at the distances" not in steps)


def test_a_program_takes_no_longer_than_a_week() -> None:
    spec = MoldSpec(milling=MillingSpec(step_down=1e-5, feed=2e-5))
    # The groove is some 70 mm long, with leads and overrun, and takes 200 passes of 0.01 mm at 0.02 mm/s: 8 days.
    with pytest.raises(InputError, match=r"the program base_\d.nc takes [\d.]+ days; it must take at most 7 days"):
        programs(plan_mold(SMALL, spec), "base")


def test_hazards_are_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mold = small()
    good = texts(mold, "base")[0]
    assert "rapid speed" in hazards(read_gcode(good.replace("G1 Z-", "G0 Z-")))[0]
    assert "spindle still" in hazards(read_gcode(good.replace("M3", "M5")))[0]
    monkeypatch.setattr("tubeopt.shaping.mold.gcode._retract", lambda mold: iter(["G0 Z5.0000"]))
    with pytest.raises(SolveError, match="rapid speed below the plate's face"):
        write_mold(mold, tmp_path)
    assert not list(tmp_path.iterdir())


def test_stock_and_end_mill_are_looked_at() -> None:
    spec = MoldSpec(plate=PlateSpec(size=(0.09, 0.05)))
    assert not [r for r in plan_mold(SMALL, spec).remarks if "stock" in r or "reaches" in r]
    tight = replace(spec, workshop=WorkshopSpec(stock=(0.095, 0.06)))
    assert any(
        "the stock is 95 x 60 mm; with room for tools and clamps it must be" in r
        for r in plan_mold(SMALL, tight).remarks
    )
    thick = replace(spec, plate=replace(spec.plate, thickness=30e-3))
    assert any("reaches 25 mm deep, the plate is 30 mm thick" in r for r in plan_mold(SMALL, thick).remarks)
    assert beyond_edge([], spec) == pytest.approx(9e-3)
    with pytest.raises(InputError, match="dialect"):
        WorkshopSpec(dialect="heidenhain")
