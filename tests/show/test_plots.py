"""Pictures: true to scale, complete, and either whole on disk or absent."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from tests.conftest import LAID_OUT
from tubeopt import ConcentricRobot, Equilibrium, InputError, Load, Tube, forward_kinematics, load_robot
from tubeopt.robots.load import PointLoad
from tubeopt.show.plots import plot_shape, plot_shapes, plot_torsion, save_figure, tube_colour
from tubeopt.show.plots.projection import DrawnMesh, Projection, SceneBox, facets_of, rule_step, widest_view
from tubeopt.show.plots.scene import SWEEPING, load_arrows, robot_mesh
from tubeopt.show.plots.shape import breakpoints
from tubeopt.show.plots.style import number
from tubeopt.show.surfaces import SampledCentreline, ring_surface, robot_parts, tube_surface, visible

ROBOT = ConcentricRobot(
    (
        Tube(1.0e-3, 0.9e-3, 0.2, 0.2, 10.0),
        Tube(1.2e-3, 1.05e-3, 0.15, 0.15, 5.0),
        Tube(1.4e-3, 1.25e-3, 0.1, 0.1, 2.5),
    ),
    name="three tubes",
)
RED = np.array([1.0, 0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def home() -> Equilibrium:
    return forward_kinematics(ROBOT, (0.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def actuated() -> Equilibrium:
    return forward_kinematics(ROBOT, (0.0, 1.0, 2.0))


@pytest.fixture(scope="module")
def circle() -> Equilibrium:
    """One tube, bent to a circle of radius 50 mm in the plane x = 0 about the point (0, -50, 0) mm."""
    return forward_kinematics(ConcentricRobot((Tube(2e-3, 1e-3, 0.02, 0.1, 20.0),)), (0.0,))


def distance_to_circle(points: np.ndarray[Any, np.dtype[np.float64]]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Distance of points (..., 3) to the centreline of `circle`, m."""
    in_plane = np.hypot(points[..., 1] + 0.05, points[..., 2]) - 0.05
    return np.asarray(np.hypot(in_plane, points[..., 0]))


def test_tube_surface_has_the_true_radius(circle: Equilibrium) -> None:
    line, s = SampledCentreline(circle), np.linspace(0.0, 0.1, 40)
    mesh = facets_of(tube_surface(line, s, 1e-3, np.zeros(2), sides=24), RED)
    first = mesh.corners.reshape(39, 24, 4, 3)[:, :, :2]
    np.testing.assert_allclose(np.linalg.norm(first - line.position(s[:-1])[:, None, None], axis=-1), 1e-3, rtol=1e-12)
    np.testing.assert_allclose(distance_to_circle(mesh.corners), 1e-3, rtol=1e-3)


def test_normals_point_outwards(circle: Equilibrium) -> None:
    mesh = facets_of(
        tube_surface(SampledCentreline(circle), np.linspace(0.0, 0.1, 40), 1e-3, np.zeros(2), sides=24), RED
    )
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0)
    middle = mesh.corners.mean(axis=1)
    assert np.all(distance_to_circle(middle + 1e-4 * mesh.normals) > distance_to_circle(middle) + 0.9e-4)


def test_ring_lies_across_the_arm(actuated: Equilibrium) -> None:
    mesh = facets_of(ring_surface(SampledCentreline(actuated), 0.2, (0.4e-3, 0.5e-3), np.zeros(2), sides=24), RED)
    from_tip = mesh.corners - actuated.tip_position
    np.testing.assert_allclose(from_tip @ actuated.tip_rotation[:, 2], 0.0, atol=1e-12)
    radii = np.linalg.norm(from_tip, axis=-1)
    np.testing.assert_allclose([radii.min(), radii.max()], [0.4e-3, 0.5e-3])


