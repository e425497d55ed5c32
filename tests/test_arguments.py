"""Arguments of a wrong type: every public function and constructor works, or says in a sentence what it takes."""

from __future__ import annotations

import inspect
import re
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

import tubeopt
from tests.examples import THESIS, TWO_TUBE
from tests.public_calls import CALLS, CONSTRUCTORS, ONE, PAIR, home, wrong_values
from tubeopt import InputError, SolveError
from tubeopt.arguments import typed
from tubeopt.control.command import Command
from tubeopt.control.servo import Servo
from tubeopt.inverse.mirror import mirror_inverse, mirror_pose, mirror_to_tip
from tubeopt.solvers.time_limit import OutOfTimeError, within

HOLDING_ITSELF: list[Any] = []
HOLDING_ITSELF.append(HOLDING_ITSELF)

ENOUGH = 0.02
"""s; what is not refused by then was not refused for its type."""


GIGAPASCALS, STEEL = tubeopt.Material("nitinol", 58, 21.5), tubeopt.Material("steel 304", 58e9, 21.5e9)


def _robot(*tube: Any) -> tubeopt.ConcentricRobot:
    return tubeopt.ConcentricRobot((tubeopt.Tube(*tube),))


@pytest.mark.parametrize("name", CALLS)
@pytest.mark.filterwarnings("ignore")
def test_a_wrong_type_is_refused_in_a_sentence(name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)  # a text may be a path to which something is saved
    function, inputs = CALLS[name]
    raw = []
    for parameter in inspect.signature(function).parameters.values():
        if parameter.kind in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL):
            continue
        for label, value in wrong_values(parameter, inputs):
            try:
                with within(ENOUGH):
                    function(**{**inputs(), parameter.name: value})
            except (InputError, SolveError, OutOfTimeError, OSError):
                pass
            except Exception as error:  # any other kind is the fault that is looked for
                raw.append(f"{parameter.name} as {label}: {type(error).__name__}: {error}")
    assert not raw, "\n".join(raw)


@pytest.mark.parametrize("name", [name for names in CONSTRUCTORS.values() for name in names.split()])
@pytest.mark.filterwarnings("ignore")
def test_a_constructor_refuses_what_nothing_could_be_done_with(name: str) -> None:
    function, inputs = CALLS[name]
    for parameter in inspect.signature(function).parameters.values():
        if parameter.kind is not parameter.VAR_KEYWORD:
            with pytest.raises(InputError):
                function(**{**inputs(), parameter.name: object()})


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: tubeopt.TipGoal("a"), "position of the goal is 'a'; it must be 3 numbers"),
        (lambda: tubeopt.TipGoal([[0, 0, 0.1], [0, 0, float("nan")]]), "position of the goal .* finite x, y, z in m"),
        (lambda: tubeopt.TipGoal([0, 0, 0.1], [0, 0, 0]), "direction of the goal is .0, 0, 0.; it must have"),
        (lambda: tubeopt.Problem(3), "name is 3; it must be a str"),
        (lambda: tubeopt.Discretisation("gaus"), "family is 'gaus'; it must be one of gauss, radau"),
        (lambda: Command(joints="home"), "joints is 'home'; it must be a pair"),
    ],
)
def test_nothing_is_refused_late_that_can_be_refused_at_once(call: object, words: str) -> None:
    with pytest.raises(InputError, match=words):
        call()  # type: ignore[operator]


def test_every_public_function_is_among_them() -> None:
    functions = {name for name in tubeopt.__all__ if inspect.isfunction(getattr(tubeopt, name))}
    left = {
        "sweep",
        "show_in_3d",
        "to_dataframe",
        "to_xarray",
        "plan_heating",
        "predict_tube",
        "save_rig",
        "design_feedback",
    }
    assert functions - set(CALLS) <= left


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: tubeopt.EccentricRobot((ONE, ONE)), "tube is .*; it must be a Tube"),
        (lambda: tubeopt.ConcentricRobot(ONE), "tubes is .*; it must be a list of tubes"),
        (lambda: tubeopt.friction_band(PAIR, home()), "equilibrium is .*; it must be an Equilibrium"),
        (lambda: mirror_inverse(PAIR, 0.1, 3.0), "robot is .*; it must be an EccentricRobot"),
        (lambda: mirror_to_tip(PAIR, (0.0, 0.0, 0.1)), "robot is .*; it must be an EccentricRobot"),
        (lambda: mirror_pose(PAIR, (0.0, 0.0, 0.1)), "robot is .*; it must be an EccentricRobot"),
        (lambda: tubeopt.find_snap(PAIR, 3, ([0, 0], None)), "start is .*; it must be a pair"),
        (lambda: tubeopt.find_equilibria("robot.yaml", [0, 0]), "robot is 'robot.yaml'; it must be a robot"),
        (
            lambda: tubeopt.forward_kinematics(PAIR, [True, False]),
            "rotations is .*; it must be 2 numbers",
        ),
        (lambda: tubeopt.forward_kinematics(PAIR, ["0", "1"]), r"rotations is .*; it must be 2 numbers"),
        (lambda: tubeopt.Tube(True, 0.0, 0.1, 0.1, 0.0), "outer_diameter is True; it must be a number"),
    ],
)
def test_the_sentence_names_the_argument_and_what_it_takes(call: object, words: str) -> None:
    with pytest.raises(InputError, match=words):
        call()  # type: ignore[operator]


