"""How a rig is wired: from the battery's plus through the tube to its minus, and what the board reads and switches."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import Any

from ...runs.heating_study import LedHeating
from ...shaping.firmware.boards import Wiring, parts_list
from .heating import IDEAL, TUBE
from .style import FAINT, INK, Axes, Figure, headed, narrow, new_figure, picture

Path = Sequence[tuple[float, float]]

BOXES = {
    "battery": (0.03, 0.44, 0.14, 0.35),
    "fuse": (0.22, 0.67, 0.08, 0.1),
    "current\nsensor": (0.37, 0.66, 0.12, 0.12),
    "tube\nin its mold": (0.59, 0.65, 0.17, 0.14),
    "stop": (0.29, 0.37, 0.1, 0.12),
    "gate\ndriver": (0.55, 0.37, 0.12, 0.12),
    "MOSFET": (0.76, 0.33, 0.16, 0.2),
    "board": (0.22, 0.03, 0.5, 0.13),
    "thermometer": (0.835, 0.03, 0.15, 0.13),
}
"""Where the parts stand: left, bottom, width, height."""

CURRENT: tuple[Path, ...] = (
    ((0.17, 0.72), (0.22, 0.72)),
    ((0.30, 0.72), (0.37, 0.72)),
    ((0.49, 0.72), (0.59, 0.72)),
    ((0.76, 0.72), (0.84, 0.72), (0.84, 0.53)),
    ((0.84, 0.33), (0.84, 0.28), (0.2, 0.28), (0.2, 0.51), (0.17, 0.51)),
    ((0.54, 0.72), (0.54, 0.87), (0.81, 0.87), (0.81, 0.72)),
)
"""Ways of the tube's current; the last but one is the ground, the last the way through the diode when it is off."""

GROUND: tuple[Path, ...] = (((0.64, 0.37), (0.64, 0.28)), ((0.68, 0.16), (0.68, 0.28)))
"""From the gate driver and the board to the ground."""

JOINTS = ((0.335, 0.72), (0.54, 0.72), (0.81, 0.72), (0.64, 0.28), (0.68, 0.28))
TERMINALS = {
    "+": (0.15, 0.72),
    "\N{MINUS SIGN}": (0.15, 0.51),
    "drain": (0.84, 0.505),
    "source": (0.84, 0.355),
    "GND": (0.68, 0.14),
}
DIODE, DIODE_SIZE = (0.675, 0.87), 0.022
"""Middle of its sign; its bar is towards the battery's plus."""


@picture
def plot_wiring(answer: LedHeating) -> Figure:
    """How the parts are wired, with poles, the pins of the board, and the ratings for the plan's currents."""
    figure = new_figure(9.8, 5.8)
    grid = figure.add_gridspec(1, 2, width_ratios=(1.9, 1.0))
    axes, text = figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[0, 1])
    for part in (axes, text):
        part.set_axis_off()
    axes.set(xlim=(0, 1), ylim=(-0.09, 0.97))
    _draw_parts(axes, answer.wiring.known.title)
    _draw_wires(axes, answer.wiring)
    _draw_diode(axes)
    lines = [f"{part.name}: {part.rating}" for part in parts_list(answer.plan, answer.wiring)]
    text.text(0, 0.97, "\n\n".join(textwrap.fill(line, 46) for line in lines), fontsize=8, va="top", color=INK)
    return headed(figure, f"{answer.plan.rig.name or 'rig'}: wiring")


def _draw_parts(axes: Axes, board: str) -> None:
    from matplotlib.patches import FancyBboxPatch

    for name, (x, y, w, h) in BOXES.items():
        box = FancyBboxPatch((x, y), w, h, boxstyle="round,pad=0.005", facecolor="white", edgecolor=FAINT)
        axes.add_patch(box)
        axes.text(x + w / 2, y + h / 2, board if name == "board" else name, ha="center", va="center", fontsize=9)
    for name, at in TERMINALS.items():
        size = 13 if len(name) == 1 else 7
        axes.text(*at, name, ha="center", va="center", fontsize=size, color=INK)


def _thick() -> float:
    """Width of the wires of the tube's current, points: letters shrink on a narrow page, and would be covered."""
    return 1.0 if narrow() else 2.4


def _draw_wires(axes: Axes, wiring: Wiring) -> None:
    thick = _thick()
    power: dict[str, Any] = {"color": TUBE, "lw": thick, "zorder": 0.5}
    ground: dict[str, Any] = {"color": INK, "lw": 1.0, "zorder": 0.5}
    signal: dict[str, Any] = {"color": IDEAL, "lw": 1.0, "zorder": 0.5}
    for ways, look, label in ((CURRENT, power, "current of the tube"), (GROUND, ground, "ground")):
        for path in ways:
            axes.plot(*zip(*path, strict=True), **look)
        axes.plot([], [], label=label, **look)
    axes.plot(*zip(*JOINTS, strict=True), "o", color=INK, ms=1.7 * thick)
    pins = wiring.known.pins
    read = f"pin {pins['select']}, SPI" if wiring.converter != "analog" else f"pin {pins['temperature']}"
    wires: tuple[tuple[Path, str, tuple[float, float]], ...] = (
        (((0.6, 0.16), (0.6, 0.37)), f"pin {pins['gate']}", (0.607, 0.2)),
        (((0.67, 0.43), (0.76, 0.43)), "gate", (0.69, 0.44)),
        (((0.43, 0.66), (0.43, 0.56), (0.52, 0.56), (0.52, 0.16)), f"pin {pins['current']}", (0.525, 0.2)),
        (((0.335, 0.72), (0.335, 0.58), (0.26, 0.58), (0.26, 0.16)), f"pin {pins['voltage']},\ndivider", (0.265, 0.19)),
        (((0.36, 0.37), (0.36, 0.16)), f"pin {pins['stop']}\nto GND", (0.367, 0.19)),
        (((0.39, 0.43), (0.55, 0.43)), "supply", (0.405, 0.44)),
        (((0.96, 0.16), (0.96, 0.58), (0.675, 0.58), (0.675, 0.65)), "on the tube", (0.86, 0.59)),
        (((0.835, 0.095), (0.72, 0.095)), read, (0.732, 0.105)),
    )
    for path, label, at in wires:
        axes.plot(*zip(*path, strict=True), **signal)
        axes.text(*at, label, fontsize=7, color=INK)
    axes.plot([], [], label="signals", **signal)
    words = (
        "There is one ground: battery, driver and board are joined at the MOSFET's source. Current sensor, divider\n"
        "and thermometer take theirs from the board. Between pulses the tube is at the battery's plus: a bead that\n"
        "touches its metal would put that on the converter. A coat of ceramic cement or a foil of mica insulates it."
    )
    axes.text(0.03, 0.0, words, fontsize=7, color=INK, va="top")
    axes.legend(loc="upper left", fontsize=7, bbox_to_anchor=(0.0, 1.0))


def _draw_diode(axes: Axes) -> None:
    from matplotlib.patches import Polygon

    (x, y), half = DIODE, DIODE_SIZE
    axes.add_patch(Polygon([(x + half, y - half), (x + half, y + half), (x - half, y)], color=TUBE, zorder=2))
    axes.plot([x - half, x - half], [y - half, y + half], color=TUBE, lw=_thick(), zorder=2)
    axes.text(x, y + 1.8 * half, "diode, its bar towards plus", ha="center", fontsize=7, color=INK)
