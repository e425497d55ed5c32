"""The command line `tubeopt`: commands gathered, failures turned into a sentence and an exit code, in one place.

Exit codes: 0 done, 2 the input makes no sense, 3 no solution was found, 4 a motion was found but not proved in time,
130 interrupted. `certify` ends with 0 if the robot cannot snap, 3 if it can, and 4 if neither is known.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Annotated, NoReturn

import typer
from rich.console import Console

from .. import __version__
from ..errors import InputError, NotProvedError, SolveError
from ..stability import ASSUMING
from . import (
    design,
    doctor,
    fabricate,
    heat,
    inverse,
    kinematics,
    measure,
    mold,
    plan,
    robot,
    stability,
    study,
    sweep,
    validation,
    view,
    workspace,
)
from .options import App

BAD_INPUT, NO_SOLUTION, NOT_PROVED = 2, 3, 4

app = App(
    help="Concentric tube robots: where they go, whether they snap, how to build them.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_show_locals=False,
)
app.command(
    epilog="Example: tubeopt fk configs/robots/thesis_ctr.yaml --rotations-deg 0,57.3,114.6 --translations-mm 0,0,0"
)(kinematics.fk)
app.command(epilog="Example: tubeopt ik configs/robots/thesis_ctr.yaml --target-mm 50,30,150 --all --out results")(
    inverse.ik
)
app.command(epilog="Example: tubeopt equilibria configs/robots/two_tube.yaml --rotations-deg 190,0")(
    stability.equilibria
)
app.command(epilog="Example: tubeopt snap configs/robots/thesis_ctr.yaml --to-deg 360,0,0 --out results")(
    stability.snap
)
app.command(epilog="Example: tubeopt follow configs/robots/thesis_ctr.yaml configs/paths/turn_and_back.csv")(
    stability.follow
)
app.command(
    epilog=f"All is said {ASSUMING}.\n\nExample: tubeopt certify configs/robots/crl_ctr.yaml --translations-mm -20,0,0"
)(stability.certify)
app.command("stability-map", epilog="Example: tubeopt stability-map configs/robots/crl_ctr.yaml --out results")(
    stability.stability_map
)
app.command(epilog="Example: tubeopt run configs/studies/thesis_actuated.yaml --out results")(study.run)
app.command(
    epilog="Example: tubeopt validate configs/robots/thesis_etr.yaml configs/experiments/synthetic_etr.csv "
    "--fit curvature"
)(validation.validate)
app.command(
    epilog="Example: tubeopt measure configs/robots/crl_ctr.yaml --fit rotation_2,rotation_3,curvature_1 --count 12 "
    "--out results"
)(measure.measure)
app.command(epilog="Example: tubeopt design configs/studies/design_thesis_snap_free.yaml --out results")(design.design)
app.command(epilog="Example: tubeopt sweep configs/studies/sweep_tips.yaml --workers 1 --out results")(sweep.sweep)
app.command(epilog="Example: tubeopt workspace configs/robots/crl_ctr.yaml --samples 20000 --out results")(
    workspace.workspace
)
app.command(
    epilog="Example: tubeopt fabricate configs/robots/thesis_etr.yaml --rig configs/rigs/thesis_calcium_silicate.yaml "
    "--out results"
)(fabricate.fabricate)
app.add_typer(heat.app, name="heat")
app.command(epilog="Example: tubeopt view configs/robots/thesis_ctr.yaml --trajectory configs/paths/turn_and_back.csv")(
    view.view
)
app.command(epilog="Example: tubeopt plan configs/studies/plan_thesis_turn.yaml --out results")(plan.plan)
app.command(epilog=f"All is said {ASSUMING}.\n\nExample: tubeopt verify results/trajectory.csv --min-margin 0.05")(
    plan.verify
)
app.command(epilog="Example: tubeopt doctor")(doctor.doctor)
app.add_typer(mold.app, name="mold")
app.add_typer(robot.app, name="robot")


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"tubeopt {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    show_version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run one command; `arguments` default to those of the process. Ends with SystemExit."""
    try:
        app(arguments, prog_name="tubeopt")
    except InputError as error:
        _complain(error, BAD_INPUT)
    except SolveError as error:
        _complain(error, NO_SOLUTION)
    except NotProvedError as error:
        _complain(error, NOT_PROVED)
    sys.exit(0)


def _complain(error: Exception, code: int) -> NoReturn:
    console = Console(stderr=True)
    for line in str(error).splitlines():
        console.print("[bold red]error:[/]", end=" ")
        console.print(line, markup=False, highlight=False, soft_wrap=True)
    sys.exit(code)


if __name__ == "__main__":
    main()
