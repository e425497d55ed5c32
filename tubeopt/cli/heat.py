"""`tubeopt heat`: heating schedules for a tube on a rig, and the rig's calibration."""

from __future__ import annotations

from ..runs.calibration_studies import HeatingCalibrationStudy
from ..runs.heating_study import HeatingStudy
from ..shaping.heating.robust import CHARGES
from .flags import answer, asks
from .output import Output

DEFAULT_CHARGES = ",".join(f"{100 * charge:g}" for charge in CHARGES)

LOG = (
    "LOG.csv",
    "time_s, duty, and any of temperature_degC, voltage_V, current_A; or trials: duty, time_s, ramp_s, and result or "
    "spring_back_percent.",
)


@asks(
    HeatingStudy,
    arguments={"rig": ("RIG.yaml", "Rig file.")},
    defaults={"charges_percent": DEFAULT_CHARGES, "samples": "64"},
    example="tubeopt heat configs/rigs/thesis_calcium_silicate.yaml --out results",
)
def plan(study: HeatingStudy, output: Output) -> None:
    """The heating schedule that holds the curved part of a tube in the window: duties, temperatures, files.

    Ends with 3 where the window cannot be held within limit, ramp and currents; the best schedule and what would help
    are shown and saved all the same.
    """
    answer(study, output)


@asks(
    HeatingCalibrationStudy,
    arguments={"log": LOG},
    example="tubeopt heat calibrate configs/experiments/heating_log.csv "
    "--rig configs/rigs/thesis_calcium_silicate.yaml --out results",
)
def calibrate(study: HeatingCalibrationStudy, output: Output) -> None:
    """Loss and contacts of a rig from a logged heating, or from trials without a thermometer."""
    answer(study, output)
