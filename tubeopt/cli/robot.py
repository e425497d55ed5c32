"""`tubeopt robot`: what a robot is made of, and whether it can be built."""

from __future__ import annotations

from ..robots.file import load_robot
from ..show.report import present
from ..show.reports import report
from .options import App, JsonOption, OutOption, RobotArgument

app = App(help="What a robot is made of.", no_args_is_help=True)


@app.command(epilog="Example: tubeopt robot show configs/robots/thesis_ctr.yaml")
def show(robot: RobotArgument, out: OutOption = None, as_json: JsonOption = False) -> None:
    """Stiffness, strain and fit of every tube, with warnings."""
    present(report(load_robot(robot)), out=out, as_json=as_json)
