"""What a force on the tip does in a pose of a design, and how that changes with the design."""

from __future__ import annotations

import numpy as np

from ..block.quantities import PoseNumber
from ..equilibrium.answer import to_equilibrium
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.linearised import linearise
from ..equilibrium.result import Equilibrium
from ..robots.concentric import ConcentricRobot
from ..robots.load import Load
from ..stability.stroke import Varied, stroke_slopes
from ..typing import Array
from .state import JOINTS, State, moving

STRONGEST = 10.0
"""N; a pose that bears more along its tip counts as one that bears this."""

STEP = 1e-5
"""Of differences of the equations by what is free of pieces, as a share of its size."""


def tip_deflection(state: State, index: PoseNumber, force: tuple[float, float, float]) -> tuple[Array, Array]:
    """(3,) m and (3, X) of a force, N, that keeps its direction and grows on a pose; raises SolveError where the robot
    does not bear it there."""
    plain, names, rows = _unloaded(state, index)
    pushed = forward_kinematics(plain.robot, plain.rotations, plain.translations, load=Load(force), guess=plain)
    directions, chain = moving(np.concatenate([rows, np.eye(state.layout.size)[state.free_pieces]]))
    of = linearise(pushed, names, more=state.piece_changes, along=directions)
    change = of.tip_position @ chain - state.pose(index).tip_slope @ state.chain(index)
    return pushed.tip_position - plain.tip_position, change


def stroke_force(state: State, index: PoseNumber) -> tuple[float, Array]:
    """The stroke force of a pose, N, at most STRONGEST, and its change (X,); raises SolveError where there is no limit
    close to where the branch is lost, or it has no derivative."""
    plain, names, rows = _unloaded(state, index)
    free = _free_pieces(state)
    turn = state.pose(index).tip_turn @ state.chain(index)
    varied = [Varied(step, robots, turn[:, k]) for k, step, robots in free]
    found = stroke_slopes(plain, names, STRONGEST, varied=varied)
    if found is None:
        return STRONGEST, np.zeros(state.layout.size)
    pieces = np.eye(state.layout.size)[state.free_pieces]
    return found[0], found[1] @ np.concatenate([rows, pieces])


def _unloaded(state: State, index: PoseNumber) -> tuple[Equilibrium, list[str], Array]:
    """The equilibrium of a pose, the PARAMETERS that some unknown moves, and their change with the unknowns, n rows
    each: the others need not be differentiated. What is free of pieces moves none."""
    rows = dict(zip(JOINTS, state.joint_slopes(index), strict=True)) | state.resized
    moved = {name: part for name, part in rows.items() if part.any()}
    plain = to_equilibrium(state.pose(index).solved, "guess")
    return plain, [*moved], np.concatenate([np.zeros((0, state.layout.size)), *moved.values()])


def _free_pieces(state: State) -> list[tuple[int, float, tuple[ConcentricRobot, ConcentricRobot]]]:
    """Column of every unknown of pieces, a step of it, and the robots a step further and a step back."""
    space, designs, out = state.layout.space, state.x[: state.layout.designs], []
    for k in state.free_pieces:
        step = STEP * float(space.scale[k])
        row = step * np.eye(len(designs))[k]
        out.append(
            (k, step, (ConcentricRobot(space.tubes(designs + row)), ConcentricRobot(space.tubes(designs - row))))
        )
    return out