def test_surfaces_reach_from_the_plate_to_the_tip(actuated: Equilibrium) -> None:
    mesh = robot_mesh(actuated)
    assert abs(mesh.corners[..., 2].min()) < 1e-12
    rim = np.linalg.norm(mesh.corners - actuated.tip_position, axis=-1).min()
    np.testing.assert_allclose(rim, 0.0, atol=1e-12)
    from_tip = mesh.corners.reshape(-1, 3) - actuated.tip_position
    assert (from_tip @ actuated.tip_rotation[:, 2]).max() < 1e-12


def test_each_tube_shows_from_the_end_of_the_next_outer_one(home: Equilibrium) -> None:
    assert [stretch.tube for stretch in visible(home)] == [2, 1, 0]
    stretches = [[stretch.start, stretch.end] for stretch in visible(home)]
    np.testing.assert_allclose(stretches, [[0.0, 0.1], [0.1, 0.15], [0.15, 0.2]])


def test_a_tube_inside_an_outer_one_does_not_show() -> None:
    equilibrium = forward_kinematics(ROBOT, (0.0, 0.5, -1.0), (-0.15, 0.01, -0.11))
    assert [stretch.tube for stretch in visible(equilibrium)] == [1]
    colours = robot_mesh(equilibrium).colours
    assert not np.any(np.all(np.isclose(colours, matplotlib.colors.to_rgba(tube_colour(0))), axis=1))


def test_every_view_keeps_lengths() -> None:
    for view in (Projection(18.0, -60.0), Projection(90.0, 10.0), Projection(-30.0, 200.0)):
        np.testing.assert_allclose(view.axes @ view.axes.T, np.eye(3), atol=1e-15)
        assert np.linalg.det(view.axes) == pytest.approx(1.0)
        np.testing.assert_allclose(
            view.project(np.array([3.0, 4.0, 12.0])) @ view.project(np.array([3.0, 4.0, 12.0])), 169e6
        )


def test_axes_have_one_scale(actuated: Equilibrium, home: Equilibrium) -> None:
    figure = plot_shapes([home, actuated])
    figure.canvas.draw()
    scales = []
    for scene in figure.axes[:2]:
        right, up = scene.transData.transform([[1.0, 0.0], [0.0, 1.0]]) - scene.transData.transform([0.0, 0.0])
        np.testing.assert_allclose(right[0], up[1], rtol=1e-9)
        scales.append(right[0])
    assert scales[0] == pytest.approx(scales[1], rel=1e-9)


def test_automatic_view_looks_across_the_shape(home: Equilibrium) -> None:
    view = widest_view(home.position)
    tip = view.project(home.tip_position)
    assert tip[0] > 0.8 * 90.758
    assert abs(tip[2] - view.project(np.array([0.0, 0.0, home.tip_position[2]]))[2]) < 0.6 * 90.758


def test_box_ends_on_whole_rules() -> None:
    box = SceneBox.around(np.array([[-0.003, 0.0, -0.001], [0.081, 0.02, 0.17]]))
    np.testing.assert_allclose(box.low, [-20.0, 0.0, -1.0])
    np.testing.assert_allclose(box.high, [100.0, 20.0, 180.0])
    np.testing.assert_allclose(box.rules(2), np.arange(0.0, 181.0, 20.0))


@pytest.mark.parametrize(("span", "step"), [(180.0, 20.0), (80.0, 20.0), (9.0, 2.0), (0.4, 0.1), (4000.0, 1000.0)])
def test_rules_are_round(span: float, step: float) -> None:
    assert rule_step(span) == pytest.approx(step)


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [(57.29578, 1, "57.3"), (-0.04, 1, "0"), (100.0, 0, "100"), (-90.0, 3, "\N{MINUS SIGN}90"), (1.05, 3, "1.05")],
)
def test_numbers_are_short(value: float, digits: int, text: str) -> None:
    assert number(value, digits) == text


