"""Commands of this checkout beside those of another one: a change of structure must not change their answers.

    python -m benchmarks.commands --against DIR [--only WORD ...]

Each line of `commands.txt` is one call. Both checkouts answer it with `--json`; the exit status, the keys and the words
must be the same, and a number may differ by 1e-9 of the largest number of its table, or of 1. Prints what differs and
exits with 1 if there is anything.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from .timing import ROOT

CALLS = [line.split() for line in (ROOT / "benchmarks" / "commands.txt").read_text().splitlines()]

CHANGES = ("seconds", "loading", "version", "out", "date", "machine")
"""Ends of keys whose values are not answers: times, places, and who computed."""

RENAMED = {
    "leaps": "jump",
    "untold": "undetermined",
    "way": "path",
    "way_deg": "path_deg",
    "ways_lost": "paths_lost",
    "ways_tried": "paths_tried",
}
"""Keys of older checkouts and what they are called here."""

SIGNS = ("before.index", "before.stable")
"""Of an equilibrium at a snap, whose margin is 0: the sign of a round-off."""

TOLERANCE = 1e-9


def answer(checkout: Path, call: list[str]) -> tuple[int, Any]:
    """Exit status and JSON of a call in a checkout; the words of the error where there is no JSON."""
    command = [sys.executable, "-m", "tubeopt", *call, "--json"]
    with tempfile.TemporaryDirectory() as folder:
        # Robots, studies and rigs are those of this checkout, whichever computes.
        os.symlink(ROOT / "configs", Path(folder) / "configs")
        environment = os.environ | {"PYTHONPATH": str(checkout)}
        done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    try:
        return done.returncode, json.loads(done.stdout, object_hook=renamed)
    except json.JSONDecodeError:
        return done.returncode, done.stderr.strip()


def renamed(answer: dict[str, Any]) -> dict[str, Any]:
    """An answer with the keys and words of today."""
    text = {RENAMED.get(key, key): value for key, value in answer.items()}
    return {k: v.replace("of the way", "of the path") if isinstance(v, str) else v for k, v in text.items()}


def differences(mine: Any, other: Any, place: str = "") -> Iterator[str]:
    """Where two answers differ, in words."""
    if isinstance(mine, dict) and isinstance(other, dict):
        for key in sorted(mine.keys() | other.keys()):
            where = f"{place}.{key}"
            if key.endswith(CHANGES) or where.endswith(SIGNS):
                continue
            if key not in mine or key not in other:
                yield f"{where}: only {'here' if key in mine else 'there'}"
            else:
                yield from differences(mine[key], other[key], where)
        return
    table, its = numbers(mine), numbers(other)
    if table is not None and its is not None and table.shape == its.shape:
        size = max(1.0, float(np.abs(its[np.isfinite(its)]).max(initial=0.0)))
        if not np.allclose(table, its, rtol=0, atol=TOLERANCE * size, equal_nan=True):
            off = float(np.nanmax(np.abs(table - its)))
            yield f"{place}: {off:.1e} off {size:.3g}"
    elif isinstance(mine, list) and isinstance(other, list) and len(mine) == len(other):
        for k, (one, two) in enumerate(zip(mine, other, strict=True)):
            yield from differences(one, two, f"{place}[{k}]")
    elif mine != other:
        yield f"{place}: {str(mine)[:120]!r}, there {str(other)[:120]!r}"


def numbers(value: Any) -> Any:
    """A number or a table of numbers as an array; None where it is neither."""
    try:
        table = np.array(value, dtype=float)
    except (TypeError, ValueError):
        return None
    return None if isinstance(value, (str, bool)) else table


def main() -> int:
    """Compare all calls, or those that contain all of the words."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--against", type=Path, required=True, help="the other checkout")
    parser.add_argument("--only", nargs="*", default=[], help="words of the calls to compare")
    args = parser.parse_args()
    failed = 0
    for call in CALLS:
        if not set(args.only) <= set(call):
            continue
        (status, mine), (its, other) = answer(ROOT, call), answer(args.against.resolve(), call)
        results = list(differences(mine, other))
        if status != its:
            results.insert(0, f"exit status {status}, there {its}")
        failed += bool(results)
        print(f"{'DIFFERS' if results else 'same':8}{' '.join(call)}", *results[:6], sep="\n        ", flush=True)
    print(f"{failed} of {len(CALLS)} calls differ")
    return int(failed > 0)


if __name__ == "__main__":
    raise SystemExit(main())
