"""What objects show of themselves: in a line, and in a notebook."""

from __future__ import annotations

import base64
import dataclasses
import importlib
import inspect
import re
from pathlib import Path

import numpy as np
import pytest

import tubeopt
from tests.examples import THESIS, TWO_TUBE
from tubeopt.display import Displayed, brief, in_full
from tubeopt.show.plots import plot_torsion
from tubeopt.show.report import report as registered
from tubeopt.show.reports import report, reports

PNG = b"\x89PNG\r\n\x1a\n"
LINE = 260
"""Characters that no line exceeds: the limit, one more field, and the name."""


def classes() -> list[type]:
    """Public classes that hold data, and the answers of commands."""
    public = [getattr(tubeopt, name) for name in tubeopt.__all__]
    data = {kind for kind in public if inspect.isclass(kind) and dataclasses.is_dataclass(kind)}
    reports()
    answers = {kind for kind in registered.registry if kind is not object and kind.__name__ != "Doctor"}
    return sorted(data | answers, key=lambda kind: kind.__name__)


@pytest.mark.parametrize("kind", classes(), ids=lambda kind: kind.__name__)
def test_every_public_class_of_data_shows_itself(kind: type) -> None:
    assert issubclass(kind, Displayed)
    assert kind.__repr__ is Displayed.__repr__


@pytest.fixture(scope="module")
def pose() -> tubeopt.Equilibrium:
    return tubeopt.forward_kinematics(TWO_TUBE, [0.3, 1.0])


def test_an_equilibrium_is_one_line(pose: tubeopt.Equilibrium) -> None:
    line = repr(pose)
    assert line.startswith("Equilibrium(robot=<ConcentricRobot 'two tubes'>, rotations=[0.3, 1]")
    assert "margin=" in line
    assert "\n" not in line
    assert len(line) < LINE


@pytest.mark.parametrize(
    "of",
    [
        lambda e: e.robot,
        lambda e: e.robot.tubes[0],
        lambda e: e.robot.tubes[0].material,
        lambda e: e.robot.limits,
        lambda e: e.jacobian(),
        lambda e: e.statistics,
        lambda e: tubeopt.Load((0, 0, 0.01)),
        lambda e: tubeopt.forward_kinematics_batch(e.robot, np.zeros((3, 2))),
        lambda e: tubeopt.assess_snapping(e.robot),
    ],
)
def test_objects_have_a_line_and_a_table(pose: tubeopt.Equilibrium, of: object) -> None:
    assert callable(of)
    thing = of(pose)
    assert repr(thing).startswith(f"{type(thing).__name__}(")
    assert len(repr(thing)) < LINE
    shown = thing._repr_mimebundle_()
    page = shown["text/html"]
    assert "<pre" in page
    assert "array(" not in page
    assert ("image/png" in shown) == ("<img" in page)


def test_a_table_has_the_numbers_of_the_command_line_and_the_picture(pose: tubeopt.Equilibrium) -> None:
    page, picture = pose._repr_html_(), pose._repr_png_()
    for _, value in report(pose).rows()[:5]:
        assert value in page
    assert picture is not None
    assert picture.startswith(PNG)
    assert base64.b64encode(picture).decode() in page


def test_a_figure_is_shown_without_pyplot(pose: tubeopt.Equilibrium) -> None:
    figure = plot_torsion(pose)
    assert figure._repr_png_().startswith(PNG)  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (1 / 3, "0.333333"),
        (np.array([1.0, 2.5]), "[1, 2.5]"),
        (np.zeros((4, 3)), "<4 x 3 array>"),
        ((1.0, 2.0), "(1, 2)"),
        (["a"] * 20, "<20 str>"),
        ("x" * 99, repr("x" * 37 + "...")),
        (tubeopt.Status.STABLE, "STABLE"),
        (THESIS, "<ConcentricRobot 'thesis CTR'>"),
    ],
)
def test_values_are_brief(value: object, words: str) -> None:
    assert brief(value) == words


def test_in_full_tells_robots_apart_by_any_number() -> None:
    tube = dataclasses.replace(TWO_TUBE.tubes[0], curvature=np.nextafter(TWO_TUBE.tubes[0].curvature, 1e9))
    other = dataclasses.replace(TWO_TUBE, tubes=(tube, *TWO_TUBE.tubes[1:]))
    assert repr(other) == repr(TWO_TUBE)
    assert in_full(other) != in_full(TWO_TUBE)
    assert in_full((1,)) == "(1,)"


def test_what_reports_name_to_be_drawn_is_there() -> None:
    texts = [path.read_text(encoding="utf-8") for path in Path(tubeopt.__path__[0], "show").glob("*.py")]
    named = {name for text in texts for name in re.findall(r'"(\w+\.(?:plot|animate)_\w+)"', text)}
    assert len(named) > 25
    for module, function in (name.split(".") for name in named):
        assert callable(getattr(importlib.import_module(f"tubeopt.show.plots.{module}"), function))