def test_light_keeps_colours_in_range(actuated: Equilibrium) -> None:
    mesh, view = robot_mesh(actuated, opacity=0.3), Projection(18.0, -60.0)
    lit = mesh.lit(view.towards_viewer, view.towards_light)
    assert lit.min() >= 0.0
    assert lit.max() <= 1.0
    np.testing.assert_array_equal(lit[:, 3], mesh.colours[:, 3])
    assert DrawnMesh.join([mesh, mesh]).corners.shape == (2 * len(mesh.corners), 4, 3)


def test_torsion_curves_end_with_their_tubes(actuated: Equilibrium) -> None:
    figure = plot_torsion(actuated)
    above, below = figure.axes
    for axes in (above, below):
        assert "mm" in below.get_xlabel()
        assert "deg" in axes.get_ylabel()
        for i, end in enumerate((200.0, 150.0, 100.0)):
            (curve,) = [line for line in axes.lines if line.get_label() == f"tube {i + 1}"]
            assert np.max(np.asarray(curve.get_xdata())) == pytest.approx(end)
            assert curve.get_color() == tube_colour(i)
    (inner,) = [line for line in above.lines if line.get_label() == "tube 1"]
    np.testing.assert_allclose(np.asarray(inner.get_ydata())[[0, -1]], np.degrees(actuated.rotation[0, [0, -1]]))
    (inner,) = [line for line in below.lines if line.get_label() == "tube 1"]
    np.testing.assert_allclose(np.asarray(inner.get_ydata())[0], np.degrees(actuated.torsion[0, 0]) / 1e3)


def test_breakpoints_are_named() -> None:
    equilibrium = forward_kinematics(ROBOT, (0.0, 0.4, 1.0), (0.02, 0.02, 0.0))
    assert breakpoints(equilibrium) == {
        20.0: "tube 1 curves, 2 curves",
        100.0: "tube 3 ends",
        170.0: "tube 2 ends",
        220.0: "tube 1 ends",
    }


def test_constant_torsion_is_not_magnified(home: Equilibrium) -> None:
    above, below = plot_torsion(home).axes
    assert np.ptp(above.get_ylim()) >= 20.0
    assert np.ptp(below.get_ylim()) >= 0.02


def test_a_robot_wholly_behind_the_plate(tmp_path: Path) -> None:
    withdrawn = forward_kinematics(ROBOT, (0.0, 1.0, 2.0), (-0.2, -0.15, -0.1))
    assert visible(withdrawn) == []
    plot_shape(withdrawn, tmp_path / "shape.png")
    plot_torsion(withdrawn, tmp_path / "torsion.png")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["shape.png", "torsion.png"]


@pytest.mark.parametrize("translations", [(0.0, 0.0, 0.0), (0.02, 0.01, 0.015), (-0.15, 0.01, -0.11)])
def test_pictures_are_whole(translations: tuple[float, ...], tmp_path: Path) -> None:
    equilibrium = forward_kinematics(ROBOT, (0.0, 1.0, 2.0), translations)
    for plot, name in ((plot_shape, "shape.png"), (plot_torsion, "torsion.png")):
        path = tmp_path / "new" / name
        plot(equilibrium, path)
        with Image.open(path) as image:
            assert image.format == "PNG"
            assert image.size == (1400, 1000)
            assert [round(dpi) for dpi in image.info["dpi"]] == [200, 200]
            pixels = np.asarray(image.convert("L"))
        assert 0.01 < np.mean(pixels < 200) < 0.5
        edge = np.concatenate([pixels[0], pixels[-1], pixels[:, 0], pixels[:, -1]])
        assert edge.min() == 255, "something is cut off at the edge"


def test_ghosts_are_drawn_translucent(home: Equilibrium, actuated: Equilibrium) -> None:
    scene = plot_shape(actuated, ghosts=[home]).axes[0]
    opacities = np.concatenate([np.asarray(collection.get_facecolor())[:, 3] for collection in scene.collections[2:]])
    assert np.any(opacities < 0.5)
    assert np.any(opacities == 1.0)


