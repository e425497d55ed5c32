"""Pegs on a drilled board: the beam between them, their heat, their places, their files; all against others' work."""

from __future__ import annotations

import csv
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy

from tubeopt import InputError, MoldSpec, Tube, load_robot
from tubeopt.shaping import PegBoard, PegSpec, Springback, plan_pegs
from tubeopt.shaping.mold.beam import held_between
from tubeopt.shaping.mold.peg_files import board_programs, write_pegs
from tubeopt.shaping.mold.pegs import peg_heat, tube_in_air
from tubeopt.shaping.mold.robot import chosen_tubes
from tubeopt.shaping.mold.spec import WorkshopSpec
from tubeopt.typing import Array

from .gcode_machine import mill
from .heating_reference import CONFIGS, TUBE

ROBOTS = sorted(path.name for path in (CONFIGS / "robots").glob("*.yaml"))


def tube_of(robot: str, number: int) -> Tube:
    tube: Tube = load_robot(CONFIGS / "robots" / robot).tubes[number - 1]
    return tube


def test_a_straight_beam_that_is_pushed_in_its_middle() -> None:
    """Clamped at both ends: the middle gives way by F L^3 / (192 EI)."""
    length, by = 0.12, 0.3e-3
    held = held_between(np.array([length]), np.zeros(1), np.array([length / 2]), np.ones(1), np.array([-by]))
    assert held.offset.min() == pytest.approx(-by, rel=1e-9)
    assert held.force[0] == pytest.approx(192 * by / length**3, rel=1e-6)
    x = held.arc_length[held.arc_length <= length / 2]
    shape = -by * (3 * (2 * x / length) ** 2 - 2 * (2 * x / length) ** 3)
    assert held.offset[: len(x)] == pytest.approx(shape, abs=1e-12)


def test_a_straight_beam_that_is_pushed_anywhere() -> None:
    """A support stands where it is said to, not at the next node: clamped at both ends by F a^3 b^3 / (3 EI L^3)."""
    length, by = 0.12, 0.3e-3
    for a in (0.0431234567891, 0.0812345678949):
        held = held_between(np.array([length]), np.zeros(1), np.array([a]), np.ones(1), np.array([-by]))
        assert held.force[0] == pytest.approx(3 * by * length**3 / (a * (length - a)) ** 3, rel=1e-6)
        assert np.interp(a, held.arc_length, held.offset) == pytest.approx(-by, rel=1e-5)


def test_a_support_does_not_pull() -> None:
    held = held_between(
        np.array([0.1]), np.zeros(1), np.array([0.03, 0.06]), np.array([1.0, -1.0]), np.array([1e-4, 0.0])
    )
    assert (held.force == 0).all()
    assert np.abs(held.offset).max() == 0


def test_a_ring_wants_to_be_wider() -> None:
    held = held_between(np.full(1, 0.1), np.full(1, 8.0), np.array([0.05]), np.ones(1), np.array([1.0]))
    # Nothing touches, and clamps alone hold it. Euler's equation of the energy: (D^2 + k^2 / 2)^2 w = -k^3 / 2.
    k = 8.0

    def slopes(_: Array, y: Array) -> Array:
        return np.vstack([y[1:], -(k**2) * y[2] - k**4 / 4 * y[0] - k**3 / 2])

    def clamped(a: Array, b: Array) -> Array:
        return np.array([a[0], a[1], b[0], b[1]])

    solved = scipy.integrate.solve_bvp(slopes, clamped, np.linspace(0, 0.1, 50), np.zeros((4, 50)), tol=1e-8)
    assert held.offset.min() < -50e-6
    assert held.offset == pytest.approx(solved.sol(held.arc_length)[0], abs=5e-9)


