"""The report on every kind of answer.

    python -m tubeopt.show.reports

writes the page of the docs that says what `--json` prints, from the lists of quantities.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..files.files import write_text
from .quantities import Quantity
from .report import FILM_FORMATS, PICTURE_FORMATS, SOLID_FORMATS, TABLE_FORMATS, Report
from .report import report as registered

MODULES = {
    "certify_report": ("Certification",),
    "command_report": (
        "Doctor",
        "CLibrary",
        "ShippedFiles",
        "WrittenFile",
        "Viewed",
        "Served",
    ),
    "commission_report": ("Commissioning",),
    "design_report": (
        "DesignAnswer",
        "PairAnswer",
    ),
    "equilibrium_report": (
        "Equilibrium",
        "ConcentricRobot",
        "EccentricRobot",
        "SegmentedEccentricRobot",
        "BundleRobot",
    ),
    "drives_report": (
        "Drives",
        "Fatigue",
    ),
    "fabrication_report": (
        "Fabrication",
        "RobotMold",
        "Calibration",
        "MoldRanking",
        "Mandrel",
        "MeasuredTube",
    ),
    "heat_report": (
        "Heating",
        "RigFit",
        "ClosedLoopHeating",
        "HeatingRun",
        "OvenPlan",
    ),
    "inverse_report": (
        "Postures",
        "TargetTable",
    ),
    "plan_report": (
        "Trajectory",
        "VerifiedTrajectory",
        "ArmsPlan",
        "Deployment",
    ),
    "snap_report": (
        "LoadLimitResult",
        "ForceRecord",
        "Equilibria",
        "StraightMotion",
        "Path",
        "RobotMap",
    ),
    "validation_report": (
        "Comparison",
        "Validation",
        "Fit",
        "Placement",
    ),
    "workspace_report": (
        "Sweep",
        "Findings",
    ),
}
"""Modules with reports -> the classes of their answers: each is imported when there is such an answer."""

PAGE = "docs/json.md"

INTRODUCTION = """# JSON output

Every command prints one JSON object with `--json`, and saves the same object with `--out`.

- A key ends in the unit of its numbers. Numbers that are not finite are null.
- `a.b` is the key b of the object a, or of each object in the list a.
- A key without a value is null, unless the table says "absent".
- `files` is in every object: the paths of the written files.
- `warnings` is in every object: sentences that stderr shows without `--json`.
- `error` reports a failure, next to the answer if there is one. It has these keys:

| key | value |
|---|---|
| `error.kind` | `input`, `usage`, `no_solution`, `not_proved` or `interrupted` |
| `error.exit_code` | 2, 2, 3, 4 or 130, in the same order |
| `error.messages` | sentences |

`tubeopt run` prints the object of the command of its study. A sweep has a column for every number of these objects.

`python -m tubeopt.show.reports` writes this page from the lists of quantities in `tubeopt/show/`.
"""


def report(answer: object) -> Report[Any]:
    """The report on an answer of any kind.

    Raises:
        TypeError: no report for such an object.
    """
    # By name, so that the class of an answer need not be imported to be compared.
    names = {kind.__name__ for kind in type(answer).__mro__}
    for module, known in MODULES.items():
        if names & set(known):
            importlib.import_module(f".{module}", __package__)
    return registered(answer)


def to_dict(answer: object) -> Mapping[str, Any]:
    """Record of an answer of any kind, as `--json` prints it: plain numbers, text, lists and mappings.

    Raises:
        TypeError: no report for such an object.
    """
    return report(answer).record()


def reports() -> dict[str, type[Report[Any]]]:
    """Class of the report for each command."""
    for module in MODULES:
        importlib.import_module(f".{module}", __package__)
    known: Mapping[Any, Any] = registered.registry
    kinds = {
        kind.command: kind
        for kind in known.values()
        if isinstance(kind, type) and issubclass(kind, Report) and kind.command  # parts of others have none
    }
    return dict(sorted(kinds.items()))


def formats_of(command: str) -> tuple[str, ...]:
    """Formats of the answer of a command in addition to JSON and CSV, with any of its flags."""
    named = f'command = "{command}'
    for module in MODULES:  # those alone that say so: all of them take seconds
        if named in (Path(__file__).parent / f"{module}.py").read_text(encoding="utf-8"):
            importlib.import_module(f".{module}", __package__)
    known: Any = registered.registry.values()
    kinds = [kind for kind in known if getattr(kind, "command", "").partition(" --")[0] == command]

    def has(name: str) -> bool:
        return any(getattr(kind, name) is not getattr(Report, name) for kind in kinds)

    pictures = PICTURE_FORMATS if has("pictures") or any(kind.drawn for kind in kinds) else ()
    kinds_of = {"films": FILM_FORMATS, "tables": TABLE_FORMATS, "solids": SOLID_FORMATS}
    return (*pictures, *(form for name, forms in kinds_of.items() if has(name) for form in forms))


Signature = tuple[Any, ...]
"""Key and meaning of a quantity and its parts; equal for quantities that a reader needs to read only once."""


def page() -> str:
    """The page of the docs about `--json`, as Markdown."""
    lines = [INTRODUCTION]
    described: dict[Signature, str] = {}
    commands = {_signatures(kind.quantities): command for command, kind in reports().items()}
    for command, kind in reports().items():
        lines += [f"## `tubeopt {command}`", "", "| key | meaning |", "|---|---|"]
        others = {signatures: link for signatures, link in commands.items() if link != command}
        known = {signatures: _link(link) for signatures, link in others.items()}
        rows = _keys(kind.quantities, "", command, known | described, described)
        lines += [f"| `{path}` | {about} |" for path, about in rows]
        lines.append("")
    return "\n".join(lines)


def _link(command: str) -> str:
    return f"[`tubeopt {command}`](#tubeopt-{command.replace(' --', '-').replace(' ', '-')})"


def _signatures(quantities: Sequence[Quantity[Any]]) -> Signature:
    return tuple((q.key, q.about, _signatures(q.of or ())) for q in quantities if q.key)


def _keys(
    quantities: Sequence[Quantity[Any]], path: str, command: str, known: dict[Signature, str], new: dict[Signature, str]
) -> Iterator[tuple[str, str]]:
    """Path and meaning of every key of some quantities; `known` lists are only named, other lists are
    added to `new`.
    """
    shown = [quantity for quantity in quantities if quantity.key]
    signatures = _signatures(shown)
    i = 0
    while i < len(shown):
        # Two keys are shorter than a reference to them; the whole list cannot refer to itself.
        same = [one for one in known if len(one) > 2 and len(one) < len(shown) and signatures[i : i + len(one)] == one]
        if same:
            longest = max(same, key=len)
            yield f"{path}*", f"the keys of {known[longest]}"
            i += len(longest)
            continue
        quantity, key_path = shown[i], f"{path}{shown[i].key}"
        i += 1
        parts = _signatures(quantity.of or ())
        if parts and parts in known:
            yield key_path, f"{quantity.about}; keys of {known[parts]}"
            continue
        yield key_path, quantity.about
        if quantity.of is not None:
            yield from _keys(quantity.of, f"{key_path}.", command, known, new)
            new.setdefault(parts, f"`{key_path}` in {_link(command)}")
            known.setdefault(parts, f"`{key_path}` in {_link(command)}")


if __name__ == "__main__":
    write_text(PAGE, page())
    print(PAGE)


__all__ = ["page", "report", "reports", "to_dict"]
