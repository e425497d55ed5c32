"""Motion through waypoints: the tip and the margin on the way, broken where the robot snaps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from ...equilibrium.kinematics import forward_kinematics
from ...equilibrium.result import Equilibrium
from ...errors import SolveError
from ...files.units import TO_MM
from ...stability import Path, Snap
from ...typing import Array
from .style import FAINT, INK, Axes, Figure, headed, legend_beside, name_above, new_figure, number, picture

COORDINATES = (("x", "#D55E00"), ("y", "#009E73"), ("z", "#0072B2"))
"""Coordinates of the tip and their colours; from the palette of Okabe and Ito (2008)."""

BETWEEN = 4
"""Points per stretch between waypoints."""

NEAR_A_SNAP = 16
"""The same where the stretch ends in a snap."""

MOST_NAMES = 12
"""Snaps that are named in the picture; more would cover each other."""

Stretch = tuple[Array, list[Equilibrium]]
"""Places in a path from one snap to the next, and the equilibria there."""

Value = Callable[[Equilibrium], float]
"""What is drawn of an equilibrium."""


@picture
def plot_path(path: Path) -> Figure:
    """Picture of a motion: tip position over the waypoints, and the margin below it.

    Between waypoints equilibria are solved too, closer where a snap is near, towards which the margin falls like a
    root. At a snap the curves break: an open mark where the robot was, a full one where it lands.
    """
    parts = _refined(stretches(path, _numbers(path)))
    figure = new_figure(7.0, 5.0)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    for k, (name, colour) in enumerate(COORDINATES):
        draw_broken(above, parts, partial(_coordinate, k), colour, label=name)
    draw_broken(below, parts, lambda e: e.margin, INK)
    _mark_snaps(above, below, path)
    below.axhline(0, color=FAINT, lw=0.7)
    least = float(np.nanmin([each.margin for _, what in parts for each in what]))
    below.set_ylim(min(-0.05, least - 0.05), 1.05)
    above.set_ylabel("tip position (mm)")
    below.set(ylabel="margin", xlabel="waypoint")
    last = len(path.equilibria)
    below.set_xlim(1 - 0.02 * last, last + 0.02 * last)
    below.xaxis.get_major_locator().set_params(integer=True)
    for axes in (above, below):
        axes.grid(axis="y")
    legend_beside(above)
    headed(figure, _heading(path))
    return figure


def _coordinate(axis: int, equilibrium: Equilibrium) -> float:
    """Of the tip, mm."""
    return float(equilibrium.tip_position[axis]) * TO_MM


def place_of(snap: Snap, values: Array) -> float:
    """Where a snap happens, in what has these values (T,) at the waypoints."""
    return float(values[snap.index] + snap.fraction * (values[snap.index + 1] - values[snap.index]))


def stretches(path: Path, values: Array) -> list[Stretch]:
    """A path cut at its snaps: values and equilibria of each stretch, up to and from the very snap."""
    out: list[Stretch] = []
    where, what, done = [float(values[0])], [path.equilibria[0]], 1
    for snap in path.snaps:
        until = snap.index + 1
        here = place_of(snap, values)
        where += [*values[done:until].tolist(), here]
        what += [*path.equilibria[done:until], snap.before]
        out.append((np.array(where), what))
        where, what, done = [here], [snap.after], max(done, until)
    out.append((np.array([*where, *values[done:].tolist()]), [*what, *path.equilibria[done:]]))
    return out


def draw_broken(
    axes: Axes, parts: Sequence[Stretch], quantity: Value, colour: str, *, width: float = 1.4, label: str = ""
) -> list[Array]:
    """A quantity along the stretches of a path, with an open mark where each snap begins, and a full one where it ends;
    returns the values of each stretch."""
    drawn = [np.array([quantity(each) for each in what]) for _, what in parts]
    for k, ((where, _), values) in enumerate(zip(parts, drawn, strict=True)):
        axes.plot(where, values, color=colour, lw=width, label="_" if k else label, zorder=3)
    look: dict[str, Any] = {"ms": 4.5, "mec": colour, "zorder": 4, "clip_on": False}
    for (where, _), (old, new) in zip(parts, pairwise(drawn), strict=False):
        axes.plot(where[-1:], old[-1:], "o", mfc="white", mew=1.2, **look)
        axes.plot(where[-1:], new[:1], "o", mfc=colour, **look)
    return drawn


def _refined(parts: Sequence[Stretch]) -> list[Stretch]:
    """Stretches with points between their waypoints."""
    out: list[Stretch] = []
    for k, (where, what) in enumerate(parts):
        points = [(where[0], what[0])]
        for (at, here), (place, there) in pairwise(zip(where, what, strict=True)):
            to_fold = there is what[-1] and k + 1 < len(parts)
            points += [*_between(here, there, at, place, to_fold=to_fold), (place, there)]
        places, shapes = zip(*points, strict=True)
        out.append((np.array(places), list(shapes)))
    return out


def _numbers(path: Path) -> Array:
    """(T,) of the waypoints, from 1."""
    return np.arange(1.0, len(path.equilibria) + 1)


def _between(
    start: Equilibrium, end: Equilibrium, first: float, last: float, *, to_fold: bool
) -> list[tuple[float, Equilibrium]]:
    """Equilibria on the straight way between two, each from the one before.

    What is lost, or comes near no fold from the other side, is left out: the curve is then drawn straight.
    """
    count = NEAR_A_SNAP if to_fold else BETWEEN
    share = np.arange(1, count) / count
    share = 1 - (1 - share) ** 2 if to_fold else share  # like a root, the margin falls fastest where it ends
    found: list[tuple[float, Equilibrium]] = []
    guess = start
    for x in share:
        turns = start.rotations + x * (end.rotations - start.rotations)
        shifts = start.translations + x * (end.translations - start.translations)
        try:
            guess = forward_kinematics(start.robot, turns, shifts, start=guess, load=start.load)
        except SolveError:
            break
        found.append((first + x * (last - first), guess))
    return found


def _mark_snaps(above: Axes, below: Axes, path: Path) -> None:
    """A thin line at every snap, numbered on top."""
    for k, snap in enumerate(path.snaps, start=1):
        at = place_of(snap, _numbers(path))
        for axes in (above, below):
            axes.axvline(at, color=FAINT, lw=0.7, ls=(0, (4, 3)), zorder=0)
        if len(path.snaps) <= MOST_NAMES:
            name_above(above, at, f"snap {k}\n{number(snap.tip_jump * TO_MM, 1)} mm")


def _heading(path: Path) -> str:
    robot = path.equilibria[0].robot
    count = {0: "no snap", 1: "1 snap"}.get(len(path.snaps), f"{len(path.snaps)} snaps")
    return f"{robot.name or 'Tube robot'}:  {len(path.equilibria)} waypoints,  {count}"