def _nonlinear(board: PegBoard, count: int = 60) -> tuple[Array, Array]:
    """Arc lengths and offsets of the elastica of least energy between clamps, as a chain of stiff links."""
    curve, spec = board.centreline, board.spec.pegs
    start, end = (np.array(p) for p in (curve.lead_in.start, curve.lead_out.end))
    first, last = (piece.tangent(np.zeros(1))[0] for piece in (curve.lead_in, curve.lead_out))
    ends = [math.atan2(t[1], t[0]) for t in (first, last)]
    s = (np.arange(count) + 0.5) / count * curve.length
    heading = np.interp(s, *_headings(board))
    radius = 0.5 * (board.tube.outer_diameter + spec.pin)
    pins = np.array([peg.pin for peg in board.pegs])
    sides = np.array([1.0 if peg.left else -1.0 for peg in board.pegs])
    link = np.array([np.searchsorted(s, peg.arc_length) for peg in board.pegs])
    near = np.clip(link[:, None] + np.arange(-3, 3), 0, count - 1)

    def points(x: Array) -> Array:
        steps = x[-1] * np.column_stack([np.cos(x[:-1]), np.sin(x[:-1])])
        return start + np.vstack([np.zeros(2), np.cumsum(steps, axis=0)])

    def energy(x: Array) -> float:
        # The first and last half link bend from the clamp.
        bends = np.diff(np.concatenate([[ends[0]], x[:-1], [ends[1]]]))
        weight = np.ones(len(bends))
        weight[[0, -1]] = 2.0
        return float((weight * bends**2).sum() / x[-1]) * 1e-2

    def room(x: Array) -> Array:
        at = points(x)
        away = pins[:, None] - 0.5 * (at[near] + at[near + 1])
        best = np.argmin((away**2).sum(2), axis=1)
        away, angle = away[np.arange(len(pins)), best], x[near[np.arange(len(pins)), best]]
        return 1e3 * (sides * (away[:, 1] * np.cos(angle) - away[:, 0] * np.sin(angle)) - radius)

    found = scipy.optimize.minimize(
        energy,
        np.append(heading, curve.length / count),
        method="SLSQP",
        constraints=[{"type": "eq", "fun": lambda x: 1e3 * (points(x)[-1] - end)}, {"type": "ineq", "fun": room}],
        options={"maxiter": 200, "ftol": 1e-12},
    )
    at = points(found.x)
    where, off = _seen(board, 0.5 * (at[1:] + at[:-1]))
    return where, off


def _headings(board: PegBoard) -> tuple[Array, Array]:
    s, heading, begin = [], [], 0.0
    for piece in board.centreline.pieces:
        places = np.linspace(0.0, piece.length, 20)
        t = piece.tangent(places)
        s.append(begin + places)
        heading.append(np.arctan2(t[:, 1], t[:, 0]))
        begin += piece.length
    return np.concatenate(s), np.concatenate(heading)


def _seen(board: PegBoard, points: Array) -> tuple[Array, Array]:
    """Arc lengths of the nearest places of the curve, and signed distances."""
    places, tangents, lengths, begin = [], [], [], 0.0
    for piece in board.centreline.pieces:
        s = np.linspace(0.0, piece.length, 4000)
        places.append(piece.point(s))
        tangents.append(piece.tangent(s))
        lengths.append(begin + s)
        begin += piece.length
    at, t, s = np.vstack(places), np.vstack(tangents), np.concatenate(lengths)
    near = np.array([np.argmin(((at - p) ** 2).sum(1)) for p in points])
    away = points - at[near]
    return s[near], t[near, 0] * away[:, 1] - t[near, 1] * away[:, 0]


def test_the_tube_between_pegs_is_an_elastica() -> None:
    board = plan_pegs(TUBE, MoldSpec(pegs=PegSpec(most_deviation=0.3e-3)))
    where, off = _nonlinear(board)
    mine = np.interp(where, board.held.arc_length, board.held.offset)
    assert np.abs(board.held.offset).max() > 120e-6
    # The beam is of first order in how far it leaves the curve.
    assert np.abs(off - mine).max() < 9e-6


def test_pins_touch_the_curve_from_outside_and_stand_off_their_holes() -> None:
    board = plan_pegs(tube_of("example_pieces.yaml", 2), MoldSpec(springback=Springback(0.08)))
    spec = board.spec.pegs
    reach = 0.5 * (board.tube.outer_diameter + spec.pin)
    assert len({peg.hole for peg in board.pegs}) == len(board.pegs)
    for peg in board.pegs:
        away = float(board.centreline.distance(np.array([peg.pin]))[0]) - reach
        assert away == pytest.approx(peg.room, abs=0.1e-6)
        assert 0 <= away < 60e-6
        assert math.dist(peg.pin, peg.place) == pytest.approx(spec.eccentricity)
        assert board.holes[peg.hole] == peg.place
        assert peg.angle / spec.angle_step == pytest.approx(round(peg.angle / spec.angle_step))
        assert (_seen(board, np.array([peg.pin]))[1][0] > 0) == peg.left
    assert board.deviation <= spec.most_deviation
    # Bent by what springs back.
    assert np.abs(board.held.wanted).max() == pytest.approx(board.tube.curvature / 0.92, rel=2e-3)
    places = np.array(list(board.holes.values()))
    apart = np.linalg.norm(places[:, None] - places, axis=2) + np.eye(len(places))
    assert apart.min() == pytest.approx(spec.pitch)


