"""Slots of lids for thermocouples: in the drawing, the solid and the program, and a wire that fits into them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tubeopt import InputError, MoldSpec, load_robot, plan_mold
from tubeopt.shaping.mold.files import draw_plate, manifold, plate_part, write_mold
from tubeopt.shaping.mold.gcode import programs, slot_deviation, slot_paths
from tubeopt.shaping.mold.groove import polygon
from tubeopt.shaping.mold.mold import Mold, chosen_tubes
from tubeopt.shaping.mold.spec import EndMill, MillingSpec, SlotSpec
from tubeopt.show.plots.sheets import groove_numbers, mold_steps
from tubeopt.typing import Array

pytest.importorskip("ezdxf")
pytest.importorskip("trimesh")
pytest.importorskip("manifold3d")
ROBOTS = sorted(path.stem for path in (Path(__file__).parents[2] / "configs/robots").glob("*.yaml"))


def molds(name: str) -> list[Mold]:
    """A mold for each planar tube of a shipped robot."""
    robot = load_robot(name)
    found = []
    try:
        numbers, _ = chosen_tubes(robot)
    except InputError:
        return []
    for number in numbers:
        try:
            found.append(plan_mold(robot.tubes[number - 1]))
        except InputError:
            continue  # a tube that no plate sets has no lid either
    return found


def bar(mold: Mold, width: float, bottom: float) -> Any:
    """Square bar of a width (m) along the slot, with its lower face at a height above the base: it holds the wire."""
    corners = polygon(mold.slots[0].centreline, width)
    solid = manifold().Manifold.extrude(manifold().CrossSection([1e3 * corners]), 1e3 * width)
    return solid.translate((0.0, 0.0, 1e3 * bottom))


@pytest.mark.parametrize("name", ROBOTS)
def test_a_thermocouple_lies_in_the_closed_mold_of_every_shipped_tube(name: str) -> None:
    for mold in molds(name):
        (groove,) = mold.grooves
        assert groove.slot is not None, groove.number
        base, lid = (plate_part(mold, part).solid() for part in ("base", "lid"))
        # On the tube, which lies on the floor of its groove, with a foil of mica between.
        wire = bar(mold, 0.25e-3, groove.tube.outer_diameter - groove.depth + 0.05e-3)
        assert (wire ^ lid).volume() < 1e-9
        assert (wire ^ base).volume() < 1e-9
        # Without the slot it would be in the lid.
        whole = plate_part(plan_mold(groove.tube, MoldSpec(slot=SlotSpec(wire=0.0))), "lid").solid()
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
