"""The S-curve: the tip angle of a tube over its input angle, through folds, with the jumps of a robot that turns."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ...errors import InputError
from ...stability import Branch
from ...typing import Array
from ..page import tube_colour
from .stage import note
from .style import FAINT, INK, Axes, Figure, angle_ticks, new_figure, number, picture

BAND = "#ECEEF1"
DOT_COLOUR = "#0072B2"
FINE_POINTS = 2000


@picture
def plot_branch(
    branch: Branch,
    *,
    tube: int = 0,
    reference: int | None = None,
    dots: ArrayLike | None = None,
    dots_label: str = "closed form",
) -> Figure:
    """Picture of a branch of equilibria: the tip angle of one tube over its input angle, deg.

    Stable parts are solid, unstable ones dashed. At each fold an arrow shows the jump of a robot that is turned slowly:
    up to the first stable part that the curve has at the same input beyond the fold. Inputs between folds, where two
    shapes are stable and history decides, are shaded.

    Args:
        branch: of `trace_branch`.
        tube: the tube that turns, 0 is the innermost.
        reference: the tube from which both angles are measured; by default the outermost, or the innermost if the
            outermost turns.
        dots: (k, 2) input and tip angles, rad, of another computation, for comparison; `dots_label` names them.

    Raises:
        InputError: tubes that do not exist or are the same, a tube that does not turn against the reference, a name of
            the picture that does not end in a known format.
    """
    n = branch.rotations.shape[1]
    base = reference if reference is not None else (0 if tube == n - 1 else n - 1)
    if tube == base or not {tube, base} <= {*range(n)}:
        raise InputError(f"tube is {tube} and reference {base}; they must be two different tubes from 0 to {n - 1}")
    curve = smooth(branch)
    inputs = np.degrees(curve.rotations[:, tube] - curve.rotations[:, base])
    tips = np.degrees(curve.tip_rotations[:, tube] - curve.tip_rotations[:, base])
    if np.ptp(inputs) < 1e-9:
        raise InputError(f"tube {tube} does not turn against tube {base} along the branch; choose one that does")
    figure = new_figure(6.0, 4.6)
    axes = figure.add_subplot()
    _draw_curve(axes, inputs, tips, curve.margin, tube_colour(tube))
    _draw_folds(axes, curve, inputs, tips)
    if dots is not None:
        x, y = np.degrees(np.asarray(dots, dtype=float)).T
        axes.plot(x, y, ".", ms=5, color=DOT_COLOUR, zorder=6, label=dots_label)
    axes.set_xlabel(f"input angle of tube {tube + 1} relative to tube {base + 1} (deg)")
    axes.set_ylabel(f"tip angle of tube {tube + 1} relative to tube {base + 1} (deg)")
    axes.grid()
    angle_ticks(axes.xaxis, axes.yaxis)
    axes.margins(x=0.07)
    axes.legend(loc="upper left" if (tips[-1] > tips[0]) == (inputs[-1] > inputs[0]) else "upper right")
    return figure


def smooth(branch: Branch) -> Branch:
    """The branch with many more points, on a cubic spline through its own, which are kept."""
    columns = np.column_stack([branch.fraction, branch.rotations, branch.tip_rotations])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(columns, axis=0), axis=1))])
    along, keep = np.unique(along, return_index=True)
    fine = np.union1d(along, np.linspace(0.0, along[-1], FINE_POINTS))
    values = scipy.interpolate.CubicSpline(along, columns[keep])(fine)
    n = branch.rotations.shape[1]
    return replace(
        branch,
        fraction=values[:, 0],
        rotations=values[:, 1 : n + 1],
        tip_rotations=values[:, n + 1 :],
        margin=np.interp(fine, along, branch.margin[keep]),
    )


def fold_points(branch: Branch) -> list[int]:
    """Numbers of the points of a branch that are its folds."""
    distances = [np.abs(branch.tip_rotations - fold.tip_rotations).max(1) for fold in branch.folds]
    return [int(np.argmin(distance)) for distance in distances]


def landing(branch: Branch, fold: int) -> tuple[float, Array] | None:
    """Where a robot lands that loses point `fold`: a fractional point number, and the tip rotations (n,) there.

    That is the first stable point with the same input on the far side of the unstable part that begins at the fold;
    None where the branch has none.
    """
    count = len(branch.fraction)
    step = 1 if branch.margin[min(fold + 1, count - 1)] < branch.margin[max(fold - 1, 0)] else -1
    gap = branch.fraction - branch.fraction[fold]
    k = fold + step
    while 0 <= k + step < count:
        if gap[k] * gap[k + step] <= 0 and gap[k] != gap[k + step]:
            part = gap[k] / (gap[k] - gap[k + step])
            margin = branch.margin[k] + part * (branch.margin[k + step] - branch.margin[k])
            if margin > 0:
                tips = branch.tip_rotations
                return k + step * float(part), tips[k] + part * (tips[k + step] - tips[k])
        k += step
    return None


def _ahead(branch: Branch, fold: int) -> bool:
    """Whether the branch comes to the fold from lower fractions, so that a robot snaps there on its way forth."""
    beside = branch.fraction[[max(fold - 1, 0), min(fold + 1, len(branch.fraction) - 1)]]
    return bool(beside.mean() < branch.fraction[fold])


def stable_parts(margin: Array) -> list[tuple[int, int, bool]]:
    """First and last point of every part of a curve that is all stable or all unstable, and whether it is stable."""
    stable = margin[:-1] + margin[1:] > 0
    cuts = [0, *(np.flatnonzero(stable[1:] != stable[:-1]) + 1).tolist(), len(stable)]
    return [(first, last, bool(stable[first])) for first, last in pairwise(cuts)]


def _draw_curve(axes: Axes, inputs: Array, tips: Array, margin: Array, colour: str) -> None:
    """The curve, cut where stability changes."""
    named: set[bool] = set()
    for first, last, kind in stable_parts(margin):
        part = slice(first, last + 1)
        label = "_" if kind in named else "stable" if kind else "unstable"
        line = "-" if kind else (0, (4, 2))
        axes.plot(inputs[part], tips[part], color=colour, ls=line, lw=2.0 if kind else 1.4, label=label, zorder=3)
        named.add(kind)


def _draw_folds(axes: Axes, curve: Branch, inputs: Array, tips: Array) -> None:
    """Folds, the jumps from them, and a band over the inputs between two folds."""
    folds = fold_points(curve)
    if folds:
        axes.plot(inputs[folds], tips[folds], "o", ms=5.5, mfc="white", mec=INK, mew=1.2, zorder=5, label="fold")
    for k in folds:
        _draw_jump(axes, curve, inputs, tips, k, outward=1 if _ahead(curve, k) == (inputs[-1] > inputs[0]) else -1)
    for first, second in pairwise(folds):
        if curve.margin[(first + second) // 2] < 0:
            name = "more than one stable shape" if first == folds[0] else None
            axes.axvspan(*sorted(inputs[[first, second]]), color=BAND, lw=0, zorder=0, label=name)


def _draw_jump(axes: Axes, branch: Branch, inputs: Array, tips: Array, fold: int, *, outward: int) -> None:
    """The angles of a fold, and an arrow to where the robot lands."""
    x, y = float(inputs[fold]), float(tips[fold])
    words = f"input {x:.3f}°\ntip {y:.3f}°".replace("-", "\N{MINUS SIGN}")
    note(axes, words, np.array([x, y]), np.array([9.0 * outward, 0.0]))
    landed = landing(branch, fold)
    if landed is None:
        return
    place, _ = landed
    end = float(np.interp(place, np.arange(len(tips)), tips))
    arrow = {"arrowstyle": "-|>", "color": INK, "lw": 1.0, "shrinkA": 4, "shrinkB": 1, "mutation_scale": 11}
    axes.annotate("", (x, end), (x, y), arrowprops=arrow, zorder=4)
    words = f"snap: tip turns {number(abs(end - y), 1)}°"
    note(axes, words, np.array([x, (y + end) / 2]), np.array([5.0 * outward, 0.0]), colour=FAINT)
