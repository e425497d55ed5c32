"""What a user waits for who only wants one thing: `import tubeopt` loads nothing that is not asked for."""

from __future__ import annotations

import subprocess
import sys

import pytest

import tubeopt


def loaded_by(statement: str) -> set[str]:
    """Names of the modules that a fresh interpreter has loaded after a statement."""
    script = f"import sys\n{statement}\nprint(*sorted(sys.modules))"
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    return set(run.stdout.split())


def test_the_package_alone_loads_no_library() -> None:
    assert not loaded_by("import tubeopt") & {"numpy", "scipy", "casadi", "matplotlib", "pydantic", "typer"}


def test_forward_kinematics_needs_neither_statistics_nor_pictures() -> None:
    modules = loaded_by("from tubeopt import forward_kinematics, load_robot")
    assert not modules & {"scipy.stats", "scipy.linalg", "scipy.optimize", "matplotlib", "typer", "viser", "trimesh"}


def test_the_answer_of_fk_is_told_without_the_questions() -> None:
    modules = loaded_by("import tubeopt.cli.flags, tubeopt.runs.forward_study, tubeopt.show.equilibrium_report")
    assert not modules & {"tubeopt.stability", "tubeopt.inverse", "tubeopt.planning", "tubeopt.design"}


@pytest.mark.parametrize("name", sorted(tubeopt.__all__))
def test_every_public_name_is_there(name: str) -> None:
    assert getattr(tubeopt, name) is not None


@pytest.mark.parametrize("old", tubeopt.RENAMED)
def test_an_old_name_still_works_and_names_the_new_one(old: str) -> None:
    with pytest.warns(DeprecationWarning, match=f"is now tubeopt.{tubeopt.RENAMED[old]}"):
        assert getattr(tubeopt, old) is getattr(tubeopt, tubeopt.RENAMED[old])
