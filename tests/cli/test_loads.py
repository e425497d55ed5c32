"""Loads on the command line and in files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.command_line import CRL, ROOT, THESIS, Run, answer, refused
from tubeopt import InputError, Load, forward_kinematics, load_robot
from tubeopt.robots.load import PointLoad, Stretch
from tubeopt.runs.robot_keys import load_entry
from tubeopt.runs.study_file import load_study

TWO_TUBE = str(ROOT / "configs" / "robots" / "two_tube.yaml")
FILE = """
tip_force_mN: [100, 0, 0]
gravity_m_per_s2: [0, 0, -9.81]
points:
  - {at_mm: 50, force_mN: [10, 0, 0]}
distributed_mN_per_m:
  - {from_mm: 10, to_mm: 60, force_mN_per_m: [1000, 0, 0]}
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "load.yaml"
    path.write_text(FILE)
    return path


def test_load_file_defines_load(file: Path) -> None:
    assert load_entry(file).build() == Load(
        (0.1, 0, 0),
        gravity=(0, 0, -9.81),
        points=(PointLoad(0.05, (0.01, 0, 0)),),
        distributed=(Stretch(0.01, 0.06, (1.0, 0, 0)),),
    )
    file.write_text("tip_force_mN: [1, 2]\ngravity: [0, 0, -9.81]")
    with pytest.raises(InputError, match=r"tip_force_mN has 2 numbers.*\n.*gravity is not a known key; did you mean"):
        load_entry(file).build()
    file.write_text("points: [{at_mm: -1, force_mN: [0, 0, 1]}]")
    with pytest.raises(InputError, match="must be at least 0"):
        load_entry(file).build()


def test_fk_by_flags_and_by_file(run: Run, file: Path) -> None:
    turned = ["fk", THESIS, "--rotations-deg", "0,57.3,114.6", "--json"]
    data = answer(run(*turned, "--tip-force-mN", "100,0,0"))
    same = forward_kinematics(load_robot(THESIS), np.radians([0, 57.3, 114.6]), load=Load((0.1, 0, 0)))
    assert np.allclose(data["tip_position_mm"], same.tip_position * 1e3, rtol=0, atol=1e-9)
    assert data["load"] == "100, 0, 0 mN at the tip"
    assert np.allclose([*data["base_force_mN"], *data["base_moment_mN_m"]], same.base_wrench * 1e3)
    assert np.allclose(data["compliance"], same.compliance)
    both = answer(run(*turned, "--load", str(file), "--tip-force-mN", "0,0,0"))
    assert "10, 0, 0 mN at 50 mm" in both["load"]
    assert "at the tip" not in both["load"]
    text = " ".join(run(*turned[:-1], "--load", str(file)).out.split())
    assert "on the plate" in text
    assert "a load along the arm" in text


def test_moments_have_a_margin_and_no_energy(run: Run) -> None:
    moment = "--tip-moment-mN-m", "0,0,2"
    data = answer(run("fk", THESIS, *moment, "--json"))
    assert data["margin"] == pytest.approx(0.905, abs=1e-3)
    assert data["stable"]
    assert "0.905, stable" in run("fk", THESIS, *moment).out
    report = run("snap", THESIS, "--to-deg", "360,0,0", *moment).out
    assert "snap at rotations" in report
    assert "nan" not in report
    assert "energy released" not in report


def test_snaps_and_equilibria_under_load(run: Run, tmp_path: Path) -> None:
    snapped = answer(run("snap", THESIS, "--to-deg", "360,0,0", "--tip-force-mN=-20,0,0", "--json"))
    assert snapped["snap"]["rotations_deg"][0] == pytest.approx(201.0758694, abs=1e-6)
    path = tmp_path / "turn_and_back.csv"
    path.write_text("rotation_1_deg,rotation_2_deg,rotation_3_deg\n0,0,0\n240,0,0\n100,0,0\n")
    followed = answer(run("follow", THESIS, str(path), "--gravity-m-per-s2", "0,0,-9.81", "--json"))
    assert len(followed["snaps"]) == 2
    loaded = run("equilibria", TWO_TUBE, "--rotations-deg", "20,0", "--tip-force-mN=-2,0,0", "--json")
    assert len(answer(loaded)["equilibria"]) == 1


def test_studies_take_a_load(tmp_path: Path) -> None:
    study = tmp_path / "study.yaml"
    study.write_text(f"kind: forward_kinematics\nrobot: {THESIS}\nload: {{tip_force_mN: [100, 0, 0]}}\n")
    assert load_study(study).run().load == Load((0.1, 0, 0))


