#!/usr/bin/env python
"""Break input files in many ways and see that every one ends with an answer or with a sentence, never with a traceback.

    .ci/mutate files [COUNT [SEED]]

takes files of all kinds, from configs/ and from below, changes one place of each, and gives them to the commands that
read them. It prints every command that ended otherwise than with a documented exit code, and ends with 1 if there were
any. What is still at work after some seconds of the processor makes sense, and is left; what waits without working
hangs. Run it by night.
"""

from __future__ import annotations

import contextlib
import io
import os
import random
import sys
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# What is left while it is being imported is half there for what comes next.
import scipy.integrate  # noqa: E402
import scipy.interpolate  # noqa: E402
import scipy.optimize  # noqa: E402
import scipy.spatial  # noqa: E402
import scipy.stats  # noqa: E402, F401

from tubeopt.cli.app import main  # noqa: E402

CODES = (0, 2, 3, 4)
"""With which a command may end: done, bad input, no solution, not proved."""

SECONDS = 4
"""Of the processor, after which a command is taken to be at work on an input that makes sense, and left."""

PATIENCE = 300
"""Seconds after which a command that has not worked as long hangs."""

NUMBERS = ("0", "-1", "1e400", "nan", ".inf", "-.inf", "1e-300", "1e12", "007", "1_000", "0x10", "true", "null", "",
           "'5'", "[1, 2]", "{a: 1}", "5 mm", "1,5", "9" * 400, "&x 1", "*x", "!!python/object:os.system",
           "2026-01-01")  # fmt: skip
"""What a number is replaced by."""

COMMANDS: dict[str, tuple[tuple[str, ...], ...]] = {
    "robots": (("fk", "{}"), ("robot", "show", "{}")),
    "molds": (("mold", "plan", "configs/robots/two_tube.yaml", "--mold", "{}"),),
    "rigs": (("heat", "plan", "{}"),),
    "studies": (("run", "{}"),),
    "obstacles": (("ik", "configs/robots/two_tube.yaml", "--target-mm", "0,0,1e9", "--obstacles", "{}"),),
    "joints": (("ik", "configs/robots/thesis_ctr.yaml", "--target-mm", "0,-50,180", "--from", "{}"),),
    "paths": (("follow", "configs/robots/thesis_ctr.yaml", "{}"),),
    "targets": (("ik", "configs/robots/thesis_ctr.yaml", "--targets", "{}"),),
    "experiments": (
        ("validate", "configs/robots/thesis_etr.yaml", "{}"),
        ("heat", "calibrate", "{}", "--rig", "configs/rigs/thesis_calcium_silicate.yaml"),
        ("force", "configs/robots/thesis_ctr.yaml", "{}"),
    ),
    "tubes": (("design", "configs/studies/design_stock.yaml", "--stock", "{}"),),
    "trials": (("mold", "calibrate", "{}"),),
    "trajectories": (("verify", "{}", "--robot", "configs/robots/two_tube.yaml"),),
    "anatomies": (("ik", "configs/robots/two_tube.yaml", "--target-mm", "0,0,1e9", "--anatomy", "{}"),),
    "calibrations": (("fk", "{}"), ("follow", "{}", "{0.parent}/way.csv")),
}
"""Kind of a file, a folder of configs/ or of those below -> commands that read it."""

SEEDS = {
    "trajectories": (".csv", """time_s,rotation_1_deg,rotation_2_deg,translation_1_mm,translation_2_mm
0,0,0,-10,-30
1,20,5,-10,-30
2.5,40,10,-12,-31
"""),
    "anatomies": (".yaml", """anatomy:
  points:
    - {file: cloud.csv, radius_mm: 2, unit: mm, axes: LPS, cell_mm: 1}
  landmarks: {file: landmarks.csv, axes: RAS}
  base: {at: entry, towards: carina, roll_deg: 20}
"""),
    "calibrations": (".yaml", (ROOT / "configs/robots/two_tube.yaml").read_text(encoding="utf-8") + """calibration:
  rotation_offsets_deg: [1, -2]
  translation_offsets_mm: [0.5, -0.2]
  rotation_gains: [1.01, 0.99]
  translation_gains: [1, 1]
  rotation_play_deg: [0.5, 0]
  translation_play_mm: [0.1, 0.2]
  translation_compliance_mm_per_N: [0.01, 0]
  latency_s: 0.05
friction: {torque_mN_m_per_m: [5], plate_mN_m: [0.2]}
limits: {rotations_deg: [[-180, 180], [-90, 90]], translations_mm: [[-50, 0], [-50, 0]]}
"""),
}  # fmt: skip
"""Kinds of which configs/ has no file: how its name ends, and its text."""

BESIDE = {
    "cloud.csv": "x_mm,y_mm,z_mm\n20,30,40\n22,30,40\n22,32,41\n20,32,41\n",
    "way.csv": "rotation_1_deg,rotation_2_deg\n0,0\n30,10\n60,-10\n",
    "landmarks.csv": "name,x_mm,y_mm,z_mm\nentry,0,0,0\ncarina,5,10,80\n",
}
"""Files that those name."""


