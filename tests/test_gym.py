"""Environments of Gymnasium: layout, joints in order, equilibria on their branches, snaps, and what is drawn."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from tests.examples import CRL, THESIS
from tubeopt import InputError, find_snap, forward_kinematics, load_robot
from tubeopt.inverse.joints import joint_space
from tubeopt.solvers.compiled.library import compiler

gymnasium = pytest.importorskip("gymnasium")
pytestmark = pytest.mark.skipif(compiler() is None, reason="no C compiler")

from tubeopt.gym import CtrEnv, CtrVectorEnv, GymOptions  # noqa: E402  after gymnasium is known to be there

STRAIGHT = np.array([tube.straight_length for tube in THESIS.tubes])
LENGTH = np.array([tube.length for tube in THESIS.tubes])


@pytest.mark.parametrize("task", ["Reach", "Path"])
def test_gymnasium_finds_no_fault(task: str) -> None:
    from gymnasium.utils.env_checker import check_env

    check_env(gymnasium.make(f"tubeopt/{task}-v0", robot="crl_ctr", randomisation=0.05).unwrapped)


@pytest.mark.parametrize("representation", ["egocentric", "proprioceptive"])
def test_observation_has_the_layout_of_ctr_reach(representation: str) -> None:
    env = CtrEnv(THESIS, representation=representation)
    seen, _ = env.reset(seed=3)
    assert env.action_space.high == pytest.approx([1e-3] * 3 + [np.radians(5)] * 3)
    alpha, shift = env.many._arms.rotations[0], env.many._arms.translations[0]
    tip = forward_kinematics(THESIS, alpha, shift).tip_position
    goal = seen["desired_goal"]
    told = []
    for i in range(3):
        a, b = alpha[i], shift[i] - STRAIGHT[i]
        if representation == "egocentric" and i:
            a, b = a - alpha[i - 1], b - (shift[i - 1] - STRAIGHT[i - 1])
        told += [np.cos(a), np.sin(a), b]
    assert seen["observation"] == pytest.approx([*told, *(goal - tip), 1e-3], abs=1e-6)
    assert seen["achieved_goal"] == pytest.approx(tip, abs=1e-7)


def test_tubes_stay_in_order_as_those_of_ctr_reach() -> None:
    """Against the rule of CTR-Reach, tube by tube: an inner tube gives way."""
    many = CtrVectorEnv(THESIS, 6, repeats=3, shift=8e-3)
    many.reset(seed=0)
    low, high = (joint_space(THESIS).ranges[k, 3:] - STRAIGHT for k in (0, 1))
    for action in [many.action_space.sample() for _ in range(12)]:
        beta = many._arms.translations - STRAIGHT
        begins = many._over.copy()
        _, _, _, _, info = many.step(action)
        for _ in range(3):
            beta = np.clip(beta + action[:, :3], low, high)
            for i in (1, 2):
                beta[:, i - 1] = np.minimum(beta[:, i - 1], beta[:, i])
                beta[:, i - 1] = np.maximum(beta[:, i - 1], LENGTH[i] - LENGTH[i - 1] + beta[:, i])
        moved = ~begins & ~info["snap"]
        now = many._arms.translations - STRAIGHT
        # Where two tubes are at their limits at once, sweeps differ from one pass; all are in order.
        assert (np.diff(now, axis=1) >= -1e-9).all()
        assert (np.diff(now + LENGTH, axis=1) <= 1e-9).all()
        free = moved & (np.abs(beta - now).max(1) < 1e-9)
        assert free.sum() >= 0.5 * moved.sum()


def test_robots_follow_their_branches_and_snap_where_these_end() -> None:
    """Turned by 5 deg a step from home, the thesis' robot snaps where the continuation of the fold says."""
    home = np.zeros(3), np.array(THESIS.home_translations)
    snap = find_snap(THESIS, home, ([2 * np.pi, 0.0, 0.0], home[1]))
    assert snap is not None
    env = CtrEnv(THESIS, repeats=1, steps=500, tolerance=1e-6)
    env.reset(seed=0, options={"goal": [0.0, 0.0, 0.3]})
    env.many._arms.go(*(each[None] for each in home), np.ones(1, dtype=bool))
    env.many._q = np.array([joint_space(THESIS).join(*home)])
    arm, turns = forward_kinematics(THESIS, *home), 0
    while True:
        turns += 1
        seen, reward, terminated, _, info = env.step(np.array([0, 0, 0, np.radians(5), 0, 0], dtype=np.float32))
        if terminated:
            break
        arm = forward_kinematics(THESIS, [np.float32(np.radians(5)) * turns, 0.0, 0.0], home[1], start=arm)
        assert seen["achieved_goal"] == pytest.approx(arm.tip_position, abs=1e-7)
        assert info["margin"] == pytest.approx(arm.margin, abs=1e-6)
    assert info["snap"]
    assert (turns - 1) * np.radians(5) < snap.rotations[0] < turns * np.radians(5)
    assert reward == -1 - (500 - turns)


def test_goal_of_a_path_leads_from_the_tip_to_another_place() -> None:
    env = CtrEnv(CRL, task="path", steps=40, repeats=1)
    seen, info = env.reset(seed=2)
    assert info["error"] == pytest.approx(0, abs=1e-9)
    way = [seen["desired_goal"]]
    for k in range(40):
        seen, reward, terminated, truncated, info = env.step(np.zeros(6))
        way.append(seen["desired_goal"])
        assert not terminated
        assert truncated == (k == 39)
        assert reward == -float(info["error"] > 1e-3)
    assert np.linalg.norm(np.diff(way, axis=0), axis=1).max() < 0.02
    end = env.many._goals
    known = forward_kinematics(CRL, end.rotations[0], end.translations[0], start=forward_kinematics(
        CRL, env.many._arms.rotations[0], env.many._arms.translations[0]))  # fmt: skip
    assert way[-1] == pytest.approx(known.tip_position, abs=1e-6)


