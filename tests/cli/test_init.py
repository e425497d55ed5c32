"""Files to begin with are used as they are written; questions are asked of a person only."""

from __future__ import annotations

import os
import pty
import re
import select
import signal
import sys
import time
from pathlib import Path

import pytest

import tubeopt
from tests.command_line import COLOUR, Run, answer, refused
from tubeopt.files.yaml_file import load_yaml
from tubeopt.runs.study_file import load_study
from tubeopt.runs.sweep_file import load_sweep
from tubeopt.runs.templates import KINDS
from tubeopt.runs.workshop_file import BatteryEntry, RigEntry


@pytest.fixture(autouse=True)
def _empty(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_a_robot_is_used_as_it_is_written(run: Run, tmp_path: Path) -> None:
    report = answer(run("init", "robot", "--json"))
    assert report["files"] == ["robot.yaml"]
    assert report["then"] == "tubeopt fk robot.yaml"
    pose = answer(run("fk", "robot.yaml", "--rotations-deg", "0,90", "--json"))
    assert (pose["stable"], pose["warnings"]) == (True, [])
    assert answer(run("robot", "show", "robot.yaml", "--json"))["warnings"] == []
    assert [path.name for path in tmp_path.iterdir()] == ["robot.yaml"]


def test_a_robot_from_flags(run: Run) -> None:
    flags = ("--outer-diameter-mm", "1,1.4,1.8", "--inner-diameter-mm", "0.8,1.2,1.6", "--radius-mm", "80,90,100")
    assert run("init", "robot", "mine.yaml", "--name", "mine: the first", *flags).code == 0
    robot = tubeopt.load_robot("mine.yaml")
    assert robot.name == "mine: the first"
    assert [tube.outer_diameter for tube in robot.tubes] == [1e-3, 1.4e-3, 1.8e-3]
    assert [tube.inner_diameter for tube in robot.tubes] == [0.8e-3, 1.2e-3, 1.6e-3]
    assert tubeopt.forward_kinematics(robot, [0, 0, 0]).stable


@pytest.mark.parametrize("count", range(1, 7))
def test_usual_tubes_fit_and_advance_in_order(run: Run, count: int) -> None:
    assert run("init", "robot", "--tubes", str(count)).code == 0
    pose = answer(run("fk", "robot.yaml", "--json"))
    assert pose["warnings"] == []
    assert pose["translations_mm"] == [0] * count


def test_an_eccentric_robot(run: Run) -> None:
    assert run("init", "robot", "--kind", "eccentric").code == 0
    assert tubeopt.load_robot("robot.yaml").tubes == tubeopt.load_robot("thesis_etr").tubes
    (line,) = refused(run("init", "robot", "a.yaml", "--kind", "eccentric", "--radius-mm", "1,2"))
    assert line == "several tubes are given; give one number for each dimension of the one tube"


def test_a_rig_is_used_as_it_is_written(run: Run) -> None:
    report = answer(run("init", "rig", "--mold", "steel", "--charge-percent", "80", "--json"))
    rig = tubeopt.load_rig("rig.yaml")
    assert (rig.mold.material.name, rig.battery.state_of_charge) == ("steel", 0.8)
    assert report["then"] == "tubeopt heat plan rig.yaml --sensor thermocouple"
    assert run("init", "rig", "usual.yaml").code == 0
    assert tubeopt.load_rig("usual.yaml").tube == tubeopt.load_rig("thesis_calcium_silicate").tube


def test_heat_plan_takes_the_rig(run: Run) -> None:
    assert run("init", "rig").code == 0
    assert answer(run("heat", "plan", "rig.yaml", "--sensor", "thermocouple", "--json"))["success_probability"] > 0.5


@pytest.mark.parametrize("what", ["robot", "rig"])
def test_the_help_states_the_values_of_the_template(run: Run, what: str) -> None:
    assert run("init", what).code == 0
    file = load_yaml(f"{what}.yaml")
    tubes = file["tubes"] if what == "robot" else [file["tube"]]
    keys = ("outer_diameter_mm", "inner_diameter_mm", "straight_length_mm", "curved_length_mm", "radius_mm")
    written = {key: ",".join(str(tube[key]) for tube in tubes) for key in keys} | {"name": file["name"]}
    if what == "rig":
        battery = file["battery"]
        written |= {"mold": file["mold"]["material"], "capacity_Ah": str(battery["capacity_Ah"])}
        written |= {"charge_percent": str(battery["state_of_charge_percent"])}
    text = " ".join(run("init", what, "--help").out.replace("│", " ").split())
    shown = re.findall(r"--(\S+) \S+ [^\[]*\[default: \(([^)]*)\)\]", text)
    assert written.items() <= {flag.replace("-", "_"): value for flag, value in shown}.items()


def test_every_key_has_a_comment_and_others_may_follow(run: Run) -> None:
    assert run("init", "rig").code == 0
    text = Path("rig.yaml").read_text()
    assert f"  capacity_Ah: 60  # {BatteryEntry.model_fields['capacity_Ah'].description}\n" in text
    assert f"\n# loss_factor: 1  # {RigEntry.model_fields['loss_factor'].description}\n" in text
    as_comments = re.sub(r"^( *)# (loss_factor|ambient_degC|  width_mm)(:)", r"\1\2\3", text, flags=re.MULTILINE)
    assert as_comments != text
    Path("more.yaml").write_text(as_comments)
    assert tubeopt.load_rig("more.yaml") == tubeopt.load_rig("rig.yaml")


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in ("verify", "tube_photo", "sweep")])
def test_a_study_of_every_kind_can_be_read(run: Run, kind: str) -> None:
    report = answer(run("init", "study", "--kind", kind, "--json"))
    assert report["then"] == "tubeopt run study.yaml"
    assert load_study("study.yaml").kind == kind


