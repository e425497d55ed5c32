"""Keys of a study for its robot, joint values and external load."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from decimal import Decimal
from os import PathLike
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, PlainValidator, ValidationInfo

from ..equilibrium.readings import to_model
from ..equilibrium.result import MIN_MARGIN
from ..errors import InputError
from ..files.checked import Count, Entry, Number, Triple, check, in_file
from ..files.fields import EntryOf, Part, keys_from, keys_in, values, with_keys
from ..files.shipped import resolve_file
from ..files.units import TO_MM, decimal
from ..files.yaml_file import load_yaml
from ..robots.file import AnyRobot, load_robot
from ..robots.limits import reading_fault
from ..robots.load import Load, Stretch
from ..robots.robot import Robot
from ..typing import Array
from .study_file import Keys

RobotPath = Annotated[
    AnyRobot,
    in_file(load_robot, "a robot file", kind=AnyRobot),
    Field(description="path of the robot file, relative to this file, or the name of a built-in robot"),
]
"""Robot, given as the path of its file or the name of a built-in robot."""


def _one_per_tube(values: list[Decimal], info: ValidationInfo) -> list[Decimal]:
    robot = info.data.get("robot")  # absent where the robot itself has problems
    if robot is not None and len(values) != robot.n_tubes:
        count = "1 number" if len(values) == 1 else f"{len(values)} numbers"
        raise ValueError(f"has {count}; it must be {robot.n_tubes} (one per tube)")
    key = info.field_name or ""
    if robot is None or robot.calibration is not None or key.startswith(("lower", "upper")):  # readings; ends of a box
        return values
    for i, (value, tube) in enumerate(zip(values, robot.tubes, strict=True)):
        if allowed := reading_fault(tube, key, float(value)):
            raise ValueError(f"has {value} for tube {i + 1}; it must be {allowed}")
    return values


OnePerTube = Annotated[list[Number], AfterValidator(_one_per_tube)]
"""Numbers, one per tube of the study's robot, inner to outer."""


HOME = "home (0, or the nearest value that limits and tube order allow)"
"""Meaning of home, for help texts."""


SHIFTED = Field(None, description=f"translation of every tube, inner to outer; default {HOME}")


def _existing_tube(tube: int, info: ValidationInfo) -> int:
    robot = info.data.get("robot")
    if robot is not None and tube > robot.n_tubes:
        raise ValueError(f"is {tube}; it must be 1 to {robot.n_tubes}")
    return tube


TubeNumber = Annotated[
    Count, AfterValidator(_existing_tube), Field(description="number of the tube, 1 for the innermost")
]
"""Number of a tube of the study's robot."""


def check_within(robot: Robot, name: str, rotations: Array, translations: Array) -> None:
    """Raise InputError for a joint value beyond the limits of a robot, before anything is solved there."""
    for kind, unit, per_si, joint_values, limits in (
        ("rotation", "deg", math.degrees(1), rotations, robot.limits.rotations),
        ("translation", "mm", TO_MM, translations, robot.limits.translations),
    ):
        for i, (value, (low, high)) in enumerate(zip(joint_values.tolist(), limits, strict=True), start=1):
            # Solving far outside takes long and ends in a less clear message.
            if not low - LIMIT_TOLERANCE <= value <= high + LIMIT_TOLERANCE:
                allowed = f"it must be from {low * per_si:.6g} to {high * per_si:.6g} {unit}"
                raise InputError(
                    f"{name} is out of range: {kind} of tube {i} is {value * per_si:.6g} {unit}; {allowed}"
                )


# With six digits 1 rad is 57.2958 deg in a file, which is 4e-7 rad more.
LIMIT_TOLERANCE = 1e-6
"""Rounding of joint values in files, rad and m: a value may exceed its limits by this much."""

OUT_OF_RANGE = re.compile(r"^(\w+) is out of range: (?:(rotation|translation) of tubes? (\d+)[^;]* is )?")


@contextmanager
def rewording_joints(**keys: tuple[str, str]) -> Iterator[None]:
    """Name the key of joint values in an InputError of the library about their range.

    Args:
        keys: argument of the library -> keys of its rotations and of its translations.
    """
    try:
        yield
    except InputError as error:
        match = OUT_OF_RANGE.match(str(error))
        if match is None or match[1] not in keys:
            raise
        rotations, translations = keys[match[1]]
        value_and_range = str(error)[match.end() :]
        if match[2] is None:  # the order of the tubes
            raise InputError(f"{translations} is out of range: {value_and_range}") from None
        key = rotations if match[2] == "rotation" else translations
        raise InputError(f"{key}[{int(match[3]) - 1}] is {value_and_range}") from None


class Posed(Entry):
    """Robot at joint values, which are readings if it has a calibration."""

    robot: RobotPath
    rotations_deg: OnePerTube | None = Field(
        None, description="rotation of every tube, inner to outer; default 0, or the nearest allowed value"
    )
    translations_mm: OnePerTube | None = SHIFTED

    @property
    def joints(self) -> tuple[Array, Array]:
        """Rotations (n,), rad, and translations (n,), m, of the model."""
        return joints_of(self.robot, self.si("rotations_deg"), self.si("translations_mm"))


Joints = Annotated[tuple[Array, Array], Keys(Posed, "joints")]
"""Parameter of a question: rotations (n,), rad, and translations (n,), m, of the model."""


