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
from .report import PICTURE_FORMATS, SOLID_FORMATS, TABLE_FORMATS, Report
from .report import report as registered

MODULES = {
    "arms_report": ("ArmsPlan",),
    "certify_report": ("Certification",),
    "design_report": ("DesignAnswer",),
    "doctor": ("Doctor",),
    "equilibrium_report": ("Equilibrium",),
    "export_report": ("CLibrary",),
    "fabrication_report": ("Fabrication",),
    "firmware_report": ("LedHeating",),
    "heat_report": ("Heating", "RigFit", "TrialFit"),
    "inverse_report": ("Postures", "TargetTable"),
    "load_report": ("Bearing", "ForceRecord"),
    "mandrel_report": ("Mandrel",),
    "pair_report": ("PairAnswer",),
    "peg_report": ("PegBoard",),
    "measure_report": ("Placement",),
    "mold_report": ("RobotMold", "Calibration", "Ranking"),
    "plan_report": ("Trajectory", "Checked"),
    "rig_page": ("HeatingRun",),
    "robot_report": ("ConcentricRobot", "EccentricRobot", "SegmentedEccentricRobot"),
    "served_report": ("Viewed", "Served"),
    "shipped_report": ("ShippedFiles",),
    "snap_report": ("Equilibria", "Way", "Path", "RobotMap"),
    "sweep_report": ("Sweep",),
    "validation_report": ("Comparison", "Validation", "Fit"),
    "written_report": ("Written",),
    "workspace_report": ("Findings",),
}
"""Modules with reports -> the classes of their answers: each is imported when there is such an answer."""

PAGE = "docs/json.md"

INTRODUCTION = """# What `--json` prints

Every command prints one JSON object with `--json`, and saves the same where it is given `--out`. Keys end in the unit
of their numbers. `a.b` is the key b of the object a, or of each object of the list a; a key is null where there is
nothing to say. Numbers that are not finite are null. Every object also has `files`, the paths that were written, and
`warnings`, sentences that are shown on stderr without `--json`. What fails has `error`: its `kind` (`input`, `usage`,
`no_solution`, `not_proved` or `interrupted`), its `exit_code` (2, 2, 3, 4 or 130), and `messages`; beside the answer
where there is one, else alone with `warnings`.
`tubeopt run` prints what the command of its study prints; a sweep has a column for every number of these objects.

This page is written by `python -m tubeopt.show.reports` from the lists of quantities that the answers are printed from.
"""


def report(answer: object) -> Report[Any]:
    """The report on an answer of any kind.

    Raises:
        TypeError: nothing is said about such an object.
    """
    names = {kind.__name__ for kind in type(answer).__mro__}
    for module, known in MODULES.items():
        if names & set(known):
            importlib.import_module(f".{module}", __package__)
    return registered(answer)


def to_dict(answer: object) -> Mapping[str, Any]:
    """What `--json` says about an answer of any kind: plain numbers, text, lists and mappings with units in the keys.

    Raises:
        TypeError: nothing is said about such an object.
    """
    return report(answer).record()


def reports() -> dict[str, type[Report[Any]]]:
    """Command -> the report on its answer."""
    for module in MODULES:
        importlib.import_module(f".{module}", __package__)
    known: Mapping[Any, Any] = registered.registry
    kinds = {kind.command: kind for kind in known.values() if isinstance(kind, type) and issubclass(kind, Report)}
    return dict(sorted(kinds.items()))


def formats_of(command: str) -> tuple[str, ...]:
    """Formats in which the answer of a command can be saved besides JSON and CSV, with any of its flags."""
    named = f'command = "{command}'
    for module in MODULES:  # those alone that say so: all of them take seconds
        if named in (Path(__file__).parent / f"{module}.py").read_text(encoding="utf-8"):
            importlib.import_module(f".{module}", __package__)
    known: Any = registered.registry.values()
    kinds = [kind for kind in known if getattr(kind, "command", "").partition(" --")[0] == command]

    def has(name: str) -> bool:
        return any(getattr(kind, name) is not getattr(Report, name) for kind in kinds)

    pictures = PICTURE_FORMATS if has("pictures") or any(kind.drawn for kind in kinds) else ()
    return (*pictures, *(TABLE_FORMATS if has("tables") else ()), *(SOLID_FORMATS if has("solids") else ()))


def page() -> str:
    """The page of the docs about `--json`, as Markdown."""
    lines = [INTRODUCTION]
    for command, kind in reports().items():
        lines += [f"## `tubeopt {command}`", "", "| key | unit | |", "|---|---|---|"]
        lines += [f"| `{path}` | {unit} | {about} |" for path, unit, about in _keys(kind.quantities, "")]
        lines.append("")
    return "\n".join(lines)


def _keys(quantities: Sequence[Quantity[Any]], path: str) -> Iterator[tuple[str, str, str]]:
    """Path, unit and meaning of every key; a part that a command of its own prints is not told again."""
    elsewhere = {id(kind.quantities): command for command, kind in reports().items()}
    for quantity in quantities:
        if not quantity.key:
            continue
        here = f"{path}{quantity.key}"
        same = elsewhere.get(id(quantity.of))
        yield here, quantity.sign, quantity.about + (f", as `tubeopt {same}` prints it" if same else "")
        if quantity.of is not None and not same:
            yield from _keys(quantity.of, f"{here}.")


if __name__ == "__main__":
    write_text(PAGE, page())
    print(PAGE)


__all__ = ["page", "report", "reports", "to_dict"]
