"""The notebooks run, and print what they say that they print."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))

pytest.importorskip("nbclient")
pytest.importorskip("ipykernel")


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_it_prints_what_it_says(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import nbformat

    if "to_dataframe" in path.read_text(encoding="utf-8"):
        pytest.importorskip("pandas")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "1")
    tool = runpy.run_path(str(ROOT / ".ci" / "notebooks.py"))
    kept = nbformat.read(path, as_version=4)
    assert tool["printed"](tool["run"](path)) == tool["printed"](kept)


def test_there_is_one_for_each_thing_that_a_beginner_asks() -> None:
    assert [path.stem for path in NOTEBOOKS] == [
        "1_first_steps",
        "2_snapping",
        "3_design",
        "4_your_own_problem",
        "5_planning",
        "6_heating",
    ]
