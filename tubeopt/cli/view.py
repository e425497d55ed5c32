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
from ..show.viewer.view import ViewerWaypoints, load_waypoints, without_times
from ..typing import Array
from .flags import study_command
from .interruption import handling_interruption
from .messages import LOGGER
from .output import OF_PICTURES, Output, can_be_saved, has_display, print_address


class ViewEntry(Loaded):
    """Robot in the viewer, with its start."""

    robot: RobotPath
    study: Annotated[tuple[str, Study], in_file(load_study, "a study file", named=True)] | None = Field(
        None, description="study file; start at its joint values, or play its path", examples=["STUDY.yaml"]
    )
    trajectory: Annotated[ViewerWaypoints, in_file(load_waypoints, "a CSV file", of="robot")] | None = Field(
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


@study_command(
    ViewEntry,
    example="tubeopt view thesis_ctr --trajectory turn_and_back",
    without=OF_PICTURES,
)
def view(study: ViewEntry, output: Output, robot: str) -> None:
    """Move the robot in a browser: joints, tip, snaps, design changes, playback.

    Each browser tab has its own robot. Ctrl-C ends the server. --json prints one object with the address of the page.
    With --out, files saved in the browser are also written to DIR.
    """
    entry = study
    shown = View(entry.robot, out=output.out, obstacles=entry.obstacles)
    if entry.study is not None:
        path, start = entry.study
        robot_of_start = getattr(start, "robot", None)
        if robot_of_start is None:
            raise InputError(f"{path}: a study of kind {start.kind} has no robot to be shown")
        if robot_of_start != shown.robot:
            raise InputError(f"{path}: the robot of the study differs from {robot}")
        shown = replace(shown, **_start_of(start, path))
    # Flags replace the keys of the study.
    flags: dict[str, Any] = {"load": entry.external_load, "waypoints": entry.trajectory}
    shown = replace(shown, **{name: value for name, value in flags.items() if value is not None})
    can_be_saved(output.out)
    shown.session()  # an invalid start is reported here, not in every browser tab
    if entry.host not in LOCAL_NAMES:
        LOGGER.warning(
            f"everyone who can reach {entry.host} can move this robot and see what is shown; there is no password and "
            "no encryption"
        )

    def _ready(address: str) -> None:
        print_address(Viewed(shown.robot, address, shown.robot.name or robot), output)
        if entry.open and has_display() and not output.as_json:
            typer.launch(address)

    with handling_interruption():
        serve(shown, host=entry.host, port=entry.port, ready=_ready)
    if not (output.as_json or output.quiet):
        print("stopped", file=sys.stderr)


def _start_of(study: Study, path: str) -> dict[str, Any]:
    """Fields of the view from a study: start configuration, path to play, obstacles, margin."""
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
"""Kinds of studies with a start configuration."""


def _joints(joints: tuple[Array, Array] | None) -> dict[str, Any]:
    return {} if joints is None else dict(zip(("rotations", "translations"), joints, strict=True))
