"""Figure 2.10 of the thesis: workspace of its concentric robot from 1,000 random configurations, and snapping losses.

The figure in the thesis shows arms at random joint values, with any equilibrium that its solver finds. Here every arm
is stable. The second picture shows the tips of unstable arms, and the region that only those reach.

Result: arms at random joint values must be checked for stability. An unstable equilibrium solves the equations but
never occurs.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import tubeopt
from tubeopt.show.plots.eccentric import arm_curve, plot_reach
from tubeopt.show.plots.workspace import plot_workspace
from tubeopt.workspaces import meridian_volume

ROOT = Path(__file__).resolve().parents[1]
SAMPLES = 1000
TIPS = 100
"""Tips of the second picture for every arm of the first."""

VOXEL = 10e-3
"""Edge of its voxels, m."""


def main(out: Path, samples: int = SAMPLES) -> list[Path]:
    """Solve all configurations, save the two pictures into `out`, and return their paths."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "thesis_ctr.yaml")
    drawn = tubeopt.workspace(robot, samples, method="random", seed=210)
    arms = [tubeopt.forward_kinematics(robot, *row) for row in zip(drawn.rotations, drawn.translations, strict=True)]
    print(f"{samples} configurations, all stable; least margin {drawn.margin.min():.3f}")
    shapes = out / "thesis_ctr_workspace.png"
    title = f"{robot.name}: arms and tips at {samples:,} random rotations and translations"
    plot_reach([arm_curve(arm, arm.margin) for arm in arms], shapes, title=title, label="stability margin", opacity=0.2)
    space = tubeopt.workspace(robot, TIPS * samples)
    loss = tubeopt.snapping_loss(robot, TIPS * samples, size=VOXEL, reached=space)
    volume = meridian_volume(space)
    print(
        f"{1e6 * volume.value:,.0f} cm3 as a body of revolution; "
        f"{100 * loss.unstable / loss.equilibria:.1f} % of all equilibria are unstable, "
        f"{1e6 * loss.lost_volume:.0f} cm3 are reached by no other"
    )
    tips = out / "thesis_ctr_workspace_tips.png"
    plot_workspace(space, tips, loss=loss, size=VOXEL)
    return [shapes, tips]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the pictures")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
