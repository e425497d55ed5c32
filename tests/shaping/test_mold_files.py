"""Files of a mold, read back by others than wrote them: DXF, SVG, STL, G-code, the set-up sheet."""

from __future__ import annotations

import math
import re
import sys
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest

from tubeopt import InputError, Mold, MoldSpec, SolveError, Tube, plan_mold
from tubeopt.shaping import EndMill, MillingSpec, Springback, write_mold
from tubeopt.shaping.mold.files import (
    Part,
    draw_plate,
    dxf_deviation,
    manifold,
    plate_part,
    volume_fault,
    write_dxf,
    write_solid,
)
from tubeopt.shaping.mold.gcode import groove_gcode, read_gcode, toolpath_deviation
from tubeopt.shaping.mold.groove import Arc
from tubeopt.show.plots.mold import plot_mold
from tubeopt.show.plots.sheets import plot_setup_sheet

ezdxf = pytest.importorskip("ezdxf")
trimesh = pytest.importorskip("trimesh")
pytest.importorskip("manifold3d")

THESIS = Tube(1.92e-3, 1.57e-3, 0.0, 94e-3, 1 / 120e-3)
TUBES = (Tube(1.6e-3, 1.1e-3, 20e-3, 80e-3, 25.0), Tube(2.1e-3, 1.8e-3, 0.3, 120e-3, -12.0))
BACK = Springback(0.07)


def drawn(mold: Mold) -> list[Arc]:
    return [piece for groove in mold.grooves for piece in groove.centreline.pieces]


@pytest.fixture(scope="module")
def mold() -> Mold:
    return plan_mold(TUBES, MoldSpec(springback=BACK))


