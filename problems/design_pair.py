"""Two robots on one plate sized together: their tips shall hold any two places of a region at once without touching.

Free are a factor on the curvatures of each robot, and how each plate leans. Each tip reaches every place of the ball by
itself; that the arms come closer than 2 mm keeps the pair from a third of the pairs of places.

One learns: a pair is not good because both of its robots are. What is left to gain lies between the arms, and a search
with a planner in the loop finds some of it in a minute. The question is `configs/studies/design_pair.yaml`.
"""

from __future__ import annotations

import argparse
from decimal import Decimal
from pathlib import Path

from tubeopt.runs.design_study import PairStudy
from tubeopt.runs.study_file import load_study
from tubeopt.show.plots.design import plot_pair_shares

ROOT = Path(__file__).resolve().parents[1]


def main(out: Path, samples: int = 60) -> list[Path]:
    """Search for so many seconds on the clock, judge, print, save the picture into `out`, and return its path."""
    study = load_study(ROOT / "configs" / "studies" / "design_pair.yaml")
    assert isinstance(study, PairStudy)
    answer = study.model_copy(update={"seconds": Decimal(samples)}).run()
    print(f"{answer.search.tried} pairs of robots tried in {samples} s")
    for name, one in (("two CRL robots side by side", answer.before), ("sized and placed together", answer.after)):
        alone = ", ".join(f"{100 * each.share:.0f} %" for each in one.reached)
        print(
            f"{name}: alone they reach {alone} of the places, together {100 * one.share:.0f} % of the pairs of places"
        )
    print(f"motions of both arms to such pairs that are proved: {answer.proved} of {answer.planned}")
    path = out / "design_pair.png"
    plot_pair_shares((answer.before, answer.after), path, names=answer.names)
    return [path]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
