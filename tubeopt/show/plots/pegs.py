"""Pegs on their board from above; beside them, along the tube: how far it is off its curve, and how much colder."""

from __future__ import annotations

import math

import numpy as np

from ...files.units import TO_MM
from ...shaping.mold.pegs import PegBoard
from ...typing import Array
from ..colours import tube_colour
from .style import INK, Axes, Figure, disk, headed, new_figure, picture

DISK = "#D9D4C5"


@picture
def plot_pegs(board: PegBoard, *, title: str = "") -> Figure:
    """The board with its pegs, the tube's deviation and temperature."""
    width, height = board.size
    figure = new_figure(8.6, 2.9 + 8.0 * min(height / width, 0.7))
    rows = figure.add_gridspec(2, 2, height_ratios=[8.0 * min(height / width, 0.7), 1.7])
    _draw_board(figure.add_subplot(rows[0, :]), board)
    off, cold = figure.add_subplot(rows[1, 0]), figure.add_subplot(rows[1, 1])
    colour, s = tube_colour(board.number - 1), board.held.arc_length * TO_MM
    off.plot(s, board.held.offset * 1e6, color=colour, lw=1.2)
    off.set_ylabel("off its curve (µm)")
    cold.plot(s, _colder(board), color=colour, lw=1.2)
    cold.axhline(board.spec.heat.tolerance, color=INK, lw=0.8, ls=(0, (4, 2)), label="tolerance")
    cold.legend(loc="best")
    cold.set_ylabel("colder by (K)")
    for axes in (off, cold):
        axes.set_xlabel("along the tube, from the proximal clamp (mm)")
        axes.axvspan(*(x * TO_MM for x in board.kept), color=DISK, alpha=0.35, lw=0)
        for peg in board.pegs:
            axes.axvline(peg.arc_length * TO_MM, color=INK, lw=0.5, alpha=0.4)
    return headed(
        figure,
        f"{title or f'{len(board.pegs)} pegs for tube {board.number}'}: within {board.deviation * 1e6:.0f} µm and "
        f"{math.degrees(board.heading_deviation):.2f}° of its curve as far as it is kept (shaded below)",
    )


def _colder(board: PegBoard) -> Array:
    """(N,) K by which the tube is colder along itself: a fin with sinks at the pegs."""
    s = board.held.arc_length
    places = np.array([peg.arc_length for peg in board.pegs])
    spots = np.exp(-np.abs(s[:, None] - places) / board.heat.decay_length)
    fin = board.heat.loss / board.spec.heat.rise
    return np.asarray(spots @ board.heat.drawn / (2 * fin * board.heat.decay_length))


def _draw_board(axes: Axes, board: PegBoard) -> None:
    spec = board.spec.pegs
    width, height = (side * TO_MM for side in board.size)
    axes.plot([0, width, width, 0, 0], [0, 0, height, height, 0], color=INK, lw=0.8)
    for hole in board.holes.values():
        disk(axes, np.multiply(hole, TO_MM), 0.5 * spec.shank * TO_MM, fc="white", ec=INK, lw=0.3, alpha=0.6)
    points = board.centreline.sample(0.5e-3) * TO_MM
    axes.plot(*points.T, color=tube_colour(board.number - 1), lw=1.6, zorder=3)
    for peg in board.pegs:
        place, radius = np.multiply(peg.place, TO_MM), (spec.eccentricity + 0.5 * spec.pin) * TO_MM
        disk(axes, place, radius, fc=DISK, ec=INK, lw=0.6, zorder=2)
        disk(axes, np.multiply(peg.pin, TO_MM), 0.5 * spec.pin * TO_MM, fc=INK, lw=0, zorder=4)
        # The name stands on the side away from the tube.
        at = place + (radius + 3.2) * _outwards(board, peg.arc_length, left=peg.left)
        words = f"{peg.hole}, {math.degrees(peg.angle):g}°"
        axes.text(float(at[0]), float(at[1]), words, ha="center", va="center", fontsize=6.5, zorder=5)
    for name, (x, y), beside, side in (("proximal", points[0], -1.5, "right"), ("distal", points[-1], 1.5, "left")):
        axes.text(x + beside, y, name, fontsize=6.5, color=INK, ha=side, va="center")
    axes.set(aspect="equal", xlim=(-2, width + 2), ylim=(-2, height + 2))
    axes.set(xlabel="x (mm)", ylabel="y (mm)")


def _outwards(board: PegBoard, s: float, *, left: bool) -> Array:
    """Unit vector from the tube to one side, at an arc length (m)."""
    begin = 0.0
    for piece in board.centreline.pieces:
        if s <= begin + piece.length:
            break
        begin += piece.length
    t = piece.tangent(np.array([s - begin]))[0]
    return np.array([-t[1], t[0]]) * (1 if left else -1)
