"""`tubeopt heat run`: a heating on a rig, shown and logged while it runs."""

from __future__ import annotations

from ..runs.heating_run import LOG_FILE, HeatingRunStudy
from ..show.reports import report
from ..show.rig_page import with_live_page
from .flags import asks
from .interruption import keeping
from .output import OF_PICTURES, Output, can_be_saved, present


@asks(
    HeatingRunStudy,
    arguments={},
    example="tubeopt heat run --simulate configs/rigs/thesis_calcium_silicate.yaml --out results",
    without=OF_PICTURES,
)
def run(study: HeatingRunStudy, output: Output) -> None:
    """Heat a tube on a rig or a simulated rig: start it, show it live, and log it for `tubeopt heat calibrate`.

    Ctrl-C stops the rig (exit code 130). Exit code 3: the rig stopped early, or the sensor reading left the window
    during the hold time.
    """
    can_be_saved(output.out)
    log = None if output.out is None else output.out / LOG_FILE

    def _kept() -> str:
        saved = f"{log} has the log up to now" if log is not None and log.exists() else "nothing was saved"
        return f"the rig stops; {saved}"

    with keeping(_kept):
        found = with_live_page(study, output.out, shown=not output.quiet)
    present(report(found), output, written=() if found.log is None else (found.log,))
