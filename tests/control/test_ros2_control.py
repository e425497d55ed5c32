"""The hardware interface of ros2_control, compiled against stand-ins of its headers and driven line by line."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from tests.examples import THESIS
from tubeopt import forward_kinematics
from tubeopt.control.c_library import c_library, robot_description, save_c_library
from tubeopt.control.command import Why

GXX = shutil.which("g++")
pytestmark = pytest.mark.skipif(GXX is None or shutil.which("gcc") is None, reason="no g++")

PACKAGE, HEADERS = Path("integrations/ros2/tubeopt_hardware"), Path("tests/control/ros2_control")
SEED = np.array([0.0, 1.0, 2.0, -0.05, -0.03, -0.02])
NAMES = [f"{kind}_{i}" for kind in ("rotation", "translation") for i in (1, 2, 3)]

ACCELERATIONS = {"turn_acceleration": 30.0, "shift_acceleration": 1.0}


def moved_by(*changes: float) -> np.ndarray:
    """Joint values away from the first ones."""
    moved: np.ndarray = SEED + np.array(changes)
    return moved


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    work = tmp_path_factory.mktemp("hardware")
    save_c_library(c_library(THESIS, name="thesis_ctr"), work)
    include = [f"-I{path}" for path in (work, PACKAGE / "include", HEADERS)]
    subprocess.run(["gcc", "-std=c99", "-O0", "-c", "tubeopt_robot.c"], cwd=work, check=True)
    sources = [str(PACKAGE / "src" / "tube_robot.cpp"), str(HEADERS / "main.cpp"), str(work / "tubeopt_robot.o")]
    flags = ["-std=c++17", "-Wall", "-Wextra", "-Werror", "-O1"]
    subprocess.run([str(GXX), *flags, *include, *sources, "-lm", "-o", str(work / "program")], check=True)
    return work / "program"


def described() -> dict[str, str]:
    """Parameters and joints of the description, as arguments of the program."""
    system = ElementTree.fromstring(robot_description(THESIS)).find("ros2_control")
    assert system is not None
    found = {part.get("name", ""): part.text or "" for part in system.findall("hardware/param")}
    for joint in system.findall("joint"):
        keys = [f"state_interface/param[@name='{key}']" for key in ("initial_value",)]
        keys += [f"command_interface/param[@name='{key}']" for key in ("min", "max")]
        found[joint.get("name", "")] = ",".join(joint.findtext(key, "") for key in keys)
    return found


class Hardware:
    """The program, and the states of its last answer."""

    def __init__(self, program: Path, **changes: float | str) -> None:
        known = described()
        for name, start in zip(NAMES, SEED.tolist(), strict=True):
            known[name] = f"{start},{known[name].partition(',')[2]}"
        words = [f"{name}={value}" for name, value in (known | changes).items() if value is not None]
        self.process = subprocess.Popen([str(program), *words], stdin=-1, stdout=-1, stderr=-1, text=True, bufsize=1)

    def ask(self, *words: object) -> int:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(" ".join(map(str, words)) + "\n")
        answer, *states = self.process.stdout.readline().split()
        values = np.array(states, dtype=float)
        self.position, self.velocity = values[0:12:2], values[1:12:2]
        self.margin, self.why, self.tip = float(values[12]), Why(int(values[13])), values[14:]
        return int(answer)

    def step(self, goal: np.ndarray, period: float = 2e-3) -> int:
        return self.ask("step", period, *goal.tolist())

    def end(self) -> str:
        return self.process.communicate()[1]


@pytest.fixture
def start(program: Path) -> Iterator[Callable[..., Hardware]]:
    """Starts hardware, which ends with the test."""
    started: list[Hardware] = []

    def begin(**changes: float | str) -> Hardware:
        started.append(Hardware(program, **changes))
        return started[-1]

    yield begin
    for hardware in started:
        if hardware.process.returncode is None:
            hardware.end()


@pytest.fixture
def robot(start: Callable[..., Hardware]) -> Hardware:
    hardware = start()
    assert hardware.ask("configure") == hardware.ask("activate") == 0
    return hardware


def test_joints_reach_the_command_within_rates_and_tip_and_margin_are_those_of_python(robot: Hardware) -> None:
    goal = moved_by(0.3, -0.2, 0.1, -0.004, 0.002, 0.003)
    last, most = SEED, np.repeat([3.0, 0.05], 3)
    assert np.array_equal(robot.position, SEED)
    for k in range(120):
        assert robot.step(goal) == 0
        moved = (robot.position - last) / 2e-3
        assert (np.abs(moved) <= most * (1 + 1e-9)).all()
        assert robot.velocity == pytest.approx(moved, abs=1e-9)
        last = robot.position
        if k == 20:
            assert Why.RATE in robot.why
            there = forward_kinematics(THESIS, *np.split(last, 2))
            assert robot.tip == pytest.approx(there.tip_position, abs=1e-9)
            assert robot.margin == pytest.approx(there.margin, abs=1e-6)
    assert robot.position == pytest.approx(goal, abs=1e-9)
    # NaN: no controller yet. A stall: no longer step than 0.02 s. No time: no step.
    robot.step(np.full(6, np.nan))
    assert robot.position == pytest.approx(goal, abs=1e-9)
    robot.step(SEED, 5.0)
    assert np.abs(robot.position - goal).max() == pytest.approx(0.02 * 3.0, rel=1e-6)
    held = robot.position
    assert robot.step(goal, 0.0) == 0
    assert np.array_equal(robot.position, held)


@pytest.mark.parametrize("limits", [{}, ACCELERATIONS])
def test_joints_brake_and_stay_where_a_command_is_out_of_range_or_order(
    start: Callable[..., Hardware], limits: dict[str, float]
) -> None:
    out_of_order, out_of_range = moved_by(0, 0, 0, 0, 0, 0.115), moved_by(7, 0, 0, 0, 0, 0)
    for wrong in (out_of_order, out_of_range, moved_by(0, 0, 0, -0.04, 0, 0), np.full(6, 1e300)):
        robot = start(**limits)
        assert robot.ask("configure") == robot.ask("activate") == 0
        for _ in range(20):
            robot.step(moved_by(0.3, 0, 0, 0, 0, 0))
        speeds, before = [robot.velocity], robot.position
        for _ in range(100):
            assert robot.step(wrong) == 0
            speeds.append(robot.velocity)
        assert Why.HELD in robot.why, (wrong, robot.why, robot.position, robot.velocity)
        assert np.abs(robot.velocity).max() == 0
        # From 1.2 rad/s at 30 rad/s^2 it is 24 mrad to rest; without such a limit none.
        assert 0 <= robot.position[0] - before[0] < (0.03 if limits else 1e-12)
        if limits:
            assert np.abs(np.diff(speeds, axis=0)[:, 0]).max() / 2e-3 <= 30.0 * (1 + 1e-6)
        robot.step(SEED)
        assert not robot.why & Why.HELD


def test_accelerations_are_kept(start: Callable[..., Hardware]) -> None:
    robot = start(**ACCELERATIONS)
    assert robot.ask("configure") == robot.ask("activate") == 0
    speeds, goal = [np.zeros(6)], moved_by(0.2, 0, 0, 0, 0, 0.001)
    for _ in range(200):
        robot.step(goal)
        speeds.append(robot.velocity)
    change = np.abs(np.diff(speeds, axis=0)) / 2e-3
    assert (change <= np.repeat([30.0, 1.0], 3) * (1 + 1e-6) + 1e-6).all()
    assert change.max() > 25.0
    assert robot.position == pytest.approx(goal, abs=1e-6)


def test_drives_that_fail_are_an_error_and_drives_that_moved_are_followed(robot: Hardware) -> None:
    at = moved_by(0.2, 0, 0, 0, 0.001, 0)
    assert robot.ask("deactivate") == 0
    assert robot.ask("by_hand", *at.tolist()) == 0
    assert robot.ask("activate") == 0
    assert robot.position == pytest.approx(at, abs=1e-12)
    assert robot.tip == pytest.approx(forward_kinematics(THESIS, *np.split(at, 2)).tip_position, abs=1e-9)
    robot.step(at)
    assert robot.position == pytest.approx(at, abs=1e-12)
    robot.ask("die")
    tip = robot.tip
    assert robot.step(SEED) == 3  # neither takes a command nor answers
    assert np.array_equal(robot.tip, tip)
    assert robot.ask("configure") == 1
    words = robot.end()
    assert "the drives do not take a command" in words
    assert "the drives do not answer" in words
    assert words.split()[-17:] == [
        *(f"{name}/{of}" for name in NAMES for of in ("position", "velocity")),
        *(f"arm/{name}" for name in ("margin", "why", "tip.x", "tip.y", "tip.z")),
    ]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"rotation_3": None}, "the URDF has 5 joints; it must have 6, with"),
        ({"rotation_3": "half,-1,1"}, "initial_value of rotation_3 is 'half'; it must be a number"),
        ({"rotation_3": "0,-1,"}, "rotation_3 must have one command interface, position, with min and max"),
        ({"min_margin": None}, "no parameter min_margin"),
        ({"turn_rate": -1.0}, "no parameter turn_rate that is a number of at least 0"),
        ({"order": None}, "the parameter order must have triples"),
        ({"order": "1 2 near"}, "the parameter order must have triples"),
        ({"order": "1 2 0.01 3"}, "the parameter order must have triples"),
        ({"order": "1 4 0.01"}, "the parameter order must have triples"),
    ],
)
def test_a_description_that_does_not_fit_is_refused_with_a_sentence(
    start: Callable[..., Hardware], changes: dict[str, str | float], words: str
) -> None:
    robot = start(**changes)
    assert words in robot.end()
    assert robot.process.returncode == 1


def test_the_hardware_starts_at_home_as_described(start: Callable[..., Hardware]) -> None:
    plugin = ElementTree.parse(PACKAGE / "tubeopt_hardware.xml").find("class")
    assert plugin is not None
    assert f"<plugin>{plugin.get('name')}</plugin>" in robot_description(THESIS)
    robot = start(**described())
    assert robot.ask("configure") == 0
    home = forward_kinematics(THESIS, THESIS.home_rotations)
    assert robot.tip == pytest.approx(home.tip_position, abs=1e-9)
