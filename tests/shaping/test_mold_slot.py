"""Lids: slots for thermocouples and hinges, in drawing, solid and program; a wire that fits, a lid that opens."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tubeopt import InputError, MoldSpec, Tube, load_robot, plan_mold
from tubeopt.shaping.materials import STEEL
from tubeopt.shaping.mold.files import draw_plate, halves, manifold, plate_part, write_mold
from tubeopt.shaping.mold.gcode import programs, slot_deviation, slot_paths, stages_of
from tubeopt.shaping.mold.groove import polygon
from tubeopt.shaping.mold.mold import Mold, chosen_tubes
from tubeopt.shaping.mold.spec import EndMill, GrooveSpec, HingeSpec, MillingSpec, PlateSpec, SlotSpec, WorkshopSpec
from tubeopt.show.plots.sheets import groove_numbers, hole_rows, mold_steps, tool_rows
from tubeopt.typing import Array

pytest.importorskip("ezdxf")
pytest.importorskip("trimesh")
pytest.importorskip("manifold3d")
ROBOTS = sorted(path.stem for path in (Path(__file__).parents[2] / "configs/robots").glob("*.yaml"))


HINGED = MoldSpec(hinge=HingeSpec(screw_diameter=3.2e-3))


def molds(name: str, spec: MoldSpec) -> list[Mold]:
    """A mold for each planar tube of a shipped robot."""
    robot = load_robot(name)
    found = []
    try:
        numbers, _ = chosen_tubes(robot)
    except InputError:
        return []
    for number in numbers:
        try:
            found.append(plan_mold(robot.tubes[number - 1], spec))
        except InputError:
            continue  # a tube that no plate sets has no lid either
    return found


def bar(mold: Mold, width: float, bottom: float) -> Any:
    """Square bar of a width (m) along the slot, with its lower face at a height above the base: it holds the wire."""
    corners = polygon(mold.slots[0].centreline, width)
    solid = manifold().Manifold.extrude(manifold().CrossSection([1e3 * corners]), 1e3 * width)
    return solid.translate((0.0, 0.0, 1e3 * bottom))


@pytest.mark.parametrize("spec", [MoldSpec(), HINGED], ids=["bolted", "hinged"])
@pytest.mark.parametrize("name", ROBOTS)
def test_a_thermocouple_lies_in_the_closed_mold_of_every_shipped_tube(name: str, spec: MoldSpec) -> None:
    for mold in molds(name, spec):
        (groove,) = mold.grooves
        assert groove.slot is not None, groove.number
        base, lid = (plate_part(mold, part).solid() for part in ("base", "lid"))
        # On the tube, which lies on the floor of its groove, with a foil of mica between.
        wire = bar(mold, 0.25e-3, groove.tube.outer_diameter - groove.depth + 0.05e-3)
        assert (wire ^ lid).volume() < 1e-9
        assert (wire ^ base).volume() < 1e-9
        # Without the slot it would be in the lid.
        whole = plate_part(plan_mold(groove.tube, replace(spec, slot=SlotSpec(wire=0.0))), "lid").solid()
        assert (wire ^ whole).volume() > 0.1 * wire.volume()
        # Its legs leave through holes at both ends.
        for x, y in (groove.slot.centreline.lead_in.start, groove.slot.centreline.lead_out.end):
            leg = manifold().Manifold.cylinder(6.3, 0.5, 0.5, 24).translate((1e3 * x, 1e3 * y, 0.0))
            assert (leg ^ lid).volume() < 1e-9
        # The bead is over the middle of the bend.
        assert abs(groove.centreline.bend_point(np.array([groove.bend_length / 2])) - middle(mold)).max() < 2e-3


def middle(mold: Mold) -> Array:
    """Middle of the slot, m."""
    curve = mold.slots[0].centreline
    return curve.bend_point(np.array([curve.bend_length / 2]))


def test_drawing_program_and_sheet_have_the_slot(tmp_path: Path) -> None:
    mold = plan_mold(load_robot("thesis_ctr").tubes[0])
    (slot,) = mold.slots
    assert slot.depth == pytest.approx(0.4e-3)
    assert slot.mill.diameter == pytest.approx(0.4e-3)
    assert 20e-3 < slot.centreline.length < 28e-3
    walls = draw_plate(mold, "lid").pieces["GROOVE"]
    lengths = sorted(piece.length for piece in walls)
    assert lengths[:2] == pytest.approx([0.4, 0.4])
    assert sum(lengths[2:]) == pytest.approx(2e3 * slot.centreline.length, rel=1e-6)
    assert slot_deviation(mold) < 1e-6
    first = programs(mold, "lid")[0]
    assert "lower face up" in first.text
    # Turned over: what is on the right of the closed mold is on the left of the machine.
    pieces = [m.piece for m in first.motions if m.end < 0 and m.piece.length > 0]
    cut = np.vstack([piece.point(np.linspace(0, piece.length, 50)) for piece in pieces])
    path = slot_paths(mold)[0]
    assert cut[:, 0].mean() == pytest.approx(mold.size[0] - slot.centreline.sample(1e-3)[:, 0].mean(), abs=2e-3)
    assert path[0].start[0] == pytest.approx(mold.size[0] - slot.centreline.lead_in.start[0])
    assert groove_numbers(mold.grooves[0], mold)["slot in the lid, width / depth / length"].startswith("0.4 / 0.4 / ")
    assert any("lower face up" in step for step in mold_steps(mold))
    names = {path.name for path in write_mold(mold, tmp_path)}
    assert {"lid.stl", "lid.dxf", "lid_1.nc"} <= names


def test_a_lid_has_no_slot_where_none_is_wanted_or_no_end_mill_fits() -> None:
    tube = load_robot("thesis_ctr").tubes[0]
    assert not plan_mold(tube, MoldSpec(slot=SlotSpec(wire=0.0))).slots
    coarse = MillingSpec(end_mills=(EndMill(0.9e-3),))
    assert not plan_mold(tube, MoldSpec(milling=coarse)).slots
    closed = plan_mold(tube, replace(MoldSpec(), vents=replace(MoldSpec().vents, profile=(0.0,))))
    assert [hole.purpose for hole in closed.slots[0].exits] == ["wire", "wire"]


# --- hinges -----------------------------------------------------------------------------------------------------------


def pieces_of_lid(mold: Mold) -> tuple[Any, Any]:
    """Solids (mm) of a hinged lid and of its strip."""
    pieces = sorted(plate_part(mold, "lid").solid().decompose(), key=lambda piece: piece.volume())
    assert len(pieces) == 2
    return pieces[1], pieces[0]


def bolt(hole: Any, bottom: float, top: float, radius: float) -> Any:
    """Cylinder in the middle of a hole, mm."""
    solid = manifold().Manifold.cylinder(top - bottom, radius, radius, 48)
    return solid.translate((1e3 * hole.centre[0], 1e3 * hole.centre[1], bottom))


@pytest.mark.parametrize("name", ROBOTS)
def test_hinged_lids_of_all_shipped_tubes_open_without_collision(name: str) -> None:
    """Over the tube, the strip, and the bolts of the latches with their nuts; to beyond a right angle, by the pin."""
    for mold in molds(name, HINGED):
        hinge, (groove,), up = mold.hinge, mold.grooves, 6.35
        assert hinge is not None
        base, (lid, strip) = plate_part(mold, "base").solid(), pieces_of_lid(mold)
        fixed = [base, strip]
        for latch in hinge.latches:
            fixed += [bolt(latch, -12.7, up + 7.0, 2.5), bolt(latch, up + 1.5, up + 6.0, 4.4)]
        # The tube lies on the floor of its groove, along the bend.
        corners = 1e3 * polygon(groove.centreline, groove.tube.outer_diameter)
        tube = manifold().Manifold.extrude(manifold().CrossSection([corners]), 1e3 * groove.tube.outer_diameter)
        fixed.append(tube.translate((0.0, 0.0, -1e3 * groove.depth)))
        wire = bar(mold, 0.25e-3, groove.tube.outer_diameter - groove.depth + 0.05e-3)
        assert all((lid ^ part).volume() < 1e-6 for part in fixed)
        assert (wire ^ lid).volume() < 1e-9
        # A hinge turns about its pin, a millimetre above the lid's upper face.
        axis = np.array([0.0, 1e3 * hinge.pin, up + 1.0])
        for angle in (2, 5, 9, 14, 22, 40, 80, 120):
            opened = (lid + wire).translate(tuple(-axis)).rotate((-angle, 0.0, 0.0)).translate(tuple(axis))
            assert opened.bounding_box()[5] > up + 20 * np.sin(np.radians(angle))
            assert all((opened ^ part).volume() < 1e-6 for part in fixed), (groove.number, angle)
        # A lid that were cut off the strip behind its pin could not open.
        (_, edge), (start, _) = halves(mold)
        assert edge < hinge.pin < start


def test_screws_of_hinges_go_through_what_they_join() -> None:
    mold = plan_mold(load_robot("thesis_ctr").tubes[0], HINGED)
    hinge = mold.hinge
    assert hinge is not None
    base, (lid, strip) = plate_part(mold, "base").solid(), pieces_of_lid(mold)
    for hole in hinge.on_lid:
        screw = bolt(hole, -12.0, 10.0, 1.5)
        assert (screw ^ lid).volume() < 1e-9
        # Its head is flush in the lid, on whole material of the base.
        assert (screw ^ base).volume() == pytest.approx(12.0 * np.pi * 1.5**2, rel=0.01)
    for hole in hinge.on_strip:
        screw = bolt(hole, -13.0, 10.0, 1.5)
        assert all((screw ^ part).volume() < 1e-9 for part in (base, strip, lid))
    reaches = [hinge.pin - hole.centre[1] for hole in hinge.on_lid] + [h.centre[1] - hinge.pin for h in hinge.on_strip]
    assert reaches == pytest.approx([8e-3] * 8)
    nuts = [bolt(hole, 0.0, 10.0, 4.4) for hole in hinge.openings]
    assert all((nut ^ lid).volume() < 1e-9 < (nut ^ base.translate((0, 0, 5))).volume() for nut in nuts)
    assert not mold.holes
    assert mold.statistics.holes == 6


@pytest.mark.parametrize("cut_out", [True, False])
def test_the_hinged_lid_is_cut_off_its_strip(tmp_path: Path, cut_out: bool) -> None:
    spec = replace(HINGED, workshop=WorkshopSpec(cut_out=cut_out))
    mold = plan_mold(load_robot("thesis_etr").tubes[0], spec)
    assert mold.hinge is not None
    last = programs(mold, "lid")[-1]
    assert "cut between the hinged lid and its strip" in last.text
    level = [m.piece for m in last.motions if m.end < -6.35e-3 and abs(m.piece.start[1] - mold.hinge.pin) < 1e-9]
    assert sum(piece.length for piece in level) > 0.8 * mold.size[0]
    assert "hinged" not in "".join(program.text for program in programs(mold, "base"))
    assert len(stages_of(mold, "lid")) == 4
    outlines = draw_plate(mold, "lid").pieces["OUTLINE"]
    assert len(outlines) == 8
    names = {path.name for path in write_mold(mold, tmp_path)}
    assert {"lid.stl", "lid.dxf", "lid.svg", "base.dxf"} <= names
    import ezdxf

    outer = ezdxf.readfile(tmp_path / "lid.dxf").modelspace().query('LWPOLYLINE[layer=="OUTLINE"]')
    assert [line.closed for line in outer] == [True, True]
    circles = ezdxf.readfile(tmp_path / "lid.dxf").modelspace().query('CIRCLE[layer=="HOLES"]')
    assert len(circles) == len(mold.lid_holes)
    steps = " ".join(mold_steps(mold))
    assert "half a turn of each nut" in steps
    # Base, lid, leaf, washers and nut of an M3: 12.7 + 6.35 + 1 + 5.1 mm. A head is twice as wide as its hole.
    assert "4 screws M3 × 30 through strip and base, countersunk 90° to 6.4, 1.6 deep" in steps
    assert "dowels" not in steps


def test_plates_without_room_for_hinges_are_refused() -> None:
    tube = load_robot("thesis_etr").tubes[0]
    with pytest.raises(InputError, match=r"no room for hinges along its upper edge; they need 28\.4 mm"):
        plan_mold(tube, replace(HINGED, plate=PlateSpec(size=(155e-3, 45e-3))))
    with pytest.raises(InputError, match=r"latch_diameter of the hinge is 7 mm; the nut of a bolt"):
        MoldSpec(hinge=HingeSpec(screw_diameter=3e-3, latch_diameter=7e-3))


def test_holes_too_wide_for_a_collet_are_milled_whole_and_nothing_beside_them() -> None:
    """The path of the 4 mm cutter, swept: it covers the circle of 12 mm below the lid, and leaves what is around."""
    mold = plan_mold(load_robot("thesis_etr").tubes[0], HINGED)
    last, slotted = programs(mold, "lid")[-1], bool(mold.slots)
    deep = np.vstack([m.piece.point(np.linspace(0, m.piece.length, 40)) for m in last.motions if m.end < -6.35e-3])
    for hole in [hole for hole in mold.lid_holes if hole.purpose == "latch"]:
        centre = np.array([mold.size[0] - hole.centre[0] if slotted else hole.centre[0], hole.centre[1]])
        path = deep[np.linalg.norm(deep - centre, axis=1) < 6e-3]
        assert np.linalg.norm(path - centre, axis=1).max() + 2e-3 == pytest.approx(6e-3, abs=1e-6)
        grid = np.mgrid[-5.4e-3:5.4e-3:41j, -5.4e-3:5.4e-3:41j].reshape(2, -1).T
        inside = grid[np.linalg.norm(grid, axis=1) < 5.4e-3] + centre
        assert np.linalg.norm(inside[:, None] - path, axis=2).min(axis=1).max() < 2e-3


@pytest.mark.parametrize(("length", "said"), [(30e-3, True), (90e-3, False)])
def test_a_remark_says_how_far_play_straightens_a_short_bend(length: float, said: bool) -> None:
    """By the height of the arc of the largest circle between the walls: chord about the length, ends on one wall."""
    mold = plan_mold(Tube(1e-3, 0.8e-3, 10e-3, length, 10.0), MoldSpec(groove=GrooveSpec(clearance=0.1e-3)))
    groove = mold.grooves[0]
    play = groove.width + 0.05e-3 - 1e-3
    sag = (1 - np.cos(length * groove.curvature / 2)) / groove.curvature
    assert (play / sag > 0.05) == said == any("play in the groove changes" in remark for remark in mold.remarks)
    assert groove.curvature_play(0.05e-3) / groove.curvature == pytest.approx(play / sag, rel=0.02)


def test_countersinks_leave_a_wall_to_the_edge() -> None:
    """A head is twice as wide as its screw, and 3 mm of board stay beside it."""
    mold = plan_mold(load_robot("thesis_etr").tubes[0], HINGED)
    screws = [hole for hole in mold.base_holes if hole.purpose == "hinge"]
    assert min(mold.size[1] - hole.centre[1] - hole.diameter for hole in screws) >= 3e-3 - 1e-9


@pytest.mark.parametrize("slotted", [True, False], ids=["slot", "none"])
def test_the_drawing_of_a_lid_says_that_it_is_mirrored_for_its_lower_face(slotted: bool) -> None:
    spec = MoldSpec() if slotted else MoldSpec(slot=SlotSpec(wire=0.0))
    texts = [text for _, text in draw_plate(plan_mold(load_robot("thesis_ctr").tubes[0], spec), "lid").texts]
    assert any(text.startswith("seen from above, closed; mirror it to mill the lower face") for text in texts)


@pytest.mark.parametrize("spec", [MoldSpec(), HINGED], ids=["bolted", "hinged"])
def test_holes_are_as_deep_on_sheets_as_in_programs(spec: MoldSpec) -> None:
    mold = plan_mold(load_robot("thesis_ctr").tubes[0], spec)
    for part in ("base", "lid"):
        rows = hole_rows(mold, part)
        listed = {-float(row[5]) for row in rows if "drill" in row[6]}
        # Milled holes are as deep as the outline.
        milled = {-float(row[5]) for row in rows if "end mill" in row[6]}
        assert milled <= {round(1e3 * stages_of(mold, part)[-1].depth, 9)}
        cut = {1e3 * s.depth for s in stages_of(mold, part) if s.tool.startswith("drill")}
        tabled = {float(row[7]) for row in tool_rows(mold) if row[0].startswith(part) and row[1].startswith("drill")}
        assert sorted(listed) == pytest.approx(sorted(cut), abs=1e-9)
        assert sorted(tabled) == pytest.approx(sorted(cut), abs=1e-9)


def test_a_fast_router_drills_board_with_the_same_feed_per_turn_and_no_steel() -> None:
    mold = plan_mold(load_robot("thesis_ctr").tubes[0])
    (drill,) = [s for s in stages_of(mold, "lid") if s.tool.startswith("drill 5")]
    (said,) = [step for step in mold_steps(mold) if "S8000" in step]
    assert f"F{8000 * 1e3 * drill.feed / drill.spindle:.0f} (drill 2.8, 5.5)" in said
    steel = plan_mold(load_robot("thesis_ctr").tubes[0], MoldSpec(material=STEEL))
    assert any("use a drill press" in step for step in mold_steps(steel))
