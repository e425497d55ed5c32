"""Campaigns: one run for each seed, kept in a file as it ends."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

from tubeopt import InputError, SolveError

R = TypeVar("R")


def add_campaign(parser: argparse.ArgumentParser, runs: int) -> None:
    """Add the options of a campaign with a default number of runs."""
    parser.add_argument("--runs", type=int, default=runs, help="truths")
    parser.add_argument("--first", type=int, default=0, help="seed of the first")
    parser.add_argument("--jsonl", type=Path, help="file that keeps every run as it ends; kept runs are not repeated")


def campaign(options: argparse.Namespace, run: Callable[[int], R], read: Callable[[dict[str, Any]], R]) -> list[R]:
    """Runs of the seeds that a file does not have, and those that it has.

    `run` returns a dataclass with the field `seed`; `read` builds one from its record. A run without an answer is
    left out, with its reason on stderr.
    """
    path: Path | None = options.jsonl
    lines = path.read_text().splitlines() if path is not None and path.exists() else []
    kept = {record["seed"]: read(record) for record in map(json.loads, lines)}
    for seed in range(options.first, options.first + options.runs):
        if seed in kept:
            continue
        try:
            kept[seed] = run(seed)
        except (InputError, SolveError) as error:
            print(f"truth {seed}: {error}", file=sys.stderr)
            continue
        if path is not None:
            with path.open("a") as file:
                file.write(json.dumps(asdict(kept[seed])) + "\n")  # type: ignore[call-overload]
    return list(kept.values())
