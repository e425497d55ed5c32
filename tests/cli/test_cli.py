"""The command line: what it prints, what it saves, and how it fails."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer

import tubeopt
from tests.command_line import COLOUR, CRL, ROOT, THESIS, Run, answer, refused
from tubeopt.cli import output
from tubeopt.equilibrium.file import load_equilibrium
from tubeopt.errors import SolveError
from tubeopt.runs import forward_study
from tubeopt.show.plots.style import RC

STUDY = str(ROOT / "configs" / "studies" / "thesis_actuated.yaml")
ACTUATED = ["--rotations-deg", "0,57.29577951308232,114.59155902616465"]
TIP_MM = [72.83688204, -41.40882527, 169.68901052]


# --- every command ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", [["fk"], ["run"], ["robot", "show"]])
def test_every_command_has_help_with_an_example_and_the_common_flags(run: Run, command: list[str]) -> None:
    outcome = run(*command, "--help")
    assert outcome.code == 0
    assert f"Example: tubeopt {' '.join(command)} thesis_" in outcome.out
    assert "--json" in outcome.out
    assert "--out" in outcome.out


def test_the_examples_of_the_help_work(run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "configs").symlink_to(ROOT / "configs")
    monkeypatch.chdir(tmp_path)
    for command in (["fk"], ["run"], ["robot", "show"]):
        text = " ".join(run(*command, "--help").out.split())
        example = text.split("Example: tubeopt ")[1].split()
        assert run(*example).code == 0


def test_version(run: Run) -> None:
    assert run("--version").out == f"tubeopt {tubeopt.__version__}\n"


def test_without_a_command_the_help_is_shown(run: Run) -> None:
    outcome = run()
    assert "fk" in outcome.out + outcome.err


def test_as_a_module() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "tubeopt", "fk", "none.yaml"], capture_output=True, text=True, cwd=ROOT, check=False
    )
    assert (done.returncode, done.stdout, COLOUR.sub("", done.stderr)) == (
        2,
        "",
        "error: none.yaml: there is no such file\n",
    )


@pytest.mark.parametrize(
    ("typed", "message"),
    [
        (("ik", THESIS, "--position-mm", "1,2,3"), "there is no option --position-mm; those in mm are --target-mm, "),
        (("fk", THESIS, "--rotation-rad", "0,1,2"), "there is no option --rotation-rad; did you mean --rotations-deg"),
        (("fk", THESIS, "--rotations", "0,1,2"), "there is no option --rotations; did you mean --rotations-deg"),
        (("fk", THESIS, "--nonsense", "1"), "there is no option --nonsense; see tubeopt fk --help"),
        (("fk", THESIS, "--rotations-deg", "0", "57", "1e2"), "57 1e2 stands alone; several numbers of an option have"),
        (("fk", THESIS, "other.yaml"), "Got unexpected extra argument"),
    ],
)
def test_unknown_flag_is_reported_with_similar_flags(run: Run, typed: tuple[str, ...], message: str) -> None:
    outcome = run(*typed)
    assert outcome.code == 2
    assert message in outcome.err


# --- fk ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["newton", "ipopt", "energy"])
def test_fk_prints_one_json_object(run: Run, method: str) -> None:
    data = answer(run("fk", THESIS, *ACTUATED, "--translations-mm", "0,0,0", "--method", method, "--verify", "--json"))
    np.testing.assert_allclose(data["tip_position_mm"], TIP_MM, atol=1e-5)
    assert data["margin"] == pytest.approx(1.0, abs=1e-4)
    assert data["stable"] is True
    assert data["statistics"]["method"] == method
    assert data["verification"]["tip_position_mm"] < 1e-5
    assert data["files"] == []


def test_fk_prints_a_table(run: Run) -> None:
    outcome = run("fk", THESIS, "--rotations-deg", "0,90,180")
    assert outcome.code == 0
    for part in ("thesis CTR", "70.7508, -4.2300, 177.3853 mm", "0.927, stable", " mJ", "residual", "estimated error"):
        assert part in outcome.out


def test_fk_without_joint_values_is_at_home(run: Run) -> None:
    data = answer(run("fk", THESIS, "--json"))
    np.testing.assert_allclose(data["tip_position_mm"], [0, -90.75837047, 164.83462233], atol=1e-5)


def test_fk_takes_numbers_that_begin_with_a_minus(run: Run) -> None:
    for flags in (["--rotations-deg", "-10,0,5"], ["--rotations-deg=-10,0,5"], ["--rotations-deg", " -10, 0, 5 "]):
        assert answer(run("fk", THESIS, *flags, "--json"))["rotations_deg"] == pytest.approx([-10, 0, 5])
    assert answer(run("fk", THESIS, "--translations-mm", "-10,-1e1,-.5", "--json"))["translations_mm"] == pytest.approx(
        [-10, -10, -0.5]
    )


def test_fk_saves_results_and_pictures(run: Run, tmp_path: Path) -> None:
    out = tmp_path / "results"
    data = answer(run("fk", THESIS, *ACTUATED, "--json", "--out", str(out)))
    names = ["result.json", "arrays.npz", "shape.png", "torsion.png"]
    assert data["files"] == [str(out / name) for name in names]
    assert {path.name for path in out.iterdir()} == set(names)
    for name in names[2:]:
        assert (out / name).read_bytes().startswith(b"\x89PNG")
    np.testing.assert_allclose(load_equilibrium(out).tip_position * 1e3, TIP_MM, atol=1e-5)


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The files that would have been opened in a window."""
    paths: list[str] = []
    monkeypatch.setattr(typer, "launch", paths.append)
    return paths


