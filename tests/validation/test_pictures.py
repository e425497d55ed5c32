"""Pictures of errors: what they show is what was computed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.quiver import Quiver

from tubeopt import InputError
from tubeopt.runs.measurement_file import load_error_table
from tubeopt.show.plots.validation import plot_error_table, plot_errors, plot_residuals
from tubeopt.validation import validate

from .laboratory import CONFIGS, ctr, etr, mirrored, noisy, turned


def test_arrows_are_the_residuals() -> None:
    result = validate(etr(), noisy(mirrored(etr(), 4), 1))
    figure = plot_residuals(result)
    above, beside = figure.axes
    for axes, columns in ((above, [0, 1]), (beside, [0, 2])):
        (quiver,) = [artist for artist in axes.get_children() if isinstance(artist, Quiver)]
        np.testing.assert_allclose(np.asarray(quiver.XY, dtype=float), result.predicted[:, columns] * 1e3)
        arrows = np.column_stack([quiver.U, quiver.V])
        factor = arrows[0, 0] / (result.residuals[0, 0] * 1e3)
        assert factor == pytest.approx(round(factor))
        np.testing.assert_allclose(arrows, factor * result.residuals[:, columns] * 1e3)
        assert axes.get_aspect() == 1


def test_errors_of_a_mirrored_robot_are_a_radar_and_of_another_one_a_row() -> None:
    radar, _, _ = plot_errors(validate(etr(), noisy(mirrored(etr(), 4), 1))).axes
    assert radar.name == "polar"
    assert len(radar.lines) == 4
    rows, _ = plot_errors(validate(ctr(), noisy(turned(ctr(), 5), 1))).axes
    assert rows.get_xlabel() == "row of the measurements"


def test_headings_say_that_a_picture_is_of_what_a_fit_left() -> None:
    result = validate(ctr(), noisy(turned(ctr(), 5), 1))
    for plot in (plot_residuals, plot_errors):
        assert "after the fit" not in plot(result).get_suptitle()
        assert plot(result, when="after the fit").get_suptitle().startswith(f"{ctr().name}, after the fit")


def test_the_radar_of_a_table_has_its_numbers() -> None:
    table = load_error_table(CONFIGS / "experiments" / "thesis_table_4_1.csv")
    (axes,) = plot_error_table(table).axes
    for line, errors in zip(axes.lines, table.error, strict=True):
        x, y = line.get_xdata(), line.get_ydata()
        np.testing.assert_allclose(np.asarray(x)[:-1], table.direction)
        np.testing.assert_allclose(np.asarray(y), [*errors * 1e3, errors[0] * 1e3])


def test_other_endings_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="it must end in"):
        plot_errors(validate(ctr(), turned(ctr(), 4)), tmp_path / "x.bmp")
