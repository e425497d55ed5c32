"""Several recordings of one robot: what is common, what each has of its own, and what is held out."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tubeopt import ConcentricRobot, InputError, Piece, Tube, load_robot
from tubeopt.cli.app import main
from tubeopt.robots.calibration import Calibration
from tubeopt.runs.measurement_file import save_measurements
from tubeopt.typing import Array
from tubeopt.validation import FitOptions, Measurements, choose_parameters, compare_effects, fit, validate
from tubeopt.validation.model import ParameterState
from tubeopt.validation.sessions import Sessions
from tubeopt.validation.tube_shapes import heated_pieces

from .drives import RATE, poses, robot, trivial
from .laboratory import MM

NOISE = 0.3 * MM


def bent() -> ConcentricRobot:
    """A robot whose outer tube is bent more than drawn."""
    inner, outer = robot().tubes
    return replace(robot(), tubes=(inner, replace(outer, curvature=5.4)))


def session(seed: int, drives: Calibration, count: int = 120, given: ConcentricRobot | None = None) -> Measurements:
    """A recording with a device of its own and a motion of its own; without noise where the seed is below 0."""
    random = np.random.default_rng(seed % 1000)
    time, speed, phase = np.arange(count) / RATE, random.uniform(0.2, 0.45, 4), random.uniform(0, 6, 4)

    def joints(at: Array) -> Array:
        waves = np.sin(speed * at[:, None] + phase) + 0.6 * np.sin(2.3 * speed * at[:, None] + 2 * phase)
        return np.asarray(waves * [1.4, 1.6, 14 * MM, 9 * MM] + [0.0, 0.0, 20 * MM, -8 * MM])

    tips = poses(given or bent(), drives, joints(time - drives.latency)).position[:, 0]
    turn, base = Rotation.random(random_state=seed % 1000).as_matrix(), random.uniform(-0.2, 0.2, 3)
    read, noise = joints(time), random.normal(0, NOISE, tips.shape) * (seed >= 0)
    return Measurements(
        read[:, :2], read[:, 2:], tips @ turn.T + base + noise, time=time + 100 * seed, source=f"session {seed}"
    )


DRIVES = tuple(
    trivial(rotation_gains=(1.015, 1.0), rotation_offsets=(0.0, zero), latency=delay)
    for zero, delay in ((0.08, 0.03), (-0.06, 0.09), (0.02, 0.06))
)
NAMES = ["latency", "rotation_2", "rotation_gain_1", "curvature_2"]
TRUTH = {
    "rotation_gain_1": 1.015, "curvature_2": 5.4,
    **{f"latency@{k + 1}": d.latency for k, d in enumerate(DRIVES)},
    **{f"rotation_2@{k + 1}": d.rotation_offsets[1] for k, d in enumerate(DRIVES)},
}  # fmt: skip


def test_common_and_own_parameters_are_recovered_and_held_out_errors_are_true() -> None:
    """The held-out number against the error of the fitted robot in a fourth session."""
    recordings = [session(seed, drives) for seed, drives in enumerate(DRIVES)]
    found = fit(robot(), recordings, NAMES)
    values = {e.name: e for e in found.estimates}
    assert set(values) == set(TRUTH)
    assert sum(e.low <= TRUTH[e.name] <= e.high for e in found.estimates) >= 7
    for name, truth in TRUTH.items():
        assert values[name].value == pytest.approx(truth, abs=4 * values[name].standard_error)
    # The three differ in latency and zeros alone: one recording knows the curvature sqrt(3) times worse.
    alone = fit(robot(), recordings[0], NAMES, FitOptions(folds=0))
    assert alone.estimates[3].standard_error > 1.4 * values["curvature_2"].standard_error
    assert found.held_out is not None
    assert found.held_out_recordings is not None
    assert len(found.after.recordings) == 3
    assert found.after.errors.shape == found.held_out_errors.shape == (360,)  # type: ignore[union-attr]
    last = found.robot.calibration
    assert last is not None
    assert last.latency == pytest.approx(0.06, abs=0.02)
    fresh = session(9, DRIVES[2], 300)
    error = validate(found.robot, fresh).summary.rms
    for held_out in (found.held_out.rms, np.sqrt((found.held_out_recordings**2).mean())):
        assert held_out == pytest.approx(error, rel=0.1)


def test_one_recording_gives_what_a_list_of_it_gives() -> None:
    m = session(0, DRIVES[0])
    one, listed = (fit(robot(), each, NAMES, FitOptions(folds=3)) for each in (m, [m]))
    assert [e.name for e in listed.estimates] == NAMES
    np.testing.assert_array_equal(one.held_out_errors, listed.held_out_errors)
    assert listed.held_out_recordings is None


def test_slopes_of_all_recordings_have_the_shape_of_an_arrow() -> None:
    recordings = [session(seed, drives, 12) for seed, drives in enumerate(DRIVES)]
    parameters = choose_parameters(robot(), recordings, NAMES, per_recording=("latency", "rotation"))
    for shared in (False, True):
        model = Sessions(robot(), recordings, shared=shared).with_parameters(parameters)
        assert model.freedoms == (6 if shared else 18)
        state = ParameterState(np.array([TRUTH[p.name] for p in parameters]) + 1e-3, model.start.registration)
        slopes, sizes = model.jacobian(state), [*(1e-3 * p.scale for p in parameters), *[1e-4] * model.freedoms]
        for k, size in enumerate(sizes):
            step = size * (np.arange(len(sizes)) == k)
            ahead, behind = (model.residuals(state.moved(side * step)) for side in (1, -1))
            largest = np.abs(slopes[..., k]).max()
            np.testing.assert_allclose((ahead - behind) / (2 * size), slopes[..., k], rtol=0, atol=2e-3 * largest)
        for k, p in enumerate(parameters):
            moved = np.abs(slopes[..., k]).max(1) > 0
            assert set(model.recording[moved]) == ({p.recording} if p.recording is not None else {0, 1, 2})


def test_a_registration_that_is_shared_is_one() -> None:
    """Two recordings on one bench: the second's tips alone lie on a short arc that leaves its own frame open."""
    turn, base = Rotation.random(random_state=5).as_matrix(), np.array([0.1, 0.0, -0.2])
    time = np.arange(60) / RATE
    wide = np.column_stack([np.sin(time), 1.4 * np.cos(1.3 * time), 10 * MM * np.sin(time), np.zeros(60)])
    small = wide * [0.02, 0.02, 0.02, 0.0]
    random = np.random.default_rng(1)
    recordings = [
        Measurements(
            read[:, :2], read[:, 2:],
            poses(bent(), trivial(), read).position[:, 0] @ turn.T + base + random.normal(0, NOISE, (60, 3)),
            time=time,
        )
        for read in (wide, small)
    ]  # fmt: skip
    options = FitOptions(registration="rigid", folds=0, per_recording=("latency",))
    model = Sessions(robot(), recordings, shared=True)
    (part,) = model.start.registration.parts
    assert np.degrees(Rotation.from_matrix(part.rotation @ turn).magnitude()) < 6
    found = fit(robot(), recordings, ["curvature_2"], options)
    assert found.estimates[0].value == pytest.approx(5.4, abs=4 * found.estimates[0].standard_error)


