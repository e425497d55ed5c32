"""Commands take their flags from the keys of their study: one line in the study, and the flag is there."""

from __future__ import annotations

import json
from decimal import Decimal
from pathlib import Path
from typing import Annotated, Literal

import pytest
import typer
from pydantic import Field
from typer.testing import CliRunner

from tests.command_line import COLOUR, ROOT, THESIS, Run, answer, refused
from tubeopt.cli.flags import study_command
from tubeopt.cli.output import Output
from tubeopt.errors import InputError
from tubeopt.files.checked import Number, Positive, Whole
from tubeopt.runs.robot_keys import RobotPath
from tubeopt.runs.study_file import STUDY_KINDS, Study
from tubeopt.typing import Progress

TRIALS = str(ROOT / "configs" / "molds" / "example_trials.csv")
RIG = str(ROOT / "configs" / "rigs" / "thesis_calcium_silicate.yaml")


class PaintStudy(Study):
    """How much paint a robot takes."""

    kind: Literal["paint"]
    robot: RobotPath
    coat_um: Positive = Field(Decimal("1e-8"), description="thickness of a coat")
    coats: Annotated[Whole, Field(ge=1)] = Field(2, description="how many", examples=["K"])
    tints_percent: list[Number] = Field([Decimal(10), Decimal("2.5")], description="parts of the colours")
    names: list[str] = Field([], description="of the colours")
    gloss: bool = Field(True, description="whether it shines")
    matt: bool = Field(False, description="whether it does not")

    def run(self, progress: Progress | None = None) -> dict[str, object]:
        """What was asked."""
        return self.model_dump(exclude={"robot"})


app = typer.Typer()


@app.command()
@study_command(PaintStudy, flags={"coats": "--coats,-c"}, defaults={"names": "red, blue"}, example="paint ROBOT.yaml")
def paint(
    study: PaintStudy, output: Output, robot: str, twice: Annotated[bool, typer.Option("--twice")] = False
) -> None:
    """Paint a robot."""
    print(json.dumps({"robot": robot, "twice": twice} | study.run(), default=float))


def painted(*arguments: str) -> dict[str, object]:
    outcome = CliRunner().invoke(app, [THESIS, *arguments], catch_exceptions=False)
    data = json.loads(outcome.stdout)
    assert isinstance(data, dict)
    return data


def test_missing_flags_have_defaults_of_study_or_command() -> None:
    assert painted() == {
        "robot": THESIS, "twice": False, "kind": "paint", "coat_um": 1e-8, "coats": 2, "tints_percent": [10, 2.5],
        "names": ["red", "blue"], "gloss": True, "matt": False,
    }  # fmt: skip


def test_what_is_typed_is_read_as_the_field_wants_it() -> None:
    flags = (
        "--coat-um",
        "3.5",
        "-c",
        "4",
        "--tints-percent",
        "1,-2",
        "--names",
        "none",
        "--no-gloss",
        "--matt",
        "--twice",
    )
    made = painted(*flags)
    assert (made["coat_um"], made["coats"], made["tints_percent"], made["names"]) == (3.5, 4, [1, -2], [])
    assert (made["gloss"], made["matt"], made["twice"]) == (False, True, True)


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (("--coat-um", "0"), "--coat-um is 0; it must be greater than 0"),
        (("--coats", "x"), "--coats is 'x'; it must be a number"),
        (("--tints-percent", "1,x"), "--tints-percent[1] is 'x'; it must be a number"),
    ],
)
def test_messages_name_the_flag(flags: tuple[str, ...], message: str) -> None:
    with pytest.raises(InputError) as caught:
        CliRunner().invoke(app, [THESIS, *flags], catch_exceptions=False)
    assert str(caught.value) == message


def test_data_may_replace_a_file_on_the_command_line(run: Run) -> None:
    typed = answer(run("fk", THESIS, "--load", "{tip_force_mN: [1, 0, 0]}", "--json"))
    flagged = answer(run("fk", THESIS, "--tip-force-mN", "1,0,0", "--json"))
    assert typed["tip_position_mm"] == flagged["tip_position_mm"]


def test_format_without_directory_is_reported(run: Run) -> None:
    report = answer(run("fk", THESIS, "--format", "pdf", "--json"))["warnings"]
    assert report == ["--format has no effect without --out or --plot: nothing is saved"]


def test_arm_without_length_is_reported(run: Run) -> None:
    report = answer(run("fk", THESIS, "--translations-mm", "-300,-300,-300", "--json"))["warnings"]
    assert report == ["no tube is in front of the base plate at these translations; the tip lies in the plate"]


