"""Posterior of a fitted robot: intervals that hold for incomplete models, and bounds on the real robot."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import scipy
from scipy.spatial.transform import Rotation

from tubeopt import ConcentricRobot, InputError, Tube, follow, forward_kinematics, load_robot
from tubeopt.bodies.obstacles import scene_of
from tubeopt.cli.app import main
from tubeopt.equilibrium.arm_surface import ArmSurface
from tubeopt.files.yaml_file import to_yaml
from tubeopt.robots.calibration import Posterior
from tubeopt.runs.plan_study import Required, load_plan_study, of_real_robot
from tubeopt.validation import Fit, FitOptions, Measurements, fit, path_bounds, real_robots, uncertainty, validate
from tubeopt.validation.certainty import certificate_bounds, expected_error
from tubeopt.validation.effects import Setup
from tubeopt.validation.fitting import FitProblem, sessions
from tubeopt.validation.measurements import Timeline
from tubeopt.validation.model import solve_poses
from tubeopt.validation.parameters import choose_parameters
from tubeopt.validation.posterior import Misfit, Places, estimate_misfit, posterior_of
from tubeopt.validation.tube_shapes import heated_pieces, shape_of

from .drives import RATE, joints, robot, trivial
from .laboratory import MM

NOISE, ROWS = 0.3 * MM, 150
NAMES = ["latency", "rotation_2", "translation_1", "translation_2", "curvature_1", "curvature_2"]


def recorded(seed: int, *, poses: bool = False) -> tuple[dict[str, float], Measurements]:
    """Values that a fit estimates, and a recording of a robot whose heated parts fade, which no fit here knows."""
    random = np.random.default_rng(seed)
    shift = random.normal(0, 2 * MM, 2)
    truth = {
        "latency": random.uniform(0.03, 0.1), "rotation_2": random.uniform(-0.1, 0.1),
        "translation_1": shift[0], "translation_2": shift[1],
        "curvature_1": random.uniform(8.2, 9.8), "curvature_2": random.uniform(4.5, 5.5),
    }  # fmt: skip
    setup = Setup.of(robot())
    setup.curvature[:] = truth["curvature_1"], truth["curvature_2"]
    setup.fade[:] = random.uniform(0, 10 * MM, 2)
    setup.drives = trivial(
        rotation_offsets=(0.0, truth["rotation_2"]), translation_offsets=tuple(shift), latency=truth["latency"]
    )
    time = np.arange(ROWS) / RATE
    read = joints(time, time[-1]) - [0.0, 0.0, 30 * MM, 7 * MM]
    rows = Measurements(read[:, :2], read[:, 2:], np.zeros((ROWS, 3)), time=time, source="a way")
    result = solve_poses(setup.robot(robot()), *Timeline.of(rows).driven(setup.drives, np.zeros(2)), np.zeros(1))
    turn, base = Rotation.random(rng=random).as_matrix(), random.uniform(-0.2, 0.2, 3)
    tips = result.position[:, 0] @ turn.T + base + random.normal(0, NOISE, (ROWS, 3))
    wobble = Rotation.from_rotvec(random.normal(0, 0.01, (ROWS, 3))).as_matrix()
    return truth, replace(rows, sensors=tips, orientation=turn @ result.frame @ wobble if poses else None)


@cache
def fitted(seed: int, *, poses: bool = False) -> tuple[dict[str, float], Fit]:
    """Values of a truth, and the fit to its recording."""
    truth, rows = recorded(seed, poses=poses)
    return truth, fit(robot(), rows, NAMES, FitOptions(folds=5 if seed == 0 else 0))


def test_intervals_hold_though_the_heated_parts_fade() -> None:
    """Ten truths; the shape of the heated part, which is not fitted, moves lengths and curvatures off theirs."""
    alone, full = [], []
    for seed in range(10):
        truth, found = fitted(seed)
        alone += [e.low <= truth[e.name] <= e.high for e in found.estimates]
        full += [e.posterior_low <= truth[e.name] <= e.posterior_high for e in found.estimates]
    assert np.mean(alone) < 0.86
    assert np.mean(full) > 0.92


def test_tips_and_poses_of_the_same_rows_agree() -> None:
    """Intervals for independent errors exclude each other, those of the posterior overlap."""
    apart = 0
    for seed in range(3):
        (_, tips), (_, poses) = fitted(seed), fitted(seed, poses=True)
        for a, b in zip(tips.estimates, poses.estimates, strict=True):
            apart += a.high < b.low or b.high < a.low
            assert abs(a.value - b.value) < 2.5 * np.hypot(a.posterior_error, b.posterior_error), a.name
    assert apart >= 3


def test_held_out_tips_are_within_their_bands() -> None:
    _, found = fitted(0)
    assert found.held_out_inside is not None
    assert 0.92 <= found.held_out_inside <= 0.98
    posterior = found.robot.posterior
    assert posterior is not None
    assert posterior.noise == pytest.approx(NOISE, rel=0.1)
    assert {"dead_length_1", "curved_length_2", "plate_yaw"} <= set(posterior.names)
    assert "rotation_1" not in posterior.names


def test_a_mean_over_fits_counts_its_distance_from_the_minimum(monkeypatch: pytest.MonkeyPatch) -> None:
    """Second moments about a state that is off the minimum are those about the minimum plus its square."""
    white = Misfit(NOISE, 0.0, 1.0, 0.0, 1.0)
    monkeypatch.setattr("tubeopt.validation.posterior.estimate_misfit", lambda *observed: white)
    monkeypatch.setattr("tubeopt.validation.posterior.considered", lambda *model: [])
    options = FitOptions(folds=0)
    recordings = [recorded(0)[1]]
    chosen = choose_parameters(robot(), recordings, NAMES)
    problem = FitProblem(sessions(robot(), recordings, chosen, options), options)
    fit_, weights = problem.fit, problem.weights()
    away = np.array([0.01, 0.02, 1 * MM, -1 * MM, 0.1, 0.2])
    moments = []
    for way in (0 * away, away, -away):
        residuals = fit_.residuals + fit_.jacobian @ np.append(way, np.zeros(6))
        off = replace(fit_, state=replace(fit_.state, x=fit_.state.x + way), residuals=residuals)
        none = np.zeros(0, dtype=int)
        found = posterior_of(problem.model, off, weights, chosen, (), None, none, at_minimum=False).posterior
        rows = found.factor[[found.names.index(name) for name in NAMES if name != "latency"]]
        moments.append(rows @ rows.T)
    for moved in moments[1:]:
        np.testing.assert_allclose(moved - moments[0], np.outer(away[1:], away[1:]), rtol=1e-2)


def test_sizes_and_ranges_of_a_misfit_are_found() -> None:
    """Draws of a random function of joint values, and of one of time, beside white noise."""
    random, n = np.random.default_rng(3), 300
    time = np.arange(n) / RATE
    at = Places(np.column_stack([3 * np.sin(0.21 * time), 3 * np.cos(0.34 * time)]), time, np.zeros(n, int), True)
    slopes = random.normal(size=(n, 3, 2))

    def drawn(distance: np.ndarray) -> np.ndarray:
        return np.linalg.cholesky(np.exp(-(distance**2) / 2) + 1e-9 * np.eye(n)) @ random.normal(size=(n, 3))

    apart = scipy.spatial.distance.cdist(at.joints, at.joints)
    found = estimate_misfit(at, 2 * drawn(apart) + 0.5 * random.normal(size=(n, 3)), slopes)
    assert found.noise == pytest.approx(0.5, rel=0.1)
    assert found.smooth == pytest.approx(2.0, rel=0.4)
    assert found.drift < 0.5
    white = estimate_misfit(at, random.normal(size=(n, 3)), slopes)
    assert white.size < 0.3
    assert white.noise == pytest.approx(1.0, rel=0.1)


def test_rows_outside_of_what_was_recorded_are_marked() -> None:
    _, found = fitted(0)
    posterior, rows = found.robot.posterior, recorded(0)[1]
    assert posterior is not None
    assert not found.after.outside.any()
    low, high = np.array(posterior.rotations).T
    np.testing.assert_allclose([low, high], [rows.rotations.min(0), rows.rotations.max(0)])
    farther = rows.rotations.copy()
    farther[:7, 1] = high[1] + 0.1
    again = validate(found.robot, replace(rows, rotations=farther))
    assert again.outside.nonzero()[0].tolist() == list(range(7))
    assert any(remark.startswith("7 rows lie outside of the ranges") for remark in again.remarks)
    inside = forward_kinematics(found.robot, (low + high) / 2, np.array(posterior.translations).mean(1))
    assert not uncertainty(inside).outside
    assert uncertainty(forward_kinematics(found.robot, high + 0.5, inside.translations)).outside


# --- bounds on the real robot -----------------------------------------------------------------------------------------


def uncertain(names: list[str], units: list[str], deviations: list[float], misfit: float = 0.0) -> ConcentricRobot:
    """Two tubes that can snap, with independent deviations."""
    tubes = (
        Tube(1.0 * MM, 0.8 * MM, 60 * MM, 110 * MM, 16.0),
        Tube(1.3 * MM, 1.05 * MM, 50 * MM, 70 * MM, 14.0),
    )
    posterior = Posterior.of(names, units, np.diag(np.square(deviations)), misfit, NOISE)
    return ConcentricRobot(tubes, posterior=posterior)


MANY = uncertain(
    ["rotation_2", "translation_1", "curvature_1", "curved_length_2", "torsional_stiffness_1", "dead_length_1"],
    ["rad", "m", "1/m", "m", "", "m"],
    [0.03, 0.5 * MM, 0.2, 1 * MM, 0.05, 0.2 * MM],
)


def test_the_robot_without_deviations_is_the_calibrated_one() -> None:
    reals = real_robots(MANY)
    assert reals is not None
    still = reals.at(np.zeros(reals.size), np.array([0.2, 1.0]), np.array([-5 * MM, -8 * MM]))
    assert still.robot.tubes == MANY.tubes
    np.testing.assert_allclose(still.rotations, [0.2, 1.0], atol=1e-15)
    assert real_robots(replace(MANY, posterior=None)) is None
    with pytest.raises(InputError, match="no posterior"):
        uncertainty(forward_kinematics(replace(MANY, posterior=None), [0.0, 0.0]))


def test_slopes_are_those_of_robots_that_differ() -> None:
    reals = real_robots(MANY)
    assert reals is not None
    joint_values = np.array([0.2, 1.0]), np.array([-5 * MM, -8 * MM])
    e, step = forward_kinematics(MANY, *joint_values), 0.02
    slopes = reals.slopes(e, np.zeros(reals.size), joint_values)
    for k, unit in enumerate(np.eye(reals.size)):
        if abs(reals.factor[-1, k]) > 1e-9:  # a dead length has one side only
            continue
        ahead, behind = (forward_kinematics(*reals.at(side * step * unit, *joint_values)) for side in (1, -1))
        change = (ahead.tip_position - behind.tip_position) / (2 * step)
        np.testing.assert_allclose(slopes.tip[:, k], change, atol=1e-4 * np.abs(slopes.tip).max())
        assert slopes.margin[k] == pytest.approx((ahead.margin - behind.margin) / (2 * step), abs=1e-4)


def test_bounds_hold_for_as_many_drawn_robots_as_told() -> None:
    """Bounds of 95 % on margin and tip against 400 robots; they are first order, hence the width."""
    robot_of = uncertain(
        ["rotation_2", "curvature_1", "torsional_stiffness_1", "translation_2"], ["rad", "1/m", "", "m"],
        [0.04, 0.4, 0.04, 0.4 * MM], misfit=0.2 * MM,
    )  # fmt: skip
    reals, joint_values = real_robots(robot_of), (np.array([0.0, 3.0]), np.array([-5 * MM, -8 * MM]))
    assert reals is not None
    e = forward_kinematics(robot_of, *joint_values)
    told = uncertainty(e)
    assert told.margin[1] < told.margin[0] < e.margin
    assert told.snap_distance[1] < told.snap_distance[0] < e.snap_distance
    random = np.random.default_rng(0)
    drawn = [forward_kinematics(*reals.at(z, *joint_values)) for z in random.normal(size=(400, reals.size))]
    margins = np.array([each.margin for each in drawn])
    assert 0.02 <= (margins < told.margin[0]).mean() <= 0.09
    assert (margins < told.margin[1]).mean() <= 0.01
    turns = np.array([each.snap_distance for each in drawn])
    assert 0.02 <= (turns < told.snap_distance[0]).mean() <= 0.09
    off = np.array([each.tip_position for each in drawn]) - e.tip_position + random.normal(0, 0.2 * MM, (400, 3))
    inside = (np.abs(off) < told.tip_half_widths[0]).mean()
    assert 0.92 <= inside <= 0.98
    assert (np.linalg.norm(off, axis=1) < told.tip_radius[0]).mean() >= 0.95
    with pytest.raises(InputError, match=r"probability is 0.3"):
        uncertainty(e, (0.3,))


def test_plans_and_checks_keep_their_bounds(tmp_path: Path) -> None:
    """A ball beside the path: a plan without, and one with a confidence, followed by 60 robots."""
    robot_of = uncertain(
        ["rotation_2", "curvature_1", "torsional_stiffness_1", "translation_2"], ["rad", "1/m", "", "m"],
        [0.06, 0.4, 0.04, 0.4 * MM], misfit=0.2 * MM,
    )  # fmt: skip
    robot_of.save(tmp_path / "robot.yaml")
    x, y, z = forward_kinematics(robot_of, np.radians([91.5, 0.0])).tip_position.tolist()
    ball = {"kind": "sphere", "centre_mm": [1e3 * x, 1e3 * y, 1e3 * z + 7], "radius_mm": 5}
    question = {"kind": "plan", "robot": "robot.yaml", "goal_deg": [183, 0], "obstacles": [ball], "clearance_mm": 0.5}
    (tmp_path / "plan.yaml").write_text(to_yaml(question, "A plan. Source: a test."))
    plain = load_plan_study(tmp_path / "plan.yaml").run()
    (tmp_path / "plan.yaml").write_text(to_yaml(question | {"confidence": 0.999}, "A plan. Source: a test."))
    sure = load_plan_study(tmp_path / "plan.yaml").run()
    assert plain.proof.real is not None
    assert sure.proof.real is not None
    assert plain.proof.real.clearance[1] <= plain.proof.real.clearance[0] < plain.proof.least_clearance - 0.2 * MM
    assert plain.proof.real.margin[1] < plain.proof.real.margin[0] < plain.proof.least_margin
    assert sure.proof.real.clearance[0] >= 0.5 * MM
    assert sure.proof.real.margin[0] >= 0.05
    rows, reals, random = np.linspace(0, len(sure.time) - 1, 40).astype(int), real_robots(robot_of), np.random
    assert reals is not None
    for draw in random.default_rng(0).normal(size=(60, reals.size)):
        real, near = reals.at(draw, sure.rotations[rows], sure.translations[rows]), sure.arms[0]
        for alpha, shift in zip(real.rotations, real.translations, strict=True):
            near = forward_kinematics(real.robot, alpha, shift, start=near)
            assert near.margin > 0.05
            assert ArmSurface(near).clearance(scene_of(sure.obstacles)) > 0.0
    required = Required(0.05, 0.5 * MM, 0.999)
    refused = of_real_robot(plain.proof, plain.rotations, plain.translations, plain.obstacles, required)
    assert plain.proof.holds
    assert not refused.holds
    assert "with 99.9 % the real robot has a clearance of" in refused.faults[0]
    replace(robot_of, posterior=None).save(tmp_path / "robot.yaml")
    with pytest.raises(InputError, match="no posterior"):
        load_plan_study(tmp_path / "plan.yaml")


def test_bounds_on_a_path_hold_between_its_rows() -> None:
    """The margin is small within a few degrees of a turn of 360 deg, which has two rows."""
    drawn = uncertain(["curvature_1", "rotation_2", "translation_2"], ["1/m", "rad", "m"], [0.15, 0.04, 0.4 * MM])
    less = replace(drawn, tubes=tuple(replace(tube, curvature=0.7 * tube.curvature) for tube in drawn.tubes))
    reals, turn = real_robots(less), np.radians([[0.0, 0.0], [360.0, 0.0]])
    assert reals is not None
    told = path_bounds(forward_kinematics(less, turn[0]), turn, np.zeros((2, 2)))
    assert told is not None
    dense = np.column_stack([np.linspace(0, 2 * np.pi, 250), np.zeros(250)])
    margins = []
    for z in np.random.default_rng(0).normal(size=(60, reals.size)):
        way = follow(*reals.at(z, dense, np.zeros((250, 2))))
        margins.append(0.0 if way.snaps else min(e.margin for e in way.equilibria))
    assert 0.01 <= (np.array(margins) < told.margin[0]).mean() <= 0.1
    assert (np.array(margins) < told.margin[1]).mean() <= 0.01
    assert told.margin[0] < 0.16


def test_certificates_of_tubes_that_may_be_more_curved() -> None:
    """One parameter: the bound is the certificate of the tube with as much more curvature."""
    given = uncertain(["curvature_1"], ["1/m"], [0.3])
    bounds = certificate_bounds(given, lambda real, shift: -real.tubes[0].curvature, np.zeros(2))
    np.testing.assert_allclose(bounds, -16.0 - 0.3 * scipy.special.ndtri([0.95, 0.999]))  # type: ignore[arg-type]


def test_heated_tubes_are_known_again(tmp_path: Path) -> None:
    tube = robot().tubes[0]
    for dead, fade in ((0.0, 8 * MM), (2 * MM, 0.0), (2 * MM, 5 * MM)):
        for bend in (9.123456789, -4.1):
            pieces = heated_pieces(tube.curved_length, bend, dead, fade)
            made = Tube.of_pieces(tube.outer_diameter, tube.inner_diameter, pieces, straight_length=0.1)
            shape = shape_of(made)
            assert shape is not None
            assert shape[:3] == pytest.approx((bend, dead, fade), abs=1e-12)
    other = Tube.of_pieces(tube.outer_diameter, tube.inner_diameter, pieces[:4], straight_length=0.1)
    assert shape_of(other) is None


def test_the_posterior_is_saved_and_read_by_the_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "robot.yaml"
    MANY.save(path)
    assert load_robot(path) == MANY
    for command in (["fk", "--rotations-deg", "0,175"], ["certify"]):
        with pytest.raises(SystemExit) as end:
            main([command[0], str(path), *command[1:], "--json"])
        assert end.value.code in (0, 3)
        record = json.loads(capsys.readouterr().out)
        if command[0] == "fk":
            assert record["real_margin"][1] <= record["real_margin"][0] < record["margin"]
            assert record["real_tip_radius_mm"][1] > record["real_tip_radius_mm"][0] > 0
        else:
            assert record["real_certificate"][1] < record["real_certificate"][0] < record["certificate"]
    text = path.read_text().replace("curvature_1", "curvture_1")
    path.write_text(text)
    with pytest.raises(SystemExit) as end:
        main(["fk", str(path)])
    assert end.value.code == 2
    assert "curvture_1" in capsys.readouterr().err


@pytest.mark.parametrize("table", [((1.0,),), ((1.0, 0.3), (0.2, 1.0)), ((1.0, 2.0), (2.0, 1.0))])
def test_correlations_that_are_none_are_refused(table: tuple[tuple[float, ...], ...]) -> None:
    two = uncertain(["rotation_2", "curvature_1"], ["rad", "1/m"], [0.1, 0.1]).posterior
    assert two is not None
    with pytest.raises(InputError, match="correlations must be"):
        replace(two, correlations=table)


def test_the_error_of_new_paths_is_that_of_drawn_robots() -> None:
    """Against real robots drawn from the posterior, at joint values of other paths through the same ranges."""
    given = uncertain(["curvature_1", "rotation_2"], ["1/m", "rad"], [0.4, 0.05], 0.2 * MM)
    random = np.random.default_rng(4)
    rotations, translations = random.uniform(-0.6, 0.6, (200, 2)), np.tile([-10 * MM, -12 * MM], (200, 1))
    found, reals = expected_error(given, rotations, translations), real_robots(given)
    assert found is not None
    assert reals is not None
    squares = []
    for row in range(12):
        joints = rotations[row], translations[row]
        tip = forward_kinematics(given, *joints).tip_position
        drawn = [forward_kinematics(*reals.at(z, *joints)).tip_position for z in random.normal(size=(60, reals.size))]
        squares.append(((np.array(drawn) - tip) ** 2).sum(1).mean())
    rest = 3 * ((0.2 * MM) ** 2 + NOISE**2)
    assert found.rms == pytest.approx(np.sqrt(np.mean(squares) + rest), rel=0.12)
    assert found.low < found.rms < found.high
    assert found.low > np.sqrt(rest)
    assert expected_error(replace(given, posterior=None), rotations, translations) is None
