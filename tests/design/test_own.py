"""Own requirements and objectives do what built-in ones do: optimise, verify, relax, report."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from tests.design.tasks import equal_pair, snap_free_thesis, tightest, two_tubes
from tubeopt import (
    ConcentricRobot,
    DesignSolver,
    DesignTask,
    InputError,
    Load,
    forward_kinematics,
    optimize_design,
    snap_free_certificate,
)
from tubeopt.block.quantities import Expression, recorded
from tubeopt.bodies.obstacles import Sphere
from tubeopt.design import (
    CustomObjective,
    CustomRequirement,
    Free,
    InfeasibleDesignError,
    Length,
    Objective,
    Poses,
    Quantities,
    Reach,
    SnapFree,
    SnapFreeInUse,
    Target,
    Wall,
)
from tubeopt.design.evaluation import state_at
from tubeopt.design.objectives import aim
from tubeopt.design.parameters import design_space
from tubeopt.design.program import Program, compile_task
from tubeopt.design.verify import check_custom, numbers_of
from tubeopt.equilibrium.kinematics import sure_margin
from tubeopt.typing import Array

MM = 1e-3


@dataclass(frozen=True)
class Certified(CustomRequirement):
    """The certificate at home, as an own requirement."""

    limit: float
    description, size = "certificate at home", 0.1

    def expression(self, q: Quantities) -> Any:
        return q.certificate() - self.limit


@dataclass(frozen=True)
class Longest(CustomRequirement):
    """Length of all tubes."""

    limit: float
    description, unit, factor, size, is_upper_bound = "length of every tube", "mm", 1e3, 1e-2, True

    def expression(self, q: Quantities) -> Any:
        return self.limit - q.tubes["straight_length"] - q.tubes["curved_length"]


@dataclass(frozen=True)
class Height(CustomRequirement):
    """Height of the tip in every pose."""

    limit: float
    description, unit, factor, size = "height of the tips", "mm", 1e3, 1e-3

    def expression(self, q: Quantities) -> Any:
        return ca.vertcat(*(pose.tip_position[2] for pose in q.poses)) - self.limit


@dataclass(frozen=True)
class Changed(CustomObjective):
    """The built-in objective "change", of the curvatures of a robot."""

    curvature: tuple[float, ...]
    description = "change of the curvatures"

    def expression(self, q: Quantities) -> Any:
        return ca.sumsqr(q.tubes["curvature"] / ca.DM(self.curvature) - 1)


def everything(q: Quantities) -> Any:
    """All quantities that there are."""
    poses = [
        part
        for pose in q.poses
        for part in (
            pose.rotations, pose.translations, pose.tip_position, pose.tip_direction, pose.margin,
            pose.position(0.37), pose.position(0.93), pose.curvature(0.37), pose.curvature(0.93),
        )
    ]  # fmt: skip
    deflection = q.poses[1].deflection((0.03, 0.02, -0.01))
    return ca.vertcat(*q.tubes.values(), *poses, deflection, q.certificate(), q.certificate([-0.01] * q.n_tubes))


def posed_task() -> DesignTask:
    """A given pose and a free one of two tubes, all dimensions free."""
    fields = {"curvature": 30.0, "straight_length": 0.2, "curved_length": 0.2}
    free = [Free(name, (0, 1), 0.0, largest) for name, largest in fields.items()]
    free += [Free("outer_diameter", (0,), 0.9 * MM, 1.05 * MM), Free("inner_diameter", (1,), 1.06 * MM, 1.2 * MM)]
    poses = Poses(((0.0, 2.0),), ((-0.01, -0.005),))
    return DesignTask(two_tubes(), tuple(free), (poses, Reach((Target((0.02, -0.03, 0.11)),))))


def at(program: Program, expression: Expression, x: Array) -> tuple[Array, Array]:
    return expression.linear(state_at(program, x).quantity)


def test_strain_and_clearance_of_a_pose_and_their_slopes() -> None:
    task, ball = posed_task(), Sphere((0.0, -0.06, 0.09), 0.005)
    program = compile_task(task)

    def asked(q: Quantities) -> Any:
        return ca.vertcat(*(p for one in q.poses for p in (one.strain(0), one.strain(1), ca.mmin(one.clearance(ball)))))

    expression = recorded(asked, 2, 2, "strain and clearance")
    x = np.concatenate([program.layout.space.start, [0.3, 1.6, -0.11, -0.06]])
    value, slope = at(program, expression, x)
    state = state_at(program, x)
    robot = replace(task.robot, tubes=state.tubes)
    result = expression(numbers_of(robot, [forward_kinematics(robot, *state.joint_values(k)) for k in range(2)]))
    room = (value - result)[[0, 1, 3, 4]]
    # Where tubes end their strain is left out when it is looked at again, and the arm is held off by 20 um.
    assert (room >= -1e-9).all()
    assert (room <= 0.02 * value[[0, 1, 3, 4]]).all()
    assert ((value - result)[[2, 5]] < 0).all()
    assert ((value - result)[[2, 5]] > -2e-4).all()
    for j, size in enumerate(1e-6 * program.scale):
        step = size * np.eye(len(x))[j]
        change = (at(program, expression, x + step)[0] - at(program, expression, x - step)[0]) / (2 * size)
        assert slope[:, j] * program.scale[j] == pytest.approx(change * program.scale[j], rel=1e-4, abs=1e-6)


def test_quantities_are_those_of_solved_equilibria_and_their_slopes_those_of_differences() -> None:
    task = posed_task()
    program = compile_task(task)
    expression = recorded(everything, 2, 2, "everything")
    x = np.concatenate([program.layout.space.start, [0.3, 1.6, -0.11, -0.06]])
    value, slope = at(program, expression, x)
    state = state_at(program, x)
    robot = replace(task.robot, tubes=state.tubes)
    equilibria = [forward_kinematics(robot, *state.joint_values(k)) for k in range(2)]
    assert value == pytest.approx(expression(numbers_of(robot, equilibria)), rel=1e-6, abs=2e-8)
    for j, size in enumerate(1e-6 * program.scale):
        step = size * np.eye(len(x))[j]
        change = (at(program, expression, x + step)[0] - at(program, expression, x - step)[0]) / (2 * size)
        assert slope[:, j] * program.scale[j] == pytest.approx(change * program.scale[j], rel=1e-4, abs=1e-5)


def test_own_requirement_and_objective_give_the_optimum_of_the_built_in_ones() -> None:
    built_in = optimize_design(snap_free_thesis(0.05), turns=0)
    change = Changed(tuple(tube.curvature for tube in built_in.task.robot.tubes))
    task = replace(built_in.task, requirements=(Certified(0.05),), objective=change)
    design = optimize_design(task, turns=0)
    for tube, other in zip(design.robot.tubes, built_in.robot.tubes, strict=True):
        assert tube.curvature == pytest.approx(other.curvature, rel=1e-6)
    assert design.objective == pytest.approx(built_in.objective, rel=1e-6)
    assert design.objectives == {"change of the curvatures": design.objective}
    sentences = [one.sensitivities[0].sentence for one in (design, built_in)]
    assert sentences[0] == sentences[1].replace("certified margin", "certificate at home").replace(
        "robot", "curvatures"
    )
    assert any(check.what == "certificate at home" and check.satisfied for check in design.verification.checks)


def test_a_small_number_is_minimised_as_exactly_as_any_other() -> None:
    """The metal of two tubes is 1e-7 m^3 of SI: a thinner wall than the least is not left on the table."""

    @dataclass(frozen=True)
    class Metal(CustomObjective):
        description, unit, factor = "metal of all tubes", "mm3", 1e9

        def expression(self, q: Quantities) -> Any:
            od, bore, length = (q.tubes[name] for name in ("outer_diameter", "inner_diameter", "straight_length"))
            return ca.dot(np.pi / 4 * (od**2 - bore**2), length + q.tubes["curved_length"])

    free = (Free("outer_diameter", (0, 1), 0.9 * MM, 1.6 * MM), Free("curved_length", (0, 1), 0.05, 0.09))
    design = optimize_design(DesignTask(two_tubes(), free, (Wall(0.1 * MM),), Metal(), ordered=False), turns=0)
    for tube, bore in zip(design.robot.tubes, (0.8, 1.1), strict=True):
        assert tube.outer_diameter == pytest.approx((bore + 0.2) * MM, rel=1e-5)
        assert tube.curved_length == pytest.approx(0.05, rel=1e-5)


def test_own_requirement_on_poses_is_kept_and_verified() -> None:
    reach = Reach((Target((0.02, -0.03, 0.11), 5e-3), Target((0.0, -0.03, 0.11), 5e-3)))
    free = (Free("curvature", (0, 1), 5.0, 25.0),)
    few = DesignSolver(poses=64, iterations=40)
    task = DesignTask(two_tubes(), free, (SnapFree(0.1), reach, Height(0.113)), Objective("change"), solver=few)
    design = optimize_design(task, turns=0)
    assert min(e.tip_position[2] for e in design.equilibria) >= 0.113 - 1e-8
    without = optimize_design(replace(task, requirements=task.requirements[:2]), turns=0)
    assert min(e.tip_position[2] for e in without.equilibria) < 0.113
    check = check_custom(Height(0.113), without.robot, without.equilibria)
    assert not check.satisfied
    assert check.value == f"{min(1e3 * e.tip_position[2] for e in without.equilibria):.6g} mm"
    assert check.what == "height of the tips"


def test_infeasible_own_requirement_is_relaxed_in_words() -> None:
    task = DesignTask(
        two_tubes(), (Free("curved_length", (0,), 0.07, 0.1),), (Longest(0.15),), Objective("length"), ordered=False
    )
    with pytest.raises(InfeasibleDesignError) as caught:
        optimize_design(task)
    assert "length of every tube must rise from 150 mm to 190 mm" in str(caught.value)
    assert caught.value.relaxations[0].task.requirements == (Longest(0.19),)
    assert optimize_design(caught.value.relaxations[0].task).objective == pytest.approx(0.19, abs=1e-8)


class Fixed(CustomRequirement):
    """A certificate that may not be eased: it has no field `limit`."""

    description, limit, size = "fixed certificate", 0.5, 0.1

    def expression(self, q: Quantities) -> Any:
        return q.certificate() - self.limit


def test_what_cannot_be_relaxed_is_kept_while_the_rest_is() -> None:
    pair = equal_pair(0.1, 0.05)
    free = (Free("curvature", (0, 1), 1.0, 30.0, "equal"),)
    task = DesignTask(pair, free, (Fixed(), Length("length", 0, 0.12)), Objective("tip_curvature"))
    with pytest.raises(InfeasibleDesignError) as caught:
        optimize_design(task)
    (path,) = caught.value.relaxations
    assert [change.limit.description for change in path.changes] == ["overall length of tube 1"]
    solution = optimize_design(path.task)
    assert snap_free_certificate(solution.robot) == pytest.approx(0.5, abs=1e-4)
    assert solution.objective == pytest.approx(optimize_design(tightest(pair, 0.5, 30.0), turns=0).objective, rel=1e-4)


@dataclass(frozen=True)
class Odd(CustomRequirement):
    """An own requirement of which something is wrong."""

    name: str
    description = "odd"

    def expression(self, q: Quantities) -> Any:
        match self.name:
            case "pose":
                return q.poses[3].margin
            case "tubes":
                return q.tubes["colour"]
            case "fraction":
                return q.poses[0].position(1.5)
            case "certificate":
                return q.certificate([0.0])
            case _:
                return 1.0


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("pose", "expression of odd refers"),
        ("tubes", "tubes have no 'colour'"),
        ("number", "the expression of odd is 1.0; it must be an expression"),
        ("fraction", "fraction is 1.5; it"),
        ("certificate", "translations of a certificate"),
    ],
)
def test_what_makes_no_sense_is_refused(name: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        optimize_design(replace(posed_task(), requirements=(*posed_task().requirements, Odd(name))))


class Nameless(CustomObjective):
    """It does not say what it is."""

    def expression(self, q: Quantities) -> Any:
        return q.certificate()


def test_own_objective_says_what_it_is() -> None:
    with pytest.raises(InputError, match="description of Nameless is ''"):
        replace(posed_task(), objective=Nameless())


def farthest(robot: ConcentricRobot, poses: Poses, force: tuple[float, float, float]) -> float:
    """How far a force moves the tip at most, m."""
    moved = []
    for joints in zip(poses.rotations, poses.translations, strict=True):
        tips = [forward_kinematics(robot, *joints, load=load).tip_position for load in (None, Load(force))]
        moved.append(float(np.linalg.norm(tips[1] - tips[0])))
    return max(moved)


def test_a_design_that_a_payload_moves_least() -> None:
    poses, force = Poses(((0.0, 2.0), (0.5, -1.0)), ((-0.01, -0.005), (-0.03, -0.02))), (0.02, 0.0, -0.01)
    free = (Free("curvature", (0, 1), 1.0, 20.0), Free("curved_length", (1,), 0.05, 0.079))
    task = DesignTask(two_tubes(), free, (poses, SnapFreeInUse(0.3, paths=False)), aim_under(force))
    solution = optimize_design(task, turns=0)
    smallest = farthest(solution.robot, poses, force)
    assert solution.objectives["tip_deflection"] == pytest.approx(smallest, rel=1e-5)
    assert smallest < 0.8 * farthest(task.robot, poses, force)
    # What binds are bounds: at each of them the price is how the objective changes with what is bounded.
    price = next(
        one for one in solution.sensitivities if one.limit.description == "upper bound of the curvature of tube 2"
    )
    sides = []
    for step in (0.05, -0.05):
        tubes = list(solution.robot.tubes)
        tubes[1] = replace(tubes[1], curvature=tubes[1].curvature + step)
        sides.append(farthest(replace(solution.robot, tubes=tuple(tubes)), poses, force))
    assert price.derivative == pytest.approx((sides[0] - sides[1]) / 0.1, rel=1e-2)
    with pytest.raises(InputError, match="objective tip_deflection needs task poses"):
        DesignTask(two_tubes(), free, (SnapFree(0.1),), aim_under(force))


TWISTED = Load(moment=(0.001, 0.002, -0.001))


@dataclass(frozen=True)
class SureUnder(CustomRequirement):
    """Every pose keeps a margin under a load."""

    limit: float
    description = "margin under the load"

    def expression(self, q: Quantities) -> Any:
        return q.poses[0].margin_under(TWISTED) - self.limit


def test_a_design_that_a_moment_moves_least_and_softens_no_further() -> None:
    """Alone it would take as much curvature as it may, and be softer."""
    poses = Poses(((0.5, 2.6),), ((-0.01, -0.005),))
    free = (Free("curvature", (0, 1), 1.0, 20.0), Free("curved_length", (1,), 0.05, 0.079))
    aim = Objective("tip_deflection", tip_moment=TWISTED.moment)
    moved, sure = [], []
    for own in ((), (SureUnder(0.9),)):
        solution = optimize_design(DesignTask(two_tubes(), free, (poses, *own), aim), turns=0)
        plain, pushed = (
            forward_kinematics(solution.robot, poses.rotations[0], poses.translations[0], load=each)
            for each in (None, TWISTED)
        )
        moved.append(float(np.linalg.norm(pushed.tip_position - plain.tip_position)))
        sure.append(sure_margin(pushed))
        assert solution.objectives["tip_deflection"] == pytest.approx(moved[-1], rel=1e-5)
    assert sure[1] >= 0.9 - 1e-6
    assert sure[0] < 0.9 or moved[0] == pytest.approx(moved[1], rel=1e-4)
    assert moved[0] <= moved[1] * (1 + 1e-6)


def aim_under(force: tuple[float, float, float]) -> Objective:
    return Objective("tip_deflection", tip_force=force)


@dataclass(frozen=True)
class Strained(CustomRequirement):
    limit: float
    description, unit, factor, size, is_upper_bound = "strain of all pieces", "%", 1e2, 1e-3, True

    def expression(self, q: Quantities) -> Any:
        return self.limit - ca.vertcat(*(q.straightened_strain(i) for i in range(q.n_tubes)))


def test_strain_held_straight_is_a_quantity_of_own_requirements() -> None:
    """r kappa / (1 - r kappa) <= e is kappa <= e / (r (1 + e))."""
    free = Free("curvature", (0, 1), 0.5, 15.0)
    solution = optimize_design(DesignTask(two_tubes(), [free], [Strained(0.003)], Objective("change")), turns=0)
    largest = [0.003 / (tube.outer_diameter / 2 * 1.003) for tube in two_tubes().tubes]
    assert [tube.curvature for tube in solution.robot.tubes] == pytest.approx(largest, rel=1e-6)
    assert solution.verification.satisfied


def test_the_stiffness_against_a_small_force_is_that_of_the_unloaded_arm() -> None:
    robot, force = two_tubes(), np.array([1e-3, -2e-3, 5e-4])
    e = forward_kinematics(robot, [0.0, 2.0], [-0.01, -0.005])
    straight = [Free("straight_length", (0,), 0.1, 0.2)]
    expression = aim(Objective("tip_stiffness", tip_force=tuple(force)), design_space(robot, straight), (0,), (), None)
    assert expression is not None
    result = expression(numbers_of(robot, [e]))[0]
    assert result == pytest.approx(force @ force / (force @ e.compliance[:3, :3] @ force), rel=1e-2)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"kind": "tip_stiffness"}, "tip_force is required for the objectives tip_deflection and tip_stiffness"),
        ({"kind": "length", "tip_force": (0.1, 0, 0)}, "tip_force is required for the objectives"),
        ({"kind": "tip_deflection", "tip_force": (0, 0, 0)}, "tip_force of the objective is 0; it must not be 0"),
        ({"kind": "tip_deflection", "tip_moment": (0, 0, 0)}, "tip_moment of the objective is 0; it must not be 0"),
        ({"kind": "length", "tip_moment": (0, 0, 1)}, "tip_moment is allowed for the objective tip_deflection"),
    ],
)
def test_a_tip_force_belongs_to_what_is_told_under_it(given: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Objective(**given)
