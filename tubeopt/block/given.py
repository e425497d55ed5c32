"""What is given to a block: joint values and dimensions of the tubes, as numbers or as expressions of a program, and
what of a load such a program can hold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from ..errors import InputError, nearest
from ..robots.assembly import DIMENSIONS, Assembly, assemble, dimensions_of, places
from ..robots.load import Load, masses
from ..robots.order import last_tube
from ..robots.robot import Robot, is_general
from ..typing import Array
from .guess import InitialEquilibrium
from .transcription.chain import OF_TUBE, PIECES, Chain, chain_of, piece_numbers, tubes_at
from .transcription.external_load import Push

LENGTHS = ("translations", "straight_length", "curved_length", "piece_length")
"""What moves breakpoints."""


@dataclass(frozen=True, eq=False)
class Given:
    """Joint values and DIMENSIONS of n tubes by name, (n,) each, and PIECES of tubes made of pieces, whose `chain` is
    known then: `values` as expressions or numbers, `start` the numbers where a solve begins."""

    values: dict[str, Any]
    start: dict[str, Array]
    chain: Chain | None = None

    def free(self, *names: str) -> bool:
        """Whether any of these is an expression."""
        return any(symbolic(self.values.get(name)) for name in names)


def symbolic(value: Any) -> bool:
    """Whether a value is an expression of CasADi."""
    return isinstance(value, (ca.SX, ca.MX))


def given_of(initial: InitialEquilibrium, rotations: Any, translations: Any, tubes: Mapping[str, Any]) -> Given:
    """What a block is given; None stands for that of `initial`."""
    robot = initial.robot
    chain = chain_of(tuple(robot.tubes)) if is_general(robot) else None
    names = DIMENSIONS if chain is None else (*DIMENSIONS, *PIECES)
    for name in tubes:
        if name not in names:
            raise InputError(
                f"tubes has the key {name!r}; allowed keys are {', '.join(names)}{nearest(str(name), names)}"
            )
    start = numbers_at(initial, chain)
    target = {"rotations": rotations, "translations": translations, **tubes}
    alone = tuple((i,) for i in range(robot.n_tubes))
    groups = {"rotations": alone} | {name: tuple((k,) for k in range(len(start[name]))) for name in names[5:]}
    values: dict[str, Any] = {}
    for name, otherwise in start.items():
        values[name] = _column(name, target.get(name), otherwise, groups.get(name, robot.moving_together))
        if not symbolic(values[name]):
            start[name] = np.array(values[name]).ravel()
    if chain is not None:
        _in_proportion(chain, values, start, (tubes, dimensions_of(robot.tubes)))
    return Given(values, start, chain)


def numbers_at(initial: InitialEquilibrium, like: Chain | None) -> dict[str, Array]:
    """Joint values and dimensions of an equilibrium."""
    tubes = initial.robot.tubes
    inputs = {"rotations": initial.rotations, "translations": initial.translations, **dimensions_of(tubes)}
    return inputs if like is None else {**inputs, **piece_numbers(tubes, like)}


def _in_proportion(
    chain: Chain, values: dict[str, Any], start: dict[str, Array], known: tuple[Mapping[str, Any], Mapping[str, Array]]
) -> None:
    """Let the pieces of a tube follow from its own dimensions, or these from the pieces; `known` are those given and
    those of the robot."""
    owner, (tubes, robot) = chain.owner.tolist(), known
    for name, whole in OF_TUBE.items():
        if name in tubes and whole in tubes:
            raise InputError(f"tubes has the keys {whole!r} and {name!r}; for tubes made of pieces, give one of them")
        if whole in tubes:
            own = robot[whole][owner]
            part = np.where(own == 0, 1.0, start[name] / np.where(own == 0, 1.0, own))
            values[name], start[name] = ca.DM(part) * values[whole][owner, :], part * start[whole][owner]
    if "piece_length" in tubes:
        rows = ca.DM((np.arange(len(robot["curvature"]))[:, None] == chain.owner).astype(float))
        values["curved_length"] = rows @ values["piece_length"]
        start["curved_length"] = np.array(rows @ ca.DM(start["piece_length"])).ravel()


def _column(name: str, value: Any, otherwise: Array, carriages: tuple[tuple[int, ...], ...]) -> Any:
    """An (n,) column of numbers or an expression; of tubes that are equal and move together one entry tells all."""
    n = sum(len(tubes) for tubes in carriages)
    if value is None:
        return ca.DM(otherwise)
    if isinstance(value, (list, tuple)) and any(symbolic(entry) for entry in value):
        value = ca.vertcat(*value)
    if symbolic(value):
        entries = value.numel()
        if entries != len(carriages):
            each = "tube" if len(carriages) == n else "segment (its tubes are equal and move together)"
            raise InputError(f"{name} has {entries} entries; it must have {len(carriages)}, one per {each}")
        column = ca.vec(value)
        return ca.vertcat(*(column[k] for k, tubes in enumerate(carriages) for _ in tubes)) if entries < n else column
    try:
        numbers = np.asarray(value, dtype=float).ravel()
    except (TypeError, ValueError):
        raise InputError(f"{name} is {value!r}; it must be numbers or an expression of the program") from None
    if numbers.shape != (n,) or not np.isfinite(numbers).all():
        raise InputError(f"{name} is {numbers.tolist()}; it must be {n} finite numbers, one per tube")
    return ca.DM(numbers)


def push_of(initial: InitialEquilibrium, bundle: Assembly, load: Load | None) -> Push | None:
    """The load on a block near an equilibrium, None where nothing pushes."""
    if load is None:
        return None
    if not isinstance(load, Load):
        raise InputError(f"load is {load!r}; it must be a Load")
    if bundle.eccentric:
        raise InputError("load is given for an eccentric robot; only concentric robots can be loaded")
    along = (0.0, 0.0, 0.0) if load.distributed is None else load.distributed
    if load.points or callable(along) or any(not isinstance(part, float) for part in along):
        raise InputError(
            "load has points, stretches or a function along the arm; a block supports tip "
            "force, tip moment, weight and a constant force per length"
        )
    gravity = np.array(load.gravity or (0.0, 0.0, 0.0))
    return Push(
        force=np.array(load.force),
        moment=np.array(load.moment),
        turning=load.frame == "tip",
        along=np.array(along, dtype=float),
        weight=masses(initial.robot.tubes, load)[:, None] * gravity,
        tip_tube=int(last_tube(bundle.end)),
        typical=float(sum(tube.bending_stiffness for tube in initial.robot.tubes)),
    )


def assembly_at(robot: Robot, assembly: Assembly, numbers: Mapping[str, Array]) -> Assembly:
    """A bundle with other joint values and dimensions, not cut into sections: `layout` does that."""
    if assembly.general:
        shift = np.minimum(numbers["translations"], numbers["straight_length"])
        return assemble(tubes_at(robot.tubes, numbers), shift)
    transmission, transition, end = places(*(numbers[name] for name in LENGTHS[:3]))
    return replace(
        assembly,
        bending_stiffness=numbers["bending_stiffness"],
        torsional_stiffness=numbers["torsional_stiffness"],
        curvature=numbers["curvature"],
        transmission=transmission,
        transition=transition,
        end=end,
    )