@pytest.fixture(scope="module")
def files(mold: Mold, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("mold")
    paths = write_mold(mold, out)
    expected = {f"{part}.{kind}" for part in ("base", "lid") for kind in ("dxf", "svg", "stl")} | {
        *(f"base_{k}.nc" for k in range(1, 6)),
        *(f"lid_{k}.nc" for k in range(1, 6)),
    }
    assert {path.name for path in paths} == expected == {path.name for path in out.iterdir()}
    return out


def test_dxf_holds_the_centreline_as_true_arcs(mold: Mold, files: Path) -> None:
    document = ezdxf.readfile(files / "base.dxf")
    assert document.header["$INSUNITS"] == 4
    assert {"OUTLINE", "GROOVE", "CENTERLINE", "HOLES", "TEXT"} <= {layer.dxf.name for layer in document.layers}
    space = document.modelspace()
    arcs = sorted(space.query('ARC[layer=="CENTERLINE"]'), key=lambda arc: arc.dxf.radius)
    lines = list(space.query('LINE[layer=="CENTERLINE"]'))
    assert (len(arcs), len(lines)) == (2, 4)
    for arc, tube in zip(arcs, TUBES, strict=True):
        assert arc.dxf.radius == pytest.approx(1e3 * 0.93 / abs(tube.curvature), abs=1e-6)
        turn = math.radians((arc.dxf.end_angle - arc.dxf.start_angle) % 360)
        assert turn * arc.dxf.radius == pytest.approx(tube.curved_length * 1e3, abs=1e-6)
        # The leads are tangent to the arc where they meet it.
        for angle, end in ((arc.dxf.end_angle, arc.end_point), (arc.dxf.start_angle, arc.start_point)):
            meeting = [
                line for line in lines if min((line.dxf.start - end).magnitude, (line.dxf.end - end).magnitude) < 1e-6
            ]
            assert len(meeting) == 1
            way = (meeting[0].dxf.end - meeting[0].dxf.start).normalize()
            radial = (math.cos(math.radians(angle)), math.sin(math.radians(angle)))
            assert way.x * radial[0] + way.y * radial[1] == pytest.approx(0.0, abs=1e-9)
    assert dxf_deviation(drawn(mold), files / "base.dxf") < 1e-6
    loops = list(space.query('LWPOLYLINE[layer=="GROOVE"]'))
    assert all(loop.closed for loop in (*loops, *space.query('LWPOLYLINE[layer=="OUTLINE"]')))
    parts = [part for loop in loops for part in loop.virtual_entities()]
    walls = sorted(part.dxf.radius for part in parts if part.dxftype() == "ARC")
    widths = [walls[1] - walls[0], walls[3] - walls[2]]
    assert widths == pytest.approx([groove.width * 1e3 for groove in mold.grooves], abs=1e-9)
    assert len(space.query('CIRCLE[layer=="HOLES"]')) == len(mold.holes)
    lid = ezdxf.readfile(files / "lid.dxf").modelspace()
    assert len(lid.query('CIRCLE[layer=="HOLES"]')) == len(mold.lid_holes)
    assert len(lid.query('LWPOLYLINE[layer=="GROOVE"]')) == len(mold.slots) == 2
    assert not document.audit().errors


def test_a_dxf_of_another_mold_is_seen(mold: Mold, files: Path, tmp_path: Path) -> None:
    other = plan_mold(TUBES, MoldSpec(springback=Springback(0.0701)))
    assert dxf_deviation(drawn(other), files / "base.dxf") > 1e-6
    (tmp_path / "bad.dxf").write_text("no drawing", encoding="utf-8")
    with pytest.raises(InputError, match="not a DXF file"):
        dxf_deviation(drawn(mold), tmp_path / "bad.dxf")


def test_solids_are_watertight_and_of_the_right_volume(mold: Mold, files: Path) -> None:
    removed = sum(groove.width * groove.centreline.length * groove.depth for groove in mold.grooves)
    area = mold.size[0] * mold.size[1]
    drilled = sum(math.pi / 4 * hole.diameter**2 for hole in mold.holes)
    vented = sum(math.pi / 4 * vent.diameter**2 for vent in (*mold.vents, *(e for s in mold.slots for e in s.exits)))
    wanted = {
        "base": (area - drilled) * mold.spec.plate.thickness - removed,
        "lid": (area - drilled - vented) * mold.spec.plate.lid_thickness,
    }
    for part, volume in wanted.items():
        mesh = trimesh.load_mesh(files / f"{part}.stl")
        assert mesh.is_watertight
        assert mesh.is_winding_consistent
        assert mesh.volume * 1e-9 == pytest.approx(volume, rel=1e-4)
        # The grooves themselves, not only the plate around them.
        if part == "base":
            full = (area - drilled) * mold.spec.plate.thickness
            assert full - mesh.volume * 1e-9 == pytest.approx(removed, rel=5e-3)
            assert mesh.bounds[:, 2] == pytest.approx([-12.7, 0.0], abs=1e-5)
        else:
            assert mesh.bounds[:, 2] == pytest.approx([0.0, 6.35], abs=1e-5)


def test_a_solid_that_is_not_right_is_refused(mold: Mold, files: Path, tmp_path: Path) -> None:
    mesh = trimesh.load_mesh(files / "base.stl")
    assert volume_fault(mold, "base", mesh) == ""
    assert volume_fault(mold, "lid", mesh).startswith("the volume of the lid is off by")
    cube = manifold().Manifold.cube((1.0, 1.0, 1.0))
    with pytest.raises(SolveError, match=r"said\.stl: it is a cube"):
        write_solid(Part("base", lambda: cube, lambda _: "it is a cube", ()), tmp_path / "said.stl")
    whole = cube.to_mesh()
    torn = SimpleNamespace(
        to_mesh=lambda: SimpleNamespace(vert_properties=whole.vert_properties, tri_verts=whole.tri_verts[1:])
    )
    with pytest.raises(SolveError, match=r"torn\.stl: the solid of the base is not watertight"):
        write_solid(Part("base", lambda: torn, lambda _: "", ()), tmp_path / "torn.stl")
    assert list(tmp_path.iterdir()) == []


def moves(text: str) -> list[tuple[str, dict[str, float]]]:
    """Motions of a program: word and numbers, by another reader than the library's."""
    found = []
    for line in text.splitlines():
        match = re.match(r"(G[0-3]) ((?:[XYZIJF][-+\d.]+ ?)+)$", line)
        if match:
            found.append((match[1], {w[0]: float(w[1:]) for w in match[2].split()}))
    return found


def test_gcode_follows_the_centreline() -> None:
    mold = plan_mold(THESIS, MoldSpec(springback=BACK))
    groove = mold.grooves[0]
    (bend,) = groove.centreline.bend
    x = y = z = 0.0
    radius, centre = groove.radius * 1e3, np.asarray(bend.centre) * 1e3
    deepest, arcs, depths = 0.0, 0, []
    for word, to in moves(groove_gcode(mold)):
        end = (to.get("X", x), to.get("Y", y))
        if word == "G2":
            arcs += 1
            about = np.array([x + to["I"], y + to["J"]])
            assert np.linalg.norm(about - centre) < 0.01
            assert np.linalg.norm(np.array([x, y]) - centre) == pytest.approx(radius, abs=0.01)
            assert np.linalg.norm(np.array(end) - centre) == pytest.approx(radius, abs=0.01)
            assert end == pytest.approx([1e3 * c for c in bend.end], abs=0.01)
            depths.append(z)
        if word == "G1" and "Z" in to:
            # Down only beyond the plate's edge.
            outside = max(-x, x - mold.size[0] * 1e3, -y, y - mold.size[1] * 1e3)
            assert outside > groove.mill.diameter * 1e3 / 2
        if word == "G0" and ("X" in to or "Y" in to):
            assert z == pytest.approx(5.0)
        z = to.get("Z", z)
        deepest = min(deepest, z)
        x, y = end
    assert deepest == pytest.approx(-groove.depth * 1e3, abs=1e-4)
    assert depths == pytest.approx([-0.5, -1.0, -1.5, -2.0])
    assert arcs == 4
    assert toolpath_deviation(mold, groove_gcode(mold)) < 1e-6


def test_gcode_of_a_groove_wider_than_its_cutter() -> None:
    spec = MoldSpec(milling=MillingSpec(end_mills=(EndMill(1.2e-3),), step_down=1e-3))
    mold = plan_mold(THESIS, spec)
    groove = mold.grooves[0]
    deep = [
        cut.piece for cut in read_gcode(groove_gcode(mold)) if cut.piece.length and abs(cut.end + groove.depth) < 1e-7
    ]
    # Every point of the groove is within the cutter's radius of some way, and no way leaves the groove.
    for offset in np.linspace(-groove.width / 2, groove.width / 2, 9):
        points = groove.centreline.offset(float(offset)).sample(1e-3)
        near = np.min([piece.distance(points) for piece in deep], axis=0)
        assert near.max() <= groove.mill.diameter / 2 + 1e-6
    outermost = max(abs(offset) for offset in groove.cutter_offsets) + groove.mill.diameter / 2
    assert outermost == pytest.approx(groove.width / 2, abs=1e-9)
    assert toolpath_deviation(mold, groove_gcode(mold)) < 1e-6


def test_gcode_that_strays_is_seen(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    mold = plan_mold(THESIS)
    good = groove_gcode(mold)
    arc = next(line for line in good.splitlines() if line.startswith("G2 X"))
    strayed = re.sub(r"X([\d.]+)", lambda m: f"X{float(m[1]) + 0.1:.4f}", arc)
    shifted = re.sub(r" X(-?[\d.]+)", lambda m: f" X{float(m[1]) + 0.02:.4f}", good)
    assert toolpath_deviation(mold, shifted) > 1e-5
    with pytest.raises(InputError, match="the arc's ends lie"):
        toolpath_deviation(mold, good.replace(arc, strayed))
    shallow = good.replace("Z-2.0000", "Z-1.9000")
    assert toolpath_deviation(mold, shallow) == math.inf
    with pytest.raises(InputError, match="must be words of a letter and a number"):
        read_gcode("G1 X1 Y@\n")
    monkeypatch.setattr("tubeopt.shaping.mold.gcode.groove_gcode", lambda _: shifted)
    with pytest.raises(SolveError, match="from its groove"):
        write_mold(mold, tmp_path)
    assert not list(tmp_path.iterdir())


def test_svg_has_the_layers_in_true_size(mold: Mold, files: Path) -> None:
    root = ElementTree.parse(files / "base.svg").getroot()
    name = "{http://www.w3.org/2000/svg}"
    groups = {group.get("id"): group for group in root.iter(f"{name}g") if group.get("id")}
    assert set(groups) == {"OUTLINE", "GROOVE", "CENTERLINE", "HOLES", "TEXT"}
    assert root.get("width", "").endswith("mm")
    assert len(list(groups["HOLES"])) == len(mold.holes)
    arcs = [path.get("d", "") for path in groups["CENTERLINE"] if " A" in path.get("d", "")]
    radii = sorted(float(arc.split(" A")[1].split(",")[0]) for arc in arcs)
    assert radii == pytest.approx(sorted(groove.radius * 1e3 for groove in mold.grooves), abs=1e-6)


def test_pictures_and_sheet(mold: Mold, tmp_path: Path) -> None:
    many = plan_mold((THESIS,) * 4)
    plot_setup_sheet(many, tmp_path / "setup.pdf", title="robot")
    content = (tmp_path / "setup.pdf").read_bytes()
    assert content.startswith(b"%PDF")
    assert len(re.findall(rb"/Type /Page\b", content)) == 1
    plot_mold(many, tmp_path / "mold.png")
    with pytest.raises(InputError, match="must end in"):
        plot_setup_sheet(mold, tmp_path / "setup.doc")


@pytest.mark.parametrize(("library", "hint"), [("ezdxf", "DXF"), ("manifold3d", "STL"), ("trimesh", "STL")])
def test_a_missing_library_is_named(
    library: str, hint: str, mold: Mold, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    missing = rf"{hint} files need {library}: python -m pip install 'tubeopt\[fabrication\]'"
    if hint == "DXF":
        with pytest.raises(InputError, match=missing):
            write_dxf(draw_plate(mold, "base"), drawn(mold), tmp_path / "x")
    else:
        with pytest.raises(InputError, match=missing):
            write_solid(plate_part(mold, "base"), tmp_path / "x")


def test_what_needs_a_missing_library_is_left_out_with_a_warning(
    mold: Mold, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setitem(sys.modules, "ezdxf", None)
    monkeypatch.setitem(sys.modules, "trimesh", None)
    paths = write_mold(mold, tmp_path)
    assert all(path.is_file() for path in paths)
    assert {path.suffix for path in paths} == {".svg", ".nc"}
    assert {record.getMessage() for record in caplog.records} == {
        f"left out: {kind} files need {library}: python -m pip install 'tubeopt[fabrication]'"
        for kind, library in (("DXF", "ezdxf"), ("STL", "trimesh"))
    }
