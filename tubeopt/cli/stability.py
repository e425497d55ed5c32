"""`tubeopt equilibria`, `snap`, `follow`, `certify` and `stability-map`: what is stable, and where the robot snaps."""

from __future__ import annotations

from dataclasses import replace

from ..runs.stability_studies import CertifyStudy, EquilibriaStudy, FollowStudy, SnapStudy, StabilityMapStudy
from ..show.reports import report
from ..stability import ASSUMING
from .flags import ROBOT, answer, ask, asks
from .output import Output, present

WAYPOINTS = (
    "PATH.csv",
    "Waypoints, with the columns rotation_1_deg, rotation_2_deg, ... in deg and, where tubes slide, translation_1_mm, "
    "... in mm; a row per waypoint.",
)


@asks(EquilibriaStudy, example="tubeopt equilibria configs/robots/two_tube.yaml --rotations-deg 190,0")
def equilibria(study: EquilibriaStudy, output: Output) -> None:
    """Every equilibrium at given joint values, stable and unstable, the lowest energy first."""
    answer(study, output)


@asks(SnapStudy, example="tubeopt snap configs/robots/thesis_ctr.yaml --to-deg 360,0,0 --out results")
def snap(study: SnapStudy, output: Output) -> None:
    """The first snap on the straight way from one set of joint values to another, computed exactly."""
    answer(study, output)


@asks(
    FollowStudy,
    arguments={"robot": ROBOT, "path": WAYPOINTS},
    example="tubeopt follow configs/robots/thesis_ctr.yaml configs/paths/turn_and_back.csv",
)
def follow(study: FollowStudy, output: Output) -> None:
    """Slow motion through waypoints, with its history: where the robot snaps and where it lands."""
    answer(study, output)


@asks(
    CertifyStudy,
    example="tubeopt certify configs/robots/crl_ctr.yaml --translations-mm -20,0,0",
    note=f"All is said {ASSUMING}.",
)
def certify(study: CertifyStudy, output: Output, robot: str) -> None:
    """Whether the robot can snap at any rotation: what is proved, and what search finds.

    Ends with 0 if it cannot snap, 3 if it can, 4 if neither is known; with a box, at the translations of its least
    certificate that was found. With a force, 0 is only for what is proved under it.
    """
    present(report(replace(ask(study, output), robot_file=robot)), output)


@asks(
    StabilityMapStudy,
    example="tubeopt stability-map configs/robots/crl_ctr.yaml --out results",
    note=f"All is said {ASSUMING}.",
)
def stability_map(study: StabilityMapStudy, output: Output) -> None:
    """The margin over the rotations of two tubes turned together from home, and where the robot snaps."""
    answer(study, output)