def test_the_help_is_that_of_the_fields(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "160")
    text = " ".join(COLOUR.sub("", CliRunner().invoke(app, ["--help"]).stdout).split())
    for message in ("Paint a robot.", "--coat-um UM Thickness of a coat. [default: 1e-8]", "How many. [default: 2]"):
        assert message in text
    assert "[default: 10,2.5]" in text


def test_every_key_of_a_study_is_a_flag_of_its_command(run: Run) -> None:
    commands = {
        "forward_kinematics": "fk", "inverse_kinematics": "ik", "equilibria": "equilibria", "snap": "snap",
        "follow": "follow", "certify": "certify", "stability_map": "stability-map", "validation": "validate",
        "heating": "heat plan", "mold_plan": "mold plan", "measure": "measure", "workspace": "workspace",
        "verify": "verify", "heating_calibration": "heat calibrate", "mandrel": "mold mandrel",
        "mold_materials": "mold materials", "mold_calibration": "mold calibrate", "fabrication": "fabricate",
    }  # fmt: skip
    placed = {"follow": ("robot", "path"), "validation": ("robot", "measurements"), "heating": ("rig",),
              "verify": ("trajectory", "rates"), "heating_calibration": ("log",),
              "mold_calibration": ("trials",)}  # fmt: skip
    for kind, command in commands.items():
        shown = run(*command.split(), "--help").out
        keys = [key for key in STUDY_KINDS[kind].model_fields if key not in ("kind", *placed.get(kind, ("robot",)))]
        renamed = {"start": "--from"}
        for key in keys:
            flag = renamed.get(key, f"--{key.replace('_', '-')}")
            assert flag[:24] in shown, (command, key)


def test_a_command_and_its_study_are_one(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "heating.yaml"
    path.write_text(
        f"kind: heating\nrig: {RIG}\nhold_s: 5\nslot_s: 1\nlongest_s: 20\nwindow_degC: [200, 260]\nsamples: 0\n"
    )
    flags = ("--hold-s", "5", "--slot-s", "1", "--longest-s", "20", "--window-degC", "200,260", "--samples", "0")
    typed = answer(run("heat", RIG, *flags, "--charges-percent", "none", "--json"))
    assert answer(run("run", str(path), "--json")) == typed


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (["measure", "configs/robots/crl_ctr.yaml"], "--fit is missing"),
        (["export", "configs/robots/crl_ctr.yaml"], "--c is missing: directory"),
        (["fabricate", "configs/robots/thesis_etr.yaml"], "--rig is missing: path of the rig file"),
        (["heat", "calibrate", "configs/experiments/heating_log.csv"], "--rig is missing"),
    ],
)
def test_a_flag_that_must_be_given_is_named(run: Run, command: list[str], words: str) -> None:
    outcome = run(command[0], *(str(ROOT / part) if "configs" in part else part for part in command[1:]))
    assert outcome.code == 2
    assert words in outcome.err


def test_flags_override_the_keys_of_a_file(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "plan.yaml"
    path.write_text(f"kind: plan\nrobot: {THESIS}\ngoal_deg: [5, 0, 0]\nobjective: none\n")
    planned = answer(run("plan", str(path), "--goal-deg", "9,0,0", "--json"))
    assert planned["goal"]["rotations_deg"] == pytest.approx([9, 0, 0])
    shown = run("plan", "--help").out
    assert "--goal-deg" in shown
    assert "--rates" not in shown  # a mapping is not typed
    report = refused(run("plan", str(path), "--goal-deg", "1,2", "--seed", "-1", "--min-margin", "2"))
    assert report == [
        "--goal-deg has 2 numbers; it must be 3 (one per tube)",
        "--min-margin is 2; it must be less than 1",
        "--seed is -1; it must be at least 0",
    ]
    # Of two kinds of goal the one that is typed holds.
    (path.parent / "tip.yaml").write_text(f"kind: plan\nrobot: {THESIS}\ntip_mm: [0, 0, 150]\nobjective: none\n")
    planned = answer(run("plan", str(path.parent / "tip.yaml"), "--goal-deg", "9,0,0", "--json"))
    assert planned["goal"]["rotations_deg"] == pytest.approx([9, 0, 0])


def test_other_commands_and_their_studies_are_one(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "study.yaml"
    path.write_text(f"kind: mold_calibration\ntrials: {TRIALS}\nmodel: linear\n")
    typed = answer(run("mold", "calibrate", TRIALS, "--model", "linear", "--json"))
    assert answer(run("run", str(path), "--json")) == typed
