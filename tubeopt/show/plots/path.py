"""Motion through waypoints: the tip and the margin on the way, broken where the robot snaps."""

from __future__ import annotations

import numpy as np

from ...equilibrium.kinematics import forward_kinematics
from ...equilibrium.result import Equilibrium
from ...errors import SolveError
from ...files.units import TO_MM
from ...stability import Path
from ...typing import Array
from .style import FAINT, INK, Axes, Figure, headed, name_above, new_figure, number, picture

COORDINATES = (("x", "#D55E00"), ("y", "#009E73"), ("z", "#0072B2"))
"""Coordinates of the tip and their colours; from the palette of Okabe and Ito (2008)."""

BETWEEN = 4
"""Points per stretch between waypoints."""

NEAR_A_SNAP = 16
"""The same where the stretch ends in a snap."""

MOST_NAMES = 12
"""Snaps that are named in the picture; more would cover each other."""


@picture
def plot_path(path: Path) -> Figure:
    """Picture of a motion: tip position over the waypoints, and the margin below it.

    Between waypoints equilibria are solved too, closer where a snap is near, towards which the margin falls like a
    root. At a snap the curves break: an open mark where the robot was, a full one where it lands.
    """
    waypoint, tip, margin = _curves(path)
    figure = new_figure(7.0, 5.0)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    for k, (name, colour) in enumerate(COORDINATES):
        above.plot(waypoint, tip[:, k] * TO_MM, color=colour, lw=1.4, label=name)
        _mark_ends(
            above,
            path,
            [(s.before.tip_position[k] * TO_MM, s.after.tip_position[k] * TO_MM) for s in path.snaps],
            colour,
        )
    below.plot(waypoint, margin, color=INK, lw=1.4)
    _mark_ends(below, path, [(s.before.margin, s.after.margin) for s in path.snaps], INK)
    _mark_snaps(above, below, path)
    below.axhline(0, color=FAINT, lw=0.7)
    below.set_ylim(min(-0.05, float(np.nanmin(margin)) - 0.05), 1.05)
    above.set_ylabel("tip position (mm)")
    below.set_ylabel("margin")
    below.set_xlabel("waypoint")
    last = len(path.equilibria)
    below.set_xlim(1 - 0.02 * last, last + 0.02 * last)
    below.xaxis.get_major_locator().set_params(integer=True)
    for axes in (above, below):
        axes.grid(axis="y")
    above.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), handlelength=1.4)
    headed(figure, _heading(path))
    return figure


def _curves(path: Path) -> tuple[Array, Array, Array]:
    """Place in the path in waypoints from 1, tip (m) and margin there; NaN between the two sides of a snap."""
    gap = np.full(3, np.nan)
    points: list[tuple[float, Array, float]] = []
    for k, here in enumerate(path.equilibria):
        points.append((k + 1.0, here.tip_position, here.margin))
        at, arrived = k + 1.0, here
        for snap in (snap for snap in path.snaps if snap.index == k):
            place = _place(snap.index, snap.fraction)
            points += _between(arrived, snap.before, at, place, to_fold=True)
            points.append((place, snap.before.tip_position, snap.before.margin))
            points.append((place, gap, np.nan))
            points.append((place, snap.after.tip_position, snap.after.margin))
            at, arrived = place, snap.after
        if k + 1 < len(path.equilibria):
            points += _between(arrived, path.equilibria[k + 1], at, k + 2.0, to_fold=False)
    return np.array([p[0] for p in points]), np.array([p[1] for p in points]), np.array([p[2] for p in points])


def _between(
    start: Equilibrium, end: Equilibrium, first: float, last: float, *, to_fold: bool
) -> list[tuple[float, Array, float]]:
    """Equilibria on the straight way between two, each from the one before: place, tip and margin.

    What is lost, or comes near no fold from the other side, is left out: the curve is then drawn straight.
    """
    count = NEAR_A_SNAP if to_fold else BETWEEN
    share = np.arange(1, count) / count
    share = 1 - (1 - share) ** 2 if to_fold else share  # like a root, the margin falls fastest where it ends
    found: list[tuple[float, Array, float]] = []
    guess = start
    for x in share:
        turns = start.rotations + x * (end.rotations - start.rotations)
        shifts = start.translations + x * (end.translations - start.translations)
        try:
            guess = forward_kinematics(start.robot, turns, shifts, guess=guess, load=start.load)
        except SolveError:
            break
        found.append((first + x * (last - first), guess.tip_position, guess.margin))
    return found


def _place(index: int, fraction: float) -> float:
    return index + 1 + fraction


def _mark_ends(axes: Axes, path: Path, ends: list[tuple[float, float]], colour: str) -> None:
    """An open mark where each snap begins, a full one where it ends."""
    for snap, (before, after) in zip(path.snaps, ends, strict=True):
        at = _place(snap.index, snap.fraction)
        axes.plot([at], [before], "o", ms=4, mfc="white", mec=colour, zorder=4, clip_on=False)
        axes.plot([at], [after], "o", ms=4, mfc=colour, mec=colour, zorder=4, clip_on=False)


def _mark_snaps(above: Axes, below: Axes, path: Path) -> None:
    """A thin line at every snap, numbered on top."""
    for k, snap in enumerate(path.snaps, start=1):
        at = _place(snap.index, snap.fraction)
        for axes in (above, below):
            axes.axvline(at, color=FAINT, lw=0.7, ls=(0, (4, 3)), zorder=0)
        if len(path.snaps) <= MOST_NAMES:
            name_above(above, at, f"snap {k}\n{number(snap.tip_jump * TO_MM, 1)} mm")


def _heading(path: Path) -> str:
    robot = path.equilibria[0].robot
    count = {0: "no snap", 1: "1 snap"}.get(len(path.snaps), f"{len(path.snaps)} snaps")
    return f"{robot.name or 'Tube robot'}:  {len(path.equilibria)} waypoints,  {count}"
