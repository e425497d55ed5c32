"""The mold for the tubes of a robot, which of them need a groove and which share one; and the tubes that come out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ...display import Displayed
from ...errors import InputError, instance, whole
from ...robots.robot import Robot
from ...robots.tubes import Tube
from .mold import Mold, plan_mold
from .setting import bend_direction, tube_from_mold
from .spec import MoldSpec
from .springback import Springback


@dataclass(frozen=True, eq=False)
class RobotMold(Displayed):
    """A mold for tubes of a robot."""

    mold: Mold
    """As planned; its grooves are numbered as the tubes of the robot."""
    name: str
    """Of the robot."""
    left_out: tuple[str, ...]
    """Why other tubes have no groove."""


def plan_robot_mold(robot: Robot, spec: MoldSpec | None = None, tubes: Sequence[int] | None = None) -> RobotMold:
    """One mold for the tubes of a robot.

    Args:
        tubes: their numbers, from 1; by default every curved tube that is not equal to an earlier one.

    Raises:
        InputError: no such tube, none that needs a mold, or a mold that cannot be made.
    """
    numbers, left_out = chosen_tubes(robot, tubes)
    mold = plan_mold([robot.tubes[number - 1] for number in numbers], spec, numbers=numbers)
    return RobotMold(mold, robot.name, tuple(left_out))


def chosen_tubes(robot: Robot, tubes: Sequence[int] | None = None) -> tuple[list[int], list[str]]:
    """Numbers, from 1, of the tubes that need a groove, and why others are left out; arguments and errors as above."""
    all_tubes = robot.tubes
    if tubes is not None:
        for number in tubes:
            if not 1 <= number <= len(all_tubes):
                raise InputError(f"tubes has {number}; it must be numbers of tubes, from 1 to {len(all_tubes)}")
        return list(tubes), []
    numbers: list[int] = []
    left_out = []
    for k, tube in enumerate(all_tubes, start=1):
        first = next((j for j in numbers if all_tubes[j - 1] == tube), None)
        if tube.curved_length == 0 or tube.curvature == 0:
            left_out.append(f"tube {k} is straight and needs no mold")
        elif bend_direction(tube) is None:
            left_out.append(f"tube {k} is a space curve and takes a mandrel: tubeopt mold mandrel")
        elif first is not None:
            left_out.append(f"tube {k} is equal to tube {first} and is set in its groove")
        else:
            numbers.append(k)
    if not numbers and any("space curve" in line for line in left_out):
        raise InputError("no tube of this robot is planar; use `tubeopt mold mandrel` for space curves")
    if not numbers:
        raise InputError("no tube of this robot is curved; none needs a mold")
    return numbers, left_out


def predict_tube(mold: Mold, index: int | None = None, *, springback: Springback | None = None) -> Tube:
    """The tube that a groove produces after spring-back: the inverse of `plan_mold`.

    Args:
        mold: the mold.
        index: index of the groove, from 0; required if there are several.
        springback: spring-back model; by default that of the mold.

    Raises:
        InputError: no such groove, several grooves and no index, or a tube tighter than it is thick.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> mold = tubeopt.plan_mold(robot.tubes[0])
        >>> round(tubeopt.predict_tube(mold).curvature, 6)
        10.0
    """
    instance("mold", mold, Mold)
    count = len(mold.grooves)
    if index is None and count > 1:
        raise InputError(f"the mold has {count} grooves; give index, 0 to {count - 1}")
    if not 0 <= (which := whole("index", 0 if index is None else index)) < count:
        raise InputError(f"index is {index}; it must lie in 0 to {count - 1}")
    return tube_from_mold(mold.grooves[which].held, springback or mold.spec.springback)


def predict_tubes(mold: Mold, *, springback: Springback | None = None) -> tuple[Tube, ...]:
    """The tubes that come out of all grooves, as `predict_tube`."""
    return tuple(predict_tube(mold, k, springback=springback) for k in range(len(mold.grooves)))
