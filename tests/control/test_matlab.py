"""MATLAB's library: its answers are those of Python, and its header has only what `loadlibrary` reads."""

from __future__ import annotations

import ctypes
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from tests.examples import THESIS
from tubeopt import find_snap, forward_kinematics
from tubeopt.control.c_library import c_library, save_c_library
from tubeopt.solvers.compiled.library import compiler
from tubeopt.typing import Array

FOLDER = Path("integrations/matlab")
JOINTS = np.array([0, 1, 2, -0.05, -0.03, -0.02])

pytestmark = pytest.mark.skipif(compiler() is None or shutil.which("cc") is None, reason="no C compiler")


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    folder = tmp_path_factory.mktemp("matlab")
    save_c_library(c_library(THESIS), folder)
    flags = ["-std=c99", "-Og", "-Wall", "-Wextra", "-Werror", "-pedantic", "-shared", "-fPIC", f"-I{folder}"]
    own, robot = FOLDER / "tubeopt_matlab.c", folder / "tubeopt_robot.c"
    made = folder / "libtubeopt_matlab.so"
    subprocess.run(["cc", *flags, str(own), str(robot), "-lm", "-o", str(made)], check=True)
    return ctypes.CDLL(str(made))


def call(library: ctypes.CDLL, name: str, *given: Array | int) -> int:
    plain = [one if isinstance(one, int) else one.ctypes.data_as(ctypes.c_void_p) for one in given]
    return int(getattr(library, f"tubeopt_matlab_{name}")(*plain))


def test_answers_are_those_of_python(library: ctypes.CDLL) -> None:
    expected = forward_kinematics(THESIS, JOINTS[:3], JOINTS[3:])
    pose, jacobian, points = np.zeros(14), np.zeros((6, 6), order="F"), np.zeros((3, 50), order="F")
    assert call(library, "tubes") == 3
    assert call(library, "solve", JOINTS, pose) == 0
    np.testing.assert_allclose(pose[:3], expected.tip_position, atol=1e-10)
    np.testing.assert_allclose(pose[3:12].reshape(3, 3, order="F"), expected.tip_rotation, atol=1e-8)
    np.testing.assert_allclose(pose[12:], [expected.margin, expected.energy], rtol=1e-6)
    assert call(library, "jacobian", jacobian) == 0
    np.testing.assert_allclose(jacobian, expected.jacobian().matrix, atol=1e-6)
    assert call(library, "shape", 50, points) == 0
    np.testing.assert_allclose(points[:, -1], expected.tip_position, atol=1e-9)
    assert np.linalg.norm(points[:, 0]) < 1e-12
    assert call(library, "shape", 1, points) == 2


def test_a_snap_is_refused_and_a_motion_taken_back(library: ctypes.CDLL) -> None:
    snap = find_snap(THESIS, ([0.0] * 3, None), (np.radians([270.0, 0.0, 0.0]), None))
    assert snap is not None
    home, pose, turned, back = np.zeros(6), np.zeros(14), np.zeros(14), np.zeros(14)
    there, beyond = home.copy(), home.copy()
    there[0], beyond[0] = snap.rotations[0] - 0.05, snap.rotations[0] + 0.05
    assert call(library, "solve", home, pose) == 0
    assert call(library, "follow", there, turned) == 0
    assert 0 < turned[12] < pose[12]
    assert call(library, "undo", back) == 0
    np.testing.assert_array_equal(back, pose)
    assert call(library, "follow", there, turned) == 0
    assert call(library, "follow", beyond, back) == 4


def test_the_servo_reaches_its_target(library: ctypes.CDLL) -> None:
    pose, report, send = np.zeros(14), np.zeros(3), JOINTS.copy()
    assert call(library, "solve", JOINTS, pose) == 0
    target = pose[:3] - [2e-3, 0, 0]
    command = np.array([1e-3, *target, 0, 0, 0, 0.02, 6, 0.1, 0.1, 0])
    for _ in range(200):
        assert call(library, "servo", command, send, pose, report) == 0
    assert report[0] < 1e-6
    assert pose[12] > 0.1
    found = forward_kinematics(THESIS, send[:3], send[3:], start=(JOINTS[:3], JOINTS[3:]))
    np.testing.assert_allclose(found.tip_position, target, atol=2e-6)


def test_the_header_has_only_what_matlab_reads(tmp_path: Path) -> None:
    text = (FOLDER / "tubeopt_matlab.h").read_text(encoding="utf-8")
    for name, flags in (("a.c", ["-std=c90", "-pedantic-errors"]), ("a.c", ["-std=c99"])):
        (tmp_path / name).write_text('#include "tubeopt_matlab.h"\n', encoding="utf-8")
        command = ["cc", *flags, "-Wall", "-Wextra", "-Werror", "-fsyntax-only", f"-I{FOLDER.resolve()}", name]
        subprocess.run(command, check=True, cwd=tmp_path)
    code = re.sub(r"/\*[\s\S]*?\*/|^#.*$", "", text, flags=re.MULTILINE)
    declared = dict(re.findall(r"TUBEOPT_MATLAB int (\w+)\(([^)]*)\);", code))
    left = re.sub(r'TUBEOPT_MATLAB int \w+\([^)]*\);|extern "C" \{|\}|\s', "", code)
    assert left == ""
    for arguments in declared.values():
        assert all(re.fullmatch(r"void|int \w+|(const )?double \*\w+", one.strip()) for one in arguments.split(","))
    calls = (FOLDER / "example.m").read_text(encoding="utf-8")
    used = re.findall(r"calllib\('tubeopt_matlab', '(\w+)'((?:, \w+)*)\)", calls)
    assert len(used) == calls.count("calllib(")
    for name, given in used:
        arguments = declared[name]
        assert given.count(",") == (0 if arguments == "void" else arguments.count(",") + 1)
