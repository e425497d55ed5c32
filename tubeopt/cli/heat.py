"""`tubeopt heat run`: a heating on a rig, shown and logged while it runs."""

from __future__ import annotations

from ..runs.heating_run import LOG_FILE, HeatingRunStudy
from ..show.reports import report
from ..show.rig_page import with_live_page
from .flags import asks
from .interruption import keeping
from .output import Output, can_be_saved, present


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

    def _kept() -> str:
        saved = f"{log} holds what was reported so far" if log is not None and log.exists() else "nothing was saved"
        return f"the rig is told to stop; {saved}"

    with keeping(_kept):
        found = with_live_page(study, output.out, shown=not output.quiet)
    present(report(found), output, written=() if found.log is None else (found.log,))
