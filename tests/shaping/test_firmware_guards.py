"""Every limit, timer and guard of the firmware: the compiled heater beside a second writing of what it must do, on a
schedule of a few slots, with made-up readings."""

from __future__ import annotations

import json
import math
import random
import re
import subprocess
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

import pytest

from tests.sanitizers import sanitizers

from .firmware_host import COMPILER, built

pytestmark = pytest.mark.skipif(COMPILER is None, reason="no C++ compiler")

SLOT_MS, TICKS, TICK_MS, HOLD_FIRST = 300, 3, 100, 6
PROPORTIONAL, INTEGRAL, SHARE, HOLDBACK, LOST = 0.01, 0.02, 0.25, 10.0, 1.75
HOLD_FLOOR = 40.0
MOST_COUNT, HALF, TEST_COUNT, TEST_TICKS, CUTOUT_MS = 249, 0.50390625, 2, 2, 150
BARE_COUNT, STILL_MS = 30.5, 700
PATIENCE_MS, LONGEST_MS, STUCK_MS, STUCK_HOLDING_MS = 1490, 9000, 300, 1400
TOO_HOT, LOWEST_READING, HIGHEST_READING, START_BELOW = 558.0, -20.0, 900.0, 80.0
STUCK_WITHIN, STUCK_RISE = 0.125, 3.0
MOST_AMPERE, LEAST_AMPERE, LEAKING_AMPERE, LOWEST_VOLT = 200.0, 30.0, 4.0, 9.0
REFERENCE = [25.0, 27.0, 31.0, 37.0, 45.0, 52.0, 56.0, 56.7, 56.7, 56.7, 56.7, 56.7, 56.7, 56.7, 56.7, 56.7, 56.7]
PLANNED = [
    [4.0, 30.25, 28.5, 26.75, 24.0, 20.5, 12.25, 10.0, 8.5, 8.25, 8.0, 0.6, 0.4, 0.4, 0.0, 7.75, 0.0],
    [5.0, 34.25, 32.5, 30.75, 27.0, 23.5, 14.25, 12.0, 9.5, 9.25, 9.0, 0.6, 0.4, 0.4, 0.0, 8.75, 0.0],
    [6.0, 40.25, 250.0, 254.5, 250.5, 27.5, 16.25, 13.0, 10.5, 10.25, 10.0, 0.6, 0.4, 0.4, 0.0, 9.75, 0.0],
]
VOLTS = [12.7, 12.4, 12.1]
SLOTS = len(REFERENCE)
TESTED = 3 * TEST_TICKS
"""Ticks of the test before the schedule."""

HEADER = f"""#include <stdint.h>
#define SCHEDULE_ID "made up"
#define SLOTS {SLOTS}u
#define WINDOW_LOW 50
#define WINDOW_HIGH 60
#define HOLD_FIRST {HOLD_FIRST}u
#define SLOT_MS {SLOT_MS}u
#define TICKS_PER_SLOT {TICKS}u
#define TICK_MS {TICK_MS}u
#define TABLES 3u
#define PROPORTIONAL ({PROPORTIONAL}f)
#define INTEGRAL ({INTEGRAL}f)
#define SHARE ({SHARE}f)
#define BARE_COUNT ({BARE_COUNT}f)
#define STILL_MS {STILL_MS}ul
#define HOLDBACK ({HOLDBACK}f)
#define MOST_COUNT {MOST_COUNT}u
#define HALF {HALF}f
#define TEST_COUNT {TEST_COUNT}u
#define TEST_TICKS {TEST_TICKS}u
#define CUTOUT_MS {CUTOUT_MS}u
#define HOLD_FLOOR ({HOLD_FLOOR}f)
#define PATIENCE_MS {PATIENCE_MS}ul
#define LONGEST_MS {LONGEST_MS}ul
#define LOST ({LOST}f)
#define TOO_HOT ({TOO_HOT}f)
#define CORRECTION (0.0f)
#define CORRECTED_FROM (25.0f)
#define LOWEST_READING ({LOWEST_READING}f)
#define HIGHEST_READING ({HIGHEST_READING}f)
#define START_BELOW {START_BELOW}f
#define STUCK_WITHIN ({STUCK_WITHIN}f)
#define STUCK_RISE ({STUCK_RISE}f)
#define STUCK_MS {STUCK_MS}ul
#define STUCK_HOLDING_MS {STUCK_HOLDING_MS}ul
#define MOST_AMPERE ({MOST_AMPERE}f)
#define LEAST_AMPERE ({LEAST_AMPERE}f)
#define LOWEST_VOLT ({LOWEST_VOLT}f)
static const float PLANNED[TABLES][SLOTS] = {{{", ".join("{" + ", ".join(map(str, row)) + "}" for row in PLANNED)}}};
static const float REFERENCE[SLOTS] = {{{", ".join(map(str, REFERENCE))}}};
static const float VOLTS[TABLES] = {{{", ".join(map(str, VOLTS))}}};
static inline float voltage_of(uint8_t table) {{ return VOLTS[table]; }}
static inline float planned_at(uint8_t table, uint16_t k) {{ return PLANNED[table][k]; }}
static inline float reference_at(uint16_t k) {{ return REFERENCE[k < SLOTS ? k : SLOTS - 1]; }}
"""

SOURCES = resources.files("tubeopt.shaping.firmware") / "sketch"


