"""The robot of the thesis made snap-free at its home translations, with the least change of its curvatures.

Result: the inner tube loses most of its curvature (10 to 6.1 per metre), the outer tube almost none. Then no rotation
snaps, and motions need no detours.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import tubeopt
from tubeopt.design import Free, Objective, SnapFree, count_snaps
from tubeopt.show.plots.design import plot_before_after

ROOT = Path(__file__).resolve().parents[1]


def main(out: Path, samples: int = 40) -> list[Path]:
    """Design, compare with the robot of the thesis on random full turns, and save the picture into `out`."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "thesis_ctr.yaml")
    assert isinstance(robot, tubeopt.ConcentricRobot)
    task = tubeopt.DesignTask(
        robot,
        free=(Free("curvature", (0, 1, 2), 0.5, 15.0),),
        requirements=(SnapFree(0.05),),
        objective=Objective("change"),
        name="snap-free",
    )
    design = tubeopt.optimize_design(task)
    bends = ", ".join(f"{tube.curvature:.3f}" for tube in design.robot.tubes)
    print(f"curvatures {bends} per m, certificate {design.certificate:.4f}, in {design.seconds:.1f} s")
    for name, one in (("before", robot), ("after", design.robot)):
        snaps, turns = count_snaps(one, samples)
        print(f"{name}: {snaps} snaps on {turns} of {samples} random full turns forth and back")
    picture = out / "design_thesis_snap_free.png"
    charts = [
        tubeopt.stability_map(one, samples=samples, directions=3 * samples, workers=1) for one in (robot, design.robot)
    ]
    plot_before_after((charts[0], charts[1]), picture)
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    parser.add_argument("--samples", type=int, default=40, help="points per axis of the maps, and full turns")
    args = parser.parse_args()
    for path in main(args.out, args.samples):
        print(f"saved {path}")
