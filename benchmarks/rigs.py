"""How many uncertain rigs keep the window: by the package's own model, and by a model of its own.

    python -m benchmarks.rigs [--tubes ROBOT:N ...] [--volts V] [--rigs N] [--seed N] [--objectives NAME ...]
                              [--sensors NAME ...] [--json]

Plan, gains and limits are those that the package makes for the rig of a file. They are then used on rigs that differ
from it in everything that a workshop has not measured, drawn from ranges as wide as the tables of materials and data
sheets (`RANGES`), with a thermometer whose error is not symmetric: heat that flows along its wires, wire class, cold
junction and converter. Rig, wire, sensor and board are those of `rig_thermal` and `rig_loop`, which share no code with
the package's. Tubes of shipped robots are heated on the rig with the mold and clamps that `tubeopt fabricate` plans for
them. At last the switch of every shipped rig is shorted in five states.
"""

from __future__ import annotations

import argparse
import copy
import json
import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tubeopt import (
    HeatingPlan,
    HeatingSpec,
    Rig,
    Thermocouple,
    Tube,
    design_feedback,
    load_rig,
    load_robot,
    plan_heating,
)
from tubeopt.shaping.firmware.boards import Wiring, with_pulses
from tubeopt.shaping.firmware.sketch_files import schedules
from tubeopt.shaping.heating.controller import wilson
from tubeopt.shaping.heating.cutout import cut_out
from tubeopt.shaping.heating.sensors import Sensor, equipped, sensor_for
from tubeopt.shaping.tube_fabrication import plan_tube
from tubeopt.typing import Array

from .rig_loop import TICKS, Feeler, Led, led
from .rig_thermal import HOT, KELVIN, Bench, Fleet, air, wire_loss
from .timing import ROOT, show, table

RANGES = {
    # Parts of the ranges of `BOARDS`, from the least to the greatest, each by itself.
    "density": (0.0, 1.0),
    "conductivity": (0.0, 1.0),
    # Relative change of a board's conductivity per K beside that of its table: from a dense crystalline one to a light
    # one with wide pores, in which radiation grows (0.055, 0.074, 0.098 W/(m K) at 25, 200, 400 degC).
    "slope": (-3e-4, 15e-4),
    "board_heat": (0.85, 1.15),
    "gap": (0.5, 1.5),
    "losses": (0.85, 1.15),
    # Nitinol: suppliers give 0.82 to 1.0 micro-ohm m; slope, emissivity and heat capacity are assumptions.
    "resistivity": (0.90, 1.22),
    "resistivity_slope": (0.6, 1.4),
    "heat_capacity": (0.92, 1.08),
    "metal_conductivity": (0.9, 1.1),
    "emissivity": (0.3, 0.8),
    "bore": (-20e-6, 20e-6),
    "contact": (0.6, 1.4),
    "clamps": (0.5, 2.0),
    "ambient": (-8.0, 8.0),
    "charge": (0.65, 1.0),
    "internal": (0.7, 1.5),
    "lost": (0.0, 10e-6),
    # Thermometer: time constant in s; conductivity of the cement, W/(m K); wire, junction and converter, each +-1.
    "lag": (0.15, 0.5),
    "cement": (1 / 3, 3.0),
    "wire": (-1.0, 1.0),
    "junction": (-1.0, 1.0),
    "converter": (-1.0, 1.0),
}
"""What may differ; factors where a number has no unit."""

STATED = 200
"""Largest number of rigs on which the package tells its probability."""

OWN = "own"
"""Name of the tube in the rig's file."""

SHIPPED = ("thesis_calcium_silicate", "thesis_mdf", "thesis_steel")
"""Files in configs/rigs."""

BOARDS = {
    "calcium_silicate": {"density": (450.0, 1200.0), "conductivity": (0.08, 0.29)},
    "mdf": {"conductivity": (0.15, 0.19)},
}
"""Range of boards in the table of molds; what is not here is as in the file."""