def compiled(folder: Path, options: tuple[str, ...] = (), header: str = HEADER) -> Path:
    """The heater with this schedule, for this computer; `options` are the compiler's."""
    for name in ("heater.h", "heater.cpp", "hardware.h", "host.cpp"):
        (folder / name).write_text((SOURCES / name).read_text(encoding="utf-8"), encoding="utf-8")
    (folder / "schedule.h").write_text(header, encoding="utf-8")
    (folder / "board.h").write_text(f"#define LEAKING_AMPERE ({LEAKING_AMPERE}f)\n", encoding="utf-8")
    return built(folder, options=options)


@pytest.fixture(scope="module")
def heater(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The heater with this schedule."""
    return compiled(tmp_path_factory.mktemp("guards"))


@dataclass(frozen=True)
class Row:
    """What the board sees at a tick: ms, degC, V, A while on, A while off, button; and a line that arrives."""

    ms: int
    celsius: float | None = 25.0
    volt: float | None = 12.8
    on: float = 90.0
    off: float = 0.0
    button: int = 0
    line: str = ""


def run(heater: Path, rows: list[Row]) -> list[tuple[int, list[dict[str, Any]]]]:
    """Count of the switch after every row, and the lines of the heater at it; those of its start come first."""

    def shown(value: float | None) -> str:
        return "nan" if value is None else f"{value!r}"

    asked = "".join(f"{r.ms} {shown(r.celsius)} {shown(r.volt)} {r.on!r} {r.off!r} {r.button} {r.line}\n" for r in rows)
    out = subprocess.run([heater], input=asked, capture_output=True, text=True, check=True).stdout
    found: list[tuple[int, list[dict[str, Any]]]] = []
    lines: list[dict[str, Any]] = []
    for line in out.splitlines():
        if line.startswith("="):
            found.append((int(line.split()[1]), lines))
            lines = []
        else:
            lines.append(json.loads(line))
    assert not lines
    assert len(found) == len(rows) + 1
    return found


# --- what it must do, written apart ---------------------------------------------------------------------------------


def clip(value: float, low: float, high: float) -> float:
    return max(low, min(value, high))


@dataclass
class Twin:
    """What the heater must do, in double precision."""

    state: str = "idle"
    reason: str = ""
    count: int = 0
    switch: int = 0
    lines: list[dict[str, Any]] = field(default_factory=list)
    dry: bool = False
    table: int = 0
    place: int = 0
    total: float = 0.0
    owed: float = 0.0
    waited: int = 0
    began: int = 0
    due: int = 0
    tick_of_slot: int = 0
    lead: tuple[float, float, int] = (0.0, 0.0, 0)
    reading: float = 0.0
    electrics: tuple[float, float, float] | None = None
    still: tuple[float, int, float] = (0.0, 0, 0.0)
    bad: tuple[int, int] = (0, 0)
    first: str = ""
    stops: list[str] = field(default_factory=list)
    hold: bool = False
    bench: bool = False
    released: int = 0

    @property
    def running(self) -> bool:
        return self.state in ("testing", "heating", "holding")

    def tick(self, row: Row) -> tuple[int, list[dict[str, Any]]]:
        self.lines = []
        # Of the characters that wait 63 are kept; a line without an end is not obeyed.
        if row.line:
            self.obey(row.line[:63], row)
        if self.state == "testing" and self.released:
            self.watch_cutout(row)
        if row.ms - self.due >= 0:
            self.due = self.due + TICK_MS if self.running else row.ms + TICK_MS
            self.step(row)
        return self.switch, self.lines

    def step(self, row: Row) -> None:
        why = self.danger(row)
        if why:
            return self.stop(why, row) if why != self.reason else None
        if not self.running or self.released:
            return None
        if self.state == "testing":
            self.hold = self.tick_of_slot >= TEST_TICKS
            why = self.test(row)
            if why:
                return self.stop(why, row)
            if self.state == "testing":
                return None
        self.hold = True
        if self.tick_of_slot == 0:
            self.decide(row)
            if self.state != "stopped":
                self.tell(row)
        self.tick_of_slot = (self.tick_of_slot + 1) % TICKS
        return None

    def test(self, row: Row) -> str:
        part, rest = divmod(self.tick_of_slot, TEST_TICKS)
        if rest == 0:
            measured = row.volt is not None
            leaks = measured and row.off > LEAKING_AMPERE
            flows = leaks or (measured and row.on > LEAKING_AMPERE)
            if part == 1 and flows:
                return "switch stuck" if leaks else "cut-out stuck"
            if part == 2:
                if flows:
                    return "switch stuck"
                if row.volt is not None and row.volt < LOWEST_VOLT and not self.dry:
                    return "low battery"
                fit = [k for k, volt in enumerate(VOLTS) if row.volt is not None and volt <= row.volt + 0.05]
                self.table = 0 if row.volt is None else (fit[0] if fit else len(VOLTS) - 1)
            if part == 3:
                if measured and not self.dry and not LEAST_AMPERE <= row.on <= MOST_AMPERE:
                    return "over-current" if row.on > MOST_AMPERE else "no current"
                self.began, self.tick_of_slot, self.still = row.ms, 0, (self.reading, row.ms, 0.0)
                if self.bench:
                    self.released, self.hold = row.ms | 1, False
                else:
                    self.state = "heating"
                return ""
            self.count = self.switch = 0 if part == 1 or self.dry else TEST_COUNT
        self.tick_of_slot += 1
        return ""

    def watch_cutout(self, row: Row) -> None:
        assert row.volt is not None
        self.electrics = (row.volt, row.on, row.off)
        span = row.ms - self.released
        if max(row.on, row.off) > LEAKING_AMPERE:
            if span > CUTOUT_MS:
                self.stop("cut-out stuck", row)
            return
        self.lines.append({"event": "cutout", "opened_ms": span, "allowed_ms": CUTOUT_MS})
        self.stop("done", row)

    def tell(self, row: Row) -> None:
        time = 0.0 if self.state == "idle" else (row.ms - self.began) / 1000
        volt, on, _ = self.electrics or (None, None, None)
        self.lines.append(
            {
                "event": "status", "state": self.state, "time_s": time, "temperature_degC": self.reading,
                "reference_degC": REFERENCE[min(self.place, SLOTS - 1)], "count": self.count, "place": self.place,
                "voltage_V": volt, "current_A": on, "reason": self.reason, "dry": self.dry, "led": self.lead[2] > 0,
            }
        )  # fmt: skip

    def error(self, text: str) -> None:
        self.lines.append({"event": "error", "text": text})

    def stop(self, why: str, row: Row) -> None:
        self.count, self.switch, self.state, self.reason, self.hold, self.released = 0, 0, "stopped", why, False, 0
        self.stops.append(why)
        self.tell(row)

    def obey(self, line: str, row: Row) -> None:
        if '"stop"' in line:
            if self.running:
                self.stop("stopped by command", row)
            else:
                self.tell(row)
        elif '"lead"' in line:
            parts = [int(line.split(f'"{key}":')[1].split(",")[0].rstrip("}")) if f'"{key}":' in line else -1
                     for key in ("slots", "from", "to")]  # fmt: skip
            slots, first, last = parts
            if not 1 <= slots <= 20 or not 0 <= first <= 25500 or not 0 <= last <= 25500:
                self.error("a lead is wrong")
            else:
                self.lead = first / 100, (last - first) / 100 / (slots - 1) if slots > 1 else 0.0, slots
        elif '"start"' in line:
            self.start(row, '"dry":true' in line, bench=False)
        elif '"test"' in line:
            self.start(row, False, bench=True)
        elif '"status"' in line:
            self.tell(row)
        elif '"hello"' in line:
            self.lines.append({"event": "hello", "firmware": "tubeopt heater", "schedule": "made up", "slots": SLOTS,
                               "slot_ms": SLOT_MS, "window_degC": [50, 60]})  # fmt: skip
        else:
            self.error('a line is {"do":"start"}, or stop, status, hello, test in place of start')

    def start(self, row: Row, dry: bool, *, bench: bool) -> None:
        if self.running:
            return self.error("it is heating")
        if row.button:
            return self.error("the stop button is pressed")
        if row.celsius is None or row.celsius <= LOWEST_READING:
            return self.error("the thermometer answers nothing")
        self.reading = row.celsius
        if row.celsius > START_BELOW:
            return self.error("the tube is still hot")
        self.electrics = None if row.volt is None else (row.volt, row.on, row.off)
        if row.volt is not None and row.volt < LOWEST_VOLT / 2:
            return self.error("no voltage: the switch is shorted, or the fuse is blown")
        if row.volt is not None and row.volt < LOWEST_VOLT and not dry:
            return self.error("the battery is low")
        if bench and row.volt is None:
            return self.error("the board measures no current")
        self.bench = bench
        self.dry, self.place, self.total, self.owed, self.waited = dry, 0, 0.0, 0.0, 0
        self.tick_of_slot, self.lead, self.bad = 0, (self.lead[0], self.lead[1], 0), (0, 0)
        self.began = self.due = row.ms
        self.still = (row.celsius, row.ms, 0.0)
        self.reason, self.state = "", "testing"
        return None

    def danger(self, row: Row) -> str:
        if row.button:
            return "emergency stop"
        good = row.celsius is not None and LOWEST_READING < row.celsius < HIGHEST_READING
        readings, currents = 0 if good else min(self.bad[0] + 1, 3), self.bad[1]
        self.bad = readings, currents
        if readings >= 3 and self.running:
            return "thermometer broken"
        if good:
            assert row.celsius is not None
            self.reading = row.celsius
            if row.celsius > TOO_HOT:
                return "over-temperature"
            if self.stuck(row):
                return "thermometer stuck"
        self.electrics = None if row.volt is None else (row.volt, row.on, row.off)
        off = self.dry or not self.running
        if row.volt is not None:
            if row.on > MOST_AMPERE:
                wrong = "over-current"
            elif row.off > LEAKING_AMPERE or (off and row.on > LEAKING_AMPERE):
                wrong = "switch stuck"
            elif off or self.state == "testing":
                wrong = ""
            elif self.count > 1 and row.on < LEAST_AMPERE:
                wrong = "no current"
            elif row.volt < LOWEST_VOLT:
                wrong = "low battery"
            else:
                wrong = ""
            self.first = self.first if currents else wrong
            currents = min(currents + 1, 2) if wrong else 0
            self.bad = readings, currents
            if currents >= 2:
                return self.first
        return "maximum time" if self.running and row.ms - self.began > LONGEST_MS else ""

    def stuck(self, row: Row) -> bool:
        assert row.celsius is not None
        at, since, rise = self.still
        if abs(row.celsius - at) > STUCK_WITHIN or self.count == 0 or self.dry or self.state == "testing":
            at, since, rise = row.celsius, row.ms, 0.0
        else:
            now, following = (REFERENCE[min(self.place + k, SLOTS - 1)] for k in (0, 1))
            rise += (following - now) * TICK_MS / SLOT_MS
        self.still = at, since, rise
        span = row.ms - since
        return span > STUCK_HOLDING_MS or (span > STUCK_MS and rise > STUCK_RISE + 1e-5)

    def decide(self, row: Row) -> None:
        if self.place >= SLOTS:
            return self.stop("done", row)
        error = REFERENCE[self.place] - self.reading
        behind = error > HOLDBACK and self.place <= HOLD_FIRST
        waits = not self.dry and (behind or (self.reading < HOLD_FLOOR and self.place >= HOLD_FIRST))
        self.waited += SLOT_MS if waits else 0
        if self.waited > PATIENCE_MS:
            return self.stop("behind schedule" if behind or self.place < HOLD_FIRST else "too cold", row)
        # A thermometer that lost touch in the hold leaves the count to what was learnt before.
        if self.place >= HOLD_FIRST and row.ms - self.still[1] > STILL_MS:
            error = 0.0
        planned = PLANNED[self.table][self.place]
        most = clip(BARE_COUNT / planned - 1, 0.0, SHARE) if planned > 0 else SHARE
        self.total = clip(self.total + INTEGRAL * SLOT_MS / 1000 * error, -SHARE, most)
        share = clip(PROPORTIONAL * error + self.total, -SHARE, most)
        wish, step, left = self.lead
        if left:
            if planned > 0:
                share = clip(wish / planned - 1, -SHARE, most)
                self.total = clip(share - PROPORTIONAL * error, -SHARE, most)
            self.lead = wish + step, step, left - 1
        wanted = planned * (1 + share)
        due = wanted + self.owed
        self.count = int(clip(math.floor(due + LOST + 1 - HALF), 0, MOST_COUNT)) if due > HALF else 0
        given = max(self.count - LOST, 0.0)
        self.owed = clip(due - given, -1 - LOST, 1.0) if wanted > 0 else 0.0
        self.state = "holding" if self.place >= HOLD_FIRST else "heating"
        if not waits:
            self.place += 1
        self.switch = 0 if self.dry else self.count
        return None


def same(found: dict[str, Any], wanted: dict[str, Any]) -> bool:
    """Whether two reports are the same to the digits that the heater writes."""
    digits = {
        "time_s": 0.051,
        "temperature_degC": 0.006,
        "reference_degC": 0.051,
        "voltage_V": 0.006,
        "current_A": 0.051,
    }
    if found.keys() != wanted.keys():
        return False
    for key, value in wanted.items():
        if key in digits and value is not None and found[key] is not None and not math.isnan(value):
            if abs(found[key] - value) > digits[key]:
                return False
        elif found[key] != value and not (isinstance(value, float) and math.isnan(value)):
            return False
    return True


def check_heater(heater: Path, rows: list[Row]) -> Twin:
    """Hold the heater against its twin on rows; the twin after them."""
    twin = Twin()
    (switch, hello), *after = run(heater, rows)
    assert switch == 0
    assert [line["event"] for line in hello] == ["hello"]
    for row, (count, lines) in zip(rows, after, strict=True):
        wanted, told = twin.tick(row)
        assert (count, len(lines)) == (wanted, len(told)), (row, lines, told)
        assert all(same(*pair) for pair in zip(lines, told, strict=True)), (row, lines, told)
    return twin


def following(twin: Twin, noise: random.Random, lag: float = 0.0) -> float:
    """A reading near the reference of a twin."""
    return round(REFERENCE[min(twin.place, SLOTS - 1)] - lag + noise.uniform(-2, 2), 2)


def heated(count: int, *, lag: float = 0.0, seed: int = 0, line: str = '{"do":"start"}', **seen: Any) -> list[Row]:
    """Rows of a heating that follows its schedule, a start before them."""
    noise, twin, rows = random.Random(seed), Twin(), []
    for k in range(TESTED + count):
        celsius = following(twin, noise, lag if k > TESTED else 0.0)
        # Also where a count is 0: tests change the readings, and so the counts.
        on = 90.0 if k > TESTED and twin.running and not twin.dry else current(twin)
        row = Row(1000 + TICK_MS * k, celsius, line=line if k == 0 else "", **{"on": on} | seen)
        rows.append(row)
        twin.tick(row)
    return rows


def current(twin: Twin) -> float:
    """Current while the switch conducts, A."""
    return 90.0 if twin.switch and twin.hold else 0.0


def changed(rows: list[Row], first: int, many: int = 1, **values: Any) -> list[Row]:
    """Rows of which `many` from the `first` of the schedule on see something else."""
    first += TESTED
    return [Row(**{**vars(r), **(values if first <= k < first + many else {})}) for k, r in enumerate(rows)]


# --- random rigs and readings ---------------------------------------------------------------------------------------


def scripted(seed: int) -> list[Row]:
    """Ticks in which everything may happen: faults that stay for a few, leads, commands, late and early ticks."""
    dice, twin, rows, ms = random.Random(seed), Twin(), [], 1000
    fault: dict[str, Any] = {}
    left, lag, base = 0, 0.0, dice.choice([12.8, 12.66, 12.64, 12.5, 12.36, 12.2, 11.0, None])
    commands = [
        '{"do":"stop"}', '{"do":"status"}', '{"do":"hello"}', '{"do":"start","dry":true}', "nonsense", '{"do":"lead"}',
        '{"do":"lead","slots":0,"from":1,"to":1}', '{"do":"lead","slots":21,"from":1,"to":1}',
        '{"do":"lead","slots":3,"from":25501,"to":1}', '{"do":"lead","slots":3,"from":1,"to":25501}',
    ]  # fmt: skip
    for _ in range(200):
        line = ""
        if twin.state in ("idle", "stopped"):
            line = dice.choice(['{"do":"start"}'] * 6 + ['{"do":"start","dry":true}', '{"do":"test"}', *commands])
            lag = dice.choice([0.0, 0.0, 0.0, 12.0, -30.0, 60.0])
        elif dice.random() < 0.02:
            line = dice.choice(commands)
        elif dice.random() < 0.05:
            first, last = dice.randint(0, 4000), dice.randint(0, 4000)
            line = f'{{"do":"lead","slots":{dice.randint(1, 6)},"from":{first},"to":{last}}}'
        if left == 0:
            fault = dice.choice(
                [{}] * 12
                + [{"celsius": None}, {"celsius": -20.5}, {"celsius": 900.5}, {"celsius": 558.5}, {"celsius": 557.5},
                   {"on": 200.5}, {"on": 199.5}, {"on": 29.5}, {"on": 30.5}, {"off": 4.5}, {"off": 3.5}, {"volt": 8.95},
                   {"volt": 9.05}, {"button": 1}, {"celsius": 40.0}]
            )  # fmt: skip
            left = dice.choice([1, 2, 3, 4, 8, 20]) if fault else dice.choice([5, 20, 40])
        left -= 1
        ms += dice.choice([100] * 12 + [50, 99, 101, 130, 300])
        seen: dict[str, Any] = {"celsius": following(twin, dice, lag), "volt": base} | fault
        if base is None:
            seen["volt"] = None
        row = Row(ms, line=line, **{"on": current(twin)} | seen)
        rows.append(row)
        twin.tick(row)
    return rows


def test_the_heater_does_what_its_twin_does_whatever_happens(heater: Path) -> None:
    reasons = set()
    for seed in range(200):
        rows = scripted(seed)
        check_heater(heater, rows)
        twin = Twin()
        for row in rows:
            twin.tick(row)
            reasons |= {twin.reason}
    assert reasons == {
        "", "done", "stopped by command", "emergency stop", "thermometer broken", "thermometer stuck",
        "over-temperature", "over-current", "no current", "switch stuck", "cut-out stuck", "low battery",
        "behind schedule",
    }  # fmt: skip


# --- one by one, from both sides of every limit -----------------------------------------------------------------------


def reason(heater: Path, rows: list[Row]) -> str:
    """Reason of the first stop; what it sees afterwards are rows of a heating that was not stopped."""
    return (check_heater(heater, rows).stops or [""])[0]


def test_it_starts_on_a_cold_tube_only(heater: Path) -> None:
    for celsius, starts in ((79.99, True), (80.0, True), (80.01, False), (300.0, False)):
        (_, (count, lines)) = run(heater, [Row(1000, celsius, line='{"do":"start"}')])
        assert (count > 0) == starts
        assert starts or lines == [{"event": "error", "text": "the tube is still hot"}]


def test_a_lead_changes_the_schedule_by_no_more_than_the_share(heater: Path) -> None:
    for wish in (0, 500, 2500, 3000, 3500, 25500):
        rows = heated(7)
        rows = changed(rows, 1, line=f'{{"do":"lead","slots":2,"from":{wish},"to":{wish}}}')
        check_heater(heater, rows)
        count = run(heater, rows)[1 + TESTED + TICKS][0]
        planned = PLANNED[0][1]
        # A count is given for the time that a pulse loses, and one may be owed by the slot before.
        assert planned * (1 - SHARE) - 2 <= count - LOST <= planned * (1 + SHARE) + 2
        most = max(min(planned * (1 + SHARE), BARE_COUNT), planned)
        assert abs(count - LOST - clip(wish / 100, planned * (1 - SHARE), most)) < 2.5


@pytest.mark.parametrize("dry", [False, True])
def test_a_dry_run_switches_nothing(heater: Path, dry: bool) -> None:
    line = '{"do":"start","dry":true}' if dry else '{"do":"start"}'
    rows = heated(3 * SLOTS + 3, line=line)
    assert reason(heater, rows) == "done"
    assert any(count for count, _ in run(heater, rows)) != dry


def bench(heater: Path, welded_ms: int, **seen: Any) -> list[dict[str, Any]]:
    """Lines of a test of the cut-out, which opens `welded_ms` after the ticks have ended."""
    twin, rows = Twin(), []
    for ms in range(1000, 1000 + 100 * TESTED + 400, 10):
        opening = twin.released and ms - twin.released < welded_ms
        on = 90.0 if twin.switch and (twin.hold or opening) else 0.0
        row = Row(ms, on=on, line='{"do":"test"}' if ms == 1000 else "", **seen)
        rows.append(row)
        twin.tick(row)
    check_heater(heater, rows)
    return [line for _, lines in run(heater, rows) for line in lines]


def test_the_bench_measures_how_fast_the_cut_out_opens(heater: Path) -> None:
    _, opened, stopped = bench(heater, 60)
    assert opened.pop("opened_ms") == pytest.approx(65, abs=5)
    assert opened == {"event": "cutout", "allowed_ms": CUTOUT_MS}
    assert stopped["reason"] == "done"
    assert bench(heater, 1000)[-1]["reason"] == "cut-out stuck"
    assert bench(heater, 60, volt=None)[1]["text"] == "the board measures no current"


def test_a_welded_cut_out_is_named_before_the_heating(heater: Path) -> None:
    rows = [Row(1000 + 100 * k, on=90.0 if k else 0.0, line="" if k else '{"do":"start"}') for k in range(TESTED)]
    assert reason(heater, rows) == "cut-out stuck"


@pytest.mark.parametrize("seen", [{"on": 0.0, "off": 90.0}, {"on": 90.0}])
def test_a_switch_that_conducts_is_named_when_idle_done_or_dry(heater: Path, seen: dict[str, float]) -> None:
    idle = [Row(1000 + 100 * k, on=0.0) for k in range(4)]
    done = heated(3 * SLOTS + 3 + TESTED)
    dry = heated(3 * SLOTS, line='{"do":"start","dry":true}')
    for rows, where in ((idle, -TESTED + 2), (done, 3 * SLOTS + 2), (dry, 9), (dry, -TESTED)):
        found = check_heater(heater, changed(rows, where, 2, **seen))
        assert found.stops[-1] == "switch stuck"
        assert not found.hold
    hot = check_heater(heater, changed(done, 3 * SLOTS + 2, celsius=558.5))
    assert hot.stops == ["done", "over-temperature"]
    pressed = check_heater(heater, changed(idle, -TESTED + 2, button=1))
    assert pressed.stops == ["emergency stop"]


def test_a_clock_that_stands_still_starves_watchdog_and_cut_out(heater: Path) -> None:
    asked = '1000 25 12.8 0 0 0 {"do":"start"}\n' + "1000 25 12.8 0 0 0\n" * 3
    told = subprocess.run([heater], input=asked, capture_output=True, text=True, check=True).stdout
    fed = [line.split()[3] for line in told.splitlines() if line.startswith("=")]
    assert fed == ["0", "1", "0", "0", "0"]


LIMITS = [
    ("celsius", [558.0], [558.25], 1, "over-temperature"),
    ("celsius", [899.9, 557.0], [900.0], 3, "thermometer broken"),
    ("celsius", [-19.9], [-20.0], 3, "thermometer broken"),
    ("on", [200.0, 30.0], [200.5], 2, "over-current"),
    ("on", [30.0], [29.5], 2, "no current"),
    ("off", [4.0], [4.125], 2, "switch stuck"),
    ("volt", [9.0], [8.75], 2, "low battery"),
]


@pytest.mark.parametrize(("what", "borne", "beyond", "times", "why"), LIMITS)
def test_every_limit_from_both_sides(
    heater: Path, what: str, borne: list[float], beyond: list[float], times: int, why: str
) -> None:
    rows = heated(24)
    for value in beyond:
        assert reason(heater, changed(rows, 5, times, **{what: value})) == why
        if times > 1:
            assert reason(heater, changed(rows, 5, times - 1, **{what: value})) == ""
    for value in borne:
        if what == "celsius" and value > 558:
            continue
        # For two ticks alone: a reading that stays is one that is stuck.
        assert reason(heater, changed(rows, 5, 2, **{what: value})) == ""


def test_a_fault_that_goes_is_forgotten(heater: Path) -> None:
    rows = heated(24)
    twice = changed(changed(rows, 5, 2, celsius=None), 8, 2, celsius=None)
    assert reason(heater, twice) == ""
    once = changed(changed(rows, 5, on=250.0), 7, on=250.0)
    assert reason(heater, once) == ""


def test_the_longest_pulse_leaves_a_pause_in_which_a_short_is_seen(heater: Path) -> None:
    rows = heated(20, volt=12.1)
    counts = [count for count, _ in run(heater, rows)[1 + TESTED :]]
    assert max(counts) == MOST_COUNT
    assert reason(heater, changed(rows, counts.index(MOST_COUNT) + 1, 2, off=50.0)) == "switch stuck"


def test_a_reading_that_stays_while_the_schedule_rises_is_stuck(heater: Path) -> None:
    rows = heated(30)
    still = changed(rows, 8, 20, celsius=33.0)
    found = check_heater(heater, still)
    assert found.stops[0] == "thermometer stuck"
    assert reason(heater, [Row(**{**vars(r), "celsius": 33.0 + 0.2 * (k % 2)}) if 8 <= k - TESTED < 14 else r
                           for k, r in enumerate(rows)]) == ""  # fmt: skip


def test_in_the_hold_a_reading_is_stuck_after_longer(heater: Path) -> None:
    rows = heated(3 * SLOTS + 3)
    first = 3 * HOLD_FIRST + 1
    many = STUCK_HOLDING_MS // TICK_MS
    assert reason(heater, changed(rows, first, many + 2, celsius=56.7)) == "thermometer stuck"
    assert reason(heater, changed(rows, first, many - 1, celsius=56.7)) == "done"


@pytest.mark.parametrize(("lag", "why"), [(9.0, "done"), (30.0, "behind schedule")])
def test_a_tube_that_falls_behind_is_waited_for_no_longer_than_patience(heater: Path, lag: float, why: str) -> None:
    noise, twin, rows = random.Random(1), Twin(), []
    for k in range(90 + TESTED):
        late = REFERENCE[min(twin.place, SLOTS - 1)] - lag if k > 12 + TESTED else following(twin, noise)
        celsius, line = round(late + 0.3 * (k % 2), 2), '{"do":"start"}' if k == 0 else ""
        row = Row(1000 + TICK_MS * k, celsius, on=current(twin), line=line)
        rows.append(row)
        twin.tick(row)
        if twin.state == "stopped":
            break
    assert reason(heater, rows) == why


def test_the_hold_waits_for_a_tube_that_is_too_cold_and_ends_so(heater: Path) -> None:
    rows = heated(3 * SLOTS)
    first = 3 * (HOLD_FIRST + 2)
    # Five slots below the floor are more than its patience; four only delay the end by as much.
    cold = [{"celsius": 39.0 + 0.3 * (k % 2)} for k in range(18)]
    for slots, why in ((6, "too cold"), (4, "")):
        late = rows
        for k in range(3 * slots):
            late = changed(late, first + k, **cold[k])
        assert reason(heater, late) == why


def test_it_heats_no_longer_than_the_longest_time(heater: Path) -> None:
    def late(gap: int) -> list[Row]:
        rows = heated(8)
        begun = rows[TESTED].ms
        return [*rows, Row(begun + gap, 31.3), Row(begun + gap + 1, 31.9)]

    assert reason(heater, late(LONGEST_MS)[:-1]) == ""
    assert reason(heater, late(LONGEST_MS + 1)[:-1]) == "maximum time"


@pytest.mark.parametrize(
    ("volt", "table"), [(12.8, 0), (12.66, 0), (12.64, 1), (12.36, 1), (12.34, 2), (11.0, 2), (None, 0)]
)
def test_the_schedule_is_that_for_the_battery(heater: Path, volt: float | None, table: int) -> None:
    rows = heated(3 * SLOTS + 3, volt=volt)
    twin = check_heater(heater, rows)
    assert (twin.table, twin.reason) == (table, "done")


def test_it_begins_off_and_refuses_to_start_where_it_must_not(heater: Path) -> None:
    start = '{"do":"start"}'
    for seen, text in (
        ({"button": 1}, "the stop button is pressed"),
        ({"celsius": None}, "the thermometer answers nothing"),
        ({"celsius": -200.0}, "the thermometer answers nothing"),
        ({"celsius": -20.0}, "the thermometer answers nothing"),
        ({"volt": 8.99}, "the battery is low"),
        ({"volt": 4.49}, "no voltage: the switch is shorted, or the fuse is blown"),
    ):
        found = run(heater, [Row(1000, line=start, **seen)])  # type: ignore[arg-type]
        assert (found[1][0], found[1][1][0]) == (0, {"event": "error", "text": text})
    dry = run(heater, heated(1, volt=8.99, line='{"do":"start","dry":true}'))
    assert dry[-1][1][0]["dry"]
    rows = changed(heated(8), 4, line=start)
    assert run(heater, rows)[5 + TESTED][1] == [{"event": "error", "text": "it is heating"}]
    check_heater(heater, rows)


def test_the_clock_may_run_over(heater: Path) -> None:
    # It does so after 49.7 days; the heating goes on as if nothing were.
    rows = heated(3 * SLOTS + 3)
    shift = 2**32 - 1000 - 1500
    wrapped = [Row(**{**vars(row), "ms": (row.ms + shift) % 2**32}) for row in rows]
    plain, over = run(heater, rows), run(heater, wrapped)
    assert [count for count, _ in plain] == [count for count, _ in over]
    assert over[-1][1] == plain[-1][1]


def test_a_second_start_knows_nothing_of_the_first(heater: Path) -> None:
    first = changed(heated(20, seed=2), 10, line='{"do":"lead","slots":20,"from":4000,"to":4000}')
    first = changed(first, 15, 2, celsius=None)
    first = changed(first, 17, button=1)
    again = [Row(**{**vars(row), "ms": row.ms + 2000}) for row in heated(3 * SLOTS + 3, seed=3)]
    assert check_heater(heater, [*first, *again]).reason == "done"


def test_numbers_are_told_to_their_digits(heater: Path) -> None:
    for celsius, volt, on in ((-0.04, 9.0, 0.0), (-12.34, 12.05, 199.95), (79.99, 10.0, 100.04), (0.0, 13.999, 30.05)):
        (_, _, (_, (told, *_))) = run(heater, [Row(1000, celsius, volt, on), Row(1010, line='{"do":"status"}')])
        assert told["temperature_degC"] == pytest.approx(celsius, abs=0.0051)
        assert told["voltage_V"] == pytest.approx(volt, abs=0.0051)
        assert told["current_A"] == pytest.approx(on, abs=0.051)


def test_a_line_that_is_too_long_harms_nothing(tmp_path: Path) -> None:
    """Not a byte beyond its buffer, which sanitizers would see."""
    heater = compiled(tmp_path, sanitizers(str(COMPILER)))
    for length in (62, 63, 64, 65, 150):
        rows = changed(heated(12), 6, line="x" * length)
        assert [line["event"] for line in run(heater, rows)[7 + TESTED][1]].count("error") == 1
        check_heater(heater, rows)


@pytest.mark.parametrize(
    "line",
    [
        '{"do":"lead"}',
        '{"do":"lead","from":5,"to":5}',
        '{"do":"lead","slots":3,"from":5}',
        '{"do":"lead","slots":3,"to":5}',
        '{"do":"lead","slots":0,"from":5,"to":5}',
        '{"do":"lead","slots":21,"from":5,"to":5}',
        '{"do":"lead","slots":3,"from":25501,"to":5}',
        '{"do":"lead","slots":3,"from":5,"to":25501}',
    ],
)
def test_a_wrong_lead_is_refused_and_changes_nothing(heater: Path, line: str) -> None:
    rows = changed(heated(9), 4, line=line)
    found = run(heater, rows)
    assert found[5 + TESTED][1][0] == {"event": "error", "text": "a lead is wrong"}
    assert not any(told.get("led") for _, lines in found for told in lines)
    check_heater(heater, rows)


def test_a_reset_by_the_watchdog_is_told_and_nothing_is_on(heater: Path) -> None:
    told = subprocess.run(
        [heater], input="", env={"RESET_BY_WATCHDOG": "1"}, capture_output=True, text=True, check=True
    ).stdout.splitlines()
    (hello, stopped), switch = [json.loads(line) for line in told[:-1]], told[-1]
    assert (hello["event"], stopped["state"], stopped["reason"], switch.split()[:3]) == (
        "hello",
        "stopped",
        "watchdog",
        ["=", "0", "0"],
    )


def test_numbers_have_the_digits_that_the_line_has_room_for(heater: Path) -> None:
    asked = '1000 25.123 12.345 90.06 0 0\n1010 25.123 12.345 90.06 0 0 {"do":"status"}\n'
    told = subprocess.run([heater], input=asked, capture_output=True, text=True, check=True).stdout
    digits = (
        r'"time_s":0\.0,"temperature_degC":25\.12,"reference_degC":25\.0,.*"voltage_V":12\.3[45],"current_A":90\.1,'
    )
    assert re.search(digits, told, re.DOTALL)


def test_no_current_is_seen_at_a_count_of_two(heater: Path) -> None:
    tried = [heated(3 * SLOTS + 3, seed=seed) for seed in range(20)]
    seen = [(rows, [count for count, _ in run(heater, rows)[1 + TESTED :]]) for rows in tried]
    rows, counts = next(one for one in seen if 2 in one[1])
    assert reason(heater, changed(rows, counts.index(2) + 1, 2, on=0.0)) == "no current"


@pytest.mark.parametrize(("step", "why"), [(0.122, "thermometer stuck"), (0.129, "")])
def test_a_reading_moves_where_it_changes_by_more_than_its_noise(heater: Path, step: float, why: str) -> None:
    rows = [
        Row(**{**vars(r), "celsius": 33.0 + step * (k % 2)}) if 8 <= k - TESTED < 16 else r
        for k, r in enumerate(heated(16))
    ]
    assert reason(heater, rows) == why


def test_a_reading_is_stuck_once_the_schedule_rose_by_the_rise(heater: Path) -> None:
    # From tick 13 on, two ticks of 4 / 3 K and two of 0.7 / 3 K are 3.13 K in 400 ms; from tick 14 on it is 2.03 K.
    for first in range(8, 18):
        rows = changed(heated(24), first, 12, celsius=50.0)
        assert reason(heater, rows) == ("thermometer stuck" if first <= 13 else "")


@pytest.mark.parametrize("lag", [0.0, 4.0, 8.0])
def test_what_a_full_count_cannot_give_is_owed_once(heater: Path, lag: float) -> None:
    rows = heated(30, volt=12.1, lag=lag)
    assert max(count for count, _ in run(heater, rows)) == MOST_COUNT
    check_heater(heater, rows)


def test_the_emptiest_of_many_schedules_is_for_batteries_below_them_all(tmp_path: Path) -> None:
    # Every table begins with a count of its own.
    rows = ", ".join(f"{{{k + 30}.0f, {', '.join('9.0f' for _ in REFERENCE[1:])}}}" for k in range(21))
    volts = ", ".join(f"{12.7 - 0.1 * k:.1f}f" for k in range(21))
    header = re.sub("TABLES 3u", "TABLES 21u", HEADER)
    header = re.sub(r"(PLANNED\[TABLES\]\[SLOTS\] = ).*;", rf"\1{{{rows}}};", header)
    header = re.sub(r"(VOLTS\[TABLES\] = ).*;", rf"\1{{{volts}}};", header)
    many = compiled(tmp_path, header=header)
    for volt, table in ((12.8, 0), (11.7, 10), (10.7, 20), (9.5, 20)):
        counts = [count for count, _ in run(many, changed(heated(2, volt=volt), 0, 2, celsius=25.0))]
        assert max(counts) == table + 32  # and what every pulse loses, 1.75
