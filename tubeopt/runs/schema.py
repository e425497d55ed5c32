"""JSON Schemas of all files for editors, and their documentation page: `python -m tubeopt.runs.schema`."""

from __future__ import annotations

import functools
import json
import operator
import re
from collections import Counter
from collections.abc import Mapping
from decimal import Decimal
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from ..files.checked import Entry
from ..files.files import write_text
from ..robots.file import ROBOT_KINDS
from ..robots.passport import PASSPORT_KINDS
from .design_parts import STOCK_KINDS
from .inverse_study import JointsFile
from .study_file import STUDY_KINDS
from .surroundings_file import ObstacleFile
from .sweep_file import SweepEntry
from .workshop_file import MOLD_KINDS, OVEN_KINDS, RIG_KINDS


class _Numbers(GenerateJsonSchema):
    """JSON Schema with decimals as numbers, not as text."""

    def decimal_schema(self, schema: core_schema.DecimalSchema) -> JsonSchemaValue:
        bounds: dict[str, Any] = {key: float(schema[key]) for key in ("gt", "ge", "lt", "le") if key in schema}
        number: JsonSchemaValue = {"type": "number"}
        self.update_with_validations(number, bounds, self.ValidationsMapping.numeric)
        return number

    def encode_default(self, dft: Any) -> Any:
        if isinstance(dft, list):
            return [self.encode_default(each) for each in dft]
        return float(dft) if isinstance(dft, Decimal) else super().encode_default(dft)

    def field_title_should_be_set(self, schema: Any) -> bool:
        return False  # the key says it


def _schema(kinds: Mapping[str, type[Entry]], title: str) -> str:
    union: Any = functools.reduce(operator.or_, kinds.values())
    # One union of all kinds: definitions that they share are written once.
    schema = TypeAdapter(union).json_schema(schema_generator=_Numbers)
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    return json.dumps(head | schema | {"title": title}, indent=2) + "\n"


def schemas() -> dict[str, str]:
    """File name -> JSON Schema, as text."""
    return {
        "joints.schema.json": _schema({"joints": JointsFile}, "tubeopt joint values"),
        "obstacles.schema.json": _schema({"obstacles": ObstacleFile}, "tubeopt obstacles"),
        "mold.schema.json": _schema(MOLD_KINDS, "tubeopt mold"),
        "passport.schema.json": _schema(PASSPORT_KINDS, "tubeopt passport of a tube"),
        "rig.schema.json": _schema(RIG_KINDS, "tubeopt rig"),
        "oven.schema.json": _schema(OVEN_KINDS, "tubeopt oven"),
        "robot.schema.json": _schema(ROBOT_KINDS, "tubeopt robot"),
        "study.schema.json": _schema({**STUDY_KINDS, "sweep": SweepEntry}, "tubeopt study"),
        "tubes.schema.json": _schema(STOCK_KINDS, "tubeopt stock of tubes"),
    }


PAGE = "docs/files.md"

INTRODUCTION = """# Files

All keys of all files. A key ends in the unit of its number. A key without a default may be left out, unless it is
required. Editors complete the keys with the schemas in `configs/schema/`. A message about a wrong key suggests the
nearest one.

A whole robot, tubes inner to outer (`configs/robots/` has twenty more):

```yaml
kind: concentric
name: my robot
tubes:
  - {outer_diameter_mm: 1.1, inner_diameter_mm: 0.9, straight_length_mm: 150, curved_length_mm: 60, radius_mm: 80}
  - {outer_diameter_mm: 1.6, inner_diameter_mm: 1.3, straight_length_mm: 80, curved_length_mm: 50, curvature_per_m: 9}
```

`python -m tubeopt.runs.schema` writes this page from the models that check the files.
"""

HEAD = ["| key | default | meaning |", "|---|---|---|"]

