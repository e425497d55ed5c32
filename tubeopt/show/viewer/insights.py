"""Slow results, computed when the joints rest: certificate, S-curve and stability map."""

from __future__ import annotations

import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from html import escape
from typing import NamedTuple

import numpy as np

from ...equilibrium.result import Equilibrium
from ...errors import InputError, SolveError
from ...files.units import TO_MM
from ...robots.robot import Robot
from ...stability import Branch, StabilityMap, snap_free_certificate, stability_map, trace_branch
from ...typing import Array
from ..page import margin_colour, tube_colour
from ..plots.maps import fold_points, smooth, stable_parts
from .panel import Panel
from .session import Session, equilibrium_load_text

MAP_SAMPLES = 13
"""Points per axis of the small stability map."""

MAX_TURN = 2 * np.pi
"""Largest rotation from home in an S-curve, rad, which repeats after a turn."""

CACHED_CURVES = 16
"""Number of cached S-curves of all tabs: a robot often returns to earlier joint values."""


class MapKey(NamedTuple):
    """Values on which certificate and stability map depend."""

    robot: Robot
    translations: tuple[float, ...]
    """Translations (n,), m."""


class CurveKey(NamedTuple):
    """Values on which an S-curve depends."""

    map: MapKey
    tube: int
    """Index of the turning tube."""
    other_rotations: tuple[float, ...]
    """Rotations of the other tubes, rad."""


class _InterruptedError(Exception):
    """Raised to stop a calculation because a job is waiting."""


class Insights:
    """Slow results, each stored with the values that it depends on, and shown while these are unchanged.

    Args:
        session: returns the current session.
        waiting: True if a more urgent job waits.
    """

    def __init__(self, panel: Panel, session: Callable[[], Session], waiting: Callable[[], bool]) -> None:
        self._panel, self._session, self._waiting = panel, session, waiting
        self.tube = 0
        self._certificate: tuple[object, float] | None = None
        self._curve: tuple[object, Branch | None] | None = None
        self._map: tuple[object, StabilityMap | None] | None = None
        self._map_shown = False
        self._loaded: Equilibrium | None = None

    @property
    def chores(self) -> list[tuple[float, Job]]:
        """Tasks that run after a time without input, and these times, s."""
        # Fast results come first: a map that starts early would delay the others.
        return [(0.03, self._certify), (0.1, self._show_load), (0.35, self._trace_curve), (0.6, self._compute_map)]

    @property
    def certificate(self) -> float | None:
        """Certificate at the current translations; None if it is not computed yet."""
        return self._certificate[1] if self._certificate and self._certificate[0] == self._map_key() else None

    def show_map(self, on: bool) -> None:
        """Show the stability map, or hide it."""
        self._map_shown, self._map = on, None
        self._panel.plot("map", "computing the stability map …" if on else "", text=on)

    def plot(self) -> None:
        """Mark the current joint values in the plots that depend on them."""
        current = self._session().equilibrium
        if current.load is not None:
            return
        if self._curve and self._curve[1] is not None and self._curve[0] == self._curve_key():
            self._panel.plot("curve", s_curve_plot(self._curve[1], current, self.tube))
        if self._map and self._map[1] is not None and self._map[0] == self._map_key():
            self._panel.plot("map", map_plot(self._map[1], current))

    def _map_key(self) -> MapKey:
        session = self._session()
        return MapKey(session.robot, tuple(session.equilibrium.translations.tolist()))

    def _curve_key(self) -> CurveKey:
        current = self._session().equilibrium
        # The rotation of the tube itself is the abscissa: turning it moves the mark and leaves the curve.
        return CurveKey(self._map_key(), self.tube, tuple(np.delete(current.rotations, self.tube).tolist()))

    def _certify(self) -> None:
        if self.certificate is None:
            session = self._session()
            value = snap_free_certificate(session.robot, session.equilibrium.translations)
            self._certificate = self._map_key(), value
            self._panel.show(session, value, None)

    def _show_load(self) -> None:
        """Show the effect of the load, and the largest load."""
        current = self._session().equilibrium
        if self._panel.push is not None and self._loaded is not current:
            self._loaded = current
            self._panel.push.report(equilibrium_load_text(current))

    def _trace_curve(self) -> None:
        key = self._curve_key()
        if self._session().equilibrium.load is not None:
            self._curve = None
            self._panel.plot("curve", "S-curves and maps are for no load", text=True)
            return
        if self._curve and self._curve[0] == key:
            return
        try:
            self._curve = key, _s_curve(key)
        except (InputError, SolveError) as error:
            # The failure is stored too, so that it is not tried again at every rest.
            self._curve = key, None
            self._panel.plot("curve", f"no S-curve here: {error}", text=True)
        self.plot()

    def _compute_map(self) -> None:
        key = self._map_key()
        if not self._map_shown or (self._map and self._map[0] == key):
            return

        def interrupt(completed: int, total: int) -> None:
            if self._waiting():
                # Raised from the progress of the search, which has no other exit.
                raise _InterruptedError

        session = self._session()
        shift = session.equilibrium.translations
        try:
            # As few directions as possible, and an even number: half of the paths follow from the other half.
            chart = stability_map(
                session.robot, shift, samples=MAP_SAMPLES, directions=2, workers=1, progress=interrupt
            )
        except _InterruptedError:
            return
        except (InputError, SolveError) as error:
            self._map = key, None
            self._panel.plot("map", f"no stability map: {error}", text=True)
            return
        self._map = key, chart
        self.plot()


