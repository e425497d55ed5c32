"""The program as tests run it."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any, NamedTuple, Protocol

ROOT = Path(__file__).parents[1]
THESIS = str(ROOT / "configs" / "robots" / "thesis_ctr.yaml")
CRL = str(ROOT / "configs" / "robots" / "crl_ctr.yaml")
COLOUR = re.compile(r"\x1b\[[0-9;?]*[a-zA-Z]")


class Outcome(NamedTuple):
    code: int
    out: str
    err: str


class Run(Protocol):
    def __call__(self, *arguments: str) -> Outcome: ...


def answer(outcome: Outcome, code: int = 0) -> dict[str, Any]:
    """The one JSON object that a command printed that ended with `code`."""
    assert (outcome.code, outcome.err) == (code, "")
    data = json.loads(outcome.out)
    assert isinstance(data, dict)
    assert data.get("error", {}).get("exit_code", code) == code
    return data


def refused(outcome: Outcome) -> list[str]:
    """The problems that a command reports on stderr, or as JSON."""
    if outcome.out.startswith("{"):
        messages = answer(outcome, 2)["error"]["messages"]
        assert isinstance(messages, list)
        return messages
    assert (outcome.code, outcome.out) == (2, "")
    lines = outcome.err.splitlines()
    assert all(line.startswith("error: ") for line in lines)
    return [line.removeprefix("error: ") for line in lines]
