"""The picture of scores: what share of the questions was answered and kept within how many seconds.

Usage: python -m benchmarks.suite.plot SCORES.json [MORE.json ...] [--out docs/images/benchmark.png]
"""

from __future__ import annotations

import argparse
import json
from collections import defaultdict
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from .questions import KINDS
from .score import Score, group_of

ROOT = Path(__file__).resolve().parents[2]

TITLES = {"inverse": "inverse kinematics", "plan": "plans", "design": "designs"}

COLOURS = {
    "free": "#0072B2",
    "corridors": "#D55E00",
    "bronchial tree": "#009E73",
    "ventricle": "#CC79A7",
    "kidney": "#E69F00",
    "cannot snap": "#56B4E9",
}


def read_scores(path: Path) -> list[Score]:
    """Scores as `score --out` wrote them, without the questions that were not answered."""
    rows: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))
    scores = [Score(**{key: np.nan if value is None else value for key, value in row.items()}) for row in rows]
    return [one for one in scores if one.why != "no answer"]


def draw(files: list[Path], out: Path) -> None:
    """Save the picture; of several solvers each has a dash of its own."""
    figure, axes = plt.subplots(1, len(KINDS), figsize=(9.6, 3.2), layout="constrained", sharey=True)
    for dash, path in zip(("-", "--", ":", "-."), files, strict=False):
        groups: dict[str, dict[str, list[Score]]] = {kind: defaultdict(list) for kind in KINDS}
        for one in read_scores(path):
            kind, scene = group_of(one)
            groups[kind][scene].append(one)
        for panel, kind in zip(axes, KINDS, strict=True):
            for scene, colour in COLOURS.items():
                if not (some := groups[kind].get(scene, [])):
                    continue
                times = np.sort([one.seconds for one in some if one.success])
                fraction = np.arange(1, len(times) + 1) / len(some)
                panel.step(times, 100 * fraction, dash, where="post", color=colour, label=scene)
    for panel, kind in zip(axes, KINDS, strict=True):
        panel.set(xscale="log", xlabel="seconds of one processor", title=TITLES[kind], ylim=(0, 103))
        panel.set_xlim(0.004, 40)
        panel.spines[["top", "right"]].set_visible(False)
        panel.legend(frameon=False, fontsize=7, loc="lower right" if kind == "inverse" else "upper left")
    axes[0].set_ylabel("answered and kept (%)")
    figure.savefig(out, dpi=150)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scores", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images" / "benchmark.png")
    args = parser.parse_args()
    draw(args.scores, args.out)
    print(f"saved {args.out}")


if __name__ == "__main__":
    main()
