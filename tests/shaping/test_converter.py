"""What the sketch makes of the words of a thermometer's converter, against the data sheets, for every word."""

from __future__ import annotations

import random
import subprocess
from importlib import resources
from pathlib import Path

import pytest

from .firmware_host import COMPILER

pytestmark = pytest.mark.skipif(COMPILER is None, reason="no C++ compiler")

ZERO, PER_STEP, STEPS, SENSOR_MS = -20.0, 0.25, 1024, 100

HEADER = f"""
#define SENSOR_MAX31855 1
#define SENSOR_MAX6675 2
#define SENSOR_ANALOG 3
#define SENSOR_MS {SENSOR_MS}
#define ANALOG_ZERO ({ZERO}f)
#define ANALOG_PER_STEP ({PER_STEP}f)
#define ANALOG_STEPS {STEPS}
"""

DECODING = """
#include <stdio.h>
#include "converter.h"
int main() {
  long high, low;
  while (scanf("%ld %ld", &high, &low) == 2) {
    float celsius = 0;
#if SENSOR == SENSOR_ANALOG
    const bool well = decoded((int)high, &celsius);
#else
    const bool well = decoded((uint16_t)high, (uint16_t)low, &celsius);
#endif
    printf("%d %.6f\\n", well, celsius);
  }
}
"""

ASKING = """
#include <stdio.h>
#include "converter.h"
static int asked = 0;
static bool ask(float *celsius) { *celsius = ++asked; return asked % 3 != 0; }
int main() {
  unsigned long now;
  while (scanf("%lu", &now) == 1) {
    float celsius = 0;
    const bool well = when_ready(ask, (uint32_t)now, &celsius);
    printf("%d %.0f\\n", well, celsius);
  }
}
"""


def answers(folder: Path, sensor: str, program: str, lines: list[str]) -> list[tuple[bool, float]]:
    """(well, number) that a program about converter.h says to each line."""
    source = resources.files("tubeopt.shaping.firmware") / "sketch" / "converter.h"
    (folder / "converter.h").write_text(source.read_text(encoding="utf-8"), encoding="utf-8")
    (folder / "board.h").write_text(HEADER + f"#define SENSOR SENSOR_{sensor}\n", encoding="utf-8")
    (folder / "main.cpp").write_text(program, encoding="utf-8")
    command = [
        str(COMPILER),
        "-std=c++11",
        "-Wall",
        "-Wextra",
        "-Wno-unused-function",
        "-Werror",
        "main.cpp",
        "-o",
        "main",
    ]
    subprocess.run(command, cwd=folder, check=True)
    told = subprocess.run([folder / "main"], input="\n".join(lines), capture_output=True, text=True, check=True).stdout
    return [(well == "1", float(number)) for well, number in map(str.split, told.splitlines())]


def test_the_max31855_has_fourteen_bits_with_a_sign_and_three_faults(tmp_path: Path) -> None:
    """Bits 31..18 quarters of a degree, 17 and 3 zero, 16 any fault, 2..0 short to supply, to ground, open."""
    draw = random.Random(0)
    words = [(quarters << 18) | (draw.getrandbits(12) << 4) for quarters in range(1 << 14)]
    words += [word | 1 << 16 | 1 << bit for word in words[::997] for bit in (0, 1, 2)]
    words += [word | 1 << bit for word in words[1:8000:991] for bit in (0, 1, 2, 16)]
    words += [0, 0xFFFFFFFF]
    told = answers(tmp_path, "MAX31855", DECODING, [f"{word >> 16} {word & 0xFFFF}" for word in words])
    for word, (well, celsius) in zip(words, told, strict=True):
        quarters = (word >> 18) - ((word >> 31) << 14)
        assert well == (word not in (0, 0xFFFFFFFF) and not word & 0x10007), hex(word)
        assert not well or celsius == quarters / 4, hex(word)


def test_the_max6675_has_twelve_bits_without_a_sign_and_an_open_input(tmp_path: Path) -> None:
    """Bits 14..3 quarters of a degree, 15 zero, 2 open input."""
    told = answers(tmp_path, "MAX6675", DECODING, [f"{word} 0" for word in (*range(1 << 15), 0xFFFF)])
    for word, (well, celsius) in enumerate(told[:-1]):
        assert well == (not word & 4)
        assert not well or celsius == (word >> 3) / 4
    assert not told[-1][0]


def test_an_analog_line_is_straight_and_false_where_it_is_cut_or_shorted(tmp_path: Path) -> None:
    told = answers(tmp_path, "ANALOG", DECODING, [f"{step} 0" for step in range(STEPS)])
    for step, (well, celsius) in enumerate(told):
        assert well == (3 <= step <= STEPS - 4)
        assert celsius == ZERO + PER_STEP * step


@pytest.mark.parametrize("begin", [5, 2**31 - 250, 2**32 - 250])
def test_a_converter_is_asked_when_it_is_ready(tmp_path: Path, begin: int) -> None:
    """In between it says what it said, also where the clock runs over; the first answer is at once."""
    steps = [0, 1, 99, 100, 101, 199, 201, 299, 300, 301, 430, 529, 530]
    asked = [1, 1, 1, 2, 2, 2, 3, 3, 3, 4, 5, 5, 6]
    before = [now for now in (5, 2**31 - 400, 2**32 - 2**20) if now < begin - 200]
    told = answers(tmp_path, "MAX6675", ASKING, [str(now % 2**32) for now in (*before, *(begin + x for x in steps))])
    numbers = [*range(1, len(before) + 1), *(number + len(before) for number in asked)]
    assert [round(celsius) for _, celsius in told] == numbers
    assert [well for well, _ in told] == [number % 3 != 0 for number in numbers]
