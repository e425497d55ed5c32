"""Mandrels of space curves, read back from their files and compared with the integrated curvature."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tubeopt import ConcentricRobot, InputError, MoldSpec, Piece, Tube, forward_kinematics, load_robot
from tubeopt.shaping import Springback, plan_mandrel, predict_wound_tube, write_mandrel
from tubeopt.shaping.materials import STEEL
from tubeopt.shaping.mold.mandrel import (
    Block,
    Cylinder,
    Mandrel,
    channel,
    exits_of,
    mandrel_gcode,
    mandrel_part,
    slot_depths,
    slot_wall,
    solid_off_curve,
)
from tubeopt.shaping.mold.mold import chosen_tubes
from tubeopt.show.fabrication_report import MandrelReport
from tubeopt.show.plots.mold import plot_mandrel
from tubeopt.show.plots.sheets import mandrel_numbers, mandrel_steps, plot_setup_sheet

trimesh = pytest.importorskip("trimesh")
pytest.importorskip("manifold3d")
pytest.importorskip("rtree")

BACK = Springback(0.07, shrinkage=0.004)
SIZES = (1.6e-3, 1.2e-3)
TUBES = {
    "left": Tube.of_pieces(*SIZES, [Piece.helix(0.16, 14e-3, 24e-3, left=True)], straight_length=20e-3),
    "right": Tube.of_pieces(1.92e-3, 1.5e-3, [Piece.helix(0.06, 25e-3, 60e-3), Piece.helix(0.03, 25e-3, 60e-3)]),
    "slender": Tube.of_pieces(*SIZES, [Piece.helix(0.09, 3e-3, 90e-3)]),
    "general": Tube.of_pieces(*SIZES, [Piece(0.05, (14.0, 0.0, 0.0)), Piece(0.05, lambda s: (10.0, 100 * s, 8.0))]),
}


def asked(tube: Tube, back: Springback, places: np.ndarray) -> np.ndarray:
    """(N, 3) points at arc lengths (N,) of the curve that springs back to the tube, by Runge and Kutta."""
    kept, longer = 1 - back.fraction, 1 / (1 - back.shrinkage)
    state, begin, found = np.concatenate([np.zeros(3), np.eye(3).ravel()]), 0.0, []
    for piece in tube.pieces:
        length = piece.length * longer

        def rate(s: float, y: np.ndarray, piece: Piece = piece) -> np.ndarray:
            x, y_, z = (float(q(np.array([s / longer]))[0]) if callable(q) else q for q in piece.precurvature)
            R = y[3:].reshape(3, 3)
            hat = np.array([[0, -z, y_ / kept], [z, 0, -x / kept], [-y_ / kept, x / kept, 0]])
            return np.concatenate([R[:, 2], (R @ hat).ravel()])

        inside = (places >= begin - 1e-12) & (places <= begin + length + 1e-12) & (places > begin - (begin == 0))
        at = np.clip(places[inside] - begin, 0.0, length)
        walked = solve_ivp(rate, (0.0, length), state, "DOP853", dense_output=True, rtol=1e-11, atol=1e-13)
        found.append(walked.sol(at)[:3].T)
        state, begin = walked.y[:, -1], begin + length
    return np.vstack(found)[: len(places)]


def laid(points: np.ndarray, onto: np.ndarray) -> np.ndarray:
    """Points moved rigidly, nothing mirrored, so that they lie on others as closely as can be (Kabsch)."""
    a, b = points - points.mean(axis=0), onto - onto.mean(axis=0)
    u, _, v = np.linalg.svd(a.T @ b)
    turn = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v))]) @ v
    return a @ turn + onto.mean(axis=0)


def off(tube: Tube, arc_length: np.ndarray, points: np.ndarray) -> float:
    """Greatest distance (m) of points at arc lengths from where the asked curve has them."""
    return float(np.linalg.norm(laid(asked(tube, BACK, arc_length), points) - points, axis=1).max())


@pytest.fixture(scope="module", params=list(TUBES))
def made(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Tube, Mandrel, Path]:
    tube, out = TUBES[request.param], tmp_path_factory.mktemp("mandrel")
    mandrel = plan_mandrel(tube, MoldSpec(springback=BACK))
    turned = request.param in ("left", "right")
    assert isinstance(mandrel.body, Cylinder if turned else Block)
    names = {path.name for path in write_mandrel(mandrel, out)}
    assert names == {"mandrel.stl"} | ({"mandrel.csv", "mandrel.nc"} if turned else set())
    return tube, mandrel, out


def test_the_solid_has_its_groove_where_spring_back_asks(made: tuple[Tube, Mandrel, Path]) -> None:
    tube, mandrel, out = made
    mesh = trimesh.load_mesh(out / "mandrel.stl")
    assert mesh.is_watertight
    s, own = (field[mandrel.winding.bend] for field in (mandrel.winding.arc_length, mandrel.winding.points))
    curve = laid(asked(tube, BACK, s), own)
    assert np.linalg.norm(curve - own, axis=1).max() < 1e-6
    away = trimesh.proximity.closest_point(mesh, curve[::6] * 1e3)[1] / 1e3
    assert np.abs(away - mandrel.width / 2).max() < 1e-5
    # Nothing is left in the tube's way, from one end of the leads to the other, nor above it.
    inside = mesh.contains(mandrel.winding.points[1:-1:8] * 1e3)
    assert not inside.any()
    assert solid_off_curve(mandrel, mesh) == ""


def test_the_table_of_a_turned_one_is_the_helix(made: tuple[Tube, Mandrel, Path]) -> None:
    tube, mandrel, out = made
    if not isinstance(mandrel.body, Cylinder):
        return
    table = np.loadtxt(out / "mandrel.csv", delimiter=",", skiprows=1)
    s, feed, turn, tip = table.T * np.array([[1e-3], [1e-3], [math.pi / 180], [1e-3]])
    bend = (s >= 0) & (s <= mandrel.held.curved_length + 1e-9)
    centre = tip + mandrel.width / 2
    points = np.column_stack([feed, centre * np.cos(turn), centre * np.sin(turn)])
    assert off(tube, s[bend], points[bend]) < 1e-6
    # A handed helix: what is wound to the other side lies nowhere near.
    mirrored = points * np.array([1.0, 1.0, -1.0])
    assert off(tube, s[bend], mirrored[bend]) > 1e-3
    # The leads are straight, and tangent.
    lead = points[s > mandrel.held.curved_length]
    ways = np.diff(lead, axis=0)
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    assert np.abs(ways[1:-1] - ways[1]).max() < 1e-3
    text = (out / "mandrel.nc").read_text()
    deepest = text.split("G93")[-1]
    moves = np.array(
        [[float(x) for x in row] for row in re.findall(r"X([-\d.]+) A([-\d.]+) Z([-\d.]+) F", deepest)]
    ) * [1e-3, math.pi / 180, 1e-3]
    centre = moves[:, 2] + mandrel.width / 2
    cut = np.column_stack([moves[:, 0], centre * np.cos(moves[:, 1]), centre * np.sin(moves[:, 1])])
    assert np.abs(cut - points[1:]).max() < 1e-6
    # The tip touches the cylinder at the height that the program says, and steel is cut slower than a board.
    assert f"(Z is 0 on the axis and {1e3 * mandrel.body.radius:.4f} on the cylinder)" in text
    assert max(map(len, text.splitlines())) < 75
    steel = mandrel_gcode(plan_mandrel(tube, MoldSpec(springback=BACK, material=STEEL)))
    speeds = [float(re.findall(r"M3 S(\d+)", each)[0]) for each in (text, steel)]
    assert speeds[0] == 12000
    assert math.pi * mandrel.width * speeds[1] == pytest.approx(27.0, rel=1e-3)
    rates = [float(re.findall(r"G93\nG1 .* F([\d.]+)", each)[0]) for each in (text, steel)]
    assert rates[1] / rates[0] == pytest.approx(0.02e3 * mandrel.width * speeds[1] / 300, rel=0.01)


def test_the_sheet_of_a_mandrel_says_how_it_is_made(made: tuple[Tube, Mandrel, Path]) -> None:
    _, mandrel, _ = made
    numbers, steps = mandrel_numbers(mandrel), " ".join(mandrel_steps(mandrel))
    # Of ceramic or board: water would crack it. Turned of metal it goes into water.
    assert "Never put a hot mandrel of ceramic or board into water" in steps
    metal = " ".join(mandrel_steps(replace(mandrel, spec=replace(mandrel.spec, material=STEEL))))
    assert ("quench the mandrel with the tube in water" in metal) == isinstance(mandrel.body, Cylinder)
    low, high = (float(x) for x in numbers["limits of its width"].split(" to "))
    assert low == pytest.approx(1e3 * mandrel.tube.outer_diameter + 0.05)
    assert low <= 1e3 * mandrel.width <= high
    if not isinstance(mandrel.body, Cylinder):
        assert "ceramic cord pressed into the slot" in steps
        return
    assert f"Turn it to {2e3 * mandrel.body.radius:.3f} ± 0.05 mm" in steps
    assert "X 25 at the face of the jaws" in steps
    # The radius of curvature of a helix, by finite differences along it, 0.05 mm further in and out.
    c, found = mandrel.body.advance, []
    for r in mandrel.body.helix_radius + np.array([-0.05e-3, 0.05e-3]):
        t = np.arange(3) * 1e-3
        p = np.column_stack([c * t, r * np.cos(t), r * np.sin(t)])
        ways = np.diff(p, axis=0)
        turn = np.linalg.norm(np.diff(ways / np.linalg.norm(ways, axis=1)[:, None], axis=0))
        found.append(1e3 * np.linalg.norm(ways[0]) / turn)
    told = next(value for name, value in numbers.items() if name.startswith("radius in a groove"))
    assert [float(x) for x in told.split(" to ")] == pytest.approx(sorted(found), abs=0.006)


def test_what_comes_off_is_what_was_asked_for(made: tuple[Tube, Mandrel, Path]) -> None:
    tube, mandrel, _ = made
    again = predict_wound_tube(mandrel)
    tips = [forward_kinematics(ConcentricRobot([t]), [0.0]).tip_position for t in (tube, again)]
    assert np.linalg.norm(tips[0] - tips[1]) < 1e-9
    other = predict_wound_tube(mandrel, springback=Springback(0.1))
    assert other.curvature == pytest.approx(tube.curvature / 0.93 * 0.9)


def test_a_solid_of_another_mandrel_is_seen(made: tuple[Tube, Mandrel, Path]) -> None:
    tube, _, out = made
    other = plan_mandrel(tube, MoldSpec(springback=Springback(0.09)))
    assert solid_off_curve(other, trimesh.load_mesh(out / "mandrel.stl")).endswith("um from the curve")


@pytest.mark.parametrize("name", ["left", "general"])
def test_pictures(name: str, tmp_path: Path) -> None:
    """Of one that is turned, and of one that is printed."""
    mandrel = plan_mandrel(TUBES[name], MoldSpec(springback=BACK))
    plot_mandrel(mandrel, tmp_path / "mandrel.png")
    plot_setup_sheet(mandrel, tmp_path / "setup.png")
    assert all((tmp_path / name).stat().st_size > 10_000 for name in ("mandrel.png", "setup.png"))


def test_a_printed_mandrel_is_told() -> None:
    tube = load_robot(Path(__file__).parents[2] / "configs/robots/example_pieces.yaml").tubes[0]
    rows = dict(MandrelReport(plan_mandrel(tube)).rows())
    assert rows["turned or printed"] == "printed"
    assert "helix, pitch" not in rows


@pytest.mark.parametrize(
    ("pieces", "message"),
    [
        ([Piece(0.05, 10.0)], "tube 1 is planar; use a plate, not a mandrel"),
        ([Piece.helix(0.2, 20e-3, 4e-3)], "leave 2.348 mm of wall between them; it must be at least 3 mm"),
        ([Piece.helix(0.05, 10e-3, 3e-3, left=True)], "tube 1 is strained 7.98 %"),
        ([Piece.helix(0.3, 5e-3, 6e-3)], "tube 1 is strained"),
        (
            [Piece.helix(0.15, 20e-3, 4e-3), Piece(0.1, (30.0, 0.0, 0.0)), Piece.helix(0.15, 20e-3, 9e-3, left=True)],
            "a helix of at least",
        ),
    ],
)
def test_what_cannot_be_wound_is_refused(pieces: Any, message: str) -> None:
    tube = Tube.of_pieces(*SIZES, pieces)
    if not tube.general:
        tube = Tube(*SIZES, 0.0, 0.05, 10.0)
    with pytest.raises(InputError) as error:
        plan_mandrel(tube, None)
    assert message in str(error.value)


def test_the_mold_of_a_robot_leaves_space_curves_out() -> None:
    robot = ConcentricRobot([TUBES["left"], Tube(2.2e-3, 1.9e-3, 10e-3, 60e-3, 8.0)])
    assert chosen_tubes(robot) == ([2], ["tube 1 is a space curve and takes a mandrel: tubeopt mold mandrel"])
    with pytest.raises(InputError, match="no tube of this robot is planar"):
        chosen_tubes(ConcentricRobot([TUBES["left"]]))


def test_sheet_and_solid_of_a_block_agree_on_its_slot(made: tuple[Tube, Mandrel, Path]) -> None:
    """Rays from above meet the floor of the groove at the depths of the sheet; an end that rises has a notch."""
    _, mandrel, out = made
    if isinstance(mandrel.body, Cylinder):
        return
    mesh, w, height = trimesh.load_mesh(out / "mandrel.stl"), mandrel.winding, mandrel.body.size[2]
    near = [0.95 * w.points[k] + 0.05 * w.points[k + step] for k, step in ((0, 1), (-1, -1))]
    points = np.vstack([w.points[2:-2:5], near])
    above = np.column_stack([1e3 * points[:, :2], np.full(len(points), 1e3 * height + 1)])
    hits, rays, _ = mesh.ray.intersects_location(above, np.tile([0.0, 0.0, -1.0], (len(above), 1)))
    floors = [1e3 * height - hits[rays == k, 2].max() for k in range(len(points))]
    least, greatest = (1e3 * depth for depth in slot_depths(mandrel))
    assert min(floors) <= least + 0.3
    assert max(floors) == pytest.approx(greatest, abs=0.3)
    for end in exits_of(mandrel):
        inside = (end.point[:2] > 1e-3) & (end.point[:2] < np.array(mandrel.body.size[:2]) - 1e-3)
        assert end.upper == (end.point[2] == pytest.approx(height, abs=2e-4) and inside.all())
        assert end.upper <= (end.notch is not None)
    rising = exits_of(plan_mandrel(load_robot("example_pieces").tubes[0]))
    assert [end.upper for end in rising] == [False, True]
    notched = any(end.notch is not None for end in exits_of(mandrel))
    assert ("with a notch" in " ".join(mandrel_steps(mandrel))) == notched


def test_no_end_of_a_block_crosses_another_turn_or_leaves_by_its_bottom() -> None:
    """Brute force over all points in the block, seen from above: a lead lies at least a wall from other turns."""
    mandrel = plan_mandrel(load_robot("example_pieces").tubes[0])
    w, body = mandrel.winding, mandrel.body
    assert isinstance(body, Block)
    inside = w.points[:, 2] <= body.size[2]
    points, s = w.points[inside, :2], w.arc_length[inside]
    # Along the curve three slots on, only other turns are near.
    far = np.abs(s[:, None] - s) > 3 * body.slot
    apart = np.where(far, np.linalg.norm(points[:, None] - points, axis=2), np.inf).min()
    assert apart >= 0.5 * (body.slot + mandrel.width) + mandrel.spec.groove.wall - 1e-4
    assert slot_wall(body, w) == pytest.approx(apart - body.slot, abs=1e-4)
    assert w.points[:, 2].min() >= 0.5 * mandrel.width + mandrel.spec.groove.floor - 1e-9
    # The straight end before the bend, as long as its tube's, by its slope alone.
    steep = w.tangents[w.bend][0][2]
    beneath = 0.5 * mandrel.tube.outer_diameter + mandrel.tube.straight_length * steep - w.points[w.bend][0][2]
    assert beneath == pytest.approx(-mandrel.envelope[0][2], abs=1e-6)
    (said,) = re.findall(r"reaches (\d+) mm below the block", " ".join(mandrel_steps(mandrel)))
    assert float(said) == pytest.approx(1e3 * beneath, abs=0.5)


def test_a_tube_is_lowered_into_the_slot_of_a_block(made: tuple[Tube, Mandrel, Path]) -> None:
    """A tube comes from above to the floor of its groove, and a brush nearly as wide as the slot to the slopes."""
    _, mandrel, _ = made
    if isinstance(mandrel.body, Cylinder):
        return
    w, body = mandrel.winding, mandrel.body
    assert body.slot > 1.8 * mandrel.width
    assert mandrel.width == pytest.approx(mandrel.tube.outer_diameter + 0.15e-3)
    solid, ups = mandrel_part(mandrel).solid(), np.tile([0.0, 0.0, 1.0], (len(w.points), 1))
    tall = np.full(len(w.points), body.size[2])
    radius = 0.5 * mandrel.tube.outer_diameter
    lowered = channel(w.points, w.tangents, ups, tall, radius, 1e-6)
    assert lowered.volume() > 1000 * (lowered ^ solid).volume()
    assert (lowered ^ solid).volume() < 1e-3
    slopes = radius + 0.5 * (body.slot - mandrel.width)
    brush = channel(w.points + (slopes + 0.47 * body.slot) * ups, w.tangents, ups, tall, 0.47 * body.slot, 1e-5)
    assert (brush ^ solid).volume() < 1e-3
    # Below the slopes the walls hold the tube to the sides.
    wide = channel(w.points, w.tangents, ups, np.full(len(w.points), radius), 0.6 * mandrel.width, 1e-6)
    left = 0.5 * math.pi * (0.36 - 0.25) * mandrel.width**2 + 0.2 * mandrel.width * radius
    length = w.arc_length[-1] - w.arc_length[0]
    # Walls rise along z, not perpendicular to the curve: the area is that of level parts.
    assert 1e-9 * (wide ^ solid).volume() == pytest.approx(left * length, rel=0.2)
    said = " ".join(mandrel_steps(mandrel))
    assert f"widens at 45° to {1e3 * body.slot:g} mm" in said
    assert mandrel_numbers(mandrel)["slot above the groove, width / depth of its floor"].startswith(
        f"{1e3 * body.slot:g} / "
    )
