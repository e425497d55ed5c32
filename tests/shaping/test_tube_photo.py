"""Radius of a tube from scans and photos: against pictures of an independent renderer, and what is refused."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from benchmarks.tube_photos import Scene, random_scene, render, save
from tests.command_line import Run, answer, refused
from tubeopt import InputError
from tubeopt.runs.workshop_file import load_trials
from tubeopt.shaping import load_photo, measure_tube
from tubeopt.shaping.mold.arc_fit import fit_arc, fit_circle

SCAN = Scene(radius=40, angle=1.2, diameter=1.2, leads=(12, 8), fades=(4, 4), dpi=200, place=(55, 45), blur=0.7)
PHOTO = Scene(radius=60, angle=1.2, tilt=math.radians(12), tilt_towards=0.7, blur=0.6)


def measured(scene: Scene, path: Path, **options: Any) -> Any:
    return measure_tube(load_photo(save(scene, path)), **options)


BY_DAY = (3, 9, 12)
"""Two scans, and a photo with a ruler, of the 30."""


def inside(k: int, folder: Path) -> tuple[bool, float]:
    """Whether the k-th radius lies in its interval, and half the width of the interval, relative."""
    scene = random_scene(k)
    m = measured(scene, folder / ("photo.jpg" if scene.dpi is None else "scan.png"))
    low, high = m.interval
    return low < scene.drawn_radius / 1e3 < high, m.half_width / m.radius


def test_radii_lie_in_their_intervals_by_day(tmp_path: Path) -> None:
    results = [inside(k, tmp_path) for k in BY_DAY]
    assert all(hit for hit, _ in results)
    assert max(width for _, width in results) < 0.02


@pytest.mark.night
def test_28_of_30_radii_lie_in_their_intervals(tmp_path: Path) -> None:
    results = [inside(k, tmp_path) for k in range(30)]
    assert sum(hit for hit, _ in results) >= 28
    assert np.median([width for _, width in results]) < 0.02


def test_a_scan_of_a_tube_with_leads(tmp_path: Path) -> None:
    m = measured(SCAN, tmp_path / "scan.png")
    assert m.radius == pytest.approx(40e-3, rel=2e-3)
    assert m.arc.length == pytest.approx(40e-3 * 1.2 + 4e-3, abs=1e-3)
    assert m.arc.leads == pytest.approx((12e-3, 8e-3), abs=2.5e-3) or m.arc.leads == pytest.approx(
        (8e-3, 12e-3), abs=2.5e-3
    )
    assert m.trace.width == pytest.approx(1.2e-3, rel=0.05)
    # The whole trace has straight ends, so that a circle through all of it is larger.
    assert fit_circle(m.trace.points).radius > 1.03 * m.radius


def test_the_scale_is_that_of_the_resolution(tmp_path: Path) -> None:
    path = tmp_path / "scan.png"
    one = measured(SCAN, path)
    assert measure_tube(load_photo(path), dpi=400).radius == pytest.approx(one.radius / 2, rel=1e-3)


def test_marks_correct_tilt_and_the_height_of_the_tube(tmp_path: Path) -> None:
    thick = replace(PHOTO, diameter=2.5, distance=250.0, leads=(0, 0))
    m = measured(thick, tmp_path / "photo.jpg")
    assert math.degrees(m.scale.tilt) == pytest.approx(12, abs=0.3)
    assert m.radius == pytest.approx(60e-3, rel=2e-3)
    # On the sheet itself the tube looks larger, by its height over the distance of the camera.
    on_sheet = fit_circle(m.trace.points).radius
    assert on_sheet / m.radius - 1 == pytest.approx(1.25 / 250, rel=0.3)


def test_marks_at_other_distances_scale_the_radius(tmp_path: Path) -> None:
    path = tmp_path / "photo.png"
    one = measured(PHOTO, path)
    other = measure_tube(load_photo(path), marks=(0.2424, 0.1717))
    assert other.radius / one.radius == pytest.approx(1.01, rel=1e-3)


def test_a_lighter_tube_and_a_highlight(tmp_path: Path) -> None:
    light = measured(replace(SCAN, tube=0.95, paper=0.4), tmp_path / "light.png")
    assert not light.trace.dark
    shiny = measured(replace(SCAN, highlight=0.55, diameter=2.0), tmp_path / "shiny.png")
    assert shiny.trace.dark
    for m in (light, shiny):
        assert m.radius == pytest.approx(40e-3, rel=3e-3)


def test_the_error_of_the_fit_is_that_of_repeated_fits() -> None:
    """Of arcs with noise that is correlated along them, 95 % of the radii lie in their intervals."""
    random, hits, angle = np.random.default_rng(4), 0, np.linspace(0, 1.0, 200)
    for _ in range(60):
        noise = ndimage.gaussian_filter1d(random.normal(size=200), 3.0) * 5e-5
        points = (50e-3 + noise)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        arc = fit_arc(points)
        hits += abs(arc.radius - 50e-3) < arc.half_width
    assert hits >= 54


def picture(path: Path, grey: Any, **notes: Any) -> Path:
    Image.fromarray((np.asarray(grey) * 255).astype(np.uint8)).save(path, **notes)
    return path


def test_what_cannot_be_measured_is_told(tmp_path: Path) -> None:
    scan = {"dpi": (200, 200)}
    straight = replace(SCAN, radius=1e5, angle=40e-5)
    second = replace(SCAN, place=(70, 25), turned=1.0, leads=(0, 0))
    first = replace(SCAN, place=(35, 60), leads=(0, 0))
    cases = {
        "no tube was found in the image": picture(tmp_path / "a.png", np.full((600, 600), 0.9), **scan),
        "the only line that was found is straight": save(straight, tmp_path / "b.png"),
        "2 curved lines were found": save(replace(first, more=[second]), tmp_path / "c.png"),
        "the tube is out of focus": save(replace(SCAN, blur=9.0, diameter=2.5), tmp_path / "d.png"),
        "no marks were found, and the file has no resolution": save(SCAN, tmp_path / "e.png", noted_dpi=False),
        "72 dpi, which is not that of a scanner": picture(tmp_path / "f.png", render(SCAN), dpi=(72, 72)),
        "3 of 4 marks were found, and the file has notes of a camera": save(
            replace(PHOTO, marks=(0, 1, 3)), tmp_path / "g.jpg"
        ),
    }
    for said, path in cases.items():
        with pytest.raises(InputError) as caught:
            measure_tube(load_photo(path))
        assert said in str(caught.value), path
        assert path.name in str(caught.value)
        assert "\n" not in str(caught.value)


def test_the_command_and_its_files(run: Run, tmp_path: Path) -> None:
    scans = {60.0: tmp_path / "one.png", 80.0: tmp_path / "two.png"}
    out = str(tmp_path / "out")
    for mold, path in scans.items():
        save(replace(SCAN, radius=mold * 1.08, angle=0.8, seed=int(mold)), path)
        data = answer(run("mold", "measure", str(path), "--mold-radius-mm", str(mold), "--out", out, "--json"))
        low, high = data["interval_mm"]
        assert low < mold * 1.08 < high
        assert data["standard_error_mm"] == pytest.approx((high - low) / 2 / 1.96)
    # The same photo again replaces its row.
    run("mold", "measure", str(path), "--mold-radius-mm", "81", "--out", out)
    trials = load_trials(tmp_path / "out" / "trials.csv")
    assert trials.mold_radius == pytest.approx([60e-3, 81e-3])
    assert trials.obtained_error is not None
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"measurement.json", "measurement.png", "trials.csv"}
    fit = answer(run("mold", "calibrate", str(tmp_path / "out" / "trials.csv"), "--json"))
    assert 5 < fit["fraction_percent"] < 9
    shown = run("mold", "measure", str(path)).out
    assert "radius" in shown
    assert "95 %:" in shown


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("nowhere.png",), "nowhere.png: there is no such file"),
        (("{trials}",), "this is no picture that can be read; it must be a PNG, JPEG or TIFF"),
        (("{scan}", "--dpi", "0"), "--dpi is 0; it must be greater than 0"),
        (("{scan}", "--dpi", "20"), "dpi is 20; it must be 90 to 10000"),
        (("{scan}", "--marks-mm", "240"), "marks"),
        (("{scan}", "--marks-mm", "24,17"), "marks are 24 x 17 mm; both must be 50 to 1000 mm"),
        (("{scan}", "--scale-error-percent", "30"), "--scale-error-percent is 30; it must be at most 20"),
        (("{scan}", "--mold-radius-mm", "-5"), "--mold-radius-mm is -5; it must be greater than 0"),
        (("{cut}",), "the picture cannot be read"),
        (("{huge}",), "more than 179 million pixels; it must have fewer: cut it to the tube"),
    ],
)
def test_wrong_input_is_refused(run: Run, tmp_path: Path, arguments: tuple[str, ...], said: str) -> None:
    scan = save(SCAN, tmp_path / "scan.png")
    (tmp_path / "cut.png").write_bytes(scan.read_bytes()[:2000])
    (tmp_path / "trials.csv").write_text("mold_radius_mm,obtained_radius_mm\n60,65\n")
    # Of one colour: a file of few bytes.
    Image.new("1", (20000, 9000)).save(tmp_path / "huge.png")
    names = {
        "scan": scan,
        "huge": tmp_path / "huge.png",
        "cut": tmp_path / "cut.png",
        "trials": tmp_path / "trials.csv",
    }
    lines = refused(run("mold", "measure", *(text.format(**names) for text in arguments)))
    assert said in lines[0]


def test_the_sheet_has_its_marks_where_they_are_measured(run: Run, tmp_path: Path) -> None:
    from tubeopt.shaping.mold.photo import SHEET_MARKS, find_marks
    from tubeopt.show.plots.tube_photo import plot_mark_sheet

    assert run("mold", "sheet", str(tmp_path / "marks.pdf")).code == 0
    assert (tmp_path / "marks.pdf").read_bytes().startswith(b"%PDF")
    assert "must end in .pdf" in refused(run("mold", "sheet", "marks.png"))[0]
    plot_mark_sheet(SHEET_MARKS, tmp_path / "marks.png")
    photo = load_photo(tmp_path / "marks.png")
    marks = find_marks(photo.grey)
    assert len(marks) == 4
    assert photo.dpi is not None
    sides = np.ptp(marks, axis=0) / photo.dpi * 0.0254
    assert sides == pytest.approx(SHEET_MARKS, rel=2e-3)