GEOMETRIC = ("gap", "clamps", "cement")
"""What is drawn by its logarithm."""


def drawn(tube: Tube, rig: Rig, count: int, seed: int) -> Iterator[tuple[Tube, Rig, dict[str, float]]]:
    """Rigs that a file may stand for, and what was drawn for each."""
    rng = np.random.default_rng(seed)
    assert tube.material.thermal is not None
    own, data, board = Bench(tube, rig), tube.material.thermal, rig.mold.material
    # The gap that conducts as the groove's air does in `rig_thermal`.
    gap = own._gap_resistance() * air(rig.ambient + HOT / 2)[1] * math.pi * tube.outer_diameter
    spans = BOARDS.get(board.name, {})
    for _ in range(count):
        d = {}
        for name, (low, high) in RANGES.items():
            part = rng.uniform()
            d[name] = low * (high / low) ** part if name in GEOMETRIC else low + (high - low) * part
        thermal = replace(
            data,
            heat_capacity=data.heat_capacity * d["heat_capacity"],
            conductivity=data.conductivity * d["metal_conductivity"],
            resistivity_slope=data.resistivity_slope * d["resistivity_slope"],
            emissivity=d["emissivity"],
        )
        material = replace(
            board,
            **{name: low * (high / low) ** d[name] for name, (low, high) in spans.items()},
            heat_capacity=board.heat_capacity * d["board_heat"],
            conductivity_range=None,
            density_range=None,
            conductivity_slope=d["slope"],
            conductivity_slope_range=None,
        )
        circuit = replace(
            rig.circuit,
            contact_resistance=rig.circuit.contact_resistance * d["contact"],
            lost_on_time=rig.circuit.lost_on_time + d["lost"],
        )
        battery = replace(
            rig.battery,
            state_of_charge=rig.battery.state_of_charge * d["charge"],
            internal_resistance=rig.battery.internal_resistance * d["internal"],
        )
        inner = tube.inner_diameter + d["bore"] if tube.inner_diameter else 0.0
        yield (
            replace(tube, inner_diameter=inner, material=replace(tube.material, thermal=thermal)),
            replace(
                rig,
                circuit=circuit,
                battery=battery,
                clamps=replace(rig.clamps, contact_conductance=rig.clamps.contact_conductance * d["clamps"]),
                mold=replace(rig.mold, material=material, gap=gap * d["gap"]),
                ambient=rig.ambient + d["ambient"],
                loss_factor=rig.loss_factor * d["losses"],
                resistivity_factor=rig.resistivity_factor * d["resistivity"],
            ),
            d,
        )


def reading_error(sensor: Sensor, rig: Rig, d: dict[str, float], hot: float) -> float:
    """Error of the corrected reading at `hot` degC, K."""
    if not isinstance(sensor, Thermocouple):
        return sensor.bias * d["wire"]
    stem = (hot + KELVIN - rig.ambient) * wire_loss(sensor.wire, sensor.anchor, d["cement"])[0]
    # Class 1 of IEC 60584: 0.4 %; cold junction and converter 2 K each (data sheet of the MAX31855).
    return 0.004 * hot * d["wire"] + 2 * d["junction"] + 2 * d["converter"] - stem + sensor.correction


@dataclass(frozen=True)
class Kept:
    """Rigs led by a sensor: length of bare tube beside a clamp, m; what the package says against the plan; share in the
    window by the package's model (and of its schedule alone) and here, with a 95 % interval; the hottest point of any
    here, degC; what boards said of those that missed; how many said nothing.
    """

    tube: str
    objective: str
    sensor: str
    bare: float
    refused: str
    stated: float
    alone: float
    share: float
    interval: tuple[float, float]
    hottest: float
    reasons: dict[str, int]
    silent: int


