"""Wrong values: every message names the flag or key that was typed, in its unit."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.command_line import THESIS, Run, refused

PLAN = f"kind: plan\nrobot: {THESIS}\nstart_deg: [0, 0, 0]\n"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ["ik", THESIS, "--target-mm", "1,2,90000"],
            "--target-mm is [1, 2, 90000], 90000 mm from the plate; it must be at most 4000 mm away",
        ),
        (["snap", THESIS, "--to-deg", "1e7,0,0"], "--to-deg has 1E+7 for tube 1; it must be at most 57296 (159 turns)"),
        (
            ["snap", THESIS, "--to-deg", "360,0,0", "--to-mm", "900,0,0"],
            "--to-mm has 900 for tube 1; it must be at most its straight length, 200",
        ),
        (["fk", THESIS, "--rotations-deg", "0,1,1e9"], "--rotations-deg has 1E+9 for tube 3; it must be at most 57296"),
        (
            ["fk", THESIS, "--translations-mm", "0,0,900"],
            "--translations-mm has 900 for tube 3; it must be at most its",
        ),
        (
            ["fk", THESIS, "--translations-mm=-90000,0,0"],
            "--translations-mm has -90000 for tube 1; it must be at least",
        ),
        (["fk", THESIS, "--tip-moment-mN-m", "0,2"], "--tip-moment-mN-m has 2 numbers; it must have 3: x, y, z"),
    ],
)
def test_messages_name_the_flag_in_its_unit(run: Run, arguments: list[str], words: str) -> None:
    assert words in "\n".join(refused(run(*arguments)))


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ("tip_mm: [1, 2, 90000]", "tip_mm is [1, 2, 90000], 90000 mm from the plate; it must be at most 4000 mm away"),
        ("goal_mm: [0, 0, 900]", "goal_mm has 900 for tube 3; it must be at most its straight length, 100"),
        ("goal_mm: [-90000, 0, 0]", "goal_mm has -90000 for tube 1; it must be at least -4000, 10 lengths of the tube"),
        ("goal_deg: [1e9, 0, 0]", "goal_deg has 1E+9 for tube 1; it must be at most 57296 (159 turns)"),
        ("goal_mm: [-60, -100, 0]", "goal is out of range: tube 2 would end inside tube 3, by 50 mm"),
        (
            "goal_deg: [1, 0, 0]\nload: {points: [{at_mm: 50, moment_mN_m: [0, 2]}]}",
            "load: points[0].moment_mN_m has 2 numbers; it must have 3: x, y, z",
        ),
        (
            "goal_deg: [1, 0, 0]\nload: {points: [{at_mm: 50, force_mN: [0, 2, 0, 3]}]}",
            "load: points[0].force_mN has 4 numbers; it must have 3: x, y, z",
        ),
    ],
)
def test_messages_name_the_key_in_its_unit(run: Run, keys: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "plan.yaml").write_text(PLAN + keys + "\n")
    assert words in "\n".join(refused(run("plan", str(tmp_path / "plan.yaml"))))


def test_an_empty_trajectory_is_called_empty(run: Run, tmp_path: Path) -> None:
    (tmp_path / "empty.csv").write_text("")
    (message,) = refused(run("verify", str(tmp_path / "empty.csv")))
    assert "empty.csv: the file is empty; its first line must name the columns" in message
    assert "names no robot" not in message


def test_verify_takes_a_limit_of_the_tip(run: Run, tmp_path: Path) -> None:
    """The outer tube turns the whole arm about the plate's axis: the tip goes round a circle."""
    path = tmp_path / "turn.csv"
    rows = "".join(f"{t},{t * 9},{t * 9},{t * 9}\n" for t in range(11))
    path.write_text(f"# robot: {THESIS}\ntime_s,rotation_1_deg,rotation_2_deg,rotation_3_deg\n{rows}")
    # 9 deg/s at 90.7 mm from the axis are 14.25 mm/s.
    assert run("verify", str(path), "--tip-mm-per-s", "15").code == 0
    slow = run("verify", str(path), "--tip-mm-per-s", "14")
    assert slow.code == 3
    assert "the tip reaches 14.2" in slow.out + slow.err
    assert "it must be at most 14 mm/s" in slow.out + slow.err
