"""Workspaces: admissible joint values, tips of equilibria, volumes that are known, what snapping takes, files."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.command_line import CRL as CRL_FILE
from tests.command_line import ROOT, Run, answer, refused
from tests.conftest import draw_quickly
from tests.examples import CRL, THESIS, TWO_TUBE, random_robot
from tubeopt import (
    ConcentricRobot,
    InputError,
    JointLimits,
    Material,
    Tube,
    Workspace,
    find_equilibria,
    forward_kinematics,
    load_robot,
    load_workspace,
    snapping_loss,
    workspace,
)
from tubeopt.inverse.joints import joint_space
from tubeopt.robots.robot import Robot
from tubeopt.show.plots.workspace import _section, plot_workspace
from tubeopt.typing import Array
from tubeopt.workspaces import alpha_volume, meridian_volume, save_workspace, voxel_volume, voxels
from tubeopt.workspaces.loss import from_tips
from tubeopt.workspaces.sampling import METHODS, JointSamples
from tubeopt.workspaces.voxels import PATCHES, patch_of

MM = 1e-3
ETR = load_robot(ROOT / "configs" / "robots" / "thesis_etr.yaml")
SEGMENTS = load_robot(ROOT / "configs" / "robots" / "example_three_segment_etr.yaml")
ROBOTS = [THESIS, CRL, TWO_TUBE, ETR, SEGMENTS]


def drawn(robot: Robot, method: str, count: int, seed: int = 0) -> tuple[Array, Array]:
    blocks = list(JointSamples(robot, method, count, seed).blocks())
    return np.concatenate([b[0] for b in blocks]), np.concatenate([b[1] for b in blocks])


# --- joint values -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("robot", ROBOTS, ids=lambda robot: robot.name)
def test_joint_values_are_admissible(robot: Robot, method: str) -> None:
    rotations, translations = drawn(robot, method, 600)
    space = joint_space(robot)
    assert len(rotations) == 600 or (method == "grid" and 0 < len(rotations) <= 600)
    for alpha, shift in zip(rotations, translations, strict=True):
        assert space.admissible(space.join(alpha, shift))
        robot.assembly(shift)
    assert len(np.unique(np.column_stack([rotations, translations]), axis=0)) == len(rotations)


def test_carriages_and_ends_are_in_order() -> None:
    rotations, translations = drawn(CRL, "sobol", 2000)
    beta = translations - [tube.straight_length for tube in CRL.tubes]
    end = beta + [tube.length for tube in CRL.tubes]
    assert (np.diff(beta, axis=1) >= -1e-12).all()
    assert (beta <= 1e-12).all()
    assert (np.diff(end, axis=1) <= 1e-12).all()
    assert (end >= -1e-12).all()
    # Half a turn either way, evenly; translations reach both ends of what the order allows.
    assert np.abs(rotations).max() <= np.pi
    assert np.abs(rotations.mean(0)).max() < 0.02
    assert (beta[:, 2].min(), beta[:, 2].max()) == pytest.approx((-0.11, 0.0), abs=1e-3)


def test_limits_of_the_actuators_hold() -> None:
    limits = JointLimits(((-0.5, 1.0), (0.0, 0.0), (-7.0, 7.0)), ((0.05, 0.08), (-0.02, 0.0), (-0.005, -0.005)))
    robot = replace(CRL, joint_limits=limits)
    for method in METHODS:
        rotations, translations = drawn(robot, method, 500)
        for values, ranges in ((rotations[:, :2], limits.rotations[:2]), (translations, limits.translations)):
            low, high = np.array(ranges).T
            assert (values >= low - 1e-9).all()
            assert (values <= high + 1e-9).all()
        assert np.abs(rotations[:, 2]).max() <= np.pi + 1e-9


def test_the_same_seed_gives_the_same_values() -> None:
    for method in ("sobol", "random"):
        first, again, other = (drawn(CRL, method, 5000, seed)[0] for seed in (1, 1, 2))
        assert np.array_equal(first, again)
        assert not np.array_equal(first, other)
        assert np.array_equal(drawn(CRL, method, 300, 1)[0], first[:300])


# --- tips -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("robot", ROBOTS[:4], ids=lambda robot: robot.name)
def test_tips_are_those_of_forward_kinematics(robot: Robot) -> None:
    space = workspace(robot, 64)
    assert len(space) == 64
    assert space.converged.all()
    for k in range(0, 64, 9):
        pose = forward_kinematics(robot, space.rotations[k], space.translations[k])
        assert space.tip_position[k] == pytest.approx(pose.tip_position, abs=1e-8)
        assert space.tip_direction[k] == pytest.approx(pose.tip_rotation[:, 2], abs=1e-7)
        assert space.margin[k] == pytest.approx(pose.margin, abs=1e-6)


# --- volumes ----------------------------------------------------------------------------------------------------------


def cloud(points: Array, directions: Array | None = None, margin: float = 1.0) -> Workspace:
    """A workspace with given tips."""
    table = np.zeros((len(points), 13))
    table[:, 6:9] = points
    table[:, 9:12] = [0.0, 0.0, 1.0] if directions is None else directions
    table[:, 12] = margin
    return Workspace(CRL, "random", 0, table)


def ball(count: int, hollow: float = 0.0) -> Array:
    random = np.random.default_rng(1)
    points = random.normal(size=(count, 3))
    radius = random.uniform(hollow**3, 1.0, count) ** (1 / 3)
    return np.asarray(points / np.linalg.norm(points, axis=1, keepdims=True) * radius[:, None])


@pytest.mark.parametrize("hollow", [0.0, 0.7])
def test_the_volume_of_a_ball_and_of_a_shell(hollow: float) -> None:
    truth = 4 / 3 * np.pi * (1 - hollow**3)
    by_voxels, by_alpha = voxel_volume(cloud(ball(60_000, hollow)), 0.1), alpha_volume(cloud(ball(20_000, hollow)))
    assert by_voxels.value == pytest.approx(truth, rel=0.08)
    assert by_alpha.value == pytest.approx(truth, rel=0.1)  # it lies inside
    assert by_voxels.half == pytest.approx(by_voxels.value, rel=0.08)
    assert by_alpha.half == pytest.approx(by_alpha.value, rel=0.05)


def test_the_volume_of_a_body_of_revolution() -> None:
    points, truth = ball(20_000, 0.7), 4 / 3 * np.pi * (1 - 0.7**3)
    by_turning = meridian_volume(cloud(points), 0.02)
    assert by_turning.value == pytest.approx(truth, rel=0.02)
    assert by_turning.half == pytest.approx(truth, rel=0.06)
    # A ball beside the axis is turned into a torus.
    beside = cloud(0.3 * ball(60_000) + [1.0, 0.0, 0.0])
    assert meridian_volume(beside, 0.015).value == pytest.approx(2 * np.pi**2 * 0.3**2, rel=0.03)
    with pytest.raises(InputError, match="body of revolution"):
        meridian_volume(replace(beside, robot=ETR))


def test_too_few_samples_show_in_the_estimate() -> None:
    few, many = (voxel_volume(cloud(ball(count)), 0.1) for count in (3000, 60_000))
    assert few.unseen > 0.2 * few.value
    assert few.half < 0.9 * few.value
    assert many.unseen < 0.03 * many.value
    assert few.value + few.unseen == pytest.approx(many.value, rel=0.25)


def test_dexterity_counts_directions() -> None:
    random = np.random.default_rng(2)
    directions = random.normal(size=(20_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    assert np.bincount(patch_of(directions), minlength=PATCHES) == pytest.approx(20_000 / PATCHES, rel=0.3)
    current = np.full((20_000, 3), 0.05)
    assert voxels(cloud(current, directions), 0.1).dexterity.tolist() == [1.0]
    assert voxels(cloud(current), 0.1).dexterity.tolist() == [1 / PATCHES]


def test_only_stable_enough_tips_count() -> None:
    points = ball(1000)
    result = cloud(points)
    result.table[500:, -1] = 0.1
    assert voxels(result, 0.2, min_margin=0.5).samples == 500
    assert voxels(result, 0.2).count.sum() == 1000
    with pytest.raises(InputError, match="no sample has"):
        voxels(result, min_margin=2.0)


def test_flat_workspaces_have_voxels_and_no_alpha_shape() -> None:
    flat = ball(500)
    flat[:, 2] = 0.0
    assert len(voxels(cloud(flat))) > 10
    with pytest.raises(InputError, match="lie in a plane"):
        alpha_volume(cloud(flat))


@pytest.mark.parametrize("method", METHODS)
def test_the_volume_of_a_robot_that_is_known(method: str) -> None:
    # A straight tube that does not yield, and an arc that comes out of it: x(e) = (1 - cos(kappa e)) / kappa to the
    # side, wherever the straight one ends. Each ring of the side x is as high as the straight tube moves.
    kappa, arc, travel = 12.0, 0.1, 0.25
    rigid = Material("rigid", 58e16, 21.5e16)
    robot = ConcentricRobot(
        (Tube(1e-3, 0.8e-3, 0.25, arc, kappa), Tube(2e-3, 1.2e-3, 0.1, 0.15, 0.0, rigid)),
    )
    side = (1 - np.cos(kappa * arc)) / kappa
    space = workspace(robot, 20_000, method=method)
    assert np.hypot(*space.tip_position[:, :2].T).max() <= side + 1e-9
    truth = np.pi * side**2 * travel
    assert meridian_volume(space).value == pytest.approx(truth, rel=0.12)
    by_voxels = voxel_volume(space, 0.01 if method != "grid" else 0.02)
    assert abs(by_voxels.value - truth) < by_voxels.surface + by_voxels.unseen


# --- what snapping takes ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_equilibria_from_tips_are_equilibria(seed: int) -> None:
    random = np.random.default_rng(seed)
    robot = [THESIS, CRL, random_robot(random, 3)][seed]
    tips = random.uniform(-np.pi, np.pi, (8, 3))
    low = np.array([-tube.curved_length for tube in robot.tubes])
    high = np.array([tube.straight_length for tube in robot.tubes])
    shifts = random.uniform(low, high, (8, 3))
    result = from_tips(robot, tips, shifts)
    for k in range(8):
        all_of_them = find_equilibria(robot, result.rotations[k], shifts[k])
        nearest = min(all_of_them, key=lambda e: float(np.linalg.norm(e.tip_position - result.tip_position[k])))
        assert nearest.tip_position == pytest.approx(result.tip_position[k], abs=1e-6)
        assert nearest.tip_rotation[:, 2] == pytest.approx(result.tip_direction[k], abs=1e-5)
        assert nearest.stable == result.stable[k] or abs(nearest.margin) < 1e-4


def test_the_thesis_robot_loses_its_straight_shapes() -> None:
    home = replace(THESIS, joint_limits=JointLimits(THESIS.limits.rotations, ((0.0, 0.0),) * 3))
    lost = snapping_loss(home, 4096, size=10 * MM)
    assert 0.1 < lost.unstable / lost.equilibria < 0.5
    assert len(lost.lost)
    assert not {tuple(v) for v in lost.lost.tolist()} & {tuple(v) for v in lost.held.tolist()}
    # With the inner tube against the others the arm is straightest, and unstable.
    straight = forward_kinematics(THESIS, np.radians([200, 0, 0])).tip_position
    centres = (lost.lost + 0.5) * lost.size
    assert centres[:, 2].max() > straight[2]
    stable = workspace(home, 2048)
    inside = np.floor(stable.tip_position / lost.size).astype(int).tolist()
    assert not {tuple(v) for v in snapping_loss(home, 4096, size=10 * MM, reached=stable).lost.tolist()} & {
        tuple(v) for v in inside
    }


def test_a_robot_that_cannot_snap_loses_nothing() -> None:
    tubes = tuple(replace(tube, curvature=tube.curvature / 4) for tube in CRL.tubes)
    lost = snapping_loss(replace(CRL, tubes=tubes), 2048)
    assert (lost.unstable, len(lost.lost), lost.fraction) == (0, 0, 0.0)


def test_tubes_off_the_centreline_are_refused() -> None:
    with pytest.raises(InputError, match="the loss to"):
        snapping_loss(ETR, 100)


# --- files and memory -------------------------------------------------------------------------------------------------


def test_a_file_holds_the_same_and_goes_on_where_it_was_cut(tmp_path: Path) -> None:
    whole = workspace(CRL, 4200, out=tmp_path)
    memory = workspace(CRL, 4200)
    assert np.array_equal(whole.table, memory.table)
    assert isinstance(whole.table, np.memmap)
    file = tmp_path / "samples.npy"
    content = file.read_bytes()
    for cut in (0, 50, 5000, len(content) - 3):
        file.write_bytes(content[:cut])
        with pytest.raises(InputError, match="missing or not finished"):
            load_workspace(CRL, tmp_path)
        observed: list[int] = []
        workspace(CRL, 4200, out=tmp_path, progress=lambda done, total, observed=observed: observed.append(done))
        assert observed[0] == max(0, (cut - 128) // (8 * 13))
        assert file.read_bytes() == content
    assert np.array_equal(load_workspace(CRL, tmp_path).table, memory.table)
    for robot, count in ((THESIS, 4200), (CRL, 4201)):
        with pytest.raises(InputError, match="the workspace of another robot or"):
            workspace(robot, count, out=tmp_path)
    with pytest.raises(InputError, match="is of another robot"):
        load_workspace(THESIS, tmp_path)


def test_files_that_are_no_workspace_are_left_alone(tmp_path: Path) -> None:
    mine = tmp_path / "samples.npy"
    mine.write_bytes(b"mine")
    with pytest.raises(InputError, match=r"exists, but workspace\.json is"):
        workspace(CRL, 10, out=tmp_path)
    assert mine.read_bytes() == b"mine"
    for content in ("{", "[]", "{}"):
        (tmp_path / "workspace.json").write_text(content)
        for compute in (partial(workspace, CRL, 10, out=tmp_path), partial(load_workspace, CRL, tmp_path)):
            with pytest.raises(InputError, match=r"workspace\.json: is damaged"):
                compute()
    assert mine.read_bytes() == b"mine"


def test_two_runs_in_a_directory_at_once_are_refused(tmp_path: Path) -> None:
    def meddle(done: int, total: int) -> None:
        with pytest.raises(InputError, match="another run is writing here"):
            workspace(CRL, 100, out=tmp_path)

    workspace(CRL, 100, out=tmp_path, progress=meddle)
    assert len(load_workspace(CRL, tmp_path)) == 100


def test_a_workspace_from_memory_is_saved_and_loaded(tmp_path: Path) -> None:
    space = workspace(CRL, 50, method="random", seed=4)
    save_workspace(replace(space, failures=((3, "no"),)), tmp_path)
    again = load_workspace(CRL, tmp_path)
    assert np.array_equal(again.table, space.table)
    assert (again.method, again.seed, again.failures) == ("random", 4, ((3, "no"),))
    assert np.array_equal(workspace(CRL, 50, method="random", seed=4, out=tmp_path).table, space.table)


GROWTH = """
import sys
import tubeopt
robot = tubeopt.load_robot(sys.argv[1])
for k, count in enumerate((20_000, 50_000)):
    tubeopt.workspaces.voxels(tubeopt.workspace(robot, count, out=f"{sys.argv[2]}/{k}"), 0.01)
    # The peak of this process alone: getrusage would tell that of the one that started it, were it larger.
    print(next(line.split()[1] for line in open("/proc/self/status") if line.startswith("VmHWM")))
