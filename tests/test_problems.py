"""Every problem runs and saves the pictures that it promises; the gallery of the site shows what came of it.

Where TUBEOPT_GALLERY names a directory, pictures and what was printed are left there for the pages of the site.
"""

from __future__ import annotations

import importlib.util
import inspect
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from PIL import Image

from tests.conftest import draw_quickly

SAMPLES = {
    "calibrate_friction": 36,
    "control_estimator": 2,
    "design_pair": 3,
    "heating_led": 20,
    "load_snap_directions": 3,
    "thesis_snap_distance": 4,
    "own_certified_dexterity": 2,
    "own_dexterity": 1,
    "own_shape_estimation": 1,
    "thesis_error_budget": 4,
}
"""Of rows, poses and seconds, fewer than a problem has; of all others, as of maps, 12: as many as it has take up to
half a minute."""

LAW_RIGS = 12
"""Rigs on which the gains of a law are chosen: a quarter of as many as usual."""

PROBLEMS = sorted((Path(__file__).resolve().parents[1] / "problems").glob("*.py"))


def problem(script: Path) -> tuple[Callable[..., list[Path]], dict[str, int]]:
    """The function of a problem that draws its pictures, and how many samples of a few are enough for a test."""
    spec = importlib.util.spec_from_file_location(script.stem, script)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    samples = inspect.signature(module.main).parameters.get("samples")
    fewer = SAMPLES.get(script.stem, 12)
    return module.main, {"samples": fewer} if samples is not None and samples.default > fewer else {}


@pytest.mark.parametrize("script", PROBLEMS, ids=lambda script: script.stem)
def test_problem(
    script: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tubeopt.shaping.heating.robust.RIGS", LAW_RIGS)
    main, coarse = problem(script)
    gallery = os.environ.get("TUBEOPT_GALLERY")
    if coarse or not gallery:
        draw_quickly(monkeypatch)
    pictures = main(tmp_path, **coarse)
    assert pictures
    for picture in pictures:
        with Image.open(picture) as image:
            image.verify()
    if gallery:
        keep_for_gallery(Path(gallery), script.stem, pictures, capsys.readouterr().out, coarse=bool(coarse))


def keep_for_gallery(gallery: Path, name: str, pictures: list[Path], printed: str, *, coarse: bool) -> None:
    """Leave what the gallery's page of a problem shows; `coarse` pictures are not for showing."""
    gallery.mkdir(parents=True, exist_ok=True)
    for picture in () if coarse else pictures:
        shutil.copy(picture, gallery / picture.name)
    record = {"pictures": [picture.name for picture in pictures], "printed": printed, "coarse": coarse}
    (gallery / f"{name}.json").write_text(json.dumps(record), encoding="utf-8")
