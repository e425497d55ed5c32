"""The thesis' Table 4.1 as data: the means that were printed beside it tell whether it is copied well."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tubeopt import InputError
from tubeopt.runs.measurement_file import load_error_table
from tubeopt.validation import ErrorTable

PATH = Path(__file__).parents[2] / "configs" / "experiments" / "thesis_table_4_1.csv"
PRINTED = 0.05e-3 + 1e-9
"""Half of the last printed digit, m."""


@pytest.fixture(scope="module")
def table() -> ErrorTable:
    return load_error_table(PATH)


def test_directions_and_separations(table: ErrorTable) -> None:
    np.testing.assert_allclose(np.degrees(table.direction), np.arange(0, 360, 20))
    np.testing.assert_allclose(np.degrees(table.separation), [0, 30, 60, 90])
    assert table.error.shape == (4, 18)


def test_means_are_those_that_were_printed(table: ErrorTable) -> None:
    np.testing.assert_allclose(table.error.mean(0), table.mean_by_direction, atol=PRINTED)
    np.testing.assert_allclose(table.error.mean(1), table.mean_by_separation, atol=PRINTED)
    assert table.error.mean() == pytest.approx(table.mean, abs=PRINTED)


def test_overall_mean_and_maximum(table: ErrorTable) -> None:
    summary = table.summary
    assert summary.count == 72
    assert round(summary.mean * 1e3, 1) == 3.6
    assert summary.max * 1e3 == pytest.approx(12.7)
    row, column = np.unravel_index(table.error.argmax(), table.error.shape)
    assert np.degrees([table.separation[row], table.direction[column]]) == pytest.approx([90, 140])
    assert summary.max / 94e-3 == pytest.approx(0.135, abs=5e-4)  # "about 13.5% of the total robot length"


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("a,b\n1,2\n", "the columns must be separation_deg"),
        ("separation_deg,error_at_0_deg_mm,mean_mm\n0,1,1\n", "the last row must begin with mean"),
        (
            "separation_deg,error_at_0_deg_mm,mean_mm\n0,x,1\nmean,1,1\n",
            r"row 1 \(line 2\), column error_at_0_deg_mm is 'x'",
        ),
    ],
)
def test_other_tables_are_refused(tmp_path: Path, text: str, problem: str) -> None:
    path = tmp_path / "table.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=problem):
        load_error_table(path)
