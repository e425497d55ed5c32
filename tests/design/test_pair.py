"""Two robots sized together: what both hold at once, bounded from below; plates that move; the search over both."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy

import tubeopt
from tests.command_line import ROOT, Run, answer, refused
from tests.conftest import draw_quickly
from tests.design.tasks import two_tubes
from tubeopt import ConcentricRobot, DesignTask, InputError, PairReach, PlanOptions, ReachFraction, search_pair
from tubeopt.bodies.frames import base_frame
from tubeopt.design import Free, Strain
from tubeopt.design.optimize import DesignStatus
from tubeopt.equilibrium.arm_surface import ArmSurface
from tubeopt.planning import PairFraction
from tubeopt.show.plots.design import plot_pair_places
from tubeopt.typing import Array

CRL = tubeopt.load_robot(ROOT / "configs" / "robots" / "crl_ctr.yaml")
WITHDRAWN = (np.zeros(3), np.array([-0.02, -0.08, -0.09]))
SHIFT = np.array([0.012, -0.05, -0.085])


def pair(**other: Any) -> PairReach:
    """Two CRL robots 16 mm apart, for places that the one on the left has its tip at."""
    bases = base_frame([-0.008, 0, 0], [0.1, 0, 1]), base_frame([0.008, 0, 0], [-0.1, 0, 1], 0.3)
    tips = [tubeopt.forward_kinematics(CRL, [a, a + 0.2, a], SHIFT).tip_position for a in (0.0, 1.2, 2.4)]
    options = PlanOptions(clearance=5e-4, time_limit=60)
    inputs = {"options": options, "count": 30, **other}
    return PairReach((WITHDRAWN, WITHDRAWN), bases, bases[0].placed(tips), **inputs)


def test_arms_are_no_closer_than_is_told() -> None:
    """Surfaces sampled at 700 places of each arm come no closer than the bound, and hardly stay farther."""
    desired = pair()
    result = desired.evaluate(CRL, CRL, np.zeros(0))
    assert result.reached[0].fraction == 1.0
    gaps = []
    for i, j in np.argwhere(np.isfinite(result.apart)):
        sides = []
        for side, base, k in zip(result.reached, desired.bases, (i, j), strict=True):
            e = side.arm(CRL, k)
            assert e is not None
            line, radius = ArmSurface(e).at(np.linspace(0, e.arc_length[-1], 700))
            assert base.placed(e.tip_position) == pytest.approx(desired.targets[k], abs=1e-3)
            sides.append((base.placed(line), radius))
        (one, thick), (other, thin) = sides
        measured = (scipy.spatial.distance.cdist(one, other) - thick[:, None] - thin).min()
        gaps.append(measured - result.apart[i, j])
    assert gaps
    assert min(gaps) > -1e-6
    assert np.median(gaps) < 4e-4
    assert not result.held.diagonal().any()
    assert result.fraction == result.held.sum() / 6


def test_plates_that_are_moved_hold_what_moved_places_are_for_plates_that_are_not() -> None:
    moving = pair(shift=2e-3, tilt=0.1)
    own = np.array([1e-3, -2e-3, 5e-4, 0.05, -0.02, 0.0, 1e-3, -1e-3, -0.03, 0.04])
    assert moving.ranges.shape == (10, 2)
    reached = replace(moving, bases=moving.plates(own), shift=0.0, tilt=0.0)
    one, other = moving.evaluate(CRL, CRL, own), reached.evaluate(CRL, CRL, np.zeros(0))
    np.testing.assert_allclose(one.apart, other.apart, atol=1e-9)


def test_arms_are_the_ones_to_which_ways_lead_not_those_that_a_robot_takes_at_once() -> None:
    """At these joint values CRL takes another equilibrium than the one of the last test row, whose tip is the place."""
    turns, shift = np.radians([190.0, 20.0, 10.0]), np.array([0.015, -0.04, -0.08])
    known = [e for e in tubeopt.find_equilibria(CRL, turns, shift) if e.stable]
    at_once = tubeopt.forward_kinematics(CRL, turns, shift)
    other = max(known, key=lambda e: float(np.linalg.norm(e.tip_position - at_once.tip_position)))
    assert np.linalg.norm(other.tip_position - at_once.tip_position) > 5e-3
    row = {"rotations": turns[None], "translations": shift[None], "tip_rotations": other.tip_rotations[None]}
    fraction = ReachFraction(other.tip_position[None], np.zeros(1), 5e-4, **row)
    arm = fraction.arm(CRL, 0)
    assert arm is not None
    np.testing.assert_allclose(arm.tip_position, other.tip_position, atol=1e-9)
    assert replace(fraction, targets=fraction.targets + 0.01).arm(CRL, 0) is None


class Together:
    """Curvatures of the inner tubes of both, which shall be 1.5 and 0.5 times a number of its own."""

    description = "likeness"
    ranges = np.array([[10.0, 30.0]])

    def __call__(self, one: ConcentricRobot, other: ConcentricRobot, own: Array) -> tuple[float, float]:
        a, b = (robot.tubes[0].curvature for robot in (one, other))
        miss = ((a - 1.5 * own[0]) / 30) ** 2 + ((b - 0.5 * own[0]) / 30) ** 2 + ((own[0] - 20) / 30) ** 2
        return float(np.clip(miss - 1e-5, 0.0, 1.0)), float(-miss)


def test_both_robots_and_own_numbers_are_searched_at_once() -> None:
    robot = two_tubes()
    free = (Free("curvature", (0,), 1.0, 60.0),)
    tasks = tuple(DesignTask(robot, free, some, ordered=False) for some in ((), (Strain((0.012,)),)))
    result = search_pair((tasks[0], tasks[1]), Together(), time_limit=60)
    one, other = result.value
    assert [one.tubes[0].curvature, other.tubes[0].curvature] == pytest.approx([30.0, 10.0], abs=0.5)
    assert result.variables == pytest.approx([20.0], abs=0.3)
    assert result.after > result.before
    assert result.solutions[1].verification.satisfied
    assert result.status is DesignStatus.SATISFIED


def test_what_is_no_pair_is_refused() -> None:
    task = DesignTask(two_tubes(), (Free("curvature", (0,), 1.0, 60.0),), ordered=False)
    with pytest.raises(InputError, match=r"tasks are .*; they must be two"):
        search_pair((task,), Together())  # type: ignore[arg-type]
    with pytest.raises(InputError, match="targets is 1 point; two tips need"):
        replace(pair(), targets=np.zeros((1, 3)))
    with pytest.raises(InputError, match="bases are 1; they must be two"):
        replace(pair(), bases=pair().bases[:1])  # type: ignore[arg-type]


ARM = {
    "robot": str(ROOT / "configs" / "robots" / "crl_ctr.yaml"),
    "start_mm": [-20, -80, -90],
    "free": [{"tubes": [1, 2, 3], "curvature_factor": [0.5, 1.2]}],
    "requirements": {},
    "ordered": False,
}
ARMS = [
    ARM | {"name": f"arm {k}", "base": {"position_mm": [x, 0, 0], "direction": [0, 0, 1]}}
    for k, x in (("A", -12), ("B", 12))
]
STUDY: dict[str, Any] = {
    "kind": "design_pair",
    "arms": ARMS,
    "region": {"centre_mm": [0, 0, 60], "radius_mm": 6},
    "places": 2,
    "judged": 2,
    "points": 12,
    "seconds": 0.1,
}


def test_a_pair_is_designed_saved_and_drawn(run: Run, tmp_path: Path) -> None:
    """What is told and what is saved are of the same designs."""
    study = tmp_path / "study.yaml"
    study.write_text(json.dumps(STUDY))
    report = answer(run("design-pair", str(study), "--out", str(tmp_path), "--plot", "--json"))
    assert [arm["name"] for arm in report["arms"]] == ["arm A", "arm B"]
    assert report["arms"][1]["position_mm"] == pytest.approx([12, 0, 0])
    assert report["searched_after"] >= report["searched_before"]
    rows = np.genfromtxt(tmp_path / "pairs.csv", delimiter=",", skip_header=1)
    assert len(rows) == 2
    assert rows[:, 7].mean() == report["after"]
    away = np.linalg.norm(rows[:, :6].reshape(-1, 3) - [0, 0, 60], axis=1)
    assert away.max() <= 6 + 1e-9
    first = tubeopt.load_robot(tmp_path / "arm_1" / "robot.yaml")
    factor = report["arms"][0]["dimensions"][0]
    assert first.tubes[0].curvature == pytest.approx(factor["after"] / factor["before"] * 28, rel=1e-9)
    assert (tmp_path / "pairs.png").stat().st_size > 0
    assert (tmp_path / "places.png").stat().st_size > 0


def test_the_map_of_places_has_what_the_other_arm_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    draw_quickly(monkeypatch)
    positions = np.array([[0.0, 0.0, 0.05], [0.01, 0.0, 0.06], [0.0, 0.02, 0.07]])

    def reach(miss: list[float]) -> ReachFraction:
        return ReachFraction(positions, np.array(miss), 1e-3, *np.zeros((3, 3, 3)))

    apart = np.array([[0.0, 0.003, 0.001], [0.004, 0.0, 0.005], [np.nan, np.nan, np.nan]])
    fraction = PairFraction((reach([0.0, 0.0, 1.0]), reach([0.0, 0.0, 0.0])), apart, 0.002)
    figure = plot_pair_places((fraction, fraction), places=positions, names=("a", "b"))
    white, first, _, second = figure.axes[0].collections  # of the first arm, then of the second
    assert white.get_offsets().tolist() == [[0.0, 70.0]]
    assert first.get_offsets().tolist() == [[0.0, 50.0], [10.0, 60.0]]
    assert first.get_array().tolist() == [0.5, 1.0]
    assert second.get_array().tolist() == [0.5, 0.5, 0.5]
    assert figure.axes[2].collections[1].get_offsets().tolist() == [[0.0, 0.0], [10.0, 0.0]]
    with pytest.raises(InputError, match="places has shape"):
        plot_pair_places((fraction, fraction), places=positions[:2])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"arms": ARMS[:1]}, "arms has 1 item; it must have at least 2"),
        ({"region": None}, "neither a region nor an anatomy with a target"),
        ({"region": {"centre_mm": [0, 0, 60], "radius_mm": -1}}, "region.radius_mm is -1"),
        ({"places": 1}, "places is 1; it must be at least 2"),
        ({"judged": 1001}, "judged is 1001; it must be at most 1000"),
        ({"obstacles": [{"centre_mm": [0, 0, 60], "radius_mm": 9}]}, "has a region"),
        ({"arms": [ARMS[0], ARMS[0]]}, "base plates 0 mm"),
        ({"arms": [ARMS[0], ARMS[1] | {"free": [{"tubes": [9], "curvature_factor": [0.5, 1.2]}]}]}, "arms[1]: free"),
        ({"arms": [ARM, ARM]}, "arms[0].base is missing"),
    ],
)
def test_studies_that_make_no_pair_are_refused(run: Run, tmp_path: Path, change: dict[str, Any], message: str) -> None:
    study = tmp_path / "study.yaml"
    study.write_text(json.dumps(STUDY | change))
    report = refused(run("design-pair", str(study)))
    assert any(message in line for line in report), report
