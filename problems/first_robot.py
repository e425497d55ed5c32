"""The robot of six lines in the README: its shape with rotated tubes.

Result: six lines define a robot; all other keys have defaults.
"""

from __future__ import annotations

import argparse
import re
from pathlib import Path

import numpy as np

import tubeopt

ROOT = Path(__file__).resolve().parents[1]


def main(out: Path) -> list[Path]:
    """Read the robot from the README, solve it, save the picture into `out`, and return its path."""
    (text,) = re.findall(r"```yaml\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    file = out / "robot.yaml"
    file.write_text(text, encoding="utf-8")
    pose = tubeopt.load_robot(file).fk(np.radians([0, 45, 90]))
    file.unlink()
    picture = out / "first_robot.png"
    tubeopt.plot_shape(pose, picture)
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the picture")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