TITLES = {
    # obstacles
    "AnatomyEntry": "Obstacles of an anatomy file",
    "Box": "Box",
    "Capsule": "Capsule",
    "Corridor": "Corridor (vessel)",
    "HalfSpace": "Half-space",
    "MeshEntry": "Mesh file as an obstacle",
    "Sphere": "Sphere",
    # molds
    "ClampSpec": "Clamps outside the mold",
    "EndMill": "End mill",
    "GrooveSpec": "Groove",
    "HeatSpec": "Heating conditions of a mold",
    "MillingSpec": "Milling of the groove",
    "MoldMaterial": "Mold material",
    "PlateSpec": "Plates and bolts",
    "SpringbackEntry": "Spring-back",
    "VentSpec": "Vents",
    "SlotSpec": "Slot",
    "HingeSpec": "Hinge",
    "WorkshopSpec": "Milling machine and G-code",
    # passports
    "HeatingEntry": "Heating of a passport",
    "RadiusEntry": "Measured radius of a passport",
    "SpringbackTrialsEntry": "Spring-back of a passport",
    "ValidationEntry": "Validation of a passport",
    # rigs
    "BatteryEntry": "Battery",
    "Circuit": "Circuit (cables, contacts, MOSFET)",
    "Clamps": "Clamps of the rig",
    "MoldBed": "Mold around the heated tube",
    "ThermalData": "Thermal and electrical constants",
    # tubes and robots
    "HelixEntry": "Helix",
    "MaterialEntry": "Tube material",
    "PatternEntry": "Slots: remaining stiffness",
    "PieceEntry": "Piece of a tube",
    "SeriesEntry": "Varying curvature or stiffness",
    "Slots": "Slots: geometry",
    "TubeEntry": "Tube",
    "BundleTubeEntry": "Tube of a bundle",
    "BundleEntry": "Bundle robot",
    "CalibrationEntry": "Calibration of the joints",
    "ConcentricEntry": "Concentric tube robot",
    "EccentricEntry": "Eccentric tube robot, one segment",
    "SegmentedEccentricEntry": "Eccentric tube robot, several segments",
    "Buffer": "Buffer between drive and sheath",
    "Friction": "Friction between tubes",
    "Posterior": "Uncertainty of the parameters",
    "Deviation": "Deviation of a parameter",
    "JointLimits": "Joint limits",
    "SavedRegistration": "Registration of a measuring device",
    # parts of studies
    "AnatomyPart": "Anatomy: image, meshes, points",
    "ArmPart": "Arm of several robots",
    "AvoidEntry": "Requirement: avoid bodies",
    "BallPart": "Ball",
    "BasePart": "Base pose in the patient",
    "CorridorRequirementEntry": "Requirement: stay in a corridor",
    "Coverage": "Requirement: reach a box",
    "CutPart": "Section plane of figures",
    "EntryPart": "Entry: allowed base poses",
    "FreeEntry": "Free dimension of a design",
    "LandmarksPart": "Landmarks",
    "LengthEntry": "Requirement: length of a tube",
    "LoadEntry": "Load: tip force, moment, gravity",
    "MeshPart": "Mesh file in a patient",
    "Objective": "Objective of a design",
    "PairPart": "Robot of a pair",
    "PointLoad": "Point load",
    "PointsPart": "Point cloud",
    "PoseEntry": "Task pose of a design",
    "RateLimits": "Rates and accelerations",
    "RegionEntry": "Objective: reachable part of a target region",
    "RegistrationPart": "Registration by landmarks",
    "Requirements": "Requirements of a design",
    "SampleEntry": "Random samples of a sweep",
    "SnapFree": "Requirement: snap-free at all rotations",
    "SnapFreeInUse": "Requirement: snap-free at task poses",
    "StockStudy": "Stock of a design",
    "Strain": "Requirement: largest strain",
    "Deflection": "Deflection of the tip",
    "Stretch": "Distributed load",
    "StructurePart": "Image of one structure",
    "Target": "Target of the tip",
    "TolerancesEntry": "Manufacturing tolerances",
    "VaryEntry": "Varied keys of a sweep",
    "StockEntry": "Tube size in stock",
    # studies
    "ArmsStudy": "Study: plan several robots",
    "CertifyStudy": "Study: certify",
    "DeployStudy": "Study: deploy the arm among walls",
    "DesignStudy": "Study: design",
    "DrivesStudy": "Study: loads of the drives",
    "EquilibriaStudy": "Study: all equilibria",
    "FabricationStudy": "Study: fabricate a robot",
    "FatigueStudy": "Study: fatigue of the tubes",
    "FollowStudy": "Study: follow a joint path",
    "ForceStudy": "Study: estimate the tip force",
    "ForwardKinematicsStudy": "Study: forward kinematics",
    "HeatingCalibrationStudy": "Study: calibrate a heating rig",
    "HeatingRunStudy": "Study: run a heating",
    "HeatingStudy": "Study: plan a heating",
    "InverseStudy": "Study: inverse kinematics",
    "ClosedLoopStudy": "Study: closed-loop heating and firmware",
    "LoadLimitStudy": "Study: load limit",
    "MandrelStudy": "Study: mandrel",
    "MaterialsStudy": "Study: rank mold materials",
    "MeasureStudy": "Study: choose measurements",
    "CommissionStudy": "Study: commission a robot",
    "MoldCalibrationStudy": "Study: calibrate spring-back",
    "MoldStudy": "Study: mold",
    "OvenStudy": "Study: plan an oven",
    "PairStudy": "Study: design two robots",
    "PlanStudy": "Study: plan a trajectory",
    "SnapStudy": "Study: first snap",
    "StabilityMapStudy": "Study: stability map",
    "SweepEntry": "Study: sweep",
    "TubePhotoStudy": "Study: measure a tube in a photo",
    "ValidationStudy": "Study: validate and calibrate",
    "VerifyStudy": "Study: verify a trajectory",
    "WorkspaceStudy": "Study: workspace",
}
"""Heading of every model on the page."""

