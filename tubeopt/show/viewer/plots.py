"""Small live plots as SVG: torsion along the arm, the S-curve, the stability map. No browser is needed for them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from ...equilibrium.result import Equilibrium
from ...files.units import TO_MM
from ...stability import Branch, StabilityMap
from ...typing import Array
from ..colours import margin_colour, tube_colour
from ..plots.branch import fold_points, smooth, stable_parts

WIDTH, HEIGHT = 340, 190
LEFT, RIGHT, TOP, BOTTOM = 54, 14, 16, 34
GREY = "#8a8f98"


@dataclass(frozen=True)
class Axes:
    """A plot's ranges, and from them pixels."""

    x: tuple[float, float]
    y: tuple[float, float]
    labels: tuple[str, str]

    def at(self, x: Array, y: Array) -> Array:
        """(k, 2) pixels of values (k,)."""
        across = LEFT + (np.asarray(x) - self.x[0]) / (self.x[1] - self.x[0]) * (WIDTH - LEFT - RIGHT)
        down = HEIGHT - BOTTOM - (np.asarray(y) - self.y[0]) / (self.y[1] - self.y[0]) * (HEIGHT - TOP - BOTTOM)
        return np.column_stack([across, down])

    def line(self, x: Array, y: Array, colour: str, *, dashed: bool = False, width: float = 1.8) -> str:
        """A line through values."""
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in self.at(x, y))
        dash = ' stroke-dasharray="5 4"' if dashed else ""
        return f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="{width}"{dash}/>'

    def dot(self, x: float, y: float, colour: str, *, hollow: bool = False, radius: float = 4.0) -> str:
        """A point."""
        ((a, b),) = self.at(np.array([x]), np.array([y]))
        fill = "white" if hollow else colour
        return f'<circle cx="{a:.1f}" cy="{b:.1f}" r="{radius}" fill="{fill}" stroke="{colour}" stroke-width="1.5"/>'


def ticks(low: float, high: float, *, angle: bool = False) -> Array:
    """Three to six round numbers in a range."""
    steps = [15, 30, 45, 90, 180, 360] if angle else []
    decade = 10.0 ** np.floor(np.log10((high - low) / 5))
    steps += [round_ * decade for round_ in (1, 2, 5, 10)] if not angle or (high - low) < 60 else []
    step = next((s for s in sorted(steps) if (high - low) / s <= 5.5), max(steps))
    first = np.ceil(low / step - 1e-9)
    return np.asarray(np.arange(first, np.floor(high / step + 1e-9) + 1) * step)


def frame(axes: Axes, body: Sequence[str], title: str, *, angles: tuple[bool, bool] = (False, False)) -> str:
    """A whole plot: grid, numbers, names of the axes, and what is drawn."""
    out = [
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" width="100%" role="img" aria-label="{escape(title, quote=True)}" '
        'style="font:10px sans-serif;display:block">'
    ]
    text = f'fill="{GREY}"'
    for value in ticks(*axes.x, angle=angles[0]):
        ((a, _),) = axes.at(np.array([value]), np.array([axes.y[0]]))
        out.append(f'<line x1="{a:.1f}" x2="{a:.1f}" y1="{TOP}" y2="{HEIGHT - BOTTOM}" stroke="{GREY}" opacity=".25"/>')
        out.append(f'<text x="{a:.1f}" y="{HEIGHT - BOTTOM + 12}" text-anchor="middle" {text}>{_number(value)}</text>')
    for value in ticks(*axes.y, angle=angles[1]):
        ((_, b),) = axes.at(np.array([axes.x[0]]), np.array([value]))
        out.append(f'<line x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{b:.1f}" y2="{b:.1f}" stroke="{GREY}" opacity=".25"/>')
        out.append(f'<text x="{LEFT - 4}" y="{b + 3:.1f}" text-anchor="end" {text}>{_number(value)}</text>')
    out += body
    middle = (LEFT + WIDTH - RIGHT) / 2
    out.append(f'<text x="{middle}" y="{HEIGHT - 6}" text-anchor="middle" {text}>{escape(axes.labels[0])}</text>')
    up = (TOP + HEIGHT - BOTTOM) / 2
    out.append(
        f'<text transform="translate(10 {up}) rotate(-90)" text-anchor="middle" {text}>{escape(axes.labels[1])}</text>'
    )
    return "".join(out) + "</svg>"


