"""From the solution of a program back to a plain, verified equilibrium."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from ..errors import SolveError, undoubted
from ..robots.breakpoints import DIMENSIONS, dimensions_of
from ..robots.concentric import ConcentricRobot
from ..robots.eccentric import EccentricRobot, SegmentedEccentricRobot
from ..robots.robot import Robot, is_general
from ..typing import Array
from .composed import ComposedBlock
from .guess import sample
from .near import N
from .pieces import remade, tubes_at
from .transcription.chain import chain_of
from .transcription.model import Model

AGREEMENT = 1e-6
"""Largest difference of the tip between block and equilibrium, over the length of the arm."""

MISSED = 5e-5
"""By how much a margin that was demanded may be missed: as well as margins close to 1 are told."""

CERTAIN = 1e-7
"""By how much a certificate may be missed: the tolerance to which programs are solved."""


def confirmed(block: ComposedBlock[N], value: Callable[[Any], Any]) -> N:
    """The verified equilibrium of a block at the numbers that `value` gives to its expressions."""
    numbers = {name: np.array(value(part)).ravel() for name, part in block.dimensions.items()}
    robot = rebuilt(block.robot, numbers)
    rotations, translations = (np.array(value(part)).ravel() for part in (block.rotations, block.translations))
    translations = np.minimum(translations, numbers["straight_length"])
    model = block.model.at(value)
    found = _solved_again(block, (robot, rotations, translations), model)
    tip = np.array(value(block.tip_position)).ravel()
    apart = float(np.linalg.norm(tip - found.tip_position))
    if apart > AGREEMENT * float(found.arm.arc_length[-1]):
        raise SolveError(
            f"the tip of the program is {1e3 * apart:.2g} mm from that of the equilibrium: "
            "the mesh is too coarse (increase refinement), or the program was not solved",
            found,
        )
    for _, floor in block.margins:
        least = float(np.array(value(floor)).item())
        if found.margin < least - MISSED:
            raise SolveError(
                f"the margin is {found.margin:.4g}; it must be at least {least:.4g}: the "
                "program has left the branch where its margin constraint is valid; start it "
                "closer to its solution",
                found,
            )
    for bound in block.bounds:
        least, value_there = float(np.array(value(bound.floor)).item()), bound.value(model, block.chain)
        if value_there < least - CERTAIN:
            raise SolveError(
                f"the {bound.words} is {value_there:.4g}; it must be at least {least:.4g}: "
                "the program has left the branch of the largest eigenvalue; start it closer "
                "to its solution",
                found,
            )
    return found


def _solved_again(block: ComposedBlock[N], at: tuple[Robot, Array, Array], model: Model) -> N:
    """On a mesh of its own, verified by re-integration."""
    curvature_at = None if block.load is None else lambda s: sample(model, s)[2]
    near = block.near.at(*at, lambda s: sample(model, s)[0], load=block.load, curvature_at=curvature_at)
    return near.verified()


@undoubted()
def rebuilt(robot: Robot, numbers: dict[str, Any]) -> Robot:
    """The robot with other DIMENSIONS of its tubes, (n,) each.

    A stiffness other than that of tube and material is a given one: diameters and material stay.
    """
    if is_general(robot):
        return _of_pieces(robot, numbers)
    given = dimensions_of(robot.tubes)
    if all(np.array_equal(numbers[name], given[name]) for name in DIMENSIONS):
        return robot
    tubes = tuple(
        remade(tube, **{name: float(numbers[name][i]) for name in DIMENSIONS}) for i, tube in enumerate(robot.tubes)
    )
    if isinstance(robot, ConcentricRobot):
        return replace(robot, tubes=tubes)
    if isinstance(robot, SegmentedEccentricRobot):
        return replace(robot, segments=tubes[::3])
    assert isinstance(robot, EccentricRobot)
    straight = tubes[0].straight_length - robot.transmission_length
    if straight >= 0:
        return replace(robot, tube=replace(tubes[0], straight_length=straight))
    return replace(robot, tube=tubes[0], transmission_length=0.0)


@undoubted()
def _of_pieces(robot: Robot, numbers: dict[str, Any]) -> Robot:
    assert isinstance(robot, ConcentricRobot)
    own = {**dimensions_of(robot.tubes), **chain_of(robot.tubes).start}
    same = all(np.array_equal(numbers[name], own[name]) for name in own if name != "curvature")
    return robot if same else replace(robot, tubes=tubes_at(robot.tubes, numbers))
