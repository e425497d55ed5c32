"""Learned changes of the precurvature along tubes: shapes, priors, and what they gain where no drawing is right."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.polynomial import legendre

from tubeopt import ConcentricRobot, InputError, Piece, Tube, load_robot, snap_free_certificate
from tubeopt.robots.calibration import Posterior
from tubeopt.robots.pieces import at
from tubeopt.solvers.robust_least_squares import RobustDescent, Weights, secant
from tubeopt.validation import FitOptions, Measurements, choose_parameters, fit, real_robots, validate
from tubeopt.validation.effects import Setup
from tubeopt.validation.learned import _Likelihood
from tubeopt.validation.tube_shapes import DEGREES, MODES, TubeShape, shape_of

from .laboratory import MM, ctr, in_device, noisy, tips, turned

NOISE = 0.05 * MM


def wavy(tube: Tube) -> Tube:
    """A tube bent in waves, in and out of its plane."""

    def bend(s: float) -> tuple[float, float, float]:
        wave = 2 * np.pi * s / tube.curved_length
        return tube.curvature * (1 + 0.3 * np.sin(wave + 1.0)), 0.25 * tube.curvature * np.sin(0.8 * wave), 0.0

    chain = [Piece(tube.curved_length, bend)]
    return Tube.of_pieces(tube.outer_diameter, tube.inner_diameter, chain, straight_length=tube.straight_length)


def recorded(robot: ConcentricRobot, count: int, seed: int) -> Measurements:
    """Tips of a robot with noise, at joint values of the laboratory."""
    exact = turned(ctr(), count)
    return noisy(replace(exact, sensors=in_device(tips(robot, exact))), seed, NOISE)


def test_a_learned_change_is_a_sum_of_polynomials_and_known_again_from_the_file(tmp_path: Path) -> None:
    tube, random = ctr().tubes[0], np.random.default_rng(0)
    for dead, fade in ((0.0, 0.0), (4 * MM, 0.0), (0.0, 12 * MM), (3 * MM, 9 * MM)):
        shape = TubeShape(-8.5, dead, fade, random.normal(0, 0.5, MODES))
        pieces = shape.pieces(tube.curved_length)
        ends = np.cumsum([0.0, *(piece.length for piece in pieces)])
        for s in random.uniform(0, tube.curved_length, 20):
            k = int(np.searchsorted(ends, s)) - 1
            x = 2 * s / tube.curved_length - 1
            sums = [
                sum(w * np.sqrt(2 * j + 1) * legendre.legval(x, [0] * j + [1]) for j, w in enumerate(part, start=1))
                for part in np.split(shape.learned, 2)
            ]
            inner = min(s, tube.curved_length - s)
            heated = shape.bend * np.clip((inner - dead) / fade if fade else float(inner > dead), 0, 1)
            found = [at(q, s - ends[k]) for q in pieces[k].precurvature]
            np.testing.assert_allclose(found, [heated + sums[0], sums[1], 0.0], atol=1e-9)
        made = Tube.of_pieces(tube.outer_diameter, tube.inner_diameter, pieces, straight_length=tube.straight_length)
        posterior = Posterior.of(["learned_curvature_1_1"], ["1/m"], np.eye(1), 0.0, 0.0)
        robot = replace(ctr(), tubes=(made, ctr().tubes[1]), posterior=posterior)
        robot.save(tmp_path / "robot.yaml")
        setup = Setup.of(load_robot(tmp_path / "robot.yaml"))
        np.testing.assert_allclose(setup.learned[:MODES], shape.learned, atol=1e-7)
        assert setup.curvature[0] == pytest.approx(8.5)
        assert (setup.dead_length[0], setup.fade[0]) == pytest.approx((dead, fade))
        assert shape_of(made) is None  # a drawing may have such a shape too
        setup.learned[:] = 0.0
        setup.dead_length[:] = setup.fade[:] = 0.0
        (alone,) = setup.robot(robot).tubes[0].pieces
        assert alone.precurvature == (pytest.approx(-8.5), 0.0, 0.0)


def test_the_likelihood_is_that_of_a_normal_vector() -> None:
    """Against the dense covariance: the fixed columns drop out of it, the noise is the most likely one."""
    random = np.random.default_rng(3)
    v, names = 15, ["a", "b", "c"]
    jacobian, x = random.normal(size=(v, 3, 5)), random.normal(size=3)
    residuals, sigma = random.normal(size=(v, 3)), 0.7
    parameters = [SimpleNamespace(start=0.2, name=name) for name in names]
    model: Any = SimpleNamespace(parameters=parameters, directed=np.zeros(v, dtype=bool))
    state: Any = SimpleNamespace(x=x)
    weights = Weights(np.full(v, sigma), np.ones(v), np.array([np.inf, 1.0, 1.0]))
    likelihood = _Likelihood(model, weights, RobustDescent(state, residuals, jacobian, True), np.array([0, 1, 1]) > 0)
    flat = jacobian.reshape(-1, 5)
    data = residuals.ravel() - flat[:, 1:3] @ (x[1:] - 0.2)
    # A basis of what the fixed columns leave.
    basis = np.linalg.svd(flat[:, [0, 3, 4]])[0][:, 3:]

    def dense(deviations: np.ndarray) -> float:
        learned = basis.T @ flat[:, 1:3] * deviations / sigma
        covariance = np.eye(basis.shape[1]) + learned @ learned.T
        rest = basis.T @ data @ np.linalg.solve(covariance, basis.T @ data)
        return float(basis.shape[1] * np.log(rest) + np.linalg.slogdet(covariance)[1])

    tried = [np.array(d) for d in ((0.1, 0.1), (2.0, 0.3), (0.4, 5.0))]
    found = np.array([likelihood.of(d) for d in tried])
    np.testing.assert_allclose(np.diff(found), np.diff([dense(d) for d in tried]), rtol=1e-8)


def test_what_no_drawing_has_is_learned(tmp_path: Path) -> None:
    drawn = ctr()
    truth = replace(drawn, tubes=tuple(map(wavy, drawn.tubes)))
    data, options = recorded(truth, 70, 1), FitOptions(folds=5)
    names = ["curvature_1", "curvature_2", "rotation_2"]
    without, found = (fit(drawn, data, [*names, *more], options) for more in ([], ["learned_curvature_all"]))
    assert without.held_out is not None
    assert found.held_out is not None
    assert found.held_out.rms < 0.25 * without.held_out.rms
    assert found.held_out_inside is not None
    assert found.held_out_inside > 0.85
    # Where the data tell the shape it is that of the truth, with the mean about x and the turn that it implies.
    setup, tube = Setup.of(found.robot), truth.tubes[0]
    s = np.linspace(0, tube.curved_length, 400)
    true = np.array([[at(q, x) for x in s] for q in tube.pieces[0].precurvature[:2]])
    learned = [q(s) for q in found.robot.tubes[0].pieces[0].precurvature[:2]]
    assert np.abs(learned[0] - true[0]).mean() < 0.5 * np.abs(true[0] - true[0].mean()).mean()
    assert setup.learned.any()
    # An ordinary robot: its file is all that margin and certificate need.
    found.robot.save(tmp_path / "robot.yaml")
    again = load_robot(tmp_path / "robot.yaml")
    assert snap_free_certificate(again) == pytest.approx(snap_free_certificate(found.robot), abs=1e-6)
    assert abs(snap_free_certificate(again) - snap_free_certificate(truth)) < 0.05
    assert validate(again, data).summary.rms == pytest.approx(found.after.summary.rms, rel=1e-4)
    reals = real_robots(again)
    assert reals is not None
    assert sum(p.kind == "learned_curvature" for p in reals.parameters) == 2 * MODES
    np.testing.assert_allclose(reals.values(np.zeros(reals.size))[:3], [p.start for p in reals.parameters][:3])


def test_nothing_is_learned_of_tubes_as_drawn() -> None:
    """The prior shrinks to 0, and what is learned is far below what the tips could show."""
    drawn = ctr()
    found = fit(drawn, recorded(drawn, 40, 2), ["curvature_1", "learned_curvature_all"], FitOptions(folds=0))
    learned = np.array([e.value for e in found.estimates if e.name.startswith("learned")])
    assert np.sqrt((learned**2).sum() / 2) < 0.1
    errors = np.array([e.posterior_error for e in found.estimates if e.name.startswith("learned")])
    assert (np.abs(learned) < 3.5 * errors).all()


def test_numbers_that_are_not_there_are_refused() -> None:
    data = turned(ctr(), 5)
    assert len(choose_parameters(ctr(), data, ["learned_curvature_all"])) == 2 * MODES == 4 * DEGREES
    with pytest.raises(InputError, match="the tube must be 1 to 2, the number 1 to 12"):
        choose_parameters(ctr(), data, ["learned_curvature_3_1"])
    with pytest.raises(InputError, match="'learned_curvature_1' is not known"):
        choose_parameters(ctr(), data, ["learned_curvature_1"])


def test_secants_explain_every_step_and_leave_other_directions() -> None:
    random = np.random.default_rng(5)
    slopes, metric = random.normal(size=(6, 3, 4)), np.array([1.0, 4.0, 0.5, 2.0])
    step, change = random.normal(size=4), random.normal(size=(6, 3))
    found = secant(slopes, step, change, metric)
    np.testing.assert_allclose(found @ step, change)
    across = np.linalg.svd((metric * step)[None])[2][1:]  # orthogonal to the step in the metric
    np.testing.assert_allclose(found @ across.T, slopes @ across.T)