def test_a_file_lists_recordings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    robot().save(tmp_path / "robot.yaml")
    for seed, drives in enumerate(DRIVES[:2]):
        save_measurements(session(seed, drives, 40), tmp_path / f"{seed}.csv")
    (tmp_path / "both.yaml").write_text("kind: recordings\nfiles: [0.csv, 1.csv]\n")
    names = "latency,rotation_2,curvature_2"
    command = ["validate", str(tmp_path / "robot.yaml"), str(tmp_path / "both.yaml"), "--fit", names, "--folds", "3"]
    with pytest.raises(SystemExit) as end:
        main([*command, "--per-recording", "registration,rotation", "--json"])
    record = json.loads(capsys.readouterr().out)
    assert end.value.code == 0
    assert [e["name"] for e in record["estimates"]] == ["latency", "rotation_2@1", "rotation_2@2", "curvature_2"]
    assert [part["measurements"] for part in record["after"]["recordings"]] == ["0.csv", "1.csv"]
    assert len(record["held_out_recordings"]) == 2


def ramped(tube: Tube, dead: float, fade: float) -> Tube:
    """A tube whose curvature rises and falls linearly, as a function of arc length."""
    u, flat = tube.curvature, tube.curved_length - 2 * (dead + fade)
    rise, fall = (Piece(fade, lambda s, at=at: u * abs(at - s) / fade) for at in (0.0, fade))
    chain = (Piece(dead, 0.0), rise, Piece(flat, u), fall, Piece(dead, 0.0))
    dimensions = tube.outer_diameter, tube.inner_diameter
    return Tube.of_pieces(*dimensions, chain, straight_length=tube.straight_length)


def test_the_heated_shape_is_recovered_and_its_uncertainty_is_reported(tmp_path: Path) -> None:
    """Ramps as functions of arc length are recovered: 16 and 10 mm of fade behind 4 and 3 mm that stayed straight."""
    inner, outer = robot().tubes
    true = replace(robot(), tubes=(ramped(inner, 4 * MM, 16 * MM), ramped(outer, 3 * MM, 10 * MM)))
    truth = {"dead_length_1": 4 * MM, "dead_length_2": 3 * MM, "fade_1": 16 * MM, "fade_2": 10 * MM, "curvature": 1.0}
    recordings = [session(seed, trivial(), 200, true) for seed in range(2)]
    options = FitOptions(per_recording=("registration",), folds=3)
    fitted = fit(robot(), recordings, ["dead_length_all", "fade_all", "curvature"], options)
    for e in fitted.estimates:
        assert e.value == pytest.approx(truth[e.name], abs=3 * e.standard_error)
        assert e.low > 0 or e.name == "dead_length_1"
    (remark,) = (r for r in fitted.remarks if r.startswith("length, stiffness and shape explain each other"))
    assert "dead_length_1 -" in remark  # a longer ramp against a shorter straight end
    assert "fade_1 +" in remark
    assert fitted.before.summary.rms > 4 * fitted.after.summary.rms
    fitted.robot.save(tmp_path / "robot.yaml")
    error = validate(load_robot(tmp_path / "robot.yaml"), session(7, trivial(), 300, true)).summary.rms
    assert fitted.held_out is not None
    assert fitted.held_out.rms == pytest.approx(error, rel=0.1)
    with pytest.raises(InputError, match="together they must be at most half the curved length of 60 mm"):
        heated_pieces(60 * MM, 5.0, 20 * MM, 11 * MM)


