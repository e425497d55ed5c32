"""`tubeopt view`: the interactive viewer in a browser."""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Annotated, Any

import typer
from pydantic import Field

from ..errors import InputError
from ..files.checked import Whole, in_file
from ..runs.inverse_study import InverseStudy
from ..runs.plan_study import PlanStudy
from ..runs.robot_keys import Loaded, Posed, RobotPath, joints_of
from ..runs.stability_studies import SnapStudy
from ..runs.study_file import Study, load_study
from ..runs.surroundings_file import Bodies
from ..show.command_report import Viewed
from ..show.viewer import View, serve
from ..show.viewer.host import LOCAL, LOCAL_NAMES
from ..show.viewer.view import Waypoints, load_waypoints, without_times
from ..typing import Array
from .flags import asks
from .interruption import left_alone
from .messages import LOGGER
from .output import OF_PICTURES, Output, can_be_saved, has_display, told


class ViewEntry(Loaded):
    """A robot to be shown, with what it begins with."""

    robot: RobotPath
    study: Annotated[tuple[str, Study], in_file(load_study, "a study file", named=True)] | None = Field(
        None, description="study file; start at its joint values, or play its path", examples=["STUDY.yaml"]
    )
    trajectory: Annotated[Waypoints, in_file(load_waypoints, "a CSV file", of="robot")] | None = Field(
        None,
        description="CSV file of a trajectory to play, with columns rotation_1_deg, ..., translation_1_mm, ..., time_s",
        examples=["PATH.csv"],
    )
    obstacles: Bodies = Field(
        (),
        description="obstacles to draw and to avoid when the tip is dragged: a YAML file or a list of bodies",
        examples=["OBSTACLES.yaml"],
    )
    port: Annotated[Whole, Field(ge=0, le=65535)] = Field(
        8080, description="TCP port of the server; 0 selects a free port"
    )
    host: str = Field(
        LOCAL,
        description="network address of the server; with another one than the "
        "default, other computers can move the robot",
        examples=["ADDRESS"],
    )
    open: bool = Field(True, description="open the page in a browser if there is a display")


@asks(
    ViewEntry,
    example="tubeopt view thesis_ctr --trajectory turn_and_back",
    without=OF_PICTURES,
)
def view(study: ViewEntry, output: Output, robot: str) -> None:
    """Move the robot in a browser: joints, tip, snaps, design changes, playback.

    Each browser tab has its own robot. Ctrl-C ends the server. --json prints one object with the address of the page.
    With --out, files saved in the browser are also written to DIR.
    """
    asked = study
    # What is typed replaces what the study has.
    given: dict[str, Any] = {"load": asked.external_load, "waypoints": asked.trajectory}
    shown = View(asked.robot, out=output.out, obstacles=asked.obstacles)
    if asked.study is not None:
        shown = _with_study(shown, robot, *asked.study)
    shown = replace(shown, **{name: value for name, value in given.items() if value is not None})
    can_be_saved(output.out)
    shown.session()  # what cannot be shown is refused here, in place of in every tab
    if asked.host not in LOCAL_NAMES:
        LOGGER.warning(
            f"everyone who can reach {asked.host} can move this robot and see what is shown; there is no password and "
            "no encryption"
        )

    def _ready(address: str) -> None:
        told(Viewed(shown.robot, address, shown.robot.name or robot), output)
        if asked.open and has_display() and not output.as_json:
            typer.launch(address)

    with left_alone():
        serve(shown, host=asked.host, port=asked.port, ready=_ready)
    if not (output.as_json or output.quiet):
        print("stopped", file=sys.stderr)


def _with_study(shown: View, robot: str, path: str, study: Any) -> View:
    """The view from where a study asks its question."""
    own = getattr(study, "robot", None)
    if own is None:
        raise InputError(f"{path}: a study of kind {study.kind} has no robot to be shown")
    if own != shown.robot:
        raise InputError(f"{path}: the robot of the study differs from {robot}")
    return replace(shown, **_begins(study, path))


def _begins(study: Study, path: str) -> dict[str, Any]:
    """What a study says of the view: joint values to begin with, a path to play, obstacles, margin."""
    if isinstance(study, Posed) and study.kind in ("forward_kinematics", "equilibria"):
        return _joints(study.joints)
    if study.kind == "follow":
        followed: Any = study
        return {"waypoints": without_times(followed.robot, followed.path)}
    if isinstance(study, SnapStudy):
        return _joints(joints_of(study.robot, study.si("from_deg"), study.si("from_mm")))
    if isinstance(study, InverseStudy | PlanStudy):
        return {"obstacles": study.bodies, "min_margin": study.si("min_margin")} | _joints(study.start)
    raise InputError(
        f"{path}: a study of kind {study.kind} has no start configuration; it must be of kind {', '.join(KINDS)}"
    )


KINDS = ("forward_kinematics", "equilibria", "follow", "snap", "inverse_kinematics", "plan")
"""Studies that say where to begin."""


def _joints(joints: tuple[Array, Array] | None) -> dict[str, Any]:
    return {} if joints is None else dict(zip(("rotations", "translations"), joints, strict=True))
