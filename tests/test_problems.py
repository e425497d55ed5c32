"""Every problem runs and saves the pictures that it promises."""

from __future__ import annotations

import importlib.util
import inspect
from pathlib import Path

import pytest
from PIL import Image

PROBLEMS = sorted((Path(__file__).resolve().parents[1] / "problems").glob("*.py"))


@pytest.mark.parametrize("script", PROBLEMS, ids=lambda script: script.stem)
def test_problem(script: Path, tmp_path: Path) -> None:
    spec = importlib.util.spec_from_file_location(script.stem, script)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    # Maps as fine as in their pictures take up to half a minute.
    coarse = {"samples": 12} if "samples" in inspect.signature(module.main).parameters else {}
    pictures = module.main(tmp_path, **coarse)
    assert pictures
    for picture in pictures:
        with Image.open(picture) as image:
            image.verify()