class TooLong(BaseException):
    """A command is at work: its input makes sense."""


def mutations(text: str, random_: random.Random) -> str:
    """The text of a file with one place changed."""
    lines = text.splitlines()
    inside = [k for k, line in enumerate(lines) if line.strip() and not line.lstrip().startswith("#")]
    k = random_.choice(inside)
    paths: tuple[Callable[[], None], ...] = (
        lambda: _number(lines, k, random_),
        lambda: _number(lines, k, random_),
        lambda: lines.__setitem__(k, lines[k].replace("_mm", "_m", 1).replace("_deg", "_rad", 1)),
        lambda: lines.__delitem__(k),
        lambda: lines.insert(k, lines[k]),
        lambda: lines.__setitem__(k, "  " * random_.randint(0, 3) + lines[k].lstrip()),
        lambda: lines.__setitem__(k, lines[k].replace(":", "", 1)),
        lambda: lines.__setitem__(k, lines[k].replace(",", random_.choice((";", ",,", " ")), 1)),
        lambda: lines.__setitem__(k, lines[k] + random_.choice((" [", " }", ": x", " # é", "\t", '"', "\x00", "𝄞"))),
        lambda: lines.__delitem__(slice(k, None)),
    )
    random_.choice(paths)()
    return "\n".join(lines) + random_.choice(("\n", "", "\r\n", "\n\n"))


def _number(lines: list[str], k: int, random_: random.Random) -> None:
    import re

    results = list(re.finditer(r"-?\d+(\.\d+)?(e-?\d+)?", lines[k]))
    if results:
        one = random_.choice(results)
        lines[k] = lines[k][: one.start()] + random_.choice(NUMBERS) + lines[k][one.end() :]
    else:
        head, _, _ = lines[k].partition(":")
        lines[k] = f"{head}: {random_.choice(NUMBERS)}"


def outcome(arguments: list[str]) -> str:
    """How a command ends: "" as it should, else what went wrong."""
    written = io.StringIO()
    rung: list[bool] = []
    try:
        with contextlib.redirect_stdout(written), contextlib.redirect_stderr(written), at_most(rung):
            main(arguments)
    except SystemExit as end:
        output = written.getvalue()
        # The alarm may ring in a callback of a solver, which tells it and goes on.
        if end.code in CODES and ("Traceback" not in output or TooLong.__name__ in output):
            return ""
        return f"ended with {end.code}: {written.getvalue()[-800:]}"
    except TooLong:
        return ""
    except TimeoutError:
        return f"hangs: {traceback.format_exc()}"
    except BaseException:  # any kind is the fault that is looked for
        return "" if rung else traceback.format_exc()  # a solver has words of its own for the alarm in its callback
    return "did not end"


@contextlib.contextmanager
def at_most(rung: list[bool]) -> Iterator[None]:
    """Raise TooLong inside after so much work, and note in `rung` that it was; TimeoutError after so long a wait."""
    import signal

    def stop(*_: object) -> None:
        rung.append(True)
        raise TooLong

    def hangs(*_: object) -> None:
        raise TimeoutError

    before = signal.signal(signal.SIGPROF, stop), signal.signal(signal.SIGALRM, hangs)
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    signal.alarm(PATIENCE)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before[0])
        signal.signal(signal.SIGALRM, before[1])


def run(count: int, seed: int) -> int:
    """The number of commands that ended as they must not."""
    random_ = random.Random(seed)
    files = [path for kind in COMMANDS for path in sorted((ROOT / "configs" / kind).glob("*.*"))]
    texts = [(each.parent.name, each.name, each.suffix, each.read_text(encoding="utf-8")) for each in files]
    texts += [("trials", name, end, text) for _, name, end, text in texts if "trials" in name and end == ".csv"]
    texts += [(kind, kind, end, text) for kind, (end, text) in SEEDS.items() for _ in range(4)]
    os.chdir(ROOT)
    positions: Counter[str] = Counter()
    with tempfile.TemporaryDirectory(dir=ROOT / "configs") as folder:
        for name, text in BESIDE.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        for number in range(count):
            kind, name, end, original = random_.choice(texts)
            position = Path(folder) / f"mutated{end}"
            text = mutations(original, random_)
            position.write_text(text, encoding="utf-8", newline="")
            for command in COMMANDS[kind]:
                wrong = outcome([part.format(position) for part in command])
                if wrong:
                    last = [line for line in wrong.splitlines() if "tubeopt" in line][-1:]
                    positions["".join(last) or wrong[-200:]] += 1
                    print(f"--- {number}: {name}: {' '.join(command)}\n{wrong}\n{text}", flush=True)
    print(f"{count} files, {sum(positions.values())} wrong endings")
    for where, times in positions.most_common():
        print(f"{times:5d}  {where.strip()}")
    return sum(positions.values())


if __name__ == "__main__":
    given = [int(argument) for argument in sys.argv[1:]]
    sys.exit(1 if run(*(given + [1000, 0][len(given) :])) else 0)