def test_checks_follow_from_annotations() -> None:
    @typed
    def asked(a: float, b: ArrayLike | None = None, *, c: tuple[int, ...] = (), d: str = "", e: bool = False) -> float:
        return a

    assert asked(np.float64(2.0), [[1, 2], [3, 4]], d="x", e=np.True_) == 2.0
    assert asked(3, np.arange(3)) == 3
    for inputs in ({"a": True}, {"a": "1"}, {"a": 1j}):
        with pytest.raises(InputError, match=f"{list(inputs)[-1]} is .*; it must be"):
            asked(**inputs)  # type: ignore[arg-type]
    for inputs in ({"d": 3}, {"e": 1}):
        with pytest.raises(InputError, match=f"{next(iter(inputs))} is .*; it must be"):
            asked(1.0, **inputs)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="unexpected keyword"):
        asked(1.0, f=3)  # type: ignore[call-arg]

    @typed
    @dataclass(frozen=True)
    class Kept:
        size: float
        name: str | None = None

    assert Kept(1.0).name is None
    with pytest.raises(InputError, match=r"size is 'a'; it must be a number"):
        Kept("a")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (
            lambda: tubeopt.forward_kinematics(PAIR, [0, 90]),
            "rotations has 90 rad, .* 14.3 turns; .*: was 90 deg meant",
        ),
        (lambda: _robot(1e-3, 0.8e-3, 50, 0.05, 8.0), "straight_length is 50 m; .*: was 50 mm meant"),
        (lambda: _robot(1e-3, 0.8e-3, 0.05, 0.05, 600.0), "curvature is 600 per m, which strains .* by 42.9 %"),
        (
            lambda: _robot(1e-3, 0.8e-3, 0.05, 0.05, 8.0, GIGAPASCALS),
            "youngs_modulus .* is 58 Pa; .*: was 58 GPa meant",
        ),
        (
            lambda: _robot(1e-3, 0.8e-3, 0.05, 0.05, 8.0, STEEL),
            "youngs_modulus .* is 5.8e.10 Pa; usual is 1.5e.11",
        ),
    ],
)
def test_what_is_implausible_is_warned_of(call: object, words: str) -> None:
    with pytest.warns(tubeopt.errors.ImplausibleWarning, match=words):
        call()  # type: ignore[operator]


def test_a_load_in_mN_is_warned_of_or_refused() -> None:
    stiffness = sum(tube.bending_stiffness for tube in PAIR.tubes)
    length = float(tubeopt.forward_kinematics(PAIR, [0, 0]).arc_length[-1])
    large = 25 * stiffness / length**2
    with pytest.warns(tubeopt.errors.ImplausibleWarning, match="tip force of the load has .* mN meant"):
        tubeopt.forward_kinematics(PAIR, [0, 0], load=tubeopt.Load((0, 0, large)))  # a pull is soon solved
    for load, text in (
        (tubeopt.Load((0, 1e300, 0)), r"tip force of the load has 1e\+300 N; on this arm it must be at most .* N: was"),
        (tubeopt.Load(moment=(50.0, 0, 0)), "tip moment of the load has 50 N m; .* was 50 mN m meant"),
        (tubeopt.Load(points=((0.01, (0, 0, 0), (0, 50.0, 0)),)), r"moment of points\[0\] of the load has 50 N m"),
    ):
        with pytest.raises(InputError, match=text):
            tubeopt.forward_kinematics(PAIR, [0, 0], load=load)


