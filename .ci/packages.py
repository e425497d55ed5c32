"""Draws the packages of tubeopt, floor by floor, into docs/images/packages.svg: python .ci/packages.py

The floors are the layers of the contract in pyproject.toml that `lint-imports` enforces.
"""

from __future__ import annotations

import re
import tomllib
from html import escape
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PICTURE = ROOT / "docs" / "images" / "packages.svg"

ROLES = {
    "cli": "commands",
    "plot": "all pictures, by name",
    "show": "tables, JSON, pictures, viewer",
    "runs": "study files, sweeps",
    "control": "servo, server, C library",
    "design": "tube dimensions",
    "planning": "trajectories, proofs",
    "shaping": "molds, heating",
    "validation": "measurements, calibration",
    "workspaces": "reachable tips",
    "gym": "environments for learning",
    "inverse": "inverse kinematics",
    "stability": "snaps, branches, certificates",
    "equilibrium": "forward kinematics",
    "solvers": "Newton, IPOPT, kernels",
    "block": "equilibrium in a program",
    "bodies": "obstacles, anatomy",
    "robots": "tubes, robots, loads",
    "files": "YAML, CSV, units",
    "physics": "torsion, energy, shape, heat",
    "arguments": "checks of arguments",
    "constants": "physical constants",
    "display": "text form of objects",
    "errors": "messages",
    "typing": "types",
}
"""Package or module -> what it does."""

WIDTH, HEIGHT, GAP, MARGIN = 148, 46, 10, 16
"""Width and height of a box, distance between boxes, and margin around all, px."""

ARROW = 60
"""Width of the column with the arrow, px."""


def floors() -> list[list[str]]:
    """Names of the packages of every floor, from the top."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
        "contracts"
    ]
    (layers,) = (contract["layers"] for contract in contracts if contract["type"] == "layers")
    return [re.findall(r"\w+", floor) for floor in layers]


def picture() -> str:
    """The text of the picture, as SVG."""
    rows = floors()
    across = max(map(len, rows)) * (WIDTH + GAP) - GAP
    size = across + 2 * MARGIN + ARROW, len(rows) * (HEIGHT + 2 * GAP) + 2 * MARGIN
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {size[0]} {size[1]}" font-family="sans-serif">',
        "<title>Packages of tubeopt: each imports only those below it</title>",
        f'<rect width="{size[0]}" height="{size[1]}" fill="#ffffff"/>',
    ]
    for k, names in enumerate(rows):
        top = MARGIN + k * (HEIGHT + 2 * GAP) + GAP
        left = MARGIN + ARROW + (across - len(names) * (WIDTH + GAP) + GAP) / 2
        for i, name in enumerate(names):
            lines += _box(left + i * (WIDTH + GAP), top, name)
    side, bottom = MARGIN + 20, size[1] - MARGIN - GAP
    lines += [
        f'<text x="{MARGIN}" y="{MARGIN + 2 * GAP}" font-size="12" fill="#37474f">imports</text>',
        f'<path d="M{side} {MARGIN + 3 * GAP}V{bottom}m-5 -8l5 8l5 -8" fill="none" stroke="#37474f"/>',
        "</svg>",
    ]
    return "\n".join([*lines, ""])


def _box(x: float, y: float, name: str) -> list[str]:
    middle, role = x + WIDTH / 2, ROLES[name]
    box = f'<rect x="{x:g}" y="{y:g}" width="{WIDTH}" height="{HEIGHT}" rx="6" fill="#eef2f6" stroke="#546e7a"/>'
    title = f'<text x="{middle:g}" y="{y + 19:g}" text-anchor="middle" font-size="14" fill="#000000">{name}</text>'
    text = (
        f'<text x="{middle:g}" y="{y + 36:g}" text-anchor="middle" font-size="9" fill="#37474f">{escape(role)}</text>'
    )
    return [box, title, text]


if __name__ == "__main__":
    PICTURE.write_text(picture(), encoding="utf-8")
    print(PICTURE.relative_to(ROOT))