"""


def test_memory_does_not_grow_with_the_samples(tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-c", GROWTH, str(ROOT / "configs/robots/two_tube.yaml"), str(tmp_path)]
    out = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    few, many = (int(line) / 1024 for line in out.stdout.split())
    table = 50_000 * 11 * 8 / 2**20
    assert many - few < 0.6 * table


def resident() -> int:
    """Memory of this process, bytes."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def test_many_solves_do_not_grow_the_process() -> None:
    random = np.random.default_rng(5)

    def solve(count: int) -> None:
        for _ in range(count):
            # Other translations each time: nothing that is kept for one fits the next.
            shift = random.uniform(-0.02, 0.0, 3)
            rotations = random.uniform(-np.pi, np.pi, 3)
            forward_kinematics(CRL, rotations, shift)
            forward_kinematics(replace(TWO_TUBE, name=str(random.random())), rotations[:2])

    solve(600)
    before = resident()
    solve(1500)
    assert resident() - before < 8 * 2**20


def test_every_cache_is_bounded() -> None:
    import gc
    from functools import _lru_cache_wrapper

    gc.unfreeze()
    caches = [o for o in gc.get_objects() if isinstance(o, _lru_cache_wrapper) and o.__module__.startswith("tubeopt")]
    gc.freeze()
    assert len(caches) > 10
    assert [cache.__qualname__ for cache in caches if cache.cache_info().maxsize is None] == []


