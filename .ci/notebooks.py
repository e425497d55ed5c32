"""Run the notebooks, in processes of their own, and keep what comes out.

    python .ci/notebooks.py [NAME ...]

writes the outputs into the files in `notebooks/`. `tests/test_notebooks.py` runs them too and compares.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

NOTEBOOKS = Path(__file__).resolve().parents[1] / "notebooks"
TIMEOUT = 120
"""Seconds that a cell may take."""


FORGET = "%reset -f"


def run(path: Path, kernel: Any = None, before: str = "") -> Any:
    """The notebook, executed, in a process of its own or in that of `kernel`, its manager, which forgets what others
    left there and has code of its own run `before`; raises nbclient's CellExecutionError where a cell fails."""
    import nbformat
    from nbclient import NotebookClient

    notebook = nbformat.read(path, as_version=4)
    if kernel is not None:
        notebook.cells.insert(0, nbformat.v4.new_code_cell(f"{FORGET}\n{before}"))
    client = NotebookClient(notebook, km=kernel, timeout=TIMEOUT, resources={"metadata": {"path": str(path.parent)}})
    client.execute()
    if kernel is not None:
        client.kc.stop_channels()
        del notebook.cells[0]
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)
        for output in cell.get("outputs", []):
            shown = output.get("data", {})
            if "text/html" in shown and "<img" in shown["text/html"]:
                shown.pop("image/png", None)  # the page has the picture already
    return notebook


def printed(notebook: Any) -> list[str]:
    """What its cells print, in order."""
    outputs = (output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs)
    return [output.text for output in outputs if output.output_type == "stream"]


def main(names: list[str]) -> None:
    import nbformat

    for path in sorted(NOTEBOOKS.glob("*.ipynb")):
        if not names or path.stem in names:
            nbformat.write(run(path), path)
            print(path)


if __name__ == "__main__":
    main(sys.argv[1:])
