"""Data along a way: latency, play, places that are passed again, what is held out, and which effects pay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tubeopt import ConcentricRobot, Friction, InputError, forward_kinematics_batch, load_robot
from tubeopt.robots.calibration import Calibration
from tubeopt.validation import (
    FitOptions,
    Measurements,
    compare_effects,
    fit,
    validate,
    where_to_measure,
)
from tubeopt.validation.effects import Setup
from tubeopt.validation.fitting import FitProblem, hold_out, predicted_held_out
from tubeopt.validation.measurements import Timeline, deal, passes, runs_of
from tubeopt.validation.model import ParameterState
from tubeopt.validation.parameters import choose_parameters
from tubeopt.validation.selection import HeldOutSets, slopes_around
from tubeopt.validation.sessions import Sessions

from .drives import driven, joints, poses, robot, trivial
from .laboratory import BASE, MM, TURN, in_device

NAMES = ["latency", "rotation_2", "translation_all", "rotation_gain_all"]
TRUTH = {
    "latency": 0.09,
    "rotation_2": 0.08,
    "translation_1": -2 * MM,
    "translation_2": 1.5 * MM,
    "rotation_gain_1": 1.01,
    "rotation_gain_2": 0.992,
}


def test_readings_are_interpolated_between_rows() -> None:
    m = driven(count=200)
    assert m.time is not None
    rotations, translations = Timeline.of(m).readings(0.043)
    exact = joints(m.time - 0.043, m.time[-1])
    inside = slice(2, 95)  # before it turns back, where the speed jumps
    np.testing.assert_allclose(np.hstack([rotations, translations])[inside], exact[inside], atol=3e-4)
    np.testing.assert_array_equal(Timeline.of(m).readings(0.0)[0], m.rotations)


def test_runs_part_at_gaps_and_where_time_begins_anew() -> None:
    time = np.array([0.0, 0.1, 0.2, 5.0, 5.1, 0.0, 0.1])
    assert [list(rows) for rows in runs_of(time)] == [[0, 1, 2], [3, 4], [5, 6]]


def test_play_lets_the_drive_turn_before_the_tube_follows() -> None:
    m = replace(driven(count=5), rotations=np.array([[0, 0], [1, 0], [0.9, 0], [0.5, 0], [1, 0]], dtype=float))
    followed = Timeline.of(m).with_play(m.rotations, np.array([0.1, 0.0]))
    np.testing.assert_allclose(followed[:, 0], [-0.1, 0.9, 0.9, 0.6, 0.9])
    np.testing.assert_array_equal(followed[:, 1], m.rotations[:, 1])


def test_what_is_wrong_with_the_drives_is_found_within_the_intervals() -> None:
    hits = dict.fromkeys(TRUTH, 0)
    for seed in range(6):
        fitted = fit(robot(), driven(seed=seed), NAMES, FitOptions(folds=0))
        for e in fitted.estimates:
            hits[e.name] += bool(e.low <= TRUTH[e.name] <= e.high)
        assert fitted.noise == pytest.approx(0.3 * MM, rel=0.1)
    assert min(hits.values()) >= 5, hits
    assert sum(hits.values()) >= 32


def test_slopes_around_a_fit_stand_in_the_order_of_the_parameters_asked_for() -> None:
    first, second = ([*choose_parameters(robot(), driven(count=40), names)] for names in (["latency"], ["rotation_2"]))
    model = Sessions(robot(), [driven(count=40)])
    later = FitProblem(model.with_parameters(second), FitOptions(folds=0))
    around = slopes_around(later.model, later.fit, [first])
    both = model.with_parameters([*first, *second])
    state = ParameterState(np.append(0.0, later.fit.state.x), later.fit.state.registration)
    np.testing.assert_allclose(around.of(both.parameters), both.jacobian(state), rtol=1e-6, atol=1e-9)


def test_the_calibrated_robot_predicts_by_itself() -> None:
    m = driven()
    fitted = fit(robot(), m, NAMES)
    assert fitted.robot.calibration is not None
    assert fitted.robot.calibration.latency == pytest.approx(0.09, abs=0.01)
    assert "300 rows of a way" in fitted.robot.calibration.found_by
    again = validate(fitted.robot, m)
    assert again.summary.rms == pytest.approx(fitted.after.summary.rms, rel=1e-3)
    assert fitted.held_out is not None
    assert fitted.after.summary.rms < fitted.held_out.rms < 1.1 * fitted.after.summary.rms
    assert fitted.before.parity is not None
    assert fitted.after.parity is not None
    assert fitted.before.parity.history > 1.5 * fitted.after.parity.history


@pytest.mark.filterwarnings("ignore::tubeopt.errors.ImplausibleWarning")  # turns of the recording
def test_gains_do_not_depend_on_the_turn_that_a_recording_counts_from() -> None:
    m = driven(count=150)
    fitted = fit(robot(), m, ["rotation_2", "rotation_gain_all"], FitOptions(folds=0))
    for turns in ([1, 0], [0, -2], [-3, 1]):
        elsewhere = replace(m, rotations=m.rotations + 2 * np.pi * np.array(turns))
        assert validate(fitted.robot, elsewhere).summary.rms == pytest.approx(fitted.after.summary.rms, rel=1e-9)
        alone = [fit(robot(), each, ["rotation_gain_all"], FitOptions(folds=0)) for each in (m, elsewhere)]
        assert alone[1].after.summary.rms == pytest.approx(alone[0].after.summary.rms, rel=1e-6)
    # A reading is the same joint value in commands as in the recording.
    calibration = alone[1].robot.calibration
    assert calibration is not None
    assert np.round(calibration.rotation_zeros / (2 * np.pi)).tolist() == [-3, 1]
    read = elsewhere.rotations[:3], elsewhere.translations[:3]
    np.testing.assert_allclose(calibration.to_readings(*calibration.to_model(*read))[0], read[0])
    first = alone[0].robot.calibration
    assert first is not None
    turned = calibration.to_model(*read)[0] - first.to_model(m.rotations[:3], m.translations[:3])[0]
    np.testing.assert_allclose(turned, np.tile(2 * np.pi * np.array(turns), (3, 1)), atol=1e-6)


def tips_at(rotations: np.ndarray) -> np.ndarray:
    """(N, 3) tips of the robot with its tubes at home, m."""
    return forward_kinematics_batch(robot(), rotations, np.zeros_like(rotations)).tip_position


def test_rows_of_a_recording_have_the_same_errors_wherever_it_begins() -> None:
    """Truth: drive 1 turns by 1.03 times its reading and 10 deg, over five turns."""
    time = np.linspace(0.0, 16.0, 160)
    read = np.column_stack([np.linspace(-2.3, 2.6, 160) * 2 * np.pi, 0.3 * np.sin(time)])
    tips = tips_at(read * [1.03, 1.0] + [np.radians(10), 0.0])
    whole = Measurements(read, np.zeros((160, 2)), tips, time=time)
    calibration = Calibration(
        (np.radians(10), 0.0), (0.0, 0.0), (1.03, 1.0), (1.0, 1.0), (0.0, 0.0), rotation_middles=(0.9, 0.0)
    )
    calibrated = replace(robot(), calibration=calibration)
    wrapped = (read + np.pi) % (2 * np.pi) - np.pi
    for rows in (slice(0, 53), slice(40, 160), slice(80, 160), slice(107, 160)):
        part = whole.rows(rows)
        result = validate(calibrated, part, registration="none")
        assert result.summary.max < 1e-9
        assert not result.remarks
        # Counters that begin elsewhere, and angles that do not count turns.
        for rotations, marks in (
            (part.rotations + np.array([4 * np.pi, 0.0]), ()),
            (np.unwrap(wrapped[rows], axis=0), (True, False)),
        ):
            again = validate(calibrated, replace(part, rotations=rotations, wrapped=marks), registration="none")
            assert again.summary.max < 1e-9
            assert "readings fit best with" in " ".join(again.remarks) or np.allclose(rotations, part.rotations)


def test_two_counters_that_were_set_to_zero_elsewhere_are_found_together() -> None:
    time = np.linspace(0.0, 16.0, 60)
    read = np.column_stack([np.linspace(-2.0, 2.0, 60), 1.5 * np.sin(time)])
    calibrated = replace(robot(), calibration=Calibration((0.0, 0.0), (0.0, 0.0), (1.03, 0.96), (1.0, 1.0), (0.0, 0.0)))
    tips = tips_at(read * [1.03, 0.96])
    for turns in ((1, -2), (-3, 2), (0, 1)):
        m = Measurements(read + 2 * np.pi * np.array(turns), np.zeros((60, 2)), tips, time=time)
        result = validate(calibrated, m, registration="none")
        assert result.summary.max < 1e-9
        text = [f"{-360 * turn:+.0f} deg of rotation_{k}" for k, turn in enumerate(turns, start=1) if turn]
        assert f"readings fit best with {' and '.join(text)}: 0.00 mm" in result.remarks[0]


def test_a_counter_stays_as_it_was_read_where_another_turn_fits_little_better() -> None:
    """An offset of a third of what a turn makes is an error of the robot, and stays one."""
    time = np.linspace(0.0, 16.0, 60)
    read = np.column_stack([np.linspace(-1.0, 1.0, 60), 0.3 * np.sin(time)])
    turn = 2 * np.pi * 0.03
    calibrated = replace(robot(), calibration=Calibration((0.0, 0.0), (0.0, 0.0), (1.03, 1.0), (1.0, 1.0), (0.0, 0.0)))
    for fraction, retained in ((0.3, 0.3), (0.6, 0.6), (0.9, 0.1)):
        tips = tips_at(read * [1.03, 1.0] + [fraction * turn, 0.0])
        m = Measurements(read, np.zeros((60, 2)), tips, time=time)
        error = validate(calibrated, m, registration="none").summary.rms
        off = tips_at(read * [1.03, 1.0] + [(fraction - retained) * turn, 0.0])
        assert error == pytest.approx(np.sqrt(((tips - off) ** 2).sum(1).mean()), rel=0.05)


def test_effects_that_are_there_are_found_and_no_others() -> None:
    c = compare_effects(robot(), driven(), ["latency", "rotation_play", "translation", "rotation_gain"])
    assert set(c.chosen) >= {"latency", "translation_1", "translation_2"}
    assert {step.effect for step in c.refused} >= {"rotation_play"}
    assert all(step.kept for step in c.steps)
    assert not any(step.kept for step in c.refused)
    rms = [c.start.rms, *(step.held_out.rms for step in c.steps)]
    for before, step in zip(rms, c.steps, strict=False):
        assert step.gain == pytest.approx(1 - step.held_out.rms / before, abs=0.02)
    assert rms == sorted(rms, reverse=True)
    assert c.fit is not None
    assert c.fit.robot.calibration is not None
    assert c.fit.held_out is not None
    # To first order, and with the choice made anew without each fold.
    assert c.chosen_anew.rms == pytest.approx(c.fit.held_out.rms, rel=0.05)


def test_where_nothing_is_wrong_nothing_is_chosen() -> None:
    c = compare_effects(robot(), driven(trivial(), count=200), ["latency", "rotation_play", "translation", "curvature"])
    assert not c.steps
    assert c.fit is None


def test_a_shadow_of_two_effects_is_not_taken_for_them_and_what_is_told_is_of_the_last_set() -> None:
    tried = ["rotation_gain", "torsional_stiffness", "curvature", "transmission_length", "sensor_offset"]
    inner, outer = robot().tubes
    soft = replace(robot(), tubes=(inner, replace(outer, torsional_stiffness=0.85 * outer.torsional_stiffness)))
    time = np.arange(240) / 4
    read = joints(time, time[-1])
    drives = trivial(rotation_gains=(1.015, 0.985))
    tips = in_device(poses(soft, drives, read).position[:, 0])
    noisy = tips + np.random.default_rng(3).normal(0, 0.2 * MM, tips.shape)
    c = compare_effects(robot(), Measurements(read[:, :2], read[:, 2:], noisy, time=time), tried)
    retained, refused = [step.effect for step in c.steps], [step.effect for step in c.refused]
    assert set(retained) == {"rotation_gain", "torsional_stiffness"}
    assert sorted(retained + refused) == sorted(tried)
    assert set(c.dropped) <= set(refused)
    assert c.fit is not None
    assert {e.name.rsplit("_", 1)[0] for e in c.fit.estimates} == set(retained)
    rivals = {name for step in c.steps for name in step.rivals}
    assert rivals <= set(refused)
    assert all(step.gain < 0.005 for step in c.refused)


def test_sets_cost_what_full_fits_to_the_other_folds_lose() -> None:
    """Held-out losses of sets from sums over folds are those of fits by rows."""
    rng = np.random.default_rng(0)
    slopes, fold = rng.normal(size=(60, 3, 5)), np.arange(60) % 4
    residuals = slopes[..., :2] @ [0.5, -0.3] + rng.normal(0, 0.2, (60, 3))
    nothing = np.zeros(4)
    sets = HeldOutSets(
        residuals=residuals,
        slopes=slopes,
        weights=np.full(60, 25.0),
        fold=fold,
        numbers=180,
        kinds=("a", "a", "b", "c"),
        base=frozenset({"a"}),
        absent=nothing,
        drawn=nothing,
        prior=np.full(4, np.inf),
        low=np.array([-1, -1, -1, 0.0]),
        high=np.ones(4),
        jumps={},
    )
    columns, lost = [0, 1, 2, 4], 0.0
    for k in range(4):
        rest, own = fold != k, fold == k
        table, right = slopes[rest][..., columns].reshape(-1, 4), -residuals[rest].ravel()
        step = np.linalg.lstsq(table, right, rcond=None)[0]
        lost += 25 * ((residuals[own] + slopes[own][..., columns] @ step) ** 2).sum()
    assert sets.lost(frozenset("ab")) == pytest.approx(lost, rel=1e-9)
    assert sets.explore()[0] == frozenset("a")
    assert 1 <= sets.inflation < 2
    assert sets.cost(frozenset("ab")) - sets.lost(frozenset("ab")) == pytest.approx(3 * sets.charge)
    weighed = {kinds: weight for weight, kinds in sets.weighed()}
    less = (sets.cost(frozenset("ab")) - sets.cost(frozenset("a"))) / (2 * sets.inflation)
    assert weighed[frozenset("ab")] == pytest.approx(weighed[frozenset("a")] * np.exp(-less))
    assert 0 < weighed[frozenset("ab")] < 0.5
    assert sum(weighed.values()) == pytest.approx(1.0)
    # Without each fold: the mean of predictions, between that of the best set and others.
    anew = sets.chosen_anew()
    assert anew.sets == (("a",),) * 4
    assert 0 < np.abs(anew.averaged - anew.residuals).max() < 0.5 * np.abs(anew.residuals).max()


def test_mean_of_setups_has_the_means_of_their_numbers() -> None:
    drives = replace(Calibration.none(2), rotation_offsets=(0.1, 0.0), latency=0.2)
    one, other = Setup.of(replace(robot(), calibration=drives, friction=Friction(0.004))), Setup.of(robot())
    one.curvature[1] = 6.0
    mean = Setup.mean([one, other], np.array([0.25, 0.75])).robot(robot())
    assert isinstance(mean, ConcentricRobot)
    assert [tube.curvature for tube in mean.tubes] == pytest.approx([9.0, 5.25])
    assert mean.friction == Friction((0.001,))
    assert mean.calibration is not None
    assert mean.calibration.rotation_offsets == pytest.approx((0.025, 0.0))
    assert mean.calibration.latency == pytest.approx(0.05)


def test_a_comparison_in_the_plate_s_frame_begins_with_nothing_to_fit() -> None:
    m = driven(trivial(latency=0.09), count=150, noise=0.2 * MM)
    current = replace(m, sensors=(m.sensors - BASE) @ TURN)
    c = compare_effects(robot(), current, ["latency", "plate_shift"], FitOptions(folds=4, registration="none"))
    assert [step.effect for step in c.steps] == ["latency"]


def test_play_is_told_from_latency_only_with_care() -> None:
    m = driven(trivial(latency=0.09))
    fitted = fit(robot(), m, ["latency"], FitOptions(folds=0))
    output = [remark for remark in fitted.remarks if "hardly be distinguished from rotation_play" in remark]
    assert all("slowly and once fast" in remark for remark in output)


def test_outliers_do_not_move_a_robust_fit() -> None:
    m = driven(trivial(latency=0.09), noise=0.2 * MM)
    spoiled = m.sensors.copy()
    spoiled[::12] += 40 * MM
    wild = replace(m, sensors=spoiled)
    plain, robust = (
        fit(robot(), wild, ["latency", "translation_all"], FitOptions(folds=0, loss=loss))
        for loss in ("linear", "huber")
    )
    off = [abs(f.estimates[1].value) for f in (plain, robust)]
    assert off[1] < 0.5 * off[0]
    assert robust.noise < 0.1 * plain.noise


# --- what is held out -------------------------------------------------------------------------------------------------


def test_rows_of_the_way_back_are_in_the_fold_of_the_way_there() -> None:
    m = driven()
    result = passes(m)
    reached = np.arange(150)
    back = len(m) - 1 - reached
    fold = deal(m, 10)
    assert (fold[reached[:140]] == fold[back[:140]]).mean() > 0.97
    assert np.bincount(fold).min() > 20
    assert len(result.pairs) > 130
    np.testing.assert_allclose(result.pairs.sum(1), len(m) - 1, atol=2)


def test_folds_are_blocks_of_time_where_the_way_is_new() -> None:
    m = driven(count=240)
    fold = deal(m.rows(np.arange(120)), 6)
    assert (np.diff(fold) >= 0).all()
    np.testing.assert_array_equal(np.bincount(fold), 20)


def test_rows_without_time_and_with_equal_joints_are_in_one_fold() -> None:
    m = replace(driven(count=40), time=None)
    twice = m.rows(np.tile(np.arange(40), 2))
    fold = deal(twice, 5)
    np.testing.assert_array_equal(fold[:40], fold[40:])


def test_data_without_time_know_no_latency() -> None:
    m = replace(driven(count=40), time=None)
    with pytest.raises(InputError, match="parameter 'latency' needs the time of every row"):
        fit(robot(), m, ["latency"])
    with pytest.raises(InputError, match="effect 'latency' cannot be compared"):
        compare_effects(robot(), m, ["latency"])


# --- directions, stations, sensors that do not see --------------------------------------------------------------------


def test_directions_tell_the_sensor_s_axis_and_weigh_by_their_noise() -> None:
    m = driven(trivial(rotation_offsets=(0.0, 0.1)), noise=0.2 * MM)
    assert m.time is not None
    frames = poses(robot(), trivial(rotation_offsets=(0.0, 0.1)), joints(m.time, m.time[-1])).frame
    shaken = Rotation.from_rotvec(np.random.default_rng(1).normal(0, np.radians(0.5), (len(m), 3))).as_matrix()
    sideways = np.array([[0, 0, -1], [0, 1, 0], [1, 0, 0]], dtype=float)  # its -x axis points along the tube
    observed = TURN @ shaken @ frames @ sideways
    observed[5] = np.nan
    fitted = fit(robot(), replace(m, orientation=observed), ["rotation_2"], FitOptions(folds=3))
    assert fitted.after.axis_errors is not None
    assert np.isnan(fitted.after.axis_errors).sum() == 1
    assert np.sqrt(np.nanmean(fitted.after.axis_errors**2)) < np.radians(1.0)
    assert fitted.axis_noise == pytest.approx(np.radians(0.5), rel=0.15)
    assert fitted.noise == pytest.approx(0.2 * MM, rel=0.1)
    plain = fit(robot(), m, ["rotation_2"], FitOptions(folds=0))
    assert fitted.estimates[0].standard_error < plain.estimates[0].standard_error


def test_sensors_along_the_arm_and_such_as_do_not_see() -> None:
    m = driven(trivial(), count=60, noise=0.0)
    assert m.time is not None
    from tubeopt.validation.model import solve_poses

    behind = np.array([0.0, 35 * MM])
    read = joints(m.time, m.time[-1])
    along = solve_poses(robot(), read[:, :2], read[:, 2:], behind).position
    both = along @ TURN.T
    both[7, 0] = np.nan
    both[8, 1] = np.nan
    result = validate(robot(), replace(m, sensors=both, behind=behind))
    assert np.nanmax(result.along) < 1e-9
    assert np.argwhere(np.isnan(result.along)).tolist() == [[7, 0], [8, 1]]
    assert result.summary.count == 59


def test_what_no_configuration_determines_is_said() -> None:
    with pytest.raises(
        InputError, match=r"rotation_2 cannot be distinguished from a change of rotation_1.*measure the base"
    ):
        where_to_measure(robot(), ["rotation_all"], 10)


def test_tubes_of_equal_length_are_measured_where_they_move_together(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tubeopt.validation.identifiability.CANDIDATES", 24)
    two = load_robot("configs/robots/two_tube.yaml")
    result = where_to_measure(two, ["rotation_1", "curvature_1"], 4, seed=2)
    assert np.allclose(result.translations[:, 0], result.translations[:, 1], rtol=0, atol=1e-12)
    assert np.ptp(result.translations[:, 0]) > 1 * MM


def test_room_between_the_tubes_is_found_like_any_other_effect() -> None:
    time, truth = np.arange(50) * 1.2, 40e-6
    read, loose = joints(time, 60.0), replace(robot(), clearance=(truth,))
    tips = poses(loose, trivial(), read).position[:, 0]
    noisy = in_device(tips + np.random.default_rng(0).normal(0, 0.1 * MM, tips.shape))
    data = Measurements(read[:, :2], read[:, 2:], noisy)
    result = compare_effects(robot(), data, ("clearance", "curvature"), FitOptions(folds=4))
    assert result.chosen == ("clearance_1",)
    assert result.fit is not None
    (estimate,) = result.fit.estimates
    assert estimate.low < truth < estimate.high < 1.2 * truth


def test_what_is_held_out_to_first_order_is_what_is_held_out() -> None:
    data, options = driven(count=150), FitOptions(priors=True)
    chosen = choose_parameters(robot(), data, NAMES)
    problem = FitProblem(Sessions(robot(), [data]).with_parameters(chosen), options)
    fold = deal(data, 6, passes(data).group)
    exact = hold_out(problem.model, problem.weights(), problem.fit, fold)
    report = predicted_held_out(problem.model, problem.weights(), problem.fit, fold)
    moved = np.linalg.norm(exact - problem.fit.residuals, axis=1)
    assert moved.max() > 0.05 * MM
    assert np.linalg.norm(report - exact, axis=1).max() < 0.05 * moved.max()