@lru_cache(maxsize=CACHED_CURVES)
def _s_curve(key: CurveKey) -> Branch:
    """Branch along a turn of one tube, from one limit to the other; raises as `trace_branch` does."""
    robot, shift = key.map
    # Limits may be infinite, and curves repeat after a turn.
    ends = np.clip(robot.limits.rotations[key.tube], -MAX_TURN, MAX_TURN)
    start, end = (np.insert(np.array(key.other_rotations), key.tube, angle) for angle in ends)
    return trace_branch(robot, start, end, np.array(shift))


Job = Callable[[], object]


class Worker:
    """Thread that runs jobs in the order of posting, and chores after a delay, s, without jobs.

    Args:
        chores: (delay, chore): each is run once after the last job, in the order of the delays.
        failed: receives the exceptions of jobs and chores; the worker continues.
    """

    def __init__(self, chores: Sequence[tuple[float, Job]], failed: Callable[[Exception], object]) -> None:
        self._chores = sorted(chores, key=lambda chore: chore[0])
        self._failed = failed
        self._jobs: deque[tuple[str | None, Job]] = deque()
        self._change = threading.Condition()
        self._open = True
        threading.Thread(target=self._run, name="tubeopt-view", daemon=True).start()

    def post(self, job: Job, *, key: str | None = None) -> None:
        """Queue a job; it replaces a waiting job with the same key."""
        with self._change:
            # Of the positions of a slider only the latest matters: with all of them the robot would lag behind.
            if key is not None:
                self._jobs = deque(waiting for waiting in self._jobs if waiting[0] != key)
            self._jobs.append((key, job))
            self._change.notify()

    @property
    def waiting(self) -> bool:
        """True if jobs are waiting or the worker must end, so that optional work is postponed."""
        return bool(self._jobs) or not self._open

    def close(self) -> None:
        """Stop the worker, without waiting for it."""
        with self._change:
            self._open = False
            self._jobs.clear()
            self._change.notify()

    def _run(self) -> None:
        left, quiet = list(self._chores), time.monotonic()
        while self._open:
            job: Job | None = None
            with self._change:
                if not self._jobs:
                    # None waits for a job without end. Zero means that a chore is due.
                    wait = max(0.0, quiet + left[0][0] - time.monotonic()) if left else None
                    if wait != 0.0:
                        self._change.wait(wait)
                if self._jobs:
                    job = self._jobs.popleft()[1]
            if job is not None:
                self._attempt(job)
                # After each job all chores are due again: their results may be of another state.
                left, quiet = list(self._chores), time.monotonic()
            # The condition may wake early or spuriously, so the time is checked again.
            elif self._open and left and time.monotonic() >= quiet + left[0][0]:
                self._attempt(left.pop(0)[1])

    def _attempt(self, job: Job) -> None:
        try:
            job()
        except Exception as error:  # an error in one job must not leave the page without an answer
            if not self._open:
                return
            traceback.print_exc()
            self._failed(error)


WIDTH, HEIGHT = 340, 190
LEFT, RIGHT, TOP, BOTTOM = 54, 14, 16, 34
GREY = "#8a8f98"


