"""Answers as tables: the columns have the numbers of the answer in their units, in every format."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy

import tubeopt
from tests.examples import THESIS, TWO_TUBE
from tubeopt.errors import InputError
from tubeopt.runs.sweeping import Sweep
from tubeopt.show.tables import columns, matlab_names


@pytest.fixture(scope="module")
def batch() -> tubeopt.EquilibriumBatch:
    return tubeopt.forward_kinematics_batch(THESIS, np.random.default_rng(0).uniform(-3, 3, (7, 3)))


def test_columns_are_in_their_units(batch: tubeopt.EquilibriumBatch) -> None:
    table = columns(batch)
    assert table["rotation_2_deg"] == pytest.approx(np.degrees(batch.rotations[:, 1]))
    assert table["tip_z_mm"] == pytest.approx(1e3 * batch.tip_position[:, 2])
    assert table["energy_mJ"] == pytest.approx(1e3 * batch.energy)
    assert table["direction_x"] == pytest.approx(batch.tip_rotation[:, 0, 2])
    assert table["converged"].dtype == bool


def test_what_has_rows_has_a_table() -> None:
    pose = tubeopt.forward_kinematics(TWO_TUBE, [0.3, 1.0])
    path = tubeopt.follow(TWO_TUBE, [[0, 0], [0.5, 0]])
    space = tubeopt.workspace(TWO_TUBE, 20)
    assert len(columns(pose)["arc_length_mm"]) == len(pose.arc_length)
    assert columns(pose)["torsion_1_rad_per_m"] == pytest.approx(pose.torsion[0])
    assert columns(path)["rotation_1_deg"] == pytest.approx([0, np.degrees(0.5)])
    assert columns(space)["margin"] == pytest.approx(space.margin, nan_ok=True)
    with pytest.raises(InputError, match=r"a Tube has no rows to make a table of; what has: EquilibriumBatch"):
        columns(TWO_TUBE.tubes[0])


def test_csv_reads_back(batch: tubeopt.EquilibriumBatch, tmp_path: Path) -> None:
    path = tubeopt.save_table(batch, tmp_path / "table.csv")
    head, *rows = path.read_text(encoding="utf-8").splitlines()
    assert head.split(",") == list(columns(batch))
    assert len(rows) == len(batch)
    assert [float(row.split(",")[0]) for row in rows] == columns(batch)["rotation_1_deg"].tolist()
    with pytest.raises(InputError, match=r"must end in \.csv or \.parquet or \.mat"):
        tubeopt.save_table(batch, "table.xlsx")


def test_parquet_reads_back(batch: tubeopt.EquilibriumBatch, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    read = parquet.read_table(tubeopt.save_table(batch, tmp_path / "table.parquet"))
    for name, values in columns(batch).items():
        assert np.array_equal(read[name].to_numpy(), values)


def test_mat_reads_back(batch: tubeopt.EquilibriumBatch, tmp_path: Path) -> None:
    read = scipy.io.loadmat(tubeopt.save_table(batch, tmp_path / "table.mat"))
    for name, values in columns(batch).items():
        assert read[name].shape == (7, 1)
        assert np.array_equal(read[name][:, 0], values)


def test_a_sweep_for_matlab_has_texts_in_cells_and_names_that_matlab_allows(tmp_path: Path) -> None:
    stored = {"rotations_deg[0]": np.array([1.0, np.nan]), "status": np.array(["done", "failed"])}
    np.savez(tmp_path / "table.npz", **stored)  # type: ignore[arg-type]
    sweep = Sweep(2, 2, (), tmp_path / "table.csv", tmp_path / "table.npz", tmp_path / "journal.jsonl")
    read = scipy.io.loadmat(tubeopt.save_table(sweep, tmp_path / "table.mat"))
    assert np.array_equal(read["rotations_deg_0"], [[1.0], [np.nan]], equal_nan=True)
    assert [str(each[0]) for each in read["status"][:, 0]] == ["done", "failed"]
    assert matlab_names(["a[0]", "a.0", "0 b", "_c", "n" * 70]) == ["a_0", "a_0_2", "x_0_b", "c", "n" * 63]


def test_without_the_library_one_line_says_what_to_install(
    batch: tubeopt.EquilibriumBatch, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("pandas", "xarray", "pyarrow"):
        monkeypatch.setitem(__import__("sys").modules, name, None)
    for use in (tubeopt.to_dataframe, tubeopt.to_xarray, lambda b: tubeopt.save_table(b, tmp_path / "t.parquet")):
        with pytest.raises(InputError, match=r"python -m pip install 'tubeopt\[data\]'"):
            use(batch)


def test_data_frames_have_the_columns(batch: tubeopt.EquilibriumBatch) -> None:
    pytest.importorskip("pandas")
    frame = tubeopt.to_dataframe(batch)
    assert list(frame.columns) == list(columns(batch))
    assert frame["margin"].to_numpy() == pytest.approx(batch.margin)


def test_labelled_arrays_are_in_si(batch: tubeopt.EquilibriumBatch) -> None:
    pytest.importorskip("xarray")
    data = tubeopt.to_xarray(batch)
    assert data.tip_position.sel(axis="z").to_numpy() == pytest.approx(batch.tip_position[:, 2])
    assert data.rotations.sel(tube=2).to_numpy() == pytest.approx(batch.rotations[:, 1])
    assert (data.tip_position.units, data.rotations.units, data.margin.units) == ("m", "rad", "1")
    assert data.energy.units == "J"
