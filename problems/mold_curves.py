"""Molds for tubes of any shape: an S and a bend of varying curvature in one plate, a helix on a mandrel.

Result: a planar curve is milled into a plate as a chain of tangent arcs, within a micrometre of the curve that springs
back to the tube. A helix is wound on a cylinder; its radius and pitch are smaller than those of the tube.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import tubeopt
from tubeopt import MoldSpec, Piece, Tube
from tubeopt.shaping import Springback, plan_mandrel, predict_wound_tube
from tubeopt.show.plots.mold import plot_mandrel, plot_mold

ROOT = Path(__file__).resolve().parents[1]

SPEC = MoldSpec(springback=Springback(0.08, shrinkage=0.005))


def main(out: Path) -> list[Path]:
    """Plan both, save the pictures into `out`, and return their paths."""
    sizes = 1.6e-3, 1.2e-3
    s_shape = Tube.of_pieces(*sizes, [Piece(50e-3, 18.0), Piece(70e-3, -14.0)], straight_length=30e-3)
    varying = Tube.of_pieces(*sizes, [Piece(0.1, lambda s: 25 * math.sin(60 * s) + 4)], straight_length=10e-3)
    helix = Tube.of_pieces(*sizes, [Piece.helix(0.16, 14e-3, 24e-3)])
    mold = tubeopt.plan_mold([s_shape, varying], SPEC)
    for groove in mold.grooves:
        print(
            f"tube {groove.number}: {len(groove.centreline.bend)} arcs over {groove.bend_length * 1e3:.2f} mm, least "
            f"radius {groove.radius * 1e3:.2f} mm, turns by {math.degrees(groove.bend_angle):.1f} deg"
        )
    mandrel = plan_mandrel(helix, SPEC, number=3)
    print(f"mandrel: {mandrel.body}")
    print(f"comes off with largest curvature {predict_wound_tube(mandrel).curvature:.3f} per m")
    pictures = [out / "mold_curves.png", out / "mold_mandrel.png"]
    plot_mold(mold, pictures[0])
    plot_mandrel(mandrel, pictures[1])
    return pictures


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the pictures")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