def lagging(seed: int, lag: Array, latency: float, noise: float = 0.1 * MM) -> Measurements:
    """A brisk motion at 20 rows per second, the drives' lag integrated in steps of 5 ms (Heun), then delayed."""
    random, fine = np.random.default_rng(seed), np.arange(-200, 2400) / 200
    speed, phase = random.uniform(1.0, 2.5, 4), random.uniform(0, 6, 4)
    x = (np.sin(speed * fine[:, None] + phase) + 0.4 * np.sin(2.3 * speed * fine[:, None] + phase)) * [1, 1, 0.01, 0.01]
    x[:200] = x[200]  # stands still before the first row
    y = x.copy()
    for k in range(len(fine) - 1):
        if lag.any():
            first = (x[k] - y[k]) / np.maximum(lag, 1e-12) * (lag > 0)
            second = (x[k + 1] - y[k] - 5e-3 * first) / np.maximum(lag, 1e-12) * (lag > 0)
            y[k + 1] = np.where(lag > 0, y[k] + 2.5e-3 * (first + second), x[k + 1])
    at = np.arange(240) * 10
    read, followed = x[200 + at], y[200 + at - round(200 * latency)]
    tips = poses(robot(), trivial(), followed).position[:, 0]
    return Measurements(read[:, :2], read[:, 2:], tips + random.normal(0, noise, tips.shape), time=at / 200)


def test_lag_and_latency_are_told_apart() -> None:
    """Truth: 0.08 s latency, tube 1 follows with 0.12 s, carriage 2 with 0.2 s; 3 motions."""
    lag, names = np.array([0.12, 0.0, 0.0, 0.2]), ["latency", "rotation_lag_all", "translation_lag_all"]
    truth, hits, ratio, options = (0.08, *lag), 0, 0.0, FitOptions("none", folds=3)
    for seed in range(3):
        fitted = fit(robot(), lagging(seed, lag, 0.08), names, options)
        for e, true in zip(fitted.estimates, truth, strict=True):
            assert e.value == pytest.approx(true, abs=max(4 * e.standard_error, 4e-3))
            hits += bool(e.low - 2e-3 <= true <= e.high + 2e-3)
        assert fitted.held_out is not None
        ratio += fitted.held_out.rms / (np.sqrt(3) * 0.1 * MM) / 3
    assert hits >= 14
    assert ratio == pytest.approx(1, abs=0.05)
    # A latency alone leaves what the lags do.
    alone = fit(robot(), lagging(0, lag, 0.08), ["latency"], options).held_out
    assert alone is not None
    assert alone.rms > 0.6 * MM
    # Tips that lead their drives have no lag: the range ends at 0.
    early = fit(robot(), lagging(0, 0 * lag, 0.0), ["rotation_lag_1"], options).estimates[0]
    assert early.value == pytest.approx(0.0, abs=3 * early.standard_error)


def test_the_held_out_number_includes_the_choice_of_effects() -> None:
    """Two recordings; the choice without each block must not end at effects that act like the true ones."""
    inner, outer = robot().tubes
    true = replace(robot(), tubes=(replace(inner, curvature=9.42), outer))
    drives = trivial(rotation_offsets=(0.0, 0.047))
    recordings = [session(seed, drives, 100, true) for seed in (1, 2)]
    tried = ["rotation", "rotation_gain", "curvature", "bending_stiffness", "torsional_stiffness"]
    result = compare_effects(robot(), recordings, tried, FitOptions(folds=6))
    assert {step.effect for step in result.steps} == {"rotation", "curvature"}
    assert sum(set(kinds) == {"rotation", "curvature"} for kinds in result.chosen_by_fold) >= 4
    assert result.fit is not None
    error = validate(result.fit.robot, session(9, drives, 400, true)).summary.rms
    assert result.chosen_anew.rms == pytest.approx(error, rel=0.1)
    # The mean over sets predicts as it says, and is the fit where nearly all weight is on one set.
    mean = validate(result.averaged, session(9, drives, 400, true)).summary.rms
    assert result.averaged_anew.rms == pytest.approx(mean, rel=0.1)
    assert sum(weight for weight, _ in result.weights) == pytest.approx(1.0)
    assert mean == pytest.approx(error, rel=0.02)
    # With nearly all weight on one set its posterior is that of the fit.
    alone, all_sets = result.fit.robot.posterior, result.averaged.posterior
    assert alone is not None
    assert all_sets is not None
    for name in ("curvature_1", "torsional_stiffness_2"):
        deviations = [np.linalg.norm(each.factor[each.names.index(name)]) for each in (alone, all_sets)]
        assert 0.7 < deviations[1] / deviations[0] < 2.0, name
    assert result.settled