@pytest.mark.parametrize(
    ("kind", "codes"),
    [
        ("forward_kinematics", [0]),
        ("inverse_kinematics", [0]),
        ("equilibria", [0]),
        ("snap", [0]),
        ("follow", [0]),
        ("certify", [0, 3]),
        ("load_limit", [0]),
        ("mold_plan", [0]),
        ("mold_calibration", [0]),
        ("plan", [0]),
    ],
)
def test_a_study_runs_as_it_is_written(run: Run, kind: str, codes: list[int]) -> None:
    assert run("init", "study", "--kind", kind).code == 0
    outcome = run("run", "study.yaml")
    assert outcome.code in codes, outcome.err


def test_a_study_of_ones_own_robot_from_elsewhere(run: Run) -> None:
    assert run("init", "robot", "robots/mine.yaml").code == 0
    flags = ("--kind", "snap", "--robot", "robots/mine.yaml", "--set", "to_deg=[200, 10]", "--set", "from_mm=[0, 0]")
    assert run("init", "study", "studies/turn.yaml", *flags).code == 0
    data = load_yaml("studies/turn.yaml")
    assert data == {"kind": "snap", "robot": "../robots/mine.yaml", "to_deg": [200, 10], "from_mm": [0, 0]}
    assert run("run", "studies/turn.yaml").code == 0


def test_a_sweep(run: Run) -> None:
    report = answer(run("init", "study", "--kind", "sweep", "--json"))
    assert report["then"] == "tubeopt sweep study.yaml"
    assert len(load_sweep("study.yaml").points.keys) == 4


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        (("study", "--kind", "snp"), "--kind is 'snp'; it must be one of forward_kinematics, "),
        (("study", "--robot", "thesis_crt"), "thesis_crt: there is no such file, and no built-in robot has this name"),
        (("study", "--kind", "verify"), "trajectory is missing; --set trajectory=VALUE gives it"),
        (("study", "--kind", "tube_photo"), "photo is missing; --set photo=VALUE gives it"),
        (("study", "--kind", "heating", "--robot", "thesis_ctr"), "a study of kind heating has no robot"),
        (("study", "--set", "to_deg"), "--set is 'to_deg'; it must be KEY=VALUE"),
        (
            ("study", "--kind", "snap", "--set", "to_dg=[1]"),
            "study.yaml: to_dg is not a known key; did you mean 'to_deg'?",
        ),
        (("robot", "--outer-diameter-mm", "1,2", "--tubes", "3"), "--outer-diameter-mm has 2 numbers; it must be 3"),
        (("robot", "--outer-diameter-mm", "1,x"), "--outer-diameter-mm[1] is 'x'; it must be a number"),
        (("robot", "--inner-diameter-mm", "2"), "inner_diameter_mm is 2; it must be less than outer_diameter_mm (1)"),
        (("robot", "--material", "steel"), "material is 'steel'; it must be nitinol or"),
        (("robot", "--tubes", "0"), "--tubes is 0; it must be at least 1"),
        (("robot", "--tubes", "99"), "--tubes is 99; it must be at most 6"),
        (("rig", "--mold", "wood"), "mold.material is 'wood'; it must be "),
        (("rig", "--radius-mm", "80,90"), "several tubes are given"),
        (("robot", "--format", "pdf"), "there is no option --format"),
    ],
)
def test_nothing_is_written_for_what_makes_no_sense(
    run: Run, tmp_path: Path, typed: tuple[str, ...], said: str
) -> None:
    lines = refused(run("init", *typed))
    assert any(said in line for line in lines), lines
    assert [*tmp_path.iterdir()] == []


