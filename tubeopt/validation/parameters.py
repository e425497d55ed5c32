"""What can be estimated of a robot: named numbers, how a robot changes with them, and their ranges."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from ..errors import InputError, nearest
from ..robots.concentric import ConcentricRobot
from ..robots.eccentric import EccentricRobot, SegmentedEccentricRobot
from ..robots.robot import Robot
from ..robots.tubes import Tube, must_follow_section
from ..typing import Array
from .measurements import Measurements

KINDS = {
    "curvature": "common factor on the precurvature of all tubes",
    "curvature_I": "precurvature of tube I (or of the tubes of segment I), 1/m",
    "stiffness_ratio_I": "bending stiffness EI of tube I (or of the tubes of segment I) over that of the first, I >= 2",
    "nu": "Poisson's ratio of all tubes",
    "nu_I": "Poisson's ratio of tube I (or of the tubes of segment I)",
    "rotation_I": "offset added to the rotation of tube I, rad",
    "transmission_length": "straight length behind the plate of an eccentric robot, or what is added to every tube, m",
    "transmission_length_I": "straight length added to tube I (or to the tubes of segment I), m",
}
"""Names of parameters, I being a number from 1, and what they mean."""

CommonRobot = ConcentricRobot | EccentricRobot | SegmentedEccentricRobot
AnyRobot = TypeVar("AnyRobot", ConcentricRobot, EccentricRobot, SegmentedEccentricRobot)
CALIBRATED = " (calibrated)"


@dataclass(frozen=True)
class Parameter:
    """A number to be estimated.

    Attributes:
        name, kind, index: as chosen ("curvature_2"), its kind ("curvature"), its tube from 0 (None: all).
        unit: "", "1/m", "rad" or "m".
        start, low, high: value of the robot as given, and the range that is searched.
        scale: a change of this size is a large one.
    """

    name: str
    kind: str
    index: int | None
    unit: str
    start: float
    low: float
    high: float
    scale: float


def members(robot: Robot) -> tuple[Tube, ...]:
    """The tubes that a robot is described by: all of a concentric one, one per segment of an eccentric one."""
    if isinstance(robot, EccentricRobot):
        return (robot.tube,)
    if isinstance(robot, SegmentedEccentricRobot):
        return robot.segments
    return robot.tubes


def choose_parameters(robot: Robot, measurements: Measurements, names: Sequence[str]) -> tuple[Parameter, ...]:
    """The parameters with these names.

    Raises:
        InputError: no name, a name that is unknown, given twice, or means nothing for this robot; a common parameter
            together with one of the same kind for a single tube.
    """
    if isinstance(names, str) or not names:
        raise InputError(f"no parameters are named; choose from {', '.join(KINDS)}")
    chosen = [_parameter(robot, measurements, name) for name in names]
    for kind in {parameter.kind for parameter in chosen}:
        same = [parameter for parameter in chosen if parameter.kind == kind]
        indices = [parameter.index for parameter in same]
        if len(set(indices)) < len(indices):
            raise InputError(f"parameter {same[0].name!r} is named twice")
        if None in indices and len(indices) > 1:
            raise InputError(f"parameters {' and '.join(p.name for p in same)} both set the {kind}; name one of them")
    return tuple(chosen)


def _parameter(robot: Robot, measurements: Measurements, name: str) -> Parameter:
    match = re.fullmatch(r"([a-z_]*[a-z])(?:_(\d+))?", name)
    kind, number = (match[1], match[2]) if match else (name, None)
    pattern = kind if number is None else f"{kind}_I"
    if pattern not in KINDS:
        known = [word for word in KINDS if "_I" not in word] + [f"{w[:-1]}{number or 1}" for w in KINDS if "_I" in w]
        raise InputError(f"parameter {name!r} is not known{nearest(name, known)}; choose from {', '.join(KINDS)}")
    count = robot.n_tubes if kind == "rotation" else len(members(robot))
    first = 2 if kind == "stiffness_ratio" else 1
    if number is not None and not first <= int(number) <= count:
        what = "tubes" if count == robot.n_tubes else "different tubes"
        allowed = f"the number must be {first} to {count}" if first <= count else "it has no such parameter"
        raise InputError(f"parameter {name!r}: the robot has {count} {what}; {allowed}")
    if kind in ("stiffness_ratio", "nu"):
        must_follow_section(members(robot), f"a fit of {kind}")
    index = None if number is None else int(number) - 1
    unit, start, low, high, scale = _RANGES[kind](robot, measurements, index)
    return Parameter(name, kind, index, unit, start, low, high, scale)


Range = tuple[str, float, float, float, float]


def _curvature(robot: Robot, _: Measurements, index: int | None) -> Range:
    if index is None:
        return "", 1.0, 0.2, 5.0, 1.0
    value, thickness = members(robot)[index].curvature, members(robot)[index].outer_diameter
    return "1/m", value, -1 / thickness, 1 / thickness, max(abs(value), 1.0)


def _stiffness(robot: Robot, _: Measurements, index: int | None) -> Range:
    tubes = members(robot)
    value = tubes[index or 0].bending_stiffness / tubes[0].bending_stiffness
    return "", value, value / 20, value * 20, value


def _nu(robot: Robot, _: Measurements, index: int | None) -> Range:
    tubes = members(robot) if index is None else members(robot)[index : index + 1]
    return "", float(np.mean([tube.material.poisson_ratio for tube in tubes])), 0.0, 0.499, 0.25


def _rotation(*_: object) -> Range:
    return "rad", 0.0, -math.pi, math.pi, 1.0


def _transmission(robot: Robot, measurements: Measurements, index: int | None) -> Range:
    tubes = members(robot)
    advance = measurements.translations.reshape(len(measurements), len(tubes), -1).max((0, 2))
    room = [reach - tube.straight_length for reach, tube in zip(advance, tubes, strict=True)]
    least = max(room) if index is None else room[index]
    scale = max(tube.length for tube in tubes)
    start = 0.0
    if isinstance(robot, EccentricRobot):
        start, least = robot.transmission_length, max(0.0, least)
    return "m", start, least, start + 20 * scale, scale


_RANGES: Mapping[str, Callable[[Robot, Measurements, int | None], Range]] = {
    "curvature": _curvature,
    "stiffness_ratio": _stiffness,
    "nu": _nu,
    "rotation": _rotation,
    "transmission_length": _transmission,
}


def apply(robot: Robot, parameters: Sequence[Parameter], values: Array) -> tuple[CommonRobot, Array]:
    """The robot with the parameters at `values` (P,), and the offsets (n,), rad, to add to its rotations.

    Raises:
        InputError: there is no such robot.
    """
    changed = list(members(robot))
    offsets = np.zeros(robot.n_tubes)
    transmission = None
    # Stiffness keeps Poisson's ratio, so it goes first; all other kinds are independent of each other.
    order = sorted(zip(parameters, values.tolist(), strict=True), key=lambda pair: pair[0].kind != "stiffness_ratio")
    for parameter, value in order:
        if parameter.kind == "rotation":
            offsets[parameter.index or 0] = value
        elif parameter.kind == "transmission_length" and isinstance(robot, EccentricRobot):
            transmission = value
        else:
            which = range(len(changed)) if parameter.index is None else [parameter.index]
            for i in which:
                changed[i] = _change(changed[i], parameter, value, changed[0].bending_stiffness)
    return _rebuild(robot, tuple(changed), transmission), offsets


def _change(tube: Tube, parameter: Parameter, value: float, reference: float) -> Tube:
    """One tube with one parameter changed; `reference` is the bending stiffness of the first tube, N m^2."""
    if parameter.kind == "curvature":
        return replace(tube, curvature=value * tube.curvature if parameter.index is None else value)
    if parameter.kind == "transmission_length":
        return replace(tube, straight_length=max(0.0, tube.straight_length + value))
    modulus, nu = tube.material.youngs_modulus, tube.material.poisson_ratio
    if parameter.kind == "nu":
        nu = value
    else:
        modulus = value * reference / tube.second_moment
    name = tube.material.name.removesuffix(CALIBRATED) + CALIBRATED
    shear = modulus / (2 * (1 + nu))
    return replace(tube, material=replace(tube.material, name=name, youngs_modulus=modulus, shear_modulus=shear))


def _rebuild(robot: Robot, tubes: tuple[Tube, ...], transmission: float | None) -> CommonRobot:
    if isinstance(robot, ConcentricRobot):
        return replace(robot, tubes=tubes)
    if isinstance(robot, SegmentedEccentricRobot):
        return replace(robot, segments=tubes)
    if isinstance(robot, EccentricRobot):
        return replace(
            robot,
            tube=tubes[0],
            transmission_length=robot.transmission_length if transmission is None else transmission,
        )
    raise InputError(f"robot is a {type(robot).__name__}; only robots that a file can describe can be fitted")
