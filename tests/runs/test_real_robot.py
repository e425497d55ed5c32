"""Designs that the real robot keeps, against robots that are drawn and solved."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.command_line import Run, answer, refused
from tubeopt import ConcentricRobot, SolveError, Tube, forward_kinematics, snap_free_certificate
from tubeopt.bodies.obstacles import scene_of
from tubeopt.design import Avoid
from tubeopt.design.requirements import of_kind
from tubeopt.equilibrium.arm_surface import ArmSurface
from tubeopt.files.yaml_file import to_yaml
from tubeopt.robots.calibration import Posterior
from tubeopt.runs.design_study import DesignAnswer, DesignStudy
from tubeopt.runs.real_robot import Judged, Reserve, kept_by_real_robot
from tubeopt.runs.study_file import load_study
from tubeopt.validation import real_robots

MM = 1e-3
DRAWN = 400

ANYWHERE = {"snap_free": {"margin": 0.2}}
IN_USE = {
    "snap_free_in_use": {"margin": 0.3, "paths": False},
    "poses": [{"rotations_deg": [180, 0], "translations_mm": [0, 0]}],
}


def known(misfit: float = 0.1 * MM) -> ConcentricRobot:
    """Two tubes whose curvatures, stiffness and zero are known to a few percent."""
    tubes = (
        Tube(1.0 * MM, 0.8 * MM, 60 * MM, 110 * MM, 12.0),
        Tube(1.3 * MM, 1.05 * MM, 50 * MM, 70 * MM, 10.0),
    )
    names, units = ["rotation_2", "curvature_1", "curvature_2", "torsional_stiffness_1"], ["rad", "1/m", "1/m", ""]
    covariance = np.diag(np.square([0.03, 0.3, 0.2, 0.03]))
    return ConcentricRobot(tubes, posterior=Posterior.of(names, units, covariance, misfit, 0.1 * MM))


def study(folder: Path, robot: ConcentricRobot, **keys: object) -> Path:
    """A design study of curvatures that changes them least."""
    robot.save(folder / "robot.yaml")
    question = {
        "kind": "design", "robot": "robot.yaml", "objective": {"kind": "change"},
        "free": [{"tubes": [1, 2], "curvature_per_m": [1, 20]}], "requirements": ANYWHERE,
    }  # fmt: skip
    (folder / "design.yaml").write_text(to_yaml(question | keys, "A design. Source: a test."))
    return folder / "design.yaml"


def designed(path: Path) -> DesignAnswer:
    """Answer of a design study."""
    loaded = load_study(path)
    assert isinstance(loaded, DesignStudy)
    return loaded.run()


def kept(found: DesignAnswer) -> float:
    """Fraction of drawn robots with the certificate, or with the margin at the pose."""
    reals, home = real_robots(found.solution.robot), np.zeros(2)
    assert reals is not None
    numbers = np.random.default_rng(0).normal(size=(DRAWN, reals.size))
    if not found.solution.equilibria:
        drawn = [reals.at(z, home, home) for z in numbers]
        return float(np.mean([snap_free_certificate(each.robot, each.translations) >= 0.2 for each in drawn]))
    (pose,) = found.solution.equilibria
    joints = pose.rotations, pose.translations
    return float(np.mean([forward_kinematics(*reals.at(z, *joints)).margin >= 0.3 for z in numbers]))


@pytest.mark.parametrize(("name", "requirements", "least"), [("certificate", ANYWHERE, 0.2), ("margin", IN_USE, 0.3)])
def test_designs_keep_their_requirements_in_as_many_robots_as_told(
    tmp_path: Path, name: str, requirements: dict[str, object], least: float
) -> None:
    """Without a confidence half of the robots that may be miss what binds; with 95 % one in twenty does."""
    plain = designed(study(tmp_path, known(), requirements=requirements))
    likely = designed(study(tmp_path, known(), requirements=requirements, confidence=0.95))
    sure = designed(study(tmp_path, known(), requirements=requirements, confidence=0.999))
    told, bound = (getattr(each.real, name) for each in (plain, sure))
    assert told[1] < told[0] < least <= bound[0] < least + 0.05
    assert 0.3 < kept(plain) < 0.7
    assert 0.93 <= kept(likely) < 1.0
    assert kept(sure) >= 1 - 2 / DRAWN
    changes = [each.solution.objective for each in (plain, likely, sure)]
    assert changes == sorted(changes)


def test_the_real_tip_and_arm_keep_tolerance_and_clearance(tmp_path: Path) -> None:
    """A target beside a ball: the design with a confidence keeps farther away, and comes closer to the target."""
    robot = known()
    x, y, z = (1e3 * forward_kinematics(robot, np.array([1.0, 0.0])).tip_position).tolist()
    ball = {"kind": "sphere", "centre_mm": [x, y, z + 13], "radius_mm": 10}
    wanted = {
        "reach": [{"position_mm": [x, y, z + 4], "tolerance_mm": 12}],
        "avoid": {"obstacles": [ball], "clearance_mm": 0.5},
    }
    plain = designed(study(tmp_path, robot, requirements=wanted))
    sure = designed(study(tmp_path, robot, requirements=wanted, confidence=0.99))
    assert plain.real is not None
    assert sure.real is not None
    assert sure.real.clearance is not None
    assert sure.real.over[0] <= 0
    assert sure.real.clearance[0] >= 0.5 * MM - 1e-9
    reals, pose = real_robots(sure.solution.robot), sure.solution.equilibria[0]
    assert reals is not None
    (avoid,), missed = of_kind(sure.solution.task.requirements, Avoid), 0
    random = np.random.default_rng(1)
    for draw in random.normal(size=(DRAWN, reals.size)):
        real = forward_kinematics(*reals.at(draw, pose.rotations, pose.translations))
        apart = np.linalg.norm(real.tip_position + random.normal(0, 0.1 * MM, 3) - np.array([x, y, z + 4]) * MM)
        missed += int(apart > 12 * MM or ArmSurface(real).clearance(scene_of(avoid.obstacles)) < 0.5 * MM)
    assert missed <= 0.02 * DRAWN


def test_a_target_that_the_real_tip_cannot_be_known_to_reach_is_named(run: Run, tmp_path: Path) -> None:
    wanted = {"reach": [{"position_mm": [5, -60, 120], "tolerance_mm": 1}]}
    path = study(tmp_path, known(2 * MM), requirements=wanted, confidence=0.999)
    outcome = run("design", str(path))
    assert outcome.code == 3
    assert "with 99.9 % the real robot has a tip" in outcome.err
    assert "the tolerance of a target, 1 mm, leaves none" in outcome.err


def test_a_confidence_needs_a_posterior_and_a_plain_objective(run: Run, tmp_path: Path) -> None:
    path = study(tmp_path, replace(known(), posterior=None), confidence=0.95)
    (message,) = refused(run("design", str(path)))
    assert "the robot has no posterior" in message
    path = study(tmp_path, known(), confidence=0.95, pareto_margins=[0.1])
    (message,) = refused(run("design", str(path)))
    assert "supports neither" in message
    forced = {"snap_free": {"margin": 0.1, "max_tip_force_mN": 10}}
    path = study(tmp_path, known(), confidence=0.95, requirements=forced)
    (message,) = refused(run("design", str(path)))
    assert "max_tip_force_mN" in message
    data = answer(run("design", str(study(tmp_path, known())), "--json"))
    assert data["real_certificate"][1] < data["real_certificate"][0] < data["certificate"]


def test_what_is_lacking_is_required_in_addition() -> None:
    """A bound that is half a unit below what is required of the calibrated robot."""

    def answer_with(reserve: Reserve) -> Judged[float]:
        real = reserve.margin - 0.5
        return Judged(real, ["too little"] if real < 0 else [], Reserve(margin=-real))

    assert kept_by_real_robot("answer", answer_with) == pytest.approx(0.15)
    with pytest.raises(SolveError, match=r"no answer was found that the real robot keeps: never") as failed:
        kept_by_real_robot("answer", lambda reserve: Judged(reserve.margin, ["never"], Reserve(margin=1.0)))
    assert failed.value.args
