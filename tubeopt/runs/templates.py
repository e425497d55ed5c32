"""Template files for a robot, a rig, or a study of any kind, valid without changes.

Comments describe the keys and list further keys.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from ..display import Displayed
from ..equilibrium.kinematics import forward_kinematics
from ..errors import InputError, nearest
from ..files.checked import Count, Entry, Number, Positive, check_kind
from ..files.shipped import find_file, shipped
from ..files.units import TO_MM
from ..files.yaml_file import commented, load_yaml, read_flow
from ..robots.file import ROBOT_KINDS, load_robot, robot_from_dict
from ..robots.materials import MATERIALS
from ..robots.robot import Robot
from ..shaping.materials import MOLD_MATERIALS
from .study_file import STUDY_KINDS
from .sweep_file import SweepEntry
from .workshop_file import RIG_KINDS, rig_from_dict

Data = dict[str, Any]

TUBE_KEYS = ("outer_diameter_mm", "inner_diameter_mm", "straight_length_mm", "curved_length_mm", "radius_mm")
"""Required keys of a tube."""


def usual_tubes(count: int) -> dict[str, list[Decimal]]:
    """Dimensions of nested tubes that can be inserted in order: key -> one number per tube, inner to outer."""
    i = range(count)
    return {
        # Steps of 0.3 mm with walls of 0.1 mm leave 0.05 mm of radial clearance.
        "outer_diameter_mm": [Decimal("1.0") + k * Decimal("0.3") for k in i],
        "inner_diameter_mm": [Decimal("0.8") + k * Decimal("0.3") for k in i],
        "straight_length_mm": [Decimal(50 * (count - k)) for k in i],
        "curved_length_mm": [Decimal(30 + 10 * (count - k)) for k in i],
        "radius_mm": [Decimal(60 + 40 * k) for k in i],
    }


USUAL_COUNT = 2
"""Default number of tubes."""

USUAL_SINGLE = dict(zip(TUBE_KEYS, ([Decimal(x)] for x in ("1.92", "1.57", "0", "94", "120")), strict=True))
"""Tube of an eccentric robot or on a rig, from the thesis (Table 3.1)."""


@dataclass(frozen=True)
class WrittenFile(Displayed):
    """Template file that was written."""

    then: str
    """Command that uses the file."""


class NewTubes(Entry):
    """Tubes of a template, with default dimensions."""

    usual_count: ClassVar = USUAL_COUNT

    outer_diameter_mm: list[Number] | None = Field(None, description="outer diameter of every tube, inner to outer")
    inner_diameter_mm: list[Number] | None = Field(None, description="inner diameter of every tube")
    straight_length_mm: list[Number] | None = Field(
        None, description="length of the straight part, from the clamped end"
    )
    curved_length_mm: list[Number] | None = Field(None, description="length of the curved part, up to the tip")
    radius_mm: list[Number] | None = Field(None, description="radius of the centreline of the curved part")

    @model_validator(mode="after")
    def _as_many(self) -> Self:
        for key, values in self.numbers.items():
            if len(values) != self.count:
                raise InputError(
                    f"{key} has {len(values)} number{'s' * (len(values) != 1)}; it must be {self.count} (one per tube)"
                )
        return self

    @property
    def numbers(self) -> dict[str, list[Decimal]]:
        """Given dimensions: key -> one number per tube."""
        return {key: getattr(self, key) for key in TUBE_KEYS if getattr(self, key) is not None}

    @property
    def count(self) -> int:
        """Number of tubes: as given, otherwise the number of dimensions, otherwise the default."""
        return getattr(self, "tubes", None) or max(map(len, self.numbers.values()), default=self.usual_count)

    @property
    def single(self) -> Data:
        """Keys of the only tube; raises InputError for several tubes."""
        if any(len(values) != 1 for values in self.numbers.values()) or getattr(self, "tubes", 1) not in (None, 1):
            raise InputError("several tubes are given; give one number for each dimension of the one tube")
        return {key: values[0] for key, values in (USUAL_SINGLE | self.numbers).items()}


class NewRobot(NewTubes):
    """Robot of a template, with defaults for missing keys."""

    prompted: ClassVar = ("name", "tubes", *TUBE_KEYS, "material")
    """Keys that are prompted for in a dialogue, in order."""

    tubes: Count | None = Field(
        None, le=6, description="number of tubes of a concentric robot, at most 6; the lists of dimensions give it too"
    )
    name: str | None = Field(None, description="name of the robot")
    robot_kind: Literal["concentric", "eccentric"] | None = Field(
        None, description="kind of robot; concentric by default"
    )
    material: str | None = Field(None, description=f"material of the tubes: {', '.join(MATERIALS)}")

    @property
    def usual(self) -> dict[str, Any]:
        """Defaults of the keys."""
        return {"name": "my robot", "tubes": self.count, "material": "nitinol"} | usual_tubes(self.count)

    def text(self, path: Path) -> str:
        """Text of the robot file; raises InputError for an invalid robot."""
        kind = self.robot_kind or "concentric"
        named = {"kind": kind, "name": self.name or self.usual["name"]}
        material = {"material": self.material or self.usual["material"]}
        if kind == "concentric":
            numbers = usual_tubes(self.count) | self.numbers
            tubes = [{key: values[k] for key, values in numbers.items()} for k in range(self.count)]
            data = named | {"tubes": [tube | material for tube in tubes]}
        else:
            data = named | {"tube": self.single | material}
        text = commented(ROBOT_KINDS[kind], data, f"A robot, tubes inner to outer: tubeopt robot show {path.name}\n")
        # Read back as a check: the template must be valid.
        robot_from_dict(read_flow(text), path)
        return text


class NewRig(NewTubes):
    """Rig of a template with its tube, with defaults for missing keys."""

    usual_count: ClassVar = 1

    prompted: ClassVar = ("name", "capacity_Ah", "charge_percent", "mold", *TUBE_KEYS)
    """Keys that are prompted for in a dialogue, in order."""

    name: str | None = Field(None, description="name of the rig")
    capacity_Ah: Positive | None = Field(None, description="capacity of the battery")
    charge_percent: Positive | None = Field(None, description="state of charge of the battery")
    mold: str | None = Field(None, description=f"material of the mold: {', '.join(MOLD_MATERIALS)}")

    @property
    def usual(self) -> dict[str, Any]:
        """Defaults of the keys."""
        values = {
            "name": "my rig",
            "capacity_Ah": Decimal(60),
            "charge_percent": Decimal(100),
            "mold": "calcium_silicate",
        }
        return values | USUAL_SINGLE

    def text(self, path: Path) -> str:
        """Text of the rig file; raises InputError for an invalid rig."""
        keys = self.usual | self.model_dump(exclude_none=True)
        data = {
            "kind": "rig",
            "name": keys["name"],
            "battery": {"capacity_Ah": keys["capacity_Ah"], "state_of_charge_percent": keys["charge_percent"]},
            "mold": {"material": keys["mold"]},
            "tube": self.single,
        }
        header = f"A rig that heats tubes to set their shape: tubeopt heat plan {path.name} --sensor thermocouple\n"
        text = commented(RIG_KINDS["rig"], data, header)
        rig_from_dict(read_flow(text), path)
        return text


# --- studies ----------------------------------------------------------------------------------------------------------


def _fan(robot: Robot) -> list[int]:
    """Rotations in steps of 30 deg."""
    return [30 * k for k in range(robot.n_tubes)]


def _turn(robot: Robot, angle: int) -> list[int]:
    """Rotations, deg, with only the first tube rotated."""
    return [angle, *[0] * (robot.n_tubes - 1)]


def _reachable_target(robot: Robot) -> list[float]:
    """Tip position of a stable shape, mm."""
    # Taken from a solved shape, so that the target can be reached by any robot.
    tip = forward_kinematics(robot, np.radians(_fan(robot))).tip_position
    return [round(float(x), 1) for x in tip * TO_MM]


def _design(robot: Robot) -> Data:
    curvature = max(abs(tube.curvature) for tube in robot.tubes)
    tubes = list(range(1, robot.n_tubes + 1))
    return {
        # 1.5 times the largest curvature of the robot, so that the search can increase and decrease it.
        "free": [{"tubes": tubes, "curvature_per_m": [0.5, round(max(1.5 * curvature, 1.0), 1)]}],
        "requirements": {"snap_free": {"margin": 0.05}},
        "objective": {"kind": "change"},
    }


EXAMPLES: dict[str, Callable[[Robot], Data]] = {
    "forward_kinematics": lambda robot: {"rotations_deg": _fan(robot)},
    "inverse_kinematics": lambda robot: {"target_mm": _reachable_target(robot)},
    "equilibria": lambda robot: {"rotations_deg": _turn(robot, 190)},
    "snap": lambda robot: {"to_deg": _turn(robot, 360)},
    "load_limit": lambda robot: {"rotations_deg": _fan(robot), "tip_force_mN": [-10, 0, 0]},
    "follow": lambda robot: {"path": "turn_and_back"},
    "drives": lambda robot: {"along": "turn_and_back"},
    "fatigue": lambda robot: {"along": "turn_and_back"},
    "force": lambda robot: {"measurements": "synthetic_forces"},
    "validation": lambda robot: {"measurements": "synthetic_etr"},
    "commission": lambda robot: {"logs": ["commission_log"]},
    "measure": lambda robot: {"fit": ["curvature_1"]},
    "plan": lambda robot: {"goal_deg": _turn(robot, 90)},
    "deploy": lambda robot: {"walls": "bent_vessel"},
    "design": _design,
    "workspace": lambda robot: {"samples": 2000},
    "fabrication": lambda robot: {"rig": "thesis_calcium_silicate", "sensor": "thermocouple"},
}
"""Kind of a study of a robot -> example values of its required keys."""

ROBOTS = {
    "commission": "braunschweig_pair",
    "validation": "thesis_etr",
    "mandrel": "example_pieces",
    "design": "example_equal_ends",
} | dict.fromkeys(("mold_plan", "mold_materials", "fabrication"), "thesis_etr")
"""Kind -> default robot of its template; thesis_ctr for other kinds."""

OF_RIGS: dict[str, Data] = {
    "heating": {"rig": "thesis_calcium_silicate", "sensor": "thermocouple"},
    "led_heating": {"rig": "thesis_calcium_silicate"},
    "oven": {"oven": "steel_slab"},
    "heating_run": {"simulate": "thesis_calcium_silicate"},
    "heating_calibration": {"rig": "thesis_calcium_silicate", "log": "heating_log"},
    "mold_calibration": {"trials": "example_trials"},
    "tube_photo": {},
    "verify": {},
}
"""Kind of a study without a robot -> example values of its required keys."""

COPIED = {"design_pair": "design_pair", "plan_arms": "plan_two_arms", "sweep": "sweep_curvature"}
"""Kind -> built-in study that is copied."""

KINDS: tuple[str, ...] = (*STUDY_KINDS, "sweep")
"""Kinds of studies."""


class NewStudy(Entry):
    """Study of a template, which runs without changes."""

    prompted: ClassVar = ("study_kind", "robot")
    """Keys that are prompted for in a dialogue, in order."""

    study_kind: str | None = Field(
        None,
        description="kind of study, such as snap, plan or design; an unknown one prints the list",
        examples=["KIND"],
    )
    robot: str | None = Field(
        None, description="robot: a file, or a name of `tubeopt robot list`; by default one that suits the kind"
    )

    @field_validator("study_kind")
    @classmethod
    def _known(cls, kind: str | None) -> str | None:
        if kind is not None and kind not in KINDS:
            raise ValueError(f"is {kind!r}; it must be one of {', '.join(KINDS)}{nearest(kind, KINDS)}")
        return kind

    @field_validator("robot")
    @classmethod
    def _loadable(cls, robot: str | None) -> str | None:
        if robot is not None:
            load_robot(robot)
        return robot

    @property
    def kind(self) -> str:
        """Kind of the study."""
        return self.study_kind or "forward_kinematics"

    @property
    def usual(self) -> Data:
        """Defaults of the keys."""
        robot = None if self.kind in (*COPIED, *OF_RIGS) else ROBOTS.get(self.kind, "thesis_ctr")
        return {"study_kind": self.kind, "robot": robot}

    def data(self, extra: Mapping[str, Any], path: Path) -> Data:
        """Contents of the study file at `path`, with further keys `extra`."""
        if self.kind in (*COPIED, *OF_RIGS):
            if self.robot is not None:
                raise InputError(f"a study of kind {self.kind} has no robot that could be chosen here")
            known: Data = (
                _by_name(load_yaml(shipped()[COPIED[self.kind]])) if self.kind in COPIED else OF_RIGS[self.kind]
            )
            return {"kind": self.kind, **known, **extra}
        name = self.robot or self.usual["robot"]
        robot = load_robot(name)
        example = EXAMPLES[self.kind](robot) if self.kind in EXAMPLES else {}
        return {"kind": self.kind, "robot": _relative(name, path), **example, **extra}

    def text(self, path: Path, extra: Mapping[str, Any]) -> str:
        """Text of the study file, with further keys `extra`; raises InputError for an invalid study."""
        data = self.data(extra, path)
        model: type[Entry] = SweepEntry if self.kind == "sweep" else STUDY_KINDS[self.kind]
        text = commented(model, data, f"A study: tubeopt {'sweep' if self.kind == 'sweep' else 'run'} {path.name}\n")
        # The relative path of the robot cannot be checked yet: the folder of the file may not exist.
        absolute = {"robot": str(find_file(self.robot, "robots").absolute())} if self.robot is not None else {}
        check_kind({self.kind: model}, read_flow(text) | absolute, path)
        return text


def _relative(robot: str, path: Path) -> str:
    """Robot in a study file at `path`: its built-in name, or its path relative to the file."""
    file = find_file(robot, "robots")
    if shipped().get(robot) == file:
        return robot
    return Path(os.path.relpath(file.absolute(), path.absolute().parent)).as_posix()


def _by_name(data: Any) -> Any:
    """Replace relative paths of built-in files by their names."""
    if isinstance(data, dict):
        return {key: _by_name(value) for key, value in data.items()}
    if isinstance(data, list):
        return [_by_name(value) for value in data]
    if isinstance(data, str) and data.startswith("../"):
        return Path(data).stem
    return data
