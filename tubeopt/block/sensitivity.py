"""The Jacobian of a block's tip inside of the program: derivatives of its unknowns, lifted into unknowns too."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from ..errors import InputError, choice
from .composed import JOINTS, ComposedBlock
from .given import LENGTHS
from .transcription.chain import OF_TUBE
from .transcription.external_load import arm_of
from .transcription.model import numbers_of


def add_jacobian(block: ComposedBlock[Any], wrt: Sequence[str]) -> Any:
    """(3, Q) derivative of the tip's position: F_x dx + F_a da = 0 for every input a, with dx as unknowns."""
    names, inputs = (wrt,) if isinstance(wrt, str) else tuple(wrt), (*JOINTS, *block.dimensions)
    # What follows from the pieces of a tube is no input of its own.
    own = [name for name in inputs if block.chain is None or name not in (*OF_TUBE.values(), "curved_length")]
    for name in names:
        choice("wrt", name, own)
    if not names:
        raise InputError(f"wrt is empty; it must have at least one of {', '.join(own)}")
    seeds = {name: np.concatenate([_seed(block, name, other) for other in names], axis=1) for name in inputs}
    equations, scale, words = _equations(block)
    count = seeds["rotations"].shape[1]
    sizes = [rows * columns for rows, columns in block.shapes.values()]
    unit = np.concatenate([np.full(size, typical) for size, typical in zip(sizes, block.typical, strict=True)])
    per = np.concatenate([np.full(_columns(block, name).shape[1], 1 / _typical(block, name)) for name in names])
    total = np.outer(unit, per)
    begin = answers_of(block, equations, seeds)
    tag = block.label + "answer to the inputs"
    flat = block.program.variable(tag, total.size, scale=total.ravel(order="F"), guess=begin)
    block.answers.append((flat, equations, seeds))
    lifted = ca.reshape(flat, len(unit), count)
    where = [ca.vertcat(*block.columns), *_parameters(block)]
    change = [lifted, *(ca.DM(seed) for seed in seeds.values()), ca.DM.zeros(where[-1].shape[0], count)]
    out = equations(*where)
    residual, tip = equations.forward(count)(*where, *out, *change)
    entries = [f"answer to input {q + 1}: {word}" for q in range(count) for word in words]
    size = np.outer(scale, per).ravel(order="F")
    block.demand("equations of the answer to the inputs", ca.vec(residual), upper=0.0, scale=size, entries=entries)
    return tip


def _columns(block: ComposedBlock[Any], name: str) -> Any:
    """(N, ...) how the N numbers of an input change with those that are free of each other: tubes of one segment are
    equal and move together, but turn alone, and so does every piece of a tube."""
    count = block.begin_numbers[name].size
    if name == "rotations" or count != block.robot.n_tubes:
        return np.eye(count)
    return np.array([[float(i in tubes) for tubes in block.robot.moving_together] for i in range(count)])


def _seed(block: ComposedBlock[Any], name: str, column: str) -> Any:
    """(N, ...) how the input `name` changes with each of `column`."""
    own, size = _columns(block, column), block.begin_numbers[name].size
    if (name, column) == ("curved_length", "piece_length") and block.chain is not None:
        return (np.arange(size)[:, None] == block.chain.owner).astype(float)
    return own if name == column else np.zeros((size, own.shape[1]))


def _typical(block: ComposedBlock[Any], name: str) -> float:
    """A typical size of an input, by which its derivatives are scaled."""
    if name == "rotations":
        return 1.0
    if name in LENGTHS:
        return block.reach
    return float(np.abs(block.begin_numbers[name]).max()) or 1 / block.reach


def _parameters(block: ComposedBlock[Any]) -> list[Any]:
    """What the equations of a block depend on beside its unknowns: joints first."""
    numbers = block.numbers if block.numbers is not None else ca.DM(block.layout.numbers())
    return [block.rotations, block.translations, *block.dimensions.values(), numbers]


def _equations(block: ComposedBlock[Any]) -> tuple[ca.Function, Any, list[str]]:
    """(unknowns, parameters...) -> (equations, tip position), with sizes and words of the equations."""
    rows = [size[0] * size[1] for size in block.shapes.values()]
    x = ca.MX.sym("x", sum(rows))
    parts = ca.vertsplit(x, np.cumsum([0, *rows]).tolist())
    n = block.robot.n_tubes
    names = [*JOINTS, *block.dimensions]
    symbols = {name: ca.MX.sym(name, n if name in JOINTS else block.dimensions[name].numel()) for name in names}
    numbers = ca.MX.sym("layout", len(block.layout.numbers()))
    unknowns = block.matrices(parts)
    model = arm_of(block.model.grid, numbers_of(block.layout, numbers), unknowns, {**symbols, **block.fittings})
    table = model.equations(symbols["rotations"], block.reach)
    scale = np.concatenate([np.full(each.expression.numel(), each.scale) for each in table])
    words = [word for each in table for word in each.entries]
    outputs = [ca.vertcat(*(each.expression for each in table)), model.pose_ends[1][:, -1]]
    return ca.Function("equations", [x, *symbols.values(), numbers], outputs), scale, words


def answers_of(block: ComposedBlock[Any], equations: ca.Function, seeds: dict[str, Any]) -> Any:
    """The lifted derivatives where the solve begins, by columns."""
    x, count = block.begin_column, seeds["rotations"].shape[1]
    numbers = [block.begin_numbers[name] for name in (*JOINTS, *block.dimensions)]
    where = [x, *numbers, block.layout.numbers()]
    out, zero = equations(*where), np.zeros((len(where[-1]), count))
    forced = equations.forward(count)(*where, *out, np.zeros((len(x), count)), *seeds.values(), zero)[0]
    slope = equations.jacobian()(*where, *out)[0]
    return -np.linalg.solve(np.array(slope), np.array(forced)).ravel(order="F")
