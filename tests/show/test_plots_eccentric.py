"""Pictures of eccentric robots: tubes at their true places, in sheaths that hold them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.examples import CONFIGS, MM, THESIS
from tubeopt import EccentricRobot, Equilibrium, InputError, SegmentedEccentricRobot, forward_kinematics, load_robot
from tubeopt.equilibrium.centrelines import tube_centrelines
from tubeopt.inverse.mirror import ASSIGNMENTS, mirror_rotations, permuted_tips
from tubeopt.show.plots import plot_shape
from tubeopt.show.plots.eccentric import Curve, Permutations, arm_curve, plot_permutations, plot_reach
from tubeopt.show.plots.projection import Projection, facets
from tubeopt.show.plots.scene import robot_mesh
from tubeopt.show.plots.shape import CLOSE_UP
from tubeopt.show.surfaces import SHEATH_COLOUR, SHEATH_OPACITY, tube_groups

ETR = load_robot(CONFIGS / "thesis_etr.yaml")
THREE = load_robot(CONFIGS / "example_three_segment_etr.yaml")
assert isinstance(ETR, EccentricRobot)
assert isinstance(THREE, SegmentedEccentricRobot)


@pytest.fixture(scope="module")
def bent() -> Equilibrium:
    return forward_kinematics(ETR, mirror_rotations(1.0, 0.5))


@pytest.fixture(scope="module")
def three() -> Equilibrium:
    return forward_kinematics(THREE, np.concatenate([mirror_rotations(a, 0.3) for a in (0.0, 2.0, 1.0)]))


def test_tubes_of_a_segment_stand_together(bent: Equilibrium, three: Equilibrium) -> None:
    (one,) = tube_groups(bent)
    assert one.tubes == (0, 1, 2)
    assert (one.start, one.end) == pytest.approx((0.0, 94 * MM))
    assert one.radius == pytest.approx(ETR.sheath_inner_diameter / 2)
    assert [bundle.tubes for bundle in tube_groups(three)] == [(6, 7, 8), (3, 4, 5), (0, 1, 2)]
    assert [bundle.end for bundle in tube_groups(three)] == pytest.approx([50 * MM, 90 * MM, 120 * MM])


def test_concentric_tubes_stand_alone() -> None:
    home = forward_kinematics(THESIS, (0.0, 0.0, 0.0))
    assert [bundle.tubes for bundle in tube_groups(home)] == [(2,), (1,), (0,)]
    assert [bundle.radius for bundle in tube_groups(home)] == pytest.approx([0.7 * MM, 0.6 * MM, 0.5 * MM])


def test_tubes_are_drawn_at_their_places(bent: Equilibrium) -> None:
    mesh = robot_mesh(bent, window=(90 * MM, 95 * MM), detail=CLOSE_UP)
    tips = tube_centrelines(bent)[:, -1]
    at_end = mesh.corners.reshape(-1, 3)
    at_end = at_end[np.abs((at_end - bent.tip_position) @ bent.tip_rotation[:, 2]) < 1e-9]
    nearest = np.linalg.norm(at_end[:, None] - tips, axis=2).min(1)
    inner, outer = 1.57 * MM / 2, 1.92 * MM / 2
    assert (np.linalg.norm(at_end[:, None] - tips, axis=2).min(0) < 1e-9).all()
    rims = nearest[nearest > 0.5 * inner]
    assert np.isclose(rims, inner, rtol=1e-6).any()
    assert np.isclose(rims, outer, rtol=1e-6).any()


def test_the_sheath_is_translucent_and_holds_all(bent: Equilibrium) -> None:
    mesh = robot_mesh(bent)
    sheath = mesh.colours[:, 3] < 1
    assert np.allclose(mesh.colours[sheath], [*(c / 255 for c in SHEATH_COLOUR), SHEATH_OPACITY])
    assert (mesh.lift[sheath] > 0).all()
    assert (mesh.lift[~sheath] == 0).all()
    first = mesh.corners[sheath].reshape(-1, 48, 4, 3)[0, :, :2]
    assert np.linalg.norm(first, axis=2) == pytest.approx(np.full((48, 2), ETR.sheath_inner_diameter / 2), rel=1e-9)


def test_the_sheath_lies_over_the_tubes_and_behind_them(bent: Equilibrium) -> None:
    mesh, view = robot_mesh(bent), Projection(18.0, -60.0)
    colours = mesh.lit(view.towards_viewer, view.towards_light)
    drawn = np.asarray(facets(mesh, view).get_facecolor())
    order = np.argsort(mesh.depth(view.towards_viewer))
    assert drawn == pytest.approx(colours[order])
    towards = mesh.normals @ view.towards_viewer
    sheath = mesh.colours[:, 3] < 1
    depth = mesh.depth(view.towards_viewer)
    plain = mesh.corners.mean(1) @ view.towards_viewer
    assert (depth[sheath & (towards > 0.01)] > plain[sheath & (towards > 0.01)]).all()
    assert (depth[sheath & (towards < -0.01)] < plain[sheath & (towards < -0.01)]).all()
    assert depth[~sheath] == pytest.approx(plain[~sheath])


def test_names_and_carriages(three: Equilibrium, tmp_path: Path) -> None:
    figure = plot_shape(three, tmp_path / "three.png")
    words = [text.get_text() for axes in figure.axes for text in axes.texts]
    for i in range(9):
        assert f"tube {i + 1}" in words
    assert "tubes 7–9, ∅ 1.92 mm" in words
    assert "translations (90, 50, 0) mm" in figure.get_suptitle()
    with Image.open(tmp_path / "three.png") as image:
        assert image.size == (1400, 1000)


def test_reach_shows_every_tip(bent: Equilibrium, tmp_path: Path) -> None:
    ring = Curve(np.array([[0.02, 0.0, 0.09], [0.0, 0.02, 0.09], [-0.02, 0.0, 0.09]]), 2.0, tip=False)
    figure = plot_reach([arm_curve(bent, 1.0), ring], tmp_path / "reach.png", title="two", label="value")
    scene, above, side = figure.axes[:3]
    counts = [sum(len(c.get_offsets()) for c in axes.collections if c.get_offsets().any()) for axes in (above, side)]
    assert counts == [1, 2]
    marks = [c for c in side.collections if len(c.get_offsets()) == 2]
    tip = np.hypot(*bent.tip_position[:2]) / MM, bent.tip_position[2] / MM
    assert np.abs(np.asarray(marks[0].get_offsets()) - tip).sum(1).min() < 1e-6
    assert scene.get_aspect() == above.get_aspect() == side.get_aspect() == 1.0
    assert (tmp_path / "reach.png").stat().st_size > 10_000


def test_permutations_are_named_and_scaled(tmp_path: Path) -> None:
    tips, reference = permuted_tips(ETR, 0.0, 0.7)
    arm = forward_kinematics(ETR, mirror_rotations(0.0, 0.7))
    data = Permutations(
        tips=tips,
        reference=reference,
        names=["".join(map(str, order)) for order in ASSIGNMENTS],
        frame=arm.tip_rotation,
        separation=np.array([0.0, 0.7, 2.0]),
        deviation=np.array([1e-6, 1.38e-5, 1e-7]),
        shown=0.7,
        published=(0.36e-3, "elsewhere"),
    )
    figure = plot_permutations(data, tmp_path / "six.png", title="six", arms=[arm] * 7)
    words = [text.get_text() for axes in figure.axes for text in axes.texts]
    assert {"012", "210", "d = 0", "elsewhere: 0.36 mm", "0.0138 mm at 40°"} <= set(words)
    assert (tmp_path / "six.png").exists()
    with pytest.raises(InputError, match=r"must end in \.png, \.pdf, \.svg, .eps, .tiff$"):
        plot_permutations(data, tmp_path / "six.gif", title="six")
