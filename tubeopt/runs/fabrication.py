"""Molds and heating schedules for every tube of a robot, in one go."""

from __future__ import annotations

from dataclasses import dataclass

from ..display import Displayed
from ..robots.robot import Robot
from ..shaping.heating.rig import Rig
from ..shaping.heating.spec import HeatingSpec
from ..shaping.mold.robot import RobotMold, chosen_tubes
from ..shaping.mold.spec import MoldSpec
from ..shaping.tube_fabrication import TubeFabrication, plan_tube
from .base import Progress
from .heating_study import Ensemble, Heating, heating_of


@dataclass(frozen=True, eq=False)
class TubeParts:
    """Mold and schedules of one tube.

    number: of the tube, from 1.   made: the two as planned together.   mold, heating: each as its own command says it.
    """

    number: int
    made: TubeFabrication
    mold: RobotMold
    heating: Heating


@dataclass(frozen=True, eq=False)
class Fabrication(Displayed):
    """Everything that it takes to make a robot's tubes.   left_out: tubes that are not, in words."""

    robot: Robot
    parts: tuple[TubeParts, ...]
    left_out: tuple[str, ...]


def fabricate(
    robot: Robot,
    rig: Rig,
    asked: MoldSpec,
    spec: HeatingSpec,
    *,
    charges: tuple[float, ...] = (),
    ensemble: Ensemble | None = None,
    progress: Progress | None = None,
) -> Fabrication:
    """Each tube's mold drawn for the rig, and its heating planned on the rig with the mold as drawn.

    Args:
        charges: states of charge for which there are tables too.   ensemble: of uncertain rigs; None for no band.

    Raises:
        InputError: no tube of the robot is curved, or as `plan_tube`.
    """
    chosen, left_out = chosen_tubes(robot)
    tell = progress or (lambda done, total: None)
    parts = []
    for k, number in enumerate(chosen):
        tell(k, len(chosen))
        # Each tube has a mold of its own: its arc and its length of cold end decide the plate.
        made = plan_tube(robot.tubes[number - 1], rig, asked, spec, number=number)
        drawn = RobotMold(made.mold, robot.name, (number,), ())
        parts.append(TubeParts(number, made, drawn, heating_of(made.heating, charges, ensemble)))
    tell(len(chosen), len(chosen))
    return Fabrication(robot, tuple(parts), tuple(left_out))
