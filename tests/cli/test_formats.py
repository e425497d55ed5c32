"""A format in which a command saves nothing is refused before anything is computed."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.command_line import THESIS, Run, refused
from tubeopt.cli.commands import COMMANDS, StudyCommand
from tubeopt.show.reports import formats_of, reports

PICTURES = ("png", "pdf", "svg", "eps", "tiff")


@pytest.mark.parametrize(
    ("command", "formats"),
    [
        ("fk", (*PICTURES, "parquet", "mat", "stl", "glb", "urdf", "mjcf")),
        ("certify", PICTURES),
        ("ik", (*PICTURES, "stl", "glb", "urdf", "mjcf")),
        ("validate", PICTURES),
        ("plan", (*PICTURES, "gif", "mp4", "parquet", "mat")),
        ("sweep", ("parquet", "mat")),
        ("force", ()),
    ],
)
def test_formats_of_commands(command: str, formats: tuple[str, ...]) -> None:
    assert formats_of(command) == formats


def test_every_command_that_asks_has_a_report_of_its_name() -> None:
    """Without one all its formats would be refused."""
    known = {command.partition(" --")[0] for command in reports()}
    assert {text for text, row in COMMANDS.items() if isinstance(row, StudyCommand)} <= known


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        (("certify", THESIS, "--format", "stl"), "--format is 'stl'; `tubeopt certify` saves png, pdf, svg, eps, tiff"),
        (
            ("plan", "plan_thesis_turn", "--format", "pdf,glb"),
            "--format is 'glb'; `tubeopt plan` saves png, pdf, svg, eps, tiff, gif, mp4, parquet, mat",
        ),
        (("run", "thesis_snap", "--format", "parquet"), "--format is 'parquet'; `tubeopt snap` saves png, "),
        (("sweep", "sweep_tips", "--format", "pdf"), "--format is 'pdf'; `tubeopt sweep` saves parquet, mat"),
        (
            ("fk", THESIS, "--format", "jpg"),
            "--format is 'jpg'; `tubeopt fk` saves png, pdf, svg, eps, tiff, parquet, ",
        ),
    ],
)
def test_a_format_that_a_command_does_not_have(run: Run, tmp_path: Path, typed: tuple[str, ...], said: str) -> None:
    (line,) = refused(run(*typed, "--out", str(tmp_path / "out")))
    assert line.startswith(said)
    assert not (tmp_path / "out").exists()


def test_words_of_a_flag_are_shown_as_its_choices(run: Run) -> None:
    assert "[newton|ipopt|energy]" in run("fk", "--help").out


def test_the_help_groups_the_commands(run: Run) -> None:
    shown = run("--help").out
    for heading in ("Ask", "Design", "Plan", "Build", "Measure", "Real time", "Files"):
        assert f"─ {heading} ─" in shown
    assert "─ Commands ─" not in shown


@pytest.mark.parametrize("command", ["force", "measure", "export", "serve", "view", "heat run"])
def test_a_command_without_plots_has_no_flags_for_them(run: Run, command: str) -> None:
    shown = run(*command.split(), "--help").out
    assert not any(flag in shown for flag in ("--plot", "--format", "--width-mm"))
    assert formats_of(command) == ()


def test_a_sweep_has_formats_of_its_table_alone(run: Run) -> None:
    shown = run("sweep", "--help").out
    assert not any(flag in shown for flag in ("--plot", "--width-mm", "--no-title", "png"))
    assert all(form in shown for form in formats_of("sweep"))
