"""Parameters that can be estimated: names, ranges and application of the numbers of the table of effects."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

from ..arguments import typed
from ..errors import InputError, nearest
from ..robots.concentric import ConcentricRobot
from ..robots.robot import Robot
from ..typing import Array
from .effects import EFFECTS, KINDS, PER_RECORDING, TWO_NUMBERS, Context, Effect, Setup, Span, members
from .measurements import Measurements, recordings_of
from .registration import FITS_PLATE
from .tube_shapes import MODES

AXES = "xyz"

# What the numbers of parameters count, where that is not tubes.
COUNTED = {"carriage": "carriages", "spring": "carriages that yield", "pair": "pairs of tubes that rub"}


@dataclass(frozen=True)
class Parameter(Span):
    """A number to be estimated."""

    name: str
    """Name, such as "curvature_2"."""
    kind: str
    """Kind of its effect, such as "curvature"."""
    index: int | None
    """Number of the object, from 0; None for all."""
    unit: str
    """Unit of its effect; "" for a factor on all curvatures."""
    which: tuple[int, ...]
    """Places in the setup that it sets."""
    idle: str = ""
    """Reason why the parameter has no influence on the tips, as text; "" where it may have one."""
    recording: int | None = None
    """Number of the recording that it is of, from 0; None for a parameter of all."""

    @property
    def effect(self) -> Effect:
        """The entry of the table."""
        return EFFECTS[self.kind]


@typed
def choose_parameters(
    robot: Robot,
    measurements: Measurements | Sequence[Measurements],
    names: Sequence[str],
    registration: str = "rigid",
    per_recording: Sequence[str] = (),
) -> tuple[Parameter, ...]:
    """The parameters with these names; "rotation_all" is one for every tube, and so on.

    Of several recordings an effect in `per_recording` has a parameter for each: "rotation_2@1", "rotation_2@2".

    Raises:
        InputError: no name, a name that is unknown, given twice, or means nothing for this robot and these data;
            parameters that set the same numbers.
    """
    if isinstance(names, str) or not len(names):
        raise InputError(f"no parameters are given; choose from {', '.join(KINDS)}")
    recordings = () if isinstance(measurements, tuple) and not measurements else recordings_of(measurements)
    context = Context(robot, recordings, Setup.of(robot))
    chosen = [_parameter(context, name, registration) for spelling in names for name in _spelled_out(context, spelling)]
    for k, parameter in enumerate(chosen):
        for earlier in chosen[:k]:
            _contradict(earlier, parameter)
    if len(recordings) <= 1:
        return tuple(chosen)
    out: list[Parameter] = []
    for common in chosen:
        parts = enumerate(recordings) if common.kind in per_recording and common.kind in PER_RECORDING else ()
        each = [_parameter(replace(context, recordings=(m,)), common.name, registration, k) for k, m in parts]
        out += each or [common]
    return tuple(out)


def _contradict(a: Parameter, b: Parameter) -> None:
    """Raise InputError if two parameters set the same numbers."""
    if a.name == b.name:
        raise InputError(f"parameter {a.name!r} is given twice")
    same = a.kind == b.kind or set(a.effect.sets) & set(b.effect.sets)
    if same and set(a.which) & set(b.which):
        what = a.kind if a.kind == b.kind else "stiffness"
        raise InputError(f"parameters {a.name} and {b.name} both set the {what}; give one of them")


def _spelled_out(context: Context, name: str) -> list[str]:
    """Names of a group such as "rotation_all", or the name itself."""
    kind = name.removesuffix("_all")
    if kind == name or kind not in EFFECTS or not EFFECTS[kind].each:
        return [name]
    return [f"{kind}_{word}" for word in numbers_of(context, EFFECTS[kind])]


def numbers_of(context: Context, effect: Effect) -> list[str]:
    """Numbers in the names of the parameters of an effect."""
    if effect.each.startswith("x"):
        return list(effect.each)
    if effect.each == "piece":
        return [f"{tube + 1}_{piece + 1}" for tube, piece in context.setup.pieces]
    if effect.each == "mode":
        return [f"{k // MODES + 1}_{k % MODES + 1}" for k in range(_count(context, effect))]
    return [str(i + 1) for i in range(effect.first - 1, _count(context, effect))]


def _count(context: Context, effect: Effect) -> int:
    robot = context.robot
    counts = {
        "pair": len(context.setup.friction),
        "tube": robot.n_tubes,
        "kind": len(members(robot)),
        "piece": len(context.setup.pieces),
        "mode": len(context.setup.learned),
        "carriage": len(robot.moving_together),
        "spring": len(robot.moving_together) if isinstance(robot, ConcentricRobot) else 0,
    }
    return counts.get(effect.each, len(effect.each))


def _parameter(context: Context, name: str, registration: str, recording: int | None = None) -> Parameter:
    # A name ends with a tube ("2"), a piece of a tube ("2_1") or an axis ("x").
    match = re.fullmatch(r"([a-z_]*[a-z])_(\d+|\d+_\d+|[xyz])", name)
    kind, number = (match[1], match[2]) if match else (name, None)
    if not _known(kind, number):
        known = [word for word in KINDS if "_I" not in word]
        known += [f"{each}_{k}" for each, effect in EFFECTS.items() for k in numbers_of(context, effect) if effect.each]
        raise InputError(f"parameter {name!r} is not known{nearest(name, known)}; choose from {', '.join(KINDS)}")
    effect = EFFECTS[kind]
    _check_number(context, effect, name, number)
    missing = lacking(context.recordings, effect, registration)
    if missing:
        raise InputError(f"parameter {name!r} {missing}")
    # Names count from `first`, places in the setup from 0.
    index = None if number is None else numbers_of(context, effect).index(number) + effect.first - 1
    unit = "" if index is None and kind == "curvature" else effect.unit
    span, which = effect.span(context, index), _places(context, effect, index)
    idle = effect.idle(context, index)
    label = name if recording is None else f"{name}@{recording + 1}"
    return Parameter(
        **vars(span), name=label, kind=kind, index=index, unit=unit, which=which, idle=idle, recording=recording
    )


def _known(kind: str, number: str | None) -> bool:
    """True if a kind has a parameter with this number."""
    if kind not in EFFECTS:
        return False
    each = EFFECTS[kind].each
    if number is None:
        return kind in KINDS
    return bool(each) and (number in AXES) == each.startswith("x") and ("_" in number) == (each in TWO_NUMBERS)


def _places(context: Context, effect: Effect, index: int | None) -> tuple[int, ...]:
    """Indices in the setup that a parameter sets."""
    if effect.each in ("carriage", "spring"):
        together = context.robot.moving_together
        return tuple(range(context.robot.n_tubes)) if index is None else together[index]
    return tuple(range(_count(context, effect) if effect.each else 1)) if index is None else (index,)


def _check_number(context: Context, effect: Effect, name: str, number: str | None) -> None:
    count, known = _count(context, effect), numbers_of(context, effect)
    if number is None or number in known:
        return
    if effect.each == "mode":
        raise InputError(
            f"parameter {name!r}: there is no such number of a tube; the tube must be 1 to {count // MODES}, the "
            f"number 1 to {MODES}"
        )
    if effect.each == "piece":
        choices = f"choose from {', '.join(known)}" if known else "the robot has no tube of two or more pieces"
        raise InputError(f"parameter {name!r}: there is no such piece of a tube; {choices}")
    if number in AXES:
        raise InputError(f"parameter {name!r} is not known; it has the axes {' and '.join(effect.each)}")
    what = COUNTED.get(effect.each, "tubes")
    what = what if effect.each in COUNTED or count == context.robot.n_tubes else "different tubes"
    first = effect.first
    allowed = f"the number must be {first} to {count}" if first <= count else "it has no such parameter"
    raise InputError(f"parameter {name!r}: the robot has {count} {what}; {allowed}")


def lacking(recordings: Sequence[Measurements], effect: Effect, registration: str) -> str:
    """Data that the estimate of an effect needs and that are missing, as text; "" if there are none."""
    if effect.needs in ("time", "way") and any(m.time is None for m in recordings):
        return "needs the time of every row; the measurements have no column time_s"
    if effect.needs == "orientation" and recordings and all(m.orientation is None for m in recordings):
        return "needs the direction of the tip's sensor; the measurements have none"
    if effect.needs == "plate" and registration in FITS_PLATE:
        return f"is part of the registration, which is {registration!r}; it is for none and base-axis"
    return ""


def groups(
    robot: Robot,
    measurements: Measurements | Sequence[Measurements],
    registration: str = "rigid",
    asked: Sequence[str] = (),
) -> dict[str, tuple[str, ...]]:
    """Effects that these data of this robot can determine, each with the names of its parameters.

    Effects that are always compared, or `asked` for.
    """
    context = Context(robot, recordings_of(measurements), Setup.of(robot))
    by_kind: dict[str, tuple[str, ...]] = {}
    for kind, effect in EFFECTS.items():
        compared = effect.compared == "always" or (effect.compared == "asked" and kind in asked)
        if not compared or lacking(context.recordings, effect, registration):
            continue
        numbered = effect.each and kind != "translation_gain"
        by_kind[kind] = tuple(_spelled_out(context, f"{kind}_all")) if numbered else (kind,)
    return {kind: names for kind, names in by_kind.items() if names}


def apply(setup: Setup, parameters: Sequence[Parameter], values: Array) -> Setup:
    """A setup with the parameters at `values` (P,)."""
    changed = setup.copy()
    order = list(EFFECTS)
    # In the order of the table, so that the result does not depend on the order in which parameters are named.
    pairs = sorted(zip(parameters, values.tolist(), strict=True), key=lambda pair: order.index(pair[0].kind))
    for parameter, value in pairs:
        parameter.effect.change(changed, setup, parameter.which, value, parameter.index is None)
    return changed
