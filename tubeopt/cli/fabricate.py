"""`tubeopt fabricate`: molds and heating schedules for every tube of a robot, in one go."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from ..robots.file import load_robot
from ..runs.fabrication import fabricate as plan_all
from ..runs.heating_study import Ensemble
from ..runs.mold_file import load_mold_spec
from ..runs.rig_file import load_rig
from ..shaping.heating.uncertainty import Uncertainty
from ..shaping.mold.spec import MoldSpec
from ..shaping.tube_fabrication import heating_for
from ..show.progress import working
from ..show.report import can_be_saved, present
from ..show.reports import report
from .heat import DEFAULT_CHARGES, ChargesOption, chosen_charges
from .options import JsonOption, RobotArgument


def fabricate(
    robot: RobotArgument,
    rig: Annotated[str, typer.Option("--rig", metavar="RIG.yaml", help="Rig file.", show_default=False)],
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Save the results into this directory.", show_default=False)
    ],
    mold: Annotated[
        str | None, typer.Option("--mold", metavar="MOLD.yaml", help="What is asked of the mold.", show_default=False)
    ] = None,
    hold_s: Annotated[
        float | None, typer.Option(help="Length of the hold; by default the mold file's, 60.", show_default=False)
    ] = None,
    objective: Annotated[str, typer.Option(help="time, energy or margin.")] = "time",
    charges_percent: ChargesOption = DEFAULT_CHARGES,
    samples: Annotated[int, typer.Option(help="Uncertain rigs in the ensemble; 0 for no band.")] = 32,
    as_json: JsonOption = False,
) -> None:
    """Molds and schedules for every tube of a robot: drawings, G-code, duties by the battery's voltage, pictures.

    The mold is drawn for the rig, and the heating planned on the rig with the mold as drawn. Ends with 3 where the
    window cannot be held within limit, ramp and currents for one of them, or where mold and heating do not agree;
    everything is shown and saved all the same.
    """
    made_of = load_robot(robot)
    heated_on = load_rig(rig)
    asked = MoldSpec() if mold is None else load_mold_spec(mold)
    spec = replace(heating_for(asked.heat), objective=objective)
    spec = spec if hold_s is None else replace(spec, hold_time=hold_s)
    charges = chosen_charges(charges_percent)
    can_be_saved(out)
    ensemble = Ensemble(Uncertainty(), samples) if samples else None
    with working("planning molds and schedules") as progress:
        answer = plan_all(made_of, heated_on, asked, spec, charges=charges, ensemble=ensemble, progress=progress)
    present(report(answer), out=out, as_json=as_json)