def heated(tube: str, rig: Rig) -> Tube:
    """Tube of a robot, or the rig's own."""
    if tube == OWN:
        assert rig.tube is not None
        return rig.tube
    robot, number = tube.rsplit(":", 1)
    return load_robot(robot).tubes[int(number) - 1]


def planned(tube: str, objective: str, rig: Rig) -> tuple[HeatingPlan, str]:
    """Plan of the rig's own tube, or of a robot's with the mold as drawn; and why mold and heating do not fit."""
    spec = HeatingSpec(objective=objective)
    chosen = heated(tube, rig)
    pulsed = with_pulses(rig, chosen, Wiring())
    if tube == OWN:
        return plan_heating(chosen, pulsed, spec), ""
    made = plan_tube(chosen, pulsed, None, spec, number=int(tube.rsplit(":", 1)[1]))
    return made.heating, made.disagreement


def loaded(file: str, volts: float | None) -> Rig:
    """Rig of a file, with a battery of as many V at rest if they are given."""
    rig = load_rig(ROOT / "configs" / "rigs" / f"{file}.yaml")
    factor = 1.0 if volts is None else volts / rig.battery.voltage
    curve = tuple((charge, factor * volt) for charge, volt in rig.battery.open_circuit)
    return replace(rig, battery=replace(rig.battery, open_circuit=curve))


def measure(tube: str, objective: str, name: str, rigs: int, seed: int, rig: Rig) -> Kept:
    """Plan, design and use on drawn rigs; name: of the sensor."""
    sensor = sensor_for(name, heated(tube, rig), rig)
    plan, disagreement = planned(tube, objective, equipped(rig, sensor))
    feedback = design_feedback(plan, sensor, samples=min(rigs, STATED), seed=seed)
    members = list(drawn(plan.tube, plan.rig, rigs, seed))
    fleet = Fleet([Bench(*member[:2]) for member in members])
    hot = float(feedback.law.reference.max())
    bias = np.array([reading_error(sensor, m[1], m[2], hot) for m in members])
    lag = np.array([sensor.lag / Thermocouple().lag * m[2]["lag"] for m in members])
    found = led(fleet, feedback.law, Feeler(sensor, fleet, bias, hot, lag, seed), schedules(plan, feedback))
    kept = in_window(plan, found)
    verdict = () if plan.feasible else (plan.verdict,)
    return Kept(
        tube=tube,
        objective=objective,
        sensor=sensor.name,
        bare=plan.rig.clamps.clearance,
        refused="; ".join(filter(None, (*verdict, disagreement, *feedback.problems))),
        stated=feedback.probability,
        alone=feedback.open_loop,
        share=float(kept.mean()),
        interval=wilson(int(kept.sum()), rigs),
        hottest=float(found.top.max()),
        reasons=dict(Counter(found.reason[~kept].tolist())),
        silent=int((found.done & ~kept).sum()),
    )


def in_window(plan: HeatingPlan, found: Led) -> NDArray[np.bool_]:
    """(B,) whether the curved part was in the window for the whole hold, and all of the tube below the limit."""
    low, high = plan.spec.window_degC
    inside = (found.low >= low) & (found.high <= high) & (found.top <= plan.spec.limit)
    return np.asarray(found.done & inside)


@dataclass(frozen=True)
class Shorted:
    """Peak after the switch of a rig has shorted in a state, degC: here, and in the package's table."""

    rig: str
    state: str
    before: float
    peak: float
    stated: float


