"""Inputs of a block: joint values, tube dimensions and load, as numbers or as expressions of a program."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from ..errors import InputError, nearest
from ..robots.assembly import DIMENSIONS, Assembly, assemble, dimensions_of, tube_positions
from ..robots.load import Load, masses
from ..robots.order import last_tube
from ..robots.robot import Robot, is_general
from ..typing import Array
from .guess import InitialEquilibrium
from .transcription.chain import OF_TUBE, PIECES, Chain, chain_of, piece_numbers, tubes_at
from .transcription.external_load import BlockLoad

LENGTHS = ("translations", "straight_length", "curved_length", "piece_length")
"""Inputs that move breakpoints."""


@dataclass(frozen=True, eq=False)
class BlockInputs:
    """Joint values and DIMENSIONS of n tubes by name, (n,) each; of tubes made of pieces also their PIECES."""

    values: dict[str, Any]
    """Expressions or numbers."""
    start: dict[str, Array]
    """Start values of a solve, by name."""
    chain: Chain | None
    """Panels of tubes made of pieces, else None."""

    def free(self, *names: str) -> bool:
        """True if any of these is an expression."""
        return any(symbolic(self.values.get(name)) for name in names)


def symbolic(value: Any) -> bool:
    """True for an expression of CasADi."""
    return isinstance(value, (ca.SX, ca.MX))


def block_inputs(
    initial: InitialEquilibrium, rotations: Any, translations: Any, tubes: Mapping[str, Any]
) -> BlockInputs:
    """Inputs of a block, checked; those that are None or omitted keep the numbers of `initial`.

    Raises:
        InputError: an unknown name, a vector of the wrong length, or a dimension that is passed twice.
    """
    robot = initial.robot
    chain = chain_of(tuple(robot.tubes)) if is_general(robot) else None
    names = DIMENSIONS if chain is None else (*DIMENSIONS, *PIECES)
    for name in tubes:
        if name not in names:
            raise InputError(
                f"tubes has the key {name!r}; allowed keys are {', '.join(names)}{nearest(str(name), names)}"
            )
    start = numbers_at(initial, chain)
    requested = {"rotations": rotations, "translations": translations, **tubes}
    # Tubes of one segment move together and are equal; rotations and pieces are independent.
    single = {"rotations", *PIECES}
    values: dict[str, Any] = {}
    for name, default in start.items():
        groups = tuple((k,) for k in range(len(default))) if name in single else robot.moving_together
        values[name] = _column(name, requested.get(name), default, groups)
        if not symbolic(values[name]):
            start[name] = np.array(values[name]).ravel()
    if chain is not None:
        known, owner = dimensions_of(robot.tubes), chain.owner.tolist()
        # The pieces of a tube change in proportion to its dimension ...
        for name, full_name in OF_TUBE.items():
            if name in tubes and full_name in tubes:
                raise InputError(
                    f"tubes has the keys {full_name!r} and {name!r}; for tubes made of pieces, give one of them"
                )
            if full_name in tubes:
                size = known[full_name][owner]
                ratio = np.where(size == 0, 1.0, start[name] / np.where(size == 0, 1.0, size))
                values[name], start[name] = ca.DM(ratio) * values[full_name][owner, :], ratio * start[full_name][owner]
        # ... or the length of a tube is the sum of its pieces.
        if "piece_length" in tubes:
            rows = ca.DM((np.arange(robot.n_tubes)[:, None] == chain.owner).astype(float))
            values["curved_length"] = rows @ values["piece_length"]
            start["curved_length"] = np.array(rows @ ca.DM(start["piece_length"])).ravel()
    return BlockInputs(values, start, chain)


def numbers_at(initial: InitialEquilibrium, like: Chain | None) -> dict[str, Array]:
    """Joint values and dimensions of an equilibrium, as numbers; its pieces are in the form of `like`."""
    tubes = initial.robot.tubes
    inputs = {"rotations": initial.rotations, "translations": initial.translations, **dimensions_of(tubes)}
    return inputs if like is None else {**inputs, **piece_numbers(tubes, like)}


def _column(name: str, value: Any, default: Array, groups: tuple[tuple[int, ...], ...]) -> Any:
    """Column (n,) of numbers or an expression; equal tubes that move together share one entry of an expression."""
    n = len(default)
    if value is None:
        return ca.DM(default)
    if isinstance(value, (list, tuple)) and any(symbolic(entry) for entry in value):
        value = ca.vertcat(*value)
    if symbolic(value):
        entries = value.numel()
        if entries != len(groups):
            each = "tube" if len(groups) == n else "segment (its tubes are equal and move together)"
            raise InputError(f"{name} has {entries} entries; it must have {len(groups)}, one per {each}")
        column = ca.vec(value)
        return ca.vertcat(*(column[k] for k, tubes in enumerate(groups) for _ in tubes)) if entries < n else column
    try:
        numbers = np.asarray(value, dtype=float).ravel()
    except (TypeError, ValueError):
        raise InputError(f"{name} is {value!r}; it must be numbers or an expression of the program") from None
    if numbers.shape != (n,) or not np.isfinite(numbers).all():
        raise InputError(f"{name} is {numbers.tolist()}; it must be {n} finite numbers, one per tube")
    return ca.DM(numbers)


def block_load(initial: InitialEquilibrium, bundle: Assembly, load: Load | None) -> BlockLoad | None:
    """Load in the form of a block; None without a load.

    Raises:
        InputError: an eccentric robot, or a load that varies along the arm.
    """
    if load is None:
        return None
    if not isinstance(load, Load):
        raise InputError(f"load is {load!r}; it must be a Load")
    if bundle.eccentric:
        raise InputError("load is given for an eccentric robot; only concentric robots can be loaded")
    per_length = (0.0, 0.0, 0.0) if load.distributed is None else load.distributed
    if load.points or callable(per_length) or any(not isinstance(part, float) for part in per_length):
        raise InputError(
            "load has points, stretches or a function along the arm; a block supports tip "
            "force, tip moment, weight and a constant force per length"
        )
    gravity = np.array(load.gravity or (0.0, 0.0, 0.0))
    return BlockLoad(
        force=np.array(load.force),
        moment=np.array(load.moment),
        following=load.frame == "tip",
        per_length=np.array(per_length, dtype=float),
        weight=masses(initial.robot.tubes, load)[:, None] * gravity,
        tip_tube=int(last_tube(bundle.end)),
        stiffness=float(sum(tube.bending_stiffness for tube in initial.robot.tubes)),
    )


def assembly_at(robot: Robot, assembly: Assembly, numbers: Mapping[str, Array]) -> Assembly:
    """Tubes of an assembly at other joint values and dimensions, without sections, which `layout` makes."""
    if assembly.general:
        shift = np.minimum(numbers["translations"], numbers["straight_length"])
        return assemble(tubes_at(robot.tubes, numbers), shift)
    transmission, transition, end = tube_positions(*(numbers[name] for name in LENGTHS[:3]))
    return replace(
        assembly,
        bending_stiffness=numbers["bending_stiffness"],
        torsional_stiffness=numbers["torsional_stiffness"],
        curvature=numbers["curvature"],
        transmission=transmission,
        transition=transition,
        end=end,
    )