@pytest.mark.parametrize("display", [False, True])
def test_fk_reports_paths_of_plots(
    run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, opened: list[str], display: bool
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(output, "has_display", lambda: display)
    outcome = run("fk", THESIS, "--plot")
    assert outcome.code == 0
    assert "saved shape.png\nsaved torsion.png\n" in outcome.out
    assert {path.name for path in tmp_path.iterdir()} == {"shape.png", "torsion.png"}
    assert opened == (["shape.png", "torsion.png"] if display else [])


def test_a_window_needs_a_display(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert not output.has_display()
    monkeypatch.setenv("DISPLAY", ":0")
    assert output.has_display()


# --- run --------------------------------------------------------------------------------------------------------------


def test_run_a_study(run: Run, tmp_path: Path) -> None:
    data = answer(run("run", STUDY, "--json", "--out", str(tmp_path)))
    np.testing.assert_allclose(data["tip_position_mm"], TIP_MM, atol=1e-5)
    assert data["rotations_deg"] == pytest.approx([0, 57.29577951308232, 114.59155902616465], abs=1e-12)
    assert len(data["files"]) == 4
    outcome = run("run", STUDY)
    assert "re-integration differs" in outcome.out


# --- robot show -------------------------------------------------------------------------------------------------------


def test_robot_show_prints_the_properties_of_the_tubes(run: Run, tmp_path: Path) -> None:
    data = answer(run("robot", "show", CRL, "--json", "--out", str(tmp_path)))
    inner = data["tubes"][0]
    second_moment = np.pi / 64 * (0.5**4 - 0.4**4)
    assert inner["bending_stiffness_N_mm2"] == pytest.approx(50e3 * second_moment)
    assert inner["torsional_stiffness_N_mm2"] == pytest.approx(50e3 / 2.6 * 2 * second_moment)
    assert inner["poisson_ratio"] == pytest.approx(0.3)
    assert inner["straightened_strain_percent"] == pytest.approx(100 * 0.007 / 0.993)
    assert [tube["radial_clearance_mm"] for tube in data["tubes"]] == [0.1, 0.15, None]
    assert [tube["length_mm"] for tube in data["tubes"]] == [210, 165, 110]
    assert len(data["warnings"]) == 1
    saved = json.loads((tmp_path / "robot.json").read_text(encoding="utf-8"))
    assert saved == {key: value for key, value in data.items() if key != "files"}
    table = run("robot", "show", THESIS).out
    for part in ("thesis CTR", "bending stiffness EI", "0.3488", "no warnings"):
        assert part in table


def test_robot_show_warns(run: Run, tmp_path: Path) -> None:
    lengths = "straight_length_mm: 9, curved_length_mm: 9"
    tubes = [
        f"  - {{outer_diameter_mm: {outer}, inner_diameter_mm: {inner}, {lengths}, radius_mm: {radius}}}"
        for outer, inner, radius in [(1, 0.9, 8), (1.2, 1, 30), (1.6, 1.45, 300), (2, 1.61, 300)]
    ]
    path = tmp_path / "robot.yaml"
    path.write_text("kind: concentric\ntubes:\n" + "\n".join(tubes))
    assert answer(run("robot", "show", str(path), "--json"))["warnings"] == [
        "tube 1 is strained 6.67 % when straightened, beyond the 6 % limit of superelasticity of nitinol",
        "tube 2 is strained 2.04 % when straightened, beyond the 1 % limit of nitinol for repeated bending",
        "tube 1 has 0 mm of radial clearance in tube 2, less than the 0.01 mm that sliding needs: friction "
        "will wind the tubes up",
        "tube 2 has 0.125 mm of radial clearance in tube 3, more than 0.1 mm: its axis may lie beside the outer tube's",
        "tube 3 has 0.005 mm of radial clearance in tube 4, less than the 0.01 mm that sliding needs: friction "
        "will wind the tubes up",
    ]
    assert "warning: tube 1 is strained 6.67 %" in run("robot", "show", str(path)).out


# --- failures ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("flags", "problem"),
    [
        (["--rotations-deg", "1,2"], "--rotations-deg has 2 numbers; it must be 3 (one per tube)"),
        (["--rotations-deg", "1"], "--rotations-deg has 1 number; it must be 3 (one per tube)"),
        (["--translations-mm", "1,2,3,4"], "--translations-mm has 4 numbers; it must be 3 (one per tube)"),
        (["--rotations-deg", "1,abc,3"], "--rotations-deg[1] is 'abc'; it must be a number"),
        (["--rotations-deg", "1,,3"], "--rotations-deg[1] is ''; it must be a number"),
        (["--rotations-deg", "1,nan,3"], "--rotations-deg[1] is NaN; it must be a finite number"),
        (["--translations-mm", "inf,0,0"], "--translations-mm[0] is Infinity; it must be a finite number"),
        (["--method", "newtn"], "--method is 'newtn'; it must be newton, ipopt or energy; did you mean 'newton'?"),
        (["--tolerance-rad", "0"], "--tolerance-rad is 0; it must be greater than 0"),
        (["--tolerance", "x"], "--tolerance-rad is 'x'; it must be a number"),
        (
            ["--translations-mm", "201,0,0"],
            "--translations-mm has 201 for tube 1; it must be at most its straight length, 200, where it is clamped",
        ),
        (
            ["--rotations-deg", "1e9,0,0"],
            "--rotations-deg has 1E+9 for tube 1; it must be at most 57296 (159 turns) to either side",
        ),
        (
            ["--rotation-deg", "1,2,3"],
            "there is no option --rotation-deg; did you mean --rotations-deg? see tubeopt fk --help",
        ),
        (
            ["--load", "{tip_force_mN: [1, 0"],
            "{tip_force_mN: [1, 0: line 1, column 21: not valid YAML: expected ',' or ']', but got '<stream end>'",
        ),
    ],
)
def test_fk_refuses(run: Run, flags: list[str], problem: str) -> None:
    assert refused(run("fk", THESIS, *flags)) == [problem]


def test_all_problems_are_reported_at_once(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    path.write_text("kind: concentric\ntubes: [{outer_diameter_mm: -1, inner_diameter_mm: 0, radius: 3}]\n")
    assert refused(run("fk", str(path), "--rotations-deg", "a", "--tolerance", "-1")) == [
        f"{path}: tubes[0].curved_length_mm is missing",
        f"{path}: tubes[0].outer_diameter_mm is -1; it must be greater than 0",
        f"{path}: tubes[0].straight_length_mm is missing",
        f"{path}: tubes[0].radius is not a known key; did you mean 'radius_mm'?",
        "--rotations-deg[0] is 'a'; it must be a number",
        "--tolerance-rad is -1; it must be greater than 0",
    ]


@pytest.mark.parametrize("command", [["fk"], ["run"], ["robot", "show"]])
def test_a_file_that_cannot_be_read(run: Run, tmp_path: Path, command: list[str]) -> None:
    assert refused(run(*command, "none.yaml")) == ["none.yaml: there is no such file"]
    near = str(ROOT / "configs" / "robots" / "thesis_ctr.y")
    assert refused(run(*command, near + "ml")) == [f"{near}ml: there is no such file; did you mean {near}aml?"]
    assert refused(run(*command, str(tmp_path))) == [f"{tmp_path}: this is a directory; it must be a file"]
    path = tmp_path / "x.yaml"
    path.write_text("a: !!python/object/apply:os.system ['touch owned']")
    assert refused(run(*command, str(path), "--json"))[0].startswith(f"{path}: line 1, column 4: not valid YAML: ")


def test_a_directory_that_cannot_be_written(run: Run, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    taken = str(tmp_path / "file")
    for command in (["fk", THESIS, "--json"], ["certify", THESIS], ["robot", "show", THESIS], ["run", STUDY, "--json"]):
        assert refused(run(*command, "--out", taken)) == [f"{taken}: nothing can be saved there: it is a file"]
    (problem,) = refused(run("fk", THESIS, "--out", f"{taken}/x"))
    assert problem == f"{taken}/x: nothing can be saved there: {taken} is a file, not a directory"


def test_what_cannot_be_saved_is_printed_all_the_same(run: Run, tmp_path: Path) -> None:
    (tmp_path / "shape.png").mkdir()
    outcome = run("fk", THESIS, "--out", str(tmp_path))
    assert (outcome.code, outcome.err) == (2, f"error: {tmp_path / 'shape.png'}: cannot be written: Is a directory\n")
    assert "-90.7584" in outcome.out
    data = answer(run("fk", THESIS, "--out", str(tmp_path), "--json"), 2)
    assert data["tip_position_mm"][2] == pytest.approx(164.8346, abs=1e-4)
    assert data["error"]["messages"] == [f"{tmp_path / 'shape.png'}: cannot be written: Is a directory"]


@pytest.mark.parametrize(
    "arguments", [["fk"], ["fk", THESIS, "--colour"], ["fl"], ["fk", THESIS, "1", "2"], ["robot", "x"]]
)
def test_usage_errors(run: Run, arguments: list[str]) -> None:
    (message,) = refused(run(*arguments))
    assert message.endswith(" --help")
    assert refused(run(*arguments, "--json")) == [message]


def test_no_solution(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*arguments: Any, **options: Any) -> None:
        raise SolveError("no equilibrium [was] found: torsion equation, tube 2: violated by 3e-3")

    monkeypatch.setattr(forward_study, "forward_kinematics", fail)
    outcome = run("fk", THESIS)
    assert outcome == (3, "", "error: no equilibrium [was] found: torsion equation, tube 2: violated by 3e-3\n")
    error = answer(run("fk", THESIS, "--json"), 3)["error"]
    assert (error["kind"], error["exit_code"]) == ("no_solution", 3)
    assert error["messages"] == ["no equilibrium [was] found: torsion equation, tube 2: violated by 3e-3"]


def test_an_interruption(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*arguments: Any, **options: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(forward_study, "forward_kinematics", interrupt)
    assert run("run", STUDY) == (130, "", "error: interrupted; nothing was saved\n")
    assert answer(run("fk", THESIS, "--json"), 130)["error"]["kind"] == "interrupted"


def test_output_that_nobody_reads_on() -> None:
    read, write = os.pipe()
    os.close(read)
    with open(write, "w") as closed:
        done = subprocess.run(
            [sys.executable, "-m", "tubeopt", "robot", "show", THESIS],
            stdout=closed,
            stderr=subprocess.PIPE,
            text=True,
            cwd=ROOT,
            check=False,
        )
    assert "Traceback" not in done.stderr


# --- formats ----------------------------------------------------------------------------------------------------------


def test_plots_and_arms_are_saved_in_requested_formats(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(RC, "pdf.fonttype", 42)  # that of the fixture has no room for the sign of a diameter
    outcome = run(
        "fk",
        THESIS,
        *ACTUATED,
        "--out",
        str(tmp_path),
        "--format",
        "svg,pdf,urdf,mjcf",
        "--width-mm",
        "88",
        "--no-title",
    )
    assert outcome.code == 0
    names = {path.name for path in tmp_path.iterdir()}
    pictures = {f"{name}.{form}" for name in ("shape", "torsion") for form in ("svg", "pdf")}
    assert names == {"result.json", "arrays.npz", "arm.urdf", "arm.xml", *pictures}
    head = (tmp_path / "shape.svg").read_text(encoding="utf-8")[:2000]
    assert f'width="{88 / 25.4 * 72:.6f}pt"'[:14] in head


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (
            ["--format", "jpg"],
            "--format is 'jpg'; `tubeopt fk` saves png, pdf, svg, eps, tiff, parquet, mat, stl, glb, urdf, mjcf",
        ),
        (["--width-mm", "5"], "--width-mm is 5; it must be a number from 50 to 300"),
        (["--width-mm", "wide"], "--width-mm is wide; it must be a number from 50 to 300"),
    ],
)
def test_formats_that_are_not_known_are_refused(run: Run, flags: list[str], words: str) -> None:
    outcome = run("fk", THESIS, *flags)
    assert outcome.code == 2
    assert words in " ".join(outcome.err.split())


# --- what is told besides the answer ----------------------------------------------------------------------------------


def test_robot_warnings_are_reported_by_every_command(run: Run) -> None:
    text = (
        "tube 2 has 0.15 mm of radial clearance in tube 3, more than 0.1 mm: its axis may lie beside the outer tube's"
    )
    outcome = run("fk", CRL)
    assert (outcome.code, outcome.err) == (0, f"warning: {text}\n")
    assert answer(run("fk", CRL, "--json"))["warnings"] == [text]
    assert answer(run("robot", "show", CRL, "--json"))["warnings"] == [text]


def test_quiet_prints_nothing_but_errors(run: Run, tmp_path: Path) -> None:
    assert run("fk", CRL, "--quiet", "--out", str(tmp_path)) == (0, "", "")
    assert (tmp_path / "result.json").exists()
    assert run("fk", "none.yaml", "--quiet").err == "error: none.yaml: there is no such file\n"


def test_what_is_logged_is_chosen(run: Run) -> None:
    assert run("--log", "error", "fk", CRL).err == ""
    assert "tubeopt.cli" in run("--log", "debug", "fk", CRL).err
    assert refused(run("--log", "loud", "fk", CRL))[0].startswith("Invalid value")


def test_the_help_of_all_commands_loads_none_of_them() -> None:
    script = "import sys\nfrom tubeopt.cli import main\ntry:\n    main(['--help'])\nfinally:\n    print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=ROOT, check=True)
    loaded = set(done.stdout.split())
    assert "Forward kinematics" in done.stdout
    assert not loaded & {"casadi", "scipy", "pydantic", "yaml", "matplotlib", "tubeopt.robots"}


def test_commands_complete_in_the_shell() -> None:
    variables = {"_TUBEOPT_COMPLETE": "complete_bash", "COMP_WORDS": "tubeopt sn", "COMP_CWORD": "1"}
    command = [sys.executable, "-c", "import sys; sys.argv[0] = 'tubeopt'; from tubeopt.cli import main; main()"]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | variables, cwd=ROOT, check=False)
    assert done.stdout.split() == ["snap"]