FAR = [50.0, 30.0, 190.0]
"""m; mm were meant."""


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: tubeopt.inverse_kinematics(PAIR, FAR), "position"),
        (lambda: tubeopt.IkSession(PAIR).solve(FAR), "position"),
        (lambda: tubeopt.plan_trajectory(PAIR, home(), FAR), "goal"),
        (lambda: tubeopt.plan_trajectory(PAIR, home(), tubeopt.TipGoal([[0, 0, 0.1], FAR])), "goal in row 2"),
        (lambda: tubeopt.plan_from_region(PAIR, home(), FAR, tubeopt.EntryRegion(1e-3)), "goal"),
        (lambda: tubeopt.follow_the_leader(PAIR, FAR), "goal"),
        (lambda: tubeopt.follow_tip_path(PAIR, [FAR, [50.0, 30.0, 190.01]]), "path in row 2"),
        (lambda: tubeopt.evaluate_reach(PAIR, home(), [[0, 0, 0.1], FAR]), "targets in row 2"),
        (lambda: tubeopt.estimate_force(PAIR, [0, 0], tip_position=FAR), "what is measured in row 1"),
        (lambda: Servo(PAIR, ([0, 0], None)).step(Command(position=FAR), 1e-3), "position"),
        (lambda: Servo(PAIR, ([0, 0], None)).step(Command(pivot=FAR), 1e-3), "pivot"),
    ],
)
def test_a_place_in_mm_is_refused(call: Any, name: str) -> None:
    text = (
        f"{name} is 50, 30, 190.* m, 198.[78] m from the plate, and the longest tube is 0.11 m long; .* at most 1.1 m"
    )
    with pytest.raises(InputError, match=text):
        call()


def test_a_place_out_of_reach_is_no_wrong_input() -> None:
    with pytest.raises(SolveError, match="beyond the longest arm"):
        tubeopt.inverse_kinematics(PAIR, [0.0, 0.0, 0.5])


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(InputError, match=r"translation of tube 2 is -60 m, and the tube is 0\.06 m long"):
        tubeopt.forward_kinematics(PAIR, [0, 0], [0, -60])
    with pytest.raises(InputError, match="translation of tube 1 is -20 m"):
        tubeopt.find_equilibria(PAIR, [0, 0], [-20, 0])
    with pytest.raises(InputError, match="translation of tube 1 is -20 m"):
        tubeopt.forward_kinematics_batch(PAIR, [[0, 0]], [[-20, 0]])
    limits = tubeopt.JointLimits(((-1, 1), (-1, 1)), ((-60, 0), (-60, 0)))
    with pytest.raises(InputError, match="limits of the translation of tube 1 are -60 to 0 m"):
        tubeopt.ConcentricRobot(PAIR.tubes, joint_limits=limits)


def test_given_stiffnesses_and_closed_forms_are_not_warned_of() -> None:
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        rod = tubeopt.Tube(1.0, 0.0, 0.0, 1.0, 0.0, bending_stiffness=1.0, torsional_stiffness=0.8)
        tubeopt.forward_kinematics(tubeopt.ConcentricRobot((rod,)), [0.0], load=tubeopt.Load((0.5, 0.0, 0.0)))
        _robot(1e-3, 0.5e-3, 1.0, 1.0, 1.0)
        tubeopt.forward_kinematics(PAIR, [0.0, 4 * np.pi])
    assert not warned


@pytest.mark.parametrize("rotations", [[0, 1j, 2], np.array([0, 1j, 2])])
def test_complex_joint_values_are_refused(rotations: object) -> None:
    with pytest.raises(InputError, match="rotations"):
        tubeopt.forward_kinematics(THESIS, rotations)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: tubeopt.RateLimits(translation={}), "translation of the rate limits is {}"),
        (
            lambda: tubeopt.RateLimits(translation_acceleration=frozenset()),
            "is empty; it must have at least",
        ),
        (lambda: tubeopt.Tube(1e308, 0.8e-3, 0.1, 0.1, 2.0), "outer_diameter is 1e"),
        (lambda: tubeopt.forward_kinematics(TWO_TUBE, HOLDING_ITSELF), "rotations is"),
        (lambda: tubeopt.find_equilibria(TWO_TUBE, [0.0, 0.0], time_limit=10**400), "time_limit is"),
        (lambda: tubeopt.evaluate_reach(TWO_TUBE, ([0.0, 0.0], None), [[0, 0, 0.1]], count=10**400), "a whole number"),
    ],
)
def test_numbers_that_are_none_are_refused(call: Callable[[], object], words: str) -> None:
    """Empty tables, integers that no float holds, and lists that hold themselves ended in errors of Python."""
    with pytest.raises(InputError, match=re.escape(words)):
        call()