class Shifted(Entry):
    """Robot at translations."""

    robot: RobotPath
    translations_mm: OnePerTube | None = SHIFTED

    @property
    def translations(self) -> Array:
        """Translations (n,), m, of the model."""
        return joints_of(self.robot, None, self.si("translations_mm"))[1]


Translations = Annotated[Array, Keys(Shifted, "translations")]
"""Parameter of a question: translations (n,), m, of the model."""

MinMargin = Annotated[
    Decimal,
    Field(ge=0, lt=1, description="smallest allowed stability margin, below 1", examples=["MU"]),
    BeforeValidator(decimal),
]
"""Required margin of a study."""

DEFAULT_MARGIN = Decimal(str(MIN_MARGIN))
"""Default of `MinMargin`."""


class Started(Entry):
    """Robot at the start of a motion."""

    robot: RobotPath
    start_deg: OnePerTube | None = Field(
        None, description="rotations at the start; default 0, or the nearest allowed value"
    )
    start_mm: OnePerTube | None = Field(None, description=f"translations at the start; default {HOME}")

    @property
    def start(self) -> tuple[Array, Array]:
        """Rotations (n,), rad, and translations (n,), m, of the model at the start."""
        return joints_of(self.robot, self.si("start_deg"), self.si("start_mm"))


def joints_of(
    robot: Robot, rotation_readings: Sequence[float] | None, translation_readings: Sequence[float] | None
) -> tuple[Array, Array]:
    """Convert drive readings to rotations (n,), rad, and translations (n,), m, of the model.

    Without a calibration both are equal. Default rotations are 0, or the nearest value within the limits of the drives;
    default translations are home.

    Raises:
        SolveError: carriages yield without end.
    """
    limits = robot.limits if robot.joint_limits is None else robot.joint_limits
    low, high = np.array(limits.rotations).T
    # Limits in the file are of readings, so that 0 is clipped as a reading.
    rotations = np.clip(0.0, low, high) if rotation_readings is None else np.array(rotation_readings)
    if translation_readings is not None:
        return to_model(robot, rotations, np.array(translation_readings))
    calibration = robot.calibration
    # Home translations are values of the model; only rotations are converted.
    rotations = rotations if calibration is None else calibration.to_model(rotations, 0.0)[0]
    return rotations, robot.home_translations


# --- loads, in a study or in a file of their own: forces in mN, moments in mN m, lengths in mm ------------------------


@keys_from(Load)
class LoadEntry(Part):
    """External load on the robot."""

    distributed_mN_per_m: Triple | list[EntryOf[Stretch]] | None = Field(
        None, description="load per length in the base frame, along the whole arm or on parts of it"
    )

    def build(self) -> Load:
        """Load in SI; raises InputError for a part without force and moment."""
        along: Any = self.distributed_mN_per_m
        stretches = along if along and isinstance(along[0], Part) else []
        points: list[Part] = getattr(self, "points") or []  # noqa: B009  # a field that `keys_from` adds
        for name, parts in (("points", points), ("distributed_mN_per_m", stretches)):
            for k, part in enumerate(parts):
                # A part without force and moment is a forgotten key, not a load of 0.
                keys = [key for key in type(part).model_fields if key.startswith(("force", "moment"))]
                if not part.model_fields_set & set(keys):
                    raise InputError(f"{name}[{k}] has no load; it must have {' or '.join(keys)}")
        if along and isinstance(along[0], Part):
            along = tuple(part.build() for part in along)
        elif along is not None:
            along = self.si("distributed_mN_per_m") or None
        return Load(**values(Load, self), distributed=along)


def load_entry(path: str | PathLike[str]) -> LoadEntry:
    """Load a load file; raises InputError with one line per problem."""
    return check(LoadEntry, load_yaml(path), path)


def _entry(value: object, info: ValidationInfo) -> LoadEntry | None:
    if value is None or isinstance(value, LoadEntry):
        return value
    if isinstance(value, str):
        return load_entry(resolve_file(value, info.context["directory"]) if info.context else resolve_file(value))
    return check(LoadEntry, value, "")


LOAD_KEYS = {one.key: one for one in keys_in(Load) if one.name in ("force", "moment", "gravity")}
"""Keys of a load that a study may have itself."""


@with_keys(
    {key: (Triple | None, Field(None, description=one.about, examples=["X,Y,Z"])) for key, one in LOAD_KEYS.items()}
)
class Loaded(Entry):
    """Robot with an optional load; keys of the study replace those of its load."""

    load: Annotated[
        LoadEntry | None,
        PlainValidator(_entry, json_schema_input_type=str | LoadEntry | None),
        Field(
            description="external load: path of a load file, or its keys as {tip_force_mN: [20, 0, 0]}; default no "
            "load. Other load keys, such as tip_force_mN, replace its values"
        ),
    ] = None

    @property
    def external_load(self) -> Load | None:
        """Load of the study; None without one."""
        overrides = {key: getattr(self, key) for key in LOAD_KEYS if getattr(self, key) is not None}
        if self.load is None and not overrides:
            return None
        # Copied, since entries are frozen; `build` checks the sum of both.
        return (self.load or check(LoadEntry, {}, "")).model_copy(update=overrides).build()


ExternalLoad = Annotated[Load | None, Keys(Loaded, "external_load")]
"""Parameter of a question: the external load, None without one."""
