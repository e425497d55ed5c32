"""Pictures of inverse kinematics are drawn with what they claim to show."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.examples import MM, THESIS, eccentric_robot
from tubeopt import IkSession, InputError, InverseOptions, inverse_kinematics
from tubeopt.show.plots.scene import TARGET
from tubeopt.show.plots.workspace import path_length, plot_inverse, plot_targets

POINT = np.array([50.0, 30.0, 150.0]) * MM


def test_the_arm_its_target_and_its_ghosts(tmp_path: Path) -> None:
    solution = inverse_kinematics(THESIS, POINT, all_solutions=True, options=InverseOptions(starts=16))
    figure = plot_inverse(solution, tmp_path / "ik.png")
    with Image.open(tmp_path / "ik.png") as image:
        image.verify()
    text = figure.get_suptitle()
    assert "tip (50, 30, 150) mm" in text
    assert (f"ghosts: {len(solution) - 1} other posture" in text) == (len(solution) > 1)
    marks = [line for line in figure.axes[0].lines if line.get_marker() == "+"]
    assert len(marks) == 1
    assert marks[0].get_color() == TARGET


def test_a_target_that_is_missed_says_by_how_much() -> None:
    closest = inverse_kinematics(
        eccentric_robot(), [0.0, 0.0, 0.12], on_failure="closest", options=InverseOptions(starts=1)
    )
    message = [text.get_text() for text in plot_inverse(closest).axes[0].texts]
    assert any("mm short" in word for word in message)


def test_a_path_of_targets(tmp_path: Path) -> None:
    session = IkSession(THESIS)
    results = [session.solve(POINT + k * np.array([1e-3, 0.0, 5e-4])) for k in range(3)]
    figure = plot_targets(results, tmp_path / "path.pdf", title="a line")
    assert (tmp_path / "path.pdf").read_bytes().startswith(b"%PDF")
    assert "a line: 3 targets" in figure.get_suptitle()
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert labels[1:] == ["rotation (deg)", "translation (mm)", "margin"]
    path = path_length(np.array([each.target_position for each in results]))
    assert path[-1] == pytest.approx(2 * np.hypot(1e-3, 5e-4))
    margin = figure.axes[3].lines[0].get_ydata()
    np.testing.assert_allclose(margin, [each.margin for each in results])
    assert len(plot_targets([*results, results[-1]]).axes[3].lines[0].get_xydata()) == 4  # one target twice


def test_unknown_formats_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="it must end in"):
        plot_inverse(inverse_kinematics(THESIS, POINT), tmp_path / "ik.gif")