def test_equal_data_give_equal_files(actuated: Equilibrium, tmp_path: Path) -> None:
    figures = []
    for _ in range(2):
        LAID_OUT.clear()  # else one is laid out for both
        figures.append(plot_torsion(actuated))
    for suffix in ("pdf", "svg"):  # PNG in the next test but two
        files = [tmp_path / f"{name}.{suffix}" for name in "ab"]
        for figure, file in zip(figures, files, strict=True):
            save_figure(figure, file)
        assert files[0].read_bytes() == files[1].read_bytes()


def test_unknown_format_is_refused(actuated: Equilibrium, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"must end in \.png, \.pdf, \.svg"):
        plot_shape(actuated, tmp_path / "shape.jpeg")
    assert list(tmp_path.iterdir()) == []


def test_failure_leaves_the_old_picture(actuated: Equilibrium, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def break_off(self: Figure, file: Any, **_: Any) -> None:
        Path(file).write_bytes(b"half a picture")
        raise RuntimeError("the disk broke")

    path = tmp_path / "torsion.png"
    path.write_bytes(b"old")
    monkeypatch.setattr(Figure, "savefig", break_off)
    with pytest.raises(RuntimeError, match="the disk broke"):
        plot_torsion(actuated, path)
    assert path.read_bytes() == b"old"
    assert [file.name for file in tmp_path.iterdir()] == ["torsion.png"]


def test_callers_settings_neither_matter_nor_change(
    actuated: Equilibrium, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tubeopt.show.plots.style.DPI", 50)
    plot_torsion(actuated, tmp_path / "plain.png")
    with matplotlib.rc_context({"font.size": 30, "lines.linewidth": 9, "axes.grid": True}):
        plot_torsion(actuated, tmp_path / "other.png")
        assert matplotlib.rcParams["font.size"] == 30
    assert (tmp_path / "plain.png").read_bytes() == (tmp_path / "other.png").read_bytes()


def test_neither_display_nor_pyplot_is_needed(tmp_path: Path) -> None:
    script = (
        "import sys\n"
        "from tubeopt import ConcentricRobot, Tube, forward_kinematics\n"
        "from tubeopt.show.plots import plot_shape, style\n"
        "assert 'matplotlib' not in sys.modules\n"
        "from tubeopt.show.plots import layout\n"
        "style.DPI, layout.MAX_PASSES = 50, 1\n"
        "robot = ConcentricRobot((Tube(2e-3, 1e-3, 0.02, 0.1, 20.0),))\n"
        "plot_shape(forward_kinematics(robot, (0.0,)), sys.argv[1])\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
    )
    environment = {**os.environ, "MPLBACKEND": "tkagg", "DISPLAY": ""}
    subprocess.run([sys.executable, "-c", script, str(tmp_path / "shape.png")], check=True, env=environment)
    assert (tmp_path / "shape.png").exists()


def test_torsion_jumps_where_pieces_meet_as_the_torque_does_not() -> None:
    """GJ (theta' - natural twist) goes on across a jump, and nothing is drawn beyond what was solved for."""
    robot = load_robot(Path(__file__).resolve().parents[2] / "configs" / "robots" / "example_pieces.yaml")
    arm = forward_kinematics(robot, np.radians((0.0, 120.0, -60.0)))
    assembly = arm.robot.assembly(arm.translations)
    assert assembly.lengthwise is not None
    lines = plot_torsion(arm).axes[1].lines
    for tube, at in ((0, 0.03), (2, 0.01)):
        line = next(line for line in lines if line.get_label() == f"tube {tube + 1}")
        s, drawn = np.array(line.get_xdata()) * 1e-3, np.radians(np.array(line.get_ydata())) * 1e3
        (gap,) = np.flatnonzero(np.isnan(s))
        np.testing.assert_allclose(s[[gap - 1, gap + 1]], at)
        behind, before = (assembly.lengthwise.values(at + d + assembly.transmission[None]) for d in (-1e-9, 1e-9))
        torque = [
            float(v[1][0, tube] * (t - v[4][0, tube])) for v, t in ((behind, drawn[gap - 1]), (before, drawn[gap + 1]))
        ]
        assert torque[1] == pytest.approx(torque[0], rel=1e-6)
        solved = arm.torsion[tube]
        room = 1e-3 * float(np.ptp(solved))
        assert solved.min() - room < np.nanmin(drawn)
        assert np.nanmax(drawn) < solved.max() + room


def test_forces_are_drawn_and_named() -> None:
    """An arrow from the tip along the force as it is seen, and force and gravity in words."""
    load = Load((0.02, 0.03, 0.0), points=(PointLoad(0.05, (0.0, 0.01, 0.0), (0.0, 0.0, 0.002)),))
    arm = forward_kinematics(ROBOT, (0.0, 0.5, 1.0), load=load)
    tip, along, moment = load_arrows(arm)
    np.testing.assert_allclose(np.cross(moment.end - moment.start, (0.0, 0.0, 1.0)), 0.0, atol=1e-12)
    np.testing.assert_allclose(moment.start, along.start)
    np.testing.assert_allclose(tip[0], arm.tip_position)
    np.testing.assert_allclose(np.cross(tip[1] - tip[0], load.force), 0.0, atol=1e-12)
    assert tip[2] == pytest.approx(np.hypot(0.02, 0.03))
    np.testing.assert_allclose(np.linalg.norm(along[1] - along[0]) / np.linalg.norm(tip[1] - tip[0]), 0.01 / tip[2])
    figure = plot_shape(arm, view=(20.0, -60.0))
    texts = [text for text in figure.axes[0].texts if isinstance(text, matplotlib.text.Annotation)]
    assert {"36.06 mN", "10 mN", "2 mN m"} <= {text.get_text() for text in texts}
    arrow = next(text for text in texts if text.arrow_patch is not None)
    observed = Projection(20.0, -60.0).project(arm.tip_position)
    np.testing.assert_allclose(arrow.xyann, observed[:2])
    assert "load: 20, 30, 0 mN at the tip" in figure.get_suptitle()


def test_a_following_force_turns_with_the_tip_in_the_picture() -> None:
    arm = forward_kinematics(ROBOT, (0.0, 0.5, 1.0), load=Load((0.0, 0.0, 0.02), frame="tip"))
    ((start, end, *_),) = load_arrows(arm)
    np.testing.assert_allclose(np.cross(end - start, arm.tip_rotation[:, 2]), 0.0, atol=1e-12)


def test_arms_of_a_plan_are_round_along_their_length(circle: Equilibrium) -> None:
    """No facet of the tube turns by more than 2 deg along the arm, whatever its size."""
    corners = robot_parts(circle, SWEEPING)[0].surface.vertices.reshape(-1, 10, 3).mean(axis=1)
    steps = np.diff(corners, axis=0)
    steps /= np.linalg.norm(steps, axis=1, keepdims=True)
    turns = np.degrees(np.arccos(np.clip((steps[1:] * steps[:-1]).sum(1), -1, 1)))
    assert turns.max() < 2.0


def test_a_load_per_length_is_a_comb_of_arrows_with_one_number() -> None:
    """Half as long as that of a force where it is largest, in proportion elsewhere; moments have two heads."""
    robot = load_robot("configs/robots/thesis_ctr.yaml")
    arm = forward_kinematics(robot, [0, 1, 2], load=Load(distributed=lambda s: (0, 0, 0, 0, 0.1 * s, 0)))
    comb = load_arrows(arm)
    length = float(arm.arc_length[-1])
    assert [arrow.labelled for arrow in comb] == [False] * 9 + [True]
    sizes = [float(np.linalg.norm(arrow.end - arrow.start)) for arrow in comb]
    assert sizes == pytest.approx([0.1 * length * (2 * k + 1) / 19 for k in range(10)])
    assert comb[-1].size == pytest.approx(0.1 * 0.95 * length)
    assert {arrow.unit for arrow in comb} == {"mN m/m"}
