"""Bodies are written one way in all files, and as design studies wrote them before there was a kind."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.command_line import THESIS
from tubeopt import InputError
from tubeopt.bodies.corridors import Corridor
from tubeopt.bodies.obstacles import Box, Capsule, HalfSpace, Obstacle, Sphere
from tubeopt.files.checked import check
from tubeopt.runs.design_parts import AvoidEntry
from tubeopt.runs.inverse_study import InverseStudy
from tubeopt.runs.plan_study import PlanStudy
from tubeopt.runs.surroundings_file import load_obstacles

KINDS = "its kind must be one of sphere, capsule, half_space, box, corridor, mesh, anatomy"

BODIES: list[tuple[dict[str, Any], Obstacle]] = [
    ({"kind": "sphere", "centre_mm": [1, 2, 3], "radius_mm": 4}, Sphere((1e-3, 2e-3, 3e-3), 4e-3)),
    ({"centre_mm": [1, 2, 3], "radius_mm": 4}, Sphere((1e-3, 2e-3, 3e-3), 4e-3)),
    (
        {"kind": "capsule", "start_mm": [0, 0, 0], "end_mm": [0, 0, 9], "radius_mm": 1},
        Capsule((0, 0, 0), (0, 0, 9e-3), 1e-3),
    ),
    ({"from_mm": [0, 0, 0], "to_mm": [0, 0, 9], "radius_mm": 1}, Capsule((0, 0, 0), (0, 0, 9e-3), 1e-3)),
    ({"low_mm": [0, 0, 0], "high_mm": [1, 2, 3]}, Box((0, 0, 0), (1e-3, 2e-3, 3e-3))),
    ({"point_mm": [0, 0, 5], "normal": [0, 0, 1]}, HalfSpace((0, 0, 5e-3), (0, 0, 1))),
    (
        {"kind": "corridor", "centreline_mm": [[0, 0, 0], [0, 0, 9]], "radius_mm": 2},
        Corridor(((0, 0, 0), (0, 0, 9e-3)), 2e-3),
    ),
    (
        {"kind": "corridor", "centreline_mm": [[0, 0, 0], [0, 0, 9]], "radius_mm": [2, 3]},
        Corridor(((0, 0, 0), (0, 0, 9e-3)), (2e-3, 3e-3)),
    ),
]  # fmt: skip


@pytest.mark.parametrize(("written", "body"), BODIES)
def test_every_file_reads_the_same_body(tmp_path: Path, written: dict[str, Any], body: Obstacle) -> None:
    path = tmp_path / "bodies.yaml"
    path.write_text(yaml.safe_dump({"obstacles": [written]}))
    assert load_obstacles(path) == (body,)
    for inputs in ([written], "bodies.yaml"):
        inverse = {"kind": "inverse_kinematics", "robot": THESIS, "target_mm": [50, 30, 150], "obstacles": inputs}
        plan = {"kind": "plan", "robot": THESIS, "goal_deg": [10, 0, 0], "obstacles": inputs}
        assert check(InverseStudy, inverse, tmp_path / "study.yaml").obstacles == (body,)
        assert check(PlanStudy, plan, tmp_path / "study.yaml").obstacles == (body,)
        assert check(AvoidEntry, {"obstacles": inputs}, tmp_path / "study.yaml").build().obstacles == (body,)


@pytest.mark.parametrize(
    ("written", "message"),
    [
        ({"kind": "spher"}, f"obstacles[0] is of kind 'spher'; {KINDS}; did you mean 'sphere'?"),
        ({"radius_mm": 3}, f"obstacles[0] has no kind, and its keys do not determine one; {KINDS[4:]}"),
        ({"from_mm": [0, 0, 0], "to_mm": [0, 0, 1], "radius_mm": -1},
         "obstacles[0].radius_mm is -1; it must be greater than 0"),
    ],
)  # fmt: skip
def test_what_is_no_body_is_refused(written: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as caught:
        check(AvoidEntry, {"obstacles": [written]}, "")
    assert str(caught.value) == message


def test_targets_have_nothing_around_them_where_the_key_has_no_value() -> None:
    written = {"kind": "inverse_kinematics", "robot": THESIS, "target_mm": [50, 30, 150], "obstacles": None}
    assert check(InverseStudy, written, "").bodies == ()
