"""`tubeopt heat`: heating schedules for a tube on a rig, and the rig's calibration."""

from __future__ import annotations

from ..runs.calibration_studies import HeatingCalibrationStudy
from ..runs.firmware_study import LedHeatingStudy
from ..runs.heating_run import LOG_FILE, HeatingRunStudy
from ..runs.heating_study import HeatingStudy
from ..shaping.heating.robust import CHARGES
from ..show.reports import report
from ..show.rig_page import with_live_page
from .flags import answer, asks
from .interruption import keeping
from .output import Output, can_be_saved, present

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
    example="tubeopt heat plan configs/rigs/thesis_calcium_silicate.yaml --out results",
)
def plan(study: HeatingStudy, output: Output) -> None:
    """The heating schedule that holds the curved part of a tube in the window: duties, temperatures, files.

    Ends with 3 where no schedule is found that holds the window within limit, ramp and currents; the best one and what
    would help are shown and saved all the same.
    """
    answer(study, output)


@asks(
    LedHeatingStudy,
    arguments={"rig": ("RIG.yaml", "Rig file.")},
    defaults={"objective": "margin"},
    example="tubeopt heat firmware configs/rigs/thesis_calcium_silicate.yaml --board uno --out results",
)
def firmware(study: LedHeatingStudy, output: Output) -> None:
    """A heating that a sensor leads: the law, how likely uncertain rigs keep the window, and the sketch for a board.

    The schedule is that of `tubeopt heat plan`; the law corrects it by what the sensor reads; its gains follow from the
    model.
    Ends with 3 where the schedule does not keep window, limit, ramp and currents on the rig as filed, or most uncertain
    rigs do not keep the window; everything is shown and saved all the same.
    """
    answer(study, output)


@asks(
    HeatingRunStudy,
    arguments={},
    example="tubeopt heat run --simulate configs/rigs/thesis_calcium_silicate.yaml --out results",
)
def run(study: HeatingRunStudy, output: Output) -> None:
    """Heat a tube: start the rig, show what it does, and log it for `tubeopt heat calibrate`.

    Ctrl-C stops the rig and ends with 130. Ends with 3 where the rig stopped before it was done, or where
    the sensor's reading missed the window in the hold.
    """
    can_be_saved(output.out)
    log = None if output.out is None else output.out / LOG_FILE

    def kept() -> str:
        saved = f"{log} holds what was reported so far" if log is not None and log.exists() else "nothing was saved"
        return f"the rig is told to stop; {saved}"

    with keeping(kept):
        found = with_live_page(study, output.out, shown=not output.quiet)
    present(report(found), output, written=() if found.log is None else (found.log,))


@asks(
    HeatingCalibrationStudy,
    arguments={"log": LOG},
    example="tubeopt heat calibrate configs/experiments/heating_log.csv "
    "--rig configs/rigs/thesis_calcium_silicate.yaml --out results",
)
def calibrate(study: HeatingCalibrationStudy, output: Output) -> None:
    """Loss and contacts of a rig from a logged heating, or from trials without a thermometer."""
    answer(study, output)