@pytest.mark.parametrize("what", ["robot", "rig", "study"])
def test_a_file_that_is_there_stays(run: Run, tmp_path: Path, what: str) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("mine")
    (line,) = refused(run("init", what, "mine.yaml"))
    assert line == "mine.yaml: the file exists; --force replaces it"
    assert path.read_text() == "mine"
    assert run("init", what, "mine.yaml", "--force").code == 0
    assert "kind:" in path.read_text()
    (line,) = refused(run("init", what, str(tmp_path), "--force"))
    assert line == f"{tmp_path}: this is a directory; it must be a file"


SCRIPT = "import sys; from tubeopt.cli import main; main(sys.argv[1:])"


def talk(*arguments: str, answers: list[str]) -> tuple[int, str]:
    """Exit code and what a terminal shows of a command whose questions are answered."""
    child, terminal = pty.fork()
    if child == 0:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # a job in the background ignores it, and so would its child
        os.execv(sys.executable, [sys.executable, "-c", SCRIPT, *arguments])
    shown, left, end = b"", list(answers), time.monotonic() + 60
    while time.monotonic() < end:
        if select.select([terminal], [], [], 0.05)[0]:
            try:
                read = os.read(terminal, 4096)
            except OSError:  # the other side has gone
                break
            shown += read
            if not read:
                break
        elif left and shown.endswith(b"]: "):
            shown += b"|"
            os.write(terminal, left.pop(0).encode())
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    os.close(terminal)
    assert left == []
    return code, COLOUR.sub("", shown.decode()).replace("\r", "")


def test_prompts_repeat_after_invalid_answers() -> None:
    first = ["twice\n", "\n", "1,x\n", "1,1.4\n", "1.2,1.3\n", *["\n"] * 4]
    second = ["\n", "\n", "\n", "0.8,1.2\n", *["\n"] * 4]
    code, shown = talk("init", "robot", answers=first + second)
    assert code == 0
    assert "Outer diameter of every tube, inner to outer, mm [1,1.3]: " in shown
    assert "error: outer_diameter_mm[1] is 'x'; it must be a number\n" in shown
    assert "tubes[0].inner_diameter_mm is 1.2; it must be less than outer_diameter_mm (1)\n" in shown
    assert "Name of the robot [twice]: " in shown
    robot = tubeopt.load_robot("robot.yaml")
    assert robot.name == "twice"
    assert [tube.inner_diameter for tube in robot.tubes] == [0.8e-3, 1.2e-3]


@pytest.mark.parametrize("key", ["\x03", "\x04"])
def test_a_person_who_leaves(key: str, tmp_path: Path) -> None:
    code, shown = talk("init", "study", answers=["snap\n", key])
    assert code == 130
    assert shown.endswith("error: interrupted; nothing was saved\n")
    assert [*tmp_path.iterdir()] == []


SIX = """kind: concentric
name: mine
tubes:
  - {outer_diameter_mm: 1.0, inner_diameter_mm: 0.8, straight_length_mm: 150, curved_length_mm: 60, radius_mm: 60}
  - {outer_diameter_mm: 1.3, inner_diameter_mm: 1.1, straight_length_mm: 100, curved_length_mm: 50, radius_mm: 100}
  - {outer_diameter_mm: 1.6, inner_diameter_mm: 1.4, straight_length_mm: 50, curved_length_mm: 40, radius_mm: 140}
"""


def test_six_lines_are_a_robot(run: Run) -> None:
    Path("six.yaml").write_text(SIX)
    assert answer(run("fk", "six.yaml", "--rotations-deg", "0,60,120", "--json"))["stable"]
    assert run("init", "robot", "three.yaml", "--tubes", "3").code == 0
    assert tubeopt.load_robot("six.yaml").tubes == tubeopt.load_robot("three.yaml").tubes


def test_a_file_without_an_ending_is_refused(run: Run) -> None:
    assert refused(run("init", "study", "plan")) == ["plan: the name of the file must end in .yaml"]
