"""Molds as YAML: what is asked of a mold, its material and spring-back; and trials of spring-back in CSV."""

from __future__ import annotations

from dataclasses import dataclass, replace
from os import PathLike
from typing import Annotated, Any, Literal

from pydantic import Field

from ..files.checked import Positive, check
from ..files.csv_file import read_csv
from ..files.fields import Part, asking, to_data
from ..files.units import MM, TO_MM, in_unit
from ..files.yaml_file import load_yaml, save_yaml
from ..shaping.mold.spec import MoldSpec
from ..shaping.mold.springback import RADII, Calibration, Springback
from ..typing import Array

TRIAL_COLUMNS = ("mold_radius_mm", "obtained_radius_mm")
NOTE = "note"


@asking(Springback)
class SpringbackEntry(Part):
    """Fraction of the mold's curvature that a tube loses: obtained = mold (1 - fraction - slope mold)."""

    radius_range_mm: Annotated[list[Positive], Field(min_length=2, max_length=2)] | None = Field(
        default=None, description="smallest and largest mold radius of the trials"
    )

    def build(self) -> Springback:
        """The spring-back, with the range of the trials that it is from."""
        back: Springback = super().build()
        if self.radius_range_mm is None:
            return back
        radii = self.si("radius_range_mm")
        return replace(back, curvature_range=(1 / max(radii), 1 / min(radii)))


@asking(MoldSpec)
class MoldEntry(Part):
    """Material, fit, plates and tools of a mold; every key has a default."""

    kind: Literal["mold"]
    springback: SpringbackEntry = Field(default_factory=SpringbackEntry)


MOLD_KINDS = {"mold": MoldEntry}
"""What the key `kind` of a mold file may say."""


def load_mold_spec(path: str | PathLike[str]) -> MoldSpec:
    """The specification in a YAML file; raises InputError for what makes none: one line for every problem."""
    return mold_spec_from_dict(load_yaml(path), path)


def mold_spec_from_dict(data: object, where: str | PathLike[str] = "") -> MoldSpec:
    """The specification that `data`, with the keys of a mold file, describes; raises InputError as `load_mold_spec`."""
    spec: MoldSpec = check(MoldEntry, data, where).build()
    return spec


def load_springback(path: str | PathLike[str]) -> Springback:
    """The spring-back in a YAML file that `save_springback` wrote; raises InputError for what makes none."""
    return check(SpringbackEntry, load_yaml(path), path).build()


def springback_to_dict(back: Springback) -> dict[str, Any]:
    """A spring-back with the keys and units of a mold file."""
    data = to_data(back)
    if back.curvature_range is not None:
        low, high = back.curvature_range
        data["radius_range_mm"] = [in_unit(1 / high, MM), in_unit(1 / low, MM)]
    return data


def save_springback(calibration: Calibration, path: str | PathLike[str]) -> None:
    """Write the fitted spring-back as YAML, to stand under the key `springback` of a mold file or for --springback;
    raises InputError where that cannot be."""
    trials = len(calibration.mold_curvature)
    save_yaml(path, springback_to_dict(calibration.springback), f"Spring-back of tubes, from {trials} trials.")


@dataclass(frozen=True, eq=False)
class Trials:
    """Trials of spring-back."""

    mold_radius: Array
    """(N,) m."""
    obtained_radius: Array
    """(N,) m, of the tubes that came out."""


def load_trials(path: str | PathLike[str]) -> Trials:
    """The trials in a CSV file with the columns `mold_radius_mm`, `obtained_radius_mm` and, for any text, `note`.

    Raises:
        InputError: no such file, a column that is unknown or missing, a cell that is no positive number: one line for
            every problem.
    """
    table = read_csv(path, (*TRIAL_COLUMNS, NOTE))
    table.expect(TRIAL_COLUMNS, [NOTE])
    radii = table.numbers(TRIAL_COLUMNS, MM)
    for row in range(len(table.rows)):
        for k, column in enumerate(TRIAL_COLUMNS):
            if not RADII[0] <= radii[row, k] <= RADII[1] and not any(
                f"row {row + 1} " in problem and column in problem for problem in table.problems
            ):
                allowed = f"it must be {RADII[0] * TO_MM:g} to {RADII[1] * TO_MM:g}, as radii of curved tubes are"
                table.complain(row, column, f"is {table.cell(row, column)}; {allowed}")
    table.check()
    return Trials(radii[:, 0], radii[:, 1])
