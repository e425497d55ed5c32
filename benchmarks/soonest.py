"""How soon a plan's hold begins and is done, against the soonest whole counts on a thermal model written apart.

    python -m benchmarks.soonest [--robots WORD ...] [--json]

More power never makes anything colder, and a hotter tube loses more, so that the greatest count in every slot that
keeps the ramp as the slot begins, the mean current, and the window's end after it is what no schedule is ahead of by
much. It is found on `rig_thermal`, in a window that is less by the plan's mesh error. Beside it: real power, chosen
anew every `STEP`.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from dataclasses import asdict, dataclass, replace

import numpy as np

from tubeopt import HeatingSpec, Rig, Tube, load_rig, plan_heating

from .rig_loop import tubes
from .rig_thermal import KELVIN, Bench
from .timing import ROOT, show, table

STEP = 0.05
"""s."""


@dataclass(frozen=True)
class Start:
    """Beginning of the hold, s: of the plan, by whole counts, and by real power; and the plan's verdict."""

    case: str
    planned: float
    counts: float
    power: float
    verdict: str

    hold: float = HeatingSpec().hold_time

    @property
    def done(self) -> float:
        """By how much the plan is done later, as a fraction: what the objective is."""
        return (self.planned + self.hold) / (self.counts + self.hold) - 1

    @property
    def later(self) -> float:
        """By how much its hold begins later than that of the soonest whole counts, as a fraction."""
        return self.planned / self.counts - 1


def soonest(tube: Tube, rig: Rig, spec: HeatingSpec, step: float, *, whole: bool) -> float:
    """Time at which the curved part can be in the window, s, by counts for every `step`, s."""
    bench, time, (low, high) = Bench(tube, rig), 0.0, spec.window_degC
    while time < spec.longest_heating:
        warm = bench.state[: bench.n] - KELVIN
        if min(float(bench.bend_begins(warm[None])[0]), float(warm[bench.bend_from :].min())) >= low:
            return time
        start = bench.state.copy(), bench.used, bench.sag
        count = math.floor(most(bench, spec, math.inf)) if whole else most(bench, spec, step)
        while bench.pass_time(count, step)[-1].max() > min(high, spec.limit) and whole and count > 0:
            (bench.state, bench.used, bench.sag), count = start, count - 1
        time += step
    return math.inf


def most(bench: Bench, spec: HeatingSpec, step: float) -> float:
    """Greatest count that keeps ramp and mean current now, and in a line the window's end after a step, s; inf: any."""
    room = 0.0 if math.isinf(step) else 1 / step
    heat = bench.capacity()
    idle, full = (bench.gains(on)[bench.edge : bench.n] / heat[bench.edge : bench.n] for on in (0.0, 1.0))
    top = min(spec.window_degC[1], spec.limit) - (bench.state[bench.edge : bench.n] - KELVIN)
    within = np.minimum(spec.ramp, top * room) if room else spec.ramp
    on = float(((within - idle) / np.maximum(full - idle, 1e-9)).min())
    return 255 * min(max(on, 0.0), 1.0, bench.rig.circuit.current_limit / bench.current()[0])


def main() -> None:
    """Measure and tell."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", nargs="*", default=["thesis"], help="those whose names hold one of these words")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    rig, spec, results = load_rig(ROOT / "configs" / "rigs" / "thesis_calcium_silicate.yaml"), HeatingSpec(), []
    for name, tube in tubes(args.robots):
        plan = plan_heating(tube, rig, spec)
        # A plan holds the window with the error of its mesh to spare, and so must what it is held against.
        sure = replace(spec, window_degC=(spec.window_degC[0] + plan.mesh_error, spec.window_degC[1] - plan.mesh_error))
        counts, power = soonest(tube, rig, sure, spec.slot, whole=True), soonest(tube, rig, spec, STEP, whole=False)
        results.append(Start(name, plan.hold_start, counts, power, plan.verdict))
        print(results[-1], file=sys.stderr, flush=True)
    if args.json:
        print(json.dumps([asdict(one) for one in results]))
        return
    rows = [
        (
            f.case,
            f"{f.planned:.1f}",
            f"{f.counts:.1f}",
            f"{100 * f.later:+.1f}",
            f"{100 * f.done:+.1f}",
            f"{f.power:.2f}",
            f.verdict,
        )
        for f in results
    ]
    columns = ("tube", "plan, s", "whole counts, s", "later by, %", "done later by, %", "real power, s", "verdict")
    show([table("beginning of the hold", columns, rows)], [])


if __name__ == "__main__":
    main()
