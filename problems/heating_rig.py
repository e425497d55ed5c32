"""A rig designed together with its schedule: the least battery energy over clamp mass, lead and groove.

Clamps, lead and gap of the rig are unknowns of a `HeatingBlock`, beside the duty and the heating time. The clamps stay
below 40 degC, and the window is kept with 5 K to spare.

Result: a wide gap to the groove and a shorter lead save a fifth of the energy. The lead heats less mold, until the ends
of the curve become too cold.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import casadi as ca

import tubeopt
from tubeopt.constants import ZERO_CELSIUS
from tubeopt.show.plots.heating import plot_heating

ROOT = Path(__file__).resolve().parents[1]
RANGES = {"clamp_mass": (1e-3, 50e-3), "lead": (5e-3, 40e-3), "gap": (50e-6, 200e-6)}
"""Smallest and largest values, kg and m."""


def main(out: Path) -> list[Path]:
    """Design the rig, plan its heating, save the picture into `out`, and return its path."""
    rig = tubeopt.load_rig(ROOT / "configs" / "rigs" / "thesis_calcium_silicate.yaml")
    opti = ca.Opti()
    parameters = {}
    for name, (low, high) in RANGES.items():
        parameters[name] = high * opti.variable()
        opti.set_initial(parameters[name], {"clamp_mass": rig.clamps.mass, "lead": rig.mold.lead}.get(name, 80e-6))
        opti.subject_to(opti.bounded(low / high, parameters[name] / high, 1.0))
    block = tubeopt.HeatingBlock(opti, rig, parameters=parameters)
    block.keep_limits(margin=5.0)
    opti.subject_to((40.0 + ZERO_CELSIUS - block.clamp_temperature) / 100 >= 0)
    opti.minimize(block.energy / 1e3)
    opti.solver("ipopt", block.solver_options(1e-6))
    best = block.rig_at(opti.solve())
    assert best.tube is not None
    plan = tubeopt.plan_heating(best.tube, best)
    picture = out / "heating_rig.png"
    plot_heating(plan, picture)
    return [picture]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the pictures")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
