"""Two robots on one plate, designed together: both tips reach as many pairs of points of a region as possible.

The unknowns are a factor on the curvatures of each robot and the tilt of each plate. Each tip alone reaches every point
of the ball. A third of the pairs of points is out of reach, since the arms must stay 2 mm apart.

Result: two good robots are not a good pair. A search that calls the planner improves the pair in one minute. The study
is `configs/studies/design_pair.yaml`.
"""

from __future__ import annotations

import argparse
from decimal import Decimal
from pathlib import Path

from tubeopt.runs.design_study import PairStudy
from tubeopt.runs.study_file import load_study
from tubeopt.show.plots.design import plot_pair_fractions, plot_pair_places

ROOT = Path(__file__).resolve().parents[1]


def main(out: Path, samples: int = 60) -> list[Path]:
    """Search for this number of seconds, verify, print, save two pictures into `out`, and return their paths."""
    study = load_study(ROOT / "configs" / "studies" / "design_pair.yaml")
    assert isinstance(study, PairStudy)
    answer = study.model_copy(update={"seconds": Decimal(samples)}).run()
    print(f"{answer.search.tried} pairs of robots tried in {samples} s")
    for name, one in (("two CRL robots side by side", answer.before), ("sized and placed together", answer.after)):
        alone = ", ".join(f"{100 * each.fraction:.0f} %" for each in one.reached)
        print(
            f"{name}: alone they reach {alone} of the points, "
            f"together {100 * one.fraction:.0f} % of the pairs of points"
        )
    print(f"motions of both arms to such pairs that are proved: {answer.proved} of {answer.planned}")
    fractions, names = (answer.before, answer.after), answer.names
    targets = answer.plates[0].placed(answer.after.reached[0].targets)
    paths = [out / "design_pair.png", out / "design_pair_places.png"]
    plot_pair_fractions(fractions, paths[0], names=names)
    plot_pair_places(fractions, paths[1], names=names, places=targets)
    return paths


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