@dataclass(frozen=True)
class Axes:
    """Axes of a plot: ranges, and the conversion to pixels."""

    x: tuple[float, float]
    y: tuple[float, float]
    labels: tuple[str, str]

    def at(self, x: Array, y: Array) -> Array:
        """(k, 2) pixel coordinates of values (k,) of the plot."""
        across = LEFT + (np.asarray(x) - self.x[0]) / (self.x[1] - self.x[0]) * (WIDTH - LEFT - RIGHT)
        down = HEIGHT - BOTTOM - (np.asarray(y) - self.y[0]) / (self.y[1] - self.y[0]) * (HEIGHT - TOP - BOTTOM)
        return np.column_stack([across, down])

    def line(self, x: Array, y: Array, colour: str, *, dashed: bool = False, width: float = 1.8) -> str:
        """SVG of a line through values."""
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in self.at(x, y))
        dash = ' stroke-dasharray="5 4"' if dashed else ""
        return f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="{width}"{dash}/>'

    def dot(self, x: float, y: float, colour: str, *, hollow: bool = False, radius: float = 4.0) -> str:
        """SVG of a point."""
        ((a, b),) = self.at(np.array([x]), np.array([y]))
        fill = "white" if hollow else colour
        return f'<circle cx="{a:.1f}" cy="{b:.1f}" r="{radius}" fill="{fill}" stroke="{colour}" stroke-width="1.5"/>'


def ticks(low: float, high: float, *, angle: bool = False) -> Array:
    """Three to six round numbers in a range."""
    # Angles are read in parts of a turn, not in tens.
    steps = [15, 30, 45, 90, 180, 360] if angle else []
    decade = 10.0 ** np.floor(np.log10((high - low) / 5))
    steps += [round_ * decade for round_ in (1, 2, 5, 10)] if not angle or (high - low) < 60 else []
    step = next((s for s in sorted(steps) if (high - low) / s <= 5.5), max(steps))
    # The tolerance keeps a tick at the end of a range, which round-off could lose.
    first = np.ceil(low / step - 1e-9)
    return np.asarray(np.arange(first, np.floor(high / step + 1e-9) + 1) * step)


def frame(axes: Axes, body: Sequence[str], title: str, *, angles: tuple[bool, bool] = (False, False)) -> str:
    """SVG of a plot: grid, numbers, names of the axes, and the drawing."""
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


def _range(values: Array, min_span: float) -> tuple[float, float]:
    """Range around values, of at least `min_span`."""
    low, high = float(np.min(values)), float(np.max(values))
    # Six per cent keep lines off the frame; the last bound avoids a scale of no length.
    border = max(0.06 * (high - low), (min_span - (high - low)) / 2, 1e-12)
    return low - border, high + border


def torsion_plot(equilibrium: Equilibrium) -> str:
    """SVG of the torsion of every tube over arc length, each up to its own end."""
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
    """SVG of the tip angle of a tube over its input, with folds and the current joint values."""
    fine = smooth(branch)
    x, y = np.degrees(fine.rotations[:, tube]), np.degrees(fine.tip_rotations[:, tube])
    current = float(np.degrees(equilibrium.rotations[tube])), float(np.degrees(equilibrium.tip_rotations[tube]))
    labels = f"input of tube {tube + 1} (deg)", "its tip (deg)"
    axes = Axes(_range(np.append(x, current[0]), 10.0), _range(np.append(y, current[1]), 10.0), labels)
    colour = tube_colour(tube)
    body = []
    for first, last, stable in stable_parts(fine.margin):
        # The spline has 2000 points and the plot about 270 pixels.
        part = slice(first, last + 1, 4)
        body.append(axes.line(x[part], y[part], colour, dashed=not stable))
    body += [axes.dot(x[k], y[k], colour, hollow=True, radius=3.0) for k in fold_points(fine)]
    body.append(axes.dot(*current, "currentColor"))
    return frame(axes, body, "S-curve: tip angle over input angle", angles=(True, True))


def map_plot(chart: StabilityMap, equilibrium: Equilibrium) -> str:
    """Map of the margin over two relative rotations, paler where the path from home snaps, with the current position.

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
                # 0.3 pixels more close the seams that browsers leave between rectangles.
                f'<rect x="{x0:.1f}" y="{y0:.1f}" width="{x1 - x0 + 0.3:.1f}" height="{y1 - y0 + 0.3:.1f}" '
                f'fill="rgb{margin_colour(chart.margin[i, j])}" opacity="{dim}"/>'
            )
    # Only relative rotations matter: turning all tubes together turns the whole arm.
    still = max(set(range(equilibrium.robot.n_tubes)) - set(chart.tubes))
    relative = np.degrees(equilibrium.rotations - equilibrium.rotations[still])
    # Into [-180, 180) deg, the range of the map.
    wrapped = (relative + 180) % 360 - 180
    wrapped_around = bool(np.abs(wrapped - relative)[[first, second]].max() > 1e-9)
    body.append(axes.dot(float(wrapped[first]), float(wrapped[second]), "#111", hollow=wrapped_around))
    return frame(axes, body, "margin over two rotations", angles=(True, True))
