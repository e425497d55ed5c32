"""`tubeopt equilibria`, `snap`, `follow`, `certify` and `stability-map`: what is stable, and where the robot snaps."""

from __future__ import annotations

from dataclasses import replace

from ..runs.stability_studies import CertifyStudy, EquilibriaStudy, FollowStudy, SnapStudy, StabilityMapStudy
from ..show.report import present
from ..show.reports import report
from .flags import ROBOT, ask, asks
from .options import JsonOption, OutOption

WAYPOINTS = (
    "PATH.csv",
    "Waypoints, with the columns rotation_1_deg, rotation_2_deg, ... in deg and, where tubes slide, translation_1_mm, "
    "... in mm; a row per waypoint.",
)


@asks(EquilibriaStudy)
def equilibria(study: EquilibriaStudy, out: OutOption = None, as_json: JsonOption = False) -> None:
    """Every equilibrium at given joint values, stable and unstable, the lowest energy first."""
    present(report(ask(study, "searching equilibria", out)), out=out, as_json=as_json)


@asks(SnapStudy)
def snap(study: SnapStudy, out: OutOption = None, as_json: JsonOption = False) -> None:
    """The first snap on the straight way from one set of joint values to another, computed exactly."""
    present(report(ask(study, "looking for the snap", out)), out=out, as_json=as_json)


@asks(FollowStudy, arguments={"robot": ROBOT, "path": WAYPOINTS})
def follow(study: FollowStudy, out: OutOption = None, as_json: JsonOption = False) -> None:
    """Slow motion through waypoints, with its history: where the robot snaps and where it lands."""
    present(report(ask(study, "following the path", out)), out=out, as_json=as_json)


@asks(CertifyStudy)
def certify(study: CertifyStudy, robot: str, out: OutOption = None, as_json: JsonOption = False) -> None:
    """Whether the robot can snap at any rotation: what is proved, and what search finds.

    Ends with 0 if it cannot snap, 3 if it can, 4 if neither is known; with a box, at the translations of its least
    certificate that was found. With a force, 0 is only for what is proved under it.
    """
    answer = replace(ask(study, "looking for snaps", out), robot_file=robot)
    present(report(answer), out=out, as_json=as_json)


@asks(StabilityMapStudy)
def stability_map(study: StabilityMapStudy, out: OutOption = None, as_json: JsonOption = False) -> None:
    """The margin over the rotations of two tubes turned together from home, and where the robot snaps."""
    present(report(ask(study, "mapping the margin", out)), out=out, as_json=as_json)
