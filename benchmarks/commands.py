"""Every command of two checkouts side by side: exit status, JSON and files written.

    python -m benchmarks.commands --against DIRECTORY [--only PART ...] [--tolerance 1e-9]

Both checkouts get the same files, those of this one. Numbers may differ by the tolerance, relative to the larger of the
two; times are not compared. Prints a line per difference and exits with 1 if there are any.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .timing import ROOT

COMMANDS = """
fk configs/robots/thesis_ctr.yaml --rotations-deg 0,57.3,114.6 --json --out OUT
fk configs/robots/thesis_ctr.yaml --rotations-deg 200,0,0 --translations-mm 0,0,0 --tip-force-mN=-10,0,0 --json
fk configs/robots/thesis_etr.yaml --rotations-deg 0,60,-60 --json --out OUT
fk configs/robots/example_pieces.yaml --rotations-deg 10,20,30 --json
fk configs/robots/example_three_segment_etr.yaml --json
fk configs/robots/crl_ctr.yaml --rotations-deg 0,60,120 --translations-mm=-10,-20,-10 --json
fk configs/robots/till_snapping_pair.yaml --rotations-deg 0,170 --json
fk configs/robots/nobody.yaml --json
fk configs/robots/thesis_ctr.yaml --rotations-deg 0,nan,0 --json
ik configs/robots/thesis_ctr.yaml --target-mm 20,-60,170 --json --out OUT
ik configs/robots/thesis_ctr.yaml --target-mm 0,0,900 --json
ik configs/robots/thesis_ctr.yaml --targets configs/targets/arc.csv --json
ik configs/robots/crl_ctr.yaml --target-mm 20,10,120 --json
ik configs/robots/two_tube.yaml --target-mm 20,10,100 --json
equilibria configs/robots/thesis_ctr.yaml --rotations-deg 180,0,0 --json
equilibria configs/robots/till_snapping_pair.yaml --rotations-deg 0,180 --json --out OUT
snap configs/robots/thesis_ctr.yaml --to-deg 360,0,0 --json --out OUT
snap configs/robots/till_snapping_pair.yaml --to-deg 360,0 --json
snap configs/robots/example_pieces.yaml --to-deg 360,0,0 --json
follow configs/robots/thesis_ctr.yaml configs/paths/turn_and_back.csv --json --out OUT
load-limit configs/robots/thesis_ctr.yaml --rotations-deg 200,0,0 --tip-force-mN=-10,0,0 --json
force configs/robots/thesis_ctr.yaml configs/experiments/synthetic_forces.csv --json
certify configs/robots/thesis_ctr.yaml --json --out OUT
certify configs/robots/thesis_etr.yaml --json
certify configs/robots/two_tube.yaml --box --json
certify configs/robots/example_pieces.yaml --json
stability-map configs/robots/crl_ctr.yaml --json --out OUT
plan configs/studies/plan_thesis_turn.yaml --json
plan configs/studies/plan_thesis_vessel.yaml --json
plan configs/studies/plan_thesis_helix.yaml --json
plan-arms configs/studies/plan_two_arms.yaml --json
design configs/studies/design_thesis_snap_free.yaml --json
design configs/studies/design_thesis_patterned.yaml --json
design configs/studies/design_corner.yaml --json
design configs/studies/design_stock.yaml --json
design-pair configs/studies/design_pair.yaml --json
run configs/studies/thesis_actuated.yaml --json
run configs/studies/thesis_inverse.yaml --json
run configs/studies/thesis_snap.yaml --json
run configs/studies/thesis_load_limit.yaml --json
workspace configs/robots/thesis_ctr.yaml --samples 2000 --json --out OUT
workspace configs/robots/thesis_etr.yaml --samples 500 --json
sweep configs/studies/sweep_curvature.yaml --json --out OUT
sweep configs/studies/sweep_tips.yaml --json --out OUT
validate configs/robots/thesis_etr.yaml configs/experiments/thesis_table_4_1.csv --json
validate configs/robots/thesis_etr.yaml configs/experiments/synthetic_etr.csv --json
validate configs/robots/thesis_etr.yaml configs/experiments/synthetic_etr.csv --fit curvature,rotation --json
measure configs/robots/crl_ctr.yaml --parameters curvature --count 12 --json
mold plan configs/robots/thesis_ctr.yaml --json --out OUT
mold plan configs/robots/two_tube.yaml --mold configs/molds/calcium_silicate.yaml --json
mold mandrel configs/robots/example_pieces.yaml --json
mold pegs configs/robots/thesis_ctr.yaml --json
mold calibrate configs/molds/example_trials.csv --json
mold materials configs/robots/thesis_ctr.yaml --json
heat plan configs/rigs/thesis_calcium_silicate.yaml --json --out OUT
heat plan configs/rigs/thesis_mdf.yaml --json
heat firmware configs/rigs/thesis_calcium_silicate.yaml --json --out OUT
heat calibrate configs/experiments/heating_log.csv --rig configs/rigs/thesis_calcium_silicate.yaml --json
fabricate configs/robots/thesis_ctr.yaml --rig configs/rigs/thesis_calcium_silicate.yaml --json --out OUT
robot show configs/robots/crl_ctr.yaml --json
robot show configs/robots/thesis_etr.yaml --json --out OUT
export configs/robots/thesis_ctr.yaml --c OUT --json
doctor --help
""".strip().splitlines()

TIMES = re.compile(r"seconds|_ms$|^ms|_s$|duration|versions|solved|cache|self_test|iterations|loading|statistics")
"""Keys whose values are measured, or count work, so that they differ from run to run."""

SECONDS = 600
"""After which a command is ended: every one takes less on a quiet machine."""


@dataclass(frozen=True)
class Ended:
    """How a command ended: exit status, what it printed as JSON or text, and the files that it wrote."""

    status: int
    said: Any
    files: tuple[str, ...]


def run(checkout: Path, command: str) -> Ended:
    """A command of a checkout."""
    with tempfile.TemporaryDirectory() as out:
        script = "import sys; sys.path.insert(0, sys.argv.pop(1)); from tubeopt.cli.app import main; main(sys.argv[1:])"
        words = [out if word == "OUT" else word for word in shlex.split(command)]
        environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | {"COLUMNS": "100"}
        try:
            done = subprocess.run(
                [sys.executable, "-P", "-c", script, str(checkout), *words],
                cwd=ROOT, env=environment, capture_output=True, text=True, timeout=SECONDS,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return Ended(-1, f"ended after {SECONDS} s", ())
        files = tuple(sorted(str(path.relative_to(out)) for path in Path(out).rglob("*") if path.is_file()))
        text = done.stdout.replace(out, "OUT")
        try:
            said = json.loads(text)
        except json.JSONDecodeError:
            said = text + done.stderr.replace(out, "OUT")
        return Ended(done.returncode, said, files)


def differences(there: Any, here: Any, tolerance: float, at: str = "") -> Iterator[str]:
    """What differs between two JSON values, a line each."""
    if isinstance(there, dict) and isinstance(here, dict):
        for key in sorted({*there, *here}):
            if TIMES.search(key):
                continue
            if key in there and key in here:
                yield from differences(there[key], here[key], tolerance, f"{at}.{key}")
            else:
                yield f"{at}.{key} is only in {'the other' if key in there else 'this'} checkout"
    elif isinstance(there, list) and isinstance(here, list) and len(there) == len(here):
        for k, (one, other) in enumerate(zip(there, here, strict=True)):
            yield from differences(one, other, tolerance, f"{at}[{k}]")
    elif isinstance(there, int | float) and isinstance(here, int | float) and not isinstance(there, bool):
        if not (there == here or math.isclose(there, here, rel_tol=tolerance, abs_tol=tolerance)):
            yield f"{at}: {there!r} there, {here!r} here"
    elif there != here:
        yield f"{at}: {str(there)[:300]!r} there, {str(here)[:300]!r} here"


def main() -> None:
    """Run and compare."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.commands", description=__doc__.split("\n")[0])
    parser.add_argument("--against", type=Path, required=True, metavar="DIRECTORY", help="the other checkout")
    parser.add_argument("--only", nargs="+", default=[""], metavar="PART", help="commands that contain one of these")
    parser.add_argument("--tolerance", type=float, default=1e-9, help="of numbers, relative")
    asked = parser.parse_args()
    faults = 0
    for command in COMMANDS:
        if not any(part in command for part in asked.only):
            continue
        there, here = run(asked.against.resolve(), command), run(ROOT, command)
        found = list(differences(vars(there), vars(here), asked.tolerance))
        faults += len(found)
        print(f"{'same' if not found else f'{len(found)} differences'} (status {here.status}): {command}", flush=True)
        for one in found[:12]:
            print(f"    {one}", flush=True)
    sys.exit(bool(faults))


if __name__ == "__main__":
    main()
