"""Molds of planar tubes of any curvature, read back from their files and compared with the integrated curvature."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from tubeopt import (
    ConcentricRobot,
    InputError,
    Mold,
    MoldSpec,
    Piece,
    Slots,
    Tube,
    forward_kinematics,
    plan_mold,
    predict_tube,
)
from tubeopt.shaping import Springback, write_mold
from tubeopt.shaping.mold.gcode import groove_gcode, toolpath_deviation
from tubeopt.show.plots.sheets import plot_setup_sheet

ezdxf = pytest.importorskip("ezdxf")
trimesh = pytest.importorskip("trimesh")
pytest.importorskip("manifold3d")

BACK = Springback(0.06, 1e-3, shrinkage=0.004)
DIAMETERS = (1.6e-3, 1.2e-3)
S_SHAPE = Tube.of_pieces(
    *DIAMETERS, [Piece(50e-3, 18.0), Piece(20e-3, 0.0), Piece(40e-3, -24.0)], straight_length=30e-3
)
VARIABLE = Tube.of_pieces(*DIAMETERS, [Piece(0.1, lambda s: 25 * math.sin(60 * s) + 4)], straight_length=10e-3)
TURNED = Tube.of_pieces(
    *DIAMETERS, [Piece(0.06, lambda s: ((5 + 200 * s) * 0.6, (5 + 200 * s) * 0.8, 0.0)), Piece(0.03, (6.0, 8.0, 0.0))]
)
TUBES = {"S": S_SHAPE, "variable": VARIABLE, "turned plane": TURNED}
CURVATURES: dict[str, Callable[[float], float]] = {
    "S": lambda s: 18.0 if s < 0.05 else 0.0 if s < 0.07 else -24.0,
    "variable": lambda s: 25 * math.sin(60 * s) + 4,
    "turned plane": lambda s: 5 + 200 * s if s < 0.06 else 10.0,
}
JUMPS = {"S": (0.05, 0.07), "variable": (), "turned plane": (0.06,)}

SIDES = {"S": 1.0, "variable": -1.0, "turned plane": -1.0}
"""To which side the drawing turns where the curvature is positive: on the whole it turns right."""


def asked(name: str, side: float) -> np.ndarray:
    """(N, 2) points (m) of the bend that springs back to the tube, from the origin along x, by Runge and Kutta."""
    shrunk, length = 1 - BACK.shrinkage, TUBES[name].curved_length

    def mold_curvature(wanted: float) -> float:
        size = abs(wanted)
        found = brentq(lambda k: k * (1 - BACK.fraction - BACK.slope * k) - size, 0.0, 2 * size + 1e-12, xtol=1e-14)
        return math.copysign(found, wanted)

    at, heading, points = np.zeros(2), 0.0, [np.zeros((1, 2))]
    ends = [0.0, *JUMPS[name], length]
    for a, b in pairwise(ends):

        def rate(s: float, y: np.ndarray, a: float = a, b: float = b) -> list[float]:
            inside = min(max(s * shrunk, a + 1e-12), b - 1e-12)
            return [math.cos(y[2]), math.sin(y[2]), side * mold_curvature(CURVATURES[name](inside))]

        steps = np.linspace(a, b, math.ceil((b - a) / 1e-4)) / shrunk
        walked = solve_ivp(rate, (steps[0], steps[-1]), [*at, heading], "DOP853", steps, rtol=1e-10, atol=1e-13).y
        at, heading = walked[:2, -1], walked[2, -1]
        points.append(walked[:2, 1:].T)
    return np.vstack(points)


def search_hold(points: np.ndarray, start: np.ndarray, towards: np.ndarray) -> np.ndarray:
    """Points moved so that they begin at `start`, along `towards`."""
    return start + points @ np.array([towards, [-towards[1], towards[0]]])


def apart(points: np.ndarray, line: np.ndarray) -> np.ndarray:
    """(N,) distances (m) of points from a polyline."""
    line = line[np.concatenate([[True], np.linalg.norm(np.diff(line, axis=0), axis=1) > 1e-12])]
    ways = np.diff(line, axis=0)
    out = []
    for p in points:
        along = np.clip(np.sum((p - line[:-1]) * ways, axis=1) / np.sum(ways**2, axis=1), 0.0, 1.0)
        out.append(np.linalg.norm(line[:-1] + along[:, None] * ways - p, axis=1).min())
    return np.array(out)


def on_arc(centre: np.ndarray, radius: float, first: float, sweep: float) -> np.ndarray:
    """Points of an arc, 50 um apart at most."""
    angle = first + np.linspace(0.0, sweep, max(2, math.ceil(radius * abs(sweep) / 5e-5)))
    return centre + radius * np.column_stack([np.cos(angle), np.sin(angle)])


@pytest.fixture(scope="module", params=list(TUBES))
def made(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Mold, Path]:
    mold = plan_mold(TUBES[request.param], MoldSpec(springback=BACK))
    out = tmp_path_factory.mktemp("curve")
    write_mold(mold, out)
    return request.param, mold, out


def test_the_drawing_holds_the_curve(made: tuple[str, Mold, Path]) -> None:
    name, mold, out = made
    entities = list(ezdxf.readfile(out / "base.dxf").modelspace().query('*[layer=="CENTERLINE"]'))
    lead, bend = entities[0], entities[1:-1]
    start, before = np.array(lead.dxf.end)[:2] / 1e3, np.array(lead.dxf.start)[:2] / 1e3
    towards = (start - before) / np.linalg.norm(start - before)
    drawn = []
    for entity in bend:
        if entity.dxftype() == "LINE":
            ends = np.array([entity.dxf.start, entity.dxf.end])[:, :2] / 1e3
            drawn.append(ends[0] + np.linspace(0, 1, 100)[:, None] * (ends[1] - ends[0]))
            continue
        sweep = math.radians((entity.dxf.end_angle - entity.dxf.start_angle) % 360)
        centre = np.array(entity.dxf.center)[:2] / 1e3
        drawn.append(on_arc(centre, entity.dxf.radius / 1e3, math.radians(entity.dxf.start_angle), sweep))
    line = np.vstack(drawn)
    off = apart(search_hold(asked(name, SIDES[name]), start, towards)[::3], line)
    assert off.max() < 1e-6
    # As long as the curve, so that every place along it is where it belongs.
    assert mold.grooves[0].bend_length == pytest.approx(TUBES[name].curved_length / (1 - BACK.shrinkage), abs=1e-6)
    arcs = [entity for entity in bend if entity.dxftype() == "ARC"]
    assert len(arcs) == {"S": 2}.get(name, len(arcs)) <= 60


def test_the_walls_of_the_solid_stand_beside_the_curve(made: tuple[str, Mold, Path]) -> None:
    name, mold, out = made
    (groove,) = mold.grooves
    mesh = trimesh.load_mesh(out / "base.stl")
    assert mesh.is_watertight
    floor = mesh.vertices[np.abs(mesh.vertices[:, 2] + groove.depth * 1e3) < 1e-4][:, :2] / 1e3
    start, towards = np.asarray(groove.centreline.lead_in.end), groove.centreline.lead_in.tangent(np.zeros(1))[0]
    line = search_hold(asked(name, SIDES[name]), start, towards)
    near = apart(floor, line)
    bend = near < groove.width
    assert bend.sum() > 25
    assert np.abs(near[bend] - groove.width / 2).max() < 10e-6


def test_the_cutter_follows_the_curve(made: tuple[str, Mold, Path]) -> None:
    name, mold, out = made
    (groove,) = mold.grooves
    text = (out / "base_1.nc").read_text()
    assert toolpath_deviation(mold, text) < 1e-6
    # By another reader: the two outermost ways stand half the room beside the curve.
    start, towards = np.asarray(groove.centreline.lead_in.end), groove.centreline.lead_in.tangent(np.zeros(1))[0]
    line = search_hold(asked(name, SIDES[name]), start, towards)
    room = (groove.width - groove.mill.diameter) / 2
    x = y = z = 0.0
    for word, rest in re.findall(r"^(G[0-3]) (.*)$", text, re.MULTILINE):
        to = {w[0]: float(w[1:]) for w in rest.split() if w[0] in "XYZIJ"}
        end, z = (to.get("X", x), to.get("Y", y)), to.get("Z", z)
        if word in ("G2", "G3") and z == pytest.approx(-groove.depth * 1e3):
            centre = np.array([x + to["I"], y + to["J"]])
            first, last = (math.atan2(p[1] - centre[1], p[0] - centre[0]) for p in ((x, y), end))
            turn = (last - first) % (2 * math.pi) if word == "G3" else -((first - last) % (2 * math.pi))
            middle = centre + np.linalg.norm(centre - [x, y]) * np.array(
                [math.cos(first + turn / 2), math.sin(first + turn / 2)]
            )
            (away,) = apart(middle[None] / 1e3, line)
            assert away == pytest.approx(room, abs=1e-5)
        x, y = end


@pytest.mark.parametrize("back", [Springback(0.08), BACK], ids=["even", "uneven"])
@pytest.mark.parametrize("name", list(TUBES))
def test_what_comes_out_is_what_was_asked_for(name: str, back: Springback) -> None:
    tube = TUBES[name]
    again = predict_tube(plan_mold(tube, MoldSpec(springback=back)))
    assert len(again.pieces) == len(tube.pieces)
    assert again.curved_length == pytest.approx(tube.curved_length, rel=1e-12)
    tips = [forward_kinematics(ConcentricRobot([t]), [0.3]).tip_position for t in (tube, again)]
    assert np.linalg.norm(tips[0] - tips[1]) < 2e-9


def test_another_spring_back_is_felt_piece_by_piece() -> None:
    mold = plan_mold(S_SHAPE, MoldSpec(springback=Springback(0.08)))
    out = predict_tube(mold, springback=BACK)
    held = 18.0 / 0.92
    assert out.pieces[0].precurvature[0] == pytest.approx(held * (1 - 0.06 - 1e-3 * held), rel=1e-12)
    assert out.pieces[2].length == pytest.approx(40e-3 * (1 - BACK.shrinkage), rel=1e-12)


def test_stiffnesses_stay_with_their_pieces() -> None:
    slots = Slots(0.5)
    soft = Piece(30e-3, 12.0, bending_stiffness=lambda s: 2e-3 + s, torsional_stiffness=1e-3, slots=slots)
    tube = Tube.of_pieces(*DIAMETERS, [soft, Piece(30e-3, 12.0)])
    mold = plan_mold(tube, MoldSpec(springback=BACK))
    assert len(mold.grooves[0].centreline.bend) == 1  # one curvature is one arc, whatever the stiffness
    (first, _) = predict_tube(mold).pieces
    assert first.bending_stiffness(np.array([0.01])) == pytest.approx([2.01e-2 - 0.81e-2], rel=1e-9)
    assert first.torsional_stiffness == 1e-3
    assert first.slots == mold.grooves[0].held.pieces[0].slots == slots


def test_a_mold_of_pieces_beside_ordinary_ones() -> None:
    mold = plan_mold([S_SHAPE, VARIABLE, Tube(1.6e-3, 1.2e-3, 0.0, 60e-3, 15.0)], MoldSpec(springback=BACK))
    assert toolpath_deviation(mold, groove_gcode(mold)) < 1e-6
    plot_setup_sheet(mold)
    alone = plan_mold(Tube(1.6e-3, 1.2e-3, 0.0, 60e-3, 15.0), MoldSpec(springback=BACK)).grooves[0]
    assert mold.grooves[2].curvature == alone.curvature
    assert mold.grooves[2].stock_length >= alone.stock_length - 1e-12


def test_what_no_plate_holds_is_refused() -> None:
    def refused(tube: Tube, spec: MoldSpec | None = None) -> str:
        with pytest.raises(InputError) as error:
            plan_mold(tube, spec)
        return str(error.value)

    helix = Tube.of_pieces(*DIAMETERS, [Piece.helix(0.1, 20e-3, 30e-3)])
    assert refused(helix) == "tube 1 is a space curve; a plate is for planar bends only: use a mandrel"
    planes = Tube.of_pieces(*DIAMETERS, [Piece(0.03, (10.0, 0.0, 0.0)), Piece(0.03, (0.0, 10.0, 0.0))])
    assert "space curve" in refused(planes)
    # By 300 deg to one side, then to the other.
    pretzel = Tube.of_pieces(*DIAMETERS, [Piece(0.131, 40.0), Piece(0.131, -40.0)])
    assert "bends by 600" in refused(pretzel)
    tight = Tube.of_pieces(*DIAMETERS, [Piece(0.02, 10.0), Piece(0.01, lambda s: 80 - 1000 * s)])
    assert "tube 1 is strained 6.4 %" in refused(tight)
    steep = replace(MoldSpec(), springback=Springback(0.1, slope=0.01))
    assert "no mold yields more than 20.25 per m" in refused(S_SHAPE, steep)


@pytest.mark.parametrize("plane", [0.0, 90.0, 180.0, 270.0])
def test_an_s_in_any_plane_with_spring_back_that_grows_has_a_groove(plane: float) -> None:
    """Where the bend runs through zero, round-off in a turned plane cuts stretches of no length."""
    direction = np.array([np.cos(np.radians(plane)), np.sin(np.radians(plane)), 0.0])
    s = np.linspace(0.0, 29e-3, 21)
    between = Piece.table(s, np.outer(13.8 - 31.2 * s / s[-1], direction))
    ends = [Piece(20e-3, tuple(bend * direction)) for bend in (13.8, -17.4)]
    tube = Tube.of_pieces(1.2e-3, 0.9e-3, [ends[0], between, ends[1]], straight_length=50e-3)
    mold = plan_mold(tube, MoldSpec(springback=Springback(0.06, 0.8e-3)))
    assert mold.grooves[0].bend_length == pytest.approx(69e-3, rel=0.02)
