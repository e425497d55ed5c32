"""Robots as YAML: exact there and back, and one clear sentence for everything that can be wrong."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from decimal import Decimal
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tubeopt.errors import InputError
from tubeopt.robots.concentric import ConcentricRobot
from tubeopt.robots.file import load_robot, robot_from_dict, robot_to_dict, save_robot
from tubeopt.robots.limits import JointLimits
from tubeopt.robots.materials import NITINOL, Material
from tubeopt.robots.tubes import Tube

CONFIGS = Path(__file__).parents[2] / "configs"

TUBE = """
  - outer_diameter_mm: 1
    inner_diameter_mm: 0.5
    straight_length_mm: 10
    curved_length_mm: 10
    radius_mm: 100
"""
ROBOT = f"kind: concentric\ntubes:{TUBE}"


# --- there and back -------------------------------------------------------------------------------------------------

TEXT = st.text(st.characters(exclude_categories=["Cs"]))
"""Of all characters that files may have. They are those of `st.text()`, which takes two seconds to find them."""


def materials() -> st.SearchStrategy[Material]:
    moduli = st.tuples(st.floats(1e6, 1e12), st.floats(0, 0.49))
    strains = st.tuples(st.floats(1e-6, 1), st.floats(1e-6, 1))
    return st.just(NITINOL) | st.builds(
        lambda name, moduli, strains: Material(name, moduli[0], moduli[0] / (2 + 2 * moduli[1]), *strains),
        TEXT,
        moduli,
        strains,
    )


@st.composite
def robots(draw: st.DrawFn) -> ConcentricRobot:
    n = draw(st.integers(1, 5))
    walls = draw(st.lists(st.tuples(st.floats(1e-6, 1e-3), st.floats(0, 1e-3)), min_size=n, max_size=n))
    longer = draw(st.lists(st.tuples(st.floats(0, 0.1), st.floats(0, 0.1)), min_size=n, max_size=n))
    tubes: list[Tube] = []
    inner, straight, curved = draw(st.floats(0, 1e-3)), 1.0, 1.0
    for (wall, gap), (less_straight, less_curved) in zip(walls, longer, strict=True):
        outer = inner + 2 * wall
        straight, curved = straight - less_straight, curved - less_curved
        bend = draw(st.floats(-0.9, 0.9))
        tubes.append(Tube(outer, inner, straight, curved, bend / (outer / 2), draw(materials())))
        inner = outer + gap
    pair = st.tuples(st.floats(-10, 10), st.floats(-10, 10)).map(lambda pair: (min(pair), max(pair)))
    pairs = st.lists(pair, min_size=n, max_size=n).map(tuple)
    limits = draw(st.none() | st.builds(JointLimits, pairs, pairs))
    return ConcentricRobot(tuple(tubes), draw(TEXT), limits)


@pytest.mark.filterwarnings("ignore::tubeopt.errors.ImplausibleWarning")
@given(robots())
def test_saved_and_loaded_is_equal_to_the_last_bit(
    tmp_path_factory: pytest.TempPathFactory, robot: ConcentricRobot
) -> None:
    path = tmp_path_factory.getbasetemp() / "robot.yaml"
    save_robot(robot, path)
    assert load_robot(path) == robot


@pytest.mark.filterwarnings("ignore::tubeopt.errors.ImplausibleWarning")
@given(robots())
def test_dictionary_there_and_back(robot: ConcentricRobot) -> None:
    assert robot_from_dict(robot_to_dict(robot)) == robot


def test_a_robot_saves_itself(tmp_path: Path) -> None:
    robot = load_robot(CONFIGS / "robots" / "crl_ctr.yaml")
    robot.save(tmp_path / "new" / "robot.yaml")
    assert load_robot(tmp_path / "new" / "robot.yaml") == robot


# --- the robots that come along ---------------------------------------------------------------------------------------


def test_thesis_robot() -> None:
    robot = load_robot(CONFIGS / "robots" / "thesis_ctr.yaml")
    assert robot.tubes == (
        Tube(1e-3, 0.9e-3, 0.2, 0.2, 10.0),
        Tube(1.2e-3, 1.05e-3, 0.15, 0.15, 5.0),
        Tube(1.4e-3, 1.25e-3, 0.1, 0.1, 2.5),
    )
    assert robot.tubes[0].material is NITINOL


def test_crl_robot() -> None:
    robot = load_robot(CONFIGS / "robots" / "crl_ctr.yaml")
    alloy = replace(Material.from_poisson_ratio("nitinol of the CRL robot", 50e9, 0.3), thermal=NITINOL.thermal)
    assert robot.tubes == (
        Tube(0.5e-3, 0.4e-3, 0.169, 0.041, 28.0, alloy),
        Tube(0.9e-3, 0.7e-3, 0.065, 0.1, 12.4, alloy),
        Tube(1.5e-3, 1.2e-3, 0.01, 0.1, 4.37, alloy),
    )
    assert [tube.length for tube in robot.tubes] == pytest.approx([0.210, 0.165, 0.110])


def test_two_tube_robot_is_the_one_of_its_header() -> None:
    inner, outer = load_robot(CONFIGS / "robots" / "two_tube.yaml").tubes
    assert inner.material.poisson_ratio == pytest.approx(outer.material.poisson_ratio)
    assert (inner.straight_length, inner.curved_length) == (outer.straight_length, outer.curved_length)
    c = (1 + inner.material.poisson_ratio) * inner.curvature * outer.curvature
    assert c * inner.curved_length**2 == pytest.approx(2)
    assert inner.straight_length / inner.curved_length == pytest.approx(0.5)
    root = math.sqrt(c)
    assert inner.straight_length * root * math.tan(root * inner.curved_length) == pytest.approx(4.48, abs=5e-3)


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("*/*.yaml")), ids=lambda path: path.stem)
def test_every_file_names_its_schema_and_its_source(path: Path) -> None:
    first, *rest = path.read_text(encoding="utf-8").splitlines()
    schema = first.removeprefix("# yaml-language-server: $schema=")
    assert (path.parent / schema).is_file()
    header = itertools.takewhile(lambda line: line.startswith("#"), rest)
    assert any(line.startswith(("# Source: ", "# Sources:")) for line in header)


# --- ways to write the same -------------------------------------------------------------------------------------------


def load(tmp_path: Path, text: str) -> ConcentricRobot:
    path = tmp_path / "robot.yaml"
    path.write_text(text, encoding="utf-8")
    return load_robot(path)


def test_radius_is_the_inverse_of_curvature(tmp_path: Path) -> None:
    assert load(tmp_path, ROBOT) == load(tmp_path, ROBOT.replace("radius_mm: 100", "curvature_per_m: 10"))


@pytest.mark.parametrize("number", ["100", "100.0", "1e2", "1.0e2", "1.E+2", "+100", "1_00"])
def test_numbers_as_people_write_them(tmp_path: Path, number: str) -> None:
    assert load(tmp_path, ROBOT.replace("radius_mm: 100", f"radius_mm: {number}")) == load(tmp_path, ROBOT)


def test_material_by_name_by_constants_and_by_default(tmp_path: Path) -> None:
    constants = "material: {name: nitinol, youngs_modulus_GPa: 58, shear_modulus_GPa: 21.5}"
    for line in ("material: nitinol", constants):
        assert load(tmp_path, f"{ROBOT}    {line}\n") == load(tmp_path, ROBOT)
    robot = load(
        tmp_path,
        ROBOT + "    material: {name: steel, youngs_modulus_GPa: 200, poisson_ratio: 0, working_strain_percent: 0.1,"
        " superelastic_strain_percent: 0.2}\n",
    )
    assert robot.tubes[0].material == Material("steel", 200e9, 100e9, 0.001, 0.002)


def test_limits(tmp_path: Path) -> None:
    robot = load(tmp_path, ROBOT + "limits: {rotations_deg: [[-180, 180]], translations_mm: [[-10, 5.5]]}\n")
    assert robot.limits == JointLimits(((-math.pi, math.pi),), ((-0.01, 0.0055),))


# --- what can be wrong ------------------------------------------------------------------------------------------------


def problems(path: Path, text: str | bytes) -> list[str]:
    """The problems that loading reports, each of which must begin with the file."""
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(InputError) as caught:
        load_robot(path)
    lines = str(caught.value).splitlines()
    assert all(line.startswith(f"{path}: ") for line in lines)
    return [line.removeprefix(f"{path}: ") for line in lines]


PROBLEMS = [
    ("diameter_mm: 1\n", "diameter_mm: -1\n", "tubes[0].outer_diameter_mm is -1; it must be greater than 0"),
    ("diameter_mm: 1\n", "diameter_mm: abc\n", "tubes[0].outer_diameter_mm is 'abc'; it must be a number"),
    ("diameter_mm: 1\n", "diameter_mm: '1'\n", "tubes[0].outer_diameter_mm is '1'; it must be a number"),
    ("diameter_mm: 1\n", "diameter_mm: yes\n", "tubes[0].outer_diameter_mm is true; it must be a number"),
    ("diameter_mm: 1\n", "diameter_mm: [1]\n", "tubes[0].outer_diameter_mm is [1]; it must be a number"),
    ("diameter_mm: 1\n", "diameter_mm:\n", "tubes[0].outer_diameter_mm is empty; it must be a number"),
    ("diameter_mm: 1\n", "diameter_mm: .nan\n", "tubes[0].outer_diameter_mm is NaN; it must be a finite number"),
    (
        "diameter_mm: 1\n",
        "diameter_mm: .inf\n",
        "tubes[0].outer_diameter_mm is Infinity; it must be a finite number",
    ),
    (
        "diameter_mm: 1\n",
        "diameter_mm: 1e999\n",
        "tubes[0].outer_diameter_mm is 1E+999; it must be a finite number",
    ),
    (
        "outer_diameter_mm: 1\n",
        "outer_diametre_mm: 1\n",
        "tubes[0].outer_diameter_mm is missing\n"
        "tubes[0].outer_diametre_mm is not a known key; did you mean 'outer_diameter_mm'?",
    ),
    (
        "diameter_mm: 1\n",
        "diameter_mm: 0.5\n",
        "tubes[0].inner_diameter_mm is 0.5; it must be less than outer_diameter_mm (0.5)",
    ),
    (
        "straight_length_mm: 10",
        "straight_length_mm: -1",
        "tubes[0].straight_length_mm is -1; it must be at least 0",
    ),
    (
        "radius_mm: 100",
        "radius_mm: 0.4",
        "tubes[0]: curvature is 2500 per m; its radius must exceed half the outer_diameter (0.5 mm)",
    ),
    ("radius_mm: 100", "radius_mm: 0", "tubes[0].radius_mm is 0; it must be greater than 0"),
    (
        "radius_mm: 100",
        "{}",
        "tubes[0] gives neither curvature_per_m nor radius_mm; it must give one of them",
    ),
    (
        "radius_mm: 100",
        "radius_mm: 100\n    curvature_per_m: 10",
        "tubes[0] gives both curvature_per_m and radius_mm; it must give one of them",
    ),
    (
        "radius_mm: 100",
        "radius_mm: 100\n    material: nitinl",
        "tubes[0].material is 'nitinl'; it must be nitinol or a mapping with its keys; did you mean 'nitinol'?",
    ),
    (
        "radius_mm: 100",
        "radius_mm: 100\n    material: 3",
        "tubes[0].material is 3; it must be a mapping of keys to values",
    ),
    (
        "radius_mm: 100",
        "radius_mm: 100\n    material: {name: a, youngs_modulus_GPa: 1, poisson_ration: 0.3}",
        "tubes[0].material.poisson_ration is not a known key; did you mean 'poisson_ratio'?",
    ),
    (
        "radius_mm: 100",
        "radius_mm: 100\n    material: {name: a, youngs_modulus_GPa: 1}",
        "tubes[0].material gives neither shear_modulus_GPa nor poisson_ratio; it must give one of them",
    ),
    (
        "radius_mm: 100",
        "radius_mm: 100\n    material: {name: a, youngs_modulus_GPa: 1, poisson_ratio: 0.5}",
        "tubes[0].material: poisson_ratio of material 'a' is 0.5; it must lie in [0, 0.5)",
    ),
    (
        "kind: concentric",
        "kind: conzentric",
        "kind is 'conzentric'; it must be concentric, eccentric, segmented_eccentric or bundle; "
        "did you mean 'concentric'?",
    ),
    ("kind: concentric\n", "", "kind is missing; it must be concentric, eccentric, segmented_eccentric or bundle"),
    (
        "kind: concentric",
        "kind: [concentric]",
        "kind is ['concentric']; it must be concentric, eccentric, segmented_eccentric or bundle",
    ),
    ("kind: concentric", "kind: concentric\nname: 3", "name is 3; it must be text"),
    ("kind: concentric", "kind: concentric\nnmae: x", "nmae is not a known key; did you mean 'name'?"),
    (
        "kind: concentric",
        "kind: concentric\nsheath_diameter_mm: 5",
        "sheath_diameter_mm is not a known key; it is one of kind: bundle",
    ),
    ("kind: concentric", "kind: concentric\n7: x", "[7] is not a known key; keys are text"),
    ("kind: concentric", "kind: concentric\nlimits: 3", "limits is 3; it must be a mapping of keys to values"),
    (
        "kind: concentric",
        "kind: concentric\nlimits: {rotations_deg: [[0, 1, 2]], translations_mm: 0}",
        "limits.rotations_deg[0] has 3 numbers; it must have 2\nlimits.translations_mm is 0; it must be a list",
    ),
    (
        "kind: concentric",
        "kind: concentric\nlimits: {rotations_deg: [[0]], translations_mm: [[0, 1]]}",
        "limits.rotations_deg[0] has 1 number; it must have 2",
    ),
    (
        "kind: concentric",
        "kind: concentric\nlimits: {rotations_deg: [[0, 1]], translations_mm: [[1, 0]]}",
        "limits: limit of translation 1 is 1 mm to 0 mm; it must be least, greatest",
    ),
    (
        "kind: concentric",
        "kind: concentric\nlimits: {rotations_deg: [[0, 1], [0, 1]], translations_mm: [[0, 1], [0, 1]]}",
        "limits are given for 2 tubes; the robot has 1",
    ),
]


@pytest.mark.parametrize(("old", "new", "problem"), PROBLEMS)
def test_each_problem_has_its_sentence(tmp_path: Path, old: str, new: str, problem: str) -> None:
    assert old in ROBOT
    text = ROBOT.replace(old, new, 1) if new != "{}" else ROBOT.replace(f"    {old}\n", "")
    assert problems(tmp_path / "x.yaml", text) == problem.splitlines()


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "the file is empty; it must be a mapping of keys to values"),
        ("# nothing but a comment\n", "the file is empty; it must be a mapping of keys to values"),
        ("- 1\n- 2\n", "the file contains a list; it must be a mapping of keys to values"),
        ("text", "the file contains text; it must be a mapping of keys to values"),
        ("3", "the file contains a single value; it must be a mapping of keys to values"),
        ("kind: concentric\ntubes: []", "tubes has 0 items; it must have at least 1"),
        ("kind: concentric\ntubes: 3", "tubes is 3; it must be a list"),
        ("kind: concentric\ntubes: [3]", "tubes[0] is 3; it must be a mapping of keys to values"),
        ("kind: concentric", "tubes is missing"),
        ("kind: concentric\nkind: concentric", "line 2, column 1: not valid YAML: the key 'kind' is given twice"),
        (
            "kind: concentric\ntubes: [",
            "line 2, column 9: not valid YAML: expected the node content, but found '<stream end>'",
        ),
        ("a: b: c", "line 1, column 5: not valid YAML: mapping values are not allowed here"),
        (
            "a: 1\n---\nb: 2",
            "line 2, column 1: not valid YAML: expected a single document in the stream, but found another document",
        ),
        ("a: \x07", "not valid YAML: unacceptable character #x0007: special characters are not allowed"),
        ("a: 2001-99-99", "not valid YAML: month must be in 1..12"),
        ("? [a]\n: 1", "line 1, column 3: not valid YAML: found unhashable key"),
        ("[" * 700, "not valid YAML: nested too deeply"),
        (b"\xff\xfe\xff", "this is not a text file in UTF-8"),
        (
            "a: !!python/object/apply:os.system ['true']",
            "line 1, column 4: not valid YAML: !!python/object/apply:os.system is not allowed; only "
            "numbers, text, lists and mappings are",
        ),
        (
            "!!python/object:tubeopt.robots.tubes.Tube {}",
            "line 1, column 1: not valid YAML: !!python/object:tubeopt.robots.tubes.Tube is not "
            "allowed; only numbers, text, lists and mappings are",
        ),
    ],
)
def test_what_is_not_even_a_robot(tmp_path: Path, text: str | bytes, problem: str) -> None:
    assert problems(tmp_path / "x.yaml", text) == [problem]


def test_no_such_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.yaml: there is no such file$"):
        load_robot(tmp_path / "none.yaml")
    with pytest.raises(InputError, match=r": this is a directory; it must be a file$"):
        load_robot(tmp_path)


def test_all_problems_at_once(tmp_path: Path) -> None:
    text = f"kind: concentric\ncolour: red\ntubes:{TUBE}{TUBE}{TUBE}"
    text = text.replace("radius_mm: 100", "radius_mm: -5", 1)
    head, last = text.rsplit("inner_diameter_mm: 0.5", 1)
    text = head + "inner_diameter_mm: 2" + last.replace("straight", "straigth")
    assert problems(tmp_path / "x.yaml", text) == [
        "tubes[0].radius_mm is -5; it must be greater than 0",
        "tubes[2].inner_diameter_mm is 2; it must be less than outer_diameter_mm (1)",
        "tubes[2].straight_length_mm is missing",
        "tubes[2].straigth_length_mm is not a known key; did you mean 'straight_length_mm'?",
        "colour is not a known key",
    ]


def test_tubes_that_do_not_go_together(tmp_path: Path) -> None:
    assert problems(tmp_path / "x.yaml", ROBOT + TUBE) == [
        "tube 1 does not fit into tube 2: its outer_diameter is 1 mm; it must be at most the other's "
        "inner_diameter, 0.5 mm"
    ]
    outer = TUBE.replace("_mm: 1\n", "_mm: 2\n").replace("_mm: 0.5", "_mm: 1").replace("_mm: 10\n", "_mm: 11\n")
    assert problems(tmp_path / "x.yaml", ROBOT + outer) == [
        "tube 1 is shorter than tube 2 around it: its overall length is 20 mm; it must be at least 22 mm"
    ]


def test_a_problem_in_an_alias_is_told_where_it_is_used(tmp_path: Path) -> None:
    material = "    material: {}\n"
    text = ROBOT + material.format("&m {name: a, youngs_modulus_GPa: 0, poisson_ratio: 0}") + TUBE
    assert problems(tmp_path / "x.yaml", text + material.format("*m")) == [
        f"tubes[{i}].material.youngs_modulus_GPa is 0; it must be greater than 0" for i in (0, 1)
    ]


def test_expanding_aliases_costs_nothing(tmp_path: Path) -> None:
    bomb = "a0: &a0 [x]\n" + "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 12))
    assert "tubes[0] is [" in problems(tmp_path / "x.yaml", f"{bomb}kind: concentric\ntubes: [*a11]\n")[0]
    assert problems(tmp_path / "x.yaml", "kind: concentric\ntubes: &t [*t]\n") == [
        "tubes[0] is [[[[[[[...]]]]]]]; it must be a mapping of keys to values"
    ]


@pytest.mark.parametrize("data", [None, 3, [], "text"])
def test_data_that_are_no_mapping(data: Any) -> None:
    with pytest.raises(InputError, match=r"^the data are .*; they must be a mapping of keys to values$"):
        robot_from_dict(data)


def test_numbers_in_dictionaries_may_be_floats() -> None:
    robot = load_robot(CONFIGS / "robots" / "thesis_ctr.yaml")
    data = robot_to_dict(robot)
    assert data["tubes"][0]["outer_diameter_mm"] == 1
    data["tubes"][0]["outer_diameter_mm"] = Decimal("1.00")
    assert robot_from_dict(data) == robot
    data["tubes"][0]["outer_diameter_mm"] = math.nan
    with pytest.raises(InputError, match=r"^tubes\[0\].outer_diameter_mm is nan; it must be a finite number$"):
        robot_from_dict(data)
