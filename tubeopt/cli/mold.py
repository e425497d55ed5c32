"""`tubeopt mold`: molds for the tubes of a robot, spring-back from trials, materials side by side."""

from __future__ import annotations

from ..runs.calibration_studies import MoldCalibrationStudy
from ..runs.mold_study import MandrelStudy, MaterialsStudy, MoldStudy, PegStudy
from .flags import answer, asks
from .output import Output


@asks(MoldStudy, example="tubeopt mold plan configs/robots/thesis_etr.yaml --out results")
def plan(study: MoldStudy, output: Output) -> None:
    """The mold for the tubes of a robot: DXF, SVG, STL, G-code and a set-up sheet."""
    answer(study, output)


@asks(MandrelStudy, example="tubeopt mold mandrel configs/robots/example_pieces.yaml --tube 1 --out results")
def mandrel(study: MandrelStudy, output: Output) -> None:
    """The mandrel for a helix or another space curve: STL, table of rotation and feed, G-code for a 4th axis."""
    answer(study, output)


@asks(PegStudy, example="tubeopt mold pegs configs/robots/thesis_etr.yaml --out results")
def pegs(study: PegStudy, output: Output) -> None:
    """An adjustable mold: where pegs go on a board that is drilled once; table, DXF, SVG, G-code of the board."""
    answer(study, output)


@asks(
    MoldCalibrationStudy,
    arguments={"trials": ("TRIALS.csv", "Columns mold_radius_mm and obtained_radius_mm.")},
    example="tubeopt mold calibrate configs/molds/example_trials.csv --out results",
)
def calibrate(study: MoldCalibrationStudy, output: Output) -> None:
    """Spring-back from trials: how much of the mold's curvature tubes lose."""
    answer(study, output)


@asks(
    MaterialsStudy,
    arguments={"robot": ("[ROBOT.yaml]", "Robot whose tube it is.")},
    example="tubeopt mold materials configs/robots/thesis_ctr.yaml --tube 1",
)
def materials(study: MaterialsStudy, output: Output) -> None:
    """Mold materials for a tube, best first: heat drawn, limit temperature, current that leaks, and why."""
    answer(study, output)
