"""Vents of the lid from a thermal camera, as section 4.2.3 of the thesis proposes, on a simulated rig.

The rig loses 15 % more heat than its file states. A camera with noise measures ten points of the curved part while a
tube is heated. The log calibrates the rig. Vents that equalise the temperature are planned on the calibrated rig. The
schedule then runs on the true rig, with the old lid and with the new one.

Result: the middle is the hottest part. Vents there halve the temperature difference along the curved part.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

import tubeopt
from tubeopt import HeatingSpec
from tubeopt.constants import ZERO_CELSIUS
from tubeopt.shaping.heating.calibration import FACTORS, HeatingLog, calibrate
from tubeopt.shaping.heating.simulation import simulate
from tubeopt.shaping.heating.thermal import FINE, thermal_model
from tubeopt.show.page import tube_colour
from tubeopt.show.plots.style import finish, new_figure

ROOT = Path(__file__).resolve().parents[1]
PLACES = np.linspace(-0.045, 0.045, 10)
TIME = np.arange(0.0, 80.0, 2.0)
DUTY = np.interp(TIME, [0, 30, 34, 80], [3, 17, 11, 9]).round()


def main(out: Path) -> list[Path]:
    """Calibrate, plan with and without free vents, save the picture into `out`, and return its path."""
    rig = tubeopt.load_rig(ROOT / "configs" / "rigs" / "thesis_calcium_silicate.yaml")
    assert rig.tube is not None
    true = FACTORS["loss"](rig, 1.15)
    fit = calibrate(rig.tube, rig, camera_log(rig.tube, true), ["loss", "gap", "resistivity"])
    print(", ".join(f"{e.name} {e.factor:.3f} ({e.low:.3f} to {e.high:.3f})" for e in fit.estimates))
    figure = new_figure(6.4, 3.2)
    axes = figure.subplots()
    lids = (((), "lid without vents"), (("vents",), "lid with vents from the camera"))
    for k, (free, name) in enumerate(lids):
        spec = HeatingSpec(hold_time=15, objective="margin", free=free)
        plan = tubeopt.plan_heating(rig.tube, fit.rig, spec)
        lid = replace(true, mold=replace(true.mold, vents=plan.rig.mold.vents))
        model = thermal_model(rig.tube, lid, FINE)
        tube = simulate(model, spec.slot, plan.duty[:-1] / 255).tube[:, 0] - ZERO_CELSIUS
        held = tube[plan.in_hold][:, model.curved]
        print(f"{name}: {held.min():.1f} to {held.max():.1f} degC in the hold, on the true rig")
        end = tube[np.flatnonzero(plan.in_hold)[-1]]
        axes.plot(
            (model.half_length - model.position) * 1e3, end, color=tube_colour(k), label=f"{name}: {np.ptp(held):.1f} K"
        )
    axes.set_xlim(0, 60)
    axes.set_ylim(490, 535)
    axes.axvspan(0, 500 * rig.tube.curved_length, color="#009E73", alpha=0.12, lw=0)
    axes.set_xlabel("from the middle of the curved part, which is shaded (mm)")
    axes.set_ylabel("as the hold ends (°C)")
    axes.legend(loc="lower left")
    picture = out / "heating_camera.png"
    finish(figure, picture)
    return [picture]


def camera_log(tube: tubeopt.Tube, rig: tubeopt.Rig) -> HeatingLog:
    """Log of the board and the camera of a heating on this rig."""
    model, random = thermal_model(tube, rig, FINE), np.random.default_rng(2)
    history = simulate(model, 2.0, np.append(DUTY[:-1] / 255, 0.0))
    current = history.current[: len(TIME), 0] + random.normal(0, 0.2, len(TIME))
    rows = history.tube[: len(TIME), 0]
    seen = np.column_stack(
        [[np.interp(model.half_length - abs(x), model.position, row) for row in rows] for x in PLACES]
    )
    noisy = seen + random.normal(0, 1.5, seen.shape)
    return HeatingLog(TIME, DUTY, current=current).with_camera(TIME, PLACES, noisy)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images", help="directory for the pictures")
    for path in main(parser.parse_args().out):
        print(f"saved {path}")
