"""Answers as tables: data frames, labelled arrays, Parquet, MATLAB and CSV.

What has many rows is described once, variable by variable: over which dimensions it runs, and which columns with which
units it fills in a flat table. A data frame and a Parquet, MATLAB or CSV file have these columns; an xarray data set
has the variables themselves, in SI.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy

from ..arguments import typed
from ..equilibrium.batch import EquilibriumBatch
from ..equilibrium.result import Equilibrium
from ..errors import InputError, import_extra
from ..files.csv_file import to_csv
from ..files.files import atomic_write, write_text
from ..files.units import SIGNS, per_si, unit_of
from ..planning import Trajectory
from ..runs.sweeping import Sweep
from ..stability import Path as JointPath
from ..typing import Array
from ..workspaces import Workspace

if TYPE_CHECKING:
    import pandas
    import xarray

SI = {"mm": "m", "deg": "rad", "mJ": "J"}
"""Unit of a column -> different unit of the variable in SI."""

FORMATS = ("csv", "parquet", "mat")

LONGEST_NAME = 63
"""Characters of a name in MATLAB."""


class Variable(NamedTuple):
    """Variable of an answer.

    Args:
        name: of the variable, and by default of the attribute that holds it.
        column: name of its columns with their unit; "{}" is the number of a tube, from 1, or the name of an axis.
        inner: the dimension besides that of the rows, "tube" or "axis"; "" for one number per row.
        get: answer -> (rows,) or (rows, inner) numbers in SI.
    """

    name: str
    column: str
    inner: str = ""
    get: Callable[[Any], Any] | None = None

    def values(self, answer: Any) -> np.ndarray:
        """Values in SI, one row per row of the table."""
        return np.asarray(getattr(answer, self.name) if self.get is None else self.get(answer))

    @property
    def unit(self) -> str:
        """Unit of the columns."""
        return unit_of(self.column.replace("_{}", ""))


JOINTS = (Variable("rotations", "rotation_{}_deg", "tube"), Variable("translations", "translation_{}_mm", "tube"))
TIP = Variable("tip_position", "tip_{}_mm", "axis")
MARGIN = Variable("margin", "margin")


def _at_waypoints(variable: Variable) -> Variable:
    return variable._replace(get=lambda path: np.array([getattr(e, variable.name) for e in path.equilibria]))


ENERGY = Variable("energy", "energy_mJ")

TABLES: Mapping[type, tuple[str, tuple[Variable, ...]]] = {
    EquilibriumBatch: (
        "configuration",
        (
            *JOINTS,
            TIP,
            Variable("tip_direction", "direction_{}", "axis", lambda batch: batch.tip_rotation[:, :, 2]),
            Variable("tip_rotations", "tip_rotation_{}_deg", "tube"),
            MARGIN,
            ENERGY,
            Variable("tip_error", "tip_error_mm"),
            Variable("converged", "converged"),
        ),
    ),
    Workspace: ("sample", (*JOINTS, TIP, Variable("tip_direction", "direction_{}", "axis"), MARGIN)),
    JointPath: ("waypoint", tuple(map(_at_waypoints, (*JOINTS, TIP, MARGIN, ENERGY)))),
    Trajectory: (
        "instant",
        (Variable("time", "time_s"), *JOINTS, TIP, MARGIN, Variable("clearance", "clearance_mm")),
    ),
    Equilibrium: (
        "point",
        (
            Variable("arc_length", "arc_length_mm"),
            Variable("position", "{}_mm", "axis"),
            Variable("rotation", "rotation_{}_deg", "tube", lambda e: e.rotation.T),
            Variable("torsion", "torsion_{}_rad_per_m", "tube", lambda e: e.torsion.T),
        ),
    ),
}
"""Kind of answer -> meaning of a row, and its variables."""

INNER: Mapping[str, Callable[[int], list[Any]]] = {
    "tube": lambda count: list(range(1, count + 1)),
    "axis": lambda count: list("xyz"[:count]),
}
"""Dimension -> the names of its members."""


def columns(answer: Any) -> dict[str, Array]:
    """The flat table of an answer: name with its unit -> a number per row, in that unit.

    Raises:
        InputError: the answer has no rows: it is none of a batch, workspace, sweep, path, trajectory or equilibrium.
    """
    if isinstance(answer, Sweep):
        with np.load(answer.arrays) as stored:
            return {name: stored[name] for name in stored.files}
    named: dict[str, Array] = {}
    for variable in _description(answer)[1]:
        values = variable.values(answer)
        # Times a factor, true would become 1.
        shown = values if values.dtype == bool else values * per_si(variable.unit)
        if not variable.inner:
            named[variable.column] = shown
            continue
        for k, name in enumerate(INNER[variable.inner](values.shape[1])):
            named[variable.column.format(name)] = shown[:, k]
    return named


def to_dataframe(answer: Any) -> pandas.DataFrame:
    """An answer with many rows as a pandas data frame; the columns end in their units.

    Args:
        answer: a batch, workspace, sweep, followed path or trajectory, or an equilibrium (a row per point of the arm).

    Raises:
        InputError: another kind of answer, or pandas is not installed.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> pose = tubeopt.forward_kinematics(robot, [0.0, 1.0, 2.0])
        >>> tubeopt.to_dataframe(pose).columns.tolist()[:4]
        ['arc_length_mm', 'x_mm', 'y_mm', 'z_mm']
    """
    frame: pandas.DataFrame = import_extra("pandas", "data", "data frames").DataFrame(columns(answer))
    return frame


def to_xarray(answer: Any) -> xarray.Dataset:
    """An answer with many rows as labelled arrays in SI; every variable has its unit as attribute `units`.

    Args:
        answer: as for `to_dataframe`, without sweeps: their columns have mixed types.

    Raises:
        InputError: another kind of answer, or xarray is not installed.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> pose = tubeopt.forward_kinematics(robot, [0.0, 1.0, 2.0])
        >>> tubeopt.to_xarray(pose).position.dims
        ('point', 'axis')
    """
    library = import_extra("xarray", "data", "labelled arrays")
    row, variables = _description(answer)
    data, labels = {}, {}
    for variable in variables:
        values = variable.values(answer)
        if variable.inner:
            labels[variable.inner] = INNER[variable.inner](values.shape[1])
        unit = SI.get(variable.unit, SIGNS.get(variable.unit, variable.unit)).replace("_", " ")
        data[variable.name] = ((row, variable.inner) if variable.inner else (row,), values, {"units": unit or "1"})
    dataset: xarray.Dataset = library.Dataset(data, coords=labels, attrs={"robot": _robot(answer)})
    return dataset


@typed
def save_table(answer: Any, path: str | PathLike[str]) -> Path:
    """Write the flat table of an answer as .csv, .parquet or .mat, whole or not at all; return the path.

    A .mat file has a column vector for each column of numbers, and a cell array for each of texts.

    Raises:
        InputError: an answer without rows, another ending, a file that cannot be written, or pyarrow is not installed.

    Examples:
        >>> import tempfile
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/two_tube.yaml")
        >>> batch = tubeopt.forward_kinematics_batch(robot, [[0.0, 0.0], [0.5, 0.0]])
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     tubeopt.save_table(batch, f"{folder}/batch.csv").name
        'batch.csv'
    """
    path = Path(path)
    kind = path.suffix.lower().removeprefix(".")
    if kind not in FORMATS:
        raise InputError(f"the table's name is {str(path)!r}; it must end in .{' or .'.join(FORMATS)}")
    table = columns(answer)
    if kind == "csv":
        rows = zip(*(values.tolist() for values in table.values()), strict=True)
        write_text(path, to_csv(list(table), ([_cell(value) for value in row] for row in rows)))
        return path
    if kind == "mat":
        named = zip(matlab_names(table), table.values(), strict=True)
        with atomic_write(path) as temporary:
            scipy.io.savemat(temporary, {name: _matlab(values) for name, values in named}, oned_as="column")
        return path
    arrow, parquet = (import_extra(name, "data", "Parquet files") for name in ("pyarrow", "pyarrow.parquet"))
    with atomic_write(path) as temporary:
        parquet.write_table(arrow.table({name: arrow.array(values) for name, values in table.items()}), temporary)
    return path


def matlab_names(columns: Iterable[str]) -> list[str]:
    """Names of columns as MATLAB allows them: "robot.tubes[0].length_mm" is robot_tubes_0_length_mm."""
    names: list[str] = []
    for column in columns:
        plain = re.sub(r"\W+", "_", column, flags=re.ASCII).strip("_")
        plain = (plain if plain[:1].isalpha() else f"x_{plain}")[:LONGEST_NAME]
        name, count = plain, 1
        # Shortened or cleaned names may coincide.
        while name in names:
            count += 1
            name = f"{plain[: LONGEST_NAME - len(str(count)) - 1]}_{count}"
        names.append(name)
    return names


def _matlab(values: Array) -> Array:
    """Numbers and truth values unchanged, anything else as text."""
    # savemat writes an array of objects as a cell array.
    return values if values.dtype.kind in "biuf" else np.array([str(value) for value in values], dtype=object)


def _cell(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    # NaN differs from itself; in CSV it is an empty cell.
    return "" if value != value else str(value)


def _description(answer: Any) -> tuple[str, tuple[Variable, ...]]:
    if type(answer) not in TABLES:
        kinds = ", ".join(kind.__name__ for kind in (*TABLES, Sweep))
        raise InputError(f"a {type(answer).__name__} has no rows to make a table of; what has: {kinds}")
    return TABLES[type(answer)]


def _robot(answer: Any) -> str:
    robot = answer.equilibria[0].robot if isinstance(answer, JointPath) else answer.robot
    return robot.name or "robot"
