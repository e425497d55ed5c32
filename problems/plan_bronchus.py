"""A motion from the trachea into the right main bronchus, planned in the labels of an image.

The image comes from formulas. It is written as NIfTI, with any orientation in the patient. Landmarks define the pose
of the robot.

Result: a label is a body like any other. Its distance is never overestimated, so a proved motion touches no voxel
outside the airway.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

import tubeopt
from tubeopt.bodies.anatomy import Anatomy
from tubeopt.bodies.frames import Frame, base_frame
from tubeopt.bodies.phantoms import bronchial_tree
from tubeopt.errors import import_extra
from tubeopt.runs.surroundings_file import load_anatomy
from tubeopt.show.plots.trajectory import plot_trajectory

ROOT = Path(__file__).resolve().parents[1]

CASE = """
anatomy:
  image: lung.nii.gz
  lumen: [1]
  target: [2]
  landmarks: {file: landmarks.csv, axes: RAS}
  base: {at: mouth of the tube, towards: carina}
"""


def written_case(directory: Path) -> Anatomy:
    """A scan, landmarks and the file that names them, written and read again."""
    nibabel = import_extra("nibabel", "anatomy", "NIfTI files")
    phantom = bronchial_tree()
    plate = base_frame([0.02, -0.11, 0.2], [0.1, 0.2, -1.0])
    image = phantom.image(7e-4, Frame(plate.axes.T, -plate.axes.T @ plate.origin))
    affine = np.eye(4)
    affine[:3, :3] = plate.axes @ image.frame.axes * image.spacing * 1e3
    affine[:3, 3] = plate.placed(image.frame.origin) * 1e3
    nibabel.save(nibabel.Nifti1Image(image.values, affine), directory / "lung.nii.gz")
    positions = {"mouth of the tube": (0.0, 0.0, 0.0), **phantom.landmarks}
    rows = ["name,x_mm,y_mm,z_mm"]
    for name, position in positions.items():
        x, y, z = plate.placed(np.array(position) * 1e-3) * 1e3
        rows.append(f"{name},{x:.4f},{y:.4f},{z:.4f}")
    (directory / "landmarks.csv").write_text("\n".join(rows))
    (directory / "case.yaml").write_text(CASE)
    return load_anatomy(directory / "case.yaml")


def main(out: Path) -> list[Path]:
    """Plan to a landmark, print the proof, save the picture into `out`, and return its path."""
    robot = tubeopt.load_robot(ROOT / "configs" / "robots" / "crl_ctr.yaml")
    with tempfile.TemporaryDirectory() as directory:
        anatomy = written_case(Path(directory))
    (lung,) = anatomy.fields
    print(f"lattice of {' x '.join(map(str, lung.values.shape))} nodes, short by {lung.error * 1e3:.2f} mm at most")
    withdrawn = (np.zeros(3), np.array([-0.033, -0.092, -0.096]))
    options = tubeopt.PlanOptions(clearance=2e-4)
    goal = tubeopt.TipGoal(anatomy.position("right main bronchus"))
    plan = tubeopt.plan_trajectory(robot, withdrawn, goal, obstacles=anatomy.bodies, options=options)
    print(f"clearance at least {plan.proof.least_clearance * 1e3:.2f} mm at all times, proved: {plan.proved}")
    picture = out / "plan_bronchus.png"
    plot_trajectory(plan, picture, title=f"{robot.name}: motion into the right main bronchus")
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
