"""Wrong values: every message names the flag or key that was typed, in its unit."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.command_line import ROOT, THESIS, Run, refused
from tubeopt.files.units import in_input_units

ETR = [str(ROOT / "configs/robots/thesis_etr.yaml"), str(ROOT / "configs/experiments/synthetic_etr.csv")]
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
        (
            ["fk", THESIS, "--tip-force-mN", "1e7,0,0"],
            "--tip-force-mN: tip force of the load has 1e+07 mN; on this arm it must be at most 185000 mN",
        ),
        (
            ["fk", THESIS, "--tip-moment-mN-m", "1e7,0,0"],
            "--tip-moment-mN-m: tip moment of the load has 1e+07 mN m; on this arm it must be at most 1110 mN m",
        ),
        (
            ["mold", "plan", THESIS, "--cold-length-mm", "90000"],
            "cold_length of the mold is 90000 mm; it must be at most",
        ),
        (
            ["measure", THESIS, "--fit", "curvture"],
            "--fit: parameter 'curvture' is not known; did you mean 'curvature'?",
        ),
        (
            ["certify", ETR[0], "--max-tip-force-mN", "3"],
            "--max-tip-force-mN is 3 mN; it must be 0 for eccentric robots",
        ),
        (
            ["force", THESIS, "synthetic_forces", "--load", "{tip_force_mN: [1, 0, 0], frame: tip}"],
            "load.frame is 'tip'; it must be 'world'",
        ),
        (["mold", "materials", "--set-degC", "850"], "if these are K, give 576.85 degC"),
        (["measure", THESIS, "--fit", "curvature_1", "--seed", "-1"], "--seed is -1; it must be at least 0"),
        (
            ["serve", THESIS, "--translations-mm=-60,-100,0"],
            "--translations-mm is out of range: tube 2 would end inside",
        ),
        (["serve", THESIS, "--rotations-deg", "400,0,0"], "--rotations-deg[0] is 400 deg; it must be from -360 to 360"),
        (["serve", THESIS, "--period-s", "10"], "--period-s is 10; it must be at most 1"),
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
        ("goal_mm: [0, 0, -190]", "goal_mm[2] is -190 mm; it must be from -100 to 100 mm"),
        ("goal_deg: [900, 0, 0]", "goal_deg[0] is 900 deg; it must be from -360 to 360 deg"),
        ("goal_mm: [-60, -100, 0]", "goal_mm is out of range: tube 2 would end inside tube 3, by 50 mm"),
        (
            "goal_deg: [1, 0, 0]\nload: {points: [{at_mm: 50, moment_mN_m: [0, 2]}]}",
            "load: points[0].moment_mN_m has 2 numbers; it must have 3: x, y, z",
        ),
        (
            "goal_deg: [1, 0, 0]\nload: {points: [{at_mm: 50, force_mN: [0, 2, 0, 3]}]}",
            "load: points[0].force_mN has 4 numbers; it must have 3: x, y, z",
        ),
        (
            "goal_deg: [1, 0, 0]\nrates: {rotation_deg_per_s: [10, 20]}",
            "plan.yaml: rates.rotation_deg_per_s is [10, 20]; it must be one number, or 3 (one per tube)",
        ),
    ],
)
def test_messages_name_the_key_in_its_unit(run: Run, keys: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "plan.yaml").write_text(PLAN + keys + "\n")
    assert words in "\n".join(refused(run("plan", str(tmp_path / "plan.yaml"))))


def test_empty_trajectory_is_reported(run: Run, tmp_path: Path) -> None:
    (tmp_path / "empty.csv").write_text("")
    (message,) = refused(run("verify", str(tmp_path / "empty.csv")))
    assert "empty.csv: the file is empty; its first line must name the columns" in message
    assert "has no robot" not in message


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


JOINTS = [f"{name}_{k}_{unit}" for name, unit in (("rotation", "deg"), ("translation", "mm")) for k in (1, 2, 3)]


@pytest.mark.parametrize(
    ("row", "words"),
    [
        (
            "0,0,0,0,0,900",
            "column translation_3_mm is 900; it must be at most its straight length, 100, where it is clamped",
        ),
        ("0,0,0,-9e4,0,0", "column translation_1_mm is -9E+4; it must be at least -4000, 10 lengths of the tube"),
        ("0,0,1e9,0,0,0", "column rotation_3_deg is 1E+9; it must be at most 57296 (159 turns) to either side"),
    ],
)
@pytest.mark.parametrize("command", ["follow", "verify", "validate", "force"])
def test_rows_of_tables_name_file_line_and_column(run: Run, row: str, words: str, command: str, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    measured = command in ("validate", "force")
    head = (["time_s"] if command == "verify" else []) + JOINTS + (["x_mm", "y_mm", "z_mm"] if measured else [])
    before, after = ("{},", "") if command == "verify" else ("", ",1,2,3" if measured else "")
    rows = [f"{before.format(k)}{each}{after}" for k, each in enumerate(["0,0,0,0,0,0", row])]
    path.write_text("\n".join([",".join(head), *rows]) + "\n")
    inputs = [str(path), "--robot", THESIS] if command == "verify" else [THESIS, str(path)]
    assert refused(run(command, *inputs)) == [
        f"{path}: row 2 (line 3), {words}" + " behind home" * words.endswith("tube")
    ]


def test_tables_of_targets_and_trials_name_their_columns(run: Run, tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("x_mm,y_mm,z_mm\n50,30,150\n50,30,90000\n")
    assert refused(run("ik", THESIS, "--targets", str(tmp_path / "t.csv"))) == [
        f"{tmp_path}/t.csv: x_mm, y_mm, z_mm in row 2 is 50, 30, 90000 mm, 90000 mm from the plate, and the longest "
        "tube is 400 mm long; it must be at most 4000 mm away"
    ]
    (tmp_path / "m.csv").write_text("mold_radius_mm,obtained_radius_mm\n60,65\n0.06,0.065\n")
    assert refused(run("mold", "calibrate", str(tmp_path / "m.csv"))) == [
        f"{tmp_path}/m.csv: row 2 (line 3), column {name} is {value}; it must be 1 to 10000, as radii of curved tubes "
        "are"
        for name, value in (("mold_radius_mm", "0.06"), ("obtained_radius_mm", "0.065"))
    ]


def test_a_file_of_another_kind_is_one_sentence(run: Run, tmp_path: Path) -> None:
    rig, mold = str(ROOT / "configs/rigs/thesis_mdf.yaml"), str(ROOT / "configs/molds/calcium_silicate.yaml")
    assert refused(run("mold", "plan", THESIS, "--mold", rig)) == [f"{rig}: kind is 'rig'; it must be mold"]
    for command, flag in (("mold plan", "--springback"), ("view", "--obstacles")):
        assert refused(run(*command.split(), THESIS, flag, mold)) == [
            f"{mold}: this is a file of kind 'mold'; another kind is required here"
        ]


@pytest.mark.parametrize(("value", "code"), [("1", 2), ("-2", 2)])
def test_folds_are_none_or_two_and_more(run: Run, value: str, code: int) -> None:
    outcome = run("validate", *ETR, "--folds", value)
    assert refused(outcome) == [f"--folds is {value}; it must be 0, or at least 2"]
    assert outcome.code == code


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        ("--fit curvture", "--fit: parameter 'curvture' is not known; did you mean 'curvature'?"),
        ("--fit rotation_all,rotation_1", "--fit: parameter 'rotation_1' is given twice"),
        ("--compare --fit curvture", "--fit: effect 'curvture' cannot be compared; did you mean 'curvature'?"),
        ("--fit curvature --axis-noise-deg 1", "--axis-noise-deg is given, and the measurements have no directions"),
        *(
            (f"{flag} {value}".strip(), f"{flag} is given without --fit or --compare; only these use it")
            for flag, value in (
                ("--axis-noise-deg", "1"),
                ("--noise-mm", "1"),
                ("--folds", "3"),
                ("--confidence", "0.9"),
                ("--loss", "huber"),
                ("--priors", ""),
            )
        ),
    ],
)
def test_flags_of_a_fit_are_checked_and_never_ignored(run: Run, flags: str, words: str) -> None:
    (message,) = refused(run("validate", *ETR, *flags.split()))
    assert message.startswith(words)


def test_rates_of_all_studies_name_their_key(run: Run, tmp_path: Path) -> None:
    text = "rates.translation_mm_per_s is [10, 20]; it must be one number, or 3 (one per tube)"
    rates = "rates: {translation_mm_per_s: [10, 20]}\n"
    (tmp_path / "t.csv").write_text("time_s,rotation_1_deg,rotation_2_deg,rotation_3_deg\n0,0,0,0\n5,10,0,0\n")
    (tmp_path / "v.yaml").write_text(f"kind: verify\nrobot: {THESIS}\ntrajectory: t.csv\n{rates}")
    (tmp_path / "p.yaml").write_text(f"{PLAN}goal_deg: [1, 0, 0]\n{rates}")
    (tmp_path / "u.yaml").write_text(f"kind: verify\nrobot: {THESIS}\ntrajectory: t.csv\nstudy: p.yaml\n")
    arm = f"{{robot: {THESIS}, goal_deg: [1, 0, 0]}}"
    (tmp_path / "a.yaml").write_text(f"kind: plan_arms\narms: [{arm}, {arm}]\n{rates}")
    for name in "va":
        assert refused(run("run", str(tmp_path / f"{name}.yaml"))) == [f"{tmp_path}/{name}.yaml: {text}"]
    (message,) = refused(run("run", str(tmp_path / "u.yaml")))
    assert message.endswith(f"{tmp_path}/p.yaml: {text}") or message.endswith(f"p.yaml: {text}")


def test_programs_of_a_mold_stay_finite(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "m.yaml"
    for keys, text in (
        ("milling: {step_down_mm: 0.0005}", "milling.step_down_mm is 0.0005; it must be at least 0.01"),
        ("milling: {feed_mm_per_min: 0.001}", "milling.feed_mm_per_min is 0.001; it must be at least 1.2"),
        ("workshop: {peck_mm: 0.001}", "workshop.peck_mm is 0.001; it must be at least 0.01"),
        ("workshop: {outline_step_mm: 0.001}", "workshop.outline_step_mm is 0.001; it must be at least 0.01"),
    ):
        path.write_text(f"kind: mold\n{keys}\n")
        assert refused(run("mold", "plan", THESIS, "--mold", str(path))) == [f"{path}: {text}"]


@pytest.mark.parametrize(
    ("said", "typed"),
    [
        (
            "limits are -3 to 5 m, and it is 0.2 m long: translations are in m",
            "limits are -3000 to 5000 mm, and it is 200 mm long",
        ),
        ("at least the length of segment 2, 0.09 m", "at least the length of segment 2, 90 mm"),
        ("it is at 0.9 m (900 mm)", "it is at 900 mm"),
        ("is 50 m; usual is 0.001 to 10 m: was 50 mm meant?", "is 50000 mm; usual is 1 to 10000 mm"),
        ("has 2 rad; rotations are in rad: was 2 deg meant?", "has 114.592 deg"),
        ("a twist of 2 rad per m, 3 1/m, 2 m/s, 7 m^2", "a twist of 114.592 deg per m, 3 1/m, 2 m/s, 7 m^2"),
        (
            "radius_mm is 5; that would be usual in m: was 5000 meant?",
            "radius_mm is 5; that would be usual in m: was 5000 meant?",
        ),
    ],
)
def test_sentences_of_the_library_come_in_the_units_that_are_typed(said: str, typed: str) -> None:
    assert in_input_units(said) == typed


def test_obstacles_typed_as_text_are_named_by_their_flag(run: Run) -> None:
    for text, message in (("[{radius_mm: 3}]", "--obstacles[0] has no kind"), ("{radius_mm: 3}", "--obstacles is {")):
        (line,) = refused(run("ik", THESIS, "--target-mm", "0,0,100", "--obstacles", text))
        assert line.startswith(message)


def test_a_missing_server_package_is_reported_before_the_robot_is_compiled(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiled: list[object] = []
    monkeypatch.setattr("tubeopt.control.server.find_spec", lambda name: None)
    monkeypatch.setattr("tubeopt.cli.control.servo_of", lambda *_, **__: compiled.append(0))
    assert refused(run("serve", THESIS)) == ["websockets is missing; pip install 'tubeopt[control]' brings it"]
    assert not compiled


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        ([], "measurements: the tips determine the device frame to"),
        (["--fit", "curvature,nu,rotation_all", "--folds", "0"], "measurements: 3 measured tips are 9 numbers; 1"),
    ],
)
def test_tips_that_determine_too_little_are_named_by_the_key(
    flags: list[str], words: str, run: Run, tmp_path: Path
) -> None:
    """Three tips near a line determine no frame, and nine numbers no ten unknowns."""
    joints = "0,0,0,1,2,150\n10,0,0,2,2,150\n0,20,0,3,3,150\n"
    (tmp_path / "m.csv").write_text(f"rotation_1_deg,rotation_2_deg,rotation_3_deg,x_mm,y_mm,z_mm\n{joints}")
    (problem,) = refused(run("validate", THESIS, str(tmp_path / "m.csv"), *flags))
    assert problem.startswith(words)
