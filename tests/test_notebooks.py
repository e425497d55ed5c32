"""The notebooks run, and print what they say that they print."""

from __future__ import annotations

import runpy
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))

SMALL = """
from tubeopt.show.plots import figure, layout
figure.SCREEN_DPI, layout.MAX_PASSES = 30, 1
del figure, layout
"""
"""What is compared is text: pictures are small, and laid out once."""

pytest.importorskip("nbclient")
pytest.importorskip("ipykernel")


@pytest.fixture(scope="module")
def kernel() -> Iterator[Any]:
    """One process for all: most of the time of each is that of its start."""
    from jupyter_client import KernelManager

    manager = KernelManager()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(ROOT))
        patch.setenv("OPENBLAS_NUM_THREADS", "1")
        yield manager
    manager.shutdown_kernel(now=True)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_it_prints_what_it_says(path: Path, kernel: Any) -> None:
    import nbformat

    if "to_dataframe" in path.read_text(encoding="utf-8"):
        pytest.importorskip("pandas")
    tool = runpy.run_path(str(ROOT / ".ci" / "notebooks.py"))
    retained = nbformat.read(path, as_version=4)
    assert tool["printed"](tool["run"](path, kernel, SMALL)) == tool["printed"](retained)


def test_there_is_one_for_each_thing_that_a_beginner_asks() -> None:
    assert [path.stem for path in NOTEBOOKS] == [
        "1_first_steps",
        "2_snapping",
        "3_design",
        "4_your_own_problem",
        "5_planning",
        "6_heating",
    ]
