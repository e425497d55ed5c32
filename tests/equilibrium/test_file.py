"""Results survive being saved and loaded in every bit."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest

from tubeopt.block.transcription.arm import ArmShape, CollocationPoints
from tubeopt.equilibrium.file import ALONG_THE_ARM, ARRAYS, PARTS, load_equilibrium, save_equilibrium
from tubeopt.equilibrium.result import Accuracy, Equilibrium, Statistics, Status, Verification
from tubeopt.errors import InputError
from tubeopt.robots.concentric import ConcentricRobot
from tubeopt.robots.limits import JointLimits
from tubeopt.robots.tubes import Tube


def an_equilibrium(seed: int = 0) -> Equilibrium:
    """Not a solution of anything: numbers without pattern in every field."""
    random = np.random.default_rng(seed)
    n, m = 2, 7
    along = {
        "arc_length": (m,),
        "position": (m, 3),
        "frame": (m, 3, 3),
        "curvature": (m, 2),
        "rotation": (n, m),
        "torsion": (n, m),
    }
    tubes = (Tube(1e-3, 0.1e-3 / 3, 0.2, 0.1 / 7, 1 / 3), Tube(2e-3, 1.1e-3, 0.1, 0.1 / 7, -1 / 3))
    limits = JointLimits(((-1 / 3, 1 / 3), (0, 1)), ((-0.1, 0), (0, 0.1)))
    return Equilibrium(
        robot=ConcentricRobot(tubes, "röbot", limits),
        margin=1 / 3,
        index=2,
        energy=1e-3 / 7,
        accuracy=Accuracy(residual=1.1e-17, mesh_error=0.1 + 0.2, tip_error=5e-324),
        status=Status.UNSTABLE,
        statistics=Statistics("newton", 3, 4, 5, "home", 0.1 / 3),
        verification=Verification(*random.normal(size=5)),
        arm=ArmShape(**{name: random.normal(size=shape) for name, shape in along.items()}),
        points=CollocationPoints(*(random.normal(size=size) for size in (5, (5, n), (5, 2)))),
        section_start=random.normal(size=4),
        **{name: random.normal(size=n) for name in ("rotations", "translations", "tip_rotations", "tube_end")},
    )


def assert_equal(a: Equilibrium, b: Equilibrium) -> None:
    fields = [field.name for kind in (Equilibrium, *PARTS.values()) for field in dataclasses.fields(kind)]
    for name in [name for name in fields if name not in PARTS]:
        one, other = getattr(a, name), getattr(b, name)
        if name in ARRAYS or name in ALONG_THE_ARM:
            assert one.dtype == other.dtype
            np.testing.assert_array_equal(one, other, strict=True)
        elif isinstance(one, float) and math.isnan(one):
            assert math.isnan(other)
        else:
            assert one == other, name
            assert type(one) is type(other)


def test_there_and_back(tmp_path: Path) -> None:
    equilibrium = an_equilibrium()
    assert save_equilibrium(equilibrium, tmp_path / "new") == [
        tmp_path / "new/result.json",
        tmp_path / "new/arrays.npz",
    ]
    assert_equal(load_equilibrium(tmp_path / "new"), equilibrium)


def test_a_failed_solve_there_and_back(tmp_path: Path) -> None:
    whole, position = an_equilibrium(), np.full((7, 3), math.nan)
    position[-1] = math.nan, -math.inf, 1.0
    equilibrium = dataclasses.replace(
        whole,
        margin=math.nan,
        energy=math.inf,
        arm=dataclasses.replace(whole.arm, position=position),
        status=Status.NOT_CONVERGED,
        verification=None,
    )
    equilibrium.save(tmp_path)
    assert_equal(load_equilibrium(tmp_path), equilibrium)


def test_the_json_file_can_be_read(tmp_path: Path) -> None:
    equilibrium = dataclasses.replace(an_equilibrium(), margin=math.nan)
    save_equilibrium(equilibrium, tmp_path)

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is not JSON")

    data = json.loads((tmp_path / "result.json").read_text(encoding="utf-8"), parse_constant=refuse)
    assert data["status"] == "UNSTABLE"
    assert data["robot"]["name"] == "röbot"
    assert data["tip_position"] == equilibrium.tip_position.tolist()
    assert data["margin"] == "NaN"
    with np.load(tmp_path / "arrays.npz", allow_pickle=False) as arrays:
        assert set(arrays) == set(ALONG_THE_ARM)


def test_files_that_are_not_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"result\.json: there is no such file$"):
        load_equilibrium(tmp_path)
    save_equilibrium(an_equilibrium(), tmp_path)
    (tmp_path / "arrays.npz").unlink()
    with pytest.raises(InputError, match=r"arrays\.npz: there is no such file$"):
        load_equilibrium(tmp_path)


def test_arrays_of_another_solve(tmp_path: Path) -> None:
    save_equilibrium(an_equilibrium(0), tmp_path / "a")
    save_equilibrium(an_equilibrium(1), tmp_path / "b")
    (tmp_path / "a" / "arrays.npz").replace(tmp_path / "b" / "arrays.npz")
    with pytest.raises(InputError, match=r"arrays\.npz: these are not the arrays that belong to .*result\.json$"):
        load_equilibrium(tmp_path / "b")


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("{", "", r"result\.json: not valid JSON: line 2: "),
        ('"UNSTABLE"', '"WOBBLY"', r"result\.json: status is 'WOBBLY'; it must be "),
        (
            '"margin"',
            '"marge"',
            r"result\.json: margin is missing\n.*: marge is not a known key; did you mean 'margin'\?$",
        ),
        (
            '"outer_diameter": 0.001',
            '"outer_diameter": -1',
            r"result\.json: robot.*: outer_diameter is -1; it must be ",
        ),
    ],
)
def test_a_file_that_someone_edited(tmp_path: Path, old: str, new: str, problem: str) -> None:
    save_equilibrium(an_equilibrium(), tmp_path)
    path = tmp_path / "result.json"
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(InputError, match=problem):
        load_equilibrium(tmp_path)