# --- refused, pictures, command ---------------------------------------------------------------------------------------


def test_what_is_no_workspace_is_refused() -> None:
    with pytest.raises(InputError, match="samples is 0; it must be at least 1"):
        workspace(CRL, 0)
    with pytest.raises(InputError, match=r"method is 'sobl'.*did you mean 'sobol'"):
        workspace(CRL, 10, method="sobl")
    with pytest.raises(InputError, match="seed is -1"):
        workspace(CRL, 10, seed=-1)
    with pytest.raises(InputError, match="size is 0"):
        voxels(cloud(ball(10)), 0.0)


@pytest.mark.parametrize("lossy", [False, True])
def test_the_picture(tmp_path: Path, lossy: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    draw_quickly(monkeypatch)
    space = workspace(CRL, 500)
    loss = snapping_loss(CRL, 2048, reached=space) if lossy else None
    figure = plot_workspace(space, tmp_path / "w.png", loss=loss)
    assert (tmp_path / "w.png").read_bytes().startswith(b"\x89PNG")
    assert len(figure.axes) == 6


def turned(places: Array, directions: Array, margins: list[float], angles_deg: list[float]) -> Workspace:
    """A workspace of tips in the plane xz, each turned about z with its direction."""
    rows = np.zeros((len(places), 2 * CRL.n_tubes + 7))
    for row, position, direction, margin, angle in zip(rows, places, directions, margins, angles_deg, strict=True):
        about_z = Rotation.from_euler("z", angle, degrees=True)
        row[-7:-4], row[-4:-1], row[-1] = about_z.apply(position), about_z.apply(direction), margin
    return Workspace(CRL, "random", 0, rows)


def test_a_section_has_the_smallest_margin_and_the_directions_in_its_half_plane() -> None:
    # Three tips in a cell 35 mm from the axis: two point upwards, one outwards. One far from them.
    positions = np.array([[0.035, 0, 0.105], [0.035, 0, 0.105], [0.035, 0, 0.105], [0.075, 0, 0.155]])
    paths = np.array([[0.1, 0.02, 1.0], [0.1, 0.02, 1.0], [1.0, 0.02, 0.1], [1.0, 0.02, 0.1]])
    result = _section(turned(positions, paths, [0.9, 0.4, 0.7, 0.8], [0, 100, 200, 300]), 0.01)
    assert result.first.tolist() == [3, 10]
    assert (result.margin[0, 0], result.margin[-1, -1]) == (0.4, 0.8)
    assert (result.dexterity[0, 0], result.dexterity[-1, -1]) == (2 / 64, 1 / 64)
    assert np.isnan(result.margin).sum() == result.margin.size - 2


def test_colours_of_a_section_span_the_margins_there_are() -> None:
    space = workspace(CRL, 500)
    figure = plot_workspace(space)
    low, high = figure.axes[2].collections[0].get_clim()
    assert low == pytest.approx(np.nanmin(space.margin), abs=1e-12)
    assert low < high <= 1.0
    drawn = figure.axes[2].collections[0].get_array().compressed()
    assert np.ptp(drawn) > 0.3
    assert drawn.min() >= low - 1e-12


def test_the_command(run: Run, tmp_path: Path) -> None:
    out = str(tmp_path / "out")
    data = answer(
        run("workspace", CRL_FILE, "--samples", "3000", "--loss", "4096", "--voxel-mm", "20", "--out", out, "--json")
    )
    assert (data["samples"], data["without_equilibrium"], data["voxel_mm"]) == (3000, 0, 20)
    result = voxels(workspace(CRL, 3000), 20 * MM)
    assert data["voxels"] == len(result)
    assert data["volume_cm3"] > 100
    assert data["snapping"]["equilibria"] == 4096
    assert sorted(path.name for path in Path(out).iterdir()) == [
        "samples.npy",
        "voxels.npz",
        "workspace.json",
        "workspace.png",
    ]
    assert json.loads((Path(out) / "workspace.json").read_text())["columns"][-1] == "margin"
    assert "Example: tubeopt workspace " in run("workspace", "--help").out
    for flag, value in (("--samples", "0"), ("--voxel-mm", "0"), ("--voxel-mm", "nan"), ("--min-margin", "nan")):
        assert flag in refused(run("workspace", CRL_FILE, flag, value))[0]


@pytest.mark.parametrize("count", [3, 50])
def test_the_interval_of_a_loss_is_that_of_clopper_and_pearson(count: int) -> None:
    """Without a lost voxel it is 0 to 1 - (0.05 / 2)^(1 / N); where N equilibria tell little, it is wide."""
    result = snapping_loss(TWO_TUBE, count, reached=workspace(TWO_TUBE, 4000))
    assert result.lost.size == 0
    low, high = result.interval
    assert low == 0.0
    assert high >= 1 - 0.025 ** (1 / count) - 1e-12
    assert high < 1.0


def test_default_voxels_make_the_uncertainty_contain_the_volume() -> None:
    """The body of revolution of many samples is the reference."""
    reference = meridian_volume(workspace(THESIS, 60_000), 3e-3)
    result = voxel_volume(workspace(THESIS, 3000))
    assert abs(result.value - reference.value) < result.surface < 0.6 * result.value