def shorted(file: str, count: int, seed: int) -> list[Shorted]:
    """The rig of a file in five states, and the hottest of many drawn ones at the stop limit.

    From the short on the whole current flows until monostable (1.5 periods and a fifth) and cut-out have opened.
    """
    rig = load_rig(ROOT / "configs" / "rigs" / f"{file}.yaml")
    assert rig.tube is not None
    rig = with_pulses(rig, rig.tube, Wiring())
    plan = plan_heating(rig.tube, rig, HeatingSpec(), cures=False)
    delay = 1.8 / rig.circuit.pwm_frequency + rig.circuit.cutout_opening
    stated = {short.state: short for short in cut_out(plan).shorts}
    drawn_rigs = list(drawn(rig.tube, rig, count, seed))
    alone, many = Fleet([Bench(rig.tube, rig)]), Fleet([Bench(*member[:2]) for member in drawn_rigs])
    slot = plan.spec.slot
    due = {round((stated[name].time or 0.0) / slot): name for name in stated if name != "at the stop limit"}
    found = []

    def peak(fleet: Fleet) -> Array:
        steps = math.ceil(delay / 1e-3)
        for _ in range(steps):
            fleet.pass_time(np.full(len(fleet.ambient), 255.0), delay / steps)
        return np.asarray(fleet.tube.max(1))

    for k in range(max(due) + 1):
        if k in due:
            tried = copy.deepcopy(alone)
            before = float(tried.tube.max())
            found.append(Shorted(file, due[k], before, float(peak(tried)[0]), stated[due[k]].peak))
        for _ in range(TICKS):
            alone.pass_time(plan.duty[k : k + 1].astype(float), slot / TICKS)
    name = "at the stop limit"
    stop = stated[name].before
    for fleet, text in ((alone, name), (many, f"{name}, {count} rigs")):
        fleet.T[:] = alone.T
        fleet.T[:, 0] += stop - alone.tube.max()
        found.append(Shorted(file, text, stop, float(peak(fleet).max()), stated[name].peak))
    return found


def main() -> None:
    """Measure and tell."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rigs", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--objectives", nargs="*", default=["margin", "time"], help="of the schedule")
    parser.add_argument("--sensors", nargs="*", default=["thermocouple"])
    parser.add_argument("--tubes", nargs="*", default=[OWN], help=f"{OWN} (of the rig's file), or such as thesis_ctr:1")
    parser.add_argument("--shorts", nargs="*", default=SHIPPED, help="rigs whose switch is shorted")
    parser.add_argument("--rig", default="thesis_calcium_silicate", help="name of a file in configs/rigs")
    parser.add_argument("--volts", type=float, help="of the battery at rest, in place of those of the file")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    results = [
        measure(tube, objective, name, options.rigs, options.seed, loaded(options.rig, options.volts))
        for tube in options.tubes
        for objective in options.objectives
        for name in options.sensors
    ]
    shorts = [short for file in options.shorts for short in shorted(file, options.rigs, options.seed)]
    if options.json:
        print(json.dumps([*map(asdict, results), *map(asdict, shorts)]))
        return
    columns = (
        "tube", "objective", "sensor", "bare, mm", "stated, %", "alone, %", "here, %", "95 %", "hottest, degC",
        "missed", "silent",
    )  # fmt: skip
    rows = [
        (
            k.tube,
            k.objective,
            k.sensor,
            f"{1e3 * k.bare:.1f}",
            f"{100 * k.stated:.1f}",
            f"{100 * k.alone:.1f}",
            f"{100 * k.share:.1f}",
            f"{100 * k.interval[0]:.1f}-{100 * k.interval[1]:.1f}",
            f"{k.hottest:.1f}",
            ", ".join(f"{n} {why}" for why, n in k.reasons.items()),
            f"{k.silent}",
        )
        for k in results
    ]
    tables = [table(f"{options.rigs} rigs, on a model of their own", columns, rows)] if rows else []
    heads = ("rig", "switch shorts", "tube, degC", "peak, degC", "stated, degC")
    lines = [(s.rig, s.state, *(f"{value:.0f}" for value in (s.before, s.peak, s.stated))) for s in shorts]
    notes = [f"{k.tube}, {k.objective}: {k.refused}" for k in results if k.refused]
    show([*tables, table("shorted switch", heads, lines)] if lines else tables, notes)


if __name__ == "__main__":
    main()