def test_drawn_robots_differ_and_come_again_with_their_seed() -> None:
    def tips(seed: int) -> np.ndarray:
        many = CtrVectorEnv(CRL, 8, randomisation=0.1)
        many.reset(seed=seed)
        joints = many._arms.rotations, many._arms.translations
        nominal = [forward_kinematics(CRL, *each).tip_position for each in zip(*joints, strict=True)]
        return np.linalg.norm(many._arms.tips - nominal, axis=1)

    off = tips(0)
    assert off == pytest.approx(tips(0), abs=0)
    assert (off > 1e-5).sum() >= 6
    assert off.max() < 0.05
    env = CtrVectorEnv(CRL, 1, randomisation=0.1)
    env.reset(seed=1)
    for _ in range(50):
        for given, drawn in zip(CRL.tubes, env._drawn().tubes, strict=True):
            for name in ("bending_stiffness", "torsional_stiffness", "curvature"):
                assert getattr(drawn, name) / (getattr(given, name) or 1) == pytest.approx(1, abs=0.1 + 1e-12)


def test_many_environments_begin_anew_one_by_one() -> None:
    many = CtrVectorEnv("two_tube", 5, steps=3, repeats=1, turn=1e-3)
    many.reset(seed=0)
    for k in range(9):
        _, reward, terminated, truncated, _ = many.step(np.zeros((5, 4)))
        assert truncated.all() == (k % 4 == 2)
        assert not terminated.any()
        assert (reward == (0.0 if k % 4 == 3 else -1.0)).all()


def test_robots_of_every_kind_are_environments() -> None:
    with pytest.raises(InputError, match="robot has 9 tubes and no compiled kernel; at most 6 tubes"):
        CtrVectorEnv("example_three_segment_etr")
    for name in ("thesis_etr", "example_pieces"):
        many = CtrVectorEnv(name, 2, repeats=1)
        seen, _ = many.reset(seed=0)
        many.action_space.seed(0)
        for _ in range(3):
            seen, *_ = many.step(many.action_space.sample())
            assert many.observation_space.contains(seen)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"task": "walk"}, "task is 'walk'"),
        ({"turn": 0.0}, "turn is 0; it must be greater than 0"),
        ({"turn": "5"}, "turn is '5'; it must be a number"),
        ({"shift": np.inf}, "shift is inf; it must be a finite number"),
        ({"steps": 0}, "steps is 0"),
        ({"steps": 2.5}, "steps is 2.5; it must be a whole number"),
        ({"randomisation": 1.0}, "randomisation is 1"),
        ({"representation": "polar"}, "representation is 'polar'"),
    ],
)
def test_wrong_options_are_named(fields: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=words):
        GymOptions(**fields)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"gaol": [0.0, 0.0, 0.1]}, "options have 'gaol'; only 'goal' is possible"),
        ({"goal": [0.0, 0.1]}, "goal"),
        ({"goal": [0.0, 0.0, 100.0]}, "goal is 0, 0, 100 m"),
    ],
)
def test_wrong_goals_are_named(options: dict[str, object], words: str) -> None:
    many = CtrVectorEnv("two_tube", 2)
    with pytest.raises(InputError, match=words):
        many.reset(options=options)


def test_actions_that_are_no_numbers_are_named() -> None:
    """Such a robot stood still and was rewarded like others, so that a diverged agent went unnoticed."""
    many = CtrVectorEnv("two_tube", 2)
    many.reset(seed=0)
    actions = many.action_space.sample()
    actions[1, 2] = np.nan
    with pytest.raises(InputError, match=r"actions\[1, 2\] is nan"):
        many.step(actions)
    with pytest.raises(InputError, match=r"shape \(2, 3\); it must be \(2, 4\)"):
        many.step(np.zeros((2, 3)))


def test_an_eccentric_robot_is_not_randomised() -> None:
    with pytest.raises(InputError, match="supports concentric robots only"):
        CtrVectorEnv(load_robot("thesis_etr"), 1, randomisation=0.1)


def test_missing_gymnasium_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    monkeypatch.delitem(sys.modules, "tubeopt.gym")
    with pytest.raises(InputError, match="gymnasium is missing"):
        __import__("tubeopt.gym")


@pytest.mark.parametrize(("robot", "fields"), [("thesis_ctr", {"repeats": 5}), ("crl_ctr", {"randomisation": 0.05})])
def test_side_by_side_robots_move_as_each_alone(robot: str, fields: dict[str, float]) -> None:
    """Lanes of the kernel against the kernel of one robot; snaps included."""
    together, alone = (CtrVectorEnv(robot, 40, turn=np.radians(8), **fields) for _ in range(2))
    alone._arms._abreast = alone._goals._abreast = None
    moved = 0
    for many in (together, alone):
        many.reset(seed=5)
    assert together._arms._abreast is not None
    for _ in range(6):
        action = together.action_space.sample()
        infos = [many.step(action)[4] for many in (together, alone)]
        assert (infos[0]["snap"] == infos[1]["snap"]).all()
        assert np.abs(together._arms.tips - alone._arms.tips).max() < 1e-12
        assert np.abs(together.margins - alone.margins).max() < 1e-9
        moved += int((together._arms._jobs[:, 3] > 0).sum())
    assert moved > 100  # so many went side by side