def test_pegs_chill_a_tube_like_sinks_a_fin() -> None:
    heat, places, conductance = MoldSpec().heat, np.array([0.030, 0.036, 0.055]), 5e-4
    told = peg_heat(TUBE, heat, places, conductance)
    end = tube_in_air(TUBE, heat)
    loss = end.loss_coefficient * math.pi * TUBE.outer_diameter
    conducts = loss * end.decay_length**2
    count, length = 4801, 0.12
    h = length / (count - 1)
    diagonal = np.full(count, loss * h + 2 * conducts / h)
    diagonal[[0, -1]] = loss * h / 2 + conducts / h
    index = np.round(places / h).astype(int)
    diagonal[index] += conductance
    right = np.zeros(count)
    right[index] = conductance * heat.rise
    bands = np.vstack([np.full(count, -conducts / h), diagonal, np.full(count, -conducts / h)])
    colder = scipy.linalg.solve_banded((1, 1), bands, right)
    assert told.dip == pytest.approx(colder[index], rel=2e-3)
    assert told.drawn == pytest.approx(conductance * (heat.rise - colder[index]), rel=2e-3)


@pytest.mark.parametrize("dialect", ["grbl", "linuxcnc", "mach"])
def test_the_board_is_drilled_where_its_holes_are(dialect: str, tmp_path: Path) -> None:
    board = plan_pegs(TUBE, MoldSpec(workshop=WorkshopSpec(dialect=dialect)))
    seen = mill(board_programs(board)[0].text)
    assert not seen.errors
    assert seen.ended
    thickness = 1e3 * board.spec.plate.thickness
    drilled = np.array([way[-1, :2] for way in seen.cuts if way[:, 2].min() < -thickness])
    wanted = 1e3 * np.array(list(board.holes.values()))
    for places, others in ((wanted, drilled), (drilled, wanted)):
        assert max(np.linalg.norm(others - p, axis=1).min() for p in places) < 0.01
    ezdxf = pytest.importorskip("ezdxf")
    write_pegs(board, tmp_path)
    circles = ezdxf.readfile(tmp_path / "board.dxf").modelspace().query("CIRCLE")
    assert {(round(c.dxf.center.x, 2), round(c.dxf.center.y, 2)) for c in circles} == {
        (round(float(x), 2), round(float(y), 2)) for x, y in wanted
    }
    lines = (tmp_path / "pegs.csv").read_text().splitlines()
    rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    for row, peg in zip(rows, board.pegs, strict=True):
        angle, (x, y) = math.radians(float(row["angle_deg"])), board.holes[row["hole"]]
        assert math.dist((x + 3e-3 * math.cos(angle), y + 3e-3 * math.sin(angle)), peg.pin) < 1e-6


def test_a_cold_end_that_is_given_is_that_of_the_board() -> None:
    board = plan_pegs(TUBE, MoldSpec(cold_length=30e-3))
    overrun = board.spec.solver.pegs.overrun * board.spec.pegs.pitch
    assert board.cold.length == 30e-3
    assert board.centreline.lead_out.length == pytest.approx(30e-3 - overrun)


@pytest.mark.parametrize("robot", ROBOTS)
def test_pegs_for_the_robots(robot: str) -> None:
    """Within 50 um; a tube of 27 mm radius 1 mm thick, and one that changes side at once, are told to be beyond."""
    found = load_robot(CONFIGS / "robots" / robot)
    for number in chosen_tubes(found)[0]:
        board = plan_pegs(found.tubes[number - 1], number=number)
        told = any("leaves its curve" in words for words in board.remarks)
        assert (board.deviation > board.spec.pegs.most_deviation) == told
        assert told == ((robot, number) in (("till_snapping_pair.yaml", 1), ("example_pieces.yaml", 2)))
        assert all(0 <= peg.room < 60e-6 and peg.force > 0 for peg in board.pegs)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: PegSpec(pitch=7e-3), "pitch of the pegs is 7 mm; it must be at least twice the eccentricity"),
        (lambda: PegSpec(pin=-1.0), "pin of the pegs is"),
        (
            lambda: plan_pegs(replace(TUBE, curvature=25.0), MoldSpec(springback=Springback(0.1, 0.02)), number=2),
            "tube 2: curvature is 25 per m; with this spring-back no mold yields more",
        ),
        (lambda: plan_pegs(replace(TUBE, curved_length=0.0, straight_length=0.1)), "has no curved part"),
        (lambda: plan_pegs(tube_of("example_pieces.yaml", 1)), "is a space curve"),
        (lambda: plan_pegs(TUBE, MoldSpec(pegs=PegSpec(board=(0.1, 0.1)))), "board of the pegs is 100 x 100 mm"),
        (lambda: plan_pegs(TUBE, MoldSpec(most_strain=1e-3)), "between its pegs, beyond the 0.1 %"),
    ],
)
def test_nonsense_is_refused(make: object, message: str) -> None:
    with pytest.raises(InputError) as caught:
        make()  # type: ignore[operator]
    assert message in str(caught.value)
