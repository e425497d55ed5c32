"""`tubeopt view`: the robot under your hands, in a browser."""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console

from ..errors import InputError
from ..files.units import parse_number
from ..robots.file import load_robot
from ..robots.path_file import Waypoints as Way
from ..runs.base import Study, metres, radians
from ..runs.inverse_study import InverseStudy
from ..runs.obstacle_file import load_obstacles
from ..runs.plan_study import PlanStudy
from ..runs.stability_studies import EquilibriaStudy, FollowStudy, SnapStudy
from ..runs.study_file import ForwardKinematicsStudy, load_study
from ..show.report import can_be_saved, has_display, to_text
from ..show.viewer import View, serve
from ..show.viewer.host import LOCAL, LOCAL_NAMES
from ..show.viewer.playback import Waypoints, load_waypoints, paced
from .options import JsonOption, OutOption, RobotArgument


def view(
    robot: RobotArgument,
    study: Annotated[
        str | None, typer.Option(metavar="STUDY.yaml", help="Begin at the joint values of a study, or play its path.")
    ] = None,
    trajectory: Annotated[
        str | None,
        typer.Option(metavar="PATH.csv", help="To be played: rotation_1_deg, ..., translation_1_mm, ..., time_s."),
    ] = None,
    obstacles: Annotated[
        str | None, typer.Option(metavar="OBSTACLES.yaml", help="Bodies to draw, and to keep away from when led.")
    ] = None,
    port: Annotated[str, typer.Option(metavar="N", help="Where to listen; 0 takes any that is free.")] = "8080",
    host: Annotated[
        str, typer.Option(metavar="ADDRESS", help="Listen on another address: others can then move the robot.")
    ] = LOCAL,
    browse: Annotated[bool, typer.Option("--open/--no-open", help="Open the page where there is a display.")] = True,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """The robot in a browser: turn and slide its tubes, lead its tip, watch it snap, change its design.

    Every tab of the browser has a robot of its own. Ends on Ctrl-C. With --json one object with the address of the page
    is printed; with --out whatever is saved in the browser goes into that directory too.
    """
    number = _port(port)
    shown = View(load_robot(robot), out=out)
    if study is not None:
        shown = _with_study(shown, robot, study)
    if trajectory is not None:
        shown = replace(shown, waypoints=load_waypoints(trajectory, shown.robot))
    if obstacles is not None:
        shown = replace(shown, obstacles=load_obstacles(obstacles))
    can_be_saved(out)
    messages = Console(stderr=True)
    if host not in LOCAL_NAMES:
        messages.print(
            f"[bold yellow]warning:[/] everyone who can reach {host} can move this robot and see what is shown; "
            "there is no password and no encryption",
            soft_wrap=True,
        )

    def ready(address: str) -> None:
        if as_json:
            print(to_text({"url": address, "robot": shown.robot.name}), end="", flush=True)
        else:
            print(f"showing {shown.robot.name or robot} at {address}   (Ctrl-C to stop)", flush=True)
        if browse and not as_json and has_display():
            typer.launch(address)

    serve(shown, host=host, port=number, ready=ready)
    if not as_json:
        print("stopped", file=sys.stderr)


def _port(text: str) -> int:
    number = parse_number(text)
    if isinstance(number, str) or not number.is_finite() or not 0 <= number <= 65535 or number != int(number):
        raise InputError(f"--port is {text}; it must be a whole number from 0 to 65535")
    return int(number)


def _with_study(shown: View, robot: str, path: str) -> View:
    """The view from where a study asks its question."""
    study: Any = load_study(path)
    own = getattr(study, "robot", None)
    if own is None:
        raise InputError(f"{path}: a study of kind {study.kind} has no robot to be shown")
    if own != shown.robot:
        raise InputError(f"{path}: its robot is another one than {robot}")
    return replace(shown, **_begins(study, path))


def _begins(study: Study, path: str) -> dict[str, Any]:
    """What a study says of the view: joint values to begin with, a path to play, obstacles, margin."""
    if isinstance(study, ForwardKinematicsStudy | EquilibriaStudy):
        at_home = np.zeros(study.robot.n_tubes), study.robot.home_translations
        return _joints(radians(study.rotations_deg, at_home[0]), metres(study.translations_mm, at_home[1]))
    if isinstance(study, FollowStudy):
        return {"waypoints": _timed(study.path)}
    if isinstance(study, SnapStudy):
        at_home = np.zeros(study.robot.n_tubes), study.robot.home_translations
        return _joints(radians(study.from_deg, at_home[0]), metres(study.from_mm, at_home[1]))
    if isinstance(study, InverseStudy):
        out: dict[str, Any] = {"obstacles": study.obstacles or (), "min_margin": float(study.min_margin)}
        return out | (_joints(*study.start) if study.start is not None else {})
    if isinstance(study, PlanStudy):
        at_home = np.zeros(study.robot.n_tubes), study.robot.home_translations
        out = {"obstacles": study.bodies(), "min_margin": float(study.min_margin)}
        return out | _joints(radians(study.start_deg, at_home[0]), metres(study.start_mm, at_home[1]))
    raise InputError(f"{path}: a study of kind {study.kind} says nothing to begin with; it must be {', '.join(KINDS)}")


KINDS = ("forward_kinematics", "equilibria", "follow", "snap", "inverse_kinematics", "plan")
"""Studies that say where to begin."""


def _joints(rotations: Any, translations: Any) -> dict[str, Any]:
    return {"rotations": rotations, "translations": translations}


def _timed(way: Way) -> Waypoints:
    return Waypoints(paced(way.rotations, way.translations), way.rotations, way.translations)