def test_what_makes_no_sense(run: Run) -> None:
    assert refused(run("fk", THESIS, "--tip-force-mN", "1,2")) == [
        "--tip-force-mN has 2 numbers; it must have 3: x, y, z"
    ]
    assert "it must be 'newton'" in refused(run("fk", THESIS, "--tip-moment-mN-m", "1,2,3", "--method", "ipopt"))[0]
    assert refused(run("load-limit", THESIS, "--tip-force-mN", "0,0,0")) == ["the load is 0; it must not be 0"]
    lost = run("fk", THESIS, "--tip-force-mN", "0,1500,-1500")
    assert lost.code == 3
    assert "bifurcates at 7.135 % of the load" in lost.err


def test_certified_whatever_pushes(run: Run) -> None:
    requested = ["certify", CRL, "--translations-mm=-20,0,0", "--json", "--max-tip-force-mN"]
    strong, weak = answer(run(*requested, "1000"), 4), answer(run(*requested, "1"))
    assert weak["exit_code"] == 0
    assert 0 < weak["certificate_under_force"] < weak["certificate"]
    assert weak["max_tip_force_mN"] == 1
    assert strong["certificate_under_force"] < 0
    assert strong["finding"] == "OPEN"
    plain = answer(run(*requested[:-1]))
    assert "certificate_under_force" not in plain


def test_load_limit_of_robot(run: Run, tmp_path: Path) -> None:
    requested = ["load-limit", THESIS, "--json"]
    turned = ["--from-deg", "0,0,0", "--rotations-deg", "200,0,0", "--tip-force-mN=-10,0,0"]
    limit = answer(run(*requested, *turned))["limit"]
    assert limit["factor"] == pytest.approx(2.1846, abs=1e-4)
    assert limit["kind"] == "fold"
    assert limit["tip_jump_mm"] > 50
    # A pose in a plane with its load: no fold, but a bifurcation.
    limit = answer(run(*requested, "--tip-force-mN", "0,1500,-1500", "--out", str(tmp_path)))["limit"]
    assert limit["factor"] == pytest.approx(0.0713476, abs=1e-7)
    assert limit["kind"] == "bifurcation"
    assert (tmp_path / "load_limit.png").exists()
    assert answer(run(*requested, "--tip-force-mN", "1,0,0", "--up-to", "2"))["limit"] is None
    assert "no load is given" in refused(run(*requested[:-1]))[0]


def test_how_hard_the_robot_can_push(run: Run) -> None:
    report = answer(run("load-limit", THESIS, "--axial", "--json"))
    assert report["limit"]["factor"] == pytest.approx(124.6476536, abs=1e-6)
    assert report["load"].endswith("mN at the tip")
    assert "axial and a load" in refused(run("load-limit", THESIS, "--axial", "--tip-force-mN", "1,0,0"))[0]


def test_forces_of_a_recording(run: Run, tmp_path: Path) -> None:
    lines = (ROOT / "configs" / "experiments" / "synthetic_forces.csv").read_text().splitlines()
    head, rows_of = [line for line in lines if not line[0].isdigit() and line[0] != "-"], lines[-12::3]
    recording = str(tmp_path / "recording.csv")
    Path(recording).write_text("\n".join([*head, *rows_of]) + "\n")
    data = answer(run("force", THESIS, recording, "--noise-mm", "0.1", "--json", "--out", str(tmp_path)))
    angle = 2 * np.pi * np.arange(0, 12, 3) / 12
    true = np.stack([60 * np.sin(angle), 40 * np.cos(angle), np.full(4, -20.0)], axis=1)
    report = data["estimates"]
    wrong = np.array([row["force_mN"] for row in report]) - true
    errors = np.array([row["standard_error_mN"] for row in report])
    assert data["estimated"] == 4
    assert np.abs(wrong / errors).max() < 3.5
    assert (errors < 10).all()
    header, *rows = (tmp_path / "forces.csv").read_text().splitlines()
    assert header.startswith("row,rotation_1_deg,")
    assert len(rows) == 4
    Path(recording).write_text("\n".join([*head, rows_of[0]]) + "\n")
    (with_moment,) = answer(run("force", THESIS, recording, "--tip-moment-mN-m", "0.001,0,0", "--json"))["estimates"]
    apart = np.array(with_moment["force_mN"]) - report[0]["force_mN"]
    assert 0 < np.abs(apart).max() < 0.1


def test_the_limit_is_a_force_and_is_searched_until_it_is_found(run: Run) -> None:
    push = ("load-limit", THESIS, "--tip-force-mN")
    little, much = "0,0.949953,-0.312393", "0,94.9953,-31.2393"
    far, near = answer(run(*push, little, "--json")), answer(run(*push, much, "--json"))
    assert (far["up_to"], near["up_to"]) == (1000.0, 10.0)
    assert far["limit"]["factor"] == pytest.approx(100 * near["limit"]["factor"], rel=1e-6)
    assert answer(run(*push, little, "--up-to", "3", "--json"))["limit"] is None
    assert "124.6 mN at the tip" in run(*push, much).out.split("(")[0]
