"""The report on every kind of answer: importing this module registers them all.

    python -m tubeopt.show.reports

writes the page of the docs that says what `--json` prints, from the lists of quantities.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from ..files.files import write_text
from . import (  # noqa: F401  (each registers its reports)
    certify_report,
    design_report,
    doctor,
    equilibrium_report,
    fabrication_report,
    heat_report,
    inverse_report,
    load_report,
    mandrel_report,
    map_report,
    measure_report,
    mold_report,
    plan_report,
    robot_report,
    snap_report,
    sweep_report,
    validation_report,
    workspace_report,
)
from .quantities import Quantity
from .report import Report, report

PAGE = "docs/json.md"

INTRODUCTION = """# What `--json` prints

Every command prints one JSON object with `--json`, and saves the same where it is given `--out`. Keys end in the unit
of their numbers. `a.b` is the key b of the object a, or of each object of the list a; a key is null where there is
nothing to say. Numbers that are not finite are null. Every object also has `files`, the paths that were written.
`tubeopt run` prints what the command of its study prints; a sweep has a column for every number of these objects.

This page is written by `python -m tubeopt.show.reports` from the lists of quantities that the answers are printed from.
"""


def to_dict(answer: object) -> Mapping[str, Any]:
    """What `--json` says about an answer of any kind: plain numbers, text, lists and mappings with units in the keys.

    Raises:
        TypeError: nothing is said about such an object.
    """
    return report(answer).record()


def reports() -> dict[str, type[Report[Any]]]:
    """Command -> the report on its answer."""
    known: Mapping[Any, Any] = report.registry
    kinds = {kind.command: kind for kind in known.values() if isinstance(kind, type) and issubclass(kind, Report)}
    return dict(sorted(kinds.items()))


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
