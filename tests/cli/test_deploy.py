"""`tubeopt deploy`: a tip led through a vessel."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.command_line import Run, answer, refused

VESSEL = "[{kind: corridor, centreline_mm: [[0, 0, -20], [0, 0, 8], [0.8, 0, 16]], radius_mm: %s}]"


def test_a_tip_is_led_along_the_corridor(run: Run, tmp_path: Path) -> None:
    outcome = run("deploy", "thesis_ctr", "--walls", VESSEL % 1.5, "--json", "--out", str(tmp_path))
    led = answer(outcome)
    assert led["status"] == "the tip reached the end of the path"
    assert led["miss_mm"] == pytest.approx(0, abs=2)
    assert led["steps"][-1]["tip_position_mm"] == pytest.approx([0.8, 0, 16], abs=2)
    forces = [0.0, *(sum(x**2 for x in c["force_mN"]) ** 0.5 for step in led["steps"] for c in step["contacts"])]
    assert max(forces) <= led["largest_force_mN"] * (1 + 1e-6) <= 500
    assert json.loads((tmp_path / "deployment.json").read_text())["steps"] == led["steps"]
    assert (tmp_path / "deployment.png").exists()
    # `follow` reads the waypoints, and arrives.
    walls = ("--walls", VESSEL % 1.5, "--json")
    followed = answer(run("follow", "thesis_ctr", str(tmp_path / "waypoints.csv"), *walls))
    assert not followed["snaps"]
    last = followed["waypoints"][-1]["tip_position_mm"]
    assert last == pytest.approx(led["steps"][-1]["tip_position_mm"], abs=1e-4)


@pytest.mark.parametrize(
    ("walls", "message"),
    [
        ("[{centre_mm: [30, 0, 50], radius_mm: 5}]", "walls have 0 corridors; without tip_path_mm they must have 1"),
        (VESSEL % 0.6, "a wall is 0.1 mm deep in the arm at the base plate"),
    ],
)
def test_walls_that_lead_nowhere_are_refused(run: Run, walls: str, message: str) -> None:
    assert message in refused(run("deploy", "thesis_ctr", "--walls", walls))[0]


def test_a_tip_that_is_blocked_is_an_error_with_its_reason(run: Run) -> None:
    vessel = "[{kind: corridor, centreline_mm: [[0, 0, -20], [0, 0, 5], [0.5, 0, 8]], radius_mm: 0.75}]"
    outcome = run(
        "deploy", "thesis_ctr", "--walls", vessel, "--largest-force-mN", "1", "--tolerance-mm", "0.01", "--json"
    )
    assert outcome.code == 3
    assert "mm from the path" in json.loads(outcome.out)["error"]["messages"][0]
