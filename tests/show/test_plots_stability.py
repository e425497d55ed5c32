"""Pictures of stability: what they show is where the numbers are, complete, and nothing is cut off."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.text import Annotation
from PIL import Image

from tests.examples import THESIS
from tubeopt import (
    Branch,
    ConcentricRobot,
    EnergyMap,
    InputError,
    Path,
    Snap,
    StabilityMap,
    energy_map,
    find_snap,
    follow,
    trace_branch,
)
from tubeopt.show.plots import (
    plot_branch,
    plot_energy_maps,
    plot_hysteresis,
    plot_shapes,
    plot_snap,
    plot_stability_map,
    tube_colour,
)
from tubeopt.show.plots.maps import energy_levels, fold_points, landing, smooth
from tubeopt.stability.following import stretches, value_at_snap
from tubeopt.stability.maps import APPROACH, pieces
from tubeopt.typing import Array

FULL_TURN = np.radians([360.0, 0.0, 0.0])
ANGLES = np.linspace(0.0, 360.0, 25)


@pytest.fixture(scope="module")
def branch() -> Branch:
    return trace_branch(THESIS, np.zeros(3), FULL_TURN)


@pytest.fixture(scope="module")
def snap() -> Snap:
    snap = find_snap(THESIS, (np.zeros(3), None), (FULL_TURN, None))
    assert snap is not None
    return snap


@pytest.fixture(scope="module")
def ways() -> tuple[Path, Path]:
    rotations = np.radians(ANGLES)[:, None] * [1.0, 0.0, 0.0]
    forth = follow(THESIS, rotations)
    return forth, follow(THESIS, rotations[::-1], start=forth.equilibria[-1])


@pytest.fixture(scope="module")
def maps() -> list[EnergyMap]:
    window = np.radians([(-30.0, 390.0), (-90.0, 90.0)])
    return [energy_map(THESIS, np.radians([deg, 0, 0]), samples=13, window=window) for deg in (135.0, 180.0)]


@pytest.fixture(scope="module")
def chart() -> StabilityMap:
    """Made up: snaps in one corner, bounded by a line that some directions do not meet."""
    angles = np.linspace(-np.pi, np.pi, 7)
    snaps = (angles[:, None] + angles > 3.5).astype(int)
    margin = 1 - 0.1 * np.abs(angles[:, None] - angles)
    directions = np.append(np.radians([10, 45, 80]), np.arange(3, 8) * np.pi / 4)
    boundary = np.full((8, 2), np.nan)
    boundary[:3] = [[3.1, 3.1 * np.tan(np.radians(10))], [1.75, 1.75], [3.1 * np.tan(np.radians(10)), 3.1]]
    approach = np.full((8, len(APPROACH)), np.nan)
    approach[:3] = np.sqrt(APPROACH)
    return StabilityMap((0, 1), angles, np.clip(margin, 0.1, 1), snaps, directions, boundary, approach)


def texts(axes: Axes) -> list[str]:
    """All annotations with words."""
    return [child.get_text() for child in axes.get_children() if isinstance(child, Annotation) and child.get_text()]


def arrows(axes: Axes) -> list[Any]:
    """From where to where each arrow goes, (2, 2)."""
    results = [
        child for child in axes.get_children() if isinstance(child, Annotation) and child.arrow_patch is not None
    ]
    return [np.array([each.xyann, each.xy], dtype=float) for each in results]


def marks(axes: Axes, marker: str) -> Array:
    """(k, 2) places of the signs of one kind."""
    lines = [line for line in axes.lines if line.get_marker() == marker]
    return np.concatenate([np.empty((0, 2)), *(np.array(line.get_xydata(), dtype=float) for line in lines)])


def relative_tips(tips: Array) -> Array:
    """Tip angles (..., 3) rad of tube 1 relative to tube 3, deg."""
    return np.asarray(np.degrees(tips[..., 0] - tips[..., 2]))


def test_branch_is_solid_where_it_is_stable(branch: Branch) -> None:
    axes = plot_branch(branch).axes[0]
    for label, style, sign in (("stable", "-", 1), ("unstable", "--", -1)):
        (line,) = [line for line in axes.lines if line.get_label() == label]
        assert line.get_linestyle() == style
        assert line.get_color() == tube_colour(0)
        shown = np.asarray(line.get_xydata(), dtype=float)
        for tips, inputs, margin in zip(
            relative_tips(branch.tip_rotations), np.degrees(branch.rotations[:, 0]), branch.margin, strict=True
        ):
            if sign * margin > 1e-6 and (label == "unstable" or inputs < 140):
                assert np.abs(shown - [inputs, tips]).max(1).min() < 1e-6


def test_folds_are_marked_with_their_angles(branch: Branch) -> None:
    axes = plot_branch(branch).axes[0]
    folds = np.array([[np.degrees(f.rotations[0]), relative_tips(f.tip_rotations)] for f in branch.folds])
    np.testing.assert_allclose(marks(axes, "o"), folds, atol=1e-6)
    assert "input 214.222°\ntip 126.652°" in texts(axes)
    assert "input 145.778°\ntip 233.348°" in texts(axes)


def test_jumps_of_a_branch_end_where_the_robot_lands(branch: Branch, snap: Snap) -> None:
    forth, back = arrows(plot_branch(branch).axes[0])
    desired = [relative_tips(each.tip_rotations) for each in (snap.before, snap.after)]
    np.testing.assert_allclose(forth[:, 0], 214.222427, atol=1e-5)
    np.testing.assert_allclose(forth[:, 1], desired, atol=1e-3)
    # By the symmetry of the robot the way back is the way forth seen from a turn on.
    np.testing.assert_allclose(back, 360 - forth, atol=1e-3)


def test_no_jump_where_the_branch_does_not_lead_on(branch: Branch) -> None:
    last = fold_points(branch)[1]
    short = replace(
        branch,
        **{name: getattr(branch, name)[: last + 1] for name in ("fraction", "rotations", "tip_rotations", "margin")},
    )
    assert landing(smooth(short), fold_points(smooth(short))[0]) is None
    assert len(arrows(plot_branch(short).axes[0])) == 1


def test_inputs_with_two_shapes_are_shaded(branch: Branch) -> None:
    figure = plot_branch(branch)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    band: Any = handles[labels.index("more than one stable shape")]
    np.testing.assert_allclose([band.get_x(), band.get_x() + band.get_width()], [145.777573, 214.222427], atol=1e-5)


def test_branch_without_folds_and_with_dots() -> None:
    calm = trace_branch(THESIS, np.zeros(3), np.radians([90.0, 0.0, 0.0]))
    axes = plot_branch(calm, dots=[[0.0, 0.0], [0.5, 0.25]], dots_label="another").axes[0]
    assert arrows(axes) == []
    np.testing.assert_allclose(marks(axes, "."), np.degrees([[0.0, 0.0], [0.5, 0.25]]))
    assert [line.get_label() for line in axes.lines] == ["stable", "another"]


def test_smoothing_keeps_the_points(branch: Branch) -> None:
    fine = smooth(branch)
    assert len(fine.fraction) > 10 * len(branch.fraction)
    for k in (0, 17, fold_points(branch)[0]):
        nearest = int(np.argmin(np.abs(fine.tip_rotations - branch.tip_rotations[k]).max(1)))
        np.testing.assert_allclose(fine.tip_rotations[nearest], branch.tip_rotations[k], atol=1e-12)
        np.testing.assert_allclose(fine.fraction[nearest], branch.fraction[k], atol=1e-12)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"tube": 3}, "must be two different tubes from 0 to 2"),
        ({"tube": 1, "reference": 1}, "must be two different tubes"),
        ({"tube": 1}, "does not turn against"),
    ],
)
def test_wrong_tubes_of_a_branch_are_refused(branch: Branch, arguments: dict[str, int], message: str) -> None:
    with pytest.raises(InputError, match=message):
        plot_branch(branch, **arguments)  # type: ignore[arg-type]


def test_energy_maps_mark_every_equilibrium(maps: list[EnergyMap]) -> None:
    figure = plot_energy_maps(maps)
    for axes, each in zip(figure.axes, maps, strict=False):
        for marker, index in (("o", 0), ("X", 1)):
            tips = [np.degrees(e.tip_rotations[:2]) for e in each.equilibria if e.index == index]
            np.testing.assert_allclose(marks(axes, marker), np.reshape(tips, (-1, 2)))
        np.testing.assert_allclose(axes.get_xlim(), (-30.0, 390.0))
        assert axes.get_title(loc="left").startswith("rotations (1")
    assert [len(each.equilibria) for each in maps] == [1, 3]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["minimum: stable", "saddle: unstable"]


def test_energy_maps_share_their_colours_in_millijoules(maps: list[EnergyMap]) -> None:
    levels = energy_levels([each.energy for each in maps])
    assert np.all(np.diff(levels) > 0)
    assert levels[0] == pytest.approx(1e3 * min(each.energy.min() for each in maps))
    assert levels[-1] == pytest.approx(1e3 * max(each.energy.max() for each in maps))
    figure = plot_energy_maps(maps)
    assert figure.axes[-1].get_ylabel() == "elastic energy (mJ)"
    # Below the saddle its level line closes around each minimum.
    (saddle,) = [e.energy * 1e3 for e in maps[1].equilibria if e.index == 1]
    assert all(e.energy * 1e3 < saddle for e in maps[1].equilibria if e.index == 0)


def test_energy_maps_of_another_number_are_refused(maps: list[EnergyMap]) -> None:
    with pytest.raises(InputError, match="0 maps are given; there must be 1 to 4"):
        plot_energy_maps([])
    with pytest.raises(InputError, match="1 titles are given for 2 maps"):
        plot_energy_maps(maps, titles=["one"])


def test_snap_shows_both_shapes_and_the_jump(snap: Snap) -> None:
    figure = plot_snap(snap, view=(0.0, 0.0))
    assert "214.222°, 0°, 0°" in figure.get_suptitle()
    assert "98.0 mm, 5.15 mJ" in figure.get_suptitle()
    before, after = figure.axes
    assert before.get_title(loc="left").startswith("before\ntip (39.7, −24.2, 190.3) mm\nmargin 0")
    assert "margin 1.000" in after.get_title(loc="left")
    # Seen along x, y is to the right and z is up.
    ((old, new),) = arrows(after)
    np.testing.assert_allclose(old, snap.before.tip_position[1:] * 1e3, atol=1e-9)
    np.testing.assert_allclose(new, snap.after.tip_position[1:] * 1e3, atol=1e-9)
    np.testing.assert_allclose(before.get_xlim(), after.get_xlim())
    opacities = [
        np.concatenate([np.asarray(collection.get_facecolor())[:, 3] for collection in scene.collections[2:]])
        for scene in (before, after)
    ]
    assert [bool(np.any(opacity < 0.5)) for opacity in opacities] == [False, True]


def test_snap_with_translations_names_them(snap: Snap) -> None:
    moved = replace(snap, before=replace(snap.before, translations=np.array([-0.02, -0.01, 0.0])))
    assert "translations (−20, −10, 0) mm" in plot_snap(moved, title="mine").get_suptitle()


def test_stability_map_hatches_what_a_snap_led_to(chart: StabilityMap) -> None:
    figure = plot_stability_map(chart, title="made up")
    axes = figure.axes[0]
    (region,) = [each for each in axes.patches if isinstance(each, PathPatch)]
    assert region.get_hatch() == "////"
    behind = region.get_path().contains_points
    # The map is made up: three directions lead to a snap, and what lies behind it in between is hatched.
    folds = np.degrees(chart.boundary[:3])
    assert behind(1.01 * folds[1:2]).all()
    assert behind([[179.0, 179.0], [179.0, 60.0], [60.0, 179.0]]).all()
    assert not behind(0.99 * folds).any()
    assert not behind([[0.0, 0.0], [-90.0, 0.0], [170.0, 20.0], [20.0, 170.0]]).any()
    names = [text.get_text() for text in figure.legends[0].get_texts()]
    assert names == ["reached through a snap", "snap on the straight path from home", "home"]


def test_stability_map_has_the_first_tube_to_the_right(chart: StabilityMap) -> None:
    calm = {"snaps": 0 * chart.snaps, "boundary": np.full((8, 2), np.nan)}
    turned = replace(chart, margin=np.tile(np.linspace(0, 1, 7)[:, None], 7), tubes=(1, 2), **calm)
    axes = plot_stability_map(turned).axes[0]
    image: Any = axes.collections[0]
    shown = np.reshape(image.get_array(), (361, 361))
    np.testing.assert_allclose(shown[180, ::60], np.linspace(0, 1, 7), atol=1e-9)
    np.testing.assert_allclose(shown - shown[180], 0, atol=2e-2)
    assert (np.diff(shown[180]) >= -1e-9).all()
    assert axes.get_xlabel().startswith("rotation of tube 2 ")
    assert axes.get_ylabel().startswith("rotation of tube 3 ")


def test_margin_falls_to_the_boundary_as_it_was_found_ahead_of_it(chart: StabilityMap) -> None:
    """Here like the root of the distance, in every direction alike."""
    image: Any = plot_stability_map(chart).axes[0].collections[0]
    shown = np.reshape(image.get_array(), (361, 361))
    for k in range(1, 20):
        position = 180 + np.degrees(1.75) - k  # along both axes
        x = int(position)
        ahead = np.sqrt(2) * (1.75 - np.radians(x - 180))
        if ahead < APPROACH[0]:
            assert shown[x, x] == pytest.approx(np.sqrt(ahead), abs=0.02)


def test_snap_boundary_is_exact_and_broken_where_there_is_none(chart: StabilityMap) -> None:
    (line, _) = plot_stability_map(chart).axes[0].lines
    shown = np.asarray(line.get_xydata(), dtype=float)
    np.testing.assert_allclose(shown[[0, len(shown) // 2, -1]], np.degrees(chart.boundary[:3]))
    direction = np.arctan2(*shown.T[::-1])
    assert (np.diff(direction) > 0).all()
    assert (direction[0], direction[-1]) == pytest.approx(np.radians([10, 80]))


def test_boundary_all_around_is_one_closed_curve(chart: StabilityMap) -> None:
    directions = np.arange(8) * np.pi / 4
    ring = np.column_stack([np.cos(directions), np.sin(directions)])
    whole = replace(chart, directions=directions, boundary=2 * ring, approach=np.tile(np.sqrt(APPROACH), (8, 1)))
    ((around, points, _),) = pieces(whole)
    assert around[-1] - around[0] == pytest.approx(2 * np.pi)
    assert points[0] == pytest.approx(points[-1])
    (region,) = [each for each in plot_stability_map(whole).axes[0].patches if isinstance(each, PathPatch)]
    behind = region.get_path().contains_points([[0.0, 0.0], [0.0, 110.0], [0.0, 120.0], [-170.0, -170.0]])
    assert behind.tolist() == [False, False, True, True]


def test_stability_map_without_snaps(chart: StabilityMap) -> None:
    calm = replace(chart, snaps=0 * chart.snaps, boundary=np.full((8, 2), np.nan))
    figure = plot_stability_map(calm)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["home"]


def test_ways_are_cut_at_the_very_snap(ways: tuple[Path, Path]) -> None:
    for walked, angles in zip(ways, (ANGLES, ANGLES[::-1]), strict=True):
        (snap,) = walked.snaps
        (first, before), (second, after) = stretches(walked, angles)
        assert first[-1] == second[0] == pytest.approx(np.degrees(snap.rotations[0]), abs=1e-9)
        assert before[-1] is snap.before
        assert after[0] is snap.after
        assert len(first) + len(second) == len(ANGLES) + 2
        assert value_at_snap(snap, angles) == first[-1]
        for where, what in ((first, before), (second, after)):
            np.testing.assert_allclose(where, [np.degrees(e.rotations[0]) for e in what], atol=1e-9)


def test_two_snaps_between_two_waypoints(ways: tuple[Path, Path]) -> None:
    forth, _ = ways
    once = forth.snaps[0]
    twice = Path(forth.equilibria, (replace(once, fraction=0.2), replace(once, fraction=0.6)))
    parts = [where for where, _ in stretches(twice, ANGLES)]
    assert [len(where) for where in parts] == [once.index + 2, 2, len(ANGLES) - once.index]
    assert np.all(np.diff(np.concatenate(parts)) >= 0)


def test_hysteresis_shows_tip_energy_and_margin(ways: tuple[Path, Path]) -> None:
    forth, back = ways
    figure = plot_hysteresis((forth, back), angles_deg=ANGLES, axis="y", title="a turn")
    tip, energy, margin = figure.axes
    assert [axes.get_ylabel() for axes in figure.axes] == ["tip y (mm)", "elastic energy (mJ)", "margin"]
    first = np.asarray(tip.lines[0].get_xydata(), dtype=float)
    np.testing.assert_allclose(first[5], [ANGLES[5], forth.equilibria[5].tip_position[1] * 1e3])
    for axes, values in (
        (tip, [e.tip_position[1] * 1e3 for e in (forth.snaps[0].before, forth.snaps[0].after)]),
        (energy, [e.energy * 1e3 for e in (forth.snaps[0].before, forth.snaps[0].after)]),
        (margin, [0.0, forth.snaps[0].after.margin]),
    ):
        jump = arrows(axes)[0]
        np.testing.assert_allclose(jump[:, 0], 214.222427, atol=1e-5)
        np.testing.assert_allclose(jump[:, 1], values, atol=1e-9)
    assert "214.22°\ntip jumps 98.0 mm\n5.15 mJ released" in texts(tip)
    assert "145.78°\ntip jumps 98.0 mm\n5.15 mJ released" in texts(tip)


def test_hysteresis_shows_what_jumps_most(ways: tuple[Path, Path]) -> None:
    assert plot_hysteresis(ways, angles_deg=ANGLES).axes[0].get_ylabel() == "tip x (mm)"
    calm = Path(ways[0].equilibria[:5], ())
    back = Path(ways[0].equilibria[4::-1], ())
    assert arrows(plot_hysteresis((calm, back), angles_deg=ANGLES[:5]).axes[0]) == []


def test_wrong_ways_are_refused(ways: tuple[Path, Path]) -> None:
    with pytest.raises(InputError, match="there must be one angle per waypoint"):
        plot_hysteresis(ways, angles_deg=ANGLES[1:])
    with pytest.raises(InputError, match="it must be x, y or z"):
        plot_hysteresis(ways, angles_deg=ANGLES, axis="tip")


@pytest.fixture
def drawings(
    branch: Branch, snap: Snap, ways: tuple[Path, Path], maps: list[EnergyMap], chart: StabilityMap
) -> dict[str, Callable[[FilePath], Figure]]:
    return {
        "branch": lambda path: plot_branch(branch, path),
        "energy": lambda path: plot_energy_maps([*maps, maps[0]], path),
        "snap": lambda path: plot_snap(snap, path),
        "map": lambda path: plot_stability_map(chart, path),
        "ways": lambda path: plot_hysteresis(ways, path, angles_deg=ANGLES),
        # The tallest box that the tests have, with headings above it.
        "shapes": lambda path: plot_shapes([snap.before, snap.after], path, titles=["before", "after"]),
    }


@pytest.mark.parametrize("name", ["branch", "energy", "snap", "map", "ways", "shapes"])
def test_pictures_are_whole(name: str, drawings: dict[str, Callable[[FilePath], Figure]], tmp_path: FilePath) -> None:
    path = tmp_path / "new" / "picture.png"
    drawings[name](path)
    with Image.open(path) as image:
        assert image.format == "PNG"
        assert [round(dpi) for dpi in image.info["dpi"]] == [200, 200]
        pixels = np.asarray(image.convert("L"))
    assert np.mean(pixels < 200) > 0.01
    edge = np.concatenate([pixels[0], pixels[-1], pixels[:, 0], pixels[:, -1]])
    assert edge.min() == 255, "something is cut off at the edge"
    assert [file.name for file in path.parent.iterdir()] == ["picture.png"]


def test_equal_data_give_equal_files(
    maps: list[EnergyMap], chart: StabilityMap, tmp_path: FilePath, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tubeopt.show.plots.style.DPI", 50)
    draws: list[tuple[str, Callable[[FilePath], Figure]]] = [
        ("png", lambda file: plot_energy_maps(maps, file)),
        ("svg", lambda file: plot_stability_map(chart, file)),
    ]
    for suffix, draw in draws:
        files = [tmp_path / f"{name}.{suffix}" for name in "ab"]
        for file in files:
            draw(file)
        assert files[0].read_bytes() == files[1].read_bytes()


def test_two_tubes_are_measured_from_each_other() -> None:
    inner, middle, _ = THESIS.tubes
    pair = ConcentricRobot((inner, middle))
    path = trace_branch(pair, (0.0, 0.0), (0.0, 1.0))
    axes = plot_branch(path, tube=1).axes[0]
    assert axes.get_xlabel() == "input angle of tube 2 relative to tube 1 (deg)"
    assert axes.lines[0].get_color() == tube_colour(1)