def _number(value: float) -> str:
    return f"{value + 0.0:.6g}".replace("-", "\N{MINUS SIGN}")


def _range(values: Array, least: float) -> tuple[float, float]:
    """A range around values, no narrower than `least`."""
    low, high = float(np.min(values)), float(np.max(values))
    room = max(0.06 * (high - low), (least - (high - low)) / 2, 1e-12)
    return low - room, high + room


def torsion_plot(equilibrium: Equilibrium) -> str:
    """Torsion of every tube over arc length, each up to its own end."""
    s = equilibrium.arc_length
    torsion = np.degrees(equilibrium.torsion) * 1e-3
    axes = Axes(
        _range(s * TO_MM, 1.0), _range(np.append(torsion.ravel(), 0.0), 0.2), ("arc length (mm)", "torsion (deg/mm)")
    )
    body = []
    for i in reversed(range(len(torsion))):
        on = s <= equilibrium.tube_end[i] + 1e-12
        if on.sum() > 1:
            width = 1.4 + 0.9 * i
            body.append(axes.line(s[on] * TO_MM, torsion[i, on], tube_colour(i), width=width))
    names = "".join(f'<tspan dx="5" fill="{tube_colour(i)}">{i + 1}</tspan>' for i in range(len(torsion)))
    body.append(
        f'<text x="{WIDTH - RIGHT}" y="{TOP - 5}" text-anchor="end" font-weight="bold">'
        f'<tspan fill="{GREY}" font-weight="normal">tube</tspan>{names}</text>'
    )
    return frame(axes, body, "torsion of each tube over arc length")


def s_curve_plot(branch: Branch, equilibrium: Equilibrium, tube: int) -> str:
    """Tip angle of a tube over its input, the folds, and where the robot is now."""
    fine = smooth(branch)
    x, y = np.degrees(fine.rotations[:, tube]), np.degrees(fine.tip_rotations[:, tube])
    here = float(np.degrees(equilibrium.rotations[tube])), float(np.degrees(equilibrium.tip_rotations[tube]))
    labels = f"input of tube {tube + 1} (deg)", "its tip (deg)"
    axes = Axes(_range(np.append(x, here[0]), 10.0), _range(np.append(y, here[1]), 10.0), labels)
    colour = tube_colour(tube)
    body = []
    for first, last, stable in stable_parts(fine.margin):
        part = slice(first, last + 1, 4)
        body.append(axes.line(x[part], y[part], colour, dashed=not stable))
    body += [axes.dot(x[k], y[k], colour, hollow=True, radius=3.0) for k in fold_points(fine)]
    body.append(axes.dot(*here, "currentColor"))
    return frame(axes, body, "S-curve: tip angle over input angle", angles=(True, True))


def map_plot(chart: StabilityMap, equilibrium: Equilibrium) -> str:
    """Margin over two relative rotations, paler where the way there from home snaps, and where the robot is.

    The place is hollow where whole turns were taken off: the map does not know of them.
    """
    angles = np.degrees(chart.angles)
    first, second = chart.tubes
    labels = f"tube {first + 1} (deg)", f"tube {second + 1} (deg)"
    axes = Axes((-180.0, 180.0), (-180.0, 180.0), labels)
    half = (angles[1] - angles[0]) / 2
    body = []
    for i, a in enumerate(angles):
        for j, b in enumerate(angles):
            corners = np.clip([a - half, a + half, b - half, b + half], -180, 180)
            (x0, y1), (x1, y0) = axes.at(corners[:2], corners[2:])
            dim = ".45" if chart.snaps[i, j] else "1"
            body.append(
                f'<rect x="{x0:.1f}" y="{y0:.1f}" width="{x1 - x0 + 0.3:.1f}" height="{y1 - y0 + 0.3:.1f}" '
                f'fill="rgb{margin_colour(chart.margin[i, j])}" opacity="{dim}"/>'
            )
    still = max(set(range(equilibrium.robot.n_tubes)) - set(chart.tubes))
    relative = np.degrees(equilibrium.rotations - equilibrium.rotations[still])
    wrapped = (relative + 180) % 360 - 180
    wound = bool(np.abs(wrapped - relative)[[first, second]].max() > 1e-9)
    body.append(axes.dot(float(wrapped[first]), float(wrapped[second]), "#111", hollow=wound))
    return frame(axes, body, "margin over two rotations", angles=(True, True))