SHARED = 3
"""Smallest number of tables with an equal row that moves it into a table of shared keys."""


def page() -> str:
    """Documentation page about files, as Markdown with a table of keys for every model."""
    lines = [INTRODUCTION]
    done: set[str] = set()
    for name, text in schemas().items():
        schema = json.loads(text)
        title = schema["title"].removeprefix("tubeopt ").capitalize()
        lines += [f"## {title} (`{name}`)", ""]
        root = [("", schema)] if "properties" in schema else []
        parts = [part for part in (*root, *schema.get("$defs", {}).items()) if "properties" in part[1]]
        parts = [part for part in parts if part[0] not in done]
        done |= {part for part, _ in parts if part}
        tables = {part: _rows(keys) for part, keys in parts}
        count = Counter(row for rows in tables.values() for row in rows.items())
        # Rare rows first: of several meanings of one key the most frequent remains.
        shared = {key: row for (key, row), n in sorted(count.items(), key=lambda entry: entry[1]) if n >= SHARED}
        if shared:
            lines += [f"### {title}: shared keys", "", *HEAD, *shared.values(), ""]
        for part, keys in parts:
            lines += [f"### {_title(part)}", ""] if part else []
            about = " ".join(keys.get("description", "").partition("\n\n")[0].split())
            lines += [f"{_kind(keys)}{about}", ""]
            rows = {key: row for key, row in tables[part].items() if shared.get(key) != row}
            lines += [*HEAD, *rows.values(), ""] if rows else []
            if omitted := [f"`{key}`" for key in tables[part] if key not in rows]:
                lines += [f"And the [shared keys]({_anchor(title)}-shared-keys) {', '.join(omitted)}.", ""]
    return "\n".join(lines)


def _rows(part: Mapping[str, Any]) -> dict[str, str]:
    """Table rows of a model: key -> row, without the key `kind`."""
    required = part.get("required", ())
    keys: Mapping[str, Any] = part["properties"]
    return {key: _row(key, value, key in required) for key, value in keys.items() if "const" not in value}


def _kind(part: Mapping[str, Any]) -> str:
    """Kind of a model as Markdown; "" without one."""
    kinds = [value["const"] for value in part["properties"].values() if "const" in value]
    return f"`kind: {kinds[0]}`. " if kinds else ""


def _title(name: str) -> str:
    """Heading of a model on the page."""
    return TITLES[name.rpartition("__")[2]]


def _anchor(title: str) -> str:
    """Link to a heading, as the website names it."""
    return "#" + re.sub(r"[\s-]+", "-", re.sub(r"[^\w\s-]", "", title).strip().lower())


def _row(key: str, value: dict[str, Any], required: bool) -> str:
    default = value.get("default")
    shown = "required" if required else "" if default is None else f"`{json.dumps(default)}`"
    description, allowed = value.get("description", ""), _allowed(value)
    choices = allowed.split(" or ")
    if len(choices) > 1 and all(re.search(rf"(?<![\w-]){re.escape(word)}(?![\w-])", description) for word in choices):
        allowed = ""  # the description has all choices
    return f"| `{key}` | {shown} | {'; '.join(filter(None, (description, allowed)))} |"


def _allowed(value: dict[str, Any]) -> str:
    """Allowed values of a key: its choices, the bounds of its number, or a link to its model."""
    if "const" in value:
        return str(value["const"])
    if "enum" in value:
        return " or ".join(str(word) for word in value["enum"])
    if "$ref" in value:
        title = _title(value["$ref"].rpartition("/")[2])
        return f"[{title}]({_anchor(title)})"
    signs = {"exclusiveMinimum": ">", "minimum": "≥", "exclusiveMaximum": "<", "maximum": "≤"}
    bounds = [f"{sign} {value[name]:g}" for name, sign in signs.items() if name in value]
    inner = [_allowed(each) for each in (*value.get("anyOf", ()), *value.get("oneOf", ()))]
    inner += [_allowed(value["items"])] if isinstance(value.get("items"), dict) else []
    if len([word for word in inner if word.startswith("[")]) > 2:
        return "[obstacles](#obstacles-obstaclesschemajson)"
    return ", ".join(bounds) or " or ".join(dict.fromkeys(word for word in inner if word))


def write_schemas(directory: str | Path = "configs/schema") -> list[Path]:
    """Write the schemas into a directory and return their paths; raises InputError if that fails."""
    paths = []
    for name, text in schemas().items():
        paths.append(Path(directory) / name)
        write_text(paths[-1], text)
    return paths


if __name__ == "__main__":
    write_text(PAGE, page())
    for path in (PAGE, *write_schemas()):
        print(path)
